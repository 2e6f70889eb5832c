"""Following one branch of a closed mechanism through a list of driver values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from spatial_pin._support.checks import (
    FEW,
    as_array,
    checked,
    finite_array,
    finite_number,
    is_finite,
)
from spatial_pin._support.columns import read_only
from spatial_pin._support.lazy import Workspaces, made_once
from spatial_pin._support.progress import progress_bar
from spatial_pin.assembly.assemble import assembly_problem, held_start, held_values, solved
from spatial_pin.assembly.close import NOTHING
from spatial_pin.assembly.holding import BASE, Hold, hold_names
from spatial_pin.assembly.redundant_equations import gap_allowed
from spatial_pin.assembly.state import State
from spatial_pin.continuation.asymptotes import BEYOND_LINKS
from spatial_pin.continuation.path_following import (
    Followed,
    both_ways_order,
    chunk_of,
    followed,
    followed_both_ways,
)
from spatial_pin.continuation.path_tracker import FARTHEST, PathTracker
from spatial_pin.continuation.pseudo_arclength import Stopped
from spatial_pin.errors import Interrupted, LimitError, SingularError, SpatialPinError
from spatial_pin.mechanism.coordinates import (
    coordinate_value,
    driver_coordinates,
    require_mechanism,
)
from spatial_pin.mechanism.extent import unlike_links
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.motion.limit_events import limit_events
from spatial_pin.motion.motion import UNRESOLVED, Event, Motion, made, steady_times
from spatial_pin.motion.rounding import CHOICES, independent_on, within_gap
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.depending import part_moving_with
from spatial_pin.rates.rates import SOLUTION_ERROR, check_finite, check_not_held
from spatial_pin.settings import Accuracy, accuracy_of

# Near a limit a joint is this much faster than the driver, and than its own lowest speed: at a
# distance d it is 1 / sqrt(d) times faster, so d is 1e-5 of the range.
FAST = 300.0
ENDS = ("limit", "half turn", "runs away")  # kinds of ends beyond which there is nothing
# Largest speed of a driver: rates of a regular path stay finite, times its square too.
FASTEST_DRIVER = 1e50
# Closure error above which a sweep with a fixed number of corrections warns: 0.1 % of the size is
# visible.
DRIFTED = 1e-3


@checked
def sweep(
    mechanism: Mechanism,
    driver: str,
    values: Any,
    speed: Any = None,
    acceleration: Any = 0.0,
    *,
    guess: Mapping[str, Any] | State | Array | None = None,
    hold: Mapping[str, float] | Hold = BASE,
    on_limit: str = "raise",
    on_crossing: str = "straight",
    accuracy: Accuracy | None = None,
    progress: bool = False,
) -> Motion:
    """Follow one branch of a mechanism through a list of driver values.

    The first value is assembled. The rest are followed with a Taylor predictor and a Newton
    corrector; steps are halved where the branch bends, so that it is never left unnoticed. All
    other drivers keep their values from the guess.

    Args:
        mechanism: the mechanism.
        driver: a driver, or any coordinate of a joint.
        values: (N,) driver values in any order [rad or m].
        speed: the driver's speed at every sample, one number or (N,) [rad/s or m/s]. Without one
            the motion has no time: v and a are derivatives with respect to the driver's value,
            and forces of it (`kinetostatics`, `report`) are statics.
        acceleration: the driver's acceleration, likewise [rad/s² or m/s²]; it needs a speed.
        guess: where to assemble, as for `assemble`.
        hold: what else stands still: {name: value} of other drivers or coordinates [rad or m] (a
            free base then stands still too); or names alone of joints and coordinates, to hold
            them where a State as guess has them, else where they are assembled. "base" is a free
            base (a floating joint that alone carries a whole machine), "springs" the joints that
            springs act about, "NAME.rotation" and "NAME.translation" parts of a floating joint.
            None: nothing. A "released" event names drivers, and coordinates held by name, that
            the loops do not let stand there.
        on_limit: where a value cannot be reached: "raise" a LimitError, or "stop", which ends the
            motion before it, with an event.
        on_crossing: where branches cross (a change point): "straight" follows the one that goes
            straight on, "stop" ends the motion before it, both with an event; or "raise".
            Crossings nearer to each other than about 2e-5 rad are one event.
        accuracy: predictor order, corrections and tolerance; default "engineering".
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The Motion, one sample per value. Joint limits that are passed are events, located exactly
        however far samples are apart. A joint that passes a limit and comes back between two
        samples, with rates of the same sign at both, is missed.

    Raises:
        AssemblyError: the first value cannot be assembled.
        LimitError: a later value cannot be reached, or opens redundant equations of a rounded file
            beyond the gap; has the limit and the motion so far.
        SingularError: the branch is not determined at a configuration, or crosses another one
            where that is not allowed, or where none goes straight on.
        Interrupted: after Ctrl-C; has the motion until then. There is none if the values go to and
            fro, because these are followed in another order.
        SpatialPinError: a value is more than 640 000 rad or characteristic lengths, of the joint
            that moves most, away from the sample before.
        UnknownNameError: a name does not exist.
        ValueError: values are one number instead of a list, or values or speeds are not finite, or
            make rates that are not, or there is an acceleration without a speed.

    Example:
        >>> mech = sp.load("rssr")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 2.0 * np.pi, 361), speed=25.0)
        >>> angle, rate, acceleration = motion.coordinate("rocker_pin")  # (361,) each
        >>> print(f"{angle.min():.4f} to {angle.max():.4f} rad, up to {rate.max():.2f} rad/s")
        1.2329 to 2.0234 rad, up to 10.66 rad/s
        >>> print(motion.closure_error.max() < 1e-13)
        True
    """
    accuracy = accuracy_of(accuracy)
    require_mechanism(mechanism)
    check_choice("on_limit", on_limit, ("raise", "stop"))
    check_choice("on_crossing", on_crossing, ("straight", "stop", "raise"))
    values = _values(mechanism, driver, values, speed)
    speeds, accels = _requested_rates(speed, acceleration, values)
    coordinate = mechanism.prescribed_coordinate(driver)
    given: Mapping[str, float] = hold if isinstance(hold, Mapping) else {}
    held = (BASE,) if isinstance(hold, Mapping) else hold_names(hold)
    requested, rates, good = values, (speeds, accels), None
    for _ in range(CHOICES):
        mechanism, result, still, events = _followed(
            mechanism, driver, coordinate, requested, guess, given, held, accuracy,
            on_crossing == "straight", progress)
        n, stop = result.done, result.stop
        values, (speeds, accels) = requested, rates
        if n < len(requested):
            values, speeds = requested[:n], speeds[:n]
            accels = None if accels is None else accels[:n]
        motion = _motion(mechanism, result, driver, values, speeds, type(speed) is float, accels,
                         coordinate.unit if speed is None else "s", still, events)
        if mechanism.whole is None or not n:
            break
        onward = (requested.item(n) if n < len(requested) else values.item(0)) - values.item(-1)
        chosen, good = independent_on(motion, accuracy, math.copysign(1.0, onward) *
                                      result.samples.t[n - 1], None if stop is None else stop.q)
        if chosen is mechanism:
            break
        mechanism = chosen
    motion = within_gap(motion, accuracy, on_limit, good)
    if len(motion) < n or good is not None:
        return motion
    if result.is_cut:
        raise Interrupted(motion)
    if stop is not None:
        motion.events.append(stop_event(stop, n, f"{driver} = {stop.value:.12g} {coordinate.unit}",
                                        "limit position"))
        ends = on_limit if stop.kind in ENDS else on_crossing
        if ends != "stop" or stop.kind == "lost":
            raise _error(motion, stop, driver, coordinate, requested.item(n), on_crossing)
    return motion


def _values(mechanism: Mechanism, driver: str, given: Any, speed: Any) -> Array:
    """Return driver values (N,), as they were given.

    Raises:
        ValueError: they are none, or one number that is no list.
    """
    values = as_array(given, "values")
    if not values.size:
        raise ValueError("values is empty; a sweep needs at least one driver value")
    if not values.ndim:
        first = finite_number(values, "values")
        last = speed if isinstance(speed, int | float) and speed != first else first + (
            math.tau if mechanism.prescribed_coordinate(driver).unit == "rad" else 0.1)
        raise ValueError(
            f"values is {first:g}: a sweep goes through a list of values, such as sp.sweep("
            f"mechanism, {driver!r}, np.linspace({first:g}, {last:g}, 101)); one position is "
            f"sp.assemble(mechanism, {{{driver!r}: {first:g}}})")
    if values.ndim > 1 or not is_finite(values):
        values = finite_array(values, (values.size,), "values")  # refuses in words
    return values


def _followed(
    mechanism: Mechanism, driver: str, coordinate: Coordinate, values: Array, guess: Any,
    given: Mapping[str, float], held: tuple[str, ...], accuracy: Accuracy, passes: bool,
    progress: bool,
) -> tuple[Mechanism, Followed, tuple[str, ...], list[Event]]:
    """Return the samples of a sweep, up to the end of the branch.

    Returns:
        The mechanism, without the equations that a rounded file contradicts; the samples; what
        stands still; and events of drivers released at the first value, and of branch points.
    """
    names, n, problem = (driver, *given), len(values), None
    first, tolerance = {coordinate.name: values.item(0)}, min(accuracy.tolerance, TOLERANCES.tight)
    ways = both_ways_order(values) if accuracy.corrections is None else None
    with Workspaces() as workspaces:
        if not isinstance(guess, State) or held in ((), (BASE,)):
            first = held_values(mechanism, {**given, **first}) if given else first
            problem = assembly_problem(
                mechanism, first, guess, tolerance, gap_allowed(mechanism, accuracy))
            judged = ways is not None or problem.with_turns() is not None
            started = None if judged or not problem.is_for_kernel() else (
                PathTracker.from_guess(problem, names, held, accuracy, workspaces,
                                       values[: chunk_of(mechanism)], n))
            if started is not None:
                tracker, samples, done = started
                result = Followed(samples, n)
                if done < n:
                    with progress_bar(n, f"{mechanism.name}: {driver}", progress) as bar:
                        result = followed(tracker, values, samples, passes, bar, done)
                return problem.mechanism, result, held, _events(tracker, result, driver, values)
        check_not_held(mechanism, [coordinate], held)
        state, gone = (solved(problem), list[str]()) if problem is not None else held_start(
            mechanism, {**given, **first}, guess, held, replace(accuracy, tolerance=tolerance))
        moved = part_moving_with(state, names, held)
        with progress_bar(n, f"{mechanism.name}: {driver}", progress) as bar:
            tracker = PathTracker.along(moved.state, names, moved.hold, accuracy, workspaces)
            both = None if ways is None else followed_both_ways(tracker, values, ways, bar)
            result = followed(tracker, values, tracker.room_for(n), passes, bar) if (
                both is None) else both
    events = _events(tracker, result, driver, values, state.released, gone)
    result = result._replace(samples=moved.of_whole(result.samples))
    return state.mechanism, result, moved.held, events


def _events(
    tracker: PathTracker, result: Followed, driver: str, values: Array,
    released: Mapping[str, float] = NOTHING, gone: Iterable[str] = (),
) -> list[Event]:
    """Return events for drivers that are not at their guess, or move.

    A coordinate that moves the only freedoms there are moves the drivers: that is no event. And of
    branch points that were passed. `gone` are sentences on held coordinates that do not stand where
    the guess has them.
    """
    moving, texts = tracker.moving_drivers, [*gone]
    if not (moving or released or texts or result.crossed):
        return []
    if moving or released:
        drivers = driver_coordinates(tracker.mechanism)
        if len(moving) < len(drivers):
            texts += [f"driver {name} is released: it stands {by:+.9g} {drivers[name].unit} from "
                      "where the guess has it, as the loops would not close otherwise"
                      for name, by in released.items() if name not in moving]
            texts += [f"driver {name} is released: it moves, as the loops do not let it stand"
                      for name in sorted(moving)]
    events = [Event("released", values.item(0), 0, text) for text in texts]
    if result.crossed:
        unit = tracker.mechanism.prescribed_coordinate(driver).unit
        events += [crossed_event(value, row, f"{driver} = {value:.12g} {unit}")
                   for value, row in result.crossed]
    return events


def check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """Refuse a word that is not in a list.

    Raises:
        ValueError: it is none.
    """
    if value not in choices:
        raise ValueError(f"{name} is {value!r}; it is one of {', '.join(map(repr, choices))}")


def _requested_rates(speed: Any, acceleration: Any, values: Array) -> tuple[Array, Array | None]:
    """Return the driver's speeds and accelerations (N,); None where these are zero."""
    speeds = _per_sample(1.0 if speed is None else speed, values, "speed")
    if type(acceleration) is float and acceleration == 0.0:
        return speeds, None
    accels = _per_sample(acceleration, values, "acceleration")
    if not accels.any():
        return speeds, None
    if speed is None:
        raise ValueError("an acceleration is given but no speed: give both (speed=0.0 at rest)")
    return speeds, accels


