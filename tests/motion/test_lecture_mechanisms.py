"""Printed numbers and formulas of the EMT 2431 lecture notes, from the library's mechanisms."""

from __future__ import annotations

from functools import cache

import closed_forms
import lecture_forms
import mechanisms
import numpy as np
import pytest

import spatial_pin as sp

TOLERANCE = 1e-11
X, Y, Z = np.eye(3)


load = cache(sp.load)


def moving(name: str, values: dict, speeds: dict, accelerations: dict | None = None,
           **dimensions) -> sp.State:
    mechanism = load(name, **dimensions)
    closed = sp.assemble(mechanism, values)
    return sp.solve_rates(mechanism, closed, speeds, accelerations)


def check_printed(actual, printed: str) -> None:
    """Every component within half a unit of its last printed digit."""
    expected = np.array(printed.split(), dtype=float)
    half_digits = [0.5 * 10.0 ** -len(word.partition(".")[2]) for word in printed.split()]
    assert np.all(np.abs(np.atleast_1d(actual) - expected) <= 1.001 * np.array(half_digits)), actual


def check(actual, expected) -> None:
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert np.max(np.abs(actual - expected)) <= TOLERANCE * (1 + np.max(np.abs(expected)))


@pytest.mark.parametrize("name", [
    "crane", "crank_collar", "double_cardan", "elliptic_trammel", "hooke_joint",
    "inverted_slider_crank", "rotating_rod_link", "rssr_crossed", "satellite_dish", "screw_press",
    "swash_plate", "turntable_collar",
])
def test_library_names_its_source(name):
    assert name in sp.list_mechanisms()
    mechanism = load(name)
    assert mechanism.title
    assert mechanism.source.startswith("EMT 2431 lecture notes")


# ---------------------------------------------------------------- loops


def test_swash_plate_example_1_1():
    mechanism = load("swash_plate")
    mobility = sp.mobility(mechanism)
    assert mobility.kutzbach == mobility.dof == 2
    assert len(mobility.passive) == 1
    normal = Z - np.tan(np.radians(20)) * X
    said = str(mobility.passive[0])
    assert "slipper" in said
    # the output does not depend on the passive spin, and the slipper has none about the normal
    turn = sp.sweep(mechanism, "shaft", np.linspace(0, 2 * np.pi, 73))
    check(turn.coordinate("slide").value, 0.06 * np.tan(np.radians(20)) * np.cos(turn.driver))
    first = sp.solve_rates(mechanism, turn.state(0), {"shaft": 7.0})
    assert abs(first.angular_velocity("slipper") @ normal) < TOLERANCE


def test_inverted_slider_crank_exercise_3_6():
    speed = 30 * np.pi / 30
    state = moving("inverted_slider_crank", {"bar": np.radians(60)}, {"bar": speed})
    s, ds, dds = state.coordinate("slide")
    check_printed(s, "0.227069")
    # s² - 2 s AC cos φ + AC² = BC², differentiated twice with φ'' = 0
    c, n = 0.15 * np.cos(np.radians(60)), 0.15 * np.sin(np.radians(60))
    check(ds, -s * n * speed / (s - c))
    check(dds, -(ds**2 + 2 * ds * n * speed + s * c * speed**2) / (s - c))
    # velocity and acceleration of B by its parts along and across the bar
    along, across = np.array([0.5, 0, np.sqrt(0.75)]), np.array([-np.sqrt(0.75), 0, 0.5])
    check(state.velocity("slider").linear, ds * along + s * speed * across)
    check(state.acceleration("slider").linear,
          (dds - s * speed**2) * along + 2 * ds * speed * across)


def test_elliptic_trammel_example_7_1():
    values = {"slider": 0.45 * np.cos(np.radians(30))}
    state = moving("elliptic_trammel", values, {"slider": 0.6}, {"slider": 1.2})
    check_printed(state.angular_velocity("link"), "0.000000 0.000000 2.666667")
    check_printed(state.angular_acceleration("link"), "0.000000 0.000000 17.650139")
    check_printed(state.velocity("slider_b").linear, "0.000000 -1.039230 0.000000")
    check_printed(state.acceleration("slider_b").linear, "0.000000 -8.478461 0.000000")


def test_elliptic_trammel_handle_draws_an_ellipse():
    x, y, _ = sp.sweep(load("elliptic_trammel"), "pin_a", np.linspace(0, 2 * np.pi, 73)).frame(
        "handle").position.T
    check((x / 0.70) ** 2 + (y / 0.25) ** 2, np.ones(73))


