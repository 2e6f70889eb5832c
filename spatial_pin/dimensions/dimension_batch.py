"""The numbers that the kernel's mechanism is made of, at many sets of dimensions together.

A number is that of a joint's or frame's placement, which the traced file gives; of a vector that is
fixed in a frame and moves with it; or it goes as a power of the characteristic length.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.state import center_of_mass
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.composite_joints import split_of
from spatial_pin.constraints.workspaces import acquired
from spatial_pin.dimensions.homotopy import varied
from spatial_pin.dimensions.variants import (
    PlacementBatch,
    TracedGeometry,
    TracedTree,
    Variants,
    copied,
)
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.dimensions import DimensionEvaluator, EvaluatedSamples, Numbers
from spatial_pin.kernel.kernel import kernel_of
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
    """

    def __init__(self, mechanism: Mechanism, tree: TracedTree, points: Iterable[str]) -> None:
        self._mechanism, self._points = mechanism, list(points)
        self._packed = packed(mechanism, True)
        self._frames = [mechanism.frame_id(name.removesuffix(".com")) for name in self._points]
        self.joints = [int(mechanism.model.frames[i].parentJoint) for i in self._frames]
        # powers of the characteristic length that numbers go with: doubling it changes no digit
        other = copied(mechanism)
        other.__dict__["characteristic_length"] = 2.0 * mechanism.characteristic_length
        one, two = self._packed.reals, packed(other, True).reals
        changed, self._powers = one != two, np.zeros(len(one))
        self._powers[changed] = np.log2(two[changed] / one[changed])
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
        found, blocks = self.placed(found), list[Block]()
        if rescaled:
            scaled = np.flatnonzero(self._powers)
            ratio = self._span.at(found) / self._mechanism.characteristic_length
            blocks.append((scaled, self.base[scaled] * ratio[:, None] ** self._powers[scaled]))
        # placements of joints, which the kernel's have their axes along z in
        carriers, turned = self._packed.carriers, self._packed.frames
        split, at = split_of(self._mechanism).model, self._packed.places()
        for i, pose in found.joints.items():
            first = int(carriers[i - 1]) + 1  # of the single joints that it is split into
            own = self._mechanism.centred_model.jointPlacements[i]
            rest = own.actInv(split.jointPlacements[first])
            placed, above = pose @ PlacementBatch.of(rest), turned[split.parents[first]]
            columns = (above.T @ placed.rotation @ turned[first]).transpose(0, 2, 1)
            blocks += [(at.rotation[first].ravel(), columns.reshape(-1, 9)),
                       (at.translation[first], placed.translation @ above)]
        blocks += self._vector_blocks(found)
        blocks += [
            (end, self._offset(name, found))
            for name, frame, end in zip(self._points, self._frames, self._end, strict=True)
            if frame in found.frames or name.removesuffix(".com") in found.levers]
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
            back = PlacementBatch(turn.rotation.transpose(0, 2, 1), turn.translation)
            joints[i] = joints.get(i, PlacementBatch.of(model.jointPlacements[i])) @ turn
            for j in range(1, model.njoints):
                if model.parents[j] == i:
                    joints[j] = back @ joints.get(j, PlacementBatch.of(model.jointPlacements[j]))
            for k, frame in enumerate(model.frames):
                if frame.parentJoint == i:
                    frames[k] = back @ _frame(model, k, found)
        return found._replace(joints=joints, frames=frames)

    def _vector_blocks(self, found: TracedGeometry) -> Iterator[Block]:
        """Yield the vectors of closure equations and the axes of idle rotations."""
        model, local = self._mechanism.model, self._packed.parts().local
        places, fixed_in = self._packed.places().local, self._packed.fixed_in.tolist()

        def on_body(joint: int, frame: int) -> Array:  # as `point_on_body`
            own = model.frames[frame].parentJoint
            if own == joint:
                return _frame(model, frame, found).translation
            return found.joints.get(own, PlacementBatch.of(model.jointPlacements[own])).translation
        for k, (frame, is_point) in enumerate(zip(fixed_in, self._packed.is_point, strict=True)):
            if frame < 0:
                passive = self._mechanism.passives[-1 - frame]
                joint = self._mechanism.frame_on_joint(passive.body)[0]
                a, b = (on_body(joint, self._mechanism.frame_id(name)) for name in passive.axis)
                axis = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
                yield places[k], axis @ self._turned(joint)
            elif frame in found.frames:
                pose, own = found.frames[frame], self._turned(model.frames[frame].parentJoint)
                fixed = model.frames[frame].placement.rotation.T @ own @ local[k]
                yield places[k], (pose.translation if is_point else pose.rotation @ fixed) @ own

    def _turned(self, joint: int) -> Array:
        """Return the axes of the kernel's joint (3, 3) in those of the joint of the model."""
        return self._packed.frames[self._packed.carriers[joint]]

    def _offset(self, name: str, found: TracedGeometry) -> Array:
        """Return a point (m or 1, 3) in the axes of the kernel's joint that carries it [m]."""
        link, frame = name.removesuffix(".com"), self._mechanism.frame_id(name.removesuffix(".com"))
        pose = _frame(self._mechanism.centred_model, frame, found)
        offset = pose.translation
        if link != name:
            lever = center_of_mass(self._mechanism, link)[None]
            offset = pose.act(found.levers.get(link, lever))
        return offset @ self._turned(self._mechanism.model.frames[frame].parentJoint)


