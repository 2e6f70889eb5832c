"""Runs the code of the documentation's pages, as a reader would, and makes their pictures.

    python scripts/page_code.py docs/sweep.md [...]             # runs it, compares what is shown
    python scripts/page_code.py --pictures docs/sweep.md [...]  # and keeps the pictures it writes
    python scripts/page_code.py --write docs/sweep.md [...]     # and writes what it prints into it

All `python` blocks of a page share one namespace and run in order, in an empty folder. Commands in
`console` blocks ("$ spatial-pin ...", "$ python FILE ...") run too. A `text` block right behind one
is what it prints ("..." stands for anything). `sp.show` and `sp.live` open no browser and wait for
nobody here, and films have few pictures a second. A block below a line that is a file's name and a
colon ("`lifter.toml`:") is that file. A comment right above a block says what else is to be known:

    <!-- from: examples/NAME.py -->  parts of this script, with "# ..." between them; the script is
                                     run, and what the page shows are lines that it prints
    <!-- ends with 1 -->             the command fails with this status
    <!-- not run: REASON -->         left alone

`<!-- files: PATH -->` puts a copy of a file or folder of the repository into the folder.

A picture of a page whose name a block writes (`![...](pictures/sweep.png)`) is that picture.
"""

from __future__ import annotations

import argparse
import contextlib
import doctest
import functools
import io
import os
import re
import runpy
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import spatial_pin as sp
from spatial_pin import cli
from spatial_pin.view.browser import find_browser

ROOT = Path(__file__).parents[1]
REMARK = re.compile(r"^<!-- (?P<word>from|ends with|not run):? (?P<what>.+) -->$")
BETWEEN = "# ...\n"  # the parts of a script
MISSING = "pip install 'spatial_pin["  # message where an extra package is missing
FENCE = re.compile(r"^(?P<ticks>`{3,}|:{3,})(?P<kind>[a-z]*|\{[a-z-]+\}.*)$")
ROUND_OFF = re.compile(r"-?\b(?:\d(?:\.\d+(?:\.\.\.\d*)?)?e-(?:09|[1-9]\d)|0\.0e\+00)\b")
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
        shown: its output on the page; None without any.
        why_not: reason why it is not run; empty where it is.
        file: name of the file that it is; empty where it is none.
        script: path of the script that it is a part of; empty without one.
        status: what its commands end with.
    """

    kind: str
    code: str
    line: int
    shown: str | None = None
    why_not: str = ""
    file: str = ""
    script: str = ""
    status: int = 0


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
        if match["kind"].startswith("{"):  # a directive: its content is part of the page
            k += 1
            continue
        yield match["kind"], lines[k + 1:end], k + 1, end, before
        before, k = "", end + 1


def block_of(kind: str, code: str, line: int, before: str) -> Block:
    """Return a piece of code with the remark before it."""
    file, remark = FILE.match(before), REMARK.match(before)
    words = {remark["word"]: remark["what"]} if remark else {}
    return Block(kind, code, line, why_not=words.get("not run", ""), file=file[1] if file else "",
                 script=words.get("from", ""), status=int(words.get("ends with", 0)))


def pieces(path: Path) -> list[Block]:
    """Return all code of a page; a `text` block right behind a piece is what it prints."""
    blocks: list[Block] = []
    for kind, lines, first, _, before in fenced(path.read_text(encoding="utf-8")):
        code = "\n".join(lines)
        if kind == "text" and blocks and not before and blocks[-1].kind != "text":
            blocks[-1] = blocks[-1]._replace(shown=code)
        else:
            blocks.append(block_of(kind, code, first + 1, before))
    return blocks


def blocks(path: Path) -> list[Block]:
    """Return the code of a page that is to run."""
    return [block for block in pieces(path)
            if not block.why_not and (block.file or block.kind in ("python", "console"))]


def commands(code: str) -> Iterator[list[str]]:
    """Yield the words of every command of a console block; of $(...) and pipes what comes first."""
    for line in code.replace("\\\n", " ").split("\n"):
        if line.startswith("$ "):
            inner = re.search(r"\$\((.*?)\)", line)
            yield shlex.split(inner[1] if inner else line[2:].partition(" | ")[0], comments=True)


def run_command(words: list[str]) -> int:
    """Run "spatial-pin ..." or "python FILE ..."; return what it ends with."""
    if words[0] == "spatial-pin":
        return cli.main(words[1:])
    if words[0] != "python":
        raise ValueError(f"{shlex.join(words)} cannot be run: say why not above the block")
    run_script(Path(words[1]), words[2:])
    return 0


def run_script(path: Path, arguments: list[str]) -> None:
    """Run a script without its pictures."""
    with patch.object(sys, "argv", [str(path), *arguments]), \
            patch.object(sp, "screenshot", lambda *arguments, **keywords: None):
        runpy.run_path(str(path), run_name="__main__")


def unindented(code: str) -> str:
    """Return code without what its lines begin with."""
    return "\n".join(line.strip() for line in code.splitlines())


def not_in_script(block: Block) -> list[str]:
    """Return the parts of a block that are not in the script it is from."""
    script = unindented((ROOT / block.script).read_text(encoding="utf-8"))
    return [part for part in block.code.split(BETWEEN) if unindented(part) not in script]


def run_block(block: Block, namespace: dict, where: str) -> str:
    """Run a block and return what it prints."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        if block.file:
            Path(block.file).write_text(block.code + "\n", encoding="utf-8")
        elif block.script:
            run_script(ROOT / block.script, ["."])
        elif block.kind == "python":
            code = "\n" * (block.line - 1) + block.code  # a traceback shows the page's line
            exec(compile(code, where, "exec"), namespace)
        elif block.kind == "console":
            with contextlib.redirect_stderr(printed):
                for words in commands(block.code):
                    status = run_command(words)
                    assert status == block.status, (
                        f"{where}:{block.line}: {words} ends with {status}\n{printed.getvalue()}")
    return printed.getvalue()


