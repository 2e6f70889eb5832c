"""The square system of a closed mechanism: the equations that determine its motion.

The kernel solves for rates with these equations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.close import scaled_row
from spatial_pin.assembly.holding import fixed_base_entries
from spatial_pin.assembly.undetermined import (
    check_passive,
    check_regular,
    dependence_words,
    moves_frame,
)
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.kernel.paths import prescribed_indices
from spatial_pin.kernel.rate_solver import Chosen, RateSolver, rates_of
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.numerics.linalg import Array, Factors, decompose, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES

SINGULAR_PIVOT = TOLERANCES.singular


class SquareSystem:
    """The square linear system of a mechanism whose freedoms are all driven or passive.

    It has independent closure equations, resolved passive freedoms, drivers, fixed entries, and a
    least-motion equation for each unresolved passive freedom; its unknowns are scaled velocities.

    Equations are selected at q (nq,). By default the free bases that are not driven are still. With
    a frame only its velocity must be determined.

    Attributes:
        evaluation: the closure equations at the current configuration.
        driven: the prescribed coordinates.
        still: indices of zero entries in the velocity vector.
        equations: indices of the independent closure equations.
        scale: (nv,) velocity of a unit of each unknown.
        drive: (d, nv) derivatives of driven coordinates, then of fixed entries.
        passive: (k, nv) unresolved passive freedoms at the selection of equations, orthonormal.
        size: length of the longest independent closure equation at any selection.
        matrix: (nv, nv) of the system, as last factored.
        pivot: its smallest over largest pivot; 0 if it is singular.
    """

    def __init__(
        self, evaluation: LoopEquations, driven: Sequence[Coordinate], q: Array,
        still: Sequence[int] | None = None, frame: int | None = None,
    ) -> None:
        self.evaluation, self._frame = evaluation, frame
        self.driven = tuple(driven)
        self.still = (
            fixed_base_entries(evaluation.mechanism, driven) if still is None else tuple(still))
        self.scale = evaluation.mechanism.velocity_scale
        nv = evaluation.model.nv
        self.drive = np.zeros((len(self.driven) + len(self.still), nv))
        for row, v in zip(self.drive, (*self.driven_entries, *self.still), strict=True):
            row[v] = 1.0
        self._bent = [(k, c) for k, c in enumerate(self.driven)
                      if c.q < 0 and not isinstance(c, VelocityEntry)]
        self.size = 0.0
        self.select(q)

    def _aim(self) -> None:
        """Update the derivatives of driven coordinates that are not velocity entries."""
        evaluation = self.evaluation
        for k, c in self._bent:
            self.drive[k] = scaled_row(evaluation.mechanism, c, evaluation.q)

    def select(self, q: Array) -> None:
        """Choose the independent equations at q."""
        evaluation = self.evaluation
        evaluation.update(q)
        self._aim()
        n, p = evaluation.constraints.n_closure, evaluation.constraints.n_passive
        self.equations = independent_rows(evaluation.jacobian[:n])
        r = len(self.equations)
        chosen = evaluation.jacobian[self.equations]
        self.size = max(self.size, float(np.linalg.norm(chosen, axis=1).max(initial=0.0)))
        regular = np.vstack([chosen, evaluation.jacobian[n:], self.drive])
        svd, d = decompose(regular), len(self.driven)
        if svd.rank < r + p + len(self.drive):
            raise SingularError(dependence_words(
                evaluation, self.driven, self.drive[:d], self.still,
                np.delete(regular, slice(r + p, r + p + d), axis=0)))
        self.passive = svd.null_space
        if len(self.passive):
            if self._frame is None or moves_frame(evaluation, self.passive, self._frame):
                check_passive(evaluation, self.driven, self.passive, r, q)
            else:
                check_regular(evaluation, q, r)
        self.factor()

    @property
    def has_redundant_equations(self) -> bool:
        """Whether some closure equations are redundant and left out."""
        return len(self.equations) < self.evaluation.constraints.n_closure

    def check_regular(self, q: Array) -> None:
        """Refuse a configuration q (nq,) at which the loops lose independent equations.

        Raises:
            SingularError: they do.
        """
        check_regular(self.evaluation, q, len(self.equations))

    def factor(self) -> None:
        """Factor the matrix at the evaluation's configuration."""
        self._aim()
        jacobian, n = self.evaluation.jacobian, self.evaluation.constraints.n_closure
        self.matrix = np.concatenate(
            [jacobian[self.equations], jacobian[n:], self.drive, self.passive])
        self.pivot = Factors(self.matrix.T).pivot  # sought among the unknowns of an equation

    @property
    def driven_entries(self) -> list[int]:
        """Indices of the driven coordinates in the velocity vector."""
        return [c.v for c in self.driven]

    @property
    def free(self) -> NDArray[np.bool_]:
        """(nv,) the velocities that are not prescribed."""
        free = np.ones(len(self.scale), dtype=bool)
        free[[*self.driven_entries, *self.still]] = False
        return free

    @property
    def chosen(self) -> Chosen:
        """The independent equations, and the rows that complete the system."""
        return self.equations, self.passive

    @contextmanager
    def _rates(self, q: Array) -> Iterator[tuple[RateSolver, Array]]:
        """Acquire the solver for rates at q (nq,) with the selected equations, and its columns."""
        with kernel_of(self.evaluation.mechanism) as kernel:
            at = prescribed_indices(kernel.nv, self.driven, self.still)
            rates = rates_of(kernel, tuple(at), len(self.driven))
            found = rates.solve(
                q, self.evaluation.angle_reference, ("columns",), chosen=self.chosen)
            if found is None:
                raise SingularError(f"mechanism {self.evaluation.mechanism.name!r}: singular "
                                    "configuration: the rates are not determined there")
            yield rates, found[0]

    def driver_rates(self) -> Array:
        """Return (nv, n_drivers): joint velocities per unit speed of each driver."""
        with self._rates(self.evaluation.q) as (_, columns):
            return columns

    def acceleration(self, q: Array, v: Array, drive: Array) -> Array:
        """Return (nv,) joint accelerations at velocity v for driver accelerations (n_drivers,)."""
        with self._rates(q) as (rates, _):
            return rates.answer(None, drive, v)
