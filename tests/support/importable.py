"""What the package can import: its importers, and the ways of stating loops in or beside a URDF."""

from spatial_pin.formats.dialects.table import BESIDE, ELEMENTS, LEFT
from spatial_pin.formats.table import IMPORTERS

__all__ = ["BESIDE", "ELEMENTS", "IMPORTERS", "LEFT"]
