"""Predicted measurements at given dimensions, offsets and base, with derivatives.

The derivatives are those of the closed states (`closed_derivatives`): no loop is closed for them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.holding import fixed_base_entries
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.closed_derivatives import ClosedDerivatives, InputChanges, OpenedError
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.dimensions.measurements import UNITS, Encoder, MeasuredQuantity
from spatial_pin.dimensions.moved_geometry import MovedGeometry, moved_geometry
from spatial_pin.dimensions.variants import Variants
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

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
        self._variants = Variants(m, unknowns.dimensions) if unknowns.dimensions else None
        self._near = start
        self._last: tuple[bytes, FittedState] | None = None
        self._slopes: tuple[bytes, Array] | None = None
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
            there = self._variants.at(dimensions) if self._variants else near.mechanism
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
        if self._slopes is not None and self._slopes[0] == x.tobytes():
            return self._slopes[1].copy()
        here = self._near = self.at(x)
        geometry = moved_geometry(here.mechanism, self._variants, False)
        rows = [self._pose_rows(i, here, geometry) for i in range(len(here.states))]
        k = len(self.unknowns.encoders)
        slopes = np.concatenate(rows) * self.sizes / self.sigmas[: len(self.sigmas) - k, None]
        read = np.eye(k, len(self.sizes), len(self.sizes) - k)
        self._slopes = x.tobytes(), np.vstack([slopes, read])
        return self._slopes[1].copy()

    def _pose_rows(self, i: int, here: FittedState, geometry: MovedGeometry) -> Array:
        """Return the derivatives (k, n) of a pose's errors [m, rad] per unit of the unknowns."""
        m, state, d = here.mechanism, here.states[i], len(self.nominal)
        held = [m.driven_coordinate(name) for name in self._drivers[i]]
        number = {c.name: d + k for k, c in enumerate(held)}
        still, n = np.zeros((len(held), d + len(held))), d + len(held)
        given = InputChanges(np.eye(n)[d:], still, still, np.zeros((m.model.nv, n)), np.eye(d, n))
        at = ClosedDerivatives(geometry, state, held, fixed_base_entries(m, held))
        try:
            moves = at.displacements(given)
        except OpenedError as error:
            name = (*self.unknowns.dimensions, *(c.name for c in held))[error.column]
            raise SpatialPinError(
                f"mechanism {m.name!r}: the loops open where {name!r} alone is "
                "changed (they are overconstrained); calibrate a dimension that keeps them closed"
            ) from error
        q = geometry.motion(state, state.a)[0]
        with loops_of(geometry.mechanism, state.angles) as evaluation:
            evaluation.update(q)
            by_q = np.vstack([x.error(evaluation, here.base)[1] for x in self._quantities[i]])
            base = [np.vstack([x.base_slope(evaluation, here.base) for x in self._quantities[i]])
                    ] if self.unknowns.has_base and here.base is not None else []
        slopes = by_q @ moves
        free = np.abs(slopes[:, n:] / np.abs(moves[:, n:]).max(axis=0, initial=0.0)).max(
            axis=1, initial=0.0)
        if free.max(initial=0.0) > TOLERANCES.half_precision * np.abs(by_q).max(initial=0.0):
            labels = [label for q in self._quantities[i] for label in q.labels()]
            raise SpatialPinError(
                f"measurement {i + 1}: {labels[int(np.argmax(free))]!r} can move where the drivers "
                "given stand; give values of drivers or coordinates that hold it, or leave it out")
        none = np.zeros((len(slopes), 1))
        wide = np.hstack([slopes[:, :n], none])
        offsets = [number.get(c.name, n) for c in self._coordinates]
        read = [number[e.coordinate] if e.pose == i else n for e in self.unknowns.encoders]
        return np.hstack([wide[:, [*range(d), *offsets]], *base, wide[:, read]])
