"""USD: what MuJoCo's schemas say of joints beside UsdPhysics.

Several of its joints between the same two bodies are in series, in the order of the stage, each
about its axis on the second body.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from spatial_pin.formats.graph.joints import Joint, Link
from spatial_pin.formats.usd.stage import Stage

MUJOCO = "MjcJointAPI"
ACTUATOR = "MjcActuator"


def with_resistance(stage: Stage, prim: Any, joint: Joint) -> Joint:
    """Return a joint with damping, dry friction, armature and spring, in SI units."""
    turns = joint.type != "prismatic"
    mass = stage.kilogram * (stage.metre ** 2 if turns else 1.0)
    stiffness = stage.optional(prim, "mjc:stiffness", 0.0) * mass
    if stiffness and (stage.optional(prim, "mjc:springref", 0.0) or joint.type == "spherical"):
        stage.notices.append(f"the spring of joint {joint.name!r} is left out: where it is at rest "
                             "has no unit, or it has several coordinates")
        stiffness = 0.0
    force = mass if turns else stage.kilogram * stage.metre
    return joint.but(
        damping=stage.optional(prim, "mjc:damping", 0.0) * mass,
        friction=stage.optional(prim, "mjc:frictionloss", 0.0) * force,
        armature=stage.optional(prim, "mjc:armature", 0.0) * mass, stiffness=stiffness)


def actuated(stage: Stage, of_path: Mapping[str, str]) -> list[str]:
    """Return the joints that actuators move."""
    found, others = [], []
    for prim in stage.prims():
        if str(prim.GetTypeName()) == ACTUATOR:
            targets = prim.GetRelationship("mjc:target").GetTargets()
            names = [of_path[str(target)] for target in targets if str(target) in of_path]
            found += names
            others += [] if names else [prim.GetName()]
    if others:
        stage.notices.append(f"actuators of no joint are left out: {', '.join(others)}")
    return list(dict.fromkeys(found))


def in_series(joints: Iterable[Joint], named: Collection[str]) -> tuple[list[Link], list[Joint]]:
    """Return joints of which those in series have massless links between them, and these links.

    Args:
        joints: all joints.
        named: those of them that MuJoCo's schemas describe.
    """
    groups: dict[tuple[str, str], list[Joint]] = {}
    for joint in joints:
        key = (joint.parent, joint.child) if joint.name in named else (joint.name, "")
        groups.setdefault(key, []).append(joint)
    links, found = [], []
    for chain in groups.values():
        for k in range(len(chain) - 1):
            this, after = chain[k], chain[k + 1]
            link = f"{this.name}/{after.name}"  # at zero it stands as the second body does
            links.append(Link(link))
            chain[k] = this.but(child=link)
            chain[k + 1] = after.but(parent=link, on_parent=after.on_child)
        found += chain
    return links, found
