"""Where on a motion that targets determine the drivers alone would not determine it.

There a Gough platform can move with its legs locked (a singularity of the second kind): targets
lead on, but efforts grow without bound towards it. The equations of the loops without the columns
of what is driven and held are a square matrix; its determinant changes its sign there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.holding import Hold, divided
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import Kernel, kernel_of
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.numerics.linalg import Array, singular_values
from spatial_pin.numerics.roots import sign_change
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.prescribed import driven_coordinates

Between = Callable[[int, float], Array]  # number of a sample and parameter to (nq,)


class _Rest(NamedTuple):
    """The square matrix of the equations without what is driven and held."""

    # independent equations of the loops, and those of resolved passive freedoms
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]  # velocities that are neither driven nor held
    passive: Array  # (k, n) rows for passive freedoms that are not resolved

    def determinants(self, kernel: Kernel, q: Array) -> tuple[Array, Array]:
        """Return signs (N,) and logarithms (N,) of the determinants at q (N, nq)."""
        matrices = np.concatenate(
            [kernel.jacobians(q)[:, self.rows[:, None], self.columns],
             np.broadcast_to(self.passive, (len(q), *self.passive.shape))], axis=1)
        found = np.linalg.slogdet(matrices)
        return found.sign, found.logabsdet


def driver_singularities(
    states: Iterable[State], q: Array, s: Array, hold: Hold, between: Between
) -> list[tuple[float, int]]:
    """Return parameters at which the drivers alone do not determine a motion, and samples before.

    Where it only touches such a configuration, without a change of sign, it is not seen. Nothing
    is looked for where drivers are fewer, or more, than what is free, or are components of balls.

    Args:
        states: some samples of the motion; where the drivers determine it, equations are chosen.
        q: (N, nq) samples.
        s: (N,) parameter at the samples.
        hold: what stands still besides.
        between: returns the configuration at a parameter, behind a sample.
    """
    chosen, mechanism = None, None
    for state in states if len(q) > 1 else ():
        chosen, mechanism = _rest(state, hold), state.mechanism
        if chosen is not None:
            break
    if chosen is None or mechanism is None:
        return []
    found = []
    with kernel_of(mechanism) as kernel:
        signs, logarithms = chosen.determinants(kernel, q)
        seen = np.flatnonzero(signs)
        for k, after in zip(seen[:-1].tolist(), seen[1:].tolist(), strict=True):
            if signs[k] == signs[after]:
                continue
            span = s[k], s[after]

            def determinant(place: float, k: int = k) -> float:
                sign, logarithm = chosen.determinants(kernel, between(k, place)[None])
                away = np.minimum(logarithm[0] - float(logarithms[k]), 50.0)
                return float(sign[0] * np.exp(away))

            place = sign_change(determinant, *span, *map(determinant, span))
            # whether all equations lose rank there, not only those that were chosen
            sizes = singular_values(
                kernel.jacobians(between(k, place)[None])[0][:, chosen.columns])
            least = sizes[len(chosen.columns) - len(chosen.passive) - 1]
            if least < TOLERANCES.half_precision * sizes[0]:
                found.append((place, int(np.searchsorted(s, place))))
    return found


def _rest(state: State, hold: Hold) -> _Rest | None:
    """Return what drivers leave; None where they do not determine the motion at a state."""
    mechanism = state.mechanism
    driven, still = divided(
        mechanism, driven_coordinates(mechanism, mechanism.drivers), hold)
    if not mechanism.drivers or any(c.q < 0 for c in driven):
        return None
    with loops_of(mechanism, state.angles) as evaluation:
        try:
            system = SquareSystem(evaluation, driven, state.q, still)
        except SingularError:
            return None
        n = evaluation.constraints.n_closure
        rows = np.concatenate([system.equations, np.arange(n, len(evaluation.jacobian))])
        columns = np.delete(np.arange(evaluation.model.nv), [*(c.v for c in driven), *still])
        passive = system.passive[:, columns]
    if len(rows) + len(passive) != len(columns):
        return None
    return _Rest(rows.astype(np.intp), columns, passive)
