"""Error estimate of a simulation: its difference from one that is more exact.

Local errors of steps add up, and grow or decay as the motion is unstable or damped. A second
integration shows that with all that acts. Its tolerance is a thirtieth, so that the difference is
the error of the first but for a little [HairerNorsettWanner1993, II.4]. Near round-off no
integration is more exact: there it is ten times as loose, and off by more. Its steps are shorter
than the longest of the first, as a few long steps are often the same at any tolerance: they grow
from a first one as fast as they may.
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

TIGHTER = 30.0  # part of the tolerances that the other integration has, or
LOOSER = 10.0  # times the tolerances, where the other one would be
TIGHTEST = 1e-13  # tolerance of steps: round-off. Fixed steps are twice as long
SHORTER = 0.7  # its longest step, by the longest of the first
ERROR_MARGIN = 2.0  # times the difference: a more exact one is off a little itself
ERROR_FLOOR = 1e-13  # error of any motion, as samples are closed to that


def comparison(accuracy: Accuracy, longest: float) -> Accuracy:
    """Return the setting of the other integration.

    Args:
        accuracy: that of the simulation.
        longest: its longest step [s].
    """
    if INTEGRATORS[accuracy.integrator].is_fixed and accuracy.step is not None:
        return replace(accuracy, step=2.0 * accuracy.step)
    part = 1.0 / TIGHTER if accuracy.time_tolerance > TIGHTER * TIGHTEST else LOOSER
    step = SHORTER * longest if longest > 0.0 else accuracy.step
    return replace(accuracy, tolerance=part * accuracy.tolerance, step=step,
                   time_tolerance=part * accuracy.time_tolerance)


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
    errors = np.full((len(motion), 3), np.inf)
    scale = motion.mechanism.velocity_scale
    if n and other is not None:
        if motion.time is not None and other.time is not None:  # what stopped it may differ
            n -= int(motion.time[n - 1] != other.time[n - 1])
        steps = [pin.difference(motion.mechanism.model, motion.q[k], other.q[k]) for k in range(n)]
        gaps = (np.array(steps).reshape(n, -1), motion.v[:n] - other.v[:n],
                motion.a[:n] - other.a[:n])
        for k, gap in enumerate(gaps):
            errors[:n, k] = ERROR_MARGIN * np.abs(gap / scale).max(axis=1, initial=0.0)
        v, a = (np.abs(x / scale).max(initial=0.0) for x in (motion.v, motion.a))
        errors[:n] += ERROR_FLOOR * np.array([1.0, v, max(a, v * v)])
    return read_only(np.maximum.accumulate(errors, axis=0))
