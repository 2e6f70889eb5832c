"""Passive spins along a motion: no spin in rate must also mean none from step to step.

A body that never spins about a line b fixed in it still turns about b over a step, because its
rotations about the two other directions do not commute. With d the rotation vector of the body
over a step in its own axes and h its length, d_before and h_before those of the step before,

    b . d = b . (d_before x d) h^2 / (6 h_before (h_before + h)) + O(h^5)

(third term of the Magnus series of R' = R [omega] with omega linear over two steps).
"""

from __future__ import annotations

import numpy as np

from spatial_pin.numerics.linalg import Array


class Spin:
    """Measures the spin of one body since the last accepted step.

    Attributes:
        has_history: whether a step before the present one is known.

    Args:
        rotation: (3, 3) view that always holds the transposed rotation of the body.
        axis: (3,) unit vector of the line, in the body's axes.
    """

    def __init__(self, rotation: Array, axis: Array) -> None:
        self._rotation = rotation
        self._axis = axis.tolist()
        self._before: Array = np.eye(3)
        self.has_history = False
        self._d = self._next = [0.0, 0.0, 0.0]
        self._h = 1.0

    def continues(self, h: float) -> bool:
        """Whether a step h goes on from the last one: same sense, of comparable length."""
        return self.has_history and 0.0 < h / self._h < 4.0

    def forget(self) -> None:
        """Forget the past, after a jump."""
        self.has_history = False

    def begin(self, before: Array, h: float) -> None:
        """Take the present rotation as accepted, `before` (3, 3, transposed) a step h earlier."""
        self._before, self.has_history = before, True
        self._d, self._h = [0.0, 0.0, 0.0], h
        self.error(h)
        self.accept(h)

    def error(self, h: float) -> float:
        """Return the spin [rad] of the present rotation after a step h, too much by this much."""
        (_, xy, xz), (yx, _, yz), (zx, zy, _) = np.dot(self._before, self._rotation.T).tolist()
        x, y, z = 0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)
        larger = 1.0 + (x * x + y * y + z * z) / 6.0  # angle over sine
        self._next = x, y, z = [larger * x, larger * y, larger * z]
        u, v, w = self._d
        a, b, c = self._axis
        triple = a * (v * z - w * y) + b * (w * x - u * z) + c * (u * y - v * x)
        return a * x + b * y + c * z - triple * (h / self._h) * (h / (self._h + h)) / 6.0

    def accept(self, h: float) -> None:
        """Make the rotation of the last `error` the last accepted one."""
        self._d, self._h = self._next, h
        self._before = self._rotation.copy()
