"""A State: one configuration of a mechanism with fresh kinematics and a known closure error."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeGuard

import numpy as np
import pinocchio as pin

from spatial_pin._support.brief import brief
from spatial_pin._support.checks import finite_array, is_finite
from spatial_pin._support.lazy import cached_property, made_once
from spatial_pin.assembly.curve_contacts import contact_closure, contact_rates
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.trees import Located, located
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.coordinates import CoordinateRates, coordinate_rates, require_mechanism
from spatial_pin.mechanism.inertia import moving_mass
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

if TYPE_CHECKING:
    import spatial_pin as sp

# Joint coordinates that one call of the kernel computes: a tenth of a second, so that Ctrl-C is
# answered, and what it needs besides its results is bounded.
PIECE = 200_000
# relative round-off of rates that is reported: dimensions seldom have ten digits
WORTH_A_WORD = 1e-10
WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class PointRates(NamedTuple):
    """Position, velocity and acceleration of a point, world axes.

    Attributes:
        position: (3,) [m].
        velocity: (3,) [m/s].
        acceleration: (3,) [m/s²].

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
        >>> position, velocity, acceleration = state.com("coupler")  # (3,) each, world axes
        >>> velocity.round(4)  # [m/s]
        array([-0.6526,  0.    ,  0.2575])
    """

    position: Array
    velocity: Array
    acceleration: Array

    def __repr__(self) -> str:
        return brief(self, position="m")


class FrameMotion(NamedTuple):
    """Motion of a frame or of a link's centre of mass, world axes, N samples.

    Of a State the arrays have no leading N.

    Attributes:
        position: (N, 3) [m].
        rotation: (N, 3, 3), columns are the axes of the frame in the world.
        velocity: (N, 3) [m/s].
        acceleration: (N, 3) second derivative of the position [m/s²].
        angular_velocity: (N, 3) [rad/s].
        angular_acceleration: (N, 3) [rad/s²].

    Example:
        >>> motion = sp.sweep(sp.load("rssr"), "crank", np.linspace(0.0, 1.0, 11), speed=2.0)
        >>> point = motion.frame("coupler_b")
        >>> point.position.shape, point.rotation.shape, point.velocity.shape
        ((11, 3), (11, 3, 3), (11, 3))
    """

    position: Array
    rotation: Array
    velocity: Array
    acceleration: Array
    angular_velocity: Array
    angular_acceleration: Array

    def __repr__(self) -> str:
        return brief(self, position="m")


class RelativeMotion(NamedTuple):
    """Motion of a point split over a moving frame, world axes [EMT2431, 7.3].

    The point's velocity is base_velocity + transport + relative_velocity, its acceleration
    base + tangential + normal + relative + coriolis.

    Attributes:
        position: (3,) of the point from the frame's origin [m].
        base_velocity: (3,) of the frame's origin [m/s].
        transport: (3,) omega x position [m/s], omega the frame's angular velocity.
        relative_velocity: (3,) of the point as seen in the frame [m/s].
        base: (3,) acceleration of the frame's origin [m/s²].
        tangential: (3,) alpha x position [m/s²], alpha the frame's angular acceleration.
        normal: (3,) omega x (omega x position) [m/s²].
        relative: (3,) acceleration of the point as seen in the frame [m/s²].
        coriolis: (3,) 2 omega x relative_velocity [m/s²].

    Example:
        >>> mech = sp.load("inverted_slider_crank")
        >>> state = sp.solve_rates(mech, sp.assemble(mech, {"bar": 0.5}), {"bar": 2.0})
        >>> seen = state.relative_motion("slider", "bar")  # the slider, seen from the turning bar
        >>> seen.relative_velocity.round(4), seen.coriolis.round(4)  # [m/s], [m/s²]
        (array([-0.2153,  0.    , -0.1176]), array([ 0.4704,  0.    , -0.861 ]))
    """

    position: Array
    base_velocity: Array
    transport: Array
    relative_velocity: Array
    base: Array
    tangential: Array
    normal: Array
    relative: Array
    coriolis: Array

    def __repr__(self) -> str:
        return brief(self, position="m")


class Gap(float):
    """The largest error of the equations of a closed configuration.

    It is 0 if all equations hold. Otherwise the numbers of the file are rounded, and this is the
    error of the redundant equations of its loops. Angles are in rad, lengths relative to the
    characteristic length.

    Attributes:
        closures: the largest error of each closure that has such equations.

    Example:
        >>> state = sp.assemble(sp.load("rssr"), {"crank": 1.0})
        >>> float(state.gap), state.gap.closures  # its numbers are exact
        (0.0, {})
    """

    closures: Mapping[str, float]

    def __new__(cls, closures: Mapping[str, float] = MappingProxyType({})) -> Gap:
        """Make a gap from the largest error of each closure."""
        gap = super().__new__(cls, max(closures.values(), default=0.0))
        gap.closures = dict(closures)
        return gap

    def __getnewargs__(self) -> tuple[Any, ...]:
        """Return the arguments of a copy."""
        return (self.closures,)


class State:
    """One configuration of a mechanism, its velocity and acceleration. Read-only.

    Made by `assemble` and `solve_rates`, which close the loops; holding one means that the
    closure error is known. `State(mechanism, q, v)` makes one of numbers that are known from
    elsewhere: it moves nothing, and measures the closure error.

    Attributes:
        mechanism: the mechanism. Where the numbers of its file are rounded (see `gap`), it is one
            without the redundant equations that these numbers contradict, the same all along a
            motion; `mechanism.whole` has all equations.
        q: (nq,) configuration as Pinocchio orders it.
        v, a: (nv,) joint velocities and accelerations [rad/s, m/s; rad/s², m/s²].
        closure_error: largest residual of a constraint equation [-]: lengths relative to the
            characteristic length, angles in rad. Measured, where it is not given. It is at least
            round-off: a rounding for each joint of the chains that a closure joins, or, far from
            the world's origin, what coordinates there can resolve. Without closures it is 0.
        angles: relative angle of every screw closure [rad], counting turns.
        branch: label of the assembly mode, from `assembly_modes`.
        released: {driver: displacement [rad or m]} of drivers that were given no value, and had to
            leave where the guess has them, for the loops to close.
        lost_turns: coordinates that were set so far from the guess that others may have lost whole
            turns, as loops could not be followed there: more than half a turn where couplings or
            screws count turns behind loops that do not, more than one where nothing counts them.
        rate_error: estimated round-off of v and a, relative to their size; it grows near a limit
            position of a driver, and near a branch point, up to 1: no digit. NaN until
            `solve_rates`; of a sample of a sweep it is worked out at first use, of a sample of
            a simulation it is NaN.
        in_time: whether v and a are rates in time; those of a sample of a sweep without speed are
            not, and forces there are those at rest.

    Raises:
        ValueError: q, v, a or angles has a value that is NaN or infinite, or another shape.

    Example:
        >>> mech = sp.load("rssr")
        >>> state = sp.assemble(mech, {"crank": 1.0})
        >>> state.q.shape, state.v.shape  # (nq,), (nv,)
        ((6,), (5,))
        >>> state.beyond_limits, float(state.gap)  # no joint limit is passed; exact numbers
        ({}, 0.0)
        >>> sp.State(mech, state.q).closure_error < 1e-13  # made of known numbers
        True
        >>> sp.solve_rates(mech, state, {"crank": 10.0}).rate_error < 1e-12
        True
        >>> state.data.oMf[mech.frame_id("rocker_b")].translation.round(4)  # Pinocchio's, [m]
        array([-0.3261,  0.2537,  0.    ])
    """

    def __init__(
        self,
        mechanism: Mechanism,
        q: Array,
        v: Array | None = None,
        a: Array | None = None,
        *,
        closure_error: float | None = None,
        angles: Array | None = None,
        branch: str = "",
        rate_error: float | Callable[[State], float] = np.nan,
        released: Mapping[str, float] = MappingProxyType({}),
        lost_turns: Iterable[str] = (),
        in_time: bool = True,
    ) -> None:
        require_mechanism(mechanism)
        rest, q = _rest(mechanism), _given(q, mechanism.neutral, "q")
        if closure_error is None:
            closure_error, angles = _measured(mechanism, q, angles)
        self._take(
            mechanism, q, rest if v is None else _given(v, rest, "v"),
            rest if a is None else _given(a, rest, "a"), float(closure_error),
            NO_ANGLES if angles is None or not angles.size else _given(angles, angles, "angles"),
            rate_error, released, lost_turns, branch, in_time)

    def _take(
        self, mechanism: Mechanism, q: Array, v: Array, a: Array, closure_error: float,
        angles: Array, rate_error: float | Callable[[State], float],
        released: Mapping[str, float], lost_turns: Iterable[str] = (), branch: str = "",
        in_time: bool = True,
    ) -> None:
        self.mechanism, self.q, self.v, self.a = mechanism, q, v, a
        self.closure_error = max(closure_error, mechanism.closure_resolution)
        self.angles, self._rate_error = angles, rate_error
        self.released, self.branch, self.in_time = dict(released), branch, in_time
        self.lost_turns = tuple(lost_turns)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields to copy or pickle: all but results that are worked out again on use."""
        return {k: x for k, x in self.__dict__.items() if k not in ("data", "_located")}

    def __setstate__(self, fields: Mapping[str, Any]) -> None:
        """Set the fields of a copy, which is read-only too."""
        self.__dict__.update(fields)
        for name in ("q", "v", "a", "angles"):
            setattr(self, name, _frozen(fields[name]))

    @cached_property
    def rate_error(self) -> float:
        """Estimated round-off of v and a, relative to their size; NaN where it is not known."""
        known, self._rate_error = self._rate_error, np.nan  # an error on the way may print us
        return float(known(self) if callable(known) else known)

    @cached_property
    def beyond_limits(self) -> dict[str, float]:
        """The excesses of coordinates over the joint limits of the URDF.

        Signed amounts by coordinate [rad or m]: positive beyond upper limits, negative beyond
        lower ones.
        """
        return beyond_limits(self.mechanism, self.q)

    @cached_property
    def gap(self) -> Gap:
        """The largest error of redundant equations of a rounded file; 0 if all equations hold."""
        return gap_of(self.mechanism, self.q, self.angles)

    @cached_property
    def data(self) -> pin.Data:
        """Pinocchio data with joint and frame kinematics at (q, v, a).

        Of the whole tree: its memory grows with the cube of the freedoms. Frames of a large tree
        are found without it.
        """
        data = self.mechanism.model.createData()
        pin.forwardKinematics(self.mechanism.model, data, self.q, self.v, self.a)
        pin.updateFramePlacements(self.mechanism.model, data)
        return data

    @cached_property
    def _located(self) -> Located | None:
        """The placements of the frames of a large tree."""
        return located(self.mechanism, self.q, self.v, self.a)

    def _frame(self, name: str) -> int:
        return self.mechanism.frame_id(self.mechanism.placed(name))

    def coordinate(self, name: str) -> CoordinateRates[float]:
        """Return (value, rate, acceleration) of a joint coordinate [rad or m, per s, per s²].

        A rotation vector, of a ball or a floating joint, is no longer than half a turn.

        Args:
            name: a coordinate, a one-freedom joint, or a driver; or `CLOSURE.s`, the place on
                the curve of a cam or a point on a curve [m].

        Returns:
            The CoordinateRates: three floats.

        Raises:
            UnknownNameError: there is none.

        Example:
            >>> state = sp.assemble(sp.load("rssr"), {"crank": 1.0})
            >>> print(f"{state.coordinate('rocker_pin').value:.4f} rad")
            1.5232 rad
        """
        contact = contact_closure(self.mechanism, name)
        if contact is not None:
            ends = [FrameMotion(*(x[None] for x in self.frame(f))) for f in contact.frames]
            rows = contact_rates(self.mechanism, contact, ends, np.atleast_2d(self.angles), name)
        else:
            rows = coordinate_rates(self.mechanism, name, self.q[None], self.v[None],
                                    self.a[None])
        return CoordinateRates(*(float(x[0]) for x in rows))

    def placement(self, name: str) -> pin.SE3:
        """Return the placement of a link, frame or joint in the world [m].

        Args:
            name: link, frame or joint.

        Returns:
            A `pinocchio.SE3`: `.translation` (3,) [m], `.rotation` (3, 3).

        Raises:
            UnknownNameError: there is none.

        Example:
            >>> state = sp.assemble(sp.load("rssr"), {"crank": 1.0})
            >>> state.placement("coupler_b").translation.round(4)  # (3,) [m]
            array([-0.3261,  0.2537,  0.    ])
            >>> state.placement("coupler_b").rotation.shape
            (3, 3)
        """
        frame, large = self._frame(name), self._located
        return self.data.oMf[frame].copy() if large is None else large.placement(frame)

    def velocity(self, name: str) -> pin.Motion:
        """Return the twist of a link, frame or joint at its origin, world axes [m/s, rad/s].

        Args:
            name: link, frame or joint.

        Returns:
            A `pinocchio.Motion`: `.linear` (3,) [m/s], `.angular` (3,) [rad/s].

        Raises:
            UnknownNameError: there is none.

        Example:
            >>> mech = sp.load("four_bar")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
            >>> state.velocity("coupler_b").linear.round(4)  # (3,) [m/s], world axes
            array([-0.4637,  0.    , -0.0254])
        """
        frame, large = self._frame(name), self._located
        return large.motion(frame)[0] if large is not None else pin.getFrameVelocity(
            self.mechanism.model, self.data, frame, WORLD_AXES)

    def acceleration(self, name: str) -> pin.Motion:
        """Return the classical acceleration of a frame's origin and the angular acceleration.

        World axes [m/s², rad/s²]; the linear part is the second derivative of the position.

        Args:
            name: link, frame or joint.

        Returns:
            A `pinocchio.Motion`: `.linear` (3,) [m/s²], `.angular` (3,) [rad/s²].

        Raises:
            UnknownNameError: there is none.

        Example:
            >>> mech = sp.load("four_bar")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
            >>> state.acceleration("coupler_b").linear.round(3)  # (3,) [m/s²], world axes
            array([-11.971,   0.   ,  -1.555])
        """
        frame, large = self._frame(name), self._located
        return large.motion(frame)[1] if large is not None else pin.getFrameClassicalAcceleration(
            self.mechanism.model, self.data, frame, WORLD_AXES)

    def frame(self, name: str) -> FrameMotion:
        """Return placement, velocity and acceleration of a link, frame or joint together.

        Args:
            name: link, frame or joint.

        Returns:
            The FrameMotion of its origin: arrays (3,), `rotation` (3, 3), world axes [m, rad, s].

        Raises:
            UnknownNameError: there is none.

        Example:
            >>> mech = sp.load("four_bar")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
            >>> state.frame("coupler_b").velocity.round(4)  # (3,) [m/s], world axes
            array([-0.4637,  0.    , -0.0254])
        """
        at, v, a = self.placement(name), self.velocity(name), self.acceleration(name)
        return FrameMotion(*(x.copy() for x in (
            at.translation, at.rotation, v.linear, a.linear, v.angular, a.angular)))

    def __getitem__(self, name: str) -> CoordinateRates[float] | FrameMotion:
        """Return the coordinate, or the frame, of a name: `coordinate` or `frame` of it.

        Raises:
            UnknownNameError: there is none.
            SpatialPinError: both have that name.
            TypeError: it is no name.
        """
        if not isinstance(name, str):
            raise TypeError(f"a State is indexed by a name, as state['crank_pin'], not by {name!r}:"
                            " a Motion has samples by number")
        return (self.coordinate if is_coordinate(self.mechanism, name) else self.frame)(name)

    __iter__ = None  # it is no sequence, though it has items

    def angular_velocity(self, name: str) -> Array:
        """Return the angular velocity of a link or frame, world axes (3,) [rad/s].

        Raises:
            UnknownNameError: there is no such link or frame.

        Example:
            >>> mech = sp.load("four_bar")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
            >>> state.angular_velocity("coupler").round(4)
            array([0.    , 2.4293, 0.    ])
        """
        return self.velocity(name).angular.copy()

    def angular_acceleration(self, name: str) -> Array:
        """Return the angular acceleration of a link or frame, world axes (3,) [rad/s²].

        Raises:
            UnknownNameError: there is no such link or frame.

        Example:
            >>> mech = sp.load("four_bar")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
            >>> state.angular_acceleration("coupler").round(3)
            array([  0.   , -33.399,   0.   ])
        """
        return self.acceleration(name).angular.copy()

    def com(self, name: str) -> PointRates:
        """Return position, velocity and acceleration of a link's own centre of mass.

        Args:
            name: link.

        Returns:
            The PointRates: three arrays (3,), world axes [m, m/s, m/s²].

        Raises:
            SpatialPinError: the link has no mass.

        Example:
            >>> mech = sp.load("four_bar")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
            >>> state.com("coupler").velocity.round(4)  # (3,) [m/s]
            array([-0.6526,  0.    ,  0.2575])
        """
        offset = self.placement(name).rotation @ center_of_mass(self.mechanism, name)
        twist, accel = self.velocity(name), self.acceleration(name)
        w = twist.angular
        turning = np.cross(w, offset)
        return PointRates(
            self.placement(name).translation + offset,
            twist.linear + turning,
            accel.linear + np.cross(accel.angular, offset) + np.cross(w, turning),
        )

    def relative_motion(self, point: str, frame: str) -> RelativeMotion:
        """Return velocity and acceleration of a point split over a moving frame.

        Args:
            point: link, frame or joint whose origin is the point.
            frame: link, frame or joint that the point is seen from.

        Returns:
            The RelativeMotion: arrays (3,), world axes [m, s].

        Raises:
            UnknownNameError: there is no such link, frame or joint.

        Example:
            >>> mech = sp.load("inverted_slider_crank")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"bar": 0.5}), {"bar": 2.0})
            >>> state.relative_motion("slider", "bar").coriolis.round(4)  # (3,) [m/s²]
            array([ 0.4704,  0.    , -0.861 ])
        """
        r = self.placement(point).translation - self.placement(frame).translation
        own, base = self.velocity(point).linear, self.velocity(frame)
        own_rate, base_rate = self.acceleration(point).linear, self.acceleration(frame)
        w = base.angular
        transport = np.cross(w, r)
        relative = own - base.linear - transport
        tangential, normal = np.cross(base_rate.angular, r), np.cross(w, transport)
        coriolis = 2.0 * np.cross(w, relative)
        seen = own_rate - base_rate.linear - tangential - normal - coriolis
        return RelativeMotion(r, base.linear.copy(), transport, relative, base_rate.linear.copy(),
                              tangential, normal, seen, coriolis)

    def _repr_html_(self) -> str:
        """Return a small table, for a notebook."""
        from spatial_pin.view.page import cards

        return cards.state(self)

    def __repr__(self) -> str:
        drivers = ", ".join(
            f"{d} = {self.coordinate(d).value:.6g} {self.mechanism.coordinate(d).unit}"
            for d in self.mechanism.drivers)
        lost = f", rates to {self.rate_error:.0e}" if self.rate_error > WORTH_A_WORD else ""
        rounded = f", gap {float(self.gap):.1e}" if self.gap else ""
        turns = f", turns of {', '.join(self.lost_turns)} lost" if self.lost_turns else ""
        return (f"State({self.mechanism.name!r}: {drivers}; closure error "
                f"{self.closure_error:.1e}{rounded}{lost}{turns})")


