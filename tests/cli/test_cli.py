"""The command line: what it prints, what it writes, how it fails."""

from __future__ import annotations

import csv
import inspect
import json
import os
import subprocess
import sys
import warnings

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin import operators

RPM_240 = 8 * np.pi


@pytest.fixture(autouse=True)
def warnings_as_python_shows_them(monkeypatch):
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)


@pytest.fixture
def printed(run):
    """Run a command that succeeds without a word on stderr; returns what it prints."""

    def printed(*words: object) -> str:
        code, out, err = run(*words)
        assert (code, err) == (0, "")
        return out

    return printed


@pytest.fixture
def fail(run):
    """Run a command that fails; returns its exit code and what it says on stderr."""

    def fail(*words: object) -> tuple[int, str]:
        code, _, err = run(*words)
        return code, err

    return fail


def pure(text: str):
    """Content of JSON text that every reader accepts: no NaN, nothing around it."""

    def refuse(name: str):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


# ---------------------------------------------------------------- list, info, check


def test_list_names_every_mechanism_of_the_library(printed):
    names = sp.list_mechanisms()
    mechanisms, formulas = printed("list").split("\n\n")
    assert [line.split()[0] for line in mechanisms.splitlines()] == names
    for line in formulas.splitlines()[1:]:
        assert inspect.ismodule(getattr(operators, line.split()[0]))
    rows = pure(printed("list", "--json", "-"))
    assert [row["name"] for row in rows] == names
    assert rows[names.index("rssr")]["title"] == "RSSR spatial four-bar"


def test_info_says_what_a_mechanism_consists_of(printed):
    text = printed("info", "rssr")
    for word in ("rssr: RSSR spatial four-bar", "ball_b", "coupler_b - rocker_b", "ball_a.z",
                 "rocker_pin", "prescribes crank_pin", "no spin of 'coupler'"):
        assert word in text
    content = pure(printed("info", "rssr", "--json", "-"))
    assert content["joints"] == {"crank_pin": "revolute", "ball_a": "spherical",
                                 "rocker_pin": "revolute"}
    assert content["coordinates"]["rocker_pin"] == "rad"
    mobility = content["mobility"]
    assert (mobility["rank"], mobility["instantaneous"], mobility["kutzbach"]) == (3, 2, 2)
    assert "coupler" in " ".join(mobility["passive"])
    assert content["closure_error"] < 1e-12


def test_info_of_what_does_not_close_says_so_and_is_no_failure(printed):
    assert "does not close" in printed("info", "rssr", "--set", "d=5")
    content = pure(printed("info", "rssr", "--set", "d=5", "--json", "-"))
    assert content["mobility"] is None and content["closure_error"] > 0.1


def test_check_of_good_and_bad_files(printed, fail, tmp_path):
    text = printed("check", "four_bar")
    assert "four_bar.toml: good" in text
    bad = tmp_path / "bad.toml"
    bad.write_text('name = "bad"\ntree = "bad.urdf"\ntitel = "x"\n')
    (tmp_path / "bad.urdf").write_text('<robot name="bad"><link name="base"/></robot>')
    code, err = fail("check", bad)
    assert code == 1 and "bad.toml: titel" in err and "did you mean 'title'?" in err


# ---------------------------------------------------------------- assemble


@pytest.mark.parametrize(("words", "degrees"), [
    (("crank=60deg",), 88.4246436),
    (("crank=60deg", "--set", "d=315mm"), 88.65583201),
    (("crank=0", "--set", "d=0.315"), 70.97299137),
])
def test_assemble_gives_the_printed_rocker_angle(printed, words, degrees):
    """EMT 2431, Example 7.3."""
    assert "rocker_pin" in printed("assemble", "rssr", *words)
    content = pure(printed("assemble", "rssr", *words, "--json", "-"))
    assert np.degrees(content["coordinates"]["rocker_pin"]) == pytest.approx(degrees, abs=6e-8)
    assert content["closure_error"] < 1e-12


def test_assemble_goes_to_the_branch_of_the_guess(printed, tmp_path):
    path = tmp_path / "state.json"
    for guess, sign in (("1.8rad", 1), ("-100deg", -1)):
        text = printed("assemble", "four_bar", "crank=0", "--guess", f"rocker_pin={guess}",
                       "--json", path)
        assert "closed to" in text
        rocker = pure(path.read_text())["coordinates"]["rocker_pin"]
        assert rocker == pytest.approx(sign * np.arccos(-0.2), abs=1e-12)  # links 200, 280, 240 mm


# ---------------------------------------------------------------- sweep