def test_elliptic_trammel_slider_turns_back_at_the_end_of_its_slot():
    mechanism = load("elliptic_trammel")
    there = sp.sweep(mechanism, "slider", np.linspace(0.389, -0.4499, 91), speed=-0.6)
    x = there.driver
    check(there.coordinate("slide_b").value, np.sqrt(0.45**2 - x**2))
    check(there.coordinate("slide_b").rate, 0.6 * x / np.sqrt(0.45**2 - x**2))
    with pytest.raises(sp.LimitError) as caught:
        sp.sweep(mechanism, "slider", np.linspace(0.389, 0.46, 10))
    assert caught.value.limit == pytest.approx(0.45, abs=1e-9)


def test_crank_collar_example_7_2():
    state = moving("crank_collar", {"crank": np.radians(90)}, {"crank": 10.0})
    check_printed(1e3 * state.placement("crank_a").translation, "50.000000 0.000000 0.000000")
    check_printed(1e3 * state.placement("collar").translation, "0.000000 150.000000 75.000000")
    check_printed(1e3 * state.velocity("collar").linear, "0.000000 -250.000000 0.000000")
    check_printed(state.angular_velocity("link"), "2.307692 3.076923 1.538462")
    assert abs(state.angular_velocity("link") @ (50 * X - 75 * Z)) < TOLERANCE


def test_crossed_rssr_velocity_ratio_of_section_7_4():
    a, c, x0, y0 = 0.10, 0.24, 0.20, 0.30
    turn = sp.sweep(load("rssr_crossed"), "crank", np.linspace(0, 2 * np.pi, 73))
    phi, psi = turn.driver, turn.coordinate("rocker_pin").value
    eq_50 = (a * (x0 * np.cos(phi) - c * np.sin(phi) * np.cos(psi))
             / (c * (a * np.cos(phi) * np.sin(psi) - y0 * np.cos(psi))))
    check(turn.coordinate("rocker_pin").rate, eq_50)


def test_screw_press_stroke():
    turns = np.linspace(0, 8 * np.pi, 97)
    motion = sp.sweep(load("screw_press"), "screw", turns, speed=3.0)
    stroke = 0.010 * turns / (2 * np.pi)
    check(motion.coordinate("slide").value, stroke)
    check(motion.coordinate("slide").rate, np.full(97, 0.010 * 3.0 / (2 * np.pi)))
    check(motion.frame("platen").position, np.outer(0.27 - stroke, Z))
    check(motion.frame("spindle").angular_velocity, np.tile(-3.0 * Z, (97, 1)))


def demonstrator(folder, kind: str, origin, axis, **keys) -> sp.Mechanism:
    """One body on the ground by one joint `pair`."""
    return mechanisms.load(
        folder, kind, mechanisms.floating("pair", "ground", "body", origin),
        mechanisms.refine("pair", kind, axis=axis, **keys),
    )


def test_screw_joint_of_section_5(tmp_path):
    screw = demonstrator(tmp_path, "screw", (2.0, -3.0, 2.0), Z, lead=0.125)
    for theta in (np.pi, -2.0, 7.5, 30.0):
        M = sp.assemble(screw, {}, guess={"pair": theta}).placement("body")
        c, s = np.cos(theta), np.sin(theta)
        check(M.rotation, [[c, -s, 0], [s, c, 0], [0, 0, 1]])
        check(M.translation, [2.0, -3.0, 2.0 + 0.125 * theta / (2 * np.pi)])
    # tutorial question 2
    M = sp.assemble(screw, {}, guess={"pair": np.pi}).placement("body")
    check_printed(M.act(2.0 * Y), "2.0000 -5.0000 2.0625")


def test_cylindrical_joint_of_section_5(tmp_path):
    cylindrical = demonstrator(tmp_path, "cylindrical", (0.3, 0.0, 0.0), Y)
    for psi, b in ((0.4, 0.2), (-2.5, -0.7)):
        M = sp.assemble(cylindrical, {}, guess={"pair": [psi, b]}).placement("body")
        c, s = np.cos(psi), np.sin(psi)
        check(M.rotation, [[c, 0, s], [0, 1, 0], [-s, 0, c]])
        check(M.translation, [0.3, b, 0.0])


