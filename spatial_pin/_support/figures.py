"""A matplotlib figure that shows itself in a notebook, without pyplot and without any magic.

Only what draws imports this module, when it draws: matplotlib is slow to import.
"""

from __future__ import annotations

import io
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

NOTEBOOK_DPI = 100  # as wide as a notebook's cell, and small in its file


class ShownFigure(Figure):
    """A figure that belongs to no window: the last value of a cell is its picture."""

    def __init__(self, **options: Any) -> None:
        super().__init__(dpi=150, layout="constrained", **options)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        """Return the picture, for a notebook."""
        content = io.BytesIO()
        self.savefig(content, format="png", dpi=NOTEBOOK_DPI)
        return content.getvalue()
