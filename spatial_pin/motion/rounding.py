"""The end of a motion of a rounded file, where its dropped equations open beyond the gap."""

from __future__ import annotations

import numpy as np

from spatial_pin.assembly.redundant_equations import allowed_from, clearly_above, gap_allowed
from spatial_pin.errors import LimitError, SingularError
from spatial_pin.motion.motion import AnyMotion, Event, first_samples
from spatial_pin.settings import Accuracy

# Samples at which a motion is checked. So many per turn miss the peak of a sine by 5e-6 of its
# height, much less than the report shows.
MOST_SAMPLES = 1000
GAP = "gap"  # kind of event


def within_gap(motion: AnyMotion, accuracy: Accuracy, on_limit: str) -> AnyMotion:
    """Return the part of a motion on which all equations hold to the gap, with an event at its end.

    At most a thousand samples are checked.

    Args:
        motion: of any mechanism; of one that has all its equations all samples stay.
        accuracy: its settings.
        on_limit: "stop", or "raise" where equations open further.

    Raises:
        LimitError: they do.
        SingularError: they do so at the first sample.
    """
    if motion.mechanism.whole is None or not len(motion):
        return motion
    gap, before = allowed_from(motion.state(0), gap_allowed(motion.mechanism, accuracy)), 0
    for row in np.unique(np.linspace(0, len(motion) - 1, MOST_SAMPLES).astype(int)).tolist():
        state = motion.state(row)
        if state.gap > gap:
            worst = max(state.gap.closures.items(), key=lambda x: x[1])[0]
            text = (f"the file's numbers are rounded, and redundant equations of closure {worst!r} "
                    f"open by {float(state.gap):.1e} at {state}, beyond the gap of {gap:.0e} "
                    f"(load(..., gap={clearly_above(float(state.gap)):.0e}) allows it)")
            if not before:
                raise SingularError(f"mechanism {motion.mechanism.name!r}: {text}", state=state,
                                    motion=motion)
            swept = motion.time if motion.driver is None else motion.driver
            value = float(row if swept is None else swept[row])
            motion = first_samples(motion, before)
            motion.events.append(Event(GAP, value, before, text))
            if on_limit != "stop":
                raise LimitError(f"mechanism {motion.mechanism.name!r}: {text}", limit=value,
                                 motion=motion)
            return motion
        before = row + 1
    return motion
