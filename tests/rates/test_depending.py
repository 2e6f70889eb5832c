"""What is asked for needs only what it depends on, whatever other parts of the scene can do."""

import numpy as np
import pinocchio as pin
import pytest
from legs import at, robot

import spatial_pin as sp

LOOSE = ("slide and hinge", "ball", "floating", "chain", "loop", "folded loop")
BAR = {"crank": 0.3, "coupler": 0.9, "rocker": 0.7}


def add_bar(model, name, place, lengths=BAR, parent=0):
    """Add a four-bar on a ground of 1 m; return its closure."""
    x, joints = 0.0, {}
    for link, on in (("crank", parent), ("coupler", "crank"), ("rocker", parent)):
        offset = lengths["crank"] if link == "coupler" else float(link == "rocker")
        start = at(offset, 0.0, 0.0) if link == "coupler" else place * at(offset, 0.0, x)
        joints[link] = model.addJoint(joints.get(on, parent), pin.JointModelRY(), start,
                                      f"{name}_{link}")
    return sp.closures.spherical((f"{name}_coupler", at(lengths["coupler"], 0.0, 0.0)),
                                 (f"{name}_rocker", at(-lengths["rocker"], 0.0, 0.0)),
                                 name=f"{name}_pin")


def scene(loose):
    """A four-bar with an arm on its rocker, driven by two motors, and something that nobody drives.

    Args:
        loose: what, one of `LOOSE`; "" for nothing.
    """
    model = pin.Model()
    closures = [add_bar(model, "bar", at(0.0, 0.0, 0.0))]
    model.addJoint(model.getJointId("bar_rocker"), pin.JointModelRZ(), at(-0.3, 0.0, 0.1), "arm")
    there = at(1.0, 2.0, 0.0)
    if loose == "slide and hinge":
        slide = model.addJoint(0, pin.JointModelPX(), there, "loose_slide")
        model.addJoint(slide, pin.JointModelRZ(), at(0.0, 0.0, 0.1), "loose_hinge")
    elif loose == "ball":
        model.addJoint(0, pin.JointModelSpherical(), there, "loose_ball")
    elif loose == "floating":
        one = model.addJoint(0, pin.JointModelFreeFlyer(), there, "loose_body")
        model.addJoint(one, pin.JointModelRX(), at(0.0, 0.0, 0.1), "loose_wheel")
    elif loose == "chain":  # carried by the arm
        link = model.getJointId("arm")
        for k, kind in enumerate((pin.JointModelRX, pin.JointModelRY, pin.JointModelPZ)):
            link = model.addJoint(link, kind(), at(0.1, 0.0, 0.0), f"loose_{k}")
    elif loose == "loop":
        closures.append(add_bar(model, "loose", at(0.0, 0.5, 0.0), parent=model.getJointId("arm")))
    elif loose == "folded loop":  # all its links lie on one line at the guess
        lengths = {"crank": 0.4, "coupler": 1.0, "rocker": 0.4}
        closures.append(add_bar(model, "loose", there, lengths))
    return sp.Mechanism.from_model(model, closures, drivers=["bar_crank", "arm"], name="scene",
                                   guess={"bar_crank": 0.4, "loose_rocker": np.pi}
                                   if loose == "folded loop" else {"bar_crank": 0.4})


@pytest.fixture(params=LOOSE)
def mechanism(request):
    return scene(request.param)


def at_home(mechanism):
    return sp.assemble(mechanism, {"bar_crank": 0.4, "arm": 0.2})


def alone():
    return scene("")


def loose_places(mechanism):
    return [c.v for c in mechanism.coordinate_table.values() if c.name.startswith("loose")]


@pytest.mark.delicate
@pytest.mark.parametrize("name", ["bar_coupler", "bar_rocker", "arm"])
def test_the_jacobian_of_a_frame_is_that_without_the_loose_part(mechanism, name):
    found = sp.jacobian(mechanism, at_home(mechanism), name)
    expected = sp.jacobian(alone(), at_home(alone()), name)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.delicate
def test_so_is_its_rate(mechanism):
    speeds = {"bar_crank": 2.0, "arm": -1.0}
    reference = sp.solve_rates(alone(), at_home(alone()), speeds)
    state = at_home(mechanism)
    v = np.zeros(mechanism.model.nv)
    for name in alone().coordinates:
        v[mechanism.coordinate(name).v] = reference.coordinate(name).rate
    moving = sp.State(mechanism, state.q, v, closure_error=state.closure_error)
    np.testing.assert_allclose(sp.jacobian_rate(mechanism, moving, "arm"),
                               sp.jacobian_rate(alone(), reference, "arm"), rtol=0, atol=1e-11)


@pytest.mark.delicate
def test_so_is_the_transmission_to_an_output(mechanism):
    found = sp.transmission(mechanism, at_home(mechanism), "bar_rocker", "bar_crank",
                            at="bar_pin")
    expected = sp.transmission(alone(), at_home(alone()), "bar_rocker", "bar_crank", at="bar_pin")
    assert found.ratio == pytest.approx(expected.ratio, rel=1e-12)
    assert found.angle == pytest.approx(expected.angle, rel=1e-10)


