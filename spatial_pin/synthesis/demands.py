"""What a mechanism should be like: swing, transmission, whole turns, dead centres, efforts."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

from spatial_pin.assembly.state import State
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.family import Family
from spatial_pin.synthesis.precision import Goal


@dataclass(frozen=True, eq=False)
class Candidate:
    """A mechanism at some dimensions, with closed configurations."""

    mechanism: Mechanism
    states: tuple[State, ...]

    @classmethod
    def of(cls, family: Family, dimensions: Array, near: State, samples: Any) -> Candidate:
        """Return the candidate at dimensions."""
        names = dict(zip(family.names, dimensions.tolist(), strict=True))
        there = family.variants.at(names)
        if samples:
            states = [State(there, q, closure_error=0.0, angles=a) for s in samples
                      for q, a in zip(s.q, s.angles, strict=True)]
        else:
            states = [followed(there, {}, near)]
        return cls(there, tuple(states))


@dataclass(frozen=True, eq=False, kw_only=True)
class Demand(Goal):
    """A goal that is asked of the mechanism as a whole."""

    @property
    def is_one_sided(self) -> bool:
        """Whether values at most zero are as good as zero."""
        return False

    @property
    def count(self) -> int:
        """How many numbers it has."""
        return 1

    @abstractmethod
    def values(self, candidate: Candidate) -> Array:
        """Return the numbers (count,), zero where it is met."""
