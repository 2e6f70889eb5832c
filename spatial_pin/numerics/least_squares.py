"""Constrained least squares with bounds, by steps in the tangent space of both.

Gauss's steps go quickly to what can be reached. Towards what cannot, they creep: they leave out how
residuals and constraints bend, which counts in proportion to what stays off. There Newton's steps
are made on the Lagrangian [NocedalWright2006, 18], along the freedoms that are left; they also lead
away from stationary points at which the sum is greatest, not least.

Bounds are kept by an active set [NocedalWright2006, 16.5]: an unknown that a step takes beyond its
bound stands there, until a step would take it back.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.numerics.linalg import Array, Triangular, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

# After this many steps that leave more than half of the residual, Newton's method replaces
# Gauss's, which converges slowly there.
SLOW_STEPS = 2
# Damping relative to the square of the largest singular value: after a first step that failed, the
# least after a later one, and one with which nothing moves any more.
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-6, 1e6
HARDENING = 4.0  # factor of the damping after a step that failed
# Gains of a step, relative to the predicted gain [NocedalWright2006, 4.1]. Below the first the
# damping grows, above the second it falls.
POOR_GAIN, GOOD_GAIN = 0.25, 0.75
# Rounds of steps more, while all are long: a spindle is reached 150 turns away.
MORE_ROUNDS = 9
NO_LONGER = 1e-9  # largest step at a minimum, relative to the unknowns
# Largest constraint residual between steps, relative to the square of a Gauss step. Such a step
# itself misses by its square. The last steps are so short that all digits are right.
OFF_ON_THE_WAY = 1e-3
# A step to a double root (a dead centre) leaves a quarter of the residual; this range counts as
# one.
DOUBLE_ROOT = 0.15, 0.35
# Part of the step to the vertex that is made. Residuals keep a slope, and a quarter of a millionth
# of them remains.
NEARLY_THERE = 0.9995
CURVATURE_STEP = 1e-6  # step of one-sided differences: half of their digits are right
GRADIENT_STEP = 1e-4  # step of central differences: their error is 1e-9 to 1e-11
SLACK = TOLERANCES.closed  # tolerated beyond a bound: corrected numbers are known to it
Bounds = dict[int, int]  # active ones, by unknown: 0 the lower, 1 the upper one


class LeastSquares(ABC):
    """Half a sum of squares to be minimised; its unknowns are of order one.

    To make something least: a class with `residual` and `jacobian`, and with

    1. `displaced`, `room` and `at_bounds`, where the unknowns are no vector;
    2. `constraints`, `corrected` and `pulled`, where constraints hold;
    3. `model`, where squares count for less than they are.

    Attributes:
        moves: (n,) which unknowns may move.
        sizes: (n,) of the unknowns of a vector, which steps are relative to.
        ends: (2, n) bounds of a vector, the lower ones first.
        tolerance: length of the residuals at which they are none.
        bends: whether Newton's steps may be made; they take a gradient for each freedom.
        gain: part of the sum that a step gains at least, while steps are Gauss's.
        longest: step that is made at most.
        cut: singular values, relative to the largest, below which Gauss's steps move nothing.
        most: largest number of steps: Newton's are ten, towards far targets some dozens.
    """

    moves: NDArray[np.bool_]
    sizes: Array | float = 1.0
    ends: Array | None = None
    tolerance = 0.0
    bends = True
    gain = 0.0
    longest = TOLERANCES.damped_step
    cut = TOLERANCES.singular
    most = 200

    @abstractmethod
    def residual(self, x: Array) -> Array:
        """Return the residuals (k,); infinite where there are none."""

    @abstractmethod
    def jacobian(self, x: Array) -> Array:
        """Return their derivatives (k, n)."""

    def model(self, x: Array) -> tuple[Array, Array]:
        """Return residuals and derivatives, (k,) and (k, n), that define the steps.

        Half the sum of their squares has the slope that the problem has, and bends as much or more.
        """
        return self.residual(x), self.jacobian(x)

    def displaced(self, x: Array, step: Array) -> Array:
        """Return the unknowns after a step (n,)."""
        moved = self.sizes * step
        there: Array = x + moved
        there[np.abs(there) <= TOLERANCES.last_digit * np.abs(moved)] = 0.0  # but for round-off
        return there

    def constraints(self, x: Array) -> Array:
        """Return the derivatives (m, n) of the constraints."""
        return np.empty((0, len(self.moves)))

    def corrected(self, x: Array, free: NDArray[np.bool_], off: float) -> Array | None:
        """Return x with its free unknowns corrected to the constraints; None if x moves too far.

        Args:
            x: where it begins.
            free: (n,) which unknowns may move.
            off: length of the constraints that may be left.
        """
        return x

    def room(self, x: Array) -> Array:
        """Return the distances of unknowns from their bounds (2, n), the lower ones first."""
        if self.ends is None:
            return np.full((2, len(self.moves)), np.inf)
        return np.stack([x - self.ends[0], self.ends[1] - x]) / self.sizes

    def at_bounds(self, x: Array, active: Bounds) -> Array:
        """Return x with unknowns at their active bounds."""
        x = x.copy()
        for k, side in active.items():
            x[k] = self.ends[side, k] if self.ends is not None else x[k]
        return x

    def pulled(self, x: Array, multipliers: Array, forces: Array) -> Array:
        """Return the sum (n,) of multipliers and forces times derivatives of both."""
        gradient: Array = multipliers @ self.constraints(x) + forces @ self.jacobian(x)
        return gradient

    def free(self, active: Bounds) -> NDArray[np.bool_]:
        """Return which unknowns may move (n,) between active bounds."""
        free = self.moves.copy()
        free[list(active)] = False
        return free


def passed(room: Array, step: Array, active: Bounds) -> tuple[int, int] | None:
    """Return unknown and side of the bound that a step (n,) passes first, or None.

    Args:
        room: (2, n) distances to the bounds.
        step: the step.
        active: bounds that are kept anyway.
    """
    if np.all(step <= room[1]) and np.all(-step <= room[0]):
        return None
    first, share = None, 1.0
    for side, k in np.argwhere(np.stack([-step, step]) > np.maximum(room, 0.0)).tolist():
        part = max(float(room[side, k]), 0.0) / abs(float(step[k]))
        if k not in active and part < share:
            first, share = (k, side), part
    return first


def beyond(room: Array, allowed: Array | float, active: Bounds) -> Bounds:
    """Return the bounds that unknowns exceed by more than a tolerance, without active ones."""
    if not room.size or room.min() >= -SLACK:
        return {}
    return {k: side for side, k in np.argwhere(
        room < np.minimum(allowed, 0.0) - SLACK).tolist() if k not in active}


class Iterate:
    """Unknowns, and the values of a problem there.

    Attributes:
        x: the unknowns.
    """

    def __init__(self, problem: LeastSquares, x: Array) -> None:
        self.problem, self.x = problem, x
        self._tangents: dict[bytes, Array] = {}
        self._lagrangians: dict[bytes, Lagrangian] = {}

    @cached_property
    def residual(self) -> Array:
        """The residuals (k,)."""
        return self.problem.residual(self.x)

    @cached_property
    def model(self) -> tuple[Array, Array]:
        """Residuals and derivatives (k, n) that define the steps."""
        return self.problem.model(self.x)

    @property
    def rows(self) -> Array:
        """These derivatives."""
        return self.model[1]

    @cached_property
    def room(self) -> Array:
        """Distances of unknowns from their bounds (2, n)."""
        return self.problem.room(self.x)

    @cached_property
    def size(self) -> float:
        """The length of the residuals."""
        return math.sqrt(self.residual.dot(self.residual))

    def tangents(self, free: NDArray[np.bool_]) -> Array:
        """Return orthonormal rows (d, n): directions of free unknowns along the constraints."""
        key = free.tobytes()
        if key not in self._tangents:
            basis = Triangular(self.problem.constraints(self.x)[:, free]).null_space
            self._tangents[key] = np.zeros((len(basis), len(free)))
            self._tangents[key][:, free] = basis
        return self._tangents[key]

    def lagrangian(self, free: NDArray[np.bool_]) -> Lagrangian:
        """Return the Lagrangian of the free unknowns."""
        key = free.tobytes()
        if key not in self._lagrangians:
            self._lagrangians[key] = Lagrangian(self, free)
        return self._lagrangians[key]

    def known_lagrangian(self, free: NDArray[np.bool_]) -> Lagrangian | None:
        """Return the same, if it is known."""
        return self._lagrangians.get(free.tobytes())

    def predicted(self, step: Array) -> float:
        """Return the predicted gain of a step (n,), as part of the sum."""
        residual, rows = self.model
        linear = residual + rows @ step
        return float(residual @ residual - linear @ linear) / self.size**2

    def push(self, active: Bounds, k: int) -> float:
        """Return how far a free step exceeds the bound at which an unknown is."""
        tangents = self.tangents(self.problem.free({v: x for v, x in active.items() if v != k}))
        residual, rows = self.model
        step = -(residual @ rows @ tangents.T) @ tangents
        return float(step[k]) if active[k] else -float(step[k])


class Lagrangian:
    """The Lagrangian: half the sum, and the constraints, each times its multiplier.

    First derivatives are differenced; residuals stay as they are, as what their changes add to the
    curvature is known exactly.

    Attributes:
        tangents: (d, n) along which constraints are kept.
        slope: (n,) the derivative of half the sum.
        gradient: (d,) this along the tangents; zero where it is no more than round-off.
        least: the curvature that is clearly one, however little others are.
    """

    def __init__(self, at: Iterate, free: NDArray[np.bool_]) -> None:
        self._at, self._free, self.tangents = at, free, at.tangents(free)
        self.slope = at.residual @ at.rows
        constraints = decompose(at.problem.constraints(at.x)[:, free])
        self._multipliers = constraints.minimum_norm_transposed(-self.slope[free])
        most = float(np.linalg.norm(at.rows[:, free]))
        self.least = max(TOLERANCES.nothing * most**2, TOLERANCES.zero)
        self.gradient = self.tangents @ self.slope
        if np.linalg.norm(self.gradient) <= TOLERANCES.round_off * most * at.size:
            self.gradient = np.zeros(len(self.tangents))

    def at(self, x: Array) -> Lagrangian:
        """Return the Lagrangian of the same sum at other unknowns."""
        return Lagrangian(Iterate(self._at.problem, x), self._free)

    def _pulled(self, step: Array) -> Array:
        """Return the derivative (n,) a step (n,) away."""
        problem = self._at.problem
        return problem.pulled(problem.displaced(self._at.x, step), self._multipliers,
                              self._at.residual)

    @cached_property
    def curvature(self) -> tuple[Array, Array]:
        """Curvatures (d,) along its principal directions, rising, and these (d, d) in columns.

        They are good to half of the digits.
        """
        tangents, parts = self.tangents, self._at.rows @ self.tangents.T
        here = self._at.problem.pulled(self._at.x, self._multipliers, self._at.residual)
        bent = [tangents @ (self._pulled(CURVATURE_STEP * tangent) - here) for tangent in tangents]
        bends = np.reshape(bent, 2 * tangents.shape[:1]) / CURVATURE_STEP
        sizes, directions = np.linalg.eigh(parts.T @ parts + 0.5 * (bends + bends.T))
        return sizes, directions

    def newton_step(self, damping: float) -> Array:
        """Return Newton's step (n,), which descends along negative curvature too."""
        if not len(self.gradient):
            return np.zeros(self.tangents.shape[1])
        sizes, ways = self.curvature
        size, along = np.abs(sizes), ways.T @ self.gradient
        most = max(float(size.max()), self.least)
        # A flat direction, as of an idle rotation, comes last: differences leave some millionths of
        # other directions in it, and so of their gradients, over a curvature that is nothing.
        is_flat = size <= TOLERANCES.half_precision * most
        along[is_flat & (np.abs(along) <= TOLERANCES.regular * np.abs(along).max())] = 0.0
        parts = along / (np.maximum(size, TOLERANCES.nothing * most) + damping * most)
        return -(ways @ parts) @ self.tangents

    def downward(self) -> Array | None:
        """Return the direction (n,) of most negative curvature; None if there is none."""
        sizes, directions = self.curvature
        size = np.abs(sizes).max(initial=self.least)
        if not len(sizes) or sizes[0] >= -TOLERANCES.half_precision * size:
            return None
        direction: Array = directions[:, 0] @ self.tangents
        return direction if direction[np.argmax(np.abs(direction))] > 0.0 else -direction

    def is_single(self) -> bool:
        """Whether all curvatures at the minimum are clearly positive."""
        parts = self._at.rows @ self.tangents.T
        sizes = np.abs(self.curvature[0])  # what residuals' bending cancels is known to 1e-6 of it
        return bool(np.all(sizes > TOLERANCES.regular * np.linalg.norm(parts) ** 2))

    def changes(self, directions: Array) -> Array:
        """Return the second derivative (d, n), along the tangents, for directions (d, n).

        To 1e-9 and better.
        """
        sizes = [float(np.linalg.norm(direction)) for direction in directions]
        steps = [GRADIENT_STEP / max(size, TOLERANCES.zero) for size in sizes]
        bent = [(self._pulled(h * direction) - self._pulled(-h * direction)) / (2.0 * h)
                for h, direction in zip(steps, directions, strict=True)]
        rows = self._at.rows
        changed = directions @ rows.T @ rows + np.reshape(bent, directions.shape)
        return changed @ self.tangents.T @ self.tangents

    def curved(self) -> tuple[Array, Array]:
        """Return sizes (k,) and directions (k, n) of the curvatures that are not zero."""
        tangents, slope = self.tangents, self._at.rows @ self.tangents.T
        curvature = self.changes(tangents) @ tangents.T
        sizes, ways = np.linalg.eigh(0.5 * (curvature + curvature.T))
        # what the residuals' bending may cancel; NumPy 2.0 has no norm of an empty matrix
        parts = float(np.linalg.norm(slope, ord=2)) ** 2 if slope.size else 0.0
        most = max(parts, float(np.abs(sizes).max(initial=0.0)))
        curved = np.abs(sizes) > max(TOLERANCES.half_precision * most, self.least)
        return sizes[curved], ways.T[curved] @ tangents


