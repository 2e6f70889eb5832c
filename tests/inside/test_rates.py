"""Inside of rates: rows of many digits, joints taken apart, rotation vectors."""

from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from variety import few

import spatial_pin as sp
from spatial_pin.accuracy.reference import ExactRows
from spatial_pin.constraints.kernel_tree import KernelTree
from spatial_pin.constraints.trees import LargeTree
from spatial_pin.mechanism.coordinates import rotation_vector
from spatial_pin.rates.rates import rate_error


def moving(mechanism):
    """The mechanism's guess, closed, its drivers moving."""
    rng = np.random.default_rng(1)
    speeds, accelerations = (
        {n: x * mechanism.velocity_scale[mechanism.coordinate(n).v]
         for n, x in zip(mechanism.drivers, rng.normal(size=len(mechanism.drivers)), strict=True)}
        for _ in range(2))
    return sp.solve_rates(mechanism, sp.assemble(mechanism), speeds, accelerations)


@pytest.mark.delicate
def test_rates_near_a_crossing_where_nothing_moves_fast_are_as_good_as_reported():
    """Next to the flat place of a Sarrus linkage accelerations lose the third power of a pivot."""
    mech = library("sarrus")
    arm = mech.prescribed_coordinate("arm")
    guess = sp.assemble(mech)
    for angle in np.geomspace(0.3, 1e-3, 12):
        guess = sp.assemble(mech, {"arm": angle}, guess)
        state = sp.solve_rates(mech, guess, {"arm": 1.0})
        rows = ExactRows(mech, [arm], np.array([[angle]]), np.ones(1), np.zeros(1))
        exact = rows.near(state.q[None], np.zeros((1, 0)))
        bend = max(1.0, float(np.abs(exact.a).max()))
        assert np.abs(state.v - exact.v[0]).max() <= state.rate_error * np.abs(exact.v).max()
        assert np.abs(state.a - exact.a[0]).max() <= state.rate_error * bend
    assert 1e-9 < state.rate_error < 1e-5


@pytest.mark.parametrize("first, n", [(0.3, 400), (0.05, 151)])
@pytest.mark.parametrize("name", few(
    ["bennett", "bricard", "four_bar", "rssr"], "bennett", "rssr"))
def test_rates_of_samples_are_as_good_as_reported(name, first, n):
    """Samples are not closed to round-off, nor solved by the equations that are best there."""
    mech = library(name)
    driver = mech.prescribed_coordinate(*mech.drivers)
    values = np.linspace(first, first + 6.2, n)
    motion = sp.sweep(mech, driver.name, values, on_limit="stop")
    n, size = len(motion), mech.velocity_scale
    exact = ExactRows(mech, [driver], values[:n, None], np.ones(n), np.zeros(n)).near(
        motion.q, np.zeros((n, 0)))
    assert n > 50 and exact.good.all()
    v, a = (np.abs(x / size).astype(float) for x in (exact.v, exact.a))
    pace = v.max(axis=1)
    bend = np.maximum(pace**2, a.max(axis=1))
    off = np.maximum(np.abs((motion.v - exact.v) / size).max(axis=1) / pace,
                     np.abs((motion.a - exact.a) / size).max(axis=1) / bend)
    told = np.array([motion.state(k).rate_error for k in range(n)])
    assert np.all(off <= told)
    assert np.median(told) < 2e-14


def test_split_models_move_alike():
    """Universal, cylindrical and planar joints as chains of single ones: same q, v and a."""
    for name in ("stewart", "rspc", "swash_plate", "oldham"):
        mechanism = library(name)
        state, tree = moving(mechanism), LargeTree(mechanism.model)
        tree.move(state.q, state.v, state.a)
        for i in range(1, mechanism.model.njoints):
            np.testing.assert_allclose(tree.data.oMi[i].homogeneous,
                                       state.data.oMi[i].homogeneous, atol=1e-15)
            np.testing.assert_allclose(tree.accelerations[i], state.data.a[i].vector, atol=1e-11)
        assert KernelTree(mechanism.model).arrays.mass.sum() == pytest.approx(
            pin.computeTotalMass(mechanism.model))


def test_where_a_driver_cannot_go_on_no_rates_of_it_are_good():
    mech = library("four_bar")
    limit = sp.limits(mech, "rocker_pin").upper.value
    stretched = sp.State(mech, sp.assemble(mech, {"rocker_pin": limit}).q, closure_error=0.0,
                         rate_error=partial(rate_error, "rocker_pin", True))
    assert np.isnan(stretched.rate_error)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, 3.0, 3.05, 3.1, np.pi - 1e-9])
def test_a_rotation_vector_keeps_its_digits_near_half_a_turn(angle):
    """The logarithm of the matrix would lose three of them there."""
    for sense in (1.0, -1.0):
        axis = np.array([0.48, -0.6, 0.64])
        quaternion = sense * np.append(np.sin(angle / 2) * axis, np.cos(angle / 2))
        np.testing.assert_allclose(rotation_vector(quaternion), angle * axis, rtol=0.0, atol=1e-15)
