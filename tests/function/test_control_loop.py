"""A mechanism in a control loop: the numbers of the other verbs, in the same arrays each tick."""

import gc
import pickle
import tracemalloc

import mechanisms as known
import numpy as np
import pytest
from loaded_library import library
from masses import heavy
from variety import each

import spatial_pin as sp


def near(ours, theirs, scale=0.0):
    size = max(np.abs(theirs).max(initial=0.0), scale)
    return np.abs(ours - theirs).max(initial=0.0) <= 1e-12 * size


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_numbers_are_those_of_the_other_verbs(name):
    mech = library(name)
    frames, drivers = mech.links[-2:], list(mech.drivers)
    loop = sp.ControlLoop(mech, frames=frames)
    scale = mech.velocity_scale[[mech.coordinate(d).v for d in drivers]]
    home = np.array([loop.state.coordinate(d).value for d in drivers])
    rng = np.random.default_rng(0)
    for k in range(4):
        x = home + 0.02 * scale * np.sin(0.7 * k + np.arange(len(drivers)))
        rates, accelerations = (scale * rng.normal(size=len(drivers)) for _ in range(2))
        loop.update(x, rates)
        state = sp.solve_rates(mech, loop.state, dict(zip(drivers, rates, strict=True)),
                               dict(zip(drivers, accelerations, strict=True)))
        assert [state.coordinate(d).value for d in drivers] == pytest.approx(x, abs=1e-15)
        assert sp.State(mech, loop.q).closure_error <= 1e-13
        assert near(loop.v, state.v)
        assert all(near(loop.jacobians[f], sp.jacobian(mech, state, f)) for f in frames)
        known = sp.influence(mech, state)
        assert near(loop.influence.first, known.first)
        assert near(loop.influence.second, known.second, 1.0)
        efforts = sp.inverse_dynamics(mech, state).efforts
        ours = loop.inertia @ accelerations + loop.velocity_efforts + loop.gravity_efforts
        assert near(ours, np.array([efforts[d] for d in drivers]), 1e-3)


def test_springs_and_damping_act_at_the_motors():
    mech = library("four_bar")
    mech = sp.Mechanism.from_model(
        mech.model, mech.closures, drivers={"crank": "crank_pin"}, guess=mech.guess,
        springs=[sp.Spring("spring", ("rocker_b", "ground"), stiffness=50.0, damping=3.0)])
    loop = sp.ControlLoop(mech)
    loop.update([1.0], [5.0])
    state = sp.solve_rates(mech, loop.state, {"crank": 5.0}, {"crank": 7.0})
    effort = loop.inertia @ [7.0] + loop.velocity_efforts + loop.gravity_efforts
    assert effort == pytest.approx([*sp.inverse_dynamics(mech, state).efforts.values()], rel=1e-12)


WEIGHT = (1.0, (0.01, 0.02, 0.03), (0.02, 0.03, 0.04))


def with_all_forces(folder):
    """Gears, a screw that moves a nut, and springs, dampers and a bushing."""
    tree = heavy(
        known.turning("pinion", "ground", "g1")
        + known.turning("wheel", "ground", "g2", (0.06, 0, 0))
        + known.sliding("rack", "ground", "r", (0, -0.02, 0), (1, 0, 0))
        + known.turning("spindle", "ground", "s", (0, 0.1, 0))
        + known.sliding("slide", "ground", "nut", (0, 0.1, 0.05)),
        **dict.fromkeys(("g1", "g2", "r", "s", "nut"), WEIGHT))
    tree += known.point("hook", "ground", (0.1, 0.4, 0.2))
    tree += known.point("eye", "nut", (0.1, 0, 0.1))
    tree += known.point("bolt", "s") + known.point("thread", "nut")
    toml = (known.driver("pinion", "pinion") + known.driver("spindle", "spindle")
            + known.coupling("teeth", "pinion", "wheel", -0.4, 0.25)
            + known.coupling("rack_teeth", "pinion", "rack", 0.02, -0.003)
            + known.closure("screw", "screw", "bolt", "thread", lead=0.01))
    for name, what in (("a", 'joint = "wheel"\nstiffness = 9.0\ndamping = 0.5'),
                       ("b", 'joint = "slide"\nstiffness = 90.0\ndamping = 5.0'),
                       ("c", 'frames = ["hook", "eye"]\nstiffness = 80.0\ndamping = 4.0'),
                       ("d", 'frames = ["g2", "r"]\n'
                             "stiffness = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]\n"
                             "damping = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]")):
        toml += f'[[springs]]\nname = "{name}"\n{what}\n'
    return known.load(folder, "all_forces", tree, toml)


