"""The page, the server, the plots and the pictures of a motion."""

import math
import re
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from subprocess import PIPE
from types import SimpleNamespace
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin
import pytest
from chromium import find_browser, needs_browser
from images import commands, data_of, page, picture
from pictured import ARM, BLUE, GREEN, RED, SHAPES, arm, shown_as, state
from variety import first

import spatial_pin as sp

MOST_ROWS = 1201  # of a film


class Output(NamedTuple):
    values: np.ndarray
    label: str
    unit: str


OUTPUTS = {
    "angle": lambda m: Output(m.q[:, 0], "shoulder", "rad"),
    "constant": lambda m: Output(0.3 + 1e-16 * np.arange(len(m.q)), "reach", "m"),
    "tip": lambda m: Output(np.stack([np.cos(m.driver), m.driver, 0 * m.driver], 1), "tip", "m"),
}


def motion(n: int = 60, turn: float = math.pi, **changes: object) -> SimpleNamespace:
    driver = np.linspace(0.0, turn, n)
    made = SimpleNamespace(
        mechanism=arm(),
        q=np.stack([driver, 0.05 * np.sin(driver)], axis=1),
        time=None,
        driver=driver,
        driver_name="crank",
        driver_unit="rad",
        closure_error=np.linspace(0.0, 3e-14, n),
        events=[],
    )
    made.output = lambda name: OUTPUTS[name](made)
    vars(made).update(changes)
    return made


# ---------------------------------------------------------------- pace


def pace(shown: object) -> tuple[list[float], tuple[str, ...]]:
    """When a page shows each sample [s], and what it notes of that."""
    text = page(shown)
    notes = re.findall(r"<small>(shown [^<]*)</small>", text)
    return data_of(text)["seconds"], tuple(notes)


@pytest.mark.parametrize(
    ("duration", "shown", "note"),
    [
        (2.0, 2.0, ()),
        (20.0, 20.0, ()),
        (0.25, 5.0, ("shown 20x slower",)),
        (3600.0, 7.2, ("shown 500x faster",)),
    ],
)
def test_motion_with_times_is_shown_at_true_time_or_says_by_how_much_not(duration, shown, note):
    seconds, notes = pace(motion(time=np.linspace(1.0, 1.0 + duration, 60)))
    assert seconds[-1] == pytest.approx(shown)
    assert notes == note


@pytest.mark.parametrize(
    ("turn", "unit", "shown", "note"),
    [
        (2 * math.pi, "rad", 2 * math.pi, "shown at 1 rad/s"),
        (-3.0, "rad", 3.0, "shown at 1 rad/s"),
        (0.06, "rad", 6.0, "shown at 0.01 rad/s"),
        (0.12, "m", 6.0, "shown at 20 mm/s"),
    ],
)
def test_motion_without_times_is_shown_at_a_round_driver_speed(turn, unit, shown, note):
    seconds, notes = pace(motion(turn=turn, driver_unit=unit))
    assert seconds[-1] == pytest.approx(shown)
    assert notes == (note,)


def test_motion_without_driver_and_times_is_shown_evenly():
    seconds, _ = pace(motion(driver=None))
    np.testing.assert_allclose(np.diff(seconds), seconds[-1] / 59, atol=1e-6)


def test_long_motion_is_thinned_and_says_so():
    text = page(motion(n=5000))
    made = data_of(text)
    assert len(made["seconds"]) == len(made["readings"][0]["values"]) == MOST_ROWS
    assert made["readings"][0]["values"][-1] == pytest.approx(180.0)
    assert f"<small>{MOST_ROWS} of 5000 rows</small>" in text
    assert "closure error ≤ 3.0e-14" in text


def test_empty_motion_is_refused():
    with pytest.raises(ValueError, match="no samples"):
        page(motion(n=0))


# ---------------------------------------------------------------- page


def test_page_refers_to_nothing_outside_itself():
    text = page(motion())
    assert not re.search(r"<(script|link|img|iframe)[^>]*\b(src|href)\s*=", text)
    assert "default-src 'none'" in text
    assert "url(" not in re.search(r"<style>(.*?)</style>", text, re.S)[1]


