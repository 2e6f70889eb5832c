"""A model whose joints all have a constant motion subspace: the same motion, more bodies.

Pinocchio's derivative algorithms are right for such joints only: in 4.1 they leave out the change
of the subspace of universal joints and of composites of slides and turns. Splitting these into
their single joints keeps q, v and a as they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.mechanism.mechanism import Mechanism

COMPOSITE = ("JointModelUniversal", "JointModelComposite")


class SplitModel(NamedTuple):
    """A model with single joints.

    Attributes:
        model: with the same nq and nv, entries in the same order.
        joint: (njoints,) for each joint of the original, the one that carries its body.
    """

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
