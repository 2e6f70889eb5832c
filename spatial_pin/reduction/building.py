"""Building a reduced mechanism from its parts, and what it leaves out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.formats.pinocchio_model.from_model import LinkTree, urdf_of
from spatial_pin.formats.pinocchio_model.pair_tree import copy_numbers
from spatial_pin.formats.urdf.elements import fresh
from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.mechanism.mechanism import Mechanism, point_on_body, rigid_distance
from spatial_pin.mechanism.mechanism_checks import check_mechanism
from spatial_pin.mechanism.pairs import PAIRS, Z, closure_geometry
from spatial_pin.mechanism.parts import Closure, Passive, add_frames
from spatial_pin.numerics.linalg import Array
from spatial_pin.reduction.influence import NeededParts, OutputInfluence, RequestedOutputs
from spatial_pin.reduction.relations import (
    BodyFrame,
    Relation,
    Surroundings,
    WeldedBodies,
    open_configurations,
)


class Omission(NamedTuple):
    """A removed part of a reduced mechanism.

    Attributes:
        what: "geometry", "inertia", "spring", "joint", "branch", "loop", "link", "leg",
            "equations", "joint limits" or "passive freedom".
        name: of the part; empty for several parts.
        why: the reason in words.

    Example:
        >>> small = sp.reduce(sp.load("rssr"), "rocker_pin")
        >>> [omission.what for omission in small.omissions]
        ['geometry', 'inertia', 'link', 'passive freedom']
        >>> small.omissions[2].name
        'coupler'
    """

    what: str
    name: str
    why: str

    def __str__(self) -> str:
        return f"{self.what}{f' {self.name}' if self.name else ''}: {self.why}"


class ReducedModel:
    """The parts of a reduced mechanism.

    Args:
        mechanism: the full mechanism.
        q: (nq,) closed configuration in which joints are welded.
        needed: the parts that the outputs depend on.
        influence: the analysis of that.
        requested: the outputs.
        dynamics: keep inertias and springs.
        lump: replace massive rods too.
    """

    def __init__(
        self, mechanism: Mechanism, q: Array, needed: NeededParts, influence: OutputInfluence,
        requested: RequestedOutputs, *, dynamics: bool, lump: bool,
    ) -> None:
        self.full, self.q, self.needed, self.influence = mechanism, q, needed, influence
        self.requested, self.dynamics, self.lump = requested, dynamics, lump
        self.moving, self.welded = set(needed.moving), set(needed.welded)
        self.lengthening: set[int] = set()  # joints that only make a distance longer
        self.bodies = WeldedBodies(mechanism, q, needed.welded)
        self.closures: list[Closure] = []
        for closure in (mechanism.closures[k] for k in needed.closures):
            if closure.acts_at is not None:  # on bodies that may be omitted
                closure = replace(closure, numbers={
                    k: x for k, x in closure.numbers.items() if x is not closure.acts_at})
            coupled = {mechanism.joint_id(mechanism.coordinate(n).joint) for n in closure.joints}
            if not closure.joints or closure.frames or coupled & self.moving:  # else it is locked
                self.closures.append(closure)
        self.relations: list[tuple[str, Relation]] = []
        self.masses: list[tuple[str, BodyFrame, float]] = []
        self.turns: dict[str, Array] = {}  # of closures' axes
        self.equations: dict[str, tuple[int, ...]] = {}  # that are needed, where not all are
        self.notes: list[Omission] = []
        free = np.zeros(mechanism.model.nv)
        for i in self.moving:
            free[influence.columns[i]] = 1.0
        self.around = Surroundings(mechanism, open_configurations(mechanism, q, free))

    def closures_on(self, joints: tuple[int, ...]) -> tuple[Closure, ...]:
        """Return the closures with a frame on the bodies of these joints, with couplings."""
        first = self.full.model.names[joints[0]]
        return tuple(c for c in self.closures if (
            first in (self.full.coordinate(j).joint for j in c.joints)
            or any(self.bodies.frame(f)[0] in joints for f in (*c.frames, *c.between))))

    def hangs_free(self, joints: tuple[int, ...]) -> bool:
        """Whether no other moving or requested part hangs on the bodies of a chain."""
        supports = self.full.model.supports
        hung = [j for j in self.moving
                if j not in joints and joints[0] in [int(k) for k in supports[j]]]
        requested = [f for f in self.requested.frames if self.bodies.of(
            self.full.frame_on_joint(f)[0])[0] in joints]
        related = [p for _, r in self.relations for p in (*r.frames, *r.between)
                   if p.body in joints]
        springs = [f for s in self.full.springs for f in s.frames
                   if self.dynamics and self.bodies.frame(f)[0] in joints]
        return not (hung or requested or related or springs)

    def link(self, i: int) -> str:
        """Return the name of the link that joint i moves."""
        return next(name for name in self.full.links if self.full.frame_on_joint(name)[0] == i)

    def keeps_spin(self, passive: Passive) -> bool:
        """Whether the body of a passive freedom still turns independently."""
        joint = self.full.frame_on_joint(passive.body)[0]
        return joint not in self.lengthening and self.bodies.of(joint)[0] in self.moving


class ReducedTree:
    """The remaining joints and links as a model of their own.

    Args:
        full: the full mechanism.
        bodies: its rigid bodies, with some joints welded.
        moving: the remaining joints.
    """

    def __init__(self, full: Mechanism, bodies: WeldedBodies, moving: Iterable[int]) -> None:
        self.full, self.bodies = full, bodies
        self.model = pin.Model()
        self.model.name, self.model.gravity = full.model.name, full.model.gravity
        self.inertias: dict[str, pin.Inertia] = {}
        self._joint_of = {0: 0}
        self._taken = {f.name for f in full.model.frames} | set(full.model.names)
        given = full.model
        for i in sorted(moving):
            body, on = bodies.of(int(given.parents[i]))
            k = int(self.model.addJoint(self._joint_of[body], given.joints[i],
                                        on * given.jointPlacements[i], given.names[i]))
            copy_numbers(given, i, self.model, k)
            self.model.addJointFrame(k, 0)
            self._joint_of[i] = k

    def hold(self, links: set[str], welded: Iterable[int], heavy: Iterable[str]) -> None:
        """Add links of the full tree, links on welded joints, and inertias.

        Args:
            links: links with a reference from other parts.
            welded: joints that carry some of the remaining parts.
            heavy: links that keep their inertia, if their body remains.
        """
        full, there, met = self.full, {*self._joint_of, *welded}, set[int]()
        weighed = {name for name in heavy if name in full.inertias
                   and full.frame_on_joint(name)[0] in there}
        for name in full.links:
            joint, placement = full.frame_on_joint(name)
            is_main = joint in there - met and placement.isIdentity(0.0)
            met.update({joint} if is_main else ())
            if is_main and joint in self._joint_of:
                self._add_body(name, self.bodies.frame(name)[0], pin.SE3.Identity(), "")
            elif is_main or name in weighed or name in links:
                frames = full.model.frames
                above = frames[frames[full.frame_id(name)].parentFrame].name
                self._add_body(name, *self.bodies.frame(name), above)
        for name in weighed:
            self._weigh(name, full.inertias[name])

    def add(self, wanted: str, frame: BodyFrame, mass: float = 0.0) -> str:
        """Add a new link on a body, with a point mass if not zero; return its name."""
        name, (body, on) = fresh(wanted, self._taken), self.bodies.of(frame.body)
        self._add_body(name, body, on * frame.placement, fresh(f"{name}_mount", self._taken))
        if mass > 0.0:
            self._weigh(name, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))))
        return name

    def _add_body(self, link: str, joint: int, placement: pin.SE3, mount: str) -> None:
        """Add a link on a joint of the full tree, by a fixed joint unless that joint moves it."""
        on, above = self._joint_of[joint], 0
        if mount:
            above = self.model.addFrame(
                pin.Frame(mount, on, 0, placement, pin.FrameType.FIXED_JOINT), False)
        self.model.addFrame(pin.Frame(link, on, above, placement, pin.FrameType.BODY), False)

    def _weigh(self, link: str, inertia: pin.Inertia) -> None:
        frame = self.model.frames[self.model.getFrameId(link, pin.FrameType.BODY)]
        self.inertias[link] = inertia
        self.model.inertias[frame.parentJoint] += frame.placement.act(inertia)

    def mechanism(self, frames: Iterable[str], **parts: Any) -> Mechanism:
        """Return the mechanism of this tree."""
        full, none = self.full, pin.GeometryModel()
        own_frames = {name: full.frames[name] for name in full.frames if name in set(frames)}
        add_frames(self.model, own_frames, full.name)
        slip_speeds = full.slip_speeds
        if slip_speeds.size:
            own = [np.arange(full.model.idx_vs[i], full.model.idx_vs[i] + full.model.nvs[i])
                   for i in self._joint_of if i]
            slip_speeds = slip_speeds[np.concatenate([[], *own]).astype(int)]
        pairs = tuple(full.pairs[i - 1] for i in self._joint_of if i)
        made = Mechanism(full.name, self.model, none, none, pairs, title=full.title,
                         source=full.source, inertias=self.inertias, frames=own_frames,
                         slip_speeds=slip_speeds, **parts)
        check_mechanism(made, f"{full.name} (reduced)")
        return made.with_fields(urdf=urdf_of(made, LinkTree(self.model)))


def built(model: ReducedModel) -> Mechanism:
    """Return the reduced mechanism."""
    full, passives = model.full, [p for p in model.full.passives if model.keeps_spin(p)]
    named = {f for c in model.closures for f in (*c.frames, *c.between)}
    named |= {name for name in model.requested.frames if name in full.frame_ids}
    if model.dynamics:
        named |= {f for s in full.springs for f in s.frames}
    tree = ReducedTree(full, model.bodies, model.moving)
    carriers = set[str]()
    for name in named:  # the links that links, frames and joints are fixed to
        while name in full.frames:
            name = full.frames[name].link
        if name not in full.links:
            on_joint = full.frame_on_joint(name)
            name = next(n for n in full.links if full.frame_on_joint(n) == on_joint)
        carriers.add(name)
    tree.hold({*carriers, *(p.body for p in passives)}, model.welded,
              full.inertias if model.dynamics else model.requested.frames)
    parts = {
        "passives": tuple(_passive(model, p, tree) for p in passives),
        "closures": tuple(_closures(model, tree)),
        "drivers": {name: d for name, d in full.drivers.items()
                    if full.joint_id(full.coordinate(d.joint).joint) in model.moving},
        "springs": full.springs if model.dynamics else (),
    }
    for name, frame, mass in model.masses:
        tree.add(name, frame, mass)
    return tree.mechanism(_frames(model, named), **parts)


def _closures(model: ReducedModel, tree: ReducedTree) -> Iterator[Closure]:
    """Yield the remaining closures, and those that replace links.

    A distance becomes a plain one if a pair of its frames is now on one body.
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
    """Return the named frames that are not in the URDF, with those that carry them."""
    chain: set[str] = set()
    for name in named:
        while name in model.full.frames and name not in chain:
            chain.add(name)
            name = model.full.frames[name].link
    return chain


