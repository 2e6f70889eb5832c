"""Drivers that nobody gives a value stand at the guess, or go no further than they must."""

import math

import mechanisms
import numpy as np
import pytest
from loaded_library import library
from machines import limited_slider, rocker_of, two_motors, wishbone
from mechanisms import (
    coupling,
    driver,
    load,
    turning,
)
from scipy.optimize import brentq, minimize

import spatial_pin as sp


@pytest.fixture
def folder(tmp_path):
    return tmp_path


def motion_of(mechanism, state):
    return sum((by / (1.0 if mechanism.coordinate(name).unit == "rad"
                      else mechanism.characteristic_length)) ** 2
               for name, by in state.released.items())


# ---------------------------------------------------------------- they stand


@pytest.mark.parametrize("leg", [1, 4])
def test_the_other_legs_of_a_platform_stand(leg):
    mechanism = library("stewart")
    home = sp.assemble(mechanism)
    state = sp.assemble(mechanism, {f"leg_{leg}": 0.41})
    for k in {1, 2, 3, 4, 5, 6} - {leg}:
        assert state.coordinate(f"leg_{k}").value == home.coordinate(f"leg_{k}").value
    assert state.released == {} == home.released
    assert state.closure_error < 1e-12


def test_home_of_a_platform_of_other_dimensions_is_its_own():
    mechanism = library("stewart", h=0.5)
    home = sp.assemble(mechanism)
    assert np.abs(home.placement("platform").translation[:2]).max() < 1e-12
    assert sp.assemble(mechanism, {"leg_2": home.coordinate("leg_2").value + 0.02}).released == {}


def test_the_other_arms_of_a_delta_stand():
    mechanism = library("delta")
    state = sp.assemble(mechanism, {"arm_2": 0.7}, guess={"arm_1": 0.2})
    assert [state.coordinate(f"arm_{k}").value for k in (1, 2, 3)] == [0.2, 0.7, 0.0]


@pytest.mark.parametrize("size", [1e-3, 1.0, 50.0])
def test_the_rack_of_a_wishbone_stands_while_the_wheel_travels(folder, size):
    mechanism = wishbone(folder, size, rack=0.004)
    for travel in np.linspace(-0.25, 0.25, 7):
        state = sp.assemble(mechanism, {"wheel": travel})
        assert state.coordinate("steering").value == 0.004 * size
        assert state.released == {}


def test_the_wheel_stands_while_the_rack_goes(folder):
    state = sp.assemble(wishbone(folder), {"rack": 0.03}, guess={"ball": [0.0, 0.1, 0.0]})
    assert state.coordinate("wheel").value == 0.0 and state.released == {}


def test_a_state_and_a_configuration_say_where_drivers_stand(folder):
    mechanism = wishbone(folder)
    before = sp.assemble(mechanism, {"wheel": 0.1, "steering": -0.02})
    for said in (before, before.q):
        state = sp.assemble(mechanism, {"wheel": -0.1}, guess=said)
        assert state.coordinate("steering").value == -0.02
    motion = sp.sweep(mechanism, "wheel", np.linspace(0.1, 0.2, 5), guess=before)
    assert np.abs(motion.coordinate("steering").value + 0.02).max() < 1e-15


def test_a_sweep_holds_what_it_is_not_set_to_move(folder):
    mechanism = wishbone(folder, rack=0.01)
    motion = sp.sweep(mechanism, "wheel", np.linspace(0.0, 0.2, 11))
    assert (motion.coordinate("rack").value == 0.01).all()
    assert [e for e in motion.events if e.kind == "released"] == []


# ---------------------------------------------------------------- they go where they must


