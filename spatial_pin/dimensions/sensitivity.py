"""How outputs change with the dimensions of a mechanism.

The geometry of a mechanism is whatever its xacro file computes from the dimensions, so derivatives
are eighth-order central differences of exactly closed mechanisms; the sixth-order value of the
same points tells how far they can be trusted. The file is expanded once (`variants`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State, of_mechanism
from spatial_pin.checks import checked, names_of
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.dimensions.variants import Variants
from spatial_pin.errors import SingularError, SpatialPinError, UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.limits import limits
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.rates import solve_rates, square_system

STEP = 2e-3  # of the dimension; of the characteristic length (1 for angles) when it is zero
EIGHTH = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
AROUND = (1, -1, 2, -2, 3, -3, 4, -4)  # steps at which outputs are taken
SIXTH = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
ROUND_OFF = 4e-15  # error of a well-conditioned configuration, for the error estimate
NO_SPREAD = 1e-14  # standard deviation, by the value, that is round-off


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of one output with respect to dimensions.

    Attributes:
        output: its name.
        value: the output itself, a number or (3,) [SI, rad].
        derivatives: by dimension, shaped like the value [output unit per m or rad].
        errors: estimated largest error of each derivative.
        unit: of the value, "" or "1" when it has none.
    """

    output: str
    value: Any
    derivatives: dict[str, Any]
    errors: dict[str, float]
    unit: str = ""

    def __str__(self) -> str:
        lines = [f"{self.output} = {np.array2string(np.asarray(self.value), precision=10)}"
                 f" {self.unit.removeprefix('1')}".rstrip()]
        for name, derivative in self.derivatives.items():
            error = self.errors[name]
            d = np.where(np.abs(derivative) <= error, 0.0, derivative)  # what is left is noise
            lines.append(f"  d/d {name} = {np.array2string(d, precision=10)}  (± {error:.0e})")
        return "\n".join(lines)


@checked
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
    return sensitivities(mechanism, state, [output], parameters)[0]


def sensitivities(
    mechanism: Mechanism,
    state: State,
    outputs: Sequence[str],
    parameters: Iterable[str] | None = None,
) -> list[Sensitivity]:
    """Differentiate several outputs at the price of one; see `sensitivity`."""
    if mechanism.path is None:
        raise SpatialPinError(f"mechanism {mechanism.name!r} has no file to change dimensions in")
    outputs = names_of(outputs, "outputs")
    names = names_of(mechanism.dimensions if parameters is None else parameters, "parameters")
    for name in names:
        if name not in mechanism.dimensions:
            raise UnknownNameError("dimension", name, mechanism.dimensions,
                                   f"mechanism {mechanism.name!r}: ")
    state = of_mechanism(mechanism, state)
    mechanism = state.mechanism
    drive = Drive.of(mechanism, state)
    found = [Sensitivity(output, value, {}, {}, _unit(mechanism, state, output))
             for output, value in zip(outputs, drive.evaluate(mechanism, state, outputs),
                                      strict=True)]
    known, sizes = _known(mechanism, state), _sizes(mechanism, state)

    def size(one: Sensitivity) -> float:
        return max(float(np.max(np.abs(one.value))), sizes.get(one.unit, 0.0))

    variants = Variants(mechanism, names)
    for name in names:
        around, h = _around(variants, state, drive, outputs, name)
        for i, one in enumerate(found):
            at = {k: np.asarray(values[i]) for k, values in around.items()}
            one.derivatives[name], one.errors[name] = _derivative(at, h, known * size(one))
    return found


def _around(
    variants: Variants, state: State, drive: Drive, outputs: Sequence[str], name: str
) -> tuple[dict[int, list[Any]], float]:
    """Return the outputs at eight values of a dimension about its own, and their step.

    Where the branch ends within them, the steps are shorter.

    Raises:
        SpatialPinError: it ends within the shortest.
    """
    mechanism = variants.mechanism
    value = mechanism.dimensions[name]
    step = STEP * (abs(value) or mechanism.characteristic_length)
    first: SpatialPinError | None = None
    for h in (step, step / 8.0, step / 64.0, step / 512.0):
        try:
            around = variants.several([{name: value + k * h} for k in AROUND])
            return {k: drive.evaluate(there, state, outputs)
                    for k, there in zip(AROUND, around, strict=True)}, h
        except SpatialPinError as error:
            first = first or error
    assert first is not None
    raise first


def _known(mechanism: Mechanism, state: State) -> float:
    """Return the round-off of closed configurations [rad, characteristic lengths].

    What closure equations leave of it grows as the smallest pivot, by the largest, gets small.
    """
    try:
        with square_system(state, [d.joint for d in mechanism.drivers.values()]) as system:
            return ROUND_OFF / system.pivots()[1]
    except SingularError:
        return ROUND_OFF


