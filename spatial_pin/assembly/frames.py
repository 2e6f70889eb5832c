"""Placements and motions of frames of a large tree, without a `pin.Data`.

For 400 freedoms a `pin.Data` takes 4 GB and seconds to make.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.kernel_tree import KernelTree
from spatial_pin.constraints.trees import is_in_kernel
from spatial_pin.constraints.workspaces import acquired
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


class Located(NamedTuple):
    """A motion of a tree, evaluated for single frames.

    Attributes:
        model: the tree.
        placements: (njoints, 4, 3) of the joints, columns of the rotation, then the position.
        twists, accelerations: (njoints, 6) spatial ones, joint axes.
    """

    model: pin.Model
    placements: Array
    twists: Array
    accelerations: Array

    def placement(self, frame: int) -> pin.SE3:
        """Return the placement of a frame by Pinocchio's index of it."""
        at = self.model.frames[frame]
        columns = self.placements[at.parentJoint]
        return pin.SE3(columns[:3].T, columns[3]) * at.placement

    def motion(self, frame: int) -> tuple[pin.Motion, pin.Motion]:
        """Return velocity and classical acceleration of a frame at its origin, world axes."""
        at = self.model.frames[frame]
        world, arm = self.placements[at.parentJoint, :3].T, at.placement.translation
        (v, w), (a, e) = (x[at.parentJoint].reshape(2, 3)
                          for x in (self.twists, self.accelerations))
        turning = np.cross(w, arm)
        felt = a + np.cross(w, v) + np.cross(e, arm) + np.cross(w, turning)
        return pin.Motion(world @ (v + turning), world @ w), pin.Motion(world @ felt, world @ e)


def located(mechanism: Mechanism, q: Array, v: Array, a: Array) -> Located | None:
    """Return a motion of a tree in the kernel; None for a small tree."""
    model = mechanism.model
    if not is_in_kernel(model):
        return None
    with acquired(mechanism, _tree) as tree:
        tree.move(q, v, a)
        return Located(model, tree.placements.copy(), tree.twists.copy(),
                       tree.accelerations.copy())


def _tree(mechanism: Mechanism) -> KernelTree:
    return KernelTree(mechanism.model)
