"""Third derivatives, the rate of the closed-loop Jacobian, and how well motion is transmitted."""

import closed_forms
import mechanisms
import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from mechanisms import closure, driver, floating, guess, load, point, refine, turning
from mpmath import acos, cos, diff, mp, mpf
from variety import each

import spatial_pin as sp

STENCIL = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}  # fourth-order first derivative
STEP = 3e-4


def moving(mechanism):
    """A state away from special positions, with rates, and the jerks of its drivers."""
    rng = np.random.default_rng(1)
    state = sp.assemble(mechanism)
    names = list(mechanism.drivers)
    units = [mechanism.coordinate(n).unit for n in names]
    size = np.array([1.0 if u == "rad" else mechanism.characteristic_length for u in units])
    if len(names) == 1:
        shift = {names[0]: state.coordinate(names[0]).value + 0.3 * size[0] / (5 - 4 * (
            units[0] == "rad"))}
        state = sp.assemble(mechanism, shift, state)
    speeds, accelerations, jerks = (dict(zip(names, x, strict=True))
                                    for x in rng.normal(size=(3, len(names))) * size)
    return sp.solve_rates(mechanism, state, speeds, accelerations), speeds, accelerations, jerks


def states_about(mechanism, state, speeds, accelerations, jerks):
    """Closed states a little earlier and later on the same motion."""
    for k, weight in STENCIL.items():
        t = k * STEP
        at = {n: state.coordinate(n).value + s * t + accelerations[n] * t**2 / 2
              + jerks[n] * t**3 / 6 for n, s in speeds.items()}
        q = pin.integrate(mechanism.model, state.q, state.v * t + state.a * t**2 / 2)
        near = sp.assemble(mechanism, at, sp.State(mechanism, q, closure_error=0.0,
                                                   angles=state.angles))
        yield weight / STEP, sp.solve_rates(
            mechanism, near, {n: s + accelerations[n] * t + jerks[n] * t**2 / 2
                              for n, s in speeds.items()},
            {n: a + jerks[n] * t for n, a in accelerations.items()})


def holonomic(mechanism):
    """Names of links whose placement is a function of the drivers."""
    spinning = {p.body for p in mechanism.passives}
    return [link for link in mechanism.links[1:] if link not in spinning]


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_jerks_are_derivatives_of_accelerations(name):
    mechanism = library(name)
    state, *drive = moving(mechanism)
    found = sp.solve_jerks(mechanism, state, drive[2])
    around = list(states_about(mechanism, state, *drive))
    links = holonomic(mechanism) if not sp.mobility(mechanism, state).passive else []
    for link in links or [mechanism.links[-1]]:
        differences = sum(w * s.acceleration(link).vector for w, s in around)
        scale = 1.0 + np.abs([s.acceleration(link).vector for _, s in around]).max()
        np.testing.assert_allclose(found.frame(link).vector, differences, atol=2e-7 * scale)
    for c in mechanism.coordinate_table.values():
        if c.q >= 0 and links:
            differences = sum(w * s.coordinate(c.name).acceleration for w, s in around)
            assert found.coordinate(c.name) == pytest.approx(differences, rel=1e-6, abs=2e-6)


