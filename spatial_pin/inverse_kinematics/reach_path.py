"""Inverse kinematics along a path: motions in which frames and coordinates follow targets."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import counted
from spatial_pin._support.checks import checked
from spatial_pin._support.progress import progress_bar
from spatial_pin.assembly.assemble import starting_state
from spatial_pin.assembly.holding import (
    BASE,
    Hold,
    divided,
    free_bases,
    held_by,
    hold_names,
    is_base,
)
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.continuation.path_following import Followed
from spatial_pin.errors import Interrupted, ReachError, SingularError, SpatialPinError
from spatial_pin.inverse_kinematics.named_targets import read_targets
from spatial_pin.inverse_kinematics.reach import exact_for, reach
from spatial_pin.inverse_kinematics.solving import Solver
from spatial_pin.inverse_kinematics.target_coordinates import (
    Chain,
    TargetTable,
    chain_of,
    copy_at,
    law_of,
    stretches_of,
    tables_of,
    targets_at,
)
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.kernel.paths import PathSamples
from spatial_pin.mechanism.coordinates import require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.follow import along, finished, follow, sample_times
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.rounding import within_gap
from spatial_pin.numerics.linalg import Array, rank, singular_values
from spatial_pin.numerics.roots import sign_change
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.prescribed import driven_coordinates
from spatial_pin.rates.rates import check_not_held
from spatial_pin.settings import Accuracy, accuracy_of

UNEVEN = 3.0  # ratio of a step to the median beyond which earlier states are changed


class LeastMotionPath:
    """Configurations that meet targets sample by sample, with least motion.

    Attributes:
        states: the states so far.
    """

    def __init__(self, first: State, tables: list[TargetTable], hold: Hold) -> None:
        self.states, self._tables, self._hold = [first], tables, hold
        self._mechanism = first.mechanism

    def extend(self) -> None:
        """Add the next state, by least motion; if that fails, change the states before it.

        They are then spaced evenly, from as far back as needed.
        """
        k, model = len(self.states), self._mechanism.model
        try:
            self.states.append(self._reached(k, self.states[-1], 0))
            return
        except ReachError:
            goal = self._reached(k, self.states[-1], 10)
        best, last, back = [*self.states, goal], k - 1, 0
        steps = self._steps(best)
        while steps.max() > UNEVEN * np.median(steps) and back < last:
            back = min(max(1, 2 * back), last)
            since = last - back
            here, tried = self.states[since], self.states[: since + 1]
            try:
                for i in range(since + 1, k):
                    q = pin.interpolate(model, here.q, goal.q, (i - since) / (k - since))
                    near = State(self._mechanism, q, angles=here.angles)
                    tried.append(self._reached(i, near, 0))
            except ReachError:
                continue
            tried.append(goal)
            if self._steps(tried).max() < steps.max():
                best, steps = tried, self._steps(tried)
        self.states = best

    def _reached(self, k: int, near: State, starts: int) -> State:
        """Return the state at a sample's targets with least motion from another state."""
        return reach(self._mechanism, targets_at(self._tables, k), near, hold=self._hold,
                     starts=starts)

    def _steps(self, states: list[State]) -> Array:
        """Return the displacement from state to state [rad, characteristic lengths]."""
        model, scale = self._mechanism.model, self._mechanism.velocity_scale
        return np.array([np.linalg.norm(pin.difference(model, one.q, other.q) / scale)
                         for one, other in pairwise(states)])


def by_drivers(
    first: State, tables: list[TargetTable], times: Array | None, hold: Hold, accuracy: Accuracy,
    progress: bool,
) -> Motion:
    """Return the motion of least motion from sample to sample, drivers on cubic splines."""
    mechanism, path = first.mechanism, LeastMotionPath(first, tables, hold)
    if not mechanism.drivers:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: the targets do not determine the motion, and it has no "
            "drivers that would; give the targets of as many coordinates as are free")

    held = held_by(mechanism, hold).entries

    def motion() -> Motion:
        n = len(path.states)
        values = {d: np.array([x.coordinate(d).value for x in path.states])
                  for d in mechanism.drivers if mechanism.coordinate(d).v not in held}
        return follow(mechanism, values, np.arange(n, dtype=float) if times is None else times[:n],
                      guess=first, hold=hold, accuracy=accuracy, progress=progress)

    with progress_bar(len(tables[0]), f"{mechanism.name}: reach", progress) as bar:
        for k in range(1, len(tables[0])):
            try:
                path.extend()
            except ReachError as error:
                error.motion = motion()
                error.args = (f"sample {k}: {error}",)
                raise
            except KeyboardInterrupt as stopped:
                raise Interrupted(motion()) from stopped
            bar.update(1)
    return motion()


