"""A mechanism itself: bodies as visuals or sticks, springs, centres of mass, curves, contacts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import coal
import numpy as np
import pinocchio as pin

from spatial_pin.assembly.curve_contacts import angles_of, contact_shape
from spatial_pin.errors import warn
from spatial_pin.mechanism.curves import curves_in
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.view.scene.shapes import Solid, ball, coloured, mg, rod, solid, tube
from spatial_pin.view.scene.stage import Entry, Item, Layer, Stage, ball_at, rod_between

# bodies without a colour of their own: steel grey ground, then colours of Okabe and Ito, and wine
# instead of their purple, which is this grey to who cannot tell red from green
GROUND_COLOUR = (0.62, 0.66, 0.70, 1.0)
BODY_COLOURS = (
    (0.835, 0.369, 0.000, 1.0),
    (0.000, 0.447, 0.698, 1.0),
    (0.000, 0.620, 0.451, 1.0),
    (0.902, 0.624, 0.000, 1.0),
    (0.533, 0.133, 0.333, 1.0),
    (0.337, 0.706, 0.914, 1.0),
)
THICKNESS = 0.013  # radius of a stick relative to the longest
SPREAD = 0.4  # how much thicker the thickest is: sticks of different bodies may coincide
FLOATING = pin.JointModelFreeFlyer().shortname()
GOLDEN = 0.5 * (5**0.5 - 1)  # multiples of it never come together again, but for whole numbers
WIRE, COIL = 0.006, 0.03  # radius of wire and coil relative to the size of the scene
COIL_TURNS, COIL_POINTS = 8, 14  # turns of a coil, points to a turn
STRAIGHT_END = 0.12  # part of the length at each end that is straight
SPRING_COLOUR = (0.30, 0.33, 0.37, 1.0)
MARK = 0.026  # radius of a mark relative to the size of the scene
DARK, LIGHT = (0.08, 0.09, 0.11, 1.0), (0.97, 0.97, 0.97, 1.0)
FACETS = 6  # along the edge of an octant: round to the eye at that size


def colour(visual: pin.GeometryObject) -> tuple[float, ...]:
    """Return the colour (red, green, blue, opacity) of a geometry object, 0 to 1 each."""
    if visual.overrideMaterial:
        return tuple(float(x) for x in np.clip(visual.meshColor, 0.0, 1.0))
    if visual.parentJoint == 0:
        return GROUND_COLOUR
    return BODY_COLOURS[(visual.parentJoint - 1) % len(BODY_COLOURS)]


def link_of(visual: pin.GeometryObject, model: pin.Model) -> str:
    """Return the link of a geometry object; the first of its joint if it names none.

    The sticks of a skeleton name none.
    """
    if visual.parentFrame < model.nframes:  # the largest number means none
        own = model.frames[visual.parentFrame]
        if own.type == pin.FrameType.BODY and own.parentJoint == visual.parentJoint:
            return str(own.name)
    return next((str(f.name) for f in model.frames
                 if f.type == pin.FrameType.BODY and f.parentJoint == visual.parentJoint),
                str(model.names[visual.parentJoint]))


def body_items(visuals: Sequence[pin.GeometryObject], stage: Stage) -> tuple[Item, ...]:
    """Return every geometry object that can be drawn, fixed to its joint; warn of the others."""
    items, model = [], stage.film.mechanism.model
    for k, visual in enumerate(visuals):
        joint, placement = int(visual.parentJoint), visual.placement.homogeneous
        name, own, link = f"{k} {visual.name}", colour(visual), link_of(visual, model)
        parts = coloured(visual)
        items += [Item(f"{name} part {i}", part, painted or own, joint, placement, called=link)
                  for i, (part, painted) in enumerate(parts)]
        drawn = None if parts else solid(visual, stage.size)
        if drawn is not None:
            items.append(Item(name, drawn, own, joint, placement, called=link))
        elif not parts:
            empty = type(visual.geometry).__name__
            warn(f"{visual.name!r} is not shown: it is an empty {empty}")
    return tuple(items)


def bodies(stage: Stage) -> Layer:
    """Return the bodies of a film."""
    return Layer(body_items(stage.visuals, stage))


# ---------------------------------------------------------------- sticks


def with_skeleton(
    model: pin.Model, geometry: pin.GeometryModel | None, wanted: bool | None
) -> list[pin.GeometryObject]:
    """Return the visuals of a model, and the sticks of its skeleton.

    Args:
        model: the model.
        geometry: its visuals.
        wanted: whether bodies are drawn as sticks; None: those that bring nothing of their own. Of
            these a body without extent and mass is nothing to be seen, and so is the ground below
            bases that float: no pair joins it to them.
    """
    own = [] if geometry is None else list(geometry.geometryObjects)
    if wanted or (wanted is None and not own):
        return [*own, *skeleton(model).geometryObjects]
    drawn = {int(visual.parentJoint) for visual in own}
    if all(model.joints[j].shortname() == FLOATING for j in model.children[0]):
        drawn.add(0)
    missing = [j for j in range(model.njoints) if j not in drawn]
    sticks = list(skeleton(model, missing).geometryObjects) if wanted is None else []
    return own + [s for s in sticks
                  if isinstance(s.geometry, coal.Capsule) or model.inertias[s.parentJoint].mass > 0]


def skeleton(model: pin.Model, joints: Iterable[int] | None = None) -> pin.GeometryModel:
    """Return the sticks of some joints' bodies, default all; a body without extent is a ball."""
    placed = [(model.parents[j], model.jointPlacements[j]) for j in range(1, model.njoints)]
    placed += [(f.parentJoint, f.placement) for f in model.frames]
    ends = [(int(j), M.translation.copy()) for j, M in placed]  # the next joints, and every frame
    longest = max((float(np.linalg.norm(p)) for _, p in ends), default=0.0) or 1.0
    geometry = pin.GeometryModel()
    for j in range(model.njoints) if joints is None else joints:
        thickness = THICKNESS * longest * (1.0 + SPREAD * (GOLDEN * j % 1.0))
        points: list[Array] = []  # those that are further from 0, and from those before
        for joint, p in ends:
            if joint == j and min(np.linalg.norm(p - other) for other in (
                    np.zeros(3), *points)) > TOLERANCES.half_precision * longest:
                points.append(p)
        for k, p in enumerate(points):
            length = float(np.linalg.norm(p))
            turn = pin.Quaternion.FromTwoVectors(pin.ZAxis, p / length).matrix()
            geometry.addGeometryObject(pin.GeometryObject(
                f"{model.names[j]} stick {k}", j, 0, pin.SE3(turn, p / 2),
                coal.Capsule(thickness, length)))
        if not points:
            ball = coal.Sphere(1.6 * thickness)
            name = f"{model.names[j]} joint"
            geometry.addGeometryObject(pin.GeometryObject(name, j, 0, pin.SE3.Identity(), ball))
    return geometry


