"""A mechanism is drawn: closed as drawn, cut well, saved with its dimensions, refused clearly."""

import inspect
import math
import pickle
import re

import drawings
import numpy as np
import pinocchio as pin
import pytest
from drawings import DRAWN
from variety import each

import spatial_pin as sp

EPS = np.finfo(float).eps


def driven(mechanism, values):
    return sp.assemble(mechanism, dict(zip(mechanism.drivers, values, strict=True)))


# ---------------------------------------------------------------- as it is drawn


@pytest.mark.parametrize("name", each(DRAWN))
def test_a_drawing_is_closed_as_drawn_where_every_coordinate_is_zero(name):
    draw, freedoms, passive = DRAWN[name]
    mech = draw().mechanism()
    state = sp.assemble(mech)
    assert np.abs(state.q - mech.neutral).max() < 4 * EPS
    assert state.closure_error <= max(4 * EPS, mech.closure_resolution)
    found = sp.mobility(mech, state)
    assert (found.dof, len(found.passive)) == (freedoms, passive)
    bodies = [link for link in mech.links if re.search(rf'"{link}_mount"', mech.urdf)
              and not re.search(rf"_on_{link}|_on_|_drawn", link)]
    for body in bodies:
        turn = state.placement(body).rotation
        assert np.abs(turn - np.eye(3)).max() < 8 * EPS


def test_the_frame_of_a_body_is_that_of_the_world_whatever_is_cut():
    for keep in ((), ("C",)):
        state = sp.assemble(drawings.four_bar().mechanism(keep=keep))
        for body in ("ground", "crank", "coupler", "rocker"):
            assert np.abs(state.placement(body).homogeneous - np.eye(4)).max() < 4 * EPS
        assert np.abs(state.placement("tip").translation - [0.2, 0.2, 0.0]).max() < 4 * EPS


def test_the_order_of_the_statements_means_nothing():
    one, two = (drawings.four_bar(backwards).mechanism() for backwards in (False, True))
    assert one.tree.read_text() == two.tree.read_text()
    assert one.notices == two.notices and one.coordinates == two.coordinates


def test_a_far_drawing_is_as_exact_as_one_at_the_origin():
    places = {"A": (0, 0, 0), "B": (0, 0.125, 0), "C": (0.25, 0.25, 0), "D": (0.375, 0, 0)}
    found = []
    for site in (0.0, 2.0**20):
        d = sp.Drawing("far").body("crank").body("coupler").body("rocker").drive("A")
        ends = ("ground", "crank"), ("crank", "coupler"), ("coupler", "rocker"), ("ground",
                                                                                  "rocker")
        for (name, at), (one, two) in zip(places.items(), ends, strict=True):
            d.hinge(name, one, two, at=np.add(at, site))
        mech = d.mechanism()
        state = driven(mech, [0.5])
        found.append((mech.characteristic_length, state.coordinate("D").value))
    assert found[0] == pytest.approx(found[1], abs=1e-14)


# ---------------------------------------------------------------- against closed forms


def test_a_drawn_four_bar_moves_as_freudensteins_equation_says():
    r1, r2, r3, r4, start = 0.30, 0.10, 0.28, 0.24, 0.4
    b = np.array([r2 * math.cos(start), r2 * math.sin(start)])
    to = np.array([r1, 0.0]) - b  # c is where circles about b and the rocker's pin meet
    f = np.linalg.norm(to)
    along = (f**2 + r3**2 - r4**2) / (2 * f)
    c = b + along * to / f + math.sqrt(r3**2 - along**2) * np.array([-to[1], to[0]]) / f
    d = sp.Drawing("plane").body("crank").body("coupler").body("rocker").drive("A")
    d.hinge("A", "ground", "crank", at=(0, 0)).hinge("B", "crank", "coupler", at=b)
    d.hinge("C", "coupler", "rocker", at=c).hinge("D", "ground", "rocker", at=(r1, 0))
    motion = sp.sweep(d.mechanism(), "A", np.linspace(0.0, 2 * np.pi, 73))
    phi = start + np.linspace(0.0, 2 * np.pi, 73)
    # Freudenstein's equation
    psi = motion.coordinate("D").value + math.atan2(c[1], c[0] - r1)
    k1, k2, k3 = r1 / r2, r1 / r4, (r1**2 + r2**2 - r3**2 + r4**2) / (2 * r2 * r4)
    residual = k1 * np.cos(psi) - k2 * np.cos(phi) + k3 - np.cos(phi - psi)
    assert np.abs(residual).max() < 1e-14


