"""On which side of its curve a follower is: where the guess has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.coordinates import joint_values, with_values
from spatial_pin.mechanism.curves import CurveShape, Follower
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.taylor import Taylor


def sided(mechanism: Mechanism) -> Mechanism:
    """Return a mechanism whose followers are on the sides of their cams that its guess has.

    Without a guess a roller is outside.
    """
    if not any("follower" in c.numbers for c in mechanism.closures):
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
        closures.append(c)
    return mechanism.with_fields(closures=tuple(closures))


def _side(curve: CurveShape, follower: Follower, placed: pin.SE3, has_guess: bool) -> int:
    apart: Array = placed.translation - curve.centre
    if follower.flat is not None:
        return -1 if float(apart @ (placed.rotation @ follower.flat)) < 0.0 else 1
    x, y, _ = curve.axes.T @ apart
    if not has_guess or not (x or y):
        return 1
    square = curve.radial()[0](Taylor([np.array([np.arctan2(y, x)])])).values[0][0]
    return 1 if x * x + y * y >= square else -1
