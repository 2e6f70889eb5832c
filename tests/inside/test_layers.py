"""What is drawn besides the bodies, layer by layer: where it stands, which way it points."""

import math
import re
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from chromium import needs_browser
from images import colour_mask, ink, near, page, z_axis
from loaded_library import library
from mechanisms import (
    closure,
    driver,
    floating,
    guess,
    load,
    point,
    refine,
    turning,
)
from pictured import (
    ARM,
    BLUE,
    GREEN,
    RED,
    SHAPES,
    SHOWN,
    TURN,
    arm,
    photograph,
    rssr,
    shown_as,
    swept,
    without_picture,
    without_picture_of,
)
from variety import each

import spatial_pin as sp
from spatial_pin.mechanism.pairs import JOINT_TYPES, closure_types
from spatial_pin.view.scene.film import film, length_words, nice
from spatial_pin.view.scene.framing import ASPECT, FIELD_OF_VIEW, Framing, frame, occupied, rotate
from spatial_pin.view.scene.layers import arrows
from spatial_pin.view.scene.layers.arrows import TRACE_COLOURS
from spatial_pin.view.scene.layers.glyphs import GLYPHS, glyphs, pairs_of
from spatial_pin.view.scene.layers.visuals import (
    BODY_COLOURS,
    GROUND_COLOUR,
    colour,
    contacts,
    link_of,
    skeleton,
)
from spatial_pin.view.scene.meshcat_commands import scene
from spatial_pin.view.scene.stage import Stage, joint_poses, quaternions_along, upright


def stage_of(shown: object) -> Stage:
    made = film(shown)
    model = made.mechanism.model
    return Stage(made, (), joint_poses(model, made.q), upright(model), 1.0)


def test_a_direction_that_is_not_given_is_the_last_one():
    v = np.array([[0, 0, 0], [0, 0, -2.0], [0, 0, 0], [3.0, 0, 0], [0, 0, 0]])
    expected = [[0, 0, 1], [0, 0, -1], [0, 0, -1], [1, 0, 0], [1, 0, 0]]
    np.testing.assert_allclose(z_axis(quaternions_along(v)), expected, atol=1e-12)


def opened(tmp_path, kind: str, x: pin.SE3, **keys: float) -> sp.State:
    """Frame 2 of a closure at a placement x of frame 1, which is not the world's."""
    tree = point("one", "ground", (0.3, 0.2, 0.1), (0.4, -0.7, 1.1)) + floating(
        "free", "one", "two"
    )
    mechanism = load(tmp_path, "open", tree, closure("loop", kind, "one", "two", **keys))
    return sp.State(mechanism, pin.SE3ToXYZQUAT(x), closure_error=1.0)


@pytest.mark.parametrize(
    ("kind", "keys", "should_be"),
    [
        ("spherical", {}, (0, 0, 0)),
        ("revolute", {}, (0, 0, 0)),
        ("cylindrical", {}, (0, 0, 0.12)),
        ("prismatic", {}, (0, 0, 0.12)),
        ("point_on_line", {}, (0, 0, 0.12)),
        ("planar", {}, (0.03, 0.04, 0)),
        ("point_on_plane", {}, (0.03, 0.04, 0)),
        ("distance", {"length": 0.26}, (0.06, 0.08, 0.24)),
    ],
)
def test_gap_is_from_where_the_frame_should_be_to_where_it_is(tmp_path, kind, keys, should_be):
    p = np.array([0.03, 0.04, 0.12])
    state = opened(tmp_path, kind, pin.SE3(np.eye(3), p), **keys)
    items = {item.name: item for item in scene(film(state)).layer.items}
    one = state.placement("one")
    here, there = (items[f"gap loop {end}"].track.poses[0, :3] for end in ("from", "to"))
    np.testing.assert_allclose(there, one.act(p), atol=1e-12)
    np.testing.assert_allclose(here, one.act(np.array(should_be, float)), atol=1e-12)


