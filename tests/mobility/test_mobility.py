"""Mobility by formula, by rank and by finite motion, against what is known of each mechanism.

`CASES` and `LIBRARY` list mechanisms with their numbers. Sources: the papers that the library's
files name; Goldberg's five-bar and Schatz's loop by their tables [Baker1979, Phillips1990];
platforms that move with their legs locked [GriffisDuffy1993]; the formulas of [McCarthy2011].
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from mechanisms import (
    ALPHA,
    BETA,
    KNOWN,
    RSCR_AXIS,
    RSCR_CRANK,
    RSCR_N0,
    RSCR_P0,
    bare_four_bar,
    bennett,
    closure,
    driver,
    floating,
    guess,
    load,
    pendulum,
    point,
    refine,
    rpy_facing,
    sliding,
    swash_plate,
    tilted,
    turning,
)

import spatial_pin as sp

pytestmark = pytest.mark.delicate


class Count(NamedTuple):
    """What `sp.mobility` must say."""

    kutzbach: int
    grubler: int
    loops: int
    rank: int
    instantaneous: int
    dof: int
    passive: int = 0
    overconstrained: bool = False


class Case(NamedTuple):
    """A mechanism, its numbers, and the coordinates of the configuration (default: the guess)."""

    build: Callable[[Path], sp.Mechanism]
    count: Count
    at: dict[str, float] | None = None


PLANE = Count(-2, 1, 1, 2, 1, 1, 0, True)  # one plane or spherical loop of four pairs
TWICE = Count(-5, 1, 2, 4, 1, 1, 0, True)  # two of them
BALL_ENDED = Count(2, 2, 1, 3, 2, 2, 1)  # R-S-S-R and R-S-E-R
SPATIAL = Count(1, 1, 1, 3, 1, 1)


def configuration(mechanism: sp.Mechanism, at: dict[str, float] | None) -> np.ndarray | None:
    if at is None:
        return None
    q = np.array(mechanism.neutral)
    for name, value in at.items():
        q[mechanism.coordinate(name).q] = value
    return q


def counted(mobility: sp.Mobility) -> Count:
    return Count(mobility.kutzbach, mobility.grubler, mobility.loops, mobility.rank,
                 mobility.instantaneous, mobility.dof, len(mobility.passive),
                 mobility.overconstrained)


# ---------------------------------------------------------------- loops of hinges


def hinge_link(a: float, twist: float, d: float = 0.0) -> pin.SE3:
    """From one hinge of a link to the next: d along the hinge, a across, then the twist."""
    return pin.SE3(pin.rpy.rpyToMatrix(twist, 0.0, 0.0), np.array([a, 0.0, d]))


def place(M: pin.SE3) -> dict:
    return {"xyz": M.translation, "rpy": pin.rpy.matrixToRpy(M.rotation)}


def hinge_loop(folder: Path, links: list, cut: int = 0, driven: int = 1,
               start: tuple = ()) -> sp.Mechanism:
    """A loop of hinges j1, j2, ..., the last link fixed, cut at a hinge (0: cut the last link).

    Hinge k leads from link k - 1 to link k; angles do not depend on where the loop is cut.
    """
    moves, n = [hinge_link(*link) for link in links], len(links)
    tree, last, at = "", "ground", pin.SE3.Identity()
    for k in range(1, cut or n + 1):
        tree += turning(f"j{k}", last, f"link{k}", **place(at))
        last, at = f"link{k}", moves[k - 1]
    tree += point("front", last, **place(at))
    last, at = "ground", pin.SE3.Identity()
    for k in range(n, cut, -1) if cut else ():
        tree += turning(f"j{k}", last, f"link{k - 1}", axis=(0, 0, -1),
                        **place(moves[k - 1].inverse()))
        last = f"link{k - 1}"
    at = moves[cut - 1].inverse() if cut else at
    tree += point("back", last, **place(at))
    toml = driver("crank", f"j{driven}") if driven != cut else ""
    toml += closure(f"j{cut}" if cut else "seam", "revolute" if cut else "weld", "front", "back")
    angles = {f"j{k}": angle for k, angle in enumerate(start, 1) if k != cut}
    return load(folder, "hinge_loop", tree, toml + (guess(**angles) if angles else ""))


BENNETT = [(0.3 * np.sin(ALPHA), ALPHA), (0.3 * np.sin(BETA), BETA)] * 2
FOLLOWER = 2 * np.arctan(np.sin((BETA + ALPHA) / 2) / np.sin((BETA - ALPHA) / 2) / np.tan(0.5))
BENNETT_ANGLES = (1.0, FOLLOWER, -1.0, -FOLLOWER)
GAMMA = 0.5
GOLDBERG = [  # two of Bennett's loops joined, the common link left out
    (0.3 * (np.sin(ALPHA) + np.sin(GAMMA)), ALPHA + GAMMA), (0.3 * np.sin(BETA), BETA),
    (0.3 * np.sin(ALPHA), ALPHA), (0.3 * np.sin(GAMMA), GAMMA), (0.3 * np.sin(BETA), BETA),
]
RIGHT = np.pi / 2
SCHATZ = [(0, RIGHT, 0.2), (1, RIGHT), (1, RIGHT), (1, RIGHT), (0, RIGHT), (np.sqrt(3), 0, -0.2)]


def nearly_bennett(folder: Path, error: float) -> sp.Mechanism:
    """Three links of Bennett's loop, one with another twist; the fourth fits at one position."""
    links = BENNETT[:3]
    links[1] = (links[1][0], BETA + error)
    tree, last, at, end = "", "ground", pin.SE3.Identity(), pin.SE3.Identity()
    for k, (link, angle) in enumerate(zip(links, BENNETT_ANGLES[:3], strict=True), 1):
        tree += turning(f"j{k}", last, f"link{k}", **place(at))
        last, at = f"link{k}", hinge_link(*link)
        end *= pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, angle), np.zeros(3)) * at
    tree += point("end", last, **place(at)) + point("fit", "ground", **place(end))
    return load(folder, "nearly_bennett", tree, driver("crank", "j1") + closure(
        "j4", "revolute", "end", "fit") + guess(j1=1.0, j2=FOLLOWER, j3=-1.0))


