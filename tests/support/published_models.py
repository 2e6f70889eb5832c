"""Mechanisms of the published benchmarks, written as URDF and TOML text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin

from spatial_pin.formats.files import load
from spatial_pin.mechanism.mechanism import Mechanism

Triple = Sequence[float]
ZERO = (0.0, 0.0, 0.0)
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
NO_MASS = ""
ARM = 2.0  # ADAMS: from the joint to the centre of mass [m]
SLENDER, UPRIGHT = (0.04, 0.1, 0.1), (0.1, 0.04, 0.1)  # ADAMS: moments of inertia [kg m²]


def made(name: str, tree: str, toml: str, gravity: Triple) -> Mechanism:
    """Return the mechanism of a tree of joints below link `ground`, and the rest of its file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.toml"
        path.with_suffix(".urdf").write_text(
            f'<robot name="{name}"><link name="ground"/>\n{tree}</robot>\n', encoding="utf-8")
        path.write_text(f'name = "{name}"\ntree = "{name}.urdf"\ngravity = {list(gravity)}\n'
                        f"{toml}", encoding="utf-8")
        return load(path)


def words(values: Triple) -> str:
    """Return numbers in the way of URDF."""
    return " ".join(repr(float(x)) for x in values)


def joint(
    kind: str, name: str, parent: str, child: str, at: Triple = ZERO, *, rpy: Triple = ZERO,
    axis: Triple = AXES["z"], mass: str = NO_MASS,
) -> str:
    """Return a joint and its child link."""
    axis_text = "" if kind in ("fixed", "floating") else f'<axis xyz="{words(axis)}"/>'
    limit = '<limit lower="-1e3" upper="1e3" effort="1" velocity="1"/>'
    return (f'<link name="{child}">{mass}</link>\n<joint name="{name}" type="{kind}">'
            f'<parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{words(at)}" rpy="{words(rpy)}"/>{axis_text}'
            f'{limit if kind == "prismatic" else ""}</joint>\n')


def point(name: str, on: str, at: Triple = ZERO, rpy: Triple = ZERO, mass: str = NO_MASS) -> str:
    """Return a frame on a link."""
    return joint("fixed", f"{name}_mount", on, name, at, rpy=rpy, mass=mass)


def closure(name: str, kind: str, first: str, second: str, keys: str = "") -> str:
    """Return a loop closure."""
    return (f'[[closures]]\nname = "{name}"\ntype = "{kind}"\nframes = ["{first}", "{second}"]\n'
            f"{keys}\n")


def inertial(mass: float, at: Triple, moments: Triple, rotation: pin.SE3 | None = None) -> str:
    """Return mass, centre of mass and principal moments of inertia of a link."""
    turn = np.eye(3) if rotation is None else rotation
    i = turn @ np.diag(moments) @ turn.T
    return (f'<inertial><origin xyz="{words(at)}"/><mass value="{mass!r}"/><inertia '
            f'ixx="{float(i[0, 0])!r}" iyy="{float(i[1, 1])!r}" izz="{float(i[2, 2])!r}" '
            f'ixy="{float(i[0, 1])!r}" ixz="{float(i[0, 2])!r}" iyz="{float(i[1, 2])!r}"/>'
            "</inertial>")


def rod(mass: float, along: Triple, width: float = 0.0) -> str:
    """Return the inertia of a rod of square section from the link's origin to `along`."""
    length = math.hypot(*along)
    z = np.array(along) / length
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    across = mass * (length**2 + width**2) / 12.0
    return inertial(mass, [0.5 * c for c in along], (across, across, mass * width**2 / 6.0),
                    np.column_stack([x, np.cross(z, x), z]))


def simple_pendulum() -> Mechanism:
    """Return IFToMM A01: 1 kg at the end of a massless rod of 1 m."""
    tree = joint("continuous", "pin", "ground", "rod") + point(
        "bob", "rod", (1.0, 0.0, 0.0), mass=inertial(1.0, ZERO, ZERO))
    return made("simple_pendulum", tree, "", (0.0, -9.81, 0.0))


def ladder(n: int) -> Mechanism:
    """Return IFToMM A02: n square windows side by side, all rods 1 m and 1 kg."""
    bar = rod(1.0, AXES["x"])
    tree = "".join(joint("continuous", f"pin_{i}", "ground", f"rod_{i}", (i, 0.0, 0.0),
                         rpy=(0.0, 0.0, math.pi / 2), mass=bar) for i in range(n + 1))
    toml = ""
    for i in range(n):
        tree += joint("continuous", f"knee_{i}", f"rod_{i}", f"coupler_{i}", AXES["x"],
                      rpy=(0.0, 0.0, -math.pi / 2), mass=bar)
        tree += point(f"end_{i}", f"coupler_{i}", AXES["x"])
        tree += point(f"top_{i + 1}", f"rod_{i + 1}", AXES["x"])
        toml += closure(f"corner_{i + 1}", "revolute", f"end_{i}", f"top_{i + 1}")
    return made(f"ladder_{n}", tree, toml, (0.0, -9.81, 0.0))


