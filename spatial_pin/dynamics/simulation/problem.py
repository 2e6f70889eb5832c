"""Forces and driver laws of a simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import as_array, is_finite, mapping
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.forces import (
    Forces,
    Law,
    external_wrenches,
    generalised,
    joint_efforts,
)
from spatial_pin.dynamics.simulation.coordinate_partitioning import Freedoms
from spatial_pin.dynamics.simulation.result import LeastExchange
from spatial_pin.dynamics.solvers.bodies import TreeDynamics, bodies_of
from spatial_pin.dynamics.solvers.least_constraint import LeastConstraint
from spatial_pin.kernel.kernel import Packed, with_masses
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.laws import DriverLaw
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.mechanism_checks import refuse_negative_inertias
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.numerics.linalg import Array

# Closure tolerance from which on the integrator gives accelerations of samples, and most samples
# of one freedom are interpolated. Below it hardly one is closed well enough.
BETWEEN_ANCHORS = 1e-11

EffortLaw = Callable[[float, State], Mapping[str, float]]
WrenchLaw = Callable[[float, State], Mapping[str, pin.Force]]

NO_LAW = ("it must be a function of time that returns (value, rate, acceleration), as those of "
          "spatial_pin.laws")


def _law(name: str, law: Any) -> DriverLaw:
    if not callable(law):
        raise TypeError(f"drives: the law of {name!r} is {law!r}; {NO_LAW}")

    def checked(t: float) -> tuple[float, float, float]:
        values: tuple[float, float, float] = law(t)
        try:
            value, rate, acceleration = map(math.isfinite, values)
        except (TypeError, ValueError):
            raise TypeError(f"drives: the law of {name!r} returns {values!r} at {t:.9g} s; "
                            f"{NO_LAW}") from None
        if not (value and rate and acceleration):
            raise ValueError(f"drives: the law of {name!r} has a value that is NaN or infinite at "
                             f"{t:.9g} s: {values}")
        return values

    return checked


class ExternalForces(NamedTuple):
    """Forces at frames, world axes, force and moment at the frame's origin.

    Attributes:
        law: of the time and the State, by frame.
        is_steady: whether they are constant.
        longest_step: of an integrator that is to leap over no row [s].
    """

    law: WrenchLaw
    is_steady: bool = False
    longest_step: float = np.inf


def external_forces(mechanism: Mechanism, given: Any, times: Array) -> ExternalForces | None:
    """Return the external forces of a simulation; None if there are none.

    Args:
        mechanism: whose frames they act at.
        given: by frame a `pin.Force` or rows (N, 6); or a function of the time and the State.
        times: (N,) that the rows belong to.

    Raises:
        UnknownNameError: there is no such frame.
        ValueError: rows are not as many as the times, or not finite.
    """
    if callable(given):
        return ExternalForces(lambda t, state: mapping(given(t, state), "external"))
    forces: dict[str, pin.Force] = {}
    tables: dict[str, Array] = {}
    for name, force in mapping(given, "external").items():
        mechanism.frame_id(name)
        if isinstance(force, pin.Force):
            forces[name] = force
            continue
        rows = tables[name] = as_array(force, f"external force at {name!r}")
        if rows.shape != (len(times), 6):
            raise ValueError(
                f"external force at {name!r} has shape {rows.shape}; give a pin.Force, or a row of "
                f"force and moment for each of the {len(times)} times: ({len(times)}, 6)")
        if not is_finite(rows):
            raise ValueError(f"external force at {name!r} is NaN or infinite")
    if not tables:
        return ExternalForces(lambda t, state: forces, is_steady=True) if forces else None

    def law(t: float, state: State) -> Mapping[str, pin.Force]:
        return forces | {
            name: pin.Force(np.array([np.interp(t, times, column) for column in rows.T]))
            for name, rows in tables.items()}

    return ExternalForces(law, longest_step=float(np.diff(times).min(initial=np.inf)))


class Problem:
    """A mechanism with its forces and prescribed coordinates.

    Attributes:
        forces: its springs, and damping and friction of joints.
        freedoms: its freedoms at a state.
        law: efforts as a function of time and state, or None.
        external: forces from outside.
        constant: (nv,) efforts otherwise.
        drives: prescribed coordinates with their laws.
        by_drivers: whether efforts act at drivers only, springs and friction as the file says.
        works: whether forces other than gravity do work.
        is_damped: whether a joint or spring takes energy away.
        is_steady: whether no function of the user acts, which may jump.
    """

    def __init__(
        self, mechanism: Mechanism, efforts: Mapping[str, float] | EffortLaw | None,
        drives: Mapping[str, DriverLaw] | None, laws: Mapping[str, Law] | None, tolerance: float,
        slip_speed: SlipSpeed | None = None, external: ExternalForces | None = None,
    ) -> None:
        refuse_negative_inertias(mechanism)
        self.mechanism, self.model = mechanism, mechanism.model
        self.scale, self.tolerance = mechanism.velocity_scale, tolerance
        self.freedoms = Freedoms(mechanism)
        self.forces = Forces(mechanism, laws, slip_speed)
        self.law: EffortLaw | None = efforts if callable(efforts) else None
        self.constant = joint_efforts(mechanism, None if callable(efforts) else efforts)
        self.external = external
        self.drives = [(mechanism.driven_coordinate(n), _law(n, law))
                       for n, law in mapping(drives, "drives").items()]
        at_drivers = {c.v for c in (mechanism.coordinate(d.joint)
                                    for d in mechanism.drivers.values()) if c.q >= 0}
        acted = {*np.flatnonzero(self.constant).tolist(), *(c.v for c, _ in self.drives)}
        self.by_drivers = (self.law is None and not laws and slip_speed is None
                           and external is None and acted <= at_drivers)
        self.is_steady = self.law is None and not laws and not self.drives and (
            external is None or external.is_steady)
        self.is_damped = bool(self.forces.resistance
                              or any(np.any(spring.damping) for spring in mechanism.springs))
        self.works = bool(self.law or external or self.constant.any() or self.forces.exist
                          or self.drives)

    @property
    def between(self) -> float:
        """Closure residual allowed at interpolated samples; 0 if none is interpolated.

        With functions of the user, which may jump, samples are not interpolated.
        """
        return self.tolerance if self.is_steady and self.tolerance >= BETWEEN_ANCHORS else 0.0

    @cached_property
    def packed(self) -> Packed:
        """The packed mechanism, masses included."""
        return with_masses(self.mechanism)

    @cached_property
    def least_exchange(self) -> LeastExchange:
        """The least energy that counts as exchanged."""
        return LeastExchange(self.mechanism, self.constant)

    @cached_property
    def bodies(self) -> TreeDynamics:
        """Mass matrix and inverse dynamics of the tree."""
        return bodies_of(self.model)

    @cached_property
    def least_constraint(self) -> LeastConstraint:
        """The solver for accelerations with any masses."""
        return LeastConstraint(self.mechanism)

    def efforts(self, t: float, q: Array, v: Array, evaluation: LoopEquations) -> Array:
        """Return the efforts (nv,) at joints, with forces from outside [N·m, N]."""
        if not (self.law or self.external):
            return self.constant
        state = State(self.mechanism, q, v, closure_error=evaluation.closure_error,
                      angles=evaluation.angles)
        total = joint_efforts(self.mechanism, self.law(t, state)) if self.law else self.constant
        if self.external:
            total = total + generalised(evaluation, external_wrenches(
                self.mechanism, evaluation, self.external.law(t, state)))
        return total

    def joint_forces(self, t: float, q: Array, v: Array, evaluation: LoopEquations) -> Array:
        """Return the joint forces (nv,) of efforts, springs, damping and friction."""
        total = self.efforts(t, q, v, evaluation)
        if self.forces.exist:
            total = total + self.forces.generalised(evaluation, q, v)
        return total
