"""The command `spatial-pin`: parses, runs, and says in one line what went wrong."""

from __future__ import annotations

import argparse
import codecs
import io
import os
import platform
import shlex
import sys
import tempfile
import traceback
import warnings
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path

import spatial_pin as sp
from spatial_pin._support.outputs import figure_suffix
from spatial_pin.cli.parser import options_of
from spatial_pin.cli.printing import SCREEN, CutShort, unheard, worded

DATA = ("json", "csv")  # options that take - for the screen
FILES = ("csv", "npz", "plot", "html", "json", "movie", "urdf",
         "picture", "curves", "report", "resume")  # options that name a file to write
PACKAGE = Path(sp.__file__).parent
LIBRARIES = ("pin", "numpy", "scipy")  # whose versions a report of a fault needs
PLAIN = "spatial_pin.plain"  # how signs are written that an encoding lacks
SIGNS = {"°": " deg", "²": "2", "³": "3", "·": "*", "µ": "u", "±": "+-", "∞": "inf", "…": "...",
         "√": "sqrt", "π": "pi", "−": "-", "≤": "<=", "×": "x", "ü": "ue"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return 0, 1 for a mechanism or solver error, 2 for usage."""
    words = sys.argv[1:] if arguments is None else arguments
    _fit_streams()
    try:
        return _run(words)
    except Exception as error:  # the last resort: no user is shown a traceback
        print(f"spatial-pin: {_unforeseen(error, words)}", file=sys.stderr)
        return 1


def _run(words: Sequence[str]) -> int:
    """Run a command; what it raises on purpose becomes one sentence."""
    options = options_of(words)
    warnings.showwarning = lambda message, *_, **__: print(
        f"spatial-pin: warning: {worded(options, message)}", file=sys.stderr)
    try:
        _check_files(options)
        options.run(options)
        if sys.stdout is not None:  # which it is where standard output is closed
            sys.stdout.flush()
    except BrokenPipeError:  # nothing is left to flush at exit
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


def _refused(options: argparse.Namespace, error: Exception) -> int:
    """Say what the library refuses; an error that it did not raise itself is raised again."""
    if _is_foreign(error):
        raise error
    print("; ".join([f"spatial-pin: {worded(options, error)}", *_hints(options)]),
          file=sys.stderr)
    return 1


def _fit_streams() -> None:
    """Have text printed in any encoding: signs that it lacks are written with those it has."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=PLAIN)


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Return what is written for signs that an encoding lacks; ? where nothing else is known."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(SIGNS.get(sign, "?") for sign in lacking), error.end


codecs.register_error(PLAIN, _plain)


def _hints(options: argparse.Namespace) -> list[str]:
    """Return what may have been meant otherwise, each once."""
    return list(dict.fromkeys(options.hints))


def _check_files(options: argparse.Namespace) -> None:
    """Refuse files that cannot be written before any work is done for them.

    Raises:
        ValueError: there is no such folder, it is not to be written in, or it is a folder; or a
            figure's name has no suffix that tells how to write it.
    """
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


def _is_foreign(error: BaseException) -> bool:
    """Whether an error was raised by the code of another package, for nobody to read."""
    if isinstance(error, sp.SpatialPinError):
        return False
    frames = traceback.extract_tb(error.__traceback__)
    return bool(frames) and PACKAGE not in Path(frames[-1].filename).parents


def _unforeseen(error: Exception, words: Sequence[str]) -> str:
    """Return the sentence about an error that no part of the library raises on purpose.

    The traceback goes into a new file of the folder for temporary files, else on stderr.

    Args:
        error: what was raised.
        words: of the command.
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
    found = [url.removeprefix("Issues, ") for url in urls if url.startswith("Issues, ")]
    return found[0] if found else "the project's page"
