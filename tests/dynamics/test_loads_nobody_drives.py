"""Inverse dynamics asks for an actuator where something works; idle rotations have none."""

from __future__ import annotations

import re
from ast import literal_eval

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from masses import heavy

import spatial_pin as sp

ARM = (2.0, (0.5, 0, 0), (1e-3, 0.1, 0.1))
DOWN, FLAT = "gravity = [0.0, -9.81, 0.0]\n", "gravity = [0.0, 0.0, -9.81]\n"


def two_arms(folder, toml=DOWN, wrap=str, end=ARM, kind=known.turning, axis=(0, 0, 1)):
    """An arm at the shoulder, driven, and one at its end that nobody drives."""
    tree = (known.turning("shoulder", "ground", "upper")
            + kind("elbow", "upper", "lower", (1.0, 0, 0), axis)
            + known.point("tip", "lower", (1.0, 0, 0)) + known.point("foot", "ground", (1, 2, 0)))
    return known.load(folder, "two_arms", wrap(heavy(tree, upper=ARM, lower=end)),
                      toml + known.driver("shoulder", "shoulder"))


def at(mechanism, speed=0.0, acceleration=0.0, **coordinates):
    state = sp.assemble(mechanism, {"shoulder": 0.3}, guess=coordinates)
    return sp.solve_rates(mechanism, state, {"shoulder": speed}, {"shoulder": acceleration})


@pytest.mark.parametrize("wrap", [str, known.tilted], ids=["level", "tilted"])
@pytest.mark.parametrize("kind", [known.turning, known.sliding])
def test_an_end_link_does_not_fall(kind, wrap, tmp_path):
    mechanism = two_arms(tmp_path, wrap=wrap, kind=kind, axis=(0, 0, 1) if
                         kind is known.turning else (0, 1, 0))
    state = at(mechanism, elbow=0.2)
    with pytest.raises(sp.SpatialPinError, match=r"carries load.*on elbow; actuate one"):
        sp.inverse_dynamics(mechanism, state)
    with pytest.raises(sp.SpatialPinError, match="elbow"):
        sp.kinetostatics(mechanism, sp.sweep(mechanism, "shoulder", [0.3, 0.4], guess=state))
    answer = sp.inverse_dynamics(mechanism, state, ["shoulder", "elbow"])
    assert np.linalg.norm(answer.reactions["elbow"].linear) + abs(
        answer.efforts["elbow"]) >= 19.62 - 1e-9


@pytest.mark.parametrize(("toml", "load"), [
    (FLAT + '[[springs]]\nname = "s"\nframes = ["tip", "foot"]\nstiffness = 10.0\n', "spring"),
    (FLAT + '[[springs]]\nname = "s"\njoint = "elbow"\nstiffness = 3.0\n', "spring about it"),
    (FLAT, "force"), (FLAT, "acceleration"), (FLAT, "centrifugal")])
def test_whatever_works_needs_an_actuator(toml, load, tmp_path):
    mechanism = two_arms(tmp_path, toml)
    state = at(mechanism, 2.0 * (load == "centrifugal"), 1.0 * (load == "acceleration"), elbow=0.7)
    force = pin.Force(np.array([0.3, 1.0, 0.2]), np.zeros(3))
    external = {"tip": force} if load == "force" else None
    with pytest.raises(sp.SpatialPinError, match=r"carries load.*elbow"):
        sp.inverse_dynamics(mechanism, state, external=external)


def test_an_end_link_without_load_needs_no_actuator(tmp_path):
    """At rest, about an upright axis; or where it swings freely, in a simulation."""
    flat = two_arms(tmp_path, FLAT)
    assert sp.inverse_dynamics(flat, at(flat, elbow=0.7)).efforts["shoulder"] == pytest.approx(
        0.0, abs=1e-12)
    swinging = two_arms(tmp_path, DOWN)
    motion = sp.simulate(swinging, at(swinging, elbow=0.7), 0.2, times=[0.0, 0.1, 0.2])
    efforts = sp.kinetostatics(swinging, motion).efforts["shoulder"]
    assert efforts == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_balanced_wheel_at_the_end_of_an_arm_is_held_by_somebody(tmp_path):
    """Its centre of mass rests on the axis, but it must turn with the arm."""
    mechanism = two_arms(tmp_path, end=(2.0, (0, 0, 0), (0.1, 0.1, 0.2)))
    sp.inverse_dynamics(mechanism, at(mechanism))
    with pytest.raises(sp.SpatialPinError, match="elbow"):
        sp.inverse_dynamics(mechanism, at(mechanism, acceleration=1.0))


