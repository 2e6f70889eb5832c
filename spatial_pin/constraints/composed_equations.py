"""Closure equations that are sums of terms, not one product of vectors.

Screws, couplings, distances as long as others: sums of numbers times products, angles, joint
coordinates and functions. Their values, rates, derivatives and wrenches follow from Taylor series
of the products and coordinates.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import Function
from spatial_pin.numerics.taylor import Taylor, argument

Ints = NDArray[np.intp]
# Of Newton's method for parameters: as in the kernel (`implicit.c`).
NEWTON_STEPS = 30
LONGEST_STEP = 0.1  # of the span of a parameter
STEP_NOISE = 1e-13  # likewise: a step so short is the last one
STARTS = 48, 16  # of one parameter, and along each of two
ROUGH_STEPS, ROUGH = 8, 1e-3  # from these, and a step so short is on the way to a root


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


CompiledTerm = tuple[float, tuple[QuantityIndex, ...]]


class ImplicitAngles(NamedTuple):
    """Angles of an equation that sums of its quantities define, compiled; as many vanish.

    Attributes:
        first: index of the first of them.
        sums: terms of these; of one that is positive at a root, and of one that is least there.
        spans, is_periodic: see `ImplicitParameters`.
    """

    first: int
    sums: tuple[tuple[CompiledTerm, ...], ...]
    spans: tuple[tuple[float, float], ...]
    is_periodic: tuple[bool, ...]


class Equation(NamedTuple):
    """One equation, compiled.

    Attributes:
        products: their numbers among all; of a plain equation the one that it is.
        coordinates: of joints.
        angles: number among all angles, and index of the sine in `products`, before the cosine.
        terms: numbers with what they are multiplied by; none of a plain equation.
        other_body_products: indices of products that act on other bodies than the closure's first
            two.
        implicit: angles that sums define, whose index of a sine is -1.
    """

    products: tuple[int, ...]
    coordinates: tuple[Coordinate, ...] = ()
    angles: tuple[tuple[int, int], ...] = ()
    terms: tuple[CompiledTerm, ...] = ()
    other_body_products: tuple[int, ...] = ()
    implicit: tuple[ImplicitAngles, ...] = ()

    @property
    def sines_and_cosines(self) -> list[tuple[int, int]]:
        """Products, by number, that are sine and cosine of its angles; of implicit ones any."""
        return [(self.products[k], self.products[k + 1]) if k >= 0 else (self.products[0],) * 2
                for _, k in self.angles]

    @property
    def form(self) -> tuple[object, ...]:
        """Key of equations that can be evaluated together."""
        return (len(self.products), len(self.coordinates), tuple(sine for _, sine in self.angles),
                tuple(factors for _, factors in self.terms), self.other_body_products,
                self.implicit)


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

    def values(
        self, inputs: list[Taylor], reference: Array
    ) -> tuple[Taylor, list[Taylor]]:
        """Return the equations (m, ...), and each of their angles.

        Args:
            inputs: products, then coordinates.
            reference: (n_angles, ...) that the angles are nearest to [rad].
        """
        like, first = inputs[0].values[0], self.equations[0]
        angles: list[Taylor] = []
        for (_, sine), numbers in zip(first.angles, self.angles, strict=True):
            near = _with_axes_of(reference[numbers], like)
            angles.append(argument(inputs[sine], inputs[sine + 1], near) if sine >= 0
                          else inputs[0] * 0.0 + near)
        n = len(first.products)
        known = {"product": inputs[:n], "coordinate": inputs[n:], "angle": angles}
        for implicit in first.implicit:
            implicit_angles(implicit, known)
        terms = [(_with_axes_of(weight, like), factors)
                 for weight, (_, factors) in zip(self.weights, first.terms, strict=True)]
        return _sums([terms], known)[0] + inputs[0] * 0.0, angles

    def slopes(
        self, products: Sequence[Array], coordinates: Sequence[Array], angles: Array
    ) -> list[Taylor]:
        """Return derivatives (m, 1, ...) of the equations, by products and then coordinates.

        Args:
            products: (N, 1, ...) derivatives 0, 1, ... of all products in the parameter.
            coordinates: the same of q and v, (nq, 1, ...) and (nv, 1, ...).
            angles: (n_angles,) that the angles are nearest to [rad].
        """
        value, _ = self.values(self.seeded(products, coordinates), angles)
        n = len(self.products) + len(self.coordinates[0])
        return [Taylor([x[:, k : k + 1] if np.ndim(x) and x.shape[1] == n else x
                        for x in value.changes]) for k in range(n)]


def _sums(
    of: Iterable[Iterable[tuple[Any, tuple[QuantityIndex, ...]]]],
    known: Mapping[str, Sequence[Taylor]],
) -> list[Any]:
    """Return sums of terms of quantities by kind; functions of these are evaluated once."""
    evaluated: dict[QuantityIndex, Taylor] = {}
    totals = []
    for terms in of:
        total: Any = 0.0
        for weight, factors in terms:
            term: Any = weight
            for factor in factors:
                if factor not in evaluated:
                    x = known[factor.kind][factor.at]
                    evaluated[factor] = factor.function(x) if factor.function else x
                term = evaluated[factor] * term
            total = term + total
        totals.append(total)
    return totals


def implicit_angles(implicit: ImplicitAngles, known: dict[str, list[Taylor]]) -> None:
    """Find the series of angles that sums define, by Newton's method on series.

    Args:
        implicit: what defines them.
        known: series of quantities by kind; those of the angles start near them, or at 0, and are
            exchanged.
    """
    own = slice(implicit.first, implicit.first + len(implicit.spans))
    still = {kind: [Taylor([x.values[0]]) for x in of] for kind, of in known.items()}
    inputs = np.broadcast_shapes(*(np.shape(x.values[0]) for of in known.values() for x in of))
    u = np.array([np.broadcast_to(x.values[0], inputs) for x in known["angle"][own]], float)
    is_known = np.any(u != 0.0, axis=0)
    u, is_root = _roots(implicit, still, u) if np.any(is_known) else (u, is_known)
    if not np.all(is_root & is_known):
        u = np.where(is_root & is_known, u, _nearest_roots(implicit, still))
    known["angle"][own] = [Taylor([x]) for x in u]
    still["angle"][own] = known["angle"][own]
    _, slopes = _with_slopes(implicit, still, u)
    inverse = np.linalg.inv(np.moveaxis(slopes, (0, 1), (-2, -1)))
    like = next(x for kind in ("product", "coordinate") for x in known[kind])
    series = [like * 0.0 + x for x in u]
    for _ in range(len(like.values) + bool(like.changes)):
        known["angle"][own] = series
        sums = _sums(implicit.sums[: len(u)], known)
        series = [x - sum((g * inverse[..., k, m] for m, g in enumerate(sums)), 0.0)
                  for k, x in enumerate(series)]
    known["angle"][own] = series


def _with_slopes(
    implicit: ImplicitAngles, known: Mapping[str, Sequence[Taylor]], u: Array
) -> tuple[Array, Array]:
    """Return the first m sums (m, ...) at angles (m, ...), and their slopes (m, m, ...)."""
    m, slopes, sums = len(u), [], [Taylor([0.0, 0.0])]
    for k in range(m):
        seeded = {kind: [Taylor([x.values[0], 0.0]) for x in of] for kind, of in known.items()}
        seeded["angle"][implicit.first : implicit.first + m] = [
            Taylor([x, float(i == k)]) for i, x in enumerate(u)]
        sums = _sums(implicit.sums[:m], seeded)
        slopes.append([np.broadcast_to(x.values[1], u[0].shape) for x in sums])
    return (np.array([np.broadcast_to(x.values[0], u[0].shape) for x in sums]),
            np.array(slopes).swapaxes(0, 1))


def _judged(
    implicit: ImplicitAngles, known: Mapping[str, Sequence[Taylor]], u: Array
) -> tuple[Array, Array]:
    """Return the sum that is positive at a root, and the one that is least there, at angles."""
    still = {kind: list(of) for kind, of in known.items()}
    still["angle"][implicit.first : implicit.first + len(u)] = [Taylor([x]) for x in u]
    positive, least = (np.broadcast_to(x.values[0] if isinstance(x, Taylor) else x, u[0].shape)
                       for x in _sums(implicit.sums[len(u) :], still))
    return positive, least


def _roots(
    implicit: ImplicitAngles, known: Mapping[str, Sequence[Taylor]], u: Array,
    steps: int = NEWTON_STEPS, noise: float = STEP_NOISE,
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the roots (m, ...) that Newton's method finds from angles, and where it found one."""
    span = np.array([high - low for low, high in implicit.spans])
    span = span.reshape(-1, *[1] * (u.ndim - 1))
    size = np.full(u[0].shape, np.inf)
    for _ in range(steps):
        sums, slopes = _with_slopes(implicit, known, u)
        with np.errstate(all="ignore"):
            if len(u) == 1:  # downhill, towards the nearest point of a curve
                step = -sums / np.abs(slopes[0])
            else:
                (a, b), (c, d) = slopes
                step = np.array([b * sums[1] - d * sums[0], c * sums[0] - a * sums[1]]) / (
                    a * d - b * c)
            size = np.max(np.abs(step) / span, axis=0)
            u = u + np.nan_to_num(step * np.minimum(1.0, LONGEST_STEP / size))
        if np.all(size <= noise):
            break
    return u, (size <= noise) & (_judged(implicit, known, u)[0] > 0.0)


def _nearest_roots(
    implicit: ImplicitAngles, known: Mapping[str, Sequence[Taylor]]
) -> Array:
    """Return of all the roots the ones (m, ...) at which the last sum is least in size."""
    m = len(implicit.spans)
    grid = np.meshgrid(*(np.linspace(low, high, STARTS[m - 1], endpoint=False)
                         for low, high in implicit.spans))
    starts = np.array([x.ravel() for x in grid])
    shape = np.broadcast_shapes(*(np.shape(x.values[0]) for of in known.values() for x in of))
    starts = np.broadcast_to(starts.reshape(m, -1, *[1] * len(shape)),
                             (m, starts.shape[1], *shape)).copy()
    u, is_root = _roots(implicit, known, starts, ROUGH_STEPS, ROUGH)
    last = np.where(is_root, np.abs(_judged(implicit, known, u)[1]), np.inf)
    best = np.argmin(last, axis=0)[None]
    roots, _ = _roots(implicit, known, np.array([np.take_along_axis(x, best, axis=0)[0]
                                                 for x in u]))
    return np.array([low + np.mod(x - low, high - low) if periodic else x for x, (low, high),
                     periodic in zip(roots, implicit.spans, implicit.is_periodic, strict=True)])


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
