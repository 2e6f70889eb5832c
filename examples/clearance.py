"""How far Sarrus's linkage can be pushed up before its plates run into each other.

The two pairs of plates lean outwards at first and stand upright where the arms have turned by 90
degrees. Beyond that the middle hinges come together.

    python examples/clearance.py [FOLDER]

writes clearance.png (the moment of contact, touching links red), clearance.html and curves.png.
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
mechanism = sp.load("sarrus")
motion = sp.sweep(mechanism, "arm", np.deg2rad(np.linspace(40.0, 110.0, 71)))

found = sp.clearance(motion)
print(found)
first = found.events[0]
print(f"\nThe first contact: {first.text}, which is {np.rad2deg(first.value):.3f} degrees.")

# a motion that ends where the plates are still 5 mm apart
early = sp.clearance(motion, tolerance=5e-3).events[0].value
safe = sp.sweep(mechanism, "arm", np.linspace(motion.driver[0], early, 51))
print(f"Up to {np.rad2deg(early):.3f} degrees no two plates come nearer than "
      f"{1e3 * sp.clearance(safe).least.distance:.3f} mm.")

look = sp.Look(clearance=found)
sp.screenshot(motion, folder / "clearance.png", look=look, row=-1)
sp.export_html(motion, folder / "clearance.html", look=look)

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for pair in found.pairs[:4]:
    axes.plot(np.rad2deg(motion.driver), 1e3 * pair.distances, label=" and ".join(pair.links))
axes.axhline(0.0, color="black", linewidth=0.8)
axes.set(xlabel="arm [degrees]", ylabel="distance [mm], below zero overlap",
         title="Sarrus's linkage: plates come together beyond 94 degrees")
axes.legend(frameon=False)
figure.savefig(folder / "curves.png", dpi=120)
