"""What a picture shows besides the bodies: where it stands, which way it points, how long it is."""

import math
import re
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from images import commands, data_of, needs_browser, picture
from mechanisms import (
    closure,
    coupling,
    driver,
    floating,
    guess,
    load,
    point,
    refine,
    turning,
)

import spatial_pin as sp
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import CLOSURE_TYPES, JOINT_TYPES
from spatial_pin.mechanism.parts import Spring
from spatial_pin.view.page.html import page
from spatial_pin.view.scene.film import film, length_words
from spatial_pin.view.scene.framing import rotate
from spatial_pin.view.scene.layers import arrows
from spatial_pin.view.scene.layers.arrows import Vectors
from spatial_pin.view.scene.layers.bodies import BODY_COLOURS, GROUND_COLOUR, link_of
from spatial_pin.view.scene.layers.glyphs import GLYPHS, glyphs
from spatial_pin.view.scene.layers.places import places
from spatial_pin.view.scene.look import Look
from spatial_pin.view.scene.meshcat_commands import scene
from spatial_pin.view.scene.skeleton import skeleton
from spatial_pin.view.scene.stage import Stage, joint_poses, quaternions_along, upright

TURN = np.linspace(0.0, 2 * np.pi, 37)
MAGENTA = (1.0, 0.0, 0.62)


def rssr(n: int = 37, **settings: object) -> sp.Motion:
    values = np.linspace(0.0, 2 * np.pi, n)
    return sp.sweep(sp.load("rssr"), "crank", values, speed=25.0, **settings)


def stage_of(shown: object) -> Stage:
    made = film(shown)
    model = made.mechanism.model
    return Stage(made, (), joint_poses(model, made.q), upright(model), 1.0)


def clips(text: str) -> dict[str, dict[str, np.ndarray]]:
    """The tracks of everything that moves, by the end of its path."""
    (animation,) = commands(text, "set_animation")
    found = {}
    for entry in animation["animations"]:
        tracks = entry["clip"]["tracks"]
        width = {"vector3": 3, "quaternion": 4}
        found[entry["path"].rpartition("/")[2]] = {
            t["name"]: np.frombuffer(t["values"].data, "<f4").reshape(-1, width[t["type"]])
            for t in tracks
        }
    return found


def paths(text: str) -> list[str]:
    return [c["path"].removeprefix("/mechanism/") for c in commands(text, "set_object")]


def points_of(text: str, name: str) -> np.ndarray:
    (command,) = [c for c in commands(text, "set_object") if c["path"] == f"/mechanism/{name}"]
    position = command["object"]["geometries"][0]["data"]["attributes"]["position"]["array"]
    return np.frombuffer(position.data, "<f4").reshape(-1, 3)


def z_axis(quaternions: np.ndarray) -> np.ndarray:
    return rotate(quaternions, np.broadcast_to([0.0, 0.0, 1.0], (len(quaternions), 3)))


def without_picture(mechanism: Mechanism) -> Mechanism:
    return replace(mechanism, visual_model=pin.GeometryModel())


# ---------------------------------------------------------------- paths


@pytest.mark.parametrize("name", ["coupler_b", "coupler", "coupler.com"])
def test_trace_goes_round_the_positions_of_the_point(name):
    motion = rssr()
    rings = points_of(page(motion, look=Look(traces=(name,))), f"path of {name}").reshape(-1, 8, 3)
    body = name.removesuffix(".com")
    expected = (motion.com(body) if name.endswith(".com") else motion.frame(body)).position
    np.testing.assert_allclose(rings.mean(axis=1), expected, atol=1e-7)
    radius = np.linalg.norm(rings - rings.mean(axis=1, keepdims=True), axis=2)
    assert np.ptp(radius) < 1e-6 and 1e-4 < radius.mean() < 5e-3


def test_trace_of_a_point_at_rest_is_a_ball():
    text = page(rssr(), look=Look(traces=("ground",)))
    assert "path of ground" in paths(text)
    assert all(np.isfinite(c["matrix"]).all() for c in commands(text, "set_transform"))


def test_trace_stands_upright_as_the_bodies_do():
    mechanism = sp.load("rssr")
    mechanism.model.gravity.linear = np.array([0.0, 9.81, 0.0])
    motion = sp.sweep(mechanism, "crank", TURN)
    drawn = points_of(page(motion, look=Look(traces=("coupler_b",))), "path of coupler_b")
    centres = drawn.reshape(-1, 8, 3).mean(axis=1)
    position = motion.frame("coupler_b").position
    np.testing.assert_allclose(centres[:, 2], -position[:, 1], atol=1e-7)  # up is against gravity


