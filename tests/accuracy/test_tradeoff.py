"""What settings cost and lose: the reference and the errors told, against known truths."""

import json

import closed_forms
import mechanisms as known
import numpy as np
import pytest
from masses import simple_pendulum

import spatial_pin as sp

TURN = np.linspace(0.0, 2 * np.pi, 37)
FEW = [sp.Accuracy(), sp.Accuracy(tolerance=1e-8), sp.Accuracy(order=2, tolerance=1e-4),
       sp.Accuracy(order=1, corrections=1), sp.Accuracy(order=0, corrections=1)]


# ---------------------------------------------------------------- extended precision


# ---------------------------------------------------------------- sweeps


def rocker_errors(mech, accuracy, values):
    """True errors of the rocker: position, velocity and acceleration."""
    motion = sp.sweep(mech, "crank", values, accuracy=accuracy)
    found = np.array(motion.coordinate("rocker_pin"))
    poses = [closed_forms.rates(closed_forms.rssr, x, 1.0, 0.0) for x in values]
    want = np.array([closed_forms.long(p.coordinates["rocker_pin"] for p in level)
                     for level in zip(*poses, strict=True)])
    return np.abs(found - want).max(axis=1).astype(float)


def test_errors_reported_for_the_rssr_are_those_of_the_closed_form():
    mech = sp.load("rssr")
    found = sp.tradeoff(mech, {"driver": "crank", "values": TURN}, settings=FEW, repeats=1)
    assert len(found) == len(FEW) and found.reference_error < 1e-17
    for row in found.rows:
        told = np.array([row.errors.position, row.errors.velocity, row.errors.acceleration])
        true = rocker_errors(mech, row.accuracy, TURN)
        assert np.all(true <= told * (1 + 1e-6) + 1e-15)
        assert np.all(told <= 20 * true + 2e-15)  # the coupler's joint loses more than the rocker
        motion = sp.sweep(mech, "crank", TURN, accuracy=row.accuracy)
        assert row.errors.closure == pytest.approx(motion.closure_error.max(), rel=0.01, abs=1e-15)
        together = row.accuracy.order == 3 and row.accuracy.corrections is None
        if together:
            assert row.errors.spin < 1e-10
        else:  # steps of 10° are long, and those that they are divided into are still seen
            assert row.errors.spin > 1e-8


def test_a_mechanism_without_loops_has_no_error():
    found = sp.tradeoff(sp.load("satellite_dish"), None, settings=FEW[:1], repeats=1)
    assert found.rows[0].error == 0.0
    assert found.cheapest(1e-14).accuracy == FEW[0]  # three times round-off


def test_rates_of_any_speed_and_other_drivers_are_judged():
    """Errors of rates grow with the speed, the total does not."""
    mech = sp.load("delta")
    values = np.linspace(-0.2, 0.3, 21)
    slow, fast = (sp.tradeoff(mech, {"driver": "arm_2", "values": values, "speed": speed,
                                  "hold": {"arm_1": 0.1, "arm_3": 0.0}},
                           settings=[sp.Accuracy(tolerance=1e-4)], repeats=1).rows[0]
                  for speed in (1.0, 100.0))
    assert fast.errors.velocity == pytest.approx(100 * slow.errors.velocity, rel=1e-6)
    assert fast.error == pytest.approx(slow.error, rel=1e-6)


def test_what_a_sweep_holds_is_held_while_it_is_measured(tmp_path):
    mechanism = known.five_bar(tmp_path)
    task = {"driver": "left", "values": np.linspace(2.0, 2.2, 11), "speed": 1.0}
    own = sp.sweep(mechanism, **task, hold=["base", "elbow2"])
    assert np.ptp(own.coordinate("elbow2").value) < 1e-12 < np.ptp(own.coordinate("right").value)
    found = sp.tradeoff(mechanism, {**task, "hold": ["base", "elbow2"]}, repeats=1,
                        settings=[sp.Accuracy.named("engineering")])
    assert "right is released" in found.rows[0].note and found.rows[0].error < 1e-12


def test_a_motion_is_a_task_too():
    mech = sp.load("rspc")
    motion = sp.sweep(mech, "crank", TURN, 2.0, acceleration=0.3)
    found = sp.tradeoff(mech, motion, settings=FEW[:2], repeats=1)
    task = {"driver": "crank", "values": TURN, "speed": 2.0, "acceleration": 0.3}
    again = sp.tradeoff(mech, task, settings=FEW[:2], repeats=1)
    errors = [{row.accuracy: row.errors for row in x.rows} for x in (found, again)]
    assert errors[0][FEW[1]] == pytest.approx(errors[1][FEW[1]], rel=1e-3)


def test_a_sweep_that_stops_at_a_limit_is_measured_up_to_there():
    mech = sp.load("rssr")
    found = sp.tradeoff(mech, {"driver": "rocker_pin", "values": np.linspace(1.5, 4.0, 26),
                            "on_limit": "stop"}, settings=FEW[:1], repeats=1)
    assert 5 < found.rows[0].steps < 26


