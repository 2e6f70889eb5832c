"""The closure equations of a mechanism, compiled once to flat arrays.

Every equation that is one product of vectors A and B is

    value      r = A . B - c
    derivative J = sign * scale * (W J6),  W = (f B, X x B)

where W is its wrench at the world origin, J6 Pinocchio's world joint Jacobian and sign is +1 (-1)
for the freedoms that move body 2 (body 1) only. Lengths are divided by the characteristic length.

A screw's equation adds -k * angle, the angle of two directions, from two more products. A distance
that is that of two other frames (`length_between`) is the difference of two distances, the second
a product more. A coupling is linear in the joint coordinates. A resolved passive freedom is the
absolute rotation of a body about a line fixed in it.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.kinds import KINDS, Composed, Equation, Kind, Parts
from spatial_pin.constraints.product_vectors import matrix_of, rate_matrix
from spatial_pin.constraints.products import Products
from spatial_pin.constraints.turns import turns_of
from spatial_pin.mechanism.coordinates import needed
from spatial_pin.mechanism.equations import ConstraintEquation
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array


class EquationLabel(NamedTuple):
    """The closure of an equation, and which of its equations it is."""

    closure: str
    equation: int


class Constraints:
    """The compiled closure equations of a mechanism.

    Attributes:
        labels: closure and equation of each of the `n_closure` closure equations.
        n_closure: number of closure equations; those of `n_passive` resolved freedoms follow them.
        n_angles: number of equations with an angle that counts turns.
        n_wrenches: of `Evaluation.row_wrenches`.
        equations: what they are made of, and after them the passive ones; see `kinds`.
        plain: closure equations that are one product each; their numbers are its own.
        composed: those that are more, by kind.
        elsewhere: (equation, product) of products that act on other bodies than the closure's.
        screws: (equation, product of the sine, pitch) of screws, in the order of their angles.
        turns: what counts the turns of each of them.
        idle_axes: joint and unit axis in its frame (3,) of each resolved passive freedom.
        terms: of the vectors A, B and X of each product, see `Term`.
        supports: (njoints, nv) 1 for the freedoms that move the body of each joint.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        products = Products(mechanism)
        self.scale, self.supports = products.scale, products.supports
        self.idle_axes = products.idle_axes
        labels: list[EquationLabel] = []
        made: list[tuple[Kind, Closure, ConstraintEquation]] = []
        for closure in mechanism.closures:
            for k, equation in enumerate(closure.rows):
                kind = KINDS["difference" if closure.between else equation.kind]
                made.append((kind, closure, equation))
                products.add_first(closure, equation)
                labels.append(EquationLabel(closure.name, k))
        self.n_products, self.n_angles = len(labels), 0
        self.couplings = [c for c in mechanism.closures if c.type == COUPLING]
        labels += [EquationLabel(c.name, 0) for c in self.couplings]
        equations = self._equations(made, products)
        self.passive_at = len(products)
        for passive in mechanism.passives:
            products.add_rotation(passive.body, passive.axis)
        self.labels = tuple(labels)
        self.n_closure, self.n_passive = len(labels), len(self.idle_axes)
        equations += [Equation(KINDS["idle"], (at,))
                      for at in range(self.passive_at, len(products))]
        self.equations = tuple(equations)
        self._sort()
        self.turns = [turns_of(mechanism, made[at][1]) for at, _, _ in self.screws]
        self._lay_out(products)

    def _equations(
        self, made: list[tuple[Kind, Closure, ConstraintEquation]], products: Products
    ) -> list[Equation]:
        """Return the closure equations; products beside their first ones are added kind by kind."""
        equations: list[Any] = [None] * len(made)
        for kind in KINDS.values():
            for at, (own, closure, equation) in enumerate(made):
                if own is kind:
                    equations[at] = self._equation(
                        kind, (at,), kind.parts(products, closure, equation))
        kind = KINDS["coupling"]
        return equations + [self._equation(kind, (), kind.parts(products, closure, None))
                            for closure in self.couplings]

    def _equation(self, kind: Kind, first: tuple[int, ...], parts: Parts) -> Equation:
        angle = self.n_angles if kind.angle else -1
        self.n_angles += kind.angle is not None
        return Equation(kind, (*first, *parts.products), parts.coordinates, parts.numbers, angle)

    def _sort(self) -> None:
        """Tell equations that are one product each from those that are more."""
        self.plain = np.array([at for at, e in enumerate(self.equations[: self.n_products])
                               if e.kind.is_product], np.intp)
        self.composed = _composed(self.equations)
        self.elsewhere = [(at, e.products[k]) for at, e in enumerate(self.equations)
                          for k in e.kind.elsewhere]
        self.n_wrenches = self.n_closure + len(self.elsewhere)
        self.screws = [(at, e.products[1], e.numbers[0]) for at, e in enumerate(self.equations)
                       if e.kind is KINDS["screw"]]

    def _lay_out(self, products: Products) -> None:
        """Make the arrays that products are evaluated by."""
        model, r = self.mechanism.model, len(products)
        self.terms = products.a.terms, products.b.terms, products.x.terms
        a, b, x = (block.entries() for block in (products.a, products.b, products.x))
        self.c_abx = matrix_of([a, b, x], [0, r, 2 * r], (3 * r, 4 * model.njoints))
        self.c_rates = rate_matrix(a, b, r, model.njoints)
        self.constants = np.array(products.constants)
        self.factors = np.array(products.factors).reshape(-1, 1)
        self.signs = np.array(products.signs).reshape(r, model.nv)
        self.signs *= self.mechanism.velocity_scale
        self.idle_bias = np.zeros((self.n_passive, 6 * model.njoints))
        for bias, (joint, axis) in zip(self.idle_bias, self.idle_axes, strict=True):
            bias[6 * joint + 3 : 6 * joint + 6] = axis

    @cached_property
    def tied(self) -> NDArray[np.bool_]:
        """(nv,) which coordinates occur in closure equations."""
        found = np.zeros(self.mechanism.model.nv, bool)
        for equation in self.equations[: self.n_closure]:
            found |= np.any(self.signs[list(equation.products)] != 0.0, axis=0)
            found[[c.v for c in equation.coordinates]] = True
        return found

    def reference(self, q: Array, angles: Array) -> Array:
        """Return (n_angles,) what angles of screws are nearest to at q (nq,): turns that are told.

        Where coordinates do not tell them all, what they are near to anyway: `angles`.
        """
        if not any(turns.are_all for turns in self.turns):
            return angles
        return np.array([turns.row @ q + turns.offset if turns.are_all else angle
                         for turns, angle in zip(self.turns, angles, strict=True)])

    def support(self, joint: int) -> Array:
        """(nv,) 1 for the freedoms that move the body of `joint`."""
        return self.supports[joint]


def _composed(equations: tuple[Equation, ...]) -> list[Composed]:
    """Return equations that are more than one product each, those of a kind together."""
    found = []
    for kind in dict.fromkeys(e.kind for e in equations if not e.kind.is_product):
        places = [at for at, e in enumerate(equations) if e.kind is kind]
        found.append(Composed(kind, np.array(places), tuple(equations[at] for at in places)))
    return found


def constraints_of(mechanism: Mechanism) -> Constraints:
    """Return the compiled constraints of a mechanism, made once."""
    needed(mechanism)
    return _compiled(mechanism)


@made_once
def _compiled(mechanism: Mechanism) -> Constraints:
    return Constraints(mechanism)
