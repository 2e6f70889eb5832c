"""Forces over a motion by their names: efforts, powers, reactions, the wrench on the ground."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from spatial_pin._support.checks import names_of
from spatial_pin._support.columns import Quantity
from spatial_pin._support.lazy import cached_property
from spatial_pin.dynamics.coupling_forces import CouplingForce, coupling_forces
from spatial_pin.dynamics.kinetostatics import Kinetostatics, kinetostatics
from spatial_pin.dynamics.simulation.result import Simulation, driver_names
from spatial_pin.errors import UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion, Output
from spatial_pin.motion.outputs import (
    EFFORT,
    ON_GROUND,
    NamedOutput,
    OutputKind,
    abscissas,
    is_force,
    named,
    named_output,
    output as output_of_motion,
    quantities as quantities_of_motion,
)
from spatial_pin.motion.summary import EFFORTS
from spatial_pin.numerics.linalg import Array

ENERGIES = ("energy", "work")  # of a simulation


def output(loads: Any, spec: str) -> Output:
    """Return a force by its name, or a quantity of the motion; see `Kinetostatics.output`."""
    is_effort = _own_name(loads.motion.mechanism, spec, loads.efforts) is not None
    x = named_output(loads.motion.mechanism, f"{spec}.{EFFORT}" if is_effort else spec)
    if x is None or x.family != "force":
        return loads.motion.output(spec)
    return x.of_samples(loads, FORCES[x.kind])


def rule_of(x: NamedOutput) -> OutputKind:
    """Return the rule of any output, a force's too."""
    return FORCES[x.kind] if x.family == "force" else x.rule


def names(loads: Kinetostatics) -> list[str]:
    """Return the names of all forces."""
    return [*(f"{name}.{kind}" for kind in ("effort", "power") for name in loads.efforts),
            *(f"{name}.reaction" for name in loads.reactions), "on_ground"]


def quantities(
    loads: Kinetostatics, outputs: str | Iterable[str] | None = None
) -> dict[str, Quantity]:
    """Return time, driver, and outputs or all forces; see `Kinetostatics.quantities`."""
    chosen = names(loads) if outputs is None else names_of(outputs, "outputs")
    return {**abscissas(loads.motion), **named(output(loads, name) for name in chosen)}


class NamedOutputs:
    """Outputs of a motion by name; its forces are solved at the first use.

    Args:
        motion: the motion.
        in_time: whether its rates are those in time; where they are not, forces are those at rest.
    """

    def __init__(self, motion: Motion, in_time: bool) -> None:
        self.motion, self._in_time = motion, in_time

    def output(self, name: str) -> Output:
        """Return a quantity or a force by its name.

        Raises:
            SpatialPinError: there is none of the name, or forces cannot be worked out.
        """
        return (self.loads if is_force(name) else self.motion).output(name)

    @cached_property
    def loads(self) -> Kinetostatics:
        """The forces."""
        per = "s" if self._in_time else "sample"
        return kinetostatics(self.motion.mechanism, replace(self.motion, per=per))


def with_force_values(
    motion: Motion, outputs: Iterable[str], loads: Callable[[], Kinetostatics]
) -> list[str | Output]:
    """Return outputs of a motion; names of forces are replaced by their values.

    Args:
        motion: the motion.
        outputs: names of quantities of the motion and of its loads.
        loads: returns the loads; not called if no name is a force, or if the motion is a simulation
            that has it.

    Raises:
        UnknownNameError: there is no such force.
        SpatialPinError: the loads cannot be worked out.
    """
    expanded: list[str | Output] = []
    for name in outputs:
        is_own = isinstance(motion, Simulation) and _prescribed_effort(motion, name)
        if is_force(name) and not is_own:
            expanded += output(loads(), name).parts()
        else:
            expanded.append(name)
    return expanded


def _own_name(mechanism: Mechanism, name: str, efforts: Mapping[str, Array]) -> str | None:
    """Return the name in `efforts` of a driver, or of the joint or coordinate it drives."""
    if name in efforts:
        return name
    if name not in mechanism.drivers and name not in mechanism.coordinate_table:
        return None
    coordinate = mechanism.coordinate(name).name
    either = (coordinate, driver_names(mechanism).get(coordinate))
    return next((x for x in either if x in efforts), None)


