"""Sensitivity: derivatives of outputs for the dimensions of a mechanism.

Derivatives are those of the closed state (`changed_state`). The xacro file can compute the geometry
from dimensions in any way, so how that changes is an eighth-order central difference. The
sixth-order value of the same points gives the error estimate. The file is expanded once
(`variants`). What has no derivative of its own is differenced likewise, over closed mechanisms.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from spatial_pin._support.brief import brief
from spatial_pin._support.checks import checked, names_of
from spatial_pin.assembly.holding import BASE
from spatial_pin.assembly.state import State, of_mechanism
from spatial_pin.dimensions.bounds import check_dimensions
from spatial_pin.dimensions.changed_state import Load, output_changes
from spatial_pin.dimensions.closed_derivatives import (
    ClosedDerivatives,
    InputChanges,
    fixed_entries,
)
from spatial_pin.dimensions.moved_geometry import (
    AROUND,
    EIGHTH,
    SHORTER,
    SIXTH,
    MovedGeometry,
    difference_steps,
    moved_geometry,
)
from spatial_pin.dimensions.variants import Variants, idle_dimensions, tell_idle
from spatial_pin.dimensions.varied_samples import (
    DriverMotion,
    end_of_range,
    with_force_values,
    with_masses,
)
from spatial_pin.dynamics.force_outputs import rule_of
from spatial_pin.errors import Interrupted, SingularError, SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion, first_samples
from spatial_pin.motion.outputs import named_output
from spatial_pin.numerics.linalg import Array, whole_turns
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.prescribed import (
    Prescription,
    chosen_at,
    driven_coordinates,
    solved_at,
    solved_by,
)

CONFIGURATION_ERROR = 4e-15  # of a well-conditioned one, for the error estimate: 18 epsilon


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of one output for dimensions.

    Attributes:
        output: its name.
        value: the output itself, a number, (3,), or (6,) for a reaction [SI, rad]; for a motion
            (N,), (N, 3) or (N, 6).
        derivatives: by dimension, shaped like the value [output unit per m or rad].
        errors: estimated largest error of each derivative; (N,) for a motion.
        unit: of the value, "" or "1" for none.
        idle: dimensions that change nothing in the mechanism's file.

    Example:
        >>> mech = sp.load("rssr")
        >>> result = sp.sensitivity(mech, sp.assemble(mech, {"crank": 1.0}), "rocker_pin", ["b"])
        >>> print(f"{result.value:.4f} {result.unit}, {result.derivatives['b']:.4f} rad/m")
        1.5232 rad, -5.8005 rad/m
    """

    output: str
    value: Any
    derivatives: dict[str, Any]
    errors: dict[str, Any]
    unit: str = ""
    idle: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return brief(self, value=self.unit.removeprefix("1"))

    def __str__(self) -> str:
        lines = [f"{self.output} = {_words(self.value)} {self.unit.removeprefix('1')}".rstrip()]
        unit = f" [{unit_of_derivative(self.unit)}]" if self.unit else ""
        for name, derivative in self.derivatives.items():
            error = np.reshape(self.errors[name], np.shape(self.errors[name]) + (1,) * (
                np.ndim(derivative) - np.ndim(self.errors[name])))
            d = np.where(np.abs(derivative) <= error, 0.0, derivative)  # the rest is noise
            lines.append(f"  d/d {name} = 0: it changes nothing in the file" if name in self.idle
                         else f"  d/d {name} = {_words(d)}  (± {np.max(error, initial=0.0):.0e})"
                         f"{unit}")
        return "\n".join(lines)


def unit_of_derivative(unit: str) -> str:
    """Return the unit of an output's derivative, for a length or an angle."""
    unit = f"({unit})" if set(unit) & set("/,·") else unit or "1"
    return f"{unit}/m or {unit}/rad"


def _words(x: Any) -> str:
    """Return a number or a short array as text: ten decimals, or ten digits of large ones."""
    return np.array2string(np.asarray(x), precision=10, max_line_width=10**6, formatter={
        "float": lambda v: f"{v:.10f}".rstrip("0").rstrip(".") if 1e-3 <= abs(v) < 1e6 or v == 0.0
        else f"{v:.10g}"})


