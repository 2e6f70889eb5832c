"""Matrices of constants of which some entries differ from configuration to configuration."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from spatial_pin.numerics.linalg import Array


class Varying(NamedTuple):
    """Coefficients (..., n), mostly the same in all of m configurations.

    Attributes:
        fixed: (..., n) the entries that are the same, zero in place of the others.
        places: index of each of the others.
        values: (len(places), m) the others.
    """

    fixed: Array
    places: tuple[tuple[int, ...], ...]
    values: Array

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape (..., n) for one configuration."""
        return self.fixed.shape

    def until(self, stop: int) -> Varying:
        """Return the first rows."""
        kept = [k for k, place in enumerate(self.places) if place[0] < stop]
        return Varying(self.fixed[:stop], tuple(self.places[k] for k in kept), self.values[kept])


def varying(values: Array, places: tuple[int, ...], others: Array) -> Any:
    """Return `values` with the entries at flat `places` replaced by `others` (len(places), m).

    As they are if there are none.
    """
    if not places:
        return values
    fixed = values.copy()
    fixed.reshape(-1)[list(places)] = 0.0
    index = tuple(tuple(map(int, np.unravel_index(at, values.shape))) for at in places)
    return Varying(fixed, index, others)


def times(coefficients: Any, vectors: Array) -> Array:
    """Return combinations (..., 5, m) of the vectors (n, 5, m), coefficients (..., n) or Varying.

    Any shape will do after the vectors' first axis, m last.
    """
    rest = vectors.shape[1:]
    flat = vectors.reshape(len(vectors), math.prod(rest))
    if not isinstance(coefficients, Varying):
        found: Array = np.dot(coefficients, flat)
        return found.reshape(coefficients.shape[:-1] + rest)
    out: Array = np.dot(coefficients.fixed, flat).reshape(coefficients.shape[:-1] + rest)
    for (*row, column), value in zip(coefficients.places, coefficients.values, strict=True):
        out[tuple(row)] += value * vectors[column]
    return out
