"""Frames go along tables of targets on one branch, with the guarantees of `follow`."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from machines import arm, at
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from tables import columns

import spatial_pin as sp

TIMES = np.linspace(0.0, 2.0, 81)
UP = np.array([0.0, 0.0, 1.0])


def figure(start, times=TIMES, size=0.02, turn=0.2):
    """Return placements over time, the first as it is given."""
    turns = np.column_stack([0.5 * np.sin(times), 0.4 * np.sin(2.0 * times), np.sin(times)])
    away = np.column_stack([np.sin(2.0 * times), 1.0 - np.cos(2.0 * times), 0.5 * np.sin(times)])
    return [pin.SE3(start.rotation @ pin.exp3(turn * w), start.translation + size * x)
            for w, x in zip(turns, away, strict=True)], turn * turns


def platform():
    mechanism = library("stewart")
    state = sp.assemble(mechanism)
    return mechanism, state, state.placement("platform")


def flyer():
    """Return a body that may go anywhere."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    return sp.Mechanism.from_model(model, name="flyer")


# ---------------------------------------------------------------- where they go


def test_the_legs_of_a_gough_platform_are_those_of_the_closed_form():
    mechanism, start, home = platform()
    poses, _ = figure(home)
    motion = sp.reach_path(mechanism, {"platform": poses}, TIMES, start)
    assert motion.driver is None and np.array_equal(motion.time, TIMES)
    found = motion.frame("platform")
    assert np.abs(found.position - [p.translation for p in poses]).max() < 1e-12
    assert np.abs(found.rotation - [p.rotation for p in poses]).max() < 1e-12
    assert motion.closure_error.max() < 1e-13
    assert motion.q.shape == (len(TIMES), mechanism.model.nq)
    for k in range(1, 7):
        on_platform = home.actInv(start.placement(f"platform_{k}").translation)
        foot = start.placement(f"cylinder_{k}").translation
        lengths = np.array([np.linalg.norm(p.act(on_platform) - foot) for p in (home, *poses)])
        moved = motion.coordinate(f"leg_{k}").value - start.coordinate(f"leg_{k}").value
        assert np.abs(moved - (lengths[1:] - lengths[0])).max() < 1e-12


def test_a_delta_robot_stands_as_its_arms_assemble():
    mechanism = library("delta")
    start = sp.assemble(mechanism)
    points = start.placement("platform").translation + np.column_stack(
        [0.1 * np.sin(2.0 * TIMES), 0.1 * (1.0 - np.cos(2.0 * TIMES)), 0.05 * TIMES])
    motion = sp.reach_path(mechanism, {"platform": points}, TIMES, start)
    assert np.abs(motion.frame("platform").position - points).max() < 1e-12
    for k in (0, 31, 80):
        arms = {d: motion.coordinate(d).value[k] for d in mechanism.drivers}
        alone = sp.assemble(mechanism, arms, motion.state(k))
        assert np.abs(alone.placement("platform").translation - points[k]).max() < 1e-12
    # as its platform cannot turn, placements that do not are as good
    rotation = start.placement("platform").rotation
    poses = [pin.SE3(rotation, x) for x in points]
    again = sp.reach_path(mechanism, {"platform": poses}, TIMES, start)
    assert np.abs(again.q - motion.q).max() < 1e-12
    assert np.abs(again.a - motion.a).max() < 1e-9 * np.abs(motion.a).max()


def test_coordinates_are_targets_as_drivers_are():
    mechanism, start, _ = platform()
    legs = {name: start.coordinate(name).value + 0.01 * np.sin((k + 1.0) * TIMES)
            for k, name in enumerate(mechanism.drivers)}
    motion = sp.reach_path(mechanism, legs, TIMES, start)
    other = sp.follow(mechanism, legs, TIMES, guess=start)
    assert np.abs(motion.q - other.q).max() < 1e-12
    assert np.abs(motion.a - other.a).max() < 1e-9


