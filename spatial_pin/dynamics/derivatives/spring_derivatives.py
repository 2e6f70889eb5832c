"""Derivatives of applied forces with respect to q and v: springs, laws, external wrenches.

A wrench that keeps its world axes while its frame turns is, seen from the frame's joint, a force
that turns the other way; a spring pulls along a row, with a force that is a
function of its length and rate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import count
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.composite_joints import SplitModel
from spatial_pin.constraints.pinocchio_views import own_jacobian
from spatial_pin.constraints.trees import Subtree
from spatial_pin.dynamics.derivatives.row_derivatives import (
    BodiesOfTree,
    RowDerivatives,
)
from spatial_pin.dynamics.forces import Forces, Law, LineSpring
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

Slopes = Callable[[float, float], tuple[float, float]]
REACH = 0.1  # first step of the differences of a law, relative to its argument
HALVINGS = 14  # halvings of that step at most: then round-off is larger than the truncation error
CENTRAL, ONE_SIDED = 4.0, 2.0  # halving the step divides the error of a difference by these numbers


class SpringForce(NamedTuple):
    """The force of a spring, along or about its line, and its derivatives.

    Attributes:
        force: as its law says [N, N·m].
        per_length: of a line, force divided by length [N/m].
        row: (nv,) derivative of the length, or of the joint coordinate; of a line without length
            it is zero.
        by_q, by_v: (nv,) of the force.
    """

    force: float
    per_length: float
    row: Array
    by_q: Array
    by_v: Array


class Springs:
    """The springs of a mechanism with the derivatives of their laws.

    Args:
        mechanism: the mechanism.
        laws: by spring, as for `forward_dynamics`.
        slopes: by spring with a law, its derivatives with respect to length and to rate;
            differences if not given.

    Attributes:
        forces: the springs.
        lines: those between frames, in the order of `forces.lines`, at a motion.
        turns: those about joints, in the order of `forces.turns`, then what resists.
        bushings: in the order of `forces.bushings`, the derivatives (12, nv) of their products by
            q, then what `Bushing.force_derivatives` returns.
    """

    lines: list[SpringForce]
    turns: list[SpringForce]
    bushings: list[tuple[Array, Array, Array, Array]]

    def __init__(
        self, mechanism: Mechanism, laws: Mapping[str, Law] | None = None,
        slopes: Mapping[str, Slopes] | None = None, slip_speed: SlipSpeed | None = None,
    ) -> None:
        laws, self.slopes = dict(laws or {}), dict(slopes or {})
        for name in self.slopes:
            if name not in laws:
                raise UnknownNameError("spring with a law", name, laws,
                                       f"mechanism {mechanism.name!r}: ")
        self.forces = Forces(mechanism, laws, slip_speed)
        self._given = laws
        self._of = {spring.name: spring for spring in mechanism.springs}
        self._length = mechanism.characteristic_length

    def _slopes(self, name: str, x: float, rate: float) -> tuple[float, float]:
        """Return the derivatives of a spring's law with respect to length and to rate."""
        if name not in self._given:
            return self._of[name].slopes(x, rate)
        if name in self.slopes:
            by_length, by_rate = self.slopes[name](x, rate)
            return float(by_length), float(by_rate)
        law, unit = self._given[name], 1.0 if self._of[name].joint else self._length
        by_rate = slope(lambda y: law(x, y), rate, REACH * (abs(rate) or unit))
        if x == 0.0 and self._of[name].frames:  # there is no length below
            at_none = law(x, rate)
            return extrapolated(lambda h: (law(h, rate) - at_none) / h, REACH * unit,
                                ONE_SIDED), by_rate
        return slope(lambda y: law(y, rate), x, REACH * (abs(x) or unit)), by_rate

    def move(self, rows: RowDerivatives) -> None:
        """Evaluate the forces at the motion of the rows.

        Raises:
            SpatialPinError: a spring has no length, and its force no direction.
        """
        self.lines, self.turns = [], []
        products, (q, v, _) = rows.products, rows.motion
        for at, line in enumerate(self.forces.lines, start=rows.closed):
            length, _ = self.forces.line_between(*(x @ products.placements[i] for i, x in zip(
                line.bodies, line.points, strict=True)))
            if not length:
                self.lines.append(self._at_a_point(line, rows, at))
                continue
            row, rate = products.by_q[0][at] / length, float(products.values[1][at]) / length
            by_length, by_rate = self._slopes(line.name, length, rate)
            by_q = by_length * row + by_rate * (products.by_q[1][at] - rate * row) / length
            force = line.law(length, rate)
            self.lines.append(SpringForce(force, force / length, row, by_q, by_rate * row))
        first = rows.closed + len(self.forces.lines)
        self.bushings = [
            (products.by_q[0, at : at + 12], *bushing.force_derivatives(
                products.values[:2, at : at + 12], products.by_q[:2, at : at + 12], self._slopes))
            for at, bushing in zip(count(first, 12), self.forces.bushings, strict=False)]
        unit = np.eye(rows.nv)
        for turn in self.forces.turns:
            x, rate = float(q[turn.q]), float(v[turn.v])
            by_length, by_rate = self._slopes(turn.name, x, rate)
            row = unit[turn.v]
            self.turns.append(
                SpringForce(turn.law(x, rate), 0.0, row, by_length * row, by_rate * row))
        resistance = self.forces.resistance
        forces, slopes = resistance.forces(v), resistance.slopes(v)
        self.turns += [SpringForce(-forces[k], 0.0, unit[k], 0.0 * unit[k], slopes[k] * unit[k])
                       for k in resistance.at]

    def _at_a_point(self, line: LineSpring, rows: RowDerivatives, at: int) -> SpringForce:
        """Return the force of a spring whose frames coincide: stiffness times their distance.

        If nothing can move them apart, any stiffness is right. Its length is row `at`.
        """
        parting = rows.products.first_slopes(at)
        none, pace = np.zeros(rows.nv), float(np.sqrt(max(rows.products.values[2][at], 0.0)))
        if np.abs(parting).max(initial=0.0) <= self._length * TOLERANCES.tight:
            return SpringForce(0.0, 0.0, none, none, none)
        forces = [line.law(0.0, rate) for rate in (0.0, pace, -pace)]
        stiffness, damping = self._slopes(line.name, 0.0, 0.0)
        if any(forces) or damping:
            what = f"force of {forces[0]:.6g} N" if forces[0] else "damping"
            raise SpatialPinError(
                f"mechanism {self.forces.mechanism.name!r}: the two frames of spring {line.name!r} "
                f"coincide, where its {what} has no direction, so that there are no derivatives: "
                "start where its frames are apart, or give it a joint instead of frames")
        return SpringForce(0.0, stiffness, none, none, none)

    @property
    def pulls(self) -> Array:
        """Forces of the springs by half their squared lengths, and of bushings by products."""
        return np.concatenate([[-x.per_length for x in self.lines],
                               *(pull for _, pull, _, _ in self.bushings)])

    def by_motion(self) -> tuple[Array, Array]:
        """Return the derivatives (nv, nv) of the springs' joint forces with respect to q and v.

        Those along lines that bend, at the same force by half the squared length, are left out: see
        `RowDerivatives.second_derivatives`.
        """
        nv = self.forces.mechanism.model.nv
        by_q, by_v = np.zeros((2, nv, nv))
        for pull in self.lines:
            by_q += np.outer(pull.row, pull.per_length * pull.row)
        for pull in (*self.lines, *self.turns):
            by_q -= np.outer(pull.row, pull.by_q)
            by_v -= np.outer(pull.row, pull.by_v)
        for rows, _, bent, damped in self.bushings:
            by_q += rows.T @ bent
            by_v += rows.T @ damped
        return by_q, by_v


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
    """Wrenches at frames, world axes, as forces in joint axes.

    Args:
        mechanism: the mechanism.
        external: by link, frame or joint.
    """

    def __init__(
        self, mechanism: Mechanism, whole: SplitModel, external: Mapping[str, pin.Force] | None
    ) -> None:
        self.whole = whole
        self.given = [(*mechanism.centred_frame(name), force)
                      for name, force in (external or {}).items()]
        self._moving = [x for x in self.given if x[0]]

    def on_joints(self, part: Subtree, placements: Array) -> pin.StdVec_Force:
        """Return the forces on the joints of a subtree, joint axes."""
        total = {int(joint): pin.Force.Zero() for joint in part.joints}
        for joint, placement, force in self._moving:
            at = int(self.whole.joint[joint])
            if at in total:
                back = placements[joint, :3]
                linear = back @ force.linear
                total[at] += pin.Force(linear, back @ force.angular
                                       + np.cross(placement.translation, linear))
        return pin.StdVec_Force([pin.Force.Zero(), *total.values()])

    def turning(self, bodies: BodiesOfTree) -> Array:
        """Return q derivatives (nv, nv) of the joint forces, as the forces turn in joint axes."""
        total = np.zeros((bodies.nv, bodies.nv))
        for joint, placement, force in self._moving:
            part, at = bodies.at(joint)
            columns = own_jacobian(part.model, part.data, at)
            back = part.data.oMi[at].rotation.T
            local = [pin.skew(back @ x) for x in (force.linear, force.angular)]
            lever = pin.skew(placement.translation)
            change = np.vstack([local[0], local[1] + lever @ local[0]]) @ columns[3:]
            total[np.ix_(part.v, part.v)] += columns.T @ change
        return total
