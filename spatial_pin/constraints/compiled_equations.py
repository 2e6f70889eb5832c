"""The closure equations of a mechanism, compiled once to what the kernel's arrays are made of.

Vectors are fixed in bodies: directions, and points. A product of sums A and B of such vectors has

    value      r = A . B - c
    derivative J = sign * scale * (W J6),  W = (f B, X x B)

where W is its wrench at the world origin, J6 Pinocchio's world joint Jacobian and sign is +1 (-1)
for the freedoms that move body 2 (body 1) only. Lengths are divided by the characteristic length.

An equation is one product, or a sum of terms: numbers times products, angles that count turns,
joint coordinates and functions of these. A resolved passive freedom is the absolute rotation of a
body about a line fixed in it.
"""

from __future__ import annotations

import math
from itertools import takewhile
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.composite_joints import AXES, SCREW, SLIDE, TURN, single_joints
from spatial_pin.mechanism.coordinates import joint_values, with_values
from spatial_pin.mechanism.equations import (
    FIRST_TWO,
    Angle,
    Bearing,
    ConstraintEquation,
    Cosine,
    Displacement,
    FunctionOf,
    ImplicitParameters,
    JointCoordinate,
    Parameter,
    PointDistance,
    Quantity,
    ScalarProduct,
    Square,
)
from spatial_pin.mechanism.mechanism import Mechanism, point_on_body
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import ROOT, Function, Piecewise

PRODUCT, COORDINATE, ANGLE = range(3)  # kinds of quantities, see `kernel.h`
Factor = tuple[int, int, int]  # kind and number of a quantity, and number of its function or -1
Sum = list[tuple[float, list[Factor]]]  # terms: a number, and quantities that it is times
SHORT = 1e-3  # distance relative to the characteristic length below which it is no unit
# Sine of an angle of two axes that are one direction: files have some digits, and turns are whole
NEARLY_PARALLEL = 0.05
ANY = np.full(3, np.nan)  # axis of a ball: it is parallel to no other
HALF_TURN_NOISE = 1e-9  # rad by which half a turn may be missed and is still +pi, not -pi
# Ratio of a coupling, of coordinates relative to their sizes, beyond which it is an equation of the
# joint that moves less: gears have less.
LARGE_RATIO = 100.0


class CountedAngle(NamedTuple):
    """An angle that counts turns.

    Attributes:
        equation: that it is of.
        name: its closure, which equation of the closure's type, and which angle there: what it has
            in every mechanism with that closure, whatever other equations are left out.
        sine: number of the product that is its sine, before its cosine; -1 where sums define it.
        row: (nq,) coefficients of coordinates that count its turns.
        offset: the angle where these are zero [rad].
        is_of_joints: whether it depends on these coordinates alone.
    """

    equation: int
    name: tuple[str, int, int]
    sine: int
    row: Array
    offset: float
    is_of_joints: bool


class _FrameOnBody(NamedTuple):
    """A frame as it is fixed in the body of a joint."""

    frame: int
    joint: int
    rotation: Array
    origin: Array


