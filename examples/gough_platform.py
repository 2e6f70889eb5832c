"""A Gough platform that writes a figure of eight with a tool on its plate.

The tool's point goes round the eight in a horizontal plane while the tool leans into the curve.
What the legs have to do for that, and the forces in them, follow from the tool's placements.

    python examples/gough_platform.py [FOLDER]

writes machine/ (the platform with its tool, as files), platform.png (the platform as it writes),
curves.png (lengths of the legs and forces in them) and motion.csv (all numbers of the motion).
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np
import pinocchio as pin

import spatial_pin as sp

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

# the platform of the library, with a pen on it and a frame at the pen's point
file = sp.load("stewart").save(folder / "machine")
tree, plate = file.with_suffix(".urdf"), '<link name="platform">'
pen = """<visual><origin xyz="0 0 0.066"/>
<geometry><cylinder length="0.068" radius="0.006"/></geometry>
<material name="pen"><color rgba="0.8 0.1 0.3 1"/></material></visual>"""
tree.write_text(tree.read_text().replace(plate, plate + pen))
file.write_text(file.read_text() + '\n[frames.tool]\nlink = "platform"\nxyz = [0, 0, 0.1]\n')
mechanism = sp.load(file)

# where the tool is to be, at 501 moments of four seconds
times = np.linspace(0.0, 4.0, 501)
angle = 0.5 * np.pi * times
start = sp.assemble(mechanism)
home = start.placement("tool")
points = home.translation + np.column_stack(
    [0.08 * np.sin(angle), 0.06 * np.sin(2.0 * angle), np.zeros_like(angle)])
leans = np.column_stack([-0.1 * np.sin(2.0 * angle), 0.15 * np.sin(angle), np.zeros_like(angle)])
poses = [pin.SE3(pin.exp3(lean) @ home.rotation, point)
         for lean, point in zip(leans, points, strict=True)]

motion = sp.reach_path(mechanism, {"tool": poses}, times, start)
print(motion)
off = np.abs(motion.frame("tool").position - points).max()
print(f"\nThe tool is nowhere farther than {off:.1e} m from where it should be.")
efforts = sp.kinetostatics(mechanism, motion).efforts
for name in mechanism.drivers:
    leg, force = motion.coordinate(name), np.abs(efforts[name]).max()
    print(f"{name}: {1e3 * leg.value.min():.1f} to {1e3 * leg.value.max():.1f} mm, "
          f"at most {1e3 * np.abs(leg.rate).max():.0f} mm/s and {force:.1f} N")

motion.to_csv(folder / "motion.csv")
sp.screenshot(motion, folder / "platform.png", look=sp.Look(traces=("tool",)), row=60)

figure, (lengths, forces) = plt.subplots(2, 1, figsize=(7, 6), sharex=True, layout="constrained")
for name in mechanism.drivers:
    lengths.plot(times, 1e3 * motion.coordinate(name).value, label=name.replace("_", " "))
    forces.plot(times, efforts[name])
lengths.set(ylabel="length [mm]", title="Six legs that write a figure of eight")
forces.set(xlabel="time [s]", ylabel="force [N]")
figure.legend(frameon=False, ncols=6, loc="outside lower center")
figure.savefig(folder / "curves.png", dpi=120)
