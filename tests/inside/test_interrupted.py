"""What was found before Ctrl-C is kept: motions, clearances, calibrations."""

import json
import pickle

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin.accuracy import tradeoff
from spatial_pin.cli.running import main
from spatial_pin.continuation import path_following as following
from spatial_pin.continuation.path_tracker import PathTracker
from spatial_pin.dimensions import tolerance
from spatial_pin.dimensions.predictions import Predictions
from spatial_pin.dimensions.sensitivity import _Around
from spatial_pin.dimensions.varied_samples import VariedSamples
from spatial_pin.dynamics import loaded_samples
from spatial_pin.dynamics.simulation.run import Run
from spatial_pin.inverse_kinematics import reach_path
from spatial_pin.kernel.kkt import CoreKKT
from spatial_pin.mobility.mode_search import ModeSearch
from spatial_pin.proximity.clearance_search import ClearanceSearch
from spatial_pin.proximity.distances import Distances
from spatial_pin.synthesis.global_search import Checkpoint
from spatial_pin.workspace import workspace as workspace

VALUES = np.linspace(0.0, 3.0, 61)


def interrupting(call, at):
    """Return what does as a method does until it is called for the nth time, which is Ctrl-C."""
    calls = []

    def interrupted(*arguments, **options):
        calls.append(arguments)
        if len(calls) == at:
            raise KeyboardInterrupt
        return call(*arguments, **options)

    return interrupted


def cut_short(call, *arguments, **options):
    """Return what a verb that Ctrl-C interrupts has found, which says that it is not whole."""
    with pytest.raises(sp.Interrupted) as stopped:
        call(*arguments, **options)
    error = stopped.value
    assert error.found is error.result and "not whole" in repr(error)
    assert not error.result.is_whole and "cut short" in repr(error.result)
    copied = pickle.loads(pickle.dumps(error))
    assert str(copied) == str(error) and type(copied.result) is type(error.result)
    return error.result


# ---------------------------------------------------------------- motions


@pytest.fixture
def cut(monkeypatch):
    """Interrupt the following of a branch when so many samples are done or more."""
    follow = following._follow

    def after(most):
        def interrupted(*arguments):
            for done in follow(*arguments):
                if done > most:
                    raise KeyboardInterrupt
                yield done

        monkeypatch.setattr(following, "_follow", interrupted)
        monkeypatch.setattr(following, "CHUNK", 30)  # ten samples of three joints at a time

    return after


def assert_begins(motion, whole, n):
    assert len(motion) == n and motion.q.shape[1] == whole.q.shape[1]
    np.testing.assert_allclose(motion.q, whole.q[:n], atol=1e-13)


def test_a_sweep_keeps_the_motion_until_ctrl_c(cut):
    mechanism = sp.load("four_bar")
    whole = sp.sweep(mechanism, "crank", VALUES, speed=2.0)
    cut(20)
    with pytest.raises(sp.Interrupted, match="after 20 samples") as stopped:
        sp.sweep(mechanism, "crank", VALUES, speed=2.0)
    assert isinstance(stopped.value, KeyboardInterrupt)
    assert not isinstance(stopped.value, Exception)  # which would be caught as an error
    assert_begins(stopped.value.motion, whole, 20)
    np.testing.assert_array_equal(stopped.value.motion.time, whole.time[:20])
    copied = pickle.loads(pickle.dumps(stopped.value))
    assert str(copied) == "after 20 samples" and len(copied.motion) == 20


def test_several_drivers_keep_the_motion_until_ctrl_c(cut):
    mechanism = sp.load("stewart")
    state = sp.assemble(mechanism)
    values = {name: state.coordinate(name).value + 0.01 * k * np.sin(VALUES)
              for k, name in enumerate(mechanism.drivers)}
    whole = sp.follow(mechanism, values, VALUES)
    cut(14)
    with pytest.raises(sp.Interrupted) as stopped:
        sp.follow(mechanism, values, VALUES)
    assert_begins(stopped.value.motion, whole, 14)
    np.testing.assert_array_equal(stopped.value.motion.time, VALUES[:14])


