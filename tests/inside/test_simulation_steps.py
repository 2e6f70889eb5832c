"""The steps of a simulation: which coordinates carry it, samples between them, what is retried."""

from dataclasses import replace

import mechanisms as known
import numpy as np
import pytest
from falling import four_bar
from loaded_library import thrown
from turning_back import arm_on_a_slider, rod_end_on_a_line
from variety import few

import spatial_pin as sp
from spatial_pin import settings
from spatial_pin.dynamics.simulation import problem
from spatial_pin.dynamics.simulation.formulations import (
    FORMULATIONS as INNER,
    IndependentFormulation,
    independent,
)
from spatial_pin.dynamics.simulation.integrators import DifferenceJacobian
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.simulate import is_in_free_fall
from spatial_pin.kernel.loop_equations import loops_of


def test_a_new_integrator_is_one_entry():
    """SciPy's Bogacki-Shampine method, which the library does not have; both formulations."""
    mech = sp.load("four_bar")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 5.0})
    exact = sp.simulate(mech, state, 0.2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(settings.INTEGRATORS, "RK23", settings.Integrator("scipy.integrate:RK23", 2))
        for formulation in settings.FORMULATIONS:
            accuracy = sp.Accuracy(
                integrator="RK23", formulation=formulation, time_tolerance=1e-7)
            motion = sp.simulate(mech, state, 0.2, accuracy=accuracy)
            assert motion.integrators == ["RK23"]
            assert 1e-13 < np.abs(motion.q - exact.q).max() < 1e-5


def test_settings_know_the_names_of_what_there_is():
    assert set(settings.FORMULATIONS) == set(INNER)
    with pytest.raises(ValueError, match="no formulation 'Foo'; there are independent, projected"):
        replace(sp.Accuracy(), formulation="Foo")
    with pytest.raises(ValueError, match="no integrator None; there are DOP853"):
        sp.Accuracy(integrator=None)


LOOSE = sp.Accuracy(tolerance=1e-10, time_tolerance=1e-8)
ONE_FREEDOM = ["bennett", "bricard", "four_bar", "geared_five_bar", "peaucellier", "rspc",
               "scotch_yoke", "watt_six_bar"]
# What samples may miss of those worked out in full: ten times what was found, the largest over the
# mechanisms above. Accelerations are those of the integrator's polynomials.
Q, V, A = 1e-9, 2e-7, 2e-5


def moving(name):
    mech = sp.load(name)
    (driver,) = mech.drivers
    return mech, sp.solve_rates(mech, sp.assemble(mech), {driver: 1.0})


def in_full(monkeypatch, *args, **keys):
    """The same simulation, every sample worked out by itself from points as closed."""
    with monkeypatch.context() as patch:
        patch.setattr(problem, "BETWEEN_ANCHORS", np.inf)
        keys["accuracy"] = sp.Accuracy(
            tolerance=1e-12, time_tolerance=keys["accuracy"].time_tolerance)
        return sp.simulate(*args, **keys)


def test_the_integrator_tells_accelerations_of_several_freedoms(monkeypatch):
    mech = sp.load("stewart")
    state = sp.solve_rates(mech, sp.assemble(mech),
                           {name: 0.02 * k - 0.05 for k, name in enumerate(mech.drivers)})
    found = sp.simulate(mech, state, 0.15, accuracy=LOOSE)
    exact = in_full(monkeypatch, mech, state, 0.15, accuracy=LOOSE)
    assert np.array_equal(found.v, exact.v) or largest(found.v, exact.v) < V
    assert 0.0 < largest(found.a, exact.a) < A


def largest(found, exact):
    return np.abs(found - exact).max() / max(np.abs(exact).max(), 1e-300)


@pytest.mark.parametrize("name", few(ONE_FREEDOM, "bennett", "four_bar", "rspc"))
def test_samples_between_are_those_worked_out_in_full(name, monkeypatch):
    mech, state = moving(name)
    found = sp.simulate(mech, state, 1.5, accuracy=LOOSE)
    exact = in_full(monkeypatch, mech, state, 1.5, accuracy=LOOSE)
    assert found.closure_error.max() <= LOOSE.tolerance
    assert np.abs(found.q - exact.q).max() < Q
    assert largest(found.v, exact.v) < V
    assert largest(found.a, exact.a) < A
    assert [e.row for e in found.events] == [e.row for e in exact.events]


def test_a_sample_between_says_how_open_its_loops_are():
    mech, state = moving("bennett")
    motion = sp.simulate(mech, state, 1.5, accuracy=sp.Accuracy(tolerance=1e-6))
    assert 1e-9 < motion.closure_error.max() <= 1e-6
    for k in (17, 500, 983):
        with loops_of(mech, motion.angles[k]) as evaluation:
            evaluation.update(motion.q[k])
            assert abs(evaluation.closure_error - motion.closure_error[k]) < 1e-14


def test_samples_between_turn_back_with_the_motion(monkeypatch):
    """A crank that swings: within a step it turns back, where samples lie between no anchors."""
    mech = sp.load("slider_crank")
    (driver,) = mech.drivers
    state = sp.assemble(mech, {driver: -1.2})
    found = sp.simulate(mech, state, 6.0, accuracy=LOOSE)
    exact = in_full(monkeypatch, mech, state, 6.0, accuracy=LOOSE)
    assert np.any(np.diff(np.sign(found.coordinate(driver).rate)) != 0.0)
    assert np.abs(found.q - exact.q).max() < Q
    assert largest(found.a, exact.a) < A


SPRING = '[[springs]]\nname = "s"\nstiffness = 10.0\nfree_length = 0.1\n'


def test_what_is_held_or_pulled_is_seen_from_the_world(tmp_path):
    def problem(toml="", efforts=None):
        return Problem(four_bar(tmp_path, toml)[0], efforts, None, None, sp.Accuracy())

    assert is_in_free_fall(problem())
    assert is_in_free_fall(problem(SPRING + 'frames = ["end", "frame"]\n'))
    assert is_in_free_fall(problem(efforts={"a": 2.0}))
    assert not is_in_free_fall(problem(SPRING + 'frames = ["end", "nail"]\n'))
    tie = known.closure("tie", "distance", "nail", "frame", length=1.0)
    assert not is_in_free_fall(problem(tie))
    assert not is_in_free_fall(problem(efforts=lambda t, state: {"a": 1.0}))
    assert not is_in_free_fall(Problem(sp.load("four_bar"), None, None, None, sp.Accuracy()))


TIMES = np.linspace(0.0, 1.0, 201)


@pytest.mark.parametrize("integrator", few(["DOP853", "RK45", "Radau"], "DOP853", "RK45"))
def test_a_step_without_samples_is_taken_again_shorter(monkeypatch, integrator):
    """As where the integrator's polynomial leads off closed loops between good ends."""
    mechanism, state = thrown("delta", 0)
    whole = sp.simulate(mechanism, state, 1.0, times=TIMES, accuracy=sp.Accuracy(
        integrator=integrator))
    from spatial_pin.dynamics.simulation import run
    from spatial_pin.dynamics.simulation.formulations import OpenLoopsError

    original, refused = run.Record.add_step, []

    def refuse_first(self, step, longest, before):
        if len(refused) < 3:
            refused.append(step.last - step.first)
            raise OpenLoopsError
        return original(self, step, longest, before)

    monkeypatch.setattr(run.Run, "_kernel_steps", lambda self: None)
    monkeypatch.setattr(run.Record, "add_step", refuse_first)
    again = sp.simulate(mechanism, state, 1.0, times=TIMES, accuracy=sp.Accuracy(
        integrator=integrator))
    assert len(again.time) == len(TIMES)
    assert refused[1] <= 0.5 * refused[0] * (1.0 + 1e-12)
    assert refused[2] <= 0.5 * refused[1] * (1.0 + 1e-12)
    assert np.abs(again.q - whole.q).max() < 1e-5


def test_differences_stay_finite_where_the_function_ends():
    """On one side of its end the other is taken, beyond it what was known last."""
    def f(t, y):
        return np.array([3.0 * y[0] + y[1], y[1] ** 2]) if y[1] <= 2.0 else np.full(2, np.nan)

    jacobian = DifferenceJacobian(f, np.ones(2))
    exact = [[3.0, 1.0], [0.0, 4.0]]
    np.testing.assert_allclose(jacobian(0.0, np.array([5.0, 2.0])), exact, atol=1e-5)
    np.testing.assert_allclose(jacobian(0.0, np.array([5.0, 2.1])), exact, atol=1e-5)


def test_nothing_that_was_given_up_is_tried_again(tmp_path):
    """From joint to joint, the fastest first; where there is no other, the best of all."""
    state = arm_on_a_slider(tmp_path, 21)
    problem, given_up, found = Problem(state.mechanism, None, None, None, sp.Accuracy()), set(), []
    for _ in range(3):
        system = independent(problem, state, given_up)
        found.append(tuple(system.free))
        given_up.add((IndependentFormulation, found[-1]))
    assert len(set(found)) == 2
    assert found[2] in found[:2]


@pytest.mark.parametrize("gap", [1e-2, 1e-4, 1e-7])
def test_a_motion_goes_to_the_limit_itself(tmp_path, gap):
    """Here the rod leans back."""
    state = rod_end_on_a_line(tmp_path, 0.0)
    assert state.placement("end").translation[0] < state.placement("rod").translation[0]
    system = independent(Problem(state.mechanism, None, None, None, sp.Accuracy()), state)
    angle = np.arcsin((0.9 - 0.8) / 0.5) + gap
    lean = np.pi - np.arcsin((0.9 - 0.5 * np.sin(angle)) / 0.8)
    rate = -0.5 * np.cos(angle) / (0.8 * np.cos(lean))  # how fast it turns, for the crank
    y = np.concatenate([[angle - state.coordinate("pin").value, 1.0],
                        state.q[state.mechanism.coordinate("ball.x").q :][:0]])
    y = np.concatenate([y, system.unknowns(state.v, 0.0)[2:]])
    sample = system.samples(np.zeros(1), y[None])
    assert sample.q[0, state.mechanism.coordinate("pin").q] == pytest.approx(angle, abs=1e-15)
    inertia = (0.02 + 0.25**2 + 0.5**2 + (0.06 + 0.4**2) * rate**2
               + 2.0 * 0.5 * 0.4 * np.cos(lean - angle) * rate)
    assert 2.0 * sample.numbers[0, 1] == pytest.approx(inertia, rel=1e-13 / gap)
