"""Inverse kinematics: drivers that put frames, coordinates and distances at given values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import counted
from spatial_pin._support.checks import checked
from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.assemble import starting_state
from spatial_pin.assembly.holding import BASE, Held, Hold, free_velocities, held_by
from spatial_pin.assembly.start_values import periodic
from spatial_pin.assembly.state import State
from spatial_pin.errors import ReachError
from spatial_pin.inverse_kinematics.named_targets import read_targets
from spatial_pin.inverse_kinematics.solving import Level, ReachResult, Solver
from spatial_pin.inverse_kinematics.targets import CoordinateValue, Target
from spatial_pin.kernel.closer import KernelTarget, closer_of, meet
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.coordinates import coordinate_value, require_mechanism
from spatial_pin.mechanism.joint_limits import JointLimit, is_within_limits, joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.least_squares import passed
from spatial_pin.numerics.linalg import Array, whole_turns
from spatial_pin.numerics.tolerances import TOLERANCES

EXACT = 1e-12  # residual of exact targets: about 100 times the round-off
START_SPREAD = 0.5  # largest displacement of near starts [rad, characteristic lengths]
# Number of distant starts per freedom and per near start. With these, every test target that 10
# near starts missed was reached: 5 starts for 2 or 3 joints, 30 for 6.
FAR_STARTS = 0.5
REACH_STEPS = 40  # damped steps of the kernel at most: it takes some five
LEG = 2.0  # path length between two far starts, for each freedom [rad, characteristic lengths]


@checked
def reach(
    mechanism: Mechanism,
    targets: Mapping[str, Any],
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    hold: Hold = BASE,
    limits: bool = True,
    starts: int = 10,
    state: Mapping[str, Any] | State | Array | None = None,
) -> State:
    """Return a configuration in which frames, coordinates and distances meet targets.

    This is inverse kinematics with closed loops: drivers and all other free coordinates are
    unknown. Of the configurations near the start that meet the targets, it is the one with the
    least sum of squares of joint displacements, in radians and characteristic lengths.

    Args:
        mechanism: the mechanism.
        targets: by name of a link, frame or joint: a point (3,) of the world for its origin [m], a
            `pinocchio.SE3` for its placement; by name of a coordinate or driver: its value [rad or
            m]; by name of another output with a position or angle, such as `tip.position.z`,
            `com.position.x`, `LINK.angle`: its value; or any of `spatial_pin.targets`, or a list of
            these: directions, distances, the centre of mass. Targets without a weight are exact;
            those with a weight are met as well as the exact ones allow.
        guess: start: a State, or a guess as for `assemble`; default the file's guess.
        hold: names of fixed coordinates, at their start values, as for `sweep`.
        limits: whether joint limits count; a start beyond them is moved within them.
        starts: number of other starts near the first one, if the targets, also weighted ones, are
            not met from it. After these come half as many per freedom that are far away, within
            joint limits. They are always the same. With 0, weighted targets are met as well as
            possible near the start, and fastest.
        state: another name of `guess`.

    Returns:
        A State without rates; `solve_rates` adds them.

    Raises:
        ReachError: the exact targets cannot be reached, or weighted ones are too far away to
            converge; it has the nearest configuration, the error of each target, and the obstacle.
        UnknownNameError: there is no such frame, coordinate or driver.
        AssemblyError: the guess does not close.
        TypeError: a target has an unknown type.
        ValueError: a number is not finite, or targets contradict each other.

    Example:
        >>> mech = sp.load("delta")
        >>> state = sp.reach(mech, {"platform": [0.1, 0.0, -0.9]})  # a point of the world [m]
        >>> [round(state.coordinate(name).value, 4) for name in mech.drivers]  # [rad]
        [-0.3467, -0.4714, -0.2211]
    """
    require_mechanism(mechanism)
    if starts < 0:
        raise ValueError(f"starts is {starts}; it is how many other starts are tried, 0 or more")
    wanted = read_targets(mechanism, targets)
    start = starting_state(mechanism, guess, state)
    mechanism = start.mechanism
    held = held_by(mechanism, hold)
    wanted += [CoordinateValue(c.name, value=coordinate_value(mechanism, c, start.q))
              for c in held.coordinates]
    reached = _nearest(start, wanted, held, limits)
    if reached is not None:
        return reached
    joint_bounds = joint_limits(mechanism) if limits else []
    with loops_of(mechanism, start.angles) as evaluation:
        solver = Solver(evaluation, wanted, joint_bounds, held.entries, exact_for(mechanism))
        best = _best(start, solver, starts)
        if not best.is_best(solver.tolerance) and not best.ran_out:
            best = _from_afar(start, solver, starts, best)
        if not best.is_met(solver.tolerance):
            best = solver.settled(best, start.q)
        solver.update(best.q)
        reached = State(mechanism, best.q, closure_error=evaluation.closure_error,
                        angles=evaluation.angles.copy())
        if not best.is_met(solver.tolerance) or best.ran_out:
            raise _short(start, solver, best, reached)
    return reached


def _nearest(
    start: State, wanted: Iterable[Target], held: Held, limits: bool
) -> State | None:
    """Return the state by the kernel's steps from the start, the nearest there.

    None where targets have weights or are of a kind that it does not know, or are not met so; or
    where it passes a joint limit.
    """
    mechanism, rows = start.mechanism, list[KernelTarget]()
    for target in wanted:
        own = target.for_kernel(mechanism) if target.weight is None else None
        if own is None:
            return None
        rows += own
    with closer_of(mechanism) as closer:
        met = meet(closer, start.q, _free(mechanism, held.entries), start.angles, rows, REACH_STEPS)
        if met is None:
            return None
        found, angles = met
        if found.may_be_mirrored or found.error > TOLERANCES.closed or (
                found.distance > exact_for(mechanism)) or (
                limits and not is_within_limits(mechanism, found.q)):
            return None
        return State(mechanism, found.q, closure_error=found.error, angles=angles)


@made_once
def _free(mechanism: Mechanism, still: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return which velocities may move (nv,)."""
    return free_velocities(mechanism, still, ())


