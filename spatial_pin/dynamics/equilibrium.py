"""Poses at rest, where springs, weights and forces balance, and their stability."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import first_names
from spatial_pin._support.checks import checked, names_of, whole_number
from spatial_pin._support.columns import Quantity, Tabular, chosen
from spatial_pin._support.lazy import acquired
from spatial_pin._support.progress import in_order
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.close import closed, scaled_row
from spatial_pin.assembly.holding import free_bases, untied
from spatial_pin.assembly.start_values import turn_free_difference
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.derivatives.derivatives import exact_mechanism
from spatial_pin.dynamics.derivatives.small_motions import AppliedLoads, SmallMotions
from spatial_pin.dynamics.forces import Law
from spatial_pin.dynamics.solvers.equations_of_motion import Equations
from spatial_pin.dynamics.state_forces import Dynamics
from spatial_pin.errors import Interrupted, SpatialPinError
from spatial_pin.kernel.loop_equations import loops_at, loops_of
from spatial_pin.mechanism.coordinates import (
    coordinate_gradient,
    coordinate_value,
    driver_coordinates,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.mobility.assembly_modes import missing_by
from spatial_pin.mobility.idle_freedoms import PassiveFreedom
from spatial_pin.numerics.linalg import Array, decompose, pivoted_rows
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy, accuracy_of

# Steps of one search. Twenty suffice as a rule; after these the mechanism falls without end.
MOST_DESCENTS = 500
LONGEST = 0.3  # longest step [rad, characteristic lengths]: equilibria are farther apart as a rule
OVERSHOT = 0.5  # largest slope at the end of a step, relative to the one at its start
SHORTEST_DESCENT = 2.0**-30  # a step is halved down to this part: below it round-off decides
ARRIVED = 1e-13  # step [rad, characteristic lengths] at which the search has converged: round-off
NEAR_REST = 1e-7  # below this step only round-off keeps the next one from being shorter
WITHOUT_END = 100.0  # rad, characteristic lengths: a mechanism that goes so far falls without end
NEUTRAL = 1e-8  # stiffness that counts as zero, relative to its terms: half of the digits
BALANCED = 1e-9  # load that counts as zero, relative to its terms
PASSING = 1e-6  # change of accelerations and forces as a shaft turns that counts as zero
NUDGE = 0.05  # rad, characteristic lengths: displacement from an unstable pose, to descend from it
# Two searches that differ by less have one equilibrium: they agree to 1e-9 and better.
SAME_POSE = 1e-6
HALF_A_TURN = 1e-4  # rad: nearer to it the second derivatives of the rotation vector are lost
# Largest distances of start values from the guess [rad, characteristic lengths].
FAR_STARTS = (np.pi, 1.0, 0.3)
# Half of them descend: they meet a basin of a tenth of the space with a chance of 96 %.
RANDOM_STARTS = 60
POSE_KINDS = {True: "stable", False: "unstable", None: "neutral"}
Guess = Mapping[str, Any] | State | Array | None


class Equilibrium(Dynamics):
    """A pose at rest, with its reactions and stiffness.

    Attributes:
        state: the State; it moves and is accelerated where coordinates have a constant speed.
        coordinates: names of the independent coordinates, which `stiffness` is in.
        stiffness: (n, n) force on each per small motion of each [N/m, N·m/rad], loops closed.
        stable: whether the mechanism returns after a small push. False where some motion leads
            away; None where none does, but some lead to further poses at rest.
        neutral: coordinates that move in motions without stiffness.
        passive: idle rotations of links about their own axes: they are no part of the verdict.
        efforts: by held coordinate or driver, the effort that holds it [N·m, N]; of a component
            of a ball or floating joint, the one that works with its rate.
        energy: potential energy of weights and springs [J]; springs with a law store none.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.equilibrium(mech)  # where it hangs
        >>> found.stable, found.coordinates, found.stiffness.shape
        (True, ('crank',), (1, 1))
        >>> held = sp.equilibrium(mech, {"crank": 1.0}, hold="crank")
        >>> sorted(held.efforts)  # [N·m]
        ['crank']
    """

    def __init__(
        self, at: SmallMotions, coordinates: Sequence[str] | None, verdict: Stability
    ) -> None:
        loads, mechanism = at.loads, at.loads.mechanism
        names, rates, motions = independent_motions(at, verdict.free, coordinates)
        self.coordinates, self.idle = tuple(names), verdict.idle
        self.reduced = at.reduced(motions, rates)
        self.stiffness = self.reduced.stiffness
        self.stable, self.passive = verdict.stable, verdict.passive
        self.neutral = tuple(_moving(names, rates, verdict.neutral * mechanism.velocity_scale))
        with loops_of(mechanism, at.state.angles) as loops:
            loops.update(at.state.q)
            held = loads.rows(loops)
            n = loops.constraints.n_closure
            self.energy = float(loads.springs.forces.energy(loops, at.state.q)) + float(
                pin.computePotentialEnergy(
                    mechanism.model, mechanism.model.createData(), at.state.q))
        freedoms, held = decompose(held[:n]).null_space, held[n:]
        pull, scale = decompose(freedoms @ held.T), mechanism.velocity_scale
        effort = held.T @ pull.minimum_norm(freedoms @ (scale * at.wanted)) / scale
        self._internal_efforts = pull.null_space @ held / scale
        still = [c for c in mechanism.coordinate_table.values() if not loads.leaves(c)]
        rates = np.array([scaled_row(mechanism, c, at.state.q) for c in still])
        bearing = decompose(rates.reshape(-1, len(scale)).T).minimum_norm(scale * effort)
        drivers = {d.joint: d.name for d in mechanism.drivers.values()}
        self.efforts: dict[str, float] = {
            drivers.get(c.name, c.name): float(x / scale[c.v])
            for c, x in zip(still, bearing, strict=True)}
        super().__init__(
            at.state, (loads.external, loads.laws, None), at.state.a.copy(),
            at.wanted - effort, loads.effort + effort)

    @cached_property
    def unique(self) -> dict[str, NDArray[np.bool_]]:
        """Which components of each pair's reaction are unique, as in `Dynamics.unique`."""
        with self._equations() as equations:
            return equations.unique(self._internal_efforts)

    def __repr__(self) -> str:
        return f"Equilibrium({self._at!r}, {POSE_KINDS[self.stable]})"

    def __str__(self) -> str:
        lines = [f"{POSE_KINDS[self.stable]} at rest: {self._at}",
                 f"potential energy {self.energy:.9g} J"]
        if self.neutral:
            lines.append(f"no stiffness in {', '.join(self.neutral)}")
        lines += [f"idle: {freedom}" for freedom in self.passive]
        for name, row in zip(self.coordinates, self.stiffness, strict=True):
            lines.append(f"stiffness of {name}: " + ", ".join(f"{x:.9g}" for x in row))
        unit_of = self._at.mechanism.prescribed_coordinate
        lines += [f"effort that holds {name}: {x:.9g} {'N' if unit_of(name).unit == 'm' else 'N·m'}"
                  for name, x in self.efforts.items()]
        return "\n".join([*lines, super().__str__()])


