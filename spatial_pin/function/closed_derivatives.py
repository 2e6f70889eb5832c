"""Derivatives of a closed state by drivers' motions, dimensions and efforts [implicit functions].

The closure equations c(q) = 0, c' = 0, c'' = 0 and the drivers' rows are differentiated. All
derivatives solve the same linear system; those of rates have the rows of idle rotations too:

    A dq = -dc,  A dv = -dc' (by q),  A da = -dc'' (by q and v)

Forces follow from the derivative of M a + b - f = J^T lambda + B tau. In forward dynamics its
projection on the freedoms of the loops gives accelerations; in inverse dynamics it gives efforts.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import scaled_row
from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dimensions.sensitivity import SLOPE
from spatial_pin.dynamics.derivatives.derivatives import changes_of_forces
from spatial_pin.dynamics.derivatives.row_derivatives import RowDerivatives
from spatial_pin.dynamics.derivatives.spring_derivatives import ExternalWrenches, Springs
from spatial_pin.dynamics.forces import Forces
from spatial_pin.dynamics.solvers.equations_of_motion import equations_of
from spatial_pin.errors import SpatialPinError
from spatial_pin.function.moved_geometry import MovedGeometry
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array, Decomposition, decompose, full_decomposition
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.jacobians import closure_jacobian


class InputChanges(NamedTuple):
    """Derivatives of the given quantities by the inputs, one column (..., m) for each input.

    Attributes:
        values, rates, accelerations: (drivers, m) of the prescribed coordinates.
        efforts: (nv, m) at joints.
        dimensions: (n, m) of the dimensions [m, rad, ...].
    """

    values: Array
    rates: Array
    accelerations: Array
    efforts: Array
    dimensions: Array


class Changes(NamedTuple):
    """Derivatives of q, v and a (nv, m) by the inputs, for the mechanism with added joints."""

    q: Array
    v: Array
    a: Array


class ClosedDerivatives:
    """Derivatives of a closed state of a mechanism.

    Args:
        geometry: the mechanism with the joints that dimensions move.
        state: the state, with rates.
        driven: the prescribed coordinates.
        still: velocity entries that do not move.

    Attributes:
        rows: the closure equations and their derivatives at the motion.
        mechanism: the mechanism with added joints.
    """

    def __init__(
        self, geometry: MovedGeometry, state: State, driven: Sequence[Coordinate],
        still: Sequence[int],
    ) -> None:
        self.geometry, self.state, self.mechanism = geometry, state, geometry.mechanism
        self._driven, self._still = list(driven), list(still)
        self.rows = RowDerivatives(
            self.mechanism, Forces(self.mechanism), geometry.motion(state, state.a), state.angles)
        self.bodies = self.rows.bodies
        self.scale = state.mechanism.velocity_scale
        self.by = [self.rows.changes(k) for k in range(3)]

    @cached_property
    def _positions(self) -> Decomposition:
        """The closure equations, drivers and fixed entries, by scaled velocities."""
        return full_decomposition(self._matrix(self.by[0][0][:, self.geometry.v] * self.scale))

    def _matrix(self, closed: Array) -> Array:
        m, q = self.state.mechanism, self.state.q
        drivers = [scaled_row(m, c, q) for c in self._driven]
        return np.vstack([closed, *drivers, np.eye(len(self.scale))[self._still]])

    @cached_property
    def _idle(self) -> tuple[Array, Array, Array, Array, Array]:
        """Rows (k, nv) of idle rotations by velocity, and derivatives (k, ...) of their rates.

        Those of the rate by q, then of the acceleration by q and by v. Last, the local angular
        velocities and accelerations (2, k, 3) of the bodies with the axes.
        """
        axes = constraints_of(self.state.mechanism).idle_axes
        joints = self.geometry.joint[[joint for joint, _ in axes]]
        along = np.array([axis for _, axis in axes])[:, None]
        first, second, paced, columns = (
            (along @ x[:, 3:])[:, 0] for x in self.bodies.by_motion(joints))
        carriers = self.bodies.joints[joints]
        back = self.bodies.to_bodies(carriers)
        spins = np.stack([(back @ x[carriers][..., None])[:, 3:, 0]
                          for x in (self.bodies.v, self.bodies.a)])
        return columns, first, second, paced, spins

    @cached_property
    def _rates(self) -> Decomposition:
        """The same with the rows of idle rotations between closure equations and drivers."""
        if not constraints_of(self.state.mechanism).idle_axes:
            return self._positions
        closed = np.vstack([self.by[0][0], self._idle[0]])[:, self.geometry.v]
        return full_decomposition(self._matrix(closed * self.scale))

    @cached_property
    def _written(self) -> Array:
        """(3, n_closure, n) derivatives of the equations and their rates by written dimensions.

        These are numbers of closures: lengths, axes, ratios, curves; not joints and frames.
        """
        out = np.zeros((3, len(self.by[0][0]), self.geometry.moves.shape[1]))
        moves, at = self.geometry.moves, self.state
        for k, (step, around) in self.geometry.written.items():
            values = []
            for mechanism in around:
                with loops_of(mechanism, at.angles) as loops:
                    bias = loops.bias(at.q, at.v)
                    loops.update(at.q)
                    rows, n = loops.jacobian / mechanism.velocity_scale, out.shape[1]
                    values.append([loops.residual.copy(), rows[:n] @ at.v,
                                   (rows @ at.a + bias)[:n]])
            out[:, :, k] = np.tensordot(SLOPE / step, np.array(values), 1) - np.array(
                [by_q @ moves[:, k] for by_q, _ in self.by])
        return out

    def changes(self, given: InputChanges) -> Changes:
        """Return the derivatives by the inputs; columns for undetermined freedoms follow.

        Raises:
            SpatialPinError: a dimension alone opens a loop.
        """
        spare, loose = self._positions.null_space, self._rates.null_space
        n, m, own = len(spare), given.values.shape[1], self.geometry.v
        q, v, a = np.zeros((3, self.bodies.model.nv, m + n + len(loose)))
        q[:, :m] = self.geometry.moves @ given.dimensions
        written = self._written @ given.dimensions
        q[own] = self._solved(self._positions, [(self.by[0][0], q)], given.values, written[0])
        q[own, m : m + n] = (spare * self.scale).T
        idle = self._idle_changes(given, q, v, 0)
        v[own] = self._solved(self._rates, [(self.by[1][0], q)], given.rates, written[1], idle)
        v[own, m + n :] = (loose * self.scale).T
        idle = self._idle_changes(given, q, v, 1)
        a[own] = self._solved(self._rates, [(self.by[2][0], q), (self.by[2][1], v)],
                              given.accelerations, written[2], idle)
        return Changes(q, v, a)

    def _idle_changes(self, given: InputChanges, q: Array, v: Array, order: int) -> Array:
        """Return changes (k, m) of idle rotations' rates, or of their accelerations."""
        if not constraints_of(self.state.mechanism).idle_axes:
            return np.zeros((0, q.shape[1]))
        _, first, second, paced, spins = self._idle
        total: Array = first @ q if order == 0 else second @ q + paced @ v
        turned = np.einsum("nki,ki->kn", self.geometry.axes, spins[order]) @ given.dimensions
        total[:, : turned.shape[1]] += turned
        return total

    def _solved(
        self, system: Decomposition, moved: Sequence[tuple[Array, Array]], driven: Array,
        written: Array, idle: Array | None = None,
    ) -> Array:
        """Return joint changes (nv, m) that keep the loops closed.

        Args:
            system: the equations.
            moved: derivatives of the closure equations, and changes (nv, m) of what these are by.
            driven: (drivers, m) changes of the drivers.
            written: (n_closure, m) changes of the closure equations besides.
            idle: (k, m) of idle rotations that they cancel.

        Raises:
            OpenedError: they cannot.
        """
        opened = np.sum([by @ x for by, x in moved], axis=0)
        opened[:, : written.shape[1]] += written
        opened = opened if idle is None else np.vstack([opened, idle])
        sizes = np.array([self.scale[c.v] for c in self._driven]).reshape(-1, 1)
        wanted, at = np.zeros((len(system.u), opened.shape[1])), len(opened)
        wanted[:at] = -opened
        wanted[at : at + len(driven), : driven.shape[1]] = driven / sizes
        size = np.abs(wanted).max(axis=0, initial=TOLERANCES.zero)
        for by, x in moved:  # of terms that cancel each other, round-off is left
            size = np.maximum(size, np.abs(by).max(initial=0.0) * np.abs(x).max(axis=0))
        rest = np.abs(system.left_null_space @ wanted).max(axis=0, initial=0.0) / size
        if (rest > TOLERANCES.half_precision).any():
            raise OpenedError(int(np.argmax(rest)))
        return self.scale[:, None] * system.minimum_norm(wanted)

    # ------------------------------------------------------------ forces

    def forced(
        self, given: InputChanges, changes: Changes, a: Array, multipliers: Array, prescribed: bool
    ) -> tuple[Array, Array]:
        """Return the changes of accelerations (nv, m) and of the drivers' efforts (drivers, m).

        Args:
            given: the inputs.
            changes: with them.
            a: (nv,) accelerations that forces give.
            multipliers: (n_closure,) of the closure equations.
            prescribed: whether the drivers' accelerations are given, else their efforts.
        """
        geometry, own, nv = self.geometry, self.geometry.v, len(self.scale)
        springs, motion = Springs(Forces(self.mechanism)), geometry.motion(self.state, a)
        rows = self.rows if np.array_equal(a, self.state.a) else RowDerivatives(
            self.mechanism, springs.forces, motion, self.state.angles)
        springs.move(rows)
        springs.refuse_undirected()
        by_q, by_v = changes_of_forces(
            rows, springs, ExternalWrenches(self.mechanism, None), multipliers)
        load = (by_q @ changes.q + by_v @ changes.v)[own]
        m = self.state.mechanism
        n = given.efforts.shape[1]
        load[:, :n] -= given.efforts
        load[:, :n] += self._dimension_forces(a, multipliers, by_q) @ given.dimensions
        by_q2, by_v2 = rows.changes(2)
        opened = by_q2 @ changes.q + by_v2 @ changes.v
        opened[:, :n] += self._written[2] @ given.dimensions
        system = self._positions if prescribed else decompose(
            self.by[0][0][:, own] * self.scale)
        total = np.zeros((len(system.u), load.shape[1]))
        total[: len(opened)] = -opened
        sizes = np.array([self.scale[c.v] for c in self._driven]).reshape(-1, 1)
        drivers = slice(len(opened), len(opened) + len(self._driven))
        if prescribed:
            total[drivers, :n] = given.accelerations / sizes
        with equations_of(m) as equations:
            equations.move_to(self.state)
            mass = equations.mass() * self.scale * self.scale[:, None]
        load *= self.scale[:, None]
        da = system.minimum_norm(total)
        free = system.null_space
        if len(free):
            inertia = free @ mass @ free.T
            da += free.T @ decompose(inertia).minimum_norm(-free @ (load + mass @ da))
        accelerations = self.scale[:, None] * da
        if not prescribed:
            return accelerations, np.zeros((0, load.shape[1]))
        r = system.rank
        borne = system.u[:, :r] @ ((system.vt[:r] @ (load + mass @ da)) / system.s[:r, None])
        if np.abs(system.left_null_space[:, drivers]).max(initial=0.0) > TOLERANCES.half_precision:
            raise SpatialPinError(
                f"mechanism {m.name!r}: it has more drivers than freedoms, so that their efforts "
                "are not unique and have no derivatives: drop a driver from the mechanism")
        assert nv == len(load)
        return accelerations, borne[drivers] / sizes

    def _dimension_forces(self, a: Array, multipliers: Array, by_q: Array) -> Array:
        """Return derivatives (nv, n) of missing forces by dimensions, without motions of the tree.

        Inertia is a linear function of the bodies' numbers; forces that the file itself computes
        are differenced.
        """
        geometry, at = self.geometry, self.state
        out = np.zeros((len(self.scale), geometry.moves.shape[1]))
        if geometry.inertias.any():
            model = at.mechanism.model
            out += pin.computeJointTorqueRegressor(
                model, model.createData(), at.q, at.v, a) @ geometry.inertias.T
        for k, (step, around) in geometry.written.items():
            values = []
            for mechanism in around:
                there = State(mechanism, at.q, at.v, a, closure_error=0.0,
                              angles=at.angles if at.angles.size else None)
                with equations_of(mechanism) as equations:
                    equations.update(there)
                    values.append(equations.motion_forces(a) - equations.given
                                  - closure_jacobian(mechanism, at.q).T @ multipliers)
            out[:, k] = np.tensordot(SLOPE / step, np.array(values), 1) - (  # masses are in it
                by_q @ geometry.moves[:, k])[geometry.v]
        return out


class OpenedError(SpatialPinError):
    """An input alone would open a loop.

    Args:
        column: number of the input.
    """

    def __init__(self, column: int) -> None:
        super().__init__(f"input {column} alone opens a loop")
        self.column = column
