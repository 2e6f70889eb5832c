"""What settings cost and lose: the reference and the errors told, against known truths."""

import json

import closed_forms
import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpmath import nstr
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

import spatial_pin as sp
from spatial_pin.accuracy import models
from spatial_pin.accuracy.cases import CASES
from spatial_pin.accuracy.exact import ExactRows
from spatial_pin.accuracy.extended import EPS, Extended
from spatial_pin.accuracy.reference import Astray, SimulationReference, SweepReference
from spatial_pin.accuracy.tasks import SHORTER, SimulationTask, task_of
from spatial_pin.accuracy.tradeoff import pareto, tradeoff, with_reference
from spatial_pin.cli import main
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.settings import MEASURED

TURN = np.linspace(0.0, 2 * np.pi, 37)
FEW = [sp.Accuracy(), sp.Accuracy(tolerance=1e-8), sp.Accuracy(order=2, tolerance=1e-4),
       sp.Accuracy(order=1, corrections=1), sp.Accuracy(order=0, corrections=1)]


def long(values) -> np.ndarray:
    """Numbers of mpmath with all digits that extended precision holds."""
    return np.array([np.longdouble(nstr(x, 25)) for x in values])


# ---------------------------------------------------------------- extended precision


@pytest.mark.parametrize("name", [*sp.list_mechanisms(), *known.KNOWN])
def test_rows_of_every_kind_and_their_rates_are_those_of_the_solvers(name, tmp_path):
    """Derivatives of the rows' definitions against Jacobians and biases, anywhere."""
    mech = known.KNOWN[name].build(tmp_path) if name in known.KNOWN else sp.load(name)
    rng, nv, start = np.random.default_rng(1), mech.model.nv, sp.assemble(mech)
    step, v, a = (mech.velocity_scale * rng.normal(size=nv) for _ in range(3))
    q = pin.integrate(mech.model, start.q, 0.1 * step)
    evaluation = Evaluation(constraints_of(mech))
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
    want = np.array([long(p.coordinates["rocker_pin"] for p in level)
                     for level in zip(*poses, strict=True)])
    got = np.array([exact.q[:, rocker.q], exact.v[:, rocker.v], exact.a[:, rocker.v]])
    assert exact.good.all() and exact.left.max() < 30 * EPS
    assert np.abs(got - want).max() < 300 * EPS


# ---------------------------------------------------------------- sweeps


def rocker_errors(mech, accuracy, values):
    """True errors of the rocker: position, velocity and acceleration."""
    motion = sp.sweep(mech, "crank", values, accuracy=accuracy)
    found = np.array(motion.coordinate("rocker_pin"))
    poses = [closed_forms.rates(closed_forms.rssr, x, 1.0, 0.0) for x in values]
    want = np.array([long(p.coordinates["rocker_pin"] for p in level)
                     for level in zip(*poses, strict=True)])
    return np.abs(found - want).max(axis=1).astype(float)


def test_errors_told_of_the_rssr_are_those_of_the_closed_form():
    mech = sp.load("rssr")
    found = sp.tradeoff(mech, {"driver": "crank", "values": TURN}, settings=FEW, repeats=1)
    assert len(found) == len(FEW) and found.reference_error < 1e-17
    for row in found.rows:
        told = np.array([row.errors.position, row.errors.velocity, row.errors.acceleration])
        true = rocker_errors(mech, row.accuracy, TURN)
        assert np.all(true <= told * (1 + 1e-6) + 1e-15)
        assert np.all(told <= 20 * true + 2e-15)  # the coupler's joint loses more than the rocker
        motion = sp.sweep(mech, "crank", TURN, accuracy=row.accuracy)
        assert row.errors.closure == pytest.approx(motion.closure_error.max(), rel=0.01, abs=1e-15)
        together = row.accuracy.order == 3 and row.accuracy.corrections is None
        if together:
            assert row.errors.spin < 1e-10
        else:  # steps of 10° are long, and those that they are divided into are still seen
            assert row.errors.spin > 1e-8


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
    found = tradeoff(sp.load("four_bar"), {"values": TURN[1:]}, settings=[
        sp.Accuracy(order=1, tolerance=1e-15), sp.Accuracy(order=2, tolerance=1e-15)], repeats=2)
    assert len(found.front) == 1


def test_a_mechanism_without_loops_has_no_error():
    found = tradeoff(sp.load("satellite_dish"), None, settings=FEW[:1], repeats=1)
    assert found.rows[0].error == 0.0
    assert found.cheapest(1e-15).accuracy == FEW[0]


