"""Derivatives of the outputs of a state: coordinates, frames, centres of mass, angles of links."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.link_angle import LinkAngle, link_angle
from spatial_pin.assembly.state import center_of_mass, mass_shares
from spatial_pin.constraints.trees import skewed
from spatial_pin.errors import UnknownNameError
from spatial_pin.function.closed_derivatives import Changes, ClosedDerivatives
from spatial_pin.mechanism.coordinates import (
    rotation_vector_rates,
    rotation_vectors,
    spin_of,
)
from spatial_pin.mechanism.inertia import moving_mass
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.motion.motion import FRAME_UNITS
from spatial_pin.motion.outputs import MASS, RATES, WHOLE, component, is_of_whole
from spatial_pin.numerics.linalg import Array

EFFORT = "effort"
ROTATION = "rotation"
KINDS = (*[kind for kind in FRAME_UNITS if kind != "jerk"], ROTATION)
ORDERS = {"rate": 1, "velocity": 1, "acceleration": 2, "angular_velocity": 1,
          "angular_acceleration": 2}
COMPLEX_STEP = 1e-200  # its square vanishes, so that derivatives have all digits


class Moved(NamedTuple):
    """A state, and its derivatives by the inputs.

    Attributes:
        at: the state with its derivatives.
        changes: of q, v and a (nv, m) of the mechanism with more joints.
        dimensions: (n, m) changes of the dimensions.
        efforts: (drivers, m) changes of the drivers' efforts; empty if no output needs them.
    """

    at: ClosedDerivatives
    changes: Changes
    dimensions: Array
    efforts: Array


Slope = Callable[[Moved], Array]  # (k, m)


class FunctionOutput(NamedTuple):
    """An output of a function.

    Attributes:
        name: as `Motion.output` or `Kinetostatics.output` takes it.
        order: of its highest time derivative.
        size: how many numbers it has.
        slope: returns its derivatives (size, m).
        follows: whether its value is that next to the sample before, in a motion.
        needs: "" or EFFORT, or MASS if it depends on masses.
    """

    name: str
    order: int
    size: int
    slope: Slope
    follows: bool = False
    needs: str = ""


def function_output(mechanism: Mechanism, spec: str) -> FunctionOutput:
    """Return an output by its name.

    Raises:
        UnknownNameError: there is no such output, or it has no derivatives.
    """
    drivers = {name: k for k, name in enumerate(mechanism.drivers)}
    whole, k = component(spec)
    if k is not None:
        made = function_output(mechanism, whole)
        return made._replace(name=spec, size=1, slope=lambda at: made.slope(at)[k : k + 1])
    name, _, kind = spec.rpartition(".")
    effort = spec.removeprefix("effort.") if spec.startswith("effort.") else name
    if effort != spec and (kind == EFFORT or spec.startswith("effort.")):
        own = {**drivers, **{d.joint: drivers[n] for n, d in mechanism.drivers.items()}}
        if effort in own:
            row = own[effort]
            return FunctionOutput(f"{effort}.{EFFORT}", 0, 1,
                                  lambda at: at.efforts[row : row + 1], needs=EFFORT)
    coordinates = {*mechanism.coordinate_table, *mechanism.drivers}
    if spec in coordinates or (name in coordinates and kind in (*RATES, "acceleration")):
        c = mechanism.coordinate(spec if spec in coordinates else name)
        order = 0 if spec in coordinates else ORDERS[kind]
        return FunctionOutput(spec, order, 1, lambda at: _coordinate(at, c, order), c.q < 0)
    angle = link_angle(mechanism, spec)
    if angle is not None:
        turning = angle
        return FunctionOutput(spec, 0, 1, lambda at: _angle(at, turning), turning.sums is None)
    if is_of_whole(mechanism, spec) and kind != "jerk":
        size = 1 if spec == MASS else 3
        return FunctionOutput(spec, ORDERS.get(kind, 0), size,
                              lambda at: _of_whole(at, kind or MASS), needs=MASS)
    body = name.removesuffix(".com")
    if body in mechanism.frame_ids and kind in KINDS and not (body != name and kind == ROTATION):
        if body != name:
            center_of_mass(mechanism, body)
        return FunctionOutput(spec, ORDERS.get(kind, 0), 9 if kind == ROTATION else 3,
                              lambda at: _frame(at, body, kind, body != name),
                              needs=MASS * (body != name))
    valid = [*coordinates, *(f"{n}.{k}" for n in coordinates for k in ("rate", "acceleration")),
             *(f"{n}.{k}" for n in mechanism.frame_ids for k in (*KINDS, "angle")),
             *(f"{n}.com.{k}" for n in mechanism.inertias for k in KINDS[:3]),
             MASS, *(f"{WHOLE}.{k}" for k in KINDS[:3]), *(f"{n}.{EFFORT}" for n in drivers)]
    raise UnknownNameError("differentiable output", spec, valid,
                           f"mechanism {mechanism.name!r}: ")


def _coordinate(moved: Moved, c: Coordinate, order: int) -> Array:
    """Return the derivatives (1, m) of a coordinate, or of its rate or acceleration."""
    at, changes = moved.at, moved.changes
    own, m = at.geometry.v, at.state.mechanism
    if c.q >= 0:
        return changes[order][own[c.v]][None]
    joint = m.joint_id(c.joint)
    v = own[m.model.idx_vs[joint] : m.model.idx_vs[joint] + m.model.nvs[joint]]
    state, first = at.state, m.model.idx_vs[joint]
    speeds, accels = (x[first : first + len(v)] for x in (state.v, state.a))
    dq, dv, da = (x[v] for x in changes)
    if len(v) == 6 and c.component < 3:
        rotation = m.model.idx_qs[joint] + 3
        turn = np.array(pin.Quaternion(state.q[rotation : rotation + 4]).matrix())
        u, w = speeds[:3], speeds[3:]
        parts = [dq[:3], dv[:3] + _cross(dq[3:], u),
                 da[:3] + _cross(dv[3:], u) + _cross(w, dv[:3])
                 + _cross(dq[3:], accels[:3] + _cross(w, u))]
        return (turn @ parts[order])[c.component][None]
    at_q = m.model.idx_qs[joint] + m.model.nqs[joint] - 4
    phi = rotation_vectors(state.q[None, at_q : at_q + 4])[0]
    changed = _rotation_vector(phi, speeds[-3:], accels[-3:], (dq[-3:], dv[-3:], da[-3:]))
    return changed[order][c.component % 3][None]


def _rotation_vector(
    phi: Array, omega: Array, alpha: Array, changes: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Return derivatives (3, m) of a rotation vector and its rates, from those of the rotation.

    With omega = J(phi) phi' and alpha = J(phi) phi'' + ..., J the derivative of the exponential.
    """
    (rate,), (accel,) = rotation_vector_rates(phi[None], omega[None], alpha[None])

    def slopes(k: int) -> tuple[Array, Array]:
        """Return derivatives (3, 3) of omega and alpha by phi, phi' or phi''."""
        given = [np.tile(x.astype(complex), (3, 1)) for x in (phi, rate, accel)]
        given[k] += COMPLEX_STEP * 1j * np.eye(3)
        spin = spin_of(*given)
        return spin[0].imag.T / COMPLEX_STEP, spin[1].imag.T / COMPLEX_STEP

    turn = np.linalg.inv(slopes(1)[0])
    dphi = turn @ changes[0]
    drate = turn @ (changes[1] - slopes(0)[0] @ dphi)
    return dphi, drate, turn @ (changes[2] - slopes(0)[1] @ dphi - slopes(1)[1] @ drate)


