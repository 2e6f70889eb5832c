"""`new` writes mechanism files that load as they are, and whose examples hold."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from closure_trees import CLOSURE_TYPES

import spatial_pin as sp

ARM = """<robot name="arm"><link name="base"/><link name="upper"/><link name="fore"/>
<link name="tip"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="0.2" upper="1.5" effort="1" velocity="9"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/>
<origin xyz="0.3 0 0"/><axis xyz="0 1 0"/></joint>
<joint name="tip_mount" type="fixed"><parent link="fore"/><child link="tip"/>
<origin xyz="0.3 0 0"/></joint></robot>"""


@pytest.fixture
def run(run, tmp_path, monkeypatch):
    """Run a command in an empty folder; returns its exit code and what it prints."""
    monkeypatch.chdir(tmp_path)
    return run


@pytest.fixture
def arm(run) -> Path:
    """The text of a new mechanism file for an arm."""
    Path("trees").mkdir()
    Path("trees/arm.urdf").write_text(ARM)
    code, out, err = run("new", "my_arm", "--from", "trees/arm.urdf")
    assert (code, err) == (0, "") and "wrote my_arm.toml" in out
    return Path("my_arm.toml")


def uncommented(text: str, table: str) -> str:
    """The text with the comment lines of one table, to the next empty one, without their #."""
    lines, on = [], False
    for line in text.splitlines():
        on = (on or line.startswith(f"# {table}")) and line not in ("", "#")
        lines.append(line[2:] if on else line)
    return "\n".join(lines) + "\n"


def test_a_new_mechanism_is_good_and_moves(run):
    code, out, err = run("new", "mine")
    assert (code, err) == (0, "")
    assert out.splitlines()[-1] == "edit mine.toml, then: spatial-pin check mine.toml"
    code, out, err = run("check", "mine.toml")
    assert code == 0 and err == "" and "good" in out and "note" not in out
    mechanism = sp.load("mine.toml", crank=0.12)
    found = sp.limits(mechanism, "crank")
    assert mechanism.dimensions["crank"] == 0.12 and found.full_turn
    assert sp.inverse_dynamics(mechanism, sp.assemble(mechanism)).efforts["crank"] != 0.0


@pytest.mark.parametrize("table", ["[joints.rocker_pin]", "[frames.tip]", "[[springs]]"])
def test_the_examples_in_a_new_mechanism_hold(run, table):
    run("new", "mine")
    path = Path("mine.toml")
    text = uncommented(path.read_text("utf-8"), table)
    assert f"\n{table}" in text
    path.write_text(text, encoding="utf-8")
    assert run("check", path)[0] == 0


def test_a_file_for_a_tree_tells_of_its_joints_and_loads_as_it_is(arm, run):
    text = arm.read_text("utf-8")
    assert 'tree = "trees/arm.urdf"' in text
    assert re.search(r"#   shoulder +revolute +base - upper  \(0.2 to 1.5 rad\)", text)
    code, out, err = run("check", arm)
    assert (code, err) == (0, "") and "good: 4 links, 2 coordinates, 0 closures" in out
    mechanism = sp.load(arm)
    assert list(mechanism.drivers) == ["shoulder"]
    assert 0.2 <= mechanism.guess["shoulder"] <= 1.5


def test_there_is_an_example_of_every_closure_and_it_holds(arm):
    kinds = set(CLOSURE_TYPES) - {"fixed"}  # another word for weld
    text = arm.read_text("utf-8")
    blocks = re.findall(r"(?:^# (?!#).*\n)+", text[text.index("# [[closures]]"):
                                                   text.index("# Drivers")], flags=re.MULTILINE)
    found = set()
    for block in blocks:
        arm.write_text(text + "\n" + re.sub("^# ", "", block, flags=re.MULTILINE), "utf-8")
        (closure,) = sp.load(arm).closures
        found.add(closure.type)
    assert found == kinds


