"""Derivatives of the constrained dynamics, by implicit differentiation.

The equations M a + b - f - J^T lambda = 0 and r'' = J a + gamma = 0 are differentiated with
respect to q, v and f; the unknown derivatives of a and lambda solve the same linear system as a and
lambda do. The kernel differentiates M a + b and the rows, on joints whose motion subspace is
constant (`constraints.composite_joints`), see `row_derivatives`.
`computeConstraintDynamicsDerivatives` is not used: in Pinocchio 4.1 its derivatives by q differ
from the differences of its own accelerations on trees with composite joints, and on the RSSR.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import checked
from spatial_pin._support.lazy import acquired, made_once
from spatial_pin.assembly.state import State, angles_of, at_sample, moving_in_time, pieces
from spatial_pin.constraints.composite_joints import single_joints
from spatial_pin.constraints.kernel_tree import TreeTask, centred_tree
from spatial_pin.dynamics.derivatives.reaction_derivatives import Linear, ReactionChanges
from spatial_pin.dynamics.derivatives.row_derivatives import RowDerivatives, products_of
from spatial_pin.dynamics.derivatives.spring_derivatives import ExternalWrenches, Slopes, Springs
from spatial_pin.dynamics.forces import Law, joint_efforts, warn_of_no_inertia
from spatial_pin.dynamics.loaded_samples import External, efforts_over, forces_at
from spatial_pin.dynamics.solvers.equations_of_motion import DOUBTFUL, Equations
from spatial_pin.dynamics.state_forces import Dynamics
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kernel.kkt import ERROR, FAILED, PIVOT, RANK, Accelerated
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array, null_space
from spatial_pin.numerics.tolerances import TOLERANCES

# Forces at frames, laws of springs, their slopes, slip speed.
Load = tuple[External | None, Mapping[str, Law] | None, Mapping[str, Slopes] | None,
             SlipSpeed | None]


class Derivatives:
    """Derivatives of `forward_dynamics` at a state, or at the N samples of a motion.

    Changes of q are joint velocities (the tangent of `pin.integrate`). Where loops are
    overconstrained, a_by_q dq + a_by_v dv holds for changes that keep the loops closed, in position
    and in velocity; the multipliers are those of `rows` alone, the others being zero.

    Over a Motion all have a leading axis (N, ...).

    Attributes:
        a: (nv,) the accelerations [rad/s², m/s²].
        a_by_q, a_by_v, a_by_effort: (nv, nv).
        rows: indices of the independent closure equations.
        multipliers: (len(rows),) of these rows.
        multipliers_by_q, multipliers_by_v, multipliers_by_effort: (len(rows), nv).

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.dynamics_derivatives(mech, sp.assemble(mech, {"crank": 1.0}))
        >>> found.a.shape, found.a_by_q.shape, found.multipliers_by_q.shape
        ((3,), (3, 3), (2, 3))
        >>> found.reactions["output_pin"].by_q.shape, found.on_ground.by_v.shape  # (6, nv)
        ((6, 3), (6, 3))
    """

    def __init__(
        self, a: Linear, rows: NDArray[np.intp], multipliers: Linear,
        reactions: Callable[[], tuple[dict[str, Linear], Linear]],
    ) -> None:
        self._a, self.rows, self._multipliers = a, rows, multipliers
        self.a, self.a_by_q, self.a_by_v, self.a_by_effort = a
        (self.multipliers, self.multipliers_by_q, self.multipliers_by_v,
         self.multipliers_by_effort) = multipliers
        self._reactions = reactions

    @cached_property
    def _borne(self) -> tuple[dict[str, Linear], Linear]:
        return self._reactions()

    @property
    def reactions(self) -> dict[str, Linear]:
        """By pair, tree joint or closure: `value` (6,), `by_q`, `by_v`, `by_effort` (6, nv).

        The force, then the moment, that the pair exerts, as in `Dynamics.reactions`: world axes,
        about the pair's own origin, which moves with it. All NaN where loops can be under stress by
        themselves: a reaction that is not unique has no derivative. Beside couplings without teeth
        or strands they are those of `Dynamics.reactions`, without these couplings' forces. Worked
        out at first use.
        """
        return self._borne[0]

    @property
    def on_ground(self) -> Linear:
        """Shaking wrench (6,) at the world's origin with its derivatives; unique always."""
        return self._borne[1]

    def __repr__(self) -> str:
        nv, of_many = self.a.shape[-1], f" at {len(self.a)} samples" if self.a.ndim > 1 else ""
        return (f"Derivatives({nv} accelerations, {self.rows.shape[-1]} multipliers and the "
                f"reactions by {nv} q, v and efforts{of_many})")


