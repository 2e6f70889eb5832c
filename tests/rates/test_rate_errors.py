"""How uncertain rates are is told: beside change points too, where nothing moves fast."""

import numpy as np
import pytest
from mechanisms import four_bar

import spatial_pin as sp
from spatial_pin.accuracy.exact import ExactRows

EXACT = np.array([1.0, -1.0, 1.0])  # of a parallelogram: crank, coupler, rocker


@pytest.mark.parametrize("angle", [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, np.pi - 1e-5])
def test_the_rates_of_a_parallelogram_are_as_good_as_is_said(angle):
    mech = four_bar(r1=0.4, r2=0.12, r3=0.4, r4=0.12)
    # from the side of the branch that goes on as a parallelogram
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": angle}, {
        "crank_pin": angle, "rocker_pin": angle}), {"crank": 1.0})
    off = np.abs(state.v - EXACT).max()
    bend = np.abs(state.a).max()  # exact: 0
    assert off <= max(state.rate_error, 1e-15)
    assert bend / max(1.0, bend) <= max(state.rate_error, 1e-14)
    if angle == 1.0:
        assert state.rate_error < 1e-13


def test_where_it_is_told_it_is_not_told_a_lot_too_large():
    mech = four_bar(r1=0.4, r2=0.12, r3=0.4, r4=0.12)
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1e-3}), {"crank": 1.0})
    assert state.rate_error < 1e-4


def test_rows_that_are_continued_across_a_change_point_know_their_rates():
    mech = four_bar(r1=0.4, r2=0.12, r3=0.4, r4=0.12)
    start = sp.assemble(mech, {"crank": 0.5}, {"crank_pin": 0.5, "rocker_pin": 0.5})
    values = np.linspace(0.5, -0.5, 51)
    motion = sp.sweep(mech, "crank", values, guess=start)
    assert np.abs(motion.v - EXACT).max() < 1e-10
    assert max(motion.state(k).rate_error for k in range(51)) < 1e-6
    near = [0.5, 1e-2]
    stopped = sp.sweep(mech, "crank", [*near, -0.5], guess=start, on_crossing="stop")
    assert len(stopped) == 2
    last = stopped.state(1)
    assert np.abs(last.v - EXACT).max() <= last.rate_error


def test_rates_near_a_crossing_where_nothing_moves_fast_are_as_good_as_is_said():
    """Next to the flat place of a Sarrus linkage accelerations lose the third power of a pivot."""
    mech = sp.load("sarrus")
    arm = mech.prescribed_coordinate("arm")
    guess = sp.assemble(mech)
    for angle in np.geomspace(0.3, 1e-3, 12):
        guess = sp.assemble(mech, {"arm": angle}, guess)
        state = sp.solve_rates(mech, guess, {"arm": 1.0})
        rows = ExactRows(mech, [arm], np.array([[angle]]), np.ones(1), np.zeros(1))
        exact = rows.near(state.q[None], np.zeros((1, 0)))
        bend = max(1.0, float(np.abs(exact.a).max()))
        assert np.abs(state.v - exact.v[0]).max() <= state.rate_error * np.abs(exact.v).max()
        assert np.abs(state.a - exact.a[0]).max() <= state.rate_error * bend
    assert 1e-9 < state.rate_error < 1e-5


def test_rates_of_a_traced_curve_near_its_branch_points_are_as_good_as_is_said():
    """They are solved there, not continued: a Sarrus linkage's angles are linear in its first."""
    motion = sp.trace(sp.load("sarrus"), "arm", step=0.05, most_rows=400)
    assert [e.kind for e in motion.events[:-1]] == ["branch point"] * 4
    rows = range(0, len(motion) - 1)
    told = np.array([motion.state(k).rate_error for k in rows])
    exact = np.array([1.0, -2.0, 1.0, 1.0, -2.0]) / np.sqrt(11.0)
    off = np.abs(motion.v[rows] - exact).max(axis=1) / np.abs(exact).max()
    bend = np.abs(motion.a[rows]).max(axis=1) / np.abs(exact).max() ** 2  # exact: 0
    assert np.all(np.maximum(off, bend) <= 10.0 * np.maximum(told, 1e-15))
    assert 1e-9 < told.max() < 1e-5 and np.median(told) < 1e-13


@pytest.mark.parametrize("first, n", [(0.3, 400), (0.05, 151)])
@pytest.mark.parametrize("name", ["bennett", "bricard", "four_bar", "rssr"])
def test_rates_of_samples_are_as_good_as_is_said(name, first, n):
    """Samples are not closed to round-off, nor solved by the equations that are best there."""
    mech = sp.load(name)
    driver = mech.prescribed_coordinate(*mech.drivers)
    values = np.linspace(first, first + 6.2, n)
    motion = sp.sweep(mech, driver.name, values, on_limit="stop")
    n, size = len(motion), mech.velocity_scale
    exact = ExactRows(mech, [driver], values[:n, None], np.ones(n), np.zeros(n)).near(
        motion.q, np.zeros((n, 0)))
    assert n > 50 and exact.good.all()
    v, a = (np.abs(x / size).astype(float) for x in (exact.v, exact.a))
    pace = v.max(axis=1)
    bend = np.maximum(pace**2, a.max(axis=1))
    off = np.maximum(np.abs((motion.v - exact.v) / size).max(axis=1) / pace,
                     np.abs((motion.a - exact.a) / size).max(axis=1) / bend)
    told = np.array([motion.state(k).rate_error for k in range(n)])
    assert np.all(off <= told)
    assert np.median(told) < 2e-14
