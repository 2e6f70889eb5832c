"""How far the frames of closures are turned against each other: the logarithms of rotations.

Products of axes vanish where the axes are opposite, too, and grow no more beyond a right angle: far
from closure they lead to mirror images. There the rotation vector phi that takes the axes of frame
1 to those of frame 2 stands in their place: of three axes the logarithm of the relative rotation,
of one axis the shortest turn. Near closure both are the same to first order:

    x1 . y2 = -phi_z    y1 . z2 = -phi_x    z1 . x2 = -phi_y    (three axes)
    x1 . z2 =  phi_y    y1 . z2 = -phi_x                        (one axis, z)

The relative angular velocity stands in the place of the derivative of phi. For |phi|^2 / 2 that
gives the exact gradient at any angle, half a turn included, where the derivative of phi itself has
no bound.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.constraints.closure_equations import Constraints, Evaluation
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.numerics.linalg import Array

THREE_AXES = -np.eye(3)[[2, 0, 1]]  # (rows, phi), see above
ONE_AXIS = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
FAR = 0.1  # rad; the products of smaller angles differ from them in the third digit
OPPOSITE = 1e-8  # sine of the angle of opposite axes, between which no turn is the shortest


class _Turn(NamedTuple):
    """The rotation rows of one closure: their places, and the axes in the frames of two joints."""

    rows: NDArray[np.intp]
    joints: tuple[int, int]
    axes: tuple[Array, Array]
    select: Array
    signs: Array


class Rotations:
    """The rotation rows of the closures whose axes must point the same way.

    Args:
        evaluation: whose `residual` and `jacobian` are changed by `put`.
    """

    def __init__(self, evaluation: Evaluation) -> None:
        self.evaluation = evaluation
        turns = list(_turns(evaluation.constraints))
        self._n = len(turns)
        self._jacobian = joint_jacobian(evaluation.data, evaluation.model.nv)
        if not turns:
            return
        self._rows = np.concatenate([t.rows for t in turns])
        self._whose = np.repeat(np.arange(self._n), [len(t.rows) for t in turns])
        self._whole = [len(t.rows) == len(THREE_AXES) for t in turns]
        self._select = np.vstack([t.select for t in turns])
        self._signs = np.array([t.signs for t in turns])[self._whose]
        self._joints = np.array([t.joints for t in turns]).T
        self._axes = np.array([[t.axes[k] for t in turns] for k in (0, 1)])

    def __bool__(self) -> bool:
        """Whether there are any."""
        return self._n > 0

    def _vectors(self) -> tuple[Array, Array]:
        """Return rotation vectors (k, 3) in the axes of frame 1, and these axes (k, 3, 3)."""
        placed = self.evaluation.placements[:, :3]  # transposed rotations
        one, two = (placed[joints].transpose(0, 2, 1) @ axes
                    for joints, axes in zip(self._joints, self._axes, strict=True))
        relative = one.transpose(0, 2, 1) @ two
        return np.array([pin.log3(r) if whole else shortest_turn(r[:, 2])
                         for r, whole in zip(relative, self._whole, strict=True)]), one

    def are_far(self) -> bool:
        """Whether frames are turned by so much that products are no measure of it."""
        return bool(np.linalg.norm(self._vectors()[0], axis=1).max(initial=0.0) > FAR)

    def put(self) -> None:
        """Put rotation vectors and angular velocities in the place of products and derivatives."""
        phi, axes = self._vectors()
        evaluation, who = self.evaluation, self._whose
        evaluation.residual[self._rows] = np.vecdot(self._select, phi[who])
        world = (axes[who] @ self._select[:, :, None])[:, :, 0]
        evaluation.jacobian[self._rows] = (world @ self._jacobian[3:]) * self._signs


def shortest_turn(z: Array) -> Array:
    """Return the rotation vector (3,) of the shortest turn that takes the z axis to `z` (3,)."""
    sine = math.hypot(z[0], z[1])
    angle = math.atan2(sine, z[2])
    if sine > OPPOSITE:
        return np.array([-z[1], z[0], 0.0]) * (angle / sine)
    return np.array([angle if z[2] < 0.0 else -z[1], z[0] * (z[2] > 0.0), 0.0])


def _turns(constraints: Constraints) -> list[_Turn]:
    """Return the rotation rows of closures that have all of them."""
    mechanism, found, at = constraints.mechanism, [], 0
    for closure in mechanism.closures:
        if closure.type == COUPLING:
            continue
        rows = at + np.flatnonzero([row.w is not None for row in closure.rows])
        at += closure.n_rows
        select = {"xyz": THREE_AXES, "z": ONE_AXIS}.get(closure.pair.aligned)
        if select is None or len(rows) != len(select):
            continue
        (i1, m1), (i2, m2) = (mechanism.frame_on_joint(f) for f in closure.frames)
        geometry = closure.geometry
        assert geometry is not None
        signs = (constraints.support(i2) - constraints.support(i1)) * mechanism.velocity_scale
        found.append(_Turn(rows, (i1, i2),
                           (m1.rotation @ geometry.axes1, m2.rotation @ geometry.axes2),
                           select, signs))
    return found


def rotations_of(evaluation: Evaluation) -> Rotations:
    """Return the rotation rows of an evaluation, made once."""
    if evaluation.rotations is None:
        evaluation.rotations = Rotations(evaluation)
    found: Rotations = evaluation.rotations
    return found
