"""All closure equations of a mechanism, compiled to flat arrays and evaluated together.

With G the joint placements stacked as rows (columns of R, then p, of each joint), every vector
that a row is made of is linear in G: A, B, X = C_A G, C_B G, C_X G. Row i is then

    value      r  = A . B - c
    Jacobian   J  = sign * scale * (W J6),  W = (f B, X x B)
    bias       r'' at zero joint acceleration = A'' . B + 2 A' . B' + A . B''

where W is the wrench of the row at the world origin, J6 Pinocchio's world joint Jacobian and sign
is +1 (-1) for the freedoms that move body 2 (body 1) only. Columns are scaled by
`Mechanism.velocity_scale`, so that ranks and steps mean the same at every size. Bodies' rates
enter through G' = H^T G and G'' = (H^T H^T + H'^T) G with H the 4 x 4 matrix of the body twist.
Pinocchio's `computeJointJacobiansTimeVariation` is not used: in 4.1 it is wrong for joints whose
motion subspace varies (universal, composite).

A screw row adds -k * angle, the angle of two directions, from two auxiliary dot rows. A distance
that is that of two other frames (`length_between`) is the difference of two distance rows, the
second an auxiliary one.
A coupling row is linear in the joint coordinates. A passive row is the absolute spin of a body
about a line fixed in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.constraints.kinds import KINDS, Composed, Equation, Kind, Parts
from spatial_pin.constraints.trees import tree_of
from spatial_pin.constraints.workspaces import acquired
from spatial_pin.mechanism.coordinates import joint_values, needed, with_values
from spatial_pin.mechanism.equations import ConstraintEquation
from spatial_pin.mechanism.mechanism import Mechanism, point_on_body
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.taylor import Taylor

SHORT = 1e-3  # distance relative to the characteristic length below which it is no unit
DENSE_LIMIT = 60_000  # entries of C above which a sparse matrix is faster


class EquationLabel(NamedTuple):
    """Which equation of which closure a row is."""

    closure: str
    equation: int


class Term(NamedTuple):
    """A part of a vector: factor * (R_joint local + flag p_joint).

    Attributes:
        factor: number before it.
        joint: whose placement it is.
        local: (3,) in the joint's axes.
        flag: 1 for a point, 0 for a direction.
        frame: of the model, that the point is the origin of or the direction is fixed in; of an
            idle rotation's axis, which runs through two points, -1 less the axis' number.
    """

    factor: float
    joint: int
    local: Array
    flag: float
    frame: int


class _Fixed(NamedTuple):
    """A frame as it is fixed in the body of a joint."""

    frame: int
    joint: int
    placement: pin.SE3

    @classmethod
    def of(cls, mechanism: Mechanism, name: str) -> _Fixed:
        """Return the frame, link or joint of a name."""
        return cls(mechanism.frame_id(name), *mechanism.frame_on_joint(name))

    def origin(self, factor: float) -> Term:
        """Return its origin."""
        return Term(factor, self.joint, self.placement.translation, 1.0, self.frame)

    def direction(self, axis: Array, factor: float = 1.0) -> Term:
        """Return a direction (3,) in its axes."""
        return Term(factor, self.joint, self.placement.rotation @ axis, 0.0, self.frame)


class _Vectors:
    """Coefficient rows on G of one block (A, B or X), grown row by row, and their terms."""

    def __init__(self) -> None:
        self.terms: list[tuple[Term, ...]] = []

    def add(self, *terms: Term) -> None:
        """Add the sum of terms."""
        self.terms.append(terms)

    def entries(self) -> _Entries:
        """Return the entries of the rows, without zeros."""
        cells: dict[tuple[int, int], float] = {}
        for row, terms in enumerate(self.terms):
            for term in terms:
                for k, x in enumerate((*term.local, term.flag)):
                    at = row, 4 * term.joint + k
                    cells[at] = cells.get(at, 0.0) + term.factor * x
        found = [(*at, x) for at, x in cells.items() if x]
        rows, columns, values = zip(*found, strict=True) if found else ((), (), ())
        return _Entries(np.array(rows, np.intp), np.array(columns, np.intp),
                        np.array(values, float))


class _Entries(NamedTuple):
    """Entries of a matrix: where they are, and what."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    values: Array


