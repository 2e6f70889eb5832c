"""What a file says is what the mechanism is, and what it must not say is refused by name."""

from __future__ import annotations

import math
import re
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from closed_forms import DIGITS, placement, rotation, vector
from closure_trees import CLOSURE_TYPES, JOINT_TYPES
from folders import ROOT
from mpmath import mp, mpf, sqrt
from variety import each, few

import spatial_pin as sp

LIBRARY = ROOT / "urdf"


def link(name: str, body: str = "") -> str:
    return f'<link name="{name}">{body}</link>'


def joint(name: str, kind: str, parent: str, child: str, body: str = "") -> str:
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/>{body}</joint>')


def robot(*parts: str) -> str:
    return f'<robot name="bench">{"".join(parts)}</robot>'


def axis(*xyz: float) -> str:
    return f'<axis xyz="{" ".join(repr(float(x)) for x in xyz)}"/>'


def origin(xyz: str, rpy: str = "0 0 0") -> str:
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


HEAD = 'name = "bench"\ntree = "bench.urdf"\n'


def joints(**pairs: str) -> str:
    """A mechanism file that says nothing but what pairs some joints are."""
    return HEAD + "".join(f'[joints.{name}]\ntype = "{pair}"\n' for name, pair in pairs.items())


@pytest.fixture
def write(tmp_path):
    """Write a tree, and what a mechanism file says of it; returns the path to load."""

    def write(urdf: str | None, toml: str | None = None, name: str = "bench.urdf") -> Path:
        if urdf is not None:
            (tmp_path / name).write_text(urdf, encoding="utf-8")
        if toml is None:
            return tmp_path / name
        (tmp_path / "bench.toml").write_text(toml, encoding="utf-8")
        return tmp_path / "bench.toml"

    return write


# ---------------------------------------------------------------- the doors


@pytest.mark.parametrize("source", [3, None, ["rssr"]])
def test_what_is_neither_a_name_nor_a_path_is_refused(source):
    with pytest.raises(TypeError, match="by its name or path, not"):
        sp.load(source)


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_a_library_mechanism_is_loaded_by_its_name(name):
    by_name, by_path = sp.load(name), sp.load(LIBRARY / f"{name}.toml")
    assert by_name.name == by_path.name == name
    assert by_name.coordinates == by_path.coordinates
    assert by_name.title and by_name.source
    assert type(by_name.model) is pin.Model


def test_a_tree_alone_is_a_mechanism_without_closures(write):
    tree = sp.load(str(LIBRARY / "four_bar.urdf.xacro"))
    plain = sp.load(write(tree.urdf))
    for mechanism, name in ((tree, "four_bar"), (plain, "bench")):
        assert mechanism.name == name
        assert mechanism.closures == () and mechanism.constraint_models() == []
        state = sp.assemble(mechanism, {"crank_pin": 0.3}, {"rocker_pin": 0.2})
        assert state.closure_error == 0.0
        assert state.q.tolist() == [0.3, 0.0, 0.2]


def test_a_path_is_relative_to_the_working_directory_and_a_tree_to_its_file(
    write, monkeypatch, tmp_path
):
    write(TREE, TOML)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert sp.load("../bench.toml").coordinates == sp.load(tmp_path / "bench.toml").coordinates
    assert sp.load("rssr").name == "rssr"


def test_a_parameter_is_a_dimension():
    for d in (0.314, 0.4):
        state = sp.assemble(sp.load("rssr", d=d), {"crank": 0.0})
        assert state.placement("rocker").translation == pytest.approx([-d, 0, 0], abs=1e-15)
    assert sp.load("rssr", d=np.float64(0.4)).parameters == {"d": 0.4}


ARM = """<robot name="arm" xmlns:xacro="{uri}"><xacro:arg name="reach" default="1"/>
<link name="base"/><link name="hand"/><joint name="slide" type="fixed"><parent link="base"/>
<child link="hand"/><origin xyz="$(arg reach) 0 0"/></joint></robot>"""


@pytest.mark.parametrize("uri", ["http://www.ros.org/wiki/xacro", "http://ros.org/wiki/xacro"])
def test_every_usual_xacro_namespace_has_parameters(write, uri):
    path = write(ARM.format(uri=uri), name="arm.urdf.xacro")
    assert sp.load(path).name == "arm"
    assert sp.load(path, reach=2.5).characteristic_length == 2.5


def test_a_parameter_may_be_declared_in_an_included_file(write):
    write(ARM.format(uri="http://www.ros.org/wiki/xacro"), name="parts.xacro")
    path = write('<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
                 '<xacro:include filename="parts.xacro"/></robot>', name="arm.xacro")
    assert sp.load(path, reach=2.5).characteristic_length == 2.5


def test_an_unknown_parameter_suggests_the_nearest(write):
    with pytest.raises(sp.MechanismFileError, match=r"rssr\.urdf\.xacro.*'dd'.*did you mean 'd'"):
        sp.load("rssr", dd=0.3)
    with pytest.raises(sp.MechanismFileError, match=r"bench\.urdf: .*'d'.*\.xacro"):
        sp.load(write(TREE), d=0.3)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, np.float32("nan")])
def test_a_parameter_that_is_not_finite_is_refused_at_the_door(value):
    with pytest.raises(ValueError, match="'d'"):
        sp.load("rssr", d=value)


# ---------------------------------------------------------------- pairs as joints of the tree

X0 = (0.7, -0.4, 0.5, 0.3, 0.6, -0.8)  # coordinates, their rates and accelerations
X1 = (-1.1, 0.8, 0.6, 0.9, -0.5, 0.4)
X2 = (0.5, 1.3, -0.7, -0.2, 0.3, 1.1)
LEAD = 0.3
SKEW, SQUARE = np.array([2.0, -3.0, 6.0]) / 7, np.array([6.0, -2.0, -3.0]) / 7
AXES = {"skew": (SKEW, SQUARE), "y": (np.eye(3)[1], np.eye(3)[2]),
        "-z": (-np.eye(3)[2], np.eye(3)[0])}
MOUNT = "0.1 -0.2 0.3", "0.4 0.5 -0.6"  # of the joint on its parent, and of the tip on the child
TIP = "0.2 0.5 -0.3", "-0.3 0.2 0.7"
SIX = ("x", "y", "z", "rx", "ry", "rz")
SUFFIXES = {  # DESIGN 3b: the coordinates of each pair, in this order
    "revolute": ("",), "prismatic": ("",), "screw": ("",), "cylindrical": ("angle", "slide"),
    "universal": ("first", "second"), "spherical": ("x", "y", "z"),
    "planar": ("x", "y", "angle"), "floating": SIX, "fixed": (),
}


def turned(about, angle) -> np.ndarray:
    return placement(rotation(about, angle), vector(0, 0, 0))


def moved(*translation) -> np.ndarray:
    return placement(np.eye(3, dtype=int), vector(*translation))


def rotated(*phi) -> np.ndarray:
    angle = sqrt(sum(x * x for x in phi))
    return turned([x / angle for x in phi], angle)