@checked
def sensitivity(
    mechanism: Mechanism,
    state: State | Motion,
    output: str,
    parameters: Iterable[str] | None = None,
) -> Sensitivity:
    """Differentiate an output for dimensions, at fixed motion of the drivers.

    In a motion, each sample counts as a state by itself: values and derivatives are (N,) or (N, 3),
    errors (N,). All drivers are fixed.

    Args:
        mechanism: a mechanism with a xacro tree.
        state: a closed state, whose driver values, speeds and accelerations are fixed; or a motion.
        output: as for `Motion.output` (`rocker_pin`, `rocker_pin.rate`, `coupler.com.velocity`,
            ...), or for `Kinetostatics.output` (`crank.effort`, `ball_b.reaction.force`, ...; at
            rest if rates are not those in time; the least one if a reaction is not unique), or
            `limit.lower.DRIVER`, `limit.upper.DRIVER` for the ends of a driver's range.
        parameters: names of dimensions; default all.

    Returns:
        The derivatives with an estimate of their error. A warning names dimensions that change
        nothing in the file.

    Raises:
        UnknownNameError: no such dimension or output.
        SpatialPinError: the branch ends, or the output does not exist, at a nearby dimension.
        Interrupted: after Ctrl-C in a motion; `.result` has the derivatives until then.

    Example:
        >>> mech = sp.load("rssr")
        >>> state = sp.assemble(mech, {"crank": 1.0})
        >>> result = sp.sensitivity(mech, state, "rocker_pin", ["b", "d"])
        >>> {name: round(float(x), 4) for name, x in result.derivatives.items()}  # [rad/m]
        {'b': -5.8005, 'd': 4.1254}
    """
    if isinstance(state, Motion):
        if not len(state):
            raise SpatialPinError(f"mechanism {mechanism.name!r}: the motion has no samples")
        several = [x[0] for x in _differentiated(
            mechanism, [(of_mechanism(mechanism, one), DriverMotion.along(state, one))
                        for one in map(state.state, range(len(state)))], [output], parameters)]
        derivatives, errors = (
            {name: np.array([each[name] for each in parts]) for name in parts[0]}
            for parts in ([x.derivatives for x in several], [x.errors for x in several]))
        unit = (several[0].unit if end_of_range(output) or with_force_values([output])
                else state.output(output).unit)
        result = Sensitivity(
            output, np.array([x.value for x in several]), derivatives, errors, unit)
    else:
        result = sensitivities(mechanism, state, [output], parameters)[0]
    still = [name for name, x in result.derivatives.items()
             if np.all(np.abs(x).T <= np.asarray(result.errors[name]).T)]
    if parameters is not None:
        tell_idle(mechanism, result.derivatives, still)
    result = replace(result, idle=idle_dimensions(mechanism, result.derivatives, still))
    if isinstance(state, Motion) and len(result.value) < len(state):
        raise Interrupted(first_samples(state, len(result.value)), result)
    return result


def sensitivities(
    mechanism: Mechanism,
    state: State,
    outputs: Sequence[str],
    parameters: Iterable[str] | None = None,
) -> list[Sensitivity]:
    """Differentiate several outputs at the price of one; see `sensitivity`."""
    state = of_mechanism(mechanism, state)
    return _differentiated(mechanism, [(state, DriverMotion.of(state))], outputs, parameters)[0]


def _differentiated(
    mechanism: Mechanism, samples: Sequence[tuple[State, DriverMotion]], outputs: Iterable[str],
    parameters: Iterable[str] | None,
) -> list[list[Sensitivity]]:
    """Differentiate outputs at states of one mechanism, each with its drivers' motion.

    After Ctrl-C the result has the states until then, if there are any.
    """
    outputs = names_of(outputs, "outputs")
    names = names_of(mechanism.dimensions if parameters is None else parameters, "parameters")
    check_dimensions(mechanism, names)
    around = _Around(samples[0][0].mechanism, names, outputs)
    results: list[list[Sensitivity]] = []
    try:
        for state, drive in samples:
            results.append(around.differentiated(state, drive))
    except KeyboardInterrupt:
        if not results:
            raise
    return results


