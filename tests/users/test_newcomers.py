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
def test_a_structure_is_reported_where_it_is_to_move(pump, run, words):
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


def test_passive_freedoms_are_not_to_be_driven(run, tmp_path):
    path = sp.load("rssr").save(tmp_path)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('[drivers.crank]\njoint = "crank_pin"\n', ""), encoding="utf-8")
    _, out, _ = run("check", path)
    assert 'such as [drivers.NAME] joint = "crank_pin"' in " ".join(out.split())


def test_too_much_is_held():
    with pytest.raises(sp.SingularError, match="held coordinates and the loops leave no freedom, "
                                               "so that 'rocker_pin' cannot move; hold less"):
        sp.sweep(sp.load("four_bar"), "rocker_pin", [1.7, 1.9], hold=["crank"])


# ---------------------------------------------------------------- the file with the mistake


def refused(pump, more: str) -> str:
    """Return what is said of a mechanism file with more in it, which is named."""
    with pytest.raises(sp.MechanismFileError) as told:
        pump(more=more)
    where, _, text = str(told.value).partition("pump.toml: ")
    assert where.endswith("/") and text
    return text


@pytest.mark.parametrize(("more", "says"), [
    (known.refine("slid", "prismatic"),
     "joints.slid: the URDF has no such joint; did you mean 'slide'?"),
    (known.refine("slide", "spherical"),
     "joints.slide: joint 'slide' is prismatic in the URDF, which does not contain a spherical"),
])
def test_the_file_is_named_in_which_the_mistake_is(pump, more, says):
    assert refused(pump, more).startswith(says)


def test_the_file_of_wrong_axes_and_of_a_wrong_order_is_named(tmp_path):
    tree = known.floating("cross", "ground", "arm")
    for toml, says in (
            (known.refine("cross", "universal", axis=[0, 0, 1], axis2=[0, 0.6, 0.8]),
             "joints.cross: the pins"),
            ('order = ["crss"]\n' + known.refine("cross", "spherical"),
             "order: no joint that moves is named 'crss'; did you mean 'cross'?")):
        with pytest.raises(sp.MechanismFileError) as told:
            known.load(tmp_path, "joint", tree, toml)
        assert f"joint.toml: {says}" in str(told.value)


@pytest.mark.parametrize("where", ["", "[joints.slide]\ndamping = 1.0\n", START])
@pytest.mark.parametrize("value", ['["slide"]', '"slide"'])
def test_drivers_written_as_a_list_get_an_error_with_the_right_form(tmp_path, where, value):
    with pytest.raises(sp.MechanismFileError) as told:
        known.load(tmp_path, "pump", PUMP, f"{where}drivers = {value}\n")
    assert 'write [drivers.NAME] and below it joint = "slide"' in str(told.value)


def test_a_driver_written_as_a_line_gets_an_error_with_the_right_form(tmp_path):
    with pytest.raises(sp.MechanismFileError) as told:
        known.load(tmp_path, "pump", PUMP, '[drivers]\ncrank = "crank_pin"\n')
    assert str(told.value).endswith('pump.toml: drivers.crank: must be a table of key = value '
                                    'lines; write [drivers.crank] and below it joint = '
                                    '"crank_pin"')


# ---------------------------------------------------------------- guesses and laws


def test_a_guess_of_another_size_names_what_the_joint_takes(tmp_path):
    tree = known.floating("c4", "ground", "arm") + known.turning("wheel", "arm", "disc")
    refined = known.refine("c4", "cylindrical")
    for toml, says in (
            ("[guess]\nc4 = 0.3\n", "'c4' is cylindrical: give [angle, slide], not 0.3"),
            ("[guess]\nwheel = [0.3, 0.1]\n", "'wheel' is revolute: give a number, not "
                                             "[0.3, 0.1]")):
        with pytest.raises(sp.MechanismFileError) as told:
            known.load(tmp_path, "arm", tree, refined + toml)
        assert f"arm.toml: guess: {says}" in str(told.value)
    with pytest.raises(ValueError, match=r"'wheel' is revolute: give a number, not"):
        sp.assemble(known.load(tmp_path, "arm", tree, refined), {}, {"wheel": [0.3, 0.1]})


@pytest.mark.parametrize("law", [lambda t: t, lambda t: (t, 1.0), lambda t: ("a", 1.0, 0.0)])
def test_a_law_that_returns_something_else_gets_an_error_with_the_right_form(law):
    mech = sp.load("four_bar")
    with pytest.raises(TypeError, match=r"the law of 'crank' returns .* at 0 s; it must be a "
                                        r"function of time that returns \(value, rate, accel"):
        sp.simulate(mech, sp.assemble(mech), 0.1, drives={"crank": law})


# ---------------------------------------------------------------- loops that stay open


def test_a_coupling_that_stays_open_has_no_frames_to_check(tmp_path):
    tree = (known.turning("a", "ground", "one", axis=(0, 0, 1))
            + known.turning("b", "one", "two", xyz=(1, 0, 0), axis=(0, 0, 1)))
    mech = known.load(tmp_path, "geared", tree, known.coupling("gears", "a", "b", 50.0, 1.0)
                      + known.coupling("wheels", "a", "b", 50.0, 2.0))
    with pytest.raises(sp.AssemblyError, match=": check ratio and offset of coupling 'gears', and"):
        sp.assemble(mech)


def test_a_length_in_another_unit_is_a_hint(tmp_path):
    tree = (known.turning("a", "ground", "one") + known.point("tip", "one", (0.2, 0, 0))
            + known.turning("b", "ground", "two", (0.5, 0, 0))
            + known.point("end", "two", (0.2, 0, 0)))
    mech = known.load(tmp_path, "rod", tree, known.closure("rod", "distance", "tip", "end",
                                                           length=400))
    with pytest.raises(sp.AssemblyError, match=r"length = 400 m is 571 times the mechanism's size: "
                                               r"400 mm are 0\.4"):
        sp.assemble(mech)


# ---------------------------------------------------------------- forces


@pytest.mark.filterwarnings("ignore:.*no link has a mass")
def test_an_actuator_at_its_limit_position_is_reported_with_the_sample(pump):
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