class Equilibria(Tabular, list[Equilibrium]):
    """The distinct poses at rest that were found, by energy.

    As a table (`columns`, `to_csv`, `to_dataframe`, ...) it has a row for each.

    Attributes:
        starts: number of starts; `reached` of them ended at a pose at rest.
        counts: how many ended at each.
        missing: estimated number of poses that no start has led to [Chao1984].
        is_whole: whether nothing cut the search short (Ctrl-C).

    Example:
        >>> found = sp.equilibria(sp.load("four_bar"), starts=20)
        >>> len(found), found.missing  # poses, and the estimate of others
        (4, 0.0)
    """

    def __init__(
        self, poses: Iterable[Equilibrium] = (), *, starts: int = 0, counts: Sequence[int] = (),
        is_whole: bool = True,
    ) -> None:
        super().__init__(poses)
        self.starts, self.counts, self.is_whole = starts, tuple(counts), is_whole
        self.reached, self.missing = sum(counts), missing_by(counts)

    def quantities(self, outputs: str | Iterable[str] | None = None) -> dict[str, Quantity]:
        """Return quantities by name: coordinates, energy, kind, and how many starts reached it.

        Args:
            outputs: names of the wanted outputs; default all.

        Raises:
            UnknownNameError: there is none of a name.

        Example:
            >>> found = sp.equilibria(sp.load("four_bar"), starts=20)
            >>> found.columns(["energy", "kind"])["kind"].tolist()
            ['stable', 'unstable', 'stable', 'unstable']
        """
        table = {c.name: Quantity(np.array([float(one.state.q[c.q]) for one in self]), c.unit)
                 for c in self[0].state.mechanism.coordinate_table.values() if c.q >= 0
                 } if self else {}
        table["energy"] = Quantity(np.array([one.energy for one in self]), "J")
        table["kind"] = Quantity(np.array([POSE_KINDS[one.stable] for one in self], dtype=str), "")
        table["reached"] = Quantity(np.array(self.counts, dtype=int), "")
        return chosen(table, outputs, "equilibria")

    def __repr__(self) -> str:
        kinds = [POSE_KINDS[one.stable] for one in self]
        return (f"Equilibria({', '.join(f'{kinds.count(x)} {x}' for x in dict.fromkeys(kinds))} "
                f"of {self.starts} starts{'' if self.is_whole else '; cut short'})")

    def __str__(self) -> str:
        lines = [f"{len(self)} poses at rest from {self.starts} starts, {self.reached} of which "
                 f"reached one{'' if self.is_whole else '; cut short'}"]
        lines += [f"  {k}: {pose!r}, energy {pose.energy:.9g} J, reached {n} times"
                  for k, (pose, n) in enumerate(zip(self, self.counts, strict=True), start=1)]
        return "\n".join([*lines, f"about {self.missing:.0f} more must be expected"])


