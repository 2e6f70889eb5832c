"""Assembly modes: all closed configurations for given driver values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice, product

import numpy as np

from spatial_pin._support.checks import checked, generator, mapping, positive_number
from spatial_pin._support.progress import progress_bar
from spatial_pin.assembly.assemble import assembled, default_driver_values, warn_of_rounding
from spatial_pin.assembly.close import violated_limit
from spatial_pin.assembly.holding import (
    LoopGroup,
    configuration_indices,
    free_bases,
    loop_groups,
    part_of,
)
from spatial_pin.assembly.redundant_equations import with_independent_equations
from spatial_pin.assembly.start_values import read_guess
from spatial_pin.errors import AssemblyError, ContinuumError, unless_cut
from spatial_pin.mechanism.coordinates import (
    coordinate_value,
    finite_number,
    require_mechanism,
    with_values,
)
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mobility.mode_check import (
    SAME_MODE,
    AssemblyModes,
    BodyMark,
    Continuum,
    ModeCheck,
    ModeKind,
    labels,
    missing_by,
    order,
    signs_of,
)
from spatial_pin.mobility.mode_search import MOST_MODES, Mode, ModeSearch, moving
from spatial_pin.mobility.rods import core_of, rods_of
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy, accuracy_of

# Starts for the readings of a rod: there are usually two, and one is missed in one of a hundred
# cases.
READINGS = 8
ENDLESS = 10**8  # starts: days, at a thousand a second


def _as_states(check: ModeCheck, search: ModeSearch, copies: bool, limits: bool) -> AssemblyModes:
    """Return the modes as sorted States; with `limits` only those within joint limits."""
    marks, all_copies = search.recognition.marks, copies or limits
    configurations = [(q, mode.kind, mode.count) for mode in search.modes
             for q in (_readings(check, marks, mode, copies, limits) if all_copies else [mode.q])]
    if limits:
        configurations = [x for x in configurations
                          if not violated_limit(check.mechanism, check.state(x[0]).q)]
    if all_copies and not copies:
        configurations = _one_of_each(check, configurations)
    loose = {joint for _, kind, _ in configurations for joint, _ in kind.idle}
    configurations.sort(key=lambda x: order(check.state(x[0]), loose))
    signs = signs_of(check, [(q, kind) for q, kind, _ in configurations])
    states = [check.state(q, branch) for (q, _, _), branch in
              zip(configurations, labels(signs), strict=True)]
    return AssemblyModes(
        states, held=check.held, starts=search.starts, closed=search.closed,
        counts=[count for _, _, count in configurations],
        missing=missing_by([mode.count for mode in search.modes]) if search.is_free else 0.0,
        continua=() if search.continuum is None else (search.continuum,),
        is_whole=search.is_whole)


def _readings(
    check: ModeCheck, marks: Mapping[int, BodyMark], mode: Mode, copies: bool, limits: bool
) -> list[Array]:
    """Return a mode with all readings of the core's rods, or those within limits."""
    model, choices = check.mechanism.model, []
    for rod in mode.rods:  # the readings of its first joint
        i, own_marks = min(rod.lines), {k: marks[k] for k in rod.lines}
        at = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
        names = {c.name for c in check.mechanism.coordinate_table.values()
                 if c.joint in {model.names[k] for k in rod.lines}}
        rng = np.random.default_rng(6)
        signatures: list[Array] = []
        values: list[Array] = []
        for k in range(READINGS):
            placed = check.with_rods((rod,), mode.q if not k else check.shaken((rod,), mode.q, rng))
            if placed is None:
                continue
            signature = check.signature(own_marks, placed)
            if any(np.abs(signature - other).max() < SAME_MODE for other in signatures):
                continue
            signatures.append(signature)
            if not limits or names.isdisjoint(
                    beyond_limits(check.mechanism, check.state(placed).q)):
                values.append(placed[at])
        choices.append([(at, x) for x in values[: None if copies else 1]])
    readings = []
    for choice in product(*choices):
        q = mode.q.copy()
        for at, x in choice:
            q[at] = x
        readings.append(q)
    return readings


def _one_of_each(
    check: ModeCheck, configurations: list[tuple[Array, ModeKind, int]]
) -> list[tuple[Array, ModeKind, int]]:
    """Return one copy of each mode, with the largest count."""
    distinct: list[tuple[Array, ModeKind, int]] = []
    signatures: list[Array] = []
    for q, kind, count in configurations:
        marks = check.marks(q, kind.idle, all_copies=False)
        signature = check.signature(marks, q)
        for k, other in enumerate(signatures):
            if other.shape == signature.shape and np.abs(other - signature).max() < SAME_MODE:
                distinct[k] = distinct[k][0], distinct[k][1], max(distinct[k][2], count)
                break
        else:
            signatures.append(signature)
            distinct.append((q, kind, count))
    return distinct


