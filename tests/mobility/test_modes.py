"""Assembly modes against the branches of closed forms, and against published counts.

Half-angle rule: E sin(x) + F cos(x) + G = 0 has the roots x = 2 atan2(-E ± √(E² + F² - G²), G - F).
Sources: Freudenstein's equation and the spherical four-bar's [McCarthy2011]; forty poses of a
platform [Dietmaier1998]; sixteen of a six-hinge arm [ManochaCanny1994].
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from dietmaier import DIETMAIER_BASE, DIETMAIER_LEGS, DIETMAIER_PLATFORM, assert_distinct, dietmaier
from loaded_library import library as from_library
from mechanisms import (
    FIVE_BAR,
    KNOWN,
    RSCR_AXIS,
    RSCR_CRANK,
    RSCR_H,
    RSCR_N0,
    RSCR_P0,
    RSSP,
    B as SHAFT_ANGLE,
    bare_four_bar,
    closure,
    driver,
    five_bar,
    floating,
    guess,
    hooke_closure,
    hooke_tree,
    lamp,
    load,
    point,
    refine,
    rscr,
    rssp,
    rssr_with_a_rod,
    swash_plate,
    turning,
)
from variety import each, paired

import spatial_pin as sp

pytestmark = pytest.mark.delicate

DEGREE = np.pi / 180
SAME = 1e-9


def half_angle(e: float, f: float, g: float) -> list[float]:
    inside = e * e + f * f - g * g
    return [2 * np.arctan2(-e + s * np.sqrt(inside), g - f) for s in (1, -1) if inside >= 0]


# ---------------------------------------------------------------- closed forms: every branch

Branches = list[dict[str, float]]


def slider_crank(crank, r=0.05, l=0.16) -> Branches:  # noqa: E741 (l as in the URDF)
    return [{"slide": r * np.cos(crank) + s * np.sqrt(l**2 - (r * np.sin(crank)) ** 2)}
            for s in (1, -1)]


def four_bar(crank, r1=0.30, r2=0.10, r3=0.28, r4=0.24) -> Branches:
    """Freudenstein's equation."""
    k1, k2, k3 = r1 / r2, r1 / r4, (r1**2 + r2**2 - r3**2 + r4**2) / (2 * r2 * r4)
    return [{"rocker_pin": x}
            for x in half_angle(-np.sin(crank), k1 - np.cos(crank), k3 - k2 * np.cos(crank))]


def rssr(crank, a=0.102, b=0.381, c=0.254, d=0.314) -> Branches:
    cosine = (b**2 - a**2 - c**2 - d**2 + 2 * a * d * np.cos(crank)) / (
        2 * c * (d - a * np.cos(crank)))
    return [{"rocker_pin": s * np.arccos(cosine)} for s in (1, -1)]


def rspc(crank, h=0.30, alpha=60 * DEGREE, d=0.25, l1=0.10, l2=0.20, a=0.15) -> Branches:
    b = np.hypot(l2, a)
    x = l1 * np.sin(crank) * np.sin(alpha)
    y, z = -l1 * np.sin(crank) * np.cos(alpha) - d, h + l1 * np.cos(crank)
    branches = []
    for r in (np.hypot(y, z), -np.hypot(y, z)):
        u = b * (r / l2 - 1)
        branches.append({"guide.angle": np.arctan2(-y * np.sign(r), z * np.sign(r)),
                         "guide.slide": x + u * a / b, "slide": u})
    return branches


def spherical_four_bar(crank) -> Branches:
    """A sin t4 + B cos t4 + C = 0, angles counted between the planes of neighbouring links."""
    t1 = crank + np.pi / 2
    (s1, s3, s4), (c1, c3, c4) = (f(np.radians([30, 65, 80])) for f in (np.sin, np.cos))
    roots = half_angle(s3 * s1 * np.sin(t1), -s3 * (c1 * s4 + s1 * c4 * np.cos(t1)),
                       c3 * (c1 * c4 - s1 * s4 * np.cos(t1)) - np.cos(70 * DEGREE))
    return [{"rocker_pin": np.pi / 2 - t4} for t4 in roots]