def test_bennetts_loop_turns_with_its_one_freedom():
    drawn, place = drawings.bennett()
    assert np.abs(place - np.eye(4)).max() < 1e-15  # the drawing closes
    motion = sp.sweep(drawn.mechanism(), "A", np.linspace(0.0, 1.0, 21))
    theta = 0.7 + np.linspace(0.0, 1.0, 21)
    names = motion.mechanism.coordinates
    assert {"A", "B"} <= set(names)
    k = math.sin((1.1 + 0.6) / 2) / math.sin((1.1 - 0.6) / 2)
    other = 2 * np.arctan(k / np.tan(theta / 2))
    assert np.abs(motion.coordinate("B").value - (other - other[0])).max() < 1e-13


def test_planetary_gears_turn_as_willis_says():
    mech = drawings.planetary_gear().mechanism()
    state = driven(mech, [1.0])
    assert 1.0 + state.coordinate("S").value == pytest.approx(1.0 + 100 / 20, abs=1e-14)
    assert state.coordinate("P").value == pytest.approx(-100 / 40, abs=1e-14)


@pytest.mark.skipif("ratios" not in inspect.signature(sp.closures.coupling).parameters,
                    reason="couplings of three joints are not read yet")
def test_a_sun_meshes_with_planets_on_a_carrier_that_turns_about_its_axis():
    d = sp.Drawing("differential").drive("S").drive("R")
    for body in ("carrier", "sun", "planet", "ring"):
        d.body(body)
    d.hinge("C", "ground", "carrier", at=(0, 0)).hinge("S", "ground", "sun", at=(0, 0))
    d.hinge("P", "carrier", "planet", at=(0.03, 0))
    d.hinge("R", "ring", "ground", at=(0, 0), axis=(0, 0, -1))
    d.gear("sp", "S", "P", teeth=(20, 40)).gear("rp", "P", "R", teeth=(40, 100), internal=True)
    state = driven(d.mechanism(), [1.0, 0.3])
    assert state.coordinate("C").value == pytest.approx((20 * 1.0 + 100 * 0.3) / 120, abs=1e-14)


@pytest.mark.parametrize(("between", "axis", "sign"), [
    (("ground", "wheel"), (0, 0, 1), -1.0), (("wheel", "ground"), (0, 0, 1), 1.0),
    (("ground", "wheel"), (0, 0, -1), 1.0), (("wheel", "ground"), (0, 0, -1), -1.0)])
def test_gears_turn_against_each_other_however_their_hinges_are_stated(between, axis, sign):
    d = sp.Drawing("pair").body("pinion").body("wheel").drive("A")
    d.hinge("A", "ground", "pinion", at=(0, 0)).hinge("B", *between, at=(0.03, 0), axis=axis)
    state = driven(d.gear("mesh", "A", "B", teeth=(20, 40)).mechanism(), [1.0])
    assert state.coordinate("B").value == pytest.approx(0.5 * sign, abs=1e-15)
    assert state.placement("wheel").rotation[0, 1] == pytest.approx(math.sin(0.5), abs=1e-15)


