"""Close samples of a sweep are closed a few at a time: each is what it would be alone."""

import numpy as np
import pytest

import spatial_pin as sp

TURNS = {"four_bar": "crank", "watt_six_bar": "crank", "bennett": "crank", "rspc": "crank",
         "spherical_four_bar": "crank", "slider_crank": "crank"}


@pytest.mark.parametrize("name", TURNS)
def test_close_samples_are_those_of_far_ones(name):
    mech, values = sp.load(name), np.linspace(0.0, 6.0, 721)
    close = sp.sweep(mech, TURNS[name], values, speed=2.0)
    far = sp.sweep(mech, TURNS[name], values[::40], speed=2.0)
    for one, other in ((close.q, far.q), (close.v, far.v), (close.a, far.a)):
        assert one[::40] == pytest.approx(other, abs=1e-12 * max(1.0, np.abs(other).max()))
    assert close.closure_error.max() < 1e-14


@pytest.mark.parametrize("turned", [2e4, 1e5 - 3.0, 3e5])
def test_a_crank_that_has_turned_far_is_no_other(turned):
    mech, values = sp.load("four_bar"), turned + np.linspace(0.0, 6.0, 361)
    rocker = sp.sweep(mech, "crank", values).coordinate("rocker_pin").value
    turn = values - 2.0 * np.pi * np.floor(values / (2.0 * np.pi))
    alone = [sp.assemble(mech, {"crank": x}).coordinate("rocker_pin").value for x in turn[::90]]
    assert np.sin(rocker[::90]) == pytest.approx(np.sin(alone), abs=1e-14 * turned)


def test_samples_to_and_fro_are_the_same():
    mech, values = sp.load("delta"), np.linspace(-0.2, 0.2, 101)
    forth = sp.sweep(mech, "arm_1", values)
    back = sp.sweep(mech, "arm_1", values[::-1], guess=forth.state(-1))
    assert forth.q == pytest.approx(back.q[::-1], abs=1e-12)
