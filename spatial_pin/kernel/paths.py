"""Paths of closed configurations that the kernel follows."""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.kernel import Kernel, address, check, numbers
from spatial_pin.kernel.library import library
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy

ENOUGH = 0.01  # of the tolerance at which a prediction is left as it is: what is left grows
CLOSED = 0.03  # of the tolerance, which points are closed to: what is left of it is their rates'
BETWEEN = 1e-8  # tolerance from which on samples are interpolated between points of the path,
NODES = 1e-13  # which are closed to this: second derivatives between them divide it by h²
FINEST = 1e-14  # residual: below it round-off decides
LEFT = 1e-11  # residual that round-off may leave where there is no closer
TIGHT = 1e-12  # of loops with redundant equations: open ones hide which of these are
IDLE = 1e-14  # idle rotation that a step may leave at most, by estimate [rad]
IDLE_PART = 1e-3  # the same by the tolerance, where that is larger


class Samples(NamedTuple):
    """Where a path goes at some driver values, m of them.

    Attributes:
        q: (m, nq) configurations.
        t, c: (m, nv) first and second derivative of the path by the driver.
        error: (m,) largest closure residual.
        angles: (m, n_angles) of screw closures, counting turns [rad].
    """

    q: Array
    t: Array
    c: Array
    error: Array
    angles: Array

    @classmethod
    def empty(cls, n: int, nq: int, nv: int, n_angles: int) -> Samples:
        """Return arrays for n samples."""
        return cls(np.empty((n, nq)), np.empty((n, nv)), np.empty((n, nv)), np.empty(n),
                   np.empty((n, n_angles)))

    def between(self, first: int, last: int) -> Samples:
        """Return the samples from `first` to before `last`, as views."""
        return Samples(*(part[first:last] for part in self))


class _Accuracy(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double)
                for name in ("enough", "tolerance", "left", "idle", "between")]
    _fields_ += [("order", ctypes.c_int64)]


class _Rows(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in Samples._fields]


class Path:
    """A path along which one coordinate of a mechanism changes.

    Args:
        kernel: of the mechanism; this path alone uses it as long as it is followed.
        chosen: independent closure equations.
        driven: velocity entries that are prescribed, that of the driver first.
        fill: (k, nv) rows that passive freedoms answer with the least motion.
        accuracy: tolerance and order of the predictor.
    """

    def __init__(
        self, kernel: Kernel, chosen: NDArray[np.integer[Any]], driven: Sequence[int], fill: Array,
        accuracy: Accuracy,
    ) -> None:
        self.kernel = kernel
        self._library = library()
        chosen = np.ascontiguousarray(chosen, np.int64)
        prescribed = np.array(driven, np.int64)
        fill = np.ascontiguousarray(fill, float)
        check(self._library.system_set(
            kernel.handle, address(chosen), len(chosen), address(prescribed), len(prescribed),
            address(fill), len(fill)))
        wanted = min(accuracy.tolerance, TIGHT) if len(chosen) < kernel.n_rows else (
            accuracy.tolerance)
        loose = accuracy.tolerance >= BETWEEN and accuracy.order == 3
        between = accuracy.tolerance if loose else 0.0
        closed = NODES if loose else max(wanted, FINEST)
        asked = _Accuracy(ENOUGH * closed, CLOSED * closed, max(LEFT, wanted),
                          max(IDLE, IDLE_PART * accuracy.tolerance), between, accuracy.order)
        handle = ctypes.c_void_p()
        check(self._library.path_create(kernel.handle, ctypes.byref(asked), ctypes.byref(handle)))
        self._handle = handle
        weakref.finalize(self, self._library.path_destroy, handle)

    def start(self, q: Array, angles: Array, choose: bool = False) -> bool:
        """Stand at a closed configuration; False if it is singular, or may be.

        Args:
            q: (nq,) the configuration.
            angles: (n_angles,) of screw closures.
            choose: which equations are independent, as many as were given.
        """
        q, angles = numbers(q, (self.kernel.nq,)), numbers(angles, (self.kernel.n_angles,))
        return not self._library.path_start(self._handle, address(q), address(angles), choose)

    def follow(self, values: Array, samples: Samples) -> int:
        """Write samples at driver values (m,); return how many were reached."""
        values = numbers(values, (len(samples.q),))
        rows, code = _Rows(*map(address, samples)), ctypes.c_int()
        reached: int = self._library.path_follow(
            self._handle, address(values), len(values), ctypes.byref(rows), ctypes.byref(code))
        return reached

    @property
    def stand(self) -> tuple[float, Array, Array]:
        """Driver value, configuration and angles where the path stands, between two samples too."""
        q, angles = np.empty(self.kernel.nq), np.empty(self.kernel.n_angles)
        s: float = self._library.path_stand(self._handle, address(q), address(angles))
        return s, q, angles
