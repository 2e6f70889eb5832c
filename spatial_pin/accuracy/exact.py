"""Exact samples of a sweep: positions, velocities and accelerations refined in extended precision.

Newton corrections with a matrix in double precision and residuals in extended precision
(`spatial_pin.accuracy.extended`) are iterated until they no longer shrink
[GolubVanLoan2013, 3.5.3]. The last ones show how accurate the samples are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.accuracy.extended import EPS, Extended, Long
from spatial_pin.assembly.close import close
from spatial_pin.assembly.holding import still_entries
from spatial_pin.assembly.square_system import SINGULAR_PIVOT, SquareSystem
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.errors import SingularError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

# Newton steps in extended precision, with factors in double: each takes off a digit at least where
# pivots are above 1e-15 of the largest, and from 1e-11 to 1e-19 there are eight.
REFINEMENTS = 12


class Exact(NamedTuple):
    """Rows in extended precision.

    Attributes:
        q, v, a: (N, nq), (N, nv), (N, nv).
        good: (N,) whether the sample is determined, and was found.
        left: (3,) last corrections of positions [-], and of velocities and accelerations by the
            largest.
        passive: (N, k, nv) passive freedoms, scaled, of unit length.
    """

    q: Array
    v: Array
    a: Array
    good: NDArray[np.bool_]
    left: Array
    passive: Array

    def sizes(self, scale: Array) -> Array:
        """Return what errors of positions, velocities and accelerations are counted by (3,).

        1, the largest velocity, and the largest acceleration or square of a velocity.
        """
        v, a = (float(np.abs(x[self.good] / scale).max(initial=0.0)) for x in (self.v, self.a))
        return np.array([1.0, v or 1.0, max(a, v * v) or 1.0])


class _Systems(NamedTuple):
    """The square linear systems of N samples, as `SquareSystem` makes them.

    Attributes:
        q: (N, nq) closed in double precision.
        inverses: (N, nv, nv); zero where the sample is not good.
        rows: (N, r) closure equations they hold.
        null: (N, k, nv) unresolved passive freedoms, their last rows.
        good: (N,) whether they are regular.
    """

    q: Array
    inverses: Array
    rows: NDArray[np.intp]
    null: Array
    good: NDArray[np.bool_]


class ExactRows:
    """The samples at given driver values, rates of the first driver given, the others at rest.

    Args:
        mechanism: the mechanism.
        driven: prescribed coordinates, the one that moves first.
        values: (N, len(driven)) theirs.
        speed, acceleration: (N,) of the first.
    """

    def __init__(
        self, mechanism: Mechanism, driven: Sequence[Coordinate], values: Array, speed: Array,
        acceleration: Array,
    ) -> None:
        self.mechanism, self.driven, self.values = mechanism, driven, values
        self.speed, self.acceleration = speed, acceleration
        self.extended = Extended(mechanism)
        self.scale = mechanism.velocity_scale
        self.at = [c.q for c in driven]
        self.moved = [*(c.v for c in driven), *still_entries(mechanism, driven)]

    def near(self, q: Array, turns: Array) -> Exact:
        """Return the exact samples nearest to q (N, nq), passive freedoms left as they are.

        Args:
            q: configurations about closed.
            turns: (N, n) relative angles of screw closures to within half a turn [rad].
        """
        systems = self._systems(q, turns)
        good, n, nv = systems.good, len(q), self.mechanism.model.nv
        x = systems.q.astype(Long)
        v, a = np.zeros((n, nv), dtype=Long), np.zeros((n, nv), dtype=Long)
        last = np.full(3, np.inf)
        for _ in range(REFINEMENTS):
            x[:, self.at] = self.values
            missing = self._missing(x, v, a, turns, systems)
            steps = np.einsum("nij,knj->kni", systems.inverses, missing)
            x = self.extended.integrate(x, steps[0] * self.scale)
            v, a = v + steps[1] * self.scale, a + steps[2] * self.scale
            found = Exact(x, v, a, good, last, self._passive(systems))
            now = np.abs(steps[:, good]).max(axis=(1, 2), initial=0.0).astype(float)
            now /= found.sizes(self.scale)
            if np.all((now <= EPS) | (now > 0.5 * last)):
                break
            last = now
        return found._replace(left=np.minimum(now, last))

    def _missing(self, q: Array, v: Array, a: Array, turns: Array, systems: _Systems) -> Array:
        """Return what the equations of positions, velocities, accelerations lack (3, N, nv)."""
        n = len(q)
        closure = self.extended.rows(q, v, a, turns)
        spins = np.zeros((3, n, self.extended.n_spins), dtype=Long)
        spins[1:] = self.extended.spins(q, v, a)
        drive = np.zeros((3, n, len(self.moved)), dtype=Long)
        fill = np.zeros((3, n, systems.null.shape[1]), dtype=Long)
        for level, rates, asked in ((1, v, self.speed), (2, a, self.acceleration)):
            scaled = rates / self.scale
            drive[level] = scaled[:, self.moved]
            drive[level, :, 0] -= asked / Long(self.scale[self.driven[0].v])
            fill[level] = np.einsum("nkv,nv->nk", systems.null, scaled)
        rows = np.broadcast_to(systems.rows, (3, *systems.rows.shape))
        chosen = np.take_along_axis(closure, rows, axis=2)
        return -np.concatenate([chosen, spins, drive, fill], axis=2)

    def _passive(self, systems: _Systems) -> Array:
        """Return the passive freedoms (N, k, nv): what the spin rows leave, and the unresolved."""
        r, k = systems.rows.shape[1], self.extended.n_spins
        spins = np.swapaxes(systems.inverses[:, :, r : r + k], 1, 2)
        length = np.sqrt((spins**2).sum(axis=2, keepdims=True))
        return np.concatenate([spins / np.where(length > 0, length, 1), systems.null], axis=1)

    def _systems(self, q: Array, turns: Array) -> _Systems:
        """Close samples in double precision, and take their systems."""
        n, nv = len(q), self.mechanism.model.nv
        evaluation = Evaluation(constraints_of(self.mechanism))
        closed = np.array(q, dtype=float)
        found: dict[int, SquareSystem] = {}
        inverses = np.zeros((n, nv, nv))
        for k in range(n):
            closed[k, self.at] = self.values[k]
            evaluation.angle_reference[:] = turns[k]
            system = self._system(evaluation, closed, k)
            if system is not None:
                found[k], inverses[k] = system, np.linalg.inv(system.matrix)
        shapes = [(len(s.equations), len(s.passive)) for s in found.values()]
        r, p = max(shapes, default=(0, 0))
        rows, null = np.zeros((n, r), dtype=np.intp), np.zeros((n, p, nv))
        good = np.zeros(n, dtype=bool)
        for (k, system), shape in zip(found.items(), shapes, strict=True):
            if shape == (r, p):  # elsewhere the loops have lost rank
                rows[k], null[k], good[k] = system.equations, system.passive, True
        inverses[~good] = 0.0
        return _Systems(closed, inverses, rows, null, good)

    def _system(self, evaluation: Evaluation, q: Array, k: int) -> SquareSystem | None:
        """Close sample k of q, and return its system; None where there is none."""
        free = np.ones(self.mechanism.model.nv, dtype=bool)
        free[self.moved] = False
        q[k], error = close(evaluation, q[k], free, TOLERANCES.round_off)
        if error > TOLERANCES.closed:
            return None
        try:
            system = SquareSystem(evaluation, self.driven, q[k])
        except SingularError:
            return None
        return system if system.pivot > SINGULAR_PIVOT else None
