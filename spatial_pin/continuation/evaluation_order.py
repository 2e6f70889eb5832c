"""The order in which driver values are best followed: a branch is the same there and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatial_pin.numerics.linalg import Array

# Values are sorted first if following them as given is more than so many times longer: random ones
# are; one or two reversals are not, and are followed as given.
SORTED_FROM = 3.0


def there_and_back(values: Array) -> list[NDArray[np.intp]] | None:
    """Return the places of values from the first one upwards, and of those from it downwards.

    None where following the values as given is not much longer.

    Args:
        values: (N,) driver values.
    """
    if len(values) < 3:
        return None
    with np.errstate(over="ignore"):
        way = np.abs(values[1:] - values[:-1]).sum()
        if way / SORTED_FROM <= abs(values[-1] - values[0]):  # as most are
            return None
        first, low, high = values[0], values.min(), values.max()
        if not way / SORTED_FROM > high - low + min(high - first, first - low):
            return None
    order = np.argsort(values, kind="stable")
    up, down = order[values[order] >= first], order[values[order] < first][::-1]
    return [part for part in (up, down) if part.size]
