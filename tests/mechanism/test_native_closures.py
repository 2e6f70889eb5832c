"""Closures as constraints of Pinocchio: the same gap, the same motions, the same closed poses."""

import numpy as np
import pinocchio as pin
import pytest
from closure_trees import PAIRS
from loaded_library import library
from sameness import near
from scipy.linalg import null_space
from variety import few

import spatial_pin as sp


@pytest.fixture(autouse=True)
def _the_same_numbers_in_any_order():
    pin.seed(1)


NATIVE = ["crank_collar", "delta", "rspc", "rssr", "rssr_crossed", "stewart"]
MAKE = {"spherical": sp.closures.spherical, "weld": sp.closures.weld, "fixed": sp.closures.fixed}


def held(kind):
    """A humanoid that holds its hands together, tools in them that point elsewhere."""
    model = pin.buildSampleModelHumanoid()
    for arm, aside in (("larm", 0.2), ("rarm", -0.2)):
        joint = model.getJointId(f"{arm}_shoulder1_joint")
        model.jointPlacements[joint] = pin.SE3(
            np.eye(3), np.array([0.0, aside, 0.3])) * model.jointPlacements[joint]
    tools = [(f"{side}_effector_body", pin.SE3(pin.rpy.rpyToMatrix(0.3, k, 0.1),
                                               np.array([0.0, 0.05, 0.02])))
             for side, k in (("larm", 0.2), ("rarm", -0.4))]
    return sp.Mechanism.from_model(model, [MAKE[kind](*tools)], name=kind)


def made(name):
    return held(name) if name in MAKE else library(name)


every_case = pytest.mark.parametrize("name", few([*NATIVE, *MAKE], "crank_collar", "rssr",
                                                 "stewart", "spherical", "weld"))


def datas(mech, q):
    """Pinocchio's models and data of the closures at q, and its Jacobian of them."""
    models = pin.StdVec_RigidConstraintModel(mech.constraint_models())
    found = pin.StdVec_RigidConstraintData([m.createData() for m in models])
    data = mech.model.createData()
    pin.computeJointJacobians(mech.model, data, q)
    for m, d in zip(models, found, strict=True):
        m.calc(mech.model, data, d)
    return models, found, np.array(pin.getConstraintsJacobian(mech.model, data, models, found))


def frames(mech, q, v):
    data = mech.model.createData()
    pin.forwardKinematics(mech.model, data, q, v)
    pin.updateFramePlacements(mech.model, data)

    def of(name):
        i = mech.frame_id(name)
        return data.oMf[i].copy(), pin.getFrameVelocity(mech.model, data, i, pin.LOCAL)

    return [tuple(map(of, c.frames)) for c in mech.closures]


def test_every_kind_that_pinocchio_has_is_looked_at():
    kinds = {c.type for name in (*NATIVE, *MAKE) for c in made(name).closures}
    assert kinds == {kind for kind, pair in PAIRS.items() if pair.native is not None and pair.rows}


@pytest.mark.slow
def test_no_other_mechanism_of_the_library_is_made_of_such_closures_alone():
    others = [sp.load(name) for name in sp.list_mechanisms() if name not in NATIVE]
    assert others
    for mech in others:
        if mech.closures:
            with pytest.raises(sp.ClosureTypeError):
                mech.constraint_models()


@every_case
def test_the_gap_and_its_rate_are_those_of_the_frames_wherever_it_stands(name):
    mech = made(name)
    rng = np.random.default_rng(4)
    for _ in range(5):
        q = pin.integrate(mech.model, mech.neutral,
                          rng.uniform(-1.0, 1.0, mech.model.nv) * mech.velocity_scale)
        v = rng.normal(size=mech.model.nv) * mech.velocity_scale
        models, found, jacobian = datas(mech, q)
        size = mech.characteristic_length
        begin = 0
        for closure, model, data, ((one, twist_1), (two, twist_2)) in zip(
                mech.closures, models, found, frames(mech, q, v), strict=True):
            assert model.name == closure.name
            gap = one.actInv(two)
            near(data.c1Mc2.rotation, gap.rotation, 1e-14)
            near(data.c1Mc2.translation, gap.translation, 1e-14 * size)
            rows = jacobian[begin : begin + model.residualSize()] @ v
            begin += model.residualSize()
            if len(rows) == 3:
                expected = twist_1.linear - gap.rotation @ twist_2.linear
            else:
                expected = (twist_1 - gap.act(twist_2)).vector
            near(rows, expected, 1e-12 * max(1.0, size) * np.abs(v / mech.velocity_scale).max())


@every_case
def test_closed_they_allow_the_same_motions(name):
    mech = made(name)
    state = sp.assemble(mech)
    _, found, jacobian = datas(mech, state.q)
    size = mech.characteristic_length
    for data in found:
        near(data.c1Mc2.translation, np.zeros(3), 1e-12 * size)
    own = sp.closure_jacobian(mech, state.q)
    free = null_space(own * mech.velocity_scale, 1e-9)
    assert free.shape == null_space(jacobian * mech.velocity_scale, 1e-9).shape
    near(jacobian * mech.velocity_scale @ free, np.zeros((len(jacobian), free.shape[1])),
         1e-11 * max(1.0, size))


@every_case
def test_made_anew_of_these_it_closes_in_the_same_places(name):
    mech = made(name)
    again = sp.Mechanism.from_model(
        mech.model, mech.constraint_models(), name=mech.name, guess=mech.guess,
        passives=mech.passives, drivers={k: d.joint for k, d in mech.drivers.items()})
    assert [c.name for c in again.closures] == [c.name for c in mech.closures]
    rng = np.random.default_rng(5)
    middle = sp.assemble(mech)
    for _ in range(3):
        start = pin.integrate(mech.model, middle.q, 0.05 * mech.velocity_scale
                              * rng.uniform(-1.0, 1.0, mech.model.nv))
        one, other = sp.assemble(mech, guess=start), sp.assemble(again, guess=start)
        near(other.q, one.q, 1e-11)


def test_a_part_of_a_closure_is_none_of_pinocchios():
    model = held("weld").model
    ends = "larm_effector_body", "rarm_effector_body"
    part = sp.closures.spherical(*ends, name="grip", equations=[0, 2])
    mech = sp.Mechanism.from_model(model, [part])
    with pytest.raises(sp.ClosureTypeError, match=r"'grip' is spherical with equations \[0, 2\]"):
        mech.constraint_models()
