"""What a simulation is of: forces, driver laws, and coordinates that can be independent."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.checks import mapping
from spatial_pin.assembly.close import close
from spatial_pin.assembly.state import State
from spatial_pin.assembly.undetermined import lost_rank_words, rank_loss
from spatial_pin.constraints.kernel_tree import is_large
from spatial_pin.dynamics.forces import (
    Forces,
    Law,
    external_wrenches,
    forces_on_frames,
    generalised,
    joint_efforts,
)
from spatial_pin.dynamics.simulation.result import LeastExchange
from spatial_pin.dynamics.solvers.least_constraint import LeastConstraint
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import kernel_of, with_masses
from spatial_pin.kernel.loop_equations import LoopEquations, loops_at, loops_of
from spatial_pin.kernel.rate_solver import rates_of
from spatial_pin.mechanism.laws import DriverLaw
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.mechanism_checks import refuse_negative_inertias
from spatial_pin.mechanism.resistance import SlipSpeed, resists
from spatial_pin.numerics.linalg import Array, decompose, independent_rows, null_space, weighty_rows
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import BETWEEN_ANCHORS, INTEGRATORS, Accuracy

NONE = 1e-13  # derivative of an equation that is round-off: others are of order one
PLAIN = 0.1  # a plain coordinate is chosen if its speed is this part of the fastest component's
FREE_SPIN = 1e-9  # largest change of closure equations per unit of a free spin: round-off
SPIN_TRIALS = 3  # other configurations at which a spin is checked to be free
# Closure residual of steps relative to their time_tolerance: thousands of them add less error than
# one step.
PART_OF_STEP = 1e-4
EffortLaw = Callable[[float, State], Mapping[str, float]]
WrenchLaw = Callable[[float, State], Mapping[str, pin.Force]]
NO_LAW = ("it must be a function of time that returns (value, rate, acceleration), as those of "
          "spatial_pin.laws")


class Freedoms:
    """The freedoms of a closed mechanism at a state, and which coordinates determine them best.

    Results at the last state are stored: new coordinates need them again.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism = mechanism
        self._state: State | None = None
        self._jacobian: Array = np.empty((0, 0))
        self._rows: NDArray[np.intp] = np.empty(0, np.intp)
        self._spaces: dict[bytes, Array] = {}  # freedoms, keyed by the held coordinates

    def equations(self, state: State) -> NDArray[np.intp]:
        """Return which closure equations are independent at a state."""
        if state is not self._state:
            with loops_of(self._mechanism, state.angles) as evaluation:
                evaluation.update(state.q)
                self._jacobian = evaluation.jacobian[: evaluation.constraints.n_closure].copy()
            self._state, self._spaces = state, {}
            if not (is_large(self._mechanism.model) and self._look_for_one_freedom(state)):
                self._rows = independent_rows(self._jacobian)
        return self._rows

    def _look_for_one_freedom(self, state: State) -> bool:
        """Whether the first joint of a large mechanism clearly moves all others.

        And only one choice of equations exists. Checked by rates, at a cost in proportion to the
        number of loops, not to its cube.
        """
        mechanism, nv = self._mechanism, self._mechanism.model.nv
        rows = np.flatnonzero(np.abs(self._jacobian).max(axis=1, initial=0.0) > NONE)
        with kernel_of(mechanism) as kernel:
            if kernel.n_passive or len(rows) != nv - 1:
                return False
            rates = rates_of(kernel, (0,), 1)
            solved = rates.solve(state.q, state.angles, ("columns",))
            if solved is None:
                return False
            motion: Array = (solved[0].T / mechanism.velocity_scale)
        self._rows = rows
        self._spaces[np.zeros((0, nv)).tobytes()] = motion / np.linalg.norm(motion)
        return True

    def best(self, state: State, prescribed: Sequence[int]) -> list[int]:
        """Return the velocity entries that determine the motion best, besides the prescribed ones.

        Column-pivoted QR of the freedoms: joints that move most.

        Raises:
            SingularError: prescribed coordinates depend on each other, or the loops have lost rank.
        """
        drive = np.zeros((len(prescribed), self._mechanism.model.nv))
        drive[np.arange(len(prescribed)), list(prescribed)] = 1.0
        freedoms = self._without(state, drive)
        if not len(freedoms):
            return []
        return weighty_rows(freedoms.T, len(freedoms)).tolist()

    def plain(self, state: State, apart: Array) -> list[int]:
        """Return the velocity entries of single joints that can be the coordinate, fastest first.

        All other freedoms are `apart` (k, nv).

        Raises:
            SingularError: the loops have lost rank.
        """
        speeds = np.abs(self._without(state, apart)[0])
        plain = [c.v for c in self._mechanism.coordinate_table.values() if c.q >= 0]
        enough = PLAIN * speeds.max()
        return sorted((v for v in plain if speeds[v] > enough), key=lambda v: -speeds[v])

    def _without(self, state: State, drive: Array) -> Array:
        """Return orthonormal rows (n, nv), scaled, of the motions in which drive (k, nv) rests."""
        rows, key, name = self.equations(state), drive.tobytes(), self._mechanism.name
        if key in self._spaces:
            return self._spaces[key]
        with loops_of(self._mechanism, state.angles) as evaluation:
            if not self._spaces and (lost := rank_loss(evaluation, state.q, len(rows))):
                why = lost_rank_words(evaluation, state.q, lost, "forces")
                raise SingularError(f"mechanism {name!r}: {state}: {why}", state=state)
        svd = decompose(np.vstack([self._jacobian[rows], drive]))
        if svd.rank < len(rows) + len(drive):
            raise SingularError(
                f"mechanism {name!r}: the prescribed coordinates are not independent of each other "
                f"at {state}", state=state)
        self._spaces[key] = svd.null_space
        return self._spaces[key]


