"""Mirror roots: closures whose equations hold, but whose axes point opposite ways."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.vector_products import FrameOnBody
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


def opposite_axes(mechanism: Mechanism, data: pin.Data) -> dict[str, bool]:
    """Return closures whose axes do not point the same way, and whether half a turn helps.

    Closed equations leave them parallel, opposite, or (three equations of rotation) interchanged:
    then half a turn of one of the frames is not what makes them one.

    Args:
        mechanism: with closures.
        data: of its model, with the joint placements.
    """
    found = {}
    for pair in _axis_pairs(mechanism):
        one, two = (data.oMi[joint].rotation @ axes for joint, axes in pair.fixed)
        cosines = np.vecdot(one.T, two.T)
        if np.any(cosines < 0.5):
            found[pair.closure] = bool(np.all(np.abs(cosines) > 0.5))
    return found


class _AxisPair(NamedTuple):
    """Axes of a closure that should point the same way.

    Attributes:
        closure: its name.
        fixed: the joint that carries each end, and the axes (3, n) fixed to it.
    """

    closure: str
    fixed: tuple[tuple[int, Array], tuple[int, Array]]


@made_once
def _axis_pairs(mechanism: Mechanism) -> list[_AxisPair]:
    """Return the axes of all closures that have any."""
    found = []
    for closure in mechanism.closures:
        if not closure.pair.aligned:
            continue
        geometry, first = closure.geometry, 2 if closure.pair.aligned == "z" else 0
        one, two = (
            (frame.joint, (frame.placement.rotation @ axes)[:, first:])
            for frame, axes in zip((FrameOnBody.of(mechanism, name) for name in closure.frames),
                                   (geometry.axes1, geometry.axes2), strict=True))
        found.append(_AxisPair(closure.name, (one, two)))
    return found
