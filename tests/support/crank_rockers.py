"""Plane four-bars whose crank turns: closed forms, a problem of design, limits of the rocker."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

import spatial_pin as sp

GROUND = 0.30  # of the library's four-bar
TURN = np.linspace(0.0, 2.0 * np.pi, 721)


def swing_of(a, b, c, d=GROUND):
    """Return the rocker's swing between stretched and folded positions, by the law of cosines."""
    angle = [np.arccos((c * c + d * d - reach * reach) / (2.0 * c * d)) for reach in (b + a, b - a)]
    return angle[0] - angle[1]


def least_transmission_of(a, b, c, d=GROUND):
    """Return the least transmission angle, which is where the crank is in line with the ground."""
    cosines = [(b * b + c * c - x * x) / (2.0 * b * c) for x in (d - a, d + a)]
    return min(np.arccos(np.abs(cosines)))


PHI, PSI = np.radians([40.0, 85.0, 130.0]), np.radians([80.0, 100.0, 130.0])
BOUNDS = {"r2": (0.05, 0.6), "r3": (0.05, 0.6), "r4": (0.05, 0.6)}
FUNCTION = sp.goals.function("rocker_pin", PSI, {"crank": PHI})


def assert_same(found, other):
    assert str(found) == str(other) and len(found) == len(other)
    for one, two in zip(found, other, strict=True):
        assert one.error == two.error and one.dimensions == two.dimensions
        for a, b in zip(one.states, two.states, strict=True):
            assert np.array_equal(a.q, b.q)


def limited_four_bar(folder: Path) -> Callable[..., sp.Mechanism]:
    """Return what loads the library's four-bar with limits of its rocker."""
    here = sp.load("four_bar").path.parent
    for name in ("four_bar.toml", "parts.xacro"):
        (folder / name).write_bytes((here / name).read_bytes())
    text = (here / "four_bar.urdf.xacro").read_text()
    start = text.index('<joint name="rocker_pin"')
    joint = text[start:].replace('"continuous">', '"revolute">\n    <limit lower="${$(arg low)}" '
                                 'upper="${$(arg high)}" effort="1" velocity="1"/>', 1)
    arguments = '<xacro:arg name="low" default="-3"/><xacro:arg name="high" default="3"/>\n'
    first = text.index("<xacro:arg")
    (folder / "four_bar.urdf.xacro").write_text(
        text[:first] + arguments + text[first:start] + joint)
    return lambda low, high, **more: sp.load(folder / "four_bar.toml", low=low, high=high, **more)


def ends(design=None, a=0.10, b=0.28, c=0.24, d=0.30):
    """Return the rocker's least and largest angle."""
    if design is not None:
        a, b, c = (design.dimensions.get(name, x) for name, x in
                   (("r2", a), ("r3", b), ("r4", c)))
    inner = [np.arccos((c * c + d * d - x * x) / (2.0 * c * d)) for x in (b + a, b - a)]
    return np.pi - inner[0], np.pi - inner[1]


def of_limits(found):
    return [defect for defect in found if defect.kind == "joint limit"]
