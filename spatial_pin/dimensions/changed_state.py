"""A closed state and its forces, with their derivatives by inputs, from which outputs have theirs.

A sample for each input has the state in its real part, and the derivative by the input, times a
tiny step, in its imaginary one. So whatever is worked out of it has its own derivative there, to
all digits [Martins2003].

Derivatives of forces follow from the derivative of M a + b - f = J^T lambda + B tau. In forward
dynamics its projection on the freedoms of the loops gives accelerations; in inverse dynamics it
gives efforts.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.state import FrameMotion, State, center_of_mass
from spatial_pin.constraints.trees import skewed
from spatial_pin.dimensions.closed_derivatives import Changes, ClosedDerivatives, InputChanges
from spatial_pin.dynamics.derivatives.derivatives import changes_of_forces, exact_mechanism
from spatial_pin.dynamics.derivatives.reaction_derivatives import Linear, ReactionChanges
from spatial_pin.dynamics.derivatives.row_derivatives import RowDerivatives
from spatial_pin.dynamics.derivatives.spring_derivatives import ExternalWrenches, Springs
from spatial_pin.dynamics.force_outputs import rule_of
from spatial_pin.dynamics.forces import Forces
from spatial_pin.dynamics.kinetostatics import Kinetostatics
from spatial_pin.dynamics.solvers.equations_of_motion import Equations
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.coordinates import (
    CoordinateRates,
    rotation_vector_rates,
    rotation_vectors,
    spin_of,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.outputs import WHOLE, NamedOutput, at_point, whole_com
from spatial_pin.numerics.linalg import Array, Decomposition, decompose
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.jacobians import closure_jacobian

IMAGINARY_STEP = 1e-200  # its square vanishes, so that derivatives have all digits
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
        q, v, _ = changes
        needed = (by_q @ q + by_v @ v)[own]
        needed[:, :n] -= given.efforts
        needed[:, :n] += self._of_dimensions(by_q) @ given.dimensions
        by_q2, by_v2 = rows.changes(2)
        opened = by_q2 @ q + by_v2 @ v
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
        inertias[list(geometry.written)] = 0.0  # `_written_reactions` has them
        changed[geometry.joint[1:], :, :n] = np.einsum(
            "djk,dm->jkm", inertias, self._given.dimensions)
        own, still = self._rows.motion[2], np.zeros((nv, nv))
        none = np.zeros((len(load.multipliers), nv))
        wrenches, ground = ReactionChanges(
            self._rows, self._springs, ExternalWrenches(larger, None), effort,
            Linear(own, still, still, a), Linear(load.multipliers, none, none, self.multipliers[1]),
            np.arange(len(load.multipliers)), efforts, changed).wrenches()
        names = [*load.unique, ""]
        written = _written_reactions(at, load, effort[geometry.v], {**wrenches, "": ground}, names)

        def total(name: str, x: Array) -> Changed:
            change = (x[:, 1 : 1 + nv] @ q + x[:, 1 + nv : 1 + 2 * nv] @ v + x[:, 1 + 2 * nv :])
            change[:, :n] += written[name] @ self._given.dimensions
            change[~load.unique.get(name, np.ones(6, bool))] = np.nan
            return x[:, 0], change

        return {name: total(name, wrenches[name]) for name in load.unique}, total("", ground)

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
                    equations.update(_state_of(mechanism, at, load))
                    values.append(equations.motion_forces(load.a) - equations.given
                                  - closure_jacobian(mechanism, at.q).T @ load.multipliers)
            out[:, k] = np.tensordot(weights, np.array(values), 1) - (  # masses are in it
                by_q @ geometry.moves[:, k])[geometry.v]
        return out


def _written_reactions(
    at: ClosedDerivatives, load: Load, effort: Array, wrenches: dict[str, Array], names: list[str]
) -> dict[str, Array]:
    """Return derivatives (6, n) by dimensions that the mechanism file itself computes with.

    Those of the reactions of pairs, "" of the wrench on the fixed link, at constant motion,
    multipliers and efforts; motions of the tree are not part of them.
    """
    geometry, nv = at.geometry, len(at.geometry.moves)
    out: dict[str, Array] = {name: np.zeros((6, geometry.moves.shape[1])) for name in names}
    for k, (weights, around) in geometry.written.items():
        values = []
        for mechanism in around:
            with acquired(mechanism, Equations) as equations:
                equations.update(_state_of(mechanism, at.state, load))
                borne, ground = equations.reactions(load.a, load.multipliers, effort)
                values.append({**borne, "": ground})
        for name, change in out.items():
            change[:, k] = np.tensordot(weights, np.array([x[name] for x in values]), 1) - (
                wrenches[name][:, 1 : 1 + nv] @ geometry.moves[:, k])
    return out


def _state_of(mechanism: Mechanism, at: State, load: Load) -> State:
    """Return the same motion of a mechanism at other dimensions, with the load's a."""
    return State(mechanism, at.q, at.v, load.a, closure_error=0.0,
                 angles=at.angles if at.angles.size else None)


