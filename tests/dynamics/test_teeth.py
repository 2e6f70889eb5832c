"""Where couplings act: tooth forces and belt pulls in the reactions of bearings."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from derivative_cases import check

import spatial_pin as sp

R1, R2, ALPHA = 0.02, 0.05, np.radians(20.0)
TORQUE = 3.0


def bodies(*joints, gravity=0.0) -> pin.Model:
    """Rigid bodies on joints: (name, model, place, parent's name or "")."""
    model = pin.Model()
    model.name = "gears"
    for name, joint, place, parent in joints:
        on = model.getJointId(parent) if parent else 0
        i = model.addJoint(on, joint, pin.SE3(np.eye(3), np.array(place, float)), name)
        model.appendBodyToJoint(i, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)),
                                pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    return model


def gears(place=(R1 + R2, 0.0, 0.0), ratio=-R1 / R2, kind=pin.JointModelRZ, **teeth):
    model = bodies(("one", pin.JointModelRZ(), (0, 0, 0), ""), ("two", kind(), place, ""))
    closure = sp.closures.coupling("one", "two", ratio, name="mesh", teeth={
        "point": [R1, 0.0, 0.0], "pressure_angle": ALPHA, **teeth})
    return sp.Mechanism.from_model(model, [closure], drivers=["one"],
                                   springs=[sp.Spring("load", joint="two")])


def reactions(mech: sp.Mechanism, effort: float):
    """With an effort of the load at the last joint, the first held by its driver."""
    state = sp.assemble(mech, {})
    return sp.inverse_dynamics(mech, state, laws={"load": lambda *_: -effort})


@pytest.mark.parametrize("torque", [TORQUE, -TORQUE])
def test_a_bearing_of_spur_gears_bears_torque_by_radius_and_its_tangent_across(torque):
    found = reactions(gears(), torque)  # the load turns gear 2 by `torque`
    tangential = torque / R2
    radial = abs(tangential) * np.tan(ALPHA)
    # the tooth force on gear 2 holds the load: at -R2 from its axis
    on_two = np.array([radial, tangential, 0.0])
    for name, force in (("mesh", on_two), ("two", -on_two), ("one", on_two)):
        assert found.reactions[name].linear == pytest.approx(force, rel=1e-12, abs=1e-12)
        assert found.reactions[name].angular == pytest.approx(np.zeros(3), abs=1e-12)
        assert found.determined[name] and np.all(found.unique[name])
    assert found.efforts["one"] == pytest.approx(torque * R1 / R2, rel=1e-12)
    assert not found.why_not_unique()


def test_an_inner_mesh_pushes_the_ring_outwards():
    mech = gears((R1 - R2, 0.0, 0.0), R1 / R2)
    found = reactions(mech, TORQUE)
    assert found.reactions["mesh"].linear == pytest.approx(
        [np.tan(ALPHA) * TORQUE / R2, -TORQUE / R2, 0.0], rel=1e-12, abs=1e-12)


def test_helical_teeth_push_along_the_axis_by_their_hand():
    beta = np.radians(15.0)
    for sign in (1.0, -1.0):
        found = reactions(gears(helix_angle=sign * beta), TORQUE)
        force = found.reactions["mesh"].linear  # on gear 2
        tangential = TORQUE / R2
        assert force == pytest.approx([
            tangential * np.tan(ALPHA) / np.cos(beta), tangential,
            -sign * tangential * np.tan(beta)], rel=1e-12)
        # the moment of the axial force about the bearing, which bears it
        arm = np.array([-R2, 0.0, 0.0])
        moment = np.cross(arm, force)
        assert found.reactions["two"].angular[:2] == pytest.approx(-moment[:2], rel=1e-12,
                                                                   abs=1e-12)


def test_a_rack_is_pushed_away_from_its_pinion():
    mech = gears((R1, 0.0, 0.0), R1, pin.JointModelPY)
    found = reactions(mech, 50.0)
    assert found.reactions["mesh"].linear == pytest.approx(
        [50.0 * np.tan(ALPHA), -50.0, 0.0], rel=1e-12, abs=1e-12)
    assert found.efforts["one"] == pytest.approx(-50.0 * R1, rel=1e-12)


