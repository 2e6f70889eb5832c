"""What newcomers do wrong, and what they are told: the cause, by name, and the remedy."""

from __future__ import annotations

import mechanisms as known
import pytest

import spatial_pin as sp

PUMP = (known.turning("crank_pin", "ground", "crank", axis=(0, 1, 0))
        + known.turning("wrist", "crank", "rod", xyz=(0.05, 0, 0), axis=(0, 1, 0))
        + known.point("rod_end", "rod", xyz=(0.14, 0, 0))
        + known.sliding("slide", "ground", "piston", axis=(1, 0, 0)))
CRANK = known.driver("crank", "crank_pin")
START = known.guess(crank_pin=0.3, wrist=-0.4, slide=0.18)


@pytest.fixture
def pump(tmp_path):
    """Write a slider-crank, the slide joined to the rod by a closure; returns its path."""

    def pump(drivers: str = CRANK, axis=(0, 1, 0), more: str = "") -> str:
        closure = known.closure("gudgeon", "revolute", "rod_end", "piston", axis=list(axis))
        return str(known.load(tmp_path, "pump", PUMP, closure + drivers + START + more).path)

    return pump


# ---------------------------------------------------------------- freedoms and drivers


def test_what_cannot_move_is_not_good(pump, run):
    path = pump(axis=(1, 0, 0))
    code, out, err = run("check", path)
    assert (code, out) == (1, "")
    assert "it cannot move: 1 driver for 0 working freedoms; check the axes and frames of " \
           "closure 'gudgeon', and the axes of the joints" in err


@pytest.mark.parametrize("words", [("sweep", "crank", 0, 1), ("limits", "crank"),
                                   ("jacobian", "piston")], ids=lambda words: words[0])
def test_a_structure_is_told_where_it_is_to_move(pump, run, words):
    code, _, err = run(words[0], pump(axis=(1, 0, 0)), *words[1:])
    assert code == 1 and "'crank_pin' cannot move: the loops leave no freedom there (see " \
        "`spatial-pin info`); check the axes and frames of closure 'gudgeon'" in err


def test_a_structure_without_drivers_is_noted(pump, run):
    code, out, _ = run("check", pump(drivers="", axis=(1, 0, 0)))
    assert code == 0 and "note: it is a structure, which cannot move; if it is to, check" in out


@pytest.mark.parametrize(("drivers", "says"), [
    ("", 'note: 0 drivers for 1 working freedom; add 1 driver, such as [drivers.NAME] joint = '
         '"crank_pin"'),
    (CRANK + known.driver("press", "slide"),
     "note: 2 drivers for 1 working freedom; leave out 1: [drivers.press]"),
])
def test_the_note_on_drivers_says_what_to_do(pump, run, drivers, says):
    code, out, _ = run("check", pump(drivers=drivers))
    assert code == 0 and says in " ".join(out.split())


def test_passive_freedoms_are_not_to_be_driven(run):
    sp.load("rssr").save("plain")
    with open("plain/rssr.toml", encoding="utf-8") as file:
        text = file.read()
    with open("plain/rssr.toml", "w", encoding="utf-8") as file:
        file.write(text.replace("[drivers.crank]\njoint = \"crank_pin\"\n", ""))
    _, out, _ = run("check", "plain/rssr.toml")
    assert 'such as [drivers.NAME] joint = "crank_pin"' in " ".join(out.split())


def test_too_much_is_held():
    with pytest.raises(sp.SingularError, match="what is held and the loops leave no freedom, so "
                                               "that 'rocker_pin' cannot move; hold less"):
        sp.sweep(sp.load("four_bar"), "rocker_pin", [1.7, 1.9], hold=["crank"])


# ---------------------------------------------------------------- forces


@pytest.mark.filterwarnings("ignore:.*no link has a mass")
def test_an_actuator_at_its_limit_position_is_told_with_the_sample(pump):
    mech = sp.load(pump())
    motion = sp.sweep(mech, "crank", [-0.5, 0.0, 0.5], speed=1.0)
    with pytest.raises(sp.SpatialPinError) as told:
        sp.kinetostatics(mech, motion, actuated=["slide"])
    text = str(told.value)
    assert "'slide' is at a limit position, where no effort there moves" in text
    assert text.endswith("such as actuated=['slide', 'crank'] (at crank = 0 rad, sample 1)")


@pytest.mark.filterwarnings("ignore:.*no link has a mass")
def test_a_driver_is_proposed_first_as_an_actuator(pump):
    mech = sp.load(pump())
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.5}), {"crank": 1.0})
    with pytest.raises(sp.SpatialPinError, match=r"such as actuated=\['crank'\]"):
        sp.inverse_dynamics(mech, state, [])
