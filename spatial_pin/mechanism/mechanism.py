"""What a mechanism is: an open tree, the closures of its loops, drivers, and names for all."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from spatial_pin.errors import (
    ClosureTypeError,
    MechanismFileError,
    SpatialPinError,
    UnknownNameError,
)
from spatial_pin.mechanism.equations import Row
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.mechanism.lazy import cached_property
from spatial_pin.mechanism.named_frames import Frame, frames_by_name
from spatial_pin.mechanism.pairs import COUPLING, PAIRS, Pair, PairGeometry
from spatial_pin.methods import method
from spatial_pin.numerics.linalg import Array

SMALLEST = 1e-100  # m


class Coordinate(NamedTuple):
    """One joint coordinate.

    Attributes:
        name: joint name, or joint name, dot, suffix of the pair.
        joint: name of the joint.
        unit: "rad" or "m".
        q: index in the configuration, -1 when it is not an entry of it (rotation vectors).
        v: index in the velocity.
        place: which of the joint's coordinates it is.
    """

    name: str
    joint: str
    unit: str
    q: int
    v: int
    place: int


class VelocityEntry(Coordinate):
    """An entry of a joint's velocity as Pinocchio has it, which is not its coordinate's rate."""

    __slots__ = ()


@dataclass(frozen=True, eq=False)
class Closure:
    """One loop closure.

    Attributes:
        name, type: as in the mechanism file.
        frames: names of the two frames it joins (empty for a coupling).
        between: names of two other frames whose distance is the length of this one (distance of
            variable length; else empty).
        geometry: the pair's axes, length and lead (None for a coupling).
        joints, ratio, offset: coupling: coordinate `joints[1]` = ratio * `joints[0]` + offset.
        equations: which of the pair's equations are asked for, None for all; the others must
            hold of themselves (planar loops).
        source: where it is stated, if not as a closure of a mechanism file.
    """

    name: str
    type: str
    frames: tuple[str, ...] = ()
    geometry: PairGeometry | None = None
    joints: tuple[str, ...] = ()
    ratio: float = 1.0
    offset: float = 0.0
    equations: tuple[int, ...] | None = None
    between: tuple[str, ...] = ()
    source: str = ""

    @property
    def pair(self) -> Pair:
        """The pair it realises; a coupling has none."""
        return PAIRS[self.type]

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """Its scalar equations on the relative placement (none for a coupling)."""
        if self.geometry is None or self.pair.rows is None:
            return ()
        rows = self.pair.rows(self.geometry)
        return rows if self.equations is None else tuple(rows[k] for k in self.equations)

    @property
    def n_rows(self) -> int:
        """Number of scalar equations."""
        return 1 if self.type == COUPLING else len(self.rows)

    def with_equations(self, places: Iterable[int]) -> Closure:
        """Return it with some of its equations, by their places in `rows`."""
        own = self.equations
        return replace(self, equations=tuple(k if own is None else own[k] for k in places))

    @property
    def can_turn(self) -> bool:
        """Whether it means the same with its two frames exchanged, once all its equations hold."""
        return (self.type != COUPLING and not self.between and not self.pair.uses_lead
                and self.equations is None and self.type not in ("point_on_line", "point_on_plane"))

    def turned(self) -> Closure:
        """Return it with its two frames exchanged: directions of frame 2 in its equations."""
        g = self.geometry
        assert g is not None
        return replace(self, frames=self.frames[::-1],
                       geometry=replace(g, axes1=g.axes2, axes2=g.axes1))


class Equations(NamedTuple):
    """Some equations of a mechanism, by closure: places in `Closure.rows`, a coupling's is 0.

    Attributes:
        own: of the closures as they are.
        turned: of the same with their frames exchanged.
    """

    own: tuple[tuple[int, ...], ...]
    turned: tuple[tuple[int, ...], ...]

    def counts(self) -> list[int]:
        """Return how many there are of each closure."""
        return [len(a) + len(b) for a, b in zip(self.own, self.turned, strict=True)]


@dataclass(frozen=True)
class Driver:
    """A coordinate that is prescribed.

    Attributes:
        name: the driver's name.
        joint: the joint, or coordinate (`joint.slide`), it drives.
    """

    name: str
    joint: str


@dataclass(frozen=True)
class Spring:
    """A spring and damper between two frames, or about or along a joint (SI units).

    Attributes:
        name, frames, joint, stiffness, damping: as in the mechanism file; either two frames or a
            joint's coordinate, whose value is the spring's length or angle.
        free_length: between frames, or of a coordinate that slides, at no force [m].
        free_angle: of a coordinate that turns [rad]; of one that slides it is taken as [m].
    """

    name: str
    frames: tuple[str, ...] = ()
    joint: str | None = None
    stiffness: float = 0.0
    damping: float = 0.0
    free_length: float = 0.0
    free_angle: float = 0.0

    @property
    def free(self) -> float:
        """The length or angle without force [m or rad]: one of the two, the other is zero."""
        return self.free_length + self.free_angle


@dataclass(frozen=True)
class Passive:
    """A passive spin that is resolved: `body` has no absolute spin about the line `axis`."""

    name: str
    body: str
    axis: tuple[str, str]


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A spatial mechanism: Pinocchio model of its open tree plus loop closures.

    Made by `spatial_pin.load`. `model` is a plain `pin.Model`: use it with any Pinocchio call.

    Attributes:
        name, title, source: what the file says of it.
        model: the open tree.
        visual_model, collision_model: its geometry; meshes are read when it is first asked for.
        pairs: pair name of every joint, in the order of `model.joints[1:]`.
        closures: the loop closures, in the file's order.
        drivers: the prescribed coordinates, by name.
        springs, passives: as in the file.
        guess: rough configuration, by joint.
        frames: frames that the URDF does not have, by name.
        inertias: own inertia of every link that has one, in the link's frame.
        parameters: xacro parameters it was loaded with.
        path: the file it came from; tree: the URDF or xacro file of its open tree.
        urdf: the expanded URDF text.
        slip_speeds: (nv,) speed of each coordinate at which its dry friction is nearly whole, as
            in the file [rad/s, m/s]; NaN, or an empty array, for the default.
        trusted, packages: how its files may be read and found, see `load`.
        notices: faults of the file that it was loaded with, a sentence for each kind.
        free_flyer: whether `load` put a floating joint below its root link.
        whole: the mechanism as its file has it, where this one is without equations that the
            file's rounded numbers contradict, see `assembly.rounding`; else None.
        kept: which equations of the `whole` it has.
        dimensions: value of every named dimension (xacro argument), given or by default [SI, rad];
            read when first asked for.
        memo: what analyses keep of it to be made once; goes when the mechanism goes.
    """

    name: str
    model: pin.Model
    visual_model: pin.GeometryModel
    collision_model: pin.GeometryModel
    pairs: tuple[str, ...]
    closures: tuple[Closure, ...] = ()
    drivers: Mapping[str, Driver] = field(default_factory=dict)
    springs: tuple[Spring, ...] = ()
    passives: tuple[Passive, ...] = ()
    guess: Mapping[str, Any] = field(default_factory=dict)
    inertias: Mapping[str, pin.Inertia] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    title: str = ""
    source: str = ""
    path: Path | None = None
    tree: Path | None = None
    urdf: str = ""
    slip_speeds: Array = field(default_factory=lambda: np.empty(0))
    trusted: bool = False
    packages: Mapping[str, Path] = field(default_factory=dict)
    notices: tuple[str, ...] = ()
    frames: Mapping[str, Frame] = field(default_factory=dict)
    free_flyer: bool = False
    whole: Mechanism | None = None
    kept: Equations | None = None
    dimensions: Mapping[str, float] = field(default_factory=dict)
    memo: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @classmethod
    def from_model(
        cls, model: pin.Model, closures: Iterable[Any] = (), *,
        drivers: Mapping[str, str] | Iterable[str] | None = None,
        springs: Iterable[Spring] = (), passives: Iterable[Passive] = (),
        guess: Mapping[str, Any] | ArrayLike | None = None,
        frames: Mapping[str, tuple[str, pin.SE3]] | None = None, name: str | None = None,
        visual_model: pin.GeometryModel | None = None,
        collision_model: pin.GeometryModel | None = None,
    ) -> Mechanism:
        """Return the mechanism of a Pinocchio model, without files.

        The model is copied, with its limits, damping, friction, armature and gravity. Two kinds of
        joints become coordinates that count: `JointModelRUB*` and `JointModelPlanar` keep angles
        as (cos, sin), which become one number; a mimicking joint gets its coordinate back, and a
        coupling. A joint that has no frame or link in the model gets one of its name. What a joint
        carries is the inertia of its first link, apart from what other links brought with them.

        Args:
            model: the open tree; its joints are pairs of this library.
            closures: made by `spatial_pin.closures`, or `pin.RigidConstraintModel`s (3-D or 6-D),
                `pin.PointAnchorConstraintModel`s, `pin.FrameAnchorConstraintModel`s of this model.
                Those without a name, or with one that is taken, get one.
            drivers: joints or coordinates by the drivers' names, or only joints. Default: in a
                tree without closures every coordinate, by its own name; else none.
            springs: `spatial_pin.Spring`s; their frames by name or, as those of closures, as
                (link or joint, `pin.SE3` on it). What stands still is "universe".
            passives: `spatial_pin.Passive`s, likewise.
            guess: rough configuration, by joint, as in a mechanism file, or (nq,) of the model.
            frames: (link, frame or joint, placement on it) by name.
            name: of the mechanism; default that of the model.
            visual_model: what is drawn.
            collision_model: what collides.

        Raises:
            SpatialPinError: a joint is no pair, a name is not there or taken, or a closure or
                number is impossible; says which.
            TypeError: an argument is of another kind.
            ValueError: a number is NaN or infinite.
        """
        made: Mechanism = method("Mechanism.from_model")(
            model, closures, drivers, springs, passives, {} if guess is None else guess,
            frames or {}, name, visual_model, collision_model)
        return made

    def __getstate__(self) -> dict[str, Any]:
        """Return what is copied or sent elsewhere: all but what is worked out again on use."""
        kept = {k: x for k, x in self.__dict__.items() if k not in ("memo", "neutral")}
        parts = {name: (x.mass, x.lever, x.inertia) for name, x in self.inertias.items()}
        return {**kept, "memo": {}, "inertias": parts}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what `__getstate__` gave; Pinocchio's inertias cannot be sent if below zero."""
        inertias = {name: inertia_as_given(*parts) for name, parts in state["inertias"].items()}
        self.__dict__.update({**state, "inertias": inertias})

    def with_fields(self, **fields: Any) -> Mechanism:
        """Return a copy with other values of some fields; unlike `replace` it reads no mesh."""
        other = copy(self)
        other.__dict__.update(fields)
        return other

    @property
    def loading(self) -> dict[str, Any]:
        """What `load` was given besides the file."""
        return {**self.parameters, "trusted": self.trusted, "packages": self.packages,
                "free_flyer": self.free_flyer}

    def with_equations(self, kept: Equations) -> Mechanism:
        """Return the same mechanism with some of its equations only; this one is its `whole`."""
        key = "with equations", kept
        if key not in self.memo:
            closures = []
            for c, own, turned in zip(self.closures, kept.own, kept.turned, strict=True):
                if own or not turned:
                    closures.append(c if c.type == COUPLING else c.with_equations(own))
                if turned:
                    closures.append(c.turned().with_equations(turned))
            other = copy(self)
            vars(other).update(whole=self, kept=kept, closures=tuple(
                c for c in closures if c.type != COUPLING or kept.own[self.closures.index(c)]))
            self.memo[key] = other
        found: Mechanism = self.memo[key]
        return found

    # ------------------------------------------------------------ coordinates

    @cached_property
    def coordinate_table(self) -> dict[str, Coordinate]:
        """Every coordinate by name, in the order of the velocity vector."""
        table: dict[str, Coordinate] = {}
        for i, pair_name in enumerate(self.pairs, start=1):
            pair, joint = PAIRS[pair_name], self.model.names[i]
            for k, (suffix, unit) in enumerate(pair.coordinates):
                name = f"{joint}.{suffix}" if suffix else joint
                q = self.model.idx_qs[i] + k if pair.is_linear else -1
                table[name] = Coordinate(name, joint, unit, q, self.model.idx_vs[i] + k, k)
        return table

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of all joint coordinates, in the order of the velocity vector."""
        return tuple(self.coordinate_table)

    def coordinate(self, name: str) -> Coordinate:
        """Return the coordinate of that name; a driver's name stands for its coordinate.

        Raises:
            UnknownNameError: there is none.
        """
        if isinstance(name, str):
            if name in self.coordinate_table:
                return self.coordinate_table[name]
            if name in self.drivers:
                return self.coordinate_table[self.drivers[name].joint]
        raise UnknownNameError(
            "coordinate or driver", name, [*self.coordinate_table, *self.drivers],
            f"mechanism {self.name!r}: ",
        )

    def prescribed_coordinate(self, name: str) -> Coordinate:
        """Return the coordinate of that name, a component of a ball or a floating joint too.

        Raises:
            UnknownNameError: there is none.
            SpatialPinError: it is a joint of several coordinates.
        """
        if isinstance(name, str) and name in self.coordinate_table:
            return self.coordinate_table[name]
        components = [c.name for c in self.coordinate_table.values()
                      if isinstance(name, str) and c.joint == name]
        if len(components) > 1 and name not in self.drivers:
            raise SpatialPinError(
                f"mechanism {self.name!r}: {name!r} is a {self.pair_of(name)} joint with several "
                f"coordinates: {', '.join(components)}; name those that are meant, such as "
                f"{{{components[0]!r}: 0.1}}"
            )
        return self.coordinate(name)

    def driven_coordinate(self, name: str) -> Coordinate:
        """Return the coordinate of that name, which is an entry of the configuration.

        Raises:
            UnknownNameError: there is none.
            SpatialPinError: it is a component of a spherical or floating joint.
        """
        coordinate = self.prescribed_coordinate(name)
        if coordinate.q < 0:
            raise SpatialPinError(
                f"mechanism {self.name!r}: {coordinate.name!r} is a component of a "
                f"{self.pair_of(coordinate.joint)} joint, no entry of q: it can be prescribed in "
                f"assemble, sweep and solve_rates (such as {{{coordinate.name!r}: 0.1}}), but no "
                "effort, law or search can take hold of it; for these model the joint as a chain "
                "of revolute joints (and prismatic ones)"
            )
        return coordinate

    def place_of(self, coordinate: Coordinate) -> int:
        """Return where a coordinate stands in the configuration, -1 for rotation vectors."""
        if coordinate.q < 0 and coordinate.unit == "m":  # the translation of a floating joint
            return int(self.model.idx_qs[self.joint_id(coordinate.joint)]) + coordinate.place
        return coordinate.q

    def pair_of(self, joint: str) -> str:
        """Return the pair name of a joint of the tree."""
        return self.pairs[self.joint_id(joint) - 1]

    def joint_id(self, joint: str) -> int:
        """Return Pinocchio's index of a joint.

        Raises:
            UnknownNameError: there is none.
        """
        known = isinstance(joint, str) and "\0" not in joint and joint.isprintable()
        if not known or not self.model.existJointName(joint) or joint == "universe":
            raise UnknownNameError("joint", joint, list(self.model.names)[1:],
                                   f"mechanism {self.name!r}: ")
        return int(self.model.getJointId(joint))

    # ------------------------------------------------------------ frames

    @cached_property
    def frame_ids(self) -> dict[str, int]:
        """Pinocchio's frame index by name; a link goes before a joint of the same name."""
        return frames_by_name(self.model)

    def frame_id(self, name: str) -> int:
        """Return Pinocchio's index of a link, frame or joint.

        Raises:
            UnknownNameError: there is none.
        """
        try:
            return self.frame_ids[name]
        except (KeyError, TypeError):
            raise UnknownNameError("link, frame or joint", name, self.frame_ids,
                                   f"mechanism {self.name!r}: ") from None

    @property
    def links(self) -> tuple[str, ...]:
        """Names of all links, the root first."""
        bodies = [f for f in self.model.frames if f.type == pin.FrameType.BODY]
        roots = [f.name for f in bodies if f.parentJoint == 0
                 and np.array_equal(f.placement.homogeneous, np.eye(4))]
        return tuple(dict.fromkeys([*roots[:1], *(f.name for f in bodies)]))

    def frame_on_joint(self, name: str) -> tuple[int, pin.SE3]:
        """Return (joint index, placement in that joint's frame) of a link, frame or joint."""
        frame = self.model.frames[self.frame_id(name)]
        return int(frame.parentJoint), frame.placement

    @property
    def unplaced(self) -> Mapping[str, str]:
        """Links, frames and joints whose motion in the world is not known here: see `Reduced`."""
        return {}

    def placed(self, name: str) -> str:
        """Return the name of a link, frame or joint whose motion in the world is known here.

        Raises:
            SpatialPinError: it is not: see `Reduced`.
        """
        return name

    def start(self, values: Mapping[str, float]) -> Array | None:
        """Return where to assemble when nobody says, (nq,); None for the guess of the file.

        Args:
            values: coordinates to be held [rad, m].
        """
        return None

    # ------------------------------------------------------------ numbers

    @cached_property
    def neutral(self) -> Array:
        """(nq,) the configuration in which every joint stands at its URDF zero."""
        q = pin.neutral(self.model)
        q.flags.writeable = False
        return q

    @cached_property
    def characteristic_length(self) -> float:
        """Largest distance between two joint, closure or named frames at neutral [m]; 1 if 0.

        Raises:
            MechanismFileError: it is so small or large that squares leave the range of numbers.
        """
        joints = [pin.SE3.Identity()]  # every joint is the identity at neutral
        for parent, placement in zip(self.model.parents[1:], self.model.jointPlacements[1:],
                                     strict=True):
            joints.append(joints[parent] * placement)
        points = np.array([joints[f.parentJoint].act(f.placement.translation)
                           for f in self.model.frames])
        reach = np.abs(points).max(axis=1)
        span = float(reach.max())
        if span <= 1.0 / SMALLEST:  # otherwise it may be infinite, or NaN
            unit = 2.0 ** math.frexp(span)[1]  # changes no digit
            points /= unit
            span = unit * _diameter(points)
        if span and not SMALLEST <= span <= 1.0 / SMALLEST:
            frame = self.model.frames[int(np.argmax(reach))].name
            raise MechanismFileError(
                f"{self.path or self.name}: the mechanism is {_large(span)} (frame {frame!r}); "
                f"only sizes from {SMALLEST:g} to {1.0 / SMALLEST:g} m can be worked with")
        return span if span > 0.0 else 1.0

    @cached_property
    def velocity_scale(self) -> Array:
        """(nv,) size of one unit of motion: 1 for angles, the characteristic length for slides."""
        units = [c.unit for c in self.coordinate_table.values()]
        return np.array([1.0 if u == "rad" else self.characteristic_length for u in units])

    def constraint_models(self) -> list[pin.RigidConstraintModel]:
        """Return the closures in Pinocchio's native form (3-D point or 6-D weld).

        Raises:
            ClosureTypeError: a closure is of a type that Pinocchio does not have, or a part of one.
        """
        models = []
        for closure in self.closures:
            native = None if closure.type == COUPLING else closure.pair.native
            if native is None or closure.equations is not None:
                part = "" if native is None else f" with equations {list(closure.equations or ())}"
                raise ClosureTypeError(
                    f"mechanism {self.name!r}: closure {closure.name!r} is {closure.type}{part}; "
                    "Pinocchio's native closures are spherical (3-D) and weld (6-D) only, whole"
                )
            (i1, m1), (i2, m2) = (self.frame_on_joint(f) for f in closure.frames)
            model = pin.RigidConstraintModel(
                native, self.model, i1, m1, i2, m2, pin.ReferenceFrame.LOCAL
            )
            model.name = closure.name
            models.append(model)
        return models

    def save(self, folder: str | Path) -> Path:
        """Write the mechanism as a folder that can be moved: mechanism file, URDF and meshes.

        Args:
            folder: made where there is none; files are called as the mechanism is.

        Returns:
            The mechanism file; what `load` makes of it is equal to this.

        Raises:
            SpatialPinError: a target is a file of the mechanism itself, or cannot be written.
            TypeError: `folder` is no path.
            ValueError: it is the name of a file, or of nothing.
        """
        written: Path = method("Mechanism.save")(self, folder)
        return written

    def __repr__(self) -> str:
        return (
            f"Mechanism({self.name!r}: {self.model.njoints - 1} joints, "
            f"{len(self.coordinates)} coordinates, {len(self.closures)} closures, "
            f"drivers {list(self.drivers)})"
        )