class _Products:
    """Collects products of vectors that are fixed in bodies, see `Constraints`."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism, self.scale = mechanism, 1.0 / mechanism.characteristic_length
        self.vectors: list[tuple[int, int, int, Array]] = []
        self.rows: list[tuple[Any, ...]] = []  # parts, factors, constant, force, joints, equation
        self.of_other_bodies: list[tuple[int, int, tuple[int, int]]] = []
        self.idle_axes: list[tuple[int, Array]] = []
        self._frames: dict[str, _FrameOnBody] = {}
        self._known: dict[tuple[int, bytes, int], int] = {}  # vectors
        model = mechanism.model
        self.supports = np.zeros((model.njoints, model.nv))
        for i in range(1, model.njoints):
            self.supports[i] = self.supports[model.parents[i]]
            self.supports[i, model.idx_vs[i] : model.idx_vs[i] + model.nvs[i]] = 1.0

    def add(
        self, equation: int, closure: Closure, product: ScalarProduct | PointDistance,
        constant: float = 0.0,
    ) -> int:
        """Add the product of two frames of a closure, less a constant; return its number."""
        names, scale = (*closure.frames, *closure.between), self.scale
        one, two = (self._frame(names[k]) for k in product.frames)
        parts: tuple[int, ...]
        if isinstance(product, Cosine):
            along = self._vector(two, two.rotation @ product.w)
            parts = along, -1, self._vector(one, one.rotation @ product.u), -1, along
            factors, force = (1.0, 0.0, 1.0, 0.0, 1.0), 0.0
        else:
            second, first = (self._vector(frame, frame.origin, 1) for frame in (two, one))
            if isinstance(product, Displacement):  # it acts where the direction is not fixed
                of, at = (two, first) if product.of_second else (one, second)
                parts = second, first, self._vector(of, of.rotation @ product.u), -1, at
                factors, force = (1.0, -1.0, scale, 0.0, 1.0), 1.0
                constant += product.offset
            else:
                half = scale**2 if isinstance(product, PointDistance) else 0.5 * scale / (
                    product.length or unit_length(self.mechanism, closure))
                parts = second, first, second, first, second
                factors, force = (1.0, -1.0, half, -half, 2.0), 2.0
            constant *= scale
        joints, number = (one.joint, two.joint), len(self.rows)
        if product.frames != FIRST_TWO:
            self.of_other_bodies.append((equation, number, joints))
        self.rows.append((parts, factors, constant, force, joints, equation))
        return number

    def add_rotation(self, equation: int, body: str, axis: tuple[str, str]) -> None:
        """Add the rotation of a body about the line through two points fixed in it."""
        joint = self._frame(body).joint
        a, b = (point_on_body(self.mechanism, joint, name) for name in axis)
        direction = (b - a) / np.linalg.norm(b - a)
        self.idle_axes.append((joint, direction))
        along = self._vector((-len(self.idle_axes), joint), direction)
        self.rows.append(((-1, -1, along, -1, -1), (0.0, 0.0, 1.0, 0.0, 0.0), 0.0, 0.0,
                          (0, joint), equation))

    def _frame(self, name: str) -> _FrameOnBody:
        """Return a frame of the tree, on the ground relative to the centre."""
        if name not in self._frames:
            joint, placement = self.mechanism.centred_frame(name)
            self._frames[name] = _FrameOnBody(
                self.mechanism.frame_id(name), joint, placement.rotation.copy(),
                placement.translation.copy())
        return self._frames[name]

    def _vector(
        self, of: _FrameOnBody | tuple[int, int], local: Array, is_point: int = 0
    ) -> int:
        """Return the number of a vector (3,) in the axes of a joint, fixed in a frame of it."""
        frame, joint = of[:2]
        key = frame, local.tobytes(), is_point
        if self._known.setdefault(key, len(self.vectors)) == len(self.vectors):
            self.vectors.append((frame, joint, is_point, local))
        return self._known[key]


class Constraints:
    """The compiled closure equations of a mechanism.

    Attributes:
        closure_of: names of the closures of the `n_closure` closure equations, which those of
            `n_passive` resolved freedoms follow; `row_of`: the number of each in its closure.
        n_products: of them that have products; those of joint coordinates alone come last.
        product: (n_closure,) the product that an equation is, or -1; `plain`: which are products.
        sums: terms of each that is a sum.
        occurring: (n_closure + n_passive, nv) whether a coordinate occurs in an equation; `tied`:
            (nv,) in a closure equation.
        vectors: fixed in bodies: frame of the model (of an idle rotation's axis, which runs through
            two points, -1 less its number), joint, 1 for a point, and (3,) in the joint's axes.
        parts, part_factors: (n, 5) vectors of each product, two of A, two of B, and X; -1: none.
        constants: (n,) c of each product; passive ones are last, from `passive_at` on.
        factors: (n, 1) f of each.
        equation_of: (n,) the equation that it is of.
        other_body_products: equation, product and joints of products that act on other bodies than
            the closure's first two.
        signs: (n, nv) sign * scale of each.
        coordinates: equation, and entries of q and v, of each joint coordinate in the sums;
            `of_joints`: the equations.
        angles: the `n_angles` angles that count turns.
        implicit: first of the angles that sums define, first of these in `defining`, and the sums.
        functions: of quantities.
        idle_axes: joint and unit axis in its frame (3,) of each resolved passive freedom.
        supports: (njoints, nv) 1 for the freedoms that move the body of each joint.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism, self._products = mechanism, (products := _Products(mechanism))
        self.scale, self.vectors = products.scale, products.vectors
        self.supports = products.supports
        self.other_body_products, self.idle_axes = products.of_other_bodies, products.idle_axes
        self.coordinates: list[tuple[int, int, int]] = []
        self.angles: list[CountedAngle] = []
        self.implicit: list[tuple[int, int, ImplicitParameters]] = []
        self.functions: list[Function] = []
        self.sums: list[Sum] = []
        self.defining: list[Sum] = []
        self._known: dict[Any, int] = {}  # numbers of what occurs again
        rows = [(all(isinstance(getattr(x, "argument", x), JointCoordinate)
                     for _, factors in row.terms for x in factors), c, k, row)
                for c in mechanism.closures for k, row in enumerate(c.rows)]
        self.n_products = sum(not of_joints for of_joints, *_ in rows)
        rows.sort(key=lambda row: row[0])
        self.closure_of = tuple(c.name for _, c, _, _ in rows)
        self.row_of = tuple(k for _, _, k, _ in rows)
        self.product = np.array([self._add_equation(c, row) for _, c, _, row in rows], np.intp)
        self.passive_at = len(products.rows)
        for number, passive in enumerate(mechanism.passives, start=len(rows)):
            products.add_rotation(number, passive.body, passive.axis)
        self.n_closure, self.n_passive = len(rows), len(self.idle_axes)
        self.n_angles = len(self.angles)
        parts, factors, constants, forces, joints, equations = (
            zip(*products.rows, strict=True) if products.rows else [()] * 6)
        self.parts = np.array(parts, np.int64).reshape(-1, 5)
        self.part_factors = np.array(factors, float).reshape(-1, 5)
        self.constants, self.factors = np.array(constants), np.array(forces).reshape(-1, 1)
        self.equation_of = np.array(equations, np.intp)
        one, two = self.supports[np.array(joints, np.intp).reshape(-1, 2).T]
        self.signs = (two - one) * mechanism.velocity_scale
        moved, entry = np.nonzero(self.signs)
        self.occurring = np.zeros((self.n_closure + self.n_passive, len(self.signs.T)), bool)
        self.occurring[self.equation_of[moved], entry] = True
        for equation, _, v in self.coordinates:
            self.occurring[equation, v] = True
        self.tied = np.any(self.occurring[: self.n_closure], axis=0)
        self.plain = np.flatnonzero(self.product >= 0)
        self.of_joints = np.array([*dict.fromkeys(x for x, _, _ in self.coordinates)], np.intp)

    def _add_equation(self, closure: Closure, equation: ConstraintEquation) -> int:
        """Add a closure equation; return the product that it is, less a constant, or -1."""
        (weight, factors), *rest = equation.terms
        if weight == 1.0 and len(factors) == 1 and isinstance(factors[0], ScalarProduct) and (
                factors[0].frames == FIRST_TWO) and not any(factors for _, factors in rest):
            constant = -sum(number for number, _ in rest)
            self.sums.append([])
            return self._products.add(len(self.sums) - 1, closure, factors[0], constant)
        size = 1.0 if len(self.sums) < self.n_products else _size(
            self.mechanism, closure, equation)
        self.sums.append(self._sum(closure, equation, size))
        return -1

    def _sum(self, closure: Closure, equation: ConstraintEquation, size: float = 1.0) -> Sum:
        """Return the terms of a sum, times a size."""
        terms = []
        for weight, quantities in equation.terms:
            lengths = sum(isinstance(x, Displacement | Square | PointDistance) for x in quantities)
            if weight or quantities:
                terms.append((size * weight * self.scale ** (equation.is_length - lengths),
                              [self._factor(closure, x) for x in quantities]))
        return terms

    def _factor(self, closure: Closure, x: Quantity) -> Factor:
        """Return kind, number and function of a quantity; it is added where it is new."""
        at = len(self.sums)
        function: Function | None = ROOT if isinstance(x, PointDistance) else None
        if isinstance(x, FunctionOf):
            function, x = x.function, x.argument
            if isinstance(x, Displacement) and isinstance(function, Piecewise):
                function = function.of_scaled(self.scale)
        f = -1
        if function is not None:
            f = self._known.setdefault(id(function), len(self.functions))
            if f == len(self.functions):
                self.functions.append(function)
        if isinstance(x, JointCoordinate):
            coordinate = self.mechanism.coordinate(closure.joints[x.joint])
            self.coordinates.append((at, coordinate.q, coordinate.v))
            return COORDINATE, len(self.coordinates) - 1, f
        if isinstance(x, Parameter):
            return ANGLE, self._parameters(closure, x.of) + x.which, f
        if isinstance(x, Angle | Bearing):
            return ANGLE, self._angle(closure, x), f
        if (at, id(x)) not in self._known:
            self._known[at, id(x)] = self._products.add(at, closure, x)
        return PRODUCT, self._known[at, id(x)], f

    def _angle(self, closure: Closure, x: Angle | Bearing) -> int:
        """Add an angle, its sine and its cosine; return its number."""
        at, turns, both = len(self.sums), None, list[ScalarProduct]()
        if isinstance(x, Angle):
            turns = turns_of(self.mechanism, closure, x)
            both += [Cosine(x.axes1[:, k], x.axes2[:, 0], x.frames) for k in (1, 0)]
        else:  # of a point that moves: turns are counted along a path
            both += [Displacement(u, x.frames, float(u @ x.centre))
                     for u in (x.axes[:, 1], x.axes[:, 0])]
        sine, _ = (self._products.add(at, closure, product) for product in both)
        return self._add_angle(closure, sine, turns)

    def _parameters(self, closure: Closure, root: ImplicitParameters) -> int:
        """Return the number of the first angle that sums define; they are added where new."""
        at, first = len(self.sums), len(self.angles)
        if self._known.setdefault((at, id(root)), first) == first:
            for _ in root.spans:
                self._add_angle(closure, -1)
            sums = [self._sum(closure, x) for x in root.definition]
            self.implicit.append((first, len(self.defining), root))
            self.defining += sums
        return self._known[at, id(root)]

    def _add_angle(
        self, closure: Closure, sine: int, turns: tuple[Array, float, bool] | None = None
    ) -> int:
        """Add an angle of a closure's equation; return its number."""
        at = len(self.sums)
        row, which = self.row_of[at], sum(x.equation == at for x in self.angles)
        row = row if closure.equations is None else closure.equations[row]
        turns = turns or (np.zeros(self.mechanism.model.nq), 0.0, False)
        self.angles.append(CountedAngle(at, (closure.name, row, which), sine, *turns))
        return len(self.angles) - 1


