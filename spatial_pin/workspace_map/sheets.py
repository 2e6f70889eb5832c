"""Other branches over the same grid: assembly modes, or other ways to reach a pose."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spatial_pin.assembly.holding import held_by, is_base
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.coordinates import coordinate_value
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mobility.assembly_modes import assembly_modes
from spatial_pin.proximity.distances import Distances
from spatial_pin.workspace_map.filling import Filling, Index
from spatial_pin.workspace_map.lines import Asked, Followed, natural_jacobians, touching

SEEDS_A_COORDINATE = 3  # values of each, spread over its range, where modes are looked for
MOST_LOOKED_AT = 30  # points in all
PATIENCE = 200  # starts that find nothing new after which no more modes are looked for at a point


def other_starts(filling: Filling) -> Iterator[tuple[Index, Followed]]:
    """Yield all configurations that assembly modes have at some points of a grid, in their order.

    Args:
        filling: of the branch that is known: its first point is looked at first.
    """
    asked = filling.asked
    names = [*asked.names, *asked.standing, *_held(asked)]
    reached = np.argwhere(filling.reached)
    begin = filling.data["q"][tuple(reached[0])]
    mechanism = asked.mechanism
    fixed = [coordinate_value(mechanism, mechanism.prescribed_coordinate(n), begin)
             for n in names[len(asked.names):]]
    distances = None if asked.apart is None else Distances(asked.body)
    for index in _looked_at(filling):
        values = dict(zip(names, [*filling.at(index).tolist(), *fixed], strict=True))
        try:
            modes = assembly_modes(mechanism, values, patience=PATIENCE)
        except SpatialPinError:  # it cannot be closed there, or moves with all of them held
            continue
        for state in modes:
            is_beyond = asked.limits and beyond_limits(mechanism, state.q)
            if not is_beyond and not (distances and touching(asked, distances, state.q)):
                yield index, one_of(asked, state)


def _held(asked: Asked) -> list[str]:
    """Return the coordinates that are held, but for those of free bases, which stand anyway."""
    held = held_by(asked.mechanism, [x for x in asked.hold if not is_base(asked.mechanism, x)])
    return [c.name for c in asked.mechanism.coordinate_table.values()
            if c in held.coordinates or c.v in held.entries]


def _looked_at(filling: Filling) -> list[Index]:
    """Return points of a grid, the first one that is reached first, then some all over it."""
    first = tuple(np.argwhere(filling.reached)[0].tolist())
    each = [sorted({round(x) for x in np.linspace(0, n - 1, SEEDS_A_COORDINATE + 2)[1:-1]})
            for n in filling.shape]
    spread = [tuple(x) for x in np.stack(np.meshgrid(*each, indexing="ij"), -1).reshape(
        -1, len(each)).tolist()]
    step = -(-len(spread) // MOST_LOOKED_AT)
    return list(dict.fromkeys([first, *spread[::step]]))


def one_of(asked: Asked, state: State) -> Followed:
    """Return a configuration as what was followed."""
    at = state.placement(asked.frame)
    return Followed(state.q[None], np.asarray(state.angles)[None],
                    np.array([state.closure_error]), at.translation[None], at.rotation[None],
                    natural_jacobians(asked, [state]), None)
