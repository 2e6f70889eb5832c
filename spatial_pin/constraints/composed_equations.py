"""Closure equations as results in Python need them: placed vectors, and sums of terms.

Screws, couplings, distances as long as others: sums of numbers times products, angles, joint
coordinates and functions. Their rates, derivatives and wrenches follow from Taylor series of the
products and coordinates.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.compiled_equations import (
    ANGLE,
    COORDINATE,
    PRODUCT,
    Constraints,
    Sum,
)
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import Function
from spatial_pin.numerics.taylor import Taylor, argument

Ints = NDArray[np.intp]
DENSE_LIMIT = 60_000  # entries of a matrix above which a sparse one is faster
# Of Newton's method for parameters: as in the kernel (`core/sums.c`).
NEWTON_STEPS = 30
LONGEST_STEP = 0.1  # of the span of a parameter
STEP_NOISE = 1e-13  # likewise: a step so short is the last one
STARTS = 48, 16  # of one parameter, and along each of two
ROUGH_STEPS, ROUGH = 8, 1e-3  # from these, and a step so short is on the way to a root

# A quantity: its kind, its number among an equation's of this kind, and a function of it.
Indexed = tuple[int, int, Function | None]
Terms = tuple[tuple[Any, tuple[Indexed, ...]], ...]  # numbers, and quantities that they are times
Known = Sequence[list[Taylor]]  # series of an equation's products, coordinates and angles


class ImplicitAngles(NamedTuple):
    """Angles of an equation that sums of its quantities define; as many vanish.

    Attributes:
        first: number of the first of them.
        sums: terms of these; of one that is positive at a root, and of one that is least there.
        spans, is_periodic: see `ImplicitParameters`.
    """

    first: int
    sums: tuple[Terms, ...]
    spans: tuple[tuple[float, float], ...]
    is_periodic: tuple[bool, ...]


@dataclass(frozen=True, eq=False)
class Composed:
    """Equations of one form that are more than one product each.

    Attributes:
        rows: (m,) numbers among all equations.
        products: (p, m) numbers of their products.
        coordinates: (c, m) indices of their coordinates in q, and in v.
        angles: (k, m) numbers of their angles.
        sines: (k,) which of their products are the sines of these, before the cosines; -1 of
            implicit ones.
        terms: the sums, with the numbers (m,) of each term.
        implicit: angles that sums define.
        other_body_products: which products act on other bodies than those of the closure.
    """

    rows: Ints
    products: Ints
    coordinates: tuple[Ints, Ints]
    angles: Ints
    sines: tuple[int, ...]
    terms: Terms
    implicit: tuple[ImplicitAngles, ...]
    other_body_products: tuple[int, ...]

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
        like, n = inputs[0].values[0], len(self.products)
        angles: list[Taylor] = []
        for sine, numbers in zip(self.sines, self.angles, strict=True):
            near = _with_axes_of(reference[numbers], like)
            angles.append(argument(inputs[sine], inputs[sine + 1], near) if sine >= 0
                          else inputs[0] * 0.0 + near)
        known = inputs[:n], inputs[n:], angles
        for implicit in self.implicit:
            implicit_angles(implicit, known)
        terms = [(_with_axes_of(number, like), factors) for number, factors in self.terms]
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


@made_once
def vector_matrix(c: Constraints) -> Any:
    """Return what takes placements of joints, row by row, to A, B and X of all products.

    (3 n, 4 njoints); the rows of a joint are three columns of its rotation, then its position. A
    sparse matrix where it is large.
    """
    (n, _), part = c.parts.shape, c.parts.T
    rows = (np.array([0, 0, 1, 1, 2])[:, None] * n + np.arange(n))[part >= 0]
    vectors = [(4 * joint, *local, flag) for _, joint, flag, local in c.vectors]
    own = np.array(vectors, float).reshape(-1, 5)[part[part >= 0]]
    at = (own[:, :1].astype(np.intp) + np.arange(4)).ravel()
    entries = (own[:, 1:] * c.part_factors.T[part >= 0][:, None]).ravel()
    rows, shape = np.repeat(rows, 4), (3 * n, 4 * len(c.supports))
    if shape[0] * shape[1] <= DENSE_LIMIT:
        dense = np.zeros(shape)
        np.add.at(dense, (rows, at), entries)
        return dense
    from scipy.sparse import csr_array  # imported on use: it takes a tenth of a second

    sparse = csr_array((entries, (rows, at)), shape=shape)
    sparse.eliminate_zeros()
    return sparse


@made_once
def composed_of(c: Constraints) -> list[Composed]:
    """Return the closure equations that are more than one product each, grouped by form."""
    alike: dict[tuple[Any, ...], list[int]] = {}
    starts: list[Ints] = [  # of each equation, in its products, coordinates and angles
        np.searchsorted(equations, np.arange(c.n_closure + 1)) for equations in (
            c.equation_of, [x[0] for x in c.coordinates], [x.equation for x in c.angles])]

    def indexed(row: int, terms: Sum) -> Terms:
        return tuple((number, tuple(
            (kind, at - int(starts[kind][row]), c.functions[f] if f >= 0 else None)
            for kind, at, f in factors)) for number, factors in terms)

    for row in np.flatnonzero(c.product < 0).tolist():
        (first, end), _, (angle, last) = (x[row : row + 2].tolist() for x in starts)
        sines = tuple(x.sine - first if x.sine >= 0 else -1 for x in c.angles[angle:last])
        implicit = tuple(ImplicitAngles(
            at - angle, tuple(indexed(row, x) for x in c.defining[sum_ : sum_ + len(of.spans) + 2]),
            of.spans, of.is_periodic) for at, sum_, of in c.implicit if angle <= at < last)
        others = tuple(x - first for _, x, _ in c.other_body_products if first <= x < end)
        form = (*(int(x[row + 1] - x[row]) for x in starts), sines,
                tuple(factors for _, factors in indexed(row, c.sums[row])), implicit, others)
        alike.setdefault(form, []).append(row)
    entries = np.array(c.coordinates, np.intp).reshape(-1, 3)
    groups = []
    for (p, n, k, sines, factors, implicit, others), found in alike.items():
        rows = np.array(found, np.intp)
        products, coordinates, angles = (
            x[rows] + np.arange(size)[:, None] for x, size in zip(starts, (p, n, k), strict=True))
        numbers = np.array([[number for number, _ in c.sums[row]] for row in found]).T
        groups.append(Composed(
            rows, products, (entries[coordinates, 1], entries[coordinates, 2]), angles, sines,
            tuple(zip(numbers, factors, strict=True)), implicit, others))
    return groups


def _sums(
    of: Iterable[Iterable[tuple[Any, tuple[Indexed, ...]]]], known: Known
) -> list[Any]:
    """Return sums of terms of quantities by kind; functions of these are evaluated once."""
    evaluated: dict[Indexed, Taylor] = {}
    totals = []
    for terms in of:
        total: Any = 0.0
        for weight, factors in terms:
            term: Any = weight
            for factor in factors:
                if factor not in evaluated:
                    kind, at, function = factor
                    x = known[kind][at]
                    evaluated[factor] = function(x) if function else x
                term = evaluated[factor] * term
            total = term + total
        totals.append(total)
    return totals


def implicit_angles(implicit: ImplicitAngles, known: Known) -> None:
    """Find the series of angles that sums define, by Newton's method on series.

    Args:
        implicit: what defines them.
        known: series of quantities by kind; those of the angles start near them, or at 0, and are
            exchanged.
    """
    own = slice(implicit.first, implicit.first + len(implicit.spans))
    still = [[Taylor([x.values[0]]) for x in of] for of in known]
    inputs = np.broadcast_shapes(*(np.shape(x.values[0]) for of in known for x in of))
    u = np.array([np.broadcast_to(x.values[0], inputs) for x in known[ANGLE][own]], float)
    is_known = np.any(u != 0.0, axis=0)
    u, is_root = _roots(implicit, still, u) if np.any(is_known) else (u, is_known)
    if not np.all(is_root & is_known):
        u = np.where(is_root & is_known, u, _nearest_roots(implicit, still))
    known[ANGLE][own] = [Taylor([x]) for x in u]
    still[ANGLE][own] = known[ANGLE][own]
    _, slopes = _with_slopes(implicit, still, u)
    inverse = np.linalg.inv(np.moveaxis(slopes, (0, 1), (-2, -1)))
    like = next(x for kind in (PRODUCT, COORDINATE) for x in known[kind])
    series = [like * 0.0 + x for x in u]
    for _ in range(len(like.values) + bool(like.changes)):
        known[ANGLE][own] = series
        sums = _sums(implicit.sums[: len(u)], known)
        series = [x - sum((g * inverse[..., k, m] for m, g in enumerate(sums)), 0.0)
                  for k, x in enumerate(series)]
    known[ANGLE][own] = series


def _with_slopes(
    implicit: ImplicitAngles, known: Known, u: Array
) -> tuple[Array, Array]:
    """Return the first m sums (m, ...) at angles (m, ...), and their slopes (m, m, ...)."""
    m, slopes, sums = len(u), [], [Taylor([0.0, 0.0])]
    for k in range(m):
        seeded = [[Taylor([x.values[0], 0.0]) for x in of] for of in known]
        seeded[ANGLE][implicit.first : implicit.first + m] = [
            Taylor([x, float(i == k)]) for i, x in enumerate(u)]
        sums = _sums(implicit.sums[:m], seeded)
        slopes.append([np.broadcast_to(x.values[1], u[0].shape) for x in sums])
    return (np.array([np.broadcast_to(x.values[0], u[0].shape) for x in sums]),
            np.array(slopes).swapaxes(0, 1))


def _judged(
    implicit: ImplicitAngles, known: Known, u: Array
) -> tuple[Array, Array]:
    """Return the sum that is positive at a root, and the one that is least there, at angles."""
    still = [list(of) for of in known]
    still[ANGLE][implicit.first : implicit.first + len(u)] = [Taylor([x]) for x in u]
    positive, least = (np.broadcast_to(x.values[0] if isinstance(x, Taylor) else x, u[0].shape)
                       for x in _sums(implicit.sums[len(u) :], still))
    return positive, least


def _roots(
    implicit: ImplicitAngles, known: Known, u: Array,
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
    implicit: ImplicitAngles, known: Known
) -> Array:
    """Return of all the roots the ones (m, ...) at which the last sum is least in size."""
    m = len(implicit.spans)
    grid = np.meshgrid(*(np.linspace(low, high, STARTS[m - 1], endpoint=False)
                         for low, high in implicit.spans))
    starts = np.array([x.ravel() for x in grid])
    shape = np.broadcast_shapes(*(np.shape(x.values[0]) for of in known for x in of))
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
    out[c.plain] = products[order][c.product[c.plain]]
    for group in composed_of(c):
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
        As many as `wrenches`, (n_closure + len(other_body_products), 6, ...).
    """
    n = c.n_closure + len(c.other_body_products)
    out = [np.zeros((n, *w.shape[1:])) for w in wrenches]
    for total, w in zip(out, wrenches, strict=True):
        total[c.plain] = w[c.product[c.plain]]
    extra = {x: k for k, (_, x, _) in enumerate(c.other_body_products, start=c.n_closure)}
    for group in composed_of(c):
        if not len(group.products):
            continue
        slopes = group.slopes(products, coordinates, angles)[: len(group.products)]
        for k, (at, slope) in enumerate(zip(group.products, slopes, strict=True)):
            to = [extra[p] for p in at.tolist()] if k in group.other_body_products else group.rows
            term = slope * Taylor.of([w[at] for w in wrenches])
            for total, w in zip(out, term.values, strict=True):
                total[to] += w
    return out
