"""How much room and mass a mechanism takes, and how far its links stay apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spatial_pin.mechanism.inertia import moving_mass
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.proximity.clearance import clearance
from spatial_pin.proximity.distances import Distances
from spatial_pin.synthesis.demands.candidate import Candidate
from spatial_pin.synthesis.demands.demand import AtMost, Moving


@dataclass(frozen=True, eq=False, kw_only=True)
class LeastClearance(Moving):
    """That links that are not joined stay apart."""

    at_least: float
    pairs: tuple[tuple[str, str], ...] | None = None
    _words, _unit = "clearance", "m"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        if not Distances(mechanism, self.pairs).pairs:
            raise ValueError(f"clearance: mechanism {mechanism.name!r} has no two links with a "
                             "shape that are not joined; name pairs of those that are")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: distances that are missing, by pair of links, in characteristic lengths."""
        motion, _ = self.motion(candidate, whole=True)
        found = sorted(clearance(motion, self.pairs).pairs, key=lambda pair: pair.links)
        size = motion.mechanism.characteristic_length
        return np.array([(self.at_least - pair.distance) / size for pair in found])

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        return np.maximum(values, 0.0) * mechanism.characteristic_length


@dataclass(frozen=True, eq=False, kw_only=True)
class MostSize(AtMost, Moving):
    """That no two joints or closures are ever far apart."""

    _words, _unit = "size", "m"

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: relative to the largest one allowed."""
        motion, _ = self.motion(candidate)
        model, closures = motion.mechanism.model, motion.mechanism.closures
        names = [*model.names[1:], *(name for c in closures for name in c.frames)]

        def beyond(motion: Motion) -> Array:
            points = np.array([motion.frame(name).position for name in dict.fromkeys(names)])
            apart = np.linalg.norm(points[:, None] - points[None], axis=3).max(axis=(0, 1))
            return apart / self.at_most - 1.0

        return self.worst(motion, beyond)


@dataclass(frozen=True, eq=False, kw_only=True)
class MostMass(AtMost):
    """That all moving links together weigh little."""

    _words, _unit = "mass", "kg"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        if not moving_mass(mechanism.model) > 0.0:
            raise ValueError(f"mass: no moving link of mechanism {mechanism.name!r} has one")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: relative to the largest one allowed."""
        heavy = candidate.mechanism if candidate.has_masses else candidate.whole
        return np.array([moving_mass(heavy.model) / self.at_most - 1.0])
