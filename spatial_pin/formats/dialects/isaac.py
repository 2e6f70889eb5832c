"""`<loop_joint>` of Isaac Sim's URDF importer, and of Drake and RigidBodyDynamics.jl before it.

    <loop_joint name type>
      <link1 link xyz rpy/>
      <link2 link xyz rpy/>
      <axis xyz/>

The joint's frame in the axes of either link; Isaac itself keeps the spherical ones only. Its
manual writes `<link1>` twice.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from spatial_pin.formats.dialects.reading import Reading


def read_loop_joint(element: ET.Element, reading: Reading) -> None:
    """Read a `<loop_joint>`."""
    found = [e for e in element if e.tag in ("link1", "link2")]
    if len(found) != 2:
        raise reading.fail(element, f"joins {len(found)} links; it needs <link1> and <link2>")
    found.sort(key=lambda e: str(e.tag))  # <link1> first, the order of two alike stays
    axis = reading.axis(element.find("axis"), element)
    ends = [(reading.link(e.get("link"), element), reading.placement(e, element)) for e in found]
    reading.close(reading.name_of(element), reading.pair(element), "Isaac <loop_joint>", ends,
                  (axis, axis))
