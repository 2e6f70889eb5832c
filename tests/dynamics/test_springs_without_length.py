"""Derivatives of the dynamics where the two frames of a spring coincide."""

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp
from spatial_pin.errors import SpatialPinError

STENCIL = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
INERTIA = pin.Inertia(1.5, np.array([0.1, 0.02, -0.03]), np.diag([0.02, 0.03, 0.04]))
LEVER = np.array([0.2, -0.1, 0.3])
TILTED = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([3.0, -2.0, 1.0]))
HINGE, SLIDE, FREE = pin.JointModelRY(), pin.JointModelPX(), pin.JointModelFreeFlyer()


def pulled(joints, lever, second=None, **spring):
    """A chain of joints whose last body is tied to the ground, or to another joint, by a spring.

    `lever` is where the spring grips the last body; the other frame is there at neutral.
    """
    model, parent = pin.Model(), 0
    for k, joint in enumerate(joints):
        placement = TILTED if not k else pin.SE3(np.eye(3), np.zeros(3))
        parent = model.addJoint(parent, joint, placement, f"j{k}")
        model.appendBodyToJoint(parent, INERTIA, pin.SE3.Identity())
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    other = 0 if second is None else second
    grip = data.oMi[parent] * pin.SE3(np.eye(3), lever)
    model.addFrame(pin.Frame("end", parent, 0, pin.SE3(np.eye(3), lever), pin.OP_FRAME))
    model.addFrame(pin.Frame("post", other, 0, data.oMi[other].actInv(grip), pin.OP_FRAME))
    return sp.Mechanism.from_model(
        model, springs=[sp.Spring("band", frames=("post", "end"), **spring)])


def moving(mech):
    v = np.random.default_rng(4).uniform(-1, 1, mech.model.nv)
    return sp.State(mech, pin.neutral(mech.model), v, closure_error=0.0)


def loads(mech, q, v, **more):
    found = sp.forward_dynamics(mech, sp.State(mech, q, v, closure_error=0.0), **more)
    return np.concatenate([found.a, *(x.vector for x in found.reactions.values()),
                           found.on_ground.vector])


def differences(mech, state, h=1e-3, **more):
    return np.column_stack([
        sum(c * (loads(mech, pin.integrate(mech.model, state.q, k * h * d), state.v, **more)
                 - loads(mech, pin.integrate(mech.model, state.q, -k * h * d), state.v, **more))
            for k, c in STENCIL) / h
        for d in np.eye(mech.model.nv)])


def by_q(mech, state, **more):
    found = sp.dynamics_derivatives(mech, state, **more)
    return np.vstack([found.a_by_q, *(x.by_q for x in found.reactions.values()),
                      found.on_ground.by_q])


@pytest.mark.parametrize("joints", [[HINGE], [SLIDE], [FREE], [HINGE, SLIDE], [HINGE, FREE]],
                         ids=["hinge", "slide", "free", "arm", "free on a hinge"])
def test_a_band_without_free_length_has_derivatives_where_its_frames_coincide(joints):
    mech = pulled(joints, LEVER, stiffness=50.0)
    state = moving(mech)
    want = differences(mech, state)
    assert by_q(mech, state) == pytest.approx(want, abs=1e-7 * np.abs(want).max())
    assert np.abs(want - differences(pulled(joints, LEVER), state)).max() > 1.0


def test_a_band_between_two_moving_bodies():
    mech = pulled([FREE, FREE], LEVER, second=1, stiffness=50.0)
    state = moving(mech)
    want = differences(mech, state)
    assert by_q(mech, state) == pytest.approx(want, abs=1e-7 * np.abs(want).max())


def test_a_law_of_a_length_that_cannot_be_negative():
    mech = pulled([FREE], LEVER)
    state, laws = moving(mech), {"band": lambda x, _: 50.0 * x + 30.0 * x**1.5 * np.sqrt(x)}
    found = by_q(mech, state, laws=laws)
    assert found == pytest.approx(by_q(pulled([FREE], LEVER, stiffness=50.0), state), rel=1e-6)
    exact = by_q(mech, state, laws=laws, slopes={"band": lambda x, _: (50.0 + 60.0 * x, 0.0)})
    assert found == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.7, -2.0)], ids=["drawn", "turned"])
