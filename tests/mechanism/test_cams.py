"""Cams and points on curves, against closed forms."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
from derivative_cases import check

import spatial_pin as sp

E, R, ROLLER = 0.01, 0.03, 0.008
CIRCLE = {"circle": {"radius": R, "centre": [E, 0.0, 0.0]}}


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def follower(curve, kind, guess=0.05, offset=0.0) -> sp.Mechanism:
    """A cam that turns about z, a follower that slides along x (beside the shaft by `offset`)."""
    model = pin.Model()
    model.name = "cam_follower"
    cam = model.addJoint(0, pin.JointModelRZ(), at(), "cam")
    rod = model.addJoint(0, pin.JointModelPX(), at(0.0, offset, 0.0), "rod")
    model.appendBodyToJoint(cam, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), at())
    model.appendBodyToJoint(rod, pin.Inertia(0.7, np.zeros(3), 0.01 * np.eye(3)), at())
    return sp.Mechanism.from_model(
        model, [sp.closures.cam("cam", "rod", curve, kind, "contact")], drivers=["cam"],
        guess={"rod": guess})


def test_a_roller_on_an_eccentric_circle_moves_as_a_slider_crank():
    mech = follower(sp.curves.circle(R, [E, 0, 0]), {"roller": ROLLER})
    turn = np.radians(50.0)
    state = sp.solve_rates(mech, sp.assemble(mech, {"cam": -turn}), {"cam": -1.0})
    found = state.coordinate("rod")
    assert found.value == pytest.approx(0.04364773089396, abs=1e-14)
    assert found.rate == pytest.approx(-0.008983404660859, abs=1e-14)
    assert found.acceleration == pytest.approx(-0.006008352858999, abs=1e-13)
    motion = sp.sweep(mech, "cam", np.linspace(-7.0, 20.0, 200), speed=3.0)
    a, length = motion.coordinate("cam").value, R + ROLLER
    root = np.sqrt(length**2 - (E * np.sin(a))**2)
    np.testing.assert_allclose(motion.coordinate("rod").value, E * np.cos(a) + root, atol=1e-14)
    s, rate, _ = motion.coordinate("contact.s")
    seen = np.unwrap(np.arctan2(-E * np.sin(a), root)) - a  # from the centre of the circle
    np.testing.assert_allclose(s - s[0], R * (seen - seen[0]), atol=1e-13)
    np.testing.assert_allclose(rate, R * 3.0 * (-E * np.cos(a) / root - 1.0), atol=1e-13)
    assert motion.output("contact.s").unit == "m"


BEAM = {0.0: (-0.26223100125846, -0.259742945279, -1.5903533181, 76.898560671),
        0.2: (-0.33608024862162, -0.420963682444, 0.064318667776, 58.715780054),
        1.0: (-0.4262686330627, 0.184210950675, 0.45354231586, 36.519285026)}


def beam() -> sp.Mechanism:
    """An elliptical cam under a flat-faced beam."""
    model = pin.Model()
    model.name = "beam"
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    model.addJoint(0, pin.JointModelRZ(), at(), "cam")
    joint = model.addJoint(0, pin.JointModelRZ(), at(2.5, 0.0, 0.0), "beam")
    inertia = 8.0 * (4.0**2 + 0.2**2) / 12.0
    model.appendBodyToJoint(joint, pin.Inertia(8.0, np.array([-1.5, 0.0, 0.0]),
                                               np.diag([0.1, inertia, inertia])), at())
    face = sp.closures.cam("cam", ("beam", at(0.0, -0.1, 0.0)), sp.curves.ellipse([1.0, 0.5]),
                           {"flat": [0.0, 1.0, 0.0]}, "contact")
    return sp.Mechanism.from_model(model, [face], drivers=["cam"], guess={"beam": -0.3})


@pytest.mark.parametrize("time", BEAM)
def test_a_flat_face_on_an_elliptical_cam(time):
    mech, speed = beam(), 0.5 * np.pi
    state = sp.solve_rates(mech, sp.assemble(mech, {"cam": speed * time}), {"cam": speed})
    angle, rate, acceleration, force = BEAM[time]
    found = state.coordinate("beam")
    assert found.value == pytest.approx(angle, abs=1e-13)
    assert found.rate == pytest.approx(rate, abs=1e-11)
    assert found.acceleration == pytest.approx(acceleration, abs=1e-9)
    loads = sp.inverse_dynamics(mech, state)
    assert np.linalg.norm(loads.reactions["contact"].linear) == pytest.approx(force, rel=1e-10)
    # virtual power: what the cam's torque does is what the beam takes up
    about = 8.0 * (4.0**2 + 0.2**2) / 12.0 + 8.0 * 1.5**2
    moment = about * acceleration - 8.0 * 9.81 * 1.5 * np.cos(angle)
    assert loads.efforts["cam"] == pytest.approx(moment * rate / speed, rel=1e-9)


CURVES = {
    "circle": (sp.curves.circle(R, [E, 0, 0]), {"roller": ROLLER}),
    "knife": (sp.curves.circle(R, [E, 0, 0]), {"knife": True}),
    "ellipse": (sp.curves.ellipse([0.04, 0.03]), {"roller": ROLLER}),
    "flat": (sp.curves.ellipse([0.04, 0.03], [0.002, 0.003, 0.0]), {"flat": [1.0, 0.0, 0.0]}),
    "points": (sp.curves.spline([[0.03 * np.cos(u) + 0.004 * np.cos(2 * u), 0.03 * np.sin(u), 0.0]
                                 for u in np.linspace(0, 2 * np.pi, 40, endpoint=False)]),
               {"roller": ROLLER}),
}
each = pytest.mark.parametrize("name", CURVES)


@each
def test_rates_and_forces_of_a_follower_are_what_differences_say(name):
    mech, h = follower(*CURVES[name]), 1e-3
    places = 1.1 + h * np.arange(-2, 3)
    states = [sp.solve_rates(mech, sp.assemble(mech, {"cam": x}), {"cam": 1.0}) for x in places]
    for key in ("rod", "contact.s"):
        rows = np.array([s.coordinate(key) for s in states])
        slope = (8 * (rows[3] - rows[1]) - (rows[4] - rows[0])) / (12 * h)
        assert rows[2, 1:] == pytest.approx(slope[:2], abs=1e-9)
    rows = [s.coordinate("rod").acceleration for s in states]
    jerk = sp.solve_jerks(mech, states[2], {"cam": 0.0}).coordinate("rod")
    assert jerk == pytest.approx((8 * (rows[3] - rows[1]) - (rows[4] - rows[0])) / (12 * h),
                                 abs=1e-8)
    check(mech, states[2], {"cam": 0.3}, 3e-4, 1e-8)


@each
def test_cams_are_saved_pickled_and_moved_in_time(tmp_path, name):
    mech = follower(*CURVES[name])
    state = sp.assemble(mech, {"cam": 2.0})
    for other in (sp.load(mech.save(tmp_path)), pickle.loads(pickle.dumps(mech))):
        again = sp.assemble(other, {"cam": 2.0})
        assert again.q == pytest.approx(state.q, abs=1e-13)
        assert again.coordinate("contact.s") == pytest.approx(state.coordinate("contact.s"),
                                                              abs=1e-13)
    moving = sp.solve_rates(mech, state, {"cam": 5.0})
    motion = sp.simulate(mech, moving, 1.0, accuracy=sp.Accuracy.named("reference"))
    assert abs(motion.energy_drift) < 1e-8 and motion.closure_error.max() < 1e-11
    assert sp.mobility(mech).dof == 1
    assert sp.reduce(mech, ["rod"]).verify().worst < 1e-9


def test_a_roller_in_a_groove_is_inside_where_the_guess_has_it():
    mech = follower(sp.curves.circle(0.05), {"roller": ROLLER}, guess=0.03)
    assert sp.assemble(mech, {"cam": 0.4}).coordinate("rod").value == pytest.approx(
        0.05 - ROLLER, abs=1e-14)


def trammel(curve, guess) -> sp.Mechanism:
    """A point that moves freely, on a curve that stands still."""
    model = pin.Model()
    model.name = "point"
    on = 0
    for name, joint in (("x", pin.JointModelPX()), ("y", pin.JointModelPY()),
                        ("z", pin.JointModelPZ())):
        on = model.addJoint(on, joint, at(), name)
    model.appendBodyToJoint(on, pin.Inertia(1.0, np.zeros(3), np.eye(3)), at())
    return sp.Mechanism.from_model(
        model, [sp.closures.point_on_curve("universe", "z", curve, "track")], drivers=["x"],
        guess=guess)


def test_a_point_goes_along_an_ellipse():
    mech = trammel(sp.curves.ellipse([1.0, 0.5], [0, 0, 0.2]), {"x": 0.1, "y": 0.4, "z": 0.1})
    state = sp.solve_rates(mech, sp.assemble(mech, {"x": 0.6}), {"x": 1.0})
    assert [state.coordinate(c).value for c in "xyz"] == pytest.approx([0.6, 0.4, 0.2], abs=1e-14)
    assert state.coordinate("y").rate == pytest.approx(-0.25 * 0.6 / 0.4, abs=1e-13)
    assert abs(state.coordinate("track.s").rate) == pytest.approx(np.hypot(1.0, 0.375), abs=1e-12)


def test_a_point_climbs_a_helix_over_many_turns():
    mech = trammel(sp.curves.helix(0.5, 0.2), {"x": 0.5, "y": 0.0, "z": 0.0})
    lifted = sp.Mechanism.from_model(mech.model, mech.closures, drivers=["z"], guess=mech.guess)
    motion = sp.sweep(lifted, "z", np.linspace(0.0, 1.0, 200), speed=1.0)
    z = motion.coordinate("z").value
    np.testing.assert_allclose(motion.coordinate("x").value, 0.5 * np.cos(10 * np.pi * z),
                               atol=1e-12)
    np.testing.assert_allclose(motion.coordinate("track.s").value,
                               z * 10 * np.pi * np.hypot(0.5, 0.2 / (2 * np.pi)), atol=1e-12)


def test_a_point_on_a_line_counts_its_way():
    mech = trammel(sp.curves.line([0.0, 1.0, 0.5], [0.6, 0.0, 0.8]), {})
    state = sp.solve_rates(mech, sp.assemble(mech, {"x": 0.3}), {"x": 1.0})
    assert state.coordinate("z").value == pytest.approx(0.9, abs=1e-14)
    assert state.coordinate("track.s")[:2] == pytest.approx((0.5, 1.0 / 0.6), abs=1e-14)


SQUARE = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]


@pytest.mark.parametrize(("points", "words"), [
    (SQUARE[:3], "four or more"), ([*SQUARE, SQUARE[0]], "at the same place"),
    ([SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]], "crosses itself|does not see"),
    ([*SQUARE[:3], [0.0, -1.0, 1.0]], "lies in a plane"),
])
def test_points_that_are_no_profile_are_refused(points, words):
    with pytest.raises(ValueError, match=words):
        sp.curves.spline(points)


@pytest.mark.parametrize(("curve", "kind", "words"), [
    (sp.curves.line([0, 0, 0], [1, 0, 0]), {"roller": 0.01}, "is closed"),
    (sp.curves.circle(0.03), {"roller": 0.01, "knife": True}, "is {roller"),
    (sp.curves.circle(0.03), {"roller": -0.01}, "roller"),
    (sp.curves.spline([[(1 + 0.2 * np.cos(3 * u)) * np.cos(u), (1 + 0.2 * np.cos(3 * u)) *
                        np.sin(u), 0] for u in np.linspace(0, 2 * np.pi, 60, endpoint=False)]),
     {"flat": [1, 0, 0]}, "hollow"),
    (sp.curves.spline([[(1 + 0.2 * np.cos(3 * u)) * np.cos(u), (1 + 0.2 * np.cos(3 * u)) *
                        np.sin(u), 0] for u in np.linspace(0, 2 * np.pi, 60, endpoint=False)]),
     {"roller": 3.0}, "undercut"),
])
def test_followers_that_do_not_fit_are_refused(curve, kind, words):
    with pytest.raises(ValueError, match=words):
        follower(curve, kind)


TREE = """<robot name="cam" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="r" default="0.03"/><xacro:arg name="e" default="0.01"/>
<link name="ground"/><link name="wheel"/><link name="rod"/>
<joint name="turn" type="continuous"><parent link="ground"/><child link="wheel"/>
<axis xyz="0 0 1"/></joint>
<joint name="lift" type="prismatic"><parent link="ground"/><child link="rod"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
CAM = """name = "cam"
tree = "cam.urdf.xacro"
drivers.cam.joint = "turn"
[curves.profile]
circle = {radius = "${r}", centre = ["${e}", 0, 0]}
[[closures]]
name = "contact"
type = "cam"
curve = "profile"
frames = ["wheel", "rod"]
follower = {roller = 0.008}
[guess]
lift = 0.05
"""


