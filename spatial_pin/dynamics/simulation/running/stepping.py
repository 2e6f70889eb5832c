"""The integrator in use: the one asked for, or by turns an explicit and an implicit one."""

from __future__ import annotations

from typing import Any

import numpy as np

from spatial_pin.dynamics.simulation.formulations.independent import Independent
from spatial_pin.dynamics.simulation.integrators import (
    AUTOMATIC,
    EXPLICIT,
    natural_units,
    stepper,
    successor,
)
from spatial_pin.errors import warn
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, Accuracy


class Stepping:
    """Makes integrators, and says which ones.

    Args:
        accuracy: integrator, tolerance or step.
        end: until when they go [s].

    Attributes:
        used: names of those that have taken steps.
    """

    def __init__(self, accuracy: Accuracy, end: float) -> None:
        self._accuracy, self._chosen, self._end = accuracy, accuracy.integrator, end
        self._method, self._easy, self._has_warned = "", 0, False
        self.used: list[str] = []

    def begin(
        self, system: Independent, t: float, y: Array, longest: float = np.inf,
        only_first: bool = False,
    ) -> Any:
        """Return an integrator that starts at unknowns y, its error norm in natural units.

        Args:
            system: the equations of motion.
            t: where it starts [s].
            y: (n,) unknowns there.
            longest: its longest step [s].
            only_first: whether that holds for the first step alone.
        """
        self._units = natural_units(system, t, y, self._end - t)
        method = EXPLICIT if self._chosen == AUTOMATIC else self._chosen
        first, longest = (longest, np.inf) if only_first else (np.inf, longest)
        return self._made(method, system, t, y, longest, first)

    def succeed(self, system: Independent, t: float, y: Array, solver: Any) -> Any:
        """Return the integrator to go on with: another one if stiffness has changed."""
        if self._chosen != AUTOMATIC:
            return solver
        method, self._easy = successor(solver, self._units.unknowns, self._easy)
        if method == self._method:
            return solver
        return self._made(method, system, t, y, solver.max_step)

    def note(self, system: Independent, solver: Any) -> None:
        """Keep the names of integrators used; warn once of an explicit one that only creeps."""
        if self._method not in self.used:
            self.used.append(self._method)
        is_asked_for = self._chosen != AUTOMATIC
        if self._has_warned or not is_asked_for or not getattr(solver, "creeps", False):
            return
        self._has_warned = True
        warn(
            f"mechanism {system.problem.mechanism.name!r}: from {solver.t:.6g} s on the explicit "
            f"integrator {self._chosen!r} is no good, for steps of {solver.t - solver.t_old:.1e} s "
            f"are as long as it is stable with: {_stiffest(system, solver)} is stiff. Leave the "
            "integrator out, or take Accuracy(integrator=\"Radau\")")

    def _made(
        self, method: str, system: Independent, t: float, y: Array, longest: float,
        first: float = np.inf,
    ) -> Any:
        self._method, self._easy = method, 0
        if system.problem.external and not INTEGRATORS[method].is_fixed:
            longest = min(longest, system.problem.external.longest_step)
        return stepper(method)(
            system, t, y, self._end, self._accuracy, self._units, longest, first)


def _stiffest(system: Independent, solver: Any) -> str:
    """Return what causes the stiffness at the solver's time, in words."""
    problem = system.problem
    resistance = problem.forces.resistance
    if not resistance:
        return "a spring or damper"
    slopes = resistance.slopes(system.place(solver.t, solver.y)[1]) * problem.scale**2
    by_v = {c.v: c.name for c in problem.mechanism.coordinate_table.values()}
    at = int(slopes.argmax())
    damped = resistance.damping[at] * problem.scale[at] ** 2 > 0.5 * slopes[at]
    return f"the {'damping' if damped else 'dry friction'} of {by_v[at]!r}"
