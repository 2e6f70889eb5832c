"""Least squares of targets' residuals, on closed loops and within joint limits.

Gauss's steps go quickly to what can be reached. Towards what cannot, they creep: they leave out how
residuals and loops bend, which counts in proportion to what stays off. There Newton's steps are
made on the Lagrangian [NocedalWright2006, 18], along the freedoms that are left; they also lead
away from dead centres and folded positions at which the distance is greatest, not least.

Joint limits are kept by an active set: a joint that a step takes beyond its limit stands there,
until a step would take it back.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin.inverse_kinematics.constrained import Constrained, Held, Lagrangian
from spatial_pin.inverse_kinematics.targets import Target
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

STEPS_AT_MOST = 200  # of a level: Newton's take ten, towards what is far away some dozens
SLOW_STEPS = 2  # that leave more than half, after which Newton's are made: Gauss's creep
# First damping where a step did not help, relative to the largest singular value.
LEAST_DAMPING = 1e-3
MOST_DAMPING = 1e6  # with which nothing moves any more
NO_LONGER = 1e-9  # rad, characteristic lengths: how far off a least sum may be
# By how much of the square of a Gauss step what is kept may be off on the way: such a step itself
# misses by its square, and the last ones are so short that all digits are kept.
OFF_ON_THE_WAY = 1e-3
# Residuals that a step leaves where it goes to a dead centre, a double root: about a quarter.
DOUBLE_ROOT = 0.15, 0.35
# Part of the way to the vertex that is gone, so that what is asked for keeps a slope: what is left
# of residuals is a quarter of a millionth.
NEARLY_THERE = 0.9995


class DescentPoint(NamedTuple):
    """Where a descent stands."""

    q: Array  # (nq,) configuration
    held: Held  # joint limits that it stands at
    size: float  # length of the residuals that are wanted small


class StepPolicy:
    """How steps are made, judged by those before: with which damping, and whether by Newton."""

    def __init__(self, off: float) -> None:
        self.damping, self._slow, self._off = 0.0, 0, off

    def off(self, step: Array) -> float:
        """Return by how much what is kept may be off behind a step."""
        return 0.0 if self.is_bent else self._off * float(step @ step)

    @property
    def is_bent(self) -> bool:
        """Whether steps are Newton's."""
        return self._slow >= SLOW_STEPS

    @property
    def converges(self) -> bool:
        """Whether steps are such that the next would be far shorter, if this one is short."""
        return self.is_bent and self.damping < TOLERANCES.half_precision

    def judge(self, left: float, moved: float) -> None:
        """Take note of what a step has left of the residuals."""
        self.damping *= 0.1
        if left < 0.1:
            self._slow = 0
        elif left > 0.5 and moved < 0.99 * TOLERANCES.damped_step:
            self._slow += 1

    def fails(self) -> bool:
        """Damp after a step that did not help; whether nothing moves any more."""
        self.damping = max(LEAST_DAMPING, 4.0 * self.damping)
        self._slow += 1
        return self.damping > MOST_DAMPING

    def bends(self) -> bool:
        """Damp no more, and let steps be Newton's; whether they were not."""
        self.damping, was_bent = 0.0, self.is_bent
        self._slow = max(self._slow, SLOW_STEPS)
        return not was_bent


