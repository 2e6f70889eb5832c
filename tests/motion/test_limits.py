"""Ranges of drivers, curves of closed configurations, Grashof types."""

from math import acos, pi

import mechanisms
import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from variety import few, paired

import spatial_pin as sp


def test_a_crank_rocker_turns_its_crank_all_the_way():
    found = sp.limits(library("four_bar"), "crank")
    assert found.full_turn
    assert str(found) == "crank: full turn"


@pytest.mark.delicate
def test_the_rocker_of_a_crank_rocker_swings_between_the_dead_centres():
    r1, r2, r3, r4 = 0.30, 0.10, 0.28, 0.24
    found = sp.limits(library("four_bar", r1=r1, r2=r2, r3=r3, r4=r4), "rocker_pin")
    stretched, folded = (acos((r1**2 + r4**2 - (r3 + s * r2)**2) / (2 * r1 * r4)) for s in (1, -1))
    ends = sorted((pi - stretched, pi - folded))
    assert (found.lower.value, found.upper.value) == pytest.approx(ends, abs=1e-13)
    assert found.lower.kind == found.upper.kind == "limit"


def test_a_slider_crank_slides_between_its_dead_centres():
    found = sp.limits(library("slider_crank", r=0.05, l=0.16), "slide")
    assert (found.lower.value, found.upper.value) == pytest.approx((0.11, 0.21), abs=1e-14)


def test_a_joint_of_an_open_tree_has_no_limit():
    found = sp.limits(library("satellite_dish"), next(iter(library("satellite_dish").drivers)))
    assert found.full_turn


NON_GRASHOF = {"r1": 0.3, "r2": 0.2, "r3": 0.2, "r4": 0.2}


@pytest.mark.delicate
def test_the_curve_of_a_non_grashof_linkage_is_traced_through_both_limits():
    motion = sp.trace(library("four_bar", **NON_GRASHOF), "crank")
    limit = acos((0.3**2 + 0.2**2 - 0.4**2) / (2 * 0.3 * 0.2))
    values = sorted(event.value for event in motion.events)
    assert values == pytest.approx([-limit, limit], abs=1e-13)
    assert {event.kind for event in motion.events} == {"limit"}
    assert motion.driver.max() <= limit
    np.testing.assert_allclose(motion.q[-1], motion.q[0], atol=1e-12)
    assert motion.closure_error.max() < 1e-13


def test_a_curve_that_is_not_closed_within_its_rows_says_so():
    mechanism = library("four_bar")
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


def test_a_traced_motion_has_the_names_of_what_was_held():
    mech = library("delta")
    assert sp.trace(mech, "arm_1", hold=["arm_2"], most_rows=3).held == ("arm_2",)
    assert sp.trace(mech, "arm_1", hold=None, most_rows=3).held == ()


@pytest.mark.parametrize("name", ["four_bar", "rssr", "rspc"])
def test_rates_along_a_traced_curve_are_derivatives_with_respect_to_its_length(name):
    mechanism = library(name)
    motion = sp.trace(mechanism, "crank", step=1e-3, most_rows=40)
    c = [c.v for c in mechanism.coordinate_table.values() if c.q >= 0]
    q = [c.q for c in mechanism.coordinate_table.values() if c.q >= 0]
    length = np.linalg.norm(motion.v / mechanism.velocity_scale, axis=1)
    np.testing.assert_allclose(length, 1.0, atol=1e-12)
    slope = (motion.q[2:, q] - motion.q[:-2, q]) / 2e-3
    np.testing.assert_allclose(slope, motion.v[1:-1][:, c], atol=1e-5)
    bend = (motion.v[2:, c] - motion.v[:-2, c]) / 2e-3
    np.testing.assert_allclose(bend, motion.a[1:-1][:, c], atol=1e-4)


@pytest.mark.delicate
def test_a_traced_curve_goes_straight_on_where_branches_cross():
    motion = sp.trace(library("four_bar", r1=0.3, r2=0.1, r3=0.3, r4=0.1), "crank",
                      {"crank_pin": 1.0, "rocker_pin": 1.0})
    np.testing.assert_allclose(motion.coordinate("rocker_pin").value, motion.driver, atol=1e-9)
    assert motion.driver[-1] == pytest.approx(1.0 + 2 * np.pi, abs=1e-12)
    assert [e.kind for e in motion.events] == ["branch point"] * 2
    np.testing.assert_allclose([e.value for e in motion.events], [np.pi, 2 * np.pi], atol=1e-9)


@pytest.mark.delicate
@pytest.mark.parametrize(("lengths", "kind"), [
    ((0.30, 0.10, 0.28, 0.24), "crank-rocker"),
    ((0.10, 0.30, 0.28, 0.24), "double-crank"),
    ((0.30, 0.24, 0.10, 0.28), "double-rocker"),
    ((0.28, 0.24, 0.30, 0.10), "rocker-crank"),
    ((0.30, 0.20, 0.20, 0.20), "triple-rocker"),
    ((0.30, 0.10, 0.30, 0.10), "change point"),
])
def test_grashof_types(lengths, kind):
    mechanism = library("four_bar", **dict(zip(("r1", "r2", "r3", "r4"), lengths, strict=True)))
    state = sp.assemble(mechanism, {}, {"crank_pin": 1.0})
    found = sp.grashof(mechanism, state)
    assert found.type == kind
    np.testing.assert_allclose(list(found.lengths.values()), lengths, atol=1e-12)
    assert list(found.lengths) == ["ground", "crank", "coupler", "rocker"]


