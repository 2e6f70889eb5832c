"""Whether there are as many drivers as freedoms, and what to do where there are not."""

from __future__ import annotations

import numpy as np

from spatial_pin._support.brief import counted
from spatial_pin.assembly.holding import still_entries
from spatial_pin.assembly.state import State
from spatial_pin.assembly.undetermined import check_loops
from spatial_pin.constraints.closure_equations import evaluated
from spatial_pin.errors import MechanismFileError
from spatial_pin.mechanism.coordinates import driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.mobility.idle_freedoms import idle_freedoms
from spatial_pin.mobility.mobility import Mobility
from spatial_pin.numerics.linalg import Array, common_rows, null_space
from spatial_pin.numerics.tolerances import TOLERANCES


def driver_advice(state: State, found: Mobility) -> str:
    """Return what to do where drivers and freedoms differ in number; "" where they do not.

    Raises:
        MechanismFileError: it has drivers and cannot move.
    """
    mechanism = state.mechanism
    drivers = list(driver_coordinates(mechanism).values())
    working = found.dof - len(found.passive)
    free = working - len(still_entries(mechanism, drivers))
    missing = free - len(drivers)
    said = f"{counted(len(drivers), 'driver')} for {counted(working, 'working freedom')}"
    if not free and drivers:
        raise MechanismFileError(
            f"{mechanism.path}: it cannot move: {said}; {check_loops(mechanism)}")
    if not free and mechanism.closures:
        return f"it is a structure, which cannot move; if it is to, {check_loops(mechanism)}"
    if not missing:
        return ""
    if missing < 0:
        return f"{said}; leave out {-missing}: {_needless(mechanism, state, drivers)}"
    names = _undriven(mechanism, state, drivers, missing)
    tables = ", ".join(f'[drivers.NAME] joint = "{name}"' for name in names)
    return f"{said}; add {counted(missing, 'driver')}{', such as ' * bool(names)}{tables}"


def _needless(mechanism: Mechanism, state: State, drivers: list[Coordinate]) -> str:
    """Return the drivers that follow from those before them."""
    rows = _tangents(mechanism, state).T[[c.v for c in drivers]]
    kept = common_rows(rows[None], np.zeros((0, rows.shape[1])), len(drivers))
    return ", ".join(f"[drivers.{name}]" for k, name in enumerate(mechanism.drivers)
                     if k not in kept)


def _undriven(
    mechanism: Mechanism, state: State, drivers: list[Coordinate], count: int
) -> list[str]:
    """Return coordinates that are independent of the drivers and move no passive freedom."""
    rows = _tangents(mechanism, state).T
    evaluation = evaluated(mechanism, state.q, state.angles)
    idle = [v for _, velocities in idle_freedoms(evaluation, state.q) for v in velocities]
    still = np.abs(np.array(idle)).max(axis=0, initial=0.0) if idle else np.zeros(len(rows))
    free = [c for c in mechanism.coordinate_table.values()
            if still[c.v] < TOLERANCES.half_precision and c.v not in still_entries(
                mechanism, drivers)]
    given = rows[[c.v for c in drivers] + list(still_entries(mechanism, drivers))]
    chosen = common_rows(rows[[c.v for c in free]][None], given, count)
    return [free[k].name for k in chosen]


def _tangents(mechanism: Mechanism, state: State) -> Array:
    """Return (freedoms, nv) velocities at which the loops stay closed."""
    evaluation = evaluated(mechanism, state.q, state.angles)
    return null_space(evaluation.jacobian[: evaluation.constraints.n_closure],
                      TOLERANCES.half_precision)