def _per_sample(value: Any, values: Array, what: str) -> Array:
    """Return one number, or one for every sample, as (N,)."""
    numbers = value if type(value) is float else as_array(value, what)
    if isinstance(numbers, np.ndarray) and numbers.ndim:
        return finite_array(numbers, values.shape, what).copy()
    speeds = np.empty(len(values))
    speeds.fill(finite_number(float(numbers), what))
    return speeds


def _motion(
    mechanism: Mechanism, result: Followed, driver: str, values: Array, speeds: Array,
    is_steady: bool, accels: Array | None, per: str, held: tuple[str, ...], events: list[Event],
) -> Motion:
    samples, n = result.samples, result.done
    samples = samples if n == len(samples.q) else samples.between(0, n)
    v, a, led = samples.t, samples.c, speeds[:1] if is_steady else speeds
    if per == "s":
        speed = speeds.item(0) if is_steady and n and accels is None else 0.0
        if 1.0 / FASTEST_DRIVER < abs(speed) < FASTEST_DRIVER:
            v, a = v * speed, a * (speed * speed)
        else:
            v, a = _scaled(v, a, speeds, accels)
            check_finite(v, a, "the speeds and accelerations of the sweep")
    return made(
        mechanism=mechanism, driver=values.copy(), driver_name=driver, q=samples.q, v=v, a=a,
        closure_error=samples.error, driver_speed=speeds, angles=samples.angles, per=per, held=held,
        _clock=lambda motion: None if accels is not None else _times(motion),
        _look=lambda motion: [*events, *_near_limit(motion, samples.t), *_drift(motion),
                              *limit_events(motion)],
        _estimate=lambda motion: scaled_estimates(
            motion, samples.estimate, led if per == "s" else None, accels))