def test_bevel_gears_push_each_other_along_their_axes():
    """Axes z and x meet at the origin, the pitch cones touch along a line in their plane."""
    model = bodies(("one", pin.JointModelRZ(), (0, 0, 0), ""), ("two", pin.JointModelRX(),
                                                                (0, 0, 0), ""))
    teeth = {"point": [R2, 0.0, R1], "pressure_angle": ALPHA}
    mech = sp.Mechanism.from_model(
        model, [sp.closures.coupling("one", "two", -R2 / R1, name="mesh", teeth=teeth)],
        drivers=["one"], springs=[sp.Spring("load", joint="two")])
    found = reactions(mech, TORQUE)
    force = found.reactions["mesh"].linear
    tangential, cone = TORQUE / R1, np.arctan2(R1, R2)  # of gear 2, about x
    assert abs(force[1]) == pytest.approx(tangential, rel=1e-12)
    across = tangential * np.tan(ALPHA)  # square to the cone: away from gear 1
    assert force[[0, 2]] == pytest.approx([across * np.sin(cone), -across * np.cos(cone)],
                                          rel=1e-12)


def test_a_sun_and_its_planet_on_a_carrier():
    """Three coordinates: the carrier moves the planet about the sun."""
    model = bodies(("sun", pin.JointModelRZ(), (0, 0, 0), ""),
                   ("carrier", pin.JointModelRZ(), (0, 0, 0), ""),
                   ("planet", pin.JointModelRZ(), (R1 + R2, 0, 0), "carrier"))
    teeth = {"frame": "carrier", "point": [R1, 0.0, 0.0], "pressure_angle": ALPHA}
    mesh = sp.closures.coupling(joints=["sun", "carrier", "planet"], ratios=[R1, -R1, R2],
                                name="mesh", teeth=teeth)
    mech = sp.Mechanism.from_model(model, [mesh], drivers=["sun", "carrier"],
                                   springs=[sp.Spring("load", joint="planet")])
    turned = sp.assemble(mech, {"sun": 0.3, "carrier": 0.5 * np.pi})
    found = sp.inverse_dynamics(mech, turned, laws={"load": lambda *_: -TORQUE})
    force = found.reactions["mesh"].linear
    tangential = TORQUE / R2
    assert force == pytest.approx([-tangential, tangential * np.tan(ALPHA), 0.0], rel=1e-12,
                                  abs=1e-10)
    assert found.reactions["planet"].linear == pytest.approx(-force, rel=1e-12, abs=1e-10)
    assert found.efforts["sun"] == pytest.approx(TORQUE * R1 / R2, rel=1e-12)
    # the load acts between carrier and planet: the carrier holds the rest
    assert found.efforts["carrier"] == pytest.approx(-TORQUE * R1 / R2, rel=1e-12)


@pytest.mark.parametrize("hand", [1.0, -1.0])
@pytest.mark.parametrize("torque", [TORQUE, -TORQUE])
def test_a_worm_pushes_its_wheel_as_the_textbook_has_it(torque, hand):
    """Without friction [Shigley, 13-17]: W_a : W_t : W_r = cos l : sin l : tan(a), lead angle l."""
    radius, wheel, lead = 0.02, 0.06, 0.0125 * np.pi
    angle = np.arctan2(lead, 2.0 * np.pi * radius)
    model = bodies(("worm", pin.JointModelRY(), (wheel + radius, 0, 0), ""),
                   ("wheel", pin.JointModelRZ(), (0, 0, 0), ""))
    mesh = sp.closures.coupling(
        "worm", "wheel", -hand * lead / (2.0 * np.pi * wheel), name="mesh", teeth={
            "point": [wheel, 0.0, 0.0], "pressure_angle": ALPHA,
            "helix_angle": hand * (0.5 * np.pi - angle)})
    mech = sp.Mechanism.from_model(model, [mesh], drivers=["worm"],
                                   springs=[sp.Spring("load", joint="wheel")])
    found = reactions(mech, torque)
    across = -torque / wheel  # it turns the wheel back, along the worm
    force = np.array([-np.tan(ALPHA) / np.cos(angle) * abs(across), across,
                      -hand * across * np.tan(angle)])
    assert found.reactions["mesh"].linear == pytest.approx(force, rel=1e-12)
    turning = -hand * across * np.tan(angle) * radius
    assert found.efforts["worm"] == pytest.approx(turning, rel=1e-12)
    assert found.determined["worm"] and found.determined["wheel"]
    # the worm's bearing bears the thrust, the wheel's what tilts it
    assert found.reactions["worm"].linear[1] == pytest.approx(across, rel=1e-12)
    assert found.reactions["wheel"].angular[1] == pytest.approx(wheel * force[2], rel=1e-12)


