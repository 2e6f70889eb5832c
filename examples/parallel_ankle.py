"""A humanoid's ankle with two motors: which torques hold it on its toes, at every pitch and roll?

    python examples/parallel_ankle.py [FOLDER]

writes parallel_ankle.png: the foot pitched and rolled.
"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

import spatial_pin as sp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
ankle = sp.load(Path(__file__).parent / "machines" / "parallel_ankle.toml")
toes = {"toes": pin.Force(np.array([0.0, 0.0, 60 * 9.81]), np.zeros(3))}  # all of the robot

print("pitch roll [deg]   motors [deg]      motors per ankle [rad/rad]   torques [N m]")
table, names = [], list(ankle.drivers)
rows = [ankle.coordinate(name).v for name in names]
for pitch, roll in [(-20, 0), (0, 0), (20, 0), (40, 0), (0, 15), (20, 15), (40, 15), (40, -15)]:
    foot = {"ankle.first": np.radians(pitch), "ankle.second": np.radians(roll)}
    state = sp.reach(ankle, foot)
    # how fast motors turn when the foot pitches, and when it rolls, by 1 rad/s
    ratios = sp.influence(ankle, state, drivers=list(foot)).first[rows]
    torques = sp.inverse_dynamics(ankle, state, external=toes).efforts
    table.append((pitch, roll, state, ratios, torques))
    motors = [np.degrees(state.coordinate(name).value) for name in names]
    print(f"{pitch:5} {roll:4}       {motors[0]:7.2f} {motors[1]:7.2f}    "
          + " ".join(f"{x:6.3f}" for x in ratios.ravel())
          + f"     {torques['left']:7.2f} {torques['right']:7.2f}")

worst = max(table, key=lambda row: max(map(abs, row[-1].values())))
print(f"The worst of these is pitch {worst[0]} and roll {worst[1]} degrees: "
      f"{max(map(abs, worst[-1].values())):.1f} N m in one motor.")
sp.screenshot(worst[2], folder / "parallel_ankle.png")
