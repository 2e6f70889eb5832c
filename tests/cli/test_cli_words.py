"""Remedies on the command line are its own words, on any terminal; nothing found is lost."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from folders import DATA

import spatial_pin as sp

GRIPPER = DATA / "mjcf" / "robotiq_2f85" / "2f85.xml"
no_meshes = pytest.mark.filterwarnings("ignore:.*mesh files")


@pytest.fixture
def said(run):
    """Run a command that fails; returns what it says on stderr."""

    def said(*words: object) -> str:
        code, _, err = run(*words)
        assert code == 1
        return err

    return said


@no_meshes
def test_freedoms_of_an_imported_robot_are_held_by_options(said):
    held = said("sweep", GRIPPER, "right_driver_joint", 0, 0.2)
    assert "such as --hold right_follower_joint --hold left_follower_joint;" in held
    assert held.endswith("--hold springs stops the joints with springs\n")
    driven = said("statics", GRIPPER)
    assert driven.endswith("such as --actuated fingers_actuator --actuated right_follower_joint "
                           "--actuated left_follower_joint\n")
    measured = said("tradeoff", GRIPPER, "--repeats", 1)
    assert measured.endswith("--hold springs stops the joints with springs\n")


@no_meshes
@pytest.mark.parametrize("words", [
    ("limits", "right_driver_joint"), ("clearance", "right_driver_joint", 0, 0.1, "--steps", 2),
    ("tradeoff", "right_driver_joint", 0, 0.1, "--steps", 2, "--repeats", 1),
    ("jacobian", "right_pad"), ("sweep", "right_driver_joint", 0, 0.2, "--steps", 3),
], ids=lambda words: words[0])
def test_everything_named_in_hold_can_be_held(words, run):
    verb, *rest = words
    code, _, err = run(verb, GRIPPER, *rest, "--hold", "springs")
    assert (code, err) == (0, "")


def process(*words: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([sys.executable, "-m", "spatial_pin", *words], capture_output=True,
                          env={**os.environ, **environment}, timeout=60)


@pytest.mark.slow
def test_signs_that_a_terminal_lacks_are_written_with_those_it_has():
    done = process("assemble", "four_bar", "crank=60deg", PYTHONIOENCODING="ascii")
    assert done.returncode == 0 and b"(60 deg)" in done.stdout
    done = process("sweep", "four_bar", "crank", "0", "1", "--steps", "2", "--speed", "1",
                   PYTHONIOENCODING="ascii")
    assert done.returncode == 0


@pytest.mark.slow
def test_standard_output_may_be_closed():
    done = subprocess.run(f"exec {sys.executable} -m spatial_pin assemble four_bar >&-",
                          shell=True, capture_output=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, b"")


def test_more_values_than_memory_holds(said):
    assert "not enough memory" in said("sweep", "four_bar", "crank", 0, 1, "--steps", 10**15)


@pytest.mark.parametrize("words", [("--npz", "-"), ("--json", ""), ("--html", "-")])
def test_only_data_goes_to_standard_output(words, run):
    code, _, err = run("sweep", "four_bar", "crank", 0, 1, *words)
    assert code == 2 and "the name of a file is needed" in err


@pytest.mark.parametrize("words", [("sweep", "four_bar", "crank", 0, 1, "--clearance")])
def test_what_was_followed_before_it_was_interrupted_is_written(words, run, monkeypatch):
    part = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.1, 0.2])

    def interrupted(*_, **__):
        raise sp.Interrupted(part)

    monkeypatch.setattr(sp, "sweep", interrupted)
    code, out, err = run(*words)
    assert (code, err) == (130, "")
    assert "3 steps" in out and "cut short after 3 steps" in out
    code, out, _ = run(*words, "--json", "-")
    content = json.loads(out)
    assert code == 130
    assert content["is_whole"] is False and len(content["columns"]["crank [rad]"]) == 3


def test_nothing_found_before_it_was_interrupted_is_stated(run, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(sp, "assembly_modes", interrupted)
    code, _, err = run("modes", "four_bar")
    assert (code, err) == (130, "spatial-pin: interrupted before there was a result\n")
