"""What leads along a branch: the value of one driver, or a parameter that several go by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from spatial_pin.kernel.paths import Path
from spatial_pin.mechanism.coordinates import coordinate_value
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.numerics.linalg import Array

SMOOTH_POINTS = 8  # Chebyshev points that a law is smoothed by: as many as nodes on either side

NEAREST_STEPS = 4  # of Newton's method, each of which squares an error that is below 1e-4


class OneDriver:
    """The value of what is driven first leads; all else that is driven stands.

    Attributes:
        begin: the leading value at the start [rad or m].
        n_moving: how many of what is driven move, the first ones.

    Args:
        mechanism: the mechanism.
        driven: the prescribed coordinates, the driver first.
        q: (nq,) configuration at the start.
    """

    def __init__(self, mechanism: Mechanism, driven: Sequence[Coordinate], q: Array) -> None:
        self.driven = driven
        self._start = np.array([0.0 if isinstance(c, VelocityEntry) else
                                coordinate_value(mechanism, c, q) for c in driven])
        self.begin, self.n_moving = float(self._start[0]), 1

    def values(self, s: float) -> Array:
        """Return the values (k,) of what is driven."""
        return np.append(s, self._start[1:])

    def rates(self, s: float) -> Array:
        """Return their derivatives (k,) with respect to the leading value."""
        return np.eye(1, len(self.driven))[0]

    def bends(self, s: float) -> Array:
        """Return their second derivatives (k,)."""
        return np.zeros(len(self.driven))

    def smooth(self, here: float, first: float, last: float) -> Any | None:
        """Return a law that is smooth between two leading values; None if this one is."""
        return None

    def put(self, q: Array, s: float) -> None:
        """Write the values of driven coordinates that are entries of q into it."""
        for c, value in zip(self.driven, self.values(s).tolist(), strict=True):
            if c.q >= 0:
                q[c.q] = value

    def prescribe(self, path: Path, s: float, still: Sequence[int]) -> None:
        """Let a path go on from a leading value; see `DriversLaw`."""


class DriversLaw(OneDriver):
    """A parameter leads that the coordinates driven first go by; what is driven besides stands.

    Args:
        mechanism: the mechanism.
        driven: the prescribed coordinates, those that go first.
        q: (nq,) configuration at the start.
        law: SciPy's piecewise polynomial of the parameter, to their values.
        begin: the parameter at the start.
    """

    def __init__(
        self, mechanism: Mechanism, driven: Sequence[Coordinate], q: Array, law: Any, begin: float
    ) -> None:
        from scipy.interpolate import PPoly  # on use: it takes a tenth of a second

        super().__init__(mechanism, driven, q)
        self.begin, self.n_moving = begin, law.c.shape[-1]
        n = self.n_moving
        c = np.zeros((*law.c.shape[:2], len(driven)))
        c[..., :n], c[-1, :, n:] = law.c, self._start[n:]
        self.law = PPoly(c, law.x)
        self._rates, self._bends = self.law.derivative(), self.law.derivative(2)
        self._standing = {c.v: float(q[c.q]) for c in mechanism.coordinate_table.values()
                          if c.q >= 0}

    def values(self, s: float) -> Array:
        """Return the values (k,) of what is driven."""
        return self.law(s)

    def rates(self, s: float) -> Array:
        """Return their derivatives (k,) with respect to the parameter."""
        return self._rates(s)

    def bends(self, s: float) -> Array:
        """Return their second derivatives (k,)."""
        return self._bends(s)

    def smooth(self, here: float, first: float, last: float) -> Any:
        """Return one polynomial for the law between two parameters, the same `here`.

        Returns:
            SciPy's piecewise polynomial, of one piece, of what moves.
        """
        from scipy.interpolate import PPoly

        low, width = min(first, last), abs(last - first)
        parts = 0.5 - 0.5 * np.cos(np.pi * np.arange(SMOOTH_POINTS) / (SMOOTH_POINTS - 1))
        values = self.law(low + width * parts)[:, : self.n_moving]
        c = np.linalg.solve(np.vander(parts), values)
        c /= width ** np.arange(SMOOTH_POINTS - 1.0, -1.0, -1.0)[:, None]
        found = PPoly(c[:, None, :], [low, low + width])
        found.c[-1] += self.law(here)[: self.n_moving] - found(here)
        return found

    def prescribe(self, path: Path, s: float, still: Sequence[int]) -> None:
        """Let a path go on from a parameter, along the law.

        Args:
            path: of the kernel.
            s: the parameter.
            still: places in the velocity vector that stand still, where coordinates have values.
        """
        coefficients = np.moveaxis(self.law.c[::-1], 0, 2)
        all_driven = np.zeros((len(coefficients), path.n_driven, coefficients.shape[-1]))
        all_driven[:, : len(self.driven)] = coefficients
        all_driven[:, len(self.driven) :, 0] = [self._standing.get(v, 0.0) for v in still]
        path.prescribe(s, self.law.x, all_driven)


def nearest(law: OneDriver, other: OneDriver, s: float) -> float:
    """Return the leading value at which a law is nearest to where another, a little off, is at s.

    It is farther off sideways, if at all, in what several drivers do.
    """
    if law is other:
        return s
    k, found = law.n_moving, s
    goal = other.values(s)[:k]
    for _ in range(NEAREST_STEPS):
        rates = law.rates(found)[:k]
        found += float((goal - law.values(found)[:k]) @ rates / (rates @ rates))
    return found
