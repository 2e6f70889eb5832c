"""The dialects in which a URDF, or a file beside it, states loops.

To add one: write a module whose reader takes the element and the `Reading`, and name it here by
its element; what is recognised otherwise is a line in `read_dialects`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

from spatial_pin.formats.dialects import (
    actuators,
    drake,
    gazebo,
    gazebo_links,
    isaac,
    onshape,
    ros,
    unknown,
    urdf_plus,
)
from spatial_pin.formats.dialects.beside import gepetto, loop_closures
from spatial_pin.formats.dialects.reading import Reading
from spatial_pin.formats.urdf.elements import is_prefixed, local

Reader = Callable[[ET.Element, Reading], None]

ELEMENTS: dict[str, Reader] = {  # directly in <robot>; they are taken out
    "loop": urdf_plus.read_loop,
    "coupling": urdf_plus.read_coupling,
    "constraint": ros.read_constraint,
    "loop_constraint": ros.read_constraint,
    "loop_joint": isaac.read_loop_joint,
    "ball_constraint": drake.read_ball,
    "distance_constraint": drake.read_distance,
    "linear_spring_damper": drake.read_spring,
    "linear_bushing_rpy": drake.refuse,
    "tendon_constraint": drake.refuse,
}
LEFT: dict[str, Reader] = {  # they stay in the URDF
    "gazebo": gazebo.read_gazebo,
    "transmission": actuators.read_transmission,
    "ros2_control": actuators.read_ros2_control,
}
BESIDE: tuple[tuple[Callable[[Path], Path | None], Callable[[Path], bool],
                    Callable[[Path, Reading], None]], ...] = (  # which is looked for, is it, read
    (gepetto.file_of, gepetto.is_robot, gepetto.read_robot),
    (loop_closures.file_of, loop_closures.is_closures, loop_closures.read_closures),
)


def read_dialects(reading: Reading, beside: Path | None = None) -> None:
    """Read all that states loops and motors in a robot and beside its file.

    Args:
        reading: the robot.
        beside: a file beside it, if that is known; else it is looked for.

    Raises:
        MechanismFileError: an element joins links in a way that is not known, or cannot be read.
    """
    for element in reading.take(lambda e: local(e) == "joint" and is_prefixed(e)):
        drake.read_joint(element, reading)
    gazebo_links.hang_links(reading)
    for element in list(reading.robot):
        if isinstance(element.tag, str) and local(element) in LEFT:
            LEFT[local(element)](element, reading)
    for element in reading.take(lambda e: local(e) in ELEMENTS):
        ELEMENTS[local(element)](element, reading)
    urdf_plus.read_independent(reading)
    onshape.read_frames(reading)
    for file_of, states, read in BESIDE:
        path = beside if beside is not None and states(beside) else file_of(reading.path)
        if path is not None:
            read(path, reading)
    unknown.refuse_unread(reading)
    unknown.tell_copies(reading)
    if not reading.content.get("closures"):  # all joints of a tree drive it, motors or not
        reading.content.pop("drivers", None)
    elif not reading.all_driven:
        actuators.drive_the_rest(reading)
