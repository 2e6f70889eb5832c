"""A motion of a tree, and how twists and accelerations of its bodies change with it.

In world axes about the world's origin, with S the twist of a coordinate, V and A the twist and the
acceleration of the body that carries its joint and v of the one that it moves, changes of q and v
make of a body's twist and acceleration (v_i, a_i), seen from the body as it moves with q
[SinghRussellWensing2022]:

    dv_i / dq = dS = V x S,           da_i / dq = A x S + V x dS - v_i x dS,
    dv_i / dv = da_i / da = S,        da_i / dv = dS + v x S - v_i x S

Joints are single ones, whose motion subspace is constant (`constraints.composite_joints`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.composite_joints import split_of
from spatial_pin.constraints.kernel_tree import KernelTree
from spatial_pin.constraints.pinocchio_views import TWIST_MATRIX
from spatial_pin.constraints.workspaces import acquired
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.stacked import cross

Motion = tuple[Array, Array, Array]  # q (nq,), v and a (nv,)


class TreeMotion:
    """A tree of single joints at a motion.

    Args:
        mechanism: the mechanism.
        motion: q (nq,), v and a (nv,).

    Attributes:
        model: the tree with single joints.
        joints: (njoints,) its joints that carry the bodies of the mechanism's tree.
        joint_of: (nv,) the joint of every velocity entry.
        moved_by: (joints, nv) whether a velocity entry moves a joint's body.
        at: (joints, 4, 3) columns of the rotation, then the position, of each joint.
        placements: (njoints, 4, 3) of the mechanism's joints.
        v, a: (joints, 6) world twists and spatial accelerations of their bodies.
        columns, turned, twice, paced: (nv, 6) S, dS, A x S + V x dS and dS + v x S.
    """

    def __init__(self, mechanism: Mechanism, motion: Motion) -> None:
        self.mechanism, self._motion = mechanism, motion
        self.model, self.joints = split_of(mechanism)
        model, parents = self.model, np.array(self.model.parents)
        self.joint_of = np.repeat(np.arange(model.njoints), np.array(model.nvs))
        self.moved_by = np.zeros((model.njoints, model.nv), bool)
        self.moved_by[self.joint_of, np.arange(model.nv)] = True
        for joint, parent in enumerate(parents.tolist()):
            self.moved_by[joint] |= self.moved_by[parent]
        with tree_of_single_joints(mechanism) as tree:
            tree.update(motion[0])
            tree.move(*motion)
            self.at, columns = tree.placements.copy(), tree.columns.T.copy()
            local = np.stack([tree.twists, tree.accelerations])
        world = (local.reshape(2, -1, 2, 3) @ self.at[:, :3]).reshape(local.shape)
        world[..., :3] += cross(self.at[:, 3], world[..., 3:])
        self.v, self.a = world
        carrier = parents[self.joint_of]
        around = motion_cross(np.stack([
            self.v[carrier], self.a[carrier], self.v[self.joint_of]]))
        self.columns, (turned, twice, paced) = columns, (around @ columns[..., None])[..., 0]
        self.turned, self.paced = turned, turned + paced
        self.twice = twice + (around[0] @ turned[..., None])[..., 0]
        self.placements = self.at[self.joints]

    def to_bodies(self, joints: NDArray[np.intp]) -> Array:
        """Return the matrices (k, 6, 6) that take world twists to the axes of joints (k,)."""
        at, back = self.at[joints], np.zeros((len(joints), 6, 6))
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
        is_moved, back = self.moved_by[joints][:, None], self.to_bodies(joints)
        spun = back @ motion_cross(self.v[joints])
        turned, twice, paced, columns = (
            x.T for x in (self.turned, self.twice, self.paced, self.columns))
        return (np.where(is_moved, back @ turned, 0.0),
                np.where(is_moved, back @ twice - spun @ turned, 0.0),
                np.where(is_moved, back @ paced - spun @ columns, 0.0),
                np.where(is_moved, back @ columns, 0.0))


def tree_of_single_joints(mechanism: Mechanism) -> acquired[KernelTree]:
    """Acquire the tree of a mechanism, its joints single ones."""
    return acquired(mechanism, _tree_of_single_joints)


def _tree_of_single_joints(mechanism: Mechanism) -> KernelTree:
    return KernelTree(split_of(mechanism).model)


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
