"""Idle spins are named whatever links weigh, however balls and legs are written or lie."""

import numpy as np
import pinocchio as pin
import pytest
from legs import at

import spatial_pin as sp

HERE = pin.SE3.Identity()
HINGES = {"x": pin.JointModelRX, "y": pin.JointModelRY, "z": pin.JointModelRZ}
ORDERS = ("xyz", "zyx", "zxz")
MASSES = (0.0, 1e-6, 0.05, 20.0)


def add_ball(model, parent, place, name, order, mass):
    """Add a ball, or hinges about some axes; what is between these has a mass. Return the body."""
    if order == "ball":
        return model.addJoint(parent, pin.JointModelSpherical(), place, name)
    for k, axis in enumerate(order):
        parent = model.addJoint(parent, HINGES[axis](), HERE if k else place, f"{name}_{k}")
        if k < len(order) - 1 and mass:
            add_mass(model, parent, mass)
    return parent


def add_mass(model, joint, mass=0.3):
    model.appendBodyToJoint(
        joint, pin.Inertia(mass, np.zeros(3), 1e-3 * mass * np.diag([1.0, 2.0, 2.0])), HERE)


def four_bar(order="ball", mass=0.0, rod=0.3):
    """RSSR: a crank, a rod on a ball, a rocker, and a ball closure between these."""
    model = pin.Model()
    crank = model.addJoint(0, pin.JointModelRZ(), HERE, "crank")
    end = add_ball(model, crank, at(0.1, 0.0, 0.0), "ball", order, mass)
    if rod:
        add_mass(model, end, rod)
    model.addJoint(0, pin.JointModelRX(), at(0.5, 0.1, 0.2), "rocker")
    closure = sp.closures.spherical((model.names[end], at(0.5, 0.0, 0.0)),
                                    ("rocker", at(0.05, -0.1, 0.25)), name="far_ball")
    return sp.Mechanism.from_model(model, [closure], drivers=["crank"], name="rssr")


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("mass", MASSES)
def test_a_rod_spins_whatever_is_inside_its_ball_of_hinges(order, mass):
    mechanism, plain = four_bar(order, mass), four_bar()
    reference = sp.assemble(plain, {"crank": 0.3})
    rocker = reference.coordinate("rocker").value
    state = sp.assemble(mechanism, {"crank": 0.3}, {"rocker": rocker})
    found = sp.mobility(mechanism, state)
    assert (found.dof, len(found.passive)) == (2, 1)
    line = state.placement("ball_2").translation - (
        state.placement("rocker").act(np.array([0.05, -0.1, 0.25])))
    axis = found.passive[0].axis
    assert np.linalg.norm(np.cross(axis, line / np.linalg.norm(line))) < 1e-9
    assert "far_ball" in str(found.passive[0])
    np.testing.assert_allclose(sp.jacobian(mechanism, state, "rocker"),
                               sp.jacobian(plain, reference, "rocker"), rtol=0, atol=1e-10)
    values = np.linspace(0.3, 0.5, 5)
    motions = [sp.sweep(m, "crank", values, guess=s)
               for m, s in ((mechanism, state), (plain, reference))]
    np.testing.assert_allclose(motions[0].coordinate("rocker").value,
                               motions[1].coordinate("rocker").value, rtol=0, atol=1e-10)


@pytest.mark.parametrize("rod", [0.0, 1e-9])
def test_a_rod_that_weighs_less_than_what_is_inside_its_ball_spins_too(rod):
    for mass in (0.0, 5.0):
        found = sp.mobility(four_bar("xyz", mass, rod))
        assert (found.dof, len(found.passive)) == (2, 1)


def hexapod(order="ball", mass=0.0, driven=True):
    """A platform on six legs of two links that slide on each other, between balls."""
    model, closures = pin.Model(), []
    model.addJoint(0, pin.JointModelFreeFlyer(), at(0.0, 0.0, 1.2), "platform")
    feet, heads = ((0.1, 1.9, 2.2, 4.0, 4.3, 6.1), (0.8, 1.2, 2.9, 3.3, 5.0, 5.4))
    for k, (foot, head) in enumerate(zip(feet, heads, strict=True)):
        a = np.array([np.cos(foot), np.sin(foot), 0.0])
        b = np.array([0.6 * np.cos(head), 0.6 * np.sin(head), 0.0])
        way = np.array([*b[:2], 1.2]) - a
        half = at(0.0, 0.0, 0.5 * np.linalg.norm(way))
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), way).matrix()
        lower = add_ball(model, 0, pin.SE3(turn, a), f"foot_{k}", order, mass)
        add_mass(model, lower)
        add_mass(model, model.addJoint(lower, pin.JointModelPZ(), half, f"leg_{k}"))
        closures.append(sp.closures.spherical((f"leg_{k}", half), ("platform", at(*b)),
                                              name=f"head_{k}"))
    return sp.Mechanism.from_model(model, closures, name="hexapod",
                                   drivers=[f"leg_{k}" for k in range(6 * driven)])


