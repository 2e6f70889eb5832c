"""Drake: the RSSR on the Jacobians of its MultibodyPlant, tuned, and its constrained dynamics.

Drake closes loops in its discrete solver SAP only, by ball constraints that are as stiff as a step
of a fixed size allows; so for the RSSR Newton is ours, as for MuJoCo.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    FixedOffsetFrame,
    JacobianWrtVariable,
    RevoluteJoint,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
    WeldJoint,
)
from pydrake.systems.analysis import Simulator
from scipy.linalg.blas import daxpy, dgemv
from scipy.linalg.lapack import dgesv, dgetrf, dgetrs

from benchmark import cube, ladder, rssr
from benchmark.case import Absent, Case
from benchmark.rssr import MAX_CORRECTIONS, Array, Problem

NAME = "Drake"
ADAMS = (  # Adams-Bashforth weights of the last one to four rates, newest last
    (1.0,),
    (-1 / 2, 3 / 2),
    (5 / 12, -16 / 12, 23 / 12),
    (-9 / 24, 37 / 24, -59 / 24, 55 / 24),
)


def setup_drake(problem: Problem) -> SimpleNamespace:
    """The coupler lies along -z of its own frame: its spin and A's velocity are rows 2 to 5."""
    plant = MultibodyPlant(0.0)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.01)
    crank, rocker, coupler = (
        plant.AddRigidBody(name, inertia) for name in ("crank", "rocker", "coupler")
    )
    crank, rocker, coupler = (body.body_frame() for body in (crank, rocker, coupler))
    x, y, z = problem.rocker_to_coupler().T
    axes = RotationMatrix(np.column_stack([-z, y, x]))  # so that roll, pitch, yaw start at zero
    there = RigidTransform([-problem.d, 0.0, 0.0]), RigidTransform(axes, [-problem.c, 0.0, 0.0])
    pivot = plant.AddFrame(FixedOffsetFrame("pivot", plant.world_frame(), there[0]))
    at_b = plant.AddFrame(FixedOffsetFrame("at_b", rocker, there[1]))
    plant.AddJoint(RevoluteJoint("crank", plant.world_frame(), crank, [0, 1, 0]))
    plant.AddJoint(RevoluteJoint("rocker", pivot, rocker, [0, 0, -1]))
    plant.AddJoint(BallRpyJoint("ball", at_b, coupler))
    plant.Finalize()
    tool = SimpleNamespace(plant=plant, context=plant.CreateDefaultContext(), problem=problem)
    tool.crank, tool.coupler = crank, coupler
    tool.world, tool.wrt = plant.world_frame(), JacobianWrtVariable.kV
    tool.q0 = np.array([0.0, problem.guess, 0.0, 0.0, 0.0])
    tool.tip, tool.pin = np.array([0.0, 0.0, -problem.b]), np.array([-problem.a, 0.0, 0.0])
    order = [plant.GetJointByName(name).velocity_start() for name in ("crank", "rocker", "ball")]
    if order != [0, 1, 2]:
        raise RuntimeError(f"Drake ordered the joints differently: {order}")
    return tool


