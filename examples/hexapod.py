"""A hexapod: its legs for a pose, the slice that it works in, and where it gives way.

    python examples/hexapod.py [FOLDER]

writes slice.png (where the level platform gets to at one height, and how well its legs move it
there) and hexapod.png (the platform turned half of the way to its singularity).
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np
import pinocchio as pin

import spatial_pin as sp

matplotlib.use("Agg")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
hexapod = sp.load("stewart")
home = sp.assemble(hexapod)
legs = list(hexapod.drivers)

# one pose, and the legs that it needs
pose = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.05, 0.2), np.array([0.03, 0.02, 0.40]))
state = sp.reach(hexapod, {"platform": pose}, home)
lengths = np.array([state.coordinate(leg).value for leg in legs])
print("legs [mm]: " + " ".join(f"{1e3 * length:.3f}" for length in lengths))

# a slice at 0.40 m, with the legs within their limits
middle = sp.reach(hexapod, {"platform": pin.SE3(np.eye(3), np.array([0, 0, 0.40]))}, home)
found = sp.workspace(hexapod, "platform", {"x": (-0.15, 0.15), "y": (-0.15, 0.15)}, points=61,
                     guess=middle)
area = 1e4 * found.reached.sum() * (0.3 / 60)**2
print(f"Level at 0.40 m it works on {area:.0f} cm2; its dexterity is "
      f"{np.nanmin(found.dexterity):.4f} to {np.nanmax(found.dexterity):.4f}.")
found.plot(folder / "slice.png", plane="xy")

# turned about its axis: how far it turns when one leg is a millimetre too long, at worst
at = home.placement("platform").translation
turns = [pin.SE3(pin.utils.rotate("z", np.radians(a)), at) for a in np.arange(0.0, 101.0)]
motion = sp.reach_path(hexapod, {"platform": turns}, state=home)
for degrees in (0, 30, 60, 80, 85, 89):
    jacobian = sp.jacobian(hexapod, motion.state(degrees), "platform")
    print(f"turned by {degrees:2} degrees: {np.degrees(1e-3 * abs(jacobian[5]).max()):.3f} "
          "degrees for a millimetre")
(lost,) = [event for event in motion.events if event.kind == "singular"]
print(f"At {lost.value:.6f} degrees: {lost.text}.")
sp.screenshot(motion, folder / "hexapod.png", look=sp.Look(ghosts=(home,)), row=45)
