"""Dimensions by gradient descent in JAX: a four-bar whose rocker turns as a given function.

    python examples/descent_in_jax.py [FOLDER]

writes descent_in_jax.png: the rocker before and after. It needs pip install 'spatial_pin[jax]'.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import spatial_pin as sp

try:
    import jax
    import jax.numpy as jnp
except ImportError:
    sys.exit("this example needs JAX: pip install 'spatial_pin[jax]'")
jax.config.update("jax_enable_x64", True)  # loops are closed in float64

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
mech, names = sp.load("four_bar"), ["r2", "r3", "r4"]
outputs = sp.function(mech, ["crank", *names], ["rocker_pin"]).jax()
crank = jnp.linspace(0.4, 2.4, 12)
start = jnp.array([mech.dimensions[name] for name in names])
wanted = outputs(jnp.column_stack([crank, jnp.tile(start, (12, 1))]))[:, 0] + 0.06 * jnp.sin(crank)


@jax.jit
def error(dimensions):
    """Return the mean squared error of the rocker's angle [rad²]."""
    x = jnp.column_stack([crank, jnp.tile(dimensions, (len(crank), 1))])
    return jnp.mean((outputs(x)[:, 0] - wanted) ** 2)


slope = jax.jit(jax.value_and_grad(error))
dimensions, step = start, 1e-2
for _ in range(60):
    value, gradient = slope(dimensions)
    while error(dimensions - step * gradient) > value - 0.5 * step * gradient @ gradient:
        step /= 2.0  # a step that is too long: Armijo's rule
    dimensions, step = dimensions - step * gradient, 1.5 * step
print("".join(f"{name} {a:.4f} -> {b:.4f} m   " for name, a, b in zip(
    names, start, dimensions, strict=True)))
print(f"error {np.degrees(error(start) ** 0.5):.3f} -> {np.degrees(error(dimensions) ** 0.5):.3f} "
      "degrees rms")

figure = Figure(figsize=(6, 3.2), layout="constrained")
axes = figure.subplots()
axes.plot(np.degrees(crank), np.degrees(wanted), "ko", label="wanted")
for sizes, label in ((start, "before"), (dimensions, "after")):
    angles = outputs(jnp.column_stack([crank, jnp.tile(sizes, (12, 1))]))
    axes.plot(np.degrees(crank), np.degrees(angles[:, 0]), label=label)
axes.set(xlabel="crank [°]", ylabel="rocker [°]")
axes.legend(frameon=False)
figure.savefig(folder / "descent_in_jax.png", dpi=110)
