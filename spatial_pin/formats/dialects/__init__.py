"""Loops and motors that are stated inside a URDF, or beside it, in other people's ways."""
