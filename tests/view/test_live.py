"""The page whose sliders move a mechanism: what it is told, whom it answers, what it looks like."""

import dataclasses
import json
import re
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from chromium import Browser, click_at, needs_browser
from images import ink, page, pixels
from live_pages import (
    LONGEST_QUESTION,
    Page,
    headers_of,
    live_data,
    opened,
    port_of,
    post,
    text_of,
)
from machines import limited_slider
from variety import few

import spatial_pin as sp

DOUBLE_ROCKER = {"r1": 0.3, "r2": 0.24, "r3": 0.1, "r4": 0.28}


@pytest.fixture
def rssr():
    with opened("rssr") as viewer:
        yield viewer


# ---------------------------------------------------------------- following the branch


def test_every_joint_is_reported_where_the_assembled_mechanism_has_it(rssr):
    answer = Page(rssr).move("crank", 40.0)
    mechanism = sp.load("rssr")
    state = sp.assemble(mechanism, {"crank": np.deg2rad(40.0)})
    told = dict(answer["poses"])
    assert set(told) == {f"/mechanism/{name}" for name in list(mechanism.model.names)[1:]}
    for path, pose in told.items():
        place = state.data.oMi[mechanism.joint_id(path.removeprefix("/mechanism/"))]
        np.testing.assert_allclose(pose[:3], place.translation, atol=1e-9)
    assert answer["values"]["crank"] == pytest.approx(40.0)
    assert "stop" not in answer
    assert answer["says"][0] == "crank = 40.00°"
    assert re.fullmatch(r"closure error \d\.\de-1\d", answer["says"][-1])


def test_coordinates_that_are_no_drivers_can_have_sliders():
    with opened("four_bar", drivers=["rocker_pin"], outputs=["crank"]) as viewer:
        before = Page(viewer).ask("ranges")
        value = before["values"]["rocker_pin"] + 3.0
        answer = Page(viewer).move("rocker_pin", value)
    assert answer["values"] == {"rocker_pin": pytest.approx(value)}
    assert before["says"][1] != answer["says"][1]
    assert answer["says"][1].startswith("crank = ")


def test_one_driver_of_many_can_have_the_only_slider():
    with opened("stewart", drivers=["leg_2"], outputs=["leg_1", "leg_3"],
                look=sp.Look(traces=("platform",))) as viewer:
        asking = Page(viewer)
        answer = asking.move("leg_2", 420.0)
        assert asking.ask("mode")["says"][:3] == answer["says"][:3]
    assert answer["says"][:3] == ["leg_2 = 420.00 mm", "leg_1 = 392.58 mm", "leg_3 = 392.58 mm"]


# ---------------------------------------------------------------- what the page is told


def test_limit_is_reported_in_words_and_marked_on_the_slider():
    with opened("four_bar", dimensions=DOUBLE_ROCKER) as viewer:
        asking = Page(viewer)
        answer = asking.move("crank", 120.0)
        ranges = asking.ask("ranges")["ranges"]["crank"]
    assert answer["stop"]["text"] == "limit position: crank = 88.73°"
    assert answer["stop"]["value"] == answer["values"]["crank"]
    assert answer["says"][0] == "crank = 88.73°"
    lower, upper = (np.rad2deg(end.value) for end in
                    sp.limits(sp.load("four_bar", **DOUBLE_ROCKER), "crank")[1:3])
    assert [m["at"] for m in ranges["marks"]] == pytest.approx([lower, upper])
    assert ranges["ends"][0] < lower and upper < ranges["ends"][1]


def test_the_page_knows_joint_limits_and_switches_them_off(tmp_path):
    with sp.live(limited_slider(tmp_path), open_browser=False) as viewer:
        assert live_data(viewer)["limits"] is True
        asking = Page(viewer)
        answer = asking.move("crank", 0.0)
        assert answer["stop"]["kind"] == "joint limit"
        assert answer["stop"]["text"].startswith("joint limit of slide: crank = ")
        assert len(asking.ask("limits", keep=True)["ranges"]["crank"]["marks"]) == 2
        assert asking.ask("limits", keep=False)["ranges"]["crank"]["marks"] == []
        answer = asking.move("crank", 0.0)
        assert "stop" not in answer and "beyond limits: slide" in answer["says"]
        assert "true or false" in asking.ask("limits", keep="no")["error"]


@pytest.mark.parametrize("limits", [True, False])
def test_joint_limits_are_in_the_way_from_the_start_or_not(tmp_path, limits):
    with sp.live(limited_slider(tmp_path), limits=limits, open_browser=False) as viewer:
        told = live_data(viewer)
        assert told["limits"] is True and told["keeps"] is limits
        assert ("stop" in Page(viewer).move("crank", 0.0)) is limits


def test_slider_without_limits_goes_a_turn_either_way_and_follows_what_is_typed(rssr):
    asking = Page(rssr)
    assert asking.ask("ranges")["ranges"]["crank"] == {"ends": pytest.approx([-360, 360]),
                                                      "marks": []}
    asking.move("crank", 1000.0)
    assert asking.ask("ranges")["ranges"]["crank"]["ends"] == pytest.approx([640, 1360])


