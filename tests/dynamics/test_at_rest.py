"""Bodies that stand still stay there, with any integrator, for any duration: every loop ends."""

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from ladders import Z_DOWN, hanging
from masses import heavy
from variety import few

import spatial_pin as sp

ROD = (1.3, (0.5, 0.0, 0.0), (0.0, 0.1, 0.1))
SETTINGS = {
    **{name: {"integrator": name} for name in ("DOP853", "RK45", "Radau", "BDF", "LSODA")},
    **{name: {"integrator": name, "step": 0.01} for name in ("RK4", "Gauss")},
    "projected": {"formulation": "projected"},
}




@pytest.mark.parametrize("seed", few(range(12), 0, 1, 2))
def test_a_pendulum_hanging_still_stays_so(tmp_path, seed):
    for k, angle in enumerate(np.random.default_rng(seed).normal(size=3) * [0.03, 0.1, 1.0]):
        mech, guess = hanging(tmp_path, angle, seed + 100 * k)
        state = sp.assemble(mech, guess=guess)
        motion = sp.simulate(mech, state, 1.0)
        assert np.abs(motion.q - state.q).max() < 1e-13


@pytest.mark.parametrize("setting", SETTINGS)
def test_it_stays_so_with_any_integrator(tmp_path, setting):
    for angle in (0.02, 0.11, -0.4):
        mech, guess = hanging(tmp_path, angle)
        state = sp.assemble(mech, guess=guess)
        motion = sp.simulate(mech, state, 1.0, accuracy=sp.Accuracy(**SETTINGS[setting]))
        assert np.abs(motion.q - state.q).max() < 1e-12


# ---------------------------------------------------------------- other bodies that stand still


def standing(folder):
    """The same pendulum upright: round-off may tip it, but not in a second."""
    mech, guess = hanging(folder, 0.1)
    return mech, {"pin": guess["pin"] + np.pi}


def double(folder):
    tree = heavy(known.turning("shoulder", "ground", "upper")
                 + known.turning("elbow", "upper", "lower", (1, 0, 0)), upper=ROD, lower=ROD)
    return (known.load(folder, "double", tree, "gravity = [0.0, -9.81, 0.0]\n"),
            {"shoulder": -0.5 * np.pi})


def ball(folder):
    tree = heavy(known.floating("ball", "ground", "bob", rpy=(0.3, -0.2, 0.9)),
                 bob=(2.0, (0.0, 0.0, -0.7), (0.1, 0.12, 0.05)))
    turned = pin.log3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.9).T)
    return (known.load(folder, "ball", tree, Z_DOWN + known.refine("ball", "spherical")),
            {"ball": turned})


def on_a_spring(folder):
    tree = heavy(known.sliding("slide", "ground", "block"), block=ROD)
    spring = '[[springs]]\nname = "s"\njoint = "slide"\nstiffness = 130.0\nfree_length = 0.3\n'
    return (known.load(folder, "on_a_spring", tree, Z_DOWN + spring),
            {"slide": 0.3 - 1.3 * 9.81 / 130.0})


def parallelogram(folder):
    """Three rods that hang: a loop at rest."""
    tree = (known.turning("left", "ground", "a") + known.turning("knee", "a", "b", (1, 0, 0))
            + known.turning("right", "ground", "c", (0.8, 0, 0))
            + known.point("b_end", "b", (0.8, 0, 0))
            + known.point("c_end", "c", (1, 0, 0)))
    toml = "gravity = [0.0, -9.81, 0.0]\n" + known.closure("pin", "revolute", "b_end", "c_end")
    down = -0.5 * np.pi
    return (known.load(folder, "parallelogram", heavy(tree, a=ROD, b=(1.0, (0.4, 0, 0)), c=ROD),
                       toml), {"left": down, "knee": -down, "right": down})


STILL = {f.__name__: f for f in (standing, double, ball, on_a_spring, parallelogram)}


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("name", STILL)
def test_what_stands_still_stays_where_it_is(tmp_path, name, setting):
    mech, guess = STILL[name](tmp_path)
    state = sp.assemble(mech, guess=guess)
    motion = sp.simulate(mech, state, 0.7, times=[0.0, 0.3, 0.7],
                         accuracy=sp.Accuracy(**SETTINGS[setting]))
    assert max(np.abs(pin.difference(mech.model, state.q, q)).max() for q in motion.q) < 1e-11


