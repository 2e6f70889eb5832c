"""The result of `assembly_modes`: a list of States, with an estimate of its completeness."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from spatial_pin._support.lazy import by_new_name
from spatial_pin.assembly.state import State

CONFIDENT = 3.0  # a mode that 3 of n starts should end at is missed in exp(-3) of cases, 5 %


class Continuum(NamedTuple):
    """Configurations that form no mode: with the given values held they can still move.

    Attributes:
        state: one of them.
        freedoms: its number of freedoms, without passive ones.
        coordinates: names of the coordinates that move.
        hold: drivers or coordinates that stop it if they are held too.

    Example:
        >>> modes = sp.assembly_modes(sp.load("sarrus"), {"arm": 0.7})  # [rad]
        >>> len(modes), [(found.freedoms, found.hold) for found in modes.continua]
        (2, [(1, ('b_low',))])
    """

    state: State
    freedoms: int
    coordinates: tuple[str, ...]
    hold: tuple[str, ...]

    def __str__(self) -> str:
        some = ", ".join(self.coordinates[:8]) + ", ..." * (len(self.coordinates) > 8)
        freedoms = "1 freedom" if self.freedoms == 1 else f"{self.freedoms} freedoms"
        verb = "is" if self.freedoms == 1 else "are"
        return f"{freedoms}, of {some}; it stops when {', '.join(self.hold)} {verb} held too"


class AssemblyModes(list[State]):
    """The assembly modes found, sorted, each with a label of its own in `State.branch`.

    Attributes:
        held: values of the coordinates held [rad, m].
        starts: number of random starts; `closed` of them ended at a closed configuration.
        counts: numbers of starts that ended at each mode.
        missing: estimated number of modes that no start has found [Chao1984].
        continua: other sets of configurations, which can move with `held` held.
        is_whole: whether nothing cut the search short (Ctrl-C).

    Example:
        >>> modes = sp.assembly_modes(sp.load("four_bar"), {"crank": 1.0})
        >>> len(modes), [state.branch for state in modes], modes.continua
        (2, ['+', '-'], ())
        >>> print(modes.missing < 0.01)  # modes that no start has found
        True
        >>> print(modes.completeness)
        none is expected to be missing, unless fewer than one start in 491 ends at it
    """

    def __init__(
        self,
        modes: Iterable[State] = (),
        *,
        held: Mapping[str, float] | None = None,
        starts: int = 0,
        closed: int = 0,
        counts: Sequence[int] = (),
        missing: float = 0.0,
        continua: Sequence[Continuum] = (),
        is_whole: bool = True,
    ) -> None:
        super().__init__(modes)
        self.held = dict(held or {})
        self.starts = starts
        self.closed = closed
        self.counts = tuple(counts)
        self.missing = missing
        self.continua = tuple(continua)
        self.is_whole = is_whole

    def __repr__(self) -> str:
        modes = super().__repr__()
        return modes if self.is_whole else f"AssemblyModes({modes}; cut short)"

    def __str__(self) -> str:
        values = ", ".join(f"{name} = {value:.6g}" for name, value in self.held.items())
        lines = [f"{len(self)} assembly modes found at {values or 'no values held'}; "
                 f"{self.starts} starts, {self.closed} closed"
                 f"{'' if self.is_whole else '; cut short'}"]
        lines += [f"  {k}: branch {mode.branch}, found {times} times"
                  for k, (mode, times) in enumerate(zip(self, self.counts, strict=False), start=1)]
        lines += [f"  beside them a set that can move: {c}" for c in self.continua]
        lines.append(self.completeness)
        return "\n".join(lines)

    @property
    def found(self) -> tuple[int, ...]:
        """The old name of `counts`; it warns."""
        return tuple(by_new_name(self, "found", "counts"))

    @property
    def completeness(self) -> str:
        """A sentence on modes that may be missing."""
        if self.missing >= 0.5:
            return f"about {self.missing:.0f} more must be expected: give more starts"
        if self.starts <= 1:
            return "there is nothing to search for"
        return ("none is expected to be missing, unless fewer than one start in "
                f"{max(1, round(self.starts / CONFIDENT))} ends at it")


def missing_by(counts: Sequence[int]) -> float:
    """Return the estimated number of unseen kinds, from the counts of the others [Chao1984].

    The estimate without bias f1 (f1 - 1) / (2 (f2 + 1)): f1 kinds were seen once, f2 twice.
    """
    once, twice = (sum(1 for n in counts if n == k) for k in (1, 2))
    return 0.5 * once * (once - 1) / (twice + 1) if once > 1 else float(once and not twice)


def order(state: State, loose: set[str]) -> list[float]:
    """Return the sort key of modes: coordinates, without those of passive links."""
    table = state.mechanism.coordinate_table.values()
    fixed = [c for c in table if c.joint not in loose]
    return [round(state.coordinate(c.name).value, 7) + 0.0 for c in fixed]


def labels(signs: list[str]) -> list[str]:
    """Return unique labels: signs, numbered if several modes have one."""
    total, seen = Counter(signs), Counter[str]()
    labels = []
    for sign in signs:
        seen[sign] += 1
        space = " " * (sign == "singular")
        labels.append(f"{sign}{space}{seen[sign]}" if total[sign] > 1 else sign)
    return labels
