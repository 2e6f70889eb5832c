"""Inside of continuation: what is followed step by step, and where matrices are singular."""

from __future__ import annotations

import mechanisms
import numpy as np
import published_models as models
import pytest
from kernel_checks import assert_same
from loaded_library import library
from machines import arms, change_points, delta
from mechanisms import KNOWN
from mpmath import mpf
from variety import few

import spatial_pin as sp
from spatial_pin.continuation import singular_points
from spatial_pin.continuation.path_following import both_ways_order
from spatial_pin.continuation.path_tracker import PathTracker
from spatial_pin.continuation.singular_points import zeros
from spatial_pin.view.page.jog import Jog

TURN = np.linspace(0.0, 2.0 * np.pi, 500)
SCATTERED = np.concatenate([[0.3], np.random.default_rng(7).uniform(-2.0, 6.0, 400),
                            [0.3, 6.0, -2.0]])
REACHED = {  # where conditioning allows less
    "tilted slider-crank cut at main pin": 3e-11,
}
FULL_TURN = ["crane", "crank_collar", "double_cardan", "four_bar", "geared_five_bar", "hooke_joint",
             "inverted_slider_crank", "oldham", "rspc", "scotch_yoke", "screw_press",
             "slider_crank", "spherical_four_bar", "turntable_collar", "watt_six_bar"]


# ---------------------------------------------------------------- together, or one by one


def without_kernel(patch: pytest.MonkeyPatch) -> None:
    """Let branches be followed by pseudo-arclength alone."""
    patch.setattr(PathTracker, "from_guess", lambda *_: None)
    patch.setattr(PathTracker, "_path_from", lambda *_, **_keys: None)


def both_ways(monkeypatch, mechanism, values, driver=None, **keys) -> tuple[sp.Motion, sp.Motion]:
    driver = driver or next(iter(mechanism.drivers))
    together = sp.sweep(mechanism, driver, values, 2.0, 0.3, **keys)
    with monkeypatch.context() as patch:
        without_kernel(patch)
        return together, sp.sweep(mechanism, driver, values, 2.0, 0.3, **keys)


@pytest.mark.parametrize("name", few(FULL_TURN, "screw_press"))
@pytest.mark.parametrize("values", [
    np.sort(np.random.default_rng(1).uniform(0.0, 6.3, 300)),
    np.concatenate([TURN[::2], TURN[::-2], np.repeat(TURN[:20], 2)])],
    ids=["uneven", "to and fro, and every value twice"])
def test_rows_together_are_rows_one_by_one(name, values, monkeypatch):
    together, one_by_one = both_ways(monkeypatch, library(name), values)
    np.testing.assert_array_equal(together.driver, one_by_one.driver)
    for one, other, by in ((together.q, one_by_one.q, 1e-12), (together.v, one_by_one.v, 5e-12),
                           (together.a, one_by_one.a, 1e-10)):
        assert_same(one, other, by)
    assert together.closure_error.max() < 1e-13
    assert [e.kind for e in together.events] == [e.kind for e in one_by_one.events]


@pytest.fixture
def step_by_step(monkeypatch) -> list[float]:
    """The driver values that were followed to step by step, not by the kernel."""
    values, reach = [], PathTracker.reach

    def counted(self, target, *given):
        values.append(target)
        return reach(self, target, *given)

    monkeypatch.setattr(PathTracker, "reach", counted)
    return values


@pytest.mark.parametrize("name", few(FULL_TURN, "crane", "four_bar", "geared_five_bar", "rspc",
                                      "screw_press", "spherical_four_bar"))
def test_all_rows_are_followed_by_the_kernel(name, step_by_step):
    mechanism = library(name)
    sp.sweep(mechanism, next(iter(mechanism.drivers)), TURN)
    assert not step_by_step


