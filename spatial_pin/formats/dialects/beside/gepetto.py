"""`robot.yaml` beside a URDF, as the repository example-parallel-robots of Gepetto has it.

    closed_loop: [[FRAME, FRAME], ...]   frames that coincide
    type: ["3d", "6d", ...]              3d: their origins only; otherwise they are welded
    name_mot: [JOINT, ...]               actuated joints
    joint_name: [JOINT, ...]             joints of the URDF whose type is replaced
    joint_type: [SPHERICAL, UJOINT_XY, FIXED, ...]

A `UJOINT_AB` turns about axis A of the joint's frame and then about axis B that turns with it;
FIXED stays at its zero. `urdf` may name the file that all this is said of. Joints that do not exist
are told and passed over, as their authors' reader does: published files have such names.
"""

from __future__ import annotations

import os
import re
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.dialects.beside.files import lists_of, table_of
from spatial_pin.formats.dialects.reading import Reading
from spatial_pin.formats.sources import Trust, is_file, read_text, shown

NAMES = ("type", "name_mot", "joint_name", "joint_type")
URDF = ("urdf", "name_urdf", "urdf_file")
ENDINGS = (".yaml", ".yml")
UNSTATED = re.compile(r"(?P<loop>closedloop\w*?\d+)_?A(?P<kind>_[36]D)?", re.I)
AXES = dict(zip("XYZ", np.eye(3).tolist(), strict=True))
SOURCE = "closed_loop"


def is_robot(path: Path) -> bool:
    """Return whether a YAML file is one, or was meant to be: reading then says what is wrong."""
    try:
        return SOURCE in table_of(path)
    except MechanismFileError:
        return SOURCE in _text(path)


def _text(path: Path) -> str:
    try:
        return read_text(path)
    except MechanismFileError:
        return ""


def urdf_of(path: Path, trust: Trust | None = None) -> Path:
    """Return the URDF that a `robot.yaml` is about: named in it, of its name, or the only one.

    Args:
        path: the file.
        trust: which files it may name; None: those of its folder.

    Raises:
        MechanismFileError: there is none, or several and none is named.
    """
    table = table_of(path)
    named = next((table[key] for key in URDF if isinstance(table.get(key), str)), None)
    if named is not None:
        try:
            (trust or Trust.of(path)).checked(path.parent / named)
        except MechanismFileError as error:
            raise MechanismFileError(f"{shown(path)}: urdf: {error}") from error
        return path.parent / named
    own = path.with_suffix(".urdf")
    if is_file(own):
        return own
    found = sorted(path.parent.glob("*.urdf"))
    if len(found) != 1:
        raise MechanismFileError(f"{shown(path)}: {len(found)} .urdf files beside it, none of its "
                                 f"name; write \"urdf: NAME.urdf\" into it")
    return found[0]


def file_of(urdf: Path) -> Path | None:
    """Return the YAML file beside a URDF that is about it."""
    own = [urdf.with_suffix(ending) for ending in ENDINGS]
    shared = [urdf.parent / f"robot{ending}" for ending in ENDINGS]
    for path in dict.fromkeys([*own, *shared]):
        if Trust.of(urdf).allows(path) and is_robot(path) and _same(urdf_of(path), urdf):
            return path
    return None


def tell_unstated(reading: Reading) -> None:
    """Tell of frames that are called as the ends of loops, where no file says that they are."""
    links = reading.links
    ends = [link for link in reading.links if UNSTATED.fullmatch(link)
            and UNSTATED.sub(r"\g<loop>_B\g<kind>", link) in links]
    if ends:
        reading.notices.append(f"{', '.join(ends)}: frames called like the ends of loops, and no "
                               "robot.yaml beside it says so: these loops are open; write that "
                               "file, or [[closures]] in a .toml file")


def read_robot(path: Path, reading: Reading) -> None:
    """Read a `robot.yaml`.

    Raises:
        MechanismFileError: it names what does not exist, or a type that is not known.
    """
    table = {key: value for key, value in table_of(path).items() if key not in URDF}
    lists = lists_of(table, (SOURCE, *NAMES), NAMES, path)
    _read_types(lists, path, reading)
    names = {**reading.links, **reading.joints}
    for k, pair in enumerate(lists["closed_loop"]):
        where = f"{shown(path)}: closed_loop[{k}]"
        if not (isinstance(pair, list) and len(pair) == 2
                and all(isinstance(frame, str) for frame in pair)):
            raise MechanismFileError(f"{where} must be two names of frames")
        for frame in pair:
            if frame not in names:
                raise MechanismFileError(f"{where}: frame {frame!r} does not exist; "
                                         f"{suggestion(frame, names)}")
        point = bool(lists["type"]) and lists["type"][k].lower() == "3d"
        reading.add("closures", {"name": _name(pair, k), "type": "spherical" if point else "weld",
                                 "frames": pair, "source": f"closed_loop of {path.name}"})
    if lists["name_mot"]:
        reading.content["drivers"], reading.all_driven = {}, True
    for motor in lists["name_mot"]:
        if motor in reading.joints:
            reading.drive(motor)
        else:
            reading.notices.append(f"{path.name}: name_mot: there is no joint {motor!r}; it drives "
                                   "nothing")


def _read_types(lists: dict[str, list[Any]], path: Path, reading: Reading) -> None:
    if len(lists["joint_name"]) != len(lists["joint_type"]):
        raise MechanismFileError(f"{shown(path)}: {len(lists['joint_name'])} joint_name for "
                                 f"{len(lists['joint_type'])} joint_type")
    if lists["type"] and len(lists["type"]) != len(lists["closed_loop"]):
        raise MechanismFileError(f"{shown(path)}: {len(lists['closed_loop'])} closed_loop for "
                                 f"{len(lists['type'])} type")
    for name, kind in zip(lists["joint_name"], lists["joint_type"], strict=True):
        where = f"{shown(path)}: joint_name {name!r}"
        if name not in reading.joints:
            reading.notices.append(f"{path.name}: joint_name: there is no joint {name!r}, which "
                                   f"would be {kind}; {suggestion(name, reading.joints)}")
            continue
        pins = re.fullmatch(r"UJOINT_([XYZ])([XYZ])", kind)
        if kind == "SPHERICAL":
            reading.refine(name, type="spherical")
        elif kind == "FIXED":
            reading.joints[name].set("type", "fixed")
        elif pins and pins[1] != pins[2]:
            reading.refine(name, type="universal", axis=AXES[pins[1]], axis2=AXES[pins[2]])
        else:
            raise MechanismFileError(f"{where}: joint_type {kind!r} is not known; there are: "
                                     "SPHERICAL, FIXED, UJOINT_XY and the like")


def _name(pair: list[str], k: int) -> str:
    """Return what the two frames of a loop are called in common, or its number."""
    same = takewhile(lambda letters: letters[0] == letters[1], zip(*pair, strict=False))
    name = "".join(a for a, _ in same).rstrip("_- ")
    return name or f"closed_loop_{k + 1}"


def _same(a: Path, b: Path) -> bool:
    return os.path.realpath(a) == os.path.realpath(b)