def stacked(parts: Iterable[Linear]) -> Linear:
    """Return quantities of samples and their derivatives as one, with a leading axis."""
    return Linear(*(np.stack(x) for x in zip(*parts, strict=True)))


@checked
def dynamics_derivatives(
    mechanism: Mechanism,
    state: State | Motion,
    efforts: Mapping[str, Any] | None = None,
    *,
    external: External | None = None,
    laws: Mapping[str, Law] | None = None,
    slopes: Mapping[str, Slopes] | None = None,
    slip_speed: SlipSpeed | None = None,
) -> Derivatives:
    """Differentiate `forward_dynamics` with respect to q, v and joint efforts.

    Args:
        mechanism: the mechanism, with its springs and gravity.
        state: configuration and velocity; or a Motion, for all its samples.
        efforts: by driver, joint or coordinate [N·m, N]; over a Motion as for `forward_dynamics`.
        external: by link, frame or joint, the force on it at its origin, world axes; it keeps its
            world axes as the frame moves. Over a Motion as for `forward_dynamics`.
        laws: of springs, as for `forward_dynamics`; smooth at the state.
        slopes: by spring with a law, its derivatives with respect to (length, rate) as a function
            of (length, rate); extrapolated differences of the law where not given.
        slip_speed: of dry friction, as for `forward_dynamics`.

    Returns:
        The Derivatives, those of the reactions among them.

    Raises:
        SingularError: as `forward_dynamics`.
        SpatialPinError: the numbers of the mechanism's file are rounded, see `State.gap`; or the
            frames of a spring coincide, and its force or damping has no direction.
        UnknownNameError: a name does not exist.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.assemble(mech, {"crank": 1.0})
        >>> found = sp.dynamics_derivatives(mech, state, {"crank": 0.1})  # [N·m]
        >>> found.a.shape, found.a_by_q.shape  # (nv,), (nv, nv)
        ((3,), (3, 3))
        >>> found.a_by_effort[:, 0].round(1)  # rad/s² per N·m on the crank
        array([ 105.3, -130.9,   20.4])
    """
    if not isinstance(state, State):
        return _over(mechanism, state, efforts, (external, laws, slopes, slip_speed))
    state = moving_in_time(mechanism, state)
    mechanism = exact_mechanism(state)
    effort, undetermined = joint_efforts(mechanism, efforts), tuple[str, ...]()
    with acquired(mechanism, Equations) as equations:
        equations.update(state, external, laws, slip_speed)
        springs, outside = (
            Springs(equations.springs, laws, slopes), ExternalWrenches(mechanism, external))
        found = None if external else _together(
            equations, springs, state.q[None], state.v[None], equations.angle_reference[None],
            effort[None])
        if found:
            a, closures, error, rank = (found.a[0], found.closures[0], found.facts.item(ERROR),
                                        int(found.facts.item(RANK)))
            equations.ranks.check(rank)
        else:
            a, closures, error = equations.solve(effort + equations.given)
            undetermined = equations.undetermined
        answer = Dynamics(state, (external, laws, slip_speed), a, closures, effort, error,
                          undetermined)
        rows = RowDerivatives(
            mechanism, springs.forces, (state.q, state.v, a), equations.angle_reference)
        springs.move(rows)
        springs.refuse_undirected()
        if found:
            chosen, multipliers = found.chosen[0, :rank], found.multipliers[0]
            a_by, multipliers_by = found.a_by[0].mT, found.multipliers_by[0].mT
        else:
            kkt = equations.whole_kkt(closures) if equations.n_closure else equations.core_kkt
            chosen, multipliers = kkt.rows, kkt.multipliers.copy()
            a_by, multipliers_by = _changes(equations, rows, springs, outside, multipliers)
    of_a, lam = Linear(a, *a_by), Linear(multipliers[chosen], *multipliers_by[:, chosen])
    warn_of_no_inertia(mechanism, efforts, external)

    def reactions() -> tuple[dict[str, Linear], Linear]:
        wrenches, ground = ReactionChanges(
            rows, springs, outside, effort, of_a, lam, chosen).wrenches()
        unique = answer.of_loops
        return {name: _linear(x if unique[name].all() else np.full_like(x, np.nan))
                for name, x in wrenches.items()}, _linear(ground)

    return Derivatives(of_a, chosen, lam, reactions)