def with_change(value: Array, change: Array) -> Array:
    """Return a value with its derivative."""
    both: Any = value + 1j * IMAGINARY_STEP * change
    return cast(Array, both)


def output_changes(
    at: ClosedDerivatives, given: InputChanges, load: Load | None, outputs: Iterable[NamedOutput],
    driver_speed: float = np.nan,
) -> list[Array]:
    """Return the derivatives (size, m) of outputs, and of freedoms that nothing determines.

    `load` has the forces there, if an output needs them or they give accelerations. The driver's
    speed, of speed ratios, does not change.

    Returns:
        By output (size, m + loose), NaN for reactions that are not unique.

    Raises:
        OpenedError: an input alone opens a loop.
        SpatialPinError: efforts are not unique, or a spring has no direction.
    """
    changes = at.changes(given)
    forces = None if load is None else ForceChanges(at, given, changes, load)
    if forces is not None and load is not None and not load.prescribed:
        changes[2][at.geometry.v] = forces.a
    n, m = given.dimensions.shape[0], changes[0].shape[1]
    wide = np.hstack([given.dimensions, np.zeros((n, m - given.dimensions.shape[1]))])
    moved = ChangedState(at, changes, wide, driver_speed)
    loads = None if forces is None else ChangedLoads(moved, forces)
    return [(np.imag(x.values(loads if x.family == "force" else moved, rule_of(x))) / IMAGINARY_STEP
             ).reshape(m, -1).T for x in outputs]


class ChangedState:
    """A state with its derivatives, in place of the samples of a motion.

    It is made of the changes of q, v and a, and those (n, m) of the dimensions.

    Attributes:
        mechanism, q: of the state.
        driver_speed: (m,) as given.
    """

    def __init__(
        self, at: ClosedDerivatives, changes: Changes, dimensions: Array,
        driver_speed: float = np.nan,
    ) -> None:
        self._at, self._changes, self._dimensions = at, changes, dimensions
        self.mechanism, self.q = at.state.mechanism, at.state.q[None]
        self.swept = self.driver_speed = np.full(dimensions.shape[1], driver_speed)

    @cached_property
    def _bodies(self) -> tuple[Array, Array, Array]:
        """Joint placements (m, n, 4, 3), local twists and spatial accelerations (m, n, 6)."""
        bodies, (dq, dv, da) = self._at.rows.bodies, self._changes
        every = np.arange(len(bodies.joints))
        v_by_q, a_by_q, a_by_v, own = bodies.by_motion(every)
        back = bodies.to_bodies(every)
        local = [(back @ x[bodies.joints][..., None])[..., 0] for x in (bodies.v, bodies.a)]
        moved = own @ dq
        rates = (moved, v_by_q @ dq + own @ dv, a_by_q @ dq + a_by_v @ dv + own @ da)
        dx, dtwist, daccel = (np.moveaxis(x, -1, 0) for x in rates)
        turn, spins = bodies.placements[:, :3], skewed(dx[..., 3:])
        placed = np.concatenate([spins.mT @ turn, dx[..., None, :3] @ turn], axis=-2)
        return (with_change(bodies.placements, placed), with_change(local[0], dtwist),
                with_change(local[1], daccel))

    def coordinate(self, name: str) -> CoordinateRates[Array]:
        """See `Motion.coordinate`."""
        state, own, m = self._at.state, self._at.geometry.v, self.mechanism
        c = m.coordinate(name)
        if c.q >= 0:
            return CoordinateRates(*(
                with_change(x, dx[own[c.v]]) for x, dx in zip(
                    (state.q[c.q], state.v[c.v], state.a[c.v]), self._changes, strict=True)))
        joint = m.joint_id(c.joint)
        entries = slice(m.model.idx_vs[joint], m.model.idx_vs[joint] + m.model.nvs[joint])
        changes = [x[own[entries]] for x in self._changes]
        speeds, accels = state.v[entries], state.a[entries]
        end = m.model.idx_qs[joint] + m.model.nqs[joint]
        if c.component < 3 and len(speeds) == 6:
            turn = np.array(pin.Quaternion(state.q[end - 4 : end]).matrix())
            position, velocity, accel = _along(turn, speeds, accels, changes)
            k, values = c.component, [state.q[end - 7 : end - 4], turn @ speeds[:3],
                                      turn @ (accels[:3] + np.cross(speeds[3:], speeds[:3]))]
            return CoordinateRates(*(with_change(x[k], dx[k]) for x, dx in zip(
                values, (position, velocity, accel), strict=True)))
        phi = rotation_vectors(state.q[None, end - 4 : end])[0]
        return _rotation_vector(phi, speeds[-3:], accels[-3:], [x[-3:] for x in changes],
                                c.component % 3)

    def frame(self, name: str) -> FrameMotion:
        """See `Motion.frame`."""
        return self._at_point(name, np.zeros(3))

    def com(self, name: str) -> FrameMotion:
        """See `Motion.com`."""
        geometry = self._at.geometry
        if name == WHOLE and name not in self.mechanism.frame_ids:
            total = self.moving_mass
            return whole_com(self, [
                (int(geometry.joint[joint]), x[:, 0] / total, x[:, 1:] / x[:, :1])
                for joint, x in enumerate(self._masses, start=1) if x[0, 0]])
        lever = center_of_mass(self.mechanism, name)
        if name in geometry.levers:
            lever = with_change(lever, self._dimensions.T @ geometry.levers[name])
        return self._at_point(name, lever)

    def _at_point(self, name: str, point: Array) -> FrameMotion:
        """Return the motion of a point, (3,) or (m, 3), of a frame."""
        joint, placement = self._at.mechanism.frame_on_joint(name)
        turn = placement.rotation
        return at_point(self, joint, turn, point @ turn.T + placement.translation)

    @property
    def moving_mass(self) -> Array:
        """(m,) mass of all moving links."""
        total: Array = self._masses[:, :, 0].sum(axis=0)
        return total

    @cached_property
    def _masses(self) -> Array:
        """(njoints - 1, m, 4) of the bodies: the mass and its first moment."""
        own = self.mechanism.model
        changes = self._at.geometry.inertias.reshape(-1, own.njoints - 1, 10)[..., :4]
        numbers = np.array([x.toDynamicParameters()[:4] for x in own.inertias][1:])
        return with_change(numbers[:, None], np.einsum("dm,djk->jmk", self._dimensions, changes))