def test_page_of_360_rows_is_small_and_holds_them_all(tmp_path):
    made = motion(n=360)
    path = sp.export_html(made, tmp_path / "arm.html")
    assert path.stat().st_size < 1.5e6
    text = path.read_text(encoding="utf-8")
    (animation,) = commands(text, "set_animation")
    clips = {c["path"]: c["clip"] for c in animation["animations"]}
    assert set(clips) == {"/mechanism/shoulder", "/mechanism/elbow"}
    position, quaternion = clips["/mechanism/elbow"]["tracks"]
    times = np.frombuffer(position["times"].data, "<f4")
    np.testing.assert_allclose(times, data_of(text)["seconds"], atol=1e-6)
    model = made.mechanism.model
    data = model.createData()
    for row in (0, 100, 359):
        pin.forwardKinematics(model, data, made.q[row])
        expected = pin.SE3ToXYZQUAT(data.oMi[2])
        place = np.frombuffer(position["values"].data, "<f4").reshape(-1, 3)[row]
        turn = np.frombuffer(quaternion["values"].data, "<f4").reshape(-1, 4)[row]
        np.testing.assert_allclose(np.r_[place, turn], expected, atol=1e-6)
    assert len(data_of(text)["readings"][0]["values"]) == 360


def test_page_says_title_driver_closure_error_and_pace():
    text = page(motion(time=np.linspace(0, 0.25, 60)))
    assert "<title>Arm &lt;1&gt; &amp; co</title>" in text
    assert "closure error ≤ 3.0e-14" in text
    assert "shown 20x slower" in text
    assert [r["name"] for r in data_of(text)["readings"]] == ["crank", "time"]
    assert "<h1>Other</h1>" in page(motion(), title="Other")


def test_names_cannot_break_out_of_the_page():
    text = page(motion(driver_name="</script><script>alert(1)"))
    assert "alert(1)" not in re.sub(r'<script type="application/json".*?</script>', "", text)
    assert data_of(text)["readings"][0]["name"] == "</script><script>alert(1)"


def test_page_of_a_state_is_still():
    text = page(state())
    assert not commands(text, "set_animation")
    (reading,) = data_of(text)["readings"]
    assert reading["name"] == "shoulder"
    assert reading["values"] == pytest.approx([math.degrees(0.7)], abs=1e-3)
    assert "closure error 2.0e-15" in text


# ---------------------------------------------------------------- shapes


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_is_drawn(name):
    objects = commands(page(shown_as(SHAPES[name]())), "set_object")
    assert [c["path"] for c in objects if "part" in c["path"]] == ["/mechanism/shoulder/0 part_1"]


def test_cylinder_axis_is_z():
    text = page(shown_as(coal.Cylinder(0.1, 0.4)))
    (command,) = [c for c in commands(text, "set_transform") if "part" in c["path"]]
    matrix = np.reshape(command["matrix"], (4, 4)).T
    np.testing.assert_allclose(np.abs(matrix[:3, 1]), [0, 0, 1])


def test_capsule_surface_is_at_its_radius():
    text = page(shown_as(coal.Capsule(0.1, 0.4)))
    (command,) = [c for c in commands(text, "set_object") if "part" in c["path"]]
    profile = command["object"]["geometries"][0]["points"]
    points = np.array([[p["x"], p["y"]] for p in profile])
    from_core = points - np.clip(points[:, 1], -0.2, 0.2)[:, None] * [0, 1]
    np.testing.assert_allclose(np.linalg.norm(from_core, axis=1), 0.1, rtol=1e-6)


def test_shape_that_cannot_be_drawn_is_omitted_with_a_warning():
    with pytest.warns(UserWarning, match="part/1.*not shown"):
        text = page(shown_as(coal.BVHModelOBBRSS()))
    assert not [c for c in commands(text, "set_object") if "part" in c["path"]]


def test_mechanism_without_visuals_is_shown_as_a_skeleton():
    mechanism = arm()
    mechanism.visual_model = pin.GeometryModel()
    paths = [c["path"] for c in commands(page(state(mechanism=mechanism)), "set_object")]
    assert any(p.startswith("/mechanism/shoulder/") and "stick" in p for p in paths)


# ---------------------------------------------------------------- framing


# ---------------------------------------------------------------- server


def get(url: str) -> tuple[int, bytes]:
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.status, answer.read()