def test_lengths_and_points_are_reported_in_a_unit_that_reads_well():
    with opened("stewart", outputs=["platform.position"]) as viewer:
        says = Page(viewer).ask("ranges")["says"]
    assert says[0] == "leg_1 = 392.58 mm"
    assert re.fullmatch(r"platform position = \((−?\d+\.\d\d, ){2}−?\d+\.\d\d\) mm", says[6])


def test_transmission_angle_can_be_watched():
    with opened("four_bar", outputs=["rocker_pin.transmission_angle"]) as viewer:
        says = Page(viewer).move("crank", 40.0)["says"]
    motion = sp.sweep(sp.load("four_bar"), "crank", [np.deg2rad(40.0)])
    angle = np.rad2deg(motion.output("rocker_pin.transmission_angle").values[0])
    assert says[1] == f"rocker_pin transmission angle = {angle:.1f}°"


def test_forces_that_hold_it_can_be_watched():
    with opened("four_bar", outputs=["crank.effort", "output_pin.reaction"]) as viewer:
        says = Page(viewer).move("crank", 40.0)["says"]
    mechanism = sp.load("four_bar")
    held = sp.inverse_dynamics(mechanism, sp.assemble(mechanism, {"crank": np.deg2rad(40.0)}))
    told = [x.replace("−", "-") for x in says]
    assert told[1] == f"crank effort = {held.efforts['crank']:.4g} N·m"
    force = ", ".join(f"{x:z.4g}" for x in held.reactions["output_pin"].linear)
    assert told[2].startswith(f"output_pin reaction force = ({force}) N; output_pin reaction mom")


def test_other_assembly_and_start_again():
    with opened("four_bar") as viewer:
        asking = Page(viewer)
        first = asking.move("crank", 50.0)
        second = asking.ask("mode")
        assert re.fullmatch(r"assembly mode [12] of 2 found", second["note"])
        assert second["values"] == {"crank": pytest.approx(50.0)}
        assert second["poses"] != first["poses"]
        back = dict(asking.ask("mode")["poses"])
        for path, pose in first["poses"]:
            np.testing.assert_allclose(back[path], pose, atol=1e-6)
        home = asking.ask("home")
    assert home["values"]["crank"] == pytest.approx(np.rad2deg(
        sp.assemble(sp.load("four_bar")).coordinate("crank").value))


def test_springs_stretch_with_the_mechanism():
    mechanism = sp.load("four_bar")
    spring = sp.Spring("return", frames=("coupler_b", "ground"), stiffness=1.0)
    with sp.live(dataclasses.replace(mechanism, springs=(spring,)), open_browser=False) as viewer:
        asking = Page(viewer)
        told = {x: dict(asking.move("crank", x)["poses"]) for x in (20.0, 100.0)}
    for x, poses in told.items():
        state = sp.assemble(mechanism, {"crank": np.deg2rad(x)})
        ends = (state.placement(name).translation for name in spring.frames)
        length = np.linalg.norm(np.subtract(*ends))
        assert poses["/mechanism/spring return"][9] == pytest.approx(length)


# ---------------------------------------------------------------- wrong questions


@pytest.mark.parametrize(("question", "words"), [
    ({"ask": "move", "driver": "cranc", "value": 1.0}, "did you mean 'crank'"),
    ({"ask": "move", "driver": ["crank"], "value": 1.0}, "no driver"),
    ({"ask": "move", "driver": "crank", "value": "1"}, "not a number"),
    ({"ask": "move", "driver": "crank"}, "not a number"),
    ({"ask": "move", "driver": "crank", "value": float("nan")}, "finite"),
    ({"ask": "move", "driver": "crank", "value": 1e300}, "20 turns"),
    ({"ask": "move", "driver": "crank", "value": 10**400}, "large"),
    ({"ask": "spy"}, "asks for one of"),
    ([1, 2], "asks for one of"),
])
def test_wrong_question_is_answered_with_what_is_wrong(rssr, question, words):
    asking = Page(rssr)
    before = asking.ask("ranges")
    status, answer = post(rssr, json.dumps(question).encode(), asking.headers)
    assert status == 200 and words in json.loads(answer)["error"]
    assert asking.ask("ranges") == before


@pytest.mark.parametrize("body", [b"", b"{", b"\xff\xfe\x00", b"[" * LONGEST_QUESTION])
def test_question_that_is_no_json_does_no_harm(rssr, body, capfd):
    asking = Page(rssr)
    status, answer = post(rssr, body, asking.headers)
    assert status == 200 and json.loads(answer)["error"]
    assert asking.move("crank", 5.0)["values"]["crank"] == pytest.approx(5.0)
    assert capfd.readouterr() == ("", "")


# ---------------------------------------------------------------- who is answered


