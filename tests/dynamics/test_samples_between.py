"""Samples of a simulation that lie on polynomials between others: what loose settings save."""

import numpy as np
import pytest

import spatial_pin as sp

LOOSE = sp.Accuracy(tolerance=1e-10, time_tolerance=1e-8)


def moving(name):
    mech = sp.load(name)
    (driver,) = mech.drivers
    return mech, sp.solve_rates(mech, sp.assemble(mech), {driver: 1.0})


def largest(found, exact):
    return np.abs(found - exact).max() / max(np.abs(exact).max(), 1e-300)


def test_the_looser_the_closure_the_more_samples_are_left_open():
    """Those that are worked out are closed to round-off."""
    mech, state = moving("four_bar")
    none, some, most = ((sp.simulate(mech, state, 1.5, accuracy=sp.Accuracy(
        tolerance=tolerance, time_tolerance=1e-10)).closure_error > 1e-13).sum()
        for tolerance in (1e-12, 1e-8, 1e-6))
    assert none == 0
    assert 100 < some < most
    assert most > 700  # of 1001 samples


@pytest.mark.parametrize("name", ["delta", "stewart"])
def test_samples_of_several_freedoms_lie_between_others_in_time(name):
    """They are off by less than the tolerance, accelerations by a hundred times as much."""
    mech, looser = sp.load(name), sp.Accuracy(tolerance=1e-6, time_tolerance=1e-9)
    state, times = sp.assemble(mech), np.linspace(0.0, 0.2, 401)
    fast, exact = (sp.simulate(mech, state, 0.2, times=times, accuracy=accuracy)
                   for accuracy in (looser, sp.Accuracy(time_tolerance=1e-12)))
    assert (fast.closure_error > 1e-10).sum() > 100  # the others are closed like steps
    assert fast.closure_error.max() < looser.tolerance
    for found, wanted, allowed in ((fast.q, exact.q, 1.0), (fast.v, exact.v, 10.0),
                                   (fast.a, exact.a, 100.0)):
        assert largest(found, wanted) < allowed * looser.tolerance
    assert fast.energy_drift < 1e-5


@pytest.mark.parametrize("jump", [0.7, 0.7005])  # at a sample, and between two
def test_where_an_effort_jumps_accelerations_are_those_of_the_time_itself(jump):
    mech, state = moving("four_bar")
    (driver,) = mech.drivers

    def efforts(t, _):
        return {driver: 5.0 if t >= jump else 0.0}

    motion = sp.simulate(mech, state, 1.4, efforts, accuracy=LOOSE)
    for k in range(480, 521):
        acting = efforts(motion.time[k], None)
        there = sp.forward_dynamics(mech, motion.state(k), acting).state
        assert largest(motion.a[k], there.a) < 1e-11