def in_plane(x, y, angle, normal) -> np.ndarray:
    """Slides along the x and y that the shortest rotation of z to the normal makes."""
    n = [mpf(x) for x in normal]
    tilt = (np.diag([mpf(1), mpf(-1), mpf(-1)]) if n[2] == -1 else
            rotation([-n[1] / sqrt(1 - n[2]**2), n[0] / sqrt(1 - n[2]**2), mpf(0)], mp.acos(n[2])))
    return moved(*(tilt @ vector(x, y, 0))) @ turned(n, angle)


PLACEMENTS = {  # pair: placement of the child in the joint's frame, from coordinates and axes
    "revolute": lambda x, u, w: turned(u, x[0]),
    "prismatic": lambda x, u, w: moved(*(x[0] * u)),
    "screw": lambda x, u, w: moved(*(x[0] * LEAD / (2 * mp.pi) * u)) @ turned(u, x[0]),
    "cylindrical": lambda x, u, w: moved(*(x[1] * u)) @ turned(u, x[0]),
    "universal": lambda x, u, w: turned(u, x[0]) @ turned(w, x[1]),
    "spherical": lambda x, u, w: rotated(*x),
    "planar": lambda x, u, w: in_plane(*x, u),
    "floating": lambda x, u, w: moved(*x[:3]) @ rotated(*x[3:]),
    "fixed": lambda x, u, w: moved(0, 0, 0),
}


def refinement(pair: str, u: np.ndarray, w: np.ndarray) -> str:
    lines = [joints(j=pair)]
    if pair not in ("spherical", "floating", "fixed"):
        lines.append(f"axis = {u.tolist()}")
    if pair == "universal":
        lines.append(f"axis2 = {w.tolist()}")
    if pair == "screw":
        lines.append(f"lead = {LEAD}")
    return "\n".join(lines)


def stem(kind: str, body: str = "", mass: str = "") -> str:
    """A child on one joint of the ground, and a tip that is fixed to the child."""
    return robot(link("base", mass), link("child", mass), link("tip"),
                 joint("j", kind, "base", "child", origin(*MOUNT) + body),
                 joint("tip_mount", "fixed", "child", "tip", origin(*TIP)))


def mount(xyz: str, rpy: str) -> np.ndarray:
    return placement(pin.rpy.rpyToMatrix(np.array(rpy.split(), float)), vector(*xyz.split()))


def truth(pair: str, u: np.ndarray, w: np.ndarray, *, outer: bool = True):
    """Placement (4, 4) of the tip, or of the child in its joint, and its two time derivatives."""

    def at(t) -> np.ndarray:
        n = len(SUFFIXES[pair])
        x = [mpf(a) + mpf(b) * t + mpf(c) * t * t / 2 for a, b, c in zip(X0, X1, X2, strict=True)]
        inner = PLACEMENTS[pair](x[:n], vector(*u), vector(*w))
        return mount(*MOUNT) @ inner @ mount(*TIP) if outer else inner

    with mp.workdps(DIGITS):
        h = mpf("1e-12")
        before, now, after = at(-h), at(mpf(0)), at(h)
        return [np.array(M, dtype=float) for M in
                (now, (after - before) / (2 * h), (after - 2 * now + before) / h**2)]


def turning(M, dM, ddM) -> tuple[np.ndarray, np.ndarray]:
    """Angular velocity and acceleration, in the axes that M maps to."""
    R, dR, ddR = (x[:3, :3] for x in (M, dM, ddM))
    return pin.unSkew(dR @ R.T), pin.unSkew(ddR @ R.T + dR @ dR.T)


def moving(mechanism: sp.Mechanism, pair: str, u: np.ndarray, w: np.ndarray) -> sp.State:
    """The state at X0 with the rates X1 and X2, told in Pinocchio's velocities."""
    n = len(SUFFIXES[pair])
    guess = {"j": X0[:n] if n > 1 else X0[0]} if n else {}
    v, a = np.array(X1[:n]), np.array(X2[:n])
    if pair in ("spherical", "floating"):
        M, dM, ddM = truth(pair, u, w, outer=False)
        R = M[:3, :3]
        omega, alpha = (R.T @ x for x in turning(M, dM, ddM))
        slide = R.T @ dM[:3, 3]
        v, a = omega, alpha
        if pair == "floating":
            v = np.concatenate([slide, omega])
            a = np.concatenate([R.T @ ddM[:3, 3] - np.cross(omega, slide), alpha])
    q = sp.assemble(mechanism, {}, guess).q
    return sp.State(mechanism, q, v, a, closure_error=0.0)


def test_every_pair_of_a_tree_has_a_formula_here():
    assert set(PLACEMENTS) == set(SUFFIXES) == set(JOINT_TYPES)


@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("pair", JOINT_TYPES)
def test_a_refined_joint_moves_as_its_pair(write, pair, axes):
    u, w = AXES[axes]
    mechanism = sp.load(write(stem("floating"), refinement(pair, u, w)))
    state = moving(mechanism, pair, u, w)
    M, dM, ddM = truth(pair, u, w)
    omega, alpha = turning(M, dM, ddM)
    close = {"rtol": 0, "atol": 1e-13}
    np.testing.assert_allclose(state.placement("tip").homogeneous, M, **close)
    np.testing.assert_allclose(state.velocity("tip").linear, dM[:3, 3], **close)
    np.testing.assert_allclose(state.velocity("tip").angular, omega, **close)
    np.testing.assert_allclose(state.acceleration("tip").linear, ddM[:3, 3], **close)
    np.testing.assert_allclose(state.acceleration("tip").angular, alpha, **close)
    for k, name in enumerate(mechanism.coordinates):
        assert state.coordinate(name) == pytest.approx((X0[k], X1[k], X2[k]), abs=1e-13)


@pytest.mark.parametrize("pair", JOINT_TYPES)
def test_coordinates_are_named_after_joint_and_freedom(write, pair):
    mechanism = sp.load(write(stem("floating"), refinement(pair, SKEW, SQUARE)))
    assert mechanism.coordinates == tuple(f"j.{s}" if s else "j" for s in SUFFIXES[pair])
    assert mechanism.model.nv == len(SUFFIXES[pair])


