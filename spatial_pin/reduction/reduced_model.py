"""A reduced mechanism in the making: what moves, what closes, what is written."""

from __future__ import annotations

import numpy as np

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.mechanism.parts import Closure, Passive
from spatial_pin.numerics.linalg import Array
from spatial_pin.reduction.influence import NeededParts, OutputInfluence, RequestedOutputs
from spatial_pin.reduction.relations import (
    BodyFrame,
    Relation,
    Surroundings,
    WeldedBodies,
    open_configurations,
)

Omitted = tuple[str, str, str]


class ReducedModel:
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

    def __init__(
        self, mechanism: Mechanism, q: Array, kept: NeededParts, influence: OutputInfluence,
        asked: RequestedOutputs, *, dynamics: bool, lump: bool,
    ) -> None:
        self.full, self.q, self.kept, self.influence = mechanism, q, kept, influence
        self.asked, self.dynamics, self.lump = asked, dynamics, lump
        self.moving, self.welded = set(kept.moving), set(kept.welded)
        self.lengthening: set[int] = set()  # joints that only make a distance longer
        self.bodies = WeldedBodies(mechanism, q, kept.welded)
        self.closures: list[Closure] = []
        for closure in (mechanism.closures[k] for k in kept.closures):
            coupled = {mechanism.joint_id(mechanism.coordinate(n).joint) for n in closure.joints}
            if closure.type != COUPLING or coupled & self.moving:  # else it is locked
                self.closures.append(closure)
        self.relations: list[tuple[str, Relation]] = []
        self.masses: list[tuple[str, BodyFrame, float]] = []
        self.turns: dict[str, Array] = {}  # of closures' axes
        self.equations: dict[str, tuple[int, ...]] = {}  # that are needed, where not all are
        self.notes: list[Omitted] = []
        free = np.zeros(mechanism.model.nv)
        for i in self.moving:
            free[influence.columns[i]] = 1.0
        self.around = Surroundings(mechanism, open_configurations(mechanism, q, free))

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

    def link(self, i: int) -> str:
        """Return the name of the link that joint i moves."""
        return next(name for name in self.full.links if self.full.frame_on_joint(name)[0] == i)

    def keeps_spin(self, passive: Passive) -> bool:
        """Whether the body of a passive freedom still turns as it did."""
        joint = self.full.frame_on_joint(passive.body)[0]
        return joint not in self.lengthening and self.bodies.of(joint)[0] in self.moving
