"""Rates and Jacobians of the kernel against NumPy's solutions with Pinocchio's numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import published_models as models
import pytest
from closure_oracle import Evaluation
from loaded_library import library
from mechanisms import four_bar, swung
from variety import each

import spatial_pin as sp
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.assembly.state import WORLD_AXES, State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.kernel.kernel import Kernel, tangent_step
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.kernel.rate_solver import RateSolver
from spatial_pin.mechanism.coordinates import coordinate_rates
from spatial_pin.numerics.linalg import Array, decompose, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.rates import RATES

LIBRARY = sp.list_mechanisms()
CLEAR = 1e-2  # pivots with which the kernel has to answer
AGREE = 1e-12  # relative to the fastest joint: a thousand times the round-off of one solution


def _square(mechanism: sp.Mechanism) -> tuple[State, SquareSystem]:
    """Return the assembled state and its square system with all drivers driven."""
    state = sp.assemble(mechanism)
    evaluation = Evaluation(constraints_of(mechanism))
    evaluation.angle_reference[:] = state.angles
    driven = [mechanism.prescribed_coordinate(d) for d in mechanism.drivers]
    return state, SquareSystem(evaluation, driven, state.q)


def _rates(system: SquareSystem, q: np.ndarray, drive: np.ndarray, more: np.ndarray):
    """Return v and a (nv,), at rest but for what is driven, by NumPy: K v = drive, K a = ..."""
    evaluation, mechanism = system.evaluation, system.evaluation.mechanism
    n, p = evaluation.constraints.n_closure, evaluation.constraints.n_passive
    r = len(system.equations)
    sizes = np.array([system.scale[c.v] for c in system.driven])
    first, second = np.zeros((2, len(system.matrix)))
    at = slice(r + p, r + p + len(system.driven))
    first[at] = drive / sizes
    v = system.scale * np.linalg.solve(system.matrix, first)
    bias = evaluation.bias(q, v)
    bent = [0.0 if c.q >= 0 else coordinate_rates(
        mechanism, c.name, q[None], v[None], np.zeros((1, len(v)))).acceleration.item(0)
        for c in system.driven]  # second derivatives of the values at zero joint accelerations
    second[:r], second[r : r + p] = -bias[system.equations], -bias[n:]
    second[at] = (more - bent) / sizes
    return v, system.scale * np.linalg.solve(system.matrix, second)


@pytest.mark.parametrize("name", LIBRARY)
def test_rates_are_those_of_the_square_system(name: str) -> None:
    mechanism = library(name)
    state, system = _square(mechanism)
    rng = np.random.default_rng(1)
    drive, more = rng.uniform(-1.0, 1.0, (2, len(system.driven)))
    at = [*system.driven_entries, *system.still]
    kernel = Kernel(mechanism)  # whose memory the rates work in
    rates = RateSolver(kernel, at, len(drive))
    rates.speeds[: len(drive)], rates.accelerations[: len(drive)] = drive, more
    found = rates.solve(state.q, state.angles, RATES)
    c = constraints_of(mechanism)
    fits = len(system.equations) + c.n_passive + len(at) == mechanism.model.nv
    clear = system.pivot > CLEAR
    assert found is not None or not (fits and clear)
    if found is None:
        return
    assert fits
    v, a = _rates(system, state.q, drive, more)
    assert np.abs(found[0] - v).max() <= AGREE * np.abs(v).max()
    assert np.abs(found[1] - a).max() <= AGREE * max(np.abs(a).max(), np.abs(v).max() ** 2)
    if len(system.equations) == c.n_closure:  # else others may be chosen
        assert found[2][0] == pytest.approx(system.pivot, rel=1e-9)
    assert [found[0][k] for k in system.driven_entries] == list(drive)


@pytest.mark.parametrize("name", each(LIBRARY))
def test_rates_with_equations_and_passive_freedoms_that_are_given(name: str) -> None:
    """Where freedoms are left that nothing determines, they take the least rates."""
    bare = replace(library(name), passives=())
    state, system = _square(bare)
    rng = np.random.default_rng(4)
    drive, more = rng.uniform(-1.0, 1.0, (2, len(system.driven)))
    kernel = Kernel(bare)  # whose memory the rates work in
    rates = RateSolver(kernel, [*system.driven_entries, *system.still], len(drive))
    rates.speeds[: len(drive)], rates.accelerations[: len(drive)] = drive, more
    found = rates.solve(state.q, state.angles, RATES, chosen=(
        system.equations, system.passive))
    v, a = _rates(system, state.q, drive, more)
    assert found is not None
    assert np.abs(found[0] - v).max() <= AGREE * np.abs(v).max()
    assert np.abs(found[1] - a).max() <= AGREE * max(np.abs(a).max(), np.abs(v).max() ** 2)
    assert np.abs(system.passive @ (found[0] / system.scale)).max(initial=0.0) <= AGREE


@pytest.mark.parametrize("name", each(LIBRARY))
def test_jacobians_are_those_of_pinocchio(name: str) -> None:
    """Against the twists of states whose drivers move one after the other."""
    mechanism = library(name)
    state = sp.assemble(mechanism)
    for link in mechanism.links[-2:]:
        found = sp.jacobian(mechanism, state, link)
        for k, driver in enumerate(mechanism.drivers):
            moving = sp.solve_rates(mechanism, state, {driver: 1.0})
            twist = moving.velocity(link).vector
            assert np.abs(found[:, k] - twist).max() <= 1e-11 * max(1.0, np.abs(twist).max())


@pytest.mark.delicate
def test_pivots_that_are_not_clear_are_left_to_the_full_way() -> None:
    """Next to a dead centre rates are known badly, and the state says so."""
    mechanism = library("peaucellier")
    driver = next(iter(mechanism.drivers))
    end = sp.limits(mechanism, driver).upper.value
    state = sp.assemble(mechanism, {driver: end - 1e-9})
    moving = sp.solve_rates(mechanism, state, {driver: 1.0})
    assert moving.rate_error > 1e-10


@pytest.mark.delicate
def test_equations_lost_are_not_taken_for_redundant_ones() -> None:
    """A flat parallelogram can fold either way: its equations depend on each other there only."""
    mechanism = models.ladder(1)
    state = sp.assemble(mechanism, {"pin_0": np.pi / 2})
    with pytest.raises(sp.SingularError, match="singular"):
        sp.solve_rates(mechanism, state, {"pin_0": 1.0})


@pytest.mark.delicate
@pytest.mark.parametrize("n", [1, 3, 30])
def test_rates_of_flat_loops_with_redundant_equations(n: int) -> None:
    """Of five equations of a hinge two are of use: all rods of a ladder turn alike."""
    mechanism = models.ladder(n)
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"pin_0": 0.3}), {"pin_0": 2.0},
                           {"pin_0": 1.0})
    pins = [state.coordinate(f"pin_{i}") for i in range(n + 1)]
    assert [pin.rate for pin in pins] == pytest.approx([2.0] * (n + 1), abs=1e-13 * n)
    assert [pin.acceleration for pin in pins] == pytest.approx([1.0] * (n + 1), abs=1e-12 * n)
    assert state.rate_error < 1e-12


def test_memory_for_rates_does_not_change_answers() -> None:
    mechanism = library("stewart")
    state = sp.assemble(mechanism)
    speeds = dict.fromkeys(mechanism.drivers, 0.1)
    first = sp.solve_rates(mechanism, state, speeds)
    other = sp.assemble(mechanism, dict.fromkeys(mechanism.drivers, state.coordinate(
        next(iter(mechanism.drivers))).value + 0.02), guess=state)
    sp.solve_rates(mechanism, other, speeds)
    again = sp.solve_rates(mechanism, state, speeds)
    assert np.array_equal(first.v, again.v)
    assert np.array_equal(first.a, again.a)


def test_components_of_balls_and_floating_joints_are_driven_in_the_kernel(tmp_path):
    """Their rates are none of the velocities: rows and second derivatives of their own."""
    mechanism = swung(tmp_path)
    state, system = _square(mechanism)
    rng = np.random.default_rng(2)
    drive, more = rng.uniform(-1.0, 1.0, (2, len(system.driven)))
    nv = mechanism.model.nv
    kernel = Kernel(mechanism)
    rates = RateSolver(kernel, [c.v + nv * (c.q < 0) for c in system.driven], len(drive))
    rates.speeds[: len(drive)], rates.accelerations[: len(drive)] = drive, more
    found = rates.solve(state.q, state.angles, RATES)
    assert found is not None
    v, a = _rates(system, state.q, drive, more)
    assert np.abs(found[0] - v).max() <= AGREE * np.abs(v).max()
    assert np.abs(found[1] - a).max() <= AGREE * max(np.abs(a).max(), np.abs(v).max() ** 2)


def _beside(mechanism: sp.Mechanism, state: State) -> tuple[Array | None, bool]:
    """Return the end of a step in the freedoms that independent closure equations leave."""
    with loops_of(mechanism, state.angles) as evaluation:
        evaluation.update(state.q)
        jacobian = evaluation.jacobian[: evaluation.constraints.n_closure].copy()
        chosen = independent_rows(jacobian)
        freedoms = decompose(jacobian[chosen]).vt[len(chosen) :]
        return tangent_step(mechanism, state.q, state.angles, chosen, freedoms)


@pytest.mark.delicate
@pytest.mark.parametrize("name", ["bennett", "sarrus", "delta", "four_bar", "oldham"])
def test_redundant_equations_hold_beside_a_regular_configuration(name: str) -> None:
    mechanism = library(name)
    state = sp.assemble(mechanism)
    end, is_closed = _beside(mechanism, state)
    assert end is not None and is_closed
    away = pin.difference(mechanism.model, state.q, end) / mechanism.velocity_scale
    assert np.linalg.norm(away) == pytest.approx(TOLERANCES.trial_step, rel=0.1)


@pytest.mark.delicate
def test_a_flat_parallelogram_opens_beside_by_the_square_of_the_step() -> None:
    """Two branches cross there: two freedoms, of which only two directions lead on."""
    mechanism = four_bar(r1=0.3, r2=0.1, r3=0.3, r4=0.1)
    flat = sp.assemble(mechanism, {"crank": 0.0}, dict.fromkeys(mechanism.coordinates, 0.0))
    end, is_closed = _beside(mechanism, flat)
    assert end is not None and not is_closed
    with loops_of(mechanism) as evaluation:
        evaluation.update(end)
        assert 1e-3 < evaluation.closure_error / TOLERANCES.trial_step**2 < 1.0


class _TreeOracle:
    """A frame's Jacobian in the tree, and its rate by Pinocchio's accelerations."""

    def __init__(self, mechanism: sp.Mechanism, q: np.ndarray, frame: int) -> None:
        self.model, self.q, self.frame = mechanism.centred_model, q, frame
        self.data = self.model.createData()
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        self.jacobian = np.array(pin.getFrameJacobian(self.model, self.data, frame, WORLD_AXES))

    def acceleration(self, v: np.ndarray) -> np.ndarray:
        """Return (6,) the frame's classical acceleration at zero joint acceleration."""
        pin.forwardKinematics(self.model, self.data, self.q, v, np.zeros_like(v))
        return pin.getFrameClassicalAcceleration(
            self.model, self.data, self.frame, WORLD_AXES).vector


