"""The report as text: what it says, and that nothing leads out of it. No browser needed."""

import html
import itertools
import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp


@pytest.fixture(scope="module")
def rssr() -> sp.Motion:
    return sp.sweep(sp.load("rssr"), "crank", np.linspace(0, 2 * np.pi, 73), speed=25.0)


@pytest.fixture(scope="module")
def reported(rssr, tmp_path_factory):
    """The report of that motion."""
    return sp.report(rssr, tmp_path_factory.mktemp("report") / "rssr.html")


def read(path) -> str:
    """The report without its 3-D view."""
    return re.sub(r'srcdoc="[^"]*"', "", path.read_text(encoding="utf-8"))


def headings(text: str) -> list[str]:
    return re.findall(r"<h2>(.*?)</h2>", text)


def test_report_of_a_motion_has_its_sections(rssr, reported):
    text = read(reported)
    assert headings(text) == [
        "Outputs", "Speed ratios", "Accelerations", "Ranges",
        "Special positions", "Efforts", "Reactions", "Mobility", "Dimensions", "Structure",
        "Accuracy",
    ]
    assert "<h1>RSSR spatial four-bar</h1>" in text
    assert html.escape(str(sp.mobility(rssr.mechanism, rssr.state(21)))) in text
    for name, value in rssr.mechanism.dimensions.items():
        assert f'<td>{name}</td><td class="number">{value:g}</td>' in text
    digits, power = f"{rssr.closure_error.max():.1e}".split("e")
    power = "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(x)] for x in power.lstrip("-0"))
    assert f"{digits}\u00a0·\u00a010⁻{power}" in text
    assert f"spatial_pin {sp.__version__}" in text and f"Pinocchio {pin.__version__}" in text
    assert "ball_a.x [rad], ball_a.y [rad], ball_a.z [rad]" in text
    assert len(re.findall(r'<svg role="img"', text)) == 4
    greatest = np.rad2deg(rssr.coordinate("rocker_pin").value.max())
    assert f"{greatest:.6g}°" in text
    assert "dead centre of rocker_pin" in text


def test_report_refers_to_nothing_outside_itself(reported):
    text = reported.read_text(encoding="utf-8")
    outer = re.sub(r'srcdoc="[^"]*"', "", text)
    assert text.count("default-src 'none'") == 1 and "default-src &#x27;none&#x27;" in text
    assert not re.search(r"<(script|link|img|iframe)[^>]*\b(src|href)\s*=", outer)
    assert not re.findall(r'(?:href|src)="(?!#)[^"]*"', outer)
    assert len(text) < 1.6e6


def test_view_in_the_report_is_the_page_with_its_title_and_look(rssr, tmp_path):
    look = sp.Look(traces=("coupler.com",))
    path = sp.report(rssr, tmp_path / "rssr.html", title="A <b>", look=look)
    text = path.read_text(encoding="utf-8")
    (view,) = re.findall(r'srcdoc="([^"]*)"', text)
    inner = html.unescape(view)
    assert inner.startswith("<!DOCTYPE html>") and "<h1>A &lt;b&gt;</h1>" in inner
    assert inner.count("</body>") == 1 and "beforeprint" in inner
    assert "<h1>A &lt;b&gt;</h1>" in text and "path of coupler.com" in inner


def test_same_motion_gives_the_same_report(rssr, reported, tmp_path):
    assert read(sp.report(rssr, tmp_path / "again.html")) == read(reported)


def test_report_of_a_state_has_coordinates_instead_of_curves(tmp_path):
    state = sp.assemble(sp.load("stewart"))
    text = read(sp.report(state, tmp_path / "stewart.html"))
    assert headings(text) == ["Configuration", "Mobility", "Dimensions", "Structure", "Accuracy"]
    assert "<svg" not in text and "hook_1.first" in text


def test_report_of_a_limit_tells_it_and_marks_it(tmp_path):
    motion = sp.sweep(sp.load("four_bar"), "rocker_pin", np.linspace(1.8, 2.9, 60), on_limit="stop")
    text = read(sp.report(motion, tmp_path / "limit.html"))
    (event,) = motion.events
    assert html.escape(event.text) in text and f"{np.rad2deg(event.value):.10g}°" in text
    lines = sp.plot(motion, "crank_pin").axes[0].lines
    assert lines[-1].get_xdata()[0] == pytest.approx(np.rad2deg(event.value))


def test_a_legend_says_what_the_lines_at_events_mean():
    mech = sp.load("slider_crank")
    at, model = mech.coordinate("slide").q, mech.model
    lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    lower[at], upper[at] = 0.1103, 0.3
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    motion = sp.sweep(mech, "crank", np.linspace(0.2, 6.0, 61))
    (legend,) = (figure := sp.plot(motion, ["slide", "slide.ratio"])).legends
    assert [text.get_text() for text in legend.get_texts()] == ["joint limit"]
    for axes in figure.axes:
        assert axes.lines[-1].get_xdata()[0] == pytest.approx(np.rad2deg(motion.events[0].value))
    quiet = sp.sweep(mech, "crank", np.linspace(0.2, 1.0, 5))
    assert not sp.plot(quiet, "slide").legends