@pytest.mark.parametrize("name", ["double", "parallelogram"])
def test_a_driver_that_stands_still_by_law_holds_all(tmp_path, name):
    mech, guess = STILL[name](tmp_path)
    held = "shoulder" if name == "double" else "left"
    state = sp.assemble(mech, guess=guess)
    value = state.coordinate(held)[0]
    motion = sp.simulate(mech, state, 1.0, drives={held: lambda t: (value, 0.0, 0.0)})
    assert max(np.abs(pin.difference(mech.model, state.q, q)).max() for q in motion.q) < 1e-11


# ---------------------------------------------------------------- every loop ends


def test_a_simulation_without_end_says_where_it_has_come_to(tmp_path):
    """A pendulum that swings for an age; what was reached is kept."""
    mech, _ = double(tmp_path)
    state = sp.assemble(mech, guess={"shoulder": 0.3})
    for formulation in ("independent", "projected"):
        with pytest.raises(sp.StepLimitError, match=r"70 steps have .*most_steps=700") as told:
            sp.simulate(mech, state, 1e12, times=np.linspace(0.0, 1e12, 11), accuracy=sp.Accuracy(
                most_steps=70, formulation=formulation, time_tolerance=1e-8))
        assert told.value.motion.steps == 70
        assert told.value.motion.time.tolist() == [0.0]


def test_fixed_steps_are_as_many_as_were_requested(tmp_path):
    mech, guess = hanging(tmp_path, 0.1)
    motion = sp.simulate(mech, sp.assemble(mech, guess=guess), 1.0, accuracy=sp.Accuracy(
        integrator="RK4", step=0.01, most_steps=3))
    assert motion.steps == 100


@pytest.mark.parametrize("most", [0, -3, 1.5, "many"])
def test_a_number_of_steps_that_is_none_is_refused(most):
    with pytest.raises((ValueError, TypeError), match="most_steps"):
        sp.Accuracy(most_steps=most)


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("duration", few([1e-100, 1e-20, 1e-9], 1e-20))
def test_a_duration_of_no_time_is_over_at_once(tmp_path, duration, setting):
    """Some integrators of others never get to the end of it."""
    mech, _ = hanging(tmp_path, 0.1)
    state = sp.assemble(mech, guess={"pin": 1.1})
    motion = sp.simulate(mech, state, duration, times=[0.0, duration],
                         accuracy=sp.Accuracy(**SETTINGS[setting]))
    assert motion.time.tolist() == [0.0, duration]
    assert np.abs(motion.q - state.q).max() < 1e-15


def test_bodies_at_rest_are_so_after_an_age(tmp_path):
    """Where nothing at all moves steps grow without end."""
    mech, guess = ball(tmp_path)
    state = sp.assemble(mech, guess=guess)
    assert sp.simulate(mech, state, 1e9, times=[1e9]).steps < 1000


@pytest.mark.parametrize("start", [1e12, 1e15, -3e16])
def test_a_driver_far_beyond_all_turns_ends_somewhere(start):
    """A step lost in the round-off of the driver's value is none."""
    mech = sp.load("four_bar")
    try:
        state = sp.assemble(mech, {"crank": start})
        motion = sp.sweep(mech, "crank", start + np.linspace(0.0, 7.0, 5), guess=state)
    except sp.SpatialPinError:
        return
    assert motion.closure_error.max() < 1e-9


@pytest.mark.parametrize("setting", few(SETTINGS, "DOP853", "projected"))
def test_a_freedom_without_inertia_stays_where_it_is(tmp_path, setting):
    """What its table would tell of its inertia is round-off of the heavy rod's, which is held."""
    tree = heavy(known.turning("pin", "ground", "rod") + known.point("tip", "rod", (1, 0, 0))
                 + known.point("hold", "ground", (1, 0, 0))
                 + known.turning("flap_pin", "rod", "flap", (0.3, 0, 0), (0.6, 0.0, 0.8)), rod=ROD)
    mech = known.load(tmp_path, "held", tree, "gravity = [0.0, -9.81, 0.0]\n" + known.closure(
        "weld", "revolute", "hold", "tip"))
    state = sp.assemble(mech, guess={"flap_pin": 0.7})
    motion = sp.simulate(mech, state, 0.4, times=np.linspace(0.0, 0.4, 9),
                         accuracy=sp.Accuracy(**SETTINGS[setting]))
    assert np.abs(motion.q - state.q).max() < 1e-12