def test_rates_of_any_speed_and_other_drivers_are_judged():
    """Errors of rates grow with the speed, the total does not."""
    mech = sp.load("delta")
    values = np.linspace(-0.2, 0.3, 21)
    slow, fast = (tradeoff(mech, {"driver": "arm_2", "values": values, "speed": speed,
                                  "hold": {"arm_1": 0.1, "arm_3": 0.0}},
                           settings=[sp.Accuracy(tolerance=1e-4)], repeats=1).rows[0]
                  for speed in (1.0, 100.0))
    assert fast.errors.velocity == pytest.approx(100 * slow.errors.velocity, rel=1e-6)
    assert fast.error == pytest.approx(slow.error, rel=1e-6)


def test_what_a_sweep_holds_is_held_while_it_is_measured(tmp_path):
    mechanism = known.five_bar(tmp_path)
    task = {"driver": "left", "values": np.linspace(2.0, 2.2, 11), "speed": 1.0}
    own = sp.sweep(mechanism, **task, hold=["base", "elbow2"])
    assert np.ptp(own.coordinate("elbow2").value) < 1e-12 < np.ptp(own.coordinate("right").value)
    found = sp.tradeoff(mechanism, {**task, "hold": ["base", "elbow2"]}, repeats=1,
                        settings=[sp.Accuracy.named("engineering")])
    assert "right is released" in found.rows[0].said and found.rows[0].error < 1e-12


def test_a_motion_is_a_task_too():
    mech = sp.load("rspc")
    motion = sp.sweep(mech, "crank", TURN, 2.0, acceleration=0.3)
    found = tradeoff(mech, motion, settings=FEW[:2], repeats=1)
    again = tradeoff(mech, {"driver": "crank", "values": TURN, "speed": 2.0, "acceleration": 0.3},
                     settings=FEW[:2], repeats=1)
    errors = [{row.accuracy: row.errors for row in x.rows} for x in (found, again)]
    assert errors[0][FEW[1]] == pytest.approx(errors[1][FEW[1]], rel=1e-3)


def test_a_sweep_that_stops_at_a_limit_is_measured_up_to_there():
    mech = sp.load("rssr")
    found = tradeoff(mech, {"driver": "rocker_pin", "values": np.linspace(1.5, 4.0, 26),
                            "on_limit": "stop"}, settings=FEW[:1], repeats=1)
    assert 5 < found.rows[0].steps < 26


def test_a_motion_on_another_branch_is_not_taken_for_a_large_error():
    mech = sp.load("four_bar")
    reference = SweepReference(task_of(mech, {"driver": "crank", "values": TURN}))
    q = sp.sweep(mech, "crank", TURN, guess={"rocker_pin": -1.5, "coupler_pin": -2.0})
    assert abs(q.coordinate("rocker_pin").value - reference.exact.q[:, 2]).max() > 0.5
    with pytest.raises(Astray, match="left its branch at 0"):
        reference.judge(q)
    with pytest.raises(Astray, match="ended after 36 of 37"):
        reference.judge(sp.sweep(mech, "crank", TURN[:36]))


def test_settings_that_fail_say_why_in_the_table():
    bad = sp.Accuracy(integrator="RK4")
    found = tradeoff(models.simple_pendulum(), {"duration": 0.1, "times": [0.05, 0.1]},
                     settings=[bad, sp.Accuracy()], repeats=2)
    failed = found.rows[-1]
    assert failed.accuracy == bad and failed.errors is None and not failed.on_front
    assert "needs a step" in failed.said and "failed: integrator 'RK4' needs a step" in str(found)
    assert len(failed.seconds) == 1 and np.isnan(failed.error) and failed.spread is None


def test_a_setting_for_which_no_time_is_left_is_said_to_be_untried():
    found = tradeoff(sp.load("four_bar"), {"values": TURN}, settings=FEW, budget=1e-9)
    assert not found.front and {row.said for row in found.rows} == {"not tried, the time was out"}
    assert "not tried" in str(found) and found.as_dict()["rows"][0]["time_per_step"] is None
    assert not found.plot().axes[0].containers
    with pytest.raises(sp.SpatialPinError, match="no setting worked"):
        found.cheapest(1.0)


# ---------------------------------------------------------------- simulations


def pendulum_swing(times):
    """Angle from the downward vertical of a pendulum of 1 m released at -90° [Landau I, 11]."""
    k2, pace = 0.5, np.sqrt(9.81)
    sn = ellipj(ellipk(k2) - pace * times, k2)[0]
    return 2.0 * np.arcsin(np.sqrt(k2) * sn)


