"""Links that spin freely about a line of symmetry: left out of the motion, and put back."""

from typing import NamedTuple

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from masses import heavy

import spatial_pin as sp

REFERENCE = sp.Accuracy.named("reference")
PROJECTED = sp.Accuracy(formulation="projected", tolerance=1e-15, time_tolerance=1e-13)


class Body(NamedTuple):
    """A link on a ball joint, and the line (3,) in it about which it may spin."""

    joint: int
    axis: np.ndarray


def spinning_body(mech):
    (passive,) = mech.passives
    (joint, first), (_, second) = map(mech.frame_on_joint, passive.axis)
    line = second.translation - first.translation
    return Body(joint, line / np.linalg.norm(line))


def moving(mech, speed, spin):
    """A state with a speed of the driver, the ball-jointed link spinning besides."""
    driver = next(iter(mech.drivers))
    state = sp.solve_rates(mech, sp.assemble(mech, {driver: 0.3}), {driver: speed})
    body, v = spinning_body(mech), state.v.copy()
    first = mech.model.idx_vs[body.joint]
    v[first : first + 3] += spin * body.axis
    return sp.State(mech, state.q, v, closure_error=state.closure_error), body


def axial(motion, body):
    """(N,) angular velocity of the body about its line [rad/s]."""
    model = motion.mechanism.model
    data = model.createData()
    found = []
    for q, v in zip(motion.q, motion.v, strict=True):
        pin.forwardKinematics(model, data, q, v)
        found.append(body.axis @ data.v[body.joint].angular)
    return np.array(found)


@pytest.mark.parametrize("spin", [0.0, 30.0])
@pytest.mark.parametrize("name", ["rssr", "rssr_crossed", "swash_plate"])
def test_the_motion_is_that_of_all_joint_coordinates(name, spin):
    """Which know nothing of spins: configuration, velocity and acceleration, spin included."""
    mech = sp.load(name)
    state, body = moving(mech, 12.0, spin)
    times = np.linspace(0.0, 0.4, 21)
    motion = sp.simulate(mech, state, 0.4, times=times, accuracy=REFERENCE)
    other = sp.simulate(mech, state, 0.4, times=times, accuracy=PROJECTED)
    assert len(motion.coordinates) == 1
    gap = max(np.abs(pin.difference(mech.model, *rows)).max()
              for rows in zip(motion.q, other.q, strict=True))
    assert gap < 2e-10
    np.testing.assert_allclose(motion.v, other.v, atol=1e-10 * np.abs(other.v).max())
    np.testing.assert_allclose(motion.a, other.a, atol=1e-9 * np.abs(other.a).max())
    assert motion.closure_error.max() < 1e-13 and motion.energy_drift < 1e-10
    sigma = axial(motion, body)
    assert np.abs(sigma - sigma[0]).max() < 1e-12 * np.abs(motion.v).max()


def test_efforts_that_look_at_the_state_work_the_same():
    mech = sp.load("rssr")
    state, _ = moving(mech, 5.0, 10.0)
    times = np.linspace(0.0, 0.3, 11)

    def law(t, state):
        return {"crank": 0.3 * np.sin(8.0 * t) - 0.01 * state.coordinate("crank").rate}

    motion, other = (sp.simulate(mech, state, 0.3, law, times, accuracy)
                     for accuracy in (REFERENCE, PROJECTED))
    np.testing.assert_allclose(motion.q, other.q, atol=2e-10)
    np.testing.assert_allclose(motion.work, other.work, atol=1e-10)
    assert motion.energy_drift < 1e-10


def test_a_link_on_a_bushing_does_not_spin_freely():
    mech = sp.load("rssr")
    state, _ = moving(mech, 5.0, 3.0)
    mount = sp.Spring("mount", ("ground", "coupler"), stiffness=(20.0, 20.0, 20.0, 2.0, 2.0, 2.0))
    mech = mech.with_fields(springs=(mount,))
    state, times = sp.State(mech, state.q, state.v), np.linspace(0.0, 0.2, 6)
    motion, other = (sp.simulate(mech, state, 0.2, times=times, accuracy=accuracy)
                     for accuracy in (REFERENCE, PROJECTED))
    assert len(motion.coordinates) > 1
    np.testing.assert_allclose(motion.q, other.q, atol=2e-10)
    assert motion.energy_drift < 1e-10


