"""The kernel's accelerations and integrators against Pinocchio, SciPy and closed forms."""

import re

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from masses import heavy
from scipy import integrate
from variety import each

import spatial_pin as sp
from spatial_pin.dynamics.simulation.events import EventDetector
from spatial_pin.dynamics.simulation.formulations import independent
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.kernel.integrating import RungeKutta
from spatial_pin.mechanism.inertia import KineticEnergy

ONE_LOOP = [n for n in sp.list_mechanisms() if n not in ("swash_plate", "crank_collar")]


def moving(name, seed):
    mech, rng = library(name), np.random.default_rng(seed)
    state = sp.assemble(mech)
    speeds = {d: rng.uniform(0.5, 3.0) * (1.0 if mech.coordinate(d).unit == "rad" else
                                          mech.characteristic_length) for d in mech.drivers}
    return mech, sp.solve_rates(mech, state, speeds)


@pytest.mark.parametrize("name", each(ONE_LOOP))
def test_accelerations_are_those_of_forward_dynamics(name):
    """Which has Pinocchio's mass matrix and forces, and solves for all joints together."""
    mech, state = moving(name, 3)
    efforts = dict.fromkeys(list(mech.drivers)[:1], 0.7)
    system = independent(Problem(mech, efforts, None, None, sp.Accuracy()), state)
    sample = system.samples(np.zeros(1), system.unknowns(state.v, 0.0)[None])
    expected = sp.forward_dynamics(mech, state, efforts).a
    assert np.abs(sample.q[0] - state.q).max() < 1e-12
    assert np.abs(sample.v[0] - state.v).max() < 1e-11 * (1.0 + np.abs(state.v).max())
    assert np.abs(sample.a[0] - expected).max() < 1e-9 * (1.0 + np.abs(expected).max())


@pytest.mark.parametrize("name", each(ONE_LOOP))
def test_energies_are_pinocchios(name):
    mech, state = moving(name, 5)
    problem = Problem(mech, None, None, None, sp.Accuracy())
    system = independent(problem, state)
    found = system.energies(0.0, system.unknowns(state.v, 0.0))
    model, data = mech.model, mech.model.createData()
    kinetic = KineticEnergy(model)(state.q, state.v)
    stored = pin.computePotentialEnergy(model, data, state.q)
    size = abs(kinetic) + abs(stored) + 1e-12
    assert found.kinetic == pytest.approx(kinetic, abs=1e-12 * size)
    springs = found.total - found.kinetic - stored
    assert springs >= -1e-12 * size
    if not mech.springs:
        assert springs == pytest.approx(0.0, abs=1e-12 * size)


def arm(folder):
    """A free body with a ball joint and hinges on it: no loop, joints that turn in space."""
    tree = heavy(known.floating("base", "ground", "body")
                 + known.floating("ball", "body", "ring", (0.2, 0.1, 0.3))
                 + known.turning("elbow", "ring", "lower", (0.4, 0, 0), axis=(0, 0.6, 0.8)),
                 body=(2.0, (0.1, 0, 0.05), (0.1, 0.2, 0.15)),
                 ring=(1.0, (0.2, 0.1, 0), (0.05, 0.06, 0.08)),
                 lower=(0.5, (0.3, 0, 0.1), (0.02, 0.03, 0.025)))
    return known.load(folder, "arm", tree, "gravity = [1.0, -2.0, -9.81]\n"
                      + known.refine("ball", "spherical"))


@pytest.mark.parametrize("seed", range(6))
def test_trees_accelerate_as_by_the_articulated_body_algorithm(tmp_path, seed):
    mech, rng = arm(tmp_path), np.random.default_rng(seed)
    model = mech.model
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
    state = sp.State(mech, q, rng.uniform(-2.0, 2.0, model.nv), closure_error=0.0)
    system = independent(Problem(mech, {"elbow": 0.4}, None, None, sp.Accuracy()), state)
    sample = system.samples(np.zeros(1), system.unknowns(state.v, 0.0)[None])
    tau = np.zeros(model.nv)
    tau[mech.coordinate("elbow").v] = 0.4
    expected = pin.aba(model, model.createData(), state.q, state.v, tau)
    np.testing.assert_allclose(sample.a[0], expected, atol=1e-11 * np.abs(expected).max())