def test_a_screw_advances_by_its_lead():
    d = sp.Drawing("press").body("nut").body("spindle").drive("H")
    d["lead"] = 0.01
    d.hinge("H", "ground", "spindle", at=(0, 0)).slider("N", "ground", "nut", at=(0, 0, 0.1),
                                                        axis=(0, 0, 2))
    d.screw("S", "spindle", "nut", at=(0, 0, 0.1), axis=(0, 0, 1), lead=d["lead"])
    mech = d.mechanism()
    assert "'S' (screw)" in mech.notices[0]
    state = driven(mech, [2 * np.pi])
    assert state.coordinate("N").value == pytest.approx(-0.01, abs=1e-16)
    found = sp.sensitivity(mech, state, "N", ["lead"])
    assert found.derivatives["lead"] == pytest.approx(-1.0, abs=1e-10)


def test_the_coordinate_of_a_joint_is_of_its_second_body_to_its_first():
    for between, sign in ((("ground", "arm"), 1.0), (("arm", "ground"), -1.0)):
        d = sp.Drawing("lever").body("arm").hinge("pin", *between, at=(0.1, 0), axis=(0, 0, 3))
        turn = sp.assemble(d.mechanism(), {"pin": 0.2}).placement("arm").rotation
        assert turn[1, 0] == pytest.approx(sign * math.sin(0.2), abs=1e-16)


def test_a_drawn_rssr_moves_as_the_librarys():
    library = sp.load("rssr")
    drawn = sp.assemble(library, {"crank": 0.0})
    d = sp.Drawing("rssr").body("crank").body("coupler").body("rocker").drive("crank_pin")
    d.hinge("crank_pin", "ground", "crank", at=(0, 0, 0), axis=(0, 1, 0))
    d.ball("a", "crank", "coupler", at=drawn.placement("ball_a").translation)
    d.ball("b", "coupler", "rocker", at=drawn.placement("rocker_b").translation)
    d.hinge("rocker_pin", "ground", "rocker", at=(-0.314, 0, 0), axis=(0, 0, -1))
    values = np.linspace(0.0, 2 * np.pi, 25)
    mine, theirs = (sp.sweep(mech, name, values).coordinate("rocker_pin").value
                    for mech, name in ((d.mechanism(), "crank_pin"), (library, "crank")))
    assert np.abs(mine + theirs[0] - theirs).max() < 1e-13


# ---------------------------------------------------------------- what is cut


def test_rods_are_cut_before_balls_and_balls_before_hinges():
    mech = drawings.double_wishbone().mechanism()
    assert [(c.name, c.type) for c in mech.closures] == [("u", "spherical"), ("tie", "distance")]
    assert mech.notices == (
        "a loop is cut at joint 'u' (spherical), which becomes a closure",
        "rods are closures that hold distances: tie")


def test_drivers_and_what_is_to_be_kept_are_in_the_tree():
    d = drawings.four_bar()
    for joint in "ABCD":
        assert joint in d.mechanism(keep=[joint]).coordinates
    d.drive("C", "other")
    assert {"A", "C"} <= set(d.mechanism().coordinates)


def test_joints_that_would_lose_something_stay_in_the_tree():
    d = sp.Drawing("four_bar").body("crank").body("coupler").body("rocker")
    d.hinge("A", "ground", "crank", at=(0, 0)).hinge("B", "crank", "coupler", at=(0, 0.1))
    d.hinge("C", "coupler", "rocker", at=(0.3, 0.2), lower=-1.0, upper=1.0, damping=0.1)
    d.hinge("D", "ground", "rocker", at=(0.3, 0))
    mech = d.mechanism()
    i = mech.model.idx_vs[mech.joint_id("C")]
    assert mech.model.upperPositionLimit[mech.coordinate("C").q] == 1.0
    assert mech.model.damping[i] == 0.1
    every = d.mechanism(keep=["A", "B", "D"])
    assert every.notices[-1].startswith("a closure has no coordinate, so that this does not act")


def test_a_body_on_rods_alone_floats_in_the_tree():
    mech = drawings.gough_platform().mechanism()
    assert mech.pairs == ("floating",) and len(mech.closures) == 6
    assert mech.notices[0] == ("held by rods alone, so that it floats in the tree: body 'top' "
                               "(joint 'top')")