def _cross(a: Array, b: Array) -> Array:
    """Return a x b of a vector (3,) and vectors (3, m), in either order."""
    return skewed(a) @ b if a.ndim == 1 else -skewed(b) @ a


class _Point:
    """A point of a joint's body with its rates and their changes, world axes."""

    def __init__(self, moved: Moved, joint: int, point: Array, shifts: Array | None) -> None:
        bodies, changes = moved.at.bodies, moved.changes
        j = bodies.joints[joint]
        (v_q,), (a_q,), (a_v,), (own,) = bodies.by_motion(np.array([joint]))
        (back,) = bodies.to_bodies(np.array([j]))
        turn, origin = bodies.at[j, :3].T, bodies.at[j, 3]
        v, a = back @ bodies.v[j], back @ bodies.a[j]
        dx, dv = own @ changes.q, v_q @ changes.q + own @ changes.v
        da = a_q @ changes.q + a_v @ changes.v + own @ changes.a
        w, dw = v[3:], dv[3:]
        shift = np.zeros_like(dx[3:])
        if shifts is not None:
            shift[:] = shifts.T @ moved.dimensions
        speed = v[:3] + _cross(w, point)
        accel = (a[:3] + _cross(w, v[:3]) + _cross(a[3:], point)
                 + _cross(w, _cross(w, point)))
        self.rotation, self.turned = turn, dx[3:]
        self.values = [turn @ point + origin, turn @ speed, turn @ accel,
                       turn @ w, turn @ a[3:]]
        local = [
            dx[:3] + _cross(dx[3:], point) + shift,
            _cross(dx[3:], speed) + dv[:3] + _cross(dw, point) + _cross(w, shift),
            _cross(dx[3:], accel) + da[:3] + _cross(dw, v[:3]) + _cross(w, dv[:3])
            + _cross(da[3:], point) + _cross(a[3:], shift)
            + _cross(dw, _cross(w, point)) + _cross(w, _cross(dw, point) + _cross(w, shift)),
            _cross(dx[3:], w) + dw, _cross(dx[3:], a[3:]) + da[3:]]
        self.changes = [turn @ x for x in local]


