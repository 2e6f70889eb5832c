"""Closing loops from a guess with the least motion: the kernel's, and its last digits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.closer import Closed, closer_of
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_gradient
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

# Damped steps at most: of random starts of `delta` 57 % close in 60, 75 % in 120, so that another
# start is worth more than so many further steps.
DAMPED_STEPS = 60
NOTHING: Mapping[str, float] = MappingProxyType({})


def close(
    evaluation: LoopEquations,
    q: Array,
    free: NDArray[np.bool_],
    tolerance: float,
    iterations: int = DAMPED_STEPS,
    pinned: Mapping[str, float] = NOTHING,
    cut: float = TOLERANCES.rank,
) -> tuple[Array, float]:
    """Move the `free` velocities of q (nq,) until the loops close, with the least motion.

    Damped steps, then undamped ones of least norm down to round-off, see
    `kernel/closing/closing.c`. Where frames of closures are turned far against each other, the
    logarithms of their rotations lead first: products would lead to mirror images. Coordinates that
    are `pinned` have their values exactly: components of balls and floating joints, which no
    velocity belongs to. Singular values below `cut` times the largest move nothing: the rows are
    closed as well as the others can.

    Returns:
        The configuration and its closure error, small or not; `evaluation` is left there.

    Raises:
        SingularError: positions have grown beyond all numbers.
    """
    found = closed(evaluation.mechanism, q, free, evaluation.angle_reference, tolerance, iterations,
                   pinned, cut).q
    evaluation.update(found)
    return found, evaluation.closure_error


def closed(
    mechanism: Mechanism,
    q: Array,
    free: NDArray[np.bool_],
    reference: Array,
    tolerance: float,
    iterations: int = DAMPED_STEPS,
    pinned: Mapping[str, float] = NOTHING,
    cut: float = TOLERANCES.rank,
) -> Closed:
    """Do as `close` without an evaluation; `angle_reference` are those that it would have."""
    with closer_of(mechanism, pinned) as closer:
        return closer.close(q, free, reference, tolerance, iterations, pinned.values(), cut)


def pinned_rows(
    evaluation: LoopEquations, free: NDArray[np.bool_], pinned: Iterable[str]
) -> tuple[Array, Array]:
    """Return the closure equations over the `free` velocities, scaled, and their residual.

    Those of pinned coordinates, which stand where they should, come after them.
    """
    n, mechanism = evaluation.constraints.n_closure, evaluation.mechanism
    rows = evaluation.jacobian[:n, free]
    if not pinned:
        return rows, evaluation.residual
    more = [scaled_row(mechanism, mechanism.coordinate_table[name], evaluation.q)[free]
            for name in pinned]
    return np.vstack([rows, *more]), np.append(evaluation.residual, np.zeros(len(more)))


def scaled_row(mechanism: Mechanism, coordinate: Coordinate, q: Array) -> Array:
    """Return the derivative (nv,), in scaled velocities, of a coordinate relative to its size."""
    size = mechanism.velocity_scale
    return coordinate_gradient(mechanism, coordinate, q) * size / size[coordinate.v]
