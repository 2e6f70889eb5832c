"""A mechanism as plain files: expanded URDF, and a mechanism file for the rest; edits of that."""

from __future__ import annotations

import os
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from spatial_pin._support.checks import finite_array, finite_number
from spatial_pin._support.output_files import named_folder, named_path, replacing, write_text
from spatial_pin.errors import MechanismFileError, SpatialPinError, UnknownNameError, warn
from spatial_pin.formats.dialects.robot import RobotReading
from spatial_pin.formats.file_access import (
    HeldFile,
    Trust,
    is_file,
    is_held,
    parse_toml,
    read_text,
    toml_text,
)
from spatial_pin.formats.files import load, made_of
from spatial_pin.formats.importers import Request
from spatial_pin.formats.pinocchio_model.pair_tree import joint_axis
from spatial_pin.formats.urdf.elements import fresh
from spatial_pin.formats.urdf.urdf_model import (
    NUMBERS,
    PAIR_OF_URDF_TYPE,
    joint_axes,
    own_entries,
    stated_limits,
    urdf_order,
)
from spatial_pin.formats.urdf_importer import read_dialects
from spatial_pin.formats.xacro.expansion import with_defaults
from spatial_pin.mechanism.curves import CurveShape, curves_in
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import COUPLING, PAIRS
from spatial_pin.mechanism.parts import Closure, Spring, drivers_of_tree
from spatial_pin.mechanism.resistance import Resistance
from spatial_pin.numerics.linalg import EPS, Array

STANDARD_GRAVITY = [0.0, 0.0, -9.81]  # m/s², of a tree whose file says nothing
MESHES = "meshes"


def save(mechanism: Mechanism, folder: str | Path, tabulate: Any = None) -> Path:
    """Write a mechanism as a folder of mechanism file, URDF and meshes, see `Mechanism.save`."""
    folder = named_folder(folder)
    stem = re.sub(r"[^\w.+-]+", "_", mechanism.name).strip("._") or "mechanism"
    urdf, toml = folder / f"{stem}.urdf", folder / f"{stem}.toml"
    tree = mechanism.tree
    mechanism = mechanism.with_fields(closures=tuple(
        _tabulated(mechanism, c, tabulate) for c in mechanism.closures))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        text, meshes = _gathered(mechanism)
        if tree is not None and is_held(tree) and not mechanism.free_flyer:  # a drawing
            urdf = folder / f"{stem}.urdf.xacro"
            text = with_defaults(read_text(tree), mechanism.dimensions)
            gap = {} if mechanism.gap is None else {"gap": mechanism.gap}
            content = {**mechanism.content, **gap, "tree": urdf.name, "complete": True}
        else:
            content = _mechanism_content(mechanism, urdf.name)
        _write(mechanism, {urdf: text, toml: toml_text(content)},
               {folder / target: source for target, source in meshes.items()})
    except OSError as error:
        raise SpatialPinError(f"cannot write {error.filename}: {error.strerror}") from error
    return toml


def _tabulated(mechanism: Mechanism, closure: Closure, tabulate: Any) -> Closure:
    """Return a closure with a table in the place of a function in code."""
    function = closure.numbers.get("function")
    if function is None or function.form:
        return closure
    where = f"mechanism {mechanism.name!r}: closure {closure.name!r}"
    values = tabulate.get(closure.name) if isinstance(tabulate, Mapping) else tabulate
    if values is None:
        raise SpatialPinError(
            f"{where}: its function is code, which no file can have; save(..., tabulate=values) "
            f"writes a table of it at values of {closure.joints[0]!r}")
    try:
        table = function.tabulated(values)
    except (TypeError, ValueError) as error:
        raise SpatialPinError(f"{where}: tabulate: {error}") from error
    return replace(closure, numbers={**closure.numbers, "function": table})


def export_urdf(mechanism: Mechanism, path: str | Path) -> list[Path]:
    """Write the open tree as plain URDF with the dimensions it was loaded with.

    A mechanism file of the same name goes beside it when there is anything that URDF cannot say,
    so that the pair loads as the same mechanism and no loop is lost. Meshes are copied beside it,
    unless they lie below its folder or in a package.

    Returns:
        The files written.
    """
    path = named_path(path)
    for closure in mechanism.closures:
        _tabulated(mechanism, closure, None)
    if path.suffix != ".urdf":
        raise SpatialPinError(f"{path}: the name of a plain URDF ends in .urdf")
    text, meshes = _gathered(mechanism, Trust.of(path))
    copies = {path.parent / target: source for target, source in meshes.items()}
    files = {path: text}
    content = _mechanism_content(mechanism, path.name)
    is_enough = content["gravity"] == STANDARD_GRAVITY and content.keys() <= {
        "name", "tree", "complete", "gravity"}
    if is_enough:  # unless readers find loops or motors in the URDF, or beside it
        reading = RobotReading(robot_of(mechanism), path)
        try:
            read_dialects(reading)
            is_enough = not reading.content
        except MechanismFileError:
            is_enough = False
    if not is_enough or (mechanism.path is not None and mechanism.path.suffix == ".toml"):
        files[path.with_suffix(".toml")] = toml_text(content)
    try:
        _write(mechanism, files, copies)
    except OSError as error:
        raise SpatialPinError(f"cannot write {error.filename}: {error.strerror}") from error
    return list(files)


