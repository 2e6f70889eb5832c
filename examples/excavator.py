"""An excavator digs: three cylinders along their trajectories, and the forces that this takes.

The soil holds the teeth back by 60 kN, against their velocity, once they are 0.2 m below ground.

    python examples/excavator.py [FOLDER]

writes excavator.png (at the bottom of the cut, with the path of the teeth), curves.png (lengths and
forces of the cylinders) and dig.csv (all numbers of the motion).
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

import spatial_pin as sp

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
mechanism = sp.load("excavator")

# lengths of the cylinders where the dig changes its character: reach out, bite, crowd, curl, lift
seconds = [0.0, 2.0, 3.5, 5.0, 6.5, 8.0, 10.0]
lengths = {"boom": [2.89, 2.76, 2.70, 2.665, 2.64, 2.70, 3.00],
           "arm": [2.70, 2.67, 2.75, 2.86, 2.985, 3.09, 3.15],
           "bucket": [2.09, 2.09, 2.23, 2.385, 2.54, 2.67, 2.70]}
times = np.linspace(0.0, 10.0, 1000)
tables = {name: CubicSpline(seconds, x, bc_type="clamped")(times) for name, x in lengths.items()}
motion = sp.follow(mechanism, tables, times)
print(motion)


def soil(state):
    """Return the force on the teeth [N]: against their velocity, below ground."""
    depth, velocity = -state.placement("teeth").translation[2], state.velocity("teeth").linear
    part = np.clip(depth / 0.2, 0.0, 1.0) / max(np.linalg.norm(velocity), 1e-2)
    return {"teeth": pin.Force(-60e3 * part * velocity, np.zeros(3))}


efforts = sp.kinetostatics(mechanism, motion, external=soil).efforts
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 6), sharex=True, layout="constrained")
for name, colour in zip(lengths, ("#c0392b", "#1f77b4", "#2e8b57"), strict=True):
    most = mechanism.model.upperEffortLimit[mechanism.coordinate(name).v]
    print(f"{name}: {1e-3 * efforts[name].min():.0f} to {1e-3 * efforts[name].max():.0f} kN "
          f"of the {1e-3 * most:.0f} kN that its pressure gives")
    above.plot(times, motion.coordinate(name).value, color=colour, label=name)
    below.plot(times, 1e-3 * efforts[name], color=colour)
above.set(ylabel="length [m]", title="Three cylinders dig")
below.set(xlabel="time [s]", ylabel="force, pushing above zero [kN]")
figure.legend(frameon=False, ncols=3, loc="outside lower center")
figure.savefig(folder / "curves.png", dpi=120)
motion.to_csv(folder / "dig.csv")
sp.screenshot(motion, folder / "excavator.png", look=sp.Look(traces=("teeth",)), row=560)