def test_a_path_of_targets_keeps_the_motion_until_ctrl_c(cut):
    mechanism = sp.load("four_bar")
    whole = sp.sweep(mechanism, "crank", VALUES)
    targets = {"rocker_pin": whole.coordinate("rocker_pin").value[20:30]}
    guess = whole.state(20)
    path = sp.reach_path(mechanism, targets, state=guess)
    cut(4)
    following.CHUNK = 6
    with pytest.raises(sp.Interrupted) as stopped:
        sp.reach_path(mechanism, targets, state=guess)
    assert 0 < len(stopped.value.motion) <= 4
    assert_begins(stopped.value.motion, path, len(stopped.value.motion))


def test_a_path_of_targets_keeps_its_motion_where_singular_drivers_are_searched_for(monkeypatch):
    mechanism = sp.load("delta")
    line = np.linspace([0.0, 0.0, -0.9], [0.2, 0.0, -0.9], 9)
    whole = sp.reach_path(mechanism, {"platform": line})
    monkeypatch.setattr(reach_path, "_driver_singularities",
                        interrupting(reach_path._driver_singularities, 1))
    with pytest.raises(sp.Interrupted) as stopped:
        sp.reach_path(mechanism, {"platform": line})
    assert_begins(stopped.value.motion, whole, 9)


def test_targets_reached_one_by_one_are_kept_until_ctrl_c(monkeypatch):
    mechanism = sp.load("excavator")
    points = np.linspace([6.0, 0.0, -1.0], [6.4, 0.0, -1.2], 9)
    start = sp.reach(mechanism, {"teeth": points[0]})
    whole = sp.reach_path(mechanism, {"teeth": points[:4]}, state=start)
    monkeypatch.setattr(reach_path, "reach", interrupting(reach_path.reach, 5))
    with pytest.raises(sp.Interrupted) as stopped:
        sp.reach_path(mechanism, {"teeth": points}, state=start)
    assert_begins(stopped.value.motion, whole, 4)


def test_nothing_is_kept_before_the_first_samples(cut, monkeypatch):
    monkeypatch.setattr(PathTracker, "from_guess", lambda *_: None)
    cut(0)
    with pytest.raises(KeyboardInterrupt) as stopped:
        sp.sweep(sp.load("four_bar"), "crank", VALUES)
    assert not isinstance(stopped.value, sp.Interrupted)


# ---------------------------------------------------------------- clearance


@pytest.fixture(scope="module")
def turn():
    return sp.sweep(sp.load("four_bar"), "crank", np.linspace(0.0, 6.0, 25))


def test_samples_that_were_looked_at_tell_of_the_clearance_after_ctrl_c(turn, monkeypatch):
    whole = sp.clearance(turn)
    monkeypatch.setattr(Distances, "every", interrupting(Distances.every, 11))
    found = cut_short(sp.clearance, turn)
    n = len(found.motion)
    assert not found.is_whole and n == 10
    assert str(found).splitlines()[0].endswith("cut short at 10 samples")
    for pair in found.pairs:
        there = whole.between(*pair.links)
        np.testing.assert_array_equal(pair.distances, there.distances[:n])
        assert pair.distance == there.distances[:n].min() == pair.distances[pair.row]
        np.testing.assert_array_equal(pair.at, there.points[pair.row])


def test_pairs_that_were_searched_stay_so_after_ctrl_c(turn, monkeypatch):
    whole = sp.clearance(turn)
    monkeypatch.setattr(ClearanceSearch, "result", interrupting(ClearanceSearch.result, 1))
    found = cut_short(sp.clearance, turn)
    assert not found.is_whole and len(found.motion) == len(turn)
    assert all(pair.distance == pair.distances.min() for pair in found.pairs)
    assert found.least.distance == pytest.approx(whole.least.distance, abs=1e-2)


def test_touches_between_samples_are_reported_by_these_after_ctrl_c(turn, monkeypatch):
    apart = sp.clearance(turn).least
    tolerance = float(np.median(apart.distances))
    monkeypatch.setattr(ClearanceSearch, "result", interrupting(ClearanceSearch.result, 1))
    found = cut_short(sp.clearance, turn, [apart.links], tolerance=tolerance)
    rows = np.flatnonzero(apart.distances <= tolerance)
    assert found.least.contacts[0].begin == turn.driver[rows[0]]
    assert found.least.contacts[-1].end == turn.driver[rows[-1]]
    assert len(found.least.contacts) == 1 + np.sum(np.diff(rows) > 1)


