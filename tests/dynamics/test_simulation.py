"""Simulated motions against exact solutions, and against equations written by hand."""

import pickle
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from masses import heavy, with_masses
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk
from variety import each, few, first

import spatial_pin as sp

G = 9.81
DOWN = "gravity = [0.0, -9.81, 0.0]\n"
WEIGHTLESS = "gravity = [0.0, 0.0, 0.0]\n"
REFERENCE = sp.Accuracy.named("reference")
FORMULATIONS = ("independent", "projected")
INTEGRATORS = ("DOP853", "RK45", "Radau", "BDF", "LSODA", "RK4", "Gauss", "automatic")
STEP = 1e-30  # of derivatives along the imaginary axis


def run(mech, state, duration, *args, drift=1e-9, **keys) -> sp.Simulation:
    """Simulate; the loops must be closed, and no energy come from nowhere, in every row."""
    motion = sp.simulate(mech, state, duration, *args, **keys)
    assert motion.closure_error.max() < 1e-12
    assert motion.energy_drift < drift
    return motion


def by_hand(f, y, times):
    """The solution of y' = f(t, y), (n, N), to 1e-13."""
    return solve_ivp(f, (0.0, times[-1]), y, method="DOP853", rtol=1e-13, atol=1e-13,
                     t_eval=times).y


# ---------------------------------------------------------------- pendulums

ROD = (1.5, (0.4, 0, 0), (0.0, 0.02, 0.02))
ROD_PACE = np.sqrt(1.5 * 0.4 * G / (0.02 + 1.5 * 0.4**2))  # of small swings [rad/s]


def hanging(folder, toml=""):
    """A rod that hangs down at 0, its angle counted about z."""
    tree = heavy(known.turning("pin", "ground", "bob", rpy=(0, 0, -np.pi / 2)), bob=ROD)
    return known.load(folder, "hanging", tree, DOWN + known.driver("pin", "pin") + toml)


def swing(amplitude, times, pace=ROD_PACE):
    """A pendulum released at an amplitude [Landau I, 11]."""
    k = np.sin(0.5 * amplitude)
    sn = ellipj(ellipk(k**2) - pace * times, k**2)[0]
    return 2.0 * np.arcsin(k * sn)


def test_a_pendulum_swings_as_elliptic_functions_say(tmp_path):
    mech = hanging(tmp_path)
    motion = run(mech, sp.assemble(mech, {"pin": 2.5}), 10.0, accuracy=REFERENCE, drift=1e-11)
    assert len(motion) == 1001 and motion.time == pytest.approx(np.linspace(0, 10, 1001))
    assert np.abs(motion.coordinate("pin").value - swing(2.5, motion.time)).max() < 1e-10
    assert motion.coordinates == ["pin"] and not motion.events and not motion.efforts
    assert motion.steps > 100 and motion.evaluations > 10 * motion.steps
    assert np.all(motion.work == 0.0)


def test_it_stops_where_a_function_vanishes(tmp_path):
    """At the bottom after a quarter of the period; the last row is there."""
    mech = hanging(tmp_path)
    motion = run(mech, sp.assemble(mech, {"pin": 1.2}), 10.0, accuracy=REFERENCE,
                 stop_when=lambda t, state: state.coordinate("pin").value)
    quarter = ellipk(np.sin(0.6) ** 2) / ROD_PACE
    assert [e.kind for e in motion.events] == ["stopped"]
    assert motion.events[0].value == pytest.approx(quarter, abs=1e-10)
    assert motion.time[-1] == motion.events[0].value
    assert motion.events[0].row == len(motion)
    assert abs(motion.coordinate("pin").value[-1]) < 1e-10
    assert np.all(np.diff(motion.time) > 0.0)


def test_rows_are_at_the_requested_times(tmp_path):
    mech = hanging(tmp_path)
    times = [0.3, 0.30001, 1.7]
    motion = run(mech, sp.assemble(mech, {"pin": 1.0}), 2.0, times=times)
    assert motion.time.tolist() == times
    assert motion.coordinate("pin").value == pytest.approx(swing(1.0, np.array(times)), abs=1e-9)


def test_a_row_at_the_start_alone_is_the_state_it_starts_from(tmp_path):
    mech = hanging(tmp_path)
    motion = run(mech, sp.assemble(mech, {"pin": 1.0}), 2.0, times=[0.0])
    assert motion.time.tolist() == [0.0] and motion.coordinate("pin").value == [1.0]


def test_two_rods_swing_as_lagrange_says(tmp_path):
    """Double pendulum of point masses at the ends of massless rods; absolute angles a, b."""
    (m1, m2), (l1, l2) = (1.3, 0.7), (0.5, 0.8)
    tree = heavy(known.turning("first", "ground", "upper", rpy=(0, 0, -np.pi / 2))
                 + known.turning("second", "upper", "lower", (l1, 0, 0)),
                 upper=(m1, (l1, 0, 0)), lower=(m2, (l2, 0, 0)))
    mech = known.load(tmp_path, "double", tree, DOWN)

    def rates(t, y):
        a, b, da, db = y
        s, c = np.sin(a - b), np.cos(a - b)
        mass = [[(m1 + m2) * l1, m2 * l2 * c], [l1 * c, l2]]
        force = [-m2 * l2 * db**2 * s - (m1 + m2) * G * np.sin(a),
                 l1 * da**2 * s - G * np.sin(b)]
        return [da, db, *np.linalg.solve(mass, force)]

    motion = run(mech, sp.assemble(mech, {"first": 2.0, "second": -0.5}), 3.0, accuracy=REFERENCE)
    a, b, _, _ = by_hand(rates, [2.0, 1.5, 0.0, 0.0], motion.time)
    assert np.abs(motion.coordinate("first").value - a).max() < 1e-9
    assert np.abs(motion.coordinate("second").value - (b - a)).max() < 1e-9


