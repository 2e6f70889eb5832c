"""Several drivers go along tables of values on one branch, with the guarantees of a sweep."""

from __future__ import annotations

import json

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from machines import delta
from scipy.interpolate import CubicSpline
from tables import columns
from variety import paired

import spatial_pin as sp

TIMES = np.linspace(0.0, 2.0, 41)


def legs(mechanism, state, times=TIMES, size=0.02):
    """Return lengths of all legs over time, those of the state first."""
    phases = np.linspace(0.0, 5.0, len(mechanism.drivers))
    return {name: state.coordinate(name).value + size * (np.sin(2.0 * times + x) - np.sin(x))
            for name, x in zip(mechanism.drivers, phases, strict=True)}


@pytest.mark.parametrize("name", ["stewart", "delta"])
def test_every_sample_is_what_its_drivers_assemble_to(name):
    mechanism = library(name)
    state = sp.assemble(mechanism)
    values = legs(mechanism, state)
    motion = sp.follow(mechanism, values, TIMES)
    assert motion.closure_error.max() < 1e-13
    assert np.array_equal(motion.time, TIMES) and motion.driver is None
    for k in (0, 13, 40):
        alone = sp.assemble(mechanism, {d: v[k] for d, v in values.items()}, motion.state(k))
        turned = np.minimum(np.abs(alone.q - motion.q[k]), np.abs(alone.q + motion.q[k]))
        assert turned.max() < 1e-12


def test_what_is_held_by_name_stands_where_it_stood():
    mechanism = library("stewart")
    state = sp.assemble(mechanism)
    values = dict(list(legs(mechanism, state).items())[:2])
    free = sp.follow(mechanism, values, TIMES, guess=state)
    held = sp.follow(mechanism, values, TIMES, guess=state, hold=["base", "slide_4", "leg_5"])
    np.testing.assert_allclose(held.q, free.q, atol=1e-13)


def test_rates_are_those_of_the_spline_through_the_values():
    mechanism = library("stewart")
    state = sp.assemble(mechanism)
    values = legs(mechanism, state)
    motion = sp.follow(mechanism, values, TIMES)
    splines = {name: CubicSpline(TIMES, v) for name, v in values.items()}
    for k in (3, 17, 30):
        there = sp.solve_rates(mechanism, motion.state(k),
                               {d: float(s(TIMES[k], 1)) for d, s in splines.items()},
                               {d: float(s(TIMES[k], 2)) for d, s in splines.items()})
        assert motion.v[k] == pytest.approx(there.v, abs=1e-11)
        assert motion.a[k] == pytest.approx(there.a, abs=1e-9)


def test_given_rates_are_kept_at_the_samples():
    mechanism = library("stewart")
    state = sp.assemble(mechanism)
    values = legs(mechanism, state)
    phases = np.linspace(0.0, 5.0, 6)
    rates = {name: 0.04 * np.cos(2.0 * TIMES + x)
             for name, x in zip(mechanism.drivers, phases, strict=True)}
    motion = sp.follow(mechanism, values, TIMES, rates=rates)
    for name, wanted in rates.items():
        assert motion.coordinate(name).rate == pytest.approx(wanted, abs=1e-12)
        bends = CubicSpline(TIMES, wanted)(TIMES, 1)
        assert motion.coordinate(name).acceleration == pytest.approx(bends, abs=1e-10)


def test_one_driver_is_a_sweep():
    mechanism = library("four_bar")
    values = np.linspace(0.0, 3.0, 25)
    one = sp.follow(mechanism, {"crank": values})
    sweep = sp.sweep(mechanism, "crank", values)
    assert np.array_equal(one.q, sweep.q) and np.array_equal(one.v, sweep.v)
    timed = sp.follow(mechanism, {"crank": values}, values / 2.0)  # at a constant speed
    fast = sp.sweep(mechanism, "crank", values, speed=2.0)
    assert timed.q == pytest.approx(fast.q, abs=1e-13)
    assert timed.v == pytest.approx(fast.v, abs=1e-11)
    assert timed.a == pytest.approx(fast.a, abs=1e-9)


