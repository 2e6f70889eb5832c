"""The same four-bar on the Jacobians of MuJoCo and Drake, plain and tuned; rows of `bench.py`.

Both engines are used as their documentation says: kinematics, Jacobian of a point, bias of its
acceleration; Newton and the linear algebra are ours. The coupler hangs on the rocker and the loop
is cut at A. The plain loops take the difference of two Jacobians; the tuned ones are tuned like the
Pinocchio loop: A moves along the known path of the crank, views kept, a predictor, LAPACK called
directly, results written in place.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import daxpy, dcopy, dgemv
from scipy.linalg.lapack import dgesv, dgetrf, dgetrs

if TYPE_CHECKING:
    from bench import Problem

Array = NDArray[np.float64]

MAX_CORRECTIONS = 30
ADAMS = (  # Adams-Bashforth weights of the last one to four rates, newest last
    (1.0,),
    (-1 / 2, 3 / 2),
    (5 / 12, -16 / 12, 23 / 12),
    (-9 / 24, 37 / 24, -59 / 24, 55 / 24),
)

FOUR_BAR = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="crank">
      <joint type="hinge" axis="0 1 0"/>
      <geom type="sphere" size="0.01"/>
      <site name="crank_a" pos="{} 0 0"/>
    </body>
    <body name="rocker" pos="{} 0 0">
      <joint type="hinge" axis="0 0 -1"/>
      <geom type="sphere" size="0.01"/>
      <body name="coupler" pos="{} 0 0">
        <joint type="ball"/>
        <geom type="sphere" size="0.01"/>
        <site name="coupler_a" pos="{} 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def rocker_to_coupler(problem: Problem) -> Array:
    """Return the guessed rotation (3, 3) of the coupler in the rocker's axes."""
    s, c = np.sin(problem.guess), np.cos(problem.guess)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ problem.guessed_coupler()


# MuJoCo


def setup_mujoco(problem: Problem) -> SimpleNamespace:
    import mujoco

    lengths = -problem.a, -problem.d, -problem.c, -problem.b
    model = mujoco.MjModel.from_xml_string(FOUR_BAR.format(*lengths))
    tool = SimpleNamespace(mujoco=mujoco, model=model, data=mujoco.MjData(model), problem=problem)
    tool.tip, tool.pin = model.site("coupler_a").id, model.site("crank_a").id
    tool.body = model.body("coupler").id
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rocker_to_coupler(problem).ravel())
    tool.q0 = np.concatenate([[0.0, problem.guess], quaternion])
    return tool


