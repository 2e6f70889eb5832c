"""Following one branch of a closed mechanism as several drivers go along tables of values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.holding import BASE, Hold
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.checks import as_array, checked, finite_array, mapping, names_of
from spatial_pin.constraints.closure_equations import evaluation_of
from spatial_pin.continuation.cursor import UNBOUND
from spatial_pin.continuation.parametrised import DrivenCurve
from spatial_pin.continuation.pseudo_arclength import Arrival
from spatial_pin.continuation.start import Start
from spatial_pin.errors import LimitError, SingularError, SpatialPinError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.paths import Path, Samples
from spatial_pin.mechanism.coordinates import coordinate_value, needed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.joint_limits import joint_limit_events
from spatial_pin.motion.motion import Event, Motion
from spatial_pin.motion.rated_limits import velocity_limit_events
from spatial_pin.motion.sweep import check_choice, sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.progress import progress_bar
from spatial_pin.rates.rates import check_finite, check_not_held
from spatial_pin.settings import Accuracy, accuracy_of

SAMPLES_AT_ONCE = 1000  # samples followed at a time: the bar moves, and Ctrl-C is heard


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
    on_crossing: str = "raise",
    accuracy: Accuracy | None = None,
    progress: bool = False,
) -> Motion:
    """Follow one branch of a mechanism as several drivers go along tables of values.

    The first values are assembled, the rest is followed as `sweep` does, which is its case of one
    driver without times. Between the samples each driver goes along the cubic spline through its
    values, two times continuously differentiable ("not-a-knot" at the ends); where `rates` are
    given, along the polynomials of fifth degree through values, rates, and the derivatives of the
    cubic spline through the rates.

    Args:
        mechanism: the mechanism.
        values: (N,) values by driver, or coordinate of a joint [rad or m]; one number stands
            still. All other drivers stand where the guess has them.
        times: (N,) rising [s]. Without them the motion has no time: its rates are those per
            sample, and its forces statics.
        rates: (N,) speeds by driver at the samples [rad/s or m/s]; they need times.
        guess: where to assemble, as for `assemble`.
        hold: names of what stands still besides, as for `sweep`.
        on_limit: "raise", or "stop" to end the motion before what cannot be reached, with an
            event.
        on_crossing: "raise", or "stop" to end the motion so where branches cross.
        accuracy: predictor order, corrections and tolerance; default "engineering".
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The Motion, one sample per row of the tables. It has no `driver`; its events have times as
        values, or numbers of samples, 0 the first, counted with fractions.

    Raises:
        AssemblyError: the first values cannot be assembled.
        LimitError: later ones cannot be reached; has the time, or number, up to which the drivers
            can go, and the motion so far.
        SingularError: the branch is not determined at a configuration, or crosses another one.
        UnknownNameError: a name does not exist.
        ValueError: tables are not finite, or of different lengths, or times do not rise.
    """
    accuracy = accuracy_of(accuracy)
    needed(mechanism)
    check_choice("on_limit", on_limit, ("raise", "stop"))
    check_choice("on_crossing", on_crossing, ("raise", "stop"))
    names, table = _table(mechanism, values)
    if len(names) == 1 and times is None and rates is None:
        return sweep(mechanism, names[0], table[:, 0], guess=guess, hold=hold, on_limit=on_limit,
                     on_crossing=on_crossing, accuracy=accuracy, progress=progress)
    s = np.arange(len(table), dtype=float) if times is None else sample_times(times, len(table))
    law = _law(mechanism, names, s, table, rates, times is None)
    held = () if hold is None else tuple(names_of(hold, "hold"))
    coordinates = [mechanism.prescribed_coordinate(name) for name in names]
    check_not_held(mechanism, coordinates, held)
    tight = replace(accuracy, tolerance=min(accuracy.tolerance, TOLERANCES.tight))
    first = dict(zip(names, table[0].tolist(), strict=True))
    state = assembled(mechanism, first, guess, accuracy=tight)
    followed = along(state, names, hold, law, s, accuracy,
                     f"{mechanism.name}: {', '.join(names)}", progress)
    return finished(state.mechanism, followed, None if times is None else s, held, list(values),
                    "drivers", on_limit, on_crossing)


class Followed(NamedTuple):
    """What was followed.

    Attributes:
        samples: of which `done` are done.
        done: how many.
        stop: what ended it before the last; None if nothing did.
    """

    samples: Samples
    done: int
    stop: Arrival | None


def along(
    state: State, names: Sequence[str], hold: Hold, law: Any, s: Array, accuracy: Accuracy,
    title: str, progress: bool,
) -> Followed:
    """Follow a branch as coordinates go by a law.

    Args:
        state: closed, where the branch begins.
        names: the coordinates.
        hold: what stands still besides.
        law: piecewise polynomial of the parameter: values (k,) of the coordinates.
        s: (N,) rising values of the parameter, the samples.
        accuracy: of the motion.
        title: of the progress bar.
        progress: whether there is one.

    Raises:
        SingularError: the coordinates do not determine the motion at the start.
    """
    mechanism, n, stop = state.mechanism, len(s), None
    with (progress_bar(n, title, progress) as bar,
          evaluation_of(mechanism, state.angles) as evaluation, kernel_of(mechanism) as kernel):
        trip = _Trip(Start.along(state, names, hold, accuracy, kernel, evaluation), law, s)
        while trip.done < n and stop is None:
            stop = trip.go_on()
            bar.update(trip.done - bar.n)
    return Followed(trip.samples, trip.done, stop)


def finished(
    mechanism: Mechanism, followed: Followed, times: Array | None, held: tuple[str, ...],
    names: list[str], who: str, on_limit: str = "raise", on_crossing: str = "raise",
) -> Motion:
    """Return the Motion of what was followed, with its events; raise where it ended early.

    Args:
        mechanism: the mechanism.
        followed: samples of its q, v and a.
        times: (N,) of all samples; None: the parameter is their number.
        held: what was held by name.
        names: what went along tables, for words.
        who: what these are, in one word.
        on_limit: "raise" or "stop".
        on_crossing: the same.

    Raises:
        LimitError: it ended at a limit.
        SingularError: it ended at a singular configuration, or the branch was lost.
    """
    stop = followed.stop
    motion = _motion(mechanism, followed.samples, followed.done, times)
    motion.held = held
    motion.events += [*joint_limit_events(motion), *velocity_limit_events(motion)]
    if stop is not None:
        motion.events.append(_event(stop, followed.done, times is None, who))
        ends = on_limit if stop.kind in ("limit", "half turn") else on_crossing
        if ends != "stop" or stop.kind == "lost":
            raise _error(motion, stop, names, times is None, who)
    return motion


class _Trip:
    """The way of several drivers along their law, sample by sample.

    Attributes:
        samples: of which `done` are done.
    """

    def __init__(self, start: Start, law: Any, s: Array) -> None:
        self.start, self.law, self.s, self.done = start, law, s, 0
        self.samples = start.samples(len(s))
        here = start.first_path()
        if here is None:  # it says why
            start.checked_system(start.state)
            raise SingularError(f"mechanism {start.mechanism.name!r}: singular configuration at "
                                f"the start, {start.state}", state=start.state)
        self._take(here, float(s[0]), start.state.q, start.state.angles)

    def _take(self, path: Path, s: float, q: Array, angles: Array) -> None:
        """Go on along a path that stands at a configuration, with the parameter there."""
        n, others = self.law.c.shape[-1], self.start.driven[self.law.c.shape[-1] :]
        pieces = np.zeros((len(self.law.x) - 1, path.n_driven, len(self.law.c)))
        pieces[:, :n] = np.moveaxis(self.law.c[::-1], 0, 2)
        pieces[:, n : n + len(others), 0] = [
            coordinate_value(self.start.mechanism, c, self.start.state.q) for c in others]
        path.prescribe(s, self.law.x, pieces)
        self._path: Path | None = path if path.start(q, angles) else None
        self._at = s, q, angles

    def go_on(self) -> Arrival | None:
        """Go on by some samples; return why that ends, if it does."""
        path, last = self._path, min(self.done + SAMPLES_AT_ONCE, len(self.s))
        if path is not None:
            self.done += path.follow(self.s[self.done : last],
                                     self.samples.between(self.done, last))
            if self.done == last:
                return None
            here, sample = path.here
            self._at = here, sample.q[0], sample.angles[0]
            if any(c.q < 0 for c in self.start.driven):  # which no curve leads by
                return self._end(here, sample.q[0], sample.t[0])
        return self._pass_on()

    def _end(self, s: float, q: Array, t: Array) -> Arrival:
        """Return what the kernel's path, whose smallest step it is, has come to."""
        mechanism, driven = self.start.mechanism, self.start.driven
        scale = mechanism.velocity_scale
        asked = self.law.derivative()(s) / [scale[c.v] for c in driven[: self.law.c.shape[-1]]]
        joints = {c.joint for c in driven if c.q < 0 and c.unit == "rad"}
        turned = [c for c in mechanism.coordinate_table.values()
                  if c.joint in joints and c.unit == "rad"]
        for joint in joints:
            length = np.linalg.norm(
                [coordinate_value(mechanism, c, q) for c in turned if c.joint == joint])
            if length > np.pi - TOLERANCES.half_precision:
                return Arrival("half turn", q, s)
        is_fast = np.abs(t / scale).max() > UNBOUND * np.abs(asked).max()
        return Arrival("limit" if is_fast else "lost", q, s)

    def _pass_on(self) -> Arrival | None:
        """Go on by arc length from where the kernel's path stands; return where that ends."""
        s, q, angles = self._at
        if any(c.q < 0 for c in self.start.driven):
            return Arrival("singular", q, s)
        try:
            system: SquareSystem = self.start.system(q, angles)
        except SingularError:
            return Arrival("singular", q, s)
        standing = [c.q for c in self.start.driven[self.law.c.shape[-1] :]]
        full = _Standing(self.law, self.start.state.q[standing])
        pace = system.driver_rates() @ full.derivative()(s) / system.scale
        size = float(np.linalg.norm(pace))
        arrival = DrivenCurve(system, full, 1.0 / max(size, TOLERANCES.nothing)).towards(
            q, s, float(self.s[self.done]))
        if arrival.kind != "reached":
            return arrival
        angles = system.evaluation.angles.copy()
        path = self.start.path(arrival.q, angles)
        if path is None:
            return Arrival("singular", arrival.q, arrival.value)
        self._take(path, arrival.value, arrival.q, angles)
        return None if self._path is not None else Arrival("singular", arrival.q, arrival.value)


