"""Six mechanisms that differ in kind: a law that holds for all is tested on them by default."""

from collections.abc import Iterable

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
