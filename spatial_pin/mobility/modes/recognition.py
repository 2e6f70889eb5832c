"""What tells closed configurations of a core apart, and the whole mechanism around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.kernel import Kernel
from spatial_pin.mobility.modes.check import Check
from spatial_pin.mobility.modes.marks import Mark, rows_of
from spatial_pin.mobility.modes.rods import Core
from spatial_pin.numerics.linalg import Array, null_space
from spatial_pin.numerics.tolerances import TOLERANCES

LOOKED_AT = 20  # closed configurations looked at for a regular one: if all are singular, it is so


class Recognition:
    """Signatures of configurations: equal where these are one mode.

    Args:
        check: of the whole mechanism.
        core: what is searched.
        base: (nq,) configuration of the whole mechanism where it is not the core's.
        kernel: of the core.
        free: (nv,) velocities of the core that may close the loops.
        all_copies: whether copies of a mode are told apart.

    Attributes:
        marks: what counts of each body; empty before anything was learnt.
        is_learnt: whether signatures can be made.
        generic_nullity: freedoms to first order of a regular configuration of the core.
    """

    def __init__(
        self, check: Check, core: Core, base: Array, kernel: Kernel,
        free: NDArray[np.bool_], all_copies: bool,
    ) -> None:
        self._check, self._core, self._base = check, core, base
        self._kernel, self._free, self._all_copies = kernel, free, all_copies
        self.marks: dict[int, Mark] = {}
        self.is_learnt = False
        self._rows: Array = np.empty((0, 0))
        self.generic_nullity = 0

    def learn(self, q: Array) -> None:
        """Learn from closed configurations q (nq, m) which freedoms are passive."""
        looked_at = 0
        for x in q.T:
            whole = self.whole(x)
            if whole is None:
                continue
            kind = self._check.kind(whole)
            if not self.is_learnt or not kind.is_singular:
                self.is_learnt = True
                self.marks = self._check.marks(whole, kind.idle, self._all_copies)
                nullity = len(null_space(self.jacobians(x[:, None])[0], TOLERANCES.half_precision))
                self.generic_nullity = nullity - kind.nullity + kind.passive
            looked_at += 1
            if not kind.is_singular or looked_at == LOOKED_AT:
                break
        if self.is_learnt:
            own = {k: self.marks[i] for k, i in enumerate(self._core.joints, start=1)}
            self._rows = rows_of(own, len(self._core.joints) + 1,
                                 self._check.mechanism.characteristic_length)

    def signatures(self, q: Array) -> Array:
        """Return (m, rows, 3) what tells configurations q (nq, m) of the core apart."""
        placed = self._kernel.placements(q.T)
        return self._rows @ placed.reshape(len(placed), -1, 3)

    def signature(self, q: Array) -> Array:
        """Return (rows, 3) of one configuration (nq,) of the whole mechanism."""
        model, own = self._check.mechanism.model, self._core.mechanism.model
        parts = [q[model.idx_qs[i] : model.idx_qs[i] + model.nqs[i]] for i in self._core.joints]
        x: Array = np.concatenate([np.empty(0), *parts]).reshape(own.nq)
        return self.signatures(x[:, None])[0]

    def jacobians(self, q: Array) -> Array:
        """Return (m, n_closure, free) derivatives of the core's equations at q (nq, m)."""
        return self._kernel.jacobians(q.T)[:, : self._kernel.n_closure, self._free]

    def whole(self, x: Array) -> Array | None:
        """Return a configuration of the core as one of the mechanism, None if it is none."""
        mechanism = self._check.mechanism
        return self._check.place_rods(
            self._core.rods, self._core.whole(mechanism, self._base, x))


def apart(signatures: Array, other: Array) -> Array:
    """Return (m,) largest differences of signatures (m, rows, 3) from another (rows, 3)."""
    return np.abs(signatures - other).max(axis=(1, 2), initial=0.0)