# ---------------------------------------------------------------- bodies that turn in space

BODY = (2.0, (0.0, 0.0, 0.3), (0.02, 0.028, 0.012))


def euler(inertia, torque):
    """Euler's equations for y = (quaternion x, y, z, w; omega in body axes)."""
    def rates(t, y):
        turn, w = pin.Quaternion(y[:4] / np.linalg.norm(y[:4])), y[4:]
        x, y_, z, s = y[:4]
        spin = 0.5 * np.array([s * w[0] + y_ * w[2] - z * w[1], s * w[1] + z * w[0] - x * w[2],
                               s * w[2] + x * w[1] - y_ * w[0],
                               -x * w[0] - y_ * w[1] - z * w[2]])
        m = torque(turn.matrix())
        return np.concatenate([spin, np.linalg.solve(inertia, m - np.cross(w, inertia @ w))])
    return rates


@pytest.mark.parametrize(("moments", "spin"), first(1, [
    ((0.02, 0.028, 0.012), (0.5, -1.5, 2.0)),  # a pendulum in space that turns over
    ((0.02, 0.02, 0.01), (0.3, 0.0, 60.0)),  # a fast top: it precesses and nods
]))
def test_a_heavy_body_on_a_ball_turns_as_euler_says(moments, spin, tmp_path):
    mass, com, _ = BODY
    mech = known.load(tmp_path, "top", heavy(
        known.floating("ball", "ground", "top"), top=(mass, com, moments)),
        known.refine("ball", "spherical"))
    q = pin.exp3_quat(np.array([1.1, 0.2, 0.0]))
    state = sp.State(mech, q, np.array(spin), closure_error=0.0)
    motion = run(mech, state, 2.0, times=np.linspace(0, 2, 101), accuracy=REFERENCE)
    c = np.array(com)
    inertia = np.diag(moments) + mass * (c @ c * np.eye(3) - np.outer(c, c))
    want = by_hand(euler(inertia, lambda r: np.cross(c, r.T @ (0, 0, -mass * G))),
                   np.concatenate([q, spin]), motion.time)
    turns = [pin.Quaternion(x / np.linalg.norm(x)).matrix() for x in want[:4].T]
    assert np.abs(motion.frame("top").rotation - turns).max() < 1e-8
    assert np.abs(motion.v - want[4:].T).max() < 1e-8 * np.abs(spin).max()


def test_a_free_body_keeps_its_momentum(tmp_path):
    """It tumbles about its middle axis while it flies straight on."""
    mech = known.load(tmp_path, "free", heavy(
        known.floating("joint", "ground", "body"), body=BODY),
        WEIGHTLESS + known.refine("joint", "floating"))
    v = np.array([0.4, -0.2, 0.1, 3.0, 0.02, 0.01])
    state = sp.State(mech, pin.neutral(mech.model), v, closure_error=0.0)
    motion = run(mech, state, 5.0, times=np.linspace(0, 5, 101), accuracy=REFERENCE, drift=1e-11)
    data = mech.model.createData()
    momenta = np.array([pin.computeCentroidalMomentum(mech.model, data, *row).vector.copy()
                        for row in zip(motion.q, motion.v, strict=True)])
    assert np.abs(momenta - momenta[0]).max() < 1e-11 * np.abs(momenta[0]).max()
    com = motion.com("body").position
    assert np.abs(com - com[0] - motion.time[:, None] * motion.com("body").velocity[0]
                  ).max() < 1e-10


# ---------------------------------------------------------------- loops, by their energy


def arrivals(phi, bodies, potential, energy):
    """Times (N,) at which a mechanism of one freedom reaches the crank angles phi, rising.

    dt = dphi sqrt(m / 2(E - V)), by Gauss quadrature from row to row.

    Args:
        bodies: function of phi, complex, to (mass, moment of inertia, coordinates..., angle) each.
    """
    nodes, weights = np.polynomial.legendre.leggauss(20)
    width = np.diff(phi)[:, None]
    x = phi[:-1, None] + 0.5 * width * (1.0 + nodes)
    inertia = 0.0
    for mass, moment, *place, angle in bodies(x + 1j * STEP):
        slopes = [np.imag(c) / STEP for c in place]
        inertia = inertia + mass * sum(s * s for s in slopes) + moment * (
            np.imag(angle) / STEP) ** 2
    rates = np.sqrt(2.0 * (energy - potential(x)) / inertia)
    return np.concatenate([[0.0], np.cumsum((0.5 * width / rates) @ weights)])


def compare_with_arrivals(motion, coordinate, bodies, height, rate, limit=1e-9):
    phi = motion.coordinate(coordinate).value
    assert np.all(np.diff(phi) > 0.0)
    first = list(bodies(phi[0] + 1j * STEP))
    kinetic = 0.5 * rate**2 * sum(
        m * sum((np.imag(c) / STEP) ** 2 for c in place) + i * (np.imag(a) / STEP) ** 2
        for m, i, *place, a in first)

    def potential(x):
        return sum(m * G * np.real(height(place)) for m, _, *place, _ in bodies(x + 0j))

    t = arrivals(phi, bodies, potential, kinetic + potential(phi[0]))
    assert np.abs(t - motion.time).max() < limit


CRANK, CONROD, SLIDER = (0.8, 0.02, 3e-4), (0.5, 0.06, 2e-3), (0.9, 0.0, 1e-3)


@pytest.mark.parametrize("build", [known.cut_at_wrist_pin, known.cut_at_crank_pin,
                                   known.cut_at_slide])