def _driver_singularities(
    states: Iterable[State], q: Array, angles: Array, s: Array, hold: Hold,
    between: Callable[[int, float], tuple[Array, Array]],
) -> list[tuple[float, int]]:
    """Return parameters with singular configurations of the second kind, and samples behind them.

    The drivers alone do not determine the motion there; a Gough platform can move with its legs
    locked. The equations without the columns of driven and fixed coordinates are a square matrix,
    whose determinant changes its sign there. A zero without a change of sign is not noticed, nor
    any if the drivers do not determine the motion elsewhere or are components of balls. Independent
    equations are chosen in one of the states. s (N,) is the parameter at the samples q (N, nq).
    `between` returns the configuration and angles at a parameter behind a sample.
    """
    chosen = next((x for state in states if (x := _undriven(state, hold)) is not None), None
                  ) if len(q) > 1 else None
    if chosen is None:
        return []
    (mechanism, rows, columns, passive), zeros = chosen, []
    with kernel_of(mechanism) as kernel:

        def jacobians(q: Array, angles: Array) -> Array:
            return kernel.jacobians_and_columns(q, angles)[0]

        def determinants(jacobians: Array) -> Any:
            return np.linalg.slogdet(np.concatenate(
                [jacobians[:, rows[:, None], columns],
                 np.broadcast_to(passive, (len(jacobians), *passive.shape))], axis=1))

        def jacobian(k: int, at: float) -> Array:
            return jacobians(*(x[None] for x in between(k, at)))

        signs, logarithms = determinants(jacobians(q, angles))
        known = np.flatnonzero(signs)
        for k, after in zip(known[:-1].tolist(), known[1:].tolist(), strict=True):
            if signs[k] == signs[after]:
                continue
            span = s[k], s[after]

            def determinant(at: float, k: int = k) -> float:
                sign, logarithm = determinants(jacobian(k, at))
                ratio = np.minimum(logarithm[0] - float(logarithms[k]), 50.0)
                return float(sign[0] * np.exp(ratio))

            zero = sign_change(determinant, *span, *map(determinant, span))
            # all equations must lose rank there, not only the chosen ones
            sizes = singular_values(jacobian(k, zero)[0][:, columns])
            if sizes[len(columns) - len(passive) - 1] < TOLERANCES.half_precision * sizes[0]:
                zeros.append((zero, int(np.searchsorted(s, zero))))
    return zeros


def _undriven(
    state: State, hold: Hold
) -> tuple[Mechanism, NDArray[np.intp], NDArray[np.intp], Array] | None:
    """Return rows and columns of the equations without driven and fixed coordinates.

    Also the mechanism, and rows (k, n) of unresolved passive freedoms. None if the drivers do not
    determine the motion at the state.
    """
    mechanism = state.mechanism
    driven, still = divided(mechanism, driven_coordinates(mechanism, mechanism.drivers), hold)
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
    return mechanism, rows.astype(np.intp), columns, passive


