"""Assembly modes: all closed configurations for given driver values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from spatial_pin._support.checks import checked, generator, mapping, positive_number
from spatial_pin._support.progress import progress_bar
from spatial_pin.assembly.assemble import assembled, standing_drivers, tell
from spatial_pin.assembly.holding import free_bases
from spatial_pin.assembly.rounding import as_meant
from spatial_pin.assembly.search.guesses import read_guess
from spatial_pin.errors import AssemblyError, unless_cut
from spatial_pin.mechanism.coordinates import (
    coordinate_value,
    finite_number,
    needed,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mobility.modes.check import Check
from spatial_pin.mobility.modes.groups import groups_of, modes_of_groups
from spatial_pin.mobility.modes.readings import answer
from spatial_pin.mobility.modes.result import AssemblyModes
from spatial_pin.mobility.modes.rods import Rod, core_of, rods_of
from spatial_pin.mobility.modes.search import Search, moving
from spatial_pin.settings import Accuracy, accuracy_of

ENDLESS = 10**8  # starts: days, at a thousand a second


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
    lines, or the two readings of a universal joint are one mode. Starts go on until `patience` of
    them in a row have found nothing new and the rarest mode has been found twenty times, or until
    `most_starts`; `AssemblyModes.missing` estimates how many have not been found.
    Nothing proves that a finite number of starts has found all: raise `patience` for rare modes. A
    screw joint of the tree, and an angle of a coupling whose ratio is no whole number, is looked
    at near its zero, for each of its turns may be a mode of its own.

    Args:
        mechanism: the mechanism.
        drivers: values of drivers or coordinates to hold [rad, m]; drivers that are not named
            stand at the guess, if the loops can be closed there.
        free: drivers that are not to stand at the guess.
        copies: list all configurations of a mode that differ in coordinates, not one of them.
        limits: leave out modes of which no copy keeps the joint limits.
        patience: go on until so many starts in a row have found nothing new.
        most_starts: stop after so many starts in any case.
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
    needed(mechanism)
    positive_number(patience, "patience")
    positive_number(most_starts, "most_starts")
    rng = generator(seed)
    if min(patience, most_starts) > ENDLESS:
        raise ValueError(f"patience is {patience:.3g} and most_starts is {most_starts:.3g}; one of "
                         f"them must be {ENDLESS:.0e} at most, or the search hardly ends")
    accuracy = accuracy_of(accuracy)
    mechanism = as_meant(mechanism, accuracy)
    held = _held(mechanism, mapping(drivers, "drivers"), free)
    rods = rods_of(mechanism)

    def searched(part: Mechanism, fixed: Mapping[str, float]) -> AssemblyModes:
        own = [rod for rod in rods if _is_within(part, rod, fixed)]
        check = Check(part, fixed, own, accuracy.tolerance, accuracy.gap)
        search = Search(check, core_of(part, fixed, own), copies or limits)
        search.look_at_guess()
        with progress_bar(most_starts, f"{mechanism.name}: modes", progress) as bar:
            search.run(rng, patience, most_starts, bar)
        if search.continuum is not None and not search.modes:
            raise moving(check, search.continuum)
        return answer(check, search, copies, limits)

    groups = groups_of(mechanism, held)
    found = searched(mechanism, held) if not groups else modes_of_groups(
        Check(mechanism, held, rods, accuracy.tolerance, accuracy.gap), groups, searched)
    if found and mechanism.whole is not None:
        tell(found[0])
    return unless_cut(found)


def _is_within(mechanism: Mechanism, rod: Rod, held: Mapping[str, float]) -> bool:
    """Whether a rod is one of those that can move at all where coordinates are held."""
    joints = {mechanism.model.names[i] for i in rod.lines}
    return any(c.joint in joints and name not in held
               for name, c in mechanism.coordinate_table.items())


def _held(
    mechanism: Mechanism, named: Mapping[str, float], free: Iterable[str]
) -> dict[str, float]:
    """Return the coordinates held: those named, drivers that stand at the guess, a free base."""
    held = {mechanism.driven_coordinate(name).name: finite_number(value, f"driver {name!r}")
            for name, value in named.items()}
    standing = standing_drivers(mechanism, held, mechanism.start(held), free)
    held |= _base(mechanism, held)
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


def _base(mechanism: Mechanism, held: Mapping[str, float]) -> dict[str, float]:
    """Return where the guess has the free bases, by coordinate."""
    bases = free_bases(mechanism)
    if not bases:
        return {}
    q = read_guess(mechanism, mechanism.start(held)).q
    return {c.name: coordinate_value(mechanism, c, q)
            for c in mechanism.coordinate_table.values() if c.joint in bases}