@pytest.mark.parametrize("change", [
    {"X-Token": "guess"},
    {"X-Token": "gueß"},
    {"X-Token": ""},
    {"Origin": "http://example.com"},
    {"Origin": "null"},
    {"Origin": ""},
    {"Host": "example.com"},
    {"Host": "rebound.example.com:80"},
    {"Host": "127.0.0.1:1"},
])
def test_stranger_is_refused(rssr, change):
    body = json.dumps({"ask": "move", "driver": "crank", "value": 33.0}).encode()
    good = headers_of(rssr)
    changed = {k: v.encode("utf-8").decode("latin-1") for k, v in change.items()}
    assert post(rssr, body, {**good, **changed})[0] == 403
    assert Page(rssr).ask("ranges")["values"]["crank"] != pytest.approx(33.0)
    assert post(rssr, body, good)[0] == 200


def test_site_that_is_no_origin_is_refused(rssr):
    headers = headers_of(rssr)
    del headers["Origin"]
    assert post(rssr, b'{"ask": "ranges"}', headers)[0] == 403


def test_page_with_its_token_is_not_given_away_under_another_name(rssr):
    asked = urllib.request.Request(rssr.url, headers={"Host": "rebound.example.com"})
    with pytest.raises(urllib.error.HTTPError, match="403") as caught:
        urllib.request.urlopen(asked, timeout=10)
    caught.value.close()
    name = {"Host": f"localhost:{port_of(rssr)}"}
    with urllib.request.urlopen(urllib.request.Request(rssr.url, headers=name), timeout=10) as got:
        assert got.status == 200


def test_page_without_secrets_may_be_seen_through_a_tunnel():
    with sp.show(sp.assemble(sp.load("rssr")), open_browser=False) as viewer:
        asked = urllib.request.Request(viewer.url, headers={"Host": "localhost:9000"})
        with urllib.request.urlopen(asked, timeout=10) as got:
            assert got.status == 200


@pytest.mark.parametrize("name", ["rebound.example.com", "rebound.example.com:80", "localhost.x:80",
                                  "127.0.0.1.example.com", "localhost:80@example.com", ""])
def test_page_is_not_shown_under_another_name(name):
    with sp.show(sp.assemble(sp.load("rssr")), open_browser=False) as viewer:
        asked = urllib.request.Request(viewer.url, headers={"Host": name})
        with pytest.raises(urllib.error.HTTPError, match="403") as caught:
            urllib.request.urlopen(asked, timeout=10)
        caught.value.close()


def test_long_question_is_refused_unread(rssr):
    headers = headers_of(rssr)
    assert post(rssr, b" " * (LONGEST_QUESTION + 1), headers)[0] == 413
    for length in ("-1", "1e3", "9" * 5000):
        assert post(rssr, b"", {**headers, "Content-Length": length})[0] == 413


def test_page_that_asks_nothing_is_answered_nothing():
    with sp.Viewer("page") as viewer:
        origin = viewer.url.rstrip("/")
        assert post(viewer, b"{}", {"Origin": origin, "X-Token": ""})[0] == 404


def test_a_title_cannot_break_out_of_the_page():
    with opened("rssr", title="</script><script>alert(1)</script>") as viewer:
        text = text_of(viewer)
    assert "<script>alert(1)" not in text and "&lt;script&gt;alert(1)" in text


def test_token_is_new_every_time_and_only_the_live_page_may_connect():
    with opened("rssr") as one, opened("rssr") as two:
        assert headers_of(one)["X-Token"] != headers_of(two)["X-Token"]
        text = text_of(one)
    assert "connect-src 'self'" in text and "default-src 'none'" in text
    assert not re.search(r"<(script|link|img|iframe)[^>]*\b(src|href)\s*=", text)
    still = page(sp.assemble(sp.load("rssr")))
    assert "connect-src 'none'" in still and "fetch(\"/\"" not in still
    assert "@" not in re.sub(r"<script>.*?</script>|<style>.*?</style>", "", still, flags=re.S)


# ---------------------------------------------------------------- a server that lives and ends


def test_many_questions_leave_nothing_behind(rssr):
    asking = Page(rssr)
    before = threading.active_count()
    for k in range(150):
        answer = asking.move("crank", 2.0 * k)
    assert answer["values"]["crank"] == pytest.approx(298.0)
    deadline = time.monotonic() + 5
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() <= before


def test_questions_at_the_same_time_are_answered_one_by_one():
    with opened("stewart") as viewer, ThreadPoolExecutor(8) as pool:
        asking = Page(viewer)
        answers = list(pool.map(
            lambda k: asking.move(f"leg_{k % 6 + 1}", 390.0 + 0.4 * k), range(48)))
        last = asking.ask("ranges")
    assert all("error" not in a for a in answers)
    assert last["values"]["leg_1"] == pytest.approx(390.0, abs=20.0)
    assert float(last["says"][-1].rsplit(" ", 1)[1]) < 1e-12


def test_browser_that_goes_away_in_the_middle_does_no_harm(rssr, capfd):
    asking = Page(rssr)
    port = int(port_of(rssr))
    for sent in (b"", b"POST / HT", b"POST / HTTP/1.1\r\nContent-Length: 50\r\n\r\n{"):
        with socket.create_connection(("127.0.0.1", port)) as line:
            line.sendall(sent)
    with socket.create_connection(("127.0.0.1", port)) as line:
        line.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        line.recv(100)
    assert asking.move("crank", 7.0)["values"]["crank"] == pytest.approx(7.0)
    assert capfd.readouterr() == ("", "")


