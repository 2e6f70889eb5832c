"""Circuit, branch, order and transmission of synthesised mechanisms, against closed forms."""

from functools import cache
from math import acos, atan2, cos, hypot, pi, sin

import numpy as np
import pinocchio as pin
import pytest
from crank_rockers import ends, limited_four_bar, of_limits
from variety import few, first

import spatial_pin as sp
from spatial_pin.synthesis.defects import Circuit, defects
from spatial_pin.synthesis.demand import Candidate, in_own_turn

CRANK_ROCKER = {"r1": 0.30, "r2": 0.10, "r3": 0.28, "r4": 0.24}
TRIPLE_ROCKER = {"r1": 0.30, "r2": 0.20, "r3": 0.15, "r4": 0.20}
PARALLELOGRAM = {"r1": 0.30, "r2": 0.20, "r3": 0.30, "r4": 0.20}
# limits of its crank at cos = (a² + D² - b²) / (2 a D), D = d + c and d - c
RSSR = {"a": 0.30, "b": 0.35, "c": 0.10, "d": 0.30}


@cache
def loaded(name, **dimensions):
    return sp.load(name, **dimensions)


def four_bar(dimensions, *points):
    """Return the linkage and its states at (crank, side): the coupler left (1) or right (-1)."""
    r1, r2, r3, r4 = dimensions.values()
    mechanism = loaded("four_bar", **dimensions)
    states = []
    for phi, side in points:
        x, z = r2 * cos(phi), r2 * sin(phi)
        d = hypot(r1 - x, z)
        coupler = atan2(-z, r1 - x) + side * acos((r3**2 + d**2 - r4**2) / (2 * r3 * d))
        rocker = atan2(z + r3 * sin(coupler), x + r3 * cos(coupler) - r1)
        states.append(sp.assemble(mechanism, {"crank": phi}, guess={
            "crank_pin": phi, "coupler_pin": coupler - phi, "rocker_pin": rocker}))
        assert states[-1].coordinate("rocker_pin").value == pytest.approx(rocker, abs=1e-12)
    return mechanism, states


def rssr(dimensions, *points):
    """Return the linkage and its states at (crank, side of the rocker)."""
    a, b, c, d = dimensions.values()
    mechanism = loaded("rssr", **dimensions)
    states = []
    for phi, side in points:
        psi = side * acos((b**2 - a**2 - c**2 - d**2 + 2 * a * d * cos(phi))
                          / (2 * c * (d - a * cos(phi))))
        states.append(sp.assemble(mechanism, {"crank": phi}, guess={
            "crank_pin": phi, "rocker_pin": psi}))
        assert states[-1].coordinate("rocker_pin").value == pytest.approx(psi, abs=1e-12)
    return mechanism, states


def kinds(found):
    return [(defect.kind, defect.samples) for defect in found]


def without(found, *others):
    return [x for x in kinds(found) if x[0] not in others]


def limit_of(dimensions):
    """Return the crank angle of the triple rocker's limit, where coupler and rocker are in line."""
    r1, r2, r3, r4 = dimensions.values()
    return acos((r1**2 + r2**2 - (r3 + r4) ** 2) / (2 * r1 * r2))


def test_a_crank_rocker_that_is_met_in_order_has_no_defect():
    mechanism, states = four_bar(CRANK_ROCKER, (0.5, 1), (1.0, 1), (2.0, 1))
    assert defects(mechanism, states) == ()


def test_both_sides_of_a_crank_rocker_are_two_circuits():
    mechanism, states = four_bar(CRANK_ROCKER, (0.5, 1), (1.0, -1), (2.0, 1))
    assert without(defects(mechanism, states), "transmission") == [("circuit", (0, 1, 2))]
    words = defects(mechanism, states)[0].text
    assert words == ("samples 0, 2 on one; sample 1 on another circuit: the loops would have to "
                     "be opened between them")


