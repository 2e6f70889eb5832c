"""Links and joints that form loops, to a spanning tree and the joints that close its loops.

Formats such as SDFormat and USD state a graph: every joint joins two links, whichever way round.
`span` picks the joints of the tree. Of every loop one joint is cut, preferably one that

1. the file itself says to cut,
2. nothing refers to: no driver, limit or spring, which act on the coordinates of the tree,
3. leaves few equations to close: a ball, then a universal joint, then a revolute joint,
4. has no damping, which a cut joint loses,

and so that the tree has short branches: it grows from its root breadth-first.
"""

from __future__ import annotations

import heapq
import math
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.linalg import Array
from spatial_pin.mechanism.pairs import JOINT_TYPES

WORLD = ""  # what links are joined to that stands still
TURN = 2.0 * math.pi - 1e-3  # rad; limits so far apart hold nothing back
SQUARE = 1e-3  # cosine of revolute axes, from which on three in a chain miss directions of a ball
KEPT = {"fixed": 0, "revolute": 2, "universal": 3, "spherical": 4, "floating": 5}  # others: 1
X, Y, Z = np.eye(3)


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
class Joint:
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
        cut: whether the file says that it closes a loop.
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
        """Whether nothing is said of it but which links it joins and how."""
        return not (self.cut or self.is_limited or self.resists or self.stiffness)

    def other(self, link: str) -> str:
        """Return the link at its other end."""
        return self.child if link == self.parent else self.parent

    def but(self, **changes: Any) -> Joint:
        """Return the same joint with changes."""
        return replace(self, **changes)

    def turned(self) -> Joint:
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
    """What a file says of its links and joints.

    Attributes:
        links, joints: in the order of the file.
        loose: whether the graph has a world, in which what is not joined to it floats; otherwise
            its roots, links that are no joint's child, stand on the ground, and joints are taken
            from parent to child where that is possible.
        held: whether that is fixed to the world instead.
        needed: names of joints whose coordinates something refers to.
        rounding: relative size of the last digit of the file's numbers.
    """

    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    loose: bool = True
    held: bool = False
    needed: frozenset[str] = frozenset()
    rounding: float = 1e-12


@dataclass(frozen=True, eq=False)
class SpanningTree:
    """A joint graph whose loops are cut.

    Attributes:
        graph: the graph, chains of revolute joints that are one pair replaced.
        joints: those of the tree, parents first, each from the link nearer to the root.
        turned: names of the joints among them that the file has the other way round.
        roots: links that no joint of the tree leads to, the world apart.
        cut: the other joints.
        notices: what was changed, a sentence each.
    """

    graph: JointGraph
    joints: tuple[Joint, ...]
    turned: frozenset[str]
    roots: tuple[str, ...]
    cut: tuple[Joint, ...]
    notices: tuple[str, ...] = ()


def span(graph: JointGraph) -> SpanningTree:
    """Return the spanning tree of a joint graph.

    Every joint must join two different links that exist, or one and the world.
    """
    graph, notices = _without_chains(graph)
    growth = _Growth(graph)
    for start, directed in _starts(graph):
        growth.grow([x for x in start if x not in growth.reached], directed)
    kept = {joint.name for joint in growth.tree}
    cut = tuple(joint for joint in graph.joints if joint.name not in kept)
    roots = tuple(root for root in growth.roots if root != WORLD)
    return SpanningTree(graph, tuple(growth.tree), frozenset(growth.turned), roots, cut, notices)


class _Growth:
    """A spanning tree that grows."""

    def __init__(self, graph: JointGraph) -> None:
        self.graph = graph
        self.meeting = _meeting(graph.joints)
        self.order = {joint.name: k for k, joint in enumerate(graph.joints)}
        self.reached: set[str] = set()
        self.tree: list[Joint] = []
        self.turned: set[str] = set()
        self.roots: list[str] = []

    def grow(self, roots: Sequence[str], directed: bool) -> None:
        """Let the tree grow from roots until nothing more is joined to it.

        Args:
            roots: links where it begins.
            directed: whether joints are to be taken from parent to child where possible.
        """
        edges: list[tuple[Any, ...]] = []
        self.roots += roots
        self.reached.update(roots)
        for root in roots:
            self.look_round(root, 0, edges, directed)
        while edges:
            *_, depth, _, k, against = heapq.heappop(edges)
            joint = self.graph.joints[k].turned() if against else self.graph.joints[k]
            if joint.child in self.reached:
                continue
            self.reached.add(joint.child)
            self.tree.append(joint)
            self.turned |= {joint.name} if against else set()
            self.look_round(joint.child, depth + 1, edges, directed)

    def look_round(
        self, link: str, depth: int, edges: list[tuple[Any, ...]], directed: bool
    ) -> None:
        """Put the joints that lead on from a link on the heap, the ones to be kept first."""
        for joint in self.meeting.get(link, ()):
            if joint.other(link) in self.reached or joint.type not in JOINT_TYPES:
                continue
            against = joint.child == link
            heapq.heappush(edges, (
                against and directed, *self.reluctance(joint), depth, against,
                self.order[joint.name], against))

    def reluctance(self, joint: Joint) -> tuple[Any, ...]:
        """Return a key by which joints are cut, the last first; see the module's docstring."""
        referred = joint.name in self.graph.needed or joint.is_limited or joint.stiffness
        return joint.cut, not referred, KEPT.get(joint.type, 1), not joint.resists


