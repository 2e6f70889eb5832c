"""Forces over a motion by their names: efforts, powers, reactions, the wrench on the ground."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

from spatial_pin._support.checks import names_of
from spatial_pin._support.columns import Quantity
from spatial_pin._support.lazy import cached_property
from spatial_pin.dynamics.coupling_forces import coupling_forces
from spatial_pin.dynamics.kinetostatics import Kinetostatics, kinetostatics
from spatial_pin.dynamics.simulation.result import Simulation, driver_names
from spatial_pin.errors import UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion, Output
from spatial_pin.motion.outputs import (
    abscissas,
    component,
    component_of,
    is_force,
    named,
    output as output_of_motion,
    quantities as quantities_of_motion,
)
from spatial_pin.motion.summary import EFFORTS
from spatial_pin.numerics.linalg import Array

ENERGIES = ("energy", "work")  # of a simulation


def output(loads: Kinetostatics, spec: str) -> Output:
    """Return a force by its name, or a quantity of the motion; see `Kinetostatics.output`."""
    whole, k = component(spec)
    if k is not None and is_force(spec):
        return component_of(output(loads, whole), k)
    values = (_effort(loads.motion, spec, loads.efforts) or _power(loads, spec)
             or _wrench(loads, spec))
    if values is not None:
        return values
    if is_force(spec):
        raise UnknownNameError("force", spec, names(loads),
                               f"loads of mechanism {loads.motion.mechanism.name!r}: ")
    return loads.motion.output(spec)


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
        is_own = (isinstance(motion, Simulation) and name.endswith(".effort")
                  and _effort(motion, name, motion.efforts) is not None)
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


def _effort(motion: Motion, spec: str, efforts: Mapping[str, Array]) -> Output | None:
    mechanism = motion.mechanism
    name = _own_name(mechanism, spec.removesuffix(".effort"), efforts)
    if name is None:
        return None
    return Output(efforts[name], f"{name} effort", EFFORTS[mechanism.coordinate(name).unit])


def _power(loads: Kinetostatics, spec: str) -> Output | None:
    whole, _, kind = spec.rpartition(".")
    name = _own_name(loads.motion.mechanism, whole, loads.power) if kind == "power" else None
    return None if name is None else Output(loads.power[name], f"{name} power", "W")


def _wrench(loads: Kinetostatics, spec: str) -> Output | None:
    """Return a reaction (N, 6), its force or moment (N, 3), or the shaking wrench.

    Of a coupling that does not say where it acts, what it does about its last joint (N,).
    """
    whole, _, kind = spec.rpartition(".")
    if kind in ("force", "moment"):
        both = _wrench(loads, whole)
        return both.parts()[kind == "moment"] if both and both.values.ndim > 1 else None
    if spec == "on_ground":
        return Output(loads.on_ground, "on ground", "N, N·m")
    if kind == "reaction" and whole in loads.reactions:
        return Output(loads.reactions[whole], f"{whole} reaction", "N, N·m")
    mechanism = loads.motion.mechanism.whole or loads.motion.mechanism
    coupling = next((c for c in coupling_forces(mechanism)
                     if kind == "reaction" and c.name == whole), None)
    if coupling is None:
        return None
    unit = EFFORTS[list(mechanism.coordinate_table.values())[coupling.last].unit]
    return Output(coupling.effort(loads.multipliers), f"{whole} reaction", unit)


def output_of_simulation(motion: Simulation, spec: str) -> Output:
    """Return an energy, the effort of a prescribed driver, or an output of any motion."""
    if spec in ENERGIES and spec not in motion.mechanism.coordinate_table:
        return Output(getattr(motion, spec), spec, "J")
    if spec.endswith(".effort"):
        values = _effort(motion, spec, motion.efforts)
        if values is not None:
            return values
    return output_of_motion(motion, spec)


def quantities_of_simulation(
    motion: Simulation, outputs: str | Iterable[str] | None = None
) -> dict[str, Quantity]:
    """Return the quantities of a motion; without names, energies and efforts too."""
    quantities = quantities_of_motion(motion, outputs)
    if outputs is not None:
        return quantities
    forces = [*ENERGIES, *(f"{name}.effort" for name in motion.efforts)]
    return {**quantities, **named(output_of_simulation(motion, name) for name in forces)}
