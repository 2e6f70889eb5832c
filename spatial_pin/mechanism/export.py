"""Writing a mechanism as plain files: the expanded URDF, and beside it what URDF cannot say."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism


def export_urdf(mechanism: Mechanism, path: str | Path) -> list[Path]:
    """Write the open tree as plain URDF with the dimensions it was loaded with.

    A mechanism file of the same name goes beside it when there are closures, drivers or refined
    joints, so that the pair loads as the same mechanism and no loop is lost.

    Returns:
        The files written.

    Raises:
        SpatialPinError: the target is a file of the mechanism itself, or cannot be written.
    """
    path = Path(path)
    toml = path.with_suffix(".toml")
    if path.suffix != ".urdf":
        raise SpatialPinError(f"{path}: the name of a plain URDF ends in .urdf")
    source = mechanism.path
    content: dict[str, Any] = {}
    sources = {source.resolve()} if source is not None else set()
    if source is not None and source.suffix == ".toml":
        content = tomllib.loads(source.read_text(encoding="utf-8"))
        sources.add((source.parent / content["tree"]).resolve())
    for target in (path, toml):
        if target.resolve() in sources:
            raise SpatialPinError(f"{target} is a file of the mechanism itself; choose another")
    try:
        path.write_text(mechanism.urdf, encoding="utf-8")
        if not content:
            return [path]
        content["tree"] = path.name
        toml.write_text(_toml(content), encoding="utf-8")
    except OSError as error:
        raise SpatialPinError(f"cannot write {error.filename}: {error.strerror}") from error
    return [path, toml]


def _toml(content: dict[str, Any], prefix: str = "") -> str:
    """Return TOML text of tables, arrays of tables and plain values, as mechanism files use."""
    plain = {k: v for k, v in content.items() if not _is_table(v)}
    lines = [f"{_key(k)} = {_value(v)}" for k, v in plain.items()]
    for key, value in content.items():
        name = f"{prefix}{_key(key)}"
        if isinstance(value, dict):
            inner_is_tables = value and all(isinstance(v, dict) for v in value.values())
            head = [] if inner_is_tables else ["", f"[{name}]"]
            lines += [*head, _toml(value, f"{name}.").rstrip("\n")]
        elif _is_table(value):
            for item in value:
                lines += ["", f"[[{name}]]", _toml(item, f"{name}.").rstrip("\n")]
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
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{escaped}"'
    if isinstance(value, list):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    return repr(value)
