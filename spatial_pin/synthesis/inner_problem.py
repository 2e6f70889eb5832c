"""The inner problem of synthesis: best configurations at given dimensions, and their derivatives.

At given unknowns x every sample has its own best configuration. With the loose method open loops
and goal errors are minimised together, so that no loop need close. With the exact method loops are
closed, drivers are fixed, and free motions serve the goal. Residuals at best configurations are
functions of x alone. Their derivative is the one at fixed configurations less the part that moving
the joints removes: variable projection [GolubPereyra1973] in the form of [Kaufman1975].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.dimensions.variants import DimensionBatch, EvaluatedBatch, Variants
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, pseudo_inverses
from spatial_pin.numerics.stacked import damped_solutions, levenberg, padded_null_spaces, projected
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.precision import Precision, simple

INNER_STEPS = 40  # for a sample: from a random start about 20 are usual, from a nearby one 4
CLOSINGS = 12  # Newton steps: after a step of half a radian 4 to 6 are usual
FIRST_DAMPING = 1e-3  # of Levenberg's method, relative to equations of order one
# factors of the damping after a step that helped, and after one that did not
INNER_EASING, INNER_HARDENING = 0.2, 8.0
# loop error after a step along the loops, from which closing converges quadratically
MOST_OPEN = 0.1
# Damping of equations of order one: the square root of round-off in their products, since Gauss's
# method needs none near a solution.
FLOOR_DAMPING = 1e-14


class GoalStates(NamedTuple):
    """Configurations of a goal."""

    q: Array  # (m, nq)
    angles: Array  # (m, n_angles) of screw closures [rad]
    at: NDArray[np.intp]  # (m,) numbers of their samples

    def taken(self, some: slice | NDArray[np.intp]) -> GoalStates:
        """Return a selection of the configurations."""
        return GoalStates(self.q[some], self.angles[some], self.at[some])

    @classmethod
    def joined(cls, several: Sequence[GoalStates]) -> GoalStates:
        """Return several sets as one."""
        return cls(*(np.concatenate(x) for x in zip(*several, strict=True)))


class GoalRows(NamedTuple):
    """Equations of m configurations that must hold, and residuals of the goal."""

    held: Array  # (m, h) closure equations, then drivers
    wanted: Array  # (m, r) residuals of the goal
    held_moves: Array  # their derivatives (m, ., nv) for v / `velocity_scale`
    wanted_moves: Array
    held_own: Array  # those for the goal's own numbers (m, ., n_own)
    wanted_own: Array

    @property
    def open(self) -> Array:
        """The largest error of equations that must hold (m,)."""
        error: Array = np.abs(self.held).max(axis=1, initial=0.0)
        return error

    def steps(self, damping: Array) -> Array:
        """Return Levenberg steps (m, nv) to closed equations, with more damping far from them."""
        open_by = np.einsum("mi,mi->m", self.held, self.held)
        return _steps(self.held_moves, self.held, np.maximum(damping, open_by))

    def together(self, weight: float) -> tuple[Array, Array, Array]:
        """Return all rows, closure equations weighted, and their derivatives."""
        return (np.concatenate([weight * self.held, self.wanted], axis=1),
                np.concatenate([weight * self.held_moves, self.wanted_moves], axis=1),
                np.concatenate([weight * self.held_own, self.wanted_own], axis=1))


class GoalEquations:
    """Closure equations, drivers and residuals of a goal on a family of mechanisms.

    Attributes:
        names: of the goal's own numbers.
    """

    def __init__(self, family: Variants, goal: Precision) -> None:
        self.family, self.goal = family, goal
        mechanism = family.mechanism
        goal.check(mechanism)
        driven = [simple(mechanism, name) for name in goal.drivers]
        self._driven_q = np.array([c.q for c in driven], dtype=np.intp)
        self._driven_v = np.array([c.v for c in driven], dtype=np.intp)
        self._sizes = mechanism.velocity_scale[self._driven_v]
        self._values = np.array([*goal.drivers.values()]).reshape(len(driven), goal.count).T
        zeros = [f"{name}.zero" for name in goal.drivers] if goal.input_offset else []
        self.names = (*goal.own_names, *zeros)
        self._n_zeros = len(zeros)

    def own_start(self) -> Array:
        """Return start values of the goal's own numbers; zeros of drivers are 0."""
        return np.concatenate([self.goal.own_start(self.family.mechanism),
                               np.zeros(self._n_zeros)])

    def _values_only(
        self, bodies: EvaluatedBatch, at: NDArray[np.intp], own: Array
    ) -> tuple[Array, Array]:
        zeros = own[len(own) - self._n_zeros :] if self._n_zeros else 0.0
        away = (bodies.q[:, self._driven_q] - self._values[at]) / self._sizes - zeros
        wanted = self.goal.residual(bodies, at, own[: len(own) - self._n_zeros])
        return np.concatenate([bodies.residual, away], axis=1), wanted

    def equations(
        self, members: DimensionBatch, samples: GoalStates, own: Array
    ) -> tuple[Array, Array]:
        """Return equations and residuals (m, h + r), and the angles of screws."""
        bodies = self.family.bodies(self._each(members, len(samples.q)), samples.q, samples.angles,
                                    with_jacobian=False)
        return np.concatenate(self._values_only(bodies, samples.at, own), axis=1), bodies.angles

    def rows(
        self, members: DimensionBatch, samples: GoalStates, own: Array
    ) -> tuple[GoalRows, Array]:
        """Return equations and residuals with their derivatives, and the angles of screws."""
        m, nv, at = len(samples.q), self.family.mechanism.model.nv, samples.at
        bodies = self.family.bodies(self._each(members, m), samples.q, samples.angles)
        held, _ = self._values_only(bodies, at, own)
        n, k, d = len(own), self._n_zeros, len(self._driven_v)
        wanted, moved, by_own = self.goal.slopes(bodies, at, own[: n - k])
        stands = np.zeros((m, d, nv))
        stands[:, np.arange(d), self._driven_v] = 1.0
        held_own = np.zeros((m, held.shape[1], n))
        if k:
            held_own[:, -d:, n - k :] = -np.eye(d)
        return GoalRows(held, wanted, np.concatenate([bodies.jacobian, stands], axis=1), moved,
                    held_own, np.concatenate([by_own, np.zeros((*by_own.shape[:2], k))], axis=2)
                    ), bodies.angles

    @staticmethod
    def _each(members: DimensionBatch, m: int) -> DimensionBatch:
        """Return members for m configurations: the same for all, or one each."""
        return members if len(members.holds) == m else members.taken(np.zeros(m, dtype=np.intp))

    def placed(self, samples: GoalStates, own: Array) -> GoalStates:
        """Return configurations with the drivers at their values."""
        q = samples.q.copy()
        zeros = own[len(own) - self._n_zeros :] if self._n_zeros else 0.0
        q[:, self._driven_q] = self._values[samples.at] + zeros * self._sizes
        return samples._replace(q=q)

    def _at_rest(
        self, members: DimensionBatch, around: DimensionBatch, widths: Array, samples: GoalStates,
        own: Array,
    ) -> tuple[Array, Array]:
        """Return derivatives (k, ., n) for the dimensions, with fixed joints."""
        k, n = len(samples.q), len(widths)
        if not n:
            rows, _ = self.rows(members, samples, own)
            return np.empty((*rows.held.shape, 0)), np.empty((*rows.wanted.shape, 0))
        at = np.tile(np.arange(k), 2 * n)
        bodies = self.family.bodies(around.taken(np.repeat(np.arange(2 * n), k)),
                                    samples.q[at], samples.angles[at], with_jacobian=False)
        slopes = []
        for x in self._values_only(bodies, samples.at[at], own):
            ahead, behind = x.reshape(2, n, k, -1)
            slopes.append(((ahead - behind) / widths[:, None, None]).transpose(1, 2, 0))
        return slopes[0], slopes[1]

    def residual(self, members: DimensionBatch, samples: GoalStates, own: Array) -> Array:
        """Return the goal's residuals (k, r) at configurations."""
        each = self._each(members, len(samples.q))
        bodies = self.family.bodies(each, samples.q, samples.angles, with_jacobian=False)
        return self._values_only(bodies, samples.at, own)[1]


