"""A link that is dragged: which driver values bring a point of it nearest to the pointer."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.holding import BASE
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.errors import SpatialPinError
from spatial_pin.inverse_kinematics.reach import reach
from spatial_pin.inverse_kinematics.targets import Residual, Target
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.page.drive import Drive

NUDGE = 0.05  # away from a dead centre [rad, characteristic lengths]: its square moves the link
STILL = 1e-6  # of a driver that does not move [rad or m]
OFF_POINTER = 1e-3  # of a point from the pointer [characteristic lengths]: a pixel or two


@dataclass(frozen=True, eq=False, kw_only=True)
class Grip(Target):
    """A point of a body on a line of the world: where the eye sees the pointer.

    Attributes:
        joint: number of the joint that the body hangs on.
        point: in the joint's frame, shape (3,) [m].
        origin: of the line, shape (3,) [m].
        direction: unit vector along it, shape (3,).
    """

    joint: int
    point: Array
    origin: Array
    direction: Array

    def residual(self, evaluation: Evaluation) -> Residual:
        """See `Target`: how far the point is from the line, by the characteristic length."""
        at = evaluation.data.oMi[self.joint].act(self.point)
        moved = evaluation.body_jacobian(self.joint)
        slope = moved[:3] - pin.skew(at) @ moved[3:]
        across = np.eye(3) - np.outer(self.direction, self.direction)
        size = evaluation.mechanism.characteristic_length
        origin = self.origin - evaluation.mechanism.centre
        return across @ (at - origin) / size, across @ slope / size

    def check(self, mechanism: Mechanism) -> None:
        """See `Target`: it names no frame."""


    def distance(self, state: State) -> float:
        """Return how far the point is from the line [m]."""
        at = state.data.oMi[self.joint].act(self.point)
        return float(np.linalg.norm(np.cross(at - self.origin, self.direction)))


def pulled(drive: Drive, grip: Grip) -> dict[str, float]:
    """Return the driver values [rad or m] at which a point is nearest to the pointer.

    Drivers without a slider, and all else that is held, stay where they are. Nothing is returned
    where nothing better is found.
    """
    nearest = found = _reached(drive, drive.state, {"grip": grip})
    for nudge in (NUDGE, -NUDGE) if _is_stuck(drive, found, grip) else ():
        name, = drive.names
        size = drive.mechanism.velocity_scale[drive.mechanism.driven_coordinate(name).v]
        beside = _reached(drive, drive.state, {name: drive.value(name) + nudge * size})
        found = beside and _reached(drive, beside, {"grip": grip})
        if found and (nearest is None or grip.distance(found) < 0.9 * grip.distance(nearest)):
            nearest = found
    return {} if nearest is None else drive.values(nearest)


def _reached(drive: Drive, start: State, targets: Mapping[str, Any]) -> State | None:
    """Return the configuration near another that meets targets; None where there is none."""
    with contextlib.suppress(SpatialPinError):
        return reach(drive.mechanism, targets, start, hold=[BASE, *drive.others()],
                     limits=drive.keeps_limits, starts=0)
    return None


def _is_stuck(drive: Drive, found: State | None, grip: Grip) -> bool:
    """Whether a point stays where it is, far from the pointer: its link is at a dead centre."""
    if found is None or len(drive.names) > 1:
        return False
    size = drive.mechanism.characteristic_length
    moved = abs(drive.values(found)[drive.names[0]] - drive.value(drive.names[0]))
    return moved < STILL and grip.distance(found) > OFF_POINTER * size
