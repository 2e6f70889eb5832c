"""Where the drivers must be for frames to be where they should, against closed forms."""

from __future__ import annotations

import json

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from folders import DATA
from hypothesis import given, settings, strategies as st
from loaded_library import library
from machines import arm, at
from scipy.optimize import brute, minimize
from variety import few

import spatial_pin as sp
from spatial_pin import targets

CASSIE = DATA / "mjcf" / "agility_cassie" / "cassie.xml"


SHIFTS = st.tuples(*[st.floats(-0.02, 0.02)] * 3)
TURNS = st.tuples(*[st.floats(-0.1, 0.1)] * 3)


def gough_platform_comes_to(shift, turn):
    """Check a pose near the guess, by the legs of the closed form."""
    mechanism = library("stewart")
    start = sp.assemble(mechanism)
    there = start.placement("platform")
    target = pin.SE3(there.rotation @ pin.exp3(np.array(turn)), there.translation + shift)
    state = sp.reach(mechanism, {"platform": target}, start)
    off = target.actInv(state.placement("platform"))
    assert np.abs(off.translation).max() < 1e-13
    assert np.abs(pin.log3(off.rotation)).max() < 1e-13
    assert state.closure_error < 1e-13
    for k in range(1, 7):  # the distance of a leg's ends, in the platform's and the base's frame
        on_platform = there.actInv(start.placement(f"platform_{k}").translation)
        foot = start.placement(f"cylinder_{k}").translation
        length, before = (np.linalg.norm(pose.act(on_platform) - foot)
                          for pose in (target, there))
        moved = state.coordinate(f"leg_{k}").value - start.coordinate(f"leg_{k}").value
        assert moved == pytest.approx(length - before, abs=1e-12)


@given(SHIFTS, TURNS)
@settings(max_examples=6)
def test_a_gough_platform_comes_to_a_pose_with_the_legs_of_the_closed_form(shift, turn):
    gough_platform_comes_to(shift, turn)


@pytest.mark.slow
@given(SHIFTS, TURNS)
@settings(max_examples=25)
def test_a_gough_platform_comes_to_many_poses(shift, turn):
    gough_platform_comes_to(shift, turn)


def delta_robot_comes_to(x, y, z):
    """Check a point beside the guess, by the arms that assemble there."""
    mechanism = library("delta")
    start = sp.assemble(mechanism)
    point = start.placement("platform").translation + np.array([x, y, z])
    state = sp.reach(mechanism, {"platform": point}, start)
    assert np.abs(state.placement("platform").translation - point).max() < 1e-12
    again = sp.assemble(mechanism, {d: state.coordinate(d).value for d in mechanism.drivers}, state)
    assert np.abs(again.placement("platform").translation - point).max() < 1e-11


@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1))
@settings(max_examples=6)
def test_a_delta_robot_comes_to_a_point(x, y, z):
    delta_robot_comes_to(x, y, z)


@pytest.mark.slow
@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1))
@settings(max_examples=25)
def test_a_delta_robot_comes_to_many_points(x, y, z):
    delta_robot_comes_to(x, y, z)


def test_two_links_reach_a_point_by_the_law_of_cosines(tmp_path):
    mechanism = arm(tmp_path, (1.0, 0.8))
    state = sp.reach(mechanism, {"tip": [1.1, 0.6, 0.0]}, at(mechanism, 0.1, 0.9))
    square = 1.1**2 + 0.6**2
    elbow = np.arccos((square - 1.0 - 0.8**2) / (2.0 * 0.8))
    shoulder = np.arctan2(0.6, 1.1) - np.arctan2(0.8 * np.sin(elbow), 1.0 + 0.8 * np.cos(elbow))
    assert state.coordinate("j2").value == pytest.approx(elbow, abs=1e-13)
    assert state.coordinate("j1").value == pytest.approx(shoulder, abs=1e-13)
    other = sp.reach(mechanism, {"tip": [1.1, 0.6, 0.0]}, at(mechanism, 1.0, -0.9))
    assert other.coordinate("j2").value == pytest.approx(-elbow, abs=1e-13)


def test_limits_on_the_way_hide_no_target_and_the_nearest_elbow_is_taken(tmp_path):
    mechanism = arm(tmp_path, (1.0, 0.8), [(-3.1, 3.1), (-2.5, 2.5)])
    rng, far = np.random.default_rng(3), 0
    for _ in range(40):
        there, first = (rng.uniform((-3.1, -2.5), (3.1, 2.5)) for _ in range(2))
        point = np.array([np.cos(there[0]) + 0.8 * np.cos(there.sum()),
                          np.sin(there[0]) + 0.8 * np.sin(there.sum()), 0.0])
        start = at(mechanism, *first)
        try:
            sp.reach(mechanism, {"tip": point}, start, starts=0)
        except sp.ReachError as error:
            far += 1
            assert error.reasons == ("joint limit",)
            state = sp.reach(mechanism, {"tip": point}, start)
            assert np.abs(state.placement("tip").translation - point).max() < 1e-13
            bend, ways = np.arccos((point @ point - 1.0 - 0.8**2) / 1.6), []
            for elbow in (bend, -bend):
                shoulder = np.arctan2(point[1], point[0]) - np.arctan2(
                    0.8 * np.sin(elbow), 1.0 + 0.8 * np.cos(elbow))
                ways += [np.hypot(x - first[0], elbow - first[1])
                         for x in shoulder + 2.0 * np.pi * np.arange(-1, 2)
                         if abs(x) <= 3.1 and abs(elbow) <= 2.5]
            assert np.linalg.norm(state.q - first) == pytest.approx(min(ways), abs=1e-9)
    assert far > 3


