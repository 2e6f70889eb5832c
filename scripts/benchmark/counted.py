"""Mechanisms whose configurations are counted: forty poses of a platform, sixteen of an arm.

Forty: six legs of given lengths [Dietmaier1998]. Sixteen: six hinges in general position between
a base and a hand that is held [ManochaCanny1994].
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from published_models import ZERO, closure, joint, made, point

import spatial_pin as sp

BASE = ((0, 0, 0), (1.107915, 0, 0), (0.549094, 0.756063, 0), (0.735077, -0.223935, 0.525991),
        (0.514188, -0.526063, -0.368418), (0.590473, 0.094733, -0.205018))
PLATFORM = ((0, 0, 0), (0.542805, 0, 0), (0.956919, -0.528915, 0),
            (0.665885, -0.353482, 1.402538), (0.478359, 1.158742, 0.107672),
            (-0.137087, -0.235121, 0.353913))
LEGS = 1.0, 0.645275, 1.086284, 1.503439, 1.281933, 0.771071
ARM = ((0.3, 0, 90), (1, 0, 1), (0, 0.2, 90), (1.5, 0, 1), (0, 0, 90), (0, 0, 1))  # a, d, alpha [°]
HELD = -14, -104, -116, 2, 8, -78  # one configuration of the hand [°]


def platform() -> sp.Mechanism:
    """Return a free platform, its legs as six distances."""
    tree, toml = joint("floating", "pose", "ground", "platform"), ""
    for k, (foot, tip, length) in enumerate(zip(BASE, PLATFORM, LEGS, strict=True)):
        tree += point(f"a{k}", "ground", foot) + point(f"b{k}", "platform", tip)
        toml += closure(f"leg{k}", "distance", f"a{k}", f"b{k}", f"length = {length}")
    return made("dietmaier", tree, toml, ZERO)


def arm() -> sp.Mechanism:
    """Return six hinges in general position, welded to where known angles put the hand."""
    tree, last, at, goal = "", "ground", pin.SE3.Identity(), pin.SE3.Identity()
    for k, ((a, d, alpha), angle) in enumerate(zip(ARM, HELD, strict=True)):
        tree += joint("continuous", f"j{k}", last, f"link{k}", at.translation,
                      rpy=pin.rpy.matrixToRpy(at.rotation))
        last = f"link{k}"
        at = pin.SE3(pin.rpy.rpyToMatrix(np.radians(alpha), 0.0, 0.0), np.array([a, 0.0, d]))
        goal *= pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.radians(angle)), np.zeros(3)) * at
    for name, on, placed in (("hand", last, at), ("goal", "ground", goal)):
        tree += point(name, on, placed.translation, pin.rpy.matrixToRpy(placed.rotation))
    return made("arm", tree, closure("grip", "weld", "goal", "hand"), ZERO)


def rssr() -> sp.Mechanism:
    """Return the RSSR of the library; its crank stands where the guess has it."""
    return sp.load("rssr")


COUNTS = {"RSSR": (rssr, 2), "six legs": (platform, 40), "six hinges": (arm, 16)}
