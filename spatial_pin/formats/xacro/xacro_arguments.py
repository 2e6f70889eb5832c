"""Dimensions: arguments of a mechanism's xacro file, and numbers in terms of them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import shown, texts_in
from spatial_pin.formats.importers import Request
from spatial_pin.formats.xacro.expansion import Expansion, arguments_of, xacro_text


def dimensions(request: Request) -> dict[str, float]:
    """Return the value of every xacro argument that is a number, given or by default."""
    return {name: float(x) for name, x in arguments(request).items() if _is_number(x)}


def arguments(request: Request) -> dict[str, str]:
    """Return the text of every xacro argument of a file, given or by default."""
    expansion, given = Expansion(request), request.parameters
    defaults = arguments_of(expansion) if request.path.suffix == ".xacro" else {}
    texts = {name: xacro_text(given.get(name, text)) for name, text in defaults.items()}
    if all(map(_is_number, texts.values())):
        return texts

    def run(xacro: Any) -> dict[str, str]:
        """Evaluate the defaults one after the other, as in a file."""
        xacro.init_stacks(str(expansion.path))
        known = xacro.substitution_args_context["arg"] = {name: texts[name] for name in given}
        for name, default in defaults.items():
            if name not in known:
                known[name] = str(expansion.eval_text(default, xacro._global_symbols))
        return {name: known[name] for name in defaults}

    return dict(expansion.guarded(run))


def _is_number(value: Any) -> bool:
    try:
        return math.isfinite(float(value))
    except (TypeError, ValueError, OverflowError):
        return False


SECTIONS = "joints", "closures", "curves", "springs", "masses"  # of a mechanism file, with numbers
WRITTEN = re.compile(r"^\s*\$\{[^}]*\}\s*$")  # an expression in the place of a number
ANYWHERE = re.compile(r"\$")  # the same, or `$(arg name)`, or a part of a text


def worked_out(
    table: Mapping[str, Any], where: Path, name: str, request: Request,
    written: re.Pattern[str] = ANYWHERE,
) -> dict[str, Any]:
    """Return a table with numbers in the place of texts that are `written` as expressions.

    The file `where` has it under a name; names in the texts are arguments of the request's file.

    Raises:
        MechanismFileError: a text is no expression of the arguments, or its value no number.
    """
    if not any(map(written.search, texts_in(table))):
        return dict(table)
    texts, expansion = arguments(request), Expansion(replace(request, path=where))
    known = f"dimensions are: {', '.join(texts)}" if texts else "no dimensions"
    names: dict[str, Any] = {}

    def number(key: str, value: Any) -> Any:
        if isinstance(value, list):
            return [number(f"{key}[{k}]", x) for k, x in enumerate(value)]
        if isinstance(value, dict):
            return {k: number(f"{key}.{k}", x) for k, x in value.items()}
        if not (isinstance(value, str) and written.search(value)):
            return value
        try:
            result = expansion.eval_text(value, names)
        except MechanismFileError as error:
            reason = str(error).removeprefix(f"{shown(where)}: ")
            raise MechanismFileError(
                f"{shown(where)}: {name}: {key}: {reason} ({known})") from error
        several = isinstance(result, list | tuple)
        parts = list(result) if several else [result]
        if not all(not isinstance(x, bool) and _is_number(x) for x in parts):
            raise MechanismFileError(f"{shown(where)}: {name}: {key}: {value!r} is "
                                     f"{str(result)[:80]!r}, no finite number")
        return [float(x) for x in parts] if several else float(result)

    def run(xacro: Any) -> dict[str, Any]:
        xacro.init_stacks(str(where))
        xacro.substitution_args_context["arg"] = texts
        names.update(xacro._global_symbols)
        names.update((key, expansion.literal(text)) for key, text in texts.items())
        return {key: number(key, value) for key, value in table.items()}

    return dict(expansion.guarded(run))


def with_numbers(content: Mapping[str, Any], where: Path, request: Request) -> dict[str, Any]:
    """Return the content of the file `where` with numbers in the place of `${...}`."""
    own = {key: content[key] for key in SECTIONS if key in content}
    return {**content, **worked_out(own, where, "numbers", request, WRITTEN)}


def written_dimensions(content: Mapping[str, Any], names: Iterable[str]) -> set[str]:
    """Return the dimensions, of some, that numbers of a mechanism file itself follow from."""
    texts = " ".join(filter(WRITTEN.search, texts_in([content.get(key) for key in SECTIONS])))
    return {name for name in names if re.search(rf"\b{re.escape(name)}\b", texts)}
