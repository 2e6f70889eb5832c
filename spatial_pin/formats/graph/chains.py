"""Chains of revolute joints through one point, with massless links between them, are one pair.

Three are a ball, two a universal joint. Only joints of loops are replaced, and none of which
anything else is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin

from spatial_pin.formats.graph.joints import Joint, JointGraph, joints_at
from spatial_pin.numerics.linalg import Array

SQUARE = 1e-3  # cosine of revolute axes, from which on three in a chain miss directions of a ball


def without_chains(graph: JointGraph) -> tuple[JointGraph, tuple[str, ...]]:
    """Put one pair in the place of revolute joints that meet in a point, between massless links."""
    notices: list[str] = []
    looped = in_loops(graph.joints)
    pairs: dict[str, Joint] = {}  # by the first joint of the chain
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


def in_loops(joints: Sequence[Joint]) -> set[str]:
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
    top = {link: link for link in depth}  # the first link above with a joint not yet found

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


def _chains(graph: JointGraph, count: int) -> list[list[Joint]]:
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


def _common_point(points: Array, axes: Array, rounding: float) -> Array | None:
    """Return the point (3,) in which lines meet, None where they do not to within rounding."""
    away = [np.eye(3) - np.outer(a, a) for a in axes]
    total = np.sum(away, axis=0)
    centre: Array = points[0] + np.linalg.solve(total, np.sum(
        [p @ (x - points[0]) for p, x in zip(away, points, strict=True)], axis=0))
    misses = [float(np.linalg.norm(p @ (x - centre))) for p, x in zip(away, points, strict=True)]
    size = max(float(np.abs(points).max()), float(np.linalg.norm(points - centre, axis=1).max()))
    return centre if max(misses) <= 10.0 * rounding * size else None


def _one_pair(kind: str, chain: Sequence[Joint], rounding: float) -> Joint | None:
    """Return the pair that a chain is, None where its axes miss each other or a direction."""
    points, axes, last = _lines(chain)
    largest = SQUARE if kind == "spherical" else 10.0 * rounding
    if any(abs(a @ b) > largest for a, b in pairwise(axes)):
        return None
    centre = _common_point(points, axes, rounding)
    if centre is None:
        return None
    frame = pin.SE3(np.eye(3), centre)
    second = axes[1] - axes[0] * (axes[0] @ axes[1])
    return Joint("+".join(joint.name for joint in chain), kind, chain[0].parent, chain[-1].child,
                 frame, last.inverse() * frame, axes[0], second / np.linalg.norm(second))