def test_both_sides_of_a_triple_rocker_are_two_branches_of_one_circuit():
    mechanism, states = four_bar(TRIPLE_ROCKER, (0.9, 1), (1.1, -1), (1.0, 1))
    found = defects(mechanism, states)
    assert without(found, "transmission") == [("branch", (0, 1, 2))]
    limit = limit_of(TRIPLE_ROCKER)
    assert f"{limit:.6g}" in found[0].text and f"{-limit:.6g}" in found[0].text


def test_the_borders_of_a_triple_rocker_are_its_closed_form_limits():
    mechanism, states = four_bar(TRIPLE_ROCKER, (0.9, 1))
    circuit = Circuit(mechanism, "crank", states[0])
    limit = limit_of(TRIPLE_ROCKER)
    borders = sorted(event.value for event in circuit.borders)
    assert borders == pytest.approx([-limit, limit], abs=1e-12)
    assert circuit.is_closed and not circuit.turns_fully and abs(circuit.turn) < 1e-12


@pytest.mark.parametrize(("start", "side"), first(2, [
    (0.0, 1), (0.7, -1), (0.0, -1), (0.7, 1), (1.5, 1), (1.5, -1)]))
def test_every_place_of_a_triple_rocker_is_on_the_branch_of_its_side(start, side):
    limit = limit_of(TRIPLE_ROCKER)
    points = [(phi, s) for s in (1, -1) for phi in np.linspace(-limit + 1e-3, limit - 1e-3, 23)]
    mechanism, states = four_bar(TRIPLE_ROCKER, (start, side), *points)
    circuit = Circuit(mechanism, "crank", states[0])
    places = [circuit.position(state) for state in states]
    assert all(place is not None and len(place[1]) == 1 for place in places)
    values, branches = zip(*places, strict=True)
    sides = [side] + [s for _, s in points]
    assert len({on for on, s in zip(branches, sides, strict=True) if s == 1}) == 1
    assert len({on for on, s in zip(branches, sides, strict=True) if s == -1}) == 1
    assert len({*branches}) == 2
    assert list(values) == pytest.approx([start] + [phi for phi, _ in points], abs=1e-9)


def test_the_last_piece_of_a_closed_curve_is_counted_with_the_first():
    mechanism, states = four_bar(TRIPLE_ROCKER, (0.9, 1))
    circuit = Circuit(mechanism, "crank", states[0])
    circuit.turn = 2.0 * pi  # of a driver that has gone round once between its borders
    numbers, values = circuit._numbered(np.array([0, 1, 2]), np.array([0.5, 3.0, 6.0]))
    assert numbers.tolist() == [0, 1, 0]
    assert values == pytest.approx([0.5, 3.0, 6.0 - 2.0 * pi])


def test_a_place_just_at_a_limit_is_on_both_branches():
    limit = limit_of(TRIPLE_ROCKER)
    mechanism, states = four_bar(TRIPLE_ROCKER, (0.9, 1))
    ends = sp.sweep(mechanism, "crank", [0.9, limit - 1e-14], guess=states[0], on_limit="stop")
    circuit = Circuit(mechanism, "crank", states[0])
    assert len(circuit.position(ends.state(-1))[1]) == 2


@pytest.mark.parametrize("values", few(
    [(0.5, 1.0, 2.0), (2.0, 1.0, 0.5), (5.0, 6.0, 0.5), (0.5, 6.0, 5.0), (1.0, 2.0)],
    (2.0, 1.0, 0.5), (5.0, 6.0, 0.5)))
def test_a_crank_meets_points_in_order_either_way_round(values):
    mechanism, states = four_bar(CRANK_ROCKER, *[(phi, 1) for phi in values])
    assert without(defects(mechanism, states), "transmission") == []


def test_points_out_of_order_are_named():
    mechanism, states = four_bar(CRANK_ROCKER, *[(phi, 1) for phi in (0.0, 1.0, 3.0, 2.0, 4.0)])
    found = [x for x in defects(mechanism, states) if x.kind == "order"]
    assert len(found) == 1 and found[0].samples in ((2,), (3,))
    assert found[0].text == "crank meets the samples in the order 0, 1, 3, 2, 4"
    assert not [x for x in defects(mechanism, states, ordered=False) if x.kind == "order"]


