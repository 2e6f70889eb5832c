"""Where a frame gets to over a grid of drivers, against closed forms."""

from __future__ import annotations

import csv
import itertools
import json
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pinocchio as pin
import pytest
from five_bars import ARM, BARS, GROUND, ROD, five_bar
from loaded_library import library
from mechanisms import closure, driver, guess, load, point, turning
from variety import few

import spatial_pin as sp

ARRAYS = ("drivers", "reached", "points", "rotations", "dexterity", "least")


def elbows(drivers):
    """Return the ends of both arms (2, N, 2)."""
    ends = ARM * np.stack([np.cos(drivers), np.sin(drivers)], axis=-1)
    return ends[:, 0], ends[:, 1] + [GROUND, 0.0]


def five_bar_tip(drivers):
    """Return the tip (N, 2) above the elbows; NaN where they are too far apart."""
    a, b = elbows(drivers)
    half = 0.5 * (b - a)
    length = np.linalg.norm(half, axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        up = np.sqrt(ROD**2 - length**2) / length
    return a + half + up * np.column_stack([-half[:, 1], half[:, 0]])


def sines(drivers):
    """Return the sines (N, 2) of the angles between arms and rods."""
    tip = five_bar_tip(drivers)
    ways = [(end - base, tip - end) for end, base in zip(
        elbows(drivers), ((0.0, 0.0), (GROUND, 0.0)), strict=True)]
    return np.column_stack([a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] for a, b in ways]) / (ARM * ROD)


@pytest.fixture(scope="module")
def bars(tmp_path_factory) -> sp.Mechanism:
    return five_bar(tmp_path_factory.mktemp("five_bar"))


@pytest.fixture(scope="module")
def found(bars) -> sp.Workspace:
    return sp.workspace(bars, "tip", BARS, points=25)


def test_a_five_bar_gets_where_its_rods_reach(found):
    tip = five_bar_tip(found.drivers)
    known = ~np.isnan(tip).any(axis=1)
    assert np.count_nonzero(~known) > 50
    np.testing.assert_array_equal(found.reached, known)
    np.testing.assert_allclose(found.points[known, :2], tip[known], atol=1e-12)
    np.testing.assert_allclose(found.points[known, 2], 0.0, atol=1e-12)
    assert np.isnan(found.points[~known]).all()
    assert {why for why, r in zip(found.why, found.reached, strict=True) if not r} == {"limit"}


def test_the_workspace_of_a_five_bar_lies_in_the_annuli_of_both_arms(found):
    for base in ((0.0, 0.0), (GROUND, 0.0)):
        far = np.linalg.norm(found.points[found.reached, :2] - base, axis=1)
        assert abs(ARM - ROD) - 1e-12 < far.min()
        assert far.max() < ARM + ROD + 1e-12


def test_the_boundary_of_a_five_bar_is_where_the_rods_are_in_line(found):
    a, b = elbows(found.boundary.drivers)
    assert set(found.boundary.why) == {"limit"}
    np.testing.assert_allclose(np.linalg.norm(b - a, axis=1), 2 * ROD, rtol=1e-9)
    np.testing.assert_allclose(found.boundary.points[:, :2], 0.5 * (a + b), atol=1e-8)
    lines = found.reached.reshape(25, 25).astype(int)
    ends = sum(np.count_nonzero(np.diff(lines, axis=k)) for k in (0, 1))
    assert len({tuple(x) for x in found.boundary.drivers.round(9)}) == ends


@pytest.mark.delicate
def test_the_singular_curves_of_a_five_bar_are_where_an_arm_and_its_rod_are_in_line(found):
    assert len(found.singular) > 10
    np.testing.assert_allclose(np.abs(sines(found.singular.drivers)).min(axis=1), 0.0, atol=1e-7)
    np.testing.assert_allclose(found.singular.points[:, :2], five_bar_tip(found.singular.drivers),
                               atol=1e-9)
    sign = np.sign(sines(found.drivers)).prod(axis=1).reshape(25, 25)
    changes = 0
    for k in (0, 1):
        first, last = (np.take(sign, range(j, 24 + j), axis=k) for j in (0, 1))
        changes += np.count_nonzero(first * last < 0)
    assert len(found.singular) == changes


