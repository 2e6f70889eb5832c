"""Accelerations under forces: one ladder, whose steps are taken until one holds.

1. The KKT system, its independent equations and units chosen at the place (`kernel.kkt`).
2. Gauss's least constraint in independent coordinates, where round-off of the first may show: near
   singular configurations of the loops, where masses differ much, or there are none.
3. A refusal in words, where no digit is left or forces do not determine the motion.

The measure of all is the estimated round-off of the accelerations, relative to their size.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.solvers.independent_coordinates import IndependentCoordinates
from spatial_pin.dynamics.solvers.least_constraint import Least, LeastConstraint
from spatial_pin.dynamics.solvers.loops import Loops
from spatial_pin.errors import SingularError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES

# Estimated error from which on the second step is taken, twenty times as dear: the KKT system has
# ten digits then, and the least constraint tells its own error without overestimating it as much.
DOUBTFUL = TOLERANCES.rank


class Solution(NamedTuple):
    """Accelerations under forces.

    Attributes:
        a: (nv,) joint accelerations.
        closures: (nv,) what closures add to the joint forces.
        error: estimated round-off of a, relative to its size.
    """

    a: Array
    closures: Array
    error: float


class MotionEquations(Loops):
    """The equations of motion of a mechanism, M a + b = f + J^T multipliers, J a + gamma = 0.

    Mass matrix M and centrifugal, Coriolis and gravity forces b are Pinocchio's, J and gamma those
    of the closure equations.
    """

    def solve(self, given: Array) -> Solution:
        """Return what happens under joint forces f (nv,) at the State of the last `place`.

        Raises:
            SingularError: a freedom has no inertia, or the loops have lost rank.
        """
        state, kkt = self.state, self.kkt
        needed = self.bodies.needed(state.q, state.v)
        a = self.by_kkt(state.q, state.v, self.turns, given, needed).copy()
        closures, error, is_sure = kkt.closures.copy(), kkt.error, self._is_sure
        self.check_rank(kkt.rank)
        if is_sure:
            return Solution(a, closures, error)
        found = self._by_least_constraint(given)
        if not (kkt.pivot < TOLERANCES.zero or found.error < error):
            return Solution(a, closures, error)
        self._refuse(found)
        return Solution(found.a, self.bodies.needed(state.q, state.v, found.a) - given, found.error)

    def by_kkt(
        self, q: Array, v: Array, turns: Array, given: Array, needed: Array, anew: bool = True
    ) -> Array:
        """Return accelerations (nv,) by the KKT system; overwritten by the next.

        Args:
            q: (nq,) configuration.
            v: (nv,) joint velocities.
            turns: (n_angles,) from which the angles of screws count [rad].
            given: (nv,) joint forces.
            needed: (nv,) joint forces that the motion needs without acceleration.
            anew: whether independent equations are chosen anew.
        """
        self.kkt.mass[:] = self.bodies.masses(q)
        return self.kkt.accelerations(q, v, turns, given, needed, anew)

    @property
    def _is_sure(self) -> bool:
        """Whether the KKT system has lost no digits that another way would keep.

        The other way is dense: of a large tree it is taken only where there is no solution at all.
        """
        return self.kkt.pivot >= TOLERANCES.rank if self._is_large else self.kkt.error <= DOUBTFUL

    @cached_property
    def least_constraint(self) -> LeastConstraint:
        """What finds accelerations for any masses."""
        return LeastConstraint(self.mechanism)

    def _by_least_constraint(self, given: Array) -> Least:
        state, scaled = self.state, self.scaled
        chosen = independent_rows(scaled)
        gamma = self.evaluation.bias(state.q, state.v)[chosen]
        coordinates = IndependentCoordinates(scaled[chosen], self.scale, state.closure_error)
        return self.least_constraint.solve(
            state.q, state.v, coordinates.carried(gamma, state.v), coordinates.columns, given)

    def _refuse(self, found: Least) -> None:
        """Refuse accelerations that forces do not determine, or not in these numbers.

        Raises:
            SingularError: as it says.
        """
        if found.pulled:
            raise self.no_inertia(_by_size(found.still / self.scale))
        if found.lost:
            worst = self.mechanism.coordinates[int(np.argmax(found.off / self.scale))]
            raise SingularError(
                f"mechanism {self.mechanism.name!r}: the acceleration of {worst} is lost in "
                "round-off beside bodies so much heavier: make the masses more alike, or the light "
                "ones zero", state=self.state)

    def no_inertia(self, motions: Array) -> SingularError:
        """Return the error for motions (k, nv) that forces work on but that have no inertia."""
        return no_inertia(self.mechanism, self.moving(motions), self.state)


def no_inertia(
    mechanism: Mechanism, names: list[str], state: State | None = None
) -> SingularError:
    """Return the error for forces on a motion of these coordinates that has no inertia."""
    return SingularError(
        f"mechanism {mechanism.name!r}: a motion of {', '.join(names)} has no inertia but a force "
        "works on it: give its links a mass or a moment of inertia", state=state)


def _by_size(motions: Array) -> Array:
    """Return motions (k, nv), each divided by its largest entry."""
    return motions / np.abs(motions).max(axis=1, keepdims=True, initial=1e-300)
