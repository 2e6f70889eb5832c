"""Mechanisms at the edges: without joints, drivers or closures, and structures that cannot move."""

from __future__ import annotations

from pathlib import Path

import mechanisms as known
import numpy as np
from masses import heavy

import spatial_pin as sp

BAR = (0.5, (0.1, 0, 0), (1e-4, 1e-3, 1e-3))
DOWN = "gravity = [0.0, -9.81, 0.0]\n"

# ---------------------------------------------------------------- nothing to solve for


def nothing(folder: Path) -> sp.Mechanism:
    """The fixed link alone."""
    return known.load(folder, "nothing", "", "")


def only_frames(folder: Path) -> sp.Mechanism:
    return known.load(folder, "only_frames", known.point("tip", "ground", (0.1, 0.2, 0.3)), "")


def welded(folder: Path) -> sp.Mechanism:
    """Links with mass, all joints fixed."""
    tree = heavy(known.point("arm", "ground", (0.3, 0, 0)) + known.point("end", "arm", (0, 0.4, 0))
                 + known.point("post", "ground", (0.3, 0.4, 0)), arm=BAR, end=BAR)
    return known.load(folder, "welded", tree, DOWN)


def free_arm(folder: Path) -> sp.Mechanism:
    """One joint, no driver, no closure."""
    return known.load(folder, "free_arm", heavy(known.turning("pin", "ground", "arm"), arm=BAR),
                      DOWN)


def driven_arm(folder: Path) -> sp.Mechanism:
    return known.load(folder, "driven_arm", heavy(known.turning("pin", "ground", "arm"), arm=BAR),
                      DOWN + known.driver("pin", "pin"))


def undriven_four_bar(folder: Path) -> sp.Mechanism:
    mechanism = known.bare_four_bar(folder, 1.0, 0.3, 0.9, 0.8)
    path = folder / f"{mechanism.name}.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(known.driver("crank", "crank_pin"), ""), encoding="utf-8")
    return sp.load(path)


# ---------------------------------------------------------------- structures


def flat_truss(folder: Path, wrap=str, size=1.0, cut="middle") -> sp.Mechanism:
    """Two bars in a line between two supports: they can be shaken, but not moved."""
    bars = heavy(known.turning("a", "ground", "bar_a"), bar_a=BAR)
    ends = known.point("tip_a", "bar_a", (size, 0, 0))
    if cut == "middle":
        bars += heavy(known.turning("b", "ground", "bar_b", (2.5 * size, 0, 0)), bar_b=BAR)
        ends += known.point("tip_b", "bar_b", (-1.5 * size, 0, 0))
    else:
        bars += heavy(known.turning("b", "bar_a", "bar_b", (size, 0, 0)), bar_b=BAR)
        ends += known.point("tip_b", "bar_b", (1.5 * size, 0, 0))
        ends += known.point("tip_c", "ground", (2.5 * size, 0, 0))
    first, second = ("tip_a", "tip_b") if cut == "middle" else ("tip_b", "tip_c")
    return known.load(folder, "flat_truss", wrap(bars + ends), DOWN + known.driver("a", "a")
                      + known.closure("pin", "revolute", first, second))


def flat_tripod(folder: Path, wrap=str) -> sp.Mechanism:
    """A point held by three rods in one plane: it can be shaken out of it."""
    tree = (known.sliding("x", "ground", "first", axis=(1, 0, 0))
            + known.sliding("y", "first", "second", axis=(0, 1, 0))
            + heavy(known.sliding("z", "second", "node"), node=BAR))
    toml = known.driver("z", "z")
    for k, (angle, length) in enumerate(((0.2, 0.5), (2.0, 0.8), (4.1, 0.7))):
        tree += known.point(f"foot_{k}", "ground", (length * np.cos(angle),
                                                    length * np.sin(angle), 0))
        toml += known.closure(f"rod_{k}", "distance", f"foot_{k}", "node", length=length)
    return known.load(folder, "flat_tripod", wrap(tree), toml)


