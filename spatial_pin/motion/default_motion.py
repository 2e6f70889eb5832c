"""The motion that is shown by default: a move of the first driver."""

from __future__ import annotations

import math

import numpy as np

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.holding import BASE, SPRINGS
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array

TURN = 2 * math.pi  # a driver that turns makes one turn [rad]
# A driver that slides goes this far, in characteristic lengths. The motion is well visible, and
# most slides of the library reach it from their guess.
SLIDE_RANGE = 0.15
ROWS = 361  # samples: one per degree of a turn


def _reach(state: State, driver: str, offsets: Array) -> Motion | None:
    """Return the motion of a driver from a state by `offsets`, as far as it goes, or None."""
    values, reached = state.coordinate(driver).value + offsets, None
    for hold in (BASE, [BASE, SPRINGS])[: 1 + bool(state.mechanism.springs)]:
        try:
            return sweep(state.mechanism, driver, values, guess=state, hold=hold, on_limit="stop")
        except SpatialPinError as error:
            reached = getattr(error, "motion", None) or reached
    return reached


def default_motion(
    mechanism: Mechanism, driver: str | None = None, rows: int = ROWS
) -> Motion | State:
    """Return a motion of the first driver; a State if the mechanism cannot move.

    A driver turns once, or slides by 15 % of the characteristic length, from the assembled guess.
    If a limit or a singular position is in between, it goes up to it, in the direction with the
    longer range. The other drivers are held, a free base too, and joints with springs where the
    drivers do not determine the motion. The motion has no speed, nor time. `rows` counts the
    samples of the whole motion.

    Returns:
        The motion; the assembled state of a mechanism without drivers, or that cannot move.

    Raises:
        AssemblyError: the guess does not close.
    """
    state = assembled(mechanism)
    driver = driver or next(iter(mechanism.drivers), None)
    if driver is None:
        return state
    turns = mechanism.coordinate(driver).unit == "rad"
    travel = TURN if turns else SLIDE_RANGE * mechanism.characteristic_length
    offsets = np.linspace(0.0, travel, rows)
    forward = _reach(state, driver, offsets)
    if forward is not None and len(forward) == rows:
        return forward
    both = (forward, _reach(state, driver, -offsets))
    best = max((m for m in both if m is not None), key=len, default=None)
    return best if best is not None and len(best) > 1 else state
