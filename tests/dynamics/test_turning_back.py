"""Motions go on where the joint that counts them turns back, however sharply."""

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from masses import heavy

import spatial_pin as sp
from spatial_pin.dynamics.simulation.formulations.independent import Independent
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.simulate import _independent


def rod(mass, length):
    return mass, (0.5 * length, 0.0, 0.0), (0.0, mass * length**2 / 12, mass * length**2 / 12)


def arm_on_a_slider(folder, seed):
    """A block on a rail and an arm pinned to it, whose tip a rod holds to the ground."""
    rng = np.random.default_rng(seed)
    length, _ = rng.uniform(0.3, 1.2), rng.uniform(-0.5, 0.5)
    slide, angle = rng.uniform(-0.5, 0.5), rng.uniform(-2.0, 2.0)
    tip = np.array([slide + length * np.cos(angle), length * np.sin(angle), 0.0])
    anchor = np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), 0.0])
    tree = (known.sliding("slide", "ground", "block", (0, 0, 0), (1, 0, 0))
            + known.turning("pin", "block", "arm") + known.point("tip", "arm", (length, 0, 0))
            + known.point("anchor", "ground", anchor))
    toml = "gravity = [0.0, -9.81, 0.0]\n" + known.closure(
        "rod", "distance", "tip", "anchor", length=np.linalg.norm(tip - anchor))
    mech = known.load(folder, "arm", heavy(tree, block=(1.0,), arm=rod(1.0, length)), toml)
    return sp.assemble(mech, guess={"slide": slide, "pin": angle})


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


def rod_end_on_a_line(folder, height, symmetric=True, wrap=str):
    """A crank, a rod on a ball joint at its end, and the rod's end on a line above the crank.

    The crank rocks; beside it only a ball joint moves, whose components count nothing by turns.
    """
    across = 0.06 if symmetric else 0.055
    tree = heavy(known.turning("pin", "ground", "crank")
                 + known.floating("ball", "crank", "rod", (0.5, 0, 0))
                 + known.point("end", "rod", (0.8, 0, 0))
                 + known.point("rail", "ground", (0, 0.9, height), known.rpy_facing((1, 0, 0))),
                 crank=(1.0, (0.25, 0, 0), (0.01, 0.02, 0.02)),
                 rod=(1.0, (0.4, 0, 0), (0.01, 0.06, across)))
    toml = ("gravity = [3.0, -9.81, 0.0]\n" + known.refine("ball", "spherical")
            + known.closure("rail", "point_on_line", "rail", "end"))
    mech = known.load(folder, "rod_end", wrap(tree), toml)
    return sp.assemble(mech, {"pin": 0.6}, guess={"ball": [0.0, 0.0, 1.0]})


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


def test_nothing_that_was_given_up_is_tried_again(tmp_path):
    """From joint to joint, the fastest first; where there is no other, the best of all."""
    state = arm_on_a_slider(tmp_path, 21)
    problem, given_up, found = Problem(state.mechanism, None, None, None, 1e-13), set(), []
    for _ in range(3):
        system = _independent(problem, state, given_up)
        found.append(tuple(system.free))
        given_up.add((Independent, found[-1]))
    assert len(set(found)) == 2
    assert found[2] in found[:2]


@pytest.mark.parametrize("gap", [1e-2, 1e-4, 1e-7])
def test_a_motion_goes_to_the_limit_itself(tmp_path, gap):
    """Here the rod leans back."""
    state = rod_end_on_a_line(tmp_path, 0.0)
    assert state.placement("end").translation[0] < state.placement("rod").translation[0]
    system = _independent(Problem(state.mechanism, None, None, None, 1e-13), state)
    angle = np.arcsin((0.9 - 0.8) / 0.5) + gap
    lean = np.pi - np.arcsin((0.9 - 0.5 * np.sin(angle)) / 0.8)
    rate = -0.5 * np.cos(angle) / (0.8 * np.cos(lean))  # how fast it turns, for the crank
    y = np.concatenate([[angle - state.coordinate("pin").value, 1.0],
                        state.q[state.mechanism.coordinate("ball.x").q :][:0]])
    y = np.concatenate([y, system.unknowns(state.v, 0.0)[2:]])
    sample = system.samples(np.zeros(1), y[None])
    assert sample.q[0, state.mechanism.coordinate("pin").q] == pytest.approx(angle, abs=1e-15)
    inertia = (0.02 + 0.25**2 + 0.5**2 + (0.06 + 0.4**2) * rate**2
               + 2.0 * 0.5 * 0.4 * np.cos(lean - angle) * rate)
    assert 2.0 * sample.numbers[0, 1] == pytest.approx(inertia, rel=1e-13 / gap)


@pytest.mark.parametrize("first", [0.0, 5e-324, 1e-300, 1e-20])
def test_a_step_of_nothing_tells_nothing_of_the_next(first):
    """Change of curvature over no way at all is no third derivative."""
    mechanism = sp.load("rssr")
    motion = sp.sweep(mechanism, "crank", [0.0, first, 0.01, 0.02])
    exact = sp.assemble(mechanism, {"crank": 0.02})
    rocker = mechanism.coordinate("rocker_pin").q
    assert motion.q[-1, rocker] == pytest.approx(exact.q[rocker], abs=1e-12)