@pytest.mark.parametrize("size", [1e-9, 1e6])
def test_those_of_small_and_large_mechanisms_too(size, step_by_step):
    mechanism = library("rssr", a=0.102 * size, b=0.381 * size, c=0.254 * size, d=0.314 * size)
    assert sp.sweep(mechanism, "crank", TURN).closure_error.max() < 1e-13
    assert not step_by_step


@pytest.mark.parametrize("turns", [1e3, 1e5, 1e6])
def test_and_those_after_many_turns(turns, step_by_step):
    """As well as angles are known that count them: three, each to half of its last digit."""
    mechanism = library("four_bar")
    start = sp.assemble(mechanism, {"crank": 0.0}).q
    q = start + 2.0 * np.pi * turns * np.array([1.0, -1.0, 0.0])
    motion = sp.sweep(mechanism, "crank", q[0] + TURN, guess=q)
    assert motion.closure_error.max() < 1.5 * np.finfo(float).eps * (2.0 * np.pi * turns)
    assert not step_by_step


@pytest.mark.slow
def test_turns_of_a_screw_closure_are_counted_together(tmp_path, monkeypatch):
    mechanism = mechanisms.press_closure(tmp_path)
    together, one_by_one = both_ways(monkeypatch, mechanism, np.linspace(0.0, 60.0, 800))
    assert_same(together.q, one_by_one.q, 1e-13)
    np.testing.assert_allclose(together.angles, one_by_one.angles, rtol=0, atol=1e-11)


@pytest.mark.delicate
def test_an_end_of_travel_is_found_from_rows_together(monkeypatch):
    mechanism = library("elliptic_trammel")
    reached = []
    for possible in (True, False):
        with monkeypatch.context() as patch:
            if not possible:
                without_kernel(patch)
            with pytest.raises(sp.LimitError) as caught:
                sp.sweep(mechanism, "slider", np.linspace(0.0, 0.6, 900))
        reached.append((caught.value.limit, len(caught.value.motion)))
    assert reached[0][0] == pytest.approx(reached[1][0], abs=1e-13)
    assert reached[0][1] == reached[1][1]


@pytest.mark.slow
@pytest.mark.parametrize("name", KNOWN)
def test_long_runs_are_the_path_by_arc_length(name, tmp_path, monkeypatch):
    mechanism, known = KNOWN[name].build(tmp_path), KNOWN[name]
    values = np.linspace(known.values[0], known.values[-1], 600)
    fast, slow = both_ways(monkeypatch, mechanism, values, known.driver, hold=known.hold)
    determined = set(known.answer(mpf(values[0])).coordinates) & set(mechanism.coordinates)
    for coordinate in determined:
        for one, other in zip(fast.coordinate(coordinate), slow.coordinate(coordinate),
                              strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=30 * REACHED.get(name, 1e-12)
                                       * (1 + np.abs(other).max()))
    assert fast.closure_error.max() < 2e-13
    np.testing.assert_array_equal(fast.driver, slow.driver)


# ---------------------------------------------------------------- order of the values


def counted(monkeypatch):
    """Count the values that a branch is asked to go to one by one."""
    asked, reach = [], PathTracker.reach
    monkeypatch.setattr(PathTracker, "reach", lambda self, s: (asked.append(s), reach(self, s))[1])
    return asked


def test_scattered_values_cost_no_walk_from_each_to_the_next(monkeypatch):
    asked = counted(monkeypatch)
    sp.sweep(library("rssr"), "crank", SCATTERED)
    assert len(asked) < 0.2 * len(SCATTERED)


def test_only_long_ways_are_sorted():
    assert both_ways_order(np.linspace(0.0, 1.0, 50)) is None
    assert both_ways_order(np.linspace(1.0, 0.0, 50)) is None
    assert both_ways_order(np.array([0.0, 1.0, 0.5])) is None
    assert both_ways_order(np.zeros(9)) is None
    values = np.array([0.0, 1.0, -1.0, 1.0, -1.0, 0.5, 0.5, 0.0, -1.0, 1.0])
    up, down = both_ways_order(values)
    assert up.tolist() == [0, 7, 5, 6, 1, 3, 9] and down.tolist() == [8, 4, 2]


