"""A snap switch: where does its button rest, and how hard must one press?

    python examples/bistable_toggle.py [FOLDER]

writes bistable_toggle.png (the switch in its two positions) and pressing.png (force of the finger).
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
switch = sp.load(Path(__file__).parent / "machines" / "bistable_toggle.toml")

# poses beyond its slider's travel are those of another assembly: the spring pulled through
poses = [pose for pose in sp.equilibria(switch) if not pose.state.beyond_limits]
poses.sort(key=lambda pose: -pose.state.coordinate("button").value)
for pose in poses:
    height, kind = pose.state.coordinate("button").value, "" if pose.stable else "not "
    print(f"button at {1e3 * height + 0.0:7.3f} mm: {kind}stable, "
          f"stiffness {pose.stiffness[0, 0]:.1f} N/m, energy {1e3 * pose.energy:.3f} mJ")

small = sp.linearize(switch, poses[0].state)
print(f"At rest the button rings at {small.frequencies[0]:.1f} Hz.")

top = max(pose.state.coordinate("button").value for pose in poses)
path = sp.sweep(switch, "button", np.linspace(1.2 * top, -1.2 * top, 241))
force = -sp.kinetostatics(switch, path).efforts["button"]
way = path.driver
inside = np.abs(way) < top
snap = int(np.argmax(np.where(inside & (way > 0.0), force, -np.inf)))
print(f"It snaps at {1e3 * way[snap]:.2f} mm, when the finger presses with {force[snap]:.2f} N.")

figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
axes.plot(1e3 * way, force)
for pose in poses:
    axes.plot(1e3 * pose.state.coordinate("button").value, 0.0, "o",
              mfc="tab:blue" if pose.stable else "white", mec="tab:blue")
axes.set(xlabel="height of the button [mm]", ylabel="force of the finger, down [N]")
axes.invert_xaxis()
figure.savefig(folder / "pressing.png", dpi=120)
ends = [pose.state for pose in poses if pose.stable]
sp.screenshot(ends[0], folder / "bistable_toggle.png", look=sp.Look(ghosts=tuple(ends[1:])))