def gap_of(mechanism: Mechanism, q: Array, angles: Array) -> Gap:
    """Return the errors of equations that a mechanism leaves out, at q (nq,).

    It has a `whole`, or is any other, whose gap is 0; `angles` (n_angles,) are those of its screw
    closures.
    """
    if mechanism.whole is None or mechanism.selection is None:
        return Gap()
    with loops_of(mechanism.whole, all_angles(mechanism, angles)) as evaluation:
        evaluation.update(q)
        largest: dict[str, float] = {}
        for name, x in zip(evaluation.constraints.closure_of, evaluation.residual, strict=True):
            largest[name] = max(largest.get(name, 0.0), abs(float(x)))
    return Gap({c.name: largest[c.name]
                for c, n in zip(mechanism.whole.closures, mechanism.selection.counts(), strict=True)
                if n < c.n_rows})


def all_angles(mechanism: Mechanism, angles: Array) -> Array:
    """Return the screw angles of the `whole` of a mechanism, from its own."""
    assert mechanism.whole is not None
    return carried_angles(mechanism, angles, mechanism.whole)


def carried_angles(mechanism: Mechanism, angles: Array, other: Mechanism) -> Array:
    """Return the angles of another mechanism with the same closures; zero for new ones."""
    own, its = (constraints_of(m).angles for m in (mechanism, other))
    known = dict(zip((x.name for x in own), angles, strict=True))
    return np.array([known.get(x.name, 0.0) for x in its])


