"""Velocities and accelerations of a closed mechanism at given driver rates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from spatial_pin._support.checks import checked, finite_number, is_finite, mapping
from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.close import scaled_row
from spatial_pin.assembly.holding import (
    BASE,
    Hold,
    divided,
    free_bases,
    held_by,
    hold_names,
)
from spatial_pin.assembly.state import State, at_sample, made, samples_of
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import loops_at, loops_of
from spatial_pin.kernel.rate_solver import Chosen
from spatial_pin.mechanism.coordinates import driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import EPS, Array, decompose, independent_rows, rank
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.prescribed import (
    Prescription,
    check_unambiguous,
    chosen_at,
    driven_coordinates,
    prescription_by,
    rate_coordinates,
    rates_by_coordinate,
    rates_prescription,
    siblings,
    solved_by,
)

if TYPE_CHECKING:
    import spatial_pin as sp

RATES = "v", "a", "facts"  # see `RateRows`
SOLUTION_ERROR = 8.0 * EPS  # of a solution, relative to its size: as in `closing/rate_errors.c`


def prescribed_at(state: State, names: Iterable[str], hold: Hold = BASE) -> list[Coordinate]:
    """Return the prescribed coordinates when `names` move from a state, in that order.

    These are the named ones, and the drivers that can be fixed beside them. Of redundant drivers,
    those that the loops would move most are released, so that they move least. Beside a coordinate
    that is not a driver, all drivers are fixed or none. If some components of a free base are
    driven, the others are prescribed too. Fixed coordinates come last; their velocity entries are
    given by `holding.divided`.
    """
    names = list(names)
    usual, still = usual_prescription(state.mechanism, tuple(names), hold_names(hold))
    try:
        chosen_at(state, Prescription(usual, len(usual), still))
        return usual
    except SingularError:
        pass
    mechanism = state.mechanism
    drivers = driven_coordinates(mechanism, mechanism.drivers)
    wanted, still = divided(mechanism, wanted_coordinates(mechanism, names), hold)
    others = [c for c in divided(mechanism, drivers, hold)[0] if c not in wanted]
    evaluation = loops_at(mechanism, state.q, state.angles)
    n = evaluation.constraints.n_closure
    rows = np.vstack([evaluation.jacobian[independent_rows(evaluation.jacobian[:n])],
                      evaluation.jacobian[n:], np.eye(mechanism.model.nv)[list(still)]])
    own, more = ([scaled_row(mechanism, c, state.q) for c in some] for some in (wanted, others))
    held = np.vstack([rows, *own])
    svd = decompose(held)
    if svd.rank < len(held):  # they cannot move
        return usual
    first = np.zeros(len(held))
    first[len(rows)] = 1.0
    moved, spare = np.array(more).reshape(-1, mechanism.model.nv), svd.null_space
    v = svd.minimum_norm(first)
    v = v - spare.T @ decompose((spare @ moved.T).T).minimum_norm(moved @ v)
    paces = np.abs(moved @ v).round(9)  # equal ones in the order of the file
    chosen = list(wanted)
    for k in np.argsort(paces, kind="stable"):
        wider = np.vstack([held, more[k]])
        if rank(wider) == len(wider):
            held, chosen = wider, [*chosen, others[k]]
    whole = set(wanted) <= set(drivers) or len(chosen) == len(wanted) + len(others)
    return chosen if whole else usual


@made_once
def usual_prescription(
    mechanism: Mechanism, names: tuple[str, ...], hold: tuple[str, ...]
) -> tuple[list[Coordinate], tuple[int, ...]]:
    """Return prescribed coordinates, in a regular state, and fixed velocity entries."""
    wanted = wanted_coordinates(mechanism, names)
    drivers = driver_coordinates(mechanism).values()
    others = [c for c in drivers if c not in wanted] if set(wanted) <= set(drivers) else []
    return divided(mechanism, [*wanted, *others], hold)


def wanted_coordinates(mechanism: Mechanism, names: Iterable[str]) -> list[Coordinate]:
    """Return the coordinates of names, with all others of a named free base."""
    wanted = list(dict.fromkeys(mechanism.prescribed_coordinate(name) for name in names))
    return wanted + [c for c in siblings(mechanism, wanted) if c.joint in free_bases(mechanism)]


def _choices(state: State, named: list[Coordinate], hold: Hold) -> Iterator[list[Coordinate]]:
    """Yield possible prescriptions for named coordinates, the best first.

    These are the mechanism's drivers if all names are drivers; with more drivers than freedoms, the
    named ones. Otherwise the other coordinates of named joints and the drivers are fixed: all of
    them if they can be, or all of one kind.
    """
    mechanism = state.mechanism
    drivers = driven_coordinates(mechanism, mechanism.drivers)
    if all(c in drivers for c in named):
        yield drivers
        others, still = divided(mechanism, drivers, hold)
        if len(others) > mechanism.model.nv - rank(_closed(state, still)):
            yield named
        return
    others_of_joints = siblings(mechanism, named)
    still_drivers = [c for c in drivers if c not in named and c not in others_of_joints]
    for more in ([*others_of_joints, *still_drivers], others_of_joints, still_drivers):
        if not more:
            continue
        driven, still = divided(mechanism, [*named, *more], hold)
        closed = _closed(state, still)
        rows = [scaled_row(mechanism, c, state.q) for c in driven]
        if rank(np.vstack([closed, *rows])) == rank(closed) + len(driven):
            yield [*named, *more]
    yield named


def _closed(state: State, still: tuple[int, ...]) -> Array:
    """Return the closure equations at a state, and one for each fixed velocity entry."""
    with loops_of(state.mechanism, state.angles) as evaluation:
        evaluation.update(state.q)
        rows = evaluation.jacobian[: evaluation.constraints.n_closure]
        return np.vstack([rows, np.eye(rows.shape[1])[list(still)]]) if still else rows.copy()


def check_not_held(mechanism: Mechanism, named: Sequence[Coordinate], hold: Hold) -> None:
    """Refuse motion of fixed coordinates.

    Raises:
        ValueError: with its name.
    """
    moving, held = divided(mechanism, named, hold)[0], held_by(mechanism, hold, named).coordinates
    for c in named:
        if c not in moving or c in held:
            raise ValueError(f"mechanism {mechanism.name!r}: {c.name!r} is held, and is to move "
                             "too: choose one")


@overload
def solve_rates(
    mechanism: Mechanism, state: State, speeds: Mapping[str, Any] | None = None,
    accelerations: Mapping[str, Any] | None = None, *, hold: Hold = BASE,
) -> State: ...


@overload
def solve_rates(
    mechanism: Mechanism, state: sp.Motion, speeds: Mapping[str, Any] | None = None,
    accelerations: Mapping[str, Any] | None = None, *, hold: Hold = BASE,
) -> sp.Motion: ...


@checked
def solve_rates(
    mechanism: Mechanism,
    state: State | sp.Motion,
    speeds: Mapping[str, Any] | None = None,
    accelerations: Mapping[str, Any] | None = None,
    *,
    hold: Hold = BASE,
) -> State | sp.Motion:
    """Solve velocities and accelerations of all joints of a closed state.

    A passive freedom, such as the idle rotation of a rod between two balls, follows the mechanism
    file, which may say that there is no rotation about a line. What the file leaves open takes the
    joint rates of least norm, velocities and accelerations each for itself: along such a freedom
    the acceleration is not the derivative of the velocity. Resolve it in the file to know more.

    Args:
        mechanism: the mechanism.
        state: a closed configuration, from `assemble`; or a Motion, for all its samples at a time.
        speeds: by driver, coordinate or joint [rad/s, m/s]; drivers left out stand still. The
            speed of a coordinate is its derivative (`ball.x`: of the rotation vector); the other
            coordinates of its joint stand still where the loops leave that open. The name of a
            joint of several freedoms takes all of them, as Pinocchio has its velocity: of a
            spherical joint the angular velocity (3,) of the child in the child's axes, of a
            floating one (6,) the linear velocity in these axes before that, of the others the
            rates of their coordinates. Of a Motion one number for all samples, or (N,); of a joint
            of k freedoms (k,), or (N, k).
        accelerations: likewise [rad/s², m/s²]: second derivatives of coordinates, derivatives of
            the joint's velocity.
        hold: names of joints or coordinates that stand still. "base": a free base (a floating
            joint that alone carries a whole machine), unless it is given rates; "springs": the
            joints that springs act about; "NAME.rotation" and "NAME.translation": parts of a
            floating joint. None: nothing.

    Returns:
        The State with v and a, and `rate_error`; or the Motion, its rates those in time. Of a
        Motion `time` is as `Motion.at_rates` has it.

    Raises:
        SingularError: the drivers do not determine the rates there; says which and why, and of a
            Motion at which sample.
        UnknownNameError: a name does not exist.
        ValueError: a value is NaN or infinite, or makes rates that are; or a joint is not given as
            many as it has freedoms.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.assemble(mech, {"crank": 1.0})
        >>> moving = sp.solve_rates(mech, state, {"crank": 10.0}, {"crank": 0.0})
        >>> value, rate, acceleration = moving.coordinate("rocker_pin")
        >>> print(f"{value:.4f} rad, {rate:.4f} rad/s, {acceleration:.3f} rad/s²")
        1.6255 rad, 1.9351 rad/s, 50.157 rad/s²
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 1.0, 101))
        >>> motion = sp.solve_rates(mech, motion, {"crank": np.linspace(0.0, 10.0, 101)})
        >>> motion.coordinate("rocker_pin").rate[[0, -1]].round(4)  # [rad/s]
        array([-0.    ,  1.9351])
    """
    samples = samples_of(mechanism, state)
    mechanism = samples.mechanism
    speeds = mapping(speeds, "speeds")
    accelerations, hold = mapping(accelerations, "accelerations"), hold_names(hold)
    if not isinstance(samples, State):
        return _motion_solved(samples, speeds, accelerations, hold)
    state = samples
    clear = _solved(state, speeds, accelerations, hold)
    v, a, facts = clear or _solved_by_trial(state, speeds, accelerations, hold)
    if not (is_finite(v) and is_finite(a)):
        check_finite(v, a, f"speeds {dict(speeds)} and accelerations {dict(accelerations)}")
    if clear is None:
        check_rates(state, v)
    return made(mechanism, state.q, v, a, closure_error=state.closure_error, angles=state.angles,
                rate_error=min(facts.item(1) * _more_error(mechanism), 1.0),
                released=state.released, lost_turns=state.lost_turns)


def _motion_solved(
    motion: sp.Motion, speeds: Mapping[str, Any], accelerations: Mapping[str, Any],
    hold: tuple[str, ...],
) -> sp.Motion:
    """Return a motion with the rates that its samples have at prescribed ones.

    The prescription is that of the first sample; a sample where its equations are not clear is
    solved as a State.
    """
    mechanism, n = motion.mechanism, len(motion)
    v_of, a_of = (rates_by_coordinate(mechanism, rates, what, n) for rates, what in (
        (speeds, "speed"), (accelerations, "acceleration")))
    plan = rates_prescription(mechanism, tuple(speeds), tuple(accelerations), hold)
    if not n:
        return motion.at_rates(motion.v, motion.a)
    if plan is not None:
        given = plan[0]
    else:
        with at_sample(0):
            given = _chosen_prescription(motion.state(0), [*v_of, *a_of], hold)[0]
    rates = np.zeros((2, n, len(given.driven) + len(given.still)))
    for target, of in zip(rates, (v_of, a_of), strict=True):
        for c, x in of.items():
            target[:, given.driven.index(c)] = x

    def at(state: State, row: int) -> tuple[Array, Array, Array]:
        own = [{name: np.asarray(x)[row] if np.ndim(x) > (
            len(rate_coordinates(mechanism, name)) > 1) else x for name, x in of.items()}
            for of in (speeds, accelerations)]  # of this sample, where there is one for each
        moving = solve_rates(mechanism, state, *own, hold=hold)
        known = moving.rate_error / _more_error(mechanism)
        return moving.v, moving.a, np.array([0.0, known, 0.0])

    v, a, facts = solved_by(
        motion, given, RATES, at, rates=(rates[0], rates[1]))
    return motion.at_rates(v, a, np.minimum(facts[:, 1] * _more_error(mechanism), 1.0))


def _solved(
    state: State, speeds: Mapping[str, Any], accelerations: Mapping[str, Any], hold: tuple[str, ...]
) -> list[Array] | None:
    """Return the `RATES` if the equations for them are clear; else None.

    Raises:
        ValueError: a rate is not a finite number.
    """
    mechanism = state.mechanism
    plan = rates_prescription(mechanism, tuple(speeds), tuple(accelerations), hold)
    if plan is None:
        return None
    values = [[finite_number(x, f"{what} of {name!r}") for name, x in rates.items()]
              for what, rates in (("speed", speeds), ("acceleration", accelerations))]
    with kernel_of(mechanism) as kernel:
        rates = plan[0].rates(kernel)
        for target, own, numbers in zip((rates.speeds, rates.accelerations), plan[1:], values,
                                        strict=True):
            target[:] = 0.0
            for index, value in zip(own, numbers, strict=True):
                target[index] = value
        return rates.solve(state.q, state.angles, RATES)


def _solved_by_trial(
    state: State, speeds: Mapping[str, Any], accelerations: Mapping[str, Any], hold: Hold
) -> list[Array]:
    """Return the `RATES` with a prescription found by trial.

    Raises:
        SingularError: none determines them.
        ValueError: a rate is not a finite number, is given twice, or is that of a fixed coordinate.
    """
    mechanism = state.mechanism
    v_of = rates_by_coordinate(mechanism, speeds, "speed")
    a_of = rates_by_coordinate(mechanism, accelerations, "acceleration")
    given, chosen = _chosen_prescription(state, [*v_of, *a_of], hold)
    with kernel_of(mechanism) as kernel:
        rates = given.rates(kernel)
        for target, of in ((rates.speeds, v_of), (rates.accelerations, a_of)):
            target[:] = 0.0
            target[: len(given.driven)] = [of.get(c, 0.0) for c in given.driven]
        solution = rates.solve(state.q, state.angles, RATES, chosen=chosen)
    assert solution is not None
    return solution


def _chosen_prescription(
    state: State, named: Sequence[Coordinate], hold: Hold
) -> tuple[Prescription, Chosen]:
    """Return the first prescription of named coordinates that determines rates; raises as above."""
    mechanism = state.mechanism
    check_unambiguous(mechanism, named)
    check_not_held(mechanism, named, hold)
    errors: list[SingularError] = []
    for driven in _choices(state, list(dict.fromkeys(named)), hold):
        given = Prescription.of(mechanism, driven, hold)
        try:
            return given, chosen_at(state, given)
        except SingularError as error:
            errors.append(error)
    raise errors[-1]


def check_finite(v: np.ndarray, a: np.ndarray, what: str) -> None:
    """Refuse infinite joint rates.

    Raises:
        ValueError: with `what` caused them.
    """
    if not (is_finite(v) and is_finite(a)):
        raise ValueError(f"{what} make joint rates larger than numbers can be")


def rate_error(driver: str, solved: bool, state: State, held: Hold = BASE) -> float:
    """Return the round-off of rates from a driver; NaN if it does not determine them.

    A path solves rates with its own closure equations. If others are redundant, these may be less
    accurate than equations chosen here; the difference shows in the rates. `solved`: whether rates
    were solved there, not continued across a branch point.
    """
    mechanism = state.mechanism
    given = prescription_by(mechanism, driver, hold_names(held))
    coordinate = mechanism.prescribed_coordinate(driver)
    at = given.driven.index(coordinate)
    moves = coordinate.q >= 0 and state.v[coordinate.v] != 0.0
    with kernel_of(mechanism) as kernel:
        rates = given.rates(kernel)
        rates.speeds[:], rates.accelerations[:] = 0.0, 0.0
        rates.speeds[at] = state.v[coordinate.v] if moves else 1.0
        rates.accelerations[at] = state.a[coordinate.v] if moves else 0.0
        solution = rates.solve(state.q, state.angles, RATES) if solved else None
        if solution is None:
            try:
                chosen = chosen_at(state, given)
            except SingularError:
                return float(np.nan)
            solution = rates.solve(state.q, state.angles, RATES, chosen=chosen)
    assert solution is not None
    v, a, facts = solution
    if not solved:
        return facts.item(2)
    lost = min(facts.item(1) * _more_error(mechanism), 1.0)
    if not moves:
        return lost
    size = mechanism.velocity_scale
    v, a = v / size, a / size
    pace = float(np.abs(v).max())
    bend = max(pace**2, float(np.abs(a).max()))
    return max(lost, 2.0 * float(np.abs(state.v / size - v).max()) / pace,
               2.0 * float(np.abs(state.a / size - a).max()) / bend)


def _more_error(mechanism: Mechanism) -> float:
    """Return by what errors of rates are larger far from the origin: coordinates have round-off."""
    return 1.0 + mechanism.extent.resolution / SOLUTION_ERROR


def check_rates(state: State, v: Array) -> None:
    """Refuse velocities (nv,) that open a loop, if redundant equations become independent.

    Raises:
        SingularError: with the closure that would open.
    """
    mechanism = state.mechanism
    with loops_of(mechanism, state.angles) as evaluation:
        evaluation.update(state.q)
        n, closure_of = evaluation.constraints.n_closure, evaluation.constraints.closure_of
        violation = np.abs(evaluation.jacobian[:n] @ (v / mechanism.velocity_scale))
    largest = np.abs(v / mechanism.velocity_scale).max(initial=0.0)
    if n and violation.max() > TOLERANCES.singular * max(largest, 1e-300):
        worst = closure_of[int(violation.argmax())]
        raise SingularError(
            f"mechanism {mechanism.name!r}: the prescribed rates would open closure "
            f"{worst!r}: they are inconsistent with the loops at {state}", state=state,
        )