@np.errstate(over="ignore", invalid="ignore")  # what overflows is refused
def _scaled(
    t: Array, c: Array, speeds: Array, accels: Array | None
) -> tuple[Array, Array]:
    """Return rates and accelerations."""
    speed = speeds[:, None]
    a = c * (speed * speed)
    return t * speed, a if accels is None else a + t * accels[:, None]


@np.errstate(over="ignore", invalid="ignore")
def _times(motion: Motion) -> Array | None:
    """Return the times (N,) of a sweep without acceleration; None if its speed changes."""
    speeds, values = motion.driver_speed, motion.swept
    if motion.per != "s" or not len(speeds) or (speeds != speeds[0]).any():
        return None
    time = steady_times(values, speeds.item(0))
    return None if time is None else read_only(time)


def scaled_estimates(
    motion: Motion, estimate: Array, speeds: Array | None = None, accels: Array | None = None
) -> Array:
    """Return error estimates (N, 3) of a motion from those of its derivatives by what leads.

    `estimate` (N, 3) is of q, dq/ds and d²q/ds². Without speeds (N,) or (1,) of what leads, these
    derivatives are the rates.
    """
    scaled = estimate.copy()
    if speeds is not None:
        scaled[:, 1] *= np.abs(speeds)
        scaled[:, 2] *= speeds * speeds
        if accels is not None:
            scaled[:, 2] += estimate[:, 1] * np.abs(accels)
    resolved = motion.mechanism.extent.resolution
    if resolved:
        v, a = (np.abs(x / motion.mechanism.velocity_scale).max(axis=1, initial=0.0)
                for x in (motion.v, motion.a))
        scaled += UNRESOLVED * resolved * np.column_stack([np.ones(len(v)), v, a + v * v])
    return read_only(scaled)