def test_show_serves_the_page_on_this_machine_only_and_stops():
    before = set(threading.enumerate())
    viewer = sp.show(motion(), open_browser=False)
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", viewer.url)
    assert viewer._server.socket.getsockname()[0] == "127.0.0.1"
    status, body = get(viewer.url)
    assert status == 200 and b"Arm &lt;1&gt;" in body
    with pytest.raises(urllib.error.HTTPError, match="404") as caught:
        get(viewer.url + "etc/passwd")
    caught.value.close()
    assert viewer.url in repr(viewer)
    viewer.stop()
    viewer.stop()
    viewer.wait()
    assert not viewer.running and "stopped" in repr(viewer)
    assert set(threading.enumerate()) <= before | {
        t for t in threading.enumerate() if "process_request_thread" in t.name
    }
    with pytest.raises(urllib.error.URLError):
        get(viewer.url)


def test_viewer_is_a_context_manager():
    with sp.show(state(), open_browser=False) as viewer:
        viewer.wait(timeout=0.01)
        assert viewer.running
    assert not viewer.running


def test_ctrl_c_ends_the_wait_cleanly_and_a_page_that_is_served_holds_no_program_up():
    program = """
import signal, sys, threading, time, traceback
from spatial_pin import Viewer

signal.signal(signal.SIGINT, signal.default_int_handler)  # which background programs ignore
v, w = Viewer("page"), Viewer("other")

def tell():  # once the program waits
    main = threading.main_thread().ident
    while "join" not in [f.name for f in traceback.extract_stack(sys._current_frames()[main])]:
        time.sleep(0.01)
    print(v.url, flush=True)

threading.Thread(target=tell).start()
v.wait()
print(v)
"""
    command = [sys.executable, "-W", "error", "-c", program]
    with subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True) as process:
        url = process.stdout.readline().strip()
        assert get(url) == (200, b"page")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    assert (process.returncode, out, err) == (0, "<Viewer, stopped>\n", "")


def test_taken_port_is_a_clear_error():
    with sp.Viewer("one") as viewer:
        port = int(viewer.url.rsplit(":", 1)[1].strip("/"))
        with pytest.raises(sp.SpatialPinError, match=rf"port {port}.*export_html"):
            sp.Viewer("two", port)


def test_show_opens_a_browser_and_waits_until_it_has_the_page(monkeypatch):
    monkeypatch.setenv("BROWSER", "any")
    opened: list[threading.Thread] = []

    def browser(url):
        opened.append(threading.Thread(target=get, args=(url,)))
        opened[0].start()
        return True

    monkeypatch.setattr("webbrowser.open", browser)
    with sp.show(state()) as viewer:
        assert viewer.wait_until_fetched(0.0)
    opened[0].join()


@pytest.mark.parametrize("shell", [None, "of a terminal"])
def test_show_without_a_browser_gives_the_address(monkeypatch, shell):
    """Where IPython and parts of notebooks are imported, but none runs, too."""
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    monkeypatch.setenv("BROWSER", "any")
    monkeypatch.setattr("webbrowser.open", lambda url: False)
    with pytest.warns(UserWarning, match=r"open http://127\.0\.0\.1:\d+/"):
        viewer = sp.show(state())
    viewer.stop()


def test_importing_loads_neither_meshcat_nor_matplotlib_and_plots_leave_its_backend_alone():
    program = (
        "import sys, spatial_pin as sp; sp.show, sp.export_html, sp.plot, sp.screenshot, sp.movie\n"
        "assert not {'meshcat', 'matplotlib', 'IPython', 'zmq'} & set(sys.modules)\n"
        "import matplotlib; matplotlib.use('svg')\n"
        "sp.plot(sp.sweep(sp.load('four_bar'), 'crank', [0.3, 0.4]), 'rocker_pin')\n"
        "assert matplotlib.get_backend() == 'svg' and 'matplotlib.pyplot' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", program], timeout=90).returncode == 0


# ---------------------------------------------------------------- plots


