"""The equations of motion of a closed mechanism at one State.

    M a + b = f + J^T lambda,     J a + gamma = 0

with the mass matrix M, centrifugal, Coriolis and gravity forces b, given forces f, the closure
rows' Jacobian J (`closure_jacobian`) and multipliers lambda. All rows that depend on others are
left out when a is solved for, so that nothing is regularised; the multipliers of all rows are then
the shortest that bear the same loads.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.newton import Regular, lost_rank, rank_loss
from spatial_pin.assembly.passive_freedoms import is_in_loop, passive_freedoms
from spatial_pin.assembly.rounding import rounding_of
from spatial_pin.assembly.state import State, all_angles
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of, evaluation_of
from spatial_pin.constraints.pinocchio_views import forces as force_view
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.dynamics.forces import (
    Forces,
    Law,
    external_wrenches,
    generalised,
)
from spatial_pin.dynamics.reactions import UNMOVED, Pairs, Poses
from spatial_pin.dynamics.solvers.constraint_dynamics import NativeDynamics, native_of
from spatial_pin.dynamics.solvers.kkt import DOUBTFUL, ROUNDING, SINGULAR, Motions, SaddlePoint
from spatial_pin.dynamics.solvers.least_constraint import Least, LeastConstraint
from spatial_pin.errors import SingularError
from spatial_pin.mechanism.checks import refuse_negative_inertias
from spatial_pin.mechanism.inertia import MassMatrix
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.numerics.linalg import (
    Array,
    Decomposition,
    decompose,
    full_decomposition,
    independent_rows,
)

ON_AXIS = 1e-6  # characteristic lengths that a centre of mass may be off the axis of a link idle


class Equations:
    """Mass matrix, forces and closure rows of a mechanism, at the State of the last `update`.

    Attributes:
        pairs: the pairs of the mechanism.
        given: (nv,) generalised forces of springs, resistance and external wrenches.
        turning: (nv,) those of springs about joints, and of resistance.
        wrenches: (joint, (6,)) external wrenches and springs on bodies, at the world origin.
        scale: (nv,) velocity of a unit of each scaled unknown.
        error: estimated round-off of the last accelerations, by their size.
        native: Pinocchio's own algorithm, once asked for and if the mechanism has that form.
        asked: whether it was asked for.
    """

    error = 0.0

    def __init__(self, mechanism: Mechanism) -> None:
        refuse_negative_inertias(mechanism)
        self.mechanism, self.model = mechanism, mechanism.model
        self.pairs = Pairs(mechanism)
        self._laws: tuple[dict[str, Law], SlipSpeed | None] = {}, None
        self.springs = Forces(mechanism)
        self.scale = mechanism.velocity_scale
        self._svd: Decomposition | None = None
        self._rank: int | None = None
        self._regular: Regular | None = None
        self.native: NativeDynamics | None = None
        self.asked = False
        self._dense: SaddlePoint | None = None
        heavy = {k: i for k, i in enumerate(self.model.inertias) if k and i.mass > 0.0}
        self._heavy = np.array(list(heavy), dtype=int)
        self._levers = np.array([[*i.lever, 1.0] for i in heavy.values()]).reshape(-1, 4)
        self._rest = np.zeros(self.model.nv)
        self._make_rows()

    def _make_rows(self) -> None:
        """Make what evaluates the closure rows, once."""
        self.evaluation = Evaluation(constraints_of(self.mechanism))
        self.data = self.model.createData()
        self._mass = MassMatrix(self.model)
        self._columns = joint_jacobian(self.evaluation.data, self.model.nv)
        self._transmitted = force_view(self.data)

    def forget(self) -> None:
        """Forget the choice of rows, which is right at any place where it was made."""
        self._dense = None

    def update(
        self, state: State, external: Mapping[str, pin.Force] | None = None,
        laws: Mapping[str, Law] | None = None, slip_speed: SlipSpeed | None = None,
    ) -> None:
        """Evaluate rows and given forces at a State of this mechanism.

        The State of a rounded file is one of this mechanism without some equations: all of them
        bear loads, as those of the exact mechanism do.

        Args:
            state: configuration and velocity.
            external: wrenches at links, frames or joints, world axes [N, N·m].
            laws: of springs, see `Forces`.
            slip_speed: of dry friction, see `Forces`.
        """
        self.state = state
        self._svd = None
        evaluation = self.evaluation
        is_whole = state.mechanism.whole is not self.mechanism
        evaluation.turns[:] = (state.angles if is_whole else
                               all_angles(state.mechanism, state.angles))
        self._rank = None if is_whole else constraints_of(state.mechanism).n_rows
        evaluation.update(state.q)
        laws = dict(laws or {})
        slip_speed = dict(slip_speed) if isinstance(slip_speed, Mapping) else slip_speed
        if (laws, slip_speed) != self._laws:
            self._laws = laws, slip_speed
            self.springs = Forces(self.mechanism, laws, slip_speed)
        springs = self.springs
        self.wrenches = external_wrenches(self.mechanism, evaluation, external)
        self.turning = self.given = springs.turning(state.q, state.v)
        if springs.lines:
            self.wrenches += springs.wrenches(evaluation, state.v)
        if self.wrenches:
            self.given = self.turning + generalised(evaluation, self.wrenches)

    @property
    def applied(self) -> Array:
        """(nv,) generalised forces of springs and external wrenches, without resistance."""
        resistance = self.springs.resistance
        return self.given - resistance.forces(self.state.v) if resistance else self.given

    # ------------------------------------------------------------ closure rows

    @property
    def scaled(self) -> Array:
        """(n_rows, nv) Jacobian of the closure rows for scaled velocities."""
        return self.evaluation.jacobian[: self.evaluation.constraints.n_rows]

    @property
    def n_rows(self) -> int:
        """How many closure rows there are."""
        return self.evaluation.constraints.n_rows

    @property
    def spaces(self) -> Decomposition:
        """Decomposition of `scaled`: freedoms, self-stresses and what is between."""
        if self._svd is None:
            svd = full_decomposition(self.scaled)
            self._svd = svd if self._rank is None else svd._replace(rank=self._rank)
        return self._svd

    @property
    def self_stresses(self) -> Array:
        """(k, n_rows) multipliers that balance among themselves, as many as there are."""
        return self.spaces.left_null_space

    @property
    def row_wrenches(self) -> Array:
        """(n_wrenches, 6) wrench of each closure row at the world origin, and those after them."""
        return self.evaluation.row_wrenches()

    def check_rank(self, rank: int) -> None:
        """Refuse configurations in which the loops have lost rank.

        Raises:
            SingularError: they have; the motion is not determined by the forces.
        """
        if rank == self.n_rows:
            return
        with evaluation_of(self.mechanism, self.state.angles) as evaluation:
            lost = rank_loss(evaluation, self.state.q, rank)
            self._regular = evaluation.regular
            if lost:
                why = lost_rank(evaluation, self.state.q, lost, "forces")
                raise SingularError(
                    f"mechanism {self.mechanism.name!r}: {self.state}: {why}", state=self.state)

    def multipliers(self, closures: Array) -> Array:
        """Return the shortest multipliers (n_rows,) whose generalised force is `closures`."""
        return self.spaces.minimum_norm_transposed(self.scale * closures)

    def of_one_link(
        self, freedoms: Array, actuated: Iterable[Coordinate] | None = None
    ) -> list[tuple[str, Array]]:
        """Return (joint, (k, nv)) the motions that move one link only, of freedoms (n, nv), scaled.

        The freedoms leave actuators, the drivers by default, at rest.
        """
        found = passive_freedoms(self.evaluation, freedoms * self.scale, actuated)
        return [(joint, motions / self.scale) for joint, motions in found]

    def idle_among(self, found: list[tuple[str, Array]]) -> Array:
        """Return the idle rotations (k, nv) among motions of one link, from `of_one_link`.

        They turn a link of a loop and move no centre of mass.
        """
        idle = [np.zeros((0, len(self.scale)))]
        for joint, motions in found:
            if is_in_loop(self.mechanism, joint):
                svd = decompose(self._shifts(motions))
                moved = svd.s > ON_AXIS * np.abs(motions).max()
                idle.append(svd.vt[np.count_nonzero(moved) :] @ motions)
        return np.vstack(idle)

    def _shifts(self, motions: Array) -> Array:
        """Return how motions (k, nv), scaled, move the centres of mass, (3 bodies, k).

        Per characteristic length; nothing for bodies without mass.
        """
        supports = self.evaluation.constraints.supports
        twists = (self._columns * supports[self._heavy][:, None]) @ (motions * self.scale).T
        centres = (self._levers[:, None] @ self.evaluation.placements[self._heavy])[:, 0]
        moved = twists[:, :3] + np.cross(twists[:, 3:], centres[:, :, None], axis=1)
        return moved.reshape(-1, len(motions)) / self.mechanism.characteristic_length

    def round_off(self, a: Array) -> float:
        """Return what round-off leaves of scaled forces at accelerations a (nv,) [N·m]."""
        state, scale = self.state, self.scale
        weight = sum(i.mass for i in self.model.inertias) * float(
            np.linalg.norm(self.model.gravity.linear)) * self.mechanism.characteristic_length
        heaviest = float(np.abs(scale[:, None] * self.mass() * scale).max(initial=0.0))
        rates = float(np.abs(a / scale).max(initial=0.0))
        rates += float(np.abs(state.v / scale).max(initial=0.0)) ** 2
        return ROUNDING * (weight + heaviest * rates)

    def active_among(self, freedoms: Array, found: list[tuple[str, Array]]) -> Array:
        """Return the freedoms (k, nv) that are left without those of one link."""
        passive = np.vstack([np.zeros((0, len(self.scale))), *(motions for _, motions in found)])
        return decompose(passive @ freedoms.T).null_space @ freedoms

    # ------------------------------------------------------------ forces

    def forward(
        self, state: State, effort: Array, external: Mapping[str, pin.Force] | None,
        laws: Mapping[str, Law] | None, slip_speed: SlipSpeed | None = None,
    ) -> tuple[Array, Array | None]:
        """Return accelerations (nv,) and what closures add to the forces, None if not known.

        By Pinocchio's own algorithm (`native`) where it is right.

        Args:
            state: configuration and velocity.
            effort: (nv,) at joints.
            external: wrenches, as for `update`.
            laws: of springs, as for `update`.
            slip_speed: of dry friction, as for `update`.

        Raises:
            SingularError: as `accelerations`.
        """
        loaded = bool(external or laws or self.springs.exist)
        if loaded:
            self.update(state, external, laws, slip_speed)
        found = self._by_pinocchio(state, effort + self.given if loaded else effort)
        if found is not None:
            return found, None
        if not loaded:
            self.update(state)
        a, closures = self.accelerations(effort + self.given)
        if self._learn():
            found = self._by_pinocchio(state, effort + self.given)
        return (a, closures) if found is None else (found, None)

    def _by_pinocchio(self, state: State, force: Array) -> Array | None:
        if self.native is None:
            return None
        found = self.native.accelerations(state.q, state.v, force)
        if found is None or not self._is_known(state, self.native.rank):
            return None
        self.error = self.native.error
        return found

    def _is_known(self, state: State, rank: int) -> bool:
        """Whether loops of this rank are known to have lost none at a state."""
        if rank in (self.evaluation.constraints.n_rows, self.model.nv):
            return True
        known = self._regular
        return known is not None and known.holds(self.mechanism, state.q, rank)

    def _learn(self) -> bool:
        """Make Pinocchio's algorithm once; return whether it may serve."""
        if not self.asked:
            self.asked = True
            self.native = native_of(self.mechanism, self._mass)
        return self.native is not None

    def mass(self) -> Array:
        """Return the mass matrix (nv, nv)."""
        return self._mass(self.state.q)

    def motion_forces(self, a: Array) -> Array:
        """Return M a + b (nv,)."""
        return pin.rnea(self.model, self.data, self.state.q, self.state.v, a)

    def accelerations(self, force: Array) -> tuple[Array, Array]:
        """Return joint accelerations (nv,) and what the closures add to the forces, (nv,).

        Args:
            force: (nv,) joint efforts, springs and external wrenches.

        Raises:
            SingularError: a freedom has no inertia, or the loops have lost rank.
        """
        scaled = self.scaled
        gamma = self.evaluation.bias(self.state.q, self.state.v)[: len(scaled)]
        work = force - self.motion_forces(self._rest)
        mass = self.mass()
        known = self._dense is not None
        system = self._dense or self._chosen(mass, scaled)
        a, multipliers = system.solve(mass, scaled, work, gamma)
        self.error = system.error
        if known and (self.error > DOUBTFUL or not system.holds(a, scaled, gamma)):
            system = self._chosen(mass, scaled)
            a, multipliers = system.solve(mass, scaled, work, gamma)
            self.error = system.error
        if self.error > DOUBTFUL:
            found = self._by_freedoms(scaled[system.rows], gamma[system.rows], force)
            if system.pivot < SINGULAR or found.error < self.error:
                self.error = found.error
                self._check(found)
                return found.a, mass @ found.a - work
        return a, system.forces(multipliers)

    def _chosen(self, mass: Array, scaled: Array) -> SaddlePoint:
        """Return the equations for the independent rows of here, kept for the next time.

        Raises:
            SingularError: the loops have lost rank.
        """
        rows = independent_rows(scaled)
        self._dense = None  # what is singular is no choice for other places
        self.check_rank(len(rows))
        self._dense = SaddlePoint(self.scale, rows, mass, scaled)
        return self._dense

    def _by_freedoms(self, rows: Array, gamma: Array, force: Array) -> Least:
        """Solve near a singular configuration, or where inertias differ much, or are none."""
        state = self.state
        motions = Motions(rows, self.scale, state.closure_error)
        return self._least_constraint.solve(
            state.q, state.v, motions.carried(gamma, state.v), motions.columns, force)

    @cached_property
    def _least_constraint(self) -> LeastConstraint:
        return LeastConstraint(self.mechanism)

    def _check(self, found: Least) -> None:
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
        return SingularError(
            f"mechanism {self.mechanism.name!r}: a motion of {', '.join(self.moving(motions))} has "
            "no inertia but a force works on it: give its links a mass or a moment of inertia",
            state=self.state,
        )

    def moving(self, motions: Array) -> list[str]:
        """Return the names of the coordinates that move in the motions (k, nv)."""
        sizes = np.abs(motions).max(axis=0, initial=0.0)
        return [c for c, s in zip(self.mechanism.coordinates, sizes, strict=True) if s > 1e-6]

    # ------------------------------------------------------------ reactions

    def poses(self) -> Poses:
        """Return views on where the bodies are, overwritten by the next `update`."""
        return Poses(self.evaluation.placements, self._columns, self.row_wrenches)

    def transmitted(self, a: Array) -> Array:
        """Return (njoints, 6) what joints hand on to move as a (nv,) says, joint axes; a view."""
        self.motion_forces(a)
        return self._transmitted

    def reactions(
        self, a: Array, multipliers: Array, effort: Array
    ) -> tuple[dict[str, Array], Array]:
        """Return the reactions (6,) by pair and the wrench (6,) on the fixed link."""
        return self.pairs.reactions(
            self.poses(), self.transmitted(a), multipliers, self.pairs.summed(self.wrenches),
            self.at_joints(effort, multipliers, a))

    def at_joints(self, effort: Array, multipliers: Array, a: Array) -> Array:
        """Return efforts (nv,) with springs about joints and what couplings and rotors do there.

        A rotor (armature) that speeds up with its joint takes its part of the effort: the rest is
        what the bodies are moved with.
        """
        total = effort + self.turning - self.model.armature * a
        couplings = self._couplings()
        if len(couplings):
            total = total + multipliers[-len(couplings) :] @ couplings
        return total

    def _couplings(self) -> Array:
        """Return the efforts (n_couplings, nv) at joints of unit multipliers of the couplings."""
        n_rows = len(self.scaled)
        return self.scaled[n_rows - len(self.evaluation.constraints.couplings) :] / self.scale

    def unique(self, efforts: Array | None = None) -> dict[str, NDArray[np.bool_]]:
        """Return for every pair which components (6,) of its reaction are unique.

        Args:
            efforts: (k, nv) of actuators that the loops bear, and that may act besides.
        """
        stresses = self.self_stresses
        pressing = np.zeros((len(stresses), len(self.scale)))
        if efforts is not None and len(efforts):
            borne = np.array([self.multipliers(-e) for e in efforts])
            size = np.maximum(np.linalg.norm(borne, axis=1), 1e-300)[:, None]
            stresses = np.vstack([stresses, borne / size])
            pressing = np.vstack([pressing, efforts / size])
        rounding = 0.0 if self._rank is None else rounding_of(self.state.mechanism)
        return self.pairs.unique(self.poses(), self._couplings(), stresses, pressing,
                                 max(rounding, UNMOVED))


def _by_size(motions: Array) -> Array:
    """Return motions (k, nv), each divided by its largest entry."""
    return motions / np.abs(motions).max(axis=1, keepdims=True, initial=1e-300)
