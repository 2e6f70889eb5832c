"""URDF and xacro: an open tree, and the loops that dialects state inside it or beside it.

To add a dialect: write a reader that takes the element and the `RobotReading`, and name it here by
its element; a dialect without such an element is a line in `read_dialects`.
"""


from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from pathlib import Path

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.dialects import drake, gazebo, urdf_loops, yaml_loops
from spatial_pin.formats.dialects.robot import RobotReading
from spatial_pin.formats.file_access import ROOT, Trust, parse_urdf, read_text, shown
from spatial_pin.formats.importers import Imported, Request
from spatial_pin.formats.urdf.elements import end_of, is_prefixed, leave_out, local, without_it
from spatial_pin.formats.xacro.expansion import expand

KNOWN = ("link", "joint", "material", "transmission", "ros2_control")  # elements that are read
HARMLESS = (  # they name links, and join none: drawing, sensing, contact, planning
    "sensor", "camera", "mujoco_camera", "frame", "fixed_frame", "mujoco", "collision_filter_group",
    "collision_filter_groups", "disable_collisions", "enable_collisions",
    "disable_default_collisions", "link_sphere_approximation", "group", "chain", "group_state",
    "end_effector", "virtual_joint", "passive_joint", "joint_property", "self_collision_checking",
)
ROLES = (  # names of the two ends of a joint
    ("parent", "child"), ("predecessor", "successor"), ("link1", "link2"), ("link_1", "link_2"),
    ("link_a", "link_b"), ("linka", "linkb"), ("body1", "body2"), ("body_1", "body_2"),
    ("body_a", "body_b"), ("bodya", "bodyb"), ("body0", "body1"), ("link0", "link1"),
    ("frame1", "frame2"), ("frame_a", "frame_b"), ("framea", "frameb"), ("site1", "site2"),
    ("parent_link", "child_link"), ("base_link", "follower_link"), ("from", "to"),
)
Reader = Callable[[ET.Element, RobotReading], None]

ELEMENTS: dict[str, Reader] = {  # directly in <robot>; they are taken out
    "loop": urdf_loops.read_loop,
    "coupling": urdf_loops.read_coupling,
    "constraint": urdf_loops.read_constraint,
    "loop_constraint": urdf_loops.read_constraint,
    "loop_joint": urdf_loops.read_loop_joint,
    "ball_constraint": drake.read_ball,
    "distance_constraint": drake.read_distance,
    "linear_spring_damper": drake.read_spring,
    "linear_bushing_rpy": drake.refuse,
    "tendon_constraint": drake.refuse,
}
LEFT: dict[str, Reader] = {  # they stay in the URDF
    "gazebo": gazebo.read_gazebo,
    "transmission": urdf_loops.read_transmission,
    "ros2_control": urdf_loops.read_ros2_control,
}
TRUE = ("true", "1")  # values of the attribute `independent`
BESIDE: tuple[tuple[Callable[[Path], Path | None], Callable[[Path], bool],
                    Callable[[Path, RobotReading], None]], ...] = (  # where is it, is it, read
    (yaml_loops.robot_file, yaml_loops.is_robot, yaml_loops.read_robot),
    (yaml_loops.closures_file, yaml_loops.is_closures, yaml_loops.read_closures),
)
WORLD = "world"
FOLDERS = ("", "urdf", "robots")  # where in a folder, or package, its URDF lies


def refuse_unread(reading: RobotReading) -> None:
    """Refuse elements that nobody reads and that join links.

    Directly in the robot these are all that name two links and are not known to be harmless; in
    `<gazebo>`, where plugins name links for many reasons, those whose two ends are named as the
    ends of a joint are.
    """
    links = reading.links.keys()
    for joint in reading.robot.findall("joint"):
        for role in ("parent", "child"):
            if len(joint.findall(role)) > 1:
                raise reading.fail(joint, f"has several <{role}>; a joint joins two links")
    for element in reading.robot:
        if not isinstance(element.tag, str) or local(element) in (*KNOWN, *HARMLESS):
            continue
        if local(element) == "gazebo":
            for inner in element.iter():
                _refuse(inner, _ends(inner, links), reading)
        else:
            _refuse(element, list(dict.fromkeys(_named(element, links))), reading)


def _refuse(element: ET.Element, ends: list[str], reading: RobotReading) -> None:
    if len(ends) > 1:
        raise reading.fail(element, f"joins the links {', '.join(map(repr, ends))} in a way that "
                                    "is not known, and a loop is never dropped: take it out, or "
                                    "write a [[closures]] entry for it in a .toml file instead; "
                                    f"{without_it(element)}")


def _named(element: ET.Element, links: Collection[str]) -> Iterator[str]:
    """Yield the links that an element names, at any depth; "joint" in a key names joints."""
    for inner in element.iter():
        if not isinstance(inner.tag, str) or (inner is not element and "joint" in local(inner)):
            continue
        for key, value in inner.attrib.items():
            own_name = inner is element and key == "name"
            if value in links and "joint" not in key and not own_name:
                yield value
        if (inner.text or "").strip() in links:
            yield (inner.text or "").strip()


def _ends(element: ET.Element, links: Collection[str]) -> list[str]:
    """Return the links at the ends that an element itself gives, as attributes or children."""
    named = {key.lower(): value for key, value in element.attrib.items() if value in links}
    for child in element:
        if isinstance(child.tag, str):
            values = (*child.attrib.values(), (child.text or "").strip())
            named.update((local(child).lower(), value) for value in values if value in links)
    for role in ROLES:
        if all(key in named for key in role):
            return list(dict.fromkeys(named[key] for key in role))
    return []


