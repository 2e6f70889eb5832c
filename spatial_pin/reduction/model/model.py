"""A reduced mechanism in the making: what moves, what closes, what is written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.constraints.closure_equations import evaluation_of
from spatial_pin.mechanism.mechanism import Mechanism, point_on_body, rigid_distance
from spatial_pin.mechanism.pairs import COUPLING, PAIRS, Z, closure_geometry
from spatial_pin.mechanism.parts import Closure, Passive
from spatial_pin.mechanism.resistance import resists
from spatial_pin.numerics.linalg import Array, null_space
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.reduction.influence import Asked, Influence, Kept
from spatial_pin.reduction.model.legs import leg_of
from spatial_pin.reduction.model.links import (
    Bodies,
    Pin,
    Place,
    Relation,
    Surroundings,
    open_configurations,
    reach,
    relation,
)
from spatial_pin.reduction.model.tree import Tree

Omitted = tuple[str, str, str]


class Model:
    """The parts of a reduced mechanism.

    Args:
        mechanism: the full mechanism.
        q: (nq,) closed configuration in which joints are welded.
        kept: what the outputs depend on.
        influence: what that was found with.
        asked: the outputs.
        dynamics: keep inertias and springs.
        lump: replace massive rods too.
    """

    def __init__(self, mechanism: Mechanism, q: Array, kept: Kept, influence: Influence,
                 asked: Asked, *, dynamics: bool, lump: bool) -> None:
        self.full, self.q, self.kept, self.influence = mechanism, q, kept, influence
        self.asked, self.dynamics, self.lump = asked, dynamics, lump
        self.moving, self.welded = set(kept.moving), set(kept.welded)
        self.lengthening: set[int] = set()  # joints that only make a distance longer
        self.bodies = Bodies(mechanism, q, kept.welded)
        self.closures: list[Closure] = [mechanism.closures[k] for k in kept.closures
                                        if not self._is_locked(mechanism.closures[k])]
        self.relations: list[tuple[str, Relation]] = []
        self.masses: list[tuple[str, Place, float]] = []
        self.turns: dict[str, Array] = {}  # of closures' axes
        self.equations: dict[str, tuple[int, ...]] = {}  # that are needed, where not all are
        self.notes: list[Omitted] = []
        free = np.zeros(mechanism.model.nv)
        for i in self.moving:
            free[influence.columns[i]] = 1.0
        self.around = Surroundings(mechanism, open_configurations(mechanism, q, free))

    def _is_locked(self, closure: Closure) -> bool:
        return closure.type == COUPLING and not {
            self.full.joint_id(self.full.coordinate(n).joint) for n in closure.joints
        } & self.moving

    # ------------------------------------------------------------ links of two pairs

    def replace_links(self) -> None:
        """Replace links that nothing is asked of by the equations that they stand for."""
        found = True
        while found:
            found = any(self._replace(i) for i in sorted(self.moving, reverse=True)) \
                or any(self._replace_leg(c) for c in self.closures if c.frames)

    def _replace(self, i: int) -> bool:
        if i not in self.moving or i in self.influence.needed or not self.hangs_free((i,)):
            return False
        own = self.closures_on((i,))
        is_free = self.full.pairs[i - 1] == "floating"
        if len(own) != (2 if is_free else 1) or any(
                c.type == COUPLING or c.equations or c.between for c in own):
            return False
        pins = [self.bodies.closing_pin(c, i) for c in own]
        if not is_free:
            pins.insert(0, self.bodies.tree_pin(i))
        if pins[0].body == pins[1].body or not self._may_go(i, pins):
            return False
        made = relation(pins[0], pins[1], self.around)
        if made is None:
            return False
        self._record("link", i, pins, own, made)
        gone = {j for j in (*self.moving, *self.welded)
                if i in [int(k) for k in self.full.model.supports[j]]}
        self.moving -= gone
        self.welded -= gone
        self.closures = [c for c in self.closures if c not in own]
        return True

    def _replace_leg(self, closure: Closure) -> bool:
        """Replace the leg that a closure ends, if it stands for a distance of variable length."""
        leg = leg_of(self, closure)
        if leg is None or (self.dynamics and not all(map(self._is_massless, leg.joints))):
            return False
        self._record("leg", leg.joints[0], leg.pins, leg.closures, leg.made, leg.joints[1:])
        self.moving.remove(leg.joints[0])
        self.welded.add(leg.joints[0])
        self.lengthening.update(leg.joints)
        self.bodies = Bodies(self.full, self.q, frozenset(self.welded))
        self.closures = [c for c in self.closures if c not in leg.closures]
        return True

    def closures_on(self, joints: tuple[int, ...]) -> tuple[Closure, ...]:
        """Return the closures with a frame on the bodies of these joints, which move them.

        A coupling of the first of them is one.
        """
        first = self.full.model.names[joints[0]]
        return tuple(c for c in self.closures if (
            first in (self.full.coordinate(j).joint for j in c.joints)
            or any(self.bodies.frame(f)[0] in joints for f in (*c.frames, *c.between))))

    def hangs_free(self, joints: tuple[int, ...]) -> bool:
        """Whether nothing else that moves, or is asked for, hangs on the bodies of a chain."""
        supports = self.full.model.supports
        hung = [j for j in self.moving
                if j not in joints and joints[0] in [int(k) for k in supports[j]]]
        asked = [f for f in self.asked.frames if self.bodies.of(
            self.full.frame_on_joint(f)[0])[0] in joints]
        related = [p for _, r in self.relations for p in (*r.places, *r.between)
                   if p.body in joints]
        springs = [f for s in self.full.springs for f in s.frames
                   if self.dynamics and self.bodies.frame(f)[0] in joints]
        return not (hung or asked or related or springs)

    def _may_go(self, i: int, pins: list[Pin]) -> bool:
        """Whether the body of joint i is massless, or its mass does not matter or is lumped."""
        if not self.dynamics or self._is_massless(i):
            return True
        if self._resists(i):
            return False
        mass = self._inertia(i)
        balls = all(p.kind in ("spherical", "universal") for p in pins)
        return self.lump and balls and self._lumped(i, pins, mass)

    def _is_massless(self, i: int) -> bool:
        """Whether no motion of the body of joint i takes a force."""
        mass = self._inertia(i)
        return not (mass.mass or np.any(mass.inertia) or self._resists(i))

    def _resists(self, i: int) -> bool:
        """Whether joint i itself takes a force to be moved."""
        return resists(self.full, i)

    def _inertia(self, i: int) -> pin.Inertia:
        """Return the inertia of the rigid body that joint i moves, in its axes."""
        total = pin.Inertia.Zero()
        for j in (i, *self.welded):
            mover, on = self.bodies.of(j)
            if mover == i:
                total += on.act(self.full.model.inertias[j])
        return total

    def _lumped(self, i: int, pins: list[Pin], body: pin.Inertia) -> bool:
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
                self.masses.append((f"{self._link(i)}_mass", Place(place.body, place.centre), mass))
        self.notes.append((
            "inertia", self._link(i),
            f"{body.mass:.6g} kg lumped at the centres of its two pairs; inertia across the rod "
            f"becomes {lumped:.4g} instead of {across:.4g} kg·m², about it 0 instead of {spin:.4g}"
            + f"; the centre of mass moves {aside:.3g} m, square to the line between them" * (
                aside > TOLERANCES.nothing * length)))
        return True

    def _link(self, i: int) -> str:
        return next(name for name in self.full.links if self.full.frame_on_joint(name)[0] == i)

    def _record(
        self, what: str, joint: int, pins: Sequence[Pin], own: Sequence[Closure],
        made: list[Relation], inner: Sequence[int] = (),
    ) -> None:
        """Take note of a link or leg, hung on a joint, that is replaced by relations."""
        link, names = self._link(joint), self.full.model.names
        self._relate(link, made)
        others = " and ".join(repr(names[i]) for i in inner)
        said = " and ".join(_words(one, others, len(inner)) for one in made)
        closed = " and ".join(repr(c.name) for c in own)
        self.notes.append((what, link, (
            f"its pairs ({pins[0].kind} and {pins[1].kind}; joint {names[joint]!r}, closure "
            f"{closed}) stand for one relation: {said}{reach(*pins)}")))

    def _relate(self, link: str, made: list[Relation]) -> None:
        taken = {c.name for c in self.closures} | {n for n, _ in self.relations}
        for k, one in enumerate(made):
            name = link if not k else f"{link}_{one.type}"
            while name in taken:
                name += "_"
            taken.add(name)
            self.relations.append((name, one))

    # ------------------------------------------------------------ equations

    def drop_equations(self) -> None:
        """Leave out equations whose derivative is zero wherever the joints are put."""
        made = self.mechanism()
        slopes = _slopes(made)
        for closure in made.closures:
            if closure.type != COUPLING and closure.equations is None:
                self._drop_equations(closure, slopes[closure.name])

    def _drop_equations(self, closure: Closure, slopes: Array) -> None:
        """Leave out equations of one closure, its axes turned so that as many as can be go."""
        turn = _turn(closure, slopes)
        if turn is not None:
            self.turns[closure.name] = turn
            slopes = _slopes(self.mechanism())[closure.name]
        needed = tuple(np.flatnonzero(np.abs(slopes).max(axis=1) > TOLERANCES.tight).tolist())
        if len(needed) == len(slopes):
            self.turns.pop(closure.name, None)
            return
        self.equations[closure.name] = needed
        gone = len(slopes) - len(needed)
        self.notes.append((
            "equations", closure.name,
            f"{gone} of {len(slopes)} hold wherever its joints stand"
            + "; nothing is left of it" * (not needed)))

    # ------------------------------------------------------------ the mechanism

    def mechanism(self) -> Mechanism:
        """Return the mechanism as it stands."""
        full, passives = self.full, [p for p in self.full.passives if self.keeps_spin(p)]
        named = {f for c in self.closures for f in (*c.frames, *c.between)}
        named |= {name for name in self.asked.frames if name in full.frame_ids}
        if self.dynamics:
            named |= {f for s in full.springs for f in s.frames}
        tree = Tree(full, self.bodies, self.moving)
        tree.hold({*map(self._carrier, named), *(p.body for p in passives)}, self.welded,
                  full.inertias if self.dynamics else self.asked.frames)
        parts = {
            "passives": tuple(self._passive(p, tree) for p in passives),
            "closures": tuple(self._closures(tree)),
            "drivers": {name: d for name, d in full.drivers.items()
                        if full.joint_id(full.coordinate(d.joint).joint) in self.moving},
            "springs": full.springs if self.dynamics else (),
        }
        for name, place, mass in self.masses:
            tree.add(name, place, mass)
        return tree.mechanism(self._frames(named), **parts)

    def _closures(self, tree: Tree) -> Iterator[Closure]:
        """Yield the closures that are kept, and those that stand for links."""
        made = [self._turned(self._with_length(c), tree) for c in self.closures]
        made += [_closure(name, relation, tree) for name, relation in self.relations]
        for closure in made:
            needed = self.equations.get(closure.name, closure.equations)
            if needed != ():
                yield replace(closure, equations=needed)

    def _frames(self, named: set[str]) -> set[str]:
        """Return those of the named that the URDF does not have, and what they are fixed to."""
        found: set[str] = set()
        for name in named:
            while name in self.full.frames and name not in found:
                found.add(name)
                name = self.full.frames[name].link
        return found

    def _carrier(self, name: str) -> str:
        """Return the link that a link, frame or joint is fixed to."""
        while name in self.full.frames:
            name = self.full.frames[name].link
        if name in self.full.links:
            return name
        joint, placement = self.full.frame_on_joint(name)
        return next(n for n in self.full.links if self.full.frame_on_joint(n)[0] == joint
                    and self.full.frame_on_joint(n)[1] == placement)

    def _with_length(self, closure: Closure) -> Closure:
        """Return a distance as a plain one if a pair of its frames moves as one body by now."""
        pairs = [closure.frames, closure.between] if closure.between else []
        for rigid, other in zip(pairs, pairs[::-1], strict=True):
            length = rigid_distance(*map(self.bodies.frame, rigid))
            if length is not None:
                return replace(closure, frames=other, between=(),
                               geometry=closure_geometry(closure.pair, length=length))
        return closure

    def _turned(self, closure: Closure, tree: Tree) -> Closure:
        """Return a closure between frames of its own where its axes are turned."""
        if closure.name not in self.turns:
            return closure
        assert closure.geometry is not None
        frames = []
        for k, (name, axes) in enumerate(zip(
                closure.frames, (closure.geometry.axes1, closure.geometry.axes2), strict=True), 1):
            body, placement = self.bodies.frame(name)
            rotation = placement.rotation @ axes @ self.turns[closure.name]
            frames.append(tree.add(f"{closure.name}_{k}", Place(
                body, placement.translation, rotation[:, 2], rotation[:, 0])))
        return replace(closure, frames=tuple(frames), geometry=closure_geometry(closure.pair, Z))

    def keeps_spin(self, passive: Passive) -> bool:
        """Whether the body of a passive freedom still turns as it did."""
        joint = self.full.frame_on_joint(passive.body)[0]
        return joint not in self.lengthening and self.bodies.of(joint)[0] in self.moving

    def _passive(self, passive: Passive, tree: Tree) -> Passive:
        """Return a passive freedom, its axis between frames that exist."""
        joint = self.full.frame_on_joint(passive.body)[0]
        first, second = (
            tree.add(f"{passive.name}_{k}", Place(joint, point_on_body(self.full, joint, name)))
            for k, name in enumerate(passive.axis, 1))
        return replace(passive, axis=(first, second))


def _closure(name: str, made: Relation, tree: Tree) -> Closure:
    """Return a relation as a closure between z axes of frames of its own."""
    frames = tuple(tree.add(f"{name}_{k}", place) for k, place in enumerate(made.places, 1))
    ends = tuple(tree.add(f"{name}_end_{k}", place) for k, place in enumerate(made.between, 1))
    geometry = closure_geometry(PAIRS[made.type], Z, Z, length=0.0 if ends else made.length)
    return Closure(name, made.type, frames, geometry, between=ends)


def _words(made: Relation, others: str, count: int) -> str:
    """Return a relation in words, and the joints that change it."""
    kind = made.type.replace("_", " ")
    if made.between:
        return f"{kind} that {others} alone change{'s' * (count == 1)}"
    return f"{kind} {made.length:.9g} m" if made.length else kind


def _slopes(made: Mechanism) -> dict[str, Array]:
    """Return the derivatives of the equations of every closure, side by side at some places."""
    with evaluation_of(made) as evaluation:
        jacobians = []
        for q in open_configurations(made, made.neutral):
            evaluation.update(q)
            jacobians.append(evaluation.jacobian[: evaluation.constraints.n_closure].copy())
        labels = evaluation.constraints.labels
    stacked = np.hstack(jacobians)
    return {c.name: stacked[[label.closure == c.name for label in labels]] for c in made.closures}


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

