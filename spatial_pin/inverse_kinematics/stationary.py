"""Where a sum of squared residuals stays least while a mechanism moves on.

Residuals that cannot be met may change without their sum: an axis that is normal to a direction
stays normal to it however it turns, and the angle between them, as a vector, turns with it. So what
is kept is not the residuals but the sum's derivative, along the motions in which the sum is curved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.inverse_kinematics.constrained import Constrained
from spatial_pin.inverse_kinematics.lagrangian import Lagrangian
from spatial_pin.inverse_kinematics.targets import Residual, Target
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """A sum of squared residuals, on closed loops and with other targets kept.

    Attributes:
        base: the mechanism.
        kept: targets that stay met.
        wanted: targets whose residuals are squared.
        free: (nv,) which velocities may move.
    """

    base: Constrained
    kept: Sequence[Target]
    wanted: Sequence[Target]
    free: NDArray[np.bool_]

    def at(self, q: Array) -> Lagrangian:
        """Return its Lagrangian at a configuration (nq,)."""
        return Lagrangian(self.base, self.kept, self.wanted, q, self.free)

    def curved(self, q: Array) -> tuple[Array, Array]:
        """Return sizes (k,) and scaled velocities (k, nv) of the directions it is curved along."""
        half = self.at(q)
        motions = half.motions
        slope = self.base.residual(q, self.wanted)[1] @ motions.T
        curvature = half.changes(motions) @ motions.T
        sizes, ways = np.linalg.eigh(0.5 * (curvature + curvature.T))
        # what the residuals' bending may cancel; NumPy 2.0 has no norm of an empty matrix
        parts = float(np.linalg.norm(slope, ord=2)) ** 2 if slope.size else 0.0
        most = max(parts, float(np.abs(sizes).max(initial=0.0)))
        curved = np.abs(sizes) > max(TOLERANCES.half_precision * most, half.least)
        return sizes[curved], ways.T[curved] @ motions


@dataclass(frozen=True, eq=False, kw_only=True)
class Stationary(Target):
    """The sum's derivative is zero along directions (k, nv) in which its curvature is `sizes`."""

    sum: LeastSquares
    sizes: Array
    ways: Array

    def residual(self, evaluation: Evaluation) -> Residual:
        """See `Target`: how far it is from the least sum along each direction.

        The derivative is that along the motions that there are: other targets and the loops see to
        the rest.
        """
        q, half = evaluation.q, self.sum.at(evaluation.q)
        ways = self.ways / self.sizes[:, None] @ half.motions.T @ half.motions
        found, rows = ways @ half.slope, half.changes(ways) / self.sum.base.scale
        self.sum.base.stand(q)
        return found, rows

    def pulled(self, evaluation: Evaluation, forces: Array) -> tuple[Array, Array]:
        """See `Target`: one way is enough, as second derivatives do not depend on the order."""
        q, half, n = evaluation.q, self.sum.at(evaluation.q), len(self.sizes)
        way = (forces[:n] / self.sizes) @ self.ways @ half.motions.T @ half.motions
        found = half.changes(way[None])[0] / self.sum.base.scale
        self.sum.base.stand(q)
        return found, forces[n:]
