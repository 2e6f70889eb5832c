"""Tables of a mechanism file, checked key by key for missing, misplaced and wrong values."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import Any, NoReturn

import numpy as np

from spatial_pin.errors import MechanismFileError, Mistakes, suggestion
from spatial_pin.formats.urdf.urdf_model import NUMBERS
from spatial_pin.mechanism.pairs import PAIRS, unit
from spatial_pin.numerics.linalg import Array

_REQUIRED: Any = object()
BETWEEN = "length_between"
TOP = "at the top of the file, before the first [table]"
BELONGS = {  # where in a file each key has its place
    TOP: ("name", "title", "source", "tree", "complete", "gravity", "gap", "order", "joints",
          "curves", "closures", "drivers", "springs", "passive", "frames", "masses", "guess",
          "bodies", "points", "rods", "gears", "dimensions", "keep", "density", "radius"),
    "in [joints.NAME]": ("type", "axis", "axis2", "lead", *NUMBERS, "between", "at"),
    "in [[closures]]": ("name", "type", "frames", "joints", *sorted(
        {"length", *(key.name for pair in PAIRS.values() for key in pair.keys)}, reverse=True),
        BETWEEN, "equations", "axis", "axis2", "lead", "source"),
    "in [curves.NAME]": ("circle", "ellipse", "line", "helix", "points", "table", "closed"),
    "in [drivers.NAME]": ("joint",),
    "in [[springs]]": ("name", "frames", "joint", "stiffness", "damping", "free_length",
                       "free_angle", "law", "tension_only", "compression_only", "preload"),
    "in [passive.NAME]": ("body", "axis"),
    "in [frames.NAME]": ("link", "xyz", "rpy"),
    "in [masses.NAME]": ("mass", "com", "inertia"),
    "in [bodies.NAME]": ("mass", "com", "inertia", "density"),
    "in [points.NAME]": ("body", "at"),
    "in [rods.NAME]": ("between",),
    "in [gears.NAME]": ("joints", "teeth", "internal"),
}
HEADINGS = {  # how what stands at the top of a file as tables is written
    "joints": "[joints.{name}]", "curves": "[curves.{name}]", "closures": "[[closures]]",
    "drivers": "[drivers.{name}]",
    "springs": "[[springs]]", "passive": "[passive.{name}]", "frames": "[frames.{name}]",
    "masses": "[masses.{name}]", "bodies": "[bodies.{name}]", "points": "[points.{name}]",
    "rods": "[rods.{name}]", "gears": "[gears.{name}]", "dimensions": "[dimensions]",
    "guess": "[guess]"}
SPRING = ("stiffness", "damping", "free_length", "free_angle")  # which no closure has
TWO_NAMES = ["?", "?"]
# What a table is read on with in the place of a value that is none.
STAND_INS: dict[str, dict[str, Any]] = {
    "in [joints.NAME]": {"axis": [0, 0, 1], "axis2": [0, 0, 1], "lead": 1.0},
    "in [[closures]]": {
        "name": "?", "frames": TWO_NAMES, "joints": TWO_NAMES, BETWEEN: TWO_NAMES, "length": 1.0,
        "axis": [0, 0, 1], "axis2": [0, 0, 1], "lead": 1.0},
    "in [drivers.NAME]": {"joint": "?"},
    "in [[springs]]": {"name": "?", "frames": TWO_NAMES, "joint": "?"},
    "in [passive.NAME]": {"body": "?", "axis": TWO_NAMES},
    "in [frames.NAME]": {"link": "?"},
}
LONGEST_VALUE = 80  # letters of a value in a message: one line of a terminal


def key_hint(key: str, value: Any) -> str:
    """Return a hint where to write a misplaced key of the top of the file."""
    return heading(key, value) if key in HEADINGS else f"it belongs {TOP}"


def heading(key: str, value: Any, name: str = "NAME") -> str:
    """Return how to write a table, as text, from its key and value."""
    line = HEADINGS[key].format(name=name)
    if key != "drivers":
        return f"write {line} and its lines below"
    named = value[0] if isinstance(value, list) and value else value
    return f"write {line} and below it joint = {_shown(named)}".replace("'", '"')


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_finite(value: int | float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond float
        return False


def _shown(value: Any) -> str:
    """Return a value of the file for a message."""
    try:
        text = repr(value)
    except ValueError:  # Python does not write numbers of thousands of digits
        return "a number of thousands of digits"
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


class CheckedValues:
    """The values of a TOML table, read key by key; every complaint names file, table and key."""

    def __init__(self, content: dict[str, Any], where: str, section: str = TOP) -> None:
        self.content, self.where, self.section = content, where, section
        self.known: list[str] = []
        self._reported: list[str] = []  # keys that were complained of
        self._ended = False

    def __contains__(self, key: str) -> bool:
        self.known.append(key)
        return key in self.content

    def fail(self, key: str, complaint: str) -> NoReturn:
        """Raise the error for one key."""
        self._reported.append(key)
        raise MechanismFileError(f"{self.where}: {key} {complaint}")

    def end(self, key: str, complaint: str) -> NoReturn:
        """Raise the error for a key that the rest of the table depends on."""
        self._ended = True
        self.fail(key, complaint)

    def get(self, key: str, default: Any = _REQUIRED) -> Any:
        """Return a value as it is; a key with no default must be there."""
        self.known.append(key)
        if key not in self.content and default is _REQUIRED:
            unknown = [k for k in self.content
                       if k not in (*self.known, *BELONGS.get(self.section, ()))]
            near = [k for k in unknown if suggestion(k, [key]).startswith("did you mean")]
            self._reported += near[:1]
            hint = f" (there is an unknown key {near[0]!r})" if near else ""
            self.fail(key, f"is missing{hint}")
        return self.content.get(key, default)

    def text(self, key: str, default: Any = _REQUIRED) -> str:
        """Return a text, which is not empty where it must be there."""
        value = self.get(key, default)
        if not isinstance(value, str) or (default is _REQUIRED and not value):
            self.fail(key, f"must be text, not {_shown(value)}")
        return value

    def flag(self, key: str) -> bool:
        """Return true or false; false where there is no such key."""
        value = self.get(key, False)
        if not isinstance(value, bool):
            self.fail(key, f"must be true or false, not {_shown(value)}")
        return value

    def choice(
        self, key: str, valid: tuple[str, ...],
        hint: Callable[[str, Collection[str]], str] = suggestion,
    ) -> str:
        """Return one of a few texts; `hint` says what to write instead of another."""
        value = self.text(key)
        if value not in valid:
            self.end(key, f"is {_shown(value)}; {hint(value, valid) or suggestion(value, valid)}")
        return value

    def number(self, key: str, default: Any = _REQUIRED, least: float = -math.inf) -> float:
        """Return a finite number, no less than the least."""
        value = self.get(key, default)
        if not _is_number(value):
            self.fail(key, f"must be a number, not {_shown(value)}")
        if not _is_finite(value) or value < least:
            self.fail(key, f"is {_shown(value)}; it must be finite" +
                      (f" and at least {least:g}" if least > -math.inf else ""))
        return float(value)

    def numbers(self, key: str, least: float = -math.inf) -> Array:
        """One number, or a list of them."""
        value = self.get(key)
        if not isinstance(value, list):
            return np.array([self.number(key, least=least)])
        parts = [CheckedValues({key: x}, self.where).number(key, least=least) for x in value]
        if not parts:
            self.fail(key, "is an empty list")
        return np.array(parts)

    def bounds(self, key: str) -> Array:
        """One number, or a list of them; inf and -inf are none."""
        value = self.get(key)
        values = value if isinstance(value, list) else [value]
        for x in values:
            if not _is_number(x) or not (_is_finite(x) or x in (math.inf, -math.inf)):
                self.fail(key, f"must be a number, or a list of them, not {_shown(value)}")
        if not values:
            self.fail(key, "is an empty list")
        return np.array(values, dtype=float)

    def names(self, key: str) -> tuple[str, ...]:
        """A list of names, of any length; none where there is no such key."""
        value = self.get(key, [])
        if not (isinstance(value, list) and all(isinstance(x, str) for x in value)):
            self.fail(key, f"must be a list of names, not {_shown(value)}")
        return tuple(value)

    def vector(self, key: str) -> Array:
        """Return three numbers (3,)."""
        value = self.get(key)
        if not (isinstance(value, list) and len(value) == 3
                and all(_is_number(x) and _is_finite(x) for x in value)):
            self.fail(key, f"must be three finite numbers, not {_shown(value)}")
        return np.array(value, dtype=float)

    def axis(self, key: str) -> Array:
        """A direction; written with a few digits it is normalised, else refused."""
        value = self.vector(key)
        norm = math.hypot(*value)  # of numbers of any size
        if abs(norm - 1.0) > 1e-3:
            self.fail(key, f"has length {norm:.6g}; an axis is a unit vector")
        return unit(value)

    def some_names(self, key: str, count: int, or_more: bool = False) -> tuple[str, ...]:
        """Return a list of some texts, or more."""
        value = self.get(key)
        if not (isinstance(value, list) and all(isinstance(x, str) for x in value)
                and (len(value) == count or (or_more and len(value) > count))):
            some = {2: "two", 3: "three", 4: "four"}.get(count, str(count))
            more = " or more" * or_more
            self.fail(key, f"must be a list of {some}{more} names, not {_shown(value)}")
        return tuple(value)

    def two_names(self, key: str) -> tuple[str, str]:
        """Return a list of two texts."""
        first, second = self.some_names(key, 2)
        return first, second

    def indices(self, key: str, count: int) -> tuple[int, ...]:
        """Some of the numbers 0 to count - 1, ascending."""
        value = self.get(key)
        valid = isinstance(value, list) and value and all(
            isinstance(x, int) and not isinstance(x, bool) and 0 <= x < count for x in value)
        if not valid or sorted(set(value)) != value:
            self.fail(key, f"must be a list of some of the numbers 0 to {count - 1}, ascending, "
                           f"not {_shown(value)}")
        return tuple(value)


class TomlTable(CheckedValues):
    """A TOML table with its inner tables, its mistakes, and its unknown keys."""

    def __init__(self, content: Any, where: str, section: str = TOP) -> None:
        if not isinstance(content, dict):
            table, _, key = where.rpartition(": ")[2].rpartition(".")
            hint = f"; {heading(table or key, content, key if table else 'NAME')}" if (
                (table or key) in HEADINGS) else ""
            if section != TOP and key in BELONGS[TOP]:
                hint = f"; {key_hint(key, content)}"
            raise MechanismFileError(f"{where}: must be a table of key = value lines{hint}")
        super().__init__(content, where, section)
        self._from, self._mended = where, frozenset[str]()

    def table(self, key: str) -> TomlTable:
        """Return the table under a key; an empty one where there is none."""
        return TomlTable(self.get(key, {}), f"{self.where}: {key}")

    def one_of(self, key: str, name: str) -> TomlTable:
        """Return the table `[KEY.NAME]`."""
        inner = self.table(key)
        return TomlTable(inner.content[name], f"{inner.where}.{name}", f"in [{key}.NAME]")

    def count(self, key: str) -> int:
        """Return how many tables `[[KEY]]` there are."""
        value = self.get(key, [])
        if not isinstance(value, list):
            self.fail(key, f"must be written as [[{key}]]")
        return len(value)

    def item_of(self, key: str, i: int) -> TomlTable:
        """Return a table `[[KEY]]` by its number."""
        return TomlTable(self.content[key][i], f"{self.where}: {key}[{i}]", f"in [[{key}]]")

    def with_replacements(self) -> TomlTable | None:
        """Return the table with a stand-in for its last wrong value, or None to read no more."""
        key = self._reported[-1] if self._reported and not self._ended else "type"
        if key == "type" or key in self._mended:
            return None
        own_lines = {k: x for k, x in self.content.items() if k not in self._reported}
        table = TomlTable(own_lines, self._from, self.section)
        own = STAND_INS.get(self.section, {})
        if key in own:
            table.content[key] = own[key]
        table._mended = self._mended | {key}
        return table if table.content else None

    @property
    def has_own_names(self) -> bool:
        """Whether no name is a stand-in."""
        own = STAND_INS.get(self.section, {})
        return not any("?" in own[key] for key in self._mended & own.keys()
                       if isinstance(own[key], str | list))

    def note_unknown_keys(self, mistakes: Mistakes) -> None:
        """Note the keys that no table of this kind has, besides its other mistakes."""
        for key in self.content:
            if key not in (*BELONGS.get(self.section, self.content), *self._reported):
                self.known += BELONGS[self.section]
                with mistakes.each():
                    self.fail(_shown(key)[1:-1], self.misplaced(key))

    def close(self) -> None:
        """Refuse keys that were not read."""
        for key in self.content:
            if key not in (*self.known, *self._reported):
                self.fail(_shown(key)[1:-1], self.misplaced(key))

    def misplaced(self, key: str) -> str:
        """Return why a key is not one of this table, and its right table."""
        sections = [section for section, keys in BELONGS.items() if key in keys]
        if self.section in sections:
            kind = self.content.get("type")
            of_type = "" if kind is None else f" of type {_shown(kind)}"
            return f"is not a key of this table{of_type}; {suggestion(key, self.known)}"
        if self.section == "in [[closures]]" and key in SPRING:
            return ("is not a key of this table: closures carry neither springs nor dampers; write "
                    "[[springs]] with name, frames (the same two) and stiffness or damping")
        if sections:
            where = key_hint(key, self.content[key]) if sections == [TOP] else (
                f"it belongs {' or '.join(sections)}")
            return f"is not a key of this table; {where}"
        return f"is not a key of this table; {suggestion(key, self.known)}"
