"""A film as one self-contained page: meshcat's viewer, the scene and the animation in one file."""

from __future__ import annotations

import base64
import html
import json
import zlib
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatial_pin._support.checks import checked, plain_text
from spatial_pin._support.output_files import named_path, write_text
from spatial_pin.motion.motion import Motion
from spatial_pin.view.page.markup import filled, template
from spatial_pin.view.page.plots import curves_of
from spatial_pin.view.scene.film import Film, Readout, film, length_words
from spatial_pin.view.scene.framing import ASPECT
from spatial_pin.view.scene.look import overlaid

if TYPE_CHECKING:
    from spatial_pin.assembly.state import State
    from spatial_pin.dynamics.kinetostatics import Kinetostatics
    from spatial_pin.synthesis.ranked_designs import Design, Designs
    from spatial_pin.view.scene.anatomy import Signal
    from spatial_pin.view.scene.look import Look
    from spatial_pin.view.scene.meshcat_commands import MeshcatScene

# Scripts of the page, in this order: each may use values of earlier ones, and functions of all.
SCRIPTS = (
    "software", "film", "play", "views", "triad", "parts", "theme", "smooth", "shadow",
    "point", "ruler", "section", "xray", "chase", "inspect", "curves", "zoom", "signals",
    "tools", "keys", "address", "start",
)


RAW_DEFLATE = -15  # RFC 1951 without a head, with the largest window


def packed(data: Sequence[bytes]) -> dict[str, Any]:
    """Return pieces of data as the page's `unpacked` takes them."""
    packer = zlib.compressobj(wbits=RAW_DEFLATE)
    text = base64.b64encode(packer.compress(b"".join(data)) + packer.flush()).decode()
    return {"sizes": [len(piece) for piece in data], "packed": text}


@cache
def packed_viewer() -> str:
    """Return meshcat's viewer, a third as long, as JSON."""
    viewer = files("meshcat").joinpath("viewer/dist/main.min.js").read_bytes()
    return json.dumps(packed([viewer]))


@cache
def packed_script(more: tuple[str, ...] = ()) -> str:
    """Return the scripts of a page, and more scripts after them, as JSON."""
    return json.dumps(packed([script_of((*SCRIPTS, *more)).encode()]))


def _rows(readings: tuple[Readout, ...]) -> list[dict[str, Any]]:
    return [{**r._asdict(), "values": np.round(r.values, r.digits + 2).tolist()} for r in readings]


def _data(
    shown: Film, drawn: MeshcatScene, curves: dict[str, Any] | None, signals: Sequence[Signal]
) -> str:
    """Return the data of the page's script, as JSON that is safe inside a script element."""
    from spatial_pin.view.scene.anatomy import anatomy
    from spatial_pin.view.scene.meshcat_commands import GRID, joint_paths
    from spatial_pin.view.scene.stage import upright

    framing, mechanism = drawn.framing, shown.mechanism
    data = {
        "commands": packed(drawn.commands),
        "extras": packed(drawn.extras),
        "parts": drawn.parts,
        "hidden": drawn.hidden,
        "shadow": drawn.shadow,
        "grid": GRID,
        "radius": framing.radius,
        "world": upright(mechanism.model).T.tolist(),
        "joints": joint_paths(mechanism.model),
        **anatomy(mechanism),
        "signals": {"told": [{**signal._asdict(), "values": None} for signal in signals],
                    "held": packed([np.asarray(signal.values, "<f4").tobytes()
                                    for signal in signals])},
        "extent": np.round(framing.scaled(drawn.extent), 4).tolist(),
        "curves": curves,
        "seconds": np.round(shown.seconds, 6).tolist(),
        "readings": _rows(shown.readings),
        "alarms": _rows(drawn.layer.alarms),
        "marks": shown.marks,
        "labels": [{"text": text, "at": framing.scaled(point).tolist()}
                   for text, point in drawn.layer.labels],
        "aspect": ASPECT,
    }
    return json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")


def parts_of(
    shown: Film, drawn: MeshcatScene, title: str | None, curves: dict[str, Any] | None,
    signals: Sequence[Signal] = (),
) -> dict[str, str]:
    """Return the texts for the marks of page.html, for a page that needs no server."""
    title = plain_text(title or shown.mechanism.title or shown.mechanism.name, "title")
    error = f"closure error {'≤ ' if len(shown.q) > 1 else ''}{shown.closure_error:.1e}"
    if isinstance(shown.source, Motion) and len(shown.source.error_estimates):
        error += f", error of positions ≤ {shown.source.error.positions:.1e}"
    notes = (*shown.notes, error, f"ground grid {length_words(drawn.framing.cell)}")
    legend = []
    for colour, text in drawn.layer.legend:
        rgb = ", ".join(str(round(255 * x)) for x in colour[:3])
        swatch = f'<i style="background: rgb({rgb})"></i>'
        legend.append(f"<small>{swatch}{html.escape(text)}</small>")
    return {
        "TITLE": html.escape(title),
        "NOTES": "".join(f"<small>{html.escape(line)}</small>" for line in notes),
        "LEGEND": "".join(legend),
        "MESHCAT": packed_viewer(),
        "STYLE": template("page.css"),
        "SCRIPT": packed_script(),
        "UNPACK": script_of(["unpack"]),
        "FILM": _data(shown, drawn, curves, signals),
        "CONNECT": "'none'",
        "EXTRA": "",
    }


def script_of(names: Sequence[str]) -> str:
    """Return scripts of the page as one."""
    return "\n".join(template(f"script/{name}.js") for name in names)


def page(
    motion_or_state: Motion | State | Design | Designs,
    title: str | None = None,
    look: Look | None = None,
    loads: Kinetostatics | None = None,
) -> str:
    """Return the text of the page that shows a motion or state; see `export_html`.

    `loads` are the forces of the motion, for the inspector of the page.
    """
    from spatial_pin.view.scene.anatomy import signals
    from spatial_pin.view.scene.meshcat_commands import scene

    motion_or_state, look = overlaid(motion_or_state, look)
    shown = film(motion_or_state)
    curves = curves_of(shown, *((look.curves, look.ghosts) if look else ((), ())))
    parts = parts_of(shown, scene(shown, look), title, curves, signals(shown, loads))
    return filled("page.html", parts)


@checked
def export_html(
    motion_or_state: Motion | State | Design | Designs,
    path: str | Path,
    *,
    title: str | None = None,
    look: Look | None = None,
) -> Path:
    """Write one self-contained page that shows a motion in the browser, or a state as a still.

    The page needs no network and no server. It plays for ever, faster, slower, to and fro or frame
    by frame, and says the driver's value, the time, the largest closure error and the pace it is
    shown at. It has views, a list of the shown objects, names under the pointer, distances between
    points, and curves of outputs. A closure that is open by more than 1e-6 is marked where and
    while it is. Limits and singular configurations are ticks on the slider. `#controls` at the end
    of the address opens meshcat's own.

    Args:
        motion_or_state: a motion or a state; of Designs the best one is shown, with its goals
            (`Look.design`).
        path: file to write.
        title: heading; the mechanism's title if not given.
        look: extras of the picture besides the bodies: signs of the pairs, paths, arrows, curves,
            ...

    Returns:
        The path written.

    Raises:
        UnknownNameError: `look` names a point or vector that does not exist.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 91), speed=1.0)
        >>> sp.export_html(motion, "page.html", look=sp.Look(traces=("coupler_b",))).name
        'page.html'
    """
    path = named_path(path)
    return write_text(path, page(motion_or_state, title, look))
