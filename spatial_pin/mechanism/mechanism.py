"""The Mechanism: an open tree, the closures of its loops, and drivers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from spatial_pin._support.brief import counted
from spatial_pin._support.lazy import RESULTS, by_new_name, cached_property, made_once
from spatial_pin.errors import (
    ClosureTypeError,
    MechanismFileError,
    SpatialPinError,
    UnknownNameError,
)
from spatial_pin.mechanism.extent import Extent, centred, extent_of
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mechanism.parts import (
    Closure,
    Coordinate,
    Driver,
    Frame,
    Passive,
    SelectedEquations,
    Spring,
    frames_by_name,
)
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import EPS

WORKED_OUT = RESULTS, "neutral", "centred_model"  # results, which copies work out again on use


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A spatial mechanism: Pinocchio model of its open tree plus loop closures.

    Made by `spatial_pin.load`. `model` is a plain `pin.Model`: use it with any Pinocchio call.

    Attributes:
        name, title, source: as in the file.
        model: the open tree.
        visual_model, collision_model: its geometry; meshes are read at the first use.
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
        gap: largest closure error that redundant equations may keep where the numbers of its file
            are rounded [-]; 0: the numbers are exact; None: that of the accuracy.
        model_of_file, without: the model of its file, and the omitted elements, see `load`.
        whole: the mechanism as its file has it, where this one is without equations that the
            file's rounded numbers contradict, see `assembly.redundant_equations`; else None.
        selection: which equations of the `whole` it has.
        content: what its mechanism file says, as it is written there.
        dimensions: value of every named dimension (xacro argument), given or by default [SI, rad];
            read at the first use.

    Example:
        >>> mech = sp.load("rssr", d=0.315)  # [m]
        >>> mech.model.nq, mech.coordinates  # model is a plain pinocchio.Model
        (6, ('crank_pin', 'ball_a.x', 'ball_a.y', 'ball_a.z', 'rocker_pin'))
        >>> mech.links
        ('ground', 'crank', 'coupler', 'coupler_b', 'rocker', 'rocker_b')
        >>> print(f"{mech.characteristic_length:.3f} m")
        0.603 m
        >>> mech.neutral  # (nq,): crank, quaternion of the ball, rocker
        array([0., 0., 0., 0., 1., 0.])
        >>> mech.centre  # [m] solvers work relative to it; here the world's origin, which is near
        array([0., 0., 0.])
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
    gap: float | None = None
    model_of_file: str | None = None
    without: tuple[str, ...] = ()
    whole: Mechanism | None = None
    selection: SelectedEquations | None = None
    content: Mapping[str, Any] = field(default_factory=dict)
    dimensions: Mapping[str, float] = field(default_factory=dict)

    @property
    def kept(self) -> SelectedEquations | None:
        """The old name of `selection`; it warns."""
        value: SelectedEquations | None = by_new_name(self, "kept", "selection")
        return value

    @classmethod
    def from_model(
        cls, model: pin.Model, closures: Iterable[Any] = (), *,
        drivers: Mapping[str, str] | Iterable[str] | None = None,
        springs: Iterable[Spring] = (), passives: Iterable[Passive] = (),
        guess: Mapping[str, Any] | ArrayLike | None = None,
        frames: Mapping[str, tuple[str, pin.SE3]] | None = None, name: str | None = None,
        visual_model: pin.GeometryModel | None = None,
        collision_model: pin.GeometryModel | None = None, gap: float | None = None,
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
                (link or joint, `pin.SE3` on it). The ground is "universe".
            passives: `spatial_pin.Passive`s, likewise.
            guess: rough configuration, by joint, as in a mechanism file, or (nq,) of the model.
            frames: (link, frame or joint, placement on it) by name.
            name: of the mechanism; default that of the model.
            visual_model: the shapes that are drawn.
            collision_model: what collides.
            gap: see the attribute.

        Returns:
            The Mechanism.

        Raises:
            SpatialPinError: a joint is no pair, a name is not there or taken, or a closure or
                number is impossible; says which.
            TypeError: an argument is of another kind.
            ValueError: a number is NaN or infinite.

        Example:
            >>> model = pin.Model()
            >>> for name, x in (("lever", 0.0), ("arm", 1.0)):  # two hinges, 1 m apart
            ...     placement = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
            ...     joint = model.addJoint(0, pin.JointModelRY(), placement, name)
            >>> ends = [(name, pin.SE3(np.eye(3), np.array([0.0, 0.0, z])))
            ...         for name, z in (("lever", 0.5), ("arm", 0.4))]
            >>> rod = sp.closures.distance(*ends, 1.0)  # of 1 m between the ends
            >>> mech = sp.Mechanism.from_model(model, [rod], drivers=["lever"])
            >>> print(f"{sp.assemble(mech, {'lever': 0.2}).coordinate('arm').value:.4f} rad")
            0.2377 rad
        """
        from spatial_pin.formats.pinocchio_model.from_model import mechanism_of

        return mechanism_of(
            model, closures, drivers, springs, passives, {} if guess is None else guess,
            frames or {}, name, visual_model, collision_model, gap)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields to copy or pickle: all but results that are worked out again on use."""
        fields = {k: x for k, x in self.__dict__.items() if k not in WORKED_OUT}
        parts = {name: (x.mass, x.lever, x.inertia) for name, x in self.inertias.items()}
        return {**fields, "inertias": parts}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set the fields from `__getstate__`; Pinocchio cannot pickle negative inertias."""
        inertias = {name: inertia_as_given(*parts) for name, parts in state["inertias"].items()}
        self.__dict__.update({**state, "inertias": inertias})

    def with_fields(self, **fields: Any) -> Mechanism:
        """Return a copy with other values of some fields; unlike `replace` it reads no mesh."""
        other = object.__new__(type(self))
        own = {key: x for key, x in self.__dict__.items() if key not in WORKED_OUT}
        other.__dict__.update({**own, **fields})
        return other

    @property
    def loading(self) -> dict[str, Any]:
        """The options of `load`."""
        return {**self.parameters, "trusted": self.trusted, "packages": self.packages,
                "free_flyer": self.free_flyer, "model": self.model_of_file,
                "without": self.without, "gap": self.gap}

    @made_once
    def with_equations(self, selection: SelectedEquations) -> Mechanism:
        """Return the same mechanism with some of its equations only; this one is its `whole`."""
        closures, length = list[Closure](), self.characteristic_length
        for c, own, turned in zip(self.closures, selection.own, selection.turned, strict=True):
            if own or (c.frames and not turned):
                closures.append(c.with_equations(own, length) if c.frames else c)
            if turned:
                closures.append(c.turned().with_equations(turned, length))
        return self.with_fields(whole=self, selection=selection, closures=tuple(closures))

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

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of all joint coordinates, in the order of the velocity vector."""
        return tuple(self.coordinate_table)

    def coordinate(self, name: str) -> Coordinate:
        """Return the coordinate of that name; a driver's name means its coordinate.

        Raises:
            UnknownNameError: there is none.

        Example:
            >>> mech = sp.load("rssr")
            >>> mech.coordinate("crank").name, mech.coordinate("rocker_pin").unit
            ('crank_pin', 'rad')
        """
        if isinstance(name, str):
            if name in self.coordinate_table:
                return self.coordinate_table[name]
            if name in self.drivers and self.drivers[name].joint in self.coordinate_table:
                return self.coordinate_table[self.drivers[name].joint]
        known = [d.name for d in self.drivers.values() if d.joint in self.coordinate_table]
        raise UnknownNameError("coordinate or driver", name, [*self.coordinate_table, *known],
                               f"mechanism {self.name!r}: ")

    def prescribed_coordinate(self, name: str) -> Coordinate:
        """Return the coordinate of that name, a component of a ball or a floating joint too.

        Raises:
            UnknownNameError: there is none.
            SpatialPinError: it is a joint of several coordinates.
        """
        if isinstance(name, str) and name in self.coordinate_table:
            return self.coordinate_table[name]
        if isinstance(name, str) and name in self.drivers:
            return self.coordinate(name)
        components = [c.name for c in self.coordinate_table.values()
                      if isinstance(name, str) and c.joint == name]
        if len(components) > 1:
            raise SpatialPinError(
                f"mechanism {self.name!r}: {name!r} is a {self.pair_of(name)} joint with several "
                f"coordinates: {', '.join(components)}; name the intended ones, such as "
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

    def index_of(self, coordinate: Coordinate) -> int:
        """Return the index of a coordinate in the configuration, -1 for rotation vectors."""
        if coordinate.q < 0 and coordinate.unit == "m":  # the translation of a floating joint
            return int(self.model.idx_qs[self.joint_id(coordinate.joint)]) + coordinate.component
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

        Example:
            >>> mech = sp.load("rssr")
            >>> mech.model.frames[mech.frame_id("rocker_b")].name
            'rocker_b'
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
        """Return the default start (nq,) of an assembly; None for the guess of the file.

        Args:
            values: coordinates to be held [rad, m].
        """
        return None

    # ------------------------------------------------------------ numbers

    @cached_property
    def neutral(self) -> Array:
        """(nq,) the configuration in which every joint is at its URDF zero."""
        q = pin.neutral(self.model)
        q.flags.writeable = False
        return q

    @cached_property
    def extent(self) -> Extent:
        """Its size and position: the characteristic length and a centre close to it.

        Raises:
            MechanismFileError: it is so small or large that squares leave the range of numbers.
        """
        whole = self.whole or self
        joined = [self.frame_ids.get(name, 0) for closure in whole.closures
                  for name in (*closure.frames, *closure.between)]
        return extent_of(self.model, set(joined), str(self.path or self.name))

    @cached_property
    def closure_resolution(self) -> float:
        """The least closure error that can be known [-]: of smaller ones no digit is right.

        It is the round-off of positions, one rounding for each joint on the two chains that a
        closure joins, or of coordinates in the world if that is more; 0 without closures.

        Example:
            >>> f"{sp.load('four_bar').closure_resolution:.1e}"  # two joints on each chain
            '8.9e-16'
        """
        if not self.closures:
            return 0.0
        chains = 2 * max(len(support) - 1 for support in self.model.supports)
        return max(EPS * chains, self.extent.resolution)

    @cached_property
    def characteristic_length(self) -> float:
        """Largest distance between two joint, closure or named frames at neutral [m]; 1 if 0.

        Frames of the ground that nothing is joined to count where they are near the others: the
        world's own does not in site coordinates.

        Raises:
            MechanismFileError: it is so small or large that squares leave the range of numbers.
        """
        return self.extent.length

    @property
    def centre(self) -> Array:
        """(3,) the origin of the solvers [m]: a point near the machine, or the world's origin."""
        return self.extent.centre

    @cached_property
    def centred_model(self) -> pin.Model:
        """The open tree relative to the `centre`; `model` itself where that is the origin."""
        centre = self.extent.centre
        return centred(self.model, centre) if centre.any() else self.model

    def centred_frame(self, name: str) -> tuple[int, pin.SE3]:
        """Return the same as `frame_on_joint`, but on the ground relative to the `centre`."""
        frame = self.centred_model.frames[self.frame_id(name)]
        return int(frame.parentJoint), frame.placement

    @cached_property
    def velocity_scale(self) -> Array:
        """(nv,) size of one unit of motion: 1 for angles, the characteristic length for slides."""
        units = [c.unit for c in self.coordinate_table.values()]
        return np.array([1.0 if u == "rad" else self.characteristic_length for u in units])

    def constraint_models(self) -> list[pin.RigidConstraintModel]:
        """Return the closures in Pinocchio's native form (3-D point or 6-D weld).

        Raises:
            ClosureTypeError: a closure is of a type that Pinocchio does not have, or a part of one.

        Example:
            >>> [(model.name, str(model.type)) for model in sp.load("rssr").constraint_models()]
            [('ball_b', 'CONTACT_3D')]
        """
        models = []
        for closure in self.closures:
            native = closure.pair.native
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

    def with_point(
        self, name: str, body: str, xyz: ArrayLike = (0.0, 0.0, 0.0),
        rpy: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Mechanism:
        """Return the mechanism with a point, or frame, on a body.

        Args:
            name: valid wherever that of a frame is.
            body: the link, joint or frame that it is fixed to.
            xyz: (3,) its origin in that frame [m].
            rpy: (3,) its roll, pitch and yaw there [rad].

        Returns:
            A new Mechanism; it is saved with the point and has the same dimensions.

        Raises:
            MechanismFileError: there is no such body, or the name is taken.
            ValueError: a number is NaN or infinite, or there are not three.

        Example:
            >>> mech = sp.load("four_bar").with_point("mid", "coupler", (0.1, 0.0, 0.05))
            >>> sp.assemble(mech, {"crank": 0.0}).placement("mid").translation.shape
            (3,)
        """
        from spatial_pin.formats.mechanism_writer import with_point

        return with_point(self, name, body, xyz, rpy)

    def with_mass(
        self, body: str, mass: float, com: ArrayLike = (0.0, 0.0, 0.0), inertia: ArrayLike = 0.0,
    ) -> Mechanism:
        """Return the mechanism with another mass of a body.

        Args:
            body: the link.
            mass: [kg].
            com: (3,) its centre of mass in the link's frame [m].
            inertia: about the centre of mass, in the link's axes: one number, three, or (3, 3)
                [kg·m²].

        Returns:
            A new Mechanism; it is saved with the mass and has the same dimensions.

        Raises:
            UnknownNameError: there is no such link.
            MechanismFileError: the mass is below zero, or the inertia not symmetric.
            ValueError: a number is NaN or infinite, or there are more or fewer.

        Example:
            >>> mech = sp.load("four_bar").with_mass("coupler", 2.0, (0.1, 0.0, 0.0), 0.01)
            >>> mech.inertias["coupler"].mass
            2.0
        """
        from spatial_pin.formats.mechanism_writer import with_mass

        return with_mass(self, body, mass, com, inertia)

    def save(self, folder: str | Path, tabulate: Any = None) -> Path:
        """Write the mechanism as a folder that can be moved: mechanism file, URDF and meshes.

        Args:
            folder: made where there is none; files are called as the mechanism is.
            tabulate: of couplings whose function is code, which no file has: the values (n,) of
                the first coordinate at which a table is written, rising [rad or m]; or in how many
                equal parts a turn is cut, of a function that repeats with it; or these by the names
                of closures. `load` reads the quintic spline through the table.

        Returns:
            The mechanism file; what `load` makes of it is equal to this.

        Raises:
            SpatialPinError: a target is a file of the mechanism itself, or cannot be written; or
                a function in code has no `tabulate`.
            TypeError: `folder` is no path.
            ValueError: it is the name of a file, or of nothing.

        Example:
            >>> file = sp.load("rssr", d=0.315).save("my_rssr")
            >>> file.name, sp.load(file).coordinates == sp.load("rssr").coordinates
            ('rssr.toml', True)
        """
        from spatial_pin.formats.mechanism_writer import save

        return save(self, folder, tabulate)

    def _repr_html_(self) -> str:
        """Return a small table, for a notebook."""
        from spatial_pin.view.page import cards

        return cards.mechanism(self)

    def __repr__(self) -> str:
        return (
            f"Mechanism({self.name!r}: {counted(self.model.njoints - 1, 'joint')}, "
            f"{counted(len(self.coordinates), 'coordinate')}, "
            f"{counted(len(self.closures), 'closure')}, "
            f"drivers {list(self.drivers)})"
        )


class _LazyField:
    """A field with a value, or with a function that returns it at the first use."""

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


for _name in ("visual_model", "collision_model", "dimensions", "guess"):
    setattr(Mechanism, _name, _LazyField(_name))


def point_on_body(mechanism: Mechanism, body: int, name: str, where: str = "") -> Array:
    """Return the point `name` (a frame, or the centre of a joint) in the axes of joint `body`."""
    model = mechanism.model
    frame = model.frames[mechanism.frame_id(name)]
    joint = frame.parentJoint
    if joint == body:
        return frame.placement.translation.copy()
    if frame.type == pin.FrameType.JOINT and model.parents[joint] == body:
        return model.jointPlacements[joint].translation.copy()
    raise MechanismFileError(f"{where}{name!r} is not a point of that body")


def rigid_distance(one: tuple[int, pin.SE3], two: tuple[int, pin.SE3]) -> float | None:
    """Return the distance [m] of two frames that one joint moves; None where two move them.

    Args:
        one: a frame: the joint, and its placement on that.
        two: another.
    """
    if one[0] != two[0]:
        return None
    return float(np.linalg.norm(two[1].translation - one[1].translation))
