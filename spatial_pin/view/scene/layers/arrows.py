"""Vectors at points, one scale for each quantity; paths of points, as thin tubes.

To draw vectors of another kind (forces, say), make `Vectors` of them and give them as
`Look.arrows`; to give their quantity a colour of its own, add it to COLOURS.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from spatial_pin._support.brief import brief
from spatial_pin._support.checks import as_array
from spatial_pin.errors import UnknownNameError
from spatial_pin.motion.motion import FrameMotion, Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.film import length_words, nice
from spatial_pin.view.scene.shapes import Solid, ball, moved, rod, tube, turned
from spatial_pin.view.scene.stage import (
    Colour,
    Entry,
    Item,
    Layer,
    Stage,
    Track,
    quaternions_along,
    rod_between,
)

if TYPE_CHECKING:
    from spatial_pin.dynamics.kinetostatics import Kinetostatics

LOADS = {"reaction": ("force", "N", slice(0, 3)), "moment": ("moment", "N·m", slice(3, 6))}
KINDS = ("velocity", "acceleration", "angular_velocity", "angular_acceleration")
LONGEST_ARROW = 0.6  # longest arrow relative to the size of the scene; all sizes below too
SHAFT_RADIUS, HEAD_RADIUS, HEAD_LENGTH = 0.011, 0.028, 0.08  # radius, radius, length
OTHER = (0.13, 0.15, 0.18, 1.0)
COLOURS: dict[str, Colour] = {
    "velocity": (0.06, 0.12, 0.55, 1.0),
    "acceleration": (0.78, 0.05, 0.13, 1.0),
    "angular velocity": (0.42, 0.10, 0.62, 1.0),
    "angular acceleration": (0.62, 0.34, 0.05, 1.0),
    "force": (0.05, 0.05, 0.05, 1.0),
    "moment": (0.35, 0.35, 0.38, 1.0),
}
TUBE = 0.006  # radius of a tube relative to the size of the scene
BEHIND = 0.35  # opacity where bodies stand before it
TRACE_COLOURS = (
    (0.55, 0.08, 0.45, 1.0),
    (0.10, 0.13, 0.17, 1.0),
    (0.00, 0.38, 0.45, 1.0),
    (0.48, 0.30, 0.05, 1.0),
)
TURNING = ("angular velocity", "angular acceleration", "moment")  # drawn with two heads


class Vectors(NamedTuple):
    """A vector at a point, in every sample of a motion.

    Attributes:
        name: of the point.
        point: where it starts, world, shape (N, 3) [m].
        vector: world axes, shape (N, 3) [unit].
        quantity: its name, such as "velocity"; arrows of one quantity share a scale.
        unit: its SI unit.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 91), speed=1.0)
        >>> point = motion.frame("coupler_b")
        >>> wind = sp.Vectors("wind", point.position, -0.5 * point.velocity, "force", "N")
        >>> sp.Look(arrows=(wind,)).arrows[0].vector.shape  # (N, 3)
        (91, 3)
    """

    name: str
    point: Array
    vector: Array
    quantity: str
    unit: str

    def __repr__(self) -> str:
        return brief(self, point="m", vector=self.unit)


def point_motion(motion: Motion, name: str) -> FrameMotion:
    """Return the motion of a link, frame or joint, or of a link's centre of mass (`NAME.com`)."""
    if name.endswith(".com"):
        return motion.com(name.removesuffix(".com"))
    return motion.frame(name)


def traces(stage: Stage, names: tuple[str, ...]) -> Layer:
    """Return the paths of named points."""
    paths = [stage.seen(point_motion(stage.film.motion, name).position) for name in names]
    colours = [TRACE_COLOURS[k % len(TRACE_COLOURS)] for k in range(len(names))]
    items: list[Item] = []
    for name, path, colour in zip(names, paths, colours, strict=True):
        radius, title = TUBE * stage.size, f"path of {name}"
        drawn = Solid(tube(path, radius))
        if np.ptp(path, axis=0).max() < 1e-3 * radius:  # a single point
            drawn = Solid(ball(radius).geometry, moved(path[0]))
        items.append(Item(title, drawn, colour))
        items.append(Item(f"{title}, behind", drawn, (*colour[:3], BEHIND), through=True,
                          called=title))
    legend = tuple(Entry(c, f"path of {n}") for c, n in zip(colours, names, strict=True))
    return Layer(tuple(items), np.concatenate([np.zeros((0, 3)), *paths]), legend)


