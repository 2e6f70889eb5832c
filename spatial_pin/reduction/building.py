"""The reduced mechanism as it stands, made of its parts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.formats.pinocchio_model.from_model import Completed
from spatial_pin.formats.pinocchio_model.joints import copy_numbers
from spatial_pin.formats.pinocchio_model.urdf_text import urdf_of
from spatial_pin.formats.urdf.writing import fresh
from spatial_pin.mechanism.checks import check_mechanism
from spatial_pin.mechanism.mechanism import Mechanism, point_on_body, rigid_distance
from spatial_pin.mechanism.named_frames import add_frames
from spatial_pin.mechanism.pairs import PAIRS, Z, closure_geometry
from spatial_pin.mechanism.parts import Closure, Passive
from spatial_pin.reduction.reduced_model import ReducedModel
from spatial_pin.reduction.relations import BodyFrame, Relation, WeldedBodies


class ReducedTree:
    """Joints that stay, and links on them, as a model of their own.

    Args:
        full: the full mechanism.
        bodies: its rigid bodies, some of its joints welded.
        moving: joints that stay.
    """

    def __init__(self, full: Mechanism, bodies: WeldedBodies, moving: Iterable[int]) -> None:
        self.full, self.bodies = full, bodies
        self.model = pin.Model()
        self.model.name, self.model.gravity = full.model.name, full.model.gravity
        self.inertias: dict[str, pin.Inertia] = {}
        self._place_of = {0: 0}
        self._taken = {f.name for f in full.model.frames} | set(full.model.names)
        for i in sorted(moving):
            self._place_of[i] = self._add_joint(i)

    def _add_joint(self, i: int) -> int:
        given = self.full.model
        body, on = self.bodies.of(int(given.parents[i]))
        k = self.model.addJoint(self._place_of[body], given.joints[i],
                                on * given.jointPlacements[i], given.names[i])
        copy_numbers(given, i, self.model, k)
        self.model.addJointFrame(k, 0)
        return int(k)

    def hold(self, links: set[str], welded: Iterable[int], heavy: Iterable[str]) -> None:
        """Keep links of the full tree, those that hang on welded joints, and inertias.

        Args:
            links: those that something refers to.
            welded: joints that carry some of what stays.
            heavy: links that keep their inertia, if what they are fixed to stays.
        """
        full, there, met = self.full, {*self._place_of, *welded}, set[int]()
        weighed = {name for name in heavy if name in full.inertias
                   and full.frame_on_joint(name)[0] in there}
        for name in full.links:
            joint, placement = full.frame_on_joint(name)
            is_main = joint in there - met and placement.isIdentity(0.0)
            met.update({joint} if is_main else ())
            if is_main and joint in self._place_of:
                self._add_body(name, self.bodies.frame(name)[0], pin.SE3.Identity(), "")
            elif is_main or name in weighed or name in links:
                frames = full.model.frames
                above = frames[frames[full.frame_id(name)].parentFrame].name
                self._add_body(name, *self.bodies.frame(name), above)
        for name in weighed:
            self._weigh(name, full.inertias[name])

    def add(self, wanted: str, place: BodyFrame, mass: float = 0.0) -> str:
        """Put a new link on a body, with a point mass if there is one; return its name."""
        name, (body, on) = fresh(wanted, self._taken), self.bodies.of(place.body)
        self._add_body(name, body, on * place.placement, fresh(f"{name}_mount", self._taken))
        if mass > 0.0:
            self._weigh(name, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))))
        return name

    def _add_body(self, link: str, joint: int, placement: pin.SE3, mount: str) -> None:
        """Add a link on a joint of the full tree, by a fixed joint unless it is moved by that."""
        on, above = self._place_of[joint], 0
        if mount:
            above = self.model.addFrame(
                pin.Frame(mount, on, 0, placement, pin.FrameType.FIXED_JOINT), False)
        self.model.addFrame(pin.Frame(link, on, above, placement, pin.FrameType.BODY), False)

    def _weigh(self, link: str, inertia: pin.Inertia) -> None:
        frame = self.model.frames[self.model.getFrameId(link, pin.FrameType.BODY)]
        self.inertias[link] = inertia
        self.model.inertias[frame.parentJoint] += frame.placement.act(inertia)

    def mechanism(self, frames: Iterable[str], **parts: Any) -> Mechanism:
        """Return the mechanism of this tree.

        Args:
            frames: those of the full mechanism that its URDF does not have, and that stay.
            **parts: its closures, drivers, springs and passives.
        """
        full, none = self.full, pin.GeometryModel()
        kept = {name: full.frames[name] for name in full.frames if name in set(frames)}
        add_frames(self.model, kept, full.name)
        slip_speeds = full.slip_speeds
        if slip_speeds.size:
            own = [np.arange(full.model.idx_vs[i], full.model.idx_vs[i] + full.model.nvs[i])
                   for i in self._place_of if i]
            slip_speeds = slip_speeds[np.concatenate([[], *own]).astype(int)]
        pairs = tuple(full.pairs[i - 1] for i in self._place_of if i)
        made = Mechanism(full.name, self.model, none, none, pairs, title=full.title,
                         source=full.source, inertias=self.inertias, frames=kept,
                         slip_speeds=slip_speeds, **parts)
        check_mechanism(made, f"{full.name} (reduced)")
        return made.with_fields(urdf=urdf_of(made, Completed(self.model).bodies()))


def built(model: ReducedModel) -> Mechanism:
    """Return the mechanism as it stands."""
    full, passives = model.full, [p for p in model.full.passives if model.keeps_spin(p)]
    named = {f for c in model.closures for f in (*c.frames, *c.between)}
    named |= {name for name in model.asked.frames if name in full.frame_ids}
    if model.dynamics:
        named |= {f for s in full.springs for f in s.frames}
    tree = ReducedTree(full, model.bodies, model.moving)
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


def _closures(model: ReducedModel, tree: ReducedTree) -> Iterator[Closure]:
    """Yield the closures that are kept, and those that stand for links.

    A distance becomes a plain one if a pair of its frames moves as one body by now.
    """
    made = []
    for closure in model.closures:
        pairs = [closure.frames, closure.between] if closure.between else []
        for rigid, other in zip(pairs, pairs[::-1], strict=True):
            length = rigid_distance(*map(model.bodies.frame, rigid))
            if length is not None:
                geometry = closure_geometry(closure.pair, length=length)
                closure = replace(closure, frames=other, between=(), geometry=geometry)
                break
        made.append(_turned(model, closure, tree))
    made += [_closure(name, relation, tree) for name, relation in model.relations]
    for closure in made:
        needed = model.equations.get(closure.name, closure.equations)
        if needed != ():
            yield replace(closure, equations=needed)


def _frames(model: ReducedModel, named: set[str]) -> set[str]:
    """Return those of the named that the URDF does not have, and what they are fixed to."""
    found: set[str] = set()
    for name in named:
        while name in model.full.frames and name not in found:
            found.add(name)
            name = model.full.frames[name].link
    return found


def _carrier(model: ReducedModel, name: str) -> str:
    """Return the link that a link, frame or joint is fixed to."""
    while name in model.full.frames:
        name = model.full.frames[name].link
    if name in model.full.links:
        return name
    joint, placement = model.full.frame_on_joint(name)
    return next(n for n in model.full.links if model.full.frame_on_joint(n)[0] == joint
                and model.full.frame_on_joint(n)[1] == placement)


def _turned(model: ReducedModel, closure: Closure, tree: ReducedTree) -> Closure:
    """Return a closure between frames of its own where its axes are turned."""
    if closure.name not in model.turns:
        return closure
    assert closure.geometry is not None
    frames = []
    for k, (name, axes) in enumerate(zip(
            closure.frames, (closure.geometry.axes1, closure.geometry.axes2), strict=True), 1):
        body, placement = model.bodies.frame(name)
        rotation = placement.rotation @ axes @ model.turns[closure.name]
        frames.append(tree.add(f"{closure.name}_{k}", BodyFrame(
            body, placement.translation, rotation[:, 2], rotation[:, 0])))
    return replace(closure, frames=tuple(frames), geometry=closure_geometry(closure.pair, Z))


def _passive(model: ReducedModel, passive: Passive, tree: ReducedTree) -> Passive:
    """Return a passive freedom, its axis between frames that exist."""
    joint = model.full.frame_on_joint(passive.body)[0]
    first, second = (
        tree.add(f"{passive.name}_{k}", BodyFrame(joint, point_on_body(model.full, joint, name)))
        for k, name in enumerate(passive.axis, 1))
    return replace(passive, axis=(first, second))


def _closure(name: str, made: Relation, tree: ReducedTree) -> Closure:
    """Return a relation as a closure between z axes of frames of its own."""
    frames = tuple(tree.add(f"{name}_{k}", place) for k, place in enumerate(made.places, 1))
    ends = tuple(tree.add(f"{name}_end_{k}", place) for k, place in enumerate(made.between, 1))
    geometry = closure_geometry(PAIRS[made.type], Z, Z, length=0.0 if ends else made.length)
    return Closure(name, made.type, frames, geometry, between=ends)
