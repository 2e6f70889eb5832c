"""What a picture shows besides the bodies: where it stands, which way it points, how long it is."""

import re
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from chromium import needs_browser
from images import clips, commands, data_of, matrix_of, page, paths, picture, points_of, z_axis
from mechanisms import (
    coupling,
    driver,
    load,
    turning,
)
from pictured import TURN, rssr, without_picture, without_picture_of

import spatial_pin as sp

MAGENTA = (1.0, 0.0, 0.62)


# ---------------------------------------------------------------- paths


@pytest.mark.parametrize("name", ["coupler_b", "coupler", "coupler.com"])
def test_trace_goes_round_the_positions_of_the_point(name):
    motion = rssr()
    text = page(motion, look=sp.Look(traces=(name,)))
    rings = points_of(text, f"path of {name}").reshape(-1, 8, 3)
    body = name.removesuffix(".com")
    expected = (motion.com(body) if name.endswith(".com") else motion.frame(body)).position
    np.testing.assert_allclose(rings.mean(axis=1), expected, atol=1e-7)
    radius = np.linalg.norm(rings - rings.mean(axis=1, keepdims=True), axis=2)
    assert np.ptp(radius) < 1e-6 and 1e-4 < radius.mean() < 5e-3


def test_trace_of_a_point_at_rest_is_a_ball():
    text = page(rssr(), look=sp.Look(traces=("ground",)))
    assert "path of ground" in paths(text)
    assert all(np.isfinite(c["matrix"]).all() for c in commands(text, "set_transform"))


def test_trace_stands_upright_as_the_bodies_do():
    mechanism = sp.load("rssr")
    mechanism.model.gravity.linear = np.array([0.0, 9.81, 0.0])
    motion = sp.sweep(mechanism, "crank", TURN)
    drawn = points_of(page(motion, look=sp.Look(traces=("coupler_b",))), "path of coupler_b")
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
    text = page(motion, look=sp.Look(arrows=(spec,)))
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
    look = sp.Look(arrows=("coupler_b.velocity", "ball_a.velocity", "coupler_b.acceleration"))
    text = page(rssr(), look=look)
    assert len(re.findall(r"velocity of coupler_b, ball_a: ", text)) == 1
    assert len(re.findall(r"acceleration of coupler_b: ", text)) == 1


def test_arrow_of_nothing_is_not_drawn_and_says_so():
    state = sp.assemble(sp.load("rssr"), {"crank": 0.3})
    text = page(state, look=sp.Look(arrows=("coupler_b.velocity",)))
    assert "velocity of coupler_b: none" in text
    assert not any("velocity" in p for p in paths(text))


def test_arrow_of_a_state_stands_where_it_should():
    mechanism = sp.load("rssr")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.3}), {"crank": 25.0})
    text = page(state, look=sp.Look(arrows=("coupler_b.velocity",)))
    matrix = matrix_of(text, "head, velocity of coupler_b")
    v, p = state.velocity("coupler_b").linear, state.placement("coupler_b").translation
    np.testing.assert_allclose(matrix[:3, 3], p + scale_of(text, "velocity") * v, atol=1e-9)
    np.testing.assert_allclose(np.cross(matrix[:3, 2], v), 0.0, atol=1e-9)


def test_any_vectors_can_be_arrows():
    motion = rssr()
    point_b = motion.frame("coupler_b").position
    force = np.outer(np.linspace(1.0, 2.0, len(motion)), [0.0, 0.0, -30.0])
    text = page(motion, look=sp.Look(arrows=(sp.Vectors("ball_b", point_b, force, "force", "N"),)))
    head = clips(text)["head, force of ball_b"]
    np.testing.assert_allclose(
        head[".position"], point_b + scale_of(text, "force") * force, atol=1e-6
    )
    with pytest.raises(ValueError, match=r"ball_b.*\(37, 3\)"):
        page(motion, look=sp.Look(arrows=(sp.Vectors("ball_b", point_b, force[:5], "force", "N"),)))


@pytest.mark.parametrize(
    "look",
    [
        sp.Look(traces=("couple_b",)),
        sp.Look(traces=("couple.com",)),
        sp.Look(arrows=("couple_b.velocity",)),
        sp.Look(arrows=("coupler_b.speed",)),
        sp.Look(arrows=("velocity",)),
        sp.Look(arrows=("coupler_b.position",)),
        sp.Look(arrows=("coupler_b.rotation",)),
    ],
)
def test_unknown_names_are_refused(look):
    with pytest.raises(sp.UnknownNameError, match="rssr"):
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


def test_open_coupling_is_stated(tmp_path):
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


@pytest.mark.parametrize(("shown", "expected"), [(None, False), (True, True), (False, False)])
def test_signs_are_for_models_without_a_picture_unless_requested(shown, expected):
    motion = rssr(5)
    assert any("ball_b" in p for p in paths(page(motion, look=sp.Look(pairs=shown)))) is expected
    bare = sp.sweep(without_picture(motion.mechanism), "crank", motion.driver)
    assert any("ball_b" in p for p in paths(page(bare, look=sp.Look(pairs=shown)))) is (
        shown is not False
    )


