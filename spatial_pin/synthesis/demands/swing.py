"""How far an output goes to and fro, and where it stands still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.demands.candidate import SHORT_OF_LIMITS, Candidate
from spatial_pin.synthesis.demands.demand import Moving


@dataclass(frozen=True, eq=False, kw_only=True)
class Swing(Moving):
    """How far an output goes to and fro."""

    output: str
    angle: float
    _words, is_one_sided = "swing of {0.output}", False

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return str(mechanism.coordinate(self.output).unit)

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        mechanism.coordinate(self.output)

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: by the coordinate's own size."""
        motion, is_turn = self.motion(candidate)
        size = motion.mechanism.velocity_scale[motion.mechanism.coordinate(self.output).v]
        least, most = _ends(motion, self.output, is_turn or self.at is not None)
        return np.array([(most - least - self.angle) / size])

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        return np.abs(values) * mechanism.velocity_scale[mechanism.coordinate(self.output).v]


def _ends(motion: Motion, output: str, is_turn: bool) -> tuple[float, float]:
    """Return the least and the largest value of a coordinate over a motion.

    Where its rate changes sign, the cubic through both samples tells where it turns back; from the
    configuration there what is left of its rate v and its derivative a tell the rest: v²/2a.
    At a limit, a distance d beyond the last sample, x = x0 + c sqrt(d) + e d.
    """
    value, rate, acceleration = motion.coordinate(output)
    assert motion.driver_name is not None
    found, at = [value.min(), value.max()], motion.swept
    for k in np.flatnonzero(rate[:-1] * rate[1:] < 0.0):
        span = at[k + 1] - at[k]
        u = _turning(value[k + 1] - value[k], span * rate[k], span * rate[k + 1])
        there = sweep(motion.mechanism, motion.driver_name, [at[k] + u * span],
                      guess=motion.state(int(k))).coordinate(output)
        x, v, a = (float(part[0]) for part in there)
        found.append(x - 0.5 * v * v / a if a else x)
    if not is_turn:
        d = SHORT_OF_LIMITS * (at[-1] - at[0]) / (1.0 - 2.0 * SHORT_OF_LIMITS)
        found += [value[k] + sign * d * rate[k] + 2.0 * d * d * acceleration[k]
                  for k, sign in ((0, -1.0), (-1, 1.0))]
    return min(found), max(found)


def _turning(rise: float, first: float, last: float) -> float:
    """Return where in (0, 1) the cubic of a rise, with slopes of opposite sign, is level."""
    a, b, c = 3.0 * (first + last - 2.0 * rise), 2.0 * (3.0 * rise - 2.0 * first - last), first
    root = np.sqrt(max(b * b - 4.0 * a * c, 0.0))
    ways = np.array([2.0 * c / (-b + sign * root) if -b + sign * root else np.inf
                     for sign in (1.0, -1.0)])
    return float(np.clip(ways[np.argmin(np.abs(ways - 0.5))], 0.0, 1.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class DeadCentres(Moving):
    """That an output stands still at values of the driver."""

    output: str
    _words, _unit = "dead centres of {0.output}", "output per driver"
    is_one_sided = False

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        output, driver = mechanism.coordinate(self.output), self.moved_by(mechanism)
        if output.name == mechanism.driven_coordinate(driver).name:
            raise ValueError(f"{self.name}: it is the driver itself; for its own dead centres name "
                             "it as the output of another joint's motion")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: speed ratios, each by the coordinates' sizes."""
        motion, _ = self.motion(candidate)
        mechanism, scale = motion.mechanism, motion.mechanism.velocity_scale
        driver = mechanism.driven_coordinate(self.moved_by(mechanism))
        rates = motion.v[:, mechanism.coordinate(self.output).v] / motion.v[:, driver.v]
        return rates * scale[driver.v] / scale[mechanism.coordinate(self.output).v]
