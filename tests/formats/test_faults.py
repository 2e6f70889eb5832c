"""Faults that real files have are told in one warning, and the robot moves all the same."""

from __future__ import annotations

import copy
import math
import pickle
import sys
import warnings
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp

LIMIT = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
INERTIA = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.04"/>'


def inertial(mass: float = 2.0, inertia: str = INERTIA, more: str = "") -> str:
    return f'<inertial><origin xyz="0.1 0 0"/><mass value="{mass}"/>{inertia}{more}</inertial>'


def moments(x: float, y: float, z: float) -> str:
    return f'<inertia ixx="{x}" ixy="0" ixz="0" iyy="{y}" iyz="0" izz="{z}"/>'


def link(name: str, inside: str = "") -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, kind: str, parent: str, child: str, inside: str = "") -> str:
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="1 0 0"/>{inside}</joint>')


def arm(hand: str = "", more: str = "", tip: str = "") -> str:
    """Two turning links and a tip on the second, a metre each."""
    axis = '<axis xyz="0 0 1"/>'
    return (link("base") + link("upper", inertial()) + link("hand", hand or inertial())
            + link("tip", tip) + joint("shoulder", "continuous", "base", "upper", axis)
            + joint("elbow", "revolute", "upper", "hand", axis + LIMIT)
            + joint("mount", "fixed", "hand", "tip") + more)


@pytest.fixture
def load(tmp_path):
    def load(inside: str, head: str = '<robot name="arm">', **given) -> sp.Mechanism:
        path = tmp_path / "arm.urdf"
        path.write_text(f"{head}{inside}</robot>", encoding="utf-8")
        return sp.load(path, **given)

    return load


@pytest.fixture
def told(load):
    """Load with one warning; give the mechanism and what was told."""

    def told(*args: str, **given) -> tuple[sp.Mechanism, str]:
        with pytest.warns(sp.SpatialPinWarning) as caught:
            mechanism = load(*args, **given)
        (warning,) = caught
        text = str(warning.message)
        assert "\n" not in text and "arm.urdf: " in text
        return mechanism, text.partition("arm.urdf: ")[2]

    return told


def place(mechanism: sp.Mechanism, **values: float) -> list[float]:
    """Where the tip is."""
    state = sp.assemble(mechanism, values)
    return state.placement("tip").translation.round(12).tolist()


# ---------------------------------------------------------------- inertias


@pytest.mark.parametrize("hand", [
    inertial(-2.0), inertial(2.0, moments(0.02, -0.03, 0.04)), inertial(2.0, moments(-1, -1, -1)),
])
def test_a_body_below_zero_moves_but_has_no_forces(told, tmp_path, hand):
    mechanism, text = told(arm(hand))
    assert "link 'hand'" in text and "below zero" in text
    assert place(mechanism, elbow=math.pi / 2) == [2, 1, 0]
    state = sp.assemble(mechanism)
    assert sp.solve_rates(mechanism, state, {"elbow": 1.0, "shoulder": 0.0}).v.tolist() == [0, 1]
    drive = {"actuated": ["shoulder", "elbow"]}
    for verb in (lambda: sp.inverse_dynamics(mechanism, state, **drive),
                 lambda: sp.forward_dynamics(mechanism, state),
                 lambda: sp.simulate(mechanism, state, 0.1),
                 lambda: sp.export_mjcf(mechanism, tmp_path / "arm.xml")):
        with pytest.raises(sp.SpatialPinError, match=r"link 'hand' .*below zero.*<inertial>"):
            verb()


@pytest.mark.parametrize("least", [-1e-20, -0.03])
@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
def test_a_body_below_zero_is_copied_sent_and_saved(load, tmp_path, least):
    mechanism = load(arm(inertial(2.0, moments(least, 0.03, 0.03))))
    saved = mechanism.save(tmp_path / "saved")
    for other in (copy.deepcopy(mechanism), pickle.loads(pickle.dumps(mechanism)), sp.load(saved)):
        assert other.model == mechanism.model and other.inertias == mechanism.inertias
        assert other.notices == mechanism.notices


