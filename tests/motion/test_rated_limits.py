"""Effort and velocity limits of the URDF: seen in sweeps, forces over a motion and simulations."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pytest
from loaded_library import library
from masses import heavy

import spatial_pin as sp

G = 9.81


def limited(text, name, **limits):
    """A tree with effort and velocity limits of one joint."""
    joint = text.index(f'<joint name="{name}"')
    end = text.index("</joint>", joint)
    own = text[joint:end].split("<limit")[0]
    given = {"lower": -1e3, "upper": 1e3, "effort": 0.0, "velocity": 0.0, **limits}
    tag = "<limit " + " ".join(f'{k}="{x!r}"' for k, x in given.items()) + "/>"
    return text[:joint] + own + tag + text[end:]


def pendulum(folder, **limits):
    """The angle is counted from hanging down; 0.6 kg·m about the pin, 0.26 kg·m²."""
    tree = heavy(known.turning("pin", "ground", "bob", axis=(0, -1, 0), rpy=(0, np.pi / 2, 0)),
                 bob=(1.5, (0.4, 0, 0), (0.0, 0.02, 0.02)))
    return known.load(folder, "pendulum", limited(tree, "pin", **limits),
                      known.driver("pin", "pin"))


def of_kind(motion, kind):
    return [e for e in motion.events if e.kind == kind]


def test_efforts_beyond_their_limit_are_reported(tmp_path):
    """The pin bears 1.5 g 0.4 sin(angle), and 3 N·m are allowed: from 30.6° to 149.4°."""
    mech = pendulum(tmp_path, effort=3.0)
    angles = np.radians(np.arange(0.0, 181.0))
    found = sp.kinetostatics(mech, sp.sweep(mech, "pin", angles))
    (one,) = found.beyond_limits
    weight = 1.5 * G * 0.4
    inside = np.flatnonzero(np.abs(weight * np.sin(angles)) > 3.0)
    assert np.array_equal(one.samples, inside) and one.worst == 90
    assert one.limit[:2] == ("effort limit", "pin") and one.limit.value == 3.0
    assert one.most == pytest.approx(weight) and one.by == pytest.approx(weight - 3.0)
    text = str(found)
    assert (f"beyond the effort limit 3 N·m of pin in {len(inside)} of 181 samples, first at pin = "
            f"{angles[inside[0]]:.6g} rad, by {weight - 3.0:.6g} N·m at most, at pin = 1.5708 rad"
            in text)


def test_velocities_beyond_their_limit_are_reported_for_motions_in_time(tmp_path):
    """A crank of 3 rad/s: the rocker, at 1 rad/s at most, is faster in a part of the turn."""
    toml = library("four_bar").save(tmp_path)
    tree = toml.with_suffix(".urdf")
    text = limited(tree.read_text(encoding="utf-8"), "rocker_pin", velocity=1.0)
    tree.write_text(text, encoding="utf-8")
    mech = sp.load(toml)
    values = np.linspace(0.0, 2.0 * np.pi, 73)
    motion = sp.sweep(mech, "crank", values, speed=3.0)
    rate = motion.coordinate("rocker_pin").rate
    first = int(np.flatnonzero(np.abs(rate) > 1.0)[0])
    (event,) = of_kind(motion, "velocity limit")
    assert (event.row, event.value) == (first, values[first])
    assert "velocity limit 1 rad/s of rocker_pin" in event.text
    (one,) = sp.kinetostatics(mech, motion).beyond_limits
    assert one.worst == int(np.argmax(np.abs(rate))) and one.most == rate[one.worst]
    still = sp.sweep(mech, "crank", values)
    assert not of_kind(still, "velocity limit") and not sp.kinetostatics(mech, still).beyond_limits


@pytest.mark.parametrize("formulation", ["independent", "projected"])
def test_a_falling_pendulum_passes_its_velocity_limit_when_energy_says(formulation, tmp_path):
    """0.26 w²/2 = 1.5 g 0.4 (1 - cos): on the way down, and on the way down from there again."""
    mech = pendulum(tmp_path, velocity=4.0)
    motion = sp.simulate(mech, sp.assemble(mech, {"pin": 1.5}), 2.0,
                         accuracy=sp.Accuracy(formulation=formulation))
    events = of_kind(motion, "velocity limit")
    rate = motion.coordinate("pin").rate
    outwards = np.count_nonzero((np.abs(rate[:-1]) <= 4.0) & (np.abs(rate[1:]) > 4.0))
    assert len(events) == outwards >= 2
    angle = np.arccos(np.cos(1.5) + 0.26 * 16.0 / (2 * 1.5 * G * 0.4))
    times = [e.value for e in events]
    there = sp.simulate(mech, sp.assemble(mech, {"pin": 1.5}), 2.0, times=times,
                        on_joint_limit="ignore")
    assert not there.events
    assert np.abs(there.coordinate("pin").value) == pytest.approx([angle] * len(times), abs=1e-8)
    assert np.abs(there.coordinate("pin").rate) == pytest.approx([4.0] * len(times), abs=1e-8)
    for event in events:
        assert motion.time[event.row - 1] < event.value <= motion.time[event.row]
        assert event.text.startswith("velocity limit 4 rad/s of pin passed at ")


def test_a_peak_within_a_step_is_found(tmp_path):
    """The pendulum's largest rate is one thousandth above the limit."""
    top = np.sqrt(2 * 1.5 * G * 0.4 * (1 - np.cos(0.5)) / 0.26)
    mech = pendulum(tmp_path, velocity=float(0.999 * top))
    motion = sp.simulate(mech, sp.assemble(mech, {"pin": 0.5}), 0.7)
    (event,) = of_kind(motion, "velocity limit")
    angle = motion.coordinate("pin").value[event.row]
    assert 0.0 < angle < 0.05


def test_efforts_of_drives_laws_and_constants(tmp_path):
    mech = pendulum(tmp_path, effort=2.0)
    still = sp.assemble(mech, {"pin": 0.0})
    (event,) = of_kind(sp.simulate(mech, still, 0.1, {"pin": 2.5}), "effort limit")
    assert event[:3] == ("effort limit", 0.0, 0)
    assert event.text == "beyond the effort limit 2 N·m of pin from the start"
    assert not sp.simulate(mech, still, 0.1, {"pin": 2.0}).events
    (event,) = of_kind(sp.simulate(mech, still, 0.5, lambda t, _: {"pin": 8.0 * t}),
                       "effort limit")
    assert event.value == pytest.approx(0.25, abs=1e-9)
    turning = sp.solve_rates(mech, still, {"pin": 1.0})
    motion = sp.simulate(mech, turning, 0.8, drives={"pin": sp.laws.constant_speed(0.0, 1.0)})
    (event,) = of_kind(motion, "effort limit")
    assert event.value == pytest.approx(np.arcsin(2.0 / (1.5 * G * 0.4)), abs=1e-9)


def test_limits_of_nothing_are_none(tmp_path):
    """URDF wants the attributes; 0 is what stands there where nothing is known."""
    mech = pendulum(tmp_path, effort=0.0, velocity=0.0)
    motion = sp.sweep(mech, "pin", [0.0, 1.0], speed=1e3)
    assert not motion.events and not sp.kinetostatics(mech, motion).beyond_limits
    assert not sp.simulate(mech, motion.state(0), 0.1).events
