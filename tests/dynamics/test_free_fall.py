"""Mechanisms that nothing holds move alike wherever they are, and however fast they fly."""

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from falling import BASE, GRAVITY, ORIGIN, four_bar, rod
from masses import heavy
from variety import first

import spatial_pin as sp


def pair_of_bodies(folder, toml=""):
    """Two floating bodies that a ball and a rod of fixed length join."""
    tree = heavy(known.floating("base", "ground", "left", **ORIGIN)
                 + known.floating("other", "ground", "right", (0.1, 0, 0), (0, 0.3, 0))
                 + known.point("eye", "left", (0.5, 0, 0))
                 + known.point("ball", "right", (0, 0.4, 0))
                 + known.point("far", "left", (0, 0.5, 0.2))
                 + known.point("tip", "right", (0, -0.4, 0))
                 + known.point("nail", "ground", (0.1, 0.2, 0.3)),
                 left=(2.0, (0.1, 0.1, 0), (0.1, 0.2, 0.25)), right=rod(1.0, 0.8))
    mech = known.load(folder, "pair", tree, (
        f"gravity = {GRAVITY.tolist()}\n" + toml + BASE + known.refine("other", "floating")
        + known.closure("ball", "spherical", "eye", "ball")
        + known.closure("rod", "distance", "far", "tip", length=0.7)))
    return mech, {}


def thrown(mech, guess, away, speed):
    """A state far away that moves on at a speed while its parts move as near the origin."""
    near = sp.assemble(mech, guess={**guess, "base": [0, 0, 0, 0.1, 0.2, 0.3]})
    model = mech.model
    rng = np.random.default_rng(1)
    free = np.linalg.svd(sp.closure_jacobian(mech, near.q))[2]
    free = free[np.linalg.matrix_rank(sp.closure_jacobian(mech, near.q), 1e-9):]
    q, v = near.q.copy(), free.T @ rng.normal(size=len(free))
    for i in [i for i, parent in enumerate(model.parents) if i and not parent]:
        k, j, base = model.idx_qs[i], model.idx_vs[i], model.jointPlacements[i].rotation
        turned = base @ pin.Quaternion(q[k + 3 : k + 7]).toRotationMatrix()
        q[k : k + 3] += base.T @ away
        v[j : j + 3] += turned.T @ speed
    return sp.State(mech, q, v, closure_error=near.closure_error, angles=near.angles)


def inner(motion):
    """Distances of all frames from the first one: what does not depend on where it all is."""
    rows = []
    for k in range(len(motion)):
        data = motion.mechanism.model.createData()
        pin.framesForwardKinematics(motion.mechanism.model, data, motion.q[k])
        base = data.oMi[1].rotation.T
        rows.append([base @ (placement.translation - data.oMi[1].translation)
                     for placement in list(data.oMi)[1:]])
    return np.array(rows)


MECHANISMS = {f.__name__: f for f in (four_bar, pair_of_bodies)}
TIMES = np.linspace(0.0, 0.8, 9)


@pytest.mark.parametrize("formulation", ["independent", "projected"])
@pytest.mark.parametrize("name", MECHANISMS)
@pytest.mark.parametrize("away, speed", first(2, [
    (1e3, 0.0), (-1e6, 3e4), (0.0, 1e3), (1e6, -1e3)]))
def test_far_away_and_fast_it_moves_as_near_the_origin(tmp_path, name, formulation, away, speed):
    """As many steps; digits are lost by the numbers that say where it is, to no more than them."""
    mech, guess = MECHANISMS[name](tmp_path)
    way, accuracy = np.array([0.6, 0.0, 0.8]), sp.Accuracy(formulation=formulation)
    near, far = (sp.simulate(mech, thrown(mech, guess, x * way, u * way), 0.8, times=TIMES,
                             accuracy=accuracy) for x, u in ((0.0, 0.0), (away, speed)))
    assert abs(far.steps - near.steps) <= 2
    lost = 1e-15 * (abs(away) + abs(speed))
    assert np.abs(inner(far) - inner(near)).max() < 1e-9 + 20.0 * lost
    moved = np.array([sp.State(mech, b, closure_error=0).placement("base").translation
                      - sp.State(mech, a, closure_error=0).placement("base").translation
                      for a, b in zip(near.q, far.q, strict=True)])
    flown = (away + speed * TIMES)[:, None] * way
    assert np.abs(moved - flown).max() < 1e-9 + 20.0 * lost
    assert far.energy_drift < 1e-9


