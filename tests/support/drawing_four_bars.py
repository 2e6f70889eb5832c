"""The four-bar that a design is, in the literature's numbers."""

from __future__ import annotations

import numpy as np
import synthesis_forms as forms


def bar(design) -> forms.FourBar:
    """Return the dimensions of a design that draws a path, in the literature's order."""
    lengths = design.mechanism.dimensions
    return forms.FourBar(*(lengths[name] for name in forms.FourBar._fields))


def at(state, name) -> np.ndarray:
    """Return where the origin of a link is in the plane."""
    return state.placement(name).translation[:2]


def side(design) -> int:
    """Return on which side of the diagonal the rocker's tip of a four-bar is."""
    tip, end, pivot = (at(design.states[0], name) for name in ("coupler", "rocker_end", "rocker"))
    return int(np.sign(np.linalg.det([pivot - tip, end - tip])))
