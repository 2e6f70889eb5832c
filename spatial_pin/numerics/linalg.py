"""Rank, null space, minimum-norm solution, condition: the only factorisations in the library."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.errors import SingularError
from spatial_pin.numerics import dense
from spatial_pin.numerics.tolerances import EPS as EPS, TOLERANCES

Array = NDArray[np.floating[Any]]  # the float64 arrays of the library

# Random members that represent all self-stresses. One would do with a chance of 1 - 1e-8 per
# reaction.
MEMBERS = 3
NOT_FINITE = ("the equations have entries that are no finite numbers: a position or a rate has "
              "grown beyond all numbers")


class Decomposition(NamedTuple):
    """Singular value decomposition with the rank it implies.

    Attributes:
        u: (m, k) left singular vectors, k = min(m, n).
        s: (k,) singular values, descending.
        vt: (n, n) right singular vectors in rows.
        rank: number of singular values above the tolerance.
    """

    u: Array
    s: Array
    vt: Array
    rank: int

    @property
    def null_space(self) -> Array:
        """(n - rank, n) orthonormal rows that span the null space."""
        return self.vt[self.rank :]

    @property
    def left_null_space(self) -> Array:
        """(m - rank, m) orthonormal rows x with x a = 0, of a `full_decomposition`."""
        return self.u[:, self.rank :].T

    def minimum_norm_transposed(self, b: Array) -> Array:
        """Return the least-squares solution x (m,) of least norm of x a = b (n,)."""
        r = self.rank
        return self.u[:, :r] @ ((self.vt[:r] @ b) / self.s[:r])

    def minimum_norm(self, b: Array) -> Array:
        """Return the least-squares solutions of least norm for `b` (m,), or its columns (m, k)."""
        r = self.rank
        return self.vt[:r].T @ ((self.u[:, :r].T @ b).T / self.s[:r]).T


def solved_transposed(a: Array, b: Array) -> tuple[Array, Array | None]:
    """Return the least-squares solutions x (N, m) of least norm of x a = b, and y with y a = 0.

    As `Decomposition.minimum_norm_transposed` and `left_null_space`, for matrices (N, m, n) and b
    (N, n). The rows y (N, k, m) are None where the ranks differ.
    """
    if not a.size:
        return np.zeros(a.shape[:2]), None
    u, s, vt = np.linalg.svd(a)
    held = s > np.maximum(TOLERANCES.rank * s[:, :1], TOLERANCES.zero)
    ranks, n = np.count_nonzero(held, axis=1), s.shape[1]
    parts = np.divide((vt[:, :n] @ b[..., None])[..., 0], s, out=np.zeros_like(s), where=held)
    x: Array = (u[..., :n] @ parts[..., None])[..., 0]
    return x, u[..., ranks[0] :].mT if np.all(ranks == ranks[0]) else None


def complements(a: Array) -> Array:
    """Return orthonormal columns (..., m, m - n) square to n independent ones (..., m, n)."""
    rest: Array = np.linalg.qr(a, mode="complete")[0][..., a.shape[-1] :]
    return rest


def decompose(a: Array, tolerance: float = TOLERANCES.rank) -> Decomposition:
    """Decompose `a` (m, n); columns and rows are expected to be scaled alike.

    Raises:
        SingularError: an entry is no number.
    """
    m, n = a.shape
    if m == 0:
        return Decomposition(np.empty((0, 0)), np.empty(0), np.eye(n), 0)
    if n == 0:
        return Decomposition(np.empty((m, 0)), np.empty(0), np.empty((0, 0)), 0)
    try:
        u, s, vt = np.linalg.svd(a, full_matrices=m < n)  # vt is to span the null space too
    except np.linalg.LinAlgError:  # as some machines' libraries tell it
        s = np.array([np.nan])
    if not s[0] < np.inf:
        raise SingularError(NOT_FINITE)
    rank = int(np.count_nonzero(s > max(tolerance * s[0], TOLERANCES.zero)))
    return Decomposition(u, s, vt, rank)


def full_decomposition(a: Array) -> Decomposition:
    """Decompose `a` (m, n) with `u` (m, m) and `vt` (n, n) whole: all four subspaces."""
    m, n = a.shape
    if not a.size:
        return Decomposition(np.eye(m), np.empty(0), np.eye(n), 0)
    if not np.isfinite(a).all():
        return decompose(a)  # which refuses it
    u, s, vt = np.linalg.svd(a, full_matrices=True)
    rank = int(np.count_nonzero(s > max(TOLERANCES.rank * s[0], TOLERANCES.zero)))
    return Decomposition(u, s, vt, rank)


def singular_values(a: Array) -> Array:
    """Return the singular values (..., k), descending, of matrices (..., m, n)."""
    return np.linalg.svd(a, compute_uv=False)


def rank(a: Array, tolerance: float = TOLERANCES.rank) -> int:
    """Return the numerical rank of `a`."""
    return decompose(a, tolerance).rank


def null_space(a: Array, tolerance: float = TOLERANCES.rank) -> Array:
    """Return orthonormal rows spanning {x: a x = 0}."""
    return decompose(a, tolerance).null_space


class Triangular:
    """QR of the transpose of a matrix (m, n), rows pivoted: a third of the price of `decompose`.

    A complete orthogonal decomposition where rows are dependent [GolubVanLoan2013, 5.4.7].

    Attributes:
        rank: number of rows that are independent of those before.

    Args:
        a: the matrix; columns and rows are expected to be scaled alike.
    """

    def __init__(self, a: Array) -> None:
        if not np.isfinite(a).all():
            raise SingularError(NOT_FINITE)
        self._rows, self._n = a.shape
        self._factors, self._order, self._tau = dense.qr(a.T)
        sizes = np.abs(self._factors.diagonal())
        least = max(TOLERANCES.rank * float(sizes.max(initial=0.0)), TOLERANCES.zero)
        self.rank = int(np.count_nonzero(sizes > least))

    @property
    def null_space(self) -> Array:
        """(n - rank, n) orthonormal rows that span {x: a x = 0}."""
        return dense.qr_turn(self._factors, self._tau, np.eye(self._n)[:, self.rank :]).T

    def minimum_norm(self, b: Array) -> Array:
        """Return the least-squares solution x (n,) of a x = b (m,) of least norm."""
        r, x, b = self.rank, np.zeros(self._n), b[self._order]
        if r == self._rows:
            x[:r] = dense.upper_solve(self._factors[:r, :r], b, transposed=True)
        elif r:  # rows that depend on others need not agree with them
            factors, order, tau = dense.qr(np.triu(self._factors[:r]).T)
            x[order] = dense.upper_solve(
                factors[:r], dense.qr_turn(factors, tau, b, transposed=True)[:r])
        return dense.qr_turn(self._factors, self._tau, x)


def null_vectors(a: Array, tolerance: float) -> tuple[Array, NDArray[np.intp]]:
    """Return of matrices (m, r, n) the sum of the null space's rows (m, n), and ranks (m,)."""
    _, s, vt = np.linalg.svd(a)
    ranks = np.count_nonzero(s > np.maximum(tolerance * s[:, :1], TOLERANCES.zero), axis=1)
    is_null = np.arange(a.shape[2]) >= ranks[:, None]
    return np.einsum("mk,mkn->mn", is_null.astype(np.float64), vt), ranks


