"""Ranges of drivers, curves of closed configurations, Grashof types."""

from math import acos, pi

import mechanisms
import numpy as np
import pytest

import spatial_pin as sp


def test_a_crank_rocker_turns_its_crank_all_the_way():
    found = sp.limits(sp.load("four_bar"), "crank")
    assert found.full_turn
    assert str(found) == "crank: full turn"


def test_the_rocker_of_a_crank_rocker_swings_between_the_dead_centres():
    r1, r2, r3, r4 = 0.30, 0.10, 0.28, 0.24
    found = sp.limits(sp.load("four_bar", r1=r1, r2=r2, r3=r3, r4=r4), "rocker_pin")
    stretched, folded = (acos((r1**2 + r4**2 - (r3 + s * r2)**2) / (2 * r1 * r4)) for s in (1, -1))
    ends = sorted((pi - stretched, pi - folded))
    assert (found.lower.value, found.upper.value) == pytest.approx(ends, abs=1e-13)
    assert found.lower.kind == found.upper.kind == "limit"


def test_a_slider_crank_slides_between_its_dead_centres():
    found = sp.limits(sp.load("slider_crank", r=0.05, l=0.16), "slide")
    assert (found.lower.value, found.upper.value) == pytest.approx((0.11, 0.21), abs=1e-14)


def test_a_joint_of_an_open_tree_has_no_limit():
    found = sp.limits(sp.load("satellite_dish"), next(iter(sp.load("satellite_dish").drivers)))
    assert found.full_turn


NON_GRASHOF = {"r1": 0.3, "r2": 0.2, "r3": 0.2, "r4": 0.2}


def test_the_curve_of_a_non_grashof_linkage_is_traced_through_both_limits():
    motion = sp.trace(sp.load("four_bar", **NON_GRASHOF), "crank")
    limit = acos((0.3**2 + 0.2**2 - 0.4**2) / (2 * 0.3 * 0.2))
    values = sorted(event.value for event in motion.events)
    assert values == pytest.approx([-limit, limit], abs=1e-13)
    assert {event.kind for event in motion.events} == {"limit"}
    assert motion.driver.max() <= limit
    np.testing.assert_allclose(motion.q[-1], motion.q[0], atol=1e-12)
    assert motion.closure_error.max() < 1e-13


def test_a_curve_that_is_not_closed_within_its_rows_says_so():
    mechanism = sp.load("four_bar")
    whole = sp.trace(mechanism, "crank", step=0.1)
    assert "not closed" not in {event.kind for event in whole.events}
    part = sp.trace(mechanism, "crank", step=0.1, most_rows=len(whole) - 2)
    last = part.events[-1]
    assert (last.kind, last.row, last.value) == ("not closed", len(part), part.driver[-1])
    assert f"not closed within {len(part)} samples" in last.text
    np.testing.assert_array_equal(part.q, whole.q[: len(part)])
    for rows in (0, -1):
        with pytest.raises(ValueError, match=r"most_rows is .*must be positive"):
            sp.trace(mechanism, "crank", most_rows=rows)


@pytest.mark.parametrize("name", ["four_bar", "rssr", "rspc"])
def test_rates_along_a_traced_curve_are_derivatives_with_respect_to_its_length(name):
    mechanism = sp.load(name)
    motion = sp.trace(mechanism, "crank", step=1e-3, most_rows=40)
    c = [c.v for c in mechanism.coordinate_table.values() if c.q >= 0]
    q = [c.q for c in mechanism.coordinate_table.values() if c.q >= 0]
    length = np.linalg.norm(motion.v / mechanism.velocity_scale, axis=1)
    np.testing.assert_allclose(length, 1.0, atol=1e-12)
    slope = (motion.q[2:, q] - motion.q[:-2, q]) / 2e-3
    np.testing.assert_allclose(slope, motion.v[1:-1][:, c], atol=1e-5)
    bend = (motion.v[2:, c] - motion.v[:-2, c]) / 2e-3
    np.testing.assert_allclose(bend, motion.a[1:-1][:, c], atol=1e-4)


def test_a_traced_curve_goes_straight_on_where_branches_cross():
    motion = sp.trace(sp.load("four_bar", r1=0.3, r2=0.1, r3=0.3, r4=0.1), "crank",
                      {"crank_pin": 1.0, "rocker_pin": 1.0})
    np.testing.assert_allclose(motion.coordinate("rocker_pin").value, motion.driver, atol=1e-9)
    assert motion.driver[-1] == pytest.approx(1.0 + 2 * np.pi, abs=1e-12)
    assert [e.kind for e in motion.events] == ["branch point"] * 2
    np.testing.assert_allclose([e.value for e in motion.events], [np.pi, 2 * np.pi], atol=1e-9)


@pytest.mark.parametrize(("lengths", "kind"), [
    ((0.30, 0.10, 0.28, 0.24), "crank-rocker"),
    ((0.10, 0.30, 0.28, 0.24), "double crank"),
    ((0.30, 0.24, 0.10, 0.28), "double rocker"),
    ((0.28, 0.24, 0.30, 0.10), "rocker-crank"),
    ((0.30, 0.20, 0.20, 0.20), "triple rocker"),
    ((0.30, 0.10, 0.30, 0.10), "change point"),
])
def test_grashof_types(lengths, kind):
    mechanism = sp.load("four_bar", **dict(zip(("r1", "r2", "r3", "r4"), lengths, strict=True)))
    state = sp.assemble(mechanism, {}, {"crank_pin": 1.0})
    found = sp.grashof(mechanism, state)
    assert found.type == kind
    np.testing.assert_allclose(list(found.lengths.values()), lengths, atol=1e-12)
    assert list(found.lengths) == ["ground", "crank", "coupler", "rocker"]


def test_only_plane_four_bars_have_a_grashof_type():
    for name in ("rssr", "slider_crank", "bennett"):
        with pytest.raises(sp.SpatialPinError, match="Grashof"):
            sp.grashof(sp.load(name))


@pytest.mark.parametrize("values", [[1.5, -0.5], np.linspace(1.5, -0.1, 50)])
def test_a_slide_that_runs_away_is_named(tmp_path, values):
    """A slide along a crank reaches a wall until they are parallel: nearer values do not help."""
    tree = (mechanisms.turning("pin", "ground", "crank")
            + mechanisms.sliding("out", "crank", "block", axis=(1, 0, 0))
            + mechanisms.point("wall", "ground", (0, 1, 0)))
    mech = mechanisms.load(tmp_path, "runaway", tree, mechanisms.driver("crank", "pin")
                           + mechanisms.closure("on_wall", "point_on_plane", "wall", "block",
                                                axis=(0, 1, 0)) + mechanisms.guess(pin=1.5, out=1))
    with pytest.raises(sp.SingularError, match=r"out has run away to [0-9]+ m") as caught:
        sp.sweep(mech, "crank", values)
    last = caught.value.motion.state(-1)
    assert last.coordinate("out").value == pytest.approx(
        1.0 / np.sin(last.coordinate("crank").value), rel=1e-12)
