"""The KKT system in the kernel: the equations it is to solve, whatever was solved before."""

from __future__ import annotations

import ctypes

import numpy as np
import published_models as models
import pytest
from closure_oracle import Evaluation
from closure_trees import somewhere
from kernel_checks import everything

from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.kernel.kernel import Kernel, address
from spatial_pin.kernel.kkt import KKT
from spatial_pin.kernel.library import BAD_ARRAYS, library
from spatial_pin.mechanism.coordinates import with_values
from spatial_pin.numerics.linalg import rank


def full(mechanism):
    """The KKT system with any mass matrix."""
    nv = mechanism.model.nv
    rows, columns = (x.ravel() for x in np.indices((nv, nv)))
    return KKT(mechanism, (rows, columns, rows * nv + columns))


def masses(mechanism, rng):
    """Some positive definite matrix whose freedoms have inertias of very different sizes."""
    factor = rng.standard_normal((mechanism.model.nv,) * 2)
    units = 10.0 ** rng.uniform(-1, 1, mechanism.model.nv)
    return (factor @ factor.T + np.eye(len(factor))) * np.outer(units, units)


def check(mechanism, kkt, q, rng):
    """All equations hold that the chosen rows are, and the others that depend on them."""
    nv, scale = mechanism.model.nv, mechanism.velocity_scale
    evaluation = Evaluation(constraints_of(mechanism))
    evaluation.update(q)
    n = evaluation.constraints.n_closure
    mass, (v, given, needed) = masses(mechanism, rng), rng.standard_normal((3, nv))
    kkt.mass[:] = mass.ravel()
    a = kkt.accelerations(q, v, evaluation.angle_reference, given, needed).copy()
    jacobian, gamma = evaluation.jacobian[:n].copy(), evaluation.bias(q, v)[:n]
    rows = kkt.rows
    assert kkt.rank == len(rows) == rank(jacobian) == rank(jacobian[rows])
    assert not np.delete(kkt.multipliers, rows).any()
    left = mass @ a - (given - needed) - kkt.closures
    size = max(np.abs(kkt.closures).max(initial=0.0), np.abs(mass @ a).max(), 1.0)
    error = min(kkt.error, 1e-6)
    assert np.abs(left).max() < error * size
    np.testing.assert_allclose((kkt.multipliers @ jacobian) / scale, kkt.closures,
                               atol=1e-12 * size)
    terms = np.abs(jacobian) @ np.abs(a / scale) + np.abs(gamma)
    left = np.abs(jacobian @ (a / scale) + gamma)[rows]
    assert np.all(left < error * terms.max(initial=1.0))
    again, multipliers = kkt.solve((given - needed)[None], gamma[None])
    for x, y in ((again[0], a), (multipliers[0], kkt.multipliers)):
        np.testing.assert_allclose(x, y, atol=error * np.abs(y).max())
    return a, kkt.multipliers.copy()


@pytest.mark.parametrize("seed", range(4))
def test_every_joint_and_closure(tmp_path, seed):
    mechanism, rng = everything(tmp_path, seed), np.random.default_rng(seed)
    check(mechanism, full(mechanism), somewhere(mechanism, rng), rng)


@pytest.mark.delicate
@pytest.mark.parametrize("n", [1, 8, 16, 40])
def test_few_and_many_loops_some_equations_of_which_depend_on_others(n):
    mechanism, rng = models.ladder(n), np.random.default_rng(n)
    values = {c: 0.3 if c.startswith("pin") else -0.3 for c in mechanism.coordinates}
    q = with_values(mechanism, mechanism.neutral, values)
    check(mechanism, full(mechanism), q, rng)


def test_what_was_solved_before_does_not_matter(tmp_path):
    mechanism = everything(tmp_path, 1)
    places = [somewhere(mechanism, np.random.default_rng(k)) for k in range(3)]
    used = full(mechanism)
    for q in places:
        check(mechanism, used, q, np.random.default_rng(5))
    for q in places:
        fresh = check(mechanism, full(mechanism), q, np.random.default_rng(7))
        for x, y in zip(fresh, check(mechanism, used, q, np.random.default_rng(7)), strict=True):
            assert np.array_equal(x, y)


@pytest.mark.parametrize("n", [2, 8, 20, 40])
def test_the_error_is_that_of_the_condition_where_pivots_tell_nothing(n):
    """All pivots of Wilkinson's triangle are 1, the entries of its inverse grow to 2^(n - 2)."""
    bar = models.rod(1.0, models.AXES["x"])
    tree = "".join(models.joint("continuous", f"pin_{i}", f"rod_{i - 1}" if i else "ground",
                                f"rod_{i}", models.AXES["x"], mass=bar) for i in range(n))
    mechanism = models.made("chain", tree, "", (0.0, 0.0, -9.81))
    kkt, none = full(mechanism), np.zeros(n)
    triangle = np.eye(n) - np.triu(np.ones((n, n)), 1)
    kkt.mass[:] = triangle.ravel()
    kkt.accelerations(mechanism.neutral, none, [], none + 1.0, none)
    expected = n * 2.0**-52 * min(np.linalg.cond(triangle, np.inf), 2.0**52)
    assert kkt.pivot == 1.0
    assert expected / 3.0 <= kkt.error <= max(expected, 128 * 2.0**-52) * (1.0 + 1e-9)


@pytest.mark.delicate
def test_a_singular_matrix_says_so():
    mechanism = models.ladder(1)
    kkt, none = full(mechanism), np.zeros(mechanism.model.nv)
    kkt.mass[:] = 0.0
    assert not kkt.accelerations(mechanism.neutral, none, [], none + 1.0, none).any()
    assert kkt.pivot == 0.0 and kkt.error >= 1.0


@pytest.mark.parametrize("wrong", [(0, 1), (1, 2), (2, -1), (3, 99), (4, -1), (5, 4)])
def test_indices_that_do_not_fit_are_refused(wrong):
    """Closures' first equations, then row, column and place of one mass."""
    mechanism = models.ladder(1)
    kernel, handle = Kernel(mechanism), ctypes.c_void_p()
    ints = np.array([0, kernel.n_closure, 2, 2, 2, 3], np.int64)
    at, value = wrong
    ints[[0, 1, 2, 3, 4, 2][at]] = value
    code = library().kkt_create(kernel.handle, address(ints), 1, 1, 3, 1.0, ctypes.byref(handle))
    assert code == BAD_ARRAYS and not handle.value