@pytest.mark.parametrize("driven", [True, False])
@pytest.mark.parametrize(("order", "mass"), [("ball", 0.0), ("zyx", 0.0), ("xyz", 0.2)])
def test_legs_of_two_links_spin_as_one(order, mass, driven):
    mechanism = hexapod(order, mass, driven)
    state = sp.assemble(mechanism)
    found = sp.mobility(mechanism, state)
    assert (found.dof, len(found.passive)) == (12, 6)
    assert {passive.kind for passive in found.passive} == {"spin"}
    assert all(f"head_{k}" in str(passive) for k, passive in enumerate(found.passive))
    legs = [f"leg_{k}" for k in range(6)]
    assert np.linalg.matrix_rank(sp.jacobian(mechanism, state, "platform", legs)) == 6


def delta(order, mass):
    """A delta: three arms, each with two rods to the platform, on balls or hinges."""
    model, closures = pin.Model(), []
    model.addJoint(0, pin.JointModelFreeFlyer(), at(0.0, 0.0, -0.8), "platform")
    for k in range(3):
        turn = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 2.0 * np.pi * k / 3.0), np.zeros(3))
        arm = model.addJoint(0, pin.JointModelRY(), turn * at(0.2, 0.0, 0.0), f"arm_{k}")
        for side in (-0.1, 0.1):
            name = f"rod_{k}_{'ab'[side > 0]}"
            way = np.array([0.1 - 0.5, 0.0, -0.8])
            lean = pin.SE3(pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), way).matrix(),
                           np.array([0.3, side, 0.0]))
            rod = add_ball(model, arm, lean, name, order, mass)
            add_mass(model, rod)
            closures.append(sp.closures.spherical(
                (model.names[rod], at(float(np.linalg.norm(way)), 0.0, 0.0)),
                ("platform", turn * at(0.1, side, 0.0)), name=f"end_{name}"))
    return sp.Mechanism.from_model(model, closures, drivers=[f"arm_{k}" for k in range(3)],
                                   name="delta")


@pytest.mark.delicate
def test_a_delta_of_hinges_moves_as_one_of_balls():
    plain, heavy = delta("ball", 0.0), delta("zyx", 0.4)
    states = [sp.assemble(m, dict.fromkeys(m.drivers, 0.1)) for m in (plain, heavy)]
    for mechanism, state in zip((plain, heavy), states, strict=True):
        found = sp.mobility(mechanism, state)
        assert (found.dof, len(found.passive)) == (9, 6)
    one, two = (sp.jacobian(m, s, "platform") for m, s in zip((plain, heavy), states, strict=True))
    np.testing.assert_allclose(one, two, rtol=0, atol=1e-9)
    motions = [sp.sweep(m, "arm_0", np.linspace(0.1, 0.3, 5), guess=s)
               for m, s in zip((plain, heavy), states, strict=True)]
    one, two = (m.frame("platform").position for m in motions)
    np.testing.assert_allclose(one, two, rtol=0, atol=1e-9)


def double_cardan(mass):
    """Two shafts on the ground and one between them, on crosses, that nobody drives."""
    model = pin.Model()
    shaft = model.addJoint(0, pin.JointModelRX(), HERE, "input")
    cross = model.addJoint(shaft, pin.JointModelRY(), HERE, "cross_1")
    middle = model.addJoint(cross, pin.JointModelRZ(), HERE, "middle")
    cross = model.addJoint(middle, pin.JointModelRY(), at(1.0, 0.0, 0.0), "cross_2")
    fork = model.addJoint(cross, pin.JointModelRZ(), HERE, "fork")
    for joint in (shaft, cross, middle, fork):
        if mass:
            add_mass(model, joint, mass)
    model.addJoint(0, pin.JointModelRX(), at(1.0, 0.0, 0.0), "output")
    return sp.Mechanism.from_model(model, [sp.closures.weld("fork", "output", name="flange")],
                                   drivers=[], name="cardan")


