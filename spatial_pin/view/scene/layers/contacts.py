"""Curves of closures, what touches them, and where."""

from __future__ import annotations

import numpy as np

from spatial_pin.assembly.contact_places import contact_shape
from spatial_pin.mechanism.pairs import axes_from_z
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
        if "curve" not in closure.numbers:
            continue
        curve, follower = closure.numbers["curve"], closure.numbers.get("follower")
        (one, on_1), (two, on_2) = map(mechanism.frame_on_joint, closure.frames)
        first, second = (stage.rotations(j, m.rotation) for j, m in ((one, on_1), (two, on_2)))
        start = stage.points(one, on_1.translation)
        seen = np.einsum("nij,ni->nj", first, stage.points(two, on_2.translation) - start)
        turned = np.einsum("nji,njk->nik", first, second)
        along = (seen - curve.centre) @ curve.axes[:, 2]
        room = FACE_MARGIN * stage.size
        path = curve.points((float(along.min()) - room, float(along.max()) + room))
        title = f"{closure.name}: {closure.type}"
        solid = Solid(tube(path, CURVE_WIDTH * stage.size))
        items.append(Item(f"curve {closure.name}", solid, CURVE, one,
                          on_1.homogeneous, through=True, called=title))
        held += [stage.points(one, on_1.act(p)) for p in path[:: max(1, len(path) // 8)]]
        touched = contact_shape(closure, (seen, turned)).point
        if np.isfinite(touched).all():
            world = start + np.einsum("nij,nj->ni", first, touched)
            items.append(Item(f"contact {closure.name}", ball(POINT * stage.size), CONTACT,
                              track=ball_at(world), through=True, called=f"contact {closure.name}"))
        normal = turned[0].T @ curve.axes[:, 2]  # of the plane, in frame 2
        place = on_2.homogeneous.copy()
        if follower is not None and follower.flat is not None:
            x = follower.flat
            place[:3, :3] = on_2.rotation @ np.column_stack([x, normal, np.cross(x, normal)])
            at = np.einsum("nji,nj->ni", turned, touched - seen) @ np.cross(x, normal)
            low, high = float(at.min()) - room, float(at.max()) + room
            place[:3, 3] += 0.5 * (low + high) * place[:3, 2]
            face = Solid(mg.Box([CURVE_WIDTH * stage.size, room, high - low]))
            items.append(Item(f"face {closure.name}", face, FOLLOWER, two, place, called=title))
        elif follower is not None and follower.radius:
            place[:3, :3] = on_2.rotation @ axes_from_z(normal)
            half = 2.0 * CURVE_WIDTH * stage.size
            items.append(Item(f"roller {closure.name}", rod(follower.radius, -half, half), FOLLOWER,
                              two, place, called=title))
    return Layer(tuple(items), np.concatenate(held))
