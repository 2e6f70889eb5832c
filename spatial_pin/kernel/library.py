"""The compiled library of the kernel, loaded once."""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from pathlib import Path

from spatial_pin.errors import SpatialPinError

SUFFIX = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")
CODES = ("done", "arrays that do not fit together", "no memory left", "a singular system",
         "not converged", "an unsafe step", "not finite")
INT, REALS, POINTER = ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p


@cache
def library() -> ctypes.CDLL:
    """Return the compiled kernel.

    Raises:
        SpatialPinError: if it is missing: the package was copied, not installed.
    """
    path = Path(__file__).with_name(f"_kernel{SUFFIX}")
    try:
        found = ctypes.CDLL(str(path))
    except OSError as error:
        raise SpatialPinError(
            f"the compiled kernel {path} cannot be loaded ({error}): install the package with pip,"
            " or run `python scripts/build_kernel.py` in its source tree") from error
    found.kernel_destroy.restype = None
    found.kernel_destroy.argtypes = [POINTER]
    found.kernel_create.argtypes = [POINTER, INT, POINTER, INT, POINTER]
    found.kernel_set_numbers.argtypes = [POINTER, POINTER, INT]
    found.kernel_evaluate.argtypes = [POINTER] * 10
    found.kernel_integrate.argtypes = [POINTER] * 3
    found.kernel_solve.argtypes = [POINTER] * 4
    found.system_set.argtypes = [POINTER, POINTER, INT, POINTER, INT, POINTER, INT]
    return found