def test_without_times_rates_are_those_per_sample():
    mechanism = library("stewart")
    values = legs(mechanism, sp.assemble(mechanism))
    timeless = sp.follow(mechanism, values)
    timed = sp.follow(mechanism, values, np.arange(len(TIMES)))
    assert timeless.time is None and timeless.per == "sample"
    assert timeless.v == pytest.approx(timed.v, abs=1e-13)
    assert "rad/sample" in " ".join(timeless.columns())


def test_drivers_that_are_not_named_stand_where_they_are():
    mechanism = library("stewart")
    state = sp.assemble(mechanism)
    values = legs(mechanism, state)
    some = {name: values[name] for name in list(values)[:2]}
    motion = sp.follow(mechanism, some, TIMES)
    for name in list(values)[2:]:
        assert np.ptp(motion.coordinate(name).value) == 0.0
    single = sp.follow(mechanism, {**some, "leg_3": values["leg_3"][0]}, TIMES)
    assert np.abs(single.q - motion.q).max() < 1e-13


def test_the_limit_of_several_drivers_is_that_of_a_sweep():
    """One leg grows by a table with times, five stand: the sweep of that leg has the same end."""
    mechanism = library("stewart")
    state = sp.assemble(mechanism)
    home = {name: state.coordinate(name).value for name in mechanism.drivers}
    values = {**home, "leg_1": home["leg_1"] + np.linspace(0.0, 0.3, 100)}
    with pytest.raises(sp.LimitError, match=r"leg_1.*cannot go on beyond 0\.44") as caught:
        sp.follow(mechanism, values, np.linspace(0.0, 1.0, 100))
    sweep = sp.sweep(mechanism, "leg_1", values["leg_1"], on_limit="stop")
    limit = next(e.value for e in sweep.events if e.kind == "limit")
    assert home["leg_1"] + 0.3 * caught.value.limit == pytest.approx(limit, abs=1e-9)
    assert len(caught.value.motion) == len(sweep)
    stopped = sp.follow(mechanism, values, np.linspace(0.0, 1.0, 100), on_limit="stop")
    assert stopped.events[-1].kind == "limit"
    assert stopped.events[-1].value == caught.value.limit
    assert stopped.events[-1].row == len(stopped)


def test_a_joint_limit_that_is_passed_is_an_event_with_its_time():
    mechanism = library("stewart")
    state = sp.assemble(mechanism)
    home = {name: state.coordinate(name).value for name in mechanism.drivers}
    rise = {name: value + np.linspace(0.0, 0.1, 51) for name, value in home.items()}
    motion = sp.follow(mechanism, rise, np.linspace(0.0, 1.0, 51))
    events = [e for e in motion.events if e.kind == "joint limit"]
    upper = mechanism.model.upperPositionLimit[mechanism.coordinate("leg_1").q]
    assert len(events) == 6
    for event in events:
        assert event.value == pytest.approx((upper - home["leg_1"]) / 0.1, abs=1e-9)


def test_a_velocity_limit_that_is_passed_is_an_event_with_its_time():
    mechanism = library("excavator")
    limit = mechanism.model.upperVelocityLimit[mechanism.coordinate("boom").v]
    times = np.linspace(0.0, 2.0, 201)
    motion = sp.follow(mechanism, {"boom": 2.7 + 0.3 * np.sin(2.0 * times), "arm": 2.9}, times)
    event = next(e for e in motion.events if e.kind == "velocity limit")
    rate = np.abs(motion.coordinate("boom").rate)
    first = int(np.flatnonzero(rate > limit)[0])
    assert (event.value, event.row) == (times[first], first) and "boom_slide" in event.text


def test_a_branch_point_ends_the_motion_with_what_it_is():
    mechanism = library("sarrus")
    arm = np.linspace(1.0, 2.0, 21)
    with pytest.raises(sp.SingularError, match="on_crossing='straight'") as caught:
        sp.follow(mechanism, {"arm": arm}, arm, on_crossing="raise")
    assert caught.value.motion.time[-1] < np.pi / 2
    stopped = sp.follow(mechanism, {"arm": arm}, arm, on_crossing="stop")
    assert stopped.events[-1].value == pytest.approx(np.pi / 2, abs=1e-9)


