"""The table of formats, and which of them a file is in."""

from __future__ import annotations

import os
from pathlib import Path

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats import folder, urdf_importer, usd
from spatial_pin.formats.imported import Importer, on_use
from spatial_pin.formats.mjcf.compiling import is_mjcf
from spatial_pin.formats.sources import check_file, shown

FOLDER = "/"  # the ending of a folder's name

IMPORTERS: dict[str, Importer] = {
    "urdf": urdf_importer.IMPORTER,
    "sdf": Importer("SDFormat", (".sdf", ".world"), lambda path: True, on_use("sdf.reading"),
                    has_models=True),
    "usd": usd.IMPORTER,
    "mjcf": Importer("MJCF", (".xml", ".mjcf"), is_mjcf, on_use("mjcf.reading")),
    "folder": folder.FOLDER,
    "statement": folder.STATEMENT,
}


def endings() -> tuple[str, ...]:
    """Return the endings of all files that are read, a mechanism file's first."""
    known = [s for importer in IMPORTERS.values() for s in importer.suffixes if s != FOLDER]
    return tuple(dict.fromkeys([".toml", *known]))


def importer_of(path: Path) -> Importer | None:
    """Return the importer that reads a file or folder; None where its name ends as none does.

    Raises:
        MechanismFileError: the file is not there, or is in none of the formats of its ending.
    """
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