def test_a_slider_crank_runs_on_as_its_energy_says(build, tmp_path):
    reach = -0.06 + known.L if build is known.cut_at_crank_pin else 0.06
    com = reach - known.L if build is known.cut_at_crank_pin else reach
    mech = with_masses(build(tmp_path), tmp_path, DOWN, crank=(0.8, (0.02, 0, 0), (3e-4,) * 3),
                       rod=(0.5, (com, 0, 0), (2e-3,) * 3), slider=(0.9, (0, 0, 0), (1e-3,) * 3))
    along = known.L + com if com < 0 else com

    def bodies(phi):
        r, l, e = known.R, known.L, known.E  # noqa: E741
        beta = np.arcsin((e - r * np.sin(phi)) / l)
        yield 0.8, 3e-4, 0.02 * np.cos(phi), 0.02 * np.sin(phi), phi
        yield (0.5, 2e-3, r * np.cos(phi) + along * np.cos(beta),
               r * np.sin(phi) + along * np.sin(beta), beta)
        yield 0.9, 1e-3, r * np.cos(phi) + l * np.cos(beta), e + 0 * phi, 0 * phi

    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.3}), {"crank": 20.0})
    motion = run(mech, state, 2.0, accuracy=REFERENCE, drift=1e-10)
    assert motion.coordinate("main_pin").value[-1] > 20.0
    compare_with_arrivals(motion, "main_pin", bodies, lambda place: place[1], 20.0)


BARS = (0.30, 0.10, 0.28, 0.24)


def heavy_four_bar(folder, lengths=BARS, toml=""):
    m = {"crank": (0.3, 0.05, 4e-4), "coupler": (0.7, 0.13, 5e-3), "rocker": (0.5, 0.11, 3e-3)}
    return with_masses(known.bare_four_bar(folder, *lengths), folder, DOWN + toml, **{
        name: (mass, (c, 0, 0), (i, i, i)) for name, (mass, c, i) in m.items()})


def test_a_four_bar_runs_on_as_its_energy_says(tmp_path):
    r1, r2, r3, r4 = BARS

    def bodies(phi):
        x, y = r2 * np.cos(phi), r2 * np.sin(phi)
        d2 = (r1 - x) ** 2 + y**2  # from the crank's end to the rocker's pivot
        a = (d2 + r3**2 - r4**2) / (2 * d2)
        h = np.sqrt(r3**2 / d2 - a**2)
        bx, by = a * (r1 - x) + h * y, -a * y + h * (r1 - x)  # along the coupler
        beta = np.arcsin(by / r3)
        px, py = x + bx - r1, y + by
        psi = np.arccos(px / r4)
        yield 0.3, 4e-4, 0.05 * np.cos(phi), 0.05 * np.sin(phi), phi
        yield 0.7, 5e-3, x + 0.13 * bx / r3, y + 0.13 * by / r3, beta
        yield 0.5, 3e-3, 0.11 * px / r4, 0.11 * py / r4, psi

    mech = heavy_four_bar(tmp_path)
    state = sp.assemble(mech, {"crank": 0.5}, guess={"rocker_pin": 1.8, "coupler_pin": 0.4})
    assert state.placement("tip").translation[1] > 0.0
    state = sp.solve_rates(mech, state, {"crank": 15.0})
    motion = run(mech, state, 2.0, accuracy=REFERENCE, drift=1e-10)
    compare_with_arrivals(motion, "crank_pin", bodies, lambda place: place[1], 15.0)


def test_an_rssr_runs_on_as_its_energy_says(tmp_path):
    """The rod has no mass; the crank's and the rocker's centres of mass lie on their axes."""
    from closed_forms import rssr

    mech = with_masses(known.rssr_with_a_rod(tmp_path), tmp_path, WEIGHTLESS, crank=(
        0.4, (0, 0, 0), (1e-3,) * 3), rocker=(0.9, (0, 0, 0), (2e-3, 3e-3, 4e-3)))
    a, b, c, d = 0.102, 0.381, 0.254, 0.314

    def bodies(phi):
        yield 0.0, 1e-3, phi
        yield 0.0, 4e-3, np.arccos((b**2 - a**2 - c**2 - d**2 + 2 * a * d * np.cos(phi))
                                   / (2 * c * (d - a * np.cos(phi))))

    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.8}), {"crank": 5.0})
    assert state.coordinate("rocker_pin").value == pytest.approx(
        float(rssr(0.8).coordinates["rocker_pin"]))
    motion = run(mech, state, 4.0, accuracy=REFERENCE, drift=1e-10)
    compare_with_arrivals(motion, "crank_pin", bodies, lambda place: 0.0, 5.0)


# ---------------------------------------------------------------- springs and dampers


def on_a_slide(folder, toml, mass=2.0):
    tree = heavy(known.sliding("slide", "ground", "block", axis=(1, 0, 0)), block=(mass,))
    tree += known.point("wall", "ground", (-1.0, 0, 0))
    return known.load(folder, "block", tree, WEIGHTLESS + toml)


LINE = ('[[springs]]\nname = "spring"\nframes = ["wall", "block"]\nstiffness = {}\n'
        "damping = {}\nfree_length = 1.0\n")
ABOUT = '[[springs]]\nname = "spring"\njoint = "{}"\nstiffness = {}\ndamping = {}\n'


