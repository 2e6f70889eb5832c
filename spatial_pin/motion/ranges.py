"""How far a driver can go: what `limits` returns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Bound(NamedTuple):
    """One end of a driver's range.

    Attributes:
        value: driver value [rad or m], infinite where there is no limit.
        kind: "limit" (dead centre), "branch point", "singular", "none", "upper limit of JOINT" or
            "lower limit of JOINT" (of the URDF), or "not followed further" (the value is then the
            last one reached).
    """

    value: float
    kind: str


class Range(NamedTuple):
    """How far a driver can go on its branch.

    Attributes:
        driver: name of the driver or coordinate.
        lower, upper: the two ends.
        unit: "rad" or "m".
        full_turn: whether it turns all the way round.
    """

    driver: str
    lower: Bound
    upper: Bound
    unit: str
    full_turn: bool

    def __str__(self) -> str:
        if self.full_turn:
            return f"{self.driver}: full turn"
        ends = []
        for bound in (self.lower, self.upper):
            degrees = f" ({np.degrees(bound.value):.9g}°)" * (self.unit == "rad")
            ends.append("no limit" if bound.kind == "none" else
                        f"{bound.value:.12g} {self.unit}{degrees} ({bound.kind})")
        return f"{self.driver}: from {ends[0]} to {ends[1]}"