def test_a_point_and_an_angle_determine_a_plane_arm(tmp_path):
    mechanism = arm(tmp_path)
    start = at(mechanism, 0.3, 0.4, 0.5)
    angles = np.column_stack([0.3 + 0.5 * np.sin(TIMES), 0.4 + 0.2 * TIMES, np.full(81, 0.5)])
    sums = np.cumsum(angles, axis=1)
    tip = np.column_stack([np.cos(sums) @ [1.0, 0.8, 0.6], np.sin(sums) @ [1.0, 0.8, 0.6],
                           np.zeros(81)])
    motion = sp.reach_path(mechanism, {"tip": tip, "j3": 0.5}, TIMES, start)
    assert np.abs(motion.q - angles).max() < 1e-12
    poses = [pin.SE3(pin.exp3(np.array([0.0, 0.0, x])), p)
             for x, p in zip(sums[:, 2], tip, strict=True)]
    motion = sp.reach_path(mechanism, {"tip": poses}, TIMES, start)
    assert np.abs(motion.q - angles).max() < 1e-12
    out = tip + np.outer(TIMES, [0.0, 0.0, 0.1])
    with pytest.raises(sp.ReachError, match=r"'tip': 3 numbers are wanted.* are 2 freedoms"):
        sp.reach_path(mechanism, {"tip": out}, TIMES, start)
    with pytest.raises(sp.ReachError, match=r"4 numbers are wanted.* are 3 freedoms"):
        sp.reach_path(mechanism, {"tip": tip, "j1": 0.3, "j3": 0.5}, TIMES[:81], start)


# ---------------------------------------------------------------- rates


def test_rates_are_those_of_splines_through_the_targets():
    mechanism, start, home = platform()
    poses, turns = figure(home)
    motion = sp.reach_path(mechanism, {"platform": poses}, TIMES, start)
    found = motion.frame("platform")
    spline = CubicSpline(TIMES, [p.translation for p in poses])
    assert np.abs(found.velocity - spline(TIMES, 1)).max() < 1e-12
    assert np.abs(found.acceleration - spline(TIMES, 2)).max() < 1e-10
    phi = CubicSpline(TIMES, turns)
    for k in (5, 40, 77):
        spin = home.rotation @ pin.exp3(turns[k]) @ pin.Jexp3(turns[k]) @ phi(TIMES[k], 1)
        assert found.angular_velocity[k] == pytest.approx(spin, abs=1e-12)
        there = sp.solve_rates(
            mechanism, motion.state(k),
            {d: motion.coordinate(d).rate[k] for d in mechanism.drivers},
            {d: motion.coordinate(d).acceleration[k] for d in mechanism.drivers})
        assert motion.v[k] == pytest.approx(there.v, abs=1e-11)
        assert motion.a[k] == pytest.approx(there.a, abs=1e-9)


def test_accelerations_are_derivatives_of_velocities():
    mechanism, start, home = platform()
    times = np.linspace(0.0, 2.0, 2001)
    motion = sp.reach_path(mechanism, {"platform": figure(home, times)[0]}, times, start)
    middle = slice(2, -2)
    assert np.abs(np.gradient(motion.v, times, axis=0) - motion.a)[middle].max() < 1e-5
    legs = motion.coordinate("leg_2")
    assert np.abs(np.gradient(legs.value, times) - legs.rate)[middle].max() < 1e-7


def test_without_times_rates_are_those_per_sample():
    mechanism, start, home = platform()
    poses, _ = figure(home)
    timeless = sp.reach_path(mechanism, {"platform": poses}, state=start)
    timed = sp.reach_path(mechanism, {"platform": poses}, np.arange(81.0), start)
    assert timeless.time is None and timeless.per == "sample"
    assert np.array_equal(timeless.v, timed.v)


