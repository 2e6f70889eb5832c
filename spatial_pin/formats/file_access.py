"""Where the files of a mechanism lie, their text, and its XML elements and TOML tables.

Texts that make parsers hang are refused: XML is nested no deeper than robots are, and may have
prefixes that nobody declares; TOML could take hours and gigabytes.
"""

from __future__ import annotations

import json
import os
import re
import stat
import sys
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.parsers.expat import errors

from spatial_pin._support.lazy import cached_property
from spatial_pin.errors import MechanismFileError

if sys.platform == "win32":
    from pathlib import WindowsPath as PlainPath
else:
    from pathlib import PosixPath as PlainPath

LARGEST_FILE = 100_000_000  # bytes of text: a hundred times the largest robots there are
LIBRARY = "spatial_pin"  # the package that holds the library: `$(find spatial_pin)/parts.xacro`
MANIFEST = "package.xml"
OF_PACKAGES = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
OF_MODELS = ("GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "SDF_PATH")  # where Gazebo's models lie
NO_PACKAGES: Mapping[str, Path] = MappingProxyType({})
REMEDY = "sp.load(..., trusted=True) reads it all the same"
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


class HeldFile(PlainPath):
    """A path whose file is in memory, its `text`; a path that is made from it has none."""

    text: str | None = None

    @classmethod
    def of(cls, path: Path | str, text: str) -> HeldFile:
        """Return a file of that path and text."""
        made = cls(path)
        made.text = text
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return (HeldFile.of, (str(self), self.text)) if self.text is not None else (
            Path, (str(self),))

    def is_file(self) -> bool:
        """Whether there is such a file, here or in memory."""
        return self.text is not None or super().is_file()

    def read_bytes(self) -> bytes:
        """Return the text as UTF-8."""
        return super().read_bytes() if self.text is None else self.text.encode()

    def read_text(self, *args: Any, **kwargs: Any) -> str:
        """Return the text."""
        return super().read_text(*args, **kwargs) if self.text is None else self.text


def is_held(path: Path | None) -> bool:
    """Whether a file is in memory."""
    return isinstance(path, HeldFile) and path.text is not None


def shown(path: Path | str) -> str:
    """Return a path for a message: printable, and not longer than anybody reads."""
    text = str(path)
    if not text.isprintable():
        text = repr(text)[1:-1]
    return text if len(text) <= 200 else f"{text[:120]}...{text[-60:]}"


def check_file(path: Path) -> None:
    """Refuse a path that is no plain file."""
    if is_held(path):
        return
    try:
        status = path.stat()
    except FileNotFoundError:
        raise MechanismFileError(f"{shown(path)}: no such file") from None
    except (OSError, ValueError) as error:  # too long a name, no permission, a loop of links, NUL
        raise MechanismFileError(f"{shown(path)}: {_reason(error)}") from error
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, socket or device"
        raise MechanismFileError(f"{shown(path)} is {kind}, not a file")
    if status.st_size > LARGEST_FILE:
        raise MechanismFileError(f"{shown(path)}: {status.st_size:,} bytes; a file of a mechanism "
                                 f"has at most {LARGEST_FILE:,}")


def _reason(error: Exception) -> str:
    return (getattr(error, "strerror", None) or str(error)).lower()


def is_file(path: Path) -> bool:
    """Return whether there is a plain file."""
    return os.path.isfile(path)  # unlike Path.is_file, false for names that are too long


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file."""
    check_file(path)
    try:
        return path.read_text(encoding="utf-8").removeprefix("\ufeff")  # the mark of its order
    except UnicodeDecodeError as error:
        raise MechanismFileError(f"{shown(path)}: not UTF-8 text: {error}") from error
    except OSError as error:
        raise MechanismFileError(f"{shown(path)}: {_reason(error)}") from error


def library_folder() -> Path:
    """Return the folder of the mechanisms that come with the library."""
    package = Path(__file__).resolve().parent.parent
    shipped = package / "urdf"
    return shipped if shipped.is_dir() else package.parent / "urdf"


def package_folders(name: str, folder: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    """Yield the folders that may be the ROS package, or Gazebo's model, of that name.

    The surest goes first: `packages` that `load` was given, then what is round the `folder` of the
    file that asks.
    """
    if not name or Path(name).name != name:
        return
    if name in packages:
        yield packages[name]
    if name == LIBRARY:
        yield library_folder()
    for root in (*_listed("ROS_PACKAGE_PATH"),
                 *(prefix / "share" for prefix in _listed("AMENT_PREFIX_PATH")),
                 *(root for variable in OF_MODELS for root in _listed(variable))):
        yield root / name
        if root.name == name:
            yield root
    for parent in (folder, *folder.parents):
        if parent.name == name or _manifest_name(parent) == name:
            yield parent
        yield parent / name
    for site in dict.fromkeys(sys.path):  # where Python packages install robots' data
        yield Path(site) / "cmeel.prefix" / "share" / name
    yield Path(sys.prefix) / "share" / name


def _listed(variable: str) -> list[Path]:
    return [Path(p) for p in os.environ.get(variable, "").split(os.pathsep) if p]


def _manifest_name(folder: Path) -> str:
    """Return the name that a folder's manifest gives it, "" where it has none."""
    manifest = folder / MANIFEST
    if not is_file(manifest):
        return ""
    try:
        match = re.search(r"<name>\s*([\w.-]+)\s*</name>", read_text(manifest))
    except MechanismFileError:
        return ""
    return match[1] if match else ""


@dataclass(frozen=True)
class Trust:
    """The one rule for every file that a file of a mechanism names.

    It is a plain file of bearable size. It lies, links followed, below the folder of the file that
    `load` reads the tree from, or in a package; if the user trusts the file, anywhere. Whoever
    reads a file asks here before anything opens it.

    Attributes:
        home: the folder, resolved.
        packages: folders of packages, by name, as `load` was given them.
        trusted: whether the user trusts the file.
    """

    home: Path
    packages: Mapping[str, Path] = field(default_factory=dict)
    trusted: bool = False

    @classmethod
    def of(
        cls, file: Path, packages: Mapping[str, Path] = NO_PACKAGES, trusted: bool = False
    ) -> Trust:
        """Return the rule for files that a file, or the files of a folder, may name."""
        folder = file if os.path.isdir(file) else file.parent
        return cls(folder.resolve(), packages, trusted)

    @cached_property
    def _installed(self) -> list[Path]:
        """The library, and folders that hold packages or are named as one, resolved."""
        listed = (root for variable in (*OF_PACKAGES, *OF_MODELS) for root in _listed(variable))
        return [root.resolve() for root in (
            library_folder(), Path(__file__).parent, *listed, *self.packages.values())]

    def resolved(self, name: Path | str) -> Path:
        """Return where a file lies that may be read if it is there."""
        try:
            path = Path(name).resolve()
        except (OSError, ValueError, RuntimeError) as error:  # too long a name, a loop of links
            raise MechanismFileError(f"{shown(name)}: {error}") from error
        folders = path.parents
        if not (self.trusted or path.is_relative_to(self.home)
                or any(root in folders for root in self._installed)
                or any(is_file(folder / MANIFEST) for folder in folders)):
            raise MechanismFileError(f"{shown(name)} lies neither below {shown(self.home)} nor in "
                                     f"an installed package; {REMEDY}")
        return path

    def checked(self, name: Path | str) -> Path:
        """Return where a file lies that may be read; refuse one elsewhere, missing or no file."""
        path = self.resolved(name)
        check_file(path)
        return path

    def allows(self, name: Path | str) -> bool:
        """Return whether there is a file of that name which may be read."""
        try:
            self.checked(name)
        except MechanismFileError:
            return False
        return True


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


def texts_in(value: Any) -> Iterator[str]:
    """Yield all texts in tables, lists and texts."""
    waiting = [value]
    while waiting:
        element = waiting.pop()
        if isinstance(element, str):
            yield element
        elif isinstance(element, dict | list | tuple):
            waiting += element.values() if isinstance(element, dict) else element


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
