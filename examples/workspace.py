"""Where a five-bar and a delta robot get to, how well, and what ends it.

Two motors on the ground move the tip of the five-bar. Its workspace ends where the two rods are in
line. It is also bounded by curves on which an arm and its rod are in line: there the tip cannot
move in one direction. Of the delta, a plane through the middle is drawn.

    python examples/workspace.py [FOLDER]

writes five_bar.png, delta.png (a cross-section), delta.csv, and cloud.png and cloud.html (all
points about the robot).
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


def five_bar(ground=0.2, arm=0.12, rod=0.16):
    """Return a five-bar in the x-y plane, its tip above its motors."""
    model = pin.Model()
    for side, x in (("left", 0.0), ("right", ground)):
        motor = model.addJoint(0, pin.JointModelRZ(), at(x), side)
        elbow = model.addJoint(motor, pin.JointModelRZ(), at(arm), f"{side}_elbow")
        model.addFrame(pin.Frame(f"{side}_tip", elbow, at(rod), pin.FrameType.OP_FRAME))
    return sp.Mechanism.from_model(
        model, [sp.closures.revolute("left_tip", "right_tip", "tip")], drivers=["left", "right"],
        guess={"left": 1.9, "right": 1.2, "left_elbow": -1.0, "right_elbow": 1.0}, name="five_bar")


def at(x):
    """Return a placement at x."""
    return pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))


ranges = {side: (-0.4, np.pi + 0.4) for side in ("left", "right")}
found = sp.workspace(five_bar(), "left_tip", ranges, points=81)
print(found)
found.plot(folder / "five_bar.png", plane="xy")

delta = sp.load("delta")
ranges = {f"arm_{k}": (-0.9, 1.4) for k in (1, 2, 3)}
found = sp.workspace(delta, "platform", ranges, points=17)
print(f"\n{found}")
found.plot(folder / "delta.png", plane="xz", at=0.0)
found.to_csv(folder / "delta.csv")

home, look = sp.assemble(delta), sp.Look(workspace=found)
sp.screenshot(home, folder / "cloud.png", look=look)
sp.export_html(home, folder / "cloud.html", look=look)