def test_a_driver_goes_as_little_as_possible_to_a_stretched_chain(folder):
    mechanism = mechanisms.five_bar(folder)
    g, a, b = mechanisms.FIVE_BAR.values()

    def stretched(right, left=3.1):
        x = g + a * math.cos(right) - a * math.cos(left)
        return math.hypot(x, a * math.sin(right) - a * math.sin(left)) - 2 * b

    assert stretched(1.0) > 0.0
    state = sp.assemble(mechanism, {"left": 3.1})
    ends = [brentq(stretched, *side) for side in ((1.0, 2.5), (-1.5, 1.0))
            if stretched(side[0]) * stretched(side[1]) < 0.0]
    nearest = min((end - 1.0 for end in ends), key=abs)
    assert set(state.released) == {"right"}
    assert state.released["right"] == pytest.approx(nearest, abs=1e-9)
    assert state.coordinate("right").value == pytest.approx(1.0 + nearest, abs=1e-9)


def test_of_two_motors_on_one_freedom_the_second_follows(folder):
    mechanism = two_motors(folder)
    state = sp.assemble(mechanism, {"first": 0.9})
    assert state.coordinate("rocker").value == pytest.approx(rocker_of(0.9), abs=1e-12)
    assert state.released == {"second": pytest.approx(rocker_of(0.9) - 1.5, abs=1e-12)}
    assert sp.assemble(mechanism, {"first": 0.9, "second": rocker_of(0.9)}).released == {}


def test_two_motors_that_disagree_share_the_least_motion(folder):
    mechanism = two_motors(folder, rough=0.3)
    state = sp.assemble(mechanism)
    best = minimize(lambda x: (x[0] - 0.4) ** 2 + (rocker_of(x[0]) - 1.8) ** 2, [0.5],
                    options={"gtol": 1e-12})
    assert motion_of(mechanism, state) == pytest.approx(best.fun, rel=1e-9)
    assert state.released["first"] == pytest.approx(best.x[0] - 0.4, abs=1e-6)
    assert state.released["second"] == pytest.approx(rocker_of(best.x[0]) - 1.8, abs=1e-6)


def test_released_drivers_of_a_sweep_are_reported(folder):
    mechanism = two_motors(folder)
    motion = sp.sweep(mechanism, "first", np.linspace(0.5, 1.5, 9))
    assert motion.coordinate("rocker").value == pytest.approx(
        [rocker_of(x) for x in motion.driver], abs=1e-12)
    (event,) = [e for e in motion.events if e.kind == "released"]
    assert "second" in event.text and event.row == 0
    task = sp.sweep(mechanism, "second", np.linspace(rocker_of(0.6), rocker_of(0.7), 3))
    assert "first" in task.events[0].text