class Spins:
    """Bodies that spin freely about lines of their own: their spin needs no integration.

    A body that is symmetric about the line through its two ball joints (u, fixed in the body) keeps
    the angular velocity about it, and the rest of the mechanism does not feel how it is turned
    about it [Routh1905; Goldstein2002, 5.7]. With sigma that angular velocity, d = R u the line, R
    the body's rotation relative to the one before it, all seen from there, and w(s) the relative
    angular velocity per unit of the coordinate s at which the body has no spin,

        R' = [w s' + sigma d] R,      omega = R^T w s' + sigma u  in the body's own axes.

    d and w are functions of s alone.

    Args:
        model: of the mechanism.
        lines: by the ball joint that carries a body, the unit vector (3,) of its line in the body's
            axes; the line passes the joint's centre.

    Attributes:
        joints: the ball joints.
        axes: (k, 3) unit vectors of the lines.
        rows: (k, nv) the joint velocities that are the spins.
    """

    def __init__(self, model: pin.Model, lines: Mapping[int, Array]) -> None:
        self._model, self.joints = model, list(lines)
        self.axes = np.array(list(lines.values())).reshape(-1, 3)
        self.rows = np.zeros((len(lines), model.nv))
        for row, joint, axis in zip(self.rows, self.joints, self.axes, strict=True):
            row[model.idx_vs[joint]:][:3] = axis

    def rates(self, q: Array, v: Array) -> list[float]:
        """Return sigma of every body [rad/s], at q (nq,) and v (nv,)."""
        if not self.joints:
            return []
        data = self._model.createData()
        pin.forwardKinematics(self._model, data, q, v)
        return [float(axis @ data.v[joint].angular)
                for joint, axis in zip(self.joints, self.axes, strict=True)]


