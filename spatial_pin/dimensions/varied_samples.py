"""A mechanism at many sets of dimensions, closed together near one of its closed states.

The kernel closes every sample by the least motion from the state, drivers fixed. A sample is on the
state's branch if it is near, the linear equations explain its motion, and the determinant has about
the same size. Other samples are reached through intermediate dimensions. Samples near a singular
configuration are left to `homotopy`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.close import DAMPED_STEPS
from spatial_pin.assembly.holding import fixed_base_entries
from spatial_pin.assembly.start_values import periodic
from spatial_pin.assembly.state import FrameMotion, State
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.dimensions.traced_tree import TracedGeometry, TracedTree
from spatial_pin.dimensions.variants import DimensionNumbers, Variants
from spatial_pin.dynamics.force_outputs import NamedOutputs
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.dimensions import ClosedSamples, DimensionKernel, Numbers
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.coordinates import CoordinateRates, coordinate_rates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.limits import limits
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.outputs import (
    ROTATION,
    NamedOutput,
    is_force,
    is_of_whole,
    named_output,
)
from spatial_pin.numerics.linalg import Array, decompose, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.rates import prescribed_at, solve_rates
from spatial_pin.settings import Accuracy


def end_of_range(output: str) -> tuple[str, str] | None:
    """Return the end ("lower" or "upper") and driver of a range limit; None for other outputs."""
    kind, _, rest = output.partition(".")
    end, _, driver = rest.partition(".")
    return (end, driver) if kind == "limit" and end in ("lower", "upper") else None


def with_force_values(outputs: Iterable[str]) -> bool:
    """Whether one of the outputs is a force."""
    return any(is_force(output) for output in outputs)


def with_masses(mechanism: Mechanism, outputs: Iterable[str]) -> bool:
    """Whether one of the outputs depends on masses: a force, or one of the whole mechanism."""
    return any(is_force(output) or is_of_whole(mechanism, output) for output in outputs)


@dataclass(frozen=True)
class DriverMotion:
    """The drivers' motion at a state: values, speeds, accelerations, by coordinate."""

    driver: str  # reference of speed ratios
    values: dict[str, float]
    speeds: dict[str, float]
    accelerations: dict[str, float]
    in_time: bool = True  # whether rates are those in time; if not, forces are those at rest

    @classmethod
    def of(cls, state: State, driver: str = "", held: Iterable[str] = ()) -> DriverMotion:
        """Return the motion of a mechanism's drivers, or of other fixed coordinates, at a state."""
        mechanism = state.mechanism
        names = list(held) or [d.joint for d in mechanism.drivers.values()]
        rates = {name: state.coordinate(name) for name in names}
        first = driver or next(iter(mechanism.drivers), next(iter(mechanism.coordinates), ""))
        values, speeds, accelerations = (
            {name: r[k] for name, r in rates.items()} for k in range(3))
        return cls(first, values, speeds, accelerations, state.in_time)

    @classmethod
    def along(cls, motion: Motion, state: State) -> DriverMotion:
        """Return it at a state of a motion: of its drivers, or of the swept coordinate."""
        mechanism, name = state.mechanism, motion.driver_name
        drivers = [mechanism.coordinate(d.joint) for d in mechanism.drivers.values()]
        if motion.driver is None or mechanism.coordinate(name) in drivers:
            return cls.of(state, name)
        return cls.of(state, name, [c.name for c in prescribed_at(state, [name])])

    @property
    def moves(self) -> bool:
        """Whether a speed or acceleration is not zero."""
        return any(self.speeds.values()) or any(self.accelerations.values())

    def state(self, mechanism: Mechanism, near: State) -> State:
        """Return the state of a mechanism with this motion of its drivers; see `evaluate`."""
        state = followed(mechanism, self.values, near)
        return solve_rates(mechanism, state, self.speeds, self.accelerations) if (
            self.moves) else state

    def evaluate(self, mechanism: Mechanism, near: State, outputs: Sequence[str]) -> list[Any]:
        """Return outputs of a mechanism with this motion of its drivers.

        `near` is a closed state at these or other dimensions, whose branch is followed.
        """
        table: NamedOutputs | None = None
        values: list[Any] = []
        for output in outputs:
            end = end_of_range(output)
            if end is not None:
                bound = getattr(limits(mechanism, end[1], near), end[0])
                if bound.kind == "none":
                    raise SpatialPinError(f"mechanism {mechanism.name!r}: {end[1]!r} has no limit")
                values.append(bound.value)
                continue
            if table is None:
                table = self.outputs_at(self.state(mechanism, near))
            value = table.output(output).values[0]
            values.append(float(value) if np.ndim(value) == 0 else value)
        return values

    def outputs_at(self, state: State) -> NamedOutputs:
        """Return the outputs of a state, by their names."""
        value, speed, _ = state.coordinate(self.driver)
        return NamedOutputs(Motion(
            state.mechanism, np.array([value]), self.driver, None, state.q[None], state.v[None],
            state.a[None], np.array([state.closure_error]), np.array([speed]),
            angles=np.array(state.angles)[None]), self.in_time)


