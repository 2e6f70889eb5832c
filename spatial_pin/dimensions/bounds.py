"""Names and bounds of the dimensions that a search may change."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from spatial_pin._support.checks import finite_number, names_of
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism

Bounds = tuple[float | None, float | None] | None  # least and most; None for no bound


def check_dimensions(mechanism: Mechanism, names: Iterable[str]) -> None:
    """Refuse names that are no dimensions, and a mechanism that cannot be made at others."""
    if mechanism.path is None:
        raise SpatialPinError(f"mechanism {mechanism.name!r} has no file to change dimensions in")
    for name in names:
        if name not in mechanism.dimensions:
            raise UnknownNameError("dimension", name, mechanism.dimensions,
                                   f"mechanism {mechanism.name!r}: ")


def bounds_of(
    mechanism: Mechanism, dimensions: Iterable[str] | Mapping[str, Any], *, around: bool = False
) -> dict[str, tuple[float, float]]:
    """Return the least and the largest value by dimension, infinite without a bound.

    Dimensions are names, or {name: (least, most) or None}; an end without bound is None, or
    infinity of its sign. `around`: whether the bounds must contain the nominal dimension.
    """
    names = names_of(dimensions, "dimensions")
    given = dimensions if isinstance(dimensions, Mapping) else {}
    if len(set(names)) < len(names):
        raise ValueError("dimensions names one twice")
    if names:
        check_dimensions(mechanism, names)
    bounds = {}
    for name in names:
        low, high = _pair(name, given.get(name))
        own = mechanism.dimensions[name]
        if around and not (low < high and low <= own <= high):
            raise ValueError(f"bounds of {name!r} are {low:g} to {high:g}; they must hold its "
                             f"nominal value {own:g}, the least first")
        if not low < high:
            raise ValueError(f"bounds of {name!r} are {low:g} to {high:g}: the first must be the "
                             "smaller one")
        bounds[name] = low, high
    return bounds


def _pair(name: str, given: Any) -> tuple[float, float]:
    if given is None:
        return -np.inf, np.inf
    words = f"bounds of {name!r} are (least, most), not {given!r}"
    if isinstance(given, str):
        raise ValueError(words)
    try:
        low, high = given
    except (TypeError, ValueError):
        raise ValueError(words) from None
    ends = [none if x is None or (isinstance(x, float | np.floating) and x == none)
            else finite_number(x, f"a bound of {name!r}")
            for x, none in ((low, -np.inf), (high, np.inf))]
    return ends[0], ends[1]
