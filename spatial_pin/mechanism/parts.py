"""The parts of a mechanism besides its tree: coordinates, closures, drivers, springs."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import finite_array, finite_number, numbers_or_none
from spatial_pin._support.lazy import by_new_name, cached_property
from spatial_pin.errors import MechanismFileError, UnknownNameError
from spatial_pin.mechanism.equations import ConstraintEquation, combined
from spatial_pin.mechanism.force_paths import Strands, Teeth
from spatial_pin.mechanism.pairs import PAIRS, Pair, PairGeometry


class Coordinate(NamedTuple):
    """One joint coordinate.

    Attributes:
        name: joint name, or joint name, dot, suffix of the pair.
        joint: name of the joint.
        unit: "rad" or "m".
        q: index in the configuration, -1 when it is not an entry of it (rotation vectors).
        v: index in the velocity.
        component: its number among the coordinates of the joint, from 0.

    Example:
        >>> sp.load("rssr").coordinate("rocker_pin")
        Coordinate(name='rocker_pin', joint='rocker_pin', unit='rad', q=5, v=4, component=0)
    """

    name: str
    joint: str
    unit: str
    q: int
    v: int
    component: int

    @property
    def place(self) -> int:
        """The old name of `component`; it warns."""
        return int(by_new_name(self, "place", "component"))


class VelocityEntry(Coordinate):
    """An entry of a joint's velocity as Pinocchio has it, which is not its coordinate's rate."""

    __slots__ = ()


@dataclass(frozen=True, eq=False)
class Closure:
    """One loop closure.

    Attributes:
        name, type: as in the mechanism file.
        frames: names of the frames it joins (none of a coupling).
        between: names of two other frames whose distance is the length of this one (distance of
            variable length; else empty).
        geometry: the pair's axes, length and lead.
        joints: names of joint coordinates in its equations.
        numbers: of its type, or (n,) of lists, by their keys in a mechanism file.
        equations: the equations of the pair that are used, None for all; the others must follow
            from them (planar loops).
        sums: weights of the equations of each sum of them that is used in their place; empty for
            these themselves.
        source: where it is stated, if not as a closure of a mechanism file.
        written: texts of its numbers that are expressions of dimensions.

    Example:
        >>> closure = sp.load("rssr").closures[0]
        >>> closure.name, closure.type, closure.frames, closure.n_rows
        ('ball_b', 'spherical', ('coupler_b', 'rocker_b'), 3)
        >>> len(closure.rows), closure.can_turn, closure.pair.native is not None
        (3, True, True)
        >>> closure.joined  # pairs of frames
        (('coupler_b', 'rocker_b'),)
        >>> gears = sp.load("geared_five_bar").closures[-1]
        >>> gears.type, gears.joints, gears.ratio, round(gears.offset, 6)  # offset [rad]
        ('coupling', ('left_pin', 'right_pin'), -2.0, 3.141593)
        >>> gears.ratios, gears.acts_at is None
        ((-2.0, -1.0), True)
    """

    name: str
    type: str
    frames: tuple[str, ...] = ()
    geometry: PairGeometry = field(default_factory=lambda: PairGeometry(np.eye(3), np.eye(3)))
    joints: tuple[str, ...] = ()
    equations: tuple[int, ...] | None = None
    between: tuple[str, ...] = ()
    source: str = ""
    numbers: Mapping[str, Any] = field(default_factory=dict)
    written: tuple[str, ...] = ()
    sums: tuple[tuple[float, ...], ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields to copy or pickle: all but the equations, which follow from them."""
        return {key: x for key, x in self.__dict__.items() if key != "rows"}

    @property
    def pair(self) -> Pair:
        """The pair it realises."""
        return PAIRS[self.type]

    @cached_property
    def rows(self) -> tuple[ConstraintEquation, ...]:
        """Its scalar equations."""
        rows = self.pair.rows(self) if self.pair.rows else ()
        if self.equations is not None:
            rows = tuple(rows[k] for k in self.equations)
        return tuple(combined(rows, weights) for weights in self.sums) if self.sums else rows

    @property
    def ratio(self) -> float:
        """Of a coupling by a ratio: coordinate `joints[1]` = ratio * `joints[0]` + offset."""
        return float(self.numbers.get("ratio", 1.0))

    @property
    def ratios(self) -> tuple[float, ...]:
        """Of a coupling: the sum of ratios times `joints`, and the offset, is zero.

        A coupling by a `ratio` has (ratio, -1), one by a function has none.
        """
        if "ratio" in self.numbers:
            return self.ratio, -1.0
        return tuple(map(float, self.numbers.get("ratios", ())))

    @property
    def offset(self) -> float:
        """Of a coupling, see `ratio` [rad or m]."""
        return float(self.numbers.get("offset", 0.0))

    @property
    def acts_at(self) -> Any:
        """The `teeth` or `strands` of a coupling, None without them."""
        return next((x for x in self.numbers.values() if isinstance(x, Teeth | Strands)), None)

    @property
    def joined(self) -> tuple[tuple[str, str], ...]:
        """The pairs of frames that it joins, by name: the first with each other one.

        Of a rope each with the next.
        """
        pairs = (list(pairwise(self.frames)) if self.pair.has_more
                 else [(self.frames[0], other) for other in self.frames[1:]])
        if self.between:
            pairs.append((self.between[0], self.between[1]))
        return tuple(pairs)

    @property
    def n_rows(self) -> int:
        """Number of scalar equations."""
        return len(self.rows)

    def with_equations(self, weights: Weights, length: float) -> Closure:
        """Return it with sums of its equations only, by weights (n, n_rows).

        Equations that are lengths are divided by a length [m]. Rows with one entry each, 1, leave
        these equations as they are.
        """
        matrix = np.array(weights).reshape(-1, self.n_rows)
        if np.all(np.count_nonzero(matrix, axis=1) == 1):
            own = range(self.n_rows) if self.equations is None else self.equations
            return replace(self, equations=tuple(own[k] for k in np.nonzero(matrix)[1].tolist()))
        matrix = matrix * [1.0 if row.is_length else length for row in self.rows]
        return replace(self, equations=self.equations or tuple(range(self.n_rows)),
                       sums=tuple(map(tuple, matrix.tolist())))

    @property
    def can_turn(self) -> bool:
        """Whether its equations have the same solutions with its two frames exchanged."""
        return (len(self.frames) == 2 and not self.between and not self.joints
                and not self.pair.keys and not self.pair.uses_lead and self.equations is None
                and self.type not in ("point_on_line", "point_on_plane"))

    def turned(self) -> Closure:
        """Return it with its two frames exchanged: directions of frame 2 in its equations."""
        g = self.geometry
        return replace(self, frames=self.frames[::-1],
                       geometry=replace(g, axes1=g.axes2, axes2=g.axes1))


