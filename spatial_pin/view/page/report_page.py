"""A motion, or a state, as a report: one self-contained page to send, to file and to print.

To add a section: a function from a `Subject` to HTML, or to None where it has nothing to say, and
its line in SECTIONS. All text that comes from a mechanism goes through `html.escape`.
"""

from __future__ import annotations

import contextlib
import html
import json
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from datetime import date
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import checked, plain_text
from spatial_pin._support.output_files import literal, named_path, write_text
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.force_outputs import with_force_values
from spatial_pin.dynamics.kinetostatics import Kinetostatics
from spatial_pin.dynamics.simulation.result import Simulation, growth_lines
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.coordinates import coordinates_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mobility.mobility import mobility
from spatial_pin.motion.dead_centres import known_dead_centres
from spatial_pin.motion.motion import Motion, Output
from spatial_pin.motion.report import info
from spatial_pin.motion.summary import EFFORTS
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.precision import FunctionGoal, PathGoal, PosesGoal
from spatial_pin.synthesis.ranked_designs import Design, Designs, Met
from spatial_pin.view.page.cards import PagePath
from spatial_pin.view.page.html import page, script_of
from spatial_pin.view.page.markup import filled, number, paragraph, section, table, template, tiny
from spatial_pin.view.page.plots import COLOURS, abscissa, default_outputs, plot, style, svg
from spatial_pin.view.scene.film import loads, not_shown
from spatial_pin.view.scene.look import Look, overlaid

FIGURE_WIDTH, PANEL, LOWEST = 7.5, 1.4, 2.4  # of a figure, of each panel of it; least height [in]
TARGET = "#141419"  # the colour of targets, in the picture too
FUNCTION_HEIGHT = 2.8  # of the figure of a function [in]
ALONG_AXIS = 0.999  # part of a direction along a world axis from which on it is called by that
LEAST_HEIGHT, MOST_HEIGHT = 2.4, 6.0  # height of the figure of a path [in]
COUNTED_AT = 0.29  # part of a motion after which its freedoms are counted: no round driver value