def crank_collar(crank, a=0.050, h=0.075, l=0.175) -> Branches:  # noqa: E741
    """The ball is a sin and a cos - h from the rod; collar and link from either side."""
    x, z = a * np.sin(crank), a * np.cos(crank) - h
    along = np.sqrt(l**2 - x**2 - z**2)
    return [{"collar.slide": s * along} for s in (1, -1) for _ in ("one way", "the other")]


def hooke(angle) -> Branches:
    out = np.arctan2(np.cos(SHAFT_ANGLE) * np.sin(angle), np.cos(angle))
    return [{"output": out}, {"output": out + np.pi}]


def rod_slider(crank) -> Branches:
    u, start = np.array(RSSP["along"]), np.array(RSSP["start"])
    d = start - RSSP["crank"] * np.array([np.cos(crank), np.sin(crank), 0.0])
    root = np.sqrt((u @ d) ** 2 - d @ d + RSSP["rod"] ** 2)
    return [{"slide": -u @ d + s * root} for s in (1, -1)]


def ball_and_cylinder(crank) -> Branches:
    """|(Rot(u, -x) A - P0) x n0| = h, a polynomial of degree 4 in tan(x / 2)."""
    u, p0, n0 = (np.array(x) for x in (RSCR_AXIS, RSCR_P0, RSCR_N0))
    ball = RSCR_CRANK + 0.1 * np.array([np.cos(crank), np.sin(crank), 0.0])
    # Rot(u, -x) ball = k + c cos x + s sin x
    k, c, s = u * (u @ ball), ball - u * (u @ ball), -np.cross(u, ball)
    k, c, s = (np.cross(x, n0) for x in (k - p0, c, s))
    # times (1 + t²): vectors as polynomials in t, highest power first
    vectors = [np.array([k[i] - c[i], 2 * s[i], k[i] + c[i]]) for i in range(3)]
    square = sum(np.polymul(p, p) for p in vectors)
    roots = np.roots(square - RSCR_H**2 * np.array([1.0, 0.0, 2.0, 0.0, 1.0]))
    angles = 2 * np.arctan(roots[np.abs(roots.imag) < 1e-9].real)
    return [{"output_pin": x, "guide.slide": float(
        (pin.AngleAxis(-x, u).matrix() @ ball - p0) @ n0)} for x in angles]


def plane_five_bar(left, right=1.0) -> Branches:
    g, a, b = FIVE_BAR.values()
    p = a * np.array([np.cos(left), np.sin(left)])
    d = np.array([g, 0.0]) + a * np.array([np.cos(right), np.sin(right)]) - p
    base, rise = np.arctan2(d[1], d[0]), np.arccos(np.hypot(*d) / (2 * b))
    return [{"elbow1": base + s * rise - left, "elbow2": base + np.pi - s * rise - right}
            for s in (1, -1)]


class Case(NamedTuple):
    """A mechanism, the driver values, and every branch there."""

    build: Callable[[Path], sp.Mechanism]
    drivers: dict[str, float]
    branches: Branches


def library(name: str) -> Callable[[Path], sp.Mechanism]:
    return lambda _: from_library(name)


CASES = {
    **{f"{name} at {angle}": Case(library(name), {"crank": angle}, branches(angle))
       for name, branches in (("slider_crank", slider_crank), ("four_bar", four_bar),
                              ("rssr", rssr), ("rspc", rspc),
                              ("spherical_four_bar", spherical_four_bar))
       for angle in (0.3, 2.5)},
    "RSSR, rod as distance": Case(rssr_with_a_rod, {"crank": 0.7}, rssr(0.7)),
    "RSSP": Case(rssp, {"crank": 0.7}, rod_slider(0.7)),
    "RSCR with 2": Case(rscr, {"crank": 1.0}, ball_and_cylinder(1.0)),
    "RSCR with 4": Case(rscr, {"crank": 0.0}, ball_and_cylinder(0.0)),
    "Hooke's joint as closure": Case(hooke_closure, {"input": 0.7}, hooke(0.7)),
    "Hooke's joint in the tree": Case(hooke_tree, {"input": 0.7}, hooke(0.7)),
    "five-bar": Case(five_bar, {"left": 1.9, "right": 1.0}, plane_five_bar(1.9)),
}

