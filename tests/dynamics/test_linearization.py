"""Small motions: closed forms, differences of the forward dynamics, SciPy's transfer functions."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
from at_rest import (
    at as place,
    chain,
    governor,
    hung,
    model_of,
    plate,
    point_mass,
    sleeved_governor,
    sprung_four_bar,
    swing,
    truss,
    turning_arms,
    with_springs,
)
from loaded_library import library
from scipy import signal
from scipy.linalg import expm
from variety import each

import spatial_pin as sp

SPRUNG = ["four_bar", "rssr", "delta", "screw_press", "geared_five_bar", "slider_crank", "bennett",
          "sarrus", "rspc", "stewart", "watt_six_bar", "bricard"]
GUESS = {"crank": np.pi / 2, "coupler": -np.pi / 2, "rocker": np.pi / 2}


def rested(mech: sp.Mechanism, guess=None, **loads) -> sp.Linearization:
    return sp.linearize(mech, sp.equilibrium(mech, guess, **loads).state, **loads)


def oscillator(mass=2.0, damping=0.0, stiffness=50.0) -> sp.Mechanism:
    """A mass on a slide with a spring and a damper."""
    model = model_of()
    slide = model.addJoint(0, pin.JointModelPX(), place(0, 0, 0), "slide")
    if mass:
        model.appendBodyToJoint(slide, point_mass(mass), place(0, 0, 0))
    return sp.Mechanism.from_model(model, drivers=["slide"], springs=[
        sp.Spring("spring", joint="slide", stiffness=stiffness, damping=damping)])


# ---------------------------------------------------------------- closed forms


def test_the_eigenvalues_of_the_benchmark():
    found = rested(sprung_four_bar(), GUESS)
    root = -0.2423858093105051 + 2.13395502834838j
    np.testing.assert_allclose(found.eigenvalues, [root.conjugate(), root], rtol=0, atol=1e-11)
    assert found.frequencies[0] == pytest.approx(abs(root) / (2 * np.pi), rel=1e-12)
    assert found.damping_ratios[0] == pytest.approx(-root.real / abs(root), rel=1e-12)


def test_a_governor_swings_at_its_speed():
    found = rested(governor(), {"arm": -0.7}, speeds={"shaft": 8.0})
    np.testing.assert_allclose(2 * np.pi * found.frequencies, [7.389312779912], rtol=0, atol=1e-11)
    assert found.coordinates == ("arm",) and found.inputs == ()


def test_a_plate_on_two_cords_twists_and_swings():
    found = 2 * np.pi * rested(plate()).frequencies
    swing = np.sqrt(9.81 / 0.8)
    np.testing.assert_allclose(found, [swing, swing, 5.252677888468], rtol=0, atol=1e-11)


def test_a_chain_of_masses():
    guess = {f"x{k}": 0.5 * (-1) ** k for k in range(1, 9)}
    found, i = rested(chain(), guess), np.arange(1, 9)
    wanted = np.sqrt(1e5 / 10.0) / np.pi * np.sin(i * np.pi / 18.0)
    np.testing.assert_allclose(found.frequencies, wanted, rtol=0, atol=1e-11)
    assert not found.damping_ratios.any() and found.stable


@pytest.mark.parametrize("ratio", [0.0, 1e-9, 0.3, 1.0, 2.5])
def test_an_oscillator_with_a_damper(ratio):
    omega = np.sqrt(50.0 / 2.0)
    found = rested(oscillator(damping=2.0 * ratio * 2.0 * omega))
    assert found.frequencies[0] == pytest.approx(omega / (2 * np.pi), rel=1e-7)
    assert found.damping_ratios[0] == pytest.approx(ratio, rel=1e-6)
    assert found.damping[0, 0] == pytest.approx(4.0 * ratio * omega, rel=1e-12)


@pytest.mark.parametrize("damping", [0.0, 3.0])
def test_a_free_motion_has_no_frequency(damping):
    model = model_of()
    hinge = model.addJoint(0, pin.JointModelRZ(), place(0, 0, 0), "turn")
    slide = model.addJoint(hinge, pin.JointModelPZ(), place(0, 0, 0), "slide")
    model.appendBodyToJoint(slide, pin.Inertia(2.0, np.zeros(3), 0.1 * np.eye(3)),
                            place(0, 0, 0))
    mech = sp.Mechanism.from_model(model, springs=[
        sp.Spring("spring", joint="slide", stiffness=50.0),
        sp.Spring("oil", joint="turn", stiffness=0.0, damping=damping)])
    found = rested(mech)
    np.testing.assert_allclose(found.frequencies, [0.0, 5.0 / (2 * np.pi)], rtol=1e-12)
    assert np.isnan(found.damping_ratios[0]) and not found.stable
    assert np.count_nonzero(found.eigenvalues == 0.0) == (1 if damping else 2)


@pytest.mark.parametrize("name", ["crane", "elliptic_trammel", "rotating_rod_link"])
def test_a_neutral_freedom_has_no_frequency(name):
    mech = library(name)
    found = rested(mech)
    assert found.frequencies[0] == 0.0 and np.count_nonzero(found.eigenvalues == 0.0) == 2
    assert "no vibration" in str(found)


def test_rods_that_spin_idly_swing_as_those_that_cannot():
    idle, tied = rested(swing()), rested(swing(by_balls=False))
    assert len(sp.equilibrium(swing()).passive) == 3 and len(idle.frequencies) == 3
    np.testing.assert_allclose(idle.frequencies, tied.frequencies, rtol=1e-9)
    moved = [sp.compliance(mech, sp.equilibrium(mech).state, "platform")
             for mech in (swing(), swing(by_balls=False))]
    np.testing.assert_allclose(*moved, rtol=0, atol=1e-9 * np.abs(moved[0]).max())


def test_an_unstable_pose_has_a_growing_eigenvalue():
    mech = truss()
    state = sp.equilibrium(mech, {"y": 0.0}, stable=None).state
    found = sp.linearize(mech, state)
    growth = np.sqrt(2000.0 * (np.hypot(0.3, 0.1) / 0.3 - 1.0))
    np.testing.assert_allclose(np.sort(found.eigenvalues.real), [-growth, growth], rtol=1e-9)
    assert not found.stable and found.frequencies[0] == 0.0 and np.isnan(found.damping_ratios[0])


# ---------------------------------------------------------------- differences


def difference(f, h=1e-4):
    """Differences of fourth order."""
    return (8.0 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12.0 * h)


def accelerations(mech, state, names):
    """Return the accelerations of coordinates, as a function of their changes and rates."""
    chosen = [mech.coordinate(name) for name in names]
    taken = {c.name for c in chosen}
    free = [name for name in mech.drivers if mech.driven_coordinate(name).name not in taken]

    def found(change, rates):
        values = {c.name: state.q[c.q] + x for c, x in zip(chosen, change, strict=True)}
        moved = sp.assemble(mech, values, guess=state, release=False, free=free)
        if np.any(rates):
            moved = sp.solve_rates(mech, moved, dict(zip(names, rates, strict=True)))
        return sp.forward_dynamics(mech, moved).a[[c.v for c in chosen]]

    return found


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow)
                                       for k in range(2, 17))])
@pytest.mark.parametrize("name", each(SPRUNG))
def test_matrices_are_differences_of_the_forward_dynamics(name, seed):
    mech = with_springs(name, seed)
    found = rested(mech)
    n, a = len(found.coordinates), accelerations(mech, found.state, found.coordinates)
    unit, none = np.eye(n), np.zeros(n)
    by_q = np.transpose([difference(lambda h, k=k: a(h * unit[k], none)) for k in range(n)])
    by_v = np.transpose([difference(lambda h, k=k: a(none, h * unit[k])) for k in range(n)])
    for matrix, wanted in ((found.stiffness, by_q), (found.damping, by_v)):
        got = -np.linalg.solve(found.mass, matrix)
        assert np.abs(got - wanted).max() < 1e-8 * np.abs(wanted).max()
    efforts = np.transpose([sp.forward_dynamics(mech, found.state, {name: 1.0}).a
                            for name in found.coordinates])
    entries = [mech.coordinate(name).v for name in found.coordinates]
    np.testing.assert_allclose(np.linalg.inv(found.mass), efforts[entries], rtol=1e-7,
                               atol=1e-7 * np.abs(efforts).max())


@pytest.mark.parametrize(("name", "frame"), [("delta", "platform"), ("stewart", "platform"),
                                             ("four_bar", "coupler"), ("rssr", "rocker"),
                                             ("bennett", "coupler")])
def test_compliance_is_how_far_a_force_moves_a_frame(name, frame):
    mech = with_springs(name)
    state = sp.equilibrium(mech).state
    found = sp.compliance(mech, state, frame)
    assert np.abs(found - found.T).max() < 1e-12 * np.abs(found).max()
    assert np.linalg.eigvalsh(found).min() > -1e-12 * np.abs(found).max()

    def twist(column, size):
        push = {frame: pin.Force(size * np.eye(6)[column])}
        moved = sp.equilibrium(mech, state, external=push).state.placement(frame)
        here = state.placement(frame)
        return np.append(moved.translation - here.translation,
                         pin.log3(moved.rotation @ here.rotation.T))

    for column in (0, 2, 4):
        wanted = difference(lambda size, k=column: twist(k, size), 1e-3)
        np.testing.assert_allclose(found[:, column], wanted, rtol=0,
                                   atol=1e-7 * np.abs(found).max())


def test_compliance_of_a_beam_on_springs():
    """A slide gives way by 1/k along itself alone."""
    found = sp.compliance(oscillator(), sp.equilibrium(oscillator()).state, "slide")
    wanted = np.zeros((6, 6))
    wanted[0, 0] = 1 / 50.0
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-15)


def test_a_hanging_body_gives_way_in_all_directions():
    found = sp.compliance(hung(), sp.equilibrium(hung()).state, "base")
    assert np.linalg.eigvalsh(found).min() > 0.0


def test_what_is_held_does_not_give_way():
    mech = library("four_bar")
    held = sp.equilibrium(mech, {"crank": 1.0}, hold="crank").state
    assert not sp.compliance(mech, held, "coupler", hold="crank").any()


@pytest.mark.parametrize("speed", [0.0, 3.0, 8.0])
def test_matrices_beside_a_shaft_that_turns_are_differences_of_the_inverse_dynamics(speed):
    mech, turning = turning_arms(), {"shaft": speed}
    found = rested(mech, speeds=turning)
    data, q, v = mech.model.createData(), found.state.q, np.array([speed, 0.0, 0.0])
    assert found.coordinates == ("arm", "bob")

    def forces(q, v):
        borne = pin.rnea(mech.model, data, q, v, np.zeros(3))[1:]
        return borne + np.array([1.0, 2.0]) * q[1:] + np.array([0.3, 0.1]) * v[1:]

    unit = np.eye(3)[1:]
    by_q = np.transpose([difference(lambda h, d=d: forces(q + h * d, v)) for d in unit])
    by_v = np.transpose([difference(lambda h, d=d: forces(q, v + h * d)) for d in unit])
    assert np.abs(forces(q, v)).max() < 1e-12
    np.testing.assert_allclose(found.stiffness, by_q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.damping, by_v, rtol=0, atol=1e-9)


def test_a_loop_on_a_shaft_swings_as_the_linearization_says():
    mech, turning = sleeved_governor(), {"shaft": 12.0}
    pose = sp.equilibrium(mech, speeds=turning)
    found = sp.linearize(mech, pose.state, speeds=turning)
    assert pose.stable and found.stable and found.coordinates == ("upper",)
    rest, period = pose.state.coordinate("upper").value, 1.0 / found.frequencies[0]
    start = sp.assemble(mech, {"upper": rest + 1e-3}, pose.state, release=False)
    start = sp.solve_rates(mech, start, {"shaft": 12.0, "upper": 0.0})
    run = sp.simulate(mech, start, period, drives={"shaft": sp.laws.constant_speed(0.0, 12.0)})
    wanted = expm(found.state_space()[0] * period) @ [1e-3, 0.0]
    assert run.coordinate("upper").value[-1] - rest == pytest.approx(wanted[0], abs=2e-6)
    assert run.coordinate("upper").rate[-1] == pytest.approx(wanted[1], abs=2e-5)


# ---------------------------------------------------------------- transfer functions


def test_the_frequency_response_is_that_of_scipy():
    mech = with_springs("delta")
    state = sp.equilibrium(mech).state
    found = sp.linearize(mech, state, outputs=["arm_1", "arm_2.rate", "platform.position.z"])
    system, omega = found.state_space(), np.array([0.0, 0.5, 3.0, 7.0, 40.0])
    assert found.inputs == ("arm_1", "arm_2", "arm_3")
    assert found.outputs == ("arm_1", "arm_2.rate", "platform.position.z")
    response = found.frequency_response(omega)
    assert response.shape == (5, 3, 3)
    for k in range(3):
        numerator, denominator = signal.ss2tf(*system, input=k)
        for j, row in enumerate(numerator):
            _, wanted = signal.freqs(row, denominator, omega)
            np.testing.assert_allclose(response[:, j, k], wanted, rtol=1e-8,
                                       atol=1e-8 * np.abs(response).max())
    poles = (sorted(x, key=lambda z: z.imag)  # real parts can be equal to round-off
             for x in (np.linalg.eigvals(system[0]), found.eigenvalues))
    np.testing.assert_allclose(*poles, rtol=1e-9, atol=1e-9)


def test_the_response_at_rest_is_the_compliance():
    mech = with_springs("delta")
    state = sp.equilibrium(mech).state
    found = sp.linearize(mech, state, coordinates=["arm_1", "arm_2", "arm_3"])
    np.testing.assert_allclose(found.frequency_response(0.0)[0], np.linalg.inv(found.stiffness),
                               rtol=1e-10, atol=1e-14)


def test_outputs_of_frames_and_rates():
    mech = library("four_bar")
    state = sp.equilibrium(mech).state
    names = ["rocker_pin", "rocker_pin.rate", "coupler_b.position.x"]
    _, _, c, _ = sp.linearize(mech, state, outputs=names).state_space()
    slope = sp.jacobian(mech, state, "coupler_b")[0, 0]
    ratio = sp.transmission(mech, state, "rocker_pin").ratio
    np.testing.assert_allclose(c, [[ratio, 0.0], [0.0, ratio], [slope, 0.0]], rtol=1e-12)


# ---------------------------------------------------------------- shapes


@pytest.mark.parametrize("name", ["delta", "four_bar", "crane", "hung", "plate"])
def test_a_shape_plays_one_period(name):
    mech = {"hung": hung, "plate": plate}.get(name, lambda: library(name))()
    found = rested(mech)
    for k in np.flatnonzero(found.frequencies):
        motion = found.shape(int(k))
        assert motion.time[-1] == pytest.approx(1.0 / found.frequencies[k])
        assert motion.closure_error.max() < 1e-12
        apart = pin.difference(mech.model, motion.q[0], motion.q[-1]) / mech.velocity_scale
        assert np.abs(apart).max() < 1e-6


def test_shapes_of_equal_frequencies_differ():
    found = rested(library("delta"))
    assert found.frequencies[1] == pytest.approx(found.frequencies[0], rel=1e-6)
    moved = [np.array([np.ptp(found.shape(k).coordinate(x).value) for x in found.coordinates])
             for k in range(2)]
    assert np.abs(moved[0] - moved[1]).max() > 0.01


def test_a_shape_has_the_amplitude_that_is_given():
    found = rested(library("four_bar"))
    value = found.shape(0, amplitude=0.02).coordinate("crank").value
    assert np.ptp(value) == pytest.approx(0.04, rel=1e-2)
    for k in (-1, 1):
        with pytest.raises(ValueError, match=rf"no vibration {k}.*\[0\]"):
            found.shape(k)


def test_a_simulation_swings_as_the_linearization_says():
    mech = library("four_bar")
    found = rested(mech)
    rest = found.state.coordinate("crank").value
    start = sp.assemble(mech, {"crank": rest + 1e-3}, found.state, release=False)
    period = 1.0 / found.frequencies[0]
    run = sp.simulate(mech, start, period)
    assert run.coordinate("crank").value[-1] - rest == pytest.approx(1e-3, rel=1e-3)


def test_words_and_pickles():
    found = rested(library("four_bar"))
    again = pickle.loads(pickle.dumps(found))
    assert repr(found).startswith("Linearization(crank: ") and "Hz" in repr(found)
    assert "damping ratio" in str(found) and str(again) == str(found)
    assert len(again.shape(0)) == len(found.shape(0))


# ---------------------------------------------------------------- refused


def test_a_pose_that_is_not_at_rest_is_refused():
    mech = library("four_bar")
    state = sp.assemble(mech, {"crank": 1.0})
    wanted = np.abs(sp.forward_dynamics(mech, state).a).max()
    for verb, more in ((sp.linearize, ()), (sp.compliance, ("coupler",))):
        with pytest.raises(sp.SpatialPinError, match=r"not at rest.*would be accelerated") as told:
            verb(mech, state, *more)
        assert f"{wanted:.6g} rad/s²" in str(told.value) and "equilibrium" in str(told.value)


def test_a_state_that_moves_is_refused():
    mech = library("four_bar")
    state = sp.solve_rates(mech, sp.equilibrium(mech).state, {"crank": 1.0})
    with pytest.raises(sp.SpatialPinError, match="the state moves"):
        sp.linearize(mech, state)


def test_a_state_of_another_mechanism_is_refused():
    state = sp.equilibrium(library("rssr")).state
    for verb, more in ((sp.linearize, ()), (sp.compliance, ("coupler",))):
        with pytest.raises(sp.SpatialPinError, match="the state belongs to mechanism 'rssr'"):
            verb(library("four_bar"), state, *more)


def test_springs_are_those_of_the_mechanism_that_is_given():
    soft, stiff = oscillator(stiffness=50.0), oscillator(stiffness=200.0)
    state = sp.equilibrium(soft).state
    assert sp.linearize(stiff, state).stiffness[0, 0] == pytest.approx(200.0)
    assert sp.compliance(stiff, state, "slide")[0, 0] == pytest.approx(1 / 200.0)
    assert sp.equilibrium(stiff, state).stiffness[0, 0] == pytest.approx(200.0)


def test_where_all_is_held_nothing_vibrates():
    mech = library("four_bar")
    found = sp.linearize(mech, sp.equilibrium(mech, {"crank": 1.0}, hold="crank").state,
                         hold="crank")
    assert found.frequencies.shape == (0,) and found.eigenvalues.shape == (0,)
    assert [x.shape for x in found.state_space()] == [(0, 0), (0, 0), (0, 0), (0, 0)]
    assert repr(found) == "Linearization()" and found.stable


@pytest.mark.parametrize("omega", [np.nan, [1.0, np.inf], "a"])
def test_frequencies_are_finite_numbers(omega):
    with pytest.raises(ValueError, match="omega"):
        rested(library("four_bar")).frequency_response(omega)


def test_a_motion_without_inertia_is_refused():
    mech = oscillator(mass=0.0)
    with pytest.raises(sp.SingularError, match="slide has no inertia"):
        sp.linearize(mech, sp.equilibrium(mech).state)


def test_a_frame_that_nothing_drives_back_is_refused():
    mech = library("crane")
    state = sp.equilibrium(mech).state
    with pytest.raises(sp.SpatialPinError, match="nothing drives 'tip' back where slew"):
        sp.compliance(mech, state, "tip")
    assert sp.compliance(mech, state, "tip", hold=["slew"]).any()


@pytest.mark.parametrize("given", [{"outputs": ["crnk"]}, {"inputs": ["crnk"]},
                                   {"outputs": ["crnk.rate"]}, {"coordinates": ["crnk"]},
                                   {"outputs": ["cuopler.position.x"]}])
def test_names_that_do_not_exist_are_refused(given):
    mech = library("four_bar")
    with pytest.raises(sp.UnknownNameError, match=r"crnk|cuopler"):
        sp.linearize(mech, sp.equilibrium(mech).state, **given)


def test_a_number_of_coordinates_that_is_wrong_is_refused():
    mech = library("four_bar")
    with pytest.raises(sp.SpatialPinError, match="2 are given, but 1"):
        sp.linearize(mech, sp.equilibrium(mech).state, coordinates=["crank", "rocker_pin"])
