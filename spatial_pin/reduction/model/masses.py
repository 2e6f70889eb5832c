"""The masses of links that go: none, of no account, or lumped at the centres of their pairs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.resistance import resists
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.reduction.model.links import Pin, Place
from spatial_pin.reduction.model.model import Model


def may_go(model: Model, i: int, pins: list[Pin]) -> bool:
    """Whether the body of joint i is massless, or its mass does not matter or is lumped."""
    if not model.dynamics or is_massless(model, i):
        return True
    if resists(model.full, i):
        return False
    balls = all(p.kind in ("spherical", "universal") for p in pins)
    return model.lump and balls and _lumped(model, i, pins)


def is_massless(model: Model, i: int) -> bool:
    """Whether no motion of the body of joint i takes a force."""
    body = _inertia(model, i)
    return not (body.mass or np.any(body.inertia) or resists(model.full, i))


def _inertia(model: Model, i: int) -> pin.Inertia:
    """Return the inertia of the rigid body that joint i moves, in its axes."""
    total = pin.Inertia.Zero()
    for j in (i, *model.welded):
        mover, on = model.bodies.of(j)
        if mover == i:
            total += on.act(model.full.model.inertias[j])
    return total


def _lumped(model: Model, i: int, pins: list[Pin]) -> bool:
    """Lump a body's mass at the centres of its two pairs, if its centre is between them."""
    body, link = _inertia(model, i), model.link(i)
    a, b = pins[0].own_centre, pins[1].own_centre
    d = b - a
    length = float(np.linalg.norm(d))
    if length == 0.0:
        return False
    part = float((body.lever - a) @ d) / length**2
    if not 0.0 <= part <= 1.0:
        return False
    n = d / length
    aside = float(np.linalg.norm(body.lever - a - part * d))
    spin = float(n @ body.inertia @ n)
    across = 0.5 * (float(np.trace(body.inertia)) - spin)
    lumped = body.mass * part * (1.0 - part) * length**2
    for place, mass in zip(pins, ((1.0 - part) * body.mass, part * body.mass), strict=True):
        if mass > 0.0 and place.body:
            model.masses.append((f"{link}_mass", Place(place.body, place.centre), mass))
    model.notes.append((
        "inertia", link,
        f"{body.mass:.6g} kg lumped at the centres of its two pairs; inertia across the rod "
        f"becomes {lumped:.4g} instead of {across:.4g} kg·m², about it 0 instead of {spin:.4g}"
        + f"; the centre of mass moves {aside:.3g} m, square to the line between them" * (
            aside > TOLERANCES.nothing * length)))
    return True
