"""What a mechanism of other dimensions, offsets and base would have measured, and its derivatives.

At a closed configuration q of dimensions p the loops c(q, p) = 0 and the drivers stay what they
are, so that dq/dp = -A^-1 dc/dp, with A the rows of the loops and drivers. What depends on p at the
same q, the rows c and the frames, is differenced: nothing is closed for that.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.holding import still_entries
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

# Part of a dimension's size: second-order differences leave its square, round-off eps over it.
STEP = EPS ** (1.0 / 3.0)
BASE = ("base.x", "base.y", "base.z", "base.rx", "base.ry", "base.rz")


class Unknowns(NamedTuple):
    """What is looked for."""

    dimensions: tuple[str, ...]  # names
    offsets: tuple[str, ...]  # drivers; what their encoders read lacks these
    has_base: bool  # whether the base is one, by six numbers
    # that read with an error, of which each pose has its own: these are found too, as numbers
    # behind the others, but have no name
    encoders: tuple[Encoder, ...] = ()

    @classmethod
    def of(
        cls, mechanism: Mechanism, dimensions: Iterable[str], offsets: Sequence[str],
        has_base: bool, drivers: Sequence[Mapping[str, float]], encoders: tuple[Encoder, ...],
    ) -> Unknowns:
        """Return them, offsets checked with what encoders read."""
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

    mechanism: Mechanism  # at its dimensions
    states: list[State]  # closed, by pose
    # of the mechanism in the axes of what measures; None where these are its own
    base: pin.SE3 | None


class NeighbouringPoses(NamedTuple):
    """Poses of a mechanism, and of those whose dimensions are a little larger and smaller."""

    # of the poses, then of all of them for each larger dimension, then for each smaller
    bodies: EvaluatedBatch
    poses: int  # how many there are
    widths: Array  # (n,) between the larger and the smaller ones [m or rad]
    known: dict[int, tuple[Array, Array]]  # rotations and origins of frames that were asked for

    def _differences(self, values: Array, i: int) -> tuple[Array, Array]:
        """Return values (n, ...) of a pose at larger, and at smaller dimensions."""
        own = values[self.poses + i :: self.poses]
        return own[: len(self.widths)], own[len(self.widths) :]

    def opened(self, i: int) -> Array:
        """Return how dimensions open the loops of a pose (rows, n), where no joint moves."""
        ahead, behind = self._differences(self.bodies.residual, i)
        found: Array = ((ahead - behind) / self.widths[:, None]).T
        return found

    def twists(self, i: int, frame: int) -> Array:
        """Return how a frame of a pose moves (6, n): its origin, and its turn, world axes."""
        if frame not in self.known:
            self.known[frame] = self.bodies.centred_frame(frame)
        turned, origin = self.known[frame]
        ahead, behind = self._differences(origin, i)
        after, before = self._differences(turned, i)
        turn = after @ before.transpose(0, 2, 1)
        found: Array = np.hstack([ahead - behind, 0.5 * np.column_stack(
            [turn[:, k, j] - turn[:, j, k] for j, k in ((1, 2), (2, 0), (0, 1))])]).T / self.widths
        return found


class _AtRest(NamedTuple):
    """A pose as targets ask for it, in which dimensions move the frames in the place of joints."""

    mechanism: Mechanism
    evaluation: LoopEquations
    beside: NeighbouringPoses
    pose: int

    def frame(self, frame: int) -> pin.SE3:
        """Return where a frame is."""
        return self.evaluation.frame(frame)

    def frame_jacobian(self, frame: int) -> Array:
        """Return how it moves with the dimensions (6, n)."""
        return self.beside.twists(self.pose, frame)

    def slope(self, quantity: MeasuredQuantity, base: pin.SE3 | None) -> Array:
        """Return the derivatives (k, n) of an error; of coordinates, which stand, zero."""
        if isinstance(quantity.target, CoordinateValue):
            return np.zeros((1, len(self.beside.widths)))
        return quantity.error(cast(LoopEquations, self), base)[1]


class Predictions:
    """Errors of the model at values x (n,) of the unknowns, and their derivatives.

    The unknowns have no unit: x is how far they are from where they start, relative to `sizes`.

    Attributes:
        sizes: (n,) of the unknowns [m or rad].
        sigmas: (m,) standard deviations of the numbers measured, those of encoders last.
        whole: length of errors as large as the mechanism: its characteristic length, one radian.
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

    def at(self, x: Array) -> FittedState:
        """Return the mechanism at values of the unknowns, its loops closed at every pose."""
        if self._last is None or self._last[0] != x.tobytes():
            near, dimensions = self._near, self.dimensions_at(x)
            there = self._variants.at(dimensions) if dimensions else near.mechanism
            states = [followed(there, held, state)
                      for held, state in zip(self.held(x), near.states, strict=True)]
            self._last = x.tobytes(), FittedState(there, states, self.base_at(x))
        return self._last[1]

    def held(self, x: Array) -> list[dict[str, float]]:
        """Return where the drivers are at each pose, by coordinate [rad or m]."""
        offsets = self.offsets_at(x)
        found = [{name: value + offsets.get(name, 0.0) for name, value in read.items()}
                 for read in self._drivers]
        for encoder, off in zip(self.unknowns.encoders, self._misread(x), strict=True):
            found[encoder.pose][encoder.coordinate] += encoder.sigma * off
        return found

    def _misread(self, x: Array) -> Array:
        """Return by how much encoders have read too little [sigma]."""
        return x[len(x) - len(self.unknowns.encoders) :]

    def dimensions_at(self, x: Array) -> dict[str, float]:
        """Return the dimensions at values of the unknowns."""
        k = len(self.nominal)
        return dict(zip(self.unknowns.dimensions,
                        (self.nominal + self.sizes[:k] * x[:k]).tolist(), strict=True))

    def offsets_at(self, x: Array) -> dict[str, float]:
        """Return the offsets by coordinate likewise."""
        some = slice(len(self.nominal), len(self.nominal) + len(self._coordinates))
        return dict(zip((c.name for c in self._coordinates),
                        (self.sizes[some] * x[some]).tolist(), strict=True))

    def base_at(self, x: Array) -> pin.SE3 | None:
        """Return the base likewise."""
        if self._start.base is None:
            return None
        if not self.unknowns.has_base:
            return self._start.base
        moved, start = self.sizes[self._base] * x[self._base], self._start.base
        return pin.SE3(pin.exp3(moved[3:]) @ start.rotation, start.translation + moved[:3])

    def errors(self, x: Array) -> Array:
        """Return model less measurements (m,), in standard deviations; infinite where it opens."""
        try:
            here = self.at(x)
        except SpatialPinError:
            return np.full(len(self.sigmas), np.inf)  # a step there is not made
        parts = []
        for state, quantities in zip(here.states, self._quantities, strict=True):
            with loops_of(here.mechanism, state.angles) as evaluation:
                evaluation.update(state.q)
                parts += [q.error(evaluation, here.base)[0] for q in quantities]
        told = np.concatenate(parts)
        return np.concatenate([told / self.sigmas[: len(told)], self._misread(x)])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives (m, n) of `errors` for x; raises as `slopes`."""
        found = self.slopes(x)
        if self.unknowns.has_base:  # of exp(w) for w: the turn that is added, from the left
            turns = slice(self._base.stop - 3, self._base.stop)
            found[:, turns] = found[:, turns] @ pin.Jexp3(x[turns]).T
        return found

    def slopes(self, x: Array) -> Array:
        """Return the derivatives (m, n) of `errors` for x, but for small turns of the base."""
        here = self._near = self.at(x)
        beside, rows = self._beside(here), []
        for i, state in enumerate(here.states):
            with loops_of(here.mechanism, state.angles) as evaluation:
                evaluation.update(state.q)
                rows.append(self._pose_rows(i, evaluation, here, beside))
        k = len(self.unknowns.encoders)
        told = np.concatenate(rows) * self.sizes / self.sigmas[: len(self.sigmas) - k, None]
        return np.vstack([told, np.eye(k, len(self.sizes), len(self.sizes) - k)])

    def _beside(self, here: FittedState) -> NeighbouringPoses | None:
        """Return the poses with every dimension a little larger and smaller, if there are any."""
        if self._family is None:
            return None
        names, poses = self.unknowns.dimensions, len(here.states)
        own = np.array([here.mechanism.dimensions[name] for name in names])
        steps = np.diag(STEP * self.sizes[: len(own)])
        every = own[:, None] + np.hstack([np.zeros((len(own), 1)), steps, -steps])
        members = self._family.at(every)
        if not members.holds.all():
            members = self._family.loaded(every)
        at = np.tile(np.arange(poses), every.shape[1])
        q, angles = (np.array(a)[at] for a in zip(
            *((s.q, s.angles) for s in here.states), strict=True))
        bodies = self._family.bodies(
            members.taken(np.repeat(np.arange(every.shape[1]), poses)), q, angles)
        ahead, behind = every[:, 1 : len(own) + 1], every[:, len(own) + 1 :]
        return NeighbouringPoses(bodies, poses, np.diag(ahead - behind), {})

    def _pose_rows(
        self, i: int, evaluation: LoopEquations, here: FittedState,
        beside: NeighbouringPoses | None,
    ) -> Array:
        """Return the derivatives (k, n) of a pose's errors [m, rad] per unit of the unknowns."""
        m, n = here.mechanism, evaluation.constraints.n_closure
        held = [m.driven_coordinate(name) for name in self._drivers[i]]
        stands = [*(c.v for c in held), *still_entries(m, held)]
        loops = evaluation.jacobian[:n] if beside is None else beside.bodies.jacobian[i]
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
        if beside is not None:
            moved = _AtRest(m, evaluation, beside, i)
            own = np.vstack([moved.slope(q, here.base) for q in self._quantities[i]])
            columns += [*(own + slopes @ self._motions(svd, -beside.opened(i), len(stands))).T]
        driven = np.eye(n + len(stands))[n : n + len(held)]
        of = {c.name: slopes @ svd.minimum_norm(row / scale[c.v])
              for c, row in zip(held, driven, strict=True)}
        still = np.zeros(len(slopes))
        columns += [of.get(c.name, still) for c in self._coordinates]
        found = np.array(columns).reshape(len(columns), len(slopes)).T
        base = [np.vstack([q.base_slope(evaluation, here.base) for q in self._quantities[i]])
                ] if self.unknowns.has_base and here.base is not None else []
        read = np.array([of[e.coordinate] if e.pose == i else still
                         for e in self.unknowns.encoders]).reshape(-1, len(slopes)).T
        return np.hstack([found, *base, read])

    def _motions(self, svd: Decomposition, opened: Array, n_still: int) -> Array:
        """Return how the joints go (nv, n) to keep loops closed that dimensions open (rows, n)."""
        wanted = np.vstack([opened, np.zeros((n_still, opened.shape[1]))])
        kept = svd.u[:, : svd.rank]
        left = np.linalg.norm(wanted - kept @ (kept.T @ wanted), axis=0)
        opens = left > TOLERANCES.half_precision * np.maximum(1.0, np.linalg.norm(wanted, axis=0))
        if opens.any():
            name = self.unknowns.dimensions[int(np.argmax(opens))]
            raise SpatialPinError(
                f"mechanism {self._start.mechanism.name!r}: the loops open where {name!r} alone is "
                "changed (they are overconstrained); calibrate a dimension that keeps them closed")
        found: Array = svd.vt[: svd.rank].T @ ((kept.T @ wanted) / svd.s[: svd.rank, None])
        return found
