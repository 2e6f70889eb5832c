"""Pieces of Chebyshev polynomials through their nodes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spatial_pin.linalg import Array

NODES = 24  # of a piece

_K = np.arange(NODES)
_ANGLES = np.pi * (_K + 0.5) / NODES
POINTS = np.cos(_ANGLES)  # Chebyshev points in (-1, 1), descending
TO_COEFFICIENTS = 2.0 / NODES * np.cos(np.outer(_K, _ANGLES))
TO_COEFFICIENTS[0] *= 0.5


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
        reduced: (NODES, 4 + 6 k) those of m, h, g and the potential energy, and of w and d of k
            bodies that spin, contiguous.
        shift: (nq,) what is to be added to q: whole turns.
        tail: last coefficients, by the largest: the error.
    """

    first: float
    last: float
    coefficients: Array
    reduced: Array
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