@pytest.mark.parametrize("change", ["bent", "flat"])
def test_a_link_without_symmetry_is_integrated_with_the_rest(change):
    mech = sp.load("rssr")
    state, body = moving(mech, 8.0, 3.0)
    old = mech.model.inertias[body.joint]
    beside = np.array([0.01, 0.0, 0.0])
    moments = old.inertia * np.array([1.3, 1.0, 1.0]) if change == "flat" else old.inertia
    mech.model.inertias[body.joint] = pin.Inertia(
        old.mass, old.lever + beside * (change == "bent"), moments)
    times = np.linspace(0.0, 0.2, 6)
    motion = sp.simulate(mech, state, 0.2, times=times, accuracy=REFERENCE)
    other = sp.simulate(mech, state, 0.2, times=times, accuracy=PROJECTED)
    assert len(motion.coordinates) > 1
    np.testing.assert_allclose(motion.q, other.q, atol=2e-10)
    sigma = axial(motion, body)
    assert np.abs(sigma - sigma[0]).max() > 1e-3  # it is felt


SPRING = ('[[springs]]\nname = "spring"\nframes = ["wall", "{}"]\nstiffness = 40.0\n'
          "damping = 0.5\nfree_length = 0.1\n")


def parallelogram(folder, toml=""):
    """Two cranks side by side, the rod between them with a ball at either end."""
    tree = heavy(
        known.turning("crank_pin", "ground", "crank")
        + known.floating("ball_a", "crank", "rod", (0.2, 0, 0))
        + known.point("rod_b", "rod", (0.3, 0, 0)) + known.point("middle", "rod", (0.1, 0, 0))
        + known.point("edge", "rod", (0.1, 0.05, 0)) + known.point("wall", "ground", (0.1, 1, 0.2))
        + known.turning("rocker_pin", "ground", "rocker", (0.3, 0, 0))
        + known.point("rocker_b", "rocker", (0.2, 0, 0)),
        crank=(0.3, (0.05, 0, 0), (4e-4,) * 3), rod=(0.7, (0.15, 0, 0), (1e-4, 5e-3, 5e-3)),
        rocker=(0.5, (0.11, 0, 0), (3e-3,) * 3))
    mech = known.load(folder, "parallelogram", tree, "gravity = [0.0, -9.81, 0.0]\n"
                      + known.refine("ball_a", "spherical") + known.driver("crank", "crank_pin")
                      + known.closure("ball_b", "spherical", "rod_b", "rocker_b") + toml)
    state = sp.assemble(mech, {"crank": 0.7}, {"rocker_pin": 0.7, "ball_a": [0, 0, -0.7]})
    return mech, sp.solve_rates(mech, state, {"crank": 20.0})


def test_change_points_are_passed_with_a_link_that_spins(tmp_path):
    """Two freedoms; flat, the parallelogram has three. The rocker goes on with the crank."""
    mech, state = parallelogram(tmp_path)
    v = state.v.copy()
    v[mech.coordinate("ball_a.x").v] += 5.0
    motion = sp.simulate(mech, sp.State(mech, state.q, v, closure_error=state.closure_error), 0.8)
    crank, rocker = (motion.coordinate(n).value for n in ("crank_pin", "rocker_pin"))
    passed = [k * np.pi for k in range(1, int(crank[-1] / np.pi) + 1)]
    assert len(passed) > 3
    assert [e.kind for e in motion.events] == ["branch point"] * len(passed)
    assert [e.value for e in motion.events] == pytest.approx(passed, abs=1e-9)
    assert np.abs(crank - rocker).max() < 1e-10
    assert motion.energy_drift < 1e-9 and motion.closure_error.max() < 1e-12


@pytest.mark.parametrize(("point", "is_free"), [("middle", True), ("edge", False)])
def test_a_spring_beside_the_line_holds_the_spin(point, is_free, tmp_path):
    """Only a spin that nothing holds is left out of what is integrated."""
    mech, state = parallelogram(tmp_path, SPRING.format(point))
    moved = sp.simulate(mech, state, 0.1, times=[0.1], accuracy=REFERENCE)
    assert (len(moved.coordinates) == 1) == is_free
    if is_free:
        times = np.linspace(0.0, 0.1, 6)
        ways = [sp.simulate(mech, state, 0.1, times=times, accuracy=accuracy)
                for accuracy in (REFERENCE, PROJECTED)]
        np.testing.assert_allclose(ways[0].q, ways[1].q, atol=2e-10)
        assert ways[0].energy_drift < 1e-10 and ways[0].work[-1] < 0.0