@pytest.mark.delicate
@pytest.mark.parametrize("samples", [5, 20, 200])
def test_a_branch_point_is_where_a_sweep_passes_it(samples):
    """Where both branches bend sharply the curve is not followed to it; what it is is told."""
    mechanism = library("delta")
    shoulder = sp.assemble(mechanism).coordinate("shoulder_1").value + np.linspace(0, 4, samples)
    swept = sp.sweep(mechanism, "shoulder_1", shoulder, on_limit="stop")
    crossing = next(e.value for e in swept.events if e.kind == "branch point")
    stopped = sp.follow(mechanism, {"shoulder_1": shoulder}, shoulder, on_crossing="stop")
    assert stopped.events[-1].kind == "branch point"
    assert stopped.events[-1].value == pytest.approx(crossing, abs=1e-9)


@pytest.mark.delicate
@pytest.mark.parametrize("samples", [13, 35, 100, 400, 1000])
def test_splines_bend_between_their_samples_at_a_branch_point_too(samples):
    """However many pieces of the spline lie about it, a parallelogram's rocker is its crank."""
    mechanism = library("four_bar", r1=0.3, r2=0.1, r3=0.3, r4=0.1)
    times = np.linspace(0.0, 2.0, samples)
    values = 1.0 + 1.2 * times + 0.3 * np.sin(5.0 * times)
    motion = sp.follow(mechanism, {"crank": values}, times)
    crank, rocker = (motion.coordinate(name) for name in ("crank", "rocker_pin"))
    assert np.abs(rocker.value - crank.value - rocker.value[0] + crank.value[0]).max() < 1e-11
    assert np.abs(rocker.rate - crank.rate).max() < 1e-10
    assert np.abs(rocker.acceleration - crank.acceleration).max() < 1e-8
    (met,) = motion.events
    assert met.kind == "branch point"
    assert CubicSpline(times, values)(met.value) == pytest.approx(np.pi, abs=1e-9)


@pytest.mark.delicate
@pytest.mark.parametrize("samples", [9, 40, 300])
def test_a_delta_robot_stays_level_where_three_arms_lead_it_across_branch_points(samples):
    times = np.linspace(0.0, 1.0, samples)
    arms = {"arm_1": 1.4 + 1.3 * times + 0.05 * np.sin(7.0 * times),
            "arm_2": -0.1 * times**2 + 0.03 * np.sin(5.0 * times), "arm_3": 0.2 * np.sin(times)}
    motion = sp.follow(library("delta"), arms, times)
    assert [event.kind for event in motion.events] == ["branch point"] * 2
    platform = motion.frame("platform")
    assert np.abs(platform.rotation - np.eye(3)).max() < 1e-11
    assert np.abs(platform.angular_velocity).max() < 1e-7
    last = delta(arms["arm_1"][-1], others=(arms["arm_2"][-1], arms["arm_3"][-1]))
    exact = last.links["platform"][:3, 3].astype(float)
    np.testing.assert_allclose(platform.position[-1], exact, rtol=0, atol=1e-12)


def test_components_of_a_floating_joint_end_where_a_sweep_of_one_ends():
    mechanism = library("delta")
    state = sp.assemble(mechanism)
    home = {name: state.coordinate(name).value for name in ("pose.x", "pose.y", "pose.z")}
    out = home["pose.x"] + 3.0 * TIMES / TIMES[-1]
    with pytest.raises(sp.LimitError) as caught:
        sp.follow(mechanism, {**home, "pose.x": out}, out)
    with pytest.raises(sp.LimitError) as swept:
        sp.sweep(mechanism, "pose.x", out, hold={k: home[k] for k in ("pose.y", "pose.z")})
    assert caught.value.limit == pytest.approx(swept.value.limit, abs=1e-9)


# ---------------------------------------------------------------- as a sweep


@pytest.mark.delicate
@pytest.mark.parametrize(("driven", "samples"), paired([
    ("parallelogram", "crank", 7.0), ("sarrus", "arm", 1.2), ("delta", "shoulder_1", 4.0),
    ("stewart", "leg_1", 0.3), ("four_bar", "crank", 7.0), ("bennett", "crank", 7.0)], [7, 60]))
