"""A mechanism drawn in code: bodies, and joints at places of the world."""

from __future__ import annotations

import math
import numbers
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.errors import SpatialPinError, suggestion
from spatial_pin.formats.drawn_file import GROUND, is_dimension_name
from spatial_pin.formats.file_access import HeldFile, toml_text
from spatial_pin.formats.files import load
from spatial_pin.mechanism.mechanism import Mechanism


class Symbol:
    """A number that follows from dimensions of a drawing: `d["b"]`, `2 * d["b"]`.

    Operators are + - * / **; functions `sqrt`, `sin`, `cos`, `tan` and `atan2` are methods, those
    of a drawing (`d.sin(d["phi"])`), and NumPy's (`np.sin(d["phi"])`). Those of `math` would lose
    the dimension; they raise a TypeError.

    Args:
        text: the expression.
        drawing: the drawing that has the dimensions.
    """

    def __init__(self, text: str, drawing: Drawing) -> None:
        self.text, self.drawing = text, drawing

    def __repr__(self) -> str:
        return f"Symbol({self.text})"

    def _with(self, other: Any, sign: str, is_first: bool = True) -> Any:
        """Return what an operator makes of this and another number."""
        if not isinstance(other, Symbol | numbers.Real) or isinstance(other, bool):
            return NotImplemented
        pair = (self, other) if is_first else (other, self)
        return Symbol(f" {sign} ".join(_operand(x, self.drawing) for x in pair), self.drawing)

    def __add__(self, other: Any) -> Any:
        return self._with(other, "+")

    def __radd__(self, other: Any) -> Any:
        return self._with(other, "+", False)

    def __sub__(self, other: Any) -> Any:
        return self._with(other, "-")

    def __rsub__(self, other: Any) -> Any:
        return self._with(other, "-", False)

    def __mul__(self, other: Any) -> Any:
        return self._with(other, "*")

    def __rmul__(self, other: Any) -> Any:
        return self._with(other, "*", False)

    def __truediv__(self, other: Any) -> Any:
        return self._with(other, "/")

    def __rtruediv__(self, other: Any) -> Any:
        return self._with(other, "/", False)

    def __pow__(self, other: Any) -> Any:
        return self._with(other, "**")

    def __rpow__(self, other: Any) -> Any:
        return self._with(other, "**", False)

    def __neg__(self) -> Symbol:
        return Symbol(f"-{_operand(self, self.drawing)}", self.drawing)

    def __pos__(self) -> Symbol:
        return self

    def sqrt(self) -> Symbol:
        """Return the square root."""
        return Symbol(f"sqrt({self.text})", self.drawing)

    def sin(self) -> Symbol:
        """Return the sine [rad]."""
        return Symbol(f"sin({self.text})", self.drawing)

    def cos(self) -> Symbol:
        """Return the cosine [rad]."""
        return Symbol(f"cos({self.text})", self.drawing)

    def tan(self) -> Symbol:
        """Return the tangent [rad]."""
        return Symbol(f"tan({self.text})", self.drawing)

    def atan2(self, x: float | Symbol) -> Symbol:
        """Return the angle whose tangent is this over x, in its quadrant [rad]."""
        return Symbol(f"atan2({self.text}, {_operand(x, self.drawing)})", self.drawing)

    arctan2 = atan2  # NumPy's word


def _operand(value: Any, drawing: Drawing) -> str:
    """Return a number, or a symbol of the drawing, as an operand of an expression."""
    if isinstance(value, Symbol):
        if value.drawing is not drawing:
            raise SpatialPinError(f"drawing {drawing.name!r}: {value.text} is a dimension of "
                                  f"drawing {value.drawing.name!r}; declare it here, too")
        return value.text if value.text.isidentifier() else f"({value.text})"
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"drawing {drawing.name!r}: {number} beside a dimension; a finite number "
                         "is needed")
    return repr(number) if number >= 0.0 else f"({number!r})"


Number = float | Symbol
PointLike = Sequence[Any] | NDArray[Any]  # (3,) numbers, or two in the plane z = 0


