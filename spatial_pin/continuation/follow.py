"""Samples of a branch at driver values: followed by the kernel, and step by step elsewhere.

The kernel follows a path as long as it is regular. Where it stops, something lies ahead that is to
be looked at: a `Branch` goes on from there, by arc length if need be, finds limits and branch
points, and hands the path back behind them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.holding import Hold, divided
from spatial_pin.assembly.newton import SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.continuation import branch_points
from spatial_pin.continuation.branch import Branch, Stopped
from spatial_pin.continuation.evaluation_order import there_and_back
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.paths import Path, Samples, prescribed_places
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.rates import prescribed_at, prescribed_first
from spatial_pin.settings import Accuracy

REST = 8  # samples step by step behind a branch point: the kernel stops beside it anyway
FAR = 1.0  # stretches from the last sample that are not gone again
CHUNK = 200_000  # joint coordinates followed at a time: a tenth of a second


class Start:
    """The beginning of a branch.

    Attributes:
        driven: the prescribed coordinates, the driver first.
        still: places in the velocity vector that stand still.

    Args:
        state: closed.
        names: what is prescribed, the driver first.
        hold: what stands still, see `sweep`.
        accuracy: of the motion.
        kernel: of the state's mechanism.
        evaluation: its closure equations.
    """

    def __init__(
        self, state: State, names: Sequence[str], hold: Hold, accuracy: Accuracy, kernel: Kernel,
        evaluation: Evaluation,
    ) -> None:
        self.state, self.accuracy = state, accuracy
        self.kernel, self.evaluation = kernel, evaluation
        self.driven, self.still = prescribed_first(state.mechanism, names, hold)
        self._path_here = self._regular_path()
        if self._path_here is None:
            self.driven = prescribed_at(state, names, hold)
            self.still = divided(state.mechanism, self.driven, hold)[1]

    def branch(self) -> Branch:
        """Return the branch that is followed step by step."""
        return Branch(self.state, self.driven, self.accuracy, self.evaluation, self.still)

    def samples(self, n: int) -> Samples:
        """Return room for n samples."""
        return Samples.empty(n, self.kernel.nq, self.kernel.nv, self.kernel.n_angles)

    def path(self) -> Path | None:
        """Return the path that the kernel follows from here; None where it cannot, or may not."""
        found = self._path_here or self._regular_path() or self._path_of_system()
        self._path_here = None
        return found

    def _regular_path(self) -> Path | None:
        """Return the path where as many equations are independent as there are unknowns."""
        k, prescribed = self.kernel, len(self.driven) + len(self.still)
        wanted = k.nv - k.n_passive - prescribed
        if not 0 <= wanted <= k.n_rows:
            return None
        return self._path(np.arange(wanted), np.empty((0, k.nv)), self.state.q,
                          self.state.angles, True)

    def _path_of_system(self) -> Path | None:
        """Return the path where passive freedoms are left."""
        self.evaluation.turns[:] = self.state.angles
        try:
            system = SquareSystem(self.evaluation, self.driven, self.state.q, self.still)
            system.check_regular(self.state.q)
        except SingularError:
            return None
        return self._path(system.rows, system.passive, self.state.q, self.state.angles)

    def path_on(self, branch: Branch) -> Path | None:
        """Return the path that the kernel follows from where a branch stands."""
        return self._path(branch.system.rows, branch.system.passive, branch.q, branch.angles)

    def _path(
        self, chosen: NDArray[np.integer[Any]], fill: Array, q: Array, angles: Array,
        choose: bool = False,
    ) -> Path | None:
        driven = prescribed_places(self.kernel, self.driven, self.still)
        path = Path(self.kernel, chosen, driven, fill, self.accuracy)
        return path if path.start(q, angles, choose) else None


def followed_in_order(start: Start, values: Array, bar: Any) -> Samples | None:
    """Return the samples, followed in the order of their values from the first on, both ways.

    None where the order asked for is no detour, or anything lies in the way: what it is, and which
    samples come before it, is told by the order asked for.
    """
    ways = there_and_back(values)
    if ways is None:
        return None
    samples = start.samples(len(values))
    for rows in ways:
        own = start.samples(len(rows))
        try:
            for _ in follow(start, values[rows], own, None):
                pass
        except (Stopped, SpatialPinError):
            bar.reset()
            return None
        bar.update(len(rows))
        for whole, part in zip(samples, own, strict=True):
            whole[rows] = part
    return samples


def follow(
    start: Start, values: Array, samples: Samples, crossed: list[tuple[float, int]] | None
) -> Iterator[int]:
    """Write the samples of a branch at driver values; yields the number of those done.

    Branch points that are passed are added to `crossed`, if that is a list, as (value, row).

    Raises:
        Stopped: a value cannot be reached; says which, and where the branch ended.
        SingularError: the driver does not determine the motion at the start.
    """
    path, branch, k, careful_until = start.path(), None, 0, 0
    chunk = max(CHUNK // max(start.kernel.nv, 1), 1)
    while k < len(values):
        if path is not None:
            done = path.follow(values[k : k + chunk], samples.between(k, k + chunk))
            k += done
            yield k
            if k == len(values) or done == chunk:
                continue
        branch = branch or start.branch()
        if path is not None:
            _take_over(branch, path, samples, k)
            path = None
        try:
            branch.reach(float(values[k]))
        except Stopped as stopped:
            before = k
            k = _pass_branch_point(branch, values, k, samples, stopped, crossed)
            careful_until = max(careful_until, k + REST)
            if k > before:
                yield k
            continue
        _put(samples, k, branch)
        k += 1
        yield k
        if careful_until <= k < len(values):
            path = start.path_on(branch)


def _take_over(branch: Branch, path: Path, samples: Samples, k: int) -> None:
    """Take a branch to where a path stopped before sample k.

    That is the sample before, where it is clear that the branch goes on, or the path's own place
    where that is far from it.
    """
    here = path.here
    s, q, angles = here.s, here.q, here.angles
    if k > 0 and branch.stretches(float(samples.q[k - 1, branch.at]) - s) < FAR:
        q, angles = samples.q[k - 1].copy(), samples.angles[k - 1]
    branch.evaluation.turns[:] = angles
    branch.place(q)


def _put(samples: Samples, k: int, branch: Branch) -> None:
    """Write where a branch stands into sample k."""
    samples.q[k], samples.t[k], samples.c[k] = branch.q, branch.t, branch.c
    samples.error[k] = np.abs(branch.residual).max(initial=0.0)
    samples.angles[k] = branch.angles


def _pass_branch_point(
    branch: Branch, values: Array, k: int, samples: Samples, stopped: Stopped,
    crossed: list[tuple[float, int]] | None,
) -> int:
    """Go straight on at a crossing before row k; return the first row behind its strip.

    Rows before the crossing that lie on the strip are taken from it too: it is the more exact.

    Raises:
        Stopped: it is no crossing, or one that is not to be passed.
    """
    stopped.row = k
    if crossed is None or stopped.arrival.kind not in ("branch point", "singular"):
        raise stopped
    found = branch_points.strip(branch, stopped.arrival.value)
    if found is None:
        raise stopped
    while k > 0 and found.holds(float(values[k - 1])):
        k -= 1
    crossed[:] = [(x, row) for x, row in crossed if row < k or not found.holds(x)]
    for row in range(k, len(values)):
        value = float(values[row])
        crossed += [(x, row) for x in found.crossed(float(values[max(row - 1, 0)]), value)]
        if not found.holds(value):
            found.leave(branch, value)
            if row == stopped.row and not abs(value - branch.s) < abs(
                    value - stopped.arrival.value):  # no nearer than before
                raise stopped
            return row
        found.put(branch, value)
        _put(samples, row, branch)
    return len(values)
