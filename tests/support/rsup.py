"""An R-S-U-P linkage in closed form, cut at any of its four pairs."""

import mechanisms as known
import mpmath
import numpy as np
import pinocchio as pin
from masses import heavy
from mpmath import asin, atan2, cos, mpf, sin, sqrt

CRANK, TILT, ROD, RAIL = "0.1", "0.7", "0.4", ("0.05", "-0.3")  # m, rad, m, (y, z) of the rail
WEIGHTS = {"crank": (0.8, (0.04, 0.01, 0.02), (1e-3, 2e-3, 2.5e-3)),
           "rod": (0.5, (0.02, -0.01, 0.22), (6e-3, 7e-3, 1e-3)),
           "slider": (1.3, (0.01, 0.02, 0.03), (1e-3,) * 3)}
BODIES = {"crank": ((0, 0, 0), (float(TILT), 0, 0)), "slider": ((0, *map(float, RAIL)), (0, 0, 0))}


def poses(phi):
    """Rotation and place of crank, rod and slider: the ball is at distance ROD of the slider."""
    def about(axis, t):
        c, s = cos(t), sin(t)
        return mpmath.matrix({"x": [[1, 0, 0], [0, c, -s], [0, s, c]],
                              "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
                              "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}[axis])

    crank = about("x", mpf(TILT)) * about("z", phi)
    ball = crank * mpmath.matrix([mpf(CRANK), 0, 0])
    y, z = (mpf(x) for x in RAIL)
    rod, across = mpf(ROD), (ball[1] - y, ball[2] - z)
    x = sqrt(rod**2 - across[0]**2 - across[1]**2)  # the ball is ahead of the slider
    slide = mpmath.matrix([ball[0] - x, y, z])
    second, first = asin(x / rod), atan2(-across[0], across[1])
    return {"crank": (crank, mpmath.zeros(3, 1)), "slider": (mpmath.eye(3), slide),
            "rod": (about("x", first) * about("y", second), slide)}, (slide[0], first, second)


def ends(*names):
    places = {"crank_ball": ("crank", (float(CRANK), 0, 0)),
              "rod_ball": ("rod", (0, 0, float(ROD))),
              "rod_end": ("rod", (0, 0, 0)), "slider_end": ("slider", (0, 0, 0)),
              "bearing": ("ground", *BODIES["crank"]), "rail": ("ground", *BODIES["slider"]),
              "hub": ("crank", (0, 0, 0))}
    return "".join(known.point(name, *places[name]) for name in names)


BEARING = known.turning("R", "ground", "crank", BODIES["crank"][0], rpy=BODIES["crank"][1])
GUIDE = known.sliding("P", "ground", "slider", BODIES["slider"][0], (1, 0, 0))
BALL = known.refine("S", "spherical")
GIMBAL = known.refine("U", "universal", axis=(1, 0, 0), axis2=(0, 1, 0))
CUTS = {
    "S": (BEARING + GUIDE + known.floating("U", "slider", "rod"), ("crank_ball", "rod_ball"),
          GIMBAL + known.closure("S", "spherical", "crank_ball", "rod_ball")),
    "U": (BEARING + GUIDE + known.floating("S", "crank", "rod_body", (float(CRANK), 0, 0))
          + known.point("rod", "rod_body", (0, 0, -float(ROD))), ("slider_end", "rod_end"),
          BALL + known.closure("U", "universal", "slider_end", "rod_end", axis=(1, 0, 0),
                               axis2=(0, 1, 0))),
    "P": (BEARING + known.floating("S", "crank", "rod_body", (float(CRANK), 0, 0))
          + known.point("rod", "rod_body", (0, 0, -float(ROD)))
          + known.floating("U", "rod", "slider_back"), ("rail",), ""),
    "R": (GUIDE + known.floating("U", "slider", "rod")
          + known.floating("S", "rod", "crank_body", (0, 0, float(ROD)))
          + known.point("crank", "crank_body", (-float(CRANK), 0, 0)), ("bearing", "hub"),
          GIMBAL + BALL + known.closure("R", "revolute", "bearing", "hub")),
}
# cut at the rail, the universal joint is met from the rod: its pins are the other way round
CUTS["P"] = (CUTS["P"][0].replace("slider_back", "slider"), ("rail", "slider_end"),
             BALL + known.refine("U", "universal", axis=(0, 1, 0), axis2=(1, 0, 0))
             + known.closure("P", "prismatic", "rail", "slider_end", axis=(1, 0, 0)))


def rsup(folder, cut, phi):
    """The mechanism cut at one pair, guessed at crank angle phi."""
    tree, names, toml = CUTS[cut]
    at, (slide, first, second) = poses(mpf(phi))
    turn = {name: np.array(x[0].tolist(), float) for name, x in at.items()}
    ball = pin.log3(turn["crank"].T @ turn["rod"])
    guesses = {"R": phi, "P": float(slide), "U": [float(first), float(second)], "S": ball}
    if cut == "P":
        guesses["U"] = [-float(second), -float(first)]
    if cut == "R":
        guesses["S"] = -ball
    toml += known.driver("motor", "P" if cut == "R" else "R")
    toml += known.guess(**{k: v for k, v in guesses.items() if k != cut})
    return known.load(folder, f"rsup_{cut}", heavy(tree + ends(*names), **WEIGHTS), toml)
