"""The whole curve of closed configurations of one driver, by arc length, through limits."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from spatial_pin._support.checks import checked, positive_number
from spatial_pin.assembly.holding import BASE, Hold
from spatial_pin.assembly.state import State
from spatial_pin.continuation.branch_points import straight_on
from spatial_pin.continuation.initial_tangent import (
    body_placements,
    non_spinning_bodies,
    system_at,
)
from spatial_pin.continuation.path_tracker import error_estimate
from spatial_pin.continuation.pseudo_arclength import ArcLengthPath, Stopped
from spatial_pin.continuation.singular_points import distance_ahead, located_singularity
from spatial_pin.continuation.solution_curve import CurvePoint, SolutionCurve
from spatial_pin.errors import SingularError
from spatial_pin.kernel.paths import PathSamples
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Event, Motion
from spatial_pin.motion.rounding import within_gap
from spatial_pin.motion.sweep import scaled_estimates
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.depending import PartMotion
from spatial_pin.settings import Accuracy

TURN = 2.0 * np.pi
# Distance, in steps, from which a curve is checked for having closed. It is one step if the joints
# move at constant speed, and two and a half if they do not.
STEPS_NEAR = 2.5


@checked
def trace(
    mechanism: Mechanism,
    driver: str,
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    step: float = 0.02,
    most_rows: int = 20_000,
    hold: Hold = BASE,
) -> Motion:
    """Follow the curve of closed configurations by arc length, through limits, until it closes.

    Args:
        mechanism: the mechanism; other drivers stay where the guess has them.
        driver: the driver or coordinate that is set free; its values are `Motion.driver`.
        guess: where to start, as for `assemble`.
        step: arc length from sample to sample [rad, characteristic lengths].
        most_rows: number of samples at which to stop in any case.
        hold: names of other joints that stand still, as for `sweep`.

    Returns:
        A Motion whose rates are with respect to the arc length. Its events are limit positions, and
        branch points, which are passed straight on. The last sample is the first one again (bodies
        that spin freely jump back in it). If the curve was not closed within `most_rows`, the last
        event is of kind "not closed".

    Raises:
        AssemblyError: the guess does not close.
        SingularError: branches cross and none goes straight on; `.motion` holds what came before.
        ValueError: `step` or `most_rows` is not positive, or the driver is held.

    Example:
        >>> mech = sp.load("four_bar", r2=0.25)  # no link turns fully
        >>> motion = sp.trace(mech, "crank")
        >>> [(event.kind, round(event.value, 4)) for event in motion.events]  # [rad]
        [('limit', 2.4751), ('limit', -2.4751)]
    """
    step = positive_number(step, "step")
    positive_number(most_rows, "most_rows")
    system, state, moved = system_at(mechanism, driver, guess, hold)
    curve = SolutionCurve(system, Accuracy.named("engineering").tolerance)
    first = curve.settle(state.q, curve.tangent(system.driver_rates()[:, 0]))
    if first is None:
        raise SingularError(f"mechanism {mechanism.name!r}: branches cross at the start, {state}",
                            state=state)
    path = ArcLengthPath(curve, first, distance_ahead(curve, first))
    samples = _TracedSamples(curve, driver, state.mechanism, moved)
    samples.add(first)
    while len(samples.points) < most_rows:
        if _advance(path, step, samples):
            if samples.is_back(path.point, step):
                samples.add_first_again()
                break
        else:
            before = samples.points[-1]
            beyond = straight_on(curve, before)
            if beyond is None:
                raise SingularError(
                    f"mechanism {mechanism.name!r}: the curve cannot be followed beyond {driver} = "
                    f"{path.value:.12g}: branch point", motion=samples.motion())
            samples.note_branch_points(before, beyond)
            path.point, path.distance = beyond, distance_ahead(curve, beyond)
        samples.add(path.point)
    else:
        samples.note("not closed", path.value)
    return within_gap(samples.motion(), Accuracy(), "stop")


def _advance(path: ArcLengthPath, length: float, samples: _TracedSamples) -> bool:
    """Move to the next sample and record limits; False if a branch point lies before it."""
    rest, longest = length, length
    with suppress(Stopped):
        while rest > TOLERANCES.tight * length:
            step = path.ahead(min(longest, rest))
            turn = path.turning_point(step)
            if turn is not None:
                samples.note("limit", path.curve.value(turn.x))
            path.take(step)
            longest, rest = step.length, rest - step.length
        return True
    return False


class _TracedSamples:
    """Samples of a traced curve."""

    def __init__(
        self, curve: SolutionCurve, driver: str, mechanism: Mechanism, moved: PartMotion
    ) -> None:
        self.curve, self.driver, self.mechanism, self._moved = curve, driver, mechanism, moved
        self.points: list[CurvePoint] = []
        self.accelerations: list[Array] = []
        self.errors: list[float] = []
        self.estimates: list[Array] = []
        self.events: list[Event] = []
        self.near, self.has_gone = np.inf, False  # how near to the first place counts as back there

    def add(self, point: CurvePoint) -> None:
        """Add a point, with the second derivative of the curve there."""
        curve, evaluation, model = self.curve, self.curve.evaluation, self.curve.evaluation.model
        rows, scale = curve.equations(point.x), curve.scale
        n, chosen = evaluation.constraints.n_closure, curve.selected
        bias = evaluation.bias(point.x, scale * point.t)
        rhs = np.zeros(len(rows) + 1)
        rhs[: len(chosen)] = -bias[:n][chosen]
        rhs[len(chosen) : len(chosen) + len(bias) - n] = -bias[n:]
        svd = decompose(np.vstack([rows, point.t]))
        bends = svd.minimum_norm(rhs)
        self.estimates.append(error_estimate(evaluation, svd, chosen, point.t, bends))
        self.points.append(point)
        self.accelerations.append(scale * bends)
        self.errors.append(evaluation.closure_error)
        if len(self.points) < 2:
            self.bodies = non_spinning_bodies(self.curve.system)
            self.own = np.isin(np.repeat(np.arange(model.njoints), model.nvs), self.bodies)
            self.first_placement = body_placements(self.curve.evaluation, self.bodies)

    def is_back(self, point: CurvePoint, step: float) -> bool:
        """Whether all bodies are within a step of their start and move in the same direction.

        But for those that spin freely, whose joints have other axes then. Where many joints share
        a step of arc length, bodies move by a small part of it only.
        """
        self.curve.equations(point.x)
        placements = body_placements(self.curve.evaluation, self.bodies)
        gap = float(np.abs(placements - self.first_placement).max())
        if len(self.points) == 1:
            self.near = min(step, STEPS_NEAR * gap)
        if gap >= self.near:
            self.has_gone = True
        now, first = (x.t[self.own] for x in (point, self.points[0]))
        is_forward = now @ first > 0.5 * np.sqrt((now @ now) * (first @ first))
        return bool(self.has_gone and gap < self.near and is_forward)

    def add_first_again(self) -> None:
        """Add the first configuration as the last, with angles counted over turns."""
        first, last = self.points[0], self.points[-1]
        q = first.x.copy()
        for c in self.mechanism.coordinate_table.values():
            if c.q >= 0 and c.unit == "rad":
                q[c.q] += TURN * np.round((last.x[c.q] - q[c.q]) / TURN)
        self.points.append(first._replace(x=q))
        self.accelerations.append(self.accelerations[0])
        self.errors.append(self.errors[0])
        self.estimates.append(self.estimates[0])

    def note(self, kind: str, value: float) -> None:
        """Record a limit position, a branch point, or an early end as an event."""
        unit = self.mechanism.coordinate(self.driver).unit
        words = {"limit": "limit position",
                 "branch point": "branch point, passed straight on,",
                 "not closed": f"not closed within {len(self.points)} samples: left off"}
        text = f"{words[kind]} at {self.driver} = {value:.12g} {unit}"
        self.events.append(Event(kind, value, len(self.points), text))

    def note_branch_points(self, point: CurvePoint, beyond: CurvePoint) -> None:
        """Record the branch points between two points, seen from both: there may be several."""
        back = beyond._replace(t=-beyond.t, sign=-beyond.sign)
        seen = [located_singularity(self.curve, x) for x in (point, back)]
        values = [singular[1] for singular in seen if singular is not None]
        for k, value in enumerate(values):
            if not k or abs(value - values[0]) > TOLERANCES.half_precision:
                self.note("branch point", value)

    def motion(self) -> Motion:
        """Return the samples as a Motion over the arc length."""
        scale = self.curve.scale
        q = np.array([p.x for p in self.points])
        v = np.array([scale * p.t for p in self.points])
        driver, moved = self.curve.system.driven[0], self._moved
        traced = PathSamples(q, v, np.array(self.accelerations), np.array(self.errors),
                        np.array(self.estimates), np.array([p.angles for p in self.points]))
        traced = moved.of_whole(traced)
        motion = Motion(
            mechanism=moved.whole.mechanism, driver=q[:, driver.q].copy(), driver_name=self.driver,
            time=None, q=q, v=v, a=traced.c, closure_error=traced.error,
            driver_speed=v[:, driver.v].copy(), events=self.events, angles=traced.angles,
            per="length", held=moved.held)
        motion.error_estimates = scaled_estimates(motion, traced.estimate)
        return motion
