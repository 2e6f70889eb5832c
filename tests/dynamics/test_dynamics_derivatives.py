"""Derivatives of the constrained dynamics against differences of sixth order."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from derivative_cases import NAMES, WEIGHT, moving, some
from ladders import ladder, leaning
from loaded_library import library
from masses import with_masses
from memory import peak_memory
from scipy.linalg import null_space
from variety import few

import spatial_pin as sp

STENCIL = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))


def difference(f, h):
    return sum(c * (f(k * h) - f(-k * h)) for k, c in STENCIL) / h


OVERCONSTRAINED = ["bennett", "bricard", "four_bar", "hooke_joint", "double_cardan", "sarrus",
                   "geared_five_bar", "screw_press", "oldham", "watt_six_bar"]


@pytest.mark.parametrize("build", some(), ids=NAMES)
def test_partial_derivatives(build, tmp_path):
    """Of accelerations and multipliers, in every direction."""
    mech = build(tmp_path)
    state, size = moving(mech), mech.velocity_scale
    efforts = {name: 0.4 for name in list(mech.coordinates)[:1] if mech.coordinate(name).q >= 0}
    found = sp.dynamics_derivatives(mech, state, efforts)

    def both(q, v, effort=efforts):
        answer = sp.forward_dynamics(mech, sp.State(mech, q, v, closure_error=0.0,
                                                 angles=state.angles), effort)
        return np.concatenate([answer.a, answer.multipliers])

    value = both(state.q, state.v)
    rng = np.random.default_rng(1)
    for _ in range(3):
        d = size * rng.uniform(-1, 1, mech.model.nv)
        by_q = difference(lambda e, d=d: both(pin.integrate(mech.model, state.q, e * d), state.v),
                          2e-4)
        by_v = difference(lambda e, d=d: both(state.q, state.v + e * d), 0.05)
        for got, want in ((np.concatenate([found.a_by_q, found.multipliers_by_q]) @ d, by_q),
                          (np.concatenate([found.a_by_v, found.multipliers_by_v]) @ d, by_v)):
            n = mech.model.nv
            for part in (slice(0, n), slice(n, None)):
                scale = np.abs(np.stack([want[part], value[part]])).max(initial=1e-9)
                assert got[part] == pytest.approx(want[part], abs=1e-8 * scale)
    for name in efforts:
        unit = both(state.q, state.v, {name: 1.4}) - value
        column = np.concatenate([found.a_by_effort, found.multipliers_by_effort])[
            :, mech.coordinate(name).v]
        assert column == pytest.approx(unit, abs=1e-9 * np.abs(unit).max())


@pytest.mark.parametrize("name", few(OVERCONSTRAINED, "bennett", "four_bar", "screw_press"))
def test_along_closed_motions_of_overconstrained_loops(name):
    mech = library(name)
    driver = next(iter(mech.drivers))
    start, speed = sp.assemble(mech, {}), 0.7
    at = start.coordinate(driver).value

    def near(e):
        state = sp.assemble(mech, {driver: at + e}, guess=start)
        return sp.solve_rates(mech, state, {driver: speed})

    def accelerations(e):
        return sp.forward_dynamics(mech, near(e), {driver: 0.3}).a

    state = near(0.0)
    found = sp.dynamics_derivatives(mech, state, {driver: 0.3})
    want = difference(accelerations, 2e-3)
    got = (found.a_by_q @ state.v + found.a_by_v @ state.a) / speed
    scale = max(np.abs(want).max(), np.abs(found.a).max())
    assert got == pytest.approx(want, abs=1e-7 * scale)


def test_a_tree_without_closures_has_pinocchios_derivatives(tmp_path):
    mech = with_masses(known.pendulum(tmp_path), tmp_path, upper=WEIGHT, lower=WEIGHT)
    state = sp.solve_rates(mech, sp.assemble(mech, {"shoulder": 0.4, "elbow": -0.8}),
                           {"shoulder": 2.0, "elbow": -1.0})
    found = sp.dynamics_derivatives(mech, state, {"elbow": 0.3})
    data = mech.model.createData()
    by_q, by_v, by_effort = pin.computeABADerivatives(mech.model, data, state.q, state.v,
                                                      np.array([0.0, 0.3]))
    assert found.a_by_q == pytest.approx(by_q, rel=1e-10, abs=1e-10)
    assert found.a_by_v == pytest.approx(by_v, rel=1e-10, abs=1e-10)
    assert found.a_by_effort == pytest.approx(by_effort, rel=1e-10, abs=1e-10)


class Native:
    """Pinocchio's constraintDynamics and its derivatives, on a mechanism's spherical closures."""

    def __init__(self, mech):
        self.model, self.data = mech.model, mech.model.createData()
        self.models = pin.StdVec_RigidConstraintModel(mech.constraint_models())
        self.datas = pin.StdVec_RigidConstraintData([m.createData() for m in self.models])
        pin.initConstraintDynamics(self.model, self.data, self.models, self.datas)
        self.settings = pin.ProximalSettings(0.0, 1e-12, 5)

    def accelerations(self, q, v):
        return pin.constraintDynamics(self.model, self.data, q, v, np.zeros(len(v)), self.models,
                                      self.datas, self.settings).copy()

    def derivatives(self, q, v):
        self.accelerations(q, v)
        return [np.array(x) for x in pin.computeConstraintDynamicsDerivatives(
            self.model, self.data, self.models, self.datas, self.settings)[:3]]


@pytest.mark.parametrize("name", ["rssr", "rspc", "crank_collar", "stewart", "delta"])
def test_pinocchios_accelerations_change_as_ours_do(name):
    """Along the closed motion q' = v, v' = a; and its derivatives are ours where those are right.

    In 4.1 those by q are not where a closure's joints are composite, nor on the RSSR.
    """
    mech = library(name)
    state = sp.solve_rates(mech, sp.assemble(mech, {}), dict.fromkeys(mech.drivers, 0.7))
    found, native = sp.dynamics_derivatives(mech, state), Native(mech)
    along = found.a_by_q @ state.v + found.a_by_v @ found.a
    want = difference(lambda e: native.accelerations(
        pin.integrate(mech.model, state.q, e * state.v), state.v + e * found.a), 1e-4)
    assert along == pytest.approx(want, abs=1e-8 * np.abs(want).max())
    by_q, by_v, by_effort = native.derivatives(state.q, state.v)
    assert found.a_by_effort == pytest.approx(by_effort, abs=1e-11 * np.abs(by_effort).max())
    closed = null_space(sp.closure_jacobian(mech, state.q) * mech.velocity_scale)
    closed = closed * mech.velocity_scale[:, None]
    size = np.abs(by_v @ closed).max()
    assert found.a_by_v @ closed == pytest.approx(by_v @ closed, abs=1e-11 * size)
    if name in ("stewart", "delta"):
        assert by_q @ state.v + by_v @ found.a == pytest.approx(
            along, abs=1e-10 * np.abs(along).max())


def test_derivatives_take_no_more_memory_than_their_answer(tmp_path):
    """Their matrices grow with the square of the loops; `pin.Data` would with the third power."""
    def memory(n):
        (tmp_path / str(n)).mkdir()
        state = leaning(ladder(tmp_path / str(n), n), 0.7, 1.3)[0]
        sp.dynamics_derivatives(state.mechanism, state)  # what is learnt once
        with peak_memory() as peak:
            found = sp.dynamics_derivatives(state.mechanism, state)
        return found, peak.bytes

    few, many = memory(15), memory(60)
    assert many[1] < 4**2 * 1.1 * few[1]
    for n, (found, _) in ((15, few), (60, many)):  # it falls as one rod
        sense = np.sign(found.a)
        slope = ((n + 1) / 2 + n) * 9.81 / ((n + 1) / 3 + n) * np.cos(0.7)
        assert found.a_by_q @ sense == pytest.approx(sense * slope, rel=1e-10)
        assert found.a_by_v @ sense == pytest.approx(np.zeros(len(sense)), abs=1e-9)
