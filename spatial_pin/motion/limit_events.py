"""Limits of the URDF that a motion passes, of positions, velocities and efforts; ends of curves.

A velocity or effort limit of 0 is none: URDF wants the attributes even where nothing is known.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import brief
from spatial_pin._support.lazy import Workspaces, made_anew
from spatial_pin.assembly.state import State
from spatial_pin.continuation.path_tracker import PathTracker
from spatial_pin.continuation.pseudo_arclength import Stopped
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.joint_limits import SLACK, JointLimit, joint_limits, limit_arrays
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.motion.motion import Event, Motion
from spatial_pin.motion.summary import EFFORTS, where
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import quintic
from spatial_pin.numerics.roots import between_samples, onsets, sign_change
from spatial_pin.settings import Accuracy

KIND = "joint limit"  # of events
VELOCITY, EFFORT, END_OF_CURVE = "velocity limit", "effort limit", "end of curve"  # other kinds
UNSET = 1e300  # Pinocchio has its largest number, or infinity, where there is no limit
CURVE_SLACK = 1e-10  # of a curve's length, beyond its end
# Rate of a joint at rest, relative to the fastest joint: round-off of solved rates stays below.
NOISE = 1e-11
# What rates and accelerations add to a polynomial of fifth degree between two samples, at most: the
# largest values of x (1 - x)³ (1 + 3 x) and of x² (1 - x)³ / 2 in steps from 0 to 1, rounded up.
SWING_OF_RATES, SWING_OF_ACCELERATIONS = 0.2, 0.02
# Margin to a limit, in swings of the joint between two samples, within which the polynomials
# between samples are checked.
DOUBT = 4.0
# Difference of joint coordinates that shows another branch [rad, characteristic lengths].
ELSEWHERE = 1e-6

_Path = Callable[[float], tuple[Array, Array]]  # to configuration and rates
_Ends = tuple[tuple[Array, Array], tuple[Array, Array]]  # the same at both ends


class Passing(NamedTuple):
    """A joint limit passed outwards.

    Attributes:
        limit: the joint limit.
        value: where [s], or the driver's value there [rad or m], or the number of the sample.
        row: number of samples of the motion before it.
        where: the value in words; empty where the motion begins beyond the limit.

    Example:
        >>> mech = sp.load("excavator")
        >>> state = sp.assemble(mech, {"boom": 2.05})  # let go, 0.05 m above its lower limit
        >>> passing = sp.simulate(mech, state, 0.4).joint_limits[0]
        >>> print(f"{passing.limit.name} after {passing.value:.4f} s")
        boom_slide after 0.3671 s
        >>> passing.event.kind
        'joint limit'
    """

    limit: JointLimit
    value: float
    row: int
    where: str

    @property
    def event(self) -> Event:
        """The event of a motion for this passing."""
        return Event(KIND, self.value, self.row, f"{self.limit.words} passed {self.where}"
                     if self.where else f"beyond the {self.limit.words} from the start")


def passed_at_start(mechanism: Mechanism, q: Array, value: float) -> list[Passing]:
    """Return the joint limits that q (nq,) is beyond, as passings at a value (driver or time)."""
    return [Passing(limit, value, 0, "") for limit in joint_limits(mechanism)
            if limit.room(q) < -SLACK * limit.size]


def first_passing(
    limit: JointLimit, at: _Path, span: tuple[float, float], ends: _Ends, noise: float = 0.0,
) -> float | None:
    """Return the time at which a limit is first passed outwards in a span, or None.

    A joint that turns back is looked at where it stands still; one that does so twice in the span
    may pass unnoticed in between. `at` is a function of the time to (q, v); `ends`, the same at
    both ends, may differ from it by round-off. `noise` is the rate of a joint at rest [rad/s,
    characteristic lengths per second].
    """
    slack, still, last = SLACK * limit.size, noise * limit.size, span[1]
    before, after = (float(limit.room(q)) for q, _ in ends)
    if before < -slack:
        return None
    if not after < -slack:
        pace = [float(limit.closing(v)) for _, v in ends]
        if not pace[0] > still >= -still > pace[1]:
            return None
        last = sign_change(lambda t: float(limit.closing(at(t)[1])), *span, *pace)
        after = float(limit.room(at(last)[0]))
        if not after < -slack:
            return None
    return sign_change(lambda t: float(limit.room(at(t)[0])), span[0], last, before, after)


def joint_limits_passed(motion: Motion) -> list[Passing]:
    """Return the points where a motion passes joint limits outwards, in order of samples.

    Where the motion of a swept driver passes one between two samples, the branch is followed
    again from the first of them, to where the joint is at its limit: however far samples are apart,
    the driver's value is as exact as the limit allows, 1e-12 where the joint moves as fast as the
    driver. Where that is impossible (coordinates held that are no drivers, branches that cross in
    between), and in simulations, whose `joint_limits` are exact, a coordinate is interpolated by
    the polynomial of fifth degree through values, rates and accelerations of the two samples, or a
    straight line without rates; then sentences have six digits. A joint that turns back between
    two samples is checked where it does; one that goes out and back between two samples while its
    rates at both have the same sign is missed: ask for samples nearer to each other.

    Args:
        motion: from `sweep`, `trace` or `simulate`.

    Returns:
        The passings; their values are driver values, or times where none was swept.
    """
    if not len(motion):
        return []
    limits = joint_limits(motion.mechanism)
    if not limits:
        return []
    values = motion.driver if motion.driver is not None else motion.time
    start = float(values[0]) if values is not None else 0.0
    all_passings = passed_at_start(motion.mechanism, motion.q[0], start)
    for at, k in zip(*(x.tolist() for x in np.nonzero(_may_be_passed(motion))), strict=True):
        passing = _between(motion, limits[at], k)
        all_passings += [passing] if passing is not None else []
    return sorted(all_passings, key=lambda passing: passing.row)


def _may_be_passed(motion: Motion) -> NDArray[np.bool_]:
    """Return (limits, N - 1) whether each limit may be passed outwards in each step."""
    limits, at, of, value, side, slack = limit_arrays(motion.mechanism)
    q, v, a = (np.ascontiguousarray(x.T) for x in (motion.q, motion.v, motion.a))  # for one joint
    pace, bend = (np.maximum(x.max(axis=1), -x.min(axis=1)) for x in (v, a))
    noise = NOISE / SLACK * float((pace / motion.mechanism.velocity_scale).max(initial=0.0))
    may = np.zeros((len(limits), len(motion) - 1), dtype=bool)
    steps = _steps(motion)
    swings: Any = np.inf  # beyond both samples of a step, at most
    if steps is not None:
        h = float(steps.max(initial=0.0))
        swings = 2.0 * h * (SWING_OF_RATES * pace[of] + h * SWING_OF_ACCELERATIONS * bend[of])
    least = side * (value - np.where(side > 0.0, q.max(axis=1)[at], q.min(axis=1)[at]))
    close = np.flatnonzero((least < -slack) | (least <= (1.0 + DOUBT) * swings))
    if not close.size:  # as most are far from all limits
        return may
    sense: Any = 1.0  # -1 where samples go against their rates
    if motion.driver is not None and motion.time is None:
        rate = motion.coordinate(motion.driver_name).rate
        sense = np.where(np.diff(motion.driver) * (rate[:-1] + rate[1:]) >= 0.0, 1.0, -1.0)
    for i in close.tolist():
        rate, room = v[of[i]], side[i] * (value[i] - q[at[i]])
        first, last = (sense * side[i] * x for x in (rate[:-1], rate[1:]))
        turning = (first > noise * slack[i]) & (last < -noise * slack[i])
        if steps is not None:
            pace, bend = (np.abs(x[:-1]) + np.abs(x[1:]) for x in (rate, a[of[i]]))
            swings = steps * (SWING_OF_RATES * pace + steps * SWING_OF_ACCELERATIONS * bend)
        near = np.minimum(room[:-1], room[1:]) <= (1.0 + DOUBT) * swings
        outside = room < -slack[i]
        may[i] = ~outside[:-1] & (outside[1:] | (turning & near))
    return may


def _steps(motion: Motion) -> Array | None:
    """Return (N - 1,) steps that v and a are rates of; None where they are none of the samples."""
    if motion.time is not None:
        return np.diff(motion.time)
    if motion.per == "sample":
        return np.ones(len(motion) - 1)
    if motion.driver is not None and motion.per == motion.driver_unit:
        return np.abs(np.diff(motion.driver))
    return None


def _between(motion: Motion, limit: JointLimit, k: int) -> Passing | None:
    """Return where a limit is passed between samples k and k + 1, if it is."""
    h, rates, seconds = _step(motion, k)
    q, v = _quintic(motion.q[k : k + 2, limit.q], rates[:, limit.v], seconds[:, limit.v], h)
    sample, moving = np.zeros(motion.q.shape[1]), np.zeros(motion.v.shape[1])

    def at(x: float) -> tuple[Array, Array]:
        sample[limit.q], moving[limit.v] = q(x), v(x)
        return sample, moving

    ends = (motion.q[k], rates[0]), (motion.q[k + 1], rates[1])
    if motion.driver is not None:
        if not _may_pass(limit, at, ends):
            return None
        with contextlib.suppress(Stopped, SpatialPinError):
            value = _followed(motion, limit, k, ends)
            return None if value is None else _at_driver(motion, limit, k, value, 12)
    x = first_passing(limit, at, (0.0, 1.0), ends)
    if x is None:
        return None
    if motion.driver is None:
        if motion.time is None:
            return Passing(limit, float(k + x), k + 1, f"at sample {k + x:.6g}")
        time = float(motion.time[k] + x * h)
        return Passing(limit, time, k + 1, f"at {time:.6g} s")
    c = motion.mechanism.coordinate(motion.driver_name)
    if c.q < 0:
        return _at_driver(motion, limit, k, float(np.interp(x, (0.0, 1.0),
                                                            motion.driver[k : k + 2])), 6)
    driver, _ = _quintic(motion.q[k : k + 2, c.q], rates[:, c.v], seconds[:, c.v], h)
    return _at_driver(motion, limit, k, float(driver(x)), 6)


def _at_driver(motion: Motion, limit: JointLimit, k: int, value: float, digits: int) -> Passing:
    return Passing(limit, value, k + 1,
                   f"at {motion.driver_name} = {value:.{digits}g} {motion.driver_unit}")


def _may_pass(limit: JointLimit, at: _Path, ends: _Ends) -> bool:
    """Whether a limit may be passed between two samples, if interpolants are only roughly right."""
    (q0, v0), (q1, v1) = ends
    if limit.room(q1) < -SLACK * limit.size:
        return True
    pace = float(limit.closing(v0)), float(limit.closing(v1))
    if not pace[0] > 0.0 > pace[1]:
        return False
    turn = sign_change(lambda x: float(limit.closing(at(x)[1])), 0.0, 1.0, *pace)
    room = limit.room(at(turn)[0])
    swing = min(limit.room(q0), limit.room(q1)) - room
    return bool(room < DOUBT * swing)


def _followed(motion: Motion, limit: JointLimit, k: int, ends: _Ends) -> float | None:
    """Return the driver's value at which a limit is passed between samples k and k + 1, if it is.

    Raises:
        Stopped: the branch of sample k does not lead to sample k + 1.
        SpatialPinError: the driver does not determine it.
    """
    first, last = motion.swept[k : k + 2].tolist()
    sense = float(np.sign(last - first))
    start = State(motion.mechanism, motion.q[k], closure_error=motion.closure_error[k],
                  angles=motion.angles[k])
    with Workspaces() as workspaces:
        tracker = PathTracker.along(start, [motion.driver_name], motion.held,
                                    Accuracy.named("reference"), workspaces)

        def at(value: float) -> tuple[Array, Array]:
            tracker.reach(value)
            return tracker.here.q, sense * tracker.here.t

        q, _ = at(last)
        size = motion.mechanism.velocity_scale
        for c in motion.mechanism.coordinate_table.values():
            if c.q >= 0 and abs(q[c.q] - motion.q[k + 1, c.q]) > ELSEWHERE * size[c.v]:
                raise SpatialPinError("the samples were taken with other coordinates held")
        return first_passing(limit, at, (first, last), ends)


def _step(motion: Motion, k: int) -> tuple[float, Array, Array]:
    """Return the step from sample k, and first and second derivatives (2, nv) at its ends.

    They are derivatives with respect to time, to the driver or to the number of samples where v and
    a are; where samples are no history in any of these, to the arc length, whose step h is the one
    that fits best q1 - q0 = h (q0' + q1')/2 + h² (q0" - q1")/12. 0 without rates.
    """
    v, a = motion.v[k : k + 2], motion.a[k : k + 2]
    steps = _steps(motion)
    if steps is not None:
        back = motion.time is None and motion.driver is not None and (
            motion.driver[k + 1] < motion.driver[k])
        return float(steps[k]), -v if back else v, a
    size = motion.mechanism.velocity_scale
    pace = np.sqrt(((v / size) ** 2).sum(axis=1))[:, None]
    if not np.all(pace > 0.0):
        return 0.0, v, a
    t, c = v / size / pace, a / size / pace**2
    c = c - t * np.vecdot(t, c)[:, None]
    moved = pin.difference(motion.mechanism.model, motion.q[k], motion.q[k + 1]) / size
    t = np.where((t @ moved)[:, None] < 0.0, -t, t)  # samples may go backwards
    first, second = 0.5 * (t[0] + t[1]), (c[0] - c[1]) / 12.0
    h = float(np.sqrt(moved @ moved))
    for _ in range(4):
        slope = first + 2.0 * h * second
        if not np.any(slope):  # samples at one place, but for round-off
            return 0.0, v, a
        h -= float((h * first + h * h * second - moved) @ slope / (slope @ slope))
    return h, size * t, size * c


def _quintic(
    q: Array, v: Array, a: Array, h: float
) -> tuple[Callable[[float], float], Callable[[float], float]]:
    """Return value and slope of the quintic through two samples, as functions of the fraction.

    Values q, rates v and accelerations a, each (2,), hold at the ends of a step of length h; 0
    makes a straight line.
    """
    polynomial = np.polynomial.Polynomial(
        quintic(q, h * v, h * h * a) if h else [q[0], q[1] - q[0]])
    return polynomial, polynomial.deriv()


class RatedLimit(NamedTuple):
    """The largest velocity, or effort, of a joint coordinate.

    Attributes:
        kind: "velocity limit" or "effort limit".
        name: of the coordinate.
        v: its place in the velocity.
        value: the limit [rad/s, m/s, N·m or N].
        unit: of that.
    """

    kind: str
    name: str
    v: int
    value: float
    unit: str

    @property
    def words(self) -> str:
        """Its name, as text."""
        return f"{self.kind} {self.value:.9g} {self.unit} of {self.name}"

    def excess(self, values: Array) -> Array:
        """Return the excess of values (...) over the limit, negative within it."""
        return np.abs(values) - self.value * (1.0 + SLACK)


class BeyondLimit(NamedTuple):
    """A velocity or effort that is beyond its limit in some samples of a motion.

    Attributes:
        limit: the exceeded limit.
        samples: (n,) numbers of the samples of the motion that are beyond it, rising.
        worst: number of the sample that is farthest beyond.
        most: the velocity or effort there [rad/s, m/s, N·m or N].

    Example:
        >>> mech = sp.load("excavator")
        >>> motion = sp.sweep(mech, "boom", np.linspace(2.7, 2.9, 21), speed=1.0)  # [m], [m/s]
        >>> beyond = sp.kinetostatics(mech, motion).beyond_limits[0]
        >>> beyond.limit.kind, beyond.limit.name, float(beyond.most)
        ('velocity limit', 'boom_slide', 1.0)
        >>> print(f"{beyond.by:.3f} m/s too fast")
        0.677 m/s too fast
    """

    limit: RatedLimit
    samples: NDArray[np.intp]
    worst: int
    most: float

    @property
    def by(self) -> float:
        """Largest excess over the limit [rad/s, m/s, N·m or N]."""
        return abs(self.most) - self.limit.value

    def text(self, motion: Motion) -> str:
        """Return the same as a sentence.

        Args:
            motion: the motion that it is about.

        Example:
            >>> mech = sp.load("excavator")
            >>> motion = sp.sweep(mech, "boom", np.linspace(2.7, 2.9, 21), speed=1.0)  # [m], [m/s]
            >>> beyond = sp.kinetostatics(mech, motion).beyond_limits[0]
            >>> print(beyond.text(motion).split(",")[0])
            beyond the velocity limit 0.323467685 m/s of boom_slide in 21 of 21 samples
        """
        return (f"beyond the {self.limit.words} in {len(self.samples)} of {len(motion)} samples, "
                f"first {where(motion, int(self.samples[0]))}, by {self.by:.6g} {self.limit.unit} "
                f"at most, {where(motion, self.worst)}")

    def __repr__(self) -> str:
        return brief(self, most=self.limit.unit)


def velocity_limits(mechanism: Mechanism) -> list[RatedLimit]:
    """Return the velocity limits that the URDF states, in the order of the coordinates."""
    return _velocity_limits(mechanism, mechanism.model.upperVelocityLimit.tobytes())


@made_anew  # as anybody may change the numbers
def _velocity_limits(mechanism: Mechanism, numbers: bytes) -> list[RatedLimit]:
    return [RatedLimit(VELOCITY, c.name, c.v, float(x), f"{c.unit}/s")
            for c, x in _stated(mechanism, mechanism.model.upperVelocityLimit)]


def effort_limits(mechanism: Mechanism) -> list[RatedLimit]:
    """Return the effort limits that the URDF states, in the order of the coordinates."""
    return [RatedLimit(EFFORT, c.name, c.v, float(x), EFFORTS[c.unit])
            for c, x in _stated(mechanism, mechanism.model.upperEffortLimit)]


def _stated(mechanism: Mechanism, values: Array) -> list[tuple[Coordinate, float]]:
    table = mechanism.coordinate_table.values()
    return [(c, x) for c, x in zip(table, values.tolist(), strict=True) if 0.0 < x < UNSET]


def beyond(pairs: Iterable[tuple[RatedLimit, Array]]) -> list[BeyondLimit]:
    """Return the limits that velocities or efforts (N,) exceed, with their samples."""
    exceeded = []
    for limit, values in pairs:
        excess = limit.excess(values)
        samples = np.flatnonzero(excess > 0.0)
        if samples.size:
            worst = int(np.argmax(excess))
            exceeded.append(BeyondLimit(limit, samples, worst, float(values[worst])))
    return exceeded


def velocities_beyond(motion: Motion) -> list[BeyondLimit]:
    """Return the velocity limits that a motion exceeds; none if its rates are not in time."""
    if motion.per != "s":
        return []
    return beyond((limit, motion.v[:, limit.v]) for limit in velocity_limits(motion.mechanism))


def curve_end_events(motion: Motion) -> list[Event]:
    """Return an event where each point leaves its curve by an end, in the order of samples.

    Between samples the place is that of a cubic.
    """
    whole = motion.mechanism.whole or motion.mechanism
    on_curves = [c for c in whole.closures if c.numbers.get("curve") is not None]
    if not on_curves or not len(motion):
        return []
    at, what = motion.time, "at {:.9g} s"
    if motion.driver is not None:
        at, what = motion.driver, f"at {motion.driver_name} = {{:.9g}} {motion.driver_unit}"
    events = []
    for closure in on_curves:
        curve = closure.numbers["curve"]
        if curve.is_closed or not np.isfinite(curve.end):
            continue
        s = motion.coordinate(f"{closure.name}.s").value
        for end, room in ((f"{curve.end:.6g} m", curve.end - s), ("0 m", s)):
            for k in onsets(room < -CURVE_SLACK * curve.end):
                value = float(k) if at is None else float(at[0]) if not k else (
                    between_samples(at, room, k))
                where = what.format(value) if at is not None else f"before sample {k}"
                events.append(Event(END_OF_CURVE, value, k, (
                    f"{closure.name} leaves its curve at the end at {end}, "
                    + (where if k else "from the start"))))
    return sorted(events, key=lambda event: event.row)


def limit_events(motion: Motion) -> list[Event]:
    """Return events of joint limits passed, of the first samples too fast, and of curves left."""
    at = motion.time if motion.driver is None else motion.driver
    too_fast = [] if at is None else [
        Event(VELOCITY, float(at[b.samples[0]]), int(b.samples[0]), b.text(motion))
        for b in velocities_beyond(motion)]
    return [*(passing.event for passing in joint_limits_passed(motion)), *too_fast,
            *curve_end_events(motion)]