def exact_for(mechanism: Mechanism) -> float:
    """Return the residual of exact targets, with the resolution of world coordinates."""
    return EXACT + 2.0 * mechanism.extent.resolution


def _best(start: State, solver: Solver, starts: int) -> ReachResult:
    """Return the best solution from a state or from others near it."""
    best = None
    for q in _starts(start, solver, starts):
        result = solver.solve(q, start.q)
        is_closed = solver.is_closed(result.q)
        if best is None:
            best = result if is_closed else solver.reached(start.q, {})
            if result.ran_out:
                break  # others near it have as far to go
        elif is_closed and result.is_nearer(best, solver.tolerance):
            best = result
        if best.is_best(solver.tolerance):
            break
    assert best is not None  # of the state itself
    return best


def _starts(state: State, solver: Solver, count: int) -> Iterable[Array]:
    """Yield start configurations: the state's own, then others near it."""
    yield state.q
    rng = np.random.default_rng(0)
    for _ in range(count):
        shaken = rng.uniform(-START_SPREAD, START_SPREAD, len(solver.scale))
        displacement = solver.scale * solver.moves * shaken
        yield pin.integrate(state.mechanism.model, state.q, displacement)


def _from_afar(start: State, solver: Solver, starts: int, best: ReachResult) -> ReachResult:
    """Return the best solution from far starts, or the known one if it is better.

    Among solutions that meet the exact targets, the best has the least weighted residuals, then the
    least motion. If only weighted targets are missed, the nearest starts come first, until `starts`
    in a row bring no gain: most such targets cannot be met at all.
    """
    def cost(result: ReachResult) -> tuple[float, float]:
        displacement = pin.difference(start.mechanism.model, start.q, result.q) / solver.scale
        return round(result.missed / TOLERANCES.nothing), float(np.linalg.norm(displacement))

    queue, most, in_vain = [*_far_starts(start, solver, starts)], np.inf, 0
    if best.is_met(solver.tolerance):
        queue, most = sorted(queue, key=lambda q: solver.reached(q, {}).missed), starts
    for q in queue:
        before = best
        for there in _solved(start, solver, q):
            if there.is_met(solver.tolerance) and best.is_met(solver.tolerance):
                best = min(best, there, key=cost)
            elif there.is_nearer(best, solver.tolerance):
                best = there
        in_vain = in_vain + 1 if best is before else 0
        if in_vain >= most:
            break
    return best


def _solved(start: State, solver: Solver, q: Array) -> Iterable[ReachResult]:
    """Yield the solution from a far start, and the one without whole turns."""
    result = solver.solve(q, start.q)
    back, ends = result.q.copy(), [result]
    for angle in periodic(start.mechanism) if result.is_met(solver.tolerance) else ():
        back[angle.q] -= whole_turns(back[angle.q] - start.q[angle.q])
    if not np.array_equal(back, result.q):
        ends.append(solver.solve(back, start.q))
    for there in ends:
        if solver.is_closed(there.q) and not (
                there.is_met(solver.tolerance) and there.ran_out):
            yield there


