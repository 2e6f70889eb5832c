"""Tolerance analysis: spread of outputs by linear propagation and Monte Carlo."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import checked, generator, names_of, number_from_zero
from spatial_pin._support.columns import Quantity, Tabular, chosen
from spatial_pin._support.progress import in_order, progress_bar
from spatial_pin.assembly.assemble import starting_state
from spatial_pin.assembly.state import State, of_mechanism
from spatial_pin.dimensions.sensitivity import sensitivities, with_spread, within_half_turn
from spatial_pin.dimensions.variants import Variants, tell_idle
from spatial_pin.dimensions.varied_samples import DriverMotion, VariedSamples, with_masses
from spatial_pin.errors import SpatialPinError, unless_cut
from spatial_pin.formats.files import load
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.outputs import label_of
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

SOLVED_TOGETHER = 4096  # samples in a call: fewer have more overhead, more leave the cache
MOST_DRAWN = 10_000_000  # they fit into memory, and give spreads to 0.02 %


@dataclass(frozen=True, eq=False)
class Tolerance(Tabular):
    """Spread of outputs when dimensions scatter independently and normally.

    As a table (`columns`, `to_csv`, `to_dataframe`, ...) it has a row for each sample.

    Attributes:
        nominal: the outputs at the nominal dimensions.
        linear: standard deviations by linear propagation.
        sampled: standard deviations of the samples; None without samples.
        mean: mean of the samples; None without.
        samples: (n,), (n, 3) or (n, 6) values by output, of the samples that could be closed.
        failed: number of samples in which the mechanism could not be closed.
        dimensions: (N,) drawn values of each dimension, of all samples [m, rad].
        is_closed: (N,) which samples could be closed: `samples[output]` are those at
            `dimensions[name][is_closed]`.
        units: of the outputs, "1" for none.
        is_whole: whether all samples were solved (no Ctrl-C).

    Example:
        >>> mech = sp.load("rssr")
        >>> result = sp.tolerance(mech, "rocker_pin", {"b": 1e-4, "d": 1e-4}, samples=100)  # [m]
        >>> result.samples["rocker_pin"].shape, result.failed
        ((100,), 0)
        >>> print(f"{result.nominal['rocker_pin']:.4f} ± {result.linear['rocker_pin']:.1e} rad")
        1.2329 ± 9.5e-04 rad
    """

    nominal: dict[str, Any]
    linear: dict[str, Any]
    sampled: dict[str, Any] | None
    mean: dict[str, Any] | None
    samples: dict[str, Array]
    failed: int
    dimensions: dict[str, Array]
    is_closed: NDArray[np.bool_]
    units: dict[str, str] = field(default_factory=dict)
    is_whole: bool = True

    def quantities(self, outputs: str | Iterable[str] | None = None) -> dict[str, Quantity]:
        """Return quantities by name: drawn dimensions, `is closed`, and outputs of the samples.

        Outputs are NaN in samples that could not be closed. Dimensions have the units of the file,
        m or rad, without a unit in the headings.

        Args:
            outputs: names of the quantities; default all.

        Raises:
            UnknownNameError: there is no quantity of a name.
            SpatialPinError: there are no samples.

        Example:
            >>> mech = sp.load("rssr")
            >>> result = sp.tolerance(mech, "rocker_pin", {"b": 1e-4}, samples=100)  # [m]
            >>> list(result.quantities())
            ['b', 'is closed', 'rocker_pin']
        """
        if not len(self.is_closed):
            raise SpatialPinError("there are no samples to make a table of: "
                                  "tolerance(..., samples=1000) draws some")
        table = {name: Quantity(x) for name, x in self.dimensions.items()}
        table["is closed"] = Quantity(self.is_closed.astype(int))
        for name, x in self.samples.items():
            every = np.full((len(self.is_closed), *x.shape[1:]), np.nan)
            every[self.is_closed] = x
            unit = self.units.get(name, "")
            table[name] = Quantity(every, "-" if unit == "1" else unit)
        selected = chosen(table, outputs, "tolerance").items()
        return {key: part for name, x in selected for key, part in _parts(
            label_of(name) if name in self.samples else name, x)}

    def __repr__(self) -> str:
        spreads = [f"{name} = {with_spread(x, self.linear[name], self.units.get(name, ''))}"
                   for name, x in self.nominal.items()]
        return (f"Tolerance({', '.join(spreads)}; {len(self.is_closed)} samples, {self.failed} "
                f"failed{'' if self.is_whole else '; cut short'})")

    def __str__(self) -> str:
        lines = []
        for name, value in self.nominal.items():
            unit = self.units.get(name, "")
            line = f"{name} = {with_spread(value, self.linear[name], unit)} (linear)"
            if self.sampled is not None and self.mean is not None:
                spread = with_spread(self.mean[name], self.sampled[name], unit)
                line += f"; {spread} ({len(self.samples[name])} samples)"
            lines.append(line)
        if self.failed:
            lines.append(f"{self.failed} samples cannot be closed")
        if not self.is_whole:
            lines.append(f"cut short after {len(self.is_closed)} samples")
        return "\n".join(lines)


def _parts(name: str, x: Quantity) -> list[tuple[str, Quantity]]:
    """Return a quantity by its name, a reaction (N, 6) as force and moment."""
    if x.values.shape[1:] != (6,):
        return [(name, x)]
    return [(f"{name} force", Quantity(x.values[:, :3], "N")),
            (f"{name} moment", Quantity(x.values[:, 3:], "N·m"))]


@checked
def tolerance(
    mechanism: Mechanism,
    outputs: str | Iterable[str],
    deviations: Mapping[str, float],
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    samples: int = 0,
    executor: Executor | None = None,
    seed: int = 0,
    progress: bool = False,
    state: Mapping[str, Any] | State | Array | None = None,
) -> Tolerance:
    """Propagate standard deviations of dimensions to outputs, linearly and by Monte Carlo.

    Dimensions scatter independently of each other, each normally about its nominal value. Every
    sample is closed on the branch of the state, however far it moves, or counts as failed because
    the branch ends before it.

    Most samples are solved together in the kernel, with the least motion from the state: the file
    is expanded once with its dimensions traced. Those that move a joint by more than 0.25 rad or
    characteristic lengths are solved again in 4 and then 16 steps of their dimensions. A sample is
    made from the file and followed by itself if that fails, if the determinant of the loops has
    fallen below a fiftieth, or if an `if` or `max` of the file decides otherwise at its dimensions.
    All samples are solved so if the file rounds or prints a number that depends on a dimension, if
    the state is almost singular, and for jerks, transmission angles and limits. Results agree to
    round-off.

    Args:
        mechanism: a mechanism with a xacro tree.
        outputs: names as for `sensitivity`.
        deviations: standard deviation by dimension [m, rad].
        guess: a closed State, whose driver values, speeds and accelerations are kept, or a guess as
            for `assemble`; default the file's guess.
        samples: number of Monte Carlo samples, 0 for none, ten millions at most.
        executor: where to solve them (any `concurrent.futures` executor, a Dask client's too);
            default in this process.
        seed: of the samples.
        progress: show a bar on stderr after a second, if that is a terminal.
        state: another word for `guess`.

    Returns:
        The Tolerance: standard deviations by output [unit of the output].

    Raises:
        UnknownNameError: no such dimension or output.
        ValueError: a deviation is negative or not finite, or a number of samples or a seed cannot
            be.
        Interrupted: after Ctrl-C; `.result` tells of the samples until then.

    Example:
        >>> mech = sp.load("rssr")
        >>> result = sp.tolerance(mech, "rocker_pin", {"b": 1e-4, "d": 1e-4}, samples=500)  # [m]
        >>> print(f"{result.linear['rocker_pin']:.1e} rad, {result.sampled['rocker_pin']:.1e} rad")
        9.5e-04 rad, 9.3e-04 rad
    """
    state = starting_state(mechanism, guess, state)
    names = names_of(outputs, "outputs")
    rng = generator(seed)
    spread = {k: number_from_zero(x, f"deviation of {k!r}") for k, x in deviations.items()}
    for name, x in spread.items():
        if x > TOLERANCES.largest:
            raise ValueError(
                f"deviation of {name!r} is {x:.3g}; it is {TOLERANCES.largest:g} at most")
    if samples == 1 or not 0 <= samples <= MOST_DRAWN:
        raise ValueError(f"samples is {samples}; it is 0 for none, or from 2, for a spread, to "
                         f"{MOST_DRAWN}")
    sensitivity = sensitivities(mechanism, state, names, spread)
    tell_idle(mechanism, spread, [name for name in spread if not any(
        np.any(np.abs(one.derivatives[name]) > one.errors[name]) for one in sensitivity)])
    nominal = {one.output: one.value for one in sensitivity}
    units = {one.output: one.unit for one in sensitivity}
    linear = {one.output: np.sqrt(sum(
        (np.asarray(one.derivatives[name]) * x) ** 2 for name, x in spread.items()))[()]
        for one in sensitivity}
    if not samples:
        return Tolerance(nominal, linear, None, None, {name: np.empty(0) for name in names}, 0,
                         {name: np.empty(0) for name in spread}, np.empty(0, dtype=bool), units)
    normal = rng.normal(size=(samples, len(spread)))
    drawn = np.array([mechanism.dimensions[name] for name in spread]) + np.array(
        list(spread.values())) * normal
    values, is_closed, n = _solved(
        mechanism, of_mechanism(mechanism, state), nominal, spread, drawn, executor, progress)
    is_closed, drawn = is_closed[:n], drawn[:n]
    values = {name: x[:n] for name, x in values.items()}
    good = {name: within_half_turn(x[is_closed], nominal[name], units[name])
            for name, x in values.items()}
    return unless_cut(Tolerance(
        nominal, linear,
        {name: _of_enough(x, 2, lambda x: x.std(axis=0, ddof=1)) for name, x in good.items()},
        {name: _of_enough(x, 1, lambda x: x.mean(axis=0)) for name, x in good.items()},
        good, int(np.count_nonzero(~is_closed)), dict(zip(spread, drawn.T, strict=True)), is_closed,
        units, n == samples,
    ))


def _of_enough(values: Array, fewest: int, what: Callable[[Array], Array]) -> Any:
    """Return a statistic of values (N, ...), NaN for too few."""
    return (what(values) if len(values) >= fewest else np.full(values.shape[1:], np.nan))[()]


def _solved(
    mechanism: Mechanism, state: State, nominal: Mapping[str, Any], spread: Mapping[str, float],
    drawn: Array, executor: Executor | None, progress: bool,
) -> tuple[dict[str, Array], NDArray[np.bool_], int]:
    """Return (N, ...) values by output, which samples (N,) are closed, and how many count.

    After Ctrl-C these are the first ones without a gap.
    """
    names, drive = list(nominal), DriverMotion.of(state)
    values = {name: np.empty((len(drawn), *np.shape(x))) for name, x in nominal.items()}
    is_closed = np.zeros(len(drawn), dtype=bool)
    bar = progress_bar(len(drawn), f"{mechanism.name}: samples", progress)
    samples = None  # what solves them together; nothing does of a rounded file
    if state.mechanism is mechanism:
        samples = VariedSamples.of(spread, names, state, drive)
    n = len(drawn)
    if samples:
        n = _solve_together(samples, drawn, values, is_closed, bar)
    rest = np.flatnonzero(~is_closed[:n]).tolist()
    start, mark = (np.array(state.q), np.array(state.angles)), os.urandom(16).hex()
    jobs = [(mechanism.path, mechanism.loading,
             dict(zip(spread, drawn[k].tolist(), strict=True)), start, drive, names, mark)
            for k in rest]
    outputs = in_order(executor, _sample, jobs)
    k = rest[0] if rest else n
    try:
        for k, sample in zip(rest, outputs, strict=True):
            if sample is not None:
                is_closed[k] = True
                for name, x in zip(names, sample, strict=True):
                    values[name][k] = x
            bar.update()
    except KeyboardInterrupt:
        n = k  # all before it are surely done
        outputs.close()
    bar.close()
    if not n:
        raise KeyboardInterrupt
    return values, is_closed, n


def _solve_together(
    samples: VariedSamples, drawn: Array, values: Mapping[str, Array],
    is_closed: NDArray[np.bool_], bar: Any,
) -> int:
    """Write the values of samples closed together; return how many were tried."""
    begin = 0
    try:
        for begin in range(0, len(drawn), SOLVED_TOGETHER):
            some = slice(begin, begin + SOLVED_TOGETHER)
            is_closed[some], together = samples.solve(drawn[some].T)
            for x, new in zip(values.values(), together, strict=True):
                x[some] = new
            bar.update(int(np.count_nonzero(is_closed[some])))
    except KeyboardInterrupt:  # those before are the answer
        return begin
    return len(drawn)


def _sample(
    path: Path | None, parameters: dict[str, Any], dimensions: dict[str, float],
    nominal: tuple[Array, Array], drive: DriverMotion, names: list[str], mark: str,
) -> list[Any] | None:
    """Return outputs of a sample, in any process; None if it cannot be closed."""
    try:
        variants = _loaded(path, pickle.dumps(parameters), tuple(dimensions), mark)
        own, (q, angles) = variants.mechanism, nominal
        near = State(own, q, closure_error=np.nan, angles=angles)
        return drive.evaluate(variants.at(dimensions, with_masses(own, names)), near, names)
    except SpatialPinError:
        return None


@lru_cache(maxsize=1)
def _loaded(path: Path | None, parameters: bytes, names: tuple[str, ...], mark: str) -> Variants:
    """Load the nominal mechanism, once for all samples of one call with its own mark."""
    assert path is not None
    return Variants(load(path, **pickle.loads(parameters)), names)
