"""A file without any inertia: its answers say so."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pytest
from masses import heavy

import spatial_pin as sp

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
        "simulate": lambda: sp.simulate(mech, state, 0.1, times=[0.1]),
    }


@pytest.mark.parametrize("verb", ["inverse", "forward", "kinetostatics", "simulate"])
def test_gravity_without_any_mass_is_reported(verb, tmp_path):
    with pytest.warns(sp.SpatialPinWarning, match=SAYS.format("gravity")) as told:
        verbs(arm(tmp_path))[verb]()
    assert len(told) == 1 and told[0].filename == __file__


@pytest.mark.parametrize("verb", ["inverse", "kinetostatics"])
def test_springs_are_reported_too(verb, tmp_path):
    with pytest.warns(sp.SpatialPinWarning, match=SAYS.format("gravity and springs")):
        verbs(arm(tmp_path, SPRING))[verb]()


@pytest.mark.parametrize(("toml", "masses"), [
    ("gravity = [0.0, 0.0, 0.0]\n", {}),
    ("", {"lower": (0.1, (0, 0, 0.1), (0.0, 0.0, 0.0))}),
    ("[joints.elbow]\narmature = 0.1\n[joints.shoulder]\narmature = 0.1\n", {}),
])
@pytest.mark.parametrize("verb", ["inverse", "kinetostatics"])
def test_nothing_is_reported_where_nothing_is_missing(verb, toml, masses, tmp_path):
    verbs(arm(tmp_path, toml, **masses))[verb]()


def test_what_a_force_from_outside_needs_is_a_question_of_its_own(tmp_path):
    import pinocchio as pin

    mech = arm(tmp_path)
    state = sp.assemble(mech, {"shoulder": 0.0, "elbow": 0.0})
    found = sp.inverse_dynamics(mech, state, external={"elbow": pin.Force(
        np.array([0.0, 0.0, -2.0]), np.zeros(3))})
    assert found.efforts["shoulder"] == pytest.approx(-0.6)


@pytest.mark.filterwarnings("default")
def test_the_command_line_tells_it_in_one_line(tmp_path, run, monkeypatch):
    import warnings

    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    arm(tmp_path)
    code, _, err = run("simulate", tmp_path / "arm.toml", "--duration", "0.1", "--rows", "2")
    assert code == 0
    assert err.startswith("spatial-pin: warning: mechanism 'arm': no link has a mass")
    assert err.count("\n") == 1


def test_a_quarter_turn_s_cosine_is_no_inertia(tmp_path):
    """A massless slide in a slide: the file's quarter turns leave axes apart by 1e-16."""
    quarter = 'rpy="1.5707963267948966 0 3.141592653589793"'
    (tmp_path / "slides.urdf").write_text(f"""<robot name="slides"><link name="ground"/>
      <link name="carrier"/><link name="block"><inertial>
        <mass value="0.2"/><inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>
        </inertial></link>
      <joint name="outer" type="prismatic"><parent link="ground"/><child link="carrier"/>
        <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
      <joint name="inner" type="prismatic"><parent link="carrier"/><child link="block"/>
        <origin xyz="0 0 0" {quarter}/><axis xyz="1 0 0"/>
        <limit lower="-1" upper="1" effort="9" velocity="9"/></joint></robot>""")
    mechanism = sp.load(str(tmp_path / "slides.urdf"))
    state = sp.assemble(mechanism)
    assert sp.forward_dynamics(mechanism, state).a == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(sp.SingularError, match="outer, inner"):
        sp.forward_dynamics(mechanism, state, {"outer": 1.0})
