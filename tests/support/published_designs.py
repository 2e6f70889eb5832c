"""Published problems of dimensional synthesis, as `sp.design` is asked for them.

Points, bounds and published dimensions stand in `tests/data/synthesis`, with their sources; the
tutorial problems are those of pylinkage's documentation.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import spatial_pin as sp

DATA = Path(__file__).parents[1] / "data" / "synthesis"
PATHS = tomllib.loads((DATA / "cases.toml").read_text(encoding="utf-8"))
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Problem:
    """A problem of synthesis.

    Attributes:
        title: what is asked, in words.
        family: file of the mechanism.
        goals: makes the goals.
        dimensions: bounds of what is free.
        fixed: dimensions that the family is loaded with: what is given, and where to begin.
        squared: whether its error is told as a sum of squared distances, as in the literature;
            else as the root of their mean.
        published: the error of the best published dimensions, as computed from them; None: unknown.
        keywords: for `sp.design`.
        measure: the error of a design, where it is not that of one goal.
    """

    title: str
    family: str
    goals: Callable[[], list[Any]]
    dimensions: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, float] = field(default_factory=dict)
    squared: bool = False
    published: float | None = None
    keywords: Mapping[str, Any] = field(default_factory=dict)
    measure: Callable[[Any], float] | None = None

    def mechanism(self) -> sp.Mechanism:
        """Return the family, with what is given."""
        return sp.load(DATA / f"{self.family}.toml", **self.fixed)

    def solve(self, **keywords: Any) -> Any:
        """Return what `sp.design` finds."""
        return sp.design(self.mechanism(), self.goals(), dict(self.dimensions),
                         **{**self.keywords, **keywords})

    def error(self, design: Any) -> float:
        """Return the error of a design [unit² of a path; else rad, or the larger of unit and rad].

        Sum of squared distances, or the root of the mean square over the samples, if the problem
        has no measure of its own.
        """
        if self.measure is not None:
            return self.measure(design)
        (found,) = design.errors.values()
        return float(found.samples * found.rms**2 if self.squared else found.rms)


# ---------------------------------------------------------------- paths

ANYWHERE = ("x0", "y0", "cx", "cy")
LINKS = ("r1", "r2", "r3", "r4")


def four_bar(lengths: tuple[float, float], offsets: tuple[float, float],
             turned: bool = True) -> dict[str, tuple[float, float]]:
    """Return bounds of a four-bar that may stand anywhere."""
    found = {name: lengths for name in LINKS} | {name: offsets for name in ANYWHERE}
    return {**found, "theta0": (0.0, TURN)} if turned else found


def path(name: str, bounds: Mapping[str, tuple[float, float]], driver: Any = None,
         fixed: Mapping[str, float] | None = None, weight: float | None = 1.0,
         closed: bool = False, **keywords: Any) -> Problem:
    """Return the problem of a path of `cases.toml`, to be met exactly where it can be."""
    case = PATHS[name]
    asked = {"input_offset": True} if "step" in case else {}

    def goals() -> list[Any]:
        return [sp.goals.path("tracer", np.array(case["points"], dtype=float), driver,
                              weight=weight, closed=closed, **asked)]

    return Problem(case["title"], "four_bar_path", goals, bounds, fixed or {}, squared=True,
                   published=case.get("error", 0.0 if "real" in case or name == "nine" else None),
                   keywords=keywords)


def through_drawn(count: int, seed: int, timed: bool = False) -> Problem:
    """Return the problem of a four-bar through points of one that is drawn, which it may not know.

    Lengths of that are 0.5 to 2, its tracer within 2 of the crank's tip, its crank angles 0.2 rad
    apart at least. Where they are given, the crank may count from anywhere: then five points ask
    for as many numbers as there are. Through free ones a four-bar has as many at nine.
    """
    rng = np.random.default_rng(seed)
    while True:
        r1, r2, r3, r4 = rng.uniform(0.5, 2.0, 4)
        tracer, base = rng.uniform(-2.0, 2.0, 2) @ [1, 1j], rng.uniform(-1.0, 1.0, 2) @ [1, 1j]
        angles, side = np.sort(rng.uniform(0.0, TURN, count)), rng.choice([-1.0, 1.0])
        rest = r1 - r2 * np.exp(1j * angles)
        inner = (r3**2 + abs(rest) ** 2 - r4**2) / (2.0 * r3 * abs(rest))
        if abs(inner).max() < 1.0 and np.diff(angles).min() > 0.2:
            break
    coupler = np.angle(rest) + side * np.arccos(inner)
    drawn = base + np.exp(1j * rng.uniform(0.0, TURN)) * (
        r2 * np.exp(1j * angles) + tracer * np.exp(1j * coupler))
    goal = sp.goals.path("tracer", np.column_stack([drawn.real, drawn.imag]),
                         {"crank": angles} if timed else None, input_offset=timed, weight=None)
    return Problem(f"{count} {'timed ' if timed else ''}points of a drawn four-bar",
                   "four_bar_path", lambda: [goal], four_bar((0.05, 5.0), (-5.0, 5.0)),
                   squared=True, published=0.0)


def within(centre: float, reach: float) -> tuple[float, float]:
    return centre - reach, centre + reach


# ---------------------------------------------------------------- functions


def logarithm(start: float, swing: float, to: float, by: float) -> tuple[Any, Any]:
    """Return three pairs of angles that generate y = log2 x, 1 <= x <= 2, from degrees."""
    x = 1.5 - 0.5 * np.cos(np.pi * np.array([1, 3, 5]) / 6)
    return np.radians(start + swing * (x - 1)), np.radians(to + by * np.log2(x))


def function(title: str, family: str, output: str, pairs: tuple[Any, Any], names: str | tuple,
             fixed: Mapping[str, float], weight: float | None = None,
             published: float | None = 0.0) -> Problem:
    """Return the problem of a function generator whose unit of length is the ground."""
    phi, psi = pairs

    def goals() -> list[Any]:
        return [sp.goals.function(output, psi, {"crank": phi}, weight=weight)]

    return Problem(title, family, goals, {name: (0.05, 5.0) for name in names}, fixed,
                   published=published)


QUADRANT = np.radians([0.5, 90.0])  # ends of the rocker's stroke: from 0 on it would fold flat


def quadrant() -> list[Any]:
    """Return the goals of a rocker that goes to and fro over a quarter of a circle of radius 2.

    At the ends of its stroke the crank and the coupler are in line.
    """
    at = {"rocker_pin": QUADRANT}
    ends = np.column_stack([3.0 + 2.0 * np.cos(QUADRANT), 2.0 * np.sin(QUADRANT)])
    return [sp.goals.path("rocker_end", ends, at, weight=None),
            sp.goals.function("coupler_pin", [0.0, np.pi], at, weight=None)]


def box_missed(design: Any) -> float:
    """Return the tutorial's measure: by how much the box about the whole curve is another."""
    r1, r2, r3, r4 = (design.mechanism.dimensions[name] for name in LINKS)
    ends = [np.pi - np.arccos((r1**2 + r4**2 - r**2) / (2 * r1 * r4)) for r in (r3 - r2, r3 + r2)]
    angles = np.linspace(*ends, 10001)
    x, y = r1 + r4 * np.cos(angles), r4 * np.sin(angles)
    return float(y.min()**2 + (x.max() - 5)**2 + (y.max() - 2)**2 + (x.min() - 3)**2)


