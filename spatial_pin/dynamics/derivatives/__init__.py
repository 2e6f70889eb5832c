"""Derivatives of the constrained dynamics."""
