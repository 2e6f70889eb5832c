"""The kinds of closure equations: what each is of products of vectors and of joint coordinates.

To add a kind, add one entry to `KINDS`, and one of the same number to the table in
`kernel/core/equations.c`:

1. `code`: its number in the kernel.
2. `formula`: the equation, as a function of its products, then its coordinates, then its angle if
   it has one, then its numbers. It is given Taylor series, and so tells derivatives of every
   order: use + - * and functions of `numerics.taylor` alone.
3. `parts`: a function that adds the products that it needs beside its first one, and tells its
   coordinates and numbers. The first product is that of the vectors of the `ConstraintEquation`.
4. `angle`: which of its products are sine and cosine of an angle that counts turns.
5. `elsewhere`: which of its products act on other bodies than the two of the closure.

Which kind an equation of a pair is says `ConstraintEquation.kind`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from spatial_pin.mechanism.equations import ConstraintEquation
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure, Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.taylor import Taylor, argument

Ints = NDArray[np.intp]


class Compiler(Protocol):
    """What an entry may ask for; lengths are times `scale`."""

    mechanism: Mechanism
    scale: float

    def add_direction(self, closure: Closure, equation: ConstraintEquation) -> tuple[int, int]:
        """Add the products sine and cosine of the angle of an equation; return their numbers."""

    def add_length(self, closure: Closure) -> int:
        """Add the product of the distance between the closure's other two frames."""


class Parts(NamedTuple):
    """What an equation is of beside its first product.

    Attributes:
        products: numbers of the others.
        coordinates: of joints.
        numbers: constants.
    """

    products: tuple[int, ...] = ()
    coordinates: tuple[Coordinate, ...] = ()
    numbers: tuple[float, ...] = ()


def _itself(product: Taylor) -> Taylor:
    return product


def _nothing(compiler: Compiler, closure: Closure, equation: ConstraintEquation | None) -> Parts:
    return Parts()


@dataclass(frozen=True, eq=False)
class Kind:
    """One entry of `KINDS`; see the module's docstring."""

    code: int
    formula: Callable[..., Taylor] = _itself
    parts: Callable[[Compiler, Closure, ConstraintEquation | None], Parts] = _nothing
    angle: tuple[int, int] | None = None
    elsewhere: tuple[int, ...] = ()

    @property
    def is_product(self) -> bool:
        """Whether its equations are their products."""
        return self.formula is _itself


def _screw(compiler: Compiler, closure: Closure, equation: ConstraintEquation | None) -> Parts:
    assert equation is not None and equation.pitch is not None
    return Parts(compiler.add_direction(closure, equation), (), (equation.pitch * compiler.scale,))


def _difference(compiler: Compiler, closure: Closure, equation: ConstraintEquation | None) -> Parts:
    return Parts((compiler.add_length(closure),))


def _coupling(compiler: Compiler, closure: Closure, equation: ConstraintEquation | None) -> Parts:
    a, b = (compiler.mechanism.coordinate(name) for name in closure.joints)
    unit = 1.0 if b.unit == "rad" else compiler.scale
    return Parts((), (a, b), (unit, closure.ratio, closure.offset))


KINDS: dict[str, Kind] = {
    "product": Kind(0),
    "screw": Kind(1, lambda slide, sine, cosine, angle, pitch: slide - pitch * angle, _screw,
                  angle=(1, 2)),
    "difference": Kind(2, lambda square, other: square - other, _difference, elsewhere=(1,)),
    "coupling": Kind(3, lambda a, b, unit, ratio, offset: unit * (b - ratio * a - offset),
                     _coupling),
    "idle": Kind(4),  # its product is the line that nothing turns about
}


class Equation(NamedTuple):
    """One equation.

    Attributes:
        kind: what it is.
        products: its products' numbers, the first one first.
        coordinates: of joints.
        numbers: constants.
        angle: number of the angle that counts turns; -1 without one.
    """

    kind: Kind
    products: tuple[int, ...]
    coordinates: tuple[Coordinate, ...] = ()
    numbers: tuple[float, ...] = ()
    angle: int = -1


