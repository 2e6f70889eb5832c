"""Poses at rest: closed forms, what is stable stays and what is not leaves, and what is refused."""

from __future__ import annotations

import pickle
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pinocchio as pin
import pytest
from at_rest import (
    at as place,
    governor,
    hung,
    model_of,
    plate,
    point_mass,
    sprung_four_bar,
    truss,
    with_springs,
)
from loaded_library import library
from variety import each

import spatial_pin as sp

SPRUNG = ["four_bar", "rssr", "delta", "screw_press", "geared_five_bar", "slider_crank", "bennett",
          "sarrus", "rspc", "stewart"]


def force(found: sp.Equilibrium) -> float:
    """The largest acceleration that is left [rad/s², m/s²]."""
    mech = found.state.mechanism
    return float(np.abs(sp.forward_dynamics(mech, found.state).a).max())


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("crank", [1.75, 2.234, 2.73])
def test_the_benchmark_of_a_four_bar_with_a_spring(crank):
    guess = {"crank": crank, "coupler": -crank, "rocker": crank}
    found = sp.equilibrium(sprung_four_bar(), guess)
    assert abs(found.state.coordinate("crank").value - 2.234331019017586) < 1e-11
    assert found.stable and found.coordinates == ("crank",) and force(found) < 1e-11


@pytest.mark.parametrize(("height", "rest"), [(0.6, 0.1), (0.02, 0.1), (-0.4, -0.1)])
@pytest.mark.parametrize("mass", [1.0, 0.0])
def test_a_truss_rests_where_its_springs_are_slack(height, rest, mass):
    found = sp.equilibrium(truss(mass), {"y": height})
    assert abs(found.state.coordinate("y").value - rest) < 1e-11
    assert found.stable and abs(found.stiffness[0, 0] - 200.0) < 1e-8 and found.energy < 1e-20


def test_a_truss_snaps_through_beyond_its_limit_load():
    limit, before, beyond = 4.054703026546, 0.05671838483786, -0.11
    held = sp.equilibrium(truss(), {"y": 0.1}, efforts={"y": -limit * (1 - 1e-9)})
    assert abs(held.state.coordinate("y").value - before) < 1e-4 and held.stable
    found = sp.equilibrium(truss(), {"y": 0.1}, efforts={"y": -limit * (1 + 1e-9)})
    assert found.state.coordinate("y").value < beyond and found.stable


def test_the_middle_of_a_truss_is_unstable_and_its_energy_is_that_of_its_springs():
    found = sp.equilibrium(truss(), {"y": 0.01}, stable=None)
    assert abs(found.state.coordinate("y").value) < 1e-11 and found.stable is False
    assert found.energy == pytest.approx(1000.0 * (np.hypot(0.3, 0.1) - 0.3) ** 2, rel=1e-12)
    assert found.stiffness[0, 0] == pytest.approx(2000.0 * (1.0 - np.hypot(0.3, 0.1) / 0.3))


@pytest.mark.parametrize("guess", [-0.7, -1.6, -0.3, -2.5])
def test_a_governor_stands_out_by_its_speed(guess):
    found = sp.equilibrium(governor(), {"arm": guess}, speeds={"shaft": 8.0})
    assert abs(found.state.coordinate("arm").value + 1.177534668264) < 1e-11
    assert found.stable and found.coordinates == ("arm",)
    assert found.state.coordinate("shaft").rate == 8.0 and abs(found.efforts["shaft"]) < 1e-9


def test_a_slow_governor_hangs():
    found = sp.equilibrium(governor(), {"arm": 0.4}, speeds={"shaft": 4.0})
    assert abs(found.state.coordinate("arm").value) < 1e-11 and found.stable


def test_a_plate_hangs_on_two_cords():
    found = sp.equilibrium(plate())
    assert found.stable and len(found.coordinates) == 3 and len(found.passive) == 1
    for cord in ("cord_1", "cord_2"):
        assert np.linalg.norm(found.reactions[cord].linear) == pytest.approx(9.81, rel=1e-12)


