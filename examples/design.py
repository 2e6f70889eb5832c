"""A four-bar that draws a closed curve, one that draws a line, and one that works out a logarithm.

Nine numbers are unknown: where the four-bar stands, how long its links are, and where its tracer
is. The crank turns by 20° from each of the eighteen points of the curve to the next; the best
published dimensions that we know miss them by 0.0954 in all [Bulatovic2016]. The points of the line
are met as well as possible, three of the logarithm exactly.

    python examples/design.py [FOLDER]

writes design.png: all three; report.txt; tracer.toml and tracer.urdf.xacro, a four-bar with all
lengths free; curve/, the first of what was found as a mechanism.
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np

import spatial_pin as sp

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

FAMILY = """<robot name="tracer" xmlns:xacro="http://www.ros.org/wiki/xacro">
  {arguments}
  <link name="ground"/>
  {links}
</robot>"""
ARGUMENTS = {"x0": 0.0, "y0": 0.0, "theta0": 0.0, "r1": 0.8, "r2": 0.2, "r3": 0.7, "r4": 0.6,
             "cx": 0.4, "cy": 0.2}
JOINT = """<link name="{child}"/>
  <joint name="{name}" type="{kind}">
    <parent link="{parent}"/> <child link="{child}"/>
    <origin xyz="{xyz}" rpy="{rpy}"/> <axis xyz="0 0 1"/>
  </joint>"""
JOINTS = [("mount", "fixed", "ground", "base", "$(arg x0) $(arg y0) 0", "0 0 $(arg theta0)"),
          ("crank_pin", "continuous", "base", "crank", "0 0 0", "0 0 0"),
          ("coupler_pin", "continuous", "crank", "coupler", "$(arg r2) 0 0", "0 0 0"),
          ("rocker_pin", "continuous", "base", "rocker", "$(arg r1) 0 0", "0 0 0"),
          ("coupler_tip", "fixed", "coupler", "coupler_end", "$(arg r3) 0 0", "0 0 0"),
          ("rocker_tip", "fixed", "rocker", "rocker_end", "$(arg r4) 0 0", "0 0 0"),
          ("pen", "fixed", "coupler", "tracer", "$(arg cx) $(arg cy) 0", "0 0 0")]


def family():
    """Write a four-bar whose lengths and places are arguments, and return it."""
    keys = ("name", "kind", "parent", "child", "xyz", "rpy")
    (folder / "tracer.urdf.xacro").write_text(FAMILY.format(
        arguments="\n  ".join(f'<xacro:arg name="{name}" default="{value}"/>'
                              for name, value in ARGUMENTS.items()),
        links="\n  ".join(JOINT.format(**dict(zip(keys, joint, strict=True)))
                          for joint in JOINTS)))
    (folder / "tracer.toml").write_text("""name = "tracer"
tree = "tracer.urdf.xacro"
guess = {crank_pin = 1.0, coupler_pin = -0.5, rocker_pin = 1.5}

[drivers.crank]
joint = "crank_pin"

[[closures]]
name = "output_pin"
type = "revolute"
frames = ["coupler_end", "rocker_end"]
""")
    return sp.load(folder / "tracer.toml")


curve = np.array([
    [0.5, 1.1], [0.4, 1.1], [0.3, 1.1], [0.2, 1.0], [0.1, 0.9], [0.05, 0.75], [0.02, 0.6], [0, 0.5],
    [0, 0.4], [0.03, 0.3], [0.1, 0.25], [0.15, 0.2], [0.2, 0.3], [0.3, 0.4], [0.4, 0.5], [0.5, 0.7],
    [0.6, 0.9], [0.6, 1.0]])
line = np.array([[0.2, y] for y in np.linspace(0.2, 0.8, 12)])
anywhere = {name: (0.05, 2.0) for name in ("r1", "r2", "r3", "r4")}
anywhere |= {name: (-2.0, 2.0) for name in ("x0", "y0", "cx", "cy")} | {"theta0": (0.0, 2 * np.pi)}

four_bar = family()
curves = sp.design(
    four_bar, sp.goals.path("tracer", curve, {"crank": np.radians(20.0 * np.arange(18))},
                            input_offset=True, closed=True), anywhere, starts=8, most=3)
curves[0].mechanism.save(folder / "curve")
lines = sp.design(four_bar, sp.goals.path("tracer", line), anywhere, starts=8, most=3)

x = 1.5 - 0.5 * np.cos(np.pi * np.array([1, 3, 5]) / 6)  # Chebyshev's points


def crank(x):
    """Return the crank's angle that stands for x."""
    return np.radians(90.0 * x)


def rocker(x):
    """Return the rocker's angle that stands for the logarithm of x."""
    return np.radians(75.0 + 60.0 * np.log2(x))


lengths = {name: (0.02, 1.0) for name in ("r2", "r3", "r4")}
logarithms = sp.design(
    sp.load("four_bar"),
    sp.goals.function("rocker_pin", rocker(x), {"crank": crank(x)}, weight=None), lengths, starts=4)

report = f"{curves}\n\n{lines}\n\n{logarithms}\n"
print(report)
(folder / "report.txt").write_text(report, encoding="utf-8")


def draw(design, points, axes):
    """Draw a four-bar, the curve of its tracer, and what was asked of it."""
    motion = design.motion()
    traced = np.array([motion.state(i).placement("tracer").translation[:2]
                       for i in range(len(motion))])
    axes.plot(*traced.T, color="tab:blue", lw=1.6, zorder=2)
    axes.scatter(*points.T, s=16, color="tab:red", zorder=5)
    for k, state in enumerate(design.states):
        at = {name: state.placement(name).translation[:2]
              for name in ("base", "coupler", "coupler_end", "rocker", "tracer")}
        alpha = 1.0 if k == 0 else 0.10
        axes.add_patch(plt.Polygon([at["coupler"], at["coupler_end"], at["tracer"]], zorder=3,
                                   fc="0.75", ec="0.25", lw=1.2, alpha=0.6 * alpha))
        for a, b in (("base", "coupler"), ("rocker", "coupler_end")):
            axes.plot(*np.transpose([at[a], at[b]]), color="0.2", lw=3.0, alpha=alpha, zorder=3,
                      solid_capstyle="round", marker="o", ms=5 * (k == 0))
    (error,) = design.errors.values()
    axes.set_title(f"{len(points)} points, missed by {error.most:.2g} at most")
    axes.set_aspect("equal")
    axes.axis("off")


def draw_function(design, axes):
    """Draw by how much the rocker misses the logarithm between the points."""
    every = np.linspace(1.0, 2.0, 201)
    motion = sp.sweep(design.mechanism, "crank", crank(every), guess=design.states[0])
    missed = np.degrees(motion.coordinate("rocker_pin").value - rocker(every))
    axes.axhline(0.0, color="0.6", lw=0.8)
    axes.plot(every, missed, color="tab:blue", lw=1.6)
    axes.plot(x, 0.0 * x, "o", color="tab:red", ms=5)
    axes.set(xlabel="x", ylabel="rocker less 60° log2 x [°]",
             title=f"logarithm, missed by {abs(missed).max():.2g}°")


figure, panels = plt.subplots(1, 3, figsize=(13.5, 4.4), layout="constrained")
draw(curves[0], curve, panels[0])
draw(lines[0], line, panels[1])
draw_function(logarithms[0], panels[2])
figure.savefig(folder / "design.png", dpi=90)
