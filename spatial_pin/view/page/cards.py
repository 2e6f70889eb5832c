"""Results in a notebook: a few lines and a small table, and pages in frames.

All names come from files of others: `markup` escapes them. An exported notebook, or one on another
machine, has no server to ask: it stores and exports whole pages.
"""

from __future__ import annotations

import html
import os
from collections.abc import Iterable, Sequence
from pathlib import PosixPath, WindowsPath
from typing import TYPE_CHECKING

import numpy as np

from spatial_pin.motion.summary import EFFORTS, heading, tidy, where
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.page.markup import filled, paragraph, table

if TYPE_CHECKING:
    from spatial_pin.accuracy.tradeoff import Tradeoff
    from spatial_pin.assembly.state import State
    from spatial_pin.dynamics.kinetostatics import Kinetostatics
    from spatial_pin.mechanism.mechanism import Mechanism
    from spatial_pin.mobility.mobility import Mobility
    from spatial_pin.motion.motion import Motion

SUFFIXES = (".html", ".htm", ".xhtml")
STYLE = "width: 100%; height: 600px; border: 1px solid #dfe3e8"
# JupyterLab takes frames out of notebooks of others until they are trusted, and leaves their
# content, which no browser shows in a frame.
HIDDEN = "Run this cell, or trust the notebook, to see the page that is stored here."
MOST_ROWS = 20  # of a table: more push the notebook's next cell off the screen


def _card(text: str, *parts: str) -> str:
    return f"<div>{paragraph(text)}{''.join(parts)}</div>"


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: int = 0) -> str:
    """Return a table of the first rows, with the number of the rest below; empty without rows."""
    every = list(rows)
    rest = len(every) - MOST_ROWS
    return (table(heads, every[:MOST_ROWS], numbers, as_cards=False) if every else "") + (
        paragraph(f"and {rest} more") if rest > 0 else "")


def mechanism(shown: Mechanism) -> str:
    """Return title, size, coordinates and closures of a mechanism."""
    driven = {shown.driven_coordinate(d).name: d for d in shown.drivers
              if shown.drivers[d].joint in shown.coordinate_table}
    coordinates = [(c.name, c.unit, driven.get(c.name, ""))
                   for c in shown.coordinate_table.values()]
    closures = [(c.name, c.type, ", ".join(c.frames or c.joints or ())) for c in shown.closures]
    title = f": {shown.title}" if shown.title else ""
    return _card(
        f"{shown.name}{title}. Joints: {shown.model.njoints - 1}, closures: {len(shown.closures)}, "
        f"characteristic length {shown.characteristic_length:.6g} m",
        _table(("coordinate", "unit", "driver"), coordinates),
        _table(("closure", "type", "between"), closures))


def state(shown: State) -> str:
    """Return all coordinates of a state, and how well its loops are closed."""
    units = {name: c.unit for name, c in shown.mechanism.coordinate_table.items()}
    per = "s" if shown.in_time else "driver"
    rows = []
    for name, unit in units.items():
        value, rate, acceleration = (f"{x:.6g}" for x in shown.coordinate(name))
        rows.append((name, unit, value, rate, acceleration))
    return _card(repr(shown), _table(
        ("coordinate", "unit", "value", f"rate [unit/{per}]", f"acceleration [unit/{per}²]"),
        rows, numbers=3))


def motion(shown: Motion) -> str:
    """Return how far, and how fast, every coordinate of a motion goes, and its first events."""
    rows = []
    for name, c in shown.mechanism.coordinate_table.items() if len(shown) else ():
        value, rate, _ = shown.coordinate(name)
        rows.append((name, c.unit, *_span(value), shown.rate_unit(c.unit), *_span(rate)))
    return _card(heading(shown), _table(
        ("coordinate", "unit", "least", "largest", "unit of rate", "least rate", "largest rate"),
        rows), _table(("event",), [(event.text,) for event in shown.events]))