@pytest.mark.filterwarnings("ignore:.*do not go straight:spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize("arm", [2.9, 3.1])
def test_no_closed_configuration_nearby_moves_the_drivers_less(arm):
    """Lagrange's condition, and random closed neighbours."""
    mechanism = library("delta")
    state = sp.assemble(mechanism, {"arm_1": arm}, guess={"arm_2": 0.1})
    least = motion_of(mechanism, state)
    assert least > 0.0 and state.closure_error < 1e-12
    rng = np.random.default_rng(5)
    for _ in range(6):
        moved = {f"arm_{k}": state.coordinate(f"arm_{k}").value + rng.uniform(-0.05, 0.05)
                 for k in (2, 3)}
        try:
            near = sp.assemble(mechanism, {"arm_1": arm, **moved}, guess=state)
        except sp.AssemblyError:
            continue
        gaps = near.coordinate("arm_2").value - 0.1, near.coordinate("arm_3").value
        assert sum(x * x for x in gaps) > least * (1.0 - 1e-9)


def test_a_guess_that_does_not_close_is_closed_as_a_whole():
    """A crank that cannot stand at 0 is not left at its dead centre, where it could not move on."""
    mechanism = library("four_bar", r1=0.3, r2=0.24, r3=0.1, r4=0.28)
    state = sp.assemble(mechanism)
    assert set(state.released) == {"crank"}
    assert sp.solve_rates(mechanism, state, {"crank": 1.0}).rate_error < 2e-12


def test_angles_and_slides_are_weighed_by_the_size(folder):
    """A wishbone a thousand times as large lets go of its drivers by the same angle."""
    released = [sp.assemble(wishbone(folder, size), {"upper_pin": 0.35}).released
                for size in (1.0, 1e3)]
    assert set(released[0]) == {"wheel"}
    assert released[1]["wheel"] == pytest.approx(released[0]["wheel"], abs=1e-9)


def test_a_coordinate_that_is_no_driver_takes_the_driver_along():
    state = sp.assemble(library("four_bar"), {"rocker_pin": 1.8})
    assert set(state.released) == {"crank"}
    assert state.coordinate("crank").value == pytest.approx(
        state.released["crank"] + 0.0, abs=1e-12)


def test_geared_drivers_follow_each_other(folder):
    tree = turning("a", "ground", "wheel_a") + turning("b", "ground", "wheel_b", (0.2, 0, 0))
    toml = coupling("teeth", "a", "b", -2.0) + driver("a", "a") + driver("b", "b")
    state = sp.assemble(load(folder, "gears", tree, toml), {"a": 0.3})
    assert state.coordinate("b").value == pytest.approx(-0.6, abs=1e-15)
    assert state.released == {"b": pytest.approx(-0.6, abs=1e-12)}
    both = sp.assemble(load(folder, "gears", tree, toml), {}, guess={"a": 1.0})
    assert both.released["a"] == pytest.approx(-0.8, abs=1e-9)  # least of a² + b² on b = −2 a
    assert both.released["b"] == pytest.approx(-0.4, abs=1e-9)


def test_nobody_is_released_when_that_is_forbidden(folder):
    mechanism = mechanisms.five_bar(folder)
    with pytest.raises(sp.AssemblyError, match=r"right = 1: give them values.*release=True"):
        sp.assemble(mechanism, {"left": 3.1}, release=False)
    assert sp.assemble(mechanism, {"left": 2.2}, release=False).released == {}


def test_drivers_that_the_guess_leaves_out_are_not_moved_either_when_that_is_forbidden():
    mechanism = library("stewart")  # its guess names the platform, not the legs
    with pytest.raises(sp.AssemblyError, match="stand at slide_1 = 0"):
        sp.assemble(mechanism, {}, release=False)
    lengths = {f"leg_{k}": sp.assemble(mechanism).coordinate(f"leg_{k}").value
               for k in range(1, 7)}
    assert sp.assemble(mechanism, lengths, release=False).released == {}


def test_free_drivers_go_where_the_loops_take_them(folder):
    mechanism = two_motors(folder)
    state = sp.assemble(mechanism, {"first": 0.9}, free=["second"], release=False)
    assert state.coordinate("second").value == pytest.approx(rocker_of(0.9), abs=1e-12)
    assert state.released == {}
    assert sp.assemble(mechanism, {"first": 0.9}, free="second").released == {}


def test_what_cannot_be_free_is_refused(folder):
    mechanism = two_motors(folder)
    with pytest.raises(ValueError, match="'knee' is no driver"):
        sp.assemble(mechanism, free=["knee"])
    with pytest.raises(ValueError, match="'first' is given a value too"):
        sp.assemble(mechanism, {"first": 0.9}, free=["first"])
    with pytest.raises(sp.UnknownNameError):
        sp.assemble(mechanism, free=["third"])


def test_rates_keep_what_was_released(folder):
    mechanism = mechanisms.five_bar(folder)
    state = sp.assemble(mechanism, {"elbow1": -1.0})
    assert sp.solve_rates(mechanism, state, {"left": 1.0, "right": 0.0}).released == state.released
    assert len(state.released) == 2


# ---------------------------------------------------------------- joint limits


def test_a_state_says_how_far_it_is_beyond_its_limits(folder):
    mechanism = limited_slider(folder)
    assert sp.assemble(mechanism).beyond_limits == {}
    with pytest.warns(sp.SpatialPinWarning, match=r"slide: 0.4 m is not in \[0.25, 0.38\]"):
        far = sp.assemble(mechanism, {"crank": 0.0})
    assert far.beyond_limits == {"slide": pytest.approx(0.02, abs=1e-12)}
    with pytest.warns(sp.SpatialPinWarning):
        near = sp.assemble(mechanism, {"crank": math.pi})
    assert near.beyond_limits == {"slide": pytest.approx(-0.05, abs=1e-12)}


def test_verbs_that_tell_of_limits_themselves_do_not_warn(folder):
    mechanism = limited_slider(folder)
    motion = sp.sweep(mechanism, "crank", [0.0, 1.0])
    assert {e.kind for e in motion.events} == {"joint limit"}
    assert motion.state(0).beyond_limits == {"slide": pytest.approx(0.02, abs=1e-12)}


def test_drivers_are_let_go_to_keep_joint_limits(folder):
    """The slide comes no further than 0.38 m: the crank goes until it stands there."""
    mechanism = limited_slider(folder)
    state = sp.assemble(mechanism, {}, guess={"crank": 0.1}, limits=True)
    crank = math.acos((0.1**2 + 0.38**2 - 0.3**2) / (2 * 0.1 * 0.38))
    assert state.beyond_limits == {}
    assert state.released == {"crank": pytest.approx(crank - 0.1, abs=1e-9)}
    with pytest.raises(sp.AssemblyError, match="joint limits"):
        sp.assemble(mechanism, {"crank": 0.1}, limits=True)


# ---------------------------------------------------------------- coordinates without end


@pytest.mark.parametrize("turns", [1e9, 1e14, -1e17, 1e300])
def test_a_guess_of_many_turns_is_one_of_less_than_a_turn(turns):
    mechanism = library("four_bar")
    state = sp.assemble(mechanism, {"crank": 0.3}, guess={"rocker_pin": turns})
    assert state.closure_error < 1e-14
    assert abs(state.coordinate("rocker_pin").value) < 7.0


@pytest.mark.parametrize("turns", [1e14, 1e17])
def test_an_exact_angle_of_many_turns_is_kept_and_closed(turns):
    mechanism = library("four_bar")
    state = sp.assemble(mechanism, {"crank": turns})
    there = sp.assemble(mechanism, {"crank": math.atan2(math.sin(turns), math.cos(turns))})
    assert state.coordinate("crank").value == turns and state.closure_error < 1e-14
    assert state.coordinate("rocker_pin").value == pytest.approx(
        there.coordinate("rocker_pin").value, abs=1e-12)


@pytest.mark.parametrize("far", [1e8, 1e14, 1e17, 1e300])
def test_a_slide_without_end_is_never_called_closed(far):
    mechanism = library("slider_crank")
    state = sp.assemble(mechanism, {}, guess={"slide": far})
    assert state.closure_error < 1e-12
    with pytest.raises(sp.AssemblyError, match="slide = "):
        sp.assemble(mechanism, {"slide": far})


@pytest.mark.parametrize("turns", [1e10, 1e14, 1e17, 1e300])
def test_a_gear_that_counts_more_turns_than_digits_is_named(turns):
    mechanism = library("geared_five_bar")
    for given in (({"crank": turns},), ({}, {"crank": turns})):
        with pytest.raises(sp.AssemblyError, match=r"(left|right)_pin = .* round-off"):
            sp.assemble(mechanism, *given)


# ---------------------------------------------------------------- the command line


@pytest.mark.filterwarnings("default::spatial_pin.SpatialPinWarning")
def test_the_command_line_says_who_was_released(run):
    code, said, _ = run("assemble", "delta", "arm_1=3")
    assert code == 0
    for arm in (2, 3):
        assert f"released: driver arm_{arm} went +0.304141578 rad" in said
    code, _, told = run("assemble", "delta", "arm_1=3", "--no-release")
    assert code == 1
    assert "or let them go by --release or --free NAME" in " ".join(told.split())
    code, said, _ = run("assemble", "delta", "arm_1=3", "--free", "arm_2")
    assert code == 0 and "released" not in said
    code, said, told = run("assemble", "stewart", "leg_1=0.5")
    assert code == 0
    assert "beyond limits: slide_1 is 0.0289" in said
    assert "slide_1: 0.5 m is not in" in told
