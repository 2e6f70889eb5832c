"""Assembly modes: what is one mode, what moves and is none, how many are missing.

Counts come from equations solved here: circles and spheres that meet, and the one angle of a plane
platform on three legs.
"""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from dietmaier import (
    DIETMAIER_BASE,
    DIETMAIER_LEGS,
    DIETMAIER_PLATFORM,
    assert_distinct,
    dietmaier,
)
from loaded_library import library
from mechanisms import (
    closure,
    driver,
    five_bar,
    floating,
    guess,
    load,
    point,
    refine,
    sliding,
    turning,
)
from variety import few

import spatial_pin as sp

pytestmark = pytest.mark.delicate

GOUGH = {f"leg_{k}": 0.37 + 0.01 * k for k in range(1, 7)}
DELTA = {"arm_1": 0.1, "arm_2": 0.2, "arm_3": -0.1}


def gough(folder: Path, base, platform, tilt: float = 0.0, ends=("universal", "spherical")):
    """A platform on legs: a pair at the foot, a slide, another pair at the platform."""
    tree, toml = floating("pose", "ground", "platform"), ""
    for k, (a, b) in enumerate(zip(base, platform, strict=True), 1):
        tree += floating(f"hook_{k}", "ground", f"cylinder_{k}", a, rpy=(0.1 * k, tilt, 0.0))
        tree += sliding(f"slide_{k}", f"cylinder_{k}", f"piston_{k}")
        tree += point(f"b{k}", "platform", b)
        axes = {"axis": (1, 0, 0), "axis2": (0, 1, 0)} if ends[0] == "universal" else {}
        toml += refine(f"hook_{k}", ends[0], **axes)
        toml += closure(f"ball_{k}", ends[1], f"piston_{k}", f"b{k}")
        toml += driver(f"leg_{k}", f"slide_{k}")
    return load(folder, "gough", tree, toml)


def plane_platform(folder: Path, feet, sides, legs) -> sp.Mechanism:
    """A triangle in the plane on three legs of given length, hinged at both ends (3-RR)."""
    tree = turning("q1", "ground", "leg1", (*feet[0], 0.0))
    tree += turning("tip", "leg1", "plate", (legs[0], 0.0, 0.0))
    corners = triangle(*sides)
    toml = ""
    for k in (1, 2):
        tree += turning(f"q{k + 1}", "ground", f"leg{k + 1}", (*feet[k], 0.0))
        tree += point(f"end{k}", f"leg{k + 1}", (legs[k], 0.0, 0.0))
        tree += point(f"corner{k}", "plate", (*corners[k], 0.0))
        toml += closure(f"pin{k}", "revolute", f"end{k}", f"corner{k}")
    return load(folder, "plane_platform", tree, toml)


def triangle(a: float, b: float, c: float) -> list[tuple[float, float]]:
    """Corners 1, 2, 3 with sides 12 = a, 23 = b, 13 = c."""
    x = (a * a + c * c - b * b) / (2 * a)
    return [(0.0, 0.0), (a, 0.0), (x, np.sqrt(c * c - x * x))]


def angles_of_plate(feet, sides, legs) -> list[float]:
    """Angles of the triangle: corner 1 from two differences of circles, put into the first."""
    feet, corners, legs = np.array(feet), np.array(triangle(*sides)), np.array(legs)

    def open_by(phi: float) -> float:
        turn = np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
        u = feet - corners @ turn.T  # |p - u_k| = legs_k
        a = 2 * (u[1:] - u[0])
        b = legs[0] ** 2 - legs[1:] ** 2 + np.sum(u[1:] ** 2, axis=1) - u[0] @ u[0]
        # times the determinant squared, so that it has no poles
        d = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
        p = np.array([b[0] * a[1, 1] - b[1] * a[0, 1], a[0, 0] * b[1] - a[1, 0] * b[0]])
        return float(np.sum((p - d * u[0]) ** 2) - (d * legs[0]) ** 2)

    grid = np.linspace(-np.pi, np.pi, 20001)
    values = [open_by(phi) for phi in grid]
    return [float(x) for x, one, two in zip(grid, values, values[1:], strict=False)
            if one * two < 0.0]


