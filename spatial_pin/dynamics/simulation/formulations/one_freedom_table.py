"""A mechanism of one freedom as functions of its coordinate s, exact to round-off.

Along its branch everything is a smooth function of s. Pieces of Chebyshev polynomials through
exactly closed configurations hold q, dq/ds, d²q/ds² and the reduced equation of motion

    m(s) s'' + h(s) s'² + g(s) = forces,

with m = t^T M t, h = t^T (M c + C(q, t)), g = t^T gravity, t = dq/ds, c = d²q/ds². A piece is
halved until its last coefficients are round-off, or as small as the closure tolerance asks for.
After a whole turn that brings all bodies back, pieces are used again.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.vectorised_tree import flat_tree_of
from spatial_pin.dynamics.forces import Forces
from spatial_pin.dynamics.simulation.formulations.free_rotation import Spins
from spatial_pin.dynamics.simulation.formulations.one_freedom_nodes import NodeRows
from spatial_pin.dynamics.simulation.formulations.one_freedom_path import Path
from spatial_pin.dynamics.simulation.independent_coordinates import Lost
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.chebyshev import (
    CELLS,
    FEWER,
    NODES,
    Piece,
    cells_of,
    coefficients_of,
    points,
    polynomials,
    polynomials_at,
)
from spatial_pin.numerics.linalg import Array

PIECES = 6  # of a turn, before any is halved
HALVINGS = 7
TAIL = 3  # last coefficients that tell the error
USELESS = 0.3  # of the error that a halved piece may keep, else it is noise that halving keeps
NEAR = 0.1  # of a piece's width: limits nearer than this make it useless
NOISE = 1e-7  # error of a piece that is not taken any more
ROUND_OFF = 2e-12  # of a coefficient, by the largest
FINER = 1e-2  # error of a piece, by the tolerance, that is good enough
SAFELY = 0.1  # of that, the error with which as many nodes do for the pieces beside it
SMALL = 1e-2  # columns smaller than this, by the largest of their kind, are judged by it
SAME = 1e-6  # difference of coordinates, and of their slopes, that are the same again
TURN = 2.0 * math.pi


class Table:
    """Everything about a one-freedom mechanism as functions of its coordinate.

    Args:
        path: the branch, at the start of the coordinate.
        coordinate: the coordinate.
        forces: the springs, whose lengths are tabulated too.
        spins: bodies whose spin is left out: see there what stands in the places of their joints.
        tolerance: closure residual that is asked for [-].
    """

    def __init__(
        self, mechanism: Mechanism, path: Path, coordinate: Coordinate, forces: Forces,
        spins: Spins, tolerance: float,
    ) -> None:
        self.mechanism, self.path, self.coordinate, self.forces = (
            mechanism, path, coordinate, forces)
        self.model = mechanism.model
        self.nodes = NODES  # of the next piece
        self.exact = max(ROUND_OFF, FINER * tolerance)
        self.rows = NodeRows(path, forces, spins)
        self.columns = self.rows.columns
        _, t, *_ = self.columns
        self.often = [*range(self.columns.reduced.start, self.columns.reduced.stop - 1)]
        for body in spins.bodies:  # columns that every evaluation wants
            self.often += range(t.start + body.v.start, t.start + body.v.stop)
            self.often += range(body.q.start, body.q.start + 3)
        self.turning = coordinate.unit == "rad"
        size = mechanism.velocity_scale[coordinate.v]
        self.span = TURN / PIECES if self.turning else size / PIECES
        self.pieces: dict[tuple[int, int], Piece] = {}
        self.divided: set[tuple[int, int]] = set()  # pieces too long, or lost
        self.divided_in_a_turn: set[tuple[int, int]] = set()  # the same, numbered within a turn
        self.first_made: dict[tuple[int, int], int] = {}
        self.period: Array | None = np.empty(0)  # empty while not known, None if there is none
        self.piece: Piece | None = None
        self.turns = np.array([c.q for c in mechanism.coordinate_table.values()
                                if c.q >= 0 and c.unit == "rad"], dtype=int)

    def pace_near(self, s: float) -> float:
        """Return how fast joints move at most, scaled, at the nodes of the piece that holds s.

        Raises:
            Lost: the branch does not go there.
        """
        piece = self._piece_at(s)
        if piece is None:
            return self._pace(self._beside_pieces(s)[None])
        return piece.pace

    def reduced(self, s: float) -> list[float]:
        """Return m, h and g at s, and w and d of every body that spins.

        Raises:
            Lost: the branch does not go there.
        """
        piece = self.piece
        if piece is None or not piece.first <= s <= piece.last:
            piece = self._piece_at(s)
            if piece is None:
                often: list[float] = self._beside_pieces(s)[self.often].tolist()
                return often
        place = CELLS * (s - piece.first) / (piece.last - piece.first)
        k = min(int(place), CELLS - 1)
        x = 2.0 * (place - k) - 1.0
        return [a + x * (b + x * (c + x * (d + x * (e + x * (f + x * g)))))
                for a, b, c, d, e, f, g in piece.cells[k]]

    def columns_at(self, s: float) -> Array:
        """Return all columns (width,) at s, q with its whole turns.

        Raises:
            Lost: the branch does not go there.
        """
        piece = self._piece_at(s)
        if piece is None:
            return self._beside_pieces(s)
        values = polynomials(piece.part(s)) @ piece.coefficients
        values[self.columns.q] += piece.shift
        return values

    def columns_of(self, places: Array) -> Array:
        """Return all columns (N, width) at places (N,), q with its whole turns.

        Raises:
            Lost: the branch does not go to one of them.
        """
        found = np.empty((len(places), self.columns.width))
        rest = np.arange(len(places))
        while rest.size:  # at least the first is found
            piece = self._piece_at(float(places[rest[0]]))
            if piece is None:
                found[rest[0]], rest = self._beside_pieces(float(places[rest[0]])), rest[1:]
                continue
            inside = (piece.first <= places[rest]) & (places[rest] <= piece.last)
            here, rest = rest[inside], rest[~inside]
            found[here] = polynomials_at(piece.part(places[here])) @ piece.coefficients
            found[here, self.columns.q] += piece.shift
        return found

    def _piece_at(self, s: float) -> Piece | None:
        """Return the piece that holds s, None where none is exact enough."""
        piece = self.piece
        if piece is None or not piece.first <= s <= piece.last:
            piece = self._find(s)
            self.piece = piece or self.piece
        return piece

    def _beside_pieces(self, s: float) -> Array:
        """Return all columns (width,) at s, where no piece is exact enough: near a limit.

        Raises:
            Lost: the branch does not go there.
        """
        turns = 0
        if self.period is not None and self.period.size:  # in the first turn, which is nearest
            turns = math.floor((s - self.path.start) / TURN)
        values = self.rows.at(s - turns * TURN)
        if self.period is not None and turns:
            values[self.columns.q] += turns * self.period
        return values

    def _pace(self, rows: Array) -> float:
        """Return how fast joints move at most, scaled, in rows (N, width)."""
        return float(np.abs(rows[:, self.columns.t] / self.mechanism.velocity_scale).max())

    def images(self, crossing: float, low: float, high: float) -> list[float]:
        """Return where in (low, high] a crossing is met, in every turn if turns are alike."""
        if self.period is None or not self.period.size:
            return [crossing] if low < crossing <= high else []
        first = math.floor((low - crossing) / TURN) + 1
        last = math.floor((high - crossing) / TURN)
        return [crossing + TURN * k for k in range(first, last + 1)]

    def springs(self, values: Array, rate: float) -> tuple[float, float]:
        """Return the force of springs and resistance on the coordinate, and the energy's slope.

        Args:
            values: columns at the place, from `columns_at`.
            rate: ds/dt.
        """
        force = stored = 0.0
        t, lengths = values[self.columns.t], values[self.columns.springs]
        for line, (length, slope) in zip(self.forces.lines, lengths.reshape(-1, 2).tolist(),
                                         strict=True):
            force -= line.law(length, slope * rate) * slope
            if line.storing:
                stored += line.storing(length) * slope
        for turn in self.forces.turns:
            x, slope = float(values[turn.q]), float(t[turn.v])
            force -= turn.law(x, slope * rate) * slope
            if turn.storing:
                stored += turn.storing(x) * slope
        if self.forces.resistance:
            force += float(self.forces.resistance.forces(t * rate) @ t)
        return force, stored

    def configuration(self, s: float, values: Array) -> Array:
        """Return q (nq,) at s, where the columns have these values."""
        q = pin.normalize(self.model, values[self.columns.q])
        q[self.coordinate.q] = s
        return q

    def finish(self, places: Array, q: Array) -> None:
        """Make interpolated q (N, nq) at places (N,) configurations, in place."""
        flat_tree_of(self.mechanism).normalize(q.T)
        q[:, self.coordinate.q] = places

    def _find(self, s: float) -> Piece | None:
        """Return the piece that holds s, made if need be; halved as long as that makes it exacter.

        None where even the shortest is not exact enough.

        Raises:
            Lost: s is not finite, or too large.
        """
        if not math.isfinite(s):
            raise Lost
        best: tuple[int, int, Piece] | None = None
        tried = []
        for level in range(HALVINGS):
            k = self._number(level, s)
            if self._is_divided(level, k) or (
                    level < HALVINGS - 1 and self._is_at_limit(level, k)):
                continue
            piece = self.pieces.get((level, k)) or self._again(level, k) or self._make(level, k)
            tried.append((level, k))
            if piece is None:
                continue
            if best is not None and piece.tail > USELESS * best[2].tail:
                break
            best = level, k, piece
            if piece.tail <= self.exact:
                break
        if best is None or best[2].tail > NOISE:
            self._divide(tried)
            return None
        self._divide(tried[: tried.index(best[:2])])
        return self._keep(*best)

    def _ends(self, level: int, k: int) -> tuple[float, float]:
        """Return the ends of a piece: to the bit those of its neighbours, halved or not."""
        width = self.span / 2**level
        return self.path.start + k * width, self.path.start + (k + 1) * width

    def _number(self, level: int, s: float) -> int:
        """Return the number of the piece of a level that holds s.

        Raises:
            Lost: s is so large that pieces are hardly longer than its round-off.
        """
        k = math.floor((s - self.path.start) / self.span * 2**level)
        for near in (k, k - 1, k + 1):  # s may round into the piece beside
            first, last = self._ends(level, near)
            if first <= s <= last and last - first > 4.0 * math.ulp(s):
                return near
        raise Lost(f"{self.coordinate.name} = {s:.6g} {self.coordinate.unit} is too large to be "
                   "told from its neighbours; count it from a value near 0")

    def _divide(self, pieces: list[tuple[int, int]]) -> None:
        """Remember pieces, by level and number, not to be made again, in no turn."""
        self.divided.update(pieces)
        self.divided_in_a_turn.update((level, k % (PIECES * 2**level)) for level, k in pieces)

    def _is_divided(self, level: int, k: int) -> bool:
        if self.period is None or not self.period.size:
            return (level, k) in self.divided
        return (level, k % (PIECES * 2**level)) in self.divided_in_a_turn

    def _is_at_limit(self, level: int, k: int) -> bool:
        """Whether a piece holds a known limit, or ends so near to one that it will not do.

        Functions go as the square root there: coefficients of Chebyshev polynomials fall slowly.
        """
        first, last = self._ends(level, k)
        near = NEAR * (last - first)
        return any(first - near <= limit <= last + near for limit in self.path.limits)

    def _keep(self, level: int, k: int, piece: Piece) -> Piece:
        self.pieces[level, k] = piece
        self.first_made.setdefault((level, k % (PIECES * 2**level)), k)
        return piece

    def _make(self, level: int, k: int) -> Piece | None:
        """Return a new piece; None where the branch does not go."""
        ends = self._ends(level, k)
        found = self._through(*ends, self.nodes)
        if found is not None and found.tail > self.exact and self.nodes < NODES:
            found = self._through(*ends, NODES)
        return found

    def _through(self, first: float, last: float, n: int) -> Piece | None:
        """Return the piece through n nodes; None where the branch does not go."""
        try:
            rows = self.rows(first + 0.5 * (last - first) * (1.0 + points(n)))
        except Lost:
            return None
        coefficients = np.zeros((NODES, self.columns.width))
        coefficients[:n] = coefficients_of(rows)
        tail = self._tail(coefficients[:n])
        if n == NODES:
            enough = (k for k in FEWER if self._tail(coefficients[:k]) < SAFELY * self.exact)
            self.nodes = next(enough, NODES)
        return Piece(first, last, coefficients, cells_of(coefficients[:, self.often]),
                     self._pace(rows), np.zeros(self.model.nq), tail)

    def _again(self, level: int, k: int) -> Piece | None:
        """Return a piece of a turn before or after, if all bodies stand as they did then.

        Found to be so at one place, it is so at all others: the branch is one closed curve.
        """
        turn = PIECES * 2**level
        made = self.first_made.get((level, k % turn))
        if not self.turning or made is None or self.period is None:
            return None
        old, turns = self.pieces[level, made], (k - made) // turn
        if self.period.size == 0:
            self.period = self._compare(old, turns)
            if self.period is None:
                return None
        first, last = self._ends(level, k)
        return old._replace(first=first, last=last, shift=old.shift + turns * self.period)

    def _compare(self, old: Piece, turns: int) -> Array | None:
        """Return what a turn of the coordinate adds to q (nq,); None if bodies do not come back."""
        middle = 0.5 * (old.first + old.last)
        there = polynomials(0.0) @ old.coefficients
        here = self.rows.at(middle + turns * TURN)
        q, t = self.columns.q, self.columns.t
        shift = here[q] - there[q] - old.shift
        whole = np.zeros(len(shift))
        whole[self.turns] = TURN * np.round(shift[self.turns] / TURN)
        same = np.abs(shift - whole).max() < SAME and np.abs(here[t] - there[t]).max() < SAME
        return whole / turns if same else None

    def _tail(self, coefficients: Array) -> float:
        """Return the last coefficients of q, t, spring lengths, m, h and g, by the largest."""
        tail = 0.0
        for columns in (self.columns.q, self.columns.t, self.columns.springs, self.columns.reduced):
            sizes = np.abs(coefficients[:, columns])
            largest = sizes.max(axis=0, initial=0.0)
            if columns == self.columns.reduced:
                largest = sizes[:, [0, 0, 3, 3]].max(axis=0)  # h is measured by m, g by the energy
            largest = np.maximum(largest, SMALL * largest.max(initial=0.0))
            largest[largest == 0.0] = 1.0
            tail = max(tail, float((sizes[-TAIL:] / largest).max(initial=0.0)))
        return tail
