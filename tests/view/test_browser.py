"""What a browser shows of the exported page, the live page, the report and the films."""

import asyncio
import contextlib
import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from folders import ROOT
from images import colour_mask, ink, middle, near, pixels, seen_at
from PIL import Image

import spatial_pin as sp
from spatial_pin.errors import SpatialPinError
from spatial_pin.view.browser.devtools import Browser
from spatial_pin.view.browser.movie import READY, movie, open_page, shoot
from spatial_pin.view.browser.picture import find_browser
from spatial_pin.view.page.html import export_html
from spatial_pin.view.page.report import report
from spatial_pin.view.scene.film import film
from spatial_pin.view.scene.framing import rotate
from spatial_pin.view.scene.layers.bodies import colour
from spatial_pin.view.scene.layers.gaps import COLOUR as GAP_COLOUR
from spatial_pin.view.scene.layers.traces import COLOURS as TRACE_COLOURS
from spatial_pin.view.scene.look import Look
from spatial_pin.view.scene.meshcat_commands import scene
from spatial_pin.view.scene.stage import joint_poses, upright

SIZE = (480, 360)
REPORT_READY = "frames.length === 1 && typeof frames[0].seek === 'function'"
SHOWN = {  # what is swept, from, to
    "rssr": ("crank", 0.3, 0.3 + 2 * np.pi),
    "four_bar": ("crank", 0.3, 3.0),
    "hooke_joint": ("input", 0.3, 3.0),
    "slider_crank": ("crank", 0.3, 3.0),
    "screw_press": ("screw", 0.0, 6.0),
    "swash_plate": ("shaft", 0.2, 3.0),
}
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(find_browser() is None, reason="no Chromium or Chrome on this machine"),
]


def swept(name: str, n: int = 61) -> sp.Motion:
    driver, first, last = SHOWN[name]
    return sp.sweep(sp.load(name), driver, np.linspace(first, last, n))


@pytest.fixture(scope="module")
def one_browser():
    with Browser(SIZE) as browser:
        yield browser


@pytest.fixture
def browser(one_browser):
    """The browser of all tests, which must have nothing to complain of after each."""
    one_browser.resize(SIZE)
    yield one_browser
    assert complaints(one_browser) == []


