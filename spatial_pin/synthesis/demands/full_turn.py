"""That a driver turns all the way round."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array, rank, singular_values
from spatial_pin.synthesis.demands.candidate import TURN, Candidate
from spatial_pin.synthesis.demands.demand import PARTS, Moving

# Square of the least singular value of what the driver leaves to be determined, lengths relative to
# the characteristic length: so far a driver that turns fully is from being stopped, about a degree
# of transmission angle.
REGULAR = 1e-4


def _regularity(motion: Motion) -> Callable[[Motion], Array]:
    """Return what tells how well loops determine the rest of a mechanism whose drivers stand.

    That is, of samples (n,), the least singular value of as many equations as are independent in
    the first sample of a motion.
    """
    mechanism = motion.mechanism
    assert motion.driver_name is not None
    names = {motion.driver_name, *(d.joint for d in mechanism.drivers.values())}
    held = [mechanism.driven_coordinate(name).v for name in names]

    def left(q: Array) -> Array:
        with kernel_of(mechanism) as kernel:
            return np.delete(kernel.jacobians(q), held, axis=2)

    independent = rank(left(motion.q[:1])[0])
    return lambda some: singular_values(left(some.q))[:, independent - 1]


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
        regularity = _regularity(motion)
        return self.worst(motion, lambda some: REGULAR - regularity(some) ** 2)

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`: angles that are missing."""
        return 2.0 * np.arccos(np.clip(1.0 - np.maximum(values, 0.0), -1.0, 1.0))
