"""Equations of closures whose derivative is zero wherever the joints stand are left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.closure_equations import evaluation_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array, null_space
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.reduction.model.building import built
from spatial_pin.reduction.model.links import open_configurations
from spatial_pin.reduction.model.model import Model


def drop_equations(model: Model) -> None:
    """Leave out equations whose derivative is zero wherever the joints are put."""
    made = built(model)
    slopes = _slopes(made)
    for closure in made.closures:
        if len(closure.frames) == 2 and not closure.joints and closure.equations is None:
            _drop_of(model, closure, slopes[closure.name])


def _drop_of(model: Model, closure: Closure, slopes: Array) -> None:
    """Leave out equations of one closure, its axes turned so that as many as can be go."""
    turn = _turn(closure, slopes)
    if turn is not None:
        model.turns[closure.name] = turn
        slopes = _slopes(built(model))[closure.name]
    needed = tuple(np.flatnonzero(np.abs(slopes).max(axis=1) > TOLERANCES.tight).tolist())
    if len(needed) == len(slopes):
        model.turns.pop(closure.name, None)
        return
    model.equations[closure.name] = needed
    gone = len(slopes) - len(needed)
    model.notes.append((
        "equations", closure.name,
        f"{gone} of {len(slopes)} hold wherever its joints stand"
        + "; nothing is left of it" * (not needed)))


def _slopes(made: Mechanism) -> dict[str, Array]:
    """Return the derivatives of the equations of every closure, side by side at some places."""
    with evaluation_of(made) as evaluation:
        jacobians = []
        for q in open_configurations(made, made.neutral):
            evaluation.update(q)
            jacobians.append(evaluation.jacobian[: evaluation.constraints.n_closure].copy())
        labels = evaluation.constraints.labels
    stacked = np.hstack(jacobians)
    return {c.name: stacked[[label.closure == c.name for label in labels]] for c in made.closures}


def _turn(closure: Closure, slopes: Array) -> NDArray[np.float64] | None:
    """Return the turn of a closure's axes that brings one into the normal of its loop's plane."""
    count = {"prismatic": 2, "cylindrical": 2, "weld": 3, "spherical": 3}.get(closure.type)
    if count is None or np.abs(slopes[:count]).max(axis=1).min() <= TOLERANCES.tight:
        return None
    normals = null_space(slopes[:count].T, TOLERANCES.closed)
    if len(normals) != 1:
        return None
    n = np.zeros(3)
    n[:count] = normals[0]
    if count == 2:  # z is the pair's own axis
        return np.column_stack([n, np.cross([0.0, 0.0, 1.0], n), [0.0, 0.0, 1.0]])
    x = np.cross(n, np.eye(3)[int(np.argmin(np.abs(n)))])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(n, x), n])