def row_space(a: Array, tolerance: float = TOLERANCES.rank) -> Array:
    """Return orthonormal rows spanning the rows of `a`."""
    svd = decompose(a, tolerance)
    return svd.vt[: svd.rank]


def aligned(rows: Array, reference: Array) -> Array:
    """Return orthonormal `rows` (k, n) turned among themselves to be nearest to `reference`.

    Orthogonal Procrustes problem [GolubVanLoan2013, 6.4.1].
    """
    u, _, vt = np.linalg.svd(reference @ rows.T)
    return u @ vt @ rows


def least_squares(a: Array, b: Array) -> Array:
    """Return x (n,) or (n, k) for which |a x - b| is least, the shortest of all that are."""
    return np.linalg.lstsq(a, b, rcond=None)[0]


def pseudo_inverses(a: Array, tolerance: float) -> Array:
    """Return those of matrices (N, m, n), singular values below a part of the largest as zero."""
    return np.linalg.pinv(a, rcond=tolerance)


def column_spaces(a: Array) -> Array:
    """Return orthonormal columns (N, m, k) that span those of matrices (N, m, k), k at most m."""
    u: Array = np.linalg.svd(a, full_matrices=False)[0]
    return u


def null_spaces(a: Array, count: int) -> Array:
    """Return orthonormal rows (N, count, n) that matrices (N, m, n) map to zero, or to least."""
    vt: Array = np.linalg.svd(a)[2]
    return vt[:, vt.shape[1] - count :]


