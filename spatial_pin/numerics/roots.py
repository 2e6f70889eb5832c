"""Roots of functions, and changes of sign between samples."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

MOST_EVALUATIONS = 1000  # bisection needs sixty; Brent's method needs most at a jump


def sign_change(
    function: Callable[[float], float], first: float, last: float, at_first: float, at_last: float,
    xtol: float = 1e-14, rtol: float = 1e-14,
) -> float:
    """Return the point at which a function changes its sign between two others.

    A function of closed configurations is round-off near its zero, and may have another
    sign when it is computed again: the values at the ends are given, and never computed again.
    Where they are of one sign, round-off hides a change at the end whose value is the smaller. A
    change as near to an end as it is known is there.
    A place where the function is NaN counts as one behind the change.

    Args:
        function: of the place.
        first: one end.
        last: the other, before or behind it.
        at_first: the function there, a number.
        at_last: the same.
        xtol: how far the place may be off.
        rtol: the same, by its size.
    """
    from scipy.optimize import brentq  # imported on use: it takes a tenth of a second

    if not (at_first < 0.0 < at_last or at_last < 0.0 < at_first):
        return first if abs(at_first) < abs(at_last) else last
    known = {first: at_first, last: at_last}

    def value(x: float) -> float:
        result = known[x] if x in known else float(function(x))
        return at_last if math.isnan(result) else result

    root, _ = brentq(value, first, last, xtol=xtol, rtol=rtol, maxiter=MOST_EVALUATIONS,
                      full_output=True, disp=False)
    off = 2.0 * (xtol + rtol * abs(root))
    return next((end for end in (first, last) if abs(root - end) <= off), float(root))


def onsets(holds: NDArray[np.bool_]) -> list[int]:
    """Return the samples at which a condition (N,) begins to hold."""
    starts: list[int] = np.flatnonzero(holds & ~np.append(False, holds[:-1])).tolist()
    return starts


def between_samples(at: Array, values: Array, k: int) -> float:
    """Return where samples change their sign before number k, by the cubic through four."""
    first = max(0, min(k - 2, len(at) - 4))
    x, y = at[first : first + 4] - at[k - 1], values[first : first + 4]
    width = at[k] - at[k - 1]
    steps = np.diff(x)
    if width and len(x) == 4 and (np.all(steps > 0.0) or np.all(steps < 0.0)):
        roots = np.roots(np.polyfit(x / width, y, 3))
        real = roots.real[(np.abs(roots.imag) < TOLERANCES.round_off)
                          & (roots.real >= 0.0) & (roots.real <= 1.0)]
        if len(real):
            return float(at[k - 1] + width * real[0])
    return float(at[k - 1] + width * values[k - 1] / (values[k - 1] - values[k]))
