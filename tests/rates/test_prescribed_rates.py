"""Speeds and accelerations are given for every pair: drivers, components, and whole joints."""

import mechanisms
import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from machines import rocker_of, two_motors, wishbone
from mechanisms import (
    closure,
    driver,
    floating,
    guess,
    load,
    point,
    refine,
    sliding,
    tilted,
    turning,
)

import spatial_pin as sp

POSE = {"spherical": [0.4, -0.8, 0.6], "floating": [0.2, -0.1, 0.3, 0.4, -0.8, 0.6],
        "cylindrical": [0.7, 0.2], "universal": [0.5, -0.9], "planar": [0.1, 0.3, 2.0]}
H = 1e-5  # s, between configurations of differences


@pytest.fixture
def folder(tmp_path):
    return tmp_path


def body(folder, pair):
    """One body on one joint, on a tilted base, an arm behind it."""
    tree = floating("free", "ground", "body", (0.1, 0.2, 0.3), (0.3, -0.2, 0.5))
    tree += turning("elbow", "body", "arm", (0.2, 0, 0), axis=(0, 1, 0))
    return load(folder, pair, tilted(tree), refine("free", pair) + driver("elbow", "elbow"))


def configured(mechanism, pair):
    return sp.assemble(mechanism, {}, guess={"free": POSE[pair], "elbow": 0.4})


def values_at(state, t):
    """The coordinates a time t later, from v and a to second order."""
    model = state.mechanism.model
    q = pin.integrate(model, state.q, t * state.v + 0.5 * t * t * state.a)
    later = sp.State(state.mechanism, q, closure_error=0.0)
    return np.array([later.coordinate(name).value for name in state.mechanism.coordinates])


@pytest.mark.parametrize("pair", POSE)
def test_a_joint_takes_its_velocity_whole(folder, pair):
    mechanism = body(folder, pair)
    n = len(POSE[pair])
    speeds, accels = np.linspace(-1.0, 2.0, n), np.linspace(3.0, 0.5, n)
    state = sp.solve_rates(mechanism, configured(mechanism, pair), {"free": speeds, "elbow": 2.0},
                           {"free": accels.tolist()})
    assert state.v == pytest.approx([*speeds, 2.0], abs=1e-14)
    assert state.a == pytest.approx([*accels, 0.0], abs=1e-13)


def test_a_ball_is_given_its_angular_velocity_in_the_bodys_axes(folder):
    mechanism = body(folder, "spherical")
    omega = np.array([0.3, -1.2, 0.7])
    state = sp.solve_rates(mechanism, configured(mechanism, "spherical"), {"free": omega})
    turned = state.placement("body").rotation.T @ state.angular_velocity("body")
    assert turned == pytest.approx(omega, abs=1e-14)


@pytest.mark.parametrize("pair", POSE)
def test_components_take_their_own_derivatives(folder, pair):
    """Rates and accelerations are those of the coordinates, which are differenced here."""
    mechanism = body(folder, pair)
    names = [c for c in mechanism.coordinates if c.startswith("free.")]
    speeds = dict(zip(names, np.linspace(-1.0, 2.0, len(names)), strict=True))
    accels = dict(zip(names, np.linspace(3.0, 0.5, len(names)), strict=True))
    state = sp.solve_rates(mechanism, configured(mechanism, pair), speeds, accels)
    for name in names:
        _, rate, acceleration = state.coordinate(name)
        assert rate == pytest.approx(speeds[name], abs=1e-13)
        assert acceleration == pytest.approx(accels[name], abs=1e-12)
    before, here, after = (values_at(state, t) for t in (-H, 0.0, H))
    assert ((after - before) / (2 * H))[:-1] == pytest.approx(list(speeds.values()), abs=1e-7)
    assert ((after - 2 * here + before) / H**2)[:-1] == pytest.approx(
        list(accels.values()), abs=1e-4)


@pytest.mark.parametrize("pair", POSE)
@pytest.mark.parametrize("which", [0, -1])
def test_of_one_component_the_others_stand_still(folder, pair, which):
    mechanism = body(folder, pair)
    names = [c for c in mechanism.coordinates if c.startswith("free.")]
    state = sp.solve_rates(mechanism, configured(mechanism, pair), {names[which]: 1.5})
    rates = {name: state.coordinate(name).rate for name in mechanism.coordinates}
    assert rates.pop(names[which]) == pytest.approx(1.5, abs=1e-13)
    assert max(map(abs, rates.values())) < 1e-13


def test_a_component_of_a_ball_moves_a_loop_as_its_driver_does():
    mechanism = library("rssr")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.7}), {"crank": 2.0},
                           {"crank": -3.0})
    for name in ("ball_a.x", "ball_a.y"):
        _, rate, acceleration = state.coordinate(name)
        again = sp.solve_rates(mechanism, state, {name: rate}, {name: acceleration})
        assert again.v == pytest.approx(state.v, rel=1e-9, abs=1e-12)
        assert again.a == pytest.approx(state.a, rel=1e-9, abs=1e-11)


def test_the_pose_of_a_platform_moves_its_legs():
    """The platform's six rates, whole or by components, against those of the legs."""
    mechanism = library("stewart")
    state = sp.assemble(mechanism, {"leg_1": 0.40, "leg_3": 0.38})
    state = sp.solve_rates(mechanism, state, {"leg_1": 0.2, "leg_4": -0.3}, {"leg_2": 1.0})
    pose = [f"pose.{x}" for x in ("x", "y", "z", "rx", "ry", "rz")]
    rows = [state.coordinate(name) for name in pose]
    at = [mechanism.coordinate(name).v for name in pose]
    for speeds, accels in (
        ({"pose": state.v[at]}, {"pose": state.a[at]}),
        ({n: r.rate for n, r in zip(pose, rows, strict=True)},
         {n: r.acceleration for n, r in zip(pose, rows, strict=True)}),
    ):
        again = sp.solve_rates(mechanism, state, speeds, accels)
        assert again.v == pytest.approx(state.v, abs=1e-11)
        assert again.a == pytest.approx(state.a, abs=1e-10)


