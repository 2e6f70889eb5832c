"""Four cylinders in line shake twice a turn: what must Lanchester's balance shafts weigh?

    python examples/balanced_engine.py [FOLDER]

writes balanced_engine.png (the engine with its shafts) and shaking.png (the force on its mounts,
with and without them).
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
FILE = Path(__file__).parent / "machines" / "balanced_engine.toml"
speed = 5000 * 2 * np.pi / 60
angles = np.linspace(0.0, 2 * np.pi, 361)


def shaking(eccentric):
    """Return the motion, the vertical force on the mounts [N] and its harmonics, of a turn."""
    engine = sp.load(FILE, eccentric=eccentric)
    motion = sp.sweep(engine, "crank", angles, speed=speed)
    force = sp.kinetostatics(engine, motion).on_ground[:, 2]
    return motion, force, 2 * np.fft.rfft(force[:-1]) / 360


motion, before, harmonics = shaking(0.0)
print(f"Without shafts: {abs(harmonics[1]):.0f} N once a turn, {harmonics[2].real:+.0f} N twice, "
      f"{harmonics[4].real:+.1f} N four times at 5000 rpm.")

# each shaft bears half of the force, at twice the speed of the crank
moment = harmonics[2].real / (2 * (2 * speed)**2)
heavy = 7850 * np.pi * 0.016**2 * 0.10  # the weight between the bearings [kg]
motion, after, left = shaking(moment / heavy)
print(f"Each shaft needs {1e6 * moment:.0f} g mm: {1e3 * heavy:.0f} g, "
      f"{1e3 * moment / heavy:.3f} mm off its axis.")
print(f"With them: {abs(left[2]):.0f} N twice, {left[4].real:+.1f} N four times.")

sp.screenshot(motion, folder / "balanced_engine.png", row=30)
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for force, name in ((before, "without shafts"), (after, "with shafts")):
    axes.plot(np.degrees(angles), 1e-3 * (force - force[:-1].mean()), label=name)
axes.set(xlabel="crank [degrees]", ylabel="force on the mounts [kN]")
axes.legend(frameon=False)
figure.savefig(folder / "shaking.png", dpi=120)
