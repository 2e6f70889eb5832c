"""Loops and motors that are stated inside a URDF, or beside it, in other people's ways."""

from spatial_pin.formats.dialects.reading import Reading
from spatial_pin.formats.dialects.table import ELEMENTS, read_dialects

__all__ = ["ELEMENTS", "Reading", "read_dialects"]
