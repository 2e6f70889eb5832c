"""Drake's constrained dynamics: ball constraints in its SAP solver.

SAP takes discrete steps of a fixed size; its constraints are as stiff as the step allows.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    RevoluteJoint,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
    WeldJoint,
)
from pydrake.systems.analysis import Simulator

from benchmark import cube, ladder
from benchmark.case import Case
from benchmark.rssr import Array

NAME = "Drake"
TIP = np.array([1.0, 0.0, 0.0])


def rod(plant: MultibodyPlant, name: str, mass: float, along: Array, moments: Array) -> RigidBody:
    """Add a rod from its origin to `along`, with moments about its middle."""
    central = RotationalInertia(*moments)
    inertia = SpatialInertia.MakeFromCentralInertia(mass, along / 2.0, central)
    return plant.AddRigidBody(name, inertia)


def hinge(plant: MultibodyPlant, name: str, parent: RigidBody, body: RigidBody, at: RigidTransform,
          axis: Array) -> None:
    frame = parent.body_frame()
    placed = plant.AddFrame(FixedOffsetFrame(f"{name}_at", frame, at))
    plant.AddJoint(RevoluteJoint(name, placed, body.body_frame(), axis))


def ready(plant: MultibodyPlant, pairs: list, g: float) -> SimpleNamespace:
    """Close the loops."""
    plant.mutable_gravity_field().set_gravity_vector([0.0, -g, 0.0])
    for one, p, other, r in pairs:
        plant.AddBallConstraint(one, p, other, r)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    tool = SimpleNamespace(plant=plant, context=context, world=plant.world_frame())
    tool.pairs = [(a.body_frame(), p, b.body_frame(), r) for a, p, b, r in pairs]
    tool.simulator = Simulator(plant, context)
    return tool


def new_plant(h: float) -> MultibodyPlant:
    plant = MultibodyPlant(h)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    return plant


def setup_ladder(h: float) -> SimpleNamespace:
    """Two rods along their x, upright at coordinate 0, and a level coupler."""
    plant, axis = new_plant(h), np.array([0.0, 0.0, 1.0])
    moments = np.array([1e-9, ladder.ROD, ladder.ROD])  # Drake wants physical ones
    up, level = (RollPitchYaw(0.0, 0.0, s * np.pi / 2).ToRotationMatrix() for s in (1, -1))
    first, coupler, last = (rod(plant, name, 1.0, TIP, moments)
                            for name in ("first", "coupler", "last"))
    world = plant.world_body()
    hinge(plant, "first_pin", world, first, RigidTransform(up, [0.0, 0.0, 0.0]), axis)
    hinge(plant, "knee", first, coupler, RigidTransform(level, TIP), axis)
    hinge(plant, "last_pin", world, last, RigidTransform(up, TIP), axis)
    tool = ready(plant, [(coupler, TIP, last, TIP)], ladder.G)
    tool.q, tool.v = np.zeros(3), np.empty(3)
    for name, sign in (("first_pin", -1.0), ("knee", 1.0), ("last_pin", -1.0)):
        tool.v[plant.GetJointByName(name).velocity_start()] = sign * ladder.START
    tool.first = plant.GetJointByName("first_pin").velocity_start()
    return tool


def setup_cube(h: float) -> SimpleNamespace:
    """Close the last hinge by two points on its axis.

    They stand on a post welded to the ground: constraints on the world itself end the process.
    """
    plant = new_plant(h)
    parent, at = plant.world_body(), cube.CORNERS[0]
    for i, (axis, edge) in enumerate(zip(cube.AXES, cube.edges(), strict=False)):
        body = rod(plant, f"rod_{i}", cube.MASS, edge, cube.moments(edge))
        hinge(plant, f"hinge_{i}", parent, body, RigidTransform(at), cube.unit(axis))
        parent, at = body, edge
    last = 0.5 * cube.unit(cube.AXES[-1])
    post = rod(plant, "post", cube.MASS, TIP, cube.moments(TIP))
    plant.AddJoint(WeldJoint("foot", plant.world_frame(), post.body_frame(), RigidTransform()))
    pairs = [(parent, at + s * last, post, cube.POST + s * last) for s in (-1, 1)]
    tool = ready(plant, pairs, cube.G)
    tool.q, tool.v = np.zeros(5), np.zeros(5)
    tool.corner = plant.GetBodyByName(f"rod_{cube.P3_ROD}").body_frame()
    return tool


def run(tool: SimpleNamespace, duration: float) -> Array:
    tool.context.SetTime(0.0)
    tool.plant.SetPositionsAndVelocities(tool.context, np.concatenate([tool.q, tool.v]))
    tool.simulator.Initialize()
    tool.simulator.AdvanceTo(duration)
    return tool.plant.GetPositions(tool.context).copy()


def opening(tool: SimpleNamespace) -> float:
    """Return how far the worst pair of points is apart [m]."""
    get, context, world = tool.plant.CalcPointsPositions, tool.context, tool.world
    return max(float(np.linalg.norm(get(context, a, p, world) - get(context, b, r, world)))
               for a, p, b, r in tool.pairs)


def judge_a02(tool: SimpleNamespace, q: Array) -> dict[str, float | None]:
    return ladder.judge_end(float(-q[tool.first]), opening(tool))


def judge_a04(tool: SimpleNamespace, _: Array) -> dict[str, float | None]:
    edge = cube.edges()[cube.P3_ROD]
    corner = tool.plant.CalcPointsPositions(tool.context, tool.corner, edge, tool.world)
    return cube.judge(corner.ravel(), opening(tool))


STEPS = (5e-3, 1e-3)  # shorter ones are no better, and slow
CASES = tuple(
    Case(task, NAME, f"SAP, {closures}, {h:g} s", partial(setup, h),
         partial(run, duration=duration), judge)
    for task, closures, setup, duration, judge in (
        ("a02", "ball constraint", setup_ladder, ladder.DURATION, judge_a02),
        ("a04", "two ball constraints", setup_cube, cube.DURATION, judge_a04))
    for h in STEPS)
