"""That no joint passes its limits of the URDF."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from spatial_pin.mechanism.joint_limits import JointLimit, joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.demands.candidate import Candidate
from spatial_pin.synthesis.demands.demand import Moving


@dataclass(frozen=True, eq=False, kw_only=True)
class WithinLimits(Moving):
    """That the driver's motion takes no other joint beyond its limits."""

    _words = "joint limits"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return ", ".join(sorted({limit.unit for limit in self._counting(mechanism)}))

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        if not self._counting(mechanism):
            raise ValueError(f"joint limits: no joint of mechanism {mechanism.name!r} has any, "
                             "but for the driver perhaps; state them in its URDF")

    def _counting(self, mechanism: Mechanism) -> list[JointLimit]:
        """Return the limits of joints that are not the driver's."""
        driver = mechanism.driven_coordinate(self.moved_by(mechanism)).name
        return [limit for limit in joint_limits(mechanism) if limit.name != driver]

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: how far joints are beyond each limit, by their own sizes."""
        motion, _ = self.motion(candidate)
        return np.concatenate([self.worst(motion, partial(_beyond, limit))
                               for limit in self._counting(candidate.mechanism)])

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        sizes = np.array([limit.size for limit in self._counting(mechanism)])
        return np.maximum(values, 0.0) * np.repeat(sizes, len(values) // len(sizes))


def _beyond(limit: JointLimit, motion: Motion) -> Array:
    return -limit.room(motion.q) / limit.size
