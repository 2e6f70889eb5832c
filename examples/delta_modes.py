"""A delta robot whose gears give way: at which frequencies does its platform ring?

    python examples/delta_modes.py [FOLDER]

writes delta_modes.html, a page that plays the lowest vibration, and delta_modes.png: frequencies as
the platform goes aside.
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np

import spatial_pin as sp

matplotlib.use("Agg")
import matplotlib.pyplot as plt

GEAR = 20e3  # N m/rad at an arm, with 20 N m s/rad
folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
rigid = sp.load("delta")


def soft(state):
    """Return the robot with springs at its arms, wound so that it rests in a state."""
    efforts = sp.inverse_dynamics(rigid, state).efforts
    springs = [sp.Spring(f"gear_{name}", joint=rigid.driven_coordinate(name).name, stiffness=GEAR,
                         damping=20.0, free_angle=state.coordinate(name).value + effort / GEAR)
               for name, effort in efforts.items()]
    drivers = {name: driver.joint for name, driver in rigid.drivers.items()}
    return sp.Mechanism.from_model(
        rigid.model, rigid.closures, drivers=drivers, springs=springs,
        guess=state.q, visual_model=rigid.visual_model, name="soft delta")


home = sp.assemble(rigid)
robot = soft(home)
rest = sp.equilibrium(robot)
small = sp.linearize(robot, rest.state)
for k, (frequency, ratio) in enumerate(zip(small.frequencies, small.damping_ratios, strict=True)):
    print(f"mode {k}: {frequency:.2f} Hz, damping ratio {ratio:.4f}")
give = 1e6 * np.diag(sp.compliance(robot, rest.state, "platform"))
print(f"The platform gives way by {give[0]:.2f} µm/N sideways, {give[2]:.2f} µm/N up and down.")
sp.export_html(small.shape(0, amplitude=0.1), folder / "delta_modes.html")

middle, found = home.placement("platform").translation, []
aside = np.linspace(0.0, 0.3, 13)
for x in aside:
    state = sp.reach(rigid, {"platform.position": middle + np.array([x, 0.0, 0.0])}, home)
    machine = soft(state)
    found.append(sp.linearize(machine, sp.equilibrium(machine).state).frequencies)
print(f"Aside by {1e3 * aside[-1]:.0f} mm they are "
      + ", ".join(f"{x:.2f}" for x in found[-1]) + " Hz.")
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
axes.plot(1e3 * aside, found, label=["lowest", "second", "third"])
axes.set(xlabel="platform aside [mm]", ylabel="frequency [Hz]")
axes.legend(frameon=False)
figure.savefig(folder / "delta_modes.png", dpi=120)
