"""A model whose joints all have a constant motion subspace: the same motion, more bodies.

The kernel uses it too: its arrays have the frames of joints turned so that z is the axis.

Pinocchio's derivative algorithms are right for such joints only: in 4.1 they leave out the change
of the subspace of universal joints and of composites of slides and turns. Splitting these into
their single joints keeps q, v and a as they are.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

COMPOSITE = ("JointModelUniversal", "JointModelComposite")
TURN, SLIDE, SCREW, BALL, FREE = 1, 2, 3, 4, 5  # the same numbers as JointKind in core/kernel.h
AXIAL = {"R": TURN, "P": SLIDE, "H": SCREW}  # by the first letter of Pinocchio's names
AXISLESS = {"Spherical": BALL, "FreeFlyer": FREE}
AXES = np.eye(3)
SYMMETRIC = np.array([4, 5, 7, 5, 6, 8, 7, 8, 9])  # indices of a (3, 3) inertia in `inertias`


class SplitModel(NamedTuple):
    """A model with single joints, and which (njoints,) of them carry the bodies of the original."""

    model: pin.Model
    joint: NDArray[np.intp]


@made_once
def split_of(mechanism: Mechanism) -> SplitModel:
    """Return the tree of a mechanism, relative to its centre, split."""
    return split(mechanism.centred_model)


def split(model: pin.Model) -> SplitModel:
    """Return `model` with universal and composite joints split; inertias stay with their bodies."""
    if not any(joint.shortname().startswith(COMPOSITE) for joint in model.joints):
        return SplitModel(model, np.arange(model.njoints))
    out = pin.Model()
    out.gravity = model.gravity
    carrier = [0]
    for i in range(1, model.njoints):
        placement, at = model.jointPlacements[i], carrier[model.parents[i]]
        for k, (joint, offset) in enumerate(_parts(model.joints[i].extract())):
            placement = placement if offset is None else placement * offset
            at = out.addJoint(at, joint, placement, f"{model.names[i]} {k}")
            placement = pin.SE3.Identity()
        out.inertias[at] = model.inertias[i]
        carrier.append(at)
    out.armature = model.armature  # entries of the velocity keep their order
    return SplitModel(out, np.array(carrier))


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
