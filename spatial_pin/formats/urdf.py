"""URDF and xacro: an open tree."""

from __future__ import annotations

from pathlib import Path

from spatial_pin.formats.imported import Imported, Importer, Request
from spatial_pin.mechanism.xacro_files import expand


def is_urdf(path: Path) -> bool:
    """Return whether a file is one; its name says so."""
    return True


def read_urdf(request: Request) -> Imported:
    """Read a URDF or xacro file.

    Raises:
        MechanismFileError: it cannot be read.
    """
    return Imported(expand(request.path, request.parameters, request.trusted))


IMPORTER = Importer("URDF or xacro", (".urdf", ".xacro"), is_urdf, read_urdf)
