"""Derivatives by central differences of eighth order, to check exact ones with."""

import numpy as np

WEIGHTS = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}


def differences(f, x, sizes, step=5e-4):
    """Return derivatives (k, m) of a function of rows (N, m) at x (m,), steps by sizes (m,)."""
    columns = []
    for j, size in enumerate(sizes):
        move = np.eye(len(x))[j] * step * size
        values = f(np.array([x + k * move for k in (1, -1, 2, -2, 3, -3, 4, -4)]))
        columns.append(sum(w * (values[2 * k - 2] - values[2 * k - 1])
                           for k, w in WEIGHTS.items()) / (step * size))
    return np.stack(columns, axis=1)


def moving_function(sp, mech, outputs, dimensions=(), efforts=False):
    """Return a function of all drivers' motions and dimensions, a row x (m,), and sizes (m,)."""
    drivers = list(mech.drivers)
    last = [f"effort.{d}" if efforts else f"{d}.acceleration" for d in drivers]
    inputs = [*drivers, *(f"{d}.rate" for d in drivers), *last,
              *(f"dimension.{d}" for d in dimensions)]
    f = sp.function(mech, inputs, outputs)
    scale = np.array([mech.velocity_scale[mech.coordinate(d).v] for d in drivers])
    at = np.array([f.home.coordinate(d).value for d in drivers])
    own = np.array([mech.dimensions[d] for d in dimensions])
    x = np.concatenate([at + 0.02 * scale, 1.3 * scale, 0.7 * scale, own])
    sizes = np.concatenate([scale, scale, scale, np.where(
        own, np.abs(own), mech.characteristic_length)])
    return f, x, sizes


def far_off(f, exact, near, values, sizes):
    """Return the largest difference of derivatives (k, m), by the size of quantities of a kind.

    Of what is zero, differences have round-off alone: a tenth [rad, m, N, per s] is the least size.
    """
    kinds = [label.removesuffix(".x").removesuffix(".y").removesuffix(".z").rpartition(".")[2]
             for label in f.labels]
    worst = 0.0
    for kind in set(kinds):
        rows = [k for k, own in enumerate(kinds) if own == kind]
        size = max(np.abs(near[rows] * sizes).max(), np.abs(values[rows]).max())
        worst = max(worst, (np.abs(exact - near)[rows] * sizes).max() / max(size, 0.1))
    return worst
