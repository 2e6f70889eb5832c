"""Assembly modes of loops that share nothing that may move: each group's with each of the others'.

Starts that close one of two groups in ten close both of them in a hundred, and close ten never.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice, product

import numpy as np

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.search.guesses import read_guess
from spatial_pin.assembly.search.loop_groups import LoopGroup, loop_groups, part_of
from spatial_pin.errors import AssemblyError, ContinuumError
from spatial_pin.mechanism.coordinates import coordinate_value, with_values
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mobility.mode_check import ModeCheck
from spatial_pin.mobility.mode_list import AssemblyModes, Continuum, labels, order
from spatial_pin.mobility.mode_search import MOST_MODES, moving
from spatial_pin.numerics.linalg import Array

Searched = Callable[[Mechanism, Mapping[str, float]], AssemblyModes]


def groups_of(mechanism: Mechanism, held: Iterable[str]) -> tuple[LoopGroup, ...]:
    """Return the groups of loops where coordinates are held; none where others move besides."""
    fixed = {mechanism.coordinate_table[name].v for name in held}
    groups = loop_groups(mechanism, tuple(sorted(fixed)))
    tied = np.any([group.entries for group in groups], axis=0) if groups else np.zeros(0, bool)
    return groups if len(groups) > 1 and fixed.issuperset(np.flatnonzero(~tied).tolist()) else ()


def modes_of_groups(
    check: ModeCheck, groups: Sequence[LoopGroup], searched: Searched
) -> AssemblyModes:
    """Return the modes of a mechanism from those of its groups of loops.

    Args:
        check: of the whole mechanism.
        groups: of its loops, from `groups_of`.
        searched: returns the modes of a mechanism with coordinates held.

    Raises:
        ContinuumError: a group can move.
    """
    mechanism, held, found = check.mechanism, check.held, list[AssemblyModes]()
    try:  # a closed configuration, that groups looked at by themselves stand in
        base = assembled(mechanism, held, free=[
            name for name in mechanism.drivers if mechanism.coordinate(name).name not in held]).q
    except AssemblyError:
        base = with_values(mechanism, read_guess(mechanism, mechanism.start(held)).q, held)
    for group in groups:
        others = {name: coordinate_value(mechanism, c, base)  # all that is not of these loops
                  for name, c in mechanism.coordinate_table.items() if not group.entries[c.v]}
        try:
            found.append(searched(part_of(mechanism, group.closures), others | held))
        except ContinuumError as error:
            assert error.state is not None
            continuum = Continuum(error.state, error.freedoms, error.coordinates, error.hold)
            raise moving(check, _of_whole(check, base, group, continuum)) from None
        if not found[-1].is_whole and len(found) < len(groups):
            raise KeyboardInterrupt
    return _together(check, base, groups, found)


def _of_whole(check: ModeCheck, base: Array, group: LoopGroup, continuum: Continuum) -> Continuum:
    return continuum._replace(state=check.state(_put(base, [group], [continuum.state.q])))


def _put(base: Array, groups: Sequence[LoopGroup], chosen: Iterable[Array]) -> Array:
    """Return a configuration (nq,) in which each group of loops stands as in one of its own."""
    q = base.copy()
    for group, own in zip(groups, chosen, strict=True):
        q[group.places] = own[group.places]
    return q


def _together(
    check: ModeCheck, base: Array, groups: Sequence[LoopGroup], found: Sequence[AssemblyModes]
) -> AssemblyModes:
    """Return each mode of each group with each of the others', `MOST_MODES` of them at most."""
    modes: list[tuple[Array, str, int]] = []
    choices = (zip(own, own.found, strict=True) for own in found)
    for choice in islice(product(*choices), MOST_MODES):
        states, counts = zip(*choice, strict=True)
        modes.append((_put(base, groups, [state.q for state in states]),
                      _sign([state.branch for state in states]), min(counts)))
    if modes:
        kind = check.kind(modes[0][0])
        loose = {joint for joint, _ in kind.idle}
        modes.sort(key=lambda x: order(check.state(x[0]), loose))
    signs = _as_together(check, modes)
    continua = [_of_whole(check, base, group, x)
                for group, own in zip(groups, found, strict=True) for x in own.continua]
    return AssemblyModes(
        [check.state(q, branch) for (q, _, _), branch in zip(modes, labels(signs), strict=True)],
        held=check.held, starts=sum(own.starts for own in found),
        closed=sum(own.closed for own in found), found=[count for _, _, count in modes],
        missing=math.prod(len(own) + own.missing for own in found) - len(modes),
        continua=continua, is_whole=found[-1].is_whole)


def _sign(branches: Iterable[str]) -> str:
    """Return the sign of a determinant from the labels of its blocks, in words."""
    signs = [branch.rstrip("0123456789 ") for branch in branches]
    if "singular" in signs:
        return "singular"
    return "" if "" in signs else "+-"[signs.count("-") % 2]


def _as_together(check: ModeCheck, modes: Sequence[tuple[Array, str, int]]) -> list[str]:
    """Return the signs of modes as those of the whole: all may be the other ones."""
    signs = [sign for _, sign, _ in modes]
    known = next((k for k, sign in enumerate(signs) if sign in ("+", "-")), None)
    if known is None:
        return signs
    q = modes[known][0]
    if check.signs([(q, check.kind(q))]) == [signs[known]]:
        return signs
    return [{"+": "-", "-": "+"}.get(sign, sign) for sign in signs]
