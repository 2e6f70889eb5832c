"""Truncated Taylor series: a formula written once gives its derivatives of every order.

A series is known to an order in t, and to first order in a second parameter e if it carries
`changes` (dual numbers): those of f(t, e) = sum over k of (values[k] + e changes[k]) t^k. Values
are arrays of any shapes that broadcast.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial
from typing import Any

import numpy as np

from spatial_pin.numerics.linalg import whole_turns

Coefficient = Any  # an array, or a number for all of its entries


class Taylor:
    """A truncated series.

    Attributes:
        values: coefficients of t^k.
        changes: of e t^k, as many; empty if they are not wanted.
    """

    __array_ufunc__ = None  # NumPy leaves its arrays' products and sums with series to these

    def __init__(self, values: list[Coefficient], changes: list[Coefficient] | None = None) -> None:
        self.values, self.changes = values, changes or []

    @staticmethod
    def of(derivatives: Sequence[Coefficient], changes: Sequence[Coefficient] = ()) -> Taylor:
        """Return the series of derivatives 0, 1, ... in t, and of their derivatives in e."""
        return Taylor(*([x / factorial(k) for k, x in enumerate(part)]
                        for part in (derivatives, changes)))

    def derivative(self, order: int) -> Coefficient:
        """Return a derivative in t at 0."""
        return factorial(order) * self.values[order]

    def change(self, order: int) -> Coefficient:
        """Return the derivative in e of a derivative in t at 0."""
        return factorial(order) * self.changes[order]

    def __add__(self, other: Taylor | Coefficient) -> Taylor:
        if not isinstance(other, Taylor):
            return Taylor([self.values[0] + other, *self.values[1:]], self.changes)
        return Taylor([a + b for a, b in zip(self.values, other.values, strict=True)],
                      [a + b for a, b in zip(self.changes, other.changes, strict=True)])

    def __neg__(self) -> Taylor:
        return self * -1.0

    def __sub__(self, other: Taylor | Coefficient) -> Taylor:
        return self + -other

    def __rsub__(self, other: Coefficient) -> Taylor:
        return -self + other

    def __mul__(self, other: Taylor | Coefficient) -> Taylor:
        if not isinstance(other, Taylor):
            return Taylor([a * other for a in self.values], [a * other for a in self.changes])
        changes = [x + y for x, y in zip(_product(self.changes, other.values),
                                         _product(self.values, other.changes), strict=True)]
        return Taylor(_product(self.values, other.values), changes)

    __radd__, __rmul__ = __add__, __mul__


def _product(a: list[Coefficient], b: list[Coefficient]) -> list[Coefficient]:
    """Return the coefficients of a product (Cauchy), none where one has none."""
    return [sum(a[i] * b[k - i] for i in range(k + 1)) for k in range(min(len(a), len(b)))]


def argument(sine: Taylor, cosine: Taylor, near: Coefficient = 0.0) -> Taylor:
    """Return the angle of a direction, of the turn nearest an angle.

    It is the imaginary part of log z, z = cosine + i sine; with u = z / z(0) - 1, whose
    powers above the order vanish, log(1 + u) = u - u² / 2 + u³ / 3 - ...

    Args:
        sine: of the angle; or both times the same positive number.
        cosine: of the angle.
        near: that the angle is nearest to [rad].
    """
    z = cosine + 1j * sine
    u = z * (1.0 / z.values[0])
    u.values[0] = 0.0
    total = power = u
    for k in range(2, len(u.values) + (1 if u.changes else 0)):
        power = power * u
        total = total + power * ((-1.0) ** (k + 1) / k)
    angle = np.arctan2(sine.values[0], cosine.values[0])
    angle = angle + whole_turns(near - angle)
    return Taylor([angle, *(np.imag(x) for x in total.values[1:])],
                  [np.imag(x) for x in total.changes])