@pytest.mark.parametrize("tree", [
    arm(inertial(2.0, moments(-1e-17, 0.03, 0.03))),  # by round-off
    arm(inertial(0.5, moments(-2e-35, 0.0, 2e-35))),  # of a mass at a point
    arm(tip=inertial(1e-3, moments(-3.5e-8, 1e-6, 1e-6))),  # of a link fixed to a larger one
    arm(tip=inertial(-1e-3, moments(0.0, 0.0, 0.0))),  # a hole in a larger body
    arm(tip=inertial(1e-6, moments(0.0, 0.0, 3e-6))),
    link("root", inertial(1.0, moments(-1.0, 1.0, 1.0))) + arm()
    + joint("floor", "fixed", "root", "base"),  # of what does not move
])
def test_an_inertia_is_judged_of_the_whole_body_and_by_its_size(load, tree):
    mechanism = load(tree)
    assert mechanism.notices == ()
    plain = pin.buildModelFromXML(f'<robot name="arm">{tree}</robot>')
    for ours, other in zip(mechanism.model.inertias, plain.inertias, strict=True):
        assert ours.mass == pytest.approx(other.mass, rel=1e-15)
    state = sp.assemble(mechanism)
    assert np.all(np.isfinite(sp.forward_dynamics(mechanism, state).a))


def test_a_body_that_cannot_be_has_forces_and_a_warning(told):
    mechanism, text = told(arm(inertial(2.0, moments(0.01, 0.01, 0.04))))
    assert "link 'hand'" in text and "moments of inertia" in text
    assert np.all(np.isfinite(sp.forward_dynamics(mechanism, sp.assemble(mechanism)).a))


@pytest.mark.parametrize(("hand", "missing", "mass", "moment"), [
    ('<inertial><mass value="2"/></inertial>', "ixx ixy ixz iyy iyz izz", 2, 0),
    (f"<inertial>{INERTIA}</inertial>", "mass", 0, 0.04),
    (inertial(2.0, '<inertia ixx="1" iyy="1" izz="1"/>'), "ixy ixz iyz", 2, 1),
])
def test_what_is_missing_of_an_inertial_counts_as_zero(
    told, capfd, hand, missing, mass, moment
):
    mechanism, text = told(arm(hand))
    assert text == f"link 'hand': {missing}: of <inertial> missing, counts as 0"
    body = mechanism.model.inertias[2]
    assert (body.mass, body.inertia[2, 2]) == (mass, moment)
    assert capfd.readouterr() == ("", "")


# ---------------------------------------------------------------- joints and links


MIMIC = '<mimic joint="{}" multiplier="2"/>'


@pytest.mark.parametrize(("kind", "source", "says"), [
    ("fixed", "elbow", "fixed, its <mimic> has no effect"),
    ("revolute", "elbw", "does not exist, moves on its own"),
    ("revolute", "mount", "mimics a fixed joint"),
    ("revolute", "finger", "or itself"),
    ("revolute", "", "does not exist"),
])
def test_a_mimic_of_nothing_that_moves_is_reported(told, kind, source, says):
    finger = link("finger") + joint("finger", kind, "hand", "finger",
                                    LIMIT + MIMIC.format(source))
    mechanism, text = told(arm(more=finger))
    assert "joint 'finger'" in text and says in text
    assert mechanism.closures == ()
    assert place(mechanism, elbow=math.pi / 2) == [2, 1, 0]


def test_several_trees_stand_on_one_ground(told):
    second = link("other") + link("wheel") + joint("axle", "continuous", "other", "wheel")
    mechanism, text = told(arm(more=second + link("loose")))
    assert text == ("link 'base', link 'other', link 'loose': no parent, fixed to the ground at "
                    "its origin")
    assert set(mechanism.coordinates) == {"shoulder", "elbow", "axle"}
    assert {"base", "other", "loose"} <= set(mechanism.links)
    assert sp.assemble(mechanism).placement("wheel").translation.tolist() == [1, 0, 0]