class Stability(NamedTuple):
    """The stability of a pose at rest.

    Attributes:
        stable: True, False or None, see `Equilibrium`.
        free: (n, nv) motions, scaled, without idle rotations.
        neutral: (m, nv) those among them without stiffness.
        down: (nv,) the motion, scaled, along which the potential falls most; None where it falls
            along none, or there is no potential.
        idle: (k, nv) idle rotations.
        passive: the same, as `mobility` names them.
    """

    stable: bool | None
    free: Array
    neutral: Array
    down: Array | None
    idle: Array
    passive: tuple[PassiveFreedom, ...]


@checked
def equilibrium(
    mechanism: Mechanism,
    guess: Guess = None,
    *,
    hold: str | Iterable[str] | None = None,
    speeds: Mapping[str, float] | None = None,
    efforts: Mapping[str, float] | None = None,
    external: Mapping[str, pin.Force] | None = None,
    laws: Mapping[str, Law] | None = None,
    coordinates: Iterable[str] | None = None,
    stable: bool | None = True,
    accuracy: Accuracy | None = None,
) -> Equilibrium:
    """Find a pose at rest under weights, springs and forces, loops closed.

    From the guess the potential energy is descended, by Newton steps with the exact stiffness, so
    that a stable pose is found. Nothing is held unless `hold` says so: drivers move.

    Args:
        mechanism: the mechanism.
        guess: start of the search, as for `assemble`; held coordinates have their values there.
        hold: names of joints, coordinates or drivers that stand still; "base" for a free base.
        speeds: by driver or coordinate, a constant speed [rad/s, m/s]: the mechanism is at rest
            relative to what turns so.
        efforts: by driver, joint or coordinate, constant [N·m, N].
        external: by link, frame or joint, the force on it at its origin, world axes, constant.
        laws: by spring, force as a function of (length, rate), see `forward_dynamics`.
        coordinates: the independent coordinates of the result; default the drivers that move,
            where they suffice, else those that move best.
        stable: None takes the nearest pose at rest, be it stable or not.
        accuracy: of closing; default "engineering".

    Returns:
        The Equilibrium.

    Raises:
        SpatialPinError: nothing supports a freedom; names it, and what would hold it. Or what
            has a constant speed takes the pose away from rest.
        AssemblyError: the guess cannot be closed.
        SingularError: the search came to a configuration where the loops lose rank.
        UnknownNameError: a name does not exist.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.equilibrium(mech, {"crank": 2.0})
        >>> found.stable, found.stiffness.round(4)  # of the crank [N·m/rad]
        (True, array([[1.3087]]))
    """
    setting = accuracy_of(accuracy)
    state = assembled(mechanism, None, guess, accuracy=setting)
    loads = AppliedLoads(exact_mechanism(state), hold, speeds, efforts, external, laws)
    at, verdict = rest_pose(loads, state, stable, setting)
    refuse_momentary_rest(at)
    return Equilibrium(at, None if coordinates is None else names_of(coordinates, "coordinates"),
                       verdict)


