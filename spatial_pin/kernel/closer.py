"""Closing loops in the kernel, see `closing.c`."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import acquired, made_once
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.library import INT, POINTER, REAL, CStructure, address, check
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import NOT_FINITE, Array
from spatial_pin.numerics.tolerances import TOLERANCES

TANGENT = "tangent"  # `Pair.aligned` of a direction along that of a curve
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


class Examined(NamedTuple):
    """Properties of a configuration.

    Attributes:
        error: its closure error.
        angles: (n_angles,) of screw closures, counting turns [rad].
        may_be_mirrored: as of `ClosureResult`.
        least: of its closure equations, the columns of their derivatives made alike: the length
            of the remainder of the last one that is independent, relative to the first one's.
        dependent: likewise of the longest of those that follow from others.
    """

    error: float
    angles: Array
    may_be_mirrored: bool
    least: float
    dependent: float


class ClosureResult(NamedTuple):
    """A configuration whose loops are closed, or as well as they could be.

    Attributes:
        q: the configuration (nq,), whole turns taken off its angles where coordinates are named.
        error: its closure error.
        may_be_mirrored: False if the axes that closures make parallel point the same way.
        distance: from the named values, but of components of balls and floating joints [rad,
            characteristic lengths]; of targets: the length of their residuals.
        examined: its properties, where one start alone has led to a closed configuration.
        is_unique: whether it is certain that no other closed configuration is as near to its start.
    """

    q: Array
    error: float
    may_be_mirrored: bool
    distance: float = 0.0
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


class NamedStruct(CStructure):
    """Named in closing_parts.h: the arrays of `NamedCoordinates`."""

    _fields_ = tuple((name, POINTER) for name in NamedCoordinates._fields)


class TargetsStruct(CStructure):
    """Targets in closing_parts.h: where frames and coordinates are wanted."""

    _fields_ = ("n", INT), ("of", POINTER), ("number", POINTER), ("size", REAL)


class ClosureTask(CStructure):
    """ClosureTask in closing.h: what loops are closed with, and the result."""

    _fields_ = (
        ("m", INT), *[(name, POINTER) for name in ("q", "first", "free")], ("loose", REAL),
        ("tolerance", REAL), ("iterations", INT), ("pinned", POINTER), ("reference", POINTER),
        ("cut", REAL), ("named", NamedStruct), ("n_steps", INT), ("steps", POINTER),
        ("near", REAL), ("moved", POINTER), ("group", POINTER),
        *[(name, POINTER) for name in ("error", "distance", "mirrored", "facts", "angle")],
        ("targets", TargetsStruct), ("unique", INT))


class PerturbedStarts(NamedTuple):
    """Further starts, if the first one does not lead near the named values.

    Attributes:
        near: a distance from the named values that is accepted.
        steps: (m, nv) joint displacements from the first start, `AT_ONCE` of each group of loops:
            while one is displaced the others stand.
        moved: (m,) the group that each displaces.
        group: (nv,) the group that each velocity is of.
    """

    near: float
    steps: Array
    moved: NDArray[np.int64]
    group: NDArray[np.int64]


class ClosureSettings(NamedTuple):
    """Settings of closing loops, without the values of fixed coordinates; compared by identity.

    Attributes:
        free, first: (nv,) velocities that may move, and may move before that, to a residual of
            `LOOSE`.
        tolerance: length of the residual from which steps are undamped.
        iterations: damped steps at most.
        cut: size of the equations, by the largest, below which they move nothing.
        kinds, limits: see `NamedCoordinates`; None: nothing is named.
        perturbed: perturbed starts; None: there are none.
        are_all_named: whether the start names all that may move.
    """

    free: NDArray[np.bool_]
    first: NDArray[np.bool_] | None
    tolerance: float
    iterations: int
    cut: float
    kinds: NDArray[np.int64] | None = None
    limits: tuple[Array, ...] = ()
    perturbed: PerturbedStarts | None = None
    are_all_named: bool = False


class Closer:
    """Closes the loops of a mechanism with some coordinates pinned; one caller at a time.

    Args:
        mechanism: the mechanism.
        pinned: names of components of balls and floating joints.

    Attributes:
        kernel: the compiled mechanism, in whose memory it works.
        handle: of the C structure.
        task, at_task: the task, and its address.
        angles: (n_angles,) of screws at the last result, counting turns [rad].
        paths: those that start where it closes the loops, by prescribed coordinates.
    """

    def __init__(self, mechanism: Mechanism, pinned: Iterable[str] = ()) -> None:
        self.kernel = kernel = Kernel(mechanism)
        self.handle, self._order = _created(kernel, pinned)
        self._library, self.paths = kernel.library, dict[tuple[int, ...], Any]()
        self._has_tangents = any(c.pair.aligned == TANGENT for c in mechanism.closures)
        rows = 1 + MOST_GROUPS * AT_ONCE
        self._q, self._value = np.empty((rows, kernel.nq)), np.empty(kernel.nq)
        self._free, self._mirrored = np.empty(kernel.nv, np.int64), np.empty(rows, np.int64)
        self._reference, self.angles = np.empty((2, kernel.n_angles))
        self._pinned, self._facts = np.empty(len(self._order)), np.empty(4)
        self._errors, self._distances = np.empty((2, rows))
        self.task = ClosureTask.of(
            q=self._q, free=self._free, pinned=self._pinned, reference=self._reference,
            error=self._errors, distance=self._distances, mirrored=self._mirrored,
            angle=self.angles)
        self.at_task = ctypes.byref(self.task)
        self._settings: ClosureSettings | None = None  # what the task is set to

    def set_task(
        self, q: Sequence[Array], settings: ClosureSettings, value: Array | None = None,
        reference: Array | float = 0.0, pinned: Iterable[float] = (), perturbed: bool = False,
    ) -> None:
        """Set the task of the kernel.

        Args:
            q: where to start (nq,), from each by itself; `AT_ONCE` at most.
            settings: how.
            value: (nq,) of named or fixed entries, see `NamedCoordinates`.
            reference: (n_angles,) from which the angles of screws count [rad].
            pinned: values of the pinned coordinates, in the order of their names.
            perturbed: close from the perturbed starts too where a single one closes, nothing is at
                fault, and it is not near: closed results that are no nearer are omitted.
        """
        task, starts = self.task, settings.perturbed
        if settings is not self._settings:  # else only values have changed
            self._settings, self._free[:] = settings, settings.free
            task.put(tolerance=settings.tolerance, loose=max(settings.tolerance, LOOSE),
                     iterations=settings.iterations, cut=settings.cut, near=np.inf, facts=None,
                     first=None if settings.first is None else settings.first.astype(np.int64))
            task.named.value = None
            if starts is not None:
                task.put(**starts._asdict())
            if settings.kinds is not None:
                task.put(facts=self._facts, named=NamedStruct(*map(
                    address, (self._value, settings.kinds, *settings.limits))))
        if value is not None:
            self._value[:] = value
        if len(self._reference):
            self._reference[:] = reference
        if len(self._order):
            self._pinned[:] = np.array(list(pinned))[self._order]
        for row, start in enumerate(q):
            self._q[row] = start
        task.m, task.n_steps = len(q), len(starts.steps) if perturbed and starts else 0
        task.unique = settings.are_all_named  # C writes it

    def results(self) -> list[ClosureResult]:
        """Return where C has closed the loops to.

        Raises:
            SingularError: positions have grown beyond all numbers.
        """
        errors = self._errors[: self.task.m].tolist()
        if not all(map(math.isfinite, errors)):
            raise SingularError(NOT_FINITE)
        is_judged = self._settings is not None and self._settings.kinds is not None
        examined = self._examined() if is_judged and self._facts.item(0) < np.inf else None
        is_unique = bool(self.task.unique)
        return [ClosureResult(self._q[k].copy(), error, self._may_be_mirrored(k),
                              self._distances.item(k), None if k else examined, not k and is_unique)
                for k, error in enumerate(errors)]

    def solve(
        self, q: Sequence[Array], settings: ClosureSettings, value: Array | None = None,
        reference: Array | float = 0.0, pinned: Iterable[float] = (), perturbed: bool = False,
    ) -> list[ClosureResult]:
        """Close the loops; arguments as of `set_task`, raises as `results`."""
        self.set_task(q, settings, value, reference, pinned, perturbed)
        check(self._library.closer_close(self.handle, self.at_task))
        return self.results()

    def prepared(
        self, q: Array, reference: Array, free: NDArray[np.bool_], tolerance: float,
        iterations: int, cut: float,
    ) -> Callable[[], float]:
        """Return what closes the loops from q (nq,), into q, and returns the closure error.

        Nothing is pinned; `q` and `reference` are read when it is called. Other arguments are those
        of `ClosureSettings`; what is returned raises as `results`.
        """
        error = np.zeros(1)
        task = ClosureTask.of(
            m=1, q=q, free=free.astype(np.int64), loose=max(tolerance, LOOSE), tolerance=tolerance,
            iterations=iterations, reference=reference, cut=cut, error=error, angle=self.angles,
            distance=self._distances, mirrored=np.zeros(1, np.int64))
        at_task = ctypes.byref(task)

        def work() -> float:
            check(self._library.closer_close(self.handle, at_task))
            if not math.isfinite(error.item(0)):
                raise SingularError(NOT_FINITE)
            return error.item(0)

        return work

    def judge(self, q: Array, reference: Array | float, named: NamedCoordinates) -> ClosureResult:
        """Return q (nq,), whole turns taken off its angles, and its properties."""
        error, distance, *_ = self._looked_at(q, reference, NamedStruct(*map(address, named)))
        return ClosureResult(self._q[0].copy(), error, self._may_be_mirrored(), distance)

    def examine(self, q: Array, reference: Array | float) -> Examined:
        """Return the properties of q (nq,); angles are nearest to `reference` (n_angles,) [rad]."""
        self._looked_at(q, reference, NamedStruct(), self.task.angle)
        return self._examined()

    def _looked_at(
        self, q: Array, reference: Array | float, named: NamedStruct, angles: int | None = None
    ) -> list[float]:
        self._q[0], self._reference[:], task = q, reference, self.task
        check(self._library.closer_examine(
            self.handle, task.q, task.reference, ctypes.byref(named), address(self._facts), angles,
            task.mirrored))
        return self._facts.tolist()

    def _examined(self) -> Examined:
        error, _, least, dependent = self._facts.tolist()
        return Examined(error, self.angles.copy(), self._may_be_mirrored(), least, dependent)

    def _may_be_mirrored(self, k: int = 0) -> bool:
        return self._mirrored.item(k) != 0 or self._has_tangents


def closer_of(mechanism: Mechanism, pinned: Iterable[str] = ()) -> acquired[Closer]:
    """Acquire a closer of a mechanism with some coordinates pinned, in its initial state."""
    return acquired(mechanism, Closer, tuple(pinned))


def descend(
    closer: Closer, q: Array, free: NDArray[np.bool_], tolerance: float, iterations: int
) -> tuple[Array, Array]:
    """Return configurations q (m, nq) after damped steps, and the lengths of residuals (m,).

    By products alone; the angles of screws count from zero.
    """
    q, errors, moving = np.array(q, order="C"), np.empty(len(q)), free.astype(np.int64)
    check(closer.kernel.library.closer_descend(
        closer.handle, len(q), address(q), address(moving), tolerance, iterations,
        address(errors)))
    return q, errors


def meet(
    closer: Closer, q: Array, free: NDArray[np.bool_], reference: Array,
    targets: Sequence[KernelTarget], iterations: int,
) -> tuple[ClosureResult, Array] | None:
    """Close the loops from q (nq,) where targets are met, by the least displacement.

    Args:
        closer: of the mechanism.
        q: where to start.
        free: (nv,) velocities that may move.
        reference: (n_angles,) from which the angles of screws count [rad].
        targets: the targets to meet.
        iterations: damped steps at most.

    Returns:
        The result, and the angles (n_angles,) of screws, counting turns [rad]. None where there
        are more targets than it takes, where they are not met from there, or only just at the
        end of their reach.
    """
    n, kernel, task = len(targets), closer.kernel, closer.task
    if n > kernel.nv + MORE_TARGETS:
        return None
    indices, numbers = np.zeros((n, TARGET_INTS), np.int64), np.zeros((n, TARGET_REALS))
    for row, (of, number) in enumerate(targets):
        indices[row], numbers[row, : len(number)] = of, number
    closer.set_task([q], ClosureSettings(
        free, None, TOLERANCES.round_off, iterations, TOLERANCES.rank), reference=reference)
    task.targets = TargetsStruct(
        n, address(indices), address(numbers), kernel.mechanism.characteristic_length)
    code = kernel.library.closer_close(closer.handle, closer.at_task)
    task.targets.n = 0
    return None if code else (closer.results()[0], closer.angles)


def _created(
    kernel: Kernel, pinned: Iterable[str]
) -> tuple[ctypes.c_void_p, NDArray[np.intp]]:
    """Return the structure in C, and the order of pinned coordinates in it."""
    mechanism, packed = kernel.mechanism, kernel.packed
    turning, rotations, at = set[str](), list[tuple[int, int]](), 0
    equations = kernel.constraints
    is_direction = np.array([x >= 0 and not equations.factors[x, 0] for x in equations.product])
    for closure in mechanism.closures:  # those with all equations of directions
        if not closure.frames:
            continue
        rows = at + np.flatnonzero(is_direction[at : at + closure.n_rows])
        at += closure.n_rows
        axes = AGREEING.get(closure.pair.aligned, 0)
        if axes and len(rows) == EQUATIONS[axes] and not closure.sums:
            turning.add(closure.name)
            rotations.append((int(rows[0]), axes))
    body, axis = list[int](), list[Array]()
    for name, ends in axis_pairs(mechanism):
        if name not in turning:
            carriers = [int(packed.carriers[joint]) for joint, _ in ends]
            turned = [packed.frames[i].T @ axes
                      for i, (_, axes) in zip(carriers, ends, strict=True)]
            for one, two in zip(turned[0].T, turned[1].T, strict=True):
                body += carriers
                axis += [one, two]
    pins, model = [], mechanism.model  # first entries in q and v, component, whether it turns
    for name in pinned:
        c = mechanism.coordinate_table[name]
        i = mechanism.joint_id(c.joint)
        skipped = 3 if model.nqs[i] == 7 and c.component >= 3 else 0  # the position
        turns = model.nqs[i] != 7 or c.component >= 3
        pins.append((model.idx_qs[i] + skipped, model.idx_vs[i] + skipped, c.component % 3, turns))
    table = np.array(pins, np.int64).reshape(-1, 4)
    order = np.lexsort(table.T[::-1])  # those of one joint side by side
    table, handle = table[order], ctypes.c_void_p()
    columns = np.array(rotations, np.int64).reshape(-1, 2).T.copy()
    bodies, directions = np.array(body, np.int64), np.array(axis)
    check(kernel.library.closer_create(
        kernel.handle, address(columns), columns.shape[1], address(table), len(table),
        address(bodies), address(directions), len(bodies) // 2, ctypes.byref(handle)))
    return handle, order


def opposite_axes(mechanism: Mechanism, data: pin.Data) -> dict[str, bool]:
    """Return closures whose axes do not point the same way, and whether half a turn helps.

    Closed equations leave them parallel, opposite, or (three equations of rotation) interchanged:
    then half a turn of one of the frames is not what makes them one.
    """
    opposite = {}
    for name, ends in axis_pairs(mechanism):
        one, two = (data.oMi[joint].rotation @ axes for joint, axes in ends)
        cosines = np.vecdot(one.T, two.T)
        if np.any(cosines < 0.5):
            opposite[name] = bool(np.all(np.abs(cosines) > 0.5))
    for closure in mechanism.closures:
        if closure.pair.aligned == TANGENT:
            frames = map(mechanism.centred_frame, closure.frames)
            first, second = (data.oMi[joint] * placement for joint, placement in frames)
            seen = first.actInv(second)
            if closure.numbers["curve"].tangent(seen.translation) @ seen.rotation[:, 2] < 0.0:
                opposite[closure.name] = True
    return opposite


@made_once
def axis_pairs(mechanism: Mechanism) -> list[tuple[str, list[tuple[int, Array]]]]:
    """Return closures with axes: name, and of each end its joint and axes (3, n) fixed to it."""
    pairs = []
    for closure in mechanism.closures:
        if not closure.pair.aligned or closure.pair.aligned == TANGENT:
            continue
        geometry, first = closure.geometry, 2 if closure.pair.aligned == "z" else 0
        ends = [
            (joint, (placement.rotation @ axes)[:, first:])
            for (joint, placement), axes in zip(
                map(mechanism.centred_frame, closure.frames), (geometry.axes1, geometry.axes2),
                strict=True)]
        pairs.append((closure.name, ends))
    return pairs
