"""Where the drivers must be for frames to be where they should: inverse kinematics."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.brief import counted
from spatial_pin._support.checks import checked
from spatial_pin.assembly.held_start import starting_state
from spatial_pin.assembly.holding import BASE, Hold, held_by
from spatial_pin.assembly.search.whole_turns import periodic
from spatial_pin.assembly.state import State
from spatial_pin.errors import ReachError
from spatial_pin.inverse_kinematics.named_targets import read_targets
from spatial_pin.inverse_kinematics.solving import Level, ReachResult, Solver
from spatial_pin.inverse_kinematics.targets import CoordinateValue
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.coordinates import coordinate_value, needed
from spatial_pin.mechanism.joint_limits import JointLimit, joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.angles import whole_turns
from spatial_pin.numerics.least_squares import passed
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

EXACT = 1e-12  # residual of what is to be exact: some hundred times what round-off leaves
START_SPREAD = 0.5  # rad, characteristic lengths: how far off near starts are, at most
# Far starts of each freedom for a near one. Of targets of arms with limits that ten near starts
# missed, all were met from the fifth far one with two and three joints, the thirtieth with six.
FAR_STARTS = 0.5
LEG = 2.0  # rad, characteristic lengths, of each freedom: from one far start to the next


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

    This is inverse kinematics with closed loops: drivers and all else that is free are unknown. Of
    the configurations near the start that meet the targets, it is the one that moves least: the
    sum of the squares of what the joints move, in radians and characteristic lengths, is least.

    Args:
        mechanism: the mechanism.
        targets: by name of a link, frame or joint: a point (3,) of the world for its origin [m], a
            `pinocchio.SE3` for its placement; by name of a coordinate or driver: its value [rad or
            m]; by name of another output that says where something is, as `tip.position.z`,
            `com.position.x`, `LINK.angle`: its value; or any of `spatial_pin.targets`, or a list of
            these: directions, distances, the centre of mass. Targets without a weight are met
            exactly, those with one as well as the exact ones leave freedom for.
        guess: where to start: a State, or what `assemble` takes; default the file's guess.
        hold: names of what stands still where the start has it, as for `sweep`.
        limits: whether joint limits are kept; a start beyond them is led back within them.
        starts: how many other states near it are tried, where the targets, those with a weight
            too, are not met from this one, and then half as many of each freedom that are far from
            it, within joint limits. They are always the same. With 0, weighted targets are met as
            well as can be near the start, and soonest.
        state: another word for `guess`.

    Returns:
        A State without rates; `solve_rates` gives it some.

    Raises:
        ReachError: the exact targets cannot be reached, or weighted ones are too far away to come
            to an end; has the nearest configuration, how far off each target is, and what stops it.
        UnknownNameError: there is no such frame, coordinate or driver.
        AssemblyError: the guess does not close.
        TypeError: a target is of no kind there is.
        ValueError: a number is not finite, or targets contradict each other.

    Example:
        >>> mech = sp.load("delta")
        >>> state = sp.reach(mech, {"platform": [0.1, 0.0, -0.9]})  # a point of the world [m]
        >>> [round(state.coordinate(name).value, 4) for name in mech.drivers]  # [rad]
        [-0.3467, -0.4714, -0.2211]
    """
    needed(mechanism)
    if starts < 0:
        raise ValueError(f"starts is {starts}; it is how many other starts are tried, 0 or more")
    asked = read_targets(mechanism, targets)
    start = starting_state(mechanism, guess, state)
    mechanism = start.mechanism
    held = held_by(mechanism, hold)
    asked += [CoordinateValue(c.name, value=coordinate_value(mechanism, c, start.q))
              for c in held.coordinates]
    kept = joint_limits(mechanism) if limits else []
    with loops_of(mechanism, start.angles) as evaluation:
        solver = Solver(evaluation, asked, kept, held.entries, exact_for(mechanism))
        best = _best(start, solver, starts)
        if not best.is_best(solver.tolerance) and not best.is_on_its_way:
            best = _from_afar(start, solver, starts, best)
        if not best.is_met(solver.tolerance):
            best = solver.settled(best, start.q)
        solver.stand(best.q)
        reached = State(mechanism, best.q, closure_error=evaluation.closure_error,
                        angles=evaluation.angles.copy())
        if not best.is_met(solver.tolerance) or best.is_on_its_way:
            raise _short(start, solver, best, reached)
    return reached


def exact_for(mechanism: Mechanism) -> float:
    """Return the residual of what is to be exact: a point of the world is known to its digits."""
    return EXACT + 2.0 * mechanism.extent.resolution


def _best(start: State, solver: Solver, starts: int) -> ReachResult:
    """Return the nearest place that solving leads to, from a state or others about it."""
    best = None
    for q in _starts(start, solver, starts):
        found = solver.solve(q, start.q)
        is_closed = solver.is_closed(found.q)
        if best is None:
            best = found if is_closed else solver.reached(start.q, {})
            if found.is_on_its_way:
                break  # others near it have as far to go
        elif is_closed and found.is_nearer(best, solver.tolerance):
            best = found
        if best.is_best(solver.tolerance):
            break
    assert best is not None  # of the state itself
    return best


def _starts(state: State, solver: Solver, count: int) -> Iterable[Array]:
    """Yield configurations to start from: the state's own, then others about it."""
    yield state.q
    rng = np.random.default_rng(0)
    for _ in range(count):
        shaken = rng.uniform(-START_SPREAD, START_SPREAD, len(solver.scale))
        way = solver.scale * solver.moves * shaken
        yield pin.integrate(state.mechanism.model, state.q, way)