@pytest.mark.parametrize("kind", ["weld", "prismatic", "revolute", "parallel"])
def test_turned_frames_are_reported_in_degrees_and_shown_as_two_directions(tmp_path, kind):
    turn = pin.SE3(pin.exp3(np.array([0.2, 0.0, 0.0])), np.zeros(3))
    state = opened(tmp_path, kind, turn)
    layer = scene(film(state)).layer
    (alarm,) = layer.alarms
    assert alarm.text(0) == "closure loop open by 11.5°"
    one, two = (state.placement(name).rotation for name in ("one", "two"))
    tracks = [i.track for i in layer.items if i.name.startswith("turned")]
    shown = [z_axis(track.poses[:, 3:])[0] for track in tracks]
    angle = math.acos(shown[0] @ shown[1])
    assert angle == pytest.approx(0.2)
    np.testing.assert_allclose(one.T @ shown[0], two.T @ shown[1], atol=1e-12)


KINDS = [kind for kind in JOINT_TYPES if kind in GLYPHS]
AXES = {"universal": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))}
SKEW = np.array([2.0, -3.0, 6.0]) / 7.0


def test_every_pair_that_has_a_place_has_a_sign():
    without = {"fixed", "weld", "floating", "coupling"}
    assert set(GLYPHS) == {*closure_types(), *JOINT_TYPES} - without


def joint_of(tmp_path, kind: str) -> sp.State:
    """A joint on a tilted base, moved, its axis askew where it has one."""
    keys = {"screw": {"lead": 0.02}}.get(kind, {})
    if kind == "universal":
        keys = {"axis": AXES[kind][0], "axis2": AXES[kind][1]}
    elif kind != "spherical":
        keys["axis"] = SKEW
    tree = floating("pair", "ground", "body", (0.3, -0.2, 0.5), (0.4, -0.7, 1.1))
    mechanism = load(tmp_path, "one", tree + point("tip", "body", (0.2, 0, 0)),
                     refine("pair", kind, **keys))
    v = np.linspace(0.1, 0.3, mechanism.model.nv)
    return sp.State(mechanism, pin.integrate(mechanism.model, mechanism.neutral, v),
                    closure_error=0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_sign_of_a_joint_stands_on_it_with_its_axis(tmp_path, kind):
    state = joint_of(tmp_path, kind)
    layer = glyphs(stage_of(state), through=False)
    base = state.mechanism.model.jointPlacements[1]
    body = state.placement("body")
    assert {item.joint for item in layer.items} == {0, 1}
    for item in layer.items:
        assert item.name.startswith(f"{kind} pair")
        world = state.data.oMi[item.joint].homogeneous @ item.placement
        frame = base if item.joint == 0 else body
        np.testing.assert_allclose(world[:3, 3], frame.translation, atol=1e-12)
        if kind != "spherical":
            axis = AXES.get(kind, (SKEW, SKEW))[item.joint]
            np.testing.assert_allclose(world[:3, 2], frame.rotation @ axis, atol=1e-12)


@pytest.mark.parametrize("kind", [k for k in closure_types() if k in GLYPHS])
def test_sign_of_a_closure_stands_on_its_frames(tmp_path, kind):
    keys = {"distance": {"length": 0.2}, "rope": {"length": 0.2},
            "point_on_curve": {"curve": "c"}, "cam": {"curve": "c", "follower": {"roller": 0.02}},
            "frame_on_curve": {"curve": "c"}, "curve_on_curve": {"curves": ["c", "c"]},
            "screw": {"lead": 0.02}}.get(kind, {})
    state = opened(tmp_path, kind, pin.SE3(np.eye(3), np.array([0.03, 0.04, 0.12])), **keys)
    stage = stage_of(state)
    items = [item for item in glyphs(stage, through=False).items if item.name.startswith(kind)]
    (place,) = [place for place in pairs_of(state.mechanism) if place.name == "loop"]
    axes1, axes2 = (state.mechanism.closures[0].geometry.axes1,
                    state.mechanism.closures[0].geometry.axes2)
    for item in items:
        if item.track is not None:  # the rod of a distance
            length = np.linalg.norm([0.03, 0.04, 0.12])
            assert item.track.scales[0, 2] == pytest.approx(length)
            continue
        world = state.data.oMi[item.joint].homogeneous @ item.placement
        name, axes = ("one", axes1) if item.joint == place.joints[0] else ("two", axes2)
        frame = state.placement(name)
        np.testing.assert_allclose(world[:3, 3], frame.translation, atol=1e-12)
        if kind != "spherical":
            np.testing.assert_allclose(world[:3, :3], frame.rotation @ axes, atol=1e-12)


@pytest.mark.parametrize(("follower", "sign"), [
    ({"roller": 0.02}, "roller"), ({"flat": [0.0, 1.0, 0.0]}, "face")])
def test_a_cam_is_drawn_with_its_follower_and_where_they_touch(follower, sign):
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "cam")
    model.addJoint(0, pin.JointModelPY(), pin.SE3.Identity(), "rod")
    profile = sp.curves.circle(0.1, [0.03, 0.0, 0.0])
    mech = sp.Mechanism.from_model(
        model, [sp.closures.cam("cam", "rod", profile, follower, "contact")], drivers=["cam"],
        guess={"rod": 0.2})
    stage = stage_of(sp.sweep(mech, "cam", [0.0, 1.0, 2.0]))
    layer = contacts(stage)
    items = {item.name: item for item in layer.items}
    assert set(items) == {"curve contact", "contact contact", f"{sign} contact"}
    turn, rod = np.array([0.0, 1.0, 2.0]), stage.points(2, np.zeros(3))
    centre = 0.03 * np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    normal = np.array([[0.0, 1.0, 0.0]] * 3) if sign == "face" else (rod - centre) / 0.12
    np.testing.assert_allclose(items["contact contact"].track.poses[:, :3],
                               centre + 0.1 * normal, atol=1e-12)
    corners = items["curve contact"].solid.geometry.vertices
    away = np.linalg.norm(np.asarray(corners).reshape(-1, 3) - [0.03, 0.0, 0.0], axis=1)
    assert away == pytest.approx(0.1, abs=0.01 * stage.size)


