"""What a mechanism file says of a mechanism, as it is saved."""

import tempfile
import tomllib
from pathlib import Path
from typing import Any

import spatial_pin as sp


def content_of(mechanism: sp.Mechanism) -> dict[str, Any]:
    """Return the tables of the file that `save` writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(mechanism.save(folder))
        return tomllib.loads(path.read_text(encoding="utf-8"))
