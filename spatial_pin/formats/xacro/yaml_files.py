"""YAML files that xacro files read: plain data, of a size that can be worked with."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import read_text, shown

UNITS = {  # tag -> its unit in radians or metres, as xacro has them
    "!radians": 1.0, "!degrees": math.pi / 180.0,
    "!meters": 1.0, "!millimeters": 0.001, "!foot": 0.3048, "!inches": 0.0254,
}
MOST_ENTRIES = 100_000  # entries of one table after all that is merged into it
MOST_DIGITS = 400  # letters of a whole number, beyond which it is beyond the range of numbers


class _PlainLoader(yaml.SafeLoader):
    """YAML's safe types, with bounds on their size."""

    def flatten_mapping(self, node: Any) -> None:
        super().flatten_mapping(node)
        if len(node.value) > MOST_ENTRIES:
            raise MechanismFileError(f"a table of more than {MOST_ENTRIES:,} entries")

    def construct_yaml_int(self, node: Any) -> int:
        if len(str(node.value)) > MOST_DIGITS:
            raise MechanismFileError("a whole number leaves the range of numbers")
        return super().construct_yaml_int(node)


_PlainLoader.add_constructor("tag:yaml.org,2002:int", _PlainLoader.construct_yaml_int)


def read_yaml(path: Path, evaluate: Callable[[str], Any]) -> Any:
    """Return the content of a YAML file; `evaluate` is for what has a unit: `!degrees 90/2`."""
    loader: Any = type("Loader", (_PlainLoader,), {})  # with the units of this file
    for tag, unit in UNITS.items():
        loader.add_constructor(tag, lambda loader, node, unit=unit: (  # type: ignore[misc]
            float(evaluate(loader.construct_scalar(node))) * unit))
    text = read_text(path)
    try:
        return yaml.load(text, loader)
    except RecursionError:
        reason = "nested too deeply"
    except Exception as error:  # YAML's own, and those of the expressions
        reason = " ".join(str(error).split())[:300]
    raise MechanismFileError(f"{shown(path)}: not valid YAML: {reason}")
