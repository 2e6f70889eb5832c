"""Replacing links without outputs by equations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure
from spatial_pin.mechanism.resistance import resists
from spatial_pin.numerics.linalg import Array, null_space
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.reduction.building import Omission, ReducedModel, built
from spatial_pin.reduction.relations import (
    BodyFrame,
    Pin,
    Relation,
    Surroundings,
    WeldedBodies,
    open_configurations,
    reach,
    relation,
)


def drop_equations(model: ReducedModel) -> None:
    """Leave out equations whose derivative is zero wherever the joints are put.

    Axes of closures are turned so that as many as can be go.
    """
    made = built(model)
    every = _slopes(made)
    for closure in made.closures:
        if len(closure.frames) != 2 or closure.joints or closure.equations is not None:
            continue
        slopes = every[closure.name]
        turn = _turn(closure, slopes)
        if turn is not None:
            model.turns[closure.name] = turn
            slopes = _slopes(built(model))[closure.name]
        needed = tuple(np.flatnonzero(np.abs(slopes).max(axis=1) > TOLERANCES.tight).tolist())
        if len(needed) == len(slopes):
            model.turns.pop(closure.name, None)
            continue
        model.equations[closure.name] = needed
        gone = len(slopes) - len(needed)
        model.notes.append(Omission(
            "equations", closure.name,
            f"{gone} of {len(slopes)} hold wherever its joints stand"
            + "; nothing is left of it" * (not needed)))


def _slopes(made: Mechanism) -> dict[str, Array]:
    """Return the derivatives of the equations of every closure, side by side at some places."""
    with loops_of(made) as evaluation:
        jacobians = []
        for q in open_configurations(made, made.neutral):
            evaluation.update(q)
            jacobians.append(evaluation.jacobian[: evaluation.constraints.n_closure].copy())
        closure_of = np.array(evaluation.constraints.closure_of)
    stacked = np.hstack(jacobians)
    return {c.name: stacked[closure_of == c.name] for c in made.closures}


def _turn(closure: Closure, slopes: Array) -> NDArray[np.float64] | None:
    """Return the turn of a closure's axes that brings one into the normal of its loop's plane."""
    count = {"prismatic": 2, "cylindrical": 2, "weld": 3, "spherical": 3}.get(closure.type)
    if count is None or np.abs(slopes[:count]).max(axis=1).min() <= TOLERANCES.tight:
        return None
    normals = null_space(slopes[:count].T, TOLERANCES.closed)
    if len(normals) != 1:
        return None
    n = np.zeros(3)
    n[:count] = normals[0]
    if count == 2:  # z is the pair's own axis
        return np.column_stack([n, np.cross([0.0, 0.0, 1.0], n), [0.0, 0.0, 1.0]])
    x = np.cross(n, np.eye(3)[int(np.argmin(np.abs(n)))])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(n, x), n])


# A leg's joints, from the one that it hangs on to that of its last body: all but the first stay;
# the closures by which it is closed, to another body and, where its first joint is a floating one,
# to the body that it hangs on; the pairs at its two ends, both as seen from its first link; and the
# closures instead of these pairs.
Leg = tuple[tuple[int, ...], tuple[Closure, ...], tuple[Pin, Pin], list[Relation]]


def leg_of(model: ReducedModel, closure: Closure) -> Leg | None:
    """Return the leg that a closure ends; None where there is none that stands for a distance.

    A leg hangs on a body by one pair and is closed to another body by a second pair; joints between
    its links move, a slide mostly. Where these change nothing of the relation that a link with
    those two pairs would stand for but the length of its distance, the leg stands for a distance of
    variable length: that of two frames on its ends, which then need no more than its joints. It is
    left where it stands, welded to the body that it hangs on.
    """
    chains = []
    for frame in closure.frames if len(closure.frames) == 2 else ():
        end = model.bodies.frame(frame)[0]
        chain = [int(j) for j in model.full.model.supports[end] if j in model.moving]
        chains += [tuple(chain[k:]) for k in reversed(range(len(chain) - 1))]
    for joints in chains:
        first, last = joints[0], joints[-1]
        own = model.closures_on(joints)
        is_free = model.full.pairs[first - 1] == "floating"
        if first in model.influence.needed or not model.hangs_free(joints) or any(
                len(c.joined) != 1 or c.joints or c.equations for c in own) \
                or closure not in own or len(own) != 1 + is_free:
            continue
        b = model.bodies.closing_pin(closure, last)
        if is_free:
            (other,) = (c for c in own if c is not closure)
            if first not in (model.bodies.frame(f)[0] for f in other.frames):
                continue
        a = model.bodies.closing_pin(other, first) if is_free else model.bodies.tree_pin(first)
        if a.body == b.body or {a.body, b.body} & set(joints):
            continue
        made = _relation(a, b, (first, last), model.around)
        if made is not None:
            return joints, own, (a, b.seen_from(model.around.placements(first, last)[0])), made
    return None


def _relation(
    a: Pin, b: Pin, bodies: tuple[int, int], around: Surroundings
) -> list[Relation] | None:
    """Return the closures that a leg stands for, one of them a distance that changes.

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
        for other in same:  # they may differ in nothing but their lengths
            if other.type != same[0].type or any(
                    p.body != o.body
                    or not np.abs(p.origin - o.origin).max() <= TOLERANCES.tight * around.length
                    or not np.abs(p.z - o.z).max() <= TOLERANCES.tight
                    for p, o in zip(same[0].frames, other.frames, strict=True)):
                return None
        lengths = [r.length for r in same]
        if max(lengths) - min(lengths) <= TOLERANCES.tight * around.length:
            made.append(same[0])
            continue
        between = [_ends(a, bodies, r, placement) for r, placement in zip(same, moved, strict=True)]
        for frames in between:
            if any(np.abs(p.origin - o.origin).max() > TOLERANCES.tight * around.length
                   for p, o in zip(frames, between[0], strict=True)):
                return None
        made.append(same[0]._replace(between=between[0]))
    return made if any(r.between for r in made) else None


