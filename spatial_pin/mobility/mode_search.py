"""The search for assembly modes: closing random starts, and comparing the results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.start_values import read_guess
from spatial_pin.errors import ContinuumError
from spatial_pin.kernel.closer import Closer, descend
from spatial_pin.mechanism.coordinates import with_values
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mobility.finite_motions import PATH_LENGTH, SETTING_OUT
from spatial_pin.mobility.mode_check import (
    SAME_MODE,
    BodyMark,
    Continuum,
    ModeCheck,
    ModeKind,
    are_joined,
    continuum_at,
    rows_of,
)
from spatial_pin.mobility.rods import Core, Rod
from spatial_pin.numerics.linalg import Array, null_space, null_vectors
from spatial_pin.numerics.tolerances import TOLERANCES

# Starts of the rarest mode before the search ends: a mode with half its share is then missed in
# exp(-10) of cases, 5e-5.
TIMES = 20
# Difference of equal singular modes: where four meet they are known to the fourth root of round-
# off, 1e-4; ten times that.
SINGULAR_SAME = 1e-3
MOST_MODES = 1000  # most modes: more are a continuum cut by its tolerance
BEYOND = 0.25  # part of the range of closed slides by which starts exceed it: for unknown modes
# Largest slide of starts [characteristic lengths]: links reach one, and the ground is within half
# of another of its frame.
SLIDES = 1.5
# Steps of a start. From random starts of `delta` 57 % close in 60 steps, 75 % in 120 and 240; of
# the Gough platform with forty modes 98.5 %, 99.75 % and as many.
ITERATIONS = 120
# starts closed together: few at first, as these may be enough, later many
FEWEST_TOGETHER, MOST_TOGETHER = 64, 512
LARGEST = 1 << 21  # numbers in their Jacobians: 16 MB
# closed configurations checked for a regular one: if all are singular, the mechanism is
LOOKED_AT = 20
MOST_REJECTED = 64  # stored mirror images: each is compared with every start


class Starts:
    """Random configurations of a mechanism, and the results of descents from them.

    It is the core of the searched mechanism, with fixed coordinates [rad, m].

    Attributes:
        kernel: of the mechanism.
        free: (nv,) velocities that close the loops.
    """

    def __init__(self, mechanism: Mechanism, held: Mapping[str, float]) -> None:
        self._mechanism, self._held = mechanism, held
        self._closer = Closer(mechanism)
        self.kernel = self._closer.kernel
        table, nv = mechanism.coordinate_table, mechanism.model.nv
        self.free = np.ones(nv, dtype=bool)
        self.free[[table[name].v for name in held]] = False
        self._most = int(np.clip(LARGEST // max(1, self.kernel.n_closure * nv), 1, MOST_TOGETHER))
        self._size = min(FEWEST_TOGETHER, self._most)
        self._slides = [at for c in table.values() if c.unit == "m" and c.name not in held
                        and (at := mechanism.index_of(c)) >= 0]
        self._low = np.full(len(self._slides), np.inf)
        self._high = -self._low

    def draw(self, rng: np.random.Generator, most: int) -> Array:
        """Return more configurations (nq, m), `most` at most."""
        m = min(self._size, most) if self.free.any() else 1
        self._size = min(2 * self._size, self._most)
        mechanism, model = self._mechanism, self._mechanism.model
        q = np.repeat(np.array(mechanism.neutral)[:, None], m, axis=1)
        reach = rng.uniform(0.0, SLIDES * mechanism.characteristic_length, m)
        for c in mechanism.coordinate_table.values():  # angles uniform, slides about neutral
            if c.q >= 0:
                q[c.q] = rng.uniform(-1.0, 1.0, m) * (np.pi if c.unit == "rad" else reach)
        for i, name in enumerate(mechanism.pairs, start=1):
            if not PAIRS[name].is_linear:  # orientations uniform
                at, n = model.idx_qs[i], model.nqs[i]
                quaternion = rng.normal(size=(4, m))
                q[at + n - 4 : at + n] = quaternion / np.linalg.norm(quaternion, axis=0)
                if n == 7:
                    q[at : at + 3] = rng.uniform(-1.0, 1.0, (3, m)) * reach
        for name, value in self._held.items():
            q[mechanism.coordinate_table[name].q] = value
        # every other start has slides in the range of closed configurations, and a part beyond it:
        # a mechanism may be small against its distance from the origin
        if self._slides and np.isfinite(self._low).all():
            beyond = BEYOND * (self._high - self._low)
            q[self._slides, 1::2] = rng.uniform(
                (self._low - beyond)[:, None], (self._high + beyond)[:, None],
                (len(self._slides), m // 2))
        return q

    def descend(self, q: Array) -> tuple[Array, Array]:
        """Return configurations q (nq, m) with their loops closed, and residuals (m,)."""
        closed, error = descend(self._closer, q.T, self.free, TOLERANCES.tight, ITERATIONS)
        return closed.T, error

    def learn(self, closed: Array) -> None:
        """Record the range of slides in closed configurations (nq, m)."""
        ends = closed[self._slides]
        self._low = np.minimum(self._low, ends.min(axis=1, initial=np.inf))
        self._high = np.maximum(self._high, ends.max(axis=1, initial=-np.inf))


class Recognition:
    """Signatures of configurations: equal for one mode.

    `base` (nq,) is the configuration of the whole mechanism outside the core. `all_copies`: whether
    copies of a mode are distinct.

    Attributes:
        marks: relevant features of each body; empty before `learn`.
        is_learnt: whether signatures can be computed.
        generic_nullity: freedoms to first order of a regular configuration of the core.
    """

    def __init__(
        self, check: ModeCheck, core: Core, base: Array, starts: Starts, all_copies: bool
    ) -> None:
        self._check, self._core, self._base = check, core, base
        self._kernel, self._free, self._all_copies = starts.kernel, starts.free, all_copies
        self.marks: dict[int, BodyMark] = {}
        self.is_learnt = False
        self._rows: Array = np.empty((0, 0))
        self.generic_nullity = 0

    def learn(self, q: Array) -> None:
        """Find the passive freedoms from closed configurations q (nq, m)."""
        looked_at = 0
        for x in q.T:
            whole = self.whole(x)
            if whole is None:
                continue
            kind = self._check.kind(whole)
            if not self.is_learnt or not kind.is_singular:
                self.is_learnt = True
                self.marks = self._check.marks(whole, kind.idle, self._all_copies)
                nullity = len(null_space(self.jacobians(x[:, None])[0], TOLERANCES.half_precision))
                self.generic_nullity = nullity - kind.nullity + kind.passive
            looked_at += 1
            if not kind.is_singular or looked_at == LOOKED_AT:
                break
        if self.is_learnt:
            own = {k: self.marks[i] for k, i in enumerate(self._core.joints, start=1)}
            self._rows = rows_of(own, len(self._core.joints) + 1,
                                 self._check.mechanism.characteristic_length)

    def signatures(self, q: Array) -> Array:
        """Return signatures (m, rows, 3) of configurations q (nq, m) of the core."""
        placed = self._kernel.placements(q.T)
        return self._rows @ placed.reshape(len(placed), -1, 3)

    def signature(self, q: Array) -> Array:
        """Return (rows, 3) of one configuration (nq,) of the whole mechanism."""
        model, own = self._check.mechanism.model, self._core.mechanism.model
        parts = [q[model.idx_qs[i] : model.idx_qs[i] + model.nqs[i]] for i in self._core.joints]
        x: Array = np.concatenate([np.empty(0), *parts]).reshape(own.nq)
        return self.signatures(x[:, None])[0]

    def jacobians(self, q: Array) -> Array:
        """Return (m, n_closure, free) derivatives of the core's equations at q (nq, m)."""
        return self._kernel.jacobians(q.T)[:, : self._kernel.n_closure, self._free]

    def whole(self, x: Array) -> Array | None:
        """Return a configuration of the core as one of the mechanism, None if impossible."""
        mechanism = self._check.mechanism
        return self._check.with_rods(
            self._core.rods, self._core.whole(mechanism, self._base, x))


