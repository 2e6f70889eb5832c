"""NumPy views on the memory of a `pin.Data`: an access to an SE3 costs more than the kinematics.

The arrays are valid as long as the data lives; keep it.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from spatial_pin.numerics.linalg import Array

# columns: v, omega of a twist; rows of 16: the transposed 4 x 4 matrix, row by row
TWIST_MATRIX = np.zeros((6, 16))
for _i in range(3):
    TWIST_MATRIX[_i, 12 + _i] = 1.0
    TWIST_MATRIX[3 + _i].reshape(4, 4)[:3, :3] = pin.skew(np.eye(3)[_i]).T


def placements(data: pin.Data) -> Array:
    """Return a view (njoints, 4, 3) on the joint placements: three columns of R, then p."""
    n, stride = len(data.oMi), 96
    if n > 1:
        first, second = (data.oMi[i].translation.__array_interface__["data"][0] for i in (0, 1))
        stride = int(second - first)
    return as_strided(data.oMi[0].rotation.T, (n, 4, 3), (stride, 24, 8))


def twists(data: pin.Data) -> Array:
    """Return a view (njoints, 6) on the joint twists, local axes, linear first."""
    return as_strided(data.v[0].linear, (len(data.v), 6), (48, 8))


def accelerations(data: pin.Data) -> Array:
    """Return a view (njoints, 6) on the spatial joint accelerations, local axes, linear first."""
    return as_strided(data.a[0].linear, (len(data.a), 6), (48, 8))


def joint_jacobian(data: pin.Data, nv: int) -> Array:
    """Return a view (6, nv) on the world joint Jacobian, which is one-dimensional for nv = 1."""
    return data.J.reshape(6, nv)


# Pinocchio gives matrices of one column as vectors, and ends the interpreter over some without any.


def frame_jacobian(model: pin.Model, data: pin.Data, frame: int) -> Array:
    """Return the Jacobian (6, nv) of a frame at its origin, world axes; joints' are known."""
    if not model.nv:
        return np.zeros((6, 0))
    J: Array = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return J.reshape(6, model.nv)
