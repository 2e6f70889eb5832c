"""Coordinates of joints against Pinocchio's configuration and velocity vectors.

Joints whose velocity is the derivative of their coordinates are read straight from q, v, a. The
orientation of spherical and floating joints is a rotation vector phi from the URDF zero pose, with
body angular velocity omega = Jr(phi) phi' and Jr(phi) = 1 - B [phi] + C [phi]^2,
B = (1 - cos t)/t^2, C = (t - sin t)/t^3, t = |phi| [Chirikjian2011, 10.86].
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import brief
from spatial_pin._support.checks import as_array, finite_array, finite_number
from spatial_pin._support.lazy import made_once
from spatial_pin.errors import MechanismFileError, SpatialPinError, UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import EPS, Array, pseudo_inverses, whole_turns
from spatial_pin.numerics.tolerances import TOLERANCES

Numbers = TypeVar("Numbers", float, Array)
FACTORIALS = np.array([  # of 2, 4, ..., 16
    2, 24, 720, 40320, 3628800, 479001600, 87178291200, 20922789888000.0])


def require_mechanism(mechanism: object) -> None:
    """Refuse an argument that is no Mechanism with a TypeError that says how to get one."""
    if not isinstance(mechanism, Mechanism):
        raise TypeError(f"a Mechanism is needed, not {str(mechanism)[:40]!r} of type "
                        f"{type(mechanism).__name__}: sp.load(...) makes one")


class CoordinateRates(NamedTuple, Generic[Numbers]):
    """Value, rate and acceleration of one coordinate: floats of a State, (N,) of a Motion.

    Attributes:
        value: [rad or m].
        rate: [rad/s or m/s].
        acceleration: [rad/s² or m/s²].

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
        >>> value, rate, acceleration = state.coordinate("rocker_pin")
        >>> print(f"{value:.4f} rad, {rate:.4f} rad/s, {acceleration:.2f} rad/s²")
        1.6255 rad, 1.9351 rad/s, 50.16 rad/s²
    """

    value: Numbers
    rate: Numbers
    acceleration: Numbers

    def __repr__(self) -> str:  # type: ignore[misc]  # of a generic tuple
        if isinstance(self.value, np.ndarray):
            return brief(self)
        return (f"CoordinateRates(value={self.value!r}, rate={self.rate!r}, "
                f"acceleration={self.acceleration!r})")


def coordinate_round_off(mechanism: Mechanism, q: Array) -> float:
    """Return the closure error that round-off of coordinates, as of many turns, may leave [-]."""
    entries, each = _round_off(mechanism)
    return float(np.abs(q[entries] * each).max(initial=0.0))


@made_once
def _round_off(mechanism: Mechanism) -> tuple[NDArray[np.intp], Array]:
    """Return the indices in q of coordinates, and the relative round-off of each."""
    at = [(index, c.v) for c in mechanism.coordinate_table.values()
          if (index := mechanism.index_of(c)) >= 0]
    entries, v_at = np.array(at, dtype=np.intp).reshape(-1, 2).T
    return entries, 4.0 * EPS / mechanism.velocity_scale[v_at]


@made_once
def by_joint(mechanism: Mechanism) -> dict[str, list[Coordinate]]:
    """Return the coordinates of every joint."""
    by_joint: dict[str, list[Coordinate]] = {}
    for c in mechanism.coordinate_table.values():
        by_joint.setdefault(c.joint, []).append(c)
    return by_joint


def coordinates_of(mechanism: Mechanism, joint: str) -> list[Coordinate]:
    """Return the coordinates of a joint, none if there is no such joint."""
    return [*by_joint(mechanism).get(joint, ())]


@made_once
def driver_coordinates(mechanism: Mechanism) -> dict[str, Coordinate]:
    """Return the coordinate of every driver, by its name."""
    return {d.name: mechanism.prescribed_coordinate(d.joint) for d in mechanism.drivers.values()}


def joint_values(mechanism: Mechanism, guess: Mapping[str, Any]) -> dict[str, float]:
    """Return the named coordinate values of a guess keyed by joint, coordinate or driver.

    Raises:
        UnknownNameError: a key names nothing of the mechanism.
        ValueError: a value is no finite number, or a joint has another number of coordinates.
    """
    values: dict[str, float] = {}
    joints = by_joint(mechanism)
    for key, value in guess.items():
        if key in joints:
            coordinates = joints[key]
            if len(coordinates) == 1 and type(value) is float:
                values[coordinates[0].name] = finite_number(value, f"{key!r}")
                continue
            shape = () if len(coordinates) == 1 else (len(coordinates),)
            if isinstance(value, str | bool) or (
                isinstance(value, list | tuple) and any(isinstance(x, str | bool) for x in value)
            ):
                raise ValueError(f"{key!r} must be a number, not {value!r}")
            if as_array(value, f"{key!r}").shape != shape:
                parts = [c.name.removeprefix(f"{key}.") for c in coordinates]
                needed = "a number" if len(parts) == 1 else f"[{', '.join(parts)}]"
                raise ValueError(
                    f"{key!r} is {mechanism.pair_of(key)}: give {needed}, not {value!r}")
            numbers = np.atleast_1d(finite_array(value, shape, f"{key!r}"))
            values.update({c.name: float(x) for c, x in zip(coordinates, numbers, strict=True)})
        elif key in mechanism.coordinate_table or key in mechanism.drivers:
            name = mechanism.prescribed_coordinate(key).name
            values[name] = finite_number(value, f"{key!r}")
        else:
            raise UnknownNameError("joint, coordinate or driver", key,
                                   [*joints, *mechanism.coordinate_table, *mechanism.drivers])
    return values


def check_guess(mechanism: Mechanism, where: str, guess: Mapping[str, Any] | None = None) -> None:
    """Refuse a guess, by default the mechanism's; `where` is the file for the error."""
    try:
        joint_values(mechanism, mechanism.guess if guess is None else guess)
    except (SpatialPinError, ValueError) as error:
        raise MechanismFileError(f"{where}: guess: {error}") from error


