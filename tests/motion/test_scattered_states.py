"""Configurations at scattered driver values: one branch, whatever the order and the threads."""

from __future__ import annotations

import pickle

import numpy as np
import published_models as models
import pytest
from loaded_library import library
from variety import each, few

import spatial_pin as sp


def scattered(mechanism: sp.Mechanism, n: int, width: float) -> dict[str, np.ndarray]:
    """Return random values of all drivers around the guess [rad, characteristic lengths]."""
    rng, state = np.random.default_rng(2), sp.assemble(mechanism)
    sizes = {d: mechanism.velocity_scale[mechanism.coordinate(d).v] for d in mechanism.drivers}
    return {d: state.coordinate(d).value + size * rng.uniform(-width, width, n)
            for d, size in sizes.items()}


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_each_row_is_that_of_a_sweep_to_it(name):
    """Joints of one freedom: what a passive freedom has turned depends on the way there."""
    mechanism = library(name)
    driver = next(iter(mechanism.drivers))
    width = 0.2 if mechanism.coordinate(driver).unit == "rad" else 0.02  # of strokes
    values = scattered(mechanism, 12, width)[driver]
    found = sp.states(mechanism, {driver: values})
    first = sp.assemble(mechanism).coordinate(driver).value
    assert not found.unreached
    assert not found.v.any()
    for k in (0, 5, 11):
        swept = sp.sweep(mechanism, driver, np.linspace(first, values[k], 9))
        for c in mechanism.coordinates:
            if mechanism.coordinate_table[c].q >= 0:
                assert found.coordinate(c).value[k] == pytest.approx(
                    swept.coordinate(c).value[-1], abs=1e-10)
    assert np.array_equal(found.coordinate(driver).value, values)


@pytest.mark.parametrize("name", few(
    ["delta", "stewart", "excavator", "geared_five_bar"], "excavator", "geared_five_bar"))
def test_no_result_depends_on_threads_or_order(name):
    mechanism = library(name)
    values = scattered(mechanism, 300, 0.15)
    found = sp.states(mechanism, values, threads=1)
    for threads in (2, 3, 8):
        assert np.array_equal(found.q, sp.states(mechanism, values, threads=threads).q)
    order = np.random.default_rng(0).permutation(300)
    other = sp.states(library(name), {d: x[order] for d, x in values.items()}, threads=2)
    assert np.array_equal(other.q, found.q[order])
    assert {int(order[k]) for k in other.unreached} == set(found.unreached)


def test_all_rows_are_closed_on_the_branch_of_the_guess():
    mechanism = library("delta")
    values = scattered(mechanism, 400, 0.3)
    found = sp.states(mechanism, values)
    assert found.closure_error.max() < 1e-13
    for k in range(0, 400, 57):
        one = sp.assemble(mechanism, {d: x[k] for d, x in values.items()}, guess=found[k])
        np.testing.assert_allclose(found.q[k], one.q, rtol=0, atol=1e-12)
    heights = found.frame("platform").position[:, 2]
    assert (np.sign(heights) == np.sign(heights[0])).all()  # the other mode is on the other side


def test_values_out_of_reach_hold_the_nearest_that_was():
    mechanism = library("four_bar", r2=0.25)
    limit = sp.limits(mechanism, "crank").upper.value
    values = np.array([3.0, 0.5, -2.9, 2.4, limit - 1e-6, limit + 1e-6])
    found = sp.states(mechanism, {"crank": values})
    assert sorted(found.unreached) == [0, 2, 5]
    assert found.coordinate("crank").value == pytest.approx(
        [limit, 0.5, -limit, 2.4, limit - 1e-6, limit], abs=1e-8)
    assert "crank = 3 rad is out of reach: limit position at crank = 2.4751" in found.unreached[0]
    assert found.closure_error.max() < 1e-11
    assert "out of reach: 3 of 6 samples" in str(found)


