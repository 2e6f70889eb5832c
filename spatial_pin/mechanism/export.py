"""Writing a mechanism as plain URDF, under the name that scripts know: see `formats.export`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from spatial_pin.methods import method


def export_urdf(mechanism: Any, path: str | Path) -> list[Path]:
    """Write the open tree as plain URDF, see `spatial_pin.formats.export.export_urdf`."""
    written: list[Path] = method("Mechanism.export_urdf")(mechanism, path)
    return written
