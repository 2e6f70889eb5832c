"""The forces of a motion that is shown."""

from __future__ import annotations

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.kinetostatics import Kinetostatics, kinetostatics
from spatial_pin.dynamics.simulation.simulate import Simulation
from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion


def loads(shown: Motion | State, motion: Motion) -> Kinetostatics:
    """Return efforts and reactions with which the drivers bring a motion about.

    Args:
        shown: what the motion was taken from.
        motion: the samples in question.

    Raises:
        SpatialPinError: the drivers cannot bring it about, or it is a simulation in which other
            forces acted too, which would be taken for theirs.
    """
    if isinstance(shown, Simulation) and not shown.by_drivers:
        raise SpatialPinError(
            f"mechanism {motion.mechanism.name!r}: efforts elsewhere than at its drivers, laws "
            "of springs, or a slip speed of its own acted in this simulation: use `kinetostatics` "
            "with `actuated`, `laws` and `slip_speed`"
        )
    return kinetostatics(motion.mechanism, motion)