def _sizes(mechanism: Mechanism, state: State) -> dict[str, float]:
    """Return how large outputs of a unit are, or may be at other dimensions."""
    length = mechanism.characteristic_length
    speed, acceleration = (float(np.abs(x / mechanism.velocity_scale).max(initial=0.0))
                           for x in (state.v, state.a))
    per_s2 = max(acceleration, speed**2)
    return {"rad": 1.0, "1": 1.0, "m": length, "rad/s": speed, "m/s": speed * length,
            "rad/s²": per_s2, "m/s²": per_s2 * length}


def _unit(mechanism: Mechanism, state: State, output: str) -> str:
    """Return the unit of an output that exists."""
    kind, _, rest = output.partition(".")
    end, _, driver = rest.partition(".")
    if kind == "limit" and end in ("lower", "upper"):
        return mechanism.coordinate(driver).unit
    return _single_row(mechanism, state).output(output).unit


def with_spread(value: Any, deviation: Any, unit: str = "") -> str:
    """Return a value, or a vector, ± its standard deviation, digits as that warrants.

    Of a deviation two digits are told, of its value as many places; 12 digits where none scatters.
    """
    if np.ndim(value):
        parts = [with_spread(x, dx) for x, dx in zip(value, deviation, strict=True)]
        return f"[{', '.join(parts)}] {unit.removeprefix('1')}".rstrip()
    size = max(abs(value), deviation)
    if not np.isfinite(size):
        text = f"{value:.6g} ± {deviation:.2g}"
    elif deviation <= NO_SPREAD * abs(value):
        text = f"{value:.12g} ± 0"
    elif 1e-4 <= size < 1e6 and deviation > 1e-9:
        places = max(1 - int(np.floor(np.log10(deviation))), 0)
        text = f"{value:.{places}f} ± {deviation:.{places}f}"
    else:
        power = int(np.floor(np.log10(size)))
        places = max(1 - int(np.floor(np.log10(deviation))) + power, 0)
        text = f"({value / 10.0**power:.{places}f} ± {deviation / 10.0**power:.{places}f})e{power}"
    return f"{text} {unit.removeprefix('1')}".rstrip()


def _derivative(at: Mapping[int, Array], h: float, known: float) -> tuple[Any, float]:
    """Return a derivative and its error from values at k steps h that are known to `known`."""
    eighth, sixth = (np.asarray(sum(w * (at[k] - at[-k]) for k, w in weights.items())) / h
                     for weights in (EIGHTH, SIXTH))
    error = float(np.max(np.abs(eighth - sixth))) + known / h
    return (float(eighth) if eighth.ndim == 0 else eighth), error


@dataclass(frozen=True)
class Drive:
    """The drivers' motion of a state: values, speeds, accelerations by coordinate."""

    values: dict[str, float]
    speeds: dict[str, float]
    accelerations: dict[str, float]

    @classmethod
    def of(cls, mechanism: Mechanism, state: State) -> Drive:
        """Return the motion of a mechanism's drivers in a state."""
        rates = {d.joint: state.coordinate(d.joint) for d in mechanism.drivers.values()}
        return cls(*({name: r[k] for name, r in rates.items()} for k in range(3)))

    def evaluate(self, mechanism: Mechanism, near: State, outputs: Sequence[str]) -> list[Any]:
        """Return outputs of a mechanism whose drivers move as here.

        Args:
            mechanism: the mechanism.
            near: a closed state of it at these or other dimensions, whose branch is followed.
            outputs: as for `sensitivity`.
        """
        row: Motion | None = None
        found = []
        for output in outputs:
            kind, _, driver = output.partition(".")
            end, _, driver = driver.partition(".")
            if kind == "limit" and end in ("lower", "upper"):
                bound = getattr(limits(mechanism, driver, near), end)
                if bound.kind == "none":
                    raise SpatialPinError(f"mechanism {mechanism.name!r}: {driver!r} has no limit")
                found.append(bound.value)
                continue
            if row is None:
                row = _single_row(mechanism, self._state(mechanism, near))
            values = row.output(output).values[0]
            found.append(float(values) if np.ndim(values) == 0 else values)
        return found

    def _state(self, mechanism: Mechanism, near: State) -> State:
        state = followed(mechanism, self.values, near)
        if any(self.speeds.values()) or any(self.accelerations.values()):
            state = solve_rates(mechanism, state, self.speeds, self.accelerations)
        return state


def _single_row(mechanism: Mechanism, state: State) -> Motion:
    driver = next(iter(mechanism.drivers), next(iter(mechanism.coordinates), ""))
    value, speed, _ = state.coordinate(driver)
    return Motion(mechanism, np.array([value]), driver, None, state.q[None], state.v[None],
                  state.a[None], np.array([state.closure_error]), np.array([speed]))
