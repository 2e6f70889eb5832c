"""Ropes over pulleys of no size: the sum of the distances of their points is constant."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from derivative_cases import check

import spatial_pin as sp

FOCUS, LENGTH = 0.3, 1.0  # two pulleys at +-0.3 m, a rope of 1 m


def at(link: str, *xyz: float) -> tuple[str, pin.SE3]:
    return link, pin.SE3(np.eye(3), np.array(xyz))


def trammel(order: float = 0.0) -> sp.Mechanism:
    """A load that slides on a bar, which turns about the middle of two pulleys."""
    model = pin.Model()
    model.name = "trammel"
    bar = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "bar")
    load = model.addJoint(bar, pin.JointModelPX(), pin.SE3.Identity(), "load")
    model.appendBodyToJoint(bar, pin.Inertia(0.5, np.zeros(3), 0.01 * np.eye(3)),
                            pin.SE3.Identity())
    model.appendBodyToJoint(load, pin.Inertia(2.0, np.zeros(3), 0.02 * np.eye(3)),
                            pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    rope = sp.closures.rope([at("universe", -FOCUS, 0.0, 0.0), at("load", 0.0, 0.0, 0.0),
                             at("universe", FOCUS, 0.0, 0.0)], LENGTH, "rope")
    return sp.Mechanism.from_model(model, [rope], drivers=["bar"], guess={"load": 0.5})


def radius(turn):
    """Distance from the centre of the ellipse with these foci, by the angle from its long axis."""
    a, c = 0.5 * LENGTH, FOCUS
    b = np.sqrt(a * a - c * c)
    return b / np.sqrt(1.0 - (c / a * np.cos(turn)) ** 2)


def test_a_rope_over_two_pulleys_leads_its_load_along_an_ellipse():
    mech = trammel()
    turns = np.linspace(0.2, 14.0, 141)
    motion = sp.sweep(mech, "bar", turns, speed=2.0)
    found = motion.coordinate("load")
    np.testing.assert_allclose(found.value, radius(turns), atol=1e-14)
    h = 1e-4
    slope = (8 * (radius(turns + h) - radius(turns - h))
             - (radius(turns + 2 * h) - radius(turns - 2 * h))) / (12 * h)
    np.testing.assert_allclose(found.rate, 2.0 * slope, atol=1e-11)
    around = [sp.solve_rates(mech, sp.assemble(mech, {"bar": 1.1 + s * h}), {"bar": 2.0})
              for s in (-2, -1, 1, 2)]
    rates = [s.coordinate("load").rate for s in around]
    state = sp.solve_rates(mech, sp.assemble(mech, {"bar": 1.1}), {"bar": 2.0})
    assert state.coordinate("load").acceleration == pytest.approx(
        2.0 * (8 * (rates[2] - rates[1]) - (rates[3] - rates[0])) / (12 * h), abs=1e-10)
    accelerations = [s.coordinate("load").acceleration for s in around]
    jerk = 2.0 * (8 * (accelerations[2] - accelerations[1])
                  - (accelerations[3] - accelerations[0])) / (12 * h)
    found = sp.solve_jerks(mech, state, {"bar": 0.0}).coordinate("load")
    assert found == pytest.approx(jerk, abs=1e-9)


def test_the_pull_of_a_rope_is_the_same_in_all_its_parts():
    mech = trammel()
    state = sp.assemble(mech, {"bar": 0.5 * np.pi})  # the load hangs above the middle
    found = sp.inverse_dynamics(mech, state)
    height = radius(0.5 * np.pi)
    pull = -found.reactions["rope"].linear  # of the first part
    tension = 0.5 * 2.0 * 9.81 / (height / (0.5 * LENGTH))
    assert np.linalg.norm(pull) == pytest.approx(tension, rel=1e-12)
    check(mech, sp.solve_rates(mech, state, {"bar": 1.3}), {"bar": 0.3}, 3e-3, 1e-9)


def test_a_block_and_tackle_lifts_by_its_parts(tmp_path):
    """Frames may come again: the hook hangs on four parts of the rope."""
    model = pin.Model()
    model.name = "tackle"
    down = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0]))
    for name, place in (("hook", down), ("end", pin.SE3.Identity())):
        joint = model.addJoint(0, pin.JointModelPZ(), place, name)
        model.appendBodyToJoint(joint, pin.Inertia(3.0, np.zeros(3), 0.1 * np.eye(3)),
                                pin.SE3.Identity())
    top, hook = at("universe", 0.0, 0.0, 1.0), at("hook", 0.0, 0.0, 0.0)
    frames = [top, hook, top, hook, top, at("end", 0.0, 0.0, 0.0)]
    mech = sp.Mechanism.from_model(model, [sp.closures.rope(frames, 9.0, "rope")], drivers=["end"])
    again = sp.load(mech.save(tmp_path))
    for one in (mech, again):
        state = sp.assemble(one, {"end": -0.4})
        assert state.coordinate("hook").value == pytest.approx(0.1, abs=1e-14)
        found = sp.forward_dynamics(one, state)
        assert found.a[0] == pytest.approx(-found.a[1] / 4, rel=1e-12)
        # 3 a + tension (1, 4) = weight: virtual work of end and hook
        assert found.a[1] == pytest.approx(-9.81 * (1 - 1 / 4) / (1 + 1 / 16), rel=1e-12)
    assert sp.mobility(mech).dof == 1
    reduced = sp.reduce(mech, ["hook"])
    assert reduced.verify().worst < 1e-9
    motion = sp.simulate(mech, sp.assemble(mech, {"end": -0.4}), 0.1,
                         accuracy=sp.Accuracy.named("reference"))
    assert abs(motion.energy_drift) < 1e-9


ROPE = """name = "rope"
tree = "rope.urdf"
[[closures]]
name = "rope"
type = "rope"
"""
TREE = """<robot name="rope"><link name="ground"/><link name="one"/><link name="two"/>
<joint name="a" type="prismatic"><parent link="ground"/><child link="one"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="b" type="fixed"><parent link="one"/><child link="two"/></joint></robot>"""


@pytest.mark.parametrize(("text", "words"), [
    ('frames = ["ground", "one"]\nlength = -1.0', "length is -1.0 m; it must be positive"),
    ('frames = ["ground"]\nlength = 1.0', "must be a list of two or more names"),
    ('frames = ["ground", "one", "two"]\nlength = 1.0', "'one' and 'two' are at the same place"),
    ('frames = ["one", "two"]\nlength = 1.0', "are at the same place"),
    ('frames = ["ground", "one"]', "length is missing"),
])
def test_what_is_no_rope_is_refused(tmp_path, text, words):
    (tmp_path / "rope.urdf").write_text(TREE)
    path = tmp_path / "rope.toml"
    path.write_text(ROPE + text + "\n")
    with pytest.raises(sp.MechanismFileError, match=words):
        sp.load(path)
