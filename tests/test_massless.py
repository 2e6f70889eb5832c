"""A file without any inertia: its answers say so."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pytest
from masses import heavy

import spatial_pin as sp
from spatial_pin.cli import main

SAYS = (r"mechanism 'arm': no link has a mass or a moment of inertia, so that weights are missing "
        r"from all forces and nothing is moved by {}; give the links an <inertial>")
SPRING = '[[springs]]\nname = "s"\njoint = "shoulder"\nstiffness = 5.0\n'


def arm(folder, toml="", **masses):
    tree = heavy(known.turning("shoulder", "ground", "upper", axis=(0, 1, 0))
                 + known.turning("elbow", "upper", "lower", (0.3, 0, 0), axis=(0, 1, 0)), **masses)
    return known.load(folder, "arm", tree, toml + known.driver("shoulder", "shoulder")
                      + known.driver("elbow", "elbow"))


def verbs(mech):
    state = sp.assemble(mech, {"shoulder": 0.4, "elbow": 0.3})
    motion = sp.sweep(mech, "shoulder", [0.1, 0.2])
    return {
        "inverse": lambda: sp.inverse_dynamics(mech, state),
        "forward": lambda: sp.forward_dynamics(mech, state),
        "kinetostatics": lambda: sp.kinetostatics(mech, motion),
        "simulate": lambda: sp.simulate(mech, state, 0.1),
    }


@pytest.mark.parametrize("verb", ["inverse", "forward", "kinetostatics", "simulate"])
def test_gravity_without_any_mass_is_told(verb, tmp_path):
    with pytest.warns(sp.SpatialPinWarning, match=SAYS.format("gravity")) as told:
        verbs(arm(tmp_path))[verb]()
    assert len(told) == 1 and told[0].filename == __file__


@pytest.mark.parametrize("verb", ["inverse", "kinetostatics"])
def test_springs_are_told_too(verb, tmp_path):
    with pytest.warns(sp.SpatialPinWarning, match=SAYS.format("gravity and springs")):
        verbs(arm(tmp_path, SPRING))[verb]()


@pytest.mark.parametrize(("toml", "masses"), [
    ("gravity = [0.0, 0.0, 0.0]\n", {}),
    ("", {"lower": (0.1, (0, 0, 0.1), (0.0, 0.0, 0.0))}),
    ("[joints.elbow]\narmature = 0.1\n[joints.shoulder]\narmature = 0.1\n", {}),
])
@pytest.mark.parametrize("verb", ["inverse", "kinetostatics"])
def test_nothing_is_told_where_nothing_is_missing(verb, toml, masses, tmp_path):
    verbs(arm(tmp_path, toml, **masses))[verb]()


def test_what_a_force_from_outside_needs_is_a_question_of_its_own(tmp_path):
    import pinocchio as pin

    mech = arm(tmp_path)
    state = sp.assemble(mech, {"shoulder": 0.0, "elbow": 0.0})
    found = sp.inverse_dynamics(mech, state, external={"elbow": pin.Force(
        np.array([0.0, 0.0, -2.0]), np.zeros(3))})
    assert found.efforts["shoulder"] == pytest.approx(-0.6)


@pytest.mark.filterwarnings("default")
def test_the_command_line_tells_it_in_one_line(tmp_path, capfd, monkeypatch):
    import warnings

    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    arm(tmp_path)
    assert main(["simulate", str(tmp_path / "arm.toml"), "--duration", "0.1"]) == 0
    err = capfd.readouterr().err
    assert err.startswith("spatial-pin: warning: mechanism 'arm': no link has a mass")
    assert err.count("\n") == 1
