"""`<constraint>` with parent and child, each with an origin and an axis of its own.

    <constraint name type>
      <parent link/> <parent_origin xyz rpy/> <parent_axis xyz/>
      <child link/> <child_origin xyz rpy/> <child_axis xyz/>

The type is that of a joint, with or without "_joint" behind it; of a cut link it is "link", which
holds both frames together. The child's axis is the parent's where it is not stated; of a universal
joint the axes are the pin in the parent and the pin in the child. An older form,
`<loop_constraint>`, has no type: a common point.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from spatial_pin.formats.dialects import urdf_plus
from spatial_pin.formats.dialects.reading import Reading
from spatial_pin.numerics.linalg import Array

SIDES = ("parent", "child")
OTHERS = {None: "spherical", "position": "spherical", "link": "weld"}  # types that are no joints


def read_constraint(element: ET.Element, reading: Reading) -> None:
    """Read a `<constraint>`; one with predecessor and successor is URDF+."""
    if element.find("predecessor") is not None:
        urdf_plus.read_constraint(element, reading)
        return
    stated = element.get("type")
    kind = OTHERS[stated] if stated in OTHERS else reading.pair(element)
    ends, axes = [], list[Array]()
    for side in SIDES:
        found = element.find(side)
        if found is None:
            raise reading.fail(element, f"has no <{side} link=...>")
        link = reading.link(found.get("link"), element)
        ends.append((link, reading.placement(element.find(f"{side}_origin"), element)))
        own = element.find(f"{side}_axis")
        own = own if own is not None else element.find("axis")
        follows = own is None and axes and kind != "universal"
        axes.append(axes[0] if follows else reading.axis(own, element))
    name, source = reading.name_of(element), "URDF <constraint>"
    if kind == "universal":
        reading.close(name, kind, source, ends, axis=axes[0].tolist(), axis2=axes[1].tolist())
    else:
        reading.close(name, kind, source, ends, (axes[0], axes[1]))
