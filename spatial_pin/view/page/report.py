"""A motion, or a state, as a report: one self-contained page to send, to file and to print."""

from __future__ import annotations

import html
import platform
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import checked, plain_text
from spatial_pin._support.output_files import named_path, write_text
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion
from spatial_pin.synthesis.ranked_designs import Design, Designs
from spatial_pin.view.page.cards import PagePath
from spatial_pin.view.page.html import script_of
from spatial_pin.view.page.markup import filled, paragraph
from spatial_pin.view.page.plots import default_outputs
from spatial_pin.view.page.sections import SECTIONS, Subject
from spatial_pin.view.scene.film import not_shown
from spatial_pin.view.scene.look import Look, overlaid

COUNTED_AT = 0.29  # part of a motion after which its freedoms are counted: no round driver value


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
