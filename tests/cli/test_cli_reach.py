"""Words of `reach`: weights, orientations, distances, the centre of mass."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp

POINT = [0.05, 0.02, -0.8]
WORDS = {  # words, and the targets that they mean
    "platform.position=50mm,2cm,-0.8@2": ("platform", sp.targets.position(POINT, 2.0)),
    "platform.orientation=0,0,10deg": (
        "platform", sp.targets.orientation(pin.exp3(np.array([0, 0, np.pi / 18])))),
    "platform.pose=0,0,-1,0,0,90deg@0.5": ("platform", sp.targets.pose(
        pin.SE3(pin.exp3(np.array([0, 0, np.pi / 2])), np.array([0, 0, -1.0])), 0.5)),
    "platform.direction=0,0,2@3": (
        "platform", sp.targets.direction([0.0, 0.0, 1.0], [0.0, 0.0, 1.0], 3.0)),
    "platform.distance=ground,80cm": ("platform", sp.targets.distance("ground", 0.8)),
    "com=_,10mm,-0.3@4": ("com", sp.targets.centre_of_mass(None, 0.01, -0.3, 4.0)),
    "arm_1=90deg@0.1": ("arm_1", sp.targets.coordinate(np.pi / 2, 0.1)),
}


def content(target: sp.Target) -> dict[str, object]:
    found = dict(vars(target))
    if isinstance(found.get("placement"), pin.SE3):
        found["placement"] = found["placement"].homogeneous
    return {key: np.asarray(x).tolist() for key, x in found.items()}


@pytest.mark.parametrize("words", WORDS)
def test_words_are_targets(run, monkeypatch, words):
    found = {}

    def reach(mechanism, targets, *_, **__):
        found.update(targets)
        raise sp.SpatialPinError("enough")

    monkeypatch.setattr(sp, "reach", reach)
    assert run("reach", "delta", words) == (1, "", "spatial-pin: enough\n")
    name, expected = WORDS[words]
    target = found.pop(name)
    (target,) = target if isinstance(target, list) else [target]
    assert not found and type(target) is type(expected)
    assert content(target) == content(expected)


@pytest.fixture
def reached(run):
    def reached(*words: str) -> tuple[sp.Mechanism, np.ndarray]:
        code, out, err = run("reach", *words, "--json", "-")
        assert (code, err) == (0, "")
        return sp.load(words[0]), np.array(json.loads(out)["q"])

    return reached


def test_what_has_a_weight_gives_way_to_what_has_none(reached):
    mechanism, q = reached("delta", "platform.position=50mm,0,-800mm@2", "arm_1=0.3")
    expected = sp.reach(mechanism, {"platform": sp.targets.position([0.05, 0, -0.8], 2.0),
                                    "arm_1": 0.3})
    assert q.tolist() == expected.q.tolist()
    assert expected.coordinate("arm_1").value == pytest.approx(0.3, abs=1e-12)


def test_the_centre_of_mass_and_a_distance_are_where_they_should_be(reached):
    mechanism, q = reached("delta", "com=_,_,-0.3")
    assert pin.centerOfMass(mechanism.model, mechanism.model.createData(), q)[2] == (
        pytest.approx(-0.3, abs=1e-12))
    mechanism, q = reached("excavator", "teeth.distance=ground,8m")
    state = sp.assemble(mechanism, {}, q)
    apart = state.placement("teeth").translation - state.placement("ground").translation
    assert np.linalg.norm(apart) == pytest.approx(8.0, abs=1e-9)


@pytest.mark.parametrize(("word", "code", "says"), [
    ("com=1,2", 2, "3 numbers, _ for any, not 2"),
    ("com=_,_,_", 2, "has no number"),
    ("com=1,2,3deg", 2, "numbers in m"),
    ("platform.distance=base", 2, "a distance is NAME.distance=OTHER,d"),
    ("platform.distance=base,3deg", 2, "a distance is in m, not in deg"),
    ("platform.distance=base,-1", 2, "must be positive"),
    ("platform.orientation=0,0,1m", 2, "an orientation has numbers in rad"),
    ("platform.position=0,0,1@-2", 2, "a weight is a positive number"),
    ("platform.position=0,0,1@2m", 2, "a weight is a positive number"),
    ("arm_1=3mm@2", 1, "arm_1 is in rad, not in mm"),
    ("platform.distance=grund,1", 1, "did you mean 'ground'?"),
    ("platfrm.distance=base,1", 1, "did you mean 'platform'?"),
    ("arm_4=1@2", 1, "arm_4"),
])
def test_mistakes_are_reported_in_words(run, monkeypatch, word, code, says):
    monkeypatch.setattr(sp, "assemble", lambda *_, **__: pytest.fail("work was done"))
    got, out, err = run("reach", "delta", word)
    assert got == code and out == "" and says in " ".join(err.split())
