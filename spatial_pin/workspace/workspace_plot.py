"""A plot of a workspace in a plane."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import finite_number, positive_number
from spatial_pin._support.output_files import literal, save_figure
from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.sweep import check_choice
from spatial_pin.numerics.linalg import Array
from spatial_pin.workspace.workspace_result import Curve, Workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLANES = {"xy": 2, "xz": 1, "yz": 0}  # with the coordinate normal to it
THIN_SLICE = 0.05  # thickness of a cross-section relative to the spread of the points
BOUNDARY, SINGULAR = "#d55e00", "#cc2277"
INK = "#2b3138"


def plot(
    result: Workspace, path: str | Path | None = None, plane: str | None = None,
    at: float | None = None, thickness: float | None = None,
) -> Figure:
    """Draw points in a plane, coloured by dexterity; see `Workspace.plot`."""
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
    curves = _curves(result) if at is None else ()
    for borders, colour, label in ((result.boundary, BOUNDARY, "the branch ends"),
                                   (result.singular, SINGULAR, "the determinant vanishes")):
        places = borders.points[holds(borders.points)]
        lines = [c.points for c in curves if c.is_boundary == (borders is result.boundary)]
        for k, line in enumerate(lines):
            axes.plot(line[:, x], line[:, y], color=colour, lw=1.6, label="" if k else label)
        if len(places) and not lines:
            axes.scatter(places[:, x], places[:, y], s=7, color=colour, linewidths=0, label=label)
    axes.set(xlabel=f"{plane[0]} [m]", ylabel=f"{plane[1]} [m]", aspect="equal")
    axes.set_title(literal(f"{result.mechanism.name}: {result.frame}{where}"), color=INK)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=2, frameon=False)
    if path is not None:
        save_figure(figure, path)
    return figure


def _curves(result: Workspace) -> tuple[Curve, ...]:
    """Return the curves of a grid of two coordinates, if they can be followed."""
    if len(result.names) != 2:
        return ()
    with contextlib.suppress(SpatialPinError):  # along a component of a ball
        return result.curves()
    return ()
