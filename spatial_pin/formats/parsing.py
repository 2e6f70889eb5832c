"""XML and TOML text to elements and tables; texts that make their parsers hang are refused.

XML is nested no deeper than robots are, and may have prefixes that nobody declares; TOML could
take hours and gigabytes.
"""

from __future__ import annotations

import json
import re
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any
from xml.parsers.expat import errors

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import shown

DEEPEST_ELEMENT = 100  # elements within one another; URDF readers take 100 or 500 and then print
UNBOUND = errors.codes[errors.XML_ERROR_UNBOUND_PREFIX]
_PREFIX = re.compile(r"[<\s]/?([A-Za-z_][\w.-]*):[A-Za-z_]")  # of an element, attribute or text
_DECLARED = re.compile(r"\sxmlns:([A-Za-z_][\w.-]*)\s*=")
PROLOGUE = r"\s*+(?>(?:<!--.*?-->|<\?.*?\?>|<![A-Z][^>]*>)\s*)*+"  # each part tried once
ROOT = re.compile(PROLOGUE + r"<[A-Za-z_][\w.-]*", re.S)
DEEPEST_KEY = 8  # names in a key; a mechanism file needs three
_TEXTS = re.compile(  # texts and comments, in which dots mean nothing
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|(#)[^\n]*', re.S)
_LONG_KEY = re.compile(rf"(?<![\w-])[\w-]++(?:[ \t]*+\.[ \t]*+[\w-]++){{{DEEPEST_KEY}}}")


def parse_xml(text: str, path: Path) -> ET.Element:
    """Return the root element of XML text."""
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
    """Return text without the parts from `begin` to the next `end`; line breaks in them stay."""
    parts, at, start = [], 0, text.find(begin)
    while start >= 0 and (stop := text.find(end, start + len(begin))) >= 0:
        parts += [text[at:start], "\n" * text.count("\n", start, stop)]
        at = stop + len(end)
        start = text.find(begin, at)
    return "".join([*parts, text[at:]])


def parse_urdf(text: str, path: Path) -> ET.Element:
    """Return the root element of URDF text; names lose a namespace of all of URDF."""
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


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """Return the tables of TOML text; `path` is where it comes from."""
    long = _LONG_KEY.search(_TEXTS.sub(lambda digits: "" if digits[1] else "_", text))
    if long:
        raise MechanismFileError(f"{shown(path)}: a key of more than {DEEPEST_KEY} names: "
                                 f"{long[0][:40]}...; a mechanism file has at most three")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise MechanismFileError(f"{shown(path)}: lists or tables are nested too deeply") from error
    except tomllib.TOMLDecodeError as error:
        raise MechanismFileError(f"{shown(path)}: not valid TOML: {str(error)[:300]}") from error
    except ValueError as error:  # Python reads no numbers of thousands of digits
        digits = re.search(r"\d{1000}", text.replace("_", ""))
        lines = text.replace("_", "")[:digits.start() if digits else 0].splitlines() or [""]
        key = lines[-1].partition("=")[0].strip()[:40]
        raise MechanismFileError(
            f"{shown(path)}: line {len(lines)}: {key}: a whole number of thousands of digits; "
            "numbers end at 1e308") from error


def toml_text(content: dict[str, Any], prefix: str = "") -> str:
    """Return TOML text of tables, arrays of tables and plain values, as mechanism files use."""
    plain = {k: v for k, v in content.items() if not _is_table(v)}
    lines = [f"{_key(k)} = {_value(v)}" for k, v in plain.items()]
    for key, value in content.items():
        name = f"{prefix}{_key(key)}"
        if isinstance(value, dict):
            inner_is_tables = value and all(isinstance(v, dict) for v in value.values())
            head = [] if inner_is_tables else ["", f"[{name}]"]
            lines += [*head, toml_text(value, f"{name}.").rstrip("\n")]
        elif _is_table(value):
            for item in value:
                lines += ["", f"[[{name}]]", toml_text(item, f"{name}.").rstrip("\n")]
    return "\n".join(lines) + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and all(isinstance(v, dict) for v in value)
    )


def _key(key: str) -> str:
    bare = key and all(c.isascii() and (c.isalnum() or c in "_-") for c in key)
    return key if bare else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    return repr(value)
