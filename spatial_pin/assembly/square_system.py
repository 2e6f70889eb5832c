"""The square system of a closed mechanism: which equations determine its motion, or why none do.

Rates are solved for by the kernel, with the equations that are chosen here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from spatial_pin.assembly.close import scaled_row
from spatial_pin.assembly.holding import still_entries
from spatial_pin.assembly.undetermined import Asked, check_passive, check_regular, dependence
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.paths import prescribed_places
from spatial_pin.kernel.rates import Chosen, Rates, rates_of
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.numerics.linalg import (
    Array,
    decompose,
    independent_rows,
    pivots_of,
    rows_factored,
)
from spatial_pin.numerics.tolerances import TOLERANCES

SINGULAR_PIVOT = TOLERANCES.singular


class SquareSystem:
    """The square linear system of a mechanism whose freedoms are all driven or passive.

    Its rows are independent closure rows, resolved passive freedoms, drivers, what stands still,
    and for each passive freedom that is not resolved a row that asks for the least motion; its
    unknowns are scaled velocities.

    Attributes:
        evaluation: the closure equations at the current configuration.
        driven: the prescribed coordinates.
        still: places in the velocity vector that are zero.
        rows: indices of the independent closure rows.
        scale: (nv,) velocity of a unit of each unknown.
        passive: (k, nv) unresolved passive freedoms where the rows were selected, orthonormal.
        size: length of the longest independent closure row wherever they were selected.

    Args:
        evaluation: the closure equations.
        driven: the prescribed coordinates.
        q: (nq,) where rows are selected.
        still: default those of the free bases that nobody drives.
    """

    def __init__(
        self, evaluation: Evaluation, driven: Sequence[Coordinate], q: Array,
        still: Sequence[int] | None = None,
    ) -> None:
        self.evaluation = evaluation
        self.driven = tuple(driven)
        self.still = still_entries(evaluation.mechanism, driven) if still is None else tuple(still)
        self.scale = evaluation.mechanism.velocity_scale
        nv = evaluation.model.nv
        self._drive = np.zeros((len(self.driven) + len(self.still), nv))
        for row, v in zip(self._drive, (*self.drive_at, *self.still), strict=True):
            row[v] = 1.0
        self._bent = [(k, c) for k, c in enumerate(self.driven)
                      if c.q < 0 and not isinstance(c, VelocityEntry)]
        self.matrix = np.zeros((nv, nv))
        self.size = 0.0
        self.select(q)

    def _aim(self) -> None:
        """Turn the rows of driven coordinates whose rates are no entries of the velocity."""
        evaluation = self.evaluation
        for k, c in self._bent:
            self._drive[k] = scaled_row(evaluation.mechanism, c, evaluation.q)

    def select(self, q: Array) -> None:
        """Choose the independent rows at q.

        Raises:
            SingularError: the drivers are not independent there, or a freedom is not driven.
        """
        evaluation = self.evaluation
        evaluation.update(q)
        self._aim()
        n, p, d = evaluation.constraints.n_rows, evaluation.constraints.n_passive, len(self._drive)
        self.rows = independent_rows(evaluation.jacobian[:n])
        r = len(self.rows)
        lengths = np.linalg.norm(evaluation.jacobian[self.rows], axis=1)
        self.size = max(self.size, float(lengths.max(initial=0.0)))
        regular = np.vstack([evaluation.jacobian[self.rows], evaluation.jacobian[n:], self._drive])
        asked = Asked(evaluation, self.driven, self._drive[: len(self.driven)], self.still)
        svd = decompose(regular)
        if svd.rank < r + p + d:
            raise SingularError(dependence(asked, np.delete(
                regular, slice(r + p, r + p + len(self.driven)), axis=0)))
        self.passive = svd.null_space
        if len(self.passive):
            check_passive(asked, self.passive, r, q)
        self._closure = slice(0, r)
        self._prescribed = slice(r + p, r + p + d)
        self.factor()

    @property
    def has_redundant_rows(self) -> bool:
        """Whether closure rows were left out because they follow from the others."""
        return len(self.rows) < self.evaluation.constraints.n_rows

    def check_regular(self, q: Array) -> None:
        """Refuse a configuration q (nq,) at which the loops lose independent equations.

        Raises:
            SingularError: they do.
        """
        check_regular(self.evaluation, q, len(self.rows))

    def factor(self) -> bool:
        """Factor the matrix at the evaluation's configuration; False when it is singular."""
        self._aim()
        jacobian, n = self.evaluation.jacobian, self.evaluation.constraints.n_rows
        np.concatenate([jacobian[self.rows], jacobian[n:], self._drive, self.passive],
                       out=self.matrix)
        self._lu, self._pivots, is_regular = rows_factored(self.matrix)
        return is_regular

    def pivots(self) -> tuple[int, float]:
        """Return the sign of the determinant, and smallest over largest pivot, as last factored."""
        return pivots_of(self._lu, self._pivots)

    @property
    def drive_at(self) -> list[int]:
        """Places of the driven coordinates in the velocity vector."""
        return [c.v for c in self.driven]

    @property
    def prescribed_rows(self) -> slice:
        """Rows of the matrix that prescribe the drivers, then what stands still."""
        return self._prescribed

    @property
    def closure_rows(self) -> slice:
        """Rows of the matrix that close the loops."""
        return self._closure

    @property
    def chosen(self) -> Chosen:
        """The independent equations, and what fills the system up."""
        return Chosen(self.rows, self.passive)

    @contextmanager
    def _rates(self, q: Array) -> Iterator[Rates]:
        """Acquire what solves for rates at q (nq,) with the equations chosen here."""
        with kernel_of(self.evaluation.mechanism) as kernel:
            at = prescribed_places(kernel, self.driven, self.still)
            rates = rates_of(kernel, tuple(at), len(self.driven))
            rates.place(q, self.evaluation.turns, self.chosen)
            yield rates

    def driver_rates(self) -> Array:
        """Return (nv, n_drivers): joint velocities per unit speed of each driver."""
        with self._rates(self.evaluation.q) as rates:
            return rates.columns()

    def acceleration(self, q: Array, v: Array, drive: Array) -> Array:
        """Return (nv,) joint accelerations at velocity v for driver accelerations (n_drivers,)."""
        with self._rates(q) as rates:
            return rates.acceleration(v, drive)
