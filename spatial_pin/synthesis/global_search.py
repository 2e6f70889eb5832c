"""Global search of a synthesis problem: local solutions from many starts, ranked."""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import fields, is_dataclass
from errno import ENOENT
from functools import lru_cache
from pathlib import Path, PurePath
from threading import get_ident
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import whole_number
from spatial_pin._support.output_files import named_path, write_text
from spatial_pin._support.progress import in_order, progress_bar
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mobility.mobility import mobility
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.curve_atlas import BATCHES, AtlasStart, CurveDatabase
from spatial_pin.synthesis.design_problem import DesignProblem, LocalSolution, ProblemSpec
from spatial_pin.synthesis.inner_problem import GoalStates

FORMAT = "spatial_pin design 2"
PAUSE = 1.0  # least time between two writings of the file [s]: one takes some milliseconds


class Checkpoint:
    """Results of a search so far, in a file from which the search can resume.

    These are solutions by number of the start, and the costs of an evolution in their order. The
    file is written about once a second and at the end, also after an error.

    Args:
        key: fingerprint of the search.
        path: of the file; None: no file.
    """

    def __init__(self, key: str, path: str | Path | None) -> None:
        self.key, self.path = key, None if path is None else named_path(path)
        self.solutions: dict[int, LocalSolution] = {}
        self.values: list[float] = []
        self._written, self._is_new = monotonic(), False
        if self.path is not None and self.path.exists():
            self._read(self.path)
        elif self.path is not None and not self.path.parent.is_dir():
            raise FileNotFoundError(ENOENT, "there is no folder for the file to resume from",
                                    str(self.path))

    def __enter__(self) -> Checkpoint:
        return self

    def __exit__(self, *error: object) -> None:
        self._write()

    def add(self, number: int, solution: LocalSolution) -> None:
        """Record the solution of a start."""
        self.solutions[number] = solution
        self._changed()

    def add_values(self, values: Sequence[float]) -> None:
        """Record costs of the evolution."""
        self.values += values
        self._changed()

    def _changed(self) -> None:
        self._is_new = True
        if monotonic() - self._written > PAUSE:
            self._write()

    def _write(self) -> None:
        if self.path is None or not self._is_new:
            return
        content = {"format": FORMAT, "key": self.key, "values": self.values,
                   "found": {str(k): _table(x) for k, x in sorted(self.solutions.items())}}
        write_text(self.path, json.dumps(content) + "\n")
        self._written, self._is_new = monotonic(), False

    def _read(self, path: Path) -> None:
        words = f"{path}: not a search for dimensions that was kept; give another file to `resume`"
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["format"] != FORMAT:
                raise SpatialPinError(words)
            key = content["key"]
            self.values = [float(x) for x in content["values"]]
            self.solutions = {int(k): _solution(x) for k, x in content["found"].items()}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise SpatialPinError(words) from error
        if key != self.key:
            raise SpatialPinError(
                f"{path}: a search with another mechanism, other goals, bounds, guess, method or "
                "seed; give another file to `resume`, or remove this one")


def _table(solution: LocalSolution) -> dict[str, Any]:
    return {"x": solution.x.tolist(), "cost": solution.cost, "hard": solution.hard,
            "evaluations": solution.evaluations, "why": solution.why,
            "others": [_table(one) for one in solution.others],
            "samples": [{"q": s.q.tolist(), "angles": s.angles.tolist(), "at": s.at.tolist()}
                        for s in solution.samples]}


def _solution(table: Mapping[str, Any]) -> LocalSolution:
    samples = tuple(
        GoalStates(_rows(s["q"], len(s["at"])), _rows(s["angles"], len(s["at"])),
                np.array(s["at"], dtype=np.intp))
        for s in table["samples"])
    return LocalSolution(
        np.array(table["x"], dtype=float), float(table["cost"]), float(table["hard"]), samples,
        int(table["evaluations"]), str(table["why"]),
        tuple(_solution(one) for one in table["others"]))


def _rows(values: Any, n: int) -> Array:
    return np.array(values, dtype=float).reshape(n, -1)


