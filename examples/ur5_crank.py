"""A UR5 turns a crank: a closed loop of arm, handle and table. Which joint is nearest to a limit?

    python examples/ur5_crank.py [FOLDER]      needs: pip install 'spatial_pin[robots]'

writes ur5_crank.png: the arm at the crank.
"""

import sys
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

import spatial_pin as sp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
URDF = "cmeel.prefix/share/example-robot-data/robots/ur_description/urdf/ur5_robot.urdf"
file = next((Path(p) / URDF for p in sys.path if (Path(p) / URDF).exists()), None)
if file is None:
    sys.exit("The UR5 is not there: pip install 'spatial_pin[robots]' (example-robot-data)")

# the arm of the maker's file, and a crank of 0.15 m beside it that nobody has drawn
arm = sp.load(file)
model, drawn, radius = arm.model.copy(), arm.visual_model.copy(), 0.15
crank = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([0.45, 0.11, 0.2])),
                       "crank")
along = pin.SE3(pin.utils.rotate("y", np.pi / 2), np.array([radius / 2, 0, 0]))
knob = pin.SE3(np.eye(3), np.array([radius, 0, 0.03]))
for name, shape, at in (("arm", coal.Cylinder(0.012, radius), along),
                        ("knob", coal.Cylinder(0.015, 0.06), knob)):
    drawn.addGeometryObject(pin.GeometryObject(name, crank, at, shape))
handle = pin.SE3(pin.utils.rotate("x", np.pi), np.array([radius, 0, 0.06]))  # z down, as the hand
robot = sp.Mechanism.from_model(
    model, [sp.closures.revolute("tool0", ("crank", handle), "grip")], visual_model=drawn,
    drivers=["crank", *arm.drivers], name="UR5 at a crank",
    guess={"shoulder_lift_joint": -1.5, "elbow_joint": 1.8, "wrist_1_joint": -1.8,
           "wrist_2_joint": -1.57})

turn = 2 * np.pi / 2.0  # a turn in two seconds
motion = sp.sweep(robot, "crank", np.linspace(0.0, 2 * np.pi, 181), speed=turn,
                  hold=["wrist_3_joint"])
brake = {"crank": pin.Force(np.zeros(3), np.array([0.0, 0.0, -6.0]))}  # it takes 6 N m
joints = list(arm.drivers)
loads = sp.kinetostatics(robot, motion, joints, external=brake)
for name in joints:
    at = robot.coordinate(name).v
    speed = abs(motion.coordinate(name).rate).max() / model.velocityLimit[at]
    torque = abs(loads.efforts[name]).max() / model.effortLimit[at]
    print(f"{name:20} {100 * speed:5.1f} % of its speed, {100 * torque:5.1f} % of its torque")
grip = loads.reactions["grip"][:, :3]
print(f"Six motors for two freedoms: with the least torques the arm leans on the handle with up to "
      f"{np.abs(grip[:, 2]).max():.0f} N; it turns with {6 / radius:.0f} N.")
sp.screenshot(motion, folder / "ur5_crank.png", look=sp.Look(traces=("tool0",)), row=20)
