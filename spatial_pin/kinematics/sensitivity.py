"""How outputs change with the dimensions of a mechanism, and with their tolerances.

The geometry of a mechanism is whatever its xacro file computes from the dimensions, so derivatives
are eighth-order central differences of exactly closed mechanisms; the sixth-order value of the
same points tells how far they can be trusted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.kinematics.assembly import assemble
from spatial_pin.kinematics.limits import limits
from spatial_pin.kinematics.motion import Motion
from spatial_pin.kinematics.rates import solve_rates
from spatial_pin.kinematics.state import State, of_mechanism
from spatial_pin.linalg import Array
from spatial_pin.mechanism.configuration import finite_number
from spatial_pin.mechanism.files import load
from spatial_pin.mechanism.mechanism import Mechanism

STEP = 2e-3  # of the dimension; of the characteristic length (1 for angles) when it is zero
EIGHTH = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
SIXTH = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
ROUND_OFF = 4e-15  # relative error of an output, for the error estimate
BRANCH = 0.3  # rad, characteristic lengths: coordinates that move more have left the branch


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of one output with respect to dimensions.

    Attributes:
        output: its name.
        value: the output itself, a number or (3,) [SI, rad].
        derivatives: by dimension, shaped like the value [output unit per m or rad].
        errors: estimated largest error of each derivative.
    """

    output: str
    value: Any
    derivatives: dict[str, Any]
    errors: dict[str, float]

    def __str__(self) -> str:
        lines = [f"{self.output} = {np.array2string(np.asarray(self.value), precision=10)}"]
        lines += [f"  d/d {name} = {np.array2string(np.asarray(d), precision=10)}"
                  f"  (± {self.errors[name]:.0e})" for name, d in self.derivatives.items()]
        return "\n".join(lines)


def sensitivity(
    mechanism: Mechanism,
    state: State,
    output: str,
    parameters: Iterable[str] | None = None,
) -> Sensitivity:
    """Differentiate an output with respect to dimensions, the drivers' motion being the same.

    Args:
        mechanism: a mechanism with a xacro tree.
        state: a closed state; its driver values, speeds and accelerations are kept.
        output: as for `Motion.output` (`rocker_pin`, `rocker_pin.rate`, `coupler.com.velocity`,
            ...), or `limit.lower.DRIVER`, `limit.upper.DRIVER` for the ends of a driver's range.
        parameters: names of dimensions; default all.

    Returns:
        The derivatives with an estimate of their error.

    Raises:
        UnknownNameError: no such dimension or output.
        SpatialPinError: the branch ends, or the output does not exist, at a nearby dimension.
    """
    if mechanism.path is None:
        raise SpatialPinError(f"mechanism {mechanism.name!r} has no file to change dimensions in")
    names = list(mechanism.dimensions if parameters is None else parameters)
    for name in names:
        if name not in mechanism.dimensions:
            raise UnknownNameError("dimension", name, mechanism.dimensions,
                                   f"mechanism {mechanism.name!r}: ")
    state = of_mechanism(mechanism, state)
    drive = _Drive.of(mechanism, state)
    derivatives: dict[str, Any] = {}
    errors: dict[str, float] = {}
    for name in names:
        derivatives[name], errors[name] = _derivative(mechanism, state, drive, output, name)
    return Sensitivity(output, drive.evaluate(mechanism, state, output), derivatives, errors)


def _derivative(
    mechanism: Mechanism, state: State, drive: _Drive, output: str, name: str
) -> tuple[Any, float]:
    value = mechanism.dimensions[name]
    h = STEP * (abs(value) or mechanism.characteristic_length)
    at = {}
    for k in (1, 2, 3, 4):
        for sign in (1, -1):
            changed = varied(mechanism, {name: value + sign * k * h})
            at[sign * k] = np.asarray(drive.evaluate(changed, state, output))
    eighth, sixth = (sum(w * (at[k] - at[-k]) for k, w in weights.items()) / h
                     for weights in (EIGHTH, SIXTH))
    size = max(float(np.max(np.abs(x))) for x in at.values())
    error = float(np.max(np.abs(eighth - sixth))) + ROUND_OFF * size / h
    return (float(eighth) if eighth.ndim == 0 else eighth), error


def varied(mechanism: Mechanism, dimensions: Mapping[str, float]) -> Mechanism:
    """Return the mechanism with some dimensions changed, loaded anew from its files."""
    if mechanism.path is None:
        raise SpatialPinError(f"mechanism {mechanism.name!r} has no file to change dimensions in")
    return load(mechanism.path, **{**mechanism.parameters, **dimensions})


@dataclass(frozen=True)
class _Drive:
    """The drivers' motion of a state: values, speeds, accelerations by coordinate."""

    values: dict[str, float]
    speeds: dict[str, float]
    accelerations: dict[str, float]

    @classmethod
    def of(cls, mechanism: Mechanism, state: State) -> _Drive:
        rates = {d.joint: state.coordinate(d.joint) for d in mechanism.drivers.values()}
        return cls(*({name: r[k] for name, r in rates.items()} for k in range(3)))

    def evaluate(self, mechanism: Mechanism, near: State, output: str) -> Any:
        """Return the output of a mechanism whose drivers move as here, on the branch of `near`."""
        kind, _, driver = output.partition(".")
        end, _, driver = driver.partition(".")
        if kind == "limit" and end in ("lower", "upper"):
            bound = getattr(limits(mechanism, driver, near), end)
            if bound.kind == "none":
                raise SpatialPinError(f"mechanism {mechanism.name!r}: {driver!r} has no limit")
            return bound.value
        state = assemble(mechanism, self.values, near)
        linear = [c for c in mechanism.coordinate_table.values() if c.q >= 0]
        moved = max((abs(state.q[c.q] - near.q[c.q]) / mechanism.velocity_scale[c.v]
                     for c in linear), default=0.0)
        if moved > BRANCH:
            raise SpatialPinError(
                f"mechanism {mechanism.name!r}: no closed configuration of this branch at "
                f"dimensions {dict(mechanism.parameters)}; the nearest is {moved:.2g} away"
            )
        if any(self.speeds.values()) or any(self.accelerations.values()):
            state = solve_rates(mechanism, state, self.speeds, self.accelerations)
        values = _single_row(mechanism, state).output(output).values[0]
        return float(values) if np.ndim(values) == 0 else values


