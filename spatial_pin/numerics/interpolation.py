"""Curves through equidistant nodes with their first and second derivatives.

Four neighbouring nodes make a polynomial of degree 11 [Hermite]: with L_i Lagrange's polynomials,
d = u - u_i, S_n the sum of (u_i - u_j)^-n,

    y(u) = sum of L_i^3 (y_i (1 + g1 d + g2 d^2) + y_i' (d + g1 d^2) + y_i'' d^2 / 2),
    g1 = -3 S_1, g2 = (3 S_2 + 9 S_1^2) / 2,

which continues 1/L_i^3 at u_i. Between the middle nodes the error is
0.178 h^12 y^(12) / 12! with h the distance of the nodes.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from spatial_pin.numerics.linalg import Array

STENCIL = np.array([-1.0, 0.0, 1.0, 2.0])
_GAPS = STENCIL[:, None] - STENCIL + np.eye(4)
_S1, _S2 = ((1.0 / _GAPS**n).sum(axis=1) - 1.0 for n in (1, 2))


class NodeCurve:
    """The curve through nodes s0 + h j, j = 0 .. n - 1, of which there are at least four.

    Args:
        s0: first node.
        h: distance of the nodes, of either sign.
        y, first, second: (k, n) values and derivatives at the nodes.
    """

    def __init__(self, s0: float, h: float, y: Array, first: Array, second: Array) -> None:
        self.s0, self.h, self.n = s0, h, y.shape[1]
        scaled = np.array([y, h * first, h * h * second])
        stencils = np.lib.stride_tricks.sliding_window_view(scaled, 4, axis=2)
        # (stencils, k, 12): gathered row by row
        self._stencils = np.ascontiguousarray(stencils.transpose(2, 1, 0, 3)).reshape(
            self.n - 3, len(y), 12)

    def reaches(self, s: float) -> bool:
        """Whether a value lies between the first and the last node."""
        return -1e-9 <= (s - self.s0) / self.h <= self.n - 1 + 1e-9

    def __call__(self, s: Array) -> Array:
        """Return the curve (k, m) at s (m,) between the first and the last node."""
        x = (s - self.s0) / self.h
        left = np.clip(np.floor(x), 1, self.n - 3).astype(np.intp)
        d = (x - left) - STENCIL[:, None]
        first, last = d[0] * d[1], d[2] * d[3]
        lagrange = np.array([d[1] * last, d[0] * last, first * d[3], first * d[2]])
        lagrange /= _GAPS.prod(axis=1)[:, None]
        weights = np.empty((3, *d.shape))
        g1, g2 = -3.0 * _S1[:, None], (1.5 * _S2 + 4.5 * _S1**2)[:, None]
        weights[0] = 1.0 + (g1 + g2 * d) * d
        weights[1] = (1.0 + g1 * d) * d
        weights[2] = 0.5 * d * d
        weights *= lagrange * lagrange * lagrange
        stencils = self._stencils.take(left - 1, axis=0)
        return np.ascontiguousarray((stencils @ weights.reshape(12, -1).T[:, :, None])[:, :, 0].T)


def integrals(h: float, first: Array, second: Array) -> Array:
    """Return the integrals (..., n - 1) of a function between n nodes at a distance h.

    Exact to degree 7, from the function and its derivative, `first` and `second` (..., n), at the
    nodes, of which there are at least four.
    """
    n = first.shape[-1]
    interval = np.arange(n - 1)
    left = np.clip(interval, 1, n - 3)
    weights = _INTEGRALS[:, :, interval - left + 1]
    at = left + np.array([[-1], [0], [1], [2]])
    return h * np.einsum("im,...im->...m", weights[0], first[..., at]) + h * h * np.einsum(
        "im,...im->...m", weights[1], second[..., at])


def _integrals() -> Array:
    """Return (2, 4, 3): weights of values and derivatives for the three intervals of a stencil.

    Hermite's polynomials integrated in fractions: quadrature would leave each machine another last
    bit, and large terms cancel.
    """
    nodes = [Fraction(x) for x in STENCIL]
    out = np.empty((2, 4, 3))
    for i, node in enumerate(nodes):
        square, slope = [Fraction(1)], Fraction(0)
        for x in nodes[:i] + nodes[i + 1 :]:
            factor = [-x / (node - x), 1 / (node - x)]
            square, slope = _times(_times(square, factor), factor), slope + 1 / (node - x)
        value = _times(square, [1 + 2 * slope * node, -2 * slope])
        derivative = _times(square, [-node, Fraction(1)])
        for k, start in enumerate(nodes[:3]):
            out[:, i, k] = [float(_integral(p, start)) for p in (value, derivative)]
    return out


def _times(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    """Return the product of two polynomials, the lowest coefficient first."""
    product = [Fraction(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            product[i + j] += x * y
    return product


def _integral(polynomial: list[Fraction], start: Fraction) -> Fraction:
    """Return the integral of a polynomial over an interval of length one."""
    return sum((c * ((start + 1) ** (k + 1) - start ** (k + 1)) / (k + 1)
                for k, c in enumerate(polynomial)), Fraction(0))


_INTEGRALS = _integrals()
