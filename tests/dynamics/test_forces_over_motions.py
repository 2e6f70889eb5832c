"""Forces over a motion are those of each of its states."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from ladders import heavy_four_bar

import spatial_pin as sp

N = 7
NAMES = ["delta", "four_bar", "geared_five_bar", "rssr", "screw_press", "stewart"]


def moving(name, speed=0.6):
    mech = sp.load(name)
    driver = next(iter(mech.drivers))
    start = sp.assemble(mech).coordinate(driver).value
    size = 0.2 if mech.coordinate(driver).unit == "rad" else 0.01
    return mech, sp.sweep(mech, driver, np.linspace(start, start + size, N), speed=speed)


def same(loads, k, found):
    """Sample k of the loads is what was found at its State."""
    size = max(np.abs(x.vector).max() for x in found.reactions.values()) or 1.0
    for name, reaction in found.reactions.items():
        np.testing.assert_allclose(loads.reactions[name][k], reaction.vector, atol=1e-12 * size)
        assert np.array_equal(loads.unique[name][k], found.unique[name])
        assert loads.determined[name][k] == found.determined[name]
    np.testing.assert_allclose(loads.on_ground[k], found.on_ground.vector, atol=1e-12 * size)
    np.testing.assert_allclose(loads.a[k], found.a, atol=1e-12 * np.abs(found.a).max())
    largest = np.abs(found.multipliers).max(initial=0.0)
    np.testing.assert_allclose(loads.multipliers[k], found.multipliers, atol=1e-12 * largest)


@pytest.mark.parametrize("name", NAMES)
def test_efforts_of_a_motion_are_those_of_its_states(name):
    mech, motion = moving(name)
    loads = sp.inverse_dynamics(mech, motion)
    other = sp.kinetostatics(mech, motion)
    for k in (0, N - 1):
        found = sp.inverse_dynamics(mech, motion.state(k))
        same(loads, k, found)
        for driver, effort in found.efforts.items():
            assert loads.efforts[driver][k] == pytest.approx(effort, rel=1e-12, abs=1e-12)
            assert np.array_equal(loads.efforts[driver], other.efforts[driver])


@pytest.mark.parametrize("name", NAMES)
def test_accelerations_under_efforts_that_change_are_those_of_the_states(name):
    mech, motion = moving(name)
    driver = next(iter(mech.drivers))
    efforts = np.linspace(-0.2, 0.4, N)
    loads = sp.forward_dynamics(mech, motion, {driver: efforts})
    assert loads.efforts[driver] == pytest.approx(efforts, abs=0.0)
    for k in (0, 3, N - 1):
        same(loads, k, sp.forward_dynamics(mech, motion.state(k), {driver: float(efforts[k])}))


def test_a_motion_without_speed_is_at_rest():
    mech, motion = moving("delta", speed=None)
    rest = sp.forward_dynamics(mech, motion)
    found = sp.forward_dynamics(mech, sp.State(mech, motion.q[2]))
    assert rest.a[2] == pytest.approx(found.a, rel=1e-12, abs=1e-12 * np.abs(found.a).max())


@pytest.mark.parametrize("verb", [sp.forward_dynamics, sp.inverse_dynamics])
def test_forces_from_outside_are_rows_or_a_function(verb):
    mech, motion = moving("delta")
    rows = np.random.default_rng(0).standard_normal((N, 6))
    link = mech.links[-1]
    by_rows = verb(mech, motion, external={link: rows})
    by_law = verb(mech, motion, external=lambda t, state: {
        link: pin.Force(np.array([np.interp(t, motion.time, x) for x in rows.T]))})
    by_state = verb(mech, motion, external=lambda state: {link: pin.Force(rows[4])})
    same(by_rows, 4, verb(mech, motion.state(4), external={link: pin.Force(rows[4])}))
    for name, x in by_rows.reactions.items():
        np.testing.assert_allclose(by_law.reactions[name], x, atol=1e-9)
        np.testing.assert_allclose(by_state.reactions[name][4], x[4], atol=1e-9)


@pytest.mark.parametrize("spring", [
    'frames = ["tip", "ground"]\nfree_length = 0.1\ndamping = 2.0\n', 'joint = "crank"\n'])
def test_springs_act_over_motions_too(tmp_path, spring):
    mech = heavy_four_bar(tmp_path, f'[[springs]]\nname = "s"\nstiffness = 300.0\n{spring}')
    start = next(iter(mech.drivers), mech.coordinates[0])
    motion = sp.sweep(mech, start, np.linspace(1.0, 1.3, N), speed=2.0)
    loads, needed = sp.forward_dynamics(mech, motion), sp.inverse_dynamics(mech, motion, [start])
    same(loads, 5, sp.forward_dynamics(mech, motion.state(5)))
    same(needed, 5, sp.inverse_dynamics(mech, motion.state(5), [start]))


def test_derivatives_of_a_motion_are_those_of_its_states():
    mech, motion = moving("delta")
    driver = next(iter(mech.drivers))
    efforts = np.linspace(0.0, 1.0, N)
    all_of, k = sp.dynamics_derivatives(mech, motion, {driver: efforts}), 3
    one = sp.dynamics_derivatives(mech, motion.state(k), {driver: float(efforts[k])})
    for name in ("a", "a_by_q", "a_by_v", "a_by_effort", "rows", "multipliers",
                 "multipliers_by_q", "multipliers_by_v", "multipliers_by_effort"):
        assert np.array_equal(getattr(all_of, name)[k], getattr(one, name)), name
    pair = next(iter(one.reactions))
    np.testing.assert_array_equal(all_of.reactions[pair].by_q[k], one.reactions[pair].by_q)
    np.testing.assert_array_equal(all_of.on_ground.by_v[k], one.on_ground.by_v)
    assert repr(all_of).endswith(f"at {N} samples)")


def test_an_array_of_another_length_is_refused():
    mech, motion = moving("delta")
    driver, link = next(iter(mech.drivers)), mech.links[-1]
    with pytest.raises(ValueError, match=r"effort at .* has shape"):
        sp.forward_dynamics(mech, motion, {driver: np.zeros(N + 1)})
    with pytest.raises(ValueError, match=r"external force at .* has shape"):
        sp.inverse_dynamics(mech, motion, external={link: np.zeros((N, 3))})
    with pytest.raises(TypeError, match="external is a function, which needs a Motion"):
        sp.forward_dynamics(mech, motion.state(0), external=lambda state: {})
    with pytest.raises(sp.SpatialPinError, match="a function of the time, and the motion has none"):
        still = sp.sweep(mech, driver, [motion.driver[0]])
        sp.forward_dynamics(mech, still, external=lambda t, state: {})


def test_an_uneven_rod_turns_about_its_line_as_forces_make_it_over_a_motion_too():
    mech, _ = moving("rssr")
    joint = mech.model.getJointId("ball_a")
    rod = mech.model.inertias[joint]
    mech.model.inertias[joint] = pin.Inertia(
        rod.mass, rod.lever, rod.inertia + np.diag([1e-3, 0.0, 0.0]))
    motion = sp.sweep(mech, "crank", np.linspace(0.0, 0.6, N), speed=6.0)
    twist = {"coupler": pin.Force(np.zeros(3), np.array([0.01, 0.02, 0.03]))}
    for external in (None, twist):
        loads = sp.inverse_dynamics(mech, motion, external=external)
        free = sp.forward_dynamics(mech, motion, loads.efforts, external=external)
        assert np.abs(loads.a - motion.a).max() > 1.0  # it is free
        np.testing.assert_allclose(loads.a, free.a, atol=1e-11 * np.abs(free.a).max())
        same(loads, 3, sp.inverse_dynamics(mech, motion.state(3), external=external))


def test_a_twist_on_a_rod_that_nothing_holds_is_refused_at_rest():
    mech, _ = moving("rssr")
    motion = sp.sweep(mech, "crank", np.linspace(0.0, 0.6, N))
    twist = {"coupler": pin.Force(np.zeros(3), np.array([0.01, 0.02, 0.03]))}
    with pytest.raises(sp.SpatialPinError, match="carries load"):
        sp.inverse_dynamics(mech, motion, external=twist)


@pytest.mark.parametrize("away", [1.0, 1e-2, 1e-4, 1e-6])
def test_the_error_of_efforts_bounds_how_far_they_are_from_the_balance_of_power(away):
    """Towards a dead centre of the rocker, which drives, its torque loses digits."""
    mech = sp.load("four_bar")
    turn = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 721))
    rocker = turn.coordinate("rocker_pin").value
    dead = turn.driver[int(np.argmax(rocker))]
    motion = sp.sweep(mech, "crank", dead + away * np.linspace(0.5, 1.0, N), speed=3.0)
    for k in (0, N - 1):
        state = motion.state(k)
        found = sp.inverse_dynamics(mech, state, actuated=["rocker_pin"])
        power = state.v @ pin.rnea(mech.model, mech.model.createData(), state.q, state.v, state.a)
        speed = state.coordinate("rocker_pin").rate
        off = abs(found.efforts["rocker_pin"] * speed / power - 1.0)
        assert off <= found.error + 1e-14 / min(1.0, abs(speed))  # the rates have errors too
        assert found.error < 1e-11 / min(1.0, abs(speed))
    loads = sp.inverse_dynamics(mech, motion, actuated=["rocker_pin"])
    assert loads.error[-1] == pytest.approx(found.error)


def test_accelerations_over_a_motion_have_the_error_that_each_state_has():
    mech, motion = moving("stewart")
    loads = sp.forward_dynamics(mech, motion)
    assert loads.error.shape == (N,)
    for k in (0, N - 1):
        want = sp.forward_dynamics(mech, motion.state(k)).error
        assert loads.error[k] == pytest.approx(want) and 0.0 < want < 1e-10


@pytest.mark.parametrize("law", [None, lambda length, rate: 30.0 * length**2 + rate])
def test_springs_between_frames_and_bushings_over_a_motion(law):
    """By a law of the user they are solved State by State, otherwise together."""
    bare = sp.load("four_bar")
    mech = sp.Mechanism.from_model(
        bare.model, bare.closures, drivers={"crank": "crank_pin"}, guess=bare.guess, springs=[
            sp.Spring("line", ("rocker_b", "ground"), stiffness=50.0, damping=3.0,
                      free_length=0.1),
            sp.Spring("inner", ("coupler", "rocker"), stiffness=20.0, damping=2.0),
            sp.Spring("bushing", ("crank", "rocker"), stiffness=(10.0, 20.0, 30.0, 1.0, 2.0, 3.0),
                      damping=(1.0, 2.0, 3.0, 0.1, 0.2, 0.3), preload=(1.0, 0, 2.0, 0, 0.3, 0))])
    laws = {"line": law} if law else None
    motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.0, N), speed=8.0)
    loads = sp.inverse_dynamics(mech, motion, laws=laws)
    moved = sp.forward_dynamics(mech, motion, {"crank": 0.3}, laws=laws)
    for k in (0, 3, N - 1):
        found = sp.inverse_dynamics(mech, motion.state(k), laws=laws)
        same(loads, k, found)
        assert loads.efforts["crank"][k] == pytest.approx(found.efforts["crank"], rel=1e-12)
        same(moved, k, sp.forward_dynamics(mech, motion.state(k), {"crank": 0.3}, laws=laws))