def _turned(model: ReducedModel, closure: Closure, tree: ReducedTree) -> Closure:
    """Return a closure between frames of its own if its axes are turned."""
    if closure.name not in model.turns:
        return closure
    frames = []
    for k, (name, axes) in enumerate(zip(
            closure.frames, (closure.geometry.axes1, closure.geometry.axes2), strict=True), 1):
        body, placement = model.bodies.frame(name)
        rotation = placement.rotation @ axes @ model.turns[closure.name]
        frames.append(tree.add(f"{closure.name}_{k}", BodyFrame(
            body, placement.translation, rotation[:, 2], rotation[:, 0])))
    return replace(closure, frames=tuple(frames), geometry=closure_geometry(closure.pair, Z))


def _passive(model: ReducedModel, passive: Passive, tree: ReducedTree) -> Passive:
    """Return a passive freedom with an axis between new frames."""
    joint = model.full.frame_on_joint(passive.body)[0]
    first, second = (
        tree.add(f"{passive.name}_{k}", BodyFrame(joint, point_on_body(model.full, joint, name)))
        for k, name in enumerate(passive.axis, 1))
    return replace(passive, axis=(first, second))


def _closure(name: str, made: Relation, tree: ReducedTree) -> Closure:
    """Return a relation as a closure between z axes of frames of its own."""
    frames = tuple(tree.add(f"{name}_{k}", frame) for k, frame in enumerate(made.frames, 1))
    ends = tuple(tree.add(f"{name}_end_{k}", frame) for k, frame in enumerate(made.between, 1))
    geometry = closure_geometry(PAIRS[made.type], Z, Z, length=0.0 if ends else made.length)
    return Closure(name, made.type, frames, geometry, between=ends)


