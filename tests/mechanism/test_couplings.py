"""Couplings of any number of coordinates, and by functions."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
from derivative_cases import check

import spatial_pin as sp

ROUND = {"rtol": 1e-12, "atol": 1e-12}


def shafts(closures, *, moments=(0.01, 0.05, 0.03), slide=False, drivers=("sun", "ring"),
           names=("sun", "ring", "carrier")) -> sp.Mechanism:
    """Shafts on one line, the last a slide if wanted."""
    model = pin.Model()
    model.name = "train"
    for k, (name, moment) in enumerate(zip(names, moments, strict=True)):
        last = slide and name == names[-1]
        joint = model.addJoint(
            0, pin.JointModelPX() if last else pin.JointModelRZ(),
            pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1 * k])), name)
        model.appendBodyToJoint(
            joint, pin.Inertia(2.0, np.zeros(3), moment * np.eye(3)), pin.SE3.Identity())
    return sp.Mechanism.from_model(model, closures, drivers=list(drivers))


def planetary() -> sp.Mechanism:
    return shafts([sp.closures.coupling(joints=["sun", "ring", "carrier"], ratios=[20, 60, -80],
                                        name="willis")])


def test_shafts_of_a_planetary_train_turn_by_willis_equation():
    mech = planetary()
    state = sp.assemble(mech, {"sun": 31.0, "ring": 0.4})
    state = sp.solve_rates(mech, state, {"sun": 3.0, "ring": -1.0}, {"sun": 1.0, "ring": 2.0})
    found = state.coordinate("carrier")
    np.testing.assert_allclose(found, [(20 * x + 60 * y) / 80 for x, y in (
        (31.0, 0.4), (3.0, -1.0), (1.0, 2.0))], **ROUND)
    motion = sp.follow(mech, {"sun": np.linspace(0.0, 100.0, 50), "ring": np.linspace(0, -40, 50)})
    np.testing.assert_allclose(motion.coordinate("carrier").value, np.linspace(0, -5, 50), **ROUND)


def test_torques_of_a_planetary_train_are_those_of_virtual_power():
    mech = planetary()
    state = sp.assemble(mech, {"sun": 0.3, "ring": 0.4})
    state = sp.solve_rates(mech, state, {"sun": 3.0, "ring": -1.0}, {"sun": 1.0, "ring": 2.0})
    at_carrier = 0.03 * (20 * 1.0 + 60 * 2.0) / 80
    efforts = sp.inverse_dynamics(mech, state).efforts
    np.testing.assert_allclose([efforts["sun"], efforts["ring"]], [
        0.01 * 1.0 + at_carrier * 20 / 80, 0.05 * 2.0 + at_carrier * 60 / 80], **ROUND)
    forward = sp.forward_dynamics(mech, state, efforts)
    np.testing.assert_allclose(forward.a, [1.0, 2.0, 140 / 80], **ROUND)
    check(mech, state, {"sun": 0.3, "ring": 0.2}, 3e-3, 1e-9)


def test_a_differential_halves_torques_and_adds_speeds():
    """Left + right = 2 cage; without inertia of the cage both wheels have the same torque."""
    mech = shafts([sp.closures.coupling(joints=["left", "right", "cage"], ratios=[1, 1, -2])],
                  names=("left", "right", "cage"), drivers=["cage"], moments=(0.02, 0.08, 0.001))
    state = sp.assemble(mech, {"cage": 0.0})
    found = sp.forward_dynamics(mech, state, {"cage": 1.0})
    left, right, cage = found.a
    each = 0.5 * (1.0 - 0.001 * cage)
    np.testing.assert_allclose([0.02 * left, 0.08 * right, left + right], [each, each, 2 * cage],
                               **ROUND)
    assert sp.mobility(mech).dof == 2


def test_two_joints_and_ratios_are_what_a_ratio_is():
    one = shafts([sp.closures.coupling("sun", "carrier", 0.25, 0.1)])
    two = shafts([sp.closures.coupling(joints=["sun", "carrier"], ratios=[1, -4], offset=0.4)])
    for mech in (one, two):
        state = sp.assemble(mech, {"sun": 31.0, "ring": 0.0})
        assert state.coordinate("carrier").value == pytest.approx(0.25 * 31.0 + 0.1, rel=1e-14)
        assert sp.forward_dynamics(mech, state, {"sun": 1.0}).a[2] == pytest.approx(
            0.25 / (0.01 + 0.03 / 16), rel=1e-13)


def sine(a):
    return 0.01 * np.sin(a), 0.01 * np.cos(a), -0.01 * np.sin(a), -0.01 * np.cos(a)


def quadratic(a):
    return 0.02 * a + 0.005 * a * a, 0.02 + 0.01 * a, 0.01, 0.0


FORMS = {
    "code": (sine, sine, 1e-12), "polynomial": ({"polynomial": [0, 0.02, 0.005]}, quadratic, 1e-12),
    "points": ({"points": [[x, sine(x)[0]] for x in np.linspace(0, 2 * np.pi, 361)],
                "periodic": True}, sine, 1e-10),
}
each_form = pytest.mark.parametrize("form", FORMS)


def cam(function) -> sp.Mechanism:
    return shafts([sp.closures.coupling(joints=["cam", "rod"], function=function, name="law")],
                  names=("cam", "rod"), moments=(0.01, 0.02), slide=True, drivers=["cam"])


@each_form
def test_a_function_moves_its_joint_to_the_third_derivative(form):
    function, law, accuracy = FORMS[form]
    mech = cam(function)
    motion = sp.sweep(mech, "cam", np.linspace(-2.0, 20.0, 200), speed=2.0, acceleration=0.5)
    a, rod = motion.coordinate("cam").value, motion.coordinate("rod")
    f = np.array([law(x) for x in a]).T
    np.testing.assert_allclose(rod.value, f[0], atol=accuracy)
    np.testing.assert_allclose(rod.rate, 2.0 * f[1], atol=10 * accuracy)
    np.testing.assert_allclose(rod.acceleration, 4.0 * f[2] + 0.5 * f[1], atol=500 * accuracy)
    state = sp.solve_rates(mech, sp.assemble(mech, {"cam": 1.3}), {"cam": 2.0}, {"cam": 0.5})
    jerk = sp.solve_jerks(mech, state, {"cam": 0.3}).coordinate("rod")
    _, f1, f2, f3 = law(1.3)
    assert jerk == pytest.approx(8.0 * f3 + 3.0 * f2 * 2.0 * 0.5 + f1 * 0.3, abs=2e4 * accuracy)


@each_form
def test_torques_at_a_cam_are_those_of_virtual_power(form):
    function, law, accuracy = FORMS[form]
    mech = cam(function)
    mech.model.gravity.linear = np.array([-9.81, 0.0, 0.0])
    state = sp.solve_rates(mech, sp.assemble(mech, {"cam": 1.3}), {"cam": 2.0}, {"cam": 0.5})
    _, slope, bend, _ = law(1.3)
    force = 2.0 * (4.0 * bend + 0.5 * slope + 9.81)
    assert sp.inverse_dynamics(mech, state).efforts["cam"] == pytest.approx(
        0.01 * 0.5 + slope * force, abs=10 * accuracy)
    check(mech, state, {"cam": 0.3}, 3e-3, 1e-9)
    motion = sp.simulate(mech, state, 0.5, accuracy=sp.Accuracy.named("reference"))
    assert abs(motion.energy_drift) < 1e-10
    reduced = sp.reduce(mech, ["rod"])
    assert reduced.verify().worst < 1e-9


@each_form
def test_functions_are_saved_and_pickled(tmp_path, form):
    function, law, _ = FORMS[form]
    mech = cam(function)
    if form == "code":
        with pytest.raises(sp.SpatialPinError, match="'law': its function is code"):
            mech.save(tmp_path)
        again = sp.load(mech.save(tmp_path, tabulate=360))
        once = sp.load(mech.save(tmp_path / "b", tabulate={"law": np.linspace(-1.0, 7.0, 300)}))
        assert sp.assemble(once, {"cam": 5.0}).coordinate("rod").value == pytest.approx(
            law(5.0)[0], abs=1e-12)
    else:
        again = sp.load(mech.save(tmp_path))
    for other in (again, pickle.loads(pickle.dumps(mech))):
        assert sp.assemble(other, {"cam": 5.0}).coordinate("rod").value == pytest.approx(
            law(5.0)[0], abs=1e-12)


TREE = """<robot name="train" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="ring" default="60"/><xacro:arg name="sun" default="20"/><link name="ground"/>
""" + "".join(f"""<link name="{name}_body"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{name}" type="continuous"><parent link="ground"/><child link="{name}_body"/>
<axis xyz="0 0 1"/></joint>
""" for name, izz in (("s", 0.1), ("r", 0.15), ("c", 0.2))) + "</robot>"
WILLIS = """name = "train"
tree = "train.urdf.xacro"
[drivers]
s.joint = "s"
r.joint = "r"
[[closures]]
name = "willis"
type = "coupling"
joints = ["s", "r", "c"]
"""
RATIOS = 'ratios = ["${sun}", "${ring}", "${-sun - ring}"]\n'


def written(folder, text: str) -> sp.Mechanism:
    (folder / "train.urdf.xacro").write_text(TREE)
    path = folder / "train.toml"
    path.write_text(WILLIS + text)
    return sp.load(path)


def test_ratios_are_dimensions(tmp_path):
    mech = written(tmp_path, RATIOS)
    assert mech.dimensions == {"ring": 60.0, "sun": 20.0}
    state = sp.assemble(mech, {"s": 31.0, "r": 1.0})
    assert state.coordinate("c").value == pytest.approx((20 * 31 + 60) / 80, rel=1e-14)
    other = sp.load(mech.path, sun=40.0)
    assert sp.assemble(other, {"s": 31.0, "r": 1.0}).coordinate("c").value == pytest.approx(
        (40 * 31 + 60) / 100, rel=1e-14)
    found = sp.sensitivity(mech, state, "c", ["sun", "ring"])
    assert found.derivatives["sun"] == pytest.approx(60 * 30 / 80**2, rel=1e-9)
    assert found.derivatives["ring"] == pytest.approx(20 * (1.0 - 31.0) / 80**2, rel=1e-9)


def test_a_ratio_is_designed(tmp_path):
    mech = written(tmp_path, RATIOS)
    turns = np.linspace(0.0, 2.0, 5)
    goal = sp.goals.function("c", 0.2 * turns, {"s": turns, "r": 0.0 * turns})
    found = sp.design(mech, [goal], {"sun": (10.0, 30.0)}, starts=4, seed=1)
    assert found[0].dimensions["sun"] == pytest.approx(15.0, abs=1e-6)


@pytest.mark.parametrize(("text", "words"), [
    ("ratios = [20, 60]", "ratios are 2 for 3 joints"),
    ("ratios = [20, 0, -80]", "ratios has a zero"),
    ("ratio = 2.0", "joints are 3; a coupling by a ratio has two"),
    ("ratios = [1, 2, 3]\nratio = 2.0", "ratio or ratios"),
    ("function = {polynomial = [1.0]}", "a coupling by a function has two"),
])
def test_what_is_no_coupling_is_refused_by_its_key(tmp_path, text, words):
    with pytest.raises(sp.MechanismFileError, match=words):
        written(tmp_path, text + "\n")


@pytest.mark.parametrize(("rows", "periodic", "words"), [
    ("0,0\n1,1\n1,2\n3,1\n4,0\n5,1\n", "false", "row 3 repeats a = 1"),
    ("0,0\n1,1\n0.5,2\n3,1\n4,0\n5,1\n", "false", "row 3 goes back"),
    ("0,0\n1,1\n2,2\n3,1\n4,0\n6,1\n", "true", "periodic, but the last b = 1 is not the first, 0"),
    ("0,0\n1,x\n2,2\n3,1\n4,0\n6,0\n", "true", "finite numbers are needed"),
    ("0,0\n", "false", "2 or more are needed"),
])
def test_a_table_that_is_no_function_is_refused(tmp_path, rows, periodic, words):
    (tmp_path / "cam.csv").write_text("a,b\n" + rows)
    text = WILLIS.replace('"s", "r", "c"', '"s", "c"')
    (tmp_path / "train.urdf.xacro").write_text(TREE)
    path = tmp_path / "train.toml"
    path.write_text(text + f'function = {{table = "cam.csv", periodic = {periodic}}}\n')
    with pytest.raises(sp.MechanismFileError, match=words):
        sp.load(path)


def test_a_table_is_read_by_the_rules_of_trust(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "cam.csv").write_text("0 rad, m\n" + "".join(
        f"{x},{np.sin(x)}\n" for x in np.linspace(0.0, 2 * np.pi, 121)))
    text = WILLIS.replace('"s", "r", "c"', '"s", "c"')
    (tmp_path / "a" / "train.urdf.xacro").write_text(TREE)
    path = tmp_path / "a" / "train.toml"
    path.write_text(text + 'function = {table = "../cam.csv", periodic = true}\n')
    with pytest.raises(sp.MechanismFileError, match="trust"):
        sp.load(path)
    mech = sp.load(path, trusted=True)
    state = sp.assemble(mech, {"s": 30.0, "r": 0.0})
    assert state.coordinate("c").value == pytest.approx(np.sin(30.0), abs=1e-9)
