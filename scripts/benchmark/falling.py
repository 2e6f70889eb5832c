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

Array = NDArray[np.float64]

DURATION, G = 10.0, 9.81
UPPER, LOWER = 0.4, 0.5  # of a leg [m], 1 kg a metre
THIRDS = [math.pi / 2.0 + 2.0 * math.pi * k / 3.0 for k in range(3)]


class Rod(NamedTuple):
    """A slender rod, or a platform of three corners.

    Attributes:
        name: of the body.
        parent: index of the body that it is pinned to, -1 for the ground.
        at: (2,) where the pin stands in the parent's axes [m].
        angle: of the body against its parent at the start [rad].
        com: (2,) centre of mass in own axes [m].
        mass: [kg].
        inertia: about the centre of mass, normal to the plane [kg m²].
    """

    name: str
    parent: int
    at: tuple[float, float]
    angle: float
    com: tuple[float, float]
    mass: float
    inertia: float


class Robot(NamedTuple):
    """Bodies, and closures: pins between a point of a body and a point of another one.

    Attributes:
        rods: the bodies, each after its parent and before its parent's other branches.
        closures: (body, (2,) point, body, (2,) point).
    """

    rods: tuple[Rod, ...]
    closures: tuple[tuple[int, tuple[float, float], int, tuple[float, float]], ...]


def _leg(name: str, pin: Array, tip: Array, first: int, bend: float) -> tuple[Rod, Rod]:
    """Return the rods from a pin to a tip; `bend` says on which side the knee is."""
    x, y = tip - pin
    far = math.hypot(x, y)
    knee = math.acos((UPPER**2 + far**2 - LOWER**2) / (2.0 * UPPER * far)) * bend
    upper = math.atan2(y, x) + knee
    elbow = pin + UPPER * np.array([math.cos(upper), math.sin(upper)])
    lower = math.atan2(*(tip - elbow)[::-1])
    return (_rod(f"{name}_upper", -1, tuple(pin), upper, UPPER),
            _rod(f"{name}_lower", first, (UPPER, 0.0), lower - upper, LOWER))


def _rod(name: str, parent: int, at: tuple[float, ...], angle: float, length: float) -> Rod:
    return Rod(name, parent, (float(at[0]), float(at[1])), angle, (length / 2.0, 0.0), length,
               length**3 / 12.0)


def five_bar() -> Robot:
    """Return two legs whose tips meet beside the middle."""
    tip = np.array([0.35, -0.55])
    left = _leg("left", np.array([0.0, 0.0]), tip, 0, -1.0)
    right = _leg("right", np.array([0.4, 0.0]), tip, 2, 1.0)
    return Robot((*left, *right), ((1, (LOWER, 0.0), 3, (LOWER, 0.0)),))


def three_legs() -> Robot:
    """Return three legs with a platform, pins on a circle, one of them on top."""
    side, radius, turned, centre = 0.2, 0.6, 0.2, np.array([0.05, -0.08])
    corners = [side * np.array([math.cos(t), math.sin(t)]) for t in THIRDS]
    spin = np.array([[math.cos(turned), -math.sin(turned)], [math.sin(turned), math.cos(turned)]])
    rods: list[Rod] = []
    for k, (t, corner) in enumerate(zip(THIRDS, corners, strict=True)):
        pin = radius * np.array([math.cos(t), math.sin(t)])
        rods += _leg(f"leg_{k}", pin, centre + spin @ corner, len(rods), 1.0)
        if not k:  # it hangs on the first leg, its axes from that corner
            lower = rods[0].angle + rods[1].angle
            rods.append(Rod("platform", 1, (LOWER, 0.0), turned - lower,
                            (-corners[0][0], -corners[0][1]), 1.0, 0.02))
    arms = [corner - corners[0] for corner in corners]
    closures = tuple((2 * k + 2, (LOWER, 0.0), 2, (float(arms[k][0]), float(arms[k][1])))
                     for k in (1, 2))
    return Robot(tuple(rods), closures)


ROBOTS = {"five-bar": five_bar, "3-RRR": three_legs}


def judge(robot: Robot, gained: float, closure: float | None) -> dict[str, float | None]:
    """Return the error of energy, of which `gained` [J] came from nowhere, and the closure [m]."""
    weight = G * sum(rod.mass for rod in robot.rods)
    return {"energy": abs(gained) / (weight * (UPPER + LOWER)), "closure": closure}
