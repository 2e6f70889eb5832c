"""The result of `assembly_modes`; and modes checked: closed, distinct, in a continuum or not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import by_new_name
from spatial_pin.assembly.close import close
from spatial_pin.assembly.passive_freedoms import moved_bodies, uncounted_links
from spatial_pin.assembly.start_values import nearest_turn, turn_free_difference
from spatial_pin.assembly.state import State, gap_of
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mobility.finite_motions import PATH_LENGTH, finite_motions
from spatial_pin.mobility.idle_freedoms import IDLE, idle_freedoms
from spatial_pin.mobility.rods import Rod
from spatial_pin.numerics.linalg import (
    Array,
    common_rows,
    decompose,
    determinant_signs,
    null_space,
    rank,
    row_space,
)
from spatial_pin.numerics.tolerances import TOLERANCES

CONFIDENT = 3.0  # a mode that 3 of n starts should end at is missed in exp(-3) of cases, 5 %


class Continuum(NamedTuple):
    """Configurations that form no mode: with the given values held they can still move.

    Attributes:
        state: one of them.
        freedoms: its number of freedoms, without passive ones.
        coordinates: names of the coordinates that move.
        hold: drivers or coordinates that stop it if they are held too.

    Example:
        >>> modes = sp.assembly_modes(sp.load("sarrus"), {"arm": 0.7})  # [rad]
        >>> len(modes), [(found.freedoms, found.hold) for found in modes.continua]
        (2, [(1, ('b_low',))])
    """

    state: State
    freedoms: int
    coordinates: tuple[str, ...]
    hold: tuple[str, ...]

    def __str__(self) -> str:
        some = ", ".join(self.coordinates[:8]) + ", ..." * (len(self.coordinates) > 8)
        freedoms = "1 freedom" if self.freedoms == 1 else f"{self.freedoms} freedoms"
        verb = "is" if self.freedoms == 1 else "are"
        return f"{freedoms}, of {some}; it stops when {', '.join(self.hold)} {verb} held too"


class AssemblyModes(list[State]):
    """The assembly modes found, sorted, each with a label of its own in `State.branch`.

    Attributes:
        held: values of the coordinates held [rad, m].
        starts: number of random starts; `closed` of them ended at a closed configuration.
        counts: numbers of starts that ended at each mode.
        missing: estimated number of modes that no start has found [Chao1984].
        continua: other sets of configurations, which can move with `held` held.
        is_whole: whether nothing cut the search short (Ctrl-C).

    Example:
        >>> modes = sp.assembly_modes(sp.load("four_bar"), {"crank": 1.0})
        >>> len(modes), [state.branch for state in modes], modes.continua
        (2, ['+', '-'], ())
        >>> print(modes.missing < 0.01)  # modes that no start has found
        True
        >>> print(modes.completeness)
        none is expected to be missing, unless fewer than one start in 491 ends at it
    """

    def __init__(
        self,
        modes: Iterable[State] = (),
        *,
        held: Mapping[str, float] | None = None,
        starts: int = 0,
        closed: int = 0,
        counts: Sequence[int] = (),
        missing: float = 0.0,
        continua: Sequence[Continuum] = (),
        is_whole: bool = True,
    ) -> None:
        super().__init__(modes)
        self.held = dict(held or {})
        self.starts = starts
        self.closed = closed
        self.counts = tuple(counts)
        self.missing = missing
        self.continua = tuple(continua)
        self.is_whole = is_whole

    def __repr__(self) -> str:
        modes = super().__repr__()
        return modes if self.is_whole else f"AssemblyModes({modes}; cut short)"

    def __str__(self) -> str:
        values = ", ".join(f"{name} = {value:.6g}" for name, value in self.held.items())
        lines = [f"{len(self)} assembly modes found at {values or 'no values held'}; "
                 f"{self.starts} starts, {self.closed} closed"
                 f"{'' if self.is_whole else '; cut short'}"]
        lines += [f"  {k}: branch {mode.branch}, found {times} times"
                  for k, (mode, times) in enumerate(zip(self, self.counts, strict=False), start=1)]
        lines += [f"  beside them a set that can move: {c}" for c in self.continua]
        lines.append(self.completeness)
        return "\n".join(lines)

    @property
    def found(self) -> tuple[int, ...]:
        """The old name of `counts`; it warns."""
        return tuple(by_new_name(self, "found", "counts"))

    @property
    def completeness(self) -> str:
        """A sentence on modes that may be missing."""
        if self.missing >= 0.5:
            return f"about {self.missing:.0f} more must be expected: give more starts"
        if self.starts <= 1:
            return "there is nothing to search for"
        return ("none is expected to be missing, unless fewer than one start in "
                f"{max(1, round(self.starts / CONFIDENT))} ends at it")


def missing_by(counts: Sequence[int]) -> float:
    """Return the estimated number of unseen kinds, from the counts of the others [Chao1984].

    The estimate without bias f1 (f1 - 1) / (2 (f2 + 1)): f1 kinds were seen once, f2 twice.
    """
    once, twice = (sum(1 for n in counts if n == k) for k in (1, 2))
    return 0.5 * once * (once - 1) / (twice + 1) if once > 1 else float(once and not twice)


def order(state: State, loose: set[str]) -> list[float]:
    """Return the sort key of modes: coordinates, without those of passive links."""
    table = state.mechanism.coordinate_table.values()
    fixed = [c for c in table if c.joint not in loose]
    return [round(state.coordinate(c.name).value, 7) + 0.0 for c in fixed]


def labels(signs: list[str]) -> list[str]:
    """Return unique labels: signs, numbered if several modes have one."""
    total, seen = Counter(signs), Counter[str]()
    labels = []
    for sign in signs:
        seen[sign] += 1
        space = " " * (sign == "singular")
        labels.append(f"{sign}{space}{seen[sign]}" if total[sign] > 1 else sign)
    return labels


# Largest difference of placements of one mode [characteristic lengths, 1]. At a singular mode it is
# the square root of the residual: loops are closed to its square, 1e-10.
SAME_MODE = 1e-5
MOVING = 1e-3  # relative speed of a coordinate that is named: three digits of a report
# Part of a motion that a coordinate must have to stop it: with a tenth, its position has one digit
# less than theirs.
HOLDS = 0.1
# parts of the straight line between two configurations where loops are checked
BETWEEN = (0.25, 0.5, 0.75)
# Starts for rods whose other end cannot be reached from the guess: one in two reaches it, and all
# fail in one of a million cases.
TRIES = 20


# ---------------------------------------------------------------- marks: what tells modes apart
# Of a rod that is its line; of a link with a passive freedom, what the freedom leaves at rest; of
# any other link its whole placement. All of it is linear in the joint placements.


class BodyMark(NamedTuple):
    """Relevant features of a body: points (k, 3) [m] and directions (l, 3), in its joint's axes."""

    points: Array
    directions: Array


