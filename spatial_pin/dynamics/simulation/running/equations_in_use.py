"""The equations of motion in use: in some coordinates, and in others where these end."""

from __future__ import annotations

import time
from collections.abc import Callable, Set

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.coordinate_partitioning import Lost
from spatial_pin.dynamics.simulation.formulations.independent import Independent
from spatial_pin.dynamics.simulation.formulations.projected import Projected
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import Projection
from spatial_pin.dynamics.simulation.running.ending import why_it_ends
from spatial_pin.dynamics.simulation.running.pace import Pace
from spatial_pin.dynamics.simulation.running.record import Record
from spatial_pin.errors import SingularError
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy

GivenUp = Set[tuple[type, tuple[int, ...]]]  # formulations, and their independent coordinates
Formulate = Callable[[Problem, State, GivenUp], Independent]


class EquationsInUse:
    """Takes one formulation and its coordinates after the other.

    Args:
        problem: what acts.
        accuracy: that was asked for.
        formulate: makes the equations of motion for a state, of no kind that was given up.
        record: where the coordinates are noted.
        pace: of the steps.

    Attributes:
        system: the equations in use, once there are some.
    """

    def __init__(
        self, problem: Problem, accuracy: Accuracy, formulate: Formulate, record: Record,
        pace: Pace,
    ) -> None:
        self._problem, self._accuracy, self._formulate = problem, accuracy, formulate
        self._record, self._pace = record, pace
        self.system: Independent | None = None
        self._first: State | None = None
        self._projections: list[Projection] = []  # of the equations of motion used before
        self._begun_at, self._failed_at = 0.0, -1.0
        self._given_up: set[tuple[type, tuple[int, ...]]] = set()  # at the time of the failure
        self._began = time.perf_counter()

    def begin(self, t: float, state: State, given_up: GivenUp = frozenset()) -> Independent:
        """Return equations of motion that begin at a state.

        Raises:
            SingularError: there are none.
        """
        if self._first is None:
            self._first = state
        if isinstance(self.system, Projected):
            self._projections.append(self.system.projection)
        self.system = system = self._formulate(self._problem, state, given_up)
        if _kind(system) in given_up:
            raise self.singular(t, state)
        self._note_begun(system, t)
        return system

    def begin_again(
        self, system: Independent, t: float, y: Array, failed: bool
    ) -> tuple[Independent, Array]:
        """Choose other independent coordinates, or begin anew; return them and the unknowns there.

        Raises:
            SingularError: none can be followed.
        """
        state = system.state(t, y)
        renewed = None if failed else system.renewed(t, y, state)
        if renewed is not None:
            self._note_begun(system, t)
            return system, renewed
        try:
            fresh = self.begin(t, state, self._give_up(system, t) if failed else frozenset())
        except SingularError as error:
            if self._pace.is_short(t):  # what is said of a start
                raise
            raise self.singular(t, state) from error
        return fresh, fresh.unknowns(state.v, self._problem.work(y))

    def singular(self, t: float, state: State) -> SingularError:
        """Return the error of a motion that cannot be followed beyond a time [s]."""
        return SingularError(
            f"mechanism {self._problem.mechanism.name!r}: the motion cannot be followed beyond "
            f"{t:.9g} s: {self._why(t, state)}; it is at {state}", state=state)

    def why(self, t: float, y: Array) -> str:
        """Return why the motion cannot be followed beyond unknowns y at a time [s]."""
        assert self._first is not None
        if self.system is None:
            return self._why(t, self._first)
        try:
            return self._why(t, self.system.state(t, y))
        except Lost:
            return "the loops cannot be closed there as on the way to it"

    def _why(self, t: float, state: State) -> str:
        return why_it_ends(self._problem, self._accuracy, self._first or state, t, state)

    def _note_begun(self, system: Independent, t: float) -> None:
        self._record.note_coordinates(system.free)
        self._begun_at = t

    def _give_up(self, system: Independent, t: float) -> GivenUp:
        """Return what has failed at the present time, the system included."""
        if not self._pace.is_short(t - self._failed_at):
            self._failed_at = t
            self._given_up.clear()
        if system.is_fresh_the_same or self._pace.is_short(t - self._begun_at):
            self._given_up.add(_kind(system))
        return self._given_up

    def projection(self) -> Projection | None:
        """Return what projecting has taken, if anything was projected."""
        if not isinstance(self.system, Projected):
            return None
        parts = [*self._projections, self.system.projection]
        seconds = sum(part.seconds for part in parts)
        return Projection(
            sum(part.steps for part in parts), sum(part.corrections for part in parts),
            max(part.opened for part in parts), seconds,
            seconds / (time.perf_counter() - self._began))


def _kind(system: Independent) -> tuple[type, tuple[int, ...]]:
    return type(system), tuple(system.free)