def test_the_dexterity_of_a_five_bar_is_that_of_its_closed_form(bars, found):
    rows = np.flatnonzero(found.reached)[::17]
    h = 1e-6
    steps = [found.drivers[rows] + h * e for e in np.vstack([np.eye(2), -np.eye(2)])]
    tips = [five_bar_tip(x) for x in steps]
    jacobians = np.stack([tips[0] - tips[2], tips[1] - tips[3]], axis=-1) / (2 * h)
    s = np.linalg.svd(jacobians / bars.characteristic_length, compute_uv=False)
    good = ~np.isnan(s).any(axis=1)
    np.testing.assert_allclose(found.dexterity[rows][good], (s[:, 1] / s[:, 0])[good], atol=1e-5)
    np.testing.assert_allclose(found.least[rows][good], s[good, 1], atol=1e-5)
    assert (found.task, found.directions, found.n_drivers) == ("position", 2, 2)
    np.testing.assert_allclose(found.condition[rows] * found.dexterity[rows], 1.0)


def spheres(drivers, side, top, arm, rod):
    """Return the point (N, 3) below that is a rod's length from three centres; NaN without one."""
    yaw = np.deg2rad([-90.0, 30.0, 150.0])
    out = side * np.sqrt(3) / 6 - top * np.sqrt(3) / 3 + arm * np.cos(drivers)
    centres = np.stack([out * np.cos(yaw), out * np.sin(yaw), -arm * np.sin(drivers)], axis=-1)
    p1 = centres[:, 0]
    ex = centres[:, 1] - p1
    d = np.linalg.norm(ex, axis=1)
    ex /= d[:, None]
    i = np.einsum("ij,ij->i", ex, centres[:, 2] - p1)
    ey = centres[:, 2] - p1 - i[:, None] * ex
    j = np.linalg.norm(ey, axis=1)
    ey /= j[:, None]
    x = d / 2
    y = (i**2 + j**2 - 2 * i * x) / (2 * j)
    with np.errstate(invalid="ignore"):
        z = np.sqrt(rod**2 - x**2 - y**2)
    ez = np.cross(ex, ey)
    return p1 + x[:, None] * ex + y[:, None] * ey - z[:, None] * ez


@pytest.mark.slow
def test_a_delta_gets_where_three_spheres_meet():
    mechanism = library("delta", ll=0.7)
    ranges = {f"arm_{k}": (-1.5, 2.4) for k in (1, 2, 3)}
    found = sp.workspace(mechanism, "platform", ranges, points=4, on_crossing="straight")
    side, top, arm, rod = 0.567, 0.076, 0.524, 0.7
    where = spheres(found.drivers, side, top, arm, rod)
    known = ~np.isnan(where).any(axis=1)
    assert known.any()
    assert not known.all()
    np.testing.assert_array_equal(found.reached, known)
    np.testing.assert_allclose(found.points[known], where[known], atol=1e-10)
    np.testing.assert_allclose(found.rotations[known], np.broadcast_to(
        np.eye(3), (np.count_nonzero(known), 3, 3)), atol=1e-10)
    assert (found.task, found.directions) == ("position", 3)
    part = sp.workspace(mechanism, "platform", ranges, points=4)  # where the platform may turn too
    assert "branch point" in part.why
    np.testing.assert_array_equal(found.reached & part.reached, part.reached)
    np.testing.assert_allclose(part.points[part.reached], where[part.reached], atol=1e-10)


def stewart_feet_and_tops():
    """Return the balls (6, 3) on the ground and on the platform of the library's Gough platform."""
    ways = np.repeat(np.deg2rad([0.0, 120.0, 240.0]), 2)
    side = np.tile([-1.0, 1.0], 3)
    feet, tops = ways + side * np.deg2rad(20), ways + side * np.deg2rad(45)
    return tuple(r * np.column_stack([np.cos(x), np.sin(x), 0 * x])
                 for r, x in ((0.30, feet), (0.18, tops)))


def test_legs_of_a_gough_platform_are_as_long_as_its_poses_say():
    mechanism = library("stewart")
    ranges = {f"leg_{k}": (0.36, 0.42) for k in (1, 3, 6)}
    found = sp.workspace(mechanism, "platform", ranges, points=5)
    assert found.reached.all()
    feet, tops = stewart_feet_and_tops()
    balls = found.points[:, None] + np.einsum("nij,kj->nki", found.rotations, tops)
    lengths = np.linalg.norm(balls - feet, axis=2)
    home = sp.assemble(mechanism, {}).coordinate("slide_2").value
    wanted = np.full(lengths.shape, home)
    wanted[:, [0, 2, 5]] = found.drivers
    np.testing.assert_allclose(lengths, wanted, atol=1e-12)
    assert (found.task, found.directions, found.n_drivers) == ("pose", 6, 6)


