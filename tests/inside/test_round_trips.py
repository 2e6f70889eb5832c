"""What is written loads as exactly that, whatever its frames are called and what lies beside it.

Frames of every mechanism here are called as the ends of loops are by programs that state loops by
names. Each importer of the table, and each way of stating loops in a URDF, has a case.
"""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from sameness import same_mechanisms
from variety import each

import spatial_pin as sp
from spatial_pin.formats.importers import IMPORTERS
from spatial_pin.formats.urdf_importer import BESIDE, ELEMENTS, LEFT

pytestmark = pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
MASS = ('<inertial><origin xyz="{x} 0 0"/><mass value="{m}"/><inertia ixx="1e-4" iyy="1e-3" '
        'izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>')
HINGE = ('<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
         '<origin xyz="{x} 0 0" rpy="0 0 {turn}"/><axis xyz="0 0 1"/></joint>')
COSINES = (0.28**2 + 0.2**2 - 0.24**2) / 0.112, (0.28**2 - 0.24**2 - 0.2**2) / 0.096
TURNS = [float(x) for x in np.arccos(COSINES)]  # of coupler and rocker, the crank along the ground
FIXED = ('<link name="{name}"/><joint name="{name}_mount" type="fixed"><parent link="{parent}"/>'
         '<child link="{name}"/><origin xyz="{x} 0 {z}"/></joint>')


def urdf(stated="", mates=()):
    """A plane four-bar, drawn closed, with frames at its ends; `mates` names their loops."""
    text = '<robot name="m"><link name="base"/>'
    for link, x, mass in (("crank", 0.05, 0.2), ("coupler", 0.14, 0.5), ("rocker", 0.12, 0.4)):
        text += f'<link name="{link}">{MASS.format(x=x, m=mass)}</link>'
    for name, parent, child, x, turn in (
            ("j1", "base", "crank", 0.0, 0.0), ("j2", "crank", "coupler", 0.1, TURNS[0]),
            ("j3", "base", "rocker", 0.3, TURNS[1])):
        text += HINGE.format(name=name, parent=parent, child=child, x=x, turn=turn)
    for name in mates:
        for side, (parent, x) in enumerate((("coupler", 0.28), ("rocker", 0.24)), start=1):
            for end, z in (("", 0.0), ("_z", 0.1)):
                text += FIXED.format(name=f"{name}_{side}{end}", parent=parent, x=x, z=z)
    return f"{text}{stated}</robot>"


def ends(text):
    """The text for the two ends of the last pin: link, and x there."""
    return "".join(text.format(side=side, link=link, x=x) for side, link, x in (
        (1, "coupler", 0.28), (2, "rocker", 0.24)))


LOOP = ends('<link{side} link="{link}" xyz="{x} 0 0"/>')
OF_CONSTRAINT = ('<parent link="coupler"/><parent_origin xyz=".28 0 0"/><child link="rocker"/>'
                 '<child_origin xyz=".24 0 0"/><axis xyz="0 0 1"/>')
URDF_PLUS = ('<predecessor link="coupler"><origin xyz=".28 0 0"/></predecessor>'
             '<successor link="rocker"><origin xyz=".24 0 0"/></successor><axis xyz="0 0 1"/>')


def drake(kind, more=""):
    points = "".join(
        f'<drake:{kind}_body_{side} name="{link}"/><drake:{kind}_p_{point} value="{x} 0 0"/>'
        for side, link, point, x in (("A", "coupler", "AP", 0.28), ("B", "rocker", "BQ", 0.24)))
    return f'<drake:{kind} name="pin">{points}{more}</drake:{kind}>'


