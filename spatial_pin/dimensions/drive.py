"""The drivers' motion of a state, which other dimensions do not change."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.dynamics.outputs import Told
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.limits import limits
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.outputs import is_force, is_of_whole
from spatial_pin.rates.rates import solve_rates


def end_of_range(output: str) -> tuple[str, str] | None:
    """Return which end ("lower" or "upper") of which driver's range an output is; None if none."""
    kind, _, rest = output.partition(".")
    end, _, driver = rest.partition(".")
    return (end, driver) if kind == "limit" and end in ("lower", "upper") else None


def with_forces(outputs: Iterable[str]) -> bool:
    """Whether one of the outputs is a force."""
    return any(is_force(output) for output in outputs)


def with_masses(mechanism: Mechanism, outputs: Iterable[str]) -> bool:
    """Whether one of the outputs depends on masses: a force, or what is of all links together."""
    return any(is_force(output) or is_of_whole(mechanism, output) for output in outputs)


@dataclass(frozen=True)
class Drive:
    """The drivers' motion at a state: values, speeds, accelerations, keyed by coordinate.

    Attributes:
        driver: whose speed ratios are relative to.
        in_time: whether rates are those in time; where they are not, forces are those at rest.
    """

    driver: str
    values: dict[str, float]
    speeds: dict[str, float]
    accelerations: dict[str, float]
    in_time: bool = True

    @classmethod
    def of(cls, state: State, driver: str = "", held: Iterable[str] = ()) -> Drive:
        """Return the motion of a mechanism's drivers, or of what else is held, in a state."""
        mechanism = state.mechanism
        names = list(held) or [d.joint for d in mechanism.drivers.values()]
        rates = {name: state.coordinate(name) for name in names}
        first = driver or next(iter(mechanism.drivers), next(iter(mechanism.coordinates), ""))
        values, speeds, accelerations = (
            {name: r[k] for name, r in rates.items()} for k in range(3))
        return cls(first, values, speeds, accelerations, state.in_time)

    @property
    def moves(self) -> bool:
        """Whether anything does."""
        return any(self.speeds.values()) or any(self.accelerations.values())

    def evaluate(self, mechanism: Mechanism, near: State, outputs: Sequence[str]) -> list[Any]:
        """Return outputs of a mechanism whose drivers move as here.

        Args:
            mechanism: the mechanism.
            near: a closed state of it at these or other dimensions, whose branch is followed.
            outputs: as for `sensitivity`.
        """
        told: Told | None = None
        found = []
        for output in outputs:
            end = end_of_range(output)
            if end is not None:
                bound = getattr(limits(mechanism, end[1], near), end[0])
                if bound.kind == "none":
                    raise SpatialPinError(f"mechanism {mechanism.name!r}: {end[1]!r} has no limit")
                found.append(bound.value)
                continue
            if told is None:
                told = self.told(self._state(mechanism, near))
            values = told.output(output).values[0]
            found.append(float(values) if np.ndim(values) == 0 else values)
        return found

    def _state(self, mechanism: Mechanism, near: State) -> State:
        state = followed(mechanism, self.values, near)
        return solve_rates(mechanism, state, self.speeds, self.accelerations) if (
            self.moves) else state

    def told(self, state: State) -> Told:
        """Return what a state tells by the names of outputs."""
        value, speed, _ = state.coordinate(self.driver)
        return Told(Motion(
            state.mechanism, np.array([value]), self.driver, None, state.q[None], state.v[None],
            state.a[None], np.array([state.closure_error]), np.array([speed]),
            angles=np.array(state.angles)[None]), self.in_time)
