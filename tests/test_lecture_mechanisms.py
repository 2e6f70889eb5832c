"""Printed numbers and formulas of the EMT 2431 lecture notes, from the library's mechanisms."""

from __future__ import annotations

import numpy as np
import pytest

import spatial_pin as sp

TOLERANCE = 1e-11
X, Y, Z = np.eye(3)


def moving(name: str, values: dict, speeds: dict, accelerations: dict | None = None,
           **dimensions) -> sp.State:
    mechanism = sp.load(name, **dimensions)
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
    mechanism = sp.load(name)
    assert mechanism.title
    assert mechanism.source.startswith("EMT 2431 lecture notes")


# ---------------------------------------------------------------- loops


def test_swash_plate_example_1_1():
    mechanism = sp.load("swash_plate")
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
    x, y, _ = sp.sweep(sp.load("elliptic_trammel"), "pin_a", np.linspace(0, 2 * np.pi, 73)).frame(
        "handle").position.T
    check((x / 0.70) ** 2 + (y / 0.25) ** 2, np.ones(73))


def test_elliptic_trammel_slider_turns_back_at_the_end_of_its_slot():
    mechanism = sp.load("elliptic_trammel")
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
