"""Slips of the pen on the command line: what is written is done, or refused with what is meant."""

from __future__ import annotations

import json

import numpy as np
import pytest


@pytest.mark.parametrize("words", [
    ("--n", "10"), ("--step", "10"), ("--np", "x"), ("--cs", "x"), ("--hol", "springs"),
    ("--js", "x")])
def test_an_abbreviated_option_is_refused_and_writes_nothing(words, run, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    code, out, err = run("sweep", "four_bar", "crank", "0", "1", *words)
    assert (code, out) == (2, "") and f"no option {words[0]!r}; did you mean" in err
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- ranges


@pytest.mark.alike
@pytest.mark.parametrize("words", [
    ("crank", "0", "720deg"), ("crank", "0..720deg"), ("crank=0..720deg",), ("crank=0", "720deg")])
@pytest.mark.parametrize("before", [(), ("--stop",), ("--hold", "springs")])
def test_a_sweep_takes_its_range_however_it_is_written(words, before, run):
    code, out, _ = run("sweep", "four_bar", *before, *words, "--steps", "3", "--csv", "-")
    values = [float(line.split(",")[0]) for line in out.splitlines()[1:]]
    assert code == 0 and values == pytest.approx([0.0, 2.0 * np.pi, 4.0 * np.pi])


@pytest.mark.parametrize("ends", ["-60deg..0.5", "-60deg 0.5", "-.5..-.25", "-.5 -.25", "1 2"])
def test_ranges_have_signs_and_units(ends, run):
    whole = run("sweep", "four_bar", "crank", *ends.replace("..", " ").split(), "--json", "-")
    for words in (("crank", *ends.split()), tuple(f"crank={ends}".split())):
        assert run("sweep", "four_bar", *words, "--json", "-") == whole


@pytest.mark.parametrize("words", [
    ("crank=0..90deg",), ("crank=0", "90deg"), ("crank", "0..90deg"), ("crank", "0", "90deg")])
def test_over_takes_its_range_however_it_is_written(words, run):
    code, out, err = run("transmission", "four_bar", "rocker_pin", "--over", *words, "--steps", "3",
                         "--csv", "-")
    assert code == 0, err
    values = [float(line.split(",")[0]) for line in out.splitlines()[1:]]
    assert values == pytest.approx([0.0, np.pi / 4.0, np.pi / 2.0])


@pytest.mark.parametrize("words", [
    ("crank=0..1",), ("crank=0", "1"), ("crank", "0..1"), ("crank", "0", "1")])
def test_a_workspace_takes_its_ranges_however_they_are_written(words, run):
    code, out, err = run("workspace", "four_bar", "coupler_b", *words, "--points", "3", "--csv",
                         "-")
    assert code == 0, err
    assert [float(line.split(",")[0]) for line in out.splitlines()[1:]] == [0.0, 0.5, 1.0]


@pytest.mark.slow
def test_a_design_takes_bounds_however_they_are_written(run, tmp_path):
    (tmp_path / "path.csv").write_text("crank [deg],rocker_pin [deg]\n0,90\n60,95\n90,100\n")
    told = [run("design", "four_bar", "--goals", tmp_path / "path.csv", *words, "--starts", "1",
                "--json", "-") for words in (
                    ("r3=0.2..0.4", "r4=0.2..0.3"), ("r3=0.2", "0.4", "r4", "0.2..0.3"))]
    assert told[0] == told[1] and told[0][0] == 0


def test_a_value_is_no_range(run):
    code, out, _ = run("clearance", "four_bar", "--at", "crank=0.3", "--json")
    assert code == 0 and json.loads(out)["mechanism"] == "four_bar"
    code, _, err = run("sweep", "four_bar", "crank", "0..1..2")
    assert code == 2 and "0..1..2" in err


# ---------------------------------------------------------------- the screen


@pytest.mark.alike
@pytest.mark.parametrize("words", [
    ("assemble", "four_bar", "crank=1", "--json"), ("assemble", "four_bar", "--json", "crank=1"),
    ("list", "--json"), ("info", "four_bar", "--json"), ("limits", "four_bar", "crank", "--json"),
    ("check", "four_bar", "--json"), ("sweep", "four_bar", "crank", "0", "1", "--json"),
    ("modes", "four_bar", "crank=1", "--json"), ("statics", "four_bar", "--json", "crank=1"),
    ("sensitivity", "four_bar", "rocker_pin", "--json", "--to", "r2")])
def test_json_alone_is_for_the_screen(words, run, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(*words)
    assert code == 0, err
    assert json.loads(out) and not list(tmp_path.iterdir())
    k = words.index("--json") + 1
    assert run(*words[:k], "-", *words[k:])[1] == out


def test_a_table_alone_is_for_the_screen_too(run):
    told = run("limits", "four_bar", "crank", "--csv")
    assert told[0] == 0 and told == run("limits", "four_bar", "crank", "--csv", "-")
    code, _, err = run("limits", "four_bar", "crank", "--csv", "--json")
    assert code == 2 and "standard output holds one" in err


def test_json_behind_which_a_file_is_named_is_written_there(run, tmp_path):
    code, out, _ = run("assemble", "four_bar", "--json", tmp_path / "x.json", "crank=1")
    assert code == 0 and json.loads((tmp_path / "x.json").read_text())["mechanism"] == "four_bar"
    assert "wrote" in out


# ---------------------------------------------------------------- units


@pytest.mark.parametrize(("output", "unit"), [
    ("rocker_pin", "rad/m or rad/rad"), ("coupler_b.position", "m/m or m/rad"),
    pytest.param("crank.effort", "(N·m)/m or (N·m)/rad", marks=pytest.mark.slow),
    ("rocker_pin.ratio", "1/m or 1/rad")])
def test_derivatives_have_units(output, unit, run):
    words = ("sensitivity", "four_bar", output, "crank=60deg", "--speed", "crank=1")
    code, out, _ = run(*words)
    lines = [line for line in out.splitlines() if line.startswith("  d/d")]
    assert code == 0 and len(lines) == 4 and all(line.endswith(f") [{unit}]") for line in lines)
    assert json.loads(run(*words, "--json")[1])["derivative_unit"] == unit
    head, *rows = run(*words, "--csv")[1].splitlines()
    assert head.endswith(",unit") and all(row.endswith(f",{unit}") for row in rows)


def test_derivatives_along_a_sweep_have_units(run):
    code, out, _ = run("sensitivity", "four_bar", "rocker_pin", "--over", "crank=0..1", "--steps",
                       "3")
    lines = [line for line in out.splitlines() if line.startswith("  d/d")]
    assert code == 0 and lines and all("[rad/m or rad/rad]" in line for line in lines)