def load(loads: Kinetostatics, pair: str, kind: str) -> Vectors:
    """Return the force ("reaction") or moment that a pair exerts, at the pair.

    On the child link of a joint, on the link of a closure's second frame.
    """
    motion, reactions = loads.motion, loads.reactions
    mechanism = motion.mechanism
    if pair not in reactions:
        raise UnknownNameError("pair", pair, list(reactions), f"mechanism {mechanism.name!r}: ")
    closure = next((c for c in mechanism.closures if c.name == pair), None)
    at = pair
    if closure is not None:  # a coupling acts on its last joint
        at = (closure.frames[1] if closure.frames
              else mechanism.coordinate(closure.joints[-1]).joint)
    point = motion.frame(at).position
    quantity, unit, part = LOADS[kind]
    return Vectors(pair, point, reactions[pair][:, part], quantity, unit)


def rates(motion: Motion, spec: str) -> Vectors:
    """Return the vectors that `NAME.velocity` and its kin name; see `Look.arrows`."""
    name, _, kind = spec.rpartition(".")
    if kind not in KINDS or not name:
        valid = [f"{n}.{k}" for n in motion.mechanism.frame_ids for k in KINDS]
        raise UnknownNameError("arrow", spec, valid, f"mechanism {motion.mechanism.name!r}: ")
    moving = point_motion(motion, name)
    return Vectors(name, moving.position, getattr(moving, kind), kind.replace("_", " "),
                   motion.frame_unit(kind))


def _items(stage: Stage, v: Vectors, per_unit: float) -> tuple[tuple[Item, ...], Array]:
    """Return shaft and head of an arrow, and its tips (N, 3) [m]."""
    start, along = stage.seen(v.point), per_unit * stage.seen(v.vector)
    length = np.linalg.norm(along, axis=1)
    heads = 2 if v.quantity in TURNING else 1
    head_length = (0.3 + 0.7 * heads) * HEAD_LENGTH * stage.size
    scale = np.minimum(1.0, length / head_length)
    tip = start + along
    covered = np.clip(length - 0.5 * head_length * scale, 0.0, None)
    part = np.divide(covered, length, out=np.zeros_like(length), where=length > 0)
    head = Track(
        np.concatenate([tip, quaternions_along(along)], axis=1), np.repeat(scale[:, None], 3, 1)
    )
    name, colour = f"{v.quantity} of {v.name}", COLOURS.get(v.quantity, OTHER)
    shaft = rod_between(start, start + part[:, None] * along)
    thin = scale[:, None] * shaft.scales[:, :2]  # type: ignore[index]
    shaft = Track(shaft.poses, np.concatenate([thin, shaft.scales[:, 2:]], axis=1))  # type: ignore[index]
    r, h = HEAD_RADIUS * stage.size, HEAD_LENGTH * stage.size
    below = [-(heads - k) * 0.7 * h - 0.3 * h for k in range(heads)]  # one behind the other
    cone = turned(*(p for z in below for p in ((0.0, z), (r, z), (0.0, z + h))))
    items = (
        Item(name, rod(SHAFT_RADIUS * stage.size), colour, track=shaft, through=True),
        Item(f"head, {name}", cone, colour, track=head, through=True),
    )
    return items, tip


def arrows(stage: Stage, specs: tuple[str | Vectors, ...]) -> list[Layer]:
    """Return vectors at their points, one layer for each quantity."""
    quantities: dict[str, list[Vectors]] = {}
    film, n = stage.film, len(np.atleast_2d(stage.film.source.q))
    for one in specs:
        if isinstance(one, str):
            name, _, kind = one.rpartition(".")
            vectors = load(film.loads, name, kind) if kind in LOADS else rates(film.motion, one)
        else:
            point, vector = (as_array(x, "points and vectors") for x in (one.point, one.vector))
            if point.shape != (n, 3) or vector.shape != (n, 3):
                shapes = f"{point.shape} and {vector.shape}"
                raise ValueError(f"{one.name}: points and vectors are {shapes}; ({n}, 3) is needed")
            vectors = one._replace(point=point[film.rows], vector=vector[film.rows])
        quantities.setdefault(vectors.quantity, []).append(vectors)
    layers = []
    for alike in quantities.values():  # to one scale
        quantity, unit = alike[0].quantity, alike[0].unit
        colour = COLOURS.get(quantity, OTHER)
        names = ", ".join(v.name for v in alike)
        largest = max(float(np.linalg.norm(v.vector, axis=1).max(initial=0.0)) for v in alike)
        if largest == 0.0:
            layers.append(Layer(legend=(Entry(colour, f"{quantity} of {names}: none"),)))
            continue
        value = nice(largest / 4)
        length = nice(0.95 * LONGEST_ARROW * stage.size / (largest / value))
        if length * largest / value > 1.5 * LONGEST_ARROW * stage.size:
            length = nice(length / 2)
        drawn = [_items(stage, v, length / value) for v in alike]
        words = f"{quantity} of {names}: {length_words(length)} = {value:.4g} {unit}"
        items = tuple(item for pair, _ in drawn for item in pair)
        tips = np.concatenate([tip for _, tip in drawn])
        layers.append(Layer(items, tips, (Entry(colour, words),)))
    return layers