def test_stopped_page_is_not_answered_any_more():
    viewer = opened("rssr")
    asking = Page(viewer)
    viewer.stop()
    with pytest.raises(ConnectionRefusedError):
        asking.move("crank", 1.0)
    assert not viewer.running


PROGRAM = """
import spatial_pin as sp
viewer = sp.live(sp.load("rssr"), open_browser=False)
print(viewer.url, flush=True)
"""


INTERRUPTED = PROGRAM + """
import os, signal, sys, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where begun in the background

def waits():
    frame = sys._current_frames()[threading.main_thread().ident]
    while frame is not None and frame.f_code is not viewer.wait.__func__.__code__:
        frame = frame.f_back
    return frame is not None

def interrupt():
    while not waits():
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGINT)

threading.Thread(target=interrupt, daemon=True).start()
viewer.wait()
print(viewer)
"""


@pytest.mark.slow
def test_ctrl_c_ends_the_wait_and_the_program():
    command = [sys.executable, "-W", "error", "-c", INTERRUPTED]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == "<Viewer, stopped>"


@pytest.mark.slow
def test_program_ends_while_its_page_is_open():
    done = subprocess.run([sys.executable, "-W", "error", "-c", PROGRAM], capture_output=True,
                          text=True, timeout=30)
    assert done.returncode == 0 and done.stderr == ""


def test_taken_port_is_a_clear_error(rssr):
    port = int(port_of(rssr))
    with pytest.raises(sp.SpatialPinError, match=rf"port {port}"):
        opened("rssr", port=port)


def test_notebook_shows_the_page_in_a_frame(rssr, monkeypatch):
    assert f'<iframe src="{rssr.url}"' in rssr._repr_html_()
    shell = SimpleNamespace(kernel="of a notebook; the shell of a terminal has none")
    ipython = SimpleNamespace(get_ipython=lambda: shell)
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    with sp.live(sp.load("rssr")) as viewer:  # opens no browser and warns of none
        pass
    assert "iframe" not in viewer._repr_html_()


@pytest.mark.parametrize("name", few(["rssr", "delta", "stewart"], "rssr"))
def test_a_dragged_slider_is_answered_at_every_place(name):
    with opened(name) as viewer:
        asking = Page(viewer)
        driver, start = next(iter(asking.ask("ranges")["values"].items()))
        step = 0.2 if name == "stewart" else 1.0
        for k in range(60):
            assert "stop" not in asking.move(driver, start + step * k)


# ---------------------------------------------------------------- what cannot be shown


def test_what_cannot_be_moved_is_refused_at_once():
    mechanism = sp.load("rssr")
    with pytest.raises(sp.SpatialPinError, match="no drivers"):
        sp.live(dataclasses.replace(mechanism, drivers={}), open_browser=False)
    with pytest.raises(sp.SpatialPinError, match="did you mean 'crank'"):
        sp.live(mechanism, drivers=["cranc"], open_browser=False)
    with pytest.raises(sp.SpatialPinError, match="arrows"):
        sp.live(mechanism, look=sp.Look(arrows=("coupler.velocity",)), open_browser=False)
    with pytest.raises(sp.SpatialPinError, match=r"rocker_pin.*knows no rates"):
        sp.live(mechanism, look=sp.Look(curves=("rocker_pin.rate",)), open_browser=False)
    with pytest.raises(sp.UnknownNameError, match="rocker_pni"):
        sp.live(mechanism, look=sp.Look(curves=("rocker_pni",)), open_browser=False)
    with pytest.raises(sp.SpatialPinError, match="traces"):
        sp.live(sp.load("stewart"), look=sp.Look(traces=("platform",)), open_browser=False)
    with pytest.raises(sp.SpatialPinError, match="knows no rates"):
        sp.live(mechanism, outputs=["coupler.velocity"], open_browser=False)
    with pytest.raises(sp.SpatialPinError, match="knows no rates"):
        sp.live(mechanism, outputs=["crank.power"], open_browser=False)
    with pytest.raises(sp.SpatialPinError, match="no force"):
        sp.live(mechanism, outputs=["cranc.effort"], open_browser=False)
    with pytest.raises(sp.SpatialPinError, match="no output"):
        sp.live(mechanism, outputs=["nothing"], open_browser=False)
    with pytest.raises(sp.SpatialPinError, match="belongs to mechanism"):
        sp.live(mechanism, sp.assemble(sp.load("four_bar")), open_browser=False)


def test_mechanism_where_a_state_or_motion_is_needed_is_a_clear_error(tmp_path):
    mechanism = sp.load("rssr")
    for call in (sp.show, lambda m: sp.export_html(m, tmp_path / "a.html"),
                 lambda m: sp.screenshot(m, tmp_path / "a.png")):
        with pytest.raises(sp.SpatialPinError, match=r"give a State or a Motion: sp\.assemble"):
            call(mechanism)
    assert not list(tmp_path.iterdir())


