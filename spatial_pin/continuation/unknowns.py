"""The unknowns of a curve: configurations, or configurations and the parameter that drivers go by.

Where a driver itself leads, it is one of the coordinates, and its equation is left out. Where
several go by a law of one parameter, that is an unknown more, and their equations have a column
more: their rates.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.continuation.driving import DriversLaw
from spatial_pin.numerics.linalg import Array


class Configurations:
    """Unknowns x (nq,) that are configurations, the first driver free.

    Attributes:
        scale: (n,) change of a unit of each unknown's velocity.
        drive: (d, nv) equations of what is driven or stands still.
        at: place of the leading value in x.
        rate: place of its rate in tangents.

    Args:
        system: the square system of what is driven.
    """

    def __init__(self, system: SquareSystem) -> None:
        self.model, self.scale = system.evaluation.model, system.scale
        self.at, self.rate = system.driven[0].q, system.driven[0].v
        self.drive = system.drive[1:]

    def of(self, q: Array, s: float) -> Array:
        """Return the unknowns at a configuration and a leading value, which q has already."""
        return q

    def configuration(self, x: Array) -> Array:
        """Return the configuration (nq,)."""
        return x

    def along(self, t: Array) -> Array:
        """Return the scaled tangent of the derivative (nv,) with respect to the leading value."""
        return t / self.scale

    def moved(self, x: Array, step: Array) -> Array:
        """Return the unknowns after a scaled step."""
        return pin.integrate(self.model, x, self.scale * step)

    def apart(self, x: Array, y: Array) -> Array:
        """Return the scaled step from unknowns to others."""
        return pin.difference(self.model, x, y) / self.scale

    def normalized(self, x: Array) -> Array:
        """Return the unknowns with quaternions of unit length."""
        return pin.normalize(self.model, x)

    def put(self, x: Array, s: float) -> None:
        """Give what is driven its values at a leading value, which becomes x's."""
        x[self.at] = s

    def completed(self, rows: Array, first: int, x: Array) -> Array:
        """Return equations (m, n) from those of configurations (m, nv), the driven from `first`."""
        return rows

    def gaps(self, x: Array) -> Array:
        """Return how far driven coordinates are from their values, relative to their sizes."""
        return np.empty(0)


class WithParameter(Configurations):
    """Unknowns x (nq + 1,): a configuration, and the parameter of a law that drivers go by.

    Args:
        system: the square system of what is driven.
        law: how the drivers go.
        unit: change of the parameter that counts as one radian.
    """

    def __init__(self, system: SquareSystem, law: DriversLaw, unit: float) -> None:
        self.model, self.law, self.unit = system.evaluation.model, law, unit
        self.scale = np.append(system.scale, unit)
        self.at = self.rate = -1
        self.drive = system.drive
        self._places = [c.q for c in system.driven]
        self._sizes = np.array([system.scale[c.v] for c in system.driven])

    def of(self, q: Array, s: float) -> Array:
        """Return the unknowns at a configuration and a parameter."""
        return np.append(q, s)

    def configuration(self, x: Array) -> Array:
        """Return the configuration (nq,)."""
        return x[:-1]

    def along(self, t: Array) -> Array:
        """Return the scaled tangent of the derivative (nv,) with respect to the parameter."""
        return np.append(t, 1.0) / self.scale

    def moved(self, x: Array, step: Array) -> Array:
        """Return the unknowns after a scaled step."""
        step = self.scale * step
        return np.append(pin.integrate(self.model, x[:-1], step[:-1]), x[-1] + step[-1])

    def apart(self, x: Array, y: Array) -> Array:
        """Return the scaled step from unknowns to others."""
        return np.append(pin.difference(self.model, x[:-1], y[:-1]), y[-1] - x[-1]) / self.scale

    def normalized(self, x: Array) -> Array:
        """Return the unknowns with quaternions of unit length."""
        return np.append(pin.normalize(self.model, x[:-1]), x[-1])

    def put(self, x: Array, s: float) -> None:
        """Give what is driven its values at a parameter, which becomes x's."""
        self.law.put(x[:-1], s)
        x[-1] = s

    def completed(self, rows: Array, first: int, x: Array) -> Array:
        """Return equations (m, n) from those of configurations (m, nv), the driven from `first`."""
        found = np.column_stack([rows, np.zeros(len(rows))])
        found[first : first + len(self._sizes), -1] = (
            -self.unit * self.law.rates(float(x[-1])) / self._sizes)
        return found

    def gaps(self, x: Array) -> Array:
        """Return how far driven coordinates are from their values, relative to their sizes."""
        return (x[self._places] - self.law.values(float(x[-1]))) / self._sizes
