"""Methods of data types that rooms above them work out.

A data type (Mechanism, Motion, what an analysis returns) imports no solver, no file format and no
view. What it offers as a method all the same stands in this table, which `spatial_pin/__init__.py`
fills: Python runs that file before any other of the package, so that the table is full whenever a
method is called. What does the work is imported when it is first asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from typing import Any

_TABLE: dict[str, str] = {}


def offer(works: Mapping[str, str]) -> None:
    """Fill the table: by "Class.method", "module:function"; the object is its first argument."""
    _TABLE.update(works)


@cache
def method(name: str) -> Callable[..., Any]:
    """Return what does the work of "Class.method"."""
    module, _, function = _TABLE[name].partition(":")
    return getattr(import_module(f"spatial_pin.{module}"), function)


def names() -> list[str]:
    """Return what is in the table."""
    return list(_TABLE)
