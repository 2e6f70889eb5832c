"""The four-bar hinge of a bonnet: does its rear edge clear the cowl, and what must the hand do?

    python examples/bonnet_hinge.py [FOLDER]

writes bonnet_hinge.png: the bonnet shut and open, with the path of its rear edge.
"""

import sys
from pathlib import Path

import numpy as np

import spatial_pin as sp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
bonnet = sp.load(Path(__file__).parent / "machines" / "bonnet_hinge.toml")

# opened by its rear link, from shut (level) to 50 degrees
motion = sp.sweep(bonnet, "hinge", np.radians(np.linspace(156.5, 113.0, 88)))
pitch = np.degrees(motion.coordinate("rear_pin").value + motion.coordinate("bonnet_pin").value)
edge = 1e3 * motion.frame("rear_edge").position
print(f"It opens from {pitch[0]:.1f} to {pitch[-1]:.1f} degrees; its rear edge goes forward by "
      f"{np.ptp(edge[:, 0]):.0f} mm and up by {np.ptp(edge[:, 2]):.0f} mm.")

found = sp.clearance(motion, [("bonnet", "body")])
print(f"It comes no nearer to the cowl than {1e3 * found.least.distance:.2f} mm, at "
      f"{pitch[found.least.row]:.1f} degrees.")

# the force at the front edge that holds it, upwards: the work of the rear link's moment
moment = sp.kinetostatics(bonnet, motion).efforts["hinge"]
hand = moment / motion.frame("hand").velocity[:, 2]  # velocity per radian of the rear link
for angle in (0, 5, 10, 20, 30, 40, 50):
    print(f"at {angle:2} degrees the hand lifts with {np.interp(angle, pitch, hand):+6.1f} N")
print(f"Above {np.interp(0.0, -hand, pitch):.1f} degrees it opens by itself.")

look = sp.Look(ghosts=(motion.state(0),), traces=("rear_edge", "hand"))
sp.screenshot(motion, folder / "bonnet_hinge.png", look=look, row=-1)
