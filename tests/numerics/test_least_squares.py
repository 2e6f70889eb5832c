"""Least squares on constraints and between bounds, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from spatial_pin.numerics.least_squares import LeastSquares, minimised


class Valley(LeastSquares):
    """Rosenbrock's curved valley, the unknowns between bounds."""

    def __init__(self, low, high, bends):
        self.moves, self.bends = np.ones(2, dtype=bool), bends
        self.ends = np.array([low, high])

    def residual(self, x):
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])

    def jacobian(self, x):
        return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


@pytest.mark.parametrize("bends", [True, False])
def test_the_end_of_a_curved_valley_is_found(bends):
    found = minimised(Valley([-9.0, -9.0], [9.0, 9.0], bends), np.array([-1.2, 1.0]), {})
    assert found.at.x == pytest.approx([1.0, 1.0], abs=1e-12)
    assert found.has_ended and not found.active


@pytest.mark.parametrize("bends", [True, False])
@pytest.mark.parametrize(("high", "best"), [
    ([0.5, 9.0], [0.5, 0.25]),  # along the bound the valley's middle
    ([9.0, 9.0], [1.0, 1.0]),
])
def test_at_a_bound_the_other_unknowns_are_the_best(bends, high, best):
    found = minimised(Valley([-2.0, -2.0], high, bends), np.array([-1.2, 1.0]), {})
    assert found.at.x == pytest.approx(best, abs=1e-9)
    assert found.active == ({0: 1} if high[0] < 1.0 else {})


def test_a_bound_that_is_active_at_the_start_is_left_where_that_goes_down():
    found = minimised(Valley([-2.0, -2.0], [9.0, 9.0], True), np.array([-2.0, 1.0]), {0: 0})
    assert found.at.x == pytest.approx([1.0, 1.0], abs=1e-12) and not found.active


class OnSphere(LeastSquares):
    """A point of the unit sphere that is to be near to another one."""

    def __init__(self, goal):
        self.moves, self._goal = np.ones(3, dtype=bool), np.array(goal)

    def residual(self, x):
        return x - self._goal

    def jacobian(self, x):
        return np.eye(3)

    def constraints(self, x):
        return 2.0 * x[None]

    def corrected(self, x, free, off):
        return x / np.linalg.norm(x)


@pytest.mark.parametrize("goal", [[2.0, 0.0, 0.0], [0.3, -0.2, 0.1], [1e-3, 0.0, 0.0]])
@pytest.mark.parametrize("start", [[0.0, 0.6, 0.8], [-1.0, 0.0, 0.0], [-0.6, 0.0, 0.8]])
def test_the_nearest_point_of_a_sphere_is_found_from_the_farthest_too(goal, start):
    """Where the sum is greatest its slope is zero as well: the curvature leads away."""
    found = minimised(OnSphere(goal), np.array(start), {})
    assert found.at.x == pytest.approx(np.array(goal) / np.linalg.norm(goal), abs=1e-8)
    assert found.has_ended


def test_what_may_not_move_stays():
    problem = OnSphere([2.0, 0.5, 0.7])
    problem.moves = np.array([True, True, False])
    problem.corrected = lambda x, free, off: np.append(
        x[:2] * np.sqrt(1.0 - x[2] ** 2) / np.linalg.norm(x[:2]), x[2])
    found = minimised(problem, np.array([0.0, 0.8, 0.6]), {})
    assert found.at.x[2] == 0.6
    assert found.at.x[:2] == pytest.approx(0.8 * np.array([2.0, 0.5]) / np.hypot(2.0, 0.5))


def test_steps_that_run_out_are_reported():
    problem = Valley([-9e3, -9e3], [9e3, 9e3], False)
    problem.most = 2
    found = minimised(problem, np.array([-900.0, 8e5]), {})
    assert not found.has_ended
