"""Cams and points on curves, against closed forms."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
from derivative_cases import check
from scipy.integrate import quad
from scipy.optimize import brentq

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


def test_the_pressure_angle_is_that_of_the_slider_crank():
    mech = follower(sp.curves.circle(R, [E, 0, 0]), {"roller": ROLLER})
    motion = sp.sweep(mech, "cam", np.radians([-90.0, -50.0, 0.0, 50.0]))
    found = motion.output("contact.pressure_angle")
    exact = np.arcsin(E * np.sin(np.radians([90.0, 50.0, 0.0, 50.0])) / (R + ROLLER))
    np.testing.assert_allclose(found.values, exact, atol=1e-14)
    assert np.degrees(found.values[3]) == pytest.approx(11.62999093099, abs=1e-11)
    assert (found.label, found.unit) == ("contact pressure angle", "rad")
    assert motion.output("contact.curvature").values == pytest.approx(1.0 / R)
    assert not motion.output("contact.undercut").values.any()
    table = motion.quantities(["contact.pressure_angle", "contact.curvature"])
    assert [x.unit for x in table.values()][-2:] == ["rad", "1/m"]


def test_the_pressure_angle_of_a_swinging_roller_is_of_the_path_of_its_centre():
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), at(), "cam")
    arm = model.addJoint(0, pin.JointModelRZ(), at(0.06), "arm")
    model.addJoint(arm, pin.JointModelRZ(), at(0.0, 0.05), "roller")
    touch = sp.closures.cam("cam", "roller", sp.curves.circle(R, [E, 0, 0]), {"roller": ROLLER},
                            "contact")
    mech = sp.Mechanism.from_model(model, [touch], drivers=["cam", "roller"], guess={"arm": 0.6})
    motion = sp.sweep(mech, "cam", np.linspace(0.0, 6.0, 13))
    centre = motion.frame("roller").position
    turn = motion.coordinate("cam").value
    normal = centre - E * np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    along = np.cross([0.0, 0.0, 1.0], centre - [0.06, 0.0, 0.0])
    cosine = np.abs(np.vecdot(normal, along)) / np.linalg.norm(normal, axis=1) / 0.05
    np.testing.assert_allclose(np.cos(motion.output("contact.pressure_angle").values), cosine,
                               atol=1e-13)


def test_a_face_presses_along_its_path_on_the_curvature_of_its_ellipse():
    mech = follower(sp.curves.ellipse([0.04, 0.03]), {"flat": [1.0, 0.0, 0.0]})
    motion = sp.sweep(mech, "cam", np.linspace(0.0, 3.0, 7))
    np.testing.assert_allclose(motion.output("contact.pressure_angle").values, 0.0, atol=1e-14)
    turn = motion.coordinate("cam").value
    reach = np.hypot(0.04 * np.cos(turn), 0.03 * np.sin(turn))
    np.testing.assert_allclose(motion.output("contact.curvature").values,
                               reach**3 / (0.04 * 0.03)**2, rtol=1e-11)


def test_a_roller_in_a_hollow_tells_how_near_it_is_to_undercut():
    turn = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    r = 0.05 + 0.01 * np.cos(3.0 * turn)
    wave = sp.curves.spline(np.column_stack([r * np.cos(turn), r * np.sin(turn), 0.0 * turn]))
    motion = sp.sweep(follower(wave, {"roller": ROLLER}, guess=0.07), "cam",
                      np.radians([0.0, 30.0, 60.0]))
    crest, hollow = (0.06 + 0.09) / 0.06**2, (0.04 - 0.09) / 0.04**2  # (r - r'') / r^2
    found = motion.output("contact.curvature").values
    assert found[[0, 2]] == pytest.approx([crest, hollow], rel=1e-5)
    assert motion.output("contact.undercut").values[[0, 2]] == pytest.approx(
        [0.0, -ROLLER * hollow], rel=1e-5)


def test_a_helix_has_a_curvature_and_no_pressure_angle():
    mech = trammel(sp.curves.helix(0.5, 0.2), {"x": 0.5, "y": 0.0, "z": 0.0})
    lifted = sp.Mechanism.from_model(mech.model, mech.closures, drivers=["z"], guess=mech.guess)
    motion = sp.sweep(lifted, "z", [0.0, 0.1])
    bent = 0.5 / (0.5**2 + (0.2 / (2.0 * np.pi))**2)
    assert motion.output("track.curvature").values == pytest.approx(bent, rel=1e-14)
    with pytest.raises(sp.SpatialPinError, match="a pressure angle is that of a closed curve"):
        motion.output("track.pressure_angle")


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


@pytest.mark.parametrize("error", [1e-3, 1e-6, 1e-9])
def test_angles_of_interpolated_samples_are_as_exact_as_they_are(error):
    mech = trammel(sp.curves.helix(0.5, 0.2), {"x": 0.5, "y": 0.0, "z": 0.0})
    lifted = sp.Mechanism.from_model(mech.model, mech.closures, drivers=["z"], guess=mech.guess)
    values = np.linspace(0.0, 0.5, 2000)
    motion, exact = (sp.sweep(lifted, "z", values, speed=1.0, accuracy=accuracy)
                     for accuracy in (sp.Accuracy.for_error(error), None))
    assert np.abs(motion.angles - exact.angles).max() < error
    np.testing.assert_allclose(motion.coordinate("track.s").value,
                               exact.coordinate("track.s").value, atol=error)


def test_a_point_on_a_line_counts_its_way():
    mech = trammel(sp.curves.line([0.0, 1.0, 0.5], [0.6, 0.0, 0.8]), {})
    state = sp.solve_rates(mech, sp.assemble(mech, {"x": 0.3}), {"x": 1.0})
    assert state.coordinate("z").value == pytest.approx(0.9, abs=1e-14)
    assert state.coordinate("track.s")[:2] == pytest.approx((0.5, 1.0 / 0.6), abs=1e-14)


SQUARE = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]


@pytest.mark.parametrize(("points", "words"), [
    (SQUARE[:3], "four or more"), ([*SQUARE, SQUARE[0]], "at the same place"),
    ([SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]], "crosses itself"),
    ([*SQUARE[:3], [0.0, -1.0, 1.0]], "closed and in a plane"),
])
def test_points_that_are_no_profile_are_refused(points, words):
    with pytest.raises(ValueError, match=words):
        sp.closures.cam("cam", "rod", sp.curves.spline(points), {"knife": True})


@pytest.mark.parametrize(("curve", "kind", "words"), [
    (sp.curves.line([0, 0, 0], [1, 0, 0]), {"roller": 0.01}, "is closed and in a plane"),
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


def test_a_follower_without_a_spring_lifts_off_where_the_cam_slows_it_down():
    mech, speed = follower(sp.curves.circle(R, [E, 0, 0]), {"roller": ROLLER}), 3.0
    length = R + ROLLER

    def acceleration(turn):  # of a slider-crank
        root = np.sqrt(length**2 - (E * np.sin(turn))**2)
        return -E * np.cos(turn) - E**2 * np.cos(2 * turn) / root - (
            E**2 * np.sin(2 * turn) / 2.0)**2 / root**3

    exact = brentq(acceleration, np.pi, 2.0 * np.pi, xtol=1e-14)  # slowed down from here on
    motion = sp.sweep(mech, "cam", np.linspace(np.pi, 7.0, 300), speed=speed)
    (event,) = sp.kinetostatics(mech, motion).events
    assert event.kind == "lift off" and "would have to pull" in event.text
    assert event.value == pytest.approx(exact, abs=1e-8)
    assert motion.driver[event.row - 1] < event.value < motion.driver[event.row]
    start = sp.solve_rates(mech, sp.assemble(mech, {"cam": np.pi}), {"cam": speed})
    run = sp.simulate(mech, start, 1.0, drives={"cam": lambda t: (np.pi + speed * t, speed, 0.0)})
    found = [e for e in run.events if e.kind == "lift off"]
    assert [e.value for e in found] == pytest.approx([(exact - np.pi) / speed], abs=1e-9)


def test_a_heavy_beam_stays_on_its_cam_and_a_light_follower_in_a_groove_is_told_of():
    mech = beam()
    motion = sp.sweep(mech, "cam", np.linspace(0.0, 6.0, 61), speed=0.5 * np.pi)
    assert sp.kinetostatics(mech, motion).events == ()
    groove = follower(sp.curves.circle(0.05, [E, 0, 0]), {"roller": ROLLER}, guess=0.03)
    motion = sp.sweep(groove, "cam", np.linspace(2.0, 4.0, 21), speed=3.0)
    (event,) = sp.kinetostatics(groove, motion).events  # the outer wall would have to pull outwards
    assert event.row == 0 and "from the start" in event.text


def arch(t):
    """A track in space: y and z by the way along x, with their derivatives."""
    y, z = np.sin(t), 0.2 * np.cos(2.0 * t)
    return np.array([y, z]), np.array([np.cos(t), -0.4 * np.sin(2.0 * t)]), np.array(
        [-np.sin(t), -0.8 * np.cos(2.0 * t)])


def test_a_point_goes_along_an_open_spline_in_space(tmp_path):
    t = np.linspace(0.0, 2.0, 201)
    track = sp.curves.spline(np.column_stack([t, *arch(t)[0]]), closed=False)
    mech = trammel(track, {"x": 0.1, "y": 0.1, "z": 0.2})
    state = sp.solve_rates(mech, sp.assemble(mech, {"x": 1.3}), {"x": 1.0})
    place, slope, bend = arch(1.3)
    for k, name in enumerate("yz"):
        found = state.coordinate(name)
        assert found.value == pytest.approx(place[k], abs=1e-11)
        assert found.rate == pytest.approx(slope[k], abs=1e-8)
        assert found.acceleration == pytest.approx(bend[k], abs=1e-6)

    def speed(x):
        return np.sqrt(1.0 + np.square(arch(x)[1]).sum())

    s = state.coordinate("track.s")
    assert s.value == pytest.approx(quad(speed, 0.0, 1.3)[0], abs=1e-10)
    assert s.rate == pytest.approx(speed(1.3), abs=1e-9)
    assert track.length == pytest.approx(quad(speed, 0.0, 2.0)[0], abs=1e-9)
    again = sp.load(mech.save(tmp_path))
    assert sp.assemble(again, {"x": 1.3}).q == pytest.approx(state.q, abs=1e-13)
    check(mech, state, {"x": 0.3}, 3e-4, 1e-8)
    motion = sp.sweep(mech, "x", [1.2, 1.3], speed=1.0)
    first, second = np.array([1.0, *slope]), np.array([0.0, *bend])
    curvature = np.linalg.norm(np.cross(first, second)) / np.linalg.norm(first)**3
    assert motion.output("track.curvature").values[1] == pytest.approx(curvature, rel=1e-6)
    running = sp.simulate(mech, state, 0.3, accuracy=sp.Accuracy.named("reference"))
    assert abs(running.energy_drift) < 1e-8


def test_an_open_spline_may_turn_back():
    u = np.linspace(0.0, 5.0, 60)
    arc = sp.curves.spline(np.column_stack([np.cos(u), np.sin(u), 0.0 * u]), closed=False)
    mech = trammel(arc, {"x": -0.8, "y": -0.5, "z": 0.0})
    state = sp.assemble(mech, {"x": -0.8})
    assert state.coordinate("y").value == pytest.approx(-0.6, abs=1e-8)
    way = np.pi + np.arctan2(0.6, 0.8)
    assert state.coordinate("track.s").value == pytest.approx(way, abs=1e-7)


def geneva() -> sp.Mechanism:
    """A driving pin in the slot of a Geneva wheel with four of them, 1 m between the axes."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), at(), "crank")
    model.addJoint(0, pin.JointModelRZ(), at(1.0), "wheel")
    radius = np.sin(np.pi / 4.0)
    depth = 1.0 - radius  # of the bottom of the slot from the axis of the wheel
    slot = sp.curves.line([-radius, 0.0, 0.0], [1.0, 0.0, 0.0], length=radius - depth)
    return sp.Mechanism.from_model(model, [sp.closures.point_on_curve(
        "wheel", ("crank", at(radius)), slot, "slot")], drivers=["crank"])


def test_a_geneva_wheel_is_engaged_for_a_quarter_turn_of_its_crank():
    mech = geneva()
    motion = sp.sweep(mech, "crank", np.radians(np.linspace(0.0, 50.0, 101)), speed=1.0)
    ratio = motion.output("wheel.ratio").values
    assert abs(ratio[0]) == pytest.approx(2.414213562373, abs=1e-12)
    assert abs(ratio[40]) == pytest.approx(0.9613563211306, abs=1e-12)
    (event,) = [e for e in motion.events if e.kind == "end of curve"]
    assert event.value == pytest.approx(np.pi / 4.0, abs=1e-8)
    assert "slot leaves its curve at the end at 0 m" in event.text
