"""How a sum of squared residuals bends on what is kept: second derivatives of its Lagrangian.

It is half the sum, and the equations of the loops and of what is kept, each times what it weighs
at a configuration [NocedalWright2006, 12.3]. First derivatives are differenced; residuals stay as
they are at the configuration, as what their changes add to the curvature is known exactly.

Residuals that cannot be met may change without their sum: an axis that is normal to a direction
stays normal to it however it turns, and the angle between them, as a vector, turns with it. So what
`Stationary` keeps while a mechanism moves on is not the residuals but the sum's derivative, along
the motions in which the sum is curved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.inverse_kinematics.constrained import Constrained
from spatial_pin.inverse_kinematics.targets import Residual, Target
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

CURVATURE_STEP = 1e-6  # of one-sided differences: half of their digits are good
GRADIENT_STEP = 1e-4  # of central ones [rad, characteristic lengths]: they leave 1e-9 to 1e-11


class Lagrangian:
    """The Lagrangian at a configuration.

    Attributes:
        motions: (k, nv) that keep loops closed and targets met.
        slope: (nv,) the derivative of half the sum.
        gradient: (k,) this along the motions; zero where it is no more than round-off.
        least: the curvature that is clearly one, however little others are.

    Args:
        base: the mechanism.
        kept: targets that stay met.
        wanted: targets whose residuals are squared.
        q: (nq,) the configuration.
        free: (nv,) which velocities may move.
    """

    def __init__(
        self, base: Constrained, kept: Sequence[Target], wanted: Sequence[Target], q: Array,
        free: NDArray[np.bool_],
    ) -> None:
        self.base, self._kept, self._wanted, self._q, self._free = base, kept, wanted, q, free
        residual, self._rows = base.residual(q, wanted)
        self.motions = base.motions(q, free, kept)
        multipliers = base.linearised(q, free, kept).minimum_norm_transposed(
            -(residual @ self._rows)[free])
        n = base.evaluation.constraints.n_closure
        self._closures = multipliers[:n]
        self._forces = (wanted, residual), (kept, multipliers[n:])
        self.slope = residual @ self._rows
        most = float(np.linalg.norm(self._rows[:, free]))
        self.least = max(TOLERANCES.nothing * most**2, TOLERANCES.zero)
        self.gradient = self.motions @ self.slope
        if np.linalg.norm(self.gradient) <= TOLERANCES.round_off * most * np.linalg.norm(residual):
            self.gradient = np.zeros(len(self.motions))

    def at(self, q: Array) -> Lagrangian:
        """Return that of the same sum at another configuration."""
        return Lagrangian(self.base, self._kept, self._wanted, q, self._free)

    def _gradient(self, q: Array) -> Array:
        self.base.stand(q)
        found: Array = self._closures @ self.base.closures()
        for targets, forces in self._forces:
            found += self.base.pulled(targets, forces)
        return found

    def _ahead(self, way: Array) -> Array:
        """Return the derivative (nv,) a scaled displacement (nv,) away."""
        base = self.base
        return self._gradient(pin.integrate(base.evaluation.model, self._q, base.scale * way))

    @cached_property
    def curvature(self) -> tuple[Array, Array]:
        """Curvatures (k,) along its principal directions, rising, and these (k, k) in columns.

        They are good to half of the digits.
        """
        motions, here = self.motions, self._gradient(self._q)
        parts = self._rows @ motions.T
        bent = [motions @ (self._ahead(CURVATURE_STEP * way) - here) for way in motions]
        found = np.reshape(bent, 2 * motions.shape[:1]) / CURVATURE_STEP
        sizes, ways = np.linalg.eigh(parts.T @ parts + 0.5 * (found + found.T))
        return sizes, ways

    def newton_step(self, damping: float) -> Array:
        """Return Newton's step (nv,), which goes down where the curvature is negative too."""
        if not len(self.gradient):
            return np.zeros(self.motions.shape[1])
        sizes, ways = self.curvature
        size, along = np.abs(sizes), ways.T @ self.gradient
        most = max(float(size.max()), self.least)
        # What is flat, as an idle rotation is, comes last: differences leave some millionths of
        # other ways in it, and so of their gradients, over a curvature that is nothing.
        is_flat = size <= TOLERANCES.half_precision * most
        along[is_flat & (np.abs(along) <= TOLERANCES.regular * np.abs(along).max())] = 0.0
        parts = along / (np.maximum(size, TOLERANCES.nothing * most) + damping * most)
        return -(ways @ parts) @ self.motions

    def off_summit(self) -> Array | None:
        """Return the way (nv,) that it bends down most along; None where it does not."""
        sizes, ways = self.curvature
        size = np.abs(sizes).max(initial=self.least)
        if not len(sizes) or sizes[0] >= -TOLERANCES.half_precision * size:
            return None
        way: Array = ways[:, 0] @ self.motions
        return way if way[np.argmax(np.abs(way))] > 0.0 else -way

    def changes(self, ways: Array) -> Array:
        """Return the second derivative (k, nv), along the motions, for scaled velocities (k, nv).

        To 1e-9 and better.
        """
        steps = [GRADIENT_STEP / max(float(np.linalg.norm(way)), TOLERANCES.zero) for way in ways]
        bent = [(self._ahead(h * way) - self._ahead(-h * way)) / (2.0 * h)
                for h, way in zip(steps, ways, strict=True)]
        found = ways @ self._rows.T @ self._rows + np.reshape(bent, ways.shape)
        return found @ self.motions.T @ self.motions

    def curved(self) -> tuple[Array, Array]:
        """Return sizes (k,) and scaled velocities (k, nv) of the directions it is curved along."""
        motions, slope = self.motions, self._rows @ self.motions.T
        curvature = self.changes(motions) @ motions.T
        sizes, ways = np.linalg.eigh(0.5 * (curvature + curvature.T))
        parts = float(np.linalg.norm(slope, ord=2)) ** 2  # what the residuals' bending may cancel
        most = max(parts, float(np.abs(sizes).max(initial=0.0)))
        curved = np.abs(sizes) > max(TOLERANCES.half_precision * most, self.least)
        return sizes[curved], ways.T[curved] @ motions


@dataclass(frozen=True, eq=False, kw_only=True)
class Stationary(Target):
    """The sum's derivative is zero along directions (k, nv) in which its curvature is `sizes`."""

    sum: Lagrangian
    sizes: Array
    ways: Array

    def residual(self, evaluation: Evaluation) -> Residual:
        """See `Target`: how far it is from the least sum along each direction.

        The derivative is that along the motions that there are: other targets and the loops see to
        the rest.
        """
        q, half = evaluation.q, self.sum.at(evaluation.q)
        ways = self.ways / self.sizes[:, None] @ half.motions.T @ half.motions
        found, rows = ways @ half.slope, half.changes(ways) / half.base.scale
        half.base.stand(q)
        return found, rows

    def pulled(self, evaluation: Evaluation, forces: Array) -> tuple[Array, Array]:
        """See `Target`: one way is enough, as second derivatives do not depend on the order."""
        q, half, n = evaluation.q, self.sum.at(evaluation.q), len(self.sizes)
        way = (forces[:n] / self.sizes) @ self.ways @ half.motions.T @ half.motions
        found = half.changes(way[None])[0] / half.base.scale
        half.base.stand(q)
        return found, forces[n:]
