"""Convex solids of links: collision geometry, else visual geometry."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from spatial_pin.errors import warn
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


class ConvexSolid(NamedTuple):
    """A convex solid of a link."""

    link: str  # name of the link
    joint: int  # joint of its frame
    rotation: Array  # rotation, position: (3, 3), (3,) in that frame
    position: Array
    shape: coal.ShapeBase  # for coal
    centre: Array  # centre, radius: (3,) in that frame, of a sphere around it [m]
    radius: float
    # half, thickness: (3,) in that frame, from the centre to an end of a segment, and the radius
    # about it that contains the solid [m]
    half: Array
    thickness: float


def solids_of(mechanism: Mechanism) -> list[ConvexSolid]:
    """Return the convex solids of all links.

    A link's solids are its collision geometry, else its visual geometry. A mesh counts as the
    convex hulls of its connected parts: these contain the mesh, so that no distance is too large.
    """
    collide = list(mechanism.collision_model.geometryObjects)
    links = {int(g.parentFrame) for g in collide}
    drawn = [g for g in mechanism.visual_model.geometryObjects if int(g.parentFrame) not in links]
    solids = []
    for geometry in (*collide, *drawn):
        shape = geometry.geometry
        if isinstance(shape, coal.BVHModelBase):
            corners = [(t[0], t[1], t[2]) for t in map(shape.tri_indices, range(shape.num_tris))]
            solids += [_solid(mechanism, geometry, hull) for hull in hulls(
                np.array(shape.vertices()), np.array(corners).reshape(-1, 3))]
        elif type(shape) in SUPPORTS:
            solids.append(_solid(mechanism, geometry, shape))
        else:
            warn(f"{geometry.name!r} has no clearance: a {type(shape).__name__} is no convex solid")
    return solids


def _solid(
    mechanism: Mechanism, geometry: pin.GeometryObject, shape: coal.ShapeBase
) -> ConvexSolid:
    placement = geometry.placement
    shape.computeLocalAABB()
    # half a segment through the middle, and how far the solid reaches from that: rods lie along
    # their axes, other solids along the longest edge of the box about them
    if isinstance(shape, coal.Cylinder | coal.Capsule | coal.Cone):
        half, thickness = np.array([0.0, 0.0, shape.halfLength]), float(shape.radius)
    elif isinstance(shape, coal.Sphere):
        half, thickness = np.zeros(3), float(shape.radius)
    else:
        box = 0.5 * (shape.aabb_local.max_ - shape.aabb_local.min_)
        half = np.where(np.arange(3) == np.argmax(box), box, 0.0)
        thickness = float(np.linalg.norm(box - half))
    return ConvexSolid(mechanism.model.frames[geometry.parentFrame].name, int(geometry.parentJoint),
                 placement.rotation, placement.translation, shape,
                 placement.act(np.array(shape.aabb_center)), float(shape.aabb_radius),
                 placement.rotation @ half, thickness)


def hulls(points: Array, corners: Array) -> Iterator[coal.ShapeBase]:
    """Yield the convex hull of each connected part of a mesh of triangles (m, 3)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import ConvexHull, QhullError

    distinct, own = np.unique(points, axis=0, return_inverse=True)
    corners = own.reshape(-1)[corners]
    edges = np.concatenate([corners[:, :2], corners[:, 1:]]).T
    graph = coo_array((np.ones(edges.shape[1]), edges), shape=(len(distinct), len(distinct)))
    parts = connected_components(graph, directed=False)[1]
    for part in np.unique(parts[corners]):
        own = distinct[parts == part]
        try:
            hull = ConvexHull(own)
        except QhullError:  # a flat part: its points are moved by round-off
            hull = ConvexHull(own, qhull_options="QJ Pp")
        numbers = np.full(len(own), -1)
        numbers[hull.vertices] = np.arange(len(hull.vertices))
        vertices, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        for point in hull.points[hull.vertices]:
            vertices.append(point)
        for face in hull.simplices:
            faces.append(coal.Triangle(*(int(i) for i in numbers[face])))
        yield coal.Convex(vertices, faces)


def _round(radius: float, n: Array, height: Array | float) -> Array:
    """Return the farthest points (k, 3) of circles about z along n (k, 3), at a height."""
    across = np.hypot(n[:, 0], n[:, 1])
    across[across == 0.0] = 1.0
    points = np.empty(n.shape)
    np.multiply((radius / across)[:, None], n[:, :2], out=points[:, :2])
    points[:, 2] = height
    return points


def _ends(s: Any, n: Array) -> Array:
    return np.copysign(s.halfLength, n[:, 2])


def _cone(s: Any, n: Array) -> Array:
    base, tip = _round(s.radius, n, -s.halfLength), np.array([0.0, 0.0, s.halfLength])
    return np.where((np.sum(n * base, axis=1) > n @ tip)[:, None], base, tip)


# The points (k, 3) of a solid that lie farthest along directions n (k, 3) of length one, in its own
# frame: its support mapping. To add a kind of solid, add its line.
SUPPORTS: dict[type, Callable[[Any, Array], Array]] = {
    coal.Box: lambda s, n: np.copysign(s.halfSide, n),
    coal.Sphere: lambda s, n: s.radius * n,
    coal.Ellipsoid: lambda s, n: s.radii**2 * n / np.linalg.norm(s.radii * n, axis=1)[:, None],
    coal.Cylinder: lambda s, n: _round(s.radius, n, _ends(s, n)),
    coal.Capsule: lambda s, n: s.radius * n + np.outer(_ends(s, n), [0.0, 0.0, 1.0]),
    coal.Cone: _cone,
    coal.Convex: lambda s, n: s.points()[(n @ s.points().T).argmax(axis=1)],
}
