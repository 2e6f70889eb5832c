"""The command `spatial-pin design`: goals in files, workers, what is kept, what is refused."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp

FREUDENSTEIN = """
[dimensions]
r2 = ["50mm", 0.6]
r3 = [0.05, "0.6 m"]
r4 = {r4}

[[goal]]
kind = "function"
output = "rocker_pin"
values = ["80deg", "100deg", "130deg"]
drivers = {{crank = ["40deg", "85deg", "130deg"]}}
"""
PHI, PSI = np.radians([40.0, 85.0, 130.0]), np.radians([80.0, 100.0, 130.0])


@pytest.fixture
def goals(tmp_path):
    path = tmp_path / "goals.toml"
    path.write_text(FREUDENSTEIN.format(r4="[0.05, 0.6]"))
    return path


def rocker(mechanism, phi, guess):
    state = sp.assemble(mechanism, {"crank": phi}, guess={"rocker_pin": guess, "crank_pin": phi})
    return state.coordinate("rocker_pin").value


@pytest.mark.slow
def test_a_design_is_reported_saved_and_shown(run, goals, tmp_path):
    files = [tmp_path / name for name in ("page.html", "report.html", "all.json")]
    code, out, err = run("design", "four_bar", "--goals", goals, "--starts", 2,
                         "--save", tmp_path / "best", "--html", files[0], "--report", files[1],
                         "--json", files[2])
    assert (code, err) == (0, "")
    assert out.startswith("four_bar: 1 design from 2 starts") and "r2 = 0.158802" in out
    assert all(f"wrote {path}" in out for path in files)
    found = json.loads(files[2].read_text())
    best = found["designs"][0]
    assert found["is_whole"] and best["bounds"]["r2"] == [0.05, 0.6]
    assert best["errors"]["function of rocker_pin"]["most"] < 1e-12
    mechanism = sp.load(tmp_path / "best" / "four_bar.toml")
    for phi, psi in zip(PHI, PSI, strict=True):
        assert rocker(mechanism, phi, psi) == pytest.approx(psi, abs=1e-12)
    assert "function of rocker_pin" in files[1].read_text("utf-8")


def test_json_on_the_screen_is_all_there_is_and_free_is_no_bound(run, goals):
    goals.write_text(FREUDENSTEIN.format(r4='"free"'))
    code, out, _ = run("design", "four_bar", "--goals", goals, "--starts", 1, "--json", "-")
    assert code == 0
    assert json.loads(out)["designs"][0]["bounds"]["r4"] == [None, None]


def test_an_end_without_a_bound_is_free_in_a_file_and_omitted_on_the_line(run, goals):
    goals.write_text(FREUDENSTEIN.format(r4='["1cm", "free"]'))
    code, out, _ = run("design", "four_bar", "r3=..40cm", "r1=0.1..", "--goals", goals,
                       "--starts", 1, "--json", "-")
    assert code == 0
    bounds = json.loads(out)["designs"][0]["bounds"]
    assert [bounds[name] for name in ("r4", "r3", "r1")] == [[0.01, None], [None, 0.4], [0.1, None]]


def test_bounds_on_the_line_replace_those_of_the_file(run, goals):
    code, out, _ = run("design", "four_bar", "r4=50mm..220mm", "--goals", goals, "--starts", 1)
    assert code == 0 and "r4 = 0.22 (its most)" in out


def test_a_table_is_a_function_of_the_drivers_in_it(run, tmp_path):
    path = tmp_path / "points.csv"
    rows = "".join(f"{a},{b}\n" for a, b in zip((40, 85, 130), (80, 100, 130), strict=True))
    path.write_text("crank [deg],rocker_pin [deg]\n" + rows)
    code, out, _ = run("design", "four_bar", "r2", "r3", "r4=0.05..0.6", "--goals", path,
                       "--starts", 1)
    assert code == 0 and "r2 = 0.158802" in out


@pytest.fixture
def goals_in(run, monkeypatch):
    """The goals that the command makes of a file for a four-bar."""
    found = []

    def design(mechanism, goals, *_, **__):
        found[:] = goals
        raise sp.SpatialPinError("enough")

    def goals_in(path):
        code, _, err = run("design", "four_bar", "r2", "--goals", path)
        assert (code, err) == (1, "spatial-pin: enough\n")
        return found

    monkeypatch.setattr(sp, "design", design)
    return goals_in


def test_tables_and_lists_of_one_goal_are_the_same(goals_in, tmp_path):
    mechanism = sp.load("four_bar")
    states = [sp.assemble(mechanism, {"crank": x}) for x in (0.3, 0.9)]
    places = [x.placement("coupler_b") for x in states]
    table = tmp_path / "poses.csv"
    names = [f"coupler_b.{x}" for x in ("x", "y", "z", "rx", "ry", "rz")]
    rows = [[*p.translation, *pin.log3(p.rotation), x] for p, x in
            zip(places, (0.3, 0.9), strict=True)]
    table.write_text("\n".join([",".join([*names, "crank"]),
                                *(",".join(map(repr, map(float, row))) for row in rows)]))
    listed = [[float(x) for x in row[:6]] for row in rows]
    file = tmp_path / "goals.toml"
    file.write_text(f"""
