"""A mechanism at many sets of its dimensions, evaluated together where its joints stand."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.workspaces import acquired
from spatial_pin.dimensions.homotopy import varied
from spatial_pin.dimensions.numbers import DimensionNumbers
from spatial_pin.dimensions.variants import Pose, Variants
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.dimensions import DimensionEvaluator, EvaluatedSamples, Numbers
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.packing import packed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


class Members(NamedTuple):
    """A mechanism at m sets of dimensions.

    Attributes:
        holds: (m,) whether there is such a mechanism.
        numbers: of the kernel, lengths relative to the characteristic length of the family.
        frames: by number in the model, placements in what carries them.
    """

    holds: NDArray[np.bool_]
    numbers: Numbers
    frames: dict[int, Pose]

    def taken(self, k: NDArray[np.intp]) -> Members:
        """Return some of them (n,), one several times if wanted."""
        base, places, varied_numbers = self.numbers
        frames = {i: Pose(*(x[k] if len(x) > 1 else x for x in pose))
                  for i, pose in self.frames.items()}
        return Members(self.holds[k], Numbers(base, places, varied_numbers[k]), frames)


class Bodies(NamedTuple):
    """Where the bodies of m mechanisms are, and how they move with the joints.

    Attributes:
        mechanism: at the family's own dimensions: its names and its structure.
        members: what they are made of.
        q: (m, nq).
        residual: (m, n_closure) closure equations.
        angles: (m, n_angles) of screw closures [rad].
        jacobian: (m, n_closure, nv) of these with respect to v / `velocity_scale`; empty if not
            asked for, like `columns`.
        columns: (m, 6, nv) of the joint Jacobian about the world origin, by v / `velocity_scale`.
        evaluated: where the joints are.
        supports: (njoints, nv) 1 for the freedoms that move the body of each joint.
    """

    mechanism: Mechanism
    members: Members
    q: Array
    residual: Array
    angles: Array
    jacobian: Array
    columns: Array
    evaluated: EvaluatedSamples
    supports: Array

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
        joint, own = self._carried(name)
        at, place = self.evaluated.rotation(joint), self.evaluated.translations[:, joint]
        found: Array = place + np.einsum("mij,mj->mi", at,
                                         np.broadcast_to(own.translation, place.shape))
        return at @ own.rotation, found

    def _carried(self, name: str | int) -> tuple[int, Pose]:
        """Return the joint that carries a frame, and its placements there."""
        i = self.mechanism.frame_id(name) if isinstance(name, str) else name
        frame = self.mechanism.centred_model.frames[i]
        return frame.parentJoint, self.members.frames.get(i) or Pose.of(frame.placement)

    def frame_jacobian(self, name: str, origin: Array) -> Array:
        """Return its Jacobian (m, 6, nv) at its origin (m, 3), world axes."""
        joint = self.mechanism.model.frames[self.mechanism.frame_id(name)].parentJoint
        found = self.columns * self.supports[joint]
        arms = np.cross((origin - self.mechanism.centre)[:, :, None], found[:, 3:], axis=1)
        found[:, :3] -= arms
        return found


class Family:
    """A mechanism as a function of some of its dimensions.

    Args:
        mechanism: at its own dimensions.
        names: the dimensions that change.

    Attributes:
        is_traced: whether the file is followed for many sets of dimensions at once.

    Raises:
        SpatialPinError: it has no file.
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

    def at(self, dimensions: Array) -> Members:
        """Return the mechanism at dimensions (n, m), in the order of the names."""
        if self._tree is None or self._numbers is None:
            return self.loaded(dimensions)
        with np.errstate(all="ignore"):  # of those that are none
            found = self._tree.at(dimensions)
            numbers = self._numbers.at(found, rescaled=False)
            return Members(found.holds & np.isfinite(numbers.varied).all(axis=1), numbers,
                           self._numbers.placed(found).frames)

    def loaded(self, dimensions: Array) -> Members:
        """Return the same of mechanisms loaded one by one, where the file cannot be followed."""
        mechanism = self.mechanism
        holds, reals = np.ones(dimensions.shape[1], dtype=bool), []
        frames: list[list[Pose]] = []
        for k, one in enumerate(dimensions.T):
            try:
                there = varied(mechanism, dict(zip(self.names, one.tolist(), strict=True)))
                there.__dict__["extent"] = mechanism.extent
                there.__dict__["characteristic_length"] = mechanism.characteristic_length
                own = packed(there).reals
                holds[k] = len(own) == len(packed(mechanism).reals)
            except SpatialPinError:
                holds[k] = False
            if not holds[k]:
                there, own = mechanism, packed(mechanism).reals
            reals.append(own)
            frames.append([Pose.of(frame.placement) for frame in there.centred_model.frames])
        placed = {i: Pose(*(np.concatenate(x) for x in zip(*several, strict=True)))
                  for i, several in enumerate(zip(*frames, strict=True))}
        base = packed(mechanism).reals
        return Members(holds, Numbers(base, np.arange(len(base)), np.array(reals)), placed)

    def bodies(
        self, members: Members, q: Array, angles: Array, with_jacobian: bool = True
    ) -> Bodies:
        """Evaluate m of them at configurations q (m, nq), screws counting from angles."""
        with acquired(self.mechanism, "dimension evaluator",
                      lambda: DimensionEvaluator(self.mechanism)) as evaluator:
            found = evaluator.evaluate(q, angles, members.numbers, with_jacobian)
        scale = self.mechanism.velocity_scale
        return Bodies(self.mechanism, members, q, found.residual, found.angles, found.jacobian,
                      found.columns * scale, found,
                      constraints_of(self.mechanism).supports)

    def displaced(self, q: Array, steps: Array) -> Array:
        """Return configurations (m, nq) moved by joint displacements (m, nv)."""
        with kernel_of(self.mechanism) as kernel:
            return kernel.displaced(q, steps)
