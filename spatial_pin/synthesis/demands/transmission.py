"""How large the transmission angle of an output is at least."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.transmission import MovedOutput, transmission_angle
from spatial_pin.synthesis.demands.candidate import Candidate
from spatial_pin.synthesis.demands.demand import Moving


@dataclass(frozen=True, eq=False, kw_only=True)
class LeastTransmission(Moving):
    """How large the transmission angle of an output is at least."""

    output: str
    at_least: float
    pair: str | None = None

    @property
    def name(self) -> str:
        """See `Goal`."""
        return f"transmission to {self.output}"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return "rad"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        MovedOutput.of(mechanism, self.output, self.moved_by(mechanism), self.pair)

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: angles that are missing."""
        motion, _ = self.motion(candidate)
        driver = self.moved_by(candidate.mechanism)

        def missing(motion: Motion) -> Array:
            return self.at_least - np.array([
                transmission_angle(motion.mechanism, motion.state(k), self.output, driver,
                                   self.pair)[0] for k in range(len(motion))])

        return self.worst(motion, missing)
