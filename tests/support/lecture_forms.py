"""Closed forms of the mechanisms of the EMT 2431 lecture notes, in the style of `closed_forms`.

Functions of one driver value (and of dimensions named as in the URDF) that return a `Pose`; those
of the open chains, at the end, are functions of all driver values.
"""

from __future__ import annotations

import math

import numpy as np
from closed_forms import Pose, placement, plane_link, rotation, vector
from mpmath import acos, asin, atan2, cos, mpf, pi, sin, sqrt, tan

X, Y, Z = vector(1, 0, 0), vector(0, 1, 0), vector(0, 0, 1)
TWENTY_DEGREES, THIRTY_DEGREES = math.radians(20), math.radians(30)


def swash_plate(theta, r=0.06, tilt=TWENTY_DEGREES, h=0.012) -> Pose:
    """Swash-plate drive, Example 1.1: the ball's centre stays in a plane through the origin."""
    r, tilt, h = map(mpf, (r, tilt, h))
    z = r * tan(tilt) * cos(theta)
    plate = rotation(Z, theta)
    normal = plate.dot(vector(-sin(tilt), 0, cos(tilt)))
    ball = vector(r, 0, z)
    return Pose(
        coordinates={"shaft": theta, "slide": z},
        links={
            "rotor": placement(plate, vector(0, 0, 0)),
            "piston": placement(rotation(Z, 0), ball),
        },
        points={
            "slipper": ball,
            "slipper_foot": ball - h * normal,
            "plate_face": -h * normal,
        },
    )


def inverted_slider_crank(phi, ac=0.15, bc=0.20, ad=0.35) -> Pose:
    """Inverted slider-crank, exercise 3.6, with the slider on the bar's side of A."""
    ac, bc, ad = map(mpf, (ac, bc, ad))
    s = ac * cos(phi) + sqrt(bc**2 - (ac * sin(phi)) ** 2)
    rocker = phi + asin(ac * sin(phi) / bc)
    x, z = s * cos(phi), s * sin(phi)
    return Pose(
        coordinates={"bar_pin": phi, "slide": s, "rocker_pin": rocker},
        links={
            "bar": plane_link(phi, 0, 0),
            "slider": plane_link(phi, x, z),
            "rocker": plane_link(rocker, ac, 0),
        },
        points={"rocker_b": vector(x, 0, z), "bar_d": vector(ad * cos(phi), 0, ad * sin(phi))},
    )


def elliptic_trammel(theta, l=0.45, handle=0.25) -> Pose:  # noqa: E741 (l as in the URDF)
    """Two sliders at right angles, Example 7.1, by the angle of the link."""
    l, handle = mpf(l), mpf(handle)  # noqa: E741
    a, b = vector(l * cos(theta), 0, 0), vector(0, l * sin(theta), 0)
    still = rotation(Z, 0)
    return Pose(
        coordinates={"slide_a": a[0], "slide_b": b[1], "pin_a": theta},
        links={
            "slider_a": placement(still, a),
            "slider_b": placement(still, b),
            "link": placement(rotation(Z, -theta), a),
        },
        points={
            "link_b": b,
            "handle": vector((l + handle) * cos(theta), -handle * sin(theta), 0),
        },
    )


def crank_collar(phi, a=0.050, h=0.075, l=0.175) -> Pose:  # noqa: E741 (l as in the URDF)
    """Crank, ball, link, pin and collar on a rod, Example 7.2, collar on the side of +y."""
    a, h, l = map(mpf, (a, h, l))  # noqa: E741
    ball = vector(a * sin(phi), 0, a * cos(phi))
    distance = sqrt(ball[0] ** 2 + (h - ball[2]) ** 2)
    angle, gamma = atan2(-ball[0], h - ball[2]), asin(distance / l)
    b = vector(0, sqrt(l**2 - distance**2), h)
    collar = rotation(Y, angle)
    return Pose(
        coordinates={
            "crank_pin": phi, "collar.angle": angle, "collar.slide": b[1], "link_pin": gamma,
        },
        links={
            "crank": placement(rotation(Y, phi), vector(0, 0, 0)),
            "collar": placement(collar, b),
            "link": placement(collar.dot(rotation(X, gamma)), b),
        },
        points={"crank_a": ball, "link_a": ball},
    )


def rssr_crossed(phi, a=0.10, b=0.44, c=0.24, x0=0.20, y0=0.30) -> Pose:
    """General RSSR of section 7.4, eq. 48 and 49: E sin psi + F cos psi + G = 0, upper root."""
    a, b, c, x0, y0 = map(mpf, (a, b, c, x0, y0))
    A = vector(a * sin(phi), 0, a * cos(phi))
    E, F = -2 * c * y0, -2 * c * A[2]
    G = (x0 - A[0]) ** 2 + y0**2 + c**2 + A[2] ** 2 - b**2
    psi = atan2(E, F) + acos(-G / sqrt(E**2 + F**2))
    B = vector(x0, y0 - c * sin(psi), c * cos(psi))
    return Pose(
        coordinates={"crank_pin": phi, "rocker_pin": psi},
        links={
            "crank": placement(rotation(Y, phi), vector(0, 0, 0)),
            "rocker": placement(rotation(X, psi), vector(x0, y0, 0)),
        },
        points={"coupler": A, "coupler_b": B, "rocker_b": B},
    )