@pytest.mark.parametrize("number", few([13, 31], 13))
def test_the_nearest_within_limits_is_that_of_a_global_search(tmp_path, number):
    limits = [(-1.5, 2.5), (-2.0, 2.0), (-2.0, 2.0)]
    mechanism = arm(tmp_path, limits=limits)

    def square(q, point):
        angles = np.cumsum(q)
        tip = [1.0, 0.8, 0.6] @ np.column_stack([np.cos(angles), np.sin(angles)])
        return np.sum((tip - point) ** 2)

    for point in ([-1.5, -1.4], [-0.2, -0.1], [-2.0, -0.4]):
        near = brute(square, limits, (point,), Ns=number, finish=None)
        best = minimize(square, near, (point,), bounds=limits, tol=1e-15)
        with pytest.raises(sp.ReachError) as caught:
            sp.reach(mechanism, {"tip": [*point, 0.0]}, at(mechanism, 0.3, -0.4, 0.5))
        found = caught.value.distances["tip"] * mechanism.characteristic_length
        assert found == pytest.approx(np.sqrt(best.fun), abs=1e-7)


@pytest.mark.parametrize(("name", "link"), [("four_bar", "coupler"), ("rssr", "rocker")])
def test_what_takes_taking_apart_is_not_reached(name, link):
    mechanism = library(name)
    here, other = sp.assembly_modes(mechanism)
    with pytest.raises(sp.ReachError):
        sp.reach(mechanism, {link: other.placement(link)}, here)


def test_what_is_left_free_moves_least(tmp_path):
    mechanism = arm(tmp_path)
    start = at(mechanism, 0.3, 0.4, 0.5)
    state = sp.reach(mechanism, {"tip": [1.2, 1.3, 0.0]}, start)

    def tip(q):
        angles = np.cumsum(q)
        return np.array([[1.0, 0.8, 0.6] @ np.cos(angles), [1.0, 0.8, 0.6] @ np.sin(angles)])

    least = minimize(lambda q: np.sum((q - start.q) ** 2), state.q + 0.01, method="SLSQP",
                     constraints={"type": "eq", "fun": lambda q: tip(q) - [1.2, 1.3]},
                     options={"ftol": 1e-16, "maxiter": 500})
    assert np.abs(tip(state.q) - [1.2, 1.3]).max() < 1e-13
    assert np.abs(state.q - least.x).max() < 1e-6


def placed(mechanism, q, name):
    data = mechanism.model.createData()
    pin.framesForwardKinematics(mechanism.model, data, q)
    return data.oMf[mechanism.frame_id(name)]


