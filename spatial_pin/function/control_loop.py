"""A mechanism in a control loop: Jacobians, inertia and efforts at each tick, in reused arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from spatial_pin._support.checks import checked, names_of
from spatial_pin.assembly.close import DAMPED_STEPS
from spatial_pin.assembly.held_start import starting_state
from spatial_pin.assembly.holding import BASE
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.forces import Forces, generalised
from spatial_pin.dynamics.solvers.bodies import bodies_of
from spatial_pin.errors import SingularError, SpatialPinError, UnknownNameError
from spatial_pin.kernel.closer import Closer
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.library import DONE, address
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.kernel.packing import frame_in_kernel
from spatial_pin.kernel.rate_solver import RateRows
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
    inertia @ s'' + velocity_efforts + gravity_efforts, as `inverse_dynamics` has them.

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
        self._kernel, self._closer = Kernel(own), Closer(own)
        self._rates = self._given.rates(self._kernel)
        self._bodies, self._forces = bodies_of(own.centred_model), Forces(own)
        self._loops = LoopEquations(own)
        self._free = np.ones(nv, bool)
        self._free[[*self._at_v, *self._given.still]] = False
        self._size_of_q = _sizes(own)
        self.q, self._angles = state.q.copy(), state.angles.copy()
        self.v, self.a, self._rest, self._step = np.zeros((4, nv))
        self.influence = Influence(np.zeros((nv, n)), np.zeros((nv, n, n)))
        points = {name: frame_in_kernel(own, own.frame_id(own.placed(name)))
                  for name in names_of(frames, "frames")}
        self._points = list(points.values())
        self.jacobians = {name: np.zeros((6, n)) for name in points}
        self.inertia = np.zeros((n, n))
        self.gravity_efforts, self.velocity_efforts = np.zeros((2, n))
        self.closure_error = state.closure_error
        self._wanted, self._speeds, self._off = np.zeros((3, n))
        self._moved_mass, self._has_idle = np.zeros((nv, n)), False
        self._ahead, self._next_angles = state.q.copy(), self._angles.copy()
        self._at_ahead = address(self._ahead), address(self._step)
        width = len(self._given.driven) + len(self._given.still)
        self._driven = np.zeros((2, 1, width))
        self._facts = np.zeros((1, 3))
        self._news = [np.zeros((1, *x.shape)) for x in (self.v, self.a, *self.influence)]
        v, a, first, second = self._news
        self._rows = RateRows(
            np.zeros(1, np.int64), first, second, v=v, a=a, facts=self._facts)
        self._new_jacobians = np.zeros((len(points), 1, 6, n))
        self._jacobian_rows = [RateRows(np.zeros(1, np.int64), jacobian=x)
                                 for x in self._new_jacobians]
        at = self._ahead[None], self._next_angles[None]
        self._tasks = [
            self._rates.prepared(*at, self._rows, rates=(self._driven[0], self._driven[1])),
            *(self._rates.prepared(*at, rows, frame=point) for rows, point in zip(
                self._jacobian_rows, self._points, strict=True))]
        self._finish(state.q, state.angles, state.closure_error)
        self._has_idle = bool(len(self._idle()))
        self._finish(state.q, state.angles, state.closure_error)

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
            self._finish(*(self._closed_next() or self._followed()))
        except SpatialPinError as error:
            error.args = (f"{error}; the control loop keeps its last configuration",)
            raise

    def _read(self, given: Any, target: Array, what: str) -> None:
        if isinstance(given, Mapping):
            for name, x in given.items():
                if name not in self._names:
                    raise UnknownNameError("driver", name, self._names,
                                           f"mechanism {self.mechanism.name!r}: ")
                target[self._names[name]] = x
        elif len(given) != len(target):
            raise ValueError(f"{what} has {len(given)} numbers; {len(target)} are needed: "
                             f"{', '.join(self.drivers)}")
        else:
            target[:] = given
        if not np.isfinite(target).all():
            raise ValueError(f"{what} has a value that is NaN or infinite")

    def _closed_next(self) -> tuple[Array, Array, float] | None:
        """Return the next configuration, from the tangent; None if it may be on another branch."""
        self.q.take(self._at_q, out=self._off, mode="clip")
        np.subtract(self._wanted, self._off, out=self._off)
        np.matmul(self.influence.first, self._off, out=self._step)
        size = float(np.abs(self._step / self.mechanism.velocity_scale).max(initial=0.0))
        if not size <= STEP_AT_ONCE:
            return None
        ahead = self._ahead
        ahead[:] = self.q
        self._kernel.library.kernel_integrate(self._kernel.handle, 1, *self._at_ahead)
        ahead[self._at_q] = self._wanted
        q, error, _ = self._closer.close(
            ahead, self._free, self._angles, TOLERANCES.tight, DAMPED_STEPS, (), TOLERANCES.rank)
        corrected = float(np.abs((q - ahead) / self._size_of_q).max(initial=0.0))
        if (error > TOLERANCES.tight and error > self.mechanism.closure_resolution) or (
                corrected > CORRECTED_MOVE * size + SMALLEST_STEP):
            return None
        angles = self._angles
        if angles.size:
            self._loops.angle_reference[:] = angles
            self._loops.update(q, False)
            angles = self._loops.angles
        return q, angles, error

    def _followed(self) -> tuple[Array, Array, float]:
        """Return the configuration at the end of a straight motion of the drivers."""
        now = self.q[self._at_q]
        table = {name: [a, b] for name, a, b in zip(
            self.drivers, now.tolist(), self._wanted.tolist(), strict=True) if a != b}
        end = follow(self.mechanism, table, guess=self.state).state(-1) if table else self.state
        return end.q, end.angles, end.closure_error

    def _finish(self, q: Array, angles: Array, error: float) -> None:
        """Compute all results at a closed configuration; arrays are set only if all succeed."""
        n = len(self.drivers)
        self._ahead[:], self._next_angles[:], self._driven[0, 0, :n] = q, angles, self._speeds
        for work in self._tasks:
            work()
        if self._rows.codes[0] != DONE:
            self._solve_by_trial(error)
        self.q[:], self._angles[:], self.closure_error = q, angles, error
        self.rate_error = self._facts.item(1)
        for target, (row,) in zip((self.v, self.a, *self.influence), self._news, strict=True):
            target[:] = row
        for target, (row,) in zip(self.jacobians.values(), self._new_jacobians, strict=True):
            target[:] = row
        self._find_efforts()

    def _solve_by_trial(self, error: float) -> None:
        """Solve with equations chosen here, if it is not clear which ones are independent.

        Raises:
            SingularError: none are.
        """
        q, angles = self._ahead, self._next_angles
        state = State(self.mechanism, q, closure_error=error,
                      angles=angles if angles.size else None)
        chosen, at = chosen_at(state, self._given), (q[None], angles[None])
        self._rates.prepared(*at, self._rows, rates=(self._driven[0], self._driven[1]),
                             chosen=chosen)()
        if self._rows.codes[0] != DONE:
            raise SingularError(f"mechanism {self.mechanism.name!r}: the rates are not determined, "
                                "or larger than numbers can be")
        for rows, point in zip(self._jacobian_rows, self._points, strict=True):
            self._rates.prepared(*at, rows, frame=point, chosen=chosen)()

    def _find_efforts(self) -> None:
        """Project inertia and forces on the drivers' motions, with idle rotations free."""
        q, first = self.q, self.influence.first
        mass = self._bodies.matrix(q)
        at_rest = self._bodies.inverse_dynamics(q, self._rest, self._rest) - self._applied(
            self._rest)
        moving = self._bodies.inverse_dynamics(q, self.v, self.a) - self._applied(self.v)
        np.matmul(mass, first, out=self._moved_mass)
        if self._has_idle:
            idle = self._idle()
            own = decompose(idle @ mass @ idle.T)
            self._moved_mass -= mass @ idle.T @ own.minimum_norm(idle @ self._moved_mass)
            at_rest = at_rest - mass @ idle.T @ own.minimum_norm(idle @ at_rest)
            moving = moving - mass @ idle.T @ own.minimum_norm(idle @ moving)
        np.matmul(first.T, self._moved_mass, out=self.inertia)
        np.matmul(first.T, at_rest, out=self.gravity_efforts)
        np.matmul(first.T, moving, out=self.velocity_efforts)
        np.subtract(self.velocity_efforts, self.gravity_efforts, out=self.velocity_efforts)

    def _applied(self, v: Array) -> Array:
        """Return the joint forces (nv,) of springs and resistance."""
        forces = self._forces
        if not forces.exist:
            return self._rest
        total = forces.turning(self.q, v)
        if forces.lines or forces.bushings:
            self._loops.update(self.q)
            total = total + generalised(self._loops, forces.wrenches(self._loops, v))
        return total

    def _idle(self) -> Array:
        """Return the velocities (k, nv), scaled, of freedoms that the drivers do not determine."""
        self._loops.angle_reference[:] = self._angles
        self._loops.update(self.q)
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


def _sizes(mechanism: Mechanism) -> Array:
    """Return the sizes (nq,) of the entries of a configuration: lengths, or one."""
    sizes = np.ones(mechanism.model.nq)
    for c in mechanism.coordinate_table.values():
        at = mechanism.index_of(c)
        if at >= 0:
            sizes[at] = mechanism.velocity_scale[c.v]
    return sizes
