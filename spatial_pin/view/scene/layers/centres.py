"""Centres of mass of the links, as quartered balls."""

from __future__ import annotations

import numpy as np

from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.quiet_meshcat import mg
from spatial_pin.view.scene.shapes import Solid
from spatial_pin.view.scene.stage import Entry, Item, Layer, Stage

MARK = 0.026  # radius of a mark relative to the size of the scene
DARK, LIGHT = (0.08, 0.09, 0.11, 1.0), (0.97, 0.97, 0.97, 1.0)
FACETS = 6  # along the edge of an octant: round to the eye at that size


def _octant(signs: tuple[int, int, int]) -> tuple[Array, Array]:
    """Return points (K, 3) and triangles (M, 3) of an eighth of the unit sphere."""
    i, j = np.meshgrid(np.arange(FACETS + 1), np.arange(FACETS + 1), indexing="ij")
    polar, turn = (np.pi / 2 / FACETS * x.ravel() for x in (i, j))
    points = np.stack(
        [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=1
    )
    a = (np.arange(FACETS)[:, None] * (FACETS + 1) + np.arange(FACETS)).ravel()
    b, c, d = a + 1, a + FACETS + 1, a + FACETS + 2
    faces = np.concatenate([np.stack([a, c, d], axis=1), np.stack([a, d, b], axis=1)])
    return points * signs, faces if np.prod(signs) > 0 else faces[:, ::-1]


def _quarters(parity: int, radius: float) -> Solid:
    """Return every other eighth of a ball."""
    signs = [(x, y, z) for x in (1, -1) for y in (1, -1) for z in (1, -1) if x * y * z == parity]
    points, faces = zip(*map(_octant, signs), strict=True)
    shifted = [face + k * len(points[0]) for k, face in enumerate(faces)]
    return Solid(
        mg.TriangularMeshGeometry(radius * np.concatenate(points), np.concatenate(shifted))
    )


def centres(stage: Stage) -> Layer:
    """Return a mark at the centre of mass of every link that has one."""
    mechanism = stage.film.mechanism
    dark, light = (_quarters(parity, MARK * stage.size) for parity in (1, -1))
    items: list[Item] = []
    points: list[Array] = [np.zeros((0, 3))]
    for link, inertia in mechanism.inertias.items():
        if inertia.mass <= 0.0:
            continue
        joint, placement = mechanism.frame_on_joint(link)
        place = placement.homogeneous.copy()
        place[:3, 3] = placement.act(inertia.lever)
        points.append(stage.points(joint, place[:3, 3]))
        name = f"centre of mass, {link}"
        items.append(Item(name, dark, DARK, joint, place, through=True))
        items.append(Item(f"{name}, light", light, LIGHT, joint, place, through=True))
    legend = (Entry(DARK, "centres of mass"),) if items else ()
    return Layer(tuple(items), np.concatenate(points), legend)
