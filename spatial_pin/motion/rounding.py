"""The end of a motion of a rounded file, where its dropped equations open beyond the gap."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close
from spatial_pin.assembly.redundant_equations import (
    CLOSED,
    allowed_from,
    clearly_above,
    gap_allowed,
    independent_along,
)
from spatial_pin.assembly.state import NO_ANGLES, State, carried_angles
from spatial_pin.errors import LimitError, SingularError
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import AnyMotion, Event, first_samples
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy

# Samples at which a motion is checked. This number per turn misses the peak of a sine by 5e-6 of
# its height, much less than the report shows.
MOST_SAMPLES = 1000
GAP = "gap"  # kind of event
# Choices of independent equations that are made along a path: each reaches half a radian further.
CHOICES = 8


def within_gap(
    motion: AnyMotion, accuracy: Accuracy, on_limit: str, independent: int | None = None,
    start: State | None = None,
) -> AnyMotion:
    """Return the part of a motion on which all equations hold to the gap, with an event at its end.

    At most a thousand samples are checked. `independent` is how many samples come before equations
    depend on each other; None: they never do. The motion begins at `start`, by default its first
    sample.

    Raises:
        LimitError: they do.
        SingularError: they do so at the first sample.
    """
    if motion.mechanism.whole is None or not len(motion):
        return motion
    gap = allowed_from(start or motion.state(0), gap_allowed(motion.mechanism, accuracy))
    end = len(motion) if independent is None else independent
    rows = np.unique(np.linspace(0, max(end - 1, 0), MOST_SAMPLES).astype(int)).tolist()
    at = next((k for k, row in enumerate(rows) if end and motion.state(row).gap > gap), None)
    if at is not None:
        end = rows[at - 1] + 1 if at else 0
    last = motion.state(max(0, end - 1) if at is None else rows[at])
    if independent is not None:
        return _ended(motion, end, last, on_limit, (
            "the file's numbers are rounded, and no choice of its redundant equations is "
            f"independent from the first sample to beyond {last}; begin another motion there: its "
            "last State is guess=, of simulate the state"))
    if at is None:
        return motion
    worst = max(last.gap.closures.items(), key=lambda x: x[1])[0]
    return _ended(motion, end, last, on_limit, (
        f"the file's numbers are rounded, and redundant equations of closure {worst!r} open by "
        f"{float(last.gap):.1e} at {last}, beyond the gap of {gap:.0e} (load(..., gap="
        f"{clearly_above(float(last.gap)):.0e}) allows it)"))


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


def independent_from(state: State, gap: float) -> State:
    """Return a moving state of a rounded file with equations that are independent ahead of it.

    The loops are closed by these equations. It is the state itself where no others do better. `gap`
    is the largest closure error that other equations may keep.
    """
    mechanism, scale = state.mechanism, state.mechanism.velocity_scale
    chosen, _ = independent_along(
        mechanism, state.q[None], state.angles, state.v / scale, gap, opens=True)
    if chosen is mechanism:
        return state
    angles = carried_angles(mechanism, state.angles, chosen)
    with loops_of(chosen, angles) as evaluation:
        q, error = close(evaluation, state.q, np.ones(len(scale), dtype=bool), CLOSED)
        away = np.abs(pin.difference(mechanism.model, state.q, q) / scale).max()
        if len(evaluation.angles) != len(state.angles) or error > CLOSED or away > gap:
            return state
        return State(chosen, q, state.v, closure_error=error, angles=evaluation.angles)


def independent_on(
    motion: AnyMotion, accuracy: Accuracy, ahead: Array, end: Array | None = None,
) -> tuple[Mechanism, int | None]:
    """Return a mechanism whose equations are independent on a motion and some distance ahead.

    `ahead` (nv,) is the direction in which it goes on, `end` (nq,) where it ends beyond its last
    sample.

    Returns:
        The motion's own mechanism where that is one, or of a rounded file no choice of equations
        is better; else the same file's with others, on which the motion is to be made again. And
        how many samples come before its equations depend on each other; None: they never do.
    """
    mechanism = motion.mechanism
    if mechanism.whole is None or not len(motion):
        return mechanism, None
    gap = allowed_from(motion.state(0), gap_allowed(mechanism, accuracy))
    q = motion.q if end is None else np.vstack([motion.q, end])
    return independent_along(mechanism, q, motion.angles[0] if motion.angles.size else NO_ANGLES,
                             ahead / mechanism.velocity_scale, gap)
