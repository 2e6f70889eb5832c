"""Machines that tests of several rooms move."""

from __future__ import annotations

import math
import re
from functools import cache

import mechanisms as known
import numpy as np
from closed_forms import Pose, placement, rotation, vector
from masses import heavy
from mechanisms import (
    closure,
    driver,
    floating,
    guess,
    joint,
    load,
    point,
    refine,
    sliding,
    turning,
)
from mpmath import asin, atan2, cos, mp, mpf, sin, sqrt
from scipy.optimize import brentq

import spatial_pin as sp

X, Y, Z = np.eye(3, dtype=int)
UPRIGHT = np.eye(3, dtype=int)  # the orientation of what does not turn
ARMS = (-0.2, 0.3)  # the held angles of the delta's arms 2 and 3


def delta(arm_1, sb=0.567, sp=0.076, lu=0.524, ll=1.244, w=0.13, others=ARMS) -> Pose:
    """The platform is ll below the elbows, when these are moved in by its corners."""
    sb, sp, lu, ll, w = map(mpf, (sb, sp, lu, ll, w))
    base, corner = sb * sqrt(3) / 6, sp * sqrt(3) / 3
    out = base + lu - corner
    home = atan2(-out, -sqrt(ll**2 - out**2))  # of a rod in the plane of its arm
    arms, elbows = [], []
    for k, angle in enumerate((arm_1, *map(mpf, others))):
        yaw = rotation(Z, 2 * mp.pi / 3 * k - mp.pi / 2)
        arms.append(placement(yaw.dot(rotation(Y, angle)), base * yaw[:, 0]))
        elbows.append(yaw.dot(vector(base - corner + lu * cos(angle), 0, -lu * sin(angle))))
    # |P - elbow| = ll for each: P = E1 + a u + b v + c n, u along E1 E2, n normal to all three
    first, second = elbows[1] - elbows[0], elbows[2] - elbows[0]
    side = sqrt(first.dot(first))
    u = first / side
    across = second - u.dot(second) * u
    height = sqrt(across.dot(across))
    v = across / height
    a = side / 2
    b = (second.dot(second) - 2 * a * u.dot(second)) / (2 * height)
    p = elbows[0] + a * u + b * v - sqrt(ll**2 - a**2 - b**2) * np.cross(u, v)
    coordinates = {"shoulder_1": arm_1, "shoulder_2": mpf(others[0]), "shoulder_3": mpf(others[1])}
    points = {}
    for k, (arm, elbow) in enumerate(zip(arms, elbows, strict=True), 1):
        rod = arm[:3, :3].T.dot(p - elbow) / ll
        yaw = rotation(Z, 2 * mp.pi / 3 * (k - 1) - mp.pi / 2)
        for name, y in (("a", -w / 2), ("b", w / 2)):
            coordinates[f"elbow_{k}{name}.first"] = atan2(rod[0], rod[2]) - home
            coordinates[f"elbow_{k}{name}.second"] = -asin(rod[1])
            points[f"rod_{k}{name}_end"] = p + yaw.dot(vector(corner, y, 0))
            points[f"rod_{k}{name}"] = elbow + yaw.dot(vector(corner, y, 0))
    return Pose(coordinates, {"platform": placement(UPRIGHT, p),
                              **{f"arm_{k}": arm for k, arm in enumerate(arms, 1)}}, points)


G = "gravity = [0.0, -9.81, 0.0]\n"
ROD = (0.3, (0.3, 0, 0), (1e-4, 2e-3, 2e-3))


def coplanar(arm_1: float, held: tuple[float, float]) -> float:
    """The volume of the three axes that the parallelograms let the platform turn about."""
    pose = delta(arm_1, others=held)
    rods = [pose.points[f"rod_{k}a_end"] - pose.points[f"rod_{k}a"] for k in (1, 2, 3)]
    axes = [np.cross(rod, pose.links[f"arm_{k}"][:3, 1]) for k, rod in enumerate(rods, 1)]
    return float(np.linalg.det(np.array(axes, dtype=float)))


@cache
def change_points(held: tuple[float, float]) -> list[float]:
    """The driver values below 2.6 rad, where arms are far out, at which the axes are coplanar."""
    grid = np.linspace(2.1, 2.6, 51)
    volumes = [coplanar(x, held) for x in grid]
    return [brentq(coplanar, grid[i], grid[i + 1], args=(held,), xtol=1e-14)
            for i in range(50) if volumes[i] * volumes[i + 1] < 0]


def arms(held: tuple[float, float]) -> dict[str, float]:
    return dict(zip(("arm_2", "arm_3"), held, strict=True))


def three_rods(folder, wrap=str) -> sp.Mechanism:
    """Three equal rods between congruent triangles: a mode of translation, and isolated ones."""
    feet, tips = [(0, 0, 0), (1.0, 0, 0), (0.4, 0.7, 0)], [(1.0, 0, 0), (0.4, 0.7, 0)]
    tree = heavy(
        known.turning("a", "ground", "rod_a") + known.turning("top", "rod_a", "plate", (0.6, 0, 0))
        + known.turning("b", "ground", "rod_b", feet[1])
        + known.turning("c", "ground", "rod_c", feet[2]),
        rod_a=ROD, rod_b=ROD, rod_c=ROD, plate=(1.0, (0.4, 0.2, 0), (1e-3, 1e-2, 1e-2)))
    toml = G + known.driver("a", "a")
    for name, tip in zip("bc", tips, strict=True):
        tree += known.point(f"end_{name}", f"rod_{name}", (0.6, 0, 0))
        tree += known.point(f"corner_{name}", "plate", tip)
        toml += known.closure(f"pin_{name}", "revolute", f"end_{name}", f"corner_{name}")
    return known.load(folder, "three_rods", wrap(tree), toml)


