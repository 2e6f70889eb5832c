"""Judging accuracy: problems with published answers."""
