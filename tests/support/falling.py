"""A four-bar whose frame floats: how to begin with, and what falls."""

from __future__ import annotations

import mechanisms as known
import numpy as np
from masses import heavy

GRAVITY = np.array([1.0, -2.0, -9.0])
ORIGIN = {"xyz": (0.3, -0.2, 0.5), "rpy": (0.4, -0.7, 1.1)}
BASE = known.refine("base", "floating")


def rod(mass, length):
    return mass, (0.5 * length, 0.0, 0.0), (0.001, mass * length**2 / 12, mass * length**2 / 12)


def four_bar(folder, toml=""):
    """A closed four-bar with a heavy frame that floats."""
    tree = heavy(known.floating("base", "ground", "frame", **ORIGIN)
                 + known.turning("a", "frame", "crank")
                 + known.turning("b", "crank", "coupler", (0.3, 0, 0))
                 + known.turning("c", "frame", "rocker", (0.9, 0, 0))
                 + known.point("end", "coupler", (0.8, 0, 0))
                 + known.point("eye", "rocker", (0.6, 0, 0))
                 + known.point("nail", "ground", (0.1, 0.2, 0.3)),
                 frame=(2.0, (0.45, 0.1, 0), (0.1, 0.2, 0.25)), crank=rod(0.5, 0.3),
                 coupler=rod(1.0, 0.8), rocker=rod(0.8, 0.6))
    mech = known.load(folder, "four_bar", tree, f"gravity = {GRAVITY.tolist()}\n" + toml + BASE
                      + known.closure("pin", "revolute", "end", "eye") + known.driver("a", "a"))
    return mech, {"a": 0.4, "b": 1.0, "c": 1.2}