@pytest.mark.parametrize("name", MECHANISMS)
def test_velocities_and_accelerations_are_those_of_the_configurations(tmp_path, name):
    mech, guess = MECHANISMS[name](tmp_path)
    state = thrown(mech, guess, np.array([3.0, 4.0, 5.0]), np.array([7.0, -20.0, 1.0]))
    h = 1e-4
    motion = sp.simulate(mech, state, 0.4, times=[0.2 - h, 0.2, 0.2 + h])
    rate = pin.difference(mech.model, motion.q[0], motion.q[2]) / (2 * h)
    np.testing.assert_allclose(motion.v[1], rate, atol=1e-5)
    np.testing.assert_allclose(motion.a[1], (motion.v[2] - motion.v[0]) / (2 * h), atol=1e-5)


@pytest.mark.parametrize("name", MECHANISMS)
def test_the_centre_of_mass_falls_and_the_energy_stays(tmp_path, name):
    mech, guess = MECHANISMS[name](tmp_path)
    state = thrown(mech, guess, np.array([3.0, 4.0, 5.0]), np.array([7.0, -20.0, 1.0]))
    motion = sp.simulate(mech, state, 14.0, times=[0.0, 5.0, 14.0])  # it falls a kilometre
    data = mech.model.createData()
    centres = [pin.centerOfMass(mech.model, data, q).copy() for q in motion.q]
    pin.centerOfMass(mech.model, data, state.q, state.v)
    start, speed = data.com[0], data.vcom[0]
    for t, centre in zip(motion.time, centres, strict=True):
        np.testing.assert_allclose(centre, start + speed * t + 0.5 * GRAVITY * t * t, atol=1e-8)
    energy = [pin.computeKineticEnergy(mech.model, data, q, v)
              + pin.computePotentialEnergy(mech.model, data, q)
              for q, v in zip(motion.q, motion.v, strict=True)]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    np.testing.assert_allclose(motion.energy, energy, rtol=1e-9)
    assert motion.mechanism is mech


def test_what_looks_at_it_sees_it_in_the_world(tmp_path):
    mech, guess = four_bar(tmp_path)
    state = thrown(mech, guess, np.array([0.0, 0.0, 500.0]), np.zeros(3))
    motion = sp.simulate(mech, state, 30.0, times=[30.0],
                         stop_when=lambda t, s: s.com("frame")[0][2])
    assert motion.time[-1] == pytest.approx(np.sqrt(2 * 500.0 / 9.0), rel=1e-2)
    assert abs(motion.state(-1).com("frame")[0][2]) < 1e-8


@pytest.mark.parametrize("toml, efforts", [
    ('[[springs]]\nname = "s"\nstiffness = 40.0\ndamping = 1.0\nfree_length = 0.1\n'
     'frames = ["end", "frame"]\n', None), ("", {"a": 0.7})])
def test_forces_inside_do_their_work_wherever_it_is(tmp_path, toml, efforts):
    mech, guess = four_bar(tmp_path, toml)
    state = thrown(mech, guess, np.zeros(3), np.array([2.0, 0.0, 1.0]))
    inside = sp.simulate(mech, state, 0.8, efforts, TIMES)
    outside = sp.simulate(mech, state, 0.8, lambda t, s: efforts or {}, TIMES)  # a function: held
    assert max(np.abs(pin.difference(mech.model, *pair)).max()
               for pair in zip(inside.q, outside.q, strict=True)) < 1e-8
    np.testing.assert_allclose(inside.work, outside.work, atol=1e-8)
    np.testing.assert_allclose(inside.energy, outside.energy, rtol=1e-9)
    assert max(inside.energy_drift, outside.energy_drift) < 1e-9


@pytest.mark.parametrize("formulation", ["independent", "projected"])
@pytest.mark.parametrize("speed", [0.0, 1.0, 1e4])
def test_a_body_that_only_falls_has_no_drift(tmp_path, formulation, speed):
    """Seen from its centre of mass nothing moves: what is left of energy there is round-off."""
    tree = heavy(known.floating("base", "ground", "body", **ORIGIN),
                 body=(2.0, (0.45, 0.1, 0), (0.1, 0.2, 0.25)))
    mech = known.load(tmp_path, "body", tree, f"gravity = {GRAVITY.tolist()}\n" + BASE)
    turned = pin.rpy.rpyToMatrix(*ORIGIN["rpy"])
    v = np.concatenate([turned.T @ (speed * np.array([0.6, 0.0, 0.8])), np.zeros(3)])
    state = sp.State(mech, sp.assemble(mech).q, v, closure_error=0.0)
    motion = sp.simulate(mech, state, 3.0, times=[1.0, 3.0],
                         accuracy=sp.Accuracy(formulation=formulation))
    assert motion.energy_drift < 1e-12
    fallen = speed * 3.0 * np.array([0.6, 0.0, 0.8]) + 4.5 * GRAVITY
    np.testing.assert_allclose(turned @ (motion.q[-1, :3] - state.q[:3]), fallen, rtol=1e-12,
                               atol=1e-12)
