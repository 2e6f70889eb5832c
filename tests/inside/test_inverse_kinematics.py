"""Inside of inverse kinematics: derivatives of targets, starts, and how many steps are taken."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from machines import arm, at

import spatial_pin as sp
from spatial_pin import targets
from spatial_pin.inverse_kinematics import reach
from spatial_pin.inverse_kinematics.named_targets import read_targets
from spatial_pin.inverse_kinematics.solving import Level, Solver, Stationary
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.numerics.least_squares import Descent, Iterate, Lagrangian


def test_an_answer_from_afar_comes_without_whole_turns(tmp_path, monkeypatch):
    mechanism = arm(tmp_path)
    start = at(mechanism, 0.3, 0.4, 0.5)
    direct = sp.reach(mechanism, {"tip": [1.2, 1.3, 0.0]}, start)
    monkeypatch.setattr(reach, "_best", lambda start, solver, _: solver.reached(start.q, {}))
    monkeypatch.setattr(reach, "_far_starts",
                        lambda start, *_: [start.q + np.array([4.0 * np.pi, -2.0 * np.pi, 0.1])])
    turned = sp.reach(mechanism, {"tip": [1.2, 1.3, 0.0]}, start)
    assert np.abs(turned.q - direct.q).max() < 1e-8


def test_forces_pull_as_the_derivatives_say(tmp_path):
    """Of every kind of target, also of those that stand for sums of squares that stay least."""
    mechanism = arm(tmp_path, (1.0, 0.8, 0.6, 0.5, 0.4))
    state = at(mechanism, 0.3, 0.4, 0.5, -0.3, 0.2)
    with loops_of(mechanism) as evaluation:
        base = Solver(evaluation, [], [], [], 1e-12)
        wanted = [targets.Position(name="link3", point=np.array([2.0, 2.5, 0.0]), weight=1.0)]
        least = Lagrangian(Iterate(Level(base, [], wanted), state.q), base.moves)
        sizes, ways = least.curved()
        bent = Stationary(name="", sum=least, sizes=sizes, ways=ways)
        assert len(sizes)
        for target in (*wanted, bent):
            evaluation.update(state.q)
            rows = target.residual(evaluation)[1]
            forces = np.arange(1.0, len(rows) + 3.0)
            pulled, others = target.pulled(evaluation, forces)
            assert np.abs(pulled - forces[:-2] @ rows).max() < 1e-8
            assert list(others) == list(forces[-2:])


def test_derivatives_of_every_kind_are_those_of_differences(tmp_path):
    mechanism = library("stewart")
    start = sp.assemble(mechanism)
    placement = start.placement("platform") * pin.SE3(pin.exp3(np.array([0.4, 0.3, -0.5])),
                                                      np.array([0.1, 0.2, 0.3]))
    wanted = {
        "platform": targets.pose(placement), "platform_1": targets.position([0.1, 0.2, 0.3]),
        "platform_2": targets.direction([0, 0.6, 0.8], [1, 0, 0]),
        "platform_3": targets.distance("ground", 0.7), "leg_1": 0.3,
        "hook_2.first": 0.2, "all": targets.centre_of_mass(0.1, None, 0.3),
        "platform_2.position.z": 0.4, "platform.com.position": [0.1, 0.2, 0.3],
        "com.position.y": 0.1, "platform.angle.z": 0.3, "platform_1.angle.x": 0.2}
    with loops_of(mechanism) as evaluation:
        for target in read_targets(mechanism, wanted):
            evaluation.update(start.q)
            _, slope = target.residual(evaluation)
            for v in range(mechanism.model.nv):
                step = np.zeros(mechanism.model.nv)
                step[v] = 1e-6
                ends = []
                for sign in (1.0, -1.0):
                    evaluation.update(pin.integrate(mechanism.model, start.q, sign * step))
                    ends.append(target.residual(evaluation)[0])
                assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(slope[:, v], abs=2e-8)


@pytest.mark.delicate
def test_a_dead_centre_is_reached_in_few_steps(monkeypatch):
    """A double root: Newton's steps halve the way there, a parabola leads on to its vertex."""
    mechanism = library("four_bar")
    end = sp.limits(mechanism, "rocker_pin").upper
    start = sp.assemble(mechanism)
    steps, own = [], Descent._step
    monkeypatch.setattr(Descent, "_step", lambda *a: steps.append(1) or own(*a))
    for short in (0.0, 1e-9, 1e-5):
        steps.clear()
        state = sp.reach(mechanism, {"rocker_pin": end.value - short}, start)
        assert state.coordinate("rocker_pin").value == pytest.approx(end.value - short, abs=1e-12)
        assert len(steps) < 15


def test_motion_is_least_from_the_state_whatever_it_is_tried_from(monkeypatch):
    """A near state that does not lead there: another start does, which is turned idly too."""
    mechanism = library("rssr")
    start = sp.assemble(mechanism, {"crank": 0.5})
    direct = sp.reach(mechanism, {"crank": 0.8}, start)
    others = reach._starts
    monkeypatch.setattr(reach, "_starts", lambda *a: list(others(*a))[1:])
    around = sp.reach(mechanism, {"crank": 0.8}, start)
    assert np.abs(around.q - direct.q).max() < 1e-8


@pytest.mark.delicate
def test_few_steps_lead_to_the_nearest(monkeypatch):
    """Newton's double the digits; Gauss's, of which there were 520, add one in ten of them."""
    steps, made = [], Descent._landed
    monkeypatch.setattr(Descent, "_landed", lambda *a: steps.append(0) or made(*a))
    mechanism = library("four_bar")
    point = sp.assemble(mechanism).placement("coupler").translation + np.array([0.3, 0.1, 0.01])
    with pytest.raises(sp.ReachError) as caught:
        sp.reach(mechanism, {"coupler": point})
    assert len(steps) < 200
    q = caught.value.state.q
    with pytest.raises(sp.ReachError) as again:
        sp.reach(mechanism, {"coupler": point}, caught.value.state, starts=0)
    assert np.abs(again.value.state.q - q).max() < 1e-10
