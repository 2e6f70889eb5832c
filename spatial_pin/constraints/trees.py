"""Kinematics of trees: of small ones by Pinocchio, of others by the kernel.

Both stay: an update of a small tree takes Pinocchio a twelfth of the time, and to make it a fifth;
the kernel's memory grows with the tree, not with its cube.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import acquired
from spatial_pin.constraints.kernel_tree import KernelTree, centred_tree, is_in_kernel
from spatial_pin.constraints.pinocchio_views import (
    TWIST_MATRIX,
    accelerations,
    frame_jacobian,
    joint_jacobian,
    placements,
    twists,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.stacked import cross

Motion = tuple[Array, Array, Array]  # q (nq,), v and a (nv,)


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


class TreePlacements:
    """Placements (njoints, 4, 3) as `pin.Data.oMi` has them, each made at its first use."""

    def __init__(self, placements: Array) -> None:
        self._placements = placements

    def __getitem__(self, joint: int) -> pin.SE3:
        at = self._placements[joint]
        return pin.SE3(at[:3].T, at[3])


class LargeTree:
    """Kinematics of a tree by the kernel; attributes and methods as of `Tree`.

    Of a `pin.Data`, `data` has the part that there is: `J` and `oMi`.
    """

    def __init__(self, model: pin.Model) -> None:
        self.model, self._tree = model, KernelTree(model)
        n, single = model.njoints, len(self._tree.arrays.kind)
        self.placements, self.columns = np.empty((n, 4, 3)), np.empty((6, model.nv))
        self.twists, self.accelerations = np.zeros((2, n, 6))
        self.data = SimpleNamespace(J=self.columns, oMi=TreePlacements(self.placements))
        self._R, self._p = np.empty((single, 3, 3)), np.empty((single, 3))

    def update(self, q: Array) -> None:
        """Set `placements` and `columns` at the configuration q (nq,)."""
        self._tree.evaluate(q, jacobian=self.columns, R=self._R, p=self._p)
        self.placements[:] = self._tree.placed(self._R, self._p)

    def frame_jacobian(self, frame: int) -> Array:
        """Return the Jacobian (6, nv) of a frame at its origin, world axes, where it is placed."""
        model, at = self.model, self.model.frames[frame]
        jacobian = np.zeros_like(self.columns)
        for i in list(model.supports[at.parentJoint])[1:]:
            own = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
            jacobian[:, own] = self.columns[:, own]
        placement = self.data.oMi[at.parentJoint] * at.placement
        jacobian[:3] -= pin.skew(placement.translation) @ jacobian[3:]
        return jacobian

    def move(self, q: Array, v: Array, a: Array) -> None:
        """Set `placements`, `twists` and `accelerations` of a motion."""
        velocity, acceleration = np.empty((2, len(self._p), 6))
        self._tree.evaluate(q, v, a, velocity=velocity, acceleration=acceleration,
                            R=self._R, p=self._p)
        self.placements[:] = self._tree.placed(self._R, self._p)
        at = self._tree.arrays.carriers
        seen, felt = velocity[at], acceleration[at]
        felt[:, :3] -= cross(seen[:, 3:], seen[:, :3])
        for world, local in ((seen, self.twists), (felt, self.accelerations)):
            np.matmul(self.placements[:, None, :3], world.reshape(-1, 2, 3, 1),
                      out=local.reshape(-1, 2, 3, 1))


def tree_of(model: pin.Model) -> Tree | LargeTree:
    """Return the kinematics of a tree, by Pinocchio or by the kernel."""
    return LargeTree(model) if is_in_kernel(model) else Tree(model)


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


def _tree(mechanism: Mechanism) -> LargeTree:
    return LargeTree(mechanism.model)


class TreeMotion:
    """A tree of single joints at a motion, and how twists and accelerations change with it.

    In world axes about the world's origin, with S the twist of a coordinate, V and A the twist and
    the acceleration of the body that carries its joint and v of the one that it moves, changes of
    q and v make of a body's twist and acceleration (v_i, a_i), seen from the body as it moves with
    q [SinghRussellWensing2022]:

        dv_i / dq = dS = V x S,           da_i / dq = A x S + V x dS - v_i x dS,
        dv_i / dv = da_i / da = S,        da_i / dv = dS + v x S - v_i x S

    Args:
        mechanism: the mechanism.
        motion: q (nq,), v and a (nv,).

    Attributes:
        parents: (joints,) of the single joints.
        joints: (njoints,) those that carry the bodies of the mechanism's tree.
        joint_of: (nv,) the joint of every velocity entry.
        moved_by: (joints, nv) whether a velocity entry moves a joint's body.
        placements: (njoints, 4, 3) columns of the rotation, then the position, of the mechanism's
            joints.
        v, a: (joints, 6) world twists and spatial accelerations of their bodies.
        columns, turned, twice, paced: (nv, 6) S, dS, A x S + V x dS and dS + v x S.
    """

    def __init__(self, mechanism: Mechanism, motion: Motion) -> None:
        self.mechanism = mechanism
        with acquired(mechanism, centred_tree) as tree:
            arrays, nv = tree.arrays, tree.model.nv
            n, columns = len(arrays.kind), np.empty((6, nv))
            rotations, positions, world = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((2, n, 6))
            tree.evaluate(*motion, R=rotations, p=positions, jacobian=columns, velocity=world[0],
                          acceleration=world[1])
            self.placements = tree.placed(rotations, positions)
        self.parents, self.joints, self.joint_of = arrays.parent, arrays.carriers, arrays.joint_of
        self.moved_by = np.zeros((n, nv), bool)
        self.moved_by[self.joint_of, np.arange(nv)] = True
        for joint, parent in enumerate(self.parents.tolist()):
            self.moved_by[joint] |= self.moved_by[parent]
        world[1, :, :3] -= cross(world[0, :, 3:], world[0, :, :3])  # spatial
        world[..., :3] += cross(positions, world[..., 3:])
        self.v, self.a = world
        columns, carrier = columns.T.copy(), self.parents[self.joint_of]
        around = motion_cross(np.stack([
            self.v[carrier], self.a[carrier], self.v[self.joint_of]]))
        self.columns, (turned, twice, paced) = columns, (around @ columns[..., None])[..., 0]
        self.turned, self.paced = turned, turned + paced
        self.twice = twice + (around[0] @ turned[..., None])[..., 0]

    def to_bodies(self, bodies: NDArray[np.intp]) -> Array:
        """Return the matrices (k, 6, 6) that take world twists to the axes of bodies (k,)."""
        at, back = self.placements[bodies], np.zeros((len(bodies), 6, 6))
        back[:, :3, :3] = back[:, 3:, 3:] = at[:, :3]
        back[:, :3, 3:] = -at[:, :3] @ skewed(at[:, 3])
        return back

    def by_motion(self, bodies: NDArray[np.intp]) -> tuple[Array, Array, Array, Array]:
        """Return how twists and accelerations of bodies (k,) change, in their own axes.

        Returns:
            Derivatives (k, 6, nv) of twists by q, of accelerations by q, v and a; that by a is also
                that of twists by v.
        """
        joints = self.joints[bodies]
        is_moved, back = self.moved_by[joints][:, None], self.to_bodies(bodies)
        spun = back @ motion_cross(self.v[joints])
        turned, twice, paced, columns = (
            x.T for x in (self.turned, self.twice, self.paced, self.columns))
        return (np.where(is_moved, back @ turned, 0.0),
                np.where(is_moved, back @ twice - spun @ turned, 0.0),
                np.where(is_moved, back @ paced - spun @ columns, 0.0),
                np.where(is_moved, back @ columns, 0.0))


def twist_matrices(twists: Array) -> Array:
    """Return the transposed 4 x 4 matrices of twists (..., 6)."""
    matrices: Array = (twists @ TWIST_MATRIX).reshape(*twists.shape[:-1], 4, 4)
    return matrices


def skewed(a: Array) -> Array:
    """Return the matrices (..., 3, 3) of the cross products a x of vectors (..., 3)."""
    matrices: Array = (a @ TWIST_MATRIX[3:]).reshape(*a.shape[:-1], 4, 4)[..., :3, :3].mT
    return matrices


def motion_cross(v: Array) -> Array:
    """Return the matrices (..., 6, 6) of v x on twists, for twists v (..., 6)."""
    out = np.zeros((*v.shape[:-1], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = skewed(v[..., 3:])
    out[..., :3, 3:] = skewed(v[..., :3])
    return out
