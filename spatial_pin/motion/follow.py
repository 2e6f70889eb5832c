"""Following one branch of a closed mechanism as several drivers go along tables of values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from spatial_pin._support.checks import as_array, checked, finite_array, mapping
from spatial_pin._support.lazy import Workspaces
from spatial_pin._support.progress import progress_bar
from spatial_pin.assembly.assemble import held_start
from spatial_pin.assembly.holding import BASE, Hold, hold_names
from spatial_pin.assembly.state import State
from spatial_pin.continuation.path_following import Followed, followed
from spatial_pin.continuation.path_tracker import PathTracker
from spatial_pin.continuation.pseudo_arclength import Stopped
from spatial_pin.errors import Interrupted, LimitError, SingularError, SpatialPinError
from spatial_pin.kernel.paths import PathSamples
from spatial_pin.mechanism.coordinates import require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.limit_events import limit_events
from spatial_pin.motion.motion import Event, Motion, made
from spatial_pin.motion.rounding import CHOICES, independent_on, within_gap
from spatial_pin.motion.sweep import (
    ENDS,
    check_choice,
    crossed_event,
    scaled_estimates,
    stop_event,
    sweep,
)
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.depending import part_moving_with
from spatial_pin.rates.rates import check_finite, check_not_held
from spatial_pin.settings import Accuracy, accuracy_of


@checked
def follow(
    mechanism: Mechanism,
    values: Mapping[str, Any],
    times: Any = None,
    *,
    rates: Mapping[str, Any] | None = None,
    guess: Mapping[str, Any] | State | Array | None = None,
    hold: Hold = BASE,
    on_limit: str = "raise",
    on_crossing: str = "straight",
    accuracy: Accuracy | None = None,
    progress: bool = False,
) -> Motion:
    """Follow one branch of a mechanism as several drivers go along tables of values.

    The first values are assembled; the rest is followed as `sweep` does with one driver. Between
    the samples each driver goes along the cubic spline through its values, which is two times
    continuously differentiable ("not-a-knot" at its ends). Where `rates` are given, it goes along
    polynomials of fifth degree through values and rates; their second derivatives at the samples
    are those of the cubic spline through the rates.

    Args:
        mechanism: the mechanism.
        values: (N,) values by driver, or coordinate of a joint [rad or m]; one number stands still.
            All other drivers keep their values from the guess.
        times: (N,) rising [s]. Without them the motion has no time: its rates are those per
            sample, and its forces statics.
        rates: (N,) speeds by driver at the samples [rad/s or m/s]; they need times.
        guess: where to assemble, as for `assemble`.
        hold: names of other joints that stand still, as for `sweep`.
        on_limit: "raise", or "stop" to end the motion before what cannot be reached, with an
            event.
        on_crossing: where branches cross (a change point): "straight" to follow the one that goes
            straight on, "stop" to end the motion before it, both with an event, or "raise".
        accuracy: predictor order, corrections and tolerance; default "engineering".
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The Motion, one sample per row of the tables. It has no `driver`. The values of its events
        are times [s], or without times numbers of samples, from 0, with fractions.

    Raises:
        AssemblyError: the first values cannot be assembled.
        LimitError: later ones cannot be reached; has the time, or number, up to which the drivers
            can go, and the motion so far.
        SingularError: the branch is not determined at a configuration, or crosses another one
            where that is not allowed, or where none goes straight on.
        Interrupted: after Ctrl-C; has the motion until then.
        UnknownNameError: a name does not exist.
        ValueError: tables are not finite, or of different lengths, or times do not rise.

    Example:
        >>> mech = sp.load("excavator")
        >>> tables = {"boom": [2.70, 2.75, 2.80], "arm": [2.90, 2.90, 2.85]}  # cylinders [m]
        >>> motion = sp.follow(mech, tables, times=[0.0, 1.0, 2.0])  # [s]
        >>> motion.q.shape  # (N, nq)
        (3, 12)
        >>> motion.frame("bucket").position[-1].round(3)  # [m], world axes
        array([6.934, 0.   , 1.382])
    """
    accuracy = accuracy_of(accuracy)
    require_mechanism(mechanism)
    check_choice("on_limit", on_limit, ("raise", "stop"))
    check_choice("on_crossing", on_crossing, ("straight", "stop", "raise"))
    names, table = table_of(mechanism, values)
    if len(names) == 1 and times is None and rates is None:
        return sweep(mechanism, names[0], table[:, 0], guess=guess, hold=hold, on_limit=on_limit,
                     on_crossing=on_crossing, accuracy=accuracy, progress=progress)
    s = np.arange(len(table), dtype=float) if times is None else sample_times(times, len(table))
    law = _law(mechanism, names, s, table, rates, times is None)
    held = hold_names(hold)
    coordinates = [mechanism.prescribed_coordinate(name) for name in names]
    check_not_held(mechanism, coordinates, held)
    tight = replace(accuracy, tolerance=min(accuracy.tolerance, TOLERANCES.tight))
    first = dict(zip(names, table[0].tolist(), strict=True))
    good = None
    for _ in range(CHOICES):
        state, gone = held_start(mechanism, first, guess, held, tight)
        moved = part_moving_with(state, names, hold)
        result = along(moved.state, names, moved.hold, law, s, accuracy,
                      f"{mechanism.name}: {', '.join(names)}", progress,
                      passes=on_crossing == "straight")
        result = result._replace(samples=moved.of_whole(result.samples), released=gone)
        if state.mechanism.whole is None:
            break
        chosen, good = independent_on(
            _motion(state.mechanism, result.samples, result.done, None, moved.held, limit_events),
            accuracy, result.samples.t[max(0, result.done - 1)],
            None if result.stop is None else result.stop.q)
        if chosen is state.mechanism:
            break
        mechanism = chosen
    motion = finished(state.mechanism, result, None if times is None else s,
                      moved.held, list(values), "drivers",
                      on_limit if good is None else "stop", on_crossing)
    return within_gap(motion, accuracy, on_limit, good)


def along(
    state: State, names: Sequence[str], hold: Hold, law: Any, s: Array, accuracy: Accuracy,
    title: str, progress: bool, passes: bool = False,
) -> Followed:
    """Follow a branch as coordinates go by a law.

    The law is a piecewise polynomial of the parameter, to values (k,) of the names; s (N,) are the
    rising values of the parameter at the samples. `hold` names what stands still besides.

    Raises:
        SingularError: the coordinates do not determine the motion at the start.
        KeyboardInterrupt: before anything was followed.
    """
    with progress_bar(len(s), title, progress) as bar, Workspaces() as workspaces:
        tracker = PathTracker.along(state, names, hold, accuracy, workspaces, law, float(s[0]))
        return followed(tracker, s, tracker.room_for(len(s)), passes, bar)


def finished(
    mechanism: Mechanism, followed: Followed, times: Array | None, held: tuple[str, ...],
    names: list[str], who: str, on_limit: str = "raise", on_crossing: str = "raise",
) -> Motion:
    """Return the Motion of followed samples, with its events; raise if it ended early.

    `who` are the coordinates with tables, in one word. `times` (N,) are those of all samples, None
    where the parameter is their number.

    Raises:
        LimitError: it ended at a limit.
        SingularError: it ended at a singular configuration, or the branch was lost.
        Interrupted: Ctrl-C ended it.
    """
    stop = followed.stop
    begin = 0.0 if times is None else float(times[0])
    events = [Event("released", begin, 0, text) for text in followed.released]
    events += [crossed_event(value, row, _where(value, times is None))
               for value, row in followed.crossed]
    events += [
        Event("singular", value, row, "the drivers alone do not determine the motion at "
              f"{_where(value, times is None)}: efforts grow without bound towards it")
        for value, row in followed.undriven]
    last = [] if stop is None or followed.is_cut else [
        stop_event(stop, followed.done, _where(stop.value, times is None),
                   f"limit of what the {who} can do together")]
    motion = _motion(mechanism, followed.samples, followed.done, times, held,
                     lambda motion: [*events, *limit_events(motion), *last])
    if followed.is_cut:
        raise Interrupted(motion)
    if stop is not None:
        ends = on_limit if stop.kind in ENDS else on_crossing
        if ends != "stop" or stop.kind == "lost":
            raise _error(motion, stop, names, times is None, who, ends)
    return motion


def table_of(mechanism: Mechanism, values: Mapping[str, Any]) -> tuple[list[str], Array]:
    """Return names of coordinates and their values (N, k).

    Raises:
        UnknownNameError: a name does not exist.
        ValueError: they are not finite, of different lengths, or none.
    """
    columns: dict[str, Array] = {}
    for name, given in mapping(values, "values").items():
        coordinate = mechanism.prescribed_coordinate(name).name
        if coordinate in columns:
            raise ValueError(f"{coordinate!r} is given two tables")
        columns[coordinate] = as_array(given, f"values of {name!r}")
    if not columns:
        raise ValueError("values is empty: give a table for every driver that moves")
    lengths = {len(c) for c in columns.values() if c.ndim}
    if len(lengths) > 1:
        counts = ", ".join(f"{name!r} {len(c)}" for name, c in zip(values, columns.values(),
                                                                 strict=True) if c.ndim)
        raise ValueError(f"tables differ in length: {counts}; every driver needs as many values")
    n = lengths.pop() if lengths else 1
    if not n:
        raise ValueError("values has no sample: give every driver one number at least")
    full = [_column(c, n, f"values of {name!r}")
            for name, c in zip(values, columns.values(), strict=True)]
    return list(columns), np.column_stack(full)


def sample_times(times: Any, n: int) -> Array:
    """Return rising times (n,).

    Raises:
        ValueError: they do not rise, or are not finite.
    """
    array = finite_array(times, (n,), "times")
    if np.any(np.diff(array) <= 0.0):
        raise ValueError("times must rise from sample to sample")
    return array


def _law(
    mechanism: Mechanism, names: list[str], s: Array, table: Array,
    rates: Mapping[str, Any] | None, is_timeless: bool,
) -> Any:
    """Return the piecewise polynomial of the parameter that drivers go by."""
    from scipy.interpolate import BPoly, CubicSpline, PPoly  # on use: they take a tenth of a second

    if len(s) == 1:
        s, table = np.append(s, s[0] + 1.0), np.repeat(table, 2, axis=0)
    if rates is None:
        spline = CubicSpline(s, table)
        return PPoly(spline.c, spline.x)
    if is_timeless:
        raise ValueError("rates are given but no times: give both")
    given = {mechanism.prescribed_coordinate(name).name: x
             for name, x in mapping(rates, "rates").items()}
    if set(given) != set(names):
        raise ValueError(f"rates are given of {', '.join(map(repr, given)) or 'nothing'}; they "
                         f"are wanted of {', '.join(map(repr, names))}")
    slopes = np.column_stack([_column(given[name], len(s), f"rates of {name!r}")
                              for name in names])
    bends = CubicSpline(s, slopes)(s, 1)
    return PPoly.from_bernstein_basis(BPoly.from_derivatives(
        s, np.stack([table, slopes, bends], axis=1)))


def _column(given: Any, n: int, what: str) -> Array:
    numbers = as_array(given, what)
    return finite_array(np.full(n, numbers) if numbers.ndim == 0 else numbers, (n,), what)


def _motion(
    mechanism: Mechanism, samples: PathSamples, n: int, times: Array | None,
    held: tuple[str, ...], look: Callable[[Motion], list[Event]],
) -> Motion:
    v, a = samples.t[:n], samples.c[:n]
    check_finite(v, a, "the speeds and accelerations of the motion")
    return made(
        mechanism=mechanism, driver=None, driver_name="",
        time=None if times is None else times[:n].copy(), q=samples.q[:n], v=v, a=a,
        closure_error=samples.error[:n], driver_speed=np.ones(n), angles=samples.angles[:n],
        per="sample" if times is None else "s", held=held, _look=look,
        _estimate=lambda motion: scaled_estimates(motion, samples.estimate[:n]))


def _where(value: float, is_timeless: bool) -> str:
    return f"sample {value:.12g}" if is_timeless else f"{value:.12g} s"


def _error(
    motion: Motion, stop: Stopped, names: list[str], is_timeless: bool, who: str, ends: str
) -> SpatialPinError:
    at, moved = _where(stop.value, is_timeless), ", ".join(names)
    where = f"mechanism {motion.mechanism.name!r}: {moved} cannot go on beyond {at}: "
    if stop.kind == "limit":
        return LimitError(f"{where}the loops let them go no further that way (limit position)",
                          limit=stop.value, motion=motion)
    if stop.kind == "half turn":
        return LimitError(f"{where}a rotation vector is no longer than half a turn; prescribe what "
                          "turns further by a revolute joint", limit=stop.value, motion=motion)
    if stop.kind == "runs away":
        return LimitError(f"{where}{stop.runs_away} runs away without end towards it",
                          limit=stop.value, motion=motion)
    if stop.kind == "lost":
        return SingularError(f"{where}the branch was lost there; ask for values nearer to each "
                             "other", motion=motion)
    what = "branches cross" if stop.kind == "branch point" else "the configuration is singular"
    may_pass = stop.kind == "branch point" and who == "drivers" and ends == "raise"
    remedy = ", or give on_crossing='straight' to go on" * may_pass
    return SingularError(f"{where}{what} there, and {who} do not determine the motion; go round "
                         f"it{remedy}", motion=motion)
