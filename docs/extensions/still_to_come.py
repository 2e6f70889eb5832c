"""Pages that are there are listed: a table of contents leaves out files that do not exist.

`{contents-of}` takes the names of pages, one a line, and makes a hidden toctree of those that are
in `docs/`. Each is named once, in the order of the table of contents.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from sphinx.application import Sphinx
from sphinx.directives.other import TocTree


class ContentsOf(TocTree):
    """A toctree of the pages that exist."""

    option_spec: ClassVar[dict] = TocTree.option_spec

    def run(self) -> list:
        """Return the toctree's nodes."""
        folder = Path(self.env.srcdir)
        here = [line for line in self.content.data if (folder / f"{line.strip()}.md").is_file()]
        self.content.data[:] = here
        return super().run()


def setup(app: Sphinx) -> dict[str, bool]:
    """Register it with Sphinx."""
    app.add_directive("contents-of", ContentsOf)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