# what is asked for, and the same numbers from Pinocchio's placements
KINDS = {
    "part of a position": (
        lambda at, other: {"platform.position.x": at.translation[0] + 0.03},
        lambda at, other: at.translation[:1]),
    "position": (lambda at, other: {"platform": at.translation + np.array([0.03, -0.02, 0.01])},
                 lambda at, other: at.translation),
    "orientation": (
        lambda at, other: {"platform": targets.orientation(pin.exp3(np.array([0.1, 0.05, 0.08])))},
        lambda at, other: pin.log3(pin.exp3(np.array([0.1, 0.05, 0.08])).T @ at.rotation)),
    "direction": (
        lambda at, other: {"platform": targets.direction([0.0, 0.0, 1.0], [0.0, 0.6, 0.8])},
        lambda at, other: at.rotation[:, 2]),
    "angle": (lambda at, other: {"platform.angle.z": 0.2},
              lambda at, other: [np.arctan2(at.rotation[1, 0], at.rotation[0, 0])]),
    "distance": (
        lambda at, other: {"platform": targets.distance(
            "cylinder_1", 1.05 * np.linalg.norm(at.translation - other.translation))},
        lambda at, other: [np.linalg.norm(at.translation - other.translation)]),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_platform_meets_any_target_by_the_least_displacement(kind):
    """The displacement from the start has no slope along motions that keep loops and target."""
    asked, value = KINDS[kind]
    mechanism = library("stewart")
    start = sp.assemble(mechanism)
    model, scale = mechanism.model, mechanism.velocity_scale
    goal = asked(*(placed(mechanism, start.q, x) for x in ("platform", "cylinder_1")))
    state = sp.reach(mechanism, goal, start, limits=False)

    def measured(v):
        q = pin.integrate(model, state.q, scale * v)
        return np.array(value(*(placed(mechanism, q, x) for x in ("platform", "cylinder_1"))))

    h = 1e-5
    rows = np.array([(measured(h * x) - measured(-h * x)) / (2.0 * h) for x in np.eye(model.nv)])
    closures = sp.closure_jacobian(mechanism, state) * scale
    away = pin.difference(model, start.q, state.q) / scale
    slope = scale * (pin.dDifference(model, start.q, state.q, pin.ARG1).T @ (away / scale))
    pulls = np.hstack([closures.T, rows])
    left = slope - pulls @ np.linalg.lstsq(pulls, slope, rcond=1e-8)[0]
    assert np.abs(left).max() < 1e-9
    assert np.linalg.norm(away) > 0.01
    assert state.closure_error < 1e-13


def test_targets_with_a_weight_are_met_in_the_freedom_that_is_left(tmp_path):
    mechanism = arm(tmp_path)
    start = at(mechanism, 0.3, 0.4, 0.5)
    state = sp.reach(mechanism, {
        "tip": [1.2, 1.3, 0.0], "link3": targets.direction([1, 0, 0], [0, 1, 0], weight=1.0)},
        start)
    assert np.abs(state.placement("tip").translation - [1.2, 1.3, 0.0]).max() < 1e-13
    axis = state.placement("link3").rotation[:, 0]
    assert np.abs(axis - [0.0, 1.0, 0.0]).max() < 1e-7  # it can be met


def test_two_weighted_targets_share_what_both_cannot_have(tmp_path):
    mechanism = arm(tmp_path, (1.0,))
    wanted = {"j1": targets.coordinate(0.0, weight=1.0),
              "tip": targets.direction([1, 0, 0], [0, 1, 0], weight=2.0)}
    state = sp.reach(mechanism, wanted, at(mechanism, 0.2))
    assert state.q[0] == pytest.approx(4.0 / 5.0 * np.pi / 2.0, abs=1e-8)


def test_what_no_motion_brings_nearer_leaves_the_least_motion(tmp_path):
    """An axis in the plane is normal to the plane's normal, however it turns."""
    mechanism = arm(tmp_path)
    start = at(mechanism, 0.3, 0.4, 0.5)
    tip = {"tip": [1.2, 1.3, 0.0]}
    level = targets.direction([1, 0, 0], [0, 0, 1], weight=0.1)
    state = sp.reach(mechanism, tip | {"link3": level}, start)
    assert np.abs(state.q - sp.reach(mechanism, tip, start).q).max() < 1e-11


@pytest.mark.delicate
@pytest.mark.parametrize("least_turn", few([None, 0.2], 0.2))
def test_of_equal_sums_that_cannot_vanish_the_nearest_is_taken(tmp_path, least_turn):
    limits = [(-3, 3), (least_turn, 3)] if least_turn else []
    mechanism = arm(tmp_path, (1.0, 0.8, 0.6, 0.5, 0.4), limits)
    start = at(mechanism, 0.3, 0.4, 0.5, -0.3, 0.2)
    far = np.array([2.0, 2.5, 0.0])  # two links stretch towards it
    state = sp.reach(mechanism, {
        "tip": targets.distance("link3", 1.3),
        "link3": targets.position(far, weight=1.0),
        "link5": targets.direction([1, 0, 0], [0, 0, 1], weight=0.5)}, start)
    elbow = least_turn or 0.0
    bent = np.arctan2(0.8 * np.sin(elbow), 1.0 + 0.8 * np.cos(elbow))
    assert np.abs(state.q[:2] - [np.arctan2(2.5, 2.0) - bent, elbow]).max() < 1e-9

    def length(q):
        return abs(0.6 + 0.5 * np.exp(1j * q[0]) + 0.4 * np.exp(1j * (q[0] + q[1])))

    least = minimize(lambda q: np.sum((q - start.q[2:]) ** 2), start.q[2:], method="SLSQP",
                     constraints={"type": "eq", "fun": lambda q: length(q[1:]) - 1.3},
                     options={"ftol": 1e-16, "maxiter": 500})
    assert np.abs(state.q[2:] - least.x).max() < 1e-6


def test_no_machine_stops_an_excavator_elsewhere():
    """The direction of its teeth is normal to the plane of its arm: all places are equal."""
    mechanism = library("excavator")
    teeth = targets.position([8.0, 0.0, 0.0])
    alone = sp.reach(mechanism, {"teeth": teeth})
    both = sp.reach(mechanism, {
        "teeth": [teeth, targets.direction([0, 0, 1], [0, 1, 0], weight=0.1)]})
    assert np.abs(both.q - alone.q).max() < 1e-9


def test_flat_ways_do_not_lead_astray():
    """Cassie's rods turn idly: steps that turned them left no length for the others."""
    with pytest.warns(sp.SpatialPinWarning, match="mesh files"):
        mechanism = sp.load(CASSIE)
    start = sp.assemble(mechanism)
    # the file's numbers are rounded, and its loops close to their ninth digit: so does the target
    far = start.placement("left-foot").translation.round(6) + np.array([3.0, 0.0, 2.1])
    state = sp.reach(mechanism, {"left-foot": targets.position(far, weight=1.0)}, start, starts=0)
    off = np.linalg.norm(state.placement("left-foot").translation - far)
    assert off / mechanism.characteristic_length == pytest.approx(2.12315411124464, abs=1e-12)
    again = sp.reach(mechanism, {"left-foot": targets.position(far, weight=1.0)}, state, starts=0)
    assert np.linalg.norm(again.placement("left-foot").translation - far) > off - 1e-12


@pytest.mark.parametrize("toward", few([(-0.7, 0.3, 0.6), (0.2, -0.9, -0.4)], (0.2, -0.9, -0.4)))
def test_what_leaves_targets_as_far_off_is_moved_least(toward):
    """A foot's axis turned as far as a hip's limits let it: what its leg does besides is free."""
    with pytest.warns(sp.SpatialPinWarning, match="mesh files"):
        mechanism = sp.load(CASSIE)
    start, toward = sp.assemble(mechanism), np.array(toward) / np.linalg.norm(toward)
    with pytest.raises(sp.ReachError) as caught:
        sp.reach(mechanism, {"left-foot": targets.direction([0, 0, 1], toward)}, start)
    state = caught.value.state
    moved = pin.difference(mechanism.model, start.q, state.q)
    hips = [mechanism.model.joints[mechanism.joint_id(f"left-hip-{x}")].idx_v
            for x in ("roll", "yaw")]
    assert np.abs(np.delete(moved, hips)).max() < 1e-9 < np.abs(moved[hips]).min()


def test_what_nothing_moves_stands_where_it_was():
    mechanism = library("delta")
    start = sp.assemble(mechanism)
    with pytest.raises(sp.ReachError) as caught:
        sp.reach(mechanism, {"platform": targets.direction([0, 0, 1], [0.6, 0.0, 0.8])}, start)
    assert caught.value.reasons == ("nothing moves",)
    assert np.abs(caught.value.state.q - start.q).max() < 1e-12


def test_every_kind_of_target_is_met_exactly(tmp_path):
    mechanism = arm(tmp_path, (1.0, 0.8, 0.6, 0.5, 0.4))
    start = at(mechanism, 0.3, 0.4, -0.5, 0.3, 0.2)
    state = sp.reach(mechanism, {
        "tip": targets.direction([0, 1, 0], np.array([0.6, 0.8, 0.0])),
        "link2": targets.distance("tip", 1.5),
        "j2": 0.7,
        "mass": targets.centre_of_mass(None, 1.2, None)}, start)
    assert np.abs(state.placement("tip").rotation[:, 1] - [0.6, 0.8, 0.0]).max() < 1e-12
    gap = state.placement("link2").translation - state.placement("tip").translation
    assert np.linalg.norm(gap) == pytest.approx(1.5, abs=1e-12)
    assert state.coordinate("j2").value == pytest.approx(0.7, abs=1e-12)
    links = [f"link{k}" for k in range(1, 6)]
    centre = sum(k * state.com(name).position for k, name in enumerate(links, start=1)) / 15.0
    assert centre[1] == pytest.approx(1.2, abs=1e-12)
    pose = sp.reach(mechanism, {"tip": targets.pose(start.placement("tip"))}, state)
    assert pose.placement("tip").isApprox(start.placement("tip"), 1e-12)
    turned = sp.reach(mechanism, {"tip": targets.orientation(pin.exp3(np.array([0, 0, 1.0])))})
    assert np.abs(turned.placement("tip").rotation - pin.exp3(np.array([0, 0, 1.0]))).max() < 1e-12


# ---------------------------------------------------------------- limits, and what is out of reach


def test_joint_limits_are_kept_where_the_target_can_be_met_with_them(tmp_path):
    mechanism = arm(tmp_path, limits=[(-3, 3), (-0.2, 0.45), (-3, 3)])
    start = at(mechanism, 0.3, 0.4, 0.5)
    free = sp.reach(mechanism, {"tip": [0.6, 1.2, 0.0]}, start, limits=False)
    assert free.coordinate("j2").value > 0.5
    kept = sp.reach(mechanism, {"tip": [0.6, 1.2, 0.0]}, start)
    assert np.abs(kept.placement("tip").translation - [0.6, 1.2, 0.0]).max() < 1e-12
    assert kept.coordinate("j2").value == pytest.approx(0.45, abs=1e-9)
    assert not kept.beyond_limits


def test_a_limit_that_stops_it_is_named(tmp_path):
    mechanism = arm(tmp_path, (1.0, 0.8), limits=[(-0.5, 0.5), (-0.5, 0.5)])
    with pytest.raises(sp.ReachError, match=r"upper limit 0\.5 rad of j1") as caught:
        sp.reach(mechanism, {"tip": [-1.0, 1.0, 0.0]}, at(mechanism, 0.1, 0.1))
    error = caught.value
    assert set(error.limits) == {"j1", "j2"}
    assert error.state.q == pytest.approx([0.5, 0.5], abs=1e-12)
    nearest = error.state.placement("tip").translation
    size = mechanism.characteristic_length
    assert error.distances["tip"] == pytest.approx(
        np.linalg.norm(nearest - [-1.0, 1.0, 0.0]) / size, abs=1e-12)


@pytest.mark.delicate
def test_a_stretched_arm_is_the_nearest_and_reported_as_stretched(tmp_path):
    mechanism = arm(tmp_path, (1.0, 0.8))
    with pytest.raises(sp.ReachError, match="stretched out or folded") as caught:
        sp.reach(mechanism, {"tip": [3.0, 4.0, 0.0]}, at(mechanism, 0.1, 0.5))
    nearest = caught.value.state.placement("tip").translation
    assert np.abs(nearest - 1.8 * np.array([0.6, 0.8, 0.0])).max() < 1e-6
    assert not caught.value.limits


def test_too_much_is_requested_of_few_freedoms():
    mechanism = library("four_bar")
    point = sp.assemble(mechanism).placement("coupler").translation + np.array([0.3, 0.1, 0.01])
    with pytest.raises(sp.ReachError, match="1 freedom there for 3 numbers"):
        sp.reach(mechanism, {"coupler": point})


def test_a_planar_arm_has_two_freedoms_for_a_point_off_its_plane(tmp_path):
    mechanism = arm(tmp_path)
    with pytest.raises(sp.ReachError, match="2 freedoms there for 3 numbers"):
        sp.reach(mechanism, {"tip": [1.0, 0.5, 0.3]}, at(mechanism, 0.2, 0.4, 0.3))


def test_a_link_that_nothing_moves_is_reported():
    mechanism = library("rssr")
    point = sp.assemble(mechanism).placement("rocker").translation + 0.1
    with pytest.raises(sp.ReachError, match="no free coordinate moves them"):
        sp.reach(mechanism, {"rocker": point})


def test_a_crank_many_turns_away_is_reached_and_hundreds_are_on_the_way():
    mechanism = library("rssr")
    near, far = 150.0, 1200.0
    assert sp.reach(mechanism, {"crank": near}).coordinate("crank_pin").value == pytest.approx(
        near, rel=0, abs=1e-12)
    with pytest.raises(sp.ReachError, match="still coming nearer") as caught:
        sp.reach(mechanism, {"crank": far})
    assert sp.reach(mechanism, {"crank": far}, caught.value.state).coordinate(
        "crank_pin").value == pytest.approx(far, rel=0, abs=1e-12)


@pytest.mark.parametrize("turn", [1e-3, 0.5, 2.0])
def test_an_idle_rotation_that_is_requested_is_made(turn):
    mechanism = library("rssr")  # its coupler spins between two balls
    start = sp.assemble(mechanism)
    coupler = start.placement("coupler")
    along = start.placement("coupler_b").translation - coupler.translation
    turned = pin.exp3(turn * along / np.linalg.norm(along)) @ coupler.rotation
    state = sp.reach(mechanism, {"coupler": pin.SE3(turned, coupler.translation)}, start)
    assert state.closure_error < 1e-12
    assert np.abs(state.placement("coupler").rotation - turned).max() < 1e-12
    assert state.coordinate("crank_pin").value == pytest.approx(
        start.coordinate("crank_pin").value, rel=0, abs=1e-9)


def test_idle_rotations_move_least():
    mechanism = library("rssr")
    start = sp.assemble(mechanism)
    state = sp.reach(mechanism, {"crank": 0.6}, start)

    def moved(spin):
        along = state.placement("coupler_b").translation - state.placement("coupler").translation
        along /= np.linalg.norm(along)
        turned = pin.exp3(spin * along) @ state.placement("coupler").rotation
        spun = sp.reach(mechanism, {"crank": 0.6, "coupler": targets.orientation(turned)}, state)
        return np.linalg.norm(
            pin.difference(mechanism.model, start.q, spun.q) / mechanism.velocity_scale)

    assert moved(0.0) < min(moved(1e-3), moved(-1e-3))


def test_what_is_held_stands_still():
    mechanism = library("stewart")
    start = sp.assemble(mechanism)
    point = start.placement("platform").translation + np.array([0.01, 0.0, 0.02])
    state = sp.reach(mechanism, {"platform": point}, start, hold=["leg_1"])
    assert state.coordinate("leg_1").value == start.coordinate("leg_1").value
    assert np.abs(state.placement("platform").translation - point).max() < 1e-12


def test_the_answer_does_not_depend_on_earlier_calls():
    mechanism = library("delta")
    start = sp.assemble(mechanism)
    point = start.placement("platform").translation + np.array([0.1, 0.05, 0.02])
    first = sp.reach(mechanism, {"platform": point}, start)
    sp.reach(mechanism, {"platform": point - 0.1}, start)
    assert np.array_equal(sp.reach(mechanism, {"platform": point}, start).q, first.q)


# ---------------------------------------------------------------- the nearest, by other solvers


def leg_lengths(mechanism, start):
    """Return the lengths of a Gough platform's legs as a function of where the platform is."""
    home = start.placement("platform")
    feet = [start.placement(f"cylinder_{k}").translation for k in range(1, 7)]
    tops = [home.actInv(start.placement(f"platform_{k}").translation) for k in range(1, 7)]
    slides = np.array([start.coordinate(f"leg_{k}").value for k in range(1, 7)])

    def lengths(place):
        return np.array([np.linalg.norm(place.act(t) - f) for t, f in zip(tops, feet, strict=True)])

    before = lengths(home)
    return lambda place: slides + lengths(place) - before


@pytest.mark.parametrize("seed", few(range(6), 1))
def test_nearest_points_of_a_gough_platform_are_those_of_its_closed_form(seed):
    """Half of them out of reach, by its six legs' limits; none beyond these."""
    mechanism = library("stewart")
    start = sp.assemble(mechanism)
    home, size = start.placement("platform"), mechanism.characteristic_length
    legs = leg_lengths(mechanism, start)
    (low,), (high,) = (set(getattr(mechanism.model, f"{side}PositionLimit")[
        [c.q for n, c in mechanism.coordinate_table.items() if n.startswith("slide")]])
        for side in ("lower", "upper"))
    point = start.placement("platform_4").translation
    corner = home.actInv(point)
    way = np.random.default_rng(seed).normal(size=3)
    point = point + (0.5 if seed % 2 else 0.25) * size * way / np.linalg.norm(way)

    def place(x):
        return pin.SE3(home.rotation @ pin.exp3(x[3:]), home.translation + size * x[:3])

    def off(x):
        return np.sum((place(x).act(corner) - point) ** 2) / size**2

    rng, best = np.random.default_rng(1), np.inf
    for _ in range(12):
        found = minimize(off, rng.uniform(-0.4, 0.4, 6), method="SLSQP", constraints=[
            {"type": "ineq", "fun": lambda x: high - legs(place(x))},
            {"type": "ineq", "fun": lambda x: legs(place(x)) - low}],
            options={"ftol": 1e-16, "maxiter": 300})
        inside = min((high - legs(place(found.x))).min(), (legs(place(found.x)) - low).min())
        best = min(best, np.sqrt(found.fun)) if inside > -1e-7 else best
    try:
        state, distance = sp.reach(mechanism, {"platform_4": point}, start), 0.0
    except sp.ReachError as error:
        state, distance = error.state, error.distances["platform_4"]
        assert error.reasons == ("joint limit",) and error.limits
    assert not state.beyond_limits
    assert distance == pytest.approx(best, abs=1e-5)


def test_least_motion_goes_along_limits(tmp_path):
    """A limit that the way to it meets; it is left again where the least motion leaves it."""
    mechanism = arm(tmp_path, (1.0, 0.8, 0.6, 0.4), limits=[(-3, 3), (-0.2, 0.45), (-0.3, 0.7)])
    start = at(mechanism, 0.3, 0.4, 0.5, 0.1)
    point = np.array([0.4, 1.9])
    state = sp.reach(mechanism, {"tip": [*point, 0.0]}, start)

    def tip(q):
        angles, lengths = np.cumsum(q), np.array([1.0, 0.8, 0.6, 0.4])
        return np.array([lengths @ np.cos(angles), lengths @ np.sin(angles)])

    least = minimize(lambda q: np.sum((q - start.q) ** 2), start.q, method="SLSQP",
                     bounds=[(-3, 3), (-0.2, 0.45), (-0.3, 0.7), (None, None)],
                     constraints={"type": "eq", "fun": lambda q: tip(q) - point},
                     options={"ftol": 1e-16, "maxiter": 500})
    assert np.abs(state.q - least.x).max() < 1e-6
    assert not state.beyond_limits


@pytest.mark.filterwarnings("ignore:Values in x were outside bounds")  # SciPy's own, up to 1.13
@pytest.mark.parametrize(("wanted", "weight"), [((0.3, 2.0), 1.0), ((-1.5, 1.0), 0.3)])
def test_sums_of_weighted_residuals_are_least_within_limits(tmp_path, wanted, weight):
    mechanism = arm(tmp_path, limits=[(-3, 3), (-0.2, 0.9), (-0.5, 1.2)])
    start = at(mechanism, 0.3, 0.4, 0.5)
    size = mechanism.characteristic_length
    state = sp.reach(mechanism, {"tip": targets.position([*wanted, 0.0], weight=1.0),
                                 "j1": targets.coordinate(0.2, weight=weight)}, start)

    def cost(q):
        angles, lengths = np.cumsum(q), np.array([1.0, 0.8, 0.6])
        tip = np.array([lengths @ np.cos(angles), lengths @ np.sin(angles)])
        return np.sum((tip - wanted) ** 2) / size**2 + (weight * (q[0] - 0.2)) ** 2

    rng = np.random.default_rng(0)
    bounds = [(-3, 3), (-0.2, 0.9), (-0.5, 1.2)]
    least = min((minimize(cost, rng.uniform(*zip(*bounds, strict=True)), method="SLSQP",
                          bounds=bounds, options={"ftol": 1e-16}) for _ in range(10)),
                key=lambda found: found.fun)
    assert cost(state.q) == pytest.approx(least.fun, rel=1e-9)
    assert not state.beyond_limits


@pytest.mark.delicate
def test_the_nearest_rocker_is_where_its_dead_centre_is():
    mechanism = library("rssr")
    start = sp.assemble(mechanism)
    with pytest.raises(sp.ReachError, match="dead centre") as caught:
        sp.reach(mechanism, {"rocker_pin": start.coordinate("rocker_pin").value + 2.0}, start)
    assert caught.value.reasons == ("dead centre",)
    turn = sp.sweep(mechanism, "crank", np.linspace(0.0, 2.0 * np.pi, 20001), guess=start)
    most = turn.coordinate("rocker_pin").value.max()
    assert caught.value.state.coordinate("rocker_pin").value == pytest.approx(most, abs=1e-7)


def teeth_everywhere(mechanism, start, count):
    """Return places (N,) of the teeth, as complex numbers x + iz, for all lengths of cylinders."""
    turns = []
    for name in ("boom", "arm", "bucket"):  # each turns one hinge of the plane chain
        c, here = mechanism.coordinate(name), start.coordinate(name).value
        turned = [sp.sweep(mechanism, name, np.linspace(here, end[c.q], count), guess=start)
                  .coordinate(f"{name}_pin").value for end in
                  (mechanism.model.lowerPositionLimit, mechanism.model.upperPositionLimit)]
        turns.append(np.exp(1j * (np.concatenate(turned) - start.coordinate(f"{name}_pin").value)))
    pins = [complex(*start.placement(name).translation[[0, 2]])
            for name in ("boom", "arm", "bucket", "teeth")]
    boom, arm_, bucket = np.diff(pins)
    first, second, third = np.ix_(*turns)
    return (pins[0] + first * (boom + second * (arm_ + third * bucket))).ravel()


PLACES = [(10.5, 0.0), (0.5, -6.5), (4.5, 11.0), (1.0, 1.5), (8.5, -6.0), (3.0, -8.0), (8.0, 10.0),
          (0.5, 5.0), (2.5, 9.5), (5.5, 8.5)]


@pytest.mark.parametrize("number", few([4, 10], 4))
def test_nearest_places_of_an_excavator_are_those_of_all_lengths_of_its_cylinders(number):
    mechanism = library("excavator")
    start = sp.assemble(mechanism)
    raised = sp.assemble(mechanism, {"boom": 3.3, "arm": 2.3}, start)
    everywhere = teeth_everywhere(mechanism, start, 40)
    for x, z in PLACES[:number]:
        off = []
        for state in (start, raised):
            with pytest.raises(sp.ReachError) as caught:
                sp.reach(mechanism, {"teeth": [x, 0.0, z]}, state, hold="swing", starts=2)
            off.append(caught.value.distances["teeth"] * mechanism.characteristic_length)
            assert not caught.value.state.beyond_limits
        best = np.abs(everywhere - (x + 1j * z)).min()
        assert min(off) <= best + 1e-9 and min(off) == pytest.approx(best, abs=0.05)


@pytest.mark.delicate
def test_the_way_off_a_dead_centre_is_not_the_long_one():
    mechanism = library("rssr")
    start = sp.assemble(mechanism)
    near = sp.assemble(mechanism, {"crank": 0.018044559959500384}, start)
    apart = np.linalg.norm(near.placement("coupler_b").translation
                           - near.placement("crank").translation)
    state = sp.reach(mechanism, {"crank": targets.distance("coupler_b", apart)}, start)
    moved, needed = (pin.difference(mechanism.model, start.q, x.q) / mechanism.velocity_scale
                     for x in (state, near))
    assert np.linalg.norm(moved) < 1.01 * np.linalg.norm(needed)


@pytest.mark.delicate
def test_a_dead_centre_at_which_it_starts_is_left():
    mechanism = library("rssr")
    start = sp.assemble(mechanism)  # its rocker is at one end of its swing
    wanted = start.coordinate("rocker_pin").value + 0.3
    state = sp.reach(mechanism, {"rocker_pin": wanted}, start, starts=0)
    assert state.coordinate("rocker_pin").value == pytest.approx(wanted, abs=1e-12)


def test_a_state_beyond_limits_is_led_back_within(tmp_path):
    mechanism = arm(tmp_path, (1.0, 0.8, 0.6), limits=[(-0.5, 0.5), (-3, 3), (-3, 3)])
    with pytest.warns(sp.SpatialPinWarning, match="beyond joint limits"):
        start = at(mechanism, 0.9, 0.4, 0.5)
    state = sp.reach(mechanism, {"tip": [1.2, 1.3, 0.0]}, start)
    assert not state.beyond_limits
    assert np.abs(state.placement("tip").translation - [1.2, 1.3, 0.0]).max() < 1e-12


@pytest.mark.delicate
@pytest.mark.parametrize(("name", "wanted", "reason"), [
    ("stewart", {"platform": [0.0, 0.0, 9.0]}, "joint limit"),
    ("scotch_yoke", {"slide": 9.0}, "dead centre"),
    ("delta", {"platform": [0.0, 0.0, 9.0]}, "singular direction"),
    ("four_bar", {"coupler": [0.3, 0.1, 9.0]}, "too few freedoms"),
    ("rssr", {"rocker": [0.3, 0.1, 9.0]}, "nothing moves"),
    ("rssr", {"crank": 1200.0}, "steps"),
])
def test_what_stops_it_has_a_word(name, wanted, reason):
    with pytest.raises(sp.ReachError) as caught:
        sp.reach(library(name), wanted)
    error = caught.value
    assert error.reasons == (reason,) and len(error.stops) == 1
    for key, off in error.residuals.items():
        assert np.linalg.norm(off) == pytest.approx(error.distances[key])
    assert bool(error.limits) == (reason == "joint limit")


def test_one_frame_may_have_several_targets(tmp_path):
    mechanism = library("stewart")
    start = sp.assemble(mechanism)
    home = start.placement("platform")
    tilted = pin.exp3(np.array([0.1, -0.05, 0.0])) @ home.rotation[:, 2]
    point = home.translation + np.array([0.01, 0.02, 0.03])
    state = sp.reach(mechanism, {"platform": [targets.position(point), targets.direction(
        [0, 0, 1], tilted)]}, start)
    there = state.placement("platform")
    assert np.abs(there.translation - point).max() < 1e-12
    assert np.abs(there.rotation[:, 2] - tilted).max() < 1e-12
    with pytest.raises(TypeError, match="a frame has a point"):
        sp.reach(mechanism, {"platform": [targets.position(point), "up"]}, start)


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(("wanted", "error", "words"), [
    ({"nobody": [0, 0, 0]}, sp.UnknownNameError, "nobody"),
    ({"nobody": 0.1}, sp.UnknownNameError, "nobody"),
    ({"coupler": "up"}, TypeError, "a frame has a point"),
    ({"coupler": [0, 0]}, TypeError, r"\[0, 0\] is none; a frame has a point"),
    ({"coupler": 0.1}, TypeError, "0.1 is none; a frame has a point"),
    ({"coupler": [0, 0, np.nan]}, ValueError, "coupler"),
    ({}, ValueError, "targets is empty"),
    ({"crank": 0.1, "crank_pin": 0.2}, ValueError, "contradict .* coordinate 'crank_pin'"),
    ({"coupler": [targets.position([0, 0, 1]), targets.position([0, 0, 2])]}, ValueError,
     "contradict .* the origin of 'coupler'"),
    ({"coupler": targets.distance("coupler", 1.0)}, ValueError, "from itself"),
    ({"coupler": pin.SE3(2.0 * np.eye(3), np.zeros(3))}, ValueError, "no rotation matrix"),
])
def test_bad_targets_are_refused_before_work_begins(wanted, error, words):
    with pytest.raises(error, match=words):
        sp.reach(library("four_bar"), wanted)


def test_targets_that_contradict_may_have_weights_and_may_agree():
    mechanism = library("four_bar")
    state = sp.reach(mechanism, {"crank": 0.1, "crank_pin": targets.coordinate(0.3, weight=1.0)})
    assert state.coordinate("crank_pin").value == pytest.approx(0.1, abs=1e-12)
    state = sp.reach(mechanism, {"crank": 0.1, "crank_pin": 0.1})
    assert state.coordinate("crank_pin").value == pytest.approx(0.1, abs=1e-12)
    with pytest.raises(ValueError, match="starts is -1"):
        sp.reach(mechanism, {"crank": 0.1}, starts=-1)


@pytest.mark.parametrize("made", [
    lambda: targets.position([0, 0]), lambda: targets.position([0, 0, 0], weight=-1.0),
    lambda: targets.orientation(2 * np.eye(3)), lambda: targets.direction([0, 0, 2], [0, 0, 1]),
    lambda: targets.distance("a", 0.0), lambda: targets.centre_of_mass(None, None, None),
    lambda: targets.coordinate(np.inf),
])
def test_bad_numbers_are_refused_where_a_target_is_made(made):
    with pytest.raises(ValueError):
        made()


def test_a_mechanism_without_mass_has_no_centre_of_mass(tmp_path):
    mechanism = known.load(tmp_path, "bare", known.turning("a", "ground", "b"), "")
    with pytest.raises(sp.SpatialPinError, match="no centre of mass"):
        sp.reach(mechanism, {"all": targets.centre_of_mass(0.0, 0.0, 0.0)})


# ---------------------------------------------------------------- command line


def test_the_command_line_reaches_and_tells(tmp_path, run):
    mechanism = library("delta")
    there = sp.assemble(mechanism).placement("platform").translation + np.array([0.05, 0.02, -0.03])
    words = ",".join(f"{1e3 * x!r}mm" for x in there.tolist())
    target = tmp_path / "state.json"
    code, said, _ = run("reach", "delta", f"platform.position={words}", "--json", target)
    assert code == 0 and "driver arm_1" in said
    q = np.array(json.loads(target.read_text())["q"])
    state = sp.assemble(mechanism, {}, q)
    assert np.abs(state.placement("platform").translation - there).max() < 1e-11


def test_one_frame_has_several_targets_in_the_command_line(tmp_path, run):
    target = tmp_path / "state.json"
    code, _, _ = run("reach", "stewart", "platform.position=0,0,0.42",
                     "platform.direction=0.1,0,1", "--json", target)
    assert code == 0
    mechanism = library("stewart")
    state = sp.assemble(mechanism, {}, np.array(json.loads(target.read_text())["q"]))
    there = state.placement("platform")
    assert there.translation == pytest.approx([0.0, 0.0, 0.42], abs=1e-11)
    assert there.rotation[:, 2] == pytest.approx(np.array([0.1, 0, 1]) / np.sqrt(1.01), abs=1e-11)
    code, _, told = run("reach", "stewart", "platform.position=0,0,0.42",
                        "platform.position=0,0,1")
    assert code == 1 and "contradict" in told
    code, _, told = run("reach", "stewart", "leg_1=0.4", "leg_1=0.41")
    assert code == 2 and "two values" in told


@pytest.mark.parametrize(("word", "code", "told"), [
    ("platform.position=0,0", 2, "has 3 numbers, not 2"),
    ("platform.position=0,0,1rad", 2, "has numbers in m"),
    ("platform=0,0,1", 2, "several numbers are those of"),
    ("platform.direction=0,0,0", 2, "along"),
    ("platform", 2, "is not NAME.position"),
    ("nobody.position=0,0,1", 1, "nobody"),
    ("arm_1=20mm", 1, "arm_1 is in rad"),
    ("platform.position=0,0,9", 1, "cannot be reached"),
    ("platform.pose=0,0,0,0,0", 2, "has 6 numbers"),
])
def test_bad_words_are_refused(run, word, code, told):
    found, _, error = run("reach", "delta", word)
    assert found == code
    assert told in error


@pytest.mark.delicate
@pytest.mark.parametrize("name", ["four_bar", "rssr", "bennett", "sarrus", "slider_crank"])
def test_loops_are_closed_whether_a_target_is_reached_or_not(name):
    mechanism = library(name)
    start = sp.assemble(mechanism)
    for c in mechanism.coordinate_table.values():
        if c.q < 0:
            continue
        for way in (0.3, 2.0, -2.5):
            target = start.coordinate(c.name).value + way * mechanism.velocity_scale[c.v]
            try:
                state = sp.reach(mechanism, {c.name: target}, start, starts=2)
                assert state.coordinate(c.name).value == pytest.approx(target, abs=1e-11)
            except sp.ReachError as error:
                state = error.state
            assert state.closure_error < 1e-11, (c.name, way)
