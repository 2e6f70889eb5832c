"""Assembly modes: all closed configurations for given driver values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.assemble import assembled, standing_drivers, tell
from spatial_pin.assembly.holding import free_bases
from spatial_pin.assembly.rounding import as_meant
from spatial_pin.assembly.search.guesses import read_guess
from spatial_pin.assembly.search.within_limits import violated_limit
from spatial_pin.assembly.state import State
from spatial_pin.checks import checked, generator, mapping, positive_number
from spatial_pin.errors import AssemblyError, ContinuumError
from spatial_pin.kernel.closer import Closer
from spatial_pin.mechanism.coordinates import (
    coordinate_value,
    finite_number,
    needed,
    with_values,
)
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mobility.finite_motions import PROBES
from spatial_pin.mobility.modes.check import SAME_MODE, Check, Kind
from spatial_pin.mobility.modes.marks import Mark, rows_of
from spatial_pin.mobility.modes.result import AssemblyModes, Continuum, missing_by
from spatial_pin.mobility.modes.rods import Core, Rod, core_of, rods_of
from spatial_pin.numerics.linalg import Array, null_space, null_vectors
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.progress import progress_bar
from spatial_pin.settings import Accuracy, accuracy_of

# Starts that the rarest mode must have had before no more are sought: one that has half its share
# of starts is then missed in exp(-10) of cases, 5e-5.
TIMES = 20
# Singular modes are the same up to this: where four of them meet they are known to the fourth root
# of round-off, 1e-4; ten times that.
SINGULAR_SAME = 1e-3
BEYOND = 0.25  # part of the range of closed slides that starts go beyond it: modes not yet found
# Starts slide by up to so many characteristic lengths either way: links reach one, and the ground
# stands no farther than half of another from where its frame is drawn.
SLIDES = 1.5
# Steps of a start. Of random starts of `delta` 57 % close in 60 steps, 75 % in 120 and 240; of the
# Gough platform with forty modes 98.5 %, 99.75 % and as many.
ITERATIONS = 120
FEWEST, MOST = 64, 512  # starts closed together: few as the first may tell all, later ones many
LARGEST = 1 << 21  # numbers in their Jacobians: 16 MB
LOOKED_AT = 20  # closed configurations looked at for a regular one: if all are singular, it is so
# Starts from which the readings of a rod are sought: there are two as a rule, and both are missed
# by so many in one of a hundred cases.
READINGS = 8
MOST_MODES = 1000  # after which no more are sought: more are a continuum cut by its tolerance
ENDLESS = 10**8  # starts: days, at a thousand a second
MOST_REJECTED = 64  # mirror images that are known again: each is compared with every start


@checked
def assembly_modes(
    mechanism: Mechanism,
    drivers: Mapping[str, float] | None = None,
    *,
    free: Iterable[str] = (),
    copies: bool = False,
    limits: bool = False,
    patience: int = 1000,
    most_starts: int = 50_000,
    seed: int = 0,
    accuracy: Accuracy | None = None,
    progress: bool = False,
) -> AssemblyModes:
    """Find the closed configurations of a mechanism at given driver values, from random starts.

    Configurations that differ only by passive freedoms, whole turns, rods turned about their own
    lines, or the two readings of a universal joint are one mode. Starts go on until the rarest mode
    has been found twenty times; `AssemblyModes.missing` estimates how many have not been found.
    Nothing proves that a finite number of starts has found all: raise `patience` for rare modes. A
    screw joint of the tree is looked at near its zero, for each of its turns may be a mode of its
    own.

    Args:
        mechanism: the mechanism.
        drivers: values of drivers or coordinates to hold [rad, m]; drivers that are not named
            stand at the guess, if the loops can be closed there.
        free: drivers that are not to stand at the guess.
        copies: list all configurations of a mode that differ in coordinates, not one of them.
        limits: leave out modes of which no copy keeps the joint limits.
        patience: go on until so many starts in a row have found nothing new.
        most_starts: stop after so many starts in any case.
        seed: of the random starts; the same seed gives the same list.
        accuracy: tolerance to reach; default "engineering".
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The modes, sorted by their coordinates. `State.branch` labels each: the sign of the
        determinant of the closed loops ("+" or "-"), numbered if there are several of a sign; ""
        where passive freedoms or missing drivers leave it open; "singular" where the mode can move
        to first order. Configurations that can really move are not modes; those found beside modes
        are in `AssemblyModes.continua`.

    Raises:
        ContinuumError: the mechanism can move with the values held, in its guess or in every
            configuration found; names the freedoms and what to hold.
        UnknownNameError, ValueError: names that do not exist, values that are not finite.
        KeyboardInterrupt: before a mode was found; else Ctrl-C ends the search, see `is_whole`.

    Example:
        >>> mech = sp.load("four_bar")
        >>> modes = sp.assembly_modes(mech, {"crank": 1.0})  # [rad]
        >>> [(m.branch, round(m.coordinate("rocker_pin").value, 3)) for m in modes]
        [('+', -2.285), ('-', 1.625)]
    """
    needed(mechanism)
    positive_number(patience, "patience")
    positive_number(most_starts, "most_starts")
    rng = generator(seed)
    if min(patience, most_starts) > ENDLESS:
        raise ValueError(f"patience is {patience:.3g} and most_starts is {most_starts:.3g}; one of "
                         f"them must be {ENDLESS:.0e} at most, or the search hardly ends")
    accuracy = accuracy_of(accuracy)
    mechanism = as_meant(mechanism, accuracy.gap)
    held = _held(mechanism, mapping(drivers, "drivers"), free)
    rods = rods_of(mechanism)
    check = Check(mechanism, held, rods, accuracy.tolerance, accuracy.gap)
    search = _Search(check, core_of(mechanism, held, rods), copies or limits)
    search.look_at_guess()
    with progress_bar(most_starts, f"{mechanism.name}: modes", progress) as bar:
        search.run(rng, patience, most_starts, bar)
    if search.continuum is not None and not search.modes:
        raise _moving(check, search.continuum)
    found = search.result(copies, limits)
    if found and mechanism.whole is not None:
        tell(found[0])
    return found


def _held(
    mechanism: Mechanism, named: Mapping[str, float], free: Iterable[str]
) -> dict[str, float]:
    """Return the coordinates held: those named, drivers that stand at the guess, a free base."""
    held = {mechanism.driven_coordinate(name).name: finite_number(value, f"driver {name!r}")
            for name, value in named.items()}
    standing = standing_drivers(mechanism, held, mechanism.start(held), free)
    held |= _base(mechanism, held)
    for name in standing:
        mechanism.driven_coordinate(name)  # refuses components of balls and floating joints
    if standing:
        try:
            state = assembled(mechanism, held, free=free)
        except AssemblyError:
            return held
        gone = {mechanism.coordinate(name).name for name in state.released}
        standing = {name: value for name, value in standing.items() if name not in gone}
    return held | standing


def _base(mechanism: Mechanism, held: Mapping[str, float]) -> dict[str, float]:
    """Return where the guess has the free bases, by coordinate."""
    bases = free_bases(mechanism)
    if not bases:
        return {}
    q = read_guess(mechanism, mechanism.start(held)).q
    return {c.name: coordinate_value(mechanism, c, q)
            for c in mechanism.coordinate_table.values() if c.joint in bases}


def _moving(check: Check, continuum: Continuum) -> ContinuumError:
    mechanism = check.mechanism
    values = ", ".join(f"{name} = {value:.6g}" for name, value in check.held.items())
    return ContinuumError(
        f"mechanism {mechanism.name!r} with {values or 'nothing'} held can still move, and what "
        f"moves is no assembly mode: {continuum}",
        state=continuum.state, freedoms=continuum.freedoms,
        coordinates=continuum.coordinates, hold=continuum.hold)


class _Mode:
    """A mode found: a closed configuration, and how many starts have ended there."""

    def __init__(self, q: Array, kind: Kind, signature: Array, rods: tuple[Rod, ...]) -> None:
        self.q, self.kind, self.signature, self.rods = q, kind, signature, rods
        self.count = 0

    @property
    def reach(self) -> float:
        """How far from its signature a configuration is still this mode."""
        return SINGULAR_SAME if self.kind.is_singular else SAME_MODE


class _Search:
    """Closed configurations of the core found so far, one of each mode.

    Attributes:
        modes: these.
        continuum: what can move, if anything found can.
        starts, closed: number of starts, and of those that closed.
        is_whole: whether nothing cut it short.
    """

    def __init__(self, check: Check, core: Core, all_copies: bool) -> None:
        self.check, self.core, self.all_copies = check, core, all_copies
        mechanism, model = check.mechanism, core.mechanism.model
        self.closer = Closer(core.mechanism)
        self.kernel = self.closer.kernel
        self.base = with_values(
            mechanism, read_guess(mechanism, mechanism.start(check.held)).q, check.held)
        table = core.mechanism.coordinate_table
        self.held = {name: x for name, x in check.held.items() if name in table}
        self.free = np.ones(model.nv, dtype=bool)
        self.free[[table[name].v for name in self.held]] = False
        self.most = int(np.clip(LARGEST // max(1, self.kernel.n_closure * model.nv), 1, MOST))
        self.size = min(FEWEST, self.most)
        self.slides = [at for c in table.values() if c.unit == "m" and c.name not in self.held
                       and (at := core.mechanism.place_of(c)) >= 0]
        self.low = np.full(len(self.slides), np.inf)
        self.high = -self.low
        self.modes: list[_Mode] = []
        self.rejected: list[Array] = []
        self.continuum: Continuum | None = None
        self.starts = self.closed = self.newest = 0
        self.is_whole = True
        self.marks: dict[int, Mark] | None = None
        self.rows: Array = np.empty((0, 0))
        self.generic_nullity = 0

    def look_at_guess(self) -> None:
        """Refuse a mechanism that can move in its guess.

        Raises:
            ContinuumError: it can.
        """
        q = self.check.close(self.base)
        if q is None:
            return
        kind = self.check.kind(q)
        if kind.moves:
            raise _moving(self.check, self.check.continuum(q, kind))

    def run(self, rng: np.random.Generator, patience: int, most_starts: int, bar: Any) -> None:
        """Try starts until further ones can be spared.

        Raises:
            KeyboardInterrupt: before a mode was found.
        """
        try:
            while not self.done(patience, most_starts):
                self.attempt(rng, most_starts)
                bar.n = self.starts
                bar.set_postfix(found=len(self.modes))
        except KeyboardInterrupt:  # what was found until then is the answer
            if not self.modes:
                raise
            self.is_whole = False

    def done(self, patience: int, most_starts: int) -> bool:
        """Whether further starts can be spared."""
        if self.starts >= most_starts or len(self.modes) >= MOST_MODES:
            return True
        if self.starts and not self.free.any():
            return True
        return (self.starts - self.newest >= patience
                and min((mode.count for mode in self.modes), default=TIMES) >= TIMES)

    def attempt(self, rng: np.random.Generator, most_starts: int) -> None:
        """Close the loops from some more starts, and sort what they end at."""
        m = min(self.size, most_starts - self.starts) if self.free.any() else 1
        self.size = min(2 * self.size, self.most)
        starts = _random_starts(self.core.mechanism, self.held, rng, m)
        if self.slides and np.isfinite(self.low).all():
            starts[self.slides, 1::2] = self._slides_near(rng, m // 2)
        q, error = self._descended(starts)
        closed = np.flatnonzero(error <= SAME_MODE * SAME_MODE)
        ends = q[self.slides][:, closed]
        self.low = np.minimum(self.low, ends.min(axis=1, initial=np.inf))
        self.high = np.maximum(self.high, ends.max(axis=1, initial=-np.inf))
        at = self.starts
        self.starts += m
        if self.marks is None:
            self._learn(q[:, closed])
        if self.marks is not None:
            self._sort(q[:, closed], self._signatures(q[:, closed]), at + closed)

    def _descended(self, q: Array) -> tuple[Array, Array]:
        """Return configurations q (nq, m) with their loops closed, and residuals (m,)."""
        found, error = self.closer.descend(q.T, self.free, TOLERANCES.tight, ITERATIONS)
        return found.T, error

    def _slides_near(self, rng: np.random.Generator, m: int) -> Array:
        """Return slides (n, m) in the range of closed configurations, and a part of it beyond.

        Every other start has them: a mechanism may be small against its distance from the origin.
        """
        low, high = self.low, self.high
        beyond = BEYOND * (high - low)
        return rng.uniform((low - beyond)[:, None], (high + beyond)[:, None], (len(self.slides), m))

    # ------------------------------------------------------------ sorting

    def _sort(self, q: Array, signatures: Array, starts: NDArray[np.intp]) -> None:
        """Count configurations q (nq, m) of known modes, and find new ones."""
        for mode in self.modes:
            q, signatures, starts = self._count(mode, q, signatures, starts)
        for rejected in self.rejected:
            other = _apart(signatures, rejected) >= SAME_MODE
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
                        if _apart(found.signature[None], x.signature)[0] < x.reach]
                if not near:
                    self.modes.append(found)
                    self.newest = first + 1
                for mode in near or [found]:
                    q, signatures, starts = self._count(mode, q, signatures, starts)
            if starts.size == left:  # rejected, or it went on to a mode far from here
                q, signatures, starts = q[:, 1:], signatures[1:], starts[1:]

    def _count(
        self, mode: _Mode, q: Array, signatures: Array, starts: NDArray[np.intp]
    ) -> tuple[Array, Array, NDArray[np.intp]]:
        other = _apart(signatures, mode.signature) >= mode.reach
        same = int(np.count_nonzero(~other))
        mode.count += same
        self.closed += same
        return q[:, other], signatures[other], starts[other]

    def _mode(self, x: Array) -> _Mode | None:
        """Return the mode that a configuration of the core belongs to, if it is one."""
        q = self._whole(x)
        if q is None or not self.check.holds(q):
            if len(self.rejected) < MOST_REJECTED:
                self.rejected.append(self._signatures(x[:, None])[0])
            return None
        kind = self.check.kind(q)
        if kind.moves:
            self.closed += 1
            if self.continuum is None:
                self.continuum = self.check.continuum(q, kind)
            return None
        assert self.marks is not None
        q = self.check.settled(q, self.base, self.marks)
        return _Mode(q, kind, self._signatures(self._part(q)[:, None])[0], self.core.rods)

    def _whole(self, x: Array) -> Array | None:
        """Return a configuration of the core as one of the mechanism, None if it is none."""
        mechanism = self.check.mechanism
        return self.check.place_rods(self.core.rods, self.core.whole(mechanism, self.base, x))

    def _part(self, q: Array) -> Array:
        """Return the core's configuration (its nq,)."""
        model, own = self.check.mechanism.model, self.core.mechanism.model
        parts = [q[model.idx_qs[i] : model.idx_qs[i] + model.nqs[i]] for i in self.core.joints]
        return np.concatenate([np.empty(0), *parts]).reshape(own.nq)

    def _moving(self, q: Array, signatures: Array) -> NDArray[np.bool_]:
        """Whether configurations q (nq, m) go on when pushed where they can to first order."""
        scale = self.core.mechanism.velocity_scale[:, None]
        jacobian = self._jacobian(q)
        if not jacobian.size:
            return np.ones(q.shape[1], dtype=bool)
        vectors, ranks = null_vectors(jacobian, TOLERANCES.half_precision)
        width = jacobian.shape[2]
        step = np.zeros((len(scale), q.shape[1]))
        step[self.free] = vectors.T
        step *= PROBES[1] / np.maximum(np.linalg.norm(step, axis=0), 1e-300)
        pushed = self.kernel.displaced(q.T, (scale * step).T).T
        found, error = self._descended(pushed)
        left = _apart(self._signatures(found), signatures)
        asked = _apart(self._signatures(pushed), signatures)
        return ((width - ranks > self.generic_nullity)
                & (error <= SAME_MODE * SAME_MODE)
                & (left > TOLERANCES.moved * asked))

    # ------------------------------------------------------------ what tells modes apart

    def _learn(self, q: Array) -> None:
        """Learn from closed configurations q (nq, m) which freedoms are passive."""
        looked_at = 0
        for x in q.T:
            whole = self._whole(x)
            if whole is None:
                continue
            kind = self.check.kind(whole)
            if self.marks is None or not kind.is_singular:
                self.marks = self.check.marks(whole, kind.idle, self.all_copies)
                jacobian = self._jacobian(x[:, None])[0]
                nullity = len(null_space(jacobian, TOLERANCES.half_precision))
                self.generic_nullity = nullity - kind.nullity + kind.passive
            looked_at += 1
            if not kind.is_singular or looked_at == LOOKED_AT:
                break
        if self.marks is not None:
            own = {k: self.marks[i] for k, i in enumerate(self.core.joints, start=1)}
            self.rows = rows_of(own, len(self.core.joints) + 1,
                                self.check.mechanism.characteristic_length)

    def _jacobian(self, q: Array) -> Array:
        """Return (m, n_closure, free) derivatives of the core's equations at q (nq, m)."""
        return self.kernel.jacobians(q.T)[:, : self.kernel.n_closure, self.free]

    def _signatures(self, q: Array) -> Array:
        """Return (m, rows, 3) what tells configurations q (nq, m) apart."""
        placed = self.kernel.placements(q.T)
        return self.rows @ placed.reshape(len(placed), -1, 3)

    # ------------------------------------------------------------ the answer

    def result(self, copies: bool, limits: bool) -> AssemblyModes:
        """Return the modes found as States, sorted."""
        check = self.check
        found = [(q, mode.kind, mode.count) for mode in self.modes
                 for q in (self._readings(mode, copies, limits) if self.all_copies else [mode.q])]
        if limits:
            found = [x for x in found if not violated_limit(check.mechanism, check.state(x[0]).q)]
        if self.all_copies and not copies:
            found = self._one_of_each(found)
        loose = {joint for _, kind, _ in found for joint, _ in kind.idle}
        found.sort(key=lambda x: _order(check.state(x[0]), loose))
        signs = check.signs([(q, kind) for q, kind, _ in found])
        states = [check.state(q, branch) for (q, _, _), branch in
                  zip(found, _labels(signs), strict=True)]
        return AssemblyModes(
            states, held=check.held, starts=self.starts, closed=self.closed,
            found=[count for _, _, count in found],
            missing=missing_by([mode.count for mode in self.modes]) if self.free.any() else 0.0,
            continua=() if self.continuum is None else (self.continuum,), is_whole=self.is_whole)

    def _readings(self, mode: _Mode, copies: bool, limits: bool) -> list[Array]:
        """Return a mode with the core's rods in their readings: all, or those within limits."""
        choices = []
        for rod in mode.rods:
            own = self._readings_of(rod, mode.q)
            if limits:
                own = [x for x in own if not x[2]]
            choices.append([x[:2] for x in own][: None if copies else 1])
        readings = []
        for choice in product(*choices):
            q = mode.q.copy()
            for at, values in choice:
                q[at] = values
            readings.append(q)
        return readings

    def _readings_of(self, rod: Rod, q: Array) -> list[tuple[slice, Array, bool]]:
        """Return the readings of a rod's first joint, and whether one is beyond joint limits."""
        check, model, i = self.check, self.check.mechanism.model, min(rod.lines)
        assert self.marks is not None
        marks = {k: self.marks[k] for k in rod.lines}
        own = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
        names = {c.name for c in check.mechanism.coordinate_table.values()
                 if c.joint in {model.names[k] for k in rod.lines}}
        rng = np.random.default_rng(6)
        signatures: list[Array] = []
        readings = []
        for k in range(READINGS):
            start = q if not k else check.shaken((rod,), q, rng)
            found = check.place_rods((rod,), start)
            if found is None:
                continue
            signature = check.signature(marks, found)
            if all(np.abs(signature - other).max() >= SAME_MODE for other in signatures):
                signatures.append(signature)
                beyond = beyond_limits(check.mechanism, check.state(found).q)
                readings.append((own, found[own], not names.isdisjoint(beyond)))
        return readings

    def _one_of_each(self, found: list[tuple[Array, Kind, int]]) -> list[tuple[Array, Kind, int]]:
        """Return one copy of each mode, the counts summed."""
        check, kept = self.check, list[tuple[Array, Kind, int]]()
        signatures: list[Array] = []
        for q, kind, count in found:
            marks = check.marks(q, kind.idle, all_copies=False)
            signature = check.signature(marks, q)
            for k, other in enumerate(signatures):
                if other.shape == signature.shape and np.abs(other - signature).max() < SAME_MODE:
                    kept[k] = kept[k][0], kept[k][1], max(kept[k][2], count)
                    break
            else:
                signatures.append(signature)
                kept.append((q, kind, count))
        return kept


