"""Pieces of Chebyshev polynomials through their nodes.

What is wanted thousands of times is cut into cells with a polynomial of low degree each, which
plain Python evaluates in a microsecond: where the Chebyshev coefficients fall to round-off, the difference is
round-off too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spatial_pin.linalg import Array

NODES = 32  # of a piece

_K = np.arange(NODES)
_ANGLES = np.pi * (_K + 0.5) / NODES
POINTS = np.cos(_ANGLES)  # Chebyshev points in (-1, 1), descending
TO_COEFFICIENTS = 2.0 / NODES * np.cos(np.outer(_K, _ANGLES))
TO_COEFFICIENTS[0] *= 0.5
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
        shift: (nq,) what is to be added to q: whole turns.
        tail: last coefficients, by the largest: the error.
    """

    first: float
    last: float
    coefficients: Array
    cells: list[list[list[float]]]
    shift: Array
    tail: float


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
    points = np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS)
    centres = (2.0 * np.arange(CELLS) + 1.0) / CELLS - 1.0
    values = polynomials_at((centres[:, None] + points / CELLS).ravel()).reshape(CELLS, TERMS, -1)
    powers = np.linalg.inv(np.vander(points, increasing=True))
    return np.ascontiguousarray((powers @ values).reshape(CELLS * TERMS, NODES))


TO_CELLS = _to_cells()


def cells_of(coefficients: Array) -> list[list[list[float]]]:
    """Return the cells of functions with Chebyshev coefficients (NODES, k), as in `Piece`."""
    found: list[list[list[float]]] = (
        (TO_CELLS @ coefficients).reshape(CELLS, TERMS, -1).swapaxes(1, 2).tolist())
    return found