class Constraints:
    """The compiled closure equations of a mechanism.

    Attributes:
        labels: closure and equation of each of the `n_rows` closure rows.
        n_rows: number of closure rows; `n_passive` rows of resolved passive freedoms follow them.
        n_angles: number of equations with an angle that counts turns.
        n_wrenches: of `Evaluation.row_wrenches`.
        equations: what they are made of, and after them the passive ones; see `kinds`.
        plain: closure equations that are one product each; their numbers are its own.
        composed: those that are more, by kind.
        elsewhere: (equation, product) of products that act on other bodies than the closure's.
        screws: (equation, product of the sine, pitch) of screws, in the order of their angles.
        spins: joint and unit axis in its frame (3,) of each resolved passive freedom.
        terms: of the vectors A, B and X of each product, see `Term`.
        supports: (njoints, nv) 1 for the freedoms that move the body of each joint.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.scale = 1.0 / mechanism.characteristic_length
        self.supports = _supports(mechanism.model)
        n = mechanism.model.njoints
        self._a, self._b, self._x = _Vectors(), _Vectors(), _Vectors()
        self._constants: list[float] = []
        self._factors: list[float] = []
        self._signs: list[Array] = []
        self.spins: list[tuple[int, Array]] = []
        labels: list[EquationLabel] = []
        made: list[tuple[Kind, Closure, ConstraintEquation]] = []
        for closure in mechanism.closures:
            for k, row in enumerate(closure.rows):
                made.append((KINDS["difference" if closure.between else row.kind], closure, row))
                self._add_row(row, closure)
                labels.append(EquationLabel(closure.name, k))
        self.n_products, self.n_angles = len(labels), 0
        self.couplings = [c for c in mechanism.closures if c.type == COUPLING]
        labels += [EquationLabel(c.name, 0) for c in self.couplings]
        equations = self._equations(made)
        self.passive_at = len(self._constants)
        spin = [self._add_passive(p.body, p.axis) for p in mechanism.passives]
        self.labels = tuple(labels)
        self.n_rows, self.n_passive = len(labels), len(spin)
        equations += [Equation(KINDS["idle"], (self.passive_at + k,)) for k in range(len(spin))]
        self.equations = tuple(equations)
        self.plain = np.array([at for at, e in enumerate(equations[: self.n_products])
                               if e.kind.is_product], np.intp)
        self.composed = _composed(self.equations)
        self.elsewhere = [(at, e.products[k]) for at, e in enumerate(self.equations)
                          for k in e.kind.elsewhere]
        self.n_wrenches = self.n_rows + len(self.elsewhere)
        self.screws = [(at, e.products[1], e.numbers[0]) for at, e in enumerate(self.equations)
                       if e.kind is KINDS["screw"]]
        a, b, x = (block.entries() for block in (self._a, self._b, self._x))
        self.terms = self._a.terms, self._b.terms, self._x.terms
        r = len(self._constants)
        self.c_abx = _matrix([a, b, x], [0, r, 2 * r], (3 * r, 4 * n))
        self.c_rates = _rate_matrix(a, b, r, n)
        self.rate_sum = _sum_of_rates(r)
        self.constants = np.array(self._constants)
        self.factors = np.array(self._factors).reshape(-1, 1)
        self.signs = np.array(self._signs).reshape(r, mechanism.model.nv)
        self.signs *= mechanism.velocity_scale
        self._signs.clear()  # many loops have many
        self.spin_bias = np.array(spin).reshape(self.n_passive, 6 * n)

    def _equations(self, made: list[tuple[Kind, Closure, ConstraintEquation]]) -> list[Equation]:
        """Return the closure equations; products beside their first ones are added kind by kind."""
        equations: list[Any] = [None] * len(made)
        for kind in KINDS.values():
            for at, (own, closure, row) in enumerate(made):
                if own is kind:
                    equations[at] = self._equation(kind, (at,), kind.parts(self, closure, row))
        kind = KINDS["coupling"]
        return equations + [self._equation(kind, (), kind.parts(self, closure, None))
                            for closure in self.couplings]

    def _equation(self, kind: Kind, first: tuple[int, ...], parts: Parts) -> Equation:
        angle = self.n_angles if kind.angle else -1
        self.n_angles += kind.angle is not None
        return Equation(kind, (*first, *parts.products), parts.coordinates, parts.numbers, angle)

    def _frames(self, names: Sequence[str]) -> tuple[_Fixed, _Fixed]:
        first, second = (_Fixed.of(self.mechanism, name) for name in names)
        return first, second

    def _add_distance(self, frames: tuple[str, ...], unit: float, constant: float) -> None:
        """Add the row d . d / 2 unit - constant of the vector d between two frames."""
        one, two = self._frames(frames)
        half = self.scale / (2.0 * unit)
        self._a.add(two.origin(1.0), one.origin(-1.0))
        self._b.add(two.origin(half), one.origin(-half))
        self._x.add(two.origin(2.0))
        self._finish(constant, 2.0, self.support(two.joint) - self.support(one.joint))

    def add_length(self, closure: Closure) -> int:
        """Add the product of the distance between the closure's other two frames."""
        self._add_distance(closure.between, unit_length(self.mechanism, closure), 0.0)
        return len(self._constants) - 1

    def _add_row(self, row: ConstraintEquation, closure: Closure) -> None:
        if row.u is None:  # distance: (d . d - L²) / 2L
            unit = unit_length(self.mechanism, closure) if closure.between else row.offset
            self._add_distance(closure.frames, unit, 0.5 * row.offset * self.scale)
            return
        one, two = self._frames(closure.frames)
        if row.w is None:  # point or screw: u . d
            self._a.add(two.origin(1.0), one.origin(-1.0))
            self._b.add(one.direction(row.u, self.scale))
            self._x.add(two.origin(1.0))
            self._finish(0.0, 1.0, self.support(two.joint) - self.support(one.joint))
        else:
            self._add_dot(one, row.u, two, row.w, row.offset)

    def _add_dot(self, one: _Fixed, u: Array, two: _Fixed, w: Array, cosine: float) -> None:
        self._a.add(two.direction(w))
        self._b.add(one.direction(u))
        self._x.add(two.direction(w))
        self._finish(cosine, 0.0, self.support(two.joint) - self.support(one.joint))

    def add_direction(self, closure: Closure, row: ConstraintEquation) -> tuple[int, int]:
        """Add the products sine and cosine of the angle of a row; return their numbers."""
        one, two = self._frames(closure.frames)
        assert row.angle_from is not None and row.angle_of is not None
        for u in row.angle_from[::-1]:  # y gives the sine, x the cosine
            self._add_dot(one, u, two, row.angle_of, 0.0)
        return len(self._constants) - 2, len(self._constants) - 1

    def _add_passive(self, body: str, axis: tuple[str, str]) -> Array:
        """Add the spin row; return its bias row on the stacked local body accelerations."""
        joint, _ = self.mechanism.frame_on_joint(body)
        a, b = (point_on_body(self.mechanism, joint, name) for name in axis)
        direction = (b - a) / np.linalg.norm(b - a)
        self.spins.append((joint, direction))
        self._a.add()
        self._b.add(Term(1.0, joint, direction, 0.0, -len(self.spins)))
        self._x.add()
        self._finish(0.0, 0.0, self.support(joint))
        bias = np.zeros(6 * self.mechanism.model.njoints)
        bias[6 * joint + 3 : 6 * joint + 6] = direction
        return bias

    def _finish(self, constant: float, factor: float, sign: Array) -> None:
        self._constants.append(constant)
        self._factors.append(factor)
        self._signs.append(sign)

    def support(self, joint: int) -> Array:
        """(nv,) 1 for the freedoms that move the body of `joint`."""
        mask: Array = self.supports[joint]
        return mask