def _frame(model: pin.Model, frame: int, found: TracedGeometry) -> PlacementBatch:
    return found.frames.get(frame, PlacementBatch.of(model.frames[frame].placement))


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
        joints = [PlacementBatch.of(pin.SE3.Identity())]
        for i in range(1, model.njoints):
            own = found.joints.get(i, PlacementBatch.of(model.jointPlacements[i]))
            joints.append(joints[model.parents[i]] @ own)
        return [joints[frame.parentJoint].act(_frame(model, i, found).translation)
                for i, frame in enumerate(model.frames) if self._counted[i]]


class DimensionBatch(NamedTuple):
    """A mechanism at m sets of dimensions."""

    holds: NDArray[np.bool_]  # (m,) whether there is such a mechanism
    numbers: Numbers  # of the kernel, lengths relative to the characteristic length of the family
    frames: dict[int, PlacementBatch]  # by number in the model, placements in what carries them

    def taken(self, k: NDArray[np.intp]) -> DimensionBatch:
        """Return some of them (n,), one several times if wanted."""
        base, places, varied_numbers = self.numbers
        frames = {i: PlacementBatch(*(x[k] if len(x) > 1 else x for x in pose))
                  for i, pose in self.frames.items()}
        return DimensionBatch(self.holds[k], Numbers(base, places, varied_numbers[k]), frames)


class EvaluatedBatch(NamedTuple):
    """Where the bodies of m mechanisms are, and how they move with the joints."""

    mechanism: Mechanism  # at the family's own dimensions: its names and its structure
    members: DimensionBatch  # what they are made of
    q: Array  # (m, nq)
    residual: Array  # (m, n_closure) closure equations
    angles: Array  # (m, n_angles) of screw closures [rad]
    # (m, n_closure, nv) of these with respect to v / `velocity_scale`; empty if not asked for, like
    # `columns`
    jacobian: Array
    # (m, 6, nv) of the joint Jacobian about the world origin, by v / `velocity_scale`
    columns: Array
    evaluated: EvaluatedSamples  # where the joints are
    supports: Array  # (njoints, nv) 1 for the freedoms that move the body of each joint

    def frame(self, name: str | int) -> tuple[Array, Array]:
        """Return rotations (m, 3, 3) and origins (m, 3) of a link, frame or joint in the world.

        It is named, or its number in the model is given.
        """
        rotations, origins = self.centred_frame(name)
        return rotations, origins + self.mechanism.centre

    def origin(self, name: str | int) -> Array:
        """Return its origins (m, 3) alone."""
        return self.frame(name)[1]

    def centred_frame(self, name: str | int) -> tuple[Array, Array]:
        """Return the same with origins relative to the centre of the mechanism."""
        i = self.mechanism.frame_id(name) if isinstance(name, str) else name
        frame = self.mechanism.centred_model.frames[i]
        own = self.members.frames.get(i) or PlacementBatch.of(frame.placement)
        joint = frame.parentJoint
        at, place = self.evaluated.rotation(joint), self.evaluated.translations[:, joint]
        found: Array = place + np.einsum("mij,mj->mi", at,
                                         np.broadcast_to(own.translation, place.shape))
        return at @ own.rotation, found

    def frame_jacobian(self, name: str, origin: Array) -> Array:
        """Return its Jacobian (m, 6, nv) at its origin (m, 3), world axes."""
        joint = self.mechanism.model.frames[self.mechanism.frame_id(name)].parentJoint
        found = self.columns * self.supports[joint]
        arms = np.cross((origin - self.mechanism.centre)[:, :, None], found[:, 3:], axis=1)
        found[:, :3] -= arms
        return found


