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
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.kernel.loop_equations import LoopEquations, loops_at
from spatial_pin.mechanism.resistance import resists
from spatial_pin.numerics.linalg import Array, null_space
from spatial_pin.numerics.tolerances import TOLERANCES

FREE_SPIN = 1e-9  # closure equations, per unit of spin, that do not hold it
SPIN_TRIALS = 3  # other configurations at which the spin must be free too


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
    it beside its line. Forces from outside may turn it.
    """
    mechanism = problem.mechanism
    if "spherical" not in mechanism.pairs or problem.external:
        return []
    evaluation = loops_at(mechanism, state.q, state.angles)
    freedoms = null_space(evaluation.jacobian[: evaluation.constraints.n_closure])
    if len(freedoms) < 2:
        return []
    found, groups = [], driven_groups(mechanism)
    for name, velocities in passive_freedoms(evaluation, freedoms * problem.scale):
        is_one_body = groups.count(groups[mechanism.joint_id(name)]) == 1
        if len(velocities) == 1 and mechanism.pair_of(name) == "spherical" and is_one_body:
            joint = mechanism.joint_id(name)
            at, iq = problem.model.idx_vs[joint], problem.model.idx_qs[joint]
            v = slice(at, at + 3)
            size = float(np.linalg.norm(velocities[0, v]))
            fastest = float(np.abs(velocities[0] / problem.scale).max())
            if size > FREE_SPIN * fastest:  # else others turn
                found.append(Spinning(joint, slice(iq, iq + 4), v, velocities[0, v] / size))
    found = [body for body in found if _is_symmetric(problem, body)]
    return found if _are_free_nearby(evaluation, state.q, found) else []


def _is_symmetric(problem: Problem, body: Spinning) -> bool:
    """Whether neither inertia nor forces depend on how a body is turned about its line."""
    model, u = problem.model, body.axis
    inertia = model.inertias[body.joint]
    size = problem.mechanism.characteristic_length
    if resists(problem.mechanism, body.joint):
        return False
    if body.joint in list(model.parents) or _off_line(u, inertia.lever) > TOLERANCES.tight * size:
        return False
    moments = inertia.inertia
    along = float(u @ moments @ u)
    across = 0.5 * (float(np.trace(moments)) - along)
    round_one = across * np.eye(3) + (along - across) * np.outer(u, u)
    if np.abs(moments - round_one).max() > TOLERANCES.tight * max(np.abs(moments).max(), 1e-300):
        return False
    return all(_off_line(u, point[:3]) <= TOLERANCES.tight * size for line in problem.forces.lines
               for joint, point in zip(line.bodies, line.points, strict=True)
               if joint == body.joint)


def _off_line(u: Array, point: Array) -> float:
    return float(np.linalg.norm(point - (point @ u) * u))


def _are_free_nearby(evaluation: LoopEquations, q: Array, bodies: list[Spinning]) -> bool:
    """Whether the spins are free at other closed configurations too."""
    model, n = evaluation.model, evaluation.constraints.n_closure
    rng, free = np.random.default_rng(7), np.ones(model.nv, dtype=bool)
    for _ in range(SPIN_TRIALS if bodies else 0):
        step = evaluation.mechanism.velocity_scale * rng.uniform(-0.1, 0.1, model.nv)
        _, error = close(evaluation, pin.integrate(model, q, step), free, 1e-13)
        held = [np.abs(evaluation.jacobian[:n, b.v] @ b.axis).max(initial=0.0) for b in bodies]
        if error > 1e-11 or max(held) > FREE_SPIN:
            return False
    return True


class Spins:
    """Spins of bodies on a branch.

    Args:
        problem: what is simulated.
        bodies: those that spin freely.
    """

    def __init__(self, problem: Problem, bodies: list[Spinning]) -> None:
        self._model, self.bodies = problem.model, bodies
        self.rows = np.zeros((len(bodies), problem.model.nv))
        for row, body in zip(self.rows, bodies, strict=True):
            row[body.v] = body.axis

    def __len__(self) -> int:
        return len(self.bodies)

    def rates(self, q: Array, v: Array) -> list[float]:
        """Return sigma of every body [rad/s], at q (nq,) and v (nv,)."""
        if not self.bodies:
            return []
        data = self._model.createData()
        pin.forwardKinematics(self._model, data, q, v)
        return [float(body.axis @ data.v[body.joint].angular) for body in self.bodies]
