"""What a browser shows of the exported page, the live page, the report and the films."""

import importlib.util

import numpy as np
import pytest
from chromium import READY, click_at, needs_browser, open_page, shoot
from folders import ROOT
from images import colour_mask, data_of, ink, middle, page, pixels
from pictured import photograph, swept
from PIL import Image

import spatial_pin as sp

SIZE = (480, 360)
MAGENTA = (1.0, 0.0, 0.62)  # of open closures
REPORT_READY = "frames.length === 1 && typeof frames[0].seek === 'function'"
pytestmark = [pytest.mark.browser, needs_browser]


# ---------------------------------------------------------------- the exported page


def test_coupler_moves_and_ground_does_not(browser, tmp_path):
    motion = swept("rssr")
    open_page(browser, sp.export_html(motion, tmp_path / "page.html"))
    first, second = (np.asarray(shoot(browser, t), float) / 255 for t in (0.0, 2.0))
    blue = (0.0, 0.447, 0.698)
    assert np.linalg.norm(middle(colour_mask(first, blue)) - middle(colour_mask(second, blue))) > 20
    again = np.asarray(shoot(browser, 0.0), float) / 255
    assert np.mean(np.any(np.abs(again - first) > 0.02, axis=2)) < 1e-3


@pytest.mark.slow
def test_player_pauses_plays_and_seeks_when_it_is_clicked(browser, tmp_path):
    browser.open(sp.export_html(swept("rssr"), tmp_path / "page.html"), READY)

    def middle_of(element: str, part: float = 0.5) -> tuple[float, float]:
        box = browser.evaluate(f"document.querySelector('{element}').getBoundingClientRect()"
                               ".toJSON()")
        return box["x"] + part * box["width"], box["y"] + 0.5 * box["height"]

    assert browser.evaluate("animator.playing")
    click_at(browser, *middle_of("#player button"))
    assert not browser.evaluate("animator.playing")
    stopped = browser.evaluate("animator.time")
    browser.screenshot()
    assert browser.evaluate("animator.time") == stopped
    click_at(browser, *middle_of("#player input", 0.75))
    duration = browser.evaluate("animator.duration")
    assert browser.evaluate("animator.time") == pytest.approx(0.75 * duration, rel=0.03)
    browser.screenshot()
    degrees = np.rad2deg(0.3 + browser.evaluate("animator.time"))
    assert f"crank = {degrees:.1f}°" in browser.evaluate("document.body.innerText")
    click_at(browser, *middle_of("#player button"))
    before = browser.evaluate("animator.time")
    browser.wait_until(f"animator.time > {before}")


@pytest.mark.slow
def test_page_of_a_state_is_a_still(browser, tmp_path):
    state = sp.assemble(sp.load("stewart"))
    image = photograph(browser, state, tmp_path)
    assert ink(image).mean() > 0.05
    assert browser.evaluate("getComputedStyle(document.getElementById('player')).display") == "none"


@pytest.mark.slow
def test_live_page_is_shown(browser):
    with sp.show(swept("four_bar"), open_browser=False) as viewer:
        open_page(browser, viewer.url)
        image = pixels(browser.screenshot())
    assert 0.02 < ink(image).mean() < 0.8
    assert colour_mask(image, (0.835, 0.369, 0.0)).sum() > 200


# ---------------------------------------------------------------- what a Look adds


@pytest.mark.slow
def test_open_closure_is_marked(browser, tmp_path):
    mechanism = sp.load("four_bar", r3=1.0)
    with pytest.raises(sp.AssemblyError) as caught:
        sp.assemble(mechanism, {"crank": 0.5})
    image = photograph(browser, caught.value.state, tmp_path)
    assert colour_mask(image, MAGENTA).sum() > 50
    assert "open by" in browser.evaluate("document.body.innerText")
    closed = photograph(browser, swept("four_bar"), tmp_path)
    assert colour_mask(closed, MAGENTA).sum() == 0


# ---------------------------------------------------------------- the report


