"""Freedoms of closed loops under forces: those that move one link only, and idle rotations."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from spatial_pin.assembly.passive_freedoms import is_in_loop, passive_freedoms
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.dynamics.solvers.equations_of_motion import Equations
from spatial_pin.dynamics.solvers.independent_coordinates import ROUNDING
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.mobility.idle_freedoms import idle_freedoms
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES


def of_one_link(
    equations: Equations, freedoms: Array, actuated: Iterable[Coordinate] | None = None
) -> list[tuple[str, Array]]:
    """Return (joint, (k, nv)), the scaled motions among freedoms (n, nv) that move one link only.

    Actuators, by default the drivers, are at rest in the freedoms.
    """
    scale = equations.scale
    found = passive_freedoms(equations.evaluation, freedoms * scale, actuated)
    return [(joint, motions / scale) for joint, motions in found]


def idle_among(equations: Equations, found: list[tuple[str, Array]]) -> Array:
    """Return the idle rotations (k, nv) among motions of one link, from `of_one_link`.

    They turn a link of a loop and move no centre of mass.
    """
    evaluation, mechanism, scale = equations.evaluation, equations.mechanism, equations.scale
    idle = [np.zeros((0, len(scale)))]
    for joint, motions in found:
        if is_in_loop(mechanism, joint):
            heavy, levers = equations.bodies.centres
            columns = joint_jacobian(evaluation.data, len(scale))
            twists = ((columns * evaluation.constraints.supports[heavy][:, None])
                      @ (motions * scale).T)
            centres = (levers[:, None] @ evaluation.placements[heavy])[:, 0]
            shifts = twists[:, :3] + np.cross(twists[:, 3:], centres[:, :, None], axis=1)
            svd = decompose(
                shifts.reshape(-1, len(motions)) / mechanism.characteristic_length)
            moved = svd.s > TOLERANCES.half_precision * np.abs(motions).max()
            idle.append(svd.vt[np.count_nonzero(moved) :] @ motions)
    return np.vstack(idle)


def passive_among(equations: Equations, freedoms: Array, held: Iterable[int]) -> Array:
    """Return the passive motions (k, nv) of single links among freedoms (n, nv), orthonormal.

    They turn or slide a link along an axis of its own, with or without its centre of mass; the
    velocities `held`, by their places, stand still in them.
    """
    found = idle_freedoms(LoopEquations(equations.mechanism), equations.state.q, held)
    return np.vstack([freedoms[:0], *(motions / equations.scale @ freedoms.T @ freedoms
                                      for _, motions in found)])


def active_among(equations: Equations, freedoms: Array, found: list[tuple[str, Array]]) -> Array:
    """Return the freedoms (k, nv) orthogonal to those of one link."""
    passive = np.vstack([np.zeros((0, len(equations.scale))), *(motions for _, motions in found)])
    return decompose(passive @ freedoms.T).null_space @ freedoms


def round_off(equations: Equations, a: Array) -> float:
    """Return the round-off of scaled forces at accelerations a (nv,) [N·m]."""
    state, scale, model = equations.state, equations.scale, equations.model
    weight = sum(i.mass for i in model.inertias) * float(
        np.linalg.norm(model.gravity.linear)) * equations.mechanism.characteristic_length
    heaviest = float(np.abs(scale[:, None] * equations.mass() * scale).max(initial=0.0))
    rates = float(np.abs(a / scale).max(initial=0.0))
    rates += float(np.abs(state.v / scale).max(initial=0.0)) ** 2
    return ROUNDING * (weight + heaviest * rates)