COUNTS = {  # of mechanisms whose branches are not spelled out: driver values, number of modes
    "bennett": ({"crank": 0.7}, 1),
    "crank_collar": ({"crank": 0.7}, 4),
    "double_cardan": ({"input": 0.7}, 4),
    "geared_five_bar": ({"crank": 0.7}, 2),
    "hooke_joint": ({"input": 0.7}, 2),
    "inverted_slider_crank": ({"bar": 0.7}, 2),
    "oldham": ({"input": 0.7}, 1),
    "peaucellier": ({"crank": 0.3}, 4),
    "rssr_crossed": ({"crank": 0.7}, 2),
    "scotch_yoke": ({"crank": 0.7}, 1),
    "screw_press": ({"screw": 0.7}, 1),
    "swash_plate": ({"shaft": 0.7}, 1),
}


def wrapped(x):
    return np.remainder(np.asarray(x) + np.pi, 2 * np.pi) - np.pi


def differs(state: sp.State, branch: dict[str, float]) -> float:
    """Largest difference of the named coordinates, whole turns apart."""
    gaps = [0.0]
    for name, value in branch.items():
        gap = state.coordinate(name).value - float(value)
        gaps.append(abs(wrapped(gap) if state.mechanism.coordinate(name).unit == "rad" else gap))
    return max(gaps)


def assert_same_set(states: list[sp.State], branches: Branches, tolerance: float = SAME) -> None:
    assert len(states) == len(branches)
    for branch in branches:
        assert sum(differs(state, branch) < tolerance for state in states) == 1, branch


def definite(mechanism: sp.Mechanism) -> list[str]:
    """Coordinates that a passive freedom does not change."""
    loose = {p.link for p in sp.mobility(mechanism).passive}
    model = mechanism.model
    bodies = {model.names[f.parentJoint] for f in model.frames
              if f.type == pin.FrameType.BODY and f.name in loose}
    return [name for name in mechanism.coordinates
            if mechanism.coordinate_table[name].joint not in bodies]


def values(state: sp.State, names: list[str]) -> dict[str, float]:
    return {name: state.coordinate(name).value for name in names}


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("name", CASES)
def test_modes_are_the_branches_of_the_closed_form(name, tmp_path):
    case = CASES[name]
    modes = sp.assembly_modes(case.build(tmp_path), case.drivers)
    assert_same_set(modes, case.branches)
    for state in modes:
        assert state.closure_error < 1e-12
        for driver_name, value in case.drivers.items():
            assert state.coordinate(driver_name).value == value


def test_rscr_has_four_modes_at_some_angles_and_two_at_others():
    counts = {len(ball_and_cylinder(x)) for x in np.linspace(0.0, 2 * np.pi, 50)}
    assert counts == {2, 4}


@pytest.mark.parametrize("name", COUNTS)
def test_number_of_modes(name):
    drivers, count = COUNTS[name]
    modes = sp.assembly_modes(from_library(name), drivers)
    assert len(modes) == count
    assert "singular" not in "".join(state.branch for state in modes)
    assert all(state.closure_error < 1e-12 for state in modes)


def test_crank_collar_has_both_sides_of_the_rod_and_both_ways_round():
    modes = sp.assembly_modes(from_library("crank_collar"), {"crank": 0.7})
    slides = sorted(state.coordinate("collar.slide").value for state in modes)
    expected = sorted(x["collar.slide"] for x in crank_collar(0.7))
    np.testing.assert_allclose(slides, expected, rtol=0, atol=SAME)
    angles = sorted(wrapped(state.coordinate("collar.angle").value) for state in modes)
    np.testing.assert_allclose(np.subtract(angles[2:], angles[:2]), np.pi, rtol=0, atol=SAME)


