"""Whole turns are kept by every closure that counts them, and told where they may be lost."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from legs import at

import spatial_pin as sp

LEAD = 0.02
TURNS = (0.25, 0.5, 0.75, 1.0, 1.5, 3.5, -2.25, 40.0)
HERE = pin.SE3.Identity()


def turned(rpy):
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(rpy)), np.zeros(3))


def nut(drivers, tilt=(0.0, 0.0, 0.0), swapped=False, facing=(0.0, 0.0, 0.0)):
    """A nut on a slide, turned on it by a hinge; a screw between it and the ground.

    Args:
        drivers: of "turn" and "slide".
        tilt: roll, pitch and yaw of all of it.
        swapped: whether the nut is the first frame of the closure.
        facing: roll, pitch and yaw of the nut's frame.
    """
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPZ(), turned(tilt), "slide")
    model.addJoint(slide, pin.JointModelRZ(), HERE, "turn")
    ends = [("universe", turned(tilt)), ("turn", turned(facing))]
    screw = sp.closures.screw(*(ends[::-1] if swapped else ends), LEAD)
    return sp.Mechanism.from_model(model, [screw], drivers=drivers)


def value(state, name):
    return state.coordinate(name).value


# ---------------------------------------------------------------- screws


@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (0.7, -1.1, 2.0)])
@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("turns", TURNS)
def test_a_nut_advances_by_its_lead_each_turn(turns, swapped, tilt):
    angle = 2.0 * np.pi * turns
    by_turn = nut(["turn"], tilt, swapped)
    state = sp.assemble(by_turn, {"turn": angle})
    assert value(state, "slide") == pytest.approx(turns * LEAD, abs=1e-12)
    assert value(state, "turn") == angle
    state = sp.assemble(nut(["slide"], tilt, swapped), {"slide": turns * LEAD})
    assert value(state, "turn") == pytest.approx(angle, abs=1e-9)
    assert state.lost_turns == ()


@pytest.mark.parametrize("turns", [3.5, -4.25, 60.0])
@pytest.mark.parametrize("name", ["screw", "gear", "slide"])
def test_turns_are_those_of_whatever_joint_a_guess_or_a_target_names(name, turns):
    """A screw that a gear turns, without drivers: any one joint tells where the others are."""
    model = pin.Model()
    for joint, kind in (("screw", pin.JointModelRZ()), ("slide", pin.JointModelPZ()),
                        ("gear", pin.JointModelRX())):
        model.addJoint(0, kind, HERE, joint)
    mechanism = sp.Mechanism.from_model(model, [
        sp.closures.screw("screw", "slide", LEAD), sp.closures.coupling("screw", "gear", -2.0),
    ], drivers=[])
    angle = 2.0 * np.pi * turns
    values = {"screw": angle, "slide": -turns * LEAD, "gear": -2.0 * angle}
    given = {name: values[name]}
    for state in (sp.assemble(mechanism, {}, given), sp.assemble(mechanism, given),
                  sp.reach(mechanism, given)):
        assert {joint: value(state, joint) for joint in values} == pytest.approx(values, rel=1e-9)
        assert state.lost_turns == ()


def test_a_nut_whose_frame_is_turned_begins_there():
    """At zero of the hinge its frame is turned by 2 rad, and the nut is 2 rad of a lead on."""
    mechanism = nut(["turn"], facing=(0.0, 0.0, 2.0))
    for turns in (0.0, 3.0, -7.0):
        state = sp.assemble(mechanism, {"turn": 2.0 * np.pi * turns})
        expected = (turns + 1.0 / np.pi) * LEAD
        assert value(state, "slide") == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("turns", [0.4, 0.6, 1.5, 3.5, -8.0])
@pytest.mark.parametrize("target", ["slide", "turn.position.z"])
def test_reaching_counts_turns(target, turns):
    state = sp.reach(nut(["turn"]), {target: turns * LEAD})
    assert value(state, "turn") == pytest.approx(2.0 * np.pi * turns, abs=1e-8)


def test_a_screw_goes_on_from_where_a_motion_has_left_it():
    mechanism = nut(["turn"])
    motion = sp.sweep(mechanism, "turn", np.linspace(0.0, 7.0 * np.pi, 50))
    state = sp.assemble(mechanism, {"turn": 7.5 * np.pi}, motion.state(-1))
    assert value(state, "slide") == pytest.approx(3.75 * LEAD, abs=1e-12)
    assert sp.solve_rates(mechanism, state, {"turn": 1.0}).coordinate("slide").rate == (
        pytest.approx(LEAD / (2.0 * np.pi), rel=1e-12))


def test_a_screw_takes_its_turns_from_the_guess():
    mechanism = nut([])
    for guess, turns in (({"turn": 7.0 * np.pi}, 3.5), ({"turn": -5.0 * np.pi}, -2.5)):
        state = sp.assemble(mechanism, guess=guess)
        assert value(state, "turn") == pytest.approx(2.0 * np.pi * turns, abs=0.2)
        assert value(state, "slide") == pytest.approx(
            value(state, "turn") / (2.0 * np.pi) * LEAD, abs=1e-12)


def jack(drivers):
    """Two arms, hinged to the ground and spread by a spindle between blocks at their ends."""
    model = pin.Model()
    for name, x in (("one", -0.2), ("two", 0.2)):
        arm = model.addJoint(0, pin.JointModelRY(), at(x, 0.0, 0.0), f"arm_{name}")
        block = model.addJoint(arm, pin.JointModelRY(), at(0.0, 0.0, 0.5), f"block_{name}")
        if name == "one":
            model.addJoint(block, pin.JointModelRX(), HERE, "spindle")
    screw = sp.closures.screw("spindle", ("block_two", at(-0.4, 0.0, 0.0)), 0.01,
                              axis=(1.0, 0.0, 0.0))
    return sp.Mechanism.from_model(model, [screw], drivers=drivers)


def span(state):
    one, two = (state.placement(f"block_{name}").translation for name in ("one", "two"))
    return np.linalg.norm(two - one)


@pytest.mark.parametrize("turns", [0.3, 1.7, 12.0, -6.0])
def test_the_spindle_of_a_jack_counts_turns_between_hinges_across_it(turns):
    """Frame 2 slides along the axis as it turns back relative to the spindle."""
    mechanism = jack(["spindle", "arm_one"])
    assert span(sp.assemble(mechanism, {"spindle": 0.0})) == pytest.approx(0.4, abs=1e-12)
    state = sp.assemble(mechanism, {"spindle": -2.0 * np.pi * turns, "arm_one": 0.1})
    assert span(state) == pytest.approx(0.4 + turns * 0.01, abs=1e-11)
    by_arms = jack(["arm_one", "arm_two"])
    angles = {name: value(state, name) for name in by_arms.drivers}
    assert value(sp.assemble(by_arms, angles), "spindle") == pytest.approx(
        -2.0 * np.pi * turns, abs=1e-8)


# ---------------------------------------------------------------- what cannot count turns


def differential(loops="weld"):
    """A carrier, a planet on it that turns two side gears, and shafts that are joined to these."""
    model, turns = pin.Model(), pin.JointModelRY()
    carrier = model.addJoint(0, turns, HERE, "tilt")
    model.addJoint(carrier, pin.JointModelRX(), at(0.1, 0.0, 0.0), "roll")
    closures = [sp.closures.coupling("roll", "gear_left", 1.0),
                sp.closures.coupling("roll", "gear_right", -1.0)]
    for name, y in (("left", 0.1), ("right", -0.1)):
        model.addJoint(carrier, turns, at(0.0, y, 0.0), f"gear_{name}")
        model.addJoint(0, turns, at(0.0, y, 0.0), name)
        closures.append(getattr(sp.closures, loops)(f"gear_{name}", name, name=f"shaft_{name}"))
    return sp.Mechanism.from_model(model, closures, drivers=["left", "right"])


@pytest.mark.delicate
@pytest.mark.parametrize(("left", "right"), [
    (0.3, 0.1), (3.5, 3.5), (3.5, -3.5), (7.0, 1.0), (-20.0, 30.0), (60.0, 60.0)])
def test_a_differential_of_welds_and_couplings_turns_as_its_gears_do(left, right):
    mechanism = differential()
    state = sp.assemble(mechanism, {"left": left, "right": right})
    assert value(state, "tilt") == pytest.approx((left + right) / 2.0, abs=1e-9)
    assert value(state, "roll") == pytest.approx((left - right) / 2.0, abs=1e-9)
    assert state.lost_turns == ()
    on = sp.assemble(mechanism, {"left": left + 5.0, "right": right}, state)
    assert value(on, "tilt") == pytest.approx((left + right + 5.0) / 2.0, abs=1e-9)


def test_turns_that_a_guess_names_are_kept():
    state = sp.assemble(differential(), {"left": 3.5, "right": 3.5}, {"tilt": 3.5})
    assert value(state, "tilt") == pytest.approx(3.5, abs=1e-12)


def shafts(*names, welded=True):
    """Coaxial hinges of the ground, each welded to the next, or joined by a slide."""
    model = pin.Model()
    for k, name in enumerate(names):
        model.addJoint(0, pin.JointModelRZ(), at(0.0, 0.0, 0.1 * k), name)
    join = sp.closures.weld if welded else sp.closures.prismatic
    closures = [join(one, (two, at(0.0, 0.0, -0.1)), name=f"{one} to {two}")
                for one, two in pairwise(names)]
    return model, closures


@pytest.mark.parametrize("turns", [0.25, 0.6, 3.5, -12.25])
@pytest.mark.parametrize("welded", [True, False])
def test_shafts_that_are_joined_turn_alike(turns, welded):
    mechanism = sp.Mechanism.from_model(*shafts("a", "b", "c", welded=welded), drivers=["a"])
    angle = 2.0 * np.pi * turns
    origin = sp.assemble(mechanism, {"a": -angle})
    for guess in (None, origin):
        state = sp.assemble(mechanism, {"a": angle}, guess)
        assert [value(state, name) for name in "bc"] == pytest.approx([angle] * 2, abs=1e-12)
        assert state.lost_turns == ()
    motion = sp.sweep(mechanism, "a", angle + np.linspace(0.0, 1.0, 5))
    assert motion.coordinate("c").value[0] == pytest.approx(angle, abs=1e-12)
    assert value(sp.assemble(mechanism, {"a": angle}, {"c": angle + 4.0 * np.pi}), "c") == (
        pytest.approx(angle + 4.0 * np.pi, abs=1e-12))


@pytest.mark.parametrize("turns", [0.6, 3.5, -12.25])
def test_shafts_that_are_joined_to_a_nut_turn_as_it_asks(turns):
    model, closures = shafts("a", "b")
    model.addJoint(0, pin.JointModelPZ(), HERE, "nut")
    screw = sp.closures.screw("nut", ("b", at(0.0, 0.0, -0.1)), LEAD)
    mechanism = sp.Mechanism.from_model(model, [*closures, screw], drivers=["nut"])
    state = sp.assemble(mechanism, {"nut": -turns * LEAD})
    assert [value(state, name) for name in "ab"] == pytest.approx(
        [2.0 * np.pi * turns] * 2, abs=1e-9)


def test_a_shaft_welded_to_the_second_of_two_in_a_row_turns_by_their_sum():
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRX(), HERE, "first")
    model.addJoint(first, pin.JointModelRevoluteUnaligned(np.array([-1.0, 0.0, 0.0])),
                   at(0.1, 0.0, 0.0), "second")
    model.addJoint(0, pin.JointModelRX(), at(0.3, 0.0, 0.0), "sum")
    weld = sp.closures.weld("second", ("sum", at(-0.2, 0.0, 0.0)))
    mechanism = sp.Mechanism.from_model(model, [weld], drivers=["first", "second"])
    state = sp.assemble(mechanism, {"first": 22.0, "second": -60.0})
    assert value(state, "sum") == pytest.approx(82.0, abs=1e-11)


def test_turns_beyond_the_limits_of_a_shaft_are_lost_and_named():
    model, closures = shafts("a", "b")
    model.lowerPositionLimit[1], model.upperPositionLimit[1] = -3.2, 3.2
    mechanism = sp.Mechanism.from_model(model, closures, drivers=["a"])
    state = sp.assemble(mechanism, {"a": 7.0 * np.pi})
    assert abs(value(state, "b")) == pytest.approx(np.pi, abs=1e-12)
    assert state.lost_turns == ("a",)


def welded_four_bar():
    """Four hinges in a row, the last link welded to the ground; it is open at neutral."""
    model, joint = pin.Model(), 0
    for name, length in {"crank": 0.0, "pin": 0.2, "knee": 0.9, "rocker": 0.6}.items():
        joint = model.addJoint(joint, pin.JointModelRZ(), at(length, 0.0, 0.0), name)
    weld = sp.closures.weld("rocker", ("universe", at(0.8, 0.0, 0.0)))
    return sp.Mechanism.from_model(model, [weld], drivers=["crank"])


@pytest.mark.parametrize("turns", [3.5, -12.25])
def test_linkages_that_no_closure_counts_are_followed_over_more_than_a_turn(turns):
    """A sweep agrees; where the start of the way is open, the turns are lost, and named."""
    mechanism, angle = welded_four_bar(), 2.0 * np.pi * turns
    closed = sp.assemble(mechanism, {"crank": 0.0}, {"pin": 0.3})
    state = sp.assemble(mechanism, {"crank": angle}, closed)
    motion = sp.sweep(mechanism, "crank", np.linspace(0.0, angle, 200), guess=closed)
    assert state.q == pytest.approx(motion.q[-1], abs=1e-9)
    assert state.lost_turns == ()
    assert sp.assemble(mechanism, {"crank": angle}).lost_turns == ("crank",)


def shaft_and_rack(crank=0.2, rocker=0.2, coupler=1.0):
    """A crank that turns a pinion through a rod; the pinion moves a rack by 0.05 m a rad."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelRY(), HERE, "crank")
    model.addJoint(root, pin.JointModelRY(), at(crank, 0.0, 0.0), "rod")
    model.addJoint(0, pin.JointModelRY(), at(1.0, 0.0, 0.0), "pinion")
    model.addJoint(0, pin.JointModelPX(), HERE, "rack")
    return sp.Mechanism.from_model(model, [
        sp.closures.spherical(("rod", at(coupler, 0.0, 0.0)), ("pinion", at(rocker, 0.0, 0.0))),
        sp.closures.coupling("pinion", "rack", 0.05)], drivers=["crank"], name="press")


