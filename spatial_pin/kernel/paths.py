"""Continuation in the kernel: paths of closed configurations, through many values or to one."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.closer import Closer
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.library import (
    BAD_ARRAYS,
    INT,
    POINTER,
    REAL,
    CStructure,
    address,
    addresses,
    check,
    numbers,
)
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTERPOLATED, Accuracy

UNCORRECTED_PART = 0.01  # of the tolerance: a prediction is left as it is; its error grows
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

    def put(self, k: int, parts: Iterable[Array | float]) -> None:
        """Write sample k, in parts in the order of the attributes."""
        for own, part in zip(self, parts, strict=True):
            own[k] = part


class Polynomials(NamedTuple):
    """Piecewise polynomials of a path's parameter, for the driven coordinates.

    Before the first break and behind the last the outer polynomials are extrapolated. At a break
    rates are those after it.

    Attributes:
        begin: the parameter where the path starts.
        breaks: (m + 1,) ends of the intervals, rising.
        coefficients: (m, k, degree + 1) of powers of the parameter less the break before it,
            rising, of all that is driven; zero of what stands still without having a value.
    """

    begin: float
    breaks: Array
    coefficients: Array


class _AccuracyStruct(ctypes.Structure):
    """PathAccuracy in following.h."""

    _fields_ = [(name, REAL) for name in ("enough", "tolerance", "left", "idle", "between")]
    _fields_ += [("order", INT), ("corrections", INT)]


class _RowsStruct(ctypes.Structure):
    """PathRows in following.h: the arrays of `PathSamples`."""

    _fields_ = [(name, POINTER) for name in PathSamples._fields]


class _PathTask(CStructure):
    """PathTask in following.h."""

    _fields_ = (
        ("chosen", POINTER), ("n_chosen", INT), ("driven", POINTER), ("n_driven", INT),
        ("fill", POINTER), ("n_fill", INT), ("accuracy", _AccuracyStruct), ("begin", REAL),
        ("n_pieces", INT), ("degree", INT), ("breaks", POINTER), ("coefficients", POINTER),
        ("open", REAL), ("s", POINTER), ("here", _RowsStruct))


class _ScatterTask(ctypes.Structure):
    """ScatterTask in following.h."""

    _fields_ = [
        ("n_rows", INT), ("n", INT), ("row", POINTER), ("parent", POINTER), ("n_values", INT),
        ("values", POINTER), ("line", POINTER), ("is_last", INT), ("rows", _RowsStruct),
        ("part", POINTER)]


class Scattered(NamedTuple):
    """Configurations at scattered values of the driven coordinates, each followed from another.

    Attributes:
        values: (n, k) of the first driven coordinates.
        parent: (n,) row that each is followed to from, along a straight line.
        samples: the rows.
        part: (n,) of its line that each has gone; 1 where the values are reached.
    """

    values: Array
    parent: NDArray[np.int64]
    samples: PathSamples
    part: Array


@cache
def path_accuracy(accuracy: Accuracy, has_redundant: bool, is_determined: bool) -> Any:
    """Return how exactly a path is followed, for C.

    Args:
        accuracy: of the path.
        has_redundant: whether its equations are some of more.
        is_determined: whether no passive freedom takes the least motion. That has no curve of its
            own, which samples could lie on: its accelerations are least by themselves.
    """
    tolerance, is_fixed = accuracy.tolerance, accuracy.corrections is not None
    loose = tolerance >= INTERPOLATED and accuracy.order == 3 and not is_fixed and is_determined
    wanted = min(tolerance, TIGHT) if has_redundant else tolerance
    node_residual = max(NODE_RESIDUAL, NODE_PART * min(tolerance, 1.0) ** 1.5)
    closed = node_residual if loose else max(wanted, FINEST)
    return _AccuracyStruct(
        UNCORRECTED_PART * closed, CLOSED_PART * closed, max(LEFT, wanted, closed),
        np.inf if is_fixed else max(IDLE_ERROR, IDLE_PART * tolerance),
        tolerance if loose else 0.0, accuracy.order,
        -1 if accuracy.corrections is None else accuracy.corrections)


class Path:
    """A path over the value of one coordinate, or over a parameter that several depend on.

    Its current point can move to any value, forwards or backwards. A kernel follows one path at a
    time; another one starts again at its current point.

    Args:
        kernel: of the mechanism.
        chosen: independent closure equations; None: as many are chosen at the start as
            there are unknowns.
        driven: prescribed coordinates, the driver first; see `prescribed_indices`.
        fill: (k, nv) rows that give passive freedoms the least motion; None: there are none.
        accuracy: tolerance and order of the predictor.
        polynomials: the driven coordinates by a parameter; None: the first one leads.
    """

    def __init__(
        self, kernel: Kernel, chosen: NDArray[np.integer[Any]] | None, driven: Sequence[int],
        fill: Array | None, accuracy: Accuracy, polynomials: Polynomials | None = None,
    ) -> None:
        self.kernel, self._library, self.accuracy = kernel, kernel.library, accuracy
        n = kernel.nv - kernel.n_passive - len(driven) if chosen is None else len(chosen)
        rows = None if chosen is None else np.ascontiguousarray(chosen, np.int64)
        at, fill = np.array(driven, np.int64), np.ascontiguousarray(
            np.empty((0, kernel.nv)) if fill is None else fill, float)
        self._here = PathSamples.empty(1, kernel.nq, kernel.nv, kernel.n_angles)
        self._s, self._value = np.empty(1), np.empty(1)
        self._token, self._here_rows = object(), _RowsStruct(*map(address, self._here))
        self._task = task = _PathTask.of(
            chosen=rows, n_chosen=n, driven=at, n_driven=len(at), fill=fill, n_fill=len(fill),
            accuracy=path_accuracy(accuracy, n < kernel.n_closure, not len(fill)), s=self._s,
            here=self._here_rows)
        if polynomials is not None:
            breaks, shape = np.array(polynomials.breaks, float), polynomials.coefficients.shape
            coefficients = numbers(
                polynomials.coefficients, (len(breaks) - 1, len(at), shape[-1]))
            task.put(begin=polynomials.begin, n_pieces=shape[0], degree=shape[-1] - 1,
                     breaks=breaks, coefficients=coefficients)
        self._at_task = ctypes.byref(task)

    def start(self, q: Array, angles: Array) -> bool:
        """Start at a closed configuration; False if it is singular, or may be.

        Args:
            q: (nq,) the configuration.
            angles: (n_angles,) of screw closures.
        """
        self.kernel.path = self._token
        code = self._library.path_start(
            self.kernel.handle, self._at_task, *self.kernel.copied_addresses(q, angles))
        if code == BAD_ARRAYS:
            check(code)
        return not code

    def from_guess(
        self, closer: Closer, widest_gap: float, values: Array, samples: PathSamples
    ) -> int:
        """Close the loops by a task that a closer has, and follow the path that starts there.

        Args:
            closer: in whose kernel it is.
            widest_gap: closure error beyond which a further start has led nowhere.
            values: (m,) of the parameter.
            samples: these are written.

        Returns:
            How many samples were reached; less than 0 where closing leaves something to choose, or
            where loops are not regular: if it is -1, `Closer.results` returns the result.
        """
        values, rows = numbers(values, (len(samples.q),)), _RowsStruct(*addresses(samples))
        self._task.open, self.kernel.path = widest_gap, self._token
        return self._library.path_from_guess(
            self.kernel.handle, self._at_task, closer.handle, closer.at_task, address(values),
            len(values), ctypes.byref(rows))

    def scatter(
        self, scattered: Scattered, rows: NDArray[np.int64], standing: Array, is_last: bool
    ) -> None:
        """Write rows of scattered values, each from its parent, or from the parent's if need be.

        The interpreter is free meanwhile: other threads may write other rows.

        Args:
            scattered: whose rows are written; a row's parent is done before.
            rows: (m,) their numbers.
            standing: (n_driven,) constant values of the other driven coordinates.
            is_last: whether unreachable rows end at the nearest configuration.
        """
        self.kernel.path, n = self._token, len(scattered.values)
        line = np.column_stack([standing, np.zeros(len(standing))])
        arrays = _RowsStruct(*addresses(scattered.samples))
        arrays.estimate = None
        task = _ScatterTask(
            n, len(rows), address(rows), address(scattered.parent), scattered.values.shape[1],
            address(scattered.values), address(line), is_last, arrays, address(scattered.part))
        check(self._library.path_scatter(self.kernel.handle, self._at_task, ctypes.byref(task)))

    def follow(self, values: Array, samples: PathSamples) -> int:
        """Write samples at values of the parameter (m,); return how many were reached."""
        values = numbers(values, (len(samples.q),))
        return self._follow(address(values), len(values), _RowsStruct(*map(address, samples)))

    def go(self, value: float) -> bool:
        """Move to a value of the parameter; False if it stopped at a safe point before it."""
        self._value[0] = value
        return self._follow(address(self._value), 1, self._here_rows) == 1

    def _follow(self, values: int, n: int, rows: _RowsStruct) -> int:
        if self.kernel.path is not self._token:  # it has followed another one since
            self._task.begin = self._s.item(0)
            if not self.start(self._here.q[0], self._here.angles[0]):
                return 0
        return self._library.path_follow(self.kernel.handle, values, n, ctypes.byref(rows))

    @property
    def here(self) -> tuple[float, PathSamples]:
        """The current point, which may lie between samples: the parameter, and one sample."""
        return self._s.item(0), PathSamples(*(part.copy() for part in self._here))


def path_of(closer: Closer, driven: tuple[int, ...], accuracy: Accuracy) -> Path | None:
    """Return a path in a closer's kernel that chooses its equations; the last one is stored.

    None where there are other numbers of equations than of unknowns.
    """
    kernel = closer.kernel
    path: Path | None = closer.paths.get(driven)
    if path is None or path.accuracy is not accuracy:
        if not 0 <= kernel.nv - kernel.n_passive - len(driven) <= kernel.n_closure:
            return None
        path = closer.paths[driven] = Path(kernel, None, driven, None, accuracy)
    return path


def prescribed_indices(
    nv: int, driven: Iterable[Coordinate], still: Iterable[int] = ()
) -> list[int]:
    """Return the kernel's indices of the prescribed coordinates.

    Args:
        nv: freedoms of the mechanism.
        driven: coordinates; those of balls and floating joints are components of a rotation
            vector, or of a position, and no entries of the velocity.
        still: indices of velocity entries that are zero.
    """
    return [c.v + nv * (c.q < 0 and not isinstance(c, VelocityEntry)) for c in driven] + [*still]