POINT_KINDS = ("position", "velocity", "acceleration", "angular_velocity", "angular_acceleration")


def _frame(moved: Moved, name: str, kind: str, is_centre: bool) -> Array:
    """Return the derivatives (3, m) of a quantity of a frame; (9, m) of its rotation, by rows."""
    mechanism, geometry = moved.at.mechanism, moved.at.geometry
    joint, placement = mechanism.frame_on_joint(name)
    point, shifts = placement.translation, None
    if is_centre:
        point = placement.act(center_of_mass(moved.at.state.mechanism, name))
        if name in geometry.levers:
            shifts = geometry.levers[name] @ placement.rotation.T
    at = _Point(moved, joint, point, shifts)
    if kind != ROTATION:
        return at.changes[POINT_KINDS.index(kind)]
    columns = [at.rotation @ _cross(at.turned, x) for x in placement.rotation.T]
    return np.stack(columns, axis=1).reshape(9, -1)


def _angle(moved: Moved, angle: LinkAngle) -> Array:
    """Return the derivatives (1, m) of the angle of a link about an axis of the world."""
    frame = moved.at.mechanism.model.frames[angle.frame]
    at = _Point(moved, frame.parentJoint, np.zeros(3), None)
    arm = at.rotation @ frame.placement.rotation @ angle.arm
    along = float(angle.axis @ arm)
    turned = (angle.axis - along * arm) / (1.0 - along * along)
    return (turned @ at.rotation @ at.turned)[None]


def _of_whole(moved: Moved, kind: str) -> Array:
    """Return the derivatives (1 or 3, m) of the whole mass, or of the motion of its centre."""
    geometry, own = moved.at.geometry, moved.at.state.mechanism
    masses = geometry.inertias.reshape(len(geometry.inertias), own.model.njoints - 1, 10)[..., :4]
    d_mass = masses[..., 0].T @ moved.dimensions
    if kind == MASS:
        return d_mass.sum(axis=0)[None]
    total = moving_mass(own.model)
    points = []
    for joint, share, lever in mass_shares(own):
        # of the mass and its first moment, as the inertia's numbers have them
        changed = masses[:, joint - 1]
        shifts = (changed[:, 1:] - changed[:, :1] * lever) / own.model.inertias[joint].mass
        points.append((joint, share, _Point(moved, int(geometry.joint[joint]), lever, shifts)))
    k = POINT_KINDS.index(kind)
    centre = sum(share * at.values[k] for _, share, at in points)
    slopes: Array = sum(share * at.changes[k] + np.outer(at.values[k] - centre, d_mass[joint - 1])
                        / total for joint, share, at in points)
    return slopes


