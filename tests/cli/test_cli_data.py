"""What commands write: JSON and tables on the screen, lines that fit it, hints, names checked."""

from __future__ import annotations

import csv
import io
import json
from unittest.mock import MagicMock

import numpy as np
import pytest

import spatial_pin as sp

SWEPT = ("four_bar", "crank", "0", "1", "--steps", "3")
TABLES = {  # commands with a table: words, and how many rows it has; None: some
    "list": ([], None),
    "info": (["rssr"], None),
    "assemble": (["four_bar", "crank=1"], 3),
    "modes": (["four_bar", "crank=1", "--patience", "50"], 2),
    "limits": (["four_bar", "rocker_pin"], 2),
    "reach": (["four_bar", "rocker_pin=1.7"], 3),
    "sweep": ([*SWEPT], 3),
    "simulate": (["four_bar", "--duration", "0.1", "--rows", "5"], 5),
    "clearance": ([*SWEPT], None),
    "equilibrium": (["four_bar"], 5),
    "linearize": (["delta"], 3),
    "compliance": (["four_bar", "coupler"], 6),
    "workspace": (["four_bar", "coupler_b", "crank=0..1", "--points", "4"], 4),
    "tradeoff": ([*SWEPT, "--repeats", "1"], None),
}
# an arm whose joint has limits
ARM = """<robot name="arm"><link name="base"/><link name="rod"/><joint name="pin" type="revolute">
<parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="0.5" effort="1" velocity="9"/></joint></robot>"""


@pytest.mark.alike
@pytest.mark.parametrize("command", TABLES)
def test_tables_and_json_on_the_screen_are_all_there_is(run, command):
    words, rows = TABLES[command]
    code, out, err = run(command, *words, "--csv", "-")
    assert (code, err) == (0, "")
    table = list(csv.reader(io.StringIO(out)))
    assert len({len(line) for line in table}) == 1 and len(table) > 1
    assert rows is None or len(table) == rows + 1
    code, out, err = run(command, *words, "--json", "-")
    assert (code, err) == (0, "") and json.loads(out)


def test_mistakes_of_a_file_are_a_table(run, tmp_path):
    (tmp_path / "bad.urdf").write_text(ARM)
    bad = tmp_path / "bad.toml"
    bad.write_text('name = "bad"\ntree = "bad.urdf"\ntitel = "x"\n[guess]\nbin = 1.0\n')
    code, out, err = run("check", bad, "--csv", "-")
    table = list(csv.DictReader(io.StringIO(out)))
    assert code == 1 and [row["kind"] for row in table] == ["mistake", "mistake"]
    assert all(row["text"].removeprefix(f"{bad}: ") in err for row in table)
    code, out, _ = run("check", "four_bar", "--csv", "-")
    assert (code, out) == (0, "kind,text\n")


def test_one_of_two_has_the_screen(run):
    code, out, err = run("sweep", *SWEPT, "--json", "-", "--csv", "-")
    assert code == 2 and out == "" and "one of --json - and --csv -" in err


def test_a_table_on_the_screen_has_all_digits_and_is_what_a_file_has(run, tmp_path):
    path = tmp_path / "turn.csv"
    _, out, _ = run("sweep", *SWEPT, "--csv", "-")
    _, told, _ = run("sweep", *SWEPT, "--csv", path)
    assert f"wrote {path}" in told and out.splitlines() == path.read_text("utf-8").splitlines()
    motion = sp.sweep(sp.load("four_bar"), "crank", np.linspace(0, 1, 3))
    column = [float(row["rocker_pin [rad]"]) for row in csv.DictReader(io.StringIO(out))]
    assert column == motion.coordinate("rocker_pin").value.tolist()


def test_configurations_have_units_and_drivers(run):
    _, out, _ = run("assemble", "excavator", "--json", "-")
    found = json.loads(out)
    assert found["units"]["boom_slide"] == "m" and found["units"]["swing"] == "rad"
    assert found["drivers"]["boom"] == found["coordinates"]["boom_slide"]


def test_a_range_of_a_full_turn_is_json_without_infinities(run):
    _, out, _ = run("limits", "four_bar", "crank", "--json", "-")
    found = json.loads(out)
    assert found["full_turn"] and found["lower"]["value"] is None
    assert found["grashof"]["type"] == "crank-rocker"


