"""Meshes: their files, and their reading in a process of its own, at the first use of shapes.

Loading a mechanism only looks whether a mesh is there.
"""

from __future__ import annotations

import json
import os
import re
import struct
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats import mesh_reader
from spatial_pin.formats.file_access import (
    REMEDY,
    Trust,
    check_file,
    is_file,
    package_folders,
    shown,
)
from spatial_pin.numerics.linalg import Array

Colours = tuple[tuple[int, tuple[float, ...] | None], ...]  # of triangles that follow each other
Seen = tuple[str, int, int]  # a file as it was read: path, size, time of its last change

_COLOURS: dict[Seen, Colours] = {}
LEAST_TIME = 20.0  # s for meshes to be read, the start of the process with it
OUTSIDE = f"neither below the folder of the file nor in an installed package; {REMEDY}"
TIME_OF_A_BYTE = 2e-6  # s, ten times the largest measured
ALONE = (".stl", ".ply", ".off", ".obj", ".dae", ".3ds")  # formats in one file
OF_PARTS = (".gltf", ".glb")  # which name other files


def mesh_colours(file: str) -> Colours:
    """Return numbers of triangles of one colour, in order, with red, green, blue, opacity."""
    try:
        seen = _seen(file)
    except OSError:
        return ()
    if seen not in _COLOURS:
        read_meshes([file])
    return _COLOURS.get(seen, ())


def _seen(file: str) -> Seen:
    status = os.stat(file)
    return file, status.st_size, status.st_mtime_ns


def read_meshes(files: Iterable[str]) -> dict[str, tuple[Array, Array] | str]:
    """Return points (N, 3) and triangles (M, 3) of mesh files, or why one cannot be read."""
    read: dict[str, tuple[Array, Array] | str] = {file: fault(Path(file)) for file in files}
    names = [name for name, why in read.items() if not why]
    if not names:
        return read
    import subprocess  # on use: it takes 3 ms to import

    paths = os.pathsep.join(path for path in sys.path if path)
    environment = {**os.environ, "PYTHONPATH": paths}
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-P", mesh_reader.__file__, folder, *names]
        time = LEAST_TIME + TIME_OF_A_BYTE * sum(map(os.path.getsize, names))
        for _ in names:  # each run that ends too soon has at least started one more
            try:
                run = subprocess.run(
                    command, timeout=time, check=False, stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
            except subprocess.TimeoutExpired:
                continue
            except OSError as error:
                raise MechanismFileError(
                    f"no process can be started that reads meshes: {error}") from error
            if run.returncode == 0:
                break
        return read | {name: _outcome(Path(folder), k, name) for k, name in enumerate(names)}


def _outcome(folder: Path, k: int, name: str) -> tuple[Array, Array] | str:
    target, report = folder / f"{k}.npz", folder / f"{k}.txt"
    try:
        if report.is_file():
            text = report.read_text(encoding="utf-8").split("message:")[-1]
            lines = text.strip().splitlines() or ["no reason given"]
            printed = [x for x in lines if not x.startswith(("Could not load resource", "Hint:"))]
            return " ".join((printed or lines)[0].split())[:200]
        with np.load(target) as arrays:
            points, corners, colours = arrays["points"], arrays["corners"], arrays["colours"]
    except (OSError, ValueError, zipfile.BadZipFile):
        return "reading it does not end, or ends the process that reads it"
    if not np.all(np.isfinite(points)):
        return "it has points that are NaN or infinite"
    if corners.min() < 0 or corners.max() >= len(points):
        return "it has triangles of points that it does not have"
    known = np.where(np.isnan(colours).any(axis=1, keepdims=True), -1.0, colours)
    starts = np.flatnonzero(np.r_[True, np.any(known[1:] != known[:-1], axis=1)])
    counts = np.diff(np.r_[starts, len(known)])
    _COLOURS[_seen(name)] = tuple(
        (int(n), None if known[k, 0] < 0.0 else tuple(np.clip(known[k], 0, 1).tolist()))
        for k, n in zip(starts, counts, strict=True))
    return points, corners


def mesh_file(name: str, folder: Path, trust: Trust) -> Path | str:
    """Return where a mesh of a URDF lies, or why it may not be read, "" if it is not there."""
    package, reason = package_of(name), ""
    candidates: Iterable[Path] = [folder / name.removeprefix("file://")]
    if package is not None:
        candidates = (root / package[1]
                      for root in package_folders(package[0], folder, trust.packages))
    for file in filter(is_file, candidates):
        try:
            path = trust.resolved(file)
        except MechanismFileError:
            reason = OUTSIDE
            continue
        try:
            check_file(path)
        except MechanismFileError as error:
            reason = str(error)
        else:
            return path
    return reason


def package_of(name: str) -> tuple[str, str] | None:
    """Return the package that a mesh is in, and its path there; None where it is in none."""
    for scheme in ("package://", "model://"):
        if name.startswith(scheme):
            package, _, rest = name.removeprefix(scheme).lstrip("/").partition("/")
            return package, rest
    return None


def fault(file: Path) -> str:
    """Return why a mesh file cannot be one of its format, "" if it can."""
    kind = file.suffix.lower()
    try:
        with file.open("rb") as stream:
            size, head = os.fstat(stream.fileno()).st_size, stream.read(1 << 16)
    except OSError as error:
        return str(error.strerror)
    if not head:
        return "it is empty"
    check = FORMATS.get(kind)
    if check is not None and not check(head, size):
        return f"it is no {kind} file"
    if kind in ALONE:
        return ""
    if kind not in OF_PARTS:
        return f"{kind} is no format of meshes that is read here"
    return _parts_elsewhere(file, kind)


def _parts_elsewhere(file: Path, kind: str) -> str:
    """Return which file that a mesh names does not lie in its own folder, "" if none."""
    content, names = file.read_bytes(), list[Any]()

    def note(pairs: list[tuple[str, Any]]) -> None:
        names.extend(value for key, value in pairs if key == "uri")

    try:
        if kind == ".glb":
            content = content[20:20 + struct.unpack_from("<I", content, 12)[0]]
        json.loads(content, object_pairs_hook=note)
    except (ValueError, RecursionError, struct.error):
        return f"it is no {kind} file"
    trust = Trust.of(file)
    for name in map(str, names):
        if not name.startswith("data:") and not trust.allows(file.parent / unquote(name)):
            return f"its part {shown(name)!r} is no file in its folder"
    return ""


def _is_stl(head: bytes, size: int) -> bool:
    if head.lstrip()[:5].lower() == b"solid" and b"facet" in head.lower():
        return True
    return len(head) >= 84 and 0 < struct.unpack_from("<I", head, 80)[0] <= (size - 84) / 50


def _is_ply(head: bytes, size: int) -> bool:
    """Whether the file is as long as its points, of three numbers at least, must be."""
    end = head.find(b"end_header")
    points = re.search(rb"element\s+vertex\s+(\d{1,18})\s", head[:end])
    least = 12 if b"format binary" in head[:end] else 6  # bytes of a point
    return (head[:3] == b"ply" and end > 0 and points is not None
            and 0 < int(points[1]) * least <= size - end)


FORMATS: dict[str, Callable[[bytes, int], Any]] = {
    ".stl": _is_stl, ".ply": _is_ply,
    ".obj": lambda head, size: size > len(head) or re.search(rb"^[ \t]*v[ \t]", head, re.M),
    ".dae": lambda head, size: b"<COLLADA" in head,
    ".glb": lambda head, size: head[:4] == b"glTF",
}
