"""What a mechanism should be like: mechanisms that are designed so are so."""

import itertools
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from crank_rockers import GROUND, TURN, least_transmission_of, swing_of

import spatial_pin as sp

goals = sp.goals
BOUNDS = {"r2": (0.02, 0.3), "r3": (0.05, 0.6), "r4": (0.05, 0.6)}


@cache
def four_bar():
    return sp.load("four_bar")


def designed(*asked, starts=1, bounds=BOUNDS, guess=None):
    found = sp.design(four_bar(), asked, bounds, starts=starts, guess=guess)
    assert len(found)
    return found[0]


def turned(design):
    state = design.states[0]
    own = state.coordinate("crank").value
    return sp.sweep(design.mechanism, "crank", own + TURN, guess=state)


def lengths(design):
    return tuple(design.dimensions[name] for name in ("r2", "r3", "r4"))


@pytest.mark.slow
def test_a_rocker_swings_as_far_as_requested():
    best = designed(goals.swing("rocker_pin", 1.0))
    assert swing_of(*lengths(best)) == pytest.approx(1.0, abs=1e-10)
    assert best.errors["swing of rocker_pin"].unit == "rad"


@pytest.mark.slow
def test_a_crank_rocker_of_given_swing_transmits_well_and_turns_fully():
    least = np.radians(40.0)
    best = designed(goals.swing("rocker_pin", 1.0), goals.transmission("rocker_pin", least),
                    goals.turns("crank"))
    assert swing_of(*lengths(best)) == pytest.approx(1.0, abs=1e-10)
    assert least_transmission_of(*lengths(best)) >= least - 1e-10
    assert sp.limits(best.mechanism, "crank", best.states[0]).full_turn
    assert "transmission to rocker_pin: met" in str(best)


@pytest.mark.slow
def test_a_function_that_is_met_as_well_as_transmission_allows_has_just_that_angle():
    phi, psi = np.radians([40.0, 85.0, 130.0]), np.radians([80.0, 100.0, 130.0])
    best = designed(goals.function("rocker_pin", psi, {"crank": phi}), goals.turns("crank"),
                    goals.transmission("rocker_pin", np.radians(40.0)))
    assert least_transmission_of(*lengths(best)) == pytest.approx(np.radians(40.0), abs=1e-9)
    assert 1e-3 < best.error < 1e-2
    free = designed(goals.function("rocker_pin", psi, {"crank": phi}))
    assert least_transmission_of(*lengths(free)) < np.radians(39.0) and free.error < 1e-12


def test_a_function_that_is_met_exactly_is_so_beside_one_that_is_not():
    """Augmented Lagrangians: the exact one is met, the other as well as it leaves freedom for."""
    exact = goals.function("rocker_pin", [1.6], {"crank": [1.0]}, weight=None)
    phi, psi = [0.4, 1.6, 2.2], [1.5, 1.9, 2.3]
    best = designed(exact, goals.function("rocker_pin", psi, {"crank": phi}),
                    bounds={"r2": (0.02, 0.3), "r4": (0.05, 0.6)})
    names = list(best.errors)
    assert best.errors[names[0]].most < 1e-10 and best.errors[names[1]].most > 1e-4
    x = np.array(list(best.dimensions.values()))
    for step in itertools.product((-1e-4, 1e-4), repeat=2):  # no better neighbour is exact
        other = sp.load("four_bar", **dict(zip(best.dimensions, x + step, strict=True)))
        missed = [sp.assemble(other, {"crank": p}, guess=best.states[0].q).coordinate(
            "rocker_pin").value - t for p, t in ((1.0, 1.6), *zip(phi, psi, strict=True))]
        assert np.sum(np.square(missed[1:])) > best.error**2 or abs(missed[0]) > 1e-6


def test_a_driver_is_made_to_turn_fully():
    """It does in a four-bar of Grashof's kind whose shortest link it is."""
    mechanism = sp.load("four_bar", r2=0.25)
    assert not sp.limits(mechanism, "crank").full_turn
    best = sp.design(mechanism, goals.turns("crank"), {"r2": (0.02, 0.4)}, method="local")[0]
    a, b, c = best.dimensions["r2"], 0.28, 0.24
    assert sp.limits(best.mechanism, "crank", best.states[0]).full_turn
    assert a + GROUND < b + c and a < min(b, c, GROUND)
    assert least_transmission_of(a, b, c) > np.radians(0.5)  # and is not about to be stopped