@pytest.mark.parametrize("beta", [-40, 10, 30])
def test_hooke_joint(beta):
    beta = np.radians(beta)
    turn = sp.sweep(load("hooke_joint", beta=beta), "input", np.linspace(0, 2 * np.pi, 73))
    out = turn.coordinate("output")
    check(np.sin(out.value) * np.cos(turn.driver) * np.cos(beta),
          np.cos(out.value) * np.sin(turn.driver))
    check(out.rate, np.cos(beta) / (1 - (np.sin(beta) * np.cos(turn.driver)) ** 2))


def test_double_cardan_turns_evenly_when_phased():
    turn = sp.sweep(load("double_cardan"), "input", np.linspace(0, 2 * np.pi, 73), speed=5.0)
    check(turn.coordinate("output").value, turn.driver)
    check(turn.coordinate("output").rate, np.full(73, 5.0))
    check(turn.coordinate("output").acceleration, np.zeros(73))
    assert np.ptp(turn.coordinate("middle").rate) > 1.0


def test_double_cardan_out_of_phase_is_twice_as_uneven():
    mechanism = load("double_cardan", phase=np.pi / 2)
    ratio = sp.sweep(mechanism, "input", np.linspace(0, 2 * np.pi, 73)).coordinate("output").rate
    assert ratio.max() == pytest.approx(1 / np.cos(np.radians(30)) ** 2, abs=1e-11)
    assert ratio.min() == pytest.approx(np.cos(np.radians(30)) ** 2, abs=1e-11)


# ---------------------------------------------------------------- open chains

OPEN_CHAINS = {  # coordinates [rad, m], their rates and accelerations, dimensions
    "satellite_dish": [
        ([0.0, np.radians(25)], [6.0, 2.0], [3.0, 1.5], {}),
        ([-2.1, 1.2], [0.7, -4.0], [-5.0, 2.0], {"oa": 2.0}),
    ],
    "crane": [
        ([0.0, np.radians(30)], [0.3, 0.5], [0.0, 0.0], {}),
        ([2.5, 1.1], [-0.4, 0.2], [0.1, -0.3], {"l": 20.0}),
    ],
    "rotating_rod_link": [
        ([0.0, np.radians(60)], [7.0, 2.0], [4.0, 3.0], {}),
        ([1.3, -2.0], [-3.0, 5.0], [2.0, -6.0], {"l": 0.5}),
    ],
    "turntable_collar": [
        ([0.0, 0.0, 0.30], [3.0, 6.0, 6.0], [1.5, 3.0, 3.0], {}),
        ([0.9, -2.2, 0.11], [-2.0, 4.0, 0.7], [6.0, -1.0, 2.0], {"oa": 0.2, "rod": 0.3}),
    ],
}


def open_chain(name: str, values, speeds, accelerations, dimensions) -> sp.State:
    drivers = load(name).drivers
    tables = (dict(zip(drivers, x, strict=True)) for x in (values, speeds, accelerations))
    return moving(name, *tables, **dimensions)


@pytest.mark.parametrize("name", OPEN_CHAINS)
def test_open_chain_has_as_many_freedoms_as_drivers(name):
    mechanism = load(name)
    mobility = sp.mobility(mechanism)
    assert mobility.dof == mobility.kutzbach == len(mechanism.drivers)
    assert not mechanism.closures


@pytest.mark.parametrize(("name", "given"), [(n, g) for n, cases in OPEN_CHAINS.items()
                                             for g in cases])
def test_open_chain(name, given):
    values, speeds, accelerations, dimensions = given
    state = open_chain(name, *given)

    def pose(t):
        at = [x + v * t + a * t**2 / 2 for x, v, a in zip(values, speeds, accelerations,
                                                          strict=True)]
        return getattr(lecture_forms, name)(*at, **dimensions)

    value, rate, acceleration = (
        closed_forms.Pose(*({k: np.array(x, float) for k, x in table.items()} for table in p))
        for p in closed_forms.rates(pose, 0.0, 1.0, 0.0)
    )
    for key in value.coordinates:
        check(state.coordinate(key), [p.coordinates[key] for p in (value, rate, acceleration)])
    places = [p.points | {link: M[:3, 3] for link, M in p.links.items()}
              for p in (value, rate, acceleration)]
    for key in places[0]:
        check(state.placement(key).translation, places[0][key])
        check(state.velocity(key).linear, places[1][key])
        check(state.acceleration(key).linear, places[2][key])
    for link in value.links:
        turning = closed_forms.angular_rates(
            *(p.links[link][:3, :3] for p in (value, rate, acceleration)))
        check(state.angular_velocity(link), turning[0])
        check(state.angular_acceleration(link), turning[1])


