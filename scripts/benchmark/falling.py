"""Plane parallel robots that hang from their pins and fall for 10 s: five-bar and 3-RRR.

Legs of two slender rods hang from pins of the ground, knees outwards; their tips meet in a point,
or carry a platform's corners. Nobody drives them, and nothing brakes them: they swing with two and
three freedoms, and angles of the latter are lost in a few seconds, whoever follows them. What is
judged is energy: the difference at the end to the start, relative to the weight's work over a leg.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from published_models import closure, inertial, joint, made, point

import spatial_pin as sp

Array = NDArray[np.float64]

DURATION, G = 10.0, 9.81
UPPER, LOWER = 0.4, 0.5  # of a leg [m], 1 kg a metre
THIRDS = [math.pi / 2.0 + 2.0 * math.pi * k / 3.0 for k in range(3)]


class Leg(NamedTuple):
    """Two rods from a pin of the ground to a tip: URDF text, and values of their hinges [rad]."""

    tree: str
    values: dict[str, float]


def leg(name: str, pin: Array, tip: Array, bend: float) -> Leg:
    """Return the rods from a pin to a tip; `bend` is the side of the knee."""
    x, y = tip - pin
    far = math.hypot(x, y)
    knee = math.acos((UPPER**2 + far**2 - LOWER**2) / (2.0 * UPPER * far)) * bend
    upper = math.atan2(y, x) + knee
    elbow = pin + UPPER * np.array([math.cos(upper), math.sin(upper)])
    lower = math.atan2(*(tip - elbow)[::-1])
    tree = joint("continuous", f"{name}_pin", "ground", f"{name}_upper", (*pin, 0.0),
                 mass=slender(UPPER))
    tree += joint("continuous", f"{name}_knee", f"{name}_upper", f"{name}_lower", (UPPER, 0.0, 0.0),
                  mass=slender(LOWER))
    tree += point(f"{name}_tip", f"{name}_lower", (LOWER, 0.0, 0.0))
    return Leg(tree, {f"{name}_pin": upper, f"{name}_knee": lower - upper})


def slender(length: float) -> str:
    """Return the inertia of a rod."""
    across = length**3 / 12.0
    return inertial(length, (length / 2.0, 0.0, 0.0), (across / 2.0, across / 2.0, across))


def five_bar() -> sp.State:
    """Return two legs whose tips meet beside the middle."""
    tip = np.array([0.35, -0.55])
    left, right = leg("left", np.zeros(2), tip, -1.0), leg("right", np.array([0.4, 0.0]), tip, 1.0)
    mechanism = made("five_bar", left.tree + right.tree,
                     closure("tips", "revolute", "left_tip", "right_tip"), (0.0, -G, 0.0))
    return sp.assemble(mechanism, left.values | right.values)


def three_legs() -> sp.State:
    """Return three legs with a platform, pins on a circle, one of them on top."""
    side, radius, turned, centre = 0.2, 0.6, 0.2, np.array([0.05, -0.08])
    spin = np.array([[math.cos(turned), -math.sin(turned)], [math.sin(turned), math.cos(turned)]])
    out = [np.array([math.cos(t), math.sin(t)]) for t in THIRDS]
    legs = [leg(f"leg_{k}", radius * x, centre + spin @ (side * x), 1.0) for k, x in enumerate(out)]
    tree = "".join(one.tree for one in legs)  # the platform hangs on the first, its axes from there
    tree += joint("continuous", "platform_pin", "leg_0_lower", "platform", (LOWER, 0.0, 0.0),
                  mass=inertial(1.0, (*(-side * out[0]), 0.0), (0.01, 0.01, 0.02)))
    toml = ""
    for k in (1, 2):
        tree += point(f"corner_{k}", "platform", (*(side * (out[k] - out[0])), 0.0))
        toml += closure(f"pin_{k}", "revolute", f"leg_{k}_tip", f"corner_{k}")
    values = {"platform_pin": turned - sum(legs[0].values.values())}
    for one in legs:
        values |= one.values
    return sp.assemble(made("three_legs", tree, toml, (0.0, -G, 0.0)), values)


ROBOTS = {"five-bar": five_bar, "3-RRR": three_legs}


def judge(
    mechanism: sp.Mechanism, gained: float, closure: float | None
) -> dict[str, float | None]:
    """Return the error of energy, with `gained` [J] from nowhere, and the closure [m]."""
    weight = G * sum(body.mass for body in mechanism.model.inertias)
    return {"energy": abs(gained) / (weight * (UPPER + LOWER)), "closure": closure}