def test_what_was_not_reached_goes_with_the_samples(tmp_path):
    mechanism = library("four_bar", r2=0.25)
    found = sp.states(mechanism, {"crank": [3.0, 0.5, -2.9, 2.4]})
    assert sorted(found[1:].unreached) == [1]
    assert found[[3, 2]].unreached == {1: found.unreached[2]}
    assert pickle.loads(pickle.dumps(found)).unreached == found.unreached
    again = sp.Motion.load(found.save(tmp_path / "cloud"), mechanism)
    assert again.unreached == found.unreached


def test_a_line_goes_straight_on_where_branches_cross():
    mechanism = models.ladder(1)  # a parallelogram, flat at 0 and at half a turn
    found = sp.states(mechanism, {"pin_0": np.linspace(-6.0, 6.0, 41)}, guess={"pin_0": 0.3})
    assert not found.unreached
    assert found.coordinate("pin_1").value == pytest.approx(found.coordinate("pin_0").value,
                                                            abs=1e-9)


def test_the_branch_is_that_of_the_guess():
    mechanism = library("four_bar")
    modes = sp.assembly_modes(mechanism, {"crank": 1.0})
    values = np.random.default_rng(1).uniform(0.5, 1.5, 20)
    for mode in modes:
        found = sp.states(mechanism, {"crank": values}, guess=mode)
        swept = sp.sweep(mechanism, "crank", [1.0, values[7]], guess=mode)
        np.testing.assert_allclose(found.q[7], swept.q[-1], rtol=0, atol=1e-11)


def test_drivers_without_values_stand_at_the_guess():
    mechanism = library("delta")
    found = sp.states(mechanism, {"arm_1": [0.1, 0.2], "arm_2": 0.3}, guess={"arm_3": 0.15})
    assert found.coordinate("arm_2").value == pytest.approx([0.3, 0.3], abs=0)
    assert found.coordinate("arm_3").value == pytest.approx([0.15, 0.15], abs=1e-15)


def test_equal_values_have_equal_rows():
    found = sp.states(library("rssr"), {"crank": [1.0, 0.5, 1.0, 1.0]})
    assert np.array_equal(found.q[0], found.q[2])
    assert np.array_equal(found.q[0], found.q[3])


def test_rates_of_scattered_states_are_solved_together():
    mechanism = library("delta")
    values = scattered(mechanism, 50, 0.2)
    found = sp.solve_rates(mechanism, sp.states(mechanism, values), {"arm_1": np.arange(50.0)})
    assert found.time is None
    one = sp.solve_rates(mechanism, found[7], {"arm_1": 7.0})
    np.testing.assert_allclose(found.v[7], one.v, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("values", "more", "kind", "words"), [
    ({}, {}, ValueError, "values is empty"),
    ({"crank": []}, {}, ValueError, "no sample"),
    ({"crank": [0.0, np.inf]}, {}, ValueError, "NaN or infinite"),
    ({"crnk": [0.0]}, {}, sp.UnknownNameError, "did you mean 'crank'"),
    ({"crank": [0.0]}, {"threads": 0}, ValueError, "threads is 0"),
    ({"crank": [0.0]}, {"hold": ["crank"]}, ValueError, "is held, and is to move too"),
    ({"crank": [0.0], "rocker_pin": [0.0, 1.0]}, {}, ValueError, "tables differ in length"),
])
def test_bad_input_is_refused(values, more, kind, words):
    with pytest.raises(kind, match=words):
        sp.states(library("four_bar"), values, **more)


def test_values_too_far_to_be_followed_to_are_told():
    found = sp.states(library("rssr"), {"crank": [0.0, 1e9]})
    assert "too far to be followed to" in found.unreached[1]


def test_trees_need_no_loop():
    mechanism = library("crane")
    values = scattered(mechanism, 30, 1.0)
    found = sp.states(mechanism, values)
    for d, x in values.items():
        assert np.array_equal(found.coordinate(d).value, x)