def test_a_shaft_between_shafts_is_no_idle_rod():
    found = sp.mobility(double_cardan(0.5))
    assert (found.dof, found.passive) == (1, ())


def test_a_hand_that_hangs_on_a_wrist_is_no_idle_rod():
    model = pin.Model()
    arm = model.addJoint(0, pin.JointModelRZ(), HERE, "arm")
    hand = add_ball(model, arm, at(0.4, 0.0, 0.0), "wrist", "xyz", 0.2)
    add_mass(model, hand)
    mechanism = sp.Mechanism.from_model(model, [], drivers=["arm"])
    assert sp.mobility(mechanism).passive == ()
    with pytest.raises(sp.SingularError, match="3 of its freedoms are not prescribed"):
        sp.jacobian(mechanism, sp.assemble(mechanism), "wrist_2", ["arm"])


# ---------------------------------------------------------------- a body of several freedoms

POINT, OTHER, FAR = (0.3, 0.2, 0.5), (0.6, 0.1, 0.4), (0.0, 0.0, 0.0)
HELD = {  # closures: kind, point on the ground and on the body; freedoms, all of them idle
    "ball": ([("spherical", POINT, POINT)], 3),
    "rod": ([("distance", FAR, POINT)], 5),
    "short rod": ([("distance", (0.25, 0.35, 0.1), (0.4, 0.1, 0.5))], 5),
    "rod at the middle": ([("distance", FAR, (0.3, 0.1, 0.5))], 5),
    "two rods": ([("distance", FAR, POINT), ("distance", (1.0, 0.0, 0.0), OTHER)], 4),
    "two rods at one point": ([("distance", FAR, POINT), ("distance", (1, 0, 0), POINT)], 4),
    "ball and rod": ([("spherical", POINT, POINT), ("distance", FAR, OTHER)], 2),
    "plane": ([("point_on_plane", POINT, POINT)], 5),
    "line": ([("point_on_line", POINT, POINT)], 4),
    "sleeve": ([("cylindrical", POINT, POINT)], 2),
    "table": ([("planar", POINT, POINT)], 3),
}


def held(closures, turn):
    """Return a body that is held to the ground by closures, all of it turned in the world."""
    model, world, pose = pin.Model(), pin.SE3(turn, np.zeros(3)), at(0.3, 0.1, 0.5)
    model.addJoint(0, pin.JointModelFreeFlyer(), world * pose, "body")
    made = []
    for k, (kind, ground, body) in enumerate(closures):
        more = [np.linalg.norm(np.subtract(ground, body))] if kind == "distance" else []
        made.append(getattr(sp.closures, kind)(
            ("universe", world * at(*ground)), ("body", pose.inverse() * at(*body)), *more,
            name=f"holds_{k}"))
    return sp.Mechanism.from_model(model, made, drivers=[], name="held")


@pytest.mark.delicate
@pytest.mark.parametrize("name", HELD)
def test_the_freedoms_of_one_body_are_counted_however_it_lies_in_the_world(name):
    closures, freedoms = HELD[name]
    rng = np.random.default_rng(4)
    for turn in (np.zeros(3), np.array([0.0, 0.0, 0.5]), *rng.normal(size=(3, 3))):
        found = sp.mobility(held(closures, pin.exp3(turn)))
        assert (found.dof, len(found.passive)) == (freedoms, freedoms)
        assert {passive.link for passive in found.passive} == {"body"}


@pytest.mark.delicate
@pytest.mark.parametrize(("order", "mass"), [("xyz", 0.0), ("xyz", 0.05), ("zyz", 5.0)])
def test_what_is_inside_a_ball_tells_no_modes_apart(order, mass):
    modes, plain = (sp.assembly_modes(m, {"crank": 0.3}) for m in (four_bar(order, mass),
                                                                  four_bar()))
    rockers = [sorted(mode.coordinate("rocker").value for mode in found)
               for found in (modes, plain)]
    assert rockers[0] == pytest.approx(rockers[1], abs=1e-8)
    assert modes.continua == ()


@pytest.mark.delicate
@pytest.mark.parametrize("mass", [0.05, 5.0])
def test_forces_are_found_where_a_rod_spins_on_hinges_that_weigh_something(mass):
    mechanism = four_bar("xyz", mass)
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.3}), {"crank": 2.0},
                           {"crank": -3.0})
    effort = sp.inverse_dynamics(mechanism, state).efforts["crank"]
    fall = sp.forward_dynamics(mechanism, state, {"crank": effort})
    assert fall.state.coordinate("crank").acceleration == pytest.approx(-3.0, abs=1e-6)
