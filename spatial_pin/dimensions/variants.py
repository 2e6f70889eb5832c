"""A mechanism at other dimensions: as mechanisms, or as numbers of the kernel, many together.

A number of the kernel belongs to the placement of a joint or frame, which the traced file gives, or
to a vector that is fixed in a frame, or it is a power of the characteristic length.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import acquired, cached_property
from spatial_pin.assembly.state import center_of_mass
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.composite_joints import single_joints
from spatial_pin.dimensions.homotopy import varied
from spatial_pin.dimensions.traced_tree import (
    PlacementBatch,
    TracedGeometry,
    TracedTree,
    copied,
    near_values,
    traced_tree,
)
from spatial_pin.errors import SpatialPinError, warn
from spatial_pin.formats.file_access import shown
from spatial_pin.formats.files import load_expanded
from spatial_pin.formats.importers import Request
from spatial_pin.formats.xacro.expansion import expand
from spatial_pin.formats.xacro.xacro_arguments import written_dimensions
from spatial_pin.kernel.dimensions import DimensionKernel, Numbers
from spatial_pin.kernel.kernel import kernel_of, packed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import EPS, Array

# Step of a search relative to a dimension's size: second-order differences have an error of its
# square, and round-off eps over it.
STEP = EPS ** (1.0 / 3.0)
Block = tuple[NDArray[np.int64], Array]  # indices of n numbers, and their values (m or 1, n)


class DimensionNumbers:
    """The kernel's numbers of a mechanism as functions of some of its dimensions.

    Points are links, frames or joints, or `LINK.com`, of outputs.

    Attributes:
        base: nominal numbers, those of the points behind the kernel's.
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

    def at(self, geometry: TracedGeometry, rescaled: bool = True) -> Numbers:
        """Return the numbers at m sets of dimensions, those of the points behind the kernel's.

        `rescaled`: whether lengths are relative to the characteristic length of each set; else to
        the nominal one.
        """
        geometry, blocks = self.placed(geometry), list[Block]()
        if rescaled:
            scaled = np.flatnonzero(self._powers)
            ratio = self._span.at(geometry) / self._mechanism.characteristic_length
            blocks.append((scaled, self.base[scaled] * ratio[:, None] ** self._powers[scaled]))
        # placements of joints, which the kernel's have their axes along z in
        tree, at = single_joints(self._mechanism), self._packed.indices()
        for i, pose in geometry.joints.items():
            first = int(tree.carriers[i - 1]) + 1  # of the single joints that it is split into
            own = self._mechanism.centred_model.jointPlacements[i]
            above = tree.frames[tree.parent[first]]
            rest = own.actInv(pin.SE3(above @ tree.rotation[first].T,
                                      above @ tree.translation[first]))
            placed = pose @ PlacementBatch.of(rest)
            columns = (above.T @ placed.rotation).transpose(0, 2, 1)
            blocks += [(at.rotation[first].ravel(), columns.reshape(-1, 9)),
                       (at.translation[first], placed.translation @ above)]
        blocks += self._vector_blocks(geometry)
        blocks += [
            (end, self._offset(name, geometry))
            for name, frame, end in zip(self._points, self._frames, self._end, strict=True)
            if frame in geometry.frames or name.removesuffix(".com") in geometry.levers]
        indices, values = zip(*blocks, strict=True) if blocks else ((), ())
        every = [np.broadcast_to(x, (len(geometry.holds), x.shape[1])) for x in values]
        return Numbers(self.base, np.concatenate([np.empty(0, np.int64), *indices]),
                       np.concatenate([np.empty((len(geometry.holds), 0)), *every], axis=1))

    def placed(self, geometry: TracedGeometry) -> TracedGeometry:
        """Return the same geometry in the kernel's axes.

        Axes of joints in their bodies are the nominal ones. Frames on the ground are relative to
        the centre of the mechanism.
        """
        model, centre = self._mechanism.model, self._mechanism.centre
        geometry = self.with_own_axes(geometry)
        if not centre.any():
            return geometry
        joints, frames = ({i: x._replace(translation=x.translation - centre) if on_ground(i) else x
                           for i, x in poses.items()} for poses, on_ground in (
            (geometry.joints, lambda i: model.parents[i] == 0),
            (geometry.frames, lambda i: model.frames[i].parentJoint == 0)))
        return geometry._replace(joints=joints, frames=frames)

    def with_own_axes(self, geometry: TracedGeometry) -> TracedGeometry:
        """Return the same geometry with nominal axes of joints in their bodies.

        The bodies' own axes turn instead: by Q in the joint's placement, and by its transpose in
        everything on the body.
        """
        if not geometry.turns:
            return geometry
        model, joints, frames = self._mechanism.model, dict(geometry.joints), dict(geometry.frames)
        for i, turn in geometry.turns.items():
            back = PlacementBatch(turn.rotation.transpose(0, 2, 1), turn.translation)
            joints[i] = joints.get(i, PlacementBatch.of(model.jointPlacements[i])) @ turn
            for j in range(1, model.njoints):
                if model.parents[j] == i:
                    joints[j] = back @ joints.get(j, PlacementBatch.of(model.jointPlacements[j]))
            for k, frame in enumerate(model.frames):
                if frame.parentJoint == i:
                    frames[k] = back @ geometry.frame(model, k)
        return geometry._replace(joints=joints, frames=frames)

    def _vector_blocks(self, geometry: TracedGeometry) -> Iterator[Block]:
        """Yield the vectors of closure equations and the axes of idle rotations."""
        model, local = self._mechanism.model, self._packed.parts().local
        indices, fixed_in = self._packed.indices().local, self._packed.fixed_in.tolist()
        for k, (frame, is_point) in enumerate(zip(fixed_in, self._packed.is_point, strict=True)):
            if frame < 0:
                passive = self._mechanism.passives[-1 - frame]
                joint = self._mechanism.frame_on_joint(passive.body)[0]
                axis = geometry.idle_axis(self._mechanism, joint, passive.axis)
                yield indices[k], axis @ self._turned(joint)
            elif frame in geometry.frames:
                pose, own = geometry.frames[frame], self._turned(model.frames[frame].parentJoint)
                fixed = model.frames[frame].placement.rotation.T @ own @ local[k]
                yield indices[k], (pose.translation if is_point else pose.rotation @ fixed) @ own

    def _turned(self, joint: int) -> Array:
        """Return the axes of the kernel's joint (3, 3) in those of the joint of the model."""
        return self._packed.frames[self._packed.carriers[joint]]

    def _offset(self, name: str, geometry: TracedGeometry) -> Array:
        """Return a point (m or 1, 3) in the axes of the kernel's joint that carries it [m]."""
        link, frame = name.removesuffix(".com"), self._mechanism.frame_id(name.removesuffix(".com"))
        pose = geometry.frame(self._mechanism.centred_model, frame)
        offset = pose.translation
        if link != name:
            lever = center_of_mass(self._mechanism, link)[None]
            offset = pose.act(geometry.levers.get(link, lever))
        return offset @ self._turned(self._mechanism.model.frames[frame].parentJoint)


