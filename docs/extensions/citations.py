"""Citations such as [Haug1989, 9.4] lead to their entry in the bibliography, on every page."""

from __future__ import annotations

import re

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

LISTED = "bibliography"
KEY = r"[A-Z][A-Za-z]+\d{4}|Pham"
CITATION = re.compile(rf"(?<=[\[;,] )(?:{KEY})\b|(?<=\[)(?:{KEY})\b")
PLAIN = (nodes.literal, nodes.literal_block, nodes.reference, nodes.title, pending_xref)


def label_of(key: str) -> str:
    """Return the name of an entry's anchor."""
    return f"source-{key.lower()}"


class Citations(SphinxTransform):
    """Give the entries of the bibliography anchors, and link to them what cites them."""

    default_priority = 510

    def apply(self, **options: object) -> None:
        """Do so for one page."""
        if self.env.docname == LISTED:
            self.put_anchors()
            return
        for text in list(self.document.findall(nodes.Text)):
            inside = text.parent
            while inside is not None and not isinstance(inside, PLAIN):
                inside = inside.parent
            if inside is None and CITATION.search(text):
                text.parent.replace(text, self.linked(text))

    def put_anchors(self) -> None:
        """Give every entry an anchor of its own."""
        labels = self.env.get_domain("std").anonlabels
        for entry in self.document.findall(nodes.list_item):
            match = re.match(rf"\[({KEY})\]", entry.astext())
            if match is not None:
                name = label_of(match[1])
                entry["ids"].append(name)
                labels[name] = LISTED, name

    def linked(self, text: nodes.Text) -> list[nodes.Node]:
        """Return the text in parts, keys in links."""
        parts, done = [], 0
        for match in CITATION.finditer(text):
            link = pending_xref(refdomain="std", reftype="ref", reftarget=label_of(match[0]),
                                refexplicit=True, refwarn=True, refdoc=self.env.docname)
            link += nodes.inline(match[0], match[0])
            parts += [nodes.Text(text[done:match.start()]), link]
            done = match.end()
        return [*parts, nodes.Text(text[done:])]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register it with Sphinx."""
    app.add_transform(Citations)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
