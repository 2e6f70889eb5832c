"""What every public function asks of its numbers before it works with them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from spatial_pin.linalg import Array

UNIT_TOLERANCE = 1e-9  # how far the length of a unit vector may be from 1


def as_array(values: Any, what: str) -> Array:
    """Return `values` as float64 of the shape they have.

    Raises:
        ValueError: they are no numbers, or integers too large for one.
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{what} must be finite numbers, not {_beginning(values)}") from None


def _beginning(values: Any) -> str:
    try:
        return str(values)[:60]
    except ValueError:  # Python does not write integers of thousands of digits
        return "integers of thousands of digits"


def finite_array(values: Any, shape: tuple[int, ...], what: str) -> Array:
    """Return `values` as float64 of that shape.

    Raises:
        ValueError: NaN, infinite, or another shape.
    """
    array = as_array(values, what)
    if array.shape != shape:
        raise ValueError(f"{what} has shape {array.shape}; {shape} is needed")
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{what} has a value that is NaN or infinite")
    return array


def finite_points(values: Any, dimension: int, what: str) -> Array:
    """Return one point (dimension,) or several (N, dimension) as float64.

    Raises:
        ValueError: NaN, infinite, or another shape.
    """
    array = as_array(values, what)
    several = (len(array), dimension) if array.ndim == 2 else (dimension,)
    return finite_array(array, several, what)


def finite_number(value: Any, what: str) -> float:
    """Return `value` as a finite float.

    Raises:
        ValueError: NaN, infinite, or no number.
    """
    if value is None or isinstance(value, str | bytes | bool):
        raise ValueError(f"{what} must be a number, not {value!r}")
    return float(finite_array(value, (), what))


def mapping(value: Any, what: str) -> Mapping[str, Any]:
    """Return `value`, names to numbers, as it is; nothing for None.

    Raises:
        TypeError: it is no mapping.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise TypeError(f"{what} must be a mapping as {{'name': value}}, not {_beginning(value)}")
    return value


def whole_number(value: Any, what: str) -> int:
    """Return `value` as an int.

    Raises:
        ValueError: NaN, infinite, no number, or not a whole one.
    """
    number = finite_number(value, what)
    if number != int(number):
        raise ValueError(f"{what} is {value}; it is a whole number")
    return int(number)


def positive_number(value: Any, what: str) -> float:
    """Return `value` as a finite float above 0.

    Raises:
        ValueError: NaN, infinite, no number, or not positive.
    """
    if isinstance(value, float) and not 0.0 < value < math.inf:
        raise ValueError(f"{what} is {value}; it must be positive, and finite")
    number = finite_number(value, what)
    if not number > 0.0:
        raise ValueError(f"{what} is {value}; it must be positive")
    return number


def unit_vector(values: Any, what: str) -> Array:
    """Return `values` (3,) with its length, which is 1 to `UNIT_TOLERANCE`, made 1 to round-off.

    Raises:
        ValueError: NaN, infinite, another shape, or another length.
    """
    array = finite_array(values, (3,), what)
    length = math.hypot(*array)
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f"{what} has length {length:.9g}; a unit vector is needed")
    return array / length
