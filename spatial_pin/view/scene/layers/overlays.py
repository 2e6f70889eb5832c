"""Objects drawn with a motion: other states and motions, clearance, workspace, goals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.proximity.clearance import Clearance, PairClearance, in_words
from spatial_pin.synthesis.goals import PathGoal, PosesGoal
from spatial_pin.synthesis.ranked_designs import Design
from spatial_pin.view.scene.film import (
    Readout,
    driver_readings,
    film,
    length_words,
    moments,
    unit_of_length,
)
from spatial_pin.view.scene.framing import axes_of_view, occupied
from spatial_pin.view.scene.layers.arrows import traces
from spatial_pin.view.scene.layers.visuals import body_items, with_skeleton
from spatial_pin.view.scene.shapes import Solid, ball, mg, moved, rod
from spatial_pin.view.scene.stage import (
    Colour,
    Entry,
    Item,
    Layer,
    Stage,
    Track,
    ball_at,
    joined,
    joint_poses,
    rod_between,
)
from spatial_pin.workspace.workspace_result import Workspace

OPACITY = 0.28  # of four that lie on each other a body behind is still seen
SPACING = 1.12  # from one picture to the next relative to their width and height
LABEL_COLOUR = (0.75, 0.78, 0.81, 1.0)


def words(state: State) -> str:
    """Return the branch of a state, and the values of its drivers, in words."""
    branch = [f"branch {state.branch}"] if state.branch else []
    values = [reading.text(0) for reading in driver_readings(state)]
    return ", ".join(branch + values) or "another configuration"


def others_of(
    stage: Stage, shown: Iterable[State | Motion], name: str
) -> list[tuple[list[Item], Array, str]]:
    """Return solids, corners (K, 3) [m] and names of other states and motions."""
    others = []
    for k, one in enumerate(shown, start=1):
        own, mechanism = film(one), one.mechanism
        visuals = tuple(with_skeleton(mechanism.model, mechanism.visual_model, None))
        poses = joint_poses(mechanism.model, own.q)
        there = Stage(own, visuals, poses, stage.upright, stage.size)
        parts = [replace(x, name=f"{name} {k} {x.name}") for x in body_items(visuals, there)]
        if isinstance(one, State):
            if mechanism.coordinates != stage.film.mechanism.coordinates:
                raise SpatialPinError(
                    f"a ghost is a state of mechanism {mechanism.name!r}; "
                    f"the picture is of {stage.film.mechanism.name!r}"
                )
            text = words(one)
            items = [x if x.joint == 0 else replace(x, joint=None, placement=pin.XYZQUATToSE3(
                poses[0, x.joint]).homogeneous @ x.placement) for x in parts]
        else:
            seconds, rows, how = moments(stage.film, own)
            text = f"another motion, {how}"
            items = [x if x.joint == 0 else replace(x, joint=None, track=Track(
                poses[rows, x.joint], None, seconds)) for x in parts]
        others.append((items, occupied(list(visuals), poses), text))
    return others


def ghosts(stage: Stage, shown: tuple[State | Motion, ...]) -> Layer:
    """Return other states and motions in the same place, half transparent."""
    others = others_of(stage, shown, "ghost")
    items = [replace(item, colour=(*item.colour[:3], OPACITY * item.colour[3]))
             for solids, _, _ in others for item in solids
             if item.joint is None]  # the ground is there already
    points = np.concatenate([np.zeros((0, 3)), *(corners for _, corners, _ in others)])
    legend = tuple(Entry(LABEL_COLOUR, f"faint: {text}") for _, _, text in others)
    return Layer(tuple(items), points, legend)


def side_by_side(stage: Stage, shown: tuple[State | Motion, ...], direction: Array) -> Layer:
    """Return other states and motions side by side with the first, which is the film itself.

    The direction (3,) is that from the middle to the camera.
    """
    others = others_of(stage, shown, "beside")
    corners = [occupied(list(stage.visuals), stage.poses), *(points for _, points, _ in others)]
    axes, n = axes_of_view(direction), len(corners)  # in rows and columns
    wide, high = SPACING * np.ptp(np.concatenate(corners) @ axes.T, axis=0)
    columns = min(range(1, n + 1), key=lambda c: max(c * wide / 4, math.ceil(n / c) * high / 3))
    row, column = np.divmod(np.arange(n), columns)
    steps = column[:, None] * wide * axes[0] - row[:, None] * high * axes[1]
    items = []
    for (solids, _, _), step in zip(others, steps[1:], strict=True):
        for item in solids:
            if item.track is None:
                items.append(replace(item, joint=None, placement=moved(step) @ item.placement))
                continue
            poses = item.track.poses + np.concatenate([step, np.zeros(4)])
            items.append(replace(item, track=item.track._replace(poses=poses)))
    placed = [points + step for points, step in zip(corners, steps, strict=True)]
    source = stage.film.source
    first = words(source) if isinstance(source, State) else "the motion"
    names = [first, *(text for _, _, text in others)]
    labels = []
    for name, points in zip(names, placed, strict=True):  # in the middle below each, as it is seen
        seen = points @ axes.T
        middle = (seen[:, 0].min() + seen[:, 0].max()) / 2
        depth = (points @ direction).mean()
        foot = np.array([middle, seen[:, 1].min()]) @ axes + depth * direction
        labels.append((name, foot))
    return Layer(tuple(items), np.concatenate(placed), labels=tuple(labels))


TOUCHING = (0.86, 0.08, 0.10, 1.0)
LINE = (0.10, 0.13, 0.17, 1.0)
CLEARANCE_BALL, CLEARANCE_ROD = 0.012, 0.005  # radius relative to the size of the scene
SWELL = 1.02  # red links are drawn over their own colours, so much larger
LINES = 1  # pairs that do not touch and are joined by a line: the nearest
WORKSPACE_BALL = 0.008  # radius relative to the size of the scene
MOST_BALLS = 6000  # points that are drawn, so that a page stays small
DEXTERITY_COLOURS: tuple[Colour, ...] = (  # from singular to even
    (0.27, 0.00, 0.33, 1.0), (0.23, 0.32, 0.55, 1.0), (0.13, 0.57, 0.55, 1.0),
    (0.37, 0.79, 0.38, 1.0), (0.99, 0.91, 0.15, 1.0))
BRANCH_END: Colour = (0.84, 0.37, 0.00, 1.0)
CORNERS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
FACES = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4],
                  [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
# radii, and a length, relative to the size of the scene
DESIGN_BALL, DESIGN_ROD, DESIGN_ARM = 0.014, 0.005, 0.10
TARGET = (0.08, 0.08, 0.10, 1.0)  # no part is black
AXES = ((0.80, 0.12, 0.12, 1.0), (0.10, 0.55, 0.15, 1.0), (0.12, 0.30, 0.80, 1.0))  # x, y, z
# a rod along z is turned so that z is x, y, z
TURNS = (np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], dtype=float),
         np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]], dtype=float), np.eye(3))


def clearances(stage: Stage, clearance: Clearance) -> Layer:
    """Return links that touch in red, lines between nearest points, and alarms."""
    film = stage.film
    if len(clearance.motion) <= int(film.rows[-1]) or not np.array_equal(
            clearance.motion.q[film.rows], film.q):
        raise SpatialPinError(
            f"mechanism {film.mechanism.name!r}: the clearance is that of another motion than the "
            "one shown; ask sp.clearance of this one")
    touching = [pair for pair in clearance.pairs if pair.contacts]
    nearest = [pair for pair in clearance.pairs if not pair.contacts][:LINES]
    items = [*_red_links(stage, clearance, touching)]
    for pair in (*touching, *nearest):
        items += _line(stage, pair, TOUCHING if pair.contacts else LINE)
    legend = [Entry(TOUCHING, "links that touch")] * bool(touching)
    legend += [Entry(LINE, f"least over the motion, {in_words(p)}: {length_words(p.distance)}")
               for p in nearest]
    alarms = []
    for pair in touching:  # how deep they overlap
        distances = pair.distances[film.rows]
        depth = np.where(distances <= clearance.tolerance, -distances, 0.0)
        size, unit = unit_of_length(float(np.abs(depth).max()) or 1.0)
        alarms.append(Readout(in_words(pair), depth / size, f" {unit}", 2, says=" overlap by "))
    return Layer(tuple(items), np.zeros((0, 3)), tuple(legend), tuple(alarms))


def _red_links(stage: Stage, clearance: Clearance, pairs: list[PairClearance]) -> list[Item]:
    """Return copies in red of links that touch, seen only as long as they do."""
    frames = stage.film.mechanism.model.frames
    rows = stage.film.rows
    is_red = {link: np.zeros(len(rows), dtype=bool) for pair in pairs for link in pair.links}
    for pair in pairs:
        for link in pair.links:
            is_red[link] |= pair.distances[rows] <= clearance.tolerance
    items = []
    for link, when in is_red.items():
        own = [v for v in stage.visuals if frames[v.parentFrame].name == link]
        scales = np.repeat(np.where(when, SWELL, 0.0)[:, None], 3, axis=1)
        for item in body_items(own, stage):
            poses = stage.poses[:, item.joint]
            turns = Rotation.from_quat(poses[:, 3:])
            positions = poses[:, :3] + turns.apply(item.placement[:3, 3])
            turned = (turns * Rotation.from_matrix(item.placement[:3, :3])).as_quat()
            items.append(Item(f"touching {link} {item.name}", item.solid, TOUCHING,
                              track=Track(np.concatenate([positions, turned], axis=1), scales)))
    return items


def _line(stage: Stage, pair: PairClearance, colour: tuple[float, ...]) -> list[Item]:
    """Return a line between the nearest points of two links, with a ball at either end."""
    a, b = (stage.seen(pair.points[stage.film.rows, k]) for k in (0, 1))
    name, size = f"clearance {in_words(pair)}", stage.size
    return [
        Item(name, rod(CLEARANCE_ROD * size), colour, track=rod_between(a, b), through=True),
        *(Item(f"{name} {k}", ball(CLEARANCE_BALL * size), colour, track=ball_at(p), through=True)
          for k, p in enumerate((a, b), start=1)),
    ]


# ---------------------------------------------------------------- workspace


def workspaces(stage: Stage, workspace: Workspace) -> Layer:
    """Return the points of a workspace in colours, and where the branch ends."""
    shown_one, own = stage.film.mechanism.name, workspace.mechanism.name
    if shown_one != own:
        raise SpatialPinError(f"mechanism {shown_one!r}: the workspace is that of another one, "
                              f"{own!r}; ask sp.workspace of this one")
    groups = []  # name, points, colour and words of each group
    rows = np.flatnonzero(workspace.reached & ~np.isnan(workspace.dexterity))
    rows = rows[:: -(-len(rows) // MOST_BALLS) or 1]
    values = workspace.dexterity[rows]
    top = float(values.max(initial=0.0)) or 1.0
    n = len(DEXTERITY_COLOURS)
    level = np.minimum((values / top * n).astype(int), n - 1)
    for k, colour in enumerate(DEXTERITY_COLOURS):
        if (level == k).any():
            low, high = (top * x / n for x in (k, k + 1))
            groups.append((f"workspace {k}", workspace.points[rows[level == k]], colour,
                           f"{workspace.frame}: dexterity {low:.2g} to {high:.2g}"))
    ends = workspace.boundary.points
    ends = ends[~np.isnan(ends).any(axis=1)]
    ends = ends[:: -(-len(ends) // MOST_BALLS) or 1]
    if len(ends):
        groups.append(("workspace ends", ends, BRANCH_END, f"{workspace.frame}: the branch ends"))
    items, legend = [], []
    shown: list[Array] = [np.zeros((0, 3))]
    for name, points, colour, text in groups:
        seen = stage.seen(points)
        corners = seen[:, None] + WORKSPACE_BALL * stage.size * CORNERS  # of octahedra, as one
        faces = FACES + 6 * np.arange(len(seen))[:, None, None]  # solid: balls would be slow
        octahedra = mg.TriangularMeshGeometry(corners.reshape(-1, 3), faces.reshape(-1, 3))
        items.append(Item(name, Solid(octahedra, faceted=True), colour))
        legend.append(Entry(colour, text))
        shown.append(seen)
    return Layer(tuple(items), np.concatenate(shown), tuple(legend))


# ---------------------------------------------------------------- goals of a design


def designs(stage: Stage, design: Design, drawn: tuple[str, ...]) -> Layer:
    """Return balls at target points, triads at target placements, and paths of their frames.

    Paths of the frames in `drawn` are there anyway.
    """
    shown = stage.film.mechanism
    if shown.name != design.mechanism.name or shown.dimensions != design.mechanism.dimensions:
        raise SpatialPinError(f"mechanism {shown.name!r}: the design has other dimensions than the "
                              "mechanism shown; show design.motion() or one of design.states")
    layers, frames = list[Layer](), list[str]()
    for k, met in enumerate(design.met):
        if isinstance(met.goal, PathGoal):
            seen = stage.seen(met.targets)
            balls = [Item(f"design {k} point {i}", ball(DESIGN_BALL * stage.size), TARGET,
                          placement=moved(point), through=True) for i, point in enumerate(seen)]
            words = f"target points of {met.goal.frame}"
            layers.append(Layer(tuple(balls), seen, (Entry(TARGET, words),)))
        elif isinstance(met.goal, PosesGoal):
            layers.append(_triads(stage, f"design {k}", met.goal, met.targets))
        else:
            continue
        frames.append(met.goal.frame)
    if len(stage.film.rows) > 1:
        layers.append(traces(stage, tuple(x for x in dict.fromkeys(frames) if x not in drawn)))
    return joined(layers)


def _triads(stage: Stage, name: str, goal: PosesGoal, placements: Array) -> Layer:
    """Return three rods at every placement, in the colours of x, y and z."""
    items = []
    for i, placement in enumerate(placements):
        for axis, colour, turn in zip("xyz", AXES, TURNS, strict=True):
            centre = moved(stage.seen(placement[:3, 3]))
            centre[:3, :3] = stage.upright @ placement[:3, :3] @ turn
            items.append(Item(f"{name} placement {i} {axis}",
                              rod(DESIGN_ROD * stage.size, 0.0, DESIGN_ARM * stage.size), colour,
                              placement=centre, through=True))
    legend = tuple(Entry(colour, f"{axis} of target placements of {goal.frame}")
                   for axis, colour in zip("xyz", AXES, strict=True))
    return Layer(tuple(items), stage.seen(placements[:, :3, 3]), legend)
