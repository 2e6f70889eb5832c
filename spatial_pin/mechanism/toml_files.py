"""TOML text to tables, without what a short text can make of the parser: hours, gigabytes."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from spatial_pin.errors import MechanismFileError
from spatial_pin.mechanism.sources import shown

DEEPEST = 8  # names in a key; a mechanism file needs three
_TEXTS = re.compile(  # texts and comments, in which dots mean nothing
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|(#)[^\n]*', re.S)
_LONG_KEY = re.compile(rf"(?<![\w-])[\w-]++(?:[ \t]*+\.[ \t]*+[\w-]++){{{DEEPEST}}}")


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """Return the tables of TOML text; `path` is where it comes from.

    Raises:
        MechanismFileError: it is not valid, or nested too deeply.
    """
    long = _LONG_KEY.search(_TEXTS.sub(lambda found: "" if found[1] else "_", text))
    if long:
        raise MechanismFileError(f"{shown(path)}: a key of more than {DEEPEST} names: "
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
