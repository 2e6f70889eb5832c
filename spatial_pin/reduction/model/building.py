"""The reduced mechanism as it stands, made of its parts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from spatial_pin.mechanism.mechanism import Mechanism, point_on_body, rigid_distance
from spatial_pin.mechanism.pairs import PAIRS, Z, closure_geometry
from spatial_pin.mechanism.parts import Closure, Passive
from spatial_pin.reduction.model.links import Place, Relation
from spatial_pin.reduction.model.model import Model
from spatial_pin.reduction.model.tree import Tree


def built(model: Model) -> Mechanism:
    """Return the mechanism as it stands."""
    full, passives = model.full, [p for p in model.full.passives if model.keeps_spin(p)]
    named = {f for c in model.closures for f in (*c.frames, *c.between)}
    named |= {name for name in model.asked.frames if name in full.frame_ids}
    if model.dynamics:
        named |= {f for s in full.springs for f in s.frames}
    tree = Tree(full, model.bodies, model.moving)
    carriers = {_carrier(model, name) for name in named}
    tree.hold({*carriers, *(p.body for p in passives)}, model.welded,
              full.inertias if model.dynamics else model.asked.frames)
    parts = {
        "passives": tuple(_passive(model, p, tree) for p in passives),
        "closures": tuple(_closures(model, tree)),
        "drivers": {name: d for name, d in full.drivers.items()
                    if full.joint_id(full.coordinate(d.joint).joint) in model.moving},
        "springs": full.springs if model.dynamics else (),
    }
    for name, place, mass in model.masses:
        tree.add(name, place, mass)
    return tree.mechanism(_frames(model, named), **parts)


def _closures(model: Model, tree: Tree) -> Iterator[Closure]:
    """Yield the closures that are kept, and those that stand for links."""
    made = [_turned(model, _with_length(model, c), tree) for c in model.closures]
    made += [_closure(name, relation, tree) for name, relation in model.relations]
    for closure in made:
        needed = model.equations.get(closure.name, closure.equations)
        if needed != ():
            yield replace(closure, equations=needed)


def _frames(model: Model, named: set[str]) -> set[str]:
    """Return those of the named that the URDF does not have, and what they are fixed to."""
    found: set[str] = set()
    for name in named:
        while name in model.full.frames and name not in found:
            found.add(name)
            name = model.full.frames[name].link
    return found


def _carrier(model: Model, name: str) -> str:
    """Return the link that a link, frame or joint is fixed to."""
    while name in model.full.frames:
        name = model.full.frames[name].link
    if name in model.full.links:
        return name
    joint, placement = model.full.frame_on_joint(name)
    return next(n for n in model.full.links if model.full.frame_on_joint(n)[0] == joint
                and model.full.frame_on_joint(n)[1] == placement)


def _with_length(model: Model, closure: Closure) -> Closure:
    """Return a distance as a plain one if a pair of its frames moves as one body by now."""
    pairs = [closure.frames, closure.between] if closure.between else []
    for rigid, other in zip(pairs, pairs[::-1], strict=True):
        length = rigid_distance(*map(model.bodies.frame, rigid))
        if length is not None:
            return replace(closure, frames=other, between=(),
                           geometry=closure_geometry(closure.pair, length=length))
    return closure


def _turned(model: Model, closure: Closure, tree: Tree) -> Closure:
    """Return a closure between frames of its own where its axes are turned."""
    if closure.name not in model.turns:
        return closure
    frames = []
    for k, (name, axes) in enumerate(zip(
            closure.frames, (closure.geometry.axes1, closure.geometry.axes2), strict=True), 1):
        body, placement = model.bodies.frame(name)
        rotation = placement.rotation @ axes @ model.turns[closure.name]
        frames.append(tree.add(f"{closure.name}_{k}", Place(
            body, placement.translation, rotation[:, 2], rotation[:, 0])))
    return replace(closure, frames=tuple(frames), geometry=closure_geometry(closure.pair, Z))


def _passive(model: Model, passive: Passive, tree: Tree) -> Passive:
    """Return a passive freedom, its axis between frames that exist."""
    joint = model.full.frame_on_joint(passive.body)[0]
    first, second = (
        tree.add(f"{passive.name}_{k}", Place(joint, point_on_body(model.full, joint, name)))
        for k, name in enumerate(passive.axis, 1))
    return replace(passive, axis=(first, second))


def _closure(name: str, made: Relation, tree: Tree) -> Closure:
    """Return a relation as a closure between z axes of frames of its own."""
    frames = tuple(tree.add(f"{name}_{k}", place) for k, place in enumerate(made.places, 1))
    ends = tuple(tree.add(f"{name}_end_{k}", place) for k, place in enumerate(made.between, 1))
    geometry = closure_geometry(PAIRS[made.type], Z, Z, length=0.0 if ends else made.length)
    return Closure(name, made.type, frames, geometry, between=ends)
