"""Messages: each tells the one cause that is true, by name and number, and what to do."""

import ast
import re

import mechanisms as known
import numpy as np
import odd_mechanisms as odd
import pinocchio as pin
import pytest
from ladders import two_rods, uniform
from masses import heavy

import spatial_pin as sp

FORMULATIONS = ("independent", "projected")


def refusal(call, kind=sp.SpatialPinError):
    """Return the words of the error that a call raises."""
    with pytest.raises(kind) as caught:
        call()
    return str(caught.value)


# ---------------------------------------------------------------- where a simulation ends


CAUSES = ("lose rank", "masses differ", "grow without bound", "jumps")


def only(cause, text):
    assert [c for c in CAUSES if c in text] == [cause], text


def bead(folder):
    tree = heavy(known.sliding("s", "ground", "bead", axis=(1, 0, 0)), bead=uniform(1.0, 1.0))
    return known.load(folder, "bead", tree, "gravity = [0.0, 0.0, 0.0]\n")


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("law, until", [
    (lambda t, s: {"s": -1.0 / max(s.q[0] ** 2, 1e-300)}, "1.110720"),
    (lambda t, s: {"s": float(s.v[0]) ** 2}, "1 s"),
])
def test_a_force_without_bound_ends_the_motion_as_such(law, until, formulation, tmp_path):
    """A bead falls into a centre after pi/sqrt(8) s; one that speed drives is gone after 1 s."""
    mech = bead(tmp_path)
    speed = 0.0 if until.startswith("1.11") else 1.0
    state = sp.solve_rates(mech, sp.assemble(mech, {"s": 1.0}), {"s": speed})
    text = refusal(lambda: sp.simulate(mech, state, 3.0, efforts=law, accuracy=sp.Accuracy(
        formulation=formulation)), sp.SingularError)
    only("grow without bound", text)
    assert f"beyond {until}" in text and "s is accelerated by" in text and "N at s" in text


def test_masses_are_not_blamed_for_an_effort_that_explodes():
    """Round-off of huge turns makes accelerations doubtful, whatever the masses are."""
    mech = sp.load("screw_press")
    text = refusal(lambda: sp.simulate(
        mech, sp.assemble(mech), 3.0, efforts=lambda t, s: {"screw": 10 * np.exp(60 * t)},
        accuracy=sp.Accuracy(formulation="projected", most_steps=1500)), sp.SingularError)
    only("grow without bound", text)


@pytest.mark.slow
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_masses_that_differ_too_much_are_named(formulation, tmp_path):
    mech = two_rods(tmp_path, 1e20)
    text = refusal(lambda: sp.simulate(
        mech, sp.assemble(mech, {"p": 0.3, "k": 0.7}), 0.8,
        accuracy=sp.Accuracy(formulation=formulation)), sp.SingularError)
    only("masses differ", text)
    assert "1 kg (moved by joint 'p')" in text and "1e+20 kg (moved by joint 'k')" in text


@pytest.mark.delicate
@pytest.mark.parametrize("name, formulation", [
    pytest.param("delta", "independent", marks=pytest.mark.slow), ("stewart", "independent"),
    pytest.param("stewart", "projected", marks=pytest.mark.slow)])
def test_loops_that_lose_rank_end_the_motion_as_such(name, formulation):
    mech = sp.load(name)
    text = refusal(lambda: sp.simulate(mech, sp.assemble(mech), 2.0, accuracy=sp.Accuracy(
        formulation=formulation)), sp.SingularError)
    only("lose rank", text)
    assert "smallest singular value has fallen from" in text and "sp.mobility" in text


@pytest.mark.delicate
@pytest.mark.parametrize("name, until", [("stewart", 0.297525), ("sarrus", 0.164032)])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-8, *(
    pytest.param(x, marks=pytest.mark.slow) for x in (1e-6, 1e-9, 1e-10, 1e-11))])
def test_no_step_of_the_projected_formulation_leaps_over_a_loss_of_rank(name, until, tolerance):
    """That of sarrus is flat: the determinant has the same sign on both sides."""
    mech = sp.load(name)
    with pytest.raises(sp.SingularError) as caught:
        sp.simulate(mech, sp.assemble(mech), 2.0, accuracy=sp.Accuracy(
            formulation="projected", time_tolerance=tolerance))
    only("lose rank", str(caught.value))
    assert until - 2e-3 < caught.value.motion.time[-1] < until