def test_errors_told_of_a_pendulum_are_those_of_elliptic_functions():
    mech = models.simple_pendulum()
    times = np.linspace(0.0, 3.0, 61)
    task = {"state": sp.assemble(mech, {"pin": np.pi}), "duration": 3.0, "times": times}
    settings = [sp.Accuracy(time_tolerance=x) for x in (1e-4, 1e-6, 1e-8)] + [
        sp.Accuracy(integrator="RK4", step=0.01), sp.Accuracy(integrator="RK45"),
        sp.Accuracy(integrator="Radau", time_tolerance=1e-5)]
    settings[4] = sp.Accuracy(integrator="RK45", time_tolerance=1e-6)
    found = tradeoff(mech, task, settings=settings, repeats=1)
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


def test_what_the_reference_cannot_tell_is_said():
    mech = models.simple_pendulum()
    task = {"state": sp.assemble(mech, {"pin": 2.0}), "duration": 1.0, "times": [0.5, 1.0]}
    tight = sp.Accuracy.named("reference")
    found = tradeoff(mech, task, settings=[tight, sp.Accuracy(time_tolerance=1e-4)], repeats=1)
    row = next(row for row in found.rows if row.accuracy == tight)
    assert row.error < found.reference_error <= found.known_error(row)
    assert f"< {found.reference_error:.1e}" in str(found)
    with pytest.raises(sp.SpatialPinError, match="as far as the reference tells"):
        found.cheapest(1e-20)


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


# ---------------------------------------------------------------- the front


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


# ---------------------------------------------------------------- settings for an error


HELD_OUT = ("RSSP", "RSCR", "RSSR, rod as distance", "press, screw as closure",
            "Hooke's joint as closure", "swash plate", "Bennett", "leaning pointer")


@pytest.mark.parametrize("name", HELD_OUT)
def test_settings_for_an_error_of_a_sweep_keep_it_elsewhere(name, tmp_path):
    entry = known.KNOWN[name]
    mech = entry.build(tmp_path)
    task = task_of(mech, {"driver": entry.driver, "values": entry.values})
    reference = SweepReference(task)
    for error in (1e-3, *(error for error, _ in MEASURED["sweep"])):
        motion = task.run(sp.Accuracy.for_error(error))
        assert reference.judge(motion).total <= error


def four_bar_of_other_lengths():
    return sp.load("four_bar", r1=0.35, r2=0.12, r3=0.33, r4=0.27)