def test_rail_of_a_slider_reaches_as_far_as_it_goes():
    mechanism = sp.load("slider_crank")
    motion = sp.sweep(mechanism, "crank", TURN)
    held = glyphs(stage_of(motion), through=True).points
    x = motion.frame("slider").position
    assert np.all(held.max(axis=0) >= x.max(axis=0)) and np.all(held.min(axis=0) <= x.min(axis=0))


def test_skeleton_has_every_stick_once_and_bodies_apart():
    model = sp.load("peaucellier").model
    sticks = {}
    for stick in skeleton(model).geometryObjects:
        if "stick" in stick.name:
            end = tuple(np.round(2 * stick.placement.translation, 9))
            assert (stick.parentJoint, end) not in sticks
            sticks[stick.parentJoint, end] = stick.geometry.radius
    thickness = {joint: radius for (joint, _), radius in sticks.items()}
    assert min(np.diff(sorted(thickness.values()))) > 0.01 * min(thickness.values())


def test_skeleton_reaches_every_fixed_frame(tmp_path):
    tree = turning("pin", "ground", "arm") + point("tool", "arm", (0.2, 0.1, 0.0))
    model = load(tmp_path, "arm", tree, "").model
    ends = [2 * s.placement.translation for s in skeleton(model).geometryObjects
            if s.parentJoint == 1]
    np.testing.assert_allclose(ends, [[0.2, 0.1, 0.0]], atol=1e-12)


def test_sticks_belong_to_their_links():
    motion = rssr(5)
    partly = without_picture_of(motion.mechanism, "crank_pin")
    parts = scene(film(replace(motion, mechanism=partly))).parts
    assert {p["name"] for p in parts if " stick " in p["path"]} == {"crank"}
    assert {p["name"] for p in parts if p["group"] == "links"} == {
        "ground", "crank", "coupler", "rocker"}


def test_signs_are_small_where_pairs_stand_close_together(tmp_path):
    far, close = (load(tmp_path, f"chain{k}",
                       turning("a", "ground", "one", (0, 0, 0))
                       + turning("b", "one", "two", (reach, 0, 0))
                       + turning("c", "two", "three", (1.0, 0, 0)), "")
                  for k, reach in enumerate((1.0, 0.04)))
    largest = [{item.name: np.ptp(item.solid.geometry.profile[:, 1]) for item in
                glyphs(stage_of(sp.assemble(m)), through=False).items if item.name.endswith(" 0")}
               for m in (far, close)]
    assert largest[0]["revolute a 0"] == largest[0]["revolute c 0"] == largest[1]["revolute c 0"]
    assert largest[1]["revolute a 0"] == largest[1]["revolute b 0"] < 0.04
    assert largest[1]["revolute b 0"] < 0.4 * largest[0]["revolute b 0"]