class InnerProblem(GoalEquations):
    """Best configurations of a goal at given dimensions, loosely or exactly closed."""

    def loosely(
        self, members: DimensionBatch, samples: GoalStates, own: Array, weight: float
    ) -> GoalStates:
        """Return configurations with the least sum of penalised open loops and goal errors."""
        def known(rows: GoalRows) -> _Loose:
            residual, slope, _ = rows.together(weight)
            return _Loose(residual, slope, np.einsum("mi,mi->m", residual, residual))

        def judged(new: _Loose, old: _Loose) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
            better = new.missed < old.missed
            return better, better & (old.missed - new.missed < TOLERANCES.nothing * old.missed)

        return self._descended(members, samples, own, known, judged, FIRST_DAMPING, 0.0)[0]

    def _descended(
        self, members: DimensionBatch, samples: GoalStates, own: Array,
        known: Callable[[GoalRows], Any], judged: Callable[[Any, Any], tuple[Any, Any]],
        first: float, least: float, most: int = INNER_STEPS,
    ) -> tuple[GoalStates, GoalRows]:
        """Return the end of Levenberg's method, with the equations there.

        `known` makes an object with `steps` from the equations; `judged` compares new ones with old
        ones: which steps help, which samples have converged. `first` and `least` are dampings.
        """
        each = self._each(members, len(samples.q))
        rows, angles = self.rows(each, samples, own)
        samples = GoalStates(samples.q.copy(), angles.copy(), samples.at)
        old = known(rows)

        def tries(
            some: NDArray[np.intp], damping: Array
        ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
            here, before = samples.taken(some), type(old)(*(x[some] for x in old))
            steps = before.steps(damping)
            there = here._replace(q=self.family.displaced(
                here.q, steps * self.family.mechanism.velocity_scale))
            new_rows, new_angles = self.rows(each.taken(some), there, own)
            new = known(new_rows)
            better, has_ended = judged(new, before)
            for whole, part in ((samples, there._replace(angles=new_angles)), (rows, new_rows),
                                (old, new)):
                for x, y in zip(whole, part, strict=True):
                    x[some[better]] = y[better]
            small = np.abs(steps).max(axis=1, initial=0.0) < TOLERANCES.half_precision
            # one that gains nothing now may do so again: all go on until all have ended
            return better, np.full(len(some), np.all(small | has_ended))

        levenberg(tries, np.arange(len(samples.q)), first=first, easing=INNER_EASING,
                  hardening=INNER_HARDENING, least=least, most=most)
        return samples, rows

    def loose_residual(
        self, members: DimensionBatch, samples: GoalStates, own: Array, weight: float
    ) -> Array:
        """Return the residuals (k, h + r) of the loose method."""
        return self.rows(members, samples, own)[0].together(weight)[0]

    def loose_slopes(
        self, members: DimensionBatch, around: DimensionBatch, widths: Array, samples: GoalStates,
        own: Array, weight: float,
    ) -> Array:
        """Return their derivatives (k, h + r, n + n_own) for dimensions and own numbers."""
        rows, _ = self.rows(members, samples, own)
        _, moved, by_own = rows.together(weight)
        held, wanted = self._at_rest(members, around, widths, samples, own)
        fixed = np.concatenate(
            [np.concatenate([weight * held, wanted], axis=1), by_own], axis=2)
        return projected(fixed, moved)

    def closed(
        self, members: DimensionBatch, samples: GoalStates, own: Array
    ) -> tuple[GoalStates, GoalRows, NDArray[np.bool_]]:
        """Return configurations with closed loops and fixed drivers, rows, and which are closed."""
        def judged(new: GoalRows, old: GoalRows) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
            better = new.open < old.open
            error = np.where(better, new.open, old.open)
            return better, error <= np.where(better, TOLERANCES.round_off, TOLERANCES.closed)

        there, rows = self._descended(
            members, self.placed(samples, own), own, lambda rows: rows, judged, FLOOR_DAMPING,
            FIRST_DAMPING, CLOSINGS)
        return there, rows, rows.open <= TOLERANCES.closed

    def exactly(
        self, members: DimensionBatch, samples: GoalStates, own: Array
    ) -> tuple[GoalStates, Array, NDArray[np.bool_]]:
        """Return closed configurations that meet the goal best, residuals, and which are closed.

        Each step closes the loops and moves along them towards the goal. Steps are compared by the
        goal errors that closed loops would have, to first order.
        """
        samples, rows, is_closed = self.closed(members, samples, own)
        if not is_closed.all():
            return samples, rows.wanted, is_closed

        def judged(new: _Along, old: _Along) -> tuple[NDArray[np.bool_], bool]:
            return (new.missed <= old.missed) & (new.open <= MOST_OPEN), False

        samples, _ = self._descended(
            members, samples, own, _Along.of, judged, FLOOR_DAMPING, FIRST_DAMPING)
        samples, rows, is_closed = self.closed(members, samples, own)
        return samples, rows.wanted, is_closed

    def slopes(
        self, members: DimensionBatch, around: DimensionBatch, widths: Array, samples: GoalStates,
        own: Array,
    ) -> Array:
        """Return their derivatives (k, r, n + n_own) at closed loops and the best timing."""
        rows, _ = self.rows(members, samples, own)
        held, wanted = self._at_rest(members, around, widths, samples, own)
        held = np.concatenate([held, rows.held_own], axis=2)
        wanted = np.concatenate([wanted, rows.wanted_own], axis=2)
        motions = padded_null_spaces(rows.held_moves, TOLERANCES.singular)
        along = -pseudo_inverses(rows.held_moves, TOLERANCES.singular) @ held
        whole = wanted + rows.wanted_moves @ along
        return projected(whole, rows.wanted_moves @ motions.transpose(0, 2, 1), rows.wanted)


class _Loose(NamedTuple):
    """Penalised residuals at m configurations."""

    residual: Array  # (m, r)
    slope: Array  # (m, r, nv)
    missed: Array  # (m,) sum of their squares

    def steps(self, damping: Array) -> Array:
        """Return Levenberg's steps (m, nv)."""
        return _steps(self.slope, self.residual, damping)


class _Along(NamedTuple):
    """Goal errors at m configurations with nearly closed loops, and motions along the loops."""

    back: Array  # (m, nv) steps that close the loops
    motions: Array  # (m, nv, nv) orthonormal motions that keep them closed, among rows of zeros
    rest: Array  # (m, r) goal errors after the closing steps
    slope: Array  # (m, r, nv) its derivatives along the motions
    missed: Array  # (m,) sum of squares of `rest`
    open: Array  # (m,) loop errors

    @classmethod
    def of(cls, rows: GoalRows) -> _Along:
        """Return them from equations."""
        inverse = pseudo_inverses(rows.held_moves, TOLERANCES.singular)
        back = -np.einsum("mvh,mh->mv", inverse, rows.held)
        motions = padded_null_spaces(rows.held_moves, TOLERANCES.singular)
        rest = rows.wanted + np.einsum("mrv,mv->mr", rows.wanted_moves, back)
        return cls(back, motions, rest, rows.wanted_moves @ motions.transpose(0, 2, 1),
                   np.einsum("mr,mr->m", rest, rest), rows.open)

    def steps(self, damping: Array) -> Array:
        """Return closing steps plus Levenberg steps along the motions (m, nv)."""
        return self.back + np.einsum("mzv,mz->mv", self.motions,
                                     _steps(self.slope, self.rest, damping))


def _steps(slope: Array, residual: Array, damping: Array) -> Array:
    """Return Levenberg steps (m, n); the longest component is half a radian at most."""
    steps = -damped_solutions(slope, residual, damping)
    longest = np.abs(steps).max(axis=1, initial=0.0)
    return steps * np.minimum(
        1.0, TOLERANCES.damped_step / np.maximum(longest, TOLERANCES.nothing))[:, None]


def spread(mechanism: Mechanism, q: Array, k: int, rng: np.random.Generator) -> Array:
    """Return random configurations (k, nq): angles within half a turn, slides within reach.

    Slides move by up to half a characteristic length, the usual range.
    """
    sizes = np.where([c.unit == "rad" for c in mechanism.coordinate_table.values()], np.pi,
                     0.5 * mechanism.characteristic_length)
    return np.array([pin.integrate(mechanism.model, q, sizes * rng.uniform(-1.0, 1.0, len(sizes)))
                     for _ in range(k)]).reshape(k, len(q))
