"""The command `spatial-pin`: parse the words, run the command, print an error in one line."""

from __future__ import annotations

import argparse
import codecs
import io
import os
import platform
import re
import shlex
import sys
import tempfile
import textwrap
import traceback
import warnings
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path
from typing import Any

import spatial_pin as sp
from spatial_pin._support.output_files import figure_suffix
from spatial_pin.cli.commands import COMMANDS, GROUPS
from spatial_pin.cli.mechanism_arguments import Options
from spatial_pin.cli.options import MECHANISM, as_taken
from spatial_pin.cli.printing import SCREEN, WIDTH, CutShort, unheard, worded
from spatial_pin.errors import suggestion

DESCRIPTION = "Spatial mechanisms with closed loops: load, close, move, see."
MORE = "`spatial-pin COMMAND --help` lists the words and options of a command."
COLUMN = 15  # where the texts of commands begin in the help
DATA = ("json", "csv")  # options that take - for the screen
FILES = ("csv", "npz", "plot", "html", "json", "movie", "urdf",
         "picture", "curves", "report", "resume")  # options that name a file to write
PACKAGE = Path(sp.__file__).parent
LIBRARIES = ("pin", "numpy", "scipy")  # whose versions a report of a fault needs
PLAIN = "spatial_pin.plain"  # how signs are written that an encoding lacks
SIGNS = {"°": " deg", "²": "2", "³": "3", "·": "*", "µ": "u", "±": "+-", "∞": "inf", "…": "...",
         "√": "sqrt", "π": "pi", "−": "-", "≤": "<=", "×": "x", "ü": "ue"}


class _Parser(argparse.ArgumentParser):
    """Takes options between the words of a command: `assemble rssr --set d=315mm crank=60deg`."""

    _within = False

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)  # --n would be any option with an n

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self.get_default("run") is None or self._within:
            return super().parse_known_args(args, namespace)
        self._within = True  # the next line calls this again, for options and words in turn
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._within = False


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    lines = []
    for title, group in GROUPS.items():
        lines += ["", f"{title}:"]
        for name, command in group.items():
            lines += textwrap.wrap(command.text, WIDTH, initial_indent=f"  {name:{COLUMN - 2}}",
                                   subsequent_indent=" " * COLUMN)
    whole = _Parser(prog="spatial-pin", usage="spatial-pin [-h] [--version] COMMAND ...",
                    description=DESCRIPTION, epilog="\n".join([*lines, "", MORE]),
                    formatter_class=argparse.RawDescriptionHelpFormatter)
    whole.add_argument("--version", action="version", version=f"spatial-pin {sp.__version__}")
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND",
                                    prog="spatial-pin", help=argparse.SUPPRESS)
    parsers: dict[str, argparse.ArgumentParser] = {}
    for name, command in COMMANDS.items():
        sub = parsers[name] = commands.add_parser(name, description=command.text)
        sub.set_defaults(run=command.run, usage_error=sub.error, hints=[], cut_short="",
                         parsers=parsers)
        for flag, settings in MECHANISM if command.takes_mechanism else ():
            sub.add_argument(flag, **settings)
        exclusive = sub.add_mutually_exclusive_group(required=True) if command.one_of else sub
        for flag, settings in command.one_of:
            exclusive.add_argument(flag, **settings)
        for flag, settings in command.options:
            sub.add_argument(flag, **settings)
    whole.set_defaults(parsers=parsers)
    return whole


def options_of(words: Sequence[str]) -> Options:
    """Return the options that words ask for; their `run` is the command's."""
    whole = parser()
    if words and words[0] not in COMMANDS and not words[0].startswith("-"):
        whole.error(f"no command {words[0]!r}; {_near(words[0], COMMANDS)}")
    if words and words[0] in COMMANDS:
        words = as_taken(words, whole.get_default("parsers")[words[0]])
    # argparse takes -90deg for an option, but nothing that begins with a space
    options, rest = whole.parse_known_args(
        [f" {w}" if re.match(r"-\.?\d", w) else w for w in words], Options())
    for word in rest:
        sub = options.parsers[options.command]
        known = [flag for action in sub._actions for flag in action.option_strings]
        sub.error(f"no option {word!r}; {_near(word, known)}" if word.startswith("--") else
                  f"nothing more is expected than was given before {word.strip()!r}")
    return options