def rod_between_balls(folder, inertia=(1e-3, 0.05, 0.05), lever=0.0, extra=""):
    """An RSSR with a rod that may idle about its own axis, and nothing said of that."""
    tree = heavy(
        known.turning("crank", "ground", "arm", axis=(0, 1, 0)) + known.floating(
            "ball_a", "arm", "rod", (0.1, 0, 0))
        + known.turning("rocker", "ground", "lever", (-0.3, 0, 0), (0, 0, 1))
        + known.point("b", "lever", (0.25, 0, 0)) + known.point("end", "rod", (0.4, 0, 0))
        + known.point("side", "rod", (0.2, 0.05, 0)) + known.point("wall", "ground", (0, 0, 1)),
        arm=ARM, lever=ARM, rod=(1.0, (0.2, lever, 0), inertia))
    return known.load(folder, "rod", tree, FLAT + known.driver("crank", "crank")
                      + known.refine("ball_a", "spherical") + known.closure(
                          "ball_b", "spherical", "end", "b") + extra
                      + known.guess(rocker=1.0))


@pytest.mark.parametrize("inertia", [(1e-3, 0.05, 0.05), (0.02, 0.05, 0.04), (1e-6, 0.05, 0.05)])
def test_the_idle_rotation_of_a_rod_needs_no_actuator(inertia, tmp_path):
    mechanism = rod_between_balls(tmp_path, inertia)
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.4}), {"crank": 2.0},
                           {"crank": 1.0})
    answer = sp.inverse_dynamics(mechanism, state)
    again = sp.forward_dynamics(mechanism, answer.state, answer.efforts)
    assert again.a == pytest.approx(answer.a, rel=1e-8, abs=1e-8)
    assert again.state.coordinate("crank").acceleration == pytest.approx(1.0, rel=1e-9)
    motion = sp.sweep(mechanism, "crank", [0.4, 0.5], speed=2.0, acceleration=1.0, guess=state)
    assert sp.kinetostatics(mechanism, motion).efforts["crank"][0] == pytest.approx(
        answer.efforts["crank"], rel=1e-6)


@pytest.mark.parametrize(("lever", "extra"), [(0.02, ""), (
    0.0, '[[springs]]\nname = "s"\nframes = ["side", "wall"]\nstiffness = 10.0\n')])
def test_a_rod_that_swings_about_its_own_axis_is_free_in_motion(lever, extra, tmp_path):
    """Its weight hangs beside the line between the balls, or a spring pulls there."""
    mechanism = rod_between_balls(tmp_path, lever=lever, extra=extra)
    state = sp.assemble(mechanism, {"crank": 0.4})
    still = sp.sweep(mechanism, "crank", [0.4, 0.5], guess=state)
    for at_rest in (lambda: sp.inverse_dynamics(mechanism, state),
                    lambda: sp.kinetostatics(mechanism, still)):
        with pytest.raises(sp.SpatialPinError, match=r"carries load.*ball_a.*universal joint"):
            at_rest()
    motion = sp.simulate(mechanism, sp.solve_rates(mechanism, state, {"crank": 2.0}), 0.1,
                         drives={"crank": sp.laws.constant_speed(0.4, 2.0)}, times=[0.0, 0.1])
    assert motion.energy_drift < 1e-8
    for row in (0, 1):
        at = sp.solve_rates(mechanism, motion.state(row), {"crank": 2.0})  # the rod does not spin
        answer = sp.inverse_dynamics(mechanism, at)
        again = sp.forward_dynamics(mechanism, at, answer.efforts)
        assert again.a == pytest.approx(answer.a, rel=1e-8, abs=1e-8)
        assert again.a[0] == pytest.approx(0.0, abs=1e-9)  # of the crank, as asked for
        answer = sp.inverse_dynamics(mechanism, motion.state(row))  # as the rod did spin
        assert answer.a == pytest.approx(motion.a[row], rel=1e-8, abs=1e-8)
        assert answer.efforts["crank"] == pytest.approx(motion.efforts["crank"][row], rel=1e-8)