def test_orientations_go_past_half_a_turn_about_any_axis():
    mechanism = flyer()
    times = np.linspace(0.0, 1.0, 201)
    turns = np.column_stack([1.5 * np.sin(3.0 * times), 5.0 * times, -2.0 * times * times])
    rotations = Rotation.from_rotvec(turns).as_matrix()
    assert np.linalg.norm(turns, axis=1).max() > 1.6 * np.pi
    first = pin.exp3(np.array([0.3, 0.2, 0.1]))
    poses = [pin.SE3(first @ r, np.array([t, t * t, 0.0]))
             for r, t in zip(rotations, times, strict=True)]
    motion = sp.reach_path(mechanism, {"body": poses}, times, hold=None)
    found = motion.frame("body")
    assert np.abs(found.rotation - first @ rotations).max() < 1e-12
    phi = CubicSpline(times, turns)
    spins = np.array([first @ r @ pin.Jexp3(w) @ x for r, w, x in zip(
        rotations, turns, phi(times, 1), strict=True)])
    assert np.abs(found.angular_velocity - spins).max() < 1e-10
    change = np.gradient(spins, times, axis=0)
    assert np.abs(found.angular_acceleration - change)[2:-2].max() < 0.02


def test_a_plane_arm_turns_round_and_round(tmp_path):
    mechanism = arm(tmp_path, (1.0, 0.8, 0.6))
    start = at(mechanism, 0.3, 0.4, 0.5)
    home, times = start.placement("tip"), np.linspace(0.0, 1.0, 101)
    poses = [pin.SE3(pin.exp3(np.array([0.0, 0.0, x])) @ home.rotation,
                     pin.exp3(np.array([0.0, 0.0, x])) @ home.translation)
             for x in 5.0 * np.pi * times]
    motion = sp.reach_path(mechanism, {"tip": poses}, times, start)
    assert np.abs(motion.coordinate("j1").value - 0.3 - 5.0 * np.pi * times).max() < 1e-11
    assert np.ptp(motion.coordinate("j2").value) < 1e-11
    assert np.abs(motion.v[:, 0] - 5.0 * np.pi)[8:-8].max() < 1e-4


def test_a_whole_turn_that_is_not_about_one_axis_is_refused_in_words():
    turns = np.column_stack([0.02 * np.linspace(-1.0, 1.0, 101), np.zeros(101),
                             np.linspace(0.0, 7.0, 101)])
    poses = [pin.SE3(Rotation.from_rotvec([0.0, 0.0, w[2]]).as_matrix()
                     @ pin.exp3(np.array([w[0], 0.0, 0.0])), np.zeros(3)) for w in turns]
    poses[0] = pin.SE3.Identity()
    with pytest.raises(sp.SpatialPinError, match=r"whole turn.*two parts"):
        sp.reach_path(flyer(), {"body": poses}, hold=None)


def test_placements_too_far_apart_are_refused_in_words():
    poses = [pin.SE3.Identity(), pin.SE3(pin.exp3(np.array([0.0, 2.0, 0.0])), np.zeros(3))]
    with pytest.raises(sp.SpatialPinError, match="from sample 0 to 1"):
        sp.reach_path(flyer(), {"body": poses}, hold=None)


# ---------------------------------------------------------------- where they end


@pytest.mark.delicate
def test_a_path_out_of_the_workspace_ends_where_bisection_by_reach_does():
    mechanism = library("delta")
    start = sp.assemble(mechanism)
    home = start.placement("platform").translation
    times, down = np.linspace(0.0, 1.0, 31), np.array([0.02, 0.0, -3.0])
    with pytest.raises(sp.LimitError, match=r"platform cannot go on beyond 0\.2.* s") as caught:
        sp.reach_path(mechanism, {"platform": home + np.outer(times, down)}, times, start)
    limit, motion = caught.value.limit, caught.value.motion
    with pytest.raises(sp.LimitError) as rough:
        few = np.linspace(0.0, 1.0, 5)
        sp.reach_path(mechanism, {"platform": home + np.outer(few, down)}, few, start)
    assert rough.value.limit == pytest.approx(limit, abs=1e-12)
    low, high, state = 0.0, 1.0, start
    for _ in range(28):
        middle = 0.5 * (low + high)
        try:
            state = sp.reach(mechanism, {"platform": home + middle * down}, state, limits=False,
                             starts=0)
            low = middle
        except sp.ReachError:
            high = middle
    assert limit == pytest.approx(low, abs=1e-7)
    assert len(motion) == np.count_nonzero(times < limit)
    assert motion.events[-1].kind == "limit"
    assert motion.events[-1].text.startswith("limit of what the targets can do together")


