"""Whole turns of periodic angles, reduced to the reference configuration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.compiled_equations import NEARLY_PARALLEL, constraints_of
from spatial_pin.constraints.composite_joints import SCREW, SLIDE, TURN, joint_kind, split_of
from spatial_pin.kernel.closer import FIXED, NAMED, TURNS, NamedCoordinates, closer_of
from spatial_pin.mechanism.joint_limits import position_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.angles import whole_turns
from spatial_pin.numerics.linalg import Array

PERIODIC = ("revolute", "cylindrical", "universal", "planar")
# first of the equations that make a closure's frames parallel
PARALLEL_FRAMES = {"weld": 3, "prismatic": 2}


class _Turning(NamedTuple):
    """A joint that turns one body, or others parallel to it, relative to another.

    Attributes:
        q: its index in the configuration.
        bodies: numbers of the two.
        axes: (3,) in the axes of each.
    """

    q: int
    bodies: tuple[int, int]
    axes: tuple[Array, Array]


@made_once
def periodic(mechanism: Mechanism) -> list[Coordinate]:
    """Return the periodic angles: no closure counts their turns."""
    coupled = [mechanism.coordinate(j).name for c in mechanism.closures for j in c.joints]
    counted = np.zeros(mechanism.model.nq, dtype=bool)
    for turns in constraints_of(mechanism).turns:
        counted |= turns.are_all & (turns.row != 0.0)
    return [
        c for c in mechanism.coordinate_table.values()
        if c.unit == "rad" and c.q >= 0 and c.name not in coupled and not counted[c.q]
        and mechanism.pair_of(c.joint) in PERIODIC
    ]


def turn_free_difference(mechanism: Mechanism, q: Array, other: Array) -> Array:
    """Return the difference (nv,) of two configurations without whole turns of periodic angles.

    In radians and characteristic lengths.
    """
    difference: Array = pin.difference(mechanism.model, q, other)
    turning = _turning_entries(mechanism)
    difference[turning] -= whole_turns(difference[turning])
    return difference / mechanism.velocity_scale


@made_once
def _turning_entries(mechanism: Mechanism) -> NDArray[np.intp]:
    """Return the velocity entries of periodic angles."""
    return np.array([c.v for c in periodic(mechanism)], dtype=np.intp)


def entry_kinds(
    mechanism: Mechanism, held: Iterable[str], named: Iterable[str]
) -> NDArray[np.int64]:
    """Return (nq,) flags of the entries of q, for `NamedCoordinates`; 0 for balls."""
    kinds = np.zeros(mechanism.model.nq, np.int64)
    kinds[[c.q for c in periodic(mechanism)]] = TURNS
    for names, bit in ((held, FIXED), (named, NAMED)):
        kinds[[c.q for name in names if (c := mechanism.coordinate_table[name]).q >= 0]] |= bit
    return kinds


def nearest_turn(
    mechanism: Mechanism, q: Array, held: Mapping[str, float], named: Mapping[str, float]
) -> Array:
    """Take whole turns off the angles: nearest to the named value, else to zero, in limits."""
    table = mechanism.coordinate_table
    value = q.copy()
    for name, x in {**named, **held}.items():
        if table[name].q >= 0:
            value[table[name].q] = x
    reference = NamedCoordinates(
        value, entry_kinds(mechanism, held, named), *position_limits(mechanism))
    with closer_of(mechanism) as closer:
        return closer.judge(q, 0.0, reference).q


@made_once
def turning_with(
    mechanism: Mechanism, fixed: tuple[str, ...]
) -> tuple[NDArray[np.intp], Array]:
    """Return the periodic angles that turn with others whose turns are known.

    Hinges about one axis, whose bodies are welded together or slide in each other, turn alike.

    Args:
        mechanism: the mechanism.
        fixed: coordinates with known values, besides those whose turns are counted.

    Returns:
        Indices in q (m,); and (m, nq) by how much each turns as the others do.
    """
    table = mechanism.coordinate_table
    unknown = {c.q for c in periodic(mechanism)} - {table[name].q for name in fixed}
    turning = _turning(mechanism) if unknown else []
    known = [x for x in turning if x.q not in unknown]
    matches = [(x.q, row) for x in turning
             if x.q in unknown and (row := _turned(mechanism.model.nq, x, known)) is not None]
    return (np.array([q for q, _ in matches], dtype=np.intp),
            np.array([row for _, row in matches]).reshape(len(matches), mechanism.model.nq))


def _turning(mechanism: Mechanism) -> list[_Turning]:
    """Return the joints about an axis between bodies that are not parallel to each other."""
    model, carriers = split_of(mechanism)
    parallel: list[tuple[int, int, Array]] = []  # two joints' bodies, rotation of 2 relative to 1
    hinges = []
    for i in range(1, model.njoints):
        kind, axis, _ = joint_kind(model.joints[i].extract())
        parent, rotation = int(model.parents[i]), np.array(model.jointPlacements[i].rotation)
        if kind == SLIDE:
            parallel.append((parent, i, rotation))
        elif kind in (TURN, SCREW) and axis is not None:
            hinges.append((int(model.idx_qs[i]), parent, i, rotation @ axis, axis))
    for c in (mechanism.whole or mechanism).closures:
        first = PARALLEL_FRAMES.get(c.type)
        if first is None or max(c.equations or (first,)) < first:
            continue
        (one, at_one), (two, at_two) = (mechanism.frame_on_joint(name) for name in c.frames)
        parallel.append((int(carriers[one]), int(carriers[two]),
                         at_one.rotation @ c.geometry.axes1
                         @ (at_two.rotation @ c.geometry.axes2).T))
    body, turned = np.arange(model.njoints), [np.eye(3)] * model.njoints
    for one, two, rotation in parallel:
        joined, onto = turned[one] @ rotation @ turned[two].T, body[one]
        for i in np.flatnonzero(body == body[two]).tolist() if body[two] != onto else ():
            body[i], turned[i] = onto, joined @ turned[i]
    return [_Turning(q, (int(body[one]), int(body[two])), (turned[one] @ a, turned[two] @ b))
            for q, one, two, a, b in hinges if body[one] != body[two]]


def _turned(nq: int, hinge: _Turning, known: list[_Turning]) -> Array | None:
    """Return (nq,) the turn of a hinge by those of known ones about its axis; None if free."""
    rows = {hinge.bodies[0]: (hinge.axes[0], np.zeros(nq))}
    queue = [hinge.bodies[0]]
    for body in queue:
        axis, row = rows[body]
        for other in known:
            for here, there, sense in ((0, 1, 1.0), (1, 0, -1.0)):
                if other.bodies[here] != body or other.bodies[there] in rows or (
                        np.linalg.norm(np.cross(other.axes[here], axis)) > NEARLY_PARALLEL):
                    continue
                along = float(np.sign(other.axes[here] @ axis))
                on = row.copy()
                on[other.q] += along * sense
                rows[other.bodies[there]] = along * other.axes[there], on
                queue.append(other.bodies[there])
    if hinge.bodies[1] not in rows:
        return None
    axis, row = rows[hinge.bodies[1]]
    return row if axis @ hinge.axes[1] > 1.0 - NEARLY_PARALLEL else None
