"""Assembly: from a rough guess to a closed configuration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.checks import mapping
from spatial_pin.errors import AssemblyError
from spatial_pin.kinematics.constraints import Evaluation, evaluation_of
from spatial_pin.kinematics.newton import close
from spatial_pin.kinematics.state import State
from spatial_pin.linalg import Array
from spatial_pin.mechanism.configuration import (
    blur,
    finite_array,
    finite_number,
    joint_values,
    joint_vector,
    needed,
    with_values,
)
from spatial_pin.mechanism.mechanism import Coordinate, Mechanism
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.settings import Accuracy, accuracy_of

MAX_STARTS = 60  # starts from other values of what the guess leaves open, before giving up
MORE_STARTS = 8  # starts after the first success, to find the branch nearest to the guess
FAR = 10.0  # characteristic lengths; a length named beyond them may be that of another size
NEAR = 1e-2  # a branch this near to the guess [rad, characteristic lengths] is not questioned
ACCEPTED = 1e-11  # closure error above which a configuration is not called closed
PERIODIC = ("revolute", "cylindrical", "universal", "planar")


class _Guess(NamedTuple):
    """Where to start: the configuration, and the coordinates in it that somebody named."""

    q: Array
    named: dict[str, float]


def assemble(
    mechanism: Mechanism,
    drivers: Mapping[str, float] | None = None,
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    limits: bool = False,
    accuracy: Accuracy | None = None,
) -> State:
    """Close the loops of a mechanism.

    What the guess names is held while the rest is solved first, then all is released except the
    drivers; of the branches in reach the one nearest to the named values is returned.

    Args:
        mechanism: the mechanism.
        drivers: values of drivers or coordinates to hold exactly [rad, m]; the others are free.
        guess: values by joint or coordinate as in the mechanism file, a State, or q (nq,);
            default the file's guess, and neutral where nothing is said.
        limits: keep the joint limits of the model.
        accuracy: tolerance to reach; default "engineering".

    Returns:
        The closed State; its v and a are zero, see `solve_rates`.

    Raises:
        AssemblyError: no closed configuration found; keeps the best attempt.
        UnknownNameError: a name does not exist.
        ValueError: a value is NaN or infinite.
    """
    needed(mechanism)
    accuracy = accuracy_of(accuracy)
    held: dict[str, float] = {}
    for name, value in mapping(drivers, "drivers").items():
        coordinate = mechanism.driven_coordinate(name).name
        if coordinate in held:
            raise ValueError(f"{coordinate!r} is given two values")
        held[coordinate] = finite_number(value, f"driver {name!r}")
    guess = mechanism.start(held) if guess is None else guess
    start = _read_guess(mechanism, guess)
    named = {name: value for name, value in start.named.items() if name not in held}
    with evaluation_of(mechanism, guess.angles if isinstance(guess, State) else 0.0) as evaluation:
        search = _Search(evaluation, held, named, limits, accuracy)
        for k, q in enumerate(_starts(mechanism, start.q, held, named)):
            search.attempt(q)
            if search.done(k):
                break
        return search.result()


class _Search:
    """Attempts from several starts, and the best of what they found."""

    def __init__(
        self,
        evaluation: Evaluation,
        held: Mapping[str, float],
        named: Mapping[str, float],
        limits: bool,
        accuracy: Accuracy,
    ) -> None:
        self.mechanism = mechanism = evaluation.mechanism
        self.evaluation, self.held, self.named = evaluation, held, named
        self.limits, self.tolerance = limits, accuracy.tolerance
        self.free = np.ones(mechanism.model.nv, dtype=bool)
        self.free[[mechanism.coordinate_table[name].v for name in held]] = False
        self.first = self.free.copy()
        self.first[[mechanism.coordinate_table[name].v for name in named]] = False
        self.best: tuple[float, Array] | None = None
        self.nearest_miss: tuple[float, Array, str] | None = None
        self.found_at = -1

    def attempt(self, q: Array) -> None:
        """Solve from one start and keep the result if it is the best so far."""
        evaluation = self.evaluation
        loose = max(self.tolerance, 1e-9)
        if self.first.any() and not np.array_equal(self.first, self.free):
            q, _ = close(evaluation, q, self.first, loose)
        q, error = close(evaluation, q, self.free, self.tolerance)
        q = nearest_turn(self.mechanism, q, self.held, self.named)
        evaluation.update(q)
        accepted = max(ACCEPTED, blur(self.mechanism, q))
        problem = evaluation.worst_closure() if not error <= accepted else evaluation.mirrored()
        if not problem and self.limits and _violated(self.mechanism, q):
            q, error = _within_limits(evaluation, q, self.free, self.tolerance)
            problem = evaluation.worst_closure() if not error <= accepted else evaluation.mirrored()
            problem = problem or _violated(self.mechanism, q)
        if problem:
            if self.nearest_miss is None or error < self.nearest_miss[0]:
                self.nearest_miss = (error, q, problem)
            return
        distance = self._distance(q)
        if self.best is None or distance < self.best[0] * (1.0 - 1e-6) - 1e-9:
            self.best = (distance, q)

    def _distance(self, q: Array) -> float:
        """How far q is from the named values; an orientation counts by its angle."""
        mechanism = self.mechanism
        model = mechanism.model
        target = with_values(mechanism, q, self.named)
        gap = pin.difference(model, q, target) / mechanism.velocity_scale
        return float(np.linalg.norm(gap))

    def done(self, k: int) -> bool:
        """Whether further starts can be spared after start number `k`."""
        if self.best is None:
            return False
        if self.found_at < 0:
            self.found_at = k
        return self.best[0] < NEAR or k - self.found_at >= MORE_STARTS

    def result(self) -> State:
        """Return the best closed State, or raise with the best attempt."""
        evaluation = self.evaluation
        if self.best is None:
            raise self._failure()
        q = self.best[1]
        evaluation.update(q)
        return State(self.mechanism, q, closure_error=evaluation.closure_error,
                     angles=evaluation.angles)

    def _failure(self) -> AssemblyError:
        assert self.nearest_miss is not None
        error, q, worst = self.nearest_miss
        self.evaluation.update(q)
        state = State(self.mechanism, q, closure_error=error, angles=self.evaluation.angles)
        held = ", ".join(f"{name} = {value:.6g}" for name, value in self.held.items())
        where = f"mechanism {self.mechanism.name!r}" + (f" with {held}" if held else "")
        if error <= ACCEPTED and worst.startswith("limit of "):
            message = (f"{where} closes only outside the joint limits ({worst}); "
                       "try other driver values or another guess")
        elif error <= ACCEPTED:
            message = (f"{where} closes only in the mirror image of closure {worst!r} (its axes "
                       "point opposite ways); give a guess nearer to the wanted configuration, "
                       "or turn one of its frames round")
        else:
            gap = open_gap(self.mechanism, self.evaluation, worst)
            message = (f"{where} cannot be closed: closure {worst!r} stays open by {gap} "
                       f"(closure error {error:.1e}); a driver value may be out of reach, or the "
                       "guess too far from any closed configuration")
            if any(c.name == worst and c.type == "screw" for c in self.mechanism.closures):
                message += ("; a screw closure is assembled within half a turn of zero: sweep to "
                            "further turns, or put the screw into the tree")
        return AssemblyError(message, closure_error=error, worst_closure=worst, state=state)


def open_gap(mechanism: Mechanism, evaluation: Evaluation, closure: str) -> str:
    """Return how far a closure is open at the evaluation, in m or rad, as text."""
    constraints = evaluation.constraints
    rows = [i for i, label in enumerate(constraints.labels) if label.closure == closure]
    kinds = {c.name: c for c in mechanism.closures}[closure]
    is_length = [row.is_length for row in kinds.rows] if kinds.type != COUPLING else [
        mechanism.coordinate(kinds.joints[1]).unit == "m"]
    values = evaluation.residual[rows]
    lengths = float(np.linalg.norm(values[np.array(is_length)]))
    angles = float(np.linalg.norm(values[~np.array(is_length)]))
    parts = []
    if lengths > 0.0:
        parts.append(f"{lengths * mechanism.characteristic_length:.1e} m")
    if angles > 0.0:
        parts.append(f"{angles:.1e} rad")
    return " and ".join(parts) or "0"


def _read_guess(
    mechanism: Mechanism, guess: Mapping[str, Any] | State | Array | None
) -> _Guess:
    base = joint_values(mechanism, mechanism.guess)
    if guess is None:
        return _Guess(with_values(mechanism, mechanism.neutral, base), base)
    if isinstance(guess, State):
        if guess.mechanism.coordinates != mechanism.coordinates:
            raise ValueError(
                f"the guess is a state of mechanism {guess.mechanism.name!r}, which has other "
                f"coordinates than {mechanism.name!r}"
            )
        guess = guess.q
    if isinstance(guess, Mapping):
        named = joint_values(mechanism, guess)
        return _Guess(with_values(mechanism, mechanism.neutral, base | named), named)
    q = finite_array(guess, (mechanism.model.nq,), "guess q")
    if not pin.isNormalized(mechanism.model, q, 0.5):
        raise ValueError("guess q has a quaternion whose length is far from 1")
    q = pin.normalize(mechanism.model, q)
    joints = list(mechanism.model.names)[1:]
    named = {}
    for joint in joints:
        names = [c.name for c in mechanism.coordinate_table.values() if c.joint == joint]
        named.update(zip(names, joint_vector(mechanism, q, joint).tolist(), strict=True))
    return _Guess(q, named)


def _starts(
    mechanism: Mechanism, q: Array, held: Mapping[str, float], named: Mapping[str, float]
) -> Iterator[Array]:
    """Yield start configurations: the guess, then others that keep what it names.

    After half of the starts what is named is shaken too, first by up to a radian, in the end by
    any angle, and lengths in proportion; named lengths far beyond the mechanism's size are cut.
    """
    model, scale = mechanism.model, mechanism.velocity_scale
    fixed = with_values(mechanism, q, {**named, **held})
    yield fixed
    rng = np.random.default_rng(20110)
    table, far = mechanism.coordinate_table, FAR * mechanism.characteristic_length
    nearer = {name: float(np.clip(value, -far, far)) for name, value in named.items()
              if table[name].unit == "m"}
    near = with_values(mechanism, fixed, {**nearer, **held})
    is_held = np.array([name in held for name in table], dtype=bool)
    is_named = np.array([name in named for name in table], dtype=bool)
    is_angle = np.array([c.unit == "rad" for c in table.values()], dtype=bool)
    if not np.any(~is_held):
        return
    open_ones = ~is_held & ~is_named
    for k in range(1, MAX_STARTS):
        reach = np.where(open_ones, np.pi, 0.0)
        if k > MAX_STARTS // 2 or not open_ones.any():
            reach = np.where(is_named, 1.0 if k < 3 * MAX_STARTS // 4 else np.pi, reach)
            fixed = near
        reach = reach * np.where(is_angle, 1.0, scale * 0.2)
        yield pin.integrate(model, fixed, rng.uniform(-1.0, 1.0, model.nv) * reach)


def periodic(mechanism: Mechanism) -> list[Coordinate]:
    """Return the angles that mean the same after a whole turn."""
    coupled = {mechanism.coordinate(j).name for c in mechanism.closures if c.type == COUPLING
               for j in c.joints}
    return [
        c for c in mechanism.coordinate_table.values()
        if c.unit == "rad" and c.q >= 0 and c.name not in coupled
        and mechanism.pair_of(c.joint) in PERIODIC
    ]


def nearest_turn(
    mechanism: Mechanism, q: Array, held: Mapping[str, float], named: Mapping[str, float]
) -> Array:
    """Take whole turns off the angles: nearest to the named value, else to zero, in limits."""
    q = q.copy()
    turn = 2.0 * np.pi
    lower, upper = mechanism.model.lowerPositionLimit, mechanism.model.upperPositionLimit
    for c in periodic(mechanism):
        if c.name in held:
            q[c.q] = held[c.name]
            continue
        target = named.get(c.name, 0.0)
        q[c.q] -= turn * np.ceil((q[c.q] - target) / turn - 0.5 - 1e-9)  # half a turn is +pi
        if q[c.q] > upper[c.q] and q[c.q] - turn >= lower[c.q]:
            q[c.q] -= turn
        elif q[c.q] < lower[c.q] and q[c.q] + turn <= upper[c.q]:
            q[c.q] += turn
    return q


def _violated(mechanism: Mechanism, q: Array) -> str:
    """Return which joint limit q breaks, as text; empty when none."""
    model = mechanism.model
    for c in mechanism.coordinate_table.values():
        if c.q < 0:
            continue
        low, high = model.lowerPositionLimit[c.q], model.upperPositionLimit[c.q]
        slack = 1e-9 * max(1.0, abs(q[c.q]))
        if not low - slack <= q[c.q] <= high + slack:
            return f"limit of {c.name}: {q[c.q]:.6g} is not in [{low:.6g}, {high:.6g}]"
    return ""


def _within_limits(
    evaluation: Evaluation, q: Array, free: NDArray[np.bool_], tolerance: float
) -> tuple[Array, float]:
    """Close the loops within the joint limits by bounded least squares, then exactly."""
    from scipy.optimize import least_squares

    mechanism, model = evaluation.mechanism, evaluation.model
    n = evaluation.constraints.n_rows
    low, high = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    start = q.copy()
    for c in mechanism.coordinate_table.values():
        if c.q >= 0 and free[c.v]:
            start[c.q] = np.clip(q[c.q], model.lowerPositionLimit[c.q],
                                 model.upperPositionLimit[c.q])
            low[c.v] = model.lowerPositionLimit[c.q] - start[c.q] - 1e-12
            high[c.v] = model.upperPositionLimit[c.q] - start[c.q] + 1e-12

    def at(x: Array) -> Array:
        step = np.zeros(model.nv)
        step[free] = x
        return pin.integrate(model, start, step)

    def residual(x: Array) -> Array:
        evaluation.update(at(x))
        return evaluation.residual.copy()

    def jacobian(x: Array) -> Array:  # exact for coordinates with limits, near zero for the rest
        evaluation.update(at(x))
        return evaluation.jacobian[:n, free] / mechanism.velocity_scale[free]

    fit = least_squares(residual, np.zeros(int(free.sum())), jacobian,
                        bounds=(low[free], high[free]), x_scale=mechanism.velocity_scale[free],
                        xtol=1e-15, ftol=1e-15, gtol=1e-15)
    loose = free.copy()
    loose[free] = (fit.x > low[free] + 1e-9) & (fit.x < high[free] - 1e-9)
    return close(evaluation, at(fit.x), loose, tolerance)
