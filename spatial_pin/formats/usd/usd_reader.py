"""USD: a stage as a joint graph."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.graph.joint_graph import WORLD, GraphJoint, JointGraph, Link, SpanningTree
from spatial_pin.formats.graph.open_tree import open_tree
from spatial_pin.formats.importers import Imported, Request
from spatial_pin.formats.usd.rigid_bodies import link_elements, read_bodies
from spatial_pin.formats.usd.usd_joints import read_joints
from spatial_pin.formats.usd.usd_stage import UsdStage, leave_out, quietly

SINGLE_PRECISION = 1e-6  # of numbers of 32 bits, after a few of them were put together


def read_stage(request: Request) -> Imported:
    """Read a stage."""
    with quietly(request.path):
        stage = UsdStage(request.path, request.trust)
        stage.notices += leave_out(stage, request.without)
        bodies = read_bodies(stage)
        if not bodies:
            raise MechanismFileError(f"{stage.where}: no rigid body (PhysicsRigidBodyAPI) in it")
        joints, between, driven, couplings = read_joints(stage, bodies)
        links = []
        for body in bodies.values():
            elements, massless = link_elements(stage, body, bodies)
            links.append(Link(body.name, body.placement, elements, massless))
        gravity = stage.gravity().tolist()
    held = [GraphJoint(f"{body.name}_held", "fixed", WORLD, body.name, body.placement)
            for body in bodies.values() if body.held]  # the kinematic bodies
    coupled = frozenset(name for table in couplings for name in table["joints"])
    graph = JointGraph((*links, *between), (*held, *joints), rounding=SINGLE_PRECISION,
                       needed=coupled | set(driven))
    pairs = {joint.name: joint.type for joint in SpanningTree(graph).joints}
    drivers = {x: {"joint": x} for x in driven if pairs.get(x) in ("revolute", "prismatic")}
    others = [x for x in driven if x not in drivers]
    if others:
        stage.notices.append("no driver, as it has no single coordinate or closes a loop: "
                             f"{', '.join(others)}")
    content: dict[str, Any] = {
        "name": request.path.stem, "gravity": gravity, "closures": couplings,
        **({"drivers": drivers} if driven else {})}
    graph = replace(graph, needed=coupled | set(drivers))
    return open_tree(graph, stage.where, content, stage.notices)
