"""Simulations far from the ordinary: masses of any ratio, none, any pace, any integrator."""

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from ladders import two_rods, uniform
from masses import heavy
from scipy.integrate import solve_ivp
from variety import each, few, first

import spatial_pin as sp

FORMULATIONS = ("independent", "projected")
BARS = {"crank": 0.1, "coupler": 0.28, "rocker": 0.24}
GUESS = known.guess(a=1.0, b=-0.41, c=1.63)


# ---------------------------------------------------------------- integrators


@pytest.mark.parametrize("integrator", ["BDF", "LSODA", "Radau"])
@pytest.mark.parametrize("name, until", first(1, [
    ("rssr", 0.3), ("delta", 0.3), ("stewart", 0.25)]))
def test_implicit_integrators_fall_as_explicit_ones(integrator, name, until):
    """They write on the unknowns that they have asked for."""
    mech = sp.load(name)
    ends = [sp.simulate(mech, sp.assemble(mech), until, times=[until], accuracy=sp.Accuracy(
        integrator=i, time_tolerance=1e-7)).q[-1] for i in (integrator, "DOP853")]
    assert np.abs(pin.difference(mech.model, *ends)).max() < 1e-4


@pytest.mark.parametrize("name", each(
    [n for n in sp.list_mechanisms() if n not in ("satellite_dish", "stewart", "sarrus")]))
def test_loose_steps_are_projected_on_the_branch(name):
    """A step that opens the loops too far is taken anew; stewart and sarrus soon lose rank."""
    mech = sp.load(name)
    tight = sp.simulate(mech, sp.assemble(mech), 0.25, times=[0.25])
    loose = sp.simulate(mech, sp.assemble(mech), 0.25, times=[0.25], accuracy=sp.Accuracy(
        formulation="projected", time_tolerance=1e-4))
    assert np.abs(pin.difference(mech.model, loose.q[-1], tight.q[-1])).max() < 2e-3
    assert loose.closure_error.max() < 1e-12
    assert loose.projection.opened < 1e-3


def test_a_fixed_step_that_opens_the_loops_too_far_is_refused():
    mech = sp.load("four_bar")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.3}), {"crank": 10.0})
    with pytest.raises(sp.SpatialPinError, match=r"a step of 0\.05 s at .* take shorter ones"):
        sp.simulate(mech, state, 1.0, accuracy=sp.Accuracy(
            formulation="projected", integrator="RK4", step=0.05))


# ---------------------------------------------------------------- masses


def lagrange(end, g=9.81):
    """Their accelerations, the large terms cancelled by hand; b is the lower one's own angle."""
    a, b, c = 4 / 3 + end, 1 / 3 + end, 0.5 + end
    upper, lower = (1.5 + end) * g, (0.5 + end) * g

    def f(t, y):
        p, k, u, w = y
        s, cos = np.sin(k), np.cos(k)
        first = c * s * w * w - upper * np.cos(p)
        second = -c * s * u * u - lower * np.cos(p + k)
        by = 7 / 36 + 2 / 3 * end + (c * s) ** 2  # ab - c² cos²
        return [u, w - u, (b * first - c * cos * second) / by, (a * second - c * cos * first) / by]
    return f


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("end", few([1e4, 1e9], 1e4))
def test_light_rods_with_a_heavy_end_swing_as_lagrange_says(end, formulation, tmp_path):
    """They fall freely until they are straight at 0.709 s, and are thrown round there."""
    mech = two_rods(tmp_path, end)
    motion = sp.simulate(mech, sp.assemble(mech, {"p": 0.3, "k": 0.7}), 0.75, times=[0.75],
                         accuracy=sp.Accuracy(formulation=formulation))
    exact = solve_ivp(lagrange(end), (0.0, 0.75), [0.3, 0.7, 0.0, 0.0], method="DOP853",
                      rtol=1e-13, atol=1e-13).y[:2, -1]
    np.testing.assert_allclose(motion.q[-1], exact, atol=1e-6)
    assert motion.energy_drift < 1e-8 and motion.steps < 900


@pytest.mark.slow
def test_masses_beyond_what_numbers_hold_end_the_motion(tmp_path):
    mech = two_rods(tmp_path, 1e20)
    with pytest.raises(sp.SingularError, match="masses differ too much") as caught:
        sp.simulate(mech, sp.assemble(mech, {"p": 0.3, "k": 0.7}), 0.8,
                    accuracy=sp.Accuracy(formulation="projected"))
    assert 0.7 < caught.value.motion.time[-1] < 0.71


def massless_coupler():
    mech = sp.load("rssr")
    ball = mech.joint_id("ball_a")
    mech.model.inertias[ball] = pin.Inertia.Zero()
    return mech, mech.model.idx_vs[ball], mech.model.idx_qs[ball]