def test_several_trees_beside_a_world_are_fixed_to_it(told):
    mechanism, text = told(arm(more=link("world") + link("table")
                                   + joint("legs", "fixed", "world", "table")))
    assert text.startswith("link 'base': no parent")
    assert sp.assemble(mechanism).placement("table").translation.tolist() == [1, 0, 0]


def test_limits_in_the_wrong_order_are_none(told):
    mechanism, text = told(arm().replace('lower="-3" upper="3"', 'lower="1" upper="-1"'))
    assert text == "joint 'elbow': lower limit above the upper one, counts as no limit"
    at = mechanism.coordinate("elbow").q
    assert mechanism.model.lowerPositionLimit[at] == -math.inf
    assert mechanism.model.upperPositionLimit[at] == math.inf


def test_numbers_of_no_size_are_read_without_a_word(load, capfd):
    tree = arm(inertial(2.0, moments(1e-310, 0.03, 0.03)))
    tree = tree.replace('xyz="1 0 0"', 'xyz="1 1e-320 0"')
    assert place(load(tree), elbow=math.pi / 2) == [2, 1, 0]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("head", [
    '\n <?xml version="1.0"?><robot name="arm">', '<robot name="arm" xmlns="http://drake.mit.edu">',
    '<robot name="arm"><xacro:property name="a" value="1"/>', "<robot>",
    '<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arm/>',
    '<robot name="arm"><material name="red"><color rgba="1 0 0 1"/></material>',
])
def test_what_other_readers_shrug_at_is_read_without_a_word(load, head):
    mechanism = load(arm().replace('<joint name="mount" type="fixed">',
                                   '<joint name="mount" type="fixed"><axis xzy="0 0 1"/>'), head)
    assert place(mechanism, elbow=math.pi / 2) == [2, 1, 0]


# ---------------------------------------------------------------- shapes


def visuals(*shapes: str, more: str = "") -> str:
    return link("base", "".join(f"<visual><geometry>{x}</geometry>{more}</visual>" for x in shapes))


def test_a_capsule_stands_beside_other_shapes(load):
    mechanism = load(visuals('<box size="1 2 3"/>', '<capsule radius="0.1" length="0.4"/>',
                             '<sphere radius="1"/>'))
    kinds = [type(x.geometry) for x in mechanism.visual_model.geometryObjects]
    assert kinds == [coal.Box, coal.Capsule, coal.Sphere]
    capsule = mechanism.visual_model.geometryObjects[1].geometry
    assert (capsule.radius, capsule.halfLength) == (0.1, 0.2)


def test_shapes_of_no_known_kind_are_omitted(told):
    mechanism, text = told(visuals('<plane normal="0 0 1"/>', '<sphere radius="1"/>', ""))
    assert text.startswith("a <visual> of link 'base': none of box, sphere")
    assert [x.name for x in mechanism.visual_model.geometryObjects] == ["base_0"]


@pytest.mark.parametrize(("scale", "means"), [
    ("2", [2, 2, 2]), ("1 2 3 1", [1, 2, 3]), (" 1  2 3 ", [1, 2, 3])])