@checked
def reach_path(
    mechanism: Mechanism,
    targets: Mapping[str, Any],
    times: Any = None,
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    hold: Hold = BASE,
    accuracy: Accuracy | None = None,
    progress: bool = False,
    state: Mapping[str, Any] | State | Array | None = None,
) -> Motion:
    """Return the motion in which frames and coordinates follow tables of targets.

    The first targets are reached from a state like in `reach`, beyond joint limits only if the
    state meets them there already. From there one branch is followed, with the guarantees of
    `follow`. Between samples, positions and coordinates follow cubic splines, two times
    continuously differentiable ("not-a-knot" at the ends). Orientations have at the samples the
    rates of the cubic spline of their rotation vectors from the first one, which continue past half
    a turn.

    The path ends where the targets cannot be followed or do not determine the motion. A
    configuration in which the drivers do not determine the motion, such as a Gough platform turned
    by a right angle, is passed, with an event of kind "singular"; efforts grow without bound near
    it.

    If there are more freedoms than targets, each sample is reached from the one before with the
    least motion, within joint limits, and the drivers follow cubic splines through their values.
    The targets are met at the samples, and nearly met between them. If the least motion ends,
    stretched out or at joint limits, `reach` looks for a configuration at the next targets, and the
    samples before it are changed towards it.

    Args:
        mechanism: the mechanism.
        targets: by name of a link, frame or joint: points (N, 3) of the world for its origin [m],
            or N `pinocchio.SE3` for its placement; by name of a coordinate or driver, or of another
            output of one number (`tip.position.z`, `LINK.angle`): values (N,) [rad or m]. One
            placement, point or number is constant. A point or placement may not leave the plane of
            the frame's motion, or turn about other axes than the frame can. Centres of mass
            (`com.position`, `com.position.x`) are reached sample by sample.
        times: (N,) rising [s]. Without them the motion has no time: its rates are those per sample,
            and its forces are static.
        guess: start: a State, or a guess as for `assemble`; default the file's guess.
        hold: names of fixed coordinates, at their start values, as for `sweep`.
        accuracy: predictor order, corrections and tolerance; default "engineering".
        progress: show a bar on stderr after a second, if that is a terminal.
        state: another name of `guess`.

    Returns:
        The Motion, one row per sample, without a `driver`; `kinetostatics` gives the efforts along
        it. Its closure error includes the error of the targets, if they determine the motion.

    Raises:
        ReachError: the first targets cannot be reached, or there are more targets than freedoms;
            for a motion that targets do not determine, also later ones: it has the motion so far.
        LimitError: later targets cannot be reached; it has the last time, or number, and the motion
            so far.
        SingularError: the branch is not determined at a configuration, or crosses another one.
        UnknownNameError: there is no such frame, coordinate or driver.
        SpatialPinError: a frame turns too far from one sample to the next.
        Interrupted: after Ctrl-C; has the motion until then.
        TypeError: a table has an unknown type.
        ValueError: tables are not finite, or of different lengths, or times do not rise.

    Example:
        >>> mech = sp.load("delta")
        >>> line = np.linspace([0.0, 0.0, -0.9], [0.2, 0.0, -0.9], 5)  # (5, 3) [m]
        >>> motion = sp.reach_path(mech, {"platform": line}, times=np.linspace(0.0, 1.0, 5))
        >>> motion.coordinate("arm_1").value.round(4)  # (5,) [rad]
        array([-0.3586, -0.3556, -0.3467, -0.332 , -0.3115])
    """
    require_mechanism(mechanism)
    accuracy = accuracy_of(accuracy)
    tables = tables_of(mechanism, targets, 1 if times is None else np.size(times))
    n = len(tables[0])
    s = np.arange(n, dtype=float) if times is None else sample_times(times, n)
    held = hold_names(hold)
    check_not_held(mechanism, [mechanism.prescribed_coordinate(t.name) for t in tables
                               if t.is_coordinate], held)
    wanted = targets_at(tables, 0)
    start = starting_state(mechanism, guess, state)
    met = TOLERANCES.closed + 2.0 * start.mechanism.extent.resolution
    with loops_of(start.mechanism, start.angles) as evaluation:
        evaluation.update(start.q)
        is_met = all(np.linalg.norm(target.residual(evaluation)[0]) <= met
                     for target in read_targets(start.mechanism, wanted))
    first = reach(mechanism, wanted, start, hold=hold,
                  limits=(guess is None and state is None) or not is_met)
    freedom, chains = _chains(first, tables, s, hold)
    count = sum(chain.n for chain in chains)
    if count > freedom:
        raise _too_much(first, tables, count, freedom)
    moved = None if times is None else s
    if not count or not all(chain.has_closure for chain in chains):
        # it stands still, and free coordinates may as well; or no coordinate stands for a target
        return by_drivers(first, tables, moved, hold, accuracy, progress)
    try:
        followed = _followed(first, chains, s, hold, accuracy, progress)
    except SingularError:
        if count == freedom:
            raise
        return by_drivers(first, tables, moved, hold, accuracy, progress)
    motion = finished(first.mechanism, followed, moved, held, [t.name for t in tables], "targets")
    return within_gap(motion, accuracy, "raise")


def _chains(
    state: State, tables: list[TargetTable], s: Array, hold: Hold
) -> tuple[int, list[Chain]]:
    """Return the number of freedoms at a state, and the chains of the targets."""
    mechanism = state.mechanism
    size = mechanism.characteristic_length
    with loops_of(mechanism, state.angles) as evaluation:
        wanted = read_targets(mechanism, targets_at(tables, 0))
        held = held_by(mechanism, hold)
        solver = Solver(evaluation, wanted, [], held.entries, exact_for(mechanism))
        motions = solver.motions(state.q)
        chains = []
        for table in tables:
            rows = np.zeros((1, len(motions)))
            if table.first is not None:
                rows = table.first.residual(evaluation)[1] @ (motions * solver.scale).T
            elif table.points is not None:
                moved = evaluation.frame_jacobian(mechanism.frame_id(table.name)).copy()
                moved[:3] /= size
                rows = moved @ (motions * solver.scale).T
            chains.append(chain_of(table, s, rows, mechanism))
            own = rank(rows if table.rotations is not None else rows[:3],
                       TOLERANCES.half_precision)
            if not table.is_coordinate and chains[-1].n > own:
                raise _too_much(state, [table], chains[-1].n, own)
    return len(motions) - len(held.coordinates), chains


