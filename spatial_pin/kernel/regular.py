"""Whether loops stay closed beside a configuration, in the kernel: see `regular.c`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.workspaces import acquired
from spatial_pin.kernel.kernel import Kernel, check, numbers
from spatial_pin.kernel.library import BAD_ARRAYS, DONE, UNSAFE, address
from spatial_pin.kernel.packing import packed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


class Beside(NamedTuple):
    """The end of a step from a closed configuration, on the surface of independent equations.

    Attributes:
        q: (nq,) where it is.
        is_closed: whether all other equations hold there.
    """

    q: Array
    is_closed: bool


def step_beside(
    mechanism: Mechanism, q: Array, reference: Array, rows: NDArray[np.intp], freedoms: Array
) -> Beside | None:
    """Return the end of a step in all freedoms; None where none is found.

    Args:
        mechanism: the mechanism.
        q: (nq,) closed configuration.
        reference: (n_angles,) from which the angles of screws count [rad].
        rows: independent closure equations at q.
        freedoms: (k, nv) orthonormal scaled velocities that they leave.
    """
    with acquired(mechanism, _without_idle_rotations) as kernel:
        q, reference = numbers(q, (kernel.nq,)), numbers(reference, (kernel.n_angles,))
        freedoms = numbers(freedoms, (len(freedoms), kernel.nv))
        chosen: NDArray[Any] = np.ascontiguousarray(rows, np.int64)
        there: Array = np.empty(kernel.nq)
        code = kernel.library.tangent_step(
            kernel.handle, address(q), address(reference), address(chosen), len(chosen),
            address(freedoms), len(freedoms), address(there))
    if code == BAD_ARRAYS:
        check(code)
    return Beside(there, code == DONE) if code in (DONE, UNSAFE) else None


def _without_idle_rotations(mechanism: Mechanism) -> Kernel:
    return Kernel(mechanism, packed(mechanism, False))