@pytest.mark.parametrize(("kind", "pair"), [
    ("revolute", "revolute"), ("continuous", "revolute"), ("prismatic", "prismatic"),
    ("planar", "planar"), ("floating", "floating"), ("fixed", "fixed"),
])
def test_a_joint_that_urdf_can_name_needs_no_refinement(write, kind, pair):
    limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    mechanism = sp.load(write(stem(kind, axis(*SKEW) + limit)))
    state = moving(mechanism, pair, SKEW, SQUARE)
    expected = truth(pair, SKEW, SQUARE)[0]
    np.testing.assert_allclose(state.placement("tip").homogeneous, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("kind", "tag", "toml", "about"), [
    ("continuous", "", HEAD, (1, 0, 0)),
    ("continuous", axis(0, 3, 4), HEAD, (0, 0.6, 0.8)),
    ("continuous", axis(0, 1, 0), joints(j="revolute"), (0, 1, 0)),
    ("floating", "", joints(j="revolute"), (0, 0, 1)),
    ("floating", axis(0, 1, 0), joints(j="revolute"), (0, 1, 0)),
    ("floating", axis(0, 1, 0), joints(j="revolute") + "axis = [0, 0, -1]", (0, 0, -1)),
    ("floating", "", joints(j="universal"), (1, 0, 0)),
    ("floating", "", joints(j="revolute") + "axis = [0.333, 0.667, 0.667]", (0.333, 0.667, 0.667)),
])
def test_the_axis_is_the_mechanism_files_else_the_urdfs_else_the_default(
    write, kind, tag, toml, about
):
    mechanism = sp.load(write(stem(kind, tag), toml))
    state = sp.assemble(mechanism, {mechanism.coordinates[0]: 0.3})
    turn = mount(*MOUNT)[:3, :3].T.astype(float) @ state.placement("child").rotation
    expected = pin.exp3(0.3 * np.array(about) / np.linalg.norm(about))
    np.testing.assert_allclose(turn, expected, rtol=0, atol=1e-14)


def test_a_joint_named_again_in_a_transmission_keeps_its_axis(write):
    transmission = '<transmission name="t"><joint name="j"/><actuator name="m"/></transmission>'
    tree = stem("continuous", axis(0, 1, 0)).replace("</robot>", f"{transmission}</robot>")
    state = sp.assemble(sp.load(write(tree)), {"j": 0.3})
    turn = mount(*MOUNT)[:3, :3].T.astype(float) @ state.placement("child").rotation
    np.testing.assert_allclose(turn, pin.exp3(np.array([0, 0.3, 0])), rtol=0, atol=1e-14)


def test_a_continuous_joint_is_one_coordinate_that_counts_turns(write):
    mechanism = sp.load(write(stem("continuous", axis(0, 1, 0))))
    assert mechanism.model.nq == mechanism.model.nv == 1
    for state in (sp.assemble(mechanism, {"j": 30.0}), sp.assemble(mechanism, {}, {"j": 30.0})):
        assert state.coordinate("j").value == 30.0
    values = np.linspace(0.0, 30.0, 7)
    assert sp.sweep(mechanism, "j", values).coordinate("j").value.tolist() == values.tolist()


def test_coordinates_come_in_the_order_of_the_velocity(write):
    tree = robot(*map(link, "gabcd"), joint("zz", "floating", "g", "a"),
                 joint("mm", "continuous", "a", "b", axis(0, 0, 1)),
                 joint("pp", "floating", "a", "c"), joint("aa", "floating", "g", "d"))
    mechanism = sp.load(write(tree, joints(zz="universal", pp="spherical", aa="cylindrical")))
    table = mechanism.coordinate_table
    assert tuple(table) == mechanism.coordinates and len(table) == 8
    assert [c.v for c in table.values()] == list(range(8))
    q, nothing = sp.assemble(mechanism).q, np.zeros(8)
    for name, v in zip(table, np.eye(8), strict=True):
        state = sp.State(mechanism, q, v, nothing, closure_error=0.0)
        assert [state.coordinate(x).rate for x in table] == v.tolist(), name


# ---------------------------------------------------------------- what survives the rebuilding

INERTIAL = ('<inertial><origin xyz="0.1 0.2 0.3" rpy="0.3 0.2 0.1"/><mass value="2"/>'
            '<inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="0.003" izz="0.04"/>'
            "</inertial>")
FREE = '<limit lower="-9" upper="9" effort="9" velocity="9"/>'


class Chain(NamedTuple):
    """Joints that plain URDF has, in series, and their velocities per velocity of the pair."""

    joints: tuple[tuple[str, tuple], ...]
    rates: np.ndarray


def chain(*joints: tuple[str, tuple]) -> Chain:
    return Chain(joints, np.eye(len(joints)))


U, W = tuple(SKEW), tuple(SQUARE)
EQUIVALENT = {
    "revolute": chain(("revolute", U)),
    "prismatic": chain(("prismatic", U)),
    "screw": Chain((("revolute", U), ("prismatic", U)), np.array([[1.0], [LEAD / (2 * np.pi)]])),
    "cylindrical": chain(("revolute", U), ("prismatic", U)),
    "universal": chain(("revolute", U), ("revolute", W)),
    "planar": chain(("prismatic", (1, 0, 0)), ("prismatic", (0, 1, 0)), ("revolute", (0, 0, 1))),
    "spherical": Chain((("floating", U),), np.eye(6)[:, 3:]),
    "floating": Chain((("floating", U),), np.eye(6)),
    "fixed": Chain((), np.zeros((0, 0))),
}


def weighed_stem(kinds: tuple[tuple[str, tuple], ...]) -> str:
    """A ground, a child on a series of joints, and an arm on the child; all have mass."""
    links = ["base", *(f"massless_{k}" for k in range(len(kinds) - 1)), "child"]
    kinds = kinds or (("fixed", U),)
    series = [joint(f"j{k}", kind, links[k], links[k + 1],
                    axis(*u) + FREE + (origin(*MOUNT) if k == 0 else ""))
              for k, (kind, u) in enumerate(kinds)]
    return robot(*(link(x, "" if x.startswith("massless") else INERTIAL) for x in links),
                 link("arm", INERTIAL), link("tip", INERTIAL), *series,
                 joint("elbow", "revolute", "child", "arm", origin(*TIP) + axis(0, 1, 0) + FREE),
                 joint("tip_mount", "fixed", "arm", "tip", origin(*MOUNT)))


@pytest.mark.parametrize("pair", JOINT_TYPES)
def test_a_refined_joint_carries_the_inertia_of_the_same_joints_in_series(write, pair):
    u, w = (np.eye(3)[2], np.eye(3)[0]) if pair == "planar" else (SKEW, SQUARE)
    series = EQUIVALENT[pair]
    toml = refinement(pair, u, w).replace("[joints.j]", "[joints.j0]")
    mechanism = sp.load(write(weighed_stem((("floating", U),)), toml))
    model = pin.buildModelFromXML(weighed_stem(series.joints))
    n = len(SUFFIXES[pair])
    guess = {"j0": X0[:n] if n > 1 else X0[0]} if n else {}
    state = sp.assemble(mechanism, {"elbow": 0.4}, guess)
    rates = np.zeros((model.nv, n + 1))
    rates[:-1, :-1], rates[-1, -1] = series.rates, 1.0
    q = pin.neutral(model)
    if pair in ("spherical", "floating"):
        q[:-1] = np.concatenate([np.zeros(7 - len(state.q[:-1])), state.q[:-1]])
    else:
        q[:-1] = series.rates @ X0[:n]
    q[-1] = 0.4
    data, expected = mechanism.model.createData(), model.createData()
    M = pin.crba(mechanism.model, data, state.q, pin.Convention.WORLD)
    N = pin.crba(model, expected, q, pin.Convention.WORLD)
    M, N = (np.triu(x) + np.triu(x, 1).T for x in (M, N))
    np.testing.assert_allclose(M, rates.T @ N @ rates, rtol=0, atol=1e-13)
    np.testing.assert_allclose(pin.centerOfMass(mechanism.model, data, state.q),
                               pin.centerOfMass(model, expected, q), rtol=0, atol=1e-14)
    moving = 4.0 if pair == "fixed" else 6.0
    assert pin.computeTotalMass(mechanism.model) == pin.computeTotalMass(model) == moving
    assert mechanism.inertias["arm"].mass == 2.0
    assert mechanism.inertias["arm"].lever.tolist() == [0.1, 0.2, 0.3]


