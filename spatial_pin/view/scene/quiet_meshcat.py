"""Meshcat, imported without the warning that its import of a deprecated part of zmq gives."""

import warnings

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat
    import meshcat.geometry as mg

__all__ = ["meshcat", "mg"]