# ---------------------------------------------------------------- springs, centres of mass


def coil(length: float, size: float) -> Solid:
    """Return a coil from 0 to 1 along z, its wire round when it is stretched to a length [m]."""
    angle = 2 * np.pi * COIL_TURNS * np.linspace(0.0, 1.0, COIL_TURNS * COIL_POINTS + 1)
    z = np.linspace(STRAIGHT_END, 1.0 - STRAIGHT_END, len(angle))
    turns = np.stack([COIL * size * np.cos(angle), COIL * size * np.sin(angle), z * length], 1)
    ends = [[0.0, 0.0, 0.0], [0.0, 0.0, STRAIGHT_END * length]]
    last = [[0.0, 0.0, length - z] for z in (STRAIGHT_END * length, 0.0)]
    path = np.concatenate([ends, turns, last])
    return Solid(tube(path, WIRE * size, segments=6), np.diag([1.0, 1.0, 1.0 / length, 1.0]))


def springs(stage: Stage) -> Layer:
    """Return every spring of the mechanism that is between two frames, and its rods.

    A rod is a closure of type `distance`; one that is a body, too, is seen as that.
    """
    items: list[Item] = []
    points: list[Array] = [np.zeros((0, 3))]
    for spring in stage.film.mechanism.springs:
        if not spring.frames:
            continue
        a, b = stage.origins(spring.frames)
        length = float(np.linalg.norm(b - a, axis=1).mean())
        drawn = coil(length or stage.size, stage.size)
        items.append(Item(f"spring {spring.name}", drawn, SPRING_COLOUR, track=rod_between(a, b)))
        points += [a, b]
    for closure in stage.film.mechanism.closures:
        if closure.type == "distance":
            a, b = stage.origins(closure.frames)
            items.append(Item(f"rod {closure.name}", rod(WIRE * stage.size), SPRING_COLOUR,
                              track=rod_between(a, b)))
            points += [a, b]
    return Layer(tuple(items), np.concatenate(points))


