"""The beginning of a branch, or of a curve: where it is, and what is prescribed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.holding import Hold, divided, still_entries
from spatial_pin.assembly.passive_freedoms import moved_bodies
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.continuation.driving import DriversLaw, OneDriver
from spatial_pin.continuation.solution_curve import SolutionCurve
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.kernel.paths import Path, PathSamples, prescribed_places
from spatial_pin.mechanism.coordinates import driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.depending import Depending, depending_on
from spatial_pin.rates.rates import check_not_held, prescribed_at, prescribed_first
from spatial_pin.settings import Accuracy

# Arc length that a start on a limit of the driver is moved by: rates there are twenty times the
# driver's, and no sample is missed, as the way back is followed too.
BESIDE_LIMIT = 0.05


def moving_drivers(
    mechanism: Mechanism, driven: Sequence[Coordinate], still: Sequence[int]
) -> set[str]:
    """Return the drivers that move though they are not driven, as nothing lets them stand."""
    return {name for name, c in driver_coordinates(mechanism).items()
            if c not in driven and c.v not in still}


class Start:
    """The beginning of a branch: where it is, what is prescribed, how exactly it is followed.

    Attributes:
        driven: the prescribed coordinates, the driver first.
        still: places in the velocity vector that stand still.

    Args:
        state: closed.
        driven: the prescribed coordinates, the driver first.
        still: places in the velocity vector that stand still; default: those of free bases.
        accuracy: of the motion.
        kernel: of the state's mechanism.
        evaluation: its closure equations.
        law: how the coordinates driven first go by a parameter, see `DriversLaw`; default: the
            driver itself leads.
        begin: the parameter at the start.
    """

    def __init__(
        self, state: State, driven: Sequence[Coordinate], still: Sequence[int] | None,
        accuracy: Accuracy, kernel: Kernel, evaluation: LoopEquations, law: Any = None,
        begin: float = 0.0,
    ) -> None:
        self.state, self.mechanism, self.accuracy = state, state.mechanism, accuracy
        self.kernel, self.evaluation = kernel, evaluation
        self.driven = driven
        self.still = still_entries(state.mechanism, driven) if still is None else tuple(still)
        self._law, self._begin = law, begin
        self._first: Path | None = None

    @cached_property
    def leading(self) -> OneDriver:
        """What leads along the branch."""
        mechanism, driven, q = self.mechanism, self.driven, self.state.q
        if self._law is None:
            return OneDriver(mechanism, driven, q)
        return DriversLaw(mechanism, driven, q, self._law, self._begin)

    @classmethod
    def along(
        cls, state: State, names: Sequence[str], hold: Hold, accuracy: Accuracy, kernel: Kernel,
        evaluation: LoopEquations, law: Any = None, begin: float = 0.0,
    ) -> Start:
        """Return the start of a branch with the first of some names driven, the others held.

        Args:
            state: closed.
            names: prescribed coordinates, the driver first.
            hold: what stands still, see `sweep`.
            accuracy: of the motion.
            kernel: of the state's mechanism.
            evaluation: its closure equations.
            law: how the names go by a parameter; default: the first one leads.
            begin: the parameter at the start.
        """
        driven, still = prescribed_first(state.mechanism, names, hold)
        start = cls(state, driven, still, accuracy, kernel, evaluation, law, begin)
        start._first = start._path_of_regular(state.q, state.angles, begin)
        if start._first is None:
            driven = prescribed_at(state, names, hold)
            still = divided(state.mechanism, driven, hold)[1]
            start = cls(state, driven, still, accuracy, kernel, evaluation, law, begin)
        return start

    def by(self, law: Any, begin: float) -> Start:
        """Return the start of a branch with the same coordinates driven by another law."""
        return Start(self.state, self.driven, self.still, self.accuracy, self.kernel,
                     self.evaluation, law, begin)

    def samples(self, n: int) -> PathSamples:
        """Return room for n samples."""
        return PathSamples.empty(n, self.kernel.nq, self.kernel.nv, self.kernel.n_angles)

    def system(self, q: Array, angles: Array) -> SquareSystem:
        """Return the square system at a configuration.

        Raises:
            SingularError: the driver does not determine the motion there.
        """
        self.evaluation.angle_reference[:] = angles
        return SquareSystem(self.evaluation, self.driven, q, self.still)

    def checked_system(self, state: State) -> SquareSystem:
        """Return the square system at a state.

        Raises:
            SingularError: the driver does not determine the motion there, or loops lose rank.
        """
        system = self.system(state.q, state.angles)
        system.check_regular(state.q)
        if system.pivot < TOLERANCES.singular:
            raise SingularError(f"mechanism {self.mechanism.name!r}: singular configuration at "
                                f"the start, {state}", state=state)
        return system

    def first_path(self) -> Path | None:
        """Return the path that the kernel follows from the state; None as `path`."""
        found, self._first = self._first, None
        return found or self.path(self.state.q, self.state.angles, self._begin)

    def path(self, q: Array, angles: Array, s: float) -> Path | None:
        """Return the path that the kernel follows from q; None where it cannot, or may not.

        Args:
            q: (nq,) closed configuration.
            angles: (n_angles,) of screw closures.
            s: the parameter there, where a law leads.
        """
        found = self._path_of_regular(q, angles, s)
        if found is not None:
            return found
        try:  # where passive freedoms are left
            system = self.system(q, angles)
            system.check_regular(q)
        except SingularError:
            return None
        return self._path(system.equations, system.passive, q, angles, s)

    def _path_of_regular(self, q: Array, angles: Array, s: float) -> Path | None:
        """Return the path where as many equations are independent as there are unknowns."""
        k = self.kernel
        wanted = k.nv - k.n_passive - len(self.driven) - len(self.still)
        if not 0 <= wanted <= k.n_closure:
            return None
        return self._path(None, None, q, angles, s)

    def _path(
        self, chosen: NDArray[np.integer[Any]] | None, fill: Array | None, q: Array,
        angles: Array, s: float,
    ) -> Path | None:
        driven = prescribed_places(self.kernel, self.driven, self.still)
        path = Path(self.kernel, chosen, driven, fill, self.accuracy)
        if self._law is not None:
            self.leading.prescribe(path, s, self.still)
        return path if path.start(q, angles) else None


def system_at(
    mechanism: Mechanism, driver: str, guess: Mapping[str, Any] | State | Array | None, hold: Hold
) -> tuple[SquareSystem, State, Depending | None]:
    """Return the square system with `driver` prescribed first, at the assembled guess or near it.

    Where the guess is just a limit of the driver, a point a little further on is taken. Of a
    mechanism that the driver does not determine, it is that of the part that it moves.

    Raises:
        ValueError: the driver is held.
    """
    check_not_held(mechanism, [mechanism.driven_coordinate(driver)], hold)
    state = assembled(mechanism, {}, guess)
    moved = depending_on(state, [driver], hold)
    if moved is not None:
        state, hold = moved[:2]
    mechanism = state.mechanism  # of a rounded file one without the equations that it contradicts
    driven = [mechanism.driven_coordinate(c.name) for c in prescribed_at(state, [driver], hold)]
    still = divided(mechanism, driven, hold)[1]
    try:
        return _square(mechanism, driven, state, still), state, moved
    except SingularError as error:
        beside = _beside(mechanism, driven, state, still)
        if beside is None:
            raise error
    return _square(mechanism, driven, beside, still), beside, moved


def _square(
    mechanism: Mechanism, driven: Sequence[Coordinate], state: State, still: Sequence[int]
) -> SquareSystem:
    evaluation = LoopEquations(mechanism)
    evaluation.angle_reference[:] = state.angles
    system = SquareSystem(evaluation, driven, state.q, still)
    system.check_regular(state.q)
    return system


def _beside(
    mechanism: Mechanism, driven: Sequence[Coordinate], state: State, still: Sequence[int]
) -> State | None:
    """Return a closed state a little further along the curve, found with another driver."""
    for other in mechanism.coordinate_table.values():
        if other.q < 0 or other in driven or other.v in still:
            continue
        try:
            system = _square(mechanism, [other, *driven[1:]], state, still)
        except SingularError:
            continue
        curve = SolutionCurve(system, Accuracy.named("engineering").tolerance)
        point = curve.settle(state.q, direction_of(system) / system.scale)
        q = curve.ahead(point, BESIDE_LIMIT) if point is not None else None
        if q is not None:
            return State(mechanism, q, closure_error=curve.evaluation.closure_error,
                         angles=curve.evaluation.angles)
    return None


def direction_of(system: SquareSystem) -> Array:
    """Return dq/d(driver) (nv,) at the system's configuration."""
    return system.driver_rates()[:, 0]


def not_spinning(system: SquareSystem) -> list[int]:
    """Return the bodies without passive freedoms, resolved or not, where the system stands.

    The others need not come back with the loops: what they spin over a turn is no whole one.
    """
    evaluation, mechanism = system.evaluation, system.evaluation.mechanism
    spinning = {joint for joint, _ in evaluation.constraints.idle_axes}
    if len(system.passive):
        spinning |= set(moved_bodies(evaluation, system.passive * system.scale))
    return [i for i in range(mechanism.model.njoints) if i not in spinning]


def body_places(evaluation: LoopEquations, bodies: list[int]) -> Array:
    """Return the placements of bodies, lengths scaled."""
    scale = np.array([1.0, 1.0, 1.0, evaluation.mechanism.characteristic_length])[:, None]
    return evaluation.placements[bodies] / scale