# ---------------------------------------------------------------- groups of loops

Searched = Callable[[Mechanism, Mapping[str, float]], AssemblyModes]  # modes with values held


def groups_of(mechanism: Mechanism, held: Iterable[str]) -> tuple[LoopGroup, ...]:
    """Return the groups of loops with fixed coordinates; () if other coordinates are free too."""
    fixed = {mechanism.coordinate_table[name].v for name in held}
    groups = loop_groups(mechanism, tuple(sorted(fixed)))
    is_free = [v not in fixed and not any(group.entries[v] for group in groups)
               for v in range(mechanism.model.nv)]
    return groups if len(groups) > 1 and not any(is_free) else ()


def modes_of_groups(
    check: ModeCheck, groups: Sequence[LoopGroup], searched: Searched
) -> AssemblyModes:
    """Return the modes of a mechanism from those of its groups of loops.

    If one start in ten closes a group, one in a hundred closes two, and practically none closes
    ten.

    Raises:
        ContinuumError: a group can move.
    """
    mechanism, held, results = check.mechanism, check.held, list[AssemblyModes]()
    try:  # a closed configuration, that groups looked at by themselves stand in
        base = assembled(mechanism, held, free=[
            name for name in mechanism.drivers if mechanism.coordinate(name).name not in held]).q
    except AssemblyError:
        base = with_values(mechanism, read_guess(mechanism, mechanism.start(held)).q, held)
    for group in groups:
        others = {name: coordinate_value(mechanism, c, base)  # all that is not of these loops
                  for name, c in mechanism.coordinate_table.items() if not group.entries[c.v]}
        try:
            results.append(searched(part_of(mechanism, group.closures), others | held))
        except ContinuumError as error:
            assert error.state is not None
            continuum = Continuum(error.state, error.freedoms, error.coordinates, error.hold)
            raise moving(check, _of_whole(check, base, group, continuum)) from None
        if not results[-1].is_whole and len(results) < len(groups):
            raise KeyboardInterrupt
    return _together(check, base, groups, results)


def _of_whole(check: ModeCheck, base: Array, group: LoopGroup, continuum: Continuum) -> Continuum:
    return continuum._replace(state=check.state(_put(check, base, [group], [continuum.state.q])))


def _put(
    check: ModeCheck, base: Array, groups: Sequence[LoopGroup], chosen: Iterable[Array]
) -> Array:
    """Return a configuration (nq,) with each group of loops from one of its own."""
    q = base.copy()
    for group, own in zip(groups, chosen, strict=True):
        indices = configuration_indices(check.mechanism, group)
        q[indices] = own[indices]
    return q


def _together(
    check: ModeCheck, base: Array, groups: Sequence[LoopGroup], results: Sequence[AssemblyModes]
) -> AssemblyModes:
    """Return all combinations of the groups' modes, `MOST_MODES` at most."""
    modes: list[tuple[Array, str, int]] = []
    choices = (zip(own, own.counts, strict=True) for own in results)
    for choice in islice(product(*choices), MOST_MODES):
        states, counts = zip(*choice, strict=True)
        # the sign of a determinant from the labels of its blocks, in words
        blocks = [state.branch.rstrip("0123456789 ") for state in states]
        sign = "" if "" in blocks else "+-"[blocks.count("-") % 2]
        modes.append((_put(check, base, groups, [state.q for state in states]),
                      "singular" if "singular" in blocks else sign, min(counts)))
    if modes:
        kind = check.kind(modes[0][0])
        loose = {joint for joint, _ in kind.idle}
        modes.sort(key=lambda x: order(check.state(x[0]), loose))
    signs = [sign for _, sign, _ in modes]  # as those of the whole: all may be the other ones
    known = next((k for k, sign in enumerate(signs) if sign in ("+", "-")), None)
    if known is not None:
        q = modes[known][0]
        if signs_of(check, [(q, check.kind(q))]) != [signs[known]]:
            signs = [{"+": "-", "-": "+"}.get(sign, sign) for sign in signs]
    continua = [_of_whole(check, base, group, x)
                for group, own in zip(groups, results, strict=True) for x in own.continua]
    return AssemblyModes(
        [check.state(q, branch) for (q, _, _), branch in zip(modes, labels(signs), strict=True)],
        held=check.held, starts=sum(own.starts for own in results),
        closed=sum(own.closed for own in results), counts=[count for _, _, count in modes],
        missing=math.prod(len(own) + own.missing for own in results) - len(modes),
        continua=continua, is_whole=results[-1].is_whole)


# ---------------------------------------------------------------- the verb


