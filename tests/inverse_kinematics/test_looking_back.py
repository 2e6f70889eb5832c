"""Paths of targets with more freedoms than numbers: least motion, and looking back where it ends.

The targets are those of a motion within the joint limits, so that there is one that meets them all.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import CubicSpline

import spatial_pin as sp

ANY = [np.array([9.0]), np.array([9.0])]  # effort, velocity
TIMES = np.linspace(0.0, 1.0, 20)


def limited(model: pin.Model, parent: int, at, lower: float, upper: float, axis) -> int:
    """Add a hinge within limits, at a distance from the one before."""
    joint = pin.JointModelRevoluteUnaligned(np.array(axis))
    place = at if isinstance(at, pin.SE3) else pin.SE3(np.eye(3), np.array([at, 0.0, 0.0]))
    ends = [np.array([lower]), np.array([upper])]
    return model.addJoint(parent, joint, place, f"h{model.njoints}", *ANY, *ends)


def arm(rng: np.random.Generator, n: int) -> sp.Mechanism:
    """Return an arm of n hinges, in a plane or in space."""
    model, parent = pin.Model(), 0
    axes = [[0.0, 0.0, 1.0]] * n if n == 3 else rng.standard_normal((n, 3))
    half = rng.uniform(0.7, 2.0)
    for k in range(n):
        centre, axis = rng.uniform(-1.0, 1.0), axes[k] / np.linalg.norm(axes[k])
        at = 0.0 if k == 0 else rng.uniform(0.3, 1.0)
        parent = limited(model, parent, at, centre - half, centre + half, axis)
    end = pin.SE3(np.eye(3), np.array([0.7, 0.0, 0.1]))
    model.addFrame(pin.Frame("tip", parent, 0, end, pin.FrameType.OP_FRAME))
    return sp.Mechanism.from_model(model, name="arm")


def crane(rng: np.random.Generator) -> sp.Mechanism:
    """Return a four-bar whose rocker carries two hinges."""
    base = sp.load("four_bar")
    model = base.model.copy()
    parent, at = model.getJointId("rocker_pin"), model.frames[base.frame_id("rocker_b")].placement
    half = rng.uniform(0.6, 2.0)
    for _ in range(2):
        centre = rng.uniform(-1.0, 1.0)
        parent = limited(model, parent, at, centre - half, centre + half, [0.0, 1.0, 0.0])
        at = rng.uniform(0.1, 0.3)
    end = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, end, pin.FrameType.OP_FRAME))
    hinges = list(model.names)[-2:]
    return sp.Mechanism.from_model(
        model, base.closures, drivers=["crank_pin", *hinges], name="crane",
        guess={"crank_pin": 0.5, "rocker_pin": 1.3})


def within_limits(mechanism: sp.Mechanism, rng: np.random.Generator) -> sp.Motion:
    """Return a motion of all drivers through three poses within their limits."""
    model = mechanism.model
    ends = {d: (model.lowerPositionLimit[c.q], model.upperPositionLimit[c.q])
            for d in mechanism.drivers for c in [mechanism.coordinate(d)]}
    ends = {d: (0.0, 5.0) if np.isinf(x).any() or x[0] < -1e3 else x for d, x in ends.items()}
    poses = [[rng.uniform(*x) for x in ends.values()] for _ in range(3)]
    lower, upper = np.transpose(list(ends.values()))
    values = np.clip(CubicSpline([0.0, 0.5, 1.0], poses)(TIMES), lower, upper)
    return sp.follow(mechanism, dict(zip(ends, values.T, strict=True)), TIMES)


def led(mechanism: sp.Mechanism, shown: sp.Motion, axes: str) -> tuple[sp.Motion, float]:
    """Return the motion along a point's components, and how far off these are at the samples."""
    points = shown.frame("tip").position
    wanted = {f"tip.position.{x}": points[:, "xyz".index(x)] for x in axes}
    found = sp.reach_path(mechanism, wanted, TIMES, shown.state(0))
    at = found.frame("tip").position
    return found, max(np.abs(at[:, "xyz".index(x)] - points[:, "xyz".index(x)]).max()
                      for x in axes)


MAKERS = {"plane arm": (lambda rng: arm(rng, 3), "x"), "arm": (lambda rng: arm(rng, 5), "xy"),
          "crane": (crane, "z")}


@pytest.mark.parametrize(("kind", "seed"), [
    ("plane arm", 5), ("plane arm", 27), ("arm", 27), ("arm", 32), ("crane", 16)])
def test_a_path_goes_on_where_the_least_motion_leads_no_further(kind, seed):
    make, axes = MAKERS[kind]
    rng = np.random.default_rng(seed)
    mechanism = make(rng)
    shown = within_limits(mechanism, rng)
    found, off = led(mechanism, shown, axes)
    assert len(found) == len(TIMES) and off < 1e-11
    assert found.q[0] == pytest.approx(shown.q[0], abs=1e-9)
    model = mechanism.model
    assert np.all(found.q < model.upperPositionLimit + 1e-9)
    assert np.all(found.q > model.lowerPositionLimit - 1e-9)
    steps = np.abs(np.diff(found.q, axis=0)).max()
    assert steps < 4.0 * np.abs(np.diff(shown.q, axis=0)).max()  # it goes there, it does not jump


@pytest.mark.parametrize("kind", MAKERS)
def test_where_the_least_motion_leads_on_the_path_is_that_of_least_motion(kind):
    make, axes = MAKERS[kind]
    rng = np.random.default_rng(0)
    mechanism = make(rng)
    shown = within_limits(mechanism, rng)
    found, _ = led(mechanism, shown, axes)
    here = shown.state(0)
    for k in range(1, len(TIMES)):
        point = shown.frame("tip").position[k]
        here = sp.reach(mechanism, {f"tip.position.{x}": point["xyz".index(x)] for x in axes},
                        here, starts=0)
        assert found.q[k] == pytest.approx(here.q, abs=1e-7)


def test_targets_beyond_all_that_can_be_reached_are_still_an_error_with_the_motion_so_far():
    rng = np.random.default_rng(0)
    mechanism = arm(rng, 3)
    start = sp.assemble(mechanism, {name: 0.3 for name in mechanism.drivers})
    x = start.placement("tip").translation[0]
    with pytest.raises(sp.ReachError, match="sample ") as told:
        sp.reach_path(mechanism, {"tip.position.x": np.linspace(x, 9.0, 20)}, TIMES, start)
    reached = told.value.motion
    assert 1 < len(reached) < 20
    assert reached.frame("tip").position[-1, 0] == pytest.approx(
        np.linspace(x, 9.0, 20)[len(reached) - 1], abs=1e-11)