def _near_limit(motion: Motion, t: Array) -> list[Event]:
    """Report samples near a limit position, where joints are so fast that digits are lost."""
    if not len(t):
        return []
    of_driver, slow = _sizes(motion.mechanism, motion.driver_name)
    if max(t.max(initial=0.0), -t.min(initial=0.0)) < slow:
        return []
    paces = np.abs(t / motion.mechanism.velocity_scale) * of_driver
    if paces.max() <= FAST:
        return []
    pace = paces.max(axis=1)
    fast = np.flatnonzero(pace > FAST * max(1.0, pace.min()))
    if not fast.size:
        return []
    row, unit = int(fast[np.argmax(pace[fast])]), motion.driver_unit
    worst, value = float(pace[row]), float(motion.swept[row])
    text = (f"near a limit position at {motion.driver_name} = {value:.12g} {unit}: joints move up "
            f"to {worst:.1e} times as fast as the driver; positions are good to about "
            f"{SOLUTION_ERROR * worst:.0e}, rates to {SOLUTION_ERROR * worst**2:.0e} of their size")
    return [Event("near limit", value, row, text)]


@made_once
def _sizes(mechanism: Mechanism, driver: str) -> tuple[float, float]:
    """Return the driver's size, and the least dq/ds that a fast joint has."""
    sizes = mechanism.velocity_scale
    of_driver = float(sizes[mechanism.coordinate(driver).v])
    return of_driver, FAST * float(sizes.min()) / of_driver


