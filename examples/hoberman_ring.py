"""Hoberman's ring: does it move though every formula says no, and how far does it open?

    python examples/hoberman_ring.py [FOLDER]

writes hoberman_ring.png: the ring, half open, with the paths of its inner hinges.
"""

import sys
from pathlib import Path

import numpy as np

import spatial_pin as sp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
FILE = Path(__file__).parent / "machines" / "hoberman_ring.toml"
ring = sp.load(FILE)
mobility = sp.mobility(ring)
print(f"{mobility.kutzbach} freedoms by the formula in space, {mobility.grubler} in the plane; "
      f"it has {mobility.dof}, for {len(mobility.redundant)} equations are redundant.")
bent = sp.mobility(sp.load(FILE, kink=np.radians(46.0)))
print(f"Were the bars bent by 46 degrees instead of 45, it would have {bent.dof}.")

motion = sp.sweep(ring, "opening", -np.radians(np.linspace(5.0, 65.0, 121)))
outer, inner = (2 * np.linalg.norm(motion.frame(f"first_0_{end}").position, axis=1)
                for end in ("outer", "inner"))
guides = np.array([motion.coordinate(f"slide_{k}").value for k in range(8)])
print(f"Open it is {outer[0]:.3f} m wide with a hole of {inner[0]:.3f} m, "
      f"closed {outer[-1]:.3f} m with one of {inner[-1]:.3f} m.")
print(f"It stays round: units differ by {1e9 * np.ptp(guides, axis=0).max():.0f} nm.")

sp.screenshot(motion, folder / "hoberman_ring.png",
              look=sp.Look(traces=tuple(f"first_{k}_inner" for k in range(8))), row=60)