def free_spins(mechanism: Mechanism, state: State, forces: Forces) -> Spins:
    """Return the bodies that spin freely, symmetric about their lines.

    Each is carried by a ball joint that does not resist, carries none itself, and no spring holds
    it beside its line. A bushing holds its bodies about every line.
    """
    model, lines = mechanism.model, dict[int, Array]()
    if "spherical" not in mechanism.pairs:
        return Spins(model, lines)
    evaluation, carriers = loops_at(mechanism, state.q, state.angles), set(model.parents)
    for joint, pair in enumerate(mechanism.pairs, start=1):
        if pair == "spherical" and joint not in carriers:
            first = model.idx_vs[joint]
            own = evaluation.jacobian[: evaluation.constraints.n_closure, first : first + 3]
            axes = null_space(own, FREE_SPIN)
            # its rotations about one line move no closure
            if len(axes) == 1 and _is_symmetric(mechanism, joint, axes[0], forces):
                lines[joint] = axes[0]
    spins, n = Spins(model, lines), evaluation.constraints.n_closure
    rng, free = np.random.default_rng(7), np.ones(model.nv, dtype=bool)
    for _ in range(SPIN_TRIALS if lines else 0):  # they are free at other configurations too
        step = mechanism.velocity_scale * rng.uniform(-0.1, 0.1, model.nv)
        _, error = close(evaluation, pin.integrate(model, state.q, step), free, 1e-13)
        held = np.abs(evaluation.jacobian[:n] @ spins.rows.T).max(initial=0.0)
        if error > 1e-11 or held > FREE_SPIN:
            return Spins(model, {})
    return spins


def _is_symmetric(mechanism: Mechanism, joint: int, axis: Array, forces: Forces) -> bool:
    """Whether neither inertia nor forces depend on how a body is turned about its line."""
    inertia, tolerance = mechanism.model.inertias[joint], TOLERANCES.tight
    if resists(mechanism, joint) or any(joint in x.bodies for x in forces.bushings):
        return False
    points = [inertia.lever, *(point[:3] for spring in forces.lines for body, point in zip(
        spring.bodies, spring.points, strict=True) if body == joint)]
    off_line = np.linalg.norm(points - np.outer(np.array(points) @ axis, axis), axis=1)
    if off_line.max() > tolerance * mechanism.characteristic_length:
        return False
    moments = inertia.inertia
    along = float(axis @ moments @ axis)
    across = 0.5 * (float(np.trace(moments)) - along)
    round_one = across * np.eye(3) + (along - across) * np.outer(axis, axis)
    return bool(np.abs(moments - round_one).max() <= tolerance * max(np.abs(moments).max(), 1e-300))


def _law(name: str, law: Any) -> DriverLaw:
    if not callable(law):
        raise TypeError(f"drives: the law of {name!r} is {law!r}; {NO_LAW}")

    def checked(t: float) -> tuple[float, float, float]:
        values: tuple[float, float, float] = law(t)
        try:
            value, rate, acceleration = map(math.isfinite, values)
        except (TypeError, ValueError):
            raise TypeError(f"drives: the law of {name!r} returns {values!r} at {t:.9g} s; "
                            f"{NO_LAW}") from None
        if not (value and rate and acceleration):
            raise ValueError(f"drives: the law of {name!r} has a value that is NaN or infinite at "
                             f"{t:.9g} s: {values}")
        return values

    return checked


class ExternalForces(NamedTuple):
    """Forces at frames, world axes, force and moment at the frame's origin.

    Attributes:
        law: of the time and the State, by frame.
        is_steady: whether they are constant.
        longest_step: of an integrator that is to leap over no row [s].
    """

    law: WrenchLaw
    is_steady: bool = False
    longest_step: float = np.inf


def external_forces(mechanism: Mechanism, given: Any, times: Array) -> ExternalForces | None:
    """Return the external forces of a simulation; None if there are none.

    Args:
        mechanism: whose frames they act at.
        given: by frame a `pin.Force` or rows (N, 6); or a function of the time and the State.
        times: (N,) that the rows belong to.

    Raises:
        UnknownNameError: there is no such frame.
        ValueError: rows are not as many as the times, or not finite.
    """
    if callable(given):
        return ExternalForces(lambda t, state: mapping(given(t, state), "external"))
    forces, tables = forces_on_frames(mechanism, given, len(times), "times")
    if not tables:
        return ExternalForces(lambda t, state: forces, is_steady=True) if forces else None

    def law(t: float, state: State) -> Mapping[str, pin.Force]:
        return forces | {
            name: pin.Force(np.array([np.interp(t, times, column) for column in rows.T]))
            for name, rows in tables.items()}

    return ExternalForces(law, longest_step=float(np.diff(times).min(initial=np.inf)))


