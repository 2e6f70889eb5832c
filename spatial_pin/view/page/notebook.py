"""Pages as a notebook shows them: inside of the notebook itself, which stores and exports them.

An exported notebook, or one on another machine, has no server to ask: a frame holds the whole page.
"""

from __future__ import annotations

import html
import os
import sys
from pathlib import PosixPath, WindowsPath

SUFFIXES = (".html", ".htm", ".xhtml")
STYLE = "width: 100%; height: 600px; border: 1px solid #dfe3e8"
# JupyterLab takes frames out of notebooks of others until they are trusted, and leaves what is in
# them, which no browser shows in a frame.
HIDDEN = "Run this cell, or trust the notebook, to see the page that is stored here."
# The frame of a page with a server: one that cannot be asked is replaced by a frame of what
# needs none. The same frame would not do: what it was to load may fail later, and show an error.
WATCHED = """<iframe src="{url}" id="{name}" data-still="{still}" style="{style}">{hidden}</iframe>
<script>
(() => {{
  const frame = document.getElementById("{name}");
  fetch("{url}", {{mode: "no-cors", cache: "no-store"}}).catch(() => {{
    const other = frame.cloneNode();
    other.removeAttribute("src");
    other.srcdoc = frame.dataset.still;
    frame.replaceWith(other);
  }});
}})();
</script>"""


def is_in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook; importing one's parts is not it."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")


def framed(page: str) -> str:
    """Return a frame that holds a page."""
    return f'<iframe srcdoc="{_quoted(page)}" style="{STYLE}">{HIDDEN}</iframe>'


def watched(url: str, still: str) -> str:
    """Return a frame of a served page, and of a still one where the server does not answer."""
    name = f"spatial_pin_{html.escape(url.rpartition(':')[2].strip('/'))}"
    return WATCHED.format(url=html.escape(url), name=name, still=_quoted(still), style=STYLE,
                          hidden=HIDDEN)


def _quoted(page: str) -> str:
    """Return a page as an attribute has it; only two characters end or change what is quoted."""
    return page.replace("&", "&amp;").replace('"', "&quot;")


class PagePath(PosixPath if os.name == "posix" else WindowsPath):  # type: ignore[misc]
    """The path of a page that was written; as the last value of a cell it is the page."""

    def _repr_html_(self) -> str | None:
        """Return the page in a frame, for a notebook; None where there is none any more."""
        is_page = self.suffix.lower() in SUFFIXES and self.is_file()  # not so of its folder
        return framed(self.read_text(encoding="utf-8")) if is_page else None