@pytest.mark.parametrize("spring", [LINE.format(50.0, 3.0), ABOUT.format("slide", 50.0, 3.0)])
def test_a_damped_oscillator(spring, tmp_path):
    mech = on_a_slide(tmp_path, spring)
    motion = run(mech, sp.assemble(mech, {"slide": 0.2}), 3.0, accuracy=REFERENCE)
    decay = 3.0 / (2 * 2.0)
    w = np.sqrt(50.0 / 2.0 - decay**2)
    t = motion.time
    x = 0.2 * np.exp(-decay * t) * (np.cos(w * t) + decay / w * np.sin(w * t))
    assert np.abs(motion.coordinate("slide").value - x).max() < 1e-11
    assert motion.energy[0] == pytest.approx(0.5 * 50.0 * 0.2**2)
    assert motion.work[-1] < 0.0 and np.all(np.diff(motion.work) < 1e-9)


def test_a_spring_about_a_joint_adds_to_gravity(tmp_path):
    mech = hanging(tmp_path, ABOUT.format("pin", 4.0, 0.0))
    motion = run(mech, sp.assemble(mech, {"pin": 1.0}), 3.0, accuracy=REFERENCE)
    inertia = 0.02 + 1.5 * 0.4**2
    x, _ = by_hand(lambda t, y: [y[1], -(4.0 * y[0] + 1.5 * 0.4 * G * np.sin(y[0])) / inertia],
                   [1.0, 0.0], motion.time)
    assert np.abs(motion.coordinate("pin").value - x).max() < 1e-10


def test_a_spring_with_a_law_of_its_own(tmp_path):
    """Duffing's; what it stores counts as work done."""
    mech = on_a_slide(tmp_path, LINE.format(50.0, 3.0))
    motion = run(mech, sp.assemble(mech, {"slide": 0.3}), 3.0, accuracy=REFERENCE,
                 laws={"spring": lambda x, v: 20.0 * (x - 1.0) + 300.0 * (x - 1.0) ** 3 + 0.5 * v})
    x, v = by_hand(lambda t, y: [y[1], -(20.0 * y[0] + 300.0 * y[0] ** 3 + 0.5 * y[1]) / 2.0],
                   [0.3, 0.0], motion.time)
    assert np.abs(motion.coordinate("slide").value - x).max() < 1e-10
    assert motion.energy == pytest.approx(0.5 * 2.0 * v**2, abs=1e-9)


# ---------------------------------------------------------------- efforts


def test_a_constant_effort_does_its_work(tmp_path):
    mech = heavy_four_bar(tmp_path)
    state = sp.assemble(mech, {"crank": 0.5}, guess={"rocker_pin": 1.8, "coupler_pin": 0.4})
    motion = run(mech, state, 2.0, {"crank": 2.5}, drift=1e-9)
    turned = motion.coordinate("crank").value
    assert motion.work == pytest.approx(2.5 * (turned - turned[0]), abs=1e-9 * np.ptp(motion.work))
    assert turned[-1] > 10.0


@pytest.mark.parametrize("build", [known.cut_at_wrist_pin, known.five_bar])
def test_an_effort_may_follow_time_and_state(build, tmp_path):
    """Forward dynamics of every row under the same effort gives the row's accelerations."""
    links = {"cut_at_wrist_pin": ("crank", "rod", "slider"),
             "five_bar": ("crank1", "crank2", "rod1", "rod2")}[build.__name__]
    mech = with_masses(build(tmp_path), tmp_path, DOWN, **dict.fromkeys(
        links, (0.5, (0.03, 0, 0), (2e-3,) * 3)))
    name = next(iter(mech.drivers))

    def efforts(t, state):
        return {name: 0.2 * np.sin(7.0 * t) - 0.05 * state.coordinate(name).rate}

    motion = run(mech, sp.assemble(mech), 0.5, efforts, times=np.linspace(0, 0.5, 51))
    assert np.ptp(motion.work) > 1e-3
    for k in range(0, 51, 10):
        state = motion.state(k)
        a = sp.forward_dynamics(mech, state, efforts(motion.time[k], state)).a
        assert motion.a[k] == pytest.approx(a, abs=1e-7 * np.abs(motion.a).max())


# ---------------------------------------------------------------- prescribed drivers

SAMPLES = {
    "constant_speed": (0.4, 6.0),
    "ramp": (0.4, 6.0, 0.3),
    "sine": (0.4, 0.9, 1.3),
    "cycloid": (0.4, 5.0, 0.8),
    "polynomial": ([0.4, 1.0, -2.0, 3.0],),
    "spline": ([0.0, 0.3, 0.6, 1.0], [0.4, 1.0, 0.2, 2.0]),
}


def test_every_law_is_tried():
    assert sorted(SAMPLES) == dir(sp.laws)


def heavy_slider_crank(folder):
    return with_masses(known.cut_at_wrist_pin(folder), folder, DOWN, crank=(
        0.8, (0.02, 0, 0), (3e-4,) * 3), rod=(0.5, (0.06, 0, 0), (2e-3,) * 3),
        slider=(0.9, (0, 0, 0), (1e-3,) * 3))


def starting(mech, law):
    value, rate, _ = law(0.0)
    return sp.solve_rates(mech, sp.assemble(mech, {"crank": value}), {"crank": rate})


@pytest.mark.parametrize("name", SAMPLES)
def test_rates_of_a_law_are_its_derivatives(name):
    law = getattr(sp.laws, name)(*SAMPLES[name])
    h = 1e-5
    for t in (0.02, 0.17, 0.44, 0.71, 0.93, 1.2):
        before, here, after = law(t - h), law(t), law(t + h)
        for order in (0, 1):
            slope = (after[order] - before[order]) / (2 * h)
            assert slope == pytest.approx(here[order + 1], abs=1e-7 * (1 + abs(slope)) + 1e-6)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_driver_moves_by_its_law_with_the_effort_of_inverse_dynamics(name, tmp_path):
    mech, law = heavy_slider_crank(tmp_path), getattr(sp.laws, name)(*SAMPLES[name])
    motion = run(mech, starting(mech, law), 0.9, drives={"crank": law},
                 times=np.linspace(0, 0.9, 46), drift=1e-8)
    want = np.array([law(t) for t in motion.time])
    assert np.column_stack(motion.coordinate("crank")) == pytest.approx(want, abs=1e-11)
    for k in range(0, 46, 5):
        answer = sp.inverse_dynamics(mech, motion.state(k))
        assert motion.efforts["crank"][k] == pytest.approx(answer.efforts["crank"], abs=1e-9)