def stretched_four_bar(folder: Path, wrap=str) -> sp.Mechanism:
    """The ground link as long as the three others together: locked in a line."""
    tree = heavy(known.turning("a", "ground", "crank")
                 + known.turning("b", "crank", "coupler", (0.3, 0, 0))
                 + known.turning("c", "ground", "rocker", (1.2, 0, 0)),
                 crank=BAR, coupler=BAR, rocker=BAR)
    tree += known.point("end", "coupler", (0.5, 0, 0)) + known.point("top", "rocker", (-0.4, 0, 0))
    return known.load(folder, "stretched_four_bar", wrap(tree), DOWN + known.driver("crank", "a")
                      + known.closure("pin", "revolute", "end", "top"))


def parallel_rods(folder: Path, lengths=(0.6, 0.4, 0.8), kind="revolute") -> sp.Mechanism:
    """A plate on three parallel rods of different lengths: they would have to turn alike."""
    feet, along = np.array([(0, 0, 0), (1.0, 0, 0), (0.4, 0.7, 0)]), np.array([0.8, 0.6, 0])
    tips = feet + np.outer(lengths, along)
    angle = float(np.arctan2(along[1], along[0]))
    tree = known.turning("a", "ground", "rod_a") + known.turning(
        "top", "rod_a", "plate", (lengths[0], 0, 0))
    toml = known.driver("a", "a")
    for name, foot, tip, length in zip("bc", feet[1:], tips[1:], lengths[1:], strict=True):
        tree += known.turning(name, "ground", f"rod_{name}", foot)
        tree += known.point(f"end_{name}", f"rod_{name}", (length, 0, 0))
        tree += known.point(f"pin_{name}", "plate", tip - tips[0])
        toml += known.closure(f"pin_{name}", kind, f"end_{name}", f"pin_{name}")
    return known.load(folder, "parallel_rods", tree, toml + known.guess(
        a=angle, top=-angle, b=angle, c=angle))


def carried_truss(folder: Path) -> sp.Mechanism:
    """A flat truss that a crank turns as a whole: shaky in every configuration."""
    tree = (known.turning("crank", "ground", "base") + known.turning("a", "base", "bar_a")
            + known.turning("b", "base", "bar_b", (2.5, 0, 0))
            + known.point("tip_a", "bar_a", (1, 0, 0))
            + known.point("tip_b", "bar_b", (-1.5, 0, 0)))
    return known.load(folder, "carried_truss", tree, known.driver("crank", "crank")
                      + known.closure("pin", "revolute", "tip_a", "tip_b"))


def tensegrity(folder: Path, wrap=str, radius=0.4, height=0.7) -> sp.Mechanism:
    """A prism of three struts and three cables at the twist at which it is shaky [Connelly].

    On its top an arm turns freely, which is a motion.
    """
    bottom = [(np.cos(a), np.sin(a), 0) for a in 2 * np.pi / 3 * np.arange(3)]
    top = [(radius * np.cos(a + np.pi / 2), radius * np.sin(a + np.pi / 2), height)
           for a in 2 * np.pi / 3 * np.arange(3)]
    tree = heavy(known.floating("free", "ground", "plate"), plate=BAR)
    tree += heavy(known.turning("arm_pin", "plate", "arm", (0, 0, height)), arm=BAR)
    toml = known.driver("arm", "arm_pin")
    for k in range(3):
        tree += known.point(f"foot_{k}", "ground", bottom[k]) + known.point(f"top_{k}", "plate",
                                                                            top[k])
    for k in range(3):
        for kind, other in (("cable", (k + 2) % 3), ("strut", (k + 1) % 3)):
            length = float(np.linalg.norm(np.subtract(top[k], bottom[other])))
            toml += known.closure(f"{kind}_{k}", "distance", f"foot_{other}", f"top_{k}",
                                  length=length)
    return known.load(folder, "tensegrity", wrap(tree), toml)


def plate_on_legs(folder: Path, wrap=str, size=1.0) -> sp.Mechanism:
    """A plate on three equal parallel legs, a hinge above and a ball below: it shakes far.

    With one leg held at an angle d, the least residual of the loops [lengths of a leg] is 9.4e-8
    at 0.05 rad, 2.4e-5 at 0.2: 0.015 d^4, by least squares on the plate's own equations.
    """
    tree = heavy(known.floating("pose", "ground", "plate"), plate=BAR)
    toml = known.driver("leg", "hinge_0")
    for k in range(3):
        corner = size * np.array([np.cos(2 * k), np.sin(2 * k), 0.0])
        tree += heavy(known.turning(f"hinge_{k}", "plate", f"leg_{k}", corner,
                                    (np.cos(k), np.sin(k), 0)), **{f"leg_{k}": BAR})
        tree += known.point(f"end_{k}", f"leg_{k}", (0, 0, -size))
        tree += known.point(f"foot_{k}", "ground", corner)
        toml += known.closure(f"ball_{k}", "spherical", f"end_{k}", f"foot_{k}")
    return known.load(folder, "plate_on_legs", wrap(tree),
                      toml + known.guess(pose=(0, 0, size, 0, 0, 0)))


