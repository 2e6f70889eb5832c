"""The side of its curve on which a follower or another curve is, from the guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.coordinates import joint_values, with_values
from spatial_pin.mechanism.curves import CurveShape, Follower
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.taylor import Taylor

MOSTLY = 0.5  # part of a curve's points inside another: it belongs there


def sided(mechanism: Mechanism) -> Mechanism:
    """Return a mechanism with each follower on the side of its cam that the guess shows.

    Without a guess a roller is outside, and two curves are outside each other.
    """
    if not any(key in c.numbers for c in mechanism.closures for key in ("follower", "curves")):
        return mechanism
    q = with_values(mechanism, mechanism.neutral, joint_values(mechanism, mechanism.guess))
    data, closures = mechanism.model.createData(), []
    pin.forwardKinematics(mechanism.model, data, q)
    for c in mechanism.closures:
        follower = c.numbers.get("follower")
        if follower is not None:
            one, two = (data.oMi[joint] * at for joint, at in map(
                mechanism.frame_on_joint, c.frames[:2]))
            side = _side(c.numbers["curve"], follower, one.actInv(two), bool(mechanism.guess))
            c = replace(c, numbers={**c.numbers, "follower": replace(follower, side=side)})
        curves = c.numbers.get("curves")
        if curves is not None and mechanism.guess:
            one, two = (data.oMi[joint] * at for joint, at in map(
                mechanism.frame_on_joint, c.frames[:2]))
            seen = one.actInv(two)
            points = (curves.two.points() @ seen.rotation.T + seen.translation
                      - curves.one.centre) @ curves.one.axes
            own = (curves.one.points() - curves.one.centre) @ curves.one.axes
            nested = max(_part_inside(*pair) for pair in (
                (points, own), (own, points))) > MOSTLY
            c = replace(c, numbers={**c.numbers, "curves": replace(
                curves, side=-1 if nested else 1)})
        closures.append(c)
    return mechanism.with_fields(closures=tuple(closures))


def _part_inside(points: Array, polygon: Array) -> float:
    """Return the fraction of points (n, 3) that are inside a polygon (m, 3), seen along z."""
    x, y = points[:, :2].T
    (x1, y1), (x2, y2) = polygon[:-1, :2].T, polygon[1:, :2].T
    crosses = (y1 > y[:, None]) != (y2 > y[:, None])
    with np.errstate(all="ignore"):
        at = x1 + (y[:, None] - y1) / (y2 - y1) * (x2 - x1)
    return float(np.mean(np.sum(crosses & (x[:, None] < at), axis=1) % 2))


def _side(curve: CurveShape, follower: Follower, placed: pin.SE3, has_guess: bool) -> int:
    apart: Array = placed.translation - curve.centre
    if follower.flat is not None:
        return -1 if float(apart @ (placed.rotation @ follower.flat)) < 0.0 else 1
    x, y, _ = curve.axes.T @ apart
    if not has_guess or not (x or y):
        return 1
    if curve.at is None:
        own = (curve.points() - curve.centre) @ curve.axes
        return -1 if _part_inside(np.array([[x, y, 0.0]]), own) else 1
    square = curve.radial()[0](Taylor([np.array([np.arctan2(y, x)])])).values[0][0]
    return 1 if x * x + y * y >= square else -1