def test_with_every_freedom_prescribed_it_is_kinematics(tmp_path):
    mech, law = heavy_slider_crank(tmp_path), sp.laws.sine(0.4, 0.9, 1.3)
    motion = run(mech, starting(mech, law), 1.0, drives={"crank": law}, drift=1e-8)
    swept = [sp.solve_rates(mech, sp.assemble(mech, {"crank": v}), {"crank": r}, {"crank": a})
             for v, r, a in map(law, motion.time[::100])]
    for state, k in zip(swept, range(0, 1001, 100), strict=True):
        assert motion.q[k] == pytest.approx(state.q, abs=1e-12)
        assert motion.v[k] == pytest.approx(state.v, abs=1e-11)
        assert motion.a[k] == pytest.approx(state.a, abs=1e-9)


def test_a_pendulum_on_a_driven_slide(tmp_path):
    """Rheonomic: theta'' = -(g sin theta + x'' cos theta) / l."""
    tree = heavy(known.sliding("slide", "ground", "cart", axis=(1, 0, 0)) + known.turning(
        "pin", "cart", "bob", rpy=(0, 0, -np.pi / 2)), cart=(3.0,), bob=(1.0, (0.5, 0, 0)))
    mech, law = known.load(tmp_path, "cart", tree, DOWN), sp.laws.sine(0.0, 0.3, 2.0, np.pi / 2)
    state = sp.assemble(mech, {"pin": 0.4, "slide": 0.3})
    motion = run(mech, state, 3.0, drives={"slide": law}, accuracy=REFERENCE)
    theta, rate = by_hand(lambda t, y: [y[1], -(G * np.sin(y[0]) + law(t)[2] * np.cos(y[0])) / 0.5],
                          [0.4, 0.0], motion.time)
    assert np.abs(motion.coordinate("pin").value - theta).max() < 1e-9
    second = motion.coordinate("pin").acceleration
    push = [4.0 * law(t)[2] for t in motion.time] + 0.5 * (
        second * np.cos(theta) - rate**2 * np.sin(theta))
    assert motion.efforts["slide"] == pytest.approx(push, abs=1e-7)


@pytest.mark.parametrize("name", few(
    ["crane", "delta", "four_bar", "rspc", "rssr", "stewart"], "crane", "four_bar", "rssr"))
def test_drivers_of_the_library_bear_the_efforts_of_inverse_dynamics(name):
    """With or without freedoms that are left: the RSSR's rod may spin."""
    mech = library(name)
    state, laws = sp.assemble(mech), {}
    for driver in mech.drivers:
        value, unit = state.coordinate(driver).value, mech.coordinate(driver).unit
        size = 0.05 if unit == "rad" else 0.05 * mech.characteristic_length
        laws[driver] = sp.laws.sine(value - size, size, 1.0, np.pi / 2)
    motion = run(mech, state, 1.0, drives=laws, times=np.linspace(0, 1, 21), drift=1e-8)
    for k in range(0, 21, 4):
        efforts = sp.inverse_dynamics(mech, motion.state(k)).efforts
        found = {driver: rows[k] for driver, rows in motion.efforts.items()}
        assert found == pytest.approx(efforts, rel=1e-10, abs=1e-10)


def test_efforts_are_named_as_drivers_are_and_found_by_the_joint_too(tmp_path):
    mech, law = heavy_slider_crank(tmp_path), sp.laws.constant_speed(0.5, 6.0)
    efforts = sp.simulate(mech, starting(mech, law), 0.1, drives={"main_pin": law}).efforts
    assert list(efforts) == ["crank"]
    assert "main_pin" in efforts and "slide" not in efforts and efforts.get("slide") is None
    assert efforts["main_pin"] is efforts["crank"] is efforts.get("main_pin")
    with pytest.raises(sp.SpatialPinError, match="no prescribed driver 'slide'"):
        efforts["slide"]
    again = pickle.loads(pickle.dumps(efforts))
    np.testing.assert_array_equal(again["main_pin"], efforts["crank"])


@pytest.mark.parametrize("times", [[0.0, 0.0, 1.0], [1.0, 0.5, 0.0], [0.0]])
def test_a_spline_through_times_that_do_not_rise_is_refused_in_words(times):
    with pytest.raises(ValueError, match="times must be two or more that rise"):
        sp.laws.spline(times, [0.0] * len(times))


def test_a_state_that_is_at_zero_but_for_round_off_is_reported_as_at_zero():
    mech = library("four_bar")
    state = sp.assemble(mech, {"crank": -1.08034167e-28})
    with pytest.raises(sp.SpatialPinError, match=r"the law of crank starts at 0\.5 rad, the state "
                       "is at 0: assemble it there"):
        sp.simulate(mech, state, 1.0, drives={"crank": sp.laws.constant_speed(0.5, 1.0)})
    with pytest.raises(sp.SpatialPinError, match="the law of crank starts with 1 rad/s, the state "
                       "moves with 0: solve its rates"):
        sp.simulate(mech, state, 1.0, drives={"crank": sp.laws.constant_speed(0.0, 1.0)})