def fingerprint(spec: Any, mechanism: Mechanism, method: str, seed: int) -> str:
    """Return a text that is equal for two searches only if they are the same search."""
    files = [path.read_bytes() for path in (mechanism.path, mechanism.tree)
             if isinstance(path, Path) and path.is_file()]
    text = json.dumps([FORMAT, method, seed, _plain(spec)], sort_keys=True)
    digest = hashlib.sha256(text.encode())
    for content in files:
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    """Return a value as texts, numbers, lists and tables."""
    if is_dataclass(value) and not isinstance(value, type):
        own = {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
        return [type(value).__name__, own]
    if isinstance(value, Mapping):
        return [[_plain(k), _plain(x)] for k, x in sorted(value.items(), key=lambda x: str(x[0]))]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, pin.SE3):
        return value.homogeneous.tolist()
    if isinstance(value, State):
        return [value.q.tolist(), value.angles.tolist()]
    if isinstance(value, PurePath):
        return value.name
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(x) for x in value]
    with suppress(TypeError):
        return json.loads(json.dumps(value))
    return [type(value).__name__, _plain(vars(value))]


METHODS = ("multistart", "evolution", "atlas", "local")
# Two solutions are equal if no dimension differs by more, relative to the width of its bounds, and
# no joint, in radians and characteristic lengths. In flat valleys local fits end some 1e-5 from the
# solution.
SAME_SOLUTION = 1e-3
# Members of the population per unknown. The evolution only has to find valleys; local fits follow.
# 3 members and 15 generations found as much as 5 and 30 for straight-line four-bars; a member costs
# about a tenth of a local fit.
POPULATION = 4
GENERATIONS = 20  # see above
OTHER_VALLEY = 0.1  # fraction of the ranges: points farther apart count as two valleys
RANGE_DRAWS = 256  # starts whose spread is the range of an unknown without bounds
VALUES_TOGETHER = 16  # members of a population that a worker gets at a time


class Searched(NamedTuple):
    """The result of a search."""

    solutions: tuple[LocalSolution, ...]  # distinct solutions, the best first
    is_whole: bool  # whether all starts were tried: False after Ctrl-C
    starts: int  # local fits
    failed: int  # local fits without a solution
    evaluations: int  # sets of dimensions tried in all
    # smallest error of exact goals among failed fits [characteristic lengths, rad]; infinite if no
    # loops closed
    nearest: float
    why: str = ""  # error message of the first fit that stopped with one


def searched(
    spec: ProblemSpec,
    method: str = "multistart",
    starts: int = 20,
    seed: int = 0,
    executor: Executor | None = None,
    progress: bool = False,
    resume: str | Path | None = None,
) -> Searched:
    """Return local solutions of a problem, ranked and distinct.

    The result depends on the problem, the method, the seed and the number of starts only, not on
    the number of workers or on interruptions. Every start has its own random numbers, so that more
    starts find at least as much.
    """
    if method not in METHODS:
        raise ValueError(f"method is {method!r}; it is one of {', '.join(METHODS)}")
    starts = whole_number(starts, "starts")
    if starts < 1:
        raise ValueError(f"starts is {starts}; a search needs 1 at least")
    if seed < 0:
        raise ValueError(f"seed is {seed}; it is a whole number from 0 up")
    problem = spec.make()
    with Checkpoint(fingerprint(spec, problem.mechanism, method, seed), resume) as checkpoint:
        work = GlobalSearch(spec, problem, executor, checkpoint)
        is_whole = False
        try:
            work.run(method, 1 if method == "local" else starts, seed, progress)
            is_whole = True
        except KeyboardInterrupt:  # the result has the designs until then
            if not checkpoint.solutions:
                raise
    tried = [checkpoint.solutions[k] for k in sorted(checkpoint.solutions) if k < starts]
    own = [x for one in tried for x in (one, *one.others) if x.is_one]
    failed = [x for x in tried if not x.is_one]
    return Searched(tuple(_distinct(problem, own)), is_whole, len(tried), len(failed),
                    sum(x.evaluations for x in tried) + len(checkpoint.values) + work.curves,
                    min((x.hard for x in failed), default=np.inf),
                    next((x.why for x in tried if x.why), ""))


