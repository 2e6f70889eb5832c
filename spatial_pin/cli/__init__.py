"""The command `spatial-pin`."""

from spatial_pin.cli.commands import main

__all__ = ["main"]
