"""The natural units of a motion: what counts as one of every unknown, whatever the unit of time.

A mechanism that moves a million times faster moves on the same curve. Its error control should see
the same numbers, so rates are counted per natural time T, and work by the energy of its heaviest
coordinate at that rate. 1/T is the largest of

    rates,  square roots of accelerations,  sqrt(gravity / characteristic length)

at the start of the integration (all in radians or characteristic lengths), by 2 pi: T is about the
period of a pendulum, or of a turn. Where nothing moves or pulls, T is many durations.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spatial_pin.dynamics.simulation.system import System
from spatial_pin.errors import SpatialPinError
from spatial_pin.numerics.linalg import Array

FASTEST = 1e100  # rate whose square, by a tolerance, still has a square
SLOWEST = 1e3  # durations that a natural time may last


class Units(NamedTuple):
    """What counts as one.

    Attributes:
        time: the natural time T [s].
        unknowns: (n,) of every unknown: 1 of coordinates and quaternions, 1/T of rates, and an
            energy of work.
    """

    time: float
    unknowns: Array


def natural_units(system: System, t: float, y: Array, q: Array, left: float) -> Units:
    """Return the natural units of a motion that stands at the unknowns y.

    Args:
        system: its equations.
        t: when [s].
        y: (n,) unknowns.
        q: (nq,) configuration there.
        left: how long it goes on [s].

    Raises:
        SpatialPinError: it changes faster than numbers can tell.
    """
    problem, n = system.problem, len(system.free)
    mechanism = problem.mechanism
    acceleration = np.abs(system(t, y)[n : 2 * n])
    gravity = float(np.linalg.norm(problem.model.gravity.linear))
    pace = max(float(np.abs(y[n : 2 * n]).max(initial=0.0)),
               math.sqrt(np.nan_to_num(acceleration, nan=0.0).max(initial=0.0)),
               math.sqrt(gravity / mechanism.characteristic_length))
    if pace > FASTEST:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: at {t:.6g} s it moves so fast, or forces are so large, "
            f"that it changes within {1.0 / pace:.1g} s: numbers cannot tell how")
    rate = max(pace / (2.0 * math.pi), 1.0 / (SLOWEST * left))
    units = np.ones(len(y))
    units[n : 2 * n] = rate
    if problem.works:
        units[-1] = problem.heaviest(q) * rate * rate or 1.0
    return Units(1.0 / rate, units)
