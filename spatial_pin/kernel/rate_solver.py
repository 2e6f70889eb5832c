"""Rates of all joints in the kernel, see `rates.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.kernel import FrameInKernel, Kernel
from spatial_pin.kernel.library import (
    DONE,
    INT,
    NOT_FINITE,
    POINTER,
    CStructure,
    address,
    check,
    numbers,
)
from spatial_pin.numerics.linalg import Array

DETERMINED = DONE, NOT_FINITE  # codes of configurations with rates, also infinite ones


# What determines the rates where it is not clear which equations are independent: such closure
# equations (r,), ascending, and what fills the system up (k, nv): unresolved passive freedoms,
# scaled, orthonormal.
Chosen = tuple[NDArray[np.integer[Any]], Array]


class RateRows(NamedTuple):
    """Rates and influence coefficients at m configurations; arrays not computed are None.

    Attributes:
        codes: (m,) of the kernel: `DONE` where equations determine the rates.
        columns: (m, nv, n_moving) joint velocities per unit speed of each that moves.
        second: (m, nv, n_moving, n_moving) joint accelerations per product of two speeds.
        jacobian, jacobian_rate: (m, 6, n_moving) of the frame.
        v, a: (m, nv) joint velocities and accelerations.
        facts: (m, 3) smallest over largest pivot of the equations; round-off of v and a, relative
            to their size; what of it is known whatever the velocities are.
    """

    codes: NDArray[np.int64]
    columns: Array | None = None
    second: Array | None = None
    jacobian: Array | None = None
    jacobian_rate: Array | None = None
    v: Array | None = None
    a: Array | None = None
    facts: Array | None = None


class _RateTask(CStructure):
    """RateTask in rates.h."""

    _fields_ = (
        ("n", INT), ("q", POINTER), ("reference", POINTER), ("equations", POINTER),
        ("n_equations", INT), ("fill", POINTER), ("n_fill", INT), ("speed", POINTER),
        ("acceleration", POINTER), ("motion", POINTER), ("joint", INT), ("local", POINTER),
        *((name, POINTER) for name in (
            "code", "columns", "second", "jacobian", "jacobian_rate", "v", "a", "facts")))

    def choose(self, chosen: Chosen | None) -> None:
        """Give it equations; None: C chooses."""
        self.equations = None
        if chosen is not None:
            rows = np.ascontiguousarray(chosen[0], np.int64)
            fill = np.ascontiguousarray(chosen[1], float)
            self.put(equations=rows, n_equations=len(rows), fill=fill, n_fill=len(fill))


def _task(
    q: Array, reference: Array, results: RateRows, frame: FrameInKernel | None, v: Array | None,
    rates: Any,
) -> _RateTask:
    """Return a task of the kernel; arguments are as of `RateSolver.prepared`."""
    codes, *others = results
    task = _RateTask.of(n=len(q), q=q, reference=reference, motion=v, code=codes, **dict(
        zip(RateRows._fields[1:], others, strict=True)))
    if frame is not None:
        task.put(joint=frame.joint, local=numbers(np.asarray(frame.origin, float), (3,)))
    if rates is not None:
        task.put(speed=rates[0], acceleration=rates[1])
    return task


class RateSolver:
    """Solves for rates with some freedoms driven; one caller at a time.

    Kept by the kernel whose memory it works in.

    Args:
        kernel: of the mechanism.
        driven: places in the velocity vector, those that stand still last; nv and that of a
            component of a ball or a floating joint.
        n_moving: how many do not.

    Attributes:
        speeds, accelerations: (n_driven,) of driven freedoms, for `solve`.
    """

    def __init__(self, kernel: Kernel, driven: Sequence[int], n_moving: int) -> None:
        self._library, handle, nv = kernel.library, ctypes.c_void_p(), kernel.nv
        self.n_driven, self.nv = len(driven), nv
        self._n_equations = kernel.n_closure + kernel.n_passive
        at = np.array(driven, np.int64)
        check(self._library.rates_create(
            kernel.handle, address(at), len(at), n_moving, ctypes.byref(handle)))
        self._handle, self._of_one = handle, dict[Any, tuple[Any, ...]]()
        self._q, self._reference = np.empty(kernel.nq), np.empty(kernel.n_angles)
        self._rates = np.zeros((2, 1, len(at)))
        self.speeds, self.accelerations = self._rates[:, 0]
        self._shapes = {"columns": (nv, n_moving), "second": (nv, n_moving, n_moving),
                        "jacobian": (6, n_moving), "jacobian_rate": (6, n_moving), "v": (nv,),
                        "a": (nv,), "facts": (3,)}

    def solve(
        self, q: Array, reference: Array, wanted: tuple[str, ...], *,
        frame: FrameInKernel | None = None, v: Array | None = None, chosen: Chosen | None = None,
    ) -> list[Array] | None:
        """Return results at one configuration; None if equations do not determine the rates there.

        Without `chosen` also if equations are not clearly independent of each other and of the
        driven freedoms, or if there are not as many equations as freedoms. "v", with "a" and
        "facts", is at `speeds` and `accelerations`, and may be infinite. Other arguments are as of
        `rows`, without an axis of configurations.
        """
        key = wanted, frame and frame.joint, v is None
        known = self._of_one.get(key)
        if known is None:  # the same task again and again
            room, local, motion = self._room(1, wanted), np.empty(3), np.empty((1, self.nv))
            at = frame and frame._replace(origin=local)
            known = self._of_one[key] = (
                local, motion, room.codes, [getattr(room, x)[0] for x in wanted],
                _task(self._q[None], self._reference[None], room, at,
                      motion if v is not None else None, self._rates if "v" in wanted else None))
        local, motion, codes, results, task = known
        self._q[:], self._reference[:] = q, reference
        if frame is not None:
            local[:] = frame.origin
        if v is not None:
            motion[:] = v
        task.choose(chosen)
        check(self._library.rates_solve(self._handle, ctypes.byref(task)))
        return [x.copy() for x in results] if codes.item() in DETERMINED else None

    def rows(
        self, q: Array, reference: Array, wanted: tuple[str, ...], *,
        frame: FrameInKernel | None = None, v: Array | None = None,
        rates: tuple[Array, Array] | None = None,
    ) -> RateRows:
        """Return results at configurations q (m, nq).

        Args:
            q: closed configurations.
            reference: (m, n_angles) from which the angles of screws count [rad].
            wanted: names of results of `RateRows`; "v" brings "a" and "facts".
            frame: of the Jacobians.
            v: (m, nv) joint velocities of "jacobian_rate".
            rates: speeds and accelerations (m, n_driven) of the driven freedoms, for "v".
        """
        m, results = len(q), self._room(len(q), wanted)
        q, reference = (numbers(x, (m, own.size)) for x, own in (
            (q, self._q), (reference, self._reference)))
        if v is not None:
            v = numbers(v, (m, self.nv))
        if rates is not None:
            rates = numbers(rates[0], (m, self.n_driven)), numbers(rates[1], (m, self.n_driven))
        self.prepared(q, reference, results, frame=frame, v=v, rates=rates)()
        return results

    def _room(self, m: int, wanted: tuple[str, ...]) -> RateRows:
        names = dict.fromkeys([*wanted, "a", "facts"] if "v" in wanted else wanted)
        return RateRows(np.zeros(m, np.int64), **{
            name: np.zeros((m, *self._shapes[name])) for name in names})

    def prepared(
        self, q: Array, reference: Array, results: RateRows, *, frame: FrameInKernel | None = None,
        v: Array | None = None, rates: tuple[Array, Array] | None = None,
        chosen: Chosen | None = None,
    ) -> Callable[[], None]:
        """Return what solves for what the arrays of `rows` have when it is called.

        The arrays are contiguous ones of doubles; those of `results` are overwritten. `chosen` are
        the equations, if the kernel is not to choose them.
        """
        task = _task(q, reference, results, frame, v, rates)
        task.choose(chosen)
        solve, handle, at_task = self._library.rates_solve, self._handle, ctypes.byref(task)

        def work() -> None:
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


def rates_of(kernel: Kernel, driven: tuple[int, ...], n_moving: int) -> RateSolver:
    """Return the solver for rates in a kernel, made once."""
    key = driven, n_moving
    if key not in kernel.solvers:
        kernel.solvers[key] = RateSolver(kernel, driven, n_moving)
    return kernel.solvers[key]
