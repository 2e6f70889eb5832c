"""The search for assembly modes: starts are closed, and sorted by what they end at."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.search.guesses import read_guess
from spatial_pin.errors import ContinuumError
from spatial_pin.mechanism.coordinates import with_values
from spatial_pin.mobility.finite_motions import SETTING_OUT, WAY_OUT
from spatial_pin.mobility.modes.check import SAME_MODE, Check, Kind
from spatial_pin.mobility.modes.recognition import Recognition, apart
from spatial_pin.mobility.modes.result import Continuum
from spatial_pin.mobility.modes.rods import Core, Rod
from spatial_pin.mobility.modes.starts import Starts
from spatial_pin.numerics.linalg import Array, null_vectors
from spatial_pin.numerics.tolerances import TOLERANCES

# Starts that the rarest mode must have had before no more are sought: one that has half its share
# of starts is then missed in exp(-10) of cases, 5e-5.
TIMES = 20
# Singular modes are the same up to this: where four of them meet they are known to the fourth root
# of round-off, 1e-4; ten times that.
SINGULAR_SAME = 1e-3
MOST_MODES = 1000  # after which no more are sought: more are a continuum cut by its tolerance
MOST_REJECTED = 64  # mirror images that are known again: each is compared with every start


class Mode:
    """A mode found: a closed configuration, and how many starts have ended there."""

    def __init__(self, q: Array, kind: Kind, signature: Array, rods: tuple[Rod, ...]) -> None:
        self.q, self.kind, self.signature, self.rods = q, kind, signature, rods
        self.count = 0

    @property
    def reach(self) -> float:
        """How far from its signature a configuration is still this mode."""
        return SINGULAR_SAME if self.kind.is_singular else SAME_MODE


class Search:
    """Closed configurations of the core found so far, one of each mode.

    Args:
        check: of the whole mechanism.
        core: what is searched.
        all_copies: whether copies of a mode are told apart.

    Attributes:
        modes: these.
        recognition: what tells them apart.
        continuum: what can move, if anything found can.
        starts, closed: number of starts, and of those that closed.
        is_whole: whether nothing cut it short.
    """

    def __init__(self, check: Check, core: Core, all_copies: bool) -> None:
        self._check, self._core = check, core
        mechanism = check.mechanism
        self._base = with_values(
            mechanism, read_guess(mechanism, mechanism.start(check.held)).q, check.held)
        table = core.mechanism.coordinate_table
        self._starts = Starts(
            core.mechanism, {name: x for name, x in check.held.items() if name in table})
        self.recognition = Recognition(
            check, core, self._base, self._starts.kernel, self._starts.free, all_copies)
        self.modes: list[Mode] = []
        self._rejected: list[Array] = []
        self.continuum: Continuum | None = None
        self.starts = self.closed = self._newest = 0
        self.is_whole = True

    @property
    def is_free(self) -> bool:
        """Whether anything is left to move with the values held."""
        return bool(self._starts.free.any())

    def look_at_guess(self) -> None:
        """Refuse a mechanism that can move in its guess.

        Raises:
            ContinuumError: it can.
        """
        q = self._check.close(self._base)
        if q is None:
            return
        kind = self._check.kind(q)
        if kind.moves:
            raise moving(self._check, self._check.continuum(q, kind))

    def run(self, rng: np.random.Generator, patience: int, most_starts: int, bar: Any) -> None:
        """Try starts until further ones can be spared.

        Raises:
            KeyboardInterrupt: before a mode was found.
        """
        try:
            while not self._is_done(patience, most_starts):
                self._attempt(rng, most_starts)
                bar.n = self.starts
                bar.set_postfix(found=len(self.modes))
        except KeyboardInterrupt:  # what was found until then is the answer
            if not self.modes:
                raise
            self.is_whole = False
        self._join()

    def _join(self) -> None:
        """Make one mode of singular ones that round-off lets stand anywhere along a valley."""
        groups: list[list[Mode]] = []
        for mode in self.modes:
            own = [group for group in groups if mode.kind.is_singular and any(
                self._check.is_joined(mode.q, other.q) for other in group)]
            groups = [group for group in groups if group not in own]
            groups.append([mode, *(other for group in own for other in group)])
        self.modes = []
        for group in groups:
            middle = min(group, key=lambda x: max(
                apart(x.signature[None], y.signature)[0] for y in group))
            middle.count = sum(x.count for x in group)
            self.modes.append(middle)

    def _is_done(self, patience: int, most_starts: int) -> bool:
        """Whether further starts can be spared."""
        if self.starts >= most_starts or len(self.modes) >= MOST_MODES:
            return True
        if self.starts and not self.is_free:
            return True
        return (self.starts - self._newest >= patience
                and min((mode.count for mode in self.modes), default=TIMES) >= TIMES)

    def _attempt(self, rng: np.random.Generator, most_starts: int) -> None:
        """Close the loops from some more starts, and sort what they end at."""
        starts = self._starts.draw(rng, most_starts - self.starts)
        q, error = self._starts.descend(starts)
        closed = np.flatnonzero(error <= SAME_MODE * SAME_MODE)
        q, numbers = q[:, closed], self.starts + closed
        self._starts.learn(q)
        self.starts += starts.shape[1]
        if not self.recognition.is_learnt:
            self.recognition.learn(q)
        if self.recognition.is_learnt:
            self._sort(q, self.recognition.signatures(q), numbers)

    def _sort(self, q: Array, signatures: Array, starts: NDArray[np.intp]) -> None:
        """Count configurations q (nq, m) of known modes, and find new ones."""
        for mode in self.modes:
            q, signatures, starts = self._count(mode, q, signatures, starts)
        for rejected in self._rejected:
            other = apart(signatures, rejected) >= SAME_MODE
            q, signatures, starts = q[:, other], signatures[other], starts[other]
        while starts.size:
            if self.continuum is not None:
                moving = self._moving(q, signatures)
                self.closed += int(np.count_nonzero(moving))
                q, signatures, starts = q[:, ~moving], signatures[~moving], starts[~moving]
                if not starts.size:
                    return
            left, first = starts.size, int(starts[0])
            found = self._mode(q[:, 0])
            if found is not None:
                near = [x for x in self.modes
                        if apart(found.signature[None], x.signature)[0] < x.reach]
                if not near:
                    self.modes.append(found)
                    self._newest = first + 1
                for mode in near or [found]:
                    q, signatures, starts = self._count(mode, q, signatures, starts)
            if starts.size == left:  # rejected, or it went on to a mode far from here
                q, signatures, starts = q[:, 1:], signatures[1:], starts[1:]

    def _count(
        self, mode: Mode, q: Array, signatures: Array, starts: NDArray[np.intp]
    ) -> tuple[Array, Array, NDArray[np.intp]]:
        other = apart(signatures, mode.signature) >= mode.reach
        same = int(np.count_nonzero(~other))
        mode.count += same
        self.closed += same
        return q[:, other], signatures[other], starts[other]

    def _mode(self, x: Array) -> Mode | None:
        """Return the mode that a configuration of the core belongs to, if it is one."""
        q = self.recognition.whole(x)
        if q is None or not self._check.holds(q):
            if len(self._rejected) < MOST_REJECTED:
                self._rejected.append(self.recognition.signatures(x[:, None])[0])
            return None
        kind = self._check.kind(q)
        if kind.moves:
            self.closed += 1
            if self.continuum is None:
                self.continuum = self._check.continuum(q, kind)
            return None
        q = self._check.settled(q, self._base, self.recognition.marks)
        return Mode(q, kind, self.recognition.signature(q), self._core.rods)

    def _moving(self, q: Array, signatures: Array) -> NDArray[np.bool_]:
        """Whether configurations q (nq, m) go on when pushed where they can to first order.

        A little, and as far as what opens loops by a high power only does not lead.
        """
        jacobian = self.recognition.jacobians(q)
        if not jacobian.size:
            return np.ones(q.shape[1], dtype=bool)
        vectors, ranks = null_vectors(jacobian, TOLERANCES.half_precision)
        moves = jacobian.shape[2] - ranks > self.recognition.generic_nullity
        for push in (SETTING_OUT, WAY_OUT):
            at = np.flatnonzero(moves)
            if at.size:
                moves[at] = self._goes_on(q[:, at], signatures[at], vectors[at].T, push)
        return moves

    def _goes_on(self, q: Array, signatures: Array, vectors: Array, push: float
                 ) -> NDArray[np.bool_]:
        """Whether configurations q (nq, m) are elsewhere after a push along vectors (n, m)."""
        scale = self._core.mechanism.velocity_scale[:, None]
        step = np.zeros((len(scale), q.shape[1]))
        step[self._starts.free] = vectors
        step *= push / np.maximum(np.linalg.norm(step, axis=0), 1e-300)
        pushed = self._starts.kernel.displaced(q.T, (scale * step).T).T
        found, error = self._starts.descend(pushed)
        left = apart(self.recognition.signatures(found), signatures)
        asked = apart(self.recognition.signatures(pushed), signatures)
        return (error <= SAME_MODE * SAME_MODE) & (left > TOLERANCES.moved * asked)


def moving(check: Check, continuum: Continuum) -> ContinuumError:
    """Return the error of a mechanism that can move with its values held."""
    mechanism = check.mechanism
    values = ", ".join(f"{name} = {value:.6g}" for name, value in check.held.items())
    return ContinuumError(
        f"mechanism {mechanism.name!r} with {values or 'nothing'} held can still move, and what "
        f"moves is no assembly mode: {continuum}",
        state=continuum.state, freedoms=continuum.freedoms,
        coordinates=continuum.coordinates, hold=continuum.hold)
