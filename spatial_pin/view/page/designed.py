"""The part of a report about a design: dimensions, errors of goals, defects, curves."""

from __future__ import annotations

import numpy as np

from spatial_pin._support.output_files import literal
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.goals import FunctionGoal, PathGoal, PosesGoal
from spatial_pin.synthesis.ranked_designs import Design, Met
from spatial_pin.view.page.markup import number, paragraph, table, tiny
from spatial_pin.view.page.plots import COLOURS, abscissa, plot, style, svg

TARGET = "#141419"  # the colour of targets, in the picture too
FIGURE_WIDTH, FIGURE_HEIGHT = 7.5, 2.8  # of a figure [in]
ALONG_AXIS = 0.999  # part of a direction along a world axis from which on it is called by that
LEAST_HEIGHT, MOST_HEIGHT = 2.4, 6.0  # height of the figure of a path [in]


def goals_page(design: Design, motion: Motion | None) -> str:
    """Return dimensions, errors and defects as tables, and functions as curves."""
    on = design.at_bounds
    dimensions = [(name, f"its {on[name]}" if name in on else "", number(x), number(low),
                   number(high)) for (name, x), (low, high) in zip(
                       design.dimensions.items(), design.bounds.values(), strict=True)]
    errors = [(name, str(e.samples), *(f"{tiny(x)} {e.unit}".strip() for x in (e.rms, e.most)))
              for name, e in design.errors.items()]
    heads = ("dimension", "on a bound", "value [m, rad]", "least", "most")
    parts = [table(heads, dimensions, numbers=3), table(
        ("goal", "samples", "root mean square", "largest error"), errors, numbers=3)]
    parts += [paragraph(f"{x.kind.capitalize()}: {x.text}.") for x in design.defects]
    if not design.defects:
        parts.append(paragraph("Circuit, branch, order and transmission are as they should be."))
    if motion is not None:
        parts += [_curve(met, motion) for met in design.met
                  if isinstance(met.goal, FunctionGoal) and met.driver == motion.driver_name]
        parts += [_path(met, motion) for met in design.met
                  if isinstance(met.goal, PathGoal | PosesGoal)]
    return "".join(parts)


def _curve(met: Met, motion: Motion) -> str:
    """Return the curve of an output with its target values."""
    assert isinstance(met.goal, FunctionGoal) and met.driver is not None
    output = met.goal.output
    figure = plot(motion, output, title="")
    figure.set_size_inches(FIGURE_WIDTH, FIGURE_HEIGHT)
    _, over, unit = abscissa(motion)
    if over == motion.driver_name:
        values = np.array([state.coordinate(met.driver).value for state in met.states])
        axes, targets = figure.axes[0], met.targets
        if unit == "°":
            values = _about(np.rad2deg(values), np.rad2deg(motion.swept))
        if motion.mechanism.prescribed_coordinate(output).unit == "rad":
            line = np.asarray(axes.lines[0].get_ydata(), dtype=float)
            targets = _about(np.rad2deg(targets), line)
        points = axes.plot(values, targets, "o", color=TARGET, markersize=5,
                          label=literal(f"targets of {output}"))
        axes.legend(handles=points, loc="lower right", bbox_to_anchor=(1.0, 0.99), fontsize=9,
                    frameon=False)
    drawing = svg(figure, f"{output} of {motion.mechanism.name}, with its targets")
    return f"<figure>{drawing}</figure>"


def _path(met: Met, motion: Motion) -> str:
    """Return the path of a frame with its target points, as seen across it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    assert isinstance(met.goal, PathGoal | PosesGoal)
    frame = met.goal.frame
    points = met.targets if isinstance(met.goal, PathGoal) else met.targets[:, :3, 3]
    there = np.array([state.placement(frame).translation for state in met.states])
    path = motion.frame(frame).position
    every = np.concatenate([path, points])
    middle, (across, up) = every.mean(axis=0), _view(every)
    x, y = (every - middle) @ across, (every - middle) @ up
    height = float(np.clip(FIGURE_WIDTH * np.ptp(y) / max(float(np.ptp(x)), 1e-12),
                           LEAST_HEIGHT, MOST_HEIGHT))
    figure = Figure(figsize=(FIGURE_WIDTH, height + 0.6), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.plot(x[: len(path)], y[: len(path)], color=COLOURS[0], label=literal(f"path of {frame}"))
    for target, point in zip(points, there, strict=True):
        ends = np.array([target, point]) - middle
        axes.plot(ends @ across, ends @ up, color=COLOURS[1], linewidth=1.0)
    axes.plot(x[len(path):], y[len(path):], "o", color=TARGET, markersize=5, label="targets")
    axes.set_xlabel(_direction(across))
    axes.set_ylabel(_direction(up))
    style(axes)
    axes.margins(0.05)
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=2, fontsize=9, frameon=False)
    drawing = svg(figure, f"path of {frame} of {motion.mechanism.name}, with its targets")
    return (f"<figure>{drawing}<figcaption>Lengths are in metres, from the middle of the path."
            "</figcaption></figure>")


def _view(points: Array) -> tuple[Array, Array]:
    """Return the directions to the right and up (3,) in which points (N, 3) are seen best.

    World axes are taken where the points lie across one of them.
    """
    away = points - points.mean(axis=0)
    spread = np.linalg.eigh(away.T @ away)[1].T[::-1]
    normal = spread[2]
    k = int(np.argmax(np.abs(normal)))
    if abs(normal[k]) > ALONG_AXIS:
        i, j = ((1, 2), (0, 2), (0, 1))[k]
        return np.eye(3)[i], np.eye(3)[j]
    across, up = (v * np.sign(v[np.argmax(np.abs(v))]) for v in spread[:2])
    return across, up


def _direction(axis: Array) -> str:
    """Return the name of a direction of the world."""
    k = int(np.argmax(np.abs(axis)))
    if abs(axis[k]) > ALONG_AXIS:
        return f"{'xyz'[k]} [m]"
    return "along ({:.2f}, {:.2f}, {:.2f}) [m]".format(*axis)


def _about(degrees: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """Return angles (k,) by whole turns nearest to the range of a curve's."""
    middle = 0.5 * (curve.min() + curve.max())
    return degrees - 360.0 * np.round((degrees - middle) / 360.0)