def _apart(signatures: Array, other: Array) -> Array:
    """Return (m,) largest differences of signatures (m, rows, 3) from another (rows, 3)."""
    return np.abs(signatures - other).max(axis=(1, 2), initial=0.0)


def _random_starts(
    mechanism: Mechanism, held: Mapping[str, float], rng: np.random.Generator, m: int
) -> Array:
    """Return configurations (nq, m) with angles and orientations uniform, slides about neutral."""
    model = mechanism.model
    q = np.repeat(np.array(mechanism.neutral)[:, None], m, axis=1)
    reach = rng.uniform(0.0, SLIDES * mechanism.characteristic_length, m)
    for c in mechanism.coordinate_table.values():
        if c.q >= 0:
            q[c.q] = rng.uniform(-1.0, 1.0, m) * (np.pi if c.unit == "rad" else reach)
    for i, name in enumerate(mechanism.pairs, start=1):
        if not PAIRS[name].is_linear:
            at, n = model.idx_qs[i], model.nqs[i]
            quaternion = rng.normal(size=(4, m))
            q[at + n - 4 : at + n] = quaternion / np.linalg.norm(quaternion, axis=0)
            if n == 7:
                q[at : at + 3] = rng.uniform(-1.0, 1.0, (3, m)) * reach
    for name, value in held.items():
        q[mechanism.coordinate_table[name].q] = value
    return q


def _order(state: State, loose: set[str]) -> list[float]:
    """Return what modes are sorted by: coordinates, those of passive links last."""
    table = state.mechanism.coordinate_table.values()
    fixed = [c for c in table if c.joint not in loose]
    return [round(state.coordinate(c.name).value, 7) + 0.0 for c in fixed]


def _labels(signs: list[str]) -> list[str]:
    """Return labels of their own: signs, numbered where several modes have one."""
    total, seen = Counter(signs), Counter[str]()
    labels = []
    for sign in signs:
        seen[sign] += 1
        space = " " * (sign == "singular")
        labels.append(f"{sign}{space}{seen[sign]}" if total[sign] > 1 else sign)
    return labels