def test_events_of_a_simulation_are_marked_at_their_times():
    mech = sp.load("stewart")
    state = sp.solve_rates(mech, sp.assemble(mech), {"leg_1": 0.1})
    motion = sp.simulate(mech, state, 0.2, on_joint_limit="stop")
    figure = sp.plot(motion, "slide_1")
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["joint limit", "stopped"]
    assert figure.axes[0].lines[-1].get_xdata()[0] == motion.events[-1].value == motion.time[-1]


def test_ticks_tell_whole_numbers_where_a_coordinate_hardly_changes():
    """Nothing is to be added to them in one's head, and they have room."""
    motion = sp.sweep(sp.load("slider_crank"), "crank", np.linspace(1.0, 1.00001, 31))
    figure = sp.plot(motion, ["slide", "slide.ratio"])
    figure.canvas.draw()
    for axes in figure.axes:
        assert not axes.yaxis.get_offset_text().get_text()
        for label in axes.get_yticklabels():
            low, high = axes.get_ylim()
            if low <= label.get_position()[1] <= high:
                assert float(label.get_text().replace("\u2212", "-")) == pytest.approx(
                    label.get_position()[1], rel=1e-12)
    boxes = [t.get_window_extent() for t in figure.axes[-1].get_xticklabels() if t.get_text()]
    assert all(a.x1 < b.x0 for a, b in itertools.pairwise(boxes)) and len(boxes) > 2


def test_outputs_are_those_requested(rssr, tmp_path):
    outputs = ["coupler.com.position", "rocker_pin"]
    text = read(sp.report(rssr, tmp_path / "a.html", outputs=outputs))
    names = re.findall(r'aria-label="([^"]*)"', text)
    assert names == [
        "Outputs of rssr: coupler.com.position, rocker_pin",
        "Speed ratios of rssr: rocker_pin.ratio",
        "Velocities of rssr: coupler.com.velocity",
        "Accelerations of rssr: coupler.com.acceleration, rocker_pin.acceleration",
        "Efforts of rssr: crank effort",
    ]
    assert "x, y and z are world axes" in text
    with pytest.raises(sp.SpatialPinError, match="rocker_pin"):
        sp.report(rssr, tmp_path / "b.html", outputs=["rocker_pni"])


def test_tree_without_loops_is_reported(tmp_path):
    motion = sp.sweep(sp.load("crane"), "slew", np.linspace(0, 1, 11))
    text = read(sp.report(motion, tmp_path / "crane.html"))
    assert "no loops" in text and "boom.com.position" in text
    assert "Speed ratios" not in headings(text)


def test_motion_in_time_without_a_driver_is_reported_over_time(rssr, tmp_path):
    motion = replace(rssr, driver=None, driver_name="", driver_speed=None)
    text = read(sp.report(motion, tmp_path / "a.html"))
    assert "Speed ratios" not in headings(text)
    assert "<dt>Duration</dt>" in text and '<th class="number">at time</th>' in text


def test_motion_without_rows_is_refused(rssr, tmp_path):
    empty = sp.Motion(rssr.mechanism, rssr.driver[:0], "crank", None, rssr.q[:0], rssr.v[:0],
                      rssr.a[:0], rssr.closure_error[:0], rssr.driver_speed[:0])
    with pytest.raises(ValueError, match="no samples"):
        sp.report(empty, tmp_path / "a.html")


def test_a_motion_that_its_drivers_cannot_bring_about_has_no_efforts(rssr, tmp_path):
    idle = replace(rssr.mechanism, drivers={})
    motion = replace(rssr, mechanism=idle, driver=None, driver_name="")
    text = read(sp.report(motion, tmp_path / "a.html"))
    assert not {"Efforts", "Reactions"} & set(headings(text))


# ---------------------------------------------------------------- pieces


def test_plot_without_a_title_has_none(rssr):
    assert sp.plot(rssr, "rocker_pin", title="").get_suptitle() == ""


@pytest.mark.parametrize(
    ("name", "rows", "fps", "message"),
    [
        ("a.avi", 5, 25, r"\.gif or \.mp4"),
        ("a.gif", 5, 0, "positive"),
        ("a.gif", 1, 25, "no movie"),
    ],
)
def test_movie_that_cannot_be_is_refused_at_once(rssr, tmp_path, name, rows, fps, message):
    motion = sp.sweep(rssr.mechanism, "crank", np.linspace(0.1, 0.2, rows))
    with pytest.raises(ValueError, match=message):
        sp.movie(motion, tmp_path / name, fps=fps)


def test_the_report_of_a_simulation_balances_its_energy(rssr, tmp_path):
    mechanism = rssr.mechanism
    state = sp.solve_rates(mechanism, sp.assemble(mechanism), {"crank": 3.0})
    simulated = sp.simulate(mechanism, state, 0.2, times=np.linspace(0.0, 0.2, 21))
    text = sp.report(simulated, tmp_path / "r.html").read_text(encoding="utf-8")
    assert "Energy and work balance to" in text


def test_the_report_tells_efforts_reactions_and_dead_centres(rssr, reported):
    text = reported.read_text(encoding="utf-8")
    for words in ("crank effort [N·m]", "fixed link, all together", "dead centre of rocker_pin"):
        assert words in text
    loads = sp.kinetostatics(rssr.mechanism, rssr)
    largest = np.linalg.norm(loads.reactions["ball_b"][:, :3], axis=1).max()
    assert f"{largest:.6g}" in text
