"""Names in docstrings and signatures link to the pages of the public names.

A signature names a class as its module does (`State`, `motion.motion.Motion`). Readers know it as
`spatial_pin.State`. Types of other packages (`pin.SE3`, `np.ndarray`) and inner types have no page
here: they stay plain text in signatures. A name that a page of prose refers to must exist.

Docstrings have names and code in single backticks. Those of public names become links, the others
code; so do they on the other pages (`sp.sweep`). Attributes stand in the docstring of their class:
fields of tuples are listed there only.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.domains.python import PyObject
from sphinx.environment import BuildEnvironment
from sphinx.transforms import SphinxTransform

import spatial_pin

REFERENCE = "reference/"
CODE = re.compile(r"sp\.(\w+)(\(.*\))?$")
MADE_BY_HAND = ("Accuracy", "Look", "Output", "Passive", "Spring", "Vectors")  # not by functions
SEVERAL = re.compile(r"^(:(?:ivar|param) [^:]*):")  # fields that are described together
ARRAY = re.compile(r"~?(numpy\.)?ndarray\[tuple\[.*?\], ~?(numpy\.)?dtype\[~?(numpy\.)?floating"
                   r"(\[.*?\])?\]\]")
QUOTED = re.compile(r"(?<!`)`([^`]+)`(?!`)(\w?)")


def resolve(app: Sphinx, env: BuildEnvironment, node: pending_xref,
            text: nodes.TextElement) -> nodes.Node | None:
    """Return a link to the public name that a type is known by, or its plain text."""
    if node.get("refdomain") != "py":
        return None
    place, _, name = node["reftarget"].rpartition(".")
    if name in spatial_pin.__all__ and place.partition(".")[0] in ("", "spatial_pin"):
        domain: Any = env.get_domain("py")
        target = f"spatial_pin.{name}"
        if target in domain.objects:
            found = domain.objects[target]
            return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", target, node,
                                       text) if found else None
    return text if node.get("refdoc", "").startswith(REFERENCE) else None


def linked(match: re.Match) -> str:
    """Return reStructuredText of words in single backticks, with the letter that follows."""
    words, letter = match.groups()
    name = words.removeprefix("sp.").removeprefix("spatial_pin.")
    after = f"\\ {letter}" if letter else ""
    if name in spatial_pin.__all__:
        return f":py:obj:`{words} <spatial_pin.{name}>`{after}"
    return f"``{words}``{after}"


def link(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Change the backticks of a docstring; they may reach over the end of a line."""
    for k, line in enumerate(lines):  # else Sphinx takes the first name for a type
        lines[k] = SEVERAL.sub(lambda match: match[0].replace(", ", ",\u200b"), line)
    lines[:] = QUOTED.sub(linked, "\n".join(lines)).split("\n")


def shorten(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None,
    returned: str | None,
) -> tuple[str | None, str | None]:
    """Write arrays of floats as ndarray; leave out how results are made, which nobody makes."""
    made = "operators" in name or name.rpartition(".")[2] in MADE_BY_HAND
    if what in ("class", "exception") and not made:
        return signature and "", None
    short = [ARRAY.sub("ndarray", text) if text else text for text in (signature, returned)]
    return short[0], short[1]


def left_out(
    app: Sphinx, what: str, name: str, obj: Any, skip: bool, options: Any
) -> bool | None:
    """Leave out fields of tuples, which Python documents as "Alias for field number N"."""
    return True if (getattr(obj, "__doc__", "") or "").startswith("Alias for field") else None


class LinkedCode(SphinxTransform):
    """Code such as `sp.sweep` or `sp.sweep(...)` on a page of prose is a link."""

    default_priority = 500

    def apply(self, **options: Any) -> None:
        """Put every such piece of code into a reference."""
        if self.env.docname.startswith(REFERENCE):
            return
        for code in list(self.document.findall(nodes.literal)):
            match = CODE.match(code.astext())
            inside = isinstance(code.parent, nodes.reference | nodes.title | pending_xref)
            if match is None or inside or match[1] not in spatial_pin.__all__:
                continue
            link = pending_xref(refdomain="py", reftype="obj", reftarget=f"spatial_pin.{match[1]}",
                                refdoc=self.env.docname, refexplicit=True, refwarn=False)
            code.replace_self(link)
            link += code


def setup(app: Sphinx) -> dict[str, bool]:
    """Register it with Sphinx."""
    for field in PyObject.doc_field_types:
        if field.name == "variable":  # attributes: no links to attributes of that name elsewhere
            field.label, field.rolename = "Attributes", ""
    app.connect("autodoc-skip-member", left_out)
    app.add_transform(LinkedCode)
    app.connect("missing-reference", resolve)
    app.connect("autodoc-process-docstring", link)
    app.connect("autodoc-process-signature", shorten)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