def test_drivers_omitted_keep_their_value_with_a_free_body(folder):
    """A crane swings its load by a ball; nobody says a word of the crane."""
    tree = (turning("slew", "ground", "tower") + sliding("trolley", "tower", "car", axis=(1, 0, 0))
            + floating("rope", "car", "load") + point("hook", "load", (0, 0, -1.0)))
    mechanism = load(folder, "swing", tree, refine("rope", "spherical") + driver("slew", "slew")
                     + driver("trolley", "trolley") + guess(trolley=2.0))
    state = sp.solve_rates(mechanism, sp.assemble(mechanism), {"rope": [0.0, 0.5, 0.0]})
    assert state.coordinate("slew").rate == state.coordinate("trolley").rate == 0.0
    assert state.velocity("hook").linear == pytest.approx([-0.5, 0.0, 0.0], abs=1e-14)


@pytest.mark.delicate
def test_of_more_drivers_than_freedoms_those_named_move_the_rest(folder):
    mechanism = two_motors(folder)
    state = sp.assemble(mechanism, {"first": 0.9})
    rates = sp.solve_rates(mechanism, state, {"first": 1.0})
    slope = (rocker_of(0.9 + H) - rocker_of(0.9 - H)) / (2 * H)
    assert rates.coordinate("second").rate == pytest.approx(slope, abs=1e-8)


def test_a_simulation_begins_with_the_spin_of_a_ball(folder):
    tree = floating("free", "ground", "body").replace(
        '<link name="body"/>', '<link name="body"><inertial><mass value="1"/><inertia ixx="1" '
        'iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>')
    mechanism = load(folder, "top", tree, "gravity = [0.0, 0.0, 0.0]\n" + refine(
        "free", "spherical"))
    start = sp.solve_rates(mechanism, sp.assemble(mechanism), {"free": [0.0, 0.0, 2.0]})
    motion = sp.simulate(mechanism, start, 0.5)
    assert motion.coordinate("free.z").value[-1] == pytest.approx(1.0, abs=1e-7)


# ---------------------------------------------------------------- refused in words


def test_what_is_not_as_many_as_the_freedoms_is_refused(folder):
    mechanism = body(folder, "spherical")
    state = configured(mechanism, "spherical")
    for value in (1.0, [1.0, 2.0], [1.0, 2.0, np.nan], "fast"):
        with pytest.raises(ValueError, match=r"speed of 'free' \(free.x, free.y, free.z\)"):
            sp.solve_rates(mechanism, state, {"free": value})
    with pytest.raises(ValueError, match=r"'free\.x'"):
        sp.solve_rates(mechanism, state, {"free.x": [1.0]})


def test_a_joint_is_given_whole_or_by_components(folder):
    mechanism = body(folder, "spherical")
    state = configured(mechanism, "spherical")
    with pytest.raises(ValueError, match="choose one"):
        sp.solve_rates(mechanism, state, {"free": [1.0, 0.0, 0.0]}, {"free.x": 1.0})
    mechanism = body(folder, "cylindrical")
    with pytest.raises(ValueError, match="given twice"):
        sp.solve_rates(mechanism, configured(mechanism, "cylindrical"),
                       {"free": [1.0, 0.0], "free.angle": 1.0})


def test_too_many_components_for_a_loop_are_refused():
    mechanism = library("rssr")
    with pytest.raises(sp.SingularError, match="prescribe fewer"):
        sp.solve_rates(mechanism, sp.assemble(mechanism), {"ball_a": [1.0, 0.0, 0.0]})


def test_freedoms_that_the_file_does_not_name_are_named(folder):
    mechanism = mechanisms.five_bar(folder)
    with pytest.raises(sp.SingularError, match="1 of its freedoms are not prescribed"):
        sp.solve_rates(mechanism, sp.assemble(mechanism), {"elbow1": 1.0})
    mechanism = wishbone(folder)
    with pytest.raises(sp.SingularError, match="not prescribed"):
        sp.solve_rates(mechanism, sp.assemble(mechanism), {"ball.x": 1.0})


def test_closures_between_bodies_are_kept_at_given_rates(folder):
    """A loop of two floating bodies tied by a ball: six rates of one, three of the other's."""
    tree = (floating("one", "ground", "a") + floating("two", "ground", "b", (1.0, 0, 0))
            + point("a_end", "a", (0.5, 0.1, 0)) + point("b_end", "b", (-0.5, 0.1, 0)))
    mechanism = load(folder, "pair", tree, closure("ball", "spherical", "a_end", "b_end"))
    state = sp.assemble(mechanism)
    rates = {"one": [0.1, 0.2, 0.3, -0.4, 0.5, 0.6], "two.rx": 1.0, "two.ry": -1.0, "two.rz": 0.5}
    state = sp.solve_rates(mechanism, state, rates)
    assert state.velocity("a_end").linear == pytest.approx(
        state.velocity("b_end").linear, abs=1e-14)
    assert state.angular_velocity("b") == pytest.approx([1.0, -1.0, 0.5], abs=1e-14)


def test_what_is_held_may_be_named_by_something_that_can_be_read_once_only():
    mechanism = sp.load("four_bar")
    state = sp.assemble(mechanism, {"crank": 1.0})
    with pytest.raises(sp.SingularError, match="held coordinates and the loops leave no freedom"):
        sp.solve_rates(mechanism, state, {"crank": 1.0}, hold=(x for x in ["rocker_pin"]))