def test_radii_and_centres_of_curves_are_dimensions(tmp_path, run):
    (tmp_path / "cam.urdf.xacro").write_text(TREE)
    path = tmp_path / "cam.toml"
    path.write_text(CAM)
    mech, turn = sp.load(path), 0.7
    state = sp.assemble(mech, {"cam": turn})
    length, e = 0.038, 0.01
    root = np.sqrt(length**2 - (e * np.sin(turn))**2)
    assert state.coordinate("lift").value == pytest.approx(e * np.cos(turn) + root, abs=1e-14)
    found = sp.sensitivity(mech, state, "lift", ["r", "e"]).derivatives
    assert found["r"] == pytest.approx(length / root, rel=1e-8)
    assert found["e"] == pytest.approx(np.cos(turn) - e * np.sin(turn)**2 / root, rel=1e-8)
    code, text, _ = run("check", str(path))
    assert code == 0 and "good" in text


def test_a_curve_that_is_not_there_is_refused_by_its_name(tmp_path):
    (tmp_path / "cam.urdf.xacro").write_text(TREE)
    path = tmp_path / "cam.toml"
    path.write_text(CAM.replace('curve = "profile"', 'curve = "other"'))
    with pytest.raises(sp.MechanismFileError, match=r"names \[curves.NAME\].*profile"):
        sp.load(path)
