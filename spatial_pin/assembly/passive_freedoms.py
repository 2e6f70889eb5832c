"""Passive freedoms: motions of one link that move nothing else.

Bodies count as one link if drivers or welds hold them together, such as the halves of a cut rod; so
do the parts of a telescopic rod that turns. A chain of hinges with intersecting axes may stand for
a ball or a universal joint: its inner links turn with the two outer ones and do not count.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import by_joint, driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure, Coordinate
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

# Relative twist of a body at rest. Null vectors have an error of round-off over the least singular
# value, which `near_singular` limits to 2e-11. This is far above it, and below the effect of the
# shortest lever in files with six digits.
RESTING = 1e-8
WELDS = ("weld", "fixed")
SLIDES, POINTS = ("prismatic", "cylindrical"), ("spherical", "distance")
HINGES = {"revolute": 1, "universal": 2}  # pairs of a chain, with their number of axes
# Largest mass of an inner link, relative to the heaviest body: files give such links a gram in a
# ton.
WITHOUT_MASS = 1e-6


@made_once
def rigid_groups(mechanism: Mechanism, fixed: frozenset[str]) -> list[int]:
    """Return for every body (by its joint's index) the first body that is rigidly connected to it.

    The halves of a telescopic leg are one body while its coordinate is among the `fixed` ones; so
    are those of a welded rod.
    """
    model = mechanism.model
    groups = list(range(model.njoints))
    for i in range(1, model.njoints):
        if fixed.issuperset(c.name for c in by_joint(mechanism)[model.names[i]]):
            groups[i] = groups[model.parents[i]]
    for closure in mechanism.closures:
        if closure.type in WELDS and closure.equations is None:
            low, high = sorted(groups[mechanism.frame_on_joint(f)[0]] for f in closure.frames)
            groups = [low if g == high else g for g in groups]
    return groups


def _names(mechanism: Mechanism, driven: Iterable[Coordinate] | None) -> frozenset[str]:
    """Return the names of prescribed coordinates, by default the drivers."""
    driven = driver_coordinates(mechanism).values() if driven is None else driven
    return frozenset(c.name for c in driven)


def is_in_loop(mechanism: Mechanism, joint: str) -> bool:
    """Whether a joint's body, with its rigidly connected bodies, carries more than one pair."""
    return _in_loops(mechanism)[mechanism.joint_id(joint)]


@made_once
def _in_loops(mechanism: Mechanism) -> list[bool]:
    """Return `is_in_loop` for every body (by its joint's index)."""
    groups = np.array(rigid_groups(mechanism, _names(mechanism, None)))
    pairs = np.bincount([groups[body] for ends in _pairs(mechanism) for body in ends
                         if groups[ends[0]] != groups[ends[1]]], minlength=len(groups))
    carries: list[bool] = (pairs[groups] > 1).tolist()
    return carries


def _pairs(mechanism: Mechanism) -> list[tuple[int, int]]:
    """Return the two bodies, by joint, of every pair; couplings have none."""
    model = mechanism.model
    pairs = [(int(model.parents[i]), i) for i in range(1, model.njoints)]
    for closure in mechanism.closures:
        for one, other in closure.joined:
            pairs.append((mechanism.frame_on_joint(one)[0], mechanism.frame_on_joint(other)[0]))
    return pairs


# ---------------------------------------------------------------- links of chains


@made_once
def massless_inner_links(mechanism: Mechanism) -> frozenset[int]:
    """Return the massless inner bodies of balls and universal joints modelled as hinges.

    They have no mass, and carry two hinges, not driven nor coupled, with a common centre. If no
    body has a mass, they cannot be distinguished from shafts, and there are none.
    """
    masses = np.array([inertia.mass for inertia in mechanism.model.inertias])
    if not masses.any():
        return frozenset()
    return frozenset(i for i in _between_hinges(mechanism)
                     if masses[i] <= WITHOUT_MASS * masses.max())


@made_once
def balls_of_hinges(mechanism: Mechanism) -> list[tuple[tuple[int, int], frozenset[int]]]:
    """Return the balls modelled as hinges about three intersecting axes, of any inner masses.

    Of each: the two outer bodies, and the bodies between its hinges.
    """
    inside, balls = _between_hinges(mechanism), []
    for group in _connected({*ends} & inside for ends in _pairs(mechanism)):
        hinges = [(ends, kind) for ends, kind in _kinds_of_pairs(mechanism) if group & {*ends}]
        axes = sum(HINGES[kind] for _, kind in hinges)
        outer = [body for ends, _ in hinges for body in ends if body not in group]
        if axes == 3 and len(outer) == 2:
            balls.append(((outer[0], outer[1]), frozenset(group)))
    return balls


def _connected(links: Iterable[set[int]]) -> list[set[int]]:
    """Return the sets that remain when those with a common element are joined."""
    joined: list[set[int]] = []
    for link in links:
        near = [x for x in joined if x & link]
        joined = [x for x in joined if not x & link]
        joined += [link.union(*near)] if link else []
    return joined


@made_once
def inner_links_of_balls(mechanism: Mechanism) -> frozenset[int]:
    """Return the inner bodies of balls modelled as hinges, of any mass."""
    return frozenset().union(*(inner for _, inner in balls_of_hinges(mechanism)))


@made_once
def uncounted_links(mechanism: Mechanism) -> frozenset[int]:
    """Return the inner bodies that do not count as links: massless ones, and those at rods.

    The inside of a ball between the ground and a body that is not a rod may be a shaft.
    """
    return massless_inner_links(mechanism).union(*(
        inner for ends, inner in balls_of_hinges(mechanism)
        if 0 not in ends or _is_rod(mechanism, max(ends))))


def _is_rod(mechanism: Mechanism, body: int) -> bool:
    """Whether a body, with bodies that slide on it, has only point contacts, two or more."""
    balls, inside, own = balls_of_hinges(mechanism), inner_links_of_balls(mechanism), {body}
    pairs = [(ends, kind) for ends, kind in _kinds_of_pairs(mechanism) if not inside & {*ends}]
    pairs += [(ends, POINTS[0]) for ends, _ in balls]
    for _ in pairs:
        for ends, kind in pairs:
            if kind in (*SLIDES, *WELDS) and own & {*ends}:
                own |= {*ends}
    held = [kind for ends, kind in pairs if own & {*ends} and not {*ends} <= own]
    return 0 not in own and len(held) > 1 and all(kind in POINTS for kind in held)


def _kinds_of_pairs(mechanism: Mechanism) -> list[tuple[tuple[int, int], str]]:
    """Return the two bodies and the type of every pair; "" for a part of a pair."""
    kinds = [*mechanism.pairs]
    for closure in mechanism.closures:
        kinds += [closure.type if closure.equations is None else ""] * len(closure.joined)
    return list(zip(_pairs(mechanism), kinds, strict=True))


@made_once
def _between_hinges(mechanism: Mechanism) -> frozenset[int]:
    """Return bodies with only two hinges, not driven nor coupled, with intersecting axes."""
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
    bodies = []
    for i in range(1, model.njoints):
        if counted[i] != 2 or mechanism.pairs[i - 1] not in HINGES:
            continue
        joints = {model.names[i], *(model.names[k] for k in model.children[i])}
        if joints.isdisjoint(moved) and _meets(mechanism, i, closures.get(i, ())):
            bodies.append(i)
    return frozenset(bodies)


def _meets(mechanism: Mechanism, body: int, closures: Iterable[Closure]) -> bool:
    """Whether the other pair of a body is a hinge about another axis through the same centre."""
    model = mechanism.model
    for child in model.children[body]:
        kind, placement = mechanism.pairs[child - 1], model.jointPlacements[child]
        axis = placement.rotation @ _axis(mechanism, child)
    for closure in closures:
        kind = closure.type if closure.equations is None else "part"
        mine = [k for k, f in enumerate(closure.frames) if mechanism.frame_on_joint(f)[0] == body]
        if not mine:
            return False
        placement = mechanism.frame_on_joint(closure.frames[mine[0]])[1]
        axes = closure.geometry.axes2 if mine[0] else closure.geometry.axes1
        axis = placement.rotation @ axes[:, 2]
    if kind not in HINGES or np.linalg.norm(placement.translation) > (
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
    """Return (joint name, (k, nv) velocities) of motions of a single link.

    A link has the name of the first of its bodies. Inner links of its balls may move with it. The
    null space (k, nv) has joint velocities that keep drivers fixed and loops closed. Prescribed
    coordinates are by default the drivers.
    """
    mechanism = evaluation.mechanism
    twists = _twists(evaluation, null_space)
    groups = np.array(rigid_groups(mechanism, _names(mechanism, driven)))
    moves = np.append(False, np.abs(twists).max(axis=(1, 2), initial=0.0) > RESTING)
    links: list[tuple[int, ...]] = [
        (group,) for group in sorted(set(groups[moves].tolist()) - {0})]
    slides = [set(groups[list(ends)].tolist()) for ends, kind in _kinds_of_pairs(mechanism)
              if kind == "prismatic"]
    # of several groups of bodies, that slide on each other
    rods = _connected(x for x in slides if len(x) == 2 and 0 not in x)
    links += [tuple(sorted(x)) for x in rods
              if _is_rod(mechanism, min(x)) and moves[list(x)].all()]
    freedoms: list[tuple[str, Array]] = []
    for link in links:
        alone = _alone(mechanism, twists, groups, moves, link)
        if len(alone):
            freedoms.append((mechanism.model.names[link[0]], alone @ null_space))
    return freedoms


def _alone(
    mechanism: Mechanism, twists: Array, groups: NDArray[np.intp], moves: NDArray[np.bool_],
    link: tuple[int, ...],
) -> Array:
    """Return combinations (m, k) of k motions that move one link (its groups of bodies) alone."""
    n = twists.shape[2]
    mine = [(ends, inner) for ends, inner in balls_of_hinges(mechanism)
            if not set(groups[list(ends)].tolist()).isdisjoint(link)]
    inside = {body for _, inner in mine for body in inner}
    partners = {int(groups[x]) for ends in _pairs(mechanism) for x in ends
                if not set(groups[list(ends)].tolist()).isdisjoint(link)} - inside
    partners |= {int(groups[body]) for ends, _ in mine for body in ends}
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
    """Return the bodies, by joint, that joint velocities (k, nv) move."""
    twists = _twists(evaluation, velocities)
    return (np.flatnonzero(np.abs(twists).max(axis=(1, 2), initial=0.0) > RESTING) + 1).tolist()


def _twists(evaluation: LoopEquations, velocities: Array) -> Array:
    """Return the twists (bodies, 6, k) of joint velocities (k, nv), the largest of size 1."""
    size = np.array([1.0, 1.0, 1.0, *[evaluation.mechanism.characteristic_length] * 3])
    columns = (joint_jacobian(evaluation.data, evaluation.model.nv)
               * evaluation.constraints.supports[1:, None])
    twists = (columns @ velocities.T) * size[:, None]
    return twists / np.abs(twists).max(initial=1e-300)