def test_settings_that_fail_say_why_in_the_table():
    bad = sp.Accuracy(integrator="RK4")
    found = sp.tradeoff(simple_pendulum(), {"duration": 0.1, "times": [0.05, 0.1]},
                        settings=[bad, sp.Accuracy()], repeats=2)
    failed = found.rows[-1]
    assert failed.accuracy == bad and failed.errors is None and not failed.on_front
    assert "needs a step" in failed.note and "failed: integrator 'RK4' needs a step" in str(found)
    assert len(failed.seconds) == 1 and np.isnan(failed.error) and failed.spread is None


@pytest.mark.slow
def test_a_setting_for_which_no_time_is_left_is_reported_as_untried():
    found = sp.tradeoff(sp.load("four_bar"), {"values": TURN}, settings=FEW, budget=1e-9)
    assert not found.front and {row.note for row in found.rows} == {"not tried, the time was out"}
    assert "not tried" in str(found) and found.as_dict()["rows"][0]["time_per_step"] is None
    assert not found.plot().axes[0].containers
    with pytest.raises(sp.SpatialPinError, match="no setting worked"):
        found.cheapest(1.0)


# ---------------------------------------------------------------- simulations


def test_what_the_reference_cannot_tell_is_stated():
    mech = simple_pendulum()
    task = {"state": sp.assemble(mech, {"pin": 2.0}), "duration": 1.0, "times": [0.5, 1.0]}
    tight = sp.Accuracy.named("reference")
    found = sp.tradeoff(mech, task, settings=[tight, sp.Accuracy(time_tolerance=1e-4)], repeats=1)
    row = next(row for row in found.rows if row.accuracy == tight)
    assert row.error < found.reference_error <= found.known_error(row)
    assert f"< {found.reference_error:.1e}" in str(found)
    with pytest.raises(sp.SpatialPinError, match="as far as the reference tells"):
        found.cheapest(1e-20)


# ---------------------------------------------------------------- the front


# ---------------------------------------------------------------- settings for an error


def test_settings_measured_on_the_mechanism_itself_go_first():
    mech = sp.load("rspc")
    found = sp.tradeoff(mech, {"values": TURN}, settings=FEW, repeats=3)
    for error in (1e-2, 1e-6, 1e-9):
        pick = sp.Accuracy.for_error(error, measured=found)
        good = [row for row in found.rows if found.error_bound(row) <= error]
        assert pick == min(good, key=lambda row: row.time_per_step).accuracy
    with pytest.raises(sp.SpatialPinError, match=r"no setting that was measured .* the best"):
        sp.Accuracy.for_error(1e-30, measured=found)


@pytest.mark.parametrize(("words", "message"), [
    ((0.0,), "must be positive"), ((float("nan"),), "must be positive"),
    ((1e-6, "dance"), "no task 'dance'"),
])
def test_errors_that_mean_nothing_are_refused(words, message):
    with pytest.raises(ValueError, match=message):
        sp.Accuracy.for_error(*words)


# ---------------------------------------------------------------- tasks


@pytest.mark.parametrize(("task", "kind", "message"), [
    ("dance", ValueError, "'sweep' and 'simulate'"),
    (3, TypeError, "a task is a mapping"),
    ({"values": TURN, "accuracy": sp.Accuracy()}, ValueError, "tries settings itself"),
    ({"values": TURN, "sped": 1.0}, LookupError, "did you mean 'speed'"),
    ({"duration": 1.0, "effort": {}}, LookupError, "did you mean 'efforts'"),
    ({"speed": 1.0}, ValueError, "needs values"),
    ({"values": TURN, "driver": "krank"}, LookupError, "did you mean 'crank'"),
    ({"values": [4.0, 9.0], "driver": "rocker_pin"}, sp.AssemblyError, "cannot be closed"),
])
def test_what_is_no_task_is_refused(task, kind, message):
    with pytest.raises(kind, match=message):
        sp.tradeoff(sp.load("rssr"), task)


def test_nothing_that_moves_is_refused(tmp_path):
    with pytest.raises(sp.SpatialPinError, match="stands still under gravity"):
        sp.tradeoff(sp.load("swash_plate"), "simulate")
    with pytest.raises(sp.SpatialPinError, match="has no masses"):
        sp.tradeoff(known.bennett(tmp_path), "simulate")
    with pytest.raises(ValueError, match="does not know all that acted"):
        mech = simple_pendulum()
        sp.tradeoff(mech, sp.simulate(mech, sp.assemble(mech), 0.1))
    with pytest.raises(ValueError, match="no settings"):
        sp.tradeoff(sp.load("rssr"), settings=[])
    with pytest.raises(ValueError, match="whole number"):
        sp.tradeoff(sp.load("rssr"), repeats=0)


# ---------------------------------------------------------------- what is written


@pytest.fixture(scope="module")
def small():
    mech = sp.load("four_bar")
    return sp.tradeoff(mech, {"driver": "crank", "values": TURN}, settings=FEW, repeats=3)