class _Span:
    """The characteristic length: the largest distance of two frames with all joints at zero."""

    def __init__(self, mechanism: Mechanism, own: TracedGeometry) -> None:
        self._model, self._counted = mechanism.centred_model, mechanism.extent.frames
        points = self._points(own)
        self._points_at_own = np.concatenate([np.broadcast_to(x, (1, 3)) for x in points])
        self._distances = np.linalg.norm(
            self._points_at_own[:, None] - self._points_at_own[None], axis=2)

    def at(self, geometry: TracedGeometry) -> Array:
        """Return (m,) the characteristic lengths [m].

        Only pairs of points that are nearly the farthest at nominal dimensions can become it. The
        limit is twice the displacement of both points and of the farthest pair.
        """
        points, m = self._points(geometry), len(geometry.holds)
        moved = max(float(np.abs(x - own).max(initial=0.0))
                    for x, own in zip(points, self._points_at_own, strict=True))
        least = self._distances.max() - 4.0 * np.sqrt(3.0) * moved
        squares = np.zeros(m)
        for i, j in np.argwhere(np.triu(self._distances >= least, 1)):
            apart = points[i] - points[j]
            squares = np.maximum(squares, np.einsum("mi,mi->m", apart, apart))
        return np.where(squares > 0.0, np.sqrt(squares), 1.0)

    def _points(self, geometry: TracedGeometry) -> list[Array]:
        """Return origins (m or 1, 3) of the counted frames with all joints at zero."""
        model = self._model
        joints = [PlacementBatch.of(pin.SE3.Identity())]
        for i in range(1, model.njoints):
            joints.append(joints[model.parents[i]] @ geometry.joint(model, i))
        return [joints[frame.parentJoint].act(geometry.frame(model, i).translation)
                for i, frame in enumerate(model.frames) if self._counted[i]]


