"""A few dozen random mechanisms and damaged files; `scripts/fuzz.py` judges thousands."""

import importlib.util
import sys

import numpy as np
import pytest
from folders import ROOT

SCRIPTS = ROOT / "scripts"
SEEDS = 35
EXTENDED = np.finfo(np.longdouble).eps < 1e-18


@pytest.fixture(scope="module")
def fuzz():
    """The script as a module."""
    before = list(sys.path)
    spec = importlib.util.spec_from_file_location("fuzz", SCRIPTS / "fuzz.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path[:] = before


@pytest.mark.skipif(not EXTENDED, reason="the judge needs extended precision")
@pytest.mark.delicate
@pytest.mark.parametrize("first", [
    0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(5, SEEDS, 5))])
def test_answers_for_random_mechanisms_are_right_or_refused_for_a_reason(fuzz, first):
    sums = fuzz.Sums()
    for seed in range(first, first + 5):
        sums.add(fuzz.judged(seed))
    assert sums.count("right") > 5
    assert not sums.count("wrong", "crashed", "hung", "refused?"), str(sums)


@pytest.mark.slow
@pytest.mark.skipif(not EXTENDED, reason="the judge needs extended precision")
def test_the_judge_notices_a_wrong_answer(fuzz, monkeypatch):
    import spatial_pin as sp

    right = sp.forward_dynamics

    def wrong(mechanism, state, efforts=None):
        found = right(mechanism, state, efforts)
        found.a = found.a * (1 + 1e-6)
        return found

    monkeypatch.setattr(sp, "forward_dynamics", wrong)
    sums = fuzz.Sums()
    for seed in range(10):
        sums.add(fuzz.judged(seed, ("forward",)))
    assert sums.count("wrong") >= 5


@pytest.mark.skipif(not EXTENDED, reason="the judge needs extended precision")
def test_round_off_of_forces_on_what_falls_freely_is_no_imbalance(fuzz, monkeypatch):
    """Centres of mass 20 m from where the links' velocities are known."""
    from fuzzing import records

    rng = np.random.default_rng(1)
    names = [("j0", "l0", 1.0), ("j1", "l1", 1e-3)]
    joints = [{"name": joint, "kind": "floating", "parent": "ground", "child": link,
               "xyz": rng.normal(size=3).tolist(), "rpy": rng.normal(size=3).tolist()}
              for joint, link, _ in names]
    inertias = {link: {"mass": mass, "com": (20.0 * rng.normal(size=3)).tolist(),
                       "tensor": [0.1 * mass, 0.0, 0.0, 0.1 * mass, 0.0, 0.1 * mass]}
                for _, link, mass in names}
    spec = {"seed": 1, "mode": "generic", "size": 1.0, "joints": joints, "frames": [],
            "closures": [], "inertias": inertias, "springs": [], "drivers": [], "parameters": {},
            "gravity": [0, 0, -9.81], "q": 2 * [0, 0, 0, 0, 0, 0, 1.0]}
    monkeypatch.setattr(records, "make", lambda seed: spec)
    assert [r["end"] for r in fuzz.judged(1, ("reactions",))] == ["right"] * 4


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
def test_damaged_files_load_or_are_refused_in_words(fuzz):
    ends = [fuzz.Damage.judged(seed) for seed in range(60)]
    assert not [r for r in ends if r["end"] in fuzz.BAD]
    assert {r["end"] for r in ends} >= {"same", "error"}


@pytest.mark.delicate
@pytest.mark.parametrize("first", [
    20, *(pytest.param(k, marks=pytest.mark.slow) for k in range(25, 100, 5))])
def test_files_of_a_few_digits_answer_as_the_exact_mechanisms(fuzz, first):
    sums = fuzz.Sums()
    for seed in range(first, first + 5):
        sums.add(fuzz.drawn_checks.judged(seed))
    assert sums.count("right") > 25
    assert not sums.bad, str(sums)


@pytest.mark.slow
@pytest.mark.delicate
def test_the_judge_of_drawn_files_notices_a_wrong_answer(fuzz, monkeypatch):
    import spatial_pin as sp

    right = sp.forward_dynamics

    def wrong(mechanism, state, efforts=None):
        found = right(mechanism, state, efforts)
        if mechanism.name == "drawn":
            found.a = found.a * (1 + 1e-2)
        return found

    monkeypatch.setattr(sp, "forward_dynamics", wrong)
    sums = fuzz.Sums()
    for seed in range(20, 30):
        sums.add(fuzz.drawn_checks.judged(seed))
    assert sums.count("wrong") >= 5
