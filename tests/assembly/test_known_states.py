"""A State of numbers that are known from elsewhere: it moves nothing, and measures its loops."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from variety import each

import spatial_pin as sp


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_a_state_of_closed_numbers_is_closed(name):
    mechanism = sp.load(name)
    whole = sp.assemble(mechanism)
    known = sp.State(mechanism, whole.q)
    assert known.closure_error < 1e-13 and np.array_equal(known.q, whole.q)
    assert known.angles == pytest.approx(whole.angles, abs=1e-12)
    assert not known.v.any() and not known.a.any()


def test_the_error_of_open_loops_is_measured_in_sizes_and_radians():
    mechanism = sp.load("four_bar")
    q = sp.assemble(mechanism, {"crank": 0.7}).q.copy()
    q[mechanism.coordinate("rocker_pin").q] += 1e-3  # the rocker of 0.24 m: its end goes 0.24 mm
    off = 0.24e-3 / mechanism.characteristic_length
    assert sp.State(mechanism, q).closure_error == pytest.approx(off, rel=0.5)
    assert sp.State(mechanism, q).closure_error > 0.5 * off
    assert sp.assemble(mechanism, guess=q).closure_error < 1e-13


def test_a_closure_error_that_is_given_is_kept():
    mechanism = sp.load("four_bar")
    q = sp.assemble(mechanism).q
    assert sp.State(mechanism, q, closure_error=0.25).closure_error == 0.25


def test_known_rates_are_those_of_the_state():
    mechanism = sp.load("rssr")
    moving = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 1.0}), {"crank": 3.0})
    known = sp.State(mechanism, moving.q, moving.v)
    assert np.array_equal(known.v, moving.v)
    twist = pin.getFrameVelocity(mechanism.model, known.data, mechanism.frame_id("rocker_b"),
                                 pin.LOCAL_WORLD_ALIGNED)
    assert known.velocity("rocker_b").isApprox(twist)
    two = [sp.forward_dynamics(mechanism, state).a for state in (moving, known)]
    assert np.array_equal(*two)
    ends = [sp.simulate(mechanism, state, 0.05, times=[0.0, 0.05]).q[-1]
            for state in (moving, known)]
    assert ends[0] == pytest.approx(ends[1], abs=1e-12)


def test_a_screw_closure_counts_from_the_turns_that_are_given():
    model = pin.Model()
    for name, joint in (("turn", pin.JointModelRZ()), ("slide", pin.JointModelPZ())):
        index = model.addJoint(0, joint, pin.SE3.Identity(), name)
        model.addBodyFrame(f"{name}_link", index, pin.SE3.Identity(), 0)
    screw = sp.closures.screw("turn_link", "slide_link", lead=-0.01)
    mechanism = sp.Mechanism.from_model(model, [screw], drivers=["turn"])
    start = sp.assemble(mechanism, {"turn": 0.5})
    turned = sp.sweep(mechanism, "turn", np.linspace(0.5, 0.5 + 4.0 * np.pi, 41),
                      guess=start).state(-1)
    known = sp.State(mechanism, turned.q, angles=turned.angles)
    assert known.closure_error < 1e-12 and known.angles == pytest.approx(turned.angles)
    counted = sp.State(mechanism, turned.q)  # the hinge's angle says how many turns
    assert counted.closure_error < 1e-12 and counted.coordinate("slide").value == pytest.approx(
        0.01 * turned.coordinate("turn").value / (2.0 * np.pi), abs=1e-12)


@pytest.mark.parametrize("wrong", ["q", "v", "angles", "mechanism"])
def test_numbers_that_are_none_of_a_state_are_refused(wrong):
    mechanism = sp.load("rssr")
    q, v = mechanism.neutral, np.zeros(mechanism.model.nv)
    with pytest.raises(TypeError if wrong == "mechanism" else ValueError):
        if wrong == "mechanism":
            sp.State("rssr", q)
        elif wrong == "angles":
            sp.State(mechanism, q, angles=np.zeros(3))
        else:
            sp.State(mechanism, q[:-1] if wrong == "q" else q, v[:-1] if wrong == "v" else v)


def test_what_pinocchios_model_says_of_resistance_acts():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "hinge")
    lever = pin.SE3(np.eye(3), np.array([0.0, 0.5, 0.0]))
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), lever)
    model.friction[:], model.damping[:] = 2.0, 0.5
    mechanism = sp.Mechanism.from_model(model)
    state = sp.State(mechanism, np.zeros(1), np.array([3.0]))
    effort = sp.inverse_dynamics(mechanism, state).efforts["hinge"]
    assert effort == pytest.approx(0.5 * 3.0 + 2.0 + 0.5 * 9.81, abs=1e-9)
