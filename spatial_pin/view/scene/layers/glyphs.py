"""Axes of joints and closures, as centre lines of drawings, and their signs, one for each kind.

To add the sign of a pair: a function from `Site` to `Piece`s, and its line in GLYPHS. Pieces are
drawn in the pair's own axes, z along its axis, of frame 1 (`first`, the body that carries) or of
frame 2 (`second`, the one that moves); `between` pieces, from 0 to 1 along z, reach from origin 1
to origin 2. A universal joint has its pin 1 along z of frame 1, its pin 2 along z of frame 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.shapes import Solid, ball, bar, moved, rod, tube, turned
from spatial_pin.view.scene.stage import Item, Layer, Stage, rod_between

AXIAL_FREEDOMS = {  # which of a joint's freedoms turn about its axis, or slide along it
    "revolute": (0,),
    "prismatic": (0,),
    "screw": (0,),
    "cylindrical": (0,),
    "planar": (2,),
    "universal": (0, 1),
}
AXIAL = (*AXIAL_FREEDOMS, "point_on_line", "point_on_plane", "parallel", "perpendicular")
COLOUR = (0.10, 0.11, 0.13, 1.0)
RADIUS, LENGTH = 0.0035, 0.35  # half the length; by the size of the scene
DASHES = (9.0, 2.0, 1.5, 2.0)  # lengths of dash, space, dot, space of an axis


class PairAxes(NamedTuple):
    """A pair between two bodies."""

    name: str  # name, kind: of the joint or closure
    kind: str
    joints: tuple[int, int]  # the bodies
    frames: tuple[Array, Array]  # of the pair in each body, z along its axis, shape (4, 4) each


def _framed(placement: pin.SE3, axes: Array) -> Array:
    M = placement.homogeneous.copy()
    M[:3, :3] = M[:3, :3] @ axes
    return M


def _outward(placement: pin.SE3) -> Array:
    """Return the direction (3,), in its own axes, in which a frame lies from its joint; else z."""
    p = placement.rotation.T @ placement.translation
    length = np.linalg.norm(p)
    return p / length if length > 0 else np.array([0.0, 0.0, 1.0])


def pairs_of(mechanism: Mechanism) -> list[PairAxes]:
    """Return every joint of the tree, and every closure that joins two frames, as a pair."""
    model, pairs = mechanism.model, list[PairAxes]()
    data = model.createData()
    J = pin.computeJointJacobians(model, data, mechanism.neutral).reshape(6, model.nv)
    for j, kind in enumerate(mechanism.pairs, start=1):
        columns = J[:, [model.idx_vs[j] + column for column in AXIAL_FREEDOMS.get(kind, ())]].T
        vectors = [c[3:] if np.any(c[3:]) else c[:3] for c in columns]
        axes = [data.oMi[j].rotation.T @ v / np.linalg.norm(v) for v in vectors]
        on_parent, bodies = model.jointPlacements[j], (int(model.parents[j]), j)
        axes = axes or [_outward(on_parent)]
        turn1, turn2 = axes_from_z(axes[0]), axes_from_z(axes[-1])
        frames = _framed(on_parent, turn1), _framed(pin.SE3.Identity(), turn2)
        pairs.append(PairAxes(model.names[j], kind, bodies, frames))
    joined = [(c, ends) for c in mechanism.closures if c.frames
              for ends in (c.joined if c.pair.has_more else [c.frames[:2]])]
    for closure, ends in joined:
        (i1, m1), (i2, m2) = (mechanism.frame_on_joint(name) for name in ends)
        turn1, turn2 = closure.geometry.axes1, closure.geometry.axes2
        if closure.type == "spherical":
            turn1 = axes_from_z(_outward(m1))
        frames = _framed(m1, turn1), _framed(m2, turn2)
        pairs.append(PairAxes(closure.name, closure.type, (i1, i2), frames))
    return pairs


def axes(stage: Stage) -> Layer:
    """Return the axis of every joint and closure that has one; both pins of a universal one."""
    length, ends = LENGTH * stage.size, [0.0]
    for part in (*(DASHES * 3), DASHES[0]):
        ends.append(ends[-1] + part)
    z = length * (2 * np.array(ends) / ends[-1] - 1)
    radius = RADIUS * stage.size
    line = turned(*((r, x) for a, b in zip(z[::2], z[1::2], strict=True)
                    for r, x in ((0.0, a), (radius, a), (radius, b), (0.0, b))), segments=12)
    items: list[Item] = []
    points: list[Array] = [np.zeros((0, 3))]
    for pair in pairs_of(stage.film.mechanism):
        sides = (0, 1) if pair.kind in ("universal", "perpendicular") else (1,)
        for side in sides if pair.kind in AXIAL else ():
            joint, frame = pair.joints[side], pair.frames[side]
            items.append(Item(f"axis {pair.name} {side}", line, COLOUR, joint, frame, through=True,
                              called=f"axis of {pair.name}", axial=True))
            points += [stage.points(joint, frame[:3, 3] + end * length * frame[:3, 2])
                       for end in (-1, 1)]
    return Layer(tuple(items), np.concatenate(points))


# ---------------------------------------------------------------- signs

UNIT, LEAST = 0.05, 0.012  # largest and least size of a sign relative to the size of the scene
NEIGHBOUR = 0.35  # largest relative to the distance from the next pair of the same body
SAME_PLACE = 1e-3  # by the size of the scene: pairs that are nearer count as one
CARRIES = (0.17, 0.19, 0.22, 1.0)  # colour of the parts on frame 1
MOVES = (0.50, 0.53, 0.57, 1.0)  # and to frame 2
THROUGH = 0.72  # opacity of signs that are seen through bodies
MOST_THREAD_TURNS = 60.0  # of a thread that is drawn: more are a grey bar


class Site(NamedTuple):
    """The placement of a sign."""

    unit: float  # its size [m]
    travel: tuple[float, float]  # least and greatest height of origin 2 along z of frame 1 [m]
    middle: tuple[float, float]  # of where origin 2 comes to, along x and y of frame 1 [m]
    reach: tuple[float, float]  # its least and greatest distance from there [m]

    @property
    def rail(self) -> tuple[float, float]:
        """Ends along z of frame 1 of what origin 2 slides on, origin 1 among it [m]."""
        (low, high), room = self.travel, 2.2 * self.unit
        return min(0.0, low - room), max(0.0, high + room)


class Piece(NamedTuple):
    """One solid of a sign."""

    on: str  # the frame that carries it: "first", "second" or "between"
    solid: Solid  # its shape
    # least and greatest z, and radius of it [m], where that is more than the sign's size
    span: tuple[float, float, float] = (0.0, 0.0, 0.0)
    middle: tuple[float, float] = (0.0, 0.0)  # x and y of where that is [m]


def _revolute(site: Site) -> list[Piece]:
    s = site.unit
    inner, outer, half = 0.5 * s, 0.95 * s, 0.55 * s
    ring = turned((inner, -half), (outer, -half), (outer, half), (inner, half), (inner, -half))
    return [Piece("first", ring), Piece("second", rod(0.42 * s, -1.0 * s, 1.0 * s))]


def _prismatic(site: Site) -> list[Piece]:
    s, rail = site.unit, site.rail
    sleeve = bar(0.75 * s, -1.1 * s, 1.1 * s)
    return [Piece("first", bar(0.32 * s, *rail), (*rail, 0.0)), Piece("second", sleeve)]


def _screw(site: Site) -> list[Piece]:
    s, (low, high) = site.unit, site.travel
    start, end = -high - 2.0 * s, 2.0 * s - low
    nut = turned(
        (0.0, -0.5 * s), (1.05 * s, -0.5 * s), (1.05 * s, 0.5 * s), (0.0, 0.5 * s), segments=6
    )
    turns = min((end - start) / (0.45 * s), MOST_THREAD_TURNS)
    angle = np.linspace(0.0, 2 * np.pi * turns, 1 + int(20 * turns))
    z = np.linspace(start, end, len(angle))
    helix = np.stack([0.5 * s * np.cos(angle), 0.5 * s * np.sin(angle), z], axis=1)
    thread = Solid(tube(helix, 0.12 * s, segments=5))
    screw = Piece("second", rod(0.5 * s, start, end), (start, end, 0.0))
    return [Piece("first", nut), screw, Piece("second", thread)]


def _cylindrical(site: Site) -> list[Piece]:
    s = site.unit
    half, r, collar, wide = 1.2 * s, 0.72 * s, 0.2 * s, 1.1 * s
    lower = [(0.0, -half), (r, -half), (r, -collar), (wide, -collar)]
    sleeve = turned(*lower, *((x, -z) for x, z in reversed(lower)))
    shaft = Piece("first", rod(0.36 * s, *site.rail), (*site.rail, 0.0))
    return [shaft, Piece("second", sleeve)]


def _spherical(site: Site) -> list[Piece]:
    s = site.unit
    angle = np.linspace(-np.pi / 2, 0.1, 12)
    outer = [(1.05 * s * np.cos(a), 1.05 * s * np.sin(a)) for a in angle]
    inner = [(0.88 * s * np.cos(a), 0.88 * s * np.sin(a)) for a in angle[::-1]]
    return [Piece("first", turned(*outer, *inner)), Piece("second", ball(0.85 * s))]


def _plate(site: Site) -> Piece:
    """Return the part of a plane that origin 2 comes to, however far frame 1 is from there."""
    s, (near, far) = site.unit, site.reach
    inner, outer = max(0.0, near - 1.8 * s), far + 1.8 * s
    ring = turned(
        (inner, -0.12 * s), (outer, -0.12 * s), (outer, 0.0), (inner, 0.0), (inner, -0.12 * s)
    )
    plate = ring._replace(placement=moved(np.array([*site.middle, 0.0])) @ ring.placement)
    return Piece("first", plate, (0.0, 0.0, outer), site.middle)


def _planar(site: Site) -> list[Piece]:
    s = site.unit
    foot = turned((0.0, 0.0), (0.75 * s, 0.0), (0.75 * s, 0.25 * s), (0.0, 0.25 * s))
    normal = rod(0.13 * s, 0.0, 1.8 * s)
    return [_plate(site), Piece("second", foot), Piece("second", normal)]


def _universal(site: Site) -> list[Piece]:
    s = site.unit
    first, second = (rod(0.3 * s, -1.35 * s, 1.35 * s) for _ in range(2))
    return [Piece("first", first), Piece("second", second), Piece("second", ball(0.5 * s))]


def _distance(site: Site) -> list[Piece]:
    s = site.unit
    ends = [Piece(on, ball(0.32 * s)) for on in ("first", "second")]
    return [*ends, Piece("between", rod(0.13 * s))]


def _point(site: Site) -> list[Piece]:
    return [Piece("second", ball(0.4 * site.unit))]


def _directions(site: Site) -> list[Piece]:
    s = site.unit
    pointer = turned(
        (0.0, 0.0), (0.12 * s, 0.0), (0.12 * s, 1.8 * s), (0.34 * s, 1.8 * s), (0.0, 2.7 * s)
    )
    return [Piece("first", pointer), Piece("second", pointer)]


GLYPHS: dict[str, Callable[[Site], list[Piece]]] = {
    "revolute": _revolute,
    "prismatic": _prismatic,
    "screw": _screw,
    "cylindrical": _cylindrical,
    "spherical": _spherical,
    "planar": _planar,
    "universal": _universal,
    "distance": _distance,
    "point_on_curve": _point,
    "cam": _point,
    "frame_on_curve": _point,
    "curve_on_curve": _point,
    "rope": _distance,
    "point_on_line": lambda site: [Piece("first", rod(0.13 * site.unit, *site.rail),
                                         (*site.rail, 0.0)), *_point(site)],
    "point_on_plane": lambda site: [_plate(site), *_point(site)],
    "parallel": _directions,
    "perpendicular": _directions,
}


def _origins(stage: Stage, pair: PairAxes) -> tuple[Array, Array]:
    """Return the origins of both frames in the view, shape (N, 3) each [m]."""
    pairs = zip(pair.joints, pair.frames, strict=True)
    first, second = (stage.points(joint, M[:3, 3]) for joint, M in pairs)
    return first, second


def _units(stage: Stage, pairs: Sequence[PairAxes]) -> list[float]:
    """Return the sizes of signs [m]: smaller where pairs of a body are close to each other."""
    sides = [(joint, frame[:3, 3]) for pair in pairs
             for joint, frame in zip(pair.joints, pair.frames, strict=True)]
    bodies = np.array([joint for joint, _ in sides])
    points = np.array([point for _, point in sides])
    units = []
    for joint, point in sides:
        away = np.linalg.norm(points[bodies == joint] - point, axis=1)
        nearest = away[away > SAME_PLACE * stage.size].min(initial=np.inf)
        units.append(np.clip(NEIGHBOUR * nearest, LEAST * stage.size, UNIT * stage.size))
    return [float(min(pair)) for pair in zip(units[::2], units[1::2], strict=True)]


def _site(stage: Stage, pair: PairAxes, unit: float) -> Site:
    """Return how far the second frame goes, as seen from the first."""
    o1, o2 = _origins(stage, pair)
    axes = stage.rotations(pair.joints[0], pair.frames[0][:3, :3])
    x, y, z = np.einsum("nij,ni->jn", axes, o2 - o1)
    middle = 0.5 * float(x.min() + x.max()), 0.5 * float(y.min() + y.max())
    away = np.hypot(x - middle[0], y - middle[1])
    return Site(unit, (float(z.min()), float(z.max())), middle,
                (float(away.min()), float(away.max())))


def _held(stage: Stage, pair: PairAxes, piece: Piece) -> Array:
    """Return the points of a piece that a picture must hold, shape (K, 3) [m]."""
    (low, high, r), (x, y) = piece.span, piece.middle
    if piece.on == "between" or low == high == r == 0.0:
        return np.zeros((0, 3))
    side = 0 if piece.on == "first" else 1
    corners = [(x + r, y, low), (x - r, y, low), (x, y + r, high), (x, y - r, high)]
    frame = pair.frames[side]
    points = [frame[:3, :3] @ p + frame[:3, 3] for p in corners]
    return np.concatenate([stage.points(pair.joints[side], p) for p in points])


def glyphs(stage: Stage, through: bool) -> Layer:
    """Return a sign for every joint and closure, seen through the bodies or not."""
    items: list[Item] = []
    points: list[Array] = [np.zeros((0, 3))]
    pairs = pairs_of(stage.film.mechanism)
    for pair, unit in zip(pairs, _units(stage, pairs), strict=True):
        make = GLYPHS.get(pair.kind)
        for k, piece in enumerate(make(_site(stage, pair, unit)) if make else ()):
            *rgb, opacity = MOVES if piece.on == "second" else CARRIES
            item = Item(f"{pair.kind} {pair.name} {k}", piece.solid,
                        (*rgb, THROUGH if through else opacity), through=through,
                        called=f"{pair.name}: {pair.kind}")
            if piece.on == "between":
                item = replace(item, track=rod_between(*_origins(stage, pair)))
            else:
                side = 0 if piece.on == "first" else 1
                item = replace(item, joint=pair.joints[side], placement=pair.frames[side],
                               axial=pair.kind in AXIAL)
            items.append(item)
            points.append(_held(stage, pair, piece))
    return Layer(tuple(items), np.concatenate(points))
