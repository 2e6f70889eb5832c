"""A mechanism in a control loop: Jacobians, inertia and efforts at each tick, in reused arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from spatial_pin._support.checks import checked, names_of
from spatial_pin.assembly.assemble import starting_state
from spatial_pin.assembly.close import DAMPED_STEPS
from spatial_pin.assembly.holding import BASE
from spatial_pin.assembly.state import State
from spatial_pin.constraints.kernel_tree import TreeSprings, centred_tree, mass_entries
from spatial_pin.dynamics.forces import Forces, generalised
from spatial_pin.errors import SingularError, SpatialPinError, UnknownNameError
from spatial_pin.kernel.closer import Closer
from spatial_pin.kernel.kernel import FrameInKernel, Kernel, frame_in_kernel
from spatial_pin.kernel.library import DONE, address
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.kernel.rate_solver import Chosen, RateRows
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.follow import follow
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.jacobians import Influence, moving_coordinates
from spatial_pin.rates.prescribed import Prescription, chosen_at

# Largest step of a joint that is corrected at once [rad, characteristic lengths]: its tangent is
# then off by half a hundredth, and other branches are far. A longer one is followed.
STEP_AT_ONCE = 0.1
CORRECTED_MOVE = 0.25  # largest correction over step: beyond it the branch may be another one
SMALLEST_STEP = 1e-7  # whose correction is round-off, not curvature


class ControlLoop:
    """Jacobians, inertia and efforts of a mechanism at each tick of a controller, in reused arrays.

    `update` closes the loops from the last configuration, on the branch of the guess. Drivers that
    jump are followed along a straight line. Each update overwrites the same arrays. An update that
    fails raises an error and changes nothing: the arrays have the values of the last good one. One
    thread at a time.

    The efforts of the motors for accelerations s'' of the drivers are
    inertia @ s'' + velocity_efforts + gravity_efforts, as `inverse_dynamics` has them. A free
    base stands still.

    Attributes:
        mechanism: the mechanism.
        drivers: names, in the order of all arrays.
        q: (nq,) the configuration.
        v: (nv,) joint velocities at the drivers' rates [rad/s, m/s].
        a: (nv,) joint accelerations there while the drivers' rates are constant.
        jacobians: (6, n) by frame, as `jacobian`.
        influence: the `Influence`: first (nv, n), second (nv, n, n).
        inertia: (n, n) effective inertia at the drivers [kg m², kg].
        gravity_efforts: (n,) efforts that balance weights and springs at rest [N·m, N].
        velocity_efforts: (n,) efforts at constant rates for Coriolis and centrifugal forces,
            damping and friction; without `gravity_efforts`.
        closure_error: as of a `State`.
        rate_error: estimated round-off of all rates, relative to their size: it grows towards a
            dead centre or another singular configuration, up to 1.

    Args:
        mechanism: the mechanism.
        frames: links, frames or joints whose Jacobians are wanted.
        guess: the first configuration, as for `assemble`.

    Raises:
        AssemblyError: the guess does not close.
        SingularError: the drivers do not determine the motion there.
        UnknownNameError: there is no such frame.

    Example:
        >>> mech = sp.load("delta")
        >>> loop = sp.ControlLoop(mech, frames=["platform"])
        >>> for angle in (0.0, 0.01, 0.02):  # [rad], at each tick
        ...     loop.update([angle, 0.0, 0.0], rates=[1.0, 0.0, 0.0])
        >>> loop.jacobians["platform"].shape, loop.inertia.shape, loop.gravity_efforts.shape
        ((6, 3), (3, 3), (3,))
        >>> effort = loop.inertia @ [5.0, 0.0, 0.0] + loop.velocity_efforts + loop.gravity_efforts
    """

    @checked
    def __init__(
        self, mechanism: Mechanism, frames: Iterable[str] = (),
        guess: Mapping[str, Any] | State | Array | None = None,
    ) -> None:
        state = starting_state(mechanism, guess)
        self.mechanism = own = state.mechanism
        self.drivers = tuple(mechanism.drivers)
        if not self.drivers:
            raise SpatialPinError(f"mechanism {mechanism.name!r}: a control loop needs drivers, "
                                  "and the mechanism has none: name some in its file")
        coordinates = [own.driven_coordinate(name) for name in self.drivers]
        self._given = Prescription.of(own, moving_coordinates(own, self.drivers, BASE), BASE)
        self._at_q, self._at_v = (np.array(x) for x in zip(
            *((c.q, c.v) for c in coordinates), strict=True))
        self._names = {**{c.name: k for k, c in enumerate(coordinates)},
                       **{name: k for k, name in enumerate(self.drivers)}}
        n, nv = len(coordinates), own.model.nv
        self._kernel, self._closer, self._tree = (
            Kernel(own), Closer(own), centred_tree(own))
        self._rates, self._forces = self._given.rates(self._kernel), Forces(own)
        self._loops = LoopEquations(own)
        self._free = np.ones(nv, bool)
        self._free[[*self._at_v, *self._given.still]] = False
        self._sizes, self._names_of_frames = _sizes(own), names_of(frames, "frames")
        points = [frame_in_kernel(own, own.frame_id(own.placed(name)))
                  for name in self._names_of_frames]
        self._make_arrays(nv, n, len(points))
        self._prepare(points)
        self._ahead[:], self._next_angles[:] = state.q, state.angles
        self._has_others = False
        self._finish(state.closure_error)
        self._has_others = len(self._null_space()) > len(self._idle)
        self._finish(state.closure_error)

    def _make_arrays(self, nv: int, n: int, n_frames: int) -> None:
        """Make all arrays: those of the last tick, those of the next one, and room to work in."""
        nq, n_angles = self._kernel.nq, self._kernel.n_angles
        shapes = [(nq,), (n_angles,), (nv,), (nv,), (nv, n), (nv, n, n), (n, n), (n,), (n,),
                  *[(6, n)] * n_frames]
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        self._all, self._next = np.zeros((2, ends[-1]))
        known, ahead = ([x.reshape(shape) for x, shape in zip(
            np.split(numbers, ends[:-1]), shapes, strict=True)] for numbers in (
                self._all, self._next))
        (self.q, self._angles, self.v, self.a, first, second, self.inertia,
         self.gravity_efforts, self.velocity_efforts, *jacobians) = known
        self.influence = Influence(first, second)
        self.jacobians = dict(zip(self._names_of_frames, jacobians, strict=True))
        (self._ahead, self._next_angles, self._v, self._a, self._first, self._second,
         self._inertia, self._at_rest, self._moving, *self._jacobians) = ahead
        self._wanted, self._speeds, self._off = np.zeros((3, n))
        self._step, self._scaled_step, self._load = np.zeros((3, nv))
        self._corrected = np.zeros(nq)
        self._driven = np.zeros((2, 1, len(self._given.driven) + len(self._given.still)))
        self._code, self._facts = np.zeros(1, np.int64), np.zeros((1, 3))
        self._idle = np.zeros((self._kernel.n_passive, nv))
        self._motions, self._needed = np.zeros((2, 2, nv)), np.zeros((2, nv))
        self._configurations = np.zeros((2, nq))
        rows, columns, indices = mass_entries(self._tree, True)
        self._entries, self._places = np.zeros(len(rows) + 1), np.full((nv, nv), len(rows))
        self._places[rows, columns] = indices
        self._mass, self._moved_mass = np.zeros((nv, nv)), np.zeros((nv, n))

    def _prepare(self, points: list[FrameInKernel]) -> None:
        """Prepare the calls of the kernel at each tick."""
        self._at_ahead = address(self._ahead), address(self._step)
        self._close = self._closer.prepared(
            self._ahead, self._angles, self._free, TOLERANCES.tight, DAMPED_STEPS, TOLERANCES.rank)
        found = [RateRows(self._code, jacobian=x[None]) for x in self._jacobians]
        rates = RateRows(self._code, self._first[None], self._second[None], v=self._v[None],
                         a=self._a[None], facts=self._facts)
        first = rates._replace(jacobian=self._jacobians[0][None]) if points else rates
        self._wanted_rows = [(first, points[0] if points else None, (*self._driven,)), *(
            (rows, point, None) for rows, point in zip(found[1:], points[1:], strict=True))]
        self._tasks = self._rate_tasks(None)
        self._find_idle = self._rates.prepared_idle(self._idle)
        (v, a), forces = self._motions, self._forces
        at = self._configurations, v, a
        resistance = forces.resistance
        self._resisting = [(k, *x) for k, x in enumerate(zip(
            resistance.damping.tolist(), resistance.friction.tolist(),
            resistance.slip_speed.tolist(), strict=True)) if x[0] or x[1]]
        self._springs = TreeSprings(self._tree.arrays, forces.packed) if (
            forces.on_frames and not forces.laws_on_frames) else None
        self._find_needed = self._tree.prepared(
            *at, tau=self._needed, springs=self._springs and self._springs.address)
        self._find_needed_by_inertia = self._tree.prepared(*at, tau=self._needed)

    def _rate_tasks(self, chosen: Chosen | None) -> list[Callable[[], None]]:
        at = self._ahead[None], self._next_angles[None]
        return [self._rates.prepared(*at, rows, frame=point, rates=rates, chosen=chosen)
                for rows, point, rates in self._wanted_rows]

    @property
    def state(self) -> State:
        """A copy of the present configuration as a State, with v and a.

        Example:
            >>> loop = sp.ControlLoop(sp.load("four_bar"))
            >>> loop.update([1.0])
            >>> f"{loop.state.coordinate('rocker_pin').value:.4f} rad"
            '1.6255 rad'
        """
        return State(self.mechanism, self.q, self.v, self.a, closure_error=self.closure_error,
                     angles=self._angles if self._angles.size else None)

    def update(
        self, drivers: Sequence[float] | Array | Mapping[str, float],
        rates: Sequence[float] | Array | Mapping[str, float] | None = None,
    ) -> None:
        """Compute all arrays at new values of the drivers.

        Args:
            drivers: (n,) their values, in the order of `drivers`, or by name: those that are not
                named stand still [rad, m].
            rates: (n,) their rates, likewise: those that are not named are zero [rad/s, m/s].

        Raises:
            LimitError: the drivers cannot go there in a straight line.
            SingularError: they do not determine the motion there, or on the way to it.
            UnknownNameError: there is no such driver.
            ValueError: a number is NaN or infinite, or there are not n.

        Example:
            >>> loop = sp.ControlLoop(sp.load("four_bar"), frames=["rocker_b"])
            >>> loop.update([1.0], rates=[10.0])  # or {"crank": 1.0}, {"crank": 10.0}
            >>> (loop.jacobians["rocker_b"][:3, 0]).round(4)  # [m/s per rad/s]
            array([-0.0464,  0.    , -0.0025])
        """
        self.q.take(self._at_q, out=self._wanted, mode="clip")
        self._speeds[:] = 0.0
        self._read(drivers, self._wanted, "drivers")
        if rates is not None:
            self._read(rates, self._speeds, "rates")
        try:
            error = self._closed_next()
            self._finish(self._followed() if error is None else error)
        except SpatialPinError as error:
            error.args = (f"{error}; the control loop keeps its last configuration",)
            raise

    def _read(self, given: Any, target: Array, what: str) -> None:
        try:
            if isinstance(given, Mapping):
                for name, x in given.items():
                    if name not in self._names:
                        raise UnknownNameError("driver", name, self._names,
                                               f"mechanism {self.mechanism.name!r}: ")
                    target[self._names[name]] = x
            elif len(given) == len(target):
                target[:] = given
            else:
                raise ValueError
        except (TypeError, ValueError):
            raise ValueError(
                f"{what} must be a number for each of {', '.join(self.drivers)}, in this order "
                f"or by name, not {given!r}") from None
        if not all(map(math.isfinite, target.tolist())):
            raise ValueError(f"{what} has a value that is NaN or infinite")

    def _closed_next(self) -> float | None:
        """Close the next configuration from the tangent; None where it may be another branch.

        Returns:
            Its closure error.
        """
        self.q.take(self._at_q, out=self._off, mode="clip")
        np.subtract(self._wanted, self._off, out=self._off)
        np.matmul(self.influence.first, self._off, out=self._step)
        np.divide(self._step, self.mechanism.velocity_scale, out=self._scaled_step)
        size = largest(self._scaled_step)
        if not size <= STEP_AT_ONCE:
            return None
        ahead, moved = self._ahead, self._corrected
        ahead[:] = self.q
        self._kernel.library.kernel_integrate(self._kernel.handle, 1, *self._at_ahead)
        ahead[self._at_q] = self._wanted
        moved[:] = ahead
        error = self._close()
        np.subtract(ahead, moved, out=moved)
        np.divide(moved, self._sizes, out=moved)
        if (error > TOLERANCES.tight and error > self.mechanism.closure_resolution) or not (
                largest(moved) <= CORRECTED_MOVE * size + SMALLEST_STEP):
            return None
        if self._angles.size:
            self._loops.angle_reference[:] = self._angles
            self._loops.update(ahead, False)
            self._next_angles[:] = self._loops.angles
        return error

    def _followed(self) -> float:
        """Go to the end of a straight motion of the drivers; return its closure error."""
        now = self.q[self._at_q]
        table = {name: [a, b] for name, a, b in zip(
            self.drivers, now.tolist(), self._wanted.tolist(), strict=True) if a != b}
        end = follow(self.mechanism, table, guess=self.state).state(-1) if table else self.state
        self._ahead[:], self._next_angles[:] = end.q, end.angles
        return end.closure_error

    def _finish(self, error: float) -> None:
        """Work out what belongs to the next configuration; it is taken when all of it is known.

        Raises:
            SingularError: the drivers do not determine the rates.
        """
        self._driven[0, 0, : len(self.drivers)] = self._speeds
        for work in self._tasks:
            work()
        if self._code[0] != DONE:  # it is not clear which equations are independent: choose here
            angles = self._next_angles if self._angles.size else None
            state = State(self.mechanism, self._ahead, closure_error=error, angles=angles)
            for work in self._rate_tasks(chosen_at(state, self._given)):
                work()
        if self._code[0] != DONE:
            raise SingularError(f"mechanism {self.mechanism.name!r}: the rates are not determined, "
                                "or larger than numbers can be")
        self._find_efforts()
        self._all[:], self.closure_error = self._next, error
        self.rate_error = self._facts.item(1)

    def _find_efforts(self) -> None:
        """Project inertia and forces on the drivers' motions, idle rotations left to themselves."""
        first, moved, needed = self._first, self._moved_mass, self._needed
        self._configurations[:] = self._ahead
        self._motions[0, 1], self._motions[1, 1] = self._v, self._a
        self._find_needed()
        if self._springs and self._springs.coincide():
            self._find_needed_by_inertia()
            self._take_forces_on_frames()
        elif self._forces.laws_on_frames:
            self._take_forces_on_frames()
        if self._forces.exist:
            for row, v in zip(needed, self._motions[0], strict=True):
                for at, damping, friction, slip in self._resisting:
                    rate = v.item(at)
                    row[at] += damping * rate + friction * math.tanh(rate / slip)
                for turn in self._forces.turns:
                    row[turn.v] += turn.law(self._ahead.item(turn.q), v.item(turn.v))
        self._tree.masses(self._ahead, self._entries)
        self._entries.take(self._places, out=self._mass, mode="clip")
        np.matmul(self._mass, first, out=moved)
        if len(self._idle) or self._has_others:
            self._leave_idle()
        np.matmul(first.T, moved, out=self._inertia)
        np.matmul(first.T, needed[0], out=self._at_rest)
        np.matmul(first.T, needed[1], out=self._moving)
        np.subtract(self._moving, self._at_rest, out=self._moving)

    def _leave_idle(self) -> None:
        """Take from inertia and forces what idle rotations, which no motor holds, give way to.

        They are made orthogonal with respect to the mass matrix, one after the other.
        """
        scale, least = self.mechanism.velocity_scale, TOLERANCES.zero
        if self._has_others:
            motions = self._null_space()
        else:
            motions = self._idle
            self._find_idle()
        for k, motion in enumerate(motions):
            for other in motions[:k]:
                if other.any():
                    np.matmul(self._mass, other, out=self._load)
                    motion -= (motion @ self._load) / (other @ self._load) * other
            np.divide(motion, scale, out=self._scaled_step)
            motion /= math.sqrt(self._scaled_step @ self._scaled_step) or 1.0
            np.matmul(self._mass, motion, out=self._load)
            inertia = float(motion @ self._load)
            if not inertia > least:
                motion[:] = 0.0
                continue
            least = max(least, TOLERANCES.rank * inertia)
            self._load /= inertia
            for row in self._needed:
                row -= (motion @ row) * self._load
            self._moved_mass -= self._load[:, None] * (motion @ self._moved_mass)

    def _take_forces_on_frames(self) -> None:
        """Take those of springs on frames: with laws, or where frames coincide."""
        loops = self._loops
        loops.update(self._ahead)
        for row, v in zip(self._needed, self._motions[0], strict=True):
            row -= generalised(loops, self._forces.wrenches(loops, v))

    def _null_space(self) -> Array:
        """Return the velocities (k, nv) of all freedoms that the drivers do not determine."""
        self._loops.angle_reference[:] = self._next_angles
        self._loops.update(self._ahead)
        rows = self._loops.jacobian[: self._loops.constraints.n_closure]
        fixed = np.eye(len(self.v))[~self._free]
        spare: Array = decompose(np.vstack([rows, fixed])).null_space
        return spare * self.mechanism.velocity_scale

    def __reduce__(self) -> Any:
        raise TypeError("a ControlLoop holds the kernel's memory and cannot be pickled: make one "
                        "of the mechanism in each process")

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {x:.6g}" for name, x in zip(
            self.drivers, self.q[self._at_q], strict=True))
        return f"ControlLoop({self.mechanism.name!r}, {values})"


def largest(x: Array) -> float:
    """Return the largest absolute entry of x, which is overwritten by absolute entries."""
    return float(np.maximum.reduce(np.abs(x, out=x), initial=0.0))


def _sizes(mechanism: Mechanism) -> Array:
    """Return the sizes (nq,) of the entries of a configuration: lengths, or one."""
    sizes = np.ones(mechanism.model.nq)
    for c in mechanism.coordinate_table.values():
        at = mechanism.index_of(c)
        if at >= 0:
            sizes[at] = mechanism.velocity_scale[c.v]
    return sizes
