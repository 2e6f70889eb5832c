"""Pieces of Chebyshev polynomials through their nodes.

What is wanted thousands of times is cut into cells with a polynomial of low degree each, which
plain Python evaluates in a microsecond: where the Chebyshev coefficients fall to round-off, the
difference is round-off too.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from spatial_pin.numerics.linalg import Array

NODES = 32  # of a piece, at most
FEWER = (12, 16, 24)  # others

_K = np.arange(NODES)


def points(n: int) -> Array:
    """Return n Chebyshev points in (-1, 1), descending."""
    found: Array = np.cos(np.pi * (np.arange(n) + 0.5) / n)
    return found


def coefficients_of(rows: Array) -> Array:
    """Return the Chebyshev coefficients (n, k) of functions with values (n, k) at `points(n)`."""
    n = len(rows)
    if n not in _TO_COEFFICIENTS:
        k = np.arange(n)
        matrix = 2.0 / n * np.cos(np.outer(k, np.pi * (k + 0.5) / n))
        matrix[0] *= 0.5
        _TO_COEFFICIENTS[n] = matrix
    found: Array = _TO_COEFFICIENTS[n] @ rows
    return found


_TO_COEFFICIENTS: dict[int, Array] = {}
CELLS, TERMS = 96, 7  # of a piece, and of a cell's polynomial


class Columns(NamedTuple):
    """Where a table's functions stand among its columns."""

    q: slice
    t: slice
    c: slice
    springs: slice
    angles: slice
    reduced: slice
    width: int


class Piece(NamedTuple):
    """Functions on one stretch of the coordinate.

    Attributes:
        first, last: ends of the stretch.
        coefficients: (NODES, width) of Chebyshev polynomials.
        cells: by cell, for m, h and g, and w and d of every body that spins, the polynomial in the
            place (-1, 1) in the cell, highest power last.
        pace: how fast joints move at most, scaled, for the coordinate.
        shift: (nq,) what is to be added to q: whole turns.
        tail: last coefficients, by the largest: the error.
    """

    first: float
    last: float
    coefficients: Array
    cells: list[list[list[float]]]
    pace: float
    shift: Array
    tail: float

    def part(self, s: Array | float) -> Any:
        """Return where places (N,), or one, lie in the stretch: from -1 to 1."""
        return (2.0 * s - self.first - self.last) / (self.last - self.first)


def polynomials(x: float) -> Array:
    """Return the Chebyshev polynomials (NODES,) at x in (-1, 1)."""
    basis: Array = np.cos(_K * math.acos(min(1.0, max(-1.0, x))))
    return basis


def polynomials_at(x: Array) -> Array:
    """Return the Chebyshev polynomials (N, NODES) at places (N,) in (-1, 1)."""
    basis: Array = np.cos(np.arccos(np.clip(x, -1.0, 1.0))[:, None] * _K)
    return basis


def _to_cells() -> Array:
    """Return (CELLS TERMS, NODES): coefficients of powers in each cell from Chebyshev's."""
    inside = points(TERMS)
    centres = (2.0 * np.arange(CELLS) + 1.0) / CELLS - 1.0
    values = polynomials_at((centres[:, None] + inside / CELLS).ravel()).reshape(CELLS, TERMS, -1)
    powers = np.linalg.inv(np.vander(inside, increasing=True))
    return np.ascontiguousarray((powers @ values).reshape(CELLS * TERMS, NODES))


TO_CELLS = _to_cells()


def cells_of(coefficients: Array) -> list[list[list[float]]]:
    """Return the cells of functions with Chebyshev coefficients (NODES, k), as in `Piece`."""
    found: list[list[list[float]]] = (
        (TO_CELLS @ coefficients).reshape(CELLS, TERMS, -1).swapaxes(1, 2).tolist())
    return found