@pytest.mark.parametrize("table", ["[joints.shoulder]", "[frames.tool]", "[[springs]]",
                                   "[drivers.elbow]"])
def test_the_other_examples_hold_too(arm, table):
    arm.write_text(uncommented(arm.read_text("utf-8"), table), encoding="utf-8")
    sp.assemble(sp.load(arm))


def test_from_edit_to_check(arm, run):
    """The arm becomes a slider-crank: its tip slides on a line through the base."""
    text = arm.read_text("utf-8").replace("0.2", "0.5") + (
        '[[closures]]\nname = "slide"\ntype = "point_on_line"\nframes = ["base", "tip"]\n'
        "axis = [1, 0, 0]\nequations = [0]\n")
    arm.write_text(text, encoding="utf-8")
    code, out, _ = run("check", arm)
    assert code == 0 and "1 closure;" in out and "note" not in out


@pytest.mark.parametrize("name", ["four_bar", "rssr", "delta", "stewart", "excavator"])
def test_trees_of_the_library(run, name):
    sp.load(name).save("plain")
    code, _, err = run("new", "mine", "--from", f"plain/{name}.urdf", "--folder", ".")
    assert (code, err) == (0, "")
    assert run("check", "mine.toml")[0] in (0, 1)
    assert sp.load("mine.toml").coordinates


def test_loops_stated_in_the_tree_are_reported_and_kept(run):
    sp.export_mjcf(sp.load("four_bar"), "four.xml")
    pytest.importorskip("mujoco")
    code, _, err = run("new", "mine", "--from", "four.xml")
    assert (code, err) == (0, "")
    assert "stated in the tree already: output_pin" in Path("mine.toml").read_text("utf-8")
    assert run("check", "mine.toml")[0] == 0
    assert len(sp.load("mine.toml").closures) == len(sp.load("four.xml").closures) > 0


@pytest.mark.parametrize(("words", "code", "says"), [
    (("new", "a b"), 2, "is no name"),
    (("new", "arm.toml"), 2, "without .toml"),
    (("new", "arm", "--from", "gone.urdf"), 1, "gone.urdf: no such file"),
    (("new", "arm", "--from", "rssr"), 1, "is a mechanism file, which is loaded as it is"),
    (("new", "arm", "--folder", "nowhere"), 1, "there is no such folder"),
    (("new",), 2, "NAME"),
])
def test_what_cannot_be_written(run, words, code, says):
    got, out, err = run(*words)
    assert got == code and out == "" and says in err and not list(Path().iterdir())


def test_nothing_is_overwritten(run, arm):
    before = arm.read_bytes()
    code, _, err = run("new", "my_arm", "--from", "trees/arm.urdf")
    assert code == 1 and "is there already" in err and arm.read_bytes() == before
    shutil.copy(arm, "other.urdf.xacro")
    assert run("new", "other")[0] == 1 and not Path("other.toml").exists()


def test_the_names_of_the_files_as_json(run):
    code, out, _ = run("new", "mine", "--json", "-")
    assert code == 0 and json.loads(out) == {"wrote": ["mine.toml", "mine.urdf.xacro"]}


def test_a_drawing_to_start_from_is_good_and_can_be_drawn_anew(run):
    code, out, _ = run("new", "mine", "--drawing")
    assert code == 0 and "wrote mine.toml" in out
    code, out, _ = run("check", "mine.toml")
    assert code == 0 and "a loop is cut at joint 'C' (revolute)" in out and "good" in out
    code, out, _ = run("info", "mine.toml")
    assert code == 0 and "dimensions: crank = 0.1, coupler = 0.28, slope = 0.6" in out
    mech = sp.load("mine.toml", crank=0.12)
    assert sp.mobility(mech).dof == 1 and mech.inertias["coupler"].mass > 0.0
    code, _, err = run("new", "other", "--drawing", "--from", "mine.toml")
    assert code == 2 and "a drawing has no tree" in err
