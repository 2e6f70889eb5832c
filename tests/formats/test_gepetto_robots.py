"""Robots of Gepetto's example-parallel-robots: a URDF and a `robot.yaml` beside it."""

import shutil
from collections import Counter

import numpy as np
import pinocchio as pin
import pytest
from folders import DATA

import spatial_pin as sp

GEPETTO = DATA / "gepetto"
ROBOTS = {  # closures, drivers, joints of the tree, finite freedoms, passive ones of them
    "5bar_linkage_iso3d": ({"spherical": 1}, 2, {"revolute": 5}, 2, 0),
    "cassie_like": ({"weld": 2}, 5, {"revolute": 19}, 7, 2),
    "digit_like_2legs": ({"weld": 6}, 12, {"revolute": 18, "universal": 6, "spherical": 6}, 12, 0),
    "digit_like_2legs_6D": ({"weld": 6}, 12, {"revolute": 48}, 12, 0),
    "talos_like": ({"weld": 1}, 6, {"revolute": 13}, 7, 1),
    "wl16_like": ({"weld": 5}, 6, {"revolute": 36, "prismatic": 6}, 12, 6),
}


@pytest.mark.delicate
@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_opens_with_its_loops_motors_joints_and_freedoms_and_closes(name):
    closures, drivers, joints, freedoms, passive = ROBOTS[name]
    mech = sp.load(GEPETTO / name)
    assert mech.name == name
    assert Counter(c.type for c in mech.closures) == closures
    assert all(c.source == "closed_loop of robot.yaml" for c in mech.closures)
    assert len(mech.drivers) == drivers
    assert Counter(mech.pairs) == joints
    state = sp.assemble(mech)
    assert state.closure_error < 1e-12
    for closure in mech.closures:
        between = state.placement(closure.frames[0]).actInv(state.placement(closure.frames[1]))
        assert np.linalg.norm(between.translation) < 1e-12
        if closure.type == "weld":
            assert np.allclose(between.rotation, np.eye(3), rtol=0, atol=1e-12)
    found = sp.mobility(mech, state)
    assert (found.dof, len(found.passive)) == (freedoms, passive)


def test_folder_urdf_and_yaml_are_the_same_robot():
    folder = GEPETTO / "digit_like_2legs"
    one, two, three = (sp.load(path) for path in (folder, folder / "robot.urdf",
                                                  folder / "robot.yaml"))
    assert [m.name for m in (one, two, three)] == ["digit_like_2legs", "robot", "digit_like_2legs"]
    for other in (two, three):
        assert [c.name for c in other.closures] == [c.name for c in one.closures]
        assert (other.pairs, list(other.drivers)) == (one.pairs, list(one.drivers))


def test_a_robot_of_a_folder_takes_all_that_load_takes(tmp_path):
    mech = sp.load(GEPETTO / "talos_like", free_flyer=True)
    assert mech.pairs[0] == "floating"
    assert sp.mobility(mech).dof == ROBOTS["talos_like"][3] + 6
    saved = sp.load(mech.save(tmp_path))
    assert [c.name for c in saved.closures] == [c.name for c in mech.closures]
    assert saved.pairs == mech.pairs