@checked
def equilibria(
    mechanism: Mechanism,
    guess: Guess = None,
    *,
    hold: str | Iterable[str] | None = None,
    speeds: Mapping[str, float] | None = None,
    efforts: Mapping[str, float] | None = None,
    external: Mapping[str, pin.Force] | None = None,
    laws: Mapping[str, Law] | None = None,
    coordinates: Iterable[str] | None = None,
    starts: int = RANDOM_STARTS,
    seed: int = 0,
    executor: Executor | None = None,
    accuracy: Accuracy | None = None,
) -> Equilibria:
    """Find all distinct poses at rest, stable and unstable ones, on all branches.

    Args:
        mechanism: the mechanism.
        guess: the first start; held coordinates have their values there.
        hold: as for `equilibrium`, as are speeds, efforts, external, laws, coordinates and
            accuracy.
        speeds: see `hold`.
        efforts: see `hold`.
        external: see `hold`.
        laws: see `hold`.
        coordinates: see `hold`.
        starts: number of starts, random but for the first.
        seed: of the random numbers.
        executor: whose workers take the starts, such as a ProcessPoolExecutor; the answer is the
            same.
        accuracy: see `hold`.

    Returns:
        The Equilibria, by energy, with the estimated number of missing ones.

    Raises:
        SpatialPinError: no start has led to a pose at rest.
        AssemblyError: the guess cannot be closed.
        UnknownNameError: a name does not exist.
        Interrupted: after Ctrl-C; `.result` has the poses until then.
        ValueError: starts is no whole number of at least 1.

    Example:
        >>> found = sp.equilibria(sp.load("four_bar"), starts=20)
        >>> [one.stable for one in found]  # two on either branch, by energy
        [True, False, True, False]
    """
    starts = whole_number(starts, "starts")
    if starts < 1:
        raise ValueError(f"starts is {starts}; it is at least 1")
    setting = accuracy_of(accuracy)
    state = assembled(mechanism, None, guess, accuracy=setting)
    names = None if coordinates is None else tuple(names_of(coordinates, "coordinates"))
    for name in names or ():
        mechanism.prescribed_coordinate(name)
    hold = hold if hold is None or isinstance(hold, str) else tuple(hold)
    acting = (hold, speeds, efforts, external, laws)
    AppliedLoads(exact_mechanism(state), *acting)  # a wrong name is an error before anything starts
    poses: list[Equilibrium] = []
    counts: list[int] = []
    jobs = [(state, acting, names, setting, seed, k) for k in range(starts)]
    try:
        for one in in_order(executor, _from_start, jobs):
            if one is None:
                continue
            same = [k for k, other in enumerate(poses) if _are_one(one, other)]
            if same:
                counts[same[0]] += 1
            else:
                poses.append(one)
                counts.append(1)
    except KeyboardInterrupt:
        raise Interrupted(None, _sorted(poses, counts, starts, False)) from None
    if not poses:
        equilibrium(mechanism, state, hold=hold, speeds=speeds, efforts=efforts,
                    external=external, laws=laws, accuracy=setting)  # which says why
    return _sorted(poses, counts, starts, True)


def _sorted(
    poses: Sequence[Equilibrium], counts: Sequence[int], starts: int, is_whole: bool
) -> Equilibria:
    order = sorted(range(len(poses)), key=lambda k: (
        round(poses[k].energy, 9), *np.round(poses[k].state.q, 6).tolist()))
    return Equilibria([poses[k] for k in order], starts=starts,
                      counts=[counts[k] for k in order], is_whole=is_whole)


def _from_start(
    state: State, acting: tuple[Any, ...], names: Sequence[str] | None, accuracy: Accuracy,
    seed: int, k: int,
) -> Equilibrium | None:
    """Return the pose at rest from start k: every second one descends, others go to the nearest."""
    mechanism = state.mechanism
    loads = AppliedLoads(mechanism, *acting)
    try:
        if k:
            rng = np.random.default_rng([seed, k])
            step = FAR_STARTS[k // 2 % len(FAR_STARTS)] * rng.uniform(
                -1.0, 1.0, mechanism.model.nv)
            step[list(loads.entries)] = 0.0
            there = displaced_state(loads, state, step, accuracy)
            if there is None:
                return None
            state = there
        at, verdict = rest_pose(loads, state, None if k % 2 else True, accuracy)
        refuse_momentary_rest(at)
    except SpatialPinError:  # it falls without end from there, or meets a singular configuration
        return None
    return Equilibrium(at, names, verdict)


