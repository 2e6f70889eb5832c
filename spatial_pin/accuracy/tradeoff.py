"""What each accuracy setting costs and loses, on one's own mechanism and task."""

from __future__ import annotations

import gc
import json
import math
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatial_pin._support.checks import checked, positive_number, whole_number
from spatial_pin._support.lazy import by_new_name
from spatial_pin._support.output_files import named_path, write_text
from spatial_pin._support.progress import progress_bar
from spatial_pin.accuracy.reference import (
    Astray,
    Errors,
    SimulationReference,
    SweepReference,
)
from spatial_pin.accuracy.tasks import (
    SweepTask,
    Task,
    describe,
    simulation_settings,
    sweep_settings,
    task_of,
)
from spatial_pin.dynamics.simulation.simulate import Simulation
from spatial_pin.errors import SingularError, SpatialPinError, unless_cut
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import INTERPOLATED, LEVELS, Accuracy, accuracy_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPEATS = 5  # runs whose least time counts: other programs only delay
SHORTEST_RUN = 1e-5  # of a sweep of few values [s]
# The processor's time, which other programs do not change; the time that passes where a system
# tells the processor's in longer steps, as Windows does.
CLOCK = (time.process_time if time.get_clock_info("process_time").resolution < SHORTEST_RUN
         else time.perf_counter)
