"""A gripper: which torque grips with 100 N, and do the jaws stay parallel?

    python examples/parallel_gripper.py [FOLDER]

writes parallel_gripper.png: the gripper half closed, and wide open.
"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

import spatial_pin as sp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
FILE = Path(__file__).parent / "machines" / "parallel_gripper.toml"
exact = sp.load(FILE)
wrong = sp.load(FILE, second=0.0601)  # one of the arms is 0.1 mm too long
grip = {side: pin.Force(np.array([force, 0.0, 0.0]), np.zeros(3))
        for side, force in (("right_pad", 100.0), ("left_pad", -100.0))}


def opened(gripper, opening):
    """Return a gripper with its pads so far apart [m]."""
    return sp.reach(gripper, {"right_pad": sp.targets.distance("left_pad", opening)})


def tilt(state):
    """Return by how much the right jaw leans [rad]."""
    return state.coordinate("right_arm").value + state.coordinate("right_jaw_pin").value


print("open [mm]  turns  torque [N mm]  tilt, and with an arm 0.1 mm too long [degrees]")
table = []
for opening in (0.08, 0.06, 0.04, 0.02, 0.005):
    state = opened(exact, opening)
    turns = state.coordinate("motor").value / (2 * np.pi)
    torque = -sp.inverse_dynamics(exact, state, external=grip).efforts["motor"]
    leans = tilt(state), tilt(opened(wrong, opening))
    table.append((opening, state, torque, leans))
    print(f"{1e3 * opening:8.0f} {turns:7.2f} {1e3 * torque:14.1f} "
          f"{abs(np.degrees(leans[0])):18.3f} {np.degrees(leans[1]):10.3f}")

half, wide = table[2][1], table[0][1]
sp.screenshot(half, folder / "parallel_gripper.png", look=sp.Look(ghosts=(wide,)))
