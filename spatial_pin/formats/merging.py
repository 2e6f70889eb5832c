"""A mechanism file and what its tree states itself: both hold, the mechanism file goes first."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

LISTS = ("closures", "springs")
TABLES = ("joints", "frames", "guess")
SAME = "that is the same"


def merged(own: Mapping[str, Any], stated: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return the content of both, and what was left out, a sentence each.

    Args:
        own: what the mechanism file says, as `tomllib` reads it.
        stated: what the file of its tree says beside the tree.

    Returns:
        The mechanism file's keys; a loop of the tree's file too, unless the mechanism file has a
        closure of that name or between the same frames; its drivers, unless the mechanism file
        names any.
    """
    both, notices = {**stated, **own}, []
    for key in LISTS:
        mine = own.get(key, [])
        others = []
        for entry in stated.get(key, ()):
            reason = _replaced(entry, mine)
            if reason == SAME:
                continue
            if reason:
                notices.append(f"{key}: {entry['name']!r} ({entry.get('source') or 'of the tree'}) "
                               f"is left out: the mechanism file has one {reason}")
            else:
                others.append(entry)
        if others and isinstance(mine, list):
            both[key] = [*mine, *others]
    for key in TABLES:
        mine = own.get(key, {})
        if isinstance(mine, dict) and stated.get(key):
            both[key] = {**stated[key], **mine}
    for name, table in stated.get("joints", {}).items():
        mine = both["joints"].get(name) if isinstance(both.get("joints"), dict) else None
        if isinstance(mine, dict) and "type" not in mine:
            both["joints"][name] = {**table, **mine}
    return both, notices


def without_loops_and_motors(stated: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a tree's file says of joints and frames, where a mechanism file is complete."""
    return {key: x for key, x in stated.items() if key not in (*LISTS, "drivers", "passive",
                                                               "guess")}


def _replaced(entry: Mapping[str, Any], mine: Any) -> str:
    """Return why an entry gives way to one of the mechanism file's, "" where it does not."""
    for other in mine if isinstance(mine, list) else ():
        if isinstance(other, dict) and other.get("name") == entry["name"]:
            same = all(other.get(key) == entry.get(key) for key in ("type", "frames", "joints"))
            return SAME if same else "of that name"
        frames = other.get("frames") if isinstance(other, dict) else None
        if isinstance(frames, list) and frames in (entry.get("frames"),
                                                   entry.get("frames", [])[::-1]) and frames:
            return f"between the same frames: {other.get('name')!r}"
    return ""
