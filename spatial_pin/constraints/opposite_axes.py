"""Mirror roots: closures whose equations hold, but whose axes point opposite ways."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.vector_products import FrameOnBody
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

TANGENT = "tangent"  # `Pair.aligned` of a direction along that of a curve


def opposite_axes(mechanism: Mechanism, data: pin.Data) -> dict[str, bool]:
    """Return closures whose axes do not point the same way, and whether half a turn helps.

    Closed equations leave them parallel, opposite, or (three equations of rotation) interchanged:
    then half a turn of one of the frames is not what makes them one.

    Args:
        mechanism: with closures.
        data: of its model, with the joint placements.
    """
    opposite = {}
    for name, ends in axis_pairs(mechanism):
        one, two = (data.oMi[joint].rotation @ axes for joint, axes in ends)
        cosines = np.vecdot(one.T, two.T)
        if np.any(cosines < 0.5):
            opposite[name] = bool(np.all(np.abs(cosines) > 0.5))
    for closure in mechanism.closures:
        if closure.pair.aligned == TANGENT:
            frames = (FrameOnBody.of(mechanism, name) for name in closure.frames)
            first, second = (data.oMi[frame.joint] * frame.placement for frame in frames)
            seen = first.actInv(second)
            if closure.numbers["curve"].tangent(seen.translation) @ seen.rotation[:, 2] < 0.0:
                opposite[closure.name] = True
    return opposite


@made_once
def axis_pairs(mechanism: Mechanism) -> list[tuple[str, list[tuple[int, Array]]]]:
    """Return closures with axes: name, and of each end its joint and axes (3, n) fixed to it."""
    pairs = []
    for closure in mechanism.closures:
        if not closure.pair.aligned or closure.pair.aligned == TANGENT:
            continue
        geometry, first = closure.geometry, 2 if closure.pair.aligned == "z" else 0
        ends = [
            (frame.joint, (frame.placement.rotation @ axes)[:, first:])
            for frame, axes in zip((FrameOnBody.of(mechanism, name) for name in closure.frames),
                                   (geometry.axes1, geometry.axes2), strict=True)]
        pairs.append((closure.name, ends))
    return pairs
