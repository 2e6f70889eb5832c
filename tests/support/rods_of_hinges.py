"""A spatial four-bar RSSR whose rod is cut and welded, and whose balls are hinges that meet."""

from __future__ import annotations

import math
from pathlib import Path

import spatial_pin as sp

ROD = 0.31


def inertial(mass: float, at: str = "0 0 0") -> str:
    i = mass * 1e-2
    return (f'<inertial><origin xyz="{at}"/><mass value="{mass}"/><inertia ixx="{i}" iyy="{2 * i}"'
            f' izz="{2 * i}" ixy="0" ixz="0" iyz="0"/></inertial>')


def link(name: str, inside: str = "") -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, kind: str, parent: str, child: str, xyz: str = "0 0 0", rpy: str = "0 0 0",
          axis: str = "0 0 1") -> str:
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/></joint>')


def ball(name: str, parent: str, child: str, xyz: str, as_hinges: int) -> tuple[list[str], str]:
    """Return URDF elements of a ball, and what a mechanism file says of it."""
    if not as_hinges:
        return [joint(name, "floating", parent, child, xyz)], (
            f'[joints.{name}]\ntype = "spherical"\n')
    ends = [parent, *(f"{name}_{k}" for k in range(1, as_hinges)), child]
    axes = ("0 0 1", "0 1 0", "1 0 0")
    text = [link(end) for end in ends[1:-1]]
    for k in range(as_hinges):
        text.append(joint(f"{name}_turn{k}", "continuous", ends[k], ends[k + 1],
                          xyz if k == 0 else "0 0 0", axis=axes[k]))
    return text, ""


def rssr(folder: Path, cut: bool, hinges_a: int = 0, hinges_b: int = 0) -> sp.Mechanism:
    """Return an RSSR: its rod whole or cut in the middle, its balls of so many hinges (0: a ball).

    Whole, it has a ball closure at its far end.
    """
    half_a, half_b = inertial(0.2, "0.1 0 0"), inertial(0.3, "0.15 0 0")
    urdf = [
        link("ground"), link("crank", inertial(0.4, "0.05 0 0")),
        joint("crank_pin", "continuous", "ground", "crank"),
        link("rocker", inertial(0.5, "0 0.1 0")),
        joint("rocker_pin", "continuous", "ground", "rocker", "0.3 0 0", axis="1 0 0"),
        link("rod_a", half_a), link("rod_b", half_b),
    ]
    first, said = ball("ball_a", "crank", "rod_a", "0.1 0 0", hinges_a)
    urdf += first
    if cut:
        second, more = ball("ball_b", "rocker", "rod_b", "0 0.25 0", hinges_b)
        urdf += [*second, link("end_a"), link("end_b"),
                 joint("on_a", "fixed", "rod_a", "end_a", f"{ROD / 2} 0 0"),
                 joint("on_b", "fixed", "rod_b", "end_b", f"{ROD / 2} 0 0", f"0 0 {math.pi!r}")]
        said += more + ('[[closures]]\nname = "cut"\ntype = "weld"\n'
                        'frames = ["end_a", "end_b"]\n')
    else:
        urdf += [joint("whole", "fixed", "rod_a", "rod_b", f"{ROD} 0 0", f"0 0 {math.pi!r}"),
                 link("tip"), joint("on_rocker", "fixed", "rocker", "tip", "0 0.25 0")]
        said += '[[closures]]\nname = "ball_b"\ntype = "spherical"\nframes = ["tip", "rod_b"]\n'
    folder.mkdir(exist_ok=True)
    (folder / "m.urdf").write_text(f'<robot name="m">{"".join(urdf)}</robot>')
    (folder / "m.toml").write_text(
        f'name = "m"\ntree = "m.urdf"\n{said}[drivers.crank]\njoint = "crank_pin"\n'
        "[guess]\ncrank_pin = 0.3\nrocker_pin = 0.4\n")
    return sp.load(folder / "m.toml")