def test_no_clearance_is_reported_before_the_first_sample(turn, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(ClearanceSearch, "sample", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sp.clearance(turn)


def test_the_command_writes_what_was_found_and_ends_as_interrupted(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(Distances, "every", interrupting(Distances.every, 11))
    file = tmp_path / "found.json"
    assert main(["clearance", "four_bar", "crank", "0", "6", "--json", str(file)]) == 130
    assert "cut short at 10 samples" in " ".join(capsys.readouterr().out.split())
    assert json.loads(file.read_text())["is_whole"] is False


# ---------------------------------------------------------------- along a motion


def test_forces_and_derivatives_along_a_motion_are_kept_until_ctrl_c(monkeypatch):
    mechanism = sp.load("geared_five_bar")
    motion = sp.sweep(mechanism, "crank", VALUES, speed=2.0)
    forces, derived = sp.kinetostatics(mechanism, motion), sp.sensitivity(
        mechanism, motion, "right_pin", ["a"])
    monkeypatch.setattr(loaded_samples, "SAMPLES_AT_ONCE", 10)
    monkeypatch.setattr(CoreKKT, "of_many", interrupting(CoreKKT.of_many, 3))
    with pytest.raises(sp.Interrupted) as stopped:
        sp.kinetostatics(mechanism, motion)
    assert "not whole" in repr(stopped.value)
    found = pickle.loads(pickle.dumps(stopped.value)).result
    assert_begins(found.motion, motion, 20)
    np.testing.assert_array_equal(found.efforts["crank"], forces.efforts["crank"][:20])
    np.testing.assert_array_equal(found.reactions["tip_pin"],
                                  forces.reactions["tip_pin"][:20])
    monkeypatch.setattr(_Around, "differentiated", interrupting(_Around.differentiated, 21))
    with pytest.raises(sp.Interrupted) as stopped:
        sp.sensitivity(mechanism, motion, "right_pin", ["a"])
    assert_begins(stopped.value.motion, motion, 20)
    np.testing.assert_array_equal(stopped.value.found.derivatives["a"],
                                  derived.derivatives["a"][:20])


@pytest.mark.parametrize(("words", "owner", "name"), [
    (["statics", "geared_five_bar"], CoreKKT, "of_many"),
    (["sensitivity", "four_bar", "rocker_pin"], _Around, "differentiated"),
], ids=["statics", "sensitivity"])
def test_commands_tell_what_they_found_along_a_sweep_until_ctrl_c(
        monkeypatch, tmp_path, capsys, words, owner, name):
    file = tmp_path / "found.csv"
    monkeypatch.setattr(loaded_samples, "SAMPLES_AT_ONCE", 1)
    monkeypatch.setattr(owner, name, interrupting(getattr(owner, name), 8))
    assert main([*words, "--over", "crank=0..3", "--steps", "31", "--csv", str(file)]) == 130
    assert capsys.readouterr().err == "spatial-pin: cut short after 7 values\n"
    rows = file.read_text().splitlines()
    assert len(rows) == 8 and float(rows[-1].split(",")[0]) == pytest.approx(0.6, abs=1e-12)
    monkeypatch.setattr(owner, name, interrupting(getattr(owner, name), 1))
    assert main([*words, "--over", "crank=0..3", "--steps", "31"]) == 130
    assert "interrupted before there was a result" in capsys.readouterr().err


# ---------------------------------------------------------------- calibration


@pytest.fixture(scope="module")
def measured():
    """Return a four-bar and what is measured of one with another rocker."""
    true = sp.load("four_bar", r4=0.26, r3=0.27)
    return sp.load("four_bar"), [
        ({"crank": x}, {"rocker_pin": sp.assemble(true, {"crank": x}).coordinate(
            "rocker_pin").value}) for x in np.linspace(0.0, 5.0, 12)]


@pytest.mark.slow
def test_a_calibration_keeps_its_best_values_until_ctrl_c(measured, monkeypatch):
    nominal, readings = measured
    whole = sp.calibrate(nominal, readings, ["r3", "r4"])
    assert whole.is_whole and whole.values["r4"] == pytest.approx(0.26, abs=1e-12)
    monkeypatch.setattr(Predictions, "jacobian", interrupting(Predictions.jacobian, 4))
    found = cut_short(sp.calibrate, nominal, readings, ["r3", "r4"])
    assert str(found).splitlines()[0].endswith("cut short")
    assert found.as_dict()["is_whole"] is False
    left, before = (np.linalg.norm(x) for x in (found.residuals, found.before))
    assert 1e-12 < left < 0.1 * before
    assert found.values["r4"] != whole.values["r4"]


def test_no_calibration_is_reported_before_the_first_step(measured, monkeypatch):
    monkeypatch.setattr(Predictions, "jacobian", interrupting(Predictions.jacobian, 1))
    with pytest.raises(KeyboardInterrupt):
        sp.calibrate(*measured, ["r3", "r4"])


# ---------------------------------------------------------------- simulations, analyses


def test_a_simulation_keeps_the_motion_until_ctrl_c():
    mechanism = sp.load("four_bar")
    state, times = sp.assemble(mechanism, {"crank": 1.0}), np.linspace(0.0, 1.0, 101)

    def efforts(t, state):
        if t > 0.6:
            raise KeyboardInterrupt
        return {"crank": 0.1}

    whole = sp.simulate(mechanism, state, 1.0, {"crank": 0.1}, times)
    with pytest.raises(sp.Interrupted) as stopped:
        sp.simulate(mechanism, state, 1.0, efforts, times)
    motion = stopped.value.motion
    assert isinstance(motion, sp.Simulation) and 20 < len(motion) < 80
    np.testing.assert_allclose(motion.q, whole.q[: len(motion)], atol=1e-6)
    assert motion.energy_drift < 1e-8


def test_the_command_writes_what_was_simulated(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(Run, "_kernel_steps", interrupting(lambda *_: None, 30))  # step by step
    file = tmp_path / "fall.json"
    assert main(["simulate", "four_bar", "--duration", "1", "--json", str(file)]) == 130
    written = json.loads(file.read_text(encoding="utf-8"))
    n = len(written["columns"]["time [s]"])
    assert 10 < n < 1001 and not written["is_whole"]
    assert f"cut short after {n} steps" in capsys.readouterr().out


@pytest.mark.parametrize("words", [
    ["transmission", "four_bar", "rocker_pin"], ["sensitivity", "four_bar", "rocker_pin"],
    ["statics", "four_bar"],
])
def test_what_was_followed_for_an_analysis_over_a_driver_is_reported(words, cut, tmp_path, capsys):
    cut(20)
    file = tmp_path / "along.csv"
    assert main([*words, "--over", "crank=0..3", "--steps", "61", "--csv", str(file)]) == 130
    n = len(file.read_text(encoding="utf-8").splitlines()) - 1
    assert 20 <= n < 61
    assert f"cut short after {n} values" in capsys.readouterr().err


def test_settings_that_were_measured_are_reported(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(tradeoff, "_judged", interrupting(tradeoff._judged, 4))
    file = tmp_path / "table.json"
    assert main(["tradeoff", "four_bar", "crank", "0", "1", "--steps", "21", "--repeats", "1",
                 "--json", str(file)]) == 130
    written = json.loads(file.read_text(encoding="utf-8"))
    assert not written["is_whole"]
    assert sum(row["note"] != "not tried, cut short" for row in written["rows"]) == 3
    assert "cut short" in capsys.readouterr().out


@pytest.mark.parametrize("copies", [[], ["--copies"]])
def test_modes_that_were_found_are_reported(copies, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(ModeSearch, "_sort", interrupting(ModeSearch._sort, 2))
    file = tmp_path / "modes.csv"
    assert main(["modes", "four_bar", "crank=1", *copies, "--csv", str(file)]) == 130
    assert len(file.read_text(encoding="utf-8").splitlines()) == 3
    assert "64 closed; cut short" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
@pytest.mark.parametrize("part", ["together", "one by one"])
def test_samples_that_were_drawn_before_tell_of_the_tolerance(part, monkeypatch, tmp_path, capsys):
    words = ["tolerance", "rssr", "rocker_pin", "--deviation", "b=1mm", "--samples", "40"]
    if part == "together":
        monkeypatch.setattr(tolerance, "SOLVED_TOGETHER", 10)
        monkeypatch.setattr(VariedSamples, "geometry", interrupting(VariedSamples.geometry, 3))
    else:
        monkeypatch.setattr(VariedSamples, "of", lambda *_: None)
        monkeypatch.setattr(tolerance, "_sample", interrupting(tolerance._sample, 22))
    file = tmp_path / "spread.json"
    assert main([*words, "--json", str(file)]) == 130
    written = json.loads(file.read_text(encoding="utf-8"))
    assert written["samples"] == 20 and written["failed"] == 0 and not written["is_whole"]
    assert "cut short after 20 samples" in capsys.readouterr().out
    whole = sp.tolerance(sp.load("rssr"), "rocker_pin", {"b": 1e-3}, samples=40)
    assert written["mean"]["rocker_pin"] == pytest.approx(
        whole.samples["rocker_pin"][:20].mean(), abs=1e-12)


# ---------------------------------------------------------------- one habit for all verbs


def test_every_verb_that_is_cut_short_raises_what_it_has_found(monkeypatch, turn):
    """Searches have no motion; what is found along one has the motion until then."""
    mechanism = sp.load("four_bar")
    goal = sp.goals.swing("rocker_pin", 1.0)
    levels = [sp.Accuracy.named("draft"), sp.Accuracy.named("engineering")]
    task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 21), "speed": 1.0}
    cases = [
        (ModeSearch, "_sort", 2, lambda: sp.assembly_modes(mechanism, {"crank": 1.0})),
        (VariedSamples, "geometry", 4, lambda: sp.tolerance(
            mechanism, "rocker_pin", {"r3": 1e-4}, samples=40)),
        (tradeoff, "_judged", 2, lambda: sp.tradeoff(
            mechanism, task, settings=levels, repeats=1)),
        (Checkpoint, "add", 2, lambda: sp.design(mechanism, goal, {"r2": (0.05, 0.15)}, starts=5)),
        (workspace, "_fill", 1, lambda: sp.workspace(
            mechanism, "coupler_b", {"crank": (0.0, 1.0)}, points=5)),
    ]
    monkeypatch.setattr(tolerance, "SOLVED_TOGETHER", 10)
    for owner, name, at, call in cases:
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, interrupting(getattr(owner, name), at))
            cut_short(call)
            patch.setattr(owner, name, interrupting(getattr(owner, name), at))
            with pytest.raises(sp.Interrupted) as stopped:
                call()
            assert stopped.value.motion is None
    monkeypatch.setattr(Distances, "every", interrupting(Distances.every, 11))
    with pytest.raises(sp.Interrupted) as stopped:
        sp.clearance(turn)
    assert stopped.value.motion is stopped.value.result.motion


def test_the_result_of_a_motion_is_the_motion(cut):
    cut(20)
    with pytest.raises(sp.Interrupted) as stopped:
        sp.sweep(sp.load("four_bar"), "crank", VALUES, speed=2.0)
    error = stopped.value
    assert error.result is error.motion is error.found
    assert repr(error).startswith("Interrupted(after 20 samples; not whole: Motion('four_bar': 20")


def test_a_verb_that_uses_another_is_interrupted_with_it(monkeypatch):
    """A search for designs took the part of a clearance that was looked at for the whole."""
    mechanism = sp.load("four_bar")
    goals = [sp.goals.swing("rocker_pin", 1.0), sp.goals.clearance(0.001)]
    monkeypatch.setattr(Distances, "every", interrupting(Distances.every, 4))
    with pytest.raises(KeyboardInterrupt):
        sp.design(mechanism, goals, {"r2": (0.05, 0.15)}, starts=1)
