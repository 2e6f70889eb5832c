"""A Motion: a mechanism's configurations, rates and events, one sample per step."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.brief import words
from spatial_pin._support.checks import checked, is_finite
from spatial_pin._support.columns import Quantity, Tabular, read_only, write_npz
from spatial_pin._support.output_files import named_path
from spatial_pin.assembly.curve_contacts import contact_closure, contact_rates
from spatial_pin.assembly.holding import BASE, hold_from_file, hold_to_file
from spatial_pin.assembly.state import FrameMotion, Samples, State, is_coordinate
from spatial_pin.errors import SampleError, SpatialPinError
from spatial_pin.mechanism.coordinates import CoordinateRates, coordinate_rates
from spatial_pin.mechanism.inertia import moving_mass
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, largest_by


class Event(NamedTuple):
    """A limit, a singular configuration or another event of a motion.

    Attributes:
        kind: "limit", "near limit" (digits are lost), "singular" (of a simulation: its end, where
            a link without inertia would become infinitely fast), "branch point", "dead centre",
            "lost", "open" (drifted without corrections), "joint limit" (of the URDF, passed),
            "velocity limit", "effort limit" (of the URDF, passed, or the first sample beyond),
            "not closed" (a traced curve, within its samples), "released" (a driver that nobody
            named, or a joint held by name, that the loops do not let stand), "gap" (redundant
            equations of a rounded file open beyond the gap allowed), "lift off" (the contact of a
            cam would have to pull, in a simulation or loads), "end of curve" (a point leaves its
            slot or track), or "stopped" (a simulation).
        value: driver value of it [rad or m]; in a simulation the time of "stopped", "gap",
            "singular", "lift off", "end of curve" and of limits of the URDF [s].
        row: number of samples of the motion before it.
        text: the event as a sentence.

    Example:
        >>> mech = sp.load("four_bar", r2=0.25)
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 3.0, 31), on_limit="stop")
        >>> event = motion.events[0]
        >>> event.kind, round(event.value, 4), event.row  # of the crank [rad]
        ('limit', 2.4751, 25)
    """

    kind: str
    value: float
    row: int
    text: str


class Output(NamedTuple):
    """A quantity of a motion with its label and unit.

    Attributes:
        values: (N,) or (N, 3); of a reaction (N, 6), force then moment.
        label: name for a plot or table.
        unit: its SI unit, "1" when it has none; of a reaction "N, N·m".

    Example:
        >>> motion = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.5, 1.0], speed=2.0)
        >>> values, label, unit = motion.output("rocker_pin.rate")
        >>> values.round(4), label, unit
        (array([-1.    , -0.2798,  0.387 ]), 'rocker_pin rate', 'rad/s')
    """

    values: Array
    label: str
    unit: str

    def parts(self) -> tuple[Output, ...]:
        """Return its parts of one unit each: a reaction as its force and its moment.

        Example:
            >>> mech = sp.load("four_bar")
            >>> loads = sp.kinetostatics(mech, sp.sweep(mech, "crank", [0.0, 0.5, 1.0], speed=10.0))
            >>> [(x.label, x.unit) for x in loads.output("output_pin.reaction").parts()]
            [('output_pin reaction force', 'N'), ('output_pin reaction moment', 'N·m')]
        """
        if self.values.ndim == 1 or self.values.shape[1] == 3:
            return (self,)
        return (Output(self.values[:, :3], f"{self.label} force", "N"),
                Output(self.values[:, 3:], f"{self.label} moment", "N·m"))

    def __repr__(self) -> str:
        return f"Output({self.label!r}: {words(self.values, self.unit.removeprefix('1'))})"


class ErrorEstimate(NamedTuple):
    """How far a motion may be off: what solving, interpolating and round-off leave of its samples.

    Attributes:
        positions: largest of any sample and coordinate [rad, characteristic lengths].
        rates, accelerations: the same, by the largest velocity and acceleration [-].
        row: numbers of the samples where these three are.
        end: the three at the last sample.

    Example:
        >>> motion = sp.sweep(sp.load("rssr"), "crank", np.linspace(0.0, 6.0, 61), speed=25.0)
        >>> motion.error.positions < 1e-11, motion.error.largest < 1e-9
        (True, True)
    """

    positions: float
    rates: float
    accelerations: float
    row: tuple[int, int, int]
    end: tuple[float, float, float]

    @property
    def largest(self) -> float:
        """The largest of the three, as `Accuracy.for_error` counts errors."""
        return max(self.positions, self.rates, self.accelerations)

    def __str__(self) -> str:
        if not self.positions < NOTHING_KNOWN:
            return f"positions to {self.positions:.1e}: nothing is known of where it goes"
        return (f"positions to {self.positions:.1e}, rates to {self.rates:.1e} and accelerations "
                f"to {self.accelerations:.1e} of the largest")


NOTHING_KNOWN = 1.0  # error of positions: a radian, or the whole mechanism's size
# Accelerations by the square of rates that are the least size of their errors: where nothing bends
LEAST_BEND = 1e-2
# Error of positions, by what coordinates of a mechanism far from the origin resolve
UNRESOLVED = 10.0
# Distance from a branch point [rad, characteristic lengths] within which samples lie on the
# polynomial through it. They are not solved. It is the distance of the polynomial's farthest node.
ACROSS = 0.12
SAMPLED = frozenset(("driver", "time", "q", "v", "a"))  # without which there is no sample
SAVED = frozenset((  # arrays of a file
    "driver", "driver_name", "time", "q", "v", "a", "closure_error", "driver_speed", "angles",
    "mechanism", "coordinates", "event_kind", "event_value", "event_row", "event_text"))
# fields, and what makes them on use
LATER = {"events": "_look", "error_estimates": "_estimate", "time": "_clock"}
NO_NUMBERS = read_only(np.empty(0))
FRAME_UNITS = {  # unit and order of the derivative
    "position": ("m", 0), "velocity": ("m", 1), "acceleration": ("m", 2),
    "angular_velocity": ("rad", 1), "angular_acceleration": ("rad", 2), "jerk": ("m", 3),
}


@dataclass(eq=False)
class Motion(Samples, Tabular):
    """A motion of a mechanism, one sample per step; its arrays are read-only.

    Attributes:
        mechanism: the mechanism.
        driver: (N,) driver values [rad or m]; None where none was swept (a simulation).
        driver_name: the driver, or coordinate, that was swept; empty where none was.
        time: (N,) [s], or None where samples are no history in time.
        q: (N, nq) configurations as Pinocchio orders them [rad, m, quaternions x, y, z, w].
        v, a: (N, nv) joint velocities and accelerations [rad, m, per `per`].
        closure_error: (N,) largest residual of a constraint equation, of each sample [-]; as of a
            `State`, but of interpolated samples a bound.
        driver_speed: (N,) [rad/s or m/s]; 1 where the driver has no speed.
        events: limits, singular configurations and the like that were met, in their order.
        angles: (N, n) relative angle of every screw closure [rad], counting turns.
        per: unit of the variable of the derivatives v and a: "s"; "rad" or "m" of the driver where
            it has no speed; "length" of the arc of a traced curve [rad, characteristic lengths];
            "sample" where several drivers go along tables without times. Where it is not "s",
            forces are those at rest.
        held: names of joints that were held in the sweep, see `sweep`.
        error_estimates: (N, 3) how far positions, v and a of each sample may be off: of the
            coordinate that is off most, by its size (rad, or characteristic lengths); `error` sums
            them up. (0, 3) where nobody has estimated them.
        rate_errors: (N,) round-off of v and a, as `State.rate_error` [-], of a motion that
            `solve_rates` made; else (0,).
        unreached: {sample: reason} of samples of `states` whose values cannot be reached: they
            hold the nearest configuration that was.

    Samples are indexed: `motion[k]` is a State, `motion[10:20]`, a mask or numbers of samples a
    Motion with the events between them, `motion["rocker_pin"]` a coordinate or a frame.

    Raises:
        ValueError: a value of the driver, of time, q, v or a is NaN or infinite.

    Example:
        >>> mech = sp.load("rssr")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.0, 61), speed=25.0)  # [rad/s]
        >>> len(motion), motion.q.shape, motion.v.shape  # N, (N, nq), (N, nv)
        (61, (61, 6), (61, 5))
        >>> print(f"{motion.time[-1]:.2f} s, crank in {motion.driver_unit}")
        0.24 s, crank in rad
        >>> motion.swept is motion.driver, motion.rate_unit("m", 2)
        (True, 'm/s²')
        >>> motion[-1].coordinate("crank").value, len(motion[10:20])  # a State, a Motion
        (6.0, 10)
        >>> motion["rocker_pin"].value.shape, motion["coupler_b"].position.shape
        ((61,), (61, 3))
    """

    mechanism: Mechanism
    driver: Array | None
    driver_name: str
    time: Array | None
    q: Array
    v: Array
    a: Array
    closure_error: Array
    driver_speed: Array
    events: list[Event] = field(default_factory=list)
    angles: Array = field(default_factory=lambda: np.empty((0, 0)))
    per: str = "s"
    held: tuple[str, ...] = (BASE,)
    error_estimates: Array = field(default_factory=lambda: np.empty((0, 3)))
    rate_errors: Array = field(default_factory=lambda: np.empty(0))
    unreached: dict[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        resolved = self.mechanism.closure_resolution
        if resolved:
            self.__dict__["closure_error"] = np.maximum(self.closure_error, resolved)
        for name, x in self.__dict__.items():
            if isinstance(x, np.ndarray):
                self.__dict__[name] = read_only(x)
                if name in SAMPLED and not is_finite(x):
                    raise ValueError(f"Motion: {name} has a value that is NaN or infinite")

    if not TYPE_CHECKING:  # which would take any name for one of its own

        def __getattr__(self, name: str) -> Any:
            """Return the events, error estimates or times that nobody has wanted yet."""
            if LATER.get(name) in self.__dict__:
                setattr(self, name, self.__dict__.pop(LATER[name])(self))
                return self.__dict__[name]
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields to copy or pickle: all but results that are worked out again on use."""
        fields = {**{name: getattr(self, name) for name in LATER}, **self.__dict__}
        return {k: x for k, x in fields.items() if not k.startswith("_")}

    def __setstate__(self, fields: dict[str, Any]) -> None:
        """Set the fields that were copied or pickled."""
        self.__dict__.update({"rate_errors": np.empty(0), "unreached": {}, **fields})
        self.__post_init__()

    def __len__(self) -> int:
        return len(self.q)

    def __iter__(self) -> Iterator[State]:
        """Return the samples as States, one after the other."""
        return (self.state(row) for row in range(len(self)))

    @overload
    def __getitem__(self, item: int | np.integer[Any]) -> State: ...

    @overload
    def __getitem__(self, item: str) -> CoordinateRates[Array] | FrameMotion: ...

    @overload
    def __getitem__(self, item: slice | list[int] | NDArray[Any]) -> Motion: ...

    def __getitem__(self, item: Any) -> Any:
        """Return a sample, samples, or the coordinate or frame of a name.

        Args:
            item: the number of a sample, negative from the end; a slice, a mask (N,) or numbers
                (k,) of samples; or a name.

        Returns:
            A State; a Motion, whose events are those before, between and behind its samples; or
            `coordinate(name)`, or of a link, frame or joint of several freedoms `frame(name)`.

        Raises:
            SampleError: there is no such sample; it is an IndexError.
            UnknownNameError: there is no such name.
            SpatialPinError: a coordinate and a link have that name.
            TypeError: it is none of these.
        """
        if isinstance(item, str):
            is_named = is_coordinate(self.mechanism, item)
            return self.coordinate(item) if is_named else self.frame(item)
        if isinstance(item, slice):
            return selected(self, np.arange(len(self))[item], item)
        rows: NDArray[Any] = np.asarray(item if isinstance(item, np.ndarray | list) else [])
        if (isinstance(item, int | np.integer) and not isinstance(item, bool)) or (
                rows.ndim == 0 and rows.dtype.kind in "iu"):
            return self.state(int(item))
        if rows.ndim == 1 and rows.dtype.kind == "b" and len(rows) == len(self):
            return selected(self, np.flatnonzero(rows))
        if isinstance(item, np.ndarray | list) and rows.ndim == 1 and (
                rows.dtype.kind in "iu" or not rows.size):
            if wrong := [x for x in rows.tolist() if not -len(self) <= x < len(self)]:
                self.state(wrong[0])  # raises the error
            return selected(self, np.arange(len(self))[rows.astype(int)])
        raise TypeError(
            "a Motion is indexed by the number of a sample, a slice, a mask of all "
            f"{len(self)} samples, numbers of samples, or a name; not by {item!r}")

    def at_rates(self, v: Array, a: Array, rate_errors: Array | None = None) -> Motion:
        """Return the same configurations with other rates in time; see `solve_rates`.

        Args:
            v: (N, nv) joint velocities [rad/s, m/s].
            a: (N, nv) joint accelerations [rad/s², m/s²].
            rate_errors: (N,) their round-off, by their size.

        Returns:
            The Motion. Its `time` is (driver value - first)/speed, if one driver was swept, its
            speed is the same at all samples, and that rises; where none was, the motion's own.

        Raises:
            ValueError: a rate is NaN or infinite.

        Example:
            >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.5, 1.0])
            >>> motion.at_rates(4.0 * motion.v, 16.0 * motion.a).time
            array([0.   , 0.125, 0.25 ])
        """
        moved = Motion(
            self.mechanism, self.driver, self.driver_name, self.time, self.q, v, a,
            self.closure_error, np.ones(len(self)), [*self.events], self.angles, "s", self.held,
            rate_errors=np.empty(0) if rate_errors is None else rate_errors,
            unreached=self.unreached)
        if self.driver is not None:
            _, speeds, bends = moved.coordinate(self.driver_name)
            steady = len(self) > 0 and not bends.any() and bool((speeds == speeds[0]).all())
            moved.driver_speed = read_only(speeds)
            moved.time = steady_times(self.driver, float(speeds[0])) if steady else None
        return moved

    @property
    def driver_unit(self) -> str:
        """Unit of the driver, "rad" or "m"."""
        return self.mechanism.coordinate(self.driver_name).unit

    def rate_unit(self, unit: str, order: int = 1) -> str:
        """Return the unit of a quantity's derivative of an order, per unit of this motion's rates.

        Args:
            unit: of the quantity: "rad" or "m".
            order: of the derivative, 1 to 3.

        Example:
            >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.1], speed=2.0)
            >>> motion.rate_unit("m"), motion.rate_unit("rad", 2)
            ('m/s', 'rad/s²')
        """
        return f"{unit}/{self.per}{('', '', '²', '³')[order]}"

    @property
    def swept(self) -> Array:
        """(N,) driver values.

        Raises:
            SpatialPinError: no driver was swept.
        """
        if self.driver is None:
            raise SpatialPinError(
                f"mechanism {self.mechanism.name!r}: no driver was swept in this motion")
        return self.driver

    @property
    def error(self) -> ErrorEstimate:
        """How far the motion may be off, by estimates of the solver that made it.

        Where samples are interpolated, one correction in the middle of each interval tells it;
        elsewhere what the loops are open by, and round-off, as the equations magnify them. What the
        mechanism itself is off by (`gap`), and passive freedoms that take the least motion, have no
        part in it.

        Raises:
            SpatialPinError: nobody has estimated it, as of a motion that was put together by hand;
                or there are no samples.

        Example:
            >>> coarse = sp.Accuracy.for_error(1e-4)
            >>> values = np.linspace(0.0, 6.0, 1801)
            >>> motion = sp.sweep(sp.load("rssr"), "crank", values, speed=25.0, accuracy=coarse)
            >>> motion.error.largest < 1e-4
            True
        """
        estimates, scale = self.error_estimates, self.mechanism.velocity_scale
        if not len(estimates):
            if not len(self):
                raise SpatialPinError(
                    f"mechanism {self.mechanism.name!r}: the motion has no samples")
            raise SpatialPinError(
                f"mechanism {self.mechanism.name!r}: nobody has estimated the errors of this "
                "motion; sweep, follow, trace and simulate do")
        v, a = largest_by(scale, self.v), largest_by(scale, self.a)
        sizes = 1.0, v or 1.0, max(a, LEAST_BEND * v * v) or 1.0
        rows = estimates.argmax(axis=0).tolist()
        end = [x / size for x, size in zip(estimates[-1].tolist(), sizes, strict=True)]
        positions, rates, accelerations = (
            estimates.item(row, k) / sizes[k] for k, row in enumerate(rows))
        return ErrorEstimate(positions, rates, accelerations, tuple(rows), tuple(end))

    @checked
    def coordinate(self, name: str) -> CoordinateRates[Array]:
        """Return (value, rate, acceleration), each (N,), of a coordinate; angles without jumps.

        Rotation vectors of balls and floating joints are continued from sample to sample, each to
        the nearest turn: where such a joint turns more than half a turn between two samples, they
        may read a turn less.

        Args:
            name: a coordinate, a joint of one freedom, or a driver; or `CLOSURE.s`, the place on
                the curve of a cam or a point on a curve [m].

        Returns:
            The CoordinateRates [rad or m, per s, per s²; see `per` for motions without time].

        Raises:
            UnknownNameError: there is no such coordinate, one-freedom joint or driver.

        Example:
            >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> value, rate, acceleration = motion.coordinate("rocker_pin")  # (3,) each
            >>> value.round(4), rate.round(4)  # [rad], [rad/s]
            (array([1.2329, 1.324 , 1.5232]), array([0.    , 0.6652, 0.8522]))
        """
        contact = contact_closure(self.mechanism, name)
        if contact is not None:
            ends = [self.frame(f) for f in contact.frames]
            return contact_rates(self.mechanism, contact, ends, self.angles, name)
        return coordinate_rates(self.mechanism, name, self.q, self.v, self.a)

    @checked
    def state(self, row: int) -> State:
        """Return one sample as a State; its `rate_error` is known where a driver was swept.

        Args:
            row: number of the sample, negative from the end.

        Returns:
            The State, with v and a as the motion has them.

        Raises:
            SampleError: there is no such row.

        Example:
            >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> motion.state(-1).coordinate("crank").value  # [rad]
            1.0
        """
        row, n = int(row), len(self)
        if not -n <= row < n:
            raise SampleError(
                f"there is no sample {row}: {n} samples are 0 to {n - 1}, or -{n} to -1" if n else
                f"there is no sample {row}: the motion has none")
        lost: Any = np.nan
        if len(self.rate_errors):
            lost = float(self.rate_errors[row])
        elif self.driver is not None:
            lost = partial(self._rate_error, row)
        return State(self.mechanism, self.q[row], self.v[row], self.a[row],
                     closure_error=self.closure_error[row],
                     angles=self.angles[row] if self.angles.size else None, rate_error=lost,
                     in_time=self.per == "s")

    def _rate_error(self, row: int, state: State) -> float:
        """Return the round-off of the rates of a sample."""
        from spatial_pin.rates.rates import rate_error

        return rate_error(self.driver_name, self._is_solved(row), state, self.held)

    def _is_solved(self, row: int) -> bool:
        """Whether rates of a sample were solved there, not continued across a branch point."""
        # tangents of a traced curve are solved up to a branch point, and behind it
        size = self.mechanism.velocity_scale[self.mechanism.coordinate(self.driver_name).v]
        return self.per == "length" or not any(
            e.kind == "branch point" and e.row < len(self)
            and abs(e.value - self.swept[row]) < ACROSS * size for e in self.events)

    @cached_property
    def _bodies(self) -> Any:
        """Placements and rates of all bodies, worked out once."""
        from spatial_pin.motion.outputs import bodies

        return bodies(self)

    @property
    def moving_mass(self) -> Array:
        """(N,) mass of all moving links [kg].

        Example:
            >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.5], speed=2.0)
            >>> motion.moving_mass.shape
            (2,)
        """
        return np.full(len(self), moving_mass(self.mechanism.model))

    @checked
    def frame(self, name: str) -> FrameMotion:
        """Return the motion of the origin of a link, frame or joint.

        Args:
            name: link, frame or joint.

        Returns:
            The FrameMotion: arrays (N, 3), world axes [m, rad, s].

        Raises:
            UnknownNameError: there is none.

        Example:
            >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> motion.frame("coupler_b").position.round(4)  # (N, 3) [m], world axes
            array([[-0.3982,  0.2396, -0.    ],
                   [-0.3761,  0.2463,  0.    ],
                   [-0.3261,  0.2537,  0.    ]])
        """
        from spatial_pin.motion.outputs import frame

        return frame(self, name)

    @checked
    def placement(self, name: str) -> Array:
        """Return the placements (N, 4, 4) of a link, frame or joint in the world [m].

        Args:
            name: link, frame or joint.

        Returns:
            Homogeneous matrices, as `State.placement(name).homogeneous` of each sample.

        Raises:
            UnknownNameError: there is none.

        Example:
            >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> motion.placement("coupler_b")[-1, :3, 3].round(4)  # [m], world axes
            array([-0.3261,  0.2537,  0.    ])
        """
        at, out = self.frame(name), np.zeros((len(self), 4, 4))
        out[:, :3, :3], out[:, :3, 3], out[:, 3, 3] = at.rotation, at.position, 1.0
        return out

    @checked
    def com(self, name: str) -> FrameMotion:
        """Return the motion of a link's own centre of mass.

        Args:
            name: link; or "com", for the centre of mass of all moving links.

        Returns:
            The FrameMotion of that point: arrays (N, 3), world axes [m, rad, s].

        Raises:
            UnknownNameError: there is no such link.
            SpatialPinError: it has no mass.

        Example:
            >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> motion.com("rocker").acceleration.round(2)  # (N, 3) [m/s²], world axes
            array([[ 0.23,  0.08,  0.  ],
                   [ 0.14, -0.  ,  0.  ],
                   [-0.  , -0.06,  0.  ]])
        """
        from spatial_pin.motion.outputs import com

        return com(self, name)

    @checked
    def output(self, spec: str) -> Output:
        """Return a quantity by its name.

        `NAME` or `NAME.rate` (or `.velocity`), `.acceleration`, `.jerk`, `.ratio` (to the driver's
        speed), `.advantage` (its inverse), `.transmission_angle` of a coordinate; `NAME.position`,
        `.velocity`, `.acceleration`, `.jerk`, `.angular_velocity`, `.angular_acceleration` of a
        link, frame or joint of another name; `NAME.com.position`, `.velocity`, `.acceleration`,
        `.jerk` of a link's centre of mass; `com.position`, ... of that of all moving links, `mass`
        theirs.
        `LINK.angle` is the direction of a link's x axis in its plane, `LINK.angle.z` that about an
        axis of the world. `.x`, `.y` or `.z` behind a vector is a component, as `tip.position.z`.
        `CLOSURE.s`, `.pressure_angle`, `.curvature` and `.undercut` are those of a contact on a
        curve.
        Jerks are those of a driver whose own jerk is zero. Efforts and reactions are outputs of
        what `kinetostatics` returns.

        Args:
            spec: name of the quantity.

        Returns:
            The Output: values (N,) or (N, 3), label, unit.

        Raises:
            UnknownNameError: it names nothing of this motion.
            SpatialPinError: it is a force, or a ratio to a driver that stands still.

        Example:
            >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> found = motion.output("rocker_pin.ratio")
            >>> found.values.round(4), found.unit
            (array([0.    , 0.3326, 0.4261]), '1')
            >>> motion.output("coupler_b.velocity").values.shape  # (N, 3)
            (3, 3)
        """
        from spatial_pin.motion.outputs import output

        return output(self, spec)

    def frame_unit(self, kind: str) -> str:
        """Return the unit of a quantity of a frame, by its name.

        Args:
            kind: "position", "velocity", "acceleration", "jerk", "angular_velocity" or
                "angular_acceleration".

        Example:
            >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.1], speed=2.0)
            >>> motion.frame_unit("acceleration")
            'm/s²'
        """
        unit, order = FRAME_UNITS[kind]
        return self.rate_unit(unit, order) if order else unit

    def quantities(self, outputs: str | Iterable[str] | None = None) -> dict[str, Quantity]:
        """Return quantities by name: time, driver, all coordinates with rates, closure error.

        Args:
            outputs: names as `output` takes them; these are returned besides time and driver.

        Raises:
            UnknownNameError: there is no such output.

        Example:
            >>> motion = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> [(name, x.unit) for name, x in motion.quantities("rocker_pin.rate").items()]
            [('time', 's'), ('crank', 'rad'), ('rocker_pin rate', 'rad/s')]
        """
        from spatial_pin.motion.outputs import quantities

        return quantities(self, outputs)

    @checked
    def save(self, path: str | Path) -> Path:
        """Write all arrays to an .npz file that `Motion.load` reads; returns the path.

        The suffix is added where it is missing, but not to the name of a pipe or device.

        Args:
            path: of the file.

        Returns:
            The path written.

        Raises:
            OSError: it cannot be written; the former file stays.

        Example:
            >>> motion = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> motion.save("motion").name
            'motion.npz'
        """
        return write_npz(path, content_of(self))

    @classmethod
    @checked
    def load(cls, path: str | Path, mechanism: Mechanism) -> Motion:
        """Read a motion of `mechanism` that `save` wrote.

        Args:
            path: the .npz file.
            mechanism: the mechanism that it is a motion of: `save` does not write it.

        Returns:
            The Motion.

        Raises:
            SpatialPinError: `save` did not write it, or it is the motion of a mechanism with other
                coordinates.
            OSError: it cannot be read.

        Example:
            >>> mech = sp.load("four_bar")
            >>> file = sp.sweep(mech, "crank", [0.0, 0.5, 1.0], speed=2.0).save("motion")
            >>> sp.Motion.load(file, mech).q.shape  # (N, nq)
            (3, 3)
        """
        return cls(mechanism, **fields_of(read_content(path, mechanism)))

    def _repr_html_(self) -> str:
        """Return a small table, for a notebook."""
        from spatial_pin.view.page import cards

        return cards.motion(self)

    def __repr__(self) -> str:
        worst = float(self.closure_error.max(initial=0.0))
        over = f"{self.driver_name} [{self.driver_unit}]" if self.driver_name else "time [s]"
        return (f"{type(self).__name__}({self.mechanism.name!r}: {len(self)} samples over {over}, "
                f"closure error at most {worst:.1e}, {len(self.events)} events)")

    def __str__(self) -> str:
        from spatial_pin.motion.summary import summary

        return summary(self)