@checked
def assembly_modes(
    mechanism: Mechanism,
    drivers: Mapping[str, float] | None = None,
    *,
    free: Iterable[str] = (),
    copies: bool = False,
    limits: bool = False,
    patience: int = 1000,
    most_starts: int = 50_000,
    seed: int = 0,
    accuracy: Accuracy | None = None,
    progress: bool = False,
) -> AssemblyModes:
    """Find the closed configurations of a mechanism at given driver values, from random starts.

    Configurations that differ only by passive freedoms, whole turns, rods turned about their own
    lines, or the two readings of a universal joint are one mode. The search ends when the last
    `patience` starts found nothing new and the rarest mode was found twenty times, or after
    `most_starts` starts. `AssemblyModes.missing` estimates the number of modes that were not found.
    Nothing proves that a finite number of starts has found all: raise `patience` for rare modes. A
    screw joint of the tree, and an angle of a coupling whose ratio is no whole number, is looked at
    near its zero, for each of its turns may be a mode of its own.

    Args:
        mechanism: the mechanism.
        drivers: values of drivers or coordinates to hold [rad, m]; other drivers keep their values
            from the guess, if the loops close with them.
        free: drivers that do not keep their values from the guess.
        copies: list all configurations of a mode that differ in coordinates, not one of them.
        limits: list only modes that keep the joint limits in one of their copies.
        patience: number of starts in a row without a new mode after which the search may end.
        most_starts: number of starts after which the search ends in any case.
        seed: of the random starts; the same seed gives the same list.
        accuracy: tolerance to reach; default "engineering".
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The modes, sorted by their coordinates. `State.branch` labels each: the sign of the
        determinant of the closed loops ("+" or "-"), numbered if there are several of a sign; ""
        where passive freedoms or missing drivers leave it open; "singular" where the mode can move
        to first order. Configurations that can really move are not modes; those found beside modes
        are in `AssemblyModes.continua`.

    Raises:
        ContinuumError: the mechanism can move with the values held, in its guess or in every
            configuration found; names the freedoms and what to hold.
        UnknownNameError, ValueError: names that do not exist, values that are not finite.
        Interrupted: after Ctrl-C; `.result` has the modes that were found until then.

    Example:
        >>> mech = sp.load("four_bar")
        >>> modes = sp.assembly_modes(mech, {"crank": 1.0})  # [rad]
        >>> [(m.branch, round(m.coordinate("rocker_pin").value, 3)) for m in modes]
        [('+', -2.285), ('-', 1.625)]
    """
    require_mechanism(mechanism)
    positive_number(patience, "patience")
    positive_number(most_starts, "most_starts")
    rng = generator(seed)
    if min(patience, most_starts) > ENDLESS:
        raise ValueError(f"patience is {patience:.3g} and most_starts is {most_starts:.3g}; one of "
                         f"them must be {ENDLESS:.0e} at most, or the search hardly ends")
    accuracy = accuracy_of(accuracy)
    mechanism = with_independent_equations(mechanism, accuracy)
    held = _held(mechanism, mapping(drivers, "drivers"), free)
    rods = rods_of(mechanism)

    def searched(part: Mechanism, fixed: Mapping[str, float]) -> AssemblyModes:
        loose = {c.joint for name, c in part.coordinate_table.items() if name not in fixed}
        own = [rod for rod in rods if any(part.model.names[i] in loose for i in rod.lines)]
        check = ModeCheck(part, fixed, own, accuracy.tolerance, accuracy.gap)
        search = ModeSearch(check, core_of(part, fixed, own), copies or limits)
        search.look_at_guess()
        with progress_bar(most_starts, f"{mechanism.name}: modes", progress) as bar:
            search.run(rng, patience, most_starts, bar)
        if search.continuum is not None and not search.modes:
            raise moving(check, search.continuum)
        return _as_states(check, search, copies, limits)

    groups = groups_of(mechanism, held)
    modes = searched(mechanism, held) if not groups else modes_of_groups(
        ModeCheck(mechanism, held, rods, accuracy.tolerance, accuracy.gap), groups, searched)
    if modes and mechanism.whole is not None:
        warn_of_rounding(modes[0])
    return unless_cut(modes)


def _held(
    mechanism: Mechanism, named: Mapping[str, float], free: Iterable[str]
) -> dict[str, float]:
    """Return the fixed coordinates: named ones, drivers at the guess, a free base."""
    held = {mechanism.driven_coordinate(name).name: finite_number(value, f"driver {name!r}")
            for name, value in named.items()}
    start = read_guess(mechanism, mechanism.start(held))
    standing = default_driver_values(mechanism, held, start, free)
    if bases := free_bases(mechanism):
        held |= {c.name: coordinate_value(mechanism, c, start.q)
                 for c in mechanism.coordinate_table.values() if c.joint in bases}
    for name in standing:
        mechanism.driven_coordinate(name)  # refuses components of balls and floating joints
    if standing:
        try:
            state = assembled(mechanism, held, free=free)
        except AssemblyError:
            return held
        gone = {mechanism.coordinate(name).name for name in state.released}
        standing = {name: value for name, value in standing.items() if name not in gone}
    return held | standing
