"""A double wishbone in six bushings: how far do toe and camber give way, and how does the car ring?

    python examples/soft_wishbone.py [FOLDER]

writes toe_and_camber.png, soft_wishbone.png, and wheel_hop.html, a page that plays.
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np
import pinocchio as pin

import spatial_pin as sp

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
car = sp.load(Path(__file__).parent / "machines" / "soft_wishbone.toml")
HELD = ["steering", "axle"]
TYRE = car.springs[1].stiffness[2]  # N/m, upright

rest = sp.equilibrium(car, hold=HELD)
rate = 1.0 / sp.compliance(car, rest.state, "contact", hold=[*HELD, "heave"])[2, 2] - TYRE
print(f"The chassis sits {1e3 * rest.state.coordinate('heave').value:.1f} mm above its design "
      f"height; the wheel rate is {1e-3 * rate:.2f} N/mm.")

small = sp.linearize(car, rest.state, hold=HELD)
for mode, name in ((0, "bounces"), (1, "hops on its tyre")):
    print(f"It {name} at {small.frequencies[mode]:.2f} Hz, damping ratio "
          f"{small.damping_ratios[mode]:.3f}.")


def angles(motion):
    """Return toe-in and camber of the wheel [degrees] along a motion."""
    axle = motion.frame("hub").rotation[:, :, 1]
    return np.degrees([np.arctan2(axle[:, 0], axle[:, 1]), -np.arcsin(axle[:, 2])])


soft = sp.compliance(car, rest.state, "contact", hold=HELD)
figure, plots = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained", sharey=True)
loads = {"lateral force [kN]": (1, 2.5e3, 1e3), "aligning torque [N m]": (5, 150.0, 1.0)}
for axes, (name, (component, most, unit)) in zip(plots, loads.items(), strict=True):
    load = pin.Force(np.eye(6)[component])
    path = sp.equilibrium_path(car, rest.state, external={"contact": load}, hold=HELD,
                               factors=(0.0, most))
    toe, camber = turned = angles(path) - angles(path)[:, :1]
    print(f"{name} {most / unit:g}: toe {toe[-1]:+.3f}, camber {camber[-1]:+.3f} degrees; "
          f"by the compliance {np.degrees(-most * soft[5, component]):+.3f}, "
          f"{np.degrees(-most * soft[3, component]):+.3f}")
    axes.plot(path.load_factor / unit, turned.T, label=["toe-in", "camber"])
    axes.set(xlabel=name, ylabel="change [degrees]")
    axes.legend()
figure.savefig(folder / "toe_and_camber.png", dpi=120)
sp.screenshot(rest.state, folder / "soft_wishbone.png")
sp.export_html(small.shape(1, amplitude=0.02), folder / "wheel_hop.html")