def omissions(model: ReducedModel, locked: frozenset[int]) -> Iterator[Omission]:
    """Yield the removed parts with reasons."""
    full = model.full
    if len(full.visual_model.geometryObjects) + len(full.collision_model.geometryObjects):
        yield Omission("geometry", "", "shapes to draw and to collide")
    if not model.dynamics:
        heavy = [n for n in full.inertias if n not in model.requested.frames]
        if heavy:
            yield Omission("inertia", "", f"of {len(heavy)} links: only the motion is wanted")
        for spring in full.springs:
            yield Omission("spring", spring.name, "only the motion is wanted")
    yield from _lost_parts(model, locked)
    yield from model.notes
    passed = dict.fromkeys(
        x.name for x in joint_limits(full)
        if full.joint_id(full.coordinate(x.name).joint) not in model.moving | locked)
    if passed:
        yield Omission("joint limits", "", f"of {', '.join(passed)}: where one is passed, the full "
                                           "mechanism says so and this one does not")
    for passive in full.passives:
        if not model.keeps_spin(passive):
            yield Omission("passive freedom", passive.name, f"of {passive.body}, which is left out")


def _lost_parts(model: ReducedModel, locked: frozenset[int]) -> Iterator[Omission]:
    """Yield the removed loops, then the removed joints."""
    for k, closure in enumerate(model.full.closures):
        if k not in model.needed.closures:
            yield Omission("loop", closure.name, (
                "no output depends on it (at "
                f"{len(model.influence.configurations)} generic configurations); where it "
                "cannot close, the full mechanism stops and this one does not"))
    names, welded = model.full.model.names, model.needed.welded - locked
    yield from (Omission("joint", names[i], "locked: welded") for i in sorted(locked))
    yield from (Omission("joint", names[i], "welded: no wanted output moves with it")
                for i in sorted(welded))
    gone = [names[i] for i in range(1, model.full.model.njoints)
            if i not in model.needed.moving | welded | locked]
    if gone:
        yield Omission("branch", "", f"no output depends on: {', '.join(gone)}")
