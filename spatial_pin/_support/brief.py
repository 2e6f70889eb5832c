"""Short words for results: arrays by their shapes, numbers with units, long lists by length."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

ONE_BY_ONE = 6  # numbers that are shown one by one: a wrench
LONGEST_TEXT = 60  # characters of a text that are shown
MOST_SHOWN = 4  # entries of a mapping, or of a list of plain values, that are shown


def brief(shown: object, **units: str) -> str:
    """Return a result as `Name(field=value unit, ...)`, in a line or two.

    Args:
        shown: a dataclass or named tuple.
        units: units of its fields by their names; of others nothing is known, or they have none.
    """
    names: Iterable[str] = getattr(shown, "_fields", getattr(shown, "__dataclass_fields__", ()))
    fields = [f"{name}={words(getattr(shown, name), units.get(name, ''))}"
              for name in names if not name.startswith("_")]
    return f"{type(shown).__name__}({', '.join(fields)})"


def counted(number: int, noun: str) -> str:
    """Return "1 loop", "2 loops"."""
    return f"{number} {noun}{'s' * (number != 1)}"


def first_names(names: Iterable[str]) -> str:
    """Return the first of many names, and how many there are besides."""
    every = list(names)
    return ", ".join(every[:MOST_SHOWN]) + _rest(every) if every else "none"


def words(value: Any, unit: str = "") -> str:
    """Return a value in a few words, with its unit."""
    text = _words(value)
    return f"{text} {unit}" if unit and value is not None else text


def _words(value: Any) -> str:
    if isinstance(value, np.ndarray):
        plain = value.ndim == 1 and value.size <= ONE_BY_ONE and value.dtype.kind in "fiu"
        return f"[{', '.join(f'{x:.6g}' for x in value)}]" if plain else f"array {value.shape}"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        shown = [f"{key}: {_words(x)}" for key, x in list(value.items())[:MOST_SHOWN]]
        return f"{{{', '.join(shown)}{_rest(value)}}}"
    if isinstance(value, tuple | list) and not hasattr(value, "_fields"):
        plain_values = all(isinstance(x, str | int | float) for x in value[:MOST_SHOWN])
        if not plain_values:
            return f"{len(value)} of {type(value[0]).__name__}"
        return f"[{', '.join(map(_words, value[:MOST_SHOWN]))}{_rest(value)}]"
    text = repr(value)
    if len(text) <= LONGEST_TEXT and "\n" not in text:
        return text
    if isinstance(value, str):
        return f"{text[: LONGEST_TEXT - 4]}...{text[0]}"
    name = getattr(value, "name", "")
    return f"{type(value).__name__}({name!r})" if isinstance(name, str) and name else (
        f"<{type(value).__name__}>")


def _rest(values: Mapping[str, Any] | tuple[Any, ...] | list[Any]) -> str:
    more = len(values) - MOST_SHOWN
    return f", and {more} more" if more > 0 else ""