class DimensionBatch(NamedTuple):
    """A mechanism at m sets of dimensions."""

    holds: NDArray[np.bool_]  # (m,) whether there is such a mechanism
    numbers: Numbers  # of the kernel, lengths relative to the nominal characteristic length
    frames: dict[int, PlacementBatch]  # by number in the model, placements in their joints

    def taken(self, k: NDArray[np.intp]) -> DimensionBatch:
        """Return a selection (n,), with repetitions if wanted."""
        base, indices, varied_numbers = self.numbers
        frames = {i: PlacementBatch(*(x[k] if len(x) > 1 else x for x in pose))
                  for i, pose in self.frames.items()}
        return DimensionBatch(self.holds[k], Numbers(base, indices, varied_numbers[k]), frames)


class EvaluatedBatch(NamedTuple):
    """Poses of the bodies of m mechanisms, and their joint Jacobians."""

    mechanism: Mechanism  # at nominal dimensions: for names and structure
    members: DimensionBatch
    q: Array  # (m, nq)
    residual: Array  # (m, n_closure) closure equations
    angles: Array  # (m, n_angles) of screw closures [rad]
    turns: Array  # (m, n, 3, 3) of the kernel's joints in the world, by columns
    translations: Array  # (m, n, 3) of these [m]
    # (m, n_closure, nv) for v / `velocity_scale`; empty if not requested, like `columns`
    jacobian: Array
    # (m, 6, nv) of the joint Jacobian about the world origin, by v / `velocity_scale`
    columns: Array

    def frame(self, name: str) -> tuple[Array, Array]:
        """Return rotations (m, 3, 3) and origins (m, 3) of a link, frame or joint in the world."""
        i, numbers = self.mechanism.frame_id(name), packed(self.mechanism, True)
        frame = self.mechanism.centred_model.frames[i]
        own = self.members.frames.get(i) or PlacementBatch.of(frame.placement)
        joint = numbers.carriers[frame.parentJoint]  # the kernel's
        at = self.turns[:, joint].transpose(0, 2, 1)
        at = (at.reshape(-1, 3) @ numbers.frames[joint].T).reshape(at.shape)
        origin: Array = self.translations[:, joint] + np.einsum(
            "mij,mj->mi", at, np.broadcast_to(own.translation, (len(at), 3)))
        return at @ own.rotation, origin + self.mechanism.centre

    def origin(self, name: str) -> Array:
        """Return its origins (m, 3) alone."""
        return self.frame(name)[1]

    def frame_jacobian(self, name: str, origin: Array) -> Array:
        """Return its Jacobian (m, 6, nv) at its origin (m, 3), world axes."""
        joint = self.mechanism.model.frames[self.mechanism.frame_id(name)].parentJoint
        jacobian = self.columns * constraints_of(self.mechanism).supports[joint]
        arms = np.cross((origin - self.mechanism.centre)[:, :, None], jacobian[:, 3:], axis=1)
        jacobian[:, :3] -= arms
        return jacobian