STATED = {  # element of the table: what is written in the robot
    "loop": f'<loop name="pin" type="continuous">{URDF_PLUS}</loop>',
    "coupling": '<coupling name="pin"><predecessor link="crank"/><successor link="rocker"/>'
                '<ratio value="2"/></coupling>',
    "constraint": f'<constraint name="pin" type="revolute">{OF_CONSTRAINT}</constraint>',
    "loop_constraint": f'<loop_constraint name="pin">{OF_CONSTRAINT}</loop_constraint>',
    "loop_joint": f'<loop_joint name="pin" type="revolute">{LOOP}<axis xyz="0 0 1"/></loop_joint>',
    "ball_constraint": drake("ball_constraint"),
    "distance_constraint": drake("distance_constraint",
                                 '<drake:distance_constraint_distance value=".01"/>'),
    "linear_spring_damper": drake("linear_spring_damper", "".join(
        f'<drake:linear_spring_damper_{key} value="{x}"/>'
        for key, x in (("free_length", 0.1), ("stiffness", 5.0), ("damping", 0.1)))),
    "gazebo": '<gazebo><joint name="pin" type="revolute"><parent>coupler</parent>'
              '<child>rocker</child><pose>.24 0 0 0 0 0</pose><axis><xyz>0 0 1</xyz></axis></joint>'
              '</gazebo>',
    "gazebo plugin": '<gazebo><plugin name="p"><joint>j1</joint><mimicJoint>j3</mimicJoint>'
                     '</plugin></gazebo>',
    "transmission": '<transmission name="t"><joint name="j1"/><actuator name="m">'
                    '<drake:rotor_inertia value=".01"/></actuator></transmission>'
                    f'<loop name="pin" type="continuous">{URDF_PLUS}</loop>',
    "ros2_control": '<ros2_control name="r" type="system"><joint name="j1"><command_interface '
                    'name="position"/></joint><joint name="j3"><param name="mimic">j1</param>'
                    '<param name="multiplier">-1.5</param></joint></ros2_control>',
}
REFUSED = ("linear_bushing_rpy", "tendon_constraint")
ROBOT_YAML = ("closed_loop: [[end_1, end_2]]\ntype: [3d]\nname_mot: [j1]\n"
              "joint_name: [j2]\njoint_type: [SPHERICAL]\n")
LOOP_CLOSURES = ("closures:\n- {link_a: coupler, link_b: rocker, "
                 "point: [0.252, 0.23515101530718507, 0], "
                 "axis: [0, 0, 1]}\nindependent: [j1]\n")


def written(folder, files):
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder / next(iter(files))


def mjcf(folder):
    bodies = ""
    for name, joint, x, length in (("crank", "j1", 0, 0.1), ("rocker", "j3", 0.3, 0.24)):
        inner = (f'<body name="coupler" pos=".1 0 0"><joint name="j2"/>{rod(0.28)}{sites(1, 0.28)}'
                 '</body>' if name == "crank" else sites(2, 0.24))
        bodies += (f'<body name="{name}" pos="{x} 0 0"><joint name="{joint}"/>'
                   f"{rod(length)}{inner}</body>")
    pytest.importorskip("mujoco")
    return written(folder, {"m.xml": (
        f'<mujoco><option gravity="0 -9.81 0"/><worldbody>{bodies}</worldbody><equality>'
        '<connect name="pin" site1="closing_pin_1" site2="closing_pin_2"/>'
        '<connect site1="closing_pin_1_z" site2="closing_pin_2_z"/></equality>'
        '<actuator><motor name="j1" joint="j1"/></actuator></mujoco>')})


def rod(length):
    return f'<geom type="capsule" fromto="0 0 0 {length} 0 0" size=".005"/>'


def sites(side, x):
    return "".join(f'<site name="closing_pin_{side}{end}" pos="{x} 0 {z}" euler="90 0 0"/>'
                   for end, z in (("", 0.0), ("_z", 0.1)))


def sdf(folder):
    frames = ends('<frame name="closing_pin_{side}" attached_to="{link}"><pose>{x} 0 0 0 0 0'
                  '</pose></frame>')
    links, joints = "", ""
    for name, x, y in (("crank", 0.0, 0.0), ("coupler", 0.1, 0.0), ("rocker", 0.3, 0.0),
                       ("closing_bolt_1", 0.2, 0.1), ("closing_bolt_2", 0.3, 0.1)):
        links += (f'<link name="{name}"><pose>{x} {y} 0 0 0 0</pose><inertial><mass>1</mass>'
                  "<inertia><ixx>.1</ixx><iyy>.1</iyy><izz>.1</izz></inertia></inertial></link>")
    for name, parent, child, kind in (
            ("j1", "world", "crank", "revolute"), ("j2", "crank", "coupler", "revolute"),
            ("j3", "world", "rocker", "revolute"), ("pin", "coupler", "rocker", "revolute"),
            ("b1", "coupler", "closing_bolt_1", "ball"),
            ("b2", "rocker", "closing_bolt_2", "ball")):
        at = "-.05 .24 0 0 0 0" if name == "pin" else ""
        joints += (f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><pose>{at}</pose>'
                   f"<child>{child}</child><axis><xyz>0 0 1</xyz></axis></joint>")
    return written(folder, {"m.sdf": f'<sdf version="1.9"><model name="m">{links}{frames}{joints}'
                                     "</model></sdf>"})


