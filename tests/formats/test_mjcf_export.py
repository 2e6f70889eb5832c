"""Mechanisms written as MJCF: MuJoCo has the same bodies, loops, forces and drivers."""

import numpy as np
import pinocchio as pin
import pytest
from beside_mujoco import accelerations, beside, mass_matrices, random_configuration
from mechanisms import from_text
from mujoco_files import ANKLE, ARMS, CASSIE, GRIPPER, SLIDER, opened, written
from variety import each

import spatial_pin as sp

mujoco = pytest.importorskip("mujoco")

EXACT = ["four_bar", "hooke_joint", "delta", "stewart", "geared_five_bar", "crank_collar", "rspc",
         "peaucellier", "rssr_crossed", "watt_six_bar"]  # closures that MuJoCo has
COMPOSED = ["oldham", "swash_plate", "screw_press"]  # with another body, or another joint


def exported(mech, tmp_path, state=None):
    return sp.export_mjcf(mech, tmp_path / "made.xml", state)


def at_home(path):
    """MuJoCo's model of a file, and its data at the key."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return model, data


def gap(mech, state, model, data):
    """Largest difference between the placements of the links here and there [m, -]."""
    worst = 0.0
    for link in mech.links:
        here, body = state.placement(link), data.body(link)
        worst = max(worst, np.abs(here.translation - body.xpos).max(),
                    np.abs(here.rotation - body.xmat.reshape(3, 3)).max())
    return worst


def opening(data):
    """Largest equation of the equalities [m, -]."""
    return np.abs(data.efc_pos[data.efc_type == 0]).max(initial=0.0)


@pytest.mark.alike
@pytest.mark.filterwarnings("ignore:mechanism")
@pytest.mark.parametrize("name", EXACT + COMPOSED)
def test_mujoco_has_the_links_where_they_are_and_the_loops_closed(name, tmp_path):
    mech = sp.load(name)
    state = sp.assemble(mech, {})
    model, data = at_home(exported(mech, tmp_path))
    assert gap(mech, state, model, data) < 1e-12
    assert opening(data) < 1e-12
    assert {model.actuator(k).name for k in range(model.nu)} == set(mech.drivers)


@pytest.mark.delicate
@pytest.mark.filterwarnings("ignore:mechanism")
@pytest.mark.parametrize("name", each(EXACT + COMPOSED))
def test_the_exported_file_has_the_same_freedoms(name, tmp_path):
    mech = sp.load(name)
    again = sp.load(exported(mech, tmp_path, sp.assemble(mech, {})))
    before, after = (sp.mobility(x, sp.assemble(x, {})) for x in (mech, again))
    assert after.dof == before.dof
    if name in EXACT:
        assert after.rank == before.rank and len(after.passive) == len(before.passive)
        assert [c.type for c in again.closures] == [c.type for c in mech.closures]
        assert set(again.coordinates) >= {c for c in mech.coordinates if c in again.coordinates}


@pytest.mark.parametrize("file", [CASSIE, GRIPPER, ANKLE], ids=lambda f: f.stem)
@pytest.mark.filterwarnings("ignore:mechanism")
def test_a_robot_comes_back_as_it_went(file, tmp_path):
    mech = opened(file)
    state = sp.assemble(mech, {})
    path = exported(mech, tmp_path, state)
    model, data = at_home(path)
    assert gap(mech, state, model, data) < 1e-12 and opening(data) < 1e-12
    again = sp.load(path)
    assert again.coordinates == mech.coordinates and set(again.links) == set(mech.links)
    assert {k: d.joint for k, d in again.drivers.items()} == {
        k: d.joint for k, d in mech.drivers.items()}
    assert [(c.name, c.type, c.n_rows) for c in again.closures] == [
        (c.name, c.type, c.n_rows) for c in mech.closures]
    assert [(s.joint, s.stiffness, s.free) for s in again.springs] == [
        (s.joint, s.stiffness, s.free) for s in mech.springs]
    for key in ("damping", "armature", "upperDryFrictionLimit", "lowerPositionLimit",
                "upperPositionLimit"):
        assert np.array_equal(getattr(again.model, key), getattr(mech.model, key)), key
    before, after = sp.mobility(mech, state), sp.mobility(again, sp.assemble(again, {}))
    assert (after.rank, after.dof, len(after.passive)) == (
        before.rank, before.dof, len(before.passive))


# ---------------------------------------------------------------- every pair, and what acts

BODY = """<inertial><origin xyz="0.1 0.2 {k}" rpy="0.3 {k} 0.5"/><mass value="{k}"/>
  <inertia ixx="0.3" iyy="0.4" izz="0.5" ixy="0.01" ixz="0.02" iyz="0.03"/></inertial>"""


def chain(pairs):
    """A chain of floating joints, made into pairs beside it."""
    links = "".join(f'<link name="l{k}">{BODY.format(k=k) if k else ""}</link>'
                    for k in range(len(pairs) + 1))
    joints = "".join(
        f'<joint name="j{k}" type="floating"><origin xyz="0.{k} 0.2 0.3" rpy="0.{k} 0.5 0.6"/>'
        f'<parent link="l{k - 1}"/><child link="l{k}"/></joint>'
        for k in range(1, len(pairs) + 1))
    axes = {"axis": [0.6, 0.0, 0.8]}
    tables = {
        "revolute": axes, "prismatic": axes, "cylindrical": axes, "planar": axes,
        "screw": {**axes, "lead": 0.3}, "spherical": {}, "floating": {},
        "universal": {"axis": [0.6, 0.0, 0.8], "axis2": [0.0, 1.0, 0.0]},
    }
    content = {"name": "chain", "tree": "chain.urdf", "joints": {
        f"j{k}": {"type": pair, **tables[pair], "damping": 0.5, "armature": 0.2}
        for k, pair in enumerate(pairs, start=1)}}
    return f'<robot name="chain">{links}{joints}</robot>', content


PAIRS = ["revolute", "prismatic", "cylindrical", "planar", "screw", "spherical", "universal",
         "floating"]


@pytest.mark.parametrize(
    "pairs", [*([p, "revolute"] for p in PAIRS), *(["revolute", p] for p in PAIRS), PAIRS],
    ids="-".join)
def test_every_pair_of_a_tree_moves_as_it_does_here(pairs, tmp_path):
    urdf, content = chain(pairs)
    mech, rng = from_text(urdf, content, "chain"), np.random.default_rng(5)
    values = {c: float(x) for c, x in zip(
        mech.coordinates, rng.uniform(-0.8, 0.8, len(mech.coordinates)), strict=True)}
    state = sp.assemble(mech, values)
    model, data = at_home(exported(mech, tmp_path, state))
    assert gap(mech, state, model, data) < 1e-12 and opening(data) < 1e-12
    assert np.abs(model.opt.gravity - mech.model.gravity.linear).max() == 0.0


@pytest.mark.parametrize("springs", [
    [], [{"name": "s", "joint": "j1", "stiffness": 30.0, "free_angle": 0.3, "damping": 2.0}],
    [{"name": "s", "joint": "j2", "stiffness": 30.0, "free_length": 0.3},
     {"name": "t", "joint": "j2", "stiffness": 10.0, "free_length": -0.4}],
    [{"name": "s", "frames": ["l0", "l3"], "stiffness": 40.0, "free_length": 0.1, "damping": 3.0}],
], ids=["weight", "about a joint", "two along a joint", "between frames"])
@pytest.mark.parametrize("last", ["revolute", "spherical"])
def test_forces_are_the_same_there(springs, last, tmp_path):
    urdf, content = chain(["revolute", "prismatic", last])
    mech = from_text(urdf, {**content, "springs": springs, "gravity": [1.0, 2.0, -3.0]}, "chain")
    model, _ = at_home(exported(mech, tmp_path))
    pair, rng = beside(mech, model), np.random.default_rng(6)
    here, there = accelerations(pair, random_configuration(mech, rng), rng)
    assert np.abs(here - there).max() < 1e-10 * np.abs(here).max()


# ---------------------------------------------------------------- shapes, names, refusals


def test_shapes_are_drawn_where_they_were(tmp_path):
    pair_text = """<worldbody><body name="a" pos="0 0 1"><joint/>
      <geom type="box" size=".1 .2 .3" pos=".1 .2 .3" quat="1 2 3 4" rgba="1 0 0 .5"/>
      <geom type="cylinder" size=".1 .2" pos="1 0 0" contype="0" conaffinity="0"/>
      <geom type="ellipsoid" size=".1 .2 .3"/></body></worldbody>"""
    mech = sp.load(written(tmp_path, pair_text))
    model, _ = at_home(exported(mech, tmp_path))
    kinds = [mujoco.mjtGeom(k).name for k in model.geom_type]
    assert kinds == ["mjGEOM_BOX", "mjGEOM_CYLINDER", "mjGEOM_MESH", "mjGEOM_BOX", "mjGEOM_MESH"]
    assert model.geom_size[0] == pytest.approx([0.1, 0.2, 0.3])
    assert model.geom_pos[0] == pytest.approx([0.1, 0.2, 0.3])
    assert model.geom_rgba[0] == pytest.approx([1.0, 0.0, 0.0, 0.5])
    assert model.geom_contype.tolist() == [0, 0, 0, 1, 1]
    again = sp.load(tmp_path / "made.xml")
    for before, after in zip(mech.visual_model.geometryObjects,
                             again.visual_model.geometryObjects, strict=True):
        assert np.abs((before.placement.inverse() * after.placement).homogeneous
                      - np.eye(4)).max() < 1e-6 or before.geometry.getNodeType() != 9


def test_limits_efforts_and_friction_go_with_their_joints(tmp_path):
    urdf, content = chain(["revolute", "prismatic"])
    content["joints"]["j1"] |= {"lower": -0.5, "upper": 0.7, "effort": 12.0, "friction": 0.4}
    mech = from_text(urdf, content, "chain")
    model, _ = at_home(exported(mech, tmp_path))
    assert model.jnt_limited.tolist() == [1, 0]
    assert model.jnt_range[0].tolist() == [-0.5, 0.7]
    assert model.jnt_actfrcrange[0].tolist() == [-12.0, 12.0]
    assert model.dof_frictionloss.tolist() == [0.4, 0.0]
    again = sp.load(tmp_path / "made.xml")
    assert again.model.upperEffortLimit[0] == 12.0


@pytest.mark.parametrize("length", [{"length": 0.9}, {"length_between": ["l0", "l3"]}],
                         ids=["constant", "of two others"])
def test_a_distance_is_a_tendon_of_its_length(length, tmp_path):
    urdf, content = chain(["universal", "spherical", "revolute", "prismatic"])
    content["closures"] = [{"name": "rod", "type": "distance", "frames": ["l1", "l4"], **length}]
    mech = from_text(urdf, content, "chain")
    state = sp.assemble(mech, {})
    path = exported(mech, tmp_path, state)
    model, data = at_home(path)
    assert gap(mech, state, model, data) < 1e-12 and opening(data) < 1e-12
    again = sp.load(path)
    assert [(c.type, c.frames, c.between) for c in again.closures] == [
        (c.type, c.frames, c.between) for c in mech.closures]
    before, after = (sp.mobility(x, sp.assemble(x, {})) for x in (mech, again))
    assert (after.rank, after.dof) == (before.rank, before.dof)


POLYNOMIAL = {"polynomial": [0.1, 0.2, 0.05, 0.0, -0.01]}
TIES = {
    "ratios": [sp.closures.coupling(joints=["a", "b", "c"], ratios=[2.0, -1.0, 3.0], offset=0.4)],
    "function": [sp.closures.coupling(joints=["a", "c"], function=POLYNOMIAL)],
    "rope": [sp.closures.rope([("universe", pin.SE3(np.eye(3), np.array([0.3, 0.4, 0.0]))),
                               ("a", pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.0]))),
                               ("c", pin.SE3(np.eye(3), np.array([0.0, 0.1, 0.2])))], 1.4)],
}


@pytest.mark.parametrize("closures", TIES.values(), ids=TIES)
def test_couplings_of_any_form_and_ropes_go_there_and_come_back(closures, tmp_path):
    model = pin.Model()
    model.name = "tied"
    for k, (name, kind) in enumerate((("a", pin.JointModelRZ), ("b", pin.JointModelRX),
                                      ("c", pin.JointModelPY))):
        joint = model.addJoint(0, kind(), pin.SE3(np.eye(3), np.array([0.2 * k, 0.0, 0.0])), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)),
                                pin.SE3.Identity())
    mech = sp.Mechanism.from_model(model, closures)
    state = sp.assemble(mech, {})
    path = sp.export_mjcf(mech, tmp_path / "tied.xml", state)
    assert opening(at_home(path)[1]) < 1e-12
    again = sp.load(path)
    assert [c.type for c in again.closures] == [c.type for c in mech.closures]
    ours, theirs = (sp.closure_jacobian(one, state.q) for one in (mech, again))
    np.testing.assert_allclose(theirs, ours, atol=1e-13)


def test_a_spline_is_no_polynomial_of_mujoco(tmp_path):
    model = pin.Model()
    for name in ("a", "b"):
        model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), name)
    law = {"points": [[x, x**2] for x in np.linspace(0.0, 1.0, 8)]}
    mech = sp.Mechanism.from_model(model, [sp.closures.coupling(joints=["a", "b"], function=law)])
    with pytest.raises(sp.ClosureTypeError, match="8 points; MuJoCo has polynomials"):
        sp.export_mjcf(mech, tmp_path / "law.xml")


def test_a_closure_that_mujoco_has_not_is_refused_by_name(tmp_path):
    urdf, content = chain(["revolute", "revolute"])
    content["closures"] = [{"name": "rail", "type": "parallel", "frames": ["l0", "l2"]}]
    mech = from_text(urdf, content, "chain")
    with pytest.raises(sp.ClosureTypeError, match="'rail' is parallel"):
        exported(mech, tmp_path)
    assert not (tmp_path / "made.xml").exists()


def test_a_joint_that_resists_in_each_direction_otherwise_is_refused_by_name(tmp_path):
    urdf, content = chain(["spherical"])
    content["joints"]["j1"]["damping"] = [0.1, 0.2, 0.3]
    with pytest.raises(sp.SpatialPinError, match="joint 'j1' has damping"):
        exported(from_text(urdf, content, "chain"), tmp_path)


def test_a_body_without_mass_at_an_end_gets_as_much_as_mujoco_demands_and_it_is_reported(tmp_path):
    urdf, content = chain(["revolute", "revolute"])
    mech = from_text(urdf.replace(BODY.format(k=2), ""), content, "chain")
    with pytest.warns(sp.SpatialPinWarning, match="l2 have got"):
        path = exported(mech, tmp_path)
    model, _ = at_home(path)
    assert 0.0 < model.body("l2").mass[0] < 1e-8


def test_a_body_without_mass_that_carries_others_gets_what_nobody_can_measure(tmp_path):
    urdf, content = chain(["revolute", "prismatic", "revolute"])
    mech = from_text(urdf.replace(BODY.format(k=1), "").replace(BODY.format(k=2), ""), content,
                     "chain")
    model, _ = at_home(exported(mech, tmp_path))
    q = random_configuration(mech, np.random.default_rng(8))
    here, there = mass_matrices(beside(mech, model), q)
    assert np.abs(here - there).max() < 1e-12 * np.abs(here).max()


def test_loops_that_do_not_close_are_written_as_the_guess_has_them(tmp_path):
    urdf, content = chain(["revolute", "revolute"])
    content["closures"] = [{"name": "far", "type": "weld", "frames": ["l0", "l2"]}]
    content["guess"] = {"j1": 0.3, "j2": -0.2}
    with pytest.warns(sp.SpatialPinWarning, match="whose loops are open"):
        _, data = at_home(exported(from_text(urdf, content, "chain"), tmp_path))
    assert data.qpos.tolist() == [0.3, -0.2]


def test_the_command_line_writes_it_closed(tmp_path, run):
    path = tmp_path / "four_bar.xml"
    code, out, _ = run("export", "four_bar", "--mjcf", path)
    assert code == 0 and str(path) in out
    assert opening(at_home(path)[1]) < 1e-12


def test_a_mechanism_is_not_written_over_itself_nor_under_another_ending(tmp_path):
    path = written(tmp_path, ARMS)
    with pytest.raises(sp.SpatialPinError, match="a file of the mechanism itself"):
        sp.export_mjcf(sp.load(path), path)
    with pytest.raises(sp.SpatialPinError, match=r"ends in .xml or .mjcf"):
        sp.export_mjcf(sp.load(path), tmp_path / "made.urdf")


def test_tendons_and_several_joints_of_a_body_come_back(tmp_path):
    mech = sp.load(written(tmp_path, SLIDER))
    again = sp.load(exported(mech, tmp_path))
    assert [s.name for s in again.springs] == [s.name for s in mech.springs]
    assert again.coordinates == mech.coordinates


def test_tooth_forces_act_at_joints_in_mujoco_and_it_is_reported(tmp_path):
    model = pin.Model()
    model.name = "gears"
    for name, x in (("one", 0.0), ("two", 0.07)):
        i = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), name)
        model.appendBodyToJoint(i, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    mesh = sp.closures.coupling("one", "two", -0.4, name="mesh", teeth={
        "point": [0.02, 0.0, 0.0], "pressure_angle": 0.35})
    with pytest.warns(sp.SpatialPinWarning, match=r"forces of teeth and strands \(mesh\)"):
        sp.export_mjcf(sp.Mechanism.from_model(model, [mesh], drivers=["one"]),
                       tmp_path / "gears.xml")
