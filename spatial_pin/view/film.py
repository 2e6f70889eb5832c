"""What is shown when: the configurations of a motion or state, and the pace they are shown at."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from spatial_pin.kinematics.motion import Motion
    from spatial_pin.kinematics.state import State
    from spatial_pin.mechanism.mechanism import Mechanism

Array = NDArray[np.float64]

SHORTEST, USUAL, LONGEST = 2.0, 6.0, 20.0  # duration of an animation [s]
MAX_ROWS = 1201  # 60 a second for 20 s: more cannot be seen


class Reading(NamedTuple):
    """A number shown beside the picture.

    Attributes:
        name: what it is.
        values: its value in every row, shape (N,), in `unit`.
        unit: "°", " mm", " m" or " s", as it follows the number.
        digits: decimals shown.
    """

    name: str
    values: Array
    unit: str
    digits: int


@dataclass(frozen=True, eq=False)
class Film:
    """A motion, or a state (one row), ready to be shown.

    Attributes:
        mechanism: what moves.
        q: configurations, shape (N, nq).
        seconds: when each is shown, shape (N,), rising from 0 [s].
        readings: numbers shown with each row.
        closure_error: the largest of the whole motion [-].
        notes: how the film differs from the motion ("shown 20x slower").
    """

    mechanism: Mechanism
    q: Array
    seconds: Array
    readings: tuple[Reading, ...]
    closure_error: float
    notes: tuple[str, ...]


def nice(x: float) -> float:
    """Return the number of the series 1, 2, 5, 10, ... that is nearest to x > 0 (by ratio)."""
    decade = 10.0 ** math.floor(math.log10(x))
    return min((f * decade for f in (1.0, 2.0, 5.0, 10.0)), key=lambda f: abs(math.log(x / f)))


def _time_pace(time: Array) -> tuple[Array, str]:
    """Return seconds of the film for times of the motion [s], true where that can be watched."""
    elapsed = time - time[0]
    factor = 1.0
    if not SHORTEST <= elapsed[-1] <= LONGEST:
        factor = nice(USUAL / elapsed[-1])
    if factor == 1.0:
        return elapsed, ""
    much, way = (factor, "slower") if factor > 1 else (1 / factor, "faster")
    return elapsed * factor, f"shown {much:g}x {way}"


def _driver_pace(driver: Array, unit: str) -> tuple[Array, str]:
    """Return seconds of the film at a constant driver speed, one second a radian if watchable."""
    travel = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(driver)))))
    if unit == "rad" and SHORTEST <= travel[-1] <= LONGEST:
        return travel, "shown at 1 rad/s"
    speed = nice(travel[-1] / USUAL)
    words = f"{speed:g} rad/s" if unit == "rad" else f"{1e3 * speed:g} mm/s"
    return travel / speed, f"shown at {words}"


def _pace(motion: Motion) -> tuple[Array, str]:
    """Return when each row is shown [s], and what is to be said about it."""
    n = len(motion.q)
    if n == 1:
        return np.zeros(1), ""
    if motion.time is not None and np.all(np.diff(motion.time) > 0):
        return _time_pace(np.asarray(motion.time, float))
    if motion.driver is not None and np.ptp(motion.driver) > 0:
        return _driver_pace(np.asarray(motion.driver, float), motion.driver_unit)
    return np.linspace(0.0, USUAL, n), f"shown at {(n - 1) / USUAL:.3g} rows a second"


def _reading(name: str, values: Array, unit: str) -> Reading:
    """Return values in rad, m or s as a reading, in a unit that reads well."""
    if unit == "rad":
        return Reading(name, np.rad2deg(values), "°", 1)
    if unit == "m" and np.max(np.abs(values)) < 1.0:
        return Reading(name, 1e3 * values, " mm", 2)
    return Reading(name, values, f" {unit}", 3)


def _readings(motion: Motion) -> tuple[Reading, ...]:
    """Return driver value and time."""
    found = []
    if motion.driver is not None:
        driver = np.asarray(motion.driver, float)
        found.append(_reading(motion.driver_name, driver, motion.driver_unit))
    if motion.time is not None:
        found.append(_reading("time", np.asarray(motion.time, float), "s"))
    return tuple(found)


def _of_state(state: State) -> Film:
    """Return the film of one row, with the values of its drivers."""
    mechanism = state.mechanism
    readings = tuple(
        _reading(name, np.atleast_1d(state.coordinate(name)[0]), mechanism.coordinate(name).unit)
        for name in mechanism.drivers
    )
    q = np.asarray(state.q, float)[None]
    return Film(mechanism, q, np.zeros(1), readings, float(state.closure_error), ())


def _thinned(film: Film) -> Film:
    """Return the film with at most MAX_ROWS rows, first and last kept."""
    n = len(film.q)
    if n <= MAX_ROWS:
        return film
    kept = np.unique(np.round(np.linspace(0, n - 1, MAX_ROWS)).astype(int))
    readings = tuple(r._replace(values=r.values[kept]) for r in film.readings)
    notes = (*film.notes, f"{len(kept)} of {n} rows")
    q, seconds = film.q[kept], film.seconds[kept]
    return Film(film.mechanism, q, seconds, readings, film.closure_error, notes)


def film(motion_or_state: Motion | State) -> Film:
    """Return what to show of a Motion or State, and when.

    A motion with times that lasts 2 to 20 s is shown at true time, otherwise slower or faster by a
    round factor. One without times is shown at one second a radian of its driver, or at another
    round driver speed when that would not last 2 to 20 s. `Film.notes` says which.
    """
    if np.ndim(motion_or_state.q) == 1:
        return _of_state(motion_or_state)  # type: ignore[arg-type]
    motion: Motion = motion_or_state  # type: ignore[assignment]
    if len(motion.q) == 0:
        raise ValueError("the motion has no rows: there is nothing to show")
    seconds, note = _pace(motion)
    error = float(np.max(motion.closure_error))
    q, notes = np.asarray(motion.q, float), (note,) if note else ()
    return _thinned(Film(motion.mechanism, q, seconds, _readings(motion), error, notes))
