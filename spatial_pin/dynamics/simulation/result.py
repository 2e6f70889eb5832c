"""A Simulation: a Motion in time, with its energies and its cost."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spatial_pin._support.checks import checked
from spatial_pin._support.columns import Quantity, write_npz
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.mechanism.inertia import fall_energy
from spatial_pin.mechanism.joint_limits import JointLimit
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.limit_events import Passing
from spatial_pin.motion.motion import Motion, Output, content_of, fields_of, read_content
from spatial_pin.motion.summary import effort_lines, first_of
from spatial_pin.numerics.linalg import Array

# Times the error of a step from which on a motion is called unstable: stable falls have up to 500.
UNSTABLE = 5e3
# Part of the energy, or of the energy of a fall over its size, that counts as exchanged.
SMALL = 1e-2
EPS = float(np.finfo(float).eps)
WITH_ENERGIES = frozenset(("energy", "work", "effort_names", "efforts", "told"))  # in a file
SUMMARY_FIELDS = (  # fields of a simulation that are no samples
    "energy_drift", "coordinates", "evaluations", "steps", "by_drivers", "joint_limits",
    "projection", "integrators", "time_tolerance")


class Projection(NamedTuple):
    """The cost of closing the loops after the steps of a "projected" simulation.

    Attributes:
        steps: how many steps were projected.
        corrections: Newton corrections of the configuration in all; velocities take one
            solution of the same equations a step.
        opened: the largest closure error that a step had left [-].
        seconds: time that it took [s].
        share: of the time of the whole simulation [-].

    Example:
        >>> mech = sp.load("four_bar")
        >>> settings = sp.Accuracy(formulation="projected")
        >>> motion = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 0.1, accuracy=settings)
        >>> motion.projection.steps == motion.steps, motion.projection.opened < 1e-3
        (True, True)
    """

    steps: int
    corrections: int
    opened: float
    seconds: float
    share: float


class ByDriver(dict[str, Array]):
    """Samples (N,) keyed by driver; a driver's joint or coordinate finds them too.

    Args:
        mechanism: the mechanism.
        samples: (N,) keyed by coordinate.
    """

    def __init__(self, mechanism: Mechanism, samples: Mapping[str, Array]) -> None:
        names = driver_names(mechanism)
        self._names = {name: names.get(name, name) for name in samples}
        super().__init__({self._names[name]: x for name, x in samples.items()})

    def __missing__(self, name: str) -> Array:
        if name in self._names:
            return self[self._names[name]]
        raise UnknownNameError("prescribed driver", name, self, "efforts: ")

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or name in self._names

    def get(self, name: str, default: Any = None) -> Any:
        """Return the samples of a driver, joint or coordinate, or a default."""
        return super().get(self._names.get(name, name), default)


def driver_names(mechanism: Mechanism) -> dict[str, str]:
    """Return the names of drivers by the coordinates that they drive."""
    return {mechanism.coordinate(d.joint).name: d.name for d in mechanism.drivers.values()}


@dataclass(eq=False, repr=False)
class Simulation(Motion):
    """A Motion in time, with its energies.

    Attributes:
        energy: (N,) kinetic, potential and spring energy [J]; heights are those above the world's
            origin, or, where that is far away, above `Mechanism.centre`.
        work: (N,) of efforts, dampers, damping and friction of joints, prescribed drivers and
            spring laws since the start [J].
        energy_drift: largest error of the energy balance (energy less work less the energy at the
            start) relative to the energy exchanged: the largest kinetic energy or change of the
            rest, at least a hundredth of the energy, or of that of a fall over the mechanism's
            size [-].
        efforts: (N,) of every prescribed driver [N·m, N], keyed by its name; one that is no driver
            of the mechanism by its coordinate. A driver's joint finds them too.
        coordinates: independent coordinates that were used, in their order.
        evaluations: how often the equations of motion were evaluated.
        steps: how many steps were taken.
        by_drivers: whether, besides gravity and springs as the file has them, only drivers acted;
            False where efforts were a function.
        joint_limits: the joint limits of the URDF that were passed, and when.
        projection: what projecting took, with the formulation "projected"; else None.
        integrators: names of those that were used, in their order.
        time_tolerance: error allowed in one step [-]; 0 of fixed steps.

    `error` is twice what another integration, thirty times as exact, differs from this one by. It
    is made when `error`, or the text of a simulation, is first wanted, and takes about as long as
    the simulation.
    `energy_drift` is no error of the motion: ten or thirty times less as a rule, and a hundred
    thousand times less where a motion is unstable.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 0.5)
        >>> motion.time.shape, motion.energy.shape, motion.energy_drift < 1e-8  # (N,) [s], (N,) [J]
        ((1001,), (1001,), True)
    """

    energy: Array = field(default_factory=lambda: np.empty(0))
    work: Array = field(default_factory=lambda: np.empty(0))
    energy_drift: float = 0.0
    efforts: dict[str, Array] = field(default_factory=dict)
    coordinates: list[str] = field(default_factory=list)
    evaluations: int = 0
    steps: int = 0
    by_drivers: bool = True
    joint_limits: list[Passing] = field(default_factory=list)
    projection: Projection | None = None
    integrators: list[str] = field(default_factory=list)
    time_tolerance: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for x in self.efforts.values():
            x.setflags(write=False)

    @checked
    def output(self, spec: str) -> Output:
        """Return a quantity by its name, as any Motion, or `energy`, `work` or `NAME.effort`.

        Raises:
            UnknownNameError: it names nothing of this motion.
            SpatialPinError: it is a force that only `kinetostatics` knows.

        Example:
            >>> mech = sp.load("four_bar")
            >>> motion = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 0.1)
            >>> motion.output("energy").values.shape, motion.output("energy").unit  # (N,)
            ((1001,), 'J')
        """
        from spatial_pin.dynamics.force_outputs import output_of_simulation

        return output_of_simulation(self, spec)

    def quantities(self, outputs: str | Iterable[str] | None = None) -> dict[str, Quantity]:
        """Return quantities by name, as any Motion, with energies and efforts.

        Args:
            outputs: names as `output` takes them; these are returned beside the time.

        Raises:
            UnknownNameError: there is no such output.

        Example:
            >>> mech = sp.load("four_bar")
            >>> motion = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 0.1)
            >>> [(name, x.unit) for name, x in motion.quantities("energy").items()]
            [('time', 's'), ('energy', 'J')]
        """
        from spatial_pin.dynamics.force_outputs import quantities_of_simulation

        return quantities_of_simulation(self, outputs)

    @checked
    def save(self, path: str | Path) -> Path:
        """Write all of it to an .npz file that `Simulation.load` reads; returns the path.

        Args:
            path: of the file; the suffix is added where it is missing.

        Raises:
            OSError: it cannot be written; the former file stays.

        Example:
            >>> mech = sp.load("four_bar")
            >>> motion = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 0.1)
            >>> motion.save("fall").name
            'fall.npz'
        """
        coordinate = self.mechanism.driven_coordinate
        return write_npz(path, content_of(self) | {
            "energy": self.energy, "work": self.work,
            "effort_names": np.array([coordinate(name).name for name in self.efforts], str),
            "efforts": np.array(list(self.efforts.values())),
            "told": json.dumps({name: getattr(self, name) for name in SUMMARY_FIELDS},
                               default=lambda x: x.item())})

    @classmethod
    @checked
    def load(cls, path: str | Path, mechanism: Mechanism) -> Simulation:
        """Read a simulation of `mechanism` that `save` wrote; `Motion.load` reads its motion.

        Args:
            path: the .npz file.
            mechanism: the mechanism that it is a simulation of: `save` does not write it.

        Returns:
            The Simulation.

        Raises:
            SpatialPinError: `save` did not write it, or it is the motion of a mechanism with other
                coordinates.
            OSError: it cannot be read.

        Example:
            >>> mech = sp.load("four_bar")
            >>> file = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 0.1).save("fall")
            >>> sp.Simulation.load(file, mech).energy.shape  # (N,) [J]
            (1001,)
        """
        content = read_content(path, mechanism)
        if not content.keys() >= WITH_ENERGIES:
            raise SpatialPinError(f"{path}: not a simulation that Simulation.save wrote")
        fields = json.loads(str(content["told"]))
        fields["joint_limits"] = [Passing(JointLimit(*limit), *where)
                                for limit, *where in fields["joint_limits"]]
        fields["projection"] = Projection(*fields["projection"]) if fields["projection"] else None
        efforts = dict(zip(content["effort_names"].tolist(), content["efforts"], strict=True))
        return cls(mechanism, **fields_of(content), energy=content["energy"],
                   work=content["work"], efforts=ByDriver(mechanism, efforts), **fields)

    def __str__(self) -> str:
        used = f" in {', '.join(self.coordinates)}" if self.coordinates else ""
        stiff = f" ({self.integrators[-1]} where stiff)" if len(self.integrators) > 1 else ""
        lines = [super().__str__(),
                 f"  energy drift {self.energy_drift:.1e} of the exchanged energy; "
                 f"{self.steps} steps of the integrator{stiff}{used}", *growth_lines(self)]
        efforts = effort_lines(self, self.efforts)
        return "\n".join([*lines, *(["efforts:"] if efforts else []),
                          *first_of(efforts, "efforts")])


def growth_lines(motion: Simulation) -> list[str]:
    """Return a line that tells of a motion in which errors of steps grow, if they do."""
    if not (len(motion) and len(motion.error_estimates) and motion.time_tolerance):
        return []
    growth = motion.error.positions / motion.time_tolerance
    if growth <= UNSTABLE:
        return []
    if math.isinf(growth):
        return ["  unstable, or singular at its end: nothing bounds its error"]
    return [f"  unstable: errors are {growth:.0e} times that of a step; a small change of the "
            "start grows as much"]


class Energies(NamedTuple):
    """Energies at a moment.

    Attributes:
        kinetic: of that [J].
        total: kinetic, potential and of springs [J].
        work: done since the start [J].
    """

    kinetic: float
    total: float
    work: float


class LeastExchange:
    """The least energy that counts as exchanged; less is round-off.

    It is a part of the energy, or of that of a fall over the mechanism's size, because heights are
    known to round-off of that. The energy of a spring near its free length is a square of
    round-off, and so is the work of efforts that balance: round-off of the energy at a stretch of
    the mechanism's size is well above that.
    """

    def __init__(self, mechanism: Mechanism, efforts: Array) -> None:
        size, scale = mechanism.characteristic_length, mechanism.velocity_scale
        self._falling = fall_energy(mechanism.model, size)
        stretching = 0.0
        for spring in mechanism.springs:
            unit = scale[mechanism.coordinate(spring.joint).v] if spring.joint else size
            if spring.is_bushing:
                stretching += float(np.max(spring.stiffness)) * max(size, 1.0) ** 2
                continue
            stiffness = max(spring.slopes(spring.free + sense, 0.0)[0] for sense in (unit, -unit))
            stretching += stiffness * (abs(spring.free) + unit) ** 2
        self._pulling = EPS * (stretching + float(np.abs(efforts) @ scale))

    def __call__(self, *energies: float) -> float:
        """Return this least energy [J] for some energies [J]."""
        return max(SMALL * max(self._falling, *map(abs, energies)), self._pulling)


def energy_drift(
    least: LeastExchange, kinetic: Array, energy: Array, work: Array, start: Energies
) -> float:
    """Return the largest error of the energy balance, relative to the energy exchanged."""
    rest, first = energy - kinetic, start.total - start.kinetic
    size = max(float(kinetic.max(initial=start.kinetic)),
               float(rest.max(initial=first) - rest.min(initial=first)),
               least(float(np.abs(energy).max(initial=abs(start.total)))))
    drift = float(np.abs(energy - work - start.total).max(initial=abs(start.work)))
    return drift / size if size > 0.0 else 0.0