def test_row_that_does_not_exist_is_a_clear_error(tmp_path):
    motion = sp.sweep(sp.load("rssr"), "crank", np.linspace(0, 1, 11))
    for row in (11, -12, 999):
        with pytest.raises(sp.SpatialPinError, match=rf"no sample {row}: 11 samples are 0 to 10"):
            sp.screenshot(motion, tmp_path / "a.png", row=row)


# ---------------------------------------------------------------- dragging


def eye_at(point: np.ndarray) -> dict[str, list[float]]:
    """A line of sight through a point of the world."""
    origin = point + np.array([0.4, -3.0, 0.7])
    return {"origin": list(origin), "direction": list(point - origin)}


def dragged_to(viewer: sp.Viewer, joint: str, point: np.ndarray, goal: np.ndarray) -> dict:
    question = {"joint": f"/mechanism/{joint}", "point": list(point), **eye_at(goal)}
    return Page(viewer).ask("drag", **question)


@pytest.mark.parametrize(("name", "joint"), [("rssr", "rocker_pin"), ("rssr", "crank_pin"),
                                             ("four_bar", "crank_pin"), ("slider_crank", "slide")])
def test_a_link_that_is_dragged_takes_its_driver_along(name, joint):
    mechanism = sp.load(name)
    (driver,) = mechanism.drivers
    motion = sp.sweep(mechanism, driver, np.linspace(0.4, 0.9, 26))
    j, point = mechanism.joint_id(joint), np.array([0.03, 0.02, 0.01])
    places = [motion.state(k).data.oMi[j].act(point) for k in range(len(motion))]
    with sp.live(mechanism, motion.state(0), open_browser=False) as viewer:
        for goal in places:
            answer = dragged_to(viewer, joint, point, goal)
        assert answer["values"][driver] == pytest.approx(np.rad2deg(0.9), abs=1e-4)


def test_a_link_at_its_dead_centre_can_be_dragged_away():
    mechanism = sp.load("rssr")
    j, point = mechanism.joint_id("rocker_pin"), np.array([0.1, 0.1, 0.0])
    motion = sp.sweep(mechanism, "crank", np.linspace(0.0, 0.6, 31))
    dead = sp.dead_centres(sp.sweep(mechanism, "crank", np.linspace(-0.5, 0.5, 61)))
    start = sp.assemble(mechanism, {"crank": dead[0].value}, motion.state(0))
    goal = motion.state(30).data.oMi[j].act(point)
    with sp.live(mechanism, start, open_browser=False) as viewer:
        before = Page(viewer).ask("ranges")["values"]["crank"]
        answer = dragged_to(viewer, "rocker_pin", point, goal)
        assert abs(answer["values"]["crank"] - before) > 10.0


def test_several_drivers_bring_a_dragged_link_where_it_is_wanted():
    mechanism = sp.load("stewart")
    state = sp.assemble(mechanism)
    j, point = state.mechanism.model.njoints - 1, np.zeros(3)
    goal = state.data.oMi[j].act(point) + np.array([0.02, 0.0, 0.03])
    with sp.live(mechanism, state, open_browser=False) as viewer:
        dragged_to(viewer, state.mechanism.model.names[j], point, goal)
        poses = dict(Page(viewer).ask("ranges")["poses"])
    at, eye = np.array(poses[f"/mechanism/{mechanism.model.names[j]}"][:3]), eye_at(goal)
    way = np.array(eye["direction"]) / np.linalg.norm(eye["direction"])
    assert np.linalg.norm(np.cross(at - eye["origin"], way)) < 1e-6


def test_a_dragged_link_stops_at_joint_limits_which_have_marks_of_their_own(tmp_path):
    mechanism = limited_slider(tmp_path)
    j = mechanism.joint_id("slide")
    with sp.live(mechanism, open_browser=False) as viewer:
        at = sp.assemble(mechanism).data.oMi[j].translation
        for way in np.linspace(0.0, 0.2, 21):
            answer = dragged_to(viewer, "slide", np.zeros(3), at + way * np.array([1.0, 0.0, 0.0]))
        assert "beyond limits" not in " ".join(answer["says"])
        x = dict(answer["poses"])["/mechanism/slide"][0]
        assert x == pytest.approx(0.38, abs=1e-6)
        marks = Page(viewer).ask("ranges")["ranges"]["crank"]["marks"]
        assert [mark["kind"] for mark in marks] == ["joint limit"] * 2


@pytest.mark.parametrize(("change", "words"), [
    ({"joint": "/mechanism/nothing"}, "none that moves"),
    ({"point": [0.0, 0.0]}, "point has shape"),
    ({"origin": [0.0, "a", 0.0]}, "origin"),
    ({"direction": [0.0, 0.0, 0.0]}, "no length"),
])
def test_wrong_drag_is_answered_with_what_is_wrong(rssr, change, words):
    question = {"joint": "/mechanism/crank_pin", "point": [0.0, 0.0, 0.0],
                "origin": [0.0, -1.0, 0.0], "direction": [0.0, 1.0, 0.0], **change}
    assert words in Page(rssr).ask("drag", **question)["error"]