def _far_starts(state: State, solver: Solver, starts: int) -> Iterable[Array]:
    """Yield configurations of a random walk with closed loops, reflected at joint limits."""
    rng = np.random.default_rng(0)
    q, loops = solver.within(state.q)[0], Level(solver, [], [])
    freedom = len(solver.motions(q))

    def reflected(step: Array) -> Array:
        motions, room = solver.motions(q), solver.room(q)
        step = step @ motions.T @ motions
        for _ in range(len(step)):
            step = step * (TOLERANCES.damped_step / max(float(np.linalg.norm(step)),
                                                        TOLERANCES.zero))
            first = passed(room, step, {})
            if first is None:
                return step
            v = first[0]
            wall = motions[:, v] @ motions
            step = step - 2.0 * step[v] / wall[v] * wall
        return np.zeros_like(step)  # in a corner

    for _ in range(round(FAR_STARTS * starts * freedom)):
        step: Array = rng.standard_normal(len(solver.scale))
        for _ in range(round(LEG * freedom**0.5 / TOLERANCES.damped_step)):
            step = reflected(step)
            there = loops.corrected(solver.displaced(q, step), solver.moves, 0.0)
            if there is None:
                break
            q = there
        yield q


def _short(start: State, solver: Solver, result: ReachResult, state: State) -> ReachError:
    """Return the error with the nearest configuration and the obstacle."""
    mechanism, residuals = state.mechanism, dict[str, Array]()
    gaps = dict[str, tuple[float, float]]()
    for target in solver.weighted if result.is_met(solver.tolerance) else solver.exact:
        off = target.residual(solver.evaluation)[0]
        residuals[target.name] = np.append(residuals.get(target.name, ()), off)
        n = target.lengths(mechanism)
        n = len(off) if n is None else n
        length, angle = gaps.get(target.name, (0.0, 0.0))
        gaps[target.name] = math.hypot(length, *off[:n]), math.hypot(angle, *off[n:])
    lengths = {name: float(np.linalg.norm(x)) for name, x in residuals.items()}
    worst = max(lengths, key=lengths.__getitem__)
    length, angle = gaps[worst]
    far = length * mechanism.characteristic_length
    gap = [f"{far:.4g} m" if far >= 1.0 else f"{1e3 * far:.4g} mm"] * (length > EXACT)
    gap += [f"{angle:.4g} rad ({math.degrees(angle):.4g}°)"] * (angle > EXACT or not gap)
    reasons, stops = zip(*_stops(start, solver, result), strict=True)
    return ReachError(
        f"mechanism {mechanism.name!r}: the targets cannot be reached from there: {worst!r} stays "
        f"off by {' and '.join(gap)}; {'; '.join(stops)}",
        state=state, distances=lengths, residuals=residuals, stops=stops, reasons=reasons,
        limits=tuple(limit.name for limit in solver.limits_of(result.active)))


def _stops(start: State, solver: Solver, result: ReachResult) -> Iterable[tuple[str, str]]:
    """Yield obstacles before the targets: reasons of `ReachError`, and sentences."""
    steps_ran_out = ("steps", "it was still coming nearer when the steps ran out: go on from the "
                      "state of this error, or start nearer")
    if result.is_met(solver.tolerance):  # and weighted targets are far away
        yield steps_ran_out
        return
    if result.beyond:
        yield ("joint limit", f"it started beyond the {_words(result.beyond)}, and does not "
                   "come within from there: start from another state, or with limits=False")
        return
    if result.active:
        yield ("joint limit", "it is stopped by the " + _words(solver.limits_of(result.active)))
        return
    count = len(result.exact)
    slopes = [solver.slopes(q) for q in (
        result.q, *(solver.closed(x, solver.moves) for x in _starts(start, solver, 1)))]
    least = TOLERANCES.half_precision * max(s.max(initial=0.0) for s in slopes)
    rank, *others = (int(np.count_nonzero(s > max(least, TOLERANCES.zero))) for s in slopes)
    freedom = max(rank, *others)  # where it is not stretched out
    if not freedom:
        yield ("nothing moves", "no free coordinate moves them: hold fewer "
                   "coordinates, or choose another target")
    elif rank < freedom:
        reason = "dead centre" if freedom == 1 else "singular direction"
        configuration = "dead centre" if freedom == 1 else "singular configuration"
        yield (reason, f"it is stretched out or folded: at this {configuration} no motion takes it "
                   "further towards them")
    elif result.ran_out:
        yield steps_ran_out
    elif freedom < count:
        yield ("too few freedoms", f"it has {counted(freedom, 'freedom')} there for "
                   f"{count} numbers of the targets: give fewer, or give some a weight")
    else:
        yield ("nearest found", "this is the nearest that was found: start from another state")


def _words(limits: Iterable[JointLimit]) -> str:
    return " and the ".join(limit.words for limit in limits)