class ChangedLoads:
    """Forces of a state with their derivatives, in place of those over a motion.

    Attributes:
        motion: the state.
        efforts, power: (m,) by driver.
        reactions: (m, 6) by pair; on_ground: (m, 6).
        multipliers: (m, n_closure) of the closure equations.
    """

    def __init__(self, motion: ChangedState, forces: ForceChanges) -> None:
        self.motion, mechanism = motion, motion.mechanism
        self._forces = forces
        self.multipliers = _samples(*forces.multipliers)
        self.efforts = {name: _samples(*x) for name, x in forces.efforts.items()}
        self.power = {name: x * motion.coordinate(mechanism.coordinate(name).name).rate
                      for name, x in self.efforts.items()}

    @cached_property
    def reactions(self) -> dict[str, Array]:
        """(m, 6) by pair; derivatives of components that are not unique are NaN."""
        return {name: _samples(*x) for name, x in self._forces.reactions[0].items()}

    @cached_property
    def on_ground(self) -> Array:
        """(m, 6) the shaking wrench."""
        return _samples(*self._forces.reactions[1])


def _samples(value: Array, change: Array) -> Array:
    """Return a quantity (...) with its changes (..., m) as samples (m, ...)."""
    return np.moveaxis(with_change(value[..., None], change), -1, 0)


def _along(turn: Array, speeds: Array, accels: Array, changes: list[Array]) -> list[Array]:
    """Return derivatives (3, m) of the position of a floating joint and of its rates."""
    (u, w), (dq, dv, da) = (speeds[:3], speeds[3:]), changes
    cross, turned = skewed, -skewed(accels[:3] + np.cross(w, u)) @ dq[3:]
    return [turn @ dq[:3], turn @ (dv[:3] - cross(u) @ dq[3:]),
            turn @ (da[:3] - cross(u) @ dv[3:] + cross(w) @ dv[:3] + turned)]


def _rotation_vector(
    phi: Array, omega: Array, alpha: Array, changes: list[Array], k: int
) -> CoordinateRates[Array]:
    """Return a component of a rotation vector and its rates, from the changes (3, m) of a rotation.

    With omega = J(phi) phi' and alpha = J(phi) phi'' + ..., J the derivative of the exponential.
    """
    (rate,), (accel,) = rotation_vector_rates(phi[None], omega[None], alpha[None])

    def slopes(order: int) -> tuple[Array, Array]:
        """Return derivatives (3, 3) of omega and alpha by phi, phi' or phi''."""
        given = [np.tile(x.astype(complex), (3, 1)) for x in (phi, rate, accel)]
        given[order] += IMAGINARY_STEP * 1j * np.eye(3)
        spin = spin_of(*given)
        return spin[0].imag.T / IMAGINARY_STEP, spin[1].imag.T / IMAGINARY_STEP

    turn = np.linalg.inv(slopes(1)[0])
    dphi = turn @ changes[0]
    drate = turn @ (changes[1] - slopes(0)[0] @ dphi)
    daccel = turn @ (changes[2] - slopes(0)[1] @ dphi - slopes(1)[1] @ drate)
    return CoordinateRates(*(with_change(x[k], dx[k]) for x, dx in zip(
        (phi, rate, accel), (dphi, drate, daccel), strict=True)))
