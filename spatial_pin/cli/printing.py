"""How results are printed: text that fits the screen, JSON and tables, errors in its words."""

from __future__ import annotations

import argparse
import ast
import json
import os
import re
import sys
import textwrap
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spatial_pin._support.output_files import write_columns, write_csv, write_text
from spatial_pin.assembly.holding import BASE

WIDTH = 80  # columns of a terminal
SCREEN, STDOUT = "-", "/dev/stdout"
NOTE = "note: "  # a sentence that stays one line, to be searched for
DEEPEST = 40  # columns: from there on a long line goes on below its last word, not farther right

Table = Mapping[str, Any]  # columns of equal length: lists or arrays


class CutShort(KeyboardInterrupt):
    """Ctrl-C cut it short, and the result until then has been printed."""


def worded(options: argparse.Namespace, text: object) -> str:
    """Return a message of the library in the words of the command line."""
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


def print_result(
    options: argparse.Namespace, text: object, content: Any = None, table: Table | None = None,
    files: Iterable[Path | str] = (), is_whole: bool = True,
) -> None:
    """Print a result, write it to files, and print the names of these.

    Args:
        options: those of the command.
        text: for a reader.
        content: for `--json`.
        table: columns of equal length by heading, for `--csv`.
        files: that are written as it goes on.
        is_whole: whether nothing cut it short.
    """
    if not on_screen(options):
        say(text)
    written = list(files)
    if table is not None and (path := getattr(options, "csv", None)):
        columns = {name: np.array(column, dtype=object) for name, column in table.items()}
        if path == SCREEN:
            write_csv(sys.stdout, columns, "\n")
        else:
            write_columns(Path(path), columns)
            written.append(path)
    if content is not None and options.json:
        plain = json.dumps(finite(content), indent=1, allow_nan=False)
        if options.json == SCREEN:
            print(plain)
        else:
            write_text(Path(options.json), plain + "\n")
            written.append(options.json)
    if not on_screen(options):
        wrote(written)
    if not is_whole:
        raise CutShort


def wrote(paths: Iterable[Path | str]) -> None:
    """Say which files were written."""
    for path in paths:
        print(f"wrote {path}")


def say(text: object) -> None:
    """Print text, with lines broken at the width of the terminal."""
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
    columns = [match.end() for match in re.finditer(r"\S {2,}(?=\S)", line[:DEEPEST])]
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


def finite(x: Any) -> Any:
    """Return plain data as JSON has it: lists for arrays, None for numbers that are not finite."""
    if isinstance(x, Mapping):
        return {key: finite(one) for key, one in x.items()}
    if isinstance(x, np.ndarray):
        return finite(x.tolist())
    if isinstance(x, list | tuple):
        return [finite(one) for one in x]
    if isinstance(x, float | np.floating):
        return float(x) if np.isfinite(x) else None
    return x


# ---------------------------------------------------------------- remedies in its own words


class Remedy(NamedTuple):
    """How advice to callers from Python reads for who types commands."""

    python: str  # pattern in a message of the library
    words: str | Callable[[re.Match[str]], str]  # its replacement
    # the option that a command needs for it; "" for none. Others leave it to the next
    flag: str = ""


def in_options(text: str, flags: Collection[str]) -> str:
    """Return a message of the library with flags, as `--hold`, in place of arguments."""
    for remedy in REMEDIES:
        if not remedy.flag or remedy.flag in flags:
            text = re.sub(remedy.python, remedy.words, text)

    def option(argument: re.Match[str]) -> str:
        flag = f"--{argument[1].replace('_', '-')}"
        return flag if flag in flags else argument[0]

    return re.sub(r"`(\w+)`", option, text)


def _each(flag: str) -> Callable[[re.Match[str]], str]:
    """Return what writes the names of a list, the last group, each behind an option."""
    return lambda match: " ".join(f"{flag} {name}" for name in ast.literal_eval(
        match[match.re.groups]) if name != str(BASE))  # which the commands hold anyway


def _rates(match: re.Match[str]) -> str:
    return " ".join(f"--speed {name}=0" for name in ast.literal_eval(f"{{{match[1]}}}"))


PRESCRIBED = (r"solve_rates\(\.\.\., \{(.*)\}\), sweep\(\.\.\., hold=(\[.*?\])\) or "
              r"jacobian\(\.\.\., drivers=\[\.\.\.\]\)")

# Tried one after the other. A test checks them against all messages of the library.
REMEDIES = (
    Remedy(PRESCRIBED, _each("--hold"), "--hold"),
    Remedy(PRESCRIBED, _rates, "--speed"),
    Remedy(f"(?:, such as )?{PRESCRIBED}; each may have a (.drivers.name.) in the file too",
           r" by a \3 of each in the file"),
    Remedy(r"hold=(\[.*?\])", _each("--hold"), "--hold"),
    Remedy(r'hold="base"', "--hold base", "--hold"),
    Remedy(r" \(hold=(?:\[.*?\]|\"base\")\)", ""),
    Remedy(r"; hold=(\[.*?\]) stops the joints with springs", ""),
    Remedy(r"; nothing holds the free base, which .*? does by default", ""),
    Remedy(r"\bactuated=(\[.*?\])", _each("--actuated")),
    Remedy(r"with release=True or free=\[\.\.\.\]", "by --release or --free NAME", "--free"),
    Remedy(r", or let them go with release=True or free=\[\.\.\.\]", ""),
    Remedy(r" \(see State\.gap; assemble\(gap=0\) refuses them\)", ""),
    Remedy(r"assemble\(limits=True\)", "`spatial-pin assemble --limits`"),
    Remedy(r"give on_joint_limit=\"report\"", "--on-joint-limit report"),
    Remedy(r"on_crossing='raise' asks to stop there; give on_crossing='straight' to go on", ""),
    Remedy(r", or give on_crossing='straight' to go on", ""),
    Remedy(r"with limits=False", "with --no-limits"),
    Remedy(r", such as sp\.closures\.weld\(\(.*?, state\.placement\(.*?\)\), .*?\)", ""),
    Remedy(r"set base=True", "--base"),
    Remedy(r"task='pose'", "--task pose"),
    Remedy(r"load\(\.\.\., gap=(.*?)\)", r"`gap = \1` in the mechanism file"),
    Remedy(r"gap=(.*?) allows it", r"`gap = \1` in the mechanism file allows it"),
    Remedy(r"(?:sp\.)?load\(\.\.\., packages=\{(.*?)\}\)", lambda match: " ".join(
        f"--package {name}=FOLDER" for name in re.findall(r"'([^']*)'", match[1]))),
    Remedy(r"sp\.load\(\.\.\., trusted=True\)", "--trusted"),
    Remedy(r"load\(\.\.\., without=\[('.*?'|\".*?\")\]\)", r"--without \1"),
    Remedy(r"load\(\.\.\., model=('.*?'|\".*?\")\)", r"--model \1"),
    Remedy(r"load\(\.\.\., (\w+)=\.\.\.\)", r"--set \1=VALUE"),
    Remedy(r"free_flyer=True", "--free-flyer"),
    Remedy(r"\bsp\.mobility\b", "`spatial-pin info`"),
    Remedy(r"take a smaller time_tolerance or step(, or formulation='independent')?",
           "take --accuracy reference"),
    Remedy(r", a larger time_tolerance, integrator='Radau' .*? Accuracy\(most_steps=.*?\)",
           " or --accuracy draft"),
    Remedy(r"make it smooth, or take Accuracy\(.*?\)", "make it smooth"),
)