def test_drivers_that_do_not_move_a_frame_have_zeros(mechanism):
    found = sp.jacobian(mechanism, at_home(mechanism), "bar_coupler", ["arm", "bar_crank"])
    assert found.shape == (6, 2)
    assert not found[:, 0].any()
    assert found[:, 1].any()


@pytest.mark.parametrize("loose", ["slide and hinge", "chain", "loop"])
def test_the_jacobian_of_the_loose_part_is_refused(loose):
    mechanism = scene(loose)
    name = next(c for c in reversed(mechanism.coordinates) if c.startswith("loose"))
    with pytest.raises(sp.SingularError, match="freedoms are not prescribed"):
        sp.jacobian(mechanism, at_home(mechanism), mechanism.coordinate(name).joint)


@pytest.mark.delicate
@pytest.mark.parametrize("mechanism", LOOSE[:5], indirect=True)
def test_a_sweep_moves_what_depends_on_its_driver_and_all_else_stands(mechanism):
    values = np.linspace(0.4, 2.0, 9)
    motion = sp.sweep(mechanism, "bar_crank", values, speed=1.0, guess=at_home(mechanism))
    expected = sp.sweep(alone(), "bar_crank", values, speed=1.0, guess=at_home(alone()))
    for name in ("bar_rocker", "bar_coupler", "arm"):
        for one, two in zip(motion.coordinate(name), expected.coordinate(name), strict=True):
            np.testing.assert_allclose(one, two, rtol=0, atol=1e-11)
    assert not motion.v[:, loose_places(mechanism)].any()
    for name in mechanism.coordinates:
        if name.startswith("loose"):
            assert np.ptp(motion.coordinate(name).value) == 0.0
    assert motion.mechanism is mechanism
    assert motion.closure_error.max() < 1e-12
    if not any(f"loose_{x}" in mechanism.coordinates for x in ("ball.x", "body.x")):
        assert any(name.startswith("loose") for name in motion.held)


@pytest.mark.delicate
@pytest.mark.parametrize("loose", ["ball", "loop"])
def test_so_do_other_motions_and_ranges(loose):
    mechanism, own = scene(loose), alone()
    table = {"bar_crank": np.linspace(0.4, 1.0, 5), "arm": np.linspace(0.2, 0.5, 5)}
    motion, expected = (sp.follow(x, table, guess=at_home(x)) for x in (mechanism, own))
    np.testing.assert_allclose(motion.coordinate("bar_rocker").value,
                               expected.coordinate("bar_rocker").value, rtol=0, atol=1e-11)
    assert sp.limits(mechanism, "bar_crank").full_turn == sp.limits(own, "bar_crank").full_turn
    traced = [sp.trace(x, "bar_crank", step=0.3) for x in (mechanism, own)]
    assert traced[0].mechanism is mechanism
    np.testing.assert_allclose(traced[0].coordinate("bar_rocker").value,
                               traced[1].coordinate("bar_rocker").value, rtol=0, atol=1e-9)


@pytest.mark.delicate
def test_rates_of_samples_are_known_where_the_rest_is_held():
    mechanism = scene("loop")
    motion = sp.sweep(mechanism, "bar_crank", [0.4, 0.8, 1.2], speed=1.0, guess=at_home(mechanism))
    assert motion.state(1).rate_error < 1e-12


def test_a_free_base_that_is_let_go_is_not_held_by_itself():
    mechanism = robot("floating", legs=1, drivers=["motor_0", "hip_0", "shoulder"])
    with pytest.raises(sp.SingularError, match="not prescribed"):
        sp.sweep(mechanism, "motor_0", [0.0, 0.1], hold=None)


# ---------------------------------------------------------------- in one loop


def slack_chain():
    """A four-bar, and a chain of three links from its coupler to the ground: one too many."""
    model = pin.Model()
    closures = [add_bar(model, "bar", at(0.0, 0.0, 0.0))]
    link = model.getJointId("bar_coupler")
    for k, x in enumerate((0.4, 0.5, 0.5)):
        link = model.addJoint(link, pin.JointModelRY(), at(x, 0.0, 0.0), f"chain_{k}")
    closures.append(sp.closures.spherical(("chain_2", at(0.5, 0.0, 0.0)), ("universe", at(
        1.2, 0.0, -0.5)), name="chain_end"))
    return sp.Mechanism.from_model(model, closures, drivers=["bar_crank"], name="slack")


@pytest.mark.delicate
def test_what_a_slack_chain_cannot_move_is_determined():
    mechanism, own = slack_chain(), alone()
    state = sp.assemble(mechanism, {"bar_crank": 0.4},
                        {"chain_0": 0.9, "chain_1": 0.9, "chain_2": -0.7})
    reference = sp.assemble(own, {"bar_crank": 0.4}, [*state.q[: own.model.nq - 1].tolist(), 0.0])
    found = sp.jacobian(mechanism, state, "bar_coupler")
    expected = sp.jacobian(own, reference, "bar_coupler", ["bar_crank", "arm"])
    np.testing.assert_allclose(found[:, 0], expected[:, 0], rtol=0, atol=1e-11)
    with pytest.raises(sp.SingularError, match="1 of its freedoms are not prescribed"):
        sp.jacobian(mechanism, state, "chain_1")
