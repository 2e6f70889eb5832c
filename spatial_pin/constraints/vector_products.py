"""Products of vectors in closure equations; vectors are linear in the placements of bodies.

With G the joint placements stacked as rows (columns of R, then p, of each joint), every vector is
a row of C G.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.lazy import made_once
from spatial_pin.mechanism.coordinates import joint_values, with_values
from spatial_pin.mechanism.equations import Cosine, Displacement, PointDistance, ScalarProduct
from spatial_pin.mechanism.mechanism import Mechanism, point_on_body
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array

TANGENT = "tangent"  # `Pair.aligned` of a direction along that of a curve
DENSE_LIMIT = 60_000  # entries of C above which a sparse matrix is faster
SHORT = 1e-3  # distance relative to the characteristic length below which it is no unit


class Term(NamedTuple):
    """A part of a vector: factor * (R_joint local + flag p_joint).

    Attributes:
        factor: number before it.
        joint: whose placement it is.
        local: (3,) in the joint's axes.
        flag: 1 for a point, 0 for a direction.
        frame: of the model, that the point is the origin of or the direction is fixed in; of an
            idle rotation's axis, which runs through two points, -1 less the axis' number.
    """

    factor: float
    joint: int
    local: Array
    flag: float
    frame: int


class FrameOnBody(NamedTuple):
    """A frame as it is fixed in the body of a joint."""

    frame: int
    joint: int
    placement: pin.SE3

    @classmethod
    def of(cls, mechanism: Mechanism, name: str) -> FrameOnBody:
        """Return the frame, link or joint of a name, on the ground relative to the centre."""
        return cls(mechanism.frame_id(name), *mechanism.centred_frame(name))

    def origin(self, factor: float) -> Term:
        """Return its origin."""
        return Term(factor, self.joint, self.placement.translation, 1.0, self.frame)

    def direction(self, axis: Array, factor: float = 1.0) -> Term:
        """Return a direction (3,) in its axes."""
        return Term(factor, self.joint, self.placement.rotation @ axis, 0.0, self.frame)


class Products:
    """Products A . B - c of vectors, with the data of their derivatives.

    Attributes:
        mechanism: whose closures they are of.
        scale: what lengths are multiplied by.
        a, b, x: the terms of the vectors A, B and X of each.
        constants: c of each.
        factors: of the force B in its wrench.
        signs: (nv,) 1 or -1 for the freedoms that move body 2 or body 1 only, of each.
        idle_axes: joint and unit axis in its frame (3,) of each resolved passive freedom.
        supports: (njoints, nv) 1 for the freedoms that move the body of each joint.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.scale = 1.0 / mechanism.characteristic_length
        self.a, self.b, self.x = list[tuple[Term, ...]](), list[tuple[Term, ...]](), list[
            tuple[Term, ...]]()
        self.constants: list[float] = []
        self.factors: list[float] = []
        self.signs: list[Array] = []
        self.idle_axes: list[tuple[int, Array]] = []
        model = mechanism.model
        self.supports = np.zeros((model.njoints, model.nv))
        for i in range(1, model.njoints):
            self.supports[i] = self.supports[model.parents[i]]
            self.supports[i, model.idx_vs[i] : model.idx_vs[i] + model.nvs[i]] = 1.0

    def add(
        self, product: ScalarProduct | PointDistance, closure: Closure, constant: float = 0.0
    ) -> int:
        """Add the product of two frames of a closure, less a constant; return its number."""
        names = (*closure.frames, *closure.between)
        one, two = (FrameOnBody.of(self.mechanism, names[k]) for k in product.frames)
        sign = self.supports[two.joint] - self.supports[one.joint]
        if isinstance(product, Cosine):
            along = two.direction(product.w)
            return self._add((along,), (one.direction(product.u),), (along,), constant, 0.0, sign)
        if isinstance(product, Displacement):
            constant += product.offset
        apart, constant = (two.origin(1.0), one.origin(-1.0)), constant * self.scale
        if isinstance(product, Displacement):  # its force acts where the direction is not fixed
            of, at = (two, one) if product.of_second else (one, two)
            direction = of.direction(product.u, self.scale)
            return self._add(apart, (direction,), (at.origin(1.0),), constant, 1.0, sign)
        if isinstance(product, PointDistance):
            half = self.scale**2
        else:
            half = 0.5 * self.scale / (unit_length(self.mechanism, closure)
                                       if product.length is None else product.length)
        return self._add(apart, (two.origin(half), one.origin(-half)), (two.origin(2.0),),
                         constant, 2.0, sign)

    def add_rotation(self, body: str, axis: tuple[str, str]) -> None:
        """Add the rotation of a body about the line through two points fixed in it."""
        joint, _ = self.mechanism.frame_on_joint(body)
        a, b = (point_on_body(self.mechanism, joint, name) for name in axis)
        direction = (b - a) / np.linalg.norm(b - a)
        self.idle_axes.append((joint, direction))
        along = Term(1.0, joint, direction, 0.0, -len(self.idle_axes))
        self._add((), (along,), (), 0.0, 0.0, self.supports[joint])

    def _add(
        self, a: tuple[Term, ...], b: tuple[Term, ...], x: tuple[Term, ...], constant: float,
        factor: float, sign: Array,
    ) -> int:
        self.a.append(a)
        self.b.append(b)
        self.x.append(x)
        self.constants.append(constant)
        self.factors.append(factor)
        self.signs.append(sign)
        return len(self.constants) - 1