def _ends(
    a: Pin, bodies: tuple[int, int], made: Relation, placement: pin.SE3
) -> tuple[BodyFrame, ...]:
    """Return the ends of a distance on the bodies of a leg, in the order of its places."""
    return tuple(
        BodyFrame(bodies[0], end) if frame.body == a.body
        else BodyFrame(bodies[1], placement.actInv(end))
        for frame, end in zip(made.frames, made.ends, strict=True))


def may_go(model: ReducedModel, i: int, pins: list[Pin]) -> bool:
    """Whether the body of joint i is massless, or its mass does not matter or is lumped.

    It is lumped at the centres of its two pairs, if its own centre is between them.
    """
    if not model.dynamics or is_massless(model, i):
        return True
    balls = all(p.kind in ("spherical", "universal") for p in pins)
    if resists(model.full, i) or not (model.lump and balls):
        return False
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
    for frame, mass in zip(pins, ((1.0 - part) * body.mass, part * body.mass), strict=True):
        if mass > 0.0 and frame.body:
            model.masses.append((f"{link}_mass", BodyFrame(frame.body, frame.centre), mass))
    model.notes.append(Omission(
        "inertia", link,
        f"{body.mass:.6g} kg lumped at the centres of its two pairs; inertia across the rod "
        f"becomes {lumped:.4g} instead of {across:.4g} kg·m², about it 0 instead of {spin:.4g}"
        + f"; the centre of mass moves {aside:.3g} m, square to the line between them" * (
            aside > TOLERANCES.nothing * length)))
    return True


def is_massless(model: ReducedModel, i: int) -> bool:
    """Whether no motion of the body of joint i takes a force."""
    body = _inertia(model, i)
    return not (body.mass or np.any(body.inertia) or resists(model.full, i))


def _inertia(model: ReducedModel, i: int) -> pin.Inertia:
    """Return the inertia of the rigid body that joint i moves, in its axes."""
    total = pin.Inertia.Zero()
    for j in (i, *model.welded):
        mover, on = model.bodies.of(j)
        if mover == i:
            total += on.act(model.full.model.inertias[j])
    return total


def replace_links(model: ReducedModel) -> None:
    """Replace links with two pairs, and legs, until none is left to replace."""
    replaced = True
    while replaced:
        replaced = any(_replace_link(model, i) for i in sorted(model.moving, reverse=True)) \
            or any(_replace_leg(model, c) for c in model.closures if c.frames)


def _replace_link(model: ReducedModel, i: int) -> bool:
    """Replace the link of joint i if it has two pairs with a relation."""
    if i not in model.moving or i in model.influence.needed or not model.hangs_free((i,)):
        return False
    own = model.closures_on((i,))
    is_free = model.full.pairs[i - 1] == "floating"
    if len(own) != (2 if is_free else 1) or any(
            len(c.joined) != 1 or c.joints or c.equations for c in own):
        return False
    pins = [model.bodies.closing_pin(c, i) for c in own]
    if not is_free:
        pins.insert(0, model.bodies.tree_pin(i))
    if pins[0].body == pins[1].body or not may_go(model, i, pins):
        return False
    made = relation(pins[0], pins[1], model.around)
    if made is None:
        return False
    _record(model, "link", i, pins, own, made)
    gone = {j for j in (*model.moving, *model.welded)
            if i in [int(k) for k in model.full.model.supports[j]]}
    model.moving -= gone
    model.welded -= gone
    model.closures = [c for c in model.closures if c not in own]
    return True


def _replace_leg(model: ReducedModel, closure: Closure) -> bool:
    """Replace the leg that a closure ends if it is a distance of variable length."""
    leg = leg_of(model, closure)
    if leg is None:
        return False
    joints, closures, pins, made = leg
    if model.dynamics and not all(is_massless(model, i) for i in joints):
        return False
    _record(model, "leg", joints[0], pins, closures, made, joints[1:])
    model.moving.remove(joints[0])
    model.welded.add(joints[0])
    model.lengthening.update(joints)
    model.bodies = WeldedBodies(model.full, model.q, frozenset(model.welded))
    model.closures = [c for c in model.closures if c not in closures]
    return True


def _record(
    model: ReducedModel, what: str, joint: int, pins: Sequence[Pin], own: Sequence[Closure],
    made: list[Relation], inner: Sequence[int] = (),
) -> None:
    """Record the replacement of a link or leg by relations."""
    link, names = model.link(joint), model.full.model.names
    taken = {c.name for c in model.closures} | {n for n, _ in model.relations}
    for k, one in enumerate(made):
        name = link if not k else f"{link}_{one.type}"
        while name in taken:
            name += "_"
        taken.add(name)
        model.relations.append((name, one))
    others = " and ".join(repr(names[i]) for i in inner)
    words = " and ".join(_words(one, others, len(inner)) for one in made)
    closed = " and ".join(repr(c.name) for c in own)
    model.notes.append(Omission(what, link, (
        f"its pairs ({pins[0].kind} and {pins[1].kind}; joint {names[joint]!r}, closure "
        f"{closed}) stand for one relation: {words}{reach(*pins)}")))


def _words(made: Relation, others: str, count: int) -> str:
    """Return a relation in words, and the joints that change it."""
    kind = made.type.replace("_", " ")
    if made.between:
        return f"{kind} that {others} alone change{'s' * (count == 1)}"
    return f"{kind} {made.length:.9g} m" if made.length else kind
