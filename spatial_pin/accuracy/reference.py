"""What the settings of a trade-off are measured against, and how good that is itself.

Sweeps are solved again sample by sample in extended precision: Newton corrections with a matrix in
double precision and residuals in extended precision (`spatial_pin.accuracy.extended`) are iterated
until they no longer shrink [GolubVanLoan2013, 3.5.3]. The last ones show how accurate they are.
Simulations are compared with a tight integration, which is compared with others that differ in
coordinates, method or step; their largest difference tells how good it is.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.accuracy.extended import EPS, Extended, Long
from spatial_pin.accuracy.tasks import SimulationTask, SweepTask
from spatial_pin.assembly.close import close
from spatial_pin.assembly.holding import fixed_base_entries
from spatial_pin.assembly.square_system import SINGULAR_PIVOT, SquareSystem
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.rates import prescribed_at
from spatial_pin.settings import Accuracy

# Newton steps in extended precision with factors in double. Each gains at least one digit where
# pivots are above 1e-15 of the largest. From 1e-11 to 1e-19 there are eight digits.
REFINEMENTS = 12
JUDGED = 721  # samples of a sweep that are compared: one per half degree of a turn
# Distance of a sample from the reference that shows another branch [rad, characteristic lengths].
# Branches are 0.1 apart and more, except near their branch points.
OTHER_BRANCH = 0.05


# ---------------------------------------------------------------- exact samples


class Exact(NamedTuple):
    """Rows in extended precision.

    Attributes:
        q, v, a: (N, nq), (N, nv), (N, nv).
        good: (N,) whether the sample is determined, and was found.
        remainder: (3,) last corrections of positions [-], and of velocities and accelerations,
            by the largest.
        passive: (N, k, nv) passive freedoms, scaled, of unit length.
    """

    q: Array
    v: Array
    a: Array
    good: NDArray[np.bool_]
    remainder: Array
    passive: Array

    def sizes(self, scale: Array) -> Array:
        """Return what errors of positions, velocities and accelerations are counted by (3,).

        1, the largest velocity, and the largest acceleration or square of a velocity.
        """
        v, a = (float(np.abs(x[self.good] / scale).max(initial=0.0)) for x in (self.v, self.a))
        return np.array([1.0, v or 1.0, max(a, v * v) or 1.0])


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
        self.moved = [*(c.v for c in driven), *fixed_base_entries(mechanism, driven)]

    def near(self, q: Array, turns: Array) -> Exact:
        """Return the exact samples nearest to q (N, nq), passive freedoms left as they are.

        Args:
            q: configurations about closed.
            turns: (N, n) relative angles of screw closures to within half a turn [rad].

        Raises:
            SpatialPinError: no sample is determined.
        """
        closed, inverses, rows, null, good = self._systems(q, turns)
        if not good.any():
            raise SpatialPinError(f"mechanism {self.mechanism.name!r}: no sample of the sweep is "
                                  "determined: it moves along a singular configuration")
        n, nv, x = len(q), self.mechanism.model.nv, closed.astype(Long)
        v, a = np.zeros((n, nv), dtype=Long), np.zeros((n, nv), dtype=Long)
        last = np.full(3, np.inf)
        r, k = rows.shape[1], self.extended.n_spins
        spins = np.swapaxes(inverses[:, :, r : r + k], 1, 2)
        length = np.sqrt((spins**2).sum(axis=2, keepdims=True))
        passive = np.concatenate([spins / np.where(length > 0, length, 1), null], axis=1)
        for _ in range(REFINEMENTS):
            x[:, self.at] = self.values
            missing = self._missing(x, v, a, turns, rows, null)
            steps = np.einsum("nij,knj->kni", inverses, missing)
            x = self.extended.integrate(x, steps[0] * self.scale)
            v, a = v + steps[1] * self.scale, a + steps[2] * self.scale
            exact = Exact(x, v, a, good, last, passive)
            now = np.abs(steps[:, good]).max(axis=(1, 2), initial=0.0).astype(float)
            now /= exact.sizes(self.scale)
            if np.all((now <= EPS) | (now > 0.5 * last)):
                break
            last = now
        return exact._replace(remainder=np.minimum(now, last))

    def _missing(
        self, q: Array, v: Array, a: Array, turns: Array, rows: NDArray[np.intp], null: Array
    ) -> Array:
        """Return what the equations of positions, velocities, accelerations lack (3, N, nv)."""
        n = len(q)
        closure = self.extended.rows(q, v, a, turns)
        spins = np.zeros((3, n, self.extended.n_spins), dtype=Long)
        spins[1:] = self.extended.spins(q, v, a)
        drive = np.zeros((3, n, len(self.moved)), dtype=Long)
        fill = np.zeros((3, n, null.shape[1]), dtype=Long)
        for level, rates, rate in ((1, v, self.speed), (2, a, self.acceleration)):
            scaled = rates / self.scale
            drive[level] = scaled[:, self.moved]
            drive[level, :, 0] -= rate / Long(self.scale[self.driven[0].v])
            fill[level] = np.einsum("nkv,nv->nk", null, scaled)
        chosen = np.take_along_axis(closure, np.broadcast_to(rows, (3, *rows.shape)), axis=2)
        return -np.concatenate([chosen, spins, drive, fill], axis=2)

    def _systems(
        self, q: Array, turns: Array
    ) -> tuple[Array, Array, NDArray[np.intp], Array, NDArray[np.bool_]]:
        """Return samples closed in double precision (N, nq), and their `SquareSystem`s.

        Of these: inverses (N, nv, nv), zero where not good; closure equations held (N, r);
        unresolved passive freedoms, the last rows (N, k, nv); whether they are regular (N,).
        """
        n, nv = len(q), self.mechanism.model.nv
        evaluation = LoopEquations(self.mechanism)
        closed = np.array(q, dtype=float)
        systems: dict[int, SquareSystem] = {}
        inverses = np.zeros((n, nv, nv))
        free = np.ones(nv, dtype=bool)
        free[self.moved] = False
        for k in range(n):
            closed[k, self.at] = self.values[k]
            evaluation.angle_reference[:] = turns[k]
            closed[k], error = close(evaluation, closed[k], free, TOLERANCES.round_off)
            with contextlib.suppress(SingularError):
                if error <= TOLERANCES.closed:
                    system = SquareSystem(evaluation, self.driven, closed[k])
                    if system.pivot > SINGULAR_PIVOT:
                        systems[k], inverses[k] = system, np.linalg.inv(system.matrix)
        shapes = [(len(s.equations), len(s.passive)) for s in systems.values()]
        r, p = max(shapes, default=(0, 0))
        rows, null = np.zeros((n, r), dtype=np.intp), np.zeros((n, p, nv))
        good = np.zeros(n, dtype=bool)
        for (k, system), shape in zip(systems.items(), shapes, strict=True):
            if shape == (r, p):  # elsewhere the loops have lost rank
                rows[k], null[k], good[k] = system.equations, system.passive, True
        inverses[~good] = 0.0
        return closed, inverses, rows, null, good


# ---------------------------------------------------------------- sweeps


class Errors(NamedTuple):
    """Largest errors of a motion, over its samples and joints.

    Attributes:
        closure: of the constraint equations [-].
        position: [rad, characteristic lengths].
        velocity: [rad/s, characteristic lengths/s].
        acceleration: [rad/s², characteristic lengths/s²].
        spin: of resolved passive freedoms [rad]; 0 without any.
        total: the largest of position, and of velocity and acceleration by their sizes [-].

    Example:
        >>> mech = sp.load("four_bar")
        >>> task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
        >>> table = sp.tradeoff(mech, task, settings=[sp.Accuracy.named("draft")], repeats=1)
        >>> table.rows[0].errors.position < 1e-3, table.rows[0].errors.spin
        (True, 0.0)
    """

    closure: float
    position: float
    velocity: float
    acceleration: float
    spin: float
    total: float


class Astray(Exception):
    """A motion differs from its task; says how."""


class SweepReference:
    """The exact samples of a sweep.

    Attributes:
        error: of the reference itself, like `Errors.total`.
        spin_error: of its passive spins [rad].
    """

    def __init__(self, task: SweepTask) -> None:
        self.mechanism = mechanism = task.mechanism
        arguments, self.n = task.arguments, len(task.arguments["values"])
        self.rows = np.unique(np.linspace(0, self.n - 1, min(self.n, JUDGED)).round().astype(int))
        self.values = arguments["values"][self.rows]
        speed, acceleration = (task.row_rates(name)[self.rows] for name in task.RATES)
        driver = mechanism.driven_coordinate(arguments["driver"])
        driven = prescribed_at(task.start, [driver.name, *arguments["hold"]])
        prescribed = [self.values, *(np.full(len(self.rows), arguments["hold"][c.name])
                                     for c in driven[1:])]
        self.solver = ExactRows(mechanism, driven, np.column_stack(prescribed), speed, acceleration)
        self.extended, self.scale = self.solver.extended, mechanism.velocity_scale
        tight = Accuracy()  # a tolerance of round-off would forget spins where it is not reached
        motion, self.spin_error = task.run(tight), 0.0
        if self.extended.n_spins and self.n > 1:  # spins depend on the way: again in half the steps
            halved = task.finer().run(tight)
            angles = halved.angles[::2] if halved.angles.size else halved.angles
            finer = Motion(mechanism, halved.swept[::2], halved.driver_name, None, halved.q[::2],
                           halved.v[::2], halved.a[::2], halved.closure_error[::2],
                           halved.driver_speed[::2], [], angles)
            change = float(np.abs(self._steps(motion.q, finer.q)).max())
            motion, self.spin_error = finer, max(change, TOLERANCES.closed)
        self.exact = self.solver.near(motion.q[self.rows], _angles(motion)[self.rows])
        self.sizes = self.exact.sizes(self.scale)
        self.error = float(max(self.exact.remainder.max(), EPS))

    @property
    def text(self) -> str:
        """What the reference is, and how good."""
        skipped = int(np.count_nonzero(~self.exact.good))
        parts = [f"every sample refined in extended precision, to {self.error:.1e}"]
        if len(self.rows) < self.n:
            parts.append(f"{len(self.rows)} of {self.n} rows judged")
        if skipped:
            parts.append(f"{skipped} samples at singular configurations not judged")
        if self.extended.n_spins:
            parts.append(f"passive spin by half the steps, to {self.spin_error:.1e} rad")
        return "; ".join(parts)

    def _steps(self, first: Array, second: Array) -> Array:
        """Return the scaled steps (N, nv) between samples."""
        steps: Array = self.extended.difference(first.astype(Long), second.astype(Long))
        return steps / self.scale

    def judge(self, motion: Motion) -> Errors:
        """Return the errors of the task's motion.

        Raises:
            Astray: it ended early, left its branch, or its loops do not close any more.
        """
        q, v, a, turns = (x[self.rows] for x in _checked(motion, self.n))
        exact, good, spin = self.exact, self.exact.good, 0.0
        apart = np.abs(self._steps(exact.q, q)[good])
        if exact.passive.size or apart.max() > TOLERANCES.half_precision:
            exact = self.solver.near(q, turns)  # the motion's own solution: is it on our branch?
            if np.any(good & ~exact.good):
                row = int(np.argmax(good & ~exact.good))
                raise Astray(f"loops open too far to close again at {self.values[row]:.6g}")
            steps, passive = self._steps(self.exact.q, exact.q), self.exact.passive
            along = np.einsum("nkv,nv->nk", passive, steps)
            away = np.abs(steps - np.einsum("nk,nkv->nv", along, passive)).max(axis=1)
            lost = good & (away > (OTHER_BRANCH if passive.size else TOLERANCES.half_precision))
            if np.any(lost):
                raise Astray(f"left its branch at {self.values[int(np.argmax(lost))]:.6g}")
            spin = float(np.abs(along[good, : self.extended.n_spins]).max(initial=0.0))
        gaps = (self._steps(exact.q, q), (v - exact.v) / self.scale, (a - exact.a) / self.scale)
        closure = self.extended.closure_errors(q, turns)
        return _errors(closure, [gap[good] for gap in gaps], self.sizes, spin)


def _angles(motion: Motion) -> Array:
    return motion.angles if motion.angles.size else np.zeros((len(motion), 0))


def _checked(motion: Motion, n: int) -> tuple[Array, Array, Array, Array]:
    """Return q, v, a and screw angles of a motion of n finite samples.

    Raises:
        Astray: it has not.
    """
    if len(motion) != n:
        raise Astray(f"ended after {len(motion)} of {n} samples")
    if not all(np.isfinite(x).all() for x in (motion.q, motion.v, motion.a)):
        raise Astray("NaN in its rows")
    return motion.q, motion.v, motion.a, _angles(motion)


def _errors(closure: Array, gaps: Sequence[Array], sizes: Array, spin: float = 0.0) -> Errors:
    """Return the largest of closure equations and of the scaled gaps of q, v, a (N, nv)."""
    position, velocity, acceleration = (float(np.abs(gap).max(initial=0.0)) for gap in gaps)
    total = float((np.array([position, velocity, acceleration]) / sizes).max())
    return Errors(float(closure.max(initial=0.0)), position, velocity, acceleration, spin, total)


# ---------------------------------------------------------------- simulations

TIGHT = Accuracy(tolerance=1e-15, time_tolerance=1e-13)
OTHERS = {  # the first of these that runs is the independent check
    "all joint coordinates, projected,": Accuracy(
        formulation="projected", tolerance=1e-15, time_tolerance=1e-13),
    "LSODA": Accuracy(integrator="LSODA", tolerance=1e-15, time_tolerance=1e-12),
}


class SimulationReference:
    """A tight integration of a simulation.

    Attributes:
        error: of the reference itself, like `Errors.total`.
        step: its mean step [s].
        checks: what it was compared with, and the differences.
    """

    def __init__(self, task: SimulationTask) -> None:
        self.scale = task.mechanism.velocity_scale
        self.extended = Extended(task.mechanism)
        motion = task.run(TIGHT)
        self.n = len(motion)
        q, v, a = (x.astype(Long) for x in (motion.q, motion.v, motion.a))
        self.exact = Exact(q, v, a, np.ones(self.n, bool), np.zeros(3), np.zeros((self.n, 0, 0)))
        self.sizes = self.exact.sizes(self.scale)
        self.step = float(task.arguments["duration"]) / max(motion.steps, 1)
        half = Accuracy(tolerance=1e-15, time_tolerance=1e-13, step=0.5 * self.step)
        self.checks = {"half the step": self.judge(task.run(half))}
        for name, accuracy in OTHERS.items():
            try:
                self.checks[name] = self.judge(task.run(accuracy))
                break
            except (Astray, SpatialPinError, ValueError, ArithmeticError):
                continue
        self.error = max(EPS, *(x.total for x in self.checks.values()))

    @property
    def text(self) -> str:
        """What the reference is, and how good."""
        return (f"DOP853 at 1e-13; {' and '.join(self.checks)} differ from it by at most "
                f"{self.error:.1e}")

    def judge(self, motion: Motion) -> Errors:
        """Return the errors of the task's motion.

        Raises:
            Astray: it ended early, or is not finite.
        """
        q, v, a, turns = _checked(motion, self.n)
        gaps = [self.extended.difference(self.exact.q, q.astype(Long)) / self.scale,
                (v - self.exact.v) / self.scale, (a - self.exact.a) / self.scale]
        return _errors(self.extended.closure_errors(q, turns), gaps, self.sizes)
