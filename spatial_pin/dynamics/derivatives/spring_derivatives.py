"""Derivatives of applied forces with respect to q and v: springs, laws, external wrenches.

A wrench that keeps its world axes while its frame turns is, seen from the frame's joint, a force
that turns the other way; a spring pulls along a row, with a force that is a
function of its length and rate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from spatial_pin._support.checks import finite_array
from spatial_pin.constraints.composite_joints import single_joints
from spatial_pin.dynamics.derivatives.row_derivatives import RowDerivatives
from spatial_pin.dynamics.forces import Forces, Law, LineSpring
from spatial_pin.errors import UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.stacked import cross

Slopes = Callable[[float, float], tuple[float, float]]
REACH = 0.1  # first step of the differences of a law, relative to its argument
HALVINGS = 14  # halvings of that step at most: then round-off is larger than the truncation error
ONE_LINE = 1e-9  # part of a velocity across a line that is round-off
CENTRAL, ONE_SIDED = 4.0, 2.0  # halving the step divides the error of a difference by these numbers


class SpringForce(NamedTuple):
    """The force of a spring along its line, and how it changes.

    Attributes:
        force: as its law says [N].
        per_length: force divided by length [N/m].
        row: (nv,) derivative of the length; of a line without length and damping it is zero.
        along: (3,) the unit vector along the line, or zero likewise.
        by_q, by_v: (nv,) of the force.
    """

    force: float
    per_length: float
    row: Array
    along: Array
    by_q: Array
    by_v: Array


class Springs:
    """The springs of a mechanism with the derivatives of their laws.

    Laws and slopes are those of `dynamics_derivatives`; `forces` have the same laws.

    Attributes:
        forces: the springs.
        lines: those between frames, in the order of `forces.lines`, at a motion.
        turning: (3, nv) forces of those about joints and of what resists, and their derivatives by
            the joint's own coordinate and velocity.
        bushings: in the order of `forces.bushings`, the derivatives (12, nv) of their products by
            q, then what `Bushing.force_derivatives` returns.
        undirected: a spring whose damping has no direction, and is left out; else None.
    """

    def __init__(
        self, forces: Forces, laws: Mapping[str, Law] | None = None,
        slopes: Mapping[str, Slopes] | None = None,
    ) -> None:
        mechanism, laws, self.slopes = forces.mechanism, dict(laws or {}), dict(slopes or {})
        for name in self.slopes:
            if name not in laws:
                raise UnknownNameError("spring with a law", name, laws,
                                       f"mechanism {mechanism.name!r}: ")
        self.forces, self._given = forces, laws
        self._of = {spring.name: spring for spring in mechanism.springs}

    def _slopes(self, name: str, x: float, rate: float) -> tuple[float, float]:
        """Return the derivatives of a spring's law with respect to length and to rate."""
        if name not in self._given:
            return self._of[name].slopes(x, rate)
        if name in self.slopes:
            by_length, by_rate = finite_array(
                self.slopes[name](x, rate), (2,), f"slopes of spring {name!r}").tolist()
            return by_length, by_rate
        law, unit = self._given[name], (
            1.0 if self._of[name].joint else self.forces.mechanism.characteristic_length)
        by_rate = slope(lambda y: law(x, y), rate, REACH * (abs(rate) or unit))
        if x == 0.0 and self._of[name].frames:  # there is no length below
            at_none = law(x, rate)
            return extrapolated(lambda h: (law(h, rate) - at_none) / h, REACH * unit,
                                ONE_SIDED), by_rate
        return slope(lambda y: law(y, rate), x, REACH * (abs(x) or unit)), by_rate

    def move(self, rows: RowDerivatives, motions: Array | None = None) -> None:
        """Evaluate the forces at the motion of the rows.

        Args:
            rows: the rows at the motion.
            motions: (n, nv) all possible joint velocities; None: each for itself.

        Raises:
            SpatialPinError: a spring has no length, and its force no direction.
        """
        self.lines: list[SpringForce] = []
        self.undirected: LineSpring | None = None
        self.turning = self.turned(*rows.motion[:2])
        for at, line in enumerate(self.forces.lines, start=rows.closed):
            length, along, _ = line.between(rows.placements)
            if not length:
                self.lines.append(self._at_a_point(line, rows, at, motions))
                continue
            row, rate = rows.by_q[0][at] / length, float(rows.values[1][at]) / length
            by_length, by_rate = self._slopes(line.name, length, rate)
            by_q = by_length * row + by_rate * (rows.by_q[1][at] - rate * row) / length
            force = line.law(length, rate)
            self.lines.append(SpringForce(
                force, force / length, row, along, by_q, by_rate * row))
        first = rows.closed + len(self.forces.lines)
        self.bushings = [
            (rows.by_q[0, at : at + 12], *bushing.force_derivatives(
                rows.values[:2, at : at + 12], rows.by_q[:2, at : at + 12], self._slopes))
            for at, bushing in zip(count(first, 12), self.forces.bushings, strict=False)]

    def turned(self, q: Array, v: Array) -> Array:
        """Return `turning` at q (nq,) and v (nv,)."""
        turning, resistance = np.zeros((3, len(v))), self.forces.resistance
        for turn in self.forces.turns:
            x, rate = float(q[turn.q]), float(v[turn.v])
            turning[:, turn.v] += turn.law(x, rate), *self._slopes(turn.name, x, rate)
        if resistance:
            turning[0] -= resistance.forces(v)
            turning[2] += resistance.slopes(v)
        return turning

    def _at_a_point(
        self, line: LineSpring, rows: RowDerivatives, at: int, motions: Array | None
    ) -> SpringForce:
        """Return the force of a spring whose frames coincide: stiffness times their distance.

        If nothing can move them apart, any stiffness is right. Its length is row `at`. Damping has
        a direction if the frames can part along one line only.
        """
        bodies = rows.bodies
        parting = sum((sense * (bodies.columns[:, :3] + cross(bodies.columns[:, 3:], x @ point))
                       * bodies.moved_by[bodies.joints[i], :, None] for sense, i, x, point in zip(
                           (-1.0, 1.0), line.bodies, line.points,
                           (rows.placements[i] for i in line.bodies), strict=True)),
                      np.zeros((rows.nv, 3)))
        moved = parting if motions is None else motions @ parting
        none, pace = np.zeros(rows.nv), float(np.sqrt(max(rows.values[2][at], 0.0)))
        if not line.can_part(moved):
            return SpringForce(0.0, 0.0, none, np.zeros(3), none, none)
        force = line.law(0.0, 0.0)
        stiffness, damping = self._slopes(line.name, 0.0, 0.0)
        if force or any(line.law(0.0, rate) for rate in (pace, -pace)):
            raise line.without_direction(f"force of {force:.6g} N" if force else "damping")
        if not damping:
            return SpringForce(0.0, stiffness, none, np.zeros(3), none, none)
        svd = decompose(moved)
        if svd.s.size > 1 and svd.s[1] > ONE_LINE * svd.s[0]:
            self.undirected = line
            return SpringForce(0.0, stiffness, none, np.zeros(3), none, none)
        along = svd.vt[0]
        row = parting @ along
        return SpringForce(0.0, stiffness, row, along, stiffness * row, damping * row)

    def refuse_undirected(self) -> None:
        """Raise an error if the damping of a spring has no direction, and was left out."""
        if self.undirected:
            raise self.undirected.without_direction("damping")

    @property
    def pulls(self) -> Array:
        """Forces of the springs by half their squared lengths, and of bushings by products."""
        if not self.forces.exist:
            return np.zeros(0)
        return np.concatenate([[-x.per_length for x in self.lines],
                               *(pull for _, pull, _, _ in self.bushings)])

    def take_slopes(self, by_q: Array, by_v: Array) -> None:
        """Subtract the q and v derivatives (nv, nv) of the springs' joint forces.

        Those along lines that bend, at the same force by half the squared length, are left out: see
        `RowDerivatives.weights`.
        """
        if self.lines:
            rows = np.stack([pull.row for pull in self.lines])
            per_length = np.array([[pull.per_length] for pull in self.lines])
            by_q += rows.T @ (np.stack([pull.by_q for pull in self.lines]) - per_length * rows)
            by_v += rows.T @ np.stack([pull.by_v for pull in self.lines])
        for rows, _, bent, damped in self.bushings:
            by_q -= rows.T @ bent
            by_v -= rows.T @ damped
        if self.forces.exist:
            own = np.arange(len(by_q))
            for total, slopes in zip((by_q, by_v), self.turning[1:], strict=True):
                total[own, own] += slopes


