"""The command `spatial-pin`."""

from spatial_pin.cli.running import main

__all__ = ["main"]
