"""Remedies on the command line are its own words, on any terminal; nothing found is lost."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from folders import DATA

import spatial_pin as sp
from spatial_pin.cli import main
from spatial_pin.cli.parser import parser
from spatial_pin.cli.remedies import in_options

PACKAGE = Path(sp.__file__).parent
GRIPPER = DATA / "mjcf" / "robotiq_2f85" / "2f85.xml"
# An argument with a value, or a call of something of the library, as Python has them.
PYTHON = re.compile(r"""\b[a-z_]+=(\[|\{|'|True|False|None|\d|\.\.\.)|\b[A-Za-z_.]+\(\.\.\."""
                    r"""|\bsp\.[a-z]\w+|\bspatial_pin\.[a-z]\w+\(|\bAccuracy\(""")
# What only callers can bring about: a folder or module, and a part of the sentence.
OF_CALLERS = (
    ("checks.py", ""), ("lazy.py", ""), ("__init__.py", ""), ("settings.py", "tradeoff("),
    ("columns.py", "pip install"), ("state.py", "a State is needed"),
    ("motion.py", "a Motion is needed"), ("coordinates.py", "a Mechanism is needed"),
    ("film.py", ""), ("clearances.py", "another motion"), ("workspaces.py", "another one"),
    ("joints.py", "sp.closures"), ("closures.py", "sp.closures"), ("export.py", "from_model"),
    ("tolerance.py", "to make a table of"), ("sweep.py", "speed=0.0 at rest"),
    ("outputs.py", "a motion by itself has no forces"), ("influence.py", "the whole mechanism"),
    ("influence.py", "dynamics=True"), ("reduce.py", "lump=True"), ("design.py", "goals"),
    ("stepping.py", "explicit integrator"), ("integrators.py", "needs a step"),
    ("simulate.py", "take a longer step"), ("jerks.py", "j="), ("forward.py", "a="),
    ("coordinates.py", "CoordinateRates"), ("picture.py", ""), ("devtools.py", ""),
    ("model.py", "canonical_link="),  # an attribute of SDFormat
)


def sentences():
    """Every text of the package that is no docstring, with a word for each value in it."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if PACKAGE / "cli" in path.parents:
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)
                 for part in node.values}
        parts |= {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if id(node) in parts:
                continue
            if isinstance(node, ast.JoinedStr):
                yield path.name, "".join(x.value if isinstance(x, ast.Constant) else word(x)
                                         for x in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield path.name, node.value


def word(part: ast.FormattedValue) -> str:
    return {"rates": "'a': 0.0", "named": "'a': FOLDER"}.get(
        ast.unparse(part.value), "['base', 'a']")


def test_no_sentence_tells_the_command_line_of_arguments_of_python():
    commands = parser().parse_args(["list"]).parsers.values()
    found = []
    for name, text in sentences():
        if " " in text and "<" not in text and PYTHON.search(text) and not any(
                name == file and part in text for file, part in OF_CALLERS):
            told = {in_options(text, command._option_string_actions) for command in commands}
            found += [x for x in told if PYTHON.search(re.sub(r"--speed \S+", "", x))]
    assert not found


no_meshes = pytest.mark.filterwarnings("ignore:.*mesh files")


def said(capsys, *words: object) -> str:
    assert main([str(word) for word in words]) == 1
    return capsys.readouterr().err


@no_meshes
def test_freedoms_of_an_imported_robot_are_held_by_options(capsys):
    held = said(capsys, "sweep", GRIPPER, "right_driver_joint", 0, 0.2)
    assert "such as --hold right_follower_joint --hold left_follower_joint;" in held
    assert held.endswith("--hold springs stops the joints with springs\n")
    driven = said(capsys, "statics", GRIPPER)
    assert driven.endswith("such as --actuated fingers_actuator --actuated right_follower_joint "
                           "--actuated left_follower_joint\n")
    measured = said(capsys, "tradeoff", GRIPPER, "--repeats", 1)
    assert measured.endswith("--hold springs stops the joints with springs\n")


@no_meshes
@pytest.mark.parametrize("words", [
    ("limits", "right_driver_joint"), ("clearance", "right_driver_joint", 0, 0.1, "--steps", 2),
    ("tradeoff", "right_driver_joint", 0, 0.1, "--steps", 2, "--repeats", 1),
    ("jacobian", "right_pad"), ("sweep", "right_driver_joint", 0, 0.2, "--steps", 3),
], ids=lambda words: words[0])
def test_what_is_told_to_be_held_can_be(words, capsys):
    verb, *rest = map(str, words)
    assert main([verb, str(GRIPPER), *rest, "--hold", "springs"]) == 0
    assert capsys.readouterr().err == ""


def test_warnings_name_the_option():
    (text,) = {in_options(text, ()) for _, text in sentences() if text.endswith("keeps them)")}
    assert text.endswith(" (`spatial-pin assemble --limits` keeps them)")


def run(*words: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([sys.executable, "-m", "spatial_pin", *words], capture_output=True,
                          env={**os.environ, **environment}, timeout=60)


def test_signs_that_a_terminal_lacks_are_written_with_those_it_has():
    done = run("assemble", "four_bar", "crank=60deg", PYTHONIOENCODING="ascii")
    assert done.returncode == 0 and b"(60 deg)" in done.stdout
    done = run("sweep", "four_bar", "crank", "0", "1", "--steps", "2", "--speed", "1",
               PYTHONIOENCODING="ascii")
    assert done.returncode == 0


def test_standard_output_may_be_closed():
    done = subprocess.run(f"exec {sys.executable} -m spatial_pin assemble four_bar >&-",
                          shell=True, capture_output=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, b"")


def test_more_values_than_memory_holds(capsys):
    assert "not enough memory" in said(capsys, "sweep", "four_bar", "crank", 0, 1,
                                       "--steps", 10**15)


@pytest.mark.parametrize("words", [("--npz", "-"), ("--json", ""), ("--html", "-")])
def test_only_data_goes_to_standard_output(words, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["sweep", "four_bar", "crank", "0", "1", *words])
    assert "the name of a file is needed" in capsys.readouterr().err


@pytest.mark.parametrize("words", [("sweep", "four_bar", "crank", 0, 1, "--clearance")])
def test_what_was_followed_before_it_was_interrupted_is_written(words, capsys, monkeypatch):
    part = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.1, 0.2])

    def interrupted(*_, **__):
        raise sp.Interrupted(part)

    monkeypatch.setattr(sp, "sweep", interrupted)
    assert main([*map(str, words)]) == 130
    out, err = capsys.readouterr()
    assert "3 steps" in out and "cut short after 3 steps" in out and err == ""
    assert main([*map(str, words), "--json", "-"]) == 130
    content = json.loads(capsys.readouterr().out)
    assert content["is_whole"] is False and len(content["columns"]["crank [rad]"]) == 3


def test_nothing_found_before_it_was_interrupted_is_said(capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(sp, "assembly_modes", interrupted)
    assert main(["modes", "four_bar"]) == 130
    assert capsys.readouterr().err == "spatial-pin: interrupted before there was a result\n"
