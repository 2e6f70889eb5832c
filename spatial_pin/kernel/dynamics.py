"""A mechanism under forces in the kernel, moved by independent coordinates."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin.kernel.integrating import LOST, Asking, view
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.library import INT, POINTER, REAL, address, library
from spatial_pin.kernel.packing import Ints, Packed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

MOST_CROSSINGS = 64  # in one step

_EFFORTS = ctypes.CFUNCTYPE(ctypes.c_int, REAL, POINTER, POINTER, POINTER, POINTER)
_SPRING = ctypes.CFUNCTYPE(ctypes.c_int, INT, REAL, REAL, POINTER)
_DRIVES = ctypes.CFUNCTYPE(ctypes.c_int, REAL, POINTER)
_LEAST = ctypes.CFUNCTYPE(ctypes.c_int, REAL, POINTER, POINTER, POINTER, POINTER, POINTER)


class _CallbackStruct(ctypes.Structure):
    """Asked in dynamics.h."""

    _fields_ = [("efforts", _EFFORTS), ("spring", _SPRING), ("drives", _DRIVES), ("least", _LEAST)]


class RunStruct(ctypes.Structure):
    """Run in running.h: what many steps want, and where their samples go."""

    _fields_ = [("times", POINTER), ("n_times", INT), ("row", INT), ("q", POINTER), ("v", POINTER),
                ("a", POINTER), ("numbers", POINTER), ("efforts", POINTER), ("angles", POINTER),
                ("most", INT), ("patience", REAL), ("largest_step", REAL),
                ("largest_pivot", REAL), ("allowed", REAL), ("n_crossed", INT),
                ("crossed", REAL * MOST_CROSSINGS), ("crossed_row", INT * MOST_CROSSINGS),
                ("looks", INT), ("n_limits", INT), ("limit_q", POINTER), ("limit_v", POINTER),
                ("limit_side", POINTER), ("limit_value", POINTER), ("limit_before", POINTER),
                ("between", REAL)]


AT_END, AT_FAILURE, NEW_COORDINATES, FULL, STIFF, CREEPING, MANY = range(7)  # why it paused
NO_SAMPLES = 9  # the same, see Pause in running.c


class SimulationSamples(NamedTuple):
    """N samples of a simulation.

    Attributes:
        q, v, a: (N, nq), (N, nv), (N, nv).
        numbers: (N, 4) closure error [-], kinetic and total energy [J], work [J].
        efforts: (N, n) of prescribed drivers [N·m, N].
        angles: (N, n_angles) of screw closures [rad].
    """

    q: Array
    v: Array
    a: Array
    numbers: Array
    efforts: Array
    angles: Array


class _SampleStruct(ctypes.Structure):
    """SampleRows in dynamics.h."""

    _fields_ = [(name, POINTER) for name in SimulationSamples._fields]


class Callbacks(NamedTuple):
    """Python functions that the equations of motion call.

    Attributes:
        efforts: joint forces (nv,) of (t, q, v, angles), where the user gave a function.
        spring: force of (number, length, rate), where springs have laws.
        drives: (n, 3) values, rates and accelerations of the prescribed coordinates, of t.
        least: scaled accelerations (n,) of the free coordinates, of (t, q, v, a, angles), where
            masses differ much; it returns None where they differ too much.
    """

    efforts: Callable[[float, Array, Array, Array], Array] | None
    spring: Callable[[int, float, float], float] | None
    drives: Callable[[float], Array] | None
    least: Callable[[float, Array, Array, Array, Array], Array | None]


class KernelDynamics:
    """The equations of motion in independent coordinates.

    Args:
        mechanism: the mechanism.
        arrays: the packed mechanism with its masses, without idle rotations.
        ints, reals: forces and prescribed drivers, as `read_arrays` in creating.c reads them.
        asked: Python functions that it calls.

    Attributes:
        handle: of the C structure.
        n: number of unknowns.
    """

    def __init__(
        self, mechanism: Mechanism, arrays: Packed, ints: Ints, reals: Array, asked: Callbacks
    ) -> None:
        self._kernel = kernel = Kernel(mechanism, arrays)
        self._library, self.asking = library(), Asking()
        self.nq, self.nv, self.n_angles = kernel.nq, kernel.nv, kernel.n_angles
        self.n_free, self.n_drives, n_spins, _, _, works, projects = ints[:7].tolist()
        self.n = (2 * self.nv if projects else 2 * self.n_free + 4 * n_spins) + works
        self._asked = self._functions(asked)
        handle = ctypes.c_void_p()
        code = self._library.dynamics_create(
            kernel.handle, address(ints), len(ints), address(reals), len(reals),
            ctypes.byref(self._asked), ctypes.byref(handle))
        if code:
            raise RuntimeError(f"the kernel refuses the forces of {mechanism.name!r}: {code}")
        self.handle = handle

    def _functions(self, asked: Callbacks) -> _CallbackStruct:
        nq, nv, na, safely = self.nq, self.nv, self.n_angles, self.asking.safely

        def efforts(t: float, q: int, v: int, angles: int, out: int) -> int:
            assert asked.efforts is not None
            view(out, nv)[:] = asked.efforts(
                t, view(q, nq).copy(), view(v, nv).copy(), view(angles, na).copy())
            return 0

        def spring(which: int, length: float, rate: float, out: int) -> int:
            assert asked.spring is not None
            view(out, 1)[0] = asked.spring(which, length, rate)
            return 0

        def drives(t: float, out: int) -> int:
            assert asked.drives is not None
            view(out, 3 * self.n_drives)[:] = asked.drives(t).ravel()
            return 0

        def lightest(t: float, q: int, v: int, a: int, angles: int, out: int) -> int:
            found = asked.least(t, view(q, nq).copy(), view(v, nv).copy(), view(a, nv).copy(),
                                view(angles, na).copy())
            if found is None:
                return LOST
            view(out, self.n_free)[:] = found
            return 0

        return _CallbackStruct(
            _EFFORTS(safely(efforts)) if asked.efforts else _EFFORTS(),
            _SPRING(safely(spring)) if asked.spring else _SPRING(),
            _DRIVES(safely(drives)) if asked.drives else _DRIVES(), _LEAST(safely(lightest)))

    def begin(
        self, q: Array, angles: Array, spins: Array, free: Sequence[int], chosen: Ints
    ) -> bool:
        """Count coordinates from a closed configuration; whether they determine the motion.

        Args:
            q: (nq,) the configuration.
            angles: (n_angles,) of screw closures.
            spins: angular velocities about their lines of bodies that spin freely [rad/s].
            free: velocity entries of the independent coordinates.
            chosen: independent closure equations.
        """
        q, angles, spins = (np.array(x, float) for x in (q, angles, spins))
        held, chosen = np.array(free, np.int64), np.array(chosen, np.int64)
        return not self._library.dynamics_begin(
            self.handle, *map(address, (q, angles, spins, held, chosen)), len(chosen))

    def renew(self, t: float, y: Array) -> tuple[list[int], Array, bool] | None:
        """Choose the best independent coordinates at y, and let them count from there.

        Returns:
            Their velocity entries, the unknowns (n,) in them, and whether nothing has changed
            (the same coordinates, none of which turns in space). None where there are none.
        """
        y, free, same = np.array(y), np.empty(self.n_free, np.int64), np.empty(1, np.int64)
        code = self.asking.settle(self._library.dynamics_renew(
            self.handle, t, *map(address, (y, free, same))))
        return None if code else (free.tolist(), y, bool(same[0]))

    def rates(self, t: float, y: Array) -> Array:
        """Return dy/dt (n,), NaN where the loops cannot be closed."""
        y, out = np.ascontiguousarray(y, float), np.empty(self.n)
        code = self.asking.settle(self._library.dynamics_rates(
            self.handle, t, address(y), address(out)))
        if code:
            out[:] = math.nan
        return out

    def place(self, t: float, y: Array) -> tuple[Array, Array, Array, float] | None:
        """Return q, v, screw angles and closure error at y; None where loops cannot be closed."""
        y, error = np.ascontiguousarray(y, float), np.empty(1)
        q, v, angles = np.empty(self.nq), np.empty(self.nv), np.empty(self.n_angles)
        code = self.asking.settle(self._library.dynamics_place(
            self.handle, t, *map(address, (y, q, v, angles, error))))
        return None if code else (q, v, angles, float(error[0]))

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
        free = np.empty(self.n_free, np.int64)
        self._library.dynamics_free(self.handle, address(free))
        return free.tolist()

    def room(self, n: int) -> SimulationSamples:
        """Return room for n samples."""
        return SimulationSamples(*(np.empty((n, k)) for k in (
            self.nq, self.nv, self.nv, 4, self.n_drives, self.n_angles)))

    def samples(self, times: Array, unknowns: Array) -> SimulationSamples | None:
        """Return samples at times (N,) and unknowns (N, n); None where loops cannot be closed."""
        times, unknowns = (np.ascontiguousarray(x, float) for x in (times, unknowns))
        found = self.room(len(times))
        code = self.asking.settle(self._library.dynamics_samples(
            self.handle, len(times), address(times), address(unknowns),
            ctypes.byref(_SampleStruct(*map(address, found)))))
        return None if code else found

    def crossed(self, first: float, last: float) -> list[float]:
        """Return the branch points between two values of the independent coordinate."""
        out = np.empty(MOST_CROSSINGS)
        n = self._library.dynamics_crossed(self.handle, first, last, address(out), len(out))
        return out[:n].tolist()

    def keep(self) -> float:
        """Keep the last configuration as one to restart from where closing from another fails.

        Returns:
            The largest speed of another coordinate relative to the independent ones; infinite where
            others must be chosen.
        """
        return float(self._library.dynamics_keep(self.handle))

    @property
    def heaviest(self) -> float:
        """The largest inertia of a joint, scaled, the others held, where it stands."""
        return float(self._library.dynamics_heaviest(self.handle))

    @property
    def evaluations(self) -> int:
        """Number of evaluations of dy/dt."""
        return int(self._library.dynamics_evaluations(self.handle))

    @property
    def factorisations(self) -> int:
        """Number of factorisations of the constraint equations."""
        return int(self._library.dynamics_factorisations(self.handle))

    @property
    def pivot(self) -> float:
        """Smallest over largest pivot of the constraint equations at the last evaluation."""
        return float(self._library.dynamics_pivot(self.handle))
