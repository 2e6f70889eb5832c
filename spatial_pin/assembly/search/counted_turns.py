"""Turns that some closures count and others do not.

A coupling and a screw count the turns of their joints; a weld or a ball is the same after a turn.
So a gear behind a loop has made several turns only if the loop was followed through them. Hinges
that no closure counts at all have the turns of hinges that they turn with; other ones are followed
if they are set more than a turn from the guess.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.close import closed
from spatial_pin.assembly.holding import fixed_base_entries, free_velocities
from spatial_pin.assembly.search.guesses import Guess
from spatial_pin.assembly.search.loop_groups import loop_groups
from spatial_pin.assembly.search.whole_turns import (
    periodic,
    turn_free_difference,
    turning_with,
)
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.errors import SingularError
from spatial_pin.kernel.closer import closer_of
from spatial_pin.mechanism.coordinates import coordinate_value, with_values
from spatial_pin.mechanism.joint_limits import position_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.angles import whole_turns
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

# Change of fixed coordinates beyond which loops are followed [rad]: with less, a loop usually turns
# by less than half a turn, which is unique.
FAR = 0.5 * math.pi
# step, and largest joint motion in a step without a change of branch [rad, characteristic lengths]
LEADING_STEP, LEAP = 0.2, 1.0
MOST_STEPS = 2000  # a hundred turns
# Change of a fixed angle beyond which hinges are followed that no closure counts [rad]: one turn,
# which the last value of a sweep over a turn has
OVER_A_TURN = 2.0 * math.pi * (1.0 + 1e-9)
SAME_CONFIGURATION = 1e-6  # rad, characteristic lengths


@made_once
def uncounted(
    mechanism: Mechanism, held: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return fixed coordinates whose turns loops hide from joints that count them.

    Returns:
        Fixed angles with that property, and the other coordinates of these loops.
    """
    constraints, table = constraints_of(mechanism), mechanism.coordinate_table
    fixed = {table[name].v for name in held if table[name].q >= 0}
    tied = [{mechanism.coordinate(name).v for name in c.joints} for c in mechanism.closures]
    entry_of = {c.q: c.v for c in table.values() if c.q >= 0}
    tied += [{entry_of[q] for q in np.flatnonzero(turns.row).tolist()}
             for turns in constraints.turns if turns.are_all]
    known = set(fixed)
    for _ in tied:  # coordinates that a counting closure ties to a known one
        for ends in tied:
            known |= ends if ends & known else set()
    angles = {c.v for c in table.values() if c.unit == "rad"}
    hidden = set().union(*tied) & angles - known
    by_path = {constraints.labels[x.equation].closure for x, turns in zip(
        constraints.angles, constraints.turns, strict=True) if not turns.are_all}
    entries: set[int] = set()
    for group in loop_groups(mechanism, tuple(sorted(fixed))):
        own = set(np.flatnonzero(group.entries).tolist())
        if (own & hidden or by_path.intersection(group.closures)) and own & fixed & angles:
            entries |= own
    return (tuple(name for name, c in table.items() if c.v in entries & fixed & angles),
            tuple(name for name, c in table.items() if c.v in entries - fixed))


def with_followed_turns(
    mechanism: Mechanism, held: Mapping[str, float], start: Guess, angles: Array | None,
    standing: Iterable[str], named: Collection[str],
) -> tuple[Guess, Array, tuple[str, ...]]:
    """Return the guess, or the configuration followed from it if turns would be lost otherwise.

    Args:
        mechanism: the mechanism.
        held: coordinates with given values.
        start: the guess.
        angles: (n_angles,) its unwrapping reference of screws [rad]; None: from the joints.
        standing: coordinates fixed at the guess.
        named: coordinates with explicit values in the guess, turns included.

    Returns:
        The start of an assembly; the unwrapping reference (n_angles,) of screws [rad]; and
        coordinates changed by more than half a turn that could not be followed.
    """
    table = mechanism.coordinate_table
    fixed = tuple(name for name in (*held, *standing) if table[name].q >= 0)
    hidden, others = uncounted(mechanism, fixed)
    goal = with_values(mechanism, start.q, held)
    first, turned = _screws(mechanism, start.q, angles)
    direct = first + turned @ (goal - start.q)
    by = {name: abs(float(goal[table[name].q] - start.q[table[name].q])) for name in hidden}
    if max(by.values(), default=0.0) < FAR:
        return start, direct, ()
    still = fixed_base_entries(mechanism, (table[name] for name in held))
    free = free_velocities(mechanism, still, fixed)
    if not set(named).isdisjoint(others):  # it says how often each joint has turned
        fitting = _closed(mechanism, goal, free, direct)
        if fitting is not None and _moved(mechanism, goal, fitting[0]) < FAR:
            return start, direct, ()
    there = _followed(mechanism, start.q, goal, free, first)
    if there is None:
        return start, direct, tuple(name for name, x in by.items() if x > math.pi)
    q, reference = there
    names = dict.fromkeys((*start.names, *others))
    values = {name: coordinate_value(mechanism, table[name], q) for name in names}
    return Guess(mechanism, q, values), reference, ()


def _screws(mechanism: Mechanism, q: Array, angles: Array | None) -> tuple[Array, Array]:
    """Return the angles of screws at a guess (nq,), and (n_angles, nq) their coefficients."""
    counted = constraints_of(mechanism).turns
    turned = np.array([turns.row for turns in counted]).reshape(len(counted), len(q))
    return (turned @ q if angles is None or len(angles) != len(counted) else angles), turned


