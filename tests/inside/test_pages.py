"""Pieces of pages, the motion shown by default, who answers a live page, the browser itself."""

import asyncio
import base64
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from chromium import READY, Browser, needs_browser
from live_pages import Page, opened
from loaded_library import library
from machines import limited_slider
from variety import each, few

import spatial_pin as sp
from spatial_pin.motion.default_motion import ROWS, SLIDE_RANGE, default_motion
from spatial_pin.view.page.html import packed
from spatial_pin.view.page.jog import BESIDE, Jog, reaches
from spatial_pin.view.page.markup import number, table, tiny
from spatial_pin.view.page.plots import default_outputs, svg
from spatial_pin.view.page.report_page import SECTIONS
from spatial_pin.view.scene.shapes import rod
from spatial_pin.view.scene.stage import joint_poses

SIZE = (480, 360)


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_browser_works_inside_a_running_event_loop():
    async def notebook() -> int:
        with Browser(SIZE) as browser:
            return browser.evaluate("6 * 7")

    assert asyncio.run(notebook()) == 42


def group_of(leader: int) -> list[int]:
    """Processes of a process group that still run."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError):
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            if int(fields[2]) == leader and fields[0] != "Z":
                found.append(int(folder.name))
    return found


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_closed_browser_leaves_nothing_behind():
    browser = Browser(SIZE)
    leader, folder = browser._process.pid, Path(browser._folder.name)
    assert group_of(leader) and folder.is_dir()
    browser.close()
    browser.close()
    assert not group_of(leader) and not folder.exists()
    with pytest.raises(sp.SpatialPinError, match="closed"):
        browser.evaluate("1")


FILMING = """
import sys, time, numpy as np, spatial_pin as sp
movie = __import__("importlib").import_module("spatial_pin.view.pictures")
def shoot(browser, seconds):
    print(browser._process.pid, browser._folder.name, flush=True)
    time.sleep(600)