# ---------------------------------------------------------------- plane loops


def four_bar_tree(scale: float = 1.0, ground="ground", lengths=(3.0, 1.0, 2.8, 2.4)) -> str:
    r1, r2, r3, r4 = (scale * r for r in lengths)
    return (turning("crank_pin", ground, "crank")
            + turning("rocker_pin", ground, "rocker", (r1, 0, 0))
            + turning("coupler_pin", "crank", "coupler", (r2, 0, 0))
            + point("tip", "coupler", (r3, 0, 0)) + point("end", "rocker", (r4, 0, 0)))


def four_bar(folder: Path, scale=1.0, kind="revolute", wrap=str, drivers=True) -> sp.Mechanism:
    return load(folder, "four_bar", wrap(four_bar_tree(scale)), closure(
        "output_pin", kind, "tip", "end") + driver("crank", "crank_pin") * drivers)


def far_away(tree: str) -> str:
    """The same tree, a hundred of its lengths away, turned."""
    return (point("base", "ground", (300, -200, 100), (0.4, -0.7, 1.1))
            + tree.replace('"ground"', '"base"'))


STRETCHED = {"crank_pin": 0.0, "coupler_pin": 0.0, "rocker_pin": np.pi}


def shaky_on_a_turntable(folder: Path) -> sp.Mechanism:
    """The stretched four-bar (1 + 1 + 1 = 3) turns as one body: shaky wherever it is."""
    tree = turning("table", "ground", "plate") + four_bar_tree(1.0, "plate", (3, 1, 1, 1))
    return load(folder, "shaky", tree, driver("table", "table") + closure(
        "output_pin", "revolute", "tip", "end"))


def equal_slider_crank(folder: Path) -> sp.Mechanism:
    """Crank and rod of one length: where they lie on each other they may turn as one."""
    tree = (turning("crank_pin", "ground", "crank") + turning("rod_pin", "crank", "rod", (0.1, 0,
                                                                                          0))
            + sliding("slide", "ground", "slider", axis=(1, 0, 0)) + point("end", "rod", (0.1, 0,
                                                                                          0)))
    return load(folder, "equal_slider_crank", tree, driver("crank", "crank_pin") + closure(
        "wrist_pin", "revolute", "end", "slider"))


def double_parallelogram(folder: Path, error: float = 0.0) -> sp.Mechanism:
    """A coupler on three parallel cranks, of which the third may have the wrong length."""
    feet = {"1": (0, 0, 0), "2": (0.3, 0, 0), "3": (0.1, 0.2, 0)}
    tree = "".join(turning(f"pin{k}", "ground", f"crank{k}", foot) for k, foot in feet.items())
    tree += turning("coupler_pin", "crank1", "coupler", (0.1, 0, 0))
    for k, length in (("2", 0.1), ("3", 0.1 + error)):
        tree += point(f"hole{k}", "coupler", feet[k])
        tree += point(f"tip{k}", f"crank{k}", (length, 0, 0))
    return load(folder, "double_parallelogram", tree, driver("crank", "pin1")
                + closure("end2", "revolute", "hole2", "tip2")
                + closure("end3", "revolute", "hole3", "tip3")
                + guess(pin1=1.0, pin2=1.0, pin3=1.0, coupler_pin=-1.0))


BARS = ((0.1, 0.0), (-0.1, 0.05), (0.0, 0.2))  # where three bars hold a plate


def plate_on_bars(folder: Path, feet, drive: str = "") -> sp.Mechanism:
    """A plate in the plane on three bars, in its neutral position."""
    tree, toml = floating("plate", "ground", "plate_link"), refine("plate", "planar")
    for k, (foot, pin_) in enumerate(zip(feet, BARS, strict=True), 1):
        tree += point(f"foot{k}", "ground", (*foot, 0)) + point(f"pin{k}", "plate_link", (*pin_, 0))
        toml += closure(f"bar{k}", "distance", f"foot{k}", f"pin{k}",
                        length=np.hypot(*np.subtract(foot, pin_)))
    return load(folder, "plate_on_bars", tree, toml + (driver("plate", drive) if drive else ""))


CONCURRENT = [tuple((1 - k) * np.array([0.03, 0.04]) + k * np.array(x))  # lines meet in a point
              for k, x in zip((3.0, 3.6, 2.4), BARS, strict=True)]
PARALLEL = [(x, y - 0.5) for x, y in BARS]


# ---------------------------------------------------------------- balls, planes, cylinders


def rssr(folder: Path, size: float = 1.0, resolved: bool = False,
         drivers: bool = True) -> sp.Mechanism:
    a, b, c, d = (size * x for x in (0.102, 0.381, 0.254, 0.314))
    tree = (turning("crank_pin", "ground", "crank", axis=(0, 1, 0))
            + floating("ball_a", "crank", "coupler", (-a, 0, 0))
            + point("coupler_b", "coupler", (0, 0, b))
            + turning("rocker_pin", "ground", "rocker", (-d, 0, 0), (0, 0, -1))
            + point("rocker_b", "rocker", (-c, 0, 0)))
    toml = (refine("ball_a", "spherical") + driver("crank", "crank_pin") * drivers
            + closure("ball_b", "spherical", "coupler_b", "rocker_b")
            + '[passive.spin]\nbody = "coupler"\naxis = ["ball_a", "coupler_b"]\n' * resolved)
    return load(folder, "rssr", tree, toml + guess(rocker_pin=1.2))