def apart(signatures: Array, other: Array) -> Array:
    """Return (m,) largest differences of signatures (m, rows, 3) from another (rows, 3)."""
    return np.abs(signatures - other).max(axis=(1, 2), initial=0.0)


class Mode:
    """A mode: a closed configuration, and the number of starts that ended there."""

    def __init__(self, q: Array, kind: ModeKind, signature: Array, rods: tuple[Rod, ...]) -> None:
        self.q, self.kind, self.signature, self.rods = q, kind, signature, rods
        self.count = 0

    @property
    def reach(self) -> float:
        """Largest difference of signatures within this mode."""
        return SINGULAR_SAME if self.kind.is_singular else SAME_MODE


class ModeSearch:
    """Closed configurations of the core, one of each mode.

    `all_copies`: whether copies of a mode are distinct.

    Attributes:
        modes: the modes so far.
        recognition: their signatures.
        continuum: a moving configuration, if any.
        starts, closed: number of starts, and of those that closed.
        is_whole: whether the search was complete.
    """

    def __init__(self, check: ModeCheck, core: Core, all_copies: bool) -> None:
        self._check, self._core = check, core
        mechanism = check.mechanism
        self._base = with_values(
            mechanism, read_guess(mechanism, mechanism.start(check.held)).q, check.held)
        table = core.mechanism.coordinate_table
        self._starts = Starts(
            core.mechanism, {name: x for name, x in check.held.items() if name in table})
        self.recognition = Recognition(check, core, self._base, self._starts, all_copies)
        self.modes: list[Mode] = []
        self._rejected: list[Array] = []
        self.continuum: Continuum | None = None
        self.starts = self.closed = self._newest = 0
        self.is_whole = True

    @property
    def is_free(self) -> bool:
        """Whether any coordinate is free."""
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
            raise moving(self._check, continuum_at(self._check, q, kind))

    def run(self, rng: np.random.Generator, patience: int, most_starts: int, bar: Any) -> None:
        """Try starts until the modes are complete with high probability.

        Raises:
            KeyboardInterrupt: before a mode was reached.
        """
        try:
            while self.starts < most_starts and len(self.modes) < MOST_MODES:
                least = min((mode.count for mode in self.modes), default=TIMES)
                if (self.starts and not self.is_free) or (
                        self.starts - self._newest >= patience and least >= TIMES):
                    break
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
                bar.n = self.starts
                bar.set_postfix(found=len(self.modes))
        except KeyboardInterrupt:  # the result has the modes until then
            if not self.modes:
                raise
            self.is_whole = False
        self._join()

    def _join(self) -> None:
        """Join singular modes that round-off spreads along a valley."""
        groups: list[list[Mode]] = []
        for mode in self.modes:
            own = [group for group in groups if mode.kind.is_singular and any(
                are_joined(self._check, mode.q, other.q) for other in group)]
            groups = [group for group in groups if group not in own]
            groups.append([mode, *(other for group in own for other in group)])
        self.modes = []
        for group in groups:
            middle = min(group, key=lambda x: max(
                apart(x.signature[None], y.signature)[0] for y in group))
            middle.count = sum(x.count for x in group)
            self.modes.append(middle)

    def _sort(self, q: Array, signatures: Array, starts: NDArray[np.intp]) -> None:
        """Count configurations q (nq, m) of known modes, and add new ones."""
        for mode in self.modes:
            q, signatures, starts = self._count(mode, q, signatures, starts)
        for rejected in self._rejected:
            other = apart(signatures, rejected) >= SAME_MODE
            q, signatures, starts = q[:, other], signatures[other], starts[other]
        while starts.size:
            if self.continuum is not None:
                moving = _moving(self.recognition, self._starts, q, signatures)
                self.closed += int(np.count_nonzero(moving))
                q, signatures, starts = q[:, ~moving], signatures[~moving], starts[~moving]
                if not starts.size:
                    return
            before, first = starts.size, int(starts[0])
            mode_here = self._mode(q[:, 0])
            if mode_here is not None:
                near = [x for x in self.modes
                        if apart(mode_here.signature[None], x.signature)[0] < x.reach]
                if not near:
                    self.modes.append(mode_here)
                    self._newest = first + 1
                for mode in near or [mode_here]:
                    q, signatures, starts = self._count(mode, q, signatures, starts)
            if starts.size == before:  # rejected, or it went on to a mode far from here
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
        """Return the mode of a configuration of the core, if it is one."""
        q = self.recognition.whole(x)
        if q is None or not self._check.holds(q):
            if len(self._rejected) < MOST_REJECTED:
                self._rejected.append(self.recognition.signatures(x[:, None])[0])
            return None
        kind = self._check.kind(q)
        if kind.moves:
            self.closed += 1
            if self.continuum is None:
                self.continuum = continuum_at(self._check, q, kind)
            return None
        q = self._check.settled(q, self._base, self.recognition.marks)
        return Mode(q, kind, self.recognition.signature(q), self._core.rods)


