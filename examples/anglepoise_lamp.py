"""A balanced lamp: what must its springs be, so that it stays wherever it is put?

    python examples/anglepoise_lamp.py [FOLDER]

writes anglepoise_lamp.png: the lamp in two of its poses.
"""

import sys
from pathlib import Path

import numpy as np

import spatial_pin as sp

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
drawn = sp.load(Path(__file__).parent / "machines" / "anglepoise_lamp.toml")

# the moment of the weights about a hinge is largest where the arm is level; a spring from high
# above the hinge to a point along the arm balances it with stiffness * high * along
level = {"lower": 0.0, "upper": 0.0}
loose = {spring.name: lambda length, rate: 0.0 for spring in drawn.springs}
weights = sp.inverse_dynamics(drawn, sp.assemble(drawn, level), laws=loose).efforts
high, along = 0.06, 0.10
wanted = {name: weights[name] / (high * along) for name in weights}
for name, stiffness in wanted.items():
    print(f"{name} arm: its weights turn with {weights[name]:.3f} N m, a spring of "
          f"{stiffness:.0f} N/m balances them")

laws = {f"{name}_spring": lambda length, rate, k=k: k * length for name, k in wanted.items()}
worst = dict.fromkeys(wanted, 0.0)
for lower in np.radians([30.0, 60.0, 90.0, 120.0]):
    for upper in np.radians([-60.0, -20.0, 20.0, 60.0]):
        state = sp.assemble(drawn, {"lower": lower, "upper": upper})
        for name, x in sp.inverse_dynamics(drawn, state, laws=laws).efforts.items():
            worst[name] = max(worst[name], abs(x))
print(f"In 16 poses all moments are below 1e-12 N m: {max(worst.values()) < 1e-12}.")

found = sp.equilibrium(drawn, sp.assemble(drawn, {"lower": 1.2, "upper": 0.3}), laws=laws)
print(f"It is {'neutral' if found.stable is None else 'not balanced'}: nothing drives back "
      f"{' and '.join(found.neutral)}.")
tired = {"upper_spring": lambda length, rate: 0.9 * wanted["upper"] * length}
held = sp.equilibrium(drawn, level, hold=["lower", "upper"], laws=laws | tired)
print(f"With an upper spring that is tired by a tenth, friction in the elbow must hold "
      f"{held.efforts['upper']:.3f} N m.")

poses = [sp.assemble(drawn, {"lower": a, "upper": b}) for a, b in ((1.9, -0.3), (0.9, 0.4))]
sp.screenshot(poses[0], folder / "anglepoise_lamp.png", look=sp.Look(ghosts=(poses[1],)))
