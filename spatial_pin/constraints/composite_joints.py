"""A model whose joints all have a constant motion subspace: the same motion, more bodies.

The kernel uses it too: its arrays have the frames of joints turned so that z is the axis.

Pinocchio's derivative algorithms are right for such joints only: in 4.1 they leave out the change
of the subspace of universal joints and of composites of slides and turns. Splitting these into
their single joints keeps q, v and a as they are.
"""

from __future__ import annotations

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
            at = out.addJoint(at, joint, placement * offset, f"{model.names[i]} {k}")
            placement = pin.SE3.Identity()
        out.inertias[at] = model.inertias[i]
        carrier.append(at)
    out.armature = model.armature  # entries of the velocity keep their order
    return SplitModel(out, np.array(carrier))


def _parts(joint: pin.JointModel) -> list[tuple[pin.JointModel, pin.SE3]]:
    """Return the single joints of a joint, each with its placement behind the one before."""
    if isinstance(joint, pin.JointModelUniversal):
        axes = joint.axis1, joint.axis2
        return [(pin.JointModelRevoluteUnaligned(axis), pin.SE3.Identity()) for axis in axes]
    if isinstance(joint, pin.JointModelComposite):
        placed = zip(joint.joints, joint.jointPlacements, strict=True)
        return [(part.extract(), placement) for part, placement in placed]
    return [(joint, pin.SE3.Identity())]


class TreeArrays:
    """Joints of a split model with their axes along z, as `kernel.h` has them."""

    def __init__(self, model: pin.Model) -> None:
        n = model.njoints
        self.kind, self.parent, self.iq, self.iv = np.zeros((4, n), np.int64)
        self.pitch, self.mass = np.zeros((2, n))
        self.frames = np.tile(np.eye(3), (n, 1, 1))
        rotation, translation = self.frames.copy(), np.zeros((n, 3))
        lever, inertia = np.zeros((n, 3)), np.zeros((n, 3, 3))
        for i in range(1, n):
            joint = model.joints[i]
            joint = joint.extract() if hasattr(joint, "extract") else joint
            self.kind[i], axis, self.pitch[i] = joint_kind(joint)
            self.parent[i], self.iq[i], self.iv[i] = model.parents[i], joint.idx_q, joint.idx_v
            if axis is not None:
                self.frames[i] = turned_to_z(axis)
            placement, body = model.jointPlacements[i], model.inertias[i]
            rotation[i], translation[i] = placement.rotation, placement.translation
            self.mass[i], lever[i], inertia[i] = body.mass, body.lever, body.inertia
        own, above = self.frames, self.frames[self.parent].mT
        self.rotation = (above @ rotation @ own).mT  # stored by columns
        self.translation = (above @ translation[..., None])[..., 0]
        self.com = (own.mT @ lever[..., None])[..., 0]
        self.inertia = own.mT @ inertia @ own


def joint_kind(joint: Any) -> tuple[int, Array | None, float]:
    """Return kind, axis (3,) if it has one, and slide per radian of a joint of the split model."""
    if isinstance(joint, pin.JointModelSpherical):
        return BALL, None, 0.0
    if isinstance(joint, pin.JointModelFreeFlyer):
        return FREE, None, 0.0
    name = joint.shortname()
    letter = name.removeprefix("JointModel")[0]
    if letter not in AXIAL:
        raise NotImplementedError(f"the kernel has no joint {name}")
    axis = np.array(joint.axis) if hasattr(joint, "axis") else np.eye(3)["XYZ".index(name[-1])]
    pitch = {"R": 0.0, "P": 1.0}.get(letter)
    return AXIAL[letter], axis, float(joint.pitch) if pitch is None else pitch


def turned_to_z(axis: Array) -> Array:
    """Return a rotation (3, 3) whose third column is a unit axis (3,); exact along the axes."""
    along = np.flatnonzero(axis)
    if len(along) == 1:
        k, frame = along[0], np.zeros((3, 3))
        sign = np.sign(axis[k])
        frame[k, 2], frame[(k + 1) % 3, 0], frame[(k + 2) % 3, 1] = sign, 1.0, sign
        return frame
    across = np.eye(3)[np.argmin(np.abs(axis))]
    across = across - (across @ axis) * axis
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(axis, across), axis])