def mean_subspace(a: Array, weights: Array) -> Array:
    """Return orthonormal rows (k, m) that span the mean of subspaces.

    It has the least sum of squared chordal distances, times the weights, from all of them
    [GolubVanLoan2013, 6.4.3].

    Args:
        a: (N, m, k) orthonormal columns of each.
        weights: (N,) of these.
    """
    mean = np.einsum("k,kij,klj->il", weights, a, a)
    vectors: Array = np.linalg.eigh(mean)[1]
    return vectors[:, vectors.shape[1] - a.shape[2] :].T


def largest_by(scale: Array, x: Array) -> float:
    """Return the largest absolute value of x (N, n) by the scale (n,) of its column; 0 of none.

    Columns are compared as rows of a copy, which numpy does ten times as fast.
    """
    sizes = scale.tolist()
    if len({*sizes}) == 1:
        return max(x.max(initial=0.0).item(), -x.min(initial=0.0).item()) / sizes[0]
    rows = np.ascontiguousarray(x.T)
    largest = np.maximum(rows.max(axis=1, initial=0.0), -rows.min(axis=1, initial=0.0))
    return float((largest / scale).max(initial=0.0))


def independent_rows(a: Array, tolerance: float = TOLERANCES.rank) -> NDArray[np.intp]:
    """Return the sorted indices of a maximal well-conditioned set of independent rows of `a`.

    As column-pivoted QR of the transpose chooses them [GolubVanLoan2013, 5.4].
    """
    return dense.independence(a, len(a), tolerance).rows


def common_rows(a: Array, given: Array, count: int) -> list[int]:
    """Return the first `count` rows that are independent in all matrices; fewer if there are not.

    In the order of the rows, so that round-off has no say where several choices are as good.

    Args:
        a: (m, r, n) matrices.
        given: (k, n) rows that the others are to be independent of too.
        count: how many are wanted.
    """
    chosen: list[int] = []
    basis = np.repeat(row_space(given)[None], len(a), axis=0)
    for least in (1e-3, 1e-6, 1e-9):
        for i in range(a.shape[1]):
            if i in chosen or len(chosen) == count:
                continue
            rest = a[:, i]
            for _ in range(2):  # once more for the digits that the first time has lost
                rest = rest - np.einsum("mk,mkn->mn", np.einsum("mkn,mn->mk", basis, rest), basis)
            sizes = np.linalg.norm(rest, axis=1)
            if sizes.min(initial=1.0) > least:
                chosen.append(i)
                basis = np.concatenate([basis, (rest / sizes[:, None])[:, None]], axis=1)
    return sorted(chosen)


def pivoted_rows(a: Array, count: int) -> list[int]:
    """Return the sorted indices of `count` independent rows, by threshold pivoting.

    Each is the first whose part independent of those before is at least a tenth of the largest
    [DuffErismanReid1986], so that round-off has no say where several are as good.

    Args:
        a: (r, n) matrix of rank `count` or more.
        count: how many are wanted.
    """
    rest, chosen = a.copy(), []
    for _ in range(count):
        sizes = np.linalg.norm(rest, axis=1)
        chosen.append(int(np.argmax(sizes >= 0.1 * sizes.max())))
        along = rest[chosen[-1]] / sizes[chosen[-1]]
        for _ in range(2):  # once more for the digits that the first time has lost
            rest = rest - np.outer(rest @ along, along)
    return sorted(chosen)