def _write(mechanism: Mechanism, texts: dict[Path, str], copies: dict[Path, Path]) -> None:
    own = {path.resolve() for path in (mechanism.path, mechanism.tree)
           if path is not None and os.path.exists(path)}
    for target in texts:
        if target.resolve() in own:
            raise SpatialPinError(f"{target} is a file of the mechanism itself; choose another")
    for target, source in copies.items():
        if target.resolve() != source.resolve():
            target.parent.mkdir(parents=True, exist_ok=True)
            with replacing(target) as temporary:
                shutil.copyfile(source, temporary)
    for target, text in texts.items():
        write_text(target, text)


def _mechanism_content(mechanism: Mechanism, tree: str) -> dict[str, Any]:
    """Return the mechanism file for a URDF that states couplings as <mimic>."""
    stated = {f"mimic_{joint.get('name')}"
              for joint in robot_of(mechanism).findall("joint")
              if joint.find("mimic") is not None}
    content = {**content_of(mechanism), "tree": tree}
    closures = [table for table in content.get("closures", ())
                if not (table["type"] == COUPLING and table["name"] in stated)]
    return {"name": content["name"], "tree": tree, "complete": True, **{
        key: closures if key == "closures" else value for key, value in content.items()
        if key != "closures" or closures}}


def _gathered(mechanism: Mechanism, trust: Trust | None = None) -> tuple[str, dict[Path, Path]]:
    """Return the URDF with meshes named below its own folder, and which file each is a copy of.

    Meshes that were not found stay as they are named; so do those that are trusted.
    """
    robot = robot_of(mechanism)
    meshes = robot.findall("link/*/geometry/mesh")
    if not meshes:
        return mechanism.urdf, {}
    folders: dict[Path, Path] = {}
    copies: dict[Path, Path] = {}
    gone: list[str] = []
    for mesh in meshes:
        source = Path(mesh.get("filename", ""))
        if not source.is_absolute():  # it was not found
            continue
        if trust is not None and trust.allows(source):
            continue
        if not is_file(source):
            gone.append(source.name)
            continue
        if source.parent not in folders:
            name, k = source.parent.name, 2
            wanted = free = Path(MESHES) if name in ("", MESHES) else Path(MESHES) / name
            while free in folders.values():
                free, k = Path(MESHES) / f"{wanted.name}_{k}", k + 1
            folders[source.parent] = free
        for part in (source, *_parts(source)):
            copies[folders[source.parent] / part.name] = part
        mesh.set("filename", str(folders[source.parent] / source.name))
    if gone:
        warn(f"mechanism {mechanism.name!r}: {len(gone)} mesh files are not there and are not "
             f"copied, {gone[0]!r} the first")
    return (ET.tostring(robot, encoding="unicode") if copies else mechanism.urdf), copies


def _parts(mesh: Path) -> list[Path]:
    """Return the files of materials beside a mesh that it names."""
    if mesh.suffix.lower() != ".obj":
        return []
    text = mesh.read_text(encoding="utf-8", errors="replace")
    named = [mesh.parent / name.strip() for name in re.findall(r"^mtllib[ \t]+(.+)$", text, re.M)]
    trust = Trust.of(mesh)
    return [file for file in named if file.parent == mesh.parent and trust.allows(file)]


def robot_of(mechanism: Mechanism) -> ET.Element:
    """Return the <robot> of a mechanism's tree."""
    try:
        return ET.fromstring(mechanism.urdf)
    except ET.ParseError as error:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: the URDF text of its tree is needed ({error}); "
            "sp.load and sp.Mechanism.from_model make one") from error