def test_centres_of_mass_move_with_their_links():
    motion = rssr(9)
    mechanism = motion.mechanism
    layer = scene(film(motion), sp.Look(centres=True)).layer
    marks = {i.name.removeprefix("centre of mass, "): i for i in layer.items if "centre" in i.name}
    for link in ("crank", "coupler", "rocker"):
        item, data = marks[link], mechanism.model.createData()
        pin.forwardKinematics(mechanism.model, data, motion.q[4])
        world = data.oMi[item.joint].act(item.placement[:3, 3])
        np.testing.assert_allclose(world, motion.com(link).position[4], atol=1e-12)


def test_ghosts_are_where_they_stand_and_half_transparent():
    mechanism = sp.load("four_bar")
    first, other = (sp.assemble(mechanism, {"crank": value}) for value in (0.3, 1.5))
    layer = scene(film(first), sp.Look(ghosts=(other,))).layer
    drawn = [item for item in layer.items if item.name.startswith("ghost 1")]
    visuals = [v for v in mechanism.visual_model.geometryObjects if v.parentJoint != 0]
    assert len(drawn) == len(visuals)
    for item, visual in zip(drawn, visuals, strict=True):
        expected = other.data.oMi[visual.parentJoint] * visual.placement
        np.testing.assert_allclose(item.placement, expected.homogeneous, atol=1e-12)
        assert item.colour[3] < 0.5
    assert any("crank = 85.9°" in entry.text for entry in layer.legend)


def test_assembly_modes_are_shown_side_by_side_with_their_names():
    first, *others = sp.assembly_modes(sp.load("watt_six_bar"), {"crank": 0.3})
    drawn = scene(film(first), sp.Look(ghosts=tuple(others), side_by_side=True))
    labels = drawn.layer.labels
    assert [text.split(",")[0] for text, _ in labels] == [
        f"branch {s.branch}" for s in (first, *others)
    ]
    moved = [item for item in drawn.layer.items if item.name.startswith("beside 1")]
    assert len(moved) == first.mechanism.visual_model.ngeoms
    alone = scene(film(first)).framing
    steps = [point - labels[0][1] for _, point in labels[1:]]
    assert min(map(np.linalg.norm, steps)) > 0.5 * alone.radius
    assert drawn.framing.radius > 1.2 * alone.radius


def test_ghost_has_the_dimensions_of_its_own_mechanism():
    first = sp.assemble(sp.load("four_bar"), {"crank": 0.3})
    other = sp.assemble(sp.load("four_bar", r3=0.34), {"crank": 0.3})
    layer = scene(film(first), sp.Look(ghosts=other)).layer
    drawn = [item for item in layer.items if item.name.startswith("ghost 1")]
    visuals = [v for v in other.mechanism.visual_model.geometryObjects if v.parentJoint != 0]
    for item, visual in zip(drawn, visuals, strict=True):
        expected = other.data.oMi[visual.parentJoint] * visual.placement
        np.testing.assert_allclose(item.placement, expected.homogeneous, atol=1e-12)


def turned(first: float, last: float, n: int, **changes: float) -> sp.Motion:
    mechanism = sp.load("four_bar", **{k: v for k, v in changes.items() if k != "speed"})
    speed = {"speed": changes["speed"]} if "speed" in changes else {}
    return sp.sweep(mechanism, "crank", np.linspace(first, last, n), **speed)


