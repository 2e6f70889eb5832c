"""Dense factorisations of small matrices, compiled: `dense.c` as Python calls it.

A tenth of a second of processor time dearer to import, `scipy.linalg` does the same. NumPy keeps no
factors, and one of its calls costs 3 to 10 µs where these cost 1 to 4.
"""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.library import library

Array = NDArray[np.floating[Any]]
Order = NDArray[np.int64]

_COUNT = ctypes.c_int64
_REALS, _COUNTS = ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_int64)
_reals: Any = ctypes.c_double.from_buffer
_counts: Any = ctypes.c_int64.from_buffer


def _function(name: str, returns: Any, *takes: Any) -> Any:
    function = getattr(library(), name)
    function.restype, function.argtypes = returns, takes
    return function


_lu = _function("dense_lu", _COUNT, _COUNT, _REALS, _COUNTS)
_lu_solve = _function(
    "dense_lu_solve", None, _COUNT, _REALS, _COUNTS, _COUNT, _COUNT, _REALS)
_qr = _function("dense_qr", None, _COUNT, _COUNT, _REALS, _COUNTS, _REALS, _REALS)
_qr_turn = _function("dense_qr_turn", None, _COUNT, _COUNT, _REALS, _REALS, _COUNT, _COUNT, _COUNT,
                     _REALS, _REALS)
_independent_rows = _function(
    "independent_rows", _COUNT, _COUNT, _COUNT, _REALS, _COUNT, ctypes.c_double, _COUNTS,
    _REALS)


def _own(a: Array) -> Array:
    """Return a copy by rows, of doubles."""
    return np.array(a, dtype=np.float64, order="C")


def lu(a: Array) -> tuple[Array, Order, bool]:
    """Return L U of `a` (n, n) with its rows exchanged, the exchanges, and whether it is regular.

    L and U stand in one matrix; row k was exchanged with row `order[k]`, one after the other.
    """
    factors, n = _own(a), len(a)
    order = np.empty(n, dtype=np.int64)
    if not n:
        return factors, order, True
    return factors, order, not _lu(n, _reals(factors), _counts(order))


def lu_solve(factors: Array, order: Order, b: Array, transposed: bool = False) -> Array:
    """Return a^-1 b, or a^-T b, for b (n,) or (n, k) and the factors of `lu`."""
    x = _own(b)
    if x.size:
        _lu_solve(len(x), _reals(factors), _counts(order), transposed, x.size // len(x), _reals(x))
    return x


def upper_solve(upper: Array, b: Array, transposed: bool = False) -> Array:
    """Return R^-1 b, or R^-T b, for the upper triangle of (n, n), and b (n,) or (n, k)."""
    return lu_solve(np.triu(upper), np.arange(len(upper)), b, transposed)


class Independence(NamedTuple):
    """Which rows of a matrix are independent, and how clearly.

    Attributes:
        rows: their indices, ascending.
        least: length of the remainder of the last one chosen, relative to the first one's; 0 where
            there is none.
        left_out: likewise of the longest of those that were not.
    """

    rows: NDArray[np.intp]
    least: float
    dependent: float


def independence(a: Array, most: int, part: float) -> Independence:
    """Return independent rows of `a` (m, n): the longest one left is chosen first.

    Args:
        a: the rows.
        most: how many are chosen at most.
        part: of the length of the first one, below which the remainder of a row counts as zero.
    """
    chosen, facts = np.empty(len(a), dtype=np.int64), np.zeros(2)
    if not a.size:
        return Independence(chosen[:0].astype(np.intp), 0.0, 0.0)
    rank = _independent_rows(*a.shape, _reals(_own(a)), most, part, _counts(chosen), _reals(facts))
    if rank < 0:
        raise MemoryError
    return Independence(chosen[:rank].astype(np.intp, copy=False), *facts.tolist())


def qr(a: Array) -> tuple[Array, Order, Array]:
    """Return Q R of the columns `order` (n,) of `a` (m, n), the longest left coming first.

    R stands in the upper triangle, and below it what `qr_turn` makes Q of, with the third (n,).
    """
    m, n = a.shape
    factors, order, tau = _own(a), np.arange(n), np.zeros(n)
    if a.size:
        _qr(m, n, _reals(factors), _counts(order), _reals(tau), _reals(np.empty(3 * n)))
    return factors, order, tau


def qr_turn(factors: Array, tau: Array, x: Array, transposed: bool = False) -> Array:
    """Return Q x, or Q^T x, for x (m,) or (m, k) and the factors of `qr`."""
    (m, n), turned = factors.shape, _own(x)
    if turned.size and factors.size:
        columns = turned.size // m
        _qr_turn(m, n, _reals(factors), _reals(tau), min(m, n), transposed, columns,
                 _reals(turned), _reals(np.empty(columns)))
    return turned
