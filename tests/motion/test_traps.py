"""What is easily written by mistake says what to write, and one name is one thing."""

from __future__ import annotations

import re

import numpy as np
import pytest

import spatial_pin as sp

# ---------------------------------------------------------------- one value instead of a list


@pytest.mark.parametrize(("values", "rest", "last"), [
    (0, (6,), 6.0), (0.5, (6.0,), 6.0), (np.float64(1.0), (), 1.0 + 2.0 * np.pi),
    (np.array(2.0), (3,), 3.0), (1.0, ([1.0],), 1.0 + 2.0 * np.pi)])
def test_a_sweep_of_one_number_is_refused_with_the_line_to_write(values, rest, last):
    mech = sp.load("four_bar")
    with pytest.raises(ValueError, match="a sweep goes through a list of values") as told:
        sp.sweep(mech, "crank", values, *rest)
    line = re.search(r"sp\.sweep\(.*?\)\)", str(told.value))[0]
    motion = eval(line, {"sp": sp, "np": np, "mechanism": mech})
    assert motion.driver[[0, -1]] == pytest.approx([float(values), last], abs=1e-4)
    line = re.search(r"sp\.assemble\(.*\)", str(told.value))[0]
    state = eval(line, {"sp": sp, "mechanism": mech})
    assert state.coordinate("crank").value == pytest.approx(float(values))


def test_a_list_of_one_value_is_a_sweep():
    motion = sp.sweep(sp.load("four_bar"), "crank", [0.5], speed=6.0)
    assert motion.driver.tolist() == [0.5]


def test_a_number_that_is_none_is_refused_as_such():
    with pytest.raises(ValueError, match="NaN or infinite"):
        sp.sweep(sp.load("four_bar"), "crank", np.nan)


# ---------------------------------------------------------------- velocities of joints


@pytest.fixture(scope="module")
def rssr() -> sp.Motion:
    return sp.sweep(sp.load("rssr"), "crank", np.linspace(0.2, 3.0, 7), speed=2.0)


@pytest.mark.parametrize("name", ["rocker_pin", "crank", "crank_pin", "ball_a.x"])
def test_the_velocity_of_a_coordinate_is_its_rate(rssr, name):
    velocity, rate = rssr.output(f"{name}.velocity"), rssr.output(f"{name}.rate")
    assert velocity.values.shape == (7,) and velocity.unit == rate.unit == "rad/s"
    assert np.array_equal(velocity.values, rate.values)
    assert np.array_equal(rate.values, rssr.coordinate(name).rate)
    assert velocity.label == f"{name} velocity"


def test_the_velocity_of_a_slide_is_its_rate_in_metres_a_second():
    motion = sp.sweep(sp.load("slider_crank"), "crank", [0.3, 0.6], speed=2.0)
    velocity = motion.output("slide.velocity")
    assert velocity.unit == "m/s"
    assert np.array_equal(velocity.values, motion.coordinate("slide").rate)


@pytest.mark.parametrize("kind", ["velocity", "acceleration"])
def test_of_a_driver_with_the_name_of_a_link_both_are_numbers_and_components_are_the_links(kind):
    mech = sp.load("excavator")
    assert "boom" in mech.drivers and "boom" in mech.links
    motion = sp.sweep(mech, "boom", np.linspace(2.7, 2.75, 3), speed=0.1)
    rates = motion.coordinate("boom")
    own = {"velocity": rates.rate, "acceleration": rates.acceleration}[kind]
    assert np.array_equal(motion.output(f"boom.{kind}").values, own)
    link = getattr(motion.frame("boom"), kind)
    for k, axis in enumerate("xyz"):
        assert np.array_equal(motion.output(f"boom.{kind}.{axis}").values, link[:, k])


def test_the_velocity_of_a_ball_or_a_link_is_that_of_its_origin(rssr):
    for name in ("ball_a", "coupler", "coupler_b", "rocker"):
        assert np.array_equal(rssr.output(f"{name}.velocity").values, rssr.frame(name).velocity)


def test_sensitivities_and_samples_of_a_joints_velocity_are_those_of_its_rate():
    mech = sp.load("four_bar")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.7}), {"crank": 3.0})
    two = [sp.sensitivity(mech, state, f"rocker_pin.{kind}", ["r2", "r3"])
           for kind in ("rate", "velocity")]
    assert two[0].derivatives == two[1].derivatives
    drawn = sp.tolerance(mech, ["rocker_pin.rate", "rocker_pin.velocity"], {"r2": 1e-4}, state,
                         samples=20)
    assert np.array_equal(*drawn.samples.values())


def test_a_smaller_model_tells_a_joints_velocity():
    mech = sp.load("rssr")
    small = sp.reduce(mech, ["rocker_pin.velocity"])
    motions = [sp.sweep(m, "crank", [0.3, 0.6], speed=2.0) for m in (mech, small)]
    assert motions[0].output("rocker_pin.velocity").values == pytest.approx(
        motions[1].output("rocker_pin.velocity").values, abs=1e-12)