class _Around:
    """Derivatives of outputs by dimensions: of closed states, else of closed mechanisms around.

    The latter count where an output, such as a limit, has no derivative of its own, and where it is
    the least one of many.
    """

    def __init__(self, mechanism: Mechanism, names: list[str], outputs: list[str]) -> None:
        self._mechanism, self._names, self._outputs = mechanism, names, outputs
        self._variants = Variants(mechanism, names)
        self._heavy = with_masses(mechanism, outputs)
        self._made: dict[tuple[str, float], list[Mechanism]] = {}  # for all states
        named = [None if end_of_range(x) else named_output(mechanism, x) for x in outputs]
        self._known = {k: x for k, x in enumerate(named) if x is not None
                       and rule_of(x).needs != "motion"}
        own = np.array([mechanism.dimensions[name] for name in names])
        self._steps = difference_steps(mechanism, own)

    @cached_property
    def _geometry(self) -> MovedGeometry:
        return moved_geometry(self._mechanism, self._variants, self._heavy, (EIGHTH, SIXTH))

    def differentiated(self, state: State, drive: DriverMotion) -> list[Sensitivity]:
        """Return the derivatives of the outputs at a state."""
        values = drive.evaluate(state.mechanism, state, self._outputs)
        sizes, pivot = _sizes(state, drive, self._outputs), _smallest_pivot(state)
        known = CONFIGURATION_ERROR / pivot  # [rad, lengths]; it changes the pivot by as much
        changes = self._changes(state, drive)
        results, n = [], len(self._names)
        for k, (output, value) in enumerate(zip(self._outputs, values, strict=True)):
            one = Sensitivity(output, value, {}, {}, _unit(state, drive, output))
            size = max(float(np.max(np.abs(value))), sizes.get(one.unit, 0.0))
            for i, name in enumerate(self._names):
                if k in changes:
                    eighth, sixth = (changes[k][:, j].reshape(np.shape(value)) for j in (i, n + i))
                    h = float(self._geometry.steps[i])
                else:
                    around, h = self._one_by_one(state, drive, i)
                    at = np.array([within_half_turn(np.asarray(x[k]), value, one.unit)
                                   for x in around])
                    eighth, sixth = (np.tensordot(w / h, at, 1) for w in (EIGHTH, SIXTH))
                one.derivatives[name] = float(eighth) if np.ndim(eighth) == 0 else eighth
                one.errors[name] = float(np.max(np.abs(eighth - sixth)) + known * size / h
                                         + known / pivot * np.max(np.abs(eighth)))
            results.append(one)
        return results

    def _changes(self, state: State, drive: DriverMotion) -> dict[int, Array]:
        """Return the derivatives (size, 2 n) of eighth and sixth order by number of an output.

        Those that have none at the state are missing.
        """
        mechanism, n = state.mechanism, len(self._names)
        changes: dict[int, Array] = {}
        driven = list(dict.fromkeys(map(mechanism.driven_coordinate, drive.values)))
        still = fixed_entries(mechanism, driven)
        rates = np.zeros((len(driven), 2 * n))
        given = InputChanges(
            rates, rates, rates, np.zeros((mechanism.model.nv, 2 * n)), np.eye(2 * n))
        for forces in (False, True):
            some = {k: x for k, x in self._known.items() if (x.family == "force") == forces}
            if not some or not self._names:
                continue
            try:
                there, load = drive.state(mechanism, state), None
                if forces:
                    load = Load.of_sample(drive.outputs_at(there).loads, 0, True)
                    there = there if drive.in_time else _at_rest(there)
                speed = there.coordinate(drive.driver).rate
                found = output_changes(ClosedDerivatives(self._geometry, there, driven, still),
                                       given, load, some.values(), speed)
            except SpatialPinError:
                continue
            size = mechanism.characteristic_length
            for k, x in zip(some, found, strict=True):
                loose = np.abs(x[:, 2 * n :]).max(initial=0.0)
                if np.isfinite(x).all() and loose <= TOLERANCES.half_precision * (
                        size + np.abs(x).max(initial=0.0)):
                    changes[k] = x
        return changes

    def _one_by_one(
        self, state: State, drive: DriverMotion, i: int
    ) -> tuple[list[list[Any]], float]:
        """Return the outputs at eight values of a dimension, and the step.

        The step is shorter if the branch ends within it.
        """
        name, first = self._names[i], None
        value = self._mechanism.dimensions[name]
        for h in self._steps[i] * np.array(SHORTER):
            try:
                if (name, h) not in self._made:
                    self._made[name, h] = self._variants.several(
                        [{name: float(value + k * h)} for k in AROUND], self._heavy)
                return [drive.evaluate(there, state, self._outputs)
                        for there in self._made[name, h]], float(h)
            except SpatialPinError as error:
                first = first or error
        assert first is not None
        raise first