# ---------------------------------------------------------------- one mode: links, not coordinates


def test_a_gough_platform_has_as_many_modes_as_poses():
    modes = sp.assembly_modes(library("stewart"), GOUGH)
    assert len(modes) == 8
    assert_distinct([state.placement("platform") for state in modes], 1e-3)
    for state in modes:
        for k in range(1, 7):
            foot = state.placement(f"hook_{k}").translation
            top = state.placement(f"platform_{k}").translation
            assert np.linalg.norm(top - foot) == pytest.approx(GOUGH[f"leg_{k}"], abs=1e-12)


def test_a_delta_robot_has_two_level_poses_among_its_modes():
    """Level, the platform's middle is where three spheres meet."""
    modes = sp.assembly_modes(library("delta"), DELTA)
    assert len(modes) == 16
    assert_distinct([state.placement("platform") for state in modes], 1e-3)
    level = [s for s in modes if np.allclose(s.placement("platform").rotation, np.eye(3))]
    assert len(level) == 2
    for state in level:
        for k in (1, 2, 3):
            for side in "ab":
                elbow = state.placement(f"elbow_{k}{side}").translation
                ball = state.placement(f"platform_{k}{side}").translation
                assert np.linalg.norm(ball - elbow) == pytest.approx(
                    library("delta").dimensions["ll"], abs=1e-12)


@pytest.mark.parametrize(("name", "values", "readings"), [("stewart", GOUGH, 64)])
def test_copies_are_the_readings_of_the_universal_joints(name, values, readings):
    mechanism = library(name)
    modes = sp.assembly_modes(mechanism, values)
    copies = sp.assembly_modes(mechanism, values, copies=True)
    assert len(copies) == readings * len(modes)
    assert max(state.closure_error for state in copies) < 1e-12
    assert len({state.branch for state in copies}) == len(copies)
    poses = {tuple(np.round(state.placement("platform").homogeneous.ravel(), 6) + 0.0)
             for state in copies}
    assert len(poses) == len(modes)


@pytest.mark.parametrize("ends", [("universal", "spherical"), ("spherical", "spherical")])
@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_legs_are_distances_whatever_their_pairs(ends, size, tmp_path):
    """Four of the platform's legs only lie elsewhere: the counts are those of the distances."""
    base = [np.array(a) * size for a in DIETMAIER_BASE]
    plate = [np.array(b) * size * 0.8 for b in DIETMAIER_PLATFORM]
    M = pin.SE3(pin.rpy.rpyToMatrix(0.2, -0.4, 0.3), size * np.array([0.3, 0.2, 0.7]))
    lengths = [float(np.linalg.norm(M.act(b) - a)) for a, b in zip(base, plate, strict=True)]
    tree, toml = floating("pose", "ground", "platform"), ""
    for k, (a, b, length) in enumerate(zip(base, plate, lengths, strict=True), 1):
        tree += point(f"a{k}", "ground", a) + point(f"b{k}", "platform", b)
        toml += closure(f"leg{k}", "distance", f"a{k}", f"b{k}", length=length)
    plain = sp.assembly_modes(load(tmp_path, "plain", tree, toml))
    values = {f"leg_{k}": x for k, x in enumerate(lengths, 1)}
    whole = sp.assembly_modes(gough(tmp_path, base, plate, 0.5, ends), values)
    assert len(plain) == len(whole) > 0
    poses = [[state.placement("platform").homogeneous for state in modes]
             for modes in (plain, whole)]
    for pose in poses[0]:
        gaps = [np.abs((pose - other) / [1, 1, 1, size]).max() for other in poses[1]]
        assert min(gaps) < 1e-8
    assert any(np.allclose(pose, M.homogeneous, atol=1e-9 * size) for pose in poses[1])


