"""Samples of a motion as the samples of a mechanism, and errors that name one of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from spatial_pin.assembly.state import Samples, State, of_mechanism
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.mechanism.coordinates import require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

if TYPE_CHECKING:
    import spatial_pin as sp

# Joint coordinates that one call of the kernel computes: a tenth of a second, so that Ctrl-C is
# answered, and what it needs besides its results is bounded.
PIECE = 200_000


def is_motion(given: object) -> TypeGuard[sp.Motion]:
    """Whether an argument is a Motion, where a State may be given too."""
    return isinstance(given, Samples)


def samples_of(mechanism: Mechanism, given: State | sp.Motion) -> State | sp.Motion:
    """Return a State or a Motion as one of `mechanism`: itself, or converted from another load.

    Raises:
        SpatialPinError: it is of another mechanism, or of other dimensions; see `of_mechanism`.
    """
    if not is_motion(given):
        return of_mechanism(mechanism, given)  # type: ignore[arg-type]  # which refuses others
    require_mechanism(mechanism)
    if mechanism in (given.mechanism, given.mechanism.whole) or not len(given):
        return given
    with at_sample(0):
        own = of_mechanism(mechanism, given.state(0)).mechanism
    with kernel_of(own) as kernel:
        errors = np.concatenate([kernel.errors(given.q[rows], angles_of(given)[rows])
                                 for rows in pieces(given)])
    open_ = errors > np.maximum(TOLERANCES.nothing, 2.0 * given.closure_error)
    for row in np.flatnonzero(open_).tolist():
        with at_sample(row):
            of_mechanism(mechanism, given.state(row))
    return replace(given, mechanism=own, closure_error=errors)


def angles_of(motion: sp.Motion) -> Array:
    """Return the angles (N, n_angles) of a motion's screw closures, (N, 0) where there are none."""
    return motion.angles if motion.angles.size else np.empty((len(motion), 0))


def pieces(motion: sp.Motion) -> Iterator[slice]:
    """Yield the samples of a motion in pieces that one call of the kernel computes."""
    n = max(PIECE // max(motion.mechanism.model.nv, 1), 1)
    for first in range(0, max(len(motion), 1), n):
        yield slice(first, first + n)


@contextmanager
def at_sample(row: Any) -> Iterator[None]:
    """Let errors of the block name the sample."""
    try:
        yield
    except (SpatialPinError, ValueError) as error:
        error.args = (f"{error} (sample {row})",)
        raise