# ---------------------------------------------------------------- arrows

NUMBER = r"([\d.e+-]+)"


def scale_of(text: str, quantity: str) -> float:
    """Length in the picture [m] of one unit, as the legend says it."""
    said = re.search(rf"{quantity} of [^:]*: {NUMBER} (m|mm|µm|nm) = {NUMBER} ", text)
    size = {"m": 1.0, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9}[said[2]]
    return float(said[1]) * size / float(said[3])


@pytest.mark.parametrize(
    ("spec", "quantity"),
    [
        ("coupler_b.velocity", "velocity"),
        ("rocker_b.acceleration", "acceleration"),
        ("coupler.angular_velocity", "angular velocity"),
        ("coupler.angular_acceleration", "angular acceleration"),
        ("coupler.com.velocity", "velocity"),
        ("coupler.com.acceleration", "acceleration"),
    ],
)
def test_arrow_is_the_vector_at_its_point_to_the_scale_of_the_legend(spec, quantity):
    motion = rssr()
    text = page(motion, look=Look(arrows=(spec,)))
    name, _, kind = spec.rpartition(".")
    body = name.removesuffix(".com")
    moving = motion.com(body) if name.endswith(".com") else motion.frame(body)
    vector = getattr(moving, kind)
    found = clips(text)
    shaft, head = found[f"{quantity} of {name}"], found[f"head, {quantity} of {name}"]
    np.testing.assert_allclose(shaft[".position"], moving.position, atol=1e-6)
    tip = moving.position + scale_of(text, quantity) * vector
    np.testing.assert_allclose(head[".position"], tip, atol=1e-6)
    size = np.linalg.norm(vector, axis=1)
    some = size > 1e-9 * size.max()  # the rocker's pin is at rest at a dead centre
    e = vector[some] / size[some, None]
    for track in (shaft, head):
        np.testing.assert_allclose(z_axis(track[".quaternion"])[some], e, atol=1e-5)
    reached = np.linalg.norm(tip - moving.position, axis=1)
    assert np.all(shaft[".scale"][some, 2] < reached[some])
    np.testing.assert_allclose(shaft[".scale"][~some], 0.0, atol=1e-9)


def test_arrows_of_one_quantity_share_a_scale_and_a_line_of_the_legend():
    look = Look(arrows=("coupler_b.velocity", "ball_a.velocity", "coupler_b.acceleration"))
    text = page(rssr(), look=look)
    assert len(re.findall(r"velocity of coupler_b, ball_a: ", text)) == 1
    assert len(re.findall(r"acceleration of coupler_b: ", text)) == 1


def test_arrow_of_nothing_is_not_drawn_and_says_so():
    state = sp.assemble(sp.load("rssr"), {"crank": 0.3})
    text = page(state, look=Look(arrows=("coupler_b.velocity",)))
    assert "velocity of coupler_b: none" in text
    assert not any("velocity" in p for p in paths(text))


def test_arrow_of_a_state_stands_where_it_should():
    mechanism = sp.load("rssr")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.3}), {"crank": 25.0})
    text = page(state, look=Look(arrows=("coupler_b.velocity",)))
    name = "/mechanism/head, velocity of coupler_b"
    (command,) = [c for c in commands(text, "set_transform") if c["path"] == name]
    matrix = np.reshape(command["matrix"], (4, 4)).T
    v, p = state.velocity("coupler_b").linear, state.placement("coupler_b").translation
    np.testing.assert_allclose(matrix[:3, 3], p + scale_of(text, "velocity") * v, atol=1e-9)
    np.testing.assert_allclose(np.cross(matrix[:3, 2], v), 0.0, atol=1e-9)


def test_any_vectors_can_be_arrows():
    motion = rssr()
    point_b = motion.frame("coupler_b").position
    force = np.outer(np.linspace(1.0, 2.0, len(motion)), [0.0, 0.0, -30.0])
    text = page(motion, look=Look(arrows=(Vectors("ball_b", point_b, force, "force", "N"),)))
    head = clips(text)["head, force of ball_b"]
    np.testing.assert_allclose(
        head[".position"], point_b + scale_of(text, "force") * force, atol=1e-6
    )
    with pytest.raises(ValueError, match=r"ball_b.*\(37, 3\)"):
        page(motion, look=Look(arrows=(Vectors("ball_b", point_b, force[:5], "force", "N"),)))


