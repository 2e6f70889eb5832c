"""Poses at rest as a load grows: limit points, branch points and displacement control."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq

import spatial_pin as sp

PUSH = {"top": pin.Force(np.array([0.0, -1.0, 0.0]), np.zeros(3))}
LIMIT_LOAD = 4.054703026546  # N, of two springs of 1000 N/m, half span 0.3 m, height 0.1 m


def truss() -> sp.Mechanism:
    """Von Mises: two springs from the ground to a slide between them, at rest 0.1 m above it."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    slide = model.addJoint(0, pin.JointModelPY(), pin.SE3.Identity(), "y")
    for name, x, joint in (("left", -0.3, 0), ("right", 0.3, 0), ("top", 0.0, slide)):
        place = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        model.addFrame(pin.Frame(name, joint, place, pin.FrameType.OP_FRAME))
    springs = [sp.Spring(side, (side, "top"), stiffness=1000.0, free_length=np.hypot(0.3, 0.1))
               for side in ("left", "right")]
    return sp.Mechanism.from_model(model, drivers=["y"], springs=springs, name="truss")


def column(offset: float = 0.0) -> sp.Mechanism:
    """Two rods of 1 m in line, a spring of 10 N·m/rad between them, the tip guided on the line."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    length = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    second = model.addJoint(first, pin.JointModelRZ(), length, "second")
    for joint in (first, second):
        rod = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.diag([0.0, 0.1, 0.1]))
        model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", second, length, pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("foot", 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    guide = sp.closures.point_on_line("foot", "tip", axis=(1, 0, 0), name="guide")
    spring = sp.Spring("middle", joint="second", stiffness=10.0, free_angle=offset)
    return sp.Mechanism.from_model(model, closures=[guide], springs=[spring], name="column")


def press(mechanism, last, **more):
    force = {"tip": pin.Force(np.array([-1.0, 0.0, 0.0]), np.zeros(3))}
    return sp.equilibrium_path(mechanism, {"first": 0.0, "second": 0.0}, external=force,
                               factors=(0.0, last), **more)


def test_a_truss_snaps_through_at_its_limit_load_and_on_to_the_last_factor():
    path = sp.equilibrium_path(truss(), {"y": 0.1}, external=PUSH, factors=(0.0, 6.0))
    first, second = path.events
    assert (first.kind, second.kind) == ("limit point", "limit point")
    assert first.value == pytest.approx(LIMIT_LOAD, abs=1e-11)
    assert second.value == pytest.approx(-LIMIT_LOAD, abs=1e-11)
    assert path.load_factor[0] == 0.0 and path.load_factor[-1] == 6.0
    assert path.stable[0] and path.stable[-1] and not path.stable[first.row + 1]


def test_every_sample_of_a_path_is_at_rest_under_its_load():
    path = sp.equilibrium_path(truss(), {"y": 0.1}, efforts={"y": -1.0}, factors=(0.0, 5.0))
    y = path.q[:, 0]
    length = np.hypot(0.3, y)
    pull = -2.0 * 1000.0 * (length - np.hypot(0.3, 0.1)) * y / length
    assert np.abs(pull - path.load_factor).max() < 1e-10
    for event, sense in zip(path.events, (1.0, -1.0), strict=True):
        assert y[event.row] == pytest.approx(sense * 0.05671838483786, abs=1e-11)
        assert path.load_factor[event.row] == event.value


def test_displacement_control_goes_through_both_limit_points():
    values = np.linspace(0.1, -0.12, 23)
    path = sp.equilibrium_path(truss(), {"y": 0.1}, efforts={"y": -1.0}, over="y", values=values)
    assert path.driver_name == "y" and np.abs(path.driver - values).max() < 1e-12
    assert [e.kind for e in path.events] == ["limit point"] * 2
    assert path.events[0].value == pytest.approx(LIMIT_LOAD, abs=1e-11)
    length = np.hypot(0.3, values)
    wanted = -2000.0 * (length - np.hypot(0.3, 0.1)) * values / length
    assert np.abs(path.load_factor - wanted).max() < 1e-10
    assert np.abs(path.v[:, 0] - 1.0).max() < 1e-12


def test_displacement_control_begins_where_nothing_is_stiff_and_keeps_a_held_base():
    """A level arm on a free base: the torque that lifts it is m g c cos(q), its slope there 0."""
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    hip = model.addJoint(base, pin.JointModelRY(), pin.SE3.Identity(), "hip")
    for joint in (base, hip):
        arm = pin.Inertia(1.0, np.array([0.3, 0.0, 0.0]), 0.01 * np.eye(3))
        model.appendBodyToJoint(joint, arm, pin.SE3.Identity())
    robot = sp.Mechanism.from_model(model, name="robot")
    path = sp.equilibrium_path(robot, efforts={"hip": -1.0}, over="hip", hold="base",
                               values=np.linspace(0.0, 1.0, 5))
    assert np.abs(path.q[:, :7] - path.q[0, :7]).max() < 1e-12
    wanted = 0.3 * -model.gravity.linear[2] * np.cos(path.driver)
    assert np.abs(path.load_factor - wanted).max() < 1e-10


def test_displacement_control_begins_at_any_load():
    mechanism = sp.load("four_bar")
    path = sp.equilibrium_path(mechanism, efforts={"crank": 1.0}, over="crank", values=[0.5, 0.6])
    for value, factor in zip((0.5, 0.6), path.load_factor, strict=True):
        held = sp.equilibrium(mechanism, {"crank": value}, hold="crank")
        assert factor == pytest.approx(held.efforts["crank"], abs=1e-12)


def test_rates_are_those_from_sample_to_sample():
    path = sp.equilibrium_path(truss(), {"y": 0.1}, efforts={"y": -1.0}, factors=(0.0, 6.0))
    assert path.per == "sample"
    assert np.all(path.v[:, 0] < 0.0)
    total = 0.5 * (path.v[1:, 0] + path.v[:-1, 0]).sum()  # the trapezoidal rule
    assert total == pytest.approx(path.q[-1, 0] - path.q[0, 0], rel=0.04)


@pytest.mark.parametrize("part", [1e-3, 1e-6, 1e-8, 1e-10, 0.0])
def test_a_load_grows_from_a_pose_whose_stiffness_is_nearly_none(part):
    """A rod on its tip, upright by a spring: k q - m g c sin(q) is the torque that bends it."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "foot")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.0, 0.5]), 0.01 * np.eye(3)),
                            pin.SE3.Identity())
    weight = -0.5 * model.gravity.linear[2]
    spring = sp.Spring("foot", joint="foot", stiffness=weight * (1.0 + part))
    rod = sp.Mechanism.from_model(model, springs=[spring], name="rod")
    path = sp.equilibrium_path(rod, {"foot": 0.0}, efforts={"foot": 1.0}, factors=(0.0, 5.0))
    q = path.q[:, 0]
    assert path.load_factor[-1] == 5.0 and len(path) < 100 and q[-1] > 1.9
    torque = weight * ((1.0 + part) * q - np.sin(q))
    assert np.abs(path.load_factor - torque).max() < 1e-9


