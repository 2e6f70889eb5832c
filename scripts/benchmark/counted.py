"""Mechanisms whose configurations are counted: forty poses of a platform, sixteen of an arm.

Forty: six legs of given lengths [Dietmaier1998]. Sixteen: six hinges in general position between
a base and a hand that is held [ManochaCanny1994].
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin
from dietmaier import dietmaier
from published_models import ZERO, closure, joint, made, point

import spatial_pin as sp

ARM = ((0.3, 0, 90), (1, 0, 1), (0, 0.2, 90), (1.5, 0, 1), (0, 0, 90), (0, 0, 1))  # a, d, alpha [°]
HELD = -14, -104, -116, 2, 8, -78  # one configuration of the hand [°]


def platform() -> sp.Mechanism:
    """Return a free platform, its legs as six distances."""
    with TemporaryDirectory() as folder:
        return dietmaier(Path(folder))


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
    """Return the RSSR of the library; its crank at the guess."""
    return sp.load("rssr")


COUNTS = {"RSSR": (rssr, 2), "six legs": (platform, 40), "six hinges": (arm, 16)}