def within_half_turn(values: Array, own: Any, unit: str) -> Array:
    """Return angles within half a turn of a given one; the angle of a link may jump by turns."""
    if unit != "rad":
        return values
    return values - whole_turns(values - own)


def _at_rest(state: State) -> State:
    return State(state.mechanism, state.q, closure_error=state.closure_error,
                 angles=state.angles if state.angles.size else None)


def _smallest_pivot(state: State) -> float:
    """Return the smallest pivot of the closure equations by the largest.

    A configuration is known to round-off by it, and derivatives to that by it once more. It is 1
    where the drivers do not determine the motion.
    """
    mechanism = state.mechanism
    given = Prescription.of(mechanism, driven_coordinates(mechanism, mechanism.drivers), BASE)
    try:
        facts = solved_by(state, given, ("facts",), lambda at, _: solved_at(
            at, given, ("facts",), chosen=chosen_at(at, given)))[0]
        return float(facts.item(0))
    except SingularError:
        return 1.0


def _sizes(state: State, drive: DriverMotion, outputs: Iterable[str]) -> dict[str, float]:
    """Return the size of outputs by unit, at these or other dimensions."""
    length, scale = state.mechanism.characteristic_length, state.mechanism.velocity_scale
    speed, acceleration = (float(np.abs(x / scale).max(initial=0.0)) for x in (state.v, state.a))
    per_s2 = max(acceleration, speed**2)
    force = 0.0  # the largest in the mechanism, moments divided by its length
    if with_force_values(outputs):
        loads = drive.outputs_at(state).loads
        wrenches = np.vstack([loads.on_ground, *loads.reactions.values()])
        force = float(np.abs(wrenches / ([1.0] * 3 + [length] * 3)).max())
    return {"rad": 1.0, "1": 1.0, "m": length, "m/rad": length, "rad/m": 1.0 / length,
            "rad/s": speed, "m/s": speed * length, "rad/s²": per_s2, "m/s²": per_s2 * length,
            "N": force, "N·m": force * length, "N, N·m": force * max(1.0, length),
            "W": force * length * speed}


def _unit(state: State, drive: DriverMotion, output: str) -> str:
    end = end_of_range(output)
    if end is not None:
        return state.mechanism.coordinate(end[1]).unit
    return drive.outputs_at(state).output(output).unit


def with_spread(value: Any, deviation: Any, unit: str = "") -> str:
    """Return a value, or a vector, ± its standard deviation, with significant digits.

    The deviation has two digits, the value as many decimals; 12 digits without a deviation.
    """
    if np.ndim(value):
        parts = [with_spread(x, dx) for x, dx in zip(value, deviation, strict=True)]
        return f"[{', '.join(parts)}] {unit.removeprefix('1')}".rstrip()
    size = max(abs(value), deviation)
    if not np.isfinite(size):
        text = f"{value:.6g} ± {deviation:.2g}"
    elif deviation <= TOLERANCES.round_off * abs(value):
        text = f"{value:.12g} ± 0"
    elif 1e-4 <= size < 1e6 and deviation > 1e-9:
        decimals = max(1 - int(np.floor(np.log10(deviation))), 0)
        text = f"{value:.{decimals}f} ± {deviation:.{decimals}f}"
    else:
        power = int(np.floor(np.log10(size)))
        decimals = max(1 - int(np.floor(np.log10(deviation))) + power, 0)
        value, deviation = value / 10.0**power, deviation / 10.0**power
        text = f"({value:.{decimals}f} ± {deviation:.{decimals}f})e{power}"
    return f"{text} {unit.removeprefix('1')}".rstrip()
