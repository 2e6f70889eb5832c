"""Legs that nothing is asked of but the joint that makes them longer.

A leg hangs on a body by one pair and is closed to another body by a second pair; joints between
its links move, a slide mostly. Where these joints change nothing of the relation that a link with
those two pairs would stand for (`links`) but the length of its distance, the leg stands for a
distance of variable length: that of two frames on the leg's two ends, which then need no more
than its joints. The leg is left where it stands, welded to the body that it hangs on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.reduction.model.links import Pin, Place, Relation, Surroundings, relation
from spatial_pin.reduction.model.model import Model


class Leg(NamedTuple):
    """A leg and what it stands for.

    Attributes:
        joints: from the one that it hangs on to that of its last body; all but the first stay.
        closures: those by which it is closed: to another body, and to the body that it hangs on
            where its first joint is a floating one.
        pins: the pairs at its two ends, both as seen from its first link.
        made: closures instead of these pairs.
    """

    joints: tuple[int, ...]
    closures: tuple[Closure, ...]
    pins: tuple[Pin, Pin]
    made: list[Relation]


def leg_of(model: Model, closure: Closure) -> Leg | None:
    """Return the leg that a closure ends; None where there is none that stands for a distance."""
    for frame in closure.frames if len(closure.frames) == 2 else ():
        end = model.bodies.frame(frame)[0]
        chain = [int(j) for j in model.full.model.supports[end] if j in model.moving]
        for k in reversed(range(len(chain) - 1)):
            leg = _leg(model, closure, tuple(chain[k:]))
            if leg is not None:
                return leg
    return None


def _leg(model: Model, closure: Closure, joints: tuple[int, ...]) -> Leg | None:
    first, last = joints[0], joints[-1]
    own = model.closures_on(joints)
    is_free = model.full.pairs[first - 1] == "floating"
    if first in model.influence.needed or not model.hangs_free(joints) or any(
            len(c.joined) != 1 or c.joints or c.equations for c in own) \
            or closure not in own or len(own) != 1 + is_free:
        return None
    b = model.bodies.closing_pin(closure, last)
    if is_free:
        (other,) = (c for c in own if c is not closure)
        if first not in (model.bodies.frame(f)[0] for f in other.frames):
            return None
        a = model.bodies.closing_pin(other, first)
    else:
        a = model.bodies.tree_pin(first)
    if a.body == b.body or {a.body, b.body} & set(joints):
        return None
    made = _relation(a, b, (first, last), model.around)
    if made is None:
        return None
    return Leg(joints, own, (a, b.seen_from(model.around.placements(first, last)[0])), made)


def _relation(
    a: Pin, b: Pin, bodies: tuple[int, int], around: Surroundings
) -> list[Relation] | None:
    """Return the closures that a leg stands for, one of them a distance that changes.

    Args:
        a: the pin at its first end.
        b: the pin at its last end.
        bodies: joints whose bodies they are on; the joints between these stay.
        around: the mechanism, in configurations in which these joints stand anywhere.

    Returns:
        The closures; None where there are none or more than a length changes.
    """
    moved = around.placements(*bodies)
    tries = [relation(a, b.seen_from(placement), around) for placement in moved]
    first = tries[0]
    if first is None or any(t is None or len(t) != len(first) for t in tries):
        return None
    made: list[Relation] = []
    for same in zip(*(t for t in tries if t is not None), strict=True):
        if any(not _is_alike(same[0], other, around.length) for other in same):
            return None
        lengths = [r.length for r in same]
        if max(lengths) - min(lengths) <= TOLERANCES.tight * around.length:
            made.append(same[0])
            continue
        between = [_ends(a, bodies, r, placement) for r, placement in zip(same, moved, strict=True)]
        for places in between:
            if any(np.abs(p.origin - o.origin).max() > TOLERANCES.tight * around.length
                   for p, o in zip(places, between[0], strict=True)):
                return None
        made.append(same[0]._replace(between=between[0]))
    return made if any(r.between for r in made) else None


def _is_alike(one: Relation, other: Relation, length: float) -> bool:
    """Whether two relations differ in nothing but their lengths."""
    return one.type == other.type and all(
        p.body == o.body and np.abs(p.origin - o.origin).max() <= TOLERANCES.tight * length
        and np.abs(p.z - o.z).max() <= TOLERANCES.tight
        for p, o in zip(one.places, other.places, strict=True))


def _ends(a: Pin, bodies: tuple[int, int], made: Relation, placement: pin.SE3) -> tuple[Place, ...]:
    """Return the ends of a distance on the bodies of a leg, in the order of its places."""
    return tuple(
        Place(bodies[0], end) if place.body == a.body else Place(bodies[1], placement.actInv(end))
        for place, end in zip(made.places, made.ends, strict=True))
