"""The library's classical linkages against what is known of them exactly, over their full motion.

`CASES` lists them with their closed forms in mpmath; what is said about one linkage only follows.
Sources: the papers that the mechanism files name, and the loop equations of [McCarthy2011].
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import closed_forms
import mechanisms
import numpy as np
import pinocchio as pin
import pytest
from closed_forms import Pose, Rates, placement, rotation, vector
from loaded_library import library
from machines import ARMS, UPRIGHT, X, Y, Z, delta
from masses import inertias, solid, urdf
from mpmath import acos, asin, atan2, cos, mp, mpf, sin, sqrt
from variety import few

import spatial_pin as sp

SPEED, ACCELERATION = 2.5, 7.0  # of every driver [rad/s and rad/s2, or m and s]
TOLERANCE = 1e-11
DEGREE = np.pi / 180
INNER = 0.12 - 2.4 * 0.06 * 0.12  # radius at which the spherical four-bar's coupler is drawn


# ---------------------------------------------------------------- closed forms


def plane_link(angle, x, z) -> np.ndarray:
    """Placement of a link in the x-z plane whose angle is counted from +x towards +z."""
    return placement(rotation(-Y, angle), vector(x, 0, z))


def scotch_yoke(angle, r=0.05) -> Pose:
    x, z = mpf(r) * cos(angle), mpf(r) * sin(angle)
    return Pose(
        coordinates={"crank_pin": angle, "slide": x, "slot": z},
        links={
            "crank": plane_link(angle, 0, 0),
            "yoke": placement(UPRIGHT, vector(x, 0, 0)),
            "block": placement(UPRIGHT, vector(x, 0, z)),
        },
        points={"crank_b": vector(x, 0, z)},
    )


def turned_about_z(angle) -> np.ndarray:
    return placement(rotation(Z, angle), vector(0, 0, 0))


def along_x(length, twist) -> np.ndarray:
    """A move along x and a turn about it: what leads from one hinge of a link to the next."""
    return placement(rotation(X, twist), vector(length, 0, 0))


def bennett(crank, a=0.10, alpha=40 * DEGREE, beta=110 * DEGREE) -> Pose:
    a, alpha, beta = map(mpf, (a, alpha, beta))
    b = a * sin(beta) / sin(alpha)
    k = sin((beta + alpha) / 2) / sin((beta - alpha) / 2)
    follower = 2 * atan2(k * cos(crank / 2), sin(crank / 2))
    first = along_x(b / 2, beta / 2).dot(turned_about_z(crank))
    second = first.dot(along_x(a, alpha)).dot(turned_about_z(follower))
    last = along_x(-b / 2, -beta / 2).dot(turned_about_z(follower))
    return Pose(
        coordinates={"crank_pin": crank, "coupler_pin": follower, "follower_pin": follower},
        links={"crank": first, "coupler": second, "follower": last},
        points={"coupler_b": second.dot(vector(b, 0, 0, 1))[:3],
                "follower_b": last.dot(vector(-a, 0, 0, 1))[:3]},
    )


def peaucellier(crank, L=0.25, s=0.10, d=0.10) -> Pose:
    L, s, d = map(mpf, (L, s, d))
    along = crank / 2  # the direction of O, Q and P
    to_q = 2 * d * cos(along)
    to_p = (L**2 - s**2) / to_q
    arm, side = acos((to_q + to_p) / (2 * L)), acos((to_p - to_q) / (2 * s))  # against that line
    x_q, z_q = to_q * cos(along), to_q * sin(along)
    x_a, z_a = L * cos(along + arm), L * sin(along + arm)
    x_b, z_b = L * cos(along - arm), L * sin(along - arm)
    p = vector(to_p * cos(along), 0, to_p * sin(along))
    return Pose(
        coordinates={
            "crank_pin": crank, "upper_arm_pin": along + arm, "lower_arm_pin": along - arm,
            "upper_inner_pin": along + side - crank, "lower_inner_pin": along - side - crank,
            "upper_outer_pin": -side - arm, "lower_outer_pin": side + arm,
        },
        links={
            "crank": plane_link(crank, d, 0),
            "upper_arm": plane_link(along + arm, 0, 0),
            "lower_arm": plane_link(along - arm, 0, 0),
            "upper_inner": plane_link(along + side, x_q, z_q),
            "lower_inner": plane_link(along - side, x_q, z_q),
            "upper_outer": plane_link(along - side, x_a, z_a),
            "lower_outer": plane_link(along + side, x_b, z_b),
        },
        points={"upper_outer_p": p, "lower_outer_p": p},
    )


def spherical_four_bar(crank, alpha1=80 * DEGREE, alpha2=30 * DEGREE, alpha3=70 * DEGREE,
                       alpha4=65 * DEGREE) -> Pose:
    alpha1, alpha2, alpha3, alpha4 = map(mpf, (alpha1, alpha2, alpha3, alpha4))
    shaft = rotation(Y, -mp.pi / 2)  # z of this frame is the crank's axis, x is up
    output = rotation(Z, -alpha1).dot(shaft)
    first = shaft.dot(rotation(Z, crank))
    second = first.dot(rotation(Y, alpha2))
    u = output.T.dot(second[:, 2])  # the coupler's first hinge as the rocker's bearing sees it
    # u . (sin alpha4 cos rocker, sin alpha4 sin rocker, cos alpha4) = cos alpha3
    across = (cos(alpha3) - u[2] * cos(alpha4)) / sin(alpha4)
    rocker = atan2(u[1], u[0]) + acos(across / sqrt(u[0] ** 2 + u[1] ** 2))
    last = output.dot(rotation(Z, rocker))
    hinge = last.dot(vector(sin(alpha4), 0, cos(alpha4)))
    seen = second.T.dot(hinge)
    coupler = atan2(seen[1], seen[0])
    second = second.dot(rotation(Z, coupler))
    centre = vector(0, 0, 0)
    return Pose(
        coordinates={"crank_pin": crank, "coupler_pin": coupler, "rocker_pin": rocker},
        links={"crank": placement(first, centre), "coupler": placement(second, centre),
               "rocker": placement(last, centre)},
        points={"coupler_b": mpf(INNER) * hinge, "rocker_b": mpf(INNER) * hinge},
    )


def sarrus(rise, r=0.06, l=0.10) -> Pose:  # noqa: E741 (l as in the URDF)
    r, l = mpf(r), mpf(l)  # noqa: E741
    height, bend = 2 * l * sin(rise), mp.pi - 2 * rise
    out = r + l * cos(rise)
    side = rotation(Z, -mp.pi / 2)  # from chain a to chain b
    return Pose(
        coordinates={"a_low": rise, "a_mid": bend, "a_top": rise - mp.pi, "b_low": rise,
                     "b_mid": bend},
        links={
            "a_lower": plane_link(rise, r, 0),
            "a_upper": plane_link(mp.pi - rise, out, height / 2),
            "b_lower": placement(side.dot(rotation(-Y, rise)), vector(0, -r, 0)),
            "b_upper": placement(side.dot(rotation(-Y, mp.pi - rise)),
                                 vector(0, -out, height / 2)),
            "platform": placement(UPRIGHT, vector(r, 0, height)),
        },
        points={"platform_middle": vector(0, 0, height), "b_upper_end": vector(0, -r, height)},
    )


def bricard(crank, l=0.15) -> Pose:  # noqa: E741
    l = mpf(l)  # noqa: E741
    even = asin(1 / (1 + sin(crank)) - 1)
    coordinates = {f"hinge_{k}": crank if k % 2 else even for k in range(1, 6)}
    links, pose = {}, placement(UPRIGHT, vector(0, 0, 0))
    for k, (axis, along) in enumerate(zip((Y, Z, X, Y, Z), (X, -Y, Z, -X, Y), strict=True), 1):
        pose = pose.dot(placement(rotation(axis, coordinates[f"hinge_{k}"]), vector(0, 0, 0)))
        links[f"rod_{k}"] = pose
        pose = pose.dot(placement(UPRIGHT, l * along))
    return Pose(coordinates, links, {"rod_5_end": vector(0, 0, l)})


def oldham(angle, e=0.015, r=None) -> Pose:
    """The coupling's middle disc is where both slots ask for it (`r` moves nothing)."""
    turned, slide = rotation(X, angle), mpf(e) * cos(angle)
    return Pose(
        coordinates={"input_pin": angle, "output_pin": angle, "slide": slide},
        links={
            "input": placement(turned, vector(0, 0, 0)),
            "output": placement(turned, vector(0, e, 0)),
            "middle": placement(turned, slide * turned[:, 1]),
        },
        points={},
    )