def test_displacement_control_keeps_a_held_component_of_a_ball():
    model = pin.Model()
    ball = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    elbow = model.addJoint(ball, pin.JointModelRY(),
                           pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0])), "elbow")
    for joint in (ball, elbow):
        arm = pin.Inertia(1.0, np.array([0.15, 0.02, 0.01]), 0.01 * np.eye(3))
        model.appendBodyToJoint(joint, arm, pin.SE3.Identity())
    arm = sp.Mechanism.from_model(model, springs=[
        sp.Spring(c, joint=f"ball.{c}", stiffness=3.0) for c in "yz"])
    path = sp.equilibrium_path(arm, {"ball": [0.2, 0.1, 0.3]}, efforts={"elbow": 1.0},
                               over="elbow", values=[0.0, 0.2, 0.5], hold="ball.x")
    for k in range(3):
        assert path.state(k).coordinate("ball.x").value == pytest.approx(0.2, abs=1e-14)
        held = sp.equilibrium(arm, path.state(k), hold=["ball.x", "elbow"])
        assert held.efforts["elbow"] == pytest.approx(path.load_factor[k], abs=1e-12)


def test_a_load_that_does_not_work_on_the_coordinate_holds_nothing():
    sideways = {"coupler": pin.Force(np.array([0.0, 1.0, 0.0]), np.zeros(3))}
    with pytest.raises(sp.SpatialPinError, match=r"no load factor holds crank = 0\.5"):
        sp.equilibrium_path(sp.load("four_bar"), external=sideways, over="crank",
                            values=[0.5, 0.6])


