"""The search for dimensions on problems whose solutions are known."""

import json
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

import spatial_pin as sp
from spatial_pin.synthesis.design_problem import LocalSolution
from spatial_pin.synthesis.global_search import SAME_SOLUTION, searched
from spatial_pin.synthesis.inner_problem import GoalStates

# the four minima of Himmelblau's function, all zero, and those of one with a little slope beside
MINIMA = np.array([[3.0, 2.0], [-2.805118, 3.131312], [-3.779310, -3.283186],
                   [3.584428, -1.848126]])
WIDTH = 12.0


@cache
def four_bar():
    return sp.load("four_bar")


class Himmelblau:
    """Two numbers in place of dimensions, without samples."""

    def __init__(self, spec):
        self.spec = spec
        self.mechanism = four_bar()
        self.names = ("x", "y")
        self.lower, self.upper = np.full(2, -6.0), np.full(2, 6.0)
        self.sizes, self.start = np.full(2, WIDTH), np.zeros(2)

    def draw(self, rng):
        return rng.uniform(self.lower, self.upper)

    def residual(self, z):
        x, y = z
        return np.array([x * x + y - 11.0, x + y * y - 7.0, self.spec.slope * (x - 3.0)])

    def value(self, x):
        if x[0] < -5.9:
            raise sp.SpatialPinError("nothing closes there")
        return float(np.sum(self.residual(x) ** 2))

    def solve(self, x, rng=None):
        if self.spec.interrupt_at is not None and np.allclose(x, self.spec.interrupt_at):
            raise KeyboardInterrupt
        found = least_squares(self.residual, x, bounds=(self.lower, self.upper), xtol=1e-15,
                              ftol=1e-15, gtol=1e-15)
        if found.optimality > 1e-6:
            return LocalSolution(x, np.inf, np.inf, (), found.nfev)
        x, cost = found.x, float(2.0 * found.cost)
        samples = GoalStates(np.array([[x[0], 0.0, self.spec.turns * 2 * np.pi]]), np.zeros((1, 0)),
                          np.zeros(1, dtype=np.intp))
        return LocalSolution(x, cost, 0.0, (samples,), found.nfev)


@dataclass(frozen=True)
class Spec:
    slope: float = 0.1
    turns: int = 0
    interrupt_at: tuple[float, float] | None = None

    def make(self):
        return Himmelblau(self)


class Later(Executor):
    """Does what it is given when it is asked for."""

    def submit(self, work, /, *args):
        future = Future()
        future.set_result(work(*args))
        return future


def told(result):
    return [(x.x.tolist(), x.cost, x.hard, x.evaluations, [s.q.tolist() for s in x.samples])
            for x in result.solutions]


def test_all_minima_are_found_once_the_best_first():
    result = searched(Spec(), starts=40)
    assert len(result.solutions) == 4 and result.is_whole and result.starts == 40
    found = np.array([x.x for x in result.solutions])
    assert result.solutions[0].x == pytest.approx(MINIMA[0], abs=1e-9)
    gaps = np.linalg.norm(found[:, None] - MINIMA, axis=2)
    assert sorted(gaps.argmin(axis=1)) == [0, 1, 2, 3] and gaps.min(axis=1).max() < 0.05
    costs = [x.cost for x in result.solutions]
    assert costs == sorted(costs)
    assert result.failed < 20 and result.evaluations > 40


def test_the_local_search_is_the_start_of_the_mechanism_alone():
    result = searched(Spec(), method="local", starts=40)
    own = Himmelblau(Spec())
    assert result.starts == 1 and result.solutions[0].x == pytest.approx(own.solve(own.start).x)


@pytest.mark.parametrize("method", ["multistart", "evolution"])
@pytest.mark.parametrize("pool", [lambda: ThreadPoolExecutor(3), Later,
                                  lambda: ProcessPoolExecutor(2)])
def test_the_answer_is_the_same_wherever_it_is_worked_out(method, pool):
    here = searched(Spec(), method, starts=6, seed=3)
    with pool() as executor:
        there = searched(Spec(), method, starts=6, seed=3, executor=executor)
    assert told(here) == told(there) and here[1:] == there[1:]


def test_more_starts_find_at_least_as_much():
    few, more = (searched(Spec(), starts=n, seed=5).solutions for n in (4, 12))
    assert len(few) < len(more)
    for one in few:
        assert min(np.abs(one.x - x.x).max() for x in more) < 1e-6


def test_another_seed_has_other_starts():
    first, second = (searched(Spec(), starts=5, seed=k).evaluations for k in (0, 1))
    assert first != second


def test_an_evolution_finds_the_best():
    result = searched(Spec(), "evolution", starts=8)
    assert result.solutions[0].x == pytest.approx(MINIMA[0], abs=1e-9)
    assert result.solutions[0].cost < 1e-18