def test_a_joint_limit_that_is_passed_is_an_event_with_its_time():
    mechanism, start, home = platform()
    times = np.linspace(0.0, 1.0, 51)
    rise = [pin.SE3(home.rotation, home.translation + 0.2 * t * UP) for t in times]
    motion = sp.reach_path(mechanism, {"platform": rise}, times, start)
    event = next(e for e in motion.events if e.kind == "joint limit")
    upper = mechanism.model.upperPositionLimit[mechanism.coordinate("leg_1").q]
    there = pin.SE3(home.rotation, home.translation + 0.2 * event.value * UP)
    state = sp.reach(mechanism, {"platform": there}, start, limits=False)
    assert state.coordinate("leg_1").value == pytest.approx(upper, abs=1e-9)
    assert all("target" not in e.text for e in motion.events)


@pytest.mark.delicate
def test_where_legs_would_not_determine_the_platform_targets_do():
    """A Gough platform turned by a right angle is singular for its legs: forces change sign."""
    mechanism, start, home = platform()
    angles = np.linspace(0.0, 1.7, 61)
    poses = [pin.SE3(home.rotation @ pin.exp3(a * UP), home.translation) for a in angles]
    motion = sp.reach_path(mechanism, {"platform": poses}, angles, start)
    (event,) = (e for e in motion.events if e.kind != "joint limit")
    assert event.kind == "singular" and "drivers alone" in event.text
    assert event.value == pytest.approx(np.pi / 2, abs=1e-12)
    assert event.row == np.searchsorted(angles, np.pi / 2)
    assert np.abs(motion.frame("platform").rotation - [p.rotation for p in poses]).max() < 1e-12
    force = sp.kinetostatics(mechanism, motion).efforts["leg_1"]
    assert angles[np.abs(force).argmax()] == pytest.approx(np.pi / 2, abs=0.03)
    assert force[0] * force[-1] < 0.0


@pytest.mark.delicate
@pytest.mark.parametrize(("samples", "within"), [(2, 1e-6), (5, 1e-11), (42, 1e-11)])
def test_where_drivers_alone_would_not_do_is_where_lines_of_legs_are_dependent(samples, within):
    """A turn about a leaning axis; two samples are joined by a polynomial, not by the turn."""
    mechanism, start, home = platform()
    axis = np.array([0.1, 0.2, 1.0]) / np.linalg.norm([0.1, 0.2, 1.0])

    def lines(angle):
        """Plücker coordinates of the legs."""
        tops = home.rotation @ pin.exp3(angle * axis)
        feet = [start.placement(f"cylinder_{k}").translation for k in range(1, 7)]
        arms = [home.actInv(start.placement(f"platform_{k}").translation) for k in range(1, 7)]
        rows = []
        for foot, arm_ in zip(feet, arms, strict=True):
            top = home.translation + tops @ arm_
            rows.append(np.concatenate([top - foot, np.cross(top, top - foot)]))
        return float(np.linalg.det(rows))

    angles = np.linspace(1.2, 1.7, samples)
    poses = [pin.SE3(home.rotation @ pin.exp3(a * axis), home.translation) for a in angles]
    first = sp.reach(mechanism, {"platform": poses[0]}, start, limits=False)
    motion = sp.reach_path(mechanism, {"platform": poses}, angles, first)
    (event,) = (e for e in motion.events if e.kind == "singular")
    assert event.value == pytest.approx(brentq(lines, 1.2, 1.7, xtol=1e-14), abs=within)


def test_motions_that_drivers_determine_have_no_such_events():
    """Of equations that are all independent, and of plane loops with many to spare."""
    mechanism = library("delta")
    start = sp.assemble(mechanism)
    up = start.placement("platform").translation + np.outer(np.linspace(0, 0.3, 9), UP)
    assert not sp.reach_path(mechanism, {"platform": up}, None, start).events
    mechanism = library("excavator")
    start = sp.assemble(mechanism)
    down = start.placement("teeth").translation - np.outer(np.linspace(0, 0.8, 9), UP)
    motion = sp.reach_path(mechanism, {"teeth": down, "bucket": 2.1}, None, start)
    assert not motion.events and len(motion) == 9