def run_drake_tuned(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """The tuned loop of `with_pinocchio.run_tuned` on Drake: rows 2 to 5, coupler's axes.

    Drake's coordinates are a vector here (roll, pitch, yaw) and their second derivatives are not
    offered, so the predictor is Adams-Bashforth on the kept coordinate rates.
    """
    plant, context, problem = tool.plant, tool.context, tool.problem
    coupler, tip, world, wrt = tool.coupler, tool.tip, tool.world, tool.wrt
    get_jacobian, get_bias = plant.CalcJacobianSpatialVelocity, plant.CalcBiasSpatialAcceleration
    steps, small = len(problem.phi), problem.tolerance**2
    positions, velocities, accelerations = (np.zeros((steps, 5)) for _ in range(3))
    moves, solved = np.empty((steps, 5)), accelerations[:, 1:]
    history = moves.T
    weights = [problem.time_step * np.array(row) for row in ADAMS]
    path, back = problem.crank_path(), tip[2]
    rhs, step = np.zeros(4), np.zeros(5)
    rotated, correction = rhs[1:], step[1:]
    q = tool.q0
    for i, phi in enumerate(problem.phi.tolist()):
        if i:
            k = min(i, 4)
            q = q + dgemv(1.0, history[:, i - k : i], weights[k - 1])
        q[0] = phi
        target, velocity, acceleration = path[i]
        for _ in range(MAX_CORRECTIONS):
            plant.SetPositions(context, q)
            jacobian = get_jacobian(context, wrt, coupler, tip, world, coupler)[2:, 1:]
            pose = coupler.CalcPoseInWorld(context).GetAsMatrix34()
            rotation = pose[:, :3]
            gap = target - pose[:, 3] - back * pose[:, 2]
            x, y, z = gap.tolist()
            if x * x + y * y + z * z <= small:
                break
            rhs[0] = 0.0
            dgemv(1.0, rotation, gap, 0.0, rotated, 0, 1, 0, 1, 1, 1)
            correction[:] = dgesv(jacobian, rhs, 0, 1)[2]
            q = q + plant.MapVelocityToQDot(context, step)
        else:
            raise RuntimeError(f"loop open at {phi} rad")
        positions[i] = q
        lu, pivots, _ = dgetrf(jacobian)
        rhs[0] = 0.0
        dgemv(1.0, rotation, velocity, 0.0, rotated, 0, 1, 0, 1, 1, 1)
        v = velocities[i]
        v[0] = problem.speed
        v[1:] = dgetrs(lu, pivots, rhs, 0, 1)[0]
        plant.SetVelocities(context, v)
        moves[i] = plant.MapVelocityToQDot(context, v)
        bias = get_bias(context, wrt, coupler, tip, world, coupler).get_coeffs()
        rhs[0] = 0.0
        dgemv(1.0, rotation, acceleration, 0.0, rotated, 0, 1, 0, 1, 1, 1)
        daxpy(bias, rhs, 4, -1.0, 2)
        solved[i] = dgetrs(lu, pivots, rhs, 0, 1)[0]
    return positions, velocities, accelerations


def read_drake(tool: SimpleNamespace, result: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    plant, context, world = tool.plant, tool.context, tool.world
    closure, omega, alpha = [], [], []
    for q, v, a in zip(*result, strict=True):
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        one, other = (
            plant.CalcPointsPositions(context, frame, p, world).ravel()
            for frame, p in ((tool.coupler, tool.tip), (tool.crank, tool.pin))
        )
        closure.append(np.linalg.norm(one - other))
        point = tool.wrt, tool.coupler, tool.tip, world, world
        turn = plant.CalcJacobianSpatialVelocity(context, *point)[:3]
        bias = plant.CalcBiasSpatialAcceleration(context, *point).rotational()
        omega.append(turn @ v)
        alpha.append(turn @ a + bias)
    q, v, a = result
    return np.array(closure), q[:, 1], v[:, 1], a[:, 1], np.array(omega), np.array(alpha)


def judge_sweep(tool: SimpleNamespace, result: Any) -> dict[str, float | None]:
    return rssr.judge(tool.problem, read_drake(tool, result))


# ---------------------------------------------------------------- forces


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

    They are on a post welded to the ground: constraints on the world itself end the process.
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
CASES = (
    *(Case("sweep", NAME, "Newton on its Jacobians, tuned", partial(setup_drake, Problem(steps=n)),
           run_drake_tuned, judge_sweep, n, n) for n in rssr.STEPS),
    *(Case(task, NAME, f"SAP, {closures}, {h:g} s", partial(setup, h),
           partial(run, duration=duration), judge)
      for task, closures, setup, duration, judge in (
          ("a02", "ball constraint", setup_ladder, ladder.DURATION, judge_a02),
          ("a04", "two ball constraints", setup_cube, cube.DURATION, judge_a04))
      for h in STEPS),
)
ABSENT = (
    Absent("sweep", NAME, "AddBallConstraint closes loops in the discrete SAP solver only, softly; "
           "InverseKinematics (NLopt, IPOPT, SNOPT) gives positions only"),
)