def test_a_sweep_is_written_in_every_form_that_is_requested(printed, tmp_path):
    files = {kind: tmp_path / f"turn.{kind}" for kind in ("csv", "json", "npz", "png", "html")}
    text = printed("sweep", "four_bar", "crank", "0", "360deg", "--steps", "13", "--speed",
                   "240rpm", "--csv", files["csv"], "--json", files["json"], "--npz", files["npz"],
                   "--plot", files["png"], "--html", files["html"])
    assert "13 samples" in text and "closure error at most" in text
    for path in files.values():
        assert str(path) in text
    expected = sp.sweep(sp.load("four_bar"), "crank", np.linspace(0, 2 * np.pi, 13), RPM_240)
    rocker = expected.coordinate("rocker_pin")
    with files["csv"].open(newline="", encoding="utf-8") as file:
        table = {row[0]: np.array(row[1:], float) for row in zip(*csv.reader(file), strict=True)}
    assert table["rocker_pin [rad]"].tolist() == rocker.value.tolist()
    assert table["rocker_pin rate [rad/s]"].tolist() == rocker.rate.tolist()
    assert set(table["crank_pin rate [rad/s]"]) == {RPM_240}
    np.testing.assert_allclose(table["time [s]"], np.linspace(0, 0.25, 13), rtol=0, atol=1e-15)
    columns = pure(files["json"].read_text())["columns"]
    assert {name: values.tolist() for name, values in table.items()} == columns
    assert sp.Motion.load(files["npz"], expected.mechanism).q.tolist() == expected.q.tolist()
    assert files["png"].read_bytes().startswith(b"\x89PNG")
    page = files["html"].read_text(encoding="utf-8")
    assert page.lower().startswith("<!doctype html>") and expected.mechanism.title in page


@pytest.mark.parametrize(("words", "first", "last", "rate"), [
    (("0", "360deg"), 0.0, 2 * np.pi, None),
    (("-60deg", "60deg"), -np.pi / 3, np.pi / 3, None),
    (("1turn", "0"), 2 * np.pi, 0.0, None),
    (("-1e-1", "-.3"), -0.1, -0.3, None),
    (("0", "1", "--speed", "-90deg/s"), 0.0, 1.0, -np.pi / 2),
    (("0", "1", "--speed=-60rpm", "--acceleration", "2"), 0.0, 1.0, -2 * np.pi),
])
def test_a_sweep_runs_between_quantities_of_either_sign(printed, words, first, last, rate):
    text = printed("sweep", "four_bar", "crank", *words, "--steps", 3, "--json", "-")
    columns = pure(text)["columns"]
    assert columns["crank_pin [rad]"] == pytest.approx([first, (first + last) / 2, last], abs=1e-15)
    per, rate = ("rad", 1.0) if rate is None else ("s", rate)  # no speed: by the driver itself
    assert columns[f"crank_pin rate [rad/{per}]"] == pytest.approx([rate] * 3, rel=1e-15)
    assert "time [s]" not in columns or per == "s"


def test_a_sweep_of_the_default_length_has_a_row_per_degree(printed):
    columns = pure(printed("sweep", "rssr", "crank", "0", "360deg", "--json", "-"))["columns"]
    degrees = np.degrees(columns["crank [rad]"])
    np.testing.assert_allclose(degrees, np.arange(361), rtol=0, atol=1e-12)


def test_a_sweep_past_a_limit_fails_unless_it_may_stop_there(printed, fail):
    words = "sweep", "rssr", "rocker_pin", "1.5", "3", "--steps", "31"
    code, err = fail(*words)
    assert code == 1 and "rocker_pin" in err
    content = pure(printed(*words, "--stop", "--json", "-"))
    (event,) = content["events"]
    reached = content["columns"]["rocker_pin [rad]"]
    assert event["kind"] == "limit" and reached[-1] <= event["value"] < 3


# ---------------------------------------------------------------- export


@pytest.mark.parametrize(("mechanism", "settings", "parameters"), [
    ("rssr", (), {}), ("rssr", ("--set", "d=315mm"), {"d": 0.315}),
    ("four_bar", (), {}), ("four_bar", ("--set", "r1=32cm"), {"r1": 0.32}),
])
def test_what_is_exported_loads_as_the_same_mechanism(
        printed, tmp_path, mechanism, settings, parameters):
    text = printed("export", mechanism, *settings, "--urdf", tmp_path / "out.urdf")
    assert str(tmp_path / "out.urdf") in text and str(tmp_path / "out.toml") in text
    original, copy = sp.load(mechanism, **parameters), sp.load(tmp_path / "out.toml")
    assert copy.coordinates == original.coordinates
    for attribute in ("name", "title", "source", "drivers", "springs", "passives", "guess"):
        assert getattr(copy, attribute) == getattr(original, attribute)
    states = [sp.solve_rates(m, sp.assemble(m, {"crank": 1.0}), {"crank": RPM_240}, {"crank": 3.0})
              for m in (original, copy)]
    for values, expected in zip(*((s.q, s.v, s.a) for s in states), strict=True):
        np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
    shapes = [m.visual_model.geometryObjects for m in (original, copy)]
    assert [s.name for s in shapes[0]] == [s.name for s in shapes[1]]