WHOLE = BodyMark(np.zeros((1, 3)), np.eye(3))
NOTHING = BodyMark(np.zeros((0, 3)), np.zeros((0, 3)))


def rows_of(marks: Mapping[int, BodyMark], n_joints: int, length: float) -> Array:
    """Return coefficients (rows, 4 n_joints) of marks on joint placements, lengths divided."""
    rows = []
    for body, mark in marks.items():
        for vectors, flag, unit in ((mark.points, 1.0, length), (mark.directions, 0.0, 1.0)):
            for x in vectors:
                row = np.zeros((n_joints, 4))
                row[body] = np.array([*x, flag]) / unit
                rows.append(row.reshape(-1))
    return np.array(rows).reshape(len(rows), 4 * n_joints)


def resting(evaluation: LoopEquations, idle: list[tuple[str, Array]]) -> dict[int, BodyMark]:
    """Return the features at rest of bodies with passive freedoms."""
    mechanism, marks = evaluation.mechanism, {}
    model, scale = mechanism.centred_model, evaluation.constraints.scale
    for _, velocities in idle:
        for body in moved_bodies(evaluation, velocities):
            points = [np.zeros(3)]  # its origin, and the centres of its pairs
            points += [model.jointPlacements[i].translation for i in range(1, model.njoints)
                       if model.parents[i] == body]
            for closure in mechanism.closures:
                placed = map(mechanism.centred_frame, (*closure.frames, *closure.between))
                points += [M.translation for joint, M in placed if joint == body]
            at = evaluation.data.oMi[body]
            positions = points @ at.rotation.T + at.translation
            twists = velocities @ evaluation.body_jacobian(body).T
            spins = twists[:, 3:]
            speeds = scale * np.abs(
                twists[:, None, :3] + np.cross(spins[:, None], positions)).max(axis=(0, 2))
            fastest = float(max(np.abs(spins).max(), speeds[0]))
            axes = row_space(spins[np.abs(spins).max(axis=1) > IDLE * fastest], IDLE)
            steady = np.eye(3)  # directions that stay as they are
            if len(axes):
                steady = axes @ at.rotation if len(axes) == 1 else np.empty((0, 3))
            marks[body] = BodyMark(np.array(points)[speeds <= IDLE * fastest], steady)
    return marks


