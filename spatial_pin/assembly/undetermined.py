"""Undetermined motions: loops that lose equations, checks, and the text of errors."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import close
from spatial_pin.assembly.holding import BASE, SPRINGS, free_bases, velocity_entries
from spatial_pin.assembly.passive_freedoms import RESTING, is_in_loop, passive_freedoms
from spatial_pin.assembly.redundant_equations import gap_words
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import tangent_step
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import (
    EPS,
    Array,
    Decomposition,
    common_rows,
    decompose,
    independent_rows,
    least_squares,
)
from spatial_pin.numerics.tolerances import TOLERANCES

STEP = TOLERANCES.trial_step
REGULAR_TRIALS = 4  # one of them nearly always closes, as each is short
# Estimated from how equations turn over a trial step, they would become dependent after some way.
# Lost rank is not looked for again within this part of it: they may turn faster farther on, but not
# four times as fast.
SURE_WAY = 0.25
# Way after which equations that depend on each other at one configuration only are independent in
# earnest, of those that shake to the second order too; links that are next to nothing stay so.
SOME_WAY = 0.1  # rad, characteristic lengths: far above all rounding
STEP_ASIDE = 0.02  # rad, characteristic lengths: most that a joint moves to a regular pose
# Part of weak equations that a motion to a singular configuration nearby may leave: the block of
# them is linear to a hundredth there, and rounded numbers leave about all of it.
LINEAR = 0.1
LONGEST_SURE = 0.1  # rad, characteristic lengths, of it at most: ten trial steps


class Regular(NamedTuple):
    """A configuration at which the loops lose no equation, and none near it.

    Attributes:
        q: the configuration (nq,).
        rank: of its closure equations.
        radius: how far off others with that rank are regular too [rad, characteristic lengths]:
            rows turn by so little on the way that those chosen here stay independent.
        near: square of a change of the numbers in q that surely is within the radius.
    """

    q: Array
    rank: int
    radius: float
    near: float = 0.0

    def holds(
        self, mechanism: Mechanism, q: Array, ranks: NDArray[np.int64] | int
    ) -> NDArray[np.bool_]:
        """Whether each q (n, nq), with rows of these ranks, is so near that it is regular too."""
        changes, is_same = q - self.q, np.asarray(ranks) == self.rank
        holds = is_same & (np.vecdot(changes, changes) <= self.near)
        far = np.flatnonzero(is_same & ~holds)
        if len(far):
            model = mechanism.model
            ways = changes[far] if model.nq == model.nv else np.array(
                [pin.difference(model, self.q, x) for x in q[far]])
            ways /= mechanism.velocity_scale
            holds[far] = np.abs(ways).max(axis=1, initial=0.0) <= self.radius
        return holds


def has_constant_rank(
    mechanism: Mechanism, n: int, rank: NDArray[np.int64] | int
) -> NDArray[np.bool_] | bool:
    """Whether n closure equations surely keep each rank nearby: all are independent, or hold.

    Those that stayed of a rounded file may be so by its rounding only.
    """
    return (rank == mechanism.model.nv) | ((rank == n) & (mechanism.whole is None))


def rank_loss(evaluation: LoopEquations, q: Array, rank: int) -> int:
    """Return how many independent equations the loops lose at q, where their rank is `rank`.

    As many independent rows as that leave a surface through q of as many dimensions as there are
    freedoms at q. Where no equation is lost, the loops are closed on all of it; where branches
    cross, or a freedom is instantaneous only, the other rows open on it: with the second power of
    the way, as a rule [ConnellyWhiteley1996], but a step shows any. The evaluation has its turns at
    q (nq,), and comes back to it; `rank` is that of the closure equations there.
    """
    n = evaluation.constraints.n_closure
    if has_constant_rank(evaluation.mechanism, n, rank):
        return 0
    known: Regular | None = evaluation.regular
    if known is not None and known.holds(evaluation.mechanism, q[None], rank).all():
        return 0
    evaluation.update(q)
    jacobian = evaluation.jacobian[:n].copy()
    rows = independent_rows(jacobian)
    svd = decompose(jacobian[rows])
    strong = int(np.count_nonzero(svd.s > TOLERANCES.half_precision * svd.s.max(initial=0.0)))
    freedoms = svd.vt[len(rows) :]
    if strong < len(rows) and not _is_near_singular(evaluation, q, rows, svd, strong):
        steps = np.vstack([freedoms, -freedoms])
        steps *= SOME_WAY / np.abs(steps).max(axis=1, keepdims=True)
        lever = np.linalg.norm(jacobian, axis=0)
        felt = lever > TOLERANCES.half_precision * svd.s.max(initial=0.0)
        lost = _rank_near(evaluation, q, steps, TOLERANCES.near_singular, felt) - strong
        evaluation.update(q)
        if lost > 0:
            return lost
    end, is_closed = tangent_step(
        evaluation.mechanism, q, evaluation.angle_reference, rows, freedoms)
    if end is not None and is_closed:
        evaluation.update(end)
        turned = np.linalg.norm(evaluation.jacobian[:n] - jacobian) / STEP
        radius = SURE_WAY * svd.s[-1] / max(turned, EPS) if rank else 0.0
        radius = min(float(radius), LONGEST_SURE)
        # a joint moves by twice the change of its quaternion, and a bit more
        near = (radius * float(evaluation.mechanism.velocity_scale.min()) / 3.0) ** 2
        evaluation.regular = Regular(q.copy(), rank, radius, near)
        evaluation.update(q)
        return 0
    steps = np.random.default_rng(3).uniform(
        -STEP_ASIDE, STEP_ASIDE, (REGULAR_TRIALS, len(jacobian.T)))
    lost = _rank_near(evaluation, q, steps, TOLERANCES.rank) - rank
    evaluation.update(q)
    return max(lost, int(end is not None))


def _is_near_singular(
    evaluation: LoopEquations, q: Array, rows: NDArray[np.intp], svd: Decomposition, strong: int
) -> bool:
    """Whether the weak equations depend on the strong ones at a configuration near q.

    Near q the block of weak rows and of directions that strong rows leave free is linear in the
    freedoms. If some motion makes it zero, q is near a singular configuration and is regular
    itself. If none does, only the rounding of the file's numbers makes the weak equations
    independent.
    """
    model, scale = evaluation.model, evaluation.mechanism.velocity_scale
    left_null, right_null = svd.u[:, strong : len(rows)], svd.vt[strong:]

    def block(step: Array) -> Array:
        evaluation.update(pin.integrate(model, q, scale * step))
        return (left_null.T @ evaluation.jacobian[rows] @ right_null.T).ravel()

    here = block(np.zeros(model.nv))
    changes = [(block(STEP * v) - block(-STEP * v)) / (2.0 * STEP) for v in svd.vt[len(rows) :]]
    evaluation.update(q)
    columns = np.reshape(changes, (len(changes), len(here))).T
    rest = here + columns @ least_squares(columns, -here)
    return bool(np.linalg.norm(rest) <= LINEAR * np.linalg.norm(here))


def _rank_near(
    evaluation: LoopEquations, q: Array, steps: Array, cut: float,
    felt: NDArray[np.bool_] | None = None,
) -> int:
    """Return the largest closure rank at closed configurations near scaled steps (k, nv) from q.

    Those at which only a link next to nothing has turned do not count: other coordinates, `felt`
    (nv,) by the loops, have to go a part of the step, where they are given.
    """
    n, model = evaluation.constraints.n_closure, evaluation.model
    scale, free, best = evaluation.mechanism.velocity_scale, np.ones(model.nv, dtype=bool), 0
    for step in steps:
        there, error = close(
            evaluation, pin.integrate(model, q, scale * step), free, TOLERANCES.zero)
        if felt is not None:
            moved = np.abs(pin.difference(model, q, there) / scale)[felt].max(initial=0.0)
            if moved < TOLERANCES.moved * np.abs(step).max():
                continue
        if error <= TOLERANCES.closed:
            best = max(best, len(independent_rows(evaluation.jacobian[:n], cut)))
    return best


def _free_directions(evaluation: LoopEquations, q: Array) -> int:
    """Return the number of independent directions in which steps from q stay closed."""
    evaluation.update(q)
    n, scale = evaluation.constraints.n_closure, evaluation.mechanism.velocity_scale
    freedoms = decompose(evaluation.jacobian[:n], TOLERANCES.half_precision).null_space
    free, rng = np.ones(len(scale), dtype=bool), np.random.default_rng(3)
    moves = []
    for _ in range(REGULAR_TRIALS * len(freedoms)):
        v = rng.standard_normal(len(freedoms)) @ freedoms
        start = pin.integrate(evaluation.model, q, scale * v * (STEP / float(np.linalg.norm(v))))
        there, error = close(evaluation, start, free, TOLERANCES.zero)
        moved = pin.difference(evaluation.model, q, there) / (scale * STEP)
        if error <= TOLERANCES.closed and np.linalg.norm(moved) > TOLERANCES.moved:
            moves.append(moved / np.linalg.norm(moved))
    evaluation.update(q)
    return int(np.count_nonzero(decompose(np.array(moves)).s > TOLERANCES.moved)) if moves else 0


def lost_rank_words(evaluation: LoopEquations, q: Array, lost: int, motion: str) -> str:
    """Return why the motion at q is not determined, in words, if the loops lose equations.

    `motion` is what determines the motion elsewhere, in words. The evaluation comes back to q.
    """
    n, ways = evaluation.constraints.n_closure, _free_directions(evaluation, q)
    freedoms = evaluation.model.nv - len(
        independent_rows(evaluation.jacobian[:n], TOLERANCES.half_precision))
    equations = f"{lost} independent equation{'s' * (lost != 1)}"
    text = f"singular configuration: the loops lose {equations} there, and "
    if ways <= freedoms - lost:
        nothing = "nothing can move: " * (not ways)
        shaken = f"{lost} freedom{' is' if lost == 1 else 's are'} instantaneous only"
        return f"{text}{nothing}{shaken}: it shakes, but goes nowhere (see sp.mobility)"
    return (f"{text}branches cross, so that the {motion} do not determine the motion; start "
            "beside this configuration")


def dependence_words(
    evaluation: LoopEquations, driven: Sequence[Coordinate], drive: Array, still: Sequence[int],
    closures: Array,
) -> str:
    """Return why drivers are not independent, as text.

    `drive` (n, nv) are the derivatives of the prescribed coordinates, scaled; `closures` are all
    rows except theirs; `still` are fixed velocity entries.
    """
    names, mechanism = ", ".join(repr(c.name) for c in driven), evaluation.mechanism
    where = f"mechanism {mechanism.name!r}: "
    needless = _needless_passives(evaluation, driven, drive)
    if needless:
        return (f"{where}passive {', '.join(map(repr, needless))}: no rotation of the "
                "body about that line is free as the drivers stand; take the table out")
    if still and decompose(closures).rank < len(closures):
        return (f"{where}the held coordinates cannot all stand still with the loops and base: "
                "they move it together; hold less")
    freedom = closures.shape[1] - decompose(closures).rank
    moving = drive @ decompose(closures).null_space.T
    if freedom < len(driven):
        rank = decompose(closures, TOLERANCES.half_precision).rank
        if closures.shape[1] - rank >= len(driven):
            n, q = evaluation.constraints.n_closure, evaluation.q.copy()
            lost = rank_loss(evaluation, q, len(independent_rows(evaluation.jacobian[:n])))
            if lost:
                return where + lost_rank_words(evaluation, q, lost, "drivers")
            return (f"{where}singular configuration: branches cross so near that round-off "
                    "hides which equations depend on others; start further from it"
                    + gap_words(mechanism))
        if not freedom:
            base = {v for joint in free_bases(mechanism)
                    for v in velocity_entries(mechanism, joint)}
            if set(still) - base:
                return (f"{where}the held coordinates and the loops leave no freedom, so that "
                        f"{names} cannot move; hold less")
            return (f"{where}{names} cannot move: the loops leave no freedom there (see "
                    f"sp.mobility); {locked_loops_hint(mechanism)}{gap_words(mechanism)}")
        independent = common_rows(moving[None], np.zeros((0, freedom)), freedom)
        more = ", ".join(repr(c.name) for k, c in enumerate(driven) if k not in independent)
        return (f"{where}{len(driven)} coordinates are prescribed ({names}), but the "
                f"closed mechanism has {freedom} freedom{'s' * (freedom != 1)} there; "
                f"prescribe fewer: leave out {len(driven) - freedom}, such as {more}, "
                "which the others move")
    moved = np.abs(moving).max(axis=1, initial=0.0)
    stuck = ", ".join(repr(c.name) for c, m in zip(driven, moved, strict=True)
                      if m < TOLERANCES.near_singular)
    if stuck:
        return (f"{where}singular configuration: {stuck} is at a limit position "
                "there, where no speed of it moves the mechanism; start beside it, or "
                "prescribe another coordinate")
    independent = common_rows(moving[None], np.zeros((0, moving.shape[1])), len(driven))
    follow = [repr(c.name) for k, c in enumerate(driven) if k not in independent]
    if not follow:
        return (f"{where}singular configuration: branches cross, so that the speeds of {names} "
                "do not determine the motion; start beside this configuration")
    return (f"{where}singular configuration: the prescribed {names} depend on each other "
            f"there, for the loops let them move together only: {', '.join(follow)} "
            f"go{'es' * (len(follow) == 1)} as the others do; prescribe another coordinate "
            "instead")


def locked_loops_hint(mechanism: Mechanism) -> str:
    """Return a hint for a mechanism that its loops lock, as text."""
    names = ", ".join(repr(c.name) for c in mechanism.closures if c.frames)
    what = f"axes and frames of closure {names}" if names else "couplings"
    return f"check the {what}, and the axes of the joints"


def _needless_passives(
    evaluation: LoopEquations, driven: Sequence[Coordinate], drive: Array
) -> list[str]:
    """Return the names of passive tables whose rotation is not free with fixed drivers."""
    n, passives = evaluation.constraints.n_closure, evaluation.mechanism.passives
    drivers = driver_coordinates(evaluation.mechanism).values()
    driver_rows = [row for c, row in zip(driven, drive, strict=True) if c in drivers]
    free = decompose(np.vstack([evaluation.jacobian[:n], *driver_rows])).null_space
    independent = set(independent_rows(evaluation.jacobian[n:] @ free.T).tolist())
    return [passive.name for k, passive in enumerate(passives) if k not in independent]


def check_passive(
    evaluation: LoopEquations, driven: Sequence[Coordinate], null_space: Array, rank: int, q: Array
) -> None:
    """Refuse freedoms that are not the motion of one link: they must be driven."""
    mechanism = evaluation.mechanism
    passive = [(joint, v) for joint, v in passive_freedoms(
        evaluation, null_space * mechanism.velocity_scale, driven)
             if joint not in free_bases(mechanism)]
    determined = sum(len(v) for _, v in passive) == len(null_space)
    if determined:
        _check_free(evaluation, null_space)
    check_regular(evaluation, q, rank)
    if determined:
        return
    missing = len(null_space) - sum(len(v) for joint, v in passive if is_in_loop(
        mechanism, joint))  # a link that hangs at an end is prescribed with the rest
    moving = np.abs(null_space).max(axis=0) > 1e-8 * np.abs(null_space).max()
    names = [c for c, m in zip(mechanism.coordinates, moving, strict=True) if m]
    picked = independent_rows(np.where(moving[:, None], null_space.T, 0.0))[:missing]
    chosen = [mechanism.coordinates[v] for v in sorted(picked)]
    given = ", ".join(repr(c.name) for c in driven) or "nothing"
    raise SingularError(
        f"mechanism {mechanism.name!r}: {given} {'are' if len(driven) > 1 else 'is'} "
        f"prescribed, and {missing} of its freedoms are not prescribed; "
        f"prescribe {missing} more of {', '.join(names)}, such as "
        + _prescription_hint(mechanism, chosen, set(names)))


def moves_frame(evaluation: LoopEquations, null_space: Array, frame: int) -> bool:
    """Whether freedoms (k, nv), scaled velocities of length 1, move a frame at the evaluation."""
    size = evaluation.mechanism.velocity_scale
    length = np.array([evaluation.mechanism.characteristic_length] * 3 + [1.0] * 3)
    twists = evaluation.frame_jacobian(frame) @ (null_space * size).T / length[:, None]
    return bool(np.abs(twists).max(initial=0.0) > RESTING)


def check_regular(evaluation: LoopEquations, q: Array, rank: int) -> None:
    """Refuse a configuration q at which the loops lose independent equations.

    Also if the new freedom moves one link only, like a passive one: a single distance whose row
    vanishes frees its link. And if there seem to be as many freedoms as drivers, but they are
    instantaneous only.
    """
    lost = rank_loss(evaluation, q, rank)
    if lost:
        raise SingularError(f"mechanism {evaluation.mechanism.name!r}: "
                            + lost_rank_words(evaluation, q, lost, "drivers"))


def _check_free(evaluation: LoopEquations, null_space: Array) -> None:
    """Refuse passive freedoms that a closure resists with a lever arm near round-off."""
    n = evaluation.constraints.n_closure
    held = np.abs(evaluation.jacobian[:n] @ null_space.T).max(axis=1, initial=0.0)
    if held.max(initial=0.0) > TOLERANCES.zero:
        mechanism, row = evaluation.mechanism, int(held.argmax())
        sizes = np.abs(null_space).max(axis=0)
        names = [c for c, s in zip(mechanism.coordinates, sizes, strict=True) if s > 1e-6]
        raise SingularError(
            f"mechanism {mechanism.name!r}: {', '.join(names)}: closure "
            f"{evaluation.constraints.closure_of[row]!r} holds them by a lever of only "
            f"{held[row]:.0e} of the mechanism's size; no digit of their rates is reliable")


def _prescription_hint(mechanism: Mechanism, names: Sequence[str], moving: Container[str]) -> str:
    """Return how to prescribe coordinates, for messages; `moving` are all free ones."""
    rates = ", ".join(f"{name!r}: 0.0" for name in names)
    bases = free_bases(mechanism)
    base = [BASE] if bases else []
    rest = [name for name in names if mechanism.coordinate_table[name].joint not in bases]
    hint = (f"solve_rates(..., {{{rates}}}), sweep(..., hold={[*base, *rest]}) or "
            f"jacobian(..., drivers=[...]); each may have a [drivers.name] in the file too")
    if len(rest) < len(names):
        hint += f"; nothing holds the free base, which hold={base} does, as hold does by default"
    springs = [spring.joint for spring in mechanism.springs if spring.joint in moving]
    return hint + f"; hold={[*base, SPRINGS]} stops the joints with springs" * bool(springs)