@pytest.mark.parametrize("turned", [0.3, 0.5])
def test_a_plate_comes_back_from_where_it_is_turned(turned):
    found = sp.equilibrium(plate(), np.array([0, 0, 0, 0, 0, np.sin(turned / 2),
                                              np.cos(turned / 2)]))
    where = found.state.placement("plate")
    assert found.stable and np.abs(where.translation).max() < 1e-9
    assert np.abs(where.rotation[:2, :2] - np.eye(2)).max() < 1e-9


def test_a_pendulum_hangs_even_from_its_upright_pose():
    model = model_of((0.0, 0.0, -9.81))
    hinge = model.addJoint(0, pin.JointModelRY(), place(0, 0, 0), "hinge")
    model.appendBodyToJoint(hinge, point_mass(2.0, 0.0, 0.0, -0.5), place(0, 0, 0))
    mech = sp.Mechanism.from_model(model, name="pendulum")
    upright = sp.equilibrium(mech, {"hinge": np.pi}, stable=None)
    assert upright.stable is False and upright.stiffness[0, 0] == pytest.approx(-9.81)
    hanging = sp.equilibrium(mech, {"hinge": np.pi})
    assert hanging.stable and abs(np.sin(hanging.state.coordinate("hinge").value)) < 1e-12
    assert hanging.stiffness[0, 0] == pytest.approx(9.81, rel=1e-12)


# ---------------------------------------------------------------- what a result has


@pytest.mark.parametrize("name", each(SPRUNG))
def test_nothing_moves_from_where_springs_and_weights_balance(name):
    found = sp.equilibrium(with_springs(name))
    stiff = found.stiffness
    assert force(found) < 1e-7 * np.abs(stiff).max() / np.abs(found.reduced.mass).max()
    assert found.stable and np.abs(stiff - stiff.T).max() < 1e-12 * np.abs(stiff).max()
    assert np.linalg.eigvalsh(stiff).min() > 0.0


@pytest.mark.parametrize("name", ["rssr", "four_bar", "swash_plate", "rssr_crossed"])
def test_idle_rotations_are_no_part_of_the_verdict(name):
    found, mobility = sp.equilibrium(library(name)), sp.mobility(library(name))
    assert found.stable and len(found.passive) == len(mobility.passive)
    assert len(found.coordinates) == mobility.dof - len(mobility.passive)


def test_what_is_held_stays_and_bears():
    mech = library("four_bar")
    found = sp.equilibrium(mech, {"crank": 1.0}, hold="crank")
    assert found.state.coordinate("crank").value == 1.0 and found.coordinates == ()
    wanted = sp.inverse_dynamics(mech, sp.assemble(mech, {"crank": 1.0})).efforts["crank"]
    assert found.efforts["crank"] == pytest.approx(wanted, rel=1e-12) and found.stable
    free = sp.equilibrium(mech, {"crank": 1.0}, efforts={"crank": wanted}, stable=None)
    assert abs(free.state.coordinate("crank").value - 1.0) < 1e-9


def test_reactions_are_those_of_forward_dynamics():
    mech = with_springs("delta")
    found = sp.equilibrium(mech)
    wanted = sp.forward_dynamics(mech, found.state)
    for name, reaction in found.reactions.items():
        assert np.abs(reaction.vector - wanted.reactions[name].vector).max() < 1e-8
        assert found.unique[name].tolist() == wanted.unique[name].tolist()
    assert np.abs(found.on_ground.vector - wanted.on_ground.vector).max() < 1e-8


def test_a_freedom_without_stiffness_is_neutral():
    found = sp.equilibrium(library("crane"))
    assert found.stable is None and found.neutral == ("slew",) and "no stiffness" in str(found)


