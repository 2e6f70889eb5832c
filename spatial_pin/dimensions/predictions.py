"""Predicted measurements at given dimensions, offsets and base, with derivatives.

At a closed configuration q of dimensions p the loops c(q, p) = 0 and the drivers stay fixed, so
that dq/dp = -A^-1 dc/dp, with A the rows of the loops and drivers. The dependence of c and of the
frames on p at fixed q is differenced; no loop is closed for that.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.holding import fixed_base_entries
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.dimension_batch import DimensionFamily, EvaluatedBatch
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.dimensions.measurements import UNITS, Encoder, MeasuredQuantity
from spatial_pin.dimensions.variants import Variants
from spatial_pin.errors import SpatialPinError
from spatial_pin.inverse_kinematics.targets import CoordinateValue
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import EPS, Array, Decomposition, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

# Step relative to a dimension's size: second-order differences have an error of its square, and
# round-off eps over it.
STEP = EPS ** (1.0 / 3.0)
BASE = ("base.x", "base.y", "base.z", "base.rx", "base.ry", "base.rz")


class Unknowns(NamedTuple):
    """The unknowns of a calibration."""

    dimensions: tuple[str, ...]  # names
    offsets: tuple[str, ...]  # drivers with an encoder offset
    has_base: bool  # whether the base has six unknowns
    # Encoders with a reading error, one unknown for each pose. These are behind the others and have
    # no name.
    encoders: tuple[Encoder, ...] = ()

    @classmethod
    def of(
        cls, mechanism: Mechanism, dimensions: Iterable[str], offsets: Sequence[str],
        has_base: bool, drivers: Sequence[Mapping[str, float]], encoders: tuple[Encoder, ...],
    ) -> Unknowns:
        """Return the unknowns, offsets checked with the encoder readings."""
        coordinates = [mechanism.driven_coordinate(name).name for name in offsets]
        if len(set(coordinates)) < len(coordinates):
            raise ValueError("offsets names one driver twice")
        for name, coordinate in zip(offsets, coordinates, strict=True):
            if not any(coordinate in read for read in drivers):
                raise ValueError(f"offsets: no measurement has a value of {name!r}")
        return cls(tuple(dimensions), tuple(offsets), has_base, encoders)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers, in their order."""
        return (*self.dimensions, *(f"{name}.offset" for name in self.offsets),
                *(BASE if self.has_base else ()))


class FittedState(NamedTuple):
    """A mechanism at some values of the unknowns."""

    mechanism: Mechanism
    states: list[State]  # closed, by pose
    # placement of the mechanism in the measuring axes; None if these are its own
    base: pin.SE3 | None


class NeighbouringPoses(NamedTuple):
    """Poses of a mechanism at dimensions, and at slightly larger and smaller ones."""

    # all poses, then all for each larger dimension, then all for each smaller one
    bodies: EvaluatedBatch
    poses: int  # number of poses
    widths: Array  # (n,) between larger and smaller dimensions [m or rad]
    known: dict[int, tuple[Array, Array]]  # rotations and origins of frames, evaluated once

    @classmethod
    def of(
        cls, family: DimensionFamily, here: FittedState, steps: Array
    ) -> NeighbouringPoses:
        """Return the poses with every dimension larger and smaller by a step."""
        poses = len(here.states)
        own = np.array([here.mechanism.dimensions[name] for name in family.names])
        moves = np.diag(steps[: len(own)])
        every = own[:, None] + np.hstack([np.zeros((len(own), 1)), moves, -moves])
        members = family.at(every)
        if not members.holds.all():
            members = family.loaded(every)
        at = np.tile(np.arange(poses), every.shape[1])
        q, angles = (np.array(a)[at] for a in zip(
            *((s.q, s.angles) for s in here.states), strict=True))
        bodies = family.bodies(
            members.taken(np.repeat(np.arange(every.shape[1]), poses)), q, angles)
        ahead, behind = every[:, 1 : len(own) + 1], every[:, len(own) + 1 :]
        return cls(bodies, poses, np.diag(ahead - behind), {})

    def _differences(self, values: Array, i: int) -> tuple[Array, Array]:
        """Return values (n, ...) of a pose at larger, and at smaller dimensions."""
        own = values[self.poses + i :: self.poses]
        return own[: len(self.widths)], own[len(self.widths) :]

    def opened(self, i: int) -> Array:
        """Return derivatives (rows, n) of a pose's loops for the dimensions, joints fixed."""
        ahead, behind = self._differences(self.bodies.residual, i)
        opened: Array = ((ahead - behind) / self.widths[:, None]).T
        return opened

    def twists(self, i: int, frame: int) -> Array:
        """Return derivatives (6, n) of a frame's pose: its origin, and its turn, world axes."""
        if frame not in self.known:
            self.known[frame] = self.bodies.centred_frame(frame)
        turned, origin = self.known[frame]
        ahead, behind = self._differences(origin, i)
        after, before = self._differences(turned, i)
        turn = after @ before.transpose(0, 2, 1)
        twists: Array = np.hstack([ahead - behind, 0.5 * np.column_stack(
            [turn[:, k, j] - turn[:, j, k] for j, k in ((1, 2), (2, 0), (0, 1))])]).T / self.widths
        return twists