def test_an_exported_tree_still_finds_its_meshes(printed, tmp_path):
    (tmp_path / "part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="base"><visual><geometry><mesh filename="part.obj"/>'
        "</geometry></visual></link></robot>")
    (tmp_path / "copies").mkdir()
    printed("export", tmp_path / "arm.urdf", "--urdf", tmp_path / "copies" / "arm.urdf")
    assert len(sp.load(tmp_path / "copies" / "arm.urdf").visual_model.geometryObjects) == 1


@pytest.mark.parametrize("target", ["arm.urdf.xacro", "arm.toml", "other.toml", "gone/arm.urdf"])
def test_export_overwrites_no_source_and_writes_no_half(fail, tmp_path, target):
    xacro = '<robot name="arm"><link name="base"/></robot>'
    toml = 'name = "arm"\ntree = "arm.urdf.xacro"\n'
    (tmp_path / "arm.urdf.xacro").write_text(xacro)
    (tmp_path / "arm.toml").write_text(toml)
    code, err = fail("export", tmp_path / "arm.toml", "--urdf", tmp_path / target)
    assert code == 1 and target.rpartition("/")[2] in err
    assert (tmp_path / "arm.urdf.xacro").read_text() == xacro
    assert (tmp_path / "arm.toml").read_text() == toml
    assert {p.name for p in tmp_path.iterdir()} == {"arm.urdf.xacro", "arm.toml"}


# ---------------------------------------------------------------- failures


@pytest.mark.parametrize(("words", "says"), [
    (("info", "rsrr"), "did you mean 'rssr'?"),
    (("info", "gone.toml"), "gone.toml: no such file"),
    (("check", "gone.urdf"), "gone.urdf: no such file"),
    (("info", "rssr", "--set", "dd=1"), "did you mean 'd'?"),
    (("assemble", "rssr", "crankk=1"), "did you mean 'crank'?"),
    (("limits", "rssr", "ball_a.x"), "spherical"),
    (("assemble", "rssr", "--set", "d=5"), "closure 'ball_b' stays open by"),
    (("assemble", "rssr", "--guess", "rocker_pim=1"), "did you mean 'rocker_pin'?"),
    (("check", "rssr", "--set", "d=5"), "closure 'ball_b' stays open by"),
    (("sweep", "rssr", "krank", "0", "1"), "did you mean 'crank'?"),
    (("sweep", "rssr", "rocker_pin", "0", "1"), "cannot be closed"),
    (("sweep", "rssr", "crank", "0", "1", "--steps", "3", "--csv", "gone/x.csv"), "gone/x.csv"),
    (("sweep", "rssr", "crank", "0", "1", "--steps", "3", "--npz", "gone/x.npz"), "gone/x.npz"),
    (("sweep", "rssr", "crank", "0", "1", "--steps", "3", "--plot", "gone/x.png"), "gone/x.png"),
    (("sweep", "rssr", "crank", "0", "1", "--steps", "3", "--html", "gone/x.html"), "gone/x.html"),
    (("sweep", "rssr", "crank", "0", "1", "--steps", "3", "--json", "gone/x.json"), "gone/x.json"),
    (("sweep", "rssr", "crank", "0", "1", "--steps", "3", "--plot", "x.foo"), "foo"),
    (("sweep", "rssr", "crank", "0", "1", "--steps", "3", "--plot", "x.png", "--output", "rocker"),
     "rocker"),
    (("export", "rssr", "--urdf", "gone/x.urdf"), "gone/x.urdf"),
])
def test_an_error_is_one_paragraph_on_stderr(fail, tmp_path, monkeypatch, words, says):
    monkeypatch.chdir(tmp_path)
    code, err = fail(*words)
    assert code == 1
    assert err.startswith("spatial-pin: ") and err.count("\n") == 1
    assert says in err and "Traceback" not in err


