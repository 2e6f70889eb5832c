"""Methods of data types that rooms above them work out.

A data type (Mechanism, Motion, what an analysis returns) imports no solver, no file format and no
view. What it offers as a method all the same stands in this table, which `spatial_pin/__init__.py`
fills: Python runs that file before any other of the package, so that the table is full whenever a
method is called.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Work = Callable[..., Any]
_TABLE: dict[str, Work] = {}


def offer(works: Mapping[str, Work]) -> None:
    """Fill the table: by "Class.method", what does the work; the object is its first argument."""
    _TABLE.update(works)


def method(name: str) -> Work:
    """Return what does the work of "Class.method"."""
    return _TABLE[name]