Weights = tuple[tuple[float, ...], ...]  # of a closure's equations, by the sums of them that stay


class SelectedEquations(NamedTuple):
    """Some equations of a mechanism, or sums of them, by closure.

    Attributes:
        own: of the closures as they are.
        turned: of the same with their frames exchanged.
        cut: part of the largest singular value of all equations, below which rounding has made
            the others.
        opened: how far each closure that lacks equations opens along the motion [-].
    """

    own: tuple[Weights, ...]
    turned: tuple[Weights, ...]
    cut: float = 0.0
    opened: tuple[tuple[str, float], ...] = ()

    def counts(self) -> list[int]:
        """Return the number of equations of each closure."""
        return [len(a) + len(b) for a, b in zip(self.own, self.turned, strict=True)]


@dataclass(frozen=True)
class Driver:
    """A coordinate that is prescribed.

    Attributes:
        name: the driver's name.
        joint: the joint, or coordinate (`joint.slide`), it drives.

    Example:
        >>> sp.load("rssr").drivers["crank"]
        Driver(name='crank', joint='crank_pin')
    """

    name: str
    joint: str


@dataclass(frozen=True)
class Spring:
    """A spring and damper between two frames, or about or along a joint.

    Attributes:
        name: the name in the mechanism file.
        frames: names of the two frames that it joins; or
        joint: the joint or coordinate whose value is the spring's length or angle, such as
            "slide" or, of a ball, "hip.x": a component of its rotation vector.
        stiffness: [N/m], of a coordinate that turns [N·m/rad]; or six numbers, or (6, 6), of a
            bushing between two frames: forces [N], then moments [N·m], by the position [m] and the
            rotation vector [rad] of frame 2 in the axes of frame 1; symmetric and not negative.
        damping: [N·s/m], of a coordinate that turns [N·m·s/rad]; of a bushing likewise.
        free_length: between frames, or of a coordinate that slides, at no force [m].
        free_angle: of a coordinate that turns, at no torque [rad]; of one that slides it is taken
            as [m].
        law: (elongation [m, rad], force [N, N·m]) of points of its characteristic, instead of a
            stiffness: straight lines between them, the end ones going on. The elongation is what
            its length or coordinate is above the free one; a positive force pulls back.
        tension_only: it pulls only, as a cable: elsewhere it is slack, without damping.
        compression_only: it pushes only, as a bump stop.
        preload: (6,) of a bushing: the force and moment by which it pulls frame 2 back where the
            two frames coincide [N, N·m].

    Raises:
        ValueError: a number is NaN or infinite, or it has both frames and a joint, or neither; a
            law has fewer than two points, points that do not rise, or a stiffness beside it; the
            numbers of a bushing are not six or (6, 6), not symmetric, or negative.

    Example:
        >>> sp.Spring("return", joint="rocker_pin", stiffness=2.0, free_angle=1.2).free  # [rad]
        1.2
    """

    name: str
    frames: tuple[str, ...] = ()
    joint: str | None = None
    stiffness: Any = 0.0
    damping: Any = 0.0
    free_length: float = 0.0
    free_angle: float = 0.0
    law: tuple[tuple[float, float], ...] = ()
    tension_only: bool = False
    compression_only: bool = False
    preload: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if (len(self.frames), bool(self.joint)) not in ((2, False), (0, True)):
            raise ValueError(f"spring {self.name!r} needs either two frames or a joint")
        if self.is_bushing:
            self._check_bushing()
            return
        for what in ("stiffness", "damping", "free_length", "free_angle"):
            finite_number(getattr(self, what), f"{what} of spring {self.name!r}")
        if self.tension_only and self.compression_only:
            raise ValueError(f"spring {self.name!r} is tension_only or compression_only: one of "
                             "the two")
        if len(self.law):
            points = numbers_or_none(self.law)
            if points.shape != (len(self.law), 2) or len(points) < 2 or not (
                    np.isfinite(points).all() and np.all(np.diff(points[:, 0]) > 0.0)):
                raise ValueError(f"law of spring {self.name!r} needs two points or more of two "
                                 "numbers, elongation and force, with rising elongations")
            if self.stiffness:
                raise ValueError(f"spring {self.name!r} has a law and a stiffness: give one of "
                                 "the two")
            object.__setattr__(self, "law", tuple(map(tuple, points.tolist())))

    @property
    def is_bushing(self) -> bool:
        """Whether it acts in all six directions between its frames.

        Example:
            >>> sp.Spring("mount", ("a", "b"), stiffness=[1e5, 1e5, 1e4, 50, 50, 5]).is_bushing
            True
        """
        return bool(np.ndim(self.stiffness) or np.ndim(self.damping) or np.size(self.preload))

    def _check_bushing(self) -> None:
        """Refuse numbers that no bushing has; store them as tuples."""
        if not self.frames or self.law or self.tension_only or self.compression_only or self.free:
            raise ValueError(f"spring {self.name!r}: a bushing joins two frames, and has no law, "
                             "free length or side of its own")
        for what in ("stiffness", "damping"):
            given = numbers_or_none(getattr(self, what))
            if given.shape == () and not given:
                continue
            matrix = np.diag(given) if given.shape == (6,) else given
            if matrix.shape != (6, 6) or not np.isfinite(matrix).all():
                raise ValueError(f"{what} of spring {self.name!r}: six finite numbers, or six "
                                 "lists of six, are needed for a bushing")
            size = float(np.abs(matrix).max())
            if np.abs(matrix - matrix.T).max() > 1e-9 * size or (
                    np.linalg.eigvalsh(matrix)[0] < -1e-9 * size):
                raise ValueError(f"{what} of spring {self.name!r} must be symmetric and not "
                                 "negative, so that it stores energy")
            rows = given.tolist()
            object.__setattr__(self, what,
                               tuple(rows) if given.ndim == 1 else tuple(map(tuple, rows)))
        preload = numbers_or_none(self.preload)
        if preload.shape not in ((0,), (6,)) or not np.isfinite(preload).all():
            raise ValueError(f"preload of spring {self.name!r}: six finite numbers are needed")
        object.__setattr__(self, "preload", tuple(preload.tolist()))

    @property
    def is_linear(self) -> bool:
        """Whether its force is the stiffness times the elongation, and damping times the rate.

        Example:
            >>> sp.Spring("cable", ("a", "b"), stiffness=10.0, tension_only=True).is_linear
            False
        """
        return not (self.law or self.tension_only or self.compression_only or self.is_bushing)

    def force(self, length: float, rate: float) -> float:
        """Return its force at a length or coordinate, positive pulling together or back.

        Args:
            length: between frames, or the coordinate [m or rad].
            rate: of that, per second.

        Raises:
            TypeError: they are no numbers.

        Example:
            >>> stop = sp.Spring("stop", joint="slide", stiffness=100.0, compression_only=True)
            >>> stop.force(-0.1, 0.0), stop.force(0.1, 0.0)  # [N]
            (-10.0, 0.0)
        """
        elastic = self._along(length - self.free)[0]
        return 0.0 if self._is_slack(elastic) else self._limited(elastic + self.damping * rate)

    def slopes(self, length: float, rate: float) -> tuple[float, float]:
        """Return the derivatives of `force` with respect to length and rate.

        Args:
            length: between frames, or the coordinate [m or rad].
            rate: of that, per second.

        Raises:
            TypeError: they are no numbers.

        Example:
            >>> gas = sp.Spring("gas", joint="slide", law=((0.0, 0.0), (0.1, 5.0)))
            >>> gas.slopes(0.05, 0.0)  # [N/m], [N·s/m]
            (50.0, 0.0)
        """
        elastic, stiffness = self._along(length - self.free)
        total = elastic + self.damping * rate
        acts = not self._is_slack(elastic) and self._limited(total) == total
        return (stiffness, self.damping) if acts else (0.0, 0.0)

    def energy(self, length: float) -> float:
        """Return the energy that it stores at a length or coordinate [J].

        Args:
            length: between frames, or the coordinate [m or rad].

        Raises:
            TypeError: it is no number.

        Example:
            >>> sp.Spring("return", joint="slide", stiffness=100.0).energy(0.1)  # [J]
            0.5
        """
        end = length - self.free
        low, high = sorted((0.0, end))
        knots = [low, *(x for x, _ in self.law if low < x < high), high]
        total = 0.0
        for a, b in pairwise(knots):
            first, last = self._along(a)[0], self._along(b)[0]
            one, other = self._limited(first), self._limited(last)
            if first * last < 0.0:  # a piece of each side of where the force is none
                middle = a + (b - a) * first / (first - last)
                total += 0.5 * (one * (middle - a) + other * (b - middle))
            else:
                total += 0.5 * (one + other) * (b - a)
        return total if end > 0.0 else -total

    def _along(self, elongation: float) -> tuple[float, float]:
        """Return the elastic force, and its slope."""
        if not self.law:
            return self.stiffness * elongation, self.stiffness
        k = min(max(bisect_right(self.law, (elongation, math.inf)), 1), len(self.law) - 1)
        (a, at_a), (b, at_b) = self.law[k - 1 : k + 1]
        slope = (at_b - at_a) / (b - a)
        return at_a + slope * (elongation - a), slope

    def _is_slack(self, elastic: float) -> bool:
        return (self.tension_only and elastic <= 0.0) or (self.compression_only and elastic >= 0.0)

    def _limited(self, force: float) -> float:
        """Return a force limited to tension or compression."""
        return max(force, 0.0) if self.tension_only else (
            min(force, 0.0) if self.compression_only else force)

    @property
    def free(self) -> float:
        """The length or angle without force [m or rad]: one of the two, the other is zero."""
        return self.free_length + self.free_angle


