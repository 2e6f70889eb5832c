"""Motions of more samples than an animation can show: pages and reports have some of them."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import spatial_pin as sp

N = 1300  # an animation shows 1201


def in_time(mechanism: sp.Mechanism) -> sp.Motion:
    """Return a motion along times, several drivers or none."""
    times = np.linspace(0.0, 2.0, N)
    return sp.follow(mechanism, {"crank": 0.4 + np.sin(times)}, times)


def of_a_target(mechanism: sp.Mechanism) -> sp.Motion:
    """Return a motion that leads a point along targets in time."""
    state = sp.assemble(mechanism, {"crank": 0.4})
    height = state.placement("coupler_b").translation[2]
    times = np.linspace(0.0, 1.0, N)
    return sp.reach_path(mechanism, {"coupler_b.position.z": height - 0.01 * times}, times, state)


def simulated(mechanism: sp.Mechanism) -> sp.Motion:
    """Return a simulation."""
    state = sp.assemble(mechanism, {"crank": 0.3})
    return sp.simulate(mechanism, state, 0.2, times=np.linspace(0.0, 0.2, N))


def swept(mechanism: sp.Mechanism) -> sp.Motion:
    """Return the sweep of one driver."""
    return sp.sweep(mechanism, "crank", np.linspace(0.0, 6.0, N), speed=2.0)


@pytest.fixture(scope="module", params=[in_time, of_a_target, simulated, swept])
def motion(request) -> sp.Motion:
    return request.param(sp.load("four_bar"))


def curves(page: str) -> dict:
    """What is drawn under the picture."""
    found = re.search(r'"curves": (\{.*?\}), "seconds"', page)
    return json.loads(found[1].replace("\\u003c", "<"))


def test_a_motion_of_any_length_has_a_page_with_its_first_and_last_sample(motion, tmp_path):
    look = sp.Look(traces=("coupler_b",), arrows=("coupler_b.velocity",), curves=("rocker_pin",))
    page = sp.export_html(motion, tmp_path / "x.html", look=look).read_text("utf-8")
    assert f"1201 of {N} rows" in page
    (panel,) = curves(page)["panels"]
    (line,) = panel["lines"]
    angle = np.rad2deg(motion.coordinate("rocker_pin").value)
    assert len(line["values"]) == 1201
    assert np.allclose([line["values"][0], line["values"][-1]], angle[[0, -1]], rtol=1e-5)


def test_a_long_simulation_has_a_report(tmp_path):
    motion = simulated(sp.load("four_bar"))
    text = sp.report(motion, tmp_path / "x.html").read_text("utf-8")
    assert "<h2>Outputs</h2>" in text and f"1201 of {N} rows" in text


def test_the_energy_of_a_long_simulation_is_drawn_at_the_samples_shown(tmp_path):
    motion = simulated(sp.load("four_bar"))
    look = sp.Look(curves=("energy", "work"))
    drawn = curves(sp.export_html(motion, tmp_path / "x.html", look=look).read_text("utf-8"))
    for panel, whole in zip(drawn["panels"], (motion.energy, motion.work), strict=True):
        (line,) = panel["lines"]
        assert len(line["values"]) == len(drawn["x"]) == 1201
        assert np.allclose(line["values"][-1], whole[-1], rtol=1e-5)


@pytest.mark.slow
def test_a_long_simulation_of_a_prescribed_driver_is_shown_with_its_forces(tmp_path):
    mechanism = sp.load("four_bar")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.3}), {"crank": 2.0})
    motion = sp.simulate(mechanism, state, 0.2, times=np.linspace(0.0, 0.2, N),
                         drives={"crank": sp.laws.constant_speed(0.3, 2.0)})
    look = sp.Look(arrows=("output_pin.reaction",))
    page = sp.export_html(motion, tmp_path / "x.html", look=look).read_text("utf-8")
    assert f"1201 of {N} rows" in page