def test_sarrus_is_flat_when_its_energy_says():
    """The time above, without a simulation: links fall as fast as their lost height allows."""
    mech = sp.load("sarrus")
    data = mech.model.createData()

    def energies(arm):
        state = sp.solve_rates(mech, sp.assemble(mech, {"arm": arm}), {"arm": 1.0})
        return (pin.computeKineticEnergy(mech.model, data, state.q, state.v),
                pin.computePotentialEnergy(mech.model, data, state.q))

    start = sp.assemble(mech).coordinate("arm").value
    height = energies(start)[1]

    def slowness(root):  # of arm = start - root**2: finite at rest
        kinetic, potential = energies(start - root**2)
        return 2.0 * root * np.sqrt(kinetic / (height - potential))

    roots, weights = np.polynomial.legendre.leggauss(40)
    end = np.sqrt(start)
    time = 0.5 * end * sum(w * slowness(0.5 * end * (x + 1.0))
                           for x, w in zip(roots, weights, strict=True))
    assert time == pytest.approx(0.164032, abs=1e-6)


@pytest.mark.delicate
def test_a_prescribed_coordinate_ends_at_its_limit_position():
    """The rocker of a four-bar turns back; nothing is wrong with masses or forces there."""
    mech = sp.load("four_bar")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"rocker_pin": 1.0})
    law = sp.laws.constant_speed(state.coordinate("rocker_pin").value, 1.0)
    text = refusal(lambda: sp.simulate(mech, state, 3.0, drives={"rocker_pin": law}),
                   sp.SingularError)
    only("lose rank", text)
    assert "limit position of the prescribed rocker_pin" in text


# ---------------------------------------------------------------- axes the wrong way round


def hinged_bar(folder, turned=0.0, kind="revolute"):
    """A bar that `roll` turns about itself, with a seat for its end, whose axis is z at turn 0."""
    tree = known.turning("roll", "ground", "bar", axis=(1, 0, 0))
    tree += known.point("end", "bar", (0.2, 0, 0))
    tree += known.point("seat", "ground", (0.2, 0, 0), (turned, 0, 0))
    return known.load(folder, "bar", tree, known.closure("hinge", kind, "end", "seat")
                      + known.driver("roll", "roll"))


def test_a_value_out_of_reach_is_not_called_a_reversed_frame(tmp_path):
    mech = hinged_bar(tmp_path)
    text = refusal(lambda: sp.assemble(mech, {"roll": np.pi}), sp.AssemblyError)
    assert "out of reach" in text and "the loops close at roll = " in text
    assert "turn one" not in text
    assert sp.assemble(mech, {"roll": 0.0}).closure_error < 1e-12


@pytest.mark.parametrize("kind", ["revolute", "cylindrical"])
def test_a_reversed_frame_is_reported_and_turning_it_helps(kind, tmp_path):
    """A bar about z reaches its seat at any height, but with its own z axis only."""
    def pinned(turned):
        tree = known.turning("pin", "ground", "bar") + known.point("end", "bar", (0.2, 0, 0))
        tree += known.point("seat", "ground", (0.2, 0, 0), (turned, 0, 0))
        return known.load(tmp_path, f"pinned_{turned:.0f}", tree,
                          known.closure("hinge", kind, "end", "seat") + known.driver("pin", "pin"))

    text = refusal(lambda: sp.assemble(pinned(np.pi), {"pin": 0.0}), sp.AssemblyError)
    assert "turn one of its frames round, by half a turn about its x axis" in text
    assert "out of reach" not in text
    assert sp.assemble(pinned(0.0), {"pin": 0.0}).closure_error < 1e-12


def test_two_reversed_closures_are_both_named(tmp_path):
    tree = known.turning("pin", "ground", "bar") + known.point("end", "bar", (0.2, 0, 0))
    tree += known.point("hole", "bar", (0.1, 0, 0))
    for at, seat in ((0.2, "far"), (0.1, "near")):
        tree += known.point(seat, "ground", (at, 0, 0), (np.pi, 0, 0))
    mech = known.load(tmp_path, "two", tree, known.closure("one", "revolute", "end", "far")
                      + known.closure("other", "revolute", "hole", "near"))
    text = refusal(lambda: sp.assemble(mech), sp.AssemblyError)
    assert "'one' and 'other'" in text and "turn one frame of each round" in text


def test_interchanged_axes_are_not_cured_by_half_a_turn(tmp_path):
    """A fixed closure whose frames differ by a third of a turn about (1, 1, 1)."""
    tree = known.turning("pin", "ground", "bar") + known.point("end", "bar", (0.2, 0, 0))
    tree += known.point("seat", "ground", (0.2, 0, 0), (np.pi / 2, 0, np.pi / 2))
    mech = known.load(tmp_path, "third", tree, known.closure("weld", "fixed", "end", "seat"))
    text = refusal(lambda: sp.assemble(mech), sp.AssemblyError)
    assert "interchanged" in text and "half a turn" not in text


