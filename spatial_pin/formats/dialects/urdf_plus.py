"""URDF+ (Chignoli et al., 2024): `<loop>`, `<coupling>`, and what they were called before.

    <loop name type>                      <coupling name>
      <predecessor link><origin/>           <predecessor link/>
      <successor link><origin/>             <successor link/>
      <axis xyz/>                           <ratio value/>

An origin is the loop's frame in the axes of its link, the axis holds in both frames. A coupling
says ratio * (angle of the predecessor) = angle of the successor, each counted from the nearest
link that carries both. Before 2024 both were `<constraint type="position">` (a common point) and
`<constraint type="rolling">`. A joint with `independent="true"` is a driver.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pinocchio as pin

from spatial_pin.formats.dialects.reading import Reading

ENDS = (("predecessor",), ("successor", "sucessor"))  # one exporter writes it so


def read_loop(element: ET.Element, reading: Reading) -> None:
    """Read a `<loop>`."""
    axis = reading.axis(element.find("axis"), element)
    reading.close(reading.name_of(element), reading.pair(element), "URDF+ <loop>",
                  _ends(element, reading), (axis, axis))


def read_constraint(element: ET.Element, reading: Reading) -> None:
    """Read a `<constraint>` with predecessor and successor."""
    kind = element.get("type", "")
    if kind == "rolling":
        read_coupling(element, reading)
    elif kind == "position":
        reading.close(reading.name_of(element), "spherical", "URDF+ <constraint>",
                      _ends(element, reading))
    else:
        read_loop(element, reading)


def read_coupling(element: ET.Element, reading: Reading) -> None:
    """Read a `<coupling>` of two joints."""
    ratio = element.find("ratio")
    value = reading.value(ratio, element) if ratio is not None else 1.0
    links = [link for link, _ in _ends(element, reading)]
    chains = reading.between(links)
    if [len(chain) for chain in chains] != [1, 1]:
        found = " and ".join(f"{len(chain)} ({', '.join(chain) or 'none'})" for chain in chains)
        raise reading.fail(element, f"couples {links[0]!r} and {links[1]!r}, with {found} joints "
                                    "between them and the link that carries both; only one and "
                                    "one can be coupled")
    reading.add("closures", {"name": reading.name_of(element), "type": "coupling", "ratio": value,
                             "joints": [chain[0] for chain in chains],
                             "source": "URDF+ <coupling>"})


def read_independent(reading: Reading) -> None:
    """Make drivers of the joints that are said to be independent."""
    for name, joint in reading.joints.items():
        if joint.get("independent", "").lower() in ("true", "1"):
            reading.drive(name)
            reading.all_driven = True


def _ends(element: ET.Element, reading: Reading) -> list[tuple[str, pin.SE3]]:
    ends = []
    for names in ENDS:
        found = next((e for e in element if e.tag in names), None)
        if found is None:
            raise reading.fail(element, f"has no <{names[0]} link=...>")
        link = reading.link(found.get("link") or found.get("name"), element)
        ends.append((link, reading.placement(found.find("origin"), element)))
    return ends

