"""Mechanisms whose joints have limits, and where they pass them."""

import mechanisms as known
import numpy as np
from loaded_library import library
from masses import heavy

DOWN = "gravity = [0.0, -9.81, 0.0]\n"
LOWER, UPPER = 0.1103, 0.209  # of the slide, which goes from 0.11 to 0.21


def hanging(folder, lower, upper, second=False):
    """A rod that hangs down at 0, with limits; with another joint, a second freedom that rests."""
    tree = known.joint("revolute", "pin", "ground", "bob", (0, 0, 0), (0, 0, -np.pi / 2),
                       (0, 0, 1), (lower, upper))
    if second:
        tree += known.sliding("far", "ground", "block", axis=(1, 0, 0))
        tree = heavy(tree, block=(1.0,))
    tree = heavy(tree, bob=(1.5, (0.4, 0, 0), (0.0, 0.02, 0.02)))
    return known.load(folder, "hanging", tree, DOWN + known.driver("pin", "pin"))


def limited_slider_crank():
    """The library's, with limits of the slide."""
    mech = library("slider_crank")
    at, model = mech.coordinate("slide").q, mech.model
    for name, value in (("lowerPositionLimit", LOWER), ("upperPositionLimit", UPPER)):
        limits = getattr(model, name).copy()
        limits[at] = value
        setattr(model, name, limits)
    return mech


def crank_at(x):
    """Crank angle in (0, pi) at a place of the slide: law of cosines, crank 0.05, rod 0.16."""
    return float(np.arccos((x * x + 0.05**2 - 0.16**2) / (2.0 * x * 0.05)))