def slope(f: Callable[[float], float], x: float, step: float) -> float:
    """Return f'(x) by central differences extrapolated to step 0."""
    return extrapolated(lambda h: (f(x + h) - f(x - h)) / (2.0 * h), step, CENTRAL)


def extrapolated(difference: Callable[[float], float], step: float, ratio: float) -> float:
    """Return the limit of a difference for step 0 [Ridders1982].

    Args:
        difference: as a function of the step.
        step: the first one.
        ratio: by what the error of a difference is divided when its step is halved.
    """
    best, error, before = np.nan, np.inf, np.empty(0)
    for k in range(HALVINGS):
        row = np.empty(k + 1)
        row[0] = difference(step / 2.0**k)
        for m in range(1, k + 1):
            row[m] = row[m - 1] + (row[m - 1] - before[m - 1]) / (ratio**m - 1.0)
            doubt = max(abs(row[m] - row[m - 1]), abs(row[m] - before[m - 1]))
            if doubt < error:
                best, error = float(row[m]), doubt
        before = row
    return best


class ExternalWrenches:
    """Wrenches at frames, world axes, as forces on joints."""

    def __init__(self, mechanism: Mechanism, external: Any) -> None:
        self.given = [(*mechanism.centred_frame(name), force)
                      for name, force in (external or {}).items()]
        self._moving = [x for x in self.given if x[0]]

    def on_joints(self, rows: RowDerivatives) -> Array:
        """Return the wrenches (joints, 6), world axes, about the origins of the single joints."""
        tree = single_joints(rows.mechanism)
        total, joints = np.zeros((len(tree.kind), 6)), tree.carriers
        for joint, placement, force in self._moving:
            lever = placement.translation @ rows.placements[joint, :3]
            total[joints[joint], :3] += force.linear
            total[joints[joint], 3:] += force.angular + np.cross(lever, force.linear)
        return total

    def take_turning(self, by_q: Array, rows: RowDerivatives) -> None:
        """Subtract the q derivatives (nv, nv) of joint forces as bodies turn below the wrenches."""
        for joint, placement, force in self._moving:
            bodies = rows.bodies
            own = np.flatnonzero(bodies.moved_by[bodies.joints[joint]])
            point = np.append(placement.translation, 1.0) @ bodies.placements[joint]
            linear, spins = bodies.columns[own, :3], bodies.columns[own, 3:]
            turned = cross(force.linear, spins), cross(force.angular, spins)
            by_q[np.ix_(own, own)] -= (
                (linear + cross(spins, point)) @ turned[0].T + spins @ turned[1].T)