@pytest.mark.parametrize("law", [sp.laws.constant_speed(0.5, 6.0), sp.laws.sine(0.4, 0.2, 1.0)])
def test_a_state_must_start_as_the_law_does(law, tmp_path):
    mech = heavy_slider_crank(tmp_path)
    with pytest.raises(sp.SpatialPinError, match="the law of crank starts"):
        sp.simulate(mech, sp.assemble(mech, {"crank": 0.4}), 1.0, drives={"crank": law})


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize(("begin", "place"), [(0.0, 0), (0.05, 0), (0.05, 2)])
def test_a_law_that_gives_no_number_is_refused_by_name_and_time(value, begin, place):
    mech = library("four_bar")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.3}), {"crank": 1.0})

    def law(t):
        found = [0.3 + t, 1.0, 0.0]
        found[place] = value if t >= begin else found[place]
        return tuple(found)

    with pytest.raises(ValueError, match="law of 'crank' has a value that is NaN or infinite at"):
        sp.simulate(mech, state, 0.1, drives={"crank": law})


# ---------------------------------------------------------------- integrators


def largest_error(mech, accuracy, amplitude=2.0):
    times = np.linspace(0.0, 2.0, 21)
    motion = run(mech, sp.assemble(mech, {"pin": amplitude}), 2.0, times=times, accuracy=accuracy,
                 drift=1.0)
    return np.abs(motion.coordinate("pin").value - swing(amplitude, times)).max()


@pytest.mark.parametrize("name", INTEGRATORS)
def test_every_integrator_reaches_its_order_or_tolerance(name, tmp_path):
    """A fixed step, halved, leaves a sixteenth of the error."""
    mech = hanging(tmp_path)
    if name in ("RK4", "Gauss"):
        coarse, fine = (largest_error(mech, sp.Accuracy(integrator=name, step=h))
                        for h in (0.01, 0.005))
        assert 13.0 < coarse / fine < 19.0
        assert coarse < 1e-4
        with pytest.raises(ValueError, match="needs a step"):
            largest_error(mech, sp.Accuracy(integrator=name))
        return
    error = largest_error(mech, sp.Accuracy(integrator=name, time_tolerance=1e-8))
    assert error < 3e-5
    assert largest_error(mech, sp.Accuracy(integrator=name, time_tolerance=1e-10)) < 0.2 * error


@pytest.mark.parametrize("name", ["RK4", "Gauss", "DOP853"])
def test_rows_between_steps_are_as_exact_as_the_method(name, tmp_path):
    mech, times = hanging(tmp_path), np.linspace(0.0, 1.0, 57)
    motion = run(mech, sp.assemble(mech, {"pin": 1.0}), 1.0, times=times, drift=1e-5,
                 accuracy=sp.Accuracy(integrator=name, step=0.005))
    assert np.abs(motion.coordinate("pin").value - swing(1.0, times)).max() < 1e-6


def test_gauss_keeps_the_energy_for_ever(tmp_path):
    """Ten thousand steps: the energy swings with the motion but does not drift away."""
    mech = hanging(tmp_path)
    motion = run(mech, sp.assemble(mech, {"pin": 1.0}), 200.0, times=np.linspace(0, 200, 401),
                 accuracy=sp.Accuracy(integrator="Gauss", step=0.02), drift=1e-5)
    assert motion.steps == 10_000
    off = np.abs(motion.energy - motion.energy[0])
    assert off[-40:].max() < 1.1 * off[:40].max()


@pytest.mark.parametrize("name", ["Radau", "BDF"])
def test_a_stiff_spring(name, tmp_path):
    """Overdamped: it creeps back with k / c, while the fast motion has c / m = 5e4."""
    mech = on_a_slide(tmp_path, LINE.format(1e4, 1e5))
    motion = run(mech, sp.assemble(mech, {"slide": 0.2}), 5.0, drift=1e-4,
                 accuracy=sp.Accuracy(integrator=name, time_tolerance=1e-8))
    slow = np.roots([2.0, 1e5, 1e4])[1]
    assert motion.coordinate("slide").value[-1] == pytest.approx(0.2 * np.exp(slow * 5.0), rel=1e-4)
    assert motion.evaluations < 5000


# ---------------------------------------------------------------- the way through a motion


def test_a_double_rocker_swings_through_the_limits_of_its_crank(tmp_path):
    mech = heavy_four_bar(tmp_path, (0.30, 0.20, 0.21, 0.16))
    state = sp.assemble(mech, {"crank": 0.9}, guess={"rocker_pin": 1.8, "coupler_pin": -0.8})
    motion = run(mech, state, 3.0, drift=1e-9, accuracy=REFERENCE)
    assert len(motion.coordinates) > 1
    rate = motion.coordinate("crank_pin").rate
    assert np.count_nonzero(np.diff(np.sign(rate[1:]))) > 3
    assert np.abs(np.diff(motion.q, axis=0)).max() < 0.3


def test_a_parallelogram_passes_its_change_points(tmp_path):
    """It stays a parallelogram: the rocker turns with the crank."""
    mech = heavy_four_bar(tmp_path, (0.3, 0.2, 0.3, 0.2))
    state = sp.assemble(mech, {"crank": 0.7}, guess={"rocker_pin": 0.7, "coupler_pin": -0.7})
    state = sp.solve_rates(mech, state, {"crank": 20.0})
    motion = run(mech, state, 2.0)
    crank, rocker = (motion.coordinate(n).value for n in ("crank_pin", "rocker_pin"))
    assert crank[-1] > 12.0
    assert np.abs(crank - rocker).max() < 1e-9
    passed = [k * np.pi for k in range(1, int(crank[-1] / np.pi) + 1)]
    assert [e.kind for e in motion.events] == ["branch point"] * len(passed)
    assert [abs(e.value) for e in motion.events] == pytest.approx(passed, abs=1e-6)
    assert all(crank[e.row - 1] <= x <= crank[e.row]
               for e, x in zip(motion.events, passed, strict=True))