def is_shown(block: Block, printed: str) -> bool:
    """Return whether a page shows what is printed; "..." alone is yet to be filled in.

    Numbers below 1e-9 are round-off, whose digits are each machine's own.
    """
    if block.shown is None:
        return True
    shown, printed = (ROUND_OFF.sub("(round-off)", text) for text in (block.shown, printed))
    if block.script:
        return set(shown.splitlines()) <= set(printed.splitlines())
    return shown != "..." and doctest.OutputChecker().check_output(shown, printed, SAME)


def write(path: Path, block: Block, printed: str) -> None:
    """Put what a block prints where the page shows something else; "..." alone is replaced too."""
    old = f"{block.code}\n```\n\n```text\n{block.shown}\n```"
    new = f"{block.code}\n```\n\n```text\n{printed.rstrip()}\n```"
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")


def needs_a_browser(block: Block) -> bool:
    return any(word in block.code for word in IN_A_BROWSER)


def run_or_skip(block: Block, namespace: dict, where: str) -> str | None:
    """Run a block and return what it prints; None where what it needs is not on this machine."""
    if needs_a_browser(block) and find_browser() is None:
        return None
    try:
        return run_block(block, namespace, where)
    except (SystemExit, sp.MechanismFileError) as error:
        if MISSING not in str(error):
            raise
        return None


@contextlib.contextmanager
def nobody_looks() -> Iterator[None]:
    """Serve pages without opening a browser, wait for nobody, make films of few pictures."""
    shown: list[sp.Viewer] = []

    def unseen(verb):
        def serve(*arguments, **options):
            shown.append(verb(*arguments, **{"open_browser": False} | options))
            return shown[-1]
        return serve

    verbs = {"show": unseen(sp.show), "live": unseen(sp.live),
             "movie": functools.partial(sp.movie, fps=2)}
    try:
        with patch.multiple(sp, **verbs), \
                patch.object(sp.Viewer, "wait", lambda viewer, timeout=None: None):
            yield
    finally:
        for viewer in shown:
            viewer.stop()


def run_page(path: Path, writes: bool = False) -> list[str]:
    """Run the code of a page in the current folder; return how what it prints differs."""
    namespace: dict = {"__name__": "__main__"}
    wrong = []
    for names in COPIES.findall(path.read_text(encoding="utf-8")):
        for name in names.split():
            source = ROOT / name
            copy = shutil.copytree if source.is_dir() else shutil.copy
            copy(source, Path(source.name))
    with nobody_looks():
        for block in blocks(path):
            if block.script:
                wrong += [f"{path}:{block.line}: {block.script} has no such lines:\n{part}"
                          for part in not_in_script(block)]
            printed = run_or_skip(block, namespace, str(path))
            if printed is None or is_shown(block, printed):
                continue
            if writes and not block.script:
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
