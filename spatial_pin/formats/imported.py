"""What an importer is given, and what it gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Request:
    """What is to be read, and how.

    Attributes:
        path: the file, or the folder for formats that are one.
        parameters: values of xacro arguments [SI, rad]; other formats have none.
        trusted: whether the file may read files from anywhere, see `load`.
        packages: folders of ROS packages, by name, absolute; go before all others.
        model: which model of a file with several; None: its only one.
        without: names of elements and joints that are left out.
        free_flyer: whether a floating joint is put below the root of what is read.
        alone: whether no mechanism file with closures says more of it.
        complete: whether a mechanism file says all that there is beside links and joints.
        expanded: what the xacro file of its tree expands to, where that is known.
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


@dataclass(frozen=True)
class Imported:
    """An open tree and all that a file says beside it.

    Attributes:
        urdf: the open tree as plain URDF text, files of meshes by absolute paths.
        content: what a mechanism file would say beside it, as `tomllib` reads one; `name` and
            `tree` may be left out.
        notices: what was changed or left out in reading, a sentence each; `load` warns of them.
    """

    urdf: str
    content: Mapping[str, Any] = field(default_factory=dict)
    notices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Importer:
    """A file format.

    Attributes:
        title: the format's name, for messages.
        suffixes: endings of the names of its files, lower case, with the dot.
        recognises: whether a file (or folder) with one of these endings is one of it; it reads no
            more than it must. A folder has the ending "/".
        read: reads one; raises `MechanismFileError` where it cannot be used.
        has_models: whether a file of it may hold several models, of which `load` takes one.
    """

    title: str
    suffixes: tuple[str, ...]
    recognises: Callable[[Path], bool]
    read: Callable[[Request], Imported]
    has_models: bool = False


def on_use(module: str) -> Callable[[Request], Imported]:
    """Return the function `read` of a module of formats, imported when a file is read."""
    return lambda request: import_module(f"spatial_pin.formats.{module}").read(request)
