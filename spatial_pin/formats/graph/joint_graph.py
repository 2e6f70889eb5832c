"""Links and joints as a graph, and its spanning tree: every joint joins two links.

Of every loop one joint is cut, preferably one that

1. the file itself cuts,
2. nothing refers to: no driver, coupling or mimic, which need a coordinate of the tree,
3. has no limits and no spring, which a cut joint loses,
4. leaves few equations to close: a ball, then a universal joint, then a revolute joint,
5. has no damping, which a cut joint loses, too,

and so that the tree has short branches: it grows from its root breadth-first.
"""

from __future__ import annotations

import heapq
import math
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.pairs import JOINT_TYPES
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


SQUARE = 1e-3  # cosine of revolute axes, from which on three in a chain miss directions of a ball
FREEDOMS = {"fixed": 0, "revolute": 2, "universal": 3, "spherical": 4, "floating": 5}  # others: 1


def without_chains(graph: JointGraph) -> tuple[JointGraph, tuple[str, ...]]:
    """Put one pair in the place of revolute joints that meet in a point, between massless links.

    Three are a ball, two a universal joint. Only joints of loops are replaced, and none with
    limits, resistance or a spring.
    """
    notices: list[str] = []
    looped = in_loops(graph.joints)
    pairs: dict[str, GraphJoint] = {}  # by the first joint of the chain
    taken: set[str] = set()
    gone: set[str] = set()
    for count, kind in ((3, "spherical"), (2, "universal")):
        for chain in _chains(graph, count):
            names = [joint.name for joint in chain]
            if chain[0].name not in looped or taken & set(names):
                continue  # it closes nothing, or a joint is one of another chain by now
            pair = _one_pair(kind, chain, graph.rounding)
            if pair is None:
                continue
            pairs[names[0]] = pair
            taken.update(names)
            gone.update(joint.child for joint in chain[:-1])
            notices.append(
                f"the revolute joints {', '.join(names)} meet in one point with massless links "
                f"between them: they are the {pair.type} joint {pair.name!r}")
    return replace(
        graph, links=tuple(x for x in graph.links if x.name not in gone),
        joints=tuple(pairs.get(x.name, x) for x in graph.joints
                     if x.name in pairs or x.name not in taken)), tuple(notices)


def in_loops(joints: Sequence[GraphJoint]) -> set[str]:
    """Return the names of the joints that are part of a loop."""
    meeting = joints_at(joints)
    above: dict[str, tuple[str, str]] = {}  # link -> joint and link before it
    depth: dict[str, int] = {}
    for start in meeting:
        waiting = [] if start in depth else [start]
        depth.setdefault(start, 0)
        while waiting:
            link = waiting.pop()
            for joint in meeting[link]:
                other = joint.other(link)
                if other not in depth:
                    depth[other] = depth[link] + 1
                    above[other] = joint.name, link
                    waiting.append(other)
    top = {link: link for link in depth}  # the first link above with a joint outside all loops

    def climb(link: str) -> str:
        while top[link] != link:
            top[link] = top[top[link]]
            link = top[link]
        return link

    tree = {name for name, _ in above.values()}
    looped = {joint.name for joint in joints if joint.name not in tree}
    for joint in joints:
        if joint.name in tree:
            continue
        one, two = climb(joint.parent), climb(joint.child)
        while one != two:
            low, high = (one, two) if depth[one] >= depth[two] else (two, one)
            name, link = above[low]
            looped.add(name)
            top[low] = link
            one, two = climb(low), high
    return looped


def _chains(graph: JointGraph, count: int) -> list[list[GraphJoint]]:
    """Return the chains of `count` bare revolute joints with nothing on the links between them."""
    meeting = joints_at(graph.joints)
    between = {
        link.name for link in graph.links
        if link.massless and all(x.tag == "inertial" for x in link.elements)
        and len(meeting[link.name]) == 2
        and all(joint.type == "revolute" and joint.is_bare and joint.name not in graph.needed
                for joint in meeting[link.name])}
    chains, seen = [], set()
    for first in graph.joints:
        for start in (first.parent, first.child):
            chain: list[GraphJoint] = []
            at = start
            joint: GraphJoint | None = first
            while joint is not None and len(chain) < count:
                chain.append(joint if joint.parent == at else joint.turned())
                at = chain[-1].child
                last = joint.name
                joint = next((x for x in meeting[at] if x.name != last), None) \
                    if at in between else None
            names = frozenset(x.name for x in chain)
            ends = {chain[0].parent, chain[-1].child}
            if len(names) == count and names not in seen and len(ends) == 2 \
                    and all(x.child in between for x in chain[:-1]):
                seen.add(names)
                chains.append(chain)
    return chains