def geared_five_bar(left, g=0.20, a=0.05, b=0.20) -> Pose:
    g, a, b = map(mpf, (g, a, b))
    right = mpf(np.pi) - 2 * left
    x_l, z_l = a * cos(left), a * sin(left)
    x_r, z_r = g + a * cos(right), a * sin(right)
    base = atan2(z_r - z_l, x_r - x_l)
    rise = acos(sqrt((x_r - x_l) ** 2 + (z_r - z_l) ** 2) / (2 * b))
    x, z = x_l + b * cos(base + rise), z_l + b * sin(base + rise)
    return Pose(
        coordinates={"left_pin": left, "right_pin": right, "left_elbow": base + rise - left,
                     "tip_pin": -2 * rise},
        links={
            "left_gear": plane_link(left, 0, 0),
            "right_gear": plane_link(right, g, 0),
            "left_rod": plane_link(base + rise, x_l, z_l),
            "right_rod": plane_link(base - rise, x, z),
        },
        points={"right_rod_b": vector(x_r, 0, z_r), "right_gear_b": vector(x_r, 0, z_r)},
    )


def watt_six_bar(crank, r1=0.30, r2=0.10, r3=0.28, r4=0.24, r5=0.15, r6=0.25, r7=0.16, r8=0.30,
                 gamma=-70 * DEGREE) -> Pose:
    """The closed form of the plane four-bar, twice."""
    r1, r5, r6, r7, r8, gamma = map(mpf, (r1, r5, r6, r7, r8, gamma))
    first = closed_forms.four_bar(crank, r1, r2, r3, r4)
    rocker = first.coordinates["rocker_pin"]
    second = closed_forms.four_bar(rocker + gamma, r8, r5, r6, r7)
    x_d, _, z_d = second.points["rocker_b"]
    x_c, z_c = r1 + r5 * cos(rocker + gamma), r5 * sin(rocker + gamma)
    output = second.coordinates["rocker_pin"]
    link = second.coordinates["coupler_pin"] + gamma  # against the rocker's first arm
    return Pose(
        coordinates={**first.coordinates, "link_pin": link, "output_pin": output},
        links={**first.links, "link": plane_link(rocker + link, x_c, z_c),
               "output": plane_link(output, r1 + r8, 0)},
        points={**first.points, "output_d": vector(r1 + x_d, 0, z_d)},
    )


