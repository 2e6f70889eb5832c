"""Importers: their request and result, the table of formats, and the format of a file."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import Trust, check_file, parse_urdf, shown
from spatial_pin.mechanism.mechanism import Mechanism

FOLDER = "/"  # the ending of a folder's name
NONE: Mapping[str, float] = MappingProxyType({})
NAMED_FAULTS = 3  # of one kind in a warning: enough to see what they have in common


@dataclass(frozen=True)
class Request:
    """A file to read, with the options of `load`.

    Attributes:
        path: the file, or the folder for formats that are one.
        parameters: values of xacro arguments [SI, rad]; other formats have none.
        trusted: whether the file may read files from anywhere, see `load`.
        packages: folders of ROS packages, by name, absolute; go before all others.
        model: which model of a file with several; None: its only one.
        without: names of elements and joints that are left out.
        free_flyer: whether a floating joint is put below the root link.
        alone: whether no mechanism file adds closures.
        complete: whether a mechanism file has everything beside links and joints.
        expanded: expanded text of the xacro file of its tree, where that is known.
    """

    path: Path
    parameters: Mapping[str, float] = field(default_factory=dict)
    trusted: bool = False
    packages: Mapping[str, Path] = field(default_factory=dict)
    model: str | None = None
    without: tuple[str, ...] = ()
    free_flyer: bool = False
    alone: bool = True
    complete: bool = False
    expanded: str | None = None

    @staticmethod
    def of(mechanism: Mechanism, path: Path, parameters: Mapping[str, float] = NONE) -> Request:
        """Return the request for a file of a mechanism, with other values of some parameters."""
        return Request(path, {**mechanism.parameters, **parameters}, mechanism.trusted,
                       dict(mechanism.packages))

    @property
    def trust(self) -> Trust:
        """Which files the file may name."""
        return Trust.of(self.path, self.packages, self.trusted)


@dataclass(frozen=True)
class Imported:
    """An open tree and the further content of its file.

    Attributes:
        urdf: the open tree as a plain URDF, its text or its <robot>; meshes by absolute paths.
        content: the other keys of a mechanism file, as `tomllib` reads them; `name` and
            `tree` may be left out.
        notices: of changes and omissions in reading, a sentence each; `load` warns of them.
    """

    urdf: str | ET.Element
    content: Mapping[str, Any] = field(default_factory=dict)
    notices: tuple[str, ...] = ()

    def robot(self, path: Path) -> ET.Element:
        """Return the <robot> of the open tree; `path` is where it comes from."""
        return parse_urdf(self.urdf, path) if isinstance(self.urdf, str) else self.urdf


class Faults:
    """Faults of a file that can be read, by kind."""

    def __init__(self) -> None:
        self._named: dict[str, list[str]] = {}

    def note(self, kind: str, what: str = "") -> None:
        """Note a fault and its treatment; `what` is the link, joint or file that has it, if any."""
        named = self._named.setdefault(kind, [])
        if what and what not in named:
            named.append(what)

    def notices(self, most: int | None = None) -> tuple[str, ...]:
        """Return a sentence for each kind, with all its faults or the first few."""
        sentences = []
        for kind, names in self._named.items():
            named = ", ".join(names[:most])
            rest = len(names) - len(names[:most])
            more = f" and {rest} more" if rest else ""
            sentences.append(f"{named}{more}: {kind}" if names else kind)
        return tuple(sentences)

    def summary(self) -> str:
        """Return one line for a warning, "" where nothing is wrong."""
        notices = self.notices(NAMED_FAULTS)
        if len(notices) < 2:
            return "".join(notices)
        return "; ".join(f"({k}) {notice}" for k, notice in enumerate(notices, start=1))


@dataclass(frozen=True)
class Importer:
    """A file format.

    Attributes:
        title: the format's name, for messages.
        suffixes: endings of the names of its files, lower case, with the dot.
        recognises: whether a file (or folder) with one of these endings is one of it; it reads no
            more than it must. A folder has the ending "/".
        read: reads one; raises `MechanismFileError` where it cannot be used.
        has_models: whether a file may hold several models; `load` takes one.
    """

    title: str
    suffixes: tuple[str, ...]
    recognises: Callable[[Path], bool]
    read: Callable[[Request], Imported]
    has_models: bool = False


def on_use(module: str, name: str = "read") -> Callable[[Any], Any]:
    """Return a function of a module of formats, which is imported when it is first called."""
    return lambda given: getattr(import_module(f"spatial_pin.formats.{module}"), name)(given)


IMPORTERS: dict[str, Importer] = {
    "urdf": Importer("URDF or xacro", (".urdf", ".xacro", ".xml"),
                     on_use("urdf_importer", "is_urdf"), on_use("urdf_importer", "read_urdf")),
    "sdf": Importer("SDFormat", (".sdf", ".world"), lambda path: True, on_use("sdf.sdf_reader"),
                    has_models=True),
    "usd": Importer("USD", (".usd", ".usda", ".usdc", ".usdz"), lambda path: True, on_use("usd")),
    "mjcf": Importer("MJCF", (".xml", ".mjcf"), on_use("mjcf.compiling", "is_mjcf"),
                     on_use("mjcf.mjcf_reader")),
    "folder": Importer("a folder with a URDF", (FOLDER,), on_use("urdf_importer", "has_urdf"),
                       on_use("urdf_importer", "read_folder")),
    "statement": Importer("robot.yaml or loop_closures.yaml beside a URDF", (".yaml", ".yml"),
                          on_use("urdf_importer", "is_statement"),
                          on_use("urdf_importer", "read_statement")),
}


def endings() -> tuple[str, ...]:
    """Return the endings of all files that are read, a mechanism file's first."""
    known = [s for importer in IMPORTERS.values() for s in importer.suffixes if s != FOLDER]
    return tuple(dict.fromkeys([".toml", *known]))


def importer_of(path: Path) -> Importer | None:
    """Return the importer that reads a file or folder; None where its name ends as none does."""
    # os.path, unlike Path.is_dir, is false for names that are too long
    ending = FOLDER if os.path.isdir(path) else path.suffix.lower()
    candidates = [x for x in IMPORTERS.values() if ending in x.suffixes]
    if not candidates:
        return None
    if ending != FOLDER:
        check_file(path)
    for importer in candidates:
        if importer.recognises(path):
            return importer
    if ending == FOLDER:
        raise MechanismFileError(f"{shown(path)}: there is no URDF in this folder; "
                                 "load a file by its own path")
    raise MechanismFileError(f"{shown(path)}: none of: {', '.join(x.title for x in candidates)}")