def mobility(shown: Mobility) -> str:
    """Return the freedoms of a mechanism by formula, by rank, and as they are."""
    rows = [("by the formula, 6 equations a loop (Kutzbach)", shown.kutzbach),
            ("by the formula, order of each loop (Grübler)", shown.grubler),
            ("independent loops", shown.loops), ("rank of the closures", shown.rank),
            ("instantaneous freedoms", shown.instantaneous),
            ("finite freedoms", shown.dof), ("of these passive", len(shown.passive)),
            ("redundant equations", len(shown.redundant))]
    return _card(f"mobility of {shown.mechanism.name}: {shown.dof}",
                 _table(("quantity", "number"), [(name, str(n)) for name, n in rows], numbers=1))


def kinetostatics(shown: Kinetostatics) -> str:
    """Return the range of every effort, and the largest reactions of every pair."""
    moved = shown.motion
    coordinates, n = moved.mechanism, len(moved)
    every = np.array(list(shown.efforts.values()))
    efforts = [(name, EFFORTS[coordinates.coordinate(name).unit], *_span(x, every),
                where(moved, int(np.abs(x).argmax()))) for name, x in shown.efforts.items() if n]
    wrenches = {**shown.reactions, "on the fixed link": shown.on_ground} if n else {}
    rows = []
    for name, x in wrenches.items():
        sizes = np.linalg.norm(x.reshape(-1, 2, 3), axis=2).max(axis=0)
        rows.append((name, *(tidy(size, shown.on_ground) + mark
                             for size, mark in zip(sizes, shown.marks(name), strict=True))))
    statics = "" if moved.per == "s" else "; at rest, for the motion has no speed"
    return _card(f"{heading(moved)}{statics}", _table(
        ("effort", "unit", "least", "largest", "most"), efforts), _table(
        ("reaction", "largest force [N]", "largest moment [N·m]"), rows, numbers=2),
        *map(paragraph, shown.why_not_unique()))


def tradeoff(shown: Tradeoff) -> str:
    """Return the table of settings, the Pareto front marked with *."""
    from spatial_pin.accuracy.tradeoff_view import cells  # on use: not all that is shown is one

    heads, *rows = cells(shown)
    return _card(f"{shown.mechanism}: {shown.task}; reference: {shown.reference}",
                 _table([head.strip() for head in heads], rows, numbers=len(heads) - 1))


def _span(values: Array, among: Array | None = None) -> tuple[str, str]:
    """Return the least and the largest value, 0 for round-off of the largest among others."""
    every = values if among is None else among
    return tidy(values.min(), every), tidy(values.max(), every)


# ---------------------------------------------------------------- pages


def framed(page: str) -> str:
    """Return a frame that holds a page."""
    return f'<iframe srcdoc="{_quoted(page)}" style="{STYLE}">{HIDDEN}</iframe>'


def watched(url: str, still: str) -> str:
    """Return a frame of a served page, and of a still one where the server does not answer.

    That is another frame: the first one may still fail to load, and show an error.
    """
    name = f"spatial_pin_{html.escape(url.rpartition(':')[2].strip('/'))}"
    return filled("watched.html", {"URL": html.escape(url), "NAME": name, "STILL": _quoted(still),
                                   "STYLE": STYLE, "HIDDEN": HIDDEN}).rstrip()


def _quoted(page: str) -> str:
    """Return a page as the text of an attribute: two characters are escaped."""
    return page.replace("&", "&amp;").replace('"', "&quot;")


class PagePath(PosixPath if os.name == "posix" else WindowsPath):  # type: ignore[misc]
    """The path of a page that was written; as the last value of a cell it is the page."""

    def _repr_html_(self) -> str | None:
        """Return the page in a frame, for a notebook; None where there is none any more."""
        is_page = self.suffix.lower() in SUFFIXES and self.is_file()  # not so of its folder
        return framed(self.read_text(encoding="utf-8")) if is_page else None
