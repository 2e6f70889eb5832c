"""Dependent parts: the loops and joints that determine the motion of some coordinates.

A loop depends on all coordinates in its closures, but not on fixed ones. Parts without a link to
driven or requested coordinates, such as a tool beside a robot or the loops of another leg, are left
out: they stay fixed with their closures.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.holding import (
    Hold,
    LoopGroup,
    free_bases,
    hold_names,
    loop_groups,
    part_of,
    velocity_entries,
)
from spatial_pin.assembly.state import State, made
from spatial_pin.assembly.undetermined import rank_loss
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import frame_in_kernel
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.kernel.paths import PathSamples
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.numerics.linalg import Array, common_rows, independent_rows, null_space
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.prescribed import Prescription, chosen_at, solved_at
from spatial_pin.rates.rates import usual_prescription, wanted_coordinates


class Part(NamedTuple):
    """A part of a mechanism, with all coordinates.

    Attributes:
        mechanism: with the closures of the part only.
        entries: (nv,) the velocities that it depends on.
        angles: numbers of its angles that count turns, in the whole mechanism.
        others: the groups of loops outside it.
    """

    mechanism: Mechanism
    entries: NDArray[np.bool_]
    angles: list[int]
    others: tuple[LoopGroup, ...]

    def state(self, state: State) -> State:
        """Return a state of the whole mechanism as a state of the part, at rest."""
        return made(self.mechanism, state.q, None, None, closure_error=state.closure_error,
                    angles=state.angles[self.angles])


@made_once
def part_for(mechanism: Mechanism, entries: tuple[int, ...], fixed: tuple[int, ...]) -> Part | None:
    """Return the part that velocities depend on; None if it is the whole mechanism.

    `entries` and `fixed` are indices in the velocity vector; the latter are fixed or driven.
    """
    own = np.zeros(mechanism.model.nv, dtype=bool)
    own[list(entries)] = True
    moving = own.copy()
    moving[list(fixed)] = False
    groups = loop_groups(mechanism, fixed)
    mine = [group for group in groups if (group.entries & moving).any()]
    for group in mine:
        own |= group.entries
    rest = ~own
    rest[list(fixed)] = False
    if len(mine) == len(groups) and not rest.any():
        return None
    chosen = {name for group in mine for name in group.closures}
    names = tuple(dict.fromkeys(c.name for c in mechanism.closures if c.name in chosen))
    passives = tuple(p for p in mechanism.passives
                     if _is_of(mechanism, mechanism.frame_on_joint(p.body)[0], own))
    return Part(part_of(mechanism, names).with_fields(passives=passives), own,
                sorted(at for group in mine for at in group.angles),
                tuple(group for group in groups if not any(group is x for x in mine)))


def _is_of(mechanism: Mechanism, joint: int, entries: NDArray[np.bool_]) -> bool:
    model = mechanism.model
    return bool(entries[model.idx_vs[joint] : model.idx_vs[joint] + model.nvs[joint]].any())


def velocity_indices(driven: Iterable[Coordinate]) -> tuple[int, ...]:
    """Return the indices of coordinates in the velocity vector, without rotation vectors."""
    return tuple(c.v for c in driven if c.q >= 0 or isinstance(c, VelocityEntry))


def solved_for_frame(
    state: State, given: Prescription, frame: int, wanted: str
) -> list[Array]:
    """Return a Jacobian (6, n_moving) of `RateRows` of a frame of a closed state.

    Only the velocity of the frame must be determined.

    Raises:
        SingularError: it is not.
    """
    model = state.mechanism.model
    carriers = list(model.supports[model.frames[frame].parentJoint])[1:]
    return solved_for_entries(state, given, tuple(v for i in carriers for v in velocity_entries(
        state.mechanism, model.names[i])), wanted, frame)


def solved_for_entries(
    state: State, given: Prescription, entries: tuple[int, ...], wanted: str,
    frame: int | None = None,
) -> list[Array]:
    """Return a result (k, n_moving) of `RateRows` at a closed state, from the part that moves.

    `entries` are indices of the velocities that must be determined; with a frame, only its velocity
    must be.

    Raises:
        SingularError: they are not determined.
    """
    moving = {*entries, *velocity_indices(given.driven)} - {*given.still}
    part = part_for(state.mechanism, tuple(sorted(moving)), tuple(sorted(given.still)))
    there, own, columns = state, given, list(range(given.n_moving))
    if part is not None:
        driven = [k for k, c in enumerate(given.driven) if part.entries[c.v]]
        columns = [k for k in driven if k < given.n_moving]
        still = {*given.still, *np.flatnonzero(~part.entries).tolist()}
        own = Prescription([given.driven[k] for k in driven], len(columns), tuple(sorted(still)))
        there = part.state(state)
    point = None if frame is None else frame_in_kernel(state.mechanism, frame)
    solution = solved_at(there, own, (wanted,), point, chosen_at(there, own, frame), state.v)
    assert solution is not None
    whole = np.zeros((len(solution[0]), given.n_moving))
    whole[:, columns] = solution[0]
    return [whole]


class PartMotion(NamedTuple):
    """What moves of a mechanism, all of it or a part, with the fixed coordinates of its motion.

    Attributes:
        state: of the part.
        hold: names of fixed coordinates of the part.
        held: names for the whole mechanism, as few as fix the rest.
        whole: the state of the whole mechanism.
        angles: numbers of the part's angles that count turns.
    """

    state: State
    hold: Hold
    held: tuple[str, ...]
    whole: State
    angles: list[int]

    def of_whole(self, samples: PathSamples) -> PathSamples:
        """Return samples of the part as samples of the whole mechanism."""
        if self.state is self.whole:
            return samples
        angles = np.repeat(self.whole.angles[None], len(samples.q), axis=0)
        angles[:, self.angles] = samples.angles
        return samples._replace(
            angles=angles, error=np.maximum(samples.error, self.whole.closure_error))


def part_moving_with(state: State, names: Sequence[str], hold: Hold) -> PartMotion:
    """Return what moves with coordinates from a closed state.

    It is a part if the whole is not determined; the whole too if a free base would move, or loops
    lose equations.
    """
    mechanism = state.mechanism
    own = hold_names(hold)
    everything = PartMotion(state, hold, own, state, [])
    driven, still = usual_prescription(mechanism, tuple(names), own)
    n = len(wanted_coordinates(mechanism, names))
    fixed = (*still, *velocity_indices(driven[n:]))
    part = part_for(mechanism, tuple(c.v for c in driven[:n]), tuple(sorted(fixed)))
    if part is None:
        return everything
    with suppress(SingularError):
        chosen_at(state, Prescription(driven, len(driven), still))
        return everything
    rest = ~part.entries
    rest[list(fixed)] = False
    bases = [v for joint in free_bases(mechanism) for v in velocity_entries(mechanism, joint)]
    if rest[bases].any():
        return everything
    with loops_of(state.mechanism, state.angles) as evaluation:
        evaluation.update(state.q)
        rows = evaluation.jacobian[: evaluation.constraints.n_closure]
        if rank_loss(evaluation, state.q, len(independent_rows(rows))):
            return everything
    few = _holding_entries(state, part, rest)
    return PartMotion(part.state(state), (*own, *_named(mechanism, rest)),
                     (*own, *_named(mechanism, few)), state, part.angles)


def _named(mechanism: Mechanism, entries: NDArray[np.bool_]) -> list[str]:
    """Return the names of coordinates, or of joints that turn in space, for velocities."""
    return list(dict.fromkeys(c.name if c.q >= 0 else c.joint
                              for c in mechanism.coordinate_table.values() if entries[c.v]))


def _holding_entries(state: State, part: Part, rest: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (nv,) velocities that fix all the rest: for loops as many as their freedoms."""
    holding = rest.copy()
    with loops_of(state.mechanism, state.angles) as evaluation:
        evaluation.update(state.q)
        for group in part.others:
            rows = [i for i, name in enumerate(evaluation.constraints.closure_of)
                    if name in group.closures]
            own = np.flatnonzero(group.entries & rest)
            freedoms: Array = null_space(
                evaluation.jacobian[rows][:, own], TOLERANCES.half_precision).T
            chosen = common_rows(freedoms[None], np.zeros((0, freedoms.shape[1])),
                                 freedoms.shape[1])
            holding[own] = False
            holding[own[chosen]] = True
    return holding