def refuse_momentary_rest(at: SmallMotions) -> None:
    """Refuse a pose that is at rest for a moment only, because a shaft turns on.

    At rest relative to it nothing is accelerated, and the balance of forces does not change along
    the motion.

    Raises:
        SpatialPinError: names what moves on.
    """
    if not at.loads.speeds:
        return
    mechanism, scale = at.loads.mechanism, at.loads.mechanism.velocity_scale
    pace = np.abs(at.state.v / scale).max(initial=0.0)
    bent = np.abs(at.state.a / scale)
    lost = np.abs(at.freedoms * scale @ at.by_q @ at.state.v)
    if bent.max(initial=0.0) <= PASSING * pace**2 and (
            lost.max(initial=0.0) <= PASSING * at.size * pace):
        return
    name = mechanism.coordinates[int(np.argmax(bent))]
    turning = ", ".join(c.name for c in at.loads.speeds)
    why = (f"{name} is accelerated" if bent.max() > PASSING * pace**2 else
           "weights, springs or forces pull another way")
    raise SpatialPinError(
        f"mechanism {mechanism.name!r}: nothing stays at rest relative to {turning}: as it goes "
        f"on, {why}; speeds= is for a shaft about which all that acts is the same all round")


def _are_one(one: Equilibrium, other: Equilibrium) -> bool:
    """Whether two poses are the same, idle rotations apart."""
    apart = np.abs(turn_free_difference(one.state.mechanism, one.state.q, other.state.q))
    idle = np.abs(one.idle).max(axis=0, initial=0.0) > 0.0
    return bool(np.max(apart[~idle], initial=0.0) < SAME_POSE)


# ---------------------------------------------------------------- the search


def rest_pose(
    loads: AppliedLoads, state: State, stable: bool | None, accuracy: Accuracy
) -> tuple[SmallMotions, Stability]:
    """Return the pose at rest that a mechanism reaches from a state, and its stability.

    Raises:
        SpatialPinError: something falls without end.
        SingularError: the loops lose rank on the way.
    """
    gone = np.zeros(loads.mechanism.model.nv)
    last = np.inf
    for _ in range(MOST_DESCENTS):
        at = SmallMotions(loads, state)
        step = _newton_step(at, bool(stable))
        length = float(np.abs(step).max(initial=0.0))
        if length <= ARRIVED or (last <= NEAR_REST and length >= 0.5 * last):
            _refuse_half_a_turn(at)
            verdict = stability_of(at)
            down = verdict.down
            if not stable or down is None:
                return at, verdict
            down = down / down[np.argmax(np.abs(down) > 0.5 * np.abs(down).max())]  # one sense
            step, length = NUDGE * down / np.abs(down).max(), NUDGE
        there = _taken(at, state, step, bool(stable) and not loads.speeds, accuracy)
        gone += turn_free_difference(loads.mechanism, state.q, there.q)
        state, last = there, length
        if np.abs(gone).max(initial=0.0) > WITHOUT_END:
            break
    raise SpatialPinError(_fall_words(loads, gone, step))


def _refuse_half_a_turn(at: SmallMotions) -> None:
    """Refuse a pose where a spring by a rotation vector is wound by half a turn: its moment jumps.

    Raises:
        SpatialPinError: names the spring.
    """
    mechanism = at.loads.mechanism
    placements = loops_at(mechanism, at.state.q).placements
    for spring in at.loads.springs.forces.bushings:
        x, _, _ = spring.pose(placements)
        moment = np.abs(spring.force(x, np.zeros(6))[3:]).max()
        size = np.abs(spring.stiffness[3:]).max() + np.abs(spring.preload[3:]).max()
        if np.linalg.norm(x[3:]) > np.pi - HALF_A_TURN and moment > NEUTRAL * size:
            raise SpatialPinError(
                f"mechanism {mechanism.name!r}: spring {spring.name!r} is wound by half a turn, "
                f"where its moment jumps, so that nothing rests at {at.state}: start from another "
                "guess")


