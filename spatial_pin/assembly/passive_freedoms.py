"""Passive freedoms: motions of one link that move nothing else.

One link is what stands together: bodies that drivers hold to each other, and those that closures
weld, as a rod that was cut in two; also the parts of a rod that slide on each other, as it turns. A
ball, or a universal joint, may be a chain of hinges whose axes meet: its links turn as the two that
it joins ask for, and nobody looks at them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure, Coordinate
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

# Twist of a body that rests relative to that of the one that moves most: null vectors are known to
# round-off over the least singular value, which `near_singular` leaves: 2e-11; far above that, and
# below what the shortest lever makes that files with six digits have.
RESTING = 1e-8
WELDS = ("weld", "fixed")
SLIDES, POINTS = ("prismatic", "cylindrical"), ("spherical", "distance")
HINGES = {"revolute": 1, "universal": 2}  # pairs that a chain is made of, and their axes
# Mass of a link of a chain, at most, relative to the heaviest body: what files give links that are
# there for their joint only, a gram in a ton.
WITHOUT_MASS = 1e-6


def driven_groups(
    mechanism: Mechanism, driven: Iterable[Coordinate] | None = None
) -> list[int]:
    """Return for every body (by its joint's index) the first body that it stands together with.

    The two halves of a driven telescopic leg are one body as long as the driver stands still; so
    are those of a rod that a closure welds.

    Args:
        mechanism: the mechanism.
        driven: what is prescribed; default the drivers.
    """
    if driven is None:
        driven = list(driver_coordinates(mechanism).values())
    return _groups(mechanism, frozenset(c.name for c in driven))


@made_once
def _groups(mechanism: Mechanism, driven: frozenset[str]) -> list[int]:
    model = mechanism.model
    names: dict[str, list[str]] = {}
    for c in mechanism.coordinate_table.values():
        names.setdefault(c.joint, []).append(c.name)
    groups = list(range(model.njoints))
    for i in range(1, model.njoints):
        if driven.issuperset(names[model.names[i]]):
            groups[i] = groups[model.parents[i]]
    for closure in mechanism.closures:
        if closure.type in WELDS and closure.equations is None:
            low, high = sorted(groups[mechanism.frame_on_joint(f)[0]] for f in closure.frames)
            groups = [low if g == high else g for g in groups]
    return groups


def is_in_loop(mechanism: Mechanism, joint: str) -> bool:
    """Whether the body of a joint, with what stands together with it, carries more than a pair."""
    return _in_loops(mechanism)[mechanism.joint_id(joint)]


@made_once
def _in_loops(mechanism: Mechanism) -> list[bool]:
    """Return for every body (by its joint's index) whether it is."""
    groups = np.array(driven_groups(mechanism))
    pairs = np.bincount([groups[body] for ends in _pairs(mechanism) for body in ends
                         if groups[ends[0]] != groups[ends[1]]], minlength=len(groups))
    found: list[bool] = (pairs[groups] > 1).tolist()
    return found


def _pairs(mechanism: Mechanism) -> list[tuple[int, int]]:
    """Return the two bodies, by joint, of every pair; couplings join none."""
    model = mechanism.model
    pairs = [(int(model.parents[i]), i) for i in range(1, model.njoints)]
    for closure in mechanism.closures:
        for one, other in closure.joined:
            pairs.append((mechanism.frame_on_joint(one)[0], mechanism.frame_on_joint(other)[0]))
    return pairs


# ---------------------------------------------------------------- links of chains


class Ball(NamedTuple):
    """A ball that is written as hinges about three axes which meet.

    Attributes:
        ends: the two bodies that it joins.
        inside: the bodies between its hinges.
    """

    ends: tuple[int, int]
    inside: frozenset[int]


@made_once
def chain_links(mechanism: Mechanism) -> frozenset[int]:
    """Return the bodies inside balls and universal joints that are written as chains of hinges.

    They weigh nothing, and carry two hinges, not driven nor coupled, whose centres are one point.
    Where nothing at all weighs, nobody can tell them from shafts: there are none.
    """
    masses = np.array([inertia.mass for inertia in mechanism.model.inertias])
    if not masses.any():
        return frozenset()
    return frozenset(i for i in _between_hinges(mechanism)
                     if masses[i] <= WITHOUT_MASS * masses.max())


@made_once
def balls_of_hinges(mechanism: Mechanism) -> list[Ball]:
    """Return the balls that are written as hinges about three axes, whatever is inside weighs."""
    inside, groups = _between_hinges(mechanism), list[set[int]]()
    for ends, _ in _kinds_of_pairs(mechanism):
        joined = {*ends} & inside
        if joined:
            near = [group for group in groups if group & joined]
            groups = [group for group in groups if not group & joined]
            groups.append(joined.union(*near))
    balls = []
    for group in groups:
        hinges = [(ends, kind) for ends, kind in _kinds_of_pairs(mechanism) if group & {*ends}]
        axes = sum(HINGES[kind] for _, kind in hinges)
        outer = [body for ends, _ in hinges for body in ends if body not in group]
        if axes == 3 and len(outer) == 2:
            balls.append(Ball((outer[0], outer[1]), frozenset(group)))
    return balls


@made_once
def inside_links(mechanism: Mechanism) -> frozenset[int]:
    """Return the bodies inside balls that are written as hinges."""
    return frozenset().union(*(ball.inside for ball in balls_of_hinges(mechanism)))


@made_once
def unseen_links(mechanism: Mechanism) -> frozenset[int]:
    """Return the bodies inside balls and universal joints, at which nobody looks.

    What is inside a ball of hinges between the ground and what is no rod may be a shaft.
    """
    balls = [ball for ball in balls_of_hinges(mechanism)
             if 0 not in ball.ends or _is_rod(mechanism, max(ball.ends))]
    return chain_links(mechanism).union(*(ball.inside for ball in balls))


def _is_rod(mechanism: Mechanism, body: int) -> bool:
    """Whether a body, with those that slide on it, is held at points only, at two or more."""
    balls, inside, own = balls_of_hinges(mechanism), inside_links(mechanism), {body}
    pairs = [(ends, kind) for ends, kind in _kinds_of_pairs(mechanism) if not inside & {*ends}]
    pairs += [(ball.ends, POINTS[0]) for ball in balls]
    for _ in pairs:
        for ends, kind in pairs:
            if kind in (*SLIDES, *WELDS) and own & {*ends}:
                own |= {*ends}
    held = [kind for ends, kind in pairs if own & {*ends} and not {*ends} <= own]
    return 0 not in own and len(held) > 1 and all(kind in POINTS for kind in held)


def _kinds_of_pairs(mechanism: Mechanism) -> list[tuple[tuple[int, int], str]]:
    """Return the two bodies of every pair, and what it is: of a part of one nothing."""
    kinds = [*mechanism.pairs]
    for closure in mechanism.closures:
        kinds += [closure.type if closure.equations is None else ""] * len(closure.joined)
    return list(zip(_pairs(mechanism), kinds, strict=True))


@made_once
def _between_hinges(mechanism: Mechanism) -> frozenset[int]:
    """Return bodies that carry two hinges alone, not driven nor coupled, whose axes meet."""
    model = mechanism.model
    counted = np.bincount([body for ends in _pairs(mechanism) for body in ends],
                          minlength=model.njoints)
    moved = {mechanism.coordinate(name).joint for name in (
        *(d.joint for d in mechanism.drivers.values()),
        *(name for c in mechanism.closures for name in c.joints))}
    closures: dict[int, list[Closure]] = {}
    for closure in mechanism.closures:
        for frame in (*closure.frames, *closure.between):
            closures.setdefault(mechanism.frame_on_joint(frame)[0], []).append(closure)
    found = []
    for i in range(1, model.njoints):
        if counted[i] != 2 or mechanism.pairs[i - 1] not in HINGES:
            continue
        joints = {model.names[i], *(model.names[k] for k in model.children[i])}
        if joints.isdisjoint(moved) and _meets(mechanism, i, closures.get(i, ())):
            found.append(i)
    return frozenset(found)


def _meets(mechanism: Mechanism, body: int, closures: Iterable[Closure]) -> bool:
    """Whether the other pair of a body is a hinge about another axis through the first one's."""
    model = mechanism.model
    for child in model.children[body]:
        kind, place = mechanism.pairs[child - 1], model.jointPlacements[child]
        axis = place.rotation @ _axis(mechanism, child)
    for closure in closures:
        kind = closure.type if closure.equations is None else "part"
        mine = [k for k, f in enumerate(closure.frames) if mechanism.frame_on_joint(f)[0] == body]
        if not mine:
            return False
        place = mechanism.frame_on_joint(closure.frames[mine[0]])[1]
        axes = closure.geometry.axes2 if mine[0] else closure.geometry.axes1
        axis = place.rotation @ axes[:, 2]
    if kind not in HINGES or np.linalg.norm(place.translation) > (
            TOLERANCES.nothing * mechanism.characteristic_length):
        return False
    if kind == mechanism.pairs[body - 1] == "revolute":
        sine = np.linalg.norm(np.cross(axis, _axis(mechanism, body)))
        return bool(sine > TOLERANCES.half_precision)
    return True


def _axis(mechanism: Mechanism, joint: int) -> Array:
    """Return the last axis (3,) of a joint that turns, in its own axes."""
    model = mechanism.model.joints[joint]
    data = model.createData()
    model.calc(data, mechanism.neutral)
    return np.array(data.S).reshape(6, -1)[3:, -1]


# ---------------------------------------------------------------- motions


def passive_freedoms(
    evaluation: LoopEquations, null_space: Array, driven: Iterable[Coordinate] | None = None
) -> list[tuple[str, Array]]:
    """Return (joint name, (k, nv) velocities) for the motions that move one link only.

    A link is named by the first of its bodies. Links inside its balls may move with it.

    Args:
        evaluation: at the configuration in question.
        null_space: (k, nv) joint velocities that move neither drivers nor open a loop.
        driven: what is prescribed; default the drivers.
    """
    mechanism = evaluation.mechanism
    twists = _twists(evaluation, null_space)
    groups = np.array(driven_groups(mechanism, driven))
    moves = np.append(False, np.abs(twists).max(axis=(1, 2), initial=0.0) > RESTING)
    links: list[tuple[int, ...]] = [
        (group,) for group in sorted(set(groups[moves].tolist()) - {0})]
    rods: list[set[int]] = []  # of several groups of bodies, that slide on each other
    for ends, kind in _kinds_of_pairs(mechanism):
        joined = set(groups[list(ends)].tolist())
        if kind == "prismatic" and len(joined) == 2 and 0 not in joined:
            near = [x for x in rods if x & joined]
            rods = [x for x in rods if not x & joined]
            rods.append(joined.union(*near))
    links += [tuple(sorted(x)) for x in rods
              if _is_rod(mechanism, min(x)) and moves[list(x)].all()]
    found: list[tuple[str, Array]] = []
    for link in links:
        alone = _alone(mechanism, twists, groups, moves, link)
        if len(alone):
            found.append((mechanism.model.names[link[0]], alone @ null_space))
    return found


def _alone(
    mechanism: Mechanism, twists: Array, groups: NDArray[np.intp], moves: NDArray[np.bool_],
    link: tuple[int, ...],
) -> Array:
    """Return which motions (m, k) of k move a link alone; of several groups of bodies as one."""
    n = twists.shape[2]
    mine = [ball for ball in balls_of_hinges(mechanism)
            if not set(groups[list(ball.ends)].tolist()).isdisjoint(link)]
    inside = {body for ball in mine for body in ball.inside}
    partners = {int(groups[x]) for ends in _pairs(mechanism) for x in ends
                if not set(groups[list(ends)].tolist()).isdisjoint(link)} - inside
    partners |= {int(groups[body]) for ball in mine for body in ball.ends}
    # between two balls on the ground, written as hinges, stand the shafts of a double Cardan joint
    inside = inside if partners - {0, *link} else set()
    own = np.isin(groups, link)
    seen = moves & ~own
    seen[list(inside)] = False
    others = twists[seen[1:]].reshape(-1, n)
    for body in link[1:]:
        others = np.vstack([others, twists[body - 1] - twists[link[0] - 1]])
    if n == 1 and len(others) and np.abs(others).max() > RESTING:
        return np.zeros((0, n))
    svd = decompose(others)
    alone = svd.vt[np.count_nonzero(svd.s > RESTING):]
    if inside and len(alone):  # without what moves the insides of balls only
        turned = decompose(twists[own[1:]].reshape(-1, n) @ alone.T)
        alone = turned.vt[: np.count_nonzero(turned.s > RESTING)] @ alone
    return alone


def moved_bodies(evaluation: LoopEquations, velocities: Array) -> list[int]:
    """Return the bodies, by joint, that joint velocities (k, nv) move at the evaluation."""
    twists = _twists(evaluation, velocities)
    return (np.flatnonzero(np.abs(twists).max(axis=(1, 2), initial=0.0) > RESTING) + 1).tolist()


def _twists(evaluation: LoopEquations, velocities: Array) -> Array:
    """Return the twists (bodies, 6, k) of joint velocities (k, nv), the largest of size 1."""
    size = np.array([1.0, 1.0, 1.0, *[evaluation.mechanism.characteristic_length] * 3])
    columns = (joint_jacobian(evaluation.data, evaluation.model.nv)
               * evaluation.constraints.supports[1:, None])
    twists = (columns @ velocities.T) * size[:, None]
    return twists / np.abs(twists).max(initial=1e-300)
