"""Modes found as States: rods in their readings, one copy of each mode or all, sorted, named."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from itertools import product

import numpy as np

from spatial_pin.assembly.search.within_limits import violated_limit
from spatial_pin.assembly.state import State
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mobility.modes.check import SAME_MODE, Check, Kind
from spatial_pin.mobility.modes.marks import Mark
from spatial_pin.mobility.modes.result import AssemblyModes, missing_by
from spatial_pin.mobility.modes.rods import Rod
from spatial_pin.mobility.modes.search import Mode, Search
from spatial_pin.numerics.linalg import Array

# Starts from which the readings of a rod are sought: there are two as a rule, and both are missed
# by so many in one of a hundred cases.
READINGS = 8

Found = tuple[Array, Kind, int]  # a configuration, what it is, and how many starts ended there


def answer(check: Check, search: Search, copies: bool, limits: bool) -> AssemblyModes:
    """Return the modes found as States, sorted.

    Args:
        check: of the whole mechanism.
        search: what was found.
        copies: whether all configurations of a mode are listed.
        limits: whether only those that keep the joint limits are.
    """
    marks, all_copies = search.recognition.marks, copies or limits
    found = [(q, mode.kind, mode.count) for mode in search.modes
             for q in (_readings(check, marks, mode, copies, limits) if all_copies else [mode.q])]
    if limits:
        found = [x for x in found if not violated_limit(check.mechanism, check.state(x[0]).q)]
    if all_copies and not copies:
        found = _one_of_each(check, found)
    loose = {joint for _, kind, _ in found for joint, _ in kind.idle}
    found.sort(key=lambda x: order(check.state(x[0]), loose))
    signs = check.signs([(q, kind) for q, kind, _ in found])
    states = [check.state(q, branch) for (q, _, _), branch in
              zip(found, labels(signs), strict=True)]
    return AssemblyModes(
        states, held=check.held, starts=search.starts, closed=search.closed,
        found=[count for _, _, count in found],
        missing=missing_by([mode.count for mode in search.modes]) if search.is_free else 0.0,
        continua=() if search.continuum is None else (search.continuum,),
        is_whole=search.is_whole)


def _readings(
    check: Check, marks: Mapping[int, Mark], mode: Mode, copies: bool, limits: bool
) -> list[Array]:
    """Return a mode with the core's rods in their readings: all, or those within limits."""
    choices = []
    for rod in mode.rods:
        own = _readings_of(check, {k: marks[k] for k in rod.lines}, rod, mode.q)
        if limits:
            own = [x for x in own if not x[2]]
        choices.append([x[:2] for x in own][: None if copies else 1])
    readings = []
    for choice in product(*choices):
        q = mode.q.copy()
        for at, values in choice:
            q[at] = values
        readings.append(q)
    return readings


def _readings_of(
    check: Check, marks: Mapping[int, Mark], rod: Rod, q: Array
) -> list[tuple[slice, Array, bool]]:
    """Return the readings of a rod's first joint, and whether one is beyond joint limits."""
    model, i = check.mechanism.model, min(rod.lines)
    own = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
    names = {c.name for c in check.mechanism.coordinate_table.values()
             if c.joint in {model.names[k] for k in rod.lines}}
    rng = np.random.default_rng(6)
    signatures: list[Array] = []
    readings = []
    for k in range(READINGS):
        start = q if not k else check.shaken((rod,), q, rng)
        found = check.place_rods((rod,), start)
        if found is None:
            continue
        signature = check.signature(marks, found)
        if all(np.abs(signature - other).max() >= SAME_MODE for other in signatures):
            signatures.append(signature)
            beyond = beyond_limits(check.mechanism, check.state(found).q)
            readings.append((own, found[own], not names.isdisjoint(beyond)))
    return readings


def _one_of_each(check: Check, found: list[Found]) -> list[Found]:
    """Return one copy of each mode, the counts summed."""
    kept: list[Found] = []
    signatures: list[Array] = []
    for q, kind, count in found:
        marks = check.marks(q, kind.idle, all_copies=False)
        signature = check.signature(marks, q)
        for k, other in enumerate(signatures):
            if other.shape == signature.shape and np.abs(other - signature).max() < SAME_MODE:
                kept[k] = kept[k][0], kept[k][1], max(kept[k][2], count)
                break
        else:
            signatures.append(signature)
            kept.append((q, kind, count))
    return kept


def order(state: State, loose: set[str]) -> list[float]:
    """Return what modes are sorted by: coordinates, those of passive links last."""
    table = state.mechanism.coordinate_table.values()
    fixed = [c for c in table if c.joint not in loose]
    return [round(state.coordinate(c.name).value, 7) + 0.0 for c in fixed]


def labels(signs: list[str]) -> list[str]:
    """Return labels of their own: signs, numbered where several modes have one."""
    total, seen = Counter(signs), Counter[str]()
    labels = []
    for sign in signs:
        seen[sign] += 1
        space = " " * (sign == "singular")
        labels.append(f"{sign}{space}{seen[sign]}" if total[sign] > 1 else sign)
    return labels