def test_a_platform_far_from_the_origin_has_as_many_modes(tmp_path):
    counts = []
    for k, away in enumerate((0.0, 200.0)):
        tree, toml = floating("pose", "ground", "platform"), ""
        M = pin.SE3(pin.rpy.rpyToMatrix(0.4, -1.1, 0.3), away * np.array([1.0, -0.6, 0.8]))
        pose = pin.SE3(pin.rpy.rpyToMatrix(0.2, -0.4, 0.3), np.array([0.3, 0.2, 0.7]))
        for leg, (a, b) in enumerate(zip(DIETMAIER_BASE, DIETMAIER_PLATFORM, strict=True)):
            a, b = np.array(a, float), 0.8 * np.array(b, float)
            tree += point(f"a{leg}", "ground", M.act(a)) + point(f"b{leg}", "platform", b)
            toml += closure(f"leg{leg}", "distance", f"a{leg}", f"b{leg}",
                            length=float(np.linalg.norm(pose.act(b) - a)))
        counts.append(len(sp.assembly_modes(load(tmp_path, f"platform{k}", tree, toml))))
    assert counts[0] == counts[1] > 0


@pytest.mark.slow
def test_dietmaiers_platform_has_forty_poses_on_legs_too(tmp_path):
    mechanism = gough(tmp_path, DIETMAIER_BASE, DIETMAIER_PLATFORM)
    modes = sp.assembly_modes(mechanism, {f"leg_{k}": x for k, x in enumerate(DIETMAIER_LEGS, 1)})
    assert len(modes) == 40
    assert max(state.closure_error for state in modes) < 1e-12
    plain = sp.assembly_modes(dietmaier(tmp_path))
    for one in plain:
        gaps = [np.abs(one.placement("platform").homogeneous
                       - two.placement("platform").homogeneous).max() for two in modes]
        assert min(gaps) < 1e-9


def test_shafts_that_stand_half_a_turn_apart_are_two_modes():
    """A universal joint's output shaft is no rod: it turns in a bearing."""
    modes = sp.assembly_modes(library("hooke_joint"), {"input": 0.7})
    one, other = (state.coordinate("output").value for state in modes)
    assert abs(one - other) == pytest.approx(np.pi, abs=1e-9)


# ---------------------------------------------------------------- plane platforms


@pytest.mark.parametrize(("feet", "sides", "legs"), [
    ([(0.0, 0.0), (15.91, 0.0), (0.0, 10.0)], (17.04, 16.54, 20.84), (14.98, 15.38, 12.0)),
    pytest.param([(0.0, 0.0), (2.0, 0.3), (0.6, 1.7)], (1.1, 0.9, 1.3), (1.3, 1.2, 1.0),
                 marks=pytest.mark.slow),
    ([(0.0, 0.0), (1.0, 0.0), (0.5, 1.0)], (0.5, 0.4, 0.45), (0.8, 0.7, 0.9)),
])
def test_a_plane_platform_has_the_modes_of_its_angle(feet, sides, legs, tmp_path):
    """Up to six [Innocenti1990]; every angle of the plate belongs to one mode."""
    expected = angles_of_plate(feet, sides, legs)
    modes = sp.assembly_modes(plane_platform(tmp_path, feet, sides, legs))
    assert len(modes) == len(expected)
    found = sorted(float(np.arctan2(*state.placement("plate").rotation[1::-1, 0]))
                   for state in modes)
    np.testing.assert_allclose(found, sorted(expected), rtol=0, atol=1e-3)


# ---------------------------------------------------------------- what moves is no mode


def griffis_duffy(folder: Path, pose: pin.SE3) -> sp.Mechanism:
    s = np.sqrt(3) / 2
    base = [(0, 0, 0), (-0.5, s, 0), (0.5, s, 0), (1.5, s, 0), (1, 0, 0), (0.5, -s, 0)]
    plate = [(0, 0, 0), (0.5, s, 0), (1, 2 * s, 0), (1.5, s, 0), (2, 0, 0), (1, 0, 0)]
    tree, toml = floating("pose", "ground", "platform"), ""
    for k, (a, b) in enumerate(zip(base, plate, strict=True), 1):
        length = float(np.linalg.norm(pose.act(np.array(b, float)) - np.array(a)))
        tree += point(f"a{k}", "ground", a) + point(f"b{k}", "platform", b)
        toml += closure(f"leg{k}", "distance", f"a{k}", f"b{k}", length=length)
    return load(folder, "griffis_duffy", tree, toml)


