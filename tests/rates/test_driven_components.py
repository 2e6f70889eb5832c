"""Components of balls and floating joints are held and driven like any other coordinate."""

import mechanisms
import numpy as np
import pytest
from loaded_library import library
from mechanisms import closure, driver, floating, guess, load, point, swung, tilted, turning

import spatial_pin as sp

POSE = ("x", "y", "z", "rx", "ry", "rz")


@pytest.fixture
def folder(tmp_path):
    return tmp_path


def rates_are_derivatives(motion, name, tolerance=1e-6):
    """Values, rates and accelerations of a coordinate over evenly spaced rows of unit speed."""
    value, rate, acceleration = motion.coordinate(name)
    h = float(motion.driver[1] - motion.driver[0])
    inner = slice(2, -2)

    def slope(x):
        return (8 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12 * h)

    assert slope(value) == pytest.approx(rate[inner], abs=tolerance)
    assert slope(rate) == pytest.approx(acceleration[inner], abs=tolerance)


# ---------------------------------------------------------------- held


def test_a_pose_is_held_by_all_its_components():
    mechanism = library("stewart")
    pose = dict(zip((f"pose.{c}" for c in POSE), (0.01, -0.02, 0.015, 0.05, -0.08, 0.1),
                    strict=True))
    state = sp.assemble(mechanism, pose, free=mechanism.drivers)
    assert state.closure_error < 1e-13 and state.released == {}
    for name, value in pose.items():
        assert state.coordinate(name).value == pytest.approx(value, abs=1e-15)
    legs = {d: state.coordinate(d).value for d in mechanism.drivers}
    again = sp.assemble(mechanism, legs)
    assert again.coordinate("pose.ry").value == pytest.approx(-0.08, abs=1e-10)


def test_one_component_of_a_pose_is_held_beside_five_legs():
    mechanism = library("stewart")
    there = sp.assemble(mechanism, {"leg_3": 0.40})
    height = there.coordinate("pose.z").value
    state = sp.assemble(mechanism, {"pose.z": height}, free=["leg_3"])
    assert state.coordinate("pose.z").value == pytest.approx(height, abs=1e-15)
    assert state.coordinate("leg_3").value == pytest.approx(0.40, abs=1e-10)
    assert state.released == {} and state.closure_error < 1e-13


def test_legs_go_as_little_as_possible_for_a_component_that_is_held():
    mechanism = library("stewart")
    home = sp.assemble(mechanism)
    state = sp.assemble(mechanism, {"pose.x": 0.03})
    least = sum(by * by for by in state.released.values())
    assert len(state.released) == 6 and state.closure_error < 1e-13
    rng = np.random.default_rng(2)
    others = ("y", "z", "rx", "ry", "rz")
    for _ in range(6):
        beside = {f"pose.{c}": state.coordinate(f"pose.{c}").value + rng.normal(0.0, 1e-3)
                  for c in others}
        near = sp.assemble(mechanism, {"pose.x": 0.03, **beside}, guess=state,
                           free=mechanism.drivers)
        gone = [near.coordinate(d).value - home.coordinate(d).value for d in mechanism.drivers]
        assert sum(x * x for x in gone) > least


def test_drivers_of_a_ball_stand_where_the_guess_has_them(folder):
    mechanism = swung(folder)
    state = sp.assemble(mechanism, {"tilt": 0.15})
    assert [state.coordinate(d).value for d in mechanism.drivers] == pytest.approx(
        [0.15, 0.05, 0.2], abs=1e-14)
    assert state.released == {} and state.closure_error < 1e-13


# ---------------------------------------------------------------- driven


