"""What a page can tell of links and pairs: places, masses, and numbers sample by sample."""

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
from spatial_pin.view.scene.layers.axes import AXIAL
from spatial_pin.view.scene.layers.places import Place, places

FORCES = (("force", "N", slice(0, 3)), ("moment", "N·m", slice(3, 6)))  # of a reaction


class Signal(NamedTuple):
    """A number of a film that its page can tell and draw.

    Attributes:
        name: of the quantity, as outputs are named.
        unit: it is told in.
        pair: joint or closure that it belongs to.
        what: "value", "rate", "force" or "moment".
        values: in every sample, shape (N,).
    """

    name: str
    unit: str
    pair: str
    what: str
    values: Array


def anatomy(mechanism: Mechanism) -> dict[str, Any]:
    """Return the frames and pairs of a mechanism, each on the number of its joint, as plain data.

    Frames are links and named frames; a link has its mass [kg] and centre of mass [m] in its frame.
    The first of two joints that a pair joins is the one that carries.
    """
    return {"frames": [_frame(mechanism, name) for name in _names(mechanism)],
            "pairs": [_pair(mechanism, place) for place in places(mechanism)]}


def _names(mechanism: Mechanism) -> list[str]:
    every = dict.fromkeys([*mechanism.links, *mechanism.frames])
    return [name for name in every if name not in mechanism.unplaced]


def _frame(mechanism: Mechanism, name: str) -> dict[str, Any]:
    joint, placement = mechanism.frame_on_joint(name)
    x, y, z, *turn = _short(pin.SE3ToXYZQUAT(placement))
    told = {"name": name, "joint": joint, "at": [x, y, z], "turn": turn}
    inertia = mechanism.inertias.get(name)
    if inertia is not None and inertia.mass > 0.0:
        told |= {"mass": inertia.mass, "com": _short(inertia.lever)}
    return told


def _pair(mechanism: Mechanism, place: Place) -> dict[str, Any]:
    coordinates = [c.name for c in coordinates_of(mechanism, place.name)]
    told = {"name": place.name, "kind": place.kind, "joints": place.joints,
            "at": [_short(frame[:3, 3]) for frame in place.frames], "coordinates": coordinates}
    if place.kind in AXIAL:
        told["along"] = _short(place.frames[1][:3, 2])
    return told


def _short(values: Array) -> list[float]:
    """Return values with the digits that a page tells, and two more."""
    return [float(f"{x:.8g}") for x in values]


def signals(film: Film, loads: Kinetostatics | None = None) -> list[Signal]:
    """Return the coordinates of a film with their rates, and its reactions.

    Args:
        film: the film; one of a state has no rates.
        loads: forces of its whole motion, if they are known.
    """
    found, source = list[Signal](), film.source
    for name, c in film.mechanism.coordinate_table.items():
        value, rate, _ = (np.atleast_1d(x)[film.rows] for x in source.coordinate(name))
        values, unit = (np.rad2deg(value), "°") if c.unit == "rad" else (value, c.unit)
        found.append(Signal(name, unit, c.joint, "value", values))
        if isinstance(source, Motion):
            found.append(Signal(f"{name}.rate", source.rate_unit(c.unit), c.joint, "rate", rate))
    if loads is None:
        return found
    for name, wrench in loads.reactions.items():
        for (what, unit, part), mark in zip(FORCES, loads.marks(name), strict=True):
            one = f"{name}.reaction {what}{', one of many' if mark else ''}"
            size = np.linalg.norm(wrench[film.rows, part], axis=1)
            found.append(Signal(one, unit, name, what, size))
    return found
