"""Writing a mechanism as plain files: the expanded URDF, and beside it what URDF cannot say."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from spatial_pin.errors import SpatialPinError
from spatial_pin.linalg import Array
from spatial_pin.mechanism.mechanism import Closure, Mechanism, Spring
from spatial_pin.mechanism.pairs import COUPLING, PAIRS
from spatial_pin.mechanism.resistance import Resistance
from spatial_pin.mechanism.sources import read_text
from spatial_pin.mechanism.toml_files import parse_toml
from spatial_pin.mechanism.urdf import PAIR_OF_URDF_TYPE
from spatial_pin.outputs import named_path, write_text


def export_urdf(mechanism: Mechanism, path: str | Path) -> list[Path]:
    """Write the open tree as plain URDF with the dimensions it was loaded with.

    A mechanism file of the same name goes beside it when there are closures, drivers or refined
    joints, so that the pair loads as the same mechanism and no loop is lost.

    Returns:
        The files written.

    Raises:
        SpatialPinError: the target is a file of the mechanism itself, or cannot be written.
    """
    path = named_path(path)
    toml = path.with_suffix(".toml")
    if path.suffix != ".urdf":
        raise SpatialPinError(f"{path}: the name of a plain URDF ends in .urdf")
    source = mechanism.path
    content: dict[str, Any] = {}
    sources = {source.resolve()} if source is not None else set()
    if source is not None and source.suffix == ".toml":
        content = parse_toml(read_text(source), source)
        sources.add((source.parent / content["tree"]).resolve())
    elif mechanism.path is None:  # made by another mechanism, not by a file
        content = content_of(mechanism)
    for target in (path, toml):
        if target.resolve() in sources:
            raise SpatialPinError(f"{target} is a file of the mechanism itself; choose another")
    try:
        write_text(path, mechanism.urdf)
        if not content:
            return [path]
        content["tree"] = path.name
        write_text(toml, _toml(content))
    except OSError as error:
        raise SpatialPinError(f"cannot write {error.filename}: {error.strerror}") from error
    return [path, toml]


def content_of(mechanism: Mechanism) -> dict[str, Any]:
    """Return what a mechanism file says of a mechanism, as `parse_toml` would read it."""
    elements = {joint.get("name", ""): joint
                for joint in ET.fromstring(mechanism.urdf).findall("joint")}
    content: dict[str, Any] = {
        "name": mechanism.name, "title": mechanism.title, "source": mechanism.source,
        "tree": f"{mechanism.name}.urdf", "gravity": mechanism.model.gravity.linear.tolist(),
        "joints": {}, "closures": [_closure(c) for c in mechanism.closures],
        "drivers": {d.name: {"joint": d.joint} for d in mechanism.drivers.values()},
        "springs": [_spring(s) for s in mechanism.springs],
        "passive": {p.name: {"body": p.body, "axis": list(p.axis)} for p in mechanism.passives},
        "frames": {f.name: {"link": f.link, "xyz": list(f.xyz), "rpy": list(f.rpy)}
                   for f in mechanism.frames.values()},
        "guess": {key: _plain(value) for key, value in mechanism.guess.items()},
    }
    for i, pair in enumerate(mechanism.pairs, start=1):
        name = mechanism.model.names[i]
        kind = elements[name].get("type", "")
        refined = pair != PAIR_OF_URDF_TYPE.get(kind, kind)
        table = {**(_joint(mechanism, i) if refined else {}),
                 **_resistances(mechanism, i, elements[name].find("dynamics"))}
        if table:
            content["joints"][name] = table
    return {key: value for key, value in content.items() if value}


def _plain(value: Any) -> Any:
    return np.asarray(value, dtype=float).tolist()


def _joint(mechanism: Mechanism, i: int) -> dict[str, Any]:
    pair = PAIRS[mechanism.pairs[i - 1]]
    axis, axis2, lead = tree_axes(mechanism, i)
    table: dict[str, Any] = {"type": mechanism.pairs[i - 1]}
    table.update({"axis": axis.tolist()} if pair.uses_axis else {})
    table.update({"axis2": axis2.tolist()} if pair.uses_axis2 else {})
    table.update({"lead": lead} if pair.uses_lead else {})
    return table


def _resistances(
    mechanism: Mechanism, i: int, dynamics: ET.Element | None
) -> dict[str, list[float]]:
    """Return what resists, or adds inertia, at tree joint i, where the URDF says otherwise."""
    model, given = mechanism.model, {} if dynamics is None else dynamics.attrib
    own = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
    values = {"damping": model.damping, "friction": model.upperDryFrictionLimit,
              "armature": model.armature}
    table = {key: x[own].tolist() for key, x in values.items()
             if np.any(x[own] != float(given.get(key, 0.0)))}
    slip = Resistance(mechanism).slip_speed[own]
    if mechanism.slip_speeds.size and not np.all(np.isnan(mechanism.slip_speeds[own])):
        table["slip_speed"] = slip.tolist()
    return table


def tree_axes(mechanism: Mechanism, i: int) -> tuple[Array, Array, float]:
    """Return axis and second axis (3,), each zero where there is none, and lead of tree joint i."""
    joint, none = mechanism.model.joints[i].extract(), np.zeros(3)
    kind = mechanism.pairs[i - 1]
    if kind == "universal":
        return joint.axis1.copy(), joint.axis2.copy(), 0.0
    if kind in ("spherical", "floating"):
        return none, none, 0.0
    if kind == "screw":
        return joint.axis.copy(), none, 2.0 * np.pi * joint.pitch
    if kind in ("cylindrical", "planar"):  # their turn, about the pair's axis
        joint = joint.joints[0 if kind == "cylindrical" else 2].extract()
    column = np.array(joint.createData().S).reshape(6, -1)[:, 0]
    return (column[:3] if kind == "prismatic" else column[3:]), none, 0.0


def _closure(closure: Closure) -> dict[str, Any]:
    table: dict[str, Any] = {"name": closure.name, "type": closure.type}
    if closure.type == COUPLING:
        return {**table, "joints": list(closure.joints), "ratio": closure.ratio,
                "offset": closure.offset}
    pair, geometry = closure.pair, closure.geometry
    assert geometry is not None
    table["frames"] = list(closure.frames)
    table.update({"axis": geometry.axes1[:, 2].tolist()} if pair.uses_axis else {})
    table.update({"axis2": geometry.axes2[:, 2].tolist()} if pair.uses_axis2 else {})
    if pair.uses_length:
        table.update({"length_between": list(closure.between)} if closure.between else
                     {"length": geometry.length})
    table.update({"lead": geometry.lead} if pair.uses_lead else {})
    table.update({} if closure.equations is None else {"equations": list(closure.equations)})
    return table


def _spring(spring: Spring) -> dict[str, Any]:
    table: dict[str, Any] = {"name": spring.name, "stiffness": spring.stiffness,
                             "damping": spring.damping}
    if spring.joint is not None:
        free = "free_length" if spring.free_length else "free_angle"
        return {**table, "joint": spring.joint, free: spring.free}
    return {**table, "frames": list(spring.frames), "free_length": spring.free_length}


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
