"""The compiled library of the kernel, loaded once."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.sources import LIBRARY, source_hash

CODES = ("done", "arrays that do not fit together", "no memory left", "a singular system",
         "not converged", "an unsafe step", "not finite")
DONE, BAD_ARRAYS, SINGULAR, UNSAFE, NOT_FINITE = 0, 1, 3, 5, 6  # of them
INT, REAL, POINTER = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
REMEDY = "install the package with pip, or run `python scripts/build_kernel.py` in its source tree"

_ENTRY = ctypes.c_double()
_NOWHERE = ctypes.addressof(_ENTRY)  # where an array without entries may begin
_view = ctypes.c_char.from_buffer  # of a tenth of the price of `array.ctypes`
_addressof = ctypes.addressof


def address(array: NDArray[Any]) -> int:
    """Return where a contiguous array begins; the caller keeps it alive."""
    try:
        return _addressof(_view(array))  # type: ignore[arg-type]
    except (TypeError, ValueError):
        if not array.size:
            return _NOWHERE
        if array.flags.writeable:  # it is not contiguous
            raise
        return int(array.ctypes.data)


def opened(path: Path) -> ctypes.CDLL:
    """Open the library of a file.

    Raises:
        SpatialPinError: if it is missing (the package was copied, not installed), if this machine
            cannot load it, or if the C files beside it are not those it was compiled from.
    """
    try:
        found = ctypes.CDLL(str(path))
    except OSError as error:
        raise SpatialPinError(
            f"the compiled kernel {path} cannot be loaded ({error}): {REMEDY}") from error
    now = source_hash(path.parent)
    if now and now != compiled_from(found):
        raise SpatialPinError(
            f"the compiled kernel {path} is older than the C files beside it: {REMEDY}")
    return _declared(found)


def compiled_from(found: ctypes.CDLL) -> str:
    """Return the hash of the C files that a library was compiled from; nothing if it has none."""
    try:
        text = (ctypes.c_char * 16).in_dll(found, "kernel_source_hash")
    except ValueError:
        return ""
    return text.raw.decode(errors="replace")


@cache
def library() -> ctypes.CDLL:
    """Return the compiled kernel; raises as `opened`."""
    return opened(Path(__file__).with_name(LIBRARY))


def _declared(found: ctypes.CDLL) -> ctypes.CDLL:
    """Tell what the functions take, and return the library."""
    found.kernel_destroy.restype = None
    found.kernel_destroy.argtypes = [POINTER]
    found.kernel_create.argtypes = [POINTER, INT, POINTER, INT, POINTER]
    found.kernel_set_numbers.argtypes = [POINTER, POINTER, INT]
    found.kernel_evaluate.argtypes = [POINTER] * 10
    found.kernel_evaluate_all.restype = None
    found.kernel_evaluate_all.argtypes = [POINTER, INT, *[POINTER] * 4]
    found.kernel_integrate.restype = None
    found.kernel_integrate.argtypes = [POINTER, INT, POINTER, POINTER]
    found.kernel_solve.argtypes = [POINTER] * 4
    found.system_set.argtypes = [POINTER, POINTER, INT, POINTER, INT, POINTER, INT]
    found.rates_create.argtypes = [POINTER, POINTER, INT, POINTER]
    found.rates_place.argtypes = [*[POINTER] * 4, INT, POINTER, INT, POINTER]
    found.rates_solve.argtypes = [*[POINTER] * 4, INT, POINTER, INT, INT, *[POINTER] * 6]
    found.rates_columns.argtypes = [POINTER, INT, POINTER]
    found.rates_acceleration.argtypes = found.rates_answer.argtypes = [POINTER] * 4
    found.rates_jacobian.argtypes = [POINTER, INT, INT, *[POINTER] * 3]
    found.regular_beside.argtypes = [*[POINTER] * 4, INT, POINTER, INT, POINTER]
    found.closer_create.argtypes = [POINTER, POINTER, INT, POINTER, INT, POINTER]
    found.closer_close.restype = found.closer_judge.restype = found.closer_descend.restype = None
    found.closer_close.argtypes = [*[POINTER] * 6, REAL, REAL, INT, REAL, POINTER, POINTER]
    found.closer_reach.argtypes = [POINTER, POINTER]
    found.closer_judge.argtypes = [POINTER] * 7
    found.closer_examine.argtypes = [POINTER] * 6
    found.closer_descend.argtypes = [POINTER, INT, POINTER, POINTER, REAL, INT, POINTER]
    found.dimensions_close.argtypes = [POINTER, POINTER, POINTER, INT, POINTER]
    found.dimensions_evaluate.argtypes = [POINTER, POINTER, INT, *[POINTER] * 7]
    found.path_create.argtypes = [POINTER] * 3
    found.path_destroy.restype = None
    found.path_destroy.argtypes = [POINTER]
    found.path_start.argtypes = [POINTER, POINTER, POINTER, INT]
    found.path_follow.restype = INT
    found.path_follow.argtypes = [POINTER, POINTER, INT, POINTER, POINTER]
    found.path_from_guess.restype = INT
    found.path_from_guess.argtypes = [POINTER] * 4
    found.path_stand.restype = REAL
    found.path_stand.argtypes = [POINTER] * 2
    found.path_go.argtypes = [POINTER, REAL]
    found.path_prescribe.argtypes = [POINTER, REAL, INT, INT, POINTER, POINTER]
    found.kkt_create.argtypes = [POINTER, POINTER, INT, INT, INT, REAL, POINTER]
    found.kkt_accelerations.argtypes = [POINTER] * 10
    found.kkt_solve.restype, found.kkt_solve.argtypes = None, [POINTER, INT, *[POINTER] * 4]
    found.kkt_entries.restype, found.kkt_entries.argtypes = INT, [POINTER] * 4
    found.kkt_chosen.restype, found.kkt_chosen.argtypes = INT, [POINTER, POINTER]
    found.tree_create.argtypes = [POINTER] * 3
    found.tree_motion.restype, found.tree_motion.argtypes = None, [POINTER] * 8
    found.tree_jacobian.restype, found.tree_jacobian.argtypes = None, [POINTER] * 2
    found.tree_forces.restype, found.tree_forces.argtypes = None, [POINTER] * 7
    found.tree_masses.restype, found.tree_masses.argtypes = None, [POINTER] * 4
    found.tree_eliminate.argtypes = [POINTER] * 7
    found.tree_respond.restype, found.tree_respond.argtypes = REAL, [POINTER] * 3
    found.tree_accelerations.restype, found.tree_accelerations.argtypes = None, [POINTER] * 5
    _declare_dynamics(found)
    return found


def _declare_dynamics(found: ctypes.CDLL) -> None:
    found.integrator_destroy.restype, found.integrator_destroy.argtypes = None, [POINTER]
    found.dynamics_create.argtypes = [POINTER, POINTER, INT, POINTER, INT, POINTER, POINTER]
    found.dynamics_begin.argtypes = [*[POINTER] * 6, INT]
    found.dynamics_renew.argtypes = [POINTER, REAL, *[POINTER] * 3]
    found.dynamics_rates.argtypes = [POINTER, REAL, POINTER, POINTER]
    found.dynamics_place.argtypes = [POINTER, REAL, *[POINTER] * 5]
    found.dynamics_samples.argtypes = [POINTER, INT, *[POINTER] * 3]
    found.dynamics_crossed.argtypes = [POINTER, REAL, REAL, POINTER, INT]
    found.dynamics_crossed.restype = INT
    found.dynamics_keep.argtypes = found.dynamics_pivot.argtypes = [POINTER]
    found.dynamics_heaviest.argtypes = [POINTER]
    found.dynamics_free.argtypes, found.dynamics_free.restype = [POINTER] * 2, None
    found.dynamics_settle.argtypes = [POINTER, REAL, *[POINTER] * 3]
    for count in (found.dynamics_evaluations, found.dynamics_factorisations):
        count.argtypes, count.restype = [POINTER], INT
    found.dynamics_keep.restype = found.dynamics_pivot.restype = REAL
    found.dynamics_heaviest.restype = REAL
    found.integrator_create.argtypes = [INT, INT, POINTER, POINTER, REAL, POINTER, REAL, REAL,
                                        REAL, REAL, POINTER, POINTER]
    found.integrator_step.argtypes = [POINTER]
    found.integrator_between.argtypes = [POINTER, POINTER, INT, POINTER]
    found.integrator_run.argtypes = [POINTER] * 3
