"""The library's mechanisms against closed forms over a full turn, and against printed numbers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import closed_forms
import lecture_forms
import numpy as np
import pinocchio as pin
import pytest
from closed_forms import Pose, Rates
from loaded_library import library
from masses import inertias, numbers, solid, urdf
from mpmath import cos, mp, mpf, sin, sqrt
from variety import few

import spatial_pin as sp

TOLERANCE = 1e-11
SPEED = 25.13  # rad/s
ACCELERATION = 314.16  # rad/s2
TURN = np.linspace(0.0, 2 * np.pi, 361)[:-1]
EVERY_4_DEGREES = TURN[::4]


class Case(NamedTuple):
    """A mechanism with a known answer; a new entry of CASES is tested by being there."""

    mechanism: str
    closed_form: Callable[..., Pose]
    parameters: dict[str, float] = {}  # noqa: RUF012 (never changed)
    spinless: dict[str, tuple[str, str]] = {}  # noqa: RUF012  {link: two points of its line}
    driver: str = "crank"  # or a coordinate
    values: np.ndarray = TURN  # of the driver


def lecture(
    mechanism: str, driver: str = "crank", spinless: dict | None = None, **dimensions: float
) -> Case:
    return Case(mechanism, getattr(lecture_forms, mechanism), dimensions, spinless or {}, driver,
                EVERY_4_DEGREES)


RSSR_COUPLER = {"coupler": ("coupler", "coupler_b")}
SLIPPER = {"slipper": ("slipper", "slipper_foot")}
CASES = {
    "rssr": Case("rssr", closed_forms.rssr, spinless=RSSR_COUPLER),
    "rssr, d = 0.315": Case("rssr", closed_forms.rssr, {"d": 0.315}, RSSR_COUPLER),
    "rssr, other links": Case(
        "rssr", closed_forms.rssr, {"a": 0.08, "b": 0.4, "c": 0.22, "d": 0.33}, RSSR_COUPLER
    ),
    "four_bar": Case("four_bar", closed_forms.four_bar),
    "four_bar, other links": Case(
        "four_bar", closed_forms.four_bar, {"r1": 0.35, "r2": 0.12, "r3": 0.3, "r4": 0.26}
    ),
    "slider_crank": Case("slider_crank", closed_forms.slider_crank),
    "slider_crank, offset": Case("slider_crank", closed_forms.slider_crank, {"e": 0.02}),
    "slider_crank, other links": Case(
        "slider_crank", closed_forms.slider_crank, {"r": 0.06, "l": 0.2, "e": -0.015}
    ),
    "rspc": Case("rspc", closed_forms.rspc),
    "rspc, other links": Case(
        "rspc",
        closed_forms.rspc,
        {"alpha": 0.7, "h": 0.32, "d": 0.2, "l1": 0.08, "l2": 0.18, "a": 0.1, "rod": 0.4},
    ),
    "swash_plate": lecture("swash_plate", "shaft", SLIPPER),
    "swash_plate, other links": lecture("swash_plate", "shaft", SLIPPER, r=0.08, tilt=0.3, h=0.02),
    "inverted_slider_crank": lecture("inverted_slider_crank", "bar"),
    "inverted_slider_crank, other links": lecture(
        "inverted_slider_crank", "bar", ac=0.2, bc=0.3, ad=0.55
    ),
    "elliptic_trammel": lecture("elliptic_trammel", "pin_a"),
    "elliptic_trammel, other links": lecture("elliptic_trammel", "pin_a", l=0.3, handle=0.1),
    "crank_collar": lecture("crank_collar"),
    "crank_collar, other links": lecture("crank_collar", a=0.04, h=0.09, l=0.2),
    "hooke_joint": lecture("hooke_joint", "input"),
    "hooke_joint, other angle": lecture("hooke_joint", "input", beta=-0.7),
    "double_cardan": lecture("double_cardan", "input"),
    "double_cardan, other angles": lecture(
        "double_cardan", "input", beta_1=0.3, beta_2=-0.6, phase=0.5, span=0.3
    ),
    "screw_press": lecture("screw_press", "screw"),
    "rssr_crossed": lecture("rssr_crossed", spinless=RSSR_COUPLER),
    "rssr_crossed, other links": lecture(
        "rssr_crossed", spinless=RSSR_COUPLER, a=0.08, b=0.4, c=0.24, x0=0.05, y0=0.3
    ),
}
MECHANISMS = sorted({case.mechanism for case in CASES.values()})
OPEN_CHAINS = ["crane", "rotating_rod_link", "satellite_dish", "turntable_collar"]

BY_DEFAULT = ("rssr, other links", "four_bar", "rspc", "swash_plate, other links", "crank_collar",
              "double_cardan, other angles", "screw_press")
COARSE = {f"{name}, coarse": CASES[name]._replace(values=TURN[::30]) for name in BY_DEFAULT}
CASES |= COARSE
every_case = pytest.mark.parametrize("name", few(CASES, *COARSE))


# ---------------------------------------------------------------- the truth


@cache
def truth_at(name: str, angle: float) -> Rates:
    """What the closed form says at one crank angle, in float64."""
    case = CASES[name]
    exact = closed_forms.rates(
        lambda phi: case.closed_form(phi, **case.parameters), angle, SPEED, ACCELERATION
    )
    return Rates(*(Pose(*({k: np.array(x, dtype=float) for k, x in table.items()}
                          for table in pose)) for pose in exact))


@cache
def truth(name: str, angles: tuple[float, ...] | None = None) -> Rates:
    """What the closed form says, one row per crank angle, by default those of the case."""
    angles = tuple(CASES[name].values) if angles is None else angles
    rows = [truth_at(name, angle) for angle in angles]
    return Rates(*(Pose(*({k: np.stack([t[k] for t in tables]) for k in tables[0]}
                          for tables in zip(*poses, strict=True)))
                   for poses in zip(*rows, strict=True)))


def turning(name: str, link: str, turn: Rates) -> tuple[np.ndarray, np.ndarray]:
    """Angular velocity and acceleration of a link."""
    if link in CASES[name].spinless:
        ends = (tuple(pose.points[end] for pose in turn) for end in CASES[name].spinless[link])
        return closed_forms.spinless_rates(*ends)
    return closed_forms.angular_rates(*(pose.links[link][..., :3, :3] for pose in turn))


def mass_centre(name: str, link: str, turn: Rates) -> list[np.ndarray]:
    """Position, velocity and acceleration of a link's centre of mass."""
    centre = inertias(CASES[name].mechanism, **CASES[name].parameters)[link].lever
    if link in CASES[name].spinless:
        start, end = CASES[name].spinless[link]  # the link's origin, and a point beyond its centre
        length = np.linalg.norm(turn.value.points[end][0] - turn.value.points[start][0])
        share = np.linalg.norm(centre) / length
        return [(1 - share) * p.points[start] + share * p.points[end] for p in turn]
    position = np.array([*centre, 1.0])
    return [(p.links[link] @ position)[..., :3] for p in turn]