def _too_much(state: State, tables: list[TargetTable], count: int, freedom: int) -> ReachError:
    names = ", ".join(repr(t.name) for t in tables)
    return ReachError(
        f"mechanism {state.mechanism.name!r}: {names}: {count} numbers are wanted along the "
        f"path, but there {'are' if freedom != 1 else 'is'} {counted(freedom, 'freedom')} at its "
        "start; ask for fewer (a position instead of a placement, or a coordinate), or start "
        "beside a singular configuration", state=state,
        distances={t.name: 0.0 for t in tables}, residuals={}, limits=(),
        stops=("more is asked for than is free",), reasons=("too few freedoms",))


def _followed(
    state: State, chains: list[Chain], s: Array, hold: Hold, accuracy: Accuracy, progress: bool
) -> Followed:
    """Follow the targets from a state at the first of them."""
    mechanism = state.mechanism
    model, here, done = mechanism.model, state, 0
    samples = PathSamples.empty(len(s), model.nq, model.nv, len(state.angles))
    lost = list[tuple[float, int]]()
    title = f"{mechanism.name}: {', '.join(chain.table.name for chain in chains)}"
    for first, course in stretches_of(chains, len(s)):
        copy, names = copy_at(here, chains, first, course[0, 0])
        standing = _standing(copy, names, mechanism, hold)
        own = s[first : first + course.shape[1]]
        law = law_of(own, course)
        followed = along(copy, names, standing, law, own, accuracy, title, progress)
        done = first + followed.done
        into = samples.between(first, done)
        for part, new in zip(into, followed.samples.between(0, followed.done), strict=True):
            part[...] = new[:, : part.shape[1]] if part.ndim == 2 else new
        n = len(into.q)
        some = dict.fromkeys((0, n - 1, n // 2) if n else ())
        states = (State(mechanism, into.q[k], closure_error=into.error[k], angles=into.angles[k])
                  for k in some)
        between = partial(
            _between, copy.mechanism, names, (model.nq, len(state.angles)), standing, law, own,
            followed.samples)
        try:
            lost += [(at, row + first) for at, row in _driver_singularities(
                states, into.q, into.angles, own[: followed.done], hold, between)]
        except KeyboardInterrupt:
            return Followed(samples, done, None, undriven=lost, is_cut=True)
        if followed.stop is not None or followed.is_cut:
            return Followed(samples, done, followed.stop, undriven=lost, is_cut=followed.is_cut)
        here = State(mechanism, into.q[-1], closure_error=into.error[-1], angles=into.angles[-1])
    return Followed(samples, done, None, undriven=lost)


def _between(
    copy: Mechanism, names: list[str], sizes: tuple[int, int], standing: list[str], law: Any,
    s: Array, samples: PathSamples, k: int, at: float,
) -> tuple[Array, Array]:
    """Return the configuration (nq,) and angles at a parameter behind sample k of a segment.

    It is the sample's own if the finest accuracy cannot follow the path from there.
    """
    start = State(copy, samples.q[k], closure_error=samples.error[k], angles=samples.angles[k])
    q, angles = start.q, start.angles
    if at > s[k]:
        followed = along(start, names, standing, law, np.array([s[k], at]),
                         Accuracy.named("reference"), "", False)
        q, angles = (x[followed.done - 1] for x in (followed.samples.q, followed.samples.angles))
    return q[: sizes[0]], angles[: sizes[1]]


def _standing(copy: State, names: list[str], mechanism: Mechanism, hold: Hold) -> list[str]:
    """Return names of fixed coordinates for a copy without drivers.

    Coordinates that targets fix already, such as those out of a plane, are left out.
    """
    standing, independent = list[str](), list[str]()
    for name in hold_names(hold):
        if is_base(mechanism, name):
            standing += free_bases(mechanism)
        else:
            standing.append(mechanism.coordinate(name).name if name in mechanism.drivers else name)
    units = np.eye(copy.mechanism.model.nv)
    with loops_of(copy.mechanism, copy.angles) as evaluation:
        evaluation.update(copy.q)
        rows = np.vstack([evaluation.jacobian,
                          units[[copy.mechanism.coordinate(x).v for x in names]]])
    for name in standing:
        held = held_by(copy.mechanism, [name])
        more = np.vstack([rows, units[list(held.entries)]])
        if held.coordinates or rank(more, TOLERANCES.half_precision) > rank(
                rows, TOLERANCES.half_precision):
            independent.append(name)
            rows = more
    return independent