# ---------------------------------------------------------------- dimensions


@pytest.mark.parametrize("draw", [drawings.four_bar, drawings.spherical_four_bar,
                                  lambda: drawings.gough_platform(True)])
def test_a_changed_dimension_is_the_mechanism_drawn_anew(draw):
    drawn = draw()
    before = drawn.mechanism()
    name = next(iter(before.dimensions))
    value = 1.05 * before.dimensions[name]
    changed = drawn.mechanism(**{name: value})
    drawn[name] = value
    anew = drawn.mechanism()
    assert changed.dimensions == anew.dimensions != before.dimensions
    for one, two in zip(changed.model.frames, anew.model.frames, strict=True):
        assert np.abs(one.placement.homogeneous - two.placement.homogeneous).max() < 1e-15
    for body, inertia in changed.inertias.items():
        assert inertia.isApprox(anew.inertias[body], 1e-12)


@pytest.mark.parametrize(("draw", "output"), [(drawings.four_bar, "D"),
                                              (drawings.spherical_four_bar, "D")])
def test_sensitivities_of_a_drawing_are_differences_of_drawings(draw, output):
    drawn, h = draw(), 1e-5
    mech = drawn.mechanism()
    found = sp.sensitivity(mech, driven(mech, [0.3]), output)
    for name, value in mech.dimensions.items():
        ahead, back = (driven(drawn.mechanism(**{name: value + step}), [0.3]).coordinate(
            output).value for step in (h, -h))
        assert found.derivatives[name] == pytest.approx((ahead - back) / (2 * h), abs=1e-8)


def test_numbers_of_springs_are_dimensions():
    d = drawings.four_bar()
    d["k"] = 100.0
    d.point("hook", "ground", at=(0.2, 0.3)).spring("s", "tip", "hook", stiffness=d["k"])
    mech = d.mechanism()
    state = driven(mech, [0.7])
    found = sp.sensitivity(mech, state, "A.effort", ["k"])
    h = 1e-2
    ahead, back = (sp.inverse_dynamics(there, driven(there, [0.7])).efforts["A"]
                   for there in (d.mechanism(k=100.0 + h), d.mechanism(k=100.0 - h)))
    assert found.derivatives["k"] == pytest.approx((ahead - back) / (2 * h), abs=1e-9)
    assert "k" not in found.idle


def test_the_spread_of_a_dimension_and_a_design_are_those_of_the_drawing():
    mech = drawings.four_bar().mechanism()
    state = driven(mech, [0.3])
    slope = sp.sensitivity(mech, state, "D", ["a"]).derivatives["a"]
    spread = sp.tolerance(mech, "D", {"a": 1e-5}, state, samples=100)
    assert spread.linear["D"] == pytest.approx(abs(slope) * 1e-5, rel=1e-6)
    goal = sp.goals.function("D", sp.assemble(drawings.four_bar().mechanism(b=0.31), {
        "A": 0.3}).coordinate("D").value * np.ones(1), {"A": [0.3]}, weight=None)
    found = sp.design(mech, goal, {"b": (0.28, 0.34)})
    assert found[0].dimensions["b"] == pytest.approx(0.31, abs=1e-8)


