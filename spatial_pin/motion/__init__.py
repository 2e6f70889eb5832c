"""Motions, and the verbs that make one of a mechanism."""