@pytest.mark.parametrize("name", ["delta", "stewart"])
def test_a_singular_configuration_ahead_ends_the_motion(name):
    """All forearms, or legs, at once: what comes is not determined by the forces."""
    mech = library(name)
    with pytest.raises(sp.SingularError, match="cannot be followed beyond") as caught:
        sp.simulate(mech, sp.assemble(mech), 2.0, times=np.linspace(0, 2, 201))
    motion = caught.value.motion
    assert isinstance(motion, sp.Simulation) and len(motion) > 10
    assert motion.closure_error.max() < 1e-12 and motion.energy_drift < 1e-8
    assert motion.evaluations < 6000


def test_many_steps_leave_the_loops_closed(tmp_path):
    """But for the digits that an angle of many turns has not got."""
    mech = heavy_four_bar(tmp_path)
    state = sp.assemble(mech, {"crank": 0.5}, guess={"rocker_pin": 1.8, "coupler_pin": 0.4})
    state = sp.solve_rates(mech, state, {"crank": 15.0})
    motion = run(mech, state, 40.0, times=np.linspace(0, 40, 201), drift=1e-4,
                 accuracy=sp.Accuracy(integrator="RK4", step=2e-3))
    assert motion.steps == 20_000
    turned = np.abs(motion.q).max(axis=1)
    assert turned[-1] > 400.0
    assert np.all(motion.closure_error < 1e-13 + np.finfo(float).eps * turned)


@pytest.mark.parametrize("name", each(
    [n for n in sp.list_mechanisms() if n not in ("delta", "stewart")]))
def test_every_mechanism_of_the_library_falls(name):
    mech = library(name)
    driver = next(iter(mech.drivers))
    unit = mech.coordinate(driver)
    size = 1.0 if unit.unit == "rad" else mech.characteristic_length
    state = sp.assemble(mech)
    start = state.coordinate(driver).value + (0.3 if unit.unit == "rad" else 0.02) * size
    if len(mech.drivers) == 1:
        state = sp.assemble(mech, {driver: start}, state)
    state = sp.solve_rates(mech, state, {driver: 0.5 * size})
    motion = run(mech, state, 0.5, times=np.linspace(0, 0.5, 26))
    for before, after in pairwise(motion.q):
        assert np.abs(after - before).max() < 2.0


# ---------------------------------------------------------------- what is refused


def test_what_is_refused(tmp_path):
    mech = hanging(tmp_path)
    state = sp.assemble(mech, {"pin": 1.0})
    for duration in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="duration"):
            sp.simulate(mech, state, duration)
    for times in ([], [0.5, 0.5], [-0.1, 0.5], [0.5, 1.5], [0.1, np.nan]):
        with pytest.raises(ValueError, match="times"):
            sp.simulate(mech, state, 1.0, times=times)
    there_are = f"no integrator 'Euler'; there are {', '.join(INTEGRATORS)}"
    with pytest.raises(ValueError, match=there_are):
        sp.Accuracy(integrator="Euler")
    with pytest.raises(ValueError, match="effort at 'pin'"):
        sp.simulate(mech, state, 1.0, {"pin": np.nan})
    for keys in ({"efforts": {"pim": 1.0}}, {"drives": {"pim": sp.laws.sine(0, 1, 1)}},
                 {"laws": {"spring": lambda x, v: 0.0}}):
        with pytest.raises(sp.SpatialPinError, match=r"pim|spring"):
            sp.simulate(mech, state, 1.0, **keys)


def test_a_start_in_a_change_point_is_refused(tmp_path):
    mech = heavy_four_bar(tmp_path, (0.3, 0.2, 0.3, 0.2))
    state = sp.State(mech, np.zeros(3), np.zeros(3), closure_error=0.0)
    with pytest.raises(sp.SingularError, match="start beside this configuration"):
        sp.simulate(mech, state, 1.0)


# ---------------------------------------------------------------- formulations


@pytest.mark.parametrize("name", ["four_bar", "rssr", "bennett", "rspc", "swash_plate", "crane"])
def test_all_joint_coordinates_projected_give_the_motion_of_independent_ones(name):
    """Plane, spatial with a passive spin, overconstrained, with a slide, open."""
    mechanism = library(name)
    driver = next(iter(mechanism.drivers))
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {driver: 0.3}), {driver: 2.0})
    times = np.linspace(0.0, 0.5, 6)
    ways = [sp.simulate(mechanism, state, 0.5, times=times, accuracy=sp.Accuracy(formulation=f))
            for f in ("independent", "projected")]
    np.testing.assert_allclose(ways[1].q, ways[0].q, atol=3e-10)
    np.testing.assert_allclose(ways[1].a, ways[0].a, atol=1e-8 * (1.0 + abs(ways[0].a).max()))
    assert ways[1].closure_error.max() < 1e-12
    assert ways[1].energy_drift < 1e-10


def test_what_projecting_takes_is_reported():
    """Long steps open the loops further, and take more corrections each."""
    mechanism = library("four_bar")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.3}), {"crank": 5.0})
    assert sp.simulate(mechanism, state, 0.02).projection is None
    took = {}
    for step in (1e-4, 2e-3):
        motion = sp.simulate(mechanism, state, 0.02, times=[0.0, 0.02], accuracy=sp.Accuracy(
            formulation="projected", integrator="RK4", step=step))
        took[step] = motion.projection
        assert motion.projection.steps == motion.steps == round(0.02 / step)
        assert 0.0 < motion.projection.share < 1.0 and motion.projection.seconds > 0.0
    short, long = took.values()
    assert short.opened < 1e-13 < long.opened < 1e-6
    assert long.corrections >= long.steps and short.corrections < short.steps