def _drift(motion: Motion) -> list[Event]:
    """Report the first sample that a fixed number of corrections left visibly open."""
    errors = motion.closure_error
    if not (max(errors.tolist(), default=0.0) if len(errors) < FEW else errors.max()) > DRIFTED:
        return []
    row = int(np.argmax(motion.closure_error > DRIFTED))
    value, unit = float(motion.swept[row]), motion.driver_unit
    text = (f"loops open by more than {DRIFTED:g} from {motion.driver_name} = {value:.6g} {unit} "
            "on: too few corrections")
    return [Event("open", value, row, text)]


def crossed_event(value: float, row: int, at: str) -> Event:
    """Return the event of a branch point that was crossed, with its location as text."""
    return Event("branch point", value, row, f"branch point at {at}: branches cross; followed the "
                 "one that goes straight on")


def stop_event(stop: Stopped, row: int, at: str, limit: str) -> Event:
    """Return the event that ended a motion, with its location and the kind of limit as text."""
    words = {"limit": limit, "singular": "singular configuration", "branch point": "branch point",
             "lost": "end of the followed path",
             "half turn": "end of a rotation vector, half a turn,",
             "runs away": f"end of the way, as {stop.runs_away} runs away without end,"}
    kind = "limit" if stop.kind in ENDS else stop.kind
    return Event(kind, stop.value, row, f"{words[stop.kind]} at {at}")


def _error(
    motion: Motion, stop: Stopped, driver: str, coordinate: Coordinate, value: float,
    on_crossing: str,
) -> SpatialPinError:
    name, unit = motion.mechanism.name, coordinate.unit
    where = f"mechanism {name!r}: {driver} = {value:.9g} {unit}"
    last = f"last closed at {motion.swept[-1]:.9g} {unit}"
    if stop.kind == "limit":
        return LimitError(
            f"{where} is out of reach: limit position at {stop.value:.12g} {unit} ({last})",
            limit=stop.value, motion=motion,
        )
    if stop.kind == "half turn":
        return LimitError(
            f"{where} is out of reach: a rotation vector about another axis than the component's "
            f"is no longer than half a turn, at {stop.value:.12g} {unit} ({last}); drive what "
            "turns further by a revolute joint", limit=stop.value, motion=motion)
    if stop.kind == "runs away":
        return LimitError(
            f"{where} is out of reach: {stop.runs_away} runs away without end towards {driver} = "
            f"{stop.value:.9g} {unit} ({last})", limit=stop.value, motion=motion)
    if unlike := unlike_links(motion.mechanism.model, motion.mechanism.extent):
        return SingularError(f"{where}: the loops do not determine the motion beyond {driver} = "
                             f"{stop.value:.12g} {unit} ({last}){unlike}", motion=motion)
    if stop.kind == "branch point":
        why = ("on_crossing='raise' asks to stop there; give on_crossing='straight' to go on"
               if on_crossing == "raise" else
               "no branch there clearly goes straight on; start")
        remedy = " the sweep beyond it with a guess on the wanted branch" * why.endswith("start")
        return SingularError(
            f"{where}: branches cross at {driver} = {stop.value:.12g} {unit} ({last}); "
            f"{why}{remedy}", motion=motion)
    if stop.kind == "singular":
        return SingularError(
            f"{where}: singular configuration at {driver} = {stop.value:.12g} {unit} ({last}); "
            "the rates are not determined there", motion=motion,
        )
    if stop.is_far:
        return SpatialPinError(
            f"{where} is too far from the sample before to be followed to ({last}): joints move by "
            f"more than {FARTHEST:g} rad or characteristic lengths between them; "
            "ask for values between")
    far = _far_out(motion.mechanism, stop.q)
    return SingularError(
        f"{where}: the branch was lost near {driver} = {stop.value:.9g} {unit} ({last}); {far}"
        "ask for values nearer to each other", motion=motion)


def _far_out(mechanism: Mechanism, q: Array) -> str:
    """Report the slide that is farthest out at a configuration, if it is absurdly far."""
    slides = [c for c in mechanism.coordinate_table.values() if c.unit == "m"]
    far = max(slides, key=lambda c: abs(coordinate_value(mechanism, c, q)), default=None)
    value = 0.0 if far is None else coordinate_value(mechanism, far, q)
    if far is None or abs(value) < BEYOND_LINKS * mechanism.characteristic_length:
        return ""
    return f"{far.name} is at {value:.3g} m there, out of all proportion; "
