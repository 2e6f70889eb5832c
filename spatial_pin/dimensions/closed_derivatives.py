"""Derivatives of a closed state by drivers' motions and dimensions [implicit functions].

The closure equations c(q) = 0, c' = 0, c'' = 0 and the drivers' rows are differentiated. All
derivatives solve the same linear system; those of rates have the rows of idle rotations too:

    A dq = -dc,  A dv = -dc' (by q),  A da = -dc'' (by q and v)
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.close import scaled_row
from spatial_pin.assembly.holding import fixed_base_entries
from spatial_pin.assembly.square_system import SINGULAR_PIVOT
from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dimensions.moved_geometry import MovedGeometry
from spatial_pin.dynamics.derivatives.row_derivatives import RowDerivatives
from spatial_pin.dynamics.forces import Forces
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array, Decomposition, full_decomposition
from spatial_pin.numerics.tolerances import TOLERANCES


def fixed_entries(mechanism: Mechanism, driven: Sequence[Coordinate]) -> list[int]:
    """Return the velocity entries that do not move: of bases, and of what no loop ties."""
    loose = np.flatnonzero(~constraints_of(mechanism).tied).tolist()
    return sorted({*fixed_base_entries(mechanism, driven), *loose} - {c.v for c in driven})


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


Changes = tuple[Array, Array, Array]  # of q, v and a (nv, m), with added joints, by the inputs


class ClosedDerivatives:
    """Derivatives of a closed state of a mechanism.

    Attributes:
        geometry, state, driven: as given.
        rows: the closure equations and their derivatives at the motion.
        mechanism: the mechanism with added joints.
    """

    def __init__(
        self, geometry: MovedGeometry, state: State, driven: Sequence[Coordinate],
        still: Sequence[int],
    ) -> None:
        self.geometry, self.state, self.mechanism = geometry, state, geometry.mechanism
        self.driven, self._still = list(driven), list(still)
        self.rows = RowDerivatives(
            self.mechanism, Forces(self.mechanism), geometry.motion(state, state.a), state.angles)
        self.scale = state.mechanism.velocity_scale
        self.by = [self.rows.changes(k) for k in range(3)]

    @cached_property
    def positions(self) -> Decomposition:
        """The closure equations, drivers and fixed entries, by scaled velocities.

        Raises:
            SingularError: a singular value is neither zero nor large enough for a digit, as of
                rates.
        """
        system = full_decomposition(self._matrix(self.by[0][0][:, self.geometry.v] * self.scale))
        if system.rank and system.s[system.rank - 1] < SINGULAR_PIVOT * system.s[0]:
            raise SingularError(
                f"mechanism {self.state.mechanism.name!r}: singular configuration, {self.state}: "
                "the derivatives have no reliable digit there", state=self.state)
        return system

    def _matrix(self, closed: Array) -> Array:
        m, q = self.state.mechanism, self.state.q
        drivers = [scaled_row(m, c, q) for c in self.driven]
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
        bodies = self.rows.bodies
        first, second, paced, columns = (
            (along @ x[:, 3:])[:, 0] for x in bodies.by_motion(joints))
        carriers, back = bodies.joints[joints], bodies.to_bodies(joints)
        spins = np.stack([(back @ x[carriers][..., None])[:, 3:, 0]
                          for x in (bodies.v, bodies.a)])
        return columns, first, second, paced, spins

    @cached_property
    def _rates(self) -> Decomposition:
        """The same with the rows of idle rotations between closure equations and drivers."""
        if not constraints_of(self.state.mechanism).idle_axes:
            return self.positions
        closed = np.vstack([self.by[0][0], self._idle[0]])[:, self.geometry.v]
        return full_decomposition(self._matrix(closed * self.scale))

    @cached_property
    def written(self) -> Array:
        """(3, n_closure, n) derivatives of the equations and their rates by written dimensions.

        These are numbers of closures: lengths, axes, ratios, curves; not joints and frames.
        """
        out = np.zeros((3, len(self.by[0][0]), self.geometry.moves.shape[1]))
        moves, at = self.geometry.moves, self.state
        for k, (weights, around) in self.geometry.written.items():
            values = []
            for mechanism in around:
                with loops_of(mechanism, at.angles) as loops:
                    bias = loops.bias(at.q, at.v)
                    loops.update(at.q)
                    rows, n = loops.jacobian / mechanism.velocity_scale, out.shape[1]
                    values.append([loops.residual.copy(), rows[:n] @ at.v,
                                   (rows @ at.a + bias)[:n]])
            out[:, :, k] = np.tensordot(weights, np.array(values), 1) - np.array(
                [by_q @ moves[:, k] for by_q, _ in self.by])
        return out

    def changes(self, given: InputChanges) -> Changes:
        """Return the derivatives by the inputs; columns for undetermined freedoms follow.

        Raises:
            OpenedError: an input alone opens a loop.
            SingularError: the state is too near a singular one.
        """
        loose = self._rates.null_space
        moved, n = self.displacements(given), len(loose)
        q, v, a = np.zeros((3, self.mechanism.model.nv, moved.shape[1] + n))
        q[:, : moved.shape[1]], own = moved, self.geometry.v
        written = self.written[1:] @ given.dimensions
        idle = self._idle_changes(given, q, v, 0)
        v[own] = self._solved(self._rates, [(self.by[1][0], q)], given.rates, written[0], idle)
        v[own, moved.shape[1] :] = (loose * self.scale).T
        idle = self._idle_changes(given, q, v, 1)
        a[own] = self._solved(self._rates, [(self.by[2][0], q), (self.by[2][1], v)],
                              given.accelerations, written[1], idle)
        return q, v, a

    def displacements(self, given: InputChanges) -> Array:
        """Return the changes of q alone by the inputs, and the freedoms that nothing determines.

        Raises:
            OpenedError: an input alone opens a loop.
            SingularError: the state is too near a singular one.
        """
        spare, m, own = self.positions.null_space, given.values.shape[1], self.geometry.v
        q = np.zeros((self.mechanism.model.nv, m + len(spare)))
        q[:, :m] = self.geometry.moves @ given.dimensions
        written = self.written[0] @ given.dimensions
        q[own] = self._solved(self.positions, [(self.by[0][0], q)], given.values, written)
        q[own, m:] = (spare * self.scale).T
        return q

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

        `moved` are derivatives of the closure equations, with the changes (nv, m) of what these are
        by. `driven` (drivers, m) are changes of the drivers, `written` (n_closure, m) others of the
        equations, `idle` (k, m) those of idle rotations that they cancel.

        Raises:
            OpenedError: they cannot.
        """
        opened = np.sum([by @ x for by, x in moved], axis=0)
        opened[:, : written.shape[1]] += written
        opened = opened if idle is None else np.vstack([opened, idle])
        sizes = np.array([self.scale[c.v] for c in self.driven]).reshape(-1, 1)
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


class OpenedError(SpatialPinError):
    """An input alone would open a loop.

    `column` is the number of the input.
    """

    def __init__(self, column: int) -> None:
        super().__init__(f"input {column} alone opens a loop")
        self.column = column
