"""Long open trees in time: solved body by body, as exact as short ones."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp

KINDS = (pin.JointModelRY, pin.JointModelSpherical, pin.JointModelPX, pin.JointModelRX)


def chain(n: int) -> sp.Mechanism:
    """A chain that hangs on a floating base: hinges, balls and slides, with springs and dampers."""
    rng = np.random.default_rng(n)
    model, parent = pin.Model(), 0
    for k in range(n):
        kind = pin.JointModelFreeFlyer if k == 0 else KINDS[k % len(KINDS)]
        place = pin.SE3(np.eye(3), np.array([0.1, 0.02 * rng.normal(), 0.0]))
        parent = model.addJoint(parent, kind(), place, f"j{k}")
        body = pin.Inertia(rng.uniform(0.5, 2.0), 0.05 * rng.normal(size=3), np.eye(3) * 1e-2)
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    model.damping = rng.uniform(0.0, 0.1, model.nv)
    model.armature = rng.uniform(0.0, 0.01, model.nv)
    springs = [sp.Spring(f"s{k}", joint=f"j{k}", stiffness=5.0) for k in range(3, n, 4)]
    springs.append(sp.Spring("line", ("j1", f"j{n - 1}"), stiffness=20.0, free_length=1.0))
    return sp.Mechanism.from_model(model, springs=springs, name=f"chain {n}")


def moving(mechanism: sp.Mechanism) -> sp.State:
    rng = np.random.default_rng(5)
    q = pin.integrate(mechanism.model, mechanism.neutral, 0.3 * rng.normal(size=mechanism.model.nv))
    return sp.State(mechanism, q, rng.normal(size=mechanism.model.nv))


@pytest.mark.parametrize("formulation", ["independent", "projected"])
@pytest.mark.parametrize("n", [4, 12, 40])
def test_the_accelerations_of_a_simulation_are_those_of_forward_dynamics(n, formulation):
    mechanism = chain(n)
    state = moving(mechanism)
    motion = sp.simulate(mechanism, state, 1e-3, times=[0.0, 1e-3],
                         accuracy=sp.Accuracy(formulation=formulation))
    wanted = sp.forward_dynamics(mechanism, state).a
    assert np.abs(motion.a[0] - wanted).max() < 1e-9 * np.abs(wanted).max()


def test_energy_of_a_long_chain_is_conserved():
    mechanism = chain(40)
    motion = sp.simulate(mechanism, moving(mechanism), 0.05, times=np.linspace(0.0, 0.05, 6))
    assert motion.energy_drift < 1e-7