def made(
    mechanism: Mechanism, q: Array, v: Array | None, a: Array | None, *, closure_error: float,
    angles: Array, rate_error: Any = np.nan, released: Mapping[str, float] = MappingProxyType({}),
    lost_turns: Iterable[str] = (),
) -> State:
    """Return a State from finite arrays without copies; they become read-only."""
    state, rest = State.__new__(State), _rest(mechanism)
    for array in (q, v, a, angles):
        if array is not None:
            array.setflags(write=False)
    state._take(mechanism, q, rest if v is None else v, rest if a is None else a, closure_error,
                angles if angles.size else NO_ANGLES, rate_error, released, lost_turns)
    return state


def is_coordinate(mechanism: Mechanism, name: str) -> bool:
    """Whether a name is that of a coordinate, or driver, and not of a link or frame.

    A joint of one freedom is the coordinate.

    Raises:
        UnknownNameError: it is neither.
        SpatialPinError: it is both.
    """
    is_named = name in mechanism.coordinate_table or name in mechanism.drivers or (
        contact_closure(mechanism, name) is not None)
    is_placed = is_named and name in mechanism.frame_ids
    if not is_named:
        with suppress(UnknownNameError):
            is_placed = mechanism.frame_id(mechanism.placed(name)) >= 0
    if not (is_named or is_placed):
        raise UnknownNameError(
            "coordinate, driver, link or frame", name,
            [*mechanism.coordinate_table, *mechanism.drivers, *mechanism.frame_ids],
            f"mechanism {mechanism.name!r}: ")
    if is_named and is_placed and not mechanism.model.existJointName(name):
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: {name!r} is a driver or coordinate, and a link or frame"
            f" too: say .coordinate({name!r}) or .frame({name!r})")
    return is_named