def test_a_direction_that_is_not_given_is_the_last_one():
    v = np.array([[0, 0, 0], [0, 0, -2.0], [0, 0, 0], [3.0, 0, 0], [0, 0, 0]])
    expected = [[0, 0, 1], [0, 0, -1], [0, 0, -1], [1, 0, 0], [1, 0, 0]]
    np.testing.assert_allclose(z_axis(quaternions_along(v)), expected, atol=1e-12)


@pytest.mark.parametrize(
    "look",
    [
        Look(traces=("couple_b",)),
        Look(traces=("couple.com",)),
        Look(arrows=("couple_b.velocity",)),
        Look(arrows=("coupler_b.speed",)),
        Look(arrows=("velocity",)),
        Look(arrows=("coupler_b.position",)),
        Look(arrows=("coupler_b.rotation",)),
    ],
)
def test_unknown_names_are_refused(look):
    with pytest.raises(UnknownNameError, match="rssr"):
        page(rssr(5), look=look)


# ---------------------------------------------------------------- open closures


def test_closed_mechanism_has_no_gap_marker_and_no_alarm():
    text = page(rssr())
    assert not any("gap" in p for p in paths(text))
    assert data_of(text)["alarms"] == []


def test_gap_of_a_drifting_sweep_is_marked_where_and_while_it_is_open():
    motion = rssr(31, accuracy=sp.Accuracy(corrections=0))
    open_ = motion.closure_error > 1e-6
    assert open_.any() and not open_.all()
    text = page(motion)
    a, b = motion.frame("rocker_b").position, motion.frame("coupler_b").position
    found = clips(text)
    ends = [found[f"gap ball_b {end}"] for end in ("from", "to")]
    for end, truth in zip(ends, (b, a), strict=True):  # frames of the closure: coupler_b, rocker_b
        np.testing.assert_array_equal(end[".scale"][:, 0], open_)
        np.testing.assert_allclose(end[".position"][open_], truth[open_], atol=1e-6)
    rod = found["gap ball_b"]
    distance = np.linalg.norm(a - b, axis=1)
    np.testing.assert_allclose(rod[".scale"][open_, 2], distance[open_], atol=1e-6)
    np.testing.assert_array_equal(rod[".scale"][~open_], 0.0)
    (alarm,) = data_of(text)["alarms"]
    assert (alarm["name"], alarm["says"]) == ("closure ball_b", " open by ")
    size = {" mm": 1e-3, " µm": 1e-6}[alarm["unit"]]
    said = np.array(alarm["values"]) * size
    np.testing.assert_allclose(said[open_], distance[open_], atol=1e-7)
    np.testing.assert_array_equal(said[~open_], 0.0)


def test_gap_of_a_failed_assembly_is_shown():
    with pytest.raises(sp.AssemblyError) as caught:
        sp.assemble(sp.load("four_bar"), {"crank": 0.3, "rocker_pin": 2.9})
    state = caught.value.state
    text = page(state)
    (alarm,) = data_of(text)["alarms"]
    p, q = (state.placement(name).translation for name in ("coupler_b", "rocker_b"))
    assert alarm["name"] == "closure output_pin" and alarm["unit"] == " mm"
    assert alarm["values"] == pytest.approx([1e3 * np.linalg.norm(p - q)], abs=0.1)
    assert {"gap output_pin/solid", "gap output_pin from/solid"} <= set(paths(text))


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
def test_turned_frames_are_told_in_degrees_and_shown_as_two_directions(tmp_path, kind):
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


def test_open_coupling_is_said(tmp_path):
    tree = turning("a", "ground", "one") + turning("b", "ground", "two", (0.1, 0, 0))
    gear = driver("a", "a") + coupling("gear", "a", "b", -2.0)
    mechanism = load(tmp_path, "gears", tree, gear)
    q = sp.assemble(mechanism, {"a": 0.4}).q.copy()
    shown = page(sp.State(mechanism, q, closure_error=0.0))
    assert data_of(shown)["alarms"] == []
    q = pin.integrate(mechanism.model, q, np.array([0.0, np.deg2rad(3.0)]))
    (alarm,) = data_of(page(sp.State(mechanism, q, closure_error=0.05)))["alarms"]
    assert (alarm["name"], alarm["unit"]) == ("closure gear", "°")
    assert alarm["values"] == pytest.approx([3.0])


