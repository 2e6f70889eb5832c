"""Collision-library shapes as three.js objects.

To add a shape: a function from the coal shape, and the size [m] of its scene, to a
`Solid`, and its line in SOLIDS. Meshcat turns shapes of revolution about y, coal about z.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from spatial_pin.formats.mesh_files import mesh_colours
from spatial_pin.numerics.linalg import Array

with warnings.catch_warnings():  # of a deprecated part of zmq
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat
    import meshcat.geometry as mg

__all__ = ["Solid", "ball", "bar", "coloured", "meshcat", "mg", "moved", "rod", "solid", "tube",
           "turned"]

Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


class Solid(NamedTuple):
    """A three.js geometry and its placement."""

    geometry: Any  # a meshcat geometry
    placement: Array = np.eye(4)  # of the geometry in the shape's frame, shape (4, 4), may scale
    faceted: bool = False  # whether its faces are to be shaded flat


class Lathe(mg.Geometry):
    """The surface that a profile sweeps about y; three.js makes it, so that it takes no room.

    Attributes:
        profile: (radius, y) of its points, from the lowest to the highest, shape (K, 2) [m].
        segments: number of facets round the axis.
    """

    def __init__(self, profile: Array, segments: int = 48) -> None:
        super().__init__()
        self.profile, self.segments = profile, segments

    def lower(self, object_data: Any) -> dict[str, Any]:
        """Return it as three.js reads it."""
        points = [{"x": float(r), "y": float(y)} for r, y in self.profile]
        return {"uuid": self.uuid, "type": "LatheGeometry", "points": points,
                "segments": self.segments}


def _capsule(shape: Any, size: float) -> Solid:
    angle = np.linspace(0.0, np.pi / 2, 9)
    half = np.stack([shape.radius * np.cos(angle), shape.halfLength + shape.radius * np.sin(angle)])
    profile = np.concatenate([(half * [[1], [-1]])[:, ::-1], half], axis=1).T
    return Solid(Lathe(profile), Y_TO_Z)


def _plane(shape: Any, size: float) -> Solid:
    pose = pin.SE3(pin.Quaternion.FromTwoVectors(pin.ZAxis, shape.n).matrix(), shape.d * shape.n)
    return Solid(mg.Box([4 * size, 4 * size, 1e-3 * size]), pose.homogeneous)


def _triangles(points: Array, corners: Callable[[int], Any], n: int) -> Solid | None:
    faces = [[t[0], t[1], t[2]] for t in map(corners, range(n))]
    return Solid(mg.TriangularMeshGeometry(points, faces), faceted=True) if faces else None


def _by_pinocchio(shape: Any, size: float) -> Solid:
    from pinocchio.visualize.meshcat_visualizer import loadMesh, loadOctree

    load = loadOctree if isinstance(shape, coal.OcTree) else loadMesh
    return Solid(load(shape), faceted=True)


SOLIDS: dict[type, Callable[[Any, float], Solid | None]] = {
    coal.Box: lambda shape, size: Solid(mg.Box([float(x) for x in 2 * shape.halfSide])),
    coal.Sphere: lambda shape, size: Solid(mg.Sphere(shape.radius)),
    coal.Ellipsoid: lambda shape, size: Solid(mg.Sphere(1.0), np.diag([*shape.radii, 1.0])),
    coal.Cylinder: lambda shape, size: Solid(
        mg.Cylinder(2 * shape.halfLength, shape.radius), Y_TO_Z),
    coal.Cone: lambda shape, size: Solid(mg.Cylinder(
        2 * shape.halfLength, radiusTop=0.0, radiusBottom=shape.radius), Y_TO_Z),
    coal.Capsule: _capsule,
    coal.Plane: _plane,
    coal.Halfspace: _plane,
    coal.TriangleP: lambda shape, size: Solid(mg.TriangularMeshGeometry(
        np.array([shape.a, shape.b, shape.c]), [[0, 1, 2]]), faceted=True),
    coal.Convex: lambda shape, size: _triangles(
        shape.points(), shape.polygons, shape.num_polygons),
    coal.BVHModelBase: lambda shape, size: _triangles(
        shape.vertices(), shape.tri_indices, shape.num_tris),
    coal.HeightFieldAABB: _by_pinocchio,
    coal.HeightFieldOBBRSS: _by_pinocchio,
    coal.OcTree: _by_pinocchio,
}


def moved(p: Array) -> Array:
    """Return the placement (4, 4) of a translation p (3,) [m]."""
    M = np.eye(4)
    M[:3, 3] = p
    return M


def rod(radius: float, start: float = 0.0, end: float = 1.0) -> Solid:
    """Return a round rod along z from `start` to `end` [m]."""
    lift = Y_TO_Z.copy()
    lift[2, 3] = (start + end) / 2
    return Solid(mg.Cylinder(end - start, radius), lift)


def bar(half_width: float, start: float, end: float) -> Solid:
    """Return a square bar along z from `start` to `end` [m]."""
    lift = moved(np.array([0.0, 0.0, (start + end) / 2]))
    return Solid(mg.Box([2 * half_width, 2 * half_width, end - start]), lift)


def ball(radius: float) -> Solid:
    """Return a ball about the origin."""
    return Solid(mg.Sphere(radius))


def turned(*corners: tuple[float, float], segments: int = 48) -> Solid:
    """Return the solid that a polygon of (radius, z) [m] sweeps about z, with sharp edges.

    Outside is to the right along the corners; few segments make a prism.
    """
    sides = [corner for k in range(len(corners) - 1) for corner in corners[k : k + 2]]
    return Solid(Lathe(np.array(sides), segments), Y_TO_Z, faceted=segments < 12)


def tube(path: Array, radius: float, segments: int = 8) -> Any:
    """Return a tube of a radius [m] round the points of a path (K, 3) [m], which need not differ.

    Vertex k * segments + i is point i of the ring about point k of those that differ.
    """
    path = path[np.r_[True, np.any(np.diff(path, axis=0) != 0, axis=1)]]
    tangent = np.gradient(path, axis=0) if len(path) > 1 else np.array([[0.0, 0.0, 1.0]])
    u, v = _frames_along(tangent)
    angle = np.arange(segments) * 2 * np.pi / segments
    ring = np.cos(angle)[:, None] * u[:, None] + np.sin(angle)[:, None] * v[:, None]
    points = path[:, None] + radius * ring
    k, s = np.divmod(np.arange((len(path) - 1) * segments), segments)
    a, b = k * segments + s, k * segments + (s + 1) % segments
    quads = np.stack([a, b, b + segments, a, b + segments, a + segments], axis=1)
    return mg.TriangularMeshGeometry(points.reshape(-1, 3), quads.reshape(-1, 3))


def _frames_along(tangent: Array) -> tuple[Array, Array]:
    """Return unit vectors u, v (K, 3) normal to tangents (K, 3), turned as little as can be."""
    u, v = np.empty_like(tangent), np.empty_like(tangent)
    last = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    t = np.array([0.0, 0.0, 1.0])
    for k, along in enumerate(tangent):
        length = np.linalg.norm(along)
        t = along / length if length > 0 else t
        across = last - (last @ t) * t
        if np.linalg.norm(across) < 1e-6:
            across = np.cross(t, np.eye(3)[np.argmin(np.abs(t))])
        last = u[k] = across / np.linalg.norm(across)
        v[k] = np.cross(t, u[k])
    return u, v


def coloured(visual: pin.GeometryObject) -> list[tuple[Solid, tuple[float, ...] | None]]:
    """Return the parts of a mesh with the colours of its file; none where one colour is for all."""
    shape = visual.geometry
    if visual.overrideMaterial or not isinstance(shape, coal.BVHModelBase):
        return []
    runs = mesh_colours(visual.meshPath)
    if all(colour is None for _, colour in runs) or sum(n for n, _ in runs) != shape.num_tris:
        return []
    faces = np.array([[t[0], t[1], t[2]] for t in map(shape.tri_indices, range(shape.num_tris))])
    ends = np.cumsum([n for n, _ in runs])[:-1]
    pieces: dict[tuple[float, ...] | None, list[Array]] = {}
    for (_, colour), piece in zip(runs, np.split(faces, ends), strict=True):
        pieces.setdefault(colour, []).append(piece)
    parts = []
    for colour, own in pieces.items():
        used, corners = np.unique(np.concatenate(own), return_inverse=True)
        mesh = mg.TriangularMeshGeometry(shape.vertices()[used], corners.reshape(-1, 3))
        parts.append((Solid(mesh, faceted=True), colour))
    return parts


def solid(visual: pin.GeometryObject, size: float) -> Solid | None:
    """Return what to draw in a scene of a size [m] for a geometry object, or None."""
    for kind, make in SOLIDS.items():
        if isinstance(visual.geometry, kind):
            return make(visual.geometry, size)
    return None
