"""The robots of the gallery are found where they lie, and stand with their loops closed."""

import importlib
import sys

import pytest
from folders import ROOT

import spatial_pin as sp

SCRIPTS = ROOT / "scripts"


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(SCRIPTS)
    return importlib.import_module("robots")


def test_robots_are_found_below_the_folders_given(script, tmp_path, monkeypatch, capsys):
    gripper = tmp_path / "menagerie" / "robotiq_2f85"
    gripper.mkdir(parents=True)
    (gripper / "2f85.xml").touch()
    monkeypatch.setattr(sys, "path", [])
    for folder in (tmp_path, tmp_path / "menagerie"):
        ((robot, path),) = script.present([folder])
        assert robot.caption == "Robotiq 2F-85 (MJCF)" and path == (gripper / "2f85.xml").resolve()
    assert "not found: agility_cassie/cassie.xml" in capsys.readouterr().err


def test_solo12_stands_on_four_feet_with_six_freedoms(script):
    solo = [(robot, path) for robot, path in script.present([]) if "Solo12" in robot.caption]
    if not solo:
        pytest.skip("example-robot-data is not installed")
    ((robot, path),) = solo
    state = robot.posed(path)
    assert state.closure_error < 1e-12
    assert sp.mobility(state.mechanism, state).dof == 6
    feet = [state.placement(f"{leg}_FOOT").translation[2] for leg in script.LEGS]
    assert max(feet) - min(feet) < 1e-12
    assert state.placement("base_link").translation[2] - feet[0] > 0.2
