"""Which joint coordinates determine the motion of a closed mechanism best [Wehage1982]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spatial_pin.assembly.newton import rank_loss
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of
from spatial_pin.errors import SingularError
from spatial_pin.numerics.linalg import Array, decompose, independent_rows, weighty_rows

PLAIN = 0.1  # speed of a plain coordinate, by the fastest component's, at which it will do


class Lost(Exception):
    """The loops cannot be closed at the coordinates asked for, or not surely on the branch."""


def best_coordinates(state: State, prescribed: Sequence[int]) -> list[int]:
    """Return the velocity entries that determine the motion best, besides the prescribed ones.

    Column-pivoted QR of the freedoms: joints that move most.

    Args:
        state: where.
        prescribed: velocity entries that follow laws.

    Raises:
        SingularError: prescribed coordinates depend on each other, or the loops have lost rank.
    """
    drive = np.zeros((len(prescribed), state.mechanism.model.nv))
    drive[np.arange(len(prescribed)), list(prescribed)] = 1.0
    freedoms = _freedoms(state, drive)
    if not len(freedoms):
        return []
    return weighty_rows(freedoms.T, len(freedoms)).tolist()


def plain_coordinates(state: State, apart: Array) -> list[int]:
    """Return the velocity entries of joints that can tell one freedom, the fastest first.

    Args:
        state: where.
        apart: (k, nv) freedoms that are not to be determined; one more is left.

    Raises:
        SingularError: the loops have lost rank.
    """
    speeds = np.abs(_freedoms(state, apart)[0])
    plain = [c.v for c in state.mechanism.coordinate_table.values() if c.q >= 0]
    enough = PLAIN * speeds.max()
    return sorted((v for v in plain if speeds[v] > enough), key=lambda v: -speeds[v])


def _freedoms(state: State, drive: Array) -> Array:
    """Return orthonormal rows (n, nv), scaled, of the motions that drive (k, nv) leaves."""
    mechanism = state.mechanism
    evaluation = Evaluation(constraints_of(mechanism))
    evaluation.turns[:] = state.angles
    evaluation.update(state.q)
    n = evaluation.constraints.n_rows
    rows = independent_rows(evaluation.jacobian[:n])
    if rank_loss(evaluation, state.q, len(rows)):
        raise SingularError(
            f"mechanism {mechanism.name!r}: singular configuration, {state}: branches cross there "
            "and the motion is not determined; start beside it", state=state)
    evaluation.update(state.q)
    svd = decompose(np.vstack([evaluation.jacobian[rows], drive]))
    if svd.rank < len(rows) + len(drive):
        raise SingularError(
            f"mechanism {mechanism.name!r}: the prescribed coordinates are not independent of each "
            f"other at {state}", state=state)
    return svd.null_space