def test_meshes_of_a_folder_lie_beside_its_urdf(tmp_path):
    folder = tmp_path / "pkg"
    (folder / "urdf").mkdir(parents=True)
    (folder / "tip.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for file in ("../tip.obj", "package://pkg/tip.obj"):
        (folder / "urdf" / "pkg.urdf").write_text(TREE.replace(
            '<link name="a"/>', f'<link name="a"><visual><geometry><mesh filename="{file}"/>'
            "</geometry></visual></link>"))
        assert len(sp.load(folder).visual_model.geometryObjects) == 1


def test_a_universal_joint_turns_about_the_two_axes_that_its_type_names():
    mech = sp.load(GEPETTO / "digit_like_2legs")
    joint = "spherical_free_knee"
    assert mech.pair_of(joint) == "universal"
    model, data, q = mech.model, mech.model.createData(), mech.neutral.copy()
    i = mech.joint_id(joint)
    q[model.idx_qs[i]:model.idx_qs[i] + 2] = 0.3, 0.4
    pin.forwardKinematics(model, data, q)
    turn = (model.jointPlacements[i].inverse() * data.liMi[i]).rotation
    assert np.allclose(turn, pin.rpy.rpyToMatrix(0.3, 0, 0) @ pin.rpy.rpyToMatrix(0, 0.4, 0),
                       atol=1e-14)


# ---------------------------------------------------------------- written by hand

TREE = """<robot name="r"><link name="base"/><link name="a"/><link name="b"/>
<link name="end_A"/><link name="end_B"/>
<joint name="m" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/></joint>
<joint name="k" type="continuous"><parent link="base"/><child link="b"/><axis xyz="0 1 0"/></joint>
<joint name="f" type="fixed"><parent link="a"/><child link="end_A"/><origin xyz="0 0 1"/></joint>
<joint name="g" type="fixed"><parent link="b"/><child link="end_B"/><origin xyz="0 0 1"/></joint>
</robot>"""
LOOP = "closed_loop: [[end_A, end_B]]\n"


def robot(folder, yaml, urdf="robot.urdf", file="robot.yaml"):
    (folder / urdf).write_text(TREE)
    (folder / file).write_text(yaml)
    return folder


def test_a_loop_without_a_type_is_a_weld_and_3d_in_any_letters_a_common_point(tmp_path):
    assert sp.load(robot(tmp_path, LOOP)).closures[0].type == "weld"
    assert sp.load(robot(tmp_path, LOOP + "type: ['3D']")).closures[0].type == "spherical"


def test_a_joint_that_is_fixed_by_the_file_stays_at_its_zero(tmp_path):
    mech = sp.load(robot(tmp_path, "closed_loop: []\njoint_name: [k]\njoint_type: [FIXED]\n"))
    assert mech.pairs == ("revolute",)


def test_names_that_do_not_exist_are_reported(tmp_path):
    yaml = LOOP + "name_mot: [m, motor]\njoint_name: [kk]\njoint_type: [SPHERICAL]\n"
    with pytest.warns(UserWarning, match=r"no joint 'motor'|no joint 'kk'.*did you mean 'k'"):
        mech = sp.load(robot(tmp_path, yaml))
    assert list(mech.drivers) == ["m"]
    assert mech.pairs == ("revolute", "revolute")


@pytest.mark.parametrize(("yaml", "words"), [
    ("closed_loop: [[end_A, end_C]]\n", "'end_C' does not exist; did you mean 'end_.'"),
    ("closed_loop: [[end_A]]\n", r"closed_loop\[0\] must be two names"),
    ("closed_loop: 3\n", "closed_loop must be a list"),
    ("closed_loop: [[{a: b}, [c]]]\n", r"closed_loop\[0\] must be two names"),
    (LOOP + "name_mot: [[m], {k: k}]\n", "name_mot must be a list of names"),
    ("closed_loop: [[end_A, end_B]\n", "not valid YAML"),
    (LOOP + "loops: [a]\n", "loops is not a key"),
    (LOOP + "joint_name: [k]\njoint_type: [UJOINT_XX]\n", "joint_type 'UJOINT_XX' is not known"),
    (LOOP + "joint_name: [k]\n", "1 joint_name for 0 joint_type"),
    (LOOP + "type: [3d, 6d]\n", "1 closed_loop for 2 type"),
])
def test_what_makes_no_sense_is_refused_with_file_and_key(tmp_path, yaml, words):
    with pytest.raises(sp.MechanismFileError, match=words) as failure:
        sp.load(robot(tmp_path, yaml))
    assert "robot.yaml" in str(failure.value)


def test_several_robots_of_a_folder_each_have_their_file(tmp_path):
    robot(tmp_path, LOOP + "type: [3d]\n", "one.urdf", "one.yaml")
    robot(tmp_path, LOOP + "urdf: one.urdf\n", "two.urdf", "welded.yaml")
    assert sp.load(tmp_path / "one.urdf").closures[0].type == "spherical"
    assert sp.load(tmp_path / "welded.yaml").closures[0].type == "weld"
    with pytest.raises(sp.MechanismFileError, match=r"which \.urdf is meant"):
        sp.load(tmp_path)
    (tmp_path / "welded.yaml").rename(tmp_path / "robot.yaml")
    mech = sp.load(tmp_path)
    assert (mech.name, mech.closures[0].type) == (tmp_path.name, "weld")


def test_a_yaml_file_of_something_else_is_unchanged(tmp_path):
    for text in ("gains: [1, 2]\n", "- a\n- b\n", "a: [\n", "\xff"):
        robot(tmp_path, text)
        assert sp.load(tmp_path / "robot.urdf").closures == ()


def test_the_file_of_another_robot_is_not_taken(tmp_path):
    robot(tmp_path, LOOP, "robot.urdf")
    (tmp_path / "other.urdf").write_text(TREE.replace("end_A", "tip").replace("end_B", "top"))
    assert sp.load(tmp_path / "other.urdf").closures == ()


def test_loops_that_only_a_missing_file_could_state_are_reported(tmp_path):
    shutil.copy(GEPETTO / "talos_like" / "robot.urdf", tmp_path / "leg.urdf")
    with pytest.warns(UserWarning, match="closedloop1_A.* no robot.yaml beside it"):
        assert sp.load(tmp_path / "leg.urdf").closures == ()
    (tmp_path / "leg.toml").write_text(
        'name = "leg"\ntree = "leg.urdf"\n[[closures]]\nname = "l"\ntype = "weld"\n'
        'frames = ["closedloop1_A", "closedloop1_B"]\n')
    assert len(sp.load(tmp_path / "leg.toml").closures) == 1