# ---------------------------------------------------------------- signs of the pairs

KINDS = [kind for kind in JOINT_TYPES if kind in GLYPHS]
AXES = {"universal": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))}
SKEW = np.array([2.0, -3.0, 6.0]) / 7.0


def test_every_pair_that_has_a_place_has_a_sign():
    without = {"fixed", "weld", "floating", "coupling"}
    assert set(GLYPHS) == {*CLOSURE_TYPES, *JOINT_TYPES} - without


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


@pytest.mark.parametrize("kind", [k for k in CLOSURE_TYPES if k in GLYPHS])
def test_sign_of_a_closure_stands_on_its_frames(tmp_path, kind):
    keys = {"distance": {"length": 0.2}, "screw": {"lead": 0.02}}.get(kind, {})
    state = opened(tmp_path, kind, pin.SE3(np.eye(3), np.array([0.03, 0.04, 0.12])), **keys)
    stage = stage_of(state)
    items = [item for item in glyphs(stage, through=False).items if item.name.startswith(kind)]
    (place,) = [place for place in places(state.mechanism) if place.name == "loop"]
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


@pytest.mark.parametrize(("shown", "expected"), [(None, False), (True, True), (False, False)])
def test_signs_are_for_models_without_a_picture_unless_asked_for(shown, expected):
    motion = rssr(5)
    assert any("ball_b" in p for p in paths(page(motion, look=Look(pairs=shown)))) is expected
    bare = sp.sweep(without_picture(motion.mechanism), "crank", motion.driver)
    assert any("ball_b" in p for p in paths(page(bare, look=Look(pairs=shown)))) is (
        shown is not False
    )


def test_rail_of_a_slider_reaches_as_far_as_it_goes():
    mechanism = sp.load("slider_crank")
    motion = sp.sweep(mechanism, "crank", TURN)
    held = glyphs(stage_of(motion), through=True).points
    x = motion.frame("slider").position
    assert np.all(held.max(axis=0) >= x.max(axis=0)) and np.all(held.min(axis=0) <= x.min(axis=0))


def test_axes_are_drawn_at_joints_and_closures():
    found = [p for p in paths(page(rssr(5), look=Look(axes=True))) if "axis" in p]
    assert found == ["crank_pin/axis crank_pin 1", "rocker_pin/axis rocker_pin 1"]
    hooke = sp.load("stewart")
    found = [p for p in paths(page(sp.assemble(hooke, {}), look=Look(axes=True))) if "axis" in p]
    assert {"universe/axis hook_1 0", "hook_1/axis hook_1 1"} <= set(found)


# ---------------------------------------------------------------- skeletons


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


# ---------------------------------------------------------------- the rest


def without_picture_of(mechanism: Mechanism, joint: str) -> Mechanism:
    kept = pin.GeometryModel()
    for visual in mechanism.visual_model.geometryObjects:
        if mechanism.model.names[visual.parentJoint] != joint:
            kept.addGeometryObject(visual)
    return replace(mechanism, visual_model=kept)


@pytest.mark.parametrize(("asked", "sticks"), [
    (None, {"crank_pin"}),
    (False, set()),
    (True, {"universe", "crank_pin", "ball_a", "rocker_pin"}),
])
def test_links_without_a_picture_of_their_own_are_sticks(asked, sticks):
    motion = rssr(5)
    partly = without_picture_of(motion.mechanism, "crank_pin")
    found = [p for p in paths(page(replace(motion, mechanism=partly), look=Look(skeleton=asked)))]
    assert {p.partition("/")[0] for p in found if " stick " in p} == sticks
    assert any("rocker_pin" in p and " stick " not in p for p in found)
    whole = paths(page(motion, look=Look(skeleton=asked)))
    assert any(" stick " in p for p in whole) is (asked is True)


@pytest.mark.parametrize(("root", "sticks"), [
    (pin.JointModelFreeFlyer(), set()),
    (pin.JointModelRX(), {"universe"}),
])
def test_no_stick_leads_from_the_ground_to_a_base_that_floats(root, sticks):
    """A walking robot's base stands high above the world's origin, and no pair holds it there."""
    model = pin.Model()
    high = pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.0]))
    base = model.addJoint(0, root, high, "base")
    model.appendBodyToJoint(base, pin.Inertia.Random(), pin.SE3.Identity())
    drawn = pin.GeometryModel()
    drawn.addGeometryObject(
        pin.GeometryObject("trunk", base, 0, pin.SE3.Identity(), coal.Sphere(0.1)))
    robot = sp.Mechanism.from_model(model, visual_model=drawn)
    found = paths(page(sp.assemble(robot)))
    assert {p.partition("/")[0] for p in found if " stick " in p} == sticks


