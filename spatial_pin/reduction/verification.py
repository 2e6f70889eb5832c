"""Comparison of a full and a reduced mechanism in sweeps."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from spatial_pin._support.brief import counted
from spatial_pin._support.checks import as_array
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.forward import forward_dynamics
from spatial_pin.dynamics.kinetostatics import kinetostatics
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.outputs import is_force
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.reduction.influence import RequestedOutputs, requested_outputs
from spatial_pin.reduction.reduce import Difference, Reduced, Verification

VALUES = 361  # default number of driver values: a degree apart over a turn
LIMIT_MARGIN = 0.05  # part of a driver's range left out near a limit, where rates are infinite
# largest range of a slide in each direction, relative to the characteristic length
LONGEST_SLIDE = 0.5
# Samples for forward dynamics: a missing part shows at any of them, and each costs two calls.
DYNAMIC_SAMPLES = 5
FIRST_VALUES_APART = 1e-6  # difference of outputs at the first value of two branches
EVENTS = ("limit", "singular", "branch point", "lost")


def verification(
    reduced: Reduced, driver: str | None, values: Any, speed: float, acceleration: float,
    guess: Mapping[str, Any] | None, hold: Mapping[str, float],
) -> Verification:
    """Compare the outputs of a reduced mechanism and of the full one; see `Reduced.verify`."""
    full = reduced.full
    requested = requested_outputs(full, reduced.outputs, reduced.dynamics)
    names = [driver] if driver is not None else _drivers(reduced, full)
    if values is not None and not np.size(values := np.atleast_1d(as_array(values, "values"))):
        raise ValueError("values is empty; one driver value at least is compared")
    if np.ndim(values) > 1:
        raise ValueError(f"values has shape {np.shape(values)}; (N,) is needed")
    differences: list[Difference] = []
    remarks: list[str] = []
    compared: list[str] = []
    rows, seconds = 0, np.zeros(2)
    hold = {full.driven_coordinate(name).name: value for name, value in hold.items()}
    for name in names:
        driver_values = (values if values is not None
                        else _default_values(full, reduced, name, guess, hold))
        pair = []
        for k, mechanism in enumerate((full, reduced)):
            held = _held(mechanism, full, reduced, name, hold, driver_values, guess)
            run = partial(_as_far, mechanism, name, driver_values, speed, acceleration, guess,
                          held)
            pair.append(run())  # the first sweep of a mechanism prepares it: the next is timed
            start = time.perf_counter()
            run()
            seconds[k] += time.perf_counter() - start
        if guess is not None and _begin_apart(pair, requested):
            remarks.append(
                f"the guess leads the two to different branches at {name} = "
                f"{pair[0].swept[0]:.6g} {pair[0].driver_unit}: what tells them apart is left out; "
                "compared is the branch of the full one (give sweeps of the reduced one "
                "guess=reduced.state(full_state))")
            pair[1] = _as_far(reduced, name, driver_values, speed, acceleration,
                              reduced.state(pair[0].state(0)), held)
        count = min(map(len, pair))
        rows += count
        remarks += _remarks(pair[0], pair[1], name, np.size(driver_values))
        if count:
            swept = pair[0].swept[:count]
            compared.append(f"{counted(count, 'row')} over {name} from {swept.min():.6g} to "
                            f"{swept.max():.6g} {pair[0].driver_unit}")
            differences += [_difference(output, name, a, b) for (output, a), (_, b) in zip(
                *(_outputs(motion, requested, count) for motion in pair), strict=True)]
            if reduced.dynamics:
                differences += _dynamics(reduced, pair, requested, count)
    if not differences:
        raise SpatialPinError(f"mechanism {full.name!r}: no sample could be compared")
    return Verification(tuple(differences), rows, float(seconds[0]), float(seconds[1]),
                        tuple(remarks), tuple(compared))


def _as_far(
    mechanism: Mechanism, driver: str, values: Array, speed: float, acceleration: float,
    guess: Any, hold: Mapping[str, float],
) -> Motion:
    """Return the motion through values, as far as it can be followed."""
    try:
        return sweep(mechanism, driver, values, speed, acceleration, guess=guess, hold=hold,
                     on_limit="stop", on_crossing="stop")
    except SpatialPinError as error:
        motion: Motion | None = getattr(error, "motion", None)
        if motion is None or not len(motion):
            raise
        return motion


def _begin_apart(pair: Sequence[Motion], requested: RequestedOutputs) -> bool:
    """Whether positions of the outputs differ where two motions begin."""
    if not all(map(len, pair)):
        return False
    return any(np.abs(x - y).max() > FIRST_VALUES_APART
               for (_, a), (_, b) in zip(*(_outputs(motion, requested, 1) for motion in pair),
                                         strict=True)
               for x, y in zip(a[0], b[0], strict=True))


def _drivers(reduced: Reduced, full: Mechanism) -> list[str]:
    if reduced.drivers:
        return list(reduced.drivers)
    for c in reduced.coordinate_table.values():
        if c.q >= 0:
            return [c.name]
    raise SpatialPinError(f"mechanism {full.name!r}: nothing to drive: no coordinate is left")


def _default_values(
    full: Mechanism, reduced: Reduced, driver: str, guess: Mapping[str, Any] | None,
    hold: Mapping[str, float],
) -> Array:
    """Return values over the driver's range, in the order of a motion over all of it.

    The first is the nearest to the guess: at an end of the range other branches may be near, and
    the full and the reduced mechanism could start on different ones.
    """
    coordinate = full.driven_coordinate(driver)
    state = assembled(full, dict(reduced.welds) | dict(hold), guess)
    at = state.coordinate(coordinate.name).value
    room = 2.0 * np.pi if coordinate.unit == "rad" else LONGEST_SLIDE * full.characteristic_length
    hold = _held(full, full, reduced, driver, hold, np.array([at]), guess)
    ends = [_end(full, driver, state, hold, at, sense * room) for sense in (1.0, -1.0)]
    if ends[0] == at + room:
        return np.linspace(at, at + room, VALUES)
    margin = LIMIT_MARGIN * (ends[0] - ends[1])
    values = np.linspace(ends[1] + margin, ends[0] - margin, VALUES)
    first = int(np.abs(values - at).argmin())
    return np.append(values[first:], values[:first][::-1])


def _end(
    full: Mechanism, driver: str, state: State, hold: Mapping[str, float], at: float, room: float
) -> float:
    """Return the end of the driver's motion, at most `room` away."""
    motion = _as_far(full, driver, np.linspace(at, at + room, VALUES), float(np.sign(room)), 0.0,
                    state, hold)
    stops = [e for e in motion.events if e.kind in EVENTS]
    if len(motion) == VALUES:
        return at + room
    return float(motion.swept[-1]) if stops[-1].kind == "lost" else stops[-1].value


