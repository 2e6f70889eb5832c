"""Bodies that spin freely about a line of their own: their spin is known without integrating it.

A body that is symmetric about the line through its two ball joints (u, fixed in the body) keeps
the angular velocity about it, and the rest of the mechanism does not feel how it is turned about
it [Routh1905; Goldstein2002, 5.7]. With sigma that angular velocity, d = R u the line, R the body's
rotation relative to the one before it, all seen from there, and w(s) the relative angular velocity
per unit of the coordinate s at which the body has no spin,

    R' = [w s' + sigma d] R,      omega = R^T w s' + sigma u  in the body's own axes.

d and w are functions of s alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close
from spatial_pin.assembly.passive_freedoms import driven_groups, passive_freedoms
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.solvers.least_constraint import cross
from spatial_pin.mechanism.resistance import resists
from spatial_pin.numerics.linalg import Array, null_space

SAME = 1e-12  # difference of moments of inertia, and distance from the line, that is none
FREE = 1e-9  # closure rows, per unit of spin, that do not hold it
TRIALS = 3  # other configurations at which the spin must be free too


class Spinning(NamedTuple):
    """A body that spins freely about a line of its own.

    Attributes:
        joint: index of the ball joint that carries it.
        q, v: where that stands in configuration and velocity.
        axis: (3,) unit vector of the line in the body's axes; it passes the joint's centre.
    """

    joint: int
    q: slice
    v: slice
    axis: Array


def spinning_bodies(problem: Problem, state: State) -> list[Spinning]:
    """Return the bodies that spin freely, symmetric about their lines.

    Each is carried by a ball joint that does not resist, carries none itself, and no spring holds
    it beside its line.
    """
    mechanism = problem.mechanism
    evaluation = Evaluation(constraints_of(mechanism))
    evaluation.turns[:] = state.angles
    evaluation.update(state.q)
    freedoms = null_space(evaluation.jacobian[: evaluation.constraints.n_rows])
    if len(freedoms) < 2 or "spherical" not in mechanism.pairs:
        return []
    found, groups = [], driven_groups(mechanism)
    for name, velocities in passive_freedoms(evaluation, freedoms * problem.scale):
        is_one_body = groups.count(groups[mechanism.joint_id(name)]) == 1
        if len(velocities) == 1 and mechanism.pair_of(name) == "spherical" and is_one_body:
            joint = mechanism.joint_id(name)
            at, iq = problem.model.idx_vs[joint], problem.model.idx_qs[joint]
            v = slice(at, at + 3)
            size = float(np.linalg.norm(velocities[0, v]))
            if size > FREE * float(np.abs(velocities[0] / problem.scale).max()):  # else others turn
                found.append(Spinning(joint, slice(iq, iq + 4), v, velocities[0, v] / size))
    found = [body for body in found if _is_symmetric(problem, body)]
    return found if _stay_free(evaluation, state.q, found) else []


def _is_symmetric(problem: Problem, body: Spinning) -> bool:
    """Whether neither inertia nor forces tell how a body is turned about its line."""
    model, u = problem.model, body.axis
    inertia = model.inertias[body.joint]
    size = problem.mechanism.characteristic_length
    if resists(problem.mechanism, body.joint):
        return False
    if body.joint in list(model.parents) or _beside(u, inertia.lever) > SAME * size:
        return False
    moments = inertia.inertia
    along = float(u @ moments @ u)
    across = 0.5 * (float(np.trace(moments)) - along)
    round_one = across * np.eye(3) + (along - across) * np.outer(u, u)
    if np.abs(moments - round_one).max() > SAME * max(np.abs(moments).max(), 1e-300):
        return False
    return all(_beside(u, point[:3]) <= SAME * size for line in problem.forces.lines
               for joint, point in zip(line.bodies, line.points, strict=True)
               if joint == body.joint)


def _beside(u: Array, point: Array) -> float:
    return float(np.linalg.norm(point - (point @ u) * u))


def _stay_free(evaluation: Evaluation, q: Array, bodies: list[Spinning]) -> bool:
    """Whether the spins are free at other closed configurations too."""
    model, n = evaluation.model, evaluation.constraints.n_rows
    rng, free = np.random.default_rng(7), np.ones(model.nv, dtype=bool)
    for _ in range(TRIALS if bodies else 0):
        step = evaluation.mechanism.velocity_scale * rng.uniform(-0.1, 0.1, model.nv)
        _, error = close(evaluation, pin.integrate(model, q, step), free, 1e-13)
        held = [np.abs(evaluation.jacobian[:n, b.v] @ b.axis).max(initial=0.0) for b in bodies]
        if error > 1e-11 or max(held) > FREE:
            return False
    return True


class Spins:
    """Spins of bodies on a branch, and what the branch's functions are without them.

    Args:
        problem: what is simulated.
        bodies: those that spin freely.
    """

    def __init__(self, problem: Problem, bodies: list[Spinning]) -> None:
        self.model, self.data, self.bodies = problem.model, problem.model.createData(), bodies
        self.rows = np.zeros((len(bodies), self.model.nv))
        for row, body in zip(self.rows, bodies, strict=True):
            row[body.v] = body.axis

    def __len__(self) -> int:
        return len(self.bodies)

    def rates(self, q: Array, v: Array) -> list[float]:
        """Return sigma of every body [rad/s], at q (nq,) and v (nv,)."""
        pin.forwardKinematics(self.model, self.data, q, v)
        return [float(body.axis @ self.data.v[body.joint].angular) for body in self.bodies]

    def without(self, q: Array, t: Array, c: Array) -> tuple[Array, Array]:
        """Return dq/ds and d²q/ds² (nv,) of a branch on which no body spins."""
        t, c = t.copy(), c.copy()
        pin.forwardKinematics(self.model, self.data, q, t, c)
        for body in self.bodies:
            u, v = body.axis, body.v
            spin = float(u @ self.data.v[body.joint].angular)
            c[v] += spin * cross(u, t[v]) - float(u @ self.data.a[body.joint].angular) * u
            t[v] -= spin * u
        return t, c

    def put(self, q: Array, t: Array, c: Array) -> tuple[Array, Array, Array]:
        """Return q, t and c with (d, 0), w and dw/ds in the places of the ball joints."""
        q, t, c = q.copy(), t.copy(), c.copy()
        for body in self.bodies:
            rotation = _rotation(q[body.q])
            q[body.q] = [*(rotation @ body.axis), 0.0]
            t[body.v], c[body.v] = rotation @ t[body.v], rotation @ c[body.v]
        return q, t, c

    def turning(self, functions: list[float], rate: float, sigmas: list[float],
                quaternions: list[float]) -> list[float]:
        """Return the derivatives of the quaternions x, y, z, w of all bodies, one after the other.

        Args:
            functions: w and d of every body.
            rate: ds/dt.
            sigmas: of every body [rad/s].
            quaternions: of every body.
        """
        found: list[float] = []
        for k, sigma in enumerate(sigmas):
            wx, wy, wz, dx, dy, dz = functions[6 * k : 6 * k + 6]
            x, y, z, w = quaternions[4 * k : 4 * k + 4]
            a = 0.5 * (wx * rate + sigma * dx)
            b = 0.5 * (wy * rate + sigma * dy)
            c = 0.5 * (wz * rate + sigma * dz)
            found += [a * w + b * z - c * y, b * w + c * x - a * z, c * w + a * y - b * x,
                      -a * x - b * y - c * z]
        return found

    def restore(
        self, q: Array, quaternions: Array, v: Array, a: Array, sigmas: list[float]
    ) -> None:
        """Take d, w s' and its derivative out of q, v and a, and put what the joints have there.

        The integrated quaternions are turned by the shortest way to have the line where it is.
        """
        for k, body in enumerate(self.bodies):
            d, u = q[body.q][:3], body.axis
            integrated = pin.Quaternion(quaternions[4 * k : 4 * k + 4])
            integrated.normalize()
            way = pin.Quaternion.FromTwoVectors(integrated.toRotationMatrix() @ u, d)
            quaternion = way * integrated
            quaternion.normalize()
            back = quaternion.toRotationMatrix().T
            q[body.q] = quaternion.coeffs()
            omega = back @ v[body.v]
            v[body.v] = omega + sigmas[k] * u
            a[body.v] = back @ a[body.v] - sigmas[k] * cross(u, omega)


def _rotation(quaternion: Array) -> Array:
    rotation: Array = pin.Quaternion(quaternion).toRotationMatrix()
    return rotation
