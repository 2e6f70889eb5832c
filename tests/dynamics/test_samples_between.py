"""Samples of a simulation that lie on polynomials between others: what loose settings save."""

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin.constraints.closure_equations import evaluation_of
from spatial_pin.dynamics.simulation import problem

LOOSE = sp.Accuracy(tolerance=1e-10, time_tolerance=1e-8)
ONE_FREEDOM = ["bennett", "bricard", "four_bar", "geared_five_bar", "peaucellier", "rspc",
               "scotch_yoke", "watt_six_bar"]
# What samples may miss of those worked out in full: ten times what was found, the largest over the
# mechanisms above. Accelerations are those of the integrator's polynomials.
Q, V, A = 1e-9, 2e-7, 2e-5


def moving(name):
    mech = sp.load(name)
    (driver,) = mech.drivers
    return mech, sp.solve_rates(mech, sp.assemble(mech), {driver: 1.0})


def in_full(monkeypatch, *args, **keys):
    """The same simulation, every sample worked out by itself from points as closed."""
    with monkeypatch.context() as patch:
        patch.setattr(problem, "BETWEEN_ANCHORS", np.inf)
        keys["accuracy"] = sp.Accuracy(
            tolerance=1e-12, time_tolerance=keys["accuracy"].time_tolerance)
        return sp.simulate(*args, **keys)


def test_the_integrator_tells_accelerations_of_several_freedoms(monkeypatch):
    mech = sp.load("stewart")
    state = sp.solve_rates(mech, sp.assemble(mech),
                           {name: 0.02 * k - 0.05 for k, name in enumerate(mech.drivers)})
    found = sp.simulate(mech, state, 0.15, accuracy=LOOSE)
    exact = in_full(monkeypatch, mech, state, 0.15, accuracy=LOOSE)
    assert np.array_equal(found.v, exact.v) or largest(found.v, exact.v) < V
    assert 0.0 < largest(found.a, exact.a) < A


def largest(found, exact):
    return np.abs(found - exact).max() / max(np.abs(exact).max(), 1e-300)


@pytest.mark.parametrize("name", ONE_FREEDOM)
def test_samples_between_are_those_worked_out_in_full(name, monkeypatch):
    mech, state = moving(name)
    found = sp.simulate(mech, state, 1.5, accuracy=LOOSE)
    exact = in_full(monkeypatch, mech, state, 1.5, accuracy=LOOSE)
    assert found.closure_error.max() <= LOOSE.tolerance
    assert np.abs(found.q - exact.q).max() < Q
    assert largest(found.v, exact.v) < V
    assert largest(found.a, exact.a) < A
    assert [e.row for e in found.events] == [e.row for e in exact.events]


def test_the_looser_the_closure_the_more_samples_are_left_open():
    """Those that are worked out are closed to round-off."""
    mech, state = moving("four_bar")
    none, some, most = ((sp.simulate(mech, state, 1.5, accuracy=sp.Accuracy(
        tolerance=tolerance, time_tolerance=1e-8)).closure_error > 1e-13).sum()
        for tolerance in (1e-12, 1e-9, 1e-6))
    assert none == 0
    assert 100 < some < most
    assert most > 700  # of 1001 samples


def test_a_sample_between_says_how_open_its_loops_are():
    mech, state = moving("bennett")
    motion = sp.simulate(mech, state, 1.5, accuracy=sp.Accuracy(tolerance=1e-6))
    assert 1e-9 < motion.closure_error.max() <= 1e-6
    for k in (17, 500, 983):
        with evaluation_of(mech, motion.angles[k]) as evaluation:
            evaluation.update(motion.q[k])
            assert abs(evaluation.closure_error - motion.closure_error[k]) < 1e-14


def test_samples_between_turn_back_with_the_motion(monkeypatch):
    """A crank that swings: within a step it turns back, where samples lie between no anchors."""
    mech = sp.load("slider_crank")
    (driver,) = mech.drivers
    state = sp.assemble(mech, {driver: -1.2})
    found = sp.simulate(mech, state, 6.0, accuracy=LOOSE)
    exact = in_full(monkeypatch, mech, state, 6.0, accuracy=LOOSE)
    assert np.any(np.diff(np.sign(found.coordinate(driver).rate)) != 0.0)
    assert np.abs(found.q - exact.q).max() < Q
    assert largest(found.a, exact.a) < A


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