def test_satellite_dish_example_7_4():
    state = open_chain("satellite_dish", *OPEN_CHAINS["satellite_dish"][0])
    check_printed(state.angular_velocity("dish"), "2.000000 0.000000 6.000000")
    check_printed(state.angular_acceleration("dish"), "1.500000 12.000000 3.000000")
    check_printed(state.velocity("horn").linear, "-7.612985 -1.183331 2.537662")
    check_printed(state.acceleration("horn").linear, "10.393481 -51.640734 -0.463416")


def test_crane_exercise_7_6():
    state = open_chain("crane", *OPEN_CHAINS["crane"][0])
    check_printed(state.angular_velocity("boom"), "0.000000 0.300000 0.500000")
    check_printed(state.angular_acceleration("boom"), "0.150000 0.000000 0.000000")
    check_printed(state.velocity("tip").linear, "-3.000000 5.196152 -3.117691")
    check_printed(state.acceleration("tip").linear, "-3.533384 -1.500000 1.800000")


def five_terms(terms: sp.RelativeMotion):
    return (terms.base, terms.tangential, terms.normal, terms.relative, terms.coriolis)


@pytest.mark.parametrize("given", OPEN_CHAINS["turntable_collar"])
def test_turntable_collar_by_five_terms_in_the_shaft(given):
    state = open_chain("turntable_collar", *given)
    along = state.placement("shaft").rotation @ Z
    _, speed, acceleration = state.coordinate("slide")
    terms = state.relative_motion("collar", "shaft_a")
    check(terms.relative_velocity, speed * along)
    check(terms.relative, acceleration * along)
    check(sum(five_terms(terms)), state.acceleration("collar").linear)
    check(terms.base_velocity + terms.transport + terms.relative_velocity,
          state.velocity("collar").linear)


def test_turntable_collar_with_the_chosen_dimensions():
    state = open_chain("turntable_collar", *OPEN_CHAINS["turntable_collar"][0])
    w, e = np.array([0, 6, 3]), np.array([-18, 3, 1.5])  # omega, alpha of the shaft
    r = 0.3 * Z
    check(state.angular_velocity("shaft"), w)
    check(state.angular_acceleration("shaft"), e)
    terms = state.relative_motion("collar", "shaft_a")
    check(terms.position, r)
    check(terms.relative_velocity, 6 * Z)
    check(terms.base, 1.5 * np.cross(Z, 0.3 * Y) - 9 * 0.3 * Y)
    check(terms.tangential, [0.9, 5.4, 0])
    check(terms.normal, [0, 5.4, -10.8])
    check(terms.relative, [0, 0, 3])
    check(terms.coriolis, [72, 0, 0])
    check(state.velocity("collar").linear, [0.9, 0, 6])
    check(state.acceleration("collar").linear, [72.45, 8.1, -7.8])


@pytest.mark.parametrize(("name", "point"), [("rotating_rod_link", "link_a"),
                                             ("turntable_collar", "collar")])
@pytest.mark.parametrize("case", [0, 1])
def test_five_terms_in_the_first_body(name, point, case):
    """What moves relative to the first body is what moves when that body stands still."""
    values, speeds, accelerations, dimensions = OPEN_CHAINS[name][case]
    state = open_chain(name, values, speeds, accelerations, dimensions)
    still = open_chain(name, values, [0.0, *speeds[1:]], [0.0, *accelerations[1:]], dimensions)
    body = {"rotating_rod_link": "rod", "turntable_collar": "turntable"}[name]
    terms = state.relative_motion(point, body)
    check(terms.relative_velocity, still.velocity(point).linear)
    check(terms.relative, still.acceleration(point).linear)
    check(sum(five_terms(terms)), state.acceleration(point).linear)


def test_rotating_rod_link_assignment_7_5():
    state = open_chain("rotating_rod_link", *OPEN_CHAINS["rotating_rod_link"][0])
    s, c = 0.8 * np.sin(np.radians(60)), 0.8 * np.cos(np.radians(60))
    check(state.angular_velocity("link"), [-2, 0, 7])
    check(state.angular_acceleration("link"), [-3, -14, 4])
    check(state.velocity("link_a").linear, [-7 * s, 2 * c, -2 * s])
    # tangential, normal and Coriolis of the rod, relative by theta: none of the base
    check(state.acceleration("link_a").linear,
          [-4 * s - 2 * 7 * 2 * c, -49 * s + 3 * c - 4 * s, -3 * s - 4 * c])
