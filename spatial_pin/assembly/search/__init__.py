"""Searching for the closed configuration that a guess means."""
