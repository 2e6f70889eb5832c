"""XML text to elements: nested no deeper than robots are, with prefixes that nobody declares."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers.expat import errors

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import shown

DEEPEST_ELEMENT = 100  # elements within one another; URDF readers take 100 or 500 and then print
UNBOUND = errors.codes[errors.XML_ERROR_UNBOUND_PREFIX]
_PREFIX = re.compile(r"[<\s]/?([A-Za-z_][\w.-]*):[A-Za-z_]")  # of an element, attribute or text
_DECLARED = re.compile(r"\sxmlns:([A-Za-z_][\w.-]*)\s*=")
PROLOGUE = r"\s*+(?>(?:<!--.*?-->|<\?.*?\?>|<![A-Z][^>]*>)\s*)*+"  # each part tried once
ROOT = re.compile(PROLOGUE + r"<[A-Za-z_][\w.-]*", re.S)


def parse_xml(text: str, path: Path) -> ET.Element:
    """Return the root element of XML text.

    Raises:
        MechanismFileError: it is not well-formed, or too deep; `path` is where it comes from.
    """
    try:
        root = _parsed(text)
    except (ET.ParseError, ValueError) as error:
        raise MechanismFileError(f"{shown(path)}: not well-formed XML: {error}") from error
    level, depth = [root], 0
    while level:
        level, depth = [child for element in level for child in element], depth + 1
        if depth > DEEPEST_ELEMENT:
            raise MechanismFileError(
                f"{shown(path)}: more than {DEEPEST_ELEMENT} elements within one another; "
                "URDF has ten")
    return root


def without(text: str, begin: str, end: str) -> str:
    """Return text without the parts from `begin` to the next `end`; line breaks in them stay.

    What has no end stays, too; unlike a regular expression, this looks for that end but once.
    """
    kept, at, start = [], 0, text.find(begin)
    while start >= 0 and (stop := text.find(end, start + len(begin))) >= 0:
        kept += [text[at:start], "\n" * text.count("\n", start, stop)]
        at = stop + len(end)
        start = text.find(begin, at)
    return "".join([*kept, text[at:]])


def parse_urdf(text: str, path: Path) -> ET.Element:
    """Return the root element of URDF text; a namespace of all of URDF is left out of its names.

    Raises:
        MechanismFileError: as `parse_xml`.
    """
    robot = parse_xml(text.lstrip(), path)
    if robot.tag.endswith("}robot"):
        namespace = robot.tag.removesuffix("robot")
        for element in robot.iter():
            element.tag = element.tag.removeprefix(namespace)
    return robot


def _parsed(text: str) -> ET.Element:
    """Return the root element; prefixes that nobody declares, as in many URDFs, are their names."""
    try:
        return ET.fromstring(text)
    except ET.ParseError as error:
        root = ROOT.match(text)
        if error.code != UNBOUND or root is None:
            raise
        declared = {"xml", "xmlns", *_DECLARED.findall(text)}
        unbound = dict.fromkeys(p for p in _PREFIX.findall(text) if p not in declared)
        names = "".join(f' xmlns:{prefix}="{prefix}"' for prefix in unbound)
        return ET.fromstring(text[:root.end()] + names + text[root.end():])
