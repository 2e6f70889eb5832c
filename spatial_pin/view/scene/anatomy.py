"""Links and pairs for the inspector of a page: poses, masses, and numbers at each sample."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.dynamics.kinetostatics import Kinetostatics
from spatial_pin.mechanism.coordinates import coordinates_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.film import Film
from spatial_pin.view.scene.layers.glyphs import AXIAL, pairs_of

FORCES = (("force", "N", slice(0, 3)), ("moment", "N·m", slice(3, 6)))  # of a reaction


class Signal(NamedTuple):
    """A number of a film that its page can show and draw."""

    name: str  # of the quantity, as outputs are named
    unit: str  # of the values
    pair: str  # joint or closure that it belongs to
    what: str  # "value", "rate", "force" or "moment"
    values: Array  # in every sample, shape (N,)


def anatomy(mechanism: Mechanism) -> dict[str, Any]:
    """Return the frames and pairs of a mechanism, each on the number of its joint, as plain data.

    Frames are links and named frames; a link has its mass [kg] and centre of mass [m] in its frame.
    The first of two joints that a pair joins is the one that carries.
    """
    frames, pairs = list[dict[str, Any]](), list[dict[str, Any]]()
    for name in dict.fromkeys([*mechanism.links, *mechanism.frames]):
        if name in mechanism.unplaced:
            continue
        joint, placement = mechanism.frame_on_joint(name)
        x, y, z, *turn = _short(pin.SE3ToXYZQUAT(placement))
        frames.append({"name": name, "joint": joint, "at": [x, y, z], "turn": turn})
        inertia = mechanism.inertias.get(name)
        if inertia is not None and inertia.mass > 0.0:
            frames[-1] |= {"mass": inertia.mass, "com": _short(inertia.lever)}
    for pair in pairs_of(mechanism):
        coordinates = [c.name for c in coordinates_of(mechanism, pair.name)]
        pairs.append({"name": pair.name, "kind": pair.kind, "joints": pair.joints,
                      "at": [_short(frame[:3, 3]) for frame in pair.frames],
                      "coordinates": coordinates})
        if pair.kind in AXIAL:
            pairs[-1]["along"] = _short(pair.frames[1][:3, 2])
    return {"frames": frames, "pairs": pairs}


def _short(values: Array) -> list[float]:
    """Return values with the digits that a page shows, and two more."""
    return [float(f"{x:.8g}") for x in values]


def signals(film: Film, loads: Kinetostatics | None = None) -> list[Signal]:
    """Return the coordinates of a film with their rates, and the reactions of its loads."""
    result, source = list[Signal](), film.source
    for name, c in film.mechanism.coordinate_table.items():
        value, rate, _ = (np.atleast_1d(x)[film.rows] for x in source.coordinate(name))
        values, unit = (np.rad2deg(value), "°") if c.unit == "rad" else (value, c.unit)
        result.append(Signal(name, unit, c.joint, "value", values))
        if isinstance(source, Motion):
            result.append(Signal(f"{name}.rate", source.rate_unit(c.unit), c.joint, "rate", rate))
    if loads is None:
        return result
    for name, wrench in loads.reactions.items():
        for (what, unit, part), mark in zip(FORCES, loads.marks(name), strict=True):
            one = f"{name}.reaction {what}{', one of many' if mark else ''}"
            size = np.linalg.norm(wrench[film.rows, part], axis=1)
            result.append(Signal(one, unit, name, what, size))
    return result