def content_of(mechanism: Mechanism) -> dict[str, Any]:
    """Return the content of a mechanism's file, as `parse_toml` reads it."""
    robot = robot_of(mechanism)
    moving, closures = list(mechanism.model.names)[1:], _with_named_curves(mechanism.closures)
    content: dict[str, Any] = {
        "name": mechanism.name, "title": mechanism.title, "source": mechanism.source,
        "tree": f"{mechanism.name}.urdf", "gravity": mechanism.model.gravity.linear.tolist(),
        "gap": [] if mechanism.gap is None else mechanism.gap,
        "order": moving if moving != [n for n in urdf_order(robot) if n in moving] else [],
        "joints": {joint.get("name", ""): table for joint in robot.findall("joint")
                   if (table := _joint(mechanism, joint))},
        "curves": {x.name: dict(x.form) for c in closures for x in curves_in(c.numbers)},
        "closures": [_closure(c) for c in closures],
        "drivers": {d.name: {"joint": d.joint} for d in mechanism.drivers.values()},
        "springs": [_spring(s) for s in mechanism.springs],
        "passive": {p.name: {"body": p.body, "axis": list(p.axis)} for p in mechanism.passives},
        "frames": {f.name: {"link": f.link, "xyz": list(f.xyz), "rpy": list(f.rpy)}
                   for f in mechanism.frames.values()},
        "guess": {key: np.asarray(value, dtype=float).tolist()
                  for key, value in mechanism.guess.items()},
    }
    joints = dict(zip(moving, mechanism.pairs, strict=True))
    unsaid = drivers_of_tree(joints, mechanism.closures)
    is_needed = list(unsaid.values()) != list(mechanism.drivers.values())
    return {key: value for key, value in content.items()
            if (is_needed if key == "drivers" else value)}


def _with_named_curves(closures: tuple[Closure, ...]) -> list[Closure]:
    """Return closures whose curves have names, each its own."""
    names: dict[int, str] = {}
    renamed = []
    for c in closures:
        named = {}
        for curve in curves_in(c.numbers):
            name = names.setdefault(id(curve), fresh(curve.name or f"{c.name}_curve",
                                                     set(names.values())))
            named[id(curve)] = replace(curve, name=name)
        numbers = dict(c.numbers)
        if "curve" in numbers:
            numbers["curve"] = named[id(numbers["curve"])]
        if "curves" in numbers:
            both = numbers["curves"]
            numbers["curves"] = replace(both, one=named[id(both.one)], two=named[id(both.two)])
        renamed.append(replace(c, numbers=numbers))
    return renamed


def _joint(mechanism: Mechanism, element: ET.Element) -> dict[str, Any]:
    """Return the table of a joint in a mechanism file: data that its URDF element lacks."""
    name, kind, model = element.get("name", ""), element.get("type", ""), mechanism.model
    if not model.existJointName(name):
        return {} if kind == "fixed" else {"type": "fixed"}
    i, table = int(model.getJointId(name)), dict[str, Any]()
    pair, axes = mechanism.pairs[i - 1], tree_axes(mechanism, i)
    axis, _ = joint_axes(PAIRS[pair], element, None, mechanism.name)
    is_turned = PAIRS[pair].uses_axis and not np.allclose(axes[0], axis, rtol=0.0, atol=4.0 * EPS)
    if is_turned or pair != PAIR_OF_URDF_TYPE.get(kind, kind):
        table = {"type": pair, **PAIRS[pair].file_entries(*axes)}
    stated = {**stated_limits(element, model.nqs[i], model.nvs[i]),
              "armature": np.zeros(model.nvs[i])}
    for key, arrays in NUMBERS.items():
        own = own_entries(model, i, key)
        for array, factor in arrays.items():
            values = getattr(model, next(iter(arrays)))[own]
            if not np.array_equal(getattr(model, array)[own], stated[array]):
                table[key] = _one_or_all(values)
            stated[array] = factor * values if key in table else stated[array]
    own = own_entries(model, i, "slip_speed")
    if mechanism.slip_speeds.size and not np.all(np.isnan(mechanism.slip_speeds[own])):
        table["slip_speed"] = _one_or_all(Resistance(mechanism).slip_speed[own])
    return table


def _one_or_all(values: Array) -> float | list[float]:
    """Return numbers (n,) as a file has them: one where all are the same."""
    return float(values[0]) if np.all(values == values[0]) else values.tolist()


def tree_axes(mechanism: Mechanism, i: int) -> tuple[Array, Array, float]:
    """Return axis and second axis (3,), each zero where there is none, and lead of tree joint i."""
    joint, none = mechanism.model.joints[i].extract(), np.zeros(3)
    kind = mechanism.pairs[i - 1]
    if kind == "universal":
        return joint.axis1.copy(), joint.axis2.copy(), 0.0
    if kind in ("spherical", "floating"):
        return none, none, 0.0
    if kind in ("cylindrical", "planar"):  # their turn, about the pair's axis
        joint = joint.joints[0 if kind == "cylindrical" else 2].extract()
    return joint_axis(joint), none, 2.0 * np.pi * joint.pitch if kind == "screw" else 0.0


