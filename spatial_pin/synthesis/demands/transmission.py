"""How large the transmission angle of an output is at least."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.transmission import MovedOutput
from spatial_pin.synthesis.demands.candidate import Candidate
from spatial_pin.synthesis.demands.demand import Moving


@dataclass(frozen=True, eq=False, kw_only=True)
class LeastTransmission(Moving):
    """How large the transmission angle of an output is at least."""

    output: str
    at_least: float
    pair: str | None = None
    _words, _unit = "transmission to {0.output}", "rad"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        MovedOutput.of(mechanism, self.output, self.moved_by(mechanism), self.pair)

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: angles that are missing."""
        motion, _ = self.motion(candidate)
        moved = MovedOutput.of(motion.mechanism, self.output,
                               self.moved_by(candidate.mechanism), self.pair)

        def missing(motion: Motion) -> Array:
            return self.at_least - np.array([
                moved.angle(motion.mechanism, q, angles)
                for q, angles in zip(motion.q, motion.angles, strict=True)])

        return self.worst(motion, missing)
