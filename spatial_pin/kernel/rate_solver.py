"""Rates of all joints in the kernel, see `rates.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.kernel import FrameInKernel, Kernel, numbers
from spatial_pin.kernel.library import (
    DONE,
    INT,
    NOT_FINITE,
    POINTER,
    address,
    check,
)
from spatial_pin.numerics.linalg import Array


class Solved(NamedTuple):
    """Rates at a configuration.

    Attributes:
        v, a: (nv,) joint velocities and accelerations.
        pivot: smallest over largest pivot of the equations.
        lost: round-off of v and a, relative to their size.
        known: what of it is known whatever the velocities are.
        is_finite: whether v and a are; else they are larger than numbers can be.
    """

    v: Array
    a: Array
    pivot: float
    lost: float
    known: float
    is_finite: bool


class Chosen(NamedTuple):
    """Equations that determine the rates where it is not clear which are independent.

    Attributes:
        rows: (r,) independent closure equations, ascending.
        fill: (k, nv) what fills the system up: unresolved passive freedoms, scaled, orthonormal.
    """

    rows: NDArray[np.integer[Any]]
    fill: Array


class RateRows(NamedTuple):
    """Rates and influence coefficients at m configurations; arrays not computed are None.

    Attributes:
        codes: (m,) of the kernel: `DONE` where equations determine the rates.
        columns: (m, nv, n_moving) joint velocities per unit speed of each that moves.
        second: (m, nv, n_moving, n_moving) joint accelerations per product of two speeds.
        jacobian, jacobian_rate: (m, 6, n_moving) of the frame.
        v, a: (m, nv) joint velocities and accelerations.
        facts: (m, 3) pivot, lost and known, see `Solved`.
    """

    codes: NDArray[np.int64]
    columns: Array | None = None
    second: Array | None = None
    jacobian: Array | None = None
    jacobian_rate: Array | None = None
    v: Array | None = None
    a: Array | None = None
    facts: Array | None = None


class _RateTask(ctypes.Structure):
    """RateTask in rates.h."""

    _fields_ = [
        ("n", INT), ("q", POINTER), ("reference", POINTER), ("equations", POINTER),
        ("n_equations", INT), ("fill", POINTER), ("n_fill", INT), ("speed", POINTER),
        ("acceleration", POINTER), ("motion", POINTER), ("joint", INT), ("local", POINTER),
        *((name, POINTER) for name in (
            "code", "columns", "second", "jacobian", "jacobian_rate", "v", "a", "facts"))]


class RateSolver:
    """Solves for rates with some freedoms driven; one caller at a time.

    Kept by the kernel whose memory it works in. Results read after `factor` or `solve` are those
    of their configuration.

    Args:
        kernel: of the mechanism.
        driven: places in the velocity vector, those that stand still last; nv and that of a
            component of a ball or a floating joint.
        n_moving: how many do not.

    Attributes:
        speeds, accelerations: (n,) of driven coordinates, for `solve`.
    """

    def __init__(self, kernel: Kernel, driven: Sequence[int], n_moving: int) -> None:
        self._library, handle = kernel.library, ctypes.c_void_p()
        self.n_moving, self.n_driven, self.nv = n_moving, len(driven), kernel.nv
        self._n_passive = kernel.n_passive
        self._n_equations = kernel.n_closure + kernel.n_passive
        at = np.array(driven, np.int64)
        check(self._library.rates_create(
            kernel.handle, address(at), len(at), n_moving, ctypes.byref(handle)))
        self._handle = handle
        self._q, self._reference = np.empty(kernel.nq), np.empty(kernel.n_angles)
        self.speeds, self.accelerations = np.zeros((2, len(at)))
        self._columns, self._v, self._a = np.empty((self.nv, n_moving)), *np.empty((2, self.nv))
        self._facts, self._local = np.zeros(3), np.empty(3)
        self._jacobian, self._code_at = np.empty((6, n_moving)), np.zeros(1, np.int64)
        self._addresses = address(self.speeds), address(self._local)
        self._task = _RateTask(
            1, address(self._q), address(self._reference),
            acceleration=address(self.accelerations), code=address(self._code_at),
            columns=address(self._columns), jacobian=address(self._jacobian), v=address(self._v),
            a=address(self._a), facts=address(self._facts))
        self._at_task = ctypes.byref(self._task)

    def factor(self, q: Array, reference: Array, chosen: Chosen | None = None) -> bool:
        """Factor the equations at q (nq,); False if they do not determine the rates there.

        Without `chosen` also if equations are not clearly independent of each other and of the
        driven freedoms, or if there are not as many equations as freedoms.

        Args:
            q: closed configuration.
            reference: (n_angles,) from which the angles of screws count [rad].
            chosen: the equations, if the kernel is not to choose them.
        """
        return self._code(q, reference, chosen) in (DONE, NOT_FINITE)

    def solve(self, q: Array, reference: Array, chosen: Chosen | None = None) -> Solved | None:
        """Return the rates at q (nq,) for the drivers' rates in `speeds` and `accelerations`.

        None as `factor`.
        """
        code = self._code(q, reference, chosen, speed=self._addresses[0])
        if code not in (DONE, NOT_FINITE):
            return None
        pivot, lost, known = self._facts.tolist()
        return Solved(self._v.copy(), self._a.copy(), pivot, lost, known, code == DONE)

    def jacobian(
        self, q: Array, reference: Array, frame: FrameInKernel, chosen: Chosen | None = None
    ) -> Array | None:
        """Return the Jacobian (6, n_moving) of a frame at q (nq,); None as `factor`."""
        self._local[:], self._task.joint = frame.origin, frame.joint
        is_solved = self._code(q, reference, chosen, local=self._addresses[1]) == DONE
        return self._jacobian.copy() if is_solved else None

    def _code(
        self, q: Array, reference: Array, chosen: Chosen | None, speed: int | None = None,
        local: int | None = None,
    ) -> int:
        """Solve the task; return the kernel's code, which says whether rates are determined."""
        self._q[:], self._reference[:], task = q, reference, self._task
        task.speed, task.local, alive = speed, local, _choose(task, chosen)
        check(self._library.rates_solve(self._handle, self._at_task))
        del alive
        return self._code_at.item(0)

    @property
    def pivot(self) -> float:
        """Smallest over largest pivot of the equations, where they were last factored."""
        return self._facts.item(0)

    def columns(self) -> Array:
        """Return (nv, n_moving): joint velocities per unit speed of each that moves."""
        return self._columns.copy()

    def rows(
        self, q: Array, reference: Array, wanted: Sequence[str], *,
        frame: FrameInKernel | None = None, v: Array | None = None,
        rates: tuple[Array, Array] | None = None, chosen: Chosen | None = None,
    ) -> RateRows:
        """Return results at configurations q (m, nq).

        Args:
            q: closed configurations.
            reference: (m, n_angles) from which the angles of screws count [rad].
            wanted: names of results of `RateRows`; "v" brings "a" and "facts".
            frame: of the Jacobians.
            v: (m, nv) joint velocities of "jacobian_rate".
            rates: speeds and accelerations (m, n_driven) of the driven freedoms, for "v".
            chosen: the equations at all of them, if the kernel is not to choose them.
        """
        m, n, nv = len(q), self.n_moving, self.nv
        shapes = {"columns": (nv, n), "second": (nv, n, n), "jacobian": (6, n),
                  "jacobian_rate": (6, n), "v": (nv,), "a": (nv,), "facts": (3,)}
        names = [*wanted, "a", "facts"] if "v" in wanted else wanted
        results = RateRows(np.zeros(m, np.int64), **{x: np.zeros((m, *shapes[x])) for x in names})
        q, reference = numbers(q, (m, self._q.size)), numbers(reference, (m, self._reference.size))
        if v is not None:
            v = numbers(v, (m, nv))
        if rates is not None:
            rates = numbers(rates[0], (m, self.n_driven)), numbers(rates[1], (m, self.n_driven))
        self.prepared(q, reference, results, frame=frame, v=v, rates=rates, chosen=chosen)()
        return results

    def prepared(
        self, q: Array, reference: Array, results: RateRows, *, frame: FrameInKernel | None = None,
        v: Array | None = None, rates: tuple[Array, Array] | None = None,
        chosen: Chosen | None = None,
    ) -> Callable[[], None]:
        """Return what solves for what the arrays of `rows` have when it is called.

        The arrays are contiguous ones of doubles; those of `results` are overwritten.
        """
        task = _RateTask(len(q), address(q), address(reference), code=address(results.codes), **{
            name: address(x) for name, x in results._asdict().items()
            if name != "codes" and x is not None})
        given: list[Any] = [q, reference, results]
        if frame is not None:
            given.append(numbers(np.array(frame.origin), (3,)))
            task.joint, task.local = frame.joint, address(given[-1])
        if v is not None:
            given.append(v)
            task.motion = address(v)
        if rates is not None:
            given.append(rates)
            task.speed, task.acceleration = map(address, rates)
        given.append(_choose(task, chosen))
        solve, handle, at_task = self._library.rates_solve, self._handle, ctypes.byref(task)

        def work(alive: Any = given) -> None:
            check(solve(handle, at_task))

        return work

    def prepared_idle(self, out: Array) -> Callable[[], None]:
        """Return what finds joint velocities (n_passive, nv) of idle rotations, into `out`.

        Each per unit rate of it, at the last configuration, while all that is driven stands still.
        """
        rates, still = np.zeros((len(out), self._n_equations)), np.zeros(self.n_driven)
        rates[:, self._n_equations - len(out) :] = -np.eye(len(out))
        calls = [(self._handle, None, address(rate), address(still), address(row))
                 for rate, row in zip(rates, out, strict=True)]

        def work(alive: Any = (rates, still, out)) -> None:
            for call in calls:
                self._library.rates_answer(*call)

        return work

    def idle(self) -> Array:
        """Return joint velocities (n_passive, nv) of idle rotations, see `prepared_idle`."""
        out = np.empty((self._n_passive, self.nv))
        self.prepared_idle(out)()
        return out

    def answer(
        self, derivative: Array | None, drive: Array | None = None, v: Array | None = None
    ) -> Array:
        """Return joint rates (nv,) of any order, or accelerations at joint velocities.

        Args:
            derivative: (n_closure + n_passive,) of the equations, where the rates are zero; driven
                coordinates must be velocity entries then. None: of accelerations at v.
            drive: (n_driven,) rates of driven coordinates; none by default.
            v: (nv,) joint velocities, of accelerations.
        """
        v = None if v is None else numbers(v, (self.nv,))
        if derivative is not None:
            derivative = numbers(derivative, (self._n_equations,))
        rates, full = np.empty(self.nv), np.zeros(self.n_driven)  # the last ones stand still
        if drive is not None:
            full[: len(drive)] = drive
        self._library.rates_answer(
            self._handle, None if v is None else address(v),
            None if derivative is None else address(derivative), address(full), address(rates))
        return rates


def _choose(task: _RateTask, chosen: Chosen | None) -> tuple[NDArray[Any], ...]:
    """Give a task chosen equations; returns the arrays that must live as long as C reads them."""
    if chosen is None:
        task.equations = None
        return ()
    rows = np.ascontiguousarray(chosen.rows, np.int64)
    fill = np.ascontiguousarray(chosen.fill, float)
    task.equations, task.n_equations = address(rows), len(rows)
    task.fill, task.n_fill = address(fill), len(fill)
    return rows, fill


def rates_of(kernel: Kernel, driven: tuple[int, ...], n_moving: int) -> RateSolver:
    """Return the solver for rates in a kernel, made once."""
    key = driven, n_moving
    if key not in kernel.solvers:
        kernel.solvers[key] = RateSolver(kernel, driven, n_moving)
    return kernel.solvers[key]