@pytest.mark.slow
def test_report_shows_the_mechanism_and_its_figures(browser, tmp_path):
    browser.resize((1100, 900))
    browser.open(sp.report(swept("rssr"), tmp_path / "report.html"), REPORT_READY)
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


@pytest.mark.slow
def test_cursor_of_the_curves_of_a_report_follows_the_picture_and_moves_it(browser, tmp_path):
    browser.resize((1100, 900))
    motion = swept("rssr")
    browser.open(sp.report(motion, tmp_path / "report.html"), REPORT_READY)
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
    click_at(browser, across, box["y"] + (top2 + 0.5 * height2) * box["height"])
    assert browser.evaluate("frames[0].filmTime()") == pytest.approx(0.6 * 2 * np.pi, abs=0.02)
    browser.wait_until(f"Math.abs({line}.x - {at(0.3 + 0.6 * 2 * np.pi)}) < 3")
    assert browser.evaluate("figures.every(f => f.lines.every(l => !l.hidden))")


@pytest.mark.slow
def test_report_fits_a_telephone(browser, tmp_path):
    browser.resize((390, 760))
    browser.open(sp.report(swept("rssr"), tmp_path / "report.html"), REPORT_READY)
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


@pytest.mark.slow
def test_report_is_printed_with_its_picture(browser, tmp_path):
    browser.open(sp.report(swept("rssr"), tmp_path / "report.html"), REPORT_READY)
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
    path = sp.movie(motion, tmp_path / "four_bar.gif", fps=2, size=(320, 240))
    with Image.open(path) as film_file:
        assert film_file.size == (320, 240)
        frames, lasted = [], 0
        for k in range(film_file.n_frames):
            film_file.seek(k)
            lasted += film_file.info["duration"]
            frames.append(np.asarray(film_file.convert("RGB"), float) / 255)
        assert film_file.info["loop"] == 0
    assert lasted / 1000 == pytest.approx(data_of(page(motion))["seconds"][-1], abs=0.5 / 2 + 0.01)
    blue = (0.0, 0.447, 0.698)
    ends = [middle(colour_mask(frames[k], blue)) for k in (0, -1)]
    assert np.linalg.norm(ends[0] - ends[1]) > 15


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("imageio_ffmpeg") is None,
                    reason="the extra `movie` is not installed")
def test_mp4_has_every_frame(tmp_path):
    import imageio_ffmpeg

    path = sp.movie(swept("four_bar"), tmp_path / "four_bar.mp4", fps=2, size=(321, 240))
    assert path.stat().st_size > 2000
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert (frames, seconds) == (5, pytest.approx(2.5, abs=0.1))


# ---------------------------------------------------------------- the gallery


@pytest.fixture
def pictures(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    return importlib.import_module("pictures")


@pytest.mark.slow
def test_gallery_has_a_picture_of_every_mechanism_requested(pictures):
    image = np.asarray(pictures.library_sheet(["rssr", "oldham", "elliptic_trammel"])) / 255
    assert image.shape == (390, 3 * 480, 3)
    for k in range(3):
        assert 0.05 < ink(image[20:340, 480 * k + 20 : 480 * k + 460]).mean() < 0.8


@pytest.mark.slow
def test_animation_of_the_readme_is_small(pictures, tmp_path, monkeypatch):
    path = tmp_path / "rssr.gif"
    monkeypatch.setattr(pictures, "FRAMES", 4)
    pictures.animate("rssr", path, ["coupler.com"])
    with Image.open(path) as animation:
        assert (animation.size, animation.n_frames) == (pictures.TILE, 4)
    assert path.stat().st_size < 60_000


# ---------------------------------------------------------------- the browser itself


@pytest.mark.slow
def test_script_that_throws_and_page_that_is_not_there_are_clear_errors(browser, tmp_path):
    with pytest.raises(sp.SpatialPinError, match="nonsense"):
        browser.evaluate("nonsense()")
    with pytest.raises(sp.SpatialPinError, match=r"cannot open.*missing"):
        browser.open(tmp_path / "missing.html")
    browser.events.clear()