class Drawing:
    """A mechanism as it is drawn: bodies, and joints at places of the world.

    All numbers are those of the drawn pose in the axes of the world [m, rad, kg]. The body
    `"ground"` stands still. The frame of every body is that of the world in the drawn pose, and
    every coordinate is zero there. `mechanism` chooses a tree and cuts the loops; the order of the
    statements means nothing.

    `d["b"] = 0.3` makes a dimension; its symbol `d["b"]`, or an expression of it, may stand
    wherever a number may. A place has three numbers, or two in the plane z = 0. `mechanism` lists
    all unknown names of bodies and points in one error.

    Args:
        name: of the mechanism.
        title: a few words for pictures.
        source: where the numbers come from.
        density: of bars, which then have masses [kg/m³].
        radius: of bars [m]; default 3 % of the root mean square distance of joints and points
            from their mean.

    Raises:
        TypeError: the name is no text.

    Example:
        >>> d = sp.Drawing("four_bar")
        >>> d["b"] = 0.3
        >>> _ = d.body("crank").body("coupler", mass=0.5).body("rocker")
        >>> _ = d.hinge("A", "ground", "crank", at=(0, 0, 0), axis=(0, 0, 1))
        >>> _ = d.hinge("B", "crank", "coupler", at=(0, 0.1, 0), axis=(0, 0, 1))
        >>> _ = d.hinge("C", "coupler", "rocker", at=(d["b"], 0.2, 0), axis=(0, 0, 1))
        >>> _ = d.hinge("D", "ground", "rocker", at=(d["b"], 0, 0), axis=(0, 0, 1))
        >>> mech = d.drive("A").mechanism()
        >>> mech.notices
        ("a loop is cut at joint 'C' (revolute), which becomes a closure",)
        >>> print(f"{sp.assemble(mech, {'A': 0.5}).coordinate('D').value:.4f} rad")
        0.2525 rad
        >>> longer = d.mechanism(b=0.35)  # drawn anew
    """

    pi = math.pi
    sqrt, sin, cos, tan, atan2 = np.sqrt, np.sin, np.cos, np.tan, np.arctan2  # of symbols

    def __init__(self, name: str, *, title: str = "", source: str = "",
                 density: Number | None = None, radius: Number | None = None) -> None:
        if not isinstance(name, str) or not name:
            raise TypeError(f"a drawing needs a name, not {name!r}")
        self.name = name
        self._dimensions: dict[str, float] = {}
        self._tables: dict[str, dict[str, Any]] = {
            key: {} for key in (
                "bodies", "joints", "points", "rods", "gears", "drivers", "springs")}
        self._top = {"name": name, **{key: x for key, x in (
            ("title", title), ("source", source), ("density", self._given(density, "density")),
            ("radius", self._given(radius, "radius"))) if x}}

    # ------------------------------------------------------------ dimensions

    def __setitem__(self, name: str, value: float) -> None:
        """Declare a dimension, or give it another value."""
        if not isinstance(name, str) or not is_dimension_name(name):
            raise SpatialPinError(f"drawing {self.name!r}: {name!r} cannot be a dimension's name: "
                                  "letters, digits and _ make one that is no function and no "
                                  "argument of load")
        if isinstance(value, Symbol):
            raise TypeError(f"drawing {self.name!r}: dimension {name!r} is a number, not the "
                            f"expression {value.text}; an expression is a variable of Python")
        self._dimensions[name] = self._given(value, f"dimension {name!r}")

    def __getitem__(self, name: str) -> Symbol:
        """Return the symbol of a dimension."""
        if name not in self._dimensions:
            raise SpatialPinError(f"drawing {self.name!r}: there is no dimension {name!r}; "
                                  f"{suggestion(name, self._dimensions)}")
        return Symbol(name, self)

    def _given(self, value: Any, what: str) -> Any:
        """Return a value as a mechanism file has it; numbers are finite."""
        if isinstance(value, Symbol):
            return f"${{{_operand(value, self)}}}"
        if isinstance(value, dict):
            return {key: self._given(x, f"{what}.{key}") for key, x in value.items()}
        if isinstance(value, list | tuple | np.ndarray):
            return [self._given(math.nan if x is None else x, what) for x in value]
        if isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_):
            if not math.isfinite(value) and what.rpartition(" ")[2] not in ("lower", "upper"):
                raise ValueError(f"drawing {self.name!r}: {what} has {float(value)}; a finite "
                                 "number is needed")
            return float(value)
        if value is None or isinstance(value, str | bool):
            return value
        raise TypeError(f"drawing {self.name!r}: {what} is {str(value)[:60]!r}; a number is "
                        "needed, or a dimension")

    def _checked_point(self, value: Any, what: str) -> Any:
        """Return a place or direction (3,); in the plane z = 0 two numbers are enough."""
        count = len(value) if isinstance(value, list | tuple | np.ndarray) else 0
        if count not in (2, 3):
            raise ValueError(f"drawing {self.name!r}: {what} needs three numbers, not "
                             f"{str(value)[:60]}")
        return self._given([*value, *[0.0] * (3 - count)], what)

    def _add(self, table: str, name: str, what: str, content: Mapping[str, Any]) -> Drawing:
        if not isinstance(name, str) or not name or not name.isprintable() or "$" in name:
            raise SpatialPinError(f"drawing {self.name!r}: {what} {name!r}: no name, or one with $ "
                                  "or what cannot be read")
        if name in self._tables[table]:
            raise SpatialPinError(f"drawing {self.name!r}: there is a {what} {name!r} already")
        self._tables[table][name] = {
            key: self._given(x, f"{what} {name!r}, {key}") for key, x in content.items()
            if x is not None}
        return self

    # ------------------------------------------------------------ parts

    def body(
        self, name: str, *, mass: Number | None = None, com: PointLike | None = None,
        inertia: Any = None, density: Number | None = None,
    ) -> Drawing:
        """Add a body.

        Args:
            name: its name.
            mass: [kg]; without one it has none, unless its bars have a density.
            com: (3,) its centre of mass [m]; default the mean of the places of its joints.
            inertia: about the centre of mass, in the world's axes: one number, three, or (3, 3)
                [kg·m²]; default zero, a point.
            density: of its bars [kg/m³].

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("pendulum").body("bob", mass=2.0, com=(0, 0, -1))
            >>> mech = d.hinge("pin", "ground", "bob", at=(0, 0, 0), axis=(0, 1, 0)).mechanism()
            >>> mech.inertias["bob"].lever  # [m]
            array([ 0.,  0., -1.])
        """
        if name == GROUND:
            raise SpatialPinError(f"drawing {self.name!r}: {GROUND!r} stands still, and is there "
                                  "already; give the body another name")
        at = None if com is None else self._checked_point(com, f"body {name!r}, com")
        return self._add("bodies", name, "body", {
            "mass": mass, "com": at, "inertia": inertia, "density": density})

    def joint(
        self, kind: str, name: str, one: str, two: str, at: PointLike | None = None,
        axis: PointLike | None = None, axis2: PointLike | None = None, **more: Any,
    ) -> Drawing:
        """Add a joint of any type of a mechanism file.

        Args:
            kind: its type, such as "revolute" or "floating".
            name: of the joint and its coordinates.
            one: the first body, or "ground".
            two: the second; coordinates are its motion relative to the first.
            at: (3,) its place [m].
            axis: (3,) direction of any length; default that of a mechanism file.
            axis2: (3,) second pin of a universal joint.
            **more: `lead`, limits and resistances, as in a mechanism file: `lower`, `upper`,
                `damping`, `friction`, `effort`, ...

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("drone").body("hull", mass=1.0, inertia=0.01)
            >>> d.joint("floating", "base", "ground", "hull").mechanism().pairs
            ('floating',)
        """
        vectors = {key: None if x is None else self._checked_point(x, f"joint {name!r}, {key}")
                  for key, x in (("at", at), ("axis", axis), ("axis2", axis2))}
        return self._add("joints", name, "joint", {
            "type": kind, "between": [one, two], **vectors, **more})

    def hinge(
        self, name: str, one: str, two: str, at: PointLike,
        axis: PointLike = (0.0, 0.0, 1.0), **more: Any,
    ) -> Drawing:
        """Add a hinge, a revolute joint.

        Args:
            name: of the joint and its coordinate.
            one: the first body, or "ground".
            two: the second; coordinates are its motion relative to the first.
            at: (3,) a point of its axis [m].
            axis: (3,) direction of any length; default z.
            **more: limits and resistances, as in a mechanism file: `lower`, `upper`, `damping`,
                `friction`, `effort`, ...

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("one").body("a")
            >>> d.hinge("J", "ground", "a", at=(0, 0)).mechanism().coordinates
            ('J',)
        """
        return self.joint("revolute", name, one, two, at, axis, **more)

    def ball(self, name: str, one: str, two: str, at: PointLike, **more: Any) -> Drawing:
        """Add a ball, a spherical joint.

        Args:
            name: of the joint and its coordinate.
            one: the first body, or "ground".
            two: the second; coordinates are its motion relative to the first.
            at: (3,) its centre [m].
            **more: limits and resistances, as in a mechanism file: `lower`, `upper`, `damping`,
                `friction`, `effort`, ...

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("one").body("a")
            >>> d.ball("J", "ground", "a", at=(0, 0)).mechanism().coordinates
            ('J.x', 'J.y', 'J.z')
        """
        return self.joint("spherical", name, one, two, at, **more)

    def slider(
        self, name: str, one: str, two: str, at: PointLike, axis: PointLike, **more: Any
    ) -> Drawing:
        """Add a slider, a prismatic joint.

        Args:
            name: of the joint and its coordinate.
            one: the first body, or "ground".
            two: the second; coordinates are its motion relative to the first.
            at: (3,) a point of its axis [m].
            axis: (3,) direction of any length.
            **more: limits and resistances, as in a mechanism file: `lower`, `upper`, `damping`,
                `friction`, `effort`, ...

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("one").body("a")
            >>> d.slider("J", "ground", "a", at=(0, 0), axis=(1, 0)).mechanism().coordinates
            ('J',)
        """
        return self.joint("prismatic", name, one, two, at, axis, **more)

    def cylindrical(
        self, name: str, one: str, two: str, at: PointLike, axis: PointLike, **more: Any
    ) -> Drawing:
        """Add a joint that turns about an axis and slides along it.

        Args:
            name: of the joint and its coordinate.
            one: the first body, or "ground".
            two: the second; coordinates are its motion relative to the first.
            at: (3,) a point of its axis [m].
            axis: (3,) direction of any length.
            **more: limits and resistances, as in a mechanism file: `lower`, `upper`, `damping`,
                `friction`, `effort`, ...

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("one").body("a")
            >>> d.cylindrical("J", "ground", "a", at=(0, 0), axis=(1, 0)).mechanism().coordinates
            ('J.angle', 'J.slide')
        """
        return self.joint("cylindrical", name, one, two, at, axis, **more)

    def universal(
        self, name: str, one: str, two: str, at: PointLike, axis: PointLike, axis2: PointLike,
        **more: Any,
    ) -> Drawing:
        """Add a universal joint, of two pins that cross at right angles.

        Args:
            name: of the joint and its coordinate.
            one: the first body, or "ground".
            two: the second; coordinates are its motion relative to the first.
            at: (3,) where they cross [m].
            axis: (3,) direction of the pin in the first body.
            axis2: (3,) that of the pin in the second.
            **more: limits and resistances, as in a mechanism file: `lower`, `upper`, `damping`,
                `friction`, `effort`, ...

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("one").body("a")
            >>> _ = d.universal("J", "ground", "a", at=(0, 0), axis=(1, 0), axis2=(0, 1))
            >>> d.mechanism().coordinates
            ('J.first', 'J.second')
        """
        return self.joint("universal", name, one, two, at, axis, axis2, **more)

    def screw(
        self, name: str, one: str, two: str, at: PointLike, axis: PointLike, lead: Number,
        **more: Any,
    ) -> Drawing:
        """Add a screw.

        Args:
            name: of the joint and its coordinate.
            one: the first body, or "ground".
            two: the second; coordinates are its motion relative to the first.
            at: (3,) a point of its axis [m].
            axis: (3,) direction of any length.
            lead: translation along the axis in a turn [m], positive for a right-handed thread.
            **more: limits and resistances, as in a mechanism file: `lower`, `upper`, `damping`,
                `friction`, `effort`, ...

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("one").body("a")
            >>> _ = d.screw("J", "ground", "a", at=(0, 0), axis=(1, 0), lead=0.01)
            >>> d.mechanism().coordinates
            ('J',)
        """
        return self.joint("screw", name, one, two, at, axis, lead=lead, **more)

    def planar(
        self, name: str, one: str, two: str, at: PointLike,
        axis: PointLike = (0.0, 0.0, 1.0), **more: Any,
    ) -> Drawing:
        """Add a joint that slides and turns in a plane.

        Args:
            name: of the joint and its coordinate.
            one: the first body, or "ground".
            two: the second; coordinates are its motion relative to the first.
            at: (3,) a point of the plane [m].
            axis: (3,) normal of the plane; default z.
            **more: limits and resistances, as in a mechanism file: `lower`, `upper`, `damping`,
                `friction`, `effort`, ...

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("one").body("a")
            >>> d.planar("J", "ground", "a", at=(0, 0)).mechanism().coordinates
            ('J.x', 'J.y', 'J.angle')
        """
        return self.joint("planar", name, one, two, at, axis, **more)

    def weld(self, name: str, one: str, two: str, at: PointLike = (0.0, 0.0, 0.0)) -> Drawing:
        """Fix two bodies to each other.

        Args:
            name: of the joint.
            one: the first body, or "ground".
            two: the second.
            at: (3,) where, which is drawn only [m].

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("one").body("a")
            >>> d.weld("J", "ground", "a").mechanism().coordinates
            ()
        """
        return self.joint("fixed", name, one, two, at)

    def point(self, name: str, body: str, at: PointLike) -> Drawing:
        """Add a point of a body: a frame in the axes of the world as it is drawn.

        Args:
            name: valid wherever that of a frame is.
            body: the body, or "ground".
            at: (3,) its place [m].

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("lever").body("arm").hinge("pin", "ground", "arm", at=(0, 0))
            >>> mech = d.point("tip", "arm", at=(0.5, 0)).mechanism()
            >>> sp.assemble(mech, {"pin": 0.0}).placement("tip").translation  # [m]
            array([0.5, 0. , 0. ])
        """
        coordinates = self._checked_point(at, f"point {name!r}, at")
        return self._add("points", name, "point", {"body": body, "at": coordinates})

    def rod(self, name: str, one: str, two: str) -> Drawing:
        """Hold two points of two bodies as far apart as they are drawn.

        A body that only rods hold floats in the tree, by a joint of its name.

        Args:
            name: its name.
            one: a point.
            two: another, of another body.

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or is none.

        Example:
            >>> d = sp.Drawing("tied").body("arm").ball("pivot", "ground", "arm", at=(0, 0))
            >>> _ = d.point("tip", "arm", at=(1, 0)).point("hook", "ground", at=(1, 1))
            >>> d.rod("tie", "tip", "hook").mechanism().closures[0].type
            'distance'
        """
        return self._add("rods", name, "rod", {"between": [one, two]})

    def spring(self, name: str, one: str, two: str | None = None, **more: Any) -> Drawing:
        """Add a spring between two points, or about or along a joint.

        Args:
            name: its name.
            one: a point, or body; without another, a joint.
            two: a point of another body.
            **more: as in a mechanism file: `stiffness`, `damping`, `free_length`, `free_angle`,
                `law` (a list of points), `tension_only`, `compression_only`, `preload`.

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("door").body("leaf").hinge("pin", "ground", "leaf", at=(0, 0))
            >>> d.spring("closer", "pin", stiffness=5.0).mechanism().springs[0].stiffness
            5.0
        """
        ends: dict[str, Any] = {"joint": one} if two is None else {"frames": [one, two]}
        if "law" in more and not isinstance(more["law"], dict):
            more["law"] = {"points": more["law"]}
        return self._add("springs", name, "spring", {**ends, **more})

    def gear(
        self, name: str, one: str, two: str, *, teeth: Sequence[Number], internal: bool = False
    ) -> Drawing:
        """Let two gears mesh that turn on two hinges, on one body that carries both.

        The carrier may turn itself: a sun that turns on the ground meshes with a planet on a
        carrier that turns about the sun's axis. Hinges of bevel gears, whose axes meet, are placed
        at their gears. Where axes pass each other, as of a worm and its wheel, positive turns of
        one go with negative turns of the other: turn an axis round for teeth of the other hand.

        Args:
            name: its name.
            one: the hinge of the first gear.
            two: that of the second.
            teeth: (2,) numbers of teeth.
            internal: whether one of them is a ring, with its teeth inside.

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or a symbol is of another drawing.
            TypeError: a value is no number.
            ValueError: a number is NaN or infinite.

        Example:
            >>> d = sp.Drawing("pair").body("pinion").body("wheel").drive("A")
            >>> _ = d.hinge("A", "ground", "pinion", at=(0, 0))
            >>> _ = d.hinge("B", "ground", "wheel", at=(0.03, 0))
            >>> mech = d.gear("mesh", "A", "B", teeth=(20, 40)).mechanism()
            >>> sp.assemble(mech, {"A": 1.0}).coordinate("B").value  # [rad]
            -0.5
        """
        return self._add("gears", name, "gear", {
            "joints": [one, two], "teeth": list(teeth), "internal": bool(internal)})

    def drive(self, coordinate: str, name: str | None = None) -> Drawing:
        """Let a coordinate be a driver.

        Args:
            coordinate: a joint of one coordinate, or a coordinate such as "C.slide".
            name: of the driver; default that of the coordinate.

        Returns:
            The drawing.

        Raises:
            SpatialPinError: the name is taken, or is none.

        Example:
            >>> d = sp.Drawing("lever").body("arm").hinge("pin", "ground", "arm", at=(0, 0))
            >>> list(d.drive("pin", "motor").mechanism().drivers)
            ['motor']
        """
        return self._add("drivers", name or coordinate, "driver", {"joint": coordinate})

    # ------------------------------------------------------------ the mechanism

    def mechanism(self, keep: Iterable[str] = (), *, density: Number | None = None,
                  **dimensions: float) -> Mechanism:
        """Return the mechanism, closed as drawn, every coordinate zero there.

        The tree has the driven joints, those of gears and springs, and those to be kept. Of every
        loop one joint is cut that leaves few equations: a rod, a ball, a universal joint, a hinge;
        far from the ground. `Mechanism.notices` tells which.

        Args:
            keep: joints that must have coordinates.
            density: of bars, which then have masses [kg/m³].
            **dimensions: other values of dimensions: it is drawn anew [m, rad].

        Returns:
            The Mechanism; its `path` holds the text of a mechanism file that says the same, its
            `tree` that of the xacro file that was made of it.

        Raises:
            MechanismFileError: bodies, joints or points are named that are not there, or a body is
                not joined to the ground, or joints that must have coordinates close a loop; all
                mistakes together.
            ValueError: a dimension is NaN or infinite.

        Example:
            >>> d = sp.Drawing("lever").body("arm", mass=1.0, com=(0.5, 0))
            >>> d["x"] = 0.2
            >>> mech = d.hinge("pin", "ground", "arm", at=(d["x"], 0)).mechanism(x=0.3)
            >>> mech.dimensions, mech.path.name, mech.tree.name
            ({'x': 0.3}, 'lever.toml', 'lever.urdf.xacro')
        """
        names = [keep] if isinstance(keep, str) else list(keep)
        springs = [{"name": name, **x} for name, x in self._tables["springs"].items()]
        given = {**self._top, "density": self._top.get("density"), "keep": names,
                 "dimensions": self._dimensions, **self._tables, "springs": springs}
        if density is not None:
            given["density"] = self._given(density, "density")
        content = {key: x for key, x in given.items() if key == "bodies" or x not in (None, [], {})}
        others: dict[str, Any] = dict(dimensions)
        stem = re.sub(r"[^\w.+-]+", "_", self.name).strip("._") or "drawing"
        return load(HeldFile.of(f"{stem}.toml", toml_text(content)), **others)

    def __repr__(self) -> str:
        return (f"Drawing({self.name!r}: bodies {list(self._tables['bodies'])}, "
                f"joints {list(self._tables['joints'])}, dimensions {self._dimensions})")