def with_values(mechanism: Mechanism, q: Array, values: Mapping[str, float]) -> Array:
    """Return a copy of `q` (nq,) with the named coordinates set."""
    q = np.array(q, dtype=np.float64)
    components: dict[str, dict[int, float]] = {}
    for name, value in values.items():
        c = mechanism.coordinate_table[name]
        if c.q >= 0:
            q[c.q] = value
        else:
            components.setdefault(c.joint, {})[c.component] = value
    for joint, given in components.items():
        i = mechanism.joint_id(joint)
        at, n = mechanism.model.idx_qs[i], mechanism.model.nvs[i]
        vector = np.empty(n) if len(given) == n else joint_vector(mechanism, q, joint)
        vector[list(given)] = list(given.values())
        if vector.size == 6:
            q[at : at + 3], at = vector[:3], at + 3
        q[at : at + 4] = pin.Quaternion(pin.exp3(vector[-3:])).coeffs()
    return q


def joint_vector(mechanism: Mechanism, q: Array, joint: str) -> Array:
    """Return the coordinates of one joint as a vector (rotation vector of length up to pi)."""
    i = mechanism.joint_id(joint)
    at, n = mechanism.model.idx_qs[i], mechanism.model.nqs[i]
    if PAIRS[mechanism.pairs[i - 1]].is_linear:
        return q[at : at + n].copy()
    return np.concatenate([q[at : at + n - 4], rotation_vector(q[at + n - 4 : at + n])])