def fixed_rod(folder: Path) -> sp.Mechanism:
    """A rod with two balls between two points of the ground."""
    tree = (floating("ball_a", "ground", "rod") + point("rod_b", "rod", (0, 0, 0.3))
            + point("wall", "ground", (0.2, 0.1, 0.2)))
    return load(folder, "fixed_rod", tree, refine("ball_a", "spherical") + closure(
        "ball_b", "spherical", "rod_b", "wall"))


def rscc(folder: Path) -> sp.Mechanism:
    """A rod with a ball at one end and a sleeve round the other."""
    tree = (turning("crank_pin", "ground", "crank", RSCR_CRANK)
            + floating("ball", "crank", "rod", (0.1, 0, 0)) + point("rod_end", "rod", (0, 0, 0.3))
            + floating("output", "ground", "arm")
            + point("bore", "arm", RSCR_P0, rpy_facing(RSCR_N0)))
    return load(folder, "rscc", tree, refine("ball", "spherical")
                + refine("output", "cylindrical", axis=RSCR_AXIS) + driver("crank", "crank_pin")
                + closure("sleeve", "cylindrical", "bore", "rod_end"))


def rser(folder: Path, resolved: bool = False) -> sp.Mechanism:
    """A slipper on a rocker's ball lies flat on a swash plate."""
    tree = (turning("shaft", "ground", "plate")
            + point("face", "plate", rpy=rpy_facing((np.sin(0.3), 0, np.cos(0.3))))
            + turning("rocker_pin", "ground", "rocker", (0.2, 0, 0), (0, 1, 0))
            + floating("ball", "rocker", "slipper", (-0.12, 0, 0))
            + point("sole", "slipper", (0, 0, 0.01)))
    return load(folder, "rser", tree, refine("ball", "spherical") + driver("shaft", "shaft")
                + closure("contact", "planar", "face", "slipper")
                + '[passive.spin]\nbody = "slipper"\naxis = ["ball", "sole"]\n' * resolved)


def two_bearings(folder: Path, drivers: bool = True) -> sp.Mechanism:
    """A shaft in two bearings on one line: the second one holds nothing."""
    tree = (turning("bearing", "ground", "shaft", axis=(0.6, 0, 0.8))
            + point("journal", "shaft", (0.6, 0, 0.8), rpy_facing((0.6, 0, 0.8)))
            + point("bush", "ground", (0.6, 0, 0.8), rpy_facing((0.6, 0, 0.8))))
    return load(folder, "two_bearings", tilted(tree), driver("shaft", "bearing") * drivers
                + closure("second", "revolute", "bush", "journal") + guess(bearing=1.0))


def rod_in_two_sleeves(folder: Path) -> sp.Mechanism:
    tree = (floating("first", "ground", "rod") + point("end", "rod", (0, 0, 0.3))
            + point("bore", "ground", (0, 0, 0.2)))
    toml = refine("first", "cylindrical") + closure("second", "cylindrical", "bore", "end")
    return load(folder, "rod_in_two_sleeves", tilted(tree), toml)


def plate_between_planes(folder: Path) -> sp.Mechanism:
    tree = (floating("below", "ground", "sheet") + point("top", "sheet", (0, 0, 0.01))
            + point("ceiling", "ground", (0.1, 0.2, 0.01)))
    return load(folder, "plate_between_planes", tilted(tree), refine("below", "planar") + closure(
        "above", "planar", "ceiling", "top"))


def free_body(folder: Path, kind: str) -> sp.Mechanism:
    return load(folder, "free_body", floating("joint", "ground", "body"), refine("joint", kind))


# ---------------------------------------------------------------- platforms

H = np.sqrt(3) / 2  # triangle of side 2: corners and middles of sides in turn
BASE = [(0, 0), (-0.5, H), (0.5, H), (1.5, H), (1, 0), (0.5, -H)]
PLATE = [(0, 0), (0.5, H), (1, 2 * H), (1.5, H), (2, 0), (1, 0)]
POSE = pin.SE3(pin.rpy.rpyToMatrix(0.2, -0.1, 0.3), np.array([0.1, 0.2, 1.4]))
LEGS = [float(np.linalg.norm(POSE.act(np.array([*b, 0.0])) - [*a, 0.0]))
        for a, b in zip(BASE, PLATE, strict=True)]


def griffis_duffy(folder: Path, kind: str) -> sp.Mechanism:
    """Platform with corners of one triangle over middles of the other.

    Legs are distances, rods (S or U below, S above), or telescopes (SP or UP below, S above).
    """
    tree = (sliding("height", "ground", "lift") + sliding("x", "lift", "saddle", axis=(1, 0, 0))
            + sliding("y", "saddle", "socket", axis=(0, 1, 0))
            + floating("tilt", "socket", "platform"))
    toml = refine("tilt", "spherical")
    start = dict(zip("xy", POSE.translation, strict=False)) | {
        "height": POSE.translation[2], "tilt": tuple(pin.log3(POSE.rotation))}
    foot = {"S": refine("{}", "spherical"),
            "U": refine("{}", "universal", axis=(1, 0, 0), axis2=(0, 1, 0))}
    for k, (a, b, length) in enumerate(zip(BASE, PLATE, LEGS, strict=True), 1):
        a, b = (*a, 0), (*b, 0)
        tree += point(f"b{k}", "platform", b)
        if kind == "distance":
            tree += point(f"a{k}", "ground", a)
            toml += closure(f"leg{k}", "distance", f"a{k}", f"b{k}", length=length)
            continue
        tree += floating(f"foot{k}", "ground", f"leg{k}", a)
        toml += foot[kind[0]].replace("{}", f"foot{k}")
        if "P" in kind:
            tree += sliding(f"slide{k}", f"leg{k}", f"rod{k}")
            toml += driver(f"motor{k}", f"slide{k}")
            start[f"slide{k}"] = length
        tree += point(f"tip{k}", *(("rod" + str(k), (0, 0, 0)) if "P" in kind
                                   else (f"leg{k}", (0, 0, length))))
        toml += closure(f"ball{k}", "spherical", f"tip{k}", f"b{k}")
    if "P" not in kind:
        toml += driver("height", "height")
    return load(folder, f"griffis_duffy_{kind}", tree, toml + guess(**start))