class GlobalSearch:
    """One search, with its results in a checkpoint.

    Attributes:
        curves: sets of dimensions drawn for the atlas.
    """

    def __init__(
        self, spec: ProblemSpec, problem: DesignProblem, executor: Executor | None,
        checkpoint: Checkpoint,
    ) -> None:
        self._spec, self._problem = pickle.dumps(spec), problem
        self._executor, self._checkpoint, self.curves = executor, checkpoint, 0

    def run(self, method: str, starts: int, seed: int, progress: bool) -> None:
        """Compute the solutions that are not in the checkpoint."""
        seeds = np.random.SeedSequence(seed).spawn(starts)
        if method == "evolution":
            starting_points = self._evolved(np.random.default_rng(seed), starts, progress)
            jobs: list[tuple[Array | AtlasStart | None, Any]] = [(x, None) for x in starting_points]
        elif method == "atlas":
            atlas = CurveDatabase(self._problem)  # refuses what it is not for
            begins = list[AtlasStart]()
            name = f"{self._problem.mechanism.name}: atlas"
            with progress_bar(BATCHES, name, progress) as bar:
                for batch in self._all(_batch, np.random.SeedSequence(seed).spawn(BATCHES)):
                    begins += batch
                    self.curves += atlas.curves
                    bar.update()
            begins = sorted(begins, key=lambda begin: begin.misfit)[:starts]
            jobs = [*((x, None) for x in begins), *((None, x) for x in seeds[len(begins) :])]
        else:
            jobs = [(None, child if k else None) for k, child in enumerate(seeds)]
        rest = [k for k in range(len(jobs)) if k not in self._checkpoint.solutions]
        name = f"{self._problem.mechanism.name}: starts"
        with progress_bar(len(jobs), name, progress) as bar:
            bar.update(len(jobs) - len(rest))
            for k, solution in zip(rest, self._all(_solved, [jobs[k] for k in rest]), strict=True):
                self._checkpoint.add(k, solution)
                bar.update()

    def _all(self, work: Callable[..., Any], jobs: Sequence[Any]) -> Iterator[Any]:
        """Return the results of jobs in their order, from this process or the executor."""
        if self._executor is None:
            return in_order(None, work, [(self._problem, job) for job in jobs])
        return in_order(self._executor, _in_worker,
                        [(work, self._spec, job) for job in jobs])

    def _evolved(self, rng: np.random.Generator, starts: int, progress: bool) -> list[Array]:
        """Return the best points of an evolution, far from each other.

        A resumed evolution repeats itself with the recorded costs.
        """
        from scipy.optimize import differential_evolution  # it takes a quarter of a second

        draws = np.random.default_rng(0)
        drawn = np.array([self._problem.draw(draws) for _ in range(RANGE_DRAWS)])
        low, high = self._problem.lower, self._problem.upper
        low = np.where(np.isfinite(low), low, drawn.min(axis=0))
        high = np.where(np.isfinite(high), high, drawn.max(axis=0))
        candidates: list[Array] = []

        def values(points: list[Array]) -> list[float]:
            known = self._checkpoint.values[len(candidates) : len(candidates) + len(points)]
            rest = [low + u * (high - low) for u in points[len(known) :]]
            groups = [rest[k : k + VALUES_TOGETHER] for k in range(0, len(rest), VALUES_TOGETHER)]
            new = [x for some in self._all(_valued, groups) for x in some]
            self._checkpoint.add_values(new)
            candidates.extend(np.array(u) for u in points)
            bar.update()
            return [*known, *new]

        name = f"{self._problem.mechanism.name}: evolution"
        with progress_bar(GENERATIONS + 1, name, progress) as bar:
            differential_evolution(
                lambda u: np.inf,  # never called: populations are valued by the workers
                [(0.0, 1.0)] * len(low), popsize=POPULATION, maxiter=GENERATIONS,
                polish=False, seed=rng, updating="deferred",
                workers=lambda _, points: values(list(points)))
        best = _apart(np.array(candidates), np.array(self._checkpoint.values), starts)
        return [low + u * (high - low) for u in best]


