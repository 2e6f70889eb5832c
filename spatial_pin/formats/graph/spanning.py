"""A joint graph to a spanning tree and the joints that close its loops.

Of every loop one joint is cut, preferably one that

1. the file itself says to cut,
2. nothing refers to: no driver, coupling or mimic, which need a coordinate of the tree,
3. has no limits and no spring, which a cut joint loses,
4. leaves few equations to close: a ball, then a universal joint, then a revolute joint,
5. has no damping, which a cut joint loses, too,

and so that the tree has short branches: it grows from its root breadth-first.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from spatial_pin.formats.graph.chains import without_chains
from spatial_pin.formats.graph.joints import WORLD, Joint, JointGraph, joints_at
from spatial_pin.mechanism.pairs import JOINT_TYPES

KEPT = {"fixed": 0, "revolute": 2, "universal": 3, "spherical": 4, "floating": 5}  # others: 1


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
    graph, notices = without_chains(graph)
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
        self.meeting = joints_at(graph.joints)
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
        referred, held = joint.name in self.graph.needed, joint.is_limited or joint.stiffness
        return joint.cut, not referred, not held, KEPT.get(joint.type, 1), not joint.resists


def _starts(graph: JointGraph) -> list[tuple[list[str], bool]]:
    """Return where the tree begins, what stands first, and whether directions count there."""
    children = {joint.child for joint in graph.joints}
    names = [link.name for link in graph.links]
    roots = [name for name in names if name not in children]
    others = [[name] for name in names if name in children]
    standing = [([WORLD], False), *(([x], False) for x in roots)] if graph.loose else [
        (roots, True)]
    return [*standing, *((x, False) for x in others)]