def test_only_plane_four_bars_have_a_grashof_type():
    for name in ("rssr", "slider_crank", "bennett"):
        with pytest.raises(sp.SpatialPinError, match="Grashof"):
            sp.grashof(library(name))


# ---------------------------------------------------------------- joints that run away


RIGHT = np.pi / 2  # of an arm's angle, at which a slide along it is parallel to the wall


@pytest.fixture
def to_a_wall(tmp_path):
    """A slide along a turning arm whose end stays in a wall at x = 1: at 1 / cos(arm)."""
    tree = (mechanisms.turning("pin", "ground", "arm")
            + mechanisms.sliding("out", "arm", "block", axis=(1, 0, 0))
            + mechanisms.point("wall", "ground", (1, 0, 0)))
    return mechanisms.load(tmp_path, "runaway", tree, mechanisms.driver("arm", "pin")
                           + mechanisms.closure("on_wall", "point_on_plane", "wall", "block",
                                                axis=(1, 0, 0)) + mechanisms.guess(pin=0.1, out=1))


@pytest.mark.delicate
@pytest.mark.parametrize("degrees", [
    [0, 95], np.linspace(0, 91, 30),
    *(pytest.param(x, marks=pytest.mark.slow) for x in (
        [0, 89.99, 95], [0, 30, 60, 85, 95], [0, 90], [60, 120], [0, 270], [0, 80, 95, 20],
        [0, 89.9999], np.linspace(0, 180, 1000)))])
def test_a_slide_that_runs_away_is_an_end_at_its_asymptote(to_a_wall, degrees):
    """Between two samples, beside one, or right at one: no other branch is jumped to."""
    values = np.radians(degrees)
    with pytest.raises(sp.LimitError, match="out runs away without end towards arm = 1"
                       ) as caught:
        sp.sweep(to_a_wall, "arm", values)
    assert caught.value.limit == pytest.approx(RIGHT, abs=1e-13)
    stopped = sp.sweep(to_a_wall, "arm", values, on_limit="stop")
    event = stopped.events[-1]
    assert (event.kind, event.row) == ("limit", len(stopped))
    assert event.value == pytest.approx(RIGHT, abs=1e-13)
    for motion in (caught.value.motion, stopped):
        arm, out = (motion.coordinate(name).value for name in ("pin", "out"))
        assert 0 < len(motion) < len(values) and arm.max() < RIGHT
        np.testing.assert_allclose(out * np.cos(arm), 1.0, rtol=1e-11)
        np.testing.assert_array_equal(arm, values[:len(motion)])


@pytest.mark.parametrize(("first", "last", "end"), [
    (-1.0, -2.0, -RIGHT), pytest.param(np.pi, 1.0, RIGHT, marks=pytest.mark.slow),
    (np.pi, 5.0, 3 * RIGHT)])
def test_a_slide_runs_away_on_either_side_of_its_asymptote(to_a_wall, first, last, end):
    """Beyond a right angle the slide is behind the pin; from there no way leads back either."""
    with pytest.raises(sp.LimitError) as caught:
        sp.sweep(to_a_wall, "arm", [first, last], guess={"pin": first, "out": 1 / np.cos(first)})
    assert caught.value.limit == pytest.approx(end, abs=1e-13)


def test_values_before_an_asymptote_are_reached(to_a_wall):
    arm = np.radians([0, 80, 89, 89.9, 0, -89.9])
    out = sp.sweep(to_a_wall, "arm", arm).coordinate("out").value
    np.testing.assert_allclose(out, 1 / np.cos(arm), rtol=1e-9)


def test_limits_are_asymptotes(to_a_wall):
    span = sp.limits(to_a_wall, "arm")
    assert span.lower.kind == span.upper.kind == "out runs away"
    np.testing.assert_allclose([span.lower.value, span.upper.value], [-RIGHT, RIGHT], atol=1e-13)
    assert not span.full_turn and "(90°) (out runs away)" in str(span)


