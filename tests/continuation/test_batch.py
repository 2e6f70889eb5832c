"""Many configurations and many driver values at once: the same numbers as one at a time."""

from __future__ import annotations

import mechanisms
import numpy as np
import pinocchio as pin
import pytest
from closure_trees import JOINTS, tree_with
from kernel_checks import SEVERAL, assert_same, check_kernel, configurations

import spatial_pin as sp
from spatial_pin.continuation.cursor import Cursor
from spatial_pin.continuation.start import Start
from spatial_pin.kernel.kernel import Kernel

TURN = np.linspace(0.0, 2.0 * np.pi, 500)






# ---------------------------------------------------------------- configurations




@pytest.mark.parametrize("joint", JOINTS)
def test_several_configurations_are_each_pinocchios(tmp_path, joint):
    mechanism, rng = tree_with(tmp_path, joint, ("leaf", "right"), "spherical", 5)
    q = configurations(mechanism, 6)
    check_kernel(mechanism, q)
    steps = rng.uniform(-1.0, 1.0, (mechanism.model.nv, SEVERAL)) * [1.0, 0.1, 1e-4, 1e-9]
    moved = Kernel(mechanism).displaced(q.T, steps.T)
    for k in range(SEVERAL):
        np.testing.assert_allclose(moved[k], pin.integrate(mechanism.model, q[:, k], steps[:, k]),
                                   rtol=0, atol=3e-15)


@pytest.mark.parametrize("name", sp.list_mechanisms())
def test_several_configurations_of_the_library(name):
    mechanism = sp.load(name)
    check_kernel(mechanism, configurations(mechanism, 12))


# ---------------------------------------------------------------- sweeps


def both_ways(monkeypatch, mechanism, values, **keys) -> tuple[sp.Motion, sp.Motion]:
    driver = next(iter(mechanism.drivers))
    together = sp.sweep(mechanism, driver, values, 2.0, 0.3, **keys)
    with monkeypatch.context() as patch:
        patch.setattr(Start, "_path", lambda *_: None)
        return together, sp.sweep(mechanism, driver, values, 2.0, 0.3, **keys)


FULL_TURN = ["crane", "crank_collar", "double_cardan", "four_bar", "geared_five_bar", "hooke_joint",
             "inverted_slider_crank", "oldham", "rspc", "scotch_yoke", "screw_press",
             "slider_crank", "spherical_four_bar", "turntable_collar", "watt_six_bar"]


@pytest.mark.slow
@pytest.mark.parametrize("name", FULL_TURN)
@pytest.mark.parametrize("values", [
    np.sort(np.random.default_rng(1).uniform(0.0, 6.3, 300)),
    np.concatenate([TURN[::2], TURN[::-2], np.repeat(TURN[:20], 2)])],
    ids=["uneven", "to and fro, and every value twice"])
def test_rows_together_are_rows_one_by_one(name, values, monkeypatch):
    together, one_by_one = both_ways(monkeypatch, sp.load(name), values)
    np.testing.assert_array_equal(together.driver, one_by_one.driver)
    for one, other, by in ((together.q, one_by_one.q, 1e-12), (together.v, one_by_one.v, 5e-12),
                           (together.a, one_by_one.a, 1e-10)):
        assert_same(one, other, by)
    assert together.closure_error.max() < 1e-13
    assert [e.kind for e in together.events] == [e.kind for e in one_by_one.events]


@pytest.fixture
def step_by_step(monkeypatch) -> list[float]:
    """The driver values that were followed to step by step, not by the kernel."""
    values, reach = [], Cursor.reach

    def counted(self, target, *given):
        values.append(target)
        return reach(self, target, *given)

    monkeypatch.setattr(Cursor, "reach", counted)
    return values


@pytest.mark.parametrize("name", FULL_TURN)
def test_all_rows_are_followed_by_the_kernel(name, step_by_step):
    mechanism = sp.load(name)
    sp.sweep(mechanism, next(iter(mechanism.drivers)), TURN)
    assert not step_by_step


@pytest.mark.parametrize("size", [1e-9, 1e6])
def test_those_of_small_and_large_mechanisms_too(size, step_by_step):
    mechanism = sp.load("rssr", a=0.102 * size, b=0.381 * size, c=0.254 * size, d=0.314 * size)
    assert sp.sweep(mechanism, "crank", TURN).closure_error.max() < 1e-13
    assert not step_by_step


@pytest.mark.parametrize("turns", [1e3, 1e5, 1e6])
def test_and_those_after_many_turns(turns, step_by_step):
    """As well as angles are known that count them."""
    mechanism = sp.load("four_bar")
    start = sp.assemble(mechanism, {"crank": 0.0}).q
    q = start + 2.0 * np.pi * turns * np.array([1.0, -1.0, 0.0])
    motion = sp.sweep(mechanism, "crank", q[0] + TURN, guess=q)
    assert motion.closure_error.max() < 1e-15 * turns
    assert not step_by_step


