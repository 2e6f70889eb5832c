"""Mechanisms of which the joint that counts their motion turns back."""

from __future__ import annotations

import mechanisms as known
import numpy as np
from masses import heavy

import spatial_pin as sp


def rod(mass, length):
    return mass, (0.5 * length, 0.0, 0.0), (0.0, mass * length**2 / 12, mass * length**2 / 12)


def arm_on_a_slider(folder, seed):
    """A block on a rail and an arm pinned to it, whose tip a rod holds to the ground."""
    rng = np.random.default_rng(seed)
    length, _ = rng.uniform(0.3, 1.2), rng.uniform(-0.5, 0.5)
    slide, angle = rng.uniform(-0.5, 0.5), rng.uniform(-2.0, 2.0)
    tip = np.array([slide + length * np.cos(angle), length * np.sin(angle), 0.0])
    anchor = np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), 0.0])
    tree = (known.sliding("slide", "ground", "block", (0, 0, 0), (1, 0, 0))
            + known.turning("pin", "block", "arm") + known.point("tip", "arm", (length, 0, 0))
            + known.point("anchor", "ground", anchor))
    toml = "gravity = [0.0, -9.81, 0.0]\n" + known.closure(
        "rod", "distance", "tip", "anchor", length=np.linalg.norm(tip - anchor))
    mech = known.load(folder, "arm", heavy(tree, block=(1.0,), arm=rod(1.0, length)), toml)
    return sp.assemble(mech, guess={"slide": slide, "pin": angle})


def rod_end_on_a_line(folder, height, symmetric=True, wrap=str):
    """A crank, a rod on a ball joint at its end, and the rod's end on a line above the crank.

    The crank rocks; beside it only a ball joint moves, whose components count nothing by turns.
    """
    across = 0.06 if symmetric else 0.055
    tree = heavy(known.turning("pin", "ground", "crank")
                 + known.floating("ball", "crank", "rod", (0.5, 0, 0))
                 + known.point("end", "rod", (0.8, 0, 0))
                 + known.point("rail", "ground", (0, 0.9, height), known.rpy_facing((1, 0, 0))),
                 crank=(1.0, (0.25, 0, 0), (0.01, 0.02, 0.02)),
                 rod=(1.0, (0.4, 0, 0), (0.01, 0.06, across)))
    toml = ("gravity = [3.0, -9.81, 0.0]\n" + known.refine("ball", "spherical")
            + known.closure("rail", "point_on_line", "rail", "end"))
    mech = known.load(folder, "rod_end", wrap(tree), toml)
    return sp.assemble(mech, {"pin": 0.6}, guess={"ball": [0.0, 0.0, 1.0]})