def coordinate_rates(
    mechanism: Mechanism, name: str, q: Array, v: Array, a: Array, *, continued: bool = True
) -> CoordinateRates[Array]:
    """Return value, rate and acceleration of a coordinate over samples q (N, nq), v, a (N, nv).

    Rotation vectors are continued from sample to sample, past pi and past whole turns; samples that
    have nothing to do with each other (not `continued`) get vectors of length up to pi.
    """
    c = mechanism.coordinate(name)
    if c.q >= 0:
        return CoordinateRates(q[:, c.q].copy(), v[:, c.v].copy(), a[:, c.v].copy())
    i = mechanism.joint_id(c.joint)
    at, n, iv = mechanism.model.idx_qs[i], mechanism.model.nqs[i], mechanism.model.idx_vs[i]
    quaternions = q[:, at + n - 4 : at + n]
    if n == 7 and c.component < 3:
        from scipy.spatial.transform import Rotation

        rotation = Rotation.from_quat(quaternions.copy())  # SciPy refuses read-only arrays
        moves, spins = v[:, iv : iv + 3], v[:, iv + 3 : iv + 6]
        rate = rotation.apply(moves.copy())
        acceleration = rotation.apply(a[:, iv : iv + 3] + np.cross(spins, moves))
        return CoordinateRates(q[:, at + c.component].copy(), rate[:, c.component],
                               acceleration[:, c.component])
    k = c.component % 3
    w = slice(iv + 3, iv + 6) if n == 7 else slice(iv, iv + 3)
    phi = (continued_rotation_vectors if continued else rotation_vectors)(quaternions)
    rate, acceleration = rotation_vector_rates(phi, v[:, w], a[:, w])
    return CoordinateRates(phi[:, k], rate[:, k], acceleration[:, k])


def coordinate_value(mechanism: Mechanism, coordinate: Coordinate, q: Array) -> float:
    """Return a coordinate at q (nq,) [rad or m]; of a rotation vector of length up to pi."""
    index = mechanism.index_of(coordinate)
    if index >= 0:
        return float(q[index])
    return float(joint_vector(mechanism, q, coordinate.joint)[coordinate.component])


def coordinate_gradient(mechanism: Mechanism, coordinate: Coordinate, q: Array) -> Array:
    """Return the derivative (nv,) of a coordinate's value with respect to joint velocities."""
    row = np.zeros(mechanism.model.nv)
    if coordinate.q >= 0:
        row[coordinate.v] = 1.0
        return row
    i = mechanism.joint_id(coordinate.joint)
    at = slice(mechanism.model.idx_vs[i], mechanism.model.idx_vs[i] + mechanism.model.nvs[i])
    units = np.eye(mechanism.model.nv)[at]
    here = np.repeat(q[None], len(units), axis=0)
    row[at] = coordinate_rates(mechanism, coordinate.name, here, units, 0.0 * units,
                               continued=False).rate
    return row


def coordinate_curvature(mechanism: Mechanism, coordinate: Coordinate, q: Array) -> Array:
    """Return the derivatives (nv, nv) of a coordinate's gradient along joint velocities.

    The symmetric part is that of its second derivatives at constant velocities; the other follows
    from the commutator of turns about body axes [Chirikjian2011, 10.86].
    """
    nv = mechanism.model.nv
    curvature = np.zeros((nv, nv))
    if coordinate.q >= 0:
        return curvature
    i = mechanism.joint_id(coordinate.joint)
    own = np.arange(mechanism.model.idx_vs[i], mechanism.model.idx_vs[i] + mechanism.model.nvs[i])
    units, n = np.eye(nv)[own], len(own)
    moving = (units[:, None] + units[None]).reshape(-1, nv)
    bent = coordinate_rates(mechanism, coordinate.name, np.repeat(q[None], n * n, axis=0), moving,
                            0.0 * moving, continued=False).acceleration.reshape(n, n)
    alone = 0.25 * np.diag(bent)
    row = np.zeros(6)
    row[6 - n :] = coordinate_gradient(mechanism, coordinate, q)[own]
    twists = [pin.Motion(x) for x in np.eye(6)[6 - n :]]
    turned = np.array([[row @ b.cross(a).vector for b in twists] for a in twists])
    curvature[np.ix_(own, own)] = 0.5 * (bent - alone[:, None] - alone + turned)
    return curvature


def rotation_vector(quaternion: Array) -> Array:
    """Return the rotation vector (3,), of length up to pi, of a quaternion (4,).

    To the last digits near half a turn too, where `pin.log3` of the matrix loses three.
    """
    return np.array(rotation_components(*quaternion.tolist()))


def rotation_components(x: float, y: float, z: float, w: float) -> list[float]:
    """Return `rotation_vector` of plain numbers."""
    sine = math.hypot(x, y, z)
    factor = math.copysign(2.0 * math.atan2(sine, abs(w)) / sine if sine else 2.0, w)
    return [factor * x, factor * y, factor * z]