# ---------------------------------------------------------------- the check


class ModeKind(NamedTuple):
    """Properties of a closed configuration.

    Attributes:
        nullity: freedoms to first order with fixed coordinates.
        idle: (joint's name, (k, nv) velocities) of the passive links.
        motions: (d, nv) finite motions, scaled; in a regular configuration the passive ones.
    """

    nullity: int
    idle: list[tuple[str, Array]]
    motions: Array

    @property
    def passive(self) -> int:
        """Number of passive freedoms."""
        return sum(len(v) for _, v in self.idle)

    @property
    def is_singular(self) -> bool:
        """Whether it can move to first order, without passive freedoms."""
        return self.nullity > self.passive

    @property
    def moves(self) -> bool:
        """Whether it has a finite motion, without passive freedoms."""
        return len(self.motions) > self.passive


class ModeCheck:
    """The closure equations of a mechanism with fixed coordinates.

    Attributes:
        held: their values [rad, m].
        free: (nv,) velocities that close the loops.
        rods: by the joint of each of their bodies.
    """

    def __init__(
        self, mechanism: Mechanism, held: Mapping[str, float], rods: list[Rod], tolerance: float,
        gap: float,
    ) -> None:
        self.mechanism, self.held, self.tolerance = mechanism, dict(held), tolerance
        self.rods, self.gap = rods, gap
        self.evaluation = LoopEquations(mechanism)
        self.free = np.ones(mechanism.model.nv, dtype=bool)
        self.fixed = [mechanism.coordinate_table[name].v for name in held]
        self.free[self.fixed] = False

    def close(self, q: Array, iterations: int = 60) -> Array | None:
        """Return q closed, with fixed values; None if that fails or gives a mirror image."""
        q, error = close(self.evaluation, q, self.free, self.tolerance, iterations)
        return q if error <= SAME_MODE * SAME_MODE and not self.evaluation.mirrored() else None

    def holds(self, q: Array) -> bool:
        """Whether the equations left out by the mechanism hold at q, to the gap allowed."""
        return gap_of(self.mechanism, q, self.evaluation.angles) <= self.gap

    def kind(self, q: Array) -> ModeKind:
        """Return the properties of a closed configuration."""
        evaluation, n = self.evaluation, self.evaluation.constraints.n_closure
        idle = idle_freedoms(evaluation, q, self.fixed)
        evaluation.update(q)
        inner = null_space(evaluation.jacobian[:n, self.free], TOLERANCES.half_precision)
        tangents = np.zeros((len(inner), len(self.free)))
        tangents[:, self.free] = inner
        kind = ModeKind(len(tangents), idle, tangents)
        if kind.is_singular:
            kind = kind._replace(motions=finite_motions(evaluation, q, tangents, self.free))
        evaluation.update(q)
        return kind

    def marks(
        self, q: Array, idle: list[tuple[str, Array]], all_copies: bool
    ) -> dict[int, BodyMark]:
        """Return the relevant features of every body, for comparing modes.

        `all_copies`: whether turned rods, and links inside chains of hinges, are relevant too.
        """
        marks = dict.fromkeys(range(1, self.mechanism.model.njoints), WHOLE)
        self.evaluation.update(q)
        marks |= resting(self.evaluation, idle)
        if not all_copies:
            marks |= {i: BodyMark(line.point[None], line.direction[None])
                      for rod in self.rods for i, line in rod.lines.items()}
            marks |= dict.fromkeys(uncounted_links(self.mechanism), NOTHING)
        return marks

    def signature(self, marks: Mapping[int, BodyMark], q: Array) -> Array:
        """Return the marks (rows, 3) at a configuration."""
        n, length = self.mechanism.model.njoints, self.mechanism.characteristic_length
        self.evaluation.update(q)
        return rows_of(marks, n, length) @ self.evaluation.placements.reshape(4 * n, 3)

    # ------------------------------------------------------------ links that stand as they like

    def _columns(self, bodies: set[int], with_children: bool) -> NDArray[np.bool_]:
        """Return (nv,) the velocities of the joints of bodies."""
        model = self.mechanism.model
        mask = np.zeros(model.nv, dtype=bool)
        for i in range(1, model.njoints):
            if i in bodies or (with_children and int(model.parents[i]) in bodies):
                mask[model.idx_vs[i] : model.idx_vs[i] + model.nvs[i]] = True
        return mask & self.free

    def with_rods(self, rods: tuple[Rod, ...], q: Array) -> Array | None:
        """Return q with rods placed between their ends, all else fixed, and then closed."""
        if not rods:
            return self.close(q)
        columns = self._columns({i for rod in rods for i in rod.lines}, with_children=False)
        rng = np.random.default_rng(5)
        for _ in range(TRIES):
            result, error = close(self.evaluation, q, columns, self.tolerance)
            if error <= SAME_MODE:
                return self.close(result)
            q = self.shaken(rods, q, rng)
        return None

    def shaken(self, rods: Iterable[Rod], q: Array, rng: np.random.Generator) -> Array:
        """Return q with rods turned at random."""
        columns = self._columns({i for rod in rods for i in rod.lines}, with_children=False)
        angles = rng.uniform(-np.pi, np.pi, len(columns))
        scale = self.mechanism.velocity_scale
        return pin.integrate(self.mechanism.model, q, np.where(columns, scale * angles, 0.0))

    def settled(self, q: Array, base: Array, marks: Mapping[int, BodyMark]) -> Array:
        """Return the copy of a mode with rods and passive links as in `base`, if near.

        So the result does not depend on the start that led to the mode.
        """
        model = self.mechanism.model
        bodies = {i for i, mark in marks.items() if mark is not WHOLE}
        if not bodies:
            return q
        start = q.copy()
        for i in bodies:
            own = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
            start[own] = base[own]
        columns = self._columns(bodies, with_children=True)
        result, error = close(self.evaluation, start, columns, self.tolerance)
        polished = self.close(result) if error <= SAME_MODE else None
        if polished is None:
            return q
        apart = np.abs(self.signature(marks, polished) - self.signature(marks, q))
        return polished if apart.max(initial=0.0) < SAME_MODE else q

    # ------------------------------------------------------------ States

    def state(self, q: Array, branch: str = "") -> State:
        """Return a closed configuration as a State."""
        q, model = nearest_turn(self.mechanism, q, self.held, {}), self.mechanism.model
        for i, name in enumerate(self.mechanism.pairs, start=1):
            if not PAIRS[name].is_linear:  # quaternions of one sign: w, or the first that is not 0
                last = model.idx_qs[i] + model.nqs[i]
                quaternion = q[[last - 1, *range(last - 4, last - 1)]]
                if quaternion[np.abs(quaternion) > SAME_MODE][0] < 0.0:
                    q[last - 4 : last] *= -1.0
        self.evaluation.update(q)
        return State(self.mechanism, q, closure_error=self.evaluation.closure_error,
                     angles=self.evaluation.angles, branch=branch)


