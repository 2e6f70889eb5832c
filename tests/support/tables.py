"""Tables that motions and commands write."""

import csv
from pathlib import Path

import numpy as np


def columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a table of numbers by their heads."""
    with path.open(encoding="utf-8") as file:
        heads, *rows = csv.reader(file)
    return dict(zip(heads, np.array(rows, dtype=float).T, strict=True))