def _near(word: str, known: Iterable[str]) -> str:
    """Return the nearest of some words, else a pointer to --help."""
    near = suggestion(word, known)
    return near if near.startswith("did you mean") else "--help lists them"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return 0, 1 for a mechanism or solver error, 2 for usage."""
    words = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):  # signs that an encoding lacks are written with others
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=PLAIN)
    try:
        return _run(words)
    except Exception as error:  # the last resort: no user is shown a traceback
        print(f"spatial-pin: {_unforeseen(error, words)}", file=sys.stderr)
        return 1


def _run(words: Sequence[str]) -> int:
    """Run a command; an expected error becomes one sentence."""
    options = options_of(words)
    warnings.showwarning = lambda message, *_, **__: print(
        f"spatial-pin: warning: {worded(options, message)}", file=sys.stderr)
    try:
        _check_files(options)
        options.run(options)
        if sys.stdout is not None:  # which it is where standard output is closed
            sys.stdout.flush()
    except BrokenPipeError:  # nothing remains to flush at exit
        unheard()
        return 0
    except (sp.SpatialPinError, ValueError) as error:
        return _refused(options, error)
    except MemoryError:
        print("spatial-pin: there is not enough memory for this; ask for fewer values",
              file=sys.stderr)
        return 1
    except OSError as error:
        what = f"{error.filename}: " if error.filename else "cannot write: "
        print(f"spatial-pin: {what}{error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as end:
        if not isinstance(end, CutShort):
            print("spatial-pin: interrupted before there was a result", file=sys.stderr)
        return 130
    for hint in _hints(options):
        print(f"spatial-pin: hint: {hint}", file=sys.stderr)
    if options.cut_short:
        print(f"spatial-pin: {options.cut_short}", file=sys.stderr)
    return 130 if options.cut_short else 0


def _refused(options: Options, error: Exception) -> int:
    """Print an error of the library; errors of other packages are raised on."""
    frames = traceback.extract_tb(error.__traceback__)
    if not isinstance(error, sp.SpatialPinError) and frames and (
            PACKAGE not in Path(frames[-1].filename).parents):
        raise error
    print("; ".join([f"spatial-pin: {worded(options, error)}", *_hints(options)]),
          file=sys.stderr)
    return 1


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Return replacements of signs that an encoding lacks; ? where there is none."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(SIGNS.get(sign, "?") for sign in lacking), error.end


codecs.register_error(PLAIN, _plain)


def _hints(options: Options) -> list[str]:
    """Return hints at words with another possible meaning, each once."""
    return list(dict.fromkeys(options.hints))


def _check_files(options: Options) -> None:
    """Refuse files that cannot be written before any work is done for them."""
    both = [name for name in DATA if getattr(options, name, None) == SCREEN]
    if len(both) > 1:
        options.usage_error("standard output holds one of --json - and --csv -")
    for name in FILES:
        path = getattr(options, name, None)
        if path is None or (name in DATA and path == SCREEN):
            continue
        if path in ("", SCREEN):
            options.usage_error(f"--{name} {path!r}: the name of a file is needed")
        if name in ("plot", "picture"):
            figure_suffix(Path(path), f"--{name}")
        folder = Path(path).parent
        if Path(path).is_dir():
            raise ValueError(f"--{name} {path}: this is a folder; give the name of a file")
        if not folder.is_dir():
            raise ValueError(f"--{name} {path}: there is no folder {str(folder)!r}")
        if not os.access(path if Path(path).exists() else folder, os.W_OK):
            raise ValueError(f"--{name} {path}: not allowed to write there")


# ---------------------------------------------------------------- what nobody foresaw


def _unforeseen(error: Exception, words: Sequence[str]) -> str:
    """Return the sentence about an error that no part of the library raises on purpose.

    The traceback goes into a new file of the folder for temporary files, else on stderr.
    """
    text = "\n".join([
        f"command: spatial-pin {shlex.join(words)}",
        f"spatial_pin {sp.__version__}, Python {platform.python_version()}, {platform.platform()}",
        ", ".join(f"{name} {_version(name)}" for name in LIBRARIES),
        "", "".join(traceback.format_exception(error)),
    ])
    try:
        with tempfile.NamedTemporaryFile("w", encoding="utf-8", prefix="spatial-pin-",
                                         suffix=".txt", delete=False) as file:
            file.write(text)
        evidence = f"with the file {file.name}"
    except OSError:
        print(text, file=sys.stderr)
        evidence = "with the lines above"
    what = " ".join(f"{type(error).__name__}: {error}".split())
    return (f"this error was not foreseen, and it is a fault of the program: {what}; please "
            f"report it at {_where()}, {evidence}")


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "of unknown version"


def _where() -> str:
    """Return where faults are reported."""
    try:
        urls = metadata("spatial_pin").get_all("Project-URL", [])
    except PackageNotFoundError:
        urls = []
    links = [url.removeprefix("Issues, ") for url in urls if url.startswith("Issues, ")]
    return links[0] if links else "the project's page"