def test_sticks_belong_to_their_links():
    motion = rssr(5)
    partly = without_picture_of(motion.mechanism, "crank_pin")
    parts = scene(film(replace(motion, mechanism=partly))).parts
    assert {p.name for p in parts if " stick " in p.path} == {"crank"}
    assert {p.name for p in parts if p.group == "links"} == {"ground", "crank", "coupler", "rocker"}


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
    layer = scene(film(motion), Look(centres=True)).layer
    marks = {i.name.removeprefix("centre of mass, "): i for i in layer.items if "centre" in i.name}
    for link in ("crank", "coupler", "rocker"):
        item, data = marks[link], mechanism.model.createData()
        pin.forwardKinematics(mechanism.model, data, motion.q[4])
        world = data.oMi[item.joint].act(item.placement[:3, 3])
        np.testing.assert_allclose(world, motion.com(link).position[4], atol=1e-12)


def test_spring_reaches_from_frame_to_frame():
    mechanism = replace(sp.load("slider_crank"), springs=(Spring("s", ("ground", "slider")),))
    motion = sp.sweep(mechanism, "crank", TURN)
    track = clips(page(motion))["spring s"]
    a, b = (motion.frame(name).position for name in ("ground", "slider"))
    np.testing.assert_allclose(track[".position"], a, atol=1e-6)
    reach = track[".scale"][:, 2:] * z_axis(track[".quaternion"])
    np.testing.assert_allclose(a + reach, b, atol=1e-6)


def test_ghosts_are_where_they_stand_and_half_transparent():
    mechanism = sp.load("four_bar")
    first, other = (sp.assemble(mechanism, {"crank": value}) for value in (0.3, 1.5))
    layer = scene(film(first), Look(ghosts=(other,))).layer
    drawn = [item for item in layer.items if item.name.startswith("ghost 1")]
    visuals = [v for v in mechanism.visual_model.geometryObjects if v.parentJoint != 0]
    assert len(drawn) == len(visuals)
    for item, visual in zip(drawn, visuals, strict=True):
        expected = other.data.oMi[visual.parentJoint] * visual.placement
        np.testing.assert_allclose(item.placement, expected.homogeneous, atol=1e-12)
        assert item.colour[3] < 0.5
    assert any("crank = 85.9°" in entry.text for entry in layer.legend)


def test_assembly_modes_stand_beside_each_other_with_their_names():
    first, *others = sp.assembly_modes(sp.load("watt_six_bar"), {"crank": 0.3})
    drawn = scene(film(first), Look(ghosts=tuple(others), beside=True))
    labels = drawn.layer.labels
    assert [label.text.split(",")[0] for label in labels] == [
        f"branch {s.branch}" for s in (first, *others)
    ]
    moved = [item for item in drawn.layer.items if item.name.startswith("beside 1")]
    assert len(moved) == first.mechanism.visual_model.ngeoms
    alone = scene(film(first)).framing
    steps = [labels[k].point - labels[0].point for k in range(1, len(labels))]
    assert min(map(np.linalg.norm, steps)) > 0.5 * alone.radius
    assert drawn.framing.radius > 1.2 * alone.radius


def test_ghost_has_the_dimensions_of_its_own_mechanism():
    first = sp.assemble(sp.load("four_bar"), {"crank": 0.3})
    other = sp.assemble(sp.load("four_bar", r3=0.34), {"crank": 0.3})
    layer = scene(film(first), Look(ghosts=other)).layer
    drawn = [item for item in layer.items if item.name.startswith("ghost 1")]
    visuals = [v for v in other.mechanism.visual_model.geometryObjects if v.parentJoint != 0]
    for item, visual in zip(drawn, visuals, strict=True):
        expected = other.data.oMi[visual.parentJoint] * visual.placement
        np.testing.assert_allclose(item.placement, expected.homogeneous, atol=1e-12)


