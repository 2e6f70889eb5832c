"""Closing loops in the kernel, see `closing.c`."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.workspaces import acquired
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import Kernel, check
from spatial_pin.kernel.library import INT, POINTER, REAL, address
from spatial_pin.mechanism.equations import Cosine
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import NOT_FINITE, Array
from spatial_pin.numerics.tolerances import TOLERANCES

AGREEING = {"z": 1, "xyz": 3}  # axes that must point the same way, by `Pair.aligned`
EQUATIONS = {1: 2, 3: 3}  # of directions that say so
NAMED, HELD, TURNS = 1, 2, 4  # what is said of an entry of q; TURNS: whole turns mean nothing
AT_ONCE = 8  # starts at most that loops are closed from in one call
MOST_GROUPS = 8  # of loops that are each closed from as many further ones in it
LOOSE = TOLERANCES.nothing  # residual to which loops are closed where more is released then


class Closed(NamedTuple):
    """The result of closing loops.

    Attributes:
        q: the configuration (nq,).
        error: its closure error.
        may_be_mirrored: False if the axes that closures make parallel point the same way.
    """

    q: Array
    error: float
    may_be_mirrored: bool


class Examined(NamedTuple):
    """What a configuration is like.

    Attributes:
        error: its closure error.
        angles: (n_angles,) of screw closures, counting turns [rad].
        may_be_mirrored: as of `Closed`.
        least: of its closure equations, the columns of their derivatives made alike: the length
            of what is left of the last one that is independent, relative to the first one's.
        left_out: likewise of the longest of those that follow from others.
    """

    error: float
    angles: Array
    may_be_mirrored: bool
    least: float
    left_out: float


class Reached(NamedTuple):
    """The result of closing loops where something is named.

    Attributes:
        q: the configuration (nq,), whole turns taken off its angles.
        error, may_be_mirrored: as of `Closed`.
        distance: from what is named, but of components of balls and floating joints [rad,
            characteristic lengths].
        examined: what it is like, where one start alone has led to a closed configuration.
    """

    q: Array
    error: float
    may_be_mirrored: bool
    distance: float
    examined: Examined | None = None


class Meant(NamedTuple):
    """What configurations are judged by.

    Angles that mean the same after a whole turn are taken to where they are named, else nearest to
    zero, to half a turn rather than its negative; a turn further where only that is in the limits.
    Held ones have their values.

    Attributes:
        value: (nq,) of what is named or held; those of a ball together.
        said: (nq,) NAMED, HELD, TURNS, or several, of each; those of a ball at its first entry.
        lower, upper: (nq,) limits.
    """

    value: Array
    said: NDArray[np.int64]
    lower: Array
    upper: Array


class MeantPlaces(ctypes.Structure):
    """Where the arrays of a `Meant` are, for C."""

    _fields_ = [(name, ctypes.c_void_p) for name in Meant._fields]


class Reaching(ctypes.Structure):
    """What loops are closed with and what is found, for C: see `closer_reach`."""

    _fields_ = [
        ("m", INT), *[(name, POINTER) for name in ("q", "first", "free")], ("loose", REAL),
        ("tolerance", REAL), ("iterations", INT), ("pinned", POINTER), ("reference", POINTER),
        ("cut", REAL), ("meant", MeantPlaces), ("n_shakes", INT), ("shakes", POINTER),
        ("near", REAL), ("shaken", POINTER), ("group", POINTER),
        *[(name, POINTER) for name in ("error", "distance", "mirrored", "facts", "angle")]]


class Shakes:
    """Further starts, for where the first one does not lead near to what is named.

    Args:
        steps: (m, `AT_ONCE`, nv) joint displacements from the first start, of each of m groups of
            loops: while one is shaken the others stand.
        near: distance from what is named that is not questioned.
        group: (nv,) the group that each velocity is of.

    Attributes:
        at, at_shaken, at_group: where the displacements are, the group of each, and `group`.
    """

    def __init__(self, steps: Array, near: float, group: NDArray[np.int64]) -> None:
        self.near, self._group = near, group.copy()
        self.steps = steps.reshape(-1, len(group)).copy()
        self._shaken = np.repeat(np.arange(len(steps)), len(self.steps) // max(len(steps), 1))
        self.at, self.at_shaken, self.at_group = (
            address(x) for x in (self.steps, self._shaken, self._group))


class ClosureSettings(NamedTuple):
    """How loops are closed, whatever the values of what is held: two are the same if one object.

    Attributes:
        free, first: (nv,) velocities that may move, and may move before that, see `Closer.close`.
        tolerance, iterations, cut: see `Closer.close`.
        said, lower, upper: see `Meant`.
        shakes: further starts; None: there are none.
    """

    free: NDArray[np.bool_]
    first: NDArray[np.bool_] | None
    tolerance: float
    iterations: int
    cut: float
    said: NDArray[np.int64]
    lower: Array
    upper: Array
    shakes: Shakes | None


class Closer:
    """Closes the loops of a mechanism with some coordinates pinned; one caller at a time.

    Args:
        mechanism: the mechanism.
        pinned: names of components of balls and floating joints.

    Attributes:
        kernel: the compiled mechanism, in whose memory it works.
        handle: of the C structure.
        facts: (3,) of what was examined last: see `Examined`.
        at_task: where C reads what is to be reached.
        paths: those that begin where it closes the loops, by what is prescribed.
        knows_mirrors: whether it knows the axes of all closures that make them parallel: not of
            those of which only some equations are kept.
    """

    def __init__(self, mechanism: Mechanism, pinned: Iterable[str] = ()) -> None:
        self.kernel = kernel = Kernel(mechanism)
        self._library = kernel.library
        rotations = np.array(list(_rotations(mechanism)), np.int64).reshape(-1, 2).T.copy()
        pins = np.array([_pin(mechanism, name) for name in pinned], np.int64).reshape(-1, 4)
        self._order = np.lexsort(pins.T[::-1])  # those of one joint side by side
        pins = pins[self._order]
        handle = ctypes.c_void_p()
        check(self._library.closer_create(
            kernel.handle, address(rotations), rotations.shape[1], address(pins), len(pins),
            ctypes.byref(handle)))
        self.handle, self.paths = handle, dict[tuple[int, ...], Any]()
        self._q, self._pinned = np.empty(kernel.nq), np.empty(len(pins))
        self._first, self._free = np.empty((2, kernel.nv), np.int64)
        self._reference, self._angles = np.empty((2, kernel.n_angles))
        self.facts, self._mirrored = np.empty(3), np.empty(1, np.int64)
        rows = 1 + MOST_GROUPS * AT_ONCE
        self._starts, self._mirrors = np.empty((rows, kernel.nq)), np.empty(rows, np.int64)
        self._errors, self._distances = np.empty((2, rows))
        self._all_may_be = [1] * rows
        self._value = np.empty(kernel.nq)
        self._said = np.empty(kernel.nq, np.int64)
        self.knows_mirrors = rotations.shape[1] == sum(
            bool(c.pair.aligned) for c in mechanism.closures)
        self._at_q, self._at_first, self._at_free, *self._at, self._at_turns = (
            address(x) for x in (self._q, self._first, self._free, self._pinned, self._reference))
        meant = MeantPlaces(address(self._value), address(self._said))
        found = *map(address, (self._errors, self._mirrors, self._distances)),
        self._facts = address(self.facts), address(self._angles), address(self._mirrored)
        self._task = Reaching(
            0, address(self._starts), None, self._at_free, pinned=self._at[0],
            reference=self._at_turns, meant=meant,
            **dict(zip(("error", "mirrored", "distance"), found, strict=True)),
            facts=self._facts[0], angle=self._facts[1])
        self.at_task, self._meant = ctypes.byref(self._task), self._task.meant
        self._reached = ctypes.byref(self._meant), *found
        self._settings: ClosureSettings | None = None  # what the task is set to

    def close(
        self, q: Array, free: NDArray[np.bool_], reference: Array | float, tolerance: float,
        iterations: int, pinned: Iterable[float], cut: float,
        first: NDArray[np.bool_] | None = None,
    ) -> Closed:
        """Close the loops from q (nq,), to the least residual that is reached.

        Args:
            q: where to start.
            free: (nv,) velocities that may move.
            reference: (n_angles,) from which the angles of screws count [rad].
            tolerance: length of the residual from which steps are undamped.
            iterations: damped steps at most.
            pinned: values of the pinned coordinates, in the order of their names.
            cut: size of the equations, by the largest, below which they move nothing.
            first: (nv,) velocities that may move before that, to a residual of `LOOSE`.

        Raises:
            SingularError: positions have grown beyond all numbers.
        """
        self._q[:], self._free[:], self._settings = q, free, None
        if first is not None:
            self._first[:] = first
        if len(self._reference):
            self._reference[:] = reference
        if len(self._order):
            self._pinned[:] = np.array(list(pinned))[self._order]
        self._library.closer_close(
            self.handle, self._at_q, None if first is None else self._at_first, self._at_free,
            *self._at, self._at_turns, max(tolerance, LOOSE), tolerance, iterations, cut,
            *self._facts[::2])
        error = self.facts.item(0)
        if not math.isfinite(error):
            raise SingularError(NOT_FINITE)
        return Closed(self._q.copy(), error, not self.knows_mirrors or self._mirrored.item(0) != 0)

    def reach(
        self, q: Sequence[Array], settings: ClosureSettings, value: Array,
        reference: Array | float = 0.0, pinned: Iterable[float] = (), shaken: bool = False,
    ) -> list[Reached]:
        """Close from each of some q (nq,), `AT_ONCE` at most, by itself, as `close` does.

        Args:
            q: where to start.
            settings: how.
            value: (nq,) of what is named or held, see `Meant`.
            reference: see `close`.
            pinned: see `close`.
            shaken: close from the further starts too where a single one closes, nothing is at
                fault, and it is not near: those that lead to what is closed, but no nearer, are
                left out.

        Raises:
            SingularError: positions have grown beyond all numbers.
        """
        self.set_task(q, settings, value, reference, pinned, shaken)
        check(self._library.closer_reach(self.handle, self.at_task))
        return self.reached()

    def reached(self) -> list[Reached]:
        """Return where C has closed the loops to; raises as `reach`."""
        mirrors = self._mirrors.tolist() if self.knows_mirrors else self._all_may_be
        seen = self._examined(mirrors[0]) if self.facts.item(0) < np.inf else None
        errors = self._errors[: self._task.m].tolist()
        if not all(map(math.isfinite, errors)):
            raise SingularError(NOT_FINITE)
        return [Reached(self._starts[k].copy(), error, mirrors[k] != 0, self._distances.item(k),
                        None if k else seen) for k, error in enumerate(errors)]

    def set_task(
        self, q: Sequence[Array], settings: ClosureSettings, value: Array,
        reference: Array | float = 0.0, pinned: Iterable[float] = (), shaken: bool = False,
    ) -> None:
        """Set what C is to close, as `reach` says it."""
        task, shakes = self._task, settings.shakes
        if settings is not self._settings:  # else only values have changed
            self._free[:], self._said[:] = settings.free, settings.said
            if settings.first is not None:
                self._first[:] = settings.first
            self._limits = settings.lower, settings.upper  # the model's own, where it keeps them
            self._meant.lower, self._meant.upper = map(address, self._limits)
            task.first = None if settings.first is None else self._at_first
            task.tolerance, task.loose = settings.tolerance, max(settings.tolerance, LOOSE)
            task.iterations, task.cut, task.near = settings.iterations, settings.cut, np.inf
            if shakes is not None:
                task.near, task.shakes = shakes.near, shakes.at
                task.shaken, task.group = shakes.at_shaken, shakes.at_group
            self._settings = settings
        for row, start in enumerate(q):
            self._starts[row] = start
        if len(self._reference):
            self._reference[:] = reference
        if len(self._order):
            self._pinned[:] = np.array(list(pinned))[self._order]
        self._value[:] = value
        task.m = len(q)
        task.n_shakes = len(shakes.steps) if shaken and shakes and self.knows_mirrors else 0

    def judge(self, q: Array, reference: Array | float, meant: Meant) -> Reached:
        """Return what q (nq,) is, whole turns taken off its angles."""
        self._q[:], self._reference[:] = q, reference
        self._value[:], self._said[:], self._settings = meant.value, meant.said, None
        self._limits = meant.lower, meant.upper
        self._meant.lower, self._meant.upper = map(address, self._limits)
        self._library.closer_judge(
            self.handle, self._at_q, self._at_turns, *self._reached)
        return Reached(self._q.copy(), self._errors.item(0),
                       not self.knows_mirrors or self._mirrors.item(0) != 0,
                       self._distances.item(0))

    def examine(self, q: Array, reference: Array | float) -> Examined:
        """Return what q (nq,) is like; turns (n_angles,) are those that angles count from [rad]."""
        self._q[:], self._reference[:] = q, reference
        check(self._library.closer_examine(self.handle, self._at_q, self._at_turns, *self._facts))
        return self._examined(not self.knows_mirrors or self._mirrored.item(0) != 0)

    def _examined(self, mirrored: float) -> Examined:
        error, least, left_out = self.facts.tolist()
        angles = self._angles.copy() if self.kernel.n_angles else self._angles
        return Examined(error, angles, mirrored != 0, least, left_out)

    def descend(
        self, q: Array, free: NDArray[np.bool_], tolerance: float, iterations: int
    ) -> tuple[Array, Array]:
        """Return configurations q (m, nq) after damped steps, and the lengths of residuals (m,).

        By products alone; the angles of screws count from zero.
        """
        q, errors = np.array(q, order="C"), np.empty(len(q))
        self._free[:], self._settings = free, None
        self._library.closer_descend(self.handle, len(q), address(q), self._at_free, tolerance,
                                     iterations, address(errors))
        return q, errors


def closer_of(mechanism: Mechanism, pinned: Iterable[str] = ()) -> acquired[Closer]:
    """Acquire a closer of a mechanism with some coordinates pinned, in its initial state."""
    return acquired(mechanism, Closer, tuple(pinned))


def _rotations(mechanism: Mechanism) -> Iterator[tuple[int, int]]:
    """Yield, per closure, its first equation of directions and how many axes these align."""
    at = 0
    for closure in mechanism.closures:
        if not closure.frames:
            continue
        rows = at + np.flatnonzero([isinstance(row.first, Cosine) for row in closure.rows])
        at += closure.n_rows
        axes = AGREEING.get(closure.pair.aligned, 0)
        if axes and len(rows) == EQUATIONS[axes]:
            yield int(rows[0]), axes


def _pin(mechanism: Mechanism, name: str) -> tuple[int, int, int, int]:
    """Return first place in q and v, component, and whether it turns, of a pinned coordinate."""
    c = mechanism.coordinate_table[name]
    i = mechanism.joint_id(c.joint)
    q, v = int(mechanism.model.idx_qs[i]), int(mechanism.model.idx_vs[i])
    is_free = mechanism.model.nqs[i] == 7
    if is_free and c.component < 3:
        return q, v, c.component, 0
    return q + 3 * is_free, v + 3 * is_free, c.component % 3, 1
