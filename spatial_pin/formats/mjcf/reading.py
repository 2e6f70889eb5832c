"""MJCF, MuJoCo's models, read through the `mujoco` package."""

from __future__ import annotations

from typing import Any

import numpy as np

from spatial_pin.formats.imported import Imported, Request
from spatial_pin.formats.mjcf.compiling import compiled
from spatial_pin.formats.mjcf.drives import read_drivers, read_guess, read_springs
from spatial_pin.formats.mjcf.left_out import left_out
from spatial_pin.formats.mjcf.loops import read_closures
from spatial_pin.formats.mjcf.tree import Reading, read_tree
from spatial_pin.formats.sources import Trust, shown

UNNAMED = "MuJoCo Model"  # what MuJoCo calls a model without a name


def read(request: Request) -> Imported:
    """Read an MJCF file.

    Raises:
        MechanismFileError: `mujoco` is not installed or refuses the file, or an equality has no
            exact counterpart.
    """
    trust = Trust.of(request.path, request.packages, request.trusted)
    source = compiled(request.path, trust, request.without)
    import mujoco

    names = source.model.names
    said = names[:names.index(b"\0")].decode()
    name = said if said and said != UNNAMED else request.path.stem
    reading = read_tree(mujoco, source, name)
    closures = read_closures(reading, shown(request.path))
    content: dict[str, Any] = {
        "name": name, "gravity": _gravity(reading),
        "order": [place.name for place in reading.joints], "joints": reading.refined,
        "closures": closures,
        "springs": read_springs(reading), "guess": read_guess(reading),
    }
    if reading.model.nu:
        content["drivers"] = read_drivers(reading, closures)
    notices = (*source.notices, *reading.notices, *left_out(reading))
    return Imported(reading.urdf.text(), content, notices)


def _gravity(reading: Reading) -> list[float]:
    gravity = np.zeros(3) if reading.is_off("GRAVITY") else reading.model.opt.gravity
    return [float(x) for x in gravity]