def _large(span: float) -> str:
    return f"{span:.3g} m large" if math.isfinite(span) else "larger than any number"


def _diameter(points: Array) -> float:
    """Return the largest distance between two of the points (N, 3)."""

    def farthest(point: Array) -> float:
        return float(np.linalg.norm(points - point, axis=1).max())

    radii = np.linalg.norm(points - (points.min(axis=0) + points.max(axis=0)) / 2, axis=1)
    least = farthest(points[int(np.argmax(radii))])
    # two points that are farther apart than that lie at least so far from the middle
    outer = radii > least * (1.0 - 4.0 * np.finfo(float).eps) - radii.max()
    return max([least, *map(farthest, points[outer])])


class _MadeWhenAsked:
    """A field that is given its value, or a function that makes it when it is first asked for."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, owner: Any, kind: type | None = None) -> Any:
        if owner is None:
            return self
        value = owner.__dict__[self.name]
        if callable(value):
            value = owner.__dict__[self.name] = value()
        return value

    def __set__(self, owner: Any, value: Any) -> None:
        owner.__dict__[self.name] = value


for _name in ("visual_model", "collision_model", "dimensions"):
    setattr(Mechanism, _name, _MadeWhenAsked(_name))


def drivers_of_tree(
    joints: Mapping[str, str], closures: Iterable[Closure]
) -> dict[str, Driver]:
    """Return what drives an open tree of which nobody says: every coordinate, by its own name.

    Those that couplings give are left out, and the components of balls and floating joints, which
    are no entries of the configuration. Where loops are closed nobody knows: nothing is returned.

    Args:
        joints: pair by joint, in the order of the tree.
        closures: the closures and couplings.
    """
    closures = list(closures)
    if any(c.type != COUPLING for c in closures):
        return {}
    given = {c.joints[1] for c in closures}
    names = [f"{joint}.{suffix}" if suffix else joint
             for joint, pair in joints.items() if PAIRS[pair].is_linear
             for suffix, _ in PAIRS[pair].coordinates]
    return {name: Driver(name, name) for name in names if name not in given}


def check_mechanism(mechanism: Mechanism, where: str) -> None:
    """Refuse names that do not exist and closures that cannot be.

    Raises:
        MechanismFileError: with `where` (the file) and the key at fault.
    """
    _check_unique([c.name for c in mechanism.closures], f"{where}: closures")
    _check_unique([s.name for s in mechanism.springs], f"{where}: springs")
    for closure in mechanism.closures:
        _check_closure(mechanism, closure, f"{where}: closure {closure.name!r}")
    _check_drivers(mechanism, where)
    for spring in mechanism.springs:
        bodies = [_named(mechanism.frame_on_joint, name, f"{where}: spring {spring.name!r}: ")[0]
                  for name in spring.frames]
        if len(bodies) == 2 and bodies[0] == bodies[1]:
            raise MechanismFileError(
                f"{where}: spring {spring.name!r}: frames {spring.frames[0]!r} and "
                f"{spring.frames[1]!r} are fixed to the same body"
            )
        if spring.joint is not None:
            coordinate = _named(mechanism.driven_coordinate, spring.joint,
                                f"{where}: spring {spring.name!r}: ")
            if spring.free_length and coordinate.unit == "rad":
                raise MechanismFileError(
                    f"{where}: spring {spring.name!r}: {spring.joint!r} turns; give free_angle, "
                    "not free_length")
    for passive in mechanism.passives:
        _check_passive(mechanism, passive, f"{where}: passive.{passive.name}")


def _check_drivers(mechanism: Mechanism, where: str) -> None:
    driven: dict[str, str] = {}
    for driver in mechanism.drivers.values():
        here = f"{where}: drivers.{driver.name}"
        table = mechanism.coordinate_table
        if driver.joint in mechanism.drivers and driver.joint not in table:
            raise MechanismFileError(
                f"{here}.joint: {driver.joint!r} is a driver, not a joint or coordinate; "
                f"there are: {', '.join(table)}"
            )
        _named(mechanism.prescribed_coordinate, driver.joint, f"{here}.joint: ")
        if driver.name in table and driver.name != driver.joint:
            raise MechanismFileError(
                f"{here}: has the name of another coordinate than its own, {driver.joint!r}"
            )
        if driver.joint in driven:
            raise MechanismFileError(
                f"{here}: {driver.joint!r} is driven by {driven[driver.joint]!r} already"
            )
        driven[driver.joint] = driver.name


def _check_unique(names: Iterable[str], where: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise MechanismFileError(f"{where}: two are named {name!r}")
        seen.add(name)


def _named(lookup: Any, name: str, where: str) -> Any:
    try:
        return lookup(name)
    except SpatialPinError as error:
        raise MechanismFileError(f"{where}{error}") from error


def _check_closure(mechanism: Mechanism, closure: Closure, where: str) -> None:
    if closure.type == COUPLING:
        for name in closure.joints:
            _named(mechanism.driven_coordinate, name, f"{where}: joints: ")
        if closure.joints[0] == closure.joints[1]:
            raise MechanismFileError(f"{where}: couples {closure.joints[0]!r} with itself")
        return
    ids = _bodies(mechanism, closure.frames, f"{where}: frames: ")
    if closure.frames[0] == closure.frames[1]:
        raise MechanismFileError(f"{where}: joins frame {closure.frames[0]!r} with itself")
    if ids[0] == ids[1]:
        raise MechanismFileError(
            f"{where}: frames {closure.frames[0]!r} and {closure.frames[1]!r} are fixed to the "
            "same body; a closure joins two bodies that can move against each other"
        )
    ids = _bodies(mechanism, closure.between, f"{where}: length_between: ")
    if set(closure.between) == set(closure.frames):
        raise MechanismFileError(f"{where}: length_between: its own frames, which says nothing")
    if len(set(ids)) == 1:
        raise MechanismFileError(
            f"{where}: length_between: {closure.between[0]!r} and {closure.between[1]!r} are fixed "
            "to the same body, so that their distance is constant: give it as length"
        )


def _bodies(mechanism: Mechanism, frames: tuple[str, ...], where: str) -> list[int]:
    return [_named(mechanism.frame_on_joint, name, where)[0] for name in frames]


def _check_passive(mechanism: Mechanism, passive: Passive, where: str) -> None:
    body = _named(mechanism.frame_on_joint, passive.body, f"{where}.body: ")[0]
    if body == 0:
        raise MechanismFileError(f"{where}.body: {passive.body!r} is fixed to the ground")
    points = [point_on_body(mechanism, body, name, f"{where}.axis: ") for name in passive.axis]
    if np.linalg.norm(points[1] - points[0]) < 1e-12 * mechanism.characteristic_length:
        raise MechanismFileError(
            f"{where}.axis: {passive.axis[0]!r} and {passive.axis[1]!r} are the same point"
        )


def point_on_body(mechanism: Mechanism, body: int, name: str, where: str = "") -> Array:
    """Return the point `name` (a frame, or the centre of a joint) in the axes of joint `body`."""
    frame = _named(mechanism.frame_id, name, where)
    joint, placement = mechanism.frame_on_joint(name)
    if joint == body:
        return placement.translation.copy()
    on_parent = mechanism.model.frames[frame].type == pin.FrameType.JOINT
    if on_parent and mechanism.model.parents[joint] == body:
        return mechanism.model.jointPlacements[joint].translation.copy()
    raise MechanismFileError(f"{where}{name!r} is not a point of that body")
