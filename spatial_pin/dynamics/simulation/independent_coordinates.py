"""Motion in independent coordinates: the loops are closed inside, at every evaluation.

The independent coordinates are entries of a chart about a closed configuration q0: x = q - q0 for
joints with one coordinate each, the rotation vector from q0 for joints that turn in space. With
K = [J; e] the closure rows and the unit rows of independent and prescribed velocities, velocities
are v = K^-1 [0; v_i], accelerations a = K^-1 [-gamma; a_i], and virtual work along the columns
G of the independent ones gives G^T (M a + b - f) = 0 [Wehage1982].
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.newton import rank_loss
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of
from spatial_pin.continuation.branch import TIGHT
from spatial_pin.errors import SingularError
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.numerics.linalg import (
    Array,
    Factors,
    decompose,
    independent_rows,
    pivots_of,
    rows_factored,
    rows_solved,
    weighty_rows,
)

MOST_CORRECTIONS = 8
CONTRACTION = 0.3  # a correction may be this fraction of the one before
EXPLAINED = 0.2  # part of a step that the prediction may leave unexplained
LONGEST = 0.7  # longest step in one go [rad, characteristic lengths]
HALVINGS = 10
SINGULAR = 1e-9  # smallest over largest pivot of K below which nothing can be solved
USELESS = 1e-7  # pivots below which no chart is begun
WORN = 1e-2  # of the pivots where a chart begins: there redundant rows are chosen anew
PLAIN = 0.1  # speed of a plain coordinate, by the fastest component's, at which it will do
CLOSED = 1e-22  # squared residual that ends a contraction by round-off


class Lost(Exception):
    """The loops cannot be closed at the coordinates asked for, or not surely on the branch."""


class Embedding:
    """A closed mechanism moved by its independent coordinates.

    Args:
        state: a closed configuration.
        independent: velocity entries that are free.
        prescribed: velocity entries that follow laws.
        tolerance: closure residual to reach [-]; loops with redundant equations are closed to
            1e-12 at least.

    Attributes:
        q: (nq,) present configuration.
        x: (n,) chart coordinates of it, independent ones first [scaled].
    """

    def __init__(
        self, state: State, independent: Sequence[int], prescribed: Sequence[int],
        tolerance: float,
    ) -> None:
        self.mechanism, self._wanted = state.mechanism, max(tolerance, 1e-14)
        self.model = state.mechanism.model
        self.scale = state.mechanism.velocity_scale
        self.evaluation = Evaluation(constraints_of(state.mechanism))
        self.n_rows = self.evaluation.constraints.n_rows
        self.curved = any(not PAIRS[pair].is_linear for pair in state.mechanism.pairs)
        self.places = {c.v: c.q for c in state.mechanism.coordinate_table.values() if c.q >= 0}
        self.base(state.q, state.angles, independent, prescribed)

    def base(
        self, q: Array, angles: Array, independent: Sequence[int], prescribed: Sequence[int]
    ) -> None:
        """Begin a chart at a closed configuration.

        Raises:
            SingularError: the coordinates do not determine the motion there.
        """
        self.held = [*independent, *prescribed]
        self.linear = not self.curved or all(v in self.places for v in self.held)
        self.at = np.array([self.places.get(v, -1) for v in self.held], dtype=int)
        self.q0, self.q = np.array(q), np.array(q)
        self.evaluation.turns[:] = angles
        self.evaluation.update(self.q)
        self.rows = independent_rows(self.evaluation.jacobian[: self.n_rows])
        self.whole = len(self.rows) == self.n_rows
        # open loops hide which equations depend on others, when the next chart is begun
        self.tolerance = self._wanted if self.whole else min(self._wanted, TIGHT)
        n, r = len(self.scale), len(self.rows)
        if r + len(self.held) != n:
            raise SingularError(
                f"mechanism {self.mechanism.name!r}: {n - r} freedoms at {q}, but "
                f"{len(self.held)} independent coordinates")
        self.k = np.zeros((n, n))
        self.k[np.arange(r, n), self.held] = 1.0
        self.rhs = np.zeros(n)
        self.units = np.zeros((n, len(self.held)))
        self.units[r:] = np.eye(len(self.held))
        self.ratio = self.scale / self.scale[self.held][:, None]
        self.x: Array = np.zeros(len(self.held))
        self._bend: tuple[Array, Array] | None = None
        self._factor()
        self.sign, self.pivot = pivots_of(self.lu, self.pivots)
        if self.pivot < USELESS:
            raise SingularError(f"mechanism {self.mechanism.name!r}: singular configuration")
        self._first_pivot = self.pivot
        self._set_columns()
        self.keep()

    def keep(self) -> None:
        """Take the present place for one to begin anew from, where the way from another is lost."""
        self._kept = self.q, self.x, self.evaluation.angles.copy()

    def _stand_at_kept(self) -> None:
        q, self.x, angles = self._kept
        self.q = q.copy()
        self.evaluation.turns[:] = angles
        self.evaluation.update(self.q)
        self._set_chart_rows(self.q)
        self._factor()
        self.pivot = pivots_of(self.lu, self.pivots)[1]
        self._set_columns()
        self._bend = None

    def _factor(self) -> bool:
        """Factor K, with what stands in its lower rows; False where it is singular."""
        jacobian = self.evaluation.jacobian
        self.k[: len(self.rows)] = jacobian[: self.n_rows] if self.whole else jacobian[self.rows]
        self.lu, self.pivots, is_regular = rows_factored(self.k)
        return is_regular

    def _solve(self, rhs: Array) -> Array:
        return rows_solved(self.lu, self.pivots, rhs)

    def _set_columns(self) -> None:
        """Set the scaled joint velocities (nv, n) per unit of held velocities, and of chart rates.

        Both are the same unless the chart is curved.
        """
        self._ahead = self.columns = self._solve(self.units)
        if not self.linear:
            self._chart = Factors(self._ahead[self.held]).solve(self.units[len(self.rows) :])
            self.columns = np.dot(self._ahead, self._chart)

    def coordinates(self, q: Array) -> Array:
        """Return the chart coordinates (n,) of a configuration, scaled."""
        if self.linear:
            return (q[self.at] - self.q0[self.at]) / self.scale[self.held]
        return (pin.difference(self.model, self.q0, q) / self.scale)[self.held]

    def chart_rates(self, v: Array) -> Array:
        """Return the rates (n,) of the chart coordinates at joint velocities v (nv,)."""
        held: Array = (v / self.scale)[self.held]
        return held if self.linear else np.dot(self._chart, held)

    def go(self, x: Array) -> None:
        """Move to the chart coordinates x (n,), on the same branch.

        A wild trial of an integrator may end where there is hardly a way back: then the way begins
        at the place that was kept last.

        Raises:
            Lost: it cannot; it stands at the place kept last.
        """
        x = np.array(x)  # integrators write on what they have asked for
        if np.isfinite(x).all():
            if self._goes(x):
                return
            self._stand_at_kept()
            if self._goes(x):
                return
            self._stand_at_kept()
        raise Lost

    def _goes(self, x: Array) -> bool:
        """Move to chart coordinates x (n,) in as many steps as it takes; whether it gets there."""
        start = self.x
        part, done = 1.0, 0.0
        while done < 1.0:
            fraction = min(1.0, done + part)
            goal = x if fraction == 1.0 else start + fraction * (x - start)
            if self._step(goal):
                done = fraction
                part *= 2.0
            elif part <= 0.5**HALVINGS:
                return False
            else:
                part *= 0.5
        return True

    def _step(self, x: Array) -> bool:
        """Move in one step; False, and nothing changed, where that is not safe."""
        evaluation = self.evaluation
        step = self._predict(x - self.x)
        size = math.sqrt(step.dot(step))
        if not size <= LONGEST:
            return False
        turns = evaluation.turns.copy()
        if turns.size:
            evaluation.turns[:] = evaluation.angles + evaluation.angle_jacobian @ step
        q = self._correct(pin.integrate(self.model, self.q, self.scale * step), x, size)
        if q is not None:
            self._set_chart_rows(q)
            if self._factor():
                sign, pivot = pivots_of(self.lu, self.pivots)
                if sign == self.sign and pivot > SINGULAR:
                    self.q, self.x, self.pivot = q, x, pivot
                    self._set_columns()
                    self._bend = None
                    if turns.size:
                        evaluation.turns[:] = evaluation.angles
                    return True
        evaluation.turns[:] = turns
        evaluation.update(self.q)
        self._set_chart_rows(self.q)
        self._factor()
        return False

    def _predict(self, dx: Array) -> Array:
        """Return the scaled step (nv,) for a change of the chart coordinates, of second order.

        The second derivatives are known along the velocity at which `bias` was asked for.
        """
        step: Array = np.dot(self._ahead, dx)
        if self._bend is not None:
            rates, bend = self._bend
            way = dx.dot(rates)
            step += (0.5 * way * way) * bend
        return step

    def _correct(self, q: Array, x: Array, predicted: float) -> Array | None:
        """Newton steps to the closed configuration with chart coordinates x; None if astray."""
        last = math.inf
        evaluation, rhs, r = self.evaluation, self.rhs, len(self.rows)
        for k in range(MOST_CORRECTIONS):
            if self.linear:
                q[self.at] = self.q0[self.at] + self.scale[self.held] * x
            evaluation.update(q)
            residual = evaluation.residual
            error = float(residual.dot(residual))
            if not self.linear:
                rhs[r:] = off = x - self.coordinates(q)
                error += float(off.dot(off))
            if error <= self.tolerance**2:
                return q
            if k == 0:  # later corrections are too small to change them
                self._set_chart_rows(q)
            if not self._factor():
                return None
            np.negative(residual if self.whole else residual[self.rows], out=rhs[:r])
            correction = self._solve(rhs)
            size = math.sqrt(correction.dot(correction))
            if k == 0 and not size <= EXPLAINED * predicted + 1e-9:
                return None
            if k and not size <= CONTRACTION * last:
                return q if error <= CLOSED else None
            last = max(size, 1e-14)
            q = pin.integrate(self.model, q, self.scale * correction)
        return None

    def _set_chart_rows(self, q: Array) -> None:
        """Let K hold the derivatives of the chart coordinates by scaled joint velocities at q."""
        if not self.linear:
            slopes = pin.dDifference(self.model, self.q0, q, pin.ARG1)[self.held]
            np.multiply(slopes, self.ratio, out=self.k[len(self.rows) :])

    def velocity(self, held: Array) -> Array:
        """Return the joint velocities (nv,) for the held ones (n,)."""
        return self.scale * np.dot(self.columns, held / self.scale[self.held])

    def bias(self, v: Array) -> Array:
        """Return the joint accelerations (nv,) at velocities v when the held ones have none."""
        gamma = self.evaluation.bias(self.q, v)[: self.n_rows]
        r = len(self.rows)
        self.rhs[:r] = -(gamma if self.whole else gamma[self.rows])
        self.rhs[r:] = 0.0
        bend = self._solve(self.rhs)
        if not self.linear:
            bend -= np.dot(self.columns, bend[self.held])
        rates = self.chart_rates(v)
        square = rates.dot(rates)
        if square > 0.0:
            self._bend = rates / square, bend
        return self.scale * bend

    @property
    def has_worn_rows(self) -> bool:
        """Whether other closure rows than were chosen where the chart began would do better."""
        return not self.whole and self.pivot < WORN * self._first_pivot

    @property
    def pace(self) -> float:
        """How many times faster than the fastest held, or chart, coordinate another one may move.

        A curved chart folds elsewhere than the velocities at its joints.
        """
        pace = float(np.abs(self.columns).max(initial=1.0))
        return pace if self.linear else max(pace, float(np.abs(self._ahead).max()))


def best_coordinates(state: State, prescribed: Sequence[int]) -> list[int]:
    """Return the velocity entries that determine the motion best, besides the prescribed ones.

    Column-pivoted QR of the freedoms: joints that move most.

    Args:
        state: where.
        prescribed: velocity entries that follow laws.

    Raises:
        SingularError: prescribed coordinates depend on each other, or the loops have lost rank.
    """
    drive = np.zeros((len(prescribed), state.mechanism.model.nv))
    drive[np.arange(len(prescribed)), list(prescribed)] = 1.0
    freedoms = _freedoms(state, drive)
    if not len(freedoms):
        return []
    return weighty_rows(freedoms.T, len(freedoms)).tolist()


def plain_coordinates(state: State, apart: Array) -> list[int]:
    """Return the velocity entries of joints that can tell one freedom, the fastest first.

    Args:
        state: where.
        apart: (k, nv) freedoms that are not to be determined; one more is left.

    Raises:
        SingularError: the loops have lost rank.
    """
    speeds = np.abs(_freedoms(state, apart)[0])
    plain = [c.v for c in state.mechanism.coordinate_table.values() if c.q >= 0]
    enough = PLAIN * speeds.max()
    return sorted((v for v in plain if speeds[v] > enough), key=lambda v: -speeds[v])


def _freedoms(state: State, drive: Array) -> Array:
    """Return orthonormal rows (n, nv), scaled, of the motions that drive (k, nv) leaves."""
    mechanism = state.mechanism
    evaluation = Evaluation(constraints_of(mechanism))
    evaluation.turns[:] = state.angles
    evaluation.update(state.q)
    n = evaluation.constraints.n_rows
    rows = independent_rows(evaluation.jacobian[:n])
    if rank_loss(evaluation, state.q, len(rows)):
        raise SingularError(
            f"mechanism {mechanism.name!r}: singular configuration, {state}: branches cross there "
            "and the motion is not determined; start beside it", state=state)
    evaluation.update(state.q)
    svd = decompose(np.vstack([evaluation.jacobian[rows], drive]))
    if svd.rank < len(rows) + len(drive):
        raise SingularError(
            f"mechanism {mechanism.name!r}: the prescribed coordinates are not independent of each "
            f"other at {state}", state=state)
    return svd.null_space