# ---------------------------------------------------------------- in a browser

SETTLED = "typeof said === 'object' && said.length > 0 && !asking && !viewer.needs_render"
@pytest.fixture
def browser(one_browser):
    """The browser of all tests, which must have nothing to complain of after each."""
    one_browser.resize((900, 700))
    yield one_browser
    one_browser.evaluate("1")
    kinds = ("Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled")
    assert [e for e in one_browser.events if e["method"] in kinds] == []


def box_of(browser: Browser, element: str) -> dict[str, float]:
    return browser.evaluate(f"{element}.getBoundingClientRect().toJSON()")


def press(browser: Browser, kind: str, x: float, y: float) -> None:
    browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)


def dragged(browser: Browser, first: float, last: float, steps: int = 20) -> None:
    """Drag the first slider from one part of its length to another."""
    box = box_of(browser, "dials[0].slider")
    y = box["y"] + box["height"] / 2
    places = box["x"] + 8 + (box["width"] - 16) * np.linspace(first, last, steps)
    press(browser, "mousePressed", places[0], y)
    for x in places[1:]:
        press(browser, "mouseMoved", float(x), y)
    press(browser, "mouseReleased", float(places[-1]), y)
    browser.wait_until(SETTLED)


def typed(browser: Browser, text: str) -> None:
    """Type a value into the first number field."""
    browser.evaluate("dials[0].number.focus(); dials[0].number.select(); 1")
    browser.call("Input.insertText", text=text)
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter",
                     windowsVirtualKeyCode=13, text="\r")
    browser.wait_until(SETTLED)


def words(browser: Browser) -> str:
    return browser.evaluate("document.body.innerText")


def picture(browser: Browser) -> np.ndarray:
    """The page above the sliders."""
    height = browser.evaluate("pane.clientHeight")
    return pixels(browser.screenshot())[:height]


def where(browser: Browser, link: str) -> tuple[float, float]:
    """A place of the picture at which a link is seen, away from its edges."""
    return tuple(browser.evaluate(f"""(() => {{
      viewer.render();
      const named = hit => hit && hit.object.userData.solid.name === {link!r};
      for (let y = 60; y < pane.clientHeight - 40; y += 5)
        for (let x = 30; x < innerWidth - 120; x += 5)
          if ([-4, 0, 4].every(d => named(hitAt(x + d, y)) && named(hitAt(x, y + d))))
            return [x, y];
    }})()"""))