# ---------------------------------------------------------------- the tables

LIBRARY = {
    "bennett": Count(-2, -2, 1, 2, 1, 1, 0, True),
    "bricard": Count(0, 0, 1, 4, 1, 1, 0, True),
    "crane": Count(2, 2, 0, 0, 2, 2),
    "crank_collar": SPATIAL,
    "double_cardan": TWICE,
    "elliptic_trammel": PLANE,
    "excavator": Count(-8, 4, 4, 8, 4, 4, 0, True),
    "four_bar": PLANE,
    "geared_five_bar": Count(-2, 1, 1, 3, 1, 1, 0, True),
    "hooke_joint": PLANE,
    "inverted_slider_crank": PLANE,
    "oldham": PLANE,
    "peaucellier": Count(-8, 1, 3, 6, 1, 1, 0, True),
    "rotating_rod_link": Count(2, 2, 0, 0, 2, 2),
    "rspc": SPATIAL,
    "rssr": BALL_ENDED,
    "rssr_crossed": BALL_ENDED,
    "sarrus": Count(0, 0, 1, 4, 1, 1, 0, True),
    "satellite_dish": Count(2, 2, 0, 0, 2, 2),
    "scotch_yoke": PLANE,
    "screw_press": Count(-3, 1, 1, 1, 1, 1, 0, True),
    "slider_crank": PLANE,
    "spherical_four_bar": PLANE,
    "stewart": Count(6, 6, 6, 18, 6, 6),
    "swash_plate": BALL_ENDED,
    "turntable_collar": Count(3, 3, 0, 0, 3, 3),
    "watt_six_bar": TWICE,
}

OF_KNOWN = {  # the mechanisms of the other tests
    **dict.fromkeys((name for name in KNOWN if "slider-crank" in name), PLANE),
    "RSSR, rod as distance": Count(1, 1, 1, 1, 1, 1),
    "arm on a ram": Count(1, 1, 1, 1, 1, 1),
    "RSSP": BALL_ENDED,
    "RSCR": SPATIAL,
    "Hooke's joint as closure": Count(-2, 1, 1, 1, 1, 1, 0, True),
    "Hooke's joint in the tree": Count(-2, 1, 1, 3, 1, 1, 0, True),
    "press, screw in the tree": Count(-3, 1, 1, 2, 1, 1, 0, True),
    "press, screw as closure": Count(-3, 1, 1, 1, 1, 1, 0, True),
    "rack and gears": Count(1, 1, 0, 2, 1, 1),
    "geared five-bar": Count(-2, 1, 1, 3, 1, 1, 0, True),
    "Bennett": Count(-2, -2, 1, 2, 1, 1, 0, True),
    "Bricard": Count(0, 0, 1, 5, 1, 1, 0, True),
    "Sarrus": Count(0, 0, 1, 4, 1, 1, 0, True),
    "swash plate": BALL_ENDED,
    "swash plate, point contact": Count(1, 1, 1, 1, 1, 1),
    "scotch yoke, line": Count(0, 0, 1, 1, 1, 1, 0, True),
    "scotch yoke, plane": Count(1, 1, 1, 1, 1, 1),
    "leaning pointer": Count(1, 1, 1, 1, 1, 1),
    "lamp": Count(2, 2, 1, 2, 2, 2),
    "pendulum": Count(2, 2, 0, 0, 2, 2),
    "five-bar": Count(-1, 2, 1, 2, 2, 2, 0, True),
}

FLAT = Count(-2, 1, 1, 1, 2, 1, 0, True)  # a plane four-bar where two branches meet