# ---------------------------------------------------------------- lines that fit


@pytest.mark.alike
@pytest.mark.parametrize("words", [
    ("list",), ("info", "excavator"), ("info", "stewart"), ("modes", "four_bar", "crank=1"),
    ("assemble", "delta"), ("limits", "four_bar", "rocker_pin"), ("--help",),
    ("equilibrium", "delta"), ("equilibrium", "four_bar", "--all", "--starts", "8"),
    ("linearize", "delta"), ("compliance", "delta", "platform"),
    ("tradeoff", *SWEPT, "--repeats", "1"), ("statics", "stewart"), ("statics", "delta"),
    ("tradeoff", "four_bar", "--simulate", "50ms", "--repeats", "1"), ("sensitivity", "rssr",
    "coupler_b.position"), ("jacobian", "stewart", "platform"), ("check", "excavator"),
    ("sweep", "--help"), ("clearance", "delta", "arm_1", "0", "1", "--steps", "9"),
])
def test_printed_results_fit_a_terminal(run, words, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = run(*words)
    assert code == 0 and max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize("words", [
    ("tradeoff", *SWEPT, "--repeats", "1"), ("jacobian", "stewart", "platform"),
    ("statics", "delta"), ("transmission", "rssr", "rocker_pin", "--over", "crank=0..1"),
])
def test_rows_of_tables_are_one_line_each(run, words):
    _, out, _ = run(*words)
    rows = [line for line in out.splitlines() if line.startswith(("  ", "* "))]
    below = [line for line in rows if line.startswith(" " * 12)]
    assert len(below) <= 1  # the line of headings


# ---------------------------------------------------------------- hints


@pytest.mark.parametrize(("words", "hint"), [
    (("info", "rssr", "--set", "d=315"), "d is 1003 times its default 0.314: millimetres?"),
    (("assemble", "rssr", "crank=60"), "crank = 60 rad is 9.55 turns: 60deg?"),
    (("sweep", "rssr", "crank", "0", "360", "--steps", "5"), "360 rad is 57.3 turns: 360deg?"),
    (("tolerance", "rssr", "rocker_pin", "--deviation", "b=0.1"),
     "b scatters by 26% of its 0.381: 0.1mm?"),
    (("info", "excavator", "--set", "lug_angle=98"), "57.3 times its default 1.71042: degrees?"),
])
def test_numbers_of_another_unit_are_queried(run, words, hint):
    code, _, err = run(*words)
    assert code == 0 and err.startswith("spatial-pin: hint: ") and hint in err
    assert err.count("\n") == 1


@pytest.fixture
def limited(tmp_path):
    """A crank of -0.5 to 0.5 rad, and a slide of -60 to 60 mm."""
    path = tmp_path / "limited.urdf"
    path.write_text("""<robot name="limited">
      <link name="base"/> <link name="crank"/> <link name="rack"/>
      <joint name="hinge" type="revolute"> <parent link="base"/> <child link="crank"/>
        <axis xyz="1 0 0"/> <limit lower="-0.5" upper="0.5" effort="1" velocity="1"/> </joint>
      <joint name="slide" type="prismatic"> <parent link="base"/> <child link="rack"/>
        <origin xyz="1 0 0"/>
        <axis xyz="0 1 0"/> <limit lower="-0.06" upper="0.06" effort="1" velocity="1"/> </joint>
    </robot>""")
    return str(path)


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize(("value", "hint"), [
    ("hinge=10", "hinge = 10 rad is beyond its joint limits, and 10deg is not: 10deg?"),
    ("slide=20", "slide = 20 m is beyond its joint limits, and 20mm is not: 20mm?"),
    ("hinge=-3", "hinge = -3 rad is beyond its joint limits, and -3deg is not: -3deg?"),
    ("hinge=0.6", ""), ("hinge=10rad", ""), ("slide=100", "")])
def test_a_number_beyond_joint_limits_may_be_intended_in_another_unit(run, limited, value, hint):
    code, _, err = run("assemble", limited, value)
    found = [line for line in err.splitlines() if "hint" in line]
    if value == "slide=100":  # beyond in both: another hint
        assert "times the length" in found[0]
    else:
        assert code == 0 and found == ([f"spatial-pin: hint: {hint}"] if hint else [])


def test_a_hint_stands_behind_the_error_that_it_may_explain(run):
    code, _, err = run("assemble", "rssr", "--set", "d=315")
    assert code == 1 and err.count("\n") == 1
    assert "stays open" in err and err.endswith("; d is 1003 times its default 0.314: "
                                                "millimetres?\n")


@pytest.mark.parametrize("words", [
    ("--set", "d=315mm"), ("--set", "d=0.5"), ("crank=60deg",), ("crank=6.5",), ("crank=-12.566",),
])
def test_usual_numbers_are_not_queried(run, words):
    assert run("assemble", "rssr", *words)[2] == "" or "d=0.5" in words


# ---------------------------------------------------------------- names before work


@pytest.mark.parametrize(("words", "says"), [
    (("sweep", *SWEPT, "--output", "rockr_pin"), "did you mean 'rocker_pin'?"),
    (("sweep", *SWEPT, "--trace", "couplr"), "did you mean 'coupler'?"),
    (("sweep", *SWEPT, "--arrow", "coupler.speed"), "no arrow 'coupler.speed'"),
    (("sweep", *SWEPT, "--arrow", "nowhere.reaction"), "no pair 'nowhere'"),
    (("sweep", *SWEPT, "--hold", "rockr_pin"), "did you mean 'rocker_pin'?"),
    (("simulate", "four_bar", "--duration", "1", "--trace", "tip"), "no link, frame or joint"),
    (("report", "four_bar", "--html", "x.html", "--output", "nix"), "no output 'nix'"),
    (("clearance", "four_bar", "--between", "crank", "roker"), "did you mean 'rocker'?"),
    (("workspace", "four_bar", "tip", "crank=0..1"), "no link, frame or joint 'tip'"),
])
def test_names_are_checked_before_work_begins(run, words, says, monkeypatch):
    for verb in ("sweep", "simulate", "workspace"):
        monkeypatch.setattr(sp, verb, lambda *_, **__: pytest.fail("work was done"))
    code, out, err = run(*words)
    assert code == 1 and out == "" and says in err


@pytest.mark.parametrize(("words", "says"), [
    (("sweeep", "rssr"), "no command 'sweeep'; did you mean 'sweep'?"),
    (("rssr",), "no command 'rssr'; --help lists them"),
    (("sweep", "rssr", "crank", "0", "1", "--stopp"), "did you mean '--stop'?"),
    (("sweep", "rssr", "crank", "0", "1", "--xyzzyq"), "no option '--xyzzyq'; --help lists"),
    (("limits", "rssr", "crank", "1"), "than was given before '1'"),
    (("limits", "rssr", "crank", "-1"), "than was given before '-1'"),
    (("list", "rssr"), "than was given before 'rssr'"),
])
def test_words_that_are_none_are_answered_with_the_nearest(run, words, says):
    code, out, err = run(*words)
    assert code == 2 and out == "" and "usage: spatial-pin" in err and says in err


# ---------------------------------------------------------------- limits of joints, clearance


def test_a_sweep_keeps_joint_limits_on_request(run, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    words = ("sweep", path, "pin", "0", "1", "--steps", "11")
    assert run(*words)[0] == 0
    code, _, err = run(*words, "--limits")
    assert code == 1 and "upper limit" in err and "--stop ends the sweep before it" in err
    code, out, _ = run(*words, "--limits", "--stop", "--json", "-")
    found = json.loads(out)
    assert code == 0 and found["columns"]["pin [rad]"][-1] == pytest.approx(0.5, abs=1e-12)
    assert [event["kind"] for event in found["events"]] == ["joint limit"]
    assert run("sweep", path, "pin", "0", "0.4", "--limits")[0] == 0
    for stop in ((), ("--stop",)):
        code, _, err = run("sweep", path, "pin", "0.8", "1", "--limits", *stop)
        assert code == 1 and "from the start" in err and "--stop" not in err


@pytest.mark.parametrize(("words", "limits"), [
    ((), True), (("--limits",), True), (("--no-limits",), False)])
def test_a_page_moved_by_hand_keeps_joint_limits_by_default(
    run, monkeypatch, words, limits
):
    asked = []
    monkeypatch.setattr(sp, "live", lambda *_, **given: asked.append(given) or MagicMock())
    assert run("show", "four_bar", "--live", *words)[0] == 0
    assert asked[0]["limits"] is limits


def test_a_film_ends_at_a_joint_limit_on_request(run, tmp_path, monkeypatch):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    filmed = []
    monkeypatch.setattr(sp, "movie", lambda motion, path, **_: filmed.append(motion) or path)
    words = ("show", path, "pin", "0", "1", "--steps", "11", "--movie", tmp_path / "f.gif")
    assert run(*words)[0] == 0 and len(filmed[0]) == 11
    assert run(*words, "--limits")[0] == 1
    assert run(*words, "--limits", "--stop")[0] == 0 and len(filmed[1]) == 6


@pytest.mark.slow
def test_clearance_of_a_sweep_and_of_one_configuration(run):
    _, out, _ = run("clearance", "delta", "arm_1", "0", "2", "--steps", "9", "--json", "-")
    found = json.loads(out)
    assert found["over"] == "arm_1 [rad]" and len(found["pairs"]) == 39
    expected = sp.clearance(sp.sweep(sp.load("delta"), "arm_1", np.linspace(0, 2, 9)))
    assert found["pairs"][0]["distance"] == expected.least.distance
    _, out, _ = run("clearance", "delta", "--at", "arm_1=0.1", "--between", "rod_1a", "rod_2b",
                    "--csv", "-")
    (row,) = csv.DictReader(io.StringIO(out))
    standing = sp.clearance(sp.assemble(sp.load("delta"), {"arm_1": 0.1}), [("rod_1a", "rod_2b")])
    assert float(row["distance [m]"]) == standing.least.distance and row["touches"] == "False"


@pytest.mark.parametrize(("table", "words"), [
    ("time [s],crank [rad]\n\n0,1\n1,nan\n", "line 4, column 2: 'nan' is no number"),
    ("crank\n0\n-inf\n", "line 3, column 1: '-inf' is no number"),
    ("time [s],krank [rad]\n0,1\n1,2\n", "column 'krank': mechanism 'four_bar': no coordinate or "
     "driver 'krank'; did you mean 'crank'?"),
    ("time,crank\n0,1\n1,2\n\n1,3\n", "line 5: the time 1 s does not rise: 1 s comes before it"),
    ("time\n0\n1\n", "there is no column of a driver"),
])
def test_a_table_that_cannot_be_followed_is_named(run, tmp_path, table, words):
    """With its line, where one is wrong, as it is counted in the file, and its column."""
    path = tmp_path / "values.csv"
    path.write_text(table)
    code, out, err = run("follow", "four_bar", str(path))
    assert (code, out) == (1, "") and err.startswith(f"spatial-pin: {path}: {words}")


def test_states_at_scattered_values_of_a_table(run, tmp_path):
    """In the order of the table; what is out of reach is told, with the nearest that was."""
    path, out_path = tmp_path / "values.csv", tmp_path / "found.csv"
    path.write_text("crank [deg]\n60\n170\n-30\n")
    code, out, _ = run("states", "four_bar", str(path), "--set", "r2=0.25", "--threads", "2",
                       "--csv", str(out_path))
    assert code == 0
    assert "out of reach: 1 of 3 samples" in out
    assert "sample 1: crank = 2.9670" in out
    values = np.genfromtxt(out_path, delimiter=",", names=True, encoding="utf-8")
    assert np.degrees(values["crank_pin_rad"][[0, 2]]) == pytest.approx([60.0, -30.0])
    code, out, _ = run("states", "four_bar", str(path), "--set", "r2=0.25", "--json")
    assert code == 0 and "limit position" in json.loads(out)["unreached"]["1"]


def test_a_table_of_states_that_names_no_driver(run, tmp_path):
    path = tmp_path / "values.csv"
    path.write_text("crnk\n60\n")
    code, _, err = run("states", "four_bar", str(path))
    assert code == 1 and f"{path}: column 'crnk': mechanism 'four_bar': no" in err


def test_a_column_of_targets_that_is_no_frame_is_named(run, tmp_path):
    path = tmp_path / "targets.csv"
    path.write_text("tipp.x,tipp.y,tipp.z\n0,1,1\n1,2,2\n")
    code, _, err = run("reach", "four_bar", "--path", str(path))
    assert code == 1 and f"{path}: column 'tipp.x': mechanism 'four_bar': no" in err