def test_springs_dampers_and_bushings_need_no_memory(tmp_path):
    mech = with_all_forces(tmp_path)
    loop = sp.ControlLoop(mech, frames=["nut"])
    x, v = np.zeros(2), np.array([2.0, 3.0])
    for k in range(1100):
        if k == 100:  # the first calls have filled what is reused
            gc.collect()
            gc.disable()
            tracemalloc.start()
            loop.update(x, v)
            before = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
        x[:] = 1e-3 * k
        loop.update(x, v)
    now, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    gc.enable()
    assert now - before < 500
    assert peak - before < 2000
    accelerations = [5.0, 7.0]
    state = sp.solve_rates(mech, loop.state, dict(zip(loop.drivers, v, strict=True)),
                           dict(zip(loop.drivers, accelerations, strict=True)))
    effort = loop.inertia @ accelerations + loop.velocity_efforts + loop.gravity_efforts
    assert effort == pytest.approx([*sp.inverse_dynamics(mech, state).efforts.values()], rel=1e-12)


def ticks(loop, n, start=0):
    drivers, rates = np.zeros(3), np.ones(3)
    for k in range(start, start + n):
        drivers[:] = 0.1 * np.sin(0.001 * k)
        loop.update(drivers, rates)


def test_memory_stays_constant():
    loop = sp.ControlLoop(library("delta"), frames=["platform"])
    arrays = [loop.q, loop.v, loop.inertia, loop.jacobians["platform"], loop.influence.second]
    ticks(loop, 50)
    gc.collect()
    tracemalloc.start()
    ticks(loop, 150, 50)
    before = tracemalloc.get_traced_memory()[0]
    ticks(loop, 500, 200)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 2000
    assert all(a is b for a, b in zip(arrays, (
        loop.q, loop.v, loop.inertia, loop.jacobians["platform"], loop.influence.second),
        strict=True))


def test_a_tick_needs_little_memory_of_its_own():
    loop = sp.ControlLoop(library("stewart"), frames=["platform"])
    home = np.array([loop.state.coordinate(d).value for d in loop.drivers])
    for k in range(3):
        loop.update(home + 1e-3 * k, np.ones(6))
    tracemalloc.start()
    loop.update(home, np.ones(6))
    before = tracemalloc.get_traced_memory()[0]
    tracemalloc.reset_peak()
    loop.update(home + 1e-3, np.ones(6))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak - before < loop.influence.second.nbytes


def test_drivers_that_jump_stay_on_the_branch():
    mech = library("four_bar")
    loop = sp.ControlLoop(mech)
    loop.update({"crank": 6.0})
    motion = sp.sweep(mech, "crank", np.linspace(loop.state.q[0] * 0.0, 6.0, 61))
    assert loop.q == pytest.approx(motion.q[-1], abs=1e-12)


def test_an_update_that_fails_changes_nothing():
    mech = library("four_bar", r2=0.25)
    loop = sp.ControlLoop(mech)
    loop.update([1.0], [2.0])
    known = [x.copy() for x in (loop.q, loop.v, loop.inertia, loop.influence.first)]
    with pytest.raises(sp.LimitError, match="the control loop keeps its last configuration"):
        loop.update([3.0])
    with pytest.raises(ValueError, match="NaN"):
        loop.update([np.nan])
    for wrong in ([1.0, 2.0], "abc", None, [[1.0]], {"crank": "fast"}, 1.0):
        with pytest.raises(ValueError, match="a number for each of crank, in this order or by "):
            loop.update(wrong)
    with pytest.raises(sp.UnknownNameError, match="did you mean 'crank'"):
        loop.update({"crnk": 1.0})
    for ours, before in zip((loop.q, loop.v, loop.inertia, loop.influence.first), known,
                            strict=True):
        assert np.array_equal(ours, before)
    loop.update([1.05], [2.0])
    assert loop.state.coordinate("crank").value == 1.05


def test_the_error_of_rates_grows_towards_a_dead_centre():
    mech = library("four_bar", r2=0.25)
    end = sp.limits(mech, "crank").upper.value
    loop, errors = sp.ControlLoop(mech), []
    for distance in (1.0, 1e-2, 1e-4, 1e-6):
        loop.update([end - distance])
        errors.append(loop.rate_error)
    assert errors == sorted(errors)
    assert errors[0] < 1e-14 < 1e-12 < errors[-1] < 1e-6


def test_it_refuses_to_be_pickled():
    with pytest.raises(TypeError, match="make one of the mechanism in each process"):
        pickle.dumps(sp.ControlLoop(library("four_bar")))
