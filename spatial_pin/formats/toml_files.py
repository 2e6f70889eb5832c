"""TOML text to tables, without what a short text can make of the parser: hours, gigabytes; back."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import shown

DEEPEST_KEY = 8  # names in a key; a mechanism file needs three
_TEXTS = re.compile(  # texts and comments, in which dots mean nothing
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|(#)[^\n]*', re.S)
_LONG_KEY = re.compile(rf"(?<![\w-])[\w-]++(?:[ \t]*+\.[ \t]*+[\w-]++){{{DEEPEST_KEY}}}")


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """Return the tables of TOML text; `path` is where it comes from.

    Raises:
        MechanismFileError: it is not valid, or nested too deeply.
    """
    long = _LONG_KEY.search(_TEXTS.sub(lambda found: "" if found[1] else "_", text))
    if long:
        raise MechanismFileError(f"{shown(path)}: a key of more than {DEEPEST_KEY} names: "
                                 f"{long[0][:40]}...; a mechanism file has at most three")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise MechanismFileError(f"{shown(path)}: lists or tables are nested too deeply") from error
    except tomllib.TOMLDecodeError as error:
        raise MechanismFileError(f"{shown(path)}: not valid TOML: {str(error)[:300]}") from error
    except ValueError as error:  # Python reads no numbers of thousands of digits
        found = re.search(r"\d{1000}", text.replace("_", ""))
        lines = text.replace("_", "")[:found.start() if found else 0].splitlines() or [""]
        key = lines[-1].partition("=")[0].strip()[:40]
        raise MechanismFileError(
            f"{shown(path)}: line {len(lines)}: {key}: a whole number of thousands of digits; "
            "numbers end at 1e308") from error


def toml_text(content: dict[str, Any], prefix: str = "") -> str:
    """Return TOML text of tables, arrays of tables and plain values, as mechanism files use."""
    plain = {k: v for k, v in content.items() if not _is_table(v)}
    lines = [f"{_key(k)} = {_value(v)}" for k, v in plain.items()]
    for key, value in content.items():
        name = f"{prefix}{_key(key)}"
        if isinstance(value, dict):
            inner_is_tables = value and all(isinstance(v, dict) for v in value.values())
            head = [] if inner_is_tables else ["", f"[{name}]"]
            lines += [*head, toml_text(value, f"{name}.").rstrip("\n")]
        elif _is_table(value):
            for item in value:
                lines += ["", f"[[{name}]]", toml_text(item, f"{name}.").rstrip("\n")]
    return "\n".join(lines) + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and all(isinstance(v, dict) for v in value)
    )


def _key(key: str) -> str:
    bare = key and all(c.isascii() and (c.isalnum() or c in "_-") for c in key)
    return key if bare else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    return repr(value)