# largest step of a joint [rad, characteristic lengths]: its cosine is still 0.97
LONGEST_AT_ONCE = 0.25
# longest step of all joints together: parallel axes cannot become opposite
LONGEST_TOGETHER = TOLERANCES.longest_step
# ratio of a sample's determinant to the state's: it costs two digits of accuracy
LEAST_DETERMINANT = 0.02
PARTS = 1, 4, 16  # steps in which a sample's dimensions are reached, one number after the other


def _square_system(state: State, drive: DriverMotion) -> dict[str, Any] | None:
    """Return what `DimensionKernel.close` closes samples with; None if it may be singular."""
    mechanism = state.mechanism
    held = [mechanism.driven_coordinate(name) for name in drive.values]
    driven = [*(c.v for c in held), *fixed_base_entries(mechanism, held)]
    free = np.ones(mechanism.model.nv, dtype=bool)
    free[[c.v for c in held]] = False
    moving = free.copy()
    moving[driven] = False
    with loops_of(mechanism, state.angles) as evaluation:
        evaluation.update(state.q)
        jacobian, n = evaluation.jacobian, evaluation.constraints.n_closure
        chosen = independent_rows(jacobian[:n, moving])
        rows = np.vstack([jacobian[chosen], jacobian[n:], np.eye(len(free))[driven]])
    svd = decompose(rows)
    if len(svd.s) < len(rows) or (len(rows) and svd.s[-1] <= TOLERANCES.regular * svd.s[0]):
        return None
    return {"chosen": chosen, "driven": driven, "fill": svd.null_space, "free": free}


