"""Dead centres: points where an output reverses while the driver goes on."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import checked
from spatial_pin._support.lazy import Workspaces
from spatial_pin.continuation.path_tracker import PathTracker
from spatial_pin.continuation.pseudo_arclength import Stopped
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.motion.motion import Event, Motion, require_motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.roots import sign_change
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy


@checked
def dead_centres(motion: Motion, output: str | None = None) -> list[Event]:
    """Return the dead centres of outputs over a sweep, located to about 1e-12 of the driver.

    An output stands still there at its limit position: its speed ratio is 0 and its mechanical
    advantage infinite. Limit positions of the driver itself are `motion.events`.

    Args:
        motion: from `sweep`, the driver moving in every sample, or from `trace`.
        output: a coordinate; default every one-freedom joint on the fixed link but the driver.

    Returns:
        Events of kind "dead centre" with the driver's values, in the order of the samples; `row`
        is the first sample that is there or beyond; the text says where the output is.

    Raises:
        UnknownNameError: there is no such coordinate.
        SingularError: branches cross, or the rates are not determined, right at one.

    Example:
        >>> mech = sp.load("slider_crank")
        >>> motion = sp.sweep(mech, "crank", np.linspace(-1.0, 5.0, 61))
        >>> [round(event.value, 4) for event in sp.dead_centres(motion, "slide")]  # crank [rad]
        [0.0, 3.1416]
    """
    require_motion(motion)
    events = []
    for name in grounded_outputs(motion) if output is None else [output]:
        rates = _rates(motion, name)
        moving = np.flatnonzero(rates)
        if not moving.size:
            continue
        goes = np.sign(motion.driver_speed[moving])  # the other way beyond its own limits
        turning = np.flatnonzero((np.diff(np.sign(rates[moving])) != 0.0) & (np.diff(goes) == 0.0))
        events += [_located(motion, moving[k : k + 2], rates, name) for k in turning.tolist()]
        ends = {0, len(motion) - 1} - set(moving.tolist())
        events += [_event(motion, name, row, float(motion.swept[row]),
                         float(motion.coordinate(name).value[row])) for row in ends]
    return sorted(events, key=lambda event: event.row)


def known_dead_centres(motion: Motion) -> list[Event]:
    """Return the dead centres of any motion's outputs, as far as they can be located."""
    if motion.driver is None or len(motion) < 2:
        return []
    with suppress(SpatialPinError):
        return dead_centres(motion)
    return []


def _rates(motion: Motion, name: str) -> Array:
    """Return the rate of an output per unit speed of the driver's, round-off taken for zero."""
    coordinate = motion.mechanism.coordinate(name)
    size = motion.mechanism.velocity_scale
    rates = motion.v[:, coordinate.v] * np.sign(motion.driver_speed)
    largest = np.abs(rates).max(initial=0.0)
    if largest < TOLERANCES.nothing * size[coordinate.v] * np.abs(motion.v / size).max(initial=0.0):
        return np.zeros(len(motion))
    return np.where(np.abs(rates) < TOLERANCES.tight * largest, 0.0, rates)


def grounded_outputs(motion: Motion) -> list[str]:
    """Return the plain coordinates of joints on the fixed link, without the driver's."""
    mechanism = motion.mechanism
    own = mechanism.coordinate(motion.driver_name)
    return [c.name for c in mechanism.coordinate_table.values()
            if c.q >= 0 and c != own
            and mechanism.model.parents[mechanism.joint_id(c.joint)] == 0]


def _located(motion: Motion, rows: NDArray[np.intp], rates: Array, name: str) -> Event:
    """Return the dead centre of an output between two samples in which it moves opposite ways.

    Given are the numbers (2,) of the samples and the rates (N,) of the output.
    """
    first, last = rows.tolist()
    mechanism, driver, unit = motion.mechanism, motion.driver_name, motion.driver_unit
    output = mechanism.coordinate(name)
    ends = motion.swept[first], motion.swept[last]
    with Workspaces() as workspaces:
        tracker = PathTracker.along(motion.state(first), [driver], motion.held,
                                    Accuracy.named("reference"), workspaces)

        def rate(value: float) -> float:
            tracker.reach(value)
            return float(tracker.here.t[output.v])

        try:
            value = sign_change(rate, *ends, *rates[rows])
            tracker.reach(value)
        except Stopped as stopped:
            raise SingularError(
                f"mechanism {mechanism.name!r}: {stopped.kind} between {driver} = "
                f"{ends[0]:.9g} and {ends[1]:.9g} {unit}, where {name} turns back", motion=motion,
            ) from None
        return _event(motion, name, first + 1, value, float(tracker.here.q[output.q]))


def _event(motion: Motion, name: str, row: int, value: float, turned: float) -> Event:
    text = (f"dead centre of {name} at {turned:.12g} {motion.mechanism.coordinate(name).unit}, "
            f"{motion.driver_name} = {value:.12g} {motion.driver_unit}")
    return Event("dead centre", value, row, text)
