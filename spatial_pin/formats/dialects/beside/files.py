"""Files beside a URDF that state its loops: where they lie, and their text."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.sources import shown


def table_of(path: Path) -> dict[str, Any]:
    """Return the table that a YAML file holds; an empty one where it holds something else.

    Raises:
        MechanismFileError: it cannot be read.
    """
    from spatial_pin.formats.xacro.yaml_files import read_yaml  # on use: yaml takes 20 ms to import

    content = read_yaml(path, float)
    return content if isinstance(content, dict) else {}


def lists_of(table: dict[str, Any], keys: tuple[str, ...], names: tuple[str, ...],
             path: Path) -> dict[str, list[Any]]:
    """Return the lists of a table, empty where a key is missing.

    Args:
        table: what the file says.
        keys: of the lists that it may have.
        names: those of them that are lists of names.
        path: of the file.

    Raises:
        MechanismFileError: one is no list, or not of names, or there is another key.
    """
    for key, value in table.items():
        if key not in keys:
            raise MechanismFileError(f"{shown(path)}: {str(key)[:60]} is not a key of such a file; "
                                     f"there are: {', '.join(keys)}")
        if value is not None and not isinstance(value, list):
            raise MechanismFileError(f"{shown(path)}: {key} must be a list")
        if key in names and not all(isinstance(name, str) for name in value or ()):
            raise MechanismFileError(f"{shown(path)}: {key} must be a list of names")
    return {key: table.get(key) or [] for key in keys}
