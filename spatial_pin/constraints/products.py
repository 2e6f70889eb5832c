"""The products of vectors that the closure equations of a mechanism are made of, one by one."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.product_vectors import FrameOnBody, Term, VectorBlock, frames_of
from spatial_pin.mechanism.coordinates import joint_values, with_values
from spatial_pin.mechanism.equations import Cosine, Displacement, ScalarProduct
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
        self.a, self.b, self.x = VectorBlock(), VectorBlock(), VectorBlock()
        self.constants: list[float] = []
        self.factors: list[float] = []
        self.signs: list[Array] = []
        self.idle_axes: list[tuple[int, Array]] = []
        self.supports = _supports(mechanism.model)

    def __len__(self) -> int:
        return len(self.constants)

    def add(self, product: ScalarProduct, closure: Closure, constant: float = 0.0) -> int:
        """Add the product of two frames of a closure, less a constant; return its number."""
        ends = [(*closure.frames, *closure.between)[k] for k in product.frames]
        one, two = frames_of(self.mechanism, ends)
        if isinstance(product, Cosine):
            self._add_dot(one, product.u, two, product.w, constant)
            return len(self) - 1
        self.a.add(two.origin(1.0), one.origin(-1.0))
        if isinstance(product, Displacement):
            self.b.add(one.direction(product.u, self.scale))
            self.x.add(two.origin(1.0))
        else:
            length = product.length
            half = 0.5 * self.scale / (unit_length(self.mechanism, closure)
                                       if length is None else length)
            self.b.add(two.origin(half), one.origin(-half))
            self.x.add(two.origin(2.0))
        factor = 1.0 if isinstance(product, Displacement) else 2.0
        self._finish(constant * self.scale, factor, self._between(one, two))
        return len(self) - 1

    def _add_dot(
        self, one: FrameOnBody, u: Array, two: FrameOnBody, w: Array, cosine: float
    ) -> None:
        """Add the scalar product of two directions, less a cosine."""
        self.a.add(two.direction(w))
        self.b.add(one.direction(u))
        self.x.add(two.direction(w))
        self._finish(cosine, 0.0, self._between(one, two))

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
