"""A mechanism of a single equation loses it like any other: where the row itself vanishes."""

import mechanisms as known
import numpy as np
import pytest
from loaded_library import library
from mechanisms import four_bar
from variety import paired

import spatial_pin as sp

TURN = np.linspace(0.5, 7.0, 50)
NUMBERS = pytest.mark.parametrize("numbers", [
    [5, 6, 11, 24, 59], pytest.param(range(5, 61), marks=pytest.mark.slow)],
    ids=["a few", "every number"])
pytestmark = pytest.mark.delicate


@pytest.fixture(scope="module")
def parallelogram():
    return four_bar(r1=0.4, r2=0.12, r3=0.4, r4=0.12)


@pytest.fixture(scope="module")
def one_distance(parallelogram):
    reduced = sp.reduce(parallelogram, "rocker_pin")
    assert (len(reduced.coordinates), len(reduced.closures)) == (2, 1)
    return reduced


def test_both_pass_the_same_change_points(parallelogram, one_distance):
    for values in (TURN, np.linspace(0.5, 7.0, 2000)):
        full, small = (sp.sweep(m, "crank", values) for m in (parallelogram, one_distance))
        assert [e.kind for e in small.events] == ["branch point"] * 2
        places = [e.value for e in small.events]
        assert np.allclose(places, [np.pi, 2.0 * np.pi], rtol=0.0, atol=1e-9)
        for got, expected in zip(small.coordinate("rocker_pin"), full.coordinate("rocker_pin"),
                                 strict=True):
            assert np.abs(got - expected).max() < 1e-10


def test_both_stop_there_on_request(parallelogram, one_distance):
    rows = {len(sp.sweep(m, "crank", TURN, on_crossing="stop"))
            for m in (parallelogram, one_distance)}
    assert rows == {int(np.count_nonzero(np.pi > TURN))}


def test_the_ends_of_the_branch_are_the_same(parallelogram, one_distance):
    for mechanism in (parallelogram, one_distance):
        ends = sp.limits(mechanism, "crank", guess={"crank_pin": 1.0})
        assert [end.kind for end in (ends.lower, ends.upper)] == ["branch point"] * 2
        assert abs(ends.lower.value) < 1e-9
        assert abs(ends.upper.value - np.pi) < 1e-9


@NUMBERS
@pytest.mark.parametrize("accuracy", ["reference", "draft"])
@pytest.mark.parametrize("off", [0.0, 0.1])
def test_however_far_from_a_change_point_the_values_are_none_takes_the_other_branch(
        accuracy, off, numbers):
    """The kite folds, or its rocker stays: the branches cross at 26 degrees."""
    kite = library("four_bar", r1=0.3, r2=0.1, r3=0.1, r4=0.3)
    reduced = sp.reduce(kite, "rocker_pin")
    assert len(reduced.closures) == 1
    for n in numbers:
        values = np.linspace(np.pi - 1.0 + off, np.pi + 1.0, n)
        motion = sp.sweep(reduced, "crank", values, accuracy=sp.Accuracy.named(accuracy))
        assert [e.kind for e in motion.events] == ["branch point"], n
        assert motion.events[0].value == pytest.approx(np.pi, abs=1e-9)
        tip = 0.1 * np.exp(1j * motion.driver)  # which mirrors the rocker's pivot, at 0.3
        rocker = np.unwrap(2.0 * np.angle((tip - 0.3) / (tip[0] - 0.3)))
        found = motion.coordinate("rocker_pin").value
        assert np.abs(found - found[0] - rocker).max() < 1e-6, n


@NUMBERS
@pytest.mark.parametrize("accuracy", ["reference", "draft"])
def test_however_far_from_a_change_point_the_values_are_it_is_passed(
        one_distance, accuracy, numbers):
    for n in numbers:
        values = np.linspace(0.5, 2.0 * np.pi + 1.0, n)
        motion = sp.sweep(one_distance, "crank", values, accuracy=sp.Accuracy.named(accuracy))
        assert [e.value for e in motion.events] == pytest.approx([np.pi, 2.0 * np.pi], abs=1e-9), n
        rocker = motion.coordinate("rocker_pin").value
        assert np.abs(rocker - rocker[0] - values + values[0]).max() < 1e-6, n


def test_the_link_that_a_vanished_row_frees_is_not_taken_as_passive(one_distance):
    flat = sp.assemble(one_distance, {"crank": 0.0}, {"crank_pin": 0.0, "rocker_pin": 0.0})
    with pytest.raises(sp.SingularError, match="lose 1 independent equation"):
        sp.solve_rates(one_distance, flat, {"crank": 1.0})


@pytest.mark.parametrize(("tolerance", "before"), paired([1e-2, 1e-4, 1e-6, 1e-9],
                                                         [0.0, 1e-12, 1e-9, 1e-6]))
@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_coarse_tolerance_is_none_to_be_refused_for(side, before, tolerance, tmp_path):
    """At a dead centre, where Newton's steps only halve the way, as anywhere."""
    mechanism = known.arm_on_a_ram(tmp_path)
    limit = getattr(sp.limits(mechanism, "ram"), side).value
    inside = limit + before * (1.0 if side == "lower" else -1.0)
    state = sp.assemble(mechanism, {"ram": inside}, accuracy=sp.Accuracy(tolerance=tolerance))
    assert state.closure_error < 1e-11
