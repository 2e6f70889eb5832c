"""Starts from an atlas of curves: published paths of free timing are met better than before."""

import dataclasses
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
import synthesis_forms as forms
from drawing_four_bars import bar, side

import spatial_pin as sp
from spatial_pin.synthesis import atlas, search
from spatial_pin.synthesis.atlas import Atlas
from spatial_pin.synthesis.problem import Problem

goals = sp.goals


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("twelve", 0), ("figure_eight", 0)])
def test_closed_paths_of_free_timing_are_met_better_than_published(problems, name, seed):
    case = forms.CASES[name]
    best = problems[name].solve(starts=8, seed=seed)[0]
    error = forms.free_error(bar(best), case["points"], side(best))  # by closed form
    assert error <= problems[name].error(best) * (1.0 + 1e-6)
    assert error < 0.75 * case["error"]
    assert not [x for x in best.defects if x.kind in ("circuit", "branch", "order")]


# ---------------------------------------------------------------- small atlases


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(atlas, "CURVES", 300)
    monkeypatch.setattr(search, "SHEETS", 2)


LINKS = {"r1": (0.2, 0.5), "r2": (0.05, 0.2), "r3": (0.1, 0.5), "r4": (0.1, 0.5)}


def drawn(k=12, **dimensions):
    """Return points that the middle of a four-bar's coupler passes."""
    mechanism = four_bar(**dimensions)
    motion = sp.sweep(mechanism, "crank", 0.4 + 2.0 * np.pi * np.arange(k) / k)
    return motion.frame("tracer").position


def four_bar(**dimensions):
    return sp.load(forms.DATA / "four_bar_path.toml", **dimensions)


TRUE = {"r1": 0.32, "r2": 0.12, "r3": 0.30, "r4": 0.27, "cx": 0.15, "cy": 0.1}
FREE = {**LINKS, "cx": (-0.3, 0.3), "cy": (-0.3, 0.3)}


def path(points, **options):
    return goals.path("tracer", points, closed=True, **options)


@pytest.mark.slow
def test_a_drawing_of_any_place_and_size_is_met(small):
    """Its own numbers take it to the curve: no dimension moves that as a whole."""
    points = 40.0 * drawn(**TRUE)[:, [1, 0, 2]] * [1.0, -1.0, 1.0] + [3.0, 5.0, 0.0]
    best = sp.design(four_bar(), path(points, placement=True, scale=True), FREE, starts=6,
                     method="atlas")[0]
    assert best.error < 1e-3
    assert all(low <= best.dimensions[name] <= high for name, (low, high) in FREE.items())


def test_how_dimensions_move_a_curve_as_a_whole_is_found_out(small):
    """Pivots and the angle of the ground do, and all lengths together scale it."""
    points = drawn(**TRUE)
    for more, shifts, turns, scale in (
            ({}, [False] * 3, [False] * 3, True),
            ({"x0": (-1.0, 1.0)}, [True, False, False], [False] * 3, True),
            ({"x0": (-1.0, 1.0), "y0": (-1.0, 1.0), "theta0": (0.0, 6.28)},
             [True, True, False], [False, False, True], True)):
        names = FREE | more
        problem = Problem(four_bar(), [path(points)], names)
        one = Atlas(problem)
        x, samples, _ = one._curves(np.array([problem.draw(np.random.default_rng(k))
                                              for k in range(60)]), np.random.default_rng(0))
        found = one._movable(x[0], [s.taken(slice(0, 1)) for s in samples[:-1]])
        assert (found.shifts.tolist(), found.turns.tolist()) == (shifts, turns)
        assert found.scale == (scale and {"x0", "y0"} <= names.keys())


def test_begins_are_at_the_path_within_bounds(small):
    points = drawn(**TRUE) + np.array([0.2, -0.1, 0.0])
    names = FREE | {"x0": (-1.0, 1.0), "y0": (-1.0, 1.0), "theta0": (-3.2, 3.2)}
    problem = Problem(four_bar(), [path(points)], names)
    found = Atlas(problem).sheet(np.random.default_rng(1))
    assert found and all(a.misfit <= b.misfit for a, b in pairwise(found))
    size = np.linalg.norm(points - points.mean(axis=0))
    for begin in found:
        assert ((problem.lower <= begin.x) & (begin.x <= problem.upper)).all()
        one = Atlas(problem)
        there = one._points(one._same(begin.x, len(points)), begin.samples)
        assert np.linalg.norm(there - points) / size < 1.5 * begin.misfit + 0.1


def test_the_answer_does_not_depend_on_the_workers(small):
    asked = dataclasses.replace(path(drawn(**TRUE)[:8]), closed=False)
    mechanism = four_bar()

    def found(executor=None):
        return sp.design(mechanism, asked, {"r2": (0.05, 0.2), "cx": (0.0, 0.3)}, starts=2,
                         method="atlas", executor=executor)

    with ProcessPoolExecutor(2) as executor:
        assert str(found(executor)) == str(found())


def test_more_starts_than_curves_are_drawn_ones(small, monkeypatch):
    monkeypatch.setattr(atlas, "MOST_BROUGHT", 0)
    found = sp.design(four_bar(), path(drawn(**TRUE)), {"r2": (0.05, 0.2)}, starts=2,
                      method="atlas")
    assert found.starts == 2 and found.evaluations > 2 * 300


# ---------------------------------------------------------------- what it is not for


@pytest.mark.parametrize(("asked", "mechanism", "says"), [
    (goals.turns(), four_bar, "one path of free timing through 4 points or more; there are 0"),
    (goals.path("tracer", np.eye(3)), four_bar, "there are 0"),
    (goals.path("tracer", np.ones((5, 3))), four_bar, "its points are all at one place"),
    (goals.path("tracer", np.eye(5, 3), {"crank": np.arange(5.0)}), four_bar,
     "there are 0"),
    (goals.path("bucket", np.eye(5, 3)), lambda: sp.load("excavator"),
     "needs one driver that turns; mechanism 'excavator' has"),
])
def test_other_goals_are_refused_before_the_work(asked, mechanism, says):
    there = mechanism()
    with pytest.raises(ValueError) as told:
        sp.design(there, asked, list(there.dimensions)[:1], method="atlas")
    assert says in str(told.value)