def _linear(x: Array) -> Linear:
    return Linear(x[:, 0], *np.split(x[:, 1:], 3, axis=1))


def _over(
    mechanism: Mechanism, motion: Motion, efforts: Mapping[str, Any] | None, load: Load
) -> Derivatives:
    """Return the derivatives at all samples of a motion."""
    n = len(motion)
    if not n:
        raise SpatialPinError(f"mechanism {mechanism.name!r}: the motion has no samples")
    moved, (external, laws, slopes, slip_speed) = exact_mechanism(motion.state(0)), load
    acting, forces = efforts_over(mechanism, motion, efforts), forces_at(
        mechanism, motion, external)

    def alone(k: int) -> Derivatives:
        state = motion.state(k)
        with at_sample(k):
            return dynamics_derivatives(
                mechanism, state, {name: float(x[k]) for name, x in acting.items()},
                external=forces(k, state) if forces else None, laws=laws, slopes=slopes,
                slip_speed=slip_speed)

    def reactions() -> tuple[dict[str, Linear], Linear]:
        pairs, ground = zip(*((x.reactions, x.on_ground) for x in map(alone, range(n))),
                            strict=True)
        return {name: stacked(x[name] for x in pairs) for name in pairs[0]}, stacked(ground)

    parts = list[tuple[Linear, NDArray[np.intp], Linear]]()
    for at in pieces(motion):
        at = slice(at.start, min(at.stop, n))
        part = None if external else _piece(moved, motion, at, acting, load)
        if part is None:
            each = [alone(k) for k in range(at.start, at.stop)]
            part = (stacked(x._a for x in each), np.stack([x.rows for x in each]),
                    stacked(x._multipliers for x in each))
        parts.append(part)
    a, rows, multipliers = zip(*parts, strict=True)
    return Derivatives(Linear(*map(np.concatenate, zip(*a, strict=True))), np.concatenate(rows),
                       Linear(*map(np.concatenate, zip(*multipliers, strict=True))), reactions)


def _piece(
    moved: Mechanism, motion: Motion, at: slice, acting: Mapping[str, Array], load: Load
) -> tuple[Linear, NDArray[np.intp], Linear] | None:
    """Return the derivatives of a piece of a motion, by the kernel; None where it cannot."""
    _, laws, slopes, slip_speed = load
    effort, v = np.zeros((2, at.stop - at.start, moved.model.nv))
    for name, x in acting.items():
        effort[:, moved.driven_coordinate(name).v] += x[at]
    if motion.per == "s":
        v = motion.v[at]
    with acquired(moved, Equations) as equations:
        equations.update(motion.state(at.start), None, laws, slip_speed)
        found = _together(equations, Springs(equations.springs, laws, slopes), motion.q[at], v,
                          angles_of(motion)[at], effort)
        if found is None:
            return None
        ranks = found.facts[:, RANK].astype(np.int64)
        equations.ranks.check_many(ranks, motion.q[at], motion[at].state)
    rows = found.chosen[:, : ranks[0]]
    by = np.take_along_axis(found.multipliers_by, rows[:, None, None], axis=3)
    return (Linear(found.a, *found.a_by.mT.swapaxes(0, 1)), rows, Linear(
        np.take_along_axis(found.multipliers, rows, axis=1), *by.mT.swapaxes(0, 1)))


def _together(
    equations: Equations, springs: Springs, q: Array, v: Array, angles: Array, effort: Array
) -> Accelerated | None:
    """Return accelerations at configurations (n, nq) with derivatives, all in the kernel.

    None where that is not possible: forces at bodies act, rows are composed, joints are outside of
    loops, the loops have several ranks, or accelerations are doubtful.
    """
    c, forces = equations.constraints, springs.forces
    if (len(c.plain) < c.n_closure or forces.on_frames or not equations.n_closure
            or equations.tree.has_limbs):
        return None
    slopes = None
    if forces.exist:
        turning = np.array([springs.turned(*x) for x in zip(q, v, strict=True)])
        effort, slopes = effort - turning[:, 0], turning[:, 1:]
    with acquired(equations.mechanism, centred_tree) as tree:
        tree.take_masses()
        found = equations.core_kkt.of_many(
            q, v, angles, effort, changes=(tree, _task_of_changes(equations), slopes))
    facts = found.facts.T.tolist()
    is_sure = (min(facts[PIVOT]) >= TOLERANCES.rank if equations.is_large else
               max(facts[ERROR]) <= DOUBTFUL and min(facts[PIVOT]) >= TOLERANCES.zero)
    has_one_rank = min(facts[RANK]) == max(facts[RANK])
    return found if is_sure and has_one_rank and not max(facts[FAILED]) else None


