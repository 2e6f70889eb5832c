"""A Gough platform calibrated by a laser tracker: from a millimetre off to below its noise.

The platform is not quite as drawn, its encoders are off, nobody knows where it stands, and some of
the tracker's readings are wrong. Forty measured poses give all of these; other poses show how far
off the platform was before, and is after.

    python examples/calibration.py [FOLDER]

writes calibration.png: how far the platform is from where it is meant to be, before and after.
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
rng = np.random.default_rng(1)
NOISE = {"position": 2e-5, "rotation": 1e-4}  # m, rad

drawn = sp.load("stewart")
built = sp.load("stewart", rb=0.3008, rp=0.1793, base=0.3505, platform=0.2609)
offsets = dict(zip(drawn.drivers, rng.uniform(-8e-4, 8e-4, 6), strict=True))
stands = pin.SE3(pin.exp3(np.array([0.02, -0.01, 0.7])), np.array([2.1, 0.4, -0.8]))

home = sp.assemble(built)
legs = {name: home.coordinate(driver.joint)[0] for name, driver in built.drivers.items()}


def poses(mechanism, tables, lacking):
    """Return the platform's placements along tables of legs that lack something."""
    motion = sp.follow(mechanism, {name: x + lacking.get(name, 0.0) for name, x in tables.items()})
    return [motion.state(i).placement("platform") for i in range(len(motion))]


def tables(count, shift=0.0):
    """Return what encoders read along a tour of the workspace; others have another shift."""
    t = np.linspace(0.0, 2.0 * np.pi, count)
    return {name: x + 0.02 * np.sin(3 * t + k + shift) + 0.03 * np.sin(2 * t + 2.4 * k * k)
            for k, (name, x) in enumerate(legs.items())}


read, measurements = tables(40), []
for i, at in enumerate(poses(built, read, offsets)):
    seen = stands * at
    seen = pin.SE3(seen.rotation @ pin.exp3(NOISE["rotation"] * rng.normal(size=3)),
                   seen.translation + NOISE["position"] * rng.normal(size=3))
    if i in (8, 21, 33):  # a reflector was mistaken for another
        seen.translation += rng.normal(size=3) * 5e-3
    measurements.append(({name: x[i] for name, x in read.items()}, {"platform": seen}))

found = sp.calibrate(drawn, measurements, ["rb", "rp", "base", "platform", "h"],
                     offsets=list(drawn.drivers), base=True, sigma=NOISE, loss="soft_l1")
print(found)
print("\nTaken for outliers: measurements", sorted({i for i, _ in found.outliers}))

def points(mechanism, base, lacking):
    """Return where the tracker sees the platform, along another tour."""
    return np.array([(base * at).translation for at in poses(mechanism, tables(61, 1.0), lacking)])


# as drawn, but for the place where it stands: that is known from the same readings
x = np.array([found.nominal[f"base.{name}"] for name in ("x", "y", "z", "rx", "ry", "rz")])
corrections = {name: found.values[f"{name}.offset"] for name in drawn.drivers}
true = points(built, stands, offsets)
before = points(drawn, pin.SE3(pin.exp3(x[3:]), x[:3]), {})
after = points(found.mechanism, found.base, corrections)
off = [1e6 * np.linalg.norm(x - true, axis=1) for x in (before, after)]
print(f"The platform is off by {off[0].mean():.0f} µm before, by {off[1].mean():.1f} µm after.")

figure = plt.figure(figsize=(11, 4.4), layout="constrained")
space = figure.add_subplot(1, 2, 1, projection="3d")
space.plot(*(1e3 * true).T, color="#1a1a1a", linewidth=1, label="where it is")
for x, colour, words in ((before, "#c0392b", "before"), (after, "#1f77b4", "after")):
    space.plot(*(1e3 * (true + 20 * (x - true))).T, ".", color=colour, markersize=4,
               label=f"where it is taken to be {words} (errors x 20)")
space.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
space.locator_params(nbins=5)
space.legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.06))
axes = figure.add_subplot(1, 2, 2)
axes.semilogy(off[0], color="#c0392b", label="as drawn")
axes.semilogy(off[1], color="#1f77b4", label="calibrated")
axes.axhline(1e6 * NOISE["position"], color="grey", linestyle=":", label="noise of one reading")
axes.set(xlabel="pose", ylabel="error of the platform [µm]",
         title="Poses that were not measured")
axes.legend(frameon=False)
figure.savefig(folder / "calibration.png", dpi=120)
