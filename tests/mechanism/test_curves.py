"""Carriages on tracks, profiles on profiles, and splines of any form, against closed forms."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
from derivative_cases import check
from scipy.integrate import quad
from scipy.optimize import brentq

import spatial_pin as sp

TURN = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
COS, SIN = np.cos(TURN), np.sin(TURN)
E, R, ROLLER = 0.01, 0.03, 0.008


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def moved_by(*joints, name, closure, drivers, guess, com=(0.0, 0.0, 0.0), one_body=True):
    """Bodies on joints, in a chain or each on the ground: (name, model, place)."""
    model, on = pin.Model(), 0
    model.name = name
    for joint, kind, place in joints:
        i = model.addJoint(on if one_body else 0, kind, at(*place), joint)
        if not one_body:
            model.appendBodyToJoint(i, pin.Inertia(0.7, np.zeros(3), 0.01 * np.eye(3)), at())
        on = i
    if one_body:
        model.appendBodyToJoint(on, pin.Inertia(1.0, np.array(com), np.diag([0.01, 0.02, 0.03])),
                                at())
    return sp.Mechanism.from_model(model, [closure], drivers=drivers, guess=guess)


def point(curve, driver="x", **guess):
    """A point that moves freely, on a curve that stands still."""
    return moved_by(("x", pin.JointModelPX(), ()), ("y", pin.JointModelPY(), ()),
                    ("z", pin.JointModelPZ(), ()), name="point", drivers=[driver], guess=guess,
                    closure=sp.closures.point_on_curve("universe", "z", curve, "track"))


def carriage(curve, driver="x", **guess):
    """A body that moves freely, its z along a track; its centre of mass hangs below."""
    return moved_by(("x", pin.JointModelPX(), ()), ("y", pin.JointModelPY(), ()),
                    ("z", pin.JointModelPZ(), ()), ("turn", pin.JointModelSpherical(), ()),
                    name="coaster", drivers=[driver], guess=guess, com=(0.0, -0.05, 0.02),
                    closure=sp.closures.frame_on_curve("universe", "turn", curve, "track"))


def differences(mech, driver, here, keys, h=1e-3, atol=1e-9):
    """Rates, accelerations and jerks by differences of five states."""
    states = [sp.solve_rates(mech, sp.assemble(mech, {driver: x}), {driver: 1.0})
              for x in here + h * np.arange(-2, 3)]
    for key in keys:
        rows = np.array([s.coordinate(key) for s in states])
        slope = (8.0 * (rows[3] - rows[1]) - (rows[4] - rows[0])) / (12.0 * h)
        np.testing.assert_allclose(rows[2, 1:], slope[:2], atol=atol)
    rows = [s.coordinate(keys[0]).acceleration for s in states]
    jerk = sp.solve_jerks(mech, states[2], {driver: 0.0}).coordinate(keys[0])
    slope = (8.0 * (rows[3] - rows[1]) - (rows[4] - rows[0])) / (12.0 * h)
    assert jerk == pytest.approx(slope, abs=10.0 * atol)
    return states[2]


# ---------------------------------------------------------------- splines of any form


SADDLE = sp.curves.spline(np.column_stack([COS, SIN, 0.2 * np.cos(2.0 * TURN)]))
LOOP = np.linspace(0.0, 7.0, 90)  # a track with a loop that crosses over itself
COASTER = sp.curves.spline(np.column_stack([LOOP - 2.0 * np.sin(LOOP), 0.05 * LOOP,
                                            1.0 - np.cos(LOOP)]), closed=False)


def test_a_closed_spline_in_space_goes_through_its_function():
    mech = point(SADDLE, x=0.6, y=0.7, z=0.0)
    state = differences(mech, "x", 0.6, ["z", "y", "track.s"])
    assert [state.coordinate(c).value for c in "yz"] == pytest.approx(
        [0.8, 0.2 * (0.36 - 0.64)], abs=1e-8)
    assert SADDLE.length == pytest.approx(
        quad(lambda u: np.hypot(1.0, 0.4 * np.sin(2.0 * u)), 0.0, 2.0 * np.pi)[0], rel=1e-7)
    check(mech, state, {"x": 0.3}, 3e-4, 1e-8)


def test_an_open_spline_may_turn_back_and_cross_itself():
    mech = point(COASTER, driver="z", x=-0.7, y=0.05, z=0.45)
    exact = np.arccos(0.4)
    state = differences(mech, "z", 0.6, ["x", "y", "track.s"], atol=1e-8)
    assert state.coordinate("x").value == pytest.approx(exact - 2.0 * np.sin(exact), abs=1e-7)
    way = quad(lambda u: np.sqrt((1.0 - 2.0 * np.cos(u))**2 + 0.0025 + np.sin(u)**2), 0.0, exact)
    assert state.coordinate("track.s").value == pytest.approx(way[0], abs=1e-6)
    steps = [{"x": x, "y": y} for x, y in zip(*COASTER.points()[::24, :2].T, strict=True)]
    driven = sp.Mechanism.from_model(mech.model, mech.closures, drivers=["y"], guess=mech.guess)
    motion = sp.sweep(driven, "y", np.linspace(0.02, 0.33, 60))
    u = motion.coordinate("y").value / 0.05
    np.testing.assert_allclose(motion.coordinate("x").value, u - 2.0 * np.sin(u), atol=1e-6)
    assert np.all(np.diff(motion.coordinate("track.s").value) > 0.0) and steps


def test_a_track_ends_with_an_event():
    mech = point(COASTER, driver="y", x=-0.4, y=0.05, z=0.1)
    motion = sp.sweep(mech, "y", np.linspace(0.3, 0.36, 25))
    (event,) = motion.events
    assert event.kind == "end of curve" and event.value == pytest.approx(0.35, abs=1e-9)


def bean(depth=0.9):
    """A closed curve that no point sees whole: an annular sector."""
    a = np.linspace(-2.0, 2.0, 40)
    outer = np.column_stack([np.cos(a), np.sin(a)])
    cap = np.linspace(0.0, np.pi, 8)[1:-1]
    ends = [0.8 * np.array([np.cos(s), np.sin(s)]) + 0.2 * np.column_stack([
        np.cos(s + k), np.sin(s + k)]) for s, k in ((2.0, cap), (-2.0, cap + np.pi))]
    inner = 0.6 * outer[::-1]
    flat = depth * 0.05 * np.vstack([outer, ends[0], inner, ends[1]])
    return sp.curves.spline(np.column_stack([flat, np.zeros(len(flat))]))


def test_a_cam_that_no_centre_sees_whole_lifts_its_roller():
    curve = bean()
    model = pin.Model()
    for name, kind in (("cam", pin.JointModelRZ()), ("rod", pin.JointModelPX())):
        i = model.addJoint(0, kind, at(), name)
        model.appendBodyToJoint(i, pin.Inertia(0.7, np.zeros(3), 0.01 * np.eye(3)), at())
    mech = sp.Mechanism.from_model(
        model, [sp.closures.cam("cam", "rod", curve, {"roller": 0.004}, "contact")],
        drivers=["cam"], guess={"rod": 0.05})
    motion = sp.sweep(mech, "cam", np.linspace(-1.2, 1.2, 20))
    np.testing.assert_allclose(motion.coordinate("rod").value, 0.045 + 0.004, atol=2e-7)
    turned = np.column_stack([motion.coordinate("rod").value * f(motion.coordinate("cam").value)
                              for f in (np.cos, lambda x: -np.sin(x))])
    away = np.linalg.norm(turned[:, None] - curve.points()[:, :2], axis=2).min(axis=1)
    np.testing.assert_allclose(away, 0.004, atol=4e-5)  # of points of the curve, not of the curve
    differences(mech, "cam", 0.4, ["rod", "contact.s"], atol=1e-8)


# ---------------------------------------------------------------- a frame on a curve


TRACKS = {
    "circle": (sp.curves.circle(1.0), {"x": 0.3, "y": 0.9}),
    "ellipse": (sp.curves.ellipse([1.0, 0.5], [0.0, 0.1, 0.2], [0.0, 0.6, 0.8]),
                {"x": 0.3, "y": 0.4, "z": 0.1}),
    "helix": (sp.curves.helix(0.8, 0.5), {"x": 0.3, "y": 0.7, "z": 0.1}),
    "line": (sp.curves.line([0.0, 1.0, 0.5], [0.6, 0.0, 0.8]), {"x": 0.3, "y": 1.0}),
    "saddle": (SADDLE, {"x": 0.3, "y": 0.9}),
    "coaster": (COASTER, {"x": 0.2, "y": 0.15, "z": 1.9}),
}
each = pytest.mark.parametrize("name", TRACKS)


@each
def test_a_carriage_keeps_its_axis_along_the_track(name):
    curve, guess = TRACKS[name]
    mech = carriage(curve, **guess)
    assert sp.mobility(mech).dof == 2  # along the track, and about it
    state = sp.assemble(mech, {"x": 0.32})
    ahead, back = (point(curve, **guess) for _ in range(2))
    h = 1e-4
    places = [sp.assemble(m, {"x": 0.32 + k * h}).placement("z").translation
              for m, k in ((ahead, 1.0), (back, -1.0))]
    along = (places[0] - places[1]) / np.linalg.norm(places[0] - places[1])
    axis = state.placement("turn").rotation[:, 2]
    sign = np.sign(axis @ along)
    np.testing.assert_allclose(sign * axis, along, atol=1e-7)
    placed = state.placement("turn").translation
    assert curve.tangent(placed) @ axis > 0.99


@each
def test_a_carriage_that_hangs_has_rates_forces_and_jerks(name):
    """A pendulum about the tangent: mass below the track, which it swings about."""
    curve, guess = TRACKS[name]
    free = carriage(curve, **guess)
    mech = sp.Mechanism.from_model(free.model, free.closures, drivers=["x", "turn.z"],
                                   guess=free.guess)
    h = 1e-3
    drive = {"x": 1.0, "turn.z": 0.3}
    states = [sp.solve_rates(mech, sp.assemble(mech, {"x": 0.32 + k * h, "turn.z": 0.4 + 0.3 * k * h
                                                      }), drive) for k in range(-2, 3)]
    rows = np.array([s.coordinate("y") + s.coordinate("track.s") for s in states])
    slope = (8.0 * (rows[3] - rows[1]) - (rows[4] - rows[0])) / (12.0 * h)
    np.testing.assert_allclose(rows[2, [1, 2, 4, 5]], slope[[0, 1, 3, 4]], atol=1e-7)


def test_a_bead_on_a_helix_slides_by_its_slope_and_is_carried_by_it():
    """Forces: weight along the helix accelerates, across it the track bears it."""
    radius, lead = 0.8, 0.5
    helix = sp.curves.helix(radius, lead)
    mech = carriage(helix, x=radius, y=0.0, z=0.0)
    free = sp.Mechanism.from_model(mech.model, mech.closures, drivers=[], guess=mech.guess)
    model = free.model
    model.inertias[4] = pin.Inertia(1.0, np.zeros(3), 1e-6 * np.eye(3))
    state = sp.assemble(free)
    found = sp.forward_dynamics(free, state)
    rise = np.arctan2(lead / (2.0 * np.pi), radius)
    moving = sp.State(free, state.q, state.v, found.a, closure_error=0.0, angles=state.angles)
    # rotational inertia of 1e-6 kg m² over the radius squared
    sliding = moving.coordinate("track.s").acceleration
    assert sliding == pytest.approx(-9.81 * np.sin(rise), rel=1e-5)
    force = found.reactions["track"].linear
    assert np.linalg.norm(force) == pytest.approx(9.81 * np.cos(rise), rel=1e-5)


def test_energy_of_a_roller_coaster_is_kept(tmp_path):
    mech = carriage(COASTER, x=0.4, y=0.17, z=1.95)
    free = sp.Mechanism.from_model(mech.model, mech.closures, drivers=[], guess=mech.guess)
    start = sp.assemble(free)
    motion = sp.simulate(free, start, 0.8, accuracy=sp.Accuracy.named("reference"))
    assert abs(motion.energy_drift) < 1e-8 and motion.closure_error.max() < 1e-11
    again = sp.load(free.save(tmp_path))
    assert sp.assemble(again).q == pytest.approx(start.q, abs=1e-12)


def test_a_carriage_the_wrong_way_round_is_turned_or_refused():
    circle = sp.curves.circle(1.0)
    mech = carriage(circle, x=0.0, y=1.0, turn=[0.0, 0.5 * np.pi, 0.0])  # z along +x: backwards
    state = sp.assemble(mech, {"x": 0.1})
    assert circle.tangent(state.placement("turn").translation) @ state.placement(
        "turn").rotation[:, 2] > 0.0


# ---------------------------------------------------------------- a curve on a curve


def profiles(one, two, apart=None, guess=0.0):
    """A profile that turns about z and another one on a slide along x, or on a pin beside it."""
    slides = apart is None
    return moved_by(
        ("cam", pin.JointModelRZ(), ()),
        ("rod", pin.JointModelPX() if slides else pin.JointModelRZ(), () if slides else (apart,)),
        name="profiles", drivers=["cam"], guess={"rod": guess}, one_body=False,
        closure=sp.closures.curve_on_curve("cam", "rod", [one, two], "contact"))


def test_two_eccentric_circles_are_a_four_bar():
    """Their centres are as far apart as their radii: a coupler."""
    one, two, e, f, d = 0.03, 0.02, 0.01, 0.03, 0.06
    mech = profiles(sp.curves.circle(one, [e, 0, 0]), sp.curves.circle(two, [f, 0, 0]), apart=d,
                    guess=2.0)
    for turn in (0.3, 1.4, 2.5):
        state = sp.assemble(mech, {"cam": turn})

        def gap(x, turn=turn):
            return np.hypot(d + f * np.cos(x) - e * np.cos(turn),
                            f * np.sin(x) - e * np.sin(turn)) - one - two

        exact = brentq(gap, 0.5, 3.0)
        assert state.coordinate("rod").value == pytest.approx(exact, abs=1e-12)
    state = differences(mech, "cam", 1.4, ["rod", "contact.s", "contact.s2"], atol=1e-7)
    check(mech, state, {"cam": 0.3}, 3e-4, 1e-8)


def test_a_circle_is_a_roller():
    wave = 0.05 + 0.01 * np.cos(3.0 * np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False))
    u = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    cam = sp.curves.spline(np.column_stack([wave * np.cos(u), wave * np.sin(u), 0.0 * u]))
    mech = profiles(cam, sp.curves.circle(ROLLER), guess=0.07)
    roller = sp.Mechanism.from_model(mech.model, [
        sp.closures.cam("cam", "rod", cam, {"roller": ROLLER}, "contact")], drivers=["cam"],
        guess=mech.guess)
    a, b = (sp.sweep(m, "cam", np.linspace(0.0, 7.0, 40), speed=1.0) for m in (mech, roller))
    for key in ("rod", "contact.s"):
        for x, y in zip(a.coordinate(key), b.coordinate(key), strict=True):
            np.testing.assert_allclose(x, y, atol=1e-10)
    for kind in ("pressure_angle", "curvature"):
        np.testing.assert_allclose(a.output(f"contact.{kind}").values,
                                   b.output(f"contact.{kind}").values, rtol=1e-9, atol=1e-11)
    forces = [sp.kinetostatics(m, x) for m, x in ((mech, a), (roller, b))]
    np.testing.assert_allclose(*(x.output("contact.reaction.force").values for x in forces),
                               atol=1e-10)
    one, two = ([e.value for e in x.events if e.kind == "lift off"] for x in forces)
    assert one == pytest.approx(two, abs=1e-3) and one  # between samples


def test_equal_ellipses_that_turn_about_their_foci_roll_on_each_other():
    """The law of elliptical gears: tan(x/2) tan(y/2) is constant; no slip at the contact."""
    a, b = 0.04, 0.03
    c = np.sqrt(a * a - b * b)
    mech = profiles(sp.curves.ellipse([a, b], [-c, 0, 0]), sp.curves.ellipse([a, b], [-c, 0, 0]),
                    apart=2.0 * a)
    motion = sp.sweep(mech, "cam", np.linspace(-2.9, 2.9, 30), speed=1.0)
    one, two = motion.coordinate("cam").value, motion.coordinate("rod").value
    exact = -2.0 * np.arctan2((a - c) * np.sin(0.5 * one), (a + c) * np.cos(0.5 * one))
    np.testing.assert_allclose(two, exact, atol=1e-12)
    np.testing.assert_allclose(motion.coordinate("contact.s").rate,
                               -motion.coordinate("contact.s2").rate, atol=1e-12)
    assert motion.output("contact.s2").unit == "m"


def test_a_configuration_alone_tells_where_its_curves_touch():
    """Without the places along the curves, those at which the loops are closed are taken."""
    for mech in (profiles(sp.curves.ellipse([0.04, 0.03]), sp.curves.ellipse([0.02, 0.03]),
                          guess=0.07),
                 profiles(sp.curves.circle(0.03, [0.01, 0, 0]),
                          sp.curves.circle(0.02, [0.03, 0, 0]), apart=0.06, guess=2.0)):
        motion = sp.sweep(mech, "cam", np.linspace(0.0, 6.0, 25))
        known = sp.closure_jacobian(mech, motion)
        alone = [sp.closure_jacobian(mech, q) for q in motion.q]
        np.testing.assert_allclose(alone, known, atol=1e-9 * np.abs(known).max())


def test_an_ellipse_slides_on_an_ellipse_as_numbers_of_fifty_digits_have_it():
    from mpmath import cos, findroot, mp, mpf, sin

    mp.dps = 50
    mech = profiles(sp.curves.ellipse([0.04, 0.03]), sp.curves.ellipse([0.02, 0.03]), guess=0.07)
    state = sp.assemble(mech, {"cam": 0.7})
    turn = mpf(0.7)

    def sums(u, w, x):
        c, s = cos(turn), sin(turn)
        p = mpf("0.04") * cos(u), mpf("0.03") * sin(u)
        t = -mpf("0.04") * sin(u), mpf("0.03") * cos(u)
        p, t = ((c * v[0] - s * v[1], s * v[0] + c * v[1]) for v in (p, t))
        q = x + mpf("0.02") * cos(w), mpf("0.03") * sin(w)
        r = -mpf("0.02") * sin(w), mpf("0.03") * cos(w)
        return q[0] - p[0], q[1] - p[1], t[0] * r[1] - t[1] * r[0]

    exact = findroot(sums, (-0.6, 3.2, 0.06))
    assert state.coordinate("rod").value == pytest.approx(float(exact[2]), abs=1e-15)


def test_a_disc_inside_a_ring_is_inside_where_the_guess_has_it():
    mech = profiles(sp.curves.circle(0.1, [0.01, 0, 0]), sp.curves.circle(0.03), guess=0.06)
    for turn in (0.0, 0.5):
        found = sp.assemble(mech, {"cam": turn}).coordinate("rod").value
        assert found == pytest.approx(
            0.01 * np.cos(turn) + np.sqrt(0.07**2 - (0.01 * np.sin(turn))**2), abs=1e-14)


def test_profiles_go_through_files_pickles_and_time(tmp_path):
    oval = sp.curves.ellipse([0.04, 0.03])
    mech = profiles(oval, sp.curves.ellipse([0.02, 0.03]), guess=0.07)
    state = sp.assemble(mech, {"cam": 2.0})
    for other in (sp.load(mech.save(tmp_path)), pickle.loads(pickle.dumps(mech))):
        again = sp.assemble(other, {"cam": 2.0})
        assert again.q == pytest.approx(state.q, abs=1e-13)
        assert again.coordinate("contact.s2") == pytest.approx(state.coordinate("contact.s2"),
                                                               abs=1e-12)
    motion = sp.simulate(mech, sp.solve_rates(mech, state, {"cam": 5.0}), 0.5,
                         accuracy=sp.Accuracy.named("reference"))
    assert abs(motion.energy_drift) < 1e-8 and motion.closure_error.max() < 1e-11
    assert sp.mobility(mech).dof == 1
    assert sp.reduce(mech, ["rod"]).verify().worst < 1e-9


def test_profiles_lift_off_where_they_would_have_to_pull():
    """Without weight the second profile is pulled on wherever the cam falls away faster."""
    mech = profiles(sp.curves.circle(R, [E, 0, 0]), sp.curves.circle(ROLLER), guess=0.05)
    loads = sp.kinetostatics(mech, sp.sweep(mech, "cam", np.linspace(0.0, 3.0, 60), speed=10.0))
    (event,) = (e for e in loads.events if e.kind == "lift off")
    assert event.value == pytest.approx(0.0)  # the crank's dead centre outside: it is pulled back


def test_profiles_out_of_reach_of_each_other_are_no_screw():
    mech = profiles(sp.curves.circle(R, [E, 0, 0]), sp.curves.circle(ROLLER), apart=1.0)
    with pytest.raises(sp.AssemblyError, match="stays open") as refused:
        sp.assemble(mech, {"cam": 0.3})
    assert "screw" not in str(refused.value)


@pytest.mark.parametrize(("curves", "words"), [
    ([sp.curves.circle(0.1)], "two curves touch"),
    ([sp.curves.circle(0.1), sp.curves.line([0, 0, 0], [1, 0, 0])], "closed and in a plane"),
    ([sp.curves.circle(0.1), SADDLE], "closed and in a plane"),
    ([sp.curves.spline(np.column_stack([np.sin(2.0 * TURN), SIN, 0.0 * TURN])),
      sp.curves.circle(0.1)], "crosses itself"),
])
def test_profiles_that_are_none_are_refused(curves, words):
    with pytest.raises(ValueError, match=words):
        sp.closures.curve_on_curve("a", "b", curves)
