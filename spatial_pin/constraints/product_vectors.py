"""The vectors whose scalar products closure equations are: linear in where the bodies are.

With G the joint placements stacked as rows (columns of R, then p, of each joint), every vector is
a row of C G.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

DENSE_LIMIT = 60_000  # entries of C above which a sparse matrix is faster


class Term(NamedTuple):
    """A part of a vector: factor * (R_joint local + flag p_joint).

    Attributes:
        factor: number before it.
        joint: whose placement it is.
        local: (3,) in the joint's axes.
        flag: 1 for a point, 0 for a direction.
        frame: of the model, that the point is the origin of or the direction is fixed in; of an
            idle rotation's axis, which runs through two points, -1 less the axis' number.
    """

    factor: float
    joint: int
    local: Array
    flag: float
    frame: int


class FrameOnBody(NamedTuple):
    """A frame as it is fixed in the body of a joint."""

    frame: int
    joint: int
    placement: pin.SE3

    @classmethod
    def of(cls, mechanism: Mechanism, name: str) -> FrameOnBody:
        """Return the frame, link or joint of a name, on the ground relative to the centre."""
        return cls(mechanism.frame_id(name), *mechanism.centred_frame(name))

    def origin(self, factor: float) -> Term:
        """Return its origin."""
        return Term(factor, self.joint, self.placement.translation, 1.0, self.frame)

    def direction(self, axis: Array, factor: float = 1.0) -> Term:
        """Return a direction (3,) in its axes."""
        return Term(factor, self.joint, self.placement.rotation @ axis, 0.0, self.frame)


def frames_of(mechanism: Mechanism, names: Sequence[str]) -> tuple[FrameOnBody, FrameOnBody]:
    """Return two frames by their names."""
    first, second = (FrameOnBody.of(mechanism, name) for name in names)
    return first, second


class VectorBlock:
    """Coefficient rows on G of one block (A, B or X), grown row by row, and their terms."""

    def __init__(self) -> None:
        self.terms: list[tuple[Term, ...]] = []

    def add(self, *terms: Term) -> None:
        """Add the sum of terms."""
        self.terms.append(terms)

    def entries(self) -> Entries:
        """Return the entries of the rows, without zeros."""
        cells: dict[tuple[int, int], float] = {}
        for row, terms in enumerate(self.terms):
            for term in terms:
                for k, x in enumerate((*term.local, term.flag)):
                    at = row, 4 * term.joint + k
                    cells[at] = cells.get(at, 0.0) + term.factor * x
        found = [(*at, x) for at, x in cells.items() if x]
        rows, columns, values = zip(*found, strict=True) if found else ((), (), ())
        return Entries(np.array(rows, np.intp), np.array(columns, np.intp), np.array(values, float))


class Entries(NamedTuple):
    """Entries of a matrix: where they are, and what."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    values: Array


def matrix_of(blocks: list[Entries], starts: list[int], shape: tuple[int, int]) -> Any:
    """Return the matrix with blocks from some rows on; a sparse one where it is large."""
    rows = np.concatenate([x.rows + start for x, start in zip(blocks, starts, strict=True)])
    columns, values = (np.concatenate(x) for x in (
        [x.columns for x in blocks], [x.values for x in blocks]))
    if shape[0] * shape[1] <= DENSE_LIMIT:
        dense = np.zeros(shape)
        dense[rows, columns] = values
        return dense
    from scipy.sparse import csr_array  # imported on use: it takes a tenth of a second

    found = csr_array((values, (rows, columns)), shape=shape)
    found.sort_indices()
    return found