def test_axes_are_drawn_at_joints_and_closures():
    found = [p for p in paths(page(rssr(5), look=sp.Look(axes=True))) if "axis" in p]
    assert found == ["crank_pin/axis crank_pin 1", "rocker_pin/axis rocker_pin 1"]
    hooke = sp.load("stewart")
    found = [p for p in paths(page(sp.assemble(hooke, {}), look=sp.Look(axes=True))) if "axis" in p]
    assert {"universe/axis hook_1 0", "hook_1/axis hook_1 1"} <= set(found)


# ---------------------------------------------------------------- skeletons


# ---------------------------------------------------------------- the rest


@pytest.mark.parametrize(("asked", "sticks"), [
    (None, {"crank_pin"}),
    (False, set()),
    (True, {"universe", "crank_pin", "ball_a", "rocker_pin"}),
])
def test_links_without_a_picture_of_their_own_are_sticks(asked, sticks):
    motion = rssr(5)
    partly = without_picture_of(motion.mechanism, "crank_pin")
    found = paths(page(replace(motion, mechanism=partly), look=sp.Look(skeleton=asked)))
    assert {p.partition("/")[0] for p in found if " stick " in p} == sticks
    assert any("rocker_pin" in p and " stick " not in p for p in found)
    whole = paths(page(motion, look=sp.Look(skeleton=asked)))
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


def test_spring_reaches_from_frame_to_frame():
    mechanism = replace(sp.load("slider_crank"), springs=(sp.Spring("s", ("ground", "slider")),))
    motion = sp.sweep(mechanism, "crank", TURN)
    track = clips(page(motion))["spring s"]
    a, b = (motion.frame(name).position for name in ("ground", "slider"))
    np.testing.assert_allclose(track[".position"], a, atol=1e-6)
    reach = track[".scale"][:, 2:] * z_axis(track[".quaternion"])
    np.testing.assert_allclose(a + reach, b, atol=1e-6)


def test_a_shadow_is_as_it_is_requested():
    for asked in (None, True, False):
        assert data_of(page(rssr(3), look=sp.Look(shadow=asked)))["shadow"] is asked


def test_curves_of_another_motion_are_reported_with_its_name():
    motion = rssr(61)
    other = sp.sweep(sp.load("rssr", d=0.33), "crank", np.linspace(1.0, 3.0, 31))
    text = page(motion, look=sp.Look(curves="rocker_pin", ghosts=other))
    values = data_of(text)["curves"]["panels"][0]["lines"][1]["values"]
    inside = (motion.driver >= 1.0) & (motion.driver <= 3.0)
    assert [v is not None for v in values] == inside.tolist()
    expected = np.rad2deg(np.interp(motion.driver[inside], other.driver,
                                    other.coordinate("rocker_pin").value))
    np.testing.assert_allclose([v for v in values if v is not None], expected, rtol=1e-5)


def test_ghost_of_another_mechanism_is_refused():
    ghost = sp.assemble(sp.load("four_bar"), {"crank": 0.3})
    with pytest.raises(sp.SpatialPinError, match=r"four_bar.*rssr"):
        page(rssr(3), look=sp.Look(ghosts=(ghost,)))


def test_limits_are_marks_of_the_page():
    mechanism = sp.load("four_bar", r2=0.2, r3=0.12)  # no crank: it swings between two limits
    start = sp.assemble(mechanism, {})
    at = float(start.coordinate("crank").value)
    motion = sp.sweep(mechanism, "crank", np.linspace(at, at + 6.0, 200), on_limit="stop")
    assert [e.kind for e in motion.events] == ["limit"]
    told = data_of(page(motion))
    (mark,) = told["marks"]
    assert mark["kind"] == "limit" and mark["text"] == motion.events[0].text
    assert mark["seconds"] == pytest.approx(told["seconds"][-1], abs=1e-6)


def test_marks_stand_between_the_rows_they_are_met_between():
    motion = rssr(11)
    value = 0.25 * motion.driver[3] + 0.75 * motion.driver[4]
    event = type("Event", (), {"kind": "singular", "value": value, "row": 4, "text": "here"})
    told = data_of(page(replace(motion, events=[event])))
    (mark,) = told["marks"]
    between = 0.25 * told["seconds"][3] + 0.75 * told["seconds"][4]
    assert mark["seconds"] == pytest.approx(between, abs=1e-6)


def test_page_with_everything_stays_small():
    look = sp.Look(
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
    look = sp.Look(traces=("coupler_b",), arrows=("coupler_b.acceleration",))
    plain, full = (
        picture(sp.screenshot(rssr(), tmp_path / f"{k}.png", row=6, size=(900, 675), look=asked))
        for k, asked in enumerate((None, look))
    )
    for colour in ((0.55, 0.08, 0.45), (0.78, 0.05, 0.13)):  # of the path, of an acceleration
        seen = [near(shot[:480], colour).sum() for shot in (plain, full)]  # without the legend
        assert seen[1] > seen[0] + 20


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_page_fits_its_window_until_the_user_moves_the_camera_and_hides_the_controls(
    one_browser, tmp_path
):
    away = "viewer.camera.position.length()"
    dialog = "getComputedStyle(document.querySelector('.dg.main'))"
    path = sp.export_html(rssr(31, accuracy=sp.Accuracy(corrections=0)), tmp_path / "rssr.html")
    browser = one_browser
    browser.resize((1200, 800))
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
