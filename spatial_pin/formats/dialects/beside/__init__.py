"""Loops that are stated in a file beside the URDF."""