class Minimum(NamedTuple):
    """The end of a descent."""

    at: Iterate
    active: Bounds  # those that hold it back
    has_ended: bool  # by itself, not since steps ran out
    is_in_progress: bool  # it went on by long steps until these ran out


def minimised(problem: LeastSquares, x: Array, active: Bounds) -> Minimum:
    """Minimise from unknowns that meet the constraints and the active bounds."""
    for off in (OFF_ON_THE_WAY, 0.0):
        result = Descent(problem, off).run(Iterate(problem, x), active)
        for _ in range(MORE_ROUNDS if result.is_in_progress else 0):
            result = Descent(problem, off).run(result.at, result.active)
            if not result.is_in_progress:
                break
        end = result.at.x
        met = problem.corrected(end, problem.free(result.active), 0.0)
        if met is not None:  # else it went where constraints cannot be met
            return result if met is end else result._replace(at=Iterate(problem, met))
    return result


class Descent:
    """The steps of `minimised`: their damping, and whether they are Newton's.

    Args:
        problem: the residuals to minimise, with constraints and bounds.
        off: part of the square of a step by which constraints may be off on the way.
    """

    def __init__(self, problem: LeastSquares, off: float) -> None:
        self._problem, self._off, self._damping, self._slow = problem, off, 0.0, 0

    @property
    def _is_bent(self) -> bool:
        """Whether steps are Newton's."""
        return self._problem.bends and self._slow >= SLOW_STEPS

    def run(self, here: Iterate, active: Bounds) -> Minimum:
        """Return the end of the descent; constraints hold nearly there."""
        problem, moved = self._problem, 0.0
        for _ in range(problem.most if here.size < np.inf else 0):
            # bounds that a free step, of some of them released, would not leave
            active = {k: side for k, side in active.items()
                      if here.push(active, k) >= -TOLERANCES.nothing * here.size}
            before, (step, now_active) = here, self._step(here, active)
            moved = math.sqrt(step.dot(step))
            there = self._landed(here, step, now_active)
            converges = self._is_bent and self._damping < TOLERANCES.half_precision
            is_last = moved < (TOLERANCES.half_precision if converges else NO_LONGER)
            if there is not None and self._is_as_good(there, here, active, moved):
                is_last = is_last and there[1].keys() == active.keys()
                if not self._is_bent:
                    there = self._to_vertex(here, active, step, there)
                share = there[0].size / here.size if here.size else 0.0
                gained = 1.0 - share * share
                predicted = 0.0 if self._is_bent or not here.size else here.predicted(step)
                if POOR_GAIN * predicted < gained < problem.gain:
                    return Minimum(*there, True, False)
                self._damping *= 2.0 if gained < POOR_GAIN * predicted else (
                    1.0 if gained < GOOD_GAIN * predicted else 0.25)
                if share < 0.1:
                    self._slow = 0
                elif share > 0.5 and moved < 0.99 * problem.longest:
                    self._slow += 1
                here, active = there
                if here.size <= problem.tolerance:
                    return Minimum(here, active, True, False)
            else:
                self._damping = max(LEAST_DAMPING, HARDENING * self._damping) if (
                    self._damping) else FIRST_DAMPING
                self._slow += 1
                is_last = self._damping > MOST_DAMPING or is_last
            if is_last:
                onward = self._onward(here, active, before)
                if onward is None:
                    return Minimum(here, active, True, False)
                here, active = onward
        return Minimum(here, active, False, moved > 0.5 * problem.longest)

    def _step(self, here: Iterate, active: Bounds) -> tuple[Array, Bounds]:
        """Return a step (n,), and the bounds that end it."""
        problem, active = self._problem, dict(active)
        jump = np.zeros(len(problem.moves))
        while True:
            free = problem.free(active)
            if self._is_bent:
                step = here.lagrangian(free).newton_step(self._damping)
            else:
                tangents, (residual, rows) = here.tangents(free), here.model
                step = damped(rows @ tangents.T, -(residual + rows @ jump), self._damping,
                              problem.cut) @ tangents
            length = math.sqrt(step.dot(step))
            if length > problem.longest:
                step *= problem.longest / length
            first = passed(here.room, step, active)
            if first is None:
                return step + jump, active
            k, side = first
            active[k] = side
            jump[k] = here.room[side, k] if side else -here.room[side, k]

    def _landed(
        self, here: Iterate, step: Array, active: Bounds
    ) -> tuple[Iterate, Bounds] | None:
        """Return the unknowns after a step, corrected, within bounds; None if they move too far."""
        problem, off = self._problem, 0.0 if self._is_bent else self._off * float(step @ step)
        while True:
            x = problem.at_bounds(problem.displaced(here.x, step), active)
            landed = problem.corrected(x, problem.free(active), off)
            if landed is None:
                return None
            there = Iterate(problem, landed)
            more = beyond(there.room, here.room, active)
            if not more:
                return (there, active) if there.size < np.inf else None
            active = active | more

    def _is_as_good(
        self, there: tuple[Iterate, Bounds], here: Iterate, active: Bounds, moved: float
    ) -> bool:
        """Whether a step is accepted: it moves and does not ascend."""
        size = there[0].size
        if size < here.size:
            return True
        if there[1].keys() != active.keys():
            return size <= here.size * (1.0 + TOLERANCES.nothing)
        if moved < TOLERANCES.half_precision and (self._is_bent or not self._problem.bends):
            # sums tell no points apart
            return size <= here.size * (1.0 + TOLERANCES.tight)
        return size <= self._problem.tolerance

    def _to_vertex(
        self, here: Iterate, active: Bounds, step: Array, there: tuple[Iterate, Bounds]
    ) -> tuple[Iterate, Bounds]:
        """Return the end of a Gauss step to the vertex of the parabola of residuals along it.

        Towards a dead centre, a double root, every step is half as long as the one before. With r
        at its start and c where it ends, (1 - t) r + t² c is zero farther on, at a t up to 2.
        """
        least, most = DOUBLE_ROOT
        if active.keys() != there[1].keys() or not (
                least * here.size < there[0].size < most * here.size):
            return there
        bent = float(here.residual @ there[0].residual) / here.size**2
        longer = min(2.0 * NEARLY_THERE, 2.0 / (1.0 + max(1.0 - 4.0 * bent, 0.0) ** 0.5))
        farther = self._landed(here, longer * step, active)
        return farther if farther and farther[0].size < 0.5 * there[0].size else there

    def _onward(
        self, here: Iterate, active: Bounds, before: Iterate
    ) -> tuple[Iterate, Bounds] | None:
        """Return a lower point near a stationary one, below `before`; None at a minimum."""
        if here.size <= self._problem.tolerance or not self._problem.bends:
            return None
        self._damping, was_bent = 0.0, self._is_bent
        self._slow = max(self._slow, SLOW_STEPS)
        if not was_bent:
            return here, active
        free = self._problem.free(active)
        known = before.known_lagrangian(free)
        if known is not None and known.downward() is None:
            return None
        direction = here.lagrangian(free).downward()
        if direction is None:
            return None
        best = here, active
        for side in (1.0, -1.0):
            there = self._landed(here, side * TOLERANCES.trial_step * direction, active)
            if there is not None and there[0].size < best[0].size * (1.0 - TOLERANCES.round_off):
                best = there
        return None if best[0] is here else best


def damped(a: Array, b: Array, damping: float, cut: float) -> Array:
    """Return x (n,) with a x = b as nearly as can be, of least norm; damped as Levenberg does."""
    svd = decompose(a, cut)
    if not svd.rank:
        return np.zeros(a.shape[1])
    s = svd.s[: svd.rank]
    parts = s / (s * s + damping * svd.s[0] ** 2)
    return (parts * (svd.u[:, : svd.rank].T @ b)) @ svd.vt[: svd.rank]
