"""A wheel loader: does the bucket stay level as it is lifted, and how hard does it break out?

    python examples/wheel_loader.py [FOLDER]

writes wheel_loader.png: the bucket on its way up, at the ground and at the top.
"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

import spatial_pin as sp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
loader = sp.load(Path(__file__).parent / "machines" / "wheel_loader.toml")


def lifting(newton):
    """Return a vertical force [N], positive upwards."""
    return pin.Force(np.array([0.0, 0.0, newton]), np.zeros(3))


# the lift, with the tilt cylinder shut off
lift = sp.sweep(loader, "lift", np.linspace(1.09, 1.76, 68))
pitch = np.degrees(lift.coordinate("boom_pin").value + lift.coordinate("bucket_pin").value)
height = 1.85 + lift.frame("bucket_pin").position[:, 2]
print(f"From {height[0]:.2f} to {height[-1]:.2f} m the bucket is level within "
      f"{np.abs(pitch).max():.2f} degrees.")
loads = sp.kinetostatics(loader, lift, external={"load": lifting(-3500 * 9.81)})
push = loads.efforts["lift"]
print(f"With 3.5 t in it the lift cylinders push with {1e-3 * push.min():.0f} to "
      f"{1e-3 * push.max():.0f} kN.")

# breakout: the tilt cylinder at its pressure, the edge held down
ground = lift.state(0)
alone = sp.inverse_dynamics(loader, ground).efforts["tilt"]
held = sp.inverse_dynamics(loader, ground, external={"edge": lifting(-1e3)}).efforts["tilt"]
most = loader.model.upperEffortLimit[loader.coordinate("tilt_slide").v]
breakout = 1e3 * (most - alone) / (held - alone)
print(f"The edge breaks out with {1e-3 * breakout:.1f} kN at {1e-3 * most:.0f} kN in the cylinder.")

rolled = sp.assemble(loader, {"lift": 1.09, "tilt": 1.62}, guess=ground)
tipped = sp.assemble(loader, {"lift": 1.76, "tilt": 1.405}, guess=lift.state(-1))
for state, where in ((rolled, "rolled back at the ground"), (tipped, "tipped at the top")):
    angle = state.coordinate("boom_pin").value + state.coordinate("bucket_pin").value
    print(f"It is {where} by {np.degrees(angle):+.1f} degrees.")
sp.screenshot(lift, folder / "wheel_loader.png", row=30,
              look=sp.Look(ghosts=(ground, tipped), traces=("edge",)))
