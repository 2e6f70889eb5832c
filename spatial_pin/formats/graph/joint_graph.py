"""Links and joints as a graph: every joint joins two links, whichever way round."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.numerics.linalg import Array

WORLD = ""  # the ground, as a link
TURN = 2.0 * math.pi - 1e-3  # rad; limits so far apart hold nothing back
Y, Z = np.eye(3)[1:]


@dataclass(frozen=True, eq=False)
class Link:
    """A link of a joint graph.

    Attributes:
        name: of the link.
        placement: in the world as the file draws it, None where it does not say.
        elements: what its URDF element holds: <inertial>, <visual>, <collision>.
        massless: whether it has neither mass nor moments of inertia.
    """

    name: str
    placement: pin.SE3 | None = None
    elements: tuple[ET.Element, ...] = ()
    massless: bool = True


@dataclass(frozen=True, eq=False)
class GraphJoint:
    """A joint of a joint graph. Its two frames coincide where its coordinates are zero.

    Attributes:
        name, type: of the joint; a pair of `PAIRS`.
        parent, child: links; `WORLD` for the world.
        on_parent, on_child: placement of the joint's frame on either link.
        axis, axis2: (3,) unit vectors in the joint's frame.
        lead: translation per turn of a screw [m].
        length: of a distance [m].
        lower, upper: limits of its one coordinate [rad, m].
        effort, velocity: largest ones [N·m, N; rad/s, m/s].
        damping, friction, armature: of each of its coordinates.
        stiffness, reference: of the spring on its one coordinate, and where that is at rest.
        cut: whether the file states that it closes a loop.
        element: its URDF element, where it has one.
    """

    name: str
    type: str
    parent: str
    child: str
    on_parent: pin.SE3 = field(default_factory=pin.SE3.Identity)
    on_child: pin.SE3 = field(default_factory=pin.SE3.Identity)
    axis: Array = field(default_factory=lambda: Z)
    axis2: Array = field(default_factory=lambda: Y)
    lead: float = 0.0
    length: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    effort: float = math.inf
    velocity: float = math.inf
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    reference: float = 0.0
    cut: bool = False
    element: ET.Element | None = None

    @property
    def is_limited(self) -> bool:
        """Whether a limit holds it back."""
        span = self.upper - self.lower
        return (math.isfinite(span) and not (self.type == "revolute" and span >= TURN)) or (
            math.isinf(span) and (math.isfinite(self.lower) or math.isfinite(self.upper)))

    @property
    def resists(self) -> bool:
        """Whether it resists motion by itself."""
        return bool(self.damping or self.friction or self.armature)

    @property
    def is_bare(self) -> bool:
        """Whether it has neither limits nor resistance nor a spring."""
        return not (self.cut or self.is_limited or self.resists or self.stiffness)

    def other(self, link: str) -> str:
        """Return the link at its other end."""
        return self.child if link == self.parent else self.parent

    def with_changes(self, **changes: Any) -> GraphJoint:
        """Return the same joint with changes."""
        return replace(self, **changes)

    def turned(self) -> GraphJoint:
        """Return the same joint from child to parent; one coordinate keeps its name and sign.

        The inverse of a motion about or along an axis is the same about or along the opposite
        one; that of a universal joint takes its two pins in the opposite order.
        """
        first, second = (self.axis2, self.axis) if self.type == "universal" else (
            self.axis, self.axis2)
        return replace(self, parent=self.child, child=self.parent, on_parent=self.on_child,
                       on_child=self.on_parent, axis=-first, axis2=-second)


@dataclass(frozen=True, eq=False)
class JointGraph:
    """Links and joints of a file.

    Attributes:
        links, joints: in the order of the file.
        loose: whether the graph has a world, in which links without a joint to it float; otherwise
            its roots, links that are no joint's child, are on the ground, and joints are taken
            from parent to child where that is possible.
        held: whether that is fixed to the world instead.
        needed: names of joints whose coordinates something refers to.
        rounding: relative size of the last digit of the file's numbers.
    """

    links: tuple[Link, ...]
    joints: tuple[GraphJoint, ...]
    loose: bool = True
    held: bool = False
    needed: frozenset[str] = frozenset()
    rounding: float = 1e-12


def joints_at(joints: Iterable[GraphJoint]) -> dict[str, list[GraphJoint]]:
    """Return the joints at every link."""
    meeting: dict[str, list[GraphJoint]] = defaultdict(list)
    for joint in joints:
        meeting[joint.parent].append(joint)
        meeting[joint.child].append(joint)
    return meeting
