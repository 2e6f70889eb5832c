"""Motions go on where the joint that counts them turns back, however sharply."""

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from masses import heavy
from turning_back import arm_on_a_slider, rod, rod_end_on_a_line

import spatial_pin as sp


def top_on_an_arm(folder, seed):
    """A body on a ball joint at the end of an arm; one axis is kept normal to one of the arm."""
    rng = np.random.default_rng(seed)
    rng.normal(size=3)
    turn, com = rng.normal(size=3), rng.normal(size=3) * 0.3
    axis = np.cross(pin.exp3(turn).T @ np.array([0.0, 0.0, 1.0]), rng.normal(size=3))
    tree = (known.turning("pin", "ground", "arm", axis=(0, 1, 0))
            + known.floating("ball", "arm", "top", (0.4, 0, 0)))
    toml = ("gravity = [0.0, 0.0, -9.81]\n" + known.refine("ball", "spherical") + known.closure(
        "flat", "perpendicular", "arm", "top", axis=(0, 0, 1),
        axis2=axis / np.linalg.norm(axis)))
    mech = known.load(folder, "top", heavy(
        tree, arm=rod(1.0, 0.4), top=(1.0, tuple(com), (0.1, 0.12, 0.15))), toml)
    return sp.assemble(mech, guess={"pin": 0.3, "ball": turn})


def assert_formulations_agree(state, until, most=1e-6):
    motions = [sp.simulate(state.mechanism, state, until, times=np.linspace(0.0, until, 6),
                           accuracy=sp.Accuracy(formulation=name, time_tolerance=1e-11))
               for name in ("independent", "projected")]
    assert max(motion.energy_drift for motion in motions) < 1e-7
    assert max(motion.closure_error.max() for motion in motions) < 1e-11
    model = state.mechanism.model
    assert max(np.abs(pin.difference(model, *pair)).max()
               for pair in zip(*(motion.q for motion in motions), strict=True)) < most
    return motions[0]


@pytest.mark.parametrize("seed", [21, 44, 52, 3, 8])
def test_a_joint_that_turns_back_sharply_hands_over_to_another(tmp_path, seed):
    """Before its limit its functions go as a root: pieces of a table end too early there."""
    assert_formulations_agree(arm_on_a_slider(tmp_path, seed), 1.0)


@pytest.mark.parametrize("seed", [33, 37, 45, 57, 2])
def test_coordinates_of_ball_joints_are_left_where_they_fold(tmp_path, seed):
    """Not where velocities do: coordinates of a rotation are other functions than theirs."""
    assert_formulations_agree(top_on_an_arm(tmp_path, seed), 1.0)


@pytest.mark.parametrize("wrap", [str, known.tilted])
@pytest.mark.parametrize("height", [0.0, 0.2])
def test_where_the_only_joint_that_counts_turns_back_others_carry_on(tmp_path, height, wrap):
    state = rod_end_on_a_line(tmp_path, height, wrap=wrap)
    motion = assert_formulations_agree(state, 2.0)
    assert {"pin", "ball.x"} <= set(motion.coordinates)  # the rod spins beside


@pytest.mark.parametrize("first", [0.0, 5e-324, 1e-300, 1e-20])
def test_a_step_of_nothing_tells_nothing_of_the_next(first):
    """Change of curvature over no way at all is no third derivative."""
    mechanism = sp.load("rssr")
    motion = sp.sweep(mechanism, "crank", [0.0, first, 0.01, 0.02])
    exact = sp.assemble(mechanism, {"crank": 0.02})
    rocker = mechanism.coordinate("rocker_pin").q
    assert motion.q[-1, rocker] == pytest.approx(exact.q[rocker], abs=1e-12)