def usd(folder):
    pytest.importorskip("pxr")
    path = Path(__file__).resolve().parents[1] / "data" / "usd" / "four_bar.usda"
    return written(folder, {"m.usda": path.read_text().replace("coupler", "closing_pin_1")
                            .replace("rocker", "closing_pin_2")})


def toml(**closure):
    lines = "".join(f"{key} = {value}\n" for key, value in closure.items())
    return (f'name = "m"\ntree = "m.urdf"\n[[closures]]\n{lines}[drivers.crank]\njoint = "j1"\n'
            "[guess]\nj1 = 0.5\nj3 = 0.1\n"
            '[[springs]]\nname = "s"\nframes = ["closing_pin_1", "base"]\nstiffness = 3.0\n')


MATE = {"mates": ["closing_pin"]}
CASES = {  # "importer: what": what writes the file that is loaded
    **{f"urdf: {element}": lambda folder, text=text: written(
        folder, {"m.urdf": urdf(text, ["closedloop1"])}) for element, text in STATED.items()},
    "urdf: closing frames": lambda folder: written(folder, {"m.urdf": urdf(**MATE)}),
    "urdf: closing frames beside a loop": lambda folder: written(
        folder, {"m.urdf": urdf(STATED["loop_joint"], **MATE)}),
    "urdf: closing frames under a mechanism file": lambda folder: written(folder, {
        "m.toml": toml(name='"pin"', type='"revolute"',
                       frames='["closing_pin_2", "closing_pin_1"]'), "m.urdf": urdf(**MATE)}),
    "urdf: closing frames whose loop is of another kind": lambda folder: written(folder, {
        "m.toml": toml(name='"closing_pin"', type='"distance"', length=0.01,
                       frames='["closing_pin_1", "closing_pin_2"]'), "m.urdf": urdf(**MATE)}),
    "sdf": sdf, "usd": usd, "mjcf": mjcf,
    "folder": lambda folder: written(folder, {
        "robot.yaml": ROBOT_YAML, "m.urdf": urdf(mates=["end"])}).parent,
    "statement: robot.yaml": lambda folder: written(
        folder, {"robot.yaml": ROBOT_YAML, "m.urdf": urdf(mates=["end"])}),
    "statement: loop_closures.yaml": lambda folder: written(
        folder, {"loop_closures.yaml": LOOP_CLOSURES, "m.urdf": urdf(**MATE)}),
}


def same_answers(found, expected):
    """Assembled from the files' guesses and let go: the same configuration and reactions."""
    one, two = (sp.assemble(mech) for mech in (found, expected))
    size = expected.characteristic_length
    np.testing.assert_allclose(one.q, two.q, rtol=0.0, atol=1e-12)
    assert sp.mobility(found, one).dof == sp.mobility(expected, two).dof
    here, there = (sp.forward_dynamics(x.mechanism, x) for x in (one, two))
    np.testing.assert_allclose(here.a, there.a, rtol=1e-9, atol=1e-9)
    for key, force in there.reactions.items():
        np.testing.assert_allclose(here.reactions[key].vector, force.vector, rtol=1e-9,
                                   atol=1e-9 * max(1.0, size))
        assert list(here.unique[key]) == list(there.unique[key]), key


def test_every_importer_and_every_way_of_stating_loops_has_a_case():
    assert {name.partition(":")[0] for name in CASES} == IMPORTERS.keys()
    assert {name.split()[0] for name in STATED} | set(REFUSED) == ELEMENTS.keys() | LEFT.keys()
    assert len(BESIDE) == sum(name.startswith("statement") for name in CASES)


