"""Links that nothing is asked of are replaced by the equations that they stand for."""

from __future__ import annotations

from collections.abc import Sequence

from spatial_pin.mechanism.parts import Closure
from spatial_pin.reduction.model.legs import leg_of
from spatial_pin.reduction.model.links import Bodies, Pin, Relation, reach, relation
from spatial_pin.reduction.model.masses import is_massless, may_go
from spatial_pin.reduction.model.model import Model


def replace_links(model: Model) -> None:
    """Replace links of two pairs, and legs, until none can be replaced any more."""
    found = True
    while found:
        found = any(_replace_link(model, i) for i in sorted(model.moving, reverse=True)) \
            or any(_replace_leg(model, c) for c in model.closures if c.frames)


def _replace_link(model: Model, i: int) -> bool:
    """Replace the link of joint i, if it has two pairs that stand for relations."""
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


def _replace_leg(model: Model, closure: Closure) -> bool:
    """Replace the leg that a closure ends, if it stands for a distance of variable length."""
    leg = leg_of(model, closure)
    if leg is None or (model.dynamics and not all(is_massless(model, i) for i in leg.joints)):
        return False
    _record(model, "leg", leg.joints[0], leg.pins, leg.closures, leg.made, leg.joints[1:])
    model.moving.remove(leg.joints[0])
    model.welded.add(leg.joints[0])
    model.lengthening.update(leg.joints)
    model.bodies = Bodies(model.full, model.q, frozenset(model.welded))
    model.closures = [c for c in model.closures if c not in leg.closures]
    return True


def _record(
    model: Model, what: str, joint: int, pins: Sequence[Pin], own: Sequence[Closure],
    made: list[Relation], inner: Sequence[int] = (),
) -> None:
    """Take note of a link or leg, hung on a joint, that is replaced by relations."""
    link, names = model.link(joint), model.full.model.names
    _relate(model, link, made)
    others = " and ".join(repr(names[i]) for i in inner)
    said = " and ".join(_words(one, others, len(inner)) for one in made)
    closed = " and ".join(repr(c.name) for c in own)
    model.notes.append((what, link, (
        f"its pairs ({pins[0].kind} and {pins[1].kind}; joint {names[joint]!r}, closure "
        f"{closed}) stand for one relation: {said}{reach(*pins)}")))


def _relate(model: Model, link: str, made: list[Relation]) -> None:
    taken = {c.name for c in model.closures} | {n for n, _ in model.relations}
    for k, one in enumerate(made):
        name = link if not k else f"{link}_{one.type}"
        while name in taken:
            name += "_"
        taken.add(name)
        model.relations.append((name, one))


def _words(made: Relation, others: str, count: int) -> str:
    """Return a relation in words, and the joints that change it."""
    kind = made.type.replace("_", " ")
    if made.between:
        return f"{kind} that {others} alone change{'s' * (count == 1)}"
    return f"{kind} {made.length:.9g} m" if made.length else kind