CASES = {
    **{f"Bennett cut at hinge {k}": Case(
        lambda f, k=k: hinge_loop(f, BENNETT, k, 2 if k == 1 else 1, BENNETT_ANGLES),
        Count(-2, -2, 1, 2, 1, 1, 0, True)) for k in (1, 2, 3, 4)},
    "Bennett cut in a link": Case(lambda f: hinge_loop(f, BENNETT, 0, 1, BENNETT_ANGLES),
                                  Count(-2, -2, 1, 3, 1, 1, 0, True)),
    "nearly Bennett": Case(lambda f: nearly_bennett(f, 1e-2), Count(-2, -2, 1, 3, 0, 0, 0, True)),
    **{f"Goldberg cut at hinge {k}": Case(
        lambda f, k=k: hinge_loop(f, GOLDBERG, k, 2 if k == 1 else 1),
        Count(-1, -1, 1, 3, 1, 1, 0, True)) for k in range(1, 6)},
    "Goldberg cut in a link": Case(lambda f: hinge_loop(f, GOLDBERG),
                                   Count(-1, -1, 1, 4, 1, 1, 0, True)),
    **{f"Schatz cut at hinge {k}": Case(lambda f, k=k: hinge_loop(f, SCHATZ, k, 2),
                                        Count(0, 0, 1, 4, 1, 1, 0, True)) for k in (1, 3, 6)},
    "Schatz cut in a link": Case(lambda f: hinge_loop(f, SCHATZ),
                                 Count(0, 0, 1, 5, 1, 1, 0, True)),
    "Griffis-Duffy, legs as distances": Case(
        lambda f: griffis_duffy(f, "distance"), Count(0, 0, 6, 5, 1, 1, 0, True)),
    "Griffis-Duffy, S-S legs": Case(
        lambda f: griffis_duffy(f, "SS"), Count(6, 6, 6, 17, 7, 7, 6, True)),
    "Griffis-Duffy, U-S legs": Case(
        lambda f: griffis_duffy(f, "US"), Count(0, 0, 6, 17, 1, 1, 0, True)),
    "Griffis-Duffy, U-P-S legs": Case(
        lambda f: griffis_duffy(f, "UPS"), Count(6, 6, 6, 18, 6, 6)),
    "Griffis-Duffy, S-P-S legs": Case(  # each leg spins as a whole between its balls
        lambda f: griffis_duffy(f, "SPS"), Count(12, 12, 6, 18, 12, 12, 6)),
    "stretched four-bar": Case(lambda f: bare_four_bar(f, 3, 1, 1, 1),
                               Count(-2, 1, 1, 1, 2, 0, 0, True), STRETCHED),
    "stretched four-bar, assembled": Case(lambda f: bare_four_bar(f, 3, 1, 1, 1),
                                          Count(-2, 1, 1, 1, 2, 0, 0, True)),
    "stretched four-bar on a turntable": Case(
        shaky_on_a_turntable, Count(-1, 2, 1, 1, 3, 1, 0, True), STRETCHED | {"table": 0.3}),
    "flat parallelogram": Case(lambda f: bare_four_bar(f, 3, 1, 3, 1), FLAT, {"crank_pin": 0.0}),
    "parallelogram": Case(lambda f: bare_four_bar(f, 3, 1, 3, 1), PLANE,
                          {"crank_pin": 1.0, "rocker_pin": 1.0, "coupler_pin": -1.0}),
    "slider-crank of equal links, folded": Case(
        equal_slider_crank, FLAT, {"crank_pin": np.pi / 2, "rod_pin": np.pi}),
    "slider-crank of equal links, turning as one": Case(
        equal_slider_crank, PLANE, {"crank_pin": 0.7, "rod_pin": np.pi}),
    "slider-crank of equal links, stretched": Case(equal_slider_crank, PLANE, {"slide": 0.2}),
    "double parallelogram": Case(double_parallelogram, Count(-6, 0, 2, 3, 1, 1, 0, True)),
    "plate on concurrent bars": Case(lambda f: plate_on_bars(f, CONCURRENT),
                                     Count(0, 0, 3, 2, 1, 0, 0, True)),
    "plate on parallel bars": Case(lambda f: plate_on_bars(f, PARALLEL, "plate.x"),
                                   Count(0, 0, 3, 2, 1, 1, 0, True)),
    "plate on bars": Case(lambda f: plate_on_bars(f, [(0.4, 0.1), (-0.3, 0.3), (0.1, 0.6)]),
                          Count(0, 0, 3, 3, 0, 0)),
    "four-bar closed by a ball": Case(lambda f: four_bar(f, kind="spherical"),
                                      Count(0, 0, 1, 2, 1, 1, 0, True)),
    "four-bar closed by a ball, tilted": Case(
        lambda f: four_bar(f, kind="spherical", wrap=tilted), Count(0, 0, 1, 2, 1, 1, 0, True)),
    "four-bar, tilted": Case(lambda f: four_bar(f, wrap=tilted), PLANE),
    "four-bar, far away": Case(lambda f: four_bar(f, wrap=far_away), PLANE),
    "four-bar, tiny": Case(lambda f: four_bar(f, 1e-4), PLANE),
    "four-bar, huge": Case(lambda f: four_bar(f, 1e4), PLANE),
    "four-bar without drivers": Case(lambda f: four_bar(f, drivers=False), PLANE),
    "RSSR": Case(rssr, BALL_ENDED),
    "RSSR, spin resolved": Case(lambda f: rssr(f, resolved=True), BALL_ENDED),
    "RSSR without drivers": Case(lambda f: rssr(f, drivers=False), BALL_ENDED),
    "RSSR, tiny": Case(lambda f: rssr(f, 1e-4), BALL_ENDED),
    "RSSR, huge": Case(lambda f: rssr(f, 1e4), BALL_ENDED),
    "R-S-E-R": Case(rser, BALL_ENDED),
    "R-S-E-R, spin resolved": Case(lambda f: rser(f, resolved=True), BALL_ENDED),
    "R-S-C-C": Case(rscc, Count(2, 2, 1, 4, 2, 2, 1)),
    "rod between two fixed balls": Case(fixed_rod, Count(0, 0, 1, 2, 1, 1, 1, True)),
    "rod in two sleeves": Case(rod_in_two_sleeves, Count(-2, 2, 1, 0, 2, 2, 2, True)),
    "plate between planes": Case(plate_between_planes, Count(0, 3, 1, 0, 3, 3, 3, True)),
    "shaft in two bearings": Case(two_bearings, Count(-4, 1, 1, 0, 1, 1, 0, True)),
    "free body": Case(lambda f: free_body(f, "floating"), Count(6, 6, 0, 0, 6, 6)),
    "body on a ball": Case(lambda f: free_body(f, "spherical"), Count(3, 3, 0, 0, 3, 3)),
    **{name: Case(KNOWN[name].build, count) for name, count in OF_KNOWN.items()},
}


