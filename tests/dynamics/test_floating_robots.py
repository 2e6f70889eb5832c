"""Efforts of what floats: the base has no motor, and the refusal says what can be done instead."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp

HERE = pin.SE3.Identity()
FORBIDDEN = re.compile(r"actuate \d+ more of [^;]*no motor|chain of revolute joints|rod")


def body(model: pin.Model, parent: int, joint: pin.JointModel, name: str, mass: float = 1.0) -> int:
    """Add a joint with a ball of some mass, off the joint."""
    index = model.addJoint(parent, joint, HERE, name)
    lever = pin.SE3(np.eye(3), np.array([0.2, 0.1, -0.3]))
    model.appendBodyToJoint(index, pin.Inertia.FromSphere(mass, 0.1), lever)
    model.addBodyFrame(f"{name}_link", index, HERE, 0)
    return index


def walker(hinges: int) -> sp.Mechanism:
    """Return a trunk that floats, with hinges in a row."""
    model = pin.Model()
    parent = body(model, 0, pin.JointModelFreeFlyer(), "trunk", 10.0)
    for k in range(hinges):
        parent = body(model, parent, (pin.JointModelRX(), pin.JointModelRY())[k % 2], f"h{k}")
    return sp.Mechanism.from_model(model, drivers=[f"h{k}" for k in range(hinges)], name="walker")


def welded(mechanism: sp.Mechanism, state: sp.State, text: str) -> sp.Mechanism:
    """Return the mechanism with the closure that a refusal offers."""
    line = re.search(r"sp\.closures\.weld\(.*\), '\w+'\)", text)
    closure = eval(line[0], {"sp": sp, "state": state})
    return sp.Mechanism.from_model(mechanism.model, [*mechanism.closures, closure],
                                   drivers={d.name: d.joint for d in mechanism.drivers.values()})


@pytest.mark.parametrize("mechanism", [
    walker(1), walker(3), sp.load("four_bar", free_flyer=True), sp.load("delta", free_flyer=True)],
    ids=["one hinge", "three hinges", "four_bar", "delta"])
@pytest.mark.parametrize("actuated", ["drivers", "nothing"])
def test_a_floating_base_is_not_to_be_actuated_but_held(mechanism, actuated):
    state = sp.assemble(mechanism)
    with pytest.raises(sp.SpatialPinError) as told:
        sp.inverse_dynamics(mechanism, state, None if actuated == "drivers" else [])
    text = str(told.value)
    assert "floats freely, and no motor acts there" in text
    assert not FORBIDDEN.search(text)


def test_what_a_refusal_offers_gives_the_efforts_of_the_robot_that_is_held():
    mechanism = walker(3)
    state = sp.assemble(mechanism)
    with pytest.raises(sp.SpatialPinError) as told:
        sp.inverse_dynamics(mechanism, state)
    held = welded(mechanism, state, str(told.value))
    found = sp.inverse_dynamics(held, sp.assemble(held))
    model = mechanism.model
    still = np.zeros(model.nv)
    expected = pin.rnea(model, model.createData(), state.q, still, still)
    assert [found.efforts[f"h{k}"] for k in range(3)] == pytest.approx(expected[6:], abs=1e-10)


def test_a_hinge_without_a_motor_is_offered_beside_the_base_that_floats():
    mechanism = sp.load("four_bar", free_flyer=True)
    with pytest.raises(sp.SpatialPinError, match="root_joint floats freely") as told:
        sp.inverse_dynamics(mechanism, sp.assemble(mechanism), [])
    assert "7 freedoms have no actuator; actuate 1 more of crank_pin, " in str(told.value)
    assert "such as actuated=['crank']; " in str(told.value)


@pytest.mark.parametrize("name", ["trunk", "trunk.z", "trunk.rx"])
def test_a_component_of_a_floating_base_has_no_motor_and_the_base_is_to_be_held(name):
    mechanism = walker(2)
    with pytest.raises(sp.SpatialPinError, match="cannot be actuated: trunk floats freely"):
        sp.inverse_dynamics(mechanism, sp.assemble(mechanism), ["h0", "h1", name])


def test_a_ball_without_a_motor_is_not_to_be_actuated():
    model = pin.Model()
    body(model, body(model, 0, pin.JointModelSpherical(), "ball"), pin.JointModelRX(), "hinge")
    mechanism = sp.Mechanism.from_model(model, drivers=["hinge"], name="pendulum")
    with pytest.raises(sp.SpatialPinError) as told:
        sp.inverse_dynamics(mechanism, sp.assemble(mechanism), [])
    assert "no motor acts on a component of a ball" in str(told.value)
    assert "actuate" not in str(told.value)


def test_the_command_line_offers_no_line_of_python(run):
    code, _, err = run("statics", "four_bar", "--free-flyer", "crank=0.3")
    assert code == 1 and "load it without --free-flyer" in err and "sp." not in err