def steady_times(values: Array, speed: float) -> Array | None:
    """Return (value - first)/speed if it rises from sample to sample, else None."""
    if speed == 0.0:
        return None
    if len(values) == 1:
        return np.zeros(1)
    time = (values - values[0]) / speed + 0.0  # nor -0.0
    rises = not len(values) or (np.isfinite(time[-1]) and (time[1:] > time[:-1]).all())
    return time if rises else None


def content_of(motion: Motion) -> dict[str, Any]:
    """Return the content of a motion's file, by name."""
    return {
        "driver": motion.driver if motion.driver is not None else np.empty(0),
        "driver_name": motion.driver_name,
        "time": motion.time if motion.time is not None else np.empty(0),
        "q": motion.q, "v": motion.v, "a": motion.a, "closure_error": motion.closure_error,
        "driver_speed": motion.driver_speed, "angles": motion.angles,
        "mechanism": motion.mechanism.name, "per": motion.per,
        "held": np.array(hold_to_file(motion.held), str),
        "error_estimates": motion.error_estimates, "rate_errors": motion.rate_errors,
        "unreached_row": np.array([*motion.unreached], dtype=int),
        "unreached_text": np.array([*motion.unreached.values()], dtype=str),
        "coordinates": np.array(motion.mechanism.coordinates),
        "event_kind": np.array([e.kind for e in motion.events], dtype=str),
        "event_value": np.array([e.value for e in motion.events], dtype=float),
        "event_row": np.array([e.row for e in motion.events], dtype=int),
        "event_text": np.array([e.text for e in motion.events], dtype=str),
    }