def test_coordinates_are_chosen():
    mech = library("four_bar")
    by_crank = sp.equilibrium(mech)
    found = sp.equilibrium(mech, coordinates=["rocker_pin"])
    assert found.coordinates == ("rocker_pin",)
    ratio = sp.transmission(mech, found.state, "rocker_pin").ratio
    assert found.stiffness[0, 0] * ratio**2 == pytest.approx(by_crank.stiffness[0, 0], rel=1e-9)


def test_a_free_base_hangs_on_springs():
    mech = hung()
    found = sp.equilibrium(mech)
    assert found.stable and len(found.coordinates) == 6 and force(found) < 1e-9
    assert found.on_ground.linear[2] == pytest.approx(-3.0 * 9.81, rel=1e-12)


def test_a_free_base_is_held():
    found = sp.equilibrium(hung(0), hold="base")
    assert found.coordinates == () and found.stable
    assert found.on_ground.linear[2] == pytest.approx(-3.0 * 9.81, rel=1e-12)


def test_a_force_from_outside_and_a_law_move_the_pose():
    down = {"top": pin.Force(np.array([0.0, -2.0, 0.0]), np.zeros(3))}
    by_force = sp.equilibrium(truss(), {"y": 0.1}, external=down)
    by_effort = sp.equilibrium(truss(), {"y": 0.1}, efforts={"y": -2.0})
    assert abs(by_force.state.q[0] - by_effort.state.q[0]) < 1e-12
    slack = np.hypot(0.3, 0.1)
    laws = dict.fromkeys(("left", "right"), lambda length, rate: 1000.0 * (length - slack))
    by_law = sp.equilibrium(truss(), {"y": 0.1}, efforts={"y": -2.0}, laws=laws)
    assert abs(by_law.state.q[0] - by_effort.state.q[0]) < 1e-9 and by_law.stable


def test_words_and_pickles():
    found = sp.equilibrium(library("rssr"))
    again = pickle.loads(pickle.dumps(found))
    assert repr(found).startswith("Equilibrium(State('rssr'") and repr(found).endswith(", stable)")
    assert "stable at rest" in str(found) and "J" in str(found) and "idle" in str(found)
    assert str(again) == str(found) and (again.stiffness == found.stiffness).all()


# ---------------------------------------------------------------- pushed


def pushed(found: sp.Equilibrium, seconds: float, by: float = 1e-3) -> float:
    """How far a nudge leads, as a multiple of itself, along the softest motion."""
    mech, name = found.state.mechanism, found.coordinates[0]
    start = found.state.coordinate(name).value
    state = sp.assemble(mech, {name: start + by}, found.state, release=False)
    run = sp.simulate(mech, state, seconds)
    return float(np.abs(run.coordinate(name).value - start).max() / by)


@pytest.mark.parametrize("name", ["four_bar", "slider_crank", "geared_five_bar"])
def test_a_stable_pose_survives_a_nudge_and_an_unstable_one_does_not(name):
    poses = sp.equilibria(library(name), starts=12)
    assert {pose.stable for pose in poses} == {True, False}
    for stable in (True, False):
        pose = next(pose for pose in poses if pose.stable is stable)
        root = np.sqrt(np.abs(pose.stiffness / pose.reduced.mass))[0, 0]
        assert (pushed(pose, 4.0 / root) < 1.5) == stable


@pytest.mark.parametrize("name", each(["delta", "rssr", "screw_press", "stewart", "bennett"]))
def test_dampers_bring_a_mechanism_back_to_its_pose(name):
    mech = with_springs(name)
    pose = sp.equilibrium(mech)
    rest = np.array([pose.state.coordinate(c).value for c in pose.coordinates])
    by = 1e-3 * np.random.default_rng(1).uniform(-1.0, 1.0, len(rest))
    start = sp.assemble(mech, dict(zip(pose.coordinates, rest + by, strict=True)), pose.state,
                        release=False)
    slowest = np.abs(sp.linearize(mech, pose.state).eigenvalues.real).min()
    run = sp.simulate(mech, start, min(3.0 / slowest, 20.0))
    apart = [np.abs(run.coordinate(c).value - x) for c, x in zip(pose.coordinates, rest,
                                                                 strict=True)]
    assert np.max(apart) < 20.0 * np.abs(by).max()
    assert np.max([x[-1] for x in apart]) < np.abs(by).max()