def rotation_vectors(quaternions: Array) -> Array:
    """Return rotation vectors (N, 3), of length up to pi, of quaternions (N, 4)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternions.copy()).as_rotvec()


def continued_rotation_vectors(quaternions: Array) -> Array:
    """Return rotation vectors (N, 3) of quaternions (N, 4), each the one nearest to the last."""
    phi = rotation_vectors(quaternions)
    angles = np.linalg.norm(phi[1:], axis=1)
    along = np.vecdot(phi[1:], phi[:-1]) / np.maximum(angles, TOLERANCES.tight)
    turns = whole_turns(along - angles)
    odd = np.flatnonzero((angles <= TOLERANCES.tight) | (turns != 0.0))
    for i in range(1 + int(odd[0]) if odd.size else len(phi), len(phi)):
        angle = float(np.linalg.norm(phi[i]))
        before = phi[i - 1]
        if angle > TOLERANCES.tight:
            axis = phi[i] / angle
            phi[i] += whole_turns(axis @ before - angle) * axis
        elif before.any():  # a whole number of turns: the axis is that of the sample before
            length = float(np.linalg.norm(before))
            phi[i] = whole_turns(length) * before / length
    return phi


def rotation_vector_rates(phi: Array, omega: Array, alpha: Array) -> tuple[Array, Array]:
    """Return phi', phi'' (N, 3) from body angular velocity and acceleration (N, 3)."""
    jacobian, functions = _jacobian(phi)
    # at whole turns the vector only tells the spin about its axis: least norm
    inverse = pseudo_inverses(jacobian, TOLERANCES.rank)
    rate = (inverse @ omega[..., None])[..., 0]
    bias = _spin_bias(phi, rate, functions)
    acceleration = (inverse @ (alpha - bias)[..., None])[..., 0]
    return rate, acceleration


def spin_of(phi: Array, rate: Array, acceleration: Array) -> tuple[Array, Array]:
    """Return body angular velocity and acceleration (N, 3) from phi, phi', phi'' (N, 3)."""
    jacobian, functions = _jacobian(phi)
    turned = (jacobian @ np.stack([rate, acceleration], axis=2)).transpose(2, 0, 1)
    return turned[0], turned[1] + _spin_bias(phi, rate, functions)


def _jacobian(phi: Array) -> tuple[Array, tuple[Array, Array, Array, Array]]:
    """Return Jr(phi) (N, 3, 3), and the functions that it is made of."""
    t2 = np.sum(phi * phi, axis=1)
    small = t2 < 1e-2  # B, C and their derivatives with respect to t^2, by series there
    s = np.where(small, 1.0, t2)
    t = np.sqrt(s)
    sin, cos = np.sin(t), np.cos(t)
    k = np.arange(8)
    powers = np.where(small, t2, 0.0)[:, None] ** k
    fb = (-1.0) ** k / FACTORIALS
    fc = fb / (2 * k + 3)
    b = np.where(small, powers @ fb, (1.0 - cos) / s)
    c = np.where(small, powers @ fc, (t - sin) / (s * t))
    db = np.where(small, powers[:, :-1] @ (fb[1:] * k[1:]),
                  (t * sin - 2.0 * (1.0 - cos)) / (2.0 * s * s))
    dc = np.where(small, powers[:, :-1] @ (fc[1:] * k[1:]),
                  (3.0 * sin - t * (2.0 + cos)) / (2.0 * s * s * t))
    skew = np.cross(np.eye(3)[None], phi[:, None])  # skew @ x = phi × x
    return np.eye(3) - b[:, None, None] * skew + c[:, None, None] * (skew @ skew), (b, c, db, dc)


def _spin_bias(phi: Array, rate: Array, functions: tuple[Array, Array, Array, Array]) -> Array:
    """Return Jr(phi)' phi' (N, 3)."""
    _, c, db, dc = functions
    dt = 2.0 * np.sum(phi * rate, axis=1)
    u = np.cross(phi, rate)
    return (-(db * dt)[:, None] * u + (dc * dt)[:, None] * np.cross(phi, u)
            + c[:, None] * np.cross(rate, u))
