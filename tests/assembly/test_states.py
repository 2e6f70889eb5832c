"""States know their mechanism and the turns of their screws."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from loaded_library import library

import spatial_pin as sp

LEAD = 0.004
JACK = """<robot name="jack" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="h" default="0.1"/><link name="ground"/><link name="spindle"/><link name="nut"/>
<joint name="spindle_pin" type="continuous"><parent link="ground"/><child link="spindle"/>
<axis xyz="0 0 1"/></joint>
<joint name="slide" type="prismatic"><parent link="ground"/><child link="nut"/>
<origin xyz="0 0 $(arg h)"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<link name="thread"/><joint name="thread_point" type="fixed"><parent link="spindle"/>
<child link="thread"/><origin xyz="0 0 $(arg h)"/></joint></robot>"""
LOOP = f"""name = "jack"
tree = "jack.urdf.xacro"
[[closures]]
name = "screw"
type = "screw"
lead = {LEAD}
frames = ["nut", "thread"]
[drivers.spindle]
joint = "spindle_pin"
"""


@pytest.fixture
def jack(tmp_path):
    (tmp_path / "jack.urdf.xacro").write_text(JACK, encoding="utf-8")
    (tmp_path / "jack.toml").write_text(LOOP, encoding="utf-8")
    return sp.load(tmp_path / "jack.toml")


@pytest.fixture
def ten_turns(jack):
    """The nut after ten turns: frame 2, the thread, has moved up against it by ten leads."""
    return sp.sweep(jack, "spindle", np.linspace(0.0, 20 * np.pi, 41)).state(40)


def test_a_screw_closure_counts_the_turns_of_a_sweep(ten_turns):
    assert ten_turns.coordinate("slide").value == pytest.approx(-10 * LEAD, abs=1e-15)
    assert ten_turns.angles == pytest.approx([20 * np.pi])


def test_mobility_rates_and_jacobian_take_the_turns_from_the_state(jack, ten_turns):
    assert sp.mobility(jack, ten_turns).dof == 1
    rates = sp.solve_rates(jack, ten_turns, {"spindle": 2 * np.pi})
    assert rates.coordinate("slide").rate == pytest.approx(-LEAD, abs=1e-15)
    assert sp.jacobian(jack, ten_turns, "nut")[2, 0] == pytest.approx(-LEAD / (2 * np.pi))


def test_a_state_as_guess_keeps_its_turns(jack, ten_turns):
    again = sp.assemble(jack, {"spindle": 20 * np.pi}, ten_turns)
    assert again.coordinate("slide").value == pytest.approx(-10 * LEAD, abs=1e-15)


def test_sensitivity_stays_on_the_turn_of_the_state(jack, ten_turns):
    found = sp.sensitivity(jack, ten_turns, "nut.position")
    np.testing.assert_allclose(found.value, [0.0, 0.0, 0.1 - 10 * LEAD], atol=1e-14)
    np.testing.assert_allclose(found.derivatives["h"], [0.0, 0.0, 1.0], atol=1e-11)


@pytest.mark.slow
def test_a_driver_that_leads_elsewhere_with_every_turn_makes_no_full_turn(jack):
    found = sp.limits(jack, "spindle")
    assert not found.full_turn
    assert found.upper.kind == "not followed further"


@pytest.mark.parametrize("use", [
    lambda m, s: sp.solve_rates(m, s, {"crank": 1.0}),
    lambda m, s: sp.jacobian(m, s, "rocker_b"),
    lambda m, s: sp.influence(m, s),
    lambda m, s: sp.mobility(m, s),
    lambda m, s: sp.sensitivity(m, s, "rocker_pin", []),
])
def test_a_state_of_other_dimensions_is_refused(use):
    state = sp.assemble(library("rssr"), {"crank": 1.0})
    with pytest.raises(sp.SpatialPinError, match="other dimensions"):
        use(library("rssr", d=0.30), state)
    with pytest.raises(sp.SpatialPinError, match="belongs to mechanism 'rssr'"):
        use(library("four_bar"), state)


def test_a_state_of_the_same_mechanism_loaded_twice_is_taken():
    state = sp.assemble(sp.load("rssr"), {"crank": 1.0})
    rates = sp.solve_rates(sp.load("rssr"), state, {"crank": 1.0})
    assert rates.coordinate("crank_pin").rate == 1.0


def test_an_argument_that_is_no_mechanism_or_state_is_refused():
    for call in (lambda: sp.assemble("rssr"), lambda: sp.sweep("rssr", "crank", [0.0]),
                 lambda: sp.mobility("rssr"), lambda: sp.assembly_modes("rssr", {}),
                 lambda: sp.limits("rssr", "crank")):
        with pytest.raises(TypeError, match=r"a Mechanism is needed, not 'rssr'.*sp\.load"):
            call()
    with pytest.raises(TypeError, match=r"a State or Motion is needed, not dict: sp\.assemble"):
        sp.solve_rates(library("rssr"), {"crank": 1.0})


def test_a_guess_of_another_mechanism_is_refused():
    state = sp.assemble(library("rssr"), {"crank": 1.0})
    with pytest.raises(ValueError, match="other coordinates"):
        sp.assemble(library("four_bar"), {}, state)


def test_a_sweep_can_stop_where_branches_cross():
    parallelogram = library("four_bar", r1=0.3, r2=0.1, r3=0.3, r4=0.1)
    motion = sp.sweep(parallelogram, "crank", np.linspace(0.5, 6.0, 200), on_crossing="stop")
    assert [event.kind for event in motion.events] == ["branch point"]
    assert motion.events[0].value == pytest.approx(np.pi, abs=1e-9)
    assert motion.driver[-1] < np.pi


@pytest.mark.parametrize("words", [
    ["assemble", "rssr", "crank=5m"],
    ["assemble", "rssr", "--guess", "rocker_pin=9cm"],
    ["assemble", "rssr", "crank=25rpm"],
    ["modes", "rssr", "crank=2mm"],
])
def test_a_length_for_an_angle_is_refused_on_the_command_line(words, run):
    code, _, error = run(*words)
    assert code == 1 and "is in rad, not in" in error


@pytest.mark.parametrize(("words", "says"), [
    ("sweep four_bar crank 0 1 --speed 25m", "the speed of crank is in rad/s, not in m"),
    ("sweep four_bar crank 0 1 --speed 5mm/s", "the speed of crank is in rad/s, not in mm/s"),
    ("sweep four_bar crank 0 1 --speed 25rpm --acceleration 3rpm",
     "the acceleration of crank is in rad/s2, not in rpm"),
    ("simulate four_bar --duration 1s --effort crank=1kN",
     "the effort of crank is in Nm or N·m, not in kN"),
    ("simulate stewart --duration 1s --effort leg_1=10Nm",
     "the effort of leg_1 is in N or kN, not in Nm"),
    ("simulate four_bar --duration 1s --speed crank=2deg",
     "the speed of crank is in rad/s, not in deg"),
])
def test_a_unit_of_another_order_is_refused_on_the_command_line(words, says, run):
    code, _, error = run(*words.split())
    assert (code, error) == (1, f"spatial-pin: {says}\n")


def test_a_mechanism_that_nobody_holds_is_forgotten():
    mechanism = sp.load("rssr")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism), {"crank": 1.0})
    sp.inverse_dynamics(mechanism, state)
    gone = weakref.ref(mechanism)
    del mechanism, state
    gc.collect()
    assert gone() is None


@pytest.mark.parametrize(("call", "says"), [
    (lambda m, s: sp.assemble(m, 3.0), "drivers must be a mapping"),
    (lambda m, s: sp.solve_rates(m, s, 3.0), "speeds must be a mapping"),
    (lambda m, s: sp.forward_dynamics(m, s, 3.0), "efforts must be a mapping"),
    (lambda m, s: sp.simulate(m, s, 1.0, lambda t, state: 3.0), "efforts must be a mapping"),
    (lambda m, s: sp.simulate(m, s, 1.0, drives={"crank": 3.0}), "law of 'crank' is 3.0"),
    (lambda m, s: sp.kinetostatics(m, s), "a Motion is needed, not State"),
    (lambda m, s: sp.dead_centres(m), "a Motion is needed, not Mechanism"),
    (lambda m, s: sp.plot(s, "rocker_pin"), "a Motion is needed, not State"),
])
def test_what_is_of_the_wrong_kind_is_refused_in_words(call, says):
    mechanism = library("four_bar")
    with pytest.raises(TypeError, match=says):
        call(mechanism, sp.assemble(mechanism, {"crank": 1.0}))


@pytest.mark.parametrize(("call", "error", "says"), [
    (lambda m: sp.assemble(m, {1: 2.0}), sp.SpatialPinError, "no coordinate or driver 1; there"),
    (lambda m: sp.assembly_modes(m, patience=0), ValueError, "patience is 0"),
    (lambda m: sp.tolerance(m, "rocker_pin", {"d": 1e-4}, samples=-1), ValueError, "samples is -1"),
    (lambda m: sp.report(m, "page.html"), sp.SpatialPinError, "a Mechanism cannot be shown"),
])
def test_an_impossible_request_is_refused_in_words(call, error, says):
    with pytest.raises(error, match=says):
        call(library("rssr"))


@pytest.mark.parametrize("what", ["q", "v", "a"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_states_and_motions_are_made_of_numbers(what, value):
    motion = sp.sweep(library("rssr"), "crank", np.linspace(0.0, 1.0, 30), speed=1.0)
    wrong = {name: getattr(motion, name).copy() for name in ("q", "v", "a")}
    wrong[what][-1, 2] = value
    rows = {name: x[-1] for name, x in wrong.items()}
    with pytest.raises(ValueError, match=f"State: {what} has a value that is NaN or infinite"):
        sp.State(motion.mechanism, **rows, closure_error=0.0)
    with pytest.raises(ValueError, match=f"Motion: {what} has a value that is NaN or infinite"):
        replace(motion, **wrong)


def test_a_state_of_another_shape_is_refused_and_a_fast_one_is_not():
    mechanism = library("rssr")
    with pytest.raises(ValueError, match=r"State: q has shape \(3,\); \(6,\) is needed"):
        sp.State(mechanism, np.zeros(3), closure_error=0.0)
    fast = sp.State(mechanism, mechanism.neutral, np.full(5, 1e200), closure_error=0.0)
    assert fast.v[0] == 1e200


@pytest.mark.parametrize("name", ["delta", "stewart", "rssr"])
def test_calls_leave_nothing_to_the_collector(name):
    """Nothing that a call makes refers to itself: memory is free at once, without a pause."""
    mechanism = library(name)
    start = sp.assemble(mechanism)
    values = {d: start.coordinate(d).value + 0.02 for d in mechanism.drivers}

    def calls():
        state = sp.assemble(mechanism, values, start)
        sp.reach(mechanism, values, start)
        sp.assemble(mechanism, values)
        sp.solve_rates(mechanism, state, dict.fromkeys(values, 1.0))
        sp.influence(mechanism, state)
        sp.inverse_dynamics(mechanism, state)
        sp.forward_dynamics(mechanism, state)

    calls()
    gc.collect()
    gc.disable()
    left = []
    try:
        for _ in range(3):  # what earlier calls have left goes in one of them
            calls()
            left.append(gc.collect())
    finally:
        gc.enable()
    assert min(left) == 0
