"""What a page of the documentation tells of any mechanism: its loops and its mobility."""

from __future__ import annotations

import warnings

import spatial_pin as sp


def loops(mechanism: sp.Mechanism) -> str:
    """Return the table of a mechanism's closures, Markdown; empty without any."""
    rows = "\n".join(f"| `{c.name}` | {c.type} | {', '.join(c.frames or c.joints)} |"
                     for c in mechanism.closures)
    return f"## Loops\n\n| closure | type | between |\n|---|---|---|\n{rows}" if rows else ""


def mobility(mechanism: sp.Mechanism, state: sp.State | None = None) -> str:
    """Return the report of a mechanism's mobility, Markdown; at its assembled guess, or a state."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sp.SpatialPinWarning)
        return f"## Mobility\n\n```text\n{sp.mobility(mechanism, state)}\n```"
