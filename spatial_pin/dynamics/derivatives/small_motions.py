"""Equations of small motions about a State, loops closed: M y'' + C y' + K y = f.

Motions that keep the loops closed and the held coordinates still are dq = N y. With the residual
r = M a + b - f - J^T lambda of the equations of motion, K = N^T (dr/dq) N at constant multipliers
lambda: the geometric stiffness of loops, weights and preloaded springs is part of it. Where
coordinates turn at constant speed, the velocities and accelerations of the others follow from q
through the loops, and their changes are part of K and C.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.close import scaled_row
from spatial_pin.assembly.holding import held_by
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.derivatives.derivatives import changes_of_forces
from spatial_pin.dynamics.derivatives.row_derivatives import RowDerivatives
from spatial_pin.dynamics.derivatives.spring_derivatives import ExternalWrenches, Springs
from spatial_pin.dynamics.forces import Forces, Law, joint_efforts
from spatial_pin.dynamics.solvers.equations_of_motion import Equations
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_curvature, finite_number
from spatial_pin.mechanism.inertia import fall_energy
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.mobility.idle_freedoms import PassiveFreedom, described, idle_freedoms
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

NO_LOAD = TOLERANCES.nothing  # part of all forces that is none


class AppliedLoads:
    """Loads, fixed coordinates and constant speeds of a mechanism, as `linearize` takes them.

    Attributes:
        entries: velocity entries that are held or have a constant speed.
        held: coordinates of joints of one freedom among them.
        effort: (nv,) efforts at joints.
    """

    def __init__(
        self, mechanism: Mechanism, hold: str | Iterable[str] | None = None,
        speeds: Mapping[str, float] | None = None, efforts: Mapping[str, float] | None = None,
        external: Mapping[str, pin.Force] | None = None, laws: Mapping[str, Law] | None = None,
    ) -> None:
        self.mechanism, self.external, self.laws = mechanism, external, laws
        self.effort = joint_efforts(mechanism, efforts)
        self.springs = Springs(Forces(mechanism, laws), laws)
        still = held_by(mechanism, hold)
        self.speeds: dict[Coordinate, float] = {}
        for name, speed in (speeds or {}).items():
            coordinate = mechanism.driven_coordinate(name)
            if coordinate.v in still.entries or coordinate in self.speeds:
                raise SpatialPinError(f"mechanism {mechanism.name!r}: {name!r} has a speed and is "
                                      "held, or has two speeds")
            self.speeds[coordinate] = finite_number(speed, f"speed of {name!r}")
        self.components = still.coordinates
        self.entries = (*still.entries, *(c.v for c in self.speeds))
        self.held = [c for c in mechanism.coordinate_table.values()
                     if c.q >= 0 and c.v in self.entries]

    def leaves(self, coordinate: Coordinate) -> bool:
        """Whether a coordinate is neither held nor turned."""
        return coordinate not in self.components and coordinate.v not in self.entries

    def rows(self, evaluation: LoopEquations) -> Array:
        """Return the closure equations, then the held coordinates, as rows (m, nv), scaled."""
        n, nv = evaluation.constraints.n_closure, evaluation.model.nv
        return np.vstack([evaluation.jacobian[:n], np.eye(nv)[list(self.entries)], *(
            scaled_row(self.mechanism, c, evaluation.q)[None] for c in self.components)])

    def pace(self) -> Array:
        """Return the rates of the held coordinates, scaled, in the order of their rows."""
        pace = np.zeros(len(self.entries) + len(self.components))
        for c, speed in self.speeds.items():
            pace[self.entries.index(c.v)] = speed / self.mechanism.velocity_scale[c.v]
        return pace


class ReducedEquations(NamedTuple):
    """Equations of small motions in n coordinates y.

    Attributes:
        motions: (n, nv) joint velocities per unit rate of each.
        mass, damping, stiffness: (n, n).
        load: (n,) forces that are not balanced.
        sizes: (n,) of the forces, and (n, n) of the terms of the stiffness without their signs.
    """

    motions: Array
    mass: Array
    damping: Array
    stiffness: Array
    load: Array
    sizes: tuple[Array, Array]


class SmallMotions:
    """The equations of motion about a closed State, ready to be reduced to coordinates.

    Attributes:
        state: the State, moving and accelerated as the speeds say.
        freedoms: (k, nv) orthonormal rows of velocities, scaled, that loops and holds leave.
        wanted: (nv,) joint forces that loops and held coordinates bear.
        size: of all forces, by scaled velocities [J].

    Raises:
        SingularError: the loops have lost rank there.
    """

    def __init__(self, loads: AppliedLoads, state: State) -> None:
        self.loads, mechanism = loads, loads.mechanism
        self._scale, q = mechanism.velocity_scale, state.q
        with acquired(mechanism, Equations) as equations:
            equations.move_to(state)
            n = equations.n_closure
            equations.ranks.check(equations.spaces.rank if n else 0)
            svd = decompose(loads.rows(equations.evaluation))
            pace, scale = loads.pace(), self._scale
            v = scale * svd.minimum_norm(np.append(np.zeros(n), pace))
            bias = equations.evaluation.bias(q, v)[:n]
            a = -scale * svd.minimum_norm(np.append(bias, 0.0 * pace))
            self.state = State(mechanism, q, v, a, closure_error=state.closure_error,
                               angles=state.angles)
            equations.update(self.state, loads.external, loads.laws)
            needed, given = equations.motion_forces(a), equations.given + loads.effort
            self.mass = equations.mass()
        self.wanted = needed - given
        self.freedoms = svd.null_space
        self._inverse = (svd.vt[: svd.rank].T / svd.s[: svd.rank]) @ svd.u[:, : svd.rank].T
        self._rows = rows = RowDerivatives(mechanism, loads.springs.forces, (q, v, a),
                                           self.state.angles)
        loads.springs.move(rows, svd.null_space * scale)
        multipliers = svd.minimum_norm_transposed(scale * self.wanted)
        self.by_q, self.by_v = changes_of_forces(
            rows, loads.springs, ExternalWrenches(mechanism, loads.external), multipliers[:n])
        for c, x in zip(loads.components, multipliers[n + len(loads.entries) :], strict=True):
            self.by_q -= x / scale[c.v] * coordinate_curvature(mechanism, c, q)
        self.size = self._size(np.abs(given) + np.abs(loads.effort))

    def _size(self, given: Array) -> float:
        """Return the size of the forces by scaled velocities [J]: weights, inertia, springs.

        A change of the pose by a unit is among what makes them, so that it is no zero at rest.
        """
        mechanism, scale, at = self.loads.mechanism, self._scale, self.state
        weight = fall_energy(mechanism.model, mechanism.characteristic_length)
        rates = np.abs(at.a / scale).max(initial=0.0) + np.abs(at.v / scale).max(initial=0.0) ** 2
        inertia = np.abs(scale[:, None] * self.mass * scale).max(initial=0.0)
        stiff = np.abs(scale[:, None] * self.by_q * scale).max(initial=0.0)
        return float(weight + rates * inertia + np.abs(scale * given).max(initial=0.0) + stiff)

    def reduced(self, motions: Array, rates: Array | None = None) -> ReducedEquations:
        """Return the equations in coordinates whose unit rates move the joints by `motions`.

        Args:
            motions: (n, nv) joint velocities.
            rates: (n, nv) of these coordinates by the joints' velocities; None where the motions
                are orthonormal once they are scaled.
        """
        q, mass = motions.T, self.mass
        stiff, damp = self.by_q @ q, self.by_v @ q
        if self.loads.speeds:
            by_q, by_v = self._rows.changes(2)
            v = self._carried(self._rows.changes(1)[0] @ q, q, rates)
            a = self._carried(by_q @ q + by_v @ v, q, rates)
            stiff = stiff + self.by_v @ v + mass @ a
            damp = damp + mass @ self._carried(by_v @ q, q, rates)
        sizes = np.abs(motions)
        return ReducedEquations(
            motions, motions @ mass @ q, motions @ damp, motions @ stiff, -motions @ self.wanted,
            (sizes @ (self.size / self._scale), sizes @ np.abs(self.by_q) @ sizes.T))

    def _carried(self, opened: Array, q: Array, rates: Array | None) -> Array:
        """Return the joint rates (nv, n) that cancel closure rates (n_closure, n)."""
        rest = np.zeros((self._inverse.shape[1] - len(opened), opened.shape[1]))
        columns: Array = -self._scale[:, None] * (self._inverse @ np.vstack([opened, rest]))
        return columns if rates is None else columns - q @ (rates @ columns)

    @cached_property
    def orthonormal(self) -> ReducedEquations:
        """The equations in an orthonormal basis of all freedoms, scaled."""
        return self.reduced(self.freedoms * self._scale)

    def idle(self) -> tuple[tuple[PassiveFreedom, ...], Array]:
        """Return idle rotations without load and stiffness, and their velocities (k, nv)."""
        loops, q = LoopEquations(self.loads.mechanism), self.state.q
        joints, free = idle_freedoms(loops, q, self.loads.entries), self.freedoms * self._scale
        pairs = [(joint, v) for joint, motions in joints for v in motions]
        motions = np.array([v for _, v in pairs]).reshape(-1, len(self.wanted))
        none = NO_LOAD * self.size * np.abs(motions / self._scale).sum(axis=1)
        loaded = np.abs(motions @ self.wanted) > none
        stiff = np.abs(motions @ self.by_q @ free.T).max(axis=1, initial=0.0) > none
        still = ~loaded & ~stiff
        return (tuple(described(loops, *pair) for pair, idles in zip(pairs, still, strict=True)
                      if idles), motions[still])

    def without_idle(self, idle: Array) -> Array:
        """Return motions (n, nv), scaled, of all freedoms but idle rotations (k, nv).

        By inertia they do no work on idle rotations, which move independently.
        """
        free, scale = self.freedoms, self._scale
        if not len(idle):
            return free
        spins = idle / scale
        rest = decompose(spins @ free.T).null_space @ free
        mass = scale[:, None] * self.mass * scale
        coupled = decompose(spins @ mass @ spins.T).minimum_norm(spins @ mass @ rest.T)
        motions: Array = rest - coupled.T @ spins
        return motions
