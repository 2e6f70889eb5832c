"""Pieces of a page to read: numbers, tables, sections. All text that comes in is escaped."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files

from spatial_pin.numerics.tolerances import TOLERANCES


def template(name: str) -> str:
    """Return the text of a file beside this module."""
    return files("spatial_pin.view.page").joinpath(name).read_text("utf-8")


def filled(name: str, parts: Mapping[str, str]) -> str:
    """Return a template in which parts replace their marks, such as @TITLE@."""
    return re.sub("@([A-Z]+)@", lambda match: parts[match[1]], template(name))


def number(x: float, unit: str = "", digits: int = 6) -> str:
    """Return a number to read, with its unit: angles in degrees, a true minus sign."""
    x = x if abs(x) > TOLERANCES.tight else 0.0
    if unit == "rad":
        x, unit = math.degrees(x), "°"
    space = "" if unit in ("", "°") else "\u202f"
    return f"{x:.{digits}g}".replace("-", "−") + space + unit


def tiny(x: float) -> str:
    """Return a small number as 3.4 · 10⁻¹⁵."""
    mantissa, exponent = f"{x:.1e}".split("e")
    power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa}\u00a0·\u00a010{power}" if x else "0"


MOST_COLUMNS = 4  # of a table on a telephone; with more, each row is a card there


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: int = 0, *,
          as_cards: bool = True) -> str:
    """Return a table of plain text, whose last columns, `numbers` of them, hold numbers.

    `as_cards`: rows of many columns may be cards, as reports have them on a telephone.
    """
    first, many = len(heads) - numbers, as_cards and len(heads) > MOST_COLUMNS
    kinds = [' class="number"' if k >= first else "" for k in range(len(heads))]
    named = [f' data-head="{html.escape(head)}"' if many else "" for head in heads]

    def line(cells: Sequence[str], tag: str, marks: Sequence[str]) -> str:
        return "".join(f"<{tag}{kind}{mark}>{html.escape(cell)}</{tag}>"
                       for kind, mark, cell in zip(kinds, marks, cells, strict=True))

    body = "".join(f"<tr>{line(row, 'td', named)}</tr>" for row in rows)
    head = line(heads, "th", [""] * len(heads))
    return (f'<div class="wide"><table{" class=many" * many}><thead><tr>{head}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>")


def section(title: str, content: str) -> str:
    """Return a section under its heading."""
    return f"<section><h2>{html.escape(title)}</h2>{content}</section>"


def paragraph(text: str) -> str:
    """Return a paragraph of plain text."""
    return f"<p>{html.escape(text)}</p>"
