"""Continuation in the kernel: paths of closed configurations, through many values or to one."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.closer import Closer
from spatial_pin.kernel.kernel import Kernel, check, numbers
from spatial_pin.kernel.library import INT, POINTER, REAL, address, addresses
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTERPOLATED, Accuracy

UNCORRECTED_PART = 0.01  # of the tolerance: a prediction is left as it is; what is left grows
CLOSED_PART = 0.03  # of the tolerance, which points are closed to: the rest is their rates'
# What points of a path are closed to that samples are interpolated between, or so much of the
# tolerance and its root: second derivatives between them divide it by the square of the way, which
# grows with a root of the tolerance.
NODE_RESIDUAL, NODE_PART = 1e-13, 1e-4
FINEST = 1e-14  # residual: below it round-off decides
LEFT = 1e-11  # residual that round-off may leave where there is no closer
TIGHT = 1e-12  # of loops with redundant equations: open ones hide which of these are
IDLE_ERROR = 1e-14  # idle rotation that a step may leave at most, by estimate [rad]
IDLE_PART = 1e-3  # the same by the tolerance, where that is larger


class PathSamples(NamedTuple):
    """The path at m driver values.

    Attributes:
        q: (m, nq) configurations.
        t, c: (m, nv) first and second derivative with respect to the driver.
        error: (m,) largest closure residual.
        estimate: (m, 3) error estimates of q, t and c: the largest of any joint, by the sizes of
            coordinates.
        angles: (m, n_angles) of screw closures, counting turns [rad].
    """

    q: Array
    t: Array
    c: Array
    error: Array
    estimate: Array
    angles: Array

    @classmethod
    def empty(cls, n: int, nq: int, nv: int, n_angles: int) -> PathSamples:
        """Return arrays for n samples."""
        return cls(np.empty((n, nq)), np.empty((n, nv)), np.empty((n, nv)), np.empty(n),
                   np.empty((n, 3)), np.empty((n, n_angles)))

    def between(self, first: int, last: int) -> PathSamples:
        """Return the samples from `first` to before `last`, as views."""
        return PathSamples(*(part[first:last] for part in self))


class _AccuracyStruct(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double)
                for name in ("enough", "tolerance", "left", "idle", "between")]
    _fields_ += [(name, ctypes.c_int64) for name in ("order", "corrections")]


@cache
def asked_path(accuracy: Accuracy, has_redundant: bool, is_determined: bool) -> Any:
    """Return what is asked of a path, for C.

    Args:
        accuracy: of the path.
        has_redundant: whether its equations are some of more.
        is_determined: whether no passive freedom takes the least motion. That has no curve of its
            own, which samples could lie on: its accelerations are least by themselves.
    """
    tolerance, is_fixed = accuracy.tolerance, accuracy.corrections is not None
    loose = tolerance >= INTERPOLATED and accuracy.order == 3 and not is_fixed and is_determined
    wanted = min(tolerance, TIGHT) if has_redundant else tolerance
    closed = max(NODE_RESIDUAL, NODE_PART * tolerance**1.5) if loose else max(wanted, FINEST)
    return ctypes.byref(_AccuracyStruct(
        UNCORRECTED_PART * closed, CLOSED_PART * closed, max(LEFT, wanted, closed),
        np.inf if is_fixed else max(IDLE_ERROR, IDLE_PART * tolerance),
        tolerance if loose else 0.0, accuracy.order,
        -1 if accuracy.corrections is None else accuracy.corrections))


class PathRows(ctypes.Structure):
    """Where the arrays of `PathSamples` are, for C."""

    _fields_ = [(name, ctypes.c_void_p) for name in PathSamples._fields]


class PathTask(ctypes.Structure):
    """Where a path begins, and where its values go, for C: see `path_from_guess`."""

    _fields_ = [("n_chosen", INT), ("driven", POINTER), ("n_driven", INT), ("open", REAL),
                ("value", POINTER), ("n", INT), ("rows", PathRows)]


class Path:
    """A path over the value of one coordinate, or over a parameter that several depend on.

    It keeps a current point, which can move to any value, forwards or backwards.

    Args:
        kernel: of the mechanism; this path alone uses it as long as it is followed.
        chosen: independent closure equations; None: as many are chosen at the start as
            there are unknowns.
        driven: what is prescribed, the driver first; see `prescribed_places`.
        fill: (k, nv) rows that give passive freedoms the least motion; None: there are none.
        accuracy: tolerance and order of the predictor.
    """

    def __init__(
        self, kernel: Kernel, chosen: NDArray[np.integer[Any]] | None,
        driven: Sequence[int], fill: Array | None, accuracy: Accuracy,
    ) -> None:
        self.kernel, self._library = kernel, kernel.library
        self.n_driven, self._chooses, self.accuracy = len(driven), chosen is None, accuracy
        rows = None if chosen is None else np.ascontiguousarray(chosen, np.int64)
        n = kernel.nv - kernel.n_passive - len(driven) if rows is None else len(rows)
        self._driven = (INT * len(driven))(*driven)
        self._task = PathTask(n, ctypes.addressof(self._driven), len(driven))
        fill = None if fill is None else np.ascontiguousarray(fill, float)
        check(self._library.system_set(
            kernel.handle, None if rows is None else address(rows), n,
            self._driven, len(driven),
            None if fill is None else address(fill), 0 if fill is None else len(fill)))
        handle = ctypes.c_void_p()
        asked = asked_path(accuracy, n < kernel.n_closure, fill is None or not len(fill))
        check(self._library.path_create(kernel.handle, asked, ctypes.byref(handle)))
        self._handle = handle

    def __del__(self) -> None:
        """Free what C has allocated."""
        if hasattr(self, "_handle"):
            self._library.path_destroy(self._handle)

    def start(self, q: Array, angles: Array) -> bool:
        """Move to a closed configuration; False if it is singular, or may be.

        Args:
            q: (nq,) the configuration.
            angles: (n_angles,) of screw closures.
        """
        return not self._library.path_start(
            self._handle, *self.kernel.taken(q, angles), self._chooses)

    def from_guess(
        self, closer: Closer, widest_gap: float, values: Array, samples: PathSamples
    ) -> int:
        """Close the loops by a task that a closer has, and follow the path that begins there.

        Args:
            closer: in whose kernel it is.
            widest_gap: closure error beyond which a further start has led nowhere.
            values: (m,) of the parameter.
            samples: these are written.

        Returns:
            How many samples were reached; less than 0 where closing leaves something to choose, or
            where loops are not regular: the closer tells then what it has reached, if it is -1.
        """
        values, task = numbers(values, (len(samples.q),)), self._task
        rows = task.rows
        rows.q, rows.t, rows.c, rows.error, rows.estimate, rows.angles = addresses(samples)
        task.open, task.value, task.n = widest_gap, address(values), len(values)
        return self._library.path_from_guess(
            self._handle, closer.handle, closer.at_task, ctypes.byref(task))

    def follow(self, values: Array, samples: PathSamples) -> int:
        """Write samples at values of the parameter (m,); return how many were reached."""
        values = numbers(values, (len(samples.q),))
        rows, code = PathRows(*map(address, samples)), ctypes.c_int()
        return self._library.path_follow(
            self._handle, address(values), len(values), ctypes.byref(rows), ctypes.byref(code))

    def go(self, value: float) -> bool:
        """Move to a value of the parameter; False if it stopped at a safe point before it."""
        return not self._library.path_go(self._handle, value)

    @property
    def here(self) -> tuple[float, PathSamples]:
        """The current point, which may lie between samples: the parameter, and one sample."""
        kernel = self.kernel
        sample = PathSamples.empty(1, kernel.nq, kernel.nv, kernel.n_angles)
        row = PathRows(*map(address, sample))
        s: float = self._library.path_stand(self._handle, ctypes.byref(row))
        return s, sample

    def prescribe(self, begin: float, breaks: Array, coefficients: Array) -> None:
        """Prescribe the driven coordinates as piecewise polynomials of the parameter.

        `start` then begins at the parameter `begin`. Outside of the breaks the first and the last
        polynomial are extrapolated. At a break rates are those after it.

        Args:
            begin: the parameter where the path starts.
            breaks: (m + 1,) ends of the intervals, rising.
            coefficients: (m, k, degree + 1) of powers of the parameter less the break before it,
                rising, of all that is driven; zero of what stands still without having a value.
        """
        breaks, shape = np.ascontiguousarray(breaks, float), coefficients.shape
        coefficients = numbers(coefficients, (len(breaks) - 1, self.n_driven, shape[-1]))
        check(self._library.path_prescribe(
            self._handle, begin, shape[0], shape[-1] - 1, address(breaks), address(coefficients)))


def path_of(closer: Closer, driven: tuple[int, ...], accuracy: Accuracy) -> Path | None:
    """Return a path in a closer's kernel that chooses its equations; the last one is kept.

    None where there are other numbers of equations than of unknowns.
    """
    kernel = closer.kernel
    path: Path | None = closer.paths.get(driven)
    if path is None or path.accuracy is not accuracy:
        if not 0 <= kernel.nv - kernel.n_passive - len(driven) <= kernel.n_closure:
            return None
        path = closer.paths[driven] = Path(kernel, None, driven, None, accuracy)
    return path


def prescribed_places(
    nv: int, driven: Iterable[Coordinate], still: Iterable[int] = ()
) -> list[int]:
    """Return the kernel's indices of the prescribed coordinates.

    Args:
        nv: freedoms of the mechanism.
        driven: coordinates; those of balls and floating joints are components of a rotation
            vector, or of a position, and no entries of the velocity.
        still: places in the velocity vector that stand still.
    """
    return [c.v + nv * (c.q < 0 and not isinstance(c, VelocityEntry)) for c in driven] + [*still]