def are_joined(check: ModeCheck, q: Array, other: Array) -> bool:
    """Whether loops are closed between two near closed configurations (nq,).

    Two modes without motion are then one, up to round-off.
    """
    difference = turn_free_difference(check.mechanism, q, other)
    size = float(np.linalg.norm(difference))
    for part in BETWEEN if size < PATH_LENGTH else ():
        step = check.mechanism.velocity_scale * part * difference
        start = pin.integrate(check.mechanism.model, q, step)
        result, error = close(check.evaluation, start, check.free, check.tolerance,
                             cut=TOLERANCES.well_conditioned)
        moved = float(np.linalg.norm(turn_free_difference(check.mechanism, start, result)))
        if error > SAME_MODE * SAME_MODE or moved > TOLERANCES.unexplained * size:
            return False
    return size < PATH_LENGTH


def continuum_at(check: ModeCheck, q: Array, kind: ModeKind) -> Continuum:
    """Return the coordinates that move at a configuration, and drivers that would stop them."""
    mechanism, motions = check.mechanism, kind.motions
    if kind.idle:
        scaled = np.vstack([v for _, v in kind.idle]) / mechanism.velocity_scale
        passive = decompose(scaled).vt[: rank(scaled)]
        motions = motions - motions @ passive.T @ passive
    motions = decompose(motions).vt[: len(kind.motions) - kind.passive]
    speeds = np.abs(motions).max(axis=0)
    table = mechanism.coordinate_table.values()
    moving = [c for c in table if speeds[c.v] > MOVING * speeds.max()]
    driven = [mechanism.driven_coordinate(name) for name in mechanism.drivers]
    first = [c for c in driven if c in moving]
    rest = sorted((c for c in moving if c not in first),
                  key=lambda c: (c.q < 0, -round(float(speeds[c.v]), 6)))
    hold: list[str] = []
    basis = np.empty((len(motions), 0))
    for c in [*first, *rest]:
        wider = np.hstack([basis, motions[:, c.v : c.v + 1]])
        if decompose(wider).s[-1] > HOLDS * MOVING and len(hold) < len(motions):
            basis = wider
            hold.append(next((d for d, x in mechanism.drivers.items()
                              if mechanism.driven_coordinate(x.joint) == c), c.name))
    return Continuum(check.state(q), len(motions), tuple(c.name for c in moving), tuple(hold))


def signs_of(check: ModeCheck, modes: list[tuple[Array, ModeKind]]) -> list[str]:
    """Return the signs of the determinants of the closed loops at modes, in words.

    The same redundant equations are left out in all modes.
    """
    evaluation, mechanism = check.evaluation, check.mechanism
    nv, n = mechanism.model.nv, evaluation.constraints.n_closure
    regular = [k for k, (_, kind) in enumerate(modes) if not kind.is_singular]
    jacobians = np.zeros((len(regular), *evaluation.jacobian.shape))
    for at, k in enumerate(regular):
        evaluation.update(modes[k][0])
        jacobians[at] = evaluation.jacobian
    drive = np.eye(nv)[sorted(check.fixed)]
    words = ["" if k in regular else "singular" for k in range(len(modes))]
    count = nv - len(drive) - (jacobians.shape[1] - n)
    rows = common_rows(jacobians[:, :n], drive, count)
    if len(rows) == count and nv:
        whole = [np.vstack([j[rows], j[n:], drive]) for j in jacobians]
        for k, sign in zip(regular, determinant_signs(np.array(whole).reshape(-1, nv, nv)),
                           strict=True):
            words[k] = {1: "+", -1: "-", 0: ""}[sign]
    return words