def test_plot_has_a_panel_an_output_with_units(tmp_path):
    figure = sp.plot(motion(), ["angle", "tip", "constant"], tmp_path / "a.png")
    angle, tip, constant = figure.axes
    assert [a.get_title("left") for a in figure.axes] == ["shoulder [°]", "tip [m]", "reach [m]"]
    assert constant.get_xlabel() == "crank [°]"
    assert figure.get_suptitle() == "Arm <1> & co"
    assert angle.lines[0].get_ydata()[-1] == pytest.approx(180.0)
    assert [t.get_text() for t in tip.get_legend().get_texts()] == ["x", "y", "z"]
    assert angle.get_legend() is None
    assert np.ptp(constant.get_ylim()) > 0.01
    assert 45.0 in constant.get_xticks() or 30.0 in constant.get_xticks()


@pytest.mark.parametrize(("suffix", "start"), first(2, [
    ("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")]))
def test_plot_is_written_as_its_suffix_says(tmp_path, suffix, start):
    path = tmp_path / f"plot.{suffix}"
    sp.plot(motion(n=720), ["angle", "tip"], path, title="Title")
    assert path.read_bytes().startswith(start)
    assert path.stat().st_size < 300_000


def test_plot_over_a_sliding_driver_or_time():
    (axes,) = sp.plot(motion(driver_unit="m"), "tip").axes
    assert axes.get_xlabel() == "crank [m]"
    still = motion(driver=None, time=np.linspace(0, 1, 60))
    assert sp.plot(still, "angle").axes[0].get_xlabel() == "time [s]"
    swing = motion(time=np.linspace(0, 1, 60))
    assert sp.plot(swing, "angle").axes[0].get_xlabel() == "crank [°]"
    swing.driver = np.sin(7 * swing.driver)
    assert sp.plot(swing, "angle").axes[0].get_xlabel() == "time [s]"
    with pytest.raises(ValueError, match="at least one"):
        sp.plot(motion(), [])


# ---------------------------------------------------------------- pictures


def hue_mask(image: np.ndarray, colour: tuple[float, float, float]) -> np.ndarray:
    """Where the picture has a colour, however lit."""
    c = np.array(colour) - np.mean(colour)
    p = image - image.mean(axis=2, keepdims=True)
    size = np.linalg.norm(p, axis=2)
    return (size > 0.15) & (p @ c > 0.95 * size * np.linalg.norm(c))


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_picture_shows_every_link_and_moves(tmp_path):
    shots = [picture(sp.screenshot(motion(), tmp_path / "shot.png", row=row, size=(480, 360)))
             for row in (0, 28)]
    for shot in shots:
        assert shot.shape == (360, 480, 3)
        assert np.mean(np.all(shot > 0.99, axis=2)) > 0.3  # white ground
        for colour in (RED, GREEN, BLUE):
            assert hue_mask(shot, colour).sum() > 100
    one, other = (np.argwhere(hue_mask(s, BLUE)).mean(axis=0) for s in shots)
    assert one[0] - other[0] > 60  # the ball has risen
    green = [hue_mask(s, GREEN) for s in shots]
    assert np.mean(green[0] ^ green[1]) < 0.01  # the base has not moved


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
@pytest.mark.parametrize("size", [1e-2, 30.0])
def test_picture_is_as_good_of_a_watch_as_of_a_crane(tmp_path, size):
    numbers = r'(xyz|size|radius|length)="([^"]*)"'

    def scaled(found):
        values = " ".join(str(size * float(x)) for x in found[2].split())
        return f'{found[1]}="{values}"'

    axes = re.sub(r'<axis xyz="', '<axis  xyz="', ARM)
    mechanism = arm(re.sub(r"(?<!axis  )" + numbers, scaled, axes))
    shot = picture(sp.screenshot(state(mechanism=mechanism), tmp_path / "a.png", size=(480, 360)))
    for colour in (RED, GREEN, BLUE):
        assert hue_mask(shot, colour).sum() > 100
    drawn = np.argwhere(hue_mask(shot, RED) | hue_mask(shot, GREEN) | hue_mask(shot, BLUE))
    assert np.ptp(drawn, axis=0).max() > 200  # it fills the picture
    assert drawn.min() > 5 and drawn[:, 0].max() < 355 and drawn[:, 1].max() < 475


def test_picture_without_a_browser_is_a_clear_error(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    if find_browser() is not None:
        pytest.skip("the browser of this machine is not found by the PATH")
    with pytest.raises(sp.SpatialPinError, match="needs Chromium"):
        sp.screenshot(state(), tmp_path / "a.png")
