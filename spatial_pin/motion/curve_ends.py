"""Events where a point leaves the curve that it is on: slots and tracks that end."""

from __future__ import annotations

import numpy as np

from spatial_pin.motion.motion import Event, Motion
from spatial_pin.numerics.roots import between_samples, onsets

KIND = "end of curve"
SLACK = 1e-10  # of its length


def curve_end_events(motion: Motion) -> list[Event]:
    """Return an event where each point leaves its curve by an end, in the order of samples.

    Between samples the place is that of a cubic.
    """
    whole = motion.mechanism.whole or motion.mechanism
    on_curves = [c for c in whole.closures if c.numbers.get("curve") is not None]
    if not on_curves or not len(motion):
        return []
    at, what = motion.time, "at {:.9g} s"
    if motion.driver is not None:
        at, what = motion.driver, f"at {motion.driver_name} = {{:.9g}} {motion.driver_unit}"
    events = []
    for closure in on_curves:
        curve = closure.numbers["curve"]
        if curve.is_closed or not np.isfinite(curve.end):
            continue
        s = motion.coordinate(f"{closure.name}.s").value
        for end, room in ((f"{curve.end:.6g} m", curve.end - s), ("0 m", s)):
            for k in onsets(room < -SLACK * curve.end):
                value = float(k) if at is None else float(at[0]) if not k else (
                    between_samples(at, room, k))
                where = what.format(value) if at is not None else f"before sample {k}"
                events.append(Event(KIND, value, k, (
                    f"{closure.name} leaves its curve at the end at {end}, "
                    + (where if k else "from the start"))))
    return sorted(events, key=lambda event: event.row)
