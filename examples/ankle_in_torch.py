"""A torque-optimal motion of a parallel ankle, by gradient descent in PyTorch.

    python examples/ankle_in_torch.py [FOLDER]

writes ankle_in_torch.png: the torques before and after. It needs pip install 'spatial_pin[torch]'.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import spatial_pin as sp

try:
    import torch
except ImportError:
    sys.exit("this example needs PyTorch: pip install 'spatial_pin[torch]'")

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
ankle = sp.load(Path(__file__).parent / "machines" / "parallel_ankle.toml")
ends = [sp.reach(ankle, {"ankle.first": np.radians(pitch), "ankle.second": np.radians(roll)})
        for pitch, roll in ((-15.0, 0.0), (25.0, 10.0))]
a, b = (torch.tensor([s.coordinate(name).value for name in ankle.drivers], dtype=torch.float64)
        for s in ends)
torques = sp.function(
    ankle, [f"{name}{kind}" for kind in ("", ".rate", ".acceleration") for name in ankle.drivers],
    [f"effort.{name}" for name in ankle.drivers], guess=ends[0]).torch()

# motors go by polynomials of t/T: one from rest to rest, and some that are at rest at both ends
duration, n, times = 0.2, 6, np.linspace(0.0, 1.0, 17)
rise = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
bump = np.polynomial.Polynomial([0, 0, 0, 1, -3, 3, -1])
shapes = [bump * np.polynomial.Polynomial([-1, 2]) ** k for k in range(n)]
table = [[torch.tensor(np.array([p.deriv(k)(times) for p in some]).T / duration**k)
          for k in range(3)] for some in ([rise], shapes)]


def work(weights):
    """Return the torques (N, 2) of a motion, with weights (n, 2) of its shapes [rad]."""
    motion = [r * (b - a) + s @ weights for r, s in zip(*table, strict=True)]
    motion[0] = motion[0] + a
    return torques(torch.hstack(motion))


weights = torch.zeros(n, 2, dtype=torch.float64, requires_grad=True)
descent = torch.optim.Adam([weights], lr=0.04)
before = work(weights).detach()
for _ in range(40):
    descent.zero_grad()
    loss = (work(weights) ** 2).mean()
    loss.backward()
    descent.step()
after = work(weights).detach()
for label, x in (("rest to rest by the shortest polynomial", before), ("optimal", after)):
    print(f"{label:40} rms {float((x**2).mean() ** 0.5):6.3f} N m, largest "
          f"{float(x.abs().max()):6.3f} N m")

figure = Figure(figsize=(6, 3.2), layout="constrained")
axes = figure.subplots()
for x, style in ((before, "--"), (after, "-")):
    axes.plot(duration * times, x, style)
axes.set(xlabel="time [s]", ylabel="torque of each motor [N m]")
figure.savefig(folder / "ankle_in_torch.png", dpi=110)