class Samples:
    """Base of Motion: samples of a mechanism, one per row. For the modules below `motion`."""


def of_mechanism(mechanism: Mechanism, state: State) -> State:
    """Return `state` as a state of `mechanism`: itself, or converted from another load of it.

    For a rounded file it belongs to the mechanism without contradicting equations: use
    `state.mechanism`.
    """
    require_mechanism(mechanism)
    if not isinstance(state, State):
        raise TypeError(f"a State is needed, not {type(state).__name__}: sp.assemble(mechanism, "
                        "{driver: value}) makes one")
    if mechanism in (state.mechanism, state.mechanism.whole):
        return state
    if state.mechanism.whole is not None and mechanism.whole is None:
        whole = state.mechanism.whole
        alike = [(c.name, c.n_rows) for c in mechanism.closures]
        if alike == [(c.name, c.n_rows) for c in whole.closures]:
            assert state.mechanism.selection is not None
            mechanism = mechanism.with_equations(state.mechanism.selection)
    same = state.mechanism.coordinates == mechanism.coordinates
    evaluation = LoopEquations(mechanism)
    if same and state.angles.size == evaluation.angle_reference.size:
        evaluation.angle_reference[:] = state.angles
        evaluation.update(state.q)
        if evaluation.closure_error <= max(TOLERANCES.nothing, 2.0 * state.closure_error):
            return State(mechanism, state.q, state.v, state.a,
                         closure_error=evaluation.closure_error, angles=state.angles,
                         branch=state.branch, released=state.released,
                         lost_turns=state.lost_turns, in_time=state.in_time)
    raise SpatialPinError(
        f"mechanism {mechanism.name!r}: the state belongs to mechanism {state.mechanism.name!r}"
        + (f" of other dimensions (its loops are open here by {evaluation.closure_error:.1e}); "
           "assemble again with this state as guess" if same else ", which has other coordinates")
    )


