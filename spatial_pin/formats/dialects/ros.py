"""`<constraint>` with parent and child, each with an origin and an axis of its own.

    <constraint name type>
      <parent link/> <parent_origin xyz rpy/> <parent_axis xyz/>
      <child link/> <child_origin xyz rpy/> <child_axis xyz/>

An older form, `<loop_constraint>`, has no type: a common point.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from spatial_pin.formats.dialects import urdf_plus
from spatial_pin.formats.dialects.reading import Reading

SIDES = ("parent", "child")


def read_constraint(element: ET.Element, reading: Reading) -> None:
    """Read a `<constraint>`; one with predecessor and successor is URDF+."""
    if element.find("predecessor") is not None:
        urdf_plus.read_constraint(element, reading)
        return
    kind = "spherical" if element.get("type") in (None, "position") else reading.pair(element)
    ends, axes = [], []
    for side in SIDES:
        found = element.find(side)
        if found is None:
            raise reading.fail(element, f"has no <{side} link=...>")
        link = reading.link(found.get("link"), element)
        ends.append((link, reading.placement(element.find(f"{side}_origin"), element)))
        own = element.find(f"{side}_axis")
        axes.append(reading.axis(own if own is not None else element.find("axis"), element))
    reading.close(reading.name_of(element), kind, "URDF <constraint>", ends, (axes[0], axes[1]))