@pytest.mark.parametrize("name", each(KNOWN))
def test_the_known_answer_is_one_of_the_modes(name, tmp_path):
    known = KNOWN[name]
    mechanism, value = known.build(tmp_path), float(known.values[len(known.values) // 3])
    if "press" in name:
        value = 0.7  # modes know screws up to whole turns
    modes = sp.assembly_modes(mechanism, {known.driver: value, **known.hold}, most_starts=300)
    answer = {key: float(x) for key, x in known.answer(value).coordinates.items()
              if key in mechanism.coordinate_table}
    assert min(differs(state, answer) for state in modes) < SAME


# ---------------------------------------------------------------- order, repetition, labels


ORDERED = ["four_bar", "rspc", "spherical_four_bar", "crank_collar", "double_cardan", "rssr",
           "swash_plate"]


def at_a_position(name: str) -> tuple[sp.Mechanism, dict[str, float]]:
    mechanism = from_library(name)
    return mechanism, {next(iter(mechanism.drivers)): 0.7}


@pytest.mark.parametrize("name", ORDERED)
def test_the_same_seed_gives_the_same_list(name):
    mechanism, drivers = at_a_position(name)
    first, again = (sp.assembly_modes(mechanism, drivers) for _ in range(2))
    assert [s.branch for s in first] == [s.branch for s in again]
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.q, other.q)


@pytest.mark.parametrize(("name", "seed"), paired(ORDERED, [1, 20261]))
def test_another_seed_gives_the_same_modes_in_the_same_order(name, seed):
    mechanism, drivers = at_a_position(name)
    names = definite(mechanism)
    first = sp.assembly_modes(mechanism, drivers)
    other = sp.assembly_modes(mechanism, drivers, seed=seed)
    assert [s.branch for s in first] == [s.branch for s in other]
    for one, two in zip(first, other, strict=True):
        np.testing.assert_allclose(list(values(one, names).values()),
                                   list(values(two, names).values()), rtol=0, atol=SAME)


def test_an_angle_of_half_a_turn_has_one_sign(tmp_path):
    """In one mode of the lamp the neck is turned by half a turn, which is also minus half a one."""
    mechanism = lamp(tmp_path)
    necks = {tuple(round(s.coordinate("neck.first").value, 6) for s in sp.assembly_modes(
        mechanism, {"pan": -0.5, "tilt": 0.0}, seed=seed)) for seed in range(6)}
    assert len(necks) == 1


@pytest.mark.parametrize("name", ORDERED)
def test_modes_are_sorted_and_distinct(name):
    mechanism, drivers = at_a_position(name)
    names = definite(mechanism)
    modes = [values(state, names) for state in sp.assembly_modes(mechanism, drivers)]
    rows = [[round(x, 7) for x in mode.values()] for mode in modes]
    assert rows == sorted(rows)
    for k, mode in enumerate(modes):
        for other in modes[:k]:
            assert max(abs(wrapped(mode[n] - other[n])) for n in names) > 1e-3


@pytest.mark.parametrize("name", ["slider_crank", "four_bar", "rssr", "rspc", "hooke_joint",
                                  "spherical_four_bar"])
def test_labels_tell_two_modes_apart_and_stay_along_the_motion(name):
    mechanism = from_library(name)
    crank = next(iter(mechanism.drivers))
    labels = {}
    for state in sp.assembly_modes(mechanism, {crank: 0.7}):
        labels[state.branch] = state
    assert set(labels) == {"+", "-"}
    followed = sp.sweep(mechanism, crank, [0.7, 0.8, 0.9, 1.0], guess=labels["+"])
    last = {key: followed.coordinate(key).value[-1] for key in definite(mechanism)}
    (match,) = [s for s in sp.assembly_modes(mechanism, {crank: 1.0}) if differs(s, last) < SAME]
    assert match.branch == "+"


def test_a_mode_where_branches_meet_is_labelled_singular(tmp_path):
    regular = sp.assembly_modes(bare_four_bar(tmp_path, 3.0, 1.0, 1.5, 2.5), {"crank": 0.0})
    assert {s.branch for s in regular} == {"+", "-"}
    stretched = sp.assembly_modes(bare_four_bar(tmp_path, 3.0, 1.0, 1.0, 3.0), {"crank": np.pi})
    assert [s.branch for s in stretched] == ["singular"]  # coupler and rocker in one line


# ---------------------------------------------------------------- what is one mode


@pytest.mark.parametrize("resolved", [True, False])
def test_a_spinning_coupler_does_not_multiply_modes(resolved, tmp_path):
    tree = (turning("crank_pin", "ground", "crank", axis=(0, 1, 0))
            + floating("ball_a", "crank", "coupler", (-0.102, 0, 0))
            + point("coupler_b", "coupler", (0, 0, 0.381))
            + turning("rocker_pin", "ground", "rocker", (-0.314, 0, 0), (0, 0, -1))
            + point("rocker_b", "rocker", (-0.254, 0, 0)))
    mechanism = load(tmp_path, "rssr", tree, refine("ball_a", "spherical")
                     + driver("crank", "crank_pin")
                     + closure("ball_b", "spherical", "coupler_b", "rocker_b")
                     + '[passive.spin]\nbody = "coupler"\naxis = ["ball_a", "coupler_b"]\n'
                     * resolved)
    assert_same_set(sp.assembly_modes(mechanism, {"crank": 0.7}), rssr(0.7))


def test_a_spinning_slipper_does_not_multiply_modes(tmp_path):
    assert len(sp.assembly_modes(swash_plate(tmp_path), {"shaft": 0.7})) == 1


@pytest.mark.parametrize("turns", [-3, 0, 2])
def test_whole_turns_of_the_driver_do_not_multiply_modes(turns):
    mechanism, crank = from_library("four_bar"), 0.7 + 2 * np.pi * turns
    modes = sp.assembly_modes(mechanism, {"crank": crank})
    assert_same_set(modes, four_bar(0.7))
    assert all(state.coordinate("crank_pin").value == crank for state in modes)


def test_angles_are_within_half_a_turn():
    for state in sp.assembly_modes(from_library("watt_six_bar"), {"crank": 0.7}):
        for name in ("coupler_pin", "rocker_pin", "link_pin", "output_pin"):
            assert abs(state.coordinate(name).value) <= np.pi + 1e-12


def test_mirror_roots_are_no_modes():
    """The revolute closure of a plane linkage may not be closed with its axis turned round."""
    for state in sp.assembly_modes(from_library("spherical_four_bar"), {"crank": 0.7}):
        one, other = (state.placement(f).rotation[:, 2] for f in ("coupler_b", "rocker_b"))
        assert one @ other == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("size", [1e-4, 1e4])
def test_size_does_not_change_the_modes(size, tmp_path):
    lengths = [size * x for x in (0.30, 0.10, 0.28, 0.24)]
    modes = sp.assembly_modes(bare_four_bar(tmp_path, *lengths), {"crank": 0.7})
    assert_same_set(modes, four_bar(0.7))


# ---------------------------------------------------------------- none, or too many


@pytest.mark.parametrize(("name", "held"), [
    ("four_bar", {"rocker_pin": 0.0}), ("slider_crank", {"slide": 0.3}),
    ("rssr", {"rocker_pin": 0.2}),
])
def test_unreachable_values_give_no_modes(name, held):
    assert sp.assembly_modes(from_library(name), held) == []


def test_a_coordinate_may_be_held_instead_of_a_driver():
    rocker = four_bar(0.7)[0]["rocker_pin"]
    modes = sp.assembly_modes(from_library("four_bar"), {"rocker_pin": rocker})
    assert len(modes) == 2
    assert min(differs(state, {"crank_pin": 0.7}) for state in modes) < SAME


@pytest.mark.parametrize(("name", "driver_name"), [
    ("four_bar", "crank"), ("rssr", "crank"), ("slider_crank", "crank"), ("rspc", "crank")])
def test_a_mechanism_that_can_still_move_is_refused(name, driver_name):
    with pytest.raises(sp.ContinuumError, match=f"1 freedom, .*{driver_name} is held") as caught:
        sp.assembly_modes(from_library(name), free=[driver_name])
    assert caught.value.hold == (driver_name,)
    assert caught.value.freedoms == 1
    assert caught.value.state.closure_error < 1e-12


def test_isolated_modes_at_a_limit_are_all_listed():
    """The link stands square to the rod, with the collar either way round."""
    modes = sp.assembly_modes(from_library("crank_collar", l=0.125), {"crank": np.pi})
    assert [state.branch for state in modes] == ["singular 1", "singular 2"]


@pytest.mark.parametrize(("name", "crank", "count"), [("peaucellier", 0.3, 4), ("sarrus", 0.7, 2)])
def test_a_family_of_degenerate_configurations_is_reported_beside_the_modes(name, crank, count):
    """The rhombus, or the arms, may fold so that what hangs on them swings freely."""
    mechanism = from_library(name)
    modes = sp.assembly_modes(mechanism, {next(iter(mechanism.drivers)): crank})
    assert len(modes) == count
    (family,) = modes.continua
    assert family.freedoms == 1
    assert sp.mobility(mechanism, family.state).dof > sp.mobility(mechanism, modes[0]).dof
    assert "can move: 1 freedom" in str(modes)


def test_bad_arguments_are_refused():
    mechanism = from_library("four_bar")
    with pytest.raises(sp.SpatialPinError, match="crnk"):
        sp.assembly_modes(mechanism, {"crnk": 0.0})
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="crank"):
            sp.assembly_modes(mechanism, {"crank": bad})


