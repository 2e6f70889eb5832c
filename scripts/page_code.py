"""Runs the code of the documentation's pages, as a reader would, and makes their pictures.

    python scripts/page_code.py docs/sweep.md [...]             # runs it, compares what is shown
    python scripts/page_code.py --pictures docs/sweep.md [...]  # and keeps the pictures it writes
    python scripts/page_code.py --write docs/sweep.md [...]     # and writes what it prints into it

All `python` blocks of a page share one namespace and run in order, in an empty folder. A `text`
block right behind one is what it prints ("..." stands for anything). In `console` blocks, lines
that begin with "$ spatial-pin" run too, but for `show`, which waits for the reader. A block below a
line that is a file's name and a colon ("`lifter.toml`:") is that file. `sp.show` and `sp.live` open
no browser here. A block below the comment `<!-- not run -->` is left alone; `<!-- files: PATH -->`
puts a copy of a file or folder of the repository into the folder.

A picture of a page whose name a block writes (`![...](pictures/sweep.png)`) is that picture.
"""

from __future__ import annotations

import argparse
import contextlib
import doctest
import io
import os
import re
import shlex
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import spatial_pin as sp
from spatial_pin import cli
from spatial_pin.view.browser.picture import find_browser
from spatial_pin.view.page.html import export_html

ROOT = Path(__file__).parents[1]
NOT_RUN = "<!-- not run -->"
FENCE = re.compile(r"^(?P<ticks>`{3,}|:{3,})(?P<kind>[a-z]*|\{[a-z-]+\}.*)$")
SAME = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
COPIES = re.compile(r"^<!-- files: (.+) -->$", flags=re.MULTILINE)
FILE = re.compile(r"^`([\w.]+\.[a-z]+)`:$")
IN_A_BROWSER = ("sp.screenshot(", "sp.movie(", "--movie", "--screenshot")


class Block(NamedTuple):
    """A piece of code on a page.

    Attributes:
        kind: "python", "console" or another word behind the three backticks.
        code: its lines.
        line: number of its first line in the file.
        shown: what the page says that it prints; None where it says nothing.
        is_run: whether it is to run.
        file: name of the file that it is; empty where it is none.
    """

    kind: str
    code: str
    line: int
    shown: str | None = None
    is_run: bool = True
    file: str = ""


def fenced(text: str) -> Iterator[tuple[str, list[str], int, int, str]]:
    """Yield (kind, lines, first line, last line, the text line before) of every fenced block."""
    lines, k, before = text.split("\n"), 0, ""
    while k < len(lines):
        match = FENCE.match(lines[k])
        if match is None or not match["kind"]:
            before = lines[k].strip() or before
            k += 1
            continue
        end = next(i for i in range(k + 1, len(lines)) if lines[i].strip() == match["ticks"])
        if match["kind"].startswith("{"):  # a directive: what is in it is part of the page
            k += 1
            continue
        yield match["kind"], lines[k + 1:end], k + 1, end, before
        before, k = "", end + 1


def blocks(path: Path) -> list[Block]:
    """Return the code of a page; a `text` block right behind it is what it prints."""
    found: list[tuple[Block, int]] = []
    for kind, lines, first, last, before in fenced(path.read_text(encoding="utf-8")):
        code = "\n".join(lines)
        if kind == "text" and found and not before and found[-1][0].kind != "text":
            found[-1] = found[-1][0]._replace(shown=code), last
        else:
            file = FILE.match(before)
            found.append((Block(kind, code, first + 1, is_run=before != NOT_RUN,
                                file=file[1] if file else ""), last))
    return [block for block, _ in found
            if block.is_run and (block.file or block.kind in ("python", "console"))]


def commands(code: str) -> Iterator[list[str]]:
    """Yield the arguments of every spatial-pin command of a console block that comes to an end."""
    for line in code.replace("\\\n", " ").split("\n"):
        if line.startswith("$ spatial-pin") and not line.startswith("$ spatial-pin show"):
            yield shlex.split(line, comments=True)[2:]


def run_block(block: Block, namespace: dict, where: str) -> str:
    """Run a block and return what it prints."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        if block.file:
            Path(block.file).write_text(block.code + "\n", encoding="utf-8")
        elif block.kind == "python":
            code = "\n" * (block.line - 1) + block.code  # a traceback shows the page's line
            exec(compile(code, where, "exec"), namespace)
        for arguments in commands(block.code) if block.kind == "console" else ():
            status = cli.main(arguments)
            assert not status, f"{where}:{block.line}: {arguments} ends with {status}"
    return printed.getvalue()


def is_shown(shown: str, printed: str) -> bool:
    """Return whether a page shows what is printed; "..." alone is yet to be filled in."""
    return shown != "..." and doctest.OutputChecker().check_output(shown, printed, SAME)


def write(path: Path, block: Block, printed: str) -> None:
    """Put what a block prints where the page shows something else; "..." alone is replaced too."""
    old = f"{block.code}\n```\n\n```text\n{block.shown}\n```"
    new = f"{block.code}\n```\n\n```text\n{printed.rstrip()}\n```"
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")


def needs_a_browser(block: Block) -> bool:
    return any(word in block.code for word in IN_A_BROWSER)


def run_page(path: Path, writes: bool = False) -> list[str]:
    """Run the code of a page in the current folder; return how what it prints differs."""
    namespace: dict = {"__name__": "__main__"}
    wrong = []
    for names in COPIES.findall(path.read_text(encoding="utf-8")):
        for name in names.split():
            source = ROOT / name
            copy = shutil.copytree if source.is_dir() else shutil.copy
            copy(source, Path(source.name))
    page = {"show": lambda shown, **options: export_html(shown, "shown.html"),
            "live": lambda mechanism, **options: sp.assemble(mechanism)}
    with patch.multiple(sp, **page):
        for block in blocks(path):
            if needs_a_browser(block) and find_browser() is None:
                continue
            printed = run_block(block, namespace, str(path))
            if block.shown is None or is_shown(block.shown, printed):
                continue
            if writes:
                write(path, block, printed)
            else:
                wrong.append(f"{path}:{block.line} prints\n{printed}\nbut the page shows\n"
                             f"{block.shown}")
    return wrong


@contextlib.contextmanager
def empty_folder() -> Iterator[Path]:
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            yield Path(folder)
        finally:
            os.chdir(before)


def keep_pictures(path: Path, folder: Path) -> None:
    """Copy what a page's code has written to where the page has its pictures."""
    for name in re.findall(r"!\[[^\]]*\]\((pictures/[^)]+)\)", path.read_text(encoding="utf-8")):
        made = folder / Path(name).name
        if made.is_file():
            shutil.copy(made, path.parent / name)
            print(f"wrote {path.parent / name}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--pictures", action="store_true", help="keep the pictures they write")
    parser.add_argument("--write", action="store_true", help="write what they print into them")
    options = parser.parse_args()
    wrong = []
    for page in [path.resolve() for path in options.pages]:
        with empty_folder() as folder:
            wrong += run_page(page, options.write)
            if options.pictures:
                keep_pictures(page, folder)
    print("\n\n".join(wrong) or "all blocks run and print what the pages show")
    return bool(wrong)


if __name__ == "__main__":
    raise SystemExit(main())