@dataclass(frozen=True)
class Passive:
    """How the idle rotation of a link is resolved: it does not rotate about a line.

    That is, its absolute rotation about the line has neither speed nor acceleration.

    Attributes:
        name: the name in the mechanism file.
        body: the link.
        axis: names of two frames; the line goes through their origins.

    Example:
        >>> sp.load("rssr").passives
        (Passive(name='coupler_spin', body='coupler', axis=('ball_a', 'coupler_b')),)
    """

    name: str
    body: str
    axis: tuple[str, str]


def drivers_of_tree(joints: Mapping[str, str], closures: Iterable[Closure]) -> dict[str, Driver]:
    """Return the drivers of an open tree that names none: every coordinate, by its own name.

    Coordinates that couplings give and components of balls and floating joints are omitted. A
    mechanism with loops gets none. The pairs are by joint, in the order of the tree.
    """
    closures = list(closures)
    if any(c.frames for c in closures):
        return {}
    given = {c.joints[-1] for c in closures}
    names = [f"{joint}.{suffix}" if suffix else joint
             for joint, pair in joints.items() if PAIRS[pair].is_linear
             for suffix, _ in PAIRS[pair].coordinates]
    return {name: Driver(name, name) for name in names if name not in given}


@dataclass(frozen=True)
class Frame:
    """A frame that the URDF does not have.

    Attributes:
        name: the frame's name.
        link: the link, frame or joint that it is fixed to.
        xyz: its origin in the axes of `link` [m].
        rpy: its orientation there, as URDF has it: turns about fixed x, y, z in this order [rad].

    Example:
        >>> sp.Frame("tool", "rocker", xyz=(0.0, 0.0, 0.1)).placement.translation  # [m]
        array([0. , 0. , 0.1])
    """

    name: str
    link: str
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for what in ("xyz", "rpy"):
            finite_array(getattr(self, what), (3,), f"{what} of frame {self.name!r}")

    @property
    def placement(self) -> pin.SE3:
        """Its placement on `link`."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy), np.array(self.xyz))


def frames_by_name(model: pin.Model) -> dict[str, int]:
    """Return Pinocchio's frame index by name; a link goes before a joint of the same name."""
    ranks = {pin.FrameType.BODY: 0, pin.FrameType.JOINT: 1}
    kinds = [frame.type for frame in model.frames]
    order = sorted(range(1, model.nframes), key=lambda i: -ranks.get(kinds[i], 2))
    return {model.frames[i].name: i for i in order}


def add_frames(model: pin.Model, frames: Mapping[str, Frame], where: str) -> None:
    """Put frames into a model, each after the one that it is fixed to; or refuse their names."""
    known = frames_by_name(model)
    for name in frames:
        if name in known or not name or not name.isprintable():
            raise MechanismFileError(
                f"{where}: frames.{name}: " + ("the tree has a link, joint or frame of that name "
                                               "already; choose another" if name in known else
                                               "a frame needs a name that can be read"))
    for name in frames:
        path: dict[str, None] = {}
        while name not in known:
            if name in path:
                raise MechanismFileError(
                    f"{where}: frames.{name}: hangs on itself: {' on '.join([*path, name])}")
            if name not in frames:
                last = next(reversed(path))
                raise MechanismFileError(f"{where}: frames.{last}: link: " + str(
                    UnknownNameError("link, joint or frame", name, [*known, *frames])))
            path[name] = None
            name = frames[name].link
        for new in reversed(path):
            on = model.frames[known[frames[new].link]]
            known[new] = model.addFrame(pin.Frame(
                new, on.parentJoint, known[frames[new].link],
                on.placement * frames[new].placement, pin.FrameType.OP_FRAME), False)