class _Standing:
    """A law of some coordinates, with others that stand at their values (k,) behind them."""

    def __init__(self, law: Any, rest: Array) -> None:
        self._law, self._rest = law, rest

    def __call__(self, s: float) -> Array:
        return np.append(self._law(s), self._rest)

    def derivative(self) -> _Standing:
        """Return the law of the rates."""
        return _Standing(self._law.derivative(), np.zeros_like(self._rest))


def _table(mechanism: Mechanism, values: Mapping[str, Any]) -> tuple[list[str], Array]:
    """Return names of coordinates and their values (N, k)."""
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
        said = ", ".join(f"{name!r} {len(c)}" for name, c in columns.items() if c.ndim)
        raise ValueError(f"tables differ in length: {said}; every driver needs as many values")
    n = lengths.pop() if lengths else 1
    full = [_column(c, n, f"values of {name!r}")
            for name, c in zip(values, columns.values(), strict=True)]
    return list(columns), np.column_stack(full)


def sample_times(times: Any, n: int) -> Array:
    """Return rising times (n,).

    Raises:
        ValueError: they do not rise, or are not finite.
    """
    found = finite_array(times, (n,), "times")
    if np.any(np.diff(found) <= 0.0):
        raise ValueError("times must rise from sample to sample")
    return found


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


