"""The square systems of a branch, factored and solved for many configurations together."""

from __future__ import annotations

import numpy as np

from spatial_pin.constraints.stacked import Batch, Placed
from spatial_pin.continuation.branch import Branch
from spatial_pin.numerics.linalg import Array, StackedLU


class BranchBatch(Batch):
    """The square systems of a branch, its drivers and independent rows included."""

    def __init__(self, branch: Branch) -> None:
        super().__init__(branch.evaluation.constraints)
        self.branch = branch

    def factor(self, p: Placed) -> StackedLU:
        """Return the factored systems of rows, spins and drivers at configurations."""
        return StackedLU(self.branch.system.stack(self.jacobian(p)))

    def correction(self, p: Placed, lu: StackedLU) -> Array:
        """Return the joint displacements (nv, m) that close the loops, drivers held."""
        system = self.branch.system
        rhs = np.zeros((len(system.matrix), p.q.shape[1]))
        rhs[system.closure_rows] = -p.residual[system.rows]
        return self.branch.scale[:, None] * lu.solve(rhs)

    def spinning(self, lu: StackedLU, spins: Array) -> Array:
        """Return joint displacements (nv, m) that spin the passive freedoms by (n_passive, m)."""
        system = self.branch.system
        rhs = np.zeros((len(system.matrix), spins.shape[1]))
        rhs[system.spin_rows] = spins
        return self.branch.scale[:, None] * lu.solve(rhs)

    def path_rates(self, p: Placed, lu: StackedLU) -> tuple[Array, Array, Array, Array]:
        """Return dq/ds and d²q/ds² (nv, m) for the driver s, and the bodies' rates of `bias`."""
        system, scale = self.branch.system, self.branch.scale[:, None]
        m = p.q.shape[1]
        t = scale * lu.solve(np.broadcast_to(self.branch.unit[:, None], (len(scale), m)))
        bias, first, second = self.bias(p, t)
        rhs = np.zeros((len(system.matrix), m))
        system.put_bias(rhs.T, bias.T)
        return t, scale * lu.solve(rhs), first, second
