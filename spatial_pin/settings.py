"""Accuracy settings: one small frozen object, used wherever speed is traded for accuracy."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

from spatial_pin._support.checks import number_from_zero, positive_number, whole_number
from spatial_pin.errors import SpatialPinError

FORMULATIONS = ("independent", "projected")  # names of those of `dynamics.simulation.formulations`
KERNEL = "kernel"


class Integrator(NamedTuple):
    """An integrator of ordinary differential equations; to add one, add an entry to `INTEGRATORS`.

    1. A class that is made and steps like those of SciPy's `solve_ivp` is given by its module and
       name: "scipy.integrate:Radau", or one of your own.
    2. One of the kernel (Runge and Kutta's) is an entry of `METHODS` in
       `kernel/integrators/integrating.c`; these have the same order here.
    3. "automatic" begins as DOP853, or as RK45 with a loose tolerance; `next_integrator` in
       `dynamics.simulation.integrators` decides when Radau goes on, and when the first one again.

    Attributes:
        solver: module and class, "module:class"; or "kernel"; or "" of the automatic one.
        order: of its error estimate; 0 where it has none, or finds its first step by itself.
        is_fixed: whether it keeps to the step given, one of the kernel.
        is_one_step: whether it forgets the steps before the last, so that the projected formulation
            may correct what a step leaves.
    """

    solver: str
    order: int = 0
    is_fixed: bool = False
    is_one_step: bool = True


INTEGRATORS = {
    "DOP853": Integrator(KERNEL, 7),
    "RK45": Integrator(KERNEL, 4),
    "Radau": Integrator("scipy.integrate:Radau", 3),
    "BDF": Integrator("scipy.integrate:BDF", 1, is_one_step=False),
    "LSODA": Integrator("scipy.integrate:LSODA", is_one_step=False),
    "RK4": Integrator(KERNEL, is_fixed=True),
    "Gauss": Integrator(KERNEL, is_fixed=True),
    "automatic": Integrator(""),
}


class Row(Protocol):
    """A setting that was measured."""

    @property
    def accuracy(self) -> Accuracy:
        """The setting."""


class Measurement(Protocol):
    """Settings that were measured: a `Tradeoff`."""

    def cheapest(self, error: float) -> Row:
        """Return the fastest row with at most this error."""


@dataclass(frozen=True)
class Accuracy:
    """How exactly loops are closed and motions are followed.

    Attributes:
        order: order of the Taylor predictor of a followed motion, 0 to 3 (the third derivative
            is a difference of two accelerations).
        corrections: number of Newton corrections at each step; None corrects until `tolerance`.
        tolerance: closure residual to reach [-], relative to the characteristic length; from 1e-9
            on also the error that samples of a followed motion may have, see below.
        gap: largest closure error that redundant equations of a rounded file may keep [-], see
            `State.gap`; 0 for none. Numbers of five digits leave up to 4e-5, single precision
            2e-7; a link that is 1 % too long leaves 1e-3 and more.
        formulation: of `simulate`: "independent" (coordinates, the loops closed inside) or
            "projected" (all joint coordinates, taken back to closed loops after every step).
        integrator: of `simulate`: "automatic" (DOP853; with one freedom and a `time_tolerance`
            of 3e-8 or more RK45; where strong damping or dry friction would make them creep,
            Radau), "DOP853",
            "RK45", "Radau", "BDF", "LSODA", "RK4", "Gauss".
        time_tolerance: error that adaptive integrators allow in one step, relative and absolute
            [rad, characteristic lengths, and these per natural time]: about the period of a turn,
            or of a pendulum as large, see `dynamics.simulation.integrators`. The pace and the
            masses of a mechanism make no difference. Below 2.2e-14, round-off, it makes none
            either.
        step: fixed step of "RK4" and "Gauss", longest step of the others [s].
        most_steps: of `simulate`: steps after which an adaptive integrator gives up, so that every
            simulation ends; a motion of a hundred thousand turns takes about a million. One
            without damping that would take ten times as many is given up early.

    With a tolerance of 1e-9 or more (and order 3), close samples of a sweep are interpolated
    between points of the path that are closed more tightly. One correction in the middle of each
    interval tells its error, and the intervals grow until that meets the tolerance: the error of
    positions, and of rates and accelerations by their size. `Motion.error` tells it. From 1e-11 on,
    most samples of a simulation are interpolated in time, with positions off by less than that, and
    accelerations by a few hundred times as much; steps of adaptive integrators close the loops to
    1e-4 of their own tolerance. This is not done if functions of yours act, because these may
    jump.

    Example:
        >>> mech = sp.load("four_bar")
        >>> coarse = sp.Accuracy(tolerance=1e-6)
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 181), accuracy=coarse)
        >>> print(motion.closure_error.max() < 1e-6)
        True
    """

    order: int = 3
    corrections: int | None = None
    tolerance: float = 1e-13
    gap: float = 1e-4
    formulation: str = "independent"
    integrator: str = "automatic"
    time_tolerance: float = 4e-12
    step: float | None = None
    most_steps: int = 1_000_000

    def __post_init__(self) -> None:
        order = whole_number(self.order, "order")
        if order not in (0, 1, 2, 3):
            raise ValueError(f"order is {order}; the predictor has orders 0 to 3")
        object.__setattr__(self, "order", order)
        if self.corrections is not None:
            corrections = whole_number(self.corrections, "corrections")
            if corrections < 0:
                raise ValueError(f"corrections is {corrections}; it cannot be negative")
            object.__setattr__(self, "corrections", corrections)
        if self.order == 0 and self.corrections == 0:
            raise ValueError("order 0 without corrections moves nothing but the driver")
        object.__setattr__(self, "tolerance", positive_number(self.tolerance, "tolerance"))
        object.__setattr__(self, "gap", number_from_zero(self.gap, "gap"))
        object.__setattr__(self, "time_tolerance",
                           positive_number(self.time_tolerance, "time_tolerance"))
        _check_name("formulation", self.formulation, FORMULATIONS)
        _check_name("integrator", self.integrator, INTEGRATORS)
        if self.step is not None:
            object.__setattr__(self, "step", positive_number(self.step, "step"))
        object.__setattr__(self, "most_steps", whole_number(self.most_steps, "most_steps"))
        if self.most_steps < 1:
            raise ValueError(f"most_steps is {self.most_steps}; it must be positive")

    @classmethod
    def named(cls, level: str) -> Accuracy:
        """Return the settings of a level: "draft", "engineering" or "reference".

        Raises:
            ValueError: there is no such level.

        Example:
            >>> sp.Accuracy.named("draft").order, sp.Accuracy.named("engineering").tolerance
            (3, 1e-13)
        """
        if not isinstance(level, str) or level not in LEVELS:
            raise ValueError(f"no accuracy level {level!r}; there are {sorted(LEVELS)}")
        return LEVELS[level]

    @classmethod
    def for_error(
        cls, error: float, task: str = "sweep", measured: Measurement | None = None
    ) -> Accuracy:
        """Return the cheapest setting that reaches an error; `Motion.error` tells whether it has.

        The error is the largest of positions [rad, characteristic lengths], and of velocities and
        accelerations by the largest one. A sweep to 1e-9 or more meets it by itself. Tighter ones,
        and simulations, have the setting that kept it with a margin over the mechanisms of the
        library with loops (simulations one between two of these), as `scripts/accuracy_table.py`
        measured: each did its usual sweep, or swung a few seconds under gravity. That is a
        measurement, not a proof: near singular configurations, and in long or unstable simulations,
        errors grow (`peaucellier` and `sarrus` through their change points, `crank_collar` and
        `excavator` let fall, are left out for that), and `Motion.error` says so. Or measure your
        own mechanism and task before:
        `for_error(1e-6, measured=spatial_pin.tradeoff(mechanism, task))`.

        Args:
            error: the largest error to accept.
            task: "sweep" or "simulate", where nothing was measured.
            measured: settings measured on one's own task, a third of the error being left for what
                lies between its samples, and for other motions.

        Returns:
            The setting, to be given as `accuracy`.

        Raises:
            SpatialPinError: no setting that was measured reaches it.
            ValueError: the error is not positive, or there is no such task.

        Example:
            >>> sp.Accuracy.for_error(1e-6).tolerance  # of a sweep, which meets it by itself
            1e-06
        """
        error = positive_number(error, "error")
        if measured is not None:
            if not hasattr(measured, "cheapest"):
                raise TypeError(f"measured is a {type(measured).__name__}; it is what "
                                "spatial_pin.tradeoff(mechanism, task) returns")
            return measured.cheapest(error).accuracy
        if not isinstance(task, str) or task not in MEASURED:
            raise ValueError(f"no task {task!r}; there are {sorted(MEASURED)}, or `measured`: what "
                             "spatial_pin.tradeoff(mechanism, task) returns")
        if task == "sweep" and error >= INTERPOLATED:
            return cls(tolerance=min(error, LOOSEST))
        looser = MEASURED[task][0]
        for row in MEASURED[task]:
            if row[0] <= error:
                return row[1] if task == "sweep" else _of_simulation(looser, row, error)
            looser = row
        best = min(reached for reached, _ in MEASURED[task])
        raise SpatialPinError(
            f"no setting is known to reach an error of {error:.3g} on every mechanism of the "
            f"library; the most exact one reaches {best:.0e} ({task}). Measure your own with "
            "spatial_pin.tradeoff(mechanism, task) and pass it as `measured`")


def _of_simulation(
    looser: tuple[float, Accuracy], tighter: tuple[float, Accuracy], error: float
) -> Accuracy:
    """Return the setting of a simulation for an error between those that two settings keep.

    Errors go with a power of the time_tolerance in between. Samples have a part of the error.
    """
    (most, first), (least, last) = looser, tighter
    error = min(error, most)
    part = math.log(error / most) / math.log(least / most) if least < most else 0.0
    steps = first.time_tolerance * (last.time_tolerance / first.time_tolerance) ** part
    samples = PART_OF_SAMPLES * error
    return replace(
        last, time_tolerance=float(f"{steps:.1e}"),
        tolerance=float(f"{samples:.1e}") if samples >= BETWEEN_ANCHORS else last.tolerance)


def accuracy_of(given: Accuracy | None) -> Accuracy:
    """Return the settings given, "engineering" where there are none.

    Raises:
        TypeError: they are something else.
    """
    if given is None:
        return LEVELS["engineering"]
    if not isinstance(given, Accuracy):
        example = given if isinstance(given, str) and given in LEVELS else "engineering"
        raise TypeError(f"accuracy is {given!r}; give it as spatial_pin.Accuracy, for example "
                        f"Accuracy.named({example!r})")
    return given


def _check_name(what: str, name: str, known: Iterable[str]) -> None:
    if not isinstance(name, str) or name not in known:
        raise ValueError(f"no {what} {name!r}; there are {', '.join(known)}")


LEVELS = {
    "draft": Accuracy(tolerance=1e-8, time_tolerance=1e-8),
    "engineering": Accuracy(),
    "reference": Accuracy(tolerance=1e-15, time_tolerance=1e-13),
}

INTERPOLATED = 1e-9  # tolerance from which on samples of a sweep are interpolated, to that error
LOOSEST = 1e-2  # of these: farther apart, points would not be predicted
# Closure tolerance of a simulation from which on most samples are interpolated. Below it hardly one
# is closed well enough.
BETWEEN_ANCHORS = 1e-11
# Part of the error of a simulation that is the tolerance of its samples: accelerations of those
# that are interpolated are off by a few hundred times as much.
PART_OF_SAMPLES = 2e-4
# error that each setting keeps, the cheapest first, as printed by scripts/accuracy_table.py
MEASURED: dict[str, tuple[tuple[float, Accuracy], ...]] = {
    "sweep": (
        (7e-12, Accuracy(tolerance=1e-12)),
        (4e-13, Accuracy()),
    ),
    "simulate": (
        (0.006, Accuracy(tolerance=1e-08, time_tolerance=1e-06)),
        (0.0003, Accuracy(tolerance=1e-09, time_tolerance=1e-07)),
        (9e-06, Accuracy(tolerance=1e-10, time_tolerance=1e-08)),
        (7e-07, Accuracy(tolerance=1e-11, time_tolerance=1e-09)),
        (9e-08, Accuracy(tolerance=1e-12, time_tolerance=1e-10)),
        (3e-09, Accuracy(time_tolerance=1e-11)),
        (1e-09, Accuracy(time_tolerance=1e-12)),
        (4e-11, Accuracy(tolerance=1e-15, time_tolerance=1e-13)),
    ),
}
