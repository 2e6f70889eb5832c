"""The RSSR four-bar turned once, and its closed form: what the tools are judged by.

The crank turns at constant speed; loops are closed to 1e-12 m; position, velocity and acceleration
of every coordinate are kept. Errors are measured outside the clock.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

MAX_CORRECTIONS = 30  # Newton steps from the rough guess; two suffice after the first angle
STEPS = (360, 3600)  # crank angles in one turn
SHORT = (1, 36)  # the same where every call counts
FEW = 9  # the second of these is the one closed state


class Answer(NamedTuple):
    """What one row found, one entry per crank angle; None where the row does not solve for it.

    Attributes:
        closure: (N,) distance between the two halves of the cut joint [m].
        angle: (N,) rocker angle [rad].
        rate: (N,) [rad/s].
        acceleration: (N,) [rad/s²].
        omega: (N, 3) angular velocity of the coupler, world axes [rad/s].
        alpha: (N, 3) angular acceleration of the coupler, world axes [rad/s²].
    """

    closure: Any = None
    angle: Any = None
    rate: Any = None
    acceleration: Any = None
    omega: Any = None
    alpha: Any = None


@dataclass(frozen=True)
class Problem:
    """Crank about +y at the origin, rocker about -z at (-d, 0, 0), coupler of length b between.

    A = (-a cos φ, 0, a sin φ), B = (-d - c cos ψ, c sin ψ, 0). The coupler does not spin about AB.
    """

    a: float = 0.102
    b: float = 0.381
    c: float = 0.254
    d: float = 0.314
    steps: int = 360
    speed: float = 25.13  # [rad/s]
    guess: float = 1.23  # rocker angle near the first closed position [rad]
    tolerance: float = 1e-12  # [m]

    @cached_property
    def phi(self) -> Array:
        """(N,) crank angles [rad]."""
        return np.linspace(0.0, 2.0 * np.pi, self.steps + 1)[:-1]

    @property
    def time_step(self) -> float:
        """Time between two crank angles [s]."""
        return 2.0 * math.pi / self.steps / self.speed

    def crank_path(self) -> Array:
        """Return (N, 3, 3): position, velocity and acceleration of A at every crank angle."""
        s, c, w = self.a * np.sin(self.phi), self.a * np.cos(self.phi), self.speed
        path = np.zeros((self.steps, 3, 3))
        path[:, 0, 0], path[:, 0, 2] = -c, s
        path[:, 1, 0], path[:, 1, 2] = w * s, w * c
        path[:, 2] = -w * w * path[:, 0]
        return path

    def guessed_coupler(self) -> Array:
        """Return a (3, 3) rotation whose first column points from A to B at the guess."""
        rocker = np.array([-math.cos(self.guess), math.sin(self.guess), 0.0])
        x = np.array([self.a - self.d, 0.0, 0.0]) + self.c * rocker
        x /= np.linalg.norm(x)
        y = np.array([-x[1], x[0], 0.0])
        return np.column_stack([x, y, np.cross(x, y)])

    def rocker_to_coupler(self) -> Array:
        """Return the guessed rotation (3, 3) of the coupler in the rocker's axes."""
        s, c = math.sin(self.guess), math.cos(self.guess)
        turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return turned @ self.guessed_coupler()

    def exact(self) -> Answer:
        """Return the closed form.

        cos ψ = n/m with n = b² - a² - c² - d² + 2ad cos φ and m = 2c(d - a cos φ); the rates follow
        from differentiating m cos ψ = n twice.
        """
        a, b, c, d, w = self.a, self.b, self.c, self.d, self.speed
        sin, cos = np.sin(self.phi), np.cos(self.phi)
        n, n1, n2 = (
            b * b - a * a - c * c - d * d + 2 * a * d * cos,
            -2 * a * d * w * sin,
            -2 * a * d * w * w * cos,
        )
        m, m1, m2 = 2 * c * (d - a * cos), 2 * a * c * w * sin, 2 * a * c * w * w * cos
        u = n / m
        u1 = (n1 - u * m1) / m
        u2 = (n2 - 2 * u1 * m1 - u * m2) / m
        psi = np.arccos(u)
        rate = -u1 / np.sin(psi)
        acceleration = -(u2 + u * rate**2) / np.sin(psi)
        return Answer(None, psi, rate, acceleration, *self._coupler(psi, rate, acceleration))

    def _coupler(self, psi: Array, rate: Array, acceleration: Array) -> tuple[Array, Array]:
        zero = np.zeros_like(psi)
        radial = self.c * np.column_stack([-np.cos(psi), np.sin(psi), zero])
        tangent = self.c * np.column_stack([np.sin(psi), np.cos(psi), zero])
        path = self.crank_path()
        r = radial - [self.d, 0.0, 0.0] - path[:, 0]
        r1 = tangent * rate[:, None] - path[:, 1]
        r2 = tangent * acceleration[:, None] - radial * rate[:, None] ** 2 - path[:, 2]
        return np.cross(r, r1) / self.b**2, np.cross(r, r2) / self.b**2


NAMES = {"closure": "closure", "angle": "ψ", "rate": "ψ'", "acceleration": "ψ''", "omega": "ω",
         "alpha": "α"}


def judge(problem: Problem, fields: Iterable[Any]) -> dict[str, float | None]:
    """Return the largest error of each field of an Answer; the closure is an error itself."""
    errors: dict[str, float | None] = {}
    for (field, name), got, true in zip(NAMES.items(), Answer(*fields), problem.exact(),
                                        strict=True):
        off = None if got is None else got if field == "closure" else got - true
        errors[name] = None if off is None else float(np.abs(off).max())
    return errors


def judge_row(
    problem: Problem, fields: Iterable[Any], row: int
) -> dict[str, float | None]:
    """Return the errors of fields of one row only, that of crank angle `row`."""
    full = Answer(*problem.exact())
    errors: dict[str, float | None] = {}
    for (field, name), got, true in zip(NAMES.items(), Answer(*fields), full, strict=True):
        off = None if got is None else got if field == "closure" else got[0] - true[row]
        errors[name] = None if off is None else float(np.abs(off).max())
    return errors


def spin_error(problem: Problem, turned: Array, row: int) -> float:
    """Return the error of the coupler's angular velocity (3,) per unit crank speed."""
    omega = problem.exact().omega
    return float(np.abs(turned - omega[row] / problem.speed).max())
