"""Events of a simulation: joint limits, rated limits, its early end, and why it ends there.

It ends at a zero of `stop_when`, and where the inertia of its motion vanishes: links without
inertia would have to be infinitely fast there. An example is the dead centre of a crank and a rod
without inertia: the slider cannot go on, and only it has momentum. Near such a configuration the
inertia of the motion, per square of the fastest speed, falls to zero in proportion to the remaining
time, and so do the steps of an integrator. Every body counts with inertias of size one: light
bodies turn slowly, but turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.checks import finite_number
from spatial_pin.assembly.state import State
from spatial_pin.constraints.kernel_tree import KernelTree
from spatial_pin.dynamics.forces import joint_efforts
from spatial_pin.dynamics.simulation.formulations import IndependentFormulation
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.solvers.least_constraint import IndependentCoordinates
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations, loops_at
from spatial_pin.mechanism.inertia import KineticEnergy, inertia_as_given
from spatial_pin.mechanism.joint_limits import SLACK, JointLimit, joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.limit_events import (
    NOISE,
    Passing,
    RatedLimit,
    effort_limits,
    first_passing,
    passed_at_start,
    velocity_limits,
)
from spatial_pin.motion.motion import Event
from spatial_pin.numerics.linalg import Array, decompose, independent_rows
from spatial_pin.numerics.roots import sign_change
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy

StopFunction = Callable[[float, State], float]
NEAR_LIMIT = 0.5  # from this part of a limit on it is also checked between the ends of a step
BETWEEN = (0.25, 0.5, 0.75)  # parts of a step at which it is checked
AT_LIMITS = ("report", "stop", "ignore")
SINGULAR = "singular"  # kind of the event where inertia vanishes
# Inertia of a motion, relative to that of its bodies, at which the mechanism is singular: steps
# are a millionth of the usual there.
NEGLIGIBLE = 1e-6
SMALL = 1e-2  # the same relative to the largest inertia before, where a motion cannot be continued
SHORTENED = 1e-4  # the inertia is checked at steps below this part of the longest step
DECREASED = 0.8  # the inertia is checked again after it fell by this factor
# Distance to the point where the inertia vanishes, in distances between the last two checks.
CLOSE_BY = 3.0
FALLEN = 1e-3  # a singular value that fell to this part of its first value goes to zero


class IntegrationStep:
    """The last step of an integrator, with the interpolant between its ends.

    Attributes:
        system: as given.
        first, last: when it begins and ends [s].
        end: (n,) unknowns there.
    """

    def __init__(self, system: IndependentFormulation, solver: Any) -> None:
        self.system, self._solver, self.end = system, solver, np.array(solver.y)
        self._dense: Callable[[Any], Array] | None = None
        self.first, self.last = float(solver.t_old), float(solver.t)

    def unknowns(self, times: Array) -> Array:
        """Return the unknowns (N, n) at times (N,)."""
        if self._dense is None:
            self._dense = self._solver.dense_output()
        return self._dense(times).T

    def _at(self, t: float) -> Array:
        return self.end if t == self.last else self.unknowns(np.array([t]))[0]

    def motion_at(self, t: float) -> tuple[Array, Array]:
        """Return configuration (nq,) and velocity (nv,) at a time."""
        return self.system.motion_at(t, self._at(t))

    def state(self, t: float) -> State:
        """Return the State at a time."""
        return self.system.state(t, self._at(t))

    def efforts(self, t: float) -> Array:
        """Return the efforts of prescribed drivers at a time."""
        return self.system.samples(np.array([t]), self._at(t)[None]).efforts[0]


class RatedLimits:
    """Velocity and effort limits during a simulation.

    Efforts are those of prescribed drivers, and those of a function. Constant efforts are checked
    once, at the start.

    Attributes:
        at_start: events of limits that it is beyond from the start.
        velocities: the limits of velocities.
        checks_efforts: whether some effort with a limit varies.
    """

    def __init__(self, problem: Problem, state: State) -> None:
        self.problem = problem
        by_v = {limit.v: limit for limit in effort_limits(problem.mechanism)}
        self.velocities = velocity_limits(problem.mechanism)
        self._given = list(by_v.values()) if problem.law is not None else []
        drives = enumerate(c.v for c, _ in problem.drives)
        self._driven = [(k, by_v[v]) for k, v in drives if v in by_v]
        self.checks_efforts = bool(self._given or self._driven)
        constant = [(limit, problem.constant[limit.v]) for limit in by_v.values()]
        moving = [(limit, state.v[limit.v]) for limit in self.velocities]
        self.at_start = [Event(limit.kind, 0.0, 0, f"beyond the {limit.words} from the start")
                         for limit, x in (*constant, *moving) if limit.excess(x) > 0.0]

    def passed(self, step: IntegrationStep) -> list[tuple[float, RatedLimit]]:
        """Return the limits passed outwards in a step, with the times, in their order."""
        limits = [*self.velocities, *self._given, *(limit for _, limit in self._driven)]
        if not limits:
            return []
        crossings = []
        first, last = step.first, step.last
        between = [first + part * (last - first) for part in BETWEEN]
        ends = zip(self._excesses(step, first), self._excesses(step, last), strict=True)
        for k, (limit, (before, after)) in enumerate(zip(limits, ends, strict=True)):
            if before > 0.0:
                continue

            def excess(t: float, k: int = k) -> float:
                return float(self._excesses(step, t)[k])

            end = last
            if not after > 0.0 and max(before, after) > -NEAR_LIMIT:
                inside = ((t, excess(t)) for t in between)
                end, after = next(((t, x) for t, x in inside if x > 0.0), (last, after))
            if after > 0.0:
                t = sign_change(excess, first, end, float(before), float(after))
                crossings.append((t, limit))
        return sorted(crossings, key=lambda pair: pair[0])

    def _excesses(self, step: IntegrationStep, t: float) -> Array:
        """Return the excesses over all limits, relative to the limits."""
        v = step.motion_at(t)[1]
        pairs = [(limit, v[limit.v]) for limit in self.velocities]
        if self._given and self.problem.law is not None:
            given = joint_efforts(self.problem.mechanism, self.problem.law(t, step.state(t)))
            pairs += [(limit, given[limit.v]) for limit in self._given]
        if self._driven:
            efforts = step.efforts(t)
            pairs += [(limit, efforts[k]) for k, limit in self._driven]
        return np.array([float(limit.excess(x)) / limit.value for limit, x in pairs])


def _stop_value(stop_when: StopFunction, t: float, state: State) -> float:
    value: Any = stop_when(t, state)
    return finite_number(value.item() if np.size(value) == 1 and isinstance(value, np.ndarray)
                         else value, f"what stop_when returns at {t:.6g} s")


class VanishingInertia:
    """Detects configurations at which a motion has no inertia."""

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism, self._scale = mechanism, mechanism.velocity_scale
        self._checks: list[tuple[float, float]] = []  # times and inertias, three at most

    @cached_property
    def _energy(self) -> KineticEnergy | None:
        """Kinetic energies with inertias of size one; None if every motion has inertia."""
        model, length = self._mechanism.model.copy(), self._mechanism.characteristic_length
        has_none = False
        for joint in range(1, model.njoints):
            body = model.inertias[joint]
            size = body.mass * length**2 + float(np.trace(body.inertia))
            least = min(body.mass * length**2, float(np.linalg.eigvalsh(body.inertia)[0]))
            has_none |= not least > TOLERANCES.nothing * size
            if size > 0.0:
                model.inertias[joint] = inertia_as_given(
                    body.mass / size, body.lever, body.inertia / size)
        model.armature = (model.armature > 0.0) / self._scale**2
        return KineticEnergy(model) if has_none else None

    def inertia(self, q: Array, v: Array) -> float:
        """Return the inertia of the motion v (nv,) at q (nq,), infinite if it cannot vanish."""
        square = float(np.square(v / self._scale).sum())
        if self._energy is None or not square > 0.0:
            return np.inf
        return self._energy(q, v) / square

    def vanishes_after_step(self, t: float, q: Array, v: Array, shortened: float) -> bool:
        """Whether the inertia vanishes soon after a step that ends at t, q (nq,) and v (nv,).

        The step is `shortened` relative to the longest so far.
        """
        inertia = self.inertia(q, v) if shortened < SHORTENED else np.inf
        if not inertia < NEGLIGIBLE or (self._checks and inertia > self._checks[-1][1]):
            self._checks.clear()
            return False
        if not self._checks or inertia < DECREASED * self._checks[-1][1]:
            self._checks = [*self._checks[-2:], (t, inertia)]
        return _falls_to_zero(self._checks)

    def vanishes_after_samples(self, times: Array, q: Array, v: Array) -> bool:
        """Whether the inertia vanishes soon after the last of N samples (N, nq) and (N, nv).

        For a motion that cannot be followed; steps of any length count.
        """
        inertias = [self.inertia(*row) for row in zip(q, v, strict=True)]
        most = max((x for x in inertias if np.isfinite(x)), default=0.0)
        return bool(inertias and inertias[-1] < SMALL * most
                    and _falls_to_zero([*zip(times.tolist(), inertias, strict=True)][-3:]))

    def words(self, t: float, q: Array, v: Array) -> str:
        """Return a sentence for the event of a motion that ends at a time [s]."""
        model, length = self._mechanism.model, self._mechanism.characteristic_length
        data = model.createData()
        pin.forwardKinematics(model, data, q, v)
        pace = [float(np.linalg.norm(x.vector * np.repeat([1.0 / length, 1.0], 3)))
                for x in data.v]
        joint = int(np.argmax(pace))
        link = next((f.name for f in model.frames if f.type == pin.FrameType.BODY
                     and f.parentJoint == joint), model.names[joint])
        return (f"dead centre of a link without inertia at {t:.12g} s: the link {link!r} "
                "would have to become infinitely fast")


def _falls_to_zero(looks: Sequence[tuple[float, float]]) -> bool:
    """Whether three falling values extrapolate to zero soon, by a parabola in time.

    Values of a motion that only passes near a singular configuration do not.
    """
    if len(looks) < 3:
        return False
    times, values = np.array(looks).T
    if not values[0] > values[1] > values[2]:
        return False
    along, parts = (times - times[2]) / (times[2] - times[0]), values / values[0]
    zeros = np.roots(np.linalg.solve(np.vander(along, 3), parts))
    return bool(np.any((zeros.imag == 0.0) & (zeros.real > 0.0) & (zeros.real < CLOSE_BY)))


class EventDetector:
    """Detects the events in the steps of a simulation.

    Attributes:
        at_start: joint limits beyond which it starts.
        bounds: limits of coordinates for the kernel's steps, by the names in `RunStruct`: entries
            of q and v; side (1 upper, -1 lower, 0 of the velocity); limit value; and distance to
            the limit and its closing speed at the end of the last step.
        always: whether every step must be checked in Python.
        inertia: of the motion.

    Raises:
        SpatialPinError: it is to stop at joint limits but starts beyond one.
        ValueError: `stop_when` returns no number.
    """

    def __init__(
        self, problem: Problem, state: State, stop_when: StopFunction | None, on_joint_limit: str
    ) -> None:
        self.stop_when, self.on_joint_limit = stop_when, on_joint_limit
        self._scale = problem.mechanism.velocity_scale
        ignored = on_joint_limit == "ignore"
        self.limits = [] if ignored else joint_limits(problem.mechanism)
        self.at_start: list[Passing] = (
            [] if ignored else passed_at_start(problem.mechanism, state.q, 0.0))
        if on_joint_limit == "stop" and self.at_start:
            raise SpatialPinError(
                f"mechanism {problem.mechanism.name!r}: the state is beyond the "
                f"{self.at_start[0].limit.words}, where the simulation is to stop: start inside "
                "(assemble(limits=True)), or give on_joint_limit=\"report\"")
        self.rated = None if ignored else RatedLimits(problem, state)
        table = [(x.q, x.v, x.side, x.value + x.side * SLACK * x.size,
                  float(x.room(state.q)) + SLACK * x.size, float(x.closing(state.v)))
                 for x in self.limits]
        table += [(0, x.v, 0, x.value * (1.0 + SLACK), -float(x.excess(state.v[x.v])), 0.0)
                  for x in (self.rated.velocities if self.rated else ())]
        columns = np.array(table, float).reshape(-1, 6)
        q, v, side = (x.astype(np.int64) for x in columns[:, :3].T)  # contiguous, as C reads it
        self.bounds: dict[str, NDArray[Any]] = {
            "limit_q": q, "limit_v": v, "limit_side": side,
            "limit_value": columns[:, 3].copy(), "limit_before": columns[:, 4:].copy()}
        self.always = bool(stop_when or (self.rated and self.rated.checks_efforts))
        self.inertia = VanishingInertia(problem.mechanism)
        self._last = 0.0 if stop_when is None else _stop_value(stop_when, 0.0, state)

    def events_in_step(self, step: IntegrationStep, times: Array, shortened: float) -> tuple[
            list[tuple[float, JointLimit]], list[tuple[float, RatedLimit]], Event | None]:
        """Return the events in a step with samples at times (N,), see `vanishes_after_step`.

        Returns:
            The joint limits passed, with the times; velocity and effort limits alike; and the event
            that ends the simulation, None if nothing does.
        """
        passed = self._passed(step)
        rated = self.rated.passed(step) if self.rated else []
        stop, text, kind = self._crossed(step, times), "", "stopped"
        if passed and self.on_joint_limit == "stop" and (stop is None or passed[0][0] <= stop):
            stop, limit = passed[0]
            text = f" by the {limit.words}"
        if stop is None:
            at = (step.last, *step.motion_at(step.last))
            if not self.inertia.vanishes_after_step(*at, shortened):
                return passed, rated, None
            stop, kind, text = step.last, SINGULAR, self.inertia.words(*at)
        else:
            text = f"stopped at {stop:.12g} s{text}"
        return ([p for p in passed if p[0] <= stop], [p for p in rated if p[0] <= stop],
                Event(kind, stop, 0, text))

    def _passed(self, step: IntegrationStep) -> list[tuple[float, JointLimit]]:
        """Return the joint limits passed in a step, in the order of the times."""
        if not self.limits:
            return []
        ends = step.motion_at(step.first), step.motion_at(step.last)
        noise = NOISE * float(np.abs(np.array([v for _, v in ends]) / self._scale).max())
        times = [(first_passing(limit, step.motion_at, (step.first, step.last), ends, noise), limit)
                 for limit in self.limits]
        return sorted(((t, limit) for t, limit in times if t is not None), key=lambda x: x[0])

    def _crossed(self, step: IntegrationStep, times: Array) -> float | None:
        """Return the first zero of `stop_when` in a step; signs are those at samples and end."""
        function = self.stop_when
        if function is None:
            return None
        before, since, time = self._last, step.first, None
        for t in sorted({*times.tolist(), step.last}):
            value = _stop_value(function, t, step.state(t))
            if before and (value <= 0.0 if before > 0.0 else value >= 0.0):
                time = sign_change(lambda t: _stop_value(function, t, step.state(t)),
                                    since, t, before, value)
                break
            before, since = value, t
        self._last = value
        return time

    def reset(self) -> None:
        """Let the kernel pause at the next step: the last step is repeated."""
        self.bounds["limit_before"][:] = np.inf


def why_it_ends(problem: Problem, accuracy: Accuracy, first: State, t: float, last: State) -> str:
    """Return why a motion from State `first` cannot be followed beyond t [s], as text.

    The loops are looked at first, then the forces, then the masses: each makes what comes after
    it look bad too.
    """
    lost = _lost_rank(problem, first, last)
    if lost:
        return lost
    with np.errstate(all="ignore"):
        start, _, _ = _accelerations(problem, 0.0, first)
        a, error, given = _accelerations(problem, t, last)
        reason = (_forces(problem, start, last.q, a, given)
                 or _masses(problem, accuracy, start, a, error))
    return reason or (
        f"steps however short miss the time_tolerance of {accuracy.time_tolerance:.1e}, though "
        "loops, masses and the size of forces are well there: a force law that jumps or is "
        "not smooth does that; make it smooth, or take Accuracy(integrator='RK4', step=...)")


def _accelerations(problem: Problem, t: float, state: State) -> tuple[Array, float, Array]:
    """Return the accelerations (nv,) of least constraint, which hold for any masses.

    With their round-off, relative to the largest of them, and the joint forces (nv,) given.
    """
    evaluation, loops, rows = _rows(problem, state)
    picked = independent_rows(rows)
    motions = IndependentCoordinates(rows[picked], problem.scale, evaluation.closure_error)
    q, v = state.q, state.v
    bias = np.array([*evaluation.bias(q, v)[: len(loops)],
                     *(-law(t)[2] / problem.scale[c.v] for c, law in problem.drives)])
    given = problem.joint_forces(t, q, v, evaluation)
    least = problem.least_constraint.solve(
        q, v, motions.carried(bias[picked], v), motions.columns, given)
    return least.a, 1.0 if least.lost else least.error, given


def _rows(problem: Problem, state: State) -> tuple[LoopEquations, Array, Array]:
    """Return an evaluation at a state, the closure rows, and these with the prescribed rows."""
    evaluation = loops_at(problem.mechanism, state.q, state.angles)
    loops = evaluation.jacobian[: evaluation.constraints.n_closure].copy()
    drives = np.eye(problem.model.nv)[[c.v for c, _ in problem.drives]]
    return evaluation, loops, np.vstack([loops, drives])


def _lost_rank(problem: Problem, first: State, last: State) -> str:
    before, now = (_rows(problem, state)[1:] for state in (first, last))
    fallen = []
    for rows, there, part in zip(before, now, (FALLEN, FALLEN**0.5), strict=True):
        # at a limit position of a coordinate, a singular value falls as the root of the distance
        rank = len(independent_rows(rows))
        least = _least(rows, rank), _least(there, rank)
        hides = least[1] < TOLERANCES.half_precision < least[0]  # all that is known of rates
        fallen.append(hides or least[1] < part * least[0])
        numbers = (f"the smallest singular value has fallen from {least[0]:.1e} to "
                   f"{least[1]:.1e} of the largest")
        if fallen == [True]:
            return (f"just ahead the loops lose rank ({numbers}), and forces do not determine how "
                    "it goes on there; end before it, or start so that it is not met; "
                    "sp.mobility tells about it")
    if not fallen[1] or not problem.drives:
        return ""
    names = ", ".join(c.name for c, _ in problem.drives)
    return (f"just ahead is a limit position of the prescribed {names}: with it held the loops "
            f"lose rank ({numbers}); end before it, or prescribe another coordinate")


def _least(rows: Array, rank: int) -> float:
    """Return singular value number `rank`, relative to the largest; 1 for rank 0."""
    s = decompose(rows).s
    return float(s[rank - 1] / s[0]) if rank else 1.0


def _masses(
    problem: Problem, accuracy: Accuracy, start: Array, a: Array, error: float
) -> str:
    if error > accuracy.time_tolerance:
        grown = f"accelerations are known to {error:.1e} of their size only"
    elif _have_grown(problem, start, a):  # not by forces
        at = int(np.abs(a / problem.scale).argmax())
        c = list(problem.mechanism.coordinate_table.values())[at]
        grown = (f"{c.name} is accelerated by {a[at]:.3g} {c.unit}/s² (at the start "
                 f"{start[at]:.3g}), though no effort or spring pulls")
    else:
        return ""
    model = problem.model
    moved = sorted((body.mass, joint) for joint, body in enumerate(model.inertias)
                   if joint and body.mass > 0.0)
    words = [f"{mass:.3g} kg (moved by joint {model.names[joint]!r})" for mass, joint in moved]
    light, heavy = (words[0], words[-1]) if words else ("no mass", "no mass")
    if light == heavy:
        return (f"links have no inertia: {grown}; the only body with a mass has {light}; give the "
                "links that it moves some")
    return (f"masses differ too much: {grown}; the lightest body has {light}, the heaviest "
            f"{heavy}; make the masses more alike, or the light ones zero")


def _have_grown(problem: Problem, start: Array, a: Array) -> bool:
    """Whether accelerations are far beyond those at the start."""
    before, now = (np.abs(x / problem.scale).max(initial=0.0) for x in (start, a))
    return bool(FALLEN * now > before)


def _forces(problem: Problem, start: Array, q: Array, a: Array, given: Array) -> str:
    units = problem.scale
    if not np.isfinite(a).all():
        return ("the accelerations there are no finite numbers: look at the force laws and at how "
                "fast it moves")
    needed = KernelTree(problem.model).mass_matrix(q) @ a * units
    have_part = np.abs(given * units).max(initial=0.0) > FALLEN * np.abs(needed).max(initial=0.0)
    if not (_have_grown(problem, start, a) and have_part):
        return ""
    at, pulled = int(np.abs(a / units).argmax()), int(np.abs(given * units).argmax())
    table = list(problem.mechanism.coordinate_table.values())
    moves, pulls = table[at], table[pulled]
    force = f"a force of {given[pulled]:.3g} {'N' if pulls.unit == 'm' else 'N·m'} at {pulls.name}"
    return (f"forces grow without bound: {moves.name} is accelerated by {a[at]:.3g} "
            f"{moves.unit}/s² (at the start {start[at]:.3g}), and efforts, springs and friction "
            f"make {force}; bound the force law there, or end before with stop_when=")
