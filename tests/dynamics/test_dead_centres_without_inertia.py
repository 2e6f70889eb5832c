"""Simulations of links without inertia: they end where one would become infinitely fast."""

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from masses import heavy
from variety import few

import spatial_pin as sp

TILTED = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.5, -1.0), np.array([1.0, 2.0, 3.0]))
AHEAD = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))


def slider(folder, masses, axis=(0.0, 0.0, 1.0)):
    """A crank of 1 m, a rod of 2 m, a slider along x that runs outwards at 1 m/s from 2.5 m."""
    rpy = known.rpy_facing(axis, (1, 0, 0))
    tree = known.point("plane", "ground", rpy=rpy)
    tree += known.turning("a", "plane", "crank") + known.turning("b", "crank", "rod", (1, 0, 0))
    tree += known.sliding("s", "plane", "slider", axis=(1, 0, 0)) + known.point(
        "tip", "rod", (2, 0, 0))
    text = known.closure("pin", "revolute", "tip", "slider") + "[drivers.s]\njoint = \"s\"\n"
    mech = known.load(folder, "slider", heavy(tree, **masses), "gravity = [0.0, 0.0, 0.0]\n" + text)
    start = sp.assemble(mech, {"s": 2.5}, guess={"a": 0.8, "b": -1.2})
    return mech, sp.solve_rates(mech, start, {"s": 1.0})


BLOCK = (1.0, (0.0, 0.0, 0.0), (1e-3, 1e-3, 1e-3))


def ends_at(motion, time, link, off):
    event = motion.events[-1]
    assert event.kind == "singular" and event.row == len(motion) and event.value == motion.time[-1]
    assert event.value == pytest.approx(time, abs=off)
    assert f"the link '{link}' would have to become infinitely fast" in event.text


FLAT, LEANING = (0, 0, 1), (0, 0.6, 0.8)
SETTINGS = [  # and what the end is off by
    ({}, 1e-7), ({"formulation": "projected"}, 1e-4),
    ({"time_tolerance": 1e-6, "integrator": "DOP853"}, 1e-6),
    ({"integrator": "RK4", "step": 1e-3}, 1e-3), ({"integrator": "Radau"}, 1e-4)]


@pytest.mark.parametrize(("axis", "setting"), [
    *((FLAT, x) for x in SETTINGS[:4]), (LEANING, SETTINGS[0]),
    *(pytest.param(LEANING, x, marks=pytest.mark.slow) for x in SETTINGS[1:]),
    pytest.param(FLAT, SETTINGS[4], marks=pytest.mark.slow)], ids=str)
def test_a_slider_ends_where_crank_and_rod_without_mass_are_in_line(axis, setting, tmp_path):
    settings, off = setting
    mech, start = slider(tmp_path, {"slider": BLOCK}, axis)
    motion = sp.simulate(mech, start, 1.0, accuracy=sp.Accuracy(**settings))
    ends_at(motion, 0.5, "crank", off)
    assert motion.coordinate("s").value[-1] == pytest.approx(3.0, abs=off)
    if "step" not in settings:
        assert np.abs(motion.coordinate("s").rate - 1.0).max() < 1e-5
        assert motion.energy_drift < 1e-6 and motion.steps < 4e3


def test_the_samples_until_then_are_those_that_were_wanted(tmp_path):
    mech, start = slider(tmp_path, {"slider": BLOCK})
    motion = sp.simulate(mech, start, 1.0, times=[0.1, 0.3, 0.45, 0.6, 0.9])
    assert motion.time[:3].tolist() == [0.1, 0.3, 0.45] and len(motion) == 4
    ends_at(motion, 0.5, "crank", 1e-7)


def test_a_crank_with_a_mass_however_small_swings_through(tmp_path):
    mech, start = slider(tmp_path, {"slider": BLOCK, "crank": (1e-4, (0, 0, 0), (1e-4,) * 3)})
    motion = sp.simulate(mech, start, 1.0)
    assert not motion.events and motion.time[-1] == 1.0 and motion.energy_drift < 1e-6
    assert motion.coordinate("a").value.min() < -0.8