@pytest.mark.parametrize("build", [
    models.simple_pendulum, four_bar_of_other_lengths,
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
    assert sp.Accuracy.for_error(1e3, task) == MEASURED[task][0][1]


def test_settings_measured_on_the_mechanism_itself_go_first():
    mech = sp.load("rspc")
    found = sp.tradeoff(mech, {"values": TURN}, settings=FEW, repeats=3)
    for error in (1e-2, 1e-6, 1e-11):
        pick = sp.Accuracy.for_error(error, measured=found)
        good = [row for row in found.rows if found.known_error(row) <= error]
        assert pick == min(good, key=lambda row: row.time_per_step).accuracy
    with pytest.raises(sp.SpatialPinError, match=r"no setting that was measured .* the best"):
        sp.Accuracy.for_error(1e-30, measured=found)


@pytest.mark.parametrize(("words", "message"), [
    ((0.0,), "must be positive"), ((float("nan"),), "must be positive"),
    ((1e-6, "dance"), "no task 'dance'"),
])
def test_errors_that_mean_nothing_are_refused(words, message):
    with pytest.raises(ValueError, match=message):
        sp.Accuracy.for_error(*words)


# ---------------------------------------------------------------- tasks


@pytest.mark.parametrize(("task", "kind", "message"), [
    ("dance", ValueError, "'sweep' and 'simulate'"),
    (3, TypeError, "a task is a mapping"),
    ({"values": TURN, "accuracy": sp.Accuracy()}, ValueError, "tries settings itself"),
    ({"values": TURN, "sped": 1.0}, LookupError, "did you mean 'speed'"),
    ({"duration": 1.0, "effort": {}}, LookupError, "did you mean 'efforts'"),
    ({"speed": 1.0}, ValueError, "needs values"),
    ({"values": TURN, "driver": "krank"}, LookupError, "did you mean 'crank'"),
    ({"values": [4.0, 9.0], "driver": "rocker_pin"}, sp.AssemblyError, "cannot be closed"),
])
def test_what_is_no_task_is_refused(task, kind, message):
    with pytest.raises(kind, match=message):
        tradeoff(sp.load("rssr"), task)


def test_nothing_that_moves_is_refused(tmp_path):
    with pytest.raises(sp.SpatialPinError, match="stands still under gravity"):
        tradeoff(sp.load("swash_plate"), "simulate")
    with pytest.raises(sp.SpatialPinError, match="has no masses"):
        tradeoff(known.bennett(tmp_path), "simulate")
    with pytest.raises(ValueError, match="does not know all that acted"):
        mech = models.simple_pendulum()
        tradeoff(mech, sp.simulate(mech, sp.assemble(mech), 0.1))
    with pytest.raises(ValueError, match="no settings"):
        tradeoff(sp.load("rssr"), settings=[])
    with pytest.raises(ValueError, match="whole number"):
        tradeoff(sp.load("rssr"), repeats=0)


# ---------------------------------------------------------------- what is written


@pytest.fixture(scope="module")
def small():
    mech = sp.load("four_bar")
    return tradeoff(mech, {"driver": "crank", "values": TURN}, settings=FEW, repeats=3)


def test_the_table_marks_the_front_and_names_levels(small):
    lines = str(small).splitlines()
    assert lines[0] == "four_bar: sweep of crank from 0 to 6.28319 rad, 37 values"
    assert sum(line.startswith("* ") for line in lines) == len(small.front) >= 1
    assert "order 3, to 1e-13 (engineering)" in str(small) and "(draft)" in str(small)
    times = [row.time_per_step for row in small.rows]
    assert times == sorted(times)
    assert all(len(row.seconds) == 3 and row.spread >= 0.0 for row in small.rows)
    assert small.rows[0].time_per_step == np.median(small.rows[0].seconds) / 37


def test_the_table_is_written_as_json_and_as_a_figure(small, tmp_path):
    content = json.loads(small.to_json(tmp_path / "t.json").read_text(encoding="utf-8"))
    assert [row["on_front"] for row in content["rows"]] == [r.on_front for r in small.rows]
    assert content["rows"][0]["error"] == small.rows[0].error
    assert content["rows"][0]["accuracy"]["order"] == small.rows[0].accuracy.order
    figure = small.plot(tmp_path / "t.png")
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")
    axes = figure.axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    drawn = np.vstack([np.column_stack(c[0].get_data()) for c in axes.containers])
    want = [(1e6 * row.time_per_step, small.known_error(row)) for row in small.rows]
    assert np.array(sorted(drawn.tolist())) == pytest.approx(np.array(sorted(want)))


def test_the_command_measures_and_picks(capfd, tmp_path):
    words = ["tradeoff", "hooke_joint", "input", "0", "90deg", "--steps", "10", "--repeats", "1",
             "--error", "1e-6", "--json", str(tmp_path / "t.json"),
             "--plot", str(tmp_path / "t.svg")]
    assert main(words) == 0
    out, err = capfd.readouterr()
    assert err == "" and "sweep of input from 0 to 1.5708 rad, 10 values" in out
    assert "cheapest for an error of 1e-06: Accuracy(" in out and f"wrote {tmp_path}" in out
    assert json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))["kind"] == "sweep"
    assert "<svg" in (tmp_path / "t.svg").read_text(encoding="utf-8")


def test_the_command_measures_simulations(capfd):
    words = ["tradeoff", "crane", "--simulate", "200ms", "--rows", "5", "--repeats", "1",
             "--begin", "slew=2rpm", "--effort", "luff=5Nm", "--json", "-"]
    assert main(words) == 0
    content = json.loads(capfd.readouterr().out)
    assert content["kind"] == "simulate" and content["task"] == "simulation of 0.2 s"
    assert {row["steps"] for row in content["rows"] if row["said"] == ""} == {5}


@pytest.mark.parametrize(("words", "code", "message"), [
    (["rsrr"], 1, "did you mean 'rssr'?"),
    (["rssr", "krank", "0", "1"], 1, "did you mean 'crank'?"),
    (["rssr", "crank", "0"], 2, "a sweep needs a driver"),
    (["rssr", "--at", "crank=1"], 2, "need --simulate"),
    (["rssr", "crank", "0", "1", "--simulate", "1"], 2, "no driver to sweep"),
    (["rssr", "--simulate", "--at", "crank=1"], 2, "needs a duration"),
    (["rssr", "--simulate", "5mm"], 1, "duration is in s or ms"),
    (["rssr", "--simulate", "1s", "--effort", "crank=5deg"], 1, "the effort of crank is in Nm"),
    (["swash_plate", "--simulate"], 1, "stands still under gravity"),
    (["rssr", "--error", "-1"], 2, "not a positive number"),
    (["rssr", "--error", "1mm"], 2, "not a positive number"),
    (["rssr", "--repeats", "0"], 2, "whole number"),
])
def test_the_command_says_in_one_paragraph_what_is_wrong(words, code, message, capfd):
    try:
        found = main(["tradeoff", *words])
    except SystemExit as end:
        found = end.code
    err = capfd.readouterr().err
    assert found == code and message in err and "Traceback" not in err