@pytest.mark.parametrize(("one", "other", "words", "crank"), [
    ((0.0, 6.0, 61, 1.0), (0.5, 5.0, 31, 2.0), "at the same times", lambda s: 0.5 + 2.0 * s),
    ((0.0, 6.0, 61, None), (5.0, 0.5, 31, None), "at the same crank", lambda s: s),
    ((0.0, 6.0, 61, 1.0), (0.5, 5.0, 31, None), "at the same crank", lambda s: s),
    ((0.0, 1.0, 61, None), (3.0, 5.0, 31, None), "from beginning to end", lambda s: 3.0 + s),
], ids=["time", "driver", "one has no time", "nothing in common"])
def test_motion_as_a_ghost_goes_with_the_film(one, other, words, crank):
    shown = turned(*one[:3], **({"speed": one[3]} if one[3] else {}))
    ghost = turned(*other[:3], r3=0.34, **({"speed": other[3]} if other[3] else {}))
    layer = scene(film(shown), sp.Look(ghosts=ghost)).layer
    assert any(words in entry.text for entry in layer.legend)
    drawn = [item for item in layer.items if item.name.startswith("ghost 1")]
    assert drawn and all(item.colour[3] < 0.5 for item in drawn)
    joint = ghost.mechanism.joint_id("crank_pin")
    (visual,) = [v for v in ghost.mechanism.visual_model.geometryObjects
                 if v.parentJoint == joint][:1]
    (item,) = [x for x in drawn if x.name.endswith(visual.name)][:1]
    made = film(shown)
    for seconds, pose in list(zip(item.track.seconds, item.track.poses, strict=True))[::7]:
        here = np.interp(seconds, made.seconds, shown.time if shown.time is not None
                         else np.linspace(*one[:3])) if "same" in words else \
            2.0 * seconds / made.seconds[-1]
        values = [ghost.driver[0], crank(here)]
        state = sp.sweep(ghost.mechanism, "crank", values, guess=ghost.state(0)).state(-1)
        expected = pin.SE3ToXYZQUAT(state.data.oMi[joint])
        np.testing.assert_allclose(pose[:3], expected[:3], atol=1e-9)
        assert abs(pose[3:] @ expected[3:]) == pytest.approx(1.0, abs=1e-9)


# How linear red, green, blue are seen without a kind of cones (Machado, Oliveira, Fernandes 2009).
CONES = {
    "all": np.eye(3),
    "no red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
               [-0.003882, -0.048116, 1.051998]],
    "no green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                 [-0.011820, 0.042940, 0.968881]],
    "no blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                [0.004733, 0.691367, 0.303900]],
}
TO_XYZ = np.array([[0.4339, 0.3762, 0.1899], [0.2126, 0.7152, 0.0722],  # white is (1, 1, 1)
                   [0.0178, 0.1095, 0.8730]])


