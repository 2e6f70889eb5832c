"""What a table is made of: everything about a mechanism of one freedom at nodes of a piece.

Nodes that lie ahead on a plain stretch of the branch are closed together
(`continuation.collocation`); those near a crossing come from its strip, and those that are left
one after the other.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.continuation import collocation
from spatial_pin.continuation.stacked_branch import BranchBatch
from spatial_pin.dynamics.forces import Forces
from spatial_pin.dynamics.simulation.formulations.free_rotation import Spins
from spatial_pin.dynamics.simulation.formulations.one_freedom_path import Path
from spatial_pin.dynamics.simulation.independent_coordinates import Lost
from spatial_pin.mechanism.inertia import MassMatrix
from spatial_pin.numerics.chebyshev import Columns
from spatial_pin.numerics.linalg import Array

WEAK = 0.1  # pivot at an end, by the largest of the piece, at which a crossing may be near
LONGEST = 0.3  # rad, characteristic lengths, that a joint moves in a step between nodes
MOST = 40  # steps to the nodes of a piece
FEWEST = 12  # nodes that are worth being closed together


class Place(NamedTuple):
    """A closed configuration: q (nq,), its derivatives t, c (nv,), angles of screw closures."""

    q: Array
    t: Array
    c: Array
    angles: Array


class NodeRows:
    """The columns of a table at places of a branch.

    Args:
        path: the branch.
        forces: the springs, whose lengths are tabulated too.
        spins: bodies whose spin is left out: see there what stands in the places of their joints.

    Attributes:
        columns: where the functions stand.
    """

    def __init__(self, path: Path, forces: Forces, spins: Spins) -> None:
        self.path, self.forces, self.spins = path, forces, spins
        self.model = path.branch.model
        self._weightless = self.model.copy()
        self._weightless.gravity = pin.Motion.Zero()
        self._data = self.model.createData()
        self._mass = MassMatrix(self.model)
        self._batch = BranchBatch(path.branch) if collocation.is_possible(path.branch) else None
        nq, nv, lines = self.model.nq, self.model.nv, len(forces.lines)
        ends = np.cumsum([0, nq, nv, nv, 2 * lines, len(path.branch.angles), 4]).tolist()
        q, t, c, springs, turns, reduced = (slice(a, b) for a, b in pairwise(ends))
        self.columns = Columns(q, t, c, springs, turns, reduced, ends[-1])

    def __call__(self, values: Array) -> Array:
        """Return all columns (N, width) at descending values (N,) of a piece.

        Raises:
            Lost: the branch does not go to one of them.
        """
        return self._or_back(self._rows, values)

    def _or_back(self, rows: Callable[[Any], Array], places: Any) -> Array:
        """Return rows at places; where the branch does not go to them it stays where it was.

        Raises:
            Lost: the branch does not go to one of them.
        """
        path, branch = self.path, self.path.branch
        start = branch.s, branch.q, branch.angles
        try:
            return rows(places)
        except Lost:
            if not path.is_on_strip(start[0]):
                path.stand(*start[1:])  # the way back from where it ended is a long one
            raise

    def _rows(self, values: Array) -> Array:
        path = self.path
        order = self._nearest(values)
        rows, pivots = np.empty((len(values), self.columns.width)), np.ones(len(values))
        plain = []
        places = self._together(values[order])
        if not places:  # something lies ahead, and is soon met on the way to the other end
            path.go_to(float(values[order[-1]]))
            order = self._nearest(values)
        while order:
            for place, pivot in places:
                i = order.pop(0)
                rows[i], pivots[i] = self._row(place), pivot
                plain.append(i)
            if order:
                i = order.pop(0)
                rows[i] = self._at(float(values[i]))
                if not path.is_on_strip(float(values[i])):
                    plain.append(i)
                    pivots[i] = path.branch.system.pivots()[1]
            if order:
                places = self._together(values[order])
        self._look_beyond(values, pivots)
        for i in plain:
            if path.is_on_strip(float(values[i])):
                rows[i] = self._at(float(values[i]))
        return rows

    def _look_beyond(self, values: Array, pivots: Array) -> None:
        """Look for a crossing just beyond an end of a piece where the pivots are weak."""
        width = float(values[0] - values[-1])
        for end, beyond in ((0, 0.25 * width), (-1, -0.25 * width)):
            if pivots[end] < WEAK * pivots.max():
                with contextlib.suppress(Lost):
                    self.path.go_to(float(values[end]) + beyond)

    def _nearest(self, values: Array) -> list[int]:
        """Return the order of values that begins where the branch stands."""
        order: list[int] = np.argsort(np.abs(values - self.path.value), kind="stable").tolist()
        return order

    def at(self, s: float) -> Array:
        """Return all columns (width,) at a place.

        Raises:
            Lost: the branch does not go there.
        """
        return self._or_back(self._at, s)

    def _at(self, s: float) -> Array:
        self.path.go_to(s)
        branch = self.path.branch
        return self._row(Place(branch.q, branch.t, branch.c, branch.angles))

    def _together(self, values: Array) -> list[tuple[Place, float]]:
        """Return the first of the places at values (N,), as many as can be closed together.

        And the smallest over the largest pivot of the equations there, roughly. The branch stands
        at the last of them.

        Raises:
            Lost: the branch does not go to the first.
        """
        batch, path, branch = self._batch, self.path, self.path.branch
        values = values[: path.clear(values)]
        if batch is None or len(values) < FEWEST or len(set(np.sign(np.diff(values)))) > 1:
            return []
        path.go_to(float(values[0]))
        if path.clear(values) < len(values):  # a crossing was found on the way
            return []
        if branch.system.has_redundant_rows:
            branch.reselect()  # else it may be done on the way, which ends the steps
        start = branch.q, branch.angles
        skeleton = self._steps(batch, float(values[-1] - values[0]))
        if skeleton is None:
            return []
        if abs(skeleton.end - values[0]) < abs(values[-1] - values[0]) * (1.0 - 1e-9):
            values = values[np.abs(values - values[0]) <= abs(skeleton.end - values[0])]
        points = collocation.closed(batch, skeleton, values)
        p, good = points.placed, points.good
        if not good:
            path.stand(*start)
            return []
        path.stand(p.q[:, good - 1].copy(), p.angles[:, good - 1], anew=False)
        magnitude = points.lu.magnitude
        if good > 1:
            last = slice(good - 2, good)
            room = collocation.room_after(values[last], magnitude[last], skeleton.h)
            branch.limit_room(room, skeleton.h)
        sizes = np.exp(magnitude - magnitude[good - 1])
        pivots = (branch.system.pivots()[1] * sizes).tolist()
        parts = (x.T[:good] for x in (p.q, points.t, points.c, p.angles))
        return list(zip(map(Place, *parts), pivots[:good], strict=True))

    def _steps(self, batch: BranchBatch, way: float) -> collocation.Skeleton | None:
        """Take long steps with the branch."""
        branch = self.path.branch
        pace = float(np.abs(branch.t / branch.scale).max())
        n = max(math.ceil(abs(way) * pace / LONGEST), collocation.FEWEST - 1)
        return collocation.steps(batch, way / n, n) if n <= MOST else None

    def _row(self, place: Place) -> Array:
        """Return all columns (width,) at a closed configuration."""
        (q, t, c, angles), model, data = place, self.model, self._data
        springs = self._springs(place)
        if len(self.spins):
            t, c = self.spins.without(q, t, c)
        gravity = pin.computeGeneralizedGravity(model, data, q).copy()
        motion = pin.rnea(self._weightless, data, q, t, c)  # a difference would lose its digits
        potential = float(pin.computePotentialEnergy(model, data, q))
        reduced = [t @ self._mass(q) @ t, t @ motion, t @ gravity, potential]
        if len(self.spins):
            q, t, c = self.spins.put(q, t, c)
        return np.concatenate([q, t, c, springs, angles, reduced])

    def _springs(self, place: Place) -> list[float]:
        """Return the length of every spring between bodies, and its slope."""
        if not self.forces.lines:
            return []
        evaluation = self.path.evaluation
        if self.path.q is not place.q:
            evaluation.turns[:] = place.angles
            evaluation.update(place.q)
        rows = [self.forces.row(evaluation, line)[:2] for line in self.forces.lines]
        return [x for row, length in rows for x in (length, float(row @ place.t))]
