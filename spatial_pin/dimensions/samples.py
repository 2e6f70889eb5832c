"""Many mechanisms that differ in their dimensions, closed together near one configuration.

`dimension_path` from that configuration is the specification: damped least motion, then Newton.
Here all samples take the same steps over flat arrays (`constraints.stacked`), each with its own
geometry (`dimensions.geometry`). A sample that does not go straight to its closed configuration is
taken there by sets of dimensions between; one that comes to a singular configuration is left to
`dimension_path`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.assemble import periodic
from spatial_pin.assembly.newton import SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of
from spatial_pin.constraints.sample_coefficients import times
from spatial_pin.constraints.stacked import Batch, Placed
from spatial_pin.dimensions.geometry import Geometry, is_length
from spatial_pin.numerics.linalg import Array, StackedLU, decompose, independent_rows
from spatial_pin.rates.rates import driven_coordinates
from spatial_pin.settings import Accuracy

DAMPING = 1e-2  # as `newton.close` begins with, and takes a tenth of after every step
LEAST_DAMPING = 1e-9  # where rows are redundant
STEPS = 12
LONGEST = 0.25  # rad, characteristic lengths, that a joint may move from one set of dimensions
WAY = 1.0  # the same of all joints together, which leaves axes pointing the same way
CONTRACTION = 0.2  # a step may be this fraction of the one before
CLOSED = 1e-13  # closure residual of a closed sample
SINGULAR = 0.02  # part of the nominal determinant below which a sample is left to others
REGULAR = 1e-4  # smallest over largest singular value of a nominal configuration fit for this
OPENED = 1e-7  # part of the joint rates by which left-out rows may open, as in `rates`


class Moving(NamedTuple):
    """Closed samples and their rates.

    Attributes:
        batch: their closure equations.
        placed: bodies and rows.
        v, a: (nv, m) joint velocities and accelerations.
        first, second: rates of `FlatTree.rates` at them, at zero joint acceleration.
    """

    batch: Batch
    placed: Placed
    v: Array
    a: Array
    first: Array | None
    second: Array | None


class Metric(NamedTuple):
    """What makes rows and joint motions comparable in samples of several sizes.

    Attributes:
        rows: (n_rows, m or 1) factors for closure rows.
        columns: (nv, m or 1) for scaled joint velocities.
    """

    rows: Array
    columns: Array


class Solver:
    """Closes samples near a closed state, drivers held, and gives them the drivers' rates.

    Args:
        state: the nominal state.
        speeds, accelerations: of the drivers; samples stand still if all are zero.

    Raises:
        SingularError: the drivers do not determine the rates at the state.
    """

    def __init__(
        self, state: State, speeds: Mapping[str, float], accelerations: Mapping[str, float]
    ) -> None:
        self.mechanism = mechanism = state.mechanism
        self.state = state
        evaluation = Evaluation(constraints_of(mechanism))
        evaluation.turns[:] = state.angles
        evaluation.update(state.q)
        self.batch = Batch(evaluation.constraints)
        self.tolerance = Accuracy.named("engineering").tolerance
        self.n = evaluation.constraints.n_rows
        driven = [mechanism.driven_coordinate(name) for name in mechanism.drivers]
        self.free = np.ones(mechanism.model.nv, dtype=bool)
        self.free[[c.v for c in driven]] = False
        jacobian = evaluation.jacobian[: self.n, self.free]
        self.rows = independent_rows(jacobian)
        self.spare = decompose(jacobian[self.rows]).null_space
        self._square = _determinant(np.vstack([jacobian[self.rows], self.spare]))
        self._lengths = is_length(evaluation.constraints)
        self._is_slide = np.array(
            [c.unit == "m" for c in mechanism.coordinate_table.values()], dtype=bool)
        singular = decompose(jacobian[self.rows]).s
        self.is_regular = not singular.size or singular[-1] > REGULAR * singular[0]
        self.moves = any(speeds.values()) or any(accelerations.values())
        if self.moves:
            self._set_rates(evaluation, speeds, accelerations)

    def _set_rates(
        self, evaluation: Evaluation, speeds: Mapping[str, float],
        accelerations: Mapping[str, float],
    ) -> None:
        mechanism = self.mechanism
        self._system = SquareSystem(
            evaluation, driven_coordinates(mechanism, [*speeds, *accelerations]), self.state.q)
        self.is_regular = self.is_regular and self._system.pivots()[1] > REGULAR
        self._whole = _determinant(self._system.matrix)
        self._v, self._a = (
            np.array([rates.get(c.name, 0.0) for c in self._system.driven]) for rates in (
                {mechanism.driven_coordinate(k).name: x for k, x in given.items()}
                for given in (speeds, accelerations)))

    def solve(
        self, geometry: Geometry, m: int, near: Placed | None = None
    ) -> tuple[Moving, NDArray[np.bool_]]:
        """Close m samples, from the state or from where they were at dimensions on the way.

        Returns:
            The samples, and which of them (m,) are good.
        """
        batch = self.batch.of_other_dimensions(
            geometry.joints, geometry.coefficients, times(geometry.constants, np.ones((1, m))))
        metric = self._metric(geometry, m)
        with np.errstate(all="ignore"):  # of samples that go astray
            placed, good = self._closed(batch, metric, m, near)
            good &= self._in_place(placed.q, geometry)
            if not self.moves:
                rest = np.zeros((self.batch.tree.nv, m))
                return Moving(batch, placed, rest, rest, None, None), good
            moving, regular = self._moving(batch, metric, placed)
        return moving, good & regular

    def _metric(self, geometry: Geometry, m: int) -> Metric:
        """Return the factors that take the nominal characteristic length to each sample's own."""
        ratio = np.ones(1)
        if len(self.spare) or (self.moves and len(self._system.passive)):
            points = times(geometry.points, np.eye(3)[:, :, None] * np.ones(m))
            span = np.max([np.square(points - p).sum(axis=1).max(axis=0) for p in points], axis=0)
            ratio = np.sqrt(span) / self.mechanism.characteristic_length
        one = np.ones_like(ratio)
        rows = np.where(self._lengths[:, None], one / ratio, one)
        return Metric(rows, np.where(self._is_slide[:, None], ratio, one))

    # ------------------------------------------------------------ closing

    def _closed(
        self, batch: Batch, metric: Metric, m: int, begin: Placed | None
    ) -> tuple[Placed, NDArray[np.bool_]]:
        start = np.repeat(self.state.q[:, None], m, axis=1) if begin is None else begin.q
        near = np.repeat(self.state.angles[:, None], m, axis=1) if begin is None else begin.angles
        p = batch.place(start, near)
        good, last, damping = np.ones(m, dtype=bool), np.full(m, np.inf), DAMPING
        farthest, way = np.zeros(m), np.zeros(m)
        for _ in range(STEPS):
            error = np.linalg.norm(p.residual * metric.rows, axis=0)
            is_open = error > self.tolerance
            if not np.any(is_open & good):
                break
            x = self._step(batch, p, metric, damping * error) * is_open
            size = np.linalg.norm(x, axis=0)
            good &= (size <= CONTRACTION * last) | ~is_open
            last = np.where(is_open, size, last)
            farthest, way = (far + x for far, x in zip(
                (farthest, way), (np.abs(x).max(axis=0, initial=0.0), np.abs(x).sum(axis=0)),
                strict=True))
            p = batch.place(self._moved(batch, p.q, x * metric.columns[self.free]), near)
            damping = max(0.1 * damping, 1e-12)
        lu = self._regular(batch, p, metric)
        x = lu.solve(self._right(-(p.residual * metric.rows)[self.rows], m))
        p = batch.place(self._moved(batch, p.q, x * metric.columns[self.free]), near)
        good &= np.abs(p.residual * metric.rows).max(axis=0, initial=0.0) <= CLOSED
        return p, good & _is_alike(lu, *self._square) & (farthest <= LONGEST) & (way <= WAY)

    def _jacobian(self, batch: Batch, p: Placed, metric: Metric) -> Array:
        """Return (n_rows, free, m)."""
        jacobian = batch.jacobian(p)[: self.n, self.free]
        return jacobian * metric.rows[:, None] * metric.columns[self.free]

    def _step(self, batch: Batch, p: Placed, metric: Metric, damping: Array) -> Array:
        """Return scaled joint displacements (free, m): Newton's, or of damped least motion."""
        jacobian, residual = self._jacobian(batch, p, metric), p.residual * metric.rows
        if not len(self.spare):
            return StackedLU(jacobian[self.rows]).solve(-residual[self.rows])
        if len(self.rows) < self.n:
            damping = np.maximum(damping, LEAST_DAMPING)
        one_by_one = jacobian.transpose(2, 0, 1)
        square = (one_by_one @ one_by_one.transpose(0, 2, 1)).transpose(1, 2, 0).copy()
        at = np.arange(self.n)
        square[at, at] += damping
        return -np.einsum("nkm,nm->km", jacobian, StackedLU(square).solve(residual))

    def _regular(self, batch: Batch, p: Placed, metric: Metric) -> StackedLU:
        """Return the factored independent rows with the nominal spare freedoms below."""
        jacobian = self._jacobian(batch, p, metric)[self.rows]
        spare = np.repeat(self.spare[:, :, None], jacobian.shape[2], axis=2)
        return StackedLU(np.concatenate([jacobian, spare]))

    def _right(self, values: Array, m: int) -> Array:
        return np.concatenate([values, np.zeros((len(self.spare), m))])

    def _moved(self, batch: Batch, q: Array, x: Array) -> Array:
        step = np.zeros((batch.tree.nv, q.shape[1]))
        step[self.free] = x * self.mechanism.velocity_scale[self.free, None]
        return batch.tree.displace(q, step)

    def _in_place(self, q: Array, geometry: Geometry) -> NDArray[np.bool_]:
        """Whether `assembly.nearest_turn` would leave the angles as they are."""
        turn, at = 2.0 * np.pi, [c.q for c in periodic(self.mechanism)]
        lower, upper = times(geometry.limits, np.ones((1, q.shape[1])))
        q = q[at]
        leaves = ((q > upper) & (q - turn >= lower)) | ((q < lower) & (q + turn <= upper))
        return ~leaves.any(axis=0)

    # ------------------------------------------------------------ rates

    def _moving(
        self, batch: Batch, metric: Metric, p: Placed
    ) -> tuple[Moving, NDArray[np.bool_]]:
        system, n, m = self._system, self.n, p.q.shape[1]
        scale = self.mechanism.velocity_scale[:, None] * metric.columns
        jacobian = batch.jacobian(p) * metric.columns
        below = np.repeat(system.matrix[system.driver_rows.start :, :, None], m, axis=2)
        lu = StackedLU(np.concatenate([jacobian[system.rows], jacobian[n:], below]))
        good = _is_alike(lu, *self._whole)
        right = np.zeros((len(scale), m))
        right[system.driver_rows] = self._v[:, None] / scale[system.drive_at]
        x = self._least(lu, lu.solve(right))
        opening = np.abs(np.einsum("nvm,vm->nm", jacobian[:n], x)).max(axis=0, initial=0.0)
        good &= opening <= OPENED * np.abs(x).max(axis=0, initial=0.0)
        bias, first, second = batch.bias(p, scale * x)
        right[system.closure_rows] = -bias[system.rows]
        right[system.spin_rows] = -bias[n:]
        right[system.driver_rows] = self._a[:, None] / scale[system.drive_at]
        a = scale * self._least(lu, lu.solve(right))
        return Moving(batch, p, scale * x, a, first, second), good

    def _least(self, lu: StackedLU, x: Array) -> Array:
        """Return the rates x (nv, m) without any of the freedoms that nothing prescribes."""
        k = len(self._system.passive)
        if not k:
            return x
        right = np.zeros((k, *x.shape))
        right[np.arange(k), np.arange(-k, 0)] = 1.0
        spare = np.array([lu.solve(r) for r in right])
        gram = np.einsum("ivm,jvm->mij", spare, spare)
        part = np.linalg.solve(gram, np.einsum("ivm,vm->mi", spare, x)[:, :, None])
        return x - np.einsum("ivm,mi->vm", spare, part[:, :, 0])


def _determinant(matrix: Array) -> tuple[float, float]:
    lu = StackedLU(matrix[:, :, None].copy())
    return float(lu.sign[0]), float(lu.magnitude[0])


def _is_alike(lu: StackedLU, sign: float, magnitude: float) -> NDArray[np.bool_]:
    """Whether determinants have the sign and about the size of the nominal one."""
    alike: NDArray[np.bool_] = (lu.sign == sign) & (lu.magnitude > magnitude + np.log(SINGULAR))
    return alike