def _closure(closure: Closure) -> dict[str, Any]:
    table: dict[str, Any] = {"name": closure.name, "type": closure.type}
    table.update({"source": closure.source} if closure.source else {})
    pair, geometry = closure.pair, closure.geometry
    names = {"frames": list(closure.frames), "joints": list(closure.joints)}
    table |= {key: value for key, value in names.items() if value}
    for key in pair.keys:
        if key.name in closure.numbers:
            number = closure.numbers[key.name]
            table[key.name] = number.name if isinstance(number, CurveShape) else (
                number.form if key.read else np.asarray(number).tolist())
    table |= pair.file_entries(
        geometry.axes1[:, 2], geometry.axes2[:, 2], geometry.lead, geometry.length)
    if closure.between:
        del table["length"]
        table["length_between"] = list(closure.between)
    table.update({} if closure.equations is None else {"equations": list(closure.equations)})
    return table


def _spring(spring: Spring) -> dict[str, Any]:
    table: dict[str, Any] = {"name": spring.name, "stiffness": spring.stiffness,
                             "damping": spring.damping}
    if spring.is_bushing:
        return {**{key: np.array(getattr(spring, key)).tolist()
                   for key in ("stiffness", "damping", "preload") if np.any(getattr(spring, key))},
                "name": spring.name, "frames": list(spring.frames)}
    if spring.law:
        del table["stiffness"]
        table["law"] = {"points": [list(point) for point in spring.law]}
    table |= {key: True for key in ("tension_only", "compression_only") if getattr(spring, key)}
    if spring.joint is not None:
        free = "free_length" if spring.free_length else "free_angle"
        return {**table, "joint": spring.joint, free: spring.free}
    return {**table, "frames": list(spring.frames), "free_length": spring.free_length}


def with_point(
    mechanism: Mechanism, name: str, body: str, xyz: ArrayLike, rpy: ArrayLike
) -> Mechanism:
    """Return a mechanism with a frame on a body; see `Mechanism.with_point`."""
    vectors = {key: finite_array(x, (3,), f"{key} of point {name!r}").tolist()
              for key, x in (("xyz", xyz), ("rpy", rpy))}
    if not isinstance(name, str):
        raise TypeError(f"the name of a point is text, not {name!r}")
    if name in mechanism.frame_ids:
        raise MechanismFileError(f"mechanism {mechanism.name!r}: there is a link, joint or frame "
                                 f"{name!r} already; choose another name for the point")
    mechanism.frame_id(body)
    return _edited(mechanism, "frames", name, {"link": body, **vectors})


def with_mass(
    mechanism: Mechanism, body: str, mass: float, com: ArrayLike, inertia: ArrayLike
) -> Mechanism:
    """Return a mechanism with another mass of a link; see `Mechanism.with_mass`."""
    if body not in mechanism.links:
        raise UnknownNameError("link", body, mechanism.links, f"mechanism {mechanism.name!r}: ")
    shape = np.shape(inertia)
    if shape not in ((), (3,), (3, 3)):
        raise ValueError(f"inertia of {body!r} is one number, three, or (3, 3), not {shape}")
    return _edited(mechanism, "masses", body, {
        "mass": finite_number(mass, f"mass of {body!r}"),
        "com": finite_array(com, (3,), f"com of {body!r}").tolist(),
        "inertia": finite_array(inertia, shape, f"inertia of {body!r}").tolist()})


def _edited(mechanism: Mechanism, table: str, name: str, entry: dict[str, Any]) -> Mechanism:
    """Return a mechanism as its file makes it with one table `[TABLE.NAME]` more.

    The tree and its dimensions stay. Of a mechanism without file one says all that there is.
    """
    m, path = mechanism, mechanism.path
    if path is None or os.path.isdir(path):
        content = content_of(m)
        content[table] = {**content.get(table, {}), name: entry}
        request = Request(Path(f"{m.name}.toml"), trusted=m.trusted, packages=dict(m.packages))
        made = made_of(content, Path(f"{m.name}.urdf"), robot_of(m), request, ())
        return made.with_fields(
            path=path, tree=m.tree, notices=m.notices, parameters=m.parameters, gap=m.gap,
            free_flyer=m.free_flyer, visual_model=partial(getattr, m, "visual_model"),
            collision_model=partial(getattr, m, "collision_model"))
    own: dict[str, Any] = {"name": m.name, "tree": path.name}
    if path.suffix == ".toml":
        own = parse_toml(read_text(path), path)
    content = {**own, table: {**own.get(table, {}), name: entry}}
    return load(HeldFile.of(path.with_suffix(".toml"), toml_text(content)), **m.loading)