@pytest.mark.parametrize("words", [
    (), ("bogus",), ("info",), ("info", "rssr", "--bogus"), ("assemble", "rssr", "crank"),
    ("assemble", "rssr", "crank=sixty"), ("assemble", "rssr", "crank=nan"),
    ("assemble", "rssr", "crank=60degrees"), ("sweep", "rssr", "crank"), ("export", "rssr"),
    ("sweep", "rssr", "crank", "0", "inf"), ("sweep", "rssr", "crank", "0", "1", "--steps", "many"),
    ("sweep", "rssr", "crank", "0", "1", "--steps", "0"),
    ("assemble", "rssr", "crank=1", "crank=2"),
    ("simulate", "four_bar", "--duration", "-1"), ("simulate", "four_bar", "--duration", "0"),
    ("simulate", "four_bar", "--duration", "nan"),
    ("tradeoff", "four_bar", "--hold", "knee"),
    ("tradeoff", "four_bar", "--simulate", "-1"), ("tradeoff", "four_bar", "--simulate", "0"),
    ("workspace", "four_bar", "coupler_b", "crank=0..1", "--clearance", "-1mm"),
    ("workspace", "four_bar", "coupler_b", "crank=1..0"),
    ("tolerance", "rssr", "rocker_pin", "--deviation", "b=-1mm"),
])
def test_wrong_usage_is_exit_code_2_and_says_how(fail, words):
    code, err = fail(*words)
    assert code == 2
    assert "usage: spatial-pin" in err and "Traceback" not in err


@pytest.mark.parametrize("words", [
    ("assemble", "rssr", "--set", "d=315mm", "crank=60deg"),
    ("assemble", "--set", "d=315mm", "rssr", "crank=60deg"),
])
def test_options_stand_anywhere_between_the_words_of_a_command(printed, words):
    assert printed(*words) == printed("assemble", "rssr", "crank=60deg", "--set", "d=315mm")


def test_no_time_of_a_sweep_backwards_is_minus_zero(printed):
    rows = printed("sweep", "rssr", "crank", "1", "0", "--steps", "3", "--speed", "-1",
                   "--csv", "-").splitlines()
    at = rows[0].split(",").index("time [s]")
    assert [row.split(",")[at] for row in rows[1:]] == ["0.0", "0.5", "1.0"]


def test_a_full_disk_is_reported_as_such(fail):
    code, err = fail("assemble", "rssr", "--json", "/dev/full")
    assert code == 1 and err == "spatial-pin: /dev/full: No space left on device\n"


def test_a_tree_without_drivers_falls_from_rest(printed, tmp_path):
    (tmp_path / "rod.urdf").write_text(
        '<robot name="rod"><link name="ground"/><link name="rod"><inertial><mass value="1"/>'
        '<origin xyz="1 0 0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
        '</inertial></link><joint name="pin" type="continuous"><parent link="ground"/>'
        '<child link="rod"/><axis xyz="0 1 0"/></joint></robot>', encoding="utf-8")
    shown = printed("simulate", tmp_path / "rod.urdf", "--duration", "1ms", "--rows", "2")
    assert "pin  +0.000000 to +0.000005 rad, rate +0 to +0.00981 rad/s" in shown  # g t, g t^2 / 2


def test_two_values_for_one_coordinate_are_refused(fail):
    code, err = fail("assemble", "rssr", "crank=1", "crank_pin=2")
    assert code == 1 and "crank_pin" in err