def moving_in_time(mechanism: Mechanism, state: State) -> State:
    """Return `state` as a state of `mechanism`, at rest if its rates are not those in time.

    Raises:
        SpatialPinError: as `of_mechanism`.
    """
    own = of_mechanism(mechanism, state)
    if own.in_time:
        return own
    return State(own.mechanism, own.q, closure_error=own.closure_error, angles=own.angles,
                 branch=own.branch, released=own.released, lost_turns=own.lost_turns)


def center_of_mass(mechanism: Mechanism, link: str) -> Array:
    """Return the centre of mass of a link in its own frame (3,) [m].

    Raises:
        UnknownNameError: there is no such link, frame or joint.
        SpatialPinError: it has no mass.
    """
    mechanism.frame_id(link)
    inertia = mechanism.inertias.get(link)
    if inertia is None or inertia.mass <= 0.0:
        massive = [name for name, i in mechanism.inertias.items() if i.mass > 0.0]
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: {link!r} has no mass, hence no centre of mass; "
            f"links with mass: {', '.join(massive) or 'none'}"
        )
    return inertia.lever.copy()


def mass_shares(mechanism: Mechanism) -> list[tuple[int, float, Array]]:
    """Return joint, part of the whole mass, centre (3,) on the joint of all bodies that move."""
    model = mechanism.model
    total = moving_mass(model)
    if not total > 0.0:
        raise SpatialPinError(f"mechanism {mechanism.name!r}: its moving links have no mass, so "
                              "that they have no centre of mass")
    return [(joint, body.mass / total, body.lever)
            for joint, body in enumerate(model.inertias) if joint and body.mass]