@pytest.mark.delicate
@pytest.mark.parametrize("angle", [0.5, 3.5, 7.0 * np.pi, -30.0])
def test_a_rack_goes_on_each_turn_though_a_rod_drives_its_pinion(angle):
    state = sp.assemble(shaft_and_rack(), {"crank": angle})
    assert value(state, "rack") == pytest.approx(0.05 * angle, abs=1e-9)
    assert state.lost_turns == ()


def test_turns_that_loops_cannot_be_followed_over_are_reported(recwarn):
    """The crank cannot turn round; it stands at the same place a turn on."""
    mechanism = shaft_and_rack(crank=0.5, rocker=0.3, coupler=0.6)
    near = sp.assemble(mechanism, {"crank": 0.3}, {"pinion": 2.0})
    assert near.lost_turns == () and not recwarn.list
    with pytest.warns(sp.SpatialPinWarning, match="turns of crank may be lost"):
        state = sp.assemble(mechanism, {"crank": 0.3 + 4.0 * np.pi}, near)
    assert state.lost_turns == ("crank",)
    assert "turns of crank lost" in str(state)
    assert state.closure_error < 1e-12
    assert sp.solve_rates(mechanism, state, {"crank": 1.0}).lost_turns == ("crank",)


def cardan_screw():
    """A shaft that drives a spindle through a universal joint, and the nut of the spindle."""
    model = pin.Model()
    shaft = model.addJoint(0, pin.JointModelRX(), HERE, "shaft")
    for name, kind in (("cross", pin.JointModelRY), ("fork", pin.JointModelRZ)):
        shaft = model.addJoint(shaft, kind(), HERE, name)
    model.addJoint(0, pin.JointModelPX(), pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.2, 0.0), np.zeros(3)),
                   "nut")
    screw = sp.closures.screw("nut", "fork", LEAD, axis=(1.0, 0.0, 0.0))
    return sp.Mechanism.from_model(model, [screw], drivers=["shaft"])


@pytest.mark.delicate
@pytest.mark.parametrize("turns", [0.25, 1.0, 3.0, -2.0])
def test_a_spindle_behind_a_universal_joint_is_followed_from_the_guess(turns):
    """After whole turns of the shaft it has turned as often, whatever the joint does between."""
    mechanism = cardan_screw()
    origin = sp.assemble(mechanism, {"shaft": 0.0})
    state = sp.assemble(mechanism, {"shaft": 2.0 * np.pi * turns}, origin)
    way = value(state, "nut") - value(origin, "nut")
    slack = 1e-9 if turns % 1.0 == 0.0 else 1e-4
    assert way == pytest.approx(-turns * LEAD, abs=slack)
    assert state.lost_turns == ()