@pytest.mark.slow
def test_turns_of_a_screw_closure_are_counted_together(tmp_path, monkeypatch):
    mechanism = mechanisms.press_closure(tmp_path)
    together, one_by_one = both_ways(monkeypatch, mechanism, np.linspace(0.0, 60.0, 800))
    assert_same(together.q, one_by_one.q, 1e-13)
    np.testing.assert_allclose(together.angles, one_by_one.angles, rtol=0, atol=1e-11)


def test_an_end_of_travel_is_found_from_rows_together(monkeypatch):
    mechanism = sp.load("elliptic_trammel")
    reached = []
    for possible in (True, False):
        with monkeypatch.context() as patch:
            if not possible:
                patch.setattr(Start, "_path", lambda *_: None)
            with pytest.raises(sp.LimitError) as caught:
                sp.sweep(mechanism, "slider", np.linspace(0.0, 0.6, 900))
        reached.append((caught.value.limit, len(caught.value.motion)))
    assert reached[0][0] == pytest.approx(reached[1][0], abs=1e-13)
    assert reached[0][1] == reached[1][1]


@pytest.mark.parametrize("name", ["rssr", "rssr_crossed", "swash_plate"])
def test_a_passive_spin_does_not_depend_on_the_rows(name):
    mechanism = sp.load(name)
    driver = next(iter(mechanism.drivers))
    fine = sp.sweep(mechanism, driver, np.linspace(0.0, 2.0 * np.pi, 3001))
    coarse = sp.sweep(mechanism, driver, np.linspace(0.0, 2.0 * np.pi, 301))
    assert_same(coarse.q, fine.q[::10], 1e-11)


@pytest.mark.parametrize("name", ["rssr", "rssr_crossed", "swash_plate"])
@pytest.mark.parametrize("rows", [[0, 3000], [0, 400, 401, 1900, 3000], range(0, 3001, 200),
                                  [0, 1700, 1300, 2800]])
def test_a_passive_spin_is_exact_however_few_the_rows_are(name, rows):
    """Over one row of a whole turn, too."""
    mechanism = sp.load(name)
    driver = next(iter(mechanism.drivers))
    fine = sp.sweep(mechanism, driver, np.linspace(0.0, 2.0 * np.pi, 3001))
    rows = list(rows)
    assert_same(sp.sweep(mechanism, driver, fine.driver[rows]).q, fine.q[rows], 1e-10)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10, 1e-13, 1e-15])
@pytest.mark.parametrize("name", ["bennett", "bricard", "sarrus", "rssr", "swash_plate"])
def test_any_tolerance_follows_the_branch(name, tolerance):
    """Loops with redundant rows are closed to 1e-12 whatever is asked: open ones hide them."""
    mechanism = sp.load(name)
    driver = next(iter(mechanism.drivers))
    values = sp.assemble(mechanism).coordinate(driver).value + np.linspace(0.0, 1.0, 300)
    motion = sp.sweep(mechanism, driver, values, accuracy=sp.Accuracy(tolerance=tolerance))
    exact = sp.sweep(mechanism, driver, values)
    assert motion.closure_error.max() <= max(tolerance, 2e-15)
    assert_same(motion.q, exact.q, max(10 * tolerance, 1e-12))


@pytest.mark.parametrize("rows", [60, 361, 2000])
@pytest.mark.parametrize("begin", [0.4, 0.8, 1.3])
def test_branches_that_cross_twice_at_one_place_are_not_passed_unnoticed(rows, begin):
    """Sarrus' linkage lies flat at 0 and π/2: the determinant keeps its sign there."""
    mechanism = sp.load("sarrus")
    for end, crossing in ((-2.0, 0.0), (2.5, np.pi / 2)):
        motion = sp.sweep(mechanism, "arm", np.linspace(begin, end, rows), on_crossing="stop")
        assert [e.kind for e in motion.events] == ["branch point"]
        assert motion.events[0].value == pytest.approx(crossing, abs=1e-9)
        assert abs(motion.driver[-1] - crossing) < 1.01 * abs(begin - end) / (rows - 1)


def test_a_state_as_guess_says_where_the_other_drivers_are_held():
    """Not only where the first value is the state's own."""
    mechanism = sp.load("stewart")
    state = sp.assemble(mechanism)
    here = state.coordinate("leg_1").value
    for first in (here, here + 0.01):
        motion = sp.sweep(mechanism, "leg_1", [first, here + 0.02], guess=state)
        for leg in list(mechanism.drivers)[1:]:
            assert motion.coordinate(leg).value == pytest.approx(state.coordinate(leg).value)
    motion = sp.sweep(mechanism, "leg_1", [here], guess=state, hold={"leg_2": here + 0.01})
    assert motion.coordinate("leg_2").value == pytest.approx(here + 0.01)