# ---------------------------------------------------------------- the Gough platform


def on_circle(radius: float, half_angle: float) -> np.ndarray:
    """Six points (6, 3) in pairs at the half angle about the directions of 0, 120, 240 degrees."""
    angles = np.radians(np.repeat([0, 120, 240], 2)) + np.tile([-half_angle, half_angle], 3)
    return radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(6)])


FEET = on_circle(0.30, 20 * DEGREE)
TOPS = on_circle(0.18, 45 * DEGREE)
HOME = np.array([0.0, 0.0, 0.36])
LEG = float(np.linalg.norm(TOPS[0] + HOME - FEET[0]))  # length of the legs at home


def leg_rates(position, velocity, acceleration) -> tuple:
    """Lengths, speeds and accelerations (6,) of the legs from those of their balls (6, 3)."""
    legs = position - FEET
    length = np.linalg.norm(legs, axis=1)
    speed = (legs * velocity).sum(axis=1) / length
    bend = (velocity * velocity).sum(axis=1) - speed**2
    return length, speed, ((legs * acceleration).sum(axis=1) + bend) / length


def stewart(leg_1) -> Pose:
    """Only what is prescribed: the other legs keep their length."""
    lengths = {f"slide_{k}": mpf(LEG) for k in range(2, 7)}
    return Pose({"slide_1": leg_1, **lengths}, {}, {})