LIMIT = '<limit lower="-1" upper="2" effort="3" velocity="4"/>'
DYNAMICS = '<dynamics damping="0.5" friction="0.25"/>'


@pytest.mark.parametrize(("kind", "pair", "lower", "upper"), [
    ("revolute", "", [-1], [2]),
    ("prismatic", "", [-1], [2]),
    ("continuous", "", [-np.inf], [np.inf]),
    ("floating", "revolute", [-1], [2]),
    ("floating", "cylindrical", [-np.inf] * 2, [np.inf] * 2),
])
def test_limits_friction_and_damping_are_those_of_the_urdf(write, kind, pair, lower, upper):
    toml = joints(j=pair) if pair else HEAD
    model = sp.load(write(stem(kind, axis(0, 1, 0) + LIMIT + DYNAMICS), toml)).model
    assert model.lowerPositionLimit.tolist() == lower
    assert model.upperPositionLimit.tolist() == upper
    for values, expected in (
        (model.lowerEffortLimit, -3), (model.upperEffortLimit, 3),
        (model.lowerVelocityLimit, -4), (model.upperVelocityLimit, 4),
        (model.lowerDryFrictionLimit, -0.25), (model.upperDryFrictionLimit, 0.25),
        (model.damping, 0.5), (model.rotorInertia, 0), (model.rotorGearRatio, 1),
        (model.armature, 0),
    ):
        assert values.tolist() == [expected] * model.nv


def test_frames_stay_where_pinocchio_puts_them(write):
    tree = weighed_stem((("revolute", U), ("floating", U)))
    ours, plain = sp.load(write(tree)).model, pin.buildModelFromXML(tree)
    assert ours.gravity.linear.tolist() == [0, 0, -9.81]
    assert len(ours.frames) == len(plain.frames)
    for frame, expected in zip(ours.frames, plain.frames, strict=True):
        for attribute in ("name", "type", "parentJoint", "parentFrame", "placement"):
            assert getattr(frame, attribute) == getattr(expected, attribute), frame.name
        assert frame.inertia.isApprox(expected.inertia, 1e-15), frame.name


SHAPES = ('<visual><origin xyz="1 2 3" rpy="0.1 0.2 0.3"/><geometry><box size="1 2 3"/></geometry>'
          '<material name="{0}"><color rgba="{0} 0.5 0.25 1"/></material></visual>'
          '<collision><origin xyz="3 2 1"/><geometry><sphere radius="{0}"/></geometry></collision>')


def test_geometry_stays_on_its_joint_with_its_placement_and_colour(write):
    tree = robot(*(link(name, SHAPES.format(0.125 * k)) for k, name in enumerate("gabc", start=1)),
                 joint("j1", "floating", "g", "a", origin(*MOUNT)),
                 joint("j2", "continuous", "a", "b"),
                 joint("j3", "fixed", "b", "c", origin(*TIP)))
    mechanism = sp.load(write(tree, joints(j1="universal")))
    plain = pin.buildModelFromXML(tree)
    kinds = pin.GeometryType.VISUAL, pin.GeometryType.COLLISION
    for ours, kind in zip((mechanism.visual_model, mechanism.collision_model), kinds, strict=True):
        expected = pin.buildGeomFromUrdfString(plain, tree, kind)
        assert len(ours.geometryObjects) == len(expected.geometryObjects) == 4
        for shape, other in zip(ours.geometryObjects, expected.geometryObjects, strict=True):
            assert shape.name == other.name
            assert shape.parentJoint == other.parentJoint and shape.placement == other.placement
            assert mechanism.model.frames[shape.parentFrame].name == shape.name[0]
            assert shape.meshColor.tolist() == other.meshColor.tolist()
    colours = [shape.meshColor[0] for shape in mechanism.visual_model.geometryObjects]
    assert colours == [0.125, 0.25, 0.375, 0.5]


# ---------------------------------------------------------------- what the file adds


def test_a_mimicking_joint_is_a_coupling(write):
    limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    tree = robot(*map(link, "gab"), joint("finger", "revolute", "g", "a", axis(0, 0, 1) + limit),
                 joint("thumb", "revolute", "g", "b", axis(0, 0, 1) + limit
                       + '<mimic joint="finger" multiplier="-2" offset="0.5"/>'))
    mechanism = sp.load(write(tree))
    (closure,) = mechanism.closures
    assert (closure.type, closure.joints) == ("coupling", ("finger", "thumb"))
    assert (closure.ratio, closure.offset) == (-2.0, 0.5)
    assert mechanism.coordinates == ("finger", "thumb")
    state = sp.assemble(mechanism, {"finger": 0.3})
    state = sp.solve_rates(mechanism, state, {"finger": 3.0}, {"finger": 5.0})
    assert state.coordinate("thumb") == pytest.approx((-0.1, -6.0, -10.0), abs=1e-14)


def test_the_characteristic_length_is_the_longest_distance_of_two_frames_at_neutral(write):
    mass = INERTIAL.replace("0.1 0.2 0.3", "70 80 90")
    box = '<visual><origin xyz="50 0 0"/><geometry><box size="9 9 9"/></geometry></visual>'
    tree = robot(link("g", box), link("a", mass), link("b"), link("mark"),
                 joint("j", "continuous", "g", "a", origin("1 0 0") + axis(0, 0, 1)),
                 joint("k", "floating", "a", "b", origin("0 2 0", "0 0 1.5707963267948966")),
                 joint("m", "fixed", "g", "mark", origin("0 0 -3")))
    mechanism = sp.load(write(tree, joints(k="spherical")))
    assert mechanism.characteristic_length == pytest.approx(math.sqrt(1 + 4 + 9), rel=1e-15)


def test_the_characteristic_length_is_a_metre_where_all_frames_are_at_one_point(write):
    tree = robot(link("g"), link("a"), joint("j", "floating", "g", "a"))
    assert sp.load(write(tree, joints(j="spherical"))).characteristic_length == 1.0


TWINS = robot(*map(link, "gabcdef"), joint("j", "floating", "g", "a", origin("0 0 1")),
              joint("k", "floating", "g", "b", origin("0 1 0")),
              joint("e_pin", "continuous", "g", "e"), joint("f_pin", "continuous", "g", "f"),
              joint("c_mount", "fixed", "a", "c", origin(*MOUNT)),
              joint("d_mount", "fixed", "b", "d", origin(*TIP)))
