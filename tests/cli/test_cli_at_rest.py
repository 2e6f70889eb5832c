"""Commands of poses at rest answer as the functions do, and refuse in their own words."""

from __future__ import annotations

import json

import numpy as np
import pytest

import spatial_pin as sp


@pytest.fixture
def found(run):
    """Run a command; return what it writes as JSON."""

    def found(*words: object):
        code, out, err = run(*words, "--json")
        assert (code, err) == (0, "")
        return json.loads(out)

    return found


def test_a_pose_at_rest_is_that_of_the_library(found):
    pose, wanted = found("equilibrium", "rssr"), sp.equilibrium(sp.load("rssr"))
    assert pose["stable"] is True and pose["independent"] == ["crank"]
    assert pose["stiffness"] == pytest.approx(wanted.stiffness)
    assert pose["energy"] == pytest.approx(wanted.energy) and len(pose["passive"]) == 1
    assert pose["coordinates"]["rocker_pin"] == pytest.approx(
        wanted.state.coordinate("rocker_pin").value)
    assert pose["reactions"]["ball_a"][:3] == pytest.approx(
        wanted.reactions["ball_a"].linear, abs=1e-9)


def test_what_is_held_stands_where_it_is_put_and_has_an_effort(found):
    pose = found("equilibrium", "four_bar", "crank=60deg", "--hold", "crank")
    wanted = found("statics", "four_bar", "crank=60deg")
    assert pose["coordinates"] == pytest.approx(wanted["coordinates"])
    assert pose["efforts"] == pytest.approx(wanted["efforts"]) and pose["independent"] == []


def test_loads_and_efforts_move_the_pose(found):
    alone = found("equilibrium", "four_bar")["coordinates"]["crank_pin"]
    mechanism = sp.load("four_bar")
    by_effort = found("equilibrium", "four_bar", "--effort", "crank=0.5Nm")
    wanted = sp.equilibrium(mechanism, efforts={"crank": 0.5}).state.coordinate("crank").value
    assert by_effort["coordinates"]["crank_pin"] == pytest.approx(wanted) != alone
    by_load = found("equilibrium", "four_bar", "--load", "coupler_b=2N,0,0")
    assert by_load["coordinates"]["crank_pin"] != pytest.approx(alone)


def test_all_poses_and_the_nearest_of_any_kind(found, run):
    poses = found("equilibrium", "four_bar", "--all", "--starts", "20")
    assert [pose["stable"] for pose in poses["poses"]] == [True, False, True, False]
    assert sum(pose["reached"] for pose in poses["poses"]) == poses["reached"] <= 20
    nearest = found("equilibrium", "four_bar", "crank=1.4", "--nearest")
    assert nearest["stable"] is False
    code, out, _ = run("equilibrium", "four_bar", "--all", "--starts", "20", "--csv")
    assert code == 0 and out.splitlines()[0].endswith("energy [J],kind,reached")
    again = run("equilibrium", "four_bar", "--all", "--starts", "20", "--csv", "--workers", "2")
    assert again[1] == out


def test_small_motions_are_those_of_the_library_and_play(found, run, tmp_path):
    words = ("linearize", "four_bar", "--output", "rocker_pin", "--input", "crank")
    small, mechanism = found(*words), sp.load("four_bar")
    wanted = sp.linearize(mechanism, sp.equilibrium(mechanism).state, outputs=["rocker_pin"])
    assert small["frequencies"] == pytest.approx(wanted.frequencies)
    assert small["c"] == pytest.approx(wanted.state_space()[2])
    assert np.array(small["eigenvalues"]) @ [1, 1j] == pytest.approx(wanted.eigenvalues)
    path = tmp_path / "ringing.html"
    code, out, _ = run("linearize", "four_bar", "--html", path)
    assert code == 0 and f"wrote {path}" in out and path.stat().st_size > 1000
    code, _, err = run("linearize", "four_bar", "--shape", "3", "--html", path)
    assert code == 1 and "there is no vibration 3" in err


def test_compliance_is_that_of_the_library(found):
    soft, mechanism = found("compliance", "four_bar", "coupler"), sp.load("four_bar")
    wanted = sp.compliance(mechanism, sp.equilibrium(mechanism).state, "coupler")
    np.testing.assert_allclose(soft["matrix"], wanted, atol=1e-15)


@pytest.mark.parametrize(("words", "code", "told"), [
    (("equilibrium", "screw_press"), 1, "hold it (--hold screw), or give it a spring"),
    (("equilibrium", "four_bar", "--hold", "krank"), 1, "did you mean 'crank'?"),
    (("equilibrium", "four_bar", "--effort", "crank=3deg"), 1, "in Nm or N·m, not in deg"),
    (("equilibrium", "four_bar", "--speed", "crank=3mm/s"), 1, "rad/s, not in mm/s"),
    (("equilibrium", "four_bar", "--load", "coupler=1,2"), 2, "a force has 3 numbers"),
    (("equilibrium", "four_bar", "--all", "--starts", "0"), 2, "a whole number of at least 1"),
    (("linearize", "four_bar", "--output", "rocker"), 1, "did you mean 'rocker_pin'?"),
    (("compliance", "four_bar", "copler"), 1, "did you mean 'coupler'?"),
    (("compliance", "crane", "tip"), 1, "nothing drives 'tip' back"),
])
def test_mistakes_are_reported(run, words, code, told):
    got, out, err = run(*words)
    assert (got, out) == (code, "") and told in err


def test_a_free_base_is_held_by_an_option(run, tmp_path):
    (tmp_path / "body.urdf").write_text(
        '<robot name="body"><link name="hull"><inertial><mass value="2"/><inertia ixx="1" iyy="1" '
        'izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>')
    code, _, err = run("equilibrium", tmp_path / "body.urdf", "--free-flyer")
    assert code == 1 and "hold it (--hold root_joint), or hang it on springs" in err
    words = ("--free-flyer", "--hold", "root_joint")
    code, out, _ = run("equilibrium", tmp_path / "body.urdf", *words)
    assert code == 0 and "stable at rest" in out