# ---------------------------------------------------------------- the cases


class Case(NamedTuple):
    """A linkage, the driver values of its full motion, and the answer."""

    mechanism: str
    driver: str
    values: np.ndarray
    closed_form: Callable[..., Pose]
    mobility: tuple[int, int]  # Kutzbach's formula, finite freedom
    parameters: dict[str, float] = {}  # noqa: RUF012 (never changed)
    hold: dict[str, float] = {}  # noqa: RUF012


def turn(start: float, rows: int = 19) -> np.ndarray:
    return start + np.linspace(0.0, 2 * np.pi, rows)


CASES = {
    "scotch_yoke": Case("scotch_yoke", "crank", turn(0.6), scotch_yoke, (-2, 1)),
    "scotch_yoke, r = 0.08": Case(
        "scotch_yoke", "crank", turn(0.6), scotch_yoke, (-2, 1), {"r": 0.08}),
    "bennett": Case("bennett", "crank", turn(0.4), bennett, (-2, 1)),
    "bennett, other links": Case("bennett", "crank", turn(0.4), bennett, (-2, 1),
                                 {"a": 0.13, "alpha": 1.0, "beta": 0.6}),
    "peaucellier": Case("peaucellier", "crank", np.linspace(-1.2, 1.2, 17), peaucellier, (-8, 1)),
    "peaucellier, other links": Case(
        "peaucellier", "crank", np.linspace(-1.0, 1.0, 9), peaucellier, (-8, 1),
        {"L": 0.4, "s": 0.15, "d": 0.17}),
    "spherical_four_bar": Case(
        "spherical_four_bar", "crank", turn(0.0), spherical_four_bar, (-2, 1)),
    "spherical_four_bar, other links": Case(
        "spherical_four_bar", "crank", turn(0.0), spherical_four_bar, (-2, 1),
        {"alpha1": 1.5, "alpha2": 0.4, "alpha3": 1.3, "alpha4": 1.2}),
    "sarrus": Case("sarrus", "arm", np.linspace(0.2, 1.4, 13), sarrus, (0, 1)),
    "sarrus, other links": Case(
        "sarrus", "arm", np.linspace(0.4, 1.2, 7), sarrus, (0, 1), {"r": 0.05, "l": 0.14}),
    "bricard": Case("bricard", "crank", np.linspace(-0.4, 3.5, 19), bricard, (0, 1)),
    "bricard, l = 1": Case(
        "bricard", "crank", np.linspace(0.0, 3.0, 7), bricard, (0, 1), {"l": 1.0}),
    "oldham": Case("oldham", "input", turn(0.0), oldham, (-2, 1)),
    "oldham, other offset": Case(
        "oldham", "input", turn(0.3), oldham, (-2, 1), {"e": -0.008, "r": 0.03}),
    "geared_five_bar": Case("geared_five_bar", "crank", turn(0.0), geared_five_bar, (-2, 1)),
    "geared_five_bar, other links": Case(
        "geared_five_bar", "crank", 3 * turn(-1.0, 19), geared_five_bar, (-2, 1),
        {"g": 0.3, "a": 0.06, "b": 0.28}),
    "watt_six_bar": Case("watt_six_bar", "crank", turn(0.0), watt_six_bar, (-5, 1)),
    "watt_six_bar, other links": Case(
        "watt_six_bar", "crank", turn(0.0), watt_six_bar, (-5, 1),
        {"r1": 0.35, "r2": 0.09, "r5": 0.17, "r6": 0.27, "r7": 0.2, "gamma": -1.1}),
    "stewart": Case("stewart", "leg_1", LEG + np.linspace(-0.04, 0.06, 21), stewart, (6, 6),
                    hold={f"leg_{k}": LEG for k in range(2, 7)}),
    "delta": Case("delta", "arm_1", np.linspace(-0.5, 1.0, 16), delta, (3, 3),
                  hold={"arm_2": ARMS[0], "arm_3": ARMS[1]}),
    "delta, other links": Case(
        "delta", "arm_1", np.linspace(-0.3, 0.8, 6), delta, (3, 3),
        {"sb": 0.4, "sp": 0.15, "lu": 0.3, "ll": 0.8, "w": 0.1},
        {"arm_2": ARMS[0], "arm_3": ARMS[1]}),
}
MECHANISMS = sorted({case.mechanism for case in CASES.values()})