def _newton_step(at: SmallMotions, descends: bool) -> Array:
    """Return a Newton step (nv,), scaled, to balanced forces; a descent step if wanted."""
    reduced = at.orthonormal
    forces, terms = reduced.sizes
    if not len(forces):
        return np.zeros(at.freedoms.shape[1])
    least = NEUTRAL * terms.max()
    symmetric = 0.5 * (reduced.stiffness + reduced.stiffness.T)
    if at.loads.speeds and np.abs(reduced.stiffness - symmetric).max() > least:
        y = decompose(reduced.stiffness, NEUTRAL).minimum_norm(reduced.load)
    else:
        values, modes = np.linalg.eigh(symmetric)
        pull = modes.T @ reduced.load
        idle = (np.abs(values) <= least) & (np.abs(pull) <= BALANCED * forces.max())
        divisor = np.maximum(np.abs(values), max(least, 1e-300))
        if not descends:
            divisor = divisor * np.where(values < -least, -1.0, 1.0)
        y = modes @ np.where(idle, 0.0, pull / divisor)
    step: Array = y @ at.freedoms
    return step * min(1.0, LONGEST / max(float(np.abs(step).max()), 1e-300))


def _taken(
    at: SmallMotions, state: State, step: Array, descends: bool, accuracy: Accuracy
) -> State:
    """Return the state after a step, halved until loops close and a descent does not overshoot."""
    loads, mechanism, part = at.loads, at.loads.mechanism, 1.0
    scale = mechanism.velocity_scale
    slope = -float(at.wanted @ (scale * step))
    while part > SHORTEST_DESCENT:
        there = displaced_state(loads, state, part * step, accuracy)
        if there is not None:
            if not descends or part * np.abs(step).max() < NEAR_REST or slope <= 0.0:
                return there
            with acquired(mechanism, Equations) as equations:  # the power of the forces there
                equations.update(there, loads.external, loads.laws)
                along = decompose(loads.rows(equations.evaluation)).null_space
                force = equations.given + loads.effort - equations.motion_forces(equations.rest)
            if float(along @ (scale * force) @ (along @ step)) >= -OVERSHOT * slope:
                return there
        part *= 0.5
    raise SpatialPinError(
        f"mechanism {mechanism.name!r}: the loops cannot follow the search for a pose at "
        f"rest from {state}: start from another guess")


def displaced_state(
    loads: AppliedLoads, state: State, step: Array, accuracy: Accuracy
) -> State | None:
    """Return the closed state after a step (nv,), scaled; None if the loops do not close."""
    mechanism = loads.mechanism
    q = pin.integrate(mechanism.model, state.q, mechanism.velocity_scale * step)
    free = np.ones(len(step), dtype=bool)
    free[list(loads.entries)] = False
    pinned = {c.name: coordinate_value(mechanism, c, state.q) for c in loads.components}
    result = closed(mechanism, q, free, state.angles, accuracy.tolerance, pinned=pinned)
    if not result.error <= max(accuracy.tolerance, TOLERANCES.closed):
        return None
    with loops_of(mechanism, state.angles) as loops:
        loops.update(result.q, with_jacobian=False)
        return State(mechanism, result.q, closure_error=result.error, angles=loops.angles.copy())


# ---------------------------------------------------------------- the verdict


def stability_of(at: SmallMotions) -> Stability:
    """Return the stability of a pose at rest."""
    passive, idle = at.idle()
    free, scale = at.without_idle(idle), at.loads.mechanism.velocity_scale
    reduced = at.reduced(free * scale)
    stiffness = reduced.stiffness
    least = NEUTRAL * reduced.sizes[1].max(initial=0.0)
    symmetric = 0.5 * (stiffness + stiffness.T)
    has_potential = np.abs(stiffness - symmetric).max(initial=0.0) <= least
    values, modes = np.linalg.eigh(symmetric)
    svd = decompose(stiffness, 0.0)
    neutral = svd.vt[svd.s <= least] @ free
    stable: bool | None = bool(np.all(values > least))
    if not at.loads.speeds and has_potential:
        stable = False if np.any(values < -least) else True if stable else None
    else:
        roots, _ = vibrations(reduced.mass, reduced.damping, stiffness)
        grows = roots.real > NEUTRAL * max(np.abs(roots).max(initial=0.0), 1e-300)
        stable = False if grows.any() else None if len(neutral) else True
    falls = bool(np.any(values < -least)) and (has_potential or not at.loads.speeds)
    down = modes[:, 0] @ free if falls and stable is False else None
    return Stability(stable, free, neutral, down, idle, passive)


