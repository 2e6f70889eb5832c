"""The products of vectors that the closure equations of a mechanism are made of, one by one."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.product_vectors import FrameOnBody, Term, Vectors, frames_of
from spatial_pin.mechanism.coordinates import joint_values, with_values
from spatial_pin.mechanism.equations import ConstraintEquation
from spatial_pin.mechanism.mechanism import Mechanism, point_on_body
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array

SHORT = 1e-3  # distance relative to the characteristic length below which it is no unit


class Products:
    """Products A . B - c of vectors, and what their derivatives are made of.

    Attributes:
        mechanism: whose closures they are of.
        scale: what lengths are multiplied by.
        a, b, x: the vectors A, B and X of each.
        constants: c of each.
        factors: of the force B in its wrench.
        signs: (nv,) 1 or -1 for the freedoms that move body 2 or body 1 only, of each.
        idle_axes: joint and unit axis in its frame (3,) of each resolved passive freedom.
        supports: (njoints, nv) 1 for the freedoms that move the body of each joint.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.scale = 1.0 / mechanism.characteristic_length
        self.a, self.b, self.x = Vectors(), Vectors(), Vectors()
        self.constants: list[float] = []
        self.factors: list[float] = []
        self.signs: list[Array] = []
        self.idle_axes: list[tuple[int, Array]] = []
        self.supports = _supports(mechanism.model)

    def __len__(self) -> int:
        return len(self.constants)

    def _add_distance(self, frames: tuple[str, ...], unit: float, constant: float) -> None:
        """Add d . d / 2 unit - constant of the vector d between two frames."""
        one, two = frames_of(self.mechanism, frames)
        half = self.scale / (2.0 * unit)
        self.a.add(two.origin(1.0), one.origin(-1.0))
        self.b.add(two.origin(half), one.origin(-half))
        self.x.add(two.origin(2.0))
        self._finish(constant, 2.0, self._between(one, two))

    def add_length(self, closure: Closure) -> int:
        """Add the product of the distance between the closure's other two frames."""
        self._add_distance(closure.between, unit_length(self.mechanism, closure), 0.0)
        return len(self.constants) - 1

    def add_first(self, closure: Closure, equation: ConstraintEquation) -> None:
        """Add the product that an equation of a closure is, or begins with."""
        if equation.u is None:  # distance: (d . d - L²) / 2L
            unit = unit_length(self.mechanism, closure) if closure.between else equation.offset
            self._add_distance(closure.frames, unit, 0.5 * equation.offset * self.scale)
            return
        one, two = frames_of(self.mechanism, closure.frames)
        if equation.w is None:  # point or screw: u . d
            self.a.add(two.origin(1.0), one.origin(-1.0))
            self.b.add(one.direction(equation.u, self.scale))
            self.x.add(two.origin(1.0))
            self._finish(0.0, 1.0, self._between(one, two))
        else:
            self._add_dot(one, equation.u, two, equation.w, equation.offset)

    def _add_dot(
        self, one: FrameOnBody, u: Array, two: FrameOnBody, w: Array, cosine: float
    ) -> None:
        """Add the scalar product of two directions, less a cosine."""
        self.a.add(two.direction(w))
        self.b.add(one.direction(u))
        self.x.add(two.direction(w))
        self._finish(cosine, 0.0, self._between(one, two))

    def add_direction(self, closure: Closure, equation: ConstraintEquation) -> tuple[int, int]:
        """Add the products sine and cosine of the angle of an equation; return their numbers."""
        one, two = frames_of(self.mechanism, closure.frames)
        assert equation.angle_from is not None and equation.angle_of is not None
        for u in equation.angle_from[::-1]:  # y gives the sine, x the cosine
            self._add_dot(one, u, two, equation.angle_of, 0.0)
        return len(self.constants) - 2, len(self.constants) - 1

    def add_rotation(self, body: str, axis: tuple[str, str]) -> None:
        """Add the rotation of a body about the line through two points fixed in it."""
        joint, _ = self.mechanism.frame_on_joint(body)
        a, b = (point_on_body(self.mechanism, joint, name) for name in axis)
        direction = (b - a) / np.linalg.norm(b - a)
        self.idle_axes.append((joint, direction))
        self.a.add()
        self.b.add(Term(1.0, joint, direction, 0.0, -len(self.idle_axes)))
        self.x.add()
        self._finish(0.0, 0.0, self.supports[joint])

    def _between(self, one: FrameOnBody, two: FrameOnBody) -> Array:
        """Return (nv,) 1 or -1 for the freedoms that move the one or the other body only."""
        return self.supports[two.joint] - self.supports[one.joint]

    def _finish(self, constant: float, factor: float, sign: Array) -> None:
        self.constants.append(constant)
        self.factors.append(factor)
        self.signs.append(sign)


def _supports(model: pin.Model) -> Array:
    """Return (njoints, nv): 1 for the freedoms that move the body of each joint."""
    supports = np.zeros((model.njoints, model.nv))
    for i in range(1, model.njoints):
        supports[i] = supports[model.parents[i]]
        supports[i, model.idx_vs[i] : model.idx_vs[i] + model.nvs[i]] = 1.0
    return supports


def unit_length(mechanism: Mechanism, closure: Closure) -> float:
    """Return the length [m] that a distance between other frames is divided by.

    It is theirs in the guess, so that the equation is the difference of the lengths near there, or
    the characteristic length where that is next to nothing.
    """
    model, size = mechanism.centred_model, mechanism.characteristic_length
    q = with_values(mechanism, mechanism.neutral, joint_values(mechanism, mechanism.guess))
    ends = []
    for joint, placement in map(mechanism.centred_frame, closure.between):
        for i in reversed(list(model.supports[joint])[1:]):  # a `pin.Data` of many loops is large
            own = model.joints[i].createData()
            model.joints[i].calc(own, q)
            placement = model.jointPlacements[i] * pin.SE3(own.M) * placement
        ends.append(placement.translation)
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return length if length > SHORT * size else size
