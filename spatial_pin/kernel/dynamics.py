"""A mechanism under forces in the kernel, moved by independent coordinates."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from spatial_pin.kernel.integrating import Asking, view
from spatial_pin.kernel.kernel import Kernel, address
from spatial_pin.kernel.library import INT, POINTER, REAL, library
from spatial_pin.kernel.packing import Ints, Packed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

LOST = 20
MOST_CROSSINGS = 64  # in one step

Efforts = Callable[[float, Array, Array, Array], Array]
Spring = Callable[[int, float, float], float]
Drives = Callable[[float], Array]
Least = Callable[[float, Array, Array, Array, Array], "Array | None"]

_EFFORTS = ctypes.CFUNCTYPE(ctypes.c_int, REAL, POINTER, POINTER, POINTER, POINTER)
_SPRING = ctypes.CFUNCTYPE(ctypes.c_int, INT, REAL, REAL, POINTER)
_DRIVES = ctypes.CFUNCTYPE(ctypes.c_int, REAL, POINTER)
_LEAST = ctypes.CFUNCTYPE(ctypes.c_int, REAL, POINTER, POINTER, POINTER, POINTER, POINTER)


class _Asked(ctypes.Structure):
    """Asked in dynamics.h."""

    _fields_ = [("efforts", _EFFORTS), ("spring", _SPRING), ("drives", _DRIVES), ("least", _LEAST)]


class Run(ctypes.Structure):
    """Run in integrating.c: what many steps want, and where their samples go."""

    _fields_ = [("times", POINTER), ("n_times", INT), ("row", INT), ("q", POINTER), ("v", POINTER),
                ("a", POINTER), ("numbers", POINTER), ("efforts", POINTER), ("angles", POINTER),
                ("most", INT), ("patience", REAL), ("largest_step", REAL),
                ("largest_pivot", REAL), ("allowed", REAL), ("n_crossed", INT),
                ("crossed", REAL * MOST_CROSSINGS), ("crossed_row", INT * MOST_CROSSINGS)]


AT_END, AT_FAILURE, WORN, FULL, STIFF, CREEPING, MANY = range(7)  # why it paused


class Samples(NamedTuple):
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


class Line(NamedTuple):
    """A spring between points (3,) of two bodies, in the axes of joints of the model."""

    bodies: tuple[int, int]
    points: tuple[Array, Array]
    spring: tuple[float, float, float]
    has_law: bool


class Turn(NamedTuple):
    """A spring about a joint: its entries of q and v."""

    q: int
    v: int
    spring: tuple[float, float, float]
    has_law: bool


class Acting(NamedTuple):
    """What acts on a mechanism besides its weight.

    Attributes:
        damping, friction, slip, armature, constant: (nv,) of joints, and efforts.
        lines, turns: springs: stiffness, damping and free length, or a law.
        efforts, spring, drives: functions, where there are any.
        works: whether work done is an unknown.
        heaviest: largest inertia of a joint, by scale.
    """

    damping: Array
    friction: Array
    slip: Array
    armature: Array
    constant: Array
    lines: list[Line]
    turns: list[Turn]
    efforts: Efforts | None
    spring: Spring | None
    drives: Drives | None
    works: bool
    heaviest: float


class Held(NamedTuple):
    """Coordinates that determine the motion.

    Attributes:
        free: velocity entries that are independent.
        prescribed: velocity entries that follow laws.
        places: entries of q by velocity entry, of joints with one coordinate.
        joints: joint of the model and component by velocity entry, of the others.
        period: of the first one, in units of its scale, after which bodies may be back; 0 if none.
        spins: joint of the model and axis (3,) of bodies that spin freely.
    """

    free: Sequence[int]
    prescribed: Sequence[int]
    places: dict[int, int]
    joints: dict[int, tuple[int, int]]
    period: float
    spins: Sequence[tuple[int, Array]]


class Dynamics:
    """The equations of motion in independent coordinates.

    Args:
        mechanism: the mechanism.
        arrays: what it is made of, idle rotations left out, with its masses.
        held: its coordinates.
        acting: forces.
        least: accelerations (n,) of the free coordinates by scale, of (t, q, v, a, angles), where
            masses differ much; None where they differ too much.
        tolerance: closure residual to reach [-].

    Attributes:
        handle: of the C structure.
        n: number of unknowns.
    """

    def __init__(
        self, mechanism: Mechanism, arrays: Packed, held: Held, acting: Acting, least: Least,
        tolerance: float,
    ) -> None:
        self._kernel = kernel = Kernel(mechanism, arrays)
        self._library, self.asking = library(), Asking()
        self.nq, self.nv, self.n_angles = kernel.nq, kernel.nv, kernel.n_angles
        self.n_drives, n_free, n_spins = len(held.prescribed), len(held.free), len(held.spins)
        self.n = 2 * n_free + 4 * n_spins + acting.works
        self._asked = self._functions(acting, least, n_free)
        ints, reals = _arrays(kernel.packed, held, acting, tolerance)
        handle = ctypes.c_void_p()
        code = self._library.dynamics_create(
            kernel.handle, address(ints), len(ints), address(reals), len(reals),
            ctypes.byref(self._asked), ctypes.byref(handle))
        if code:
            raise RuntimeError(f"the kernel refuses the forces of {mechanism.name!r}: {code}")
        self.handle = handle
        weakref.finalize(self, self._library.dynamics_destroy, handle)

    def _functions(self, acting: Acting, least: Least, n_free: int) -> _Asked:
        nq, nv, na, nd, safely = (
            self.nq, self.nv, self.n_angles, self.n_drives, self.asking.safely)
        asked = _Asked()

        def efforts(t: float, q: int, v: int, angles: int, out: int) -> int:
            assert acting.efforts is not None
            view(out, nv)[:] = acting.efforts(
                t, view(q, nq).copy(), view(v, nv).copy(), view(angles, na).copy())
            return 0

        def spring(which: int, length: float, rate: float, out: int) -> int:
            assert acting.spring is not None
            view(out, 1)[0] = acting.spring(which, length, rate)
            return 0

        def drives(t: float, out: int) -> int:
            assert acting.drives is not None
            view(out, 3 * nd)[:] = acting.drives(t).ravel()
            return 0

        def lightest(t: float, q: int, v: int, a: int, angles: int, out: int) -> int:
            found = least(t, view(q, nq).copy(), view(v, nv).copy(), view(a, nv).copy(),
                          view(angles, na).copy())
            if found is None:
                return LOST
            view(out, n_free)[:] = found
            return 0

        if acting.efforts is not None:
            asked.efforts = _EFFORTS(safely(efforts))
        if acting.spring is not None:
            asked.spring = _SPRING(safely(spring))
        if acting.drives is not None:
            asked.drives = _DRIVES(safely(drives))
        asked.least = _LEAST(safely(lightest))
        return asked

    def begin(self, q: Array, angles: Array, spins: Array, chosen: Ints) -> bool:
        """Begin a chart at a closed configuration; whether its coordinates determine the motion.

        Args:
            q: (nq,) the configuration.
            angles: (n_angles,) of screw closures.
            spins: angular velocities about their lines of bodies that spin freely [rad/s].
            chosen: independent closure equations.
        """
        q, angles, spins = (np.array(x, float) for x in (q, angles, spins))
        chosen = np.array(chosen, np.int64)
        return not self._library.dynamics_begin(
            self.handle, *map(address, (q, angles, spins, chosen)), len(chosen))

    def rates(self, t: float, y: Array) -> Array:
        """Return dy/dt (n,), NaN where the loops cannot be closed."""
        y, out = np.ascontiguousarray(y, float), np.empty(self.n)
        code = self.asking.settle(self._library.dynamics_function(
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

    def room(self, n: int) -> Samples:
        """Return room for n samples."""
        return Samples(*(np.empty((n, k)) for k in (
            self.nq, self.nv, self.nv, 4, self.n_drives, self.n_angles)))

    def samples(self, times: Array, unknowns: Array) -> Samples | None:
        """Return samples at times (N,) and unknowns (N, n); None where loops cannot be closed."""
        times, unknowns = (np.ascontiguousarray(x, float) for x in (times, unknowns))
        found = self.room(len(times))
        code = self.asking.settle(self._library.dynamics_samples(
            self.handle, len(times), *map(address, (times, unknowns, *found))))
        return None if code else found

    def crossed(self, first: float, last: float) -> list[float]:
        """Return where branches cross on the way from one chart coordinate to another."""
        out = np.empty(MOST_CROSSINGS)
        n = self._library.dynamics_crossed(self.handle, first, last, address(out), len(out))
        found: list[float] = out[:n].tolist()
        return found

    def keep(self) -> float:
        """Take the present place for one to begin anew from where the way from another is lost.

        Returns:
            How many times faster than the coordinates another moves, infinite where others must be
            taken.
        """
        return float(self._library.dynamics_keep(self.handle))

    @property
    def evaluations(self) -> int:
        """How often dy/dt was evaluated."""
        return int(self._library.dynamics_evaluations(self.handle))

    @property
    def pivot(self) -> float:
        """Smallest over largest pivot of the equations at the present place."""
        return float(self._library.dynamics_pivot(self.handle))


def _arrays(pack: Packed, held: Held, acting: Acting, tolerance: float) -> tuple[Any, Array]:
    """Return what `read_arrays` in creating.c reads."""
    all_held = [*held.free, *held.prescribed]
    joints = [held.joints.get(v, (0, 0)) for v in all_held]
    lines, turns, carriers = acting.lines, acting.turns, pack.carriers
    bodies = [int(carriers[j]) for line in lines for j in line.bodies]
    points = [pack.frames[carriers[j]].T @ x for line in lines
              for j, x in zip(line.bodies, line.points, strict=True)]
    parts: list[Any] = [
        [len(held.free), len(held.prescribed), len(held.spins), len(lines), len(turns),
         acting.works],
        all_held, [held.places.get(v, -1) for v in all_held], [int(carriers[j]) for j, _ in joints],
        [c for _, c in joints], [int(carriers[j]) for j, _ in held.spins], bodies,
        [x.has_law for x in lines], [x.q for x in turns], [x.v for x in turns],
        [x.has_law for x in turns]]
    numbers: list[Any] = [
        [tolerance, acting.heaviest, held.period], acting.damping, acting.friction, acting.slip,
        acting.armature, acting.constant, [axis for _, axis in held.spins], points,
        [x.spring for x in lines], [x.spring for x in turns]]
    return (np.concatenate([np.asarray(p, np.int64).ravel() for p in parts]),
            np.concatenate([np.asarray(p, float).ravel() for p in numbers]))
