"""Joint limits of the URDF."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

UNSTATED = float(np.finfo(float).max)  # size of a limit where there is none
SLACK = TOLERANCES.closed  # beyond a limit that is not called so: coordinates are known to it


class JointLimit(NamedTuple):
    """One limit of one joint coordinate.

    Attributes:
        name: of the coordinate.
        unit: "rad" or "m".
        q, v: where it stands in configuration and velocity.
        value: the limit [rad or m].
        side: +1 for an upper limit, -1 for a lower one.
        size: 1 rad, or the characteristic length [m].
    """

    name: str
    unit: str
    q: int
    v: int
    value: float
    side: int
    size: float

    def room(self, q: Array) -> Array:
        """Return how much is left before the limit, at q (nq,) or (N, nq) [rad or m]."""
        return self.side * (self.value - q[..., self.q])

    def closing(self, v: Array) -> Array:
        """Return how fast the room grows less, at v (nv,) or (N, nv) [rad/s or m/s]."""
        return self.side * v[..., self.v]

    @property
    def words(self) -> str:
        """What it is, for a sentence."""
        side = "upper" if self.side > 0 else "lower"
        return f"{side} limit {self.value:.9g} {self.unit} of {self.name}"


def joint_limits(mechanism: Mechanism) -> list[JointLimit]:
    """Return the joint limits that the URDF states, in the order of the coordinates.

    Joints whose lower limit is not below the upper one have none: both are 0 where the URDF states
    neither.
    """
    table = [c for c in mechanism.coordinate_table.values() if c.q >= 0]
    places = [c.q for c in table]
    lows, highs = (x[places].tolist() for x in (mechanism.model.lowerPositionLimit,
                                                mechanism.model.upperPositionLimit))
    return [JointLimit(c.name, c.unit, c.q, c.v, value, side, float(mechanism.velocity_scale[c.v]))
            for c, low, high in zip(table, lows, highs, strict=True) if low < high
            for value, side in ((low, -1), (high, 1)) if abs(value) < UNSTATED]


def beyond_limits(mechanism: Mechanism, q: Array) -> dict[str, float]:
    """Return how far coordinates are beyond their joint limits, of those that are [rad or m].

    Args:
        mechanism: the mechanism.
        q: (nq,) the configuration.

    Returns:
        The signed amounts by coordinate: positive beyond upper limits, negative beyond lower ones.
    """
    places, slack = _places(mechanism)
    here = q[places]
    low, high = (x[places] for x in (mechanism.model.lowerPositionLimit,
                                     mechanism.model.upperPositionLimit))
    if ((here >= low - slack) & (here <= high + slack) | (low >= high)).all():  # as a rule
        return {}
    rooms = {limit: float(limit.room(q)) for limit in joint_limits(mechanism)}
    return {limit.name: -limit.side * room for limit, room in rooms.items()
            if room < -SLACK * limit.size}


def _places(mechanism: Mechanism) -> tuple[NDArray[np.intp], Array]:
    """Return the places in q of coordinates that may have limits, and half of their slack."""
    if "limited" not in mechanism.memo:
        table = [c for c in mechanism.coordinate_table.values() if c.q >= 0]
        mechanism.memo["limited"] = (
            np.array([c.q for c in table], dtype=np.intp),
            0.5 * SLACK * mechanism.velocity_scale[[c.v for c in table]])
    places, slack = mechanism.memo["limited"]
    return places, slack
