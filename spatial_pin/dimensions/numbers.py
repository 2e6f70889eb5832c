"""The numbers that the kernel's mechanism is made of, at many sets of dimensions together.

A number is that of a joint's or frame's placement, which the traced file gives; of a vector that is
fixed in a frame and moves with it; or it goes as a power of the characteristic length.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.state import center_of_mass
from spatial_pin.constraints.composite_joints import split_of
from spatial_pin.dimensions.variants import Pose, TracedGeometry, TracedTree, copied
from spatial_pin.kernel.dimensions import Numbers
from spatial_pin.kernel.packing import packed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

Block = tuple[NDArray[np.int64], Array]  # places of n numbers, and what they are, (m or 1, n)


class DimensionNumbers:
    """The kernel's numbers of a mechanism as functions of some of its dimensions.

    Args:
        mechanism: at its own dimensions.
        tree: its file, traced.
        points: links, frames or joints, or `LINK.com`, that outputs are of.

    Attributes:
        base: at its own dimensions, those of the points behind the kernel's.
        joints: of the model, that carry the points.

    Raises:
        UnknownNameError: there is no such point.
        SpatialPinError: a link has no mass, hence no centre of mass.
    """

    def __init__(self, mechanism: Mechanism, tree: TracedTree, points: Iterable[str]) -> None:
        self._mechanism, self._points, self._packed = mechanism, list(points), packed(mechanism)
        self._frames = [mechanism.frame_id(name.removesuffix(".com")) for name in self._points]
        self.joints = [int(mechanism.model.frames[i].parentJoint) for i in self._frames]
        self._powers = _powers_of_length(mechanism)
        own, n = tree.own(), len(self._packed.reals)
        ends = [self._offset(name, self.placed(own))[0] for name in self._points]
        self.base = np.concatenate([self._packed.reals, *ends])
        self._end = np.arange(n, len(self.base)).reshape(-1, 3)
        self._span = _Span(mechanism, self.placed(own))

    def at(self, found: TracedGeometry, rescaled: bool = True) -> Numbers:
        """Return the numbers at m sets of dimensions, those of the points behind the kernel's.

        Args:
            found: what follows from the dimensions.
            rescaled: whether lengths are relative to the characteristic length that each set has;
                else to the mechanism's own.
        """
        found = self.placed(found)
        blocks = [*(self._scaled(found) if rescaled else ()), *self._blocks(found)]
        places, values = zip(*blocks, strict=True) if blocks else ((), ())
        every = [np.broadcast_to(x, (len(found.holds), x.shape[1])) for x in values]
        return Numbers(self.base, np.concatenate([np.empty(0, np.int64), *places]),
                       np.concatenate([np.empty((len(found.holds), 0)), *every], axis=1))

    def placed(self, found: TracedGeometry) -> TracedGeometry:
        """Return the same mechanisms as the kernel has them.

        The axes of joints in their bodies are as here, and what is on the ground is relative to
        the centre of the mechanism.
        """
        model, centre = self._mechanism.model, self._mechanism.centre
        found = self.with_own_axes(found)
        if not centre.any():
            return found
        joints, frames = ({i: x._replace(translation=x.translation - centre) if on_ground(i) else x
                           for i, x in poses.items()} for poses, on_ground in (
            (found.joints, lambda i: model.parents[i] == 0),
            (found.frames, lambda i: model.frames[i].parentJoint == 0)))
        return found._replace(joints=joints, frames=frames)

    def with_own_axes(self, found: TracedGeometry) -> TracedGeometry:
        """Return the same mechanisms with the axes of joints in their bodies as they are here.

        The bodies' own axes are turned instead: Q in the joint's placement and its transpose in
        what the body carries.
        """
        if not found.turns:
            return found
        model, joints, frames = self._mechanism.model, dict(found.joints), dict(found.frames)
        for i, turn in found.turns.items():
            back = Pose(turn.rotation.transpose(0, 2, 1), turn.translation)
            joints[i] = joints.get(i, Pose.of(model.jointPlacements[i])) @ turn
            for j in range(1, model.njoints):
                if model.parents[j] == i:
                    joints[j] = back @ joints.get(j, Pose.of(model.jointPlacements[j]))
            for k, frame in enumerate(model.frames):
                if frame.parentJoint == i:
                    frames[k] = back @ _frame(model, k, found)
        return found._replace(joints=joints, frames=frames)

    def _scaled(self, found: TracedGeometry) -> Iterator[Block]:
        """Yield what goes with the characteristic length."""
        scaled = np.flatnonzero(self._powers)
        ratio = self._span.at(found) / self._mechanism.characteristic_length
        yield scaled, self.base[scaled] * ratio[:, None] ** self._powers[scaled]

    def _blocks(self, found: TracedGeometry) -> Iterator[Block]:
        """Yield what else depends on the dimensions."""
        yield from self._joint_blocks(found)
        yield from self._vector_blocks(found)
        for name, frame, places in zip(self._points, self._frames, self._end, strict=True):
            if frame in found.frames or name.removesuffix(".com") in found.levers:
                yield places, self._offset(name, found)

    def _joint_blocks(self, found: TracedGeometry) -> Iterator[Block]:
        """Yield the placements of joints, which the kernel's have their axes along z in."""
        carriers, turned = self._packed.carriers, self._packed.frames
        split, places = split_of(self._mechanism).model, self._packed.places()
        for i, pose in found.joints.items():
            at = int(carriers[i - 1]) + 1  # the first of the single joints that it is split into
            own = self._mechanism.centred_model.jointPlacements[i]
            rest = own.actInv(split.jointPlacements[at])
            placed, above = pose @ Pose.of(rest), turned[split.parents[at]]
            columns = (above.T @ placed.rotation @ turned[at]).transpose(0, 2, 1)
            yield places.rotation[at].ravel(), columns.reshape(-1, 9)
            yield places.translation[at], placed.translation @ above

    def _vector_blocks(self, found: TracedGeometry) -> Iterator[Block]:
        """Yield the vectors of closure equations and the axes of idle rotations."""
        model, local = self._mechanism.model, self._packed.parts().local
        places, fixed_in = self._packed.places().local, self._packed.fixed_in.tolist()
        for k, (frame, is_point) in enumerate(zip(fixed_in, self._packed.is_point, strict=True)):
            if frame < 0:
                own = self._turned(self._mechanism.frame_on_joint(self._axis(frame)[0])[0])
                yield places[k], self._idle_axis(frame, found) @ own
            elif frame in found.frames:
                pose, own = found.frames[frame], self._turned(model.frames[frame].parentJoint)
                fixed = model.frames[frame].placement.rotation.T @ own @ local[k]
                yield places[k], (pose.translation if is_point else pose.rotation @ fixed) @ own

    def _turned(self, joint: int) -> Array:
        """Return the axes of the kernel's joint (3, 3) in those of the joint of the model."""
        return self._packed.frames[self._packed.carriers[joint]]

    def _axis(self, frame: int) -> tuple[str, str, str]:
        """Return the body of an idle rotation and the two points that its axis runs through."""
        passive = self._mechanism.passives[-1 - frame]
        return passive.body, *passive.axis

    def _idle_axis(self, frame: int, found: TracedGeometry) -> Array:
        """Return the unit vector (m or 1, 3) of an idle rotation's axis in the joint's axes."""
        body, *ends = self._axis(frame)
        joint = self._mechanism.frame_on_joint(body)[0]
        a, b = (self._on_body(joint, self._mechanism.frame_id(name), found) for name in ends)
        return (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)

    def _on_body(self, joint: int, frame: int, found: TracedGeometry) -> Array:
        """Return a frame's origin (m or 1, 3) in the axes of a joint, as `point_on_body`."""
        model, own = self._mechanism.model, self._mechanism.model.frames[frame].parentJoint
        if own == joint:
            return _frame(model, frame, found).translation
        return found.joints.get(own, Pose.of(model.jointPlacements[own])).translation

    def _offset(self, name: str, found: TracedGeometry) -> Array:
        """Return a point (m or 1, 3) in the axes of the kernel's joint that carries it [m]."""
        link, frame = name.removesuffix(".com"), self._mechanism.frame_id(name.removesuffix(".com"))
        pose = _frame(self._mechanism.centred_model, frame, found)
        offset = pose.translation
        if link != name:
            lever = center_of_mass(self._mechanism, link)[None]
            offset = pose.act(found.levers.get(link, lever))
        return offset @ self._turned(self._mechanism.model.frames[frame].parentJoint)