class Variants:
    """A mechanism at other values of some of its dimensions: one, several, or many in the kernel.

    It is loaded again if its file cannot be traced, or decides otherwise at those dimensions.
    """

    def __init__(self, mechanism: Mechanism, names: Iterable[str]) -> None:
        self.mechanism, self.names = mechanism, list(names)

    def at(self, dimensions: Mapping[str, float], with_masses: bool = False) -> Mechanism:
        """Return the mechanism at other dimensions; for motion alone masses may stay nominal."""
        return self.several([dimensions], with_masses)[0]

    def several(
        self, many: Sequence[Mapping[str, float]], with_masses: bool = False
    ) -> list[Mechanism]:
        """Return the mechanisms at several sets of dimensions."""
        if with_masses and not self.has_masses:
            return [self.whole(x) for x in many]
        tree = self.tree
        if tree is None or tree.turns_axes or any(
                name not in tree.dimensions for x in many for name in x):
            return [varied(self.mechanism, x) for x in many]
        own = tree.dimensions.items()
        given = np.array([[x.get(name, value) for x in many] for name, value in own])
        geometry = tree.at(given, True)
        return [tree.mechanism_at(x, geometry, k) if good else varied(self.mechanism, x)
                for k, (x, good) in enumerate(zip(many, geometry.holds, strict=True))]

    def whole(self, dimensions: Mapping[str, float]) -> Mechanism:
        """Return the mechanism with masses and shapes."""
        tree = self.tree
        text = None if tree is None else tree.text_at(dimensions)
        if text is None:
            return varied(self.mechanism, dimensions)
        return load_expanded(self.mechanism, dimensions, text)

    @property
    def has_masses(self) -> bool:
        """Whether mechanisms of `at` have their masses, without their shapes."""
        return self.tree is None or self.tree.turns_axes or self.tree.has_masses

    @property
    def tree(self) -> TracedTree | None:
        """The mechanism's traced tree; None if the file cannot be traced."""
        return traced_tree(self.mechanism, tuple(self.names))

    def batch(self, dimensions: Array) -> DimensionBatch:
        """Return the mechanism at dimensions (n, m), in the order of the names, for the kernel."""
        if self.tree is None:
            return self.loaded(dimensions)
        with np.errstate(all="ignore"):  # of those that are none
            geometry = self.tree.at(dimensions)
            numbers = self._numbers.at(geometry, rescaled=False)
            return DimensionBatch(geometry.holds & np.isfinite(numbers.varied).all(axis=1), numbers,
                                  self._numbers.placed(geometry).frames)

    @cached_property
    def _numbers(self) -> DimensionNumbers:
        assert self.tree is not None
        return DimensionNumbers(self.mechanism, self.tree, [])

    def loaded(self, dimensions: Array) -> DimensionBatch:
        """Return mechanisms loaded one by one, for a file that cannot be traced."""
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
        """Evaluate m of them at configurations q (m, nq), with unwrapping references `angles`."""
        with acquired(self.mechanism, DimensionKernel) as kernel:
            found = kernel.evaluate(q, angles, members.numbers, with_jacobian)
        return EvaluatedBatch(self.mechanism, members, q, *found[:-1],
                              found[-1] * self.mechanism.velocity_scale)

    def displaced(self, q: Array, steps: Array) -> Array:
        """Return configurations (m, nq) moved by joint displacements (m, nv)."""
        with kernel_of(self.mechanism) as kernel:
            return kernel.displaced(q, steps)


def idle_dimensions(
    mechanism: Mechanism, names: Iterable[str], among: Container[str] | None = None
) -> tuple[str, ...]:
    """Return the dimensions that change nothing in the mechanism's file near their values.

    `among` is a selection of the names, which are traced together; default all.
    """
    names = list(names)
    selected = [name for name in names if among is None or name in among]
    if mechanism.tree is None or not selected:
        return ()
    tree = Variants(mechanism, names).tree
    texts = None if tree is None else tree.texts_change(selected)
    changes = dict(texts or {})
    for name in selected if texts is None else ():
        try:
            changes[name] = len({expand(Request.of(mechanism, mechanism.tree, {name: value}))
                                 for value in near_values(mechanism.dimensions[name])}) > 1
        except SpatialPinError:  # a value that it cannot have is a change
            changes[name] = True
    changes |= dict.fromkeys(written_dimensions(mechanism.content, selected), True)
    return tuple(name for name in selected if not changes[name])


def tell_idle(
    mechanism: Mechanism, names: Iterable[str], among: Container[str] | None = None
) -> None:
    """Warn of dimensions that change nothing in the mechanism's file; see `idle_dimensions`."""
    idle = idle_dimensions(mechanism, names, among)
    if idle:
        warn(f"mechanism {mechanism.name!r}: {', '.join(idle)} "
             f"change{'s' * (len(idle) == 1)} nothing in {shown(str(mechanism.tree))}: "
             "nothing of what the file describes depends on it")