movie.shoot = shoot
sp.movie(sp.sweep(sp.load("four_bar"), "crank", np.linspace(0.3, 3.0, 9)), sys.argv[1])
"""


@pytest.mark.browser
@needs_browser
@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_killed_movie_leaves_neither_browser_nor_half_a_file(tmp_path, how):
    path = tmp_path / "film.gif"
    path.write_text("the last one")
    command = [sys.executable, "-c", FILMING, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                          text=True) as process:
        leader, folder = process.stdout.readline().split()
        assert group_of(int(leader))
        process.send_signal(how)
        process.wait(60)
    end = time.monotonic() + 60
    while (group_of(int(leader)) or Path(folder).exists()) and time.monotonic() < end:
        time.sleep(0.05)
    assert not group_of(int(leader))
    assert not Path(folder).exists()
    assert path.read_text() == "the last one"


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
@pytest.mark.parametrize("is_noticed", few([False, True], False))
def test_browser_that_dies_is_a_clear_error(is_noticed):
    with Browser(SIZE) as browser:
        os.killpg(browser._process.pid, 9)
        while is_noticed and browser._process.poll() is None:
            time.sleep(0.01)
        with pytest.raises(sp.SpatialPinError, match=r"went away|closed"):
            browser.evaluate("1")


@pytest.mark.browser
@needs_browser
def test_browser_that_does_not_start_is_a_clear_error(monkeypatch, tmp_path):
    program = tmp_path / "chromium"
    program.write_text("#!/bin/sh\necho no display >&2\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr("spatial_pin.view.browser.find_browser", lambda: str(program))
    with pytest.raises(sp.SpatialPinError, match=r"ended at once:\s+no display"):
        Browser(SIZE)


DOUBLE_ROCKER = {"r1": 0.3, "r2": 0.24, "r3": 0.1, "r4": 0.28}
PARALLELOGRAM = {"r1": 0.3, "r2": 0.1, "r3": 0.3, "r4": 0.1}


@pytest.fixture
def rssr():
    with opened("rssr") as viewer:
        yield viewer


@pytest.mark.parametrize("name", few(
    ["rssr", "bennett", "screw_press", "slider_crank", "stewart"], "rssr", "screw_press"))
def test_drive_is_where_a_sweep_is_and_comes_back(name):
    mechanism = sp.load(name)
    state = sp.assemble(mechanism)
    driver = next(iter(mechanism.drivers))
    drive = Jog(state, mechanism.drivers)
    start = drive.value(driver)
    step = 0.05 * (1.0 if mechanism.coordinate(driver).unit == "rad" else 0.1)
    values = start + step * np.arange(20)
    motion = sp.sweep(mechanism, driver, values, guess=state)
    for value, q in zip(values, motion.q, strict=True):
        assert drive.move(driver, value) is None
        there, wanted = (joint_poses(mechanism.model, x[None])[0, :, :3]
                         for x in (drive.state.q, q))
        np.testing.assert_allclose(there, wanted, atol=1e-6)
        assert drive.state.closure_error < 1e-12
    assert drive.move(driver, start) is None
    there, wanted = (joint_poses(mechanism.model, x[None])[0, :, :3]
                     for x in (drive.state.q, state.q))
    np.testing.assert_allclose(there, wanted, atol=1e-9)


def test_limit_is_where_it_is_and_the_way_back_is_the_same():
    mechanism = sp.load("four_bar", **DOUBLE_ROCKER)
    limit = sp.limits(mechanism, "crank").upper.value
    drive = Jog(sp.assemble(mechanism), mechanism.drivers)
    drive.move("crank", 1.2)
    before = drive.state.q
    for beyond in (limit + 1e-9, limit + 0.01, 3.0, 2 * np.pi):
        stop = drive.move("crank", beyond)
        assert stop.kind == "limit" and stop.value == pytest.approx(limit, abs=1e-9)
        assert drive.value("crank") == stop.value
        assert drive.state.closure_error < 1e-12
    assert drive.move("crank", 1.2) is None
    np.testing.assert_allclose(drive.state.q, before, atol=1e-9)


def test_value_of_the_limit_itself_is_reached_or_stopped_at_and_left_again():
    mechanism = sp.load("four_bar", **DOUBLE_ROCKER)
    limit = sp.limits(mechanism, "crank").upper.value
    drive = Jog(sp.assemble(mechanism), mechanism.drivers)
    for value in (limit, limit - 1e-13, limit - 1e-10, limit):
        drive.move("crank", value)
        assert drive.value("crank") == pytest.approx(limit, abs=1e-9)
    assert drive.move("crank", 1.0) is None
    expected = sp.assemble(mechanism, {"crank": 1.0})
    np.testing.assert_allclose(drive.state.q, expected.q, atol=1e-9)


@pytest.mark.parametrize("steps", few([1, 7, 400], 7))
def test_change_point_is_passed_straight_on(steps):
    mechanism = sp.load("four_bar", **PARALLELOGRAM)
    state = sp.assemble(mechanism, {"crank": 1.0})
    drive = Jog(state, mechanism.drivers)
    poses = joint_poses(mechanism.model, state.q[None])
    for value in [*np.linspace(1.0, 5.5, steps + 1)[1:], np.pi, 3.0, 1.0]:
        assert drive.move("crank", value) is None
        assert drive.value("crank") == pytest.approx(value)
        assert drive.state.closure_error < 1e-9
    np.testing.assert_allclose(joint_poses(mechanism.model, drive.state.q[None]), poses, atol=1e-9)


def test_other_drivers_are_held_even_beside_a_limit():
    mechanism = sp.load("stewart")
    drive = Jog(sp.assemble(mechanism), mechanism.drivers)
    stop = drive.move("leg_1", 1.0)
    assert stop.kind == "limit"
    for name in ("leg_2", "leg_5"):
        drive.move(name, drive.value(name) + 1e-3)
    moved = abs(drive.value("leg_1") - stop.value)
    assert moved <= 2 * BESIDE * mechanism.characteristic_length
    assert drive.state.closure_error < 1e-12


@pytest.mark.slow
def test_a_move_ends_where_a_joint_runs_away():
    """An arm whose slide reaches a wall until they are parallel, at a quarter turn."""
    here, wall = (pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])) for x in (0.0, 1.0))
    model = pin.Model()
    arm = model.addJoint(0, pin.JointModelRZ(), here, "arm")
    model.addJoint(arm, pin.JointModelPX(), here, "slide")
    on_wall = sp.closures.point_on_plane(("universe", wall), ("slide", here), axis=[1, 0, 0])
    mech = sp.Mechanism.from_model(model, [on_wall], drivers=["arm"],
                                   guess={"arm": 0.1, "slide": 1.0}, name="wall")
    drive = Jog(sp.assemble(mech), ["arm"])
    (_, stops, _), stop = reaches(drive, "arm", 91), drive.move("arm", 2.0)
    for found, end in zip((*stops, stop), (-1.0, 1.0, 1.0), strict=True):
        assert found.kind == "limit" and found.value == pytest.approx(end * np.pi / 2, abs=1e-12)
    assert abs(drive.value("arm")) < np.pi / 2
    assert drive.move("arm", 0.2) is None and drive.value("arm") == 0.2


def test_a_driver_stops_where_any_joint_comes_to_its_limit(tmp_path):
    mechanism = limited_slider(tmp_path)
    drive = Jog(sp.assemble(mechanism), mechanism.drivers)
    drive.keeps_limits = True
    at = {end: np.arccos((0.01 + end**2 - 0.09) / (0.2 * end)) for end in (0.25, 0.38)}
    for wanted, value in ((0.0, at[0.38]), (3.0, at[0.25])):
        stop = drive.move("crank", wanted)
        assert (stop.kind, stop.of) == ("joint limit", "slide")
        assert drive.value("crank") == stop.value == pytest.approx(value, abs=1e-10)
        assert abs(drive.state.beyond_limits.get("slide", 0.0)) < 1e-10
    assert drive.move("crank", 1.5) is None
    ends, stops, _ = reaches(drive, "crank", 13)
    assert ends == pytest.approx((at[0.38], at[0.25]), abs=1e-10)
    assert [stop.of for stop in stops] == ["slide", "slide"]
    drive.keeps_limits = False
    assert drive.move("crank", 0.2) is None and drive.state.beyond_limits["slide"] > 0.0
    drive.keeps_limits = True
    assert drive.move("crank", 0.1).value == pytest.approx(0.2)  # no further out, but back
    assert drive.move("crank", 1.0) is None and not drive.state.beyond_limits


@pytest.mark.parametrize("far", few([0.5, 0.55, 1.0], 0.55))
def test_joint_limits_are_in_the_way_of_moves_beyond_the_end_of_the_branch(far):
    """The branch ends at 0.525 m, between the two values that such a move has."""
    mechanism = sp.load("stewart")
    limit = mechanism.model.upperPositionLimit[mechanism.coordinate("slide_1").q]
    drive = Jog(sp.assemble(mechanism), mechanism.drivers)
    drive.keeps_limits = True
    stop = drive.move("leg_1", far)
    assert (stop.kind, stop.of) == ("joint limit", "slide_1")
    assert drive.value("leg_1") == stop.value == pytest.approx(limit, abs=1e-12)


def test_failure_nobody_thought_of_is_reported_and_does_no_harm(rssr, monkeypatch, capfd):
    asking = Page(rssr)
    monkeypatch.setattr(Jog, "move", lambda *_: 1 / 0)
    assert asking.move("crank", 5.0) == {"error": "ZeroDivisionError: division by zero"}
    monkeypatch.undo()
    assert asking.move("crank", 5.0)["values"]["crank"] == pytest.approx(5.0)
    assert capfd.readouterr() == ("", "")


@pytest.fixture(scope="module")
def turned() -> sp.Motion:
    return sp.sweep(sp.load("rssr"), "crank", np.linspace(0, 2 * np.pi, 73), speed=25.0)


def test_every_section_says_what_it_does():
    assert all(write.__doc__ for write in SECTIONS)


@pytest.mark.parametrize(
    ("name", "driver", "expected"),
    [
        ("rssr", "crank", ["rocker_pin"]),
        ("four_bar", "crank", ["rocker_pin"]),
        ("four_bar", "rocker_pin", ["crank_pin"]),
        ("slider_crank", "crank", ["slide"]),
        ("rspc", "crank", ["guide.angle", "guide.slide"]),
        ("delta", "arm_1", ["pose.position"]),
        ("crane", "slew", ["boom.com.position", "cab.com.position"]),
    ],
)
def test_usual_outputs_are_what_moves_from_the_ground_on(name, driver, expected):
    mechanism = library(name)
    state = sp.assemble(mechanism)
    first = state.coordinate(driver).value
    motion = sp.sweep(mechanism, driver, np.linspace(first, first + 0.1, 5), guess=state)
    assert default_outputs(motion) == expected


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_every_mechanism_of_the_library_has_a_usual_motion(name):
    motion = default_motion(library(name))
    assert isinstance(motion, sp.Motion) and len(motion) > ROWS // 4
    assert motion.driver_name == next(iter(motion.mechanism.drivers))
    assert motion.time is None and default_outputs(motion)


def test_usual_motion_slides_a_little_and_turns_away_from_a_limit():
    slid = default_motion(sp.load("stewart"))
    assert np.ptp(slid.driver) == pytest.approx(SLIDE_RANGE * slid.mechanism.characteristic_length)
    rocked = default_motion(sp.load("four_bar"), "rocker_pin")
    (event,) = rocked.events
    assert event.kind == "limit" and 1 < len(rocked) < ROWS


def test_usual_motion_of_a_mechanism_without_drivers_is_its_state():
    mechanism = replace(sp.load("rssr"), drivers={})
    assert isinstance(default_motion(mechanism), sp.State)


def test_usual_outputs_of_what_stands_still_are_its_driver():
    motion = sp.sweep(sp.load("rssr"), "crank", [0.4])
    assert default_outputs(motion) == ["crank_pin"]


def test_numbers_read_well():
    assert number(np.pi / 2, "rad") == "90°"
    assert number(-0.25, "m") == "−0.25\u202fm"
    assert number(-3e-17, "m/s²") == "0\u202fm/s²"
    assert tiny(8.4e-15) == "8.4\u00a0·\u00a010⁻¹⁵" and tiny(0.0) == "0"


def test_table_escapes_what_it_is_given():
    text = table(("<name>", "value"), [("a & b", "1")], numbers=1)
    assert "&lt;name&gt;" in text and '<td>a &amp; b</td><td class="number">1</td>' in text


def test_svg_is_one_element_with_identifiers_of_its_own(turned):
    first, second = (svg(sp.plot(turned, "rocker_pin", title=""), name) for name in ("one", "two"))
    assert first.startswith('<svg role="img" aria-label="one"') and "<?xml" not in first

    def clips(text):
        return set(re.findall(r'<clipPath id="(\w+)"', text))

    assert clips(first) and not clips(first) & clips(second)



@pytest.mark.slow
@pytest.mark.browser
@needs_browser
@pytest.mark.parametrize("data", [
    [], [b""], [b"one", b"", b"three"], [b"again " * 20000], [bytes(range(256)) * 300],
    [np.random.default_rng(5).bytes(70000), b"end"],
], ids=["none", "empty", "few", "repeated", "every byte", "random"])
def test_page_unpacks_what_was_packed(browser, data, tmp_path):
    state = sp.assemble(sp.load("four_bar"))
    browser.open(sp.export_html(state, tmp_path / "page.html"), READY)
    text = browser.evaluate(
        f"unpacked({json.dumps(packed(data))}).then(found => found.map("
        "d => btoa(Array.from(d, c => String.fromCharCode(c)).join(''))))")
    assert [base64.b64decode(piece) for piece in text] == data


def test_a_rod_reaches_from_its_start_to_its_end():
    solid = rod(0.1, 1.0, 3.0)
    assert solid.geometry.height == 2.0
    assert (solid.placement @ [0.0, 0.0, 0.0, 1.0])[:3] == pytest.approx([0.0, 0.0, 2.0])
