"""Drake's constrained dynamics: ball constraints in its SAP solver, and Lagrange on its terms.

SAP takes one discrete step of a fixed size; its constraints are as stiff as the step allows. The
exact rows solve [M J'; J 0] by LAPACK from CalcMassMatrix, CalcBiasTerm and the Jacobians and
biases of the points, with Baumgarte's terms where they integrate.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    JacobianWrtVariable,
    RevoluteJoint,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
    WeldJoint,
)
from pydrake.systems.analysis import Simulator

from benchmark import cube, ladder
from benchmark.case import Case
from benchmark.rk4 import BY_HAND_STEPS, DAMPING, STIFFNESS, rk4
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


def ready(plant: MultibodyPlant, pairs: list, h: float, g: float) -> SimpleNamespace:
    """Close the loops where the plant steps; keep points for where it does not."""
    plant.mutable_gravity_field().set_gravity_vector([0.0, -g, 0.0])
    if h:
        for one, p, other, r in pairs:
            plant.AddBallConstraint(one, p, other, r)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    tool = SimpleNamespace(plant=plant, context=context, step=h, world=plant.world_frame())
    tool.pairs = [(a.body_frame(), p, b.body_frame(), r) for a, p, b, r in pairs]
    if h:
        tool.simulator = Simulator(plant, context)
    return tool


def new_plant(h: float) -> MultibodyPlant:
    plant = MultibodyPlant(h)
    if h:
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    return plant


def setup_ladder(n: int, turn: float, rate: float, h: float) -> SimpleNamespace:
    """Rods along their x, upright at coordinate 0; couplers level. A continuous plant for h = 0."""
    plant, axis, rods, bars = new_plant(h), np.array([0.0, 0.0, 1.0]), [], []
    moments = np.array([1e-9, ladder.ROD, ladder.ROD])  # Drake wants physical ones
    up, level = (RollPitchYaw(0.0, 0.0, s * np.pi / 2).ToRotationMatrix() for s in (1, -1))
    for i in range(n + 1):
        rods.append(rod(plant, f"rod_{i}", 1.0, TIP, moments))
        at = RigidTransform(up, [i, 0.0, 0.0])
        hinge(plant, f"pin_{i}", plant.world_body(), rods[-1], at, axis)
        if i < n:
            bars.append(rod(plant, f"bar_{i}", 1.0, TIP, moments))
            hinge(plant, f"knee_{i}", rods[-1], bars[-1], RigidTransform(level, TIP), axis)
    tool = ready(plant, [(bars[i], TIP, rods[i + 1], TIP) for i in range(n)], h, ladder.G)
    tool.q, tool.v = np.empty(2 * n + 1), np.empty(2 * n + 1)
    for i in range(n + 1):
        for name, sign in ((f"pin_{i}", -1.0), (f"knee_{i}", 1.0)):
            if plant.HasJointNamed(name):
                at = plant.GetJointByName(name).velocity_start()
                tool.q[at], tool.v[at] = sign * turn, sign * rate
    tool.first, tool.loops = plant.GetJointByName("pin_0").velocity_start(), n
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
    tool = ready(plant, pairs, h, cube.G)
    tool.q, tool.v = np.zeros(5), np.zeros(5)
    tool.corner = plant.GetBodyByName(f"rod_{cube.P3_ROD}").body_frame()
    return tool


def points(tool: SimpleNamespace) -> Array:
    """Return (loops, 3): how far each pair of points is apart, world axes [m]."""
    get, context, world = tool.plant.CalcPointsPositions, tool.context, tool.world
    return np.array([(get(context, a, p, world) - get(context, b, r, world)).ravel()
                     for a, p, b, r in tool.pairs])


def acceleration(tool: SimpleNamespace, q: Array, v: Array) -> Array:
    """Return Lagrange's; the hinges are parallel to z, so each loop has two equations."""
    plant, context, world, wrt = tool.plant, tool.context, tool.world, JacobianWrtVariable.kV
    plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
    n, m = len(v), 2 * len(tool.pairs)
    matrix, rhs = np.zeros((n + m, n + m)), np.empty(n + m)
    matrix[:n, :n] = plant.CalcMassMatrix(context)
    rhs[:n] = plant.CalcGravityGeneralizedForces(context) - plant.CalcBiasTerm(context)
    for i, (a, p, b, r) in enumerate(tool.pairs):
        rows = slice(n + 2 * i, n + 2 * i + 2)
        one, other = (plant.CalcJacobianTranslationalVelocity(context, wrt, f, x, world, world)
                      for f, x in ((a, p), (b, r)))
        matrix[rows, :n] = (one - other)[:2]
        one, other = (plant.CalcBiasTranslationalAcceleration(context, wrt, f, x, world, world)
                      for f, x in ((a, p), (b, r)))
        rhs[rows] = -(one - other)[:2, 0] - DAMPING * (matrix[rows, :n] @ v)
    rhs[n:] -= STIFFNESS * points(tool)[:, :2].ravel()
    matrix[:n, n:] = matrix[n:, :n].T
    return np.linalg.solve(matrix, rhs)[:n]


