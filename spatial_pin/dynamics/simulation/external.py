"""Forces from outside over time: constant, in rows that belong to times, or a function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import as_array, is_finite, mapping
from spatial_pin.assembly.state import State
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

WrenchLaw = Callable[[float, State], Mapping[str, pin.Force]]


class External(NamedTuple):
    """Forces at frames, world axes, force and moment at the frame's origin.

    Attributes:
        law: of the time and the State, by frame.
        is_steady: whether they are constant.
        longest_step: of an integrator that is to leap over no row [s].
    """

    law: WrenchLaw
    is_steady: bool = False
    longest_step: float = np.inf


def external_forces(mechanism: Mechanism, given: Any, times: Array) -> External | None:
    """Return what `simulate` is given as forces from outside; None if there are none.

    Args:
        mechanism: whose frames they act at.
        given: by frame a `pin.Force` or rows (N, 6); or a function of the time and the State.
        times: (N,) that the rows belong to.

    Raises:
        UnknownNameError: there is no such frame.
        ValueError: rows are not as many as the times, or not finite.
    """
    if callable(given):
        return External(lambda t, state: mapping(given(t, state), "external"))
    forces: dict[str, pin.Force] = {}
    tables: dict[str, Array] = {}
    for name, force in mapping(given, "external").items():
        mechanism.frame_id(name)
        if isinstance(force, pin.Force):
            forces[name] = force
        else:
            tables[name] = _rows(name, force, times)
    if not tables:
        return External(lambda t, state: forces, is_steady=True) if forces else None

    def law(t: float, state: State) -> Mapping[str, pin.Force]:
        return forces | {
            name: pin.Force(np.array([np.interp(t, times, column) for column in rows.T]))
            for name, rows in tables.items()}

    return External(law, longest_step=float(np.diff(times).min(initial=np.inf)))


def _rows(name: str, force: Any, times: Array) -> Array:
    rows = as_array(force, f"external force at {name!r}")
    if rows.shape != (len(times), 6):
        raise ValueError(
            f"external force at {name!r} has shape {rows.shape}; give a pin.Force, or a row of "
            f"force and moment for each of the {len(times)} times: ({len(times)}, 6)")
    if not is_finite(rows):
        raise ValueError(f"external force at {name!r} is NaN or infinite")
    return rows