@pytest.mark.parametrize("rpy", [(0.3, -0.2, 0.5), (-0.4, 0.3, 1.1)])
def test_a_platform_that_moves_on_six_legs_is_refused(rpy, tmp_path):
    pose = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array([0.1, -0.3, 1.2]))
    with pytest.raises(sp.ContinuumError, match=r"1 freedom, of pose\.x"):
        sp.assembly_modes(griffis_duffy(tmp_path, pose))


def test_the_remedy_of_the_refusal_helps(tmp_path):
    mechanism = five_bar(tmp_path)
    with pytest.raises(sp.ContinuumError, match="right is held too") as caught:
        sp.assembly_modes(mechanism, {"left": 1.9}, free=["right"])
    held = {"left": 1.9} | {name: caught.value.state.coordinate(name).value
                            for name in caught.value.hold}
    modes = sp.assembly_modes(mechanism, held)
    assert 0 < len(modes) <= 2
    assert not modes.continua


def test_nothing_held_names_all_that_can_be_driven():
    with pytest.raises(sp.ContinuumError, match="6 freedoms") as caught:
        sp.assembly_modes(library("stewart"), free=[f"leg_{k}" for k in range(1, 7)])
    assert caught.value.hold == tuple(f"leg_{k}" for k in range(1, 7))
    assert pickle.loads(pickle.dumps(caught.value)).hold == caught.value.hold


def test_a_link_that_hangs_free_is_no_set_of_modes(tmp_path):
    """A pendulum on the coupler of nothing: it moves alone, but is in no loop."""
    tree = (turning("crank", "ground", "arm") + turning("swing", "arm", "bob", (1.0, 0.0, 0.0)))
    mechanism = load(tmp_path, "pendulum", tree, driver("crank", "crank"))
    with pytest.raises(sp.ContinuumError, match="swing is held too"):
        sp.assembly_modes(mechanism, {"crank": 0.3})
    assert len(sp.assembly_modes(mechanism, {"crank": 0.3, "swing": 0.2})) == 1


def test_a_link_that_moves_alone_along_a_curve_is_refused(tmp_path):
    """On a ball and on a plane it has no axis of its own to idle about, unless both are one."""
    tree = (floating("ball", "ground", "link") + point("foot", "link", (0.3, 0.0, 0.0))
            + point("nose", "link", (0.0, 0.2, 0.0)) + point("post", "ground", (0.1, 0.5, 0.2))
            + point("floor", "ground", (0.0, 0.0, 0.1)))
    toml = refine("ball", "spherical") + closure("contact", "point_on_plane", "floor", "foot")
    rod = closure("rod", "distance", "post", "nose", length=0.45)
    with pytest.raises(sp.ContinuumError, match=r"1 freedom, of ball\.x"):
        sp.assembly_modes(load(tmp_path, "curve", tree, toml + rod))


def test_drivers_that_nobody_named_stand_at_the_guess():
    mechanism = library("four_bar")
    at_guess = mechanism.guess["crank_pin"]
    modes = sp.assembly_modes(mechanism)
    assert len(modes) == 2
    assert [state.coordinate("crank").value for state in modes] == [at_guess] * 2


# ---------------------------------------------------------------- the list


def test_the_list_knows_how_complete_it_is():
    modes = sp.assembly_modes(library("rssr"), {"crank": 0.7})
    assert isinstance(modes, list)
    assert modes.missing == 0.0
    assert modes.held == {"crank_pin": 0.7}
    assert sum(modes.counts) == modes.closed <= modes.starts
    text = str(modes)
    assert "2 assembly modes found at crank_pin = 0.7" in text
    assert "none is expected to be missing" in text


def test_few_starts_tell_that_modes_are_missing(tmp_path):
    modes = sp.assembly_modes(dietmaier(tmp_path), most_starts=64)
    assert len(modes) < 40
    assert 0.3 * 40 < len(modes) + modes.missing < 2 * 40
    assert "more must be expected" in str(modes)


def test_the_list_pickles():
    modes = sp.assembly_modes(library("rssr"), {"crank": 0.7})
    again = pickle.loads(pickle.dumps(modes))
    assert type(again) is sp.AssemblyModes
    assert str(again) == str(modes)
    assert [s.branch for s in again] == [s.branch for s in modes]