def _apart(candidates: Array, values: Array, most: int) -> list[Array]:
    """Return the best of points (m, n) between 0 and 1 that are not near a better one."""
    order = np.flatnonzero(np.isfinite(values))
    order = order[np.argsort(values[order], kind="stable")]
    apart: list[Array] = []
    while order.size and len(apart) < most:
        best = candidates[order[0]]
        apart.append(best)
        order = order[np.abs(candidates[order] - best).max(axis=1) > OTHER_VALLEY]
    return apart


def _in_worker(work: Callable[..., Any], spec: bytes, job: Any) -> Any:
    """Do a job in another process or thread, which builds the problem once."""
    return work(_made(spec, get_ident()), job)


@lru_cache(maxsize=8)
def _made(spec: bytes, thread: int) -> DesignProblem:
    problem: DesignProblem = pickle.loads(spec).make()
    return problem


def _batch(problem: DesignProblem, seed: np.random.SeedSequence) -> list[AtlasStart]:
    return CurveDatabase(problem).batch(np.random.default_rng(seed))


def _solved(
    problem: DesignProblem, job: tuple[Array | AtlasStart | None, np.random.SeedSequence | None]
) -> LocalSolution:
    """Return the local solution from x, a curve, a random start, or the nominal dimensions."""
    x, seed = job
    if isinstance(x, AtlasStart):
        return CurveDatabase(problem).solved(x)
    if seed is not None:
        rng = np.random.default_rng(seed)
        return problem.solve(problem.draw(rng), rng)
    return problem.solve(problem.start if x is None else x, None)


def _valued(problem: DesignProblem, points: Sequence[Array]) -> list[float]:
    """Return costs of points; infinite where there is none."""
    values = [np.inf] * len(points)
    for k, x in enumerate(points):
        with suppress(SpatialPinError):
            value = float(problem.value(x))
            values[k] = np.inf if np.isnan(value) else value
    return values


def _distinct(problem: DesignProblem, solutions: Sequence[LocalSolution]) -> list[LocalSolution]:
    """Return distinct solutions, the best first.

    Solutions with round-off errors are equally good and keep the order of their starts. Angles of
    links that spin freely do not count.
    """
    best = sorted(solutions, key=lambda one: max(one.cost, TOLERANCES.nothing**2))
    mechanism, links = problem.mechanism, set[str]()
    if len(best) > 1:
        with suppress(SpatialPinError):  # it does not close at its own dimensions: all links count
            links = {freedom.link for freedom in mobility(mechanism).passive}
    spinning = {mechanism.model.names[
        mechanism.model.frames[mechanism.frame_id(name)].parentJoint] for name in links}
    distinct: list[tuple[Array, LocalSolution]] = []
    for one in best:
        mark = _signature(problem, one, spinning)
        if all(np.abs(mark - other).max(initial=0.0) > SAME_SOLUTION for other, _ in distinct):
            distinct.append((mark, one))
    return [one for _, one in distinct]


def _signature(problem: DesignProblem, solution: LocalSolution, spinning: set[str]) -> Array:
    """Return numbers that differ between distinct solutions, but not by whole turns."""
    mechanism, model = problem.mechanism, problem.mechanism.model
    parts: list[Array] = [np.array([x / size for name, x, size in zip(
        problem.names, solution.x.tolist(), problem.sizes.tolist(), strict=True)
        if ": " not in name])]
    for samples in solution.samples:
        for c in mechanism.coordinate_table.values():
            if c.q >= 0 and c.joint not in spinning:
                value = samples.q[:, c.q]
                parts += ([np.cos(value), np.sin(value)] if c.unit == "rad" else
                          [value / mechanism.characteristic_length])
        for i, name in enumerate(mechanism.pairs, start=1):
            if not PAIRS[name].is_linear and model.names[i] not in spinning:
                end = model.idx_qs[i] + model.nqs[i]
                turn = samples.q[:, end - 4 : end]
                parts.append(np.einsum("mi,mj->mij", turn, turn).ravel())
    return np.concatenate(parts)