class DimensionFamily:
    """A mechanism as a function of some of its dimensions.

    Attributes:
        is_traced: whether the file is followed for many sets of dimensions at once.
    """

    def __init__(self, mechanism: Mechanism, names: Iterable[str]) -> None:
        self.mechanism, self.names = mechanism, list(names)
        if mechanism.path is None:
            raise SpatialPinError(
                f"mechanism {mechanism.name!r} has no file to change dimensions in")
        self.variants = Variants(mechanism, self.names)
        tree = self.variants.tree
        self._tree, self.is_traced = tree, tree is not None
        self._numbers = DimensionNumbers(mechanism, tree, []) if tree else None

    def at(self, dimensions: Array) -> DimensionBatch:
        """Return the mechanism at dimensions (n, m), in the order of the names."""
        if self._tree is None or self._numbers is None:
            return self.loaded(dimensions)
        with np.errstate(all="ignore"):  # of those that are none
            found = self._tree.at(dimensions)
            numbers = self._numbers.at(found, rescaled=False)
            return DimensionBatch(found.holds & np.isfinite(numbers.varied).all(axis=1), numbers,
                           self._numbers.placed(found).frames)

    def loaded(self, dimensions: Array) -> DimensionBatch:
        """Return the same of mechanisms loaded one by one, where the file cannot be followed."""
        mechanism = self.mechanism
        holds, reals = np.ones(dimensions.shape[1], dtype=bool), []
        frames: list[list[PlacementBatch]] = []
        for k, one in enumerate(dimensions.T):
            try:
                there = varied(mechanism, dict(zip(self.names, one.tolist(), strict=True)))
                there.__dict__["extent"] = mechanism.extent
                there.__dict__["characteristic_length"] = mechanism.characteristic_length
                own = packed(there, True).reals
                holds[k] = len(own) == len(packed(mechanism, True).reals)
            except SpatialPinError:
                holds[k] = False
            if not holds[k]:
                there, own = mechanism, packed(mechanism, True).reals
            reals.append(own)
            frames.append([PlacementBatch.of(x.placement) for x in there.centred_model.frames])
        placed = {i: PlacementBatch(*(np.concatenate(x) for x in zip(*several, strict=True)))
                  for i, several in enumerate(zip(*frames, strict=True))}
        base = packed(mechanism, True).reals
        return DimensionBatch(holds, Numbers(base, np.arange(len(base)), np.array(reals)), placed)

    def bodies(
        self, members: DimensionBatch, q: Array, angles: Array, with_jacobian: bool = True
    ) -> EvaluatedBatch:
        """Evaluate m of them at configurations q (m, nq), screws counting from angles."""
        with acquired(self.mechanism, DimensionEvaluator) as evaluator:
            found = evaluator.evaluate(q, angles, members.numbers, with_jacobian)
        scale = self.mechanism.velocity_scale
        return EvaluatedBatch(
            self.mechanism, members, q, found.residual, found.angles, found.jacobian,
            found.columns * scale, found, constraints_of(self.mechanism).supports)

    def displaced(self, q: Array, steps: Array) -> Array:
        """Return configurations (m, nq) moved by joint displacements (m, nv)."""
        with kernel_of(self.mechanism) as kernel:
            return kernel.displaced(q, steps)
