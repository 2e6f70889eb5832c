"""Inertias that no body has: below zero, or with a moment above the sum of the other two."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

ROUNDED = 1e-6  # of mass times length squared: inertias are written with six digits or more


class Impossible(NamedTuple):
    """Inertias of moving bodies that no body has, by the link at fault, in words.

    Attributes:
        negative: a mass or a principal moment of inertia is below zero.
        lopsided: a principal moment is more than the sum of the other two.
    """

    negative: dict[str, str]
    lopsided: dict[str, str]


def impossible_inertias(mechanism: Mechanism) -> Impossible:
    """Return the links whose bodies have inertias that no body has.

    Links that are fixed to one another are one body, of which it is judged; what round-off of the
    file's numbers can do to a moment, relative to mass times length squared, is let pass.
    """
    if "impossible inertias" not in mechanism.memo:
        mechanism.memo["impossible inertias"] = _impossible(mechanism)
    found: Impossible = mechanism.memo["impossible inertias"]
    return found


def refuse_negative_inertias(mechanism: Mechanism) -> None:
    """Refuse to work with a body whose mass, or a moment of inertia, is below zero.

    Raises:
        SpatialPinError: there is one; names the link.
    """
    for link, words in impossible_inertias(mechanism).negative.items():
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: link {link!r} has {words}: below zero, which no body "
            "has, so that no forces come of it; mend its <inertial>")


def _impossible(mechanism: Mechanism) -> Impossible:
    model, length = mechanism.model, mechanism.characteristic_length
    found = Impossible({}, {})
    for kinds, kind in zip(_kinds(list(model.inertias)[1:], length), found, strict=True):
        for joint in map(int, np.flatnonzero(kinds) + 1):
            links = [f.name for f in model.frames
                     if f.type == pin.FrameType.BODY and f.parentJoint == joint]
            own = [x for x in links if x in mechanism.inertias]
            at_fault = [x for x in own if np.any(_kinds([mechanism.inertias[x]], length))]
            for name in at_fault or own[:1] or [model.names[joint]]:
                kind[name] = _words(mechanism.inertias.get(name, model.inertias[joint]))
    return found


def _kinds(bodies: list[pin.Inertia], length: float) -> Array:
    """Return which bodies have negative, and which else lopsided inertias, shape (2, N)."""
    mass = np.array([x.mass for x in bodies])
    a, b, c = np.linalg.eigvalsh(np.array([x.inertia for x in bodies]).reshape(-1, 3, 3)).T
    slack = ROUNDED * np.maximum(np.maximum(abs(a), abs(c)), abs(mass) * length**2)
    negative = (mass < 0.0) | (a < -slack)
    return np.array([negative, ~negative & (a + b < c - slack)])


def _words(body: pin.Inertia) -> str:
    moments = ", ".join(f"{x:.4g}" for x in np.linalg.eigvalsh(body.inertia))
    return f"mass {body.mass:.4g} kg, principal moments {moments} kg·m²"


def has_inertia(mechanism: Mechanism) -> bool:
    """Whether anything that moves has a mass, a moment of inertia or an armature."""
    if "has inertia" not in mechanism.memo:
        model = mechanism.model
        bodies = (x for x in list(model.inertias)[1:] if x.mass or np.any(x.inertia))
        mechanism.memo["has inertia"] = bool(
            np.any(model.armature) or next(bodies, None) is not None)
    found: bool = mechanism.memo["has inertia"]
    return found