class _AtRest(NamedTuple):
    """A pose with the interface that targets use: dimensions move the frames, not joints."""

    mechanism: Mechanism
    evaluation: LoopEquations
    neighbours: NeighbouringPoses
    pose: int

    def frame(self, frame: int) -> pin.SE3:
        """Return the placement of a frame."""
        return self.evaluation.frame(frame)

    def frame_jacobian(self, frame: int) -> Array:
        """Return its derivatives (6, n) for the dimensions."""
        return self.neighbours.twists(self.pose, frame)

    def slope(self, quantity: MeasuredQuantity, base: pin.SE3 | None) -> Array:
        """Return the derivatives (k, n) of an error; zero for coordinates, which are fixed."""
        if isinstance(quantity.target, CoordinateValue):
            return np.zeros((1, len(self.neighbours.widths)))
        return quantity.error(cast(LoopEquations, self), base)[1]


class Predictions:
    """Errors of the model at values x (n,) of the unknowns, and their derivatives.

    The unknowns have no unit: x is the change from the start values, relative to `sizes`.

    Attributes:
        sizes: (n,) of the unknowns [m or rad].
        sigmas: (m,) standard deviations of the measured numbers, those of encoders last.
        whole: norm of errors as large as the mechanism: its characteristic length, one radian.
    """

    def __init__(
        self, start: FittedState, unknowns: Unknowns, drivers: Sequence[Mapping[str, float]],
        quantities: Sequence[Sequence[MeasuredQuantity]],
    ) -> None:
        self._start, self.unknowns, self._drivers = start, unknowns, drivers
        self._quantities, m = quantities, start.mechanism
        self._coordinates = [m.driven_coordinate(name) for name in unknowns.offsets]
        self._variants = Variants(m, unknowns.dimensions)
        self._family = DimensionFamily(m, unknowns.dimensions) if unknowns.dimensions else None
        self._near = start
        self._last: tuple[bytes, FittedState] | None = None
        length = m.characteristic_length
        own = self.nominal = np.array([m.dimensions[name] for name in unknowns.dimensions])
        # a dimension may be a length or an angle, and be zero
        sizes = [*np.maximum(np.abs(own), min(length, 1.0)),
                 *(m.velocity_scale[c.v] for c in self._coordinates),
                 *([length] * 3 + [1.0] * 3 if unknowns.has_base else [])]
        read = [encoder.sigma for encoder in unknowns.encoders]
        self.sizes = np.array([*sizes, *read])
        self.sigmas = np.array(
            [*(q.sigma for some in quantities for q in some for _ in q.labels()), *read])
        self.whole = float(np.linalg.norm([
            (length if UNITS[q.kind] == "m" else 1.0) / q.sigma
            for some in quantities for q in some for _ in q.labels()]))
        self._base = slice(len(sizes) - 6, len(sizes))
        self._misread = slice(len(sizes), None)  # reading errors of encoders [sigma], too small

    def at(self, x: Array) -> FittedState:
        """Return the mechanism at values of the unknowns, closed at every pose."""
        if self._last is None or self._last[0] != x.tobytes():
            near, dimensions = self._near, self.dimensions_at(x)
            there = self._variants.at(dimensions) if dimensions else near.mechanism
            states = [followed(there, held, state)
                      for held, state in zip(self.held(x), near.states, strict=True)]
            self._last = x.tobytes(), FittedState(there, states, self.base_at(x))
        return self._last[1]

    def held(self, x: Array) -> list[dict[str, float]]:
        """Return the drivers' values at each pose, by coordinate [rad or m]."""
        offsets = self.offsets_at(x)
        held = [{name: value + offsets.get(name, 0.0) for name, value in read.items()}
                 for read in self._drivers]
        for encoder, off in zip(self.unknowns.encoders, x[self._misread], strict=True):
            held[encoder.pose][encoder.coordinate] += encoder.sigma * off
        return held

    def dimensions_at(self, x: Array) -> dict[str, float]:
        """Return the dimensions at values of the unknowns."""
        k = len(self.nominal)
        return dict(zip(self.unknowns.dimensions,
                        (self.nominal + self.sizes[:k] * x[:k]).tolist(), strict=True))

    def offsets_at(self, x: Array) -> dict[str, float]:
        """Return the offsets by coordinate."""
        some = slice(len(self.nominal), len(self.nominal) + len(self._coordinates))
        return dict(zip((c.name for c in self._coordinates),
                        (self.sizes[some] * x[some]).tolist(), strict=True))

    def base_at(self, x: Array) -> pin.SE3 | None:
        """Return the base."""
        if self._start.base is None:
            return None
        if not self.unknowns.has_base:
            return self._start.base
        moved, start = self.sizes[self._base] * x[self._base], self._start.base
        return pin.SE3(pin.exp3(moved[3:]) @ start.rotation, start.translation + moved[:3])

    def errors(self, x: Array) -> Array:
        """Return model less measurements (m,) [sigma]; infinite if loops do not close."""
        try:
            here = self.at(x)
        except SpatialPinError:
            return np.full(len(self.sigmas), np.inf)  # a step there is not made
        parts = []
        for state, quantities in zip(here.states, self._quantities, strict=True):
            with loops_of(here.mechanism, state.angles) as evaluation:
                evaluation.update(state.q)
                parts += [q.error(evaluation, here.base)[0] for q in quantities]
        errors = np.concatenate(parts)
        return np.concatenate([errors / self.sigmas[: len(errors)], x[self._misread]])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives (m, n) of `errors` for x; raises as `slopes`."""
        jacobian = self.slopes(x)
        if self.unknowns.has_base:  # of exp(w) for w: the turn that is added, from the left
            turns = slice(self._base.stop - 3, self._base.stop)
            jacobian[:, turns] = jacobian[:, turns] @ pin.Jexp3(x[turns]).T
        return jacobian

    def slopes(self, x: Array) -> Array:
        """Return the derivatives (m, n) of `errors` for x, with small turns of the base."""
        here = self._near = self.at(x)
        neighbours, rows = None, []
        if self._family is not None:
            neighbours = NeighbouringPoses.of(self._family, here, STEP * self.sizes)
        for i, state in enumerate(here.states):
            with loops_of(here.mechanism, state.angles) as evaluation:
                evaluation.update(state.q)
                rows.append(self._pose_rows(i, evaluation, here, neighbours))
        k = len(self.unknowns.encoders)
        slopes = np.concatenate(rows) * self.sizes / self.sigmas[: len(self.sigmas) - k, None]
        return np.vstack([slopes, np.eye(k, len(self.sizes), len(self.sizes) - k)])

    def _pose_rows(
        self, i: int, evaluation: LoopEquations, here: FittedState,
        neighbours: NeighbouringPoses | None,
    ) -> Array:
        """Return the derivatives (k, n) of a pose's errors [m, rad] per unit of the unknowns."""
        m, n = here.mechanism, evaluation.constraints.n_closure
        held = [m.driven_coordinate(name) for name in self._drivers[i]]
        stands = [*(c.v for c in held), *fixed_base_entries(m, held)]
        loops = evaluation.jacobian[:n] if neighbours is None else neighbours.bodies.jacobian[i]
        scale = self._start.mechanism.velocity_scale
        svd = decompose(np.vstack([loops, np.eye(m.model.nv)[stands]]))
        slopes = scale * np.vstack(
            [q.error(evaluation, here.base)[1] for q in self._quantities[i]])
        free = np.abs(slopes @ svd.null_space.T).max(axis=1, initial=0.0)
        if free.max(initial=0.0) > TOLERANCES.half_precision * np.abs(slopes).max(initial=0.0):
            labels = [label for q in self._quantities[i] for label in q.labels()]
            raise SpatialPinError(
                f"measurement {i + 1}: {labels[int(np.argmax(free))]!r} can move where the drivers "
                "given stand; give values of drivers or coordinates that hold it, or leave it out")
        columns = list[Array]()
        if neighbours is not None:
            moved = _AtRest(m, evaluation, neighbours, i)
            own = np.vstack([moved.slope(q, here.base) for q in self._quantities[i]])
            columns += [*(own + slopes @ _joint_motions(
                m, self.unknowns.dimensions, svd, neighbours.opened(i))).T]
        driven = np.eye(n + len(stands))[n : n + len(held)]
        of = {c.name: slopes @ svd.minimum_norm(row / scale[c.v])
              for c, row in zip(held, driven, strict=True)}
        still = np.zeros(len(slopes))
        columns += [of.get(c.name, still) for c in self._coordinates]
        joint_slopes = np.array(columns).reshape(len(columns), len(slopes)).T
        base = [np.vstack([q.base_slope(evaluation, here.base) for q in self._quantities[i]])
                ] if self.unknowns.has_base and here.base is not None else []
        read = np.array([of[e.coordinate] if e.pose == i else still
                         for e in self.unknowns.encoders]).reshape(-1, len(slopes)).T
        return np.hstack([joint_slopes, *base, read])


def _joint_motions(
    mechanism: Mechanism, names: Sequence[str], svd: Decomposition, opened: Array
) -> Array:
    """Return joint motions (nv, n) that close loops opened by dimensions (rows, n)."""
    wanted = np.zeros((len(svd.u), opened.shape[1]))
    wanted[: len(opened)] = -opened
    basis = svd.u[:, : svd.rank]
    residual = np.linalg.norm(wanted - basis @ (basis.T @ wanted), axis=0)
    sizes = np.maximum(1.0, np.linalg.norm(wanted, axis=0))
    opens = residual > TOLERANCES.half_precision * sizes
    if opens.any():
        name = names[int(np.argmax(opens))]
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: the loops open where {name!r} alone is "
            "changed (they are overconstrained); calibrate a dimension that keeps them closed")
    motions: Array = svd.vt[: svd.rank].T @ ((basis.T @ wanted) / svd.s[: svd.rank, None])
    return motions
