"""Runs the notebooks in `notebooks/` and stores what their cells show.

    ./scripts/notebooks [first_steps ...]

Needs the extra `test`, and Chromium or Chrome for the pictures. Cells are edited in the notebooks;
what changes from run to run without a meaning (times of execution, versions) is not stored.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "notebooks"
MOST_BYTES = 700_000  # of a notebook that is stored: pictures and one page that plays, not a film
LONGEST = 300  # of a cell [s]


def notebooks() -> list[Path]:
    """Return the notebooks, sorted."""
    return sorted(FOLDER.glob("*.ipynb"))


def run(path: Path) -> Any:
    """Return a notebook after all its cells ran in an empty folder; a cell's error is raised."""
    book = nbformat.read(path, as_version=4)
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(book, timeout=LONGEST, record_timing=False, coalesce_streams=True,
                                resources={"metadata": {"path": folder}})
        client.execute(env=env)
    book.metadata["language_info"] = {"name": "python"}
    return book


def main() -> None:
    """Run the notebooks that were named, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="of notebooks, without .ipynb; default all")
    names = parser.parse_args().names
    for path in [FOLDER / f"{name}.ipynb" for name in names] or notebooks():
        text = nbformat.writes(run(path)) + "\n"
        if len(text.encode()) > MOST_BYTES:
            raise SystemExit(f"{path}: {len(text.encode())} bytes are more than {MOST_BYTES}")
        path.write_text(text, encoding="utf-8")
        print(f"{path.relative_to(ROOT)}: {len(text.encode())} bytes")


if __name__ == "__main__":
    main()