@pytest.mark.filterwarnings("default")
def test_a_warning_is_a_line_on_stderr_and_json_stays_pure(run, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text('<robot name="arm"><link name="base"><visual><geometry><mesh '
                    'filename="gone.stl"/></geometry></visual></link></robot>')
    code, out, err = run("info", path, "--json", "-")
    assert code == 0
    assert pure(out)["links"] == ["base"]
    assert err.startswith("spatial-pin: warning: ") and "gone.stl" in err and err.count("\n") == 1


@pytest.mark.parametrize("words", [["info", "rssr"], ["sweep", "rssr", "crank", "0", "1"]])
def test_a_reader_that_closes_early_is_no_error_and_files_are_written(
        words, run, monkeypatch, tmp_path):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w", encoding="utf-8", buffering=1) as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        code, _, err = run(*words, "--json", tmp_path / "told.json")
    assert (code, err) == (0, "") and (tmp_path / "told.json").stat().st_size


def test_the_version_is_printed(printed):
    assert sp.__version__ in printed("--version")


# ---------------------------------------------------------------- units


def test_a_simulation_is_reported_and_written(printed, tmp_path):
    text = printed("simulate", "four_bar", "--duration", "500ms", "--rows", "51", "--at",
                   "crank=60deg", "--speed", "crank=30rpm", "--csv", str(tmp_path / "f.csv"))
    assert "51 samples, time 0 to 0.5 s" in text
    assert "energy drift" in text
    rows = list(csv.DictReader((tmp_path / "f.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 51
    assert float(rows[0]["crank_pin [rad]"]) == pytest.approx(np.pi / 3)
    assert float(rows[0]["crank_pin rate [rad/s]"]) == pytest.approx(np.pi)


def test_a_pushed_crank_gains_what_the_effort_works(printed, tmp_path):
    path = tmp_path / "s.json"
    printed("simulate", "rssr", "--duration", "0.2", "--rows", "21", "--effort", "crank=2Nm",
            "--json", str(path), "--accuracy", "draft")
    columns = json.loads(path.read_text(encoding="utf-8"))["columns"]
    assert columns["crank_pin rate [rad/s]"][-1] != 0.0
    assert columns["time [s]"][-1] == 0.2


@pytest.mark.parametrize("words", [
    ["simulate", "four_bar", "--duration", "1", "--at", "crank=2s"],
    ["assemble", "rssr", "crank=5N"],
])
def test_seconds_and_newtons_are_no_angles(words, fail):
    code, err = fail(*words)
    assert code == 1 and "is in rad, not in" in err


@pytest.mark.parametrize(("words", "message"), [
    (["--duration", "5mm"], "duration is in s or ms, not in mm"),
    (["--duration", "1s", "--effort", "crank=5deg"], "is in Nm or N·m, not in deg"),
    (["--duration", "1s", "--speed", "crank=3N"], "crank is in rad/s, not in N"),
])
def test_durations_efforts_and_speeds_are_requested_in_their_units(words, message, fail):
    code, err = fail("simulate", "four_bar", *words)
    assert code == 1 and message in err


@pytest.mark.parametrize(("option", "name", "says"), [
    ("--plot", "turn.foo", "turn.foo: its suffix is the format of a figure: .png, .svg, .pdf"),
    ("--plot", "turn", "turn: its suffix is the format"),
    ("--csv", "gone/turn.csv", "there is no folder"),
    ("--html", ".", "this is a folder; give the name of a file"),
    ("--npz", "locked/turn.npz", "not allowed to write there"),
    ("--json", "locked/there.json", "not allowed to write there"),
])
def test_a_file_that_cannot_be_written_is_refused_before_the_work(
    option, name, says, fail, tmp_path, monkeypatch
):
    (tmp_path / "locked").mkdir()
    (tmp_path / "locked" / "there.json").write_text("kept", encoding="utf-8")
    allowed = os.access  # whoever runs this may be allowed everything
    monkeypatch.setattr(
        os, "access", lambda path, mode: "locked" not in str(path) and allowed(path, mode))
    monkeypatch.setattr(sp, "sweep", lambda *_, **__: pytest.fail("work was done"))
    code, err = fail("sweep", "four_bar", "crank", "0", "1", option, tmp_path / name)
    assert code == 1 and err.startswith(f"spatial-pin: {option} ") and says in err
    assert (tmp_path / "locked" / "there.json").read_text(encoding="utf-8") == "kept"


def test_the_package_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "spatial_pin", "--version"], capture_output=True,
                          text=True, check=True)
    assert done.stdout == f"spatial-pin {sp.__version__}\n" and not done.stderr


def test_info_names_curves_followers_and_teeth(run, tmp_path):
    joints = "".join(
        f'<link name="l_{name}"/><joint name="{name}" type="continuous"><parent link="ground"/>'
        f'<child link="l_{name}"/><origin xyz="{x} 0 0"/><axis xyz="0 0 1"/></joint>'
        for name, x in (("cam", 0.0), ("rocker", 0.1), ("wheel", -0.07)))
    (tmp_path / "parts.urdf").write_text(
        f'<robot name="parts"><link name="ground"/>{joints}</robot>', encoding="utf-8")
    (tmp_path / "parts.toml").write_text('''name = "parts"
tree = "parts.urdf"
[[closures]]
name = "contact"
type = "cam"
curve = "profile"
frames = ["l_cam", "l_rocker"]
follower = {flat = [0, 1, 0]}
[curves.profile]
circle = {radius = 0.03, centre = [0.01, 0, 0]}
[[closures]]
name = "mesh"
type = "coupling"
joints = ["cam", "wheel"]
ratio = -0.4
[closures.teeth]
point = [-0.02, 0, 0]
''', encoding="utf-8")
    code, out, _ = run("info", str(tmp_path / "parts.toml"))
    assert code == 0
    assert "cam: l_cam - l_rocker, on circle profile, flat (1 equation)" in out
    assert "coupling: wheel = -0.4 * cam, with teeth (1 equation)" in out