def test_order_on_a_branch_with_limits_is_that_of_the_driver():
    limit = limit_of(TRIPLE_ROCKER)
    values = (-0.5 * limit, 0.2, 0.8 * limit, 0.5)
    mechanism, states = four_bar(TRIPLE_ROCKER, *[(phi, 1) for phi in values])
    found = without(defects(mechanism, states), "transmission")
    assert found == [("order", (3,))] or found == [("order", (2,))]


def transmission(phi, r1, r2, r3, r4):
    d2 = r1**2 + r2**2 - 2 * r1 * r2 * np.cos(phi)
    mu = np.arccos((r3**2 + r4**2 - d2) / (2 * r3 * r4))
    return np.minimum(mu, pi - mu)


def test_the_least_transmission_angle_is_that_of_the_range_that_is_used():
    mechanism, states = four_bar(CRANK_ROCKER, (0.9, 1), (0.2, 1), (-0.9, 1))
    least = transmission(0.0, *CRANK_ROCKER.values())
    between = transmission(np.array([0.9, 0.2, -0.9]), *CRANK_ROCKER.values())
    threshold = 0.5 * (least + between.min())
    found = defects(mechanism, states, least_angle=float(threshold))
    assert kinds(found) == [("transmission", ())]
    assert f"falls to {np.degrees(least):.3g}°" in found[0].text
    assert f"{np.degrees(threshold):.3g}° are required" in found[0].text
    assert defects(mechanism, states, least_angle=float(least) - 1e-3) == ()


def test_a_cyclic_use_of_a_full_turn_is_all_of_it():
    mechanism, states = four_bar(CRANK_ROCKER, (1.5, 1), (2.0, 1), (2.5, 1))
    least = transmission(np.array([0.0, pi]), *CRANK_ROCKER.values()).min()
    assert defects(mechanism, states, least_angle=float(least) + 0.05) == ()
    found = defects(mechanism, states, least_angle=float(least) + 0.05, cyclic=True)
    assert kinds(found) == [("transmission", ())]


def test_samples_with_a_poor_angle_are_named():
    mechanism, states = four_bar(CRANK_ROCKER, (0.0, 1), (1.5, 1))
    angles = transmission(np.array([0.0, 1.5]), *CRANK_ROCKER.values())
    assert angles[0] < angles[1]
    found = defects(mechanism, states, least_angle=float(angles.mean()))
    assert kinds(found) == [("transmission", (0,))]


def test_the_sides_of_a_parallelogram_meet_at_branch_points():
    mechanism, states = four_bar(PARALLELOGRAM, (0.8, 1), (1.2, -1))
    found = defects(mechanism, states)
    assert without(found, "transmission") == [("branch", (0, 1))]
    assert "branch points" in found[0].text


def test_a_parallelogram_on_one_side_of_its_branch_points_has_no_defect():
    mechanism, states = four_bar(PARALLELOGRAM, (0.8, 1), (1.2, 1), (2.0, 1))
    assert defects(mechanism, states, least_angle=0.1) == ()
    mechanism, states = four_bar(PARALLELOGRAM, (2.8, 1), (3.5, -1))
    assert without(defects(mechanism, states), "transmission") == [("branch", (0, 1))]


def test_the_mirrored_rockers_of_an_rssr_are_two_branches():
    mechanism, states = rssr(RSSR, (1.2, 1), (1.3, -1))
    found = defects(mechanism, states)
    assert without(found, "transmission") == [("branch", (0, 1))]
    limits = [acos((0.3**2 + D**2 - 0.35**2) / (0.6 * D)) for D in (0.4, 0.2)]
    assert all(f"{x:.6g}" in found[0].text for x in limits)


def test_an_rssr_has_circuits_that_are_not_connected():
    mechanism, states = rssr(RSSR, (1.2, 1), (-1.2, 1))
    assert without(defects(mechanism, states), "transmission") == [("circuit", (0, 1))]
    dimensions = {"a": 0.102, "b": 0.381, "c": 0.254, "d": 0.314}
    mechanism, states = rssr(dimensions, (0.2, 1), (1.2, 1), (2.0, -1))
    assert without(defects(mechanism, states), "transmission") == [("circuit", (0, 1, 2))]