def test_crossed_helical_gears_push_by_their_helix_angles():
    """Right-handed both, axes 70° apart: r w cos(beta) is the same for both [Shigley, 13-16]."""
    one, two = np.radians(40.0), np.radians(30.0)
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "one")
    tilt = pin.exp3(np.array([-1.0, 0.0, 0.0]) * (one + two))
    second = model.addJoint(0, pin.JointModelRZ(), pin.SE3(tilt, np.array([R1 + R2, 0.0, 0.0])),
                            "two")
    for i in (first, second):
        model.appendBodyToJoint(i, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)),
                                pin.SE3.Identity())
    ratio = -R1 * np.cos(one) / (R2 * np.cos(two))
    mesh = sp.closures.coupling("one", "two", ratio, name="mesh", teeth={
        "point": [R1, 0.0, 0.0], "pressure_angle": ALPHA, "helix_angle": one})
    mech = sp.Mechanism.from_model(model, [mesh], drivers=["one"],
                                   springs=[sp.Spring("load", joint="two")])
    found = reactions(mech, TORQUE)
    force = found.reactions["mesh"].linear
    tangential = TORQUE / R2
    normal = tangential / np.cos(two)
    assert force[0] == pytest.approx(normal * np.tan(ALPHA), rel=1e-12)
    assert np.hypot(force[1], force[2]) == pytest.approx(normal, rel=1e-12)
    assert abs(force[1]) == pytest.approx(normal * np.cos(one), rel=1e-12)  # about axis 1
    assert abs(force[2]) == pytest.approx(normal * np.sin(one), rel=1e-12)  # along it
    axis = tilt[:, 2]
    assert abs(force @ axis) == pytest.approx(normal * np.sin(two), rel=1e-12)
    with pytest.raises(sp.SpatialPinError, match="follows from the ratio and the point"):
        wrong = sp.closures.coupling("one", "two", ratio, name="mesh", teeth={
            "point": [R1, 0.0, 0.0], "helix_angle": 0.5})
        assert reactions(sp.Mechanism.from_model(model, [wrong], drivers=["one"], springs=[
            sp.Spring("load", joint="two")]), TORQUE).reactions


@pytest.mark.parametrize("pretension", [0.0, 20.0, 400.0])
def test_a_belt_pulls_its_shafts_together(pretension):
    r1, r2, apart = 0.05, 0.05, 0.4
    model = bodies(("one", pin.JointModelRZ(), (0, 0, 0), ""),
                   ("two", pin.JointModelRZ(), (apart, 0, 0), ""))
    strands = {"points": [[[0, r1, 0], [apart, r2, 0]], [[0, -r1, 0], [apart, -r2, 0]]],
               "pretension": pretension}
    mech = sp.Mechanism.from_model(
        model, [sp.closures.coupling("one", "two", r1 / r2, name="belt", strands=strands)],
        drivers=["one"], springs=[sp.Spring("load", joint="two")])
    for torque in (TORQUE, -TORQUE):
        found = reactions(mech, torque)
        pull = TORQUE / r2
        total = max(pull, 2.0 * pretension)
        assert found.reactions["belt"].linear == pytest.approx([-total, 0, 0], rel=1e-12, abs=1e-11)
        assert found.reactions["two"].linear == pytest.approx([total, 0, 0], rel=1e-12, abs=1e-11)
        assert found.reactions["two"].angular == pytest.approx(np.zeros(3), abs=1e-11)
        assert found.determined["two"]


def test_teeth_are_outputs_over_a_motion_and_go_through_a_file(tmp_path):
    mech = gears()
    again = sp.load(mech.save(tmp_path))
    for one in (mech, again):
        motion = sp.sweep(one, "one", np.linspace(0.0, 7.0, 20), speed=3.0, acceleration=2.0)
        loads = sp.kinetostatics(one, motion)
        values = loads.output("mesh.reaction.force").values
        force = 0.01 * 2.0 * R1 / R2 / R2
        np.testing.assert_allclose(values, np.tile(
            [force * np.tan(ALPHA), force, 0.0], (20, 1)), rtol=1e-11, atol=1e-12)
        assert loads.determined["one"].all()
    assert mech.closures[0].numbers["teeth"].form == again.closures[0].numbers["teeth"].form


