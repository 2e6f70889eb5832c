"""How given forces change with q and v: springs, their laws, and wrenches from outside.

A wrench that keeps its world axes while its frame turns is, seen from the frame's joint, a force
that turns the other way; a spring pulls along a row, with a force that is a
function of its length and rate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.composite_joints import SplitModel
from spatial_pin.constraints.pinocchio_views import own_jacobian
from spatial_pin.constraints.trees import Subtree
from spatial_pin.dynamics.derivatives.closures import BodiesOfTree, Rates, Rows
from spatial_pin.dynamics.forces import Forces, Law
from spatial_pin.errors import UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.numerics.linalg import Array

Slopes = Callable[[float, float], tuple[float, float]]
REACH = 0.1  # first step of a law's differences, relative to the size of its argument
HALVINGS = 14  # how often that step is halved, at most


class Pull(NamedTuple):
    """The force of a spring, along or about its line, and how it changes.

    Attributes:
        force: as its law says [N, N·m].
        length: of its line [m]; that of its joint is 1.
        by_length, by_rate: derivatives of the law.
        row: (nv,) derivative of the length, or of the joint coordinate.
        by_q, by_v: (nv,) of the force.
    """

    force: float
    length: float
    by_length: float
    by_rate: float
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
    """

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
            return self._of[name].stiffness, self._of[name].damping
        if name in self.slopes:
            by_length, by_rate = self.slopes[name](x, rate)
            return float(by_length), float(by_rate)
        law, unit = self._given[name], 1.0 if self._of[name].joint else self._length
        return (slope(lambda y: law(y, rate), x, REACH * (abs(x) or unit)),
                slope(lambda y: law(x, y), rate, REACH * (abs(rate) or unit)))

    def lines(self, rows: Rows, rates: Rates) -> list[Pull]:
        """Return the springs between frames, in the order of `forces.lines`."""
        found = []
        for k, line in enumerate(self.forces.lines):
            at = rows.closed + k
            length = float(np.sqrt(2.0 * rates.values[0][at]))
            row, rate = rates.by_q[0][at] / length, float(rates.values[1][at]) / length
            by_length, by_rate = self._slopes(line.name, length, rate)
            by_q = by_length * row + by_rate * (rates.by_q[1][at] - rate * row) / length
            found.append(Pull(line.law(length, rate), length, by_length, by_rate, row, by_q,
                              by_rate * row))
        return found

    def turns(self, q: Array, v: Array) -> list[Pull]:
        """Return the springs about joints, in the order of `forces.turns`, then what resists."""
        found = []
        for turn in self.forces.turns:
            x, rate = float(q[turn.q]), float(v[turn.v])
            by_length, by_rate = self._slopes(turn.name, x, rate)
            row = np.zeros(len(v))
            row[turn.v] = 1.0
            found.append(Pull(turn.law(x, rate), 1.0, by_length, by_rate, row, by_length * row,
                              by_rate * row))
        resistance = self.forces.resistance
        forces, slopes = resistance.forces(v), resistance.slopes(v)
        for k in resistance.at:
            row = np.zeros(len(v))
            row[k] = 1.0
            found.append(Pull(-forces[k], 1.0, 0.0, slopes[k], row, 0.0 * row, slopes[k] * row))
        return found


def spring_slopes(lines: list[Pull], turns: list[Pull], nv: int) -> tuple[Array, Array]:
    """Return the derivatives (nv, nv) of the springs' joint forces with respect to q and v.

    Those along lines that bend, at the same force by half the squared length, are left out: see
    `Rows.bending`.

    Args:
        lines: springs between frames.
        turns: springs about joints.
        nv: how many velocities there are.
    """
    by_q, by_v = np.zeros((2, nv, nv))
    for pull in lines:
        by_q += np.outer(pull.row, pull.force / pull.length * pull.row)
    for pull in (*lines, *turns):
        by_q -= np.outer(pull.row, pull.by_q)
        by_v -= np.outer(pull.row, pull.by_v)
    return by_q, by_v


def slope(f: Callable[[float], float], x: float, step: float) -> float:
    """Return f'(x) by central differences extrapolated to step 0 [Ridders1982]."""
    best, error, before = np.nan, np.inf, np.empty(0)
    for k in range(HALVINGS):
        h = step / 2.0**k
        row = np.empty(k + 1)
        row[0] = (f(x + h) - f(x - h)) / (2.0 * h)
        for m in range(1, k + 1):
            row[m] = row[m - 1] + (row[m - 1] - before[m - 1]) / (4.0**m - 1.0)
            doubt = max(abs(row[m] - row[m - 1]), abs(row[m] - before[m - 1]))
            if doubt < error:
                best, error = float(row[m]), doubt
        before = row
    return best


class Outside:
    """Wrenches at frames, world axes, as forces in joint axes.

    Args:
        mechanism: the mechanism.
        external: by link, frame or joint.
    """

    def __init__(
        self, mechanism: Mechanism, whole: SplitModel, external: Mapping[str, pin.Force] | None
    ) -> None:
        self.whole = whole
        self.given = [(*mechanism.frame_on_joint(name), force)
                      for name, force in (external or {}).items()]
        self._moving = [x for x in self.given if x[0]]

    def on_joints(self, part: Subtree, placements: Array) -> pin.StdVec_Force:
        """Return the forces on the joints of a part of the tree, joint axes."""
        total = {int(joint): pin.Force.Zero() for joint in part.joints}
        for joint, placement, force in self._moving:
            at = int(self.whole.joint[joint])
            if at in total:
                total[at] += _carried(placement, placements[joint, :3], force)
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


def _carried(placement: pin.SE3, back: Array, force: pin.Force) -> pin.Force:
    """Return a force at a frame, world axes, in the axes of its joint."""
    linear = back @ force.linear
    return pin.Force(linear, back @ force.angular + np.cross(placement.translation, linear))