def _composed(equations: tuple[Equation, ...]) -> list[Composed]:
    """Return equations that are more than one product each, those of a kind together."""
    found = []
    for kind in dict.fromkeys(e.kind for e in equations if not e.kind.is_product):
        rows = [at for at, e in enumerate(equations) if e.kind is kind]
        found.append(Composed(kind, np.array(rows), tuple(equations[at] for at in rows)))
    return found


def _supports(model: pin.Model) -> Array:
    """Return (njoints, nv): 1 for the freedoms that move the body of each joint."""
    supports = np.zeros((model.njoints, model.nv))
    for i in range(1, model.njoints):
        supports[i] = supports[model.parents[i]]
        supports[i, model.idx_vs[i] : model.idx_vs[i] + model.nvs[i]] = 1.0
    return supports


def unit_length(mechanism: Mechanism, closure: Closure) -> float:
    """Return the length [m] that a distance between other frames is divided by.

    It is theirs in the guess, so that the row is the difference of the lengths near there, or the
    characteristic length where that is next to nothing.
    """
    model, size = mechanism.model, mechanism.characteristic_length
    q = with_values(mechanism, mechanism.neutral, joint_values(mechanism, mechanism.guess))
    ends = []
    for joint, placement in map(mechanism.frame_on_joint, closure.between):
        for i in reversed(list(model.supports[joint])[1:]):  # a `pin.Data` of many loops is large
            own = model.joints[i].createData()
            model.joints[i].calc(own, q)
            placement = model.jointPlacements[i] * pin.SE3(own.M) * placement
        ends.append(placement.translation)
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return length if length > SHORT * size else size