def _motion(mechanism: Mechanism, samples: Samples, n: int, times: Array | None) -> Motion:
    v, a = samples.t[:n], samples.c[:n]
    check_finite(v, a, "the speeds and accelerations of the motion")
    return Motion(
        mechanism=mechanism, driver=None, driver_name="",
        time=None if times is None else times[:n].copy(), q=samples.q[:n], v=v, a=a,
        closure_error=samples.error[:n], driver_speed=np.ones(n), angles=samples.angles[:n],
        per="sample" if times is None else "s")


def _where(value: float, is_timeless: bool) -> str:
    return f"sample {value:.12g}" if is_timeless else f"{value:.12g} s"


def _event(stop: Arrival, row: int, is_timeless: bool, who: str) -> Event:
    words = {"limit": f"limit of what the {who} can do together", "singular":
             "singular configuration", "branch point": "branch point", "lost":
             "end of the followed path", "half turn": "end of a rotation vector, half a turn,"}
    kind = "limit" if stop.kind == "half turn" else stop.kind
    return Event(kind, stop.value, row,
                 f"{words[stop.kind]} at {_where(stop.value, is_timeless)}")


def _error(
    motion: Motion, stop: Arrival, names: list[str], is_timeless: bool, who: str
) -> SpatialPinError:
    at, moved = _where(stop.value, is_timeless), ", ".join(names)
    where = f"mechanism {motion.mechanism.name!r}: {moved} cannot go on beyond {at}: "
    if stop.kind == "limit":
        return LimitError(f"{where}the loops let them go no further that way (limit position)",
                          limit=stop.value, motion=motion)
    if stop.kind == "half turn":
        return LimitError(f"{where}a rotation vector is no longer than half a turn; prescribe what "
                          "turns further by a revolute joint", limit=stop.value, motion=motion)
    if stop.kind == "lost":
        return SingularError(f"{where}the branch was lost there; ask for values nearer to each "
                             "other", motion=motion)
    what = "branches cross" if stop.kind == "branch point" else "the configuration is singular"
    return SingularError(f"{where}{what} there, and {who} do not determine the motion; go round "
                         "it", motion=motion)