TUTORIAL_PAIRS = tuple(np.radians([[30, 75, 135], [75, 90, 135]]))
TUTORIAL_FIVE = tuple(np.radians([[30, 60, 75, 110, 135], [75, 85, 90, 118, 135]]))
TUTORIAL_POINTS = ((0.0, 1.0), (1.0, 2.0), (2.0, 1.5), (3.0, 0.5))


# ---------------------------------------------------------------- poses


def plane_pose(x: float, y: float, angle: float) -> np.ndarray:
    """Return the placement (4, 4) of a body in the plane."""
    found = np.eye(4)
    found[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    found[:2, 3] = x, y
    return found


def guided(count: int) -> list[np.ndarray]:
    """Return poses of the coupler of a known four-bar.

    Its centre points are (0, 0) and (2, -0.3), its circle points (0, 0) and (2.6, -0.4), its cranks
    1 and 3.4 long. Two other dyads guide the body through all five poses.
    """
    found, pin = [], 2.6 - 0.4j
    for crank in (0.2, 0.8, 1.4, 2.8, 3.7)[:count]:
        tip = np.exp(1j * crank)
        rest = 2 - 0.3j - tip
        inner = np.arccos((abs(pin)**2 + abs(rest)**2 - 3.4**2) / (2 * abs(pin) * abs(rest)))
        found.append(plane_pose(tip.real, tip.imag, np.angle(rest) + inner - np.angle(pin)))
    return found


def bennett_poses() -> list[np.ndarray]:
    """Return three poses of the body of the Bennett loop in the file, at its own dimensions."""
    k = np.sin((1.2 + 0.7) / 2) / np.sin((1.2 - 0.7) / 2)
    found = []
    for crank in (0.6, 1.3, 2.0):
        coupler = 2 * np.arctan2(k * np.cos(crank / 2), np.sin(crank / 2))
        found.append(screwed(crank, 0.3, 0.7) @ screwed(coupler, 0.0, 0.0))
    return found


def screwed(angle: float, length: float, twist: float) -> np.ndarray:
    """Return a turn about z, then a shift along x and a turn about it."""
    c, s, ct, st = np.cos(angle), np.sin(angle), np.cos(twist), np.sin(twist)
    return np.array([[c, -s * ct, s * st, length * c], [s, c * ct, -c * st, length * s],
                     [0, st, ct, 0], [0, 0, 0, 1]])


def poses(title: str, family: str, placements: list[np.ndarray],
          bounds: Mapping[str, tuple[float, float]],
          fixed: Mapping[str, float] | None = None, **keywords: Any) -> Problem:
    """Return the problem of a body that is guided exactly."""
    return Problem(title, family, lambda: [sp.goals.poses("body", placements, weight=None)], bounds,
                   fixed or {}, published=0.0, keywords=keywords)


PLANE_BODY = {name: (-5.0, 5.0) for name in ("gx", "gy", "hx", "hy", "ux", "uy", "vx", "vy")}
PLANE_BODY |= {"r2": (0.1, 8.0), "r4": (0.1, 8.0)}
BENNETT = {"a": (0.1, 0.6), "alpha": (0.3, 1.5), "beta": (0.3, 1.5)}
BENNETT |= {name: (-0.5, 0.5) for name in ("x", "y", "z", "px", "py", "pz")}
BENNETT |= {name: (-1.0, 1.0) for name in ("roll", "pitch", "yaw", "pr", "pp", "pw")}

DEGREES = np.radians(PATHS["five_timed"]["degrees"])
STEPS = np.radians(20.0 * np.arange(18))

PROBLEMS = {
    "freudenstein": function(
        "Freudenstein: plane four-bar, y = log2 x at three points", "four_bar_path", "rocker_pin",
        logarithm(90, 90, 75, 60), ("r2", "r3", "r4"), {"r1": 1.0}),
    "spatial_freudenstein": function(
        "RSSR with axes at 60°, y = log2 x at three points", "rssr_function", "follower_pin",
        logarithm(60, 90, 75, 60), ("a", "b", "c"), {"alpha": np.pi / 3, "d": 1.0}),
    "burmester_four": poses("Burmester: four poses in the plane", "four_bar_poses", guided(4),
                            PLANE_BODY),
    "burmester_five": poses("Burmester: five poses in the plane", "four_bar_poses", guided(5),
                            PLANE_BODY, starts=60, most=20),
    "bennett": poses("Bennett: three poses in space", "bennett_poses", bennett_poses(), BENNETT,
                     fixed={"a": 0.2, "alpha": 1.0, "beta": 0.8, "x": 0.1, "yaw": 0.3, "pz": 0.1}),
    "line_of_six": path("line_of_six", four_bar((0.5, 60.0), (-60.0, 60.0)),
                        weight=None),
    "five_timed": path(
        "five_timed", {name: (0.1, 50.0) for name in LINKS} | {"cx": (-50.0, 50.0),
                                                              "cy": (-50.0, 50.0)},
        {"crank": DEGREES}),
    "closed_of_eighteen": path("closed_of_eighteen", four_bar((0.05, 2.0), (-2.0, 2.0)),
                               {"crank": STEPS}),
    "twelve": path("twelve", four_bar((0.1, 6.0), (-6.0, 6.0)), closed=True, method="atlas"),
    "figure_eight": path("figure_eight", four_bar((5.0, 100.0), (-100.0, 100.0)), closed=True,
                         method="atlas"),
    "line_of_five": path(
        "line_of_five", {name: (0.05, 20.0) for name in ("r2", "r3", "r4")}
        | {"cx": (-20.0, 20.0), "cy": (-20.0, 20.0)}, fixed={"r1": 1.0},
        weight=None, starts=100, most=30),
    "nine": path("nine", four_bar((0.05, 5.0), (-5.0, 5.0)), weight=None, starts=60),
    "tutorial_function": function(
        "pylinkage 06: function at three pairs", "four_bar_path", "rocker_pin", TUTORIAL_PAIRS,
        ("r2", "r3", "r4"), {"r1": 1.0}),
    "tutorial_function_of_five": function(
        "pylinkage 06: function at five pairs", "four_bar_path", "rocker_pin", TUTORIAL_FIVE,
        ("r2", "r3", "r4"), {"r1": 1.0}, weight=1.0, published=None),
    "tutorial_path": Problem(
        "pylinkage synthesis: path through four points", "four_bar_path",
        lambda: [sp.goals.path("tracer", np.array(TUTORIAL_POINTS))],
        four_bar((0.1, 10.0), (-10.0, 10.0)), squared=True),
    "tutorial_quadrant": Problem(
        "pylinkage complete example: quarter of a circle", "four_bar_path", quadrant,
        {"r2": (0.2, 5.0), "r3": (0.6, 15.0), "r4": (0.2, 5.0)},
        {"r1": 3.0, "r2": 1.0, "r3": 3.0, "r4": 1.0}, measure=box_missed),
}