EXTRA = {"screw": "lead = 0.1", "distance": "length = 0.5", "rope": "length = 0.5",
         "frame_on_curve": 'curve = "c"\n[curves.c]\nhelix = {radius = 0.5, lead = 0.1}',
         "curve_on_curve": 'curves = ["c", "c"]\n[curves.c]\ncircle = {radius = 0.5}',
         "point_on_curve": 'curve = "c"\n[curves.c]\ncircle = {radius = 0.5}',
         "cam": 'curve = "c"\nfollower = {knife = true}\n[curves.c]\ncircle = {radius = 0.5}'}


def twins(kind: str) -> str:
    ends = 'joints = ["e_pin", "f_pin"]' if kind == "coupling" else 'frames = ["c", "d"]'
    return HEAD + f'[[closures]]\nname = "joint"\ntype = "{kind}"\n{ends}\n{EXTRA.get(kind, "")}\n'


@pytest.mark.parametrize("kind", CLOSURE_TYPES)
def test_pinocchios_own_closures_are_the_ball_and_the_weld_and_no_other(write, kind):
    mechanism = sp.load(write(TWINS, twins(kind)))
    if kind not in ("spherical", "weld", "fixed"):
        with pytest.raises(sp.ClosureTypeError, match=f"'joint' is {kind}"):
            mechanism.constraint_models()
        return
    (native,) = mechanism.constraint_models()
    assert native.name == "joint"
    assert native.type == (pin.ContactType.CONTACT_3D if kind == "spherical"
                           else pin.ContactType.CONTACT_6D)
    state = sp.assemble(mechanism)
    model, data, contact = mechanism.model, mechanism.model.createData(), native.createData()
    pin.computeAllTerms(model, data, state.q, state.v)
    contact.oMc1 = data.oMi[native.joint1_id] * native.joint1_placement
    contact.oMc2 = data.oMi[native.joint2_id] * native.joint2_placement
    gap = contact.c1Mc2 = contact.oMc1.actInv(contact.oMc2)
    jacobian = pin.getConstraintJacobian(model, data, native, contact)
    assert np.linalg.norm(gap.translation) < 1e-13
    assert kind == "spherical" or np.linalg.norm(pin.log3(gap.rotation)) < 1e-13
    spaces = (np.linalg.svd(x)[2][: len(jacobian)]
              for x in (jacobian, sp.closure_jacobian(mechanism, state.q)))
    ours, theirs = (x.T @ x for x in spaces)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)


def test_springs_passive_freedoms_drivers_and_gravity_are_read(write):
    mechanism = sp.load(write(TREE, TOML))
    assert (mechanism.name, mechanism.title, mechanism.source) == ("bench", "A bench", "nowhere")
    assert mechanism.model.gravity.linear.tolist() == [0.0, -9.81, 0.0]
    assert {d.name: d.joint for d in mechanism.drivers.values()} == {"motor": "pin"}
    assert mechanism.guess == {"pin": 0.25, "ball": [0.0, 0.1, 0.2]}
    rod, coil = mechanism.springs
    assert (rod.frames, rod.joint) == (("rod_tip", "mark"), None)
    assert (rod.stiffness, rod.damping, rod.free_length) == (4530.0, 2.0, 0.07785)
    assert (coil.frames, coil.joint, coil.stiffness, coil.free_angle) == ((), "hinge", 3.0, 0.5)
    (spin,) = mechanism.passives
    assert (spin.name, spin.body, spin.axis) == ("rod_spin", "rod", ("ball", "rod_tip"))


# ---------------------------------------------------------------- meshes

TRIANGLE = (bytes(80) + struct.pack("<I", 1)
            + struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0))


def meshed(file: str) -> str:
    shape = (f'<visual><origin xyz="1 2 3"/><geometry><mesh filename="{file}" scale="2 2 2"/>'
             "</geometry></visual>")
    return robot(link("g", shape + '<visual><geometry><sphere radius="1"/></geometry></visual>'))


@pytest.mark.parametrize("file", [
    "part.stl", "./part.stl", "meshes/part.obj", "{folder}/part.stl", "file://{folder}/part.stl",
    "package://{name}/part.stl", "package://{name}/meshes/part.obj", "package://elsewhere/part.stl",
])
def test_a_mesh_is_found_from_the_file_and_in_packages(write, tmp_path, monkeypatch, file):
    (tmp_path / "part.stl").write_bytes(TRIANGLE)
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    packages = tmp_path / "packages"
    (packages / "elsewhere").mkdir(parents=True)
    (packages / "elsewhere" / "part.stl").write_bytes(TRIANGLE)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(packages))
    monkeypatch.chdir(packages)
    path = write(meshed(file.format(folder=tmp_path, name=tmp_path.name)))
    mesh, _ = sp.load(path).visual_model.geometryObjects
    assert Path(mesh.meshPath).is_file()
    assert mesh.placement.translation.tolist() == [1, 2, 3]
    assert mesh.meshScale.tolist() == [2, 2, 2]


@pytest.mark.parametrize("file", ["gone.stl", "package://gone/part.stl", ""])
def test_a_mesh_that_is_not_found_is_a_warning_and_the_rest_is_drawn(write, file):
    path = write(meshed(file))
    with pytest.warns(UserWarning, match=rf"bench\.urdf: link 'g': mesh '{file}'"):
        mechanism = sp.load(path)
    (sphere,) = mechanism.visual_model.geometryObjects
    assert sphere.geometry.radius == 1.0


# ---------------------------------------------------------------- what is refused

HINGE_LIMIT = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
TREE = f"""<robot name="bench">
<link name="base"><visual><origin xyz="0 0 0"/><geometry><box size="1 1 1"/></geometry></visual>
</link>
<link name="crank">{INERTIAL}</link><link name="rod"/><link name="rocker"/>
<link name="mark"/><link name="rod_tip"/><link name="rocker_tip"/>
<joint name="pin" type="continuous"><parent link="base"/><child link="crank"/>
  <origin xyz="0 0 0.5" rpy="0 0 0"/><axis xyz="0 1 0"/></joint>
<joint name="ball" type="floating"><parent link="crank"/><child link="rod"/>
  <origin xyz="0.1 0 0"/></joint>
<joint name="hinge" type="revolute"><parent link="base"/><child link="rocker"/>
  <origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>{HINGE_LIMIT}</joint>
<joint name="mark_mount" type="fixed"><parent link="base"/><child link="mark"/></joint>
<joint name="rod_mount" type="fixed"><parent link="rod"/><child link="rod_tip"/>
  <origin xyz="0.6 0 0"/></joint>
<joint name="rocker_mount" type="fixed"><parent link="rocker"/><child link="rocker_tip"/>
  <origin xyz="0.2 0 0"/></joint>
<!--end-->
</robot>
"""
CLOSURE = 'type = "spherical"\nframes = ["rod_tip", "rocker_tip"]\n'
TOML = f"""name = "bench"
title = "A bench"
source = "nowhere"
tree = "bench.urdf"
gravity = [0.0, -9.81, 0.0]
[joints.ball]
type = "spherical"
# joint
[[closures]]
name = "end_ball"
{CLOSURE}
[drivers.motor]
joint = "pin"
[[springs]]
name = "return"
frames = ["rod_tip", "mark"]
stiffness = 4530.0
damping = 2.0
free_length = 0.07785
[[springs]]
name = "coil"
joint = "hinge"
stiffness = 3.0
free_angle = 0.5
[passive.rod_spin]
body = "rod"
axis = ["ball", "rod_tip"]
[guess]
pin = 0.25
ball = [0.0, 0.1, 0.2]
# end
"""


