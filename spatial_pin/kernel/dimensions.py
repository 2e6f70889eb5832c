"""Many mechanisms that differ in their dimensions, closed in the kernel, see `dimensions.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.closer import Closer
from spatial_pin.kernel.kernel import EvaluationStruct
from spatial_pin.kernel.library import INT, NOT_FINITE, POINTER, REAL, address, check, numbers
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES


class Numbers(NamedTuple):
    """The numbers (dimensions) of m samples.

    Attributes:
        base: (n,) the numbers of a kernel, then (3,) of each point in the axes of the kernel's
            joint that carries it.
        indices: (k,) of those that differ from sample to sample.
        varied: (m, k) their values.
    """

    base: Array
    indices: NDArray[np.int64]
    varied: Array


class ClosedSamples(NamedTuple):
    """m closed samples, and how they were closed.

    Attributes:
        q: (m, nq) configurations; angles: (m, n_angles) of screw closures [rad].
        v, a: (m, nv) joint velocities and accelerations.
        points: (m, n_points, 5, 3) position, velocity, acceleration, angular velocity and angular
            acceleration of what the points are fixed in, world axes.
        error: (m,) closure errors.
        farthest, distance: (m,) displacement from the start, of the joint that moved farthest and
            the norm of all [rad, characteristic lengths].
        sign, magnitude: (m,) of the determinant of the square system; natural logarithm.
        bend: (m,) norm of Newton's step from the end back to the start, less `distance`.
        opened: (m,) rate at which redundant equations would be violated, relative to the fastest
            joint's rate.
    """

    q: Array
    angles: Array
    v: Array
    a: Array
    points: Array
    error: Array
    farthest: Array
    distance: Array
    sign: Array
    magnitude: Array
    bend: Array
    opened: Array


class _DimensionStruct(ctypes.Structure):
    """Samples in dimensions.c."""

    _fields_ = [(name, POINTER) for name in (
        "chosen", "driven", "fill", "base", "varied_index", "varied", "free", "joint", "speed",
        "acceleration", "q", "angle", "v", "a", "point", "fact")]
    _fields_ += [(name, INT) for name in (
        "n_chosen", "n_driven", "n_fill", "n_reals", "n_varied", "n_points", "iterations")]
    _fields_ += [("tolerance", REAL), ("cut", REAL)]


class DimensionKernel:
    """Closes and evaluates samples of a mechanism that differ in their dimensions.

    One caller at a time: its kernel is not shared, as it holds the numbers of the last sample.

    Args:
        mechanism: the mechanism.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._closer = Closer(mechanism)
        self._kernel = self._closer.kernel

    def close(
        self, q: Array, angles: Array, made_of: Numbers, *, chosen: NDArray[np.intp],
        driven: list[int], fill: Array, free: NDArray[np.bool_], joints: Sequence[int],
        rates: Array | None, tolerance: float, iterations: int,
    ) -> ClosedSamples:
        """Close samples, each from its own start, and solve their rates by a square system.

        Args:
            q: (m, nq) starts.
            angles: (m, n_angles) from which those of screws count [rad].
            made_of: their numbers.
            chosen: of the square system, the independent closure equations.
            driven: the places of the drivers in the velocity vector.
            fill: (k, nv) rows that give passive freedoms the least motion.
            free: (nv,) velocities that may move to close the loops.
            joints: Pinocchio's indices of the joints that carry the points.
            rates: (2, n_driven) speeds and accelerations of the drivers; None: all stand still.
            tolerance: see `ClosureSettings`.
            iterations: damped steps at most.
        """
        kernel, m, nv = self._kernel, len(q), self._kernel.nv
        q, angles = np.array(q, order="C"), np.array(angles, order="C")
        indices, reals = np.array(made_of.indices, np.int64), kernel.packed.reals.size
        at = kernel.packed.carriers[np.array(joints, np.int64)].astype(np.int64)
        base = numbers(made_of.base, (reals + 3 * len(at),))
        varied = numbers(made_of.varied, (m, len(indices)))
        v, a, facts = np.empty((m, nv)), np.empty((m, nv)), np.empty((m, 7))
        points = np.empty((m, len(at), 5, 3))
        fill = numbers(fill, (len(fill), nv))
        equations, places, moving = (np.array(x, np.int64) for x in (chosen, driven, free))
        work = np.empty(3 * len(at) + kernel.nq + nv + kernel.n_closure + fill.size)
        speed, acceleration = (None, None) if rates is None else (
            np.ascontiguousarray(x, float) for x in rates)
        samples = _DimensionStruct(
            *(None if x is None else address(x) for x in (
                equations, places, fill, base, indices, varied, moving, at, speed, acceleration,
                q, angles, v, a, points, facts)),
            len(equations), len(places), len(fill), reals, len(indices), len(at), iterations,
            tolerance, TOLERANCES.rank)
        check(kernel.library.dimensions_close(
            kernel.handle, self._closer.handle, ctypes.byref(samples), m, address(work)))
        return ClosedSamples(q, angles, v, a, points, *facts.T)

    def evaluate(
        self, q: Array, angles: Array, made_of: Numbers, with_jacobian: bool = True
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Evaluate samples at their configurations, without closing loops.

        Args:
            q: (m, nq) configurations.
            angles: (m, n_angles) from which those of screws count [rad].
            made_of: their numbers, none of points.
            with_jacobian: whether the last two results are wanted; else these are empty.

        Returns:
            (m, n_closure) closure equations; (m, n_angles) angles of screw closures [rad];
            (m, n, 3, 3) the kernel's joints in the world, by columns, and (m, n, 3) where they are
            [m]; (m, n_closure, nv) derivatives of the equations for v / `velocity_scale`; and
            (m, 6, nv) the joint Jacobian about the world origin, by v.
        """
        kernel, m, nv = self._kernel, len(q), self._kernel.nv
        n, size = len(kernel.packed.frames), kernel.n_closure + kernel.n_passive
        q = numbers(q, (m, kernel.nq))
        angles = np.array(numbers(angles, (m, kernel.n_angles)))
        base = numbers(made_of.base, kernel.packed.reals.shape)
        indices = np.array(made_of.indices, np.int64)
        varied = numbers(made_of.varied, (m, len(indices)))
        residual, turns, translations = (
            np.empty((m, *shape)) for shape in ((kernel.n_closure,), (n, 3, 3), (n, 3)))
        k = m if with_jacobian else 0
        jacobian, linear, angular = np.empty((k, size + kernel.n_angles, nv)), *np.empty(
            (2, k, nv, 3))
        ends = [address(x) if with_jacobian else None for x in (jacobian, linear, angular)]
        code = kernel.library.kernel_evaluate(kernel.handle, ctypes.byref(EvaluationStruct(
            m, address(q), None, address(angles), address(base), len(base), len(indices),
            *map(address, (indices, varied, turns, translations, residual, angles)), *ends)))
        if code != NOT_FINITE:
            check(code)
        columns = np.concatenate([linear, angular], axis=2).transpose(0, 2, 1)
        return residual, angles, turns, translations, jacobian[:, : kernel.n_closure], columns