@pytest.mark.parametrize(("name", "values"), [
    ("stewart", GOUGH), ("delta", DELTA), ("peaucellier", {"crank": 0.3}),
    ("double_cardan", {"input": 0.7})])
def test_labels_are_unique(name, values):
    labels = [state.branch for state in sp.assembly_modes(library(name), values)]
    assert len(set(labels)) == len(labels)
    assert set("".join(labels)) <= set("+-0123456789")


@pytest.mark.parametrize("seed", few([1, 7], 7))
def test_every_start_gives_the_same_reading_of_rods(seed):
    """Also where a start found another reading of the legs, or another spin of the coupler."""
    for name, values in (("stewart", GOUGH), ("rssr", {"crank": 0.7})):
        first = sp.assembly_modes(library(name), values)
        other = sp.assembly_modes(library(name), values, seed=seed)
        for one, two in zip(first, other, strict=True):
            np.testing.assert_allclose(one.q, two.q, rtol=0, atol=1e-9)


# ---------------------------------------------------------------- joint limits


def test_modes_beyond_joint_limits_are_omitted_on_request(tmp_path):
    """The slide is on one side only; its limits exclude the other."""
    tree = (turning("crank", "ground", "arm") + turning("elbow", "arm", "rod", (0.1, 0.0, 0.0))
            + point("rod_end", "rod", (0.3, 0.0, 0.0))
            + sliding("slide", "ground", "block", axis=(1, 0, 0)))
    toml = (driver("crank", "crank") + guess(slide=0.3)
            + closure("wrist", "revolute", "rod_end", "block"))
    mechanism = load(tmp_path, "slider", tree, toml)
    at = mechanism.coordinate("slide").q
    assert len(sp.assembly_modes(mechanism, {"crank": 0.7})) == 2
    mechanism.model.lowerPositionLimit[at] = 0.0
    (kept,) = sp.assembly_modes(mechanism, {"crank": 0.7}, limits=True)
    assert kept.coordinate("slide").value > 0.0


def test_a_mode_of_which_one_copy_keeps_the_limits_is_kept():
    """Both readings of a leg's universal joint count: limits of half a turn leave one of them."""
    mechanism = library("stewart")
    names = [f"hook_{k}.second" for k in range(1, 7)]
    at = [mechanism.coordinate(name).q for name in names]
    modes = sp.assembly_modes(mechanism, GOUGH)
    for sign in (1.0, -1.0):  # |second| below, then above a quarter turn
        mechanism.model.lowerPositionLimit[at] = -np.pi / 2 if sign > 0 else np.pi / 2
        mechanism.model.upperPositionLimit[at] = np.pi / 2 if sign > 0 else 3 * np.pi / 2
        kept = sp.assembly_modes(mechanism, GOUGH, limits=True)
        assert len(kept) == len(modes)
    slides = [mechanism.coordinate(f"slide_{k}").q for k in range(1, 7)]
    mechanism.model.lowerPositionLimit[slides] = 0.1
    mechanism.model.upperPositionLimit[slides] = 0.2
    assert sp.assembly_modes(mechanism, GOUGH, limits=True) == []


# ---------------------------------------------------------------- command line


def test_the_command_tells_modes_and_how_complete_they_are(run):
    code, text, _ = run("modes", "stewart", *(f"{name}={x}" for name, x in GOUGH.items()))
    assert code == 0
    assert "8 assembly modes found" in text
    assert "none is expected to be missing" in text
    code, text, _ = run("modes", "rssr", "crank=0.7", "--copies", "--limits", "--json", "-")
    assert code == 0 and len(json.loads(text)) == 2


def test_the_command_refuses_what_can_move(tmp_path, run):
    tree = turning("crank", "ground", "arm") + turning("swing", "arm", "bob", (1.0, 0.0, 0.0))
    load(tmp_path, "pendulum", tree, driver("crank", "crank"))
    code, _, told = run("modes", tmp_path / "pendulum.toml", "crank=0.3")
    assert code == 1 and "it stops when swing is held too" in told
