"""The truss of von Mises: how much does it bear, when does it snap through, and where to?

    python examples/von_mises_truss.py [FOLDER]

writes snapping.png (load over height) and von_mises_truss.png (the truss at rest, and snapped).
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np

import spatial_pin as sp

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
truss = sp.load(Path(__file__).parent / "machines" / "von_mises_truss.toml")
rest = sp.equilibrium(truss)
print(f"At rest it is {rest.stiffness[0, 0]:.3f} N/m stiff.")

# the load grows: the path goes on through both limit points
loaded = sp.equilibrium_path(truss, rest.state, efforts={"cap": -1.0}, factors=(0.0, 6.0))
limit = loaded.events[0]
height = loaded.coordinate("cap").value[limit.row]
print(f"It snaps at {limit.value:.6f} N, when its cap is {1e3 * height:.3f} mm high.")
# the height is prescribed: the load that holds it there
held = sp.equilibrium_path(truss, rest.state, efforts={"cap": -1.0}, over="cap",
                           values=np.linspace(0.1, -0.12, 111))

heavy = 1.01 * limit.value
fall = sp.simulate(truss, rest.state, 2.0, efforts={"cap": -heavy})
snapped = sp.equilibrium(truss, fall.state(-1), efforts={"cap": -heavy})
print(f"With a hundredth more it falls to {1e3 * snapped.state.coordinate('cap').value:.2f} mm.")

figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for part, style in ((held.stable, "-"), (~held.stable, "--")):
    axes.plot(1e3 * held.driver, np.where(part, held.load_factor, np.nan), f"C0{style}")
axes.axhline(limit.value, color="0.7", linewidth=0.8)
axes.set(xlabel="height of the cap [mm]", ylabel="load, down [N]")
axes.invert_xaxis()
figure.savefig(folder / "snapping.png", dpi=120)
sp.screenshot(rest.state, folder / "von_mises_truss.png", look=sp.Look(ghosts=(snapped.state,)))