@pytest.mark.parametrize("name", each(mechanisms.KNOWN))
def test_jerks_over_a_sweep_are_slopes_of_the_accelerations(name, tmp_path):
    """Screw closures, couplings, every pair."""
    known = mechanisms.KNOWN[name]
    mechanism = known.build(tmp_path)
    step = min(1e-3, 2e-3 * (known.values[-1] - known.values[0]))
    middle = known.values[len(known.values) // 3] + step * np.arange(-2, 3)
    motion = sp.sweep(mechanism, known.driver, middle, hold=known.hold)
    found = sp.solve_jerks(mechanism, motion.state(2), dict.fromkeys([known.driver, *known.hold],
                                                                     0.0)).j
    for c in mechanism.coordinate_table.values():
        if c.q >= 0:
            a = motion.a[:, c.v]
            slope = (a[0] - 8 * a[1] + 8 * a[3] - a[4]) / (12 * step)
            assert found[c.v] == pytest.approx(slope, rel=1e-6, abs=1e-6 * (1 + abs(a).max()))


def test_the_jerk_of_the_rssr_rocker_is_that_of_its_closed_form():
    """SEEDS B7, 40 digits."""
    def rocker(phi):
        a, b, c, d = map(mpf, ("0.102", "0.381", "0.254", "0.314"))
        return acos((b**2 - a**2 - c**2 - d**2 + 2 * a * d * cos(phi))
                    / (2 * c * (d - a * cos(phi))))

    mechanism = library("rssr")
    state = sp.assemble(mechanism, {"crank": 1.0})
    state = sp.solve_rates(mechanism, state, {"crank": 25.0}, {"crank": 100.0})
    found = sp.solve_jerks(mechanism, state, {"crank": -3000.0})
    with mp.workdps(40):
        d1, d2, d3 = (diff(rocker, 1, k) for k in (1, 2, 3))
        exact = d3 * 25**3 + 3 * d2 * 25 * 100 - 3000 * d1
    assert found.coordinate("rocker_pin") == pytest.approx(float(exact), rel=1e-12)


def test_jerks_of_a_circle():
    """A point on a crank at constant speed: jerk -speed² times its velocity."""
    mechanism = library("four_bar")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.7}), {"crank": 5.0})
    found = sp.solve_jerks(mechanism, state)
    np.testing.assert_allclose(found.frame("coupler").linear,
                               -25.0 * state.velocity("coupler").linear, atol=1e-12)
    np.testing.assert_allclose(found.com("crank"), -25.0 * state.com("crank").velocity, atol=1e-12)
    motion = sp.sweep(mechanism, "crank", [0.5, 0.7], speed=5.0)
    np.testing.assert_allclose(motion.output("coupler.jerk").values[1],
                               found.frame("coupler").linear, atol=1e-11)
    assert motion.output("rocker_pin.jerk").values[1] == pytest.approx(
        found.coordinate("rocker_pin"), rel=1e-11)


def test_rotation_vectors_have_no_jerk_of_their_own():
    mechanism = library("rssr")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism), {"crank": 1.0})
    with pytest.raises(sp.SpatialPinError, match="jerk of a frame"):
        sp.solve_jerks(mechanism, state).coordinate("ball_a.x")
    with pytest.raises(ValueError, match="jerk of 'crank'"):
        sp.solve_jerks(mechanism, state, {"crank": np.nan})


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_the_jacobian_rate_is_the_derivative_of_the_jacobian(name):
    mechanism = library(name)
    state, *drive = moving(mechanism)
    link = mechanism.links[-1]
    found = sp.jacobian_rate(mechanism, state, link)
    speeds, accelerations = (np.array(list(x.values())) for x in drive[:2])
    predicted = sp.jacobian(mechanism, state, link) @ accelerations + found @ speeds
    scale = 1.0 + np.abs(found).max()
    np.testing.assert_allclose(predicted, state.acceleration(link).vector, atol=1e-12 * scale)
    differences = sum(w * sp.jacobian(mechanism, s, link)
                      for w, s in states_about(mechanism, state, *drive))
    if not sp.mobility(mechanism, state).passive:
        np.testing.assert_allclose(found, differences, atol=1e-7 * scale)


# ---------------------------------------------------------------- transmission


def at(mechanism, **values):
    return mechanism, sp.assemble(mechanism, values)


@pytest.mark.parametrize("crank", [0.3, 1.0, 2.0, 4.5])
def test_the_transmission_angle_of_a_four_bar_follows_from_its_triangles(crank):
    r1, r2, r3, r4 = 0.30, 0.10, 0.28, 0.24
    found = sp.transmission(*at(library("four_bar"), crank=crank), "rocker_pin")
    diagonal2 = r1**2 + r2**2 - 2 * r1 * r2 * np.cos(crank)
    angle = np.arccos((r3**2 + r4**2 - diagonal2) / (2 * r3 * r4))
    assert found.angle == pytest.approx(min(angle, np.pi - angle), abs=1e-13)
    assert found.at == "output_pin"
    assert found.ratio * found.mechanical_advantage == pytest.approx(1.0)


def test_the_rod_of_a_slider_crank_leans_by_the_pressure_angle():
    mechanism = library("slider_crank")
    r, rod = mechanism.dimensions["r"], mechanism.dimensions["l"]
    found = sp.transmission(*at(mechanism, crank=1.1), "slide")
    assert np.pi / 2 - found.angle == pytest.approx(np.arcsin(r * np.sin(1.1) / rod), abs=1e-13)


def test_the_rod_of_an_rssr_pushes_along_its_line():
    mechanism, state = at(library("rssr"), crank=1.0)
    found = sp.transmission(mechanism, state, "rocker_pin")
    rod = state.placement("rocker_b").translation - state.placement("ball_a").translation
    way = sp.jacobian(mechanism, state, "rocker_b")[:3, 0]
    sine = abs(rod @ way) / np.linalg.norm(rod) / np.linalg.norm(way)
    assert np.sin(found.angle) == pytest.approx(sine, abs=1e-13)
    assert found.ratio == pytest.approx(
        sp.influence(mechanism, state).first[mechanism.coordinate("rocker_pin").v, 0], abs=1e-13)


