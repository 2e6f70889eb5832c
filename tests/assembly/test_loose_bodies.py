"""Models whose bodies are all free, each on a floating joint: none is a base that is held."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp


def loose(n: int) -> sp.Mechanism:
    """Return n bodies in a row that nothing joins."""
    model = pin.Model()
    for k in range(n):
        place = pin.SE3(np.eye(3), np.array([float(k), 0.0, 0.0]))
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), place, f"body_{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.1, 0.2, 0.3), pin.SE3.Identity())
    return sp.Mechanism.from_model(model, name="loose")


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_loose_body_is_led_anywhere_and_the_others_stay(n):
    mechanism = loose(n)
    start = sp.assemble(mechanism)
    goal = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.9])), np.array([1.0, -2.0, 3.0]))
    state = sp.reach(mechanism, {f"body_{n - 1}": goal}, start)
    assert state.placement(f"body_{n - 1}").isApprox(goal, 1e-12)
    for k in range(n - 1):
        assert state.placement(f"body_{k}").homogeneous == pytest.approx(
            start.placement(f"body_{k}").homogeneous, abs=1e-12)


def test_one_loose_body_goes_along_placements():
    mechanism = loose(1)
    poses = [pin.SE3(pin.exp3(x * np.array([0.3, -0.5, 0.9])), x * np.array([1.0, -2.0, 3.0]))
             for x in np.linspace(0.0, 1.0, 5)]
    motion = sp.reach_path(mechanism, {"body_0": poses}, np.linspace(0.0, 1.0, 5))
    assert motion.frame("body_0").position == pytest.approx(
        np.array([p.translation for p in poses]), abs=1e-12)


@pytest.mark.parametrize("n", [1, 3])
def test_the_freedoms_of_loose_bodies_are_all_there(n):
    mechanism = loose(n)
    found = sp.mobility(mechanism)
    assert found.dof == 6 * n and "free base" not in str(found)
    assert sp.jacobian(mechanism, sp.assemble(mechanism), "body_0").shape == (6, 6 * n)
    with pytest.raises(sp.ContinuumError):
        sp.assembly_modes(mechanism)


def test_what_a_loose_body_is_driven_by_moves_alone():
    mechanism = loose(2)
    motion = sp.sweep(mechanism, "body_1.z", [0.0, 0.5, 1.0], speed=1.0)
    assert motion.frame("body_1").position == pytest.approx(
        np.array([[1.0, 0.0, z] for z in (0.0, 0.5, 1.0)]), abs=1e-14)
    assert np.ptp(motion.frame("body_0").position, axis=0) == pytest.approx(np.zeros(3), abs=1e-14)


def test_a_robot_with_a_joint_beside_its_floating_one_has_a_base_that_is_held():
    mechanism = sp.load("four_bar", free_flyer=True)
    assert "root_joint carries all of it as a free base" in str(sp.mobility(mechanism))
    start = sp.assemble(mechanism)
    with pytest.raises(sp.ReachError, match="no free coordinate moves them"):
        sp.reach(mechanism, {"ground": [1.0, 2.0, 3.0]}, start)


def test_the_efforts_of_a_loose_body_are_refused_in_words():
    mechanism = loose(1)
    with pytest.raises(sp.SpatialPinError, match="floats freely, and no motor acts there"):
        sp.inverse_dynamics(mechanism, sp.assemble(mechanism))
