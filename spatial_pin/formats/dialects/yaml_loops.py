"""YAML files that state the loops of the URDF beside them.

`robot.yaml`, as the repository example-parallel-robots of Gepetto has it:

    closed_loop: [[FRAME, FRAME], ...]   frames that coincide
    type: ["3d", "6d", ...]              3d: their origins only; otherwise they are welded
    name_mot: [JOINT, ...]               actuated joints
    joint_name: [JOINT, ...]             joints of the URDF whose type is replaced
    joint_type: [SPHERICAL, UJOINT_XY, FIXED, ...]

A `UJOINT_AB` turns about axis A of the joint's frame and then about axis B that turns with it;
FIXED stays at its zero. `urdf` may name the file of the robot. Joints that do not exist are ignored
with a notice, as in their authors' reader: published files have such names.

`loop_closures.yaml`, which sw2robot and scikit-robot write beside the URDF of a cut linkage:

    closures:                            hinges that the tree had to drop
      - {link_a, link_b, point: [x, y, z], axis: [x, y, z]}
    independent: [JOINT, ...]            driven
    dependent: [JOINT, ...]              solved for; a <mimic> of theirs is the loop a second time

Point and axis are in the axes of the root link when all joints are at zero. RoboNex has another
layout under the same name: `pin_loops` and `ball_loops` with the point in the axes of either link
(parent, child, parent_xyz, child_xyz, and the pin's axis), `ball_upgrades` (joints that are balls)
and `actuated_joints`.
"""

from __future__ import annotations

import os
import re
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.dialects.robot import RobotReading
from spatial_pin.formats.file_access import Trust, is_file, read_text, shown
from spatial_pin.numerics.linalg import Array

ROBOT_NAMES = ("type", "name_mot", "joint_name", "joint_type")
URDF = ("urdf", "name_urdf", "urdf_file")
ENDINGS = (".yaml", ".yml")
UNSTATED = re.compile(r"(?P<loop>closedloop\w*?\d+)_?A(?P<kind>_[36]D)?", re.I)
AXES = dict(zip("XYZ", np.eye(3).tolist(), strict=True))
SOURCE = "closed_loop"
NAME = "loop_closures.yaml"
LOOPS = ("closures", "pin_loops", "ball_loops")
CLOSURE_NAMES = ("independent", "dependent", "ball_upgrades", "actuated_joints")
LIMITS = ("ball_limit_deg",)  # how far a ball swings: a limit of what closes, which has none here
LARGEST_COORDINATE = 1e300  # of a coordinate; whole numbers may be beyond float
ROOT = "base_link"  # what sw2robot calls the root, whatever its name


def table_of(path: Path) -> dict[str, Any]:
    """Return the table that a YAML file holds; an empty one where it holds something else."""
    from spatial_pin.formats.xacro.yaml_files import read_yaml  # on use: yaml takes 20 ms to import

    content = read_yaml(path, float)
    return content if isinstance(content, dict) else {}


def lists_of(table: dict[str, Any], keys: tuple[str, ...], names: tuple[str, ...],
             path: Path) -> dict[str, list[Any]]:
    """Return the lists of a table, empty where a key is missing."""
    for key, value in table.items():
        if key not in keys:
            raise MechanismFileError(f"{shown(path)}: {str(key)[:60]} is not a key of such a file; "
                                     f"there are: {', '.join(keys)}")
        if value is not None and not isinstance(value, list):
            raise MechanismFileError(f"{shown(path)}: {key} must be a list")
        if key in names and not all(isinstance(name, str) for name in value or ()):
            raise MechanismFileError(f"{shown(path)}: {key} must be a list of names")
    return {key: table.get(key) or [] for key in keys}


def is_robot(path: Path) -> bool:
    """Return whether a YAML file is one, or looks like one: reading then names its mistakes."""
    try:
        return SOURCE in table_of(path)
    except MechanismFileError:
        pass
    try:
        return SOURCE in read_text(path)
    except MechanismFileError:
        return False


def urdf_of(path: Path, trust: Trust | None = None) -> Path:
    """Return the URDF that a `robot.yaml` is about: named in it, of its name, or the only one."""
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
    files = sorted(path.parent.glob("*.urdf"))
    if len(files) != 1:
        raise MechanismFileError(f"{shown(path)}: {len(files)} .urdf files beside it, none of its "
                                 f"name; write \"urdf: NAME.urdf\" into it")
    return files[0]


def robot_file(urdf: Path) -> Path | None:
    """Return the YAML file beside a URDF that is about it."""
    own = [urdf.with_suffix(ending) for ending in ENDINGS]
    shared = [urdf.parent / f"robot{ending}" for ending in ENDINGS]
    for path in dict.fromkeys([*own, *shared]):
        if Trust.of(urdf).allows(path) and is_robot(path) and os.path.realpath(
                urdf_of(path)) == os.path.realpath(urdf):
            return path
    return None


