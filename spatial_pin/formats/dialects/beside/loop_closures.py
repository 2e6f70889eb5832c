"""`loop_closures.yaml`, which sw2robot and scikit-robot write beside the URDF of a cut linkage.

    closures:                            hinges that the tree had to drop
      - {link_a, link_b, point: [x, y, z], axis: [x, y, z]}
    independent: [JOINT, ...]            driven
    dependent: [JOINT, ...]              solved for; a <mimic> of theirs says the loop a second time

Point and axis are in the axes of the root link when all joints are at zero. RoboNex has another
layout under the same name: `pin_loops` and `ball_loops` with the point in the axes of either link
(parent, child, parent_xyz, child_xyz, and the pin's axis), `ball_upgrades` (joints that are balls)
and `actuated_joints`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.dialects.beside.files import lists_of, table_of
from spatial_pin.formats.dialects.reading import Reading
from spatial_pin.formats.sources import Trust, shown
from spatial_pin.numerics.linalg import Array

NAME = "loop_closures.yaml"
LOOPS = ("closures", "pin_loops", "ball_loops")
NAMES = ("independent", "dependent", "ball_upgrades", "actuated_joints")
LIMITS = ("ball_limit_deg",)  # how far a ball swings: a limit of what closes, which has none here
LARGEST_COORDINATE = 1e300  # of a coordinate; whole numbers may be beyond float
ROOT = "base_link"  # what sw2robot calls the root, whatever its name


def file_of(urdf: Path) -> Path | None:
    """Return the file that is about a URDF: beside it, or in the package of its `urdf` folder."""
    folders, home = [urdf.parent], urdf.parent
    if urdf.parent.name == "urdf":
        home = urdf.parent.parent
        folders += [home, home / "config"]
    trust = Trust(home.resolve())
    return next((path for folder in folders if trust.allows(path := folder / NAME)), None)


def is_closures(path: Path) -> bool:
    """Return whether a file is one; its name says so."""
    return path.name == NAME


def read_closures(path: Path, reading: Reading) -> None:
    """Read a `loop_closures.yaml`.

    Raises:
        MechanismFileError: it names what does not exist, or has other keys.
    """
    table = {key: value for key, value in table_of(path).items() if key not in LIMITS}
    lists = lists_of(table, (*LOOPS, *NAMES), NAMES, path)
    named = _links_of(lists)
    if named and not named & reading.links.keys():
        reading.notices.append(f"{path.name} beside it is about other links, "
                               f"{', '.join(sorted(named))}: its loops are not closed here")
        return
    for k, entry in enumerate(lists["closures"]):
        _read_hinge(_Entry(entry, f"closures[{k}]", path, reading), reading.world)
    for key, kind in (("pin_loops", "revolute"), ("ball_loops", "spherical")):
        for k, entry in enumerate(lists[key]):
            _read_pin(_Entry(entry, f"{key}[{k}]", path, reading), kind, reading.world)
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
    reading.drop_mimics(lists["dependent"], f"{path.name} has the loop itself, of which it is a "
                                            "copy or an approximation")


def _links_of(lists: dict[str, list[Any]]) -> set[str]:
    """Return the links that the loops of a file join."""
    entries = [entry for key in LOOPS for entry in lists[key] if isinstance(entry, dict)]
    return {entry[key] for entry in entries for key in ("link_a", "link_b", "parent", "child")
            if isinstance(entry.get(key), str)}


class _Entry:
    """One loop of the file."""

    def __init__(self, content: Any, where: str, path: Path, reading: Reading) -> None:
        self.content = content if isinstance(content, dict) else {}
        self.where, self.reading, self.source = f"{path.name}: {where}", reading, path.name

    def link(self, key: str) -> str:
        name = self.content.get(key)
        if name == ROOT and ROOT not in self.reading.links:
            name = self.reading.root
        return self.reading.link(name if isinstance(name, str) else None, self.where)

    def vector(self, key: str) -> Array:
        value = self.content.get(key)
        numbers = isinstance(value, list) and len(value) == 3 and all(
            isinstance(x, int | float) and abs(x) <= LARGEST_COORDINATE for x in value)
        if not numbers:
            raise MechanismFileError(f"{shown(self.reading.path)}: {self.where}: {key} must be "
                                     "three finite numbers")
        return np.array(value, dtype=float)

    def axis(self) -> Array:
        return self.reading.unit(self.vector("axis"), self.where)


def _read_hinge(entry: _Entry, world: dict[str, pin.SE3]) -> None:
    links = [entry.link("link_a"), entry.link("link_b")]
    at = pin.SE3(np.eye(3), entry.vector("point"))  # as the root stands
    axis = entry.axis()
    name = str(entry.content.get("name") or "__".join(links))
    ends = [(link, world[link].actInv(at)) for link in links]
    entry.reading.close(name, "revolute", entry.source, ends, (axis, axis))


def _read_pin(entry: _Entry, kind: str, world: dict[str, pin.SE3]) -> None:
    links = [entry.link("parent"), entry.link("child")]
    ends = [(link, pin.SE3(np.eye(3), entry.vector(f"{side}_xyz")))
            for link, side in zip(links, ("parent", "child"), strict=True)]
    axes = None
    if kind == "revolute":
        axis = entry.axis()
        axes = axis, world[links[1]].rotation.T @ world[links[0]].rotation @ axis
    name = str(entry.content.get("name") or "__".join(links))
    entry.reading.close(name, kind, entry.source, ends, axes)