def test_known_transmission_angles():
    swash = library("swash_plate")
    found = sp.transmission(swash, sp.assemble(swash), "slide")
    assert np.pi / 2 - found.angle == pytest.approx(swash.dimensions["tilt"], abs=1e-12)
    yoke, state = at(library("scotch_yoke"), crank=0.4)
    driven = [c for c in yoke.coordinates if c != "crank_pin" and
              abs(sp.transmission(yoke, state, c).angle - np.pi / 2) < 1e-12]
    assert driven  # the block pushes square to its slot


@pytest.mark.delicate
def test_the_transmission_angle_vanishes_where_the_crank_cannot_go_on():
    mechanism = library("four_bar", r1=0.3, r2=0.24, r3=0.1, r4=0.28)
    limit = sp.limits(mechanism, "crank").upper.value
    motion = sp.sweep(mechanism, "crank", [limit - 0.3, limit - 1e-8])
    angles = motion.output("rocker_pin.transmission_angle")
    assert angles.unit == "rad"
    assert angles.values[1] < 1e-3 < angles.values[0]


def test_advantage_is_the_inverse_of_the_ratio():
    motion = sp.sweep(library("rssr"), "crank", np.linspace(0.5, 2.5, 9), speed=3.0)
    ratio, advantage = (motion.output(f"rocker_pin.{k}").values for k in ("ratio", "advantage"))
    np.testing.assert_allclose(ratio * advantage, 1.0, rtol=1e-13)


@pytest.mark.parametrize(("name", "output", "options", "words"), [
    ("four_bar", "crank_pin", {}, "is a driver itself"),
    ("rspc", "guide.slide", {}, "one of several coordinates"),
    ("peaucellier", "lower_arm_pin", {}, "say at which it is moved: lower_outer_pin, b"),
    ("four_bar", "rocker_pin", {"at": "pin"}, "output_pin"),
    ("stewart", "slide_1", {}, "has 6 drivers"),
    ("four_bar", "rocker", {}, "rocker_pin"),
])
def test_what_has_no_transmission_angle_says_why(name, output, options, words):
    mechanism = library(name)
    with pytest.raises(sp.SpatialPinError, match=words):
        sp.transmission(mechanism, sp.assemble(mechanism), output, **options)


@pytest.mark.parametrize("held", ["knee", "knee.z"])  # a hinge; a component of a ball
def test_with_its_knee_held_a_coupler_of_two_links_is_one(tmp_path, held, run):
    """Ratio and angle of the four-bar whose coupler is as long as the knee leaves it."""
    ground, crank, first, second, rocker = 0.30, 0.10, 0.15, 0.14, 0.24
    tree = (turning("crank_pin", "ground", "crank") + turning("a", "crank", "rod", (crank, 0, 0))
            + (floating if "." in held else turning)("knee", "rod", "shin", (first, 0, 0))
            + turning("rocker_pin", "ground", "rocker", (ground, 0, 0))
            + point("b1", "shin", (second, 0, 0)) + point("b2", "rocker", (rocker, 0, 0)))
    mechanism = load(tmp_path, "kneed", tree, driver("crank", "crank_pin")
                     + closure("b", "revolute", "b1", "b2")
                     + refine("knee", "spherical") * ("." in held)
                     + guess(crank_pin=1.0, a=-0.5, rocker_pin=1.9))
    state = sp.assemble(mechanism, {"crank": 1.0, held: 0.2})
    with pytest.raises(sp.SingularError, match="knee"):
        sp.transmission(mechanism, state, "rocker_pin")
    with pytest.raises(sp.SpatialPinError, match="is held, and cannot be moved"):
        sp.transmission(mechanism, state, "rocker_pin", hold="rocker_pin")
    found = sp.transmission(mechanism, state, "rocker_pin", hold=held)
    a, b = state.placement("a").translation, state.placement("b2").translation
    assert np.linalg.norm(b - a) == pytest.approx(abs(first + second * np.exp(0.2j)), rel=1e-12)
    coupler = np.arctan2(*(b - a)[1::-1])
    turned = state.coordinate("rocker_pin").value
    ratio = crank * np.sin(1.0 - coupler) / (rocker * np.sin(turned - coupler))
    assert found.ratio == pytest.approx(ratio, rel=1e-11)
    assert found.angle == pytest.approx(abs(np.arcsin(np.sin(turned - coupler))), rel=1e-11)
    words = ["transmission", mechanism.path, "rocker_pin", "crank=1.0", "--json", "-"]
    assert run(*words)[0] == 1
    assert run(*words, "--hold", held)[0] == 0


