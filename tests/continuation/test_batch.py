"""Many driver values at once: a branch does not depend on which of them are asked for."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from loaded_library import library
from sameness import assert_same
from variety import paired

import spatial_pin as sp


@pytest.mark.parametrize("name", ["rssr", "rssr_crossed", "swash_plate"])
def test_a_passive_spin_does_not_depend_on_the_rows(name):
    mechanism = library(name)
    driver = next(iter(mechanism.drivers))
    fine = sp.sweep(mechanism, driver, np.linspace(0.0, 2.0 * np.pi, 3001))
    coarse = sp.sweep(mechanism, driver, np.linspace(0.0, 2.0 * np.pi, 301))
    assert_same(coarse.q, fine.q[::10], 1e-11)


@pytest.mark.parametrize(("name", "rows"), paired(
    ["rssr", "rssr_crossed", "swash_plate"],
    [[0, 3000], [0, 400, 401, 1900, 3000], range(0, 3001, 200), [0, 1700, 1300, 2800]]))
def test_a_passive_spin_is_exact_however_few_the_rows_are(name, rows):
    """Over one row of a whole turn, too."""
    mechanism = library(name)
    driver = next(iter(mechanism.drivers))
    fine = sp.sweep(mechanism, driver, np.linspace(0.0, 2.0 * np.pi, 3001))
    rows = list(rows)
    assert_same(sp.sweep(mechanism, driver, fine.driver[rows]).q, fine.q[rows], 1e-10)


@pytest.mark.parametrize(("name", "tolerance"), paired(
    ["bennett", "bricard", "sarrus", "rssr", "swash_plate"],
    [1e-4, 1e-6, 1e-8, 1e-10, 1e-13, 1e-15]))
def test_any_tolerance_follows_the_branch(name, tolerance):
    """Loops with redundant rows are closed to 1e-12 whatever is asked: open ones hide them."""
    mechanism = library(name)
    driver = next(iter(mechanism.drivers))
    values = sp.assemble(mechanism).coordinate(driver).value + np.linspace(0.0, 1.0, 300)
    motion = sp.sweep(mechanism, driver, values, accuracy=sp.Accuracy(tolerance=tolerance))
    exact = sp.sweep(mechanism, driver, values)
    floor = max(2e-15, mechanism.closure_resolution)  # no smaller closure error is told
    assert motion.closure_error.max() <= max(tolerance, floor)
    assert_same(motion.q, exact.q, max(10 * tolerance, 1e-12))


@pytest.mark.delicate
@pytest.mark.parametrize(("rows", "begin"), paired([60, 361, 2000], [0.4, 0.8, 1.3]))
def test_branches_that_cross_twice_at_one_place_are_not_passed_unnoticed(rows, begin):
    """Sarrus' linkage lies flat at 0 and π/2: the determinant keeps its sign there."""
    mechanism = library("sarrus")
    for end, crossing in ((-2.0, 0.0), (2.5, np.pi / 2)):
        motion = sp.sweep(mechanism, "arm", np.linspace(begin, end, rows), on_crossing="stop")
        assert [e.kind for e in motion.events] == ["branch point"]
        assert motion.events[0].value == pytest.approx(crossing, abs=1e-9)
        assert abs(motion.driver[-1] - crossing) < 1.01 * abs(begin - end) / (rows - 1)


def test_a_state_as_guess_says_where_the_other_drivers_are_held():
    """Not only where the first value is the state's own."""
    mechanism = library("stewart")
    state = sp.assemble(mechanism)
    here = state.coordinate("leg_1").value
    for first in (here, here + 0.01):
        motion = sp.sweep(mechanism, "leg_1", [first, here + 0.02], guess=state)
        for leg in list(mechanism.drivers)[1:]:
            assert motion.coordinate(leg).value == pytest.approx(state.coordinate(leg).value)
    motion = sp.sweep(mechanism, "leg_1", [here], guess=state, hold={"leg_2": here + 0.01})
    assert motion.coordinate("leg_2").value == pytest.approx(here + 0.01)


def test_the_guess_may_change():
    mechanism = library("four_bar")
    values = [0.5, 0.6]
    one = sp.sweep(mechanism, "crank", values)
    other = sp.assembly_modes(mechanism, {"crank": 0.5})[0]
    if np.allclose(other.q, one.q[0]):
        other = sp.assembly_modes(mechanism, {"crank": 0.5})[1]
    mechanism.guess.clear()
    mechanism.guess.update({name: other.coordinate(name).value for name in mechanism.coordinates})
    assert np.abs(sp.sweep(mechanism, "crank", values).q[0] - other.q).max() < 1e-12
    assert np.abs(one.q[0] - other.q).max() > 0.1


def test_what_names_do_not_exist_or_are_held_is_refused_every_time():
    mechanism = library("rssr")
    for _ in range(2):
        with pytest.raises(ValueError, match="is held"):
            sp.sweep(mechanism, "crank", [0.0], hold=["crank_pin"])
        with pytest.raises(sp.UnknownNameError):
            sp.sweep(mechanism, "crank", [0.0], hold=["nothing"])


def test_events_are_looked_for_on_request():
    """Copies have them, and what has no other name is no attribute."""
    mechanism = library("four_bar", r2=0.25)
    motion = sp.sweep(mechanism, "crank", [0.0, 2.4751083])
    for twin in (pickle.loads(pickle.dumps(motion)), copy.deepcopy(motion), copy.copy(motion)):
        assert twin.events == motion.events
    with pytest.raises(AttributeError, match="no attribute 'event'"):
        _ = motion.event
    assert [e.kind for e in motion.events] == ["near limit"]