def test_first_targets_out_of_reach_are_reported_as_reach_tells_them():
    mechanism, start, home = platform()
    poses = [pin.SE3(home.rotation, home.translation + (2.0 + t) * UP) for t in (0.0, 0.1)]
    with pytest.raises(sp.ReachError, match="platform"):
        sp.reach_path(mechanism, {"platform": poses}, state=start)


# ---------------------------------------------------------------- what is left free


def test_what_targets_leave_free_moves_least_from_sample_to_sample(tmp_path):
    mechanism = arm(tmp_path)
    start = at(mechanism, 0.3, 0.4, 0.5)
    tip = start.placement("tip").translation + np.column_stack(
        [-0.2 * TIMES, 0.1 * np.sin(TIMES), 0.0 * TIMES])
    motion = sp.reach_path(mechanism, {"tip": tip}, TIMES, start)
    assert np.abs(motion.frame("tip").position - tip).max() < 1e-12
    second = sp.reach(mechanism, {"tip": tip[1]}, start)
    assert np.abs(motion.q[1] - second.q).max() < 1e-12
    out = tip + np.outer(TIMES, [3.0, 0.0, 0.0])
    with pytest.raises(sp.ReachError, match=r"sample \d+: .*'tip'") as caught:
        sp.reach_path(mechanism, {"tip": out}, TIMES, start)
    assert 0 < len(caught.value.motion) < 81


def test_a_target_that_cannot_move_leaves_all_to_the_drivers():
    mechanism = library("hooke_joint")
    start = sp.assemble(mechanism)
    fork = np.tile(start.placement("output_fork").translation, (5, 1))
    motion = sp.reach_path(mechanism, {"output_fork": fork}, state=start)
    assert np.abs(motion.q - start.q).max() < 1e-12


def test_a_single_sample_is_what_reach_finds():
    mechanism, start, home = platform()
    there = figure(home)[0][9]
    motion = sp.reach_path(mechanism, {"platform": there}, [3.0], start)
    state = sp.reach(mechanism, {"platform": there}, start)
    assert np.abs(motion.q[0] - state.q).max() < 1e-12
    assert not motion.v.any() and motion.time[0] == 3.0


def test_few_samples_and_targets_that_stand():
    mechanism, start, home = platform()
    there = figure(home)[0][9]
    two = sp.reach_path(mechanism, {"platform": [home, there]}, [0.0, 2.0], start)
    found = two.frame("platform")  # on a straight line, at a constant speed
    assert np.abs(found.velocity - 0.5 * (there.translation - home.translation)).max() < 1e-13
    assert np.abs(found.acceleration).max() < 1e-12
    still = sp.reach_path(mechanism, {"platform": home}, TIMES, start)
    assert len(still) == 81 and not still.v.any()
    three = sp.reach_path(mechanism, {"platform": home.translation[None] + np.outer(
        [0.0, 0.01, 0.02], UP), "hook_1.first": start.coordinate("hook_1.first").value},
        state=start)
    assert np.ptp(three.coordinate("hook_1.first").value) < 1e-12
    assert three.frame("platform").position[:, 2] == pytest.approx(
        home.translation[2] + np.array([0.0, 0.01, 0.02]), abs=1e-13)


# ---------------------------------------------------------------- what it is good for


def test_efforts_along_it_are_those_of_each_state():
    mechanism, start, home = platform()
    motion = sp.reach_path(mechanism, {"platform": figure(home)[0]}, TIMES, start)
    efforts = sp.kinetostatics(mechanism, motion).efforts
    alone = sp.inverse_dynamics(mechanism, motion.state(40))
    for name in mechanism.drivers:
        assert efforts[name][40] == pytest.approx(alone.efforts[name], rel=1e-9)


