"""A door closer: how long does the door take to shut, and how fast does it meet the frame?

EN 1154 wants at least 18 N m at the door when it is shut, and 3 to 7 s from 90 degrees.

    python examples/door_closer.py [FOLDER]

writes door_closer.png (the door half open) and closing.png (its angle in time).
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
door = sp.load(Path(__file__).parent / "machines" / "door_closer.toml")

opened = sp.sweep(door, "door", np.radians([0.0, 30.0, 60.0, 90.0]))
moments = sp.kinetostatics(door, opened).efforts["door"]
print("To hold the door: " + ", ".join(f"{m:.1f} N m at {a:.0f}°" for m, a in zip(
    moments, np.degrees(opened.driver), strict=True)))


def latch(angle, rate):
    """Return the moment of the spring [N m] where a valve lets oil pass before the door is shut."""
    return 3.0 * (angle + 4.5) - 18.0 * rate * (1.0 - np.tanh((angle + 0.4) / 0.05)) / 2.0


def shut(time, state):
    """Cross zero where the door meets the frame."""
    return state.coordinate("door").value


figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
runs = {}
for name, laws in (("one valve", None), ("with a latching valve", {"closer": latch})):
    run = sp.simulate(door, opened.state(-1), 15.0, laws=laws, stop_when=shut)
    angle = run.coordinate("door")
    runs[name] = run
    print(f"{name}: shut after {run.time[-1]:.3f} s at {-angle.rate[-1]:.3f} rad/s, "
          f"{-0.9 * angle.rate[-1]:.3f} m/s at its edge")
    axes.plot(run.time, np.degrees(angle.value), label=name)
axes.set(xlabel="time [s]", ylabel="door [degrees]")
axes.legend(frameon=False)
figure.savefig(folder / "closing.png", dpi=120)
sp.screenshot(opened, folder / "door_closer.png", row=2)