class Problem:
    """A mechanism with its forces and prescribed coordinates.

    Attributes:
        forces: its springs, and damping and friction of joints.
        freedoms: its freedoms at a state.
        law: efforts as a function of time and state, or None.
        external: forces from outside.
        constant: (nv,) efforts otherwise.
        least_exchange: the least energy that counts as exchanged.
        drives: prescribed coordinates with their laws.
        accuracy: tolerances of loops and steps.
        packed: the packed mechanism, masses included.
        by_drivers: whether efforts act at drivers only, springs and friction as the file says.
        works: whether forces other than gravity do work.
        is_damped: whether a joint or spring takes energy away.
        is_steady: whether no function of the user acts, which may jump.
        between: closure residual allowed at interpolated samples; 0 where none is: with functions
            of the user, which may jump.
        closure_of_steps: closure residual to reach in steps: it adds up, as errors of adaptive
            steps do.
    """

    def __init__(
        self, mechanism: Mechanism, efforts: Mapping[str, float] | EffortLaw | None,
        drives: Mapping[str, DriverLaw] | None, laws: Mapping[str, Law] | None, accuracy: Accuracy,
        slip_speed: SlipSpeed | None = None, external: ExternalForces | None = None,
    ) -> None:
        refuse_negative_inertias(mechanism)
        self._arguments = efforts, drives, laws, accuracy, slip_speed, external
        self.mechanism, self.model = mechanism, mechanism.model
        self.scale, self.accuracy = mechanism.velocity_scale, accuracy
        self.packed, self.freedoms = with_masses(mechanism), Freedoms(mechanism)
        self.forces = Forces(mechanism, laws, slip_speed)
        self.law: EffortLaw | None = efforts if callable(efforts) else None
        self.constant = joint_efforts(mechanism, None if callable(efforts) else efforts)
        self.least_exchange = LeastExchange(mechanism, self.constant)
        self.external = external
        self.drives = [(mechanism.driven_coordinate(n), _law(n, law))
                       for n, law in mapping(drives, "drives").items()]
        at_drivers = {c.v for c in (mechanism.coordinate(d.joint)
                                    for d in mechanism.drivers.values()) if c.q >= 0}
        acted = {*np.flatnonzero(self.constant).tolist(), *(c.v for c, _ in self.drives)}
        self.by_drivers = (self.law is None and not laws and slip_speed is None
                           and external is None and acted <= at_drivers)
        self.is_steady = self.law is None and not laws and not self.drives and (
            external is None or external.is_steady)
        self.is_damped = bool(self.forces.resistance
                              or any(np.any(spring.damping) for spring in mechanism.springs))
        self.works = bool(self.law or external or self.constant.any() or self.forces.exist
                          or self.drives)
        tolerance, steps = accuracy.tolerance, PART_OF_STEP * accuracy.time_tolerance
        self.between = tolerance if self.is_steady and tolerance >= BETWEEN_ANCHORS else 0.0
        self.closure_of_steps = (
            tolerance if INTEGRATORS[accuracy.integrator].is_fixed
            else min(tolerance, max(steps, Accuracy.tolerance)))

    def of(self, mechanism: Mechanism) -> Problem:
        """Return the same problem of a mechanism with other equations."""
        return Problem(mechanism, *self._arguments)

    @cached_property
    def least_constraint(self) -> LeastConstraint:
        """The solver for accelerations with any masses."""
        return LeastConstraint(self.mechanism)

    def efforts(self, t: float, q: Array, v: Array, evaluation: LoopEquations) -> Array:
        """Return the efforts (nv,) at joints, with forces from outside [N·m, N]."""
        if not (self.law or self.external):
            return self.constant
        state = State(self.mechanism, q, v, closure_error=evaluation.closure_error,
                      angles=evaluation.angles)
        total = joint_efforts(self.mechanism, self.law(t, state)) if self.law else self.constant
        if self.external:
            total = total + generalised(evaluation, external_wrenches(
                self.mechanism, evaluation, self.external.law(t, state)))
        return total

    def joint_forces(self, t: float, q: Array, v: Array, evaluation: LoopEquations) -> Array:
        """Return the joint forces (nv,) of efforts, springs, damping and friction."""
        total = self.efforts(t, q, v, evaluation)
        if self.forces.exist:
            total = total + self.forces.generalised(evaluation, q, v)
        return total