def test_symbols_are_numbers_in_arithmetic():
    d, other = sp.Drawing("d").body("a"), sp.Drawing("other")
    d["x"], d["e"], other["x"] = 0.3, 0.2, 1.0
    x, e = d["x"], d["e"]
    forms = {
        2 * x + 1 - e: 2 * 0.3 + 1 - 0.2, -x / 3: -0.1, 1 / x: 1 / 0.3, x**2: 0.09, 2**x: 2**0.3,
        3 - x: 2.7, d.sqrt(x): 0.3**0.5, np.sin(x): math.sin(0.3), d.cos(e + x): math.cos(0.5),
        d.tan(x): math.tan(0.3), d.atan2(x, e): math.atan2(0.3, 0.2),
        x.atan2(1): math.atan2(0.3, 1),
        d.pi * x: math.pi * 0.3, x - -1.0: 1.3, (x + e) * (x - e): 0.05, +x: 0.3}
    for k, form in enumerate(forms):
        d.point(f"p{k}", "a", at=np.array([form, 0, 0]))
    mech = d.hinge("pin", "ground", "a", at=(0, 0)).mechanism()
    state = sp.assemble(mech)
    for k, value in enumerate(forms.values()):
        assert state.placement(f"p{k}").translation[0] == pytest.approx(value, abs=1e-15)
    with pytest.raises(TypeError):
        math.sin(x)
    with pytest.raises(sp.SpatialPinError, match="is a dimension of drawing 'other'"):
        x + other["x"]


# ---------------------------------------------------------------- masses and shapes


def test_bodies_have_the_masses_that_are_given_and_others_none():
    mech = drawings.four_bar().mechanism()
    assert set(mech.inertias) == {"coupler", "rocker"}
    elbow = np.array([0.1 + 0.3 * math.cos(0.5), 0.3 * math.sin(0.5), 0.0])
    for body, place in (("coupler", [0.1, 0, 0]), ("rocker", [0.35, 0, 0])):
        assert np.abs(mech.inertias[body].lever - (elbow + np.array(place)) / 2).max() < 1e-16


def test_a_bar_of_a_density_weighs_what_a_round_rod_weighs():
    d = sp.Drawing("rod", radius=0.01).body("arm", density=7850.0)
    d.hinge("pin", "ground", "arm", at=(0, 0)).point("tip", "arm", at=(0.6, 0.0, 0.8))
    inertia = d.mechanism().inertias["arm"]
    m = 7850.0 * math.pi * 0.01**2
    along = np.array([0.6, 0.0, 0.8])
    expected = m * (1 / 12 + 0.01**2 / 4) * (np.eye(3) - np.outer(along, along)) + (
        m * 0.01**2 / 2 * np.outer(along, along))
    assert inertia.mass == pytest.approx(m, rel=1e-14)
    assert np.abs(inertia.lever - along / 2).max() < 1e-16
    assert np.abs(inertia.inertia - expected).max() < 1e-15


def test_a_density_for_all_bodies_spares_those_with_a_mass():
    d = drawings.four_bar()
    light, heavy = (d.mechanism(density=x).inertias for x in (1000.0, 2000.0))
    assert heavy["crank"].mass == pytest.approx(2 * light["crank"].mass, rel=1e-14)
    assert heavy["coupler"].mass == light["coupler"].mass == 1.0


def test_every_body_is_seen():
    mech = drawings.double_wishbone().mechanism()
    seen = {mech.visual_model.geometryObjects[k].parentJoint
            for k in range(mech.visual_model.ngeoms)}
    assert seen == set(range(1, mech.model.njoints))


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("name", each(DRAWN))
def test_a_saved_drawing_loads_as_the_same_with_its_dimensions(name, tmp_path):
    mech = DRAWN[name][0]().mechanism()
    file = mech.save(tmp_path / "saved")
    assert {x.name for x in file.parent.iterdir()} == {f"{mech.name}.toml",
                                                       f"{mech.name}.urdf.xacro"}
    again = sp.load(file)
    assert again.coordinates == mech.coordinates and again.dimensions == mech.dimensions
    assert list(again.drivers) == list(mech.drivers)
    assert [(c.name, c.type, c.frames, c.geometry.length) for c in again.closures] == [
        (c.name, c.type, c.frames, c.geometry.length) for c in mech.closures]
    for one, two in zip(mech.model.frames, again.model.frames, strict=True):
        assert np.array_equal(one.placement.homogeneous, two.placement.homogeneous)