@pytest.mark.parametrize("component", POSE)
def test_a_free_body_is_driven_by_any_component(folder, component):
    mechanism = load(folder, "free", tilted(floating("free", "ground", "body")), "".join(
        driver(f"d{c}", f"free.{c}") for c in POSE))
    held = dict(zip(POSE, (0.1, 0.2, -0.3, 0.4, -0.5, 0.6), strict=True))
    rest = {f"free.{c}": x for c, x in held.items() if c != component}
    motion = sp.sweep(mechanism, f"free.{component}", np.linspace(-0.5, 0.5, 41), speed=1.0,
                      hold=rest)
    for c in POSE:
        value, rate, acceleration = motion.coordinate(f"free.{c}")
        own = c == component
        assert value == pytest.approx(motion.driver if own else np.full(41, held[c]), abs=1e-13)
        assert rate == pytest.approx(np.full(41, float(own)), abs=1e-12)
        assert acceleration == pytest.approx(np.zeros(41), abs=1e-11)


@pytest.mark.parametrize("driven", ["tilt", "lean", "spin"])
def test_a_ball_drives_a_loop(folder, driven):
    mechanism = swung(folder)
    start = sp.assemble(mechanism).coordinate(driven).value
    motion = sp.sweep(mechanism, driven, start + np.linspace(0.0, 0.1, 41), speed=1.0)
    assert motion.closure_error.max() < 1e-11
    assert motion.coordinate(driven).value == pytest.approx(motion.driver, abs=1e-13)
    for other in set(mechanism.drivers) - {driven}:
        assert np.ptp(motion.coordinate(other).value) < 1e-12
    rates_are_derivatives(motion, "crank")
    rates_are_derivatives(motion, driven)


def test_a_pose_component_sweeps_as_its_legs_are_found_to():
    mechanism = library("stewart")
    values = np.linspace(0.0, 0.04, 21)
    rest = {f"pose.{c}": 0.0 for c in POSE if c != "z"}
    motion = sp.sweep(mechanism, "pose.z", values, speed=1.0, hold=rest)
    legs = [motion.coordinate(f"leg_{k}").value for k in range(1, 7)]
    home = legs[0][0]
    height = 0.36
    for leg in legs:
        assert leg == pytest.approx(np.sqrt(home**2 - height**2 + (height + values) ** 2),
                                    abs=1e-10)
    rates_are_derivatives(motion, "leg_2")


def test_the_loops_stop_a_component_where_they_are_stretched(folder):
    """A body on a string slides out until the string is straight."""
    tree = floating("free", "ground", "body") + point("eye", "body") + turning(
        "arm_pin", "ground", "arm", (-1.0, 0, 0)) + point("tip", "arm", (0.5, 0, 0))
    mechanism = load(folder, "string", tree, closure("string", "distance", "eye", "tip", length=0.8)
                     + "".join(driver(f"d{c}", f"free.{c}") for c in POSE)
                     + guess(arm_pin=0.6))
    with pytest.raises(sp.LimitError) as caught:
        sp.sweep(mechanism, "free.x", np.linspace(0.0, 0.5, 11))
    assert caught.value.limit == pytest.approx(0.3, abs=1e-7)  # −1 + 0.5 + 0.8


# ---------------------------------------------------------------- refused in words


def test_what_knows_only_entries_of_the_configuration_says_so(folder):
    mechanism = swung(folder)
    state = sp.assemble(mechanism)
    for ask in (lambda: sp.limits(mechanism, "tilt"), lambda: sp.solve_jerks(mechanism, state),
                lambda: sp.inverse_dynamics(mechanism, state),
                lambda: sp.live(mechanism, open_browser=False),
                lambda: sp.assembly_modes(mechanism)):
        with pytest.raises(sp.SpatialPinError, match=r"'ball\.x' is a component of a spherical"):
            ask()


def test_a_whole_ball_is_no_driver(folder):
    mechanism = mechanisms.five_bar(folder)
    with pytest.raises(sp.UnknownNameError):
        sp.sweep(mechanism, "ball.x", [0.0, 1.0])
    with pytest.raises(sp.SpatialPinError, match="several coordinates"):
        sp.sweep(swung(folder), "ball", [0.0, 1.0])
