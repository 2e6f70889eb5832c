"""Without a speed a motion has no time, and its forces are those at rest."""

from __future__ import annotations

import re

import mechanisms as known
import numpy as np
import pytest
from images import data_of, page
from masses import heavy

import spatial_pin as sp

G = 9.81


def boom(folder):
    """A boom that a slide lifts, a mass at its end: it would be thrown about at 1 m/s."""
    tree = heavy(known.turning("hinge", "ground", "boom", axis=(0, -1, 0))
                 + known.turning("foot", "ground", "barrel", (0.1, 0, -0.2), axis=(0, -1, 0))
                 + known.sliding("ram", "barrel", "rod", axis=(1, 0, 0)),
                 boom=(30.0, (0.6, 0, 0), (0.1, 0.9, 0.9)), rod=(2.0, (-0.1, 0, 0), (0.1,) * 3))
    tree += known.point("eye", "boom", (0.4, 0, 0.0)) + known.point("end", "rod")
    toml = (known.closure("head", "revolute", "eye", "end", axis=[0.0, 1.0, 0.0])
            + known.driver("ram", "ram"))
    toml += "\n[guess]\nhinge = 0.5\nfoot = 0.9\nram = 0.4\n"
    return known.load(folder, "boom", tree, toml)


@pytest.fixture
def lifted(tmp_path):
    return sp.sweep(boom(tmp_path), "ram", np.linspace(0.4, 0.5, 9))


def test_rates_are_those_per_unit_of_the_driver(lifted):
    timed = sp.sweep(lifted.mechanism, "ram", lifted.driver, speed=1.0)
    assert lifted.time is None and timed.time is not None
    assert (lifted.per, timed.per) == ("m", "s")
    for name in ("q", "v", "a", "driver_speed"):
        assert np.array_equal(getattr(lifted, name), getattr(timed, name))
    back = sp.sweep(lifted.mechanism, "ram", lifted.driver[::-1])
    assert back.v[::-1] == pytest.approx(lifted.v, rel=1e-9) and np.all(back.driver_speed == 1.0)
    assert lifted.output("hinge.ratio").values == pytest.approx(lifted.coordinate("hinge")[1])


def test_forces_are_those_at_rest(lifted):
    """By virtual work: the ram does what gravity takes, and that is less than moving it."""
    found = sp.kinetostatics(lifted.mechanism, lifted)
    height = sum(m * lifted.com(x).velocity[:, 2] for x, m in (("boom", 30.0), ("rod", 2.0)))
    assert found.efforts["ram"] == pytest.approx(G * height, rel=1e-10)
    assert np.all(found.power["ram"] == 0.0)
    assert found.on_ground[:, :3] == pytest.approx(np.array([[0.0, 0.0, -32.0 * G]] * 9), abs=1e-9)
    assert "efforts at rest, for the motion has no speed" in str(found)
    timed = sp.kinetostatics(lifted.mechanism, sp.sweep(
        lifted.mechanism, "ram", lifted.driver, speed=1.0))
    assert np.abs(timed.efforts["ram"] / found.efforts["ram"] - 1.0).max() > 0.1
    for speed in (0.0, 1e-9):
        slow = sp.sweep(lifted.mechanism, "ram", lifted.driver, speed=speed)
        assert sp.kinetostatics(slow.mechanism, slow).efforts["ram"] == pytest.approx(
            found.efforts["ram"], rel=1e-12)


def test_forces_at_one_of_its_states_are_too(lifted):
    mech, found = lifted.mechanism, sp.kinetostatics(lifted.mechanism, lifted)
    state = lifted.state(4)
    assert np.any(state.v) and not state.in_time
    one = sp.inverse_dynamics(mech, state)
    assert one.efforts["ram"] == pytest.approx(found.efforts["ram"][4], rel=1e-12)
    assert one.power == {"ram": 0.0}
    held = sp.forward_dynamics(mech, state, one.efforts)
    assert np.abs(held.a).max() < 1e-9 and not np.any(held.state.v)
    assert sp.dynamics_derivatives(mech, state, one.efforts).a == pytest.approx(held.a, abs=1e-9)
    assert not np.any(sp.simulate(mech, state, 0.1, one.efforts, [0.0]).v)


def test_a_traced_curve_has_no_time_either():
    motion = sp.trace(sp.load("four_bar"), "crank")
    assert motion.time is None and motion.per == "length"
    found = sp.kinetostatics(motion.mechanism, motion)
    still = sp.inverse_dynamics(motion.mechanism, sp.State(
        motion.mechanism, motion.q[7], closure_error=0.0))
    assert found.efforts["crank"][7] == pytest.approx(still.efforts["crank"], rel=1e-9)


def test_tables_and_pages_show_no_time(lifted):
    names = list(lifted.columns())
    assert names[0] == "ram [m]" and not any("time" in n or "/s" in n for n in names)
    assert "hinge rate [rad/m]" in names and "ram acceleration [m/m²]" in names
    assert lifted.output("boom.velocity").unit == "m/m"
    assert "/s" not in str(lifted)
    assert [r["name"] for r in data_of(page(lifted))["readings"]] == ["ram"]


@pytest.mark.slow
def test_reports_show_no_time(lifted, tmp_path):
    report = sp.report(lifted, tmp_path / "boom.html").read_text(encoding="utf-8")
    text = re.sub(r'srcdoc="[^"]*"', "", report)
    assert "rad/s" not in text and "m/s" not in text and "Driver speed" not in text
    assert "hold every position with, at rest" in text


def test_files_keep_what_rates_are_by(lifted, tmp_path):
    path = lifted.save(tmp_path / "lifted.npz")
    again = sp.Motion.load(path, lifted.mechanism)
    assert again.per == "m" and again.time is None
    assert sp.kinetostatics(again.mechanism, again).power["ram"].tolist() == [0.0] * 9


def test_a_turn_is_shown_at_one_radian_a_second():
    motion = sp.sweep(sp.load("rssr"), "crank", np.linspace(0.0, 2 * np.pi, 61))
    text = page(motion)
    assert data_of(text)["seconds"][-1] == pytest.approx(2 * np.pi)
    assert re.findall(r"<small>(shown [^<]*)</small>", text) == ["shown at 1 rad/s"]


def test_an_acceleration_needs_a_speed(lifted):
    with pytest.raises(ValueError, match=r"acceleration is given but no speed.*speed=0\.0"):
        sp.sweep(lifted.mechanism, "ram", [0.4], acceleration=1.0)
    started = sp.sweep(lifted.mechanism, "ram", [0.4], speed=0.0, acceleration=1.0)
    assert started.per == "s" and np.any(started.a)