@pytest.mark.parametrize("n", few([4, 12, 60, 400], 12, 400))
def test_several_drivers_end_where_a_joint_runs_away(tmp_path, n):
    """A slide on two arms that turn about one line, each by its table."""
    tree = (mechanisms.turning("pin", "ground", "arm") + mechanisms.turning("fine", "arm", "hand")
            + mechanisms.sliding("out", "hand", "block", axis=(1, 0, 0))
            + mechanisms.point("wall", "ground", (1, 0, 0)))
    mech = mechanisms.load(tmp_path, "two_arms", tree, mechanisms.driver("pin", "pin")
                           + mechanisms.driver("fine", "fine")
                           + mechanisms.closure("on_wall", "point_on_plane", "wall", "block",
                                                axis=(1, 0, 0)) + mechanisms.guess(out=1))
    times = np.linspace(0.0, 2.0, n)
    tables = {"pin": times, "fine": 0.3 * np.sin(2 * times)}
    law = CubicSpline(times, tables["pin"] + tables["fine"])
    end = brentq(lambda t: law(t) - RIGHT, 1.0, 2.0, xtol=1e-15)
    with pytest.raises(sp.LimitError, match="out runs away without end towards it") as caught:
        sp.follow(mech, tables, times)
    assert caught.value.limit == pytest.approx(end, abs=1e-11)
    stopped = sp.follow(mech, tables, times, on_limit="stop")
    assert len(stopped) == len(caught.value.motion) == np.searchsorted(times, end)
    assert stopped.events[-1].kind == "limit"
    assert stopped.events[-1].value == pytest.approx(end, abs=1e-11)


def away_by(kind: str) -> sp.Mechanism:
    """Return an arm with something along it whose end stays in a wall: no slide of the tree."""
    at = [pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])) for x in (0.0, 1.0)]
    wall = sp.closures.point_on_plane(("universe", at[1]), ("body", at[0]), axis=[1, 0, 0])
    model, closures, place = pin.Model(), [wall], [1.0]
    arm = model.addJoint(0, pin.JointModelRZ(), at[0], "arm")
    if kind == "screw":
        model.addJoint(arm, pin.JointModelHX(0.3 / (2 * np.pi)), at[0], "body")
        place = [2 * np.pi / 0.3]
    elif kind == "planar":
        model.addJoint(0, pin.JointModelPlanar(), at[0], "body")
        closures += [sp.closures.point_on_line(("arm", at[0]), ("body", at[0]), axis=[1, 0, 0]),
                     sp.closures.perpendicular(("universe", at[0]), ("body", at[0]),
                                               axis=[1, 0, 0], axis2=[0, 1, 0])]
        place += [0.1, 0.0]
    else:
        model.addJoint(0, pin.JointModelFreeFlyer(), at[0], "body")
        closures.append(sp.closures.prismatic(("arm", at[0]), ("body", at[0]), axis=[1, 0, 0]))
        place += [0.1, 0.0, 0.0, 0.0, 0.1]
    guess = {"arm": 0.1, "body": place if len(place) > 1 else place[0]}
    return sp.Mechanism.from_model(model, closures, drivers=["arm"], guess=guess, name=kind)


@pytest.mark.delicate
@pytest.mark.parametrize(("kind", "n"), paired(["screw", "planar", "floating"], [5, 100, 10_000]))
def test_screws_and_free_bodies_run_away_as_slides_do(kind, n):
    motion = sp.sweep(away_by(kind), "arm", np.linspace(0.0, 1.6, n), on_limit="stop")
    assert motion.events[-1].kind == "limit" and "body" in motion.events[-1].text
    assert motion.events[-1].value == pytest.approx(RIGHT, abs=1e-13)


def test_what_goes_far_with_its_driver_has_no_asymptote(tmp_path):
    """A rack goes on with its pinion for ever, and far out there is no end."""
    tree = (mechanisms.turning("pinion", "ground", "wheel")
            + mechanisms.sliding("rack", "ground", "bar"))
    mech = mechanisms.load(tmp_path, "rack", tree, mechanisms.driver("pinion", "pinion")
                           + mechanisms.coupling("mesh", "pinion", "rack", 1.0))
    motion = sp.sweep(mech, "pinion", [0.0, 1.0, 5e4], on_limit="stop")
    assert len(motion) == 3 and {event.kind for event in motion.events} <= {"joint limit"}


def test_a_joint_limit_comes_before_an_asymptote(to_a_wall):
    """The slide has limits of the URDF: it reaches the upper one at cos(arm) = 1 / limit."""
    at = to_a_wall.coordinate("out").q
    most = float(to_a_wall.model.upperPositionLimit[at])
    span = sp.limits(to_a_wall, "arm", joints=True)
    assert span.upper.kind == "upper limit of out"
    assert span.upper.value == pytest.approx(acos(1.0 / most), abs=1e-9)


@pytest.mark.slow
def test_a_workspace_ends_at_an_asymptote_without_a_point_there(to_a_wall):
    found = sp.workspace(to_a_wall, "block", {"arm": (0.0, 2.0)}, points=7)
    assert found.why == ("",) * 5 + ("limit",) * 2
    assert found.boundary.drivers[0, 0] == pytest.approx(RIGHT, abs=1e-12)
    assert np.isnan(found.boundary.points).all()


def test_the_search_ends_where_a_law_has_turned_a_joint_far():
    model = pin.Model()
    for name in ("crank", "spool"):
        model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), name)
    law = sp.closures.coupling(joints=["crank", "spool"], function=lambda x: (x**3, 3 * x**2, 6 * x,
                                                                              6.0), name="law")
    upper = sp.limits(sp.Mechanism.from_model(model, [law], drivers=["crank"]), "crank").upper
    turns = upper.value / (2 * pi)
    assert upper.kind == "not followed further"
    assert turns == pytest.approx(7.0, abs=1e-12)  # the first whose cube is ten thousand turns