def chain(point=True, on=TILTED, pull=0.0):
    """Two links of 1 m without mass, and a mass of 2 kg at their end: a point of the outer one."""
    model, parent = pin.Model(), 0
    for name, link, at in (("a", "inner", on), ("b", "outer", AHEAD), ("c", "disc", AHEAD)):
        if name == "c" and point:
            model.appendBodyToJoint(parent, pin.Inertia(2.0, AHEAD.translation, np.zeros((3, 3))),
                                    pin.SE3.Identity())
            break
        parent = model.addJoint(parent, pin.JointModelRZ(), at, name)
        model.addBodyFrame(link, parent, pin.SE3.Identity(), 0)
        if name == "c":
            model.appendBodyToJoint(parent, pin.Inertia(2.0, np.zeros(3), 0.1 * np.eye(3)),
                                    pin.SE3.Identity())
    model.gravity.linear = on.rotation @ np.array([0.0, -pull, 0.0])
    return sp.Mechanism.from_model(model, name="chain")


def thrown(mech, place, speed):
    """The state in which the end is at a place (2,) in the plane of the chain with a speed (2,)."""
    bend = 2.0 * np.arccos(0.5 * np.hypot(*place))
    first = np.arctan2(place[1], place[0]) - 0.5 * bend
    (s1, c1), (s2, c2) = ((np.sin(x), np.cos(x)) for x in (first, first + bend))
    rates = np.linalg.solve([[-s1 - s2, -s2], [c1 + c2, c2]], speed)
    q, v = np.zeros((2, mech.model.nv))
    q[:2], v[:2] = (first, bend), rates
    v[2:] = 0.3 - rates.sum()
    return sp.State(mech, q, v, closure_error=0.0)


@pytest.mark.parametrize("settings, off", [({}, 1e-7), ({"formulation": "projected"}, 1e-4)],
                         ids=str)
@pytest.mark.parametrize("point", few([True, False], False), ids=["point", "disc"])
def test_a_mass_on_links_without_mass_flies_straight_until_they_are_stretched(point, settings, off):
    mech, place, speed = chain(point), np.array([1.0, 0.5]), np.array([1.0, 0.2])
    motion = sp.simulate(mech, thrown(mech, place, speed), 2.0, accuracy=sp.Accuracy(**settings))
    a, b, c = speed @ speed, place @ speed, place @ place - 4.0
    ends_at(motion, (np.sqrt(b * b - a * c) - b) / a, "outer", off)
    assert motion.energy_drift < 1e-8


@pytest.mark.parametrize("short", few([1e-3, 1e-6, 1e-9], 1e-6))
def test_a_mass_that_turns_back_just_before_they_are_stretched_falls_down_again(short):
    """Thrown up on links without mass, it feels nothing of them."""
    pull = 9.81
    rise = np.sqrt(2.0 * pull * (1.0 - short))
    mech, until = chain(pull=pull), 1.5 * rise / pull
    motion = sp.simulate(mech, thrown(mech, [0.0, 1.0], [0.0, rise]), until, times=[until])
    first, bend = motion.q[-1, :2]
    height = 1.0 + rise * until - 0.5 * pull * until**2
    assert not motion.events
    assert np.sin(first) + np.sin(first + bend) == pytest.approx(height, abs=1e-10)


@pytest.mark.slow
def test_a_mass_thrown_up_too_fast_ends_where_they_are_stretched():
    rise = np.sqrt(2.0 * 9.81 * 1.01)
    mech = chain(pull=9.81)
    motion = sp.simulate(mech, thrown(mech, [0.0, 1.0], [0.0, rise]), 1.0)
    ends_at(motion, (rise - np.sqrt(2.0 * 9.81 * 0.01)) / 9.81, "outer", 1e-6)


def test_the_command_line_tells_of_the_end(tmp_path, run):
    mech, _ = slider(tmp_path, {"slider": BLOCK})
    code, text, _ = run("simulate", mech.path, "--duration", "1", "--at", "s=2.5",
                        "--speed", "s=1")
    assert code == 0 and "'crank' would have to become infinitely fast" in " ".join(text.split())
