"""Closing loops within joint limits: which are broken, and bounded least squares where some are."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

# Weight of the motion of drivers against open loops, where limits are looked for: it leaves loops
# open by its square, 1e-6 of a characteristic length or radian, which closing them takes away.
LEAST_MOTION = 1e-3


def violated_limit(
    mechanism: Mechanism, q: Array, entries: NDArray[np.bool_] | None = None
) -> str:
    """Return which joint limit q breaks, of some velocities (nv,), as text; empty when none."""
    for name, by in beyond_limits(mechanism, q).items():
        c = mechanism.coordinate_table[name]
        is_looked_at = entries is None or entries[c.v]
        least = 1e-9 * max(mechanism.velocity_scale[c.v], abs(q[c.q]))
        if is_looked_at and abs(by) > least:
            return f"limit of {beyond_words(mechanism, q, name)}"
    return ""


def beyond_words(mechanism: Mechanism, q: Array, name: str) -> str:
    """Return a coordinate, its value and its range."""
    c, model = mechanism.coordinate_table[name], mechanism.model
    low, high = float(model.lowerPositionLimit[c.q]), float(model.upperPositionLimit[c.q])
    return f"{name}: {q[c.q]:.6g} {c.unit} is not in [{low:.6g}, {high:.6g}]"


def within_limits(
    evaluation: LoopEquations, q: Array, free: NDArray[np.bool_], let_go: Mapping[str, float]
) -> tuple[Array, NDArray[np.bool_]]:
    """Close the loops within the joint limits by bounded least squares, nearly.

    Args:
        evaluation: of the mechanism.
        q: where to start.
        free: (nv,) the velocities that may move.
        let_go: drivers that are to go as little as possible from these values.

    Returns:
        The configuration, and the velocities that no limit stops there (nv,).
    """
    from scipy.optimize import least_squares

    mechanism, model = evaluation.mechanism, evaluation.model
    n, scale = evaluation.constraints.n_closure, mechanism.velocity_scale
    low, high = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    start = q.copy()
    for c in mechanism.coordinate_table.values():
        if c.q >= 0 and free[c.v]:
            start[c.q] = np.clip(q[c.q], model.lowerPositionLimit[c.q],
                                 model.upperPositionLimit[c.q])
            low[c.v] = model.lowerPositionLimit[c.q] - start[c.q] - 1e-12
            high[c.v] = model.upperPositionLimit[c.q] - start[c.q] + 1e-12
    gone = [mechanism.driven_coordinate(name) for name in let_go]
    pull = LEAST_MOTION * np.eye(model.nv)[[c.v for c in gone]][:, free] / scale[free]
    wanted = np.array(list(let_go.values()), dtype=float)

    def at(x: Array) -> Array:
        step = np.zeros(model.nv)
        step[free] = x
        return pin.integrate(model, start, step)

    def residual(x: Array) -> Array:
        there = at(x)
        evaluation.update(there)
        gaps = (there[[c.q for c in gone]] - wanted) / scale[[c.v for c in gone]]
        return np.concatenate([evaluation.residual, LEAST_MOTION * gaps])

    def jacobian(x: Array) -> Array:  # exact for coordinates with limits, near zero for the rest
        evaluation.update(at(x))
        return np.vstack([evaluation.jacobian[:n, free] / scale[free], pull])

    fit = least_squares(residual, np.zeros(int(free.sum())), jacobian,
                        bounds=(low[free], high[free]), x_scale=scale[free],
                        xtol=1e-15, ftol=1e-15, gtol=1e-15)
    loose = free.copy()
    loose[free] = (fit.x > low[free] + 1e-9) & (fit.x < high[free] - 1e-9)
    return at(fit.x), loose
