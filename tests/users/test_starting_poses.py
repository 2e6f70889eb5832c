"""Where a verb starts from is its `guess`, in every verb: a State, values by joint, or q."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import spatial_pin as sp

VERBS = ("assemble", "sweep", "follow", "limits", "trace", "reach", "reach_path", "workspace",
         "tolerance", "calibrate", "design", "reduce", "live")
MECH = sp.load("four_bar")
HERE = sp.assemble(MECH, {"crank": 0.7})
STARTS = {"state": HERE, "values": {"crank_pin": 0.7}, "q": HERE.q}
MEASURED = [({"crank": x}, {"rocker_pin": sp.assemble(MECH, {"crank": x}).coordinate(
    "rocker_pin").value}) for x in (0.6, 0.7, 0.8, 0.9)]


def point(state: sp.State) -> np.ndarray:
    return state.placement("coupler_b").translation


def asked(verb: str, **start) -> np.ndarray:
    """Return numbers that a verb answers with from a start."""
    if verb == "reach":
        return sp.reach(MECH, {"rocker_pin": 1.7}, **start).q
    if verb == "reach_path":
        return sp.reach_path(MECH, {"rocker_pin": [1.6, 1.7]}, **start).q
    if verb == "tolerance":
        return np.array(sp.tolerance(MECH, "rocker_pin", {"r2": 1e-4}, **start).linear[
            "rocker_pin"])
    if verb == "sweep":
        return sp.sweep(MECH, "crank", [0.7, 0.8], **start).q
    if verb == "follow":
        return sp.follow(MECH, {"crank": [0.7, 0.8]}, [0.0, 1.0], **start).q
    if verb == "limits":
        return np.array(sp.limits(MECH, "rocker_pin", **start).upper.value)
    return sp.assemble(MECH, {"crank": 0.8}, **start).q


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_that_starts_from_a_pose_calls_it_guess(verb):
    assert "guess" in inspect.signature(getattr(sp, verb)).parameters


@pytest.mark.alike
@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("verb", ["reach", "reach_path", "tolerance", "sweep", "follow", "limits",
                                  "assemble"])
def test_a_guess_is_a_state_values_by_joint_or_a_configuration(verb, start):
    assert asked(verb, guess=STARTS[start]) == pytest.approx(asked(verb, guess=HERE), abs=1e-9)


@pytest.mark.parametrize("verb", ["reach", "reach_path", "tolerance"])
def test_state_is_another_word_for_the_guess(verb):
    for start in STARTS.values():
        assert np.array_equal(asked(verb, state=start), asked(verb, guess=start))
    with pytest.raises(TypeError, match="guess and state are two words"):
        asked(verb, guess=HERE, state=HERE)


def test_the_guess_stands_in_the_same_place_in_order():
    assert np.array_equal(sp.reach(MECH, {"rocker_pin": 1.7}, HERE).q, asked("reach", guess=HERE))
    path = sp.reach_path(MECH, {"rocker_pin": [1.6, 1.7]}, None, HERE)
    assert np.array_equal(path.q, asked("reach_path", guess=HERE))
    found = sp.tolerance(MECH, "rocker_pin", {"r2": 1e-4}, HERE)
    assert found.linear["rocker_pin"] == asked("tolerance", guess=HERE)


def test_the_guess_decides_the_branch_that_is_reached():
    other = sp.assemble(MECH, {"crank": 0.7}, {"rocker_pin": -1.5})
    values = {name: other.coordinate(name).value for name in MECH.coordinates}
    found = [sp.reach(MECH, {"crank": 0.9}, start) for start in (other, values, other.q)]
    for state in found:
        assert state.q == pytest.approx(found[0].q, abs=1e-9)
        assert state.coordinate("rocker_pin").value < 0.0


def test_a_page_starts_from_the_guess():
    with sp.live(MECH, {"crank_pin": 0.7}, open_browser=False) as viewer:
        assert viewer.running
    with sp.live(MECH, state=HERE, open_browser=False) as viewer:
        assert viewer.running
