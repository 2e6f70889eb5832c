"""Mechanisms of the library whose joints damp, rub and have armatures."""

from __future__ import annotations

from loaded_library import library
from mechanisms import content_of, from_text

import spatial_pin as sp

HARD = {"damping": 0.2, "friction": 0.3, "armature": 0.05, "slip_speed": 0.4}
LISTED = {"damping": [0.1, 0.2, 0.3], "friction": [0.3, 0.1, 0.2], "armature": [0.01, 0.02, 0.03],
          "slip_speed": [0.5, 0.6, 0.7]}
CASES = [("four_bar", {"crank_pin": HARD}), ("rssr", {"crank_pin": HARD, "ball_a": LISTED}),
         ("screw_press", {}), ("rspc", {"crank_pin": HARD}), ("stewart", {}), ("delta", {})]


def resisting(mech: sp.Mechanism, **joints) -> sp.Mechanism:
    """The same mechanism with keys of [joints.X] added."""
    content = content_of(mech)
    for name, keys in joints.items():
        content.setdefault("joints", {}).setdefault(name, {}).update(keys)
    return from_text(mech.urdf, content, "here.toml")


def hard(name, joints):
    """A library mechanism that resists, at all its joints where none are named."""
    mech = library(name)
    return resisting(mech, **(joints or dict.fromkeys(list(mech.model.names)[1:], HARD)))
