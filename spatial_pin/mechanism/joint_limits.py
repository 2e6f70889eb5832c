"""Joint limits of the URDF."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_anew, made_once
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
        q, v: its indices in configuration and velocity.
        value: the limit [rad or m].
        side: +1 for an upper limit, -1 for a lower one.
        size: 1 rad, or the characteristic length [m].

    Example:
        >>> mech = sp.load("excavator")
        >>> state = sp.assemble(mech, {"boom": 2.05})  # let go, 0.05 m above its lower limit
        >>> limit = sp.simulate(mech, state, 0.4).joint_limits[0].limit
        >>> limit.name, limit.side, limit.value, limit.unit
        ('boom_slide', -1, 2.0, 'm')
        >>> limit.words, round(float(limit.room(state.q)), 3)  # [m]
        ('lower limit 2 m of boom_slide', 0.05)
    """

    name: str
    unit: str
    q: int
    v: int
    value: float
    side: int
    size: float

    def room(self, q: Array) -> Array:
        """Return the distance to the limit, at q (nq,) or (N, nq) [rad or m].

        Args:
            q: configurations, (nq,) or (N, nq).

        Example:
            >>> mech = sp.load("excavator")
            >>> state = sp.assemble(mech, {"boom": 2.05})  # let go, 0.05 m above its lower limit
            >>> limit = sp.simulate(mech, state, 0.4).joint_limits[0].limit
            >>> print(f"{limit.room(state.q):.3f} m")
            0.050 m
        """
        return self.side * (self.value - q[..., self.q])

    def closing(self, v: Array) -> Array:
        """Return the speed towards the limit, at v (nv,) or (N, nv) [rad/s or m/s]."""
        return self.side * v[..., self.v]

    @property
    def words(self) -> str:
        """Side, value and coordinate of the limit, as text."""
        side = "upper" if self.side > 0 else "lower"
        return f"{side} limit {self.value:.9g} {self.unit} of {self.name}"


# the limits of joints: indices in q and v, values, sides, and margins
LimitArrays = tuple[list[JointLimit], NDArray[np.intp], NDArray[np.intp], Array, Array, Array]


@made_once
def position_limits(mechanism: Mechanism) -> tuple[Array, Array]:
    """Return lower and upper limits (nq,) of the model: its own arrays, not to be changed."""
    return mechanism.model.lowerPositionLimit, mechanism.model.upperPositionLimit


def joint_limits(mechanism: Mechanism) -> list[JointLimit]:
    """Return the joint limits that the URDF states, lower below upper, as coordinates go."""
    return limit_arrays(mechanism)[0]


def beyond_limits(mechanism: Mechanism, q: Array) -> dict[str, float]:
    """Return signed excesses of coordinates at q (nq,) over their limits [rad or m], by name."""
    limits, entries, _, values, sides, slack = limit_arrays(mechanism)
    if not limits:
        return {}
    by = sides * (q[entries] - values)
    return {limits[k].name: float(sides[k] * by[k]) for k in np.flatnonzero(by > slack)}


def is_within_limits(mechanism: Mechanism, q: Array) -> bool:
    """Whether no coordinate of a configuration (nq,) is beyond its joint limits."""
    _, entries, _, values, sides, slack = limit_arrays(mechanism)
    return not (sides * (q[entries] - values) > slack).any()


def limit_arrays(mechanism: Mechanism) -> LimitArrays:
    """Return the present limits of the model, which its user may change, as arrays (n,)."""
    lower, upper = position_limits(mechanism)
    return _stated_by(mechanism, lower.tobytes() + upper.tobytes())


@made_anew
def _stated_by(mechanism: Mechanism, numbers: bytes) -> LimitArrays:
    lower, upper = position_limits(mechanism)
    limits = [JointLimit(c.name, c.unit, c.q, c.v, float(value), side,
                         float(mechanism.velocity_scale[c.v]))
              for c in mechanism.coordinate_table.values() if c.q >= 0 and lower[c.q] < upper[c.q]
              for value, side in ((lower[c.q], -1), (upper[c.q], 1)) if abs(value) < UNSTATED]
    return (
        limits, np.array([x.q for x in limits], np.intp), np.array([x.v for x in limits], np.intp),
        np.array([x.value for x in limits]), np.array([float(x.side) for x in limits]),
        np.array([SLACK * x.size for x in limits]))