# ---------------------------------------------------------------- too many or too few prescribed


def example_of(text):
    """Return the mapping of names to values that a message gives as an example."""
    return ast.literal_eval(re.search(r"\{.*?\}", text)[0])


@pytest.mark.delicate
def test_too_few_prescribed_coordinates_name_those_that_would_do():
    """The example given is one that works: components of a pose too."""
    mech = sp.load("delta")
    state = sp.assemble(mech)
    text = refusal(lambda: sp.sweep(mech, "pose.x", [0.0, 0.01]), sp.SingularError)
    assert "'pose.x' is prescribed, and 2 of its freedoms are not prescribed" in text
    more = example_of(text)
    assert len(more) == 2 and set(more) <= set(mech.coordinates)
    moved = sp.solve_rates(mech, state, {"pose.x": 1.0, **more})
    assert moved.coordinate("pose.x").rate == pytest.approx(1.0)
    assert len(sp.sweep(mech, "pose.x", [0.0, 0.01], hold={
        name: state.coordinate(name).value for name in more})) == 2


@pytest.mark.delicate
def test_too_many_prescribed_coordinates_tell_how_many_to_leave_out():
    mech = sp.load("rssr")
    text = refusal(lambda: sp.solve_rates(mech, sp.assemble(mech), {"ball_a": [0.0, 0.0, 1.0]}))
    assert "has 1 freedom there; prescribe fewer: leave out 2" in text


def test_components_tell_where_they_can_be_prescribed_and_where_not():
    mech = sp.load("rssr")
    state = sp.assemble(mech)
    text = refusal(lambda: sp.simulate(mech, state, 0.1, efforts={"ball_a.x": 1.0}))
    assert "it can be prescribed in assemble, sweep and solve_rates" in text
    assert sp.solve_rates(mech, state, example_of(text)).coordinate(
        "ball_a.x").rate == pytest.approx(0.1, rel=1e-15)  # in which all three entries have a part
    text = refusal(lambda: sp.assemble(mech, {"ball_a": 0.1}))
    assert "ball_a.x, ball_a.y, ball_a.z" in text
    assert sp.assemble(mech, example_of(text), free=["crank"]).coordinate(
        "ball_a.x").value == pytest.approx(0.1)


# ---------------------------------------------------------------- loops that stay open


def bars(folder, name, coupler, rocker, toml=""):
    """A four-bar of crank 0.1 on a base of 0.3."""
    tree = (known.turning("a", "ground", "crank")
            + known.turning("b", "crank", "coupler", (0.1, 0, 0))
            + known.turning("c", "ground", "rocker", (0.3, 0, 0))
            + known.point("end", "coupler", (coupler, 0, 0))
            + known.point("eye", "rocker", (rocker, 0, 0)))
    return known.load(folder, name, tree, known.closure("pin", "revolute", "end", "eye")
                      + known.driver("crank", "a") + toml)


def test_links_too_short_to_meet_are_not_called_a_value_out_of_reach(tmp_path):
    mech = bars(tmp_path, "short", 0.05, 0.04)
    for drivers in (None, {"crank": 1.0}):
        text = refusal(lambda d=drivers: sp.assemble(mech, d), sp.AssemblyError)
        assert "check the frames of 'pin' and the lengths between them" in text
        assert "out of reach" not in text


def test_a_value_out_of_reach_is_reported_with_one_in_reach(tmp_path):
    mech = bars(tmp_path, "rocks", 0.28, 0.24)
    text = refusal(lambda: sp.assemble(mech, {"c": 0.5}), sp.AssemblyError)
    assert "a value is out of reach: left free, the loops close at c = " in text
    value = float(re.search(r"close at c = ([-+.\de]+)", text)[1])
    assert sp.assemble(mech, {"c": value}).closure_error < 1e-11


def test_more_values_than_freedoms_are_counted(tmp_path):
    mech = bars(tmp_path, "many", 0.28, 0.24)
    text = refusal(lambda: sp.assemble(mech, {"a": 0.3, "b": 0.2}), sp.AssemblyError)
    assert "2 coordinates have a value, but the mechanism has 1 freedom: leave out 1" in text


# ---------------------------------------------------------------- singular configurations


@pytest.mark.delicate
def test_a_dead_centre_is_named():
    """A slider at the end of its stroke."""
    mech = sp.load("slider_crank")
    state = sp.assemble(mech, {"crank": 0.0})
    text = refusal(lambda: sp.solve_rates(mech, state, {"slide": 1.0}))
    assert "'slide' is at a limit position" in text and "crank_pin" not in text