@dataclass(frozen=True, eq=False)
class Composed:
    """Equations of one kind that are more than one product each.

    Attributes:
        kind: what they are.
        rows: (m,) numbers among all equations.
        equations: (m,) what they are made of.
    """

    kind: Kind
    rows: Ints
    equations: tuple[Equation, ...]

    @cached_property
    def products(self) -> Ints:
        """(p, m) numbers of their products."""
        return np.array([e.products for e in self.equations], np.intp).T

    @cached_property
    def coordinates(self) -> tuple[Ints, Ints]:
        """(c, m) places of their coordinates in q, and in v."""
        q, v = ([[getattr(c, at) for c in e.coordinates] for e in self.equations] for at in "qv")
        return np.array(q, np.intp).T, np.array(v, np.intp).T

    @cached_property
    def numbers(self) -> Array:
        """(k, m) their constants."""
        return np.array([e.numbers for e in self.equations]).T

    @cached_property
    def angles(self) -> Ints:
        """(m,) numbers of their angles, or none."""
        return np.array([e.angle for e in self.equations if e.angle >= 0], np.intp)

    def inputs(
        self, products: Sequence[Array], coordinates: Sequence[Array],
        changes: Sequence[Array] = (),
    ) -> list[Taylor]:
        """Return products and coordinates as series.

        Args:
            products: (N, ...) derivatives 0, 1, ... of all products in the parameter.
            coordinates: q, v and further derivatives (nv,); zero where there are no more.
            changes: (N, ...) derivatives of the products with respect to a second variable;
                coordinates do not depend on it.
        """
        found = [Taylor.of(*([x[at] for x in part] for part in (products, changes)))
                 for at in self.products]
        rest = np.zeros([len(self.rows)] + [1] * (np.ndim(products[0]) - 1))
        for places in zip(*self.coordinates, strict=True):
            known = [_beside(x[places[min(k, 1)]], rest) for k, x in enumerate(coordinates)]
            found.append(Taylor.of([*known, *[rest] * (len(products) - len(known))],
                                   [rest] * len(changes)))
        return found

    def seeded(self, products: Sequence[Array], coordinates: Sequence[Array]) -> list[Taylor]:
        """Return products (N, 1, ...) and coordinates that change each by itself (m, n, ...)."""
        inputs = self.inputs(products, coordinates)
        seeds = np.eye(len(inputs)).reshape(len(inputs), 1, -1, *[1] * (np.ndim(products[0]) - 2))
        return [Taylor(x.values, [seed, *[0.0] * (len(products) - 1)])
                for x, seed in zip(inputs, seeds, strict=True)]

    def values(self, inputs: list[Taylor], reference: Array | None = None
               ) -> tuple[Taylor, Taylor | None]:
        """Return the equations (m, ...), and their angles if they have some.

        Args:
            inputs: products, then coordinates.
            reference: (n_angles, ...) that the angles are nearest to [rad]; zero if left out.
        """
        like = inputs[0].values[0]
        numbers = [_beside(x, like) for x in self.numbers]
        if self.kind.angle is None:
            return self.kind.formula(*inputs, *numbers), None
        near = 0.0 if reference is None else _beside(reference[self.angles], like)
        sine, cosine = (inputs[k] for k in self.kind.angle)
        angle = argument(sine, cosine, near)
        return self.kind.formula(*inputs, angle, *numbers), angle

    def slopes(self, products: Sequence[Array]) -> list[Taylor]:
        """Return derivatives (m, 1, ...) of the equations with respect to each of their products.

        Args:
            products: (N, 1, ...) derivatives 0, 1, ... of all products in the parameter.
        """
        if not len(self.products):
            return []
        value, _ = self.values(self.seeded(products, []))
        return [Taylor([x[:, k : k + 1] if np.ndim(x) else x for x in value.changes])
                for k in range(len(self.products))]


def _beside(x: Array, like: Array) -> Array:
    """Return an array (m, ...) with as many axes as another one, the missing ones last."""
    return x.reshape(x.shape + (1,) * (np.ndim(like) - x.ndim))