def _rate_matrix(a: _Entries, b: _Entries, r: int, n: int) -> Any:
    """Return the matrix that takes (G'', G', G) of n joints to A'', A', A and then B, B', B''."""
    orders = [(a, 2), (a, 1), (a, 0), (b, 0), (b, 1), (b, 2)]
    blocks = [_Entries(x.rows, 12 * (x.columns // 4) + 4 * (2 - order) + x.columns % 4, x.values)
              for x, order in orders]
    return _matrix(blocks, [k * r for k in range(6)], (6 * r, 12 * n))


def _matrix(blocks: list[_Entries], starts: list[int], shape: tuple[int, int]) -> Any:
    """Return the matrix with blocks from some rows on; a sparse one where it is large."""
    rows = np.concatenate([x.rows + start for x, start in zip(blocks, starts, strict=True)])
    columns, values = (np.concatenate(x) for x in (
        [x.columns for x in blocks], [x.values for x in blocks]))
    if shape[0] * shape[1] <= DENSE_LIMIT:
        dense = np.zeros(shape)
        dense[rows, columns] = values
        return dense
    from scipy.sparse import csr_array  # imported on use: it takes a tenth of a second

    found = csr_array((values, (rows, columns)), shape=shape)
    found.sort_indices()
    return found


def _sum_of_rates(n: int) -> Any:
    """Return the matrix that takes n values each of A''.B, A'.B', A.B'' to their Leibniz sum."""
    if 3 * n * n <= DENSE_LIMIT:
        return np.hstack([np.eye(n), 2.0 * np.eye(n), np.eye(n)])
    from scipy.sparse import csr_array

    at = np.arange(n)
    weights = np.repeat([1.0, 2.0, 1.0], n)
    return csr_array((weights, (np.tile(at, 3), np.arange(3 * n))), shape=(n, 3 * n))


def _product(matrix: Any, vectors: Array, out: Array) -> None:
    """Write matrix @ vectors into `out`; `np.dot` costs half of `@` here."""
    if isinstance(matrix, np.ndarray):
        np.dot(matrix, vectors, out)
    else:
        out[:] = matrix @ vectors


def constraints_of(mechanism: Mechanism) -> Constraints:
    """Return the compiled constraints of a mechanism, made once."""
    needed(mechanism)
    if "constraints" not in mechanism.memo:
        mechanism.memo["constraints"] = Constraints(mechanism)
    found: Constraints = mechanism.memo["constraints"]
    return found


class evaluation_of(acquired["Evaluation"]):  # with evaluation_of(...) as evaluation
    """Acquire an `Evaluation` of a mechanism, its screws counting turns from some angles.

    Args:
        mechanism: the mechanism.
        angles: (n_angles,) of its screws [rad].
    """

    def __init__(self, mechanism: Mechanism, angles: Array | float = 0.0) -> None:
        super().__init__(mechanism, "evaluation", lambda: Evaluation(constraints_of(mechanism)))
        self._angles = angles

    def __enter__(self) -> Evaluation:
        """Return the evaluation."""
        found = super().__enter__()
        found.turns[:] = self._angles
        return found


# columns: v, omega of a twist; rows of 16: the transposed 4 x 4 matrix, row by row
TWIST_MATRIX = np.zeros((6, 16))
for _i in range(3):
    TWIST_MATRIX[_i, 12 + _i] = 1.0
    TWIST_MATRIX[3 + _i].reshape(4, 4)[:3, :3] = pin.skew(np.eye(3)[_i]).T
# a @ _CYCLES = (a, a_yzx, a_zxy, a_yzx): a cross product from one multiplication and one difference
_CYCLES = np.hstack([np.eye(3)[:, c] for c in ([0, 1, 2], [1, 2, 0], [2, 0, 1], [1, 2, 0])])


def composed_rates(
    c: Constraints, products: Sequence[Array], coordinates: Sequence[Array]
) -> Array:
    """Return (n_rows, ...) the last of the products' derivatives, of the closure equations.

    Args:
        c: the equations.
        products: (N, ...) derivatives 0, 1, ... of all products.
        coordinates: q, v and further derivatives (nv, ...); zero where there are no more.
    """
    order = len(products) - 1
    out = np.zeros((c.n_rows, *products[0].shape[1:]))
    out[: c.n_products] = products[order][: c.n_products]
    for group in c.composed:
        value, _ = group.values(group.inputs(products, coordinates))
        out[group.rows] = value.derivative(order)
    return out


def composed_rows(group: Composed, slopes: Array, products: Array, scale: Array) -> Array:
    """Return (m, nv, ...) derivatives of composed equations, in scaled velocities.

    Args:
        group: the equations.
        slopes: (m, n, ...) derivatives with respect to their products and coordinates.
        products: (N, nv, ...) derivatives of all products.
        scale: (nv,) of the velocities.
    """
    m, p = len(group.rows), len(group.products)
    slopes = np.broadcast_to(slopes, (m, *slopes.shape[1:]))
    out = np.zeros((m, *products.shape[1:]))
    for k, at in enumerate(group.products):
        out += slopes[:, k, None] * products[at]
    for k, v in enumerate(group.coordinates[1], start=p):
        own = slopes[:, k]
        out[np.arange(m), v] += own * scale[v].reshape(-1, *[1] * (own.ndim - 1))
    return out


def combined_wrenches(
    c: Constraints, products: Sequence[Array], wrenches: Sequence[Array]
) -> list[Array]:
    """Return the wrenches of the equations; after them those that act on other bodies.

    Args:
        c: the equations.
        products: (N, 1, ...) of the products, and a derivative of theirs if wanted.
        wrenches: (N, 6, ...) of the products, or what else is linear in their derivatives; and
            the same derivative of that.

    Returns:
        As many as `wrenches`, (n_wrenches, 6, ...).
    """
    out = [np.zeros((c.n_wrenches, *w.shape[1:])) for w in wrenches]
    for total, w in zip(out, wrenches, strict=True):
        total[c.plain] = w[c.plain]
    extra = {row: k for k, (row, _) in enumerate(c.elsewhere, start=c.n_rows)}
    for group in c.composed:
        for k, (at, slope) in enumerate(zip(group.products, group.slopes(products), strict=True)):
            to = [extra[row] for row in group.rows] if k in group.kind.elsewhere else group.rows
            term = slope * Taylor.of([w[at] for w in wrenches])
            for total, w in zip(out, term.values, strict=True):
                total[to] += w
    return out


class Evaluation:
    """Closure value, Jacobian and bias at one configuration at a time.

    A small tree's `pin.Data` is read through views made once.

    Attributes:
        q: (nq,) the last configuration; not to be changed before what is made of it.
        residual: (n_rows,) closure rows [-]; lengths divided by the characteristic length.
        jacobian: (n_rows + n_passive, nv) derivative of the rows with respect to the scaled
            velocities v / `velocity_scale`; the last ones are spin rates.
        angles: (n_angles,) relative angle of every screw closure [rad], counting turns from the
            one in `turns`.
        turns: (n_angles,) the angles to which `angles` stays nearest.
        angle_jacobian: (n_angles, nv) derivative of `angles`, like `jacobian`.
        wrenches: (rows, 6) force and moment about the world origin of each product row.
        placements: (njoints, 4, 3) view on the joint placements.
        regular: the last configuration that was found to be regular, see `newton.rank_loss`.
    """

    def __init__(self, constraints: Constraints) -> None:
        self.regular: Any = None
        self.constraints = c = constraints
        self.mechanism = c.mechanism
        self.model = model = c.mechanism.model
        self._tree = tree_of(model)
        self.data = self._tree.data
        n, nv, r = model.njoints, model.nv, len(c.constants)
        self._n_all = r
        self.angles = np.zeros(c.n_angles)
        self.turns = np.zeros(c.n_angles)
        self.angle_jacobian = np.zeros((c.n_angles, nv))
        self._zero = np.zeros(nv)
        self.q = c.mechanism.neutral
        self.placements = self._tree.placements
        self._g = self.placements.reshape(4 * n, 3)
        self._twists, self._accelerations = self._tree.twists, self._tree.accelerations
        self._spins = self._accelerations.reshape(-1)
        self._joint_jacobian = self._tree.columns
        self._make_buffers(n, nv, r)
        self._plain = not c.composed
        self._offset = bool(np.any(c.constants))
        self.residual = self._values[: c.n_rows] if self._plain else np.zeros(c.n_rows)
        self.jacobian = np.zeros((c.n_rows + c.n_passive, nv))

    def _make_buffers(self, n: int, nv: int, r: int) -> None:
        """Allocate once what every evaluation writes, with the views it is read through."""
        self._abx, self._cycled = np.empty((3 * r, 3)), np.empty((3 * r, 12))
        blocks = self._cycled[:r], self._cycled[r : 2 * r], self._cycled[2 * r :]
        self._a, self._b = blocks[0][:, :3], blocks[1][:, :3]
        self._b_cycles, self._x_cycles = blocks[1][:, 6:12], blocks[2][:, 3:9]
        self._values = np.zeros(r)
        self.wrenches = np.zeros((r, 6))
        self._forces, self._moments = self.wrenches[:, :3], self.wrenches[:, 3:]
        spin = slice(self.constraints.passive_at, r)
        self._spin_moments, self._spin_axes = self._moments[spin], self._b[spin]
        self._halves = np.empty((r, 6))
        self._first, self._second = self._halves[:, :3], self._halves[:, 3:]
        self._products = np.zeros((r, nv))
        self._rates_h = np.zeros((n, 4, 8))  # transposed matrices of twist and acceleration
        self._h1, self._h2 = self._rates_h[:, :, :4], self._rates_h[:, :, 4:]
        self._g_rates = np.zeros((n, 12, 3))  # G'', G', G of each joint
        self._g2, self._g1, self._g0 = (self._g_rates[:, k : k + 4] for k in (0, 4, 8))
        self._g10 = self._g_rates[:, 4:]
        self._g_flat = self._g_rates.reshape(12 * n, 3)
        self._ab_rates = np.zeros((6 * r, 3))
        self._a_rates, self._b_rates = self._ab_rates[: 3 * r], self._ab_rates[3 * r :]
        self._rate_products = np.zeros(3 * r)
        self._bias = np.zeros(r)

    def update(self, q: Array) -> None:
        """Evaluate `residual` and `jacobian` at the configuration q (nq,)."""
        self.update_wrenches(q)
        if self._n_all:
            products = np.dot(self.wrenches, self._joint_jacobian, self._products)
            if self._plain:
                np.multiply(products, self.constraints.signs, out=self.jacobian)
                return
        self._finish_rows(q)

    def update_wrenches(self, q: Array) -> None:
        """Evaluate placements, joint Jacobian, values and wrenches of the rows at q (nq,) only."""
        c, self.q = self.constraints, q
        self._tree.place(q)
        if self._n_all:
            _product(c.c_abx, self._g, self._abx)
            np.dot(self._abx, _CYCLES, self._cycled)
            values = np.vecdot(self._a, self._b, out=self._values)
            if self._offset:
                values -= c.constants
            np.multiply(self._b, c.factors, out=self._forces)
            np.multiply(self._x_cycles, self._b_cycles, out=self._halves)
            np.subtract(self._first, self._second, out=self._moments)
            if c.n_passive:
                self._spin_moments[:] = self._spin_axes

    def row_wrenches(self) -> Array:
        """Return (n_wrenches, 6) force on body 2 per unit of each row, and moment about the origin.

        World axes, at the last `update`; a row's derivative is its wrench times the twist of
        body 2 relative to body 1. Couplings, which act on joints, have none. After the rows come
        those of `Constraints.elsewhere`: they act on two bodies of their own.
        """
        (found,) = combined_wrenches(self.constraints, [self._values[:, None]], [self.wrenches])
        return found

    def frame(self, frame: int) -> pin.SE3:
        """Return where a frame of the model is, at the last `update`."""
        at = self.model.frames[frame]
        return self.data.oMi[at.parentJoint] * at.placement

    def body_jacobian(self, joint: int) -> Array:
        """Return the world Jacobian (6, nv) of the body of a joint, at the last `update`."""
        return self._joint_jacobian * self.constraints.support(joint)

    def frame_jacobian(self, frame: int) -> Array:
        """Return the Jacobian (6, nv) of a frame at its origin, world axes, likewise."""
        found = self.body_jacobian(self.model.frames[frame].parentJoint)
        found[:3] -= pin.skew(self.frame(frame).translation) @ found[3:]
        return found

    def twist_derivatives(self, joint: int) -> Array:
        """Return (n_rows, 6) derivatives of the rows for a twist of what a joint carries."""
        c, at = self.constraints, self.model.idx_vs[joint]
        signs = c.signs[:, at, None] / self.mechanism.velocity_scale[at]
        (moved,) = combined_wrenches(c, [self._values[:, None]], [signs * self.wrenches])
        for k, (row, _) in enumerate(c.elsewhere, start=c.n_rows):
            moved[row] += moved[k]
        return moved[: c.n_rows]

    def _finish_rows(self, q: Array) -> None:
        """Put the rows in their places, those of composed equations from what they are made of."""
        c, p = self.constraints, self.constraints.n_products
        products = self._products
        products *= c.signs
        self.jacobian[:p] = products[:p]
        self.residual[:p] = self._values[:p]
        for group in c.composed:
            inputs = group.seeded([self._values[:, None]], [q[:, None]])
            value, angle = group.values(inputs, self.turns)
            size = self.mechanism.velocity_scale
            self.residual[group.rows] = value.values[0][:, 0]
            self.jacobian[group.rows] = composed_rows(group, value.changes[0], products, size)
            if angle is not None:
                self.angles[group.angles] = angle.values[0][:, 0]
                self.angle_jacobian[group.angles] = composed_rows(
                    group, angle.changes[0], products, size)
        self.jacobian[c.n_rows :] = products[c.passive_at :]

    def bias(self, q: Array, v: Array) -> Array:
        """Return (n_rows + n_passive,) second derivatives of the rows at zero joint acceleration.

        Call after `update` at the same q.
        """
        c = self.constraints
        self._tree.move(q, v, self._zero)
        if not self._n_all:
            return np.zeros(c.n_rows)
        shape = self._h1.shape
        self._h1[:] = np.dot(self._twists, TWIST_MATRIX).reshape(shape)
        self._h2[:] = np.dot(self._accelerations, TWIST_MATRIX).reshape(shape)
        self._g0[:] = self.placements
        np.matmul(self._h1, self.placements, out=self._g1)
        np.matmul(self._rates_h, self._g10, out=self._g2)  # G'' = H^T G' + H'^T G
        _product(c.c_rates, self._g_flat, self._ab_rates)
        np.vecdot(self._a_rates, self._b_rates, out=self._rate_products)
        bias = self._bias
        _product(c.rate_sum, self._rate_products, bias)
        if c.n_passive:
            bias[c.passive_at :] = np.dot(c.spin_bias, self._spins)
        return bias if self._plain else self._finish_bias(q, v, bias)

    def move(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Move the bodies as q (nq,), v and a (nv,) say; return views as `rates`."""
        self._tree.move(q, v, a)
        return self.rates()

    def rates(self) -> tuple[Array, Array]:
        """Return views (njoints, 6) on the twists and spatial accelerations, joint axes."""
        return self._twists, self._accelerations

    def _finish_bias(self, q: Array, v: Array, bias: Array) -> Array:
        c, r = self.constraints, self._n_all
        a1, b1 = self._a_rates[r : 2 * r], self._b_rates[r : 2 * r]
        first = np.vecdot(a1, self._b) + np.vecdot(self._a, b1)
        rows = composed_rates(c, [self._values, first, bias], [q, v])
        return np.concatenate([rows, bias[c.passive_at :]])

    @property
    def closure_error(self) -> float:
        """Largest absolute closure row at the last configuration [-]."""
        return float(np.abs(self.residual).max()) if self.residual.size else 0.0

    def worst_closure(self) -> str:
        """Return the name of the closure with the largest row; empty when there is none."""
        if not self.residual.size:
            return ""
        return self.constraints.labels[int(np.argmax(np.abs(self.residual)))].closure

    def mirrored(self) -> str:
        """Return the name of a closure whose axes do not point the same way, else nothing."""
        return next(iter(self.opposite_axes()), "")

    def opposite_axes(self) -> dict[str, bool]:
        """Return closures whose axes do not point the same way, and whether half a turn helps.

        Closed rows leave them parallel, opposite, or (three rotation rows) interchanged: then half
        a turn of one of the frames is not what makes them one.
        """
        found = {}
        for closure in self.mechanism.closures:
            if closure.type == COUPLING or not closure.pair.aligned:
                continue
            one, two = self.constraints._frames(closure.frames)
            oM = self.data.oMi
            geometry = closure.geometry
            assert geometry is not None
            axes1 = oM[one.joint].rotation @ one.placement.rotation @ geometry.axes1
            axes2 = oM[two.joint].rotation @ two.placement.rotation @ geometry.axes2
            cosines = np.vecdot(axes1.T, axes2.T)[2 if closure.pair.aligned == "z" else 0 :]
            if np.any(cosines < 0.5):
                found[closure.name] = bool(np.all(np.abs(cosines) > 0.5))
        return found
