"""Closing loops in the kernel, see `closing.c`."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.vector_products import TANGENT, axis_pairs
from spatial_pin.constraints.workspaces import acquired
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.library import INT, POINTER, REAL, address, check
from spatial_pin.mechanism.equations import Cosine
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import NOT_FINITE, Array
from spatial_pin.numerics.tolerances import TOLERANCES

AGREEING = {"z": 1, "xyz": 3}  # axes that must point the same way, by `Pair.aligned`
EQUATIONS = {1: 2, 3: 3}  # of directions that say so
NAMED, FIXED, TURNS = 1, 2, 4  # kinds of an entry of q; TURNS: whole turns mean nothing
AT_ONCE = 8  # starts at most that loops are closed from in one call
MOST_GROUPS = 8  # of loops that are each closed from as many further ones in it
LOOSE = TOLERANCES.nothing  # residual to which loops are closed where more is released then
POINT, TURN, DIRECTION, DISTANCE, LINK_ANGLE, VALUE = range(6)  # kinds of targets
# How many indices and numbers a target has, see closing_parts.h.
TARGET_INTS, TARGET_REALS = 4, 18
MORE_TARGETS = 6  # rows of targets besides one for each velocity, see closing.c
KernelTarget = tuple[Sequence[int], Sequence[float]]  # kind and indices, then numbers


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
    """Properties of a configuration.

    Attributes:
        error: its closure error.
        angles: (n_angles,) of screw closures, counting turns [rad].
        may_be_mirrored: as of `Closed`.
        least: of its closure equations, the columns of their derivatives made alike: the length
            of the remainder of the last one that is independent, relative to the first one's.
        dependent: likewise of the longest of those that follow from others.
    """

    error: float
    angles: Array
    may_be_mirrored: bool
    least: float
    dependent: float


class Reached(NamedTuple):
    """The result of closing loops with named coordinates.

    Attributes:
        q: the configuration (nq,), whole turns taken off its angles.
        error, may_be_mirrored: as of `Closed`.
        distance: from the named values, but of components of balls and floating joints [rad,
            characteristic lengths].
        examined: what it is like, where one start alone has led to a closed configuration.
        is_unique: whether it is certain that no other closed configuration is as near to its start.
    """

    q: Array
    error: float
    may_be_mirrored: bool
    distance: float
    examined: Examined | None = None
    is_unique: bool = False


class NamedCoordinates(NamedTuple):
    """Values that configurations are compared with, and to which their angles are unwrapped.

    An angle that means the same after a whole turn is taken to where it is named, else nearest to
    zero, to half a turn rather than its negative; a turn further where only that is in the limits.
    Fixed ones have their values.

    Attributes:
        value: (nq,) of named or fixed entries; those of a ball together.
        kinds: (nq,) NAMED, FIXED, TURNS, or several, of each; those of a ball at its first entry.
        lower, upper: (nq,) limits.
    """

    value: Array
    kinds: NDArray[np.int64]
    lower: Array
    upper: Array


class NamedStruct(ctypes.Structure):
    """Named in closing_parts.h: the arrays of `NamedCoordinates`."""

    _fields_ = [(name, POINTER) for name in NamedCoordinates._fields]


class TargetsStruct(ctypes.Structure):
    """Targets in closing_parts.h: where frames and coordinates are wanted."""

    _fields_ = [("n", INT), ("of", POINTER), ("number", POINTER), ("size", REAL)]


class ClosureTask(ctypes.Structure):
    """ClosureTask in closing.h: what loops are closed with, and the result."""

    _fields_ = [
        ("m", INT), *[(name, POINTER) for name in ("q", "first", "free")], ("loose", REAL),
        ("tolerance", REAL), ("iterations", INT), ("pinned", POINTER), ("reference", POINTER),
        ("cut", REAL), ("named", NamedStruct), ("n_steps", INT), ("steps", POINTER),
        ("near", REAL), ("moved", POINTER), ("group", POINTER),
        *[(name, POINTER) for name in ("error", "distance", "mirrored", "facts", "angle")],
        ("targets", TargetsStruct), ("unique", INT)]


class PerturbedStarts:
    """Further starts, if the first one does not lead near the named values.

    Args:
        steps: (m, `AT_ONCE`, nv) joint displacements from the first start, of each of m groups of
            loops: while one is displaced the others stand.
        near: a distance from the named values that is accepted.
        group: (nv,) the group that each velocity is of.
    """

    def __init__(self, steps: Array, near: float, group: NDArray[np.int64]) -> None:
        self.near, self.steps = near, steps.reshape(-1, len(group)).copy()
        moved = np.repeat(np.arange(len(steps)), len(self.steps) // max(len(steps), 1))
        self._alive = moved, group.copy()  # as long as C reads them
        self.addresses = address(self.steps), *map(address, self._alive)


class ClosureSettings(NamedTuple):
    """Settings of closing loops, without the values of fixed coordinates; compared by identity.

    Attributes:
        free, first: (nv,) velocities that may move, and may move before that, see `Closer.close`.
        tolerance, iterations, cut: see `Closer.close`.
        kinds, lower, upper: see `NamedCoordinates`.
        perturbed: perturbed starts; None: there are none.
        are_all_named: whether the start names all that may move.
    """

    free: NDArray[np.bool_]
    first: NDArray[np.bool_] | None
    tolerance: float
    iterations: int
    cut: float
    kinds: NDArray[np.int64]
    lower: Array
    upper: Array
    perturbed: PerturbedStarts | None
    are_all_named: bool = False


class Closer:
    """Closes the loops of a mechanism with some coordinates pinned; one caller at a time.

    Args:
        mechanism: the mechanism.
        pinned: names of components of balls and floating joints.

    Attributes:
        kernel: the compiled mechanism, in whose memory it works.
        handle: of the C structure.
        at_task: address of the task.
        paths: those that start where it closes the loops, by prescribed coordinates.
    """

    def __init__(self, mechanism: Mechanism, pinned: Iterable[str] = ()) -> None:
        self.kernel = kernel = Kernel(mechanism)
        self._library = kernel.library
        turning = dict(_rotations(mechanism))
        self._has_tangents = any(c.pair.aligned == TANGENT for c in mechanism.closures)
        rotations = np.array([*turning.values()], np.int64).reshape(-1, 2).T.copy()
        pins = np.array([_pin(mechanism, name) for name in pinned], np.int64).reshape(-1, 4)
        self._order = np.lexsort(pins.T[::-1])  # those of one joint side by side
        pins = pins[self._order]
        body, axis = self._axes([
            ends for name, ends in axis_pairs(mechanism) if name not in turning])
        handle = ctypes.c_void_p()
        check(self._library.closer_create(
            kernel.handle, address(rotations), rotations.shape[1], address(pins), len(pins),
            address(body), address(axis), len(body) // 2, ctypes.byref(handle)))
        self.handle, self.paths = handle, dict[tuple[int, ...], Any]()
        rows = 1 + MOST_GROUPS * AT_ONCE
        self._q, self._value = np.empty((rows, kernel.nq)), np.empty(kernel.nq)
        self._kinds, self._mirrored = np.empty(kernel.nq, np.int64), np.empty(rows, np.int64)
        self._first, self._free = np.empty((2, kernel.nv), np.int64)
        self._reference, self._angles = np.empty((2, kernel.n_angles))
        self._pinned, self._facts = np.empty(len(pins)), np.empty(4)
        self._errors, self._distances = np.empty((2, rows))
        self._of = np.zeros((kernel.nv + MORE_TARGETS, TARGET_INTS), np.int64)
        self._number = np.zeros((len(self._of), TARGET_REALS))
        self._at_value, self._at_kinds, self._at_first, self._at_facts, self._at_angles = map(
            address, (self._value, self._kinds, self._first, self._facts, self._angles))
        self._task = ClosureTask(
            0, address(self._q), None, address(self._free), pinned=address(self._pinned),
            reference=address(self._reference), error=address(self._errors),
            distance=address(self._distances), mirrored=address(self._mirrored),
            angle=self._at_angles, targets=TargetsStruct(
                0, address(self._of), address(self._number), mechanism.characteristic_length))
        self.at_task = ctypes.byref(self._task)
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
        task, self._settings = self._task, None
        self._set_method(free, first, tolerance, iterations, cut)
        self._set_values(reference, pinned)
        self._q[0], task.m, task.n_steps, task.facts = q, 1, 0, None
        task.named.value = None
        check(self._library.closer_close(self.handle, self.at_task))
        error = self._errors.item(0)
        if not math.isfinite(error):
            raise SingularError(NOT_FINITE)
        return Closed(self._q[0].copy(), error, self._may_be_mirrored)

    def prepared(
        self, q: Array, reference: Array, free: NDArray[np.bool_], tolerance: float,
        iterations: int, cut: float,
    ) -> Callable[[], float]:
        """Return what closes the loops from q (nq,), into q, and returns the closure error.

        Nothing is pinned; `q` and `reference` are read when it is called. Else as `close`.

        Raises:
            SingularError: when it is called, as `close`.
        """
        moving, error, mirrored = free.astype(np.int64), np.zeros(1), np.zeros(1, np.int64)
        given = q, reference, moving, error, mirrored
        task = ClosureTask(
            1, address(q), None, address(moving), max(tolerance, LOOSE), tolerance, iterations,
            None, address(reference), cut, error=address(error), distance=address(self._distances),
            mirrored=address(mirrored), angle=self._at_angles, targets=self._task.targets)
        at_task = ctypes.byref(task)

        def work(alive: Any = given) -> float:
            check(self._library.closer_close(self.handle, at_task))
            if not math.isfinite(error.item(0)):
                raise SingularError(NOT_FINITE)
            return error.item(0)

        return work

    def meet(
        self, q: Array, free: NDArray[np.bool_], reference: Array, targets: Sequence[KernelTarget],
        iterations: int,
    ) -> tuple[Closed, float, Array] | None:
        """Close the loops from q (nq,) where targets are met, by the least displacement.

        Args:
            q: where to start.
            free: (nv,) velocities that may move.
            reference: (n_angles,) from which the angles of screws count [rad].
            targets: the targets to meet.
            iterations: damped steps at most.

        Returns:
            The configuration, the length of the targets' residuals, and the angles (n_angles,) of
            screws, counting turns [rad]. None where there are more targets than it takes, where
            they are not met from there, or only just at the end of their reach.
        """
        if len(targets) > len(self._of):
            return None
        task, self._settings = self._task, None
        for row, (of, number) in enumerate(targets):
            self._of[row], self._number[row, : len(number)] = of, number
        self._set_method(free, None, TOLERANCES.round_off, iterations, TOLERANCES.rank)
        self._set_values(reference, ())
        self._q[0], task.m, task.n_steps, task.facts = q, 1, 0, None
        task.named.value, task.targets.n = None, len(targets)
        code = self._library.closer_close(self.handle, self.at_task)
        task.targets.n = 0
        return None if code else (
            Closed(self._q[0], self._errors.item(0), self._may_be_mirrored),
            self._distances.item(0), self._angles)

    def _axes(
        self, pairs: Sequence[Sequence[tuple[int, Array]]]
    ) -> tuple[NDArray[np.int64], Array]:
        """Return the joints and axes of pairs of parallel axes, for C."""
        known, body, axis = self.kernel.packed, list[int](), list[Array]()
        for ends in pairs:
            carriers = [int(known.carriers[joint]) for joint, _ in ends]
            one, two = (known.frames[i].T @ axes
                        for i, (_, axes) in zip(carriers, ends, strict=True))
            for column in range(one.shape[1]):
                body += carriers
                axis += [one[:, column], two[:, column]]
        return np.array(body, np.int64), np.array(axis)

    def reach(
        self, q: Sequence[Array], settings: ClosureSettings, value: Array,
        reference: Array | float = 0.0, pinned: Iterable[float] = (), perturbed: bool = False,
    ) -> list[Reached]:
        """Close from each of some q (nq,), `AT_ONCE` at most, by itself, as `close` does.

        Args:
            q: where to start.
            settings: how.
            value: (nq,) of named or fixed entries, see `NamedCoordinates`.
            reference: see `close`.
            pinned: see `close`.
            perturbed: close from the perturbed starts too where a single one closes, nothing is at
                fault, and it is not near: closed results that are no nearer are omitted.

        Raises:
            SingularError: positions have grown beyond all numbers.
        """
        self.set_task(q, settings, value, reference, pinned, perturbed)
        check(self._library.closer_close(self.handle, self.at_task))
        return self.reached()

    def reached(self) -> list[Reached]:
        """Return where C has closed the loops to; raises as `reach`."""
        mirrored = [x or self._has_tangents for x in self._mirrored.tolist()]
        examined = self._examined(mirrored[0] != 0) if self._facts.item(0) < np.inf else None
        errors = self._errors[: self._task.m].tolist()
        if not all(map(math.isfinite, errors)):
            raise SingularError(NOT_FINITE)
        return [Reached(self._q[k].copy(), error, mirrored[k] != 0, self._distances.item(k),
                        None if k else examined, not k and bool(self._task.unique))
                for k, error in enumerate(errors)]

    def set_task(
        self, q: Sequence[Array], settings: ClosureSettings, value: Array,
        reference: Array | float = 0.0, pinned: Iterable[float] = (), perturbed: bool = False,
    ) -> None:
        """Set the task of the kernel, see `reach`."""
        task, starts = self._task, settings.perturbed
        if settings is not self._settings:  # else only values have changed
            self._set_method(settings.free, settings.first, settings.tolerance,
                             settings.iterations, settings.cut)
            self._name(value, settings.kinds, settings.lower, settings.upper)
            task.facts, task.near = self._at_facts, np.inf
            if starts is not None:
                task.near, (task.steps, task.moved, task.group) = starts.near, starts.addresses
            self._settings = settings
        self._set_values(reference, pinned)
        for row, start in enumerate(q):
            self._q[row] = start
        self._value[:] = value
        task.m = len(q)
        task.n_steps = len(starts.steps) if perturbed and starts else 0
        task.unique = settings.are_all_named

    def _set_method(
        self, free: NDArray[np.bool_], first: NDArray[np.bool_] | None, tolerance: float,
        iterations: int, cut: float,
    ) -> None:
        task = self._task
        self._free[:] = free
        if first is not None:
            self._first[:] = first
        task.first = None if first is None else self._at_first
        task.tolerance, task.loose = tolerance, max(tolerance, LOOSE)
        task.iterations, task.cut = iterations, cut

    def _set_values(self, reference: Array | float, pinned: Iterable[float]) -> None:
        if len(self._reference):
            self._reference[:] = reference
        if len(self._order):
            self._pinned[:] = np.array(list(pinned))[self._order]

    def _name(
        self, value: Array, kinds: NDArray[np.int64], lower: Array, upper: Array
    ) -> None:
        self._value[:], self._kinds[:] = value, kinds
        self._limits = lower, upper  # as long as C reads them
        named = self._task.named
        named.value, named.kinds = self._at_value, self._at_kinds
        named.lower, named.upper = map(address, self._limits)

    def judge(self, q: Array, reference: Array | float, named: NamedCoordinates) -> Reached:
        """Return q (nq,), whole turns taken off its angles, and its properties."""
        self._settings = None
        self._name(*named)
        self._examine(q, reference, None)
        return Reached(self._q[0].copy(), self._facts.item(0), self._may_be_mirrored,
                       self._facts.item(1))

    def examine(self, q: Array, reference: Array | float) -> Examined:
        """Return the properties of q (nq,); angles are nearest to `reference` (n_angles,) [rad]."""
        self._settings = self._task.named.value = None
        self._examine(q, reference, self._at_angles)
        return self._examined(self._may_be_mirrored)

    def _examine(self, q: Array, reference: Array | float, angles: int | None) -> None:
        self._q[0], self._reference[:], task = q, reference, self._task
        named = ctypes.addressof(task) + ClosureTask.named.offset
        check(self._library.closer_examine(
            self.handle, task.q, task.reference, named, self._at_facts, angles, task.mirrored))

    @property
    def _may_be_mirrored(self) -> bool:
        return self._mirrored.item(0) != 0 or self._has_tangents

    def _examined(self, mirrored: bool) -> Examined:
        error, _, least, dependent = self._facts.tolist()
        angles = self._angles.copy() if self.kernel.n_angles else self._angles
        return Examined(error, angles, mirrored, least, dependent)

    def descend(
        self, q: Array, free: NDArray[np.bool_], tolerance: float, iterations: int
    ) -> tuple[Array, Array]:
        """Return configurations q (m, nq) after damped steps, and the lengths of residuals (m,).

        By products alone; the angles of screws count from zero.
        """
        q, errors = np.array(q, order="C"), np.empty(len(q))
        self._free[:], self._settings = free, None
        check(self._library.closer_descend(
            self.handle, len(q), address(q), self._task.free, tolerance, iterations,
            address(errors)))
        return q, errors


def closer_of(mechanism: Mechanism, pinned: Iterable[str] = ()) -> acquired[Closer]:
    """Acquire a closer of a mechanism with some coordinates pinned, in its initial state."""
    return acquired(mechanism, Closer, tuple(pinned))


def _rotations(mechanism: Mechanism) -> Iterator[tuple[str, tuple[int, int]]]:
    """Yield closures with all equations of directions: the first, and how many axes they align."""
    at = 0
    for closure in mechanism.closures:
        if not closure.frames:
            continue
        rows = at + np.flatnonzero([isinstance(row.first, Cosine) for row in closure.rows])
        at += closure.n_rows
        axes = AGREEING.get(closure.pair.aligned, 0)
        if axes and len(rows) == EQUATIONS[axes] and not closure.sums:
            yield closure.name, (int(rows[0]), axes)


def _pin(mechanism: Mechanism, name: str) -> tuple[int, int, int, int]:
    """Return first place in q and v, component, and whether it turns, of a pinned coordinate."""
    c = mechanism.coordinate_table[name]
    i = mechanism.joint_id(c.joint)
    q, v = int(mechanism.model.idx_qs[i]), int(mechanism.model.idx_vs[i])
    is_free = mechanism.model.nqs[i] == 7
    if is_free and c.component < 3:
        return q, v, c.component, 0
    return q + 3 * is_free, v + 3 * is_free, c.component % 3, 1