def test_an_answer_does_not_depend_on_earlier_calls():
    mechanism, start, home = platform()
    poses, _ = figure(home)
    one = sp.reach_path(mechanism, {"platform": poses}, TIMES, start)
    sp.reach_path(mechanism, {"platform": poses[::-1]}, TIMES)
    two = sp.reach_path(mechanism, {"platform": poses}, TIMES, start)
    assert np.array_equal(one.q, two.q) and np.array_equal(one.a, two.a)


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(("targets", "times", "error", "words"), [
    ({}, None, ValueError, "targets is empty"),
    ({"nobody": np.zeros((2, 3))}, None, sp.UnknownNameError, "nobody"),
    ({"nobody": [0.0, 1.0]}, None, sp.UnknownNameError, "nobody"),
    ({"platform": np.zeros((2, 4))}, None, TypeError, "no table"),
    ({"platform": "there"}, None, TypeError, "no table"),
    ({"platform": None}, None, TypeError, "no table"),
    ({"platform": {"x": 1.0}}, None, TypeError, "no table"),
    ({"platform": [0.1, 0.2]}, None, TypeError, "no table"),
    ({"platform": sp.targets.position([0.0, 0.0, 1.0])}, None, TypeError, "no table"),
    ({"platform": np.full((2, 3), np.nan)}, None, ValueError, "platform"),
    ({"platform": np.zeros((2, 3)), "leg_1": np.zeros(3)}, None, ValueError, "differ in length"),
    ({"platform": np.zeros((0, 3))}, None, ValueError, "no sample"),
    ({"platform": np.zeros((2, 3))}, [1.0, 1.0], ValueError, "must rise"),
    ({"platform": np.zeros((2, 3))}, [1.0], ValueError, "times"),
    ([1.0, 2.0], None, TypeError, "targets"),
])
def test_bad_tables_are_refused_in_words(targets, times, error, words):
    with pytest.raises(error, match=words):
        sp.reach_path(library("stewart"), targets, times)


@pytest.mark.parametrize(("table", "error", "words"), [
    ([], ValueError, "has no sample"),
    ([pin.SE3(2.0 * np.eye(3), np.zeros(3))], ValueError, "no rotation matrix"),
    ([pin.SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3))], ValueError, "no rotation matrix"),
    ([pin.SE3.Identity(), [0.0, 0.0, 1.0]], TypeError, "is no table"),
    ([sp.targets.position([0.0, 0.0, 1.0])], TypeError, "is no table"),
])
def test_lists_of_something_else_are_refused_in_words(table, error, words):
    with pytest.raises(error, match=words):
        sp.reach_path(library("stewart"), {"platform": table})


def test_one_point_stands_still():
    mechanism = library("delta")
    start = sp.assemble(mechanism)
    point = start.placement("platform").translation
    motion = sp.reach_path(mechanism, {"platform": point}, TIMES, start)
    assert len(motion) == len(TIMES)
    assert np.abs(motion.frame("platform").position - point).max() < 1e-12


def test_more_targets_than_freedoms_are_refused_before_work_begins():
    mechanism = library("delta")
    home = sp.assemble(mechanism).placement("platform")
    poses, _ = figure(home)
    with pytest.raises(sp.ReachError, match=r"6 numbers are wanted .* there are 3"):
        sp.reach_path(mechanism, {"platform": poses}, TIMES)


def test_what_is_held_is_no_target():
    mechanism, start, _ = platform()
    with pytest.raises(ValueError, match="is held"):
        sp.reach_path(mechanism, {"leg_1": [0.4, 0.5]}, state=start, hold=["leg_1"])


# ---------------------------------------------------------------- command line


def write(path, head, columns):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=head, comments="",
               fmt="%.17g")
    return str(path)


def test_the_command_line_goes_along_a_table_of_points(tmp_path, run):
    mechanism = library("delta")
    start = sp.assemble(mechanism)
    points = start.placement("platform").translation + np.column_stack(
        [0.1 * np.sin(2.0 * TIMES), 0.05 * TIMES, 0.02 * TIMES])
    table = write(tmp_path / "points.csv",
                  "time [ms],platform.x [mm],platform.y,platform.z [cm]",
                  [1e3 * TIMES, 1e3 * points[:, 0], points[:, 1], 1e2 * points[:, 2]])
    out = tmp_path / "out.csv"
    code, said, _ = run("reach", "delta", "--path", table, "--csv", out,
                        "--html", tmp_path / "page.html", "--trace", "platform")
    assert code == 0
    assert "time 0 to" in said and (tmp_path / "page.html").exists()
    expected = sp.reach_path(mechanism, {"platform": points}, TIMES, start)
    found = columns(out)
    assert found["time [s]"] == pytest.approx(TIMES, abs=1e-15)
    arm = mechanism.coordinate("arm_2").name
    assert found[f"{arm} [rad]"] == pytest.approx(expected.coordinate(arm).value, abs=1e-12)


