"""The end of a motion of a rounded file, where its dropped equations open beyond the gap."""

from __future__ import annotations

import numpy as np

from spatial_pin.assembly.redundant_equations import (
    allowed_from,
    clearly_above,
    gap_allowed,
    independent_along,
)
from spatial_pin.assembly.state import NO_ANGLES, State
from spatial_pin.errors import LimitError, SingularError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import AnyMotion, Event, first_samples
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy

# Samples at which a motion is checked. This number per turn misses the peak of a sine by 5e-6 of
# its height, much less than the report shows.
MOST_SAMPLES = 1000
GAP = "gap"  # kind of event
BRIEF = 0.01  # part of a motion on which equations that were left out open beyond the gap at most
# Choices of independent equations that are made along a path: each reaches half a radian further.
CHOICES = 8


def first_opened(
    motion: AnyMotion, accuracy: Accuracy, end: int | None = None
) -> tuple[int, int | None]:
    """Return at how many of the first `end` samples equations hold to the gap, and where not.

    At most a thousand are checked.
    """
    end = len(motion) if end is None else end
    if motion.mechanism.whole is None or not end:
        return end, None
    gap, before = allowed_from(motion.state(0), gap_allowed(motion.mechanism, accuracy)), 0
    for row in np.unique(np.linspace(0, end - 1, min(end, MOST_SAMPLES)).astype(int)).tolist():
        if motion.state(row).gap > gap:
            return before, row
        before = row + 1
    return end, None


def within_gap(
    motion: AnyMotion, accuracy: Accuracy, on_limit: str, independent: int | None = None
) -> AnyMotion:
    """Return the part of a motion on which all equations hold to the gap, with an event at its end.

    At most a thousand samples are checked.

    Args:
        motion: of any mechanism; of one that has all its equations all samples stay.
        accuracy: its settings.
        on_limit: "stop", or "raise" where equations open further, or are not independent.
        independent: how many samples come before equations depend on each other; None: they never
            do.

    Raises:
        LimitError: they do.
        SingularError: they do so at the first sample.
    """
    if motion.mechanism.whole is None or not len(motion):
        return motion
    gap = allowed_from(motion.state(0), gap_allowed(motion.mechanism, accuracy))
    end, row = first_opened(motion, accuracy, independent)
    at = motion.state(max(0, end - 1) if row is None else row)
    if independent is not None:
        return _ended(motion, end, at, on_limit, (
            "the file's numbers are rounded, and no choice of its redundant equations is "
            f"independent from the first sample to beyond {at}; begin another motion there: its "
            "last State is guess=, of simulate the state"))
    if row is None:
        return motion
    worst = max(at.gap.closures.items(), key=lambda x: x[1])[0]
    return _ended(motion, end, at, on_limit, (
        f"the file's numbers are rounded, and redundant equations of closure {worst!r} open by "
        f"{float(at.gap):.1e} at {at}, beyond the gap of {gap:.0e} (load(..., gap="
        f"{clearly_above(float(at.gap)):.0e}) allows it)"))


def _ended(
    motion: AnyMotion, n: int, state: State, on_limit: str, text: str
) -> AnyMotion:
    """Return the first n samples of a motion, with an event at the end that a file's digits set.

    Raises:
        LimitError: that is not allowed.
        SingularError: there is no sample.
    """
    name = motion.mechanism.name
    if not n:
        raise SingularError(f"mechanism {name!r}: {text}", state=state, motion=motion)
    swept, row = motion.time if motion.driver is None else motion.driver, min(n, len(motion) - 1)
    value = float(row if swept is None else swept[row])
    motion = first_samples(motion, n)
    motion.events.append(Event(GAP, value, n, text))
    if on_limit != "stop":
        raise LimitError(f"mechanism {name!r}: {text}", limit=value, motion=motion)
    return motion


def is_closed_again(motion: AnyMotion, row: int, accuracy: Accuracy) -> bool:
    """Whether equations that open at a sample hold to the gap again soon after, to the end."""
    gap = allowed_from(motion.state(0), gap_allowed(motion.mechanism, accuracy))
    is_open = [k for k in range(row, len(motion)) if motion.state(k).gap > gap]
    return len(is_open) <= BRIEF * len(motion) and is_open[-1] + 1 < len(motion)


def ended_by(motion: AnyMotion, event: Event | None) -> AnyMotion:
    """Return a motion with an event at its end that was found on a motion of more samples."""
    if event is not None:
        motion.events.append(event._replace(row=len(motion)))
    return motion


def independent_on(
    motion: AnyMotion, accuracy: Accuracy, ahead: Array, end: Array | None = None,
    opens_after: int | None = None,
) -> tuple[Mechanism, int | None]:
    """Return a mechanism whose equations are independent on a motion and some distance ahead.

    Args:
        motion: of any mechanism.
        accuracy: its settings.
        ahead: (nv,) the direction in which it goes on.
        end: (nq,) where it ends beyond its last sample.
        opens_after: how many samples come before one at which redundant equations open too far.

    Returns:
        The motion's own mechanism where that is one, or of a rounded file no choice of equations
        is better; else the same file's with others, on which the motion is to be made again. And
        how many samples come before its equations depend on each other; None: they never do.
    """
    mechanism = motion.mechanism
    if mechanism.whole is None or not len(motion):
        return mechanism, None
    gap = allowed_from(motion.state(0), gap_allowed(mechanism, accuracy))
    q = motion.q[:opens_after] if end is None else np.vstack([motion.q, end])
    return independent_along(mechanism, q, motion.angles[0] if motion.angles.size else NO_ANGLES,
                             ahead / mechanism.velocity_scale, gap, opens_after is not None)
