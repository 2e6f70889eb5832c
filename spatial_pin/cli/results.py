"""How commands answer: text that fits the screen, JSON and tables where they were asked for."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spatial_pin._support.outputs import write_columns, write_csv, write_text
from spatial_pin.cli.remedies import in_options

WIDTH = 80  # columns of a terminal
SCREEN, STDOUT = "-", "/dev/stdout"
NOTE = "note: "  # a sentence that stays one line, to be searched for
DEEPEST = 40  # columns: from there on a long line goes on below its last word, not farther right

Table = Mapping[str, Any]  # columns of equal length: lists or arrays


class Told(KeyboardInterrupt):
    """Ctrl-C cut it short, and what was found until then has been told."""


def worded(options: argparse.Namespace, text: object) -> str:
    """Return what the library says in the words of the command line."""
    given, flags = vars(options), set(options.parsers[options.command]._option_string_actions)
    if given.get("over", "") is None:
        flags.discard("--hold")  # which is of a sweep
    if not isinstance(given.get("speed"), list):
        flags.discard("--speed")  # which is that of the driver alone
    return in_options(str(text), flags)


def on_screen(options: argparse.Namespace) -> bool:
    """Whether standard output is to hold JSON or a table, and nothing else."""
    paths = getattr(options, "json", None), getattr(options, "csv", None)
    return SCREEN in paths or STDOUT in paths


def tell(
    options: argparse.Namespace, text: object, content: Any = None, table: Table | None = None,
    files: Iterable[Path | str] = (), is_whole: bool = True,
) -> None:
    """Say what was found, write it as asked, and say what was written.

    Args:
        options: those of the command.
        text: for a reader.
        content: for `--json`.
        table: columns of equal length by heading, for `--csv`.
        files: that are written as it goes on.
        is_whole: whether nothing cut it short.

    Raises:
        Told: something did.
    """
    if not on_screen(options):
        say(text)
    written = list(files)
    if table is not None and getattr(options, "csv", None):
        written += write_table(table, options.csv)
    if content is not None and options.json:
        written += write_json(content, options.json)
    if not on_screen(options):
        wrote(written)
    if not is_whole:
        raise Told


def wrote(paths: Iterable[Path | str]) -> None:
    """Say which files were written."""
    for path in paths:
        print(f"wrote {path}")


def say(text: object) -> None:
    """Print text, no line of which is wider than a terminal where it can be broken."""
    shown = "\n".join(fitted(line) for line in str(text).splitlines())
    if shown:
        try:
            print(shown, flush=True)
        except BrokenPipeError:
            unheard()  # files are written all the same


def unheard() -> None:
    """Lead the rest of standard output nowhere: its reader has seen enough."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def fitted(line: str) -> str:
    """Return a line broken at spaces to fit, the rest below its last column of text."""
    if len(line) <= WIDTH or line.startswith(NOTE):
        return line
    columns = [found.end() for found in re.finditer(r"\S {2,}(?=\S)", line[:DEEPEST])]
    indent = len(line) - len(line.lstrip())
    below = columns[-1] if columns else indent + 2
    return textwrap.fill(line, WIDTH, subsequent_indent=" " * below, break_long_words=False,
                         break_on_hyphens=False, replace_whitespace=False)


def grid(rows: Sequence[Sequence[str]], heads: Sequence[str] = ()) -> str:
    """Return rows of words in columns, numbers to the right; lines are broken by `say`."""
    whole = [*([list(heads)] if heads else []), *rows]
    widths = [max(len(row[k]) for row in whole) for k in range(len(whole[0]))] if whole else []
    right = [bool(rows) and all(re.match(r"[-+]?[.\d∞]|$", row[k]) for row in rows)
             for k in range(len(widths))]
    lines = []
    for row in whole:
        words = [f"{word:>{w}}" if to_right else f"{word:{w}}"
                 for word, w, to_right in zip(row, widths, right, strict=True)]
        lines.append("  " + "  ".join(words).rstrip())
    return "\n".join(lines)


def write_json(content: Any, path: str) -> list[str]:
    """Write plain data; returns the files written."""
    text = json.dumps(content, indent=1, allow_nan=False)
    if path == SCREEN:
        print(text)
        return []
    write_text(Path(path), text + "\n")
    return [path]


def write_table(table: Table, path: str) -> list[str]:
    """Write columns of equal length with all digits; returns the files written."""
    columns = {name: np.array(column, dtype=object) for name, column in table.items()}
    if path != SCREEN:
        write_columns(Path(path), columns)
        return [path]
    write_csv(sys.stdout, columns, "\n")
    return []


def finite(x: Any) -> Any:
    """Return numbers, or lists of them, as JSON has them: None for what is not finite."""
    if isinstance(x, Mapping):
        return {key: finite(one) for key, one in x.items()}
    if isinstance(x, np.ndarray):
        return finite(x.tolist())
    if isinstance(x, list | tuple):
        return [finite(one) for one in x]
    if isinstance(x, float | np.floating):
        return float(x) if np.isfinite(x) else None
    return x
