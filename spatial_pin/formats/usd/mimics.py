"""USD: joints that mimic others, as PhysX and Newton state it, as couplings of coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pxr import UsdPhysics

from spatial_pin.formats.urdf.leaving_out import go_on
from spatial_pin.formats.usd.stage import DEGREE, Stage, applied

PHYSX, NEWTON, EQUALITY = "PhysxMimicJointAPI", "NewtonMimicAPI", "MjcEqualityJointAPI"


def mimics(stage: Stage, prim: Any, name: str, of_path: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return the mimics that a joint states, as a mechanism file has couplings.

    Args:
        stage: the stage.
        prim: of the joint.
        name: of the joint.
        of_path: names of all joints by path.

    Raises:
        MechanismFileError: one is of a kind that is not known, or names no joint that it could be.
    """
    found = []
    for schema in applied(prim):
        kind, _, freedom = schema.partition(":")
        if kind == PHYSX:  # coordinate + gearing * other's + offset = 0
            start = f"physxMimicJoint:{freedom}"
            sign, words = -1.0, (f"{start}:referenceJoint", f"{start}:gearing", f"{start}:offset")
        elif kind == NEWTON:  # coordinate = coef0 + coef1 * other's
            if prim.GetAttribute("newton:mimicEnabled").Get() is False:
                continue
            sign, words = 1.0, ("newton:mimicJoint", "newton:mimicCoef1", "newton:mimicCoef0")
        elif kind == EQUALITY:  # the same, its offset in radians
            if any(stage.optional(prim, f"mjc:coef{k}", 0.0) for k in (2, 3, 4)):
                stage.fail(prim, f"{schema}: a coupling of higher order than one is not read")
            if NEWTON in applied(prim):  # which says the rest
                continue
            sign, words = 1.0, ("mjc:target", "mjc:coef1", "mjc:coef0")
        elif "Mimic" in kind:
            stage.fail(prim, f"{schema} couples joints and is not read; {go_on(prim.GetName())}")
        else:
            continue
        other, unit = _leader(stage, prim, schema, words[0])
        unit = 1.0 if kind == EQUALITY and unit == DEGREE else unit
        if str(other.GetPath()) not in of_path:
            stage.fail(prim, f"{schema}: {other.GetPath()} is no joint")
        found.append({
            "name": f"mimic_{name}", "type": "coupling",
            "joints": [of_path[str(other.GetPath())], name],
            "ratio": sign * stage.optional(prim, words[1], 1.0),
            "offset": sign * stage.optional(prim, words[2], 0.0) * unit})
    return found


def _leader(stage: Stage, prim: Any, schema: str, relationship: str) -> tuple[Any, float]:
    """Return the joint that is mimicked, and the unit of both coordinates [rad, m]."""
    targets = prim.GetRelationship(relationship).GetTargets()
    other = stage.usd.GetPrimAtPath(targets[0]) if len(targets) == 1 else None
    if not other:
        stage.fail(prim, f"{schema}: {relationship} must be one joint")
    units = ((UsdPhysics.RevoluteJoint, DEGREE), (UsdPhysics.PrismaticJoint, stage.metre))
    for kind, unit in units:
        if prim.IsA(kind) and other.IsA(kind):
            return other, unit
    stage.fail(prim, f"{schema}: it couples a joint that turns with one that slides, or other "
                     "joints than these; that is not read")
