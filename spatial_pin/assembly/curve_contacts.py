"""Where a point or a follower touches its curve: the coordinate `CLOSURE.s` [m], and the shape.

Of two curves that touch `CLOSURE.s` is on the first, `CLOSURE.s2` on the second.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from spatial_pin.constraints.compiled_equations import ANGLE, PRODUCT, constraints_of
from spatial_pin.constraints.composed_equations import ImplicitAngles, Indexed, implicit_angles
from spatial_pin.mechanism.coordinates import CoordinateRates
from spatial_pin.mechanism.curves import CurveShape, curves_in
from spatial_pin.mechanism.equations import (
    Cosine,
    Displacement,
    FunctionOf,
    Parameter,
    Quantity,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.taylor import Taylor, argument

Series = list[Taylor]


def contact_closure(mechanism: Mechanism, name: object) -> Closure | None:
    """Return the closure that a name `CLOSURE.s` or `CLOSURE.s2` is of; None of other names."""
    if not isinstance(name, str) or name in mechanism.coordinate_table:
        return None
    of, _, end = name.rpartition(".")
    closure = next((c for c in (mechanism.whole or mechanism).closures if c.name == of), None)
    return closure if closure is not None and end in contact_coordinates(closure) else None


def contact_coordinates(closure: Closure) -> tuple[str, ...]:
    """Return the coordinates of a closure that lie along its curves: "s" and "s2"."""
    return ("s", "s2")[: len(curves_in(closure.numbers))]


def contact_rates(
    mechanism: Mechanism, closure: Closure, frames: Sequence[Any], angles: Array, name: str = "s"
) -> CoordinateRates[Array]:
    """Return place, rate and acceleration (N,) along the curve [m, m/s, m/s²].

    `frames` are motions (N,) of the closure's two frames; `angles` (N, n_angles) count turns [rad].
    The name ends in "s2" of the second of two curves.
    """
    position, rotation = _relative(*frames)
    near = angles_of(mechanism, closure, angles, len(position[0].values[0]))
    second = name.endswith("2")
    curve = _curve(closure, second)
    if "curves" in closure.numbers or curve.path is not None:
        u = parameters_of(closure, position, rotation, near)
        s = curve.by_parameter.arc(u[int(second)])
    else:
        s = _curve_length(closure, position, rotation, near)
    return CoordinateRates(*(s.derivative(k) for k in range(3)))


def angles_of(mechanism: Mechanism, closure: Closure, angles: Array, n: int) -> Array:
    """Return those angles (k, n) of a motion (n, n_angles) that count turns of a closure's curves.

    Zero, two of them, where the motion has none.
    """
    rows = [k for k, angle in enumerate(constraints_of(mechanism).angles)
            if angle.name[0] == closure.name]
    angle_rows: Array = angles[:, rows].T if rows and angles.shape[-1] else np.zeros((2, n))
    return angle_rows


def _curve(closure: Closure, second: bool = False) -> CurveShape:
    """Return the curve of a closure, the first or second of two."""
    shape: CurveShape = closure.numbers["curve"] if "curve" in closure.numbers else getattr(
        closure.numbers["curves"], "two" if second else "one")
    return shape


def _relative(one: Any, two: Any) -> tuple[Series, list[Series]]:
    """Return series of the position (3,) [m] and the rotation (3, 3) of frame 2 in frame 1."""
    w, e = one.angular_velocity, one.angular_acceleration
    vectors = [tuple(getattr(two, key) - getattr(one, key)
                     for key in ("position", "velocity", "acceleration"))]
    for u in np.moveaxis(two.rotation, -1, 0):
        rate = np.cross(two.angular_velocity, u)
        vectors.append((u, rate, np.cross(two.angular_acceleration, u)
                        + np.cross(two.angular_velocity, rate)))
    columns = []
    for d, v, a in vectors:
        v_seen = v - np.cross(w, d)  # as frame 1 sees it
        a_seen = a - np.cross(e, d) - 2.0 * np.cross(w, v_seen) - np.cross(w, np.cross(w, d))
        local = [np.einsum("nij,ni->nj", one.rotation, x) for x in (d, v_seen, a_seen)]
        columns.append([Taylor.of([x[:, k] for x in local]) for k in range(3)])
    return columns[0], [list(row) for row in zip(*columns[1:], strict=True)]


def _combined(numbers: Array, series: Series) -> Taylor:
    """Return the sum of numbers (3,) times series."""
    x, y, z = (part * float(a) for a, part in zip(numbers, series, strict=True))
    return x + y + z


def _curve_length(
    closure: Closure, position: Series, rotation: list[Series], near: Array
) -> Taylor:
    """Return the length along a curve, or along a line, to the contact [m]."""
    curve: Any = closure.numbers["curve"]
    follower: Any = closure.numbers.get("follower")
    is_face = follower is not None and follower.flat is not None
    d = ([_combined(follower.side * follower.flat, row) for row in rotation] if is_face else
         [x - float(c) for x, c in zip(position, curve.centre, strict=True)])
    x, y, z = (_combined(u, d) for u in curve.axes.T)
    if curve.at is None and not curve.numbers:  # a line
        return z
    angle = argument(y, x, near[0])
    if curve.at is None:
        radius, lead = curve.numbers
        return angle * float(np.hypot(radius, lead / (2.0 * np.pi)))
    offset = follower.side * follower.radius if follower is not None else 0.0
    length: Taylor = curve.support()[1](angle) if is_face else curve.radial(offset)[1](angle)
    return length


def parameters_of(
    closure: Closure, position: Series, rotation: list[Series], near: Array
) -> Series:
    """Return the parameters of a closure's curves where they are touched.

    Position [m] and rotation, row by row, are series of frame 2 in frame 1. `near` (2, N) is what
    the parameters are nearest to; 0 for the best of all.
    """
    root = next(x.argument.of for _, factors in closure.rows[0].terms for x in factors
                if isinstance(x, FunctionOf) and isinstance(x.argument, Parameter))
    products, parameters = list[Taylor](), [
        Taylor([x, *[0.0 * x] * (len(position[0].values) - 1)]) for x in near[: len(root.spans)]]
    index_of: dict[int, int] = {}

    def index(x: Quantity) -> Indexed:
        if isinstance(x, FunctionOf):
            return *index(x.argument)[:2], x.function
        if isinstance(x, Parameter):
            return ANGLE, x.which, None
        assert isinstance(x, Displacement | Cosine)
        if id(x) not in index_of:
            index_of[id(x)] = len(index_of)
            products.append(
                _combined(x.u, position) - x.offset if isinstance(x, Displacement)
                else _combined(x.u, [_combined(x.w, row) for row in rotation]))
        return PRODUCT, index_of[id(x)], None

    sums = tuple(tuple((number, tuple(map(index, factors))) for number, factors in of.terms)
                 for of in root.definition)
    implicit_angles(ImplicitAngles(0, sums, root.spans, root.is_periodic),
                    (products, [], parameters))
    return parameters


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


def contact_shape(closure: Closure, seen: tuple[Array, Array], near: Array) -> ContactShape:
    """Return the curve at its contact, from its distance by direction, or its support function.

    `seen` are origins (N, 3) [m] and rotations (N, 3, 3) of frame 2 in frame 1; for `near` (k, N)
    see `angles_of`.
    """
    curve: Any = _curve(closure)
    follower: Any = closure.numbers.get("follower")
    position, rotation = seen
    if "curves" in closure.numbers or curve.path is not None:
        series = ([Taylor([x]) for x in position.T],
                  [[Taylor([x]) for x in row] for row in np.moveaxis(rotation, 0, -1)])
        u = parameters_of(closure, *series, near)[0].values[0]
        return _shape_at(curve, u)
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


def _shape_at(curve: CurveShape, u: Array) -> ContactShape:
    """Return a curve at parameters (N,)."""
    path = curve.by_parameter
    x = Taylor([u, np.ones_like(u), np.zeros_like(u)])
    point, rate, rise = (np.column_stack([f(x).derivative(k) for f in path.coordinates])
                         for k in range(3))
    size, across = np.linalg.norm(rate, axis=1), np.cross(rate, rise)
    is_profile = curve.is_closed and curve.is_plane
    bent = across[:, 2] if is_profile else np.linalg.norm(across, axis=1)
    normal = np.column_stack([rate[:, 1], -rate[:, 0], 0.0 * u]) / size[:, None]
    return ContactShape(normal @ curve.axes.T if is_profile else np.full_like(point, np.nan),
                        curve.centre + point @ curve.axes.T, bent / size**3)
