"""Whether a motion of a rounded file stays where the equations chosen hold the others too."""

from __future__ import annotations

import numpy as np

from spatial_pin.assembly.rounding import allowed_from
from spatial_pin.errors import SingularError
from spatial_pin.motion.motion import Motion

# Samples of a motion that are looked at: so many over a turn miss the peak of a sine by 5e-6 of it,
# far more than is reported.
MOST_SAMPLES = 1000


def check_gaps(motion: Motion, gap: float) -> None:
    """Refuse a motion of a rounded file on which equations that it is without open.

    At most a thousand of its samples are checked.

    Raises:
        SingularError: they do; says where, and which.
    """
    if motion.mechanism.whole is None or not len(motion):
        return
    gap = allowed_from(motion.state(0), gap)
    for row in np.unique(np.linspace(0, len(motion) - 1, MOST_SAMPLES).astype(int)).tolist():
        state = motion.state(row)
        if state.gap > gap:
            worst = max(state.gap.closures.items(), key=lambda x: x[1])[0]
            raise SingularError(
                f"mechanism {motion.mechanism.name!r}: the file's numbers are rounded, and "
                f"{state} is out of the reach of the equations chosen: others of closure {worst!r} "
                f"open to {float(state.gap):.1e}; begin beside this configuration",
                state=state, motion=motion)