def translation(mechanism: sp.Mechanism, angle: float) -> sp.State:
    return sp.assemble(mechanism, guess={"a": angle, "top": -angle, "b": angle, "c": angle})


def arm(folder, lengths=(1.0, 0.8, 0.6), limits=()):
    """Return a plane arm of hinges about z, masses at the links' ends."""
    links = ["<link name='base'/>"]
    for k, length in enumerate(lengths, start=1):
        bound = limits[k - 1] if k <= len(limits) else None
        kind, stop = ("revolute", f"<limit lower='{bound[0]}' upper='{bound[1]}' effort='1' "
                      "velocity='1'/>") if bound else ("continuous", "")
        place = lengths[k - 2] if k > 1 else 0.0
        parent = f"link{k - 1}" if k > 1 else "base"
        links.append(
            f"<link name='link{k}'><inertial><origin xyz='{length} 0 0'/><mass value='{k}'/>"
            "<inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial></link>"
            f"<joint name='j{k}' type='{kind}'><parent link='{parent}'/><child link='link{k}'/>"
            f"<origin xyz='{place} 0 0'/><axis xyz='0 0 1'/>{stop}</joint>")
    links.append(f"<link name='tip'/><joint name='end' type='fixed'><parent link='link"
                 f"{len(lengths)}'/><child link='tip'/><origin xyz='{lengths[-1]} 0 0'/></joint>")
    (folder / "arm.urdf").write_text(f"<robot name='arm'>{''.join(links)}</robot>")
    return sp.load(folder / "arm.urdf")


def at(mechanism, *angles):
    names = mechanism.coordinates
    return sp.assemble(mechanism, dict(zip(names, angles, strict=True)))


HARD_POINTS = {  # of a double wishbone [m]: x forward, y outward, z up
    "lower_pivot": (0.0, 0.35, 0.20), "lower_ball": (0.0, 0.72, 0.18),
    "upper_pivot": (-0.02, 0.42, 0.46), "upper_ball": (-0.03, 0.68, 0.48),
    "rack_end": (-0.12, 0.33, 0.24), "arm_end": (-0.14, 0.70, 0.23),
}


def wishbone(folder, size=1.0, rack=0.0):
    """A double wishbone: the lower arm (wheel travel) and the rack are driven."""
    p = {name: size * np.array(x) for name, x in HARD_POINTS.items()}
    tie = float(np.linalg.norm(p["arm_end"] - p["rack_end"]))
    tree = (turning("travel", "ground", "lower", p["lower_pivot"], axis=(1, 0, 0))
            + turning("upper_pin", "ground", "upper", p["upper_pivot"], axis=(1, 0, 0))
            + sliding("rack", "ground", "rack_bar", p["rack_end"], axis=(0, 1, 0))
            + floating("ball", "lower", "upright", p["lower_ball"] - p["lower_pivot"])
            + point("upright_top", "upright", p["upper_ball"] - p["lower_ball"])
            + point("upper_end", "upper", p["upper_ball"] - p["upper_pivot"])
            + point("steering_arm", "upright", p["arm_end"] - p["lower_ball"]))
    toml = (refine("ball", "spherical") + driver("wheel", "travel") + driver("steering", "rack")
            + closure("top", "spherical", "upright_top", "upper_end")
            + closure("tie_rod", "distance", "rack_bar", "steering_arm", length=tie)
            + (guess(rack=size * rack) if rack else ""))
    return load(folder, "wishbone", tree, toml)


def two_motors(folder, rough=0.0):
    """A plane four-bar with a motor at the crank and another at the rocker: one too many."""
    tree = (turning("crank", "ground", "a") + turning("knee", "a", "b", (0.1, 0, 0))
            + turning("rocker", "ground", "c", (0.3, 0, 0))
            + point("b_end", "b", (0.28, 0, 0)) + point("c_end", "c", (0.24, 0, 0)))
    toml = (closure("pin", "revolute", "b_end", "c_end") + driver("first", "crank")
            + driver("second", "rocker") + guess(crank=0.4, knee=0.4, rocker=1.5 + rough))
    return load(folder, "two_motors", tree, toml)


def rocker_of(crank):
    """The rocker's angle, coupler above, by the law of cosines."""
    x, y = 0.3 - 0.1 * math.cos(crank), -0.1 * math.sin(crank)
    d = math.hypot(x, y)
    return math.atan2(y, x) + math.pi - math.acos((d**2 + 0.24**2 - 0.28**2) / (2 * d * 0.24))


def limited_slider(folder):
    """A slider-crank whose rail ends before the crank's dead centres."""
    tree = (turning("crank", "ground", "a") + turning("knee", "a", "b", (0.1, 0, 0))
            + joint("prismatic", "slide", "ground", "c", axis=(1, 0, 0), limits=(0.25, 0.38))
            + point("b_end", "b", (0.3, 0, 0)))
    toml = closure("pin", "revolute", "b_end", "c") + driver("crank", "crank")
    return load(folder, "limited", tree, toml + guess(crank=1.2, slide=0.3))


def free_bases(mechanism: sp.Mechanism) -> tuple[str, ...]:
    """Return the joints of which the mobility says that they are free bases."""
    return tuple(re.findall(r"(\S+) carries all of it as a free base", str(sp.mobility(mechanism))))
