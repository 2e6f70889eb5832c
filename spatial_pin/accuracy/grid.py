"""The settings that a trade-off tries."""

from __future__ import annotations

from spatial_pin._support.brief import counted
from spatial_pin.settings import LEVELS, Accuracy

CLOSURES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-10, 1e-12, 1e-13, 1e-15)  # of order 3
FEWER = (1e-4, 1e-8, 1e-13)  # of lower ones
CORRECTIONS = (0, 1, 2)
TIME_TOLERANCES = {  # by formulation and integrator
    ("independent", "DOP853"): (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12),
    ("independent", "RK45"): (1e-3, 1e-4, 1e-6, 1e-8),
    ("independent", "LSODA"): (1e-4, 1e-6, 1e-8, 1e-10),
    ("independent", "Radau"): (1e-3, 1e-5, 1e-7),
    ("independent", "BDF"): (1e-4, 1e-6),
    ("projected", "DOP853"): (1e-4, 1e-6, 1e-8, 1e-10),
}
STEPS = {  # fixed steps relative to the mean step of the reference
    ("independent", "RK4"): (4.0, 2.0, 1.0, 0.5),
    ("independent", "Gauss"): (4.0, 1.0),
    ("projected", "RK4"): (2.0,),
}
# Closure tolerance relative to the tolerance in time, between 1e-13 and 1e-8: a hundred steps leave
# less by it than by the other.
SAFETY = 1e-2


def sweep_settings() -> list[Accuracy]:
    """Return predictor orders with fixed corrections, and with corrections to tolerances."""
    fixed = [Accuracy(order=order, corrections=n) for order in range(4) for n in CORRECTIONS
             if order or n]
    converged = [Accuracy(order=order, tolerance=x) for order in range(4)
                 for x in (CLOSURES if order == 3 else FEWER)]
    return _distinct([*_named("tolerance"), *converged, *fixed])


def simulation_settings(step: float) -> list[Accuracy]:
    """Return integrators with tolerances, or with steps by a mean step [s]."""
    adaptive = [
        Accuracy(tolerance=float(f"{min(1e-8, max(1e-13, SAFETY * x)):.1e}"),
                 formulation=formulation, integrator=integrator, time_tolerance=x)
        for (formulation, integrator), tolerances in TIME_TOLERANCES.items() for x in tolerances]
    fixed = [
        Accuracy(formulation=formulation, integrator=integrator, step=float(f"{step * x:.2g}"))
        for (formulation, integrator), factors in STEPS.items() for x in factors]
    return _distinct([*LEVELS.values(), *adaptive, *fixed])


def _named(*names: str) -> list[Accuracy]:
    """Return the named levels as far as these attributes go."""
    return [Accuracy(**{name: getattr(level, name) for name in names}) for level in LEVELS.values()]


def _distinct(settings: list[Accuracy]) -> list[Accuracy]:
    return list(dict.fromkeys(settings))


def power(x: float) -> str:
    """Return a number as 1e-8, with two digits at most."""
    mantissa, exponent = f"{x:.1e}".split("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def describe(accuracy: Accuracy, kind: str) -> str:
    """Return a setting in words, for a "sweep" or for "simulate"."""
    same: tuple[str, ...] = ("order", "corrections", "tolerance")
    if kind == "sweep":
        n = accuracy.corrections
        words = f"to {power(accuracy.tolerance)}" if n is None else counted(n, "correction")
        text = f"order {accuracy.order}, {words}"
    else:
        dial = (f"step {accuracy.step:.3g} s" if accuracy.step is not None
                else power(accuracy.time_tolerance))
        projected = "projected " if accuracy.formulation == "projected" else ""
        text = f"{projected}{accuracy.integrator} {dial}"
        same = tuple(accuracy.__dataclass_fields__)
    level = next((name for name, x in LEVELS.items()
                  if all(getattr(x, key) == getattr(accuracy, key) for key in same)), None)
    return f"{text} ({level})" if level else text