@pytest.mark.delicate
def test_coordinates_that_move_together_depend_on_each_other(tmp_path):
    """Crank and rocker of one four-bar are prescribed, none of the arm beside it."""
    tree = (known.turning("a", "ground", "crank")
            + known.turning("b", "crank", "coupler", (0.1, 0, 0))
            + known.turning("c", "ground", "rocker", (0.3, 0, 0))
            + known.point("end", "coupler", (0.28, 0, 0))
            + known.point("eye", "rocker", (0.24, 0, 0)) + known.turning("arm", "ground", "side"))
    mech = known.load(tmp_path, "beside", tree, known.closure("pin", "revolute", "end", "eye"))
    state = sp.assemble(mech, {"a": 1.0})
    text = refusal(lambda: sp.solve_rates(mech, state, {"a": 1.0, "c": 1.0}))
    assert "the prescribed 'a', 'c' depend on each other" in text and "dead centre" not in text


@pytest.mark.delicate
def test_a_passive_table_of_a_link_that_cannot_spin_is_named(tmp_path):
    tree = (known.turning("a", "ground", "crank")
            + known.turning("b", "crank", "coupler", (1, 0, 0))
            + known.turning("c", "ground", "rocker", (3, 0, 0))
            + known.point("end", "coupler", (2.8, 0, 0))
            + known.point("eye", "rocker", (2.4, 0, 0)))
    mech = known.load(tmp_path, "still", tree, known.closure("pin", "revolute", "end", "eye")
                      + known.driver("a", "a")
                      + '[passive.spin]\nbody = "coupler"\naxis = ["b", "end"]\n')
    state = sp.assemble(mech, {"a": 1.0})
    text = refusal(lambda: sp.solve_rates(mech, state, {"a": 1.0}))
    assert "passive 'spin': no rotation of the body about that line is free" in text


@pytest.mark.delicate
def test_branches_that_cross_are_distinguished_from_what_only_shakes(tmp_path):
    flat = known.bare_four_bar(tmp_path, 0.3, 0.1, 0.3, 0.1)
    state = sp.assemble(flat, {"crank": 0.0}, guess={"rocker_pin": 0.0})
    text = refusal(lambda: sp.solve_rates(flat, state, {"crank": 1.0}), sp.SingularError)
    assert "branches cross, so that the drivers do not determine the motion; start beside" in text
    assert "instantaneous" not in text
    truss = odd.flat_truss(tmp_path, size=1.0)
    text = refusal(lambda: sp.solve_rates(truss, sp.assemble(truss), {"a": 1.0}), sp.SingularError)
    assert "nothing can move: 1 freedom is instantaneous only" in text
    assert "branches" not in text


# ---------------------------------------------------------------- values and choices


@pytest.mark.delicate
def test_a_crossing_that_was_to_be_refused_says_so(tmp_path):
    flat = known.bare_four_bar(tmp_path, 0.3, 0.1, 0.3, 0.1)
    text = refusal(lambda: sp.sweep(
        flat, "crank", np.linspace(0.5, 4.0, 30), on_crossing="raise",
        guess={"crank": 0.5, "rocker_pin": 0.5}), sp.SingularError)
    assert "branches cross at crank = 3.14159" in text
    assert "on_crossing='raise' asks to stop there; give on_crossing='straight'" in text


@pytest.mark.slow
def test_a_value_beyond_its_own_limit_is_reported_as_such():
    mech = sp.load("stewart")
    text = refusal(lambda: sp.assemble(mech, {"leg_1": 5.0}, limits=True), sp.AssemblyError)
    assert "that is the value given: give one within its limits" in text


def test_one_number_is_requested_in_words():
    mech = sp.load("four_bar")
    text = refusal(lambda: sp.solve_rates(mech, sp.assemble(mech), {"crank": [1.0, 2.0]}),
                   ValueError)
    assert text == "speed of 'crank' has shape (2,); a single number is needed"


@pytest.mark.parametrize("weight", [0.0, -1.0])
def test_weights_and_deviations_that_are_wrong_are_named(weight):
    mech = sp.load("four_bar")
    state = sp.assemble(mech)
    text = refusal(lambda: sp.inverse_dynamics(mech, state, {"crank": weight}), ValueError)
    assert text.startswith(f"weight of 'crank' is {weight}; it must be positive")
    text = refusal(lambda: sp.tolerance(mech, "rocker_pin", {"r2": -1e-4}, state), ValueError)
    assert text == "deviation of 'r2' is -0.0001; it cannot be negative"
