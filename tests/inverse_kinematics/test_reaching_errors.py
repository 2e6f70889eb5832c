"""How far off a target stays is said in millimetres and degrees."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp
from spatial_pin import targets


def arm(size: float) -> sp.Mechanism:
    """Return two links in a plane, the second shorter, with a slide across their base."""
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "lift", *[
        np.array([x]) for x in (9.0, 9.0, 0.0, 0.1 * size)])
    one = model.addJoint(slide, pin.JointModelRZ(), pin.SE3.Identity(), "shoulder")
    place = pin.SE3(np.eye(3), np.array([size, 0.0, 0.0]))
    two = model.addJoint(one, pin.JointModelRZ(), place, "elbow")
    end = pin.SE3(np.eye(3), np.array([0.6 * size, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", two, 0, end, pin.FrameType.OP_FRAME))
    return sp.Mechanism.from_model(model, name="arm")


def off(mechanism: sp.Mechanism, wanted: dict) -> tuple[sp.ReachError, str]:
    """Return the error of a target out of reach, and how far off it says that it stays."""
    start = sp.assemble(mechanism, {"shoulder": 0.3, "elbow": 0.8})
    with pytest.raises(sp.ReachError) as told:
        sp.reach(mechanism, wanted, start)
    found = re.search(r"stays off by (.*?); ", str(told.value))
    assert "relative" not in str(told.value)
    return told.value, found[1]


@pytest.mark.parametrize("size", [1e-3, 0.3, 1.0, 50.0])
def test_a_point_out_of_reach_is_off_by_so_many_millimetres_or_metres(size):
    error, words = off(arm(size), {"tip": [2.0 * size, 0.0, 0.0]})
    gap = np.linalg.norm(error.state.placement("tip").translation - [2.0 * size, 0.0, 0.0])
    assert gap == pytest.approx(0.4 * size, rel=1e-9)
    number, unit = words.split()
    assert float(number) * {"mm": 1e-3, "m": 1.0}[unit] == pytest.approx(gap, rel=1e-3)
    assert unit == ("mm" if gap < 1.0 else "m")


@pytest.mark.parametrize("wanted", [
    {"tip.position.x": 2.0}, {"tip": targets.distance("world", 2.0)},
    {"tip": [targets.position([2.0, 0.0, 0.0])]}])
def test_lengths_of_all_kinds_are_in_millimetres(wanted):
    words = off(arm(1.0), wanted)[1]
    assert words.endswith(" mm") and float(words.split()[0]) == pytest.approx(400.0, rel=1e-2)


def test_a_slide_is_off_in_millimetres_and_a_hinge_in_degrees():
    assert off(arm(1.0), {"lift": 0.35})[1] == "250 mm"
    model = pin.Model()
    model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "shoulder", *[
        np.array([x]) for x in (9.0, 9.0, -1.0, 1.0)])
    model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "elbow")
    assert off(sp.Mechanism.from_model(model), {"shoulder": 1.5})[1] == "0.5 rad (28.65°)"


def test_a_placement_is_off_in_both():
    goal = pin.SE3(pin.exp3(np.array([0.0, 0.4, 0.0])), np.array([2.0, 0.0, 0.0]))
    error, words = off(arm(1.0), {"tip": goal})
    at = error.state.placement("tip")
    length, angle, degrees = map(float, re.match(
        r"(\S+) mm and (\S+) rad \((\S+)°\)$", words).groups())
    assert length == pytest.approx(1e3 * np.linalg.norm(at.translation - goal.translation),
                                   rel=1e-3)
    assert angle == pytest.approx(np.linalg.norm(pin.log3(goal.rotation.T @ at.rotation)),
                                  rel=1e-3)
    assert degrees == pytest.approx(np.degrees(angle), rel=1e-3)


def test_a_direction_is_off_in_degrees_alone():
    wanted = {"tip": targets.direction([0, 0, 1], [0.0, np.sqrt(0.5), np.sqrt(0.5)])}
    assert off(arm(1.0), wanted)[1] == "0.7854 rad (45°)"
