"""What no loop ties to what is set stays where the guess has it: outside loops to the last bit."""

import numpy as np
import pytest
from legs import robot

import spatial_pin as sp

BASES = ("floating", "planar", "chain", "ground")
ANGLES = np.linspace(-3.0, 3.0, 13)  # of a motor: from home many of them are found by other starts
LEG = ("knee_0", "motor_0", "rod_0")
OTHER_LEG = ("knee_1", "motor_1", "rod_1")
POSE = {"floating": {"base": [0.3, -0.2, 0.5, 0.4, -0.3, 0.2]},
        "planar": {"base": [0.3, -0.2, 2.5]},
        "chain": {"base_x": 0.3, "base_z": -1.5, "base_ball": [0.1, 0.2, 0.3]}, "ground": {}}
BENT = {"knee_0": 0.8, "motor_0": 0.8, "rod_0": -0.8}
ARM = {"shoulder": 7.5, "wrist": [0.3, 0.2, 0.1], "hip_0": 0.4, "hip_1": -0.2}


def moved(mechanism, one, two, least=0.0):
    """Return the coordinates in which two states differ, of those not in the first leg's loop."""
    return [name for name in mechanism.coordinates if name not in LEG
            and abs(one.coordinate(name).value - two.coordinate(name).value) > least]


@pytest.mark.filterwarnings("ignore:.*are on another branch:spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize("base", BASES)
def test_setting_a_motor_leaves_the_base_the_arm_and_the_other_leg_where_they_are(base):
    mechanism = robot(base)
    guess = {**POSE[base], **ARM, **BENT}
    home = sp.assemble(mechanism, guess=guess)
    assert home.coordinate("shoulder").value == 7.5
    for angle in ANGLES:
        for start in (guess, home, home.q):
            state = sp.assemble(mechanism, {"motor_0": angle}, start)
            assert state.closure_error < 1e-12
            assert state.coordinate("motor_0").value == angle
            assert set(moved(mechanism, home, state)) <= {*OTHER_LEG}
            assert moved(mechanism, home, state, least=1e-12) == []
            assert state.released == {}


@pytest.mark.parametrize("base", BASES[:3])
def test_joints_that_nobody_drives_stay_too(base):
    mechanism = robot(base, legs=1, drivers=[])
    home = sp.assemble(mechanism, guess={**POSE[base], **BENT, "hip_0": 0.4})
    for angle in ANGLES[::3]:
        assert moved(mechanism, home, sp.assemble(mechanism, {"motor_0": angle}, home)) == []


def test_a_base_goes_where_it_is_set_and_not_beyond():
    mechanism = robot("floating")
    home = sp.assemble(mechanism, guess={**POSE["floating"], **ARM, **BENT})
    for angle in ANGLES[::3]:
        state = sp.assemble(mechanism, {"motor_0": angle, "base.z": 0.9}, home)
        assert moved(mechanism, home, state, least=1e-14) == ["base.z"]
        assert state.coordinate("base.z").value == 0.9


def test_the_branch_does_not_depend_on_the_base():
    """The leg stands alike on the ground and on a base, wherever its guess is."""
    fixed, free = robot("ground"), robot("floating")
    guess = {**POSE["floating"], "knee_0": 0.8}
    for angle in ANGLES:
        one, two = (sp.assemble(x, {"motor_0": angle}, {k: v for k, v in guess.items()
                    if k in x.coordinates or (k == "base" and x is free)}) for x in (fixed, free))
        for name in LEG:
            assert one.coordinate(name).value == pytest.approx(two.coordinate(name).value,
                                                               abs=1e-9)


def test_turns_of_a_joint_that_the_file_guesses_are_not_taken_off():
    mechanism = robot("floating").with_fields(guess={"shoulder": 7.5, "hip_0": 0.4})
    for guess in (None, {"knee_0": 0.8}):
        state = sp.assemble(mechanism, {"motor_0": 0.3}, guess)
        assert state.coordinate("shoulder").value == 7.5
