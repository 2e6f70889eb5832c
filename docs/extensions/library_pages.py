"""The gallery: a page for each mechanism of the library, written when the documentation is built.

`docs/library/NAME.md` has a picture, what the file says of the mechanism, its dimensions, its
mobility and the file itself. `{library-cards}` shows them all on one page.
"""

from __future__ import annotations

from pathlib import Path

from docutils import nodes
from mechanism_words import loops, mobility
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import spatial_pin as sp

FOLDER = "library"


def picture(docs: Path, name: str) -> str:
    """Return the picture of a mechanism, from `docs/`; empty where there is none yet."""
    path = f"pictures/{name}.jpg"
    return path if (docs / path).is_file() else ""


def number(value: float) -> str:
    """Return a dimension in few digits."""
    return f"{value:.6g}"


def drives(mechanism: sp.Mechanism) -> str:
    """Return the drivers in words, with the joint of each where its name is another."""
    named = [f"`{name}`" if name == driver.joint else f"`{name}` (joint `{driver.joint}`)"
             for name, driver in mechanism.drivers.items()]
    return ", ".join(named) or "none"


def page(docs: Path, name: str) -> str:
    """Return the page of a mechanism, Markdown."""
    mechanism = sp.load(name)
    shown = picture(docs, name)
    sizes = "\n".join(f"| `{key}` | {number(value)} |"
                      for key, value in mechanism.dimensions.items())
    file = mechanism.path
    parts = [
        f"# {name}", f"{mechanism.title}.".replace("..", "."),
        f"![{mechanism.title}](../{shown}){{width=\"480px\"}}" if shown else "",
        f"Source: {mechanism.source}." if mechanism.source else "",
        f"```python\nimport spatial_pin as sp\n\nmech = sp.load(\"{name}\")\nsp.live(mech)\n```",
        f"Drivers: {drives(mechanism)}.",
        loops(mechanism),
        "## Dimensions\n\nIn SI units and radians. Each is a keyword of `sp.load` and of `--set`."
        f"\n\n| name | default |\n|---|---|\n{sizes}" if sizes else "",
        mobility(mechanism),
        f"## File\n\n`{file.name}`:\n\n```toml\n{file.read_text(encoding='utf-8').strip()}\n```"
        if file else "",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def write_pages(app: Sphinx) -> None:
    """Write the pages of all mechanisms; those that say the same as before are left alone."""
    docs = Path(app.srcdir)
    folder = docs / FOLDER
    folder.mkdir(exist_ok=True)
    names = sp.list_mechanisms()
    for path in folder.glob("*.md"):
        if path.stem not in names:
            path.unlink()
    for name in names:
        path, text = folder / f"{name}.md", page(docs, name)
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


class LibraryCards(SphinxDirective):
    """A card for each mechanism of the library, with a link to its page."""

    def run(self) -> list[nodes.Node]:
        """Return the grid's nodes."""
        lines = ["::::{grid} 2 2 3 3", ":gutter: 2", ""]
        for name in sp.list_mechanisms():
            shown = picture(Path(self.env.srcdir), name)
            lines += [f":::{{grid-item-card}} {name}", f":link: {FOLDER}/{name}",
                      ":link-type: doc", *([f":img-top: {shown}"] if shown else []), "",
                      sp.load(name).title, ":::", ""]
        return self.parse_text_to_nodes("\n".join([*lines, "::::"]))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register it with Sphinx."""
    app.connect("builder-inited", write_pages)
    app.add_directive("library-cards", LibraryCards)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
