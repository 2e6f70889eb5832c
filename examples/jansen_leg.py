"""Theo Jansen's leg: how far does it step, how high, and for how long does it stand?

    python examples/jansen_leg.py [FOLDER]

writes jansen_leg.png: the leg with the path of its foot.
"""

import sys
from pathlib import Path

import numpy as np

import spatial_pin as sp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
leg = sp.load(Path(__file__).parent / "machines" / "jansen_leg.toml")
motion = sp.sweep(leg, "crank", np.linspace(0.0, 2 * np.pi, 721))

foot = motion.frame("foot").position[:-1]
x, z = foot[:, 0], foot[:, 2]
stands = z < z.min() + 0.02
print(f"A step is {100 * np.ptp(x):.1f} cm long, the foot is lifted by {100 * np.ptp(z):.1f} cm.")
print(f"It is within 2 cm of the ground for {100 * stands.mean():.0f} % of a turn, "
      f"over {100 * np.ptp(x[stands]):.1f} cm.")
for legs in (2, 3, 6):  # on one crankshaft, evenly apart: the body hangs on the lowest foot
    body = -np.min([np.roll(z, k * 720 // legs) for k in range(legs)], axis=0)
    print(f"With {legs} legs the body rises and falls by {100 * np.ptp(body):.1f} cm.")

sp.screenshot(motion, folder / "jansen_leg.png", look=sp.Look(traces=("foot",)), row=90)
