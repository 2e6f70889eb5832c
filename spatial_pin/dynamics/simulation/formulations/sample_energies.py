"""Energies, closure errors and screw angles of many rows together."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.constraints.stacked import Batch, Placed
from spatial_pin.constraints.vectorised_tree import dot
from spatial_pin.dynamics.forces import Line
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.numerics.linalg import Array

CHUNK = 512  # rows that are computed together: their arrays fit a processor's cache


class PlacedRows:
    """Energy and closure of a mechanism at many configurations.

    Args:
        problem: what acts.
        evaluation: its closure equations.
    """

    def __init__(self, problem: Problem, evaluation: Evaluation) -> None:
        self.problem, self.evaluation = problem, evaluation
        self._batch: Batch | None = None

    def __call__(self, q: Array, v: Array, near: Array) -> tuple[Array, Array, Array]:
        """Return energies [J] (N,), largest closure rows [-] (N,) and screw angles (N, n_angles).

        Args:
            q: (N, nq) configurations.
            v: (N, nv) velocities.
            near: (N, n_angles) the angles of screw closures, roughly.
        """
        if not isinstance(self.evaluation.constraints.c_abx, np.ndarray):
            return self._one_by_one(q, v, near)
        if self._batch is None:
            self._batch = Batch(self.evaluation.constraints)
        parts = [self._part(self._batch, q[k : k + CHUNK], v[k : k + CHUNK], near[k : k + CHUNK])
                 for k in range(0, len(q), CHUNK)]
        energy, error, angles = (np.concatenate(part) for part in zip(*parts, strict=True))
        return energy, error, angles

    def _part(self, batch: Batch, q: Array, v: Array, near: Array) -> tuple[Array, Array, Array]:
        placed = batch.place(np.ascontiguousarray(q.T), near.T)
        error = np.abs(placed.residual).max(axis=0, initial=0.0)
        model, data, kinetic = self.problem.model, self.problem.data, self.problem.kinetic
        energy = np.array([  # the kinetic energy leaves the placements for the potential one
            kinetic(*row, data) + pin.computePotentialEnergy(model, data)
            for row in zip(q, v, strict=True)])
        for line in self.problem.forces.lines:
            if line.energy:
                energy += [line.energy(x) for x in _lengths(batch, placed, line).tolist()]
        for turn in self.problem.forces.turns:
            if turn.energy:
                energy += [turn.energy(x) for x in q[:, turn.q].tolist()]
        return energy, error, placed.angles.T

    def _one_by_one(self, q: Array, v: Array, near: Array) -> tuple[Array, Array, Array]:
        evaluation, found = self.evaluation, []
        for row, rates, angles in zip(q, v, near, strict=True):
            evaluation.turns[:] = angles
            evaluation.update(row)
            found.append((self.problem.energy(row, rates, evaluation), evaluation.closure_error,
                          evaluation.angles.copy()))
        energy, error, turned = zip(*found, strict=True)
        return np.array(energy), np.array(error), np.array(turned)


def _lengths(batch: Batch, placed: Placed, line: Line) -> Array:
    """Return the lengths (m,) of a spring."""
    first, second = (np.einsum("k,kxm->xm", point, placed.g[batch.tree.carrier[body]])
                     for body, point in zip(line.bodies, line.points, strict=True))
    return np.sqrt(dot(second - first, second - first))