def bricard() -> Mechanism:
    """Return IFToMM A04: six hinges and five rods along the edges of a cube."""
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)], float)
    edges = np.diff(corners, axis=0)
    tree, parent, at = "", "ground", corners[0]
    for i, (axis, edge) in enumerate(zip("yzxyz", edges, strict=True)):
        tree += joint("continuous", f"hinge_{i}", parent, f"rod_{i}", at, axis=AXES[axis],
                      mass=rod(1.0, edge, 0.1))
        parent, at = f"rod_{i}", edge
    tree += point("p3", "rod_2", edges[2])
    tree += point("last", "rod_4", edges[4]) + point("post", "ground", corners[5])
    return made("bricard_cube", tree, closure("hinge_5", "revolute", "post", "last",
                                              "axis = [1.0, 0.0, 0.0]"), (0.0, -9.81, 0.0))


def governor() -> Mechanism:
    """Return IFToMM A05: a flyball governor with stiff springs; 30° below the horizontal."""
    tree = joint("continuous", "shaft_pin", "ground", "shaft", mass=rod(0.3, AXES["z"], 0.01))
    tree += joint("prismatic", "slide", "shaft", "slider",
                  mass=inertial(3.0, ZERO, (0.005, 0.005, 0.005)))
    toml = ""
    for side, sign in (("right", 1.0), ("left", -1.0)):
        along = (sign, 0.0, 0.0)
        tree += joint("continuous", f"{side}_pin", "shaft", f"{side}_rod", (0.05 * sign, 0.0, 1.0),
                      axis=(0.0, sign, 0.0), mass=rod(0.3, along, 0.01))
        tree += point(f"{side}_ball", f"{side}_rod", along, mass=inertial(5.0, ZERO, ZERO))
        tree += point(f"{side}_middle", f"{side}_rod", (0.5 * sign, 0.0, 0.0))
        tree += point(f"{side}_foot", "slider", (0.05 * sign, 0.0, 0.0))
        toml += (f'[[springs]]\nname = "{side}"\nframes = ["{side}_foot", "{side}_middle"]\n'
                 "stiffness = 8e5\ndamping = 4e4\nfree_length = 0.5\n")
    return made("governor", tree, toml, (0.0, 0.0, -9.81))


def on_a_joint(pair: str, at: Triple, turn: float) -> Mechanism:
    """Return an ADAMS body on a joint at `at` turned by `turn` about x, its arm along its x."""
    rpy = (turn, 0.0, 0.0)
    arm, toml = inertial(1.0, (ARM, 0.0, 0.0), SLENDER), ""
    kind = {"revolute": "continuous", "prismatic": "prismatic"}.get(pair, "floating")
    if kind == "floating":
        toml = f'[joints.pair]\ntype = "{pair}"\n' + ("" if pair == "spherical"
                                                       else "axis = [0.0, 0.0, 1.0]\n")
    tree = joint(kind, "pair", "ground", "body", at, rpy=rpy, mass=arm) + point(
        "com", "body", (ARM, 0.0, 0.0))
    return made(f"{pair}_pendulum", tree, toml, (0.0, 0.0, -9.80665))


def on_a_string(length: float = ARM) -> Mechanism:
    """Return the ADAMS body that keeps its distance from the world's origin."""
    tree = joint("floating", "free", "ground", "com", (0.0, length, 0.0),
                 mass=inertial(1.0, ZERO, SLENDER))
    return made("distance_pendulum", tree, closure("pair", "distance", "ground", "com",
                                                   f"length = {length}"), (0.0, 0.0, -9.80665))


def on_a_link() -> Mechanism:
    """Return the ADAMS body hung by a ball from a massless link that turns about the vertical."""
    tree = joint("continuous", "pin", "ground", "link")
    tree += point("tip", "link", (ARM, 0.0, 0.0))
    tree += joint("floating", "free", "ground", "com", (ARM, ARM, 0.0),
                  mass=inertial(1.0, ZERO, UPRIGHT))
    tree += point("socket", "com", (0.0, -ARM, 0.0))
    return made("revolute_spherical_pendulum", tree, closure("pair", "spherical", "tip", "socket"),
                (0.0, 0.0, -9.80665))