@pytest.mark.parametrize("numbers", [{"stiffness": 50.0}, {"stiffness": 50.0, "free_length": 0.3},
                                     {"damping": 4.0}], ids=str)
def test_frames_on_hinge_axes_never_part_and_change_nothing(numbers, angles):
    """Whatever the spring; only the sum of what the hinges bear is unique."""
    joints = [pin.JointModelRX(), HINGE]
    mech, bare = pulled(joints, 0.0 * LEVER, **numbers), pulled(joints, 0.0 * LEVER)
    v = np.array([1.0, -2.0])
    state, same = (sp.State(m, np.array(angles), v, closure_error=0.0)
                   for m in (mech, bare))
    found, want = sp.dynamics_derivatives(mech, state), sp.dynamics_derivatives(bare, same)
    for name in ("a", "a_by_q", "a_by_v"):
        assert getattr(found, name) == pytest.approx(getattr(want, name), abs=1e-11)
    assert by_q(mech, state) == pytest.approx(by_q(bare, same), abs=1e-11)


@pytest.mark.parametrize("joints", [[HINGE], [FREE]], ids=["hinge", "free"])
@pytest.mark.parametrize("numbers, word", [
    ({"stiffness": 50.0, "free_length": 0.3}, "its force of -15 N"), ({"damping": 4.0}, "damping")])
def test_a_force_without_direction_is_refused(joints, numbers, word):
    mech = pulled(joints, LEVER, **numbers)
    with pytest.raises(SpatialPinError, match=f"spring 'band' coincide, where .*{word}"):
        sp.dynamics_derivatives(mech, moving(mech))


def crossed(**numbers):
    """A parallelogram of two cranks and a rod, with a spring between points of its cranks."""
    model = pin.Model()
    for name, x in (("left", 0.0), ("right", 0.5)):
        joint = model.addJoint(0, HINGE, TILTED * pin.SE3(np.eye(3), np.array([x, 0, 0])), name)
        model.appendBodyToJoint(joint, INERTIA, pin.SE3.Identity())
    place = {name: (name, pin.SE3(np.eye(3), np.array(at))) for name, at in (
        ("left", (0.0, 0.0, 0.4)), ("right", (0.0, 0.0, 0.4)))}
    middle = [("left", pin.SE3(np.eye(3), np.array([0.25, 0.0, 0.2]))),
              ("right", pin.SE3(np.eye(3), np.array([-0.25, 0.0, 0.2])))]
    springs = [sp.Spring("band", frames=middle, **numbers)] if numbers else []
    return sp.Mechanism.from_model(
        model, [sp.closures.distance(place["left"], place["right"], 0.5, "rod")],
        drivers=["left"], springs=springs)


def test_a_band_without_length_across_a_loop():
    mech = crossed(stiffness=50.0)
    state = moving(mech)
    want = differences(mech, state)
    assert by_q(mech, state) == pytest.approx(want, abs=1e-7 * np.abs(want).max())
    assert np.abs(want - differences(crossed(), state)).max() > 1.0


# ---------------------------------------------------------------- all verbs alike


def held(joints, lever=LEVER, **numbers):
    """A chain at neutral, without weight, whose last body a spring of no length holds."""
    mech = pulled(joints, lever, **numbers)
    model = mech.model.copy()
    model.gravity.linear = np.zeros(3)
    drivers = [f"j{k}" for k, joint in enumerate(joints) if joint.nv == 1]
    return sp.Mechanism.from_model(model, springs=mech.springs, drivers=drivers)


