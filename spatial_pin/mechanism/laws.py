"""Laws of drivers: the value, rate and acceleration of a prescribed coordinate over time.

A law is a function of the time t [s] that returns (value, rate, acceleration) of the coordinate
[rad or m, per s, per s²]. These are the usual ones; any such function is a law.

Example:
    >>> dir(sp.laws)
    ['constant_speed', 'cycloid', 'polynomial', 'ramp', 'sine', 'spline']
    >>> mech = sp.load("four_bar")
    >>> drives = {"crank": sp.laws.constant_speed(0.0, 10.0)}  # [rad], [rad/s]
    >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.0}), {"crank": 10.0})
    >>> motion = sp.simulate(mech, state, 0.1, drives=drives)  # [s]
    >>> print(f"{motion.coordinate('crank').value[-1]:.3f} rad")
    1.000 rad
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from spatial_pin._support.checks import checked, finite_array, finite_number, positive_number

__all__ = ["constant_speed", "cycloid", "polynomial", "ramp", "sine", "spline"]
DriverLaw = Callable[[float], tuple[float, float, float]]


def __dir__() -> list[str]:
    return __all__


@checked
def constant_speed(start: float, speed: float) -> DriverLaw:
    """Return a law that moves on at constant speed.

    Args:
        start: value at time 0 [rad or m].
        speed: [rad/s or m/s].

    Raises:
        ValueError: a value is no finite number.

    Example:
        >>> law = sp.laws.constant_speed(0.5, 10.0)  # from 0.5 rad at 10 rad/s
        >>> law(0.1)  # after 0.1 s: value, rate, acceleration
        (1.5, 10.0, 0.0)
    """
    start, speed = finite_number(start, "start"), finite_number(speed, "speed")
    return lambda t: (start + speed * t, speed, 0.0)


@checked
def ramp(start: float, speed: float, rise_time: float) -> DriverLaw:
    """Return a law that speeds up from rest at constant acceleration, then keeps its speed.

    Args:
        start: value at time 0 [rad or m].
        speed: the constant speed [rad/s or m/s].
        rise_time: how long it speeds up, positive [s].

    Raises:
        ValueError: a value is no finite number, or the time not positive.

    Example:
        >>> law = sp.laws.ramp(0.0, 10.0, 0.5)  # to 10 rad/s within 0.5 s
        >>> law(0.25), law(1.0)  # value [rad], rate [rad/s], acceleration [rad/s²]
        ((0.625, 5.0, 20.0), (7.5, 10.0, 0.0))
    """
    start, speed = finite_number(start, "start"), finite_number(speed, "speed")
    rise_time = positive_number(rise_time, "rise_time")
    rate = speed / rise_time

    def law(t: float) -> tuple[float, float, float]:
        if t < rise_time:
            return start + 0.5 * rate * t * t, rate * t, rate
        return start + speed * (t - 0.5 * rise_time), speed, 0.0

    return law


@checked
def sine(mean: float, amplitude: float, frequency: float, phase: float = 0.0) -> DriverLaw:
    """Return the law mean + amplitude sin(2 pi frequency t + phase).

    Args:
        mean: value it swings about [rad or m].
        amplitude: largest distance from its middle [rad or m].
        frequency: [Hz].
        phase: at time 0 [rad].

    Raises:
        ValueError: a value is no finite number.

    Example:
        >>> law = sp.laws.sine(0.0, 0.2, 1.5)  # ± 0.2 rad at 1.5 Hz
        >>> [round(x, 4) for x in law(0.1)]  # rad, rad/s, rad/s² after 0.1 s
        [0.1618, 1.1079, -14.3724]
    """
    mean, amplitude = finite_number(mean, "mean"), finite_number(amplitude, "amplitude")
    phase = finite_number(phase, "phase")
    w = 2.0 * math.pi * finite_number(frequency, "frequency")

    def law(t: float) -> tuple[float, float, float]:
        s, c = math.sin(w * t + phase), math.cos(w * t + phase)
        return mean + amplitude * s, amplitude * w * c, -amplitude * w * w * s

    return law


@checked
def cycloid(start: float, end: float, rise_time: float) -> DriverLaw:
    """Return a law from rest to rest with a full sine of acceleration [Norton2009, 2.4].

    Args:
        start: value up to time 0 [rad or m].
        end: value from `rise_time` on [rad or m].
        rise_time: how long it takes, positive [s].

    Raises:
        ValueError: a value is no finite number, or the time not positive.

    Example:
        >>> law = sp.laws.cycloid(0.0, 1.0, 2.0)  # from 0 to 1 rad within 2 s
        >>> [round(x, 4) for x in law(1.0)]  # half of the travel: rad, rad/s, rad/s²
        [0.5, 1.0, 0.0]
    """
    start, end = finite_number(start, "start"), finite_number(end, "end")
    rise_time = positive_number(rise_time, "rise_time")
    stroke, w = end - start, 2.0 * math.pi / rise_time

    def law(t: float) -> tuple[float, float, float]:
        if not 0.0 <= t <= rise_time:
            return (start if t < 0.0 else end), 0.0, 0.0
        value = start + stroke * (t / rise_time - math.sin(w * t) / (2.0 * math.pi))
        return value, stroke / rise_time * (1.0 - math.cos(w * t)), (
            stroke / rise_time * w * math.sin(w * t))

    return law


@checked
def polynomial(coefficients: Sequence[float]) -> DriverLaw:
    """Return the law c0 + c1 t + c2 t² + ...

    Args:
        coefficients: (k,) c0 [rad or m], c1 [rad/s or m/s], ...; t is in seconds.

    Raises:
        ValueError: a value is no finite number, or there is none.

    Example:
        >>> law = sp.laws.polynomial([0.1, 0.0, 3.0])  # 0.1 + 3 t² [rad]
        >>> [round(x, 4) for x in law(2.0)]  # rad, rad/s, rad/s²
        [12.1, 12.0, 6.0]
    """
    if not len(coefficients):
        raise ValueError("coefficients is empty; a polynomial has at least c0")
    c = np.polynomial.Polynomial(finite_array(coefficients, (len(coefficients),), "coefficients"))
    first, second = c.deriv(), c.deriv(2)
    return lambda t: (float(c(t)), float(first(t)), float(second(t)))


@checked
def spline(times: Sequence[float], values: Sequence[float]) -> DriverLaw:
    """Return the quintic spline through values at times, at rest and unaccelerated at its ends.

    Args:
        times: (k,) rising [s].
        values: (k,) of the coordinate at these times [rad or m].

    Raises:
        ValueError: a value is no finite number, or the times are not two or more that rise.

    Example:
        >>> law = sp.laws.spline([0.0, 1.0, 2.0], [0.0, 0.8, 1.0])  # [s], [rad]
        >>> [round(x, 4) for x in law(2.0)]  # at rest at its end
        [1.0, 0.0, 0.0]
    """
    from scipy.interpolate import make_interp_spline  # imported on use: it takes half a second

    x = finite_array(times, (len(times),), "times")
    y = finite_array(values, (len(times),), "values")
    if not (np.diff(x) > 0.0).all() or len(x) < 2:
        raise ValueError(f"times must be two or more that rise, not {x.tolist()}")
    at_rest = [(1, 0.0), (2, 0.0)]
    value = make_interp_spline(x, y, k=5, bc_type=(at_rest, at_rest))
    first, second = value.derivative(1), value.derivative(2)

    def law(t: float) -> tuple[float, float, float]:
        if not x[0] <= t <= x[-1]:
            return float(y[0] if t < x[0] else y[-1]), 0.0, 0.0
        return float(value(t)), float(first(t)), float(second(t))

    return law
