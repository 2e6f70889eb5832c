"""Shape of cams at their contact: pressure angle, curvature, undercut."""

from __future__ import annotations

import math

import numpy as np

from spatial_pin.assembly.curve_contacts import angles_of, contact_shape
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.curves import curves_in
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array, null_space, row_space
from spatial_pin.numerics.tolerances import TOLERANCES

UNITS = {"pressure_angle": "rad", "curvature": "1/m", "undercut": "1"}


def contact_quantity(
    mechanism: Mechanism, closure: Closure, kind: str, q: Array, angles: Array
) -> Array:
    """Return a quantity (N,) of a contact of a curve.

    "curvature" is that of the curve, of two the first, positive where a closed one is convex [1/m];
    "undercut" the radius of a roller over that of the hollow that it is in, 0 where there is none:
    it is undercut from 1 on; "pressure_angle" the angle between the normal and the direction in
    which the follower can move while the cam stands still [rad] [Norton2009, ch. 7]. `angles` (N,
    n_angles) count turns [rad]; `kind` is one of `UNITS`.

    Raises:
        SpatialPinError: the curve is not a closed one, and has no single normal.
    """
    curve = curves_in(closure.numbers)[0]
    if kind == "pressure_angle" and not (curve.is_closed and curve.is_plane):
        raise SpatialPinError(f"{closure.name}.pressure_angle: a pressure angle is that of a "
                              "closed curve in a plane, and this curve is none")
    values = []
    for row, turned in zip(q, angles, strict=True):
        with loops_of(mechanism, turned) as loops:
            loops.update(row)
            one, two = (loops.frame(mechanism.frame_id(name)) for name in closure.frames)
            seen = one.actInv(two)
            shape = contact_shape(closure, (seen.translation[None], seen.rotation[None]),
                                  angles_of(mechanism, closure, turned[None], 1))
            curvature = float(shape.curvature[0])
            if kind == "pressure_angle":
                values.append(_pressure_angle(loops, closure, one.rotation @ shape.normal[0],
                                              one.act(shape.point[0])))
                continue
        follower = closure.numbers.get("follower")
        hollow = -curvature * (follower.side * follower.radius if follower else 0.0)
        values.append(max(0.0, hollow) if kind == "undercut" else curvature)
    return np.array(values)


def _pressure_angle(loops: LoopEquations, closure: Closure, normal: Array, point: Array) -> float:
    """Return the angle between a normal (3,) and the path of the follower [rad].

    That of a face or a curve is the path of its point of contact, of others that of the origin of
    frame 2.
    The cam stands still, and so do drivers; where nothing moves then, a driver may, and where still
    nothing moves, as where the cam goes around its follower, the follower stands still instead.
    """
    mechanism = loops.mechanism
    scale, size = mechanism.velocity_scale, mechanism.characteristic_length
    follower, closure_of = closure.numbers.get("follower"), loops.constraints.closure_of
    other = np.array([name != closure.name for name in closure_of], dtype=bool)
    others = loops.jacobian[: len(other)][other]
    driven = [mechanism.coordinate(d.joint).v for d in mechanism.drivers.values()]
    ids = [mechanism.frame_id(name) for name in closure.frames]
    twists = [loops.frame_jacobian(k) * scale / np.array([[size]] * 3 + [[1.0]] * 3) for k in ids]
    is_point = follower is None or follower.flat is None
    at = point if not is_point or "curves" in closure.numbers else loops.frame(ids[1]).translation
    paths = [twist[:3] + np.cross(twist[3:].T, (at - loops.frame(k).translation) / size).T
             for k, twist in zip(ids, twists, strict=True)]
    for still in twists:
        for held in (driven, []):
            free = null_space(np.vstack([others, still, np.eye(len(scale))[held]]))
            moved = free @ (paths[1] - paths[0]).T  # (k, 3)
            if np.linalg.norm(moved) > TOLERANCES.rank:
                basis = row_space(moved)
                along = basis.T @ (basis @ normal)
                return math.atan2(float(np.linalg.norm(normal - along)),
                                  float(np.linalg.norm(along)))
    return math.nan