@pytest.mark.alike
@pytest.mark.parametrize("name", CASES)
def test_what_was_imported_loads_as_it_was_saved(name, tmp_path):
    mech = sp.load(CASES[name](tmp_path / "source"))
    assert mech.closures or mech.springs
    written(tmp_path / "out", {"robot.yaml": ROBOT_YAML, "loop_closures.yaml": LOOP_CLOSURES})
    again = sp.load(mech.save(tmp_path / "out"))
    same_mechanisms(again, mech)
    same_answers(again, mech)


@pytest.mark.alike
@pytest.mark.parametrize("name", CASES)
def test_and_as_it_was_exported_beside_other_robots_statements(name, tmp_path, run):
    path = CASES[name](tmp_path / "source")
    mech = sp.load(path)
    written(tmp_path / "out", {"robot.yaml": ROBOT_YAML, "loop_closures.yaml": LOOP_CLOSURES})
    assert run("export", path, "--urdf", tmp_path / "out" / "robot.urdf")[0] == 0
    same_mechanisms(sp.load(tmp_path / "out" / "robot.toml"), mech)


def test_an_open_tree_with_closing_frames_is_exported_as_open(tmp_path, run):
    plain = written(tmp_path / "a", {"m.toml": 'name = "m"\ntree = "m.urdf"\ncomplete = true\n',
                                     "m.urdf": urdf(**MATE)})
    mech = sp.load(plain)
    assert not mech.closures and list(mech.drivers) == ["j1", "j2", "j3"]
    assert len(sp.load(plain.with_suffix(".urdf")).closures) == 1
    model = pin.buildModelFromXML(urdf(**MATE))
    for k, tree in enumerate((mech, sp.Mechanism.from_model(model, name="m"))):
        same_mechanisms(sp.load(tree.save(tmp_path / f"saved_{k}")), tree)
    assert run("export", plain, "--urdf", tmp_path / "b.urdf")[0] == 0
    same_mechanisms(sp.load(tmp_path / "b.toml"), mech)


def test_a_mechanism_file_that_is_complete_takes_only_joints_and_frames_of_its_tree(tmp_path):
    pytest.importorskip("mujoco")
    mjcf(tmp_path)
    path = written(tmp_path, {"m.toml": 'name = "m"\ntree = "m.xml"\ncomplete = true\n'})
    mech = sp.load(path)
    assert not mech.closures and mech.coordinates == ("j1", "j2", "j3")
    assert mech.model.gravity.linear == pytest.approx([0.0, -9.81, 0.0])
    path.write_text(path.read_text().replace("true", "false"))
    assert [c.name for c in sp.load(path).closures] == ["pin"]
    path.write_text(path.read_text().replace("false", '"no"'))
    with pytest.raises(sp.MechanismFileError, match="complete must be true or false, not 'no'"):
        sp.load(path)


def test_a_loop_that_is_written_into_a_complete_tree_is_refused_and_not_dropped(tmp_path):
    mech = sp.load(written(tmp_path, {"m.urdf": urdf(**MATE)}))
    path = mech.save(tmp_path / "out")
    tree = path.with_suffix(".urdf")
    tree.write_text(tree.read_text().replace("</robot>", STATED["loop_joint"] + "</robot>"))
    with pytest.raises(sp.MechanismFileError, match=r"<loop_joint name='pin'>: joins the links"):
        sp.load(path)


def test_a_model_of_pinocchio_with_closing_frames_loads_as_it_was_saved(tmp_path):
    model = pin.buildModelFromXML(urdf(**MATE))
    pins = [sp.closures.revolute("closing_pin_1", "closing_pin_2", name="pin")]
    mech = sp.Mechanism.from_model(model, pins, drivers=["j1"], guess={"j1": 0.5, "j3": 0.1})
    again = sp.load(mech.save(tmp_path))
    same_mechanisms(again, mech)
    same_answers(again, mech)


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_every_library_mechanism_gives_the_same_answers_after_it_was_saved(name, tmp_path):
    mech = sp.load(name)
    same_answers(sp.load(mech.save(tmp_path)), mech)