def _quarters(parity: int, radius: float) -> Solid:
    """Return every other eighth of a ball."""
    i, j = np.meshgrid(np.arange(FACETS + 1), np.arange(FACETS + 1), indexing="ij")
    polar, turn = (np.pi / 2 / FACETS * x.ravel() for x in (i, j))
    octant = np.stack(
        [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=1)
    a = (np.arange(FACETS)[:, None] * (FACETS + 1) + np.arange(FACETS)).ravel()
    b, c, d = a + 1, a + FACETS + 1, a + FACETS + 2
    faces = np.concatenate([np.stack([a, c, d], axis=1), np.stack([a, d, b], axis=1)])
    signs = [(x, y, z) for x in (1, -1) for y in (1, -1) for z in (1, -1) if x * y * z == parity]
    points = np.concatenate([octant * sign for sign in signs])
    shifted = np.concatenate([faces[:, ::parity] + k * len(octant) for k in range(len(signs))])
    return Solid(mg.TriangularMeshGeometry(radius * points, shifted))


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
        centre = placement.homogeneous.copy()
        centre[:3, 3] = placement.act(inertia.lever)
        points.append(stage.points(joint, centre[:3, 3]))
        name = f"centre of mass, {link}"
        items.append(Item(name, dark, DARK, joint, centre, through=True))
        items.append(Item(f"{name}, light", light, LIGHT, joint, centre, through=True))
    legend = (Entry(DARK, "centres of mass"),) if items else ()
    return Layer(tuple(items), np.concatenate(points), legend)


# ---------------------------------------------------------------- curves and contacts

CURVE = (0.17, 0.19, 0.22, 1.0)
FOLLOWER = (0.50, 0.53, 0.57, 1.0)
CONTACT = (0.84, 0.37, 0.0, 1.0)
# Radius of a curve and of a point of contact, by the size of the scene.
CURVE_WIDTH, POINT = 0.006, 0.016
FACE_MARGIN = 0.1  # of a line or helix, beyond where its point comes to, likewise


def contacts(stage: Stage) -> Layer:
    """Return the curve of every cam and track, its follower and the point of contact."""
    items: list[Item] = []
    held: list[Array] = [np.zeros((0, 3))]
    mechanism = stage.film.mechanism
    for closure in mechanism.closures:
        if not curves_in(closure.numbers):
            continue
        (one, on_1), (two, on_2) = map(mechanism.frame_on_joint, closure.frames)
        first, second = (stage.rotations(j, m.rotation) for j, m in ((one, on_1), (two, on_2)))
        start, end = stage.origins(closure.frames)
        seen = np.einsum("nij,ni->nj", first, end - start)
        turned = np.einsum("nji,njk->nik", first, second)
        curve = curves_in(closure.numbers)[0]
        along = (seen - curve.centre) @ curve.axes[:, 2]
        room = FACE_MARGIN * stage.size
        reach = float(along.min()) - room, float(along.max()) + room
        title = f"{closure.name}: {closure.type}"
        for of, joint, on, name in zip(curves_in(closure.numbers), (one, two), (on_1, on_2),
                                       ("curve", "second curve"), strict=False):
            path = of.points(reach)
            solid = Solid(tube(path, CURVE_WIDTH * stage.size))
            items.append(Item(f"{name} {closure.name}", solid, CURVE, joint, on.homogeneous,
                              through=True, called=title))
            held += [stage.points(joint, on.act(p)) for p in path[:: max(1, len(path) // 8)]]
        near = angles_of(mechanism, closure, stage.film.motion.angles, len(seen))
        touched = contact_shape(closure, (seen, turned), near).point
        if np.isfinite(touched).all():
            world = start + np.einsum("nij,nj->ni", first, touched)
            items.append(Item(f"contact {closure.name}", ball(POINT * stage.size), CONTACT,
                              track=ball_at(world), through=True, called=f"contact {closure.name}"))
        follower = closure.numbers.get("follower")
        if follower is not None:
            items += _follower(stage, title, closure, (two, on_2), turned, touched - seen)
    return Layer(tuple(items), np.concatenate(held))


def _follower(
    stage: Stage, title: str, closure: Closure, on: tuple[int, pin.SE3], turned: Array,
    touched: Array,
) -> list[Item]:
    """Return the face or the roller of a cam's follower, none of a knife edge.

    Frame 2 is on a joint; `turned` (N, 3, 3) is its rotation in frame 1, `touched` (N, 3) the point
    of contact from its origin in axes of frame 1 [m].
    """
    follower, (joint, at) = closure.numbers["follower"], on
    normal = turned[0].T @ curves_in(closure.numbers)[0].axes[:, 2]  # of the plane, in frame 2
    pose = at.homogeneous.copy()
    if follower.flat is not None:
        x, room = follower.flat, FACE_MARGIN * stage.size
        pose[:3, :3] = at.rotation @ np.column_stack([x, normal, np.cross(x, normal)])
        along = np.einsum("nji,nj->ni", turned, touched) @ np.cross(x, normal)
        low, high = float(along.min()) - room, float(along.max()) + room
        pose[:3, 3] += 0.5 * (low + high) * pose[:3, 2]
        face = Solid(mg.Box([CURVE_WIDTH * stage.size, room, high - low]))
        return [Item(f"face {closure.name}", face, FOLLOWER, joint, pose, called=title)]
    if not follower.radius:
        return []
    pose[:3, :3] = at.rotation @ axes_from_z(normal)
    half = 2.0 * CURVE_WIDTH * stage.size
    roller = rod(follower.radius, -half, half)
    return [Item(f"roller {closure.name}", roller, FOLLOWER, joint, pose, called=title)]
