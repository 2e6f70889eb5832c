"""Dietmaier's platform with forty real poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
from mechanisms import closure, floating, load, point

import spatial_pin as sp

DIETMAIER_BASE = [(0, 0, 0), (1.107915, 0, 0), (0.549094, 0.756063, 0),
                  (0.735077, -0.223935, 0.525991), (0.514188, -0.526063, -0.368418),
                  (0.590473, 0.094733, -0.205018)]
DIETMAIER_PLATFORM = [(0, 0, 0), (0.542805, 0, 0), (0.956919, -0.528915, 0),
                      (0.665885, -0.353482, 1.402538), (0.478359, 1.158742, 0.107672),
                      (-0.137087, -0.235121, 0.353913)]
DIETMAIER_LEGS = [1.0, 0.645275, 1.086284, 1.503439, 1.281933, 0.771071]


def dietmaier(folder: Path) -> sp.Mechanism:
    tree, toml = floating("pose", "ground", "platform"), ""
    legs = zip(DIETMAIER_BASE, DIETMAIER_PLATFORM, DIETMAIER_LEGS, strict=True)
    for k, (a, b, length) in enumerate(legs, 1):
        tree += point(f"a{k}", "ground", a) + point(f"b{k}", "platform", b)
        toml += closure(f"leg{k}", "distance", f"a{k}", f"b{k}", length=length)
    return load(folder, "dietmaier", tree, toml)


def assert_distinct(placements: list[pin.SE3], apart: float) -> None:
    flat = np.array([M.homogeneous[:3].ravel() for M in placements])
    gaps = np.abs(flat[:, None] - flat[None]).max(axis=2)
    assert np.min(gaps + 10.0 * np.eye(len(flat))) > apart
