"""Dimensional synthesis: dimensions with which a mechanism does what is asked of it."""