def test_teeth_on_the_ground_may_name_it_as_closures_do():
    assert reactions(gears(frame="universe"), TORQUE).reactions["mesh"].isApprox(
        reactions(gears(), TORQUE).reactions["mesh"], 1e-14)


def test_a_coupling_without_teeth_has_the_effort_at_its_last_joint():
    model = bodies(("one", pin.JointModelRZ(), (0, 0, 0), ""),
                   ("two", pin.JointModelPX(), (1.0, 0, 0), ""))
    mech = sp.Mechanism.from_model(
        model, [sp.closures.coupling("one", "two", 0.02, name="rack")], drivers=["one"],
        springs=[sp.Spring("load", joint="two")])
    loads = sp.kinetostatics(mech, sp.sweep(mech, "one", [0.0, 0.5, 1.0], speed=1.0),
                             laws={"load": lambda *_: -50.0})
    values, label, unit = loads.output("rack.reaction")
    assert values == pytest.approx(-50.0, rel=1e-12) and (label, unit) == ("rack reaction", "N")
    assert "rack" not in loads.reactions and not loads.determined["one"].any()


@pytest.mark.parametrize(("teeth", "words"), [
    ({"point": [0.03, 0.0, 0.0]}, "where the pitch circles touch"),
    ({"point": [0.02, 0.0]}, "point: three finite numbers are needed"),
    ({"point": [0.02, 0.0, 0.0], "pressure_angle": 20.0}, "pressure_angle: is 20.0 rad"),
    ({"point": [0.02, 0.0, 0.0], "angle": 0.3}, "angle is not one of its keys"),
    ({"point": [0.02, 0.0, 0.0], "frame": "elsewhere"}, "elsewhere"),
])
def test_teeth_that_do_not_mesh_are_refused(teeth, words):
    with pytest.raises((ValueError, sp.SpatialPinError), match=words):
        assert reactions(gears(**teeth), TORQUE).reactions


def carried(coupling):
    """Two wheels on a carrier that turns about y, with their centres of mass aside."""
    model = bodies(("carrier", pin.JointModelRY(), (0.1, 0.2, 0.0), ""),
                   ("one", pin.JointModelRZ(), (0.0, 0.0, 0.1), "carrier"),
                   ("two", pin.JointModelRZ(), (R1 + R2, 0.0, 0.1), "carrier"), gravity=9.81)
    for i in range(1, 4):
        model.inertias[i] = pin.Inertia(1.0 + i, np.array([0.01 * i, 0.02, -0.01]),
                                        0.01 * np.diag([1.0, 2.0, 2.5]))
    mech = sp.Mechanism.from_model(model, [coupling], drivers=["one"])
    start = sp.assemble(mech, {"carrier": 0.3, "one": 0.7})
    return mech, sp.solve_rates(mech, start, {"one": 2.0, "carrier": -1.0})


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_reactions_beside_teeth_have_derivatives(sign):
    mech, state = carried(sp.closures.coupling("one", "two", -R1 / R2, name="mesh", teeth={
        "point": [R1, 0.0, 0.1], "pressure_angle": ALPHA, "helix_angle": 0.2}))
    check(mech, state, {"one": sign * 3.0, "two": 0.1, "carrier": 0.2}, 1e-3, 1e-8)


@pytest.mark.parametrize(("pretension", "torque"), [(0.0, 3.0), (0.0, -3.0), (400.0, 3.0)])
def test_reactions_beside_strands_have_derivatives(pretension, torque):
    apart = R1 + R2
    tilt = np.arcsin((R2 - R1) / apart)  # of an open belt
    strands = {"points": [[[-R1 * np.sin(tilt), side * R1 * np.cos(tilt), 0.1],
                           [apart - R2 * np.sin(tilt), side * R2 * np.cos(tilt), 0.1]]
                          for side in (1.0, -1.0)], "pretension": pretension}
    mech, state = carried(sp.closures.coupling("one", "two", R1 / R2, name="belt",
                                               strands=strands))
    check(mech, state, {"one": torque, "two": 0.1, "carrier": 0.2}, 1e-3, 1e-8)
