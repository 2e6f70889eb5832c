"""Mirror roots: closures whose equations hold, but whose axes point opposite ways."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.product_vectors import frames_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import COUPLING


def opposite_axes(mechanism: Mechanism, data: pin.Data) -> dict[str, bool]:
    """Return closures whose axes do not point the same way, and whether half a turn helps.

    Closed equations leave them parallel, opposite, or (three equations of rotation) interchanged:
    then half a turn of one of the frames is not what makes them one.

    Args:
        mechanism: with closures.
        data: of its model, with the joint placements.
    """
    found = {}
    for closure in mechanism.closures:
        if closure.type == COUPLING or not closure.pair.aligned:
            continue
        one, two = frames_of(mechanism, closure.frames)
        oM = data.oMi
        geometry = closure.geometry
        assert geometry is not None
        axes1 = oM[one.joint].rotation @ one.placement.rotation @ geometry.axes1
        axes2 = oM[two.joint].rotation @ two.placement.rotation @ geometry.axes2
        cosines = np.vecdot(axes1.T, axes2.T)[2 if closure.pair.aligned == "z" else 0 :]
        if np.any(cosines < 0.5):
            found[closure.name] = bool(np.all(np.abs(cosines) > 0.5))
    return found
