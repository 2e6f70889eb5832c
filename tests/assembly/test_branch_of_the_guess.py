"""Assembly from a State: loops that end on another branch than there are told of, and no others."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest

import spatial_pin as sp

BRANCH = "on another branch than those of the guess"


def assembled(mechanism, values, guess):
    """Assemble, and return the state and what the warnings about branches say."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        state = sp.assemble(mechanism, values, guess)
    return state, [str(x.message) for x in told if "loops of" in str(x.message)]


def is_followed(mechanism, values, guess, state) -> bool:
    """Whether following drivers from the guess leads to a state, whole turns apart or not."""
    tables = {name: np.linspace(guess.coordinate(name).value, x, 9) for name, x in values.items()}
    end = sp.follow(mechanism, tables, np.arange(9.0), guess=guess).state(-1)
    return all(np.abs(end.placement(link).homogeneous - state.placement(link).homogeneous).max()
               < 1e-7 for link in mechanism.links)


@pytest.mark.delicate
@pytest.mark.parametrize("name", ["four_bar", "slider_crank", "watt_six_bar", "crank_collar",
                                  "spherical_four_bar", "scotch_yoke", "inverted_slider_crank"])
def test_it_is_reported_just_where_following_the_driver_leads_elsewhere(name):
    mechanism = sp.load(name)
    driver = next(iter(mechanism.drivers))
    start = sp.assemble(mechanism, {driver: 0.3})
    for value in np.linspace(0.3, 6.3, 13):
        state, told = assembled(mechanism, {driver: value}, start)
        assert bool(told) != is_followed(mechanism, {driver: value}, start, state), value


@pytest.mark.delicate
def test_the_loops_that_change_their_branch_are_named():
    mechanism = sp.load("slider_crank")
    start = sp.assemble(mechanism, {"crank": 0.3})
    state, told = assembled(mechanism, {"crank": 3.0}, start)
    assert not is_followed(mechanism, {"crank": 3.0}, start, state)
    (text,) = told
    assert text.startswith(f"mechanism 'slider_crank': the loops of wrist_pin are {BRANCH}")


def test_one_leg_of_several_is_named_alone():
    mechanism = sp.load("delta")
    start = sp.assemble(mechanism)
    for value in np.linspace(-0.6, 1.0, 5):
        state, told = assembled(mechanism, {"arm_1": value}, start)
        assert bool(told) != is_followed(mechanism, {"arm_1": value}, start, state)


def test_a_value_beyond_a_limit_position_is_reported_with_how_far_it_goes():
    mechanism = sp.load("four_bar", r2=0.25)  # the crank goes to 2.4751 rad
    start = sp.assemble(mechanism, {"crank": 2.0})
    _, told = assembled(mechanism, {"crank": 2.0 * np.pi - 2.0}, start)
    (text,) = told
    part = float(re.search(r"([\d.]+) % of the way is all they can go", text)[1]) / 100.0
    assert part == pytest.approx((2.4751 - 2.0) / (2.0 * np.pi - 4.0), abs=2e-3)


@pytest.mark.parametrize("name", ["rssr", "stewart", "excavator"])
def test_idle_rotations_and_drivers_that_stand_are_no_other_branch(name):
    mechanism = sp.load(name)
    start = sp.assemble(mechanism)
    driver = next(iter(mechanism.drivers))
    value = start.coordinate(driver).value
    size = mechanism.velocity_scale[mechanism.coordinate(driver).v]
    for part in (0.02, 0.5) if name == "rssr" else (0.02, 0.05):
        assert not assembled(mechanism, {driver: value + part * size}, start)[1]


def test_a_guess_that_is_no_state_says_nothing_of_branches():
    mechanism = sp.load("slider_crank")
    start = sp.assemble(mechanism, {"crank": 0.3})
    for guess in (start.q, {"crank_pin": 0.3}, None):
        assert not assembled(mechanism, {"crank": 3.0}, guess)[1]