# ---------------------------------------------------------------- all of them


def test_all_four_poses_of_a_four_bar():
    found = sp.equilibria(library("four_bar"), starts=30)
    assert [pose.stable for pose in found] == [True, False, True, False]
    assert np.all(np.diff([pose.energy for pose in found]) > 0.0)
    assert found.starts == 30 and found.reached == sum(found.counts) and found.is_whole
    assert found.missing < 0.5 and "4 poses at rest from 30 starts" in str(found)
    assert all(force(pose) < 1e-6 for pose in found)


def test_all_three_poses_of_a_truss():
    found = sp.equilibria(truss(), starts=20)
    heights = sorted(float(pose.state.q[0]) for pose in found)
    np.testing.assert_allclose(heights, [-0.1, 0.0, 0.1], rtol=0, atol=1e-11)


def test_any_executor_finds_the_same():
    alone = sp.equilibria(library("four_bar"), starts=6, seed=3)
    with ProcessPoolExecutor(2) as executor:
        found = sp.equilibria(library("four_bar"), starts=6, seed=3, executor=executor)
    assert str(found) == str(alone) and found.counts == alone.counts
    assert all((x.state.q == y.state.q).all() for x, y in zip(found, alone, strict=True))
    again = pickle.loads(pickle.dumps(found))
    assert str(again) == str(found) and again.missing == found.missing


def test_no_pose_at_rest_at_all_is_an_error():
    with pytest.raises(sp.SpatialPinError, match="falls without end"):
        sp.equilibria(hung(0), starts=3)


# ---------------------------------------------------------------- refused


def test_a_free_base_that_nothing_holds_falls():
    with pytest.raises(sp.SpatialPinError, match=r"base floats freely.*hold=\['base'\]"):
        sp.equilibrium(hung(0))
    model = model_of((0.0, 0.0, -9.81))
    hull = model.addJoint(0, pin.JointModelFreeFlyer(), place(0, 0, 0), "hull")
    arm = model.addJoint(hull, pin.JointModelRY(), place(0, 0, 0), "arm")
    for joint in (hull, arm):
        model.appendBodyToJoint(joint, pin.Inertia(2.0, np.array([0.1, 0.0, 0.0]), np.eye(3)),
                                place(0, 0, 0))
    walker = sp.Mechanism.from_model(model)
    with pytest.raises(sp.SpatialPinError, match=r'hull floats freely.*hold="base"'):
        sp.equilibrium(walker)
    found = sp.equilibrium(walker, hold="base")
    assert found.stable and found.coordinates == ("arm",)


def test_what_falls_is_named_and_what_would_hold_it():
    with pytest.raises(sp.SpatialPinError, match=r"screw moves without end.*hold=\['screw'\]"):
        sp.equilibrium(library("screw_press"))
    assert sp.equilibrium(library("screw_press"), hold=["screw"]).stable
    with pytest.raises(sp.SpatialPinError, match=r"hold=\['slide_1', .*'slide_6'\]"):
        sp.equilibrium(library("stewart"))


@pytest.mark.parametrize(("coordinates", "words"), [
    (["crank", "rocker_pin"], "2 are given, but 1"), ([], "0 are given, but 1")])
def test_coordinates_are_as_many_as_there_are_freedoms(coordinates, words):
    with pytest.raises(sp.SpatialPinError, match=words):
        sp.equilibrium(library("four_bar"), coordinates=coordinates)


@pytest.mark.parametrize("given", [
    {"hold": "crnk"}, {"speeds": {"crnk": 1.0}}, {"efforts": {"crnk": 1.0}},
    {"coordinates": ["crnk"]}, {"external": {"crnk": pin.Force.Zero()}}, {"guess": {"crnk": 1.0}}])