def complaints(browser: Browser) -> list[str]:
    """Errors on the console, exceptions, and requests that leave the page."""
    browser.evaluate("1")  # what was reported before has arrived now
    found = []
    for event in browser.events:
        method, said = event["method"], event["params"]
        if method == "Runtime.exceptionThrown":
            found.append(str(said["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and said["type"] in ("error", "assert"):
            found.append(str(said["args"]))
        elif method == "Log.entryAdded" and said["entry"]["level"] == "error":
            found.append(said["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            url = said["request"]["url"]
            own = url.startswith(("file:", "data:", "blob:", "about:", "http://127.0.0.1:"))
            found += [] if own else [url]
    return found


def photograph(browser: Browser, shown, folder: Path, seconds: float = 0.0, **options):
    """A picture of the page of a motion or state."""
    open_page(browser, export_html(shown, folder / "page.html", **options))
    return np.asarray(shoot(browser, seconds), float) / 255


# ---------------------------------------------------------------- the exported page


@pytest.mark.slow
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


def test_coupler_moves_and_ground_does_not(browser, tmp_path):
    motion = swept("rssr")
    open_page(browser, export_html(motion, tmp_path / "page.html"))
    first, second = (np.asarray(shoot(browser, t), float) / 255 for t in (0.0, 2.0))
    blue = (0.0, 0.447, 0.698)
    assert np.linalg.norm(middle(colour_mask(first, blue)) - middle(colour_mask(second, blue))) > 20
    again = np.asarray(shoot(browser, 0.0), float) / 255
    assert np.mean(np.any(np.abs(again - first) > 0.02, axis=2)) < 1e-3


def test_player_pauses_plays_and_seeks_when_it_is_clicked(browser, tmp_path):
    browser.open(export_html(swept("rssr"), tmp_path / "page.html"), READY)

    def middle_of(element: str, part: float = 0.5) -> tuple[float, float]:
        box = browser.evaluate(f"document.querySelector('{element}').getBoundingClientRect()"
                               ".toJSON()")
        return box["x"] + part * box["width"], box["y"] + 0.5 * box["height"]

    assert browser.evaluate("animator.playing")
    browser.click(*middle_of("#player button"))
    assert not browser.evaluate("animator.playing")
    stopped = browser.evaluate("animator.time")
    browser.screenshot()
    assert browser.evaluate("animator.time") == stopped
    browser.click(*middle_of("#player input", 0.75))
    duration = browser.evaluate("animator.duration")
    assert browser.evaluate("animator.time") == pytest.approx(0.75 * duration, rel=0.03)
    browser.screenshot()
    degrees = np.rad2deg(0.3 + browser.evaluate("animator.time"))
    assert f"crank = {degrees:.1f}°" in browser.evaluate("document.body.innerText")
    browser.click(*middle_of("#player button"))
    before = browser.evaluate("animator.time")
    browser.wait_until(f"animator.time > {before}")


def test_page_of_a_state_is_a_still(browser, tmp_path):
    state = sp.assemble(sp.load("stewart"))
    image = photograph(browser, state, tmp_path)
    assert ink(image).mean() > 0.05
    assert browser.evaluate("getComputedStyle(document.getElementById('player')).display") == "none"


def test_live_page_is_shown(browser):
    with sp.show(swept("four_bar"), open_browser=False) as viewer:
        open_page(browser, viewer.url)
        image = pixels(browser.screenshot())
    assert 0.02 < ink(image).mean() < 0.8
    assert colour_mask(image, (0.835, 0.369, 0.0)).sum() > 200


# ---------------------------------------------------------------- what a Look adds


def test_trace_is_drawn_along_the_path(browser, tmp_path):
    motion = swept("four_bar")
    look = Look(traces=("coupler_b",))
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


def test_open_closure_is_marked(browser, tmp_path):
    mechanism = sp.load("four_bar", r3=1.0)
    with pytest.raises(sp.AssemblyError) as caught:
        sp.assemble(mechanism, {"crank": 0.5})
    image = photograph(browser, caught.value.state, tmp_path)
    assert colour_mask(image, GAP_COLOUR).sum() > 50
    assert "open by" in browser.evaluate("document.body.innerText")
    closed = photograph(browser, swept("four_bar"), tmp_path)
    assert colour_mask(closed, GAP_COLOUR).sum() == 0


# ---------------------------------------------------------------- the report


@pytest.mark.slow
def test_report_shows_the_mechanism_and_its_figures(browser, tmp_path):
    browser.resize((1100, 900))
    browser.open(report(swept("rssr"), tmp_path / "report.html"), REPORT_READY)
    browser.wait_until("!frames[0].viewer.needs_render")
    browser.evaluate("frames[0].seek(1.0)")
    box = browser.evaluate("document.querySelector('iframe').getBoundingClientRect().toJSON()")
    image = pixels(browser.screenshot())
    part = image[int(box["y"]) : int(box["bottom"]), int(box["x"]) : int(box["right"])]
    for hue in ((0.835, 0.369, 0.0), (0.0, 0.447, 0.698), (0.0, 0.62, 0.451)):
        assert colour_mask(part, hue).sum() > 500
    figures = browser.evaluate(
        "[...document.querySelectorAll('figure > svg')].map(s => s.getBoundingClientRect().width)"
    )
    assert len(figures) == 4 and min(figures) > 700
    browser.evaluate("document.querySelector('figure > svg').scrollIntoView(); 1")
    assert colour_mask(pixels(browser.screenshot()), (0.0, 0.447, 0.698)).sum() > 300
    assert browser.evaluate("document.documentElement.scrollWidth") <= 1100


def test_cursor_of_the_curves_of_a_report_follows_the_picture_and_moves_it(browser, tmp_path):
    browser.resize((1100, 900))
    motion = swept("rssr")
    browser.open(report(motion, tmp_path / "report.html"), REPORT_READY)
    browser.evaluate("frames[0].seek(1.0)")
    line = "figures[0].lines[0].getBoundingClientRect().toJSON()"
    drawn = browser.evaluate("figures[0].svg.getBoundingClientRect().toJSON()")
    left, _, width, _, first, last = browser.evaluate("figures[0].panels[0]")
    assert (first, last) == pytest.approx(tuple(np.rad2deg(motion.driver[[0, -1]])))

    def at(crank: float) -> float:
        part = (np.rad2deg(crank) - first) / (last - first)
        return drawn["x"] + (left + part * width) * drawn["width"]

    browser.wait_until(f"Math.abs({line}.x - {at(1.3)}) < 1.5")
    browser.evaluate("figures[1].svg.scrollIntoView(); 1")
    box = browser.evaluate("figures[1].svg.getBoundingClientRect().toJSON()")
    left2, top2, width2, height2, *_ = browser.evaluate("figures[1].panels[0]")
    across = box["x"] + (left2 + 0.6 * width2) * box["width"]
    browser.click(across, box["y"] + (top2 + 0.5 * height2) * box["height"])
    assert browser.evaluate("frames[0].filmTime()") == pytest.approx(0.6 * 2 * np.pi, abs=0.02)
    browser.wait_until(f"Math.abs({line}.x - {at(0.3 + 0.6 * 2 * np.pi)}) < 3")
    assert browser.evaluate("figures.every(f => f.lines.every(l => !l.hidden))")


def test_report_fits_a_telephone(browser, tmp_path):
    browser.resize((390, 760))
    browser.open(report(swept("rssr"), tmp_path / "report.html"), REPORT_READY)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
    boxes = browser.evaluate("[...document.querySelectorAll('.key div, .key dd, iframe, h1')]"
                             ".map(e => e.getBoundingClientRect().toJSON())")
    assert all(b["x"] >= 0 and b["right"] <= 390 for b in boxes)
    words = browser.evaluate("[...document.querySelectorAll('.key dd')]"
                             ".every(e => e.scrollWidth <= e.clientWidth + 1)")
    assert words
    assert browser.evaluate("document.querySelector('iframe').clientHeight") > 400
    fits = "e.scrollWidth <= e.clientWidth && e.getBoundingClientRect().right <= 390"
    boxes = "[...document.querySelectorAll('figure, figure > svg, .wide')]"
    assert browser.evaluate(f"{boxes}.length > 8 && {boxes}.every(e => {fits})")
    text = ("[...document.querySelectorAll('figure [id^=text_]')]"
            ".map(e => e.getBoundingClientRect())")
    low, left, right = browser.evaluate(
        f"(t => [Math.min(...t.map(b => b.height)), Math.min(...t.map(b => b.left)),"
        f" Math.max(...t.map(b => b.right))])({text})")
    assert low > 6.5 and left >= 0 and right <= 390  # small letters without stems
    drawn = browser.evaluate("figures[0].svg.getBoundingClientRect().toJSON()")
    assert drawn["width"] > 340 and drawn["height"] > 150
    browser.evaluate("dispatchEvent(new Event('beforeprint')); 1")
    assert browser.evaluate("figures[0].svg.getAttribute('preserveAspectRatio')") == "xMidYMid"



def test_report_is_printed_with_its_picture(browser, tmp_path):
    browser.open(report(swept("rssr"), tmp_path / "report.html"), REPORT_READY)
    browser.evaluate("frames[0].seek(1.0); frames[0].dispatchEvent(new Event('beforeprint')); 1")
    browser.wait_until("frames[0].document.getElementById('still').complete")
    assert browser.evaluate("frames[0].document.getElementById('still').naturalWidth") > 200
    browser.evaluate("frames[0].dispatchEvent(new Event('afterprint')); 1")
    assert browser.evaluate("frames[0].document.getElementById('still')") is None
    printed = browser.call("Page.printToPDF", preferCSSPageSize=True)["data"]
    assert len(printed) > 50_000


# ---------------------------------------------------------------- films


@pytest.mark.slow
def test_gif_lasts_as_long_as_the_motion_and_moves(tmp_path):
    motion = swept("four_bar")
    path = movie(motion, tmp_path / "four_bar.gif", fps=2, size=(320, 240))
    with Image.open(path) as film_file:
        assert film_file.size == (320, 240)
        frames, lasted = [], 0
        for k in range(film_file.n_frames):
            film_file.seek(k)
            lasted += film_file.info["duration"]
            frames.append(np.asarray(film_file.convert("RGB"), float) / 255)
        assert film_file.info["loop"] == 0
    assert lasted / 1000 == pytest.approx(film(motion).seconds[-1], abs=0.5 / 2 + 0.01)
    blue = (0.0, 0.447, 0.698)
    ends = [middle(colour_mask(frames[k], blue)) for k in (0, -1)]
    assert np.linalg.norm(ends[0] - ends[1]) > 15


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("imageio_ffmpeg") is None,
                    reason="the extra `movie` is not installed")
def test_mp4_has_every_frame(tmp_path):
    import imageio_ffmpeg

    path = movie(swept("four_bar"), tmp_path / "four_bar.mp4", fps=2, size=(321, 240))
    assert path.stat().st_size > 2000
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert (frames, seconds) == (5, pytest.approx(2.5, abs=0.1))


def test_browser_works_inside_a_running_event_loop():
    async def notebook() -> int:
        with Browser(SIZE) as browser:
            return browser.evaluate("6 * 7")

    assert asyncio.run(notebook()) == 42


# ---------------------------------------------------------------- the gallery


def gallery():
    spec = importlib.util.spec_from_file_location(
        "gallery", ROOT / "scripts" / "gallery.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_gallery_has_a_picture_of_every_mechanism_asked_for(tmp_path, capsys):
    path = tmp_path / "sheet.png"
    gallery().main([str(path), "--only", "rssr", "oldham", "elliptic_trammel"])
    image = pixels(path.read_bytes())
    assert image.shape == (390, 3 * 480, 3)
    for k in range(3):
        assert 0.05 < ink(image[20:340, 480 * k + 20 : 480 * k + 460]).mean() < 0.8
    assert "wrote" in capsys.readouterr().out


@pytest.mark.slow
def test_animation_of_the_readme_is_small(tmp_path, monkeypatch):
    script, path = gallery(), tmp_path / "rssr.gif"
    monkeypatch.setattr(script, "FRAMES", 4)
    script.main(["--animation", "rssr", str(path), "--trace", "coupler.com"])
    with Image.open(path) as animation:
        assert (animation.size, animation.n_frames) == (script.ANIMATION, 4)
    assert path.stat().st_size < 60_000


# ---------------------------------------------------------------- the browser itself


def group_of(leader: int) -> list[int]:
    """Processes of a process group that still run."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError):
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            if int(fields[2]) == leader and fields[0] != "Z":
                found.append(int(folder.name))
    return found


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_closed_browser_leaves_nothing_behind():
    browser = Browser(SIZE)
    leader, folder = browser._process.pid, Path(browser._folder.name)
    assert group_of(leader) and folder.is_dir()
    browser.close()
    browser.close()
    assert not group_of(leader) and not folder.exists()
    with pytest.raises(SpatialPinError, match="closed"):
        browser.evaluate("1")


FILMING = """
import sys, time, numpy as np, spatial_pin as sp
movie = __import__("importlib").import_module("spatial_pin.view.browser.movie")
def shoot(browser, seconds):
    print(browser._process.pid, browser._folder.name, flush=True)
    time.sleep(600)
movie.shoot = shoot
sp.movie(sp.sweep(sp.load("four_bar"), "crank", np.linspace(0.3, 3.0, 9)), sys.argv[1])
"""


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


def test_script_that_throws_and_page_that_is_not_there_are_clear_errors(browser, tmp_path):
    with pytest.raises(SpatialPinError, match="nonsense"):
        browser.evaluate("nonsense()")
    with pytest.raises(SpatialPinError, match=r"cannot open.*missing"):
        browser.open(tmp_path / "missing.html")
    browser.events.clear()


@pytest.mark.parametrize("is_noticed", [False, True])
def test_browser_that_dies_is_a_clear_error(is_noticed):
    with Browser(SIZE) as browser:
        os.killpg(browser._process.pid, 9)
        while is_noticed and not browser._line._socket.protocol.stream.closed():
            time.sleep(0.01)
        with pytest.raises(SpatialPinError, match=r"went away|closed"):
            browser.evaluate("1")


def test_browser_that_does_not_start_is_a_clear_error(monkeypatch, tmp_path):
    program = tmp_path / "chromium"
    program.write_text("#!/bin/sh\necho no display >&2\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr("spatial_pin.view.browser.devtools.find_browser", lambda: str(program))
    with pytest.raises(SpatialPinError, match=r"ended at once:\s+no display"):
        Browser(SIZE)
