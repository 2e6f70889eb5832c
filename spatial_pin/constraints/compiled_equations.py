"""The closure equations of a mechanism, compiled once to flat arrays.

Every equation that is one product of vectors A and B is

    value      r = A . B - c
    derivative J = sign * scale * (W J6),  W = (f B, X x B)

where W is its wrench at the world origin, J6 Pinocchio's world joint Jacobian and sign is +1 (-1)
for the freedoms that move body 2 (body 1) only. Lengths are divided by the characteristic length.

All others are composed: sums of numbers times products, angles that count turns, joint coordinates
and functions of these (`composed_equations`). A resolved passive freedom is the absolute rotation
of a body about a line fixed in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import takewhile
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.composed_equations import (
    CompiledTerm,
    Composed,
    Equation,
    ImplicitAngles,
    QuantityIndex,
)
from spatial_pin.constraints.composite_joints import split_of
from spatial_pin.constraints.vector_products import Products, matrix_of
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
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure, Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import ROOT, Piecewise
from spatial_pin.numerics.taylor import Taylor

# Sine of an angle of two axes that are one direction: files have some digits, and turns are whole
NEARLY_PARALLEL = 0.05
HALF_TURN_NOISE = 1e-9  # rad by which half a turn may be missed and is still +pi, not -pi
# Ratio of a coupling, of coordinates relative to their sizes, beyond which it is an equation of the
# joint that moves less: gears have less.
LARGE_RATIO = 100.0


class Turns(NamedTuple):
    """Coordinates that count the turns of a screw closure.

    Attributes:
        row: (nq,) coefficients of coordinates in the angle of its frames.
        offset: the angle where these are zero [rad].
        are_all: whether the angle depends on these coordinates alone.
    """

    row: Array
    offset: float
    are_all: bool


class _Hinge(NamedTuple):
    """A joint between two bodies, at neutral.

    Attributes:
        q: its index in the configuration.
        axes: (k, 3) that it turns about, world axes; none of a slide.
        sense: 1 if it moves body 2, -1 if it moves body 1.
    """

    q: int
    axes: Array
    sense: int

    def is_about(self, axis: Array) -> bool:
        """Whether it turns about an axis (3,) alone."""
        sines = np.linalg.norm(np.cross(self.axes, axis), axis=1)
        return len(sines) == 1 and sines[0] < NEARLY_PARALLEL


def turns_of(
    mechanism: Mechanism, closure: Closure, angle: Angle | Bearing | Parameter
) -> Turns:
    """Return the coordinates that count the turns of an angle of a closure.

    Two frames tell their angle within a turn. Hinges next to either frame, but for slides, whose
    axes are that of the screw turn it by their own coordinates. Where the hinges between these are
    parallel to each other, nothing else turns it. Other trees may wind about the axis; there turns
    are counted along a path.
    """
    if not isinstance(angle, Angle):  # of a point that moves: turns are counted along a path
        return Turns(np.zeros(mechanism.model.nq), 0.0, False)
    model, carriers = split_of(mechanism)
    ends, frames = [], []
    for name in (closure.frames[k] for k in angle.frames):
        joint, placement = mechanism.frame_on_joint(name)
        ends.append(int(carriers[joint]))
        frames.append(_placement(model, ends[-1]).rotation @ placement.rotation)
    one, two = frames[0] @ angle.axes1, frames[1] @ angle.axes2
    hinges = _between(model, *ends)
    first = list(takewhile(lambda x: x.is_about(one[:, 2]), hinges))
    rest = hinges[len(first) :][::-1]
    last = list(takewhile(lambda x: x.is_about(two[:, 2]), rest))
    row = np.zeros(mechanism.model.nq)
    for hinge, axis in [*((x, one[:, 2]) for x in first), *((x, two[:, 2]) for x in last)]:
        row[hinge.q] += hinge.sense * math.copysign(1.0, float(hinge.axes[0] @ axis))
    middle = rest[len(last) :]
    are_all = bool(first or last) and all(x.is_about(middle[0].axes[0]) for x in middle)
    if middle and are_all:
        axis, u, w = middle[0].axes[0], two[:, 2], one[:, 2]  # takes u nearest to w about it
        sine, cosine = axis @ np.cross(u, w), u @ w - (axis @ u) * (axis @ w)
        two = pin.exp3(axis * math.atan2(sine, cosine)) @ two
    at_zero = math.atan2(one[:, 1] @ two[:, 0], one[:, 0] @ two[:, 0])
    return Turns(row, at_zero if at_zero > HALF_TURN_NOISE - math.pi else at_zero + 2.0 * math.pi,
                 are_all)


def _placement(model: pin.Model, joint: int) -> pin.SE3:
    """Return the placement of a joint at neutral, without a `pin.Data`, which may be large."""
    placement = pin.SE3.Identity()
    for i in list(model.supports[joint])[1:]:
        placement = placement * model.jointPlacements[i]
    return placement


def _between(model: pin.Model, one: int, two: int) -> list[_Hinge]:
    """Return the joints that turn a body relative to another, from body 1 to body 2."""
    ways = [list(model.supports[body]) for body in (one, two)]
    shared = sum(1 for a, b in zip(*ways, strict=False) if a == b)
    up = [_hinge(model, i, -1) for i in ways[0][shared:][::-1]]
    down = [_hinge(model, i, 1) for i in ways[1][shared:]]
    return [hinge for hinge in [*up, *down] if len(hinge.axes)]


def _hinge(model: pin.Model, i: int, sense: int) -> _Hinge:
    joint = model.joints[i]
    data = joint.createData()
    joint.calc(data, pin.neutral(model))
    turns = np.array(data.S).reshape(6, -1)[3:].T
    axes = turns[turns.any(axis=1)] @ _placement(model, i).rotation.T
    return _Hinge(int(model.idx_qs[i]), axes, sense)


class EquationLabel(NamedTuple):
    """The name of an equation's closure, and the number of the equation in it."""

    closure: str
    equation: int


