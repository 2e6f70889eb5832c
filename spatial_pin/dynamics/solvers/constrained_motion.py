"""The loops of a mechanism at one State: their KKT system, freedoms and self-stresses.

For a large tree all is sparse: cost grows in proportion to the number of loops, and the dense
Jacobian is formed only on use.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.state import State, all_angles
from spatial_pin.assembly.undetermined import Regular, has_constant_rank, lost_rank_words, rank_loss
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.kernel_tree import KernelTree, is_large, mass_entries
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kkt import KKT, CoreKKT
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, Decomposition, SparseSpaces, full_decomposition
from spatial_pin.numerics.tolerances import TOLERANCES

# Freedoms of a large tree up to which lost rank is found by closing loops nearby. It uses dense
# factors, whose cost grows with the third power. Above, the second-order analysis decides.
PROBED = 128
# Largest residual of a redundant equation for a motion of unit size, relative to its terms. It is
# far above round-off, and far below the 1 of a loop that loses rank.
FOLLOWS = 1e-6


class Loops:
    """Closure equations and bodies of a mechanism, at the State of the last `move_to`.

    Its size decides whether it is treated as a large one, if `large` does not say so.

    Attributes:
        scale: (nv,) velocity of a unit of each scaled unknown.
        is_large: whether it is treated as a large one.
        rest: (nv,) zeros.
        ranks: refuses States in which the loops have lost rank.
    """

    def __init__(self, mechanism: Mechanism, large: bool | None = None) -> None:
        self.mechanism, self.model = mechanism, mechanism.model
        self.constraints, self.scale = constraints_of(mechanism), mechanism.velocity_scale
        self.n_closure = self.constraints.n_closure
        self.is_large = is_large(self.model) if large is None else large
        self.rest = np.zeros(self.model.nv)
        self.ranks = RankCheck(self)
        self._spaces: Decomposition | SparseSpaces | None = None
        self._tied_freedoms: tuple[Array, int] | None = None
        self._rank: int | None = None
        self._has_jacobian: bool | None = None  # of the evaluation at the State; None: not there

    def move_to(self, state: State) -> None:
        """Move to a State of this mechanism.

        The State of a file with rounded numbers is that of the mechanism without some redundant
        equations; all equations bear loads, as those of the exact mechanism do.
        """
        self.state, self._spaces, self._tied_freedoms = state, None, None
        is_rounded = state.mechanism.whole is self.mechanism
        self.angle_reference = (
            all_angles(state.mechanism, state.angles) if is_rounded else
            state.angles if state.angles.size else np.zeros(self.constraints.n_angles))
        self._rank = constraints_of(state.mechanism).n_closure if is_rounded else None
        self._has_jacobian = None

    @cached_property
    def tree(self) -> KernelTree:
        """The bodies, whose core is what loops are built on: the other joints are limbs."""
        joint_of = np.repeat(np.arange(self.model.njoints), self.model.nvs)
        is_core = np.isin(np.arange(self.model.njoints), joint_of[self.constraints.tied])
        return KernelTree(self.model, self.scale, is_core)

    @cached_property
    def kkt(self) -> KKT:
        """The KKT system of all joints."""
        return KKT(self.mechanism, mass_entries(self.tree, True))

    @cached_property
    def core_kkt(self) -> CoreKKT:
        """The KKT system of the core, as if its bodies had articulated inertias.

        Limbs are eliminated before, from the tips inwards, at a cost in proportion to their number:
        the articulated-body algorithm [Featherstone2008, 7.3]. An open tree is all limbs.
        """
        return CoreKKT(self.mechanism, self.tree)

    @cached_property
    def _evaluation(self) -> LoopEquations:
        return LoopEquations(self.mechanism)

    def _evaluated(self, with_jacobian: bool) -> LoopEquations:
        evaluation = self._evaluation
        if self._has_jacobian is None or with_jacobian > self._has_jacobian:
            evaluation.angle_reference[:] = self.angle_reference
            evaluation.update(self.state.q, with_jacobian=with_jacobian)
            self._has_jacobian = with_jacobian
        return evaluation

    @property
    def evaluation(self) -> LoopEquations:
        """The closure equations at the state; for a large tree without their dense Jacobian."""
        return self._evaluated(not self.is_large)

    @property
    def scaled(self) -> Array:
        """(n_closure, nv) Jacobian of the closure equations for scaled velocities."""
        return self._evaluated(True).jacobian[: self.n_closure]

    @property
    def joint_rows(self) -> Array:
        """(k, nv) joint forces per unit multiplier of the equations `Constraints.of_joints`."""
        if not len(self.constraints.of_joints):
            return np.zeros((0, self.model.nv))
        return self.evaluation.joint_rows()

    # ------------------------------------------------------------ subspaces

    @property
    def spaces(self) -> Decomposition | SparseSpaces:
        """Null space (freedoms), left null space (self-stresses) and row space of the equations.

        They are dense where the file's numbers are rounded, whose rank is that of fewer equations,
        and where it is uncertain which equations are independent.
        """
        if self._spaces is None and self.is_sparse:
            self.rest_without_masses(self.rest, self.rest)
            kkt, n = self.kkt, self.n_closure

            def nearest(motions: Array) -> Array:
                projected, _ = kkt.solve(motions / self.scale, np.zeros((len(motions), n)))
                return projected / self.scale

            if kkt.pivot > TOLERANCES.rank:
                sparse = SparseSpaces(*kkt.entries, (n, len(self.scale)), kkt.rank, nearest)
                self._spaces = sparse if sparse.is_sure else None
        if self._spaces is None:
            svd = full_decomposition(self.scaled)
            self._spaces = svd if self._rank is None else svd._replace(rank=self._rank)
        return self._spaces

    @property
    def is_sparse(self) -> bool:
        """Whether the subspaces are sparse: those of a large tree whose numbers are exact."""
        return self.is_large and self._rank is None

    @property
    def tied_freedoms(self) -> tuple[Array, int]:
        """Freedoms (k, nv), scaled, of the coordinates in equations, and the equations' rank."""
        if not self.n_closure:
            return np.zeros((0, self.model.nv)), 0
        if self._tied_freedoms is None:
            tied = self.constraints.tied
            svd = full_decomposition(self.scaled[:, tied])
            rank = svd.rank if self._rank is None else self._rank
            freedoms = np.zeros((int(tied.sum()) - rank, len(tied)))
            freedoms[:, tied] = svd._replace(rank=rank).null_space
            self._tied_freedoms = freedoms, rank
        return self._tied_freedoms

    def multipliers(self, closures: Array) -> Array:
        """Return the shortest multipliers (n_closure,) whose generalised force is `closures`."""
        if not self.n_closure:
            return np.zeros(0)
        return self.spaces.minimum_norm_transposed(self.scale * closures)

    def moving(self, motions: Array) -> list[str]:
        """Return the names of the coordinates that move in the motions (k, nv)."""
        sizes = np.abs(motions).max(axis=0, initial=0.0)
        return [c for c, s in zip(self.mechanism.coordinates, sizes, strict=True) if s > 1e-6]

    def rest_without_masses(self, v: Array, force: Array) -> Array:
        """Solve the KKT system with a unit mass matrix of the scaled velocities."""
        rows, columns, at = mass_entries(self.tree, True)
        own = rows == columns
        self.kkt.mass[:] = 0.0
        self.kkt.mass[at[own]] = self.scale[rows[own]] ** -2.0
        return self.kkt.accelerations(self.state.q, v, self.angle_reference, force, self.rest)


