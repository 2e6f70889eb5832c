"""Collision-library shapes as three.js objects.

To add a shape: a function from the coal shape, and the size [m] of the scene it stands in, to a
`Solid`, and its line in SOLIDS. Meshcat turns shapes of revolution about y, coal about z.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.view.quiet_meshcat import mg

Array = NDArray[np.float64]

Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


class Solid(NamedTuple):
    """A three.js geometry and where it stands.

    Attributes:
        geometry: a meshcat geometry.
        placement: of the geometry in the shape's frame, shape (4, 4), may scale.
        faceted: whether its faces are to be shaded flat.
    """

    geometry: Any
    placement: Array = np.eye(4)
    faceted: bool = False


def _box(shape: Any, size: float) -> Solid:
    return Solid(mg.Box([float(x) for x in 2 * shape.halfSide]))


def _sphere(shape: Any, size: float) -> Solid:
    return Solid(mg.Sphere(shape.radius))


def _ellipsoid(shape: Any, size: float) -> Solid:
    return Solid(mg.Sphere(1.0), np.diag([*shape.radii, 1.0]))


def _cylinder(shape: Any, size: float) -> Solid:
    return Solid(mg.Cylinder(2 * shape.halfLength, shape.radius), Y_TO_Z)


def _cone(shape: Any, size: float) -> Solid:
    geometry = mg.Cylinder(2 * shape.halfLength, radiusTop=0.0, radiusBottom=shape.radius)
    return Solid(geometry, Y_TO_Z)


def _capsule(shape: Any, size: float) -> Solid:
    angle = np.linspace(0.0, np.pi / 2, 9)
    half = np.stack([shape.radius * np.cos(angle), shape.halfLength + shape.radius * np.sin(angle)])
    profile = np.concatenate([(half * [[1], [-1]])[:, ::-1], half], axis=1).T
    return Solid(revolve(profile))


def _plane(shape: Any, size: float) -> Solid:
    pose = pin.SE3(pin.Quaternion.FromTwoVectors(pin.ZAxis, shape.n).matrix(), shape.d * shape.n)
    return Solid(mg.Box([4 * size, 4 * size, 1e-3 * size]), pose.homogeneous)


def _triangle(shape: Any, size: float) -> Solid:
    corners = np.array([shape.a, shape.b, shape.c])
    return Solid(mg.TriangularMeshGeometry(corners, [[0, 1, 2]]), faceted=True)


def _convex(shape: Any, size: float) -> Solid | None:
    return _triangles(shape.points(), shape.polygons, shape.num_polygons)


def _mesh(shape: Any, size: float) -> Solid | None:
    return _triangles(shape.vertices(), shape.tri_indices, shape.num_tris)


def _triangles(points: Array, corners: Callable[[int], Any], n: int) -> Solid | None:
    faces = [[t[0], t[1], t[2]] for t in map(corners, range(n))]
    return Solid(mg.TriangularMeshGeometry(points, faces), faceted=True) if faces else None


def _height_field(shape: Any, size: float) -> Solid:
    from pinocchio.visualize.meshcat_visualizer import loadMesh

    return Solid(loadMesh(shape), faceted=True)


def _octree(shape: Any, size: float) -> Solid:
    from pinocchio.visualize.meshcat_visualizer import loadOctree

    return Solid(loadOctree(shape), faceted=True)


SOLIDS: dict[type, Callable[[Any, float], Solid | None]] = {
    coal.Box: _box,
    coal.Sphere: _sphere,
    coal.Ellipsoid: _ellipsoid,
    coal.Cylinder: _cylinder,
    coal.Cone: _cone,
    coal.Capsule: _capsule,
    coal.Plane: _plane,
    coal.Halfspace: _plane,
    coal.TriangleP: _triangle,
    coal.Convex: _convex,
    coal.BVHModelBase: _mesh,
    coal.HeightFieldAABB: _height_field,
    coal.HeightFieldOBBRSS: _height_field,
    coal.OcTree: _octree,
}


def revolve(profile: Array, segments: int = 48) -> Any:
    """Return the surface that a profile sweeps about z.

    Args:
        profile: (radius, z) of its points, from the lowest to the highest, shape (K, 2) [m].
        segments: number of facets round the axis.
    """
    angle = np.arange(segments) * 2 * np.pi / segments
    r, z = profile.T
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    xy = r[:, None, None] * ring
    points = np.concatenate([xy, np.broadcast_to(z[:, None, None], (*xy.shape[:2], 1))], axis=2)
    k, s = np.divmod(np.arange((len(profile) - 1) * segments), segments)
    a, b = k * segments + s, k * segments + (s + 1) % segments
    quads = np.stack([a, b, b + segments, a, b + segments, a + segments], axis=1)
    return mg.TriangularMeshGeometry(points.reshape(-1, 3), quads.reshape(-1, 3))


def solid(visual: pin.GeometryObject, size: float) -> Solid | None:
    """Return what to draw for a geometry object, or None when nothing can be.

    Args:
        visual: the geometry object.
        size: of the scene [m]; unbounded planes are drawn as large as that.
    """
    for kind, make in SOLIDS.items():
        if isinstance(visual.geometry, kind):
            return make(visual.geometry, size)
    return None
