"""That a driver turns all the way round."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spatial_pin.kernel.kernel import Kernel, kernel_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array, rank, singular_values
from spatial_pin.synthesis.demands.candidate import TURN, Candidate
from spatial_pin.synthesis.demands.demand import PARTS, Moving

# Square of the least singular value of what the driver leaves to be determined, lengths relative to
# the characteristic length: so far a driver that turns fully is from being stopped, about a degree
# of transmission angle.
REGULAR = 1e-4


class _Loops:
    """The loops of a mechanism whose drivers stand: how well they determine the rest.

    Args:
        motion: of it; how many equations are independent is that of its first sample.
    """

    def __init__(self, motion: Motion) -> None:
        mechanism = motion.mechanism
        assert motion.driver_name is not None
        names = {motion.driver_name, *(d.joint for d in mechanism.drivers.values())}
        self._held = [mechanism.driven_coordinate(name).v for name in names]
        with kernel_of(mechanism) as kernel:
            self._rank = rank(self._left(kernel, motion.q[:1])[0])

    def _left(self, kernel: Kernel, q: Array) -> Array:
        """Return derivatives (n, ., .) of all equations for what is not driven."""
        return np.delete(kernel.jacobians(q), self._held, axis=2)

    def regularity(self, motion: Motion) -> Array:
        """Return the least singular value (n,) of as many equations as are independent."""
        with kernel_of(motion.mechanism) as kernel:
            return singular_values(self._left(kernel, motion.q))[:, self._rank - 1]


@dataclass(frozen=True, eq=False, kw_only=True)
class FullTurn(Moving):
    """That a driver turns all the way round."""

    _unit = "rad"

    @property
    def name(self) -> str:
        """See `Goal`."""
        return f"full turn of {self.driver or 'the driver'}"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        if mechanism.driven_coordinate(self.moved_by(mechanism)).unit != "rad":
            raise ValueError(f"{self.name}: it slides, and cannot turn")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: 1 - cos of half the gap in the turn, and nearness of a limit beyond it."""
        motion, is_turn = self.motion(candidate)
        if not is_turn:
            gap = max(0.0, TURN - float(np.ptp(motion.swept)))
            return (REGULAR + 1.0 - np.cos(0.5 * gap)) * np.eye(PARTS)[0]
        loops = _Loops(motion)
        return self.worst(motion, lambda some: REGULAR - loops.regularity(some) ** 2)

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`: angles that are missing."""
        return 2.0 * np.arccos(np.clip(1.0 - np.maximum(values, 0.0), -1.0, 1.0))