# ---------------------------------------------------------------- integrators


def swing(t, y):
    return np.array([y[1], -np.sin(y[0]) + 0.1 * np.cos(2.0 * t)])


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_adaptive_methods_step_as_scipys(method):
    """The same steps, ends and values between them, up to the order of sums."""
    y0, tolerance = np.array([0.4, 1.1]), 1e-9
    ours = RungeKutta(method, swing, 0.0, y0, 20.0, 0.01, np.inf, tolerance, np.full(2, tolerance))
    theirs = getattr(integrate, method)(swing, 0.0, y0, 20.0, first_step=0.01, rtol=tolerance,
                                        atol=tolerance)
    for _ in range(12):  # what round-off adds up to would choose other steps in the end
        theirs.step()
        ours.step()
        assert ours.t == pytest.approx(theirs.t, rel=1e-5)
        middle = 0.5 * (ours.t + ours.t_old)
        np.testing.assert_allclose(ours.dense_output()(middle), theirs.dense_output()(middle),
                                   atol=1e-8)
    while ours.status == "running":
        ours.step()
    assert ours.status == "finished"
    exact = integrate.solve_ivp(swing, (0.0, 20.0), y0, rtol=1e-13, atol=1e-13, method=method)
    np.testing.assert_allclose(ours.y, exact.y[:, -1], atol=1e-6)


def test_the_fixed_method_is_of_fourth_order():
    exact = integrate.solve_ivp(swing, (0.0, 2.0), [0.4, 1.1], rtol=1e-13, atol=1e-13,
                                method="DOP853").y[:, -1]
    errors = []
    for count in (20, 40):
        solver = RungeKutta("RK4", swing, 0.0, np.array([0.4, 1.1]), 2.0, count, np.inf, 1e-6,
                          np.full(2, 1e-6))
        while solver.status == "running":
            solver.step()
        errors.append(np.abs(solver.y - exact).max())
    assert 12.0 < errors[0] / errors[1] < 20.0


def test_what_a_function_raises_is_raised():
    def breaks(t, y):
        if t > 0.5:
            raise KeyError("late")
        return -y

    solver = RungeKutta("DOP853", breaks, 0.0, np.ones(1), 1.0, 0.1, 0.1, 1e-6, np.full(1, 1e-6))
    with pytest.raises(KeyError, match="late"):
        for _ in range(20):
            solver.step()


def test_samples_do_not_change_the_steps():
    """They are interpolated: where it has been asked for does not matter to where it goes."""
    mech, state = moving("four_bar", 2)
    few = sp.simulate(mech, state, 1.0, times=[0.5, 1.0])
    many = sp.simulate(mech, state, 1.0, times=np.linspace(0.0, 1.0, 333))
    assert few.steps == many.steps
    np.testing.assert_allclose(few.q[-1], many.q[-1], atol=1e-12)


@pytest.mark.parametrize(("limits", "passings"), [
    ('lower="-9" upper="2" velocity="0"', 5), ('lower="-9" upper="9" velocity="5"', 9)])
def test_steps_heed_limits_in_the_kernel(tmp_path, monkeypatch, limits, passings):
    """They are the same steps as without limits, and few are looked at."""
    tree = heavy(known.joint("revolute", "pin", "ground", "arm", axis=(0, 1, 0), limits=(0, 0)),
                 arm=(1.0, (0.5, 0.0, 0.0), (0.0, 0.02, 0.02)))
    tree = re.sub("<limit [^/]*/>", f'<limit effort="0" {limits}/>', tree)
    state = sp.assemble(known.load(tmp_path, "pendulum", tree, "gravity = [0.0, 0.0, -9.81]\n"))
    free = sp.simulate(state.mechanism, state, 8.0, on_joint_limit="ignore")
    looked, look = [], EventDetector.events_in_step
    monkeypatch.setattr(
        EventDetector, "events_in_step", lambda *step: looked.append(step) or look(*step))
    motion = sp.simulate(state.mechanism, state, 8.0)
    np.testing.assert_allclose(motion.q, free.q, atol=1e-12)
    assert motion.steps == free.steps
    assert (len(free.events), len(motion.events)) == (0, passings)
    assert passings <= len(looked) < 0.5 * motion.steps