# ---------------------------------------------------------------- published counts

ARM = list(zip((0.3, 1, 0, 1.5, 0, 0), (0, 0, 0.2, 0, 0, 0), np.radians((90, 1, 90, 1, 90, 1)),
               strict=True))  # a, d, alpha
ARM_ANGLES = np.radians((-14, -104, -116, 2, 8, -78))


def arm(folder: Path) -> sp.Mechanism:
    """Six hinges welded to where the known angles put the hand: a loop of seven with one held."""
    tree, last, at, goal = "", "ground", pin.SE3.Identity(), pin.SE3.Identity()
    for k, ((a, d, alpha), angle) in enumerate(zip(ARM, ARM_ANGLES, strict=True), 1):
        tree += turning(f"j{k}", last, f"link{k}", at.translation,
                        rpy=pin.rpy.matrixToRpy(at.rotation))
        last = f"link{k}"
        at = pin.SE3(pin.rpy.rpyToMatrix(alpha, 0.0, 0.0), np.array([a, 0.0, d]))
        goal *= pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, angle), np.zeros(3)) * at
    for name, on, M in (("hand", last, at), ("goal", "ground", goal)):
        tree += point(name, on, M.translation, pin.rpy.matrixToRpy(M.rotation))
    return load(folder, "arm", tree, closure("grip", "weld", "goal", "hand") + guess(j1=0.0))