def _given(values: Array, like: Array, what: str) -> Array:
    """Return a read-only copy of an array for a State.

    Raises:
        ValueError: NaN, infinite, or a shape other than that of `like`.
    """
    copy = _frozen(values)
    if copy.shape != like.shape or not is_finite(copy):
        finite_array(copy, like.shape, f"State: {what}")
    return copy


def _measured(mechanism: Mechanism, q: Array, angles: Array | None) -> tuple[float, Array]:
    """Return the closure error at q (nq,), and the angles of screw closures.

    These count from given angles (n,), else within half a turn.
    """
    reference: Array | float = 0.0
    if angles is not None and angles.size:
        reference = _given(angles, np.zeros(constraints_of(mechanism).n_angles), "angles")
    with loops_of(mechanism, reference) as at:
        at.update(q)
        return float(at.closure_error), at.angles.copy()


def _frozen(array: Array) -> Array:
    copy = np.array(array, np.float64)
    copy.setflags(write=False)
    return copy


NO_ANGLES = _frozen(np.empty(0))


@made_once
def _rest(mechanism: Mechanism) -> Array:
    """Return zero rates (nv,)."""
    return _frozen(np.zeros(mechanism.model.nv))


def is_motion(given: object) -> TypeGuard[sp.Motion]:
    """Whether an argument is a Motion, where a State may be given too."""
    return isinstance(given, Samples)


