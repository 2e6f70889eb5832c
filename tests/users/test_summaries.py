"""What results say when they are printed: a few lines, true and with units."""

import re

import numpy as np
import pytest

import spatial_pin as sp

LINES = 45  # of a summary, at most


@pytest.fixture(scope="module")
def turn():
    mech = sp.load("four_bar")
    return sp.sweep(mech, "crank", np.linspace(0.0, 2.0 * np.pi, 73))


def test_a_motion_prints_its_ranges(turn):
    text = str(turn)
    assert text.splitlines()[0].startswith("four_bar: 73 samples, crank 0 to 6.28319 rad, closure")
    assert len(text.splitlines()) == 5
    assert text.splitlines()[1].startswith("  error: positions to ")
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


def test_tolerances_print_with_units_and_few_digits():
    mech = sp.load("four_bar")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.7}), {"crank": 1.0})
    name = next(iter(mech.dimensions))
    found = sp.tolerance(mech, ["rocker_pin", "rocker_pin.ratio", "limit.upper.rocker_pin"],
                         {name: 1e-4 * mech.dimensions[name]}, state, samples=8)
    lines = str(found).splitlines()
    assert found.units == {"rocker_pin": "rad", "rocker_pin.ratio": "1",
                           "limit.upper.rocker_pin": "rad"}
    value, spread = re.match(r"rocker_pin = (\S+) ± (\S+) rad \(linear\); ", lines[0]).groups()
    assert float(spread) == float(f"{found.linear['rocker_pin']:.2g}")
    digits = len(spread.partition(".")[2])
    assert value == f"{found.nominal['rocker_pin']:.{digits}f}" and "(8 samples)" in lines[0]
    assert max(map(len, lines)) < 100


def test_a_derivative_below_its_own_error_prints_as_zero():
    mech = sp.load("four_bar")
    state = sp.assemble(mech, {"crank": 0.7})
    found = [sp.sensitivity(mech, state, x, list(mech.dimensions)) for x in (
        "crank_pin", "rocker_pin")]
    assert str(found[0]).splitlines()[0].endswith(" rad")
    for one in found:
        for name, line in zip(one.derivatives, str(one).splitlines()[1:], strict=True):
            is_noise = abs(one.derivatives[name]) <= one.errors[name]
            assert line.startswith(f"  d/d {name} = 0  (") == is_noise
    one = sp.Sensitivity("x", 1.0, {"a": 3e-13, "b": np.array([1.0, 2e-13])},
                         {"a": 1e-12, "b": 1e-12})
    assert str(one) == "x = 1\n  d/d a = 0  (± 1e-12)\n  d/d b = [1 0]  (± 1e-12)"