def run_exact(tool: SimpleNamespace) -> float:
    return float(-acceleration(tool, tool.q, tool.v)[tool.first])


def run_step(tool: SimpleNamespace) -> float:
    """Return the mean acceleration over one discrete step."""
    run_simulation(tool, tool.step)
    return float((tool.v - tool.plant.GetVelocities(tool.context))[tool.first] / tool.step)


def judge_forward(tool: SimpleNamespace, found: float) -> dict[str, float | None]:
    return ladder.judge_acceleration(tool.loops, found)


def run_simulation(tool: SimpleNamespace, duration: float) -> Array:
    tool.context.SetTime(0.0)
    tool.plant.SetPositionsAndVelocities(tool.context, np.concatenate([tool.q, tool.v]))
    tool.simulator.Initialize()
    tool.simulator.AdvanceTo(duration)
    return tool.plant.GetPositions(tool.context).copy()


def run_by_hand(tool: SimpleNamespace, h: float) -> Array:
    q, v = rk4(partial(acceleration, tool), tool.q, tool.v, h, ladder.DURATION)
    tool.plant.SetPositionsAndVelocities(tool.context, np.concatenate([q, v]))
    return q


def opening(tool: SimpleNamespace) -> float:
    return float(np.linalg.norm(points(tool), axis=1).max())


def judge_a02(tool: SimpleNamespace, q: Array) -> dict[str, float | None]:
    return ladder.judge_end(float(-q[tool.first]), opening(tool))


def judge_a04(tool: SimpleNamespace, _: Array) -> dict[str, float | None]:
    edge = cube.edges()[cube.P3_ROD]
    corner = tool.plant.CalcPointsPositions(tool.context, tool.corner, edge, tool.world)
    return cube.judge(corner.ravel(), opening(tool))


STEPS = (5e-3, 1e-3)  # shorter ones are no better, and slow
CASES = (
    *(Case("forward", NAME, "one SAP step of 1 ms",
           partial(setup_ladder, n, ladder.ANGLE, ladder.RATE, 1e-3), run_step, judge_forward,
           size=n) for n in ladder.SIZES),
    *(Case("forward", NAME, "its terms, Lagrange's equations by LAPACK",
           partial(setup_ladder, n, ladder.ANGLE, ladder.RATE, 0.0), run_exact, judge_forward,
           size=n) for n in ladder.SIZES),
    *(Case("a02", NAME, f"SAP, ball constraint, {h:g} s",
           partial(setup_ladder, 1, 0.0, ladder.START, h),
           partial(run_simulation, duration=ladder.DURATION), judge_a02)
      for h in STEPS),
    *(Case("a02", NAME, f"its terms, Lagrange + Baumgarte by LAPACK, RK4 at {h:g} s",
           partial(setup_ladder, 1, 0.0, ladder.START, 0.0), partial(run_by_hand, h=h), judge_a02,
           slow=h < 2e-3) for h in BY_HAND_STEPS),
    *(Case("a04", NAME, f"SAP, two ball constraints, {h:g} s", partial(setup_cube, h),
           partial(run_simulation, duration=cube.DURATION), judge_a04)
      for h in STEPS),
)