@made_once
def _task_of_changes(equations: Equations) -> TreeTask:
    """Return what the kernel finds changes of joint forces and of closure equations by."""
    mechanism, n, nv = equations.mechanism, equations.n_closure, equations.model.nv
    by_q, by_v = np.empty((2, 3, n, nv))
    outside = np.zeros((len(single_joints(mechanism).kind), 6))
    return TreeTask.of(**products_of(mechanism), outside=outside, values=np.empty((3, n)),
                       product_by_q=by_q, product_by_v=by_v, bent=np.empty((nv, nv)))


def exact_mechanism(state: State) -> Mechanism:
    """Return the mechanism of a state; refuse one whose file's numbers are rounded."""
    mechanism = state.mechanism
    if mechanism.whole is not None:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: its file's numbers are rounded (state.gap is "
            f"{float(state.gap):.1e}), and derivatives of forces are made for exact ones only: "
            "write more digits into the file")
    return mechanism


def changes_of_forces(
    rows: RowDerivatives, springs: Springs, outside: ExternalWrenches, multipliers: Array,
    out: Array | None = None,
) -> tuple[Array, Array]:
    """Return q and v derivatives (nv, nv) of M a + b - f - J^T multipliers, multipliers constant.

    `out` (2, nv, nv) are zeros, to be filled with the transposed derivatives.
    """
    total = np.zeros((2, rows.nv, rows.nv)) if out is None else out
    by_q, by_v = total[0].T, total[1].T
    weights, composed = rows.weights(multipliers, springs.pulls)
    rows.force_changes(outside.on_joints(rows), weights, total)
    if composed is not None:
        by_q -= composed
    outside.take_turning(by_q, rows)
    springs.take_slopes(by_q, by_v)
    return by_q, by_v


def _changes(
    equations: Equations, rows: RowDerivatives, springs: Springs, outside: ExternalWrenches,
    multipliers: Array,
) -> tuple[Array, Array]:
    """Return derivatives with respect to q, v, efforts: of accelerations, and of multipliers.

    The former are (3, nv, nv), the latter (3, n_closure, nv); `multipliers` (n_closure,) are those
    of the KKT system.

    Raises:
        SingularError: a motion has no inertia.
    """
    nv, n, state = rows.nv, equations.n_closure, equations.state
    work = np.zeros((3, nv, nv))
    changes_of_forces(rows, springs, outside, multipliers, work[:2])
    np.negative(work[:2], out=work[:2])
    flat = work.reshape(3 * nv, nv)
    work.reshape(-1)[2 * nv * nv :: nv + 1] = 1.0
    if not n and equations.tree.respond(state.q, state.v, flat):
        return work.swapaxes(1, 2), np.zeros((3, 0, nv))
    kkt = equations.whole_kkt(equations.rest)
    if kkt.pivot < TOLERANCES.zero:
        freedoms = null_space(equations.scaled) * equations.scale
        inertias = freedoms @ equations.mass() @ freedoms.T
        motion = np.linalg.eigh(inertias)[1][:, 0] @ freedoms  # that of the least inertia
        sizes = np.abs(motion / equations.scale)
        names = equations.moving((sizes / sizes.max())[None])
        raise SingularError(
            f"mechanism {equations.mechanism.name!r}: {state}: beside others a motion of "
            f"{', '.join(names)} has no inertia, so accelerations have no "
            "derivatives there: give its links more mass", state=state)
    gamma = np.zeros((3, nv, n))
    for out, change in zip(gamma, rows.changes(2), strict=False):
        out[:] = change.T
    a_by, multipliers_by = kkt.solve(flat, gamma.reshape(3 * nv, n))
    return (a_by.reshape(3, nv, nv).swapaxes(1, 2),
            multipliers_by.reshape(3, nv, n).swapaxes(1, 2))
