"""The order in which driver values are best followed: a branch is the same there and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatial_pin.numerics.linalg import Array

# Values are sorted first if the way through them as they are given is more than so many times
# longer: random ones are; one or two turns back are not, and are followed as they are asked for.
SORTED_FROM = 3.0


def there_and_back(values: Array) -> list[NDArray[np.intp]] | None:
    """Return the rows from the first value upwards, and those from it downwards.

    None where values asked for one after the other make no much longer way.

    Args:
        values: (N,) driver values.
    """
    if len(values) < 3:
        return None
    first, low, high = values[0], values.min(), values.max()
    with np.errstate(over="ignore"):
        way = np.abs(values[1:] - values[:-1]).sum()
        if not way / SORTED_FROM > high - low + min(high - first, first - low):
            return None
    rows = np.argsort(values, kind="stable")
    up, down = rows[values[rows] >= first], rows[values[rows] < first][::-1]
    return [part for part in (up, down) if part.size]
