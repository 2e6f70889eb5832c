"""The bodies of a mechanism as its visuals, each in its colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from spatial_pin.errors import warn
from spatial_pin.view.scene.shapes import coloured, solid
from spatial_pin.view.scene.stage import Item, Layer, Stage

# bodies without a colour of their own: steel grey ground, then colours of Okabe and Ito, and wine
# instead of their purple, which is this grey to who cannot tell red from green
GROUND_COLOUR = (0.62, 0.66, 0.70, 1.0)
BODY_COLOURS = (
    (0.835, 0.369, 0.000, 1.0),
    (0.000, 0.447, 0.698, 1.0),
    (0.000, 0.620, 0.451, 1.0),
    (0.902, 0.624, 0.000, 1.0),
    (0.533, 0.133, 0.333, 1.0),
    (0.337, 0.706, 0.914, 1.0),
)


def colour(visual: pin.GeometryObject) -> tuple[float, ...]:
    """Return the colour (red, green, blue, opacity) of a geometry object, 0 to 1 each."""
    if visual.overrideMaterial:
        return tuple(float(x) for x in np.clip(visual.meshColor, 0.0, 1.0))
    if visual.parentJoint == 0:
        return GROUND_COLOUR
    return BODY_COLOURS[(visual.parentJoint - 1) % len(BODY_COLOURS)]


def link_of(visual: pin.GeometryObject, model: pin.Model) -> str:
    """Return the link that a geometry object belongs to; the first of its joint if it tells none.

    The sticks of a skeleton tell none.
    """
    if visual.parentFrame < model.nframes:  # the largest number there is stands for none
        own = model.frames[visual.parentFrame]
        if own.type == pin.FrameType.BODY and own.parentJoint == visual.parentJoint:
            return str(own.name)
    return next((str(f.name) for f in model.frames
                 if f.type == pin.FrameType.BODY and f.parentJoint == visual.parentJoint),
                str(model.names[visual.parentJoint]))


def body_items(visuals: Sequence[pin.GeometryObject], stage: Stage) -> tuple[Item, ...]:
    """Return every geometry object that can be drawn, fixed to its joint; warn of the others."""
    items, model = [], stage.film.mechanism.model
    for k, visual in enumerate(visuals):
        joint, place = int(visual.parentJoint), visual.placement.homogeneous
        name, own, link = f"{k} {visual.name}", colour(visual), link_of(visual, model)
        parts = coloured(visual)
        items += [Item(f"{name} part {i}", part, painted or own, joint, place, called=link)
                  for i, (part, painted) in enumerate(parts)]
        drawn = None if parts else solid(visual, stage.size)
        if drawn is not None:
            items.append(Item(name, drawn, own, joint, place, called=link))
        elif not parts:
            empty = type(visual.geometry).__name__
            warn(f"{visual.name!r} is not shown: it is an empty {empty}")
    return tuple(items)


def bodies(stage: Stage) -> Layer:
    """Return the bodies of a film."""
    return Layer(body_items(stage.visuals, stage))
