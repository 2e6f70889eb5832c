"""A film: the configurations of a motion or state, each with its moment."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

if TYPE_CHECKING:
    from spatial_pin.assembly.state import State
    from spatial_pin.dynamics.kinetostatics import Kinetostatics
    from spatial_pin.mechanism.mechanism import Mechanism


SHORTEST_FILM, USUAL_FILM, LONGEST_FILM = 2.0, 6.0, 20.0  # duration of an animation [s]
LENGTHS = ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"))
MAX_ROWS = 1201  # 60 a second for 20 s: more cannot be seen


class Readout(NamedTuple):
    """A number shown beside the picture."""

    name: str  # of the number
    values: Array  # its value in every sample, shape (N,), in `unit`
    unit: str  # "°", " mm", " m" or " s", as it follows the number
    digits: int  # decimals shown
    says: str = " = "  # text between name and number

    def text(self, row: int) -> str:
        """Return it in words, at one sample."""
        value = f"{self.values[row]:.{self.digits}f}".replace("-", "−")
        return f"{self.name}{self.says}{value}{self.unit}"


@dataclass(frozen=True, eq=False)
class Film:
    """A motion, or a state (one sample), ready to be shown."""

    mechanism: Mechanism  # what moves
    q: Array  # configurations, shape (N, nq)
    seconds: Array  # when each is shown, shape (N,), rising from 0 [s]
    readings: tuple[Readout, ...]  # numbers shown with each sample
    closure_error: float  # the largest of the whole motion [-]
    notes: tuple[str, ...]  # how the film differs from the motion ("shown 20x slower")
    source: Motion | State  # the Motion or State
    rows: NDArray[np.intp]  # which of its samples are shown, shape (N,)
    # limits, singular configurations and branch points that are passed: each its moment `seconds`,
    # its `kind`, and a sentence, `text`
    marks: tuple[dict[str, Any], ...] = ()

    @cached_property
    def open_rows(self) -> NDArray[np.intp]:
        """Which of the samples shown have an open closure."""
        error = np.atleast_1d(self.source.closure_error)[self.rows]
        return np.flatnonzero(error > TOLERANCES.half_precision)

    @cached_property
    def loads(self) -> Kinetostatics:
        """Efforts and reactions of the samples shown.

        Raises:
            SpatialPinError: see `loads`.
        """
        return loads(self.source, self.motion)

    @cached_property
    def motion(self) -> Motion:
        """The samples shown, with their rates."""
        whole, rows = as_motion(self.source), self.rows
        if len(rows) == len(whole):
            return whole
        sampled = {f.name: _some(getattr(whole, f.name), rows, len(whole)) for f in fields(whole)
                   if f.name != "events"}
        return replace(whole, **sampled, events=[])


def loads(shown: Motion | State, motion: Motion) -> Kinetostatics:
    """Return efforts and reactions with which the drivers bring a motion about."""
    from spatial_pin.dynamics.kinetostatics import kinetostatics  # on use: few films show forces
    from spatial_pin.dynamics.simulation.simulate import Simulation

    if isinstance(shown, Simulation) and not shown.by_drivers:
        raise SpatialPinError(
            f"mechanism {motion.mechanism.name!r}: efforts elsewhere than at its drivers, laws "
            "of springs, or a slip speed of its own acted in this simulation: use `kinetostatics` "
            "with `actuated`, `laws` and `slip_speed`"
        )
    return kinetostatics(motion.mechanism, motion)


def _some(x: Any, rows: NDArray[np.intp], n: int) -> Any:
    """Return those samples of a field of a motion of n samples; other fields as they are."""
    if isinstance(x, np.ndarray):
        return x[rows] if len(x) == n else x
    if isinstance(x, dict):  # efforts by driver
        some = copy(x)
        some.update({name: _some(values, rows, n) for name, values in x.items()})
        return some
    return x


def as_motion(source: Motion | State) -> Motion:
    """Return a state as a motion of one sample that has no driver; a motion as it is."""
    if np.ndim(source.q) == 2:
        return source  # type: ignore[return-value]
    s, still = source, np.zeros(1)
    q, v, a, error, angles = (np.atleast_2d(x) for x in (s.q, s.v, s.a, s.closure_error, s.angles))
    return Motion(s.mechanism, still, "", None, q, v, a, error[0], still, [], angles)


def unit_of_length(x: float) -> tuple[float, str]:
    """Return (size [m], name) of the unit in which a length x [m] reads well."""
    return next((unit for unit in LENGTHS if abs(x) >= unit[0]), LENGTHS[-1])


def length_words(x: float) -> str:
    """Return a length x [m] with its unit."""
    size, unit = unit_of_length(x)
    return f"{x / size:.4g} {unit}"


def nice(x: float) -> float:
    """Return the number of the series 1, 2, 5, 10, ... that is nearest to x > 0 (by ratio)."""
    decade = 10.0 ** math.floor(math.log10(x))
    return min((f * decade for f in (1.0, 2.0, 5.0, 10.0)), key=lambda f: abs(math.log(x / f)))


def _pace(motion: Motion) -> tuple[Array, str]:
    """Return the moment of each sample [s], and a note about the pace."""
    n = len(motion.q)
    if n == 1:
        return np.zeros(1), ""
    if motion.time is not None and np.all(np.diff(motion.time) > 0):
        elapsed = np.asarray(motion.time, float) - motion.time[0]
        factor = 1.0  # true where that can be watched
        if not SHORTEST_FILM <= elapsed[-1] <= LONGEST_FILM:
            factor = nice(USUAL_FILM / elapsed[-1])
        if factor == 1.0:
            return elapsed, ""
        much, word = (factor, "slower") if factor > 1 else (1 / factor, "faster")
        return elapsed * factor, f"shown {much:g}x {word}"
    if motion.driver is not None and np.ptp(motion.driver) > 0:
        steps = np.abs(np.diff(np.asarray(motion.driver, float)))
        travel, unit = np.concatenate(([0.0], np.cumsum(steps))), motion.driver_unit
        if unit == "rad" and SHORTEST_FILM <= travel[-1] <= LONGEST_FILM:
            return travel, "shown at 1 rad/s"  # one second a radian
        speed = nice(travel[-1] / USUAL_FILM)
        words = f"{speed:g} rad/s" if unit == "rad" else f"{1e3 * speed:g} mm/s"
        return travel / speed, f"shown at {words}"
    return np.linspace(0.0, USUAL_FILM, n), f"shown at {(n - 1) / USUAL_FILM:.3g} samples a second"


def reading(name: str, values: Array, unit: str) -> Readout:
    """Return values in rad, m or s as a reading, in a unit that reads well."""
    if unit == "rad":
        return Readout(name, np.rad2deg(values), "°", 1)
    largest = float(np.max(np.abs(values)))
    if unit == "m" and 0.0 < largest < 1.0:
        size, unit = unit_of_length(largest)
        return Readout(name, values / size, f" {unit}", 2)
    return Readout(name, values, f" {unit}", 3)


def driver_readings(state: State) -> tuple[Readout, ...]:
    """Return the values of the drivers of a state, one row each."""
    mechanism = state.mechanism
    return tuple(
        reading(name, np.atleast_1d(state.coordinate(name)[0]), mechanism.coordinate(name).unit)
        for name in mechanism.drivers
    )


def not_shown(given: object) -> str:
    """Return the message about an object that is neither a Motion nor a State."""
    kind = type(given).__name__
    remedy = "sp.assemble(mechanism) or sp.sweep(mechanism, driver, values)"
    return f"a {kind} cannot be shown; give a State or a Motion: {remedy}"


def is_monotonic(values: Array) -> bool:
    """Return whether values rise, or fall, all the time."""
    steps = np.diff(values)
    return bool(np.all(steps > 0) or np.all(steps < 0))


def moments(shown: Film, other: Film) -> tuple[Array, NDArray[np.intp], str]:
    """Return when samples of another motion are shown with a film.

    They are where both have the same time, else the same driver value; else both begin and end
    together. Return seconds (K,), rising, samples of the other (K,), and how in words.
    """
    one, two = shown.motion, other.motion
    x, y, words = _ends(one, two)
    if one.time is not None and two.time is not None:
        if is_monotonic(one.time) and is_monotonic(two.time):
            x, y, words = one.time, two.time, "at the same times"
    elif one.driver_name == two.driver_name and one.driver is not None and is_monotonic(
            one.driver) and two.driver is not None and is_monotonic(two.driver):
        x, y, words = one.driver, two.driver, f"at the same {one.driver_name}"
    rising = np.argsort(x)
    inside = np.flatnonzero((y >= x.min()) & (y <= x.max()))
    if not len(inside):
        x, y, words = _ends(one, two)
        rising, inside = np.arange(len(x)), np.arange(len(y))
    seconds = np.interp(y[inside], x[rising], shown.seconds[rising])
    order = np.argsort(seconds)
    return seconds[order], inside[order], words


def _ends(one: Motion, other: Motion) -> tuple[Array, Array, str]:
    parts = [np.linspace(0.0, 1.0, len(x)) for x in (one, other)]
    return parts[0], parts[1], "from beginning to end"


def film(motion_or_state: Motion | State) -> Film:
    """Return the film of a Motion or State.

    A motion with times that lasts 2 to 20 s is shown at true time, otherwise slower or faster by a
    round factor. One without times is shown at one second a radian of its driver, or at another
    round driver speed when that would not last 2 to 20 s. `Film.notes` names it.
    """
    if not hasattr(motion_or_state, "q"):
        raise SpatialPinError(not_shown(motion_or_state))
    if np.ndim(motion_or_state.q) == 1:
        state: State = motion_or_state  # type: ignore[assignment]
        q, now = np.asarray(state.q, float)[None], np.zeros(1)
        error, rows = float(state.closure_error), np.zeros(1, dtype=np.intp)
        return Film(state.mechanism, q, now, driver_readings(state), error, (), state, rows)
    motion: Motion = motion_or_state  # type: ignore[assignment]
    if len(motion.q) == 0:
        raise ValueError("the motion has no samples: there is nothing to show")
    seconds, note = _pace(motion)
    error = float(np.max(motion.closure_error))
    q, notes = np.asarray(motion.q, float), (note,) if note else ()
    n, rows = len(q), np.arange(len(q))
    readings: tuple[Readout, ...] = ()
    if motion.driver is not None:
        driver = np.asarray(motion.driver, float)
        readings = (reading(motion.driver_name, driver, motion.driver_unit),)
    if motion.time is not None:
        readings = (*readings, reading("time", np.asarray(motion.time, float), "s"))
    marks = list[dict[str, Any]]()
    for event in motion.events:  # between samples, in proportion to the driver
        after = min(event.row, len(seconds) - 1)
        before = max(after - 1, 0)
        part = 1.0
        if motion.driver is not None and (step := motion.driver[after] - motion.driver[before]):
            part = np.clip((event.value - motion.driver[before]) / step, 0.0, 1.0)
        moment = seconds[before] + part * (seconds[after] - seconds[before])
        marks.append({"seconds": float(moment), "kind": event.kind, "text": event.text})
    if n > MAX_ROWS:  # first and last included
        rows = np.unique(np.round(np.linspace(0, n - 1, MAX_ROWS)).astype(int))
        readings = tuple(r._replace(values=r.values[rows]) for r in readings)
        notes = (*notes, f"{len(rows)} of {n} rows")
        q, seconds = q[rows], seconds[rows]
    return Film(motion.mechanism, q, seconds, readings, error, notes, motion, rows,
                tuple(marks))
