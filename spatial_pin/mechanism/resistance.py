"""Resistance to the motion of joints: viscous damping and dry friction.

    force = -damping v - friction tanh(v / slip speed)

of every coordinate with velocity v, as a part of it. Dry (Coulomb) friction is a step at v = 0; the
step is smoothed over the slip speed. At three slip speeds friction has all but 0.5 % of its value,
at twenty all of it to round-off. So there is no friction at rest: a load that friction should hold
creeps. A load of half the friction creeps at 0.55 slip speeds.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spatial_pin._support.checks import positive_number
from spatial_pin.mechanism.coordinates import coordinates_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

# Speed at which dry friction has its full size [rad/s, characteristic lengths per second]: a
# thousandth of the speed of a slow machine. No integrator can follow a jump.
SLIP_SPEED = 1e-3

SlipSpeed = float | Mapping[str, float]


class Resistance:
    """Damping and dry friction of a mechanism's joints.

    Args:
        mechanism: the mechanism.
        slip_speed: instead of the file's: of all coordinates [rad/s, characteristic lengths per
            second], or by driver, joint or coordinate [rad/s, m/s], positive.

    Attributes:
        damping, friction, slip_speed: (nv,).
        at: indices of the coordinates that have any.
    """

    def __init__(self, mechanism: Mechanism, slip_speed: SlipSpeed | None = None) -> None:
        model = mechanism.model
        self.damping, self.friction = model.damping.copy(), model.upperDryFrictionLimit.copy()
        total = SLIP_SPEED * mechanism.velocity_scale
        if mechanism.slip_speeds.size:
            total = np.where(np.isnan(mechanism.slip_speeds), total, mechanism.slip_speeds)
        if isinstance(slip_speed, Mapping):
            for name, value in slip_speed.items():
                at = [c.v for c in coordinates_of(mechanism, name)]
                total[at or [mechanism.coordinate(name).v]] = positive_number(
                    value, f"slip_speed of {name!r}")
        elif slip_speed is not None:
            total = positive_number(slip_speed, "slip_speed") * mechanism.velocity_scale
        self.slip_speed = total
        self.at = np.flatnonzero((self.damping != 0.0) | (self.friction != 0.0))

    def __bool__(self) -> bool:
        return bool(self.at.size)

    def forces(self, v: Array) -> Array:
        """Return the joint forces (nv,) at joint velocities v (nv,) [N·m, N]."""
        return -self.damping * v - self.friction * np.tanh(v / self.slip_speed)

    def slopes(self, v: Array) -> Array:
        """Return the damping coefficients -d force / d v (nv,), never negative."""
        held = np.tanh(v / self.slip_speed)
        return self.damping + self.friction / self.slip_speed * (1.0 - held * held)


def resistance_texts(mechanism: Mechanism) -> dict[str, str]:
    """Return damping, dry friction and armature of each coordinate that has any, as text."""
    resistance, texts = Resistance(mechanism), {}
    for c in mechanism.coordinate_table.values():
        turns = c.unit == "rad"
        force, per = ("N·m", "rad") if turns else ("N", "m")
        values = [
            (resistance.damping[c.v], "damping", f"{force}·s/{per}"),
            (resistance.friction[c.v], "dry friction", force),
            (mechanism.model.armature[c.v], "armature", "kg·m²" if turns else "kg"),
        ]
        parts = [f"{what} {x:g} {unit}" for x, what, unit in values if x != 0.0]
        if resistance.friction[c.v]:
            parts.append(f"slip speed {resistance.slip_speed[c.v]:g} {per}/s")
        if parts:
            texts[c.name] = ", ".join(parts)
    return texts


def resists(mechanism: Mechanism, joint: int) -> bool:
    """Whether joint number `joint` has damping, dry friction or armature."""
    model = mechanism.model
    v = slice(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint])
    return any(bool(np.any(x[v])) for x in (
        model.damping, model.upperDryFrictionLimit, model.armature))
