"""An excavator is asked to put its teeth everywhere, and tells how near it comes and what stops it.

One point is reached in three ways: with the least motion, with the teeth as level as possible, and
with the boom where it is. Then every point of a grid in the plane of the boom is a target. From a
point that is out of reach, a line goes to the nearest place; together the lines draw the digging
range.

    python examples/digging_range.py [FOLDER]

writes range.png (the digging range, drawn by what stops it) and range.csv (the points, how far off
the teeth stay, and the joint limits that stop them).
"""

import csv
import sys
from pathlib import Path

import matplotlib
import numpy as np

import spatial_pin as sp
from spatial_pin import targets

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
mechanism = sp.load("excavator")
start = sp.assemble(mechanism)

# one point, three times: what else is wanted decides which of many configurations it is
point = np.array([6.0, 0.0, -1.0])
level = targets.direction([1, 0, 0], [-1, 0, 0], weight=1.0)  # teeth point at the machine
for title, wanted, held in [("least motion", point, ["swing"]),
                            ("level teeth", [targets.position(point), level], ["swing"]),
                            ("boom held", point, ["swing", "boom"])]:
    state = sp.reach(mechanism, {"teeth": wanted}, start, hold=held)
    lean = np.degrees(np.arccos(-state.placement("teeth").rotation[0, 0]))
    print(f"{title}: " + ", ".join(f"{name} {state.coordinate(name).value:.3f} m"
                                   for name in ("boom", "arm", "bucket"))
          + f", teeth {lean:.0f} deg from level")


def stopped(point):
    """Return the nearest place of the teeth to a point (3,), and the limits that stop them there.

    It is the nearest one from where it starts; so it starts with the boom as it is, and raised.
    """
    found = []
    for state in (start, raised):
        try:
            sp.reach(mechanism, {"teeth": point}, state, hold="swing", starts=2)
            return point, point, ()
        except sp.ReachError as error:
            nearest = error.state.placement("teeth").translation
            found.append((point, nearest, tuple(sorted(error.limits))))
    return min(found, key=lambda one: np.linalg.norm(one[1] - point))


# a grid of points, and what stops the teeth on the way there
raised = sp.assemble(mechanism, {"boom": 3.3, "arm": 2.3}, start)
rows = [stopped(np.array([x, 0.0, z]))
        for z in np.linspace(-8.5, 11.5, 21) for x in np.linspace(0.5, 11.5, 12)]
reached = np.array([point for point, _, limits in rows if not limits])
print(f"{len(reached)} of {len(rows)} points are reached")
with (folder / "range.csv").open("w", newline="") as file:
    table = csv.writer(file)
    table.writerow(["x [m]", "z [m]", "nearest x [m]", "nearest z [m]", "off [m]", "limits"])
    for point, nearest, limits in rows:
        table.writerow([*point[[0, 2]], *nearest[[0, 2]], np.linalg.norm(nearest - point),
                        " ".join(limits)])

# the machine, the points, and the ways to the nearest places by the cylinders that are at an end
figure, plot = plt.subplots(figsize=(7, 9), layout="constrained")
links = "boom", "arm", "bucket"
pins = [start.placement(name).translation for name in (*links, "teeth")]
plot.plot(*np.transpose(pins)[[0, 2]], "-o", color="#e0a000", linewidth=7, label=", ".join(links))
plot.plot(*reached.T[[0, 2]], "o", color="#b0b0b0", markersize=4, label="reached")
stops = sorted(sorted({limits for *_, limits in rows if limits}), key=len)
for limits, colour in zip(stops, plt.cm.tab10.colors, strict=False):
    name = " and ".join(limits).replace("_slide", "")
    for point, nearest, own in rows:
        if own == limits:
            plot.plot(*np.transpose([point, nearest])[[0, 2]], color=colour, linewidth=0.8)
            plot.plot(*nearest[[0, 2]], "o", color=colour, markersize=4, label=name)
            name = None
plot.axhline(0.0, color="#806040", linewidth=0.8)
plot.set(xlabel="in front of the swing [m]", ylabel="above ground [m]", aspect="equal",
         title="How near the teeth come, and which cylinders are then at an end")
figure.legend(frameon=False, ncols=3, loc="outside lower center")
figure.savefig(folder / "range.png", dpi=120)
