"""A five-bar whose two arms are driven: where its tip gets to."""

from mechanisms import closure, driver, guess, load, point, turning

import spatial_pin as sp

GROUND, ARM, ROD = 0.2, 0.12, 0.16  # of the five-bar
ANGLES = (0.3, 2.8)
BARS = {"left": ANGLES, "right": ANGLES}


def five_bar(folder, ground=GROUND, arms=(ARM, ARM), rods=(ROD, ROD)) -> sp.Mechanism:
    """Two arms on the ground that are driven, and two rods that meet at the tip above them."""
    tree = (turning("left", "ground", "arm1") + turning("right", "ground", "arm2", (ground, 0, 0))
            + turning("elbow1", "arm1", "rod1", (arms[0], 0, 0))
            + turning("elbow2", "arm2", "rod2", (arms[1], 0, 0))
            + point("tip", "rod1", (rods[0], 0, 0)) + point("tip2", "rod2", (rods[1], 0, 0)))
    toml = (driver("left", "left") + driver("right", "right")
            + closure("pin", "revolute", "tip", "tip2")
            + guess(left=1.9, right=1.2, elbow1=-1.0, elbow2=1.0))
    return load(folder, "five_bar", tree, toml)