def check(mobility: sp.Mobility, expected: Count) -> None:
    """The numbers, and that they fit each other."""
    assert counted(mobility) == expected
    mechanism = mobility.mechanism
    rows = len(sp.closure_jacobian(mechanism, mechanism.neutral))
    assert mobility.instantaneous == mechanism.model.nv - mobility.rank
    assert mobility.kutzbach == mechanism.model.nv - rows
    assert len(mobility.redundant) == rows - mobility.rank
    assert len(mobility.passive) <= mobility.dof <= mobility.instantaneous


@pytest.mark.parametrize("name", CASES)
def test_count(name, tmp_path):
    case = CASES[name]
    mechanism = case.build(tmp_path)
    check(sp.mobility(mechanism, configuration(mechanism, case.at)), case.count)


@pytest.mark.parametrize("name", LIBRARY)
def test_count_of_the_library(name):
    check(sp.mobility(library(name)), LIBRARY[name])


def test_the_other_tests_mechanisms_are_all_counted():
    assert set(OF_KNOWN) == set(KNOWN)


@pytest.mark.parametrize("name", ["four_bar", "rssr", "rspc", "spherical_four_bar", "bricard",
                                  "swash_plate"])
def test_count_is_the_same_all_along_the_motion(name):
    mechanism = library(name)
    value = sp.assemble(mechanism).coordinate(next(iter(mechanism.drivers))).value
    for angle in value + np.linspace(0.1, 0.9, 5):
        state = sp.assemble(mechanism, {next(iter(mechanism.drivers)): angle})
        check(sp.mobility(mechanism, state), LIBRARY[name])


# ---------------------------------------------------------------- linkages that fit at one position


@pytest.mark.parametrize("error", [1e-1, -1e-2, 1e-3, 1e-4, -1e-5, 1e-6])
def test_nearly_bennett_does_not_move_if_its_numbers_are_exact(error, tmp_path):
    nearly_bennett(tmp_path, error)
    mobility = sp.mobility(sp.load(tmp_path / "nearly_bennett.toml", gap=0.0))
    assert mobility.dof == 0 and mobility.overconstrained


@pytest.mark.parametrize("error", [1e-2, 1e-3])
def test_a_double_parallelogram_that_does_not_fit_cannot_be_assembled_or_does_not_move(
    error, tmp_path
):
    mechanism = double_parallelogram(tmp_path, error)
    try:
        assert sp.mobility(mechanism).dof == 0
    except sp.AssemblyError as problem:
        assert problem.worst_closure in ("end2", "end3")


def test_griffis_duffy_platform_moves_with_its_legs_locked(tmp_path):
    mechanism = griffis_duffy(tmp_path, "distance")
    height = sp.assemble(mechanism).coordinate("height").value
    moved = sp.sweep(mechanism, "height", height - np.linspace(0.0, 0.1, 11))
    assert np.max(moved.closure_error) < 1e-12
    for q in moved.q[::5]:
        assert sp.mobility(mechanism, q).rank == 5


def test_a_shaft_in_two_bearings_turns(tmp_path):
    turned = sp.sweep(two_bearings(tmp_path), "shaft", np.linspace(0.0, 6.0, 13), speed=2.0)
    assert np.max(turned.closure_error) < 1e-12
    np.testing.assert_allclose(turned.coordinate("bearing").rate, 2.0, rtol=1e-12)


# ---------------------------------------------------------------- names


def test_rssr_names_the_coupler_and_both_balls(tmp_path):
    mechanism = rssr(tmp_path)
    state = sp.assemble(mechanism, {"crank": 0.4})
    (passive,) = sp.mobility(mechanism, state).passive
    a, b = (state.placement(f).translation for f in ("coupler", "coupler_b"))
    along = (b - a) / np.linalg.norm(b - a)
    assert (passive.link, passive.kind) == ("coupler", "spin")
    assert abs(passive.axis @ along) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(np.cross(passive.point - a, along)) < 1e-12
    assert str(passive) == passive.text
    assert "coupler spins about" in passive.text
    assert "ball_a and ball_b" in passive.text


@pytest.mark.parametrize("build", [swash_plate, rser])
def test_the_slipper_spins_about_the_normal_of_the_plate(build, tmp_path):
    mechanism = build(tmp_path)
    state = sp.assemble(mechanism, {"shaft": 0.4})
    (passive,) = sp.mobility(mechanism, state).passive
    normal = state.placement("face").rotation[:, 2]
    ball = state.placement("slipper").translation
    assert (passive.link, passive.kind) == ("slipper", "spin")
    assert abs(passive.axis @ normal) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(np.cross(passive.point - ball, normal)) < 1e-12
    assert "ball" in passive.text and "contact" in passive.text


def test_a_rod_in_a_sleeve_spins_about_its_line(tmp_path):
    mechanism = rscc(tmp_path)
    state = sp.assemble(mechanism, {"crank": 0.4})
    (passive,) = sp.mobility(mechanism, state).passive
    line = state.placement("bore").rotation[:, 2]
    assert passive.link == "rod"
    assert abs(passive.axis @ line) == pytest.approx(1.0, abs=1e-12)
    assert "ball and sleeve" in passive.text


def test_a_rod_in_two_sleeves_spins_and_slides(tmp_path):
    mechanism = rod_in_two_sleeves(tmp_path)
    passive = sp.mobility(mechanism).passive
    line = sp.assemble(mechanism).placement("bore").rotation[:, 2]
    assert sorted(p.kind for p in passive) == ["slide", "spin"]
    for p in passive:
        assert p.link == "rod" and abs(p.axis @ line) == pytest.approx(1.0, abs=1e-12)


