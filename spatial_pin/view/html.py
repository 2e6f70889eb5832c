"""A film as one self-contained page: meshcat's viewer, the scene and the animation in one file."""

from __future__ import annotations

import base64
import html
import json
import re
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from spatial_pin.view.film import Film, film
from spatial_pin.view.framing import ASPECT, Framing

if TYPE_CHECKING:
    from spatial_pin.kinematics.motion import Motion
    from spatial_pin.kinematics.state import State


def _notes(shown: Film, framing: Framing) -> str:
    """Return the small print of the page."""
    error = f"closure error {'≤ ' if len(shown.q) > 1 else ''}{shown.closure_error:.1e}"
    cell = f"{framing.cell:g} m" if framing.cell >= 1 else f"{1e3 * framing.cell:g} mm"
    lines = (*shown.notes, error, f"ground grid {cell}")
    return "".join(f"<small>{html.escape(line)}</small>" for line in lines)


def _data(shown: Film, commands: list[bytes]) -> str:
    """Return what the page's script reads, as JSON that is safe inside a script element."""
    readings = [
        {**r._asdict(), "values": np.round(r.values, r.digits + 2).tolist()} for r in shown.readings
    ]
    data = {
        "commands": [base64.b64encode(c).decode() for c in commands],
        "seconds": np.round(shown.seconds, 6).tolist(),
        "readings": readings,
        "aspect": ASPECT,
    }
    return json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")


def page(motion_or_state: Motion | State, title: str | None = None) -> str:
    """Return the text of the page that shows a motion or state; see `export_html`."""
    from spatial_pin.view.scene import scene

    shown = film(motion_or_state)
    commands, framing = scene(shown)
    title = title or shown.mechanism.title or shown.mechanism.name
    parts = {
        "TITLE": html.escape(title),
        "NOTES": _notes(shown, framing),
        "MESHCAT": files("meshcat").joinpath("viewer/dist/main.min.js").read_text("utf-8"),
        "FILM": _data(shown, commands),
    }
    template = files("spatial_pin.view").joinpath("page.html").read_text("utf-8")
    return re.sub("@([A-Z]+)@", lambda found: parts[found[1]], template)


def export_html(
    motion_or_state: Motion | State, path: str | Path, *, title: str | None = None
) -> Path:
    """Write one self-contained page that shows a motion in the browser, or a state as a still.

    The page needs no network and no server. It plays for ever, with play, pause and a slider, and
    says the driver's value, the time, the largest closure error and the pace it is shown at.

    Args:
        motion_or_state: what to show.
        path: file to write.
        title: heading; the mechanism's title if not given.

    Returns:
        The path written.
    """
    path = Path(path)
    path.write_text(page(motion_or_state, title), encoding="utf-8")
    return path