@pytest.mark.slow
def test_dead_centres_are_where_they_are_requested():
    asked = [0.5, 3.9]
    best = designed(goals.dead_centres("rocker_pin", asked), starts=2)
    found = sorted(event.value % (2.0 * np.pi)
                   for event in sp.dead_centres(turned(best), "rocker_pin"))
    assert found == pytest.approx(asked, abs=1e-9)


@pytest.mark.slow
def test_a_driver_needs_no_larger_effort_than_allowed():
    load = {"rocker_b": pin.Force(np.array([0.0, 0.0, -10.0, 0.0, 0.0, 0.0]))}
    best = designed(goals.effort(0.8, loads=load), goals.swing("rocker_pin", 0.5))
    needed = sp.kinetostatics(best.mechanism, turned(best), external=load).efforts["crank"]
    assert 0.4 < np.abs(needed).max() <= 0.8 + 1e-6


@pytest.mark.slow
def test_joints_stay_within_the_size_and_links_below_the_mass():
    best = designed(goals.swing("rocker_pin", 0.8), goals.turns(), goals.size(0.45),
                    goals.mass(2.0))
    motion = turned(best)
    points = np.array([motion.frame(name).position
                       for name in ("crank", "coupler_pin", "coupler_b", "rocker_pin")])
    assert np.linalg.norm(points[:, None] - points[None], axis=3).max() <= 0.45 + 1e-9
    assert sum(i.mass for i in list(best.mechanism.model.inertias)[1:]) <= 2.0 + 1e-9


def test_links_stay_apart_as_requested():
    values = np.linspace(0.5, 2.5, 5)
    wide = goals.clearance(0.2, [("crank", "rocker")], values=values)
    best = designed(wide, bounds={"r1": (0.2, 0.5)})
    motion = sp.sweep(best.mechanism, "crank", values, guess=best.states[0])
    assert sp.clearance(motion, [("crank", "rocker")]).least.distance >= 0.2 - 1e-9
    nominal = sp.load("four_bar")
    before = sp.clearance(sp.sweep(nominal, "crank", values), [("crank", "rocker")])
    assert before.least.distance < 0.19


def test_a_demand_at_given_values_is_judged_there_alone():
    poor = designed(goals.transmission("rocker_pin", np.radians(80.0), values=[1.0]))
    assert least_transmission_of(*lengths(poor)) < np.radians(70.0)
    there = sp.assemble(poor.mechanism, {"crank": 1.0}, guess=poor.states[0])
    assert sp.transmission(poor.mechanism, there, "rocker_pin").angle >= np.radians(80.0) - 1e-9


def test_what_cannot_be_met_leads_to_no_design():
    found = sp.design(four_bar(), [goals.swing("rocker_pin", 3.0), goals.turns("crank")],
                      {"r2": (0.05, 0.15)}, starts=1)
    assert not found and found.failed == 1 and found.starts == 1


@pytest.mark.parametrize(("goal", "error", "words"), [
    (lambda: goals.swing("rocker_pin", -1.0), ValueError, "angle"),
    (lambda: goals.transmission("rocker_pin", 2.0), ValueError, "pi/2 at most"),
    (lambda: goals.effort(0.0), ValueError, "at_most"),
    (lambda: goals.effort(1.0, loads={"rocker": [1.0]}), ValueError, "load at 'rocker'"),
    (lambda: goals.size(np.nan), ValueError, "at_most"),
    (lambda: goals.dead_centres("rocker_pin", []), ValueError, "driver values"),
    (lambda: goals.path("coupler_b", [[0.0, 1.0]], weight=0.0), ValueError, "weight"),
])
def test_numbers_that_cannot_be_are_refused_where_they_are_given(goal, error, words):
    with pytest.raises(error, match=words):
        goal()


@pytest.mark.parametrize(("goal", "words"), [
    (goals.swing("rocket", 1.0), "rocket"),
    (goals.turns("nobody"), "nobody"),
    (goals.effort(1.0, loads={"nothing": np.zeros(6)}), "nothing"),
    (goals.dead_centres("crank", [1.0]), "driver itself"),
    (goals.clearance(0.1, [("crank", "moon")]), "moon"),
])
def test_names_that_are_not_there_are_refused_before_work_begins(goal, words):
    with pytest.raises((ValueError, sp.UnknownNameError), match=words):
        sp.design(four_bar(), goal, BOUNDS)


def test_a_slide_cannot_turn_and_several_drivers_are_queried_separately():
    stewart = sp.load("stewart")
    with pytest.raises(ValueError, match="slides"):
        sp.design(stewart, goals.turns("leg_1"), [next(iter(stewart.dimensions))])
    with pytest.raises(ValueError, match="6 drivers"):
        sp.design(stewart, goals.size(1.0), [next(iter(stewart.dimensions))])
