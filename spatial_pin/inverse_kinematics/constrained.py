"""Closed loops, and targets that are kept, while a mechanism moves within its joint limits.

How a sum of squared residuals bends there the second derivatives of its Lagrangian tell: that is
half the sum, and the equations of the loops and of what is kept, each times what it weighs at a
configuration [NocedalWright2006, 12.3]. First derivatives are differenced; residuals stay as they
are at the configuration, as what their changes add to the curvature is known exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import closed
from spatial_pin.inverse_kinematics.targets import Residual, Target
from spatial_pin.kernel.closer import Closed
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.joint_limits import SLACK, JointLimit
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, Decomposition, Triangular, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

CORRECTIONS = 8  # Newton's, after steps that nearly keep what is kept: four do as a rule
Held = dict[int, JointLimit]  # by place in the velocity: limits that joints stand at


class Stops:
    """Which velocities may move, and the joint limits within which they do.

    Attributes:
        limits: joint limits to keep.
        scale: (nv,) velocity of a unit of each unknown.
        moves: (nv,) which velocities may move.
    """

    def __init__(
        self, mechanism: Mechanism, limits: Sequence[JointLimit], still: Sequence[int]
    ) -> None:
        self._model, self.limits, self.scale = mechanism.model, limits, mechanism.velocity_scale
        self._limited = np.array([limit.q for limit in limits], dtype=np.intp)
        self._ends = np.array([(x.side, x.side * x.value + SLACK * x.size) for x in limits])
        self.moves = np.ones(len(self.scale), dtype=bool)
        self.moves[list(still)] = False

    def free(self, held: Held) -> NDArray[np.bool_]:
        """Return which velocities may move (nv,) where joints stand at limits."""
        free = self.moves.copy()
        free[list(held)] = False
        return free

    def moved(self, q: Array, step: Array, held: Held) -> Array:
        """Return the configuration a scaled step (nv,) away, held joints at their limits."""
        found: Array = pin.integrate(self._model, q, self.scale * step)
        for limit in held.values():
            found[limit.q] = limit.value
        return found

    def passed(self, q: Array, step: Array, held: Held) -> JointLimit | None:
        """Return the limit that a step passes first, or None."""
        first, part, ways = None, 1.0, (step * self.scale * self.moves).tolist()
        for limit in self.limits:
            way = limit.side * ways[limit.v]
            if way <= 0.0 or limit.v in held:
                continue
            room = max(float(limit.room(q)), 0.0)
            if way > room and room / way < part:
                first, part = limit, room / way
        return first

    def beyond(self, q: Array, held: Held, before: Array | None = None) -> Held:
        """Return limits that q is beyond, and farther than another configuration was."""
        if not self.limits or np.all(q[self._limited] * self._ends[:, 0] <= self._ends[:, 1]):
            return {}
        found = {}
        for limit in self.limits:
            room = float(limit.room(q))
            allowed = 0.0 if before is None else min(float(limit.room(before)), 0.0)
            if limit.v not in held and self.moves[limit.v] and room < allowed - SLACK * limit.size:
                found[limit.v] = limit
        return found


class Constrained:
    """A mechanism whose loops stay closed, with joint limits.

    Attributes:
        evaluation: its closure equations.
        stops: its joint limits, and what may move.
        scale: (nv,) velocity of a unit of each unknown.
        tolerance: length of the residuals at which targets are reached.
    """

    def __init__(
        self, evaluation: LoopEquations, limits: Sequence[JointLimit], still: Sequence[int],
        tolerance: float,
    ) -> None:
        self.evaluation, self.tolerance = evaluation, tolerance
        self.stops = Stops(evaluation.mechanism, limits, still)
        self.scale = self.stops.scale
        # the last two residuals, with configuration and targets: they are asked for again and again
        self._known: list[tuple[Array, Sequence[Target], tuple[Array, Array]]] = []
        # at a configuration, by what moves and the identity of what is kept: what is kept, so that
        # its identity is its own, and the decomposed derivatives, or motions that keep it
        self._linear_at: Array = np.empty(0)
        self._linear: dict[tuple[bytes, int], tuple[Sequence[Target], Decomposition]] = {}
        self._motions: dict[tuple[bytes, int, bool], tuple[Sequence[Target], Array]] = {}
        self._last: Closed | None = None  # where closing led

    def residual(self, q: Array, targets: Sequence[Target]) -> tuple[Array, Array]:
        """Return weighted residuals (k,) and derivatives (k, nv) for scaled velocities."""
        self.stand(q)
        if not targets:
            return np.empty(0), np.empty((0, len(self.scale)))
        for at, known, found in self._known:
            if at is q and known is targets:
                return found
        parts = []
        for target in targets:
            residual, rows = target.residual(self.evaluation)
            weight = 1.0 if target.weight is None else target.weight
            parts.append((weight * residual, rows * (weight * self.scale)))
        found = parts[0] if len(parts) == 1 else (
            np.concatenate([r for r, _ in parts]), np.concatenate([j for _, j in parts]))
        self._known = [*self._known[-1:], (q, targets, found)]
        return found

    def pulled(self, targets: Sequence[Target], forces: Array) -> Array:
        """Return the sum (nv,) of forces (k,) times derivatives of residuals, where they stand."""
        found = np.zeros(len(self.scale))
        for target in targets:
            pulled, forces = target.pulled(self.evaluation, forces)
            found += pulled if target.weight is None else target.weight * pulled
        return found * self.scale

    def stand(self, q: Array) -> None:
        """Evaluate the equations at q (nq,), if they do not stand there."""
        if self.evaluation.q is not q:
            self.evaluation.update(q)

    def closed(self, q: Array, free: NDArray[np.bool_]) -> Array:
        """Return a configuration with its loops closed by what is free (nv,) to move."""
        evaluation, last = self.evaluation, self._last
        if last is None or last.q is not q or last.error > TOLERANCES.round_off:
            last = self._last = closed(evaluation.mechanism, q, free, evaluation.angle_reference,
                                       TOLERANCES.round_off)
        self.stand(last.q)
        return last.q

    def motions(
        self, q: Array, free: NDArray[np.bool_], kept: Sequence[Target], idle: bool = True
    ) -> Array:
        """Return orthonormal rows (k, nv) of motions that keep loops closed and targets met.

        Idle rotations are among them, unless they are not wanted: a target may ask for one.
        """
        key = (free.tobytes(), id(kept), idle)
        self._forget_all_but(q)
        if key not in self._motions:
            basis = Triangular(self._rows(q, free, kept, idle)).null_space
            found = np.zeros((len(basis), len(free)))
            found[:, free] = basis
            self._motions[key] = kept, found
        return self._motions[key][1]

    def linearised(
        self, q: Array, free: NDArray[np.bool_], kept: Sequence[Target]
    ) -> Decomposition:
        """Return the decomposed derivatives (k, n) of loops and targets for what is free (n,)."""
        key = (free.tobytes(), id(kept))
        self._forget_all_but(q)
        if key not in self._linear:
            self._linear[key] = kept, decompose(self._rows(q, free, kept, True))
        return self._linear[key][1]

    def _forget_all_but(self, q: Array) -> None:
        """Forget what is known at another configuration than this."""
        if self._linear_at is not q:
            self._linear_at, self._linear, self._motions = q, {}, {}

    def _rows(
        self, q: Array, free: NDArray[np.bool_], kept: Sequence[Target], idle: bool
    ) -> Array:
        _, rows = self.residual(q, kept)
        closures = self.closures() if idle else self.evaluation.jacobian
        return (np.concatenate([closures, rows]) if kept else closures)[:, free]

    def closures(self) -> Array:
        """Return the derivative (k, nv) of the loops' equations, none of idle rotations."""
        return self.evaluation.jacobian[: self.evaluation.constraints.n_closure]

    def kept(
        self, q: Array, free: NDArray[np.bool_], kept: Sequence[Target], off: float = 0.0
    ) -> Array | None:
        """Return q with its loops closed and targets met again; None if that takes too far.

        Args:
            q: (nq,) where it begins.
            free: (nv,) which velocities may move.
            kept: the targets.
            off: length of the residuals that may be left.
        """
        q, last = self.closed(q, free), np.inf
        for _ in range(CORRECTIONS):
            residual, _ = self.residual(q, kept)
            size = math.sqrt(residual.dot(residual))
            if size <= max(TOLERANCES.last_digit, off) or (
                    size <= self.tolerance and size > 0.5 * last):
                return q if self.is_closed(q) else None
            if size > min(TOLERANCES.unexplained, last):
                return None
            last = size
            step = np.zeros(len(free))
            step[free] = Triangular(self._rows(q, free, kept, True)).minimum_norm(
                np.concatenate([-self.evaluation.residual, -residual]))
            q = self.closed(pin.integrate(self.evaluation.model, q, self.scale * step), free)
        return q if last <= self.tolerance and self.is_closed(q) else None

    def is_closed(self, q: Array) -> bool:
        """Whether loops are closed at q (nq,), no axis turned round; equations stand there."""
        self.stand(q)
        evaluation, last = self.evaluation, self._last
        if last is not None and last.q is q and not last.may_be_mirrored:
            return last.error <= TOLERANCES.closed
        return evaluation.closure_error <= TOLERANCES.closed and not evaluation.mirrored()

    def within(self, q: Array) -> tuple[Array, Held]:
        """Return a configuration with its loops closed within the limits, if they close there.

        Joints that were beyond limits stand at them.
        """
        stops = self.stops
        closed, held = self.closed(q, stops.moves), Held()
        while beyond := stops.beyond(closed, held):
            held |= beyond
            tried = self.kept(
                stops.moved(closed, np.zeros(len(self.scale)), held), stops.free(held), [])
            if tried is None:
                return closed, {}
            closed = tried
        return closed, held


