"""The result of `workspace`: points of a grid, their dexterity, and the boundary."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import brief
from spatial_pin._support.checks import checked, finite_number, positive_number
from spatial_pin._support.columns import Quantity, Tabular, chosen, quantities_of
from spatial_pin._support.output_files import literal, save_figure
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.sweep import check_choice
from spatial_pin.numerics.linalg import Array
from spatial_pin.workspace.dexterity import SINGULAR
from spatial_pin.workspace.grid_axes import PARTS, SLIDES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLANES = {"xy": 2, "xz": 1, "yz": 0}  # of a figure, with the coordinate normal to it
THIN_SLICE = 0.05  # thickness of a cross-section relative to the spread of the points
BOUNDARY_COLOUR, SINGULAR_COLOUR = "#d55e00", "#cc2277"
INK = "#2b3138"


def unit_of(mechanism: Mechanism, name: str) -> str:
    """Return the unit of a coordinate of a grid: a driver, or a part of a pose."""
    if name in PARTS and name not in {*mechanism.coordinate_table, *mechanism.drivers}:
        return "m" if name in SLIDES else "rad"
    return mechanism.prescribed_coordinate(name).unit


@dataclass(frozen=True, eq=False)
class Curve:
    """A polyline at the end of the branch, or along zeros of a determinant.

    Attributes:
        drivers: (m, k) values of the grid's coordinates at its points [rad or m].
        points: (m, 3) of the frame [m].
        why: (m - 1,) the reason of each piece, as in `Borders.why`.
        is_closed: whether its last point is its first; coordinates may differ by whole turns.
        tolerance: largest distance between curve and polyline [rad, characteristic lengths]; its
            points are on the curve to 1e-10.

    Example:
        >>> mech = sp.load("delta")
        >>> ranges = {"x": (-1.4, 0.0), "y": (-0.2, 0.2)}  # [m]
        >>> points = sp.workspace(mech, "platform", ranges, points=5)
        >>> curve = points.curves(tolerance=0.01)[0]
        >>> curve.why[0], curve.is_closed, curve.is_boundary
        ('limit', False, True)
    """

    drivers: Array
    points: Array
    why: tuple[str, ...]
    is_closed: bool
    tolerance: float

    def __len__(self) -> int:
        return len(self.points)

    @property
    def is_boundary(self) -> bool:
        """Whether the branch ends on it."""
        return SINGULAR not in self.why

    def __repr__(self) -> str:
        return brief(self, points="m")


@dataclass(frozen=True, eq=False)
class Borders:
    """Points on the lines of a grid where the branch ends, or a determinant vanishes.

    Attributes:
        drivers: (m, k) values of the grid's coordinates [rad or m].
        points: (m, 3) of the frame [m]; NaN where the branch could not be followed up to there.
        why: the reason at each point, in words.

    Example:
        >>> mech = sp.load("delta")
        >>> ranges = {"x": (-1.4, 0.0), "y": (-0.2, 0.2)}  # [m]
        >>> places = sp.workspace(mech, "platform", ranges, points=5)
        >>> places.boundary.points.shape, set(places.boundary.why)  # (m, 3) [m]
        ((5, 3), {'limit'})
    """

    drivers: Array
    points: Array
    why: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.why)

    def __repr__(self) -> str:
        return brief(self, points="m")


@dataclass(frozen=True, eq=False)
class Workspace(Tabular):
    """The points that a frame reaches over a grid of drivers or of its own poses, on one branch.

    The N points of the grid are in rows, the last coordinate fastest.

    Attributes:
        mechanism: the mechanism.
        frame: whose points these are.
        names: the k coordinates that span the grid: drivers, or parts of the frame's pose.
        shape: how many values each has.
        drivers: (N, k) their values [rad or m].
        reached: (N,) whether the branch reaches the point.
        points: (N, 3) of the frame in the world [m]; NaN where it is not reached.
        rotations: (N, 3, 3) of the frame, likewise.
        dexterity: (N,) least singular value of the closed-loop Jacobian in natural units (radians,
            characteristic lengths) relative to the largest: 1 all directions alike, 0 singular;
            NaN where it is not reached.
        least: (N,) that least singular value [-].
        why: why a point is not reached: "limit", "branch point", "singular", "lost" (the numbers
            gave out), "joint limit: " and which, "nearer than ...: " and which links, "no way
            along the grid", "not looked at"; empty where it is.
        boundary: where the branch ends on lines of the grid.
        singular: where a determinant vanishes on lines of the grid: of the frame's motions by the
            drivers', or, where the grid is one of poses, of the drivers' by the frame's.
        aspects: (N,) numbers from 0 of the parts of the grid that are connected without a singular
            point in between; -1 where it is not reached. A position of the frame in two aspects is
            reached in two working modes.
        sheets: the same grid on other branches (other assembly modes), with `sheets=True`.
        task: "position" or "pose": the rows of the Jacobian.
        directions: number of directions in which the frame moves.
        n_drivers: by how many drivers; a determinant there is only if these are as many.
        is_whole: whether the search is complete (no Ctrl-C).

    Example:
        >>> mech = sp.load("delta")
        >>> ranges = {"x": (-1.4, 0.0), "y": (-0.2, 0.2)}  # [m]
        >>> places = sp.workspace(mech, "platform", ranges, points=5)
        >>> places.points.shape, places.reached.shape, places.dexterity.shape  # N = 25 points
        ((25, 3), (25,), (25,))
        >>> print(f"{np.nanmin(places.condition):.3f}")  # 1: alike in all directions
        2.338
    """

    mechanism: Mechanism
    frame: str
    names: tuple[str, ...]
    shape: tuple[int, ...]
    drivers: Array
    reached: NDArray[np.bool_]
    points: Array
    rotations: Array
    dexterity: Array
    least: Array
    why: tuple[str, ...]
    boundary: Borders
    singular: Borders
    aspects: NDArray[np.intp]
    sheets: tuple[Workspace, ...]
    task: str
    directions: int
    n_drivers: int
    is_whole: bool
    _rows: Mapping[str, Array]
    _source: Any

    @property
    def condition(self) -> Array:
        """The condition numbers (N,) of the Jacobian: 1/dexterity."""
        with np.errstate(divide="ignore"):
            return 1.0 / self.dexterity

    def state(self, row: int) -> State:
        """Return the configuration at a point of the grid.

        Args:
            row: number of the point, from 0.

        Returns:
            The State.

        Raises:
            SpatialPinError: it is not reached, or there is no such point.

        Example:
            >>> mech = sp.load("delta")
            >>> ranges = {"x": (-0.2, 0.2), "y": (-0.2, 0.2)}  # [m]
            >>> places = sp.workspace(mech, "platform", ranges, points=3)
            >>> places.state(4).placement("platform").translation.round(3)  # the middle one [m]
            array([ 0.   ,  0.   , -1.064])
        """
        if not -len(self.reached) <= row < len(self.reached):
            raise SpatialPinError(f"there is no point {row}: the grid has {len(self.reached)}")
        if not self.reached[row]:
            raise SpatialPinError(f"point {row} of the grid is not reached: {self.why[row]}")
        return State(self.mechanism, self._rows["q"][row], angles=self._rows["angles"][row],
                     closure_error=float(self._rows["errors"][row]))

    def quantities(self, outputs: str | Iterable[str] | None = None) -> dict[str, Quantity]:
        """Return quantities by name, a row for every point of the grid.

        Rows of `sheets` follow those of this one, where there are any; a column tells which.

        Args:
            outputs: names without units; default all.

        Raises:
            UnknownNameError: there is none of a name.

        Example:
            >>> mech = sp.load("crane")
            >>> ranges = {"slew": (0.0, 1.0), "luff": (0.2, 1.0)}  # [rad]
            >>> places = sp.workspace(mech, "tip", ranges, points=3)
            >>> [(name, x.unit) for name, x in places.quantities().items()][:3]
            [('slew', 'rad'), ('luff', 'rad'), ('tip.x', 'm')]
        """
        tables = [x._own_columns() for x in (self, *self.sheets)]
        table = {name: np.concatenate([t[name] for t in tables]) for name in tables[0]}
        if self.sheets:
            n = len(self.reached)
            table = {"sheet": np.repeat(np.arange(len(tables)), n), **table}
        return chosen(quantities_of(table), outputs, f"workspace of {self.frame}")

    def _own_columns(self) -> dict[str, Any]:
        """Return columns of this sheet by their headings."""
        units = [unit_of(self.mechanism, name) for name in self.names]
        turns = np.array([pin.log3(r) if known else np.full(3, np.nan)
                          for r, known in zip(self.rotations, self.reached, strict=True)])
        table: dict[str, Any] = {f"{name} [{unit}]": x for name, unit, x in zip(
            self.names, units, self.drivers.T, strict=True)}
        table |= {f"{self.frame}.{x} [m]": p for x, p in zip("xyz", self.points.T, strict=True)}
        table |= {f"{self.frame}.r{x} [rad]": r for x, r in zip("xyz", turns.T, strict=True)}
        for driver in self.mechanism.drivers.values():
            c = self.mechanism.driven_coordinate(driver.name)
            if driver.name not in self.names and c.name not in self.names and c.q >= 0:
                table[f"{driver.name} [{c.unit}]"] = self._rows["q"][:, c.q]
        return table | {"reached": self.reached.astype(int), "aspect": self.aspects,
                        "dexterity [-]": self.dexterity,
                        "least singular value [-]": self.least, "why": np.array(self.why)}

    @checked
    def curves(
        self, at: Mapping[str, float] | None = None, *, tolerance: float = 1e-3
    ) -> tuple[Curve, ...]:
        """Return the curves in a section of the grid: its boundary, and where it is singular.

        They begin at `boundary` and `singular` of the section and are followed from there. Pieces
        of the boundary are joined where they meet: a limit position and a joint limit, say. They
        end where they leave the ranges. Places where branches cross, or where links come too near
        to each other, are on no curve: they stay points of `boundary`.

        Args:
            at: values of all coordinates of the grid but two, each one of the grid's; none where
                the grid has only two.
            tolerance: how far a curve may bend away from its straight pieces [rad, characteristic
                lengths].

        Returns:
            The Curves; `is_boundary` tells those of the boundary.

        Raises:
            SpatialPinError: the branch does not change along a coordinate that can be followed.
            ValueError: `at` leaves other than two coordinates, or has a value that the grid has
                not; the tolerance is not above zero.

        Example:
            >>> mech = sp.load("delta")
            >>> ranges = {"x": (-1.4, 0.0), "y": (-0.2, 0.2)}  # [m]
            >>> places = sp.workspace(mech, "platform", ranges, points=5)
            >>> curve = places.curves(tolerance=0.01)[0]
            >>> curve.is_boundary, curve.points.shape[1]  # (m, 3) [m]
            (True, 3)
        """
        from spatial_pin.workspace.section_curves import curves

        return curves(self, at, tolerance)

    @checked
    def plot(
        self, path: str | Path | None = None, *, plane: str | None = None,
        at: float | None = None, thickness: float | None = None,
    ) -> Figure:
        """Draw points in a plane, coloured by dexterity, with boundary and singular curves.

        Of a grid of two coordinates the curves are drawn, else places on lines of the grid.

        Args:
            path: where to save it; None: not.
            plane: "xy", "xz" or "yz" of the world; default the one in which points are spread
                most.
            at: draw a cross-section: the third coordinate [m]; None: all points.
            thickness: of the cross-section [m]; default a twentieth of how far points are spread.

        Returns:
            A matplotlib figure.

        Raises:
            ValueError: there is no such plane, or the thickness is not above zero.

        Example:
            >>> mech = sp.load("crane")
            >>> ranges = {"slew": (0.0, 1.0), "luff": (0.2, 1.0)}  # [rad]
            >>> places = sp.workspace(mech, "tip", ranges, points=3)
            >>> figure = places.plot("crane.svg", plane="xz")
            >>> figure.axes[0].get_xlabel()
            'x [m]'
        """
        return _drawn(self, path, plane, at, thickness)

    def __repr__(self) -> str:
        return (f"Workspace({self.mechanism.name!r}: {self.frame} over "
                f"{' x '.join(map(str, self.shape))} values of {', '.join(self.names)}, "
                f"{int(self.reached.sum())} of {len(self.reached)} points reached"
                f"{'' if self.is_whole else '; cut short'})")

    def __str__(self) -> str:
        n, total = int(self.reached.sum()), len(self.reached)
        lines = [f"{self.mechanism.name}: {self.frame} over {' x '.join(map(str, self.shape))} "
                 f"values of {', '.join(self.names)}: {n} of {total} points reached"
                 f"{'' if self.is_whole else ', cut short'}"]
        for why, count in Counter(filter(None, self.why)).most_common():
            lines.append(f"  not reached: {count} ({why})")
        low, high = (f(self.points[self.reached], axis=0) for f in (np.min, np.max))
        lines += [f"  {x} from {a:.6g} to {b:.6g} m"
                  for x, a, b in zip("xyz", low, high, strict=True)]
        if not np.isnan(self.dexterity).all():
            best, worst = int(np.nanargmax(self.dexterity)), int(np.nanargmin(self.dexterity))
            lines.append(f"  dexterity ({self.task}, {self.directions} directions by "
                         f"{self.n_drivers} drivers): {self.dexterity[worst]:.3g} at "
                         f"{self._named(worst)} to {self.dexterity[best]:.3g} at "
                         f"{self._named(best)}")
        ends = ", ".join(f"{count} {why}" for why, count in Counter(self.boundary.why).items())
        lines.append(f"  boundary on lines of the grid: {ends or 'none'}")
        count = int(self.aspects.max(initial=-1)) + 1
        if count > 1:
            sizes = ", ".join(str(int((self.aspects == k).sum())) for k in range(count))
            lines.append(f"  {count} parts that singular places part (aspects), of {sizes} points")
        if self.sheets:
            sizes = ", ".join(str(int(x.reached.sum())) for x in self.sheets)
            lines.append(f"  {len(self.sheets)} other sheets, of {sizes} points")
        lines.append(f"  the determinant vanishes at {len(self.singular)} places on them"
                     if self.directions == self.n_drivers else "  it has no determinant: "
                     "singular places between points of the grid are not looked for")
        return "\n".join(lines)

    def _named(self, row: int) -> str:
        return ", ".join(f"{name} = {x:.6g}" for name, x in zip(
            self.names, self.drivers[row].tolist(), strict=True))


def _drawn(
    result: Workspace, path: str | Path | None, plane: str | None, at: float | None,
    thickness: float | None,
) -> Figure:
    """Return the figure of `Workspace.plot`."""
    from spatial_pin._support.figures import ShownFigure

    points = result.points[result.reached]
    if plane is None:
        normal = int(np.argmin(np.ptp(points, axis=0)))
        plane = next(name for name, k in PLANES.items() if k == normal)
    check_choice("plane", plane, tuple(PLANES))
    half = 0.5 * (THIN_SLICE * float(np.ptp(points, axis=0).max()) if thickness is None
                  else positive_number(thickness, "thickness"))
    normal, offset = PLANES[plane], None if at is None else finite_number(at, "at")
    where = "" if offset is None else f", {'xyz'[normal]} = {offset:.4g} ± {half:.2g} m"

    def holds(points: Array) -> NDArray[np.bool_]:
        known = np.asarray(~np.isnan(points).any(axis=1))
        return known if offset is None else known & (np.abs(points[:, normal] - offset) <= half)

    figure = ShownFigure(figsize=(7.0, 5.8))
    figure.set_layout_engine("compressed")  # axes of equal units leave no margin beside them
    axes = figure.subplots()
    x, y = ("xyz".index(c) for c in plane)
    seen = holds(points)
    n = int(np.count_nonzero(seen))
    dots = axes.scatter(points[seen, x], points[seen, y], c=result.dexterity[result.reached][seen],
                        s=float(np.clip(4e4 / max(n, 1), 3.0, 40.0)), linewidths=0, cmap="viridis")
    figure.colorbar(dots, label=f"dexterity ({result.task}) [-]")
    curves: tuple[Curve, ...] = ()
    if at is None and len(result.names) == 2:
        with contextlib.suppress(SpatialPinError):  # they cannot be followed along part of a ball
            curves = result.curves()
    for borders, colour, label in ((result.boundary, BOUNDARY_COLOUR, "the branch ends"),
                                   (result.singular, SINGULAR_COLOUR, "the determinant vanishes")):
        held = borders.points[holds(borders.points)]
        lines = [c.points for c in curves if c.is_boundary == (borders is result.boundary)]
        for k, line in enumerate(lines):
            axes.plot(line[:, x], line[:, y], color=colour, lw=1.6, label="" if k else label)
        if len(held) and not lines:
            axes.scatter(held[:, x], held[:, y], s=7, color=colour, linewidths=0, label=label)
    axes.set(xlabel=f"{plane[0]} [m]", ylabel=f"{plane[1]} [m]", aspect="equal")
    axes.set_title(literal(f"{result.mechanism.name}: {result.frame}{where}"), color=INK)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=2, frameon=False)
    if path is not None:
        save_figure(figure, path)
    return figure