def lab(colours: np.ndarray, cones: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of sRGB colours (K, 3), as they are seen."""
    linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    x, y, z = np.cbrt(np.clip(linear @ np.transpose(cones), 0, 1) @ TO_XYZ.T).T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


@pytest.mark.parametrize("missing", CONES)
def test_colours_of_bodies_can_be_distinguished(missing):
    seen = lab(np.array([GROUND_COLOUR, *BODY_COLOURS])[:, :3], np.array(CONES[missing]))
    apart = np.linalg.norm(seen[:, None] - seen, axis=2)
    assert apart[np.triu_indices(len(seen), 1)].min() > 14  # 2 is just seen, side by side


@pytest.mark.parametrize("size", [1e-6, 1e3])
def test_pictures_of_any_size_are_the_same(tmp_path, size):
    look = sp.Look(axes=True, traces=("b",), arrows=("b.velocity",))

    def drawn(size: float):
        a, b, c, d = size * np.array([0.102, 0.381, 0.254, 0.314])
        tree = turning("crank_pin", "ground", "crank", axis=(0, 1, 0))
        tree += point("a", "crank", (-a, 0, 0)) + point("b", "rocker", (-c, 0, 0))
        tree += turning("rocker_pin", "ground", "rocker", (-d, 0, 0), (0, 0, -1))
        rod = closure("coupler", "distance", "a", "b", length=b)
        name = f"rod{size:g}".replace("-", "_").replace("+", "_")
        mechanism = load(tmp_path, name, tree, driver("crank", "crank_pin") + rod
                         + guess(rocker_pin=1.2))
        return scene(film(sp.sweep(mechanism, "crank", TURN)), look)

    one, other = drawn(1.0), drawn(size)
    np.testing.assert_allclose(other.framing.camera, one.framing.camera, rtol=1e-3)
    assert other.framing.radius / one.framing.radius == pytest.approx(size, rel=0.3)
    assert [i.name for i in other.layer.items] == [i.name for i in one.layer.items]


@pytest.mark.parametrize(
    ("x", "words"), [(2.0, "2 m"), (0.05, "50 mm"), (2e-5, "20 µm"), (5e-8, "50 nm")]
)
def test_lengths_are_stated_in_the_unit_that_suits_them(x, words):
    assert length_words(x) == words


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
@pytest.mark.parametrize("bare", [False, True])
def test_every_mechanism_of_the_library_is_drawn_with_everything(name, bare):
    mechanism = library(name)
    mechanism = without_picture(mechanism) if bare else mechanism
    state = sp.assemble(mechanism, {})
    link = mechanism.links[-1]
    look = sp.Look(pairs=True, axes=True, centres=True, traces=(link,), ghosts=(state,),
                arrows=(f"{link}.velocity",))
    drawn = scene(film(state), look)
    names = [(item.joint, item.name) for item in drawn.layer.items]
    assert len(names) == len(set(names)) and drawn.layer.alarms == ()
    assert np.all(np.isfinite(drawn.layer.points))


def test_reaction_arrows_are_the_forces_at_the_pairs():
    mechanism = sp.load("rssr")
    motion = sp.sweep(mechanism, "crank", np.linspace(0.0, 1.0, 5), speed=20.0)
    loads = film(motion).loads
    found = arrows.load(loads, "ball_b", "reaction")
    np.testing.assert_array_equal(found.vector,
                                  sp.kinetostatics(mechanism, motion).reactions["ball_b"][:, :3])
    np.testing.assert_allclose(found.point, motion.frame("rocker_b").position)
    with pytest.raises(sp.UnknownNameError, match="ball_b"):
        arrows.load(loads, "ball_c", "reaction")


def test_reactions_of_a_simulation_are_not_laid_to_drivers_that_did_not_act():
    mechanism = sp.load("four_bar")
    state = sp.assemble(mechanism, {"crank": 0.3})
    pushed = [sp.simulate(mechanism, state, 0.02, {joint: 0.5}, [0.0, 0.01, 0.02])
              for joint in ("crank", "rocker_pin")]
    np.testing.assert_allclose(film(pushed[0]).loads.efforts["crank"], 0.5, atol=1e-9)
    with pytest.raises(sp.SpatialPinError, match="elsewhere than at its drivers"):
        page(pushed[1], look=sp.Look(arrows=("crank_pin.reaction",)))


def test_a_visual_that_names_no_frame_belongs_to_the_link_of_its_joint():
    model = sp.load("four_bar").model
    joint = model.getJointId("crank_pin")
    stick = pin.GeometryObject("stick", joint, pin.SE3.Identity(), coal.Cylinder(0.01, 0.1))
    assert link_of(stick, model) == "crank"


@pytest.mark.parametrize(
    ("x", "expected"), [(1, 1), (1.3, 1), (24, 20), (0.003, 0.002), (7.2, 10), (1000, 1000)]
)
def test_nice_numbers_are_1_2_5(x, expected):
    assert nice(x) == pytest.approx(expected)


def test_colours_are_those_of_the_urdf_and_apart_where_it_gives_none():
    from spatial_pin.view.scene.meshcat_commands import colour

    drawn = [colour(v) for v in arm().visual_model.geometryObjects]
    np.testing.assert_allclose(drawn, [(*c, 1.0) for c in (GREEN, RED, BLUE)])
    bare = arm(re.sub(r"<material.*?</material>", "", ARM, flags=re.S))
    assert len({colour(v) for v in bare.visual_model.geometryObjects}) == 3


def test_rotate_is_that_of_pinocchio():
    rotation = pin.exp3(np.array([0.3, -1.0, 2.0]))
    quaternion = pin.Quaternion(rotation).coeffs()
    v = np.array([[1.0, 2.0, 3.0], [-1.0, 0.0, 2.0]])
    np.testing.assert_allclose(rotate(quaternion, v), v @ rotation.T)


@pytest.mark.parametrize("size", [1e-3, 1.0, 50.0])
@pytest.mark.parametrize("extent", [(1, 1, 1), (1, 0.01, 1), (1, 1, 0), (5, 0.2, 0.1)])
def test_camera_sees_everything_in_the_middle(extent, size):
    rng = np.random.default_rng(1)
    points = size * (rng.uniform(-1, 1, (200, 3)) * extent + [3.0, -2.0, 7.0])
    made = frame(points)
    p = (points - made.centre) / made.radius
    away = np.linalg.norm(made.camera)
    v = made.camera / away
    right = np.cross([0, 0, 1], v) / np.linalg.norm(np.cross([0, 0, 1], v))
    picture = np.stack([p @ right / ASPECT, p @ np.cross(v, right)]) / (away - p @ v)
    picture /= math.tan(math.radians(FIELD_OF_VIEW) / 2)
    assert 0.8 < np.abs(picture).max() < 0.9
    np.testing.assert_allclose(picture.min(axis=1) + picture.max(axis=1), 0.0, atol=1e-2)
    assert np.linalg.norm(p, axis=1).max() == pytest.approx(1.0)


def test_unbounded_shapes_do_not_count_for_the_framing():
    plane = shown_as(SHAPES["halfspace"]()).mechanism
    poses = np.zeros((1, 3, 7))
    assert occupied(list(plane.visual_model.geometryObjects), poses).shape == (0, 3)
    assert frame(np.zeros((0, 3))).radius > 0


SIZE = (480, 360)


def seen_at(points: np.ndarray, framing: Framing, size: tuple[int, int]) -> np.ndarray:
    """Column and row (K, 2) at which the page's camera sees points (K, 3) of the view [m]."""
    width, height = size
    p = (np.atleast_2d(points) - framing.centre) / framing.radius
    camera = framing.camera * max(1.0, ASPECT * height / width)
    away = np.linalg.norm(camera)
    v = camera / away
    right = np.cross([0.0, 0.0, 1.0], v)
    right /= np.linalg.norm(right)
    up = np.cross(v, right)
    focus = height / 2 / math.tan(math.radians(FIELD_OF_VIEW) / 2)
    flat = np.stack([p @ right, -(p @ up)], axis=1) / (away - p @ v)[:, None]
    return flat * focus + [width / 2, height / 2]


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
@pytest.mark.parametrize("name", SHOWN)
def test_page_shows_every_coloured_link_where_it_is(browser, tmp_path, name):
    motion = swept(name)
    row = 20
    image = photograph(browser, motion, tmp_path, film(motion).seconds[row])
    assert 0.02 < ink(image).mean() < 0.8
    framing = scene(film(motion)).framing
    mechanism = motion.mechanism
    poses = joint_poses(mechanism.model, motion.q[row : row + 1])[0]
    found: dict[int, bool] = {}
    for visual in mechanism.visual_model.geometryObjects:
        if np.ptp(colour(visual)[:3]) > 0.3:
            x, turn = poses[visual.parentJoint, :3], poses[visual.parentJoint, 3:]
            place = rotate(turn, visual.placement.translation) + x
            ((column, line),) = seen_at(place, framing, SIZE)
            seen = near(colour_mask(image, colour(visual)), column, line)
            found[visual.parentJoint] = found.get(visual.parentJoint, False) or seen
    assert found and all(found.values()), found


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_trace_is_drawn_along_the_path(browser, tmp_path):
    motion = swept("four_bar")
    look = sp.Look(traces=("coupler_b",))
    image = photograph(browser, motion, tmp_path, 0.0, look=look)
    bare = photograph(browser, motion, tmp_path, 0.0)
    mask = colour_mask(image, TRACE_COLOURS[0])
    framing = scene(film(motion), look).framing
    turn = upright(motion.mechanism.model)
    path = seen_at(motion.frame("coupler_b").position @ turn.T, framing, SIZE)
    free = path[np.linalg.norm(path - path[0], axis=1) > 30]  # not behind the pin that is there
    assert len(free) > 20
    assert all(near(mask, *point, reach=4) for point in free)
    assert colour_mask(bare, TRACE_COLOURS[0]).sum() < 0.1 * mask.sum()