def test_names_that_do_not_exist_are_refused(given):
    for verb in (sp.equilibrium, sp.equilibria):
        with pytest.raises(sp.UnknownNameError, match="crnk"):
            verb(library("four_bar"), **given)


def test_what_is_held_has_no_speed():
    with pytest.raises(sp.SpatialPinError, match="'crank' has a speed and is held"):
        sp.equilibrium(library("four_bar"), hold="crank", speeds={"crank": 1.0})


@pytest.mark.parametrize("starts", [0, -1, 2.5])
def test_starts_are_a_number_of_at_least_one(starts):
    with pytest.raises((ValueError, TypeError), match="starts"):
        sp.equilibria(library("four_bar"), starts=starts)


def test_a_crank_that_turns_leaves_nothing_at_rest():
    with pytest.raises(sp.SpatialPinError, match=r"nothing stays at rest relative to crank"):
        sp.equilibrium(sp.load("four_bar"), speeds={"crank": 1.0})


def test_a_rope_with_a_part_between_two_points_of_the_ground():
    """From the wall over a pulley to a weight: the first part moves nothing."""
    model = pin.Model()
    lift = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "lift")
    swing = model.addJoint(lift, pin.JointModelRX(), pin.SE3.Identity(), "swing")
    for joint in (lift, swing):
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.1, -0.1]), np.eye(3)),
                                pin.SE3.Identity())
    frames = {name: (body, pin.SE3(np.eye(3), np.array(point))) for name, body, point in (
        ("wall", "universe", [0.0, -1.0, 1.0]), ("pulley", "universe", [0.0, 0.0, 1.0]),
        ("hook", "swing", [0.0, 0.3, -0.1]))}
    mechanism = sp.Mechanism.from_model(
        model, [sp.closures.rope(["wall", "pulley", "hook"], 2.2)], frames=frames,
        springs=[sp.Spring("stay", joint="swing", stiffness=3.0)])
    found = sp.equilibrium(mechanism)
    assert found.stable and force(found) < 1e-12
    alone = sp.Mechanism.from_model(
        model, [sp.closures.rope(["pulley", "hook"], 1.2)], frames=frames,
        springs=mechanism.springs)
    assert found.stiffness == pytest.approx(sp.equilibrium(alone).stiffness, rel=1e-12)


def test_without_drivers_the_coordinates_are_those_that_move_best():
    """Near its dead centre a crank moves, and its slide hardly does."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    for name, kind in (("slide", pin.JointModelPX()), ("crank", pin.JointModelRZ())):
        joint = model.addJoint(0, kind, pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)),
                                pin.SE3.Identity())
    frames = {"pin": ("crank", pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0])))}
    mechanism = sp.Mechanism.from_model(
        model, [sp.closures.distance("slide", "pin", 0.3)], frames=frames,
        guess={"slide": 0.4, "crank": 0.0},
        springs=[sp.Spring("stay", joint="crank", stiffness=3.0, free_angle=0.01)])
    found = sp.equilibrium(mechanism, {"slide": 0.4, "crank": 0.005})
    assert found.coordinates == ("crank",) and found.stiffness[0, 0] == pytest.approx(3.0)
    assert sp.linearize(mechanism, found.state).coordinates == ("crank",)


def test_nothing_rests_where_a_rotation_vector_jumps():
    """Its spring pulls the ball beyond half a turn, where the vector takes the other sense."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    ball = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(ball, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    springs = [sp.Spring("twist", joint="ball.x", stiffness=3.0, free_angle=4.0)]
    springs += [sp.Spring(c, joint=f"ball.{c}", stiffness=1.0) for c in "yz"]
    mechanism = sp.Mechanism.from_model(model, springs=springs)
    with pytest.raises(sp.SpatialPinError, match="'twist' is wound by half a turn"):
        sp.equilibrium(mechanism, {"ball": [2.0, 0.1, 0.0]})