def swept(first: float, last: float, n: int, **changes: float) -> sp.Motion:
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
    shown = swept(*one[:3], **({"speed": one[3]} if one[3] else {}))
    ghost = swept(*other[:3], r3=0.34, **({"speed": other[3]} if other[3] else {}))
    layer = scene(film(shown), Look(ghosts=ghost)).layer
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
def test_colours_of_bodies_can_be_told_apart(missing):
    seen = lab(np.array([GROUND_COLOUR, *BODY_COLOURS])[:, :3], np.array(CONES[missing]))
    apart = np.linalg.norm(seen[:, None] - seen, axis=2)
    assert apart[np.triu_indices(len(seen), 1)].min() > 14  # 2 is just seen, side by side


def test_ghost_of_another_mechanism_is_refused():
    ghost = sp.assemble(sp.load("four_bar"), {"crank": 0.3})
    with pytest.raises(SpatialPinError, match=r"four_bar.*rssr"):
        page(rssr(3), look=Look(ghosts=(ghost,)))


def test_limits_are_marks_of_the_film_and_ticks_of_the_page():
    mechanism = sp.load("four_bar", r2=0.2, r3=0.12)  # no crank: it swings between two limits
    start = sp.assemble(mechanism, {})
    at = float(start.coordinate("crank").value)
    motion = sp.sweep(mechanism, "crank", np.linspace(at, at + 6.0, 200), on_limit="stop")
    assert [e.kind for e in motion.events] == ["limit"]
    made = film(motion)
    (mark,) = made.marks
    assert mark.kind == "limit" and mark.text == motion.events[0].text
    assert mark.seconds == pytest.approx(made.seconds[-1], abs=1e-9)
    assert data_of(page(motion))["marks"] == [mark._asdict()]


def test_marks_stand_between_the_rows_they_are_met_between():
    motion = rssr(11)
    value = 0.25 * motion.driver[3] + 0.75 * motion.driver[4]
    event = type("Event", (), {"kind": "singular", "value": value, "row": 4, "text": "here"})
    made = film(replace(motion, events=[event]))
    (mark,) = made.marks
    assert mark.seconds == pytest.approx(0.25 * made.seconds[3] + 0.75 * made.seconds[4])


@pytest.mark.parametrize("size", [1e-6, 1e3])
def test_pictures_of_any_size_are_the_same(tmp_path, size):
    look = Look(axes=True, traces=("b",), arrows=("b.velocity",))

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
def test_lengths_are_said_in_the_unit_that_suits_them(x, words):
    assert length_words(x) == words


@pytest.mark.parametrize("name", sp.list_mechanisms())
@pytest.mark.parametrize("bare", [False, True])
def test_every_mechanism_of_the_library_is_drawn_with_everything(name, bare):
    mechanism = sp.load(name)
    mechanism = without_picture(mechanism) if bare else mechanism
    state = sp.assemble(mechanism, {})
    link = mechanism.links[-1]
    look = Look(pairs=True, axes=True, centres=True, traces=(link,), ghosts=(state,),
                arrows=(f"{link}.velocity",))
    drawn = scene(film(state), look)
    names = [(item.joint, item.name) for item in drawn.layer.items]
    assert len(names) == len(set(names)) and drawn.layer.alarms == ()
    assert np.all(np.isfinite(drawn.layer.points))


def test_page_with_everything_stays_small():
    look = Look(
        pairs=True,
        axes=True,
        centres=True,
        traces=("coupler_b", "coupler.com", "crank"),
        arrows=("coupler_b.velocity", "coupler_b.acceleration", "coupler.angular_velocity"),
    )
    assert len(page(rssr(360), look=look).encode()) < 3e6


# ---------------------------------------------------------------- pictures


