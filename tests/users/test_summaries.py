"""What results say when they are printed: a few lines, true and with units."""

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin.dimensions.sensitivity import Sensitivity, sensitivities, with_spread

LINES = 45  # of a summary, at most


@pytest.fixture(scope="module")
def turn():
    mech = sp.load("four_bar")
    return sp.sweep(mech, "crank", np.linspace(0.0, 2.0 * np.pi, 73))


def test_a_motion_prints_its_ranges(turn):
    text = str(turn)
    assert text.splitlines()[0].startswith("four_bar: 73 samples, crank 0 to 6.28319 rad, closure")
    assert len(text.splitlines()) == 4
    low, high = (turn.coordinate("rocker_pin").value[k] for k in (
        turn.coordinate("rocker_pin").value.argmin(), turn.coordinate("rocker_pin").value.argmax()))
    assert f"{low:+.6f} to {high:+.6f} rad" in text
    assert repr(turn).startswith("Motion('four_bar': 73 samples over crank")


def test_an_empty_motion_prints_one_line(turn):
    none = sp.Motion(turn.mechanism, np.empty(0), "crank", None, turn.q[:0], turn.v[:0], turn.a[:0],
                     np.empty(0), np.empty(0))
    assert str(none) == "four_bar: 0 samples, closure error at most 0.0e+00"


def test_a_simulation_prints_energy_events_and_efforts():
    mech = sp.load("stewart")
    state = sp.solve_rates(mech, sp.assemble(mech), {"leg_1": 0.1})
    text = str(motion := sp.simulate(mech, state, 0.2, times=np.linspace(0.0, 0.2, 101)))
    assert len(text.splitlines()) < LINES and "array" not in text
    assert "... and 13 more coordinates" in text
    assert sum("passed at" in line for line in text.splitlines()) == 5
    assert f"energy drift {motion.energy_drift:.1e}" in text and "-0.000000" not in text
    assert "e-17" not in text  # of a leg that begins at rest
    assert repr(motion).startswith("Simulation('stewart': 101 samples over time")


def test_a_prescribed_simulation_prints_its_efforts():
    mech = sp.load("four_bar")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.0}), {"crank": 1.0})
    motion = sp.simulate(mech, state, 0.2, drives={"crank": sp.laws.constant_speed(0.0, 1.0)})
    x = motion.efforts["crank"]
    assert f"  crank  {x.min():.6g} to {x.max():.6g} N·m, largest at time = " in str(motion)


def test_forces_over_a_motion_print_the_largest(turn):
    loads = sp.kinetostatics(turn.mechanism, turn)
    text = str(loads)
    assert len(text.splitlines()) < 15 and "array" not in text + repr(loads)
    x, force = loads.efforts["crank"], np.linalg.norm(loads.reactions["rocker_pin"][:, :3], axis=1)
    at = [turn.swept[int(np.abs(y).argmax())] for y in (x, force)]
    assert (f"crank  {x.min():.6g} to {x.max():.6g} N·m, largest at crank = {at[0]:.6g} rad"
            in text)
    assert (f"rocker_pin: {force.max():.6g} N *y at crank = {at[1]:.6g} rad, 0 N·m *xz\n"
            in text)
    assert "* one of many" in text and "on the fixed link, all together: " in text


@pytest.mark.parametrize(("value", "deviation", "unit", "text"), [
    (1.23456789, 0.00214, "rad", "1.2346 ± 0.0021 rad"),
    (1234.5678, 31.4, "m/s²", "1235 ± 31 m/s²"),
    (0.0, 0.0321, "m", "0.000 ± 0.032 m"),
    (1.25, 3e-17, "m", "1.25 ± 0 m"),
    (1.23456e-7, 3.2e-9, "1", "(1.235 ± 0.032)e-7"),
    (2.5e9, 4.4e7, "N", "(2.500 ± 0.044)e9 N"),
    (np.inf, np.nan, "", "inf ± nan"),
    (np.array([1.0, 2.0]), np.array([0.1, 0.0]), "m", "[1.00 ± 0.10, 2 ± 0] m"),
])
def test_a_value_has_the_digits_that_its_spread_warrants(value, deviation, unit, text):
    assert with_spread(value, deviation, unit) == text


def test_tolerances_print_with_units_and_few_digits():
    mech = sp.load("four_bar")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.7}), {"crank": 1.0})
    name = next(iter(mech.dimensions))
    found = sp.tolerance(mech, ["rocker_pin", "rocker_pin.ratio", "limit.upper.rocker_pin"],
                         {name: 1e-4 * mech.dimensions[name]}, state, samples=8)
    lines = str(found).splitlines()
    assert found.units == {"rocker_pin": "rad", "rocker_pin.ratio": "1",
                           "limit.upper.rocker_pin": "rad"}
    value = with_spread(found.nominal["rocker_pin"], found.linear["rocker_pin"], "rad")
    assert lines[0].startswith(f"rocker_pin = {value} (linear); ") and "(8 samples)" in lines[0]
    assert max(map(len, lines)) < 100


def test_a_derivative_below_its_own_error_prints_as_zero():
    mech = sp.load("four_bar")
    found = sensitivities(mech, sp.assemble(mech, {"crank": 0.7}), ["crank_pin", "rocker_pin"])
    assert str(found[0]).splitlines()[0].endswith(" rad")
    for one in found:
        for name, line in zip(one.derivatives, str(one).splitlines()[1:], strict=True):
            is_noise = abs(one.derivatives[name]) <= one.errors[name]
            assert line.startswith(f"  d/d {name} = 0  (") == is_noise
    one = Sensitivity("x", 1.0, {"a": 3e-13, "b": np.array([1.0, 2e-13])},
                         {"a": 1e-12, "b": 1e-12})
    assert str(one) == "x = 1\n  d/d a = 0  (± 1e-12)\n  d/d b = [1 0]  (± 1e-12)"