def test_a_coupler_that_spins_is_the_same_place():
    """The ball joint's coordinates differ by a turn of the coupler about its own axis."""
    dimensions = {"a": 0.102, "b": 0.381, "c": 0.254, "d": 0.314}
    mechanism, states = rssr(dimensions, (0.2, 1), (1.2, 1), (2.0, 1))
    turned = []
    for k, state in enumerate(states):
        axis = state.placement("coupler").rotation.T @ (
            state.placement("coupler_b").translation - state.placement("coupler").translation)
        turn = pin.SE3(pin.AngleAxis(0.7 * k, axis / np.linalg.norm(axis)).matrix(), np.zeros(3))
        q = np.array(state.q)
        at = mechanism.model.idx_qs[mechanism.joint_id("ball_a")]
        before = pin.Quaternion(*[q[at + 3], *q[at : at + 3]])
        q[at : at + 4] = (before * pin.Quaternion(turn.rotation)).coeffs()
        turned.append(sp.State(mechanism, q, closure_error=0.0))
    assert without(defects(mechanism, turned), "transmission") == []


@pytest.mark.parametrize("name", few(
    ["rssr", "rssr_crossed", "bennett", "spherical_four_bar", "watt_six_bar", "geared_five_bar",
     "inverted_slider_crank"], "rssr", "bennett", "watt_six_bar"))
def test_what_a_sweep_leads_to_is_one_circuit_and_branch_in_order(name):
    mechanism = sp.load(name)
    driver = next(iter(mechanism.drivers))
    motion = sp.sweep(mechanism, driver, np.linspace(-1.0, 1.0, 7), guess=sp.assemble(mechanism))
    found = defects(mechanism, [motion.state(k) for k in range(7)], driver, output=None)
    assert not {x.kind for x in found} & {"circuit", "branch", "order"}


def test_a_screw_does_not_come_back_after_a_turn():
    """It is a lead further on, a part of a step of the curve."""
    mechanism = sp.load("screw_press")
    states = [sp.assemble(mechanism, {"screw": x}) for x in (0.0, 7.0, 20.0)]
    driver = next(iter(mechanism.drivers))
    assert not Circuit(mechanism, driver, states[0]).is_closed
    assert "circuit" not in {x.kind for x in defects(mechanism, states, driver)}


def test_what_is_not_judged_is_stated():
    platform = sp.load("stewart")
    states = [sp.assemble(platform)] * 2
    found = defects(platform, states)
    assert kinds(found) == [("not judged", (0, 1))]
    assert "6 drivers move, and these are of motions by one" in found[0].text
    assert defects(platform, []) == ()
    six_bar = sp.load("watt_six_bar")
    found = defects(six_bar, [sp.assemble(six_bar, {"crank": x}) for x in (0.0, 0.2)])
    assert kinds(found) == [("not judged", (0, 1))] and "transmission" in found[0].text


def test_another_driver_that_moves_is_not_judged():
    mechanism = sp.load("delta")
    names = list(mechanism.drivers)
    states = [sp.assemble(mechanism), sp.assemble(mechanism, {names[1]: 0.05})]
    found = defects(mechanism, states, names[0])
    assert [x.kind for x in found] == ["not judged"] and "moves besides" in found[0].text


def test_an_unknown_output_is_refused():
    mechanism, states = four_bar(CRANK_ROCKER, (0.5, 1), (1.0, 1))
    with pytest.raises(sp.UnknownNameError):
        defects(mechanism, states, output="rocker")
    with pytest.raises(sp.UnknownNameError):
        defects(mechanism, states, "cranks")


def test_a_coordinate_that_leads_instead_of_the_driver_is_judged():
    """The rocker cannot lead across its dead centres, where the crank is in line."""
    mechanism, states = four_bar(CRANK_ROCKER, (0.9, 1), (2.0, 1), (5.0, 1))
    assert kinds(defects(mechanism, states[:2], "rocker_pin", least_angle=0.01)) == []
    found = defects(mechanism, states, "rocker_pin", output="crank_pin", least_angle=0.01)
    assert ("branch", (0, 1, 2)) in kinds(found)


