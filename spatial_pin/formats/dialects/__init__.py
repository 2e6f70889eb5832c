"""Loops and motors that are stated inside a URDF, or beside it, in other people's ways."""

from spatial_pin.formats.dialects.registry import ELEMENTS, read_dialects
from spatial_pin.formats.dialects.robot import RobotReading

__all__ = ["ELEMENTS", "RobotReading", "read_dialects"]
