"""That a driver needs little effort to hold loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.state import State, moving_in_time
from spatial_pin.dynamics.inverse import inverse_dynamics
from spatial_pin.dynamics.solvers.equations import equations_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.demands.candidate import Candidate
from spatial_pin.synthesis.demands.demand import AtMost, Moving

SAME_EFFORT = TOLERANCES.nothing  # part of it, by which two ways to it differ at most


@dataclass(frozen=True, eq=False, kw_only=True)
class MostEffort(AtMost, Moving):
    """That a driver needs little effort to hold loads."""

    loads: Mapping[str, Array] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """See `Goal`."""
        return f"effort of {self.driver or 'the driver'}"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return "N m" if mechanism.driven_coordinate(self.moved_by(mechanism)).unit == "rad" else "N"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        for name in self.loads:
            mechanism.frame_id(name)

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: relative to the largest one allowed."""
        motion, _ = self.motion(candidate, whole=not candidate.has_masses)
        loads = {name: pin.Force(wrench) for name, wrench in self.loads.items()}
        driver = motion.mechanism.driven_coordinate(self.moved_by(candidate.mechanism))
        found = _balanced(motion, 0, driver.name, loads)
        own = _by_work(motion, driver.v, loads, 1)[0]
        is_same = abs(own - found) <= SAME_EFFORT * max(abs(own), abs(found))

        def beyond(motion: Motion) -> Array:
            efforts = _by_work(motion, driver.v, loads) if is_same else np.array(
                [_balanced(motion, k, driver.name, loads) for k in range(len(motion))])
            return np.abs(efforts) / self.at_most - 1.0

        return self.worst(motion, beyond)


def _balanced(motion: Motion, row: int, driver: str, loads: Mapping[str, pin.Force]) -> float:
    """Return the effort that holds a sample at rest, one of several drivers perhaps."""
    state = moving_in_time(motion.mechanism, motion.state(row))
    efforts = inverse_dynamics(motion.mechanism, state, external=loads).efforts
    return float(next(x for name, x in efforts.items()
                      if motion.mechanism.driven_coordinate(name).name == driver))


def _by_work(
    motion: Motion, driver: int, loads: Mapping[str, pin.Force], most: int | None = None
) -> Array:
    """Return efforts (n,), of the first samples at most, by virtual work.

    Along the motion the driver's work makes up for that of all other forces: its effort is the one
    there is where drivers are as many as the freedoms that they hold.
    """
    still, found = np.zeros(motion.mechanism.model.nv), []
    with equations_of(motion.mechanism) as equations:
        for q, angles, v in zip(
                motion.q[:most], motion.angles[:most], motion.v[:most], strict=True):
            equations.update(State(motion.mechanism, q, closure_error=0.0, angles=angles), loads)
            wanted = equations.motion_forces(still) - equations.given
            found.append(float(wanted @ v) / v[driver])
    return np.array(found)
