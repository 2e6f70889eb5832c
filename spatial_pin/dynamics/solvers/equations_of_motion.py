"""The equations of motion of a closed mechanism at one State, with its forces.

All closure equations that depend on others are left out when accelerations are solved for, so that
nothing is regularised; the multipliers of all of them are then the shortest that bear the same
loads.

Accelerations under forces come from one ladder of solvers, tried in order until one is accurate:

1. The KKT system, its independent equations and scaling chosen at the state (`kernel.kkt`), joints
   that no loop is built on eliminated before: an open tree has no KKT system. Of a long tree, where
   the second is slow, doubtful accelerations are corrected once.
2. Gauss's least constraint in independent coordinates, where round-off of the first may matter:
   near singular configurations of the loops, and where masses differ much or are zero.
3. An error that says why, where no digit is left or forces do not determine the motion.

What decides is the estimated round-off of the accelerations, relative to their size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.redundant_equations import rounding_of
from spatial_pin.assembly.state import State
from spatial_pin.constraints.kernel_tree import is_in_kernel
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.dynamics.forces import Forces, Law, external_wrenches, generalised
from spatial_pin.dynamics.reactions import UNMOVED, Pairs, Poses
from spatial_pin.dynamics.solvers.constrained_motion import PROBED, Loops
from spatial_pin.dynamics.solvers.least_constraint import (
    IndependentCoordinates,
    Least,
    LeastConstraint,
)
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kkt import KKT
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.mechanism_checks import refuse_negative_inertias
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.numerics.linalg import Array, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES

# Estimated error from which on the second solver is used, at twenty times the cost: the KKT system
# has ten digits then, and the error bound of the least constraint is less of an overestimate.
DOUBTFUL = TOLERANCES.rank
# Largest correction of a long tree's accelerations after which the rest is negligible.
CORRECTED = 1e-6
# Accelerations under forces: (nv,) of the joints, (nv,) joint forces of the closures, J^T
# multipliers, and the estimated round-off of the former, relative to their size.
Solution = tuple[Array, Array, float]
# Laws of springs and slip speed where the mechanism has its own.
OWN: tuple[dict[str, Law], SlipSpeed | None] = {}, None


class MotionEquations(Loops):
    """The equations of motion of a mechanism, M a + b = f + J^T multipliers, J a + gamma = 0.

    Mass matrix M and centrifugal, Coriolis and gravity forces b are Pinocchio's, J and gamma those
    of the closure equations.

    Attributes:
        undetermined: coordinates of motions without inertia, whose last accelerations are the
            least ones.
    """

    undetermined: tuple[str, ...] = ()
    _solved: KKT | None = None  # the system whose factors and multipliers are those of the State

    def solve(self, given: Array) -> Solution:
        """Return the accelerations under joint forces f (nv,) at the State of the last `move_to`.

        Raises:
            SingularError: a freedom has no inertia, or the loops have lost rank.
        """
        self.undetermined, self._solved = (), None
        state, kkt, is_open = self.state, self.core_kkt, not self.n_closure
        if not kkt.of_tree(state.q, state.v, self.angle_reference, given):
            return self._solved_with_all_joints(given)
        if not is_open:
            self.ranks.check(kkt.rank)
        if self.is_large:
            is_accurate = is_open or kkt.pivot >= TOLERANCES.rank
        elif kkt.error_of_tree <= DOUBTFUL:
            is_accurate = True
        elif is_open:
            is_accurate = kkt.is_of_forces or self.model.nv > PROBED
        else:
            is_accurate = kkt.is_of_forces and kkt.error <= DOUBTFUL
        if not is_accurate:
            return self._solved_with_all_joints(given)
        self._solved = kkt
        return kkt.a.copy(), kkt.closures.copy(), kkt.error_of_tree

    def _solved_with_all_joints(self, given: Array) -> Solution:
        """Return the accelerations by the KKT system of all joints, or by the least constraint."""
        kkt, state = self.kkt, self.state
        needed = self.tree.forces(state.q, state.v)
        a = self.by_kkt(state.q, state.v, self.angle_reference, given, needed).copy()
        closures, error = kkt.closures.copy(), kkt.error
        # the least constraint is dense: of a large tree only where the KKT system is singular
        is_accurate = kkt.pivot >= TOLERANCES.rank if self.is_large else error <= DOUBTFUL
        self.ranks.check(kkt.rank)
        if is_accurate:
            return a, closures, error
        if is_in_kernel(self.model) and not self.is_large and kkt.pivot >= TOLERANCES.zero:
            corrected = self._corrected(a, closures, given)
            if corrected[2] <= CORRECTED:
                return corrected
        least = self._least(given)
        if not (kkt.pivot < TOLERANCES.zero or least.error < error):
            return a, closures, error
        still = least.still / self.scale
        still = still / np.abs(still).max(axis=1, keepdims=True, initial=1e-300)
        self.undetermined = tuple(self.moving(still))
        if least.pulled:
            raise no_inertia_error(self.mechanism, self.undetermined, state)
        if least.lost:
            worst = self.mechanism.coordinates[int(np.argmax(least.off / self.scale))]
            raise SingularError(
                f"mechanism {self.mechanism.name!r}: the acceleration of {worst} is lost in "
                "round-off beside bodies so much heavier: make the masses more alike, or the light "
                "ones zero", state=state)
        return least.a, self.motion_forces(least.a) - given, least.error

    def _least(self, given: Array) -> Least:
        """Return the accelerations of least constraint, which hold for any ratio of masses."""
        scaled, state = self.scaled, self.state
        chosen = independent_rows(scaled)
        gamma = self.evaluation.bias(state.q, state.v)[chosen]
        coordinates = IndependentCoordinates(scaled[chosen], self.scale, state.closure_error)
        return self._least_constraint.solve(
            state.q, state.v, coordinates.carried(gamma, state.v), coordinates.columns, given)

    @cached_property
    def _least_constraint(self) -> LeastConstraint:
        return LeastConstraint(self.mechanism)

    def whole_kkt(self, closures: Array) -> KKT:
        """Return the KKT system of all joints, with the multipliers of joint forces of closures.

        Args:
            closures: (nv,) the joint forces, of the last `solve` at the State if not zero.
        """
        if self._solved is self.core_kkt and not self.tree.has_limbs:
            return self._solved
        state, kkt = self.state, self.kkt
        if self._solved is not kkt:
            self.by_kkt(state.q, state.v, self.angle_reference, closures, closures)
            _, multipliers = kkt.solve(-closures[None], np.zeros((1, self.n_closure)))
            kkt.multipliers[:] = multipliers[0]
            self._solved = kkt
        return kkt

    def by_kkt(self, q: Array, v: Array, reference: Array, given: Array, needed: Array) -> Array:
        """Return accelerations (nv,) from the KKT system; overwritten by the next call.

        `given` are joint forces (nv,), `needed` those of the motion without acceleration; angles of
        screws count from `reference`.
        """
        self.tree.masses(q, self.kkt.mass)
        return self.kkt.accelerations(q, v, reference, given, needed)

    def motion_forces(self, a: Array) -> Array:
        """Return M a + b (nv,)."""
        return self.tree.forces(self.state.q, self.state.v, a).copy()

    def _corrected(self, a: Array, closures: Array, given: Array) -> Solution:
        """Correct the KKT solution by the residual of forces and closure equations.

        Its estimate, from a condition, is far too large for a long arm that carries loops; by how
        much accelerations change tells how far off they were.
        """
        state = self.state
        missing = given + closures - self.motion_forces(a)
        opening = self.scaled @ (a / self.scale) + self.evaluation.bias(state.q, state.v)
        (change,), (multipliers,) = self.kkt.solve(missing[None], opening[None])
        closures = closures + (multipliers @ self.scaled) / self.scale
        sizes = np.abs([change, a]) / self.scale
        return a + change, closures, float(sizes[0].max() / max(sizes[1].max(), 1e-300))


def no_inertia_error(
    mechanism: Mechanism, names: Sequence[str], state: State | None = None
) -> SingularError:
    """Return the error for forces on a motion of these coordinates that has no inertia."""
    return SingularError(
        f"mechanism {mechanism.name!r}: a motion of {', '.join(names)} has no inertia but a force "
        "works on it: give its links a mass or a moment of inertia", state=state)


class Equations(MotionEquations):
    """The equations of motion with the forces that act, and the reactions that they cause.

    Attributes:
        given: (nv,) generalised forces of springs, resistance and external wrenches.
        turning: (nv,) those of springs about joints, and of resistance.
        wrenches: (joint, (6,)) external wrenches and springs on bodies, at the world origin.
    """

    def __init__(self, mechanism: Mechanism, large: bool | None = None) -> None:
        refuse_negative_inertias(mechanism)
        super().__init__(mechanism, large)
        self._laws = OWN
        self.springs = Forces(mechanism)

    def update(
        self, state: State, external: Any = None,
        laws: Mapping[str, Law] | None = None, slip_speed: SlipSpeed | None = None,
    ) -> None:
        """Move to a State of this mechanism, under given forces."""
        self.move_to(state)
        own = OWN if not laws and slip_speed is None else (
            dict(laws or {}), dict(slip_speed) if isinstance(slip_speed, Mapping) else slip_speed)
        if own is not self._laws and own != self._laws:
            self._laws, self.springs = own, Forces(self.mechanism, *own)
        springs, self.wrenches = self.springs, []
        self.given = self.turning = (
            springs.turning(state.q, state.v) if springs.exist else self.rest)
        if external:
            self.wrenches += external_wrenches(self.mechanism, self.evaluation, external)
        if springs.on_frames:
            self.wrenches += springs.wrenches(self.evaluation, state.v)
        if self.wrenches:
            self.given = self.turning + generalised(self.evaluation, self.wrenches)

    @property
    def applied(self) -> Array:
        """(nv,) generalised forces of springs and external wrenches, without resistance."""
        resistance = self.springs.resistance
        return self.given - resistance.forces(self.state.v) if resistance else self.given

    def mass(self) -> Array:
        """Return the mass matrix (nv, nv)."""
        return self.tree.mass_matrix(self.state.q)

    # ------------------------------------------------------------ reactions

    @cached_property
    def pairs(self) -> Pairs:
        """The pairs of the mechanism."""
        return Pairs(self.mechanism)

    def poses(self) -> Poses:
        """Return the placements of the bodies as views, overwritten at the next State."""
        evaluation = self.evaluation
        return Poses(evaluation.placements, joint_jacobian(evaluation.data, self.model.nv),
                     evaluation.row_wrenches())

    def reactions(
        self, a: Array, multipliers: Array, effort: Array
    ) -> tuple[dict[str, Array], Array]:
        """Return the reactions (6,) by pair and the wrench (6,) on the fixed link."""
        # a rotor (armature) that speeds up with its joint takes its part of the effort: the rest is
        # what the bodies are moved with
        at_joints = effort + self.turning - self.model.armature * a
        of_joints = self.constraints.of_joints
        if len(of_joints):
            at_joints = at_joints + multipliers[of_joints] @ self.joint_rows
        return self.pairs.reactions(
            self.poses(), self.tree.transmitted(self.state.q, self.state.v, a), multipliers,
            self.pairs.summed(self.wrenches), at_joints)

    def unique_in_loops(self, efforts: Array | None = None) -> dict[str, NDArray[np.bool_]]:
        """Return by pair which components (6,) of its reaction no self-stress of loops changes.

        Args:
            efforts: (k, nv) of actuators that the loops bear, and that may act besides.
        """
        stresses = self.spaces.left_null_space if self.n_closure else np.zeros((0, 0))
        pressing = np.zeros((len(stresses), len(self.scale)))
        if efforts is not None and len(efforts):
            borne = np.array([self.multipliers(-e) for e in efforts])
            size = np.maximum(np.linalg.norm(borne, axis=1), 1e-300)[:, None]
            stresses = np.vstack([stresses, borne / size])
            pressing = np.vstack([pressing, efforts / size])
        rounding = 0.0 if self._rank is None else rounding_of(self.state.mechanism)
        return self.pairs.unstressed(self.poses(), self.joint_rows, stresses, pressing,
                                     max(rounding, UNMOVED))

    def unique(self, efforts: Array | None = None) -> dict[str, NDArray[np.bool_]]:
        """Return by pair which components (6,) of its reaction are unique."""
        return self.pairs.beside_couplings(self.unique_in_loops(efforts), self.poses())