def _one_pair(kind: str, chain: Sequence[GraphJoint], rounding: float) -> GraphJoint | None:
    """Return the pair that a chain is, None where its axes miss each other or a direction."""
    at, frames = pin.SE3.Identity(), []  # on the first link, all at zero of its coordinates
    for joint in chain:
        frames.append(at * joint.on_parent)
        at = frames[-1] * joint.on_child.inverse()
    points = np.array([frame.translation for frame in frames])
    axes = [frame.rotation @ joint.axis for frame, joint in zip(frames, chain, strict=True)]
    largest = SQUARE if kind == "spherical" else 10.0 * rounding
    if any(abs(a @ b) > largest for a, b in pairwise(axes)):
        return None
    across = [np.eye(3) - np.outer(a, a) for a in axes]
    centre: Array = points[0] + np.linalg.solve(np.sum(across, axis=0), np.sum(
        [p @ (x - points[0]) for p, x in zip(across, points, strict=True)], axis=0))
    gaps = [float(np.linalg.norm(p @ (x - centre))) for p, x in zip(across, points, strict=True)]
    size = max(float(np.abs(points).max()), float(np.linalg.norm(points - centre, axis=1).max()))
    if max(gaps) > 10.0 * rounding * size:
        return None
    frame, second = pin.SE3(np.eye(3), centre), axes[1] - axes[0] * (axes[0] @ axes[1])
    return GraphJoint(
        "+".join(joint.name for joint in chain), kind, chain[0].parent, chain[-1].child, frame,
        at.inverse() * frame, axes[0], second / np.linalg.norm(second))


class SpanningTree:
    """A joint graph whose loops are cut.

    Every joint must join two different links that exist, or one and the world.

    Attributes:
        graph: the graph, chains of revolute joints that are one pair replaced.
        joints: those of the tree, parents first, each from the link nearer to the root.
        turned: names of the joints among them that the file has the other way round.
        roots: links that no joint of the tree leads to, the world apart.
        cut: the other joints.
        notices: of changes, a sentence each.
    """

    def __init__(self, graph: JointGraph) -> None:
        self.graph, self.notices = without_chains(graph)
        self.joints: list[GraphJoint] = []
        self.turned: set[str] = set()
        self.roots: list[str] = []
        self._reached: set[str] = set()
        self._meeting = joints_at(self.graph.joints)
        self._order = {joint.name: k for k, joint in enumerate(self.graph.joints)}
        children = {joint.child for joint in self.graph.joints}
        names = [link.name for link in self.graph.links]
        roots = [name for name in names if name not in children]
        if self.graph.loose:
            for root in (WORLD, *roots):
                self._grow([root], False)
        else:
            self._grow(roots, True)
        for name in names:
            self._grow([name], False)
        tree = {joint.name for joint in self.joints}
        self.cut = tuple(joint for joint in self.graph.joints if joint.name not in tree)

    def _grow(self, roots: Sequence[str], directed: bool) -> None:
        """Let the tree grow from links, if it has not reached them, as far as joints lead."""
        edges: list[tuple[Any, ...]] = []

        def look_round(link: str, depth: int) -> None:
            """Put the joints that lead on from a link on the heap, the ones to stay first."""
            for joint in self._meeting.get(link, ()):
                if joint.other(link) in self._reached or joint.type not in JOINT_TYPES:
                    continue
                against = joint.child == link
                held = joint.is_limited or joint.stiffness
                reluctance = (joint.cut, joint.name not in self.graph.needed, not held,
                              FREEDOMS.get(joint.type, 1), not joint.resists)
                heapq.heappush(edges, (against and directed, *reluctance, depth, against,
                                       self._order[joint.name], against))

        new = [root for root in roots if root not in self._reached]
        self.roots += [root for root in new if root != WORLD]
        self._reached.update(new)
        for root in new:
            look_round(root, 0)
        while edges:
            *_, depth, _, k, against = heapq.heappop(edges)
            joint = self.graph.joints[k].turned() if against else self.graph.joints[k]
            if joint.child in self._reached:
                continue
            self._reached.add(joint.child)
            self.joints.append(joint)
            self.turned |= {joint.name} if against else set()
            look_round(joint.child, depth + 1)
