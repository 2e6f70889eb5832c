"""What a closed configuration is with values held: a mode, or one of a set that can move."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import close
from spatial_pin.assembly.passive_freedoms import unseen_links
from spatial_pin.assembly.search.whole_turns import nearest_turn, turned_apart
from spatial_pin.assembly.state import State, gap_of
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mobility.finite_motions import WAY_OUT, finite_motions
from spatial_pin.mobility.idle_freedoms import idle_freedoms
from spatial_pin.mobility.modes.marks import NOTHING, WHOLE, Mark, of_line, resting, rows_of
from spatial_pin.mobility.modes.result import Continuum
from spatial_pin.mobility.modes.rods import Rod
from spatial_pin.numerics.linalg import (
    Array,
    common_rows,
    decompose,
    determinant_signs,
    null_space,
    rank,
)
from spatial_pin.numerics.tolerances import TOLERANCES

# Largest difference of two placements of one mode [characteristic lengths, 1]. At a singular mode
# it is the square root of the residual: loops count as closed at its square, 1e-10.
SAME_MODE = 1e-5
MOVING = 1e-3  # part of the fastest joint's speed that is worth a name: three digits of a report
# Part of a motion that coordinates must change by to hold it: a tenth leaves its place known to one
# digit less than theirs.
HOLDS = 0.1
# Parts of the way between two configurations where loops are looked at: what is closed there by
# chance is open at another.
BETWEEN = (0.25, 0.5, 0.75)
# Starts for rods whose other end cannot be reached from the guess: one in two reaches it, and all
# of so many fail in one of a million cases.
TRIES = 20


class Kind(NamedTuple):
    """What a closed configuration is.

    Attributes:
        nullity: freedoms to first order with the values held.
        idle: (joint's name, (k, nv) velocities) of the links that are passive.
        motions: (d, nv) finite motions, scaled; of a regular configuration the passive ones.
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
        """Whether it can move, passive freedoms apart, if only to first order."""
        return self.nullity > self.passive

    @property
    def moves(self) -> bool:
        """Whether it can really move, passive freedoms apart."""
        return len(self.motions) > self.passive


class Check:
    """The closure equations of a mechanism with coordinates held.

    Attributes:
        held: their values [rad, m].
        free: (nv,) which velocities may close the loops.
        rods: by the joint of each of their bodies.
    """

    def __init__(
        self, mechanism: Mechanism, held: Mapping[str, float], rods: list[Rod], tolerance: float,
        gap: float,
    ) -> None:
        self.mechanism, self.held, self.tolerance = mechanism, dict(held), tolerance
        self.rods, self.gap = rods, gap
        self.evaluation = Evaluation(constraints_of(mechanism))
        self.free = np.ones(mechanism.model.nv, dtype=bool)
        self.fixed = [mechanism.coordinate_table[name].v for name in held]
        self.free[self.fixed] = False

    def close(self, q: Array, iterations: int = 60) -> Array | None:
        """Return q closed, values held; None if that fails or gives a mirror image."""
        q, error = close(self.evaluation, q, self.free, self.tolerance, iterations)
        return q if error <= SAME_MODE * SAME_MODE and not self.evaluation.mirrored() else None

    def holds(self, q: Array) -> bool:
        """Whether the equations that the mechanism is without hold at q to the gap allowed."""
        return gap_of(self.mechanism, q, self.evaluation.angles) <= self.gap

    def kind(self, q: Array) -> Kind:
        """Return what a closed configuration is."""
        evaluation, n = self.evaluation, self.evaluation.constraints.n_closure
        idle = idle_freedoms(evaluation, q, self.fixed)
        evaluation.update(q)
        inner = null_space(evaluation.jacobian[:n, self.free], TOLERANCES.half_precision)
        tangents = np.zeros((len(inner), len(self.free)))
        tangents[:, self.free] = inner
        kind = Kind(len(tangents), idle, tangents)
        if kind.is_singular:
            kind = kind._replace(motions=finite_motions(evaluation, q, tangents, self.free))
        evaluation.update(q)
        return kind

    def is_joined(self, q: Array, other: Array) -> bool:
        """Whether loops are closed all the way between two closed configurations (nq,) nearby.

        Of modes that cannot move, both are then one, as far as round-off tells.
        """
        way = turned_apart(self.mechanism, q, other)
        size = float(np.linalg.norm(way))
        return size < WAY_OUT and all(self._is_closed_near(q, part * way, size) for part in BETWEEN)

    def _is_closed_near(self, q: Array, step: Array, size: float) -> bool:
        """Whether loops close a scaled step (nv,) from q, but for a tenth of a size right there."""
        start = pin.integrate(self.mechanism.model, q, self.mechanism.velocity_scale * step)
        found, error = close(self.evaluation, start, self.free, self.tolerance,
                             cut=TOLERANCES.well_conditioned)
        moved = float(np.linalg.norm(turned_apart(self.mechanism, start, found)))
        return error <= SAME_MODE * SAME_MODE and moved <= TOLERANCES.unexplained * size

    def continuum(self, q: Array, kind: Kind) -> Continuum:
        """Return what can move at a configuration, and what would hold it."""
        mechanism, motions = self.mechanism, kind.motions
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
        return Continuum(self.state(q), len(motions), tuple(c.name for c in moving), tuple(hold))

    def marks(self, q: Array, idle: list[tuple[str, Array]], all_copies: bool) -> dict[int, Mark]:
        """Return what tells modes apart of every body.

        Args:
            q: (nq,) a closed configuration.
            idle: its passive freedoms.
            all_copies: rods that are turned about their lines are told apart too, and links
                inside chains of hinges.
        """
        marks = dict.fromkeys(range(1, self.mechanism.model.njoints), WHOLE)
        self.evaluation.update(q)
        marks |= resting(self.evaluation, idle)
        if not all_copies:
            marks |= {i: of_line(line) for rod in self.rods for i, line in rod.lines.items()}
            marks |= dict.fromkeys(unseen_links(self.mechanism), NOTHING)
        return marks

    def signature(self, marks: Mapping[int, Mark], q: Array) -> Array:
        """Return the marks (rows, 3) at a configuration."""
        n, length = self.mechanism.model.njoints, self.mechanism.characteristic_length
        self.evaluation.update(q)
        return rows_of(marks, n, length) @ self.evaluation.placements.reshape(4 * n, 3)

    # ------------------------------------------------------------ links that stand as they like

    def _columns(self, bodies: set[int], with_children: bool) -> NDArray[np.bool_]:
        """Return (nv,) which velocities are those of the joints of bodies."""
        model = self.mechanism.model
        mask = np.zeros(model.nv, dtype=bool)
        for i in range(1, model.njoints):
            if i in bodies or (with_children and int(model.parents[i]) in bodies):
                mask[model.idx_vs[i] : model.idx_vs[i] + model.nvs[i]] = True
        return mask & self.free

    def place_rods(self, rods: tuple[Rod, ...], q: Array) -> Array | None:
        """Return q with rods placed between their ends, all else held, and then closed."""
        if not rods:
            return self.close(q)
        columns = self._columns({i for rod in rods for i in rod.lines}, with_children=False)
        rng = np.random.default_rng(5)
        for _ in range(TRIES):
            found, error = close(self.evaluation, q, columns, self.tolerance)
            if error <= SAME_MODE:
                return self.close(found)
            q = self.shaken(rods, q, rng)
        return None

    def shaken(self, rods: Iterable[Rod], q: Array, rng: np.random.Generator) -> Array:
        """Return q with rods turned at random."""
        columns = self._columns({i for rod in rods for i in rod.lines}, with_children=False)
        angles = rng.uniform(-np.pi, np.pi, len(columns))
        scale = self.mechanism.velocity_scale
        return pin.integrate(self.mechanism.model, q, np.where(columns, scale * angles, 0.0))

    def settled(self, q: Array, base: Array, marks: Mapping[int, Mark]) -> Array:
        """Return the copy of a mode in which rods and passive links stand as in `base`, if near.

        So that it does not depend on the start that found the mode.
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
        found, error = close(self.evaluation, start, columns, self.tolerance)
        polished = self.close(found) if error <= SAME_MODE else None
        if polished is None:
            return q
        apart = np.abs(self.signature(marks, polished) - self.signature(marks, q))
        return polished if apart.max(initial=0.0) < SAME_MODE else q

    # ------------------------------------------------------------ States

    def state(self, q: Array, branch: str = "") -> State:
        """Return a closed configuration as a State."""
        q = _one_sign(self.mechanism, nearest_turn(self.mechanism, q, self.held, {}))
        self.evaluation.update(q)
        return State(self.mechanism, q, closure_error=self.evaluation.closure_error,
                     angles=self.evaluation.angles, branch=branch)

    def signs(self, modes: list[tuple[Array, Kind]]) -> list[str]:
        """Return the signs of the determinants of the closed loops at modes, in words.

        Of redundant equations the same are left out in all modes.
        """
        evaluation, mechanism = self.evaluation, self.mechanism
        nv, n = mechanism.model.nv, evaluation.constraints.n_closure
        regular = [k for k, (_, kind) in enumerate(modes) if not kind.is_singular]
        jacobians = np.zeros((len(regular), *evaluation.jacobian.shape))
        for at, k in enumerate(regular):
            evaluation.update(modes[k][0])
            jacobians[at] = evaluation.jacobian
        drive = np.eye(nv)[sorted(self.fixed)]
        words = ["" if k in regular else "singular" for k in range(len(modes))]
        count = nv - len(drive) - (jacobians.shape[1] - n)
        rows = common_rows(jacobians[:, :n], drive, count)
        if len(rows) == count and nv:
            whole = [np.vstack([j[rows], j[n:], drive]) for j in jacobians]
            for k, sign in zip(regular, determinant_signs(np.array(whole).reshape(-1, nv, nv)),
                               strict=True):
                words[k] = {1: "+", -1: "-", 0: ""}[sign]
        return words


def _one_sign(mechanism: Mechanism, q: Array) -> Array:
    """Return q (nq,) with quaternions of one sign: w positive, or the first entry that is."""
    model = mechanism.model
    for i, name in enumerate(mechanism.pairs, start=1):
        if not PAIRS[name].is_linear:
            last = model.idx_qs[i] + model.nqs[i]
            quaternion = q[[last - 1, *range(last - 4, last - 1)]]
            if quaternion[np.abs(quaternion) > SAME_MODE][0] < 0.0:
                q[last - 4 : last] *= -1.0
    return q