def test_a_straight_column_buckles_and_either_branch_is_followed():
    straight = press(column(), 60.0)
    (event,) = straight.events
    assert event.kind == "branch point" and event.value == pytest.approx(20.0, abs=1e-9)
    assert straight.stable[0] and not straight.stable[-1]
    assert np.abs(straight.q).max() < 1e-12
    angle = brentq(lambda x: 20.0 * x / np.sin(x) - 25.0, 0.5, 2.0, xtol=1e-14)
    for branch in (1, -1):
        bent = press(column(), 25.0, branch=branch)
        assert abs(bent.q[-1, 0]) == pytest.approx(angle, abs=1e-9)
        assert bent.stable[-1] and bent.q[-1, 1] == pytest.approx(-2.0 * bent.q[-1, 0], abs=1e-9)
    assert np.sign(press(column(), 25.0, branch=-1).q[-1, 0]) == -np.sign(
        press(column(), 25.0, branch=1).q[-1, 0])


def test_an_imperfect_column_bends_without_a_branch_point():
    path = press(column(offset=0.01), 25.0)
    assert not path.events and path.stable.all() and abs(path.q[-1, 1]) > 1.0


def test_a_load_that_never_comes_to_its_end_says_so():
    path = press(column(), -5.0, hold="first")
    assert path.load_factor[-1] == -5.0  # nothing can move: the loads are borne
    slack = sp.equilibrium_path(truss(), {"y": 0.1}, efforts={"y": 1.0}, factors=(0.0, 5.0))
    assert slack.load_factor[-1] == 5.0


def test_wrong_arguments_are_refused_by_name():
    with pytest.raises(sp.SpatialPinError, match="over needs values"):
        sp.equilibrium_path(truss(), efforts={"y": 1.0}, over="y")
    with pytest.raises(sp.UnknownNameError, match="'z'"):
        sp.equilibrium_path(truss(), efforts={"z": 1.0})
    with pytest.raises(ValueError, match="factors"):
        sp.equilibrium_path(truss(), efforts={"y": 1.0}, factors=(0.0, np.inf))


def test_a_path_is_pickled_whole():
    path = sp.equilibrium_path(truss(), {"y": 0.1}, efforts={"y": -1.0}, factors=(0.0, 2.0))
    again = pickle.loads(pickle.dumps(path))
    assert np.array_equal(again.load_factor, path.load_factor)
    assert np.array_equal(again.stable, path.stable)


def test_a_mechanism_with_loops_in_space_is_followed():
    mechanism = sp.load("rssr").with_fields(springs=(
        sp.Spring("return", joint="rocker_pin", stiffness=3.0, free_angle=1.6),))
    path = sp.equilibrium_path(mechanism, {"crank": 0.8}, efforts={"crank": 1.0},
                               factors=(0.0, 0.3))
    for row in (0, len(path) // 2, -1):
        state = path.state(row)
        found = sp.inverse_dynamics(mechanism, sp.State(mechanism, state.q))
        assert found.efforts["crank"] == pytest.approx(path.load_factor[row], abs=1e-9)


def test_a_path_is_drawn_dashed_where_it_is_not_stable():
    path = sp.equilibrium_path(truss(), {"y": 0.1}, efforts={"y": -1.0}, over="y",
                               values=np.linspace(0.1, -0.1, 41))
    figure = sp.plot(path, "load_factor")
    whole, dashed = [np.isfinite(line.get_ydata()) for line in figure.axes[0].lines[:2]]
    assert (whole == path.stable).all() and figure.axes[0].lines[1].get_linestyle() == "--"
    assert dashed[~path.stable].all() and 0 < np.count_nonzero(dashed & path.stable) <= 4
    assert path.quantities()["stable"].values.tolist() == path.stable.tolist()
