"""The library's classical linkages against what is known of them exactly, over their full motion.

`CASES` lists them with their closed forms in mpmath; what is said about one linkage only follows.
Sources: the papers that the mechanism files name, and the loop equations of [McCarthy2011].
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import closed_forms
import numpy as np
import pinocchio as pin
import pytest
from closed_forms import Pose, Rates, placement, rotation, vector
from mpmath import atan2, cos, mpf, sin
from test_mechanisms import inertias, solid, urdf

import spatial_pin as sp

SPEED, ACCELERATION = 2.5, 7.0  # of every driver [rad/s and rad/s2, or m and s]
TOLERANCE = 1e-11
X, Y, Z = np.eye(3, dtype=int)
UPRIGHT = np.eye(3, dtype=int)  # the orientation of what does not turn


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


def bennett(crank, a=0.10, alpha=np.radians(40), beta=np.radians(110)) -> Pose:
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
}
MECHANISMS = sorted({case.mechanism for case in CASES.values()})

every_case = pytest.mark.parametrize("name", CASES)
every_mechanism = pytest.mark.parametrize("name", MECHANISMS)


@cache
def loaded(name: str) -> sp.Mechanism:
    return sp.load(CASES[name].mechanism, **CASES[name].parameters)


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
        unit = mechanism.coordinate(coordinate).unit
        gap = (actual[0] - value)[0]
        whole_turns = 2 * np.pi * np.round(gap / (2 * np.pi)) if unit == "rad" else 0.0
        check(actual[0], value + whole_turns, coordinate)
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
    mechanism = sp.load(name)
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
    k = np.sin(np.radians(75)) / np.sin(np.radians(35))
    check(np.sin(crank / 2) * np.sin(follower / 2), k * np.cos(crank / 2) * np.cos(follower / 2),
          "tan tan = k")