def test_one_driver_with_times_is_a_sweep_across_branch_points_and_to_limits(driven, samples):
    name, driver, way = driven
    mechanism = (library("four_bar", r1=0.3, r2=0.1, r3=0.3, r4=0.1) if name == "parallelogram"
                 else library(name))
    home = 1.0 if name == "parallelogram" else sp.assemble(mechanism).coordinate(driver).value
    values = home + np.linspace(0.0, way, samples)
    swept = sp.sweep(mechanism, driver, values, on_limit="stop")
    motion = sp.follow(mechanism, {driver: values}, values - home, on_limit="stop")
    assert len(motion) == len(swept)
    kinds = "branch point", "limit"
    expected, found = ([e for e in m.events if e.kind in kinds] for m in (swept, motion))
    assert [(e.kind, e.row) for e in found] == [(e.kind, e.row) for e in expected]
    for one, other in zip(found, expected, strict=True):
        assert one.value + home == pytest.approx(other.value, abs=1e-9)
    pace = np.maximum(np.abs(swept.v).max(axis=1, keepdims=True), 1.0)
    assert np.abs(motion.q - swept.q).max() < 1e-9
    assert (np.abs(motion.v - swept.v) / pace).max() < 1e-8
    assert (np.abs(motion.a - swept.a) / pace**3).max() < 1e-7


def ball():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    return sp.Mechanism.from_model(model)


def test_a_component_of_a_ball_turns_on_about_its_axis_as_in_a_sweep():
    turn = np.linspace(0.0, 7.0, 15)
    motion = sp.follow(ball(), {"ball.x": turn}, turn)
    assert motion.coordinate("ball.x").value == pytest.approx(turn, abs=1e-14)
    assert motion.v == pytest.approx(np.tile([1.0, 0.0, 0.0], (15, 1)), abs=1e-14)
    assert motion.q == pytest.approx(sp.sweep(ball(), "ball.x", turn).q, abs=1e-14)


def test_a_rotation_vector_about_another_axis_ends_at_half_a_turn_and_that_is_stated():
    turn, other = np.linspace(0.0, 7.0, 15), {"ball.y": 0.3, "ball.z": 0.1}
    half = np.sqrt(np.pi**2 - 0.3**2 - 0.1**2)
    for ask in (lambda **how: sp.follow(ball(), {"ball.x": turn, **other}, turn, **how),
                lambda **how: sp.sweep(ball(), "ball.x", turn, hold=other, **how)):
        with pytest.raises(sp.LimitError, match="no longer than half a turn") as caught:
            ask()
        assert caught.value.limit == pytest.approx(half, abs=1e-9)
        stopped = ask(on_limit="stop")
        assert (len(stopped), stopped.events[-1].kind) == (7, "limit")
        assert stopped.events[-1].value == caught.value.limit


@pytest.mark.delicate
@pytest.mark.parametrize("samples", [30, 300])
def test_a_freedom_that_nothing_determines_moves_least_however_many_samples(samples):
    """By symmetry ball.z stays zero as x turns and y is held; no predictor may feed on itself."""
    turn = np.linspace(0.0, 3.0, samples)
    motion = sp.sweep(ball(), "ball.x", turn, hold={"ball.y": 0.3})
    assert np.abs(motion.coordinate("ball.z").value).max() < 1e-12


def test_a_single_sample_is_the_assembled_state():
    mechanism = library("stewart")
    state = sp.assemble(mechanism)
    home = {name: [state.coordinate(name).value] for name in mechanism.drivers}
    motion = sp.follow(mechanism, home, [3.0])
    assert motion.q == pytest.approx(state.q[None], abs=1e-13)
    assert not motion.v.any() and motion.time[0] == 3.0


def test_drivers_may_stand_for_a_while():
    mechanism = library("delta")
    state = sp.assemble(mechanism)
    moves = np.concatenate([np.linspace(0.0, 0.2, 10), np.full(10, 0.2), np.linspace(0.2, 0, 10)])
    values = {d: state.coordinate(d).value + moves for d in mechanism.drivers}
    motion = sp.follow(mechanism, values, np.linspace(0.0, 3.0, 30))
    assert np.abs(motion.q[-1] - motion.q[0]).max() < 1e-12
    assert np.abs(motion.q[10:20] - motion.q[10]).max() < 1e-12


