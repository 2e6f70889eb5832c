"""What the command says of an error that nobody foresaw: one sentence, and a file to report."""

from __future__ import annotations

import platform
import shlex
import sys
import tempfile
import traceback
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path

import spatial_pin as sp

PACKAGE = Path(sp.__file__).parent
LIBRARIES = ("pin", "numpy", "scipy")  # whose versions a report needs


def is_foreign(error: BaseException) -> bool:
    """Whether an error was raised by the code of another package, for nobody to read."""
    frames = traceback.extract_tb(error.__traceback__)
    return bool(frames) and PACKAGE not in Path(frames[-1].filename).parents


def unforeseen(error: Exception, words: Sequence[str]) -> str:
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