def read_dialects(reading: RobotReading, loops_file: Path | None = None) -> None:
    """Read all that states loops and motors in a robot, and beside its file or in a known file."""
    for element in reading.take(lambda e: local(e) == "joint" and is_prefixed(e)):
        drake.read_joint(element, reading)
    if reading.robot.find("gazebo") is not None:
        gazebo.hang_links(reading)
    for element in list(reading.robot):
        if isinstance(element.tag, str) and local(element) in LEFT:
            LEFT[local(element)](element, reading)
    for element in reading.take(lambda e: local(e) in ELEMENTS):
        ELEMENTS[local(element)](element, reading)
    for name in [k for k, x in reading.joints.items() if x.get("independent", "").lower() in TRUE]:
        reading.drive(name)
        reading.all_driven = True
    urdf_loops.read_closing_frames(reading)
    for file_of, states, read in BESIDE:
        is_known = loops_file is not None and states(loops_file)
        path = loops_file if is_known else file_of(reading.path)
        if path is not None:
            read(path, reading)
    refuse_unread(reading)
    if reading.content.get("closures"):
        urdf_loops.note_copies(reading)
        urdf_loops.drive_the_rest(reading)
    else:  # all joints of a tree drive it, motors or not
        reading.content.pop("drivers", None)


def is_urdf(path: Path) -> bool:
    """Return whether a file is a URDF, by its name or the name of its root element."""
    if path.suffix.lower() != ".xml":
        return True
    try:
        root = ROOT.match(read_text(path))
    except MechanismFileError:  # in an encoding that other formats may know
        return False
    return root is not None and root[0].endswith("<robot")


def read_urdf(request: Request, loops_file: Path | None = None) -> Imported:
    """Read a URDF or xacro file; its loops are in `loops_file`, or that is looked for."""
    text = expand(request) if request.expanded is None else request.expanded
    robot = parse_urdf(text, request.path)
    notices = []
    if request.path.suffix != ".xacro" and "${" in text and (written := re.search(
            r"\$\{[^}]*\}", ET.tostring(robot, encoding="unicode"))):
        notices.append(f"{written[0]} is in it as text: xacro puts values in, where "
                       "the file's name ends in .urdf.xacro")
    notices += leave_out(robot, request.without, str(request.path)) if request.without else []
    links = {link.get("name") for link in robot.findall("link")}
    named = {end_of(x, "parent") for x in robot.iter() if local(x) == "joint"}
    named |= {x.get("name", "") for x in robot.iter() if local(x).endswith(("_body_A", "_body_B"))}
    if WORLD in named - links:  # as Drake has it
        robot.insert(0, ET.Element("link", name=WORLD))
        notices.append(f"link {WORLD!r} is not defined: it is the ground")
    reading = RobotReading(robot, request.path, notices=notices)
    if request.complete:
        refuse_unread(reading)
    else:
        read_dialects(reading, loops_file)
    if request.alone and not reading.content.get("closures"):
        yaml_loops.note_unstated(reading)
    return Imported(reading.robot, reading.content, tuple(reading.notices))


def is_statement(path: Path) -> bool:
    """Return whether a YAML file states the loops of a URDF."""
    return yaml_loops.is_closures(path) or yaml_loops.is_robot(path)


def read_folder(request: Request) -> Imported:
    """Read the robot of a folder: that of its `robot.yaml`, or its only URDF."""
    folder, trust = request.path, request.trust
    stated = [p for ending in yaml_loops.ENDINGS for p in sorted(folder.glob(f"*{ending}"))
              if trust.allows(p) and yaml_loops.is_robot(p)]
    chosen = stated if len(stated) == 1 else [p for p in stated if p.stem == "robot"][:1]
    urdf = yaml_loops.urdf_of(chosen[0], trust) if chosen else _only(folder, trust)
    return _read(urdf, request, folder.resolve().name, chosen[0] if chosen else None)


def read_statement(request: Request) -> Imported:
    """Read the robot of a YAML file."""
    path = request.path
    if yaml_loops.is_closures(path):
        folder = path.parent.parent if path.parent.name == "config" else path.parent
        trust = Trust.of(folder, request.packages, request.trusted)
        urdf, name = _only(folder, trust), folder.resolve().name
    else:
        urdf = yaml_loops.urdf_of(path, request.trust)
        name = path.resolve().parent.name if path.stem == "robot" else path.stem
    return _read(urdf, request, name, path)


def _read(urdf: Path, request: Request, name: str, statement: Path | None = None) -> Imported:
    imported = read_urdf(replace(request, path=urdf), statement)
    robot = imported.robot(urdf)
    for mesh in robot.iter("mesh"):
        file = mesh.get("filename", "")
        if file and "://" not in file:  # relative to the URDF, not to the file that was loaded
            mesh.set("filename", str(urdf.resolve().parent / file))
    return replace(imported, urdf=robot, content={"name": name, **imported.content})


def _candidates(folder: Path, trust: Trust) -> list[Path]:
    """Return the URDFs of a folder, those of the first place that has any."""
    for part in FOLDERS:
        files = sorted(p for p in (folder / part).glob("*.urdf") if trust.allows(p))
        if files:
            return files
    return []


def _only(folder: Path, trust: Trust) -> Path:
    """Return the URDF of a folder."""
    files = _candidates(folder, trust)
    names = ("robot", folder.resolve().name)
    chosen = files if len(files) == 1 else [p for p in files if p.stem in names][:1]
    if not chosen:
        listed = ", ".join(p.name for p in files) or "none"
        raise MechanismFileError(f"{shown(folder)}: which .urdf is meant? There are: {listed}; "
                                 "load one of them by its own path")
    return chosen[0]


def has_urdf(folder: Path) -> bool:
    """Return whether there is a URDF in a folder."""
    return bool(_candidates(folder, Trust.of(folder)))