def _meeting(joints: Iterable[Joint]) -> dict[str, list[Joint]]:
    """Return the joints at every link."""
    meeting: dict[str, list[Joint]] = defaultdict(list)
    for joint in joints:
        meeting[joint.parent].append(joint)
        meeting[joint.child].append(joint)
    return meeting


def _starts(graph: JointGraph) -> list[tuple[list[str], bool]]:
    """Return where the tree begins, what stands first, and whether directions count there."""
    children = {joint.child for joint in graph.joints}
    names = [link.name for link in graph.links]
    roots = [name for name in names if name not in children]
    others = [[name] for name in names if name in children]
    standing = [([WORLD], False), *(([x], False) for x in roots)] if graph.loose else [
        (roots, True)]
    return [*standing, *((x, False) for x in others)]


# ---------------------------------------------------------------- chains that are one pair


def _without_chains(graph: JointGraph) -> tuple[JointGraph, tuple[str, ...]]:
    """Put one pair in the place of revolute joints that meet in a point, between massless links."""
    notices: list[str] = []
    for count, make in ((3, _ball), (2, _universal)):
        for chain in _chains(graph, count):
            known = {joint.name for joint in graph.joints}
            if any(joint.name not in known for joint in chain) or not _in_a_loop(graph, chain):
                continue  # a joint of another chain by now, or one that closes nothing
            pair = make(chain, graph.rounding)
            if pair is None:
                continue
            gone = {joint.child for joint in chain[:-1]}
            names = [joint.name for joint in chain]
            notices.append(
                f"the revolute joints {', '.join(names)} meet in one point with massless links "
                f"between them: they are the {pair.type} joint {pair.name!r}")
            graph = replace(
                graph, links=tuple(x for x in graph.links if x.name not in gone),
                joints=tuple(pair if x.name == names[0] else x for x in graph.joints
                             if x.name not in names[1:]))
    return graph, tuple(notices)


def _chains(graph: JointGraph, count: int) -> list[list[Joint]]:
    """Return the chains of `count` bare revolute joints with nothing on the links between them."""
    meeting = _meeting(graph.joints)
    between = {
        link.name for link in graph.links
        if link.massless and all(x.tag == "inertial" for x in link.elements)
        and len(meeting[link.name]) == 2
        and all(joint.type == "revolute" and joint.is_bare and joint.name not in graph.needed
                for joint in meeting[link.name])}
    chains, seen = [], set()
    for first in graph.joints:
        for start in (first.parent, first.child):
            chain: list[Joint] = []
            at = start
            joint: Joint | None = first
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


def _in_a_loop(graph: JointGraph, chain: Sequence[Joint]) -> bool:
    """Whether the ends of a chain are joined without it, too."""
    names = {joint.name for joint in chain}
    meeting = _meeting(joint for joint in graph.joints if joint.name not in names)
    reached, waiting = {chain[0].parent}, [chain[0].parent]
    while waiting:
        link = waiting.pop()
        new = {joint.other(link) for joint in meeting.get(link, ())} - reached
        reached |= new
        waiting += new
    return chain[-1].child in reached


def _lines(chain: Sequence[Joint]) -> tuple[Array, Array, pin.SE3]:
    """Return points and directions (n, 3) of a chain's axes, on its first link, and its last link.

    All at zero of its coordinates.
    """
    points, axes, at = [], [], pin.SE3.Identity()
    for joint in chain:
        frame = at * joint.on_parent
        points.append(frame.translation)
        axes.append(frame.rotation @ joint.axis)
        at = frame * joint.on_child.inverse()
    return np.array(points), np.array(axes), at


def _meeting_point(points: Array, axes: Array, rounding: float) -> Array | None:
    """Return the point (3,) in which lines meet, None where they do not to within rounding."""
    away = [np.eye(3) - np.outer(a, a) for a in axes]
    total = np.sum(away, axis=0)
    centre: Array = points[0] + np.linalg.solve(total, np.sum(
        [p @ (x - points[0]) for p, x in zip(away, points, strict=True)], axis=0))
    misses = [float(np.linalg.norm(p @ (x - centre))) for p, x in zip(away, points, strict=True)]
    size = max(float(np.abs(points).max()), float(np.linalg.norm(points - centre, axis=1).max()))
    return centre if max(misses) <= 10.0 * rounding * size else None


def _ball(chain: Sequence[Joint], rounding: float) -> Joint | None:
    points, axes, last = _lines(chain)
    if abs(axes[0] @ axes[1]) > SQUARE or abs(axes[1] @ axes[2]) > SQUARE:
        return None
    return _one_pair("spherical", chain, points, axes, last, rounding)


def _universal(chain: Sequence[Joint], rounding: float) -> Joint | None:
    points, axes, last = _lines(chain)
    if abs(axes[0] @ axes[1]) > 10.0 * rounding:
        return None
    return _one_pair("universal", chain, points, axes, last, rounding)


def _one_pair(
    kind: str, chain: Sequence[Joint], points: Array, axes: Array, last: pin.SE3, rounding: float
) -> Joint | None:
    centre = _meeting_point(points, axes, rounding)
    if centre is None:
        return None
    frame = pin.SE3(np.eye(3), centre)
    second = axes[1] - axes[0] * (axes[0] @ axes[1])
    return Joint("+".join(joint.name for joint in chain), kind, chain[0].parent, chain[-1].child,
                 frame, last.inverse() * frame, axes[0], second / np.linalg.norm(second))
