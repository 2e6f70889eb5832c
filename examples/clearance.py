"""How far one arm of a delta robot can go before its rods run into each other.

As the arm swings down and in, it pushes the platform away. The two rods of every other arm then
come nearer to each other. They would end in one line, but touch before.

    python examples/clearance.py [FOLDER]

writes clearance.png (links that touch are red, the beginning is faint), clearance.html and
curves.png.
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
mechanism = sp.load("delta")
motion = sp.sweep(mechanism, "arm_1", np.deg2rad(np.linspace(0.0, 134.0, 68)))

found = sp.clearance(motion)
print(found)
first = found.events[0]
print(f"\nThe first contact: {first.text}, which is {np.rad2deg(first.value):.3f} degrees.")

# a motion that ends where those rods are still 5 mm apart
rods = [found.touching[0].links]
early = sp.clearance(motion, rods, tolerance=5e-3).events[0].value
safe = sp.sweep(mechanism, "arm_1", np.linspace(motion.driver[0], early, 51))
print(f"Up to {np.rad2deg(early):.3f} degrees these two come no nearer than "
      f"{1e3 * sp.clearance(safe, rods).least.distance:.3f} mm.")

look = sp.Look(clearance=found, ghosts=[motion.state(0)])
sp.screenshot(motion, folder / "clearance.png", look=look, row=-1, size=(1280, 800))
sp.export_html(motion, folder / "clearance.html", look=look)

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for pair in found.pairs[:4]:
    axes.plot(np.rad2deg(motion.driver), 1e3 * pair.distances, label=" and ".join(pair.links))
axes.axhline(0.0, color="black", linewidth=0.8)
axes.set(xlabel="arm_1 [degrees]", ylabel="distance [mm], below zero overlap",
         title="Delta robot: rods run into each other beyond 124 degrees")
axes.legend(frameon=False)
figure.savefig(folder / "curves.png", dpi=120)
