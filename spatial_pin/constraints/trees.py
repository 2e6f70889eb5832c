"""Kinematics of trees: of small ones by Pinocchio, of others by the kernel.

A `pin.Data` takes memory with the cube of the number of freedoms (4 GB for 400), and some of its
algorithms time with the square.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.constraints.kernel_tree import KernelTree
from spatial_pin.constraints.pinocchio_views import (
    accelerations,
    frame_jacobian,
    joint_jacobian,
    placements,
    twists,
)
from spatial_pin.constraints.workspaces import acquired
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

WHOLE = 60  # freedoms from which on the kernel moves a tree: a `pin.Data` has 10 MB there
BRANCHES = 4  # at the ground, from which on each subtree is small beside the tree


def is_in_kernel(model: pin.Model) -> bool:
    """Whether the kernel moves a tree: it is too large for a `pin.Data`."""
    return model.nv >= WHOLE


def is_large(model: pin.Model) -> bool:
    """Whether a tree is large, and has branches that do not depend on each other."""
    return is_in_kernel(model) and len(model.children[0]) >= BRANCHES


class Tree:
    """Kinematics of a small tree, as views on the memory of a `pin.Data`.

    Attributes:
        data: Pinocchio's.
        placements: (njoints, 4, 3) of the joints, columns of the rotation, then the position.
        columns: (6, nv) world joint Jacobian.
        twists, accelerations: (njoints, 6) spatial ones, joint axes.
    """

    def __init__(self, model: pin.Model) -> None:
        self.model, self.data = model, model.createData()
        self.placements, self.columns = placements(self.data), joint_jacobian(self.data, model.nv)
        self.twists, self.accelerations = twists(self.data), accelerations(self.data)

    def update(self, q: Array) -> None:
        """Set `placements` and `columns` at the configuration q (nq,)."""
        pin.computeJointJacobians(self.model, self.data, q)

    def frame_jacobian(self, frame: int) -> Array:
        """Return the Jacobian (6, nv) of a frame at its origin, world axes, where it is placed."""
        return frame_jacobian(self.model, self.data, frame)

    def move(self, q: Array, v: Array, a: Array) -> None:
        """Set `placements`, `twists` and `accelerations` of a motion."""
        pin.forwardKinematics(self.model, self.data, q, v, a)


def tree_of(model: pin.Model) -> Tree | KernelTree:
    """Return the kinematics of a tree, by Pinocchio or by the kernel."""
    return KernelTree(model) if is_in_kernel(model) else Tree(model)


def mass_pattern(model: pin.Model) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return (rows, columns) of freedoms where one carries the other."""
    related = np.zeros((model.nv, model.nv), dtype=bool)
    for i in range(1, model.njoints):
        own = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
        for j in model.supports[i]:
            other = slice(model.idx_vs[j], model.idx_vs[j] + model.nvs[j])
            related[own, other] = related[other, own] = True
    rows, columns = np.nonzero(related)
    return rows, columns


class Located(NamedTuple):
    """A motion of a tree of joints, as `Tree` has it, evaluated for single frames."""

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