def read_content(path: str | Path, mechanism: Mechanism) -> dict[str, NDArray[Any]]:
    """Read what `content_of` has written to a file, of a mechanism with the same coordinates.

    Raises:
        SpatialPinError: it is the file of no motion, or the coordinates are others.
        OSError: it cannot be read.
    """
    path = named_path(path)
    try:
        with path.open("rb") as opened, np.load(opened) as file:
            content = {key: file[key] for key in file.files}
        missing = SAVED - set(content)
    except (ValueError, TypeError, EOFError, AttributeError, zipfile.BadZipFile, zlib.error):
        missing = SAVED
    if missing:
        raise SpatialPinError(f"{path}: not a motion that Motion.save wrote")
    if content["coordinates"].tolist() != list(mechanism.coordinates):
        raise SpatialPinError(
            f"{path}: a motion of mechanism {str(content['mechanism'])!r} with coordinates "
            f"{', '.join(content['coordinates'].tolist())}; {mechanism.name!r} has others"
        )
    return content


def fields_of(content: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return the fields of a motion that a file holds."""
    events = zip(*(content[f"event_{x}"].tolist() for x in Event._fields), strict=True)
    arrays = ("q", "v", "a", "closure_error", "driver_speed", "angles")
    return {
        "driver": content["driver"] if content["driver_name"] else None,
        "driver_name": str(content["driver_name"]),
        "time": content["time"] if content["time"].size else None,
        "events": [Event(*e) for e in events], "per": str(content.get("per", "s")),
        "held": hold_from_file(content["held"].tolist()) if "held" in content else (BASE,),
        **{name: content[name] for name in arrays},
        "error_estimates": content.get("error_estimates", np.empty((0, 3))),
        "rate_errors": content.get("rate_errors", np.empty(0)),
        "unreached": {} if "unreached_row" not in content else dict(zip(
            *(content[f"unreached_{x}"].tolist() for x in ("row", "text")), strict=True)),
    }


def require_motion(motion: object) -> None:
    """Raise an error if an argument is no Motion.

    Raises:
        TypeError: says how to get one.
    """
    if not isinstance(motion, Motion):
        raise TypeError(f"a Motion is needed, not {type(motion).__name__}: sp.sweep(mechanism, "
                        "driver, values) or sp.simulate(mechanism, state, duration) makes one")


AnyMotion = TypeVar("AnyMotion", bound=Motion)


def first_samples(motion: AnyMotion, n: int) -> AnyMotion:
    """Return the first n samples of a motion, with their events."""
    return selected(motion, np.arange(len(motion))[:n], slice(n))


def selected(
    motion: AnyMotion, rows: NDArray[np.intp], piece: slice | None = None
) -> AnyMotion:
    """Return samples of a motion by their numbers (k,).

    Events come along where the numbers rise or fall. `piece` is the same as a slice, so that arrays
    are views.
    """
    n, index = len(motion), rows if piece is None else piece

    def cut(x: Any) -> Any:
        if isinstance(x, dict):
            whole = copy(x)
            whole.update({key: cut(value) for key, value in x.items()})
            return whole
        return x[index] if isinstance(x, np.ndarray) and len(x) == n else x

    later = LATER["error_estimates"]
    is_known = later not in motion.__dict__
    parts = {f.name: cut(getattr(motion, f.name)) for f in fields(motion)
             if is_known or f.name != "error_estimates"}
    none = {} if is_known else {"error_estimates": np.empty((0, 3))}
    parts["unreached"] = {k: motion.unreached[row] for k, row in enumerate(rows.tolist())
                          if row in motion.unreached}
    # an event stands before the sample of its number; those behind the last sample come with it
    steps, events = np.diff(rows), list[Event]()
    rises = bool((steps > 0).all())
    if len(rows) and (rises or (steps < 0).all()):
        first, last = sorted((int(rows[0]), int(rows[-1])))
        inside = [e for e in motion.events if first <= e.row <= last or e.row == n == last + 1]
        for event in inside if rises else inside[::-1]:
            row = np.searchsorted(rows, event.row) if rises else (rows >= event.row).sum()
            events.append(event._replace(row=int(row)))
    part = replace(motion, **{**parts, **none, "events": events})
    if not is_known:  # a simulation makes another one for them
        del part.error_estimates
        part.__dict__[later] = lambda _: motion.error_estimates[index]
    return part


def made(**fields: Any) -> Motion:
    """Return a Motion from all its fields; its arrays are checked to be finite and read-only.

    In place of events, error estimates and times that depend on nothing but these fields, there
    may be functions of the motion that make them at first use: see `LATER`.
    """
    motion = Motion.__new__(Motion)
    fields = {"rate_errors": NO_NUMBERS, "unreached": {}, **fields}
    resolved = fields["mechanism"].closure_resolution
    if resolved:
        fields["closure_error"] = np.maximum(fields["closure_error"], resolved)
    for x in fields.values():
        if type(x) is np.ndarray:
            x.setflags(False)  # type: ignore[call-arg]  # by keyword it takes twice as long
    motion.__dict__ = fields
    return motion
