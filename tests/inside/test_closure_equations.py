"""Every closure type: its value, Jacobian, bias, rank and roots, against independent evaluations.

The values are written here a second time, from the relative placement M = oM1^-1 oM2 alone, and
derivatives are central differences of eighth order.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pinocchio as pin
import pytest
from closure_oracle import Evaluation
from closure_trees import (
    FIRST,
    JOINTS,
    KEYS,
    LEAD,
    LENGTH,
    PLACES,
    STEP,
    TYPES,
    along,
    check_derivatives,
    evaluate,
    pose,
    relative,
    somewhere,
    tree_with,
    two_bodies,
)
from mechanisms import closure, coupling, floating, load, point, refine, turning
from variety import paired

import spatial_pin as sp
from spatial_pin.constraints.compiled_equations import Constraints
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.pairs import PAIRS


@pytest.fixture(autouse=True)
def _the_same_numbers_in_any_order():
    pin.seed(1)


every_type = pytest.mark.parametrize("kind", TYPES)
by_formula = pytest.mark.parametrize(  # a curve's value is zero on it, and any off it
    "kind", [kind for kind in TYPES if not {"curve", "curves"} & KEYS.get(kind, {}).keys()])


# ---------------------------------------------------------------- the truth


def rows_of(kind: str, M: pin.SE3, scale: float) -> list[float]:
    """The closure equations with z as axis (universal: x in frame 1, y in frame 2)."""
    R, p = M.rotation, M.translation * scale
    coincident, on_line, on_plane = list(p), [p[0], p[1]], [p[2]]
    parallel, oriented = [R[0, 2], R[1, 2]], [R[0, 1], R[1, 2], R[2, 0]]
    if kind == "distance":
        return [(M.translation @ M.translation - LENGTH**2) / (2 * LENGTH) * scale]
    if kind == "rope":
        return [(np.linalg.norm(M.translation) - LENGTH) * scale]
    if kind == "screw":
        slide = LEAD / (2 * np.pi) * np.arctan2(R[1, 0], R[0, 0])
        return [*on_line, *parallel, (M.translation[2] - slide) * scale]
    return {
        "revolute": coincident + parallel,
        "prismatic": on_line + oriented,
        "cylindrical": on_line + parallel,
        "universal": [-p[2], p[1], p[0], R[0, 1]],  # the pair's z is pin 1
        "spherical": coincident,
        "planar": on_plane + parallel,
        "weld": coincident + oriented,
        "fixed": coincident + oriented,
        "point_on_line": on_line,
        "point_on_plane": on_plane,
        "parallel": parallel,
        "perpendicular": [R[2, 2]],
    }[kind]


def about(axis: str, angle: float) -> np.ndarray:
    return pin.exp3(angle * np.eye(3)["xyz".index(axis)])


def placed_in(kind: str, rng: np.random.Generator) -> pin.SE3:
    """A relative placement that the pair allows."""
    a, b, s, t = rng.uniform(-2.0, 2.0, 4)
    anywhere, random = pin.SE3.Random().rotation, rng.uniform(-1.0, 1.0, 3)
    turned, eye, zero = about("z", a), np.eye(3), np.zeros(3)
    ellipse = np.array([0.3 * np.cos(a), 0.2 * np.sin(a), 0.0])
    normal = np.array([0.2 * np.cos(a), 0.3 * np.sin(a), 0.0])
    roller = ellipse + 0.02 * normal / np.linalg.norm(normal)
    return pin.SE3(*{
        "revolute": (turned, zero),
        "prismatic": (eye, np.array([0, 0, s])),
        "screw": (turned, np.array([0, 0, LEAD * a / (2 * np.pi)])),
        "cylindrical": (turned, np.array([0, 0, s])),
        "universal": (about("x", a) @ about("y", b), zero),
        "spherical": (anywhere, zero),
        "planar": (turned, np.array([s, t, 0])),
        "weld": (eye, zero),
        "fixed": (eye, zero),
        "distance": (anywhere, LENGTH * random / np.linalg.norm(random)),
        "rope": (anywhere, LENGTH * random / np.linalg.norm(random)),
        "point_on_curve": (anywhere, ellipse),
        "cam": (anywhere, roller + np.array([0.0, 0.0, s])),
        "frame_on_curve": (pin.Quaternion.FromTwoVectors(np.eye(3)[2], np.array(
            [-0.3 * np.sin(a), 0.2 * np.cos(a), 0.0])).matrix() @ about("z", b), ellipse),
        "curve_on_curve": (about("z", np.pi), 2.0 * ellipse),
        "point_on_line": (anywhere, np.array([0, 0, s])),
        "point_on_plane": (anywhere, np.array([s, t, 0])),
        "parallel": (turned, random),
        "perpendicular": (turned @ about("x", np.pi / 2) @ about("z", b), random),
    }[kind])


# ---------------------------------------------------------------- mechanisms


def at_relative(mechanism: sp.Mechanism, M: pin.SE3, rng: np.random.Generator) -> np.ndarray:
    """A configuration of `two_bodies` with a anywhere and b at M from it."""
    a = pin.SE3(pin.exp3(rng.uniform(-1, 1, 3)), rng.uniform(-1, 1, 3))
    b = mechanism.model.jointPlacements[2].actInv(a * M)
    return np.concatenate([pin.SE3ToXYZQUAT(a), pin.SE3ToXYZQUAT(b)])


def settle(evaluation: LoopEquations, q: np.ndarray) -> None:
    """Make screw closures count their turns from q."""
    evaluation.update(q)
    evaluation.angle_reference[:] = evaluation.angles


# ---------------------------------------------------------------- value, Jacobian, bias


@by_formula
@pytest.mark.parametrize("frames", [("left", "leaf"), ("leaf", "left"), ("leaf", "right")],
                         ids=["child of child", "child to parent", "two branches"])
def test_value_is_that_of_the_relative_placement(tmp_path, kind, frames):
    mechanism, rng = tree_with(tmp_path, "floating", frames, kind, 1)
    evaluation = Evaluation(Constraints(mechanism))
    for _ in range(20):
        q = somewhere(mechanism, rng)
        expected = rows_of(kind, relative(mechanism, q), 1 / mechanism.characteristic_length)
        np.testing.assert_allclose(evaluate(evaluation, q), expected, rtol=2e-15, atol=2e-15)


@every_type
def test_value_with_another_axis_is_that_of_turned_frames(tmp_path, kind):
    pair = PAIRS[kind]
    if not pair.uses_axis:
        pytest.skip("has no axis")
    n = np.array([0.48, -0.6, 0.64])
    n2 = np.array([0.6, 0.0, 0.8]) if pair.uses_axis2 else n
    keys = {"axis": n} | ({"axis2": n2} if pair.uses_axis2 else {})
    mechanism, rng = tree_with(tmp_path, "floating", ("leaf", "right"), kind, 2, **keys)
    evaluation = LoopEquations(mechanism)
    scale = 1 / mechanism.characteristic_length
    for _ in range(10):
        q = somewhere(mechanism, rng)
        M = relative(mechanism, q)
        value, p, turned = evaluate(evaluation, q), M.translation * scale, M.rotation @ n2
        across = p - (n @ p) * n
        expected = {  # sizes that do not depend on the directions normal to the axis
            "revolute": [p @ p, np.sum(np.cross(n, turned) ** 2)],
            "cylindrical": [across @ across, np.sum(np.cross(n, turned) ** 2)],
            "screw": [across @ across, np.sum(np.cross(n, turned) ** 2)],
            "prismatic": [across @ across],
            "universal": [p @ p, (n @ turned) ** 2],
            "planar": [(n @ p) ** 2, np.sum(np.cross(n, turned) ** 2)],
            "point_on_line": [across @ across],
            "point_on_plane": [(n @ p) ** 2],
            "parallel": [np.sum(np.cross(n, turned) ** 2)],
            "perpendicular": [(n @ turned) ** 2],
        }[kind]
        sizes = {"revolute": (3, 2), "cylindrical": (2, 2), "screw": (2, 2), "prismatic": (2,),
                 "universal": (3, 1), "planar": (1, 2), "point_on_line": (2,),
                 "point_on_plane": (1,), "parallel": (2,), "perpendicular": (1,)}[kind]
        starts = np.cumsum([0, *sizes])
        for start, size, square in zip(starts, sizes, expected, strict=False):
            assert np.sum(value[start : start + size] ** 2) == pytest.approx(square, rel=1e-13,
                                                                             abs=1e-14)


@pytest.mark.parametrize(("kind", "joint"), paired(  # profiles whose planes are askew touch nowhere
    [kind for kind in TYPES if kind != "curve_on_curve"], JOINTS))
@pytest.mark.parametrize("frames", [("left", "leaf"), ("leaf", "right")],
                         ids=["child of child", "two branches"])
def test_jacobian_and_bias_are_derivatives(tmp_path, kind, joint, frames):
    mechanism, rng = tree_with(tmp_path, joint, frames, kind, 3)
    evaluation = LoopEquations(mechanism)
    for _ in range(2):
        q = somewhere(mechanism, rng)
        v = rng.uniform(-1.0, 1.0, mechanism.model.nv)
        settle(evaluation, q)
        check_derivatives(evaluation, q, v)


@every_type
def test_every_jacobian_column_is_a_derivative(tmp_path, kind):
    mechanism, rng = tree_with(tmp_path, "universal", ("leaf", "right"), kind, 4)
    evaluation = LoopEquations(mechanism)
    q = somewhere(mechanism, rng)
    settle(evaluation, q)
    expected = np.array([FIRST @ along(evaluation, q, e) / STEP
                         for e in np.eye(mechanism.model.nv)]).T
    evaluation.angle_reference[:] = 0.0
    np.testing.assert_allclose(sp.closure_jacobian(mechanism, q), expected, rtol=0, atol=1e-10)


def test_coupling_rows(tmp_path):
    tree = (turning("a", "ground", "la") + floating("b", "la", "lb", (0.4, 0, 0))
            + floating("c", "ground", "lc"))
    toml = (refine("b", "cylindrical") + refine("c", "universal")
            + coupling("one", "a", "b.slide", 0.02, 0.3) + coupling("two", "b.slide", "c.second",
                                                                    7.0)
            + coupling("three", "c.first", "b.angle", -2.0, 0.1))
    mechanism = load(tmp_path, "coupled", tree, toml)
    evaluation = LoopEquations(mechanism)
    q = np.array([30.0, 1.0, 2.0, 3.0, 4.0])
    a, angle, slide, first, second = q
    L = mechanism.characteristic_length
    expected = [(slide - 0.02 * a - 0.3) / L, second - 7.0 * slide, angle + 2.0 * first - 0.1]
    np.testing.assert_allclose(evaluate(evaluation, q), expected, rtol=0, atol=1e-14)
    v = np.array([0.3, -0.4, 0.5, 0.6, -0.7])
    scaled = v / mechanism.velocity_scale
    np.testing.assert_allclose(FIRST @ along(evaluation, q, v) / STEP,
                               evaluation.jacobian @ scaled, rtol=0, atol=1e-11)
    assert not evaluation.bias(q, v).any()


def test_passive_row_is_the_spin_of_the_body(tmp_path):
    tree = floating("ball", "ground", "a", (0.1, 0.2, 0.3)) + floating("ball2", "a", "b", (0, 0.3,
                                                                                           0))
    tree += point("tip", "b", (0.1, 0.2, -0.2))
    toml = (refine("ball", "spherical") + refine("ball2", "spherical")
            + '[passive.spin]\nbody = "b"\naxis = ["ball2", "tip"]\n')
    mechanism = load(tmp_path, "spinning", tree, toml)
    evaluation = LoopEquations(mechanism)
    rng = np.random.default_rng(5)
    along_b = np.array([0.1, 0.2, -0.2]) / 0.3
    for _ in range(5):
        q, v = somewhere(mechanism, rng), rng.uniform(-1, 1, 6)

        def spin(t, q=q, v=v):
            data = mechanism.model.createData()
            pin.forwardKinematics(mechanism.model, data, pin.integrate(mechanism.model, q, t * v),
                                  v)
            return data.v[2].angular @ along_b

        evaluation.update(q)
        scaled = v / mechanism.velocity_scale
        assert (evaluation.jacobian @ scaled)[0] == pytest.approx(spin(0.0), abs=1e-14)
        bias = FIRST @ [spin(t) for t in PLACES] / STEP
        assert evaluation.bias(q, v)[0] == pytest.approx(bias, abs=1e-11)


# ---------------------------------------------------------------- what the pair allows


@every_type
def test_rows_vanish_where_the_pair_holds_with_full_rank(tmp_path, kind):
    pin.seed(7)
    mechanism = two_bodies(tmp_path, kind)
    evaluation = LoopEquations(mechanism)
    rng = np.random.default_rng(8)
    for _ in range(10):
        q = at_relative(mechanism, placed_in(kind, rng), rng)
        assert np.abs(evaluate(evaluation, q)).max() < 1e-14
        assert not evaluation.mirrored()
        singular = np.linalg.svd(evaluation.jacobian, compute_uv=False)
        assert len(singular) == 6 - PAIRS[kind].freedom  # rows
        assert singular[-1] > 1e-3 * singular[0]  # all of them independent


@every_type
def test_rows_do_not_vanish_where_the_pair_does_not_hold(tmp_path, kind):
    """Away from the closed placements along each direction that the pair forbids."""
    pin.seed(9)
    mechanism = two_bodies(tmp_path, kind)
    evaluation = LoopEquations(mechanism)
    rng = np.random.default_rng(10)
    for _ in range(5):
        M = placed_in(kind, rng)
        evaluation.update(at_relative(mechanism, M, rng))
        forbidden = np.linalg.svd(evaluation.jacobian[:, 6:])[2][: 6 - PAIRS[kind].freedom]
        for direction in forbidden:
            for step in (1e-6, 1e-2):
                moved = M * pin.exp6(pin.Motion(step * direction))
                residual = evaluate(evaluation, at_relative(mechanism, moved, rng))
                assert np.abs(residual).max() > 0.02 * step


HALF_AND_THIRD_TURNS = [
    np.array([[s * (j == c) for j in range(3)] for s, c in zip(signs, columns, strict=True)], float)
    for columns in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
]
HALF_AND_THIRD_TURNS = [R for R in HALF_AND_THIRD_TURNS if np.linalg.det(R) > 0]  # 24 of the cube


@pytest.mark.parametrize("kind", ["weld", "fixed", "prismatic"])
def test_only_the_right_orientation_passes_as_welded(tmp_path, kind):
    mechanism = two_bodies(tmp_path, kind)
    evaluation = LoopEquations(mechanism)
    rng = np.random.default_rng(11)
    passing = [R for R in HALF_AND_THIRD_TURNS
               if np.abs(evaluate(evaluation, at_relative(
                   mechanism, pin.SE3(R, np.zeros(3)), rng))).max() < 1e-12
               and not evaluation.mirrored()]
    assert len(passing) == 1
    assert np.array_equal(passing[0], np.eye(3))


@pytest.mark.parametrize("kind", ["revolute", "cylindrical", "screw", "planar", "parallel"])
def test_a_reversed_axis_is_a_mirror_image(tmp_path, kind):
    mechanism = two_bodies(tmp_path, kind)
    evaluation = LoopEquations(mechanism)
    rng = np.random.default_rng(12)
    for R in HALF_AND_THIRD_TURNS:
        evaluation.update(at_relative(mechanism, pin.SE3(R, np.zeros(3)), rng))
        tilt = np.abs(evaluation.residual[[row for row in range(len(evaluation.residual))
                                           if not mechanism.closures[0].rows[row].is_length]]).max()
        parallel = tilt < 1e-12 and not evaluation.mirrored()
        assert parallel == (R[2, 2] == 1.0)


@pytest.mark.parametrize("kind", [name for name, pair in PAIRS.items() if pair.joint and pair.rows])
def test_a_tree_joint_satisfies_the_closure_of_its_name(tmp_path, kind):
    """The same axis, pins and lead in the tree and in the closure mean the same motion."""
    rng, pair = np.random.default_rng(14), PAIRS[kind]
    axis, other = np.linalg.qr(rng.normal(size=(3, 3)))[0][:2]
    keys = {"axis": axis} if pair.uses_axis else {}
    keys |= {"axis2": other} if pair.uses_axis2 else {}
    keys |= {"lead": LEAD} if pair.uses_lead else {}
    mount = pose(rng)
    tree = (turning("pin", "ground", "arm") + floating("joint", "arm", "body", **mount)
            + point("seat", "arm", **mount))
    mechanism = load(tmp_path, "twice", tree, refine("joint", kind, **keys) + closure(
        "same", kind, "seat", "body", **keys))
    evaluation = LoopEquations(mechanism)
    for _ in range(10):
        q = somewhere(mechanism, rng)
        settle(evaluation, q)
        assert np.abs(evaluate(evaluation, q)).max() < 1e-15 * 10
        assert not evaluation.mirrored()
        assert np.abs(evaluation.jacobian).max() < 1e-14
        assert np.abs(evaluation.bias(q, rng.uniform(-1, 1, mechanism.model.nv))).max() < 1e-13


def test_screw_angle_counts_turns(tmp_path):
    mechanism = two_bodies(tmp_path, "screw")
    evaluation = LoopEquations(mechanism)
    rng = np.random.default_rng(15)
    for angle in np.arange(0.0, 25.0, 0.5):
        slide = LEAD * angle / (2 * np.pi)
        q = at_relative(mechanism, pin.SE3(about("z", angle), np.array([0, 0, slide])), rng)
        assert np.abs(evaluate(evaluation, q)).max() < 1e-14
        assert evaluation.angles[0] == pytest.approx(angle, abs=1e-13)
        evaluation.angle_reference[:] = evaluation.angles
    for angle in (-2.0, 0.3, 2.9):
        evaluation.angle_reference[:] = 0.0
        evaluation.update(at_relative(mechanism, pin.SE3(about("z", angle), np.zeros(3)), rng))
        assert evaluation.angles[0] == pytest.approx(angle, abs=1e-14)
