"""Why nothing determines the motion of a mechanism: what is refused, and the words of refusals."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.holding import BASE, SPRINGS, free_bases, velocity_entries
from spatial_pin.assembly.passive_freedoms import RESTING, is_in_loop, passive_freedoms
from spatial_pin.assembly.rank_loss import lost_rank, rank_loss
from spatial_pin.assembly.redundant_equations import gap_words
from spatial_pin.errors import SingularError
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array, common_rows, decompose, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES


class PrescribedMotion(NamedTuple):
    """What is to determine a motion.

    Attributes:
        evaluation: the closure equations, at the configuration.
        driven: the prescribed coordinates.
        drive: (n, nv) derivatives of these, scaled.
        still: velocity entries that stand still.
    """

    evaluation: LoopEquations
    driven: Sequence[Coordinate]
    drive: Array
    still: Sequence[int]


def dependence(asked: PrescribedMotion, closures: Array) -> str:
    """Return why drivers are not independent, from the rows of all else."""
    names = ", ".join(repr(c.name) for c in asked.driven)
    where = f"mechanism {asked.evaluation.mechanism.name!r}: "
    drive = asked.drive
    needless = _needless_passives(asked)
    if needless:
        return (f"{where}passive {', '.join(map(repr, needless))}: no rotation of the "
                "body about that line is free as the drivers stand; take the table out")
    if asked.still and decompose(closures).rank < len(closures):
        return (f"{where}what is held cannot all stand still beside the loops and the base: "
                "they move it together; hold less")
    freedom = closures.shape[1] - decompose(closures).rank
    moving = drive @ decompose(closures).null_space.T
    if freedom < len(asked.driven):
        rank = decompose(closures, TOLERANCES.near_singular).rank
        if closures.shape[1] - rank >= len(asked.driven):
            return (f"{where}singular configuration: branches cross so near that round-off "
                    "hides which equations depend on others; start further from it"
                    + gap_words(asked.evaluation.mechanism))
        if not freedom:
            return where + _nothing_moves(asked, names)
        kept = common_rows(moving[None], np.zeros((0, freedom)), freedom)
        more = ", ".join(repr(c.name) for k, c in enumerate(asked.driven) if k not in kept)
        return (f"{where}{len(asked.driven)} coordinates are prescribed ({names}), but the "
                f"closed mechanism has {freedom} freedom{'s' * (freedom != 1)} there; "
                f"prescribe fewer: leave out {len(asked.driven) - freedom}, such as {more}, "
                "which the others move")
    moved = np.abs(moving).max(axis=1, initial=0.0)
    stuck = ", ".join(repr(c.name) for c, m in zip(asked.driven, moved, strict=True)
                      if m < TOLERANCES.near_singular)
    if stuck:
        return (f"{where}singular configuration: {stuck} is at a limit position "
                "there, where no speed of it moves the mechanism; start beside it, or "
                "prescribe another coordinate")
    kept = common_rows(moving[None], np.zeros((0, moving.shape[1])), len(asked.driven))
    follow = [repr(c.name) for k, c in enumerate(asked.driven) if k not in kept]
    return (f"{where}singular configuration: the prescribed {names} depend on each other "
            f"there, for the loops let them move together only: {', '.join(follow)} "
            f"go{'es' * (len(follow) == 1)} as the others do; prescribe another coordinate "
            "instead")


def _nothing_moves(asked: PrescribedMotion, names: str) -> str:
    """Return why nothing is left that could move."""
    mechanism = asked.evaluation.mechanism
    base = {v for joint in free_bases(mechanism) for v in velocity_entries(mechanism, joint)}
    if set(asked.still) - base:
        return (f"what is held and the loops leave no freedom, so that {names} cannot move; "
                "hold less")
    return (f"{names} cannot move: the loops leave no freedom there (see sp.mobility); "
            f"{check_loops(mechanism)}{gap_words(mechanism)}")


def check_loops(mechanism: Mechanism) -> str:
    """Return what to look at where loops hold a mechanism that is to move."""
    names = ", ".join(repr(c.name) for c in mechanism.closures if c.frames)
    what = f"axes and frames of closure {names}" if names else "couplings"
    return f"check the {what}, and the axes of the joints"


def _needless_passives(asked: PrescribedMotion) -> list[str]:
    """Return the names of passive tables whose rotation is not free as the drivers stand."""
    evaluation = asked.evaluation
    n, passives = evaluation.constraints.n_closure, evaluation.mechanism.passives
    drivers = driver_coordinates(evaluation.mechanism).values()
    stand = [row for c, row in zip(asked.driven, asked.drive, strict=True) if c in drivers]
    free = decompose(np.vstack([evaluation.jacobian[:n], *stand])).null_space
    kept = set(independent_rows(evaluation.jacobian[n:] @ free.T).tolist())
    return [passive.name for k, passive in enumerate(passives) if k not in kept]


def check_passive(asked: PrescribedMotion, null_space: Array, rank: int, q: Array) -> None:
    """Refuse freedoms that are not the motion of one link: somebody must drive them."""
    evaluation, mechanism = asked.evaluation, asked.evaluation.mechanism
    found = [(joint, v) for joint, v in passive_freedoms(
        evaluation, null_space * mechanism.velocity_scale, asked.driven)
             if joint not in free_bases(mechanism)]
    determined = sum(len(v) for _, v in found) == len(null_space)
    if determined:
        _check_free(evaluation, null_space)
    check_regular(evaluation, q, rank)
    if determined:
        return
    missing = len(null_space) - sum(len(v) for joint, v in found if is_in_loop(
        mechanism, joint))  # a link that hangs at an end is prescribed with the rest
    moving = np.abs(null_space).max(axis=0) > 1e-8 * np.abs(null_space).max()
    names = [c for c, m in zip(mechanism.coordinates, moving, strict=True) if m]
    picked = independent_rows(np.where(moving[:, None], null_space.T, 0.0))[:missing]
    chosen = [mechanism.coordinates[v] for v in sorted(picked)]
    given = ", ".join(repr(c.name) for c in asked.driven) or "nothing"
    raise SingularError(
        f"mechanism {mechanism.name!r}: {given} {'are' if len(asked.driven) > 1 else 'is'} "
        f"prescribed, and {missing} of its freedoms are not prescribed; "
        f"prescribe {missing} more of {', '.join(names)}, such as "
        + _ways_to_prescribe(mechanism, chosen, set(names)))


def moves_frame(evaluation: LoopEquations, null_space: Array, frame: int) -> bool:
    """Whether freedoms (k, nv), scaled velocities of length 1, move a frame at the evaluation."""
    size = evaluation.mechanism.velocity_scale
    length = np.array([evaluation.mechanism.characteristic_length] * 3 + [1.0] * 3)
    twists = evaluation.frame_jacobian(frame) @ (null_space * size).T / length[:, None]
    return bool(np.abs(twists).max(initial=0.0) > RESTING)


def check_regular(evaluation: LoopEquations, q: Array, rank: int) -> None:
    """Refuse a configuration q at which the loops lose independent equations.

    Also where the freedom won moves one link only, like a passive one: a single distance whose
    row vanishes frees the link it holds. And where there seem to be as many freedoms as
    drivers, but they are instantaneous only.
    """
    lost = rank_loss(evaluation, q, rank)
    if lost:
        raise SingularError(f"mechanism {evaluation.mechanism.name!r}: "
                            + lost_rank(evaluation, q, lost, "drivers"))


def _check_free(evaluation: LoopEquations, null_space: Array) -> None:
    """Refuse freedoms counted as passive that a closure holds, with a lever arm near round-off."""
    n = evaluation.constraints.n_closure
    held = np.abs(evaluation.jacobian[:n] @ null_space.T).max(axis=1, initial=0.0)
    if held.max(initial=0.0) > TOLERANCES.zero:
        mechanism, row = evaluation.mechanism, int(held.argmax())
        sizes = np.abs(null_space).max(axis=0)
        names = [c for c, s in zip(mechanism.coordinates, sizes, strict=True) if s > 1e-6]
        raise SingularError(
            f"mechanism {mechanism.name!r}: {', '.join(names)}: closure "
            f"{evaluation.constraints.labels[row].closure!r} holds them by a lever of only "
            f"{held[row]:.0e} of the mechanism's size; no digit of their rates is reliable")


def _ways_to_prescribe(mechanism: Mechanism, names: Sequence[str], moving: Container[str]) -> str:
    """Return how coordinates are prescribed, for messages; `moving` are all that are not."""
    rates = ", ".join(f"{name!r}: 0.0" for name in names)
    bases = free_bases(mechanism)
    base = [BASE] if bases else []
    rest = [name for name in names if mechanism.coordinate_table[name].joint not in bases]
    said = (f"solve_rates(..., {{{rates}}}), sweep(..., hold={[*base, *rest]}) or "
            f"jacobian(..., drivers=[...]); each may have a [drivers.name] in the file too")
    if len(rest) < len(names):
        said += f"; nothing holds the free base, which hold={base} does, as hold does by default"
    springs = [spring.joint for spring in mechanism.springs if spring.joint in moving]
    return said + f"; hold={[*base, SPRINGS]} stops the joints with springs" * bool(springs)
