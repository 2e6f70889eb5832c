"""Screw closures that turn many times from one value to the next."""

from dataclasses import replace

import numpy as np
import pytest
from masses import heavy
from mechanisms import closure, driver, load, sliding, turning

import spatial_pin as sp

LEAD, MASS, INERTIA, G = 0.02, 2.0, 1e-5, 9.81
TURN = 2.0 * np.pi


@pytest.fixture
def nut(tmp_path) -> sp.Mechanism:
    """A nut of 2 kg on a guide, its screw a light shaft that turns freely."""
    tree = turning("spin", "ground", "shaft") + sliding("slide", "ground", "nut")
    tree = heavy(tree, shaft=(1.0, (0, 0, 0), (0.1, 0.1, INERTIA)),
                 nut=(MASS, (0, 0, 0), (0.1, 0.1, 0.1)))
    return load(tmp_path, "nut", tree, driver("spin", "spin")
                + closure("thread", "screw", "shaft", "nut", axis=(0, 0, 1), lead=LEAD))


@pytest.mark.parametrize(("name", "values"), [
    ("spin", [0.0, 1000.0]), ("spin", [0.0, 3.2, -3.2, 500.0, -7.0]), ("slide", [0.0, 0.5, -0.5]),
    ("spin", np.linspace(0.0, 3000.0, 20))])
def test_a_screw_is_followed_over_any_number_of_turns(nut, name, values):
    motion = sp.sweep(nut, name, values)
    spin, slide = (motion.coordinate(x).value for x in ("spin", "slide"))
    np.testing.assert_allclose(slide, -LEAD * spin / TURN, rtol=0, atol=1e-12)
    np.testing.assert_allclose(spin if name == "spin" else slide, values)
    np.testing.assert_allclose(motion.angles[:, 0], -spin, atol=1e-9)


def test_what_is_too_far_is_reported_so(nut):
    with pytest.raises(sp.SpatialPinError, match="too far from the sample before"):
        sp.sweep(nut, "spin", [0.0, 1e12])


@pytest.mark.parametrize("formulation", ["independent", "projected"])
def test_a_nut_runs_down_its_screw(nut, formulation):
    """A thousand radians in a second, at constant acceleration."""
    accuracy = replace(sp.Accuracy.named("engineering"), formulation=formulation)
    motion = sp.simulate(nut, sp.assemble(nut, {"spin": 0.0}), 1.0, accuracy=accuracy,
                         times=[0.0, 0.5, 1.0])
    acceleration = MASS * G / (MASS + INERTIA * (TURN / LEAD) ** 2)
    slide, spin = motion.coordinate("slide").value, motion.coordinate("spin").value
    np.testing.assert_allclose(slide, -0.5 * acceleration * np.array([0.0, 0.25, 1.0]),
                               rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(spin, -slide * TURN / LEAD, rtol=1e-11, atol=1e-10)
    np.testing.assert_allclose(motion.angles[:, 0], -spin, rtol=1e-11, atol=1e-10)
    assert spin[-1] > 1000.0


def test_a_screw_without_lead_is_none():
    with pytest.raises(ValueError, match="lead is 0; a screw advances as it turns"):
        sp.closures.screw("nut", "spindle", 0.0)
