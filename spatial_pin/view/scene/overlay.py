"""What is shown of a design: a motion of its mechanism, with what was asked of it."""

from __future__ import annotations

from dataclasses import replace

from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion
from spatial_pin.synthesis.ranked_designs import Design, Designs
from spatial_pin.view.scene.look import Look

Shown = Motion | State


def overlaid(given: Shown | Design | Designs, look: Look | None) -> tuple[Shown, Look | None]:
    """Return what is shown, and how; a motion or a state as they are.

    Of designs the best is shown, and of it the motion through the samples of its first goal.
    Samples that no motion joins are shown beside each other.

    Raises:
        SpatialPinError: nothing was found.
    """
    if isinstance(given, Designs):
        if not given:
            raise SpatialPinError(f"{given.name}: no design was found that could be shown; ask for "
                                  "more starts, or for less")
        given = given[0]
    if not isinstance(given, Design):
        return given, look
    look = replace(look or Look(), design=given)
    try:
        return given.motion(), look
    except SpatialPinError:  # its defects tell why
        first, *others = given.states
        return first, replace(look, ghosts=(*look.ghosts, *others))
