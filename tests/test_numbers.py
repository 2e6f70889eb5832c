"""Numbers at the ends of what is accepted: they work, or are refused in words."""

import numpy as np
import pytest
from masses import heavy
from mechanisms import closure, driver, floating, load, point, refine, sliding, turning
from test_at_rest import hanging

import spatial_pin as sp

FORMULATIONS = ["independent", "projected"]
SPRING = '[[springs]]\nname = "s"\nstiffness = {}\nfree_length = {}\n'


def drift(mechanism, state, formulation, duration=1.0, efforts=None):
    motion = sp.simulate(mechanism, state, duration, efforts, times=[0.3 * duration, duration],
                         accuracy=sp.Accuracy(formulation=formulation))
    assert np.isfinite(motion.energy).all()
    return motion.energy_drift


# ---------------------------------------------------------------- energy drift of what stands still


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("seed", range(4))
def test_a_hanging_pendulum_has_no_drift(tmp_path, seed, formulation):
    mech, guess = hanging(tmp_path, 0.4 * seed - 0.7, seed)
    assert drift(mech, sp.assemble(mech, guess=guess), formulation) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(("size", "mass", "gravity"), [
    (1e-9, 1e-20, 9.81), (1e-3, 1e-6, 1.6), (1e6, 1e15, 9.81), (1.0, 1.0, 1e-9), (1e3, 1e-9, 1e6)])
def test_units_make_no_difference(tmp_path, formulation, size, mass, gravity):
    tree = heavy(turning("pin", "ground", "rod", (0.0, size, 0.0), (0.3, 0.9, 0.1)),
                 rod=(mass, (0.3 * size, 0.0, -0.7 * size), [0.1 * mass * size**2] * 3))
    toml = f"gravity = [0.0, 0.0, {-gravity}]\n"
    axis = np.array([0.3, 0.9, 0.1]) / np.linalg.norm([0.3, 0.9, 0.1])
    mech = load(tmp_path, "rod", tree, toml)
    # at rest the lever, seen along the axis, points down
    com, down = np.array([0.3, 0.0, -0.7]), np.array([0.0, 0.0, -1.0])
    lever, low = com - (com @ axis) * axis, down - (down @ axis) * axis
    angle = np.arctan2(np.cross(lever, low) @ axis, lever @ low)
    time = np.sqrt(size / gravity)
    state = sp.assemble(mech, guess={"pin": float(angle)})
    assert drift(mech, state, formulation, 3.0 * time) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("stiffness", [1e-6, 40.0, 1e9])
@pytest.mark.parametrize("free", [0.1, 0.37, 1e3])
def test_a_spring_at_rest_has_no_drift(tmp_path, stiffness, free, formulation):
    """Without gravity, between points whose distance is free to round-off only."""
    tree = heavy(turning("pin", "ground", "arm", axis=(0, 0.6, 0.8))
                 + sliding("slide", "arm", "bead", (0.1, 0.2, 0.3), (0.6, 0.8, 0)),
                 arm=(1.0, (0.1, 0, 0), (0.1, 0.1, 0.1)), bead=(2.0, (0, 0, 0), (0.1, 0.1, 0.1)))
    mech = load(tmp_path, "bead", tree + point("hook", "arm", (0.1, 0.2, 0.3)),
                "gravity = [0.0, 0.0, 0.0]\n" + SPRING.format(stiffness, free)
                + 'frames = ["hook", "bead"]\n')
    state = sp.assemble(mech, guess={"slide": free * (1.0 + 3e-16)})
    assert drift(mech, state, formulation, 3.0 / np.sqrt(stiffness)) < 1e-5


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_spring_that_carries_a_weight_has_no_drift(tmp_path, formulation):
    tree = heavy(sliding("slide", "ground", "bead"), bead=(2.0, (0, 0, 0.1), (0.1, 0.1, 0.1)))
    mech = load(tmp_path, "scales", tree, "gravity = [0.0, 0.0, -9.81]\n"
                + SPRING.format(100.0, 1.0) + 'joint = "slide"\n')
    state = sp.assemble(mech, guess={"slide": 1.0 - 2.0 * 9.81 / 100.0})
    assert drift(mech, state, formulation) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("gravity", [0.0, 9.81])
def test_a_loop_at_rest_has_no_drift(tmp_path, formulation, gravity):
    """Its centre of mass as low as it gets, or anywhere where nothing pulls."""
    tree = heavy(turning("a", "ground", "left", axis=(0, 1, 0))
                 + turning("b", "left", "beam", (0, 0, -1.0), axis=(0, 1, 0))
                 + turning("c", "ground", "right", (1.0, 0, 0), axis=(0, 1, 0)),
                 left=(1.0, (0, 0, -0.5), (0.1, 0.1, 0.1)),
                 beam=(2.0, (0.5, 0, 0), (0.1, 0.1, 0.1)),
                 right=(1.0, (0, 0, -0.5), (0.1, 0.1, 0.1)))
    tree += point("end", "beam", (1.0, 0, 0)) + point("tip", "right", (0, 0, -1.0))
    mech = load(tmp_path, "swing", tree, f"gravity = [0.0, 0.0, {-gravity}]\n"
                + closure("pin", "spherical", "end", "tip"))
    assert drift(mech, sp.assemble(mech), formulation) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_efforts_that_balance_have_no_drift(tmp_path, formulation):
    """Nothing weighs, nothing is stretched: round-off of the efforts is all that works."""
    tree = heavy(turning("a", "ground", "arm", axis=(0, 0.6, 0.8)),
                 arm=(1.0, (0.5, 0, 0), (0.1, 0.1, 0.1)))
    mech = load(tmp_path, "arm", tree, "gravity = [0.0, 0.0, 0.0]\n" + driver("motor", "a")
                + SPRING.format(10.0, 0.0).replace("free_length", "free_angle") + 'joint = "a"\n')
    state = sp.assemble(mech, guess={"a": 0.3})
    assert drift(mech, state, formulation, efforts={"motor": 3.0}) < 1e-12
    assert drift(mech, sp.assemble(mech, guess={"a": 0.0}), formulation) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(("gravity", "height"), [(0.0, 0.0), (0.0, 1e7), (9.81, 0.0), (9.81, 1e7)])
@pytest.mark.parametrize("duration", [1e-12, 1e-6, 1.0])
def test_a_floating_body_has_no_drift(tmp_path, gravity, height, duration, formulation):
    tree = heavy(floating("base", "ground", "body", (0.0, 0.0, height), (0.3, 0.2, 0.1)),
                 body=(2.0, (0.45, 0.1, 0), (0.1, 0.2, 0.25)))
    mech = load(tmp_path, "body", tree, f"gravity = [0.0, 0.0, {-gravity}]\n"
                + refine("base", "floating"))
    for v in (np.zeros(6), np.array([3.0, -1.0, 2.0, 0.0, 0.0, 0.0]),
              np.array([3.0, -1.0, 2.0, 0.4, -0.1, 0.2])):
        state = sp.State(mech, sp.assemble(mech).q, v, closure_error=0.0)
        assert drift(mech, state, formulation, duration) < 1e-9