class VariedSamples:
    """Outputs of a mechanism at many sets of its dimensions, near a closed state; make it by `of`.

    Drivers are fixed, and have the rates of that state.
    """

    def __init__(
        self, tree: TracedTree, wanted: list[NamedOutput], state: State, drive: DriverMotion,
        system: dict[str, Any],
    ) -> None:
        self.mechanism, self._tree, self._wanted = state.mechanism, tree, wanted
        self._state, self._drive, self._system = state, drive, system
        self._points = list(dict.fromkeys(x.of for x in wanted if x.family == "point"))
        self._numbers = DimensionNumbers(self.mechanism, tree, self._points)
        still = [0.0] * (len(system["driven"]) - len(drive.values))
        self._rates = np.array([[*rates.values(), *still] for rates in (
            drive.speeds, drive.accelerations)]) if drive.moves else None
        own = Numbers(self._numbers.base, np.empty(0, np.int64), np.empty((1, 0)))
        nominal = self._close(state.q[None], state.angles[None], own, self._rates)
        self._sign, self._magnitude = nominal.sign, nominal.magnitude

    @classmethod
    def of(
        cls, dimensions: Iterable[str], outputs: Iterable[str], state: State, drive: DriverMotion
    ) -> VariedSamples | None:
        """Return samples that can be closed together; None if each needs its own mechanism.

        That is so for a file that cannot be traced, for outputs other than rates of coordinates and
        points, and for a state whose equations may be dependent.
        """
        tree, system = Variants(state.mechanism, dimensions).tree, _square_system(state, drive)
        wanted = [named_output(state.mechanism, spec) for spec in outputs]
        known = [x for x in wanted if x is not None and x.family in ("coordinate", "point")
                 and not x.rule.needs and x.kind != ROTATION]
        if tree is None or system is None or not wanted or len(known) < len(wanted):
            return None
        try:
            return cls(tree, known, state, drive, system)
        except SpatialPinError:  # an output that does not exist: whoever asks for it says so
            return None

    def geometry(self, dimensions: Array, part: float) -> tuple[TracedGeometry, Numbers]:
        """Return the geometry at a part of the change to dimensions (k, m), and its numbers."""
        if part != 1.0:
            own = np.array([[*self._tree.dimensions.values()]]).T
            dimensions = own + part * (dimensions - own)
        with np.errstate(all="ignore"):  # of samples that are none
            traced = self._tree.at(dimensions)
            return traced, self._numbers.at(traced)

    def solve(self, dimensions: Array) -> tuple[NDArray[np.bool_], list[Array]]:
        """Return which samples at dimensions (k, m) are on the state's branch, and all outputs.

        These are each (m,) or (m, 3).
        """
        good, values = np.zeros(dimensions.shape[1], dtype=bool), list[Array]()
        for parts in PARTS:
            far = np.flatnonzero(~good)
            if not len(far):
                break
            good[far], closed = self._in_parts(dimensions[:, far], parts)
            samples = _ClosedTogether(self.mechanism, self._points, closed, self._drive.driver)
            new = [x.values(samples) for x in self._wanted]
            for old, some in zip(values, new, strict=bool(values)):
                old[far] = some
            values = values or new
        return good, values

    def _in_parts(
        self, dimensions: Array, parts: int
    ) -> tuple[NDArray[np.bool_], ClosedSamples]:
        """Close samples, their dimensions changed in equal parts.

        Good samples are closed near their start, and `start_values.nearest_turn` would not change
        their angles.
        """
        m, state = dimensions.shape[1], self._state
        q, angles = (np.repeat(x[None], m, axis=0) for x in (state.q, state.angles))
        good, model, turn = np.ones(m, dtype=bool), self.mechanism.model, 2.0 * np.pi
        for k in range(1, parts + 1):
            traced, numbers = self.geometry(dimensions, k / parts)
            closed = self._close(q, angles, numbers, self._rates if k == parts else None)
            q, angles = closed.q, closed.angles
            step = np.maximum(closed.farthest, TOLERANCES.nothing)
            good &= (
                traced.holds & (closed.error <= TOLERANCES.zero)
                & (closed.farthest <= LONGEST_AT_ONCE) & (closed.distance <= LONGEST_TOGETHER)
                & (closed.bend <= TOLERANCES.contraction * step) & (closed.sign == self._sign)
                & (closed.magnitude > self._magnitude + np.log(LEAST_DETERMINANT))
                & (closed.opened <= TOLERANCES.singular))
            for at in (c.q for c in periodic(self.mechanism)):
                lower, upper = (traced.limits.get(
                    (bound, at), getattr(model, f"{bound}PositionLimit")[at])
                    for bound in ("lower", "upper"))
                x = q[:, at]
                good &= ~(((x > upper) & (x - turn >= lower)) | ((x < lower) & (x + turn <= upper)))
        return good, closed

    def _close(
        self, q: Array, angles: Array, numbers: Numbers, rates: Array | None
    ) -> ClosedSamples:
        with acquired(self.mechanism, DimensionKernel) as kernel:
            return kernel.close(
                q, angles, numbers, **self._system, joints=self._numbers.joints, rates=rates,
                tolerance=Accuracy.named("engineering").tolerance, iterations=DAMPED_STEPS)


class _ClosedTogether:
    """Samples closed together, in place of those of a motion; see `Motion`."""

    def __init__(
        self, mechanism: Mechanism, points: list[str], closed: ClosedSamples, driver: str
    ) -> None:
        self.mechanism, self._points, self._closed = mechanism, points, closed
        self.swept = self.driver_speed = closed.v[:, mechanism.coordinate(driver).v]

    def coordinate(self, name: str) -> CoordinateRates[Array]:
        """See `Motion.coordinate`; samples have nothing to do with each other."""
        q, _, v, a = self._closed[:4]
        return coordinate_rates(self.mechanism, name, q, v, a, continued=False)

    def frame(self, name: str) -> FrameMotion:
        """See `Motion.frame`; rotations are missing."""
        x, *rates = np.moveaxis(self._closed.points[:, self._points.index(name)], 1, 0)
        return FrameMotion(x + self.mechanism.centre, np.empty(0), *rates)

    def com(self, name: str) -> FrameMotion:
        """See `Motion.com`."""
        return self.frame(f"{name}.com")