class OtherBodyProduct(NamedTuple):
    """A product of an equation that acts on other bodies than the closure's first two.

    Attributes:
        equation: number of the equation.
        product: number of the product.
        joints: that carry its two bodies.
    """

    equation: int
    product: int
    joints: tuple[int, int]


class CountedAngle(NamedTuple):
    """An angle that counts turns.

    Attributes:
        equation: that it is of.
        name: its closure, which equation of the closure's type, and which angle there: what it has
            in every mechanism with that closure, whatever other equations are left out.
    """

    equation: int
    name: tuple[str, int, int]


class Constraints:
    """The compiled closure equations of a mechanism.

    Attributes:
        labels: closure and equation of each of the `n_closure` closure equations.
        n_closure: number of closure equations; those of `n_passive` resolved freedoms follow them.
        n_products: of them that have products; those of joint coordinates alone come last.
        n_wrenches: of `LoopEquations.row_wrenches`.
        equations: the compiled equations, passive ones last.
        plain: closure equations that are one product each; their numbers are its own.
        composed: those that are more, alike ones together.
        other_body_products: products that act on other bodies than the closure's first two.
        angles: the `n_angles` angles that count turns.
        turns: the joints that count the turns of each of them.
        counts_turns: whether they, or couplings, count turns of joints.
        of_joints: (k,) equations that coordinates of joints occur in as such.
        idle_axes: joint and unit axis in its frame (3,) of each resolved passive freedom.
        terms: of the vectors A, B and X of each product, see `Term`.
        supports: (njoints, nv) 1 for the freedoms that move the body of each joint.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        products = Products(mechanism)
        self.scale, self.supports = products.scale, products.supports
        self.idle_axes = products.idle_axes
        rows = [(EquationLabel(c.name, k), c, e)
                for c in mechanism.closures for k, e in enumerate(c.rows)]
        first = [_first_product(e) for _, _, e in rows]
        rows = [r for r, p in zip(rows, first, strict=True) if p] + [
            r for r, p in zip(rows, first, strict=True) if not p]
        self.labels = tuple(label for label, _, _ in rows)
        self.n_closure, self.n_products = len(rows), len(rows) - first.count(None)
        for _, closure, equation in rows[: self.n_products]:
            product = _first_product(equation)
            assert product is not None
            constant = _plain_constant(equation)
            products.add(product, closure, 0.0 if constant is None else -constant)
        self.other_body_products: list[OtherBodyProduct] = []
        self.angles: list[CountedAngle] = []
        self.turns = [turns_of(mechanism, c, x) for _, c, e in rows for x in _angles_of(e)]
        self.counts_turns = bool(self.turns) or any(c.joints for c in mechanism.closures)
        equations = [self._equation(at, closure, equation, products)
                     for at, (_, closure, equation) in enumerate(rows)]
        self.passive_at = len(products.constants)
        for passive in mechanism.passives:
            products.add_rotation(passive.body, passive.axis)
        self.n_passive = len(self.idle_axes)
        equations += [Equation((at,)) for at in range(self.passive_at, len(products.constants))]
        self.equations = tuple(equations)
        closed = self.equations[: self.n_closure]
        self.plain = np.array([at for at, e in enumerate(closed) if not e.terms], np.intp)
        self.of_joints = np.array([at for at, e in enumerate(closed) if e.coordinates], np.intp)
        self.composed = Composed.of(closed)
        self.n_wrenches = self.n_closure + len(self.other_body_products)
        self.n_angles = len(self.angles)
        model, r = mechanism.model, len(products.constants)
        self.terms = products.a, products.b, products.x
        self.c_abx = matrix_of(self.terms, model.njoints)
        self.constants = np.array(products.constants)
        self.factors = np.array(products.factors).reshape(-1, 1)
        self.signs = np.array(products.signs).reshape(r, model.nv) * mechanism.velocity_scale
        self.idle_bias = np.zeros((self.n_passive, 6 * model.njoints))
        for bias, (joint, axis) in zip(self.idle_bias, self.idle_axes, strict=True):
            bias[6 * joint + 3 : 6 * joint + 6] = axis

    def _equation(
        self, at: int, closure: Closure, equation: ConstraintEquation, products: Products
    ) -> Equation:
        """Return equation number `at`; products besides its first one are added."""
        if _plain_constant(equation) is not None:
            return Equation((at,))
        made = _EquationBuilder(self.mechanism, closure, products, at, len(self.angles))
        terms = made.terms_of(equation, self._size(closure, equation))
        row = self.labels[at].equation
        row = row if closure.equations is None else closure.equations[row]
        self.angles += [CountedAngle(at, (closure.name, row, k)) for k in range(len(made.angles))]
        names = (*closure.frames, *closure.between)
        for k, (one, two) in made.other_body_products:
            self.other_body_products.append(OtherBodyProduct(at, made.products[k], (
                self.mechanism.frame_on_joint(names[one])[0],
                self.mechanism.frame_on_joint(names[two])[0])))
        return Equation(tuple(made.products), tuple(made.coordinates), tuple(made.angles), terms,
                        tuple(k for k, _ in made.other_body_products), tuple(made.implicit))

    def _size(self, closure: Closure, equation: ConstraintEquation) -> float:
        """Return the factor of an equation of joint coordinates alone; 1 for others.

        That is the size of its last coordinate. Where ratios are large, it is the one of the joint
        that moves less, to a power of two, which changes no digit of a solution: else digits would
        seem lost where the other ones move fast.
        """
        if _first_product(equation):
            return 1.0
        sizes = [1.0 if self.mechanism.coordinate(name).unit == "rad" else self.scale
                 for name in closure.joints]
        largest = max((abs(weight) / sizes[x[0].joint] for weight, x in equation.terms
                       if len(x) == 1 and isinstance(x[0], JointCoordinate)), default=0.0)
        if largest * sizes[-1] <= LARGE_RATIO:
            return sizes[-1]
        return float(2.0 ** round(-math.log2(largest)))

    @cached_property
    def tied(self) -> NDArray[np.bool_]:
        """(nv,) which coordinates occur in closure equations."""
        return np.any(self.occurring[: self.n_closure], axis=0)  # type: ignore[no-any-return]

    @cached_property
    def occurring(self) -> NDArray[np.bool_]:
        """(n_closure + n_passive, nv) which coordinates occur in each equation."""
        occurring = np.zeros((len(self.equations), self.mechanism.model.nv), bool)
        for own, equation in zip(occurring, self.equations, strict=True):
            own |= np.any(self.signs[list(equation.products)] != 0.0, axis=0)
            own[[c.v for c in equation.coordinates]] = True
        return occurring

    def support(self, joint: int) -> Array:
        """(nv,) 1 for the freedoms that move the body of `joint`."""
        return self.supports[joint]


class _EquationBuilder:
    """Collects the quantities of one equation, numbered by kind."""

    def __init__(
        self, mechanism: Mechanism, closure: Closure, products: Products, first: int, angles: int
    ) -> None:
        self.mechanism, self.closure, self.all_products = mechanism, closure, products
        self._first, self._angles_before = first, angles
        self.products: list[int] = []
        self.coordinates: list[Coordinate] = []
        self.angles: list[tuple[int, int]] = []
        self.other_body_products: list[tuple[int, tuple[int, int]]] = []
        self.implicit: list[ImplicitAngles] = []
        self._roots: dict[ImplicitParameters, int] = {}
        self._product_indices: dict[int, int] = {}  # of products that occur again

    def terms_of(self, equation: ConstraintEquation, size: float = 1.0) -> tuple[CompiledTerm, ...]:
        """Add the quantities of a sum; return its terms."""
        terms = []
        for weight, quantities in equation.terms:
            lengths = sum(isinstance(x, Displacement | Square | PointDistance) for x in quantities)
            power = equation.is_length - lengths
            if weight or quantities:
                terms.append((size * weight * self.all_products.scale**power,
                              tuple(self.index_of(x) for x in quantities)))
        return tuple(terms)

    def _implicit(self, root: ImplicitParameters) -> int:
        """Add parameters to the angles of the equation; return the index of the first."""
        if root not in self._roots:
            first = self._roots[root] = len(self.angles)
            self.angles += [(self._angles_before + first + k, -1) for k in range(len(root.spans))]
            sums = tuple(self.terms_of(x) for x in root.definition)
            self.implicit.append(ImplicitAngles(first, sums, root.spans, root.is_periodic))
        return self._roots[root]

    def index_of(self, quantity: Quantity) -> QuantityIndex:
        """Add a quantity to the equation; return its index."""
        if isinstance(quantity, FunctionOf):
            function = quantity.function
            if isinstance(quantity.argument, Displacement) and isinstance(function, Piecewise):
                function = function.of_scaled(self.all_products.scale)
            return self.index_of(quantity.argument)._replace(function=function)
        if isinstance(quantity, JointCoordinate):
            name = self.closure.joints[quantity.joint]
            self.coordinates.append(self.mechanism.coordinate(name))
            return QuantityIndex("coordinate", len(self.coordinates) - 1)
        if isinstance(quantity, Parameter):
            return QuantityIndex("angle", self._implicit(quantity.of) + quantity.which)
        first = len(self.products)
        if id(quantity) in self._product_indices:
            return QuantityIndex("product", self._product_indices[id(quantity)])
        for product in _products_of(quantity):
            if product.frames != FIRST_TWO:
                self.other_body_products.append((len(self.products), product.frames))
            self.products.append(self.all_products.add(product, self.closure) if self.products
                                 else self._first)
        if not isinstance(quantity, Angle | Bearing):
            root = ROOT if isinstance(quantity, PointDistance) else None
            if isinstance(quantity, Displacement | Cosine):
                self._product_indices[id(quantity)] = first
            return QuantityIndex("product", first, root)
        self.angles.append((self._angles_before + len(self.angles), first))
        return QuantityIndex("angle", len(self.angles) - 1)


def _products_of(quantity: Quantity) -> list[ScalarProduct | PointDistance]:
    """Return the products that a quantity is made of; of an angle sine and cosine."""
    if isinstance(quantity, FunctionOf):
        return _products_of(quantity.argument)
    if isinstance(quantity, Angle):
        return [Cosine(u, quantity.axes2[:, 0], quantity.frames)
                for u in (quantity.axes1[:, 1], quantity.axes1[:, 0])]
    if isinstance(quantity, Bearing):
        return [Displacement(u, quantity.frames, float(u @ quantity.centre))
                for u in (quantity.axes[:, 1], quantity.axes[:, 0])]
    return [] if isinstance(quantity, JointCoordinate | Parameter) else [quantity]


def _first_product(equation: ConstraintEquation) -> ScalarProduct | PointDistance | None:
    return next((p for _, factors in equation.terms for x in factors for p in _products_of(x)),
                None)


def _angles_of(equation: ConstraintEquation) -> list[Angle | Bearing | Parameter]:
    """Return the angles of an equation, in the order of its terms, parameters once."""
    bare = [x.argument if isinstance(x, FunctionOf) else x
            for _, factors in equation.terms for x in factors]
    angles: list[Angle | Bearing | Parameter] = []
    for x in bare:
        if isinstance(x, Angle | Bearing):
            angles.append(x)
        elif isinstance(x, Parameter) and x not in angles:
            angles += x.of.parameters
    return angles


def _plain_constant(equation: ConstraintEquation) -> float | None:
    """Return the constant of an equation that else is one product of two frames, or None."""
    (weight, factors), *rest = equation.terms
    is_plain = (weight == 1.0 and len(factors) == 1 and isinstance(factors[0], ScalarProduct)
                and factors[0].frames == FIRST_TWO and not any(factors for _, factors in rest))
    return sum(weight for weight, _ in rest) if is_plain else None


@made_once
def constraints_of(mechanism: Mechanism) -> Constraints:
    """Return the compiled constraints of a mechanism, made once."""
    return Constraints(mechanism)


def composed_rates(
    c: Constraints, products: Sequence[Array], coordinates: Sequence[Array], angles: Array
) -> Array:
    """Return the derivative (n_closure, ...) of the closure equations of the highest order given.

    Args:
        c: the equations.
        products: (N, ...) derivatives 0, 1, ... of all products.
        coordinates: q, v and further derivatives (nv, ...); zero where there are no more.
        angles: (n_angles,) that counted ones are nearest to [rad].
    """
    order = len(products) - 1
    out = np.zeros((c.n_closure, *products[0].shape[1:]))
    out[: c.n_products] = products[order][: c.n_products]
    for group in c.composed:
        value, _ = group.values(group.inputs(products, coordinates), angles)
        out[group.rows] = value.derivative(order)
    return out


def combined_wrenches(
    c: Constraints, products: Sequence[Array], coordinates: Sequence[Array],
    wrenches: Sequence[Array], angles: Array,
) -> list[Array]:
    """Return the wrenches of the equations; after them those that act on other bodies.

    Args:
        c: the equations.
        products: (N, 1, ...) of the products, and a derivative of theirs if wanted.
        coordinates: q (nq, 1, ...), and the same derivative of v's integral (nv, 1, ...).
        wrenches: (N, 6, ...) of the products, or what else is linear in their derivatives; and
            the same derivative of that.
        angles: (n_angles,) that counted ones are nearest to [rad].

    Returns:
        As many as `wrenches`, (n_wrenches, 6, ...).
    """
    out = [np.zeros((c.n_wrenches, *w.shape[1:])) for w in wrenches]
    for total, w in zip(out, wrenches, strict=True):
        total[c.plain] = w[c.plain]
    extra = {x.product: k for k, x in enumerate(c.other_body_products, start=c.n_closure)}
    for group in c.composed:
        if not len(group.products):
            continue
        slopes = group.slopes(products, coordinates, angles)[: len(group.products)]
        for k, (at, slope) in enumerate(zip(group.products, slopes, strict=True)):
            to = [extra[p] for p in at.tolist()] if k in group.other_body_products else group.rows
            term = slope * Taylor.of([w[at] for w in wrenches])
            for total, w in zip(out, term.values, strict=True):
                total[to] += w
    return out