@pytest.mark.parametrize("joints", [[HINGE], [SLIDE], [HINGE, SLIDE], [FREE]], ids=str)
def test_a_damper_acts_where_its_frames_pass_each_other(joints):
    """As just before and just after, in the direction of the motion."""
    mech = held(joints, stiffness=50.0, damping=4.0)
    model, q = mech.model, pin.neutral(mech.model)
    v = np.linspace(0.7, -1.3, model.nv)
    found, before, after = (
        sp.forward_dynamics(mech, sp.State(mech, pin.integrate(model, q, t * v), v)).a
        for t in (0.0, -1e-7, 1e-7))
    assert np.abs(found).max() > 1.0
    assert found == pytest.approx((before + after) / 2.0, abs=1e-5)
    motion = sp.simulate(mech, sp.State(mech, q, v), 1e-3, times=[0.0, 1e-3])
    assert motion.a[0] == pytest.approx(found, rel=1e-9)


@pytest.mark.parametrize("joints, freedoms", [([HINGE], 1), ([SLIDE], 1), ([HINGE, SLIDE], 2)])
def test_a_damped_band_holds_a_pose_at_rest_as_stiffly_as_an_undamped_one(joints, freedoms):
    damped, plain = (held(joints, stiffness=50.0, damping=c) for c in (4.0, 0.0))
    state, same = sp.assemble(damped), sp.assemble(plain)
    found, want = sp.equilibrium(damped, state), sp.equilibrium(plain, same)
    assert found.stiffness == pytest.approx(want.stiffness, rel=1e-12)
    assert found.stable and want.stiffness.shape == (freedoms, freedoms)
    name = damped.model.names[-1]
    assert sp.compliance(damped, state, name) == pytest.approx(
        sp.compliance(plain, same, name), rel=1e-12)


@pytest.mark.parametrize("joint", [HINGE, SLIDE])
def test_damping_along_one_line_is_linear(joint):
    mech = held([joint], stiffness=50.0, damping=4.0)
    state, q = sp.assemble(mech), pin.neutral(mech.model)
    vibration = sp.linearize(mech, state)
    assert vibration.damping == pytest.approx(vibration.stiffness * 4.0 / 50.0, rel=1e-12)
    found = sp.dynamics_derivatives(mech, state)
    by_v = np.vstack([found.a_by_v, *(x.by_v for x in found.reactions.values()),
                      found.on_ground.by_v])
    want = (loads(mech, q, np.array([1e-4])) - loads(mech, q, np.array([-1e-4]))) / 2e-4
    assert by_v[:, 0] == pytest.approx(want, abs=1e-9)


def test_damping_between_two_cranks_that_a_rod_joins_is_linear():
    """The cranks could part along two lines, but not with the rod."""
    mech = crossed(stiffness=50.0, damping=4.0)
    model = mech.model.copy()
    model.gravity.linear = np.zeros(3)
    mech = sp.Mechanism.from_model(model, mech.closures, drivers=["left"], springs=mech.springs)
    vibration = sp.linearize(mech, sp.assemble(mech))
    assert vibration.damping == pytest.approx(vibration.stiffness * 4.0 / 50.0, rel=1e-9)


@pytest.mark.parametrize("verb", ["linearize", "dynamics_derivatives"])
def test_damping_across_a_plane_is_not_linear_and_refused(verb):
    mech = held([HINGE, SLIDE], stiffness=50.0, damping=4.0)
    with pytest.raises(SpatialPinError, match="spring 'band' coincide, where its damping"):
        getattr(sp, verb)(mech, sp.assemble(mech))


@pytest.mark.parametrize("verb", [
    sp.forward_dynamics, sp.inverse_dynamics, sp.dynamics_derivatives, sp.linearize,
    lambda mech, state: sp.equilibrium(mech, state),
    lambda mech, state: sp.compliance(mech, state, "end"),
    lambda mech, state: sp.simulate(mech, state, 0.1),
    lambda mech, state: sp.kinetostatics(mech, sp.sweep(mech, "j0", [-0.1, 0.0, 0.1])),
], ids=["forward", "inverse", "derivatives", "linearize", "equilibrium", "compliance", "simulate",
        "kinetostatics"])
def test_a_spring_pressed_to_no_length_is_refused_by_every_verb(verb):
    mech = held([HINGE], stiffness=50.0, free_length=0.3)
    with pytest.raises(SpatialPinError, match="spring 'band' coincide, where its force of -15 N"):
        verb(mech, sp.assemble(mech))