def _from_afar(start: State, solver: Solver, starts: int, best: ReachResult) -> ReachResult:
    """Return the nearest place that solving from afar leads to, or a nearer one that is known.

    Of places where targets are met it is that of the least weighted residuals, then motion. Where
    only targets with a weight are not met yet, the starts nearest to them come first, until
    `starts` in a row have led to nothing better: most of such targets cannot be met at all.
    """
    def cost(found: ReachResult) -> tuple[float, float]:
        way = pin.difference(start.mechanism.model, start.q, found.q) / solver.scale
        return round(found.missed / TOLERANCES.nothing), float(np.linalg.norm(way))

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
    """Yield where solving from a far start leads to, and this without whole turns."""
    found = solver.solve(q, start.q)
    back, ends = found.q.copy(), [found]
    for angle in periodic(start.mechanism) if found.is_met(solver.tolerance) else ():
        back[angle.q] -= whole_turns(back[angle.q] - start.q[angle.q])
    if not np.array_equal(back, found.q):
        ends.append(solver.solve(back, start.q))
    for there in ends:
        if solver.is_closed(there.q) and not (
                there.is_met(solver.tolerance) and there.is_on_its_way):
            yield there


def _far_starts(state: State, solver: Solver, starts: int) -> Iterable[Array]:
    """Yield configurations along a walk with loops closed, thrown back by joint limits."""
    rng = np.random.default_rng(0)
    q, loops = solver.within(state.q)[0], Level(solver, [], [])
    freedom = len(solver.motions(q))
    strides = round(LEG * freedom**0.5 / TOLERANCES.damped_step)
    for _ in range(round(FAR_STARTS * starts * freedom)):
        way: Array = rng.standard_normal(len(solver.scale))
        for _ in range(strides):
            way = _stride(solver, q, way)
            there = loops.corrected(solver.displaced(q, way), solver.moves, 0.0)
            if there is None:
                break
            q = there
        yield q


def _stride(solver: Solver, q: Array, way: Array) -> Array:
    """Return the step (nv,) along a way, mirrored at the joint limits that it would pass."""
    motions, room = solver.motions(q), solver.room(q)
    way = way @ motions.T @ motions
    for _ in range(len(way)):
        way = way * (TOLERANCES.damped_step / max(float(np.linalg.norm(way)), TOLERANCES.zero))
        first = passed(room, way, {})
        if first is None:
            return way
        v = first[0]
        wall = motions[:, v] @ motions
        way = way - 2.0 * way[v] / wall[v] * wall
    return np.zeros_like(way)  # in a corner


def _short(start: State, solver: Solver, found: ReachResult, state: State) -> ReachError:
    """Return the error that tells how near it comes, and what stops it there."""
    mechanism, residuals = state.mechanism, dict[str, Array]()
    gaps = dict[str, tuple[float, float]]()
    for target in solver.weighted if found.is_met(solver.tolerance) else solver.exact:
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
    reasons, stops = zip(*_stops(start, solver, found), strict=True)
    return ReachError(
        f"mechanism {mechanism.name!r}: the targets cannot be reached from there: {worst!r} stays "
        f"off by {' and '.join(gap)}; {'; '.join(stops)}",
        state=state, distances=lengths, residuals=residuals, stops=stops, reasons=reasons,
        limits=tuple(limit.name for limit in solver.limits_of(found.active)))


def _stops(start: State, solver: Solver, found: ReachResult) -> Iterable[tuple[str, str]]:
    """Yield what stops a mechanism short of its targets: reasons of `ReachError`, and sentences."""
    on_its_way = ("steps", "it was still coming nearer when the steps ran out: go on from the "
                      "state of this error, or start nearer")
    if found.is_met(solver.tolerance):  # and what has a weight is far away
        yield on_its_way
        return
    if found.beyond:
        yield ("joint limit", f"it started beyond the {_words(found.beyond)}, and does not "
                   "come within from there: start from another state, or with limits=False")
        return
    if found.active:
        yield ("joint limit", "it is stopped by the " + _words(solver.limits_of(found.active)))
        return
    asked = len(found.exact)
    slopes = [solver.slopes(q) for q in (
        found.q, *(solver.closed(x, solver.moves) for x in _starts(start, solver, 1)))]
    least = TOLERANCES.half_precision * max(s.max(initial=0.0) for s in slopes)
    rank, *others = (int(np.count_nonzero(s > max(least, TOLERANCES.zero))) for s in slopes)
    freedom = max(rank, *others)  # where it is not stretched out
    if not freedom:
        yield ("nothing moves", "nothing that is free to move moves them: let go of what is "
                   "held, or ask for another")
    elif rank < freedom:
        reason = "dead centre" if freedom == 1 else "singular direction"
        place = "dead centre" if freedom == 1 else "singular configuration"
        yield (reason, f"it is stretched out or folded: at this {place} no motion takes it "
                   "further towards them")
    elif found.is_on_its_way:
        yield on_its_way
    elif freedom < asked:
        yield ("too few freedoms", f"it has {counted(freedom, 'freedom')} there for "
                   f"{asked} numbers asked for: ask for fewer, or give some a weight")
    else:
        yield ("nearest found", "this is the nearest that was found: start from another state")


def _words(limits: Iterable[JointLimit]) -> str:
    return " and the ".join(limit.words for limit in limits)