def test_a_plate_between_planes_slides_two_ways_and_spins(tmp_path):
    mechanism = plate_between_planes(tmp_path)
    passive = sp.mobility(mechanism).passive
    normal = sp.assemble(mechanism).placement("ceiling").rotation[:, 2]
    assert sorted(p.kind for p in passive) == ["slide", "slide", "spin"]
    slides = np.array([p.axis for p in passive if p.kind == "slide"])
    assert np.linalg.matrix_rank(slides, 1e-6) == 2
    assert np.max(np.abs(slides @ normal)) < 1e-12


def test_each_leg_between_balls_is_named_once(tmp_path):
    passive = sp.mobility(griffis_duffy(tmp_path, "SS")).passive
    assert sorted(p.link for p in passive) == [f"leg{k}" for k in range(1, 7)]
    for p in passive:
        k = p.link[-1]
        assert f"foot{k} and ball{k}" in p.text


def test_a_passive_freedom_moves_nothing_else(tmp_path):
    mechanism = rssr(tmp_path)
    state = sp.assemble(mechanism, {"crank": 0.4})
    q = state.q.copy()
    at = mechanism.model.idx_qs[mechanism.model.getJointId("ball_a")]
    spin = pin.Quaternion(pin.AngleAxis(0.8, np.array([0.0, 0.0, 1.0])).matrix())  # the rod's z
    q[at : at + 4] = (pin.Quaternion(q[at : at + 4]) * spin).coeffs()
    assert sp.mobility(mechanism, q).dof == 2  # closed: `mobility` would refuse otherwise


@pytest.mark.parametrize("name", ["four_bar", "bennett", "peaucellier", "hooke_joint",
                                  "screw_press"])
def test_redundant_equations_are_named_by_closure_and_index(name):
    mechanism = library(name)
    rows = {c.name: len(c.rows) for c in mechanism.closures}
    redundant = sp.mobility(mechanism).redundant
    assert len(set(redundant)) == len(redundant)
    for text in redundant:
        closed, index = re.fullmatch(r"(\w+)\[(\d+)\]", text).groups()
        assert int(index) < rows[closed]


def test_without_the_redundant_equations_the_rank_is_the_same():
    mechanism = library("four_bar")
    state = sp.assemble(mechanism, {"crank": 0.4})
    mobility = sp.mobility(mechanism, state)
    names = [f"{c.name}[{k}]" for c in mechanism.closures for k in range(len(c.rows))]
    kept = [k for k, name in enumerate(names) if name not in mobility.redundant]
    jacobian = sp.closure_jacobian(mechanism, state.q)[kept]
    assert np.linalg.matrix_rank(jacobian, 1e-9) == mobility.rank == len(kept)


@pytest.mark.parametrize(("name", "kind", "order"), [
    ("four_bar", "planar", 3), ("slider_crank", "planar", 3), ("hooke_joint", "spherical", 3),
    ("spherical_four_bar", "spherical", 3), ("rssr", "spatial", 6), ("bennett", "spatial", 6),
    ("screw_press", "one axis (turn and slide)", 2),
])
def test_loops_are_recognised(name, kind, order):
    (loop,) = sp.mobility(library(name)).loop_list
    assert (loop.kind, loop.order) == (kind, order)


def test_loops_name_their_closure_and_joints(tmp_path):
    first, second = sp.mobility(double_parallelogram(tmp_path)).loop_list
    assert (first.closure, second.closure) == ("end2", "end3")
    assert set(first.joints) == {"pin1", "coupler_pin", "pin2"}
    assert set(second.joints) == {"pin1", "coupler_pin", "pin3"}


# ---------------------------------------------------------------- the report


def lines(mobility: sp.Mobility) -> list[str]:
    return [line.strip() for line in str(mobility).splitlines()]


def test_report_of_the_rssr(tmp_path):
    report = lines(sp.mobility(rssr(tmp_path)))
    assert report[0] == "mobility of rssr: 2"
    assert "links 4, pairs 4, independent loops 1, coordinates 5" in report
    assert "formula with 6 equations a loop (Kutzbach): 2" in report
    assert "loop closed by ball_b: spatial, order 6" in report
    assert "closure rank 3 of 3 equations, instantaneous freedom 2" in report
    assert "finite freedom 2, of which 1 passive and 1 working" in report
    assert any(re.fullmatch(r"passive freedom: coupler spins about \(.*\) through ball_a and "
                            r"ball_b", line) for line in report)
    assert not any(line.startswith(("note", "redundant")) for line in report)


def test_report_of_a_plane_four_bar():
    report = lines(sp.mobility(library("four_bar")))
    assert report[0] == "mobility of four_bar: 1"
    assert "formula with 6 equations a loop (Kutzbach): -2" in report
    assert "formula with the order of each loop (Grübler): 1" in report
    assert any(line.startswith("redundant equations (3): output_pin[") for line in report)
    assert not any(line.startswith("note") for line in report)


def test_report_says_where_the_formula_fails(tmp_path):
    report = str(sp.mobility(bennett(tmp_path)))
    assert "special dimensions give 1 instead of -2" in report


def test_report_says_what_is_instantaneous_only(tmp_path):
    report = lines(sp.mobility(bare_four_bar(tmp_path, 3, 1, 1, 1)))
    assert report[0] == "mobility of bare_four_bar: 0"
    assert any(line.startswith("note: 2 freedom(s) are instantaneous only") for line in report)


