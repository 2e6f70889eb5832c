"""Closing in the kernel: steps against singular values, closed configurations, what is held."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from closure_oracle import Evaluation
from loaded_library import library
from mechanisms import KNOWN
from variety import each

import spatial_pin as sp
from spatial_pin.assembly.close import close, pinned_rows
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.kernel.closer import (
    NAMED,
    TURNS,
    Closer,
    ClosureSettings,
    NamedCoordinates,
    PerturbedStarts,
    closer_of,
    descend,
    opposite_axes,
)
from spatial_pin.numerics.linalg import decompose
from spatial_pin.numerics.tolerances import TOLERANCES

LIBRARY = sp.list_mechanisms()
MOVED = 0.02  # rad, characteristic lengths, from a closed configuration
FAR_DAMPING = 1e-2  # times the residual: the first step's


def _near(mechanism: sp.Mechanism, seed: int, size: float) -> np.ndarray:
    """Return a configuration (nq,) beside the assembled one."""
    q = sp.assemble(mechanism).q
    step = np.random.default_rng(seed).uniform(-size, size, mechanism.model.nv)
    return pin.integrate(mechanism.model, q, mechanism.velocity_scale * step)


@pytest.mark.delicate
@pytest.mark.parametrize("name", each(LIBRARY))
def test_first_step_is_that_of_singular_values(name: str) -> None:
    mechanism = library(name)
    q, free = _near(mechanism, 1, MOVED), np.ones(mechanism.model.nv, dtype=bool)
    free[::3] = False
    evaluation = Evaluation(constraints_of(mechanism))
    evaluation.update(q)
    rows, residual = pinned_rows(evaluation, free, {})
    svd = decompose(rows)
    length = float(np.linalg.norm(residual))
    s, r = svd.s[: svd.rank], svd.rank
    step = np.zeros(len(free))
    step[free] = -svd.vt[:r].T @ (s * (svd.u[:, :r].T @ residual) / (s * s + FAR_DAMPING * length))
    expected = pin.integrate(mechanism.model, q, mechanism.velocity_scale * step)
    closer = Closer(mechanism)
    found, left = descend(closer, q[None], free, 0.0, 1)
    evaluation.update(expected)
    assert left[0] <= length
    if float(np.linalg.norm(evaluation.residual)) < length:  # else it is damped more
        assert np.abs(found[0] - expected).max() <= 1e-11
        assert left[0] == pytest.approx(float(np.linalg.norm(evaluation.residual)), abs=1e-13)


@pytest.mark.parametrize("name", each(LIBRARY))
def test_loops_are_closed_by_little_motion_and_what_is_held_stands(name: str) -> None:
    mechanism = library(name)
    q, free = _near(mechanism, 2, MOVED), np.ones(mechanism.model.nv, dtype=bool)
    held = [mechanism.coordinate(d) for d in mechanism.drivers][:1]
    free[[c.v for c in held]] = False
    evaluation = Evaluation(constraints_of(mechanism))
    found, error = close(evaluation, q, free, 1e-13)
    assert error <= 1e-14
    moved = pin.difference(mechanism.model, q, found) / mechanism.velocity_scale
    assert np.abs(moved).max(initial=0.0) <= 20.0 * MOVED
    assert all(found[c.q] == q[c.q] for c in held)
    assert not np.abs(moved[~free]).any()


@pytest.mark.delicate
@pytest.mark.parametrize("case", each(KNOWN))
def test_cases_close_to_the_branch_they_are_moved_from(case: str, tmp_path: Path) -> None:
    known = KNOWN[case]
    mechanism = known.build(tmp_path)
    state = sp.assemble(mechanism, {known.driver: float(known.values[len(known.values) // 2]),
                                    **known.hold})
    free = np.ones(mechanism.model.nv, dtype=bool)
    free[[mechanism.coordinate(n).v for n in (known.driver, *known.hold)]] = False
    step = np.random.default_rng(3).uniform(-1e-4, 1e-4, mechanism.model.nv) * free
    start = pin.integrate(mechanism.model, state.q, mechanism.velocity_scale * step)
    evaluation = Evaluation(constraints_of(mechanism))
    evaluation.angle_reference[:] = state.angles
    found, error = close(evaluation, start, free, 1e-13)
    assert error <= 1e-14
    apart = pin.difference(mechanism.model, state.q, found) / mechanism.velocity_scale
    assert np.abs(apart).max() <= 1e-2


def test_answer_does_not_depend_on_what_was_closed_before() -> None:
    mechanism = library("rssr")
    free = np.ones(mechanism.model.nv, dtype=bool)
    q = _near(mechanism, 4, 0.3)
    how = ClosureSettings(free, None, 1e-13, 60, 1e-10)
    (fresh,) = Closer(mechanism).solve([q], how)
    used = Closer(mechanism)
    for seed in range(3):
        used.solve([_near(mechanism, seed, 1.0)], how)
    (again,) = used.solve([q], how)
    assert np.array_equal(fresh.q, again.q)
    assert fresh.error == again.error


def test_many_loops_close_as_few_do() -> None:
    """Sparse squares, which many equations are closed by, and orthogonal factors lead alike."""
    mechanism = library("stewart")
    free = np.ones(mechanism.model.nv, dtype=bool)
    free[[mechanism.coordinate(d).v for d in mechanism.drivers]] = False
    q = _near(mechanism, 5, MOVED)
    closer = Closer(mechanism)
    ((few, error, *_),) = closer.solve([q], ClosureSettings(free, None, 1e-13, 60, 1e-10))
    q[[mechanism.coordinate(d).q for d in mechanism.drivers]] = few[
        [mechanism.coordinate(d).q for d in mechanism.drivers]]
    many, left = descend(closer, q[None], free, 1e-13, 60)
    assert error <= 1e-15
    assert left[0] <= 1e-13
    assert np.abs(many[0] - few).max() <= 1e-11


@pytest.mark.parametrize("name", ["rssr", "stewart", "watt_six_bar"])
def test_configurations_closed_in_one_go_are_those_closed_one_by_one(name: str) -> None:
    mechanism = library(name)
    q = np.array([_near(mechanism, seed, 3.0) for seed in range(8)])
    free = np.ones(mechanism.model.nv, dtype=bool)
    free[mechanism.coordinate(next(iter(mechanism.drivers))).v] = False
    rest = ClosureSettings(free, None, 1e-13, 60, 1e-9)
    asked = ClosureSettings(free, None, 1e-13, 60, 1e-9, np.zeros(mechanism.model.nq, np.int64),
                            (q[0], q[0]), None)
    together, alone = Closer(mechanism).solve(q, asked, q[0]), Closer(mechanism)
    for start, found in zip(q, together, strict=True):
        (known,) = alone.solve([start], rest)
        assert np.array_equal(found.q, known.q)
        assert found[1:3] == known[1:3]


@pytest.mark.parametrize(("name", "near", "stays"), [
    ("rssr", 0.0, ""), ("rssr", 0.0, "rocker_pin"), ("rssr", 3.0, ""), ("watt_six_bar", 0.0, ""),
    ("four_bar", 0.0, "rocker_pin"), ("stewart", 0.5, "")])
def test_further_starts_tried_in_one_go_are_those_tried_one_by_one(
    name: str, near: float, stays: str
) -> None:
    """Of places where nothing is at fault only those nearer than all before are told."""
    mechanism = library(name)
    model, q = mechanism.model, mechanism.neutral.copy()
    free = np.ones(model.nv, dtype=bool)
    free[mechanism.coordinate(next(iter(mechanism.drivers))).v] = False
    first = free.copy()
    if stays:  # named too, and held first
        first[mechanism.coordinate(stays).v] = False
    kinds = np.zeros(model.nq, np.int64)
    kinds[[c.q for c in mechanism.coordinate_table.values() if c.q >= 0]] = NAMED
    steps = np.random.default_rng(7).uniform(-2.0, 2.0, (8, model.nv)) * mechanism.velocity_scale
    one_group = (np.zeros(n, np.int64) for n in (8, model.nv))
    further = PerturbedStarts(near, steps, *one_group)
    asked = ClosureSettings(free, first if stays else None, 1e-13, 60, 1e-9, kinds, (q, q),
                            further)
    start = Closer(mechanism).solve([_near(mechanism, 3, 0.5)], asked, q)[0].q
    told = Closer(mechanism).solve([start], asked, start + 0.1, perturbed=True)
    alone, wanted, nearest = Closer(mechanism), [], np.inf
    for step in (np.zeros(model.nv), *steps):
        (found,) = alone.solve([pin.integrate(model, start, step)], asked, start + 0.1)
        is_sound = found.error <= TOLERANCES.closed and not found.may_be_mirrored
        if not is_sound or found.distance < nearest:
            wanted.append(found)
        nearest = min(nearest, found.distance) if is_sound else nearest
        if nearest < near:
            break
    assert len(told) == len(wanted)
    for one, other in zip(told, wanted, strict=True):
        # what nothing determines stays where the first steps lead, which end a little earlier
        np.testing.assert_allclose(one.q, other.q, rtol=0.0, atol=1e-6 if stays else 1e-12)
        assert one.may_be_mirrored == other.may_be_mirrored


@pytest.mark.parametrize(("angle", "named", "limits", "meant"), [
    (7.0, None, (-9.0, 9.0), 7.0 - 2.0 * np.pi),
    (7.0, 8.0, (-9.0, 9.0), 7.0),
    (-np.pi, None, (-9.0, 9.0), np.pi),  # half a turn is the positive one
    (3.0, None, (-4.0, 0.0), 3.0 - 2.0 * np.pi),  # only that is in the limits
    (3.0, None, (-1.0, 1.0), 3.0),  # nor is that
])
def test_angles_are_unwrapped_to_their_reference(angle, named, limits, meant) -> None:
    mechanism = library("rssr")
    at = mechanism.coordinate("rocker_pin").q
    q, kinds = mechanism.neutral.copy(), np.zeros(mechanism.model.nq, np.int64)
    q[at], kinds[at] = angle, TURNS | (NAMED if named is not None else 0)
    value, lower, upper = (np.zeros(mechanism.model.nq) for _ in range(3))
    value[at], lower[at], upper[at] = named or 0.0, *limits
    found = Closer(mechanism).judge(q, 0.0, NamedCoordinates(value, kinds, lower, upper))
    assert abs(found.q[at] - meant) <= 1e-15
    assert found.distance == pytest.approx(0.0 if named is None else abs(meant - named))


def test_distance_from_a_named_orientation_is_its_angle() -> None:
    mechanism = library("rssr")
    ball = mechanism.model.idx_qs[mechanism.joint_id("ball_a")]
    q, kinds = mechanism.neutral.copy(), np.zeros(mechanism.model.nq, np.int64)
    kinds[ball] = NAMED
    goal, at_rest = q.copy(), np.zeros(mechanism.model.nq)
    goal[ball : ball + 4] = -np.array([0.0, np.sin(0.2), 0.0, np.cos(0.2)])  # turned by 0.4
    found = Closer(mechanism).judge(q, 0.0, NamedCoordinates(goal, kinds, at_rest, at_rest))
    assert found.distance == pytest.approx(0.4, abs=1e-15)
    assert np.array_equal(found.q, q)


@pytest.mark.parametrize("name, output", [
    ("excavator", "boom_base"), ("oldham", "output_pin"), ("sarrus", "a_top"),
    ("scotch_yoke", "slot"), ("screw_press", "slide")])
def test_opposite_axes_are_detected_where_equations_are_left_out(name, output):
    mechanism = sp.reduce(sp.load(name), output)
    assert any(c.equations is not None for c in mechanism.closures)
    rng, counts = np.random.default_rng(3), [0, 0]
    with closer_of(mechanism) as closer:
        for _ in range(40):
            q = pin.integrate(mechanism.model, pin.neutral(mechanism.model),
                              rng.uniform(-3.0, 3.0, mechanism.model.nv))
            data = mechanism.model.createData()
            pin.forwardKinematics(mechanism.model, data, q)
            opposite = bool(opposite_axes(mechanism, data))
            assert closer.examine(q, np.zeros(closer.kernel.n_angles)).may_be_mirrored == opposite
            counts[opposite] += 1
    assert max(counts) == 40 or min(counts) > 2
