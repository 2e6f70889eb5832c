"""From where a frame should be to where the drivers must be."""

from spatial_pin.inverse_kinematics import targets

__all__ = ["targets"]
