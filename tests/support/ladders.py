"""Ladders of four-bars and falling bodies: loops whose forces are known."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pinocchio as pin
from masses import heavy, with_masses

import spatial_pin as sp

G = 9.81


def moving(mech: sp.Mechanism, at=None, speed=0.7, acceleration=0.4) -> sp.State:
    """Assembled at `at`, all drivers moving."""
    state = sp.assemble(mech, at or {})
    return sp.solve_rates(mech, state, dict.fromkeys(mech.drivers, speed),
                          dict.fromkeys(mech.drivers, acceleration))


DOWN = "gravity = [0.0, -9.81, 0.0]\n"
Z_DOWN = "gravity = [0.0, 0.0, -9.81]\n"
LENGTHS = (0.30, 0.10, 0.28, 0.24)
BARS = {"crank": (0.3, 0.05, 4e-4), "coupler": (0.7, 0.13, 5e-3), "rocker": (0.5, 0.11, 3e-3)}


def heavy_four_bar(folder, toml=""):
    return with_masses(known.bare_four_bar(folder, *LENGTHS), folder, DOWN + toml, **{
        name: (m, (c, 0, 0), (i, i, i)) for name, (m, c, i) in BARS.items()})


def ladder(folder, n):
    """Square windows side by side [IFToMM A02]: n + 1 upright rods, n couplers, 1 m, 1 kg."""
    rod = (1.0, (0.5, 0, 0), (1e-3, 1 / 12, 1 / 12))
    tree, toml = "", DOWN
    for k in range(n + 1):
        tree += heavy(known.turning(f"p{k}", "ground", f"r{k}", (k, 0, 0), rpy=(0, 0, np.pi / 2)),
                      **{f"r{k}": rod})
        tree += known.point(f"t{k}", f"r{k}", (1, 0, 0))
    for k in range(n):
        tree += heavy(known.turning(f"k{k}", f"r{k}", f"c{k}", (1, 0, 0), rpy=(0, 0, -np.pi / 2)),
                      **{f"c{k}": rod})
        tree += known.point(f"e{k}", f"c{k}", (1, 0, 0))
        toml += known.closure(f"c{k}", "revolute", f"e{k}", f"t{k + 1}")
    return known.load(folder, f"ladder{n}", tree, toml)


def leaning(mech, angle, rate):
    """Uprights turned by -angle from the vertical, couplers level."""
    sense = np.array([-1.0 if name.startswith("p") else 1.0 for name in mech.coordinates])
    return sp.State(mech, sense * angle, sense * rate, closure_error=0.0), sense


def hanging(folder, angle, seed=0):
    """A pendulum about any axis on a tilted base, that hangs at rest at an angle of its joint."""
    rng = np.random.default_rng(seed)
    rpy, axis, com = rng.uniform(-1.2, 1.2, 3), rng.normal(size=3), rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    down = pin.rpy.rpyToMatrix(*rpy).T @ np.array([0.0, 0.0, -1.0])
    lever, across = com - (com @ axis) * axis, np.cross(axis, com)
    rest = np.arctan2(down @ across, down @ lever)
    com = pin.AngleAxis(rest - angle, axis).toRotationMatrix() @ com
    tree = heavy(known.turning("pin", "ground", "rod", rpy=tuple(rpy), axis=tuple(axis)),
                 rod=(1.3, tuple(com), (0.1, 0.08, 0.12)))
    return known.load(folder, "hanging", tree, Z_DOWN), {"pin": float(angle)}


def uniform(mass, length):
    return mass, (0.5 * length, 0, 0), (0.0, mass * length**2 / 12, mass * length**2 / 12)


def two_rods(folder, end):
    """Two rods of 1 kg and 1 m, and a mass at the end."""
    tree = heavy(
        known.turning("p", "ground", "upper") + known.turning("k", "upper", "lower", (1, 0, 0))
        + known.point("load", "lower", (1, 0, 0)),
        upper=uniform(1.0, 1.0), lower=uniform(1.0, 1.0), load=(end,))
    return known.load(folder, "two_rods", tree, "gravity = [0.0, -9.81, 0.0]\n")
