"""Starts for paths with free timing: an atlas of coupler curves.

Random dimensions give closed curves while the driver turns. Curves with a part that is similar to
the path are selected (see `numerics.curve_matching`); their place and size count only where the
dimensions cannot change them. A homotopy moves each selected curve to the path. Local fits start
there, with configurations in the right order on one branch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.dimensions.variants import DimensionBatch, Variants
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.curve_matching import lengths_along, matches
from spatial_pin.numerics.linalg import Array, pseudo_inverses
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.design_problem import DesignProblem, LocalSolution
from spatial_pin.synthesis.design_space import WEIGHTS
from spatial_pin.synthesis.inner_problem import GoalStates, InnerProblem, spread
from spatial_pin.synthesis.precision import PathGoal

# curves drawn together; fewer where a mechanism must be loaded for each (30 ms each)
CURVES, LOADED = 4096, 64
MOST_COMPARED = 1024  # of the curves with a full turn: where all have one, a quarter is enough
BATCHES = 8  # batches of an atlas: a tenth to a third of four-bars turn fully
TURN_STEPS = 72  # samples of a turn
# Newton steps for random configurations, and from sample to sample; an error below NEARLY before
# the last step is squared by it.
FIRST_STEPS, NEXT_STEPS, NEARLY = 12, 2, 1e-2
LONGEST_NEWTON = 0.5  # longest Newton step [rad, characteristic lengths]
FLOOR = 1e-12  # added to the diagonal of normal equations of order one, which may be singular
OF_A_BATCH, MOST_BROUGHT = 4, 12  # curves used of each batch, and curves tried for that
COMES_BACK = 1e-3  # distance between the ends of a curve after a turn, relative to its size
MOVED = 1e-6  # relative error up to which dimensions can make a rigid motion of the curve
# Steps of the homotopy: factor of size, and angle [rad] or displacement relative to the curve's
# size.
SIZE_STEP, TURN_STEP = 1.5, 0.4
STEPS_TO_PATH = 16  # most steps of the homotopy
BRINGING_CORRECTIONS = 2  # Newton corrections of each step; the next step corrects the rest
OUTSIDE = 1e-6  # distance beyond a bound that counts as inside, relative to the width of the bounds
LEAST_SIZE = 1e-6  # size of a path relative to a curve: a smaller one is a point
LEAST_POINTS = 4  # every curve has a part similar to three points
NO_NUMBERS = np.empty(0)  # a turn has no numbers of its own


@dataclass(frozen=True, eq=False)
class AtlasStart:
    """A start of a local fit with its configurations."""

    x: Array  # (n,) dimensions and own numbers
    samples: GoalStates  # configurations at the samples of the path
    misfit: float  # distance between curve and path, relative to the size of the curve
    tried: int  # sets of dimensions tried in the homotopy


def _extrapolated(mechanism: Mechanism, last: Array, before: Array) -> Array:
    """Return configurations (m, nq) one step on, by the difference of the last two."""
    model = mechanism.model
    if model.nq == model.nv and all(c.q >= 0 for c in mechanism.coordinate_table.values()):
        return 2.0 * last - before
    return np.array([pin.integrate(model, a, pin.difference(model, b, a))
                     for a, b in zip(last, before, strict=True)]).reshape(last.shape)


def _nearly_closed(
    family: Variants, members: DimensionBatch, samples: GoalStates, steps: int, driver: int
) -> tuple[GoalStates, NDArray[np.intp]]:
    """Return configurations after Newton steps with a fixed driver, and which are nearly closed.

    The normal equations are exact enough to compare curves.
    """
    q, angles, at = samples
    scale = family.mechanism.velocity_scale
    error = np.full(len(q), np.inf)
    for _ in range(steps if len(q) else 0):
        bodies = family.bodies(members, q, angles)
        error = np.abs(bodies.residual).max(axis=1, initial=0.0)
        slope = bodies.jacobian.copy()
        slope[:, :, driver] = 0.0
        square = np.einsum("mhi,mhj->mij", slope, slope)
        square += FLOOR * np.eye(slope.shape[2])
        moved = -np.linalg.solve(square, np.einsum("mhi,mh->mi", slope, bodies.residual)[
            :, :, None])[:, :, 0]
        longest = np.abs(moved).max(axis=1, initial=0.0)
        moved *= np.minimum(1.0, LONGEST_NEWTON / np.maximum(longest, LONGEST_NEWTON))[:, None]
        q, angles = family.displaced(q, moved * scale), bodies.angles
    return GoalStates(q, angles, at), np.flatnonzero(error < NEARLY)


class CurveDatabase:
    """Coupler curves of random dimensions, and those that are similar to a path.

    Attributes:
        curves: number of curves drawn together.
        number: number of the path among goals of precision; goal: the path.
    """

    def __init__(self, problem: DesignProblem) -> None:
        self.p = problem
        paths = [(k, s.goal) for k, s in enumerate(problem.inner_problems)
                 if isinstance(s.goal, PathGoal) and not s.goal.drivers
                 and s.goal.count >= LEAST_POINTS]
        if len(paths) != 1:
            raise ValueError(
                f"method 'atlas' is for one path of free timing through {LEAST_POINTS} points or "
                f"more; there are {len(paths)}: take another method")
        self.number, self.goal = paths[0]
        if not np.ptp(self.goal.points, axis=0).any():
            raise ValueError("method 'atlas' is for a path; its points are all at one place")
        self.curves = LOADED if problem.family.tree is None else CURVES
        mechanism = problem.mechanism
        names = list(mechanism.drivers)
        if len(names) != 1 or mechanism.driven_coordinate(names[0]).unit != "rad":
            raise ValueError(
                f"method 'atlas' needs one driver that turns; mechanism {mechanism.name!r} has "
                f"{len(names)} drivers: take another method")
        self._driver = mechanism.driven_coordinate(names[0])
        own = problem.nominal().coordinate(self._driver.name).value
        self._values = own + 2.0 * np.pi * np.arange(TURN_STEPS + 1) / TURN_STEPS
        self._turn = self._driven(np.zeros((TURN_STEPS + 1, 3)), self._values)
        self._own = problem.own[self.number]

    def _driven(self, points: Array, values: Array) -> InnerProblem:
        """Return the path through points with prescribed driver values."""
        return InnerProblem(self.p.family, replace(
            self.goal, points=points, drivers={self._driver.name: values}, input_offset=False,
            placement=False, scale=False))

    def batch(self, rng: np.random.Generator) -> list[AtlasStart]:
        """Return starts from one batch of random curves, the most similar first."""
        drawn = np.array([self.p.draw(rng) for _ in range(self.curves)])
        x, samples, points = self._curves(drawn, rng)
        if not len(x):
            return []
        curves = points[:, :-1]
        movable = self._movable(x[0], [s.taken(slice(0, 1)) for s in samples[:-1]])
        match = matches(self.goal.points, curves, self.goal.closed, *movable)
        best = np.argsort(match.misfit, kind="stable")[:MOST_BROUGHT]
        parts = lengths_along(curves)
        begins: list[AtlasStart] = []
        for i in best.tolist():
            rows = np.rint(np.interp(match.at[i], parts[i], np.arange(TURN_STEPS + 1.0)))
            own = [samples[int(row)].taken(slice(i, i + 1)) for row in rows]
            alike = AtlasStart(
                x[i], GoalStates.joined([s._replace(at=np.array([k])) for k, s in enumerate(own)]),
                float(match.misfit[i]), 0)
            there = _homotopy(self, alike, float(match.size[i]), match.rotation[i])
            begins += [there] if there is not None else []
            if len(begins) == OF_A_BATCH:
                break
        return begins

    def _curves(self, x: Array, rng: np.random.Generator) -> tuple[Array, list[GoalStates], Array]:
        """Return unknowns (m, n) with a full turn, configurations, and curves.

        Half of the curves begin at the nominal state, half at random configurations, since a
        mechanism may have several assembly modes.
        """
        members = self.p.family.batch(x[:, : self.p.n].T)
        x, members = x[members.holds], members.taken(np.flatnonzero(members.holds))
        state, m = self.p.nominal(), len(x)
        q = np.repeat(state.q[None], m, axis=0)
        q[1::2] = spread(self.p.mechanism, state.q, len(q[1::2]), rng)
        here = GoalStates(q, np.repeat(state.angles[None], m, axis=0), np.zeros(m, dtype=np.intp))
        states: list[GoalStates] = []
        for k, value in enumerate(self._values.tolist()):
            ahead = (_extrapolated(self.p.mechanism, states[-1].q, states[-2].q)
                     if len(states) > 1 else here.q.copy())
            ahead[:, self._driver.q] = value
            here = GoalStates(ahead, here.angles, np.full(len(x), k))
            here, closed = _nearly_closed(self.p.family, members, here,
                                          NEXT_STEPS if k > 1 else FIRST_STEPS, self._driver.v)
            x, members, here = x[closed], members.taken(closed), here.taken(closed)
            states = [*(s.taken(closed) for s in states), here]
        points = np.stack([self._points(members, s) for s in states], axis=1)
        size = np.ptp(points, axis=1).max(axis=1, initial=0.0)
        gap = np.abs(points[:, -1] - points[:, 0]).max(axis=1, initial=0.0)
        back = np.flatnonzero(gap < COMES_BACK * size)[:MOST_COMPARED]
        return (x[back], [s.taken(back) for s in states], points[back])

    def _points(self, members: DimensionBatch, samples: GoalStates) -> Array:
        """Return origins of the frame (m, 3), one configuration for each set of dimensions."""
        bodies = self.p.family.bodies(members, samples.q, samples.angles, with_jacobian=False)
        return bodies.origin(self.goal.frame)

    def _movable(
        self, x: Array, samples: Sequence[GoalStates]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], bool]:
        """Return along and about which axes, and whether in size, the unknowns can move a curve."""
        placed, scaled = self.goal.placement, self.goal.scale
        some = GoalStates.joined(samples[::6])
        columns = self._turn.slopes(*self._around(x), some, NO_NUMBERS).reshape(-1, self.p.n)
        inverse = pseudo_inverses(columns[None], TOLERANCES.singular)[0]
        arms = self._points(self._same(x, len(some.q)), some)
        arms = arms - arms.mean(axis=0)
        spread = float(np.abs(arms).max())

        def can(motion: Array) -> bool:
            moved = motion.ravel()
            size = float(np.linalg.norm(moved))
            if size <= MOVED * spread:
                return False
            rest = moved - columns @ (inverse @ moved)
            return bool(np.linalg.norm(rest) < MOVED * size)

        axes = np.eye(3)
        shifts = np.array([placed or can(np.broadcast_to(a, arms.shape)) for a in axes])
        turns = np.array([placed or can(np.cross(a, arms)) for a in axes])
        if turns.sum() == 2:
            turns[:] = False
        return shifts, turns, scaled or can(arms)

    def _same(self, x: Array, m: int) -> DimensionBatch:
        """Return the mechanism of x, repeated for m configurations."""
        return self.p.members(x).taken(np.zeros(m, dtype=np.intp))

    def _around(self, x: Array) -> tuple[DimensionBatch, DimensionBatch, Array]:
        """Return the mechanism of x, its neighbours, and the step widths."""
        return self.p.members(x), *self.p.around(x)

    def solved(self, begin: AtlasStart) -> LocalSolution:
        """Return the local solution that starts from a curve."""
        near = [begin.samples]
        if len(self.p.inner_problems) > 1:
            near = self.p.start_states(begin.x, None)
            near[self.number] = begin.samples
        solution = self.p.solve_from(begin.x, near, WEIGHTS[1:])
        return replace(solution, evaluations=solution.evaluations + begin.tried)


def _homotopy(
    atlas: CurveDatabase, alike: AtlasStart, size: float, rotation: Array
) -> AtlasStart | None:
    """Return a curve moved to the path; None if the bounds do not allow it.

    The curve grows by a factor and turns by a rotation (3, 3), as a whole in small steps, by
    dimensions from Newton's method. A path with free placement or scale is moved instead.
    """
    p, goal, x = atlas.p, atlas.goal, alike.x.copy()
    size, turn = max(size, LEAST_SIZE), pin.log3(rotation)
    own = atlas._points(atlas._same(x, goal.count), alike.samples)
    there, numbers = own.mean(axis=0), np.zeros(len(goal.own_names))
    away = there - goal.points.mean(axis=0)
    if goal.placement:
        numbers[:3], numbers[3:6] = away / p.mechanism.characteristic_length, -turn
        turn, away = np.zeros(3), np.zeros(3)
    if goal.scale:
        numbers[-1], size = -np.log(size), 1.0
    x[atlas._own] = numbers
    timed = atlas._driven(goal.points, alike.samples.q[:, atlas._driver.q])
    width = float(np.abs(own - there).max()) * max(size, 1.0)
    steps = max(abs(np.log(size)) / np.log(SIZE_STEP), float(np.linalg.norm(turn)) / TURN_STEP,
                float(np.abs(away).max()) / width)
    n, samples = int(min(np.ceil(steps), STEPS_TO_PATH)), alike.samples
    for part in np.repeat(np.arange(1, n + 1) / max(n, 1), BRINGING_CORRECTIONS).tolist():
        target = there - part * away + size**part * (own - there) @ pin.exp3(part * turn).T
        samples, _, closed = timed.closed(p.members(x), samples, NO_NUMBERS)
        if not closed.all():
            return None
        missed = (atlas._points(atlas._same(x, goal.count), samples) - target).ravel()
        slopes = timed.slopes(*atlas._around(x), samples, NO_NUMBERS).reshape(missed.size, -1)
        slopes = slopes * p.sizes[: p.n] * p.mechanism.characteristic_length
        inverse = pseudo_inverses(slopes[None], TOLERANCES.singular)[0]
        x = x.copy()
        x[: p.n] -= p.sizes[: p.n] * (inverse @ missed)
    outside = np.maximum(p.lower - x, x - p.upper) > OUTSIDE * p.sizes
    return None if outside.any() else AtlasStart(
        np.clip(x, p.lower, p.upper), samples, alike.misfit, n * BRINGING_CORRECTIONS)
