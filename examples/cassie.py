"""Cassie's leg: how far does it reach, and how soft do its leaf springs make it?

The file is that of MuJoCo Menagerie (MIT licence) without its meshes; you may give yours with them.

    python examples/cassie.py [FOLDER] [cassie.xml]      needs: pip install 'spatial_pin[mjcf]'

writes cassie.png: the robot with its leg bent, and the path of the foot.
"""

import sys
import warnings
from pathlib import Path

import numpy as np

import spatial_pin as sp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
COPY = Path(__file__).parent.parent / "tests" / "data" / "mjcf" / "agility_cassie" / "cassie.xml"
warnings.filterwarnings("ignore", message=".*mesh")
robot = sp.load(sys.argv[2] if len(sys.argv) > 2 else COPY)
weight = 9.81 * sum(body.mass for body in robot.inertias.values())

# the springs straight: the knee's motor bends the leg by way of the rod behind the thigh
springs = {spring.joint: 0.0 for spring in robot.springs}
home = sp.assemble(robot, springs)
knee = sp.limits(robot, "left-knee", home, joints=True, hold=["base", "springs"])
print(knee)
motion = sp.sweep(robot, "left-knee", np.linspace(knee.upper.value, knee.lower.value, 81),
                  guess=home, hold=springs)
length = np.linalg.norm(motion.frame("left-foot").position
                        - motion.frame("left-hip-pitch").position, axis=1)
bend = np.degrees(motion.coordinate("left-knee").value + motion.coordinate("left-tarsus").value)
print(f"The leg is {length.min():.3f} to {length.max():.3f} m long from hip to foot; "
      f"tarsus and knee together stay at {bend.min():.2f} to {bend.max():.2f} degrees.")

# on one foot at home: springs give by their load over their stiffness, to first order
leaves = [spring for spring in robot.springs if spring.joint.startswith("left")]
names = [leaf.joint for leaf in leaves]
others = [name for name in (*robot.drivers, *springs) if name not in names]
slopes = sp.jacobian(robot, home, "left-foot", drivers=names, hold=["base", *others])[2]
load = weight * slopes  # N m about each spring, by virtual work
give = load / [leaf.stiffness for leaf in leaves]
sink = slopes @ give
print(f"On one foot it sinks by {1e3 * sink:.1f} mm of its springs, which is "
      f"{1e-3 * weight / sink:.1f} kN/m: " + ", ".join(
          f"{name} {np.degrees(angle):+.2f}°" for name, angle in zip(names, give, strict=True)))
sp.screenshot(motion, folder / "cassie.png", look=sp.Look(traces=("left-foot",)), row=30)
