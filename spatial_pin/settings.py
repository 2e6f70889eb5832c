"""Accuracy settings: one small frozen object, used wherever speed is traded for accuracy."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Accuracy:
    """How exactly loops are closed and motions are followed.

    Attributes:
        order: order of the Taylor predictor of a followed motion, 0 to 3 (the third derivative
            is a difference of two accelerations).
        corrections: number of Newton corrections at each step; None corrects until `tolerance`.
        tolerance: closure residual to reach [-], relative to the characteristic length.
        formulation: of `simulate`: "independent" (coordinates, the loops closed inside) or
            "projected" (all joint coordinates, taken back to closed loops after every step).
        integrator: of `simulate`: "DOP853", "RK45", "Radau", "BDF", "LSODA", "RK4" or "Gauss".
        time_tolerance: error that adaptive integrators allow in one step [rad, characteristic
            lengths, and these per second], absolute and relative.
        step: fixed step of "RK4" and "Gauss", longest step of the others [s].

    Equal steps are taken many at a time, two to three times faster, with order 3 to tolerance only.
    """

    order: int = 3
    corrections: int | None = None
    tolerance: float = 1e-13
    formulation: str = "independent"
    integrator: str = "DOP853"
    time_tolerance: float = 4e-12
    step: float | None = None

    def __post_init__(self) -> None:
        if self.order not in (0, 1, 2, 3):
            raise ValueError(f"order is {self.order}; the predictor has orders 0 to 3")
        if self.corrections is not None and self.corrections < 0:
            raise ValueError(f"corrections is {self.corrections}; it cannot be negative")
        if self.order == 0 and self.corrections == 0:
            raise ValueError("order 0 without corrections moves nothing but the driver")
        if not (math.isfinite(self.tolerance) and self.tolerance > 0.0):
            raise ValueError(f"tolerance is {self.tolerance}; it must be positive")
        if not (math.isfinite(self.time_tolerance) and self.time_tolerance > 0.0):
            raise ValueError(f"time_tolerance is {self.time_tolerance}; it must be positive")
        if self.step is not None and not (math.isfinite(self.step) and self.step > 0.0):
            raise ValueError(f"step is {self.step}; it must be positive")

    @classmethod
    def named(cls, level: str) -> Accuracy:
        """Return the settings of a level: "draft", "engineering" or "reference".

        Raises:
            ValueError: there is no such level.
        """
        try:
            return LEVELS[level]
        except KeyError:
            raise ValueError(f"no accuracy level {level!r}; there are {sorted(LEVELS)}") from None


LEVELS = {
    "draft": Accuracy(tolerance=1e-8, time_tolerance=1e-6),
    "engineering": Accuracy(),
    "reference": Accuracy(tolerance=1e-15, time_tolerance=1e-13),
}
