"""Closure equations that are more than one product of vectors, from what they are made of.

Screws, differences of distances and couplings: their values, rates, derivatives and wrenches follow
from those of their products and coordinates, by the formulas in `kinds`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spatial_pin.constraints.compiled_equations import Constraints
from spatial_pin.constraints.kinds import Composed
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.taylor import Taylor


def composed_rates(
    c: Constraints, products: Sequence[Array], coordinates: Sequence[Array]
) -> Array:
    """Return (n_closure, ...) the last of the products' derivatives, of the closure equations.

    Args:
        c: the equations.
        products: (N, ...) derivatives 0, 1, ... of all products.
        coordinates: q, v and further derivatives (nv, ...); zero where there are no more.
    """
    order = len(products) - 1
    out = np.zeros((c.n_closure, *products[0].shape[1:]))
    out[: c.n_products] = products[order][: c.n_products]
    for group in c.composed:
        value, _ = group.values(group.inputs(products, coordinates))
        out[group.rows] = value.derivative(order)
    return out


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


def combined_wrenches(
    c: Constraints, products: Sequence[Array], wrenches: Sequence[Array]
) -> list[Array]:
    """Return the wrenches of the equations; after them those that act on other bodies.

    Args:
        c: the equations.
        products: (N, 1, ...) of the products, and a derivative of theirs if wanted.
        wrenches: (N, 6, ...) of the products, or what else is linear in their derivatives; and
            the same derivative of that.

    Returns:
        As many as `wrenches`, (n_wrenches, 6, ...).
    """
    out = [np.zeros((c.n_wrenches, *w.shape[1:])) for w in wrenches]
    for total, w in zip(out, wrenches, strict=True):
        total[c.plain] = w[c.plain]
    extra = {row: k for k, (row, _) in enumerate(c.elsewhere, start=c.n_closure)}
    for group in c.composed:
        for k, (at, slope) in enumerate(zip(group.products, group.slopes(products), strict=True)):
            to = [extra[row] for row in group.rows] if k in group.kind.elsewhere else group.rows
            term = slope * Taylor.of([w[at] for w in wrenches])
            for total, w in zip(out, term.values, strict=True):
                total[to] += w
    return out