def _moving(
    recognition: Recognition, starts: Starts, q: Array, signatures: Array
) -> NDArray[np.bool_]:
    """Whether configurations q (nq, m) move on when pushed along first-order freedoms.

    Pushed a little, and beyond the range of loops that open by a high power only.
    """
    jacobian = recognition.jacobians(q)
    if not jacobian.size:
        return np.ones(q.shape[1], dtype=bool)
    vectors, ranks = null_vectors(jacobian, TOLERANCES.half_precision)
    moves = jacobian.shape[2] - ranks > recognition.generic_nullity
    scale = starts.kernel.mechanism.velocity_scale[:, None]
    for push in (SETTING_OUT, PATH_LENGTH):
        at = np.flatnonzero(moves)
        if not at.size:
            break
        step = np.zeros((len(scale), at.size))
        step[starts.free] = vectors[at].T
        step *= push / np.maximum(np.linalg.norm(step, axis=0), 1e-300)
        pushed = starts.kernel.displaced(q[:, at].T, (scale * step).T).T
        closed, error = starts.descend(pushed)
        shift, wanted = (apart(recognition.signatures(x), signatures[at])
                        for x in (closed, pushed))
        moves[at] = (error <= SAME_MODE * SAME_MODE) & (shift > TOLERANCES.moved * wanted)
    return moves


def moving(check: ModeCheck, continuum: Continuum) -> ContinuumError:
    """Return the error of a mechanism that can move with its fixed coordinates."""
    mechanism = check.mechanism
    values = ", ".join(f"{name} = {value:.6g}" for name, value in check.held.items())
    return ContinuumError(
        f"mechanism {mechanism.name!r} with {values or 'nothing'} held can still move, and what "
        f"moves is no assembly mode: {continuum}",
        state=continuum.state, freedoms=continuum.freedoms,
        coordinates=continuum.coordinates, hold=continuum.hold)