def test_a_saved_drawing_has_the_dimensions_it_was_drawn_with(tmp_path):
    drawn = drawings.four_bar()
    drawn["k"] = 3.0
    drawn.spring("s", "A", stiffness=drawn["k"])
    file = drawn.mechanism(b=0.35, k=4.0).save(tmp_path)
    again = sp.load(file)
    assert again.dimensions == {"a": 0.1, "b": 0.35, "phi": 0.5, "k": 4.0}
    assert again.springs[0].stiffness == 4.0 and sp.load(file, k=5.0).springs[0].stiffness == 5.0
    longer, drawn_longer = (driven(x, [0.3]).coordinate("D").value
                            for x in (sp.load(file, b=0.36), drawn.mechanism(b=0.36)))
    assert longer == drawn_longer


def test_the_file_of_a_drawing_is_a_mechanism_file(tmp_path):
    mech = drawings.four_bar().mechanism()
    file = tmp_path / "mine.toml"
    file.write_text(mech.path.read_text())
    loaded = sp.load(file, b=0.31)
    assert loaded.coordinates == mech.coordinates and loaded.notices == mech.notices
    assert driven(loaded, [0.3]).q.tolist() == driven(
        drawings.four_bar().mechanism(b=0.31), [0.3]).q.tolist()


def test_a_drawing_is_sent_to_other_processes_with_its_dimensions():
    mech = drawings.four_bar().mechanism(b=0.31)
    again = pickle.loads(pickle.dumps(mech))
    assert again.path.read_text() == mech.path.read_text()
    there, here = (sp.sensitivity(m, driven(m, [0.3]), "D", ["b"]).derivatives["b"]
                   for m in (again, mech))
    assert there == here


# ---------------------------------------------------------------- a point or a mass more


@pytest.mark.parametrize("name", ["rssr", "four_bar", "drawn", "made"])
def test_a_point_and_a_mass_more_go_with_the_mechanism(name, tmp_path):
    if name == "drawn":
        mech = drawings.four_bar().mechanism()
    elif name == "made":
        own = sp.load("rssr")
        mech = sp.Mechanism.from_model(own.model, own.closures, drivers=["crank_pin"],
                                       guess=own.guess, name="made")
    else:
        mech = sp.load(name)
    driver, inertia = next(iter(mech.drivers)), np.diag([0.1, 0.2, 0.25])
    more = mech.with_point("mid", "coupler", (0.01, 0.1, 0.02), (0.1, 0, 0)).with_mass(
        "coupler", 3.0, (0.1, 0.2, 0.3), inertia)
    saved = sp.load(more.save(tmp_path / "saved"))
    for there in (more, saved, pickle.loads(pickle.dumps(more))):
        state = sp.assemble(there, {driver: 0.4})
        own = state.placement("coupler")
        assert np.abs(state.placement("mid").translation
                      - own.act(np.array([0.01, 0.1, 0.02]))).max() < 1e-15
        body = there.inertias["coupler"]
        assert body.mass == 3.0 and np.array_equal(body.lever, [0.1, 0.2, 0.3])
        assert np.array_equal(body.inertia, inertia)
    assert more.dimensions == mech.dimensions and more.drivers == mech.drivers
    assert "mid" not in mech.frames and more.coordinates == mech.coordinates


def test_dimensions_move_a_point_that_was_added():
    mech = sp.load("rssr").with_point("mid", "rocker_b", (0, 0, 0.05)).with_mass("rocker", 2.0)
    state = sp.assemble(mech, {"crank": 1.0})
    found = sp.sensitivity(mech, state, "mid.position", ["b"])
    h = 1e-6
    ahead, back = (sp.assemble(sp.load("rssr", b=mech.dimensions["b"] + x).with_point(
        "mid", "rocker_b", (0, 0, 0.05)), {"crank": 1.0}).placement("mid").translation
        for x in (h, -h))
    assert np.abs(found.derivatives["b"] - (ahead - back) / (2 * h)).max() < 1e-8
    assert sp.load("rssr", b=0.4).with_point("mid", "rocker").dimensions["b"] == 0.4