[[goal]]
table = "poses.csv"
weight = "exact"
placement = true

[[goal]]
kind = "poses"
frame = "coupler_b"
placements = {listed}
drivers = {{crank = [0.3, 0.9]}}
weight = "exact"
placement = true

[[goal]]
kind = "path"
frame = "coupler_b"
points = {[row[:3] for row in listed]}
weight = 2.5
closed = true
""")
    first, second, path = goals_in(file)
    for one in (first, second):
        assert one.name == "poses of coupler_b" and one.weight is None and one.placement
        assert one.points == pytest.approx(np.array([p.translation for p in places]), abs=1e-15)
        assert one.rotations == pytest.approx(np.array([p.rotation for p in places]), abs=1e-14)
        assert next(iter(one.drivers.values())) == pytest.approx([0.3, 0.9])
    assert path.weight == 2.5 and path.closed and path.points == pytest.approx(first.points)
    assert not path.drivers


WHOLE = {  # goals of the mechanism as a whole: what a file says, and the arguments that means
    "swing": ('output = "rocker_pin"\nangle = "60deg"',
              {"output": "rocker_pin", "angle": np.radians(60.0)}),
    "transmission": ('output = "rocker_pin"\nat_least = "35deg"\ndriver = "crank"',
                     {"output": "rocker_pin", "at_least": np.radians(35.0), "driver": "crank"}),
    "turns": ('driver = "crank"', {"driver": "crank"}),
    "dead_centres": ('output = "rocker_pin"\nvalues = ["10deg", 3.5]',
                     {"output": "rocker_pin", "values": [np.radians(10.0), 3.5]}),
    "effort": ("at_most = 2.5\nloads = {rocker_b = [0, 0, 10, 0, 0, 0]}",
               {"at_most": 2.5, "loads": {"rocker_b": [0.0, 0.0, 10.0, 0.0, 0.0, 0.0]}}),
    "size": ('at_most = "600mm"\nweight = 2', {"at_most": 0.6, "weight": 2.0}),
    "mass": ("at_most = 3", {"at_most": 3.0}),
    "clearance": ('at_least = "5mm"\npairs = [["crank", "rocker"]]',
                  {"at_least": 0.005, "pairs": [("crank", "rocker")]}),
}


def test_every_goal_has_a_kind(run, goals):
    goals.write_text("[[goal]]\n")
    _, _, err = run("design", "four_bar", "r2", "--goals", goals)
    kinds = re.findall(r"\w+", " ".join(err.split()).partition("it has no kind; there are: ")[2])
    assert {"path", "poses", "function", *WHOLE} <= set(kinds)
    assert all(callable(getattr(sp.goals, kind)) for kind in kinds)


@pytest.mark.parametrize("kind", WHOLE)
def test_goals_of_the_whole_mechanism_are_those_of_their_functions(goals_in, tmp_path, kind):
    text, arguments = WHOLE[kind]
    path = tmp_path / "goals.toml"
    path.write_text(f'[[goal]]\nkind = "{kind}"\n{text}\n')
    (goal,) = goals_in(path)
    assert repr(goal) == repr(getattr(sp.goals, kind)(**arguments))


GOAL = '[[goal]]\nkind = "function"\noutput = "rocker_pin"\nvalues = [1.4]\n'


@pytest.mark.parametrize(("text", "words", "says"), [
    ("", ["r2"], "there is no goal; write [[goal]]"),
    ("[[goals]]\n", ["r2"], "there is no table 'goals'"),
    ("goal = 1\n", ["r2"], "there is no goal"),
    ("a b\n", ["r2"], "not valid TOML"),
    ('[[goal]]\nkind = "fonction"\n', ["r2"], "goal 1: kind is 'fonction'; did you mean"),
    ("[[goal]]\n", ["r2"], "goal 1: it has no kind; there are: "),
    (GOAL, ["r2"], "goal 1: function needs 'drivers'"),
    (GOAL + "driver = 1\n", ["r2"], "function has no 'driver'; did you mean 'drivers'?"),
    (GOAL + "drivers = {crank = [1.0, 2.0]}\n", ["r2"], "drivers: values of 'crank' has shape"),
    (GOAL + 'drivers = {crank = ["40mm"]}\n', ["r2"], "drivers: crank is in rad, not in mm"),
    (GOAL + 'drivers = {crank = ["40degrees"]}\n', ["r2"], "'40degrees' has no unit that is known"),
    (GOAL + "drivers = {cranc = [1.0]}\n", ["r2"], "did you mean 'crank"),
    (GOAL + "drivers = {crank = [1.0]}\nweight = -1\n", ["r2"], "weight is -1"),
    (GOAL + 'drivers = {crank = [1.0]}\nweight = "hard"\n', ["r2"], "weight must be a number"),
    (GOAL + "drivers = {crank = [1.0]}\n[dimensions]\nr2 = 3\n", [], "dimension r2 is [least"),
    (GOAL + "drivers = {crank = [1.0]}\n[dimensions]\nr2 = [0.3, 0.1]\n", [],
     "bounds of 'r2' are 0.3 to 0.1: the first must be the smaller one"),
    (GOAL + "drivers = {crank = [1.0]}\n", ["r2=1..5s"], "bounds of r2 are in s; a dimension"),
    (GOAL + "drivers = {crank = [1.0]}\n", ["r2=1mm..5deg"], "bounds of r2 are in mm and deg"),
    (GOAL + "drivers = {crank = [1.0]}\n", ["r9"], "'r9'"),
    (GOAL + "drivers = {crank = [1.0]}\n", [], "nothing may change: name dimensions"),
    (GOAL + "drivers = {crank = [1.0]}\n", ["r2", "r2"], "a name is given two ranges"),
    (GOAL + "drivers = {crank = [1.0]}\n", ["r2", "--starts", "0"], "whole number of at least 1"),
    (GOAL + "drivers = {crank = [1.0]}\n", ["r2", "--seed", "-1"], "whole number from 0 up"),
    ('[[goal]]\nkind = "path"\nframe = "tipp"\npoints = [[0, 0, 1]]\n', ["r2"], "'tipp'"),
    ('[[goal]]\nkind = "path"\nframe = "coupler"\npoints = [[0, "1deg", 1]]\n', ["r2"],
     "points is in m, not in deg"),
    ('[[goal]]\nkind = "path"\nframe = "coupler"\npoints = []\n', ["r2"], "points"),
    ('[[goal]]\nkind = "poses"\nframe = "coupler"\nplacements = [[0, 0, 1]]\n', ["r2"],
     "placement 0 has shape (3,)"),
    ('[[goal]]\ntable = "none.csv"\n', ["r2"], "none.csv"),
])
def test_an_impossible_request_is_refused_in_words(run, tmp_path, text, words, says):
    path = tmp_path / "goals.toml"
    path.write_text(text)
    code, out, err = run("design", "four_bar", *words, "--goals", path)
    assert code in (1, 2) and out == ""
    assert says in " ".join(err.split())
    assert "Traceback" not in err


@pytest.mark.parametrize(("text", "says"), [
    ("crank\n0.1\n", "there is no goal: columns NAME.x"),
    ("time,crank,rocker_pin\n0,0.1,1.4\n", "a design has no time"),
    ("rocker_pin\n1.4\n", "drivers names no driver"),
    ("coupler.x,coupler.z\n0.1,0.1\n", "no column coupler.y"),
])
def test_a_table_without_goals_is_refused(run, tmp_path, text, says):
    path = tmp_path / "goals.csv"
    path.write_text(text)
    code, _, err = run("design", "four_bar", "r2", "--goals", path)
    assert code == 1 and says in " ".join(err.split())


def test_files_that_cannot_be_written_are_refused_before_the_work(run, goals, tmp_path):
    for option in ("--report", "--resume"):
        code, _, err = run("design", "four_bar", "--goals", goals, option,
                           tmp_path / "none" / "f")
        assert code == 1 and "there is no folder" in err


@pytest.mark.slow
def test_workers_and_going_on_change_nothing(run, goals, tmp_path):
    def answer(*words):
        code, out, err = run("design", "four_bar", "--goals", goals, *words)
        assert (code, err) == (0, "")
        return out

    alone = answer("--starts", 3)
    assert answer("--starts", 3, "--workers", 2) == alone
    kept = tmp_path / "kept.jsonl"
    answer("--starts", 2, "--resume", kept)
    assert answer("--starts", 3, "--resume", kept) == alone


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs a signal of its own")
@pytest.mark.parametrize("workers", [1, 2])
def test_results_from_before_ctrl_c_are_returned(goals, tmp_path, workers):
    kept = tmp_path / "kept"
    # the signal is ignored in the background
    program = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
    program += "import runpy; runpy.run_module('spatial_pin', run_name='__main__')"
    command = [sys.executable, "-c", program, "design", "four_bar", "--goals", str(goals),
               "--starts", "100000", "--workers", str(workers), "--resume", str(kept),
               "--save", str(tmp_path / "best")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          start_new_session=True) as process:
        end = time.monotonic() + 60.0
        while time.monotonic() < end and not (kept.exists() and kept.stat().st_size > 2000):
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: every process of the group
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "cut short" in out and "r2 = 0.158802" in out
    assert "Traceback" not in err
    assert (tmp_path / "best" / "four_bar.toml").exists()
