"""Where a point or a follower touches its curve: the coordinate `CLOSURE.s` [m], and the shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

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
    if curve.graph:
        s = curve.graph[2](z)
        return CoordinateRates(*(s.derivative(k) for k in range(3)))
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


class ContactShape(NamedTuple):
    """A curve where it is touched, N samples.

    Attributes:
        normal: (N, 3) of a plane closed curve, outwards, in the axes of frame 1.
        point: (N, 3) of contact, likewise [m].
        curvature: (N,) of the curve, positive where a closed one is convex [1/m].
    """

    normal: Array
    point: Array
    curvature: Array


def contact_shape(closure: Closure, seen: tuple[Array, Array]) -> ContactShape:
    """Return the curve at its contact, from its distance by direction, or its support function.

    Args:
        closure: of a curve.
        seen: origin (N, 3) [m] and rotation (N, 3, 3) of frame 2 in frame 1.
    """
    curve: Any = closure.numbers["curve"]
    follower: Any = closure.numbers.get("follower")
    position, rotation = seen
    if curve.graph:
        z = (position - curve.centre) @ curve.axes[:, 2]
        series = [f(Taylor.of([z, np.ones_like(z), np.zeros_like(z)])) for f in curve.graph[:2]]
        rate, rise = (np.column_stack([*(x.derivative(k) for x in series), (2 - k) + 0.0 * z])
                      for k in (1, 2))
        bent = np.linalg.norm(np.cross(rate, rise), axis=1) / np.linalg.norm(rate, axis=1)**3
        return ContactShape(np.full_like(position, np.nan), position, bent)
    if curve.at is None:
        radius, lead = curve.numbers or (0.0, 1.0)
        bent = radius / (radius**2 + (lead / (2.0 * np.pi))**2)
        return ContactShape(np.full_like(position, np.nan), position,
                            np.full(len(position), bent))
    flat = follower.flat if follower is not None else None
    is_face = flat is not None
    out = rotation @ (follower.side * flat) if is_face else position - curve.centre
    x, y = (out @ curve.axes)[:, :2].T
    offset = follower.side * follower.radius if follower is not None else 0.0
    function = (curve.support() if is_face else curve.radial(offset))[0]
    angle = np.arctan2(y, x)
    series = function(Taylor.of([angle, np.ones_like(angle), np.zeros_like(angle)]))
    value, first, second = (series.derivative(k) for k in range(3))
    ahead = np.column_stack([np.cos(angle), np.sin(angle)])
    aside = np.column_stack([-np.sin(angle), np.cos(angle)])
    if is_face:  # distance h of the tangent
        normal, radius = ahead, value + second
        point = ahead * value[:, None] + aside * first[:, None]
        bent = 1.0 / radius
    else:  # squared distance r^2
        r = np.sqrt(value)
        slope = 0.5 * first / r
        rise = 0.5 * second / r - slope**2 / r
        size = np.hypot(r, slope)
        normal = (ahead * r[:, None] - aside * slope[:, None]) / size[:, None]
        outer = (r**2 + 2.0 * slope**2 - r * rise) / size**3
        bent = outer / (1.0 - offset * outer)
        point = ahead * r[:, None] - offset * normal
    plane = curve.axes[:, :2].T
    return ContactShape(normal @ plane, point @ plane + curve.centre, bent)
