"""Open trees of every kind of joint, long and bushy, and their States in motion."""

import numpy as np
import pinocchio as pin

import spatial_pin as sp

BODY = (1.0, (0.05, 0.01, -0.02), (1e-3, 2e-3, 2.5e-3))
INERTIA = pin.Inertia(BODY[0], np.array(BODY[1]), np.diag(BODY[2]))
KINDS = {
    "hinges": [pin.JointModelRY(), pin.JointModelRX()],
    "slides and hinges": [pin.JointModelPX(), pin.JointModelRevoluteUnaligned(0.6, 0.0, 0.8)],
    "balls": [pin.JointModelSpherical()],
    "screws": [pin.JointModelHX(0.1), pin.JointModelRZ()],
    "universal": [pin.JointModelUniversal(np.array([0.0, 1, 0]), np.array([1.0, 0, 0]))],
    "free": [pin.JointModelFreeFlyer(), pin.JointModelRX(), pin.JointModelRY()],
}


def tree(joints, n, parent_of, seed=0):
    """A tree of n joints, each on `parent_of(k)` of those before it."""
    rng, model = np.random.default_rng(seed), pin.Model()
    for k in range(n):
        place = pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-0.4, 0.4, 3)), np.array([0.1, 0.0, 0.0]))
        made = model.addJoint(parent_of(k), joints[k % len(joints)], place, f"j{k}")
        model.addBodyFrame(f"link{k}", made, pin.SE3.Identity(), 0)
        model.appendBodyToJoint(made, INERTIA, pin.SE3.Identity())
    model.armature = np.where(rng.uniform(size=model.nv) < 0.3, 0.01, 0.0)
    return sp.Mechanism.from_model(model)


def bushy(seed):
    """Return a parent for each joint such that joints are not in the order of the branches."""
    rng = np.random.default_rng(seed)
    chosen = [int(rng.integers(max(0, k - 6), k + 1)) for k in range(300)]
    return lambda k: chosen[k]


def straight(k):
    return k


def moving(mech, seed=1):
    rng, model = np.random.default_rng(seed), mech.model
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.5, 0.5, model.nv))
    v, a = rng.uniform(-1, 1, (2, model.nv))
    return sp.State(mech, q, v, a, closure_error=0.0)


def efforts_of(mech, tau):
    return {name: float(tau[mech.coordinate(name).v]) for name in mech.coordinates
            if mech.coordinate(name).q >= 0}