@pytest.mark.parametrize("method", ["multistart", "evolution"])
def test_a_search_goes_on_where_it_was_cut_short(tmp_path, method, monkeypatch):
    file = tmp_path / "search.json"
    whole = searched(Spec(), method, starts=8, seed=2)
    solve, value, calls = Himmelblau.solve, Himmelblau.value, []

    def cut(self, x, *rest):
        calls.append(x)
        if len(calls) > (5 if method == "multistart" else 100):
            raise KeyboardInterrupt
        return (solve if rest or method == "multistart" else value)(self, x, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(Himmelblau, "solve" if method == "multistart" else "value", cut)
        if method == "multistart":
            part = searched(Spec(), method, starts=8, seed=2, resume=file)
            assert not part.is_whole and part.starts == 5
        else:
            with pytest.raises(KeyboardInterrupt):
                searched(Spec(), method, starts=8, seed=2, resume=file)
    kept = json.loads(file.read_text())
    assert (len(kept["found"]), bool(kept["values"])) == ((5, False) if method == "multistart"
                                                          else (0, True))
    calls.clear()
    monkeypatch.setattr(Himmelblau, "solve", lambda *x: calls.append(x) or solve(*x))
    again = searched(Spec(), method, starts=8, seed=2, resume=str(file))
    assert told(again) == told(whole) and again[1:] == whole[1:]
    assert len(calls) == (3 if method == "multistart" else whole.starts)
    calls.clear()
    assert told(searched(Spec(), method, starts=8, seed=2, resume=file)) == told(whole)
    assert not calls
    assert [p.name for p in tmp_path.iterdir()] == ["search.json"]


def test_an_interrupt_returns_what_was_found():
    rng = [np.random.default_rng(s) for s in np.random.SeedSequence(0).spawn(9)][4]
    place = tuple(rng.uniform(-6.0, 6.0, 2).tolist())
    result = searched(Spec(interrupt_at=place), starts=9)
    assert not result.is_whole and result.starts == 4 and result.solutions


def test_an_interrupt_before_anything_was_found_is_one():
    with pytest.raises(KeyboardInterrupt):
        searched(Spec(interrupt_at=(0.0, 0.0)), starts=3)


def test_more_starts_go_on_from_fewer(tmp_path):
    file = tmp_path / "search.json"
    searched(Spec(), starts=3, resume=file)
    assert told(searched(Spec(), starts=7, resume=file)) == told(searched(Spec(), starts=7))
    assert told(searched(Spec(), starts=3, resume=file)) == told(searched(Spec(), starts=3))


@pytest.mark.parametrize("change", [{"seed": 1}, {"method": "evolution"}, {"slope": 0.2}])
def test_the_file_of_another_search_is_refused(tmp_path, change):
    file = tmp_path / "search.json"
    searched(Spec(), starts=2, resume=file)
    before = file.read_text()
    spec = replace(Spec(), slope=change.pop("slope", 0.1))
    with pytest.raises(sp.SpatialPinError, match="another mechanism, other goals"):
        searched(spec, starts=2, resume=file, **change)
    assert file.read_text() == before


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"format": "spatial_pin design 2"}', "7",
                                  '{"format": "spatial_pin design 2", "key": "", "values": [],'
                                  ' "found": {"0": {"x": 1}}}'])
def test_a_file_of_something_else_is_refused(tmp_path, text):
    file = tmp_path / "search.json"
    file.write_text(text)
    with pytest.raises(sp.SpatialPinError, match="not a search"):
        searched(Spec(), starts=2, resume=file)
    assert file.read_text() == text


def test_what_cannot_be_is_refused(tmp_path):
    for words, given in (("method is 'best'", {"method": "best"}), ("starts is 0", {"starts": 0}),
                         ("seed is -1", {"seed": -1}), ("this is a folder", {"resume": tmp_path})):
        with pytest.raises(ValueError, match=words):
            searched(Spec(), **given)


def test_turns_of_joints_do_not_make_another_solution(monkeypatch):
    solve = Himmelblau.solve
    monkeypatch.setattr(Himmelblau, "solve", lambda self, x, rng=None: solve(
        Himmelblau(replace(self.spec, turns=int(10 * x[0]))), x, rng))
    assert len(searched(Spec(), starts=40).solutions) == 4


def test_solutions_nearer_than_a_thousandth_of_the_bounds_are_one(monkeypatch):
    solve = Himmelblau.solve
    for away, n in ((0.9, 1), (1.2, 2)):
        monkeypatch.setattr(Himmelblau, "solve", lambda self, x, rng=None, a=away: replace(
            solve(self, np.array([2.9, 2.1])),
            x=MINIMA[0] + (rng is None) * a * SAME_SOLUTION * WIDTH))
        assert len(searched(Spec(), starts=3).solutions) == n


def test_what_was_handed_out_is_called_back_when_it_is_cut_short():
    handed = []

    class Interrupted(Executor):
        def submit(self, work, /, *args):
            if len(handed) == 3:
                raise KeyboardInterrupt
            handed.append(Future())
            return handed[-1]

    with pytest.raises(KeyboardInterrupt):
        searched(Spec(), starts=8, executor=Interrupted())
    assert len(handed) == 3 and all(future.cancelled() for future in handed)
