"""Loose simulations make all samples that were asked for, or say why not."""

import numpy as np
import pytest
from loaded_library import thrown
from variety import few, first

import spatial_pin as sp

TIMES = np.linspace(0.0, 1.0, 201)


@pytest.mark.parametrize(("name", "seed", "integrator"), first(3, [
    ("delta", 0, "RK45"), ("rssr", 1, "RK45"), ("swash_plate", 0, "DOP853"), ("delta", 1, "RK45"),
    ("stewart", 1, "RK45"), ("stewart", 2, "DOP853"),
]))
def test_what_a_loose_closure_leaves_open_does_not_end_a_simulation(name, seed, integrator):
    """A step is not refused, nor its samples, for what the one before has left open."""
    mechanism, state = thrown(name, seed)
    loose = sp.Accuracy(integrator=integrator, tolerance=1e-3, time_tolerance=1e-3)
    motion = sp.simulate(mechanism, state, 1.0, times=TIMES, accuracy=loose)
    exact = sp.simulate(mechanism, state, 1.0, times=TIMES[:51])
    assert len(motion.time) == len(TIMES)
    assert motion.closure_error.max() <= 1e-3
    assert np.abs(motion.q[:51] - exact.q).max() < 0.05


@pytest.mark.parametrize("name", ["rssr", "delta"])
@pytest.mark.parametrize("steps", [{"integrator": "RK4", "step": 0.002}, {"time_tolerance": 1e-6}])
def test_the_projected_formulation_takes_loose_closures_too(name, steps):
    """Whether two places are one is told to 1e-6: projected places are closed better than that."""
    mechanism = sp.load(name)
    state = sp.assemble(mechanism)
    exact, loose = (
        sp.simulate(mechanism, state, 0.3, accuracy=sp.Accuracy(
            formulation="projected", tolerance=tolerance, **steps))
        for tolerance in (1e-13, 1e-3))
    assert loose.closure_error.max() < 1e-8
    assert loose.energy_drift < 2.0 * exact.energy_drift + 1e-6
    assert np.abs(loose.q - exact.q).max() < 1e-5


def test_no_sample_lies_beyond_where_a_simulation_is_to_stop():
    """Also where the function is beyond zero for a part of a step only: the rocker turns back."""
    mechanism = sp.load("four_bar")
    state = sp.assemble(mechanism, {"crank": 1.0})
    times = np.linspace(0.0, 0.5, 1001)
    swing = sp.simulate(mechanism, state, 0.5, times=times).coordinate("rocker_pin").value
    level = swing[:700].max() - 1e-4
    motion = sp.simulate(
        mechanism, state, 0.5, times=times,
        stop_when=lambda t, state: state.coordinate("rocker_pin").value - level)
    assert motion.events[-1].kind == "stopped"
    assert motion.coordinate("rocker_pin").value[-1] == pytest.approx(level, abs=1e-10)
    assert motion.coordinate("rocker_pin").value.max() < level + 1e-10


@pytest.mark.parametrize("seed", few(range(1, 4), 1))
def test_interpolated_samples_count_how_far_they_are_not_how_open_their_loops_are(seed):
    """Of Peaucellier's linkage loops hardly open where joints are off: its accelerations told."""
    mechanism = sp.load("peaucellier")
    speed = np.random.default_rng(seed).uniform(-6.0, 6.0)
    state = sp.solve_rates(
        mechanism, sp.assemble(mechanism), dict.fromkeys(mechanism.drivers, speed))
    times = np.linspace(0.0, 1.0, 1001)
    loose, exact = (
        sp.simulate(mechanism, state, 1.0, times=times,
                    accuracy=sp.Accuracy(tolerance=tolerance, time_tolerance=1e-9))
        for tolerance in (1e-4, 1e-12))
    off = np.abs(loose.a - exact.a) / mechanism.velocity_scale
    assert off.max() < 5e-3 * (np.abs(exact.a) / mechanism.velocity_scale).max()
