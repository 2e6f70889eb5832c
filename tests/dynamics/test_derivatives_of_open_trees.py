"""Derivatives of open trees: right for all pairs and loads, in memory and time of the answer."""

import time

import numpy as np
import pinocchio as pin
import pytest
from memory import peak_memory
from open_trees import KINDS, bushy, efforts_of, moving, straight, tree

import spatial_pin as sp

STENCIL = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
CONSTANT = [kinds for kinds in KINDS if kinds != "universal"]  # where Pinocchio's are right


def difference(f, h):
    return sum(c * (f(k * h) - f(-k * h)) for k, c in STENCIL) / h


def mass_matrix(model, q):
    data = model.createData()
    upper = np.triu(pin.crba(model, data, q))
    return upper + np.triu(upper, 1).T


@pytest.mark.parametrize("kinds, n", [*((k, n) for k in CONSTANT for n in (2, 20)), ("hinges", 70)])
def test_forces_of_a_chain_change_as_pinocchio_says(kinds, n):
    """M da = -d(M a + b) at the same a: what the accelerations leave is round-off."""
    mech = tree(KINDS[kinds], n, straight)
    state, model, data = moving(mech), mech.model, mech.model.createData()
    tau = np.random.default_rng(3).uniform(-1, 1, model.nv)
    found = sp.dynamics_derivatives(mech, state, efforts_of(mech, tau))
    by_q, by_v, _ = pin.computeRNEADerivatives(model, data, state.q, state.v, found.a)
    mass = mass_matrix(model, state.q)
    for change, by in ((by_q, found.a_by_q), (by_v, found.a_by_v),
                       (-np.eye(model.nv), found.a_by_effort)):
        size = (np.abs(mass) @ np.abs(by)).max()
        assert mass @ by == pytest.approx(-change, abs=1e-14 * size)


@pytest.mark.parametrize("kinds", KINDS)
def test_accelerations_of_a_tree_change_as_their_differences(kinds):
    """Joints in any order, pushed from outside by wrenches that keep their world axes."""
    mech = tree(KINDS[kinds], 12, bushy(12))
    state, model = moving(mech), mech.model
    external = {f"link{k}": pin.Force(np.array([3.0, -2.0, k]), np.array([0.2, 0.1 * k, -0.3]))
                for k in (0, 5, 11)}
    found = sp.dynamics_derivatives(mech, state, external=external)

    def accelerations(q, v):
        return sp.forward_dynamics(
            mech, sp.State(mech, q, v, closure_error=0.0), external=external).a

    d = np.random.default_rng(4).uniform(-1, 1, model.nv)
    by_q = difference(lambda e: accelerations(pin.integrate(model, state.q, e * d), state.v), 2e-3)
    by_v = difference(lambda e: accelerations(state.q, state.v + e * d), 0.05)
    assert found.a_by_q @ d == pytest.approx(by_q, abs=1e-9 * np.abs(by_q).max())
    assert found.a_by_v @ d == pytest.approx(by_v, abs=1e-9 * np.abs(by_v).max())


def sprung():
    """A tree of all pairs with springs of every kind, dampers and friction."""
    planar = pin.JointModelComposite(pin.JointModelPX())
    for joint in (pin.JointModelPY(), pin.JointModelRZ()):
        planar.addJoint(joint)
    mech = tree([planar, *(joint for kind in KINDS.values() for joint in kind)], 13, bushy(13))
    model, bed = mech.model, np.array([100.0, 110.0, 90.0, 1.0, 2.0, 1.5])
    model.damping = np.linspace(0.0, 0.3, model.nv)
    model.upperDryFrictionLimit = np.where(np.arange(model.nv) % 4 == 0, 0.1, 0.0)
    hinge, other = [c for c in mech.coordinates if mech.coordinate(c).q >= 0][:2]
    return mech.with_fields(springs=(
        sp.Spring("across", ("link3", "link9"), stiffness=50.0, damping=2.0, free_length=0.1),
        sp.Spring("bed", ("link4", "link7"), stiffness=bed, damping=0.01 * bed),
        sp.Spring("turn", joint=hinge, stiffness=3.0, damping=0.2),
        sp.Spring("slide", joint=other, stiffness=4.0, damping=0.1)))


def test_springs_bushings_dampers_and_friction_are_among_them():
    mech = sprung()
    state, model = moving(mech), mech.model
    found = sp.dynamics_derivatives(mech, state, slip_speed=0.7)

    def accelerations(q, v):
        return sp.forward_dynamics(
            mech, sp.State(mech, q, v, closure_error=0.0), slip_speed=0.7).a

    d = np.random.default_rng(4).uniform(-1, 1, model.nv)
    by_q = difference(lambda e: accelerations(pin.integrate(model, state.q, e * d), state.v), 1e-3)
    by_v = difference(lambda e: accelerations(state.q, state.v + e * d), 0.01)
    assert found.a_by_q @ d == pytest.approx(by_q, abs=1e-9 * np.abs(by_q).max())
    assert found.a_by_v @ d == pytest.approx(by_v, abs=1e-9 * np.abs(by_v).max())


def test_reactions_of_a_chain_change_as_their_differences():
    mech = tree(KINDS["hinges"], 70, straight)
    state, model = moving(mech), mech.model
    found = sp.dynamics_derivatives(mech, state)
    d = np.random.default_rng(4).uniform(-1, 1, model.nv)
    for name in ("j0", "j35", "j69"):
        want = difference(lambda e, name=name: sp.forward_dynamics(mech, sp.State(
            mech, pin.integrate(model, state.q, e * d), state.v, closure_error=0.0)).reactions[
                name].vector, 1e-3)
        assert found.reactions[name].by_q @ d == pytest.approx(
            want, abs=1e-7 * max(1.0, np.abs(want).max()))


def test_memory_is_that_of_the_answer():
    """A `pin.Data` of 400 hinges has 3 GB."""
    mech = tree(KINDS["hinges"], 400, straight)
    state = moving(mech)
    with peak_memory() as peak:
        sp.dynamics_derivatives(mech, state)
    assert peak.bytes < 12 * 8 * 400**2


@pytest.mark.slow
def test_time_grows_with_the_number_of_entries():
    def best(n):
        mech = tree(KINDS["hinges"], n, straight)
        state, times = moving(mech), []
        for _ in range(6):
            begin = time.perf_counter()
            sp.dynamics_derivatives(mech, state)
            times.append(time.perf_counter() - begin)
        return min(times)

    assert np.log(best(1600) / best(400)) / np.log(4.0) < 2.4