def determinant_signs(a: Array) -> list[int]:
    """Return the signs (-1, 0, 1) of the determinants of matrices (m, n, n)."""
    return [int(x) for x in np.linalg.slogdet(a)[0]]


def pivots_of(lu: Array, pivots: dense.Order) -> tuple[int, float]:
    """Return the sign of the determinant from LU factors, and smallest over largest pivot.

    Both are 0 for a singular matrix, both 1 for an empty one.
    """
    diagonal = lu.diagonal().tolist()
    if not diagonal:
        return 1, 1.0
    sizes = [abs(d) for d in diagonal]
    smallest, largest = min(sizes), max(sizes)
    if not smallest > 0.0:
        return 0, 0.0
    sign = 1
    for i, (d, p) in enumerate(zip(diagonal, pivots.tolist(), strict=True)):
        if (d < 0.0) != (p != i):
            sign = -sign
    return sign, smallest / largest


class Factors:
    """LU factors of a square matrix (n, n), which may be empty.

    Attributes:
        pivot: smallest over largest pivot, 0 if the matrix is singular.
    """

    def __init__(self, a: Array) -> None:
        self._lu, self._order, is_regular = dense.lu(a)
        self.pivot = pivots_of(self._lu, self._order)[1] if is_regular else 0.0

    def solve(self, b: Array) -> Array:
        """Return the solution for right-hand sides (n,) or (n, k)."""
        return dense.lu_solve(self._lu, self._order, b)

    def error_bounds(self, x: Array, known: Array, rounding: float) -> Array:
        """Return bounds on the errors of a solution, entry by entry [Higham2002, 7.2, 9.3].

        Args:
            x: the solution (n,) or (n, k).
            known: (n, n) how far the entries of the matrix may be off.
            rounding: of an entry of the factors, relative to the size of its summands.
        """
        if not len(known):
            return np.zeros_like(x)
        return self.spread((known + rounding * self._grown) @ np.abs(x))

    def spread(self, off: Array) -> Array:
        """Return bounds on the errors of a solution for errors (n,) or (n, k) of its right side."""
        return self._inverse @ off

    @cached_property
    def _inverse(self) -> Array:
        """Sizes (n, n) of the entries of the inverse; infinite where there is none."""
        if not self.pivot:
            return np.full_like(self._lu, np.inf)
        return np.abs(self.solve(np.eye(len(self._lu))))

    @cached_property
    def _grown(self) -> Array:
        """Sizes (n, n) of all that is added to the entries of the matrix, in its own order."""
        lu = np.abs(self._lu)
        grown = np.tril(lu, -1) @ np.triu(lu) + np.triu(lu)
        for i, p in reversed(list(enumerate(self._order.tolist()))):
            if i != p:
                grown[[i, p]] = grown[[p, i]]
        return grown


def weighty_rows(a: Array, count: int) -> NDArray[np.intp]:
    """Return the sorted indices of `count` independent rows of `a`, the longest first chosen."""
    return dense.independence(a, count, 0.0).rows


def determinant_sign_of(a: Array) -> int:
    """Return the sign (-1, 0, 1) of the determinant of `a` (n, n)."""
    lu, order, _ = dense.lu(a)
    return pivots_of(lu, order)[0]


def whole_turns(angle: Any) -> Any:
    """Return the whole turns nearest to an angle, or to each of several [rad]."""
    return 2.0 * np.pi * np.round(angle / (2.0 * np.pi))


