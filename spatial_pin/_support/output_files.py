"""Writing files: an old file stays until the new one is complete.

A full disk, an error or a kill on the way loses nothing.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LONGEST_SUFFIX = 16  # of a name whose suffix is the format
FORMULA = ("=", "+", "-", "@")  # how formulas of a spreadsheet begin
QUOTE = "'"  # before a text that is none, in a table


def named_path(path: object) -> Path:
    """Return a path that can name a file.

    Raises:
        TypeError: it is no path.
        ValueError: it is empty, a folder, or has a character that no name can have.
    """
    text = _name(path, "file")
    if os.path.isdir(text):
        raise ValueError(f"{text}: this is a folder; give the name of a file")
    return Path(text)


def named_folder(path: object) -> Path:
    """Return a path that can name a folder.

    Raises:
        TypeError: it is no path.
        ValueError: it is empty, a file, or has a character that no name can have.
    """
    text = _name(path, "folder")
    if os.path.lexists(text) and not os.path.isdir(text):
        raise ValueError(f"{text}: this is a file; give the name of a folder")
    return Path(text)


def _name(path: object, kind: str) -> str:
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else path
    if not isinstance(text, str):
        raise TypeError(f"path must be the name of a {kind}, not {repr(path)[:60]} of type "
                        f"{type(path).__name__}")
    try:
        is_name = bool(text) and b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:  # half a character
        is_name = False
    if not is_name:
        raise ValueError(f"path is {text!r:.60}, which is no name of a {kind}")
    return text


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a name beside `path`; when the block ends well, its file takes the place of `path`.

    The new file has the permissions of the old one. Links, pipes and devices are written
    themselves, and so is a file in a folder where no other can be made.

    Raises:
        OSError: it cannot be written; the error names `path`.
    """
    try:  # is it new or a plain file, in a folder that takes another beside it?
        is_replaced = stat.S_ISREG(path.lstat().st_mode) and os.access(
            path.parent, os.W_OK | os.X_OK)
    except OSError:
        is_replaced = True
    if not is_replaced:
        with _naming(path, path):
            yield path
        return
    if path.exists() and not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    suffix = path.suffix if len(path.suffix) <= LONGEST_SUFFIX else ""
    new = path.with_name(f".{os.urandom(8).hex()}{suffix}")
    try:
        with _naming(path, new):
            os.close(os.open(new, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            if path.exists():
                os.chmod(new, stat.S_IMODE(path.stat().st_mode))
            yield new
            os.replace(new, path)
    finally:
        with contextlib.suppress(OSError):
            new.unlink()


def is_special(path: Path) -> bool:
    """Whether a path is a pipe, a device or the like."""
    return path.exists() and not path.is_file()


@contextlib.contextmanager
def _naming(path: Path, new: Path) -> Iterator[None]:
    """Let errors speak of the file that the user knows."""
    try:
        yield
    except OSError as error:
        if error.errno is None or not (
                error.filename is None or os.fspath(error.filename) == str(new)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error  # of its own kind


def write_columns(path: Path, table: Mapping[str, Any]) -> Path:
    """Write named columns of equal length as .csv, with all digits; returns the path.

    Raises:
        OSError: it cannot be written; an old file stays.
    """
    with replacing(path) as target, target.open("w", newline="", encoding="utf-8") as file:
        write_csv(file, table, "\r\n")
    return path


def write_csv(file: TextIO, table: Mapping[str, Any], line_end: str) -> None:
    """Write named columns of equal length to an open file, with all digits.

    Names that a spreadsheet would take for formulas are written as text, behind a quote.
    """
    writer = csv.writer(file, lineterminator=line_end)
    writer.writerow(map(_as_text, table))
    writer.writerows(zip(*(map(_as_text, c.tolist()) for c in table.values()), strict=True))


def _as_text(cell: Any) -> Any:
    """Return a cell that is no formula; a number, or a text that is one, stays as it is."""
    if not isinstance(cell, str) or not cell.startswith(FORMULA) or len(cell) == 1:
        return cell
    try:
        float(cell)
    except ValueError:
        return f"{QUOTE}{cell}"
    return cell


def plain_text(cell: str) -> str:
    """Return a cell of a table as it was before it was written as text and no formula."""
    return cell[1:] if cell.startswith(tuple(QUOTE + x for x in FORMULA)) else cell


def write_bytes(path: Path, content: bytes | memoryview) -> Path:
    """Write a file as a whole; returns its path.

    Raises:
        OSError: it cannot be written.
    """
    with replacing(path) as target, target.open("wb") as file:
        file.write(content)
    return path


def write_text(path: Path, text: str) -> Path:
    """Write a file of text as a whole, UTF-8, line ends as they are; returns its path.

    Raises:
        OSError: it cannot be written.
    """
    return write_bytes(path, text.encode())


def figure_suffix(path: Path, what: str = "path") -> str:
    """Return the format that the name of a figure's file asks for, without the dot.

    Raises:
        ValueError: no figure has this suffix.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to import

    known, suffix = FigureCanvasAgg.get_supported_filetypes(), path.suffix.lower()[1:]
    if suffix not in known:
        raise ValueError(f"{what} {path}: its suffix is the format of a figure: .png, .svg, .pdf "
                         f"(or .{', .'.join(sorted(set(known) - {'png', 'svg', 'pdf'}))})")
    return suffix


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure in the format of its suffix.

    Raises:
        ValueError: no figure has this suffix.
        OSError: it cannot be written.
    """
    path = named_path(path)
    suffix = figure_suffix(path)
    with replacing(path) as target:
        figure.savefig(target, format=suffix)


def literal(text: str) -> str:
    """Return text that a figure shows as it is: between two $ it would read a formula."""
    return text.replace("$", r"\$")