@pytest.mark.parametrize("name", each(LIBRARY))
def test_rates_of_jacobians_give_the_accelerations_of_pinocchio(name: str) -> None:
    """J' s + J s' is the frame's acceleration, for speeds of all drivers together."""
    mechanism = library(name)
    rng = np.random.default_rng(3)
    s, ds = rng.uniform(-1.0, 1.0, (2, len(mechanism.drivers)))
    state = sp.solve_rates(mechanism, sp.assemble(mechanism),
                           dict(zip(mechanism.drivers, s, strict=True)),
                           dict(zip(mechanism.drivers, ds, strict=True)))
    for link in mechanism.links[-2:]:
        tree = _TreeOracle(mechanism, state.q, mechanism.frame_id(link))
        expected = tree.jacobian @ state.a + tree.acceleration(state.v)
        found = (sp.jacobian(mechanism, state, link) @ ds
                 + sp.jacobian_rate(mechanism, state, link) @ s)
        assert np.abs(found - expected).max() <= 1e-12 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("name", ["delta", "stewart", "rssr", "swash_plate", "satellite_dish"])
def test_each_column_of_the_rate_is_that_of_differences(name: str) -> None:
    """Column by column, which accelerations along one motion do not tell."""
    mechanism = library(name)
    speeds = {d: 0.3 + 0.2 * k for k, d in enumerate(mechanism.drivers)}
    state, link, h = sp.assemble(mechanism), mechanism.links[-1], 1e-4
    moving = sp.solve_rates(mechanism, state, speeds)
    ends = []
    for t in (-h, h):
        q = pin.integrate(mechanism.model, state.q, t * moving.v)
        values = {d: state.coordinate(d).value + t * x for d, x in speeds.items()}
        ends.append(sp.jacobian(mechanism, sp.assemble(mechanism, values, q), link))
    rate = (ends[1] - ends[0]) / (2.0 * h)
    np.testing.assert_allclose(sp.jacobian_rate(mechanism, moving, link), rate,
                               atol=1e-6 * max(1.0, np.abs(rate).max()))


def test_pieces_of_a_long_motion_are_put_together(monkeypatch) -> None:
    mechanism = library("delta")
    motion = sp.sweep(mechanism, "arm_1", np.linspace(0.0, 0.3, 40))
    whole = sp.jacobian(mechanism, motion, "platform")
    monkeypatch.setattr("spatial_pin.assembly.state.PIECE", 7 * mechanism.model.nv)
    assert np.array_equal(whole, sp.jacobian(mechanism, motion, "platform"))
