"""Equations of points, frames, followers and other curves on curves.

Let d be the vector from a curve c(u) to a point, e the last axis of the curve, c' its derivative.
The nearest point of the curve has d . c' = 0, which defines u. The point is on the curve where
(e x c') . d = e . d = 0. Two profiles touch where their tangents are opposite and the vector d
between them has no component along the normal [Litvin, Gear Geometry, ch. 6].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from spatial_pin.mechanism.curves import CurveShape, Follower, TouchingCurves, circle
from spatial_pin.mechanism.equations import (
    Angle,
    Bearing,
    ConstraintEquation,
    Cosine,
    Displacement,
    FunctionOf,
    ImplicitParameters,
    Parameter,
    Quantity,
    Term,
)
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import Piecewise

Rows = tuple[ConstraintEquation, ...]
TURN = 2.0 * np.pi


def _length(*terms: Term) -> ConstraintEquation:
    return ConstraintEquation(terms, is_length=True)


def _from(curve: CurveShape) -> list[Displacement]:
    """Return the components of frame 2's origin from a curve's centre, along its axes."""
    return [Displacement(u, offset=float(u @ curve.centre)) for u in curve.axes.T]


def _of(functions: Sequence[Piecewise], u: Parameter) -> list[FunctionOf]:
    return [FunctionOf(f, u) for f in functions]


def nearest(curve: CurveShape, d: Sequence[Quantity]) -> Parameter:
    """Return the parameter of the point of a curve nearest to another one, see `_from`."""
    path = curve.by_parameter

    def sums(u: Parameter) -> tuple[ConstraintEquation, ...]:
        c, t = _of(path.coordinates, u), _of(path.slopes, u)
        towards: list[Term] = []
        square: list[Term] = []
        for x, at, slope in zip(d, c, t, strict=True):
            towards += [(-1.0, (x, slope)), (1.0, (at, slope))]
            square += [(1.0, (x, x)), (-2.0, (x, at)), (1.0, (at, at))]
        return _length(*towards), ConstraintEquation(((1.0, ()),)), _length(*square)

    return ImplicitParameters(sums, (path.reach,), (curve.is_closed,)).parameters[0]


def around(curve: CurveShape, offset: float = 0.0) -> ConstraintEquation:
    """Return origin 2 on a closed curve in a plane, or outside of it: squares by its radius [m]."""
    square, _ = curve.radial(offset)
    x, y, _ = _from(curve)
    number = 0.5 / math.sqrt(float(square.coefficients[:, 0].mean()))
    return _length((number, (x, x)), (number, (y, y)), (-number, (
        FunctionOf(square, Bearing(curve.axes, curve.centre)),)))


def offset_point(curve: CurveShape, offset: float) -> ConstraintEquation:
    """Return origin 2 at a distance from a curve in a plane [m], positive outside, to its right."""
    x, y, _ = d = _from(curve)
    u, path = nearest(curve, d), curve.by_parameter
    (cx, cy, _), (tx, ty, _) = _of(path.coordinates, u), _of(path.slopes, u)
    return _length((1.0, (x, ty)), (-1.0, (y, tx)), (-1.0, (cx, ty)), (1.0, (cy, tx)), *(
        [(-offset, (FunctionOf(path.arc.derivative(), u),))] if offset else []))


def on_curve(curve: CurveShape) -> Rows:
    """Return origin 2 on a curve."""
    x, y, z = d = _from(curve)
    if curve.at is not None:
        return around(curve), _length((1.0, (z,)))
    if curve.path is not None:
        u = nearest(curve, d)
        (cx, cy, cz), (tx, ty, _) = (_of(f, u) for f in (curve.path.coordinates,
                                                         curve.path.slopes))
        level: list[Term] = [] if curve.path.is_level else [(-1.0, (cz,))]
        return (_length((1.0, (x, ty)), (-1.0, (y, tx)), (-1.0, (cx, ty)), (1.0, (cy, tx))),
                _length((1.0, (z,)), *level))
    if not curve.numbers:  # a line
        return _length((1.0, (x,))), _length((1.0, (y,)))
    radius, lead = curve.numbers
    turn = Bearing(curve.axes, curve.centre)
    return (_length((0.5 / radius, (x, x)), (0.5 / radius, (y, y)), (-0.5 * radius, ())),
            _length((1.0, (z,)), (-lead / TURN, (turn,))))


def along_curve(curve: CurveShape, z: Array) -> Rows:
    """Return equations for direction z (3,) of frame 2 along the tangent of a curve at origin 2."""
    zx, zy, zz = (Cosine(u, z) for u in curve.axes.T)
    if curve.numbers:
        radius, lead = curve.numbers
        turn = Bearing(curve.axes, curve.centre)
        c, s = (FunctionOf(f, turn) for f in circle(1.0).normals)
        rise = lead / TURN
        return (ConstraintEquation(((1.0, (zx, c)), (1.0, (zy, s)))),
                ConstraintEquation(((rise, (zx, s)), (-rise, (zy, c)), (radius, (zz,)))))
    if curve.at is None and curve.path is None:  # a line
        return tuple(ConstraintEquation(((1.0, (x,)),)) for x in (zx, zy))
    if curve.at is not None:
        turn = Bearing(curve.axes, curve.centre)
        nx, ny = (FunctionOf(f, turn) for f in curve.normals)
        return (ConstraintEquation(((1.0, (zx, nx)), (1.0, (zy, ny)))),
                ConstraintEquation(((1.0, (zz,)),)))
    u = nearest(curve, _from(curve))
    tx, ty, tz = _of(curve.by_parameter.slopes, u)
    second: tuple[Term, ...] = ((1.0, (zz,)),)
    if not curve.is_plane:
        second = ((1.0, (zz, tx, tx)), (1.0, (zz, ty, ty)), (-1.0, (zx, tx, tz)),
                  (-1.0, (zy, ty, tz)))
    return (ConstraintEquation(((1.0, (zx, ty)), (-1.0, (zy, tx)))), ConstraintEquation(second))


def follows(curve: CurveShape, follower: Follower, z: Array) -> Rows:
    """Return a follower that touches a cam; z (3,) is a direction across a face's normal."""
    if follower.flat is None:
        offset = follower.side * follower.radius
        return (around(curve, offset) if curve.at is not None else offset_point(curve, offset),)
    n = follower.side * follower.flat  # away from the cam
    distance, _ = curve.support()
    # from origin 1 to the face, by its normal, less what the cam reaches towards it
    facing = Angle(curve.axes, np.column_stack([n, z, curve.axes[:, 2]]))
    terms: list[Any] = [(1.0, (Displacement(n, of_second=True),)),
                        (-1.0, (FunctionOf(distance, facing),))]
    if np.any(curve.centre):
        size = float(np.linalg.norm(curve.centre))
        terms.append((-size, (Cosine(curve.centre / size, n),)))
    return (_length(*terms),)


