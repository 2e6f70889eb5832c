"""Six mechanisms that differ in kind: a law that holds for all is tested on them by default."""

from collections.abc import Iterable
from functools import cache

import pytest

import spatial_pin as sp

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


def first(n: int, rows: Iterable[tuple[object, ...]]) -> list[object]:
    """Return rows of values for `parametrize`: n of them by default, all with `--all`."""
    return [pytest.param(*row, marks=() if k < n else pytest.mark.slow)
            for k, row in enumerate(rows)]


@cache
def library(name: str) -> sp.Mechanism:
    """Return a mechanism of the library, which is loaded once: it is not to be changed."""
    return sp.load(name)
