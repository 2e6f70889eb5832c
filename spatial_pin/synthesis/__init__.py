"""Dimensional synthesis: from what a mechanism should do to its dimensions."""

from spatial_pin.synthesis import goals

__all__ = ["goals"]