@made_once
def _winding(
    mechanism: Mechanism, fixed: tuple[str, ...], named: tuple[str, ...]
) -> tuple[tuple[str, ...], NDArray[np.intp], NDArray[np.intp], Array, bool]:
    """Return fixed angles that may wind periodic ones round.

    Returns:
        Fixed angles of loops with such ones; the indices in q of these (n,); what `turning_with`
        returns of the others, those with names left out; and whether these turn with others too
        than the fixed ones.
    """
    table = mechanism.coordinate_table
    explicit = {table[name].q for name in named}
    alike, rows = turning_with(mechanism, fixed)
    is_open = np.array([q not in explicit for q in alike], dtype=bool)
    lower, upper = position_limits(mechanism)
    free = [c for c in periodic(mechanism) if c.q not in {*explicit, *alike} and c.name not in fixed
            and not lower[c.q] < upper[c.q] < math.inf]
    held = {table[name].v for name in fixed}
    entries: set[int] = set()
    for group in loop_groups(mechanism, tuple(sorted(held))):
        if any(group.entries[c.v] for c in free):
            entries |= set(np.flatnonzero(group.entries).tolist()) & held
    angles = tuple(name for name in fixed if table[name].v in entries and table[name].unit == "rad")
    alike, rows = alike[is_open], rows[is_open]
    known = [table[name].q for name in fixed]  # counted ones only when the loops are closed
    waits = bool(np.delete(rows, known, axis=1).any())
    return angles, np.array([c.q for c in free], dtype=np.intp), alike, rows, waits


def turns_of_others(
    mechanism: Mechanism, start: Array, goal: Array, fixed: tuple[str, ...],
    named: tuple[str, ...], angles: Array | None,
) -> Callable[[Array], tuple[Array, tuple[str, ...]]] | None:
    """Return a function that gives hinges the turns that no closure counts.

    Args:
        mechanism: the mechanism.
        start: (nq,) the guess.
        goal: (nq,) the same with the fixed coordinates at their values.
        fixed: fixed coordinates.
        named: coordinates with explicit values in the guess, turns included.
        angles: (n_angles,) of screws at the guess [rad]; None: from the joints.

    Returns:
        A function of a closed configuration (nq,): the same with turns, and fixed angles whose
        turns others may have lost. None if nothing is set so far from the guess.
    """
    table = mechanism.coordinate_table
    followed, winding, alike, rows, waits = _winding(mechanism, fixed, named)
    by = {name: abs(float(goal[table[name].q] - start[table[name].q])) for name in followed}
    far = tuple(name for name, x in by.items() if x > OVER_A_TURN)
    if not (far or waits or (
            len(rows) and np.abs(rows @ (goal - start)).max() > math.pi)):
        return None
    lower, upper = position_limits(mechanism)

    def with_turns(q: Array) -> tuple[Array, tuple[str, ...]]:
        lost: tuple[str, ...] = ()
        turned, q = rows @ (q - start), q.copy()
        for at, row, x in zip(alike.tolist(), rows, turned.tolist(), strict=True):
            value = q[at] + whole_turns(start[at] + x - q[at])
            if abs(x) > math.pi and lower[at] < upper[at] and not lower[at] <= value <= upper[at]:
                lost += tuple(name for name in fixed if row[table[name].q])
            elif abs(x) > math.pi:
                q[at] = value
        if far:
            free = free_velocities(mechanism, fixed_base_entries(
                mechanism, (table[name] for name in fixed)), fixed)
            there = _followed(mechanism, start, q, free, _screws(mechanism, start, angles)[0])
            if there is None or np.abs(
                    turn_free_difference(mechanism, there[0], q)).max() > SAME_CONFIGURATION:
                lost += far
            else:
                q[winding] += whole_turns(there[0][winding] - q[winding])
        return q, tuple(dict.fromkeys(lost))

    return with_turns


def _followed(
    mechanism: Mechanism, q: Array, goal: Array, free: NDArray[np.bool_], angles: Array
) -> tuple[Array, Array] | None:
    """Follow the loops from q (nq,) in steps until fixed coordinates are as in a goal (nq,)."""
    model, scale = mechanism.model, mechanism.velocity_scale
    change = np.where(free, 0.0, pin.difference(model, q, goal))
    n = math.ceil(float(np.abs(change / scale).max()) / LEADING_STEP)
    here, before = _closed(mechanism, q, free, angles), None
    if here is None or n > MOST_STEPS:
        return None
    for _ in range(n):
        at, angles = here
        ahead = np.where(free, 0.0 if before is None else pin.difference(model, before, at),
                         change / n)
        there = _closed(mechanism, pin.integrate(model, at, ahead), free, angles)
        if there is None or _moved(mechanism, at, there[0]) > LEAP:
            return None
        before, here = at, there
    return here


def _closed(
    mechanism: Mechanism, q: Array, free: NDArray[np.bool_], angles: Array
) -> tuple[Array, Array] | None:
    """Return the closed configuration from q (nq,), and the angles of screws; None if open."""
    try:
        result = closed(mechanism, q, free, angles, TOLERANCES.tight)
    except SingularError:
        return None
    if result.error > TOLERANCES.closed:
        return None
    if not len(angles):
        return result.q, angles
    with closer_of(mechanism) as closer:
        return result.q, closer.examine(result.q, angles).angles


def _moved(mechanism: Mechanism, q: Array, other: Array) -> float:
    """Return the largest joint displacement [rad, characteristic lengths]."""
    difference = pin.difference(mechanism.model, q, other) / mechanism.velocity_scale
    return float(np.abs(difference).max(initial=0.0))
