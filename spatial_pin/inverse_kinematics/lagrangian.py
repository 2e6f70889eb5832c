"""How a sum of squared residuals bends on what is kept: second derivatives of its Lagrangian.

It is half the sum, and the equations of the loops and of what is kept, each times what it weighs
at a configuration [NocedalWright2006, 12.3]. First derivatives are differenced; residuals stay as
they are at the configuration, as what their changes add to the curvature is known exactly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.inverse_kinematics.constrained import Constrained
from spatial_pin.inverse_kinematics.targets import Target
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
        self._base, self._q = base, q
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

    def _gradient(self, q: Array) -> Array:
        self._base.stand(q)
        found: Array = self._closures @ self._base.closures()
        for targets, forces in self._forces:
            found += self._base.pulled(targets, forces)
        return found

    def _at(self, way: Array) -> Array:
        """Return the derivative (nv,) a scaled displacement (nv,) away."""
        base = self._base
        return self._gradient(pin.integrate(base.evaluation.model, self._q, base.scale * way))

    def curvature(self) -> Array:
        """Return the second derivative (k, k) along the motions, good to half of the digits."""
        motions, here = self.motions, self._gradient(self._q)
        parts = self._rows @ motions.T
        bent = [motions @ (self._at(CURVATURE_STEP * way) - here) for way in motions]
        found = np.reshape(bent, 2 * motions.shape[:1]) / CURVATURE_STEP
        return parts.T @ parts + 0.5 * (found + found.T)

    def changes(self, ways: Array) -> Array:
        """Return the second derivative (k, nv), along the motions, for scaled velocities (k, nv).

        To 1e-9 and better.
        """
        steps = [GRADIENT_STEP / max(float(np.linalg.norm(way)), TOLERANCES.zero) for way in ways]
        bent = [(self._at(h * way) - self._at(-h * way)) / (2.0 * h)
                for h, way in zip(steps, ways, strict=True)]
        found = ways @ self._rows.T @ self._rows + np.reshape(bent, ways.shape)
        return found @ self.motions.T @ self.motions