def run_mujoco(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """Newton on the Jacobians of the two sites, from the last position moved on by its velocity."""
    mujoco, model, data, problem = tool.mujoco, tool.model, tool.data, tool.problem
    data.qpos, data.qvel = tool.q0, 0.0
    positions, velocities, accelerations = [], [], []
    rows, rhs, step = np.zeros((4, model.nv)), np.zeros(4), np.zeros(model.nv)
    on_tip, on_pin, turn = (np.zeros((3, model.nv)) for _ in range(3))
    sites = (on_tip, turn, tool.tip), (on_pin, None, tool.pin)
    for phi in problem.phi:
        mujoco.mj_integratePos(model, data.qpos, data.qvel, problem.time_step)
        data.qpos[0] = phi
        while True:
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for linear, angular, site in sites:
                mujoco.mj_jacSite(model, data, linear, angular, site)
            axis = data.xmat[tool.body].reshape(3, 3)[:, 0]
            rows[:3], rows[3] = on_tip - on_pin, axis @ turn
            rhs[:3] = data.site_xpos[tool.pin] - data.site_xpos[tool.tip]
            if np.linalg.norm(rhs) <= problem.tolerance:
                break
            step[1:] = np.linalg.solve(rows[:, 1:], rhs)
            mujoco.mj_integratePos(model, data.qpos, step, 1.0)
        data.qvel[0] = problem.speed
        data.qvel[1:] = np.linalg.solve(rows[:, 1:], -rows[:, 0] * problem.speed)
        mujoco.mj_comVel(model, data)
        for linear, angular, site in sites:
            point, body = data.site_xpos[site], model.site_bodyid[site]
            mujoco.mj_jacDot(model, data, linear, angular, point, body)
        a, v = np.zeros(model.nv), data.qvel.copy()
        bias = np.array([*((on_tip - on_pin) @ v), axis @ turn @ v])
        a[1:] = np.linalg.solve(rows[:, 1:], -bias)
        positions.append(data.qpos.copy())
        velocities.append(v)
        accelerations.append(a)
    return np.array(positions), np.array(velocities), np.array(accelerations)


def run_mujoco_tuned(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """The tuned loop of `bench.run_tuned` on MuJoCo's calls.

    `mj_jac` writes world axes into the buffer `full`: three rows of A's velocity, a free row that
    takes the spin, three rows of angular velocity.
    """
    mujoco, model, data, problem = tool.mujoco, tool.model, tool.data, tool.problem
    mj_kinematics, mj_com_pos, mj_jac = mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_jac
    nv, body, h = model.nv, tool.body, problem.time_step
    steps, small = len(problem.phi), problem.tolerance**2
    positions, rates = np.empty((steps, model.nq)), np.zeros((steps, 2, nv))
    rates[:, 0, 0] = problem.speed
    history, unknown = rates.reshape(-1, nv).T, rates[:, :, 1:]
    predictor = np.array([1.5 * h, 7 / 12 * h * h, -0.5 * h, 17 / 12 * h * h])
    path = np.zeros((steps, 3, 4))
    path[:, :, :3] = problem.crank_path()
    full = np.zeros((7, nv))
    linear, angular, spin, system = full[:3], full[4:], full[3], full[:4, 1:]
    rows_t, angular_t = full[:4].T, full[4:].T
    q, qvel, p = data.qpos, data.qvel, data.site_xpos[tool.tip]
    axis, step, rhs = data.xmat[body].reshape(3, 3)[:, 0], np.zeros(nv), np.zeros(4)
    point, correction, bias = rhs[:3], step[1:], np.zeros(4)
    q[:] = tool.q0
    for i, phi in enumerate(problem.phi.tolist()):
        if i > 1:
            moved = dgemv(1.0, history[:, 2 * i - 4 : 2 * i], predictor)
            mujoco.mj_integratePos(model, q, moved, 1.0)
        elif i == 1:
            mujoco.mj_integratePos(model, q, rates[0, 0] + h / 2 * rates[0, 1], h)
        q[0] = phi
        target, velocity, acceleration = path[i]
        for _ in range(MAX_CORRECTIONS):
            mj_kinematics(model, data)
            mj_com_pos(model, data)
            mj_jac(model, data, linear, angular, p, body)
            dgemv(1.0, angular_t, axis, 0.0, spin, 0, 1, 0, 1, 0, 1)
            dcopy(target, rhs)
            daxpy(p, point, 3, -1.0)
            x, y, z, _ = rhs.tolist()
            if x * x + y * y + z * z <= small:
                break
            correction[:] = dgesv(system, rhs, 0, 1)[2]
            mujoco.mj_integratePos(model, q, step, 1.0)
        else:
            raise RuntimeError(f"loop open at {phi} rad")
        positions[i] = q
        lu, pivots, _ = dgetrf(system)
        solution = unknown[i, 0]
        dcopy(velocity, solution)
        dgetrs(lu, pivots, solution, 0, 1)
        qvel[:] = rates[i, 0]
        mujoco.mj_comVel(model, data)
        mujoco.mj_jacDot(model, data, linear, angular, p, body)
        dgemv(1.0, angular_t, axis, 0.0, spin, 0, 1, 0, 1, 0, 1)
        dgemv(1.0, rows_t, qvel, 0.0, bias, 0, 1, 0, 1, 1, 1)
        solution = unknown[i, 1]
        dcopy(acceleration, solution)
        daxpy(bias, solution, 4, -1.0)
        dgetrs(lu, pivots, solution, 0, 1)
    return positions, rates[:, 0], rates[:, 1]


def read_mujoco(tool: SimpleNamespace, result: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    mujoco, model, data = tool.mujoco, tool.model, tool.data
    closure, omega, alpha = [], [], []
    turn, turn_rate = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for q, v, a in zip(*result, strict=True):
        data.qpos, data.qvel = q, v
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        p = data.site_xpos[tool.tip]
        mujoco.mj_jac(model, data, None, turn, p, tool.body)
        mujoco.mj_jacDot(model, data, None, turn_rate, p, tool.body)
        closure.append(np.linalg.norm(p - data.site_xpos[tool.pin]))
        omega.append(turn @ v)
        alpha.append(turn @ a + turn_rate @ v)
    q, v, a = result
    return np.array(closure), q[:, 1], v[:, 1], a[:, 1], np.array(omega), np.array(alpha)


# Drake


def setup_drake(problem: Problem) -> SimpleNamespace:
    """The coupler lies along -z of its own frame: its spin and A's velocity are rows 2 to 5."""
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import (
        BallRpyJoint,
        FixedOffsetFrame,
        JacobianWrtVariable,
        RevoluteJoint,
        SpatialInertia,
    )

    plant = MultibodyPlant(0.0)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.01)
    crank, rocker, coupler = (
        plant.AddRigidBody(name, inertia) for name in ("crank", "rocker", "coupler")
    )
    crank, rocker, coupler = (body.body_frame() for body in (crank, rocker, coupler))
    x, y, z = rocker_to_coupler(problem).T
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


def run_drake(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """Newton on spatial velocity Jacobians, from the last position moved on by its rates."""
    plant, context, world, problem = tool.plant, tool.context, tool.world, tool.problem
    q, rates, step = tool.q0, np.zeros(5), np.zeros(5)
    rows, rhs = np.zeros((4, 5)), np.zeros(4)
    positions, velocities, accelerations = [], [], []
    ends = (tool.coupler, tool.tip), (tool.crank, tool.pin)
    for phi in problem.phi:
        q = q + problem.time_step * rates
        q[0] = phi
        while True:
            plant.SetPositions(context, q)
            pose = plant.CalcRelativeTransform(context, world, tool.coupler)
            axis = pose.rotation().matrix()[:, 2]
            one, other = (
                plant.CalcJacobianSpatialVelocity(context, tool.wrt, frame, p, world, world)
                for frame, p in ends
            )
            rows[:3], rows[3] = one[3:] - other[3:], axis @ one[:3]
            p_tip, p_pin = (
                plant.CalcPointsPositions(context, frame, p, world).ravel() for frame, p in ends
            )
            rhs[:3] = p_pin - p_tip
            if np.linalg.norm(rhs) <= problem.tolerance:
                break
            step[1:] = np.linalg.solve(rows[:, 1:], rhs)
            q = q + plant.MapVelocityToQDot(context, step)
        v, a = np.zeros(5), np.zeros(5)
        v[0] = problem.speed
        v[1:] = np.linalg.solve(rows[:, 1:], -rows[:, 0] * problem.speed)
        plant.SetVelocities(context, v)
        rates = plant.MapVelocityToQDot(context, v)
        one, other = (
            plant.CalcBiasSpatialAcceleration(context, tool.wrt, frame, p, world, world)
            for frame, p in ends
        )
        linear = one.translational() - other.translational()
        a[1:] = np.linalg.solve(rows[:, 1:], -np.array([*linear, axis @ one.rotational()]))
        positions.append(q)
        velocities.append(v)
        accelerations.append(a)
    return np.array(positions), np.array(velocities), np.array(accelerations)


def run_drake_tuned(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """The tuned loop of `bench.run_tuned` on Drake's calls: rows 2 to 5 in the coupler's axes.

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