def _frame(model: pin.Model, frame: int, found: TracedGeometry) -> Pose:
    return found.frames.get(frame, Pose.of(model.frames[frame].placement))


def _powers_of_length(mechanism: Mechanism) -> Array:
    """Return (n,) the powers of the characteristic length that the kernel's numbers go with.

    They are seen by doubling it, which changes no digit.
    """
    other = copied(mechanism)
    other.__dict__["characteristic_length"] = 2.0 * mechanism.characteristic_length
    one, two = packed(mechanism).reals, packed(other).reals
    powers = np.zeros(len(one))
    changed = one != two
    powers[changed] = np.log2(two[changed] / one[changed])
    return powers


class _Span:
    """The characteristic length: the largest distance of two frames where joints are at zero."""

    def __init__(self, mechanism: Mechanism, own: TracedGeometry) -> None:
        self._model, self._counted = mechanism.centred_model, mechanism.extent.frames
        points = self._points(own)
        self._points_at_own = np.concatenate([np.broadcast_to(x, (1, 3)) for x in points])
        self._distances = np.linalg.norm(
            self._points_at_own[:, None] - self._points_at_own[None], axis=2)

    def at(self, found: TracedGeometry) -> Array:
        """Return (m,) the characteristic lengths [m].

        Only those pairs of points can be the farthest that have been nearly, at the mechanism's own
        dimensions: but for twice what both of them have moved, and the farthest pair too.
        """
        points, m = self._points(found), len(found.holds)
        moved = max(float(np.abs(x - own).max(initial=0.0))
                    for x, own in zip(points, self._points_at_own, strict=True))
        least = self._distances.max() - 4.0 * np.sqrt(3.0) * moved
        squares = np.zeros(m)
        for i, j in np.argwhere(np.triu(self._distances >= least, 1)):
            apart = points[i] - points[j]
            squares = np.maximum(squares, np.einsum("mi,mi->m", apart, apart))
        return np.where(squares > 0.0, np.sqrt(squares), 1.0)

    def _points(self, found: TracedGeometry) -> list[Array]:
        """Return the origins (m or 1, 3) of frames that count where every joint is at its zero."""
        model = self._model
        joints = [Pose.of(pin.SE3.Identity())]
        for i in range(1, model.njoints):
            own = found.joints.get(i, Pose.of(model.jointPlacements[i]))
            joints.append(joints[model.parents[i]] @ own)
        return [joints[frame.parentJoint].act(_frame(model, i, found).translation)
                for i, frame in enumerate(model.frames) if self._counted[i]]