def samples_of(mechanism: Mechanism, given: State | sp.Motion) -> State | sp.Motion:
    """Return a State or a Motion as one of `mechanism`: itself, or converted from another load.

    Raises:
        SpatialPinError: it is of another mechanism, or of other dimensions; see `of_mechanism`.
    """
    if not is_motion(given):
        return of_mechanism(mechanism, given)  # type: ignore[arg-type]  # which refuses others
    require_mechanism(mechanism)
    if mechanism in (given.mechanism, given.mechanism.whole) or not len(given):
        return given
    with at_sample(0):
        own = of_mechanism(mechanism, given.state(0)).mechanism
    with kernel_of(own) as kernel:
        errors = np.concatenate([kernel.errors(given.q[rows], angles_of(given)[rows])
                                 for rows in pieces(given)])
    open_ = errors > np.maximum(TOLERANCES.nothing, 2.0 * given.closure_error)
    for row in np.flatnonzero(open_).tolist():
        with at_sample(row):
            of_mechanism(mechanism, given.state(row))
    return replace(given, mechanism=own, closure_error=errors)


def angles_of(motion: sp.Motion) -> Array:
    """Return the angles (N, n_angles) of a motion's screw closures, (N, 0) where there are none."""
    return motion.angles if motion.angles.size else np.empty((len(motion), 0))


def pieces(motion: sp.Motion) -> Iterator[slice]:
    """Yield the samples of a motion in pieces that one call of the kernel computes."""
    n = max(PIECE // max(motion.mechanism.model.nv, 1), 1)
    for first in range(0, max(len(motion), 1), n):
        yield slice(first, first + n)


@contextmanager
def at_sample(row: Any) -> Iterator[None]:
    """Let errors of the block name the sample."""
    try:
        yield
    except (SpatialPinError, ValueError) as error:
        error.args = (f"{error} (sample {row})",)
        raise
