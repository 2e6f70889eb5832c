"""Curves of closures, what touches them, and where."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.curve_contacts import angles_of, contact_shape
from spatial_pin.mechanism.curves import curves_in
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.shapes import Solid, ball, mg, rod, tube
from spatial_pin.view.scene.stage import Item, Layer, Stage, ball_at

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
