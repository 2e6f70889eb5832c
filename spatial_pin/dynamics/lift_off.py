"""Where cams and their followers lift off: the contact would have to pull from there on."""

from __future__ import annotations

import numpy as np

from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.mechanism.inertia import moving_mass
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Event, Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.roots import between_samples, onsets

KIND = "lift off"
WEIGHT = 9.81  # m/s²: the weight is a scale of forces, where gravity is off too
NO_FORCE = 1e-9  # of the largest multiplier, or of the weight: what rounding leaves of none


def contacts_of(mechanism: Mechanism) -> dict[str, tuple[int, int]]:
    """Return by closure that pushes alone its equation, and the sign of a multiplier that pushes.

    The equation of a roller grows outwards of the cam, that of a face away from the cam, and that
    of two curves outwards of the first.
    """
    whole = mechanism.whole or mechanism
    rows = {name: k for k, name in enumerate(constraints_of(whole).closure_of)}
    signs = {}
    for c in whole.closures:
        both = c.numbers.get("curves")
        if both is not None:  # the second one is inside of the first, pushed inwards, or not
            signs[c.name] = -1 if both.side < 0 and both.two.length < both.one.length else 1
        follower = c.numbers.get("follower")
        if follower is not None:
            signs[c.name] = follower.side if follower.flat is None else 1
    return {name: (rows[name], sign) for name, sign in signs.items()}


def lift_offs(motion: Motion, multipliers: Array) -> list[Event]:
    """Return an event where each contact begins to pull, in their order.

    Args:
        motion: the motion, of N samples.
        multipliers: (N, n_closure) of the equations of its file.
    """
    mechanism, at, what = motion.mechanism, motion.driver, "at {:.9g} s"
    if at is not None:
        what = f"at {motion.driver_name} = {{:.9g}} {motion.driver_unit}"
    elif motion.time is not None:
        at = motion.time
    else:
        at, what = np.arange(len(motion), dtype=float), "in sample {:.9g}"
    size = mechanism.characteristic_length * moving_mass(mechanism.model)
    size = max(WEIGHT * size, float(np.abs(multipliers).max(initial=0.0)))
    events = []
    for name, (row, sign) in contacts_of(mechanism).items():
        push = sign * multipliers[:, row]
        pulls = push < -NO_FORCE * size
        for k in onsets(pulls):
            ends = np.flatnonzero(~pulls[k:])
            until = between_samples(at, push, k + int(ends[0])) if len(ends) else None
            value = between_samples(at, push, k) if k else float(at[0])
            events.append(Event(KIND, value, k, (
                f"{name} lifts off {what.format(value) if k else 'from the start'}: the contact "
                "would have to pull" + (f", and pushes again {what.format(until)}"
                                        if until is not None else ""))))
    return sorted(events, key=lambda event: event.row)