class Bad(NamedTuple):
    """A change to the good files above, and what the complaint must say (patterns, in order)."""

    old: str
    new: str
    says: tuple[str, ...]


def bad(old: str, new: str, *says: str) -> Bad:
    return Bad(old, new, says)


def closure(kind: str, *lines: str, frames: str = '["rod_tip", "rocker_tip"]') -> str:
    return "\n".join([f'type = "{kind}"', f"frames = {frames}", *lines]) + "\n"


REFUSED = {
    # XML and structure
    "XML that does not parse": bad("</robot>", "", "not well-formed XML", "line"),
    "another XML": bad('<robot name="bench">', "<sdf>", "XML"),
    "two links of one name": bad("<!--end-->", link("rod"), "two links are named 'rod'"),
    "two joints of one name": bad(
        "<!--end-->", link("x") + joint("pin", "fixed", "base", "x"),
        "two joints are named 'pin'"),
    "joint with Pinocchio's own name": bad('joint name="pin"', 'joint name="universe"',
                                           "a joint is named 'universe'", "rename it"),
    "line break in a joint's name": bad(
        'joint name="pin"', 'joint name="a&#10;b"', "joint is named 'a.nb'"),
    "no-break space in a link's name": bad(
        'link name="mark"', 'link name="a&#160;b"', "link is named 'a.xa0b'"),
    "text turned round in a link's name": bad(
        'link name="mark"', 'link name="a&#8238;b"', "link is named 'a.u202eb'"),
    "link without a name": bad('<link name="mark"/>', "<link/>", "<link> has no name"),
    "parent that does not exist": bad(
        '<parent link="crank"/>', '<parent link="cranc"/>', "'ball'", "parent link 'cranc'",
        "did you mean 'crank'"),
    "joint without a child": bad('<child link="rod"/>', "", "'ball'", "child"),
    "joint type that URDF does not know": bad(
        'type="continuous"', 'type="hinge"', "'pin'", "no joint type 'hinge'"),
    "pair as a URDF type": bad(
        'type="floating"', 'type="spherical"', "'ball'", "'spherical'", "floating"),
    # numbers in the URDF
    "NaN in an origin": bad('xyz="0 0 0.5"', 'xyz="0 nan 0.5"', "'pin'", "origin", "0 nan 0.5"),
    "infinite angle": bad('rpy="0 0 0"', 'rpy="inf 0 0"', "'pin'", "origin", "inf"),
    "two numbers for a point": bad('xyz="0.3 0 0"', 'xyz="0.3 0"', "'hinge'", "3 finite numbers"),
    "NaN in a visual's origin": bad('xyz="0 0 0"/><geo', 'xyz="0 0 nan"/><geo', "'base'", "origin"),
    "NaN in a shape": bad('size="1 1 1"', 'size="1 1 nan"', "'base'", "size"),
    "shape with too few numbers": bad('size="1 1 1"', 'size="1 1"', "'base'", "size"),
    "NaN in a mass": bad('value="2"', 'value="nan"', "'crank'", "mass", "nan"),
    "mass as Python writes numbers": bad('value="2"', 'value="1_0"', "'crank'", "mass", "1_0"),
    "mass in digits of another script": bad('value="2"', 'value="\uff12"', "'crank'", "mass"),
    "offset as Python writes numbers": bad('xyz="0 0 0.5"', 'xyz="0 0 1_0"', "'pin'", "1_0"),
    "mass that is text": bad('value="2"', 'value="2 kg"', "'crank'", "mass", "2 kg"),
    "NaN in an inertia": bad('ixy="0.001"', 'ixy="nan"', "'crank'", "ixy", "nan"),
    "NaN in an axis": bad('<axis xyz="0 1 0"/>', '<axis xyz="0 nan 0"/>', "'pin'", "axis"),
    "zero axis in the URDF": bad('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "'pin'", "axis"),
    "NaN in a limit": bad('lower="-3"', 'lower="nan"', "'hinge'", "limit", "lower"),
    "infinite limit": bad('lower="-3"', 'lower="-inf"', "'hinge'", "limit", "lower"),
    "negative effort": bad('effort="1"', 'effort="-1"', "'hinge'", "effort"),
    "mimic with NaN": bad(HINGE_LIMIT, HINGE_LIMIT + '<mimic joint="pin" multiplier="nan"/>',
                          "'hinge'", "mimic", "multiplier"),
    # keys and their types
    "TOML that does not parse": bad('title = "A', "title = A", "not valid TOML", "line 2"),
    "unknown key": bad("title =", "tilte =", "tilte", "did you mean 'title'"),
    "misspelt required key": bad("name =", "nmae =", "name is missing", "'nmae'"),
    "no tree": bad('tree = "bench.urdf"', "", "tree is missing"),
    "tree that is not there": bad(
        '"bench.urdf"', '"gone.urdf"', r"bench\.toml", "tree", r"gone\.urdf", "no such file"),
    "tree that is a folder": bad('"bench.urdf"', '"."', r"bench\.toml", "tree"),
    "number for text": bad('"A bench"', "7", "title", "text", "7"),
    "text for a number": bad("4530.0", '"hard"', r"springs\[0\]", "stiffness", "number", "'hard'"),
    "bool for a number": bad("4530.0", "true", "stiffness", "number", "True"),
    "number beyond float": bad("4530.0", "9" * 400, "stiffness", "finite"),
    "NaN in a number": bad("4530.0", "nan", "stiffness", "finite"),
    "negative stiffness": bad("4530.0", "-1.0", "stiffness", "-1"),
    "NaN in a vector": bad("-9.81", "nan", "gravity", "finite"),
    "two numbers for a vector": bad("[0.0, -9.81, 0.0]", "[0.0, -9.81]", "gravity", "three"),
    "list for a table": bad("[guess]", "[[guess]]", "guess", "table"),
    "closures written as a table": bad("[[closures]]", "[closures]", r"\[\[closures\]\]"),
    # joints
    "refinement of a joint that does not exist": bad(
        "[joints.ball]", "[joints.bal]", r"joints\.bal", "did you mean 'ball'"),
    "refinement that the URDF type does not contain": bad(
        "# joint", '[joints.pin]\ntype = "spherical"', "'pin'", "continuous", "spherical",
        "floating"),
    "unknown pair": bad('type = "spherical"\n# joint', 'type = "sperical"', r"joints\.ball", "type",
                        "did you mean 'spherical'"),
    "screw joint without lead": bad('type = "spherical"\n# joint', 'type = "screw"',
                                    r"joints\.ball", "lead is missing"),
    "screw joint of lead 0": bad('type = "spherical"\n# joint', 'type = "screw"\nlead = 0.0',
                                 r"joints\.ball", "lead is 0", "revolute"),
    "axis of a ball": bad("# joint", "axis = [0, 0, 1]", r"joints\.ball", "axis"),
    "pins of a universal joint that are not square": bad(
        'type = "spherical"\n# joint', 'type = "universal"\naxis = [0, 1, 0]', "joints.ball",
        "perpendicular"),
    # closures
    "unknown closure": bad(CLOSURE, closure("sphericle"), r"closures\[0\]", "'end_ball'", "type",
                           "did you mean 'spherical'"),
    "frame that does not exist": bad(
        '"rocker_tip"]', '"rocket_tip"]', "'end_ball'", "'rocket_tip'",
        "did you mean 'rocker_tip'"),
    "closure of a frame with itself": bad(
        CLOSURE, closure("spherical", frames='["mark", "mark"]'), "'end_ball'", "'mark'", "itself"),
    "closure within a body": bad(
        CLOSURE, closure("spherical", frames='["rod", "rod_tip"]'), "'end_ball'", "same body"),
    "closure within the ground": bad(
        CLOSURE, closure("spherical", frames='["base", "mark"]'), "'end_ball'", "same body"),
    "closure of one frame": bad(
        CLOSURE, closure("spherical", frames='["rod_tip"]'), "'end_ball'", "frames", "two names"),
    "zero axis": bad(CLOSURE, closure("revolute", "axis = [0, 0, 0]"), "'end_ball'", "axis",
                     "unit vector"),
    "axis that is no unit vector": bad(CLOSURE, closure("revolute", "axis = [0, 0, 2]"),
                                       "'end_ball'", "axis", "unit vector"),
    "NaN in a closure's axis": bad(CLOSURE, closure("revolute", "axis = [0, 0, nan]"),
                                   "'end_ball'", "axis", "finite"),
    "negative length": bad(CLOSURE, closure("distance", "length = -0.1"), "'end_ball'", "length",
                           "positive"),
    "zero length": bad(CLOSURE, closure("distance", "length = 0"), "'end_ball'", "length",
                       "spherical"),
    "no length": bad(CLOSURE, closure("distance"), "'end_ball'", "length is missing"),
    "screw closure of lead 0": bad(CLOSURE, closure("screw", "lead = 0"), "'end_ball'", "lead is 0",
                                   "revolute"),
    "screw without lead": bad(CLOSURE, closure("screw"), "'end_ball'", "lead is missing"),
    "NaN for a lead": bad(CLOSURE, closure("screw", "lead = nan"), "'end_ball'", "lead", "finite"),
    "length of a ball": bad(CLOSURE, CLOSURE + "length = 1.0\n", "'end_ball'", "length"),
    "coupling of nothing": bad(CLOSURE, 'type = "coupling"\njoints = ["pin", "pin"]\n',
                               "'end_ball'", "'pin'", "itself"),
    "coupling of a ball": bad(CLOSURE, 'type = "coupling"\njoints = ["pin", "ball.x"]\n',
                              "'end_ball'", "'ball.x'"),
    "coupling of ratio zero": bad(CLOSURE, 'type = "coupling"\njoints = ["pin", "hinge"]\n'
                                  "ratio = 0\n", "'end_ball'", "ratio"),
    "two closures of one name": bad("[drivers.motor]", '[[closures]]\nname = "end_ball"\n'
                                    + CLOSURE + "[drivers.motor]", "closures", "'end_ball'"),
    # drivers
    "driver of a joint that does not exist": bad(
        'joint = "pin"', 'joint = "pim"', r"drivers\.motor", "'pim'", "did you mean 'pin'"),
    "driver of itself": bad('joint = "pin"', 'joint = "motor"', r"drivers\.motor", "'motor'"),
    "driver of a ball": bad('joint = "pin"', 'joint = "ball"', r"drivers\.motor", "'ball'",
                            "spherical"),
    "driver of a whole ball": bad('joint = "pin"', 'joint = "ball"', r"drivers\.motor",
                                  "'ball'", "several coordinates"),
    "driver without a table": bad('[drivers.motor]\njoint = "pin"', '[drivers]\nmotor = "pin"',
                                  r"drivers\.motor", "table"),
    "two drivers of one coordinate": bad(
        'joint = "pin"', 'joint = "pin"\n[drivers.engine]\njoint = "pin"', "drivers", "'pin'"),
    "driver with the name of another coordinate": bad(
        "[drivers.motor]", "[drivers.hinge]", r"drivers\.hinge", "'pin'"),
    # springs and passive freedoms
    "spring with joint and frames": bad('joint = "hinge"', 'joint = "hinge"\nframes = ["a", "b"]',
                                        r"springs\[1\]", "frames", "joint"),
    "spring about a turning joint with a length": bad(
        "free_angle = 0.5", "free_length = 0.5", "'coil'", "'hinge' turns", "free_angle"),
    "spring with a length and an angle": bad(
        "free_angle = 0.5", "free_angle = 0.5\nfree_length = 0.5", r"springs\[1\]", "free_length"),
    "spring with neither": bad('joint = "hinge"', "", r"springs\[1\]", "frames", "joint"),
    "spring about a joint that does not exist": bad(
        'joint = "hinge"', 'joint = "hinges"', "'coil'", "did you mean 'hinge'"),
    "spring on a frame that does not exist": bad('"mark"]', '"marc"]', "'return'", "'marc'",
                                                 "did you mean 'mark'"),
    "spring within a body": bad('["rod_tip", "mark"]', '["base", "mark"]', "'return'", "same body"),
    "passive freedom of the ground": bad('body = "rod"', 'body = "mark"', r"passive\.rod_spin",
                                         "'mark'", "ground"),
    "passive axis off the body": bad('["ball", "rod_tip"]', '["ball", "mark"]',
                                     r"passive\.rod_spin", "axis", "'mark'", "body"),
    "passive axis of no length": bad('["ball", "rod_tip"]', '["ball", "rod"]',
                                     r"passive\.rod_spin", "axis", "same point"),
    "passive body that does not exist": bad('body = "rod"', 'body = "rode"', r"passive\.rod_spin",
                                            "'rode'", "did you mean 'rod'"),
    # guess
    "guess of an unknown joint": bad("pin = 0.25", "pim = 0.25", "guess", "'pim'",
                                     "did you mean 'pin'"),
    "guess with too few numbers": bad("[0.0, 0.1, 0.2]", "[0.0, 0.1]", "guess", "'ball'",
                                       r"give \[x, y, z\]"),
    "guess of one number for a ball": bad("[0.0, 0.1, 0.2]", "0.1", "guess", "'ball'",
                                          r"give \[x, y, z\]"),
    "guess of a list for a pin": bad("pin = 0.25", "pin = [0.25]", "guess", "'pin'"),
    "guess of NaN": bad("pin = 0.25", "pin = nan", "guess", "'pin'", "NaN"),
    "guess of NaN in a list": bad("[0.0, 0.1, 0.2]", "[0.0, nan, 0.2]", "guess", "'ball'", "NaN"),
    "guess that is text": bad("pin = 0.25", 'pin = "left"', "guess", "'pin'", "'left'"),
    "guess that is text in a list": bad("[0.0, 0.1, 0.2]", '[0.0, "left", 0.2]', "guess", "'ball'"),
    "guess that is true": bad("pin = 0.25", "pin = true", "guess", "'pin'", "True"),
    "guess that is true in a list": bad("[0.0, 0.1, 0.2]", "[true, 0.1, 0.2]", "guess", "'ball'"),
    "guess that is a table": bad("ball = [0.0, 0.1, 0.2]", "ball = {x = 0.1}", "guess", "'ball'"),
    "guess that is a date": bad("pin = 0.25", "pin = 2024-01-01", "guess", "'pin'"),
}


def test_the_files_that_the_refused_ones_are_made_from_are_good(write):
    sp.assemble(sp.load(write(TREE, TOML)))


@pytest.mark.parametrize("case", REFUSED)
def test_refused(write, capfd, case):
    old, new, says = REFUSED[case]
    in_toml = old in TOML
    assert in_toml or TREE.count(old) >= 1, "the case changes nothing"
    path = write(TREE if in_toml else TREE.replace(old, new, 1),
                 TOML.replace(old, new, 1) if in_toml else TOML)
    with pytest.raises(sp.MechanismFileError) as refusal:
        sp.load(path)
    text = str(refusal.value)
    assert re.search(r"bench\.(toml|urdf)", text), text
    for pattern in says:
        assert re.search(pattern, text), text
    assert "\n" not in text
    assert capfd.readouterr() == ("", "")  # neither does the URDF reader print of its own


@pytest.mark.parametrize("kind", ["continuous", "planar", "prismatic"])
@pytest.mark.parametrize("size", [1e-9, 1e160, 1.7e308])
def test_an_axis_of_any_size_has_its_direction(write, kind, size):
    def loaded(x: float):
        turning = joint("j", kind, "a", "b", axis(0.0, x, x) + HINGE_LIMIT)
        return sp.load(write(robot(link("a"), link("b"), turning))).model

    one, large = loaded(1.0), loaded(size)
    q = np.full(one.nq, 0.3)
    for model in (one, large):
        model.data = model.createData()
        pin.framesForwardKinematics(model, model.data, q)
    assert np.abs(one.data.oMf[-1].homogeneous - large.data.oMf[-1].homogeneous).max() < 1e-15
    assert not one.data.oMf[-1].isIdentity(1e-2)


@pytest.mark.parametrize("kind", few(["fixed", "continuous"], "continuous"))
def test_a_chain_that_ends_readers_of_urdf_is_read(write, kind):
    def chain(n: int) -> str:
        return robot(link("l0"), *(link(f"l{k + 1}") + joint(f"j{k}", kind, f"l{k}", f"l{k + 1}")
                                   for k in range(n)))

    assert sp.load(write(chain(2000))).model.nframes == 4002


@pytest.mark.parametrize(("name", "content"), [
    ("bench.urdf", b""), ("bench.toml", b""), ("bench.urdf.xacro", b""), ("bench.urdf", b"\0\xff"),
    ("bench.urdf", b'<robot name="\xe9"/>'), ("bench.toml", b'name = "\xe9"'),
    ("bench.urdf.xacro", b'<robot name="\xe9"/>'), ("bench.urdf", None), ("bench.toml", None),
])
def test_a_file_that_is_empty_or_not_utf8_or_a_folder_is_refused_by_name(tmp_path, name, content):
    path = tmp_path / name
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    with pytest.raises(sp.MechanismFileError, match=re.escape(name)):
        sp.load(path)


@pytest.mark.parametrize(("source", "says"), [
    ("rsrr", "did you mean 'rssr'"), ("", "four_bar"), ("gone.toml", "gone.toml: no such file"),
    ("gone.urdf", "gone.urdf: no such file"), ("robot.step", r"\.toml, \.urdf"),
])
def test_a_source_that_is_nowhere_says_where_it_was_sought(source, says):
    with pytest.raises(sp.MechanismFileError, match=says):
        sp.load(source)


def test_a_xacro_that_cannot_be_expanded_says_why(write):
    path = write(ARM.format(uri="http://www.ros.org/wiki/xacro").replace("$(arg reach)", "${1/0}"),
                 name="arm.xacro")
    with pytest.raises(sp.MechanismFileError, match=r"arm\.xacro: .*division by zero") as refusal:
        sp.load(path)
    assert "\n" not in str(refusal.value)


def test_an_inertia_that_violates_the_triangle_inequality_is_a_warning(write):
    path = write(TREE.replace('izz="0.04"', 'izz="0.09"'))
    with pytest.warns(UserWarning, match=r"bench\.urdf: link 'crank'.*moments of inertia"):
        assert sp.load(path).inertias["crank"].mass == 2.0


@pytest.mark.parametrize("pair", ["prismatic", "revolute"])
def test_a_planar_joint_contains_slides_in_its_plane_and_turns_about_its_normal(write, pair):
    tree = stem("planar", axis(0, 0, 1))
    inside, outside = ("[1, 0, 0]", "[0, 0, 1]")[:: 1 if pair == "prismatic" else -1]
    toml = joints(j=pair) + "axis = "
    assert sp.load(write(tree, toml + inside)).coordinates == ("j",)
    with pytest.raises(sp.MechanismFileError, match=r"joints.j is planar"):
        sp.load(write(tree, toml + outside))


def test_an_empty_folder_is_refused_in_words(tmp_path):
    with pytest.raises(sp.MechanismFileError, match="there is no URDF in this folder"):
        sp.load(tmp_path)


def test_a_library_mechanism_that_is_loaded_again_is_another_one_of_the_same_numbers():
    one, other, changed = sp.load("delta"), sp.load("delta"), sp.load("delta", sb=0.6)
    assert one is not other and one.model is not other.model and one.urdf == other.urdf
    assert changed.urdf != one.urdf and sp.load("delta").urdf == one.urdf
    with pytest.raises(sp.MechanismFileError, match="no parameter 'sb2'"):
        sp.load("delta", sb2=0.6)


@pytest.mark.parametrize("name, text", [
    ("arm.xml", '<mujoco><worldbody><body name="b"><joint type="hinge"/><geom size="0.1"/></body>'
                "</worldbody></mujoco>"),
    ("arm.urdf", '<robot name="arm"><link name="b"/></robot>'),
    ("arm.sdf", '<sdf version="1.9"><model name="arm"><link name="b"/></model></sdf>')])
def test_a_file_without_arguments_takes_no_parameters(name, text, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(sp.MechanismFileError, match=rf"{name}: parameters \['d'\] given, but only"):
        sp.load(tmp_path / name, d=0.3)