def _effort_of(kind: str) -> OutputKind:
    """Return the effort or the power of a driver."""
    def name(loads: Any, x: NamedOutput) -> str:
        own = _own_name(loads.motion.mechanism, x.of, loads.efforts)
        if own is None:
            raise _unknown(loads, x)
        return own

    def unit(loads: Any, x: NamedOutput) -> str:
        return "W" if kind == "power" else EFFORTS[
            loads.motion.mechanism.coordinate(name(loads, x)).unit]

    return OutputKind(
        lambda loads, x: (loads.power if kind == "power" else loads.efforts)[name(loads, x)], unit,
        order=int(kind == "power"), needs="forces",
        label=lambda loads, x: f"{name(loads, x)} {kind}")


def _coupling(loads: Any, name: str) -> CouplingForce | None:
    """Return a coupling that does not say where it acts: its reaction is about its last joint."""
    mechanism = loads.motion.mechanism.whole or loads.motion.mechanism
    return next((c for c in coupling_forces(mechanism) if c.name == name), None)


def _wrench_of(part: str) -> OutputKind:
    """Return a reaction (N, 6), or the shaking wrench, its force or its moment (N, 3).

    Of a coupling that does not say where it acts, what it does about its last joint (N,).
    """
    def values(loads: Any, x: NamedOutput) -> Array:
        if x.kind in ON_GROUND or x.of in loads.reactions:
            wrench: Array = loads.on_ground if x.kind in ON_GROUND else loads.reactions[x.of]
            return wrench[:, {"": slice(6), "force": slice(3), "moment": slice(3, 6)}[part]]
        coupling = _coupling(loads, x.of)
        if coupling is None or part:
            raise _unknown(loads, x)
        return coupling.effort(loads.multipliers)

    def unit(loads: Any, x: NamedOutput) -> str:
        if x.kind in ON_GROUND or x.of in loads.reactions:
            return {"": "N, N·m", "force": "N", "moment": "N·m"}[part]
        coupling, mechanism = _coupling(loads, x.of), loads.motion.mechanism
        table = list((mechanism.whole or mechanism).coordinate_table.values())
        return EFFORTS[table[coupling.last].unit] if coupling else ""

    return OutputKind(values, unit, size=3 if part else 6, needs="forces")


def _unknown(loads: Any, x: NamedOutput) -> UnknownNameError:
    return UnknownNameError("force", x.spec, names(loads),
                            f"loads of mechanism {loads.motion.mechanism.name!r}: ")


FORCES = {EFFORT: _effort_of(EFFORT), "power": _effort_of("power"), **{
    f"{of}{end}": _wrench_of(end[1:]) for of in ("reaction", "on_ground")
    for end in ("", ".force", ".moment")}}


def _prescribed_effort(motion: Simulation, spec: str) -> Output | None:
    """Return the effort of a prescribed driver of a simulation; None for other names."""
    name = spec.removesuffix(f".{EFFORT}")
    own = _own_name(motion.mechanism, name, motion.efforts) if name != spec else None
    return None if own is None else Output(
        motion.efforts[own], f"{own} {EFFORT}", EFFORTS[motion.mechanism.coordinate(own).unit])


def output_of_simulation(motion: Simulation, spec: str) -> Output:
    """Return an energy, the effort of a prescribed driver, or an output of any motion."""
    if spec in ENERGIES and spec not in motion.mechanism.coordinate_table:
        return Output(getattr(motion, spec), spec, "J")
    return _prescribed_effort(motion, spec) or output_of_motion(motion, spec)


def quantities_of_simulation(
    motion: Simulation, outputs: str | Iterable[str] | None = None
) -> dict[str, Quantity]:
    """Return the quantities of a motion; without names, energies and efforts too."""
    quantities = quantities_of_motion(motion, outputs)
    if outputs is not None:
        return quantities
    forces = [*ENERGIES, *(f"{name}.effort" for name in motion.efforts)]
    return {**quantities, **named(output_of_simulation(motion, name) for name in forces)}
