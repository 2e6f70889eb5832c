"""What settings cost and lose: the reference, extended precision, the front, the measured table."""

import closed_forms
import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from masses import simple_pendulum
from published_cases import CASES
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk
from variety import each, few

import spatial_pin as sp
from spatial_pin.accuracy.extended import EPS, Extended
from spatial_pin.accuracy.reference import Astray, ExactRows, SimulationReference, SweepReference
from spatial_pin.accuracy.tasks import SHORTER, SimulationTask, task_of
from spatial_pin.accuracy.tradeoff import pareto, with_reference
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.settings import MEASURED

TURN = np.linspace(0.0, 2 * np.pi, 37)


@pytest.mark.alike
@pytest.mark.parametrize("name", [*each(sp.list_mechanisms()), *known.KNOWN])
def test_rows_of_every_kind_and_their_rates_are_those_of_the_solvers(name, tmp_path):
    """Derivatives of the rows' definitions against Jacobians and biases, anywhere."""
    mech = known.KNOWN[name].build(tmp_path) if name in known.KNOWN else sp.load(name)
    rng, nv, start = np.random.default_rng(1), mech.model.nv, sp.assemble(mech)
    step, v, a = (mech.velocity_scale * rng.normal(size=nv) for _ in range(3))
    q = pin.integrate(mech.model, start.q, 0.1 * step)
    evaluation = LoopEquations(mech)
    evaluation.angle_reference[:] = start.angles
    evaluation.update(q)
    n, jacobian = evaluation.constraints.n_closure, evaluation.jacobian / mech.velocity_scale
    residual, angles = evaluation.residual.copy(), evaluation.angles[None].copy()
    bias = evaluation.bias(q, v)
    extended, rows = Extended(mech), [x[None].astype(np.longdouble) for x in (q, v, a)]
    found, spins = extended.rows(*rows, angles)[:, 0], extended.spins(*rows)[:, 0]
    rates, accelerations = jacobian @ v, jacobian @ a + bias
    for got, want in [(found, [residual, rates[:n], accelerations[:n]]),
                      (spins, [rates[n:], accelerations[n:]])]:
        assert np.abs(got - np.array(want)).max(initial=0.0) < 1e-14


def test_exact_rows_of_the_rssr_are_those_of_the_closed_form():
    """Rocker and crank to 18 digits; the model's own numbers are those of the closed form."""
    mech = sp.load("rssr")
    motion = sp.sweep(mech, "crank", TURN, 3.0, 0.5)
    driven = [mech.driven_coordinate("crank")]
    solver = ExactRows(mech, driven, motion.driver[:, None], np.full(37, 3.0), np.full(37, 0.5))
    exact = solver.near(motion.q, np.zeros((37, 0)))
    rocker = mech.coordinate("rocker_pin")
    poses = [closed_forms.rates(closed_forms.rssr, x, 3.0, 0.5) for x in TURN]
    want = np.array([closed_forms.long(p.coordinates["rocker_pin"] for p in level)
                     for level in zip(*poses, strict=True)])
    got = np.array([exact.q[:, rocker.q], exact.v[:, rocker.v], exact.a[:, rocker.v]])
    assert exact.good.all() and exact.remainder.max() < 30 * EPS
    assert np.abs(got - want).max() < 300 * EPS


def coupler_turned_without_spin(start, values):
    """Rotations of the RSSR's coupler: R' = [w] R with w = b x b' / b . b, b from A to B."""
    def line(phi):
        a, b, c, d = 0.102, 0.381, 0.254, 0.314
        psi = np.arccos((b**2 - a**2 - c**2 - d**2 + 2 * a * d * np.cos(phi))
                        / (2 * c * (d - a * np.cos(phi))))
        return np.array([-d - c * np.cos(psi) + a * np.cos(phi), c * np.sin(psi),
                         -a * np.sin(phi)])

    def rate(phi, r):
        h = 1e-3  # central differences of sixth order, here to 1e-13
        k = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60
        b = line(phi)
        db = sum(w * line(phi + i * h) for i, w in zip(range(-3, 4), k, strict=True)) / h
        return (pin.skew(np.cross(b, db) / (b @ b)) @ r.reshape(3, 3)).ravel()

    found = solve_ivp(rate, (values[0], values[-1]), start.ravel(), method="DOP853", rtol=1e-12,
                      atol=1e-12, t_eval=values).y
    return found.T.reshape(-1, 3, 3)