@dataclass(frozen=True, eq=False)
class Subject:
    """The subject of a report."""

    shown: Motion | State  # the motion or state
    motion: Motion | None  # the motion; None for a state
    state: State  # the state, or a sample of the motion that is no special position
    outputs: tuple[str, ...]  # names of the drawn outputs, as `Motion.output` takes them
    title: str  # heading
    look: Look | None  # extras of the picture; None for the usual

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism."""
        return self.shown.mechanism

    @cached_property
    def loads(self) -> Kinetostatics | None:
        """Efforts and reactions over the motion, if its drivers can bring it about."""
        massive = any(inertia.mass > 0.0 for inertia in self.mechanism.inertias.values())
        if self.motion is None or not massive:
            return None
        try:
            return loads(self.shown, self.motion)
        except SpatialPinError:
            return None


def _drawn(
    subject: Subject, title: str, outputs: Sequence[str | Output], note: str = ""
) -> str | None:
    """Return a section with a figure of outputs; None without any."""
    if subject.motion is None or not outputs:
        return None
    figure = plot(subject.motion, outputs, title="", columns=1)
    figure.set_size_inches(FIGURE_WIDTH, max(LOWEST, 0.5 + PANEL * len(outputs)))
    drawn = [x if isinstance(x, Output) else subject.motion.output(x) for x in outputs]
    names = ", ".join(x if isinstance(x, str) else x.label for x in outputs)
    drawing = svg(figure, f"{title} of {subject.mechanism.name}: {names}")
    vectors = any(output.values.ndim > 1 for output in drawn)
    caption = "<figcaption>x, y and z are world axes.</figcaption>" * vectors
    words = paragraph(note) if note else ""
    panels = []  # for the cursors of the page: parts of the figure, and the ends of the abscissa
    for axes in figure.axes:
        left, bottom, width, height = axes.get_position().bounds
        panels.append([*(round(x, 4) for x in (left, 1 - bottom - height, width, height)),
                       *(float(x) for x in axes.get_xlim())])
    data = json.dumps(panels)
    return section(title, f"{words}<figure data-panels='{data}'>{drawing}{caption}</figure>")


DERIVED = (  # titles of figures, and what they have of outputs that are coordinates, or positions
    ("Speed ratios", "ratio", ""), ("Velocities", "", "velocity"),
    ("Accelerations", "acceleration", "acceleration"))


def _derivatives(subject: Subject) -> str | None:
    """Draw speed ratios, velocities and accelerations of the outputs that have them."""
    motion, figures = subject.motion, list[str]()
    if motion is None:
        return None
    for title, of_coordinate, of_position in DERIVED:
        names = list[str]()
        for name in subject.outputs:
            stem = name.removesuffix(".position")
            derivative = f"{stem}.{of_coordinate if stem == name else of_position}"
            with contextlib.suppress(SpatialPinError):  # there is no such thing of this output
                motion.output(derivative)
                names.append(derivative)
        figures += filter(None, [_drawn(subject, title, names)])
    return "\n".join(figures)


def _key(subject: Subject) -> str:
    """Write the most important numbers."""
    mechanism, motion = subject.mechanism, subject.motion
    error = float(np.max(subject.shown.closure_error))
    facts = [("Characteristic length", number(mechanism.characteristic_length, "m"))]
    if motion is None:
        facts += [(name, number(subject.state.coordinate(name).value,
                                mechanism.coordinate(name).unit)) for name in mechanism.drivers]
    elif motion.driver is None and motion.time is not None:
        facts.append(("Duration", number(float(np.ptp(motion.time)), "s")))
    elif motion.driver is not None:
        unit = motion.driver_unit
        ends = f"{number(motion.driver[0], unit)} to {number(motion.driver[-1], unit)}"
        facts.append((f"Driver {motion.driver_name}", ends))
        if motion.per == "s":
            low, high = float(np.min(motion.driver_speed)), float(np.max(motion.driver_speed))
            speed = number(high, f"{unit}/s")
            facts.append(("Driver speed", speed if low == high else f"{number(low)} to {speed}"))
    if motion is not None:
        facts.append(("Positions computed", str(len(motion))))
    facts.append(("Largest closure error", tiny(error)))
    if motion is not None and len(motion.error_estimates):
        facts.append(("Error of positions at most", tiny(motion.error.positions)))
    cells = (f"<div><dt>{html.escape(a)}</dt><dd>{html.escape(b)}</dd></div>" for a, b in facts)
    return f'<dl class="key">{"".join(cells)}</dl>'


def _view(subject: Subject) -> str:
    """Show the mechanism in three dimensions."""
    text = page(subject.shown, subject.title, subject.look, subject.loads)
    # paper has no 3-D: the view is printed as a picture
    text = text.replace("</body>", template("freeze.html").rstrip())
    frame = f'<iframe title="3-D view" srcdoc="{html.escape(text)}"></iframe>'
    hint = "Drag to turn, scroll to come nearer, drag with the right button to move. "
    if subject.motion is not None:
        hint += "Drag in a curve below to move the mechanism."
    hint = f'<figcaption class="screen">{hint}</figcaption>'
    return f'<figure><div class="view">{frame}</div>{hint}</figure>'


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
    figure.set_size_inches(FIGURE_WIDTH, FUNCTION_HEIGHT)
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
    middle, (across, up) = every.mean(axis=0), _best_view(every)
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


def _best_view(points: Array) -> tuple[Array, Array]:
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


def _design(subject: Subject) -> str | None:
    """Write the goals of a design, and its errors."""
    if subject.look is None or subject.look.design is None:
        return None
    return section("Design", goals_page(subject.look.design, subject.motion))


def _outputs(subject: Subject) -> str | None:
    """Draw the outputs, forces among them."""
    motion = subject.motion
    if motion is None:
        return None
    return _drawn(subject, "Outputs", with_force_values(
        motion, subject.outputs, lambda: subject.loads or loads(subject.shown, motion)))


def _ranges(subject: Subject) -> str | None:
    """Write the range of every coordinate, and where its ends are."""
    motion = subject.motion
    if motion is None:
        return None
    rows = []
    x, where, unit = abscissa(motion)
    for name, c in subject.mechanism.coordinate_table.items():
        value, rate, acceleration = motion.coordinate(name)
        low, high = int(np.argmin(value)), int(np.argmax(value))
        moves = value[high] - value[low] > TOLERANCES.nothing
        at = [number(x[k], unit) if moves else "–" for k in (low, high)]
        rows.append((
            name,
            number(value[low], c.unit), at[0], number(value[high], c.unit), at[1],
            number(np.max(np.abs(rate)), motion.rate_unit(c.unit)),
            number(np.max(np.abs(acceleration)), motion.rate_unit(c.unit, 2)),
        ))
    here = f"at {where}"
    heads = ("coordinate", "least", here, "greatest", here, "largest rate", "largest acceleration")
    return section("Ranges", table(heads, rows, numbers=6))


def _coordinates(subject: Subject) -> str | None:
    """Write the coordinates of a state."""
    if subject.motion is not None:
        return None
    rows = []
    for name, c in subject.mechanism.coordinate_table.items():
        value, rate, acceleration = subject.state.coordinate(name)
        rows.append((name, number(value, c.unit, 10), number(rate, f"{c.unit}/s"),
                     number(acceleration, f"{c.unit}/s²")))
    heads = ("coordinate", "value", "rate", "acceleration")
    return section("Configuration", table(heads, rows, numbers=3))


def _events(subject: Subject) -> str | None:
    """Write limits, dead centres and singular positions of the motion."""
    motion = subject.motion
    if motion is None:
        return None
    title = "Special positions"
    events = [*motion.events, *known_dead_centres(motion)]
    if not events:
        return section(title, paragraph("No limit and no singular position was met."))
    unit = motion.driver_unit if motion.driver_name else "s"
    rows = [(e.kind, e.text, number(e.value, unit, 10))
            for e in sorted(events, key=lambda e: e.row)]
    heads = ("kind", "event", f"at {motion.driver_name or 'time'}")
    return section(title, table(heads, rows, numbers=1))


def _efforts(subject: Subject) -> str | None:
    """Draw the efforts of the drivers."""
    if subject.loads is None:
        return None
    curves = [Output(values, f"{name} effort", EFFORTS[subject.mechanism.coordinate(name).unit])
              for name, values in subject.loads.efforts.items()]
    note = ("What the drivers bring about this motion with, against links, gravity, springs and "
            "what resists at joints.")
    if subject.loads.motion.per != "s":
        note = ("What the drivers hold every position with, at rest, against gravity and springs: "
                "the motion has no speed.")
    return _drawn(subject, "Efforts", curves, note)


def _reactions(subject: Subject) -> str | None:
    """Write the largest reactions of all pairs, and the largest shaking wrench."""
    loads = subject.loads
    if loads is None:
        return None
    wrenches = {**loads.reactions, "fixed link, all together": loads.on_ground}
    rows = []
    for name, wrench in wrenches.items():
        force, moment = np.linalg.norm(wrench.reshape(-1, 2, 3), axis=2).max(axis=0)
        marks = loads.marks(name)
        rows.append((name, number(force, "N") + marks[0], number(moment, "N·m") + marks[1]))
    note = "".join(map(paragraph, loads.why_not_unique()))
    return section("Reactions", table(("pair", "largest force", "largest moment"), rows, 2) + note)


def _mobility(subject: Subject) -> str:
    """Write the freedoms, by formula, by rank and by finite motion."""
    try:
        text = str(mobility(subject.mechanism, subject.state))
    except SpatialPinError as error:
        text = str(error)
    where = ", ".join(
        f"{name} = {number(subject.state.coordinate(name).value, c.unit)}"
        for name in subject.mechanism.drivers for c in [subject.mechanism.coordinate(name)]
    )
    note = paragraph(f"Counted at {where}.") if where else ""
    return section("Mobility", f"{note}<pre>{html.escape(text)}</pre>")


def _dimensions(subject: Subject) -> str | None:
    """Write the named dimensions."""
    dimensions = subject.mechanism.dimensions
    if not dimensions:
        return None
    rows = [(name, number(x, "", 10)) for name, x in dimensions.items()]
    half = -(-len(rows) // 2)
    heads = ("dimension", "value [m or rad]")
    tables = "".join(f"<div>{table(heads, part, numbers=1)}</div>"
                     for part in (rows[:half], rows[half:]) if part)
    return section("Dimensions", f'<div class="columns">{tables}</div>')


def _structure(subject: Subject) -> str:
    """Write joints, closures and drivers."""
    mechanism = subject.mechanism
    facts = info(mechanism)
    joints = [(joint, pair, ", ".join(f"{c.name} [{c.unit}]"
                                      for c in coordinates_of(mechanism, joint)))
              for joint, pair in facts.joints.items()]
    parts = [f"<h3>Joints of the open tree</h3>{table(('joint', 'pair', 'coordinates'), joints)}"]
    for title, items in (("Closures of the loops", facts.closures), ("Drivers", facts.drivers),
                         ("Frames", facts.frames)):
        if items:
            rows = list(items.items())
            parts.append(f"<h3>{title}</h3>{table(('name', 'what it does'), rows)}")
    links = paragraph(f"{len(facts.links)} links: {', '.join(facts.links)}.")
    return section("Structure", links + "".join(parts))


def _accuracy(subject: Subject) -> str:
    """Write the closure error, relative and in lengths."""
    error = np.atleast_1d(subject.shown.closure_error)
    worst, size = float(np.max(error)), subject.mechanism.characteristic_length
    where = ""
    if subject.motion is not None and len(error) > 1:
        x, name, unit = abscissa(subject.motion)
        at = f"{name} = {number(x[int(np.argmax(error))], unit)}"
        where = f" in any of {len(error)} positions (the largest at {at})"
    if not subject.mechanism.closures:
        return section("Accuracy", paragraph("The mechanism has no loops that could stay open."))
    text = (
        f"No loop is open by more than {tiny(worst)}{where}: by {tiny(worst * size)} m in lengths, "
        f"which are measured by the characteristic length of {number(size, 'm')}, and by "
        f"{tiny(worst)} rad in angles. Rates and accelerations are solved from the exact "
        "derivatives of the closure equations; no difference quotients are taken."
    )
    if subject.motion is not None and len(subject.motion.error_estimates):
        text += f" The motion itself is known to this error: {subject.motion.error}."
    if isinstance(subject.shown, Simulation):
        text += "".join(f" It is {line.strip()}." for line in growth_lines(subject.shown))
        text += (f" Energy and work balance to {tiny(subject.shown.energy_drift)} of the "
                 f"exchanged energy, over {subject.shown.steps} steps of the integrator.")
    settings = getattr(subject.shown, "accuracy", None)
    words = "" if settings is None else paragraph("Settings: " + ", ".join(
        f"{f.name} {getattr(settings, f.name)}" for f in fields(settings)))
    return section("Accuracy", paragraph(text) + words)


SECTIONS: tuple[Callable[[Subject], str | None], ...] = (
    _key,
    _view,
    _design,
    _outputs,
    _derivatives,
    _ranges,
    _coordinates,
    _events,
    _efforts,
    _reactions,
    _mobility,
    _dimensions,
    _structure,
    _accuracy,
)


@checked
def report(
    motion_or_state: Motion | State | Design | Designs,
    path: str | Path,
    *,
    outputs: Sequence[str] | str | None = None,
    title: str | None = None,
    look: Look | None = None,
) -> Path:
    """Write a report of a motion, or of a state: one page that needs no network and prints well.

    It holds the 3-D view, the outputs over the driver with their speed ratios and accelerations,
    the ranges of all coordinates, limits met, freedoms, dimensions, structure and accuracy. The
    report of a state has its coordinates instead of curves. The report of a design has its goals
    and their errors.

    Args:
        motion_or_state: a motion or a state; a design as in `export_html`.
        path: file to write.
        outputs: names of outputs to draw, as `motion.output` takes them, or forces as the `output`
            of what `kinetostatics` finds; those of `default_outputs` if not given. Not used for a
            state.
        title: heading; the mechanism's title if not given.
        look: extras of the picture, as in `export_html`.

    Returns:
        The path written; in a notebook it shows the page.

    Raises:
        UnknownNameError: an output names nothing of the motion.
        ValueError: the motion has no samples.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 91), speed=1.0)
        >>> sp.report(motion, "report.html", outputs=["rocker_pin", "rocker_pin.rate"]).name
        'report.html'
    """
    import spatial_pin

    path = named_path(path)
    shown, look = overlaid(motion_or_state, look)
    if not isinstance(shown, State | Motion):
        raise SpatialPinError(not_shown(shown))
    mechanism = shown.mechanism
    title = plain_text(title or mechanism.title or mechanism.name, "title")
    if isinstance(shown, State):
        subject = Subject(shown, None, shown, (), title, look)
    elif len(shown) == 0:
        raise ValueError("the motion has no samples: there is nothing to report")
    else:
        outputs = default_outputs(shown) if outputs is None else outputs
        names = (outputs,) if isinstance(outputs, str) else tuple(outputs)
        state = shown.state(int(COUNTED_AT * len(shown)))
        subject = Subject(shown, shown, state, names, title, look)
    today = f"{date.today():%d %B %Y}".replace(" ", "\u00a0")
    words = [f"Mechanism {mechanism.name}", mechanism.source, today]
    versions = {"spatial_pin": spatial_pin.__version__, "Pinocchio": pin.__version__,
                "NumPy": np.__version__, "Python": platform.python_version()}
    made = ", ".join(f"{name} {version}" for name, version in versions.items())
    written = (write(subject) for write in SECTIONS)
    parts = {
        "TITLE": html.escape(subject.title),
        "HEAD": paragraph(" · ".join(word for word in words if word)),
        "SECTIONS": "\n".join(part for part in written if part),
        "FOOT": html.escape(f"Computed with {made}. Units are SI; angles are given in degrees, "
                            "their rates in radians."),
        "SCRIPT": script_of(["report", "narrow"]),
    }
    return PagePath(write_text(path, filled("report.html", parts)))