def screw_press(theta, height=0.40, width=0.30, hang=0.13, lead=0.010) -> Pose:
    """Screw press R-H-P: the platen moves down by lead theta / 2 pi (`width` moves nothing)."""
    height, hang, lead = map(mpf, (height, hang, lead))
    stroke = lead * theta / (2 * pi)
    foot = vector(0, 0, height - hang - stroke)
    return Pose(
        coordinates={"screw": theta, "slide": stroke},
        links={
            "spindle": placement(rotation(Z, -theta), vector(0, 0, height - stroke)),
            "platen": placement(rotation(Z, 0), foot),
        },
        points={"spindle_foot": foot},
    )


def ahead(theta, gain):
    """The angle whose tangent is gain tan(theta), on the same turn as theta."""
    s, c = sin(theta), cos(theta)
    return theta + atan2((gain - 1) * s * c, c**2 + gain * s**2)


def across(first, second) -> np.ndarray:
    """Rotation of a cross whose y and z axes are the given unit vectors."""
    x = vector(
        first[1] * second[2] - first[2] * second[1],
        first[2] * second[0] - first[0] * second[2],
        first[0] * second[1] - first[1] * second[0],
    )
    return np.stack([x, first, second], axis=1)


def hooke_joint(theta, beta=THIRTY_DEGREES, length=0.20) -> Pose:
    """Hooke's joint, the input's pins in the plane of the shafts at 0 (`length` moves nothing)."""
    beta = mpf(beta)
    out = ahead(theta, 1 / cos(beta))
    shafts = rotation(X, theta), rotation(Z, beta).dot(rotation(X, out))
    here = vector(0, 0, 0)
    return Pose(
        coordinates={"input": theta, "output": out, "cross_pin": asin(sin(beta) * sin(out))},
        links={
            "input_shaft": placement(shafts[0], here),
            "output_shaft": placement(shafts[1], here),
            "cross": placement(across(shafts[0].dot(Y), shafts[1].dot(Z)), here),
        },
        points={"output_fork": here},
    )


def double_cardan(
    theta, beta_1=THIRTY_DEGREES, beta_2=THIRTY_DEGREES, phase=0.0, span=0.25, length=0.16
) -> Pose:
    """Two Hooke's joints in a row (`length` moves nothing)."""
    beta_1, beta_2, phase, span = map(mpf, (beta_1, beta_2, phase, span))
    middle = ahead(theta, 1 / cos(beta_1))
    out = ahead(middle + phase, cos(beta_2))
    shafts = (
        rotation(Z, beta_1).dot(rotation(X, theta)),
        rotation(X, middle),
        rotation(Z, beta_2).dot(rotation(X, out)),
    )
    near, far = vector(0, 0, 0), vector(span, 0, 0)
    second_pins = rotation(X, middle + phase).dot(Z)
    return Pose(
        coordinates={"input": theta, "middle": middle, "output": out},
        links={
            "input_shaft": placement(shafts[0], near),
            "middle_shaft": placement(shafts[1], near),
            "output_shaft": placement(shafts[2], far),
            "cross_1": placement(across(shafts[0].dot(Y), shafts[1].dot(Z)), near),
            "cross_2": placement(across(shafts[2].dot(Y), second_pins), far),
        },
        points={"middle_fork_1": near, "output_fork": far},
    )


# ---------------------------------------------------------------- open chains


def satellite_dish(pan, tilt, oa=1.4) -> Pose:
    """Satellite dish, Example 7.4."""
    mount, here = rotation(Z, pan), vector(0, 0, 0)
    dish = mount.dot(rotation(X, tilt))
    return Pose(
        coordinates={"pan": pan, "tilt": tilt},
        links={"mount": placement(mount, here), "dish": placement(dish, here)},
        points={"horn": mpf(oa) * dish.dot(Y)},
    )


def crane(slew, luff, l=12.0) -> Pose:  # noqa: E741 (l as in the URDF)
    """Crane, exercise 7.6: y is up."""
    cab, here = rotation(Y, slew), vector(0, 0, 0)
    boom = cab.dot(rotation(Z, luff))
    return Pose(
        coordinates={"slew": slew, "luff": luff},
        links={"cab": placement(cab, here), "boom": placement(boom, here)},
        points={"tip": mpf(l) * boom.dot(X)},
    )


def rotating_rod_link(rod, theta, l=0.8) -> Pose:  # noqa: E741 (l as in the URDF)
    """Link hinged on a rotating vertical rod, assignment 7.5 (b)."""
    turned, here = rotation(Z, rod), vector(0, 0, 0)
    link = turned.dot(rotation(X, -theta))
    return Pose(
        coordinates={"rod_pin": rod, "link_pin": theta},
        links={"rod": placement(turned, here), "link": placement(link, here)},
        points={"link_a": mpf(l) * turned.dot(vector(0, sin(theta), cos(theta)))},
    )


def turntable_collar(turntable, shaft, slide, oa=0.30, rod=0.45) -> Pose:
    """Collar on a rod on a shaft on a turntable, assignment 7.5 (a) (`rod` moves nothing)."""
    table = rotation(Z, turntable)
    turned, here = table.dot(rotation(Y, shaft)), vector(0, 0, 0)
    a = mpf(oa) * table.dot(Y)
    collar = a + slide * turned.dot(Z)
    return Pose(
        coordinates={"turntable_pin": turntable, "shaft_pin": shaft, "slide": slide},
        links={
            "turntable": placement(table, here),
            "shaft": placement(turned, here),
            "collar": placement(turned, collar),
        },
        points={"shaft_a": a},
    )
