"""Which of many cases are tested by default: a few that differ in kind, and with `--all` the rest.

A law that holds for all mechanisms is tested on six by default.
"""

from collections.abc import Iterable, Sequence

import pytest

SIX = {
    # of the library
    "crane",  # an open tree of two freedoms
    "four_bar",  # plane, overconstrained
    "rssr",  # spatial, with an idle rotation
    "delta",  # several loops and freedoms
    "screw_press",  # a screw
    "geared_five_bar",  # a coupling
    # with a known answer
    "pendulum", "slider-crank cut at slide", "RSSR, rod as distance", "five-bar",
    "press, screw as closure", "rack and gears",
}


def each(names: Iterable[str]) -> list[object]:
    """Return names as values for `parametrize`: the six kinds by default, all with `--all`."""
    return [pytest.param(name, marks=() if name in SIX else pytest.mark.slow) for name in names]


def few(values: Iterable[object], *chosen: object) -> list[object]:
    """Return values for `parametrize`: those chosen by default, all with `--all`."""
    values = list(values)
    assert set(chosen) <= set(values)
    return [pytest.param(x, marks=() if x in chosen else pytest.mark.slow) for x in values]


def paired(
    ones: Sequence[object], others: Sequence[object], chosen: Iterable[object] = ()
) -> list[object]:
    """Return pairs for `parametrize`: every value of both once or more, all pairs with `--all`.

    Where some of the ones are chosen, by default only they are.
    """
    chosen = list(chosen or ones)
    return [pytest.param(one, other, marks=() if one in chosen and (
                i % len(others) == j or j % len(ones) == i) else pytest.mark.slow)
            for i, one in enumerate(ones) for j, other in enumerate(others)]


def first(n: int, rows: Iterable[tuple[object, ...]]) -> list[object]:
    """Return rows of values for `parametrize`: n of them by default, all with `--all`."""
    return [pytest.param(*row, marks=() if k < n else pytest.mark.slow)
            for k, row in enumerate(rows)]