goals = sp.goals


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """Return what loads the four-bar with limits of its rocker."""
    return limited_four_bar(tmp_path_factory.mktemp("limited"))


def at(mechanism, *cranks):
    return [sp.assemble(mechanism, {"crank": crank}) for crank in cranks]


def rocker(state):
    return state.coordinate("rocker_pin").value


def test_no_limit_that_is_kept_is_named(limited):
    least, most = ends()
    mechanism = limited(least - 1e-6, most + 1e-6)
    assert defects(mechanism, at(mechanism, 0.5, 3.0), cyclic=True) == ()


def test_a_limit_that_is_passed_on_the_way_is_named_with_where_and_how_far(limited):
    """Both samples are within it; the rocker turns back between them."""
    _, most = ends()
    mechanism = limited(1.0, most - 0.01)
    free = sp.load("four_bar")
    turn = sp.sweep(free, "crank", np.linspace(0.0, 2.0 * np.pi, 3601))
    highest = turn.driver[np.argmax(turn.coordinate("rocker_pin").value)]
    states = at(mechanism, highest - 0.8, highest + 0.8)
    assert not any(state.beyond_limits for state in states)
    (found,) = of_limits(defects(mechanism, states))
    assert found.samples == (0, 1)
    assert f"upper limit {most - 0.01:.9g} rad of rocker_pin is passed at crank = " in found.text
    assert ", by up to 0.01 rad" in found.text
    where = float(found.text.partition("crank = ")[2].partition(" ")[0])
    assert rocker(sp.assemble(free, {"crank": where})) == pytest.approx(most - 0.01, abs=1e-10)


def test_a_limit_that_is_passed_elsewhere_counts_where_the_driver_goes_all_the_way_round(limited):
    _, most = ends()
    mechanism = limited(1.0, most - 0.01)
    free = sp.load("four_bar")
    low = [x for x in np.linspace(0.0, 6.0, 25)
           if rocker(sp.assemble(free, {"crank": x})) < most - 0.3]
    states = at(mechanism, low[0], low[1])
    assert not of_limits(defects(mechanism, states))
    assert len(of_limits(defects(mechanism, states, cyclic=True))) == 1


def test_samples_beyond_a_limit_are_named(limited):
    angles = [rocker(state) for state in at(sp.load("four_bar"), 0.5, 2.0)]
    mechanism = limited(0.1, 0.5 * sum(angles))
    with pytest.warns(sp.SpatialPinWarning, match="beyond joint limits"):
        states = at(mechanism, 0.5, 2.0)
    beyond = int(np.argmax(angles))
    (found,) = of_limits(defects(mechanism, states))
    assert found.samples == (beyond,)
    assert found.text.startswith(f"sample {beyond} is beyond the upper limit")


def test_a_joint_that_stands_a_turn_away_is_not_beyond_its_limit(limited):
    mechanism = limited(0.0, 3.0)
    state = sp.assemble(mechanism, {"crank": 1.0})
    place, q = mechanism.coordinate("rocker_pin").q, state.q.copy()
    for turns in (-2, -1, 1):
        q[place] = state.q[place] + 2.0 * np.pi * turns
        np.testing.assert_allclose(in_own_turn(mechanism, q), state.q, atol=1e-14)
        assert in_own_turn(mechanism, q, ["rocker_pin"])[place] == q[place]


def test_how_far_joints_are_beyond_is_the_number_of_the_demand(limited):
    least, most = ends()
    mechanism = limited(least + 0.02, most - 0.01)
    asked = goals.joint_limits()
    state = sp.assemble(mechanism, {"crank": 1.3}, limits=False)
    values = asked.values(Candidate(mechanism, (state,))).reshape(2, -1)
    assert values.max(axis=1) == pytest.approx([0.02, 0.01], abs=1e-10)
    assert asked.unit_of(mechanism) == "rad"
