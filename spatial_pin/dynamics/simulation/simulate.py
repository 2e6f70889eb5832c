"""Motion in time under forces, the loops closed exactly in every evaluation.

A mechanism that nothing holds is seen from a point that falls with its centre of mass. Seen from
there it has no weight, and is the same mechanism wherever it is and however fast it flies
[Goldstein2002, 1.2]: joint coordinates are integrated near the origin, where they have all their
digits. With r(t) = c + u t + g t²/2 the motion of the centre of mass, the energy is greater by
m u²/2 - m g c (Koenig), and that for all time.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from spatial_pin._support.checks import as_array, checked, positive_number
from spatial_pin._support.columns import read_only
from spatial_pin._support.progress import progress_bar
from spatial_pin.assembly.close import close
from spatial_pin.assembly.redundant_equations import independence_at
from spatial_pin.assembly.state import State, moving_in_time
from spatial_pin.dynamics.forces import Law, warn_of_no_inertia
from spatial_pin.dynamics.simulation.events import AT_LIMITS, EventDetector
from spatial_pin.dynamics.simulation.formulations import OpenLoopsError
from spatial_pin.dynamics.simulation.problem import EffortLaw, Problem, WrenchLaw, external_forces
from spatial_pin.dynamics.simulation.result import (
    Energies,
    LeastExchange,
    Projection,
    Simulation,
    driver_names,
    energy_drift,
)
from spatial_pin.dynamics.simulation.run import LOST_SHARE, NEARLY_DEPENDENT, Run
from spatial_pin.errors import (
    EnergyError,
    Interrupted,
    SingularError,
    SpatialPinError,
    StepLimitError,
)
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.coordinates import finite_array
from spatial_pin.mechanism.inertia import KineticEnergy
from spatial_pin.mechanism.laws import DriverLaw
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.motion.rounding import independent_on, within_gap
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, Accuracy, accuracy_of

__all__ = ["Projection", "Simulation", "simulate"]

# Least and greatest duration [s]: their squares divided by a tolerance are finite.
DURATIONS = 1e-100, 1e100
INTERVALS = 1000  # samples of a simulation without `times`, less one
TIGHTER = 30.0  # part of the tolerances that the other integration has, or
LOOSER = 10.0  # times the tolerances, where the other one would be
TIGHTEST = 1e-13  # tolerance of steps: round-off. Fixed steps are twice as long
COMPARED_STEP = 0.7  # its longest step, by the longest of the first
ERROR_MARGIN = 2.0  # times the difference: a more exact one is off a little itself
# Difference of rates, by the largest, from which on two motions tell nothing about a third one:
# differences that have grown as large as the motion grow no further.
UNRELATED = 0.5
ERROR_FLOOR = 1e-13  # error of any motion, as samples are closed to that


def is_in_free_fall(problem: Problem) -> bool:
    """Whether a mechanism falls freely: no joint, closure or force connects it with the ground.

    Efforts given as a function may act from the ground, so they exclude it.
    """
    mechanism, model = problem.mechanism, problem.model
    if "floating" not in mechanism.pairs:
        return False
    roots = _roots(mechanism)
    if any(mechanism.pairs[i - 1] != "floating" for i in roots):
        return False
    frames = [f for c in mechanism.closures for f in (*c.frames, *c.between)]
    frames += [f for spring in mechanism.springs for f in spring.frames]
    if any(mechanism.frame_on_joint(f)[0] == 0 for f in frames):
        return False
    own = np.concatenate([model.idx_vs[i] + np.arange(6) for i in roots])
    resistance = problem.forces.resistance
    held = [problem.constant[own], model.armature[own]]
    held += [resistance.damping[own], resistance.friction[own]] if resistance else []
    joints = {mechanism.model.names[i] for i in roots}
    driven = any(c.joint in joints for c, _ in problem.drives)
    return not (driven or problem.law or problem.external or any(np.any(x) for x in held)
                or not sum(body.mass for body in model.inertias) > 0.0)


def _roots(mechanism: Mechanism) -> list[int]:
    return [i for i, parent in enumerate(mechanism.model.parents) if i and not parent]


class FreeFall:
    """A mechanism in free fall, relative to its centre of mass.

    Args:
        state: where it begins.
        tolerance: closure residual to begin with there: far from the origin digits are lost.

    Attributes:
        mechanism: the same mechanism, weightless.
        state: the same state, relative to the centre of mass.
    """

    def __init__(self, state: State, tolerance: float) -> None:
        self._whole, model = state.mechanism, state.mechanism.centred_model
        self._data = model.createData()
        centre = pin.centerOfMass(model, self._data, state.q, state.v)
        self._start, self._speed = centre.copy(), self._data.vcom[0].copy()
        self._gravity = self._whole.model.gravity.linear.copy()
        mass = float(self._data.mass[0])
        self._energy = mass * float(0.5 * self._speed @ self._speed - self._gravity @ self._start)
        self._kinetic = KineticEnergy(model)(state.q, state.v)
        weightless = self._whole.model.copy()
        weightless.gravity = pin.Motion.Zero()
        self.mechanism = state.mechanism.with_fields(model=weightless)
        q, v, _ = self._shifted(0.0, state.q, state.v, state.a, -1.0)
        with loops_of(self.mechanism, state.angles) as evaluation:
            evaluation.update(q)
            if evaluation.closure_error > tolerance:
                q, _ = close(evaluation, q, np.ones(model.nv, dtype=bool), tolerance)
            self.state = State(self.mechanism, q, v, closure_error=evaluation.closure_error,
                               angles=evaluation.angles)

    def _shifted(
        self, t: float, q: Array, v: Array, a: Array, sense: float
    ) -> tuple[Array, Array, Array]:
        """Return q, v, a with the motion of the centre of mass added (1) or subtracted (-1)."""
        model, (q, v, a) = self._whole.model, (x.copy() for x in (q, v, a))
        speed = sense * (self._speed + self._gravity * t)
        away = sense * (self._start + (self._speed + 0.5 * self._gravity * t) * t)
        for i in _roots(self._whole):
            base, k, j = model.jointPlacements[i].rotation, model.idx_qs[i], model.idx_vs[i]
            turned = base @ pin.Quaternion(q[k + 3 : k + 7]).toRotationMatrix()
            u = turned.T @ speed
            q[k : k + 3] += base.T @ away
            v[j : j + 3] += u
            a[j : j + 3] += sense * (turned.T @ self._gravity) - np.cross(v[j + 3 : j + 6], u)
        return q, v, a

    def world_state(self, t: float, state: State) -> State:
        """Return a state, relative to the centre of mass, as a state in the world."""
        q, v, a = self._shifted(t, state.q, state.v, state.a, 1.0)
        return State(self._whole, q, v, a, closure_error=state.closure_error, angles=state.angles)

    def with_world_states(self, function: Callable[[float, State], Any] | None) -> Any:
        """Return a function of world States as one of States relative to the centre of mass."""
        if function is None:
            return None
        return lambda t, state: function(t, self.world_state(t, state))

    def motion(self, seen: Simulation, start: Energies, efforts: Array) -> Simulation:
        """Return a motion relative to the centre of mass as a motion in the world."""
        assert seen.time is not None
        rows = [self._shifted(*row, 1.0) for row in zip(
            seen.time.tolist(), seen.q, seen.v, seen.a, strict=True)]
        q, v, a = (np.array(x) for x in zip(*rows, strict=True)) if rows else (
            seen.q, seen.v, seen.a)
        energy = seen.energy + self._energy
        start = Energies(self._kinetic, start.total + self._energy, start.work)
        kinetic = np.array(list(map(KineticEnergy(self._whole.model), q, v)))
        return replace(
            seen, mechanism=self._whole, q=q, v=v, a=a, energy=energy,
            energy_drift=energy_drift(
                LeastExchange(self._whole, efforts), kinetic, energy, seen.work, start))


def _check_accuracy(accuracy: Accuracy, duration: float) -> None:
    if accuracy.formulation == "projected" and not INTEGRATORS[accuracy.integrator].is_one_step:
        known = [name for name, x in INTEGRATORS.items() if x.is_one_step]
        raise ValueError(f"integrator {accuracy.integrator!r} cannot be corrected after a step; "
                         f"for the projected formulation there are {', '.join(known)}")
    most = max(accuracy.most_steps, Accuracy.most_steps)
    if accuracy.step is not None and duration > most * accuracy.step:
        with np.errstate(over="ignore"):
            number = np.float64(duration) / accuracy.step
        raise ValueError(
            f"step is {accuracy.step:.3g} s: {duration:.6g} s would take {number:.2g} steps of it, "
            f"where {most} are allowed; take a longer step, a shorter duration, or "
            "Accuracy(most_steps=...)")


def _times(duration: float, times: Any) -> Array:
    duration = positive_number(duration, "duration")
    if not DURATIONS[0] <= duration <= DURATIONS[1]:
        raise ValueError(f"duration is {duration:.3g} s; from {DURATIONS[0]:g} s to "
                         f"{DURATIONS[1]:g} s can be simulated")
    if times is None:
        return np.linspace(0.0, duration, INTERVALS + 1)
    array = np.atleast_1d(as_array(times, "times"))
    array = finite_array(array, (array.size,), "times")
    if not array.size or array[0] < 0.0 or np.any(np.diff(array) <= 0.0) or array[-1] > duration:
        raise ValueError("times must rise from 0 at least to the duration at most")
    if 0.0 < array[-1] < DURATIONS[0]:
        raise ValueError(f"times end at {array[-1]:.3g} s; {DURATIONS[0]:g} s is the least but 0")
    return array


def _check_start(problem: Problem, state: State) -> None:
    """Refuse a state that does not start as the laws of its prescribed drivers do.

    Or where the force of a spring has no direction.
    """
    if problem.forces.lines:
        with loops_of(problem.mechanism, state.angles) as evaluation:
            evaluation.update(state.q)
            problem.forces.wrenches(evaluation, state.v)
    name, drivers = problem.mechanism.name, driver_names(problem.mechanism)
    for c, law in problem.drives:
        value, rate, _ = law(0.0)
        scale, driver = problem.scale[c.v], drivers.get(c.name, c.name)
        at, pace = (0.0 if abs(x) < 1e-12 * scale else x for x in (state.q[c.q], state.v[c.v]))
        if abs(value - state.q[c.q]) > 1e-9 * scale:
            raise SpatialPinError(
                f"mechanism {name!r}: the law of {driver} starts at {value:.9g} {c.unit}, the "
                f"state is at {at:.9g}: assemble it there")
        if abs(rate - state.v[c.v]) > 1e-9 * scale * (1.0 + abs(rate)):
            raise SpatialPinError(
                f"mechanism {name!r}: the law of {driver} starts with {rate:.9g} {c.unit}/s, the "
                f"state moves with {pace:.9g}: solve its rates")


@checked
def simulate(
    mechanism: Mechanism,
    state: State,
    duration: float,
    efforts: Mapping[str, float] | EffortLaw | None = None,
    times: Any = None,
    accuracy: Accuracy | None = None,
    *,
    drives: Mapping[str, DriverLaw] | None = None,
    external: Mapping[str, pin.Force | ArrayLike] | WrenchLaw | None = None,
    laws: Mapping[str, Law] | None = None,
    slip_speed: SlipSpeed | None = None,
    stop_when: Callable[[float, State], float] | None = None,
    on_joint_limit: str = "report",
    progress: bool = False,
) -> Simulation:
    """Simulate a mechanism in time.

    The equations of motion are solved in independent coordinates, chosen anew when others move
    faster; every evaluation closes the loops to `accuracy.tolerance`, so that nothing drifts. With
    one freedom, links that spin freely about a line of symmetry not counted, change points
    (branches that cross) are passed straight on, with an event. A mechanism that nothing holds, all
    its bodies hanging on floating joints, is solved relative to its falling centre of mass: far
    from the origin, and at any speed, it moves as it does at the origin. Where links without
    inertia come to a dead centre, beyond which one of them would have to be infinitely fast, the
    motion ends with an event of kind "singular" that names it.

    Args:
        mechanism: the mechanism.
        state: configuration and velocity at time 0, from `solve_rates`.
        duration: how long [s].
        efforts: by driver, joint or coordinate, constant, or a function (t, State) -> such a
            mapping [N·m about it, N along it]. Drivers are free unless they have a law in `drives`.
        times: (N,) rising times of the samples, default 0 to duration in 1000 steps [s].
        accuracy: integrator, its tolerance or step, and closure; default "engineering".
        drives: by driver or coordinate, a law (see `spatial_pin.laws`) that prescribes it.
        external: by link, frame or joint, the force on it at its origin, world axes: a `pin.Force`,
            or (N, 6) force then moment [N, N·m], whose rows belong to `times`, linear between; or
            a function (t, State) that returns `pin.Force`s so.
        laws: by spring, force as a function of (length, rate), see `forward_dynamics`.
        slip_speed: speed at which dry friction has 76 % of its full value, see `forward_dynamics`.
            Joints that friction should hold creep at a fraction of this speed.
        stop_when: ends the simulation where this function (t, State) crosses zero, with an event
            and a last sample there. It is evaluated at every sample and end of a step: two
            crossings between two of these pass unnoticed.
        on_joint_limit: where a joint passes a limit of the URDF: "report" to go on with an event
            of kind "joint limit", for nothing holds the joint back; "stop" to end there, with a
            last sample; "ignore". The time is located to about 1e-12 s. Velocities and efforts (of
            prescribed drivers, and those given) that pass their limits are events too, of kind
            "velocity limit" and "effort limit", unless limits are ignored.
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The Simulation, a Motion with energy, work and efforts; it ends before `duration` where
        an event says so.

    Raises:
        SingularError: the motion is not determined at some configuration; `.motion` holds what
            came before.
        EnergyError: a step would gain energy without work; `.motion` as well.
        StepLimitError: it would take more steps than `accuracy.most_steps`; `.motion` as well.
        SpatialPinError: the state does not fit the laws, or is beyond a joint limit at which the
            simulation is to stop, or the integrator gives up.
        Interrupted: after Ctrl-C; `.motion` holds what came before.
        UnknownNameError: a name does not exist.
        ValueError: a value is NaN or infinite, or times do not rise.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.assemble(mech, {"crank": 1.0})  # at rest
        >>> motion = sp.simulate(mech, state, 0.5, times=np.linspace(0.0, 0.5, 51))  # [s]
        >>> motion.coordinate("crank").value[[0, 25, 50]].round(4)  # [rad]
        array([ 1.    , -0.5695, -4.2174])
        >>> motion.energy_drift < 1e-8
        True
    """
    accuracy = accuracy_of(accuracy)
    state = moving_in_time(mechanism, state)
    times = _times(duration, times)
    _check_accuracy(accuracy, float(times[-1]))
    if on_joint_limit not in AT_LIMITS:
        raise ValueError(f"on_joint_limit is {on_joint_limit!r}; it is one of "
                         f"{', '.join(map(repr, AT_LIMITS))}")
    warn_of_no_inertia(state.mechanism, efforts, external)
    other = partial(
        simulate, mechanism, state, duration, efforts, times, drives=drives, external=external,
        laws=laws, slip_speed=slip_speed, stop_when=stop_when, on_joint_limit=on_joint_limit)

    def follow(start: State) -> Simulation:
        forces = efforts, drives, external_forces(start.mechanism, external, times), laws
        return _followed(start, times, accuracy, forces, slip_speed, stop_when, on_joint_limit,
                         progress, other)

    if state.mechanism.whole is None:
        return follow(state)
    return _of_rounded_file(state, accuracy, follow)


def _of_rounded_file(
    state: State, accuracy: Accuracy, follow: Callable[[State], Simulation]
) -> Simulation:
    """Return the motion of a mechanism with rounded numbers, as far as these allow.

    Its equations are chosen anew along the motion, see `Run`. The returned motion has the choice
    that is best for all of it.

    Raises:
        SingularError: the loops lose rank there with all equations.
    """
    try:
        seen, depend = follow(state), None
    except SingularError as error:
        if not (isinstance(error.motion, Simulation) and len(error.motion)):
            raise
        seen, depend = error.motion, len(error.motion)
        last = seen.state(-1)
        if independence_at(seen.mechanism, last.q, last.angles)[0] > NEARLY_DEPENDENT:
            raise
    if seen.mechanism is not state.mechanism and len(seen):
        seen.mechanism = independent_on(seen, accuracy, seen.v[-1])[0]
    seen = within_gap(seen, accuracy, "stop", start=state)
    return within_gap(seen, accuracy, "stop", depend, state)


def _followed(
    state: State, times: Array, accuracy: Accuracy, forces: tuple[Any, Any, Any, Any],
    slip_speed: SlipSpeed | None, stop_when: Callable[[float, State], float] | None,
    on_joint_limit: str, progress: bool, other: Callable[..., Simulation],
) -> Simulation:
    """Return the motion from a state, with the arguments of `simulate`.

    `forces` are efforts, drives, `ExternalForces` and laws; `other` follows it with another
    `accuracy`.
    """
    mechanism, (efforts, drives, external, laws) = state.mechanism, forces
    problem = Problem(
        mechanism, efforts, drives, laws, accuracy, slip_speed, external)
    _check_start(problem, state)
    fall = FreeFall(state, accuracy.tolerance) if is_in_free_fall(problem) else None
    if fall is not None:
        state, stop_when = fall.state, fall.with_world_states(stop_when)
        problem = Problem(fall.mechanism, efforts, drives, laws, accuracy, slip_speed)
    detector = EventDetector(problem, state, stop_when, on_joint_limit)
    run = Run(problem, accuracy, state, times, detector)

    def motion() -> Simulation:
        moved = run.motion() if fall is None else fall.motion(
            run.motion(), run.record.start, problem.constant)
        del moved.error_estimates
        moved.__dict__["_estimate"] = partial(error_estimates, lambda: other(
            accuracy=comparison(accuracy, run.longest_step)))
        return moved

    bar = progress_bar(float(times[-1]), f"{mechanism.name}: seconds", progress)
    try:
        for t in run.follow():
            bar.update(t - bar.n)
        moved = motion()
        if moved.energy_drift > LOST_SHARE:
            run.record.refuse_samples()
    except (OpenLoopsError, SingularError, StepLimitError) as error:
        if not run.record.end_without_inertia():
            raise _ended(error, run, motion(), fall) from None
        moved = motion()
    except EnergyError as error:
        error.motion = motion()
        raise
    except KeyboardInterrupt:
        raise (Interrupted(motion()) if run.record.filled else KeyboardInterrupt()) from None
    finally:
        bar.close()
    return moved


def _ended(
    error: OpenLoopsError | SingularError | StepLimitError, run: Run, moved: Simulation,
    fall: FreeFall | None,
) -> SpatialPinError:
    """Return the error of a motion that cannot be followed further, with the motion so far."""
    if isinstance(error, OpenLoopsError):
        return SingularError(
            f"mechanism {moved.mechanism.name!r}: the motion cannot be followed beyond "
            f"{run.t:.9g} s: {str(error) or run.why()}", motion=moved)
    error.motion = moved
    if fall is not None and isinstance(error, SingularError) and error.state is not None:
        error.state = fall.world_state(run.t, error.state)
    return error


def comparison(accuracy: Accuracy, longest: float) -> Accuracy:
    """Return the setting of the other integration of `error_estimates`; `longest` step [s]."""
    if INTEGRATORS[accuracy.integrator].is_fixed and accuracy.step is not None:
        return replace(accuracy, step=2.0 * accuracy.step)
    part = 1.0 / TIGHTER if accuracy.time_tolerance > TIGHTER * TIGHTEST else LOOSER
    step = COMPARED_STEP * longest if longest > 0.0 else accuracy.step
    return replace(accuracy, tolerance=part * accuracy.tolerance, step=step,
                   time_tolerance=part * accuracy.time_tolerance)


def error_estimates(run: Callable[[], Simulation], motion: Simulation) -> Array:
    """Return error estimates (N, 3) of the samples of a simulation, see `Motion.error_estimates`.

    Local errors of steps add up, and grow or decay as the motion is unstable or damped. A second
    integration shows that with all that acts. Its tolerance is a thirtieth, so that the difference
    is the error of the first but for a little [HairerNorsettWanner1993, II.4]. Near round-off no
    integration is more exact: there it is ten times as loose, and off by more. Its steps are
    shorter than the longest of the first, as a few long steps are often the same at any tolerance:
    they grow from a first one as fast as they may.

    They never fall: an error that has passed zero is none that has gone. They are infinite from
    where the other integration could not go on, or has nothing in common with the first any more.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other: Simulation | None
        try:
            other = run()
        except SpatialPinError as error:
            other = getattr(error, "motion", None)
    n = 0 if other is None else min(len(other), len(motion))
    errors = np.full((len(motion), 3), np.inf)
    scale = motion.mechanism.velocity_scale
    if n and other is not None:
        if motion.time is not None and other.time is not None:  # what stopped it may differ
            n -= int(motion.time[n - 1] != other.time[n - 1])
        steps = [pin.difference(motion.mechanism.model, motion.q[k], other.q[k]) for k in range(n)]
        gaps = (np.array(steps).reshape(n, -1), motion.v[:n] - other.v[:n],
                motion.a[:n] - other.a[:n])
        for k, gap in enumerate(gaps):
            errors[:n, k] = ERROR_MARGIN * np.abs(gap / scale).max(axis=1, initial=0.0)
        v, a = (np.abs(x / scale).max(initial=0.0) for x in (motion.v, motion.a))
        errors[:n][errors[:n, 1] > ERROR_MARGIN * UNRELATED * v] = np.inf
        errors[:n] += ERROR_FLOOR * np.array([1.0, v, max(a, v * v)])
    return read_only(np.maximum.accumulate(errors, axis=0))
