"""Derivatives of the forces of a closed state by drivers' motions, dimensions and efforts.

They follow from the derivative of M a + b - f = J^T lambda + B tau. In forward dynamics its
projection on the freedoms of the loops gives accelerations; in inverse dynamics it gives efforts.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.closed_derivatives import Changes, ClosedDerivatives, InputChanges
from spatial_pin.dynamics.derivatives.derivatives import changes_of_forces, exact_mechanism
from spatial_pin.dynamics.derivatives.reaction_derivatives import Linear, ReactionChanges
from spatial_pin.dynamics.derivatives.row_derivatives import RowDerivatives
from spatial_pin.dynamics.derivatives.spring_derivatives import ExternalWrenches, Springs
from spatial_pin.dynamics.forces import Forces
from spatial_pin.dynamics.kinetostatics import Kinetostatics
from spatial_pin.dynamics.solvers.equations_of_motion import Equations
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, Decomposition, decompose
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.jacobians import closure_jacobian

Changed = tuple[Array, Array]  # a quantity (...), and its derivatives (..., m)


class Load(NamedTuple):
    """The forces at a state.

    Attributes:
        a: (nv,) accelerations that they give.
        multipliers: (n_closure,) of the closure equations.
        efforts: by driver.
        unique: (6,) by pair, which components of its reaction are unique.
        prescribed: whether the drivers' accelerations are given, and not their efforts.
    """

    a: Array
    multipliers: Array
    efforts: dict[str, float]
    unique: dict[str, NDArray[np.bool_]]
    prescribed: bool

    @classmethod
    def of_sample(cls, loads: Kinetostatics, k: int, prescribed: bool) -> Load:
        """Return the forces at a sample of a motion."""
        return cls(loads.a[k], loads.multipliers[k],
                   {name: float(x[k]) for name, x in loads.efforts.items()},
                   {name: x[k] for name, x in loads.unique.items()}, prescribed)


class ForceChanges:
    """Derivatives of forces, and of the accelerations that efforts give.

    Attributes:
        a: (nv, m) changes of the accelerations.
        multipliers: of the closure equations.
        efforts: by driver.

    Raises:
        SpatialPinError: the efforts are not unique, or the file's numbers are rounded.
    """

    def __init__(
        self, at: ClosedDerivatives, given: InputChanges, changes: Changes, load: Load
    ) -> None:
        exact_mechanism(at.state)
        self._at, self._given, self._changes, self._load = at, given, changes, load
        geometry, own, n = at.geometry, at.geometry.v, given.efforts.shape[1]
        self._springs = springs = Springs(Forces(at.mechanism))
        self._rows = rows = at.rows if np.array_equal(load.a, at.state.a) else RowDerivatives(
            at.mechanism, springs.forces, geometry.motion(at.state, load.a), at.state.angles)
        springs.move(rows)
        springs.refuse_undirected()
        by_q, by_v = changes_of_forces(
            rows, springs, ExternalWrenches(at.mechanism, None), load.multipliers)
        needed = (by_q @ changes.q + by_v @ changes.v)[own]
        needed[:, :n] -= given.efforts
        needed[:, :n] += self._of_dimensions(by_q) @ given.dimensions
        by_q2, by_v2 = rows.changes(2)
        opened = by_q2 @ changes.q + by_v2 @ changes.v
        opened[:, :n] += at.written[2] @ given.dimensions
        system = at.positions if load.prescribed else decompose(at.by[0][0][:, own] * at.scale)
        self._solve(system, needed, opened)

    def _solve(self, system: Decomposition, needed: Array, opened: Array) -> None:
        """Solve for accelerations and for what bears the missing forces `needed` (nv, m).

        The system has the closure equations, of prescribed drivers with their rows. `needed` is
        that of M a + b - f - J^T lambda at constant a and lambda, `opened` (n_closure, m) that of
        the equations' second rates.
        """
        at, load, given, mechanism = self._at, self._load, self._given, self._at.state.mechanism
        sizes = np.array([at.scale[c.v] for c in at.driven]).reshape(-1, 1)
        drivers = slice(len(opened), len(opened) + len(at.driven))
        total = np.zeros((len(system.u), needed.shape[1]))
        total[: len(opened)] = -opened
        if load.prescribed:
            total[drivers, : given.efforts.shape[1]] = given.accelerations / sizes
        with acquired(mechanism, Equations) as equations:
            equations.move_to(at.state)
            mass = equations.mass() * at.scale * at.scale[:, None]
        needed = needed * at.scale[:, None]
        da, free = system.minimum_norm(total), system.null_space
        if len(free):
            inertia = free @ mass @ free.T
            da += free.T @ decompose(inertia).minimum_norm(-free @ (needed + mass @ da))
        r = system.rank
        borne = system.u[:, :r] @ ((system.vt[:r] @ (needed + mass @ da)) / system.s[:r, None])
        self.a = at.scale[:, None] * da
        self.multipliers: Changed = load.multipliers, borne[: len(opened)]
        self.efforts: dict[str, Changed] = {}
        rows = borne[drivers] / sizes if load.prescribed else np.hstack([
            given.efforts, np.zeros((len(da), da.shape[1] - given.efforts.shape[1]))])
        pressed = load.prescribed and np.abs(system.left_null_space[:, drivers]).max(
            initial=0.0) > TOLERANCES.half_precision
        for name in mechanism.drivers:
            c = mechanism.coordinate(name)
            if load.prescribed and (pressed or c not in at.driven):
                raise SpatialPinError(
                    f"mechanism {mechanism.name!r}: it has more drivers than freedoms, so that "
                    "their efforts are not unique and have no derivatives: drop a driver from the "
                    "mechanism")
            change = rows[at.driven.index(c)] if load.prescribed else rows[c.v]
            self.efforts[name] = np.array(load.efforts.get(name, 0.0)), change

    @cached_property
    def reactions(self) -> tuple[dict[str, Changed], Changed]:
        """(6,) and (6, m) by pair, NaN where they are not unique, and on the fixed link."""
        at, load, geometry, (q, v, _) = self._at, self._load, self._at.geometry, self._changes
        larger, n, m = at.mechanism, self._given.dimensions.shape[1], q.shape[1]
        nv, mechanism = larger.model.nv, at.state.mechanism
        effort, efforts, a = np.zeros(nv), np.zeros((nv, m)), np.zeros((nv, m))
        for name, (value, change) in self.efforts.items():
            entry = geometry.v[mechanism.coordinate(name).v]
            effort[entry] += value
            efforts[entry] += change
        a[geometry.v] = self.a
        changed = np.zeros((larger.model.njoints, 10, m))
        inertias = geometry.inertias.reshape(-1, mechanism.model.njoints - 1, 10).copy()
        inertias[list(geometry.written)] = 0.0  # `_of_written` has them
        changed[geometry.joint[1:], :, :n] = np.einsum(
            "djk,dm->jkm", inertias, self._given.dimensions)
        own, still = self._rows.motion[2], np.zeros((nv, nv))
        none = np.zeros((len(load.multipliers), nv))
        wrenches, ground = ReactionChanges(
            None, self._rows, self._springs, ExternalWrenches(larger, None), effort,
            Linear(own, still, still, a), Linear(load.multipliers, none, none, self.multipliers[1]),
            np.arange(len(load.multipliers)), efforts, changed).wrenches()
        names = [*load.unique, ""]
        written = self._of_written(effort[geometry.v], {**wrenches, "": ground}, names)

        def total(name: str, x: Array) -> Changed:
            change = (x[:, 1 : 1 + nv] @ q + x[:, 1 + nv : 1 + 2 * nv] @ v + x[:, 1 + 2 * nv :])
            change[:, :n] += written[name] @ self._given.dimensions
            change[~load.unique.get(name, np.ones(6, bool))] = np.nan
            return x[:, 0], change

        return {name: total(name, wrenches[name]) for name in load.unique}, total("", ground)

    def _of_written(
        self, effort: Array, wrenches: dict[str, Array], names: list[str]
    ) -> dict[str, Array]:
        """Return derivatives (6, n) by dimensions that the mechanism file itself computes with.

        Those of the reactions of pairs, "" of the wrench on the fixed link, at constant motion,
        multipliers and efforts; motions of the tree are not part of them.
        """
        geometry, load = self._at.geometry, self._load
        out: dict[str, Array] = {name: np.zeros((6, geometry.moves.shape[1])) for name in names}
        nv = len(geometry.moves)
        for k, (weights, around) in geometry.written.items():
            values = []
            for mechanism in around:
                with acquired(mechanism, Equations) as equations:
                    equations.update(self._there(mechanism))
                    borne, ground = equations.reactions(load.a, load.multipliers, effort)
                    values.append({**borne, "": ground})
            for name, change in out.items():
                change[:, k] = np.tensordot(
                    weights, np.array([x[name] for x in values]), 1) - (
                    wrenches[name][:, 1 : 1 + nv] @ geometry.moves[:, k])
        return out

    def _there(self, mechanism: Mechanism) -> State:
        """Return the same motion of a mechanism at other dimensions, with the load's a."""
        at = self._at.state
        return State(mechanism, at.q, at.v, self._load.a, closure_error=0.0,
                     angles=at.angles if at.angles.size else None)

    def _of_dimensions(self, by_q: Array) -> Array:
        """Return derivatives (nv, n) of missing forces by dimensions, without motions of the tree.

        Inertia is a linear function of the bodies' numbers; forces that the file itself computes
        are differenced.
        """
        geometry, at, load = self._at.geometry, self._at.state, self._load
        out = np.zeros((len(self._at.scale), geometry.moves.shape[1]))
        if geometry.inertias.any():
            model = at.mechanism.model
            out += pin.computeJointTorqueRegressor(
                model, model.createData(), at.q, at.v, load.a) @ geometry.inertias.T
        for k, (weights, around) in geometry.written.items():
            values = []
            for mechanism in around:
                with acquired(mechanism, Equations) as equations:
                    equations.update(self._there(mechanism))
                    values.append(equations.motion_forces(load.a) - equations.given
                                  - closure_jacobian(mechanism, at.q).T @ load.multipliers)
            out[:, k] = np.tensordot(weights, np.array(values), 1) - (  # masses are in it
                by_q @ geometry.moves[:, k])[geometry.v]
        return out