def test_the_table_marks_the_front_and_names_levels(small):
    lines = str(small).splitlines()
    assert lines[0] == "four_bar: sweep of crank from 0 to 6.28319 rad, 37 values"
    assert sum(line.startswith("* ") for line in lines) == len(small.front) >= 1
    assert "order 3, to 1e-13 (engineering)" in str(small) and "(draft)" in str(small)
    times = [row.time_per_step for row in small.rows]
    assert times == sorted(times)
    assert all(len(row.seconds) == 3 and row.spread >= 0.0 for row in small.rows)
    assert small.rows[0].time_per_step == min(small.rows[0].seconds) / 37


def test_the_table_is_written_as_json_and_as_a_figure(small, tmp_path):
    content = json.loads(small.to_json(tmp_path / "t.json").read_text(encoding="utf-8"))
    assert [row["on_front"] for row in content["rows"]] == [r.on_front for r in small.rows]
    assert content["rows"][0]["error"] == small.rows[0].error
    assert content["rows"][0]["accuracy"]["order"] == small.rows[0].accuracy.order
    figure = small.plot(tmp_path / "t.png")
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")
    axes = figure.axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    drawn = np.vstack([np.column_stack(c[0].get_data()) for c in axes.containers])
    want = [(1e6 * row.time_per_step, small.known_error(row)) for row in small.rows]
    assert np.array(sorted(drawn.tolist())) == pytest.approx(np.array(sorted(want)))


def test_the_command_measures_and_picks(run, tmp_path):
    words = ["hooke_joint", "input", "0", "90deg", "--steps", "10", "--repeats", "1", "--error",
             "1e-6", "--json", tmp_path / "t.json", "--plot", tmp_path / "t.svg"]
    code, out, err = run("tradeoff", *words)
    assert code == 0 and err == "" and "sweep of input from 0 to 1.5708 rad, 10 values" in out
    assert "cheapest for an error of 1e-06: Accuracy(" in out and f"wrote {tmp_path}" in out
    assert json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))["kind"] == "sweep"
    assert "<svg" in (tmp_path / "t.svg").read_text(encoding="utf-8")


def test_the_command_measures_simulations(run):
    words = ["crane", "--simulate", "200ms", "--rows", "5", "--repeats", "1", "--begin",
             "slew=2rpm", "--effort", "luff=5Nm", "--json", "-"]
    code, out, _ = run("tradeoff", *words)
    assert code == 0
    content = json.loads(out)
    assert content["kind"] == "simulate" and content["task"] == "simulation of 0.2 s"
    assert {row["steps"] for row in content["rows"] if row["note"] == ""} == {5}


@pytest.mark.parametrize(("words", "code", "message"), [
    (["rsrr"], 1, "did you mean 'rssr'?"),
    (["rssr", "krank", "0", "1"], 1, "did you mean 'crank'?"),
    (["rssr", "crank", "0"], 2, "a sweep needs a driver"),
    (["rssr", "--at", "crank=1"], 2, "need --simulate"),
    (["rssr", "crank", "0", "1", "--simulate", "1"], 2, "no driver to sweep"),
    (["rssr", "--simulate", "--at", "crank=1"], 2, "needs a duration"),
    (["rssr", "--simulate", "5mm"], 1, "duration is in s or ms"),
    (["rssr", "--simulate", "1s", "--effort", "crank=5deg"], 1, "the effort of crank is in Nm"),
    (["swash_plate", "--simulate"], 1, "stands still under gravity"),
    (["rssr", "--error", "-1"], 2, "not a positive number"),
    (["rssr", "--error", "1mm"], 2, "not a positive number"),
    (["rssr", "--repeats", "0"], 2, "whole number"),
])
def test_the_command_says_in_one_paragraph_what_is_wrong(words, code, message, run):
    found, _, err = run("tradeoff", *words)
    assert found == code and message in err and "Traceback" not in err


@pytest.mark.parametrize("name", ["rssr", "four_bar"])
def test_what_was_measured_on_few_values_is_kept_on_many(name):
    """Between samples too: those that lie closer together are interpolated."""
    mech = sp.load(name)
    crank = np.linspace(0.0, 2.0 * np.pi, 2001)
    found = sp.tradeoff(mech, {"driver": "crank", "values": crank[::10]}, repeats=1, budget=5.0)
    for values in (crank, crank[::-1] + 0.3):
        exact = sp.sweep(mech, "crank", values)
        for error in (1e-2, 1e-4, 1e-6):
            setting = sp.Accuracy.for_error(error, measured=found)
            motion = sp.sweep(mech, "crank", values, accuracy=setting)
            for one, true in ((motion.q, exact.q), (motion.v, exact.v), (motion.a, exact.a)):
                assert np.abs(one - true).max() <= error * max(1.0, np.abs(true).max())


def test_a_table_tells_times_by_engineering_and_the_error_that_a_setting_keeps():
    found = sp.tradeoff(sp.load("four_bar"), {"values": TURN}, settings=FEW, repeats=3)
    text = str(found)
    assert "keeps e =" in text and "time" in text.splitlines()[2]
    base = next(row for row in found.rows if row.accuracy == sp.Accuracy())
    assert found.relative_time(base) == 1.0
    assert all(found.error_bound(row) >= 3.0 * row.error for row in found.rows if row.errors)