def test_a_platform_that_nobody_drives_is_not_passive(tmp_path):
    """Five rods of fixed lengths leave it one freedom, along a curve: no spin, nor a slide."""
    ends = [((0.5, 0, 0), (0.1, 0, 0)), ((0, 0.5, 0), (0, 0.1, 0)), ((-0.4, 0.1, 0), (-0.1, 0, 0)),
            ((0.1, -0.5, 0), (0, -0.1, 0)), ((0.4, 0.3, 0.1), (0.1, 0.1, 0.2))]
    places = [(known.point(f"low{k}", "ground", low), known.point(f"high{k}", "plate", high))
              for k, (low, high) in enumerate(ends)]
    tree = known.floating("free", "ground", "plate", (0, 0, 0.5)) + known.turning(
        "wheel", "ground", "disc", (2, 0, 0)) + "".join(a + b for a, b in places)
    lengths = [np.linalg.norm(np.add(high, (0, 0, 0.5)) - low) for low, high in ends]
    mechanism = known.load(tmp_path, "plate", heavy(tree, plate=ARM, disc=ARM), FLAT + known.driver(
        "wheel", "wheel") + known.refine("free", "floating") + "".join(
            known.closure(f"rod{k}", "distance", f"low{k}", f"high{k}", length=float(x))
            for k, x in enumerate(lengths)))
    state = sp.solve_rates(mechanism, sp.assemble(mechanism), {"wheel": 1.0})
    assert not sp.mobility(mechanism, state).passive
    with pytest.raises(sp.SpatialPinError, match=r"(without|no) actuator"):
        sp.inverse_dynamics(mechanism, state)


def test_motors_are_named_where_they_can_act(tmp_path):
    """A rod between two balls, one on a crank and one on a slide of a rocker."""
    tree = heavy(
        known.turning("crank", "ground", "arm", axis=(0, 1, 0))
        + known.floating("ball_a", "arm", "rod", (0.1, 0, 0))
        + known.turning("rocker", "ground", "lever", (-0.3, 0, 0))
        + known.sliding("tube", "lever", "slider", (0.25, 0, 0), axis=(1, 0, 0))
        + known.point("end", "rod", (0.4, 0, 0)),
        arm=ARM, lever=ARM, slider=ARM, rod=(1.0, (0.2, 0, 0), (1e-3, 0.05, 0.05)))
    mechanism = known.load(
        tmp_path, "rods", tree, FLAT + known.driver("crank", "crank")
        + known.refine("ball_a", "spherical")
        + known.closure("ball_b", "spherical", "end", "slider")
        + known.guess(rocker=1.0))
    state = sp.assemble(mechanism, {"crank": 0.4})
    with pytest.raises(sp.SpatialPinError, match="1 freedom has no actuator") as told:
        sp.inverse_dynamics(mechanism, state)
    named = re.search(r"actuated=(\[.*\])", str(told.value))
    assert named
    assert set(sp.inverse_dynamics(mechanism, state, literal_eval(named[1])).efforts) > {"crank"}


def test_an_idle_rod_turns_under_the_efforts_as_it_does_under_forces():
    mech = sp.load("rssr")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.7}), {"crank": 3.0}, {"crank": -2.0})
    needed = sp.inverse_dynamics(mech, state)
    found = sp.forward_dynamics(mech, state, needed.efforts)
    assert np.abs(needed.a - found.a).max() <= 1e-11 * np.abs(found.a).max()
    assert needed.a[mech.coordinate("crank").v] == pytest.approx(-2.0, abs=1e-12)
