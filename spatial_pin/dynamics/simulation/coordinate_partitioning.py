"""Which joint coordinates determine the motion of a closed mechanism best [Wehage1982]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.state import State
from spatial_pin.assembly.undetermined import lost_rank, rank_loss
from spatial_pin.constraints.trees import is_large
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.kernel.rate_solver import rates_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, decompose, independent_rows, weighty_rows

NONE = 1e-13  # derivative of an equation that is round-off: others are of order one
PLAIN = 0.1  # speed of a plain coordinate, relative to the fastest component's, that will do


class Lost(Exception):
    """The loops cannot be closed at the coordinates asked for, or not surely on the branch."""


class Freedoms:
    """The freedoms of a closed mechanism at a state, and which coordinates determine them best.

    What it has found at the last state is kept: coordinates that begin there ask for it again.

    Args:
        mechanism: the mechanism.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism = mechanism
        self._state: State | None = None
        self._jacobian: Array = np.empty((0, 0))
        self._rows: NDArray[np.intp] = np.empty(0, np.intp)
        self._spaces: dict[bytes, Array] = {}  # freedoms, keyed by what is held

    def equations(self, state: State) -> NDArray[np.intp]:
        """Return which closure equations are independent at a state."""
        if state is not self._state:
            with loops_of(self._mechanism, state.angles) as evaluation:
                evaluation.update(state.q)
                self._jacobian = evaluation.jacobian[: evaluation.constraints.n_closure].copy()
            self._state, self._spaces = state, {}
            if not (is_large(self._mechanism.model) and self._look_for_one_freedom(state)):
                self._rows = independent_rows(self._jacobian)
        return self._rows

    def _look_for_one_freedom(self, state: State) -> bool:
        """Look whether the first joint of a large mechanism clearly moves all others.

        And whether there is one choice of equations only. By rates, whose cost grows with the
        number of loops, not with its cube.
        """
        mechanism, nv = self._mechanism, self._mechanism.model.nv
        rows = np.flatnonzero(np.abs(self._jacobian).max(axis=1, initial=0.0) > NONE)
        with kernel_of(mechanism) as kernel:
            if kernel.n_passive or len(rows) != nv - 1:
                return False
            rates = rates_of(kernel, (0,), 1)
            rates.speeds[:], rates.accelerations[:] = 1.0, 0.0
            found = rates.solve(state.q, state.angles)
            if found is None:
                return False
            motion: Array = (found.v / mechanism.velocity_scale)[None]
        self._rows = rows
        self._spaces[np.zeros((0, nv)).tobytes()] = motion / np.linalg.norm(motion)
        return True

    def best(self, state: State, prescribed: Sequence[int]) -> list[int]:
        """Return the velocity entries that determine the motion best, besides the prescribed ones.

        Column-pivoted QR of the freedoms: joints that move most.

        Args:
            state: where.
            prescribed: velocity entries that follow laws.

        Raises:
            SingularError: prescribed coordinates depend on each other, or the loops have lost rank.
        """
        drive = np.zeros((len(prescribed), self._mechanism.model.nv))
        drive[np.arange(len(prescribed)), list(prescribed)] = 1.0
        freedoms = self._without(state, drive)
        if not len(freedoms):
            return []
        return weighty_rows(freedoms.T, len(freedoms)).tolist()

    def plain(self, state: State, apart: Array) -> list[int]:
        """Return the joints' velocity entries that can be a freedom's coordinate, fastest first.

        Args:
            state: where.
            apart: (k, nv) freedoms that are not to be determined; one more is left.

        Raises:
            SingularError: the loops have lost rank.
        """
        speeds = np.abs(self._without(state, apart)[0])
        plain = [c.v for c in self._mechanism.coordinate_table.values() if c.q >= 0]
        enough = PLAIN * speeds.max()
        return sorted((v for v in plain if speeds[v] > enough), key=lambda v: -speeds[v])

    def _without(self, state: State, drive: Array) -> Array:
        """Return orthonormal rows (n, nv), scaled, of the motions in which drive (k, nv) rests."""
        rows, key, name = self.equations(state), drive.tobytes(), self._mechanism.name
        if key in self._spaces:
            return self._spaces[key]
        with loops_of(self._mechanism, state.angles) as evaluation:
            if not self._spaces and (lost := rank_loss(evaluation, state.q, len(rows))):
                why = lost_rank(evaluation, state.q, lost, "forces")
                raise SingularError(f"mechanism {name!r}: {state}: {why}", state=state)
        svd = decompose(np.vstack([self._jacobian[rows], drive]))
        if svd.rank < len(rows) + len(drive):
            raise SingularError(
                f"mechanism {name!r}: the prescribed coordinates are not independent of each other "
                f"at {state}", state=state)
        self._spaces[key] = svd.null_space
        return self._spaces[key]