# ---------------------------------------------------------------- crossings


@pytest.mark.delicate
def test_where_many_windows_go_flat_is_reported_in_few_steps(monkeypatch):
    """Round-off scatters the many eigenvalues of the place: they are not followed one by one."""
    taken, steps = [], singular_points._Interpolated.steps
    monkeypatch.setattr(singular_points._Interpolated, "steps",
                        lambda curve, place: taken.append(place) or steps(curve, place))
    mech = models.ladder(40)
    upright = {c: 0.5 if c.startswith("pin") else -0.5 for c in mech.coordinates}
    motion = sp.sweep(mech, "pin_0", [0.5, 2.0], guess=upright)
    assert [e.value for e in motion.events] == pytest.approx([np.pi / 2.0], abs=1e-11)
    assert 0 < len(taken) < 200


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 20])
@pytest.mark.parametrize("held", [(0.0, 0.0), (-0.1, 0.2), (-0.2, 0.3), (0.3, -0.3)],
                         ids=["level", "little", "more", "opposite"])  # arms 2 and 3 [rad]
def test_the_delta_robot_moved_by_hand_passes_its_change_points(held, steps):
    robot = library("delta")
    drive = Jog(sp.assemble(robot, {"arm_1": 1.4, **arms(held)}), robot.drivers)
    first, second = change_points(held)
    for value in [*np.linspace(1.4, 2.7, steps + 1)[1:], first, 0.5 * (first + second), second,
                  1.5, 2.7]:
        assert drive.move("arm_1", value) is None
        exact = delta(value, others=held).links["platform"][:3, 3].astype(float)
        np.testing.assert_allclose(drive.state.placement("platform").translation, exact,
                                   atol=1e-11)


# ---------------------------------------------------------------- singular places of matrices

SAMPLES = np.linspace(-0.3, 0.5, 12)


def matrices(values):
    """Matrices (k, n, n) that vary smoothly, singular where a value (k, m) is 0."""
    rng, size = np.random.default_rng(2), values.shape[1] + 4
    left, right, bent = np.eye(size) + rng.uniform(-0.3, 0.3, (3, size, size)) / size**0.5
    middle = np.array([np.diag([*row, 1.0, 2.0, 1.5, 0.7]) for row in values])
    turned = left + 0.2 * np.sin(SAMPLES)[:, None, None] * bent
    return turned @ middle @ right


@pytest.mark.delicate
@pytest.mark.parametrize("fold", [1, 2, 5, 20])
def test_a_place_where_many_ranks_are_lost_keeps_its_digits(fold):
    speeds = np.linspace(0.3, 2.0, fold)
    values = np.sin(SAMPLES - 0.1)[:, None] * speeds
    assert zeros(SAMPLES, matrices(values)) == pytest.approx([0.1], abs=1e-11)


@pytest.mark.delicate
@pytest.mark.parametrize("apart", [0.3, 0.03, 1e-3])
def test_places_where_ranks_are_lost_are_distinguished(apart):
    values = np.stack([np.sin(SAMPLES - x) for x in (0.1, 0.1, 0.1 + apart)], axis=1)
    assert zeros(SAMPLES, matrices(values)) == pytest.approx([0.1, 0.1 + apart], abs=1e-11)


@pytest.mark.delicate
def test_a_place_where_a_matrix_only_touches_singularity_is_found():
    values = np.sin(SAMPLES - 0.1)[:, None] ** 2
    assert zeros(SAMPLES, matrices(values)) == pytest.approx([0.1], abs=1e-6)


def test_matrices_that_are_nowhere_singular_have_no_such_place():
    assert zeros(SAMPLES, matrices(1.0 + SAMPLES[:, None] ** 2)) == []
