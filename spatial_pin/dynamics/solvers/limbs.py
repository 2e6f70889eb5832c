"""What no loop is built on: articulated-body algorithm [Featherstone2008, 7.3].

Such joints are eliminated, from the tips inwards, at a cost in proportion to their number. What is
left, the core, has a KKT system as if its bodies had articulated inertias; an open tree has none.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.kernel_tree import KernelTree
from spatial_pin.dynamics.solvers.bodies import both_halves
from spatial_pin.kernel.kkt import KKT
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import EPS

LEAST_ERROR = 16.0 * EPS  # of accelerations: of their forces, rounded some times


class Limbs:
    """The joints of a mechanism that no loop is built on, and the core that is left.

    Args:
        mechanism: the mechanism.

    Attributes:
        exist: whether there are such joints.
        a: (nv,) accelerations that were found last.
        error: their estimated round-off, relative to the largest.
        kkt: of the core, None of an open tree.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism, model = mechanism, mechanism.model
        tied, is_core = constraints_of(mechanism).tied, np.zeros(model.njoints, bool)
        for joint, (first, n) in enumerate(zip(model.idx_vs, model.nvs, strict=True)):
            is_core[joint] = joint > 0 and tied[first : first + n].any()
        self._tree = KernelTree(model, mechanism.velocity_scale, is_core)
        self._open = np.flatnonzero(~self._tree.is_core)
        self.exist = bool(len(self._open))
        self.a, self._needed, self._force = np.zeros((3, model.nv))
        self._scale, self.error = mechanism.velocity_scale, 0.0
        self._rounding = EPS * np.random.default_rng(0).choice([-1.0, 1.0], model.nv)

    @cached_property
    def _entries(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        return self._tree.mass_entries(all_joints=False)

    @cached_property
    def _masses(self) -> Array:
        """The core's masses, then units of the others: these have no part in the KKT system."""
        return np.zeros(len(self._entries[0]) + len(self._open))

    @cached_property
    def kkt(self) -> KKT | None:
        """The KKT system of the core."""
        n = len(self._entries[0])
        if not n:
            return None
        rows, columns, places = both_halves(*self._entries)
        others = np.arange(n, len(self._masses))
        at = (np.concatenate([rows, self._open]), np.concatenate([columns, self._open]),
              np.concatenate([places, others]))
        return KKT(self._mechanism, at, len(self._masses))

    def solve(self, state: State, reference: Array, force: Array) -> bool:
        """Find the accelerations under joint forces (nv,); False where a limb has no inertia.

        Args:
            state: configuration and velocity.
            reference: (n_angles,) from which the angles of screws count [rad].
            force: the joint forces.
        """
        self._force[:] = force
        if not self._tree.eliminate(state.q, state.v, self._force, self._masses, self._needed):
            return False
        self.error = 0.0
        if self.kkt is not None:
            self._solve_core(self.kkt, state, reference)
        largest, corrected, rounding = self._tree.complete(self._force, self.a)
        largest = largest or 1.0
        self.error = max(self.error, LEAST_ERROR, (corrected + rounding) / largest)
        return True

    @property
    def is_of_forces(self) -> bool:
        """Whether round-off of the joint forces is most of `error`: no solver can know more."""
        rounding = self._tree.response(self._rounding * self._force)
        return self.error * float(np.abs(self.a / self._scale).max()) <= 10.0 * rounding

    def _solve_core(self, kkt: KKT, state: State, reference: Array) -> None:
        """Put the accelerations of the core into `a`, by its KKT system."""
        rows, columns = self._entries
        n, own = len(rows), rows == columns
        heaviest = float((self._masses[:n][own] * self._scale[rows[own]] ** 2).max())
        self._masses[n:] = (heaviest or 1.0) / self._scale[self._open] ** 2
        kkt.mass[:] = self._masses
        given = np.where(self._tree.is_core, self._force, 0.0)
        self.a[:] = kkt.accelerations(state.q, state.v, reference, given, self._needed)
        self.error = kkt.error
