"""A closed state with its derivatives by inputs, from which outputs have theirs.

A sample for each input has the state in its real part, and the derivative by the input, times a
tiny step, in its imaginary one. So whatever is worked out of it has its own derivative there, to
all digits [Martins2003].
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any, cast

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.state import FrameMotion, center_of_mass
from spatial_pin.constraints.trees import skewed
from spatial_pin.dimensions.closed_derivatives import Changes, ClosedDerivatives, InputChanges
from spatial_pin.dimensions.force_derivatives import ForceChanges, Load
from spatial_pin.dynamics.force_outputs import rule_of
from spatial_pin.mechanism.coordinates import (
    CoordinateRates,
    rotation_vector_rates,
    rotation_vectors,
    spin_of,
)
from spatial_pin.motion.outputs import WHOLE, NamedOutput, at_point, whole_com
from spatial_pin.numerics.linalg import Array

IMAGINARY_STEP = 1e-200  # its square vanishes, so that derivatives have all digits


def with_change(value: Array, change: Array) -> Array:
    """Return a value with its derivative."""
    both: Any = value + 1j * IMAGINARY_STEP * change
    return cast(Array, both)


def output_changes(
    at: ClosedDerivatives, given: InputChanges, load: Load | None, outputs: Iterable[NamedOutput],
    driver_speed: float = np.nan,
) -> list[Array]:
    """Return the derivatives (size, m) of outputs, and of freedoms that nothing determines.

    Args:
        at: the closed state.
        given: what the m inputs change.
        load: the forces there, if an output needs them or they give accelerations.
        outputs: which need no "motion".
        driver_speed: of speed ratios; it does not change.

    Returns:
        By output (size, m + loose), NaN for reactions that are not unique.

    Raises:
        OpenedError: an input alone opens a loop.
        SpatialPinError: efforts are not unique, or a spring has no direction.
    """
    changes = at.changes(given)
    forces = None if load is None else ForceChanges(at, given, changes, load)
    if forces is not None and load is not None and not load.prescribed:
        changes.a[at.geometry.v] = forces.a
    n, m = given.dimensions.shape[0], changes.q.shape[1]
    wide = np.hstack([given.dimensions, np.zeros((n, m - given.dimensions.shape[1]))])
    moved = ChangedState(at, changes, wide, driver_speed)
    loads = None if forces is None else ChangedLoads(moved, forces)
    return [(np.imag(x.values(loads if x.family == "force" else moved, rule_of(x))) / IMAGINARY_STEP
             ).reshape(m, -1).T for x in outputs]


class ChangedState:
    """A state with its derivatives, in place of the samples of a motion.

    Args:
        at: the state.
        changes: of its q, v and a.
        dimensions: (n, m) changes of the dimensions.
        driver_speed: of speed ratios; it does not change.

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
        bodies, (dq, dv, da) = self._at.bodies, self._changes
        v_by_q, a_by_q, a_by_v, own = bodies.by_motion(np.arange(len(bodies.joints)))
        back = bodies.to_bodies(bodies.joints)
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