def test_impossible_points_and_masses_are_refused():
    mech = sp.load("four_bar")
    for wrong, error in (
        (lambda: mech.with_point("coupler", "crank"), sp.MechanismFileError),
        (lambda: mech.with_point("mid", "copler"), sp.UnknownNameError),
        (lambda: mech.with_point("mid", "coupler", (0, math.nan, 0)), ValueError),
        (lambda: mech.with_mass("copler", 1.0), sp.UnknownNameError),
        (lambda: mech.with_mass("coupler", -1.0), sp.MechanismFileError),
        (lambda: mech.with_mass("coupler", math.inf), ValueError),
        (lambda: mech.with_mass("coupler", 1.0, inertia=[[1, 2, 0], [0, 1, 0], [0, 0, 1]]),
         sp.MechanismFileError),
    ):
        with pytest.raises(error):
            wrong()


# ---------------------------------------------------------------- refused


WRONG = {
    "joins a body that is not there": (
        lambda d: d.hinge("E", "crank", "rokcer", at=(0, 0)).mechanism(),
        r"joints\.E: between has 'rokcer', which is no body of the drawing; did you mean 'rocker'"),
    "has a body without joint": (
        lambda d: d.body("x").mechanism(), r"bodies\.x: no joint and no rod joins it"),
    "has a joint twice": (
        lambda d: d.hinge("A", "ground", "rocker", at=(0, 0)), "there is a joint 'A' already"),
    "has no direction of an axis": (
        lambda d: d.hinge("E", "crank", "rocker", at=(0, 0), axis=(0, 0, d["a"] - 0.1)).mechanism(),
        r"joints\.E: axis is zero"),
    "is not joined to the ground": (
        lambda d: d.body("x").body("y").hinge("E", "x", "y", at=(0, 0)).mechanism(),
        "nothing joins x, y to 'ground'"),
    "keeps a joint that is not there": (
        lambda d: d.mechanism(keep=["Q"]), "keep has 'Q', which is no joint of the drawing"),
    "keeps all joints of a loop": (
        lambda d: d.mechanism(keep=["A", "B", "C", "D"]), "closes a loop and would be cut"),
    "drives a joint that is not there": (
        lambda d: d.drive("Z").mechanism(), r"drivers\.Z\.joint"),
    "has a dimension that is not there": (
        lambda d: d["bb"], "there is no dimension 'bb'; did you mean 'b'"),
    "is given a dimension that is not there": (
        lambda d: d.mechanism(z=1.0), "no parameter 'z'; there are: a, b, phi"),
    "has a rod of no length": (
        lambda d: d.point("p", "ground", at=(0.2, 0.2)).rod("r", "p", "tip").mechanism(),
        "has two points at the same place"),
    "has a rod on one body": (
        lambda d: d.point("p", "coupler", at=(1, 0)).rod("r", "p", "tip").mechanism(),
        "has two points of 'coupler'"),
    "has gears without a carrier": (
        lambda d: d.gear("g", "A", "C", teeth=(10, 20)).mechanism(),
        "must have one body in common"),
    "has pins that are not square": (
        lambda d: d.body("x").universal("E", "x", "rocker", at=(0, 0), axis=(1, 0), axis2=(1, 1)
                                        ).mechanism(), "is not perpendicular to axis"),
    "has a body that stands still": (lambda d: d.body("ground"), "stands still"),
    "has two things of one name": (
        lambda d: d.point("crank", "rocker", at=(0, 0)).mechanism(),
        "two things have the name 'crank'"),
    "divides by zero": (
        lambda d: d.point("p", "rocker", at=(1 / (d["a"] - 0.1), 0)).mechanism(),
        "float division by zero"),
    "has an unknown key": (
        lambda d: d.body("x").hinge("E", "x", "rocker", at=(0, 0), dampng=1.0).mechanism(),
        "dampng is not a key of this table; did you mean 'damping'"),
    "has a dimension with the name of a function": (
        lambda d: d.__setitem__("sin", 1.0), "cannot be a dimension's name"),
    "is empty": (lambda d: sp.Drawing("x").mechanism(), "a drawing needs a body"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_drawing_is_refused_that(fault):
    wrong, words = WRONG[fault]
    with pytest.raises(sp.SpatialPinError, match=words):
        wrong(drawings.four_bar())


@pytest.mark.parametrize("wrong", [
    lambda d: d.point("p", "rocker", at=(math.nan, 0, 0)), lambda d: d.__setitem__("w", math.inf),
    lambda d: d.point("p", "rocker", at=(None, 0, 0)), lambda d: d.point("p", "rocker", at=(1,)),
    lambda d: d.mechanism(b=math.nan), lambda d: d["b"] + math.inf])
def test_numbers_of_a_drawing_are_finite(wrong):
    with pytest.raises(ValueError, match=r"finite|numbers"):
        wrong(drawings.four_bar())


def test_all_mistakes_of_a_drawing_are_told_together():
    d = drawings.four_bar().hinge("E", "crank", "roker", at=(0, 0)).point("p", "nobody", at=(0, 0))
    with pytest.raises(sp.MechanismFileError) as caught:
        d.mechanism()
    assert len(caught.value.mistakes) == 2


@pytest.mark.parametrize("keep", [(), "U"])
@pytest.mark.parametrize("turn", [np.eye(3), np.eye(3)[[2, 0, 1]], -np.eye(3)[[1, 0, 2]]])
def test_a_universal_joint_turns_as_cardan_has_it_wherever_its_pins_point(turn, keep):
    d, bend = sp.Drawing("cardan"), 0.5
    d.body("in").body("out").drive("A")
    d.hinge("A", "ground", "in", at=(0, 0), axis=turn @ [1, 0, 0])
    out = turn @ [np.cos(bend), np.sin(bend), 0]
    d.hinge("D", "ground", "out", at=(0, 0), axis=out)
    d.universal("U", "in", "out", at=(0, 0), axis=turn @ [0, 0, 1],
                axis2=turn @ [-np.sin(bend), np.cos(bend), 0])
    state = sp.assemble(d.mechanism(keep=keep), {"A": 1.0})
    assert pin.log3(state.placement("out").rotation) @ out == pytest.approx(
        np.arctan(np.tan(1.0) * np.cos(bend)), abs=1e-14)


def differential(left=(1, 0), right=(1, 0), spider=(0, 1), at=(-0.05, 0)):
    d = sp.Drawing("differential")
    d.body("cage").body("left").body("right").body("spider").drive("L").drive("C")
    d.hinge("C", "ground", "cage", at=(0, 0), axis=(1, 0))
    d.hinge("L", "ground", "left", at=at, axis=left).hinge(
        "R", "ground", "right", at=(0.05, 0), axis=right)
    d.hinge("S", "cage", "spider", at=(0, 0.05), axis=spider)
    return d.gear("one", "L", "S", teeth=(20, 10)).gear("two", "S", "R", teeth=(10, 20))


@pytest.mark.parametrize("left", [1, -1])
@pytest.mark.parametrize("right", [1, -1])
@pytest.mark.parametrize("spider", [1, -1])
def test_the_wheels_of_a_bevel_differential_turn_twice_as_far_as_its_cage(left, right, spider):
    mech = differential((left, 0), (right, 0), (0, spider)).mechanism()
    state = driven(mech, [2.0 * left, 5.0])
    assert state.coordinate("R").value == pytest.approx(8.0 * right, abs=1e-14)
    # the left wheel, slower than the cage by 3 rad, rolls on the spider at x = -0.05
    assert state.coordinate("S").value == pytest.approx(-6.0 * spider, abs=1e-14)


def test_a_bevel_gear_at_its_apex_is_refused():
    with pytest.raises(sp.MechanismFileError, match=r"gears.one: joints has 'L' where the axes"):
        differential(at=(0, 0)).mechanism()
