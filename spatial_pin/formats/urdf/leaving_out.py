"""What is left out of a file because `load(..., without=[...])` names it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.urdf.elements import local

BODIES = ("link", "body", "model", "robot", "world")  # which joints of the same name are not


def without_it(element: ET.Element) -> str:
    """Return how one goes on without an element, for the message that it cannot be read."""
    return go_on(element.get("name") or local(element))


def go_on(name: str) -> str:
    """Return how one goes on without what has a name, for the message that it cannot be read."""
    return f"load(..., without=[{name!r}]) goes on without it"


def leave_out(root: ET.Element, names: Iterable[str], where: str) -> list[str]:
    """Take elements out of an XML file, by their names or tags; links and bodies stay.

    Args:
        root: the file's root element.
        names: of what is taken out.
        where: the file, for errors.

    Returns:
        A notice of what was taken out.

    Raises:
        MechanismFileError: nothing has one of the names.
    """
    wanted = dict.fromkeys(names)
    matches: dict[str, list[str]] = {name: [] for name in wanted}
    known: dict[str, None] = {}
    for parent in list(root.iter()) if wanted else ():
        for element in list(parent):
            if not isinstance(element.tag, str) or local(element) in BODIES:
                continue
            own = [x for x in (element.get("name"), local(element)) if x]
            known.update(dict.fromkeys(own))
            for name in set(own) & wanted.keys():
                matches[name].append(local(element))
                if element in list(parent):
                    parent.remove(element)
    return notice_of(matches, known, where)


def notice_of(matches: dict[str, list[str]], known: Iterable[str], where: str) -> list[str]:
    """Return a notice of what was left out; none where nothing was to be.

    Args:
        matches: kinds of what was left out, by the name that it has.
        known: names that could have been given.
        where: the file, for errors.

    Raises:
        MechanismFileError: nothing has one of the names.
    """
    for name, kinds in matches.items():
        if not kinds:
            raise MechanismFileError(f"{where}: without: there is no element or joint {name!r}; "
                                     f"{suggestion(name, known)}")
    parts = [f"{name!r} ({', '.join(sorted(set(kinds)))})" for name, kinds in matches.items()]
    return [f"left out by load(..., without=...): {', '.join(parts)}"] if parts else []
