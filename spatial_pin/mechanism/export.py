"""The old module of `export_urdf`, which users import; see `formats.mechanism_writer`."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any


def export_urdf(mechanism: Any, path: str | Path) -> list[Path]:
    """Write the open tree as plain URDF, see `spatial_pin.formats.mechanism_writer.export_urdf`."""
    return import_module("spatial_pin.formats.mechanism_writer").export_urdf(mechanism, path)
