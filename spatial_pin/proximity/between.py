"""Configurations between the samples of a motion."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.assemble import assembled
from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.hermite import quintic
from spatial_pin.numerics.linalg import Array


class Between:
    """Goes from each sample of a motion to the next.

    Joint coordinates follow Hermite's polynomials of fifth degree, through the configurations,
    rates and accelerations of both samples; ball and floating joints those of third degree, in the
    rotation vectors from the first sample. Where a driver was swept, `closed` closes the loops
    there at its value.

    Args:
        motion: of two samples at least, or no way is asked for.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion, self.model = motion, motion.mechanism.model
        self.driver = (motion.mechanism.prescribed_coordinate(motion.driver_name)
                       if motion.driver is not None else None)
        table = motion.mechanism.coordinate_table.values()
        self._is_linear = np.array([c.q >= 0 for c in table], dtype=bool)
        self._turns = np.array([c.unit == "rad" for c in table], dtype=bool)
        self._powers, self._at_first = np.arange(6), np.zeros(self.model.nv)

    def at(self, row: int, part: float) -> Array:
        """Return the configuration (nq,) a part, 0 to 1, of the way from a sample to the next."""
        q0, q1 = self.motion.q[row], self.motion.q[row + 1]
        (slope0, slope1), bends = self._rates(row)
        way = pin.difference(self.model, q0, q1)
        slope1 = pin.dDifference(self.model, q0, q1, pin.ARG1) @ slope1
        u, v = part, 1.0 - part
        cubic = u * u * ((3.0 - 2.0 * u) * way - v * slope1) + u * v * v * slope0
        fifth = part**self._powers @ quintic((self._at_first, way), (slope0, slope1), bends)
        step = np.where(self._is_linear, fifth, cubic)
        return pin.integrate(self.model, q0, step)

    def turned(self, row: int) -> float:
        """Return the angle [rad] that all joints together turn, on the way to the next sample.

        It is that at the mean speed, or the speed at either sample, if that is larger.
        """
        way = pin.difference(self.model, *self.motion.q[row : row + 2])
        most = np.abs([way, *self._rates(row)[0]]).max(axis=0)
        return float(most[self._turns].sum())

    def closed(self, row: int, part: float) -> Array:
        """Return the configuration (nq,) with its loops closed at the driver's value."""
        q = self.at(row, part)
        if self.driver is None or self.motion.per == "length":
            return q
        try:
            state = assembled(self.motion.mechanism, {self.driver.name: self.value(row, part)}, q,
                              release=False)
        except SpatialPinError:  # beside a limit the driver's value may have no configuration
            return q
        return state.q

    def value(self, row: int, part: float) -> float:
        """Return the driver's value [rad or m] there; the time [s] where none was swept."""
        motion = self.motion
        if motion.driver is None:
            given = np.arange(len(motion)) if motion.time is None else motion.time
            return float((1.0 - part) * given[row] + part * given[min(row + 1, len(given) - 1)])
        if part == 0.0 or self._steps_in_time(row) or motion.per == "length":
            return float(motion.driver[row]) + self._driver_way(row, part)
        return float((1.0 - part) * motion.driver[row] + part * motion.driver[row + 1])

    def _driver_way(self, row: int, part: float) -> float:
        """Return how far the driver has come from a sample, where it is no parameter."""
        if part == 0.0 or self.driver is None:
            return 0.0
        moved = pin.difference(self.model, self.motion.q[row], self.at(row, part))
        return float(moved[self.driver.v])

    def _steps_in_time(self, row: int) -> bool:
        return self.motion.time is not None and self.motion.driver is not None and bool(
            np.any(self.motion.driver_speed[row : row + 2] != self.motion.driver_speed[row]))

    def _rates(self, row: int) -> tuple[Array, Array]:
        """Return slopes (2, nv) and bends (2, nv) at both samples for a way of length one."""
        motion = self.motion
        v, a = motion.v[row : row + 2], motion.a[row : row + 2]
        if motion.per == "length":
            scale = motion.mechanism.velocity_scale
            h = float(np.linalg.norm(pin.difference(self.model, *motion.q[row : row + 2]) / scale))
        elif motion.driver is None or self._steps_in_time(row):
            # without times rates are those per sample
            h = 1.0 if motion.time is None else float(motion.time[row + 1] - motion.time[row])
        else:
            assert self.driver is not None
            h = float(motion.driver[row + 1] - motion.driver[row])
            speed, gain = v[:, [self.driver.v]], a[:, [self.driver.v]]
            if not np.all(speed):
                return np.repeat(pin.difference(self.model, *motion.q[row : row + 2])[None], 2,
                                 axis=0), np.zeros_like(a)
            v, a = v / speed, (a - v * (gain / speed)) / (speed * speed)
        return h * v, h * h * a