class TestBrowser:
    pytestmark = [pytest.mark.browser, needs_browser]  # noqa: RUF012

    @pytest.mark.slow
    def test_typed_value_moves_the_picture_and_is_read(self, browser, rssr):
        browser.open(rssr.url, SETTLED)
        first = picture(browser)
        assert 0.02 < ink(first).mean() < 0.8
        typed(browser, "75.5")
        assert "crank = 75.50°" in words(browser)
        assert browser.evaluate("dials[0].number.value") == "75.50"
        assert browser.evaluate("Number(dials[0].slider.value)") == pytest.approx(75.5)
        assert np.mean(np.any(np.abs(picture(browser) - first) > 0.1, axis=2)) > 0.01

    @pytest.mark.slow
    def test_inspector_tells_coordinates_where_the_mechanism_stands(self, browser, rssr):
        browser.open(rssr.url, SETTLED)
        browser.evaluate("toggleTool('inspector'); inspect('pair rocker_pin'); 1")
        typed(browser, "75.5")
        browser.evaluate("tellInspected(); 1")
        said = browser.evaluate("table.innerText").replace("−", "-").split()
        angle = float(said[said.index("rocker_pin") + 1].rstrip("°"))
        state = sp.assemble(sp.load("rssr"), {"crank": np.deg2rad(75.5)})
        assert angle == pytest.approx(np.rad2deg(state.coordinate("rocker_pin").value), rel=1e-4)

    @pytest.mark.slow
    def test_dragged_slider_moves_the_picture_as_the_typed_value_does(self, browser, rssr):
        browser.open(rssr.url, SETTLED)
        dragged(browser, 0.5, 0.75)
        value = browser.evaluate("dials[0].value")
        assert value == pytest.approx(180.0, abs=3.0)
        here = picture(browser)
        typed(browser, "0")
        assert np.mean(np.any(np.abs(picture(browser) - here) > 0.1, axis=2)) > 0.01
        typed(browser, repr(value))
        browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=450, y=10)
        assert np.mean(np.any(np.abs(picture(browser)[150:] - here[150:]) > 0.1, axis=2)) < 1e-3

    @pytest.mark.slow
    def test_slider_stops_at_the_limit_and_the_page_says_so(self, browser):
        with opened("four_bar", dimensions=DOUBLE_ROCKER) as viewer:
            browser.open(viewer.url, SETTLED)
            assert browser.evaluate("dials[0].track.querySelectorAll('b').length") == 2
            dragged(browser, 0.05, 1.0)
            assert "limit position: crank = 88.73°" in words(browser)
            assert "crank = 88.73°" in words(browser)
            assert browser.evaluate("Number(dials[0].slider.value)") == pytest.approx(88.7267,
                                                                                       abs=1e-3)
            stopped = picture(browser)
            typed(browser, "200")
            assert "limit position: crank = 88.73°" in words(browser)
            np.testing.assert_allclose(picture(browser), stopped, atol=0.02)
            dragged(browser, 0.96, 0.5)
            assert "limit position" not in words(browser)
            assert browser.evaluate("dials[0].value") < 70.0

    def test_slider_stops_at_joint_limits_until_the_switch_lets_it_pass(self, browser, tmp_path):
        with sp.live(limited_slider(tmp_path), open_browser=False) as viewer:
            browser.open(viewer.url, SETTLED)
            assert browser.evaluate("document.getElementById('limits').hidden") is False
            typed(browser, "10")
            assert "joint limit of slide" in words(browser)
            browser.evaluate("keep.click(); 1")
            browser.wait_until("!asking")
            typed(browser, "10")
            assert "crank = 10.00°" in words(browser) and "beyond limits: slide" in words(browser)

    @pytest.mark.slow
    def test_a_link_follows_the_pointer_and_the_camera_stands_still(self, browser, rssr):
        browser.open(rssr.url, SETTLED)
        typed(browser, "40")
        x, y = where(browser, "crank")
        browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        assert browser.evaluate("pane.style.cursor") == "grab"
        browser.evaluate(f"held = pickOf(hitAt({x}, {y})); 1")
        typed(browser, "70")
        browser.evaluate("viewer.render(); 1")
        goal = browser.evaluate("onScreen(inWorld(held))")  # of what was under the pointer at 40
        typed(browser, "40")
        camera = browser.evaluate("viewer.camera.position.toArray()")
        press(browser, "mousePressed", x, y)
        for place in np.linspace((x, y), goal, 9)[1:]:
            press(browser, "mouseMoved", *map(float, place))
            browser.wait_until(SETTLED)
        press(browser, "mouseReleased", *goal)
        browser.wait_until(SETTLED)
        assert browser.evaluate("dials[0].value") == pytest.approx(70.0, abs=1.0)
        assert browser.evaluate("viewer.camera.position.toArray()") == pytest.approx(camera)
        assert browser.evaluate("Number(dials[0].number.value)") == pytest.approx(
            browser.evaluate("dials[0].value"), abs=0.01)

    @pytest.mark.slow
    def test_dragging_the_ground_turns_the_camera(self, browser, rssr):
        browser.open(rssr.url, SETTLED)
        value, camera = (browser.evaluate(s) for s in
                         ("dials[0].value", "viewer.camera.position.toArray()"))
        x, y = where(browser, "ground")
        for kind, way in (("mousePressed", 0), ("mouseMoved", 30), ("mouseReleased", 30)):
            press(browser, kind, x + way, y)
        browser.wait_until(SETTLED)
        assert browser.evaluate("viewer.camera.position.toArray()") != pytest.approx(camera)
        assert browser.evaluate("dials[0].value") == value

    @pytest.mark.slow
    def test_camera_goes_back_where_the_mechanism_leaves_the_picture(self, browser):
        with opened("slider_crank") as viewer:
            browser.open(viewer.url, SETTLED)
            away = "viewer.camera.position.clone().sub(viewer.controls.target).length()"
            browser.evaluate("viewer.camera.position.multiplyScalar(0.3); 1")
            near = browser.evaluate(away)
            typed(browser, "30")
            assert browser.evaluate(away) > 1.2 * near
            browser.evaluate("moved = true; viewer.camera.position.multiplyScalar(0.3); 1")
            near = browser.evaluate(away)
            typed(browser, "60")
            assert browser.evaluate(away) == pytest.approx(near)
            browser.evaluate("view('fit'); 1")
            assert browser.evaluate(away) > 1.2 * near

    @pytest.mark.slow
    def test_joint_limits_are_marked_in_another_way_than_limit_positions(self, browser, tmp_path):
        with sp.live(limited_slider(tmp_path), open_browser=False) as viewer:
            browser.open(viewer.url, SETTLED)
            marks = "[...dials[0].track.querySelectorAll('b')].map(b => b.className)"
            assert browser.evaluate(marks) == ["joint-limit", "joint-limit"]
            browser.evaluate("keep.click(); 1")
            browser.wait_until("!asking")
            assert browser.evaluate(marks) == []

    @pytest.mark.slow
    def test_error_and_lost_server_are_reported(self, browser):
        viewer = opened("rssr")
        try:
            browser.open(viewer.url, SETTLED)
            typed(browser, "1e6")
            assert "no further than 20 turns" in words(browser)
            assert browser.evaluate("dials[0].number.value") != "1e6"
        finally:
            viewer.stop()
        browser.evaluate("wish({ask: 'ranges'}); 1")
        browser.wait_until("!asking")
        assert "no answer from the program" in words(browser)
        browser.events.clear()

    @pytest.mark.slow
    def test_names_of_a_mechanism_cannot_break_out_of_the_page(self, browser):
        title = "</script><script>document.title = 'broken'</script>"
        with opened("rssr", title=title) as viewer:
            browser.open(viewer.url, SETTLED)
            assert browser.evaluate("document.title") == title

    @pytest.mark.slow
    def test_open_tree_has_no_other_assembly(self, browser, rssr):
        for viewer, shown in ((opened("crane"), False), (rssr, True)):
            with viewer:
                browser.open(viewer.url, SETTLED)
                assert (box_of(browser, "document.getElementById('mode')")["width"] > 0) == shown

    @pytest.mark.slow
    def test_reloaded_page_shows_where_the_mechanism_is(self, browser, rssr):
        browser.open(rssr.url, SETTLED)
        typed(browser, "120")
        browser.open(rssr.url, SETTLED)
        assert "crank = 120.00°" in words(browser)

    @pytest.mark.slow
    @pytest.mark.parametrize("size", [(900, 700), (420, 700)])
    def test_sliders_leave_room_for_the_picture(self, browser, size):
        with opened("stewart") as viewer:
            browser.resize(size)
            try:
                browser.open(viewer.url, SETTLED)
                seen = ink(picture(browser))
                assert seen.shape[0] >= 0.5 * size[1] and seen.mean() > 0.05
                assert browser.evaluate("document.documentElement.scrollWidth") <= size[0]
                assert browser.evaluate("dials.length") == 6
                assert box_of(browser, "dials[5].slider")["width"] > 80
            finally:
                browser.resize((900, 700))