every_case = pytest.mark.parametrize("name", few(
    CASES, "bennett, other links", "peaucellier", "spherical_four_bar", "oldham, other offset",
    "geared_five_bar", "watt_six_bar, other links", "delta"))
every_mechanism = pytest.mark.parametrize("name", few(
    MECHANISMS, "delta", "geared_five_bar", "sarrus"))


@cache
def loaded(name: str) -> sp.Mechanism:
    return library(CASES[name].mechanism, **CASES[name].parameters)


@cache
def motion(name: str) -> sp.Motion:
    case = CASES[name]
    return sp.sweep(loaded(name), case.driver, case.values, SPEED, ACCELERATION, hold=case.hold)


@cache
def truth(name: str) -> Rates:
    """What the closed form says, one row per driver value, in float64."""
    case = CASES[name]
    rows = [closed_forms.rates(lambda s: case.closed_form(s, **case.parameters), value,
                               SPEED, ACCELERATION) for value in case.values]
    return Rates(*(Pose(*({key: np.array([table[key] for table in tables], dtype=float)
                           for key in tables[0]} for tables in zip(*poses, strict=True)))
                   for poses in zip(*rows, strict=True)))


def check(actual, expected, what: str, tolerance: float = TOLERANCE) -> None:
    """Scalars (N,) or vectors (N, 3): within tolerance (1 + |expected|) in every row."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape, what
    size = np.linalg.norm(expected.reshape(len(expected), -1), axis=1)
    error = np.linalg.norm((actual - expected).reshape(len(expected), -1), axis=1)
    worst = np.max(error / (1 + size))
    assert worst <= tolerance, f"{what}: off by {worst:.1e}"


# ---------------------------------------------------------------- over the full motion


@every_case
def test_motion_is_closed(name):
    turned = motion(name)
    assert len(turned.q) == len(CASES[name].values)
    assert np.max(turned.closure_error) < 1e-12
    assert not turned.events


@every_case
def test_coordinates(name):
    expected, turned, mechanism = truth(name), motion(name), loaded(name)
    for coordinate, value in expected.value.coordinates.items():
        actual = turned.coordinate(coordinate)
        if mechanism.coordinate(coordinate).unit == "rad":  # as counted from the first row on
            value = np.unwrap(value)
            value += 2 * np.pi * np.round((actual[0] - value)[0] / (2 * np.pi))
        check(actual[0], value, coordinate)
        check(actual[1], expected.rate.coordinates[coordinate], f"rate of {coordinate}")
        check(actual[2], expected.acceleration.coordinates[coordinate],
              f"acceleration of {coordinate}")


@every_case
def test_links(name):
    expected = truth(name)
    for link in expected.value.links:
        frame = motion(name).frame(link)
        poses = [pose.links[link] for pose in expected]
        omega, alpha = closed_forms.angular_rates(*(pose[:, :3, :3] for pose in poses))
        check(frame.rotation, poses[0][:, :3, :3], f"rotation of {link}")
        check(frame.position, poses[0][:, :3, 3], f"position of {link}")
        check(frame.velocity, poses[1][:, :3, 3], f"velocity of {link}")
        check(frame.acceleration, poses[2][:, :3, 3], f"acceleration of {link}")
        check(frame.angular_velocity, omega, f"angular velocity of {link}")
        check(frame.angular_acceleration, alpha, f"angular acceleration of {link}")


@every_case
def test_points(name):
    expected = truth(name)
    for point in expected.value.points:
        frame = motion(name).frame(point)
        check(frame.position, expected.value.points[point], f"position of {point}")
        check(frame.velocity, expected.rate.points[point], f"velocity of {point}")
        check(frame.acceleration, expected.acceleration.points[point], f"acceleration of {point}")


@every_case
def test_every_position_assembles_on_this_branch(name):
    case, expected = CASES[name], truth(name).value.coordinates
    for row in range(0, len(case.values), 3):
        closed = sp.assemble(loaded(name), {case.driver: case.values[row], **case.hold})
        for coordinate, values in expected.items():
            gap = closed.coordinate(coordinate)[0] - values[row]
            if loaded(name).coordinate(coordinate).unit == "rad":
                gap = np.remainder(gap + np.pi, 2 * np.pi) - np.pi
            assert abs(gap) < TOLERANCE, f"{coordinate} at {case.values[row]:.3f}"


@pytest.mark.delicate
@every_case
def test_mobility(name):
    mobility = sp.mobility(loaded(name))
    assert (mobility.kutzbach, mobility.dof, len(mobility.passive)) == (*CASES[name].mobility, 0)


@every_mechanism
def test_links_weigh_what_is_drawn(name):
    stated = inertias(name)
    for link in urdf(name).iter("link"):
        if link.get("name") not in stated:
            continue
        drawn = sum((solid(visual) for visual in link.iter("visual")), pin.Inertia.Zero())
        inertia = stated[link.get("name")]
        assert inertia.mass == pytest.approx(drawn.mass, rel=1e-12)
        np.testing.assert_allclose(inertia.lever, drawn.lever, rtol=0, atol=1e-14)
        np.testing.assert_allclose(inertia.inertia, drawn.inertia, rtol=0, atol=1e-14)


@every_mechanism
def test_file_says_what_it_is(name):
    mechanism = library(name)
    assert mechanism.name == name
    assert mechanism.title
    assert any(character.isdigit() for character in mechanism.source)


# ---------------------------------------------------------------- what each is known for


def test_scotch_yoke_is_simple_harmonic():
    turned = motion("scotch_yoke")
    x, speed, acceleration = turned.coordinate("slide")
    check(x, 0.05 * np.cos(turned.driver), "x")
    check(speed, -0.05 * SPEED * np.sin(turned.driver), "speed")
    check(acceleration, -(SPEED**2) * x + ACCELERATION / SPEED * speed, "acceleration")


def test_bennett_half_angles_have_a_constant_product():
    turned = motion("bennett")
    crank, follower = (turned.coordinate(f"{name}_pin")[0] for name in ("crank", "follower"))
    k = np.sin(75 * DEGREE) / np.sin(35 * DEGREE)
    check(np.sin(crank / 2) * np.sin(follower / 2), k * np.cos(crank / 2) * np.cos(follower / 2),
          "tan tan = k")


def test_peaucellier_draws_a_straight_line():
    p = motion("peaucellier").frame("upper_outer_p")
    assert np.max(np.abs(p.position[:, 0] - (0.25**2 - 0.1**2) / (2 * 0.1))) < 1e-13
    assert np.max(np.abs(p.position[:, 1])) < 1e-13
    assert np.max(np.abs(p.velocity[:, :2])) < 1e-12
    assert np.max(np.abs(p.acceleration[:, :2])) < 1e-11


@pytest.mark.delicate
def test_peaucellier_stops_where_the_rhombus_is_flat():
    with pytest.raises(sp.LimitError) as caught:
        sp.sweep(loaded("peaucellier"), "crank", np.linspace(0.0, 2.0, 21))
    assert caught.value.limit == pytest.approx(2 * np.arccos((0.25 - 0.1) / 0.2), abs=1e-7)


def test_spherical_four_bar_is_the_primal_part_of_rccc():
    """A sin t4 + B cos t4 + C = 0, angles counted between the planes of neighbouring links."""
    turned = motion("spherical_four_bar")
    t1, t4 = (turned.coordinate("crank_pin")[0] + np.pi / 2,
              np.pi / 2 - turned.coordinate("rocker_pin")[0])
    (s1, s3, s4), (c1, c3, c4) = (f(np.radians([30, 65, 80])) for f in (np.sin, np.cos))
    residual = (s3 * s1 * np.sin(t1) * np.sin(t4)
                - s3 * (c1 * s4 + s1 * c4 * np.cos(t1)) * np.cos(t4)
                + c3 * (c1 * c4 - s1 * s4 * np.cos(t1)) - np.cos(70 * DEGREE))
    assert np.max(np.abs(residual)) < 1e-12


def test_sarrus_rises_straight():
    platform = motion("sarrus").frame("platform_middle")
    rise = CASES["sarrus"].values
    for vectors in (platform.position, platform.velocity, platform.acceleration):
        assert np.max(np.abs(vectors[:, :2])) < 1e-12
    assert np.max(np.abs(platform.angular_velocity)) < 1e-12
    assert np.max(np.abs(platform.angular_acceleration)) < 1e-11
    check(platform.position[:, 2], 0.2 * np.sin(rise), "height")


def test_bricard_sines_have_a_constant_product():
    turned = motion("bricard")
    hinges = [1 + np.sin(turned.coordinate(f"hinge_{k}")[0]) for k in range(1, 6)]
    for odd, even in ((0, 1), (2, 3), (4, 1)):
        check(hinges[odd] * hinges[even], np.ones(len(turned.driver)), "product")


@pytest.mark.delicate
def test_bricard_ends_at_210_degrees():
    with pytest.raises(sp.LimitError) as caught:
        sp.sweep(loaded("bricard"), "crank", np.linspace(0.0, 4.0, 21))
    assert caught.value.limit == pytest.approx(np.radians(210), abs=1e-7)


def test_oldham_turns_both_shafts_alike():
    turned = motion("oldham")
    for driving, driven in zip(*map(turned.coordinate, ("input_pin", "output_pin")), strict=True):
        assert np.max(np.abs(driven - driving)) < 1e-12
    centre = turned.frame("middle").position - [0.0, 0.0075, 0.0]
    check(np.linalg.norm(centre, axis=1), np.full(len(centre), 0.0075), "the centre's circle")
    twice = np.unwrap(np.arctan2(centre[:, 2], centre[:, 1]))
    assert twice[-1] - twice[0] == pytest.approx(4 * np.pi, abs=1e-11)


def test_geared_five_bar_keeps_its_gear_ratio_over_turns():
    turned = motion("geared_five_bar, other links")
    check(turned.coordinate("right_pin")[0], np.pi - 2 * turned.driver, "right gear")
    check(turned.coordinate("right_pin")[1], np.full(19, -2 * SPEED), "its speed")


def freudenstein(crank, rocker, r1, r2, r3, r4) -> np.ndarray:
    """K1 cos(rocker) - K2 cos(crank) + K3 - cos(crank - rocker)."""
    k3 = (r1**2 + r2**2 - r3**2 + r4**2) / (2 * r2 * r4)
    return (r1 / r2 * np.cos(rocker) - r1 / r4 * np.cos(crank) + k3) - np.cos(crank - rocker)


def test_watt_six_bar_satisfies_freudensteins_equation_twice():
    turned = motion("watt_six_bar")
    crank, rocker, output = (
        turned.coordinate(f"{name}_pin")[0] for name in ("crank", "rocker", "output"))
    first = freudenstein(crank, rocker, 0.30, 0.10, 0.28, 0.24)
    second = freudenstein(rocker - 70 * DEGREE, output, 0.30, 0.15, 0.25, 0.16)
    assert np.max(np.abs([first, second])) < 1e-12


def test_stewart_legs_have_the_lengths_requested():
    """The inverse kinematics, which are plain, applied to the balls of the motion."""
    turned = motion("stewart")
    balls = [turned.frame(f"platform_{k}") for k in range(1, 7)]
    for row in range(len(turned.driver)):
        actual = leg_rates(*(np.array([getattr(ball, what)[row] for ball in balls])
                             for what in ("position", "velocity", "acceleration")))
        held = np.r_[0.0, np.ones(5)]
        check(actual[0], np.where(held, LEG, turned.driver[row]), "lengths", 1e-12)
        check(actual[1], SPEED * (1 - held), "speeds")
        check(actual[2], ACCELERATION * (1 - held), "accelerations")


@pytest.mark.filterwarnings("ignore:.*beyond joint limits")  # some poses are beyond the legs' reach
@pytest.mark.parametrize("seed", few(range(5), 0, 3))
def test_stewart_takes_the_pose_whose_leg_lengths_it_is_given(seed):
    rng = np.random.default_rng(seed)
    shift, turned = rng.uniform(-0.05, 0.05, 3), pin.exp3(rng.uniform(-0.2, 0.2, 3))
    velocity, omega, acceleration, alpha = rng.uniform(-1.0, 1.0, (4, 3))
    arms = TOPS @ turned.T
    spun = np.cross(omega, arms)
    lengths, speeds, accelerations = (
        {f"leg_{k}": float(x) for k, x in enumerate(rates, 1)}
        for rates in leg_rates(
            HOME + shift + arms, velocity + spun,
            acceleration + np.cross(alpha, arms) + np.cross(omega, spun)))
    closed = sp.assemble(loaded("stewart"), lengths)
    closed = sp.solve_rates(loaded("stewart"), closed, speeds, accelerations)
    check(closed.placement("platform").translation, HOME + shift, "position")
    check(closed.placement("platform").rotation, turned, "rotation")
    check(closed.velocity("platform").linear, velocity, "velocity")
    check(closed.angular_velocity("platform"), omega, "angular velocity")
    check(closed.acceleration("platform").linear, acceleration, "acceleration")
    check(closed.angular_acceleration("platform"), alpha, "angular acceleration")


@pytest.mark.parametrize(("degrees", "position"), [
    ((0, 0, 0), (0, 0, -1.06445166)),
    ((10, 20, 30), (0.10813541, -0.18034835, -1.24354125)),
])
def test_delta_forward_kinematics(degrees, position):
    arms = {f"arm_{k}": np.radians(angle) for k, angle in enumerate(degrees, 1)}
    platform = sp.assemble(loaded("delta"), arms).placement("platform")
    np.testing.assert_allclose(platform.translation, position, rtol=0, atol=0.501e-8)
    np.testing.assert_allclose(platform.rotation, np.eye(3), rtol=0, atol=1e-13)


@pytest.mark.delicate
def test_three_cranks_of_a_flat_locomotive_drive_are_no_lack_of_freedom(tmp_path):
    tree, places = mechanisms.turning("q", "crank0", "rod", (0.12, 0, 0.01)), (0.0, 0.25, 0.6)
    for k, x in enumerate(places):
        tree += mechanisms.turning(f"p{k}", "ground", f"crank{k}", (x, 0, 0))
        tree += mechanisms.point(f"f{k}", f"crank{k}", (0.12, 0, 0.01))
        tree += mechanisms.point(f"e{k}", "rod", (x, 0, 0))
    mech = mechanisms.load(tmp_path, "drive", tree, (
        mechanisms.driver("crank", "p0") + mechanisms.closure("h1", "revolute", "e1", "f1")
        + mechanisms.closure("h2", "revolute", "e2", "f2") + mechanisms.guess(p0=0.5, q=-0.5)))
    flat = sp.assemble(mech, {"crank": 0.0})
    with pytest.raises(sp.SingularError, match="singular configuration"):
        sp.solve_rates(mech, flat, {"crank": 1.0})
    with pytest.raises(sp.SingularError, match="singular configuration"):
        sp.sweep(mech, "crank", [0.0, 1.0])
    motion = sp.sweep(mech, "crank", np.linspace(0.5, 60.0, 3000))
    for name in ("p1", "p2"):
        value, rate, acceleration = motion.coordinate(name)
        assert np.abs(value - motion.swept).max() < 1e-11
        assert np.abs(rate - 1.0).max() < 1e-9
        assert np.abs(acceleration).max() < 1e-8
    crossings = [e.value / np.pi for e in motion.events if e.kind == "branch point"]
    assert np.allclose(crossings, np.arange(1, 20), rtol=0.0, atol=1e-9)