def shell_radii(mechanism, height):
    """Return the circles (6, 2) centres, inner and outer radii (6,), of a level platform."""
    feet, tops = stewart_feet_and_tops()
    limits = [mechanism.coordinate(f"slide_{k}").q for k in range(1, 7)]
    low, high = (x[limits] for x in (mechanism.model.lowerPositionLimit,
                                     mechanism.model.upperPositionLimit))
    return ((feet - tops)[:, :2], np.sqrt(np.maximum(low**2 - height**2, 0.0)),
            np.sqrt(high**2 - height**2))


def area_between(centres, inner, outer):
    """Return the area inside of all outer circles and outside of all inner ones: by its arcs."""
    total = 0.0
    circles = [*zip(centres, outer, [1] * 6, strict=True),
               *((c, r, -1) for c, r in zip(centres, inner, strict=True) if r > 0.0)]
    for k, (c, r, side) in enumerate(circles):
        cuts = [0.0, 2 * np.pi]
        for j, (other, radius, _) in enumerate(circles):
            way = other - c
            d = np.linalg.norm(way)
            if j != k and abs(r - radius) < d < r + radius:
                half = np.arccos((r**2 + d**2 - radius**2) / (2 * r * d))
                mean = np.arctan2(way[1], way[0])
                cuts += [(mean - half) % (2 * np.pi), (mean + half) % (2 * np.pi)]
        for a, b in itertools.pairwise(sorted(cuts)):
            middle = c + r * np.array([np.cos((a + b) / 2), np.sin((a + b) / 2)])
            if all(s * np.linalg.norm(middle - o) <= s * x + 1e-12
                   for j, (o, x, s) in enumerate(circles) if j != k):
                total += side * 0.5 * (r * r * (b - a) + r * c[0] * (np.sin(b) - np.sin(a))
                                       - r * c[1] * (np.cos(b) - np.cos(a)))
    return total


def area_of(polygon):
    """Return the area of a polygon (m, 2)."""
    x, y = polygon.T
    return 0.5 * abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def test_a_gough_platform_that_keeps_its_orientation_stays_between_spherical_shells():
    mechanism = library("stewart")
    found = sp.workspace(mechanism, "platform", {"x": (-0.25, 0.25), "y": (-0.25, 0.25)},
                         points=17)
    centres, inner, outer = shell_radii(mechanism, sp.assemble(mechanism).placement(
        "platform").translation[2])
    far = np.linalg.norm(found.drivers[:, None] - centres, axis=2)
    inside = ((far >= inner) & (far <= outer)).all(axis=1)
    np.testing.assert_array_equal(found.reached, inside)
    np.testing.assert_allclose(found.points[inside, :2], found.drivers[inside], atol=1e-12)
    np.testing.assert_allclose(found.rotations[inside], np.broadcast_to(
        np.eye(3), (np.count_nonzero(inside), 3, 3)), atol=1e-12)
    assert (found.task, found.n_drivers, found.names) == ("pose", 6, ("x", "y"))
    curves = found.curves(tolerance=1e-5)
    (edge,) = curves
    assert edge.is_closed and edge.is_boundary and len(set(edge.why)) == 6
    far = np.linalg.norm(edge.drivers[:, None] - centres, axis=2)
    np.testing.assert_allclose(np.minimum(np.abs(far - outer), np.abs(far - inner)).min(axis=1),
                               0.0, atol=1e-10)
    changes = [k for k in range(1, len(edge.why)) if edge.why[k] != edge.why[k - 1]]
    both = np.sort(np.abs(far - outer)[changes], axis=1)[:, 1]  # corners are on two circles
    np.testing.assert_allclose(both, 0.0, atol=1e-9)
    exact = area_between(centres, inner, outer)
    size = mechanism.characteristic_length
    length = np.linalg.norm(np.diff(edge.drivers, axis=0), axis=1).sum()
    assert abs(area_of(edge.drivers) - exact) < 1e-5 * size * length
    state = found.state(int(np.flatnonzero(inside)[0]))
    assert state.mechanism is mechanism and state.closure_error < 1e-12
    assert "joint limit: upper limit" in str(found)


