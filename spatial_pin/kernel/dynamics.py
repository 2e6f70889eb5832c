"""A mechanism under forces in the kernel, moved by independent coordinates."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence

import numpy as np

from spatial_pin.errors import SingularError
from spatial_pin.kernel.integrating import (
    LOST,
    MOST_CROSSINGS,
    CallbackErrors,
    SampleStruct,
    SimulationSamples,
    view,
)
from spatial_pin.kernel.kernel import Ints, Kernel, Packed
from spatial_pin.kernel.library import INT, POINTER, REAL, SINGULAR, address, check, library
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

_EFFORTS = ctypes.CFUNCTYPE(ctypes.c_int, REAL, POINTER, POINTER, POINTER, POINTER)
_SPRING = ctypes.CFUNCTYPE(ctypes.c_int, INT, REAL, REAL, POINTER)
_DRIVES = ctypes.CFUNCTYPE(ctypes.c_int, REAL, POINTER)
_LEAST = ctypes.CFUNCTYPE(ctypes.c_int, REAL, POINTER, POINTER, POINTER, POINTER, POINTER)


class _CallbackStruct(ctypes.Structure):
    """Callbacks in dynamics.h."""

    _fields_ = [("efforts", _EFFORTS), ("spring", _SPRING), ("drives", _DRIVES), ("least", _LEAST)]


class _StartStruct(ctypes.Structure):
    """StartingPoint in dynamics.h."""

    _fields_ = [(name, POINTER) for name in ("q", "angles", "spins", "free", "chosen")]
    _fields_ += [("n_chosen", INT)]


class _DynamicsHead(ctypes.Structure):
    """The first fields of Dynamics in dynamics.h."""

    _fields_ = [("evaluations", INT), ("crosses", INT), ("pivot", REAL), ("held", POINTER),
                ("factorisations", POINTER)]


# Functions of Python that the equations of motion call, see `KernelDynamics`.
Callbacks = tuple[
    Callable[[float, Array, Array, Array], Array] | None,
    Callable[[int, float, float], float] | None, Callable[[float], Array] | None,
    Callable[[float, Array, Array, Array, Array], Array | None]]


class KernelDynamics:
    """The equations of motion in independent coordinates.

    Args:
        mechanism: the mechanism.
        arrays: the packed mechanism with its masses, without idle rotations.
        ints, reals: forces and prescribed drivers, as `read_arrays` in creating.c reads them.
        callbacks: Python functions that it calls: joint forces (nv,) of (t, q, v, angles), where
            the user gave a function; force of a spring of (number, length, rate), where some have
            laws; (n, 3) values, rates and accelerations of the prescribed coordinates, of t; and
            scaled accelerations (n,) of the free coordinates, of (t, q, v, a, angles), where masses
            differ much, None where they differ too much.
        start: reference of the independent coordinates: closed configuration (nq,), angles of
            screw closures, angular velocities about their lines of bodies that spin freely [rad/s],
            velocity entries of the independent coordinates, independent closure equations.

    Attributes:
        handle: of the C structure.
        n: number of unknowns.

    Raises:
        SingularError: the coordinates do not determine the motion there.
    """

    def __init__(
        self, mechanism: Mechanism, arrays: Packed, ints: Ints, reals: Array,
        callbacks: Callbacks,
        start: tuple[Array, Array, Sequence[float], Sequence[int], Ints],
    ) -> None:
        self._kernel = kernel = Kernel(mechanism, arrays)
        self._library, self.errors = library(), CallbackErrors()
        self.nq, self.nv, self.n_angles = kernel.nq, kernel.nv, kernel.n_angles
        self.n_free, self.n_drives, n_spins, _, _, works, projects = ints[:7].tolist()
        self.n = (2 * self.nv if projects else 2 * self.n_free + 4 * n_spins) + works
        self._callbacks = _struct_of(
            callbacks, self.errors, self.nq, self.nv, self.n_angles, self.n_drives, self.n_free)
        given = [np.array(x, float) for x in start[:3]] + [np.array(x, np.int64) for x in start[3:]]
        handle = ctypes.c_void_p()
        code = self._library.dynamics_create(
            kernel.handle, address(ints), len(ints), address(reals), len(reals),
            ctypes.byref(self._callbacks),
            ctypes.byref(_StartStruct(*map(address, given), len(start[4]))),
            ctypes.byref(handle))
        if code == SINGULAR:
            raise SingularError(f"mechanism {mechanism.name!r}: singular configuration")
        check(code)
        self.handle, self._head = handle, _DynamicsHead.from_address(handle.value or 0)

    def renew(self, t: float, y: Array) -> tuple[list[int], Array, bool] | None:
        """Choose the best independent coordinates at y, and let them count from there.

        Returns:
            Their velocity entries, the unknowns (n,) in them, and whether nothing has changed
            (the same coordinates, and none turns in space). None where there are none.
        """
        y, free, same = np.array(y), np.empty(self.n_free, np.int64), np.empty(1, np.int64)
        code = self.errors.checked(self._library.dynamics_renew(
            self.handle, t, *map(address, (y, free, same))))
        return None if code else (free.tolist(), y, bool(same[0]))

    def rates(self, t: float, y: Array) -> Array:
        """Return dy/dt (n,), NaN where the loops cannot be closed."""
        y, out = np.ascontiguousarray(y, float), np.empty(self.n)
        code = self.errors.checked(self._library.dynamics_rates(
            self.handle, t, address(y), address(out)))
        if code:
            out[:] = math.nan
        return out

    def motion_at(self, t: float, y: Array) -> tuple[Array, Array, Array, float] | None:
        """Return q, v, screw angles and closure error at y; None where loops cannot be closed."""
        numbers = np.empty(4)
        q, v, angles = np.empty(self.nq), np.empty(self.nv), np.empty(self.n_angles)
        code = self._samples(np.array([t]), y, SampleStruct(
            address(q), address(v), numbers=address(numbers), angles=address(angles)))
        return None if code else (q, v, angles, numbers.item(0))

    def heaviest(self, t: float, y: Array) -> float:
        """Return the largest inertia of a joint at y, scaled, the others held."""
        most, other = np.zeros(1), self.room(1)
        self._samples(np.array([t]), y, SampleStruct(
            address(other.q), address(other.v), numbers=address(other.numbers),
            angles=address(other.angles), heaviest=address(most)))
        return most.item(0)

    def _samples(self, times: Array, unknowns: Array, rows: SampleStruct) -> int:
        unknowns = np.ascontiguousarray(unknowns, float)
        return self.errors.checked(self._library.dynamics_samples(
            self.handle, len(times), address(times), address(unknowns), ctypes.byref(rows)))

    def settle(self, y: Array, allowed: float) -> tuple[Array, float, int] | None:
        """Take unknowns (n,) of all joints to closed loops.

        Args:
            y: the unknowns at the end of a step; they are overwritten.
            allowed: residual that it may have left.

        Returns:
            The unknowns, the closure error before, and how many corrections it took; None where
            it was larger, or the step does not lead there as the way before.
        """
        opened, corrections = np.empty(1), np.empty(1, np.int64)
        code = self._library.dynamics_settle(
            self.handle, allowed, *map(address, (y, opened, corrections)))
        return None if code else (y, float(opened[0]), int(corrections[0]))

    @property
    def free(self) -> list[int]:
        """Velocity entries of the independent coordinates that it solves for now."""
        return list((INT * self.n_free).from_address(self._head.held)) if self.n_free else []

    def room(self, n: int) -> SimulationSamples:
        """Return room for n samples."""
        return SimulationSamples(*(np.empty((n, k)) for k in (
            self.nq, self.nv, self.nv, 4, self.n_drives, self.n_angles)))

    def samples(self, times: Array, unknowns: Array) -> SimulationSamples | None:
        """Return samples at times (N,) and unknowns (N, n); None where loops cannot be closed."""
        times, samples = np.ascontiguousarray(times, float), self.room(len(times))
        code = self._samples(times, unknowns, SampleStruct(*map(address, samples)))
        return None if code else samples

    def crossed(self, first: float, last: float) -> list[float]:
        """Return the branch points between two values of the independent coordinate."""
        out = np.empty(MOST_CROSSINGS)
        n = self._library.dynamics_crossed(self.handle, first, last, address(out), len(out))
        return out[:n].tolist()

    def save_position(self) -> float:
        """Save the last configuration, to restart from it where closing from another fails.

        Returns:
            The largest speed of another coordinate relative to the independent ones; infinite where
            others must be chosen.
        """
        return float(self._library.dynamics_save(self.handle))

    @property
    def evaluations(self) -> int:
        """Number of evaluations of dy/dt."""
        return int(self._head.evaluations)

    @property
    def factorisations(self) -> int:
        """Number of factorisations of the constraint equations."""
        return int(INT.from_address(self._head.factorisations).value)

    @property
    def pivot(self) -> float:
        """Smallest over largest pivot at the last evaluation; 1 where branch points are crossed."""
        return 1.0 if self._head.crosses else float(self._head.pivot)


def _struct_of(
    given: Callbacks, errors: CallbackErrors, nq: int, nv: int, na: int, n_drives: int, n_free: int
) -> _CallbackStruct:
    """Return functions as C calls them; what they raise goes to `errors`."""
    of_efforts, of_spring, of_drives, of_least = given

    def efforts(t: float, q: int, v: int, angles: int, out: int) -> int:
        assert of_efforts is not None
        view(out, nv)[:] = of_efforts(
            t, view(q, nq).copy(), view(v, nv).copy(), view(angles, na).copy())
        return 0

    def spring(which: int, length: float, rate: float, out: int) -> int:
        assert of_spring is not None
        view(out, 1)[0] = of_spring(which, length, rate)
        return 0

    def drives(t: float, out: int) -> int:
        assert of_drives is not None
        view(out, 3 * n_drives)[:] = of_drives(t).ravel()
        return 0

    def least(t: float, q: int, v: int, a: int, angles: int, out: int) -> int:
        accelerations = of_least(t, view(q, nq).copy(), view(v, nv).copy(),
                                    view(a, nv).copy(), view(angles, na).copy())
        if accelerations is None:
            return LOST
        view(out, n_free)[:] = accelerations
        return 0

    return _CallbackStruct(
        _EFFORTS(errors.caught(efforts)) if of_efforts else _EFFORTS(),
        _SPRING(errors.caught(spring)) if of_spring else _SPRING(),
        _DRIVES(errors.caught(drives)) if of_drives else _DRIVES(), _LEAST(errors.caught(least)))