CURVATURE_STEP = 1e-6  # of one-sided differences: half of their digits are good
GRADIENT_STEP = 1e-4  # of central ones [rad, characteristic lengths]: they leave 1e-9 to 1e-11


class Lagrangian:
    """The Lagrangian at a configuration.

    Attributes:
        motions: (k, nv) that keep loops closed and targets met.
        slope: (nv,) the derivative of half the sum.
        gradient: (k,) this along the motions; zero where it is no more than round-off.
        least: the curvature that is clearly one, however little others are.

    Args:
        base: the mechanism.
        kept: targets that stay met.
        wanted: targets whose residuals are squared.
        q: (nq,) the configuration.
        free: (nv,) which velocities may move.
    """

    def __init__(
        self, base: Constrained, kept: Sequence[Target], wanted: Sequence[Target], q: Array,
        free: NDArray[np.bool_],
    ) -> None:
        self.base, self._kept, self._wanted, self._q, self._free = base, kept, wanted, q, free
        residual, self._rows = base.residual(q, wanted)
        self.motions = base.motions(q, free, kept)
        multipliers = base.linearised(q, free, kept).minimum_norm_transposed(
            -(residual @ self._rows)[free])
        n = base.evaluation.constraints.n_closure
        self._closures = multipliers[:n]
        self._forces = (wanted, residual), (kept, multipliers[n:])
        self.slope = residual @ self._rows
        most = float(np.linalg.norm(self._rows[:, free]))
        self.least = max(TOLERANCES.nothing * most**2, TOLERANCES.zero)
        self.gradient = self.motions @ self.slope
        if np.linalg.norm(self.gradient) <= TOLERANCES.round_off * most * np.linalg.norm(residual):
            self.gradient = np.zeros(len(self.motions))

    def at(self, q: Array) -> Lagrangian:
        """Return that of the same sum at another configuration."""
        return Lagrangian(self.base, self._kept, self._wanted, q, self._free)

    def _gradient(self, q: Array) -> Array:
        self.base.stand(q)
        found: Array = self._closures @ self.base.closures()
        for targets, forces in self._forces:
            found += self.base.pulled(targets, forces)
        return found

    def _ahead(self, way: Array) -> Array:
        """Return the derivative (nv,) a scaled displacement (nv,) away."""
        base = self.base
        return self._gradient(pin.integrate(base.evaluation.model, self._q, base.scale * way))

    @cached_property
    def curvature(self) -> tuple[Array, Array]:
        """Curvatures (k,) along its principal directions, rising, and these (k, k) in columns.

        They are good to half of the digits.
        """
        motions, here = self.motions, self._gradient(self._q)
        parts = self._rows @ motions.T
        bent = [motions @ (self._ahead(CURVATURE_STEP * way) - here) for way in motions]
        found = np.reshape(bent, 2 * motions.shape[:1]) / CURVATURE_STEP
        sizes, ways = np.linalg.eigh(parts.T @ parts + 0.5 * (found + found.T))
        return sizes, ways

    def newton_step(self, damping: float) -> Array:
        """Return Newton's step (nv,), which goes down where the curvature is negative too."""
        if not len(self.gradient):
            return np.zeros(self.motions.shape[1])
        sizes, ways = self.curvature
        size, along = np.abs(sizes), ways.T @ self.gradient
        most = max(float(size.max()), self.least)
        # What is flat, as an idle rotation is, comes last: differences leave some millionths of
        # other ways in it, and so of their gradients, over a curvature that is nothing.
        is_flat = size <= TOLERANCES.half_precision * most
        along[is_flat & (np.abs(along) <= TOLERANCES.regular * np.abs(along).max())] = 0.0
        parts = along / (np.maximum(size, TOLERANCES.nothing * most) + damping * most)
        return -(ways @ parts) @ self.motions

    def off_summit(self) -> Array | None:
        """Return the way (nv,) that it bends down most along; None where it does not."""
        sizes, ways = self.curvature
        size = np.abs(sizes).max(initial=self.least)
        if not len(sizes) or sizes[0] >= -TOLERANCES.half_precision * size:
            return None
        way: Array = ways[:, 0] @ self.motions
        return way if way[np.argmax(np.abs(way))] > 0.0 else -way

    def changes(self, ways: Array) -> Array:
        """Return the second derivative (k, nv), along the motions, for scaled velocities (k, nv).

        To 1e-9 and better.
        """
        steps = [GRADIENT_STEP / max(float(np.linalg.norm(way)), TOLERANCES.zero) for way in ways]
        bent = [(self._ahead(h * way) - self._ahead(-h * way)) / (2.0 * h)
                for h, way in zip(steps, ways, strict=True)]
        found = ways @ self._rows.T @ self._rows + np.reshape(bent, ways.shape)
        return found @ self.motions.T @ self.motions

    def curved(self) -> tuple[Array, Array]:
        """Return sizes (k,) and scaled velocities (k, nv) of the directions it is curved along."""
        motions, slope = self.motions, self._rows @ self.motions.T
        curvature = self.changes(motions) @ motions.T
        sizes, ways = np.linalg.eigh(0.5 * (curvature + curvature.T))
        # what the residuals' bending may cancel; NumPy 2.0 has no norm of an empty matrix
        parts = float(np.linalg.norm(slope, ord=2)) ** 2 if slope.size else 0.0
        most = max(parts, float(np.abs(sizes).max(initial=0.0)))
        curved = np.abs(sizes) > max(TOLERANCES.half_precision * most, self.least)
        return sizes[curved], ways.T[curved] @ motions


@dataclass(frozen=True, eq=False, kw_only=True)
class Stationary(Target):
    """The sum's derivative is zero along directions (k, nv) in which its curvature is `sizes`.

    Residuals that cannot be met may change without their sum: an axis that is normal to a direction
    stays normal to it however it turns, and the angle between them, as a vector, turns with it.
    """

    sum: Lagrangian
    sizes: Array
    ways: Array

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: how far it is from the least sum along each direction.

        The derivative is that along the motions that there are: other targets and the loops see to
        the rest.
        """
        q, half = evaluation.q, self.sum.at(evaluation.q)
        ways = self.ways / self.sizes[:, None] @ half.motions.T @ half.motions
        found, rows = ways @ half.slope, half.changes(ways) / half.base.scale
        half.base.stand(q)
        return found, rows

    def pulled(self, evaluation: LoopEquations, forces: Array) -> tuple[Array, Array]:
        """See `Target`: one way is enough, as second derivatives do not depend on the order."""
        q, half, n = evaluation.q, self.sum.at(evaluation.q), len(self.sizes)
        way = (forces[:n] / self.sizes) @ self.ways @ half.motions.T @ half.motions
        found = half.changes(way[None])[0] / half.base.scale
        half.base.stand(q)
        return found, forces[n:]
