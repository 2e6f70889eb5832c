"""The compiled library of the kernel, loaded once."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.sources import LIBRARY, source_hash

CODES = ("done", "arrays that do not fit together", "no memory left", "a singular system",
         "not converged", "an unsafe step", "not finite")
DONE, BAD_ARRAYS, SINGULAR, UNSAFE, NOT_FINITE = 0, 1, 3, 5, 6  # of them
INT, REAL, POINTER = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
TYPES: dict[str, Any] = {"int": ctypes.c_int, "Int": INT, "Real": REAL, "void": None}
REMEDY = "install the package with pip, or run `python scripts/build_kernel.py` in its source tree"

_ENTRY = ctypes.c_double()
_NOWHERE = ctypes.addressof(_ENTRY)  # where an array without entries may begin
_view = ctypes.c_char.from_buffer  # of a tenth of the price of `array.ctypes`
_addressof = ctypes.addressof


def address(array: NDArray[Any]) -> int:
    """Return the address of a contiguous array; the caller keeps it alive."""
    if not array.size:
        return _NOWHERE
    try:
        return _addressof(_view(array))  # type: ignore[arg-type]
    except (TypeError, ValueError):
        if array.flags.writeable:  # it is not contiguous
            raise
        return int(array.ctypes.data)


def addresses(arrays: Iterable[NDArray[Any]]) -> list[int]:
    """Return the addresses of arrays for C to write: contiguous, and not read-only."""
    return [_addressof(_view(x)) if x.size else _NOWHERE for x in arrays]  # type: ignore[arg-type]


def numbers(array: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.floating[Any]]:
    """Return an array as contiguous doubles of a shape, as C reads it; copied if it is read-only.

    The address of a read-only array takes several times as long to ask for as a small copy.
    """
    out = np.ascontiguousarray(array, float)
    out = out if out.flags.writeable else out.copy()
    if out.shape != shape:
        raise ValueError(f"an array of shape {out.shape} stands where {shape} is needed")
    return out


class CStructure(ctypes.Structure):
    """A structure of C; the arrays that it points to live as long as it does."""

    @classmethod
    def of(cls, **fields: Any) -> Self:
        """Return a structure with some fields set, see `put`."""
        made = cls()
        made.put(**fields)
        return made

    def put(self, **fields: Any) -> None:
        """Set fields: numbers, structures and addresses, contiguous arrays; None: nowhere."""
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                self.__dict__[name], value = value, address(value)
            setattr(self, name, value)


def opened(path: Path) -> ctypes.CDLL:
    """Open the library of a file; its functions are declared as C declares them.

    Raises:
        SpatialPinError: if it is missing (the package was copied, not installed), if this machine
            cannot load it, or if the C files beside it are not those it was compiled from.
    """
    try:
        loaded = ctypes.CDLL(str(path))
    except OSError as error:
        raise SpatialPinError(
            f"the compiled kernel {path} cannot be loaded ({error}): {REMEDY}") from error
    now = source_hash(path.parent)
    if now and now != compiled_from(loaded):
        raise SpatialPinError(
            f"the compiled kernel {path} is older than the C files beside it: {REMEDY}")
    prototypes: Any = ctypes.pointer(ctypes.c_char_p.in_dll(loaded, "kernel_prototypes"))
    for prototype in takewhile(bool, prototypes):  # NULL behind the last
        head, _, arguments = prototype.decode().partition("(")
        *returned, name = head.split()
        function = getattr(loaded, name)
        function.restype = TYPES[returned[-1]]
        function.argtypes = [POINTER if "*" in x else TYPES.get(x.split()[-2], POINTER)
                             for x in arguments.rstrip(")").split(",")]
    return loaded


def compiled_from(loaded: ctypes.CDLL) -> str:
    """Return the hash of the C files that a library was compiled from; nothing if it has none."""
    try:
        text = (ctypes.c_char * 16).in_dll(loaded, "kernel_source_hash")
    except ValueError:
        return ""
    return text.raw.decode(errors="replace")


@cache
def library() -> ctypes.CDLL:
    """Return the compiled kernel; raises as `opened`."""
    return opened(Path(__file__).with_name(LIBRARY))


def check(code: int) -> None:
    """Raise an error for a code of the kernel that no mechanism can cause."""
    if code:
        raise SpatialPinError(f"the kernel ended with {CODES[code]}")