# ---------------------------------------------------------------- curves that grow


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_curves_grow_while_the_mechanism_is_moved(browser):
    look = sp.Look(curves=("rocker_pin", "coupler.com.position"))
    mechanism = sp.load("rssr")
    with sp.live(mechanism, look=look, open_browser=False) as viewer:
        browser.resize((900, 760))
        browser.open(viewer.url, SETTLED)
        assert browser.evaluate("[panels.length, film.curves.name]") == [2, "crank [°]"]
        dragged(browser, 0.5, 0.6)
        browser.wait_until("!asking && !viewer.needs_render && film.curves.x.length > 3")
        browser.screenshot()
        x, rocker = browser.evaluate("[film.curves.x, film.curves.panels[0].lines[0].values]")
        states = [sp.assemble(mechanism, {"crank": np.radians(v)}) for v in (x[0], x[-1])]
        np.testing.assert_allclose(
            [rocker[0], rocker[-1]], [np.degrees(s.coordinate("rocker_pin").value) for s in states],
            rtol=1e-5)
        drawn = "panels.map(p => p.svg.querySelectorAll('path').length)"
        assert browser.evaluate(drawn) == [1, 3]
        assert browser.evaluate("panels[0].values[0].textContent") == f"{rocker[-1]:.5g} °"
        # the mechanism goes where one clicks in a curve
        box = box_of(browser, "panels[0].svg")
        click_at(browser, box["x"] + 0.3 * box["width"], box["y"] + 40)
        browser.wait_until("!asking")
        now = browser.evaluate("dials[0].value")
        assert x[0] < now < 0.5 * (x[0] + x[-1])
        # going back to the start is no line
        press_button = "document.getElementById('home').onclick(); 1"
        browser.evaluate(press_button)
        browser.wait_until("!asking")
        assert None in browser.evaluate("film.curves.panels[0].lines[0].values")
        assert browser.evaluate("document.documentElement.scrollHeight") <= 760


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
def test_curves_of_many_drivers_are_drawn_movement_by_movement(browser):
    with sp.live(sp.load("stewart"), look=sp.Look(curves=("platform.position",)),
              open_browser=False) as viewer:
        browser.resize((390, 844))
        browser.open(viewer.url, SETTLED)
        browser.evaluate("wish({ask: 'move', driver: 'leg_1', value: dials[0].value + 5}); 1")
        browser.wait_until("!asking && film.curves.x.length === 2")
        browser.evaluate("wish({ask: 'move', driver: 'leg_2', value: dials[1].value + 5}); 1")
        browser.wait_until("!asking && film.curves.x.length === 3")
        browser.screenshot()
        assert browser.evaluate("[film.curves.x, film.curves.name]") == [[0, 1, 2], "movements"]
        assert browser.evaluate("pane.clientHeight") > 250
        tools, triad = (box_of(browser, f"document.getElementById('{name}')")
                        for name in ("tools", "triad"))
        seen = browser.evaluate(
            "getComputedStyle(document.querySelector('#triad g')).visibility") == "visible"
        assert seen == (triad["y"] >= tools["bottom"])
        assert browser.evaluate("document.documentElement.scrollWidth") <= 390


def test_what_stands_still_has_no_curves(tmp_path):
    state = sp.assemble(sp.load("rssr"))
    with pytest.raises(sp.SpatialPinError, match="curves belong to a motion"):
        sp.export_html(state, tmp_path / "a.html", look=sp.Look(curves="rocker_pin"))
