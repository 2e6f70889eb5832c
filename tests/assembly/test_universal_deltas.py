"""Deltas whose rods have universal joints: as drawn they move; with pins exchanged they shake."""

import numpy as np
import pinocchio as pin
import pytest
from variety import few, paired

import spatial_pin as sp

pytestmark = [pytest.mark.delicate,
              pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")]
PLATFORM = np.array([0.0, 0.0, -0.9])
ARM, BASE, EDGE, HALF_WIDTH = 0.4, 0.3, 0.1, 0.06
ONE, OTHER = (1, 0, 0), (0, 1, 0)
DRIVERS = ("arm_0", "arm_1", "arm_2")


def rounded(place, digits):
    turn = np.round(pin.Quaternion(place.rotation).coeffs(), digits)
    return pin.SE3(pin.Quaternion(turn).normalized().matrix(), np.round(place.translation, digits))


def delta(exchanged=(), digits=17):
    """A delta with two rods a leg and a universal joint at each end; 24 equations, 6 redundant.

    In the legs that are `exchanged` the pins at the platform have changed places. All numbers are
    rounded to some digits, and the loops close as drawn.
    """
    model, closures = pin.Model(), []

    def add(parent, joint, place, name, mass):
        index = model.addJoint(parent, joint, rounded(place, digits), name)
        model.appendBodyToJoint(index, pin.Inertia(mass, np.zeros(3), 0.01 * np.eye(3)),
                                pin.SE3.Identity())
        return index

    add(0, pin.JointModelFreeFlyer(), pin.SE3(np.eye(3), PLATFORM), "platform", 1.0)
    for k in range(3):
        leg = pin.rpy.rpyToMatrix(0.0, 0.0, 2.0 * np.pi * k / 3.0)
        hinge = pin.SE3(leg, leg @ [BASE, 0.0, 0.0])
        arm = add(0, pin.JointModelRY(), hinge, f"arm_{k}", 0.5)
        for side, at in (("a", HALF_WIDTH), ("b", -HALF_WIDTH)):
            elbow, wrist = hinge.act(np.array([ARM, at, 0.0])), leg @ [EDGE, at, 0.0] + PLATFORM
            along = (wrist - elbow) / np.linalg.norm(wrist - elbow)
            rod = np.column_stack([np.cross(leg[:, 1], along), leg[:, 1], along])
            name = f"{k}{side}"
            pivot = add(arm, pin.JointModelRY(), hinge.actInv(pin.SE3(rod, elbow)),
                        f"pivot_{name}", 0.0)
            add(pivot, pin.JointModelRX(), pin.SE3.Identity(), f"rod_{name}", 0.1)
            closures.append((k, f"rod_{name}", pin.SE3(rod, wrist)))
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    ends = []
    for k, name, place in closures:
        frames = [(link, data.oMi[model.getJointId(link)].actInv(place))
                  for link in (name, "platform")]
        axes = (OTHER, ONE) if k in exchanged else (ONE, OTHER)
        ends.append(sp.closures.universal(*frames, axis=axes[0], axis2=axes[1], name=f"end_{name}"))
    return sp.Mechanism.from_model(model, ends, drivers=DRIVERS)


@pytest.mark.parametrize("digits", few([17, 9, 4], 17, 4))
def test_a_delta_moves_however_its_numbers_are_rounded(digits):
    mechanism = delta(digits=digits)
    state = sp.assemble(mechanism)
    assert sp.mobility(mechanism, state).dof == 3
    exact = delta()
    wanted = sp.forward_dynamics(exact, sp.assemble(exact)).a
    found = sp.forward_dynamics(mechanism, state).a
    near = 10.0 ** (2 - digits) * np.abs(wanted).max() + 1e-11
    assert found == pytest.approx(wanted, abs=near)
    swept = sp.sweep(mechanism, "arm_0", np.linspace(0.0, 0.2, 5), hold=["arm_1", "arm_2"])
    turned = [pin.log3(swept.state(row).placement("platform").rotation) for row in range(5)]
    assert np.abs(turned).max() < 10.0 ** (2 - digits) + 1e-11


@pytest.mark.parametrize(("exchanged", "digits"), paired([(0, 1), (1, 2)], [17, 9, 7, 6, 4]))
def test_all_verbs_say_that_a_delta_with_exchanged_pins_is_singular(exchanged, digits):
    """To the first order it moves three ways as a delta does, in earnest one way only."""
    mechanism = delta(exchanged, digits)
    state = sp.assemble(mechanism)
    found = sp.mobility(mechanism, state)
    assert (found.dof, found.instantaneous) == (1, 3)
    speeds = dict.fromkeys(DRIVERS, 0.1)
    for verb in (lambda: sp.solve_rates(mechanism, state, speeds),
                 lambda: sp.jacobian(mechanism, state, "platform"),
                 lambda: sp.sweep(mechanism, "arm_0", np.linspace(0.0, 0.2, 5)),
                 lambda: sp.forward_dynamics(mechanism, state),
                 lambda: sp.inverse_dynamics(mechanism, state),
                 lambda: sp.simulate(mechanism, state, 0.01)):
        with pytest.raises(sp.SingularError, match="the loops lose 2 independent equations"):
            verb()


@pytest.mark.parametrize("exchanged", few([(0, 1), (1, 2)], (1, 2)))
def test_in_three_digits_such_a_delta_has_one_freedom_for_all_verbs(exchanged):
    """It goes down, until branches cross."""
    mechanism = delta(exchanged, 3)
    state = sp.assemble(mechanism)
    found = sp.mobility(mechanism, state)
    assert (found.dof, found.instantaneous) == (1, 1)
    fallen = sp.forward_dynamics(mechanism, state).a
    assert fallen[:3] == pytest.approx(sp.forward_dynamics(delta(), sp.assemble(delta())).a[:3],
                                       abs=1e-6)
    speeds = dict.fromkeys(DRIVERS, 0.1)
    for verb in (lambda: sp.solve_rates(mechanism, state, speeds),
                 lambda: sp.jacobian(mechanism, state, "platform")):
        with pytest.raises(sp.SingularError, match="the closed mechanism has 1 freedom there"):
            verb()
    with pytest.raises(sp.SingularError, match="just ahead the loops lose rank") as caught:
        sp.simulate(mechanism, state, 0.1)
    assert 0.06 < caught.value.motion.time[-1] < 0.066
    with pytest.raises(sp.SpatialPinError, match="branches cross"):
        sp.sweep(mechanism, "arm_0", np.linspace(0.0, 0.2, 5))