def test_report_requires_drivers(tmp_path):
    mechanism = load(tmp_path, "five_bar", tilted(
        turning("left", "ground", "crank1") + turning("right", "ground", "crank2", (0.2, 0, 0))
        + turning("elbow1", "crank1", "rod1", (0.1, 0, 0))
        + turning("elbow2", "crank2", "rod2", (0.1, 0, 0))
        + point("tip1", "rod1", (0.18, 0, 0)) + point("tip2", "rod2", (0.18, 0, 0))),
        driver("left", "left") + closure("tip", "revolute", "tip1", "tip2"))
    assert "1 more driver(s) needed" in str(sp.mobility(mechanism))


def test_telescopic_legs_that_spin_need_no_driver(tmp_path):
    assert "more driver(s)" not in str(sp.mobility(griffis_duffy(tmp_path, "SPS")))


def test_report_of_an_open_tree(tmp_path):
    report = lines(sp.mobility(pendulum(tmp_path)))
    assert report[0] == "mobility of pendulum: 2"
    assert "closure rank 0 of 0 equations, instantaneous freedom 2" in report
    assert not any(line.startswith(("note", "redundant", "passive")) for line in report)


# ---------------------------------------------------------------- arguments


def test_a_state_its_q_and_the_guess_say_the_same(tmp_path):
    mechanism = bennett(tmp_path)
    state = sp.assemble(mechanism)
    texts = {str(sp.mobility(mechanism, q)) for q in (None, state, state.q, state.q)}
    assert len(texts) == 1


def test_a_configuration_that_is_not_closed_is_refused(tmp_path):
    mechanism = bennett(tmp_path)
    q = np.array(sp.assemble(mechanism).q)
    with pytest.raises(sp.SpatialPinError, match=r"closed configuration.*'j4' is open by"):
        sp.mobility(mechanism, q + np.array([0.0, 1e-3, 0.0]))
    with pytest.raises(sp.SpatialPinError):
        sp.mobility(mechanism, np.zeros(3))


def test_a_mechanism_that_cannot_be_closed_is_refused(tmp_path):
    with pytest.raises(sp.AssemblyError):
        sp.mobility(bare_four_bar(tmp_path, 3.0, 0.5, 0.5, 0.5))


@pytest.mark.parametrize("q", [[np.nan, 0.0, 0.0], [np.inf, 0.0, 0.0], [0.0, 0.0]])
def test_bad_numbers_are_refused(q, tmp_path):
    with pytest.raises(ValueError, match="q"):
        sp.mobility(bennett(tmp_path), np.array(q))


def platform_on_distances(folder: Path, legs=(0, 1, 2, 3, 4, 5), wrap=str) -> sp.Mechanism:
    """Griffis and Duffy's platform as one body, its legs as distances."""
    tree, toml = floating("pose", "ground", "platform"), ""
    for k in legs:
        a, b = (*BASE[k], 0.0), (*PLATE[k], 0.0)
        tree += point(f"a{k}", "ground", a) + point(f"b{k}", "platform", b)
        toml += closure(f"leg{k}", "distance", f"a{k}", f"b{k}", length=LEGS[k])
    return load(folder, "platform", wrap(tree), toml + guess(
        pose=(*POSE.translation, *pin.log3(POSE.rotation))))


@pytest.mark.parametrize(("legs", "dof"), [((0, 1, 2, 3, 4, 5), 1), ((0, 1, 2, 3, 4), 1),
                                           ((0, 2, 3, 5), 2)])
def test_a_platform_that_its_legs_carry_along_a_curve_is_no_passive_link(legs, dof, tmp_path):
    """It moves alone, for legs are no links, but about axes that move: that is work, not idling."""
    mobility = sp.mobility(platform_on_distances(tmp_path, legs))
    assert (mobility.dof, mobility.passive) == (dof, ())


def test_a_rod_on_two_distances_from_one_point_idles_about_the_line_of_its_ends(tmp_path):
    """A body that is held at two points only turns about their line for ever."""
    tree = floating("pose", "ground", "rod") + point("a", "ground") + point("b", "rod", (1, 0, 0))
    tree += point("c", "rod", (0.2, 0, 0))
    toml = closure("ball", "spherical", "a", "rod") + closure(
        "held", "point_on_line", "a", "c", axis=(1, 0, 0))
    passive = sp.mobility(load(tmp_path, "rod", tree, toml)).passive
    assert [p.kind for p in passive] == ["spin"]
    assert abs(passive[0].axis[0]) == pytest.approx(1.0)


def test_a_nut_between_two_equal_threads_turns_and_advances(tmp_path):
    """A body in a screw joint and a screw closure of the same lead and axis."""
    tree = floating("thread", "ground", "nut") + point("face", "nut") + point("bolt", "ground")
    toml = refine("thread", "screw", axis=(0, 0, 1), lead=0.2) + closure(
        "second", "screw", "bolt", "face", lead=0.2)
    (passive,) = sp.mobility(load(tmp_path, "nut", tree, toml)).passive
    assert passive.kind == "screw" and "turns and advances" in str(passive)


@pytest.mark.parametrize(("radius", "times"), [(1e-2, 1), (1e-3, 1), (1e-5, 1), (1e-2, 2)])
def test_a_point_on_a_tiny_circle_moves(radius, times, tmp_path):
    """It turns back within less than a long trial motion, said once or twice."""
    tree = sliding("x", "ground", "block", axis=(1, 0, 0)) + sliding("y", "block", "pen")
    tree += point("far", "ground", (0.0, 0.0, 1.0)) + point("start", "ground", (-radius, 0, 0))
    toml = "".join(closure(f"string{k}", "distance", "start", "pen", length=radius)
                   for k in range(times))
    mobility = sp.mobility(load(tmp_path, "pen", tree, toml))
    assert (mobility.instantaneous, mobility.dof) == (1, 1)