def test_what_the_projected_formulation_cannot_do_is_stated():
    mechanism = library("four_bar")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.3}), {"crank": 2.0})
    projected = sp.Accuracy(formulation="projected")
    with pytest.raises(sp.SpatialPinError, match="prescribes no drivers"):
        sp.simulate(mechanism, state, 0.1, accuracy=projected,
                    drives={"crank": sp.laws.constant_speed(0.3, 2.0)})
    with pytest.raises(ValueError, match=r"LSODA.*cannot be corrected"):
        sp.simulate(mechanism, state, 0.1,
                    accuracy=sp.Accuracy(formulation="projected", integrator="LSODA"))
    with pytest.raises(ValueError, match="no formulation 'lagrange'"):
        sp.simulate(mechanism, state, 0.1, accuracy=sp.Accuracy(formulation="lagrange"))


@pytest.mark.filterwarnings("ignore:mechanism .* no link has a mass")
@pytest.mark.parametrize("name", ["slider-crank cut at slide", "five-bar"])
def test_freedoms_without_inertia_have_the_least_accelerations_or_are_refused(name, tmp_path):
    """No link has a mass: one freedom, and two."""
    case = known.KNOWN[name]
    mechanism = case.build(tmp_path)
    state = sp.assemble(mechanism, {case.driver: case.values[9], **case.hold})
    state = sp.solve_rates(mechanism, state, {case.driver: 0.1})
    moved = sp.simulate(mechanism, state, 0.1, times=np.linspace(0.0, 0.1, 5))
    for k in range(5):
        least = sp.forward_dynamics(mechanism, moved.state(k))
        assert least.undetermined
        np.testing.assert_allclose(moved.a[k], least.state.a, atol=1e-10)
    by_simpson = 0.1 / 12.0 * (np.array([1.0, 4.0, 2.0, 4.0, 1.0]) @ moved.a)
    np.testing.assert_allclose(moved.v[4] - moved.v[0], by_simpson, atol=1e-9)
    with pytest.raises(sp.SingularError, match="no inertia but a force works on it"):
        sp.simulate(mechanism, state, 0.1, {case.driver: 1.0})


# ---------------------------------------------------------------- coarse, and overconstrained

LUMP = (1.0, (0.1, 0.02, 0.03), (1e-2, 2e-2, 3e-2))


def bennett_with_a_pendulum(folder):
    """Bennett's linkage, three of whose equations follow from the others, and one link more."""
    mech = known.bennett(folder)
    path = folder / f"{mech.name}.urdf"
    hung = known.turning("hang", "link3", "bob", (0.3, 0.1, 0), axis=(0.3, 0.5, 0.8))
    tree = path.read_text(encoding="utf-8").replace("</robot>", hung + "</robot>")
    path.write_text(heavy(tree, link1=LUMP, link2=LUMP, link3=LUMP, bob=LUMP), encoding="utf-8")
    return sp.load(folder / f"{mech.name}.toml")


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_coarse_steps_do_not_hide_which_equations_depend_on_others(formulation, tmp_path):
    """Loops open by 1e-8 seem to have more equations; the linkage loses none on its way.

    Steps are closed to round-off; samples between them are interpolated to a part of the tolerance.
    """
    mech = bennett_with_a_pendulum(tmp_path)
    draft = replace(sp.Accuracy.named("draft"), formulation=formulation)
    coarse, fine = (sp.simulate(mech, sp.assemble(mech), 8.0, accuracy=accuracy)
                    for accuracy in (draft, None))
    assert coarse.closure_error.max() < (1e-12 if formulation == "projected" else 1e-9)
    assert np.median(coarse.closure_error) < 1e-12
    assert coarse.energy_drift < 1e-6
    assert np.abs(coarse.q - fine.q).max() < 1e-3


@pytest.fixture(scope="module")
def sarrus_with_a_pendulum(tmp_path_factory):
    """Sarrus' linkage with a pendulum on its platform: two freedoms."""
    folder = tmp_path_factory.mktemp("files") / "urdf"
    shutil.copytree(Path(sp.__file__).parent.parent / "urdf", folder)
    file = folder / "sarrus.urdf.xacro"
    bob = heavy(known.turning("swing", "platform", "bob", axis=(0, 1, 0)),
                bob=(0.05, (0.05, 0, 0), (1e-5, 1e-4, 1e-4)))
    file.write_text(file.read_text().replace("</robot>", bob + "</robot>"))
    return sp.assemble(sp.load(folder / "sarrus.toml"))


@pytest.mark.parametrize(("tolerance", "speed", "duration"), [
    (1e-8, -30.0, 0.06), (1e-6, 0.0, 0.3), (1e-6, -8.0, 0.3), (1e-6, -30.0, 0.06)])
def test_no_step_goes_across_a_flat_place(sarrus_with_a_pendulum, tolerance, speed, duration):
    """Both loops go flat at once there: the determinant vanishes without a change of its sign."""
    mech = sarrus_with_a_pendulum.mechanism
    state = sp.solve_rates(mech, sarrus_with_a_pendulum, {"arm": speed})
    with pytest.raises(sp.SingularError) as caught:
        sp.simulate(mech, state, duration, accuracy=sp.Accuracy(time_tolerance=tolerance))
    assert caught.value.motion.coordinate("a_low").value.min() > -1e-3
