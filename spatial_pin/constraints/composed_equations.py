"""Closure equations that are sums of terms, not one product of vectors.

Screws, couplings, distances as long as others: sums of numbers times products, angles, joint
coordinates and functions. Their values, rates, derivatives and wrenches follow from Taylor series
of the products and coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import Function
from spatial_pin.numerics.taylor import Taylor, argument

Ints = NDArray[np.intp]


class QuantityIndex(NamedTuple):
    """The index of a quantity in an equation, and a function of the quantity.

    Attributes:
        kind: "product", "coordinate" or "angle".
        at: index among the equation's quantities of this kind.
        function: of it, or None for itself.
    """

    kind: str
    at: int
    function: Function | None = None


class Equation(NamedTuple):
    """One equation, compiled.

    Attributes:
        products: their numbers among all; of a plain equation the one that it is.
        coordinates: of joints.
        angles: number among all angles, and index of the sine in `products`, before the cosine.
        terms: numbers with what they are multiplied by; none of a plain equation.
        other_body_products: indices of products that act on other bodies than the closure's first
            two.
    """

    products: tuple[int, ...]
    coordinates: tuple[Coordinate, ...] = ()
    angles: tuple[tuple[int, int], ...] = ()
    terms: tuple[tuple[float, tuple[QuantityIndex, ...]], ...] = ()
    other_body_products: tuple[int, ...] = ()

    @property
    def sines_and_cosines(self) -> list[tuple[int, int]]:
        """Numbers of the products that are sine and cosine of each of its angles."""
        return [(self.products[k], self.products[k + 1]) for _, k in self.angles]

    @property
    def form(self) -> tuple[object, ...]:
        """Key of equations that can be evaluated together."""
        return (len(self.products), len(self.coordinates), tuple(sine for _, sine in self.angles),
                tuple(factors for _, factors in self.terms), self.other_body_products)


@dataclass(frozen=True, eq=False)
class Composed:
    """Equations of one form that are more than one product each.

    Attributes:
        rows: (m,) numbers among all equations.
        equations: (m,) the compiled equations.
    """

    rows: Ints
    equations: tuple[Equation, ...]

    @staticmethod
    def of(equations: Sequence[Equation]) -> list[Composed]:
        """Return the composed ones of some equations, grouped by form."""
        alike: dict[tuple[object, ...], list[int]] = {}
        for at, equation in enumerate(equations):
            if equation.terms:
                alike.setdefault(equation.form, []).append(at)
        return [Composed(np.array(rows, np.intp), tuple(equations[at] for at in rows))
                for rows in alike.values()]

    @cached_property
    def products(self) -> Ints:
        """(p, m) numbers of their products."""
        return np.array([e.products for e in self.equations], np.intp).T

    @cached_property
    def coordinates(self) -> tuple[Ints, Ints]:
        """(c, m) indices of their coordinates in q, and in v."""
        q, v = ([[getattr(c, at) for c in e.coordinates] for e in self.equations] for at in "qv")
        return np.array(q, np.intp).T, np.array(v, np.intp).T

    @cached_property
    def angles(self) -> Ints:
        """(k, m) numbers of their angles."""
        return np.array([[number for number, _ in e.angles] for e in self.equations], np.intp).T

    @cached_property
    def weights(self) -> Array:
        """(n_terms, m) numbers of their terms."""
        return np.array([[weight for weight, _ in e.terms] for e in self.equations]).T

    @property
    def other_body_products(self) -> tuple[int, ...]:
        """Places of products that act on other bodies than those of the closure."""
        return self.equations[0].other_body_products

    def inputs(
        self, products: Sequence[Array], coordinates: Sequence[Array],
        changes: Sequence[Array] = (), coordinate_changes: Sequence[Array] = (),
    ) -> list[Taylor]:
        """Return products and coordinates as series.

        Args:
            products: (N, ...) derivatives 0, 1, ... of all products in the parameter.
            coordinates: q, v and further derivatives (nv,); zero where there are no more.
            changes: (N, ...) derivatives of the products with respect to a second variable.
            coordinate_changes: (nv, ...) the same of q, v and so on, as many.
        """
        series = [Taylor.of(*([x[at] for x in part] for part in (products, changes)))
                 for at in self.products]
        rest = np.zeros([len(self.rows)] + [1] * (np.ndim(products[0]) - 1))
        for q, v in zip(*self.coordinates, strict=True):
            known = [_with_axes_of(x[v if k else q], rest) for k, x in enumerate(coordinates)]
            series.append(Taylor.of([*known, *[rest] * (len(products) - len(known))],
                                   [x[v] for x in coordinate_changes]))
        return series

    def seeded(self, products: Sequence[Array], coordinates: Sequence[Array]) -> list[Taylor]:
        """Return products (N, 1, ...) and coordinates that change each by itself (m, n, ...)."""
        inputs = self.inputs(products, coordinates)
        seeds = np.eye(len(inputs)).reshape(len(inputs), 1, -1, *[1] * (np.ndim(products[0]) - 2))
        return [Taylor(x.values, [seed, *[0.0] * (len(products) - 1)])
                for x, seed in zip(inputs, seeds, strict=True)]

    def values(self, inputs: list[Taylor], reference: Array | None = None
               ) -> tuple[Taylor, list[Taylor]]:
        """Return the equations (m, ...), and each of their angles.

        Args:
            inputs: products, then coordinates.
            reference: (n_angles, ...) that the angles are nearest to [rad]; zero if left out.
        """
        like, first = inputs[0].values[0], self.equations[0]
        angles = []
        for (_, sine), numbers in zip(first.angles, self.angles, strict=True):
            near = 0.0 if reference is None else _with_axes_of(reference[numbers], like)
            angles.append(argument(inputs[sine], inputs[sine + 1], near))
        n = len(first.products)
        known = {"product": inputs[:n], "coordinate": inputs[n:], "angle": angles}
        total: Taylor = inputs[0] * 0.0
        for weights, (_, factors) in zip(self.weights, first.terms, strict=True):
            weight, term = _with_axes_of(weights, like), None
            for kind, at, function in factors:
                x = known[kind][at]
                x = function(x) if function else x
                term = x if term is None else term * x
            total = total + (weight if term is None else term * weight)
        return total, angles

    def slopes(self, products: Sequence[Array], coordinates: Sequence[Array]) -> list[Taylor]:
        """Return derivatives (m, 1, ...) of the equations, by products and then coordinates.

        Args:
            products: (N, 1, ...) derivatives 0, 1, ... of all products in the parameter.
            coordinates: the same of q and v, (nq, 1, ...) and (nv, 1, ...).
        """
        value, _ = self.values(self.seeded(products, coordinates))
        n = len(self.products) + len(self.coordinates[0])
        return [Taylor([x[:, k : k + 1] if np.ndim(x) and x.shape[1] == n else x
                        for x in value.changes]) for k in range(n)]


def _with_axes_of(x: Array, like: Array) -> Array:
    """Return an array (m, ...) with as many axes as another one, the missing ones last."""
    return x.reshape(x.shape + (1,) * (np.ndim(like) - x.ndim))


def composed_rows(group: Composed, slopes: Array, products: Array, scale: Array) -> Array:
    """Return (m, nv, ...) derivatives of composed equations, in scaled velocities.

    Args:
        group: the equations.
        slopes: (m, n, ...) derivatives with respect to their products and coordinates.
        products: (N, nv, ...) derivatives of all products.
        scale: (nv,) of the velocities.
    """
    m, p = len(group.rows), len(group.products)
    slopes = np.broadcast_to(slopes, (m, *slopes.shape[1:]))
    out = np.zeros((m, *products.shape[1:]))
    for k, at in enumerate(group.products):
        out += slopes[:, k, None] * products[at]
    for k, v in enumerate(group.coordinates[1], start=p):
        own = slopes[:, k]
        out[np.arange(m), v] += own * scale[v].reshape(-1, *[1] * (own.ndim - 1))
    return out