def near(image: np.ndarray, colour: tuple[float, float, float]) -> np.ndarray:
    """Where the picture has a pure colour, however lit."""
    c = np.array(colour) / np.linalg.norm(colour)
    size = np.linalg.norm(image, axis=2)
    return (size > 0.3) & (image @ c > 0.97 * size)


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_picture_shows_an_open_closure_even_when_it_cannot_be_seen(tmp_path):
    motion = rssr(31, accuracy=sp.Accuracy(corrections=0))
    assert motion.closure_error[-1] < 1e-3  # 0.4 mm: less than a pixel
    shots = [
        picture(sp.screenshot(motion, tmp_path / f"{row}.png", row=row, size=(900, 675)))
        for row in (0, -1)
    ]
    closed, broken = (near(shot[:600, 280:], MAGENTA).sum() for shot in shots)  # words left out
    assert closed == 0 and broken > 60


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_picture_shows_paths_and_arrows_in_their_colours(tmp_path):
    from spatial_pin.view.scene.layers import traces
    from spatial_pin.view.scene.layers.arrows import COLOURS

    look = Look(traces=("coupler_b",), arrows=("coupler_b.acceleration",))
    plain, full = (
        picture(sp.screenshot(rssr(), tmp_path / f"{k}.png", row=6, size=(900, 675), look=asked))
        for k, asked in enumerate((None, look))
    )
    for colour in (traces.COLOURS[0][:3], COLOURS["acceleration"][:3]):
        seen = [near(shot[:480], colour).sum() for shot in (plain, full)]  # without the legend
        assert seen[1] > seen[0] + 20


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_page_fits_its_window_until_the_user_moves_the_camera_and_hides_the_controls(tmp_path):
    from spatial_pin.view.browser.devtools import Browser

    away = "viewer.camera.position.length()"
    dialog = "getComputedStyle(document.querySelector('.dg.main'))"
    path = sp.export_html(rssr(31, accuracy=sp.Accuracy(corrections=0)), tmp_path / "rssr.html")
    with Browser((1200, 800)) as browser:
        browser.open(path, "typeof animator !== 'undefined'")
        home = browser.evaluate(away)
        browser.resize((400, 900))
        browser.wait_until(f"{away} > {1.01 * home}")
        browser.evaluate("viewer.render(); 1")
        x, y = np.transpose(browser.evaluate(
            "extent().map(p => p.clone().project(viewer.camera)).map(p =>"
            " [(1 + p.x) / 2 * pane.clientWidth, (1 - p.y) / 2 * pane.clientHeight])"))
        left, bottom = browser.evaluate("(box => [box.left, box.bottom])("
                                        "document.getElementById('tools').getBoundingClientRect())")
        assert min(x) > 0.0 and max(x) < 400.0 and min(y) > 0.0 and max(y) < 900.0
        assert max(x) - min(x) > 200.0 and not np.any((x > left) & (y < bottom))
        browser.evaluate("viewer.controls.dispatchEvent({type: 'start'})")
        browser.resize((1200, 800))
        browser.wait_until("innerWidth === 1200")
        assert browser.evaluate(away) > 1.01 * home
        assert browser.evaluate(f"{dialog}.display") == "none"
        browser.evaluate("location.hash = 'controls&t=6'")
        browser.wait_until(f"{dialog}.display === 'block'")
        browser.wait_until("alarms.innerText.startsWith('closure ball_b open by ')")
        browser.evaluate("location.hash = 't=0'")
        browser.wait_until("alarms.innerText === ''")


def test_reaction_arrows_are_the_forces_at_the_pairs():
    mechanism = sp.load("rssr")
    motion = sp.sweep(mechanism, "crank", np.linspace(0.0, 1.0, 5), speed=20.0)
    loads = film(motion).loads
    found = arrows.load(loads, "ball_b", "reaction")
    np.testing.assert_array_equal(found.vector,
                                  sp.kinetostatics(mechanism, motion).reactions["ball_b"][:, :3])
    np.testing.assert_allclose(found.point, motion.frame("rocker_b").position)
    with pytest.raises(UnknownNameError, match="ball_b"):
        arrows.load(loads, "ball_c", "reaction")


def test_reactions_of_a_simulation_are_not_laid_to_drivers_that_did_not_act():
    mechanism = sp.load("four_bar")
    state = sp.assemble(mechanism, {"crank": 0.3})
    pushed = [sp.simulate(mechanism, state, 0.02, {joint: 0.5}, [0.0, 0.01, 0.02])
              for joint in ("crank", "rocker_pin")]
    np.testing.assert_allclose(film(pushed[0]).loads.efforts["crank"], 0.5, atol=1e-9)
    with pytest.raises(SpatialPinError, match="elsewhere than at its drivers"):
        page(pushed[1], look=Look(arrows=("crank_pin.reaction",)))


def test_a_visual_that_names_no_frame_belongs_to_the_link_of_its_joint():
    model = sp.load("four_bar").model
    joint = model.getJointId("crank_pin")
    stick = pin.GeometryObject("stick", joint, pin.SE3.Identity(), coal.Cylinder(0.01, 0.1))
    assert link_of(stick, model) == "crank"
