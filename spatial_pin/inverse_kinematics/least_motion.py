"""Motions that targets do not determine: least motion from sample to sample, with looking back.

The least motion may end where the targets lead no further, stretched out or at joint limits, though
another way of the same freedoms goes on. A configuration behind that place is then looked for as
`reach` does, and the samples before it are gone anew towards it, from as far back as it takes for
the steps to be no longer than the others.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin

from spatial_pin._support.progress import progress_bar
from spatial_pin.assembly.holding import Hold, held_by
from spatial_pin.assembly.state import State
from spatial_pin.errors import Interrupted, ReachError, SpatialPinError
from spatial_pin.inverse_kinematics.reach import reach
from spatial_pin.inverse_kinematics.target_tables import Table, targets_at
from spatial_pin.motion.follow import follow
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy

UNEVEN = 3.0  # by how much a step may be longer than most are, where they are gone anew


class Path:
    """Configurations that meet targets, sample by sample, from the first on.

    Attributes:
        states: those there are.

    Args:
        first: where the first targets are met.
        tables: the targets.
        hold: what stands still.
    """

    def __init__(self, first: State, tables: list[Table], hold: Hold) -> None:
        self.states, self._tables, self._hold = [first], tables, hold
        self._mechanism = first.mechanism

    def go_on(self) -> None:
        """Add a state, with least motion; where that leads no further, look back.

        Raises:
            ReachError: its targets cannot be reached.
        """
        k = len(self.states)
        try:
            self.states.append(self._reached(k, self.states[-1], 0))
        except ReachError:
            goal = self._reached(k, self.states[-1], 10)
            self.states = self._led_to(goal)

    def _reached(self, k: int, near: State, starts: int) -> State:
        """Return the state that meets the targets of a sample with least motion from another."""
        return reach(self._mechanism, targets_at(self._tables, k), near, hold=self._hold,
                     starts=starts)

    def _led_to(self, goal: State) -> list[State]:
        """Return states that end with a goal, gone anew from as far back as it takes."""
        best, last, back = [*self.states, goal], len(self.states) - 1, 0
        steps = self._steps(best)
        while steps.max() > UNEVEN * np.median(steps) and back < last:
            back = min(max(1, 2 * back), last)
            tried = self._anew(last - back, goal)
            if tried is not None and self._steps(tried).max() < steps.max():
                best, steps = tried, self._steps(tried)
        return best

    def _anew(self, since: int, goal: State) -> list[State] | None:
        """Return states that go evenly from one that there is to a goal; None if they cannot."""
        model, here, n = self._mechanism.model, self.states[since], len(self.states)
        found = []
        for k in range(since + 1, n):
            q = pin.interpolate(model, here.q, goal.q, (k - since) / (n - since))
            near = State(self._mechanism, q, angles=here.angles)
            try:
                found.append(self._reached(k, near, 0))
            except ReachError:
                return None
        return [*self.states[: since + 1], *found, goal]

    def _steps(self, states: list[State]) -> Array:
        """Return how far each state is from the one before [rad, characteristic lengths]."""
        model, scale = self._mechanism.model, self._mechanism.velocity_scale
        return np.array([np.linalg.norm(pin.difference(model, one.q, other.q) / scale)
                         for one, other in pairwise(states)])


def by_drivers(
    first: State, tables: list[Table], times: Array | None, hold: Hold, accuracy: Accuracy,
    progress: bool,
) -> Motion:
    """Return the motion of least motion from sample to sample, the drivers on splines.

    Raises:
        ReachError: targets cannot be reached; has the motion so far.
        SpatialPinError: there are no drivers.
        Interrupted: after Ctrl-C; has the motion until then.
    """
    mechanism, path = first.mechanism, Path(first, tables, hold)
    if not mechanism.drivers:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: the targets do not determine the motion, and it has no "
            "drivers that would; give the targets of as many coordinates as are free")

    held = held_by(mechanism, hold).entries

    def motion() -> Motion:
        n = len(path.states)
        values = {d: np.array([x.coordinate(d).value for x in path.states])
                  for d in mechanism.drivers if mechanism.coordinate(d).v not in held}
        return follow(mechanism, values, np.arange(n, dtype=float) if times is None else times[:n],
                      guess=first, hold=hold, accuracy=accuracy, progress=progress)

    with progress_bar(len(tables[0]), f"{mechanism.name}: reach", progress) as bar:
        for k in range(1, len(tables[0])):
            try:
                path.go_on()
            except ReachError as error:
                error.motion = motion()
                error.args = (f"sample {k}: {error}",)
                raise
            except KeyboardInterrupt as stopped:
                raise Interrupted(motion()) from stopped
            bar.update(1)
    return motion()