def test_the_command_line_goes_along_a_table_of_placements(tmp_path, run):
    mechanism, start, home = platform()
    poses, _ = figure(home)
    vectors = np.array([pin.log3(pose.rotation) for pose in poses])
    points = np.array([pose.translation for pose in poses])
    table = write(tmp_path / "poses.csv", "time," + ",".join(
        f"platform.{part}" for part in ("x", "y", "z", "rx", "ry", "rz")),
        [TIMES, points, vectors])
    out = tmp_path / "out.json"
    assert run("reach", "stewart", "--path", table, "--json", out)[0] == 0
    found = json.loads(out.read_text())["columns"]
    expected = sp.reach_path(mechanism, {"platform": poses}, TIMES, start)
    for name in ("slide_1", "slide_4"):
        head = next(head for head in found if head.startswith(f"{name} [") or head == name)
        assert found[head] == pytest.approx(expected.coordinate(name).value, abs=1e-12)


def test_coordinates_beside_a_table_stand_still(tmp_path, run):
    table = write(tmp_path / "arms.csv", "arm_1 [deg],arm_2", [np.linspace(0.0, 20.0, 9),
                                                             np.linspace(0.0, 0.1, 9)])
    out = tmp_path / "out.csv"
    assert run("reach", "delta", "arm_3=5deg", "--path", table, "--csv", out)[0] == 0
    found = columns(out)
    assert not any(head.startswith("time") for head in found)
    assert found["shoulder_3 [rad]"] == pytest.approx(np.full(9, np.deg2rad(5.0)), abs=1e-14)
    assert found["shoulder_1 [rad]"][-1] == pytest.approx(np.deg2rad(20.0), abs=1e-14)


@pytest.mark.parametrize(("head", "numbers", "words"), [
    ("platform.x,platform.y", [0, 0], "no column platform.z"),
    ("platform.x,platform.y,platform.z,platform.rx", [0, 0, -1, 0], "no column platform.ry"),
    ("platform.x [deg],platform.y,platform.z", [0, 0, -1], "column 'platform.x' is in m"),
    ("arm_1 [mm]", [0], "column 'arm_1' is in rad"),
    ("time [m],arm_1", [0, 0], "column 'time' is in s"),
    ("nobody.x,nobody.y,nobody.z", [0, 0, 0], "nobody"),
    ("arm_7", [0], "arm_7"),
    ("platform.x,platform.y,platform.z", [0, 0, 9], "cannot be reached"),
])
def test_bad_files_are_refused_in_words(tmp_path, run, head, numbers, words):
    table = write(tmp_path / "bad.csv", head, [np.array([numbers, numbers], dtype=float)])
    code, _, told = run("reach", "delta", "--path", table)
    assert code == 1 and words in told and "Traceback" not in told


@pytest.mark.parametrize(("arguments", "words"), [
    (["reach", "delta"], "there is no target"),
    (["reach", "delta", "arm_1=1", "--csv", "x.csv"], "need --path"),
    (["reach", "delta", "platform.position=0,0,1", "--path", "x.csv"], "columns of the table"),
    (["reach", "delta", "--no-limits", "--path", "x.csv"], "for single targets"),
])
def test_what_does_not_go_together_is_refused(run, arguments, words):
    code, _, told = run(*arguments)
    assert code == 2 and words in told


def test_units_of_a_table_of_drivers_are_theirs(tmp_path, run):
    table = write(tmp_path / "legs.csv", "leg_1 [deg]", [np.array([0.39, 0.4])])
    code, _, told = run("follow", "stewart", table)
    assert code == 1 and "column 'leg_1' is in m, not in deg" in told
