"""The excavator: its cylinders' triangles and four-bar in closed form, and the maker's table."""

from __future__ import annotations

from math import acos, atan2, hypot

import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from scipy.interpolate import CubicSpline

import spatial_pin as sp

STROKES = {"boom": (2.0, 3.334), "arm": (2.244, 3.734), "bucket": (1.6, 2.72)}  # lengths [m]
SECONDS = [0.0, 2.0, 3.5, 5.0, 6.5, 8.0, 10.0]
DIG = {"boom": [2.89, 2.76, 2.70, 2.665, 2.64, 2.70, 3.00],
       "arm": [2.70, 2.67, 2.75, 2.86, 2.985, 3.09, 3.15],
       "bucket": [2.09, 2.09, 2.23, 2.385, 2.54, 2.67, 2.70]}


def digs(samples: int) -> sp.Motion:
    times = np.linspace(0.0, 10.0, samples)
    return sp.follow(library("excavator"), {
        name: CubicSpline(SECONDS, x, bc_type="clamped")(times) for name, x in DIG.items()}, times)


def triangle(a: float, b: float, c: float) -> float:
    """The angle between sides a and b of a triangle with the third side c."""
    return acos((a * a + b * b - c * c) / (2 * a * b))


def boom_pin(length: float) -> float:
    base, lug = (0.58, -0.58), (2.62, 0.86)
    return (triangle(hypot(*base), hypot(*lug), length)
            + atan2(base[1], base[0]) - atan2(lug[1], lug[0]))


def arm_pin(length: float) -> float:
    base, lug = (2.95 - 5.7, 1.32), (-0.87, 0.23)  # from the arm's pin, of boom and of arm
    return (atan2(base[1], base[0]) - triangle(hypot(*base), hypot(*lug), length)
            - atan2(lug[1], lug[0]))


def bucket_pin(length: float) -> float:
    base, ground, tipping, connecting, lug = (0.36, 0.50), 0.425, 0.64, 0.62, 0.47
    tip = np.array([2.925 - ground, 0.03])
    back = np.array(base) - tip
    turned = atan2(back[1], back[0]) - triangle(hypot(*back), tipping, length)
    end = tip + tipping * np.array([np.cos(turned), np.sin(turned)]) - np.array([2.925, 0.0])
    return (atan2(end[1], end[0]) - triangle(hypot(*end), lug, connecting)
            - np.radians(98.0))


FORMS = {"boom_pin": ("boom", boom_pin), "arm_pin": ("arm", arm_pin),
         "bucket_pin": ("bucket", bucket_pin)}


def test_a_dig_is_that_of_the_triangles():
    motion = digs(200)
    assert motion.closure_error.max() < 1e-14 and not motion.events
    for pin_, (driver, form) in FORMS.items():
        expected = [form(x) for x in motion.coordinate(driver).value]
        off = np.array(expected) - motion.coordinate(pin_).value
        assert np.abs(off).max() < 1e-13


def test_rates_of_a_dig_are_those_of_the_triangles():
    """By the chain rule; differences of fourth order of the closed forms."""
    motion, h = digs(200), 5e-4
    for k in (20, 111, 160):
        for pin_, (driver, form) in FORMS.items():
            length, rate, acceleration = (series[k] for series in motion.coordinate(driver))
            x = [form(length + j * h) for j in (-2, -1, 0, 1, 2)]
            slope = (x[0] - 8 * x[1] + 8 * x[3] - x[4]) / (12 * h)
            curved = (-x[0] + 16 * x[1] - 30 * x[2] + 16 * x[3] - x[4]) / (12 * h * h)
            _, found_rate, found = (series[k] for series in motion.coordinate(pin_))
            assert found_rate == pytest.approx(slope * rate, abs=1e-9)
            assert found == pytest.approx(slope * acceleration + curved * rate**2, abs=1e-8)


def test_cylinders_work_as_much_as_the_energy_grows():
    times = np.linspace(0.0, 3.0, 601)
    mechanism = library("excavator")
    motion = sp.follow(mechanism, {"boom": 2.7 + 0.2 * np.sin(times), "bucket": 2.2 + 0.1 * times,
                                   "arm": 3.0 + 0.3 * np.sin(2.0 * times)}, times)
    data, energy = mechanism.model.createData(), []
    for q, v in zip(motion.q, motion.v, strict=True):
        energy.append(pin.computeMechanicalEnergy(mechanism.model, data, q, v))
    efforts = sp.kinetostatics(mechanism, motion).efforts
    power = sum(efforts[name] * motion.coordinate(name).rate for name in DIG)
    grown = CubicSpline(times, energy)(times, 1)
    assert np.abs(grown - power)[5:-5].max() < 1e-5 * np.abs(power).max()


def at(**lengths: float) -> sp.State:
    mechanism = library("excavator")
    return sp.assemble(mechanism, lengths)


def test_it_gets_where_the_makers_table_says():
    """Digging depth 6620, height 10000, dumping height 7110, reach 9875, on the ground 9700 mm."""
    shut = {name: ends[0] for name, ends in STROKES.items()}
    reached = []
    for bucket in np.linspace(1.75, 1.9, 7):  # teeth, arm and boom in line somewhere here
        state = at(boom=2.75, arm=shut["arm"], bucket=bucket)
        foot = state.placement("boom").translation
        reached.append(np.linalg.norm(state.placement("teeth").translation - foot))
    radius = max(reached)
    assert foot[0] + radius == pytest.approx(9.875, rel=0.005)
    assert foot[0] + (radius**2 - foot[2] ** 2) ** 0.5 == pytest.approx(9.700, rel=0.005)
    deepest = at(boom=shut["boom"], arm=3.0, bucket=2.0)
    elbow = deepest.placement("arm").translation[2]
    assert elbow - 2.925 - 1.48 == pytest.approx(-6.620, rel=0.01)  # arm and bucket hang down
    highest = at(boom=STROKES["boom"][1], arm=shut["arm"], bucket=shut["bucket"])
    assert highest.placement("teeth").translation[2] == pytest.approx(10.0, rel=0.005)
    assert highest.placement("bucket").translation[2] - 1.48 == pytest.approx(7.110, rel=0.005)


def test_it_digs_into_the_ground_and_swings():
    motion = digs(50)
    teeth = motion.frame("teeth").position
    assert teeth[:, 2].min() < -0.8 and teeth[-1, 2] > 1.0 and np.ptp(teeth[:, 0]) > 2.0
    there = sp.reach(motion.mechanism, {"teeth": [3.0, -4.0, 0.5]}, motion.state(0))
    assert there.coordinate("swing").value == pytest.approx(atan2(-4.0, 3.0), abs=1e-12)


def test_other_dimensions_assemble():
    longer = library("excavator", arm=3.2, bucket=1.3)
    state = sp.assemble(longer)
    reach = np.linalg.norm(state.placement("bucket").translation
                           - state.placement("arm").translation)
    assert state.closure_error < 1e-13 and reach == pytest.approx(3.2, abs=1e-12)