def touching(curves: TouchingCurves) -> Rows:
    """Return equations for two closed profiles that touch."""
    one, two, side = curves.one, curves.two, curves.side
    paths = one.by_parameter, two.by_parameter
    x, y = (Displacement(u) for u in one.axes.T[:2])
    turned = [[Cosine(u, w) for w in two.axes.T[:2]] for u in one.axes.T[:2]]
    centres = [float(u @ one.centre) for u in one.axes.T[:2]]
    own = two.centre @ two.axes[:, :2]

    def between(u: Parameter, w: Parameter, k: int, by: FunctionOf, sign: float) -> list[Term]:
        """A component of the vector from point to point, times a function."""
        moved = _of(paths[1].coordinates[:2], w)
        terms: list[Term] = [(sign, ((x, y)[k], by)), (-sign * centres[k], (by,)),
                             (-sign, (FunctionOf(paths[0].coordinates[k], u), by))]
        for c, at, offset in zip(turned[k], moved, own, strict=True):
            terms += [(sign, (c, at, by)), (sign * float(offset), (c, by))]
        return terms

    def sums(u: Parameter, w: Parameter) -> tuple[ConstraintEquation, ...]:
        t1, t2 = _of(paths[0].slopes[:2], u), _of(paths[1].slopes[:2], w)
        across: list[Term] = []
        opposite: list[Term] = []
        for k, other in enumerate(t2):
            across += [(1.0, (turned[1][k], t1[0], other)), (-1.0, (turned[0][k], t1[1], other))]
            opposite += [(-float(side), (turned[i][k], t1[i], other)) for i in range(2)]
        return (_length(*between(u, w, 0, t1[0], 1.0), *between(u, w, 1, t1[1], 1.0)),
                ConstraintEquation(tuple(across)), ConstraintEquation(tuple(opposite)),
                gap(u, w))

    def gap(u: Parameter, w: Parameter) -> ConstraintEquation:
        tx, ty = _of(paths[0].slopes[:2], u)
        return _length(*between(u, w, 0, ty, 1.0), *between(u, w, 1, tx, -1.0))

    parameters = ImplicitParameters(sums, tuple(p.span for p in paths), (True, True)).parameters
    return (gap(*parameters),)
