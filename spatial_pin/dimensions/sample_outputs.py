"""Outputs of many samples together, by the names that `Motion.output` knows."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from spatial_pin.constraints.closure_equations import constraints_of
from spatial_pin.constraints.sample_coefficients import times
from spatial_pin.constraints.vectorised_tree import WRAPPED, cross
from spatial_pin.dimensions.geometry import Geometry, carriers
from spatial_pin.dimensions.samples import Moving
from spatial_pin.mechanism.coordinates import coordinate_rates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import FRAME_UNITS
from spatial_pin.motion.outputs import COORDINATE_OUTPUTS
from spatial_pin.numerics.linalg import Array

COORDINATE_KINDS = ("rate", "acceleration", "ratio", "advantage")
POINT_KINDS = tuple(kind for kind in FRAME_UNITS if kind != "jerk")


class Wanted(NamedTuple):
    """An output: which quantity of which coordinate, or of which point."""

    name: str
    kind: str
    is_point: bool


def wanted(mechanism: Mechanism, spec: str) -> Wanted | None:
    """Read an output as `Motion.output` does; None if it takes one sample at a time."""
    coordinates = {*mechanism.coordinate_table, *mechanism.drivers}
    if spec in coordinates:
        return Wanted(spec, "value", False)
    name, _, kind = spec.rpartition(".")
    if name in coordinates and kind in COORDINATE_OUTPUTS:
        return Wanted(name, kind, False) if kind in COORDINATE_KINDS else None
    if kind in POINT_KINDS and name.removesuffix(".com") in mechanism.frame_ids:
        return Wanted(name, kind, True)
    return None


def is_possible(mechanism: Mechanism, outputs: Iterable[str]) -> bool:
    """Whether the outputs can be had of many samples together."""
    return (all(wanted(mechanism, spec) for spec in outputs)
            and isinstance(constraints_of(mechanism).c_abx, np.ndarray))


def points_of(mechanism: Mechanism, outputs: Iterable[str]) -> list[str]:
    """Return the points whose motion the outputs tell."""
    found = (wanted(mechanism, spec) for spec in outputs)
    return list(dict.fromkeys(x.name for x in found if x and x.is_point))


def output(moving: Moving, geometry: Geometry, points: list[str], spec: str) -> Array:
    """Return an output (m,) or (m, 3) of samples.

    Args:
        moving: the samples.
        geometry: theirs, made for `points`.
        points: of `points_of`.
        spec: one of the outputs that `wanted` reads.
    """
    mechanism = moving.batch.mechanism
    found = wanted(mechanism, spec)
    assert found is not None
    if found.is_point:
        return _point(moving, geometry, points, found).T
    rows = moving.placed.q.T, moving.v.T, moving.a.T
    rates = coordinate_rates(mechanism, found.name, *rows, continued=False)
    if found.kind not in ("ratio", "advantage"):
        value: Array = rates._asdict()[found.kind]
        return value
    speed = moving.v[mechanism.coordinate(next(iter(mechanism.drivers))).v]
    with np.errstate(divide="ignore"):
        ratio: Array = rates.rate / speed if found.kind == "ratio" else speed / rates.rate
    return ratio


def _point(moving: Moving, geometry: Geometry, points: list[str], found: Wanted) -> Array:
    """Return a rate (3, m) of a point, world axes."""
    batch, place, kind = moving.batch, points.index(found.name), found.kind
    joint = carriers(batch.mechanism, [found.name])[0]
    at = batch.tree.carrier[joint]
    g = moving.placed.g[at]
    arm = times(geometry.offsets, g[:3])[place]
    if kind == "position":
        return (g[3] + arm)[:3]
    if moving.first is None or moving.second is None:
        return np.zeros((3, g.shape[-1]))
    w, velocity = moving.first[at]
    if kind == "angular_velocity":
        return w[:3]
    if kind == "velocity":
        return (velocity + cross(w, arm))[:3]
    own = moving.a * batch.constraints.support(joint)[:, None]
    columns = batch.tree.columns(moving.placed.g)
    linear, turning = (np.einsum("ivm,vm->im", part, own)[WRAPPED]
                       for part in (columns[:3], columns[3:]))
    alpha = moving.second[at, 0] + turning
    if kind == "angular_acceleration":
        return alpha[:3]
    origin = moving.second[at, 1] + linear + cross(turning, g[3])
    return (origin + cross(alpha, arm) + cross(w, cross(w, arm)))[:3]