# ---------------------------------------------------------------- dead centres


def test_dead_centres_of_a_crank_rocker_are_where_crank_and_coupler_align():
    r1, r2, r3, r4 = 0.30, 0.10, 0.28, 0.24
    motion = sp.sweep(library("four_bar"), "crank", np.linspace(0.0, 2 * np.pi, 50))
    found = sp.dead_centres(motion)
    stretched, folded = (np.arccos((r1**2 + s**2 - r4**2) / (2 * r1 * s))
                         for s in (r3 + r2, r3 - r2))
    np.testing.assert_allclose([e.value for e in found], [stretched, folded + np.pi], atol=1e-12)
    assert [e.kind for e in found] == ["dead centre"] * 2
    assert all("rocker_pin" in e.text for e in found)
    assert motion.driver[found[0].row - 1] < found[0].value < motion.driver[found[0].row]


@pytest.mark.delicate
def test_dead_centres_of_a_curve_through_limits_of_the_driver():
    """The rocker turns back where crank and coupler are in line, not where the crank does."""
    lengths = {"r1": 0.30, "r2": 0.20, "r3": 0.15, "r4": 0.20}
    mechanism = library("four_bar", **lengths)
    motion = sp.trace(mechanism, "crank", sp.assemble(mechanism, {"crank": 0.9}))
    assert [event.kind for event in motion.events] == ["limit", "limit"]
    at = np.arccos((0.30**2 + 0.35**2 - 0.20**2) / (2 * 0.30 * 0.35))
    assert [event.value for event in sp.dead_centres(motion)] == pytest.approx([-at, at], abs=1e-12)


def test_dead_centres_at_rows_are_found_once():
    motion = sp.sweep(library("slider_crank"), "crank", np.linspace(0.0, 2 * np.pi, 361))
    found = sp.dead_centres(motion, "slide")
    np.testing.assert_allclose([e.value for e in found], [0.0, np.pi, 2 * np.pi], atol=1e-12)
    assert [e.row for e in found] == [0, 180, 360]


def test_what_always_moves_one_way_has_no_dead_centre():
    motion = sp.sweep(library("hooke_joint"), "input", np.linspace(0.0, 6.0, 50))
    assert sp.dead_centres(motion) == []


@pytest.mark.delicate
def test_a_row_of_a_sweep_knows_the_error_of_its_rates_as_solve_rates_does():
    mech = library("four_bar")
    limit = sp.limits(mech, "rocker_pin").upper.value
    motion = sp.sweep(mech, "rocker_pin", limit - np.array([0.3, 1e-3, 1e-8]))
    for k in range(3):
        state = sp.solve_rates(mech, motion.state(k), {"rocker_pin": 1.0})
        assert motion.state(k).rate_error == pytest.approx(state.rate_error, rel=1e-6)
    assert motion.state(2).rate_error > 1e-9 and "rates to" in repr(motion.state(2))
    fall = sp.simulate(mech, sp.assemble(mech), 0.1, times=[0.1])
    assert np.isnan(fall.state(0).rate_error)


@pytest.mark.delicate
@pytest.mark.parametrize("gap", [1e-6, 1e-8, 1e-10])
def test_digits_lost_near_a_dead_centre_are_reported(gap):
    lengths = {"r1": 0.3, "r2": 0.24, "r3": 0.1, "r4": 0.28}
    mechanism = library("four_bar", **lengths)
    target = sp.limits(mechanism, "crank").upper.value - gap
    motion = sp.sweep(mechanism, "crank", [target - 0.3, target - 0.1, target])
    (event,) = motion.events
    assert (event.kind, event.row) == ("near limit", 2)
    assert "good to about" in event.text
    with mp.workdps(40):
        lengths = {k: mpf(repr(x)) for k, x in lengths.items()}

        def rocker(phi):
            return closed_forms.four_bar(phi, **lengths).coordinates["rocker_pin"]
        exact = float(rocker(mpf(target))), float(diff(rocker, mpf(target), h=mpf(10) ** -25))
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": target}, motion.state(2)),
                           {"crank": 1.0})
    value, rate, _ = state.coordinate("rocker_pin")
    assert abs(value - exact[0]) < 1e-10 or gap < 1e-6
    assert abs(rate / exact[1] - 1.0) < 30 * state.rate_error
    assert state.rate_error > 1e-10 and "rates to" in repr(state)