def dead_centres(folder: Path, count: int, size=1.0, times=1, carried=False,
                 is_locked=True) -> sp.Mechanism:
    """Slides in a row, a bar from each to the next at its dead centre, the last one to a wall.

    Where the first slide moves by d, each next one does by half the square of what the one before
    does: bar k opens by half the power 2^k of d, and less. Without the last bar they all move.
    """
    root = "carriage" if carried else "ground"
    tree = known.turning("table", "ground", "carriage") if carried else ""
    toml, at, names = "", np.zeros(3), [*(f"block_{k}" for k in range(count)), "wall"]
    for k in range(count):
        tree += known.sliding(f"slide_{k}", root, names[k], at, axis=np.eye(3)[k % 2])
        at = at + size * np.eye(3)[1 - k % 2]
    tree += known.point("wall", root, at)
    for k in range(count if is_locked else count - 1):
        for bar in range(times):
            toml += known.closure(f"bar_{k}_{bar}", "distance", names[k], names[k + 1],
                                  length=size)
    return known.load(folder, "dead_centres", tree, toml)


def watt_pair(folder: Path, first: tuple, second: tuple) -> sp.Mechanism:
    """Two of Watt's linkages in their middle position, a bar between the points that they guide.

    Args:
        folder: where its files are written.
        first: arms, half the length of the coupler, and where on it the guided point is.
        second: likewise.
    """
    tree = toml = ""
    for name, x, (arm, other, half, part) in (("a", 0.0, first), ("b", 2.0, second)):
        top, middle = (0, -2 * half, 0), (0, -2 * half * part, 0)
        tree += known.turning(f"{name}1", "ground", f"{name}_arm", (x - arm, 2 * half * part, 0))
        tree += known.turning(f"{name}2", f"{name}_arm", f"{name}_coupler", (arm, 0, 0))
        tree += known.turning(f"{name}3", "ground", f"{name}_rocker",
                              (x + other, -2 * half * (1 - part), 0))
        tree += known.point(f"{name}_end", f"{name}_coupler", top)
        tree += known.point(f"{name}_guided", f"{name}_coupler", middle)
        tree += known.point(f"{name}_tip", f"{name}_rocker", (-other, 0, 0))
        toml += known.closure(f"{name}4", "revolute", f"{name}_end", f"{name}_tip")
    return known.load(folder, "watt_pair", tree, toml + known.closure(
        "bar", "distance", "a_guided", "b_guided", length=2.0))


EMPTY = {f.__name__: f for f in (nothing, only_frames, welded)}
FREE = {f.__name__: f for f in (free_arm, driven_arm, undriven_four_bar)}
STRUCTURES = {
    "flat truss": flat_truss,
    "flat truss, tilted": lambda folder: flat_truss(folder, known.tilted),
    "flat truss, cut at its end": lambda folder: flat_truss(folder, cut="end"),
    "a tiny flat truss": lambda folder: flat_truss(folder, size=1e-4),
    "a huge flat truss": lambda folder: flat_truss(folder, size=1e4),
    "flat tripod": flat_tripod,
    "flat tripod, tilted": lambda folder: flat_tripod(folder, known.tilted),
    "stretched four-bar": stretched_four_bar,
    "stretched four-bar, tilted": lambda folder: stretched_four_bar(folder, known.tilted),
    "tensegrity": tensegrity,
    "parallel rods": parallel_rods,
    "parallel rods, nearly alike": lambda folder: parallel_rods(folder, (0.6, 0.6, 0.605)),
    "parallel rods with balls": lambda folder: parallel_rods(folder, kind="spherical"),
    "a truss that is carried": carried_truss,
    "plate on equal legs": plate_on_legs,
    "plate on equal legs, tilted": lambda folder: plate_on_legs(folder, known.tilted),
}