def test_the_spin_of_the_reference_is_that_of_a_body_without_spin():
    """Against an integration of the coupler's rotation; so is a sweep's of order 3."""
    mech = sp.load("rssr")
    motion = sp.sweep(mech, "crank", TURN)
    reference = SweepReference(task_of(mech, motion))
    want = coupler_turned_without_spin(motion.frame("coupler").rotation[0], TURN)
    q = reference.exact.q.astype(float)
    still = [sp.State(mech, x, closure_error=0.0).placement("coupler").rotation for x in q]
    assert np.abs(np.array(still) - want).max() < reference.spin_error < 1e-8
    coarse = sp.sweep(mech, "crank", TURN, accuracy=sp.Accuracy(order=2, corrections=3))
    gap, coarse_gap = (np.abs(m.frame("coupler").rotation - want).max() for m in (motion, coarse))
    assert gap < 1e-11
    assert 1e-10 < coarse_gap == pytest.approx(reference.judge(coarse).spin, rel=0.5)


def test_what_is_below_round_off_is_equally_exact(monkeypatch):
    monkeypatch.setattr("spatial_pin.accuracy.tradeoff.ROUND_OFF", 1e-13)
    found = sp.tradeoff(sp.load("four_bar"), {"values": TURN[1:]}, settings=[
        sp.Accuracy(order=1, tolerance=1e-15), sp.Accuracy(order=2, tolerance=1e-15)], repeats=2)
    assert len(found.front) == 1


def test_a_motion_on_another_branch_is_not_taken_for_a_large_error():
    mech = sp.load("four_bar")
    reference = SweepReference(task_of(mech, {"driver": "crank", "values": TURN}))
    q = sp.sweep(mech, "crank", TURN, guess={"rocker_pin": -1.5, "coupler_pin": -2.0})
    assert abs(q.coordinate("rocker_pin").value - reference.exact.q[:, 2]).max() > 0.5
    with pytest.raises(Astray, match="left its branch at 0"):
        reference.judge(q)
    with pytest.raises(Astray, match="ended after 36 of 37"):
        reference.judge(sp.sweep(mech, "crank", TURN[:36]))


def pendulum_swing(times):
    """Angle from the downward vertical of a pendulum of 1 m released at -90° [Landau I, 11]."""
    k2, pace = 0.5, np.sqrt(9.81)
    sn = ellipj(ellipk(k2) - pace * times, k2)[0]
    return 2.0 * np.arcsin(np.sqrt(k2) * sn)


def test_errors_reported_for_a_pendulum_are_those_of_elliptic_functions():
    mech = simple_pendulum()
    times = np.linspace(0.0, 3.0, 61)
    task = {"state": sp.assemble(mech, {"pin": np.pi}), "duration": 3.0, "times": times}
    settings = [sp.Accuracy(time_tolerance=x) for x in (1e-4, 1e-6, 1e-8)] + [
        sp.Accuracy(integrator="RK4", step=0.01), sp.Accuracy(integrator="RK45"),
        sp.Accuracy(integrator="Radau", time_tolerance=1e-5)]
    settings[4] = sp.Accuracy(integrator="RK45", time_tolerance=1e-6)
    found = sp.tradeoff(mech, task, settings=settings, repeats=1)
    # hanging is -90° of the pin; it starts at 180°, a quarter turn behind
    truth = -np.pi / 2 - pendulum_swing(times)
    reference = SimulationReference(task_of(mech, task)).exact.q[:, 0].astype(float)
    shift = 2 * np.pi * np.round((reference[0] - truth[0]) / (2 * np.pi))
    assert np.abs(reference - truth - shift).max() < 3 * found.reference_error + 1e-13
    assert found.reference_error < 1e-11
    for row in found.rows:
        motion = sp.simulate(mech, task["state"], 3.0, times=times, accuracy=row.accuracy)
        true = np.abs(motion.coordinate("pin").value - truth - shift).max()
        assert row.errors.position == pytest.approx(true, rel=1e-3, abs=1e-11)
        assert row.energy_drift == motion.energy_drift and row.solver_steps == motion.steps


def test_the_reference_of_a_loop_knows_its_own_error():
    """IFToMM A02, one window: exact by elliptic functions after 10 s, ten change points passed."""
    case = CASES["ladder_1"]
    mech = case.build()
    task = {"state": case.begin(mech), "duration": 10.0, "times": np.linspace(0.0, 10.0, 41)}
    reference = SimulationReference(task_of(mech, task))
    v = reference.exact.v[-1, mech.coordinate("pin_0").v]
    q = reference.exact.q[-1, mech.coordinate("pin_0").q]
    exact = case.answers["angles"].values[0], case.answers["speed"].values[0]
    assert abs(float(-q) - exact[0]) < 3 * reference.error + 1e-13
    assert abs(float(-v) - exact[1]) < 3 * reference.error * reference.sizes[1] + 1e-13
    assert reference.error < 1e-8