@pytest.mark.parametrize(("values", "times", "more", "error", "words"), [
    ({}, None, {}, ValueError, "values is empty"),
    ({"leg_1": []}, None, {}, ValueError, "has no sample"),
    ({"nobody": [0.0, 1.0]}, None, {}, sp.UnknownNameError, "nobody"),
    ({"leg_1": [0.0, 1.0], "leg_2": [0.0]}, None, {}, ValueError, "differ in length"),
    ({"leg_1": [0.4, 0.4], "slide_1": [0.4, 0.4]}, None, {}, ValueError, "two tables"),
    ({"leg_1": [0.4, np.nan], "leg_2": 0.4}, None, {}, ValueError, "leg_1"),
    ({"leg_1": [0.4, 0.4]}, [1.0, 1.0], {}, ValueError, "must rise"),
    ({"leg_1": [0.4, 0.4]}, [1.0], {}, ValueError, "times"),
    ({"leg_1": [0.4, 0.4]}, None, {"rates": {"leg_1": 0.0}}, ValueError, "no times"),
    ({"leg_1": [0.4, 0.4]}, [0.0, 1.0], {"rates": {"leg_2": 0.0}}, ValueError, "wanted of"),
    ({"leg_1": [0.4, 0.4]}, [0.0, 1.0], {"on_limit": "go"}, ValueError, "on_limit"),
])
def test_bad_tables_are_refused_in_words(values, times, more, error, words):
    with pytest.raises(error, match=words):
        sp.follow(library("stewart"), values, times, **more)


def test_a_motion_of_several_drivers_can_be_written_shown_and_loaded(tmp_path):
    mechanism = library("delta")
    values = legs(mechanism, sp.assemble(mechanism))
    for times in (TIMES, None):
        motion = sp.follow(mechanism, values, times)
        motion.to_csv(tmp_path / "m.csv")
        again = sp.Motion.load(motion.save(tmp_path / "m.npz"), mechanism)
        assert np.array_equal(again.q, motion.q) and again.per == motion.per
        assert str(motion)
        sp.plot(motion, ["platform.position"], tmp_path / "m.png")
        sp.export_html(motion, tmp_path / "m.html")
        assert sp.kinetostatics(mechanism, motion).efforts
        assert len(sp.clearance(motion, [("arm_1", "arm_2")]).least.distances) == len(TIMES)


# ---------------------------------------------------------------- command line


def test_the_command_line_follows_a_table_and_writes_one(tmp_path, run):
    mechanism = library("delta")
    values = legs(mechanism, sp.assemble(mechanism))
    table = tmp_path / "arms.csv"
    head = "time [ms]," + ",".join(f"{name} [deg]" for name in values)
    rows = np.column_stack([1e3 * TIMES, *np.rad2deg(list(values.values()))])
    np.savetxt(table, rows, delimiter=",", header=head, comments="", fmt="%.17g")
    out = tmp_path / "out.csv"
    code, said, _ = run("follow", "delta", table, "--csv", out)
    assert code == 0 and "delta: 41 samples, time 0 to 2 s" in said
    expected = sp.follow(mechanism, values, TIMES)
    found = columns(out)
    assert found["time [s]"] == pytest.approx(expected.time, abs=1e-15)
    arm = mechanism.coordinate("arm_2").name
    assert found[f"{arm} [rad]"] == pytest.approx(values["arm_2"], abs=1e-14)


@pytest.mark.parametrize(("text", "words"), [
    ("boom\n1,2\n", "line 2 has more numbers than there are names"),
    ("arm_1\n1mm\n", "column 'arm_1' is in rad, not in mm"), ("\xff\n1\n", "no table in UTF-8"),
    ("boom\n", "no table"), ("boom [ft]\n1\n", "has the unit 'ft'"), ("boom\nx\n", "'x' is no"),
    ("boom,arm\n1\n", "line 2, column 2: nothing is no number"), ("a,a\n1,2\n", "two columns"),
    ("[rad]\n1\n", "is no name of a column"),
])
def test_a_bad_table_is_refused_with_its_place(tmp_path, run, text, words):
    table = tmp_path / "bad.csv"
    table.write_text(text, encoding="latin-1")
    code, _, told = run("follow", "delta", table)
    assert code == 1 and words in told and "bad.csv" in told and "Traceback" not in told


