"""A tree as the kernel has it: all joints with a constant motion subspace, see `kernel.h`.

Universal joints and composites of slides and turns are split into single joints, which keeps q, v
and a as they are; the frames of these are turned so that z is the axis.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

TURN, SLIDE, SCREW, BALL, FREE = 1, 2, 3, 4, 5  # the same numbers as JointKind in core/kernel.h
AXIAL = {"R": TURN, "P": SLIDE, "H": SCREW}  # by the first letter of Pinocchio's names
AXISLESS = {"Spherical": BALL, "FreeFlyer": FREE}
AXES = np.eye(3)
SYMMETRIC = np.array([4, 5, 7, 5, 6, 8, 7, 8, 9])  # indices of a (3, 3) inertia in `inertias`


def _parts(joint: pin.JointModel) -> list[tuple[pin.JointModel, pin.SE3 | None]]:
    """Return the single joints of a joint, each with its placement behind the one before."""
    if isinstance(joint, pin.JointModelUniversal):
        axes = joint.axis1, joint.axis2
        return [(pin.JointModelRevoluteUnaligned(axis), None) for axis in axes]
    if isinstance(joint, pin.JointModelComposite):
        placed = zip(joint.joints, joint.jointPlacements, strict=True)
        return [(part.extract(), placement) for part, placement in placed]
    return [(joint, None)]


class TreeArrays:
    """A tree as single joints with their axes along z, as `kernel.h` has them.

    Attributes:
        kind, parent, iq, iv, pitch: (n,) of each joint.
        rotation, translation: (n, 3, 3) by columns, and (n, 3): placement in its parent at zero.
        frames: (n, 3, 3) rotations from Pinocchio's axes of the joints to these.
        carriers: (njoints,) those that carry the bodies of the joints of the tree.
        joint_of: (nv,) the joint of every velocity entry.
        mass, com, inertia: of these bodies, see `in_kernel`.
    """

    def __init__(self, model: pin.Model) -> None:
        carriers, rows = [0], [(0, 0, 0, 0, 0.0)]
        frames, rotations, positions = list[Array]([AXES]), list[Array]([AXES]), [np.zeros(3)]
        joints, fixed, parents = model.joints, model.jointPlacements, list(model.parents)
        for i in range(1, model.njoints):
            joint, placement, at = joints[i], fixed[i], carriers[parents[i]]
            joint = joint.extract() if hasattr(joint, "extract") else joint
            q, v = joint.idx_q, joint.idx_v
            for part, offset in _parts(joint):
                kind, axis, pitch = joint_kind(part)
                rows.append((kind, at, q, v, pitch))
                frames.append(AXES if axis is None else turned_to_z(axis))
                placement = placement if offset is None else placement * offset
                rotations.append(placement.rotation)
                positions.append(placement.translation)
                placement = pin.SE3.Identity()
                at, q, v = len(rows) - 1, q + part.nq, v + part.nv
            carriers.append(at)
        self.carriers, own = np.array(carriers), np.array(frames)
        self.kind, self.parent, self.iq, self.iv = np.array([x[:4] for x in rows], np.int64).T
        self.pitch = np.array([x[4] for x in rows])
        self.joint_of = np.repeat(np.arange(len(rows)), np.diff(self.iv, append=model.nv))
        self.frames, above = own, own[self.parent].mT
        self.rotation = (above @ np.array(rotations) @ own).mT  # stored by columns
        self.translation = (above @ np.array(positions)[..., None])[..., 0]
        self.mass, self.com, self.inertia = in_kernel(inertias(model), own, self.carriers)


@made_once
def single_joints(mechanism: Mechanism) -> TreeArrays:
    """Return the tree of a mechanism, relative to its centre, as single joints."""
    return TreeArrays(mechanism.centred_model)


def inertias(model: pin.Model) -> Array:
    """Return a view (njoints, 10) on inertias: mass, lever, then xx, xy, yy, xz, yz, zz about it.

    It sees later changes.
    """
    first, second = (model.inertias[i].lever for i in (0, min(1, model.njoints - 1)))
    at, after = (x.__array_interface__["data"][0] for x in (first, second))
    n, each = model.njoints, (after - at or 80) // 8
    room = (ctypes.c_double * (n * each)).from_address(at - 8)
    return np.frombuffer(room, float).reshape(n, each)[:, :10]


def in_kernel(
    bodies: Array, frames: Array, carriers: NDArray[np.intp]
) -> tuple[Array, Array, Array]:
    """Return mass (n,), centre (n, 3) and inertia about it (n, 3, 3) of the joints of a kernel.

    Args:
        bodies: (njoints, 10) as `inertias` has them; the ground's do not count.
        frames: see `TreeArrays`.
        carriers: those that carry the bodies.
    """
    n, own = len(frames), frames[carriers]
    mass, com, inertia = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
    mass[carriers] = bodies[:, 0]
    com[carriers] = (own.mT @ bodies[:, 1:4, None])[..., 0]
    inertia[carriers] = own.mT @ bodies[:, SYMMETRIC].reshape(-1, 3, 3) @ own
    mass[0], com[0], inertia[0] = 0.0, 0.0, 0.0
    return mass, com, inertia


def joint_kind(joint: Any) -> tuple[int, Array | None, float]:
    """Return kind, axis (3,) if it has one, and slide per radian of a single joint."""
    name = joint.shortname().removeprefix("JointModel")
    if name in AXISLESS:
        return AXISLESS[name], None, 0.0
    kind = AXIAL.get(name[0])
    if kind is None:
        raise NotImplementedError(f"the kernel has no joint JointModel{name}")
    axis = np.array(joint.axis) if hasattr(joint, "axis") else AXES["XYZ".index(name[-1])]
    return kind, axis, float(joint.pitch) if kind == SCREW else float(kind == SLIDE)


def turned_to_z(axis: Array) -> Array:
    """Return a rotation (3, 3) whose third column is a unit axis (3,); exact along the axes."""
    x, y, z = axis.tolist()
    if (x != 0.0) + (y != 0.0) + (z != 0.0) == 1:
        k = 0 if x else 1 if y else 2
        frame, sign = np.zeros((3, 3)), math.copysign(1.0, axis[k])
        frame[k, 2], frame[(k + 1) % 3, 0], frame[(k + 2) % 3, 1] = sign, 1.0, sign
        return frame
    across = AXES[np.argmin(np.abs(axis))]
    across = across - (across @ axis) * axis
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(axis, across), axis])