def test_poses_turn_by_cardan_angles():
    mechanism = library("stewart")
    found = sp.workspace(mechanism, "platform", {"z": (0.34, 0.38), "turn_z": (-0.3, 0.3)},
                         points=3)
    assert found.reached.all()
    for row in range(9):
        z, angle = found.drivers[row]
        np.testing.assert_allclose(found.points[row], [0.0, 0.0, z], atol=1e-12)
        turn = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        np.testing.assert_allclose(found.rotations[row, :2, :2], turn, atol=1e-12)
    reached = sp.reach(mechanism, {"platform": pin.SE3(found.rotations[2], found.points[2])})
    np.testing.assert_allclose(found.columns()["leg_4 [m]"][2],
                               reached.coordinate("slide_4").value, atol=1e-12)


@pytest.mark.slow
def test_a_five_bar_gets_to_points_between_two_circles_of_each_arm(bars):
    found = sp.workspace(bars, "tip", {"x": (-0.1, 0.3), "y": (0.05, 0.3)}, points=21, sheets=True)
    far = np.stack([np.linalg.norm(found.drivers - base, axis=1)
                    for base in ((0.0, 0.0), (GROUND, 0.0))])
    inside = ((far > ROD - ARM) & (far < ROD + ARM)).all(axis=0)
    np.testing.assert_array_equal(found.reached, inside)
    np.testing.assert_allclose(found.points[inside, :2], found.drivers[inside], atol=1e-12)
    # the other working modes: each elbow has two places
    assert len(found.sheets) == 3
    signs = set()
    for sheet in (found, *found.sheets):
        np.testing.assert_array_equal(sheet.reached, inside)
        row = int(np.flatnonzero(inside)[7])
        signs.add(tuple(np.sign(np.sin([sheet.state(row).coordinate(f"elbow{k}").value
                                        for k in (1, 2)]))))
    assert len(signs) == 4
    for curve in found.curves():
        far = np.stack([np.linalg.norm(curve.drivers - base, axis=1)
                        for base in ((0.0, 0.0), (GROUND, 0.0))])
        if curve.is_boundary:  # circles
            off = np.minimum(np.abs(far - ROD - ARM), np.abs(far - ROD + ARM)).min(axis=0)
            np.testing.assert_allclose(off, 0.0, atol=1e-10)
    assert sum(curve.is_boundary for curve in found.curves()) >= 1


@pytest.mark.delicate
@pytest.mark.parametrize(("low", "high", "points"), [
    ((0.05, -0.1), (0.15, 0.0), 9),
    pytest.param((-0.1, -0.1), (0.3, 0.3), 25, marks=pytest.mark.slow)], ids=["below", "all over"])
