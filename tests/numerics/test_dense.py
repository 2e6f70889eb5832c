"""Compiled dense factorisations: what they give is what they factored, for all sizes and scales."""

import numpy as np
import pytest
from variety import few

from spatial_pin.errors import SingularError
from spatial_pin.numerics import dense
from spatial_pin.numerics.linalg import (
    Factors,
    Triangular,
    decompose,
    independent_rows,
    pivots_of,
)

EPS = np.finfo(float).eps
SIZES = [1, 2, 3, 5, 12, 40]


def random(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def graded(n):
    """A matrix whose rows and columns differ in size by 1e24 each."""
    scale = np.logspace(-12, 12, n)
    return scale[:, None] * random(n, n, seed=n) * scale[::-1]


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("columns", [(), (1,), (3,)])
@pytest.mark.parametrize("transposed", [False, True])
def test_lu_solves(n, columns, transposed):
    a, b = random(n, n), random(n, *columns, seed=1)
    kept = a.copy(), b.copy()
    factors, order, is_regular = dense.lu(a)
    x = dense.lu_solve(factors, order, b, transposed)
    assert is_regular and x.shape == b.shape
    matrix = a.T if transposed else a
    assert np.abs(matrix @ x - b).max() <= 10 * n * EPS * np.abs(matrix).max() * np.abs(x).max() * n
    assert np.array_equal(a, kept[0]) and np.array_equal(b, kept[1])


@pytest.mark.parametrize("n", SIZES)
def test_lu_is_the_matrix_with_its_rows_exchanged(n):
    a = random(n, n)
    factors, order, _ = dense.lu(a)
    for k, p in enumerate(order):
        a[[k, p]] = a[[p, k]]
    lower = np.tril(factors, -1) + np.eye(n)
    assert np.abs(lower).max() <= 1.0
    assert lower @ np.triu(factors) == pytest.approx(a, abs=n * EPS * 8)
    assert pivots_of(*dense.lu(random(n, n))[:2])[0] == np.sign(np.linalg.det(random(n, n)))


def test_rows_are_exchanged_where_scales_differ():
    a = graded(9)
    x = dense.lu_solve(*dense.lu(a)[:2], a @ np.ones(9) * 1.0)
    assert np.abs(a @ (x - 1.0)).max() <= 100 * EPS * np.abs(a).max()


def test_a_singular_matrix_is_reported():
    a = random(4, 4)
    a[2] = 0.0
    assert not dense.lu(a)[2]
    assert not dense.lu(np.zeros((3, 3)))[2]
    assert not dense.lu(np.full((3, 3), np.nan))[2]
    assert Factors(a).pivot == 0.0


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (5, 3), (12, 12), (40, 7), (7, 40)])
def test_qr_is_the_matrix_with_its_columns_in_order(shape):
    a = random(*shape)
    factors, order, tau = dense.qr(a)
    m, n = shape
    k = min(m, n)
    q = dense.qr_turn(factors, tau, np.eye(m))
    assert q @ q.T == pytest.approx(np.eye(m), abs=1e-14)
    assert q[:, :k] @ np.triu(factors)[:k] == pytest.approx(a[:, order], abs=1e-13)
    diagonal = np.abs(np.diagonal(factors))
    assert np.all(diagonal[1:] <= diagonal[:-1] * (1.0 + 1e-7))
    x = random(m, seed=2)
    assert dense.qr_turn(factors, tau, dense.qr_turn(factors, tau, x, True)) == pytest.approx(x)


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (5, 3), (12, 12), (40, 7), (7, 40)])
def test_the_longest_row_left_is_chosen(shape):
    a = random(*shape)
    expected, left = [], a.copy()
    for _ in range(min(shape)):
        expected.append(int(np.argmax(np.linalg.norm(left, axis=1))))
        left = a - a @ np.linalg.pinv(a[expected]) @ a[expected]
        assert dense.independence(a, len(expected), 0.0).rows.tolist() == sorted(expected)
    assert independent_rows(a).tolist() == sorted(expected)


def test_rank_shows_in_the_rows_chosen():
    a = random(6, 3) @ random(3, 8, seed=1)
    for scale in (1e-9, 1.0, 1e100):
        assert len(independent_rows(scale * a)) == 3
    assert len(independent_rows(1e-14 * a)) == 0


