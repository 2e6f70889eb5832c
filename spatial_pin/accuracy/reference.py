"""What the settings of a trade-off are measured against, and how good that is itself.

Sweeps are solved again sample by sample in extended precision (`spatial_pin.accuracy.exact`).
Simulations are compared with a tight integration, which is compared with others that differ in
coordinates, method or step; their largest difference tells how good it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin.accuracy.exact import Exact, ExactRows
from spatial_pin.accuracy.extended import EPS, Extended, Long
from spatial_pin.accuracy.tasks import SimulationTask, SweepTask
from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.rates import prescribed_at
from spatial_pin.settings import Accuracy

JUDGED = 721  # samples of a sweep that are judged at most: half a degree apart over a turn
# Distance of a sample's own solution from the reference that is another branch, where passive
# freedoms lie between: branches are a tenth of a radian apart and more, but where they meet.
OTHER_BRANCH = 0.05


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
    """A motion is not the one asked for; says how."""


class SweepReference:
    """The exact samples of a sweep.

    Attributes:
        error: of the reference itself, like `Errors.total`.
        spin_error: of its passive spins [rad].
    """

    def __init__(self, task: SweepTask) -> None:
        self.mechanism = mechanism = task.mechanism
        asked, self.n = task.arguments, len(task.arguments["values"])
        self.rows = np.unique(np.linspace(0, self.n - 1, min(self.n, JUDGED)).round().astype(int))
        self.values = asked["values"][self.rows]
        speed, acceleration = (task.row_rates(name)[self.rows] for name in task.RATES)
        driver = mechanism.driven_coordinate(asked["driver"])
        driven = prescribed_at(task.start, [driver.name, *asked["hold"]])
        prescribed = [self.values, *(np.full(len(self.rows), asked["hold"][c.name])
                                     for c in driven[1:])]
        self.solver = ExactRows(mechanism, driven, np.column_stack(prescribed), speed, acceleration)
        self.extended, self.scale = self.solver.extended, mechanism.velocity_scale
        motion, self.spin_error = self._fine(task)
        self.exact = self.solver.near(motion.q[self.rows], _angles(motion)[self.rows])
        if not self.exact.good.any():
            raise SpatialPinError(f"mechanism {mechanism.name!r}: no sample of the sweep is "
                                  "determined: it moves along a singular configuration")
        self.sizes = self.exact.sizes(self.scale)
        self.error = float(max(self.exact.left.max(), EPS))

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

    def _fine(self, task: SweepTask) -> tuple[Motion, float]:
        """Return the task's samples at the tightest setting, and how good their passive spins are.

        Loops are refined later; spins depend on the way, which is taken again in half the steps.
        """
        tight = Accuracy()  # a tolerance of round-off would forget spins where it is not reached
        motion = task.run(tight)
        if not self.extended.n_spins or self.n < 2:
            return motion, 0.0
        finer = _every_other(task.finer().run(tight))
        change = float(np.abs(self._steps(motion.q, finer.q)).max())
        return finer, max(change, TOLERANCES.closed)

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
            exact = self.solver.near(q, turns)
            spin = self._compare(exact)
        gaps = (self._steps(exact.q, q), (v - exact.v) / self.scale, (a - exact.a) / self.scale)
        closure = self.extended.closure_errors(q, turns)
        return _errors(closure, [gap[good] for gap in gaps], self.sizes, spin)

    def _compare(self, exact: Exact) -> float:
        """Return how far the passive freedoms of a motion's own solution are from ours [rad].

        Raises:
            Astray: it is not on our branch.
        """
        good = self.exact.good
        if np.any(good & ~exact.good):
            row = int(np.argmax(good & ~exact.good))
            raise Astray(f"loops open too far to close again at {self.values[row]:.6g}")
        steps, passive = self._steps(self.exact.q, exact.q), self.exact.passive
        along = np.einsum("nkv,nv->nk", passive, steps)
        away = np.abs(steps - np.einsum("nk,nkv->nv", along, passive)).max(axis=1)
        lost = good & (away > (OTHER_BRANCH if passive.size else TOLERANCES.half_precision))
        if np.any(lost):
            raise Astray(f"left its branch at {self.values[int(np.argmax(lost))]:.6g}")
        return float(np.abs(along[good, : self.extended.n_spins]).max(initial=0.0))


def _angles(motion: Motion) -> Array:
    return motion.angles if motion.angles.size else np.zeros((len(motion), 0))


def _every_other(motion: Motion) -> Motion:
    angles = motion.angles[::2] if motion.angles.size else motion.angles
    return Motion(motion.mechanism, motion.swept[::2], motion.driver_name, None, motion.q[::2],
                  motion.v[::2], motion.a[::2], motion.closure_error[::2],
                  motion.driver_speed[::2], [], angles)


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
        self.checks = self._checks(task)
        self.error = max(EPS, *(x.total for x in self.checks.values()))

    def _checks(self, task: SimulationTask) -> dict[str, Errors]:
        half = Accuracy(tolerance=1e-15, time_tolerance=1e-13, step=0.5 * self.step)
        found = {"half the step": self.judge(task.run(half))}
        for name, accuracy in OTHERS.items():
            try:
                found[name] = self.judge(task.run(accuracy))
                break
            except (Astray, SpatialPinError, ValueError, ArithmeticError):
                continue
        return found

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