def _held(
    mechanism: Mechanism, full: Mechanism, reduced: Reduced, driver: str,
    hold: Mapping[str, float], values: Array, guess: Mapping[str, Any] | None,
) -> dict[str, float]:
    """Return the fixed values of a sweep: equal drivers, and the welded ones in the full one."""
    welded = dict(reduced.welds)
    first = {driver: float(np.atleast_1d(values)[0])}
    there = assembled(full, {**welded, **hold, **first}, guess)
    coordinate = full.driven_coordinate(driver).name
    others = {d.joint: there.coordinate(d.joint).value for d in reduced.drivers.values()
              if d.joint != coordinate}
    return {**others, **(welded if mechanism is full else {}), **hold}


def _remarks(full: Motion, reduced: Motion, driver: str, count: int) -> Iterator[str]:
    ends = [[e for e in m.events if e.kind in EVENTS] for m in (full, reduced)]
    for who, motion, other, events in (("full", full, reduced, ends[0]),
                                       ("reduced", reduced, full, ends[1])):
        if len(motion) < len(other):
            yield (f"over {driver} the {who} model ends after {len(motion)} of "
                   f"{len(other)} rows: {events[-1].text if events else 'no reason known'}")
    if len(full) == len(reduced) < count:
        yield (f"over {driver} both end after {len(full)} of {count} rows: "
               f"{ends[0][-1].text if ends[0] else 'no reason known'}")


def _outputs(
    motion: Motion, requested: RequestedOutputs, count: int
) -> Iterator[tuple[str, tuple[list[Array], ...]]]:
    """Yield name, and positions, rates and accelerations, angles and lengths apart."""
    size = motion.mechanism.characteristic_length
    for name in requested.coordinates:
        unit = 1.0 if motion.mechanism.coordinate(name).unit == "rad" else size
        yield name, tuple([x[:count] / unit] for x in motion.coordinate(name))
    centres = {f"{name}.com": motion.com(name) for name in requested.centres}
    for name, moving in ({name: motion.frame(name) for name in requested.frames} | centres).items():
        yield name, (
            [moving.position[:count] / size, moving.rotation[:count]],
            [moving.velocity[:count] / size, moving.angular_velocity[:count]],
            [moving.acceleration[:count] / size, moving.angular_acceleration[:count]])


def _dynamics(
    reduced: Reduced, pair: Sequence[Motion], requested: RequestedOutputs, count: int
) -> Iterator[Difference]:
    """Yield differences of accelerations from forces alone, and of requested efforts and powers."""
    full, size = pair[0].mechanism, pair[0].mechanism.characteristic_length
    worst: dict[str, float] = {}
    for row in np.linspace(0, len(pair[0]) - 1, DYNAMIC_SAMPLES, dtype=int):
        states = [pair[0].state(row)]
        states.append(reduced.state(states[0]))
        accelerated = [forward_dynamics(m, s).state
                       for m, s in zip((full, reduced), states, strict=True)]
        for name in requested.coordinates:
            unit = 1.0 if full.coordinate(name).unit == "rad" else size
            a, b = (s.coordinate(name).acceleration / unit for s in accelerated)
            worst[name] = max(worst.get(name, 0.0), abs(a - b) / max(1.0, abs(a)))
        for name in requested.frames:
            a, b = (s.acceleration(name).vector / np.repeat([size, 1.0], 3) for s in accelerated)
            gap = float(np.abs(a - b).max()) / max(1.0, float(np.abs(a).max()))
            worst[name] = max(worst.get(name, 0.0), gap)
    for name, gap in worst.items():
        yield Difference(name, "forward dynamics", 0.0, 0.0, gap)
    names = [name for name in reduced.outputs if is_force(name)]
    loads = [kinetostatics(motion.mechanism, motion) for motion in pair] if names else []
    for name in names:
        first, second = (table.output(name).values[:count] for table in loads)
        largest = max(float(np.abs(first).max()), np.finfo(float).tiny)
        gap = float(np.abs(first - second).max()) / largest
        yield Difference(name, "kinetostatics", 0.0, 0.0, gap)


def _difference(
    output: str, driver: str, a: tuple[list[Array], ...], b: tuple[list[Array], ...]
) -> Difference:
    worst = []
    for order, (first, second) in enumerate(zip(a, b, strict=True)):
        size = max([1.0, *(float(np.abs(x).max()) for x in first)]) if order else 1.0
        worst.append(max(float(np.abs(x - y).max()) / size
                         for x, y in zip(first, second, strict=True)))
    return Difference(output, driver, *worst)