class Descent:
    """The way down to where the sum of squared residuals is least.

    Attributes:
        base: the mechanism.
        kept: targets that stay met.
        wanted: targets whose residuals are to become small.
    """

    def __init__(
        self, base: Constrained, kept: Sequence[Target], wanted: Sequence[Target]
    ) -> None:
        self.base, self.kept, self.wanted = base, kept, wanted
        self._pace = StepPolicy(OFF_ON_THE_WAY)
        # Lagrangians at a configuration, by what may move
        self._known: tuple[Array, dict[bytes, Lagrangian]] = np.empty(0), {}

    def run(self, q: Array, held: Held) -> tuple[Array, Held, bool]:
        """Go down from a configuration (nq,) and the limits it stands at.

        Returns:
            The configuration, the limits that hold it, and whether it went on by long steps until
            these ran out.
        """
        for off in (OFF_ON_THE_WAY, 0.0):
            self._pace = StepPolicy(off)
            place, is_on_its_way = self._down(DescentPoint(q, held, self._size(q)))
            whole = self.base.kept(place.q, self.base.stops.free(place.held), self.kept)
            if whole is not None:  # else it went where what is kept cannot be met
                return whole, place.held, is_on_its_way
        return place.q, place.held, is_on_its_way

    def _down(self, place: DescentPoint) -> tuple[DescentPoint, bool]:
        """Return where the way down ends, as `run`; what is kept may be off by a little."""
        moved = 0.0
        for _ in range(STEPS_AT_MOST):
            # limits that a free step, of some of them released, would not leave
            held = dict(place.held)
            for v in place.held:
                if self.push(place.q, held, v) < -TOLERANCES.nothing * place.size:
                    del held[v]
            place = place._replace(held=held)
            before, (step, now_held) = place.q, self._step(place)
            moved = math.sqrt(step.dot(step))
            there = self._landed(place.q, step, now_held)
            is_last = moved < (TOLERANCES.half_precision if self._pace.converges else NO_LONGER)
            if there is not None and self._is_as_good(there, place, moved):
                is_last = is_last and there.held.keys() == place.held.keys()
                if not self._pace.is_bent:
                    there = self._to_vertex(place, step, there)
                self._pace.judge(there.size / place.size if place.size else 0.0, moved)
                place = there
                if place.size <= self.base.tolerance:
                    return place, False
            else:
                is_last = self._pace.fails() or is_last
            if is_last:
                onward = self._onward(place, before)
                if onward is None:
                    return place, False
                place = onward
        return place, moved > 0.5 * TOLERANCES.damped_step

    def _to_vertex(self, place: DescentPoint, step: Array, there: DescentPoint) -> DescentPoint:
        """Return where a Gauss step leads that goes as far as residuals go as a parabola along it.

        Towards a dead centre, a double root, every step is half as long as the one before. With r
        at its start and c where it ends, (1 - t) r + t² c is zero farther on, at a t up to 2.
        """
        least, most = DOUBLE_ROOT
        if place.held.keys() != there.held.keys() or not (
                least * place.size < there.size < most * place.size):
            return there
        first, last = (self.base.residual(x.q, self.wanted)[0] for x in (place, there))
        bent = float(first @ last) / place.size**2
        longer = min(2.0 * NEARLY_THERE, 2.0 / (1.0 + max(1.0 - 4.0 * bent, 0.0) ** 0.5))
        farther = self._landed(place.q, longer * step, place.held)
        return farther if farther and farther.size < 0.5 * there.size else there

    def _size(self, q: Array) -> float:
        residual = self.base.residual(q, self.wanted)[0]
        return math.sqrt(residual.dot(residual))

    def _is_as_good(self, there: DescentPoint, place: DescentPoint, moved: float) -> bool:
        """Whether a step is to be made: not one that only stands still, or goes up."""
        if there.size < place.size:
            return True
        if there.held.keys() != place.held.keys():
            return there.size <= place.size * (1.0 + TOLERANCES.nothing)
        if self._pace.is_bent and moved < TOLERANCES.half_precision:  # sums tell no places apart
            return there.size <= place.size * (1.0 + TOLERANCES.tight)
        return there.size <= self.base.tolerance

    def _onward(self, place: DescentPoint, before: Array) -> DescentPoint | None:
        """Return where to go on from a place that steps do not leave; None if it is the least.

        The last, short step came from the configuration `before`.
        """
        if place.size <= self.base.tolerance:
            return None
        if self._pace.bends():
            return place
        at, known = self._known
        slope = known.get(self.base.stops.free(place.held).tobytes()) if at is before else None
        if slope is not None and slope.off_summit() is None:
            return None
        way = self._slope(place.q, place.held).off_summit()
        if way is None:
            return None
        best = place
        for side in (1.0, -1.0):
            there = self._landed(place.q, side * TOLERANCES.trial_step * way, place.held)
            if there is not None and there.size < best.size * (1.0 - TOLERANCES.round_off):
                best = there
        return None if best is place else best



    def _step(self, place: DescentPoint) -> tuple[Array, Held]:
        """Return a scaled step (nv,), and the limits that it stops at."""
        held = dict(place.held)
        while True:
            if self._pace.is_bent:
                step = self._slope(place.q, held).newton_step(self._pace.damping)
            else:
                motions = self.base.motions(place.q, self.base.stops.free(held), self.kept)
                residual, rows = self.base.residual(place.q, self.wanted)
                step = damped(rows @ motions.T, -residual, self._pace.damping) @ motions
            length = math.sqrt(step.dot(step))
            if length > TOLERANCES.damped_step:
                step *= TOLERANCES.damped_step / length
            passed = self.base.stops.passed(place.q, step, held)
            if passed is None:
                return step, held
            held[passed.v] = passed

    def _landed(self, q: Array, step: Array, held: Held) -> DescentPoint | None:
        """Return where a step leads, what is kept met again, within limits; None if too far."""
        base = self.base
        while True:
            there = base.kept(base.stops.moved(q, step, held), base.stops.free(held), self.kept,
                              self._pace.off(step))
            if there is None:
                return None
            beyond = base.stops.beyond(there, held, q)
            if not beyond:
                return DescentPoint(there, held, self._size(there))
            held = held | beyond

    def is_single(self, q: Array, held: Held) -> bool:
        """Whether the sum is clearly curved along all motions at a place where it is least."""
        slope = self._slope(q, held)
        parts = self.base.residual(q, self.wanted)[1] @ slope.motions.T
        sizes = np.abs(slope.curvature[0])  # what residuals' bending cancels is known to 1e-6 of it
        return bool(np.all(sizes > TOLERANCES.regular * np.linalg.norm(parts) ** 2))

    def push(self, q: Array, held: Held, v: int) -> float:
        """Return how far a free step goes beyond the limit that the joint at `v` stands at."""
        without = {k: x for k, x in held.items() if k != v}
        motions = self.base.motions(q, self.base.stops.free(without), self.kept)
        residual, rows = self.base.residual(q, self.wanted)
        step = -(residual @ rows @ motions.T) @ motions
        return float(held[v].side * step[v])



    def _slope(self, q: Array, held: Held) -> Lagrangian:
        """Return what tells of half the square, along freedoms between limits held."""
        if self._known[0] is not q:
            self._known = q, {}
        known, free = self._known[1], self.base.stops.free(held)
        if free.tobytes() not in known:
            known[free.tobytes()] = Lagrangian(self.base, self.kept, self.wanted, q, free)
        return known[free.tobytes()]


def damped(a: Array, b: Array, damping: float) -> Array:
    """Return x (n,) with a x = b as nearly as can be, of least norm; damped as Levenberg does."""
    svd = decompose(a, TOLERANCES.singular)
    if not svd.rank:
        return np.zeros(a.shape[1])
    s = svd.s[: svd.rank]
    parts = s / (s * s + damping * svd.s[0] ** 2)
    return (parts * (svd.u[:, : svd.rank].T @ b)) @ svd.vt[: svd.rank]
