"""Where a sum of squared residuals stays least while a mechanism moves on.

Residuals that cannot be met may change without their sum: an axis that is normal to a direction
stays normal to it however it turns, and the angle between them, as a vector, turns with it. So what
is kept is not the residuals but the sum's derivative, along the motions in which the sum is curved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.inverse_kinematics.constrained import Constrained
from spatial_pin.inverse_kinematics.targets import Residual, Target
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

GRADIENT_STEP = 1e-4  # of differences [rad, characteristic lengths]: they leave 1e-9 to 1e-11


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

    def gradient(self, q: Array) -> Array:
        """Return the derivative (nv,) of half the sum, along the motions that there are."""
        motions = self.base.motions(q, self.free, self.kept)
        residual, rows = self.base.residual(q, self.wanted)
        found: Array = (residual @ rows @ motions.T) @ motions
        return found

    def change(self, q: Array, ways: Array) -> Array:
        """Return how the gradient changes (k, nv) along scaled velocities (k, nv)."""
        base = self.base
        ends = [[self.gradient(pin.integrate(base.evaluation.model, q, side * base.scale * way))
                 for side in (GRADIENT_STEP, -GRADIENT_STEP)] for way in ways]
        base.evaluation.update(q)
        return np.array([(a - b) / (2.0 * GRADIENT_STEP) for a, b in ends]).reshape(ways.shape)

    def curved(self, q: Array) -> tuple[Array, Array]:
        """Return sizes (k,) and scaled velocities (k, nv) of the directions it is curved along."""
        motions = self.base.motions(q, self.free, self.kept)
        slope = self.base.residual(q, self.wanted)[1] @ motions.T
        curvature = self.change(q, motions) @ motions.T
        sizes, ways = np.linalg.eigh(0.5 * (curvature + curvature.T))
        parts = float(np.linalg.norm(slope, ord=2)) ** 2  # what the residuals' bending may cancel
        most = max(parts, float(np.abs(sizes).max(initial=0.0)))
        curved = np.abs(sizes) > TOLERANCES.half_precision * most
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
        q, total = evaluation.q, self.sum
        ways = self.ways / self.sizes[:, None]
        found = ways @ total.gradient(q)
        motions = total.base.motions(q, total.free, total.kept)
        return found, ways @ total.change(q, motions).T @ motions / total.base.scale