def _size(mechanism: Mechanism, closure: Closure, equation: ConstraintEquation) -> float:
    """Return the factor of an equation of joint coordinates alone.

    That is the size of its last coordinate. Where ratios are large, it is the one of the joint that
    moves less, to a power of two, which changes no digit of a solution: else digits would seem lost
    where the other ones move fast.
    """
    scale = 1.0 / mechanism.characteristic_length
    sizes = [1.0 if mechanism.coordinate(name).unit == "rad" else scale for name in closure.joints]
    largest = max((abs(weight) / sizes[x[0].joint] for weight, x in equation.terms
                   if len(x) == 1 and isinstance(x[0], JointCoordinate)), default=0.0)
    if largest * sizes[-1] <= LARGE_RATIO:
        return sizes[-1]
    return float(2.0 ** round(-math.log2(largest)))


@made_once
def constraints_of(mechanism: Mechanism) -> Constraints:
    """Return the compiled constraints of a mechanism, made once."""
    return Constraints(mechanism)


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


# ---------------------------------------------------------------- turns


def turns_of(mechanism: Mechanism, closure: Closure, angle: Angle) -> tuple[Array, float, bool]:
    """Return which coordinates count the turns of an angle, see `CountedAngle`.

    Two frames tell their angle within a turn. Hinges next to either frame, but for slides, whose
    axes are that of the screw turn it by their own coordinates. Where the hinges between these are
    parallel to each other, nothing else turns it. Other trees may wind about the axis; there turns
    are counted along a path.
    """
    tree, world, frames, chains = single_joints(mechanism), [AXES], [], []
    for parent, rotation in zip(tree.parent[1:], tree.rotation[1:], strict=True):  # at neutral
        world.append(world[parent] @ rotation.T)
    for name in (closure.frames[k] for k in angle.frames):
        joint, placement = mechanism.frame_on_joint(name)
        i = int(tree.carriers[joint])
        frames.append(world[i] @ tree.frames[i].T @ placement.rotation)
        chains.append([i])
        while i:
            i = int(tree.parent[i])
            chains[-1].append(i)
    one, two = frames[0] @ angle.axes1, frames[1] @ angle.axes2
    between = [(i, -1) for i in chains[0] if i not in chains[1]] + [
        (i, 1) for i in chains[1][::-1] if i not in chains[0]]
    hinges = [(int(tree.iq[i]), world[i][:, 2] if tree.kind[i] in (TURN, SCREW) else ANY, sense)
              for i, sense in between if tree.kind[i] != SLIDE]

    def is_about(own: Array, axis: Array) -> bool:
        return bool(np.linalg.norm(np.cross(own, axis)) < NEARLY_PARALLEL)

    first = list(takewhile(lambda x: is_about(x[1], one[:, 2]), hinges))
    rest = hinges[len(first) :][::-1]
    last = list(takewhile(lambda x: is_about(x[1], two[:, 2]), rest))
    row = np.zeros(mechanism.model.nq)
    for chosen, axis in ((first, one[:, 2]), (last, two[:, 2])):
        for q, own, sense in chosen:
            row[q] += sense * math.copysign(1.0, float(own @ axis))
    middle = [own for _, own, _ in rest[len(last) :]]
    is_of_joints = bool(first or last) and all(is_about(own, middle[0]) for own in middle)
    if middle and is_of_joints:
        axis, u, w = middle[0], two[:, 2], one[:, 2]  # takes u nearest to w about it
        sine, cosine = axis @ np.cross(u, w), u @ w - (axis @ u) * (axis @ w)
        two = pin.exp3(axis * math.atan2(sine, cosine)) @ two
    at_zero = math.atan2(one[:, 1] @ two[:, 0], one[:, 0] @ two[:, 0])
    at_zero += 0.0 if at_zero > HALF_TURN_NOISE - math.pi else 2.0 * math.pi
    return row, at_zero, is_of_joints