def test_bands_are_chosen_as_full_rows_are():
    """Rows with zeros at their ends cost less, and are chosen alike."""
    a = np.zeros((30, 40))
    for i in range(30):
        a[i, i : i + 6] = random(6, seed=i)
    a[7], a[21] = a[3] - a[6], a[20] + a[22]
    turned = np.linalg.qr(random(40, 40))[0]
    assert len(independent_rows(a)) == 28
    assert independent_rows(a).tolist() == independent_rows(a @ turned).tolist()


def test_round_off_does_not_choose_among_equal_rows():
    """As in a mechanism that is its own mirror image: the first of them is taken."""
    a = np.eye(5)[[0, 1, 2, 3, 4, 0, 1]]
    for seed in range(20):
        noisy = a * (1.0 + 4 * EPS * random(7, 5, seed=seed))
        assert independent_rows(noisy).tolist() == [0, 1, 2, 3, 4]


def test_triangles():
    upper, b = random(6, 6) + 4.0 * np.eye(6), random(6, 2, seed=1)
    assert np.triu(upper) @ dense.upper_solve(upper, b) == pytest.approx(b)
    assert np.triu(upper).T @ dense.upper_solve(upper, b, True) == pytest.approx(b)
    assert np.triu(upper) @ dense.upper_solve(upper, b[:, 0]) == pytest.approx(b[:, 0])


def test_nothing_to_factor():
    none = np.empty((0, 0))
    assert dense.lu(none)[2]
    assert dense.lu_solve(*dense.lu(none)[:2], np.empty(0)).shape == (0,)
    assert dense.lu_solve(*dense.lu(np.eye(2))[:2], np.empty((2, 0))).shape == (2, 0)
    assert dense.qr(np.empty((3, 0)))[1].shape == (0,)
    assert dense.qr(np.empty((0, 3)))[1].tolist() == [0, 1, 2]
    assert independent_rows(np.empty((3, 0))).shape == (0,)
    assert independent_rows(np.empty((0, 3))).shape == (0,)


def test_entries_that_are_no_numbers_are_refused():
    from spatial_pin import SingularError

    for bad in (np.nan, np.inf):
        a = random(3, 4)
        a[1, 1] = bad
        with pytest.raises(SingularError, match="no finite numbers"):
            decompose(a)


@pytest.mark.delicate
@pytest.mark.parametrize("seed", few(range(40), *range(10)))
def test_triangular_factors_tell_what_singular_values_do(seed):
    """Rank, null space, shortest least squares: of full rank, of less, of none, wide and tall."""
    rng = np.random.default_rng(seed)
    m, n = rng.integers(0, 25, 2)
    r = int(rng.integers(0, min(m, n) + 1))
    a = rng.normal(size=(m, r)) @ rng.normal(size=(r, n))
    found, known = Triangular(a), decompose(a)
    assert found.rank == known.rank
    rows = found.null_space
    assert rows.shape == (n - found.rank, n)
    assert np.abs(rows @ rows.T - np.eye(len(rows))).max(initial=0.0) < 1e-13
    assert np.abs(a @ rows.T).max(initial=0.0) < 1e-11
    b = rng.normal(size=m)  # which rows that depend on others contradict
    x = found.minimum_norm(b)
    best = np.linalg.pinv(a, rcond=1e-10) @ b if a.size else np.zeros(n)
    assert np.abs(x - best).max(initial=0.0) < 1e-9 * (1.0 + np.abs(best).max(initial=0.0))
    with pytest.raises(SingularError):
        Triangular(np.array([[1.0, np.nan]]))


@pytest.mark.parametrize("k", [1, 3, 4, 7])
def test_several_right_hand_sides_are_columns(k):
    """As many as the rank, too, where columns and singular values could be taken for each other."""
    rng = np.random.default_rng(k)
    found = decompose(rng.normal(size=(6, 3)) @ rng.normal(size=(3, 5)))
    b = rng.normal(size=(6, k))
    each = np.transpose([found.minimum_norm(column) for column in b.T])
    np.testing.assert_allclose(found.minimum_norm(b), each, rtol=1e-12, atol=1e-14)