@pytest.mark.parametrize("text", [
    "time [ms],arm_1 [deg],\r\n0,0,\r\n500,22.5,\r\n", "\ufefftime;arm_1 [deg]\n0;0\n0,5;22,5\n",
    "time [s]\tarm_1\r0\t0deg\r500ms\t 22.5 ° \r", 'time,arm_1,arm_1 rate [rad/s],tip jerk x\n'
    '0,"0",9,9\n.5,22.5deg,9,9\n\n',
], ids=["commas at line ends", "semicolons", "tabs", "units"])
def test_tables_as_other_programs_write_them(tmp_path, run, text):
    table, out = tmp_path / "table.csv", tmp_path / "out.csv"
    table.write_bytes(text.encode())
    code, _, told = run("follow", "delta", table, "--csv", out)
    assert code == 0, told  # names of other columns would be refused
    found = columns(out)
    assert found["time [s]"].tolist() == [0.0, 0.5]
    assert found["shoulder_1 [rad]"] == pytest.approx([0.0, np.pi / 8], abs=1e-16)
    for k in (2, 3):
        assert np.ptp(found[f"shoulder_{k} [rad]"]) == 0.0


def test_points_are_read_as_a_motion_writes_them(tmp_path, run):
    """Rates beside them are not asked for."""
    motion = sp.sweep(library("delta"), "arm_1", [0.0, 0.1, 0.2])
    table, out = tmp_path / "p.csv", tmp_path / "out.json"
    motion.to_csv(table, ["platform.position", "arm_1.rate"])
    text = table.read_text(encoding="utf-8")
    assert text.startswith("arm_1 [rad],platform position x [m],") and "arm_1 rate" in text
    table.write_text("".join(line.split(",", 1)[1] for line in text.splitlines(keepends=True)),
                     encoding="utf-8")  # the points alone
    code, _, told = run("reach", "delta", "--path", table, "--json", out)
    assert code == 0, told
    found = json.loads(out.read_text(encoding="utf-8"))["columns"]
    assert found["shoulder_1 [rad]"] == pytest.approx([0.0, 0.1, 0.2], abs=1e-14)
    for k in (2, 3):
        assert np.ptp(found[f"shoulder_{k} [rad]"]) < 1e-14


def test_a_table_that_is_not_there_is_reported(run):
    code, _, told = run("follow", "delta", "nowhere.csv")
    assert code == 1 and "nowhere.csv" in told


def test_held_joints_stand_where_the_state_has_them_or_it_is_reported(tmp_path):
    mechanism = known.five_bar(tmp_path)
    state = sp.assemble(mechanism, {"left": 2.0, "right": 1.0})
    elbow, times = state.coordinate("elbow1").value, [3.0, 4.0]
    held = sp.sweep(mechanism, "left", [2.3, 2.31], guess=state, hold=["elbow1"])
    assert np.abs(held.coordinate("elbow1")[0] - elbow).max() < 1e-12
    driver = sp.sweep(mechanism, "elbow1", [elbow + 0.3, elbow + 0.31], guess=state, hold=["left"])
    assert np.abs(driver.coordinate("left")[0] - 2.0).max() < 1e-12  # right is released instead
    tables = {"left": np.array([3.0, 3.01])}  # where no length of the rods reaches so far
    for motion in (sp.sweep(mechanism, "left", tables["left"], guess=state, hold=["elbow1"]),
                   sp.follow(mechanism, tables, times, guess=state, hold=["elbow1"])):
        angle = motion.coordinate("elbow1")[0]
        assert abs(np.ptp(angle)) < 1e-12 < abs(angle[0] - elbow)
        event = next(e for e in motion.events if e.text.startswith("elbow1"))
        assert (event.kind, event.row) == ("released", 0)
        assert event.value == (times[0] if motion.time is not None else 3.0)
        assert f"held {angle[0] - elbow:+.9g} rad from where the guess has it" in event.text