def signs(states: list[sp.State]) -> list[str]:
    return sorted(state.branch[0] for state in states)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_dietmaiers_platform_has_forty_poses(seed, tmp_path):
    poses = sp.assembly_modes(dietmaier(tmp_path), seed=seed)
    assert len(poses) == 40
    assert poses.missing == 0.0
    assert max(state.closure_error for state in poses) < 1e-12
    assert_distinct([state.placement("platform") for state in poses], 1e-3)
    for state in poses:
        M = state.placement("platform")
        feet = np.array(DIETMAIER_BASE)
        tips = np.array([M.act(np.array(b, float)) for b in DIETMAIER_PLATFORM])
        np.testing.assert_allclose(np.linalg.norm(tips - feet, axis=1), DIETMAIER_LEGS, rtol=0,
                                   atol=1e-11)
    assert signs(poses) == ["+"] * 20 + ["-"] * 20
    assert len({state.branch for state in poses}) == 40


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_arm_has_sixteen_configurations(seed, tmp_path):
    found = sp.assembly_modes(arm(tmp_path), seed=seed)
    assert len(found) == 16
    assert max(state.closure_error for state in found) < 1e-12
    angles = np.array([[state.coordinate(f"j{k}").value for k in range(1, 7)] for state in found])
    gaps = np.abs(wrapped(angles[:, None] - angles[None])).max(axis=2)
    assert np.min(gaps + 10.0 * np.eye(16)) > 1e-3
    assert np.min(np.abs(wrapped(angles - ARM_ANGLES)).max(axis=1)) < SAME
    assert signs(found) == ["+"] * 8 + ["-"] * 8
