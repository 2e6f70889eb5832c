"""Wavefront (.obj): triangles with the colours of the materials in the .mtl files it names.

Runs in the process that reads meshes (`mesh_reader`): it uses nothing but NumPy and the standard
library. What it does not know it refuses; then the mesh is read without colours.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np

LARGEST_MATERIALS = 10_000_000  # bytes of a file of materials


def read(file: str) -> tuple[Any, Any, Any]:
    """Return points (N, 3), triangles (M, 3) and their colours (M, 4), NaN for those without.

    Raises:
        ValueError: a line is not understood, or a face has points that are not there.
    """
    points, corners, colours = [], [], []
    known: dict[str, list[float]] = {}
    none = [np.nan] * 4
    colour = none
    for key, words in _lines(file):
        if key == "v":
            points.append([float(x) for x in words[:3]])
        elif key == "f":
            face = [_place(word, len(points)) for word in words]
            corners += [(face[0], *face[k:k + 2]) for k in range(1, len(face) - 1)]
            colours += [colour] * (len(face) - 2)
        elif key == "usemtl":
            colour = known.get(" ".join(words), none)
        elif key == "mtllib":
            known.update(_materials(" ".join(words), os.path.dirname(os.path.realpath(file))))
    if not corners:
        raise ValueError("it has no triangles")
    used, places = np.unique(np.array(corners, dtype=np.int64), return_inverse=True)
    return np.array(points)[used], places.reshape(-1, 3), np.array(colours)


def _place(word: str, count: int) -> int:
    """Return the number, from 0, of a point of a face; negative ones count from the last."""
    number = int(word.partition("/")[0])
    place = number - 1 if number > 0 else count + number
    if not 0 <= place < count or not number:
        raise ValueError("it has triangles of points that it does not have")
    return place


def _lines(file: str) -> Iterator[tuple[str, list[str]]]:
    with open(file, encoding="utf-8", errors="replace") as stream:
        for line in stream:
            words = line.partition("#")[0].split()
            if words:
                if words[-1] == "\\":
                    raise ValueError("a line goes on in the next one")
                yield words[0], words[1:]


def _materials(name: str, folder: str) -> dict[str, list[float]]:
    """Return colours by the names of materials; none where no file of the folder has them."""
    file = os.path.realpath(os.path.join(folder, name))
    if not (file.startswith(os.path.join(folder, "")) and os.path.isfile(file)
            and os.path.getsize(file) <= LARGEST_MATERIALS):
        return {}
    found: dict[str, list[float]] = {}
    colour: list[float] = []
    for key, words in _lines(file):
        if key == "newmtl":
            colour = found.setdefault(" ".join(words), [np.nan] * 4)
        elif key == "Kd" and len(words) == 3 and colour:
            colour[:] = [*map(float, words), 1.0 if np.isnan(colour[3]) else colour[3]]
        elif key == "d" and colour and float(words[-1]) > 0.0:
            colour[3] = float(words[-1])
    return found