def note_unstated(reading: RobotReading) -> None:
    """Note frames that are named as the ends of loops, where no file states these loops."""
    links = reading.links
    ends = [link for link in reading.links if UNSTATED.fullmatch(link)
            and UNSTATED.sub(r"\g<loop>_B\g<kind>", link) in links]
    if ends:
        reading.notices.append(f"{', '.join(ends)}: frames called like the ends of loops, and no "
                               "robot.yaml beside it says so: these loops are open; write that "
                               "file, or [[closures]] in a .toml file")


def read_robot(path: Path, reading: RobotReading) -> None:
    """Read a `robot.yaml`."""
    table = {key: value for key, value in table_of(path).items() if key not in URDF}
    lists = lists_of(table, (SOURCE, *ROBOT_NAMES), ROBOT_NAMES, path)
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
        same = takewhile(lambda letters: letters[0] == letters[1], zip(*pair, strict=False))
        name = "".join(a for a, _ in same).rstrip("_- ") or f"closed_loop_{k + 1}"
        kind = "spherical" if lists["type"] and lists["type"][k].lower() == "3d" else "weld"
        reading.add("closures", {"name": name, "type": kind, "frames": pair,
                                 "source": f"closed_loop of {path.name}"})
    if lists["name_mot"]:
        reading.content["drivers"], reading.all_driven = {}, True
    for motor in lists["name_mot"]:
        if motor in reading.joints:
            reading.drive(motor)
        else:
            reading.notices.append(f"{path.name}: name_mot: there is no joint {motor!r}; it drives "
                                   "nothing")


def _read_types(lists: dict[str, list[Any]], path: Path, reading: RobotReading) -> None:
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


def closures_file(urdf: Path) -> Path | None:
    """Return the file that is about a URDF: beside it, or in the package of its `urdf` folder."""
    folders, home = [urdf.parent], urdf.parent
    if urdf.parent.name == "urdf":
        home = urdf.parent.parent
        folders += [home, home / "config"]
    trust = Trust(home.resolve())
    return next((path for folder in folders if trust.allows(path := folder / NAME)), None)


def is_closures(path: Path) -> bool:
    """Return whether a file is one, by its name."""
    return path.name == NAME


def read_closures(path: Path, reading: RobotReading) -> None:
    """Read a `loop_closures.yaml`."""
    table = {key: value for key, value in table_of(path).items() if key not in LIMITS}
    lists = lists_of(table, (*LOOPS, *CLOSURE_NAMES), CLOSURE_NAMES, path)
    loops = [entry for key in LOOPS for entry in lists[key] if isinstance(entry, dict)]
    named = {entry[key] for entry in loops for key in ("link_a", "link_b", "parent", "child")
             if isinstance(entry.get(key), str)}
    if named and not named & reading.links.keys():
        reading.notices.append(f"{path.name} beside it is about other links, "
                               f"{', '.join(sorted(named))}: its loops are not closed here")
        return
    for key, kind in zip(LOOPS, ("revolute", "revolute", "spherical"), strict=True):
        for k, content in enumerate(lists[key]):
            _close(content, kind, f"{path.name}: {key}[{k}]", reading, key != "closures")
    for name in lists["ball_upgrades"]:
        reading.joint(name, f"ball_upgrades of {path.name}")
        reading.refine(name, type="spherical")
    motors = [*lists["independent"], *lists["actuated_joints"]]
    if motors:
        reading.content["drivers"], reading.all_driven = {}, True
    for name in motors:
        reading.joint(name, f"{path.name}")
        reading.drive(name)
    for name in lists["dependent"]:
        reading.joint(name, f"dependent of {path.name}")
    reading.drop_mimics(lists["dependent"], f"{path.name} has the loop itself; the <mimic> is "
                                            "a copy or an approximation of it")


def _close(given: Any, kind: str, where: str, reading: RobotReading, by_links: bool) -> None:
    """Close a loop whose point is given on both links, or with its axis in the root's axes."""
    content, source = given if isinstance(given, dict) else {}, where.partition(":")[0]

    def link(key: str) -> str:
        name = content.get(key)
        if name == ROOT and ROOT not in reading.links:
            name = reading.root
        return reading.link(name if isinstance(name, str) else None, where)

    def vector(key: str) -> Array:
        value = content.get(key)
        if not (isinstance(value, list) and len(value) == 3 and all(
                isinstance(x, int | float) and abs(x) <= LARGEST_COORDINATE for x in value)):
            raise MechanismFileError(f"{shown(reading.path)}: {where}: {key} must be three finite "
                                     "numbers")
        return np.array(value, dtype=float)

    world, axes = reading.world, None
    if by_links:
        links = [link("parent"), link("child")]
        ends = [(name, pin.SE3(np.eye(3), vector(f"{side}_xyz")))
                for name, side in zip(links, ("parent", "child"), strict=True)]
    else:
        links, at = [link("link_a"), link("link_b")], pin.SE3(np.eye(3), vector("point"))
        ends = [(name, world[name].actInv(at)) for name in links]
    if kind == "revolute":
        one = other = reading.unit(vector("axis"), where)
        if by_links:
            other = world[links[1]].rotation.T @ world[links[0]].rotation @ one
        axes = one, other
    reading.close(str(content.get("name") or "__".join(links)), kind, source, ends, axes)