def matrix_of(blocks: Sequence[list[tuple[Term, ...]]], n_joints: int) -> Any:
    """Return the rows of C of vectors, block after block; a sparse matrix where it is large."""
    cells: dict[tuple[int, int], float] = {}
    vectors = [terms for block in blocks for terms in block]
    for row, terms in enumerate(vectors):
        for term in terms:
            for k, x in enumerate((*term.local, term.flag)):
                at = row, 4 * term.joint + k
                cells[at] = cells.get(at, 0.0) + term.factor * x
    entries = [(*at, x) for at, x in cells.items() if x]
    rows, columns, values = np.array(entries or np.empty((0, 3)), float).T
    rows, columns = rows.astype(np.intp), columns.astype(np.intp)
    shape = len(vectors), 4 * n_joints
    if shape[0] * shape[1] <= DENSE_LIMIT:
        dense = np.zeros(shape)
        dense[rows, columns] = values
        return dense
    from scipy.sparse import csr_array  # imported on use: it takes a tenth of a second

    sparse = csr_array((values, (rows, columns)), shape=shape)
    sparse.sort_indices()
    return sparse


def unit_length(mechanism: Mechanism, closure: Closure) -> float:
    """Return the unit [m] of a distance between other frames: theirs in the guess.

    So the equation is the difference of the lengths near there. Where that is next to nothing it is
    the characteristic length.
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


def opposite_axes(mechanism: Mechanism, data: pin.Data) -> dict[str, bool]:
    """Return closures whose axes do not point the same way, and whether half a turn helps.

    Closed equations leave them parallel, opposite, or (three equations of rotation) interchanged:
    then half a turn of one of the frames is not what makes them one.
    """
    opposite = {}
    for name, ends in axis_pairs(mechanism):
        one, two = (data.oMi[joint].rotation @ axes for joint, axes in ends)
        cosines = np.vecdot(one.T, two.T)
        if np.any(cosines < 0.5):
            opposite[name] = bool(np.all(np.abs(cosines) > 0.5))
    for closure in mechanism.closures:
        if closure.pair.aligned == TANGENT:
            frames = (FrameOnBody.of(mechanism, name) for name in closure.frames)
            first, second = (data.oMi[frame.joint] * frame.placement for frame in frames)
            seen = first.actInv(second)
            if closure.numbers["curve"].tangent(seen.translation) @ seen.rotation[:, 2] < 0.0:
                opposite[closure.name] = True
    return opposite


@made_once
def axis_pairs(mechanism: Mechanism) -> list[tuple[str, list[tuple[int, Array]]]]:
    """Return closures with axes: name, and of each end its joint and axes (3, n) fixed to it."""
    pairs = []
    for closure in mechanism.closures:
        if not closure.pair.aligned or closure.pair.aligned == TANGENT:
            continue
        geometry, first = closure.geometry, 2 if closure.pair.aligned == "z" else 0
        ends = [
            (frame.joint, (frame.placement.rotation @ axes)[:, first:])
            for frame, axes in zip((FrameOnBody.of(mechanism, name) for name in closure.frames),
                                   (geometry.axes1, geometry.axes2), strict=True)]
        pairs.append((closure.name, ends))
    return pairs
