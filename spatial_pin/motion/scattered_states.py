"""Configurations at scattered driver values on one branch, each from its nearest neighbour.

The values are taken from few to many: half of them are solved before the other half, a quarter
before that, and so on, spread evenly by Morton's order [Morton1966]. Each is followed to along a
straight line from the nearest one of those before it, so that as many rows as there are cores are
solved at a time, and no row depends on more than some twenty others.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import checked
from spatial_pin._support.lazy import Workspaces
from spatial_pin._support.progress import in_order, progress_bar
from spatial_pin.assembly.assemble import held_start, starting_state
from spatial_pin.assembly.holding import BASE, Hold, hold_names
from spatial_pin.assembly.redundant_equations import allowed_from, gap_allowed
from spatial_pin.assembly.start_values import read_guess
from spatial_pin.assembly.state import PIECE, State, all_angles
from spatial_pin.continuation.path_tracker import PathTracker
from spatial_pin.errors import AssemblyError, Interrupted, SingularError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import loops_at
from spatial_pin.kernel.paths import Path, PathSamples, Scattered, prescribed_indices
from spatial_pin.mechanism.coordinates import coordinate_value, require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.follow import along, table_of
from spatial_pin.motion.motion import Event, Motion, selected
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.depending import part_moving_with
from spatial_pin.rates.rates import check_not_held
from spatial_pin.settings import Accuracy, accuracy_of

Rows = NDArray[np.int64]
FEWEST = 32  # rows of one call of the kernel, for which a thread is worth its while
SHARES = 4  # calls of each thread for half of the rows: the last one to end waits for no more
# Nearest solved neighbours from which a row is tried: behind a corner of the reachable values the
# nearest one sees it as a rule, and each costs as much as ten rows where none does.
NEIGHBOURS = 3
BYTE = 8  # bits of Morton's order that are spread at a time
BELOW_ONE = float(np.nextafter(1.0, 0.0))  # part of a line that is not its end
ENDS = {  # of lines, by kind
    "limit": "limit position", "half turn": "a rotation vector of half a turn",
    "runs away": "a joint that runs away without end, last seen", "lost": "the branch is lost",
    "singular": "singular configuration", "branch point": "branch point"}
AT_LIMIT = 1e-6  # rad, characteristic lengths: a line ends no nearer to it where branches cross
# Lines in a row that lead through no singular configuration, before the rest is not tried: each
# costs milliseconds.
PASSAGES = 20


@checked
def states(
    mechanism: Mechanism,
    values: Mapping[str, Any],
    guess: Mapping[str, Any] | State | Array | None = None,
    threads: int | None = None,
    *,
    hold: Hold = BASE,
    accuracy: Accuracy | None = None,
    progress: bool = False,
) -> Motion:
    """Solve configurations at scattered driver values on one branch: that of the guess.

    The sample nearest to the guess is assembled. Each other sample is followed from its nearest
    solved neighbour, along a straight line of driver values, so it is on the same branch. If it
    cannot be reached from there, other neighbours are tried. At a branch point a line goes straight
    on. No result depends on the number of threads, nor on the order of the samples.

    If a region of driver values cannot be reached, lines on either side of it may lead to different
    branches. Then use `sweep` or `follow` along a line that you choose.

    Args:
        mechanism: the mechanism.
        values: (N,) values by driver, or coordinate of a joint [rad or m], in any order; one number
            holds it at that value. All other drivers keep their values from the guess.
        guess: the first configuration, as for `assemble`; a State selects its own branch.
        threads: number of threads that solve rows; default: the number of cores.
        hold: names of other joints that stand still, as for `sweep`.
        accuracy: tolerance; default "engineering".
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The Motion, one sample per row of the tables, in their order, at rest: v and a are zero, as
        those of `assemble`; `solve_rates` of it takes arrays of speeds. It has no driver and no
        time. If a value cannot be reached, the row holds the nearest configuration that was reached
        on the line, and `unreached` {sample: reason} says why.

    Raises:
        AssemblyError: neither the sample nearest to the guess nor the guess can be assembled.
        SingularError: the drivers do not determine the motion there.
        Interrupted: after Ctrl-C; has the samples until then.
        UnknownNameError: a name does not exist.
        ValueError: tables are not finite, or of different lengths; or threads are less than one.

    Example:
        >>> mech = sp.load("delta")
        >>> rng = np.random.default_rng(0)
        >>> arms = {f"arm_{i}": rng.uniform(0.0, 0.6, 500) for i in (1, 2, 3)}  # [rad]
        >>> motion = sp.states(mech, arms)
        >>> motion.placement("platform")[:, :3, 3].shape, motion.unreached  # (N, 3) [m]
        ((500, 3), {})
        >>> sp.jacobian(mech, motion, "platform").shape  # (N, 6, n)
        (500, 6, 3)
    """
    accuracy = accuracy_of(accuracy)
    require_mechanism(mechanism)
    if threads is not None and threads < 1:
        raise ValueError(f"threads is {threads}: it must be at least 1")
    names, table = table_of(mechanism, values)
    held = hold_names(hold)
    check_not_held(mechanism, [mechanism.prescribed_coordinate(name) for name in names], held)
    order = np.argsort(table[:, 0], kind="stable")  # which decides alone, but for equal values
    if len(table.T) > 1 and not np.diff(table[order, 0]).all():
        order = np.lexsort(table.T[::-1])
    is_new = np.ones(len(table), dtype=bool)
    is_new[1:] = (table[order[1:]] != table[order[:-1]]).any(axis=1)
    number = np.empty(len(table), np.int64)
    number[order] = np.cumsum(is_new) - 1
    distinct = table[order[is_new]]
    state, gone = _first(mechanism, names, distinct, guess, held, accuracy)
    moved = part_moving_with(state, names, hold)
    own_cores = getattr(os, "sched_getaffinity", None)
    threads = threads or (len(own_cores(0)) if own_cores else os.cpu_count() or 1)
    cloud, is_done = None, None
    try:  # around the workspaces: after Ctrl-C a thread may still use a kernel of theirs
        with (progress_bar(len(distinct), f"{mechanism.name}: {', '.join(names)}", progress) as bar,
              Workspaces() as workspaces):
            cloud = _Cloud(moved.state, names, moved.hold, distinct, accuracy, threads, workspaces)
            cloud.solve(bar)
    except KeyboardInterrupt:
        if cloud is None or not (cloud.scattered.part[:-1] >= 1.0).any():
            raise
        is_done = cloud.scattered.part[number] >= 1.0
    samples = moved.of_whole(cloud.scattered.samples)
    unreached = _unreached(cloud, list(values), [mechanism.coordinate(x).unit for x in names])
    unreached |= _opened(state, samples, accuracy)
    n = len(table)
    v, a = np.zeros((2, n, state.mechanism.model.nv))
    motion = Motion(
        state.mechanism, None, "", None, samples.q[number], v, a, samples.error[number], np.ones(n),
        [Event("released", 0.0, 0, text) for text in gone], samples.angles[number],
        held=moved.held, unreached={
            k: unreached[row] for k, row in enumerate(number.tolist()) if row in unreached})
    if is_done is not None:
        raise Interrupted(selected(motion, np.flatnonzero(is_done)))
    return motion


def _first(
    mechanism: Mechanism, names: list[str], table: Array, guess: Any, held: tuple[str, ...],
    accuracy: Accuracy,
) -> tuple[State, list[str]]:
    """Return the first State, and sentences on coordinates held at other values than the guess.

    It is at the values nearest to the guess, where these cannot be assembled at the guess.

    Raises:
        AssemblyError: neither can be assembled.
    """
    coordinates = [mechanism.coordinate_table[name] for name in names]
    if isinstance(guess, State):
        own = {name: guess.coordinate(name).value for name in names}
        return held_start(mechanism, own, guess, held, accuracy)
    start = read_guess(mechanism, guess)
    at = np.array([coordinate_value(mechanism, c, start.q) for c in coordinates])
    sizes = mechanism.velocity_scale[[c.v for c in coordinates]]
    row = int(np.linalg.norm((table - at) / sizes, axis=1).argmin())
    try:
        return held_start(mechanism, dict(zip(names, table[row].tolist(), strict=True)), guess,
                          held, accuracy)
    except AssemblyError:
        with suppress(AssemblyError):
            return starting_state(mechanism, guess), []
        raise


def _paths_of(
    state: State, names: Sequence[str], hold: Hold, accuracy: Accuracy, n: int,
    workspaces: Workspaces,
) -> tuple[list[Path], Array]:
    """Return n paths of kernels from a state, and the values there of what they prescribe.

    Values of the names are first (m,).
    """
    mechanism = state.mechanism
    tracker = PathTracker.along(state, names, hold, accuracy, workspaces)
    driven, still = tracker.driven, tracker.still
    system = tracker.checked_system(state)
    indices = prescribed_indices(mechanism.model.nv, driven, still)
    values = {c.v: coordinate_value(mechanism, c, state.q)
              for c in mechanism.coordinate_table.values() if c.q >= 0}
    standing = [*(coordinate_value(mechanism, c, state.q) for c in driven),
                *(values.get(v, 0.0) for v in still)]
    return [Path(workspaces.acquire(kernel_of(mechanism)), system.equations, indices,
                 system.passive, accuracy) for _ in range(n)], np.array(standing)


class _Cloud:
    """Scattered values, each with the neighbour it is followed from, and their solver.

    The first State is of the mechanism or of the part that moves; the table (n, k) has distinct
    values of the coordinates of the names. Workspaces hold the kernels of the threads.
    """

    def __init__(
        self, state: State, names: Sequence[str], hold: Hold, table: Array, accuracy: Accuracy,
        threads: int, workspaces: Workspaces,
    ) -> None:
        mechanism = self.mechanism = state.mechanism
        self._names, self._hold, self._accuracy = names, hold, accuracy
        n, k = table.shape
        self._threads = max(1, min(threads, n // FEWEST))
        self._paths, self._standing = _paths_of(
            state, names, hold, accuracy, self._threads, workspaces)
        whole = np.vstack([table, self._standing[:k]])
        sizes = [mechanism.velocity_scale[mechanism.coordinate_table[name].v] for name in names]
        self.points: Array = whole / sizes
        samples = PathSamples.empty(n + 1, mechanism.model.nq, mechanism.model.nv,
                                    state.angles.size)
        samples.q[n], samples.angles[n], samples.error[n] = (  # C writes all others
            state.q, state.angles, state.closure_error)
        samples.t[n] = samples.c[n] = 0.0
        part = np.zeros(n + 1)
        part[n] = 1.0
        self.scattered = Scattered(whole, np.full(n + 1, n), samples, part)
        self.ends: dict[int, str] = {}  # of lines to rows that are not reached, in words

    def solve(self, bar: Any) -> None:
        """Solve all rows; unreachable ones end at the nearest configuration on their line."""
        with ThreadPoolExecutor(self._threads) as executor:
            pool = executor if self._threads > 1 else None
            for rows in levels_of(self.points, self.scattered.parent, pool):
                self._follow(pool, rows)
                bar.update(len(rows))
            self._try_others(pool)
            self._pass_singular(pool)
        for row in self._unsolved().tolist():
            if row not in self.ends:
                self.ends[row] = ENDS["limit" if self._is_limit(row) else "singular"]

    def _follow(self, pool: Any, rows: Rows, is_last: bool = False) -> None:
        """Follow rows from their parents, which are solved before."""
        most = max(PIECE // max(self.mechanism.model.nv, 1), 1)
        n = min(max(FEWEST, -(-len(rows) // (SHARES * self._threads))), most)

        def follow_piece(some: Rows) -> None:
            path = self._paths.pop()
            try:
                path.scatter(self.scattered, some, self._standing, is_last)
            finally:
                self._paths.append(path)

        jobs = [(np.ascontiguousarray(rows[k : k + n]),) for k in range(0, len(rows), n)]
        for _ in in_order(pool if len(jobs) > 1 else None, follow_piece, jobs):
            pass

    def _unsolved(self) -> Rows:
        return np.flatnonzero(self.scattered.part < 1.0)

    def _try_others(self, pool: Any) -> None:
        """Try unreached rows from other solved neighbours; else end as near as possible.

        A row that is reached is a neighbour of others.
        """
        from scipy.spatial import cKDTree

        scattered, points = self.scattered, self.points
        tried: dict[int, dict[int, float]] = {row: {} for row in self._unsolved().tolist()}
        while len(rows := self._unsolved()):
            solved = np.flatnonzero(scattered.part >= 1.0)
            k = min(NEIGHBOURS, len(solved))
            near = solved[cKDTree(points[solved]).query(points[rows], k)[1].reshape(-1, k)]
            fresh = [next((x for x in own if x not in tried[row]), -1)
                     for row, own in zip(rows.tolist(), near.tolist(), strict=True)]
            parents = np.array(fresh)
            rows, parents = rows[parents >= 0], parents[parents >= 0]
            if not len(rows):
                break
            scattered.parent[rows] = parents
            self._follow(pool, rows)
            apart = np.linalg.norm(points[rows] - points[parents], axis=1)
            for row, parent, far in zip(rows.tolist(), parents.tolist(), (
                    apart * (1.0 - scattered.part[rows])).tolist(), strict=True):
                tried[row][parent] = far
        rows = self._unsolved()
        for row in rows.tolist():
            scattered.parent[row] = min(tried[row], key=lambda x: (tried[row][x], x))
        self._follow(pool, rows, is_last=True)

    def _pass_singular(self, pool: Any) -> None:
        """Pass singular configurations and branch points on the lines to rows, if any."""
        failed, seen = 0, set[int]()
        while failed < PASSAGES:
            rows = [row for row in self._unsolved().tolist() if row not in seen and not
                    self._is_limit(row)]
            if not rows:
                return
            parents = self.scattered.parent[rows]
            far = np.linalg.norm(self.points[rows] - self.points[parents], axis=1)
            row = rows[int(far.argmin())]
            seen.add(row)
            if self._passes(row):
                failed = 0
                self._try_others(pool)
            else:
                failed += 1

    def _passes(self, row: int) -> bool:
        """Whether the line to a row passes the point that stopped it; then the row is written."""
        from scipy.interpolate import PPoly  # on use: it takes a tenth of a second

        s, parent = self.scattered, self.scattered.parent[row]
        angles = s.samples.angles[parent]
        state = State(self.mechanism, s.samples.q[parent], closure_error=s.samples.error[parent],
                      angles=angles if angles.size else None)
        first, last = s.values[parent], s.values[row]
        line = PPoly(np.array([[last - first], [first]]), np.array([0.0, 1.0]))
        try:
            passage = along(state, self._names, self._hold, line, np.array([0.0, 1.0]),
                          self._accuracy, "", False, passes=True)
        except SingularError:  # right at the neighbour
            return False
        if passage.stop is None:
            for to, own in zip(s.samples, passage.samples, strict=True):
                to[row] = own[1]
            s.part[row] = 1.0
            return True
        end = passage.stop
        self.ends[row] = "too far to be followed to" if end.is_far else ENDS[end.kind]
        if end.value > s.part[row]:
            loops = loops_at(self.mechanism, end.q, s.samples.angles[row])
            s.samples.q[row], s.samples.error[row] = end.q, loops.closure_error
            s.samples.angles[row], s.part[row] = loops.angles, min(end.value, BELOW_ONE)
        return False

    def _is_limit(self, row: int) -> bool:
        """Whether the line to a row ends at a limit position.

        There joints go like the root of the distance e that is left: q' = b / (2 root e) and
        q'' = b / (4 e root e), so that e = q' / (2 q'').
        """
        s, scale = self.scattered, self.mechanism.velocity_scale
        t, c = s.samples.t[row] / scale, s.samples.c[row] / scale
        bend = -float(t @ c)  # the parameter falls along the line
        distance = float(np.abs(self.points[row] - self.points[s.parent[row]]).max())
        return bend > 0.0 and float(t @ t) / (2.0 * bend) * distance < AT_LIMIT


def _unreached(cloud: _Cloud, names: Sequence[str], units: Sequence[str]) -> dict[int, str]:
    """Return the reasons why rows are not reached, by row, with names and values."""
    s, words = cloud.scattered, {}

    def at(values: Array) -> str:
        return ", ".join(f"{name} = {x:.9g} {unit}" for name, x, unit in zip(
            names, values.tolist(), units, strict=True))

    for row, kind in cloud.ends.items():
        parent, part = s.parent[row], s.part[row]
        if part < 1.0:
            end = s.values[parent] + part * (s.values[row] - s.values[parent])
            words[row] = f"{at(s.values[row])} is out of reach: {kind} at {at(end)}"
    return words


def levels_of(points: Array, parent: Rows, pool: Any) -> Iterator[Rows]:
    """Yield rows of points (n + 1, k) in levels of growing density, after setting their parents.

    The last point is solved. The parents of all levels are known before any row is solved: threads
    of a pool find those of later levels while rows of earlier ones are solved.
    """
    from scipy.spatial import cKDTree  # on use: it takes a tenth of a second

    n = len(points) - 1
    order, number = morton_order(points[:n]), np.arange(1, n + 1)
    levels, before = np.bitwise_and(number, -number), np.array([n])
    jobs = list[tuple[Rows, Rows]]()
    for size in 2 ** np.arange(int(n).bit_length())[::-1]:
        jobs.append((before, order[levels == size]))
        before = np.concatenate(jobs[-1])

    def with_parents(before: Rows, rows: Rows) -> Rows:
        # threads of the query itself would go on in memory that is free after Ctrl-C
        parent[rows] = before[cKDTree(points[before]).query(points[rows])[1]]
        return rows

    return in_order(pool, with_parents, jobs)


def morton_order(points: Array) -> Rows:
    """Return the order (n,) of points (n, k) on Morton's curve, those of one cell as they come."""
    n, k = points.shape
    bits = max(62 // k, 1)
    low, span = points.min(axis=0), float(np.ptp(points, axis=0).max())
    cells = np.minimum((points - low) / (span or 1.0) * 2.0**bits, 2.0**bits - 1.0).astype(np.int64)
    cells = cells[:, : 62 // bits]
    k = cells.shape[1]
    low_bits = np.arange(min(bits, BYTE))  # spread by a table: a bit for each of the k columns
    spread = ((np.arange(2 ** len(low_bits))[:, None] >> low_bits & 1) << k * low_bits).sum(axis=1)
    code = np.zeros(n, np.int64)
    for column, place in zip(cells.T, range(k - 1, -1, -1), strict=True):
        for first in range(0, bits, BYTE):
            code |= spread[column >> first & len(spread) - 1] << k * first + place
    return np.argsort(code, kind="stable")


def _opened(state: State, samples: PathSamples, accuracy: Accuracy) -> dict[int, str]:
    """Return rows at which redundant equations of a rounded file open beyond the gap."""
    mechanism = state.mechanism
    if mechanism.whole is None:
        return {}
    gap = allowed_from(state, gap_allowed(mechanism, accuracy))
    angles = np.array([all_angles(mechanism, x) for x in samples.angles])
    with kernel_of(mechanism.whole) as kernel:
        errors = kernel.errors(samples.q, angles.reshape(len(samples.q), -1))
    return {row: f"the file's numbers are rounded, and its redundant equations open by "
            f"{errors[row]:.1e} there, beyond the gap of {gap:.0e}"
            for row in np.flatnonzero(errors > gap).tolist()}


