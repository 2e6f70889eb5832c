"""Values of a sweep in any order: a branch is the same there and back."""

import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from variety import few

import spatial_pin as sp

RNG = np.random.default_rng(7)
SCATTERED = np.concatenate([[0.3], RNG.uniform(-2.0, 6.0, 400), [0.3, 6.0, -2.0]])


def apart(mech, first, second):
    """The largest step of a joint from one configuration to another, quaternions of any sign."""
    return np.abs(pin.difference(mech.model, first, second) / mech.velocity_scale).max()


@pytest.mark.parametrize("name", few(
    ["rssr", "rspc", "bennett", "double_cardan", "screw_press"], "rssr", "bennett", "screw_press"))
def test_a_row_is_what_its_value_makes_it_and_not_the_rows_before(name):
    close = 1e-7 if name == "rssr" else 1e-10  # a rod's spin is as exact as its many steps
    mech = library(name)
    driver = next(iter(mech.drivers))
    speed, acceleration = RNG.uniform(-2.0, 2.0, (2, len(SCATTERED)))
    motion = sp.sweep(mech, driver, SCATTERED, speed, acceleration)
    start = motion.state(0)
    for rows in (np.flatnonzero(SCATTERED >= 0.3), np.flatnonzero(SCATTERED <= 0.3)):
        order = rows[np.argsort(np.abs(SCATTERED[rows] - 0.3), kind="stable")]
        told = sp.sweep(mech, driver, SCATTERED[order], speed[order], acceleration[order],
                        guess=start)
        for k, row in enumerate(order):
            assert apart(mech, motion.q[row], told.q[k]) < close
        for got, want in ((motion.v, told.v), (motion.a, told.a)):
            assert np.abs(got[order] - want).max() < close * (1.0 + np.abs(want).max())
    assert motion.closure_error.max() < 1e-12
    assert np.array_equal(motion.swept, SCATTERED)


def test_the_spin_of_a_rod_is_that_of_small_steps_however_far_the_rows_jump():
    mech = library("rssr")
    even = sp.sweep(mech, "crank", np.linspace(-2.0, 6.0, 8001), guess=sp.sweep(
        mech, "crank", np.linspace(0.3, -2.0, 2301)).state(-1))
    scattered = sp.sweep(mech, "crank", SCATTERED)
    for row in (17, 230, -1, -2):
        near = int(np.argmin(np.abs(even.swept - scattered.swept[row])))
        again = sp.sweep(mech, "crank", [even.swept[near], scattered.swept[row]],
                         guess=even.state(near))
        assert apart(mech, again.q[1], scattered.q[row]) < 1e-7


def test_the_first_value_in_the_order_requested_that_is_out_of_reach_ends_it():
    mech = library("slider_crank")
    driver, end = "slide", sp.limits(mech, "slide").upper.value
    start = sp.assemble(mech, {})
    there = start.coordinate(driver).value
    values = np.concatenate([[there], RNG.uniform(0.9 * there, 0.999 * end, 60)])
    values[40] = 1.01 * end
    values[20] = 1.02 * end
    with pytest.raises(sp.LimitError) as caught:
        sp.sweep(mech, driver, values, guess=start)
    assert len(caught.value.motion) == 20
    assert caught.value.limit == pytest.approx(end, abs=1e-12)
    stopped = sp.sweep(mech, driver, values, guess=start, on_limit="stop")
    assert len(stopped) == 20 and [e.row for e in stopped.events if e.kind == "limit"] == [20]


@pytest.mark.delicate
def test_change_points_are_reported_as_often_as_they_are_passed():
    mech = library("four_bar", r1=0.4, r2=0.12, r3=0.4, r4=0.12)
    values = np.tile([2.0, 4.0], 6)
    motion = sp.sweep(mech, "crank", values)
    assert [e.row for e in motion.events if e.kind == "branch point"] == list(range(1, 12))