def test_where_the_motors_of_a_five_bar_lose_the_tip_is_a_coupler_curve(bars, low, high, points):
    """There both rods are in line: each elbow on its circle, the tip in the middle or beyond."""
    grid = dict(zip("xy", zip(low, high, strict=True), strict=True))
    found = sp.workspace(bars, "tip", grid, points=points)
    inner = [c for c in found.curves() if not c.is_boundary]
    assert inner
    for curve in inner:
        for place in curve.points[:: len(curve) // 5 + 1]:
            near = found.state(int(np.nanargmin(np.linalg.norm(found.points - place, axis=1))))
            ways, sines = [], []
            for k, base in ((1, (0.0, 0.0)), (2, (GROUND, 0.0))):
                way = place[:2] - base
                d = np.linalg.norm(way)
                half = np.arccos(np.clip((ARM**2 + d**2 - ROD**2) / (2 * ARM * d), -1.0, 1.0))
                side = -np.sign(np.sin(near.coordinate(f"elbow{k}").value))
                angle = np.arctan2(way[1], way[0]) + side * half
                sines.append(np.sin(half))  # round-off over it is that of the angle
                ways.append(way - ARM * np.array([np.cos(angle), np.sin(angle)]))
            sine = (ways[0][0] * ways[1][1] - ways[0][1] * ways[1][0]) / ROD**2
            assert abs(sine) * min(sines) < 1e-12


def test_curves_of_a_five_bar_are_those_of_its_closed_form(found):
    curves = found.curves(tolerance=1e-4)
    inner = np.concatenate([c.drivers for c in curves if not c.is_boundary])
    apart = np.linalg.norm(np.subtract(*elbows(inner)), axis=1)
    inner = inner[apart > 1e-3]  # where both elbows meet the closed form has no tip
    np.testing.assert_allclose(np.abs(sines(inner)).min(axis=1), 0.0, atol=1e-9)
    edges = np.concatenate([c.drivers for c in curves if c.is_boundary])
    apart = np.linalg.norm(np.subtract(*elbows(edges)), axis=1)
    np.testing.assert_allclose(np.minimum(apart, np.abs(apart - 2 * ROD)), 0.0, atol=1e-10)
    # as far as every place on lines of the grid is on a curve, and as near as is said
    places = np.concatenate([found.boundary.drivers, found.singular.drivers])
    pieces = [np.stack([c.drivers[:-1], c.drivers[1:]], axis=1) for c in curves]
    first, last = np.concatenate(pieces).swapaxes(0, 1)
    for place in places:
        way = last - first
        part = np.clip(np.einsum("ij,ij->i", place - first, way)
                       / np.maximum(np.einsum("ij,ij->i", way, way), 1e-30), 0.0, 1.0)
        assert np.linalg.norm(first + part[:, None] * way - place, axis=1).min() < 1e-4
    assert found.aspects.max() >= 1


@pytest.mark.parametrize("points", few([10, 16], 10))
def test_a_circle_that_turns_a_joint_wholly_round_is_closed(tmp_path, points):
    """The right arm and its rod in line: the tip goes round both bases, so the left arm turns."""
    ground, arms, rods = 0.05, (0.09, 0.06), (0.17, 0.13)
    mechanism = five_bar(tmp_path, ground, arms, rods)
    reach = arms[1] + rods[1]
    assert ground < reach < sum((arms[0], rods[0], -ground))  # the left arm gets round it
    ranges = {"left": (-np.pi, np.pi), "elbow1": (-np.pi, np.pi)}
    curves = sp.workspace(mechanism, "tip", ranges, points=points).curves(tolerance=1e-3)
    whole = [c for c in curves if c.is_closed]
    assert whole
    for curve in whole:
        way = curve.points[:, :2] - [ground, 0.0]
        np.testing.assert_allclose(np.hypot(*way.T), reach, rtol=1e-10)
        round_it = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
        assert abs(round_it[-1] - round_it[0]) == pytest.approx(2.0 * np.pi, abs=1e-7)
        np.testing.assert_array_equal(curve.points[0], curve.points[-1])
        turned = curve.drivers[-1] - curve.drivers[0]
        np.testing.assert_allclose(np.abs(turned), [2.0 * np.pi, 0.0], atol=1e-7)
        far = np.hypot(*curve.points[:, :2].T)  # the left elbow by the law of cosines
        bend = np.arccos((far**2 - arms[0] ** 2 - rods[0] ** 2) / (2.0 * arms[0] * rods[0]))
        np.testing.assert_allclose(np.cos(curve.drivers[:, 1]), np.cos(bend), atol=1e-9)
    for curve in curves:
        assert np.abs(curve.drivers).max() < np.pi + 1e-9
    part = sp.workspace(mechanism, "tip", ranges | {"left": (-2.0, 2.0)}, points=points)
    assert not any(c.is_closed for c in part.curves(tolerance=1e-3))


@pytest.mark.delicate
@pytest.mark.parametrize(("x", "y", "points"), [
    ((0.0, 1.5), (-1.5, 0.0), 5),
    pytest.param((-1.5, 1.5), (-1.5, 1.5), 15, marks=pytest.mark.slow)], ids=["a quarter", "all"])
def test_a_section_of_a_delta_ends_where_its_arms_and_rods_are_in_line(x, y, points):
    mechanism = library("delta")
    found = sp.workspace(mechanism, "platform", {"x": x, "y": y}, points=points,
                         limits=False, on_crossing="straight")
    side, top, arm, rod = 0.567, 0.076, 0.524, mechanism.dimensions["ll"]
    yaw = np.deg2rad([-90.0, 30.0, 150.0])
    out = side * np.sqrt(3) / 6 - top * np.sqrt(3) / 3
    height = found.points[found.reached][0, 2]

    def rooms(points):
        """How far each arm is from reaching (3, N): distance in its plane to the rod's end."""
        rows = []
        for a in yaw:
            along = points @ [np.cos(a), np.sin(a)] - out
            across = points @ [-np.sin(a), np.cos(a)]
            within = np.sqrt(np.maximum(rod**2 - across**2, 0.0))
            far = np.hypot(along, height)
            rows.append(np.minimum(arm + within - far, far - np.abs(arm - within)))
        return np.array(rows)

    inside = (rooms(found.drivers) > 0.0).all(axis=0)
    assert np.count_nonzero(found.reached & ~inside) == 0
    assert np.count_nonzero(found.reached) > 0.5 * np.count_nonzero(inside)
    edges = [c for c in found.curves() if c.is_boundary and "limit" in c.why]
    assert edges
    for curve in edges:
        np.testing.assert_allclose(np.abs(rooms(curve.drivers)).min(axis=0), 0.0, atol=1e-8)


def test_joint_limits_are_kept_and_named():
    mechanism = library("stewart")
    ranges = {"leg_1": (0.38, 0.5), "leg_2": (0.38, 0.5)}
    found = sp.workspace(mechanism, "platform", ranges, points=4)
    highest = mechanism.model.upperPositionLimit[mechanism.coordinate("slide_1").q]
    np.testing.assert_array_equal(found.reached, (found.drivers < highest).all(axis=1))
    assert {why.partition(":")[0] for why in found.why} <= {
        "", "joint limit", "no way along the grid"}
    assert any(why.startswith("joint limit: upper limit") for why in found.why)
    ends = found.boundary.drivers.max(axis=1)
    np.testing.assert_allclose(ends, highest, atol=1e-9)
    free = sp.workspace(mechanism, "platform", ranges, points=4, limits=False)
    assert np.count_nonzero(free.reached) > np.count_nonzero(found.reached)


BALLS = """<robot name="balls">
<link name="post"><visual><origin xyz="1 0.5 0"/><geometry><sphere radius="0.1"/></geometry>
</visual></link><link name="first"><visual><origin xyz="0 0 9"/><geometry><sphere radius="0.1"/>
</geometry></visual></link><link name="second"><visual><origin xyz="1 0 0"/><geometry>
<sphere radius="0.05"/></geometry></visual></link>
<joint name="turn" type="continuous"><parent link="post"/><child link="first"/><axis xyz="0 0 1"/>
</joint><joint name="lift" type="prismatic"><parent link="first"/><child link="second"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize("apart", [0.0, 0.05])
def test_links_keep_apart_and_are_named(tmp_path, apart):
    (tmp_path / "balls.urdf").write_text(BALLS)
    mechanism = sp.load(tmp_path / "balls.urdf")
    found = sp.workspace(mechanism, "second", {"turn": (-1.0, 2.0)}, points=31, clearance=apart)
    far = np.hypot(1.0, 0.5)
    half = np.arccos((1.0 + far**2 - (0.15 + apart) ** 2) / (2.0 * far))
    first = np.arctan2(0.5, 1.0) - half
    np.testing.assert_array_equal(found.reached, found.drivers[:, 0] < first)
    assert found.boundary.drivers[:, 0] == pytest.approx([first], abs=2e-7)
    words = "links touch" if not apart else "nearer than 0.05 m"
    assert found.boundary.why == (f"{words}: post and second",)
    with pytest.raises(sp.SpatialPinError, match=words):
        sp.workspace(mechanism, "second", {"turn": (0.42, 0.5)}, points=2, clearance=apart,
                     guess={"turn": 0.46})


def test_the_command_line_says_and_writes_it(tmp_path, run):
    names = {name: tmp_path / name for name in ("t.csv", "c.csv", "p.png", "p.html", "t.json")}
    code, out, _ = run(
        "workspace", "stewart", "platform", "x=-0.25..0.25", "y=-250mm..250mm", "--points", "7",
        "--csv", names["t.csv"], "--curves", names["c.csv"], "--picture", names["p.png"],
        "--html", names["p.html"], "--json", names["t.json"])
    assert code == 0
    assert "7 x 7 values of x, y" in out and out.count("wrote") == 5
    with open(names["t.csv"], encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 49 and {"x [m]", "leg_1 [m]", "aspect", "why"} <= set(rows[0])
    with open(names["c.csv"], encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) > 50
    code, out, _ = run("workspace", "rssr", "coupler", "crank=0..90deg", "--points", "5",
                       "--json", "-")
    assert code == 0
    columns = json.loads(out)["columns"]
    assert columns["crank [rad]"] == pytest.approx(np.linspace(0.0, np.pi / 2, 5))


@pytest.mark.parametrize(("words", "code", "told"), [
    (["crank=0"], 2, "NAME=LO..HI"), (["crank=0..1", "crank=0..2"], 2, "two ranges"),
    (["crank=0..1m"], 1, "crank is in rad"), (["x=0deg..1"], 1, "x is in m"),
    (["crunk=0..1"], 1, "crunk"), (["crank=0..1", "--picture", "p.doc"], 1, "--picture"),
])
def test_the_command_line_refuses_in_words(run, words, code, told):
    found, _, err = run("workspace", "rssr", "coupler", *words)
    assert found == code and told in err and "Traceback" not in err


@pytest.fixture(scope="module")
def kneed(tmp_path_factory) -> sp.State:
    """The five-bar with a joint in the middle of a rod, which is stretched."""
    half = (ROD / 2, 0, 0)
    tree = (turning("left", "ground", "arm1") + turning("right", "ground", "arm2", (GROUND, 0, 0))
            + turning("elbow1", "arm1", "rod1", (ARM, 0, 0)) + turning("knee", "rod1", "end1", half)
            + turning("elbow2", "arm2", "rod2", (ARM, 0, 0))
            + point("tip", "end1", half) + point("tip2", "rod2", (ROD, 0, 0)))
    toml = (driver("left", "left") + driver("right", "right")
            + closure("pin", "revolute", "tip", "tip2")
            + guess(left=1.9, right=1.2, elbow1=-1.0, elbow2=1.0))
    mechanism = load(tmp_path_factory.mktemp("kneed"), "kneed", tree, toml)
    return sp.assemble(mechanism, {"left": 1.9, "right": 1.2, "knee": 0.0})


@pytest.mark.parametrize("points", few([4, 9], 4))
def test_a_joint_that_is_held_is_as_good_as_none(bars, kneed, points):
    plain = sp.workspace(bars, "tip", BARS, points=points, sheets=True)
    held = sp.workspace(kneed.mechanism, "tip", BARS, points=points, sheets=True, guess=kneed,
                        hold=["base", "knee"])
    assert len(held.sheets) == len(plain.sheets) > 0
    for one, other in zip((held, *held.sheets), (plain, *plain.sheets), strict=True):
        np.testing.assert_array_equal(one.reached, other.reached)
        np.testing.assert_allclose(one.points, other.points, atol=1e-12)
        np.testing.assert_allclose(one.dexterity, other.dexterity, atol=1e-9)
        np.testing.assert_allclose(one.boundary.drivers, other.boundary.drivers, atol=1e-8)
        np.testing.assert_allclose(one.singular.drivers, other.singular.drivers, atol=1e-7)
    curves, others = held.curves(), plain.curves()
    assert [curve.why for curve in curves] == [curve.why for curve in others]
    for curve in curves:
        if curve.why == "limit":
            a, b = elbows(curve.drivers)
            np.testing.assert_allclose(np.linalg.norm(b - a, axis=1), 2 * ROD, rtol=1e-8)


def test_a_pose_whose_driver_is_held_goes_round_its_elbow(bars):
    state = sp.assemble(bars, {"left": 1.9, "right": 1.2})
    found = sp.workspace(bars, "tip", {"x": (0.09, 0.13)}, points=9, guess=state,
                         hold=["base", "right"])
    assert found.reached.sum() > 3
    elbow = np.array([GROUND + ARM * np.cos(1.2), ARM * np.sin(1.2)])
    far = np.linalg.norm(found.points[found.reached, :2] - elbow, axis=1)
    np.testing.assert_allclose(far, ROD, rtol=1e-12)


def test_what_spans_the_grid_is_not_held(kneed, run):
    with pytest.raises(ValueError, match="'left' is held"):
        sp.workspace(kneed.mechanism, "tip", BARS, points=3, guess=kneed, hold="left")
    path = kneed.mechanism.path
    words = ["workspace", path, "tip", "left=1.6..1.9", "--points", "3"]
    code, _, told = run(*words)
    assert code == 1 and "--hold" in told
    code, said, _ = run(*words, "--hold", "knee", "--json", "-")
    assert code == 0
    columns = json.loads(said)["columns"]
    assert len(columns["left [rad]"]) == 3
    code, _, told = run(*words, "--hold", "kne")
    assert code == 1 and "did you mean 'knee'?" in told


def test_workers_change_nothing(bars, found):
    with ProcessPoolExecutor(2) as pool:
        other = sp.workspace(bars, "tip", BARS, points=25, executor=pool)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(other, name), getattr(found, name))
    assert other.why == found.why
    np.testing.assert_array_equal(other.aspects, found.aspects)
    for name, side in itertools.product(("drivers", "points"), ("boundary", "singular")):
        np.testing.assert_array_equal(getattr(getattr(other, side), name),
                                      getattr(getattr(found, side), name))
    assert str(other) == str(found)


def test_a_command_gives_the_work_to_processes(run):
    words = ["workspace", "rssr", "coupler", "crank=0..90deg", "--points", "9"]
    alone = run(*words)
    assert alone[0] == 0
    assert run(*words, "--workers", "2")[:2] == alone[:2]


def test_a_state_of_it_is_closed_and_stands_there(found):
    row = int(np.flatnonzero(found.reached)[5])
    state = found.state(row)
    np.testing.assert_allclose(state.placement("tip").translation, found.points[row], atol=1e-14)
    assert state.closure_error < 1e-12
    with pytest.raises(sp.SpatialPinError, match="not reached: limit"):
        found.state(int(np.flatnonzero(~found.reached)[0]))
    with pytest.raises(sp.SpatialPinError, match="there is no point"):
        found.state(10**6)


def test_a_report_a_table_and_pictures_are_made_of_it(bars, found, tmp_path):
    text = str(found)
    assert "points reached" in text
    assert "limit" in text
    assert f"vanishes at {len(found.singular)} places" in text
    with found.to_csv(tmp_path / "w.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 625
    assert [float(r["tip.x [m]"]) for r, k in zip(rows, found.reached, strict=True) if k] == list(
        found.points[found.reached, 0])
    figure = found.plot(tmp_path / "w.png")
    assert (tmp_path / "w.png").stat().st_size > 10_000
    assert figure.axes[0].get_xlabel() == "x [m]"
    assert figure.axes[0].get_ylabel() == "y [m]"
    thin = found.plot(plane="yz", at=0.1, thickness=0.01)
    assert len(thin.axes[0].collections[0].get_offsets()) < np.count_nonzero(found.reached)
    with pytest.raises(ValueError, match="plane"):
        found.plot(plane="zz")
    with pytest.raises(TypeError, match=r"sp\.workspace\(mechanism, frame"):
        sp.Look(workspace=3)
    with pytest.raises(sp.SpatialPinError, match="that of another one, 'five_bar'"):
        sp.export_html(sp.assemble(library("four_bar")), tmp_path / "page.html",
                       look=sp.Look(workspace=found))


@pytest.mark.parametrize(("given", "words"), [
    ({"at": {"left": 1.0}}, "leaves 1 coordinates"), ({"at": {"lift": 1.0}}, "no coordinate of"),
    ({"tolerance": 0.0}, "tolerance"),
])
def test_a_section_that_there_is_not_is_refused(found, given, words):
    with pytest.raises(ValueError, match=words):
        found.curves(**given)


@pytest.mark.parametrize(("change", "error", "words"), [
    ({"frame": "tap"}, LookupError, "did you mean 'tip'"),
    ({"ranges": {"lift": (0, 1)}}, LookupError, "lift"),
    ({"ranges": {"left": (1.0, 0.5)}}, ValueError, "the first is to be the smaller one"),
    ({"ranges": {"left": (0.0, np.nan)}}, ValueError, "left"),
    ({"ranges": {"left": 1.0}}, ValueError, "left"),
    ({"ranges": {}}, ValueError, "empty"),
    ({"points": 1}, ValueError, "2 at least"),
    ({"points": 500}, ValueError, "200000 at most"),
    ({"points": {"left": 5}}, ValueError, "they are wanted of"),
    ({"task": "place"}, ValueError, "task"),
    ({"ranges": {"x": (0.0, 0.1), "left": (0.5, 1.0)}}, ValueError, "not of both"),
    ({"ranges": {"x": (0.0, 0.1), "tip.x": (0.5, 1.0)}}, ValueError, "twice"),
    ({"ranges": {"x": (0.0, 0.1), "z": (0.0, 1.0)}}, ValueError, "z of 'tip' cannot change"),
    ({"ranges": {"turn_z": (0.0, 0.1)}, "task": "position"}, ValueError, "orientation is free"),
    ({"clearance": -1.0}, ValueError, "clearance"),
])
def test_bad_input_is_refused_in_words(bars, change, error, words):
    given = {"frame": "tip", "ranges": BARS, "points": 5} | change
    with pytest.raises(error, match=words):
        sp.workspace(bars, given.pop("frame"), given.pop("ranges"), **given)