def vibrations(
    mass: Array, damping: Array, stiffness: Array
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the eigenvalues (2n,) [1/s] of M y'' + C y' + K y = 0, and their forms (2n, n).

    Motions without mass have no frequency, so there may be fewer.
    """
    from scipy.linalg import eig  # on use: it takes a tenth of a second

    n = len(mass)
    if not n:
        return np.zeros(0, complex), np.zeros((0, 0), complex)
    zero, one = np.zeros((n, n)), np.eye(n)
    stiff, heavy = (np.abs(x).max() or 1.0 for x in (stiffness, mass))
    pace = np.sqrt(stiff / heavy)  # time is counted in its inverse, so that all terms are alike
    roots, forms = eig(
        np.block([[zero, one], [-stiffness / stiff, -damping * (pace / stiff)]]),
        np.block([[one, zero], [zero, mass / heavy]]))
    finite = np.isfinite(roots)
    return pace * roots[finite], forms.T[finite, :n]


def independent_motions(
    at: SmallMotions, free: Array, chosen: Sequence[str] | None
) -> tuple[list[str], Array, Array]:
    """Return names of independent coordinates, their rates, and the motion per unit of each.

    Returns:
        Their names, (n, nv) their rates by the joints' velocities, and (n, nv) joint velocities per
        unit rate of each.

    Raises:
        SpatialPinError: those chosen are not as many as there are freedoms, or not independent.
        UnknownNameError: one of those chosen does not exist.
    """
    mechanism, q, n = at.loads.mechanism, at.state.q, len(free)
    scaled, table = free * mechanism.velocity_scale, mechanism.coordinate_table

    def rates_of(coordinates: Iterable[Coordinate]) -> tuple[Array, Array]:
        """Return rates (m, nv), and (m, n) those in the motions by the coordinates' sizes."""
        rows = [coordinate_gradient(mechanism, c, q) for c in coordinates]
        sizes = [mechanism.velocity_scale[c.v] for c in coordinates]
        rates = np.array(rows).reshape(-1, free.shape[1])
        return rates, (rates @ scaled.T) / np.array(sizes)[:, None]

    if chosen is not None:
        rates, own = rates_of([mechanism.prescribed_coordinate(name) for name in chosen])
        if len(rates) != n or decompose(own, TOLERANCES.near_singular).rank < n:
            raise SpatialPinError(
                f"mechanism {mechanism.name!r}: coordinates: {len(rates)} are given, but {n} "
                f"that are independent are needed: {', '.join(chosen)}")
        return list(chosen), rates, np.linalg.solve(scaled @ rates.T, scaled)
    drivers = {name: c for name, c in driver_coordinates(mechanism).items()
               if at.loads.leaves(c)}
    for known in (drivers, table):
        rates, own = rates_of(known.values())
        if decompose(own, TOLERANCES.near_singular).rank == n:
            best = pivoted_rows(own, n)
            rates = rates[best]
            return ([list(known)[k] for k in best], rates,
                    np.linalg.solve(scaled @ rates.T, scaled))
    raise AssertionError("all coordinates determine all motions")


def _moving(names: Sequence[str], rates: Array, motions: Array) -> list[str]:
    """Return which coordinates, of rates (n, nv), move in motions (m, nv)."""
    sizes = np.abs(motions @ rates.T).max(axis=0, initial=0.0)
    return [name for name, size in zip(names, sizes, strict=True)
            if size > TOLERANCES.half_precision * np.abs(motions).max(initial=0.0)]


def _fall_words(loads: AppliedLoads, gone: Array, step: Array) -> str:
    """Return the coordinates that move without end, and a remedy, as text."""
    mechanism = loads.mechanism
    largest = np.abs(step).max(initial=0.0)
    moving = [name for name, x, y in zip(mechanism.coordinates, step, gone, strict=True)
              if abs(x) > 0.1 * largest and abs(y) > 0.1 * np.abs(gone).max()]
    joints = {mechanism.coordinate(name).joint for name in moving}
    bases = [joint for joint in untied(mechanism) if joint in joints]
    if bases:
        hold = '"base"' if set(bases) <= set(free_bases(mechanism)) else repr(bases)
        return (f"mechanism {mechanism.name!r}: {', '.join(bases)} floats freely, and nothing "
                f"holds the machine: it falls without end; hold it (hold={hold}), or hang it on "
                "springs")
    names = first_names(moving)
    drivers = [mechanism.drivers[name].joint for name in mechanism.drivers]
    first = [name for name in moving if name in drivers] or moving[:1]
    return (f"mechanism {mechanism.name!r}: there is no pose at rest from this guess on: {names} "
            f"{'moves' if len(moving) == 1 else 'move'} without end, and nothing supports it; "
            f"hold it (hold={first!r}), or give it a spring or an effort")
