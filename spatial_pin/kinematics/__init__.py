"""Closing mechanisms and moving them."""
