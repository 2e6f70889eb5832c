"""Targets with a weight: the least sum of all places that starts lead to, exact targets or not."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from variety import paired

import spatial_pin as sp
from spatial_pin import targets

LENGTHS = np.array([1.0, 0.8, 0.6])
UP = np.array([0.0, 0.0, 1.0])


def arm(limits, tilt=(0.0, 0.0, 0.0)) -> sp.Mechanism:
    """Return an arm in a plane, tilted, each hinge within (lower, upper) [rad]."""
    model, parent = pin.Model(), 0
    for k, (lower, upper) in enumerate(limits):
        at = np.array([LENGTHS[k - 1], 0.0, 0.0]) if k else np.zeros(3)
        place = pin.SE3(np.eye(3) if k else pin.exp3(np.array(tilt)), at)
        one = [np.array([x]) for x in (9.0, 9.0, lower, upper)]
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"j{k + 1}", *one)
    end = pin.SE3(np.eye(3), np.array([LENGTHS[len(limits) - 1], 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, end, pin.FrameType.OP_FRAME))
    return sp.Mechanism.from_model(model, name="arm")


def at(mechanism, *angles) -> sp.State:
    return sp.assemble(mechanism, dict(zip(mechanism.coordinates, angles, strict=True)))


TWO = arm([(-2.9, 2.9), (-9.0, 9.0)])
TILTED = arm([(-2.9, 2.9), (-9.0, 9.0)], (0.4, -0.7, 0.3))
THREE = arm([(-2.0, 2.0), (-2.5, 2.5), (-2.5, 2.5)])
CASES = {  # behind a limit: mechanism, start, goal
    "two": (TWO, (2.8, 0.7), (-2.0, 0.7)),
    "tilted": (TILTED, (2.8, 0.7), (-2.0, 0.7)),
    "three": (THREE, (1.9, 1.0, 0.5), (-1.9, -1.0, -0.5)),
}


@pytest.mark.parametrize(("case", "weight"), paired([*CASES], [1e-9, 1.0, 1e4]))
def test_weighted_targets_alone_are_met_behind_a_limit_as_exact_ones_are(case, weight):
    mechanism, here, there = CASES[case]
    start, goal = at(mechanism, *here), at(mechanism, *there).placement("tip").translation
    near = sp.reach(mechanism, {"tip": targets.position(goal, weight=weight)}, start, starts=0)
    assert np.linalg.norm(near.placement("tip").translation - goal) > 0.1  # a least sum near by
    found = sp.reach(mechanism, {"tip": targets.position(goal, weight=weight)}, start)
    exact = sp.reach(mechanism, {"tip": goal}, start)
    for state in (found, exact):
        assert np.abs(state.placement("tip").translation - goal).max() < 1e-11
        assert not state.beyond_limits


def test_placements_with_a_weight_are_met_behind_a_limit():
    mechanism, here, there = CASES["three"]
    start, goal = at(mechanism, *here), at(mechanism, *there).placement("tip")
    state = sp.reach(mechanism, {"tip": targets.pose(goal, weight=3.0)}, start)
    assert pin.log6(state.placement("tip").actInv(goal)).np == pytest.approx(np.zeros(6), abs=1e-11)


def test_beside_exact_targets_a_weighted_one_is_met_behind_a_limit():
    mechanism, here, there = CASES["three"]
    start, goal = at(mechanism, *here), at(mechanism, *there)
    wanted = {"tip": targets.position(goal.placement("tip").translation, weight=1.0),
              "j3": goal.coordinate("j3").value}
    state = sp.reach(mechanism, wanted, start)
    assert state.coordinate("j3").value == pytest.approx(goal.coordinate("j3").value, abs=1e-12)
    assert np.abs(state.placement("tip").translation - wanted["tip"].point).max() < 1e-11


def test_a_loop_behind_the_limit_of_its_cylinder_is_met_by_weighted_targets():
    mechanism = sp.load("delta")
    start = sp.assemble(mechanism)
    goal = start.placement("platform").translation + np.array([0.15, -0.1, 0.05])
    state = sp.reach(mechanism, {"platform": targets.position(goal, weight=0.5)}, start)
    exact = sp.reach(mechanism, {"platform": goal}, start)
    assert state.q == pytest.approx(exact.q, abs=1e-9)


@pytest.mark.parametrize("wanted", [(-1.5, -0.4), (0.2, -1.2), (-2.5, 0.3), (-0.6, 0.1)])
def test_a_compromise_is_the_least_sum_of_a_grid_over_all_angles(wanted):
    """A point that may be out of reach, and an angle that pulls elsewhere."""
    mechanism, lean = arm([(-1.2, 2.9), (-2.0, 2.0)]), 0.3
    size = mechanism.characteristic_length
    pulls = {"tip": targets.position([*wanted, 0.0], weight=1.0),
             "j2": targets.coordinate(0.5, weight=lean)}
    state = sp.reach(mechanism, pulls, at(mechanism, 2.5, 1.0))

    def sums(one, two):
        x = LENGTHS[0] * np.cos(one) + LENGTHS[1] * np.cos(one + two) - wanted[0]
        y = LENGTHS[0] * np.sin(one) + LENGTHS[1] * np.sin(one + two) - wanted[1]
        return (x * x + y * y) / size**2 + (lean * (two - 0.5)) ** 2

    grid = np.meshgrid(np.linspace(-1.2, 2.9, 401), np.linspace(-2.0, 2.0, 401))
    own = sums(*(state.coordinate(name).value for name in ("j1", "j2")))
    assert own <= sums(*grid).min() + 1e-12


def test_of_places_where_weighted_targets_are_met_the_one_that_moves_least_is_taken():
    mechanism = arm([(-2.9, 2.9), (-2.9, 2.9)])
    start = at(mechanism, 0.3, 0.8)
    goal = at(mechanism, 0.5, 0.9).placement("tip").translation
    state = sp.reach(mechanism, {"tip": targets.position(goal, weight=2.0)}, start)
    assert state.q == pytest.approx([0.5, 0.9], abs=1e-9)


def test_a_weighted_target_too_far_away_for_the_steps_is_an_error_that_says_so():
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    hinge = model.addJoint(slide, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    end = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", hinge, 0, end, pin.FrameType.OP_FRAME))
    mechanism = sp.Mechanism.from_model(model, name="crane")
    for weight in (None, 1.0):
        with pytest.raises(sp.ReachError, match="steps ran out") as told:
            sp.reach(mechanism, {"tip": targets.position([3000.0, 0.5, 0.0], weight=weight)})
        assert told.value.reasons == ("steps",) and told.value.distances["tip"] > 1000.0
