"""The equations of motion in one, in some, or in all coordinates."""