def test_scales_of_one_number_and_of_four_are_read(load, tmp_path, scale, means):
    (tmp_path / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    mechanism = load(visuals(f'<mesh filename="part.obj" scale="{scale}"/>'))
    (shape,) = mechanism.visual_model.geometryObjects
    assert shape.meshScale.tolist() == means


@pytest.mark.parametrize(("head", "inside", "colours"), [
    ("", ['name="x"'], [None]),
    ('<material name="x"><color rgba="1 0 0 1"/></material>', ['name="x"'], [[1, 0, 0, 1]]),
    ('<material name="x"><color rgba="1 0 0 1"/></material>', ["", 'name="y"'], [None, None]),
    ("", ['name="x"><color rgba="0 1 0 1"/', 'name="x"'], [[0, 1, 0, 1]] * 2),
    ('<material name="x"/>', ['name="x"'], [None]),
])
def test_a_material_is_what_its_name_says_anywhere_in_the_file(load, head, inside, colours):
    shapes = "".join(
        visuals('<sphere radius="1"/>', more=(f"<material {x}></material>" if x.endswith("/")
                                             else f"<material {x}/>") if x else ""
                ).replace("base", f"l{k}") for k, x in enumerate(inside))
    fixed = "".join(joint(f"j{k}", "fixed", "l0", f"l{k}") for k in range(1, len(inside)))
    found = load(head + shapes + fixed).visual_model.geometryObjects
    assert [x.meshColor.tolist() if x.overrideMaterial else None for x in found] == colours


@pytest.mark.parametrize(("hand", "tip", "more", "says"), [
    (inertial(2.0) + inertial(5.0), "", "", "link 'hand': <inertial>"),
    (inertial(2.0, more="<mass value='5'/>"), "", "", "link 'hand': <mass>"),
    ("", "<visual><origin/><origin xyz='1 0 0'/><geometry><sphere radius='1'/></geometry></visual>",
     "", "link 'tip': <origin>"),
    ("", "", link("end") + joint("last", "continuous", "tip", "end",
                                 "<mimic joint='elbow'/><mimic joint='shoulder'/>"),
     "joint 'last': <mimic>"),
])
def test_of_what_is_stated_twice_the_first_counts(told, hand, tip, more, says):
    mechanism, text = told(arm(hand, more, tip))
    assert text == f"{says}: stated more than once, the first counts"
    assert mechanism.inertias["hand"].mass == 2.0
    assert [c.joints[0] for c in mechanism.closures] == ["elbow"] * len(mechanism.closures)


def test_of_two_materials_of_one_name_the_first_counts(told):
    twice = '<material name="x"><color rgba="{} 0 0 1"/></material>'
    mechanism, text = told(twice.format(1) + twice.format(0)
                           + visuals('<sphere radius="1"/>', more='<material name="x"/>'))
    assert text == "material 'x': given more than once, the first counts"
    (shape,) = mechanism.visual_model.geometryObjects
    assert shape.meshColor.tolist() == [1, 0, 0, 1]


# ---------------------------------------------------------------- what is told


def test_many_faults_are_one_warning_and_all_are_noted(told, run, tmp_path):
    meshes = visuals(*(f'<mesh filename="package://hall/part_{k}.stl"/>' for k in range(40)))
    tree = arm(inertial(2.0, moments(0.01, 0.01, 0.04))).replace(link("base"), meshes)
    mechanism, text = told(tree)
    assert text.startswith("(1) link 'base': mesh 'package://hall/part_0.stl', ")
    assert " and 37 more: not found, left out of pictures; " in text
    assert "load(..., packages={'hall': FOLDER})" in text and "(2) link 'hand'" in text
    assert len(mechanism.notices) == 2 and "part_39.stl" in mechanism.notices[0]
    assert mechanism.visual_model.ngeoms == 0  # without another word
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        code, out, _ = run("check", tmp_path / "arm.urdf")
    assert code == 0
    assert [line for line in out.splitlines() if line.startswith("note: ")][:2] == [
        f"note: {notice}" for notice in mechanism.notices]


def test_a_package_lies_where_the_caller_says(load, tmp_path, run):
    hall = tmp_path / "somewhere" / "else"
    hall.mkdir(parents=True)
    (hall / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    tree = visuals('<mesh filename="package://hall/part.obj"/>')
    for folder in (hall, str(hall)):
        mechanism = load(tree, packages={"hall": folder})
        assert mechanism.notices == () and mechanism.visual_model.ngeoms == 1
    code, out, err = run("check", tmp_path / "arm.urdf", "--package", f"hall={hall}")
    assert code == 0 and "not found" not in out + err
    with pytest.raises(sp.MechanismFileError, match=r"'hall'.*no folder.*nowhere"):
        load(tree, packages={"hall": tmp_path / "nowhere"})
    with pytest.raises(TypeError, match="packages"):
        load(tree, packages=[hall])


PLACES = {
    "ROS_PACKAGE_PATH": "hall", "AMENT_PREFIX_PATH": "share/hall",
    "an installed package": "cmeel.prefix/share/hall",
}


@pytest.mark.parametrize("how", PLACES)
def test_a_package_is_found_where_packages_are_installed(load, tmp_path, monkeypatch, how):
    root = tmp_path / "installed"
    folder = root / PLACES[how] / "meshes"
    folder.mkdir(parents=True)
    (folder / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    if how in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.setenv(how, str(root))
    else:
        monkeypatch.syspath_prepend(root)
    for scheme in ("package://", "package:///", "model://"):
        mechanism = load(visuals(f'<mesh filename="{scheme}hall/meshes/part.obj"/>'))
        assert mechanism.notices == () and mechanism.visual_model.ngeoms == 1


def test_a_mesh_lies_beside_the_urdf_of_a_folder(tmp_path):
    (tmp_path / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    tree = arm().replace(link("base"), visuals('<mesh filename="package:///part.obj"/>'))
    (tmp_path / "robot.urdf").write_text(f'<robot name="arm">{tree}</robot>', encoding="utf-8")
    (tmp_path / "robot.yaml").write_text("name_mot: [elbow]\n", encoding="utf-8")
    assert sp.load(tmp_path).visual_model.ngeoms == 1


def test_a_package_that_the_caller_names_holds_xacro_files_too(tmp_path):
    hall = tmp_path / "somewhere"
    hall.mkdir()
    space = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
    (hall / "parts.xacro").write_text(f'<robot {space}><link name="base"/></robot>')
    path = tmp_path / "user" / "deep" / "arm.xacro"
    path.parent.mkdir(parents=True)
    path.write_text(f'<robot name="arm" {space}><xacro:arg name="d" default="1"/>'
                    '<xacro:include filename="$(find hall)/parts.xacro"/></robot>')
    mechanism = sp.load(path, packages={"hall": hall}, d=2.0)
    assert mechanism.links == ("base",) and mechanism.dimensions == {"d": 2.0}


# ---------------------------------------------------------------- robots of example-robot-data


def robots() -> list[Path]:
    roots = (Path(p) / "cmeel.prefix/share/example-robot-data/robots" for p in sys.path)
    return sorted(path for root in roots if root.is_dir() for path in root.rglob("*.urdf"))


@pytest.mark.skipif(not robots(), reason="example-robot-data is not installed")
@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.slow)])
def test_every_robot_stands_where_pinocchio_puts_it(step):
    """All but ur3.urdf, which has no link: Pinocchio refuses it too. By default one in seven."""
    rng, refused, chosen = np.random.default_rng(0), [], robots()[::step]
    for path in chosen:
        try:
            mechanism = sp.load(path)
        except sp.MechanismFileError:
            refused.append(path.name)
            continue
        plain = pin.buildModelFromUrdf(str(path))
        model = mechanism.model
        names = [(f.name, f.type) for f in plain.frames]
        frames = [k for k, f in enumerate(model.frames) if (f.name, f.type) in names]
        assert [(model.frames[k].name, model.frames[k].type) for k in frames] == names, path.name
        for ours, other in zip(model.inertias, plain.inertias, strict=True):
            assert ours.mass == pytest.approx(other.mass, rel=1e-14)
        for size in (0.0, 3.0):
            q, same = size * rng.uniform(-1.0, 1.0, model.nv), []
            for joint, at in zip(list(plain.joints)[1:], list(model.idx_vs)[1:], strict=True):
                same += [q[at]] if joint.nq == 1 else [math.cos(q[at]), math.sin(q[at])]
            data, expected = model.createData(), plain.createData()
            pin.framesForwardKinematics(model, data, q)
            pin.framesForwardKinematics(plain, expected, np.array(same))
            assert [data.oMf[k] for k in frames] == list(expected.oMf), path.name
    assert refused == [path.name for path in chosen if path.name == "ur3.urdf"]
    assert len(chosen) > 4