class RankCheck:
    """Refuses configurations in which the loops have lost rank.

    Args:
        loops: whose State it is.
    """

    def __init__(self, loops: Loops) -> None:
        self._loops, self._mechanism = loops, loops.mechanism
        self._regular: Regular | None = None
        self._last_at: State | None = None  # where the rank was checked last
        self._last = 0

    def check_many(
        self, ranks: NDArray[np.int64], q: Array, state: Callable[[int], State]
    ) -> None:
        """Do `check` of each rank at q (n, nq), whose State is made where it is needed."""
        k = 0
        while not (kept := self._keep(ranks[k:], q[k:])).all():
            k += int(kept.argmin())
            self._loops.move_to(state(k))
            self.check(int(ranks[k]))
            k += 1

    def _keep(self, ranks: NDArray[np.int64], q: Array) -> NDArray[np.bool_]:
        """Whether the equations surely keep each rank near q (n, nq), by known bounds."""
        kept = np.asarray(has_constant_rank(self._mechanism, self._loops.n_closure, ranks))
        if self._regular is not None and not kept.all():
            kept |= self._regular.holds(self._mechanism, q, ranks)
        return kept

    def check(self, rank: int) -> None:
        """Refuse the State if its loops, of this rank, have lost some.

        Raises:
            SingularError: they have; the motion is not determined by the forces.
        """
        loops, state = self._loops, self._loops.state
        if self._last_at is state and self._last == rank:
            return
        if has_constant_rank(self._mechanism, loops.n_closure, rank) or (
                self._keep(np.array([rank]), state.q[None])[0]):
            self._last_at, self._last = state, rank
            return
        if loops.is_large and loops.model.nv > PROBED:
            self._check_second_order(rank)
            return
        with loops_of(self._mechanism, loops.angle_reference) as evaluation:
            lost = rank_loss(evaluation, state.q, rank)
            self._regular = evaluation.regular
            if lost:
                why = lost_rank_words(evaluation, state.q, lost, "forces")
                raise SingularError(
                    f"mechanism {self._mechanism.name!r}: {state}: {why}", state=state)

    def _check_second_order(self, rank: int) -> None:
        """Refuse a configuration where redundant equations become independent nearby.

        They do if J a = -gamma(v) has no solution for a motion v that the loops allow
        [ConnellyWhiteley1996]; a random v is tried.
        """
        loops, state, scale = self._loops, self._loops.state, self._loops.scale
        random = np.random.default_rng(3).standard_normal(len(scale))
        motion = loops.rest_without_masses(loops.rest, random / scale).copy()
        if loops.kkt.pivot >= TOLERANCES.rank:
            a = loops.rest_without_masses(motion, loops.rest)
            rows, columns, values = loops.kkt.entries
            gamma = loops.evaluation.bias(state.q, motion)[: loops.n_closure]
            terms, fastest = values * (a / scale)[columns], np.abs(motion / scale).max()
            lacking = np.abs(np.bincount(rows, terms, loops.n_closure) + gamma)  # J a + gamma
            size = max(float(np.abs(terms).max()), float(fastest) ** 2)
            if float(lacking.max()) / size > FOLLOWS:
                raise SingularError(
                    f"mechanism {self._mechanism.name!r}: {state}: singular configuration: the "
                    "loops lose independent equations there, so that the forces do not determine "
                    "the motion; start beside this configuration", state=state)
        self._regular = Regular(state.q.copy(), rank, 0.0)
