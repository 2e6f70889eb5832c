"""How uncertain rates are is told: beside change points too, where nothing moves fast."""

import numpy as np
import pytest
from loaded_library import library
from mechanisms import four_bar
from variety import few

import spatial_pin as sp

pytestmark = pytest.mark.delicate
EXACT = np.array([1.0, -1.0, 1.0])  # of a parallelogram: crank, coupler, rocker


@pytest.mark.parametrize("angle", few(
    [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, np.pi - 1e-5], 1e-6, 1e-3, 1.0, np.pi - 1e-5))
def test_the_rates_of_a_parallelogram_are_as_good_as_reported(angle):
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


def test_where_it_is_reported_it_is_not_reported_far_too_large():
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


def test_rates_of_a_traced_curve_near_its_branch_points_are_as_good_as_reported():
    """They are solved there, not continued: a Sarrus linkage's angles are linear in its first."""
    motion = sp.trace(library("sarrus"), "arm", step=0.05, most_rows=400)
    assert [e.kind for e in motion.events[:-1]] == ["branch point"] * 4
    rows = range(0, len(motion) - 1)
    told = np.array([motion.state(k).rate_error for k in rows])
    exact = np.array([1.0, -2.0, 1.0, 1.0, -2.0]) / np.sqrt(11.0)
    off = np.abs(motion.v[rows] - exact).max(axis=1) / np.abs(exact).max()
    bend = np.abs(motion.a[rows]).max(axis=1) / np.abs(exact).max() ** 2  # exact: 0
    assert np.all(np.maximum(off, bend) <= 10.0 * np.maximum(told, 1e-15))
    assert 1e-9 < told.max() < 1e-5 and np.median(told) < 2e-13  # 7e-14 to 1.1e-13 by processor