def spin(motion, v, q):
    """Angular velocity of the coupler about its line [rad/s]."""
    mech = motion.mechanism
    found = []
    for row, rates in zip(motion.q, motion.v, strict=True):
        data = mech.model.createData()
        pin.forwardKinematics(mech.model, data, row, rates)
        frame = mech.model.frames[mech.model.getFrameId("coupler_b")]
        line = frame.placement.translation
        found.append(float(data.v[frame.parentJoint].angular @ line) / np.linalg.norm(line))
    return np.array(found)


def test_a_massless_coupler_is_one_freedom_in_any_formulation():
    mech, *at = massless_coupler()
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.3}), {"crank": 1.0})
    ways = [sp.simulate(mech, state, 0.3, times=np.linspace(0, 0.3, 4),
                        accuracy=sp.Accuracy(formulation=f)) for f in FORMULATIONS]
    gaps = [pin.difference(mech.model, *rows) for rows in zip(*(w.q for w in ways), strict=True)]
    assert np.abs(gaps).max() < 1e-8
    for way in ways:
        assert way.energy_drift < 1e-9 and way.steps < 120
        sigma = spin(way, *at)
        assert np.abs(sigma - sigma[0]).max() < 1e-8


def test_a_massless_coupler_keeps_its_spin_while_the_crank_is_driven():
    mech, *at = massless_coupler()
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.3}), {"crank": 4.0})
    motion = sp.simulate(mech, state, 1.6, times=np.linspace(0, 1.6, 17),
                         drives={"crank": sp.laws.constant_speed(0.3, 4.0)})
    assert motion.steps < 160
    sigma = spin(motion, *at)
    assert np.abs(sigma - sigma[0]).max() < 1e-8
    driven = sp.inverse_dynamics(mech, motion.state(-1)).efforts["crank"]
    np.testing.assert_allclose(motion.efforts["crank_pin"][-1], driven, rtol=1e-8)


# ---------------------------------------------------------------- pace


def falling(folder, gravity, toml=""):
    tree = heavy(
        known.turning("a", "ground", "crank") + known.turning("b", "crank", "coupler", (0.1, 0, 0))
        + known.turning("c", "ground", "rocker", (0.3, 0, 0))
        + known.point("end", "coupler", (0.28, 0, 0)) + known.point("eye", "rocker", (0.24, 0, 0)),
        **{link: uniform(1.0, length) for link, length in BARS.items()})
    return known.load(folder, f"falls_{gravity:g}", tree, f"gravity = [0.0, {-gravity!r}, 0.0]\n"
                      + known.closure("pin", "revolute", "end", "eye")
                      + known.driver("crank", "a") + GUESS + toml)


@pytest.mark.parametrize("integrator", few(["DOP853", "Radau", "LSODA"], "DOP853", "LSODA"))
def test_a_faster_motion_is_as_exact(integrator, tmp_path):
    """Gravity a million times as large, or as small: the same curve, a thousand times faster."""
    ends, steps = [], []
    for gravity in (9.81e-6, 9.81, 9.81e6):
        mech = falling(tmp_path, gravity)
        time = 2.0 / np.sqrt(gravity)
        motion = sp.simulate(
            mech, sp.assemble(mech, {"crank": 1.0}), time, times=[time], accuracy=sp.Accuracy(
                formulation="independent" if integrator == "LSODA" else "projected",
                integrator=integrator, time_tolerance=1e-8))
        ends.append(motion.q[-1])
        steps.append(motion.steps)
    assert max(steps) < 1.1 * min(steps)
    np.testing.assert_allclose(ends, np.tile(ends[1], (3, 1)), atol=1e-6)


@pytest.mark.parametrize("gravity", [9.81e-6, 9.81, 9.81e6, 9.81e12])
def test_the_energy_drifts_as_little_at_any_pace(gravity, tmp_path):
    mech = falling(tmp_path, gravity)
    motion = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 10.0 / np.sqrt(gravity))
    assert motion.energy_drift < 1e-10
    assert motion.steps < 450


def test_work_is_counted_by_the_energy_of_the_bodies(tmp_path):
    """A rod of any mass turned by a motor as strong: as many steps, as small a drift."""
    found = []
    for mass in (1e-15, 1.0, 1e9):
        tree = heavy(known.turning("p", "ground", "rod"), rod=uniform(mass, 1.0))
        mech = known.load(tmp_path, f"rod_{mass:g}", tree, "gravity = [0.0, -9.81, 0.0]\n"
                          + known.driver("motor", "p"))
        motion = sp.simulate(mech, sp.assemble(mech, {"motor": 0.3}), 2.0, {"motor": 9.0 * mass})
        found.append((motion.steps, motion.energy_drift))
    steps, drifts = zip(*found, strict=True)
    assert max(steps) <= 1.05 * min(steps)
    assert max(drifts) < 1e-10