def links(name: str) -> list[str]:
    return [*truth_at(name, 0.0).value.links, *CASES[name].spinless]


# ---------------------------------------------------------------- the library


@cache
def loaded(name: str) -> sp.Mechanism:
    return library(CASES[name].mechanism, **CASES[name].parameters)


@cache
def motion(name: str) -> sp.Motion:
    case = CASES[name]
    return sp.sweep(loaded(name), case.driver, case.values, speed=SPEED, acceleration=ACCELERATION)


def state(name: str, angle: float) -> sp.State:
    mechanism = loaded(name)
    driver = CASES[name].driver
    closed = sp.assemble(mechanism, {driver: angle})
    return sp.solve_rates(
        mechanism, closed, speeds={driver: SPEED}, accelerations={driver: ACCELERATION}
    )


def check(actual, expected, what: str) -> None:
    """Scalars (N,) or vectors (N, 3): within TOLERANCE (1 + |expected|) in every row."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape, what
    vectors = expected.ndim == 2
    size = np.linalg.norm(expected, axis=-1) if vectors else np.abs(expected)
    error = np.linalg.norm(actual - expected, axis=-1) if vectors else np.abs(actual - expected)
    worst = np.max(error / (1 + size))
    assert worst <= TOLERANCE, f"{what}: off by {worst:.1e}"


# ---------------------------------------------------------------- over a full turn


@every_case
def test_turn_is_closed(name):
    turn = motion(name)
    np.testing.assert_allclose(turn.driver, CASES[name].values, rtol=0, atol=1e-14)
    assert np.max(turn.closure_error) < 1e-12
    assert not turn.events


@every_case
def test_coordinates_over_a_turn(name):
    expected = truth(name)
    for coordinate in expected.value.coordinates:
        rates = motion(name).coordinate(coordinate)
        for actual, pose, order in zip(rates, expected, Rates._fields, strict=True):
            check(actual, pose.coordinates[coordinate], f"{order} of {coordinate}")


@every_case
def test_links_over_a_turn(name):
    expected = truth(name)
    for link in expected.value.links:
        frame = motion(name).frame(link)
        position, velocity, acceleration = (pose.links[link][:, :3, 3] for pose in expected)
        check(frame.position, position, f"position of {link}")
        check(frame.velocity, velocity, f"velocity of {link}")
        check(frame.acceleration, acceleration, f"acceleration of {link}")
        difference = frame.rotation - expected.value.links[link][:, :3, :3]
        assert np.max(np.abs(difference)) < TOLERANCE, f"rotation of {link}"


@every_case
def test_angular_rates_over_a_turn(name):
    for link in links(name):
        frame = motion(name).frame(link)
        omega, alpha = turning(name, link, truth(name))
        check(frame.angular_velocity, omega, f"angular velocity of {link}")
        check(frame.angular_acceleration, alpha, f"angular acceleration of {link}")


@every_case
def test_points_over_a_turn(name):
    expected = truth(name)
    for point in expected.value.points:
        frame = motion(name).frame(point)
        position, velocity, acceleration = (pose.points[point] for pose in expected)
        check(frame.position, position, f"position of {point}")
        check(frame.velocity, velocity, f"velocity of {point}")
        check(frame.acceleration, acceleration, f"acceleration of {point}")


@every_case
def test_mass_centres_over_a_turn(name):
    for link in links(name):
        com = motion(name).com(link)
        position, velocity, acceleration = mass_centre(name, link, truth(name))
        check(com.position, position, f"position of the mass centre of {link}")
        check(com.velocity, velocity, f"velocity of the mass centre of {link}")
        check(com.acceleration, acceleration, f"acceleration of the mass centre of {link}")


@pytest.mark.parametrize("name", few(MECHANISMS, "rssr", "double_cardan", "screw_press"))
def test_angles_count_turns(name):
    turns = 4 * np.pi
    twice = sp.sweep(library(name), CASES[name].driver, np.linspace(0.0, turns, 181))
    first, last = (truth_at(name, angle).value.coordinates for angle in (0.0, turns))
    for coordinate in first:
        value = twice.coordinate(coordinate)[0]
        gain = last[coordinate] - first[coordinate]
        assert value[-1] - value[0] == pytest.approx(gain, abs=1e-11)


# ---------------------------------------------------------------- at one position


@every_case
@pytest.mark.parametrize("angle", few([-0.4, 0.0, 0.7], 0.7))
def test_state(name, angle):
    turn, closed = truth(name, (angle,)), state(name, angle)
    assert closed.closure_error < 1e-12
    for coordinate in turn.value.coordinates:
        rates = closed.coordinate(coordinate)
        for actual, pose, order in zip(rates, turn, Rates._fields, strict=True):
            check([actual], pose.coordinates[coordinate], f"{order} of {coordinate}")
    for link, expected in turn.value.links.items():
        difference = closed.placement(link).homogeneous - expected[0]
        assert np.max(np.abs(difference)) < TOLERANCE, link
    for point, expected in turn.value.points.items():
        check([closed.placement(point).translation], expected, f"position of {point}")
        check([closed.velocity(point).linear], turn.rate.points[point], f"velocity of {point}")
        check([closed.acceleration(point).linear], turn.acceleration.points[point],
              f"acceleration of {point}")
    for link in links(name):
        omega, alpha = turning(name, link, turn)
        check([closed.angular_velocity(link)], omega, f"angular velocity of {link}")
        check([closed.angular_acceleration(link)], alpha, f"angular acceleration of {link}")
        for actual, expected in zip(closed.com(link), mass_centre(name, link, turn), strict=True):
            check([actual], expected, f"mass centre of {link}")


@every_case
def test_every_position_assembles_on_the_branch_of_the_guess(name):
    mechanism = loaded(name)
    for angle in TURN[::30]:
        closed = sp.assemble(mechanism, {CASES[name].driver: angle})
        for coordinate, expected in truth_at(name, angle).value.coordinates.items():
            error = closed.coordinate(coordinate)[0] - expected
            if mechanism.coordinate(coordinate).unit == "rad":
                error = np.remainder(error + np.pi, 2 * np.pi) - np.pi
            assert abs(error) < TOLERANCE, f"{coordinate} at {angle:.3f} rad"


# ---------------------------------------------------------------- printed numbers


class Printed(NamedTuple):
    """A printed number or vector, and half a unit of the last digit of each component."""

    value: np.ndarray
    half_digit: np.ndarray

    @classmethod
    def parse(cls, text: str) -> Printed:
        decimals = np.array([len(word.partition(".")[2]) for word in text.split()])
        return cls(numbers(text), 0.5 * 10.0**-decimals)

    def check(self, actual) -> None:
        error = np.abs(np.atleast_1d(actual) - self.value)
        assert np.all(error <= 1.001 * self.half_digit), f"{actual} is not {self.value}"


# EMT 2431, Example 7.3, worked to more digits: {(d [m], phi [deg], rpm, rpm/s): {output: number}}
EXAMPLE_7_3 = {
    (0.314, 0, 1200, 3000): {
        "psi": "70.64028162",
        "rocker speed": "0.000000000000",
        "rocker acceleration": "12624.9732",
        "coupler speed": "-21.159989 -26.154464 0.000000000000",
        "coupler acceleration": "-52.899971 -65.386161 -4504.5541",
    },
    (0.314, 60, 240, 0): {
        "psi": "88.4246436",
        "ratio": "0.424607246164",
        "rocker speed": "10.67154404",
        "rocker acceleration": "-28.44939425",
        "coupler speed": "-2.1966226 -2.6817942 -0.99471481",
    },
    (0.315, 0, 240, 0): {"psi": "70.97299137"},
    (0.315, 60, 240, 0): {"psi": "88.65583201", "ratio": "0.422923035202"},
}


@pytest.mark.parametrize(("given", "printed"), EXAMPLE_7_3.items())
def test_example_7_3(given, printed):
    d, degrees, rpm, rpm_per_second = given
    speed, acceleration = rpm * np.pi / 30, rpm_per_second * np.pi / 30
    mechanism = library("rssr", d=d)
    closed = sp.assemble(mechanism, {"crank": np.radians(degrees)})
    closed = sp.solve_rates(
        mechanism, closed, speeds={"crank": speed}, accelerations={"crank": acceleration}
    )
    rocker = closed.coordinate("rocker_pin")
    outputs = {
        "psi": np.degrees(rocker[0]),
        "ratio": rocker[1] / speed,
        "rocker speed": rocker[1],
        "rocker acceleration": rocker[2],
        "coupler speed": closed.angular_velocity("coupler"),
        "coupler acceleration": closed.angular_acceleration("coupler"),
    }
    for output, text in printed.items():
        Printed.parse(text).check(outputs[output])


def test_rspc_rod_lies_on_the_line_from_c_to_f():
    turn = motion("rspc")
    cde, ball = turn.frame("cde"), turn.frame("rod_b").position
    c = cde.position + cde.rotation @ [0.0, 0.0, 0.20]
    f = cde.position + cde.rotation @ [0.15, 0.0, 0.0]
    assert np.max(np.linalg.norm(np.cross(ball - c, f - c), axis=1)) < TOLERANCE
    u = np.linalg.norm(ball - c, axis=1)
    check(turn.coordinate("slide")[0], u, "u")
    check(cde.position[:, 1:], np.tile([0.25, 0.0], (len(TURN), 1)), "D on the guide")


MOBILITY = {  # Kutzbach, degrees of freedom, passive freedoms
    "rssr": (2, 2, 1),
    "four_bar": (-2, 1, 0),
    "slider_crank": (-2, 1, 0),
    "rspc": (1, 1, 0),
    "swash_plate": (2, 2, 1),
    "inverted_slider_crank": (-2, 1, 0),
    "elliptic_trammel": (-2, 1, 0),
    "crank_collar": (1, 1, 0),
    "hooke_joint": (-2, 1, 0),
    "double_cardan": (-5, 1, 0),
    "screw_press": (-3, 1, 0),
    "rssr_crossed": (2, 2, 1),
}


@pytest.mark.delicate
@pytest.mark.parametrize(("name", "expected"), MOBILITY.items())
def test_mobility(name, expected):
    mobility = sp.mobility(library(name))
    assert (mobility.kutzbach, mobility.dof, len(mobility.passive)) == expected


# ---------------------------------------------------------------- the files and the closed forms


@pytest.mark.parametrize("name", few(
    [*MECHANISMS, *OPEN_CHAINS], "crane", "four_bar", "rssr", "rspc", "screw_press", "swash_plate"))
def test_links_weigh_what_is_drawn(name):
    drawn = dict.fromkeys(inertias(name), pin.Inertia.Zero())
    for link in urdf(name).iter("link"):
        for visual in link.iter("visual") if link.get("name") in drawn else ():
            drawn[link.get("name")] = drawn[link.get("name")] + solid(visual)
    for link, stated in inertias(name).items():
        assert stated.mass == pytest.approx(drawn[link].mass, rel=1e-12)
        np.testing.assert_allclose(stated.lever, drawn[link].lever, rtol=0, atol=1e-14)
        round_off = 1e-14 + 1e-15 * np.trace(stated.inertia)
        np.testing.assert_allclose(stated.inertia, drawn[link].inertia, rtol=0, atol=round_off)


@pytest.mark.parametrize("name", few(MECHANISMS, "rssr", "double_cardan", "screw_press"))
def test_rates_of_closed_forms_are_taylor_coefficients(name):
    f, phi, speed, acceleration = CASES[name].closed_form, mpf("1.1"), mpf(3), mpf(7)
    exact = closed_forms.rates(f, phi, speed, acceleration)
    with mp.workdps(closed_forms.DIGITS):
        for key in exact.value.coordinates:
            _, first, half_second = mp.taylor(lambda x, key=key: f(x).coordinates[key], phi, 2)
            second = 2 * half_second
            assert abs(exact.rate.coordinates[key] - first * speed) < mpf("1e-25")
            assert abs(exact.acceleration.coordinates[key]
                       - (second * speed**2 + first * acceleration)) < mpf("1e-25")


def test_rspc_closed_form_satisfies_the_papers_equations():
    with mp.workdps(closed_forms.DIGITS):
        h, d, l1, l2, a, alpha = map(mpf, (0.30, 0.25, 0.10, 0.20, 0.15, np.radians(60)))
        b = sqrt(l2**2 + a**2)
        for k in range(12):
            phi = 2 * mp.pi * k / 12
            x = closed_forms.rspc(phi)
            delta, x_d, u = (x.coordinates[c] for c in ("guide.angle", "guide.slide", "slide"))
            c = (x.links["cde"] @ closed_forms.vector(0, 0, l2, 1))[:3]
            # sin gamma cos beta, sin gamma sin beta, -cos gamma: the direction from B to C
            along = (c - x.points["rod_b"]) / u
            residuals = (
                l1 * sin(phi) * sin(alpha) + u * along[0] - x_d,
                -l1 * sin(phi) * cos(alpha) + u * along[1] + l2 * sin(delta) - d,
                h + l1 * cos(phi) + u * along[2] - l2 * cos(delta),
                b * along[1] - l2 * sin(delta),
                b * along[2] + l2 * cos(delta),
                b * along[0] - a,
            )
            assert max(map(abs, residuals)) < mpf("1e-38")