class SparseSpaces:
    """The subspaces of a large sparse Jacobian (n_rows, nv), named as those of a `Decomposition`.

    What the singular value decomposition tells of the Jacobian J of a few loops, for many: with the
    independent equations J_r, and the columns J_c that are left when as many coordinates are taken
    out as there are freedoms, both

        [1  J_r^T; J_r  0]     and     [1  J_c; J_c^T  0]

    are regular. The first, a KKT system, takes any velocities to the nearest that the loops allow,
    the second any multipliers to the nearest self-stress, or generalised forces to the shortest
    multipliers that bear them [GolubVanLoan2013, 5.5]. Both have the pattern of the loops: their
    factors grow with the number of loops.

    Args:
        row_at, column_at: (nnz,) places of its entries.
        values: (nnz,) its entries, of order one.
        shape: n_rows, nv.
        rank: how many independent rows there are, as is thought.
        nearest: takes motions (k, nv) to the nearest that as many rows allow.

    Attributes:
        null_space: (nv - rank, nv) orthonormal rows that span the freedoms.
        is_sure: whether the other rows follow from those.
    """

    def __init__(
        self, row_at: NDArray[np.intp], column_at: NDArray[np.intp], values: Array,
        shape: tuple[int, int], rank: int, nearest: Callable[[Array], Array],
    ) -> None:
        from scipy.sparse import csr_array  # imported on use: it takes a tenth of a second

        self.jacobian: Any = csr_array((values, (row_at, column_at)), shape=shape)
        self.rank = rank
        motions = np.random.default_rng(4).standard_normal((shape[1] - rank, shape[1]))
        for _ in range(2):  # once more for the digits that the first time has lost
            motions = np.linalg.qr(nearest(motions).T)[0].T
        self.null_space = motions
        motion = np.ones(len(motions)) @ motions
        residual, terms = np.abs(self.jacobian @ motion), abs(self.jacobian) @ np.abs(motion)
        self.is_sure = bool(np.all(residual <= TOLERANCES.nothing * terms.max(initial=1.0)))

    @cached_property
    def _dependent(self) -> NDArray[np.intp]:
        """Places of the coordinates that the others determine."""
        free = weighty_rows(self.null_space.T, len(self.null_space))
        return np.setdiff1d(np.arange(self.jacobian.shape[1]), free)

    @cached_property
    def _balanced(self) -> _ProjectionMatrix:
        return _ProjectionMatrix(self.jacobian[:, self._dependent])

    def minimum_norm_transposed(self, b: Array) -> Array:
        """Return the shortest x (n_rows,) with x J = b, for a b (nv,) that no freedom feels."""
        if not self.rank:
            return np.zeros(self.jacobian.shape[0])
        return self._balanced.shortest(b[self._dependent])

    @cached_property
    def left_null_space(self) -> Array:
        """(k, n_rows) random self-stresses, x J = 0: entries of order one, each a bit of all."""
        n = self.jacobian.shape[0]
        members = np.random.default_rng(5).standard_normal((min(MEMBERS, n - self.rank), n))
        return np.array([self._balanced.nearest(x) for x in members]).reshape(members.shape)


class _ProjectionMatrix:
    """The regular matrix [1 A; A^T 0] of a sparse matrix A (m, r) of full column rank, factored."""

    def __init__(self, a: Any) -> None:
        from scipy.sparse import block_array, eye_array
        from scipy.sparse.linalg import splu

        self._m, self._r = a.shape
        self._matrix = block_array([[eye_array(self._m), a], [a.T, None]], format="csc")
        self._factors: Any = splu(self._matrix) if self._r else None

    def nearest(self, x: Array) -> Array:
        """Return the nearest vector (m,) to x with A^T y = 0."""
        return self._solved(np.concatenate([x, np.zeros(self._r)])) if self._r else x

    def shortest(self, b: Array) -> Array:
        """Return the shortest vector (m,) with A^T y = b (r,)."""
        return self._solved(np.concatenate([np.zeros(self._m), b])) if self._r else b

    def _solved(self, rhs: Array) -> Array:
        x = self._factors.solve(rhs)
        x += self._factors.solve(rhs - self._matrix @ x)
        return x[: self._m]
