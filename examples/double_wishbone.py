"""A double wishbone suspension: camber, caster, toe and bump steer as the wheel goes up and down.

How high must the steering rack stand so that the wheel does not steer when it meets a bump?

    python examples/double_wishbone.py [FOLDER]

writes double_wishbone.png: the suspension, and the paths of hub and balls.
"""

import sys
from pathlib import Path

import numpy as np

import spatial_pin as sp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
FILE = Path(__file__).parent / "machines" / "double_wishbone.toml"


def travel(rack_z):
    """Return the motion of the wheel, and its angles [degrees], for a height of the rack."""
    car = sp.load(FILE, rack_z=rack_z)
    motion = sp.sweep(car, "wheel", np.radians(np.linspace(-10.0, 10.0, 41)))
    hub, top, bottom = (motion.frame(name) for name in ("hub", "upright_top", "lower_ball"))
    axle, kingpin = hub.rotation[:, :, 1], top.position - bottom.position
    angles = {"camber": -np.arcsin(axle[:, 2]), "toe-in": np.arctan2(axle[:, 0], axle[:, 1]),
              "caster": np.arctan2(-kingpin[:, 0], kingpin[:, 2])}
    return motion, hub, {name: np.degrees(x) for name, x in angles.items()}


motion, hub, angles = travel(0.233)
height = 1e3 * (hub.position[:, 2] - hub.position[20, 2])
print("  wheel [mm]" + "".join(f"{name:>10}" for name in angles) + "   [degrees]")
for i in range(0, 41, 5):
    print(f"{height[i]:12.1f}" + "".join(f"{round(x[i], 3) + 0.0:10.3f}" for x in angles.values()))

for rack_z in (0.223, 0.233, 0.243):
    _, at, found = travel(rack_z)
    steer = np.gradient(found["toe-in"], 1e3 * at.position[:, 2])[20]
    print(f"rack at {1e3 * rack_z:.0f} mm: bump steer {100 * steer:+.3f} degrees in 100 mm")

foot, top = motion.frame("strut_foot"), motion.frame("strut_top")
strut = top.position - foot.position
ratio = np.sum(strut * foot.velocity, axis=1) / np.linalg.norm(strut, axis=1) / hub.velocity[:, 2]
print(f"The spring is pressed by {ratio[20]:.3f} mm when the wheel rises by 1 mm: "
      f"50 N/mm are {50 * ratio[20]**2:.1f} N/mm at the wheel.")
look = sp.Look(traces=("hub", "steering_arm", "upright_top"))
sp.screenshot(motion, folder / "double_wishbone.png", look=look, row=20)