def test_the_usual_simulation_ends_before_a_singular_configuration():
    """The delta robot falls into one."""
    task = task_of(sp.load("delta"), "simulate")
    assert 0.2 < task.arguments["duration"] < 0.4
    assert len(task.run(sp.Accuracy.named("draft"))) == 201


def test_the_usual_simulation_is_as_short_as_its_reference_needs():
    """As if a loose integration had passed the singular configuration; what was asked for stays."""
    mech = sp.load("delta")
    usual = task_of(mech, "simulate")
    singular = usual.arguments["duration"] / SHORTER
    beyond = {**usual.arguments, "duration": 2.0 * singular,
              "times": np.linspace(0.0, 2.0 * singular, 21)}
    task, reference = with_reference(SimulationTask(mech, beyond, is_usual=True))
    assert 0.7 * singular < task.arguments["duration"] < singular
    assert reference.error < 1e-9
    with pytest.raises(sp.SingularError, match="cannot be followed beyond"):
        with_reference(SimulationTask(mech, beyond))


POINTS = st.lists(st.tuples(st.floats(0, 9), st.one_of(st.floats(0, 9), st.just(np.nan))),
                  min_size=1)


@given(POINTS)
def test_the_front_is_what_nothing_beats(points):
    flags = pareto(*zip(*points, strict=True))

    def beats(p, q):
        return p[0] <= q[0] and p[1] <= q[1] and p != q

    front = [p for p, flag in zip(points, flags, strict=True) if flag]
    assert not any(beats(p, q) for p in front for q in front)
    for p, flag in zip(points, flags, strict=True):
        if not flag and not np.isnan(p[1]):
            assert any(beats(q, p) for q in front)
        assert not (flag and np.isnan(p[1]))


HELD_OUT = ("RSSP", "RSCR", "RSSR, rod as distance", "press, screw as closure",
            "Hooke's joint as closure", "swash plate", "Bennett", "leaning pointer")


@pytest.mark.parametrize("name", few(HELD_OUT, "RSSR, rod as distance", "Bennett", "RSSP"))
def test_settings_for_an_error_of_a_sweep_keep_it_elsewhere(name, tmp_path):
    entry = known.KNOWN[name]
    mech = entry.build(tmp_path)
    task = task_of(mech, {"driver": entry.driver, "values": entry.values})
    reference = SweepReference(task)
    for error in (1e-2, 1e-3, 1e-5, 1e-7, *(error for error, _ in MEASURED["sweep"])):
        motion = task.run(sp.Accuracy.for_error(error))
        assert reference.judge(motion).total <= motion.error.largest
        assert motion.error.largest <= max(error, 1e-9)


def four_bar_of_other_lengths():
    return sp.load("four_bar", r1=0.35, r2=0.12, r3=0.33, r4=0.27)


@pytest.mark.parametrize("build", [
    simple_pendulum, four_bar_of_other_lengths,
    pytest.param(lambda: sp.load("rssr", a=0.09, c=0.27), marks=pytest.mark.slow)])
def test_settings_for_an_error_of_a_simulation_keep_it_elsewhere(build):
    mech = build()
    task = task_of(mech, "simulate")
    reference = SimulationReference(task)
    for error in (1.0, 1e-3, 1e-5, 2e-8):
        found = reference.judge(task.run(sp.Accuracy.for_error(error, "simulate")))
        assert found.total <= error


@pytest.mark.parametrize("task", ["sweep", "simulate"])
def test_the_table_behind_gets_dearer_as_it_gets_more_exact(task):
    errors = [error for error, _ in MEASURED[task]]
    assert len(errors) >= 2 and errors == sorted(errors, reverse=True)
    with pytest.raises(sp.SpatialPinError, match="Measure your own"):
        sp.Accuracy.for_error(0.5 * errors[-1], task)
    assert sp.Accuracy.for_error(errors[-1], task) == MEASURED[task][-1][1]
    loosest = {"sweep": sp.Accuracy(tolerance=1e-2), "simulate": MEASURED["simulate"][0][1]}[task]
    found = sp.Accuracy.for_error(1e3, task)
    assert (found.time_tolerance, found.integrator) == (loosest.time_tolerance, loosest.integrator)
    assert found.tolerance >= loosest.tolerance  # samples have a part of the error


def test_what_is_as_cheap_and_less_exact_is_no_part_of_the_front():
    assert pareto([1.0, 1.0, 2.0, 2.0], [2.0, 3.0, 2.0, 1.0]) == [True, False, False, True]
    assert pareto([1.0, 1.0], [2.0, 2.0]) == [True, True]
