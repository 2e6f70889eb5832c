"""A simulation under way: from step to step, and from coordinates to others."""