MOST_REPEATS = 10_000  # runs at most: more tell nothing
MARGIN = 3.0  # times the measured error that a setting is said to keep
BUDGET = 30.0  # after this time no run is repeated [s]
ROUND_OFF = TOLERANCES.last_digit  # error below which results in double precision are equally exact
FAILURES = (Astray, SpatialPinError, ValueError, ArithmeticError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Measured:
    """Time and errors of one accuracy setting.

    Attributes:
        accuracy: the setting.
        seconds: of the processor in every run, in the order they were made.
        steps: samples of the motion; a step is a sample.
        errors: largest errors against the reference; None where it failed.
        energy_drift: of a simulation [-], see `Simulation`; None of a sweep.
        solver_steps: of the integrator; None of a sweep.
        on_front: whether no other setting is both as fast and as exact.
        estimate: largest of the motion's own error estimates [-]; None where it has none.
        note: why it failed, or what the motion reports; empty if nothing.

    Example:
        >>> mech = sp.load("four_bar")
        >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
        >>> levels = [sp.Accuracy.named("draft")]
        >>> row = sp.tradeoff(mech, task, settings=levels, repeats=2).rows[0]
        >>> row.steps, len(row.seconds), row.time_per_step > 0.0, row.spread >= 0.0
        (21, 2, True, True)
        >>> print(row.error < 1e-3)
        True
    """

    accuracy: Accuracy
    seconds: tuple[float, ...]
    steps: int
    errors: Errors | None = None
    energy_drift: float | None = None
    solver_steps: int | None = None
    on_front: bool = False
    note: str = ""
    estimate: float | None = None

    @property
    def said(self) -> str:
        """The old name of `note`; it warns."""
        return str(by_new_name(self, "said", "note"))

    @property
    def time_per_step(self) -> float:
        """Least time of a step, assembly of the first one included [s]; NaN where it failed."""
        return min(self.seconds) / self.steps if self.steps else np.nan

    @property
    def spread(self) -> float | None:
        """Difference of the quartiles of the runs relative to their median; None for one run."""
        if len(self.seconds) < 2:
            return None
        low, middle, high = np.percentile(self.seconds, [25, 50, 75])
        return float((high - low) / middle)

    @property
    def error(self) -> float:
        """Largest error of a position, or of a rate by the largest rate; NaN where it failed."""
        return self.errors.total if self.errors else np.nan

    def __repr__(self) -> str:
        kind = "sweep" if self.solver_steps is None else "simulate"
        return (f"Measured({describe(self.accuracy, kind)!r}: {1e6 * self.time_per_step:.3g} µs a "
                f"step, error {self.error:.1e})")


@dataclass(frozen=True)
class Tradeoff:
    """Time and errors of accuracy settings on one task; `str()` is the table.

    Errors are absolute in rad, and in m relative to the characteristic length; `error` is the
    largest of that of positions, and those of velocities and accelerations by the largest one.

    Attributes:
        mechanism: its name.
        task: the task, in words.
        kind: "sweep" or "simulate".
        rows: one for each setting, the fastest first, those that failed last.
        reference: the reference of the errors, in words.
        reference_error: the error of that [-], like `Measured.error`.
        is_whole: whether nothing cut it short (Ctrl-C).

    Example:
        >>> mech = sp.load("four_bar")
        >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
        >>> levels = [sp.Accuracy.named("draft"), sp.Accuracy.named("engineering")]
        >>> table = sp.tradeoff(mech, task, settings=levels, repeats=1)
        >>> len(table.rows), len(table.front) >= 1, table.kind
        (2, True, 'sweep')
    """

    mechanism: str
    task: str
    kind: str
    rows: tuple[Measured, ...]
    reference: str
    reference_error: float
    is_whole: bool = True

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def front(self) -> tuple[Measured, ...]:
        """The rows of the Pareto front, the fastest first."""
        return tuple(row for row in self.rows if row.on_front)

    def known_error(self, row: Measured) -> float:
        """Return the error of a row as far as it is known.

        It is at least the reference's own, and round-off; NaN where the setting failed.

        Args:
            row: one of `rows`.

        Example:
            >>> mech = sp.load("four_bar")
            >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
            >>> levels = [sp.Accuracy.named("engineering")]
            >>> table = sp.tradeoff(mech, task, settings=levels, repeats=1)
            >>> table.known_error(table.rows[0]) < 1e-10
            True
        """
        return float(np.maximum(row.error, max(self.reference_error, ROUND_OFF)))

    def error_bound(self, row: Measured) -> float:
        """Return the error that a setting keeps, on this motion and on others like it.

        It is three times the measured error, to cover points between samples and other motions. It
        is no less than the estimate of the motion. If closer samples would be interpolated, it is
        no less than the bound of the interpolation error.

        Args:
            row: one of `rows`.

        Example:
            >>> mech = sp.load("four_bar")
            >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
            >>> levels = [sp.Accuracy.named("draft")]
            >>> table = sp.tradeoff(mech, task, settings=levels, repeats=1)
            >>> table.error_bound(table.rows[0]) >= 1e-8
            True
        """
        accuracy, least = row.accuracy, row.estimate or 0.0
        if (self.kind == "sweep" and accuracy.tolerance >= INTERPOLATED and accuracy.order == 3
                and accuracy.corrections is None):
            least = max(least, accuracy.tolerance)
        return float(np.maximum(MARGIN * self.known_error(row), least))

    def relative_time(self, row: Measured) -> float:
        """Return the time of a row relative to "engineering"; NaN where that was not measured.

        Args:
            row: one of `rows`.

        Example:
            >>> mech = sp.load("four_bar")
            >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
            >>> levels = [sp.Accuracy.named("engineering")]
            >>> table = sp.tradeoff(mech, task, settings=levels, repeats=1)
            >>> table.relative_time(table.rows[0])
            1.0
        """
        named = describe(LEVELS["engineering"], self.kind)
        base = (x.time_per_step for x in self.rows if describe(x.accuracy, self.kind) == named)
        return row.time_per_step / next(base, np.nan)

    @checked
    def cheapest(self, error: float) -> Measured:
        """Return the fastest row that keeps this error, see `error_bound`.

        Args:
            error: the largest error to accept [rad, characteristic lengths].

        Returns:
            The row; its `accuracy` is the setting.

        Raises:
            SpatialPinError: there is none.
            ValueError: the error is not positive.

        Example:
            >>> mech = sp.load("four_bar")
            >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
            >>> levels = [sp.Accuracy.named("engineering")]
            >>> table = sp.tradeoff(mech, task, settings=levels, repeats=1)
            >>> table.cheapest(1e-6).accuracy.tolerance
            1e-13
        """
        error = positive_number(error, "error")
        good = [row for row in self.rows if row.errors is not None]
        for row in good:
            if self.error_bound(row) <= error:
                return row
        if not good:
            raise SpatialPinError(f"{self.mechanism}, {self.task}: no setting worked; the table "
                                  "says why")
        best = min(self.error_bound(row) for row in good)
        raise SpatialPinError(
            f"{self.mechanism}, {self.task}: no setting that was measured has an error of "
            f"{error:.3g}; the best keeps {best:.1e}"
            + (f", as far as the reference tells (itself to {self.reference_error:.1e})"
               if min(map(self.known_error, good)) <= self.reference_error else ""))

    def _repr_html_(self) -> str:
        """Return a small table, for a notebook."""
        from spatial_pin.view.page import cards

        return cards.tradeoff(self)

    def __repr__(self) -> str:
        return (f"Tradeoff({self.mechanism!r}, {self.task!r}: {len(self)} settings, "
                f"{len(self.front)} of them on the front{'' if self.is_whole else '; cut short'})")

    def __str__(self) -> str:
        from spatial_pin.accuracy.tradeoff_view import table

        return table(self)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain data; an error without a bound is None.

        Example:
            >>> mech = sp.load("four_bar")
            >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
            >>> table = sp.tradeoff(mech, task, settings=[sp.Accuracy.named("draft")], repeats=1)
            >>> sorted(table.as_dict())
            ['is_whole', 'kind', 'mechanism', 'reference', 'reference_error', 'rows', 'task']
        """
        rows = [{
            "setting": describe(row.accuracy, self.kind), "accuracy": asdict(row.accuracy),
            "seconds": list(row.seconds), "steps": row.steps,
            "time_per_step": row.errors and row.time_per_step,
            "spread": row.spread, "error": row.errors and row.errors.total,
            **{key: row.errors and getattr(row.errors, key) for key in Errors._fields[:-1]},
            "below_reference": bool(row.errors and row.error < self.reference_error),
            "energy_drift": row.energy_drift, "solver_steps": row.solver_steps,
            "on_front": row.on_front, "note": row.note, "estimate": _finite(row.estimate),
            "keeps": row.errors and _finite(self.error_bound(row)),
        } for row in self.rows]
        return {"mechanism": self.mechanism, "task": self.task, "kind": self.kind,
                "reference": self.reference, "reference_error": self.reference_error,
                "is_whole": self.is_whole, "rows": rows}

    def to_json(self, path: str | Path) -> Path:
        """Write `as_dict`; returns the path.

        Args:
            path: of the file.

        Raises:
            OSError: it cannot be written; the former file stays.

        Example:
            >>> mech = sp.load("four_bar")
            >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
            >>> table = sp.tradeoff(mech, task, settings=[sp.Accuracy.named("draft")], repeats=1)
            >>> table.to_json("table.json").name
            'table.json'
        """
        text = json.dumps(self.as_dict(), indent=1, allow_nan=False) + "\n"
        return write_text(named_path(path), text)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw error over time per step, both logarithmic, with the Pareto front.

        Args:
            path: file to write as well; its suffix says how: .png, .svg, .pdf.

        Returns:
            The figure.

        Raises:
            ValueError: the suffix is none that a figure has.

        Example:
            >>> mech = sp.load("four_bar")
            >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
            >>> table = sp.tradeoff(mech, task, settings=[sp.Accuracy.named("draft")], repeats=1)
            >>> len(table.plot("table.svg").axes)
            1
        """
        from spatial_pin.accuracy.tradeoff_view import plot

        return plot(self, path)


@checked
def tradeoff(
    mechanism: Mechanism,
    task: Mapping[str, Any] | str | Motion | None = None,
    *,
    settings: Iterable[Accuracy] | None = None,
    repeats: int = REPEATS,
    budget: float = BUDGET,
    progress: bool = False,
) -> Tradeoff:
    """Measure time and errors of accuracy settings on a mechanism and a task.

    The settings take turns in changing order, and each does the whole task, so that noise affects
    all alike and shows as a spread. Its motion is compared with a reference that does not depend on
    settings: sweeps with samples refined in extended precision, simulations with a tight
    integration that is itself compared with others. Sweeps of all settings begin at the same state;
    only values that can be reached are swept. Passive freedoms, which move no other body, are
    judged apart (`Errors.spin`).

    Args:
        mechanism: the mechanism.
        task: a mapping with the arguments of `sweep` (driver, values, speed, ...) or `simulate`
            (duration, state, efforts, ...; default state the assembled guess at rest); a swept
            Motion; "sweep" for the default motion of the first driver (the default); "simulate" for
            a few seconds under gravity.
        settings: the Accuracy settings to try; default a grid of all kinds.
        repeats: how often each setting is timed.
        budget: time after which no run is repeated any more [s]; after twice that time settings
            that have not run yet are not tried.
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The Tradeoff; `print` it for the table.

    Raises:
        SpatialPinError: the task cannot be done at all, or the mechanism has no such task.
        TypeError, ValueError: no task, or a number out of range.
        UnknownNameError: an argument or name does not exist.
        Interrupted: after Ctrl-C; `.result` has the settings that were measured until then.

    Example:
        >>> mech = sp.load("four_bar")
        >>> levels = [sp.Accuracy.named("draft"), sp.Accuracy.named("engineering")]
        >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
        >>> table = sp.tradeoff(mech, task, settings=levels, repeats=1)
        >>> table.cheapest(1e-6).error < 1e-6
        True
    """
    repeats = whole_number(repeats, "repeats")
    if not 1 <= repeats <= MOST_REPEATS:
        raise ValueError(f"repeats is {repeats}; each setting is timed a whole number of times, "
                         f"{MOST_REPEATS} at most")
    if not (isinstance(budget, int | float) and budget >= 0.0):
        raise ValueError(f"budget is {budget!r}; it is a time in s")
    if isinstance(settings, Accuracy):
        settings = [settings]
    start = time.perf_counter()
    doing, reference = with_reference(task_of(mechanism, task))
    if settings is not None:
        tried = [accuracy_of(x) for x in settings]
    elif isinstance(reference, SweepReference):
        tried = sweep_settings()
    else:
        tried = simulation_settings(reference.step)
    if not tried:
        raise ValueError("no settings to try")
    with progress_bar(len(tried) * repeats, f"{mechanism.name}: runs", progress) as bar:
        rows = list[Measured]()
        try:
            for accuracy in tried:
                rows.append(_judged(doing, reference, accuracy, bar)
                            if time.perf_counter() < start + 2.0 * budget
                            else Measured(accuracy, (), 0, note="not tried, the time was out"))
            _repeat(doing, rows, repeats - 1, start + budget, bar)
            is_whole = True
        except KeyboardInterrupt:  # the result has the rows until then
            if not rows:
                raise
            rows += [Measured(accuracy, (), 0, note="not tried, cut short")
                     for accuracy in tried[len(rows):]]
            is_whole = False
    rows.sort(key=lambda row: row.time_per_step if row.errors else np.inf)
    result = Tradeoff(mechanism.name, str(doing), doing.kind, tuple(rows), reference.text,
                     reference.error, is_whole)
    flags = pareto([row.time_per_step for row in rows], [result.known_error(row) for row in rows])
    return unless_cut(replace(result, rows=tuple(
        replace(row, on_front=flag) for row, flag in zip(rows, flags, strict=True))))


def with_reference(task: Task) -> tuple[Task, SweepReference | SimulationReference]:
    """Return a task and its reference, the default simulation shortened until it has one.

    A loose integration may pass a singular configuration by its error.
    """
    if isinstance(task, SweepTask):
        return task, SweepReference(task)
    try:
        return task, SimulationReference(task)
    except SingularError as error:
        return with_reference(task.before(error))


def _judged(
    task: Task, reference: SweepReference | SimulationReference, accuracy: Accuracy, bar: Any
) -> Measured:
    """Run a setting once, time it and compare it."""
    start = CLOCK()
    try:
        motion = task.run(accuracy)
        seconds = CLOCK() - start
        errors = reference.judge(motion)
    except FAILURES as error:
        text = str(error) or type(error).__name__
        return Measured(accuracy, (CLOCK() - start,), 0, note=text)
    finally:
        bar.update()
    text = "; ".join(event.text for event in motion.events)
    sizes = reference.sizes
    estimate = float((motion.error_estimates.max(axis=0) / sizes).max()) if (
        len(motion.error_estimates)) else None
    row = Measured(accuracy, (seconds,), len(motion), errors, note=text, estimate=estimate)
    if isinstance(motion, Simulation):
        return replace(row, energy_drift=motion.energy_drift, solver_steps=motion.steps)
    return row


def _repeat(task: Task, rows: list[Measured], rounds: int, end: float, bar: Any) -> None:
    """Time the settings that work again, round by round in changing order."""
    good = [k for k, row in enumerate(rows) if row.errors is not None]
    rng = np.random.default_rng(0)
    for _ in range(rounds):
        gc.collect()
        for k in rng.permutation(good).tolist():
            if time.perf_counter() > end:
                return
            start = CLOCK()
            task.run(rows[k].accuracy)
            seconds = CLOCK() - start
            rows[k] = replace(rows[k], seconds=(*rows[k].seconds, seconds))
            bar.update()


def _finite(error: float | None) -> float | None:
    """Return an error as JSON has it: None where it is infinite."""
    return error if error is not None and math.isfinite(error) else None


def pareto(costs: Iterable[float], errors: Iterable[float]) -> list[bool]:
    """Return which of (cost, error) no other matches in both and beats in one; NaN never is."""
    points: Array = np.column_stack([list(costs), list(errors)])
    flags = []
    for point in points:
        no_worse = np.all(points <= point, axis=1)
        better = np.any(points < point, axis=1)
        flags.append(bool(np.isfinite(point).all() and not np.any(no_worse & better)))
    return flags