def _single_row(mechanism: Mechanism, state: State) -> Motion:
    driver = next(iter(mechanism.drivers), next(iter(mechanism.coordinates), ""))
    value, speed, _ = state.coordinate(driver)
    return Motion(mechanism, np.array([value]), driver, None, state.q[None], state.v[None],
                  state.a[None], np.array([state.closure_error]), np.array([speed]))


# ---------------------------------------------------------------- tolerances


@dataclass(frozen=True, eq=False)
class Tolerance:
    """Spread of outputs when dimensions scatter independently and normally.

    Attributes:
        nominal: the outputs at the nominal dimensions.
        linear: standard deviations by linear propagation.
        sampled: standard deviations of the samples; None without samples.
        mean: mean of the samples; None without.
        samples: (n,) or (n, 3) values by output.
        failed: samples in which the mechanism could not be closed.
    """

    nominal: dict[str, Any]
    linear: dict[str, Any]
    sampled: dict[str, Any] | None
    mean: dict[str, Any] | None
    samples: dict[str, Array]
    failed: int

    def __str__(self) -> str:
        lines = []
        for name, value in self.nominal.items():
            line = f"{name} = {value} ± {self.linear[name]} (linear)"
            if self.sampled is not None:
                line += f", ± {self.sampled[name]} ({len(self.samples[name])} samples)"
            lines.append(line)
        if self.failed:
            lines.append(f"{self.failed} samples cannot be closed")
        return "\n".join(lines)


def tolerance(
    mechanism: Mechanism,
    outputs: str | Iterable[str],
    deviations: Mapping[str, float],
    state: State | None = None,
    *,
    samples: int = 0,
    executor: Executor | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Tolerance:
    """Propagate standard deviations of dimensions to outputs, linearly and by Monte Carlo.

    Args:
        mechanism: a mechanism with a xacro tree.
        outputs: names as for `sensitivity`.
        deviations: standard deviation by dimension [m, rad].
        state: a closed state; its driver values, speeds and accelerations are kept; default the
            assembled guess.
        samples: number of Monte Carlo samples, 0 for none.
        executor: where to solve them (any `concurrent.futures` executor, a Dask client's too);
            default in this process.
        seed: of the samples.
        progress: show a bar on stderr after a second, if that is a terminal.

    Raises:
        UnknownNameError: no such dimension or output.
        ValueError: a deviation is negative or not finite.
    """
    state = state or assemble(mechanism)
    names = [outputs] if isinstance(outputs, str) else list(outputs)
    spread = {k: finite_number(x, f"deviation of {k!r}") for k, x in deviations.items()}
    if any(x < 0.0 for x in spread.values()):
        raise ValueError("a standard deviation is negative")
    nominal, linear = {}, {}
    for name in names:
        found = sensitivity(mechanism, state, name, spread)
        nominal[name] = found.value
        parts = [(np.asarray(found.derivatives[k]) * x) ** 2 for k, x in spread.items()]
        linear[name] = np.sqrt(sum(parts))[()]
    rows = _sampled(mechanism, state, names, spread, samples, executor, seed, progress)
    good = [row for row in rows if row is not None]
    values = {name: np.array([row[i] for row in good]) for i, name in enumerate(names)}
    return Tolerance(
        nominal, linear,
        {name: x.std(axis=0, ddof=1)[()] for name, x in values.items()} if samples else None,
        {name: x.mean(axis=0)[()] for name, x in values.items()} if samples else None,
        values, len(rows) - len(good),
    )


def _sampled(
    mechanism: Mechanism, state: State, names: list[str], spread: Mapping[str, float],
    samples: int, executor: Executor | None, seed: int, progress: bool,
) -> list[list[Any] | None]:
    if not samples:
        return []
    rng = np.random.default_rng(seed)
    drive = _Drive.of(mechanism, state)
    jobs = [
        (str(mechanism.path), {**mechanism.parameters, **{
            k: mechanism.dimensions[k] + x * float(rng.normal()) for k, x in spread.items()}},
         (np.array(state.q), np.array(state.angles)), drive, names)
        for _ in range(samples)
    ]
    bar = tqdm(total=samples, desc=f"{mechanism.name}: samples", delay=1.0, leave=False,
               disable=None if progress else True)
    rows = []
    futures = [executor.submit(_sample, job) for job in jobs] if executor else []
    solved = (future.result() for future in futures) if executor else map(_sample, jobs)
    for row in solved:
        rows.append(row)
        bar.update()
    bar.close()
    return rows


def _sample(
    job: tuple[str, dict[str, float], tuple[Array, Array], _Drive, list[str]]
) -> list[Any] | None:
    """Solve one sample; None when it cannot be closed. Runs in any process."""
    path, parameters, (q, angles), drive, names = job
    try:
        mechanism = load(path, **parameters)
        near = State(mechanism, q, closure_error=np.nan, angles=angles)
        return [drive.evaluate(mechanism, near, name) for name in names]
    except SpatialPinError:
        return None
