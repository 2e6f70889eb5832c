"""Where a point or a follower touches its curve: the coordinate `CLOSURE.s` [m]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.mechanism.coordinates import CoordinateRates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.taylor import Taylor, argument

END = ".s"


def contact_closure(mechanism: Mechanism, name: object) -> Closure | None:
    """Return the closure that a name `CLOSURE.s` is of; None of other names."""
    if not isinstance(name, str) or not name.endswith(END) or name in mechanism.coordinate_table:
        return None
    whole = mechanism.whole or mechanism
    return next((c for c in whole.closures
                 if "curve" in c.numbers and c.name == name.removesuffix(END)), None)


def contact_rates(
    mechanism: Mechanism, closure: Closure, frames: Sequence[Any], angles: Array
) -> CoordinateRates[Array]:
    """Return place, rate and acceleration (N,) along the curve [m, m/s, m/s²].

    Args:
        mechanism: the mechanism.
        closure: of a curve.
        frames: motions (N,) of its two frames, as `FrameMotion`.
        angles: (N, n_angles) that count turns [rad].
    """
    one, two = frames
    curve, follower = closure.numbers["curve"], closure.numbers.get("follower")
    w, e = one.angular_velocity, one.angular_acceleration
    if follower is not None and follower.flat is not None:  # the face's normal, in the world
        normal = two.rotation @ (follower.side * follower.flat)
        rate = np.cross(two.angular_velocity, normal)
        vectors = normal, rate, (np.cross(two.angular_acceleration, normal)
                                 + np.cross(two.angular_velocity, rate))
    else:
        centre = one.rotation @ curve.centre
        moving = np.cross(w, centre)
        vectors = (two.position - one.position - centre, two.velocity - one.velocity - moving,
                   two.acceleration - one.acceleration - np.cross(e, centre) - np.cross(w, moving))
    d, v, a = vectors
    v_seen = v - np.cross(w, d)  # as frame 1 sees it
    a_seen = a - np.cross(e, d) - 2.0 * np.cross(w, v_seen) - np.cross(w, np.cross(w, d))
    local = [np.einsum("nij,ni->nj", one.rotation, x) @ curve.axes for x in (d, v_seen, a_seen)]
    x, y, z = (Taylor.of([part[:, k] for part in local]) for k in range(3))
    if curve.at is None and not curve.numbers:  # a line
        return CoordinateRates(*(z.derivative(k) for k in range(3)))
    constraints = constraints_of(mechanism)
    row = [k for k, angle in enumerate(constraints.angles) if angle.name[0] == closure.name]
    near = angles[:, row[0]] if row and angles.shape[-1] else np.zeros(len(d))
    angle = argument(y, x, near)
    if curve.at is None:
        radius, lead = curve.numbers
        s = angle * float(np.hypot(radius, lead / (2.0 * np.pi)))
    elif follower is None:
        s = curve.radial()[1](angle)
    elif follower.flat is None:
        s = curve.radial(follower.side * follower.radius)[1](angle)
    else:
        s = curve.support()[1](angle)
    return CoordinateRates(*(s.derivative(k) for k in range(3)))


