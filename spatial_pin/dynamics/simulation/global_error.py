"""Error estimate of a simulation: its difference from one with other tolerances.

Local errors of steps add up, and grow or decay as the motion is unstable or damped. A second
integration whose steps may be ten times as inexact shows that with all that acts: where errors are
proportional to the tolerance, it is off by ten times as much [HairerNorsettWanner1993, II.4].
Beside a loose one they are no longer proportional, and the second one is more exact: then the
difference is the error itself, but for a little.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from spatial_pin._support.columns import read_only
from spatial_pin.errors import SpatialPinError
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, Accuracy

if TYPE_CHECKING:
    from spatial_pin.dynamics.simulation.result import Simulation

LOOSER = 10.0  # times the tolerances of the other integration; fixed steps are twice as long
TIGHTER = 30.0  # the same where it is the more exact one
LOOSE_TOLERANCE = 3e-6  # tolerance of steps from which on it is
LOOSEST_COMPARED = 1e-6  # closure residual: loops that are more open jump where branches are near
ERROR_MARGIN = 1.5  # times the difference: a more exact one is off a little itself
ERROR_FLOOR = 1e-13  # error of any motion, as samples are closed to that


def comparison(accuracy: Accuracy) -> Accuracy:
    """Return the setting of the other integration."""
    if INTEGRATORS[accuracy.integrator].is_fixed and accuracy.step is not None:
        return replace(accuracy, step=2.0 * accuracy.step)
    if accuracy.time_tolerance > LOOSE_TOLERANCE:
        return replace(accuracy, tolerance=accuracy.tolerance / TIGHTER,
                       time_tolerance=accuracy.time_tolerance / TIGHTER)
    tolerance = max(accuracy.tolerance, min(LOOSER * accuracy.tolerance, LOOSEST_COMPARED))
    return replace(accuracy, tolerance=tolerance, time_tolerance=LOOSER * accuracy.time_tolerance)


def error_estimates(run: Callable[[], Simulation], motion: Simulation) -> Array:
    """Return error estimates (N, 3) of the samples of a simulation, see `Motion.error_estimates`.

    They never fall: an error that has passed zero is none that has gone. They are infinite from
    where the other integration could not go on.

    Args:
        run: the other integration.
        motion: the simulation.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other: Simulation | None
        try:
            other = run()
        except SpatialPinError as error:
            other = getattr(error, "motion", None)
    n = 0 if other is None else min(len(other), len(motion))
    found = np.full((len(motion), 3), np.inf)
    scale = motion.mechanism.velocity_scale
    if n and other is not None:
        if motion.time is not None and other.time is not None:  # what stopped it may differ
            n -= int(motion.time[n - 1] != other.time[n - 1])
        steps = [pin.difference(motion.mechanism.model, motion.q[k], other.q[k]) for k in range(n)]
        gaps = (np.array(steps).reshape(n, -1), motion.v[:n] - other.v[:n],
                motion.a[:n] - other.a[:n])
        for k, gap in enumerate(gaps):
            found[:n, k] = ERROR_MARGIN * np.abs(gap / scale).max(axis=1, initial=0.0)
        v, a = (np.abs(x / scale).max(initial=0.0) for x in (motion.v, motion.a))
        found[:n] += ERROR_FLOOR * np.array([1.0, v, max(a, v * v)])
    return read_only(np.maximum.accumulate(found, axis=0))
