"""That a driver needs little effort to hold loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from spatial_pin.dynamics.kinetostatics import kinetostatics
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.demands.candidate import Candidate
from spatial_pin.synthesis.demands.demand import AtMost, Moving


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
        motion, _ = self.motion(candidate, whole=True)
        driver = self.moved_by(candidate.mechanism)
        loads = {name: pin.Force(wrench) for name, wrench in self.loads.items()}

        def beyond(motion: Motion) -> Array:
            efforts = kinetostatics(motion.mechanism, motion, external=loads).efforts
            held = motion.mechanism.driven_coordinate(driver).name
            own = next(x for name, x in efforts.items()
                       if motion.mechanism.driven_coordinate(name).name == held)
            return np.abs(own) / self.at_most - 1.0

        return self.worst(motion, beyond)
